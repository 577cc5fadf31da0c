//! Which objects of a scene have plugins.

use super::build::Builder;
use super::{Identity, NameMap, ObjectId, ObjectType, Scene};
use crate::adf::{self, PluginEntry, SourcePos};
use crate::ids::{
    ActuatorId, BodyId, CameraId, GhostId, Id, JointId, LightId, ModelId, SensorId, SoftBodyId, VehicleId,
};

/// The plugins that a description asks for at one place.
#[derive(Debug, Clone, PartialEq)]
pub struct DeclaredPlugins {
    /// The model.
    pub model: ModelId,
    /// The object that has them; `None`: the model itself.
    pub object: Option<ObjectId>,
    /// In file order.
    pub entries: Vec<PluginEntry>,
    /// Where the object's key stands; of a model the file, without a line.
    pub source: SourcePos,
}

impl Builder<'_> {
    /// Makes an object with `add`, and remembers its plugins if it was not dropped.
    pub(super) fn with_plugins(&mut self, kind: ObjectType, common: &adf::Common, add: impl FnOnce(&mut Self)) {
        let index = self.scene.object_count(kind);
        add(self);
        if !common.plugins.is_empty() && self.scene.object_count(kind) > index {
            self.scene.plugins.push(DeclaredPlugins {
                model: self.model,
                object: Some(ObjectId { kind, index }),
                entries: common.plugins.clone(),
                source: common.source.clone(),
            });
        }
    }

    /// Remembers the plugins of the model and its volumes, after those of its other objects.
    pub(super) fn declare_plugins(&mut self, model: &adf::Model) {
        let first = self.scene.object_count(ObjectType::Volume) - model.volumes.len();
        for (i, volume) in model.volumes.iter().enumerate().filter(|(_, volume)| !volume.common.plugins.is_empty()) {
            self.scene.plugins.push(DeclaredPlugins {
                model: self.model,
                object: Some(ObjectId { kind: ObjectType::Volume, index: first + i }),
                entries: volume.common.plugins.clone(),
                source: volume.common.source.clone(),
            });
        }
        if !model.plugins.is_empty() {
            self.scene.plugins.push(DeclaredPlugins {
                model: self.model,
                object: None,
                entries: model.plugins.clone(),
                source: SourcePos { file: model.file.clone(), line: 0, column: 0 },
            });
        }
    }
}

impl Scene {
    /// How many objects of a type there ever were.
    pub fn object_count(&self, kind: ObjectType) -> usize {
        match kind {
            ObjectType::Body => self.bodies.len(),
            ObjectType::SoftBody => self.soft_bodies.len(),
            ObjectType::Ghost => self.ghosts.len(),
            ObjectType::Joint => self.joints.len(),
            ObjectType::Sensor => self.sensors.len(),
            ObjectType::Actuator => self.actuators.len(),
            ObjectType::Vehicle => self.vehicles.len(),
            ObjectType::Camera => self.cameras.len(),
            ObjectType::Light => self.lights.len(),
            ObjectType::Volume => self.models.iter().map(|model| model.description.volumes.len()).sum(),
        }
    }

    /// Model of an object; `None` when there is no such object.
    pub fn model_of(&self, object: ObjectId) -> Option<ModelId> {
        match object.kind {
            ObjectType::Joint => self.joints.get(JointId::new(object.index)).map(|joint| joint.model),
            ObjectType::Volume => self.volume(object.index).map(|(model, _)| model),
            _ => self.identity_of(object).map(|identity| identity.model),
        }
    }

    /// Name (without namespace, with the suffix that tells copies apart) and qualified identifier of an object; `None`
    /// when there is no such object.
    pub fn names_of(&self, object: ObjectId) -> Option<(String, String)> {
        match object.kind {
            ObjectType::Joint => {
                self.joints.get(JointId::new(object.index)).map(|joint| (joint.name.clone(), joint.key.clone()))
            }
            ObjectType::Volume => self.volume(object.index).map(|(_, volume)| {
                let common = &volume.common;
                (common.name.clone(), format!("{}{}{}", self.options.prefix, common.namespace, common.identifier))
            }),
            _ => self.identity_of(object).map(|identity| {
                let key = format!("{}{}", identity.key(), identity.suffix);
                (identity.communication_name(), key)
            }),
        }
    }

    /// Whether an object is in the scene: it was made, and neither it nor its model was taken out.
    pub fn has_object(&self, object: ObjectId) -> bool {
        let is_gone = || match object.kind {
            ObjectType::Joint => self.joints[JointId::new(object.index)].removed,
            ObjectType::Body => self.bodies[BodyId::new(object.index)].removed,
            ObjectType::Sensor => self.bodies[self.sensors[SensorId::new(object.index)].parent].removed,
            ObjectType::Actuator => self.bodies[self.actuators[ActuatorId::new(object.index)].parent].removed,
            ObjectType::Vehicle => self.bodies[self.vehicles[VehicleId::new(object.index)].chassis].removed,
            _ => false,
        };
        self.model_of(object).is_some_and(|model| !self.models[model].removed && !is_gone())
    }

    /// The object of a type whose qualified identifier is `text`, else the only one whose identifier holds it, else the
    /// only one whose name is `text`.
    pub fn find_object(&self, kind: ObjectType, text: &str) -> Option<usize> {
        let (exact, part) = match kind {
            ObjectType::Body => indices(&self.body_names, text),
            ObjectType::SoftBody => indices(&self.names.soft_bodies, text),
            ObjectType::Ghost => indices(&self.names.ghosts, text),
            ObjectType::Joint => indices(&self.names.joints, text),
            ObjectType::Sensor => indices(&self.names.sensors, text),
            ObjectType::Actuator => indices(&self.names.actuators, text),
            ObjectType::Vehicle => indices(&self.names.vehicles, text),
            ObjectType::Camera => indices(&self.names.cameras, text),
            ObjectType::Light => indices(&self.names.lights, text),
            ObjectType::Volume => (None, None),
        };
        if exact.is_some() {
            return exact;
        }
        let mut named = (0..self.object_count(kind)).filter(|&index| {
            let object = ObjectId { kind, index };
            self.has_object(object) && self.names_of(object).is_some_and(|(name, _)| name == text)
        });
        match (named.next(), named.next()) {
            (Some(index), None) => Some(index),
            (Some(_), Some(_)) => None,
            (None, _) => part,
        }
    }

    /// The objects of a model in the order in which plugins are called: by type, then by qualified identifier.
    pub(crate) fn objects_of_model(&self, model: ModelId) -> Vec<ObjectId> {
        let all = ObjectType::ALL.into_iter().flat_map(|kind| {
            let objects = (0..self.object_count(kind)).map(move |index| ObjectId { kind, index });
            objects.filter(|&object| self.model_of(object) == Some(model) && self.has_object(object))
        });
        let mut objects: Vec<ObjectId> = all.collect();
        objects.sort_by_cached_key(|&object| self.calling_key(object));
        objects
    }

    /// What sorts the objects of a model into the order in which their plugins are called.
    pub(crate) fn calling_key(&self, object: ObjectId) -> (u8, String) {
        let rank = match object.kind {
            ObjectType::Actuator => 0,
            ObjectType::Camera => 1,
            ObjectType::Light => 2,
            ObjectType::Body => 3,
            ObjectType::SoftBody => 4,
            ObjectType::Ghost => 5,
            ObjectType::Sensor => 6,
            ObjectType::Vehicle => 7,
            ObjectType::Volume => 8,
            ObjectType::Joint => 9,
        };
        (rank, self.names_of(object).unwrap_or_default().1)
    }

    fn identity_of(&self, object: ObjectId) -> Option<&Identity> {
        let index = object.index;
        match object.kind {
            ObjectType::Body => self.bodies.get(BodyId::new(index)).map(|body| &body.identity),
            ObjectType::SoftBody => self.soft_bodies.get(SoftBodyId::new(index)).map(|soft| &soft.identity),
            ObjectType::Ghost => self.ghosts.get(GhostId::new(index)).map(|ghost| &ghost.attached.identity),
            ObjectType::Sensor => self.sensors.get(SensorId::new(index)).map(|sensor| &sensor.identity),
            ObjectType::Actuator => self.actuators.get(ActuatorId::new(index)).map(|actuator| &actuator.identity),
            ObjectType::Vehicle => self.vehicles.get(VehicleId::new(index)).map(|vehicle| &vehicle.identity),
            ObjectType::Camera => self.cameras.get(CameraId::new(index)).map(|camera| &camera.attached.identity),
            ObjectType::Light => self.lights.get(LightId::new(index)).map(|light| &light.attached.identity),
            ObjectType::Joint | ObjectType::Volume => None,
        }
    }

    /// Model and description of a volume.
    fn volume(&self, mut index: usize) -> Option<(ModelId, &adf::Volume)> {
        for (model, info) in self.models.entries() {
            match info.description.volumes.get(index) {
                Some(volume) => return Some((model, volume)),
                None => index -= info.description.volumes.len(),
            }
        }
        None
    }
}

fn indices<I: Id>(names: &NameMap<I>, text: &str) -> (Option<usize>, Option<usize>) {
    (names.exact(text).map(I::to_index), names.id(text).map(I::to_index))
}
