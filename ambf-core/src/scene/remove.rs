//! Taking models and bodies out of a scene, and what follows from its list of objects.

use std::collections::BTreeSet;
use std::fmt::{self, Write};
use std::hash::{DefaultHasher, Hasher};
use std::sync::Arc;

use ambf_dynamics::assembly::Omission;

use super::attached::Attached;
use super::list::ObjectList;
use super::{Bodies, BodyGraph, Joint, JointCoupling, ModelInfo, ObjectId, ObjectType, Parent, Scene};
use crate::adf;
use crate::ids::{BodyId, JointId, ModelId};

impl ModelInfo {
    /// Takes the model out of the scene, and forgets what it was made from: a simulator may add and remove models for
    /// days.
    fn remove(&mut self) {
        self.removed = true;
        self.fingerprint = fingerprint(&self.description);
        self.shared = None;
        self.description = Arc::new(self.description.outline());
    }
}

/// Hash of all that a description says.
fn fingerprint(model: &adf::Model) -> u64 {
    struct Hashed(DefaultHasher);
    impl fmt::Write for Hashed {
        fn write_str(&mut self, text: &str) -> fmt::Result {
            self.0.write(text.as_bytes());
            Ok(())
        }
    }
    let mut hashed = Hashed(DefaultHasher::new());
    // Neither the description nor the hasher can fail.
    let _ = write!(hashed, "{model:?}");
    hashed.0.finish()
}

impl Scene {
    /// The model called `name`: its key, or a part of the key that no other has. The environment cannot be
    /// named.
    pub(crate) fn find_model(&self, name: &str) -> Result<ModelId, String> {
        match self.model_names.find(name).id() {
            Some(ModelId::ENVIRONMENT) => Err("it is the world's environment".into()),
            Some(id) => Ok(id),
            None => Err(self.model_names.find(name).to_string()),
        }
    }

    /// The model called `name`, the environment included.
    pub(crate) fn find_any_model(&self, name: &str) -> Option<ModelId> {
        self.model_names.id(name)
    }

    /// Takes a model out of the scene, with all joints and constraints of actuators that lead into it.
    pub(crate) fn remove_model(&mut self, model: ModelId) {
        let Self { world, bodies, gravity, .. } = self;
        for ghost in self.ghosts.iter_mut().filter(|ghost| ghost.attached.identity.model == model) {
            ghost.release(world, bodies, gravity);
        }
        self.orphan_children(|scene, parent| scene.model_of_parent(parent) == model);
        self.release_bodies(|bodies, body| bodies[body].identity.model == model);
        // Its joints may be between bodies of others.
        self.remove_joints(|joint| joint.model == model);
        let Self { world, bodies, .. } = self;
        for ghost in self.ghosts.iter().filter(|ghost| ghost.attached.identity.model == model) {
            world.remove_ghost(ghost.handle);
        }
        for actuator in self.actuators.iter_mut().filter(|actuator| actuator.identity.model == model) {
            actuator.release(world, bodies);
        }
        for vehicle in self.vehicles.iter().filter(|vehicle| vehicle.identity.model == model) {
            world.remove_vehicle(vehicle.handle);
        }
        for soft in self.soft_bodies.iter().filter(|soft| soft.identity.model == model) {
            world.remove_soft_body(soft.handle);
        }
        for body in bodies.iter().filter(|body| body.identity.model == model) {
            world.remove_body(body.handle);
        }
        self.models[model].remove();
        self.plugins.retain(|declared| declared.model != model);
        self.model_names.remove(|id| id == model);
        self.forget();
    }

    /// Takes one body out of the scene, with all joints on it and what stands on it. False when it is not there.
    pub(crate) fn remove_body(&mut self, body: BodyId) -> bool {
        if self.bodies.get(body).is_none() || self.body_is_gone(body) {
            return false;
        }
        self.orphan_children(|_, parent| parent == Parent::Body(body));
        self.release_bodies(|_, other| other == body);
        self.world.remove_body(self.bodies[body].handle);
        self.bodies[body].removed = true;
        self.forget();
        true
    }

    /// Removes constraints, vehicles and joints on bodies that go: what refers to bodies goes before them.
    fn release_bodies(&mut self, is_gone: impl Fn(&Bodies, BodyId) -> bool) {
        let Self { world, bodies, .. } = self;
        let going: Vec<BodyId> = bodies.ids().filter(|&body| is_gone(bodies, body)).collect();
        let is_gone = |body: BodyId| going.binary_search(&body).is_ok();
        for actuator in &mut self.actuators {
            if is_gone(actuator.parent) || going.iter().any(|&body| actuator.holds(bodies[body].handle)) {
                actuator.release(world, bodies);
            }
        }
        for vehicle in self.vehicles.iter().filter(|vehicle| is_gone(vehicle.chassis)) {
            world.remove_vehicle(vehicle.handle);
        }
        self.remove_joints(|joint| is_gone(joint.parent) || is_gone(joint.child));
    }

    fn remove_joints(&mut self, goes: impl Fn(&Joint) -> bool) {
        for joint in self.joints.iter_mut().filter(|joint| goes(joint)) {
            joint.removed = true;
            (joint.position, joint.velocity, joint.effort) = (0.0, 0.0, 0.0);
            joint.place = None;
            if let Some(handle) = joint.handle.take() {
                self.world.remove_constraint(handle);
            }
        }
        let Self { redundant_loops, followers, joints, world, .. } = self;
        let removed: BTreeSet<JointId> =
            joints.entries().filter(|(_, joint)| joint.removed).map(|(id, _)| id).collect();
        for (id, joint) in joints.entries_mut() {
            let leads = |coupling: &JointCoupling| coupling.leaders.iter().any(|(leader, _)| removed.contains(leader));
            if removed.contains(&id) || joint.coupling.as_ref().is_some_and(leads) {
                joint.coupling = None;
            }
        }
        followers.retain(|&follower| joints[follower].coupling.is_some());
        redundant_loops.retain(|members| {
            let is_whole = !members.iter().any(|&joint| joints[joint].removed);
            if !is_whole {
                for Joint { handle, frames, .. } in members.iter().map(|&joint| &joints[joint]) {
                    if let Some(handle) = *handle {
                        world.omit_rows(handle, frames, &Omission::NONE);
                    }
                }
            }
            is_whole
        });
    }

    /// Whether a body was taken out of the scene, by itself or with its model.
    pub fn body_is_gone(&self, body: BodyId) -> bool {
        let body = &self.bodies[body];
        body.removed || self.models[body.identity.model].removed
    }

    /// Whether an object was taken out of the scene: itself, its model, or what it stood on.
    pub(crate) fn is_removed(&self, object: ObjectId) -> bool {
        self.stands_on(object).is_some_and(|body| self.body_is_gone(body))
            || self.model_of(object).is_some_and(|model| self.models[model].removed)
    }

    /// Forgets the names of what was removed, and brings up to date what follows from the lists of objects.
    fn forget(&mut self) {
        self.changes += 1;
        let is_gone = |list: &dyn ObjectList| {
            let kind = list.object_type();
            (0..list.count()).map(|index| self.is_removed(ObjectId { kind, index })).collect::<Vec<_>>()
        };
        let gone = self.lists().map(is_gone);
        for (list, gone) in self.lists_mut().into_iter().zip(gone) {
            list.forget_names(&gone);
        }
        let Self { joints, joint_names, .. } = self;
        joint_names.remove(|joint| joints[joint].removed);
        self.rebuild_graph();
        self.arrange();
        self.choose_leading_tools();
        self.hide_removed_volumes();
    }

    /// Gives up the places of a model that was removed for the same model that is about to be added again: of the same
    /// key, and of the same description to the letter. So an id never names another object than before. A body to which
    /// an object of another model refers keeps its place: that object is gone with it.
    pub(super) fn vacate_for(&mut self, key: &str, description: &adf::Model) {
        let same_key = |(_, model): &(ModelId, &ModelInfo)| model.removed && model.key == key;
        let mut before = self.models.entries().filter(same_key).peekable();
        let wanted = before.peek().map(|_| fingerprint(description));
        let same = before.filter(|(_, model)| Some(model.fingerprint) == wanted).map(|(id, _)| id).collect();
        self.vacate(&same);
    }

    /// Gives up the places of some removed models instead of those that were given up before.
    pub(super) fn vacate(&mut self, of: &BTreeSet<ModelId>) {
        if of.is_empty() {
            // The usual case, of each model that is loaded.
            self.lists_mut().into_iter().for_each(|list| list.vacate(&[]));
            self.joints.vacate([]);
            self.models.vacate([]);
            return;
        }
        let is_removed = |model: ModelId| of.contains(&model);
        let held = self.held_bodies();
        let vacant = self.lists().map(|list| {
            let is_vacant = |&index: &usize| {
                let is_held = list.object_type() == ObjectType::Body && held.contains(&BodyId::new(index));
                !is_held && list.identity(index).is_some_and(|identity| is_removed(identity.model))
            };
            (0..list.count()).filter(is_vacant).collect::<Vec<_>>()
        });
        let joints: Vec<_> =
            self.joints.entries().filter(|(_, joint)| is_removed(joint.model)).map(|(id, _)| id).collect();
        let mut models = of.clone();
        for list in self.lists() {
            (0..list.count()).filter_map(|index| list.identity(index)).for_each(|identity| {
                models.remove(&identity.model);
            });
        }
        self.joints.iter().for_each(|joint| {
            models.remove(&joint.model);
        });
        for (list, vacant) in self.lists_mut().into_iter().zip(&vacant) {
            list.vacate(vacant);
        }
        self.joints.vacate(joints);
        self.models.vacate(models);
    }

    /// The bodies to which objects refer whose models were not removed.
    fn held_bodies(&self) -> BTreeSet<BodyId> {
        let mut held = BTreeSet::new();
        let is_there = |model: ModelId| !self.models[model].removed;
        for list in self.lists().into_iter().filter(|list| list.object_type() != ObjectType::Body) {
            let standing = |index: usize| list.identity(index).filter(|identity| is_there(identity.model));
            held.extend((0..list.count()).filter_map(|index| standing(index).and(list.stands_on(index))));
        }
        for joint in self.joints.iter().filter(|joint| is_there(joint.model)) {
            held.extend([joint.parent, joint.child]);
        }
        for vehicle in self.vehicles.iter().filter(|vehicle| is_there(vehicle.identity.model)) {
            held.extend(vehicle.wheels.iter().filter_map(|wheel| wheel.body));
        }
        held
    }

    fn model_of_parent(&self, parent: Parent) -> ModelId {
        match parent {
            Parent::Body(i) => self.bodies[i].identity.model,
            Parent::Camera(i) => self.cameras[i].attached.identity.model,
            Parent::Light(i) => self.lights[i].attached.identity.model,
            Parent::Ghost(i) => self.ghosts[i].attached.identity.model,
            Parent::Volume(i) => self.volumes[i].attached.identity.model,
        }
    }

    /// What hung on an object that goes stays where it is, in the world.
    fn orphan_children(&mut self, goes: impl Fn(&Self, Parent) -> bool) {
        for child in self.all_attached().collect::<Vec<_>>() {
            let Some(&mut Attached { parent: Some(parent), pose, .. }) = self.attached_mut(child) else { continue };
            if goes(self, parent) {
                let pose = self.global_pose(Some(parent), &pose);
                if let Some(attached) = self.attached_mut(child) {
                    (attached.parent, attached.pose) = (None, pose);
                }
            }
        }
    }

    fn rebuild_graph(&mut self) {
        self.graph = BodyGraph::default();
        self.graph.grow(self.bodies.len());
        for (id, joint) in self.joints.entries().filter(|(_, joint)| !joint.removed) {
            self.graph.add_joint(joint.parent, joint.child, id, joint.passive);
        }
    }

    /// Brings what follows from the lists of objects up to date: active joints, feedback, the order of updates.
    pub(super) fn arrange(&mut self) {
        let graph = &self.graph;
        let active = |body| graph.active(body).map(|entry| entry.joint).collect();
        self.active_joints = self.bodies.ids().map(active).collect();
        let mut order = Vec::new();
        for list in self.lists() {
            let Some(update) = list.update() else { continue };
            let objects = (0..list.count()).map(|index| ObjectId { kind: list.object_type(), index });
            order.extend(objects.filter(|&object| !self.is_removed(object)).map(|object| (object, update)));
        }
        order.sort_by_cached_key(|&(object, _)| self.visiting_key(Some(object)));
        self.elements = order.into_iter().map(|(object, update)| (update, object.index)).collect();
        let Self { sensors, bodies, touching, .. } = self;
        let feeling = sensors.iter().filter(|sensor| sensor.contacts().is_some());
        touching.watch(feeling.map(|sensor| bodies[sensor.parent].handle));
    }
}
