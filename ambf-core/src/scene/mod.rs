//! Descriptions → live objects in a Bullet world.

mod actuator;
mod articulate;
mod assemble;
mod attached;
mod body;
mod build;
mod elements;
mod end_effector;
mod gesture;
mod ghost;
mod graph;
mod identity;
mod joint;
mod load;
mod names;
mod object;
mod physics;
mod remove;
mod saved;
mod sensor;
mod shape;
mod soft_body;
mod targets;
mod vehicle;
mod visuals;

pub use actuator::Actuator;
pub use ambf_plugin::{ObjectId, ObjectType};
pub use attached::{Attached, Camera, Light, Parent};
pub use body::{Bodies, Body};
pub use end_effector::{EndEffectorParts, PreparedEndEffector};
pub use gesture::{CameraGesture, CameraPlace};
pub use ghost::Ghost;
pub use graph::{BodyGraph, Descendant};
pub use identity::Identity;
pub use joint::{Joint, JointType};
pub use load::{load, read_model, Loaded, PreparedModel, SceneFiles, SceneReport};
pub use names::{Found, NameMap};
pub use object::DeclaredPlugins;
pub use physics::PhysicsOptions;
pub(crate) use saved::SavedScene;
pub use sensor::{LocalRay, Sensed, Sensor};
pub use soft_body::SoftBody;
pub(crate) use targets::SubSteps;
pub use vehicle::{Vehicle, Wheel};
pub use visuals::{
    VisualActuator, VisualBody, VisualCamera, VisualJoint, VisualLight, VisualModel, VisualObject, VisualScene,
    VisualSensor, VisualSoftBody, VisualVehicle,
};

use std::fmt;
use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};

use crate::adf::{self, Severity, SourcePos};
use crate::bullet::{Gyroscopic, Preset, World};
use crate::comm::{
    ActuatorCommand, BodyKinematics, GhostInfo, GhostReading, ObjectInfo, ObjectKind, Rates, RigidBodyInfo, Snapshot,
    SoftBodyReading, VehicleInfo, VehicleReading, Wrench,
};
use crate::control::Profile;
use crate::ids::{
    ActuatorId, BodyId, CameraId, GhostId, JointId, LightId, ModelId, SensorId, SoftBodyId, Table, VehicleId,
};

/// How a scene is built, beside what its files say.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SceneOptions {
    /// Put before every namespace.
    pub prefix: String,
    /// Publishing rates of all objects instead of their own.
    pub rates: Option<Rates>,
    /// Physics wanted; `None`: the world file's, else the default.
    pub physics: PhysicsOptions,
    /// Models with joints will be added later: where joints may be put into reduced coordinates, theirs may be too.
    /// Default: `false`.
    pub may_grow: bool,
    /// States of the simulation can be [saved](crate::sim::Simulation::save). Default: `false`.
    pub savable: bool,
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
        write!(f, "{}: {}: {}", self.source, self.severity, self.message)
    }
}

/// A model as part of a scene.
#[derive(Debug, Clone)]
pub struct ModelInfo {
    /// Namespace and file name, with the suffix that tells copies apart: models are visited in the order of these.
    pub key: String,
    /// What it was made from: also all that is only drawn (volumes, shaders, materials).
    pub description: Arc<adf::Model>,
    /// It was taken out of the scene.
    pub removed: bool,
}

/// All objects of a world, by index in order of creation. What is removed while running keeps its place.
pub struct Scene {
    /// Bullet's side. Its bodies are [`bodies`](Self::bodies), place for place.
    pub world: World,
    /// Rigid bodies.
    pub bodies: Bodies,
    /// Joints, those of unknown type included.
    pub joints: Table<JointId, Joint>,
    /// Soft bodies.
    pub soft_bodies: Table<SoftBodyId, SoftBody>,
    /// Ghost objects.
    pub ghosts: Table<GhostId, Ghost>,
    /// Sensors.
    pub sensors: Table<SensorId, Sensor>,
    /// Actuators.
    pub actuators: Table<ActuatorId, Actuator>,
    /// Vehicles.
    pub vehicles: Table<VehicleId, Vehicle>,
    /// Cameras.
    pub cameras: Table<CameraId, Camera>,
    /// Lights.
    pub lights: Table<LightId, Light>,
    /// What hangs below what.
    pub graph: BodyGraph,
    /// Models in order of creation; the first is the environment.
    pub models: Table<ModelId, ModelInfo>,
    /// Bodies by qualified identifier.
    pub body_names: NameMap<BodyId>,
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
    /// How the gyroscopic torque is integrated.
    pub gyroscopic: Gyroscopic,
    /// Whether any joint estimates its reactions.
    pub has_feedback: bool,
    /// What the world was made from: also all that is only drawn (skybox, shaders).
    pub description: Arc<adf::World>,
    /// Plugins that models and objects ask for, in the order in which they are loaded; those of the world are in its
    /// [`description`](Self::description). Nothing here loads them.
    pub plugins: Vec<DeclaredPlugins>,
    options: SceneOptions,
    /// For each body its active joints; see [`active_joints`](Self::active_joints).
    active_joints: Table<BodyId, Vec<JointId>>,
    names: Names,
    /// Ghosts, sensors and vehicles in the order in which they are updated.
    elements: Vec<Element>,
}

/// Objects by qualified identifier, bodies excepted.
#[derive(Debug, Default)]
struct Names {
    models: NameMap<ModelId>,
    joints: NameMap<JointId>,
    soft_bodies: NameMap<SoftBodyId>,
    ghosts: NameMap<GhostId>,
    sensors: NameMap<SensorId>,
    actuators: NameMap<ActuatorId>,
    vehicles: NameMap<VehicleId>,
    cameras: NameMap<CameraId>,
    lights: NameMap<LightId>,
}

/// An object that has something to do in each iteration, by index.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Element {
    Ghost(GhostId),
    Sensor(SensorId),
    Vehicle(VehicleId),
}

impl Scene {
    /// The objects that have a State and a Command, the world first.
    pub fn objects(&self) -> Vec<ObjectInfo> {
        let world = ObjectInfo {
            kind: ObjectKind::World,
            namespace: self.namespace.clone(),
            name: "World".into(),
            identifier: format!("{}World", self.namespace),
            rates: self.world_rates,
        };
        std::iter::once(world).chain(self.objects_from(&Counts::default())).collect()
    }

    /// The objects that have a State and a Command beyond the first `known` of each type, without the world.
    pub(crate) fn objects_from(&self, known: &Counts) -> Vec<ObjectInfo> {
        let mut objects = Vec::new();
        let mut add = |identity: &Identity, kind: ObjectKind| objects.extend(identity.object(kind));
        for (i, light) in self.lights.entries().skip(known.lights) {
            add(&light.attached.identity, ObjectKind::Light(i, Box::new(light.parameters.clone())));
        }
        for (i, camera) in self.cameras.entries().skip(known.cameras) {
            add(&camera.attached.identity, ObjectKind::Camera(i, Box::new(camera.parameters.clone())));
        }
        for (i, body) in self.bodies.entries().skip(known.bodies) {
            add(&body.identity, ObjectKind::RigidBody(i, Box::new(self.body_info(i))));
        }
        for (i, soft) in self.soft_bodies.entries().skip(known.soft_bodies) {
            add(&soft.identity, ObjectKind::SoftBody(i, soft.mass));
        }
        for (i, ghost) in self.ghosts.entries().skip(known.ghosts) {
            let info = GhostInfo { parent_name: ghost.parent_name.clone() };
            add(&ghost.attached.identity, ObjectKind::Ghost(i, Box::new(info)));
        }
        for (i, sensor) in self.sensors.entries().skip(known.sensors) {
            add(&sensor.identity, ObjectKind::Sensor(i, Box::new(sensor.info.clone())));
        }
        for (i, actuator) in self.actuators.entries().skip(known.actuators) {
            add(&actuator.identity, ObjectKind::Actuator(i, Box::new(actuator.info.clone())));
        }
        for (i, vehicle) in self.vehicles.entries().skip(known.vehicles) {
            let chassis = &self.bodies[vehicle.chassis];
            let info = VehicleInfo { mass: chassis.mass, inertia: chassis.inertia, wheels: vehicle.wheels.len() };
            add(&vehicle.identity, ObjectKind::Vehicle(i, Box::new(info)));
        }
        objects
    }

    /// How many objects of each type there are, removed ones included.
    pub(crate) fn counts(&self) -> Counts {
        Counts {
            bodies: self.bodies.len(),
            soft_bodies: self.soft_bodies.len(),
            ghosts: self.ghosts.len(),
            sensors: self.sensors.len(),
            actuators: self.actuators.len(),
            vehicles: self.vehicles.len(),
            cameras: self.cameras.len(),
            lights: self.lights.len(),
        }
    }

    /// Names of an object that has a State; `None` for the world.
    pub(crate) fn identity(&self, kind: &ObjectKind) -> Option<&Identity> {
        match *kind {
            ObjectKind::World => None,
            ObjectKind::RigidBody(i, _) => Some(&self.bodies[i].identity),
            ObjectKind::Camera(i, _) => Some(&self.cameras[i].attached.identity),
            ObjectKind::Light(i, _) => Some(&self.lights[i].attached.identity),
            ObjectKind::Sensor(i, _) => Some(&self.sensors[i].identity),
            ObjectKind::Actuator(i, _) => Some(&self.actuators[i].identity),
            ObjectKind::Vehicle(i, _) => Some(&self.vehicles[i].identity),
            ObjectKind::SoftBody(i, _) => Some(&self.soft_bodies[i].identity),
            ObjectKind::Ghost(i, _) => Some(&self.ghosts[i].attached.identity),
        }
    }

    /// What sorts objects into the order in which they are visited: by model, then by type, then by qualified
    /// identifier.
    pub(crate) fn visiting_key(&self, kind: &ObjectKind) -> (String, u8, String) {
        let Some(identity) = self.identity(kind) else { return Default::default() };
        let rank = match kind {
            ObjectKind::World => 0,
            ObjectKind::Actuator(..) => 1,
            ObjectKind::Camera(..) => 2,
            ObjectKind::Light(..) => 3,
            ObjectKind::RigidBody(..) => 4,
            ObjectKind::SoftBody(..) => 5,
            ObjectKind::Ghost(..) => 6,
            ObjectKind::Sensor(..) => 7,
            ObjectKind::Vehicle(..) => 8,
        };
        (self.models[identity.model].key.clone(), rank, identity.key())
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

    /// Reads all joint positions from Bullet; `dt` is the interval before, s.
    pub(crate) fn observe_joints(&mut self, dt: f64, buffer: &mut [f64]) {
        if self.profile == Profile::Accurate {
            self.world.refresh_constraints();
        }
        self.world.read_constraints(buffer);
        for joint in &mut self.joints {
            // Joints of unknown type have no constraint: their position stays 0.
            if let Some(place) = joint.place {
                joint.observe(buffer[place], dt);
            }
        }
    }

    /// Lets an actuator hold or let go.
    pub(crate) fn command_actuator(&mut self, id: ActuatorId, command: &ActuatorCommand) -> Option<String> {
        let Self { actuators, world, bodies, body_names, sensors, names, .. } = self;
        actuators[id].apply_command(world, bodies, body_names, sensors, &names.sensors, command)
    }

    /// Lets an actuator hold a body where it is, or let go.
    pub(crate) fn hold_with_actuator(&mut self, id: ActuatorId, body: Option<BodyId>) {
        let Self { actuators, world, bodies, .. } = self;
        match body {
            Some(body) => actuators[id].hold(world, bodies, body, None),
            None => actuators[id].release(world, bodies),
        }
    }

    /// Cameras, lights and ghost objects back to where they were.
    pub(crate) fn reset_placed(&mut self) {
        for object in self.all_placed().collect::<Vec<_>>() {
            if let Some(attached) = self.attached_mut(object) {
                attached.pose = attached.initial_pose;
            }
        }
        self.reset_cameras();
    }

    /// Cameras back to where they were, with the targets of the beginning.
    pub(crate) fn reset_cameras(&mut self) {
        self.cameras.iter_mut().for_each(Camera::reset);
    }

    /// A snapshot with place for the state of every object.
    pub(crate) fn snapshot(&self, wrenches: &Table<BodyId, Wrench>) -> Snapshot {
        let identities = |n: usize| vec![Isometry3::identity(); n];
        let vehicle = |vehicle: &Vehicle| VehicleReading {
            wheels: identities(vehicle.wheels.len()),
            ..VehicleReading::default()
        };
        let soft =
            |soft: &SoftBody| SoftBodyReading { nodes: vec![[0.0; 3]; soft.nodes], ..SoftBodyReading::default() };
        Snapshot {
            bodies: Table::filled(BodyKinematics::default(), self.bodies.len()),
            wrenches: wrenches.clone(),
            joint_positions: Table::filled(0.0, self.joints.len()),
            joint_velocities: Table::filled(0.0, self.joints.len()),
            joint_efforts: Table::filled(0.0, self.joints.len()),
            cameras: identities(self.cameras.len()).into(),
            lights: identities(self.lights.len()).into(),
            views: self.cameras.iter().map(|camera| self.view_of(camera)).collect(),
            spots: self.lights.iter().map(|light| self.spot_of(light)).collect(),
            sensors: self.sensors.iter().map(|sensor| sensor.readings().to_vec()).collect(),
            contacts: self.sensors.iter().map(|sensor| sensor.contacts().cloned().unwrap_or_default()).collect(),
            actuators: Table::filled(false, self.actuators.len()),
            vehicles: self.vehicles.iter().map(vehicle).collect(),
            soft_bodies: self.soft_bodies.iter().map(soft).collect(),
            ghosts: Table::filled(GhostReading::default(), self.ghosts.len()),
            ..Snapshot::default()
        }
    }

    /// Writes the states of everything but bodies and joints.
    pub(crate) fn fill_elements(&self, snapshot: &mut Snapshot) {
        for (i, camera) in self.cameras.entries() {
            snapshot.cameras[i] = camera.attached.pose;
            snapshot.views[i] = self.view_of(camera);
        }
        for (i, light) in self.lights.entries() {
            snapshot.lights[i] = light.attached.pose;
            snapshot.spots[i] = self.spot_of(light);
        }
        for (readings, sensor) in snapshot.sensors.iter_mut().zip(&self.sensors) {
            // Keeps the memory of what was there.
            readings.clear();
            readings.extend_from_slice(sensor.readings());
        }
        for (reading, sensor) in snapshot.contacts.iter_mut().zip(&self.sensors) {
            if let Some(contacts) = sensor.contacts() {
                reading.copy_from(contacts);
            }
        }
        for (actuated, actuator) in snapshot.actuators.iter_mut().zip(&self.actuators) {
            *actuated = actuator.is_actuated();
        }
        for (reading, vehicle) in snapshot.vehicles.iter_mut().zip(&self.vehicles) {
            vehicle.read(&self.world, &self.bodies, reading);
        }
        for (reading, soft) in snapshot.soft_bodies.iter_mut().zip(&self.soft_bodies) {
            soft.read(&self.world, reading);
        }
        for (reading, ghost) in snapshot.ghosts.iter_mut().zip(&self.ghosts) {
            ghost.read(&self.bodies, reading);
        }
    }

    /// Updates everything that has something to do besides moving: ghosts, sensors, vehicles. Sub-step and update in s.
    pub(crate) fn update_elements(&mut self, sub_step: f64, interval: f64) {
        for i in 0..self.elements.len() {
            match self.elements[i] {
                Element::Ghost(index) => {
                    let Attached { parent, pose, .. } = self.ghosts[index].attached;
                    let pose = self.global_pose(parent, &pose);
                    let carrier = match parent {
                        Some(Parent::Body(body)) => Some(body),
                        _ => None,
                    };
                    let Self { ghosts, world, bodies, gravity, profile, .. } = self;
                    ghosts[index].update(world, bodies, pose, carrier, gravity, *profile);
                }
                Element::Sensor(index) => self.sensors[index].update(&mut self.world, &self.bodies, sub_step, interval),
                Element::Vehicle(index) => self.vehicles[index].update(&mut self.world, &self.bodies),
            }
        }
    }
}

/// Numbers of objects by type.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Counts {
    pub bodies: usize,
    pub soft_bodies: usize,
    pub ghosts: usize,
    pub sensors: usize,
    pub actuators: usize,
    pub vehicles: usize,
    pub cameras: usize,
    pub lights: usize,
}
