//! Live ghost objects: volumes that take the weight and the speed off what is in them.

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};

use super::attached::Attached;
use super::build::Builder;
use super::list::SceneObject;
use super::{Bodies, Identity, ObjectType, Parent, Scene};
use crate::adf::{self, SourcePos};
use crate::bullet::{BodyHandle, GhostHandle, World};
use crate::comm::{GhostInfo, GhostReading, ObjectKind, Snapshot};
use crate::control::Profile;
use crate::ids::{BodyId, GhostId};

/// A ghost object of a [`Scene`](super::Scene).
#[derive(Debug)]
pub struct Ghost {
    /// Names, parent and pose.
    pub attached: Attached,
    /// Text that names the parent; empty: the world.
    pub parent_name: String,
    /// Collision groups.
    pub collision_groups: Vec<u32>,
    /// Where it is defined.
    pub source: SourcePos,
    pub(crate) handle: GhostHandle,
    pose: Isometry3<f64>,
    /// Bodies in it, one entry a contact.
    sensed: Vec<BodyHandle>,
    found: Vec<BodyHandle>,
}

/// What of a [`Ghost`] changes while the simulation runs, beside what Bullet knows.
#[derive(Debug, Clone)]
pub(super) struct SavedGhost {
    attached: Isometry3<f64>,
    pose: Isometry3<f64>,
    sensed: Vec<BodyHandle>,
}

/// Share of the velocity against the ghost that is left after an iteration in it.
const KEPT: f64 = 0.9;
/// Bodies in a ghost, counted by contact, that take no new memory.
const CONTACTS: usize = 256;

impl SceneObject for Ghost {
    type Id = GhostId;
    type Saved = SavedGhost;
    const TYPE: ObjectType = ObjectType::Ghost;
    const RANK: u8 = 5;
    const ACTS: bool = true;

    fn identity(&self) -> &Identity {
        &self.attached.identity
    }

    fn add_all(builder: &mut Builder<'_>, model: &adf::Model) {
        for ghost in &model.ghosts {
            builder.with_plugins(Self::TYPE, &ghost.common, |builder| builder.add_ghost(ghost));
        }
    }

    fn kind(&self, id: Self::Id, _scene: &Scene) -> Option<ObjectKind> {
        Some(ObjectKind::Ghost(id, Box::new(GhostInfo { parent_name: self.parent_name.clone() })))
    }

    fn make_room(&self, _scene: &Scene, snapshot: &mut Snapshot) {
        snapshot.ghosts.push(GhostReading::default());
    }

    fn read(&self, id: Self::Id, scene: &Scene, snapshot: &mut Snapshot) {
        let reading = &mut snapshot.ghosts[id];
        reading.pose = self.pose;
        reading.sensed.clear();
        for body in self.sensed(&scene.bodies) {
            let identifier = &scene.bodies[body].identity.qualified;
            if !reading.sensed.iter().any(|known| Arc::ptr_eq(known, identifier)) {
                reading.sensed.push(Arc::clone(identifier));
            }
        }
    }

    fn pose(&self, _id: Self::Id, _scene: &Scene) -> Option<Isometry3<f64>> {
        Some(self.pose)
    }

    /// The bodies in it, one entry a contact.
    fn values(&self, scene: &Scene, out: &mut Vec<f64>) {
        out.extend(self.sensed(&scene.bodies).map(|body| body.index() as f64));
    }

    fn update(scene: &mut Scene, id: Self::Id, _sub_step: f64, _interval: f64) {
        let Attached { parent, pose, .. } = scene.ghosts[id].attached;
        let pose = scene.global_pose(parent, &pose);
        let carrier = match parent {
            Some(Parent::Body(body)) => Some(body),
            _ => None,
        };
        let Scene { ghosts, world, bodies, gravity, profile, .. } = scene;
        ghosts[id].follow(world, bodies, pose, carrier, gravity, *profile);
    }

    /// Where it was, without anything in it: the bodies have their weight again.
    fn reset(scene: &mut Scene, id: Self::Id) {
        let ghost = &mut scene.ghosts[id];
        ghost.attached.reset();
        ghost.sensed.clear();
        scene.place_ghost(id);
    }

    fn save(&self) -> SavedGhost {
        // All fields by name, so that no new one is forgotten.
        let Self { attached, parent_name: _, collision_groups: _, source: _, handle: _, pose, sensed, found: _ } = self;
        SavedGhost { attached: attached.pose, pose: *pose, sensed: sensed.clone() }
    }

    fn restore(&mut self, saved: &SavedGhost) {
        (self.attached.pose, self.pose) = (saved.attached, saved.pose);
        self.sensed.clone_from(&saved.sensed);
    }
}

impl Scene {
    /// Puts a ghost where it is before the first update. In the C++ program, and with the legacy profile, that is its pose in
    /// the parent, taken as one in the world.
    pub(super) fn place_ghost(&mut self, id: GhostId) {
        let Attached { parent, pose, .. } = self.ghosts[id].attached;
        let parent = parent.filter(|_| self.profile == Profile::Accurate);
        let pose = self.global_pose(parent, &pose);
        let Self { ghosts, world, .. } = self;
        ghosts[id].pose = pose;
        world.set_ghost_pose(ghosts[id].handle, &pose);
    }
}

impl Ghost {
    pub(super) fn new(attached: Attached, ghost: &adf::GhostObject, handle: GhostHandle) -> Self {
        Self {
            pose: attached.pose,
            attached,
            parent_name: ghost.parent.clone(),
            collision_groups: ghost.collision_groups.clone(),
            source: ghost.common.source.clone(),
            handle,
            sensed: Vec::with_capacity(CONTACTS),
            found: Vec::with_capacity(CONTACTS),
        }
    }

    /// Pose in the world.
    pub fn pose(&self) -> &Isometry3<f64> {
        &self.pose
    }

    /// The bodies in it, one entry a contact.
    pub fn sensed<'a>(&'a self, bodies: &'a Bodies) -> impl Iterator<Item = BodyId> + 'a {
        self.sensed.iter().filter_map(|&handle| bodies.id_of(handle))
    }

    /// Moves to `pose` in the world; what left it gets its weight back, what is in it is held. `carrier` is the parent
    /// body.
    fn follow(
        &mut self,
        world: &mut World,
        bodies: &Bodies,
        pose: Isometry3<f64>,
        carrier: Option<BodyId>,
        gravity: &Vector3<f64>,
        profile: Profile,
    ) {
        self.pose = pose;
        world.set_ghost_pose(self.handle, &pose);
        self.release(world, bodies, gravity);
        world.ghost_overlaps(self.handle, &mut self.found);
        let velocity = carrier.and_then(|body| world.velocity(bodies[body].handle)).unwrap_or_default().0;
        for i in 0..self.found.len() {
            let handle = self.found[i];
            let Some(body) = bodies.id_of(handle) else { continue };
            let is_again = self.sensed.contains(&handle);
            // The C++ program slows a body once for each contact, and what carries the ghost too.
            let left_out = profile == Profile::Accurate && (is_again || carrier == Some(body));
            if left_out || bodies[body].mass == 0.0 || !self.shares_group(&bodies[body].collision_groups) {
                continue;
            }
            self.sensed.push(handle);
            hold(world, handle, &velocity);
        }
    }

    /// Gives everything in it its own weight back.
    pub(crate) fn release(&mut self, world: &mut World, bodies: &Bodies, gravity: &Vector3<f64>) {
        for handle in self.sensed.drain(..) {
            let Some(body) = bodies.id_of(handle) else { continue };
            world.set_body_gravity(handle, bodies[body].gravity.as_ref().unwrap_or(gravity));
        }
    }

    fn shares_group(&self, groups: &[u32]) -> bool {
        let own = &self.collision_groups;
        own.is_empty() || groups.is_empty() || groups.iter().any(|group| own.contains(group))
    }
}

/// Takes the weight and a share of the velocity against `carried`, m/s, off a body.
fn hold(world: &mut World, body: BodyHandle, carried: &Vector3<f64>) {
    let Some((linear, angular)) = world.velocity(body) else { return };
    let speed = carried.norm();
    let across = if speed > 1e-5 { linear - carried * (linear.dot(carried) / (speed * speed)) } else { linear };
    world.set_body_gravity(body, &Vector3::zeros());
    world.set_velocity(body, &(across * KEPT + carried), &(angular * KEPT));
}
