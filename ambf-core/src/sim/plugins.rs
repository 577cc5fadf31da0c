//! The simulation's side of its plugins: when they are called, and what they can see and do.

use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::Arc;
use std::time::Instant;

use nalgebra::{Isometry3, Vector3};

use super::physics::{Physics, Time};
use super::session::Entry;
use super::Simulation;
use crate::adf::{node_text, PluginEntry, SourcePos, VolumeTool};
use crate::bullet::{Constraint, ConstraintHandle, ConstraintKind, Ray, RayTarget};
use crate::comm::{JointCommandType, Resets, RigidBodyCommand, ToolReading};
use crate::ids::{BodyId, CameraId, GhostId, Id, JointId, LightId, ModelId, SoftBodyId, Table, VehicleId, VolumeId};
use crate::plugin::run::{Access, Phase, Plugins, Shared, TextOf, Wanted};
use crate::plugin::{
    BodyState, Clock, Command, CommandError, Drawings, Hit, Input, JointFrame, JointState, ObjectId, ObjectType,
    PluginReport, PluginSetup, StateSnapshot, Subject, ToolState, Touch,
};
use crate::scene::{Joint, JointType, Scene};

/// What the simulation keeps for its plugins.
#[derive(Default)]
pub(super) struct PluginState {
    /// Plugin that is being called.
    caller: u64,
    attachments: Vec<Attachment>,
    /// Number of the latest attachment.
    pub(super) next_attachment: u64,
    /// What plugins have attached while they began: part of the start, to which a reset returns.
    first_attachments: Vec<Attachment>,
    /// The plugin that is called begins.
    begins: bool,
    /// Commands that were left before this moment are not executed.
    forgotten_before: Option<Instant>,
    /// Where requests to the loop are left, also while the plugins themselves are being called.
    shared: Option<Arc<Shared>>,
    /// What plugins show in windows.
    pub(super) drawings: Drawings,
}

/// Bodies that a plugin holds together.
#[derive(Clone)]
pub(super) struct Attachment {
    number: u64,
    plugin: u64,
    bodies: [BodyId; 2],
    /// Pose of the first in the second, inertial frames.
    offset: Isometry3<f64>,
    constraint: ConstraintHandle,
}

impl PluginState {
    /// What plugins hold. Numbers go on, so that none names another thing after a state was restored.
    pub fn save(&self) -> Vec<Attachment> {
        // All fields by name, so that no new one is forgotten.
        let Self {
            caller: _,
            attachments,
            next_attachment: _,
            // Of the start, not of the moment.
            first_attachments: _,
            begins: _,
            forgotten_before: _,
            shared: _,
            drawings: _,
        } = self;
        attachments.clone()
    }

    pub fn restore(&mut self, saved: &[Attachment]) {
        saved.clone_into(&mut self.attachments);
    }

    /// Removes the constraints that `which` is true for; true if there was any.
    fn detach_where(&mut self, scene: &mut Scene, which: impl Fn(&Attachment) -> bool) -> bool {
        let before = self.attachments.len();
        self.attachments.retain(|attachment| {
            let goes = which(attachment);
            if goes {
                scene.world.remove_constraint(attachment.constraint);
            }
            !goes
        });
        self.attachments.len() < before
    }
}

impl Simulation {
    /// Loads the plugins that the scene and `setup` ask for, in this order: those of the environment's objects, the
    /// environment's, the world's; for each model those of its objects, then its own; those of the command line; those
    /// of the launch file. A plugin that cannot be loaded is left out. Models that are added later bring theirs along.
    /// Without a call of this, no plugin runs.
    pub fn load_plugins(&mut self, setup: PluginSetup) -> PluginReport {
        self.close_plugins();
        let plugins = Plugins::new(setup, self.plugin_state.drawings.clone());
        self.plugin_state.shared = Some(Arc::clone(&plugins.shared));
        self.plugins = Some(Box::new(plugins));
        let mut report = PluginReport::default();
        self.with_plugins(|plugins, access| {
            for model in access.physics.scene.models.ids() {
                access.load_model_plugins(plugins, model, &mut report);
                if model == ModelId::ENVIRONMENT {
                    access.load_world_plugins(plugins, &mut report);
                }
                access.announce(plugins, model, true);
            }
            let command_line: Vec<PluginEntry> =
                plugins.setup.command_line.iter().map(|path| named_by_itself(path)).collect();
            for entry in &command_line {
                let directory = plugins.setup.search.working_folder.clone();
                let wanted = Wanted { entry, subject: Subject::Simulator, model: None, node: String::new(), directory };
                access.load(plugins, wanted, &mut report);
            }
            let launch = plugins.setup.launch.clone();
            let source = launch.first().map(|entry| entry.source.clone());
            access.load_entries(plugins, &launch, (Subject::Simulator, None), source, &mut report);
            access.arrange(plugins);
        });
        report
    }

    /// Loads the plugins of a model that was just added; sentences about what is left out.
    pub(super) fn start_model_plugins(&mut self, model: ModelId) -> Vec<String> {
        let mut report = PluginReport::default();
        self.with_plugins(|plugins, access| {
            access.load_model_plugins(plugins, model, &mut report);
            access.announce(plugins, model, true);
            access.arrange(plugins);
        });
        report.problems
    }

    /// Tells of a model that is about to leave, and closes its plugins.
    pub(super) fn end_model_plugins(&mut self, model: ModelId) {
        self.with_plugins(|plugins, access| {
            access.announce(plugins, model, false);
            plugins.close_model(access, model.index());
            access.arrange(plugins);
        });
        let own: Table<BodyId, bool> =
            self.physics.scene.bodies.iter().map(|body| body.identity.model == model).collect();
        self.detach_plugins_from(|body| own[body]);
    }

    /// Undoes what plugins have attached to bodies that are about to leave.
    pub(super) fn detach_plugins_from(&mut self, is_going: impl Fn(BodyId) -> bool) {
        let goes = |attachment: &Attachment| attachment.bodies.iter().any(|&body| is_going(body));
        self.plugin_state.detach_where(&mut self.physics.scene, goes);
        self.plugin_state.first_attachments.retain(|attachment| !goes(attachment));
    }

    /// Whether plugins are running or were.
    pub fn has_plugins(&self) -> bool {
        self.plugins.as_ref().is_some_and(|plugins| !plugins.is_empty())
    }

    /// Calls plugins after an [`update`](Self::update) that made a step, in the order of the C++ program.
    pub(super) fn update_plugins(&mut self, phase: Phase) {
        if self.plugins.is_none() {
            return;
        }
        let (dt, tools) = (self.physics.time.interval, self.physics.scene.tool_count());
        self.with_plugins(|plugins, access| {
            plugins.update(access, phase, dt);
            if phase == Phase::Simulator {
                let Plugins { incoming, shared, .. } = plugins;
                incoming.publish(shared, |snapshot| access.fill_states(snapshot));
            }
        });
        if self.physics.scene.tool_count() != tools {
            self.show_changed_looks();
        }
    }

    /// Undoes what plugins have attached, and forgets the commands that they left before `time`.
    pub(super) fn release_plugins_before(&mut self, time: Instant) {
        self.plugin_state.forgotten_before = Some(time);
        self.plugin_state.detach_where(&mut self.physics.scene, |_| true);
    }

    /// Attaches again what plugins had attached when they began, and tells them of the reset.
    pub(super) fn reset_plugins(&mut self) {
        let Self { plugin_state: PluginState { attachments, first_attachments, .. }, physics, .. } = self;
        let Scene { bodies, world, .. } = &mut physics.scene;
        for first in &*first_attachments {
            let [a, b] = first.bodies.map(|id| bodies[id].handle);
            if let Some(constraint) = world.add_constraint(a, b, &held_at(first.offset)) {
                attachments.push(Attachment { constraint, ..first.clone() });
            }
        }
        self.with_plugins(|plugins, access| plugins.reset(access));
    }

    /// Calls all plugins after a picture: for a program that has windows.
    pub fn plugins_after_picture(&mut self) {
        self.with_plugins(|plugins, _| plugins.graphics_update());
    }

    /// Tells the simulator's plugins of a use of a window: for a program that has windows.
    pub fn plugins_input(&mut self, input: &Input) {
        self.with_plugins(|plugins, _| plugins.input(input));
    }

    /// Closes all plugins: the simulator's, those of objects, of models, of the world, each in the reverse order of
    /// loading, each once. Dropping the simulation does the same.
    pub fn close_plugins(&mut self) {
        self.with_plugins(|plugins, access| plugins.close(access));
        self.plugins = None;
    }

    /// Lets plugins work with the physics, and collects what they have to say.
    fn with_plugins(&mut self, work: impl FnOnce(&mut Plugins, &mut SceneAccess<'_>)) {
        let Some(plugins) = &mut self.plugins else { return };
        work(plugins, &mut SceneAccess { physics: &mut self.physics, state: &mut self.plugin_state });
        self.notices.append(&mut plugins.notices);
        self.notices.extend(plugins.shared.said());
    }

    /// Collects what plugins have said in threads of their own.
    pub(super) fn hear_plugins(&mut self) {
        self.with_plugins(|_, _| ());
    }

    /// Does what a plugin did; `begins`: while it was loaded.
    pub(super) fn act_as_plugin(&mut self, plugin: u64, begins: bool, command: &Command) -> Result<(), CommandError> {
        self.plugin_state.begins = begins;
        let mut access = SceneAccess { physics: &mut self.physics, state: &mut self.plugin_state };
        access.act_as(plugin);
        let done = access.execute(command);
        self.plugin_state.begins = false;
        done.map(|_| ())
    }

    /// Releases what a plugin holds, as when it is closed.
    pub(super) fn release_plugin(&mut self, plugin: u64) {
        SceneAccess { physics: &mut self.physics, state: &mut self.plugin_state }.release(plugin);
    }

    /// Executes what plugins have left since the step before.
    pub(super) fn execute_posted(&mut self) {
        self.with_plugins(|plugins, access| {
            for (plugin, at, command) in plugins.shared.posted() {
                if access.state.forgotten_before.is_some_and(|time| at < time) {
                    continue;
                }
                access.act_as(plugin);
                if let Err(error) = access.execute(&command) {
                    plugins.notices.push(format!("a command that a plugin left failed: {command}: {error}"));
                }
            }
        });
    }

    /// Whether a plugin asked for a reset.
    pub(super) fn plugins_want_reset(&self) -> bool {
        self.plugins.as_ref().is_some_and(|plugins| {
            let requests = &plugins.shared.requests;
            requests.reset_world.is_waiting() || requests.reset_bodies.load(Ordering::Acquire)
        })
    }

    /// Takes what plugins asked for: reset of the world, of the bodies.
    pub(super) fn take_plugin_resets(&self) -> Resets {
        let Some(plugins) = &self.plugins else { return Resets::default() };
        let requests = &plugins.shared.requests;
        let world = requests.reset_world.take();
        // The usual case costs no exchange.
        let bodies =
            requests.reset_bodies.load(Ordering::Relaxed) && requests.reset_bodies.swap(false, Ordering::AcqRel);
        Resets { world, bodies }
    }

    /// Takes what plugins asked of the loop: pause or resume, manual steps.
    pub(super) fn take_plugin_requests(&self) -> (Option<bool>, u32) {
        let Some(plugins) = &self.plugins else { return (None, 0) };
        let requests = &plugins.shared.requests;
        (requests.take_pause(), requests.take_steps())
    }
}

/// The entry of a plugin that the command line names.
fn named_by_itself(path: &Path) -> PluginEntry {
    let name = path.display().to_string();
    let source = SourcePos { file: Path::new("--plugins").into(), line: 0, column: 0 };
    PluginEntry { name, filename: path.to_owned(), path: None, source }
}

/// What holds one body at a pose in another, inertial frames.
fn held_at(offset: Isometry3<f64>) -> Constraint {
    Constraint {
        kind: ConstraintKind::Fixed,
        frame_a: Isometry3::identity(),
        frame_b: offset,
        parameters: Vec::new(),
        feedback: false,
        disable_collisions: true,
    }
}

fn joint_state(joint: &Joint) -> JointState {
    let limits = joint.limits.map_or((f64::NEG_INFINITY, f64::INFINITY), |limits| (limits.low, limits.high));
    JointState {
        position: joint.position,
        velocity: joint.velocity,
        effort: joint.effort,
        limits,
        parent: joint.parent.index(),
        child: joint.child.index(),
    }
}

/// The simulation as its plugins can work with it.
struct SceneAccess<'a> {
    physics: &'a mut Physics,
    state: &'a mut PluginState,
}

impl SceneAccess<'_> {
    fn load_world_plugins(&mut self, plugins: &mut Plugins, report: &mut PluginReport) {
        let world = Arc::clone(&self.physics.scene.description);
        let source = Some(world.common.source.clone());
        self.load_entries(plugins, &world.common.plugins, (Subject::World, None), source, report);
    }

    fn load_model_plugins(&mut self, plugins: &mut Plugins, model: ModelId, report: &mut PluginReport) {
        let declared: Vec<_> =
            self.physics.scene.plugins.iter().filter(|place| place.model == model).cloned().collect();
        for place in declared {
            let subject = place.object.map_or(Subject::Model(model.index()), Subject::Object);
            let source = place.source;
            let node = node_text(&source);
            self.load_at(plugins, &place.entries, (subject, Some(model.index())), &source, node, report);
        }
    }

    /// Loads plugins that are declared at the root of a file.
    fn load_entries(
        &mut self,
        plugins: &mut Plugins,
        entries: &[PluginEntry],
        on: (Subject, Option<usize>),
        source: Option<SourcePos>,
        report: &mut PluginReport,
    ) {
        if let (Some(source), false) = (source, entries.is_empty()) {
            // The root is the whole file.
            let root = SourcePos { line: 0, column: 0, ..source };
            let node = node_text(&root);
            self.load_at(plugins, entries, on, &root, node, report);
        }
    }

    fn load_at(
        &mut self,
        plugins: &mut Plugins,
        entries: &[PluginEntry],
        (subject, model): (Subject, Option<usize>),
        source: &SourcePos,
        node: Result<String, crate::adf::LoadError>,
        report: &mut PluginReport,
    ) {
        let node = node.unwrap_or_else(|error| {
            report.problems.push(format!("{source}: plugins here cannot read their own keys: {error}"));
            String::new()
        });
        let directory = source.file.parent().unwrap_or(Path::new("")).to_owned();
        for entry in entries {
            let wanted = Wanted { entry, subject, model, node: node.clone(), directory: directory.clone() };
            self.load(plugins, wanted, report);
        }
    }

    fn arrange(&self, plugins: &mut Plugins) {
        let scene = &self.physics.scene;
        plugins.arrange(|model, object| {
            (scene.models[ModelId::new(model)].key.clone(), object.map(|object| scene.calling_key(object)))
        });
    }

    fn announce(&mut self, plugins: &mut Plugins, model: ModelId, added: bool) {
        if plugins.watches_models() {
            let objects = self.physics.scene.objects_of_model(model);
            plugins.model_changed(self, model.index(), &objects, added);
        }
    }

    fn load(&mut self, plugins: &mut Plugins, wanted: Wanted<'_>, report: &mut PluginReport) {
        let (entry, subject) = (wanted.entry, wanted.subject);
        let file = entry.filename.display();
        self.state.begins = true;
        let loaded = plugins.load(self, wanted);
        self.state.begins = false;
        match loaded {
            Ok(()) => report.loaded.push(format!("{} plugin {} ({file})", subject.kind().words(), entry.name)),
            Err(error) => {
                report.problems.push(format!("{}: plugin {} ({file}) is left out: {error}", entry.source, entry.name));
            }
        }
    }

    fn fill_states(&self, snapshot: &mut StateSnapshot) {
        let scene = &self.physics.scene;
        snapshot.clock = Access::clock(self);
        snapshot.bodies.resize(scene.bodies.len(), BodyState::default());
        for (i, state) in snapshot.bodies.iter_mut().enumerate() {
            *state = Access::body(self, i).unwrap_or(*state);
        }
        snapshot.joints.clear();
        snapshot.joints.extend(scene.joints.iter().map(joint_state));
    }

    /// What a plugin names by a number, if it is in the scene.
    fn live<I: Id + Into<ObjectId>>(&self, index: usize) -> Result<I, CommandError> {
        let id = I::from_index(index);
        self.physics.scene.has_object(id.into()).then_some(id).ok_or(CommandError::NoObject)
    }

    fn attach(&mut self, body: BodyId, to: BodyId) -> Result<u64, CommandError> {
        let Scene { bodies, world, .. } = &mut self.physics.scene;
        let [a, b] = [body, to].map(|id| bodies[id].handle);
        let (Some(pose), Some(other)) = (world.pose(a), world.pose(b)) else { return Err(CommandError::NoObject) };
        if body == to {
            return Err(CommandError::Refused);
        }
        let offset = other.inverse() * pose;
        let constraint = world.add_constraint(a, b, &held_at(offset)).ok_or(CommandError::Refused)?;
        let state = &mut self.state;
        state.next_attachment = state.next_attachment.wrapping_add(1);
        let (number, plugin) = (state.next_attachment, state.caller);
        let attachment = Attachment { number, plugin, bodies: [body, to], offset, constraint };
        if state.begins {
            state.first_attachments.push(attachment.clone());
        }
        state.attachments.push(attachment);
        Ok(number)
    }

    fn place(&mut self, object: ObjectId, pose: &Isometry3<f64>) -> Result<(), CommandError> {
        let index = object.index;
        if !self.physics.scene.has_object(object) {
            return Err(CommandError::NoObject);
        }
        let attached = match object.kind {
            ObjectType::Camera => &mut self.physics.scene.cameras[CameraId::new(index)].attached,
            ObjectType::Light => &mut self.physics.scene.lights[LightId::new(index)].attached,
            ObjectType::Ghost => &mut self.physics.scene.ghosts[GhostId::new(index)].attached,
            ObjectType::Volume => &mut self.physics.scene.volumes[VolumeId::new(index)].attached,
            _ => return Err(CommandError::Refused),
        };
        attached.pose = *pose;
        Ok(())
    }

    fn pull_node(&mut self, soft: SoftBodyId, node: usize, goal: Option<Vector3<f64>>) -> Result<(), CommandError> {
        let Scene { soft_bodies, world, .. } = &mut self.physics.scene;
        if node >= soft_bodies[soft].nodes {
            return Err(CommandError::NoObject);
        }
        world.pull_node(soft_bodies[soft].handle, node, goal);
        Ok(())
    }
}

impl Access for SceneAccess<'_> {
    fn act_as(&mut self, plugin: u64) {
        self.state.caller = plugin;
    }

    fn release(&mut self, plugin: u64) {
        self.physics.note(&Entry::PluginGone { plugin });
        self.state.detach_where(&mut self.physics.scene, |attachment| attachment.plugin == plugin);
        self.state.first_attachments.retain(|attachment| attachment.plugin != plugin);
    }

    fn clock(&self) -> Clock {
        let Time { sim_time, interval, iteration, .. } = self.physics.time;
        Clock { sim_time, dt: interval, step: iteration }
    }

    fn count(&self, kind: Option<ObjectType>) -> usize {
        kind.map_or(self.physics.scene.models.len(), |kind| self.physics.scene.object_count(kind))
    }

    fn find(&self, kind: Option<ObjectType>, text: &str) -> Option<usize> {
        match kind {
            Some(kind) => self.physics.scene.find_object(kind, text),
            None => self.physics.scene.find_any_model(text).map(ModelId::index),
        }
    }

    fn text(&self, what: TextOf, kind: Option<ObjectType>, index: usize) -> Option<String> {
        let Some(kind) = kind else {
            let model = self.physics.scene.models.get(ModelId::new(index))?;
            return Some(match what {
                TextOf::Name => model.description.name.clone(),
                TextOf::Identifier => model.key.clone(),
                TextOf::File => model.description.file.display().to_string(),
            });
        };
        let (name, identifier) = self.physics.scene.names_of(ObjectId { kind, index })?;
        match what {
            TextOf::Name => Some(name),
            TextOf::Identifier => Some(identifier),
            TextOf::File => None,
        }
    }

    fn model_of(&self, object: ObjectId) -> Option<usize> {
        self.physics.scene.model_of(object).map(ModelId::index)
    }

    fn body(&self, index: usize) -> Option<BodyState> {
        let world = &self.physics.scene.world;
        let body = self.physics.scene.bodies.get(BodyId::new(index))?;
        let (linear_velocity, angular_velocity) = world.velocity(body.handle)?;
        Some(BodyState {
            pose: body.pose(world),
            inertial_pose: world.pose(body.handle)?,
            linear_velocity,
            angular_velocity,
            mass: body.mass,
            inertia: body.inertia,
        })
    }

    fn joint(&self, index: usize) -> Option<JointState> {
        let joint: JointId = self.live(index).ok()?;
        Some(joint_state(&self.physics.scene.joints[joint]))
    }

    fn joint_frame(&self, index: usize) -> Option<JointFrame> {
        let joint: JointId = self.live(index).ok()?;
        let joint = &self.physics.scene.joints[joint];
        let is_angular = match joint.joint_type {
            JointType::Revolute => true,
            JointType::Prismatic => false,
            _ => return None,
        };
        Some(JointFrame { is_angular, pivot: joint.frames[0].translation.vector, axis: joint.axis })
    }

    fn gravity(&self, body: usize) -> Option<Vector3<f64>> {
        let body: BodyId = self.live(body).ok()?;
        let scene = &self.physics.scene;
        Some(scene.bodies[body].gravity.unwrap_or(scene.gravity))
    }

    fn pose(&self, object: ObjectId) -> Option<Isometry3<f64>> {
        self.physics.scene.pose_of(object)
    }

    fn values(&self, object: ObjectId, out: &mut Vec<f64>) -> Option<()> {
        self.physics.scene.values_of(object, out)
    }

    fn cast_ray(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> Option<Hit> {
        let mut hits = [None];
        self.physics.scene.world.cast_rays(&[Ray { from: *from, to: *to }], &mut hits);
        let hit = hits[0]?;
        let body = match hit.target {
            RayTarget::Body(handle) => self.physics.scene.bodies.id_of(handle),
            RayTarget::SoftBody(_) | RayTarget::Other => None,
        };
        Some(Hit { body: body.map(BodyId::index), point: hit.point, normal: hit.normal, fraction: hit.fraction })
    }

    fn contacts(&self, body: usize, out: &mut Vec<Touch>) -> Option<()> {
        let body: BodyId = self.live(body).ok()?;
        let mut contacts = Vec::new();
        self.physics.scene.world.contacts(self.physics.scene.bodies[body].handle, f64::INFINITY, &mut contacts);
        out.extend(contacts.iter().map(|contact| Touch {
            body: self.physics.scene.bodies.id_of(contact.other).map(BodyId::index),
            point: contact.point,
            normal: contact.normal,
            distance: contact.distance,
            impulse: contact.impulse,
        }));
        Some(())
    }

    fn add_tool(&mut self, volume: usize, tool: &VolumeTool) -> Result<usize, String> {
        let volume: VolumeId = self.live(volume).map_err(|error| error.to_string())?;
        self.physics.add_tool(volume, tool).map_err(|error| error.to_string())
    }

    fn tool(&self, volume: usize, tool: usize) -> Option<ToolState> {
        let volume: VolumeId = self.live(volume).ok()?;
        let ToolReading { radius, is_on, is_touching, force, .. } = self.physics.scene.tool(volume, tool)?;
        Some(ToolState { radius, is_on, is_touching, force })
    }

    fn set_tool(
        &mut self,
        volume: usize,
        tool: usize,
        on: Option<bool>,
        radius: Option<f64>,
    ) -> Result<(), CommandError> {
        let volume = self.live(volume)?;
        self.physics.set_tool(volume, tool, on, radius).map_err(|_| CommandError::Refused)
    }

    fn restore_voxels(&mut self, volume: usize) -> Result<(), CommandError> {
        let volume = self.live(volume)?;
        self.physics.restore_voxels(volume).map_err(|_| CommandError::Refused)
    }

    fn execute(&mut self, command: &Command) -> Result<u64, CommandError> {
        if !command.is_finite() {
            return Err(CommandError::NotFinite);
        }
        let done = self.execute_finite(command)?;
        let asks_loop =
            matches!(command, Command::ResetWorld | Command::ResetBodies | Command::Pause(_) | Command::Step(_));
        // What failed has changed nothing.
        if !asks_loop {
            let (plugin, begins) = (self.state.caller, self.state.begins);
            self.physics.note(&Entry::Plugin { plugin, begins, command: *command });
        }
        Ok(done)
    }
}

impl SceneAccess<'_> {
    fn execute_finite(&mut self, command: &Command) -> Result<u64, CommandError> {
        match *command {
            Command::Wrench { body, force, torque } => {
                let body = self.live(body)?;
                self.physics.command_body(body, &RigidBodyCommand::wrench(force, torque));
            }
            Command::Velocity { body, linear, angular } => {
                let body = self.live(body)?;
                self.physics.command_body(body, &RigidBodyCommand::velocity(linear, angular));
            }
            Command::Pose { body, pose } => {
                let body: BodyId = self.live(body)?;
                let Scene { bodies, world, .. } = &mut self.physics.scene;
                world.set_pose(bodies[body].handle, &(pose * bodies[body].inertial_offset));
            }
            Command::FollowPose { body, pose } => {
                let body = self.live(body)?;
                let command = RigidBodyCommand::pose(pose.translation.vector, pose.rotation.coords.into());
                self.physics.command_body(body, &command);
            }
            Command::Joint { joint, kind, value } => {
                let joint = self.live(joint)?;
                if matches!(kind, JointCommandType::Unknown(_)) {
                    return Err(CommandError::Unknown);
                }
                self.physics.apply_joint_command(joint, kind, value);
            }
            Command::Place { object, pose } => self.place(object, &pose)?,
            Command::Hold { actuator, body } => {
                let actuator = self.live(actuator)?;
                let body = body.map(|body| self.live(body)).transpose()?;
                self.physics.scene.hold_with_actuator(actuator, body);
            }
            Command::Drive { vehicle, wheel, steering, power, brake } => {
                let vehicle: VehicleId = self.live(vehicle)?;
                let Scene { vehicles, world, .. } = &mut self.physics.scene;
                if !vehicles[vehicle].drive_wheel(world, wheel, steering, power, brake) {
                    return Err(CommandError::NoObject);
                }
            }
            Command::SoftForce { soft, force } => {
                let soft: SoftBodyId = self.live(soft)?;
                self.physics.scene.world.apply_soft_force(self.physics.scene.soft_bodies[soft].handle, &force);
            }
            Command::PullNode { soft, node, goal } => self.pull_node(self.live(soft)?, node, goal)?,
            Command::Attach { body, to } => return self.attach(self.live(body)?, self.live(to)?),
            Command::Detach { attachment } => {
                let plugin = self.state.caller;
                let is_own = |own: &Attachment| own.number == attachment && own.plugin == plugin;
                if !self.state.detach_where(&mut self.physics.scene, is_own) {
                    return Err(CommandError::NoObject);
                }
            }
            Command::ResetWorld | Command::ResetBodies | Command::Pause(_) | Command::Step(_) => {
                if let Some(shared) = &self.state.shared {
                    shared.requests.keep(command);
                }
            }
        }
        Ok(0)
    }
}
