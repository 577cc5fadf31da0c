//! Safe owners over Bullet. The other `unsafe` code of the project is at the solver's C interface (ambf-dynamics),
//! OpenGL (ambf-render, ambf-viewer), plugins and drivers in libraries (ambf-plugin), vendor libraries, and one system
//! call (`sim/pace.rs`).
//!
//! A [`World`] owns its bodies, soft bodies, ghosts, their shapes, the constraints between bodies and vehicles on them.
//! Callers refer to them by handles; a stale handle, of an object that was removed, gives `None` or `false`, never
//! undefined behaviour. Vehicles and constraints are freed before bodies, bodies before shapes. No panic can
//! cross into C++: of what it calls, the solver's entry points catch panics, and the sources of volumes end the process.

mod accurate;
mod arena;
mod articulation;
mod body;
mod constraint;
mod contact;
mod coupling;
mod drive;
mod energy;
mod ghost;
mod kinematics;
mod ray;
mod saved;
mod settings;
mod shape;
mod sleeping;
mod soft_body;
mod soft_world;
mod solver;
mod statistics;
mod step;
mod vehicle;
mod volume;
mod world;

pub use accurate::AccurateSettings;
pub use body::{Apart, BodySurface, PlausibleBounds, RigidBody};
pub use constraint::{Constraint, ConstraintKind, ConstraintParameter, JointReadings, JointWrench, Spring};
pub use contact::{Contact, ContactLists};
pub use drive::{BodyDrive, Resistance, SoftMotor};
pub use energy::EnergyLedger;
pub use kinematics::BodyKinematics;
pub use ray::{Ray, RayHit, RayTarget};
pub use saved::{SavedWorld, StateError};
pub use settings::{Gyroscopic, Preset, SolverSettings};
pub use shape::{Axis, Shape, ShapePattern};
pub use soft_body::{SoftBody, SoftBodyError, SoftConfig};
pub use soft_world::SoftFeatures;
pub use solver::{Integrator, Solver};
pub use statistics::SolverStatistics;
pub use step::{ExpectedTurn, SubStep};
pub use vehicle::Wheel;
pub use world::{
    ArticulationHandle, BodyHandle, ConstraintHandle, GhostHandle, SoftBodyHandle, VehicleHandle, VolumePartHandle,
    World, WorldKind,
};

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

#[cfg(test)]
mod tests {
    use super::*;

    pub fn ball(mass: f64, x: f64) -> RigidBody {
        RigidBody {
            mass,
            inertia: Vector3::repeat(0.004 * mass),
            shape: Shape::sphere(0.1, 0.001),
            pose: Isometry3::translation(x, 0.0, 0.0),
            friction: 0.5,
            rolling_friction: 0.0,
            restitution: 0.0,
            linear_damping: 0.0,
            angular_damping: 0.0,
            gravity: None,
        }
    }

    pub fn hinge() -> Constraint {
        Constraint {
            kind: ConstraintKind::Hinge { limits: None },
            frame_a: Isometry3::identity(),
            frame_b: Isometry3::translation(-1.0, 0.0, 0.0),
            parameters: vec![],
            feedback: true,
            disable_collisions: true,
        }
    }
}
