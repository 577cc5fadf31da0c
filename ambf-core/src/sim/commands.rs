//! What commands do, and the physics thread's end of the hub.

use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Isometry3, Vector3};

use super::{NonFinite, Simulation};
use crate::bullet::BodyKinematics;
use crate::comm::{
    CameraParameters, CartesianCommandType, Channel, Hub, Inbox, JointCommandType, LightParameters, ObjectKind,
    ObjectList, PoseCommand, RigidBodyCommand, Snapshot, SnapshotWriter, Timing, Wrench,
};
use crate::scene::Scene;

/// The physics thread's end of the hub.
pub(super) struct Link {
    pub hub: Arc<Hub>,
    objects: Arc<ObjectList>,
    writer: SnapshotWriter,
    slots: Vec<Slot>,
    /// Objects that were ever commanded, in visiting order: only they are looked at in an iteration.
    commanded: Vec<usize>,
    /// Rank of each object in visiting order.
    rank: Vec<usize>,
}

/// Commands in force for one object, which is named by its index in the scene.
enum Slot {
    /// The world and sensors: commands do nothing to them.
    Idle,
    Body(usize, Inbox<RigidBodyCommand>),
    Camera(usize, Inbox<PoseCommand>, Inbox<CameraParameters>),
    Light(usize, Inbox<PoseCommand>, Inbox<LightParameters>),
}

impl Slot {
    fn of(kind: &ObjectKind) -> Self {
        match *kind {
            ObjectKind::RigidBody(index, _) => Self::Body(index, Inbox::default()),
            ObjectKind::Camera(index, _) => Self::Camera(index, Inbox::default(), Inbox::default()),
            ObjectKind::Light(index, _) => Self::Light(index, Inbox::default(), Inbox::default()),
            _ => Self::Idle,
        }
    }

    /// Takes what waits in `channel`; true when there is a command to execute from now on.
    fn fetch(&mut self, channel: &Channel, scene: &mut Scene) -> bool {
        match self {
            Self::Idle => false,
            Self::Body(_, inbox) => inbox.fetch(&channel.body),
            Self::Camera(index, pose, parameters) => {
                if parameters.fetch(&channel.camera) {
                    scene.cameras[*index].set_parameters(parameters.command(), &scene.body_names);
                }
                pose.fetch(&channel.pose)
            }
            Self::Light(index, pose, parameters) => {
                if parameters.fetch(&channel.light) {
                    scene.lights[*index].set_parameters(parameters.command(), &scene.body_names);
                }
                pose.fetch(&channel.pose)
            }
        }
    }
}

impl Link {
    pub fn new(hub: Arc<Hub>, scene: &Scene, wrenches: &[Wrench]) -> Self {
        let objects = hub.objects().clone();
        let mut body_rank = vec![0; scene.bodies.len()];
        for (rank, body) in scene.visiting_order().into_iter().enumerate() {
            body_rank[body] = rank + 1;
        }
        let rank = objects.iter().map(|object| match object.info.kind {
            ObjectKind::RigidBody(index, _) => body_rank[index],
            _ => 0,
        });
        let template = Snapshot {
            bodies: vec![BodyKinematics::default(); scene.bodies.len()],
            wrenches: wrenches.to_vec(),
            joint_positions: vec![0.0; scene.joints.len()],
            joint_velocities: vec![0.0; scene.joints.len()],
            joint_efforts: vec![0.0; scene.joints.len()],
            cameras: vec![Isometry3::identity(); scene.cameras.len()],
            lights: vec![Isometry3::identity(); scene.lights.len()],
            ..Snapshot::default()
        };
        Self {
            rank: rank.collect(),
            commanded: Vec::with_capacity(objects.len()),
            slots: objects.iter().map(|object| Slot::of(&object.info.kind)).collect(),
            objects,
            hub,
            writer: SnapshotWriter::new(template),
        }
    }

    /// What the body was last told, in words.
    pub fn last_command(&self, body: usize) -> String {
        let slot = self.slots.iter().find_map(|slot| match slot {
            Slot::Body(index, inbox) if *index == body => Some(inbox),
            _ => None,
        });
        slot.map_or_else(|| "none".into(), |inbox| format!("{:?}", inbox.command()))
    }
}

impl Simulation {
    /// Executes the newest commands.
    ///
    /// # Errors
    /// [`NonFinite`] when a finite command has a result that is not, such as a goal so far off that the velocity towards it
    /// overflows.
    pub(super) fn execute_commands(&mut self) -> Result<(), NonFinite> {
        let Some(mut link) = self.link.take() else { return Ok(()) };
        self.fetch(&mut link);
        self.execute(&mut link);
        let is_commanded = !link.commanded.is_empty();
        self.link = Some(link);
        if is_commanded {
            self.check_finite()?;
        }
        Ok(())
    }

    /// Publishes the states. `wall_time` in s.
    pub(super) fn publish(&mut self, wall_time: f64, timing: Timing) {
        let Some(mut link) = self.link.take() else { return };
        if link.hub.is_listening() {
            // When readers hold every spare snapshot they see this state one iteration later.
            let hub = Arc::clone(&link.hub);
            hub.publish(&mut link.writer, |snapshot| self.fill(snapshot, wall_time, timing));
        }
        self.link = Some(link);
    }

    fn fetch(&mut self, link: &mut Link) {
        let Link { objects, slots, commanded, rank, .. } = link;
        objects.take_pending(|object| {
            if slots[object].fetch(&objects[object].channel, &mut self.scene) {
                // Only bodies have ranks of their own.
                let place = |object: usize| (rank[object], object);
                if let Err(place) = commanded.binary_search_by_key(&place(object), |&other| place(other)) {
                    commanded.insert(place, object);
                }
            }
        });
    }

    fn execute(&mut self, link: &mut Link) {
        if link.commanded.is_empty() {
            return;
        }
        let now = link.hub.now_ns();
        for &object in &link.commanded {
            match &mut link.slots[object] {
                Slot::Idle => (),
                Slot::Body(index, inbox) => {
                    inbox.check_watchdog(now);
                    self.command_body(*index, inbox.command());
                }
                Slot::Camera(index, inbox, _) => {
                    inbox.check_watchdog(now);
                    self.scene.cameras[*index].placed.apply_command(inbox.command());
                }
                Slot::Light(index, inbox, _) => {
                    inbox.check_watchdog(now);
                    self.scene.lights[*index].placed.apply_command(inbox.command());
                }
            }
        }
    }

    /// Applies a whole command to a body; it acts in the next update.
    pub fn command_body(&mut self, body: usize, command: &RigidBodyCommand) {
        let Scene { bodies, world, .. } = &mut self.scene;
        bodies[body].apply_command(world, command, self.dt, self.iteration);
        let n = command.joint_commands.len().min(self.scene.active_joints(body).len());
        for (i, &value) in command.joint_commands[..n].iter().enumerate() {
            let kind = command.joint_command_types.get(i).copied().unwrap_or_default();
            self.command_joint(body, i, kind, value);
        }
    }

    /// Applies a command to the `index`-th active joint of a body: effort (N·m, N), position (rad, m) or velocity (rad/s, m/s). False when
    /// there is no such joint or the value is not finite.
    pub fn command_joint(&mut self, body: usize, index: usize, kind: JointCommandType, value: f64) -> bool {
        if !value.is_finite() {
            return false;
        }
        let time = (self.sim_time, self.interval);
        let Some(&joint) = self.scene.active_joints(body).get(index) else { return false };
        let Scene { joints, bodies, world, .. } = &mut self.scene;
        joints[joint].apply_command(world, bodies, kind, value, time);
        true
    }

    /// Adds a force (N) at the centre of mass and a torque (N·m), world axes, for the next update.
    pub fn apply_wrench(&mut self, body: usize, force: Vector3<f64>, torque: Vector3<f64>) {
        let command =
            RigidBodyCommand { cartesian: CartesianCommandType::Force, force, torque, ..RigidBodyCommand::default() };
        self.command_body(body, &command);
    }

    /// Sets the velocity of a body, m/s and rad/s, world axes.
    pub fn set_velocity(&mut self, body: usize, linear: Vector3<f64>, angular: Vector3<f64>) {
        let command = RigidBodyCommand {
            cartesian: CartesianCommandType::Velocity,
            linear_velocity: linear,
            angular_velocity: angular,
            ..RigidBodyCommand::default()
        };
        self.command_body(body, &command);
    }

    /// Follows a pose of the body frame in the world for one iteration; `orientation` is a quaternion `[x, y, z, w]`.
    pub fn follow_pose(&mut self, body: usize, position: Vector3<f64>, orientation: [f64; 4]) {
        let command = RigidBodyCommand {
            cartesian: CartesianCommandType::Position,
            position,
            orientation,
            ..RigidBodyCommand::default()
        };
        self.command_body(body, &command);
    }

    /// Says that the calling thread is the one that clients hold.
    pub(super) fn wait_in_this_thread(&self) {
        if let Some(link) = &self.link {
            link.hub.throttle().set_waiter(std::thread::current());
        }
    }

    /// Holds the calling thread while clients throttle the simulation; `give_up` ends that.
    pub(super) fn wait_for_clients(&self, give_up: impl Fn() -> bool) {
        if let Some(link) = &self.link {
            link.hub.throttle().wait(|| link.hub.now_ns(), give_up);
        }
    }

    /// Counts the iteration for throttling clients; true when they ask for steps of no iterations.
    pub(super) fn count_for_clients(&self, counter: &mut u32) -> bool {
        self.link.as_ref().is_some_and(|link| {
            link.hub.throttle().check_watchdog(link.hub.now_ns());
            link.hub.throttle().count(counter)
        })
    }

    /// Does the resets that were asked for through the hub; true if there was one.
    pub(super) fn do_requested_resets(&mut self) -> bool {
        let Some(link) = &self.link else { return false };
        match link.hub.take_resets() {
            (true, _) => self.reset_world(),
            (false, true) => self.reset_bodies(),
            (false, false) => return false,
        }
        true
    }

    /// Whether clients asked for a reset that was not done yet.
    pub(super) fn reset_is_requested(&self) -> bool {
        self.link.as_ref().is_some_and(|link| link.hub.reset_requested())
    }

    /// Lets the cap on sub-steps learn what the latest update cost.
    pub(super) fn learn_cost(&mut self, cost: Duration) {
        self.cap.learn(self.due, self.sub_step, cost.as_secs_f64());
    }
}
