//! The types of objects that have a State and a Command: one list of them, and their fields in [`Channel`] and
//! [`Snapshot`].
//!
//! What is known of the objects of a type has three parts: what does not change (`…Info`), what does (`…Reading`) and
//! what clients ask for (`…Command`). Those of a new type stand in a file of its own below this module.

use std::sync::Arc;
use std::time::SystemTime;

use nalgebra::Isometry3;

use super::{
    ActuatorCommand, ActuatorInfo, CameraParameters, CameraView, ContactReading, GhostInfo, GhostReading,
    LightParameters, Mailbox, PoseCommand, RayReading, RigidBodyCommand, RigidBodyInfo, SensorCommand, SensorInfo,
    SoftBodyCommand, SoftBodyReading, SpotReading, Timing, ToolReading, VehicleCommand, VehicleInfo, VehicleReading,
    Wrench,
};
use crate::bullet::BodyKinematics;
use crate::ids::{
    ActuatorId, BodyId, CameraId, GhostId, JointId, LightId, SensorId, SoftBodyId, Table, VehicleId, VolumeId,
};
use ambf_plugin::ObjectId;
use ambf_volume::VoxelGrid;

macro_rules! object_kinds {
    ($($(#[$doc:meta])* $kind:ident($id:ident = $type:ident, $info:ty) with $mailbox:ident;)*) => {
        pub(crate) mod object_ids {
            crate::ids::ids! {$(
                #[doc = concat!(
                    "Names an object of the type [`ObjectType::", stringify!($type),
                    "`](ambf_plugin::ObjectType::", stringify!($type), ").",
                )]
                $id = $type;
            )*}
        }

        /// What an object is, and where its state stands in a [`Snapshot`].
        #[derive(Debug, Clone, PartialEq)]
        pub enum ObjectKind {
            /// The one world.
            World,
            $($(#[$doc])* $kind($id, $info),)*
        }

        impl ObjectKind {
            /// Which object of the scene it is; `None`: the world.
            pub fn object(&self) -> Option<ObjectId> {
                match *self {
                    Self::World => None,
                    $(Self::$kind(id, _) => Some(id.into()),)*
                }
            }

            /// Whether commands that keep it alive come through `channel`.
            pub(super) fn is_live(&self, channel: &Channel, now_ns: u64) -> bool {
                match self {
                    Self::World => false,
                    $(Self::$kind(..) => channel.$mailbox.is_live(now_ns),)*
                }
            }
        }
    };
}

// A line a type: its id and what of its state does not change; the mailbox whose commands keep it alive.
object_kinds! {
    /// In [`Snapshot::bodies`]; what does not change in its state.
    RigidBody(BodyId = Body, Box<RigidBodyInfo>) with body;
    /// In [`Snapshot::cameras`]; the parameters at the start.
    Camera(CameraId = Camera, Box<CameraParameters>) with pose;
    /// In [`Snapshot::lights`]; the parameters at the start.
    Light(LightId = Light, Box<LightParameters>) with pose;
    /// In [`Snapshot::sensors`]; what does not change in its state.
    Sensor(SensorId = Sensor, Box<SensorInfo>) with sensor;
    /// In [`Snapshot::actuators`]; what does not change in its state.
    Actuator(ActuatorId = Actuator, Box<ActuatorInfo>) with actuator;
    /// In [`Snapshot::vehicles`]; what does not change in its state.
    Vehicle(VehicleId = Vehicle, Box<VehicleInfo>) with vehicle;
    /// In [`Snapshot::soft_bodies`]; its mass, kg.
    SoftBody(SoftBodyId = SoftBody, f64) with soft_body;
    /// In [`Snapshot::ghosts`]; what does not change in its state.
    Ghost(GhostId = Ghost, Box<GhostInfo>) with sensor;
}

/// Where commands for one object are left. Which field is used follows from the object's kind.
#[derive(Default)]
pub struct Channel {
    /// Commands of a rigid body.
    pub body: Mailbox<RigidBodyCommand>,
    /// Commands of a camera or light.
    pub pose: Mailbox<PoseCommand>,
    /// Changed parameters of a camera.
    pub camera: Mailbox<CameraParameters>,
    /// Changed parameters of a light.
    pub light: Mailbox<LightParameters>,
    /// Commands of a sensor or a ghost object.
    pub sensor: Mailbox<SensorCommand>,
    /// Commands of an actuator.
    pub actuator: Mailbox<ActuatorCommand>,
    /// Commands of a vehicle.
    pub vehicle: Mailbox<VehicleCommand>,
    /// Commands of a soft body.
    pub soft_body: Mailbox<SoftBodyCommand>,
}

/// State of every object after one physics iteration. Arrays are indexed as [`ObjectKind`] says.
#[derive(Debug, Clone, PartialEq)]
pub struct Snapshot {
    /// System time right after the step, or simulated time since 1970
    /// ([`Simulation::set_simulated_stamps`](crate::sim::Simulation::set_simulated_stamps)).
    pub stamp: SystemTime,
    /// Iterations that stepped, since the start.
    pub sim_step: u32,
    /// Monotonic seconds since the physics thread began.
    pub wall_time: f64,
    /// Sum of all intervals passed to the dynamics update, s.
    pub sim_time: f64,
    /// Where time went.
    pub timing: Timing,
    /// (bodies x 1).
    pub bodies: Table<BodyId, BodyKinematics>,
    /// (bodies x 1) sum of the joint reactions on each body in its own inertial frame; empty when no joint has
    /// feedback.
    pub wrenches: Table<BodyId, Wrench>,
    /// (joints x 1) rad or m.
    pub joint_positions: Table<JointId, f64>,
    /// (joints x 1) rad/s or m/s.
    pub joint_velocities: Table<JointId, f64>,
    /// (joints x 1) N·m or N; 0 for joints without feedback.
    pub joint_efforts: Table<JointId, f64>,
    /// (joints x 1) what each joint exerts on its child: see [`Joint::wrench`](crate::scene::Joint::wrench).
    pub joint_wrenches: Table<JointId, Wrench>,
    /// (cameras x 1) pose in the parent's body frame, or in the world.
    pub cameras: Table<CameraId, Isometry3<f64>>,
    /// (lights x 1) pose in the parent's body frame, or in the world.
    pub lights: Table<LightId, Isometry3<f64>>,
    /// (cameras x 1) what pictures of them depend on.
    pub views: Table<CameraId, CameraView>,
    /// (lights x 1) where they shine.
    pub spots: Table<LightId, SpotReading>,
    /// (sensors x rays), for contact sensors (sensors x contacts).
    pub sensors: Table<SensorId, Vec<RayReading>>,
    /// (sensors x 1) what touches the body of each contact sensor; empty for other sensors.
    pub contacts: Table<SensorId, ContactReading>,
    /// (actuators x 1) whether it holds something.
    pub actuators: Table<ActuatorId, bool>,
    /// (vehicles x 1).
    pub vehicles: Table<VehicleId, VehicleReading>,
    /// (soft bodies x 1).
    pub soft_bodies: Table<SoftBodyId, SoftBodyReading>,
    /// (ghost objects x 1).
    pub ghosts: Table<GhostId, GhostReading>,
    /// (volumes x 1) pose in the world.
    pub volumes: Table<VolumeId, Isometry3<f64>>,
    /// (volumes x 1) voxels as they are now; `None`: the volume is empty, or its voxels cannot be read.
    pub voxels: Table<VolumeId, Option<Arc<VoxelGrid>>>,
    /// (volumes x tools).
    pub tools: Table<VolumeId, Vec<ToolReading>>,
}

impl Default for Snapshot {
    fn default() -> Self {
        Self {
            stamp: SystemTime::UNIX_EPOCH,
            sim_step: 0,
            wall_time: 0.0,
            sim_time: 0.0,
            timing: Timing::default(),
            bodies: Table::default(),
            wrenches: Table::default(),
            joint_positions: Table::default(),
            joint_velocities: Table::default(),
            joint_efforts: Table::default(),
            joint_wrenches: Table::default(),
            cameras: Table::default(),
            lights: Table::default(),
            views: Table::default(),
            spots: Table::default(),
            sensors: Table::default(),
            contacts: Table::default(),
            actuators: Table::default(),
            vehicles: Table::default(),
            soft_bodies: Table::default(),
            ghosts: Table::default(),
            volumes: Table::default(),
            voxels: Table::default(),
            tools: Table::default(),
        }
    }
}
