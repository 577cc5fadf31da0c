//! Any object of a scene, named by its type and its index.

pub use ambf_model::adf::ObjectType;

/// An object: its type, and its index among all of that type in order of creation. An index never names another object:
/// only the same object of the same model gets it again, when that model was removed and is added again.
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
