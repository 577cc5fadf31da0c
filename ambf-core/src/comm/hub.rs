use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant};

use arc_swap::Guard;
use nalgebra::{Isometry3, Vector3};
use thiserror::Error;

use super::snapshot::Slot;
use super::{
    CameraParameters, Command, LightParameters, Mailbox, PoseCommand, Rates, RigidBodyCommand, Snapshot,
    SnapshotWriter, StepThrottle,
};

/// What an object is, and where its state stands in a [`Snapshot`].
#[derive(Debug, Clone, PartialEq)]
pub enum ObjectKind {
    /// The one world.
    World,
    /// Index into [`Snapshot::bodies`], and what does not change in its state.
    RigidBody(usize, Box<RigidBodyInfo>),
    /// Index into [`Snapshot::cameras`], and the parameters at the start.
    Camera(usize, Box<CameraParameters>),
    /// Index into [`Snapshot::lights`], and the parameters at the start.
    Light(usize, Box<LightParameters>),
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
    /// (n x 1) where each active joint stands in the snapshot's joint arrays.
    pub joints: Vec<usize>,
    /// Whether the names of children are in the state before a client asks.
    pub publish_children_names: bool,
    /// Whether the names of joints are in the state before a client asks.
    pub publish_joint_names: bool,
    /// Whether joint positions, velocities and efforts are in the state before a client asks.
    pub publish_joint_positions: bool,
}

/// An object that has a State and a Command.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectInfo {
    /// What it is and where its state stands.
    pub kind: ObjectKind,
    /// Global prefix and namespace, as written: may hold doubled slashes.
    pub namespace: String,
    /// Communication name: the ADF name and the suffix that tells copies apart.
    pub name: String,
    /// Qualified identifier and suffix.
    pub identifier: String,
    /// How often it is published.
    pub rates: Rates,
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
}

/// Error when a command cannot be accepted. The command before stays in force.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum PostError {
    /// Error when a number in the command is NaN or infinite.
    #[error(
        "a command for \"{0}\" holds a number that is not finite; it is ignored and the one before stays in force"
    )]
    NotFinite(String),
}

/// Meeting point of the physics thread and everybody who talks to it. See the [module](super).
pub struct Hub {
    objects: Vec<ObjectInfo>,
    channels: Vec<Channel>,
    /// One bit an object: something waits in its channel.
    pending: Vec<AtomicU64>,
    snapshot: Slot,
    listeners: AtomicBool,
    throttle: StepThrottle,
    reset_world: AtomicBool,
    reset_bodies: AtomicBool,
    start: Instant,
}

impl Hub {
    /// A hub for `objects`.
    pub fn new(objects: Vec<ObjectInfo>) -> Self {
        Self {
            channels: objects.iter().map(|_| Channel::default()).collect(),
            pending: objects.chunks(64).map(|_| AtomicU64::new(0)).collect(),
            objects,
            snapshot: Slot::empty(),
            listeners: AtomicBool::new(false),
            throttle: StepThrottle::default(),
            reset_world: AtomicBool::new(false),
            reset_bodies: AtomicBool::new(false),
            start: Instant::now(),
        }
    }

    /// All objects that have a State and a Command; the position in this list names an object below.
    pub fn objects(&self) -> &[ObjectInfo] {
        &self.objects
    }

    /// The hub's clock: monotonic time since it was made; never 0.
    pub fn now(&self) -> Duration {
        self.start.elapsed().max(Duration::from_nanos(1))
    }

    /// [`now`](Self::now) in ns.
    pub fn now_ns(&self) -> u64 {
        self.now().as_nanos() as u64
    }

    /// The newest state of everything; empty before the first physics iteration and while nobody
    /// [listens](Self::set_listening). Hold it briefly.
    pub fn snapshot(&self) -> Guard<Option<Arc<Snapshot>>> {
        self.snapshot.load()
    }

    /// Says that somebody reads snapshots; before that none are made.
    pub fn set_listening(&self) {
        self.listeners.store(true, Ordering::Release);
    }

    /// Whether somebody reads snapshots.
    pub fn is_listening(&self) -> bool {
        self.listeners.load(Ordering::Acquire)
    }

    /// Physics thread: publishes a snapshot through `writer`; false when readers hold all spare ones.
    pub fn publish(&self, writer: &mut SnapshotWriter, fill: impl FnOnce(&mut Snapshot)) -> bool {
        writer.publish(&self.snapshot, fill)
    }

    /// Leaves a command for the rigid body at position `object`.
    ///
    /// # Errors
    /// [`PostError::NotFinite`].
    pub fn post_body(&self, object: usize, command: &RigidBodyCommand) -> Result<(), PostError> {
        self.post(object, &self.channels[object].body, command)
    }

    /// Leaves a command for the camera or light at position `object`.
    ///
    /// # Errors
    /// [`PostError::NotFinite`].
    pub fn post_pose(&self, object: usize, command: &PoseCommand) -> Result<(), PostError> {
        self.post(object, &self.channels[object].pose, command)
    }

    /// Leaves changed parameters for the camera at position `object`.
    ///
    /// # Errors
    /// [`PostError::NotFinite`].
    pub fn post_camera(&self, object: usize, parameters: &CameraParameters) -> Result<(), PostError> {
        self.post(object, &self.channels[object].camera, parameters)
    }

    /// Leaves changed parameters for the light at position `object`.
    ///
    /// # Errors
    /// [`PostError::NotFinite`].
    pub fn post_light(&self, object: usize, parameters: &LightParameters) -> Result<(), PostError> {
        self.post(object, &self.channels[object].light, parameters)
    }

    fn post<C: Command>(&self, object: usize, mailbox: &Mailbox<C>, command: &C) -> Result<(), PostError> {
        if !command.is_finite() {
            return Err(PostError::NotFinite(self.objects[object].name.clone()));
        }
        mailbox.post(command, self.now_ns());
        self.pending[object / 64].fetch_or(1 << (object % 64), Ordering::Release);
        Ok(())
    }

    /// Where commands for the object at position `object` are left.
    pub fn channel(&self, object: usize) -> &Channel {
        &self.channels[object]
    }

    /// Physics thread: calls `visit` for each object for which something was left since the last call.
    pub fn take_pending(&self, mut visit: impl FnMut(usize)) {
        for (word, bits) in self.pending.iter().enumerate() {
            if bits.load(Ordering::Relaxed) == 0 {
                continue;
            }
            let mut rest = bits.swap(0, Ordering::Acquire);
            while rest != 0 {
                visit(word * 64 + rest.trailing_zeros() as usize);
                rest &= rest - 1;
            }
        }
    }

    /// Step throttling by the world's clients.
    pub fn throttle(&self) -> &StepThrottle {
        &self.throttle
    }

    /// Asks for a reset of all objects before the next step; honoured also while paused or throttled.
    pub fn request_world_reset(&self) {
        self.reset_world.store(true, Ordering::Release);
        self.throttle.wake();
    }

    /// Asks for a reset of the rigid bodies before the next step; honoured also while paused or throttled.
    pub fn request_body_reset(&self) {
        self.reset_bodies.store(true, Ordering::Release);
        self.throttle.wake();
    }

    /// Whether a reset waits to be done.
    pub fn reset_requested(&self) -> bool {
        self.reset_world.load(Ordering::Acquire) || self.reset_bodies.load(Ordering::Acquire)
    }

    /// Physics thread: takes the requests (world, bodies).
    pub fn take_resets(&self) -> (bool, bool) {
        (self.reset_world.swap(false, Ordering::AcqRel), self.reset_bodies.swap(false, Ordering::AcqRel))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hub(n: usize) -> Hub {
        let object = |i: usize| ObjectInfo {
            kind: ObjectKind::RigidBody(i, Box::default()),
            namespace: "/ambf/env/".into(),
            name: format!("Box{i}"),
            identifier: format!("/ambf/env/BODY Box{i}"),
            rates: Rates::default(),
        };
        Hub::new((0..n).map(object).collect())
    }

    #[test]
    fn only_objects_with_mail_are_visited() {
        let hub = hub(130);
        for object in [0, 63, 64, 129] {
            hub.post_body(object, &RigidBodyCommand::default()).unwrap();
        }
        let mut seen = Vec::new();
        hub.take_pending(|object| seen.push(object));
        assert_eq!(seen, [0, 63, 64, 129]);
        hub.take_pending(|object| panic!("{object} has nothing new"));
    }

    #[test]
    fn a_command_with_nan_is_refused_by_name() {
        let hub = hub(1);
        let command = RigidBodyCommand { joint_commands: vec![f64::NAN], ..Default::default() };
        let error = hub.post_body(0, &command).unwrap_err();
        assert!(error.to_string().contains("Box0"), "{error}");
        hub.take_pending(|_| panic!("nothing was posted"));
    }
}
