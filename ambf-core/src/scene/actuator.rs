//! Live constraint actuators: they fix the body that a command names, or what a sensor sees, to their parent.

use nalgebra::Isometry3;

use super::build::Builder;
use super::commands::{Commanded, Commands};
use super::list::SceneObject;
use super::sensor::{Sensed, Sensor};
use super::{Bodies, Identity, NameMap, ObjectType, Objects, Scene};
use crate::adf;
use crate::bullet::{BodyHandle, Constraint, ConstraintHandle, ConstraintKind, SoftBodyHandle, World};
use crate::comm::{ActuatorCommand, ActuatorInfo, ObjectKind, Snapshot};
use crate::control::orientation_of;
use crate::ids::{ActuatorId, BodyId, Id, SensorId};

/// An actuator of a [`Scene`](super::Scene).
#[derive(Debug)]
pub struct Actuator {
    /// Names and publishing rates.
    pub identity: Identity,
    /// Parent's name and pose in the parent's body frame.
    pub info: ActuatorInfo,
    /// Index of the parent body.
    pub parent: BodyId,
    /// Pose of the constraint in the parent's inertial frame.
    pub(super) frame: Isometry3<f64>,
    held: Held,
    /// What it could not find was named.
    complained: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Held {
    Nothing,
    Body(BodyHandle, ConstraintHandle),
    SoftBody(SoftBodyHandle),
}

/// How far from the point that a ray hits a node or the middle of a face may be, m.
const REACH: f64 = 0.1;

/// What of an [`Actuator`] changes while the simulation runs.
#[derive(Debug, Clone, Copy)]
pub(super) struct SavedActuator {
    held: Held,
    complained: bool,
}

impl SceneObject for Actuator {
    type Id = ActuatorId;
    type Saved = SavedActuator;
    const TYPE: ObjectType = ObjectType::Actuator;
    const RANK: u8 = 0;

    fn identity(&self) -> &Identity {
        &self.identity
    }

    fn add_all(builder: &mut Builder<'_>, model: &adf::Model) {
        for actuator in &model.actuators {
            builder.with_plugins(Self::TYPE, &actuator.common, |builder| builder.add_actuator(actuator));
        }
    }

    fn kind(&self, id: Self::Id, _scene: &Scene) -> Option<ObjectKind> {
        Some(ObjectKind::Actuator(id, Box::new(self.info.clone())))
    }

    fn stands_on(&self, _id: Self::Id) -> Option<BodyId> {
        Some(self.parent)
    }

    fn make_room(&self, _scene: &Scene, snapshot: &mut Snapshot) {
        snapshot.actuators.push(false);
    }

    fn read(&self, id: Self::Id, _scene: &Scene, snapshot: &mut Snapshot) {
        snapshot.actuators[id] = self.is_actuated();
    }

    fn commands(id: Self::Id) -> Option<Box<dyn Commands>> {
        Some(Commanded::new(id, |scene, id, command, notices| notices.extend(scene.command_actuator(id, command))))
    }

    fn pose(&self, _id: Self::Id, scene: &Scene) -> Option<Isometry3<f64>> {
        Some(scene.bodies[self.parent].pose(&scene.world) * self.info.pose)
    }

    /// Whether it holds something.
    fn values(&self, _scene: &Scene, out: &mut Vec<f64>) {
        out.push(f64::from(u8::from(self.is_actuated())));
    }

    /// Holding nothing.
    fn reset(Scene { actuators, world, bodies, .. }: &mut Scene, id: Self::Id) {
        actuators[id].release(world, bodies);
        actuators[id].complained = false;
    }

    fn save(&self) -> SavedActuator {
        // All fields by name, so that no new one is forgotten.
        let Self { identity: _, info: _, parent: _, frame: _, held, complained } = self;
        SavedActuator { held: *held, complained: *complained }
    }

    fn restore(&mut self, saved: &SavedActuator) {
        (self.held, self.complained) = (saved.held, saved.complained);
    }
}

impl Scene {
    /// Looks whether there is what a command lets an actuator hold. A command that releases names nothing.
    ///
    /// # Errors
    /// A sentence that says what is not there, or not unique.
    pub fn check_actuator_command(&self, id: ActuatorId, command: &ActuatorCommand) -> Result<(), String> {
        let (actuator, Scene { sensors, bodies, .. }) = (&self.actuators[id], self);
        let (sensor, body) = (&command.sensor_identifier, &command.body_name);
        match (command.actuate, command.use_sensor_data) {
            (true, true) if named(sensors, sensor, |sensor| &sensor.identity).is_none() => {
                Err(actuator.complaint(&sensors.names, "sensor", sensor))
            }
            (true, false) if named(bodies, body, |body| &body.identity).is_none() => {
                Err(actuator.complaint(&bodies.names, "body", body))
            }
            _ => Ok(()),
        }
    }
}

/// The object that `text` names: by its identifier or a part of it, else by the name of its topics or the last parts of that.
fn named<I: Id, T>(objects: &Objects<I, T>, text: &str, identity: impl Fn(&T) -> &Identity) -> Option<I> {
    let identified = objects.names.id(text);
    if identified.is_some() || text.is_empty() {
        return identified;
    }
    let (whole, ends): (Vec<I>, Vec<I>) = (objects.names.iter())
        .filter_map(|(_, id)| {
            let listed = identity(&objects[id]).topic();
            let before = listed.strip_suffix(text)?;
            let is_whole_part = before.is_empty() || before.ends_with('/') || text.starts_with('/');
            is_whole_part.then_some((id, before.is_empty()))
        })
        .fold(Default::default(), |(mut whole, mut ends), (id, is_whole)| {
            if is_whole { &mut whole } else { &mut ends }.push(id);
            (whole, ends)
        });
    match (&whole[..], &ends[..]) {
        ([only], _) | ([], [only]) => Some(*only),
        _ => None,
    }
}

impl Actuator {
    pub(super) fn new(identity: Identity, info: ActuatorInfo, parent: BodyId, frame: Isometry3<f64>) -> Self {
        Self { identity, info, parent, frame, held: Held::Nothing, complained: false }
    }

    /// Whether it holds something.
    pub fn is_actuated(&self) -> bool {
        self.held != Held::Nothing
    }

    /// Executes a command. A sentence when what it names is not there, once until a command releases it.
    pub(crate) fn apply_command(
        &mut self,
        world: &mut World,
        bodies: &Bodies,
        sensors: &Objects<SensorId, Sensor>,
        command: &ActuatorCommand,
    ) -> Option<String> {
        if !command.actuate {
            self.release(world, bodies);
            self.complained = false;
            return None;
        }
        if self.is_actuated() {
            return None;
        }
        if command.use_sensor_data {
            let Some(sensor) = named(sensors, &command.sensor_identifier, |sensor| &sensor.identity) else {
                return self.complain(&sensors.names, "sensor", &command.sensor_identifier);
            };
            for sensed in sensors[sensor].sensed(bodies) {
                match sensed {
                    Sensed::Body(body) => self.hold(world, bodies, body, None),
                    Sensed::SoftBody(body, point) => self.hold_soft(world, bodies, body, &point.into()),
                    Sensed::Other => (),
                }
            }
            return None;
        }
        let Some(body) = named(bodies, &command.body_name, |body| &body.identity) else {
            return self.complain(&bodies.names, "body", &command.body_name);
        };
        let offset = command.use_offset.then(|| {
            let rotation = orientation_of(&command.offset_orientation).0;
            Isometry3::from_parts(command.offset_position.into(), rotation)
        });
        self.hold(world, bodies, body, offset);
        None
    }

    fn complain<I: Id>(&mut self, names: &NameMap<I>, what: &str, text: &str) -> Option<String> {
        let first = !std::mem::replace(&mut self.complained, true);
        first.then(|| self.complaint(names, what, text))
    }

    fn complaint<I: Id>(&self, names: &NameMap<I>, what: &str, text: &str) -> String {
        format!("actuator `{}`: {what} `{text}` is {}", self.identity.key(), names.find(text))
    }

    /// Holds a body at `offset`, the pose of the constraint in its inertial frame, or where it is now.
    pub(crate) fn hold(&mut self, world: &mut World, bodies: &Bodies, body: BodyId, offset: Option<Isometry3<f64>>) {
        let (parent, target) = (bodies[self.parent].handle, bodies[body].handle);
        if matches!(self.held, Held::Body(held, _) if held == target) || parent == target {
            return;
        }
        self.release(world, bodies);
        let (Some(pose), Some(target_pose)) = (world.pose(parent), world.pose(target)) else { return };
        let constraint = Constraint {
            kind: ConstraintKind::Fixed,
            frame_a: self.frame,
            frame_b: offset.unwrap_or_else(|| target_pose.inverse() * pose * self.frame),
            parameters: Vec::new(),
            feedback: false,
            disable_collisions: false,
        };
        if let Some(constraint) = world.add_constraint(parent, target, &constraint) {
            self.held = Held::Body(target, constraint);
        }
    }

    /// Ties the nodes of a soft body around `point` to the parent.
    fn hold_soft(&mut self, world: &mut World, bodies: &Bodies, soft: SoftBodyHandle, point: &nalgebra::Point3<f64>) {
        if let Held::Body(..) = self.held {
            self.release(world, bodies);
        }
        let parent = bodies[self.parent].handle;
        let features = world.soft_features(soft, &point.coords, REACH);
        match (features.face, features.node) {
            (Some(nodes), _) => nodes.into_iter().for_each(|node| self.anchor(world, soft, node, parent)),
            (None, Some(node)) => self.anchor(world, soft, node, parent),
            (None, None) => (),
        }
    }

    fn anchor(&mut self, world: &mut World, soft: SoftBodyHandle, node: usize, parent: BodyHandle) {
        let (Some(pose), Some(position)) = (world.pose(parent), world.soft_node(soft, node)) else { return };
        let pivot = pose.inverse_transform_point(&position.into()).coords;
        if world.add_anchor(soft, node, parent, &pivot, 1.0, false) {
            self.held = Held::SoftBody(soft);
        }
    }

    /// Releases what it holds.
    pub(crate) fn release(&mut self, world: &mut World, bodies: &Bodies) {
        match std::mem::replace(&mut self.held, Held::Nothing) {
            Held::Nothing => (),
            Held::Body(_, constraint) => {
                world.remove_constraint(constraint);
            }
            Held::SoftBody(soft) => {
                world.remove_anchors(soft, bodies[self.parent].handle);
            }
        }
    }

    /// Whether it holds this body.
    pub(super) fn holds(&self, body: BodyHandle) -> bool {
        matches!(self.held, Held::Body(held, _) if held == body)
    }
}
