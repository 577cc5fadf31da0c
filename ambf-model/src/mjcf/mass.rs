//! Masses and moments of inertia: of shapes, and of bodies made of them.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use crate::adf::Primitive;
use crate::inertia::diagonalised;

/// Mass, centre of mass and inertia about it, in the axes of some frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Mass {
    /// kg, not negative.
    pub mass: f64,
    /// m.
    pub centre: Vector3<f64>,
    /// kg·m².
    pub inertia: Matrix3<f64>,
}

impl Mass {
    /// The same in another frame, in which the present one is at a pose.
    pub fn placed(&self, pose: &Isometry3<f64>) -> Self {
        let turn = pose.rotation.to_rotation_matrix();
        let inertia = turn.matrix() * self.inertia * turn.matrix().transpose();
        Self { mass: self.mass, centre: (pose * Point3::from(self.centre)).coords, inertia }
    }

    /// Of several together.
    pub fn sum(parts: &[Self]) -> Self {
        let mass: f64 = parts.iter().map(|part| part.mass).sum();
        if mass <= 0.0 {
            return Self::default();
        }
        let centre = parts.iter().map(|part| part.centre * (part.mass / mass)).sum::<Vector3<f64>>();
        let about = |part: &Self| {
            let apart = part.centre - centre;
            part.inertia
                + (Matrix3::from_diagonal_element(apart.norm_squared()) - apart * apart.transpose()) * part.mass
        };
        Self { mass, centre, inertia: parts.iter().map(about).sum() }
    }

    /// As many times as heavy.
    pub fn times(&self, factor: f64) -> Self {
        Self { mass: self.mass * factor, centre: self.centre, inertia: self.inertia * factor }
    }

    /// Principal moments, and the pose of their axes at the centre of mass.
    pub fn principal(&self) -> (Vector3<f64>, Isometry3<f64>) {
        let (moments, axes) = diagonalised(self.inertia);
        (moments, Isometry3::from_parts(self.centre.into(), axes.into()))
    }
}

/// Volume, m³, and the inertia of a solid primitive of density 1, in its own frame. `None`: a plane.
pub(super) fn solid(primitive: &Primitive) -> Option<Mass> {
    use std::f64::consts::PI;
    // Volume, and moments over mass.
    let (volume, moments) = match *primitive {
        Primitive::Box { size } => {
            let [x, y, z] = size.map(|edge| edge * edge / 12.0).into();
            (size.product(), Vector3::new(y + z, x + z, x + y))
        }
        Primitive::Sphere { radius } => (4.0 / 3.0 * PI * radius.powi(3), Vector3::repeat(0.4 * radius * radius)),
        Primitive::Ellipsoid { radii } => {
            let [x, y, z] = radii.map(|radius| radius * radius / 5.0).into();
            (4.0 / 3.0 * PI * radii.product(), Vector3::new(y + z, x + z, x + y))
        }
        Primitive::Cylinder { radius: r, height, .. } => {
            let across = (3.0 * r * r + height * height) / 12.0;
            (PI * r * r * height, Vector3::new(across, across, r * r / 2.0))
        }
        Primitive::Capsule { radius: r, height, .. } => {
            let between = height - 2.0 * r;
            let (cylinder, ball) = (PI * r * r * between, 4.0 / 3.0 * PI * r.powi(3));
            // Half balls, whose centres of mass are 3/8 of the radius above their discs.
            let across = cylinder * (3.0 * r * r + between * between) / 12.0
                + ball * (0.4 * r * r + between * between / 4.0 + 3.0 / 8.0 * r * between);
            let along = cylinder * r * r / 2.0 + ball * 0.4 * r * r;
            let volume = cylinder + ball;
            (volume, Vector3::new(across, across, along) / volume)
        }
        Primitive::Cone { .. } | Primitive::Plane { .. } => return None,
    };
    Some(Mass { mass: volume, centre: Vector3::zeros(), inertia: Matrix3::from_diagonal(&(moments * volume)) })
}

/// Area, m², and the inertia of the surface of a primitive with 1 kg/m², in its own frame. `None`: a plane. As in MuJoCo, the area of an
/// ellipsoid is that of Knud Thomsen's formula, and its surface a layer of a micrometre.
pub(super) fn shell(primitive: &Primitive) -> Option<Mass> {
    use std::f64::consts::PI;
    let (area, moments) = match *primitive {
        Primitive::Box { size } => {
            let [x, y, z] = size.map(|edge| edge * edge / 12.0).into();
            // Two faces each, with their normal along x, y and z: they are half an edge from the middle.
            let faces = 2.0 * Vector3::new(size.y * size.z, size.x * size.z, size.x * size.y);
            let squares = |own: f64, normal: usize| own * (faces.sum() + 2.0 * faces[normal]);
            let [x, y, z] = [squares(x, 0), squares(y, 1), squares(z, 2)];
            (faces.sum(), Vector3::new(y + z, x + z, x + y))
        }
        Primitive::Sphere { radius } => {
            let area = 4.0 * PI * radius * radius;
            (area, Vector3::repeat(2.0 / 3.0 * area * radius * radius))
        }
        Primitive::Ellipsoid { radii } => {
            const POWER: f64 = 1.6075;
            const LAYER: f64 = 1e-6;
            let [a, b, c] = radii.map(|radius| radius.powf(POWER)).into();
            let area = 4.0 * PI * ((a * b + a * c + b * c) / 3.0).powf(POWER.recip());
            let solid = |radii| solid(&Primitive::Ellipsoid { radii });
            let (outer, inner) = (solid(radii.add_scalar(LAYER))?, solid(radii)?);
            let layer = (outer.inertia - inner.inertia) / (outer.mass - inner.mass);
            (area, layer.diagonal() * area)
        }
        Primitive::Cylinder { radius: r, height, .. } => {
            let (side, ends) = (2.0 * PI * r * height, 2.0 * PI * r * r);
            let across = side * (6.0 * r * r + height * height) / 12.0 + ends * (r * r + height * height) / 4.0;
            (side + ends, Vector3::new(across, across, (side + ends / 2.0) * r * r))
        }
        Primitive::Capsule { radius: r, height, .. } => {
            let between = height - 2.0 * r;
            let (side, ends) = (2.0 * PI * r * between, 4.0 * PI * r * r);
            // Half spheres, whose centres of mass are half of the radius above their rims.
            let across = side * (6.0 * r * r + between * between) / 12.0
                + ends * (2.0 / 3.0 * r * r + between * between / 4.0 + between * r / 2.0);
            (side + ends, Vector3::new(across, across, (side + 2.0 / 3.0 * ends) * r * r))
        }
        Primitive::Cone { .. } | Primitive::Plane { .. } => return None,
    };
    Some(Mass { mass: area, centre: Vector3::zeros(), inertia: Matrix3::from_diagonal(&moments) })
}

/// What of a mesh weighs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MeshMass {
    /// That which closed surfaces enclose: pyramids over triangles that look to the inside count negative.
    Exact,
    /// All pyramids count positive, as in MuJoCo where a mesh says nothing else: the same for convex meshes, more for others.
    Legacy,
    /// The convex hull.
    Convex,
    /// The surface.
    Shell,
}

fn area([a, b, c]: &[Vector3<f64>; 3]) -> f64 {
    (b - a).cross(&(c - a)).norm() / 2.0
}

/// Area, m², and inertia of the surface of a mesh with 1 kg/m².
fn of_surface<'a>(triangles: impl Iterator<Item = [Vector3<f64>; 3]> + Clone + 'a) -> Mass {
    let mass: f64 = triangles.clone().map(|triangle| area(&triangle)).sum();
    if mass <= 0.0 {
        return Mass::default();
    }
    let part = |triangle: &[Vector3<f64>; 3]| triangle.iter().sum::<Vector3<f64>>() * (area(triangle) / (3.0 * mass));
    let centre = triangles.clone().map(|triangle| part(&triangle)).sum::<Vector3<f64>>();
    let second = triangles.map(|triangle| {
        let corners = triangle.map(|corner| corner - centre);
        squares(&corners) * (area(&triangle) / 12.0)
    });
    let second = second.sum::<Matrix3<f64>>();
    Mass { mass, centre, inertia: Matrix3::from_diagonal_element(second.trace()) - second }
}

/// Σ x xᵀ of the corners of a triangle and of their sum: of a triangle 12 times the second moment about the origin over the area, of a
/// pyramid with its top there 20 times that over the volume.
fn squares(corners: &[Vector3<f64>; 3]) -> Matrix3<f64> {
    let sum = corners[0] + corners[1] + corners[2];
    corners.iter().map(|corner| corner * corner.transpose()).sum::<Matrix3<f64>>() + sum * sum.transpose()
}

/// Mass and inertia of a mesh of density 1; of the triangles of its hull where that weighs.
pub(super) fn of_mesh<'a>(triangles: impl Iterator<Item = [Vector3<f64>; 3]> + Clone + 'a, kind: MeshMass) -> Mass {
    match kind {
        MeshMass::Exact | MeshMass::Convex => of_volume(triangles, |volume| volume),
        MeshMass::Legacy => of_volume(triangles, f64::abs),
        MeshMass::Shell => of_surface(triangles),
    }
}

/// Volume, m³, and inertia of a mesh of density 1: the sum of pyramids over its triangles, each with the volume that `count` makes of its
/// own, which is negative where the triangle looks to the inside.
fn of_volume<'a>(triangles: impl Iterator<Item = [Vector3<f64>; 3]> + Clone + 'a, count: fn(f64) -> f64) -> Mass {
    let middle = |[a, b, c]: &[Vector3<f64>; 3]| (a + b + c) / 3.0;
    let surface: f64 = triangles.clone().map(|triangle| area(&triangle)).sum();
    if surface <= 0.0 {
        return Mass::default();
    }
    let top = triangles.clone().map(|triangle| middle(&triangle) * (area(&triangle) / surface)).sum::<Vector3<f64>>();
    let volume_below = move |top: &Vector3<f64>, [a, b, c]: &[Vector3<f64>; 3]| {
        count((a - top).dot(&(b - top).cross(&(c - top))) / 6.0)
    };
    let (mut volume, mut moment) = (0.0, Vector3::zeros());
    for triangle in triangles.clone() {
        let pyramid = volume_below(&top, &triangle);
        volume += pyramid;
        moment += (middle(&triangle) * 0.75 + top * 0.25) * pyramid;
    }
    if volume.abs() <= f64::MIN_POSITIVE {
        return Mass::default();
    }
    let centre = moment / volume;
    // Second moments ∫ x xᵀ dV of pyramids with their top at the centre of mass.
    let (mut whole, mut second) = (0.0, Matrix3::zeros());
    for triangle in triangles {
        let pyramid = volume_below(&centre, &triangle);
        // MuJoCo takes the volume about the centre of mass; where pyramids count positive it is another one.
        whole += pyramid;
        let corners = triangle.map(|corner| corner - centre);
        second += squares(&corners) * (pyramid / 20.0);
    }
    let inertia = Matrix3::from_diagonal_element(second.trace()) - second;
    // Surfaces that look inwards all over.
    let sign = whole.signum();
    Mass { mass: whole * sign, centre, inertia: inertia * sign }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adf::Axis;
    use crate::mesh::VisualMesh;

    fn of_drawn(primitive: &Primitive) -> Mass {
        let mesh = VisualMesh::primitive(primitive);
        let part = &mesh.parts[0];
        let corner = |index: u32| Vector3::from(part.positions[index as usize].map(f64::from));
        of_mesh(part.triangles.iter().map(|triangle| triangle.map(corner)), MeshMass::Exact)
    }

    #[test]
    fn primitives_are_as_their_meshes() {
        let axis = Axis::Z;
        for primitive in [
            Primitive::Box { size: Vector3::new(1.0, 2.0, 3.0) },
            Primitive::Sphere { radius: 2.0 },
            Primitive::Ellipsoid { radii: Vector3::new(1.0, 2.0, 3.0) },
            Primitive::Cylinder { radius: 1.0, height: 3.0, axis },
            Primitive::Capsule { radius: 1.0, height: 5.0, axis },
        ] {
            let (exact, mesh) = (solid(&primitive).expect("a solid"), of_drawn(&primitive));
            // Round shapes are drawn with 32 corners.
            assert!((exact.mass / mesh.mass - 1.0).abs() < 0.02, "{primitive:?}: {} and {}", exact.mass, mesh.mass);
            let off = (exact.inertia - mesh.inertia).amax() / exact.inertia.amax();
            assert!(off < 0.03, "{primitive:?}: {} and {}", exact.inertia, mesh.inertia);
        }
    }

    #[test]
    fn a_mesh_anywhere_has_the_inertia_of_its_shape() {
        let pose = Isometry3::new(Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.3, 0.2, -1.0));
        let size = Vector3::new(1.0, 2.0, 3.0);
        let mesh = VisualMesh::primitive(&Primitive::Box { size });
        let part = &mesh.parts[0];
        let corner = |index: u32| (pose * Point3::from(part.positions[index as usize].map(f64::from))).coords;
        for kind in [MeshMass::Exact, MeshMass::Legacy] {
            let found = of_mesh(part.triangles.iter().map(|triangle| triangle.map(corner)), kind);
            let expected = solid(&Primitive::Box { size }).expect("a solid").placed(&pose);
            assert!((found.mass - 6.0).abs() < 1e-12 && (found.centre - expected.centre).norm() < 1e-12);
            assert!((found.inertia - expected.inertia).amax() < 1e-11, "{} {}", found.inertia, expected.inertia);
        }
    }

    /// Numbers of MuJoCo 4.0.0, of geoms of these sizes with `shellinertia`.
    #[test]
    fn surfaces_of_primitives() {
        let axis = Axis::Z;
        for (primitive, area, moments) in [
            (Primitive::Sphere { radius: 0.2 }, 0.5026548245743669, [0.013404128655316452; 3]),
            (
                Primitive::Box { size: Vector3::new(0.2, 0.4, 0.6) },
                0.88,
                [0.05413333333333333, 0.04213333333333334, 0.02426666666666667],
            ),
            (
                Primitive::Cylinder { radius: 0.1, height: 0.6, axis },
                0.439822971502571,
                [0.019006635554218246, 0.019006635554218246, 0.004084070449666732],
            ),
            (
                Primitive::Capsule { radius: 0.1, height: 0.8, axis },
                0.5026548245743669,
                [0.029112091923265415, 0.029112091923265415, 0.004607669225265],
            ),
            (
                Primitive::Ellipsoid { radii: Vector3::new(0.1, 0.2, 0.3) },
                0.4897193333371731,
                [0.01807517488259691, 0.01406836657633903, 0.0081026809368268],
            ),
        ] {
            let found = shell(&primitive).expect("a surface");
            let expected = Matrix3::from_diagonal(&Vector3::from(moments));
            assert!((found.mass - area).abs() < 1e-14, "{primitive:?}: {}", found.mass);
            assert!((found.inertia - expected).amax() < 1e-12, "{primitive:?}: {}", found.inertia);
        }
    }

    /// A box as a mesh has the surface of a box.
    #[test]
    fn surfaces_of_meshes() {
        let pose = Isometry3::new(Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.3, 0.2, -1.0));
        let solid = Primitive::Box { size: Vector3::new(1.0, 2.0, 3.0) };
        let mesh = VisualMesh::primitive(&solid);
        let part = &mesh.parts[0];
        let corner = |index: u32| (pose * Point3::from(part.positions[index as usize].map(f64::from))).coords;
        let found = of_mesh(part.triangles.iter().map(|triangle| triangle.map(corner)), MeshMass::Shell);
        let expected = shell(&solid).expect("a surface").placed(&pose);
        assert!((found.mass - expected.mass).abs() < 1e-12 && (found.centre - expected.centre).norm() < 1e-12);
        assert!((found.inertia - expected.inertia).amax() < 1e-11, "{} {}", found.inertia, expected.inertia);
    }

    #[test]
    fn two_halves_are_a_whole() {
        let half = solid(&Primitive::Box { size: Vector3::new(1.0, 2.0, 1.5) }).expect("a solid");
        let at = |z| half.placed(&Isometry3::translation(0.0, 0.0, z));
        let sum = Mass::sum(&[at(-0.75), at(0.75)]);
        let whole = solid(&Primitive::Box { size: Vector3::new(1.0, 2.0, 3.0) }).expect("a solid");
        assert!((sum.mass - whole.mass).abs() < 1e-12 && (sum.inertia - whole.inertia).amax() < 1e-12);
    }
}
