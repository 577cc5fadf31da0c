//! Hashes of types as ROS 2 computes them: `RIHS01` of REP 2016.

use std::fmt::Write;

use sha2::{Digest, Sha256};

use crate::description::{Arity, Base, Description, Field, Primitive};
use crate::names::TypeName;

/// What a message without fields has in ROS 2.
const NO_FIELDS: &str = "structure_needs_at_least_one_member";

/// Numbers of `type_description_interfaces/msg/FieldType`.
const NESTED: u32 = 1;
const TEXT: u32 = 17;
const ARRAY: u32 = 48;
const SEQUENCE: u32 = 144;

impl Description {
    /// `RIHS01_` and the hash of the type description, 64 digits.
    pub fn type_hash(&self) -> String {
        let mut hash = String::from("RIHS01_");
        for byte in Sha256::digest(self.json().as_bytes()) {
            // Writing to a text cannot fail.
            let _ = write!(hash, "{byte:02x}");
        }
        hash
    }

    /// The description as rosidl writes it, `json.dumps` with default separators, without default values.
    fn json(&self) -> String {
        let others = self.types.iter().filter(|(name, _)| **name != self.name);
        let mut named: Vec<(String, &[Field])> =
            others.map(|(name, fields)| (name.to_string(), fields.as_slice())).collect();
        named.sort_by(|one, other| one.0.cmp(&other.0));
        let referenced: Vec<String> = named.iter().map(|(name, fields)| individual(name, fields)).collect();
        format!(
            "{{\"type_description\": {}, \"referenced_type_descriptions\": [{}]}}",
            individual(&self.name.to_string(), self.fields()),
            referenced.join(", ")
        )
    }
}

fn individual(name: &str, fields: &[Field]) -> String {
    let nothing = [Field { name: NO_FIELDS.into(), base: Base::Primitive(Primitive::U8), arity: Arity::One }];
    let fields = if fields.is_empty() { &nothing } else { fields };
    let fields: Vec<String> = fields.iter().map(field).collect();
    format!("{{\"type_name\": \"{name}\", \"fields\": [{}]}}", fields.join(", "))
}

fn field(field: &Field) -> String {
    let (element, nested) = match &field.base {
        Base::Primitive(primitive) => (number(*primitive), None),
        Base::Text => (TEXT, None),
        Base::Message(name) => (NESTED, Some(name)),
    };
    let (offset, capacity) = match field.arity {
        Arity::One => (0, 0),
        Arity::Array(count) => (ARRAY, count),
        Arity::Sequence => (SEQUENCE, 0),
    };
    format!(
        "{{\"name\": \"{}\", \"type\": {{\"type_id\": {}, \"capacity\": {capacity}, \"string_capacity\": 0, \
         \"nested_type_name\": \"{}\"}}}}",
        field.name,
        element + offset,
        nested.map(TypeName::to_string).unwrap_or_default()
    )
}

fn number(primitive: Primitive) -> u32 {
    match primitive {
        Primitive::I8 => 2,
        Primitive::U8 => 3,
        Primitive::I16 => 4,
        Primitive::U16 => 5,
        Primitive::I32 => 6,
        Primitive::U32 => 7,
        Primitive::I64 => 8,
        Primitive::U64 => 9,
        Primitive::F32 => 10,
        Primitive::F64 => 11,
        Primitive::Bool => 15,
        Primitive::Byte => 16,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hash(name: &str, definition: &str) -> String {
        Description::parse(TypeName::parse(name).unwrap(), definition).unwrap().type_hash()
    }

    /// Hashes that the packages of ROS 2 Jazzy have beside their messages.
    #[test]
    fn standard_messages_have_the_hashes_of_ros_2() {
        let time = "RIHS01_b106235e25a4c5ed35098aa0a61a3ee9c9b18d197f398b0e4206cea9acf9c197";
        assert_eq!(hash("builtin_interfaces/Time", "int32 sec\nuint32 nanosec"), time);
        let header = "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01";
        assert_eq!(hash("std_msgs/Header", "uint32 seq\ntime stamp\nstring frame_id"), header);
        let empty = "RIHS01_20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312";
        assert_eq!(hash("std_msgs/Empty", ""), empty);
    }
}
