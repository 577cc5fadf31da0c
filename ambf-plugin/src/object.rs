//! Any object of a scene, named by its type and its index.

/// Types of objects that a model is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u32)]
pub enum ObjectType {
    /// Rigid body.
    Body = 0,
    /// Soft body.
    SoftBody = 1,
    /// Ghost object.
    Ghost = 2,
    /// Joint.
    Joint = 3,
    /// Sensor.
    Sensor = 4,
    /// Actuator.
    Actuator = 5,
    /// Vehicle.
    Vehicle = 6,
    /// Camera.
    Camera = 7,
    /// Light.
    Light = 8,
    /// Volume: kept for a viewer, without anything that moves.
    Volume = 9,
}

impl ObjectType {
    /// All types, in the order of their numbers.
    pub const ALL: [Self; 10] = [
        Self::Body,
        Self::SoftBody,
        Self::Ghost,
        Self::Joint,
        Self::Sensor,
        Self::Actuator,
        Self::Vehicle,
        Self::Camera,
        Self::Light,
        Self::Volume,
    ];

    /// The type with a number.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.get(number as usize).copied()
    }

    /// What a message calls it.
    pub fn words(self) -> &'static str {
        match self {
            Self::Body => "rigid body",
            Self::SoftBody => "soft body",
            Self::Ghost => "ghost object",
            Self::Joint => "joint",
            Self::Sensor => "sensor",
            Self::Actuator => "actuator",
            Self::Vehicle => "vehicle",
            Self::Camera => "camera",
            Self::Light => "light",
            Self::Volume => "volume",
        }
    }
}

/// An object: its type, and its index among all of that type in order of creation. Indices are never used again.
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
