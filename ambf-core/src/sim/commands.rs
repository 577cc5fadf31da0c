//! What commands do, and the physics thread's end of the hub.

use std::any::Any;
use std::borrow::Cow;
use std::cmp::Reverse;
use std::sync::Arc;
use std::time::Instant;

use ambf_volume::Carved;
use nalgebra::{Isometry3, Vector3};

use super::physics::Physics;
use super::session::Entry;
use super::{LostState, Nearness, Reset, Simulation};
use crate::adf::{ObjectType, VolumeTool};
use crate::comm::{
    Activity, ActuatorCommand, CarveCommand, Channel, Command, Cut, Hub, HubIndex, HubObject, Inbox, JointCommandType,
    ObjectKind, ObjectList, PoseCommand, Resets, RigidBodyCommand, Snapshot, SnapshotWriter, Timing, VehicleCommand,
    VolumeCommand, Wrench,
};
use crate::ids::{ActuatorId, BodyId, CameraId, LightId, SoftBodyId, Table, VehicleId, VolumeId};
use crate::plugin::ObjectId;
use crate::scene::{Commands, ParameterChange, ParameterError, Scene, SetStateError, StateChange, VolumeError};

/// The physics thread's end of the hub.
pub(super) struct Link {
    pub hub: Arc<Hub>,
    objects: Arc<ObjectList>,
    writer: SnapshotWriter,
    slots: Vec<Slot>,
    /// Objects that were ever commanded, in visiting order: only they are looked at in an iteration.
    commanded: Vec<HubIndex>,
    /// Rank of each object in visiting order.
    rank: Vec<usize>,
    arrivals: Arrivals,
}

/// When objects got their last commands.
#[derive(Default)]
struct Arrivals {
    /// Number of the last one of each object; 0: it never had one.
    of: Vec<u64>,
    count: u64,
}

impl Arrivals {
    fn note(&mut self, object: HubIndex) {
        self.count += 1;
        self.of[object.0] = self.count;
    }
}

/// Commands in force for one object of the scene.
enum Slot {
    /// The world, and objects to which commands do nothing.
    Idle,
    /// Commands of a rigid body: its targets are executed in sub-steps, by [`Physics`].
    Body(BodyId, Inbox<RigidBodyCommand>),
    Other(Box<dyn Commands>),
}

impl Slot {
    fn of(kind: &ObjectKind, scene: &Scene) -> Self {
        match *kind {
            ObjectKind::RigidBody(index, _) => Self::Body(index, Inbox::default()),
            _ => kind.object().and_then(|object| scene.commands_of(object)).map_or(Self::Idle, Self::Other),
        }
    }

    /// The same commands, as if they had come `by` ns later.
    fn later(&self, by: u64) -> Self {
        match self {
            Self::Idle => Self::Idle,
            Self::Body(index, inbox) => Self::Body(*index, inbox.later(by)),
            Self::Other(commands) => Self::Other(commands.later(by)),
        }
    }

    /// Forgets the command in force unless it was posted at `time_ns` or later; whether it did.
    fn forget_before(&mut self, time_ns: u64) -> bool {
        match self {
            Self::Idle => true,
            Self::Body(_, inbox) => inbox.forget_before(time_ns),
            Self::Other(commands) => commands.forget_before(time_ns),
        }
    }

    /// Takes what waits in `channel` while the order of steps with the number `order` runs; true when there is a command
    /// to execute from now on. Sentences about what cannot be done go to `notices`.
    fn fetch(&mut self, channel: &Channel, order: u64, scene: &mut Scene, notices: &mut Vec<String>) -> bool {
        match self {
            Self::Idle => false,
            Self::Body(_, inbox) => inbox.fetch(&channel.body, order),
            Self::Other(commands) => commands.fetch(channel, order, scene, notices),
        }
    }
}

/// Commands in force.
#[derive(Default)]
pub(super) struct SavedCommands {
    /// Time of the watchdog, ns.
    saved_at: u64,
    slots: Vec<(HubIndex, Slot)>,
}

impl SavedCommands {
    /// How many objects have one.
    #[cfg(test)]
    pub fn count(&self) -> usize {
        self.slots.len()
    }
}

impl Link {
    pub fn save(&self) -> SavedCommands {
        let slot = |&object: &HubIndex| (object, self.slots[object.0].later(0));
        SavedCommands { saved_at: self.watch_time(), slots: self.commanded.iter().map(slot).collect() }
    }

    /// Commands that came since are forgotten, but for those that were not looked at yet; watchdogs leave the others as
    /// long as they would have.
    pub fn restore(&mut self, saved: &SavedCommands, scene: &Scene) {
        let passed = self.watch_time().saturating_sub(saved.saved_at);
        for object in std::mem::take(&mut self.commanded) {
            self.slots[object.0] = Slot::of(&self.objects[object].info.kind, scene);
        }
        for (object, slot) in &saved.slots {
            self.slots[object.0] = slot.later(passed);
            self.commanded.push(*object);
        }
    }

    fn watch_time(&self) -> u64 {
        self.hub.throttle().watch_time(self.hub.now_ns())
    }

    pub fn new(hub: Arc<Hub>, scene: &Scene, wrenches: &Table<BodyId, Wrench>) -> Self {
        let mut link = Self {
            objects: hub.objects().clone(),
            hub,
            writer: SnapshotWriter::new(Snapshot::default()),
            slots: Vec::new(),
            commanded: Vec::new(),
            rank: Vec::new(),
            arrivals: Arrivals::default(),
        };
        link.follow_scene(scene, wrenches);
        link
    }

    /// Makes place for what the hub and the scene hold now.
    pub fn follow_scene(&mut self, scene: &Scene, wrenches: &Table<BodyId, Wrench>) {
        self.objects = self.hub.objects().clone();
        let new = self.objects.iter().skip(self.slots.len());
        self.slots.extend(new.map(|object| Slot::of(&object.info.kind, scene)));
        // Positions are kept for good, commands of what is gone are not.
        for (slot, _) in self.slots.iter_mut().zip(self.objects.iter()).filter(|(_, object)| object.is_removed()) {
            *slot = Slot::Idle;
        }
        let live = self.objects.entries().filter(|(_, object)| !object.is_removed());
        let mut order: Vec<HubIndex> = live.map(|(object, _)| object).collect();
        order.sort_by_cached_key(|&object| scene.visiting_key(self.objects[object].info.kind.object()));
        self.arrivals.of.resize(self.objects.len(), 0);
        self.rank = vec![0; self.objects.len()];
        let live_count = order.len();
        for (rank, object) in order.into_iter().enumerate() {
            self.rank[object.0] = rank;
        }
        self.commanded.retain(|&object| !self.objects[object].is_removed());
        self.commanded.sort_by_key(|&object| self.rank[object.0]);
        self.commanded.reserve(live_count);
        self.writer = SnapshotWriter::new(scene.snapshot(wrenches));
        self.hub.set_visuals(scene.visuals(self.hub.generation()));
    }

    /// Tells the hub which objects are no longer part of the scene.
    pub fn remove_objects(&mut self, scene: &Scene) {
        let is_gone = |object: &HubObject| {
            !object.is_removed() && object.info.kind.object().is_some_and(|object| scene.is_removed(object))
        };
        let gone = self.objects.entries().filter(|(_, object)| is_gone(object)).map(|(position, _)| position);
        self.hub.remove_objects(gone.collect::<Vec<_>>());
    }

    /// The command in force for the body at position `object`, to be changed; no watchdog follows it. `None` when that
    /// is no body.
    pub fn body_command(&mut self, object: HubIndex) -> Option<&mut RigidBodyCommand> {
        let Some(Slot::Body(_, inbox)) = self.slots.get_mut(object.0) else { return None };
        note_commanded(&mut self.commanded, &self.rank, object);
        self.arrivals.note(object);
        Some(inbox.command_mut())
    }

    /// [`body_command`](Self::body_command) for an actuator.
    pub fn actuator_command(&mut self, object: HubIndex) -> Option<&mut ActuatorCommand> {
        let Some(Slot::Other(commands)) = self.slots.get_mut(object.0) else { return None };
        let inbox = commands.inbox().downcast_mut::<Inbox<ActuatorCommand>>()?;
        note_commanded(&mut self.commanded, &self.rank, object);
        self.arrivals.note(object);
        Some(inbox.command_mut())
    }

    /// The newest command to the nearest objects that were commanded, in words: what it asks for, and to whom it went.
    /// `None` if there was none. `near` says how near bodies are, and with them the other objects of their models.
    pub fn last_command(&self, near: &Table<BodyId, Nearness>, scene: &Scene) -> Option<String> {
        let model_of =
            |object: HubIndex| self.objects[object].info.kind.object().and_then(|object| scene.model_of(object));
        let models: Vec<_> = (scene.bodies.iter().zip(near.iter()))
            .filter(|(_, near)| **near < Nearness::Apart)
            .map(|(body, _)| Some(body.identity.model))
            .collect();
        let nearness = |object: HubIndex| match self.slots[object.0] {
            Slot::Body(body, _) => near[body],
            _ if models.contains(&model_of(object)) => Nearness::SameModel,
            _ => Nearness::Apart,
        };
        // A command that its watchdog has cleared, or that asks for nothing, is not what moves something.
        let is_idle = |object: HubIndex| match &self.slots[object.0] {
            Slot::Idle => true,
            Slot::Body(_, inbox) => inbox.command().is_idle(),
            Slot::Other(_) => false,
        };
        let order = |object: HubIndex| (nearness(object), is_idle(object), Reverse(self.arrivals.of[object.0]));
        let newest = self.commanded.iter().copied().min_by_key(|&object| order(object))?;
        let command = match &self.slots[newest.0] {
            Slot::Body(_, inbox) => format!("{} ", inbox.command()),
            _ => String::new(),
        };
        Some(format!("{command}to `{}`", self.objects[newest].info.identifier))
    }

    /// Takes what waits in the mailboxes.
    fn fetch(&mut self, physics: &mut Physics, notices: &mut Vec<String>) {
        let Self { hub, objects, slots, commanded, rank, arrivals, .. } = self;
        let order = hub.running_order();
        objects.take_pending(|object| {
            if objects[object].is_removed() {
                return;
            }
            let slot = &mut slots[object.0];
            let is_new = slot.fetch(&objects[object].channel, order, &mut physics.scene, notices);
            if let (Slot::Other(commands), Some(id)) = (slot, objects[object].info.kind.object()) {
                if let Some(entry) = commands.new_parameters().and_then(|parameters| entry_of(id, parameters)) {
                    physics.note(&entry);
                }
            }
            if is_new {
                note_commanded(commanded, rank, object);
                arrivals.note(object);
            }
        });
    }

    /// Executes the commands in force.
    fn execute(&mut self, physics: &mut Physics, notices: &mut Vec<String>) {
        if self.commanded.is_empty() {
            return;
        }
        let now = self.watch_time();
        for &object in &self.commanded {
            match &mut self.slots[object.0] {
                Slot::Idle => (),
                Slot::Body(index, inbox) => {
                    inbox.check_watchdog(now);
                    physics.note(&body_entry(*index, inbox.command()));
                    physics.command_body(*index, inbox.command());
                }
                Slot::Other(commands) => {
                    commands.execute(now, &mut physics.scene, notices);
                    let object = self.objects[object].info.kind.object();
                    if let Some(entry) = object.and_then(|object| entry_of(object, commands.inbox())) {
                        physics.note(&entry);
                    }
                }
            }
        }
    }
}

fn body_entry(body: BodyId, command: &RigidBodyCommand) -> Entry<'_> {
    Entry::Body { body: body.index(), command: Cow::Borrowed(command) }
}

/// The entry of what is in force for an object, or of its parameters; `None` for what does nothing.
fn entry_of(object: ObjectId, inbox: &mut dyn Any) -> Option<Entry<'_>> {
    fn command<C: Command + Clone + 'static>(inbox: &mut dyn Any) -> Option<Cow<'_, C>> {
        inbox.downcast_ref::<Inbox<C>>().map(|inbox| Cow::Borrowed(inbox.command()))
    }
    let index = object.index;
    match object.kind {
        ObjectType::Camera | ObjectType::Light if inbox.is::<Inbox<PoseCommand>>() => {
            command(inbox).map(|command| Entry::Pose { object, command })
        }
        ObjectType::Camera => command(inbox).map(|parameters| Entry::Camera { camera: index, parameters }),
        ObjectType::Light => command(inbox).map(|parameters| Entry::Light { light: index, parameters }),
        ObjectType::SoftBody => command(inbox).map(|command| Entry::SoftBody { soft: index, command }),
        ObjectType::Actuator => command(inbox).map(|command| Entry::Actuator { actuator: index, command }),
        ObjectType::Vehicle => command(inbox).map(|command| Entry::Vehicle { vehicle: index, command }),
        _ => None,
    }
}

/// Puts `object` among those that are visited in each iteration.
fn note_commanded(commanded: &mut Vec<HubIndex>, rank: &[usize], object: HubIndex) {
    if let Err(place) = commanded.binary_search_by_key(&rank[object.0], |&other| rank[other.0]) {
        commanded.insert(place, object);
    }
}

impl Simulation {
    /// Executes the newest commands.
    ///
    /// # Errors
    /// [`LostState`] when a finite command has a result that is not, such as a goal so far off that the velocity
    /// towards it overflows.
    pub(super) fn execute_commands(&mut self) -> Result<(), LostState> {
        self.execute_volume_orders();
        let Some(link) = &mut self.link else { return Ok(()) };
        link.fetch(&mut self.physics, &mut self.notices);
        link.execute(&mut self.physics, &mut self.notices);
        if link.commanded.is_empty() {
            return Ok(());
        }
        self.check_state()
    }

    /// Whether a recording is replayed, in which others move nothing.
    pub(super) fn is_replaying(&self) -> bool {
        self.link.as_ref().is_some_and(|link| link.hub.is_replaying())
    }

    /// [`is_replaying`](Self::is_replaying) when somebody wants to move something, which is said to the user.
    pub(super) fn refuses(&self) -> bool {
        self.link.as_ref().is_some_and(|link| link.hub.refuses())
    }

    /// Ends a replay: from now on others move the simulation, which holds nothing for a user who is not there.
    pub(super) fn end_replay(&mut self) {
        self.release_picked();
        if let Some(link) = &self.link {
            link.hub.set_replaying(false);
        }
    }

    /// Whether states go anywhere.
    pub(super) fn is_listened_to(&self) -> bool {
        self.link.as_ref().is_some_and(|link| link.hub.is_listening())
    }

    /// Publishes the states. `wall_time` in s.
    pub(super) fn publish(&mut self, wall_time: f64, timing: Timing) {
        let Some(link) = self.link.as_mut().filter(|link| link.hub.is_listening()) else { return };
        let Link { hub, writer, .. } = link;
        // When readers hold every spare snapshot they see this state one iteration later. There is no later one when a
        // client waits for just this state.
        while !hub.publish(writer, |snapshot| self.physics.fill(snapshot, wall_time, timing))
            && !hub.throttle().is_open()
        {
            std::thread::yield_now();
        }
    }

    /// Tells clients that the state of this iteration is published.
    pub(super) fn note_published(&self) {
        if let Some(link) = &self.link {
            link.hub.throttle().note_published(link.hub.now_ns());
        }
    }

    /// Tells clients that a reset is published.
    pub(super) fn note_reset(&self) {
        if let Some(link) = &self.link {
            link.hub.note_reset();
        }
    }

    /// Tells clients that the state was lost, or that all is well again.
    pub(super) fn tell_lost(&self, problem: Option<&LostState>) {
        if let Some(link) = &self.link {
            let sentence = |problem: &LostState| format!("lost at step {}: {problem}; a reset resumes", problem.step);
            link.hub.set_lost(problem.map(sentence));
        }
    }

    /// Tells clients what the physics thread does.
    pub(super) fn tell_activity(&self, activity: Activity) {
        if let Some(link) = &self.link {
            link.hub.throttle().set_activity(activity);
        }
    }

    /// Whether clients hold the simulation between iterations.
    pub(super) fn is_throttled(&self) -> bool {
        self.link.as_ref().is_some_and(|link| link.hub.throttle().is_throttling())
    }

    /// Whether clients order iterations one by one.
    pub(super) fn is_stepped_by_orders(&self) -> bool {
        self.link.as_ref().is_some_and(|link| link.hub.throttle().is_stepped_by_orders())
    }

    /// Applies a whole command to a body; it acts in the next update.
    pub fn command_body(&mut self, body: BodyId, command: &RigidBodyCommand) {
        self.physics.note(&body_entry(body, command));
        self.physics.command_body(body, command);
    }

    /// Applies a command to the `index`-th active joint of a body: effort (N·m, N), position (rad, m) or velocity
    /// (rad/s, m/s). False when there is no such joint or the value is not finite.
    pub fn command_joint(&mut self, body: BodyId, index: usize, kind: JointCommandType, value: f64) -> bool {
        self.physics.note(&Entry::Joint { body: body.index(), index, kind, value });
        self.physics.command_joint(body, index, kind, value)
    }

    /// Applies a whole command to a vehicle; it acts in the next update.
    pub fn command_vehicle(&mut self, vehicle: VehicleId, command: &VehicleCommand) {
        self.physics.note(&Entry::Vehicle { vehicle: vehicle.index(), command: Cow::Borrowed(command) });
        self.physics.scene.command_vehicle(vehicle, command);
    }

    /// Executes a command of an actuator: it fixes a body to its parent, or releases it. A sentence when what the command names is not there.
    pub fn command_actuator(&mut self, actuator: ActuatorId, command: &ActuatorCommand) -> Option<String> {
        self.physics.note(&Entry::Actuator { actuator: actuator.index(), command: Cow::Borrowed(command) });
        self.physics.scene.command_actuator(actuator, command)
    }

    /// Cuts a volume, between iterations; what was removed. It is seen with the next publication.
    ///
    /// # Errors
    /// [`VolumeError`]; nothing is cut then.
    pub fn carve(&mut self, volume: VolumeId, command: &CarveCommand) -> Result<Carved, VolumeError> {
        self.physics.note(&Entry::Carve { volume: volume.index(), command: Cow::Borrowed(command) });
        let (stamp, sim_time, sim_step) =
            (self.physics.stamp_now(), self.physics.time.sim_time, self.physics.sim_step());
        let carved = self.physics.scene.carve(volume, command)?;
        if let Some(link) = self.link.as_ref().filter(|_| !carved.indices.is_empty()) {
            link.hub.tell_cut(|| Cut { volume, stamp, sim_time, sim_step, carved: carved.clone() });
        }
        Ok(carved)
    }

    /// Switches a tool of a volume on or off, or gives it a tip of another radius, m.
    ///
    /// # Errors
    /// [`VolumeError::Unknown`], [`VolumeError::Tool`].
    pub fn set_tool(
        &mut self,
        volume: VolumeId,
        tool: usize,
        on: Option<bool>,
        radius: Option<f64>,
    ) -> Result<(), VolumeError> {
        self.physics.set_tool(volume, tool, on, radius)
    }

    /// Adds a tool to those of a volume, for as long as the scene lasts; its place among them.
    ///
    /// # Errors
    /// [`VolumeError`]; nothing is added then.
    pub fn add_tool(&mut self, volume: VolumeId, tool: &VolumeTool) -> Result<usize, VolumeError> {
        let place = self.physics.add_tool(volume, tool)?;
        self.show_changed_looks();
        Ok(place)
    }

    /// Tells what tools have cut in the latest update.
    pub(super) fn tell_cuts(&self) {
        let Some(link) = &self.link else { return };
        for (volume, found) in self.physics.scene.volumes.entries() {
            let carved = found.cut_by_tools();
            if !carved.indices.is_empty() {
                let (sim_time, sim_step) = (self.physics.time.sim_time, self.physics.sim_step());
                let stamp = self.physics.stamp_now();
                link.hub.tell_cut(|| Cut { volume, stamp, sim_time, sim_step, carved: carved.clone() });
            }
        }
    }

    /// Executes the commands of volumes that wait.
    fn execute_volume_orders(&mut self) {
        // What comes meanwhile waits for the next time, so that no sender keeps the physics here.
        let waiting = self.link.as_ref().map_or(0, |link| link.hub.count_volume_orders());
        for _ in 0..waiting {
            let order = self.link.as_ref().and_then(|link| link.hub.take_volume_order());
            let Some((_, volume, command)) = order else { break };
            let done = match command {
                VolumeCommand::Carve(command) => self.carve(volume, &command).map(|_| ()),
                VolumeCommand::Restore => self.restore_voxels(volume),
                VolumeCommand::Tool { tool, on, radius } => self.set_tool(volume, tool, on, radius),
            };
            if let Err(error) = done {
                self.notices.push(format!("a command of a volume is ignored: {error}"));
            }
        }
    }

    /// Gives a volume the voxels of the start back, as a reset does.
    ///
    /// # Errors
    /// [`VolumeError::Unknown`].
    pub fn restore_voxels(&mut self, volume: VolumeId) -> Result<(), VolumeError> {
        self.physics.restore_voxels(volume)
    }

    /// Draws the node of a soft body that is nearest to `point` (m, world axes) and within `radius` of it towards
    /// `goal` before each sub-step from now on: what picking with a mouse does. The node, or `None` when none is that
    /// near.
    pub fn pick_soft_node(
        &mut self,
        soft: SoftBodyId,
        point: &Vector3<f64>,
        radius: f64,
        goal: Vector3<f64>,
    ) -> Option<usize> {
        let Scene { soft_bodies, world, .. } = &mut self.physics.scene;
        let handle = soft_bodies[soft].handle;
        let node = world.nearest_node(handle, point, radius)?;
        self.drag_soft_node(soft, node, Some(goal)).then_some(node)
    }

    /// Moves the goal of a picked node, or releases it.
    pub fn drag_soft_node(&mut self, soft: SoftBodyId, node: usize, goal: Option<Vector3<f64>>) -> bool {
        self.physics.note(&Entry::PickNode { soft: soft.index(), node, goal });
        self.pull_soft_node(soft, node, goal)
    }

    /// [`drag_soft_node`](Self::drag_soft_node) as part of something else.
    pub(super) fn pull_soft_node(&mut self, soft: SoftBodyId, node: usize, goal: Option<Vector3<f64>>) -> bool {
        let Scene { soft_bodies, world, .. } = &mut self.physics.scene;
        world.pull_node(soft_bodies[soft].handle, node, goal)
    }

    /// Sets a state; it acts in the next update.
    ///
    /// # Errors
    /// [`SetStateError`]; nothing has changed then.
    pub(super) fn set_state(&mut self, change: &StateChange) -> Result<(), SetStateError> {
        self.physics.scene.set_state(change)?;
        self.physics.note(&Entry::State { change: Cow::Borrowed(change) });
        Ok(())
    }

    /// Changes masses, surfaces, limits, gains, gravity, colours.
    ///
    /// # Errors
    /// [`ParameterError`]; nothing has changed then.
    pub(super) fn set_parameters(&mut self, change: &ParameterChange) -> Result<(), ParameterError> {
        self.physics.scene.set_parameters(change)?;
        self.physics.note(&Entry::Parameters { change: Cow::Borrowed(change) });
        if !change.colors.is_empty() {
            self.show_changed_looks();
        }
        Ok(())
    }

    /// Puts a camera or a light at a pose in its parent's frame.
    pub(super) fn place(&mut self, object: ObjectId, pose: Isometry3<f64>) {
        self.physics.note(&Entry::Place { object, pose });
        match object.kind {
            ObjectType::Camera => self.physics.scene.cameras[CameraId::new(object.index)].attached.pose = pose,
            ObjectType::Light => self.physics.scene.lights[LightId::new(object.index)].attached.pose = pose,
            _ => (),
        }
    }

    /// Adds a force (N) at the centre of mass and a torque (N·m), world axes, for the next update.
    pub fn apply_wrench(&mut self, body: BodyId, force: Vector3<f64>, torque: Vector3<f64>) {
        self.command_body(body, &RigidBodyCommand::wrench(force, torque));
    }

    /// Sets the velocity of a body, m/s and rad/s, world axes.
    pub fn set_velocity(&mut self, body: BodyId, linear: Vector3<f64>, angular: Vector3<f64>) {
        self.command_body(body, &RigidBodyCommand::velocity(linear, angular));
    }

    /// Follows a pose of the body frame in the world for one iteration; `orientation` is a quaternion `[x, y, z, w]`.
    pub fn follow_pose(&mut self, body: BodyId, position: Vector3<f64>, orientation: [f64; 4]) {
        self.command_body(body, &RigidBodyCommand::pose(position, orientation));
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

    /// Whether clients let no iteration go on.
    pub(super) fn is_held_by_clients(&self) -> bool {
        self.link.as_ref().is_some_and(|link| !link.hub.throttle().is_open())
    }

    /// Counts the iteration for throttling clients; true when they ask for steps of no iterations.
    pub(super) fn count_for_clients(&self, counter: &mut u32) -> bool {
        self.link.as_ref().is_some_and(|link| {
            link.hub.throttle().check_watchdog(link.hub.now_ns());
            link.hub.throttle().count(counter)
        })
    }

    /// Does the resets that clients or plugins asked for; what was done, if anything.
    pub(super) fn do_requested_resets(&mut self) -> Option<Reset> {
        let from_clients = self.link.as_ref().map(|link| link.hub.take_resets()).unwrap_or_default();
        let done = self.do_resets(from_clients);
        done.max(self.do_plugin_resets())
    }

    /// Does the resets that plugins asked for; what was done, if anything.
    pub(super) fn do_plugin_resets(&mut self) -> Option<Reset> {
        let resets = self.take_plugin_resets();
        self.do_resets(resets)
    }

    fn do_resets(&mut self, resets: Resets) -> Option<Reset> {
        match resets {
            Resets { world: Some(asked), .. } => Some(self.reset_world_asked(asked)),
            Resets { bodies: true, .. } => Some(self.reset_bodies_or_lost_world()),
            _ => None,
        }
    }

    /// Forgets commands that are in force or wait if they came before `time`. Parameters that wait are taken over first:
    /// they are settings.
    pub(super) fn forget_commands_before(&mut self, time: Instant) {
        let Some(link) = &mut self.link else { return };
        link.fetch(&mut self.physics, &mut self.notices);
        // Of those of volumes the later ones wait on, in order.
        let waiting = link.hub.count_volume_orders();
        let orders: Vec<_> = std::iter::from_fn(|| link.hub.take_volume_order()).take(waiting).collect();
        for (_, volume, command) in orders.into_iter().filter(|(came, ..)| *came >= time) {
            let _ = link.hub.post_volume(volume, command);
        }
        let time_ns = link.hub.at_ns(time);
        let Link { slots, commanded, .. } = link;
        commanded.retain(|&object| !slots[object.0].forget_before(time_ns));
    }

    /// Whether clients or plugins asked for a reset that was not done yet.
    pub(super) fn reset_is_requested(&self) -> bool {
        self.link.as_ref().is_some_and(|link| link.hub.reset_requested()) || self.plugins_want_reset()
    }
}
