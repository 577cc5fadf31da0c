//! Shapes of bodies: what is drawn and what collides.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};

use super::common::{Material, ShaderProgram};
use super::reader::{Map, Range};
use super::report::ProblemKind;
use super::values::{mesh_path, Base};
use crate::mesh::Mesh;

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
    /// Ellipsoid, for descriptions that are not ADF.
    Ellipsoid {
        /// Half axes along x, y, z, m.
        radii: Vector3<f64>,
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

/// A primitive or a mesh at a pose in the body frame. ADF has no bodies made of several meshes; URDF has.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// What is placed.
    pub geometry: PartGeometry,
    /// Pose of the shape or mesh in the body frame.
    pub offset: Isometry3<f64>,
}

/// Shape of a [`Part`].
#[derive(Clone, Debug, PartialEq)]
pub enum PartGeometry {
    /// A primitive.
    Primitive(Primitive),
    /// A mesh file.
    Mesh {
        /// The mesh file; absolute or relative to the working directory; not looked for yet.
        path: PathBuf,
        /// Factors along the axes of the mesh; finite, none is zero, negative ones mirror.
        scale: Vector3<f64>,
    },
    /// Triangles that the description itself gives. Never in ADF files.
    Triangles(Arc<Mesh>),
}

/// A [`Part`] that is drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct VisualPart {
    /// What is drawn.
    pub part: Part,
    /// Replaces the part's own materials; `None`: they stay.
    pub material: Option<Material>,
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
    /// Primitives and meshes together, for descriptions that are not ADF; not empty. A mesh that cannot be used leaves
    /// the other parts as they are. The body's scale has no effect on them.
    Parts {
        /// The parts.
        parts: Vec<Part>,
        /// What Bullet shape each mesh becomes.
        kind: CollisionMeshKind,
    },
}

/// Key `collision mesh type`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
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
    /// Convex hulls that together have nearly the surface of a sub-mesh. The C++ program does not know it.
    ConvexDecomposition(ConvexDecomposition),
    /// Convex hull of each solid of a sub-mesh ([`SubMesh::solids`](crate::mesh::SubMesh::solids)), and of one with holes the
    /// hulls into which it is divided. For descriptions that are not ADF.
    ConvexParts(ConvexDecomposition),
}

/// Key `convex decomposition`: how a mesh is divided into convex hulls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConvexDecomposition {
    /// Hulls of a sub-mesh at most, 1 to [`MAX_HULLS`](Self::MAX_HULLS). Default: 32.
    pub hulls: u32,
    /// Voxels along the longest edge of the bounding box of a sub-mesh, 8 to [`MAX_RESOLUTION`](Self::MAX_RESOLUTION):
    /// the finer, the closer a cut can be to where it is best. Default: 64.
    pub resolution: u32,
    /// Volume that a hull may have beyond what it encloses of the sub-mesh, as a share of the volume of the convex hull
    /// of the whole sub-mesh; above 0, at most 1. Default: 0.005.
    pub concavity: f64,
}

impl ConvexDecomposition {
    /// The cost of two bodies that touch grows with the product of their numbers of hulls.
    pub const MAX_HULLS: u32 = 256;
    /// Two million voxels.
    pub const MAX_RESOLUTION: u32 = 128;
}

impl Default for ConvexDecomposition {
    fn default() -> Self {
        Self { hulls: 32, resolution: 64, concavity: 0.005 }
    }
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
    /// Primitives and meshes together, for descriptions that are not ADF; not empty.
    Parts(Vec<VisualPart>),
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

const SHAPES: &str = "Box, Sphere, Cylinder, Capsule, Cone or Plane";

impl Primitive {
    /// Reads the shape named by one key with the dimensions below another; an unknown shape is reported and left out.
    fn read(map: &Map<'_>, shape: &'static str, geometry: &'static str) -> Option<Self> {
        let name = map.need_string(shape);
        let capitalised = |c: &str| {
            ["Box", "Sphere", "Cylinder", "Capsule", "Cone", "Plane"]
                .into_iter()
                .find(|n| *n == c || n.to_lowercase() == c || n.to_uppercase() == c)
        };
        let Some(name) = capitalised(&name) else {
            map.error(ProblemKind::UnknownValue, shape, SHAPES, "the shape is left out");
            map.skip(&[geometry]);
            return None;
        };
        let dims = map.map(geometry);
        let length = |key| dims.need_real_in(key, Range::Positive);
        let primitive = match name {
            "Box" => Primitive::Box { size: Vector3::new(length("x"), length("y"), length("z")) },
            "Sphere" => Primitive::Sphere { radius: length("radius") },
            "Plane" => {
                let normal = dims.need_vector("normal");
                dims.reject_zero("normal", &normal);
                Primitive::Plane { normal, offset: dims.need_real("offset") }
            }
            round => {
                let (radius, height) = (length("radius"), length("height"));
                let axis = Axis::read(&dims);
                match round {
                    "Cylinder" => Primitive::Cylinder { radius, height, axis },
                    "Capsule" => Primitive::Capsule { radius, height, axis },
                    _ => Primitive::Cone { radius, height, axis },
                }
            }
        };
        dims.finish();
        Some(primitive)
    }
}

impl Axis {
    fn read(map: &Map<'_>) -> Self {
        match map.string("axis").as_deref() {
            Some("x" | "X") => Axis::X,
            Some("y" | "Y") => Axis::Y,
            Some("z" | "Z") | None => Axis::Z,
            Some(_) => {
                map.warn(ProblemKind::UnknownValue, "axis", "x, y or z", "z is used");
                Axis::Z
            }
        }
    }
}

fn compound(map: &Map<'_>, key: &'static str) -> Vec<PlacedPrimitive> {
    let mut children = Vec::new();
    for child in map.maps(key) {
        let primitive = Primitive::read(&child, "shape", "geometry");
        let offset = child.pose("offset").unwrap_or_default();
        child.skip(&["name"]);
        child.finish();
        children.extend(primitive.map(|primitive| PlacedPrimitive { primitive, offset }));
    }
    children
}

/// Directories of an element's own meshes: keys `high resolution path`, `low resolution path`.
fn own_paths(map: &Map<'_>) -> (PathBuf, PathBuf) {
    let high = map.filled("high resolution path").unwrap_or_default();
    let low = map.filled("low resolution path");
    let low = low.unwrap_or_else(|| high.clone());
    (high.into(), low.into())
}

impl Visual {
    /// Reads the keys of the visual geometry of an element.
    pub(super) fn read(map: &Map<'_>, base: &Base) -> Self {
        let geometry = if map.has("shape") {
            map.skip(&["compound shape"]);
            Primitive::read(map, "shape", "geometry").map_or(VisualGeometry::None, VisualGeometry::Primitive)
        } else if map.has("compound shape") {
            match compound(map, "compound shape") {
                children if children.is_empty() => VisualGeometry::None,
                children => VisualGeometry::Compound(children),
            }
        } else if let Some(mesh) = map.filled("mesh") {
            let (own, _) = own_paths(map);
            let dir = map.reader().dir();
            VisualGeometry::Mesh { path: mesh_path(dir, &base.high_resolution, &own, &mesh) }
        } else {
            VisualGeometry::None
        };
        map.skip(&["mesh", "high resolution path"]);
        Self {
            geometry,
            remove_duplicates: map.boolean("mesh remove duplicates").unwrap_or(false),
            visible: map.boolean("visible").unwrap_or(true),
            material: map.material(),
            shaders: map.shaders("shaders"),
        }
    }
}

/// File that key `collision mesh`, or without it `mesh`, names.
pub(super) fn collision_mesh(map: &Map<'_>, base: &Base) -> Option<PathBuf> {
    let key = if map.has("collision mesh") { "collision mesh" } else { "mesh" };
    let mesh = map.filled(key)?;
    let (_, own) = own_paths(map);
    let dir: &Path = map.reader().dir();
    Some(mesh_path(dir, &base.low_resolution, &own, &mesh))
}

impl CollisionGeometry {
    /// Reads the keys of the collision geometry of an element; what is there but unusable is reported.
    pub(super) fn read(map: &Map<'_>, base: &Base) -> Self {
        let replaced = [
            "compound collision shape",
            "collision mesh",
            "collision mesh type",
            "convex decomposition",
            "low resolution path",
        ];
        if map.has("collision shape") {
            map.skip(&replaced);
            let primitive = Primitive::read(map, "collision shape", "collision geometry");
            let offset = map.pose("collision offset");
            return primitive
                .map_or(CollisionGeometry::None, |primitive| CollisionGeometry::Primitive { primitive, offset });
        }
        let why = "only a single `collision shape` has it";
        map.ignore(&["collision geometry", "collision offset"], why);
        if map.has("compound collision shape") {
            let children = compound(map, "compound collision shape");
            map.skip(&replaced);
            if children.is_empty() {
                return CollisionGeometry::None;
            }
            return CollisionGeometry::Compound(children);
        }
        let kind = CollisionMeshKind::read(map);
        let mesh = collision_mesh(map, base);
        map.skip(&["low resolution path"]);
        mesh.map_or(CollisionGeometry::None, |path| CollisionGeometry::Mesh { path, kind })
    }
}

impl CollisionMeshKind {
    fn read(map: &Map<'_>) -> Self {
        let key = "collision mesh type";
        // An empty text is what the Blender add-on writes for "none".
        let kind = match map.string(key).as_deref().filter(|text| !text.is_empty()) {
            Some("CONVEX_HULL" | "convex_hull" | "hull") => Self::ConvexHull,
            Some("CONVEX_MESH" | "convex_mesh") => Self::ConvexMesh,
            Some("POINT_CLOUD" | "point_cloud") => Self::PointCloud,
            Some("CONCAVE_MESH" | "TRIMESH" | "trimesh") | None => Self::ConcaveMesh,
            Some("CONVEX_DECOMPOSITION" | "convex_decomposition" | "convex decomposition") => {
                return Self::ConvexDecomposition(ConvexDecomposition::read(map));
            }
            Some(_) => {
                let expected = "CONVEX_HULL, CONVEX_MESH, CONCAVE_MESH, POINT_CLOUD or CONVEX_DECOMPOSITION";
                map.warn(ProblemKind::UnknownValue, key, expected, "CONCAVE_MESH is used");
                Self::ConcaveMesh
            }
        };
        let why = "only `collision mesh type: CONVEX_DECOMPOSITION` has it";
        map.ignore(&[DECOMPOSITION], why);
        kind
    }
}

const DECOMPOSITION: &str = "convex decomposition";

impl ConvexDecomposition {
    fn read(map: &Map<'_>) -> Self {
        let default = Self::default();
        let block = map.map(DECOMPOSITION);
        let bounded = |key: &str, least: u32, most: u32, default: u32| {
            let Some(value) = block.uint(key) else { return default };
            if !(least..=most).contains(&value) {
                block.reject(ProblemKind::OutOfRange, key, &format!("an integer from {least} to {most}"));
            }
            value.clamp(least, most)
        };
        let read = Self {
            hulls: bounded("hulls", 1, Self::MAX_HULLS, default.hulls),
            resolution: bounded("resolution", 8, Self::MAX_RESOLUTION, default.resolution),
            concavity: block.real_in("concavity", Range::Share).unwrap_or(default.concavity),
        };
        block.finish();
        read
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{read, refused};
    use super::super::{Model, RigidBody};
    use super::*;

    fn body(keys: &str) -> (RigidBody, Vec<String>) {
        let (mut model, problems) = read::<Model>(&format!(
            "bodies: [A]\nhigh resolution path: hi\nlow resolution path: lo\nA: {{mass: 1, {keys}}}\n"
        ));
        (model.bodies.remove(0), problems)
    }

    fn collision(keys: &str) -> CollisionGeometry {
        body(keys).0.collision
    }

    #[test]
    fn primitives_in_three_spellings() {
        for name in ["Cylinder", "cylinder", "CYLINDER"] {
            let keys = format!("collision shape: {name}, collision geometry: {{radius: 1, height: 2, axis: X}}");
            let CollisionGeometry::Primitive { primitive, .. } = collision(&keys) else { panic!() };
            let axis = Axis::X;
            assert_eq!(primitive, Primitive::Cylinder { radius: 1.0, height: 2.0, axis });
        }
        let (body, problems) = body("collision shape: cYlinder, collision geometry: {radius: 1}, mesh: m");
        assert_eq!(body.collision, CollisionGeometry::None);
        assert!(problems[0].contains("`A / collision shape` is `cYlinder`, expected Box"));
        let text = "bodies: [A]\nA: {mass: 1, collision shape: Cone, collision geometry: {radius: 1}}\n";
        assert!(refused::<Model>(text)[0].contains("`A / collision geometry / height` is missing"));
    }

    #[test]
    fn compounds() {
        let child = "{name: 1, shape: Box, geometry: {x: 1, y: 1, z: 1}, offset: {position: {x: 1, y: 0, z: 0}}}";
        let keys = format!("compound collision shape: [{child}, {{shape: Blob}}]");
        let (body, problems) = body(&keys);
        let CollisionGeometry::Compound(children) = body.collision else { panic!() };
        assert_eq!(children.len(), 1);
        assert_eq!(children[0].offset.translation.x, 1.0);
        assert_eq!(problems.len(), 1);
        assert!(problems[0].contains("`A / compound collision shape[1] / shape` is `Blob`"));
    }

    #[test]
    fn meshes() {
        let path = |keys: &str| match collision(keys) {
            CollisionGeometry::Mesh { path, .. } => Some(path),
            _ => None,
        };
        assert_eq!(path("mesh: a.stl"), Some("dir/lo/a.stl".into()));
        assert_eq!(path("mesh: a.stl, collision mesh: b.stl"), Some("dir/lo/b.stl".into()));
        assert_eq!(path("mesh: a.stl, collision mesh: ''"), None);
        assert_eq!(path("mesh: a.stl, high resolution path: own"), Some("dir/lo/own/a.stl".into()));
        let both = "mesh: a.stl, high resolution path: own, low resolution path: /x";
        assert_eq!(path(both), Some("/x/a.stl".into()));
        let VisualGeometry::Mesh { path } = body(both).0.visual.geometry else { panic!() };
        assert_eq!(path, Path::new("dir/hi/own/a.stl"));
    }

    #[test]
    fn mesh_types() {
        for (text, expected) in [
            ("hull", CollisionMeshKind::ConvexHull),
            ("CONVEX_MESH", CollisionMeshKind::ConvexMesh),
            ("trimesh", CollisionMeshKind::ConcaveMesh),
            ("point_cloud", CollisionMeshKind::PointCloud),
        ] {
            let (body, problems) = body(&format!("mesh: a, collision mesh type: {text}"));
            assert!(matches!(body.collision, CollisionGeometry::Mesh { kind, .. } if kind == expected));
            assert!(problems.is_empty());
        }
        for text in ["CONVEX_DECOMPOSITION", "convex_decomposition", "convex decomposition"] {
            let (body, problems) = body(&format!("mesh: a, collision mesh type: {text}"));
            let kind = CollisionMeshKind::ConvexDecomposition(ConvexDecomposition::default());
            assert_eq!(body.collision, CollisionGeometry::Mesh { path: "dir/lo/a".into(), kind });
            assert!(problems.is_empty(), "{problems:?}");
        }
        for (text, expected) in [("''", 0), ("concave_mesh", 1)] {
            let (body, problems) = body(&format!("mesh: a, collision mesh type: {text}"));
            assert!(matches!(body.collision, CollisionGeometry::Mesh { kind: CollisionMeshKind::ConcaveMesh, .. }));
            assert_eq!(problems.len(), expected, "{problems:?}");
        }
    }

    #[test]
    fn a_decomposition_has_parameters() {
        let kind = "mesh: a, collision mesh type: CONVEX_DECOMPOSITION";
        let keys = format!("{kind}, convex decomposition: {{hulls: 8, resolution: 100, concavity: 0.1}}");
        let (read_body, problems) = body(&keys);
        assert!(problems.is_empty(), "{problems:?}");
        let wanted = ConvexDecomposition { hulls: 8, resolution: 100, concavity: 0.1 };
        let CollisionGeometry::Mesh { kind: found, .. } = read_body.collision else { panic!() };
        assert_eq!(found, CollisionMeshKind::ConvexDecomposition(wanted));
        // Without the type the parameters have no meaning, as misspelt ones have not.
        let (read_body, problems) = body("mesh: a, convex decomposition: {hulls: 8}");
        assert!(matches!(read_body.collision, CollisionGeometry::Mesh { kind: CollisionMeshKind::ConcaveMesh, .. }));
        assert_eq!(problems.len(), 1, "{problems:?}");
        let (_, problems) = body(&format!("{kind}, convex decomposition: {{hull: 8}}"));
        assert_eq!(problems.len(), 1, "{problems:?}");
        for wrong in ["hulls: 0", "hulls: 257", "resolution: 7", "resolution: 129", "concavity: 0", "concavity: 1.5"] {
            let text =
                format!("bodies: [A, B]\nA: {{mass: 1, {kind}, convex decomposition: {{{wrong}}}}}\nB: {{mass: 1}}\n");
            let (model, problems) = read::<Model>(&text);
            assert_eq!((model.bodies.len(), problems.len()), (1, 1), "{wrong}: {problems:?}");
            assert!(problems[0].contains("the body is dropped"), "{}", problems[0]);
        }
    }

    #[test]
    fn unknown_axis_is_z() {
        let (body, problems) = body("collision shape: Capsule, collision geometry: {radius: 1, height: 1, axis: w}");
        assert!(matches!(
            body.collision,
            CollisionGeometry::Primitive { primitive: Primitive::Capsule { axis: Axis::Z, .. }, .. }
        ));
        assert_eq!(problems.len(), 1);
    }
}
