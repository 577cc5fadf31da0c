//! What of objects does not change while the simulation runs.

use nalgebra::{Isometry3, Vector3};

use crate::ids::JointId;

/// The part of a ghost object's state that does not change while it runs.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct GhostInfo {
    /// Parent as named in the file; empty: the world.
    pub parent_name: String,
}

/// The part of a rigid body's state that does not change while it runs.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RigidBodyInfo {
    /// kg; 0 is static.
    pub mass: f64,
    /// Principal moments of inertia about the axes of the inertial frame, kg·m².
    pub inertia: Vector3<f64>,
    /// Inverse of the inertial offset: pose of the body frame in the inertial frame.
    pub inertial_offset_inverse: Isometry3<f64>,
    /// (n x 1) names of the active descendants, without namespace.
    pub children_names: Vec<String>,
    /// (n x 1) names of the active joints, in the order that indexes joint commands.
    pub joint_names: Vec<String>,
    /// (n x 1) each active joint.
    pub joints: Vec<JointId>,
    /// Whether the names of children are in the state before a client asks.
    pub publish_children_names: bool,
    /// Whether the names of joints are in the state before a client asks.
    pub publish_joint_names: bool,
    /// Whether joint positions, velocities and efforts are in the state before a client asks.
    pub publish_joint_positions: bool,
}

/// Types of sensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SensorType {
    /// Rays that see.
    #[default]
    Proximity,
    /// Rays that see and push.
    Resistance,
    /// Contacts of its parent body.
    Contact,
}

/// The part of a sensor's state that does not change while it runs.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SensorInfo {
    /// Type of the sensor.
    pub kind: SensorType,
    /// Parent body as named in the file.
    pub parent_name: String,
    /// Pose of the sensor in its parent's body frame.
    pub pose: Isometry3<f64>,
    /// Reach of a ray of direction length 1, m; for contact sensors the largest distance that counts as contact.
    pub range: f64,
}

/// The part of an actuator's state that does not change while it runs.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ActuatorInfo {
    /// Parent body as named in the file.
    pub parent_name: String,
    /// Pose of the actuator in its parent's body frame.
    pub pose: Isometry3<f64>,
}

/// The part of a vehicle's state that does not change while it runs.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct VehicleInfo {
    /// Mass of the chassis, kg.
    pub mass: f64,
    /// Principal moments of inertia of the chassis, kg·m².
    pub inertia: Vector3<f64>,
    /// Number of wheels.
    pub wheels: usize,
}
