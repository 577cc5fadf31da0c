//! Collision geometry of a description → Bullet shape, with the estimates that follow from it.

use nalgebra::{Isometry3, Vector3};

use crate::adf::{self, CollisionGeometry, CollisionMeshKind, Primitive, RigidBody};
use crate::bullet::{Axis, Shape};
use crate::control::Profile;
use crate::mesh::Mesh;

/// A collision shape in the inertial frame, and the inertial frame it was made for.
pub(super) struct BuiltShape {
    pub shape: Shape,
    /// Pose of the inertial frame in the body frame.
    pub inertial_offset: Isometry3<f64>,
    /// Parts that had to be left out, one sentence each.
    pub left_out: Vec<String>,
}

/// Makes the collision shape of `body`. `mesh` is its collision mesh, welded and scaled, when the geometry is one.
pub(super) fn build(body: &RigidBody, mesh: Option<&Mesh>, profile: Profile) -> BuiltShape {
    let inertial_offset = body.inertial_offset.unwrap_or_else(|| match mesh {
        Some(mesh) => Isometry3::from(estimated_centre(mesh, profile)),
        None => Isometry3::identity(),
    });
    let mut left_out = Vec::new();
    let shape = geometry(&body.collision, body.collision_margin, mesh, &inertial_offset, &mut left_out);
    BuiltShape { shape, inertial_offset, left_out }
}

/// The shape of a collision geometry in a frame at `origin` in the body frame; a single primitive without an offset is centred there.
pub(super) fn geometry(
    collision: &CollisionGeometry,
    margin: f64,
    mesh: Option<&Mesh>,
    origin: &Isometry3<f64>,
    left_out: &mut Vec<String>,
) -> Shape {
    let to_origin = origin.inverse();
    match collision {
        CollisionGeometry::None => Shape::empty(),
        CollisionGeometry::Primitive { primitive: Primitive::Plane { normal, offset }, .. } => {
            Shape::plane(*normal, *offset, margin)
        }
        CollisionGeometry::Primitive { primitive: p, offset } => {
            let pose = to_origin * offset.unwrap_or(*origin);
            Shape::compound([(primitive(p, margin), pose)])
        }
        CollisionGeometry::Compound(parts) => {
            Shape::compound(parts.iter().map(|part| (primitive(&part.primitive, margin), to_origin * part.offset)))
        }
        CollisionGeometry::Mesh { kind, .. } => match mesh {
            Some(mesh) => mesh_shape(mesh, *kind, margin, &to_origin, left_out),
            None => Shape::empty(),
        },
    }
}

/// Estimate of the centre of mass of a mesh without a written one: the mean of its vertices.
///
/// The C++ program adds the mean of the *first* sub-mesh once for each sub-mesh; the legacy profile does the same.
fn estimated_centre(mesh: &Mesh, profile: Profile) -> Vector3<f64> {
    let mean = |vertices: &mut dyn Iterator<Item = &[f64; 3]>| {
        let (sum, n) = vertices.fold((Vector3::zeros(), 0u32), |(sum, n), v| (sum + Vector3::from(*v), n + 1));
        if n == 0 {
            Vector3::zeros()
        } else {
            sum / f64::from(n)
        }
    };
    match profile {
        Profile::Legacy => {
            let first = mesh.sub_meshes.first().map_or_else(Vector3::zeros, |sub| mean(&mut sub.vertices.iter()));
            first * mesh.sub_meshes.len() as f64
        }
        Profile::Accurate => mean(&mut mesh.sub_meshes.iter().flat_map(|sub| &sub.vertices)),
    }
}

fn axis(axis: adf::Axis) -> Axis {
    match axis {
        adf::Axis::X => Axis::X,
        adf::Axis::Y => Axis::Y,
        adf::Axis::Z => Axis::Z,
    }
}

fn primitive(primitive: &Primitive, margin: f64) -> Shape {
    match *primitive {
        Primitive::Box { size } => Shape::cuboid(size / 2.0, margin),
        Primitive::Sphere { radius } => Shape::sphere(radius, margin),
        Primitive::Cylinder { radius, height, axis: a } => Shape::cylinder(axis(a), radius, height, margin),
        // ADF gives the total height, Bullet wants the part between the caps.
        Primitive::Capsule { radius, height, axis: a } => {
            Shape::capsule(axis(a), radius, height - 2.0 * radius, margin)
        }
        Primitive::Cone { radius, height, axis: a } => Shape::cone(axis(a), radius, height, margin),
        Primitive::Plane { normal, offset } => Shape::plane(normal, offset, margin),
    }
}

fn mesh_shape(
    mesh: &Mesh,
    kind: CollisionMeshKind,
    margin: f64,
    pose: &Isometry3<f64>,
    left_out: &mut Vec<String>,
) -> Shape {
    let mut children = Vec::new();
    for (number, sub) in mesh.sub_meshes.iter().enumerate() {
        let child = match kind {
            CollisionMeshKind::ConvexHull => {
                (sub.vertices.len() >= 3).then(|| Shape::convex_hull(&sub.vertices, margin))
            }
            CollisionMeshKind::ConvexMesh => Shape::convex_triangle_mesh(&sub.vertices, &sub.triangles, margin),
            CollisionMeshKind::ConcaveMesh => Shape::concave_mesh(&sub.vertices, &sub.triangles, margin),
            CollisionMeshKind::PointCloud => {
                let spheres = sub
                    .vertices
                    .iter()
                    .map(|&[x, y, z]| (Shape::sphere(margin, margin), pose * Isometry3::translation(x, y, z)));
                children.extend(spheres);
                continue;
            }
        };
        match child {
            Some(child) => children.push((child, *pose)),
            None => left_out.push(format!("part {number} of the collision mesh has no surface and is left out")),
        }
    }
    if children.is_empty() {
        Shape::empty()
    } else {
        Shape::compound(children)
    }
}
