//! Taking models out of a scene, and what follows from its list of objects.

use super::placed::Placed;
use super::{BodyGraph, Element, Parent, Scene};
use crate::comm::ObjectKind;

impl Scene {
    /// Index of the model called `name`: its key, or a part of the key that no other has. The environment cannot be named.
    pub(crate) fn find_model(&self, name: &str) -> Result<usize, String> {
        match self.names.models.find(name).index() {
            Some(0) => Err("it is the world's environment".into()),
            Some(index) => Ok(index),
            None => Err(self.names.models.find(name).to_string()),
        }
    }

    /// Index of the model called `name`, the environment included.
    pub(crate) fn find_any_model(&self, name: &str) -> Option<usize> {
        self.names.models.index(name)
    }

    /// Takes a model out of the scene, with all joints and everything held that leads into it.
    pub(crate) fn remove_model(&mut self, model: usize) {
        self.orphan_children(model);
        let Self { world, bodies, gravity, .. } = self;
        let is_gone = |body: usize| bodies[body].identity.model == model;
        // What refers to bodies goes before them.
        for actuator in &mut self.actuators {
            let held = bodies.iter().any(|body| body.identity.model == model && actuator.holds(body.handle));
            if held || actuator.identity.model == model || is_gone(actuator.parent) {
                actuator.release(world, bodies);
            }
        }
        for vehicle in self.vehicles.iter().filter(|v| v.identity.model == model || is_gone(v.chassis)) {
            world.remove_vehicle(vehicle.handle);
        }
        for joint in self.joints.iter_mut().filter(|joint| is_gone(joint.parent) || is_gone(joint.child)) {
            joint.removed = true;
            (joint.position, joint.velocity, joint.effort) = (0.0, 0.0, 0.0);
            joint.place = None;
            if let Some(handle) = joint.handle.take() {
                world.remove_constraint(handle);
            }
        }
        for ghost in self.ghosts.iter_mut().filter(|ghost| ghost.placed.identity.model == model) {
            ghost.release(world, bodies, gravity);
            world.remove_ghost(ghost.handle);
        }
        for soft in self.soft_bodies.iter().filter(|soft| soft.identity.model == model) {
            world.remove_soft_body(soft.handle);
        }
        for body in bodies.iter().filter(|body| body.identity.model == model) {
            world.remove_body(body.handle);
        }
        self.models[model].removed = true;
        self.forget_names(model);
        self.rebuild_graph();
        self.arrange();
    }

    /// Whether an object was taken out of the scene: its model, or what it stood on.
    pub(crate) fn is_removed(&self, kind: &ObjectKind) -> bool {
        let model_is_gone = |model: usize| self.models[model].removed;
        let body_is_gone = |body: usize| model_is_gone(self.bodies[body].identity.model);
        let stands_on_nothing = match *kind {
            ObjectKind::Sensor(i, _) => body_is_gone(self.sensors[i].parent),
            ObjectKind::Actuator(i, _) => body_is_gone(self.actuators[i].parent),
            ObjectKind::Vehicle(i, _) => body_is_gone(self.vehicles[i].chassis),
            _ => false,
        };
        stands_on_nothing || self.identity(kind).is_some_and(|identity| model_is_gone(identity.model))
    }

    fn forget_names(&mut self, model: usize) {
        let Self { names, bodies, .. } = self;
        let body_is_gone = |body: usize| bodies[body].identity.model == model;
        names.models.remove(|index| index == model);
        self.body_names.remove(body_is_gone);
        names.joints.remove(|i| self.joints[i].removed);
        names.soft_bodies.remove(|i| self.soft_bodies[i].identity.model == model);
        names.ghosts.remove(|i| self.ghosts[i].placed.identity.model == model);
        names.cameras.remove(|i| self.cameras[i].placed.identity.model == model);
        names.lights.remove(|i| self.lights[i].placed.identity.model == model);
        names.sensors.remove(|i| self.sensors[i].identity.model == model || body_is_gone(self.sensors[i].parent));
        names.actuators.remove(|i| self.actuators[i].identity.model == model || body_is_gone(self.actuators[i].parent));
        names.vehicles.remove(|i| self.vehicles[i].identity.model == model || body_is_gone(self.vehicles[i].chassis));
    }

    /// What hung on an object of the model stays where it is, in the world.
    fn orphan_children(&mut self, model: usize) {
        let model_of = |scene: &Self, parent: Parent| match parent {
            Parent::Body(i) => scene.bodies[i].identity.model,
            Parent::Camera(i) => scene.cameras[i].placed.identity.model,
            Parent::Light(i) => scene.lights[i].placed.identity.model,
            Parent::Ghost(i) => scene.ghosts[i].placed.identity.model,
        };
        for child in self.all_placed().collect::<Vec<_>>() {
            let Some(&mut Placed { parent: Some(parent), pose, .. }) = self.placed_mut(child) else { continue };
            if model_of(self, parent) == model {
                let pose = self.global_pose(Some(parent), &pose);
                if let Some(placed) = self.placed_mut(child) {
                    (placed.parent, placed.pose) = (None, pose);
                }
            }
        }
    }

    fn rebuild_graph(&mut self) {
        self.graph = BodyGraph::default();
        for _ in 0..self.bodies.len() {
            self.graph.add_body();
        }
        for (index, joint) in self.joints.iter().enumerate().filter(|(_, joint)| !joint.removed) {
            self.graph.add_joint(joint.parent, joint.child, index, joint.passive);
        }
    }

    /// Brings what follows from the lists of objects up to date: active joints, feedback, the order of updates.
    pub(super) fn arrange(&mut self) {
        let graph = &self.graph;
        let active = |body| graph.active(body).map(|entry| entry.joint).collect();
        self.active_joints = (0..self.bodies.len()).map(active).collect();
        let mut order = Vec::new();
        for i in 0..self.ghosts.len() {
            order.push((ObjectKind::Ghost(i, Box::default()), Element::Ghost(i)));
        }
        for i in 0..self.sensors.len() {
            order.push((ObjectKind::Sensor(i, Box::default()), Element::Sensor(i)));
        }
        for i in 0..self.vehicles.len() {
            order.push((ObjectKind::Vehicle(i, Box::default()), Element::Vehicle(i)));
        }
        order.retain(|(kind, _)| !self.is_removed(kind));
        order.sort_by_cached_key(|(kind, _)| self.visiting_key(kind));
        self.elements = order.into_iter().map(|(_, element)| element).collect();
    }
}
