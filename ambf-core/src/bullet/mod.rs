//! Safe owners over Bullet: the only `unsafe` code of the simulator besides callbacks and vendor libraries.
//!
//! A [`World`] owns its bodies, their shapes and the constraints between them. Outside they are named by handles; a handle of
//! something that was removed gives `None` or `false`, never undefined behaviour. Constraints are freed before bodies, bodies
//! before shapes. No panic can cross into C++: nothing here is called back from it.

mod constraint;
mod kinematics;
mod method;
mod shape;
mod world;

pub use constraint::{Constraint, ConstraintKind, ConstraintParameter, Spring};
pub use kinematics::BodyKinematics;
pub use method::{Integrator, Solver};
pub use shape::{Axis, Shape};
pub use world::{BodyHandle, ConstraintHandle, JointWrench, RigidBody, World};

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// A pose as the shim takes it: origin, then the rotation matrix row by row.
fn raw_pose(pose: &Isometry3<f64>) -> [f64; 12] {
    let t = pose.translation.vector;
    let m = pose.rotation.to_rotation_matrix();
    [t.x, t.y, t.z, m[(0, 0)], m[(0, 1)], m[(0, 2)], m[(1, 0)], m[(1, 1)], m[(1, 2)], m[(2, 0)], m[(2, 1)], m[(2, 2)]]
}

fn pose_of(raw: &[f64; 12]) -> Isometry3<f64> {
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_row_slice(&raw[3..]));
    let origin = Vector3::from_column_slice(&raw[..3]);
    Isometry3::from_parts(Translation3::from(origin), UnitQuaternion::from_rotation_matrix(&rotation))
}
