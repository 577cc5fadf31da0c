//! Simulated end-effectors: models of which an input device moves one body, or a body that is there already.

use std::path::Path;

use nalgebra::{Isometry3, Vector3};

use super::targets::BodyTarget;
use super::{Actuator, Found, Identity, NameMap, Note, PreparedModel, Scene};
use crate::adf::{self, Severity};
use crate::bullet::Preset;
use crate::comm::{ActuatorInfo, SensorType};
use crate::control::{CartesianController, Profile};
use crate::ids::{ActuatorId, BodyId, CameraId, ModelId, SensorId};

/// A simulated end-effector that was read and is not part of a scene yet.
pub struct PreparedEndEffector {
    device: adf::InputDevice,
    /// Its own model and the key of the root link in it; `None`: the root link is a body of the scene.
    model: Option<(PreparedModel, String)>,
    notes: Vec<Note>,
    /// Problems in the text of its model.
    report: String,
}

/// A simulated end-effector of a [`Scene`].
#[derive(Debug, Clone, PartialEq)]
pub struct EndEffectorParts {
    /// Its own model, if it has one.
    pub model: Option<ModelId>,
    /// The body that follows the device.
    pub root: BodyId,
    /// The actuator with which it grips.
    pub actuator: ActuatorId,
    /// Controller of the root link.
    pub controller: adf::CartesianController,
    /// Pose of the root link's body frame that it starts from.
    pub initial_pose: Isometry3<f64>,
}

/// Appended to the namespace of a root link that came with its own model.
const NAMESPACE: &str = "/simulated_device/";

impl PreparedEndEffector {
    /// Reads the model of a device's end-effector, if it has one, and its meshes; takes as long as that takes, but no
    /// scene.
    ///
    /// # Errors
    /// Why the file is of no use, with all problems in it, or why it has no root link.
    pub fn read(device: &adf::InputDevice) -> Result<Self, String> {
        let mut notes = Vec::new();
        let model = match &device.simulated_multibody {
            Some(path) => Some(read_model(path, device, &mut notes)?),
            None => None,
        };
        let report = model.as_ref().map(|(model, _)| model.report.to_string()).unwrap_or_default();
        Ok(Self { device: device.clone(), model, notes, report })
    }
}

fn read_model(
    path: &Path,
    device: &adf::InputDevice,
    notes: &mut Vec<Note>,
) -> Result<(PreparedModel, String), String> {
    let mut prepared = PreparedModel::read(path)?;
    let mut model = prepared.description().clone();
    let root = find_root(&model, device, notes)?;
    let key = body_key(&model.bodies[root]);
    for body in &mut model.bodies {
        body.common.passive = true;
    }
    let body = &mut model.bodies[root];
    body.common.passive = false;
    if let Some(controller) = device.controller_gain {
        body.controller = Some(controller);
    }
    if let Some(location) = device.location {
        let shift = location * body.location.inverse();
        move_model(&mut model, &shift);
    }
    prepared.set_description(model);
    Ok((prepared, key))
}

fn body_key(body: &adf::RigidBody) -> String {
    format!("{}{}", body.common.namespace, body.common.identifier)
}

/// The root link of a device's own model: the body that `root link` names, else the one without parents.
fn find_root(model: &adf::Model, device: &adf::InputDevice, notes: &mut Vec<Note>) -> Result<usize, String> {
    let mut names = NameMap::default();
    model.bodies.iter().enumerate().for_each(|(index, body)| names.insert(&body_key(body), index));
    let find = |namespace: &str, text: &str| {
        let exact = names.exact(text).or_else(|| names.exact(&format!("{namespace}{text}")));
        exact.map_or_else(|| names.find(text), Found::Exact)
    };
    if let Some(text) = &device.root_link {
        let found = find(&model.namespace, text);
        return found.id().ok_or_else(|| format!("`root link: {text}` is {found} in {}", model.file.display()));
    }
    let mut has_parent = vec![false; model.bodies.len()];
    for joint in &model.joints {
        if let Some(child) = find(&joint.common.namespace, &joint.child).id() {
            has_parent[child] = true;
        }
    }
    // In the order of the C++ program's map, of which the last counts.
    let roots: Vec<_> = names.iter().filter(|(_, index)| !has_parent[*index]).collect();
    let &(key, root) = roots
        .last()
        .ok_or_else(|| format!("{} has no body without a parent; name a `root link`", model.file.display()))?;
    if roots.len() > 1 {
        let others: Vec<_> = roots[..roots.len() - 1].iter().map(|(key, _)| *key).collect();
        let message = format!(
            "`{}`: its model has several bodies without a parent; `{key}` is its root link, not `{}`: name the `root link`",
            device.identifier,
            others.join("`, `")
        );
        notes.push(Note { severity: Severity::Warning, source: device.source.clone(), message, wanted: None });
    }
    Ok(root)
}

/// Moves everything of a model that is placed in the world.
fn move_model(model: &mut adf::Model, shift: &Isometry3<f64>) {
    let turn = |v: &Vector3<f64>| (shift * nalgebra::Point3::from(*v)).coords;
    model.bodies.iter_mut().for_each(|body| body.location = shift * body.location);
    model.soft_bodies.iter_mut().for_each(|soft| soft.location = shift * soft.location);
    for ghost in model.ghosts.iter_mut().filter(|ghost| ghost.parent.is_empty()) {
        ghost.location = shift * ghost.location;
    }
    for light in model.lights.iter_mut().filter(|light| light.parent.is_empty()) {
        light.location = shift * light.location;
        light.direction = light.direction.map(|direction| shift.rotation * direction);
    }
    for camera in model.cameras.iter_mut().filter(|camera| camera.parent.is_empty()) {
        (camera.location, camera.look_at) = (turn(&camera.location), turn(&camera.look_at));
        camera.up = shift.rotation * camera.up;
    }
    for volume in model.volumes.iter_mut().filter(|volume| volume.parent.is_empty()) {
        volume.location = shift * volume.location;
    }
}

impl Scene {
    /// Builds an end-effector into the scene, or finds it there. Says what was dropped, replaced or guessed.
    ///
    /// # Errors
    /// Why there is none; the scene is as it was.
    pub(crate) fn add_end_effector(
        &mut self,
        prepared: PreparedEndEffector,
    ) -> Result<(EndEffectorParts, Vec<String>), String> {
        let PreparedEndEffector { device, model, mut notes, report } = prepared;
        let (model, root) = match model {
            Some((prepared, key)) => {
                let (model, remarks) = self.add_model(prepared);
                let key = format!("{}{key}", self.options.prefix);
                let is_root = |body: &super::Body| body.identity.model == model && body.identity.key() == key;
                let Some(root) = self.bodies.position(is_root) else {
                    self.remove_model(model);
                    let why: Vec<_> = remarks.iter().map(|note| note.message.as_str()).collect();
                    return Err(format!("its root link `{key}` could not be made: {}", why.join("; ")));
                };
                notes.extend(remarks);
                self.bodies[root].identity.namespace += NAMESPACE;
                (Some(model), root)
            }
            None => (None, self.bind_body(&device)?),
        };
        if !self.bodies[root].is_dynamic() {
            let message = format!("`{}`: its root link has no mass, so that nothing moves it", device.identifier);
            notes.push(Note { severity: Severity::Warning, source: device.source.clone(), message, wanted: None });
        }
        let body = &self.bodies[root];
        let parts = EndEffectorParts {
            model,
            root,
            controller: body.controller.settings(),
            initial_pose: body.initial_pose * body.inertial_offset_inverse,
            actuator: self.add_gripping_actuator(&device, root),
        };
        let said = report.lines().map(str::to_owned).chain(notes.iter().map(ToString::to_string));
        Ok((parts, said.collect()))
    }

    /// A body that is there already becomes a root link.
    fn bind_body(&mut self, device: &adf::InputDevice) -> Result<BodyId, String> {
        let text = device.root_link.as_deref().ok_or("it has neither `simulated multibody` nor `root link`")?;
        let with_prefix = format!("{}{text}", self.options.prefix);
        let found = self.bodies.names.exact(&with_prefix).map_or_else(|| self.bodies.names.find(text), Found::Exact);
        let root = found.id().ok_or_else(|| format!("`root link: {text}` is {found} among the bodies"))?;
        if let Some(adf::CartesianController { linear, angular }) = device.controller_gain {
            let body = &mut self.bodies[root];
            body.controller = CartesianController::new(linear, angular);
            body.target = BodyTarget::new(&linear, &angular);
        }
        if let Some(location) = device.location {
            self.move_subtree(root, &location);
        }
        Ok(root)
    }

    /// Moves a body and all below it so that its body frame is at `location`; resets return there.
    fn move_subtree(&mut self, root: BodyId, location: &Isometry3<f64>) {
        let Self { world, bodies, graph, .. } = self;
        let shift = location * bodies[root].pose(world).inverse();
        let below = graph.descendants(root).iter().map(|below| below.body);
        for id in std::iter::once(root).chain(below) {
            let body = &mut bodies[id];
            let Some(pose) = world.pose(body.handle).filter(|_| body.is_dynamic()) else { continue };
            body.initial_pose = shift * pose;
            world.reset_body(body.handle, &body.initial_pose, body.gravity.as_ref());
        }
        world.refresh_constraints();
    }

    /// The actuator that holds what is gripped: unseen, without State and Command.
    fn add_gripping_actuator(&mut self, device: &adf::InputDevice, root: BodyId) -> ActuatorId {
        let body = &self.bodies[root];
        let name = format!("{}_constraint_actuator", device.identifier.replace(' ', ""));
        let mut identity = Identity {
            name: name.as_str().into(),
            suffix: String::new(),
            namespace: body.identity.namespace.clone(),
            identifier: name,
            passive: true,
            ..body.identity.clone()
        };
        let key = identity.key();
        identity.suffix = self.actuators.names.free_suffix(&key);
        identity.qualified = format!("{key}{}", identity.suffix).into();
        let frame = match (self.profile, self.preset) {
            (Profile::Legacy, None | Some(Preset::PyBullet)) => Isometry3::identity(),
            (Profile::Accurate, _) => body.inertial_offset_inverse,
        };
        let info = ActuatorInfo { parent_name: body.identity.identifier.clone(), pose: Isometry3::identity() };
        self.changes += 1;
        let id = self.actuators.push(Actuator::new(identity, info, root, frame));
        self.actuators.names.insert(&key, id);
        id
    }

    /// The proximity sensors on a body.
    pub(crate) fn proximity_sensors(&self, body: BodyId) -> impl Iterator<Item = SensorId> + '_ {
        let live =
            |sensor: &super::Sensor| !self.models[sensor.identity.model].removed && !self.body_is_gone(sensor.parent);
        let sensors = self.sensors.entries();
        sensors
            .filter(move |(_, s)| s.parent == body && s.info.kind == SensorType::Proximity && live(s))
            .map(|(id, _)| id)
    }

    /// The cameras that a device is paired with: those that are named, else all. Says which are not found.
    pub(crate) fn paired_cameras(&self, names: &[String]) -> (Vec<CameraId>, Vec<String>) {
        let live = |id: &CameraId| !self.models[self.cameras[*id].attached.identity.model].removed;
        let (mut paired, mut missing) = (Vec::new(), Vec::new());
        for name in names {
            let named = |id: &CameraId| *self.cameras[*id].attached.identity.name == **name;
            let found = self.cameras.names.find(name);
            match found.id().or_else(|| self.cameras.ids().filter(live).find(named)) {
                Some(id) => paired.push(id),
                None => missing.push(format!("camera `{name}` is {found}")),
            }
        }
        if paired.is_empty() {
            paired.extend(self.cameras.ids().filter(live));
        }
        (paired, missing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODEL: &str = "bodies: [BODY a, BODY b, BODY c]\njoints: [J]\nnamespace: /n/\n\
        BODY a: {name: a, mass: 1}\nBODY b: {name: b, mass: 1}\nBODY c: {name: c, mass: 1}\n\
        J: {name: J, type: fixed, parent: BODY b, child: BODY a, parent pivot: {x: 0, y: 0, z: 0}, \
        child pivot: {x: 0, y: 0, z: 0}, parent axis: {x: 0, y: 0, z: 1}, child axis: {x: 0, y: 0, z: 1}}\n";

    fn root(device: &str, model: &str) -> (Result<String, String>, usize) {
        let text = format!("input devices: [A]\nA: {{hardware name: x, simulated multibody: m.yaml{device}}}\n");
        let (devices, _) = adf::parse::<adf::InputDevices>(&text, Path::new("d.yaml")).expect("a list");
        let (model, _) = adf::parse::<adf::Model>(model, Path::new("m.yaml")).expect("a model");
        let mut notes = Vec::new();
        let root = find_root(&model, devices.entries[0].as_ref().expect("an entry"), &mut notes);
        (root.map(|index| model.bodies[index].common.name.clone()), notes.len())
    }

    #[test]
    fn a_named_root_link_is_found_with_and_without_its_namespace() {
        assert_eq!(root(", root link: BODY a", MODEL), (Ok("a".into()), 0));
        assert_eq!(root(", root link: /n/BODY b", MODEL), (Ok("b".into()), 0));
        let (missing, _) = root(", root link: BODY z", MODEL);
        assert!(missing.is_err_and(|why| why.contains("`root link: BODY z` is not found")));
    }

    #[test]
    fn without_a_name_it_is_the_body_without_parents() {
        assert_eq!(root("", MODEL), (Ok("c".into()), 1), "b and c have none: the last, with a warning");
        assert_eq!(root("", &MODEL.replace(", BODY c]", "]")), (Ok("b".into()), 0));
    }

    #[test]
    fn models_move_as_a_whole() {
        let text = MODEL.replace("BODY c: {", "BODY c: {location: {position: {x: 1, y: 0, z: 0}}, ");
        let (mut model, _) = adf::parse::<adf::Model>(&text, Path::new("m.yaml")).expect("a model");
        let shift = Isometry3::new(Vector3::z(), Vector3::z() * std::f64::consts::FRAC_PI_2);
        move_model(&mut model, &shift);
        let moved = model.bodies[2].location.translation.vector;
        assert!((moved - Vector3::new(0.0, 1.0, 1.0)).norm() < 1e-12, "{moved}");
    }
}
