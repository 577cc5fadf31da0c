//! Pictures of the primitive shapes.

use std::f64::consts::TAU;

use nalgebra::{Rotation3, UnitVector3, Vector3};

use super::visual::{VisualMesh, VisualMeshPart};
use crate::adf::{Axis, PlacedPrimitive, Primitive};

/// Segments around an axis, and from pole to pole of a sphere.
const SEGMENTS: usize = 32;

/// Half of the edge of the square that stands for a plane, m.
const HALF_PLANE: f64 = 50.0;

impl VisualMesh {
    /// The picture of a shape in its own frame, as Bullet has it: round shapes about their `axis`, the tip of a cone at
    /// the positive end, a capsule with the caps in its height. A plane is a square of 100 m × 100 m about offset ·
    /// normal, its upper side towards the normal. Round surfaces are 32 flat segments around, whose edges are on the
    /// surface. Material: the default.
    pub fn primitive(primitive: &Primitive) -> VisualMesh {
        let mut part = match *primitive {
            Primitive::Box { size } => cuboid(size / 2.0),
            Primitive::Sphere { radius } => revolved(&[cap(radius, 0.0, -1.0), cap(radius, 0.0, 1.0)].concat()),
            Primitive::Ellipsoid { radii } => ellipsoid(&radii),
            Primitive::Cylinder { radius, height, .. } => {
                let z = height / 2.0;
                let rim = |z, normal| Ring { radius, z, normal };
                let centre = |z, normal| Ring { radius: 0.0, z, normal };
                revolved(
                    &[
                        vec![centre(-z, DOWN), rim(-z, DOWN)],
                        vec![rim(-z, OUT), rim(z, OUT)],
                        vec![rim(z, UP), centre(z, UP)],
                    ]
                    .concat(),
                )
            }
            Primitive::Cone { radius, height, .. } => {
                let z = height / 2.0;
                let length = radius.hypot(height);
                let slope = [height / length, radius / length];
                revolved(&[
                    Ring { radius: 0.0, z: -z, normal: DOWN },
                    Ring { radius, z: -z, normal: DOWN },
                    Ring { radius, z: -z, normal: slope },
                    Ring { radius: 0.0, z, normal: slope },
                ])
            }
            Primitive::Capsule { radius, height, .. } => {
                // Where the caps need more than the height, Bullet computes contacts with this distance of their
                // centres, although the box by which it looks for neighbours is smaller then.
                let z = (height / 2.0 - radius).abs();
                revolved(&[cap(radius, -z, -1.0), cap(radius, z, 1.0)].concat())
            }
            Primitive::Plane { normal, offset } => plane(normal, offset),
        };
        match primitive {
            Primitive::Cylinder { axis, .. } | Primitive::Cone { axis, .. } | Primitive::Capsule { axis, .. } => {
                let turn = |[x, y, z]: [f32; 3]| match axis {
                    Axis::X => [z, x, y],
                    Axis::Y => [y, z, x],
                    Axis::Z => [x, y, z],
                };
                part.positions.iter_mut().chain(&mut part.normals).for_each(|v| *v = turn(*v));
            }
            Primitive::Box { .. }
            | Primitive::Sphere { .. }
            | Primitive::Ellipsoid { .. }
            | Primitive::Plane { .. } => {}
        }
        part.nodes = (0..part.positions.len() as u32).collect();
        VisualMesh { parts: vec![part] }
    }

    /// The picture of several shapes in the body frame, each at its offset.
    pub fn compound(parts: &[PlacedPrimitive]) -> VisualMesh {
        let placed = |part: &PlacedPrimitive| VisualMesh::primitive(&part.primitive).transformed(&part.offset).parts;
        VisualMesh { parts: parts.iter().flat_map(placed).collect() }
    }
}

/// Directions in a half plane through the axis: away from the axis, along it.
const OUT: [f64; 2] = [1.0, 0.0];
const UP: [f64; 2] = [0.0, 1.0];
const DOWN: [f64; 2] = [0.0, -1.0];

/// A circle about z of a surface of revolution.
#[derive(Clone, Copy)]
struct Ring {
    radius: f64,
    z: f64,
    /// Unit normal: away from the axis, along it.
    normal: [f64; 2],
}

/// Half of a sphere about (0, 0, `z`): from the pole to the equator below (`side` −1), from the equator to the pole
/// above (1).
fn cap(radius: f64, z: f64, side: f64) -> Vec<Ring> {
    let steps = SEGMENTS / 2;
    let ring = |step: usize| {
        let (sine, cosine) = (TAU / 4.0 * step as f64 / steps as f64).sin_cos();
        // Exactly on the axis.
        let cosine = if step == steps { 0.0 } else { cosine };
        Ring { radius: radius * cosine, z: z + side * radius * sine, normal: [cosine, side * sine] }
    };
    match side < 0.0 {
        true => (0..=steps).rev().map(ring).collect(),
        false => (0..=steps).map(ring).collect(),
    }
}

/// A ball that is stretched along the axes.
fn ellipsoid(radii: &Vector3<f64>) -> VisualMeshPart {
    let mut part = revolved(&[cap(1.0, 0.0, -1.0), cap(1.0, 0.0, 1.0)].concat());
    for (position, normal) in part.positions.iter_mut().zip(&mut part.normals) {
        let on_ball = Vector3::from(position.map(f64::from));
        *position = on_ball.component_mul(radii).map(|x| x as f32).into();
        *normal = on_ball.component_div(radii).try_normalize(0.0).unwrap_or(on_ball).map(|x| x as f32).into();
    }
    part
}

/// The surface between successive rings, which go upwards where the surface looks outwards. Texture: u around, v along
/// the rings.
fn revolved(rings: &[Ring]) -> VisualMeshPart {
    let mut part = VisualMeshPart::default();
    let columns = SEGMENTS + 1;
    for (row, ring) in rings.iter().enumerate() {
        for column in 0..columns {
            // The last column is the first one, with another u.
            let (sine, cosine) = (TAU * (column % SEGMENTS) as f64 / SEGMENTS as f64).sin_cos();
            let at = |across: f64, along: f64| [(across * cosine) as f32, (across * sine) as f32, along as f32];
            part.positions.push(at(ring.radius, ring.z));
            part.normals.push(at(ring.normal[0], ring.normal[1]));
            part.tex_coords.push([column as f32 / SEGMENTS as f32, row as f32 / (rings.len() - 1) as f32]);
        }
    }
    for (row, pair) in rings.windows(2).enumerate() {
        // An edge: the same circle with another normal.
        if (pair[0].radius, pair[0].z) == (pair[1].radius, pair[1].z) {
            continue;
        }
        for column in 0..SEGMENTS {
            let low = (row * columns + column) as u32;
            let high = low + columns as u32;
            // Where a ring is a point, one of the two triangles has no area.
            if pair[0].radius > 0.0 {
                part.triangles.push([low, low + 1, high + 1]);
            }
            if pair[1].radius > 0.0 {
                part.triangles.push([low, high + 1, high]);
            }
        }
    }
    part
}

/// Corners of a square, counter-clockwise.
const SQUARE: [[f32; 2]; 4] = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];

impl VisualMeshPart {
    /// Adds a rectangle about `centre` with half edges `u` and `v`; its upper side is u × v.
    fn rectangle(&mut self, centre: Vector3<f64>, u: Vector3<f64>, v: Vector3<f64>) {
        let first = self.positions.len() as u32;
        let normal = u.cross(&v).try_normalize(0.0).unwrap_or_else(Vector3::z).cast::<f32>();
        for corner in SQUARE {
            let [s, t] = corner.map(|x| f64::from(2.0 * x - 1.0));
            self.positions.push((centre + u * s + v * t).cast::<f32>().into());
            self.normals.push(normal.into());
            self.tex_coords.push(corner);
        }
        self.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
}

fn cuboid(half: Vector3<f64>) -> VisualMeshPart {
    let mut part = VisualMeshPart::default();
    let [x, y, z] = [Vector3::x() * half.x, Vector3::y() * half.y, Vector3::z() * half.z];
    for (w, u, v) in [(x, y, z), (y, z, x), (z, x, y)] {
        part.rectangle(w, u, v);
        part.rectangle(-w, v, u);
    }
    part
}

fn plane(normal: Vector3<f64>, offset: f64) -> VisualMeshPart {
    let mut part = VisualMeshPart::default();
    let up = UnitVector3::try_new(normal, 0.0).unwrap_or_else(Vector3::z_axis);
    let turn = Rotation3::rotation_between(&Vector3::z(), &up)
        // Upside down: any axis at right angles will do.
        .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), TAU / 2.0));
    part.rectangle(up.into_inner() * offset, turn * Vector3::x() * HALF_PLANE, turn * Vector3::y() * HALF_PLANE);
    part
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;

    fn drawn(primitive: &Primitive) -> VisualMeshPart {
        let part = VisualMesh::primitive(primitive).parts.remove(0);
        let count = part.positions.len();
        assert!(part.normals.len() == count && part.tex_coords.len() == count && part.nodes.len() == count);
        for triangle in &part.triangles {
            let [a, b, c] = triangle.map(|i| Vector3::from(part.positions[i as usize]).cast::<f64>());
            let cross = (b - a).cross(&(c - a));
            assert!(cross.norm() > 0.0, "a triangle without an area");
            for i in triangle {
                let normal = Vector3::from(part.normals[*i as usize]).cast::<f64>();
                assert!((normal.norm() - 1.0).abs() < 1e-6);
                // Smooth normals differ from that of a flat segment by half a segment, or by one at a pole.
                assert!(normal.dot(&cross.normalize()) > 0.99, "{normal:?} against {cross:?}");
            }
        }
        part
    }

    /// Volume inside the triangles, m³.
    fn volume(part: &VisualMeshPart) -> f64 {
        let of = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|i| Vector3::from(part.positions[i as usize]).cast::<f64>());
            a.dot(&b.cross(&c)) / 6.0
        };
        part.triangles.iter().map(of).sum()
    }

    fn extent(part: &VisualMeshPart) -> [f32; 3] {
        let (low, high) = VisualMesh { parts: vec![part.clone()] }.bounds().unwrap();
        std::array::from_fn(|i| {
            assert!((low[i] + high[i]).abs() < 1e-6, "not centred");
            high[i] - low[i]
        })
    }

    fn near(a: [f32; 3], b: [f32; 3]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6)
    }

    #[test]
    fn shapes_are_closed_and_as_large_as_written() {
        // Area of a polygon of 32 corners against that of its circle.
        let around = (TAU / 32.0).sin() * 16.0;
        for (axis, turn) in [(Axis::X, [2, 0, 1]), (Axis::Y, [1, 2, 0]), (Axis::Z, [0, 1, 2])] {
            let turned = |extent: [f32; 3]| turn.map(|i| extent[i]);
            let cylinder = drawn(&Primitive::Cylinder { radius: 0.5, height: 3.0, axis });
            assert!(near(extent(&cylinder), turned([1.0, 1.0, 3.0])), "{axis:?} {:?}", extent(&cylinder));
            assert!((volume(&cylinder) - around * 0.25 * 3.0).abs() < 1e-5);
            let cone = drawn(&Primitive::Cone { radius: 0.5, height: 3.0, axis });
            assert!((volume(&cone) - around * 0.25).abs() < 1e-5);
            let tip = cone.positions.iter().filter(|p| near(**p, turned([0.0, 0.0, 1.5]))).count();
            assert!(tip > 0, "the tip is at the positive end");
            let capsule = drawn(&Primitive::Capsule { radius: 0.5, height: 3.0, axis });
            assert!(near(extent(&capsule), turned([1.0, 1.0, 3.0])), "{:?}", extent(&capsule));
            let exact = std::f64::consts::PI * (0.25 * 2.0 + 4.0 / 3.0 * 0.125);
            assert!((volume(&capsule) / exact - 1.0).abs() < 0.01);
        }
        let sphere = drawn(&Primitive::Sphere { radius: 2.0 });
        assert!(near(extent(&sphere), [4.0; 3]));
        assert_eq!(sphere.triangles.len(), 32 * 31 * 2);
        assert!(sphere.positions.iter().all(|p| (Vector3::from(*p).norm() - 2.0).abs() < 1e-6));
        let radii = Vector3::new(1.0, 1.2, 1.4);
        let ellipsoid = drawn(&Primitive::Ellipsoid { radii });
        let off = |p: &[f32; 3]| (Vector3::from(*p).cast::<f64>().component_div(&radii).norm() - 1.0).abs();
        assert!(ellipsoid.positions.iter().all(|p| off(p) < 1e-6));
        let cuboid = drawn(&Primitive::Box { size: Vector3::new(1.0, 2.0, 3.0) });
        assert!(near(extent(&cuboid), [1.0, 2.0, 3.0]) && (volume(&cuboid) - 6.0).abs() < 1e-6);
    }

    #[test]
    fn a_capsule_shorter_than_its_caps_is_what_collides() {
        // Bullet: two spheres whose centres are |height - 2 radius| apart.
        for (height, expected) in [(0.4, 1.6), (1.0, 1.0)] {
            let part = drawn(&Primitive::Capsule { radius: 0.5, height, axis: Axis::Z });
            assert!(near(extent(&part), [1.0, 1.0, expected]), "{:?}", extent(&part));
        }
    }

    #[test]
    fn a_plane_is_a_square_towards_its_normal() {
        for normal in [[0.0, 0.0, 2.0], [0.0, 0.0, -1.0], [3.0, 0.0, 4.0], [0.0, 1e-9, 0.0]] {
            let normal = Vector3::from(normal);
            let part = drawn(&Primitive::Plane { normal, offset: -2.0 });
            let up = normal.normalize();
            for position in &part.positions {
                let position = Vector3::from(*position).cast::<f64>();
                assert!((position.dot(&up) + 2.0).abs() < 1e-5);
                assert!(((position + 2.0 * up).norm() - 5000f64.sqrt()).abs() < 1e-4);
            }
            assert!((Vector3::from(part.normals[0]).cast() - up).norm() < 1e-6);
        }
    }

    #[test]
    fn parts_of_a_compound_are_at_their_offsets() {
        let primitive = Primitive::Box { size: Vector3::new(1.0, 2.0, 1.0) };
        let turned = Isometry3::new(Vector3::new(5.0, 0.0, 0.0), Vector3::z() * TAU / 4.0);
        let parts =
            [Isometry3::identity(), turned].map(|offset| PlacedPrimitive { primitive: primitive.clone(), offset });
        let mesh = VisualMesh::compound(&parts);
        let (low, high) = mesh.bounds().unwrap();
        assert!(near(low, [-0.5, -1.0, -0.5]) && near(high, [6.0, 1.0, 0.5]), "{low:?} {high:?}");
        assert_eq!(mesh.triangle_count(), 24);
    }
}
