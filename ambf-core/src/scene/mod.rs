//! Descriptions → live objects in a Bullet world.

mod body;
mod build;
mod graph;
mod identity;
mod joint;
mod load;
mod names;
mod placed;
mod shape;

pub use body::Body;
pub use graph::{BodyGraph, Descendant};
pub use identity::Identity;
pub use joint::{Joint, JointType};
pub use load::{load, read_model, Loaded, SceneFiles, SceneReport};
pub use names::{Found, NameMap};
pub use placed::{Camera, Light, Placed};

use std::fmt;

use nalgebra::Vector3;

use crate::adf::{Severity, SourcePos};
use crate::bullet::{Integrator, Solver, World};
use crate::comm::{ObjectInfo, ObjectKind, Rates, RigidBodyInfo};
use crate::control::Profile;

/// How a scene is built, beside what its files say.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SceneOptions {
    /// Put before every namespace.
    pub prefix: String,
    /// Publishing rates of all objects instead of their own.
    pub rates: Option<Rates>,
    /// Physics wanted; `None`: the world file's, else the default.
    pub physics: PhysicsOptions,
}

/// How physics is solved; what is `None` comes from the world file, else from the profile.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PhysicsOptions {
    /// Legacy or accurate.
    pub profile: Option<Profile>,
    /// Constraint solver.
    pub solver: Option<Solver>,
    /// Iterations of the solver.
    pub iterations: Option<u32>,
    /// How free bodies are moved.
    pub integrator: Option<Integrator>,
    /// Length of a sub-step, s.
    pub sub_step: Option<f64>,
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
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}: {}", self.source, self.severity, self.message)
    }
}

/// A model as part of a scene.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelInfo {
    /// Namespace and file name, with the suffix that tells copies apart: models are visited in the order of these.
    pub key: String,
    /// Bodies, as a range of [`Scene::bodies`].
    pub bodies: std::ops::Range<usize>,
}

/// All objects of a world, by index in order of creation.
pub struct Scene {
    /// Bullet's side. Its bodies are [`bodies`](Self::bodies), place for place.
    pub world: World,
    /// Rigid bodies.
    pub bodies: Vec<Body>,
    /// Joints, those of unknown type included.
    pub joints: Vec<Joint>,
    /// Cameras.
    pub cameras: Vec<Camera>,
    /// Lights.
    pub lights: Vec<Light>,
    /// What hangs below what.
    pub graph: BodyGraph,
    /// Models in order of creation; the first is the environment.
    pub models: Vec<ModelInfo>,
    /// Bodies by qualified identifier.
    pub body_names: NameMap,
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
    /// Whether any joint estimates its reactions.
    pub has_feedback: bool,
    /// For each body its active joints; see [`active_joints`](Self::active_joints).
    active_joints: Vec<Vec<usize>>,
    joint_names: NameMap,
    camera_names: NameMap,
    light_names: NameMap,
}

impl Scene {
    /// Indices of the bodies in the order in which models and objects are visited: by model, then by qualified identifier.
    pub fn visiting_order(&self) -> Vec<usize> {
        let mut models: Vec<_> = self.models.iter().collect();
        models.sort_by(|a, b| a.key.cmp(&b.key));
        models
            .into_iter()
            .flat_map(|model| {
                let mut bodies: Vec<_> = model.bodies.clone().collect();
                bodies.sort_by_cached_key(|&body| self.bodies[body].identity.key());
                bodies
            })
            .collect()
    }

    /// Indices of the active joints of a body: what its joint commands are indexed by.
    pub fn active_joints(&self, body: usize) -> &[usize] {
        &self.active_joints[body]
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
        let lights = self.lights.iter().enumerate();
        let lights =
            lights.filter_map(|(i, l)| l.placed.identity.object(ObjectKind::Light(i, Box::new(l.parameters.clone()))));
        let cameras = self.cameras.iter().enumerate();
        let cameras = cameras
            .filter_map(|(i, c)| c.placed.identity.object(ObjectKind::Camera(i, Box::new(c.parameters.clone()))));
        let bodies = self.bodies.iter().enumerate();
        let bodies =
            bodies.filter_map(|(i, body)| body.identity.object(ObjectKind::RigidBody(i, Box::new(self.body_info(i)))));
        std::iter::once(world).chain(lights).chain(cameras).chain(bodies).collect()
    }

    fn body_info(&self, index: usize) -> RigidBodyInfo {
        let body = &self.bodies[index];
        RigidBodyInfo {
            mass: body.mass,
            inertia: body.inertia,
            inertial_offset_inverse: body.inertial_offset_inverse,
            children_names: self
                .graph
                .active(index)
                .map(|entry| self.bodies[entry.body].identity.name.clone())
                .collect(),
            joint_names: self.graph.active(index).map(|entry| self.joints[entry.joint].name.clone()).collect(),
            joints: self.active_joints(index).to_vec(),
            publish_children_names: body.publish_children_names,
            publish_joint_names: body.publish_joint_names,
            publish_joint_positions: body.publish_joint_positions,
        }
    }

    /// Reads all joint positions from Bullet; `dt` is the interval before, s.
    pub(crate) fn observe_joints(&mut self, dt: f64, buffer: &mut [f64]) {
        self.world.read_constraints(buffer);
        let mut place = 0;
        for joint in &mut self.joints {
            // Joints of unknown type have no constraint: their position stays 0.
            if joint.handle.is_some() {
                joint.observe(buffer[place], dt);
                place += 1;
            }
        }
    }
}
