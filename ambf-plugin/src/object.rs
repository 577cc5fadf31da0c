//! Any object of a scene, named by its type and its index.

macro_rules! object_types {
    ($($(#[$doc:meta])* $kind:ident = $number:literal, $words:literal;)*) => {
        /// Types of objects that a model is made of.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u32)]
        pub enum ObjectType {
            $($(#[$doc])* $kind = $number,)*
        }

        impl ObjectType {
            /// All types, in the order of their numbers.
            pub const ALL: [Self; [$($number),*].len()] = [$(Self::$kind),*];

            /// What a message calls it.
            pub fn words(self) -> &'static str {
                match self {
                    $(Self::$kind => $words,)*
                }
            }
        }
    };
}

// New ones at the end: numbers stay what they are.
object_types! {
    /// Rigid body.
    Body = 0, "rigid body";
    /// Soft body.
    SoftBody = 1, "soft body";
    /// Ghost object.
    Ghost = 2, "ghost object";
    /// Joint.
    Joint = 3, "joint";
    /// Sensor.
    Sensor = 4, "sensor";
    /// Actuator.
    Actuator = 5, "actuator";
    /// Vehicle.
    Vehicle = 6, "vehicle";
    /// Camera.
    Camera = 7, "camera";
    /// Light.
    Light = 8, "light";
    /// Volume: kept for a viewer, without anything that moves.
    Volume = 9, "volume";
}

impl ObjectType {
    /// The type with a number.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.get(number as usize).copied()
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
