//! Nodes of a scene that place geometry: what Collada and glTF have in common.

use std::path::Path;

use nalgebra::{Matrix3, Matrix4, Point3, Vector3};

use super::{check_finite, MeshError};

/// Nodes that one file may expand to: nested instances can grow exponentially, or for ever.
pub(super) const MAX_NODES: usize = 1_000_000;

/// Triangles that one file may expand to.
pub(super) const MAX_TRIANGLES: usize = 10_000_000;

/// Longest name of a sub-mesh, in characters. Each instance has its own copy.
const MAX_NAME: usize = 200;

/// The beginning of a name.
pub(super) fn short_name(name: &str) -> String {
    name.chars().take(MAX_NAME).collect()
}

/// How a node places its geometry in the mesh frame.
pub(super) struct Placement {
    transform: Matrix4<f64>,
    outwards: Matrix3<f64>,
    mirrors: bool,
}

impl Placement {
    /// `transform` need not have an inverse.
    pub fn new(transform: Matrix4<f64>) -> Self {
        let linear: Matrix3<f64> = transform.fixed_view::<3, 3>(0, 0).into();
        let mirrors = linear.determinant() < 0.0;
        // Normals stay at right angles to the surface.
        let [x, y, z] = [0, 1, 2].map(|i| linear.column(i).into_owned());
        let cofactors = Matrix3::from_columns(&[y.cross(&z), z.cross(&x), x.cross(&y)]);
        Self { transform, outwards: cofactors * if mirrors { -1.0 } else { 1.0 }, mirrors }
    }

    /// Whether triangles must be reversed so that they still face outwards.
    pub fn mirrors(&self) -> bool {
        self.mirrors
    }

    /// The placed position of vertex number `vertex`.
    ///
    /// # Errors
    /// Error when it is not finite.
    pub fn position(&self, path: &Path, vertex: usize, position: Point3<f64>) -> Result<[f64; 3], MeshError> {
        check_finite(path, vertex, self.transform.transform_point(&position).into())
    }

    /// The placed normal, of length 1, or of length 0 where there is none.
    pub fn normal(&self, normal: Vector3<f64>) -> [f32; 3] {
        let placed = (self.outwards * normal).try_normalize(0.0).filter(|n| n.iter().all(|x| x.is_finite()));
        placed.unwrap_or_else(Vector3::zeros).cast::<f32>().into()
    }
}
