//! Descriptions → live objects in a Bullet world.

mod actuator;
mod articulate;
mod assemble;
mod attached;
mod body;
mod build;
mod carriage;
mod commands;
mod descriptions;
mod elements;
mod empty;
mod end_effector;
mod gesture;
mod ghost;
mod graph;
mod hulls;
mod identity;
mod joint;
mod keyframes;
mod list;
mod load;
mod mechanism;
mod names;
mod object;
mod parameters;
mod physics;
mod planned;
mod progress;
mod remove;
mod rigid_bodies;
mod robot_description;
mod saved;
mod sensor;
mod shape;
mod shared;
mod soft_body;
mod states;
mod targets;
mod tool;
mod used_files;
mod vehicle;
mod visuals;
mod volume;
mod voxels;

pub use actuator::Actuator;
pub use ambf_plugin::{ObjectId, ObjectType};
pub use attached::{Attached, Camera, Light, Parent};
pub use body::{Bodies, Body};
pub(crate) use commands::Commands;
use descriptions::SharedModel;
pub use descriptions::{shared_descriptions, shared_launch};
pub use end_effector::{EndEffectorParts, PreparedEndEffector};
pub use gesture::{CameraGesture, CameraPlace};
pub use ghost::Ghost;
pub use graph::{BodyGraph, Descendant};
pub use hulls::convex_hulls;
pub use identity::Identity;
pub use joint::{Joint, JointCoupling, JointType};
pub use list::Objects;
use list::{ObjectList, SceneObject, Update};
pub use load::{load, load_with_progress, read_model, Loaded, PreparedModel, SceneFiles, SceneReport};
pub use mechanism::{Mechanism, MechanismError};
pub use names::{Found, NameMap};
pub use object::DeclaredPlugins;
pub use parameters::{ParameterChange, ParameterError};
pub use physics::PhysicsOptions;
pub use progress::Progress;
pub use robot_description::{LinkFrame, RobotDescription, UNLIMITED, WORLD_LINK};
pub(crate) use saved::SavedScene;
pub use sensor::{LocalRay, Sensed, Sensor};
pub use shared::shared_shapes;
pub use soft_body::SoftBody;
pub use states::{SetStateError, StateChange};
pub use vehicle::{Vehicle, Wheel};
pub use visuals::{
    VisualActuator, VisualBody, VisualCamera, VisualJoint, VisualLight, VisualModel, VisualObject, VisualScene,
    VisualSensor, VisualSoftBody, VisualVehicle, VisualVolume,
};
pub use volume::{Volume, VolumeError};

use std::fmt;
use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};

use crate::adf::{self, Severity, SourcePos};
use crate::bullet::{ContactLists, Gyroscopic, JointReadings, Preset, World};
use crate::comm::{ActuatorCommand, ObjectInfo, ObjectKind, Rates, RigidBodyInfo, Snapshot, Wrench};
use crate::control::Profile;
use crate::ids::{
    ActuatorId, BodyId, CameraId, GhostId, JointId, LightId, ModelId, SensorId, SoftBodyId, Table, VehicleId, VolumeId,
};
use crate::text::one_line;

/// How a scene is built, beside what its files say.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SceneOptions {
    /// Put before every namespace.
    pub prefix: String,
    /// Publishing rates of all objects instead of their own.
    pub rates: Option<Rates>,
    /// Physics wanted; `None`: the world file's, else the default.
    pub physics: PhysicsOptions,
    /// Profile where neither `physics` nor the world file names one; `None`: legacy. Default: `None`.
    pub default_profile: Option<Profile>,
    /// Models with joints will be added later: where joints may be put into reduced coordinates, theirs may be too.
    /// Default: `false`.
    pub may_grow: bool,
    /// The process has many worlds and none of them runs in real time: memory of contact manifolds is taken as bodies
    /// come close, during steps, but for 8 pairs of bodies. Default: `false`, memory for 1024 pairs is taken at once.
    pub is_one_of_many: bool,
    /// States of the simulation can be [saved](crate::sim::Simulation::save). Default: `false`.
    pub savable: bool,
    /// The [wrenches](Joint::wrench) of all joints are measured, not only of those with `enable feedback`. Default: `false`.
    pub joint_wrenches: bool,
}

/// A remark on a scene: what was dropped, replaced or guessed while it was built.
#[derive(Debug, Clone, PartialEq)]
pub struct Note {
    /// How bad it is.
    pub severity: Severity,
    /// The element it is about.
    pub source: SourcePos,
    /// What is wrong and what is done instead.
    pub message: String,
    /// The name in the file that led to nothing, or to several objects; `None` where the remark is about something
    /// else.
    pub wanted: Option<String>,
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&one_line(&format!("{}: {}: {}", self.source, self.severity, self.message)))
    }
}

/// A model as part of a scene.
#[derive(Debug, Clone)]
pub struct ModelInfo {
    /// Namespace and file name, with the suffix that tells copies apart: models are visited in the order of these.
    pub key: String,
    /// What it was made from: also all that is only drawn (shaders, materials). Of a model that was removed only names
    /// and file.
    pub description: Arc<adf::Model>,
    /// It was taken out of the scene.
    pub removed: bool,
    /// What other worlds may use, too, while it is part of this one.
    shared: Option<Arc<SharedModel>>,
    /// Of a model that was removed: what its description was.
    fingerprint: u64,
}

/// All objects of a world, by index in order of creation. What is removed while running keeps its place, which the same
/// model takes again when it is added again.
pub struct Scene {
    /// Bullet's side. Its bodies are [`bodies`](Self::bodies), place for place.
    pub world: World,
    /// Rigid bodies.
    pub bodies: Bodies,
    /// Joints, those of unknown type included.
    pub joints: Table<JointId, Joint>,
    /// Soft bodies.
    pub soft_bodies: Objects<SoftBodyId, SoftBody>,
    /// Ghost objects.
    pub ghosts: Objects<GhostId, Ghost>,
    /// Sensors.
    pub sensors: Objects<SensorId, Sensor>,
    /// Actuators.
    pub actuators: Objects<ActuatorId, Actuator>,
    /// Vehicles.
    pub vehicles: Objects<VehicleId, Vehicle>,
    /// Cameras.
    pub cameras: Objects<CameraId, Camera>,
    /// Lights.
    pub lights: Objects<LightId, Light>,
    /// Volumes.
    pub volumes: Objects<VolumeId, Volume>,
    /// What hangs below what.
    pub graph: BodyGraph,
    /// Models in order of creation; the first is the environment.
    pub models: Table<ModelId, ModelInfo>,
    /// Prefix and namespace of the world object.
    pub namespace: String,
    /// Publishing rates of the world object.
    pub world_rates: Rates,
    /// World gravity, m/s².
    pub gravity: Vector3<f64>,
    /// Most sub-steps of an update.
    pub max_sub_steps: u32,
    /// Length of a sub-step, s; `None`: the user of the scene decides.
    pub sub_step: Option<f64>,
    /// Physics wanted.
    pub profile: Profile,
    /// Settings of the solver and of shapes instead of the profile's.
    pub preset: Option<Preset>,
    /// Share of the position error that every joint corrects in a sub-step; `None`: as the descriptions say.
    pub joint_erp: Option<f64>,
    /// Joints of all models are put into reduced coordinates; else only those of models with links without a mass.
    articulates_all: bool,
    /// How the gyroscopic torque is integrated.
    pub gyroscopic: Gyroscopic,
    /// Bodies without mass that commands move have the velocity of their motion.
    pub kinematic_bodies: bool,
    /// Whether any joint estimates its reactions.
    pub has_feedback: bool,
    /// Whether the wrench of any joint is measured.
    pub(crate) has_measured: bool,
    /// What the world was made from: also all that is only drawn (skybox, shaders).
    pub description: Arc<adf::World>,
    /// Plugins that models and objects ask for, in the order in which they are loaded; those of the world are in its
    /// [`description`](Self::description). Nothing here loads them.
    pub plugins: Vec<DeclaredPlugins>,
    options: SceneOptions,
    /// What it was loaded from.
    files: SceneFiles,
    /// For each body its active joints; see [`active_joints`](Self::active_joints).
    active_joints: Table<BodyId, Vec<JointId>>,
    /// Models by key.
    model_names: NameMap<ModelId>,
    /// Joints by qualified identifier.
    joint_names: NameMap<JointId>,
    /// What acts by itself in an iteration, in the order in which it does.
    elements: Vec<(Update, usize)>,
    /// Contacts of the parents of contact sensors.
    touching: ContactLists,
    /// Joints that follow others, each after its leaders.
    followers: Vec<JointId>,
    /// Joints of loops of which rows are left out: without one of its joints a loop needs those rows.
    redundant_loops: Vec<Vec<JointId>>,
    /// How often objects came or went.
    changes: u64,
}

impl Scene {
    /// A scene without objects, with defaults for all that `description` and `options` can choose.
    fn empty(world: World, description: Arc<adf::World>, options: &SceneOptions) -> Self {
        Self {
            world,
            bodies: Bodies::default(),
            joints: Table::default(),
            soft_bodies: Objects::default(),
            ghosts: Objects::default(),
            sensors: Objects::default(),
            actuators: Objects::default(),
            vehicles: Objects::default(),
            cameras: Objects::default(),
            lights: Objects::default(),
            volumes: Objects::default(),
            graph: BodyGraph::default(),
            models: Table::default(),
            namespace: String::new(),
            world_rates: Rates::default(),
            gravity: Vector3::zeros(),
            max_sub_steps: 1,
            sub_step: None,
            profile: Profile::default(),
            preset: None,
            joint_erp: None,
            articulates_all: false,
            gyroscopic: Gyroscopic::default(),
            kinematic_bodies: false,
            has_feedback: false,
            has_measured: false,
            description,
            plugins: Vec::new(),
            options: options.clone(),
            files: SceneFiles::default(),
            active_joints: Table::default(),
            model_names: NameMap::default(),
            joint_names: NameMap::default(),
            elements: Vec::new(),
            touching: ContactLists::default(),
            followers: Vec::new(),
            redundant_loops: Vec::new(),
            changes: 0,
        }
    }

    /// What is saved beside the [`lists`](Self::lists) of objects.
    fn saved_fields(&self) -> (&World, &Table<JointId, Joint>, &Vector3<f64>) {
        // All fields by name, so that no new one is forgotten.
        let Self {
            world,
            joints,
            gravity,
            // These are in `lists`.
            bodies: _,
            soft_bodies: _,
            ghosts: _,
            sensors: _,
            actuators: _,
            vehicles: _,
            cameras: _,
            lights: _,
            volumes: _,
            // These change only with the objects.
            graph: _,
            models: _,
            plugins: _,
            active_joints: _,
            model_names: _,
            joint_names: _,
            elements: _,
            touching: _,
            followers: _,
            redundant_loops: _,
            changes: _,
            has_feedback: _,
            has_measured: _,
            // These are chosen when the scene is loaded.
            namespace: _,
            world_rates: _,
            max_sub_steps: _,
            sub_step: _,
            profile: _,
            preset: _,
            joint_erp: _,
            articulates_all: _,
            gyroscopic: _,
            kinematic_bodies: _,
            description: _,
            options: _,
            files: _,
        } = self;
        (world, joints, gravity)
    }

    /// The files and options that it was loaded with.
    pub fn origin(&self) -> (&SceneFiles, &SceneOptions) {
        (&self.files, &self.options)
    }

    /// The objects that have a State and a Command, the world first.
    pub fn objects(&self) -> Vec<ObjectInfo> {
        let world = ObjectInfo {
            kind: ObjectKind::World,
            namespace: self.namespace.clone(),
            name: "World".into(),
            identifier: format!("{}World", self.namespace),
            rates: self.world_rates,
        };
        std::iter::once(world).chain(self.objects_of(|_| true)).collect()
    }

    /// By how much the position of a joint exceeds what the joints that it follows ask for, rad or m; `None` of a joint that moves
    /// on its own.
    pub fn coupling_error(&self, joint: JointId) -> Option<f64> {
        self.world.coupling_error(self.joints.get(joint)?.handle?)
    }

    /// How often models, bodies and end-effectors were added or removed. As long as this stays the same, an id names the
    /// same object.
    pub fn changes(&self) -> u64 {
        self.changes
    }

    /// All objects but joints: each type has its line here, in the order of the list that clients see.
    fn lists(&self) -> [&dyn ObjectList; 9] {
        [
            &self.lights,
            &self.cameras,
            &*self.bodies,
            &self.soft_bodies,
            &self.ghosts,
            &self.sensors,
            &self.actuators,
            &self.vehicles,
            &self.volumes,
        ]
    }

    /// [`lists`](Self::lists), to be changed.
    fn lists_mut(&mut self) -> [&mut dyn ObjectList; 9] {
        [
            &mut self.lights,
            &mut self.cameras,
            &mut *self.bodies,
            &mut self.soft_bodies,
            &mut self.ghosts,
            &mut self.sensors,
            &mut self.actuators,
            &mut self.vehicles,
            &mut self.volumes,
        ]
    }

    /// The objects of a type; `None` for joints.
    fn list(&self, kind: ObjectType) -> Option<&dyn ObjectList> {
        self.lists().into_iter().find(|list| list.object_type() == kind)
    }

    /// The objects of some models that have a State and a Command, without what was removed.
    pub(crate) fn objects_of(&self, is_wanted: impl Fn(ModelId) -> bool) -> Vec<ObjectInfo> {
        let mut objects = Vec::new();
        for list in self.lists() {
            let is_there = |index: &usize| !self.is_removed(ObjectId { kind: list.object_type(), index: *index });
            objects.extend((0..list.count()).filter(is_there).filter_map(|index| {
                let identity = list.identity(index).filter(|identity| is_wanted(identity.model))?;
                identity.object(|| list.kind(index, self))
            }));
        }
        objects
    }

    /// Whether anything was built of a model: an object, or a joint, which may hold bodies of others.
    pub(crate) fn has_objects_of(&self, model: ModelId) -> bool {
        let is_its = |list: &dyn ObjectList, index| {
            let is_removed = self.is_removed(ObjectId { kind: list.object_type(), index });
            !is_removed && list.identity(index).is_some_and(|identity| identity.model == model)
        };
        let lists = self.lists();
        let has_object = lists.into_iter().any(|list| (0..list.count()).any(|index| is_its(list, index)));
        has_object || self.joints.iter().any(|joint| joint.model == model && !joint.removed)
    }

    /// Where the commands of an object are taken and executed; `None` where they do nothing.
    pub(crate) fn commands_of(&self, object: ObjectId) -> Option<Box<dyn Commands>> {
        self.list(object.kind)?.commands(object.index)
    }

    /// Pose of an object in the world; `None` when it is not there or has none.
    pub(crate) fn pose_of(&self, object: ObjectId) -> Option<Isometry3<f64>> {
        self.has_object(object).then(|| self.list(object.kind)?.pose(object.index, self)).flatten()
    }

    /// Appends the numbers that plugins can read of an object; `None` when it is not there.
    pub(crate) fn values_of(&self, object: ObjectId, out: &mut Vec<f64>) -> Option<()> {
        self.has_object(object).then(|| {
            if let Some(list) = self.list(object.kind) {
                list.values(object.index, self, out);
            }
        })
    }

    /// What sorts objects into the order in which they are visited: by model, then by type, then by qualified
    /// identifier.
    pub(crate) fn visiting_key(&self, object: Option<ObjectId>) -> (String, u8, String) {
        let found = object.and_then(|object| {
            let list = self.list(object.kind)?;
            Some((list.rank(), list.identity(object.index)?))
        });
        found.map_or_else(Default::default, |(rank, identity)| {
            (self.models[identity.model].key.clone(), rank + 1, identity.key())
        })
    }

    /// The active joints of a body: what its joint commands are indexed by.
    pub fn active_joints(&self, body: BodyId) -> &[JointId] {
        &self.active_joints[body]
    }

    fn body_info(&self, id: BodyId) -> RigidBodyInfo {
        let body = &self.bodies[id];
        RigidBodyInfo {
            mass: body.mass,
            inertia: body.inertia,
            inertial_offset_inverse: body.inertial_offset_inverse,
            children_names: self
                .graph
                .active(id)
                .map(|entry| self.bodies[entry.body].identity.name.to_string())
                .collect(),
            joint_names: self.graph.active(id).map(|entry| self.joints[entry.joint].name.clone()).collect(),
            joints: self.active_joints(id).to_vec(),
            publish_children_names: body.publish_children_names,
            publish_joint_names: body.publish_joint_names,
            publish_joint_positions: body.publish_joint_positions,
        }
    }

    /// Reads all joint positions from Bullet; `dt` is the interval before, s. `readings` is room for what is read.
    pub(crate) fn observe_joints(&mut self, dt: f64, readings: &mut JointReadings) {
        let is_accurate = self.profile == Profile::Accurate;
        match is_accurate {
            true => self.world.observe_constraints(readings),
            false => self.world.read_positions(readings),
        }
        for joint in &mut self.joints {
            // Joints of unknown type have no constraint: their position stays 0.
            if let Some(place) = joint.place {
                let has_rate = is_accurate && joint.joint_type == JointType::Revolute;
                joint.observe(readings.positions[place], dt, has_rate.then(|| readings.rates[place]));
            }
        }
    }

    /// Executes a command of an actuator. A sentence when what it names is not there.
    pub(crate) fn command_actuator(&mut self, id: ActuatorId, command: &ActuatorCommand) -> Option<String> {
        let Self { actuators, world, bodies, sensors, .. } = self;
        actuators[id].apply_command(world, bodies, sensors, command)
    }

    /// Fixes a body to an actuator where it is; `None`: releases what it holds.
    pub(crate) fn hold_with_actuator(&mut self, id: ActuatorId, body: Option<BodyId>) {
        let Self { actuators, world, bodies, .. } = self;
        match body {
            Some(body) => actuators[id].hold(world, bodies, body, None),
            None => actuators[id].release(world, bodies),
        }
    }

    /// All objects back to the start, or only bodies and what belongs to them, with nothing left of what was before.
    /// `readings` is room as for [`observe_joints`](Self::observe_joints).
    pub(crate) fn reset(&mut self, bodies_only: bool, readings: &mut JointReadings) {
        if !bodies_only {
            self.world.begin_restart();
        }
        let mut kinds = self.lists().map(|list| (list.rank(), list.object_type(), list.count(), list.reset()));
        kinds.sort_unstable_by_key(|kind| kind.0);
        for (_, kind, count, (reset, is_of_bodies)) in kinds {
            if bodies_only && !is_of_bodies {
                continue;
            }
            for index in 0..count {
                if !self.is_removed(ObjectId { kind, index }) {
                    reset(self, index);
                }
            }
        }
        if bodies_only {
            self.volumes.iter_mut().flat_map(|volume| &mut volume.tools).for_each(tool::Tool::let_go);
        }
        match bodies_only {
            true => self.world.recover(),
            false => self.world.finish_restart(),
        }
        self.joints.iter_mut().for_each(Joint::reset);
        self.world.refresh_constraints();
        self.observe_joints(0.0, readings);
    }

    /// Cameras back to where they were, with the targets of the beginning.
    pub(crate) fn reset_cameras(&mut self) {
        self.cameras.ids().for_each(|camera| <Camera as SceneObject>::reset(self, camera));
    }

    /// A snapshot with place for the state of every object.
    pub(crate) fn snapshot(&self, wrenches: &Table<BodyId, Wrench>) -> Snapshot {
        let coordinates = || Table::filled(0.0, self.joints.len());
        let mut snapshot = Snapshot {
            wrenches: wrenches.clone(),
            joint_positions: coordinates(),
            joint_velocities: coordinates(),
            joint_efforts: coordinates(),
            joint_wrenches: Table::filled(Wrench::default(), self.joints.len()),
            ..Snapshot::default()
        };
        self.lists().into_iter().for_each(|list| list.make_room(self, &mut snapshot));
        snapshot
    }

    /// Writes the states of everything but bodies and joints.
    pub(crate) fn fill_elements(&self, snapshot: &mut Snapshot) {
        self.lists().into_iter().for_each(|list| list.read(self, snapshot));
    }

    /// Updates everything that has something to do besides moving: ghosts, sensors, vehicles. Sub-step and update in s.
    pub(crate) fn update_elements(&mut self, sub_step: f64, interval: f64) {
        self.touching.update(&self.world);
        for i in 0..self.elements.len() {
            let (update, index) = self.elements[i];
            update(self, index, sub_step, interval);
        }
    }
}
