//! Collision geometry of a description → Bullet shape, with the estimates that follow from it.

use nalgebra::{Isometry3, Matrix3, SymmetricEigen, Vector3};

use super::hulls::{hull_remark, CollisionMeshes, HullCache};
use crate::adf::{
    self, CollisionGeometry, CollisionMeshKind, ConvexDecomposition, Part, PartGeometry, Primitive, RigidBody, Severity,
};
use crate::bullet::{Axis, Shape};
use crate::control::Profile;
use crate::mesh::{has_holes, Mesh, SubMesh};

/// Margin of boxes and cylinders in the accurate profile as a share of their least half extent.
const MOST_MARGIN: f64 = 0.5;

/// A collision shape in the inertial frame, and the inertial frame it was made for.
pub(super) struct BuiltShape {
    pub shape: Shape,
    /// Pose of the inertial frame in the body frame.
    pub inertial_offset: Isometry3<f64>,
    /// Parts that had to be left out, one sentence each.
    pub left_out: Vec<(Severity, String)>,
}

/// Makes the collision shape of `body`. `mesh` is its collision mesh, welded and scaled, when the geometry is one;
/// `meshes` gives those of its parts, when it has several.
pub(super) fn build(body: &RigidBody, mesh: Option<&Mesh>, meshes: &CollisionMeshes, profile: Profile) -> BuiltShape {
    let inertial_offset = body.inertial_offset.unwrap_or_else(|| match mesh {
        Some(mesh) => Isometry3::from(estimated_centre(mesh, profile)),
        None => Isometry3::identity(),
    });
    let mut left_out = Vec::new();
    let margin = Margin { length: body.collision_margin, profile, is_moved: body.mass != 0.0 };
    let shape = geometry(&body.collision, margin, mesh, meshes, &inertial_offset, &mut left_out);
    BuiltShape { shape, inertial_offset, left_out }
}

/// Collision margin of the shapes of an object.
#[derive(Clone, Copy)]
pub(super) struct Margin {
    /// What the file says, m.
    pub length: f64,
    pub profile: Profile,
    /// It is that of a body with a mass.
    pub is_moved: bool,
}

/// Margin of a part of the mesh of a body that moves, as a share of its least extent, in the accurate profile. Bullet adds it
/// around the part, and so closes holes by twice of it.
const MOST_MESH_MARGIN: f64 = 0.02;

/// Least extent of a part, as a share of its largest one, below which it is a sheet: its margin is what makes it thick.
const SHEET: f64 = 0.01;

impl Margin {
    /// Margin of a primitive, m. Bullet makes boxes and cylinders smaller by their margin before it adds it around them:
    /// those that are thinner than two margins turn inside out. In the accurate profile their margin is at most
    /// [`MOST_MARGIN`] times their least half extent.
    fn of(self, primitive: &Primitive) -> f64 {
        let least = match (self.profile, primitive) {
            (Profile::Accurate, Primitive::Box { size }) => size.min() / 2.0,
            (Profile::Accurate, Primitive::Cylinder { radius, height, .. }) => radius.min(height / 2.0),
            _ => f64::INFINITY,
        };
        self.length.min(MOST_MARGIN * least)
    }

    /// Margin of a part of a mesh, m.
    fn of_part(self, vertices: &[[f64; 3]], kind: CollisionMeshKind) -> f64 {
        let is_ours = self.profile == Profile::Accurate || matches!(kind, CollisionMeshKind::ConvexParts(_));
        if !is_ours || !self.is_moved {
            return self.length;
        }
        let (least, largest) = extents(vertices);
        if least > SHEET * largest {
            self.length.min(MOST_MESH_MARGIN * least)
        } else {
            self.length
        }
    }
}

/// Least and largest extent of a part along the axes of its mesh and the principal axes of its vertices, m: those of a wall do not
/// depend on how it is turned.
fn extents(vertices: &[[f64; 3]]) -> (f64, f64) {
    let points = || vertices.iter().map(|vertex| Vector3::from(*vertex));
    let mean = points().sum::<Vector3<f64>>() / vertices.len().max(1) as f64;
    let scatter = points().map(|point| (point - mean) * (point - mean).transpose()).sum::<Matrix3<f64>>();
    let along = |axis: Vector3<f64>| {
        let places = || points().map(|point| axis.dot(&point));
        places().fold(f64::NEG_INFINITY, f64::max) - places().fold(f64::INFINITY, f64::min)
    };
    let (mut least, mut largest) = (f64::INFINITY, 0.0_f64);
    let principal = SymmetricEigen::try_new(scatter, f64::EPSILON, 100).map(|eigen| eigen.eigenvectors);
    for axis in std::iter::once(Matrix3::identity())
        .chain(principal)
        .flat_map(|axes| [0, 1, 2].map(|i| axes.column(i).into_owned()))
    {
        least = least.min(along(axis));
        largest = largest.max(along(axis));
    }
    (least, largest)
}

/// The shape of a collision geometry in a frame at `origin` in the body frame; a single primitive without an offset is
/// centred there.
pub(super) fn geometry(
    collision: &CollisionGeometry,
    margin: Margin,
    mesh: Option<&Mesh>,
    meshes: &CollisionMeshes,
    origin: &Isometry3<f64>,
    left_out: &mut Vec<(Severity, String)>,
) -> Shape {
    let to_origin = origin.inverse();
    match collision {
        CollisionGeometry::None => Shape::empty(),
        CollisionGeometry::Primitive { primitive: Primitive::Plane { normal, offset }, .. } => {
            Shape::plane(*normal, *offset, margin.length)
        }
        CollisionGeometry::Primitive { primitive: p, offset } => {
            let pose = to_origin * offset.unwrap_or(*origin);
            Shape::compound([(primitive(p, margin), pose)])
        }
        CollisionGeometry::Compound(parts) => {
            Shape::compound(parts.iter().map(|part| (primitive(&part.primitive, margin), to_origin * part.offset)))
        }
        CollisionGeometry::Mesh { kind, .. } => match mesh {
            Some(mesh) => compound(mesh_children(mesh, *kind, &meshes.hulls, margin, &to_origin, left_out)),
            None => Shape::empty(),
        },
        CollisionGeometry::Parts { parts, kind } => {
            let children = |part| part_children(part, *kind, margin, &to_origin, meshes, left_out);
            compound(parts.iter().flat_map(children).collect())
        }
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

fn primitive(primitive: &Primitive, margin: Margin) -> Shape {
    let margin = margin.of(primitive);
    match *primitive {
        Primitive::Box { size } => Shape::cuboid(size / 2.0, margin),
        Primitive::Sphere { radius } => Shape::sphere(radius, margin),
        Primitive::Ellipsoid { radii } => ellipsoid(&radii, margin),
        Primitive::Cylinder { radius, height, axis: a } => Shape::cylinder(axis(a), radius, height, margin),
        // ADF gives the total height, Bullet wants the part between the caps.
        Primitive::Capsule { radius, height, axis: a } => {
            Shape::capsule(axis(a), radius, height - 2.0 * radius, margin)
        }
        Primitive::Cone { radius, height, axis: a } => Shape::cone(axis(a), radius, height, margin),
        Primitive::Plane { normal, offset } => Shape::plane(normal, offset, margin),
    }
}

/// Corners of the hull that stands for an ellipsoid, along each of two sets of circles.
const ELLIPSOID_CIRCLES: usize = 12;

/// Bullet's balls cannot be stretched: a hull of points on the surface, which is at most 3 % of the radii inside of it.
fn ellipsoid(radii: &Vector3<f64>, margin: f64) -> Shape {
    use std::f64::consts::PI;
    let step = PI / ELLIPSOID_CIRCLES as f64;
    let poles = [Vector3::z(), -Vector3::z()].into_iter();
    let circles = (1..ELLIPSOID_CIRCLES).flat_map(|row| {
        let (ring, z) = (row as f64 * step).sin_cos();
        (0..2 * ELLIPSOID_CIRCLES).map(move |column| {
            let (sine, cosine) = (column as f64 * step).sin_cos();
            Vector3::new(ring * cosine, ring * sine, z)
        })
    });
    let points: Vec<[f64; 3]> = poles.chain(circles).map(|point| point.component_mul(radii).into()).collect();
    Shape::convex_part(&points, margin.min(MOST_MESH_MARGIN * radii.min()))
}

fn compound(children: Vec<(Shape, Isometry3<f64>)>) -> Shape {
    if children.is_empty() {
        Shape::empty()
    } else {
        Shape::compound(children)
    }
}

fn part_children(
    part: &Part,
    kind: CollisionMeshKind,
    margin: Margin,
    body_in_inertial: &Isometry3<f64>,
    meshes: &CollisionMeshes,
    left_out: &mut Vec<(Severity, String)>,
) -> Vec<(Shape, Isometry3<f64>)> {
    let pose = body_in_inertial * part.offset;
    match &part.geometry {
        PartGeometry::Primitive(p) => vec![(primitive(p, margin), pose)],
        PartGeometry::Triangles(mesh) => mesh_children(mesh, kind, &meshes.hulls, margin, &pose, left_out),
        PartGeometry::Mesh { path, scale } => match meshes.files.get(path, 1.0) {
            Ok(mesh) => {
                let mesh = mesh.scaled_along((*scale).into());
                if mesh.sub_meshes.iter().flat_map(|sub| sub.vertices.as_flattened()).all(|x| x.is_finite()) {
                    return mesh_children(&mesh, kind, &meshes.hulls, margin, &pose, left_out);
                }
                let message = format!("{}: too large for its numbers when scaled; it is left out", path.display());
                left_out.push((Severity::Error, message));
                vec![]
            }
            Err(error) => {
                left_out.push((Severity::Error, format!("a collision mesh is left out: {error}")));
                vec![]
            }
        },
    }
}

fn mesh_children(
    mesh: &Mesh,
    kind: CollisionMeshKind,
    hulls: &HullCache,
    margin: Margin,
    pose: &Isometry3<f64>,
    left_out: &mut Vec<(Severity, String)>,
) -> Vec<(Shape, Isometry3<f64>)> {
    let mut children = Vec::new();
    let mut empty = Vec::new();
    let mut divided = 0;
    for (number, sub) in mesh.sub_meshes.iter().enumerate() {
        let whole = margin.of_part(&sub.vertices, kind);
        let divide = |children: &mut Vec<(Shape, Isometry3<f64>)>, sub: &SubMesh, parameters: &ConvexDecomposition| {
            let parts = hulls.hulls_of(sub, parameters);
            let part = |hull: &Vec<[f64; 3]>| (Shape::convex_part(hull, margin.of_part(hull, kind)), *pose);
            children.extend(parts.iter().map(part));
            parts.len()
        };
        let child = match kind {
            CollisionMeshKind::ConvexDecomposition(parameters) => {
                if divide(&mut children, sub, &parameters) == 0 {
                    empty.push(number);
                }
                continue;
            }
            CollisionMeshKind::ConvexHull | CollisionMeshKind::ConvexParts(_) => {
                let is_ours = margin.profile == Profile::Accurate || kind != CollisionMeshKind::ConvexHull;
                let solids = if is_ours { sub.solids() } else { Vec::new() };
                for solid in &solids {
                    match kind {
                        CollisionMeshKind::ConvexParts(parameters) if has_holes(solid) => {
                            divided += divide(&mut children, &sub.of(solid), &parameters);
                        }
                        _ => {
                            let vertices = sub.of(solid).vertices;
                            let margin = margin.of_part(&vertices, kind);
                            children.push((Shape::convex_part(&vertices, margin), *pose));
                        }
                    }
                }
                match kind {
                    _ if !solids.is_empty() => continue,
                    CollisionMeshKind::ConvexParts(parameters) if has_holes(&sub.triangles) => {
                        divided += divide(&mut children, sub, &parameters);
                        continue;
                    }
                    _ => (),
                }
                if margin.is_moved {
                    left_out.extend(hull_remark(sub).map(|remark| (Severity::Info, remark)));
                }
                (sub.vertices.len() >= 3).then(|| Shape::convex_hull(&sub.vertices, whole))
            }
            CollisionMeshKind::ConvexMesh => Shape::convex_triangle_mesh(&sub.vertices, &sub.triangles, whole),
            CollisionMeshKind::ConcaveMesh => Shape::concave_mesh(&sub.vertices, &sub.triangles, whole),
            CollisionMeshKind::PointCloud => {
                let radius = margin.length;
                let sphere =
                    |&[x, y, z]: &[f64; 3]| (Shape::sphere(radius, radius), pose * Isometry3::translation(x, y, z));
                children.extend(sub.vertices.iter().map(sphere));
                continue;
            }
        };
        match child {
            Some(child) => children.push((child, *pose)),
            None => empty.push(number),
        }
    }
    left_out.extend(hulls.take_remarks());
    if divided > 0 {
        let message =
            format!("its collision mesh has holes, which one convex hull would close: it collides as {divided} hulls");
        left_out.push((Severity::Info, message));
    }
    match empty[..] {
        [] => (),
        [number] => {
            let message = format!("part {number} of the collision mesh has no surface and is left out");
            left_out.push((Severity::Warning, message));
        }
        [first, ..] => {
            let count = empty.len();
            let message =
                format!("{count} parts of the collision mesh, {first} first, have no surface and are left out");
            left_out.push((Severity::Warning, message));
        }
    }
    children
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adf::PlacedPrimitive;
    use crate::mesh::VisualMesh;

    /// What is drawn of `drawn` fills the box around what collides of `shape`, whose margin is `margin`.
    fn check_congruent(shape: &Shape, drawn: &VisualMesh, margin: f64, what: &str) {
        let (least, most) = shape.bounds();
        let (low, high) = drawn.bounds().expect("a picture");
        for i in 0..3 {
            // Bullet's boxes have the margin once or twice around them; circles are drawn with 32 corners.
            let slack = 2.5 * margin + 0.006 * (most[i] - least[i]);
            let (low, high) = (f64::from(low[i]), f64::from(high[i]));
            let congruent =
                low - least[i] < slack && most[i] - high < slack && least[i] - low < 1e-6 && high - most[i] < 1e-6;
            assert!(congruent, "{what}, axis {i}: drawn {low} to {high}, collides {} to {}", least[i], most[i]);
        }
    }

    #[test]
    fn what_is_drawn_is_what_collides() {
        let margin = 1e-4;
        let mut parts = Vec::new();
        for axis in [adf::Axis::X, adf::Axis::Y, adf::Axis::Z] {
            for p in [
                Primitive::Box { size: Vector3::new(0.2, 0.4, 0.8) },
                Primitive::Sphere { radius: 0.3 },
                Primitive::Ellipsoid { radii: Vector3::new(0.1, 0.2, 0.4) },
                Primitive::Cylinder { radius: 0.2, height: 1.0, axis },
                Primitive::Capsule { radius: 0.2, height: 1.0, axis },
                Primitive::Cone { radius: 0.2, height: 1.0, axis },
            ] {
                let shape = primitive(&p, Margin { length: margin, profile: Profile::Legacy, is_moved: true });
                // Bullet's box around a hull has its default margin of 4 cm.
                let around = if matches!(p, Primitive::Ellipsoid { .. }) { 0.04 + margin } else { margin };
                check_congruent(&shape, &VisualMesh::primitive(&p), around, &format!("{p:?}"));
                let offset = Isometry3::translation(parts.len() as f64, -0.5, 2.0);
                parts.push(PlacedPrimitive { primitive: p, offset });
            }
        }
        let drawn = VisualMesh::compound(&parts);
        let geometry_of = |parts| {
            let compound = CollisionGeometry::Compound(parts);
            let margin = Margin { length: margin, profile: Profile::Legacy, is_moved: true };
            geometry(&compound, margin, None, &CollisionMeshes::new(), &Isometry3::identity(), &mut Vec::new())
        };
        check_congruent(&geometry_of(parts), &drawn, margin, "compound");
    }

    #[test]
    fn the_margin_of_a_wall_does_not_depend_on_how_it_is_turned() {
        let margin = |turn: f64, scale: f64| {
            let turn = nalgebra::Rotation3::from_euler_angles(0.3 * turn, 0.5 * turn, turn);
            let corner = |i: u32| {
                let at = |bit: u32, half: f64| if i >> bit & 1 == 1 { half } else { -half };
                (turn * Vector3::new(at(0, 0.0005), at(1, 0.007), at(2, 0.0075)) * scale).into()
            };
            let vertices: Vec<[f64; 3]> = (0..8).map(corner).collect();
            Margin { length: 0.001, profile: Profile::Accurate, is_moved: true }
                .of_part(&vertices, CollisionMeshKind::ConvexHull)
        };
        for turn in [0.0, 0.4, 1.1] {
            assert!((margin(turn, 1.0) - 2e-5).abs() < 1e-12, "{turn}: {}", margin(turn, 1.0));
        }
        assert_eq!(margin(0.4, f64::NAN), 0.001);
    }

    #[test]
    fn thin_primitives_have_thin_margins_in_the_accurate_profile() {
        let margin = |profile, primitive: &Primitive| Margin { length: 0.001, profile, is_moved: true }.of(primitive);
        let thin = Primitive::Box { size: Vector3::new(0.1, 0.2, 0.0004) };
        let disc = Primitive::Cylinder { radius: 0.01, height: 0.0004, axis: adf::Axis::X };
        let thick = Primitive::Box { size: Vector3::new(0.1, 0.2, 0.004) };
        let ball = Primitive::Sphere { radius: 0.0002 };
        for (primitive, expected) in [(&thin, 1e-4), (&disc, 1e-4), (&thick, 1e-3), (&ball, 1e-3)] {
            assert!((margin(Profile::Accurate, primitive) - expected).abs() < 1e-18, "{primitive:?}");
            assert_eq!(margin(Profile::Legacy, primitive), 0.001, "{primitive:?}");
        }
    }
}
