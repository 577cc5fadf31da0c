//! State and Command of every object as plain values, and how they cross threads.
//!
//! One [`Hub`] a simulation. The physics thread writes a [`Snapshot`] of all states once an iteration and takes the
//! newest command of each object from its [`Mailbox`]; everybody else (ROS, a script, a test) reads the newest snapshot
//! and posts commands. Neither side waits for the other on this way: no lock is taken, and a reader that stops half-way
//! only keeps its own copy of an old snapshot alive. The physics thread takes short locks only when clients step it,
//! and when models come and go ([`StepThrottle`], [`Hub::add_objects`]).
//!
//! A [`Middleware`] carries the values over a wire. What it may rely on:
//! * the list of objects only grows: an object keeps its position, and one that is removed says so ([`Hub::generation`]
//!   counts changes);
//! * [`Hub::snapshot`] is `None` until the first physics iteration has filled it;
//! * a command is in force until the next one, or until its watchdog expires ([`WATCHDOG_TIMEOUT`]).

mod command;
mod followers;
mod hub;
mod info;
mod mailbox;
mod objects;
mod reading;
mod schedule;
mod step;
mod throttle;
mod volume;

pub use crate::bullet::BodyKinematics;
pub use ambf_plugin::JointCommandType;
pub use command::{
    ActuatorCommand, CameraParameters, CartesianCommandType, Command, LightParameters, PoseCommand, RigidBodyCommand,
    SensorCommand, SoftBodyCommand, VehicleCommand,
};
pub use followers::{Follower, Published};
pub use hub::{Hub, HubIndex, HubObject, ObjectInfo, ObjectList, PostError, Resets};
pub use info::{ActuatorInfo, GhostInfo, RigidBodyInfo, SensorInfo, SensorType, VehicleInfo};
pub use mailbox::{Inbox, Mailbox};
pub use objects::*;
pub use reading::{
    CameraView, ContactPoint, ContactReading, GhostReading, RayReading, SoftBodyReading, SpotReading, Timing,
    TouchingBody, VehicleReading, Wrench,
};
pub use schedule::{PublishSchedule, Rates};

/// The physics thread's end of the slot of the newest snapshot.
pub type SnapshotWriter = ambf_plugin::SnapshotWriter<Snapshot>;

pub use step::{OrderedCommands, StepError, StepOrder};
pub use throttle::{Activity, StepThrottle, WorldCommand};
pub(crate) use volume::Order;
pub use volume::{CarveCommand, Cut, ToolReading, VolumeCommand};

use std::sync::Arc;
use std::time::Duration;

/// How long a command stays in force after it was posted unless another one follows: 0.5 s, for every object and the
/// world.
pub const WATCHDOG_TIMEOUT: Duration = Duration::from_millis(500);

/// Carries states and commands over a wire (ROS, shared memory, …).
pub trait Middleware: Send {
    /// Starts serving the objects of `hub` in threads of its own and returns at once.
    ///
    /// # Errors
    /// When the transport cannot be set up at all; a peer that is merely not there yet is retried, not an error.
    fn start(&mut self, hub: Arc<Hub>) -> Result<(), Box<dyn std::error::Error + Send + Sync>>;

    /// Withdraws everything that [`start`](Self::start) announced and ends its threads. Called once; safe after a
    /// failed start.
    fn stop(&mut self);
}
