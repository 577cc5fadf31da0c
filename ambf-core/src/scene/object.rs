//! Which objects of a scene have plugins.

use super::build::Builder;
use super::{Identity, ObjectId, ObjectType, Scene};
use crate::adf::{self, PluginEntry, SourcePos};
use crate::ids::{BodyId, JointId, ModelId};

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
        let index = self.scene.next_index(kind);
        add(self);
        if !common.plugins.is_empty() && self.scene.next_index(kind) != index {
            self.scene.plugins.push(DeclaredPlugins {
                model: self.model,
                object: Some(ObjectId { kind, index }),
                entries: common.plugins.clone(),
                source: common.source.clone(),
            });
        }
    }

    /// Remembers the plugins of the model, after those of its objects.
    pub(super) fn declare_plugins(&mut self, model: &adf::Model) {
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
    /// How many objects of a type there are, removed ones included.
    pub fn object_count(&self, kind: ObjectType) -> usize {
        match kind {
            ObjectType::Joint => self.joints.len(),
            _ => self.list(kind).map_or(0, |list| list.count()),
        }
    }

    /// The index that the next object of a type will have.
    fn next_index(&self, kind: ObjectType) -> usize {
        match kind {
            ObjectType::Joint => self.joints.next_id().index(),
            _ => self.list(kind).map_or(0, |list| list.next_index()),
        }
    }

    /// Model of an object; `None` when there is no such object.
    pub fn model_of(&self, object: ObjectId) -> Option<ModelId> {
        match object.kind {
            ObjectType::Joint => self.joints.get(JointId::new(object.index)).map(|joint| joint.model),
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
            _ => self.stands_on(object).is_some_and(|body| self.bodies[body].removed),
        };
        self.model_of(object).is_some_and(|model| !self.models[model].removed && !is_gone())
    }

    /// The object of a type whose qualified identifier is `text`, else the only one whose identifier holds it, else the
    /// only one whose name is `text`.
    pub fn find_object(&self, kind: ObjectType, text: &str) -> Option<usize> {
        let (exact, part) = match kind {
            ObjectType::Joint => {
                (self.joint_names.exact(text).map(JointId::index), self.joint_names.id(text).map(JointId::index))
            }
            _ => self.list(kind).map_or((None, None), |list| list.find(text)),
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
            ObjectType::Joint => u8::MAX,
            _ => self.list(object.kind).map_or(0, |list| list.rank()),
        };
        (rank, self.names_of(object).unwrap_or_default().1)
    }

    /// Names of an object; `None` for a joint.
    fn identity_of(&self, object: ObjectId) -> Option<&Identity> {
        self.list(object.kind)?.identity(object.index)
    }

    /// The body with which an object leaves the scene.
    pub(super) fn stands_on(&self, object: ObjectId) -> Option<BodyId> {
        self.list(object.kind)?.stands_on(object.index)
    }
}
