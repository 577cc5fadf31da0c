//! Builds the objects of one model after the other.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use nalgebra::Isometry3;

use super::body::Body;
use super::joint::{constraint, frames, Joint};
use super::placed::{camera_parameters, camera_pose, light_rotation, Camera, Light, Placed};
use super::{shape, BodyGraph, Found, Identity, ModelInfo, NameMap, Note, PhysicsOptions, Scene, SceneOptions};
use crate::adf::{self, CollisionGeometry, Part, PartGeometry, PhysicsProfile, Severity, SourcePos};
use crate::bullet::{self, Integrator, Solver, World};
use crate::comm::{LightParameters, Rates};
use crate::control::{CartesianController, Profile};
use crate::mesh::{Mesh, MeshCache};

pub(super) struct Builder<'a> {
    pub scene: Scene,
    pub notes: Vec<Note>,
    options: &'a SceneOptions,
    meshes: &'a MeshCache,
    model_names: NameMap,
    first_joint_of_model: usize,
}

/// Meshes that a model's collision shapes need, with their scales.
pub(super) fn collision_meshes(model: &adf::Model) -> impl Iterator<Item = (PathBuf, f64)> + '_ {
    model.bodies.iter().flat_map(|body| match &body.collision {
        CollisionGeometry::Mesh { path, .. } => vec![(path.clone(), body.scale)],
        CollisionGeometry::Parts { parts, .. } => {
            // Each part has its own scale, which is applied when its shape is made.
            let mesh = |part: &Part| match &part.geometry {
                PartGeometry::Mesh { path, .. } => Some((path.clone(), 1.0)),
                PartGeometry::Primitive(_) => None,
            };
            parts.iter().filter_map(mesh).collect()
        }
        _ => vec![],
    })
}

impl<'a> Builder<'a> {
    pub fn new(world: &adf::World, options: &'a SceneOptions, meshes: &'a MeshCache) -> Self {
        let mut notes = Vec::new();
        let physics = physics(world, &options.physics, &mut notes);
        let profile = physics.profile.unwrap_or_default();
        let (solver, integrator) = match profile {
            Profile::Legacy => (Solver::WarmFriction, Integrator::Euler),
            Profile::Accurate => (Solver::SequentialImpulse, Integrator::Ballistic),
        };
        let mut bullet = World::new(physics.solver.unwrap_or(solver));
        bullet.set_integrator(physics.integrator.unwrap_or(integrator));
        bullet.set_lag(profile == Profile::Legacy);
        bullet.set_gravity(world.gravity);
        if let Some(iterations) = physics.iterations {
            bullet.set_iterations(iterations);
        }
        let scene = Scene {
            world: bullet,
            bodies: Vec::new(),
            joints: Vec::new(),
            cameras: Vec::new(),
            lights: Vec::new(),
            graph: BodyGraph::default(),
            models: Vec::new(),
            body_names: NameMap::default(),
            namespace: format!("{}{}", options.prefix, world.common.namespace),
            world_rates: options.rates.unwrap_or_default(),
            gravity: world.gravity,
            max_sub_steps: world.max_iterations.max(1),
            sub_step: physics.sub_step,
            profile,
            has_feedback: false,
            active_joints: Vec::new(),
            joint_names: NameMap::default(),
            camera_names: NameMap::default(),
            light_names: NameMap::default(),
        };
        Self { scene, notes, options, meshes, model_names: NameMap::default(), first_joint_of_model: 0 }
    }

    /// Builds the environment model with the world's own lights and cameras in it.
    pub fn add_environment(&mut self, model: &adf::Model, world: &adf::World) {
        let first = self.begin_model(model);
        self.add_bodies(model);
        self.add_lights(&world.lights);
        self.add_cameras(&world.cameras);
        self.finish_model(model, first);
    }

    /// Builds a model.
    pub fn add_model(&mut self, model: &adf::Model) {
        let first = self.begin_model(model);
        self.add_bodies(model);
        self.add_cameras(&model.cameras);
        self.add_lights(&model.lights);
        self.finish_model(model, first);
    }

    /// Resolves what may refer to later models, and reads the joints for the first time.
    pub fn finish(mut self) -> (Scene, Vec<Note>) {
        self.resolve_parents();
        let graph = &self.scene.graph;
        let active = |body| graph.active(body).map(|entry| entry.joint).collect();
        self.scene.active_joints = (0..self.scene.bodies.len()).map(active).collect();
        let mut buffer = vec![0.0; self.scene.world.constraints().len()];
        self.scene.world.refresh_constraints();
        self.scene.observe_joints(0.0, &mut buffer);
        (self.scene, self.notes)
    }

    fn note(&mut self, severity: Severity, source: &SourcePos, message: String) {
        self.notes.push(Note { severity, source: source.clone(), message });
    }

    fn begin_model(&mut self, model: &adf::Model) -> usize {
        self.first_joint_of_model = self.scene.joints.len();
        let unbuilt = [
            ("soft body", model.soft_bodies.len()),
            ("ghost object", model.ghosts.len()),
            ("sensor", model.sensors.len()),
            ("actuator", model.actuators.len()),
            ("vehicle", model.vehicles.len()),
            ("volume", model.volumes.len()),
        ];
        let unbuilt: Vec<_> = unbuilt.iter().filter(|(_, n)| *n > 0).map(|(what, n)| format!("{n} × {what}")).collect();
        if !unbuilt.is_empty() {
            let source = SourcePos { file: model.file.clone(), line: 0, column: 0 };
            self.note(Severity::Warning, &source, format!("read but not simulated: {}", unbuilt.join(", ")));
        }
        self.scene.bodies.len()
    }

    fn rates(&mut self, common: &adf::Common) -> Rates {
        match (self.options.rates, common.publish_frequency) {
            (Some(rates), _) => rates,
            (None, None) => Rates::default(),
            (None, Some((low, high))) => Rates::new(low, high).unwrap_or_else(|message| {
                self.note(Severity::Error, &common.source, format!("{message}; 50 and 1000 Hz are used"));
                Rates::default()
            }),
        }
    }

    fn add_bodies(&mut self, model: &adf::Model) {
        let first = self.scene.bodies.len();
        let mut own_names = NameMap::default();
        for body in &model.bodies {
            if let Some(index) = self.add_body(body, model) {
                own_names.insert(&self.scene.bodies[index].identity.key(), index);
            }
        }
        for joint in &model.joints {
            self.add_joint(joint, &own_names);
        }
        if model.ignore_inter_collision {
            self.ignore_all_pairs(first..self.scene.bodies.len());
        }
    }

    fn add_body(&mut self, body: &adf::RigidBody, model: &adf::Model) -> Option<usize> {
        let source = &body.common.source;
        let mesh = match &body.collision {
            CollisionGeometry::Mesh { path, .. } => match self.meshes.get(path, body.scale) {
                Ok(mesh) => Some(mesh),
                Err(error) => {
                    let message = format!("`{}` is dropped: {error}", body.common.identifier);
                    self.note(Severity::Error, source, message);
                    return None;
                }
            },
            _ => None,
        };
        let built = shape::build(body, mesh.as_deref(), self.meshes, self.scene.profile);
        for (severity, message) in &built.left_out {
            self.note(*severity, source, format!("`{}`: {message}", body.common.identifier));
        }
        self.note_displacement(body, mesh.as_deref(), &built.inertial_offset);

        let inertia = body.inertia.unwrap_or_else(|| {
            if body.mass > 0.0 {
                built.shape.inertia(body.mass)
            } else {
                nalgebra::Vector3::zeros()
            }
        });
        let initial_pose = body.location * built.inertial_offset;
        let gravity = body.gravity.or(model.gravity);
        let handle = self.scene.world.add_body(bullet::RigidBody {
            mass: body.mass,
            inertia,
            shape: built.shape,
            pose: initial_pose,
            friction: body.surface.static_friction,
            rolling_friction: body.surface.rolling_friction,
            restitution: body.surface.restitution,
            linear_damping: body.surface.linear_damping,
            angular_damping: body.surface.angular_damping,
            gravity,
        });
        let controller = body.controller.unwrap_or_default();
        let namespace = format!("{}{}", self.options.prefix, body.common.namespace);
        let key = format!("{namespace}{}", body.common.identifier);
        let suffix = self.scene.body_names.free_suffix(&key);
        let rates = self.rates(&body.common);
        self.scene.bodies.push(Body {
            identity: Identity::new(&body.common, namespace, suffix, rates),
            mass: body.mass,
            inertia,
            inertial_offset: built.inertial_offset,
            inertial_offset_inverse: built.inertial_offset.inverse(),
            initial_pose,
            gravity,
            scale: body.scale,
            collision_groups: body.collision_groups.clone(),
            publish_children_names: body.publish_children_names,
            publish_joint_names: body.publish_joint_names,
            publish_joint_positions: body.publish_joint_positions,
            source: source.clone(),
            handle,
            controller: CartesianController::new(controller.linear, controller.angular, self.scene.profile),
            controlled_in: 0,
        });
        Some(self.scene.graph.add_body())
    }

    fn note_displacement(&mut self, body: &adf::RigidBody, mesh: Option<&Mesh>, offset: &Isometry3<f64>) {
        let distance = offset.translation.vector.norm();
        if mesh.is_some() && body.inertial_offset.is_none() && distance > 0.0 {
            let message = format!(
                "`{}` has no `inertial offset`: its centre of mass is taken from the collision mesh; the C++ program then collides \
                 with the mesh displaced by {distance:.4} m, here it stays where it is drawn",
                body.common.identifier
            );
            self.note(Severity::Warning, &body.common.source, message);
        }
    }

    fn add_joint(&mut self, joint: &adf::Joint, own_names: &NameMap) {
        let source = &joint.common.source;
        let namespace = format!("{}{}", self.options.prefix, joint.common.namespace);
        let key = format!("{namespace}{}", joint.common.identifier);
        let suffix = self.scene.joint_names.free_suffix(&key);
        let mut find = |role: &str, text: &str| {
            let found = self.find_body(text, &namespace, &suffix, own_names);
            match &found {
                Ok((index, None)) => return Some(*index),
                Ok((index, Some(remark))) => {
                    let message = format!("`{}`: {role} `{text}` {remark}", joint.common.identifier);
                    self.notes.push(Note { severity: Severity::Warning, source: source.clone(), message });
                    return Some(*index);
                }
                Err(why) => {
                    let message = format!("`{}` is dropped: {role} `{text}` {why}", joint.common.identifier);
                    self.notes.push(Note { severity: Severity::Error, source: source.clone(), message });
                }
            }
            None
        };
        let (Some(parent), Some(child)) = (find("parent", &joint.parent), find("child", &joint.child)) else { return };
        if parent == child {
            let message = format!("`{}` is dropped: it joins `{}` with itself", joint.common.identifier, joint.parent);
            self.note(Severity::Error, source, message);
            return;
        }
        let (frame_a, frame_b, axis) = frames(joint, &self.scene.bodies[parent], &self.scene.bodies[child]);
        let handle = constraint(joint, frame_a, frame_b).and_then(|constraint| {
            let [a, b] = [parent, child].map(|body| self.scene.bodies[body].handle);
            self.scene.world.add_constraint(a, b, &constraint)
        });
        let index = self.scene.joints.len();
        self.scene.graph.add_joint(parent, child, index, joint.common.passive);
        self.scene.has_feedback |= joint.enable_feedback && handle.is_some();
        let live = Joint::new(joint, key, (parent, child), axis, handle, self.scene.profile);
        self.scene.joints.push(live);
    }

    /// Where a joint's text leads: in its own model as it is, then with its namespace; in the world with namespace and suffix, then as
    /// it is. A remark says when it was no exact hit in the own model.
    fn find_body(
        &self,
        text: &str,
        namespace: &str,
        suffix: &str,
        own_names: &NameMap,
    ) -> Result<(usize, Option<String>), String> {
        let qualified = format!("{namespace}{text}");
        // The usual case first, without a search: a key that is `qualified` holds `text`, so that the steps below could only end at it.
        if let Some(index) = own_names.exact(text).or_else(|| own_names.exact(&qualified)) {
            return Ok((index, None));
        }
        let world = &self.scene.body_names;
        let with_suffix = format!("{qualified}{suffix}");
        let steps: [(&NameMap, &str); 4] =
            [(own_names, text), (own_names, &qualified), (world, &with_suffix), (world, text)];
        let mut ambiguous = None;
        for (step, (names, wanted)) in steps.into_iter().enumerate() {
            let found = names.find(wanted);
            match found.index() {
                Some(index) if step < 2 => return Ok((index, Some(format!("is {found}")))),
                Some(index) => {
                    let remark = format!("is taken from another model: `{}`", self.scene.bodies[index].identity.key());
                    return Ok((index, Some(remark)));
                }
                None if matches!(found, Found::Ambiguous(_)) => ambiguous = ambiguous.or(Some(found)),
                None => (),
            }
        }
        Err(format!("is {}", ambiguous.unwrap_or(Found::Nothing)))
    }

    fn add_cameras(&mut self, cameras: &[adf::Camera]) {
        for camera in cameras {
            let pose = camera_pose(&camera.location, &camera.look_at, &camera.up);
            let placed = self.placed(&camera.common, pose, |scene| &scene.camera_names);
            self.scene.cameras.push(Camera { placed, parameters: camera_parameters(camera) });
        }
    }

    fn add_lights(&mut self, lights: &[adf::Light]) {
        for light in lights {
            let mut pose = light.location;
            pose.rotation = light.direction.as_ref().and_then(light_rotation).unwrap_or(pose.rotation);
            let placed = self.placed(&light.common, pose, |scene| &scene.light_names);
            let parameters = LightParameters { cutoff_angle: light.cutoff_angle, parent_name: light.parent.clone() };
            self.scene.lights.push(Light { placed, parameters });
        }
    }

    fn placed(&mut self, common: &adf::Common, pose: Isometry3<f64>, names: fn(&Scene) -> &NameMap) -> Placed {
        let namespace = format!("{}{}", self.options.prefix, common.namespace);
        let suffix = names(&self.scene).free_suffix(&format!("{namespace}{}", common.identifier));
        let rates = self.rates(common);
        Placed::new(Identity::new(common, namespace, suffix, rates), pose)
    }

    /// Enters a model's objects in the world's maps and applies what concerns them together.
    fn finish_model(&mut self, model: &adf::Model, first_body: usize) {
        let scene = &mut self.scene;
        let key = format!("{}{}{}", self.options.prefix, model.namespace, model.name);
        let suffix = self.model_names.free_suffix(&key);
        self.model_names.insert(&key, scene.models.len());
        scene.models.push(ModelInfo { key: key + &suffix, bodies: first_body..scene.bodies.len() });

        // Sorted by key, as the C++ program's maps are.
        let mut bodies: Vec<_> =
            (first_body..scene.bodies.len()).map(|i| (scene.bodies[i].identity.key(), i)).collect();
        bodies.sort();
        bodies.iter().for_each(|(key, index)| scene.body_names.insert(key, *index));
        for index in self.first_joint_of_model..scene.joints.len() {
            scene.joint_names.insert(&scene.joints[index].key, index);
        }
        enter_placed(&mut scene.camera_names, scene.cameras.iter().map(|camera| &camera.placed));
        enter_placed(&mut scene.light_names, scene.lights.iter().map(|light| &light.placed));
        self.ignore_foreign_groups();
    }

    fn ignore_all_pairs(&mut self, bodies: std::ops::Range<usize>) {
        for a in bodies.clone() {
            for b in a + 1..bodies.end {
                self.ignore_pair(a, b);
            }
        }
    }

    fn ignore_pair(&mut self, a: usize, b: usize) {
        let [a, b] = [a, b].map(|body| self.scene.bodies[body].handle);
        self.scene.world.ignore_collision(a, b);
    }

    /// Bodies of different groups that share none never collide; bodies in no group collide with everything.
    fn ignore_foreign_groups(&mut self) {
        let mut members: BTreeMap<&[u32], Vec<usize>> = BTreeMap::new();
        for (index, body) in self.scene.bodies.iter().enumerate() {
            if !body.collision_groups.is_empty() {
                members.entry(&body.collision_groups).or_default().push(index);
            }
        }
        let members: Vec<_> =
            members.into_iter().map(|(groups, m)| (BTreeSet::from_iter(groups.to_vec()), m)).collect();
        for (i, (groups, bodies)) in members.iter().enumerate() {
            for (_, others) in members[i + 1..].iter().filter(|(other, _)| other.is_disjoint(groups)) {
                for &a in bodies {
                    for &b in others {
                        self.ignore_pair(a, b);
                    }
                }
            }
        }
    }

    fn resolve_parents(&mut self) {
        let scene = &self.scene;
        let find = |text: &str| (!text.is_empty()).then(|| (text.to_owned(), scene.body_names.find(text)));
        let cameras: Vec<_> = scene.cameras.iter().map(|camera| find(&camera.parameters.parent_name)).collect();
        let lights: Vec<_> = scene.lights.iter().map(|light| find(&light.parameters.parent_name)).collect();
        let mut lost = Vec::new();
        let mut set = |placed: &mut Placed, wanted: Option<(String, Found)>| {
            let Some((text, found)) = wanted else { return };
            placed.parent = found.index();
            if placed.parent.is_none() {
                lost.push(format!(
                    "`{}`: parent `{text}` is {found}; it stays in the world",
                    placed.identity.identifier
                ));
            }
        };
        for (camera, wanted) in self.scene.cameras.iter_mut().zip(cameras) {
            set(&mut camera.placed, wanted);
        }
        for (light, wanted) in self.scene.lights.iter_mut().zip(lights) {
            set(&mut light.placed, wanted);
        }
        let source = SourcePos { file: PathBuf::from("scene").into(), line: 0, column: 0 };
        lost.into_iter().for_each(|message| self.note(Severity::Warning, &source, message));
    }
}

fn enter_placed<'p>(names: &mut NameMap, placed: impl Iterator<Item = &'p Placed>) {
    let known = names.iter().count();
    for (index, placed) in placed.enumerate().skip(known) {
        names.insert(&placed.identity.key(), index);
    }
}

/// The options, completed by the world file.
fn physics(world: &adf::World, options: &PhysicsOptions, notes: &mut Vec<Note>) -> PhysicsOptions {
    let settings = &world.physics;
    let mut unknown = |key: &str, name: &str, known: Vec<&str>| {
        let message = format!("`physics / {key}`: `{name}` is not known, expected one of {}", known.join(", "));
        notes.push(Note { severity: Severity::Error, source: world.common.source.clone(), message });
    };
    let solver = settings.solver.as_deref().and_then(|name| {
        let solver = Solver::from_name(name);
        if solver.is_none() {
            unknown("solver", name, Solver::NAMES.map(|(name, _)| name).to_vec());
        }
        solver
    });
    let integrator = settings.integrator.as_deref().and_then(|name| {
        let integrator = Integrator::from_name(name);
        if integrator.is_none() {
            unknown("integrator", name, Integrator::NAMES.map(|(name, _)| name).to_vec());
        }
        integrator
    });
    let profile = settings.profile.map(|profile| match profile {
        PhysicsProfile::Legacy => Profile::Legacy,
        PhysicsProfile::Accurate => Profile::Accurate,
    });
    PhysicsOptions {
        profile: options.profile.or(profile),
        solver: options.solver.or(solver),
        iterations: options.iterations.or(settings.iterations),
        integrator: options.integrator.or(integrator),
        sub_step: options.sub_step.or(settings.sub_step),
    }
}
