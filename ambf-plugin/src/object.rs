//! Any object of a scene, named by its type and its index.

pub use ambf_model::adf::ObjectType;

/// An object: its type, and its index among all of that type. The index of an object that was removed with its model may
/// be that of another once a model is added; [`WorldPlugin::on_object_removal`](crate::WorldPlugin::on_object_removal)
/// says when to forget it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ObjectId {
    /// What it is.
    pub kind: ObjectType,
    /// Which one.
    pub index: usize,
}

impl ObjectId {
    /// Object `index` of a type.
    pub fn new(kind: ObjectType, index: usize) -> Self {
        Self { kind, index }
    }
}
