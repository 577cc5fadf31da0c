//! Shapes of bodies: what is drawn and what collides.

use std::path::PathBuf;

use nalgebra::{Isometry3, Vector3};

use super::common::{Material, ShaderProgram};

/// A coordinate axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Axis {
    /// First axis.
    X,
    /// Second axis.
    Y,
    /// Third axis, the default.
    #[default]
    Z,
}

/// A primitive shape, centred at its own origin. Lengths in m; all are positive and finite.
#[derive(Clone, Debug, PartialEq)]
pub enum Primitive {
    /// Box with full edge lengths along x, y, z.
    Box {
        /// Full edge lengths, m.
        size: Vector3<f64>,
    },
    /// Sphere.
    Sphere {
        /// Radius, m.
        radius: f64,
    },
    /// Cylinder.
    Cylinder {
        /// Radius, m.
        radius: f64,
        /// Full height, m.
        height: f64,
        /// Axis of symmetry.
        axis: Axis,
    },
    /// Capsule.
    Capsule {
        /// Radius, m.
        radius: f64,
        /// Total height with both caps, m, as written; it may be less than the two caps need.
        height: f64,
        /// Axis of symmetry.
        axis: Axis,
    },
    /// Cone.
    Cone {
        /// Radius of the base, m.
        radius: f64,
        /// Full height, m.
        height: f64,
        /// Axis of symmetry.
        axis: Axis,
    },
    /// Half space below a plane.
    Plane {
        /// Outward normal as written: finite, not zero, not normalised.
        normal: Vector3<f64>,
        /// Signed distance of the plane from the origin along the normal, m.
        offset: f64,
    },
}

/// A primitive at a pose in the body frame.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedPrimitive {
    /// The shape.
    pub primitive: Primitive,
    /// Pose of the shape in the body frame. Default: identity.
    pub offset: Isometry3<f64>,
}

/// What collides.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum CollisionGeometry {
    /// Nothing: the body gets an empty shape.
    #[default]
    None,
    /// Keys `collision shape`, `collision geometry`, `collision offset`.
    Primitive {
        /// The shape.
        primitive: Primitive,
        /// Pose of the shape in the body frame; `None`: the inertial frame. Not used for a plane.
        offset: Option<Isometry3<f64>>,
    },
    /// Key `compound collision shape`; not empty.
    Compound(Vec<PlacedPrimitive>),
    /// Key `collision mesh`, or `mesh`.
    Mesh {
        /// The mesh file; absolute or relative to the working directory; not looked for yet.
        path: PathBuf,
        /// What Bullet shape the mesh becomes.
        kind: CollisionMeshKind,
    },
}

/// Key `collision mesh type`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CollisionMeshKind {
    /// Convex hull of all vertices of a sub-mesh.
    ConvexHull,
    /// Triangle mesh treated as convex.
    ConvexMesh,
    /// Triangle mesh as it is, the default.
    #[default]
    ConcaveMesh,
    /// A sphere with the radius of the collision margin at each vertex.
    PointCloud,
}

/// What is drawn.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum VisualGeometry {
    /// Nothing.
    #[default]
    None,
    /// Keys `shape` and `geometry`.
    Primitive(Primitive),
    /// Key `compound shape`; not empty.
    Compound(Vec<PlacedPrimitive>),
    /// Key `mesh`.
    Mesh {
        /// The mesh file; absolute or relative to the working directory; not looked for yet.
        path: PathBuf,
    },
}

/// Appearance of a body.
#[derive(Clone, Debug, PartialEq)]
pub struct Visual {
    /// What is drawn.
    pub geometry: VisualGeometry,
    /// Weld duplicate vertices of the mesh. Default: `false`.
    pub remove_duplicates: bool,
    /// Default: `true`.
    pub visible: bool,
    /// Replaces the mesh's own materials; `None`: they stay.
    pub material: Option<Material>,
    /// Own shaders; `None`: the model's, else the world's.
    pub shaders: Option<ShaderProgram>,
}

impl Default for Visual {
    fn default() -> Self {
        Self { geometry: VisualGeometry::None, remove_duplicates: false, visible: true, material: None, shaders: None }
    }
}
