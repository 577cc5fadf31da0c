//! Rigid bodies.

use nalgebra::{Isometry3, Vector3};

use super::common::Common;
use super::controller::CartesianController;
use super::geometry::{CollisionGeometry, Visual};

/// A rigid body as written.
#[derive(Clone, Debug, PartialEq)]
pub struct RigidBody {
    /// Identity, communication, plugins.
    pub common: Common,
    /// Initial pose of the body (mesh) frame in the world. Default: identity.
    pub location: Isometry3<f64>,
    /// Uniform scale of meshes and joint pivots, not of primitives, offsets and inertia; positive. Default: 1.
    pub scale: f64,
    /// Mass, kg, not negative; 0: static. Default: 1, then `inertia`, `inertial_offset`, `gravity` are `None`.
    pub mass: f64,
    /// Principal moments about the axes of the inertial frame, kg·m², not negative; `None`: to be estimated.
    pub inertia: Option<Vector3<f64>>,
    /// Pose of the inertial frame in the body frame; `None`: to be estimated.
    pub inertial_offset: Option<Isometry3<f64>>,
    /// Acceleration instead of the model's or the world's gravity, m/s².
    pub gravity: Option<Vector3<f64>>,
    /// Appearance.
    pub visual: Visual,
    /// What collides.
    pub collision: CollisionGeometry,
    /// Collision margin of each child shape, m, not negative. Default: 0.001.
    pub collision_margin: f64,
    /// Collision groups, each 0 to 999, in file order.
    pub collision_groups: Vec<u32>,
    /// Contact and damping properties.
    pub surface: Surface,
    /// Cartesian controller; `None`: the key is absent.
    pub controller: Option<CartesianController>,
    /// Names of active children in the state message. Default: `false`.
    pub publish_children_names: bool,
    /// Names of active joints in the state message. Default: `true`.
    pub publish_joint_names: bool,
    /// Positions, velocities and efforts of active joints in the state message. Default: `true`.
    pub publish_joint_positions: bool,
}

/// Contact and damping properties of a rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Coefficient of sliding friction. Default: 0.5.
    pub static_friction: f64,
    /// Coefficient of rolling friction. Default: 0.01.
    pub rolling_friction: f64,
    /// Bullet's linear damping of the body: share of velocity lost in 1 s. Default: 0.04.
    pub linear_damping: f64,
    /// Bullet's angular damping of the body: share of angular velocity lost in 1 s. Default: 0.1.
    pub angular_damping: f64,
    /// Coefficient of restitution. Default: 0.1.
    pub restitution: f64,
}

impl Default for Surface {
    fn default() -> Self {
        Self {
            static_friction: 0.5,
            rolling_friction: 0.01,
            linear_damping: 0.04,
            angular_damping: 0.1,
            restitution: 0.1,
        }
    }
}
