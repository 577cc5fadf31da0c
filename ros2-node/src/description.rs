//! Descriptions of message types, from the definitions of ROS 1.

use std::collections::BTreeMap;

use crate::names::{NameError, TypeName};

/// Deepest nesting of messages in messages.
const DEEPEST: usize = 32;

/// A type that has no parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Primitive {
    /// True or false, one byte.
    Bool,
    /// One byte without a meaning: `byte`, in ROS 1 an alias of `int8`.
    Byte,
    /// Signed, 8 bits.
    I8,
    /// Unsigned, 8 bits; also `char`.
    U8,
    /// Signed, 16 bits.
    I16,
    /// Unsigned, 16 bits.
    U16,
    /// Signed, 32 bits.
    I32,
    /// Unsigned, 32 bits.
    U32,
    /// Signed, 64 bits.
    I64,
    /// Unsigned, 64 bits.
    U64,
    /// Floating point, 32 bits.
    F32,
    /// Floating point, 64 bits.
    F64,
}

impl Primitive {
    /// Bytes on the wire; also its alignment in CDR.
    pub fn size(self) -> usize {
        match self {
            Self::Bool | Self::Byte | Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    fn of(name: &str) -> Option<Self> {
        Some(match name {
            "bool" => Self::Bool,
            "byte" => Self::Byte,
            "int8" => Self::I8,
            "uint8" | "char" => Self::U8,
            "int16" => Self::I16,
            "uint16" => Self::U16,
            "int32" => Self::I32,
            "uint32" => Self::U32,
            "int64" => Self::I64,
            "uint64" => Self::U64,
            "float32" => Self::F32,
            "float64" => Self::F64,
            _ => return None,
        })
    }
}

/// What an element of a field is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Base {
    /// A number or truth value.
    Primitive(Primitive),
    /// A text.
    Text,
    /// Another message.
    Message(TypeName),
}

/// How many elements a field has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arity {
    /// One.
    One,
    /// Always so many.
    Array(u32),
    /// Any number.
    Sequence,
}

/// A field of a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Field {
    /// Its name in ROS 2: lower case, with `_` between words.
    pub name: String,
    /// What its elements are.
    pub base: Base,
    /// How many there are.
    pub arity: Arity,
}

/// A message type with those it is made of, as they are in ROS 2.
///
/// `std_msgs/Header` has no `seq`; `time` and `duration` are messages of `builtin_interfaces`; names of fields are
/// those that rosidl accepts (`pInertia` is `p_inertia`).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Description {
    /// The type.
    pub name: TypeName,
    /// The fields of the type and of all that it refers to.
    pub types: BTreeMap<TypeName, Vec<Field>>,
}

/// Why a definition cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DescriptionError {
    /// Error when a line is no field, constant or comment.
    #[error("{type_name}: the line \"{line}\" is neither a field, a constant nor a comment")]
    Line {
        /// Where it stands.
        type_name: String,
        /// The line.
        line: String,
    },
    /// Error when a type is used that is not defined.
    #[error("{by} uses {name}, which is not defined")]
    Undefined {
        /// The type that is not defined.
        name: String,
        /// Where it is used.
        by: String,
    },
    /// Error when a type contains itself, or others more than 32 deep.
    #[error("{0} contains itself, or other messages more than {DEEPEST} deep")]
    Deep(String),
    /// Error when a type has a name that is none.
    #[error(transparent)]
    Name(#[from] NameError),
}

/// The type of a header, which has one more field in ROS 1.
pub(crate) fn is_header(name: &TypeName) -> bool {
    name.package == "std_msgs" && name.name == "Header"
}

impl Description {
    /// Reads `text`, the definition of `name` with those of all types that it uses, as ROS 1 sends it with a message:
    /// sections that are separated by a line of `=` and a line `MSG: package/Type`.
    ///
    /// # Errors
    /// What is wrong, and where.
    pub fn parse(name: TypeName, text: &str) -> Result<Self, DescriptionError> {
        let mut types = builtin_types();
        for (number, section) in sections(text).into_iter().enumerate() {
            let (section_name, body) = match section.trim_start().strip_prefix("MSG:") {
                Some(rest) if number > 0 => {
                    let (title, body) = rest.split_once('\n').unwrap_or((rest, ""));
                    (TypeName::parse(title.trim())?, body)
                }
                _ => (name.clone(), section),
            };
            types.insert(section_name.clone(), fields(&section_name, body)?);
        }
        let mut used = BTreeMap::new();
        collect(&name, &name, &types, &mut used, 0)?;
        Ok(Self { name, types: used })
    }

    /// The fields of the type.
    pub fn fields(&self) -> &[Field] {
        self.types.get(&self.name).map_or(&[], Vec::as_slice)
    }
}

fn builtin_types() -> BTreeMap<TypeName, Vec<Field>> {
    let field =
        |name: &str, primitive| Field { name: name.into(), base: Base::Primitive(primitive), arity: Arity::One };
    let fields = || vec![field("sec", Primitive::I32), field("nanosec", Primitive::U32)];
    ["Time", "Duration"].into_iter().map(|name| (TypeName::message("builtin_interfaces", name), fields())).collect()
}

/// The parts of a definition between lines of `=`.
fn sections(text: &str) -> Vec<&str> {
    let is_separator = |line: &str| line.len() >= 20 && line.trim_end().bytes().all(|c| c == b'=');
    let (mut sections, mut from, mut at) = (Vec::new(), 0, 0);
    for line in text.split_inclusive('\n') {
        if is_separator(line.trim_end()) {
            sections.push(&text[from..at]);
            from = at + line.len();
        }
        at += line.len();
    }
    sections.push(&text[from..]);
    sections
}

fn fields(of: &TypeName, text: &str) -> Result<Vec<Field>, DescriptionError> {
    let mut fields = Vec::new();
    for line in text.lines() {
        let statement = line.split('#').next().unwrap_or_default().trim();
        // A constant: not part of a message. One of texts may have `#` in its value.
        if statement.is_empty() || statement.contains('=') {
            continue;
        }
        let error = || DescriptionError::Line { type_name: of.to_string(), line: line.to_owned() };
        let mut words = statement.split_whitespace();
        let (Some(kind), Some(name), None) = (words.next(), words.next(), words.next()) else { return Err(error()) };
        // In ROS 2 the time says what the number said.
        if is_header(of) && name == "seq" {
            continue;
        }
        let (kind, arity) = arity(kind).ok_or_else(error)?;
        fields.push(Field { name: snake_case(name), base: base(of, kind)?, arity });
    }
    Ok(fields)
}

fn arity(kind: &str) -> Option<(&str, Arity)> {
    let Some((kind, count)) = kind.split_once('[') else { return Some((kind, Arity::One)) };
    let count = count.strip_suffix(']')?;
    if count.is_empty() {
        return Some((kind, Arity::Sequence));
    }
    Some((kind, Arity::Array(count.parse().ok().filter(|&count| count > 0)?)))
}

fn base(of: &TypeName, kind: &str) -> Result<Base, NameError> {
    if let Some(primitive) = Primitive::of(kind) {
        return Ok(Base::Primitive(primitive));
    }
    Ok(match kind {
        "string" => Base::Text,
        "time" => Base::Message(TypeName::message("builtin_interfaces", "Time")),
        "duration" => Base::Message(TypeName::message("builtin_interfaces", "Duration")),
        "Header" => Base::Message(TypeName::message("std_msgs", "Header")),
        _ if kind.contains('/') => Base::Message(TypeName::parse(kind)?),
        _ => Base::Message(TypeName::parse(&format!("{}/{kind}", of.package))?),
    })
}

/// `pInertia` becomes `p_inertia`.
fn snake_case(name: &str) -> String {
    let mut snake = String::with_capacity(name.len() + 2);
    let mut after_lower = false;
    for c in name.chars() {
        if c.is_ascii_uppercase() && after_lower {
            snake.push('_');
        }
        after_lower = c.is_ascii_lowercase() || c.is_ascii_digit();
        snake.push(c.to_ascii_lowercase());
    }
    snake
}

fn collect(
    name: &TypeName,
    by: &TypeName,
    known: &BTreeMap<TypeName, Vec<Field>>,
    used: &mut BTreeMap<TypeName, Vec<Field>>,
    depth: usize,
) -> Result<(), DescriptionError> {
    if depth > DEEPEST {
        return Err(DescriptionError::Deep(by.to_string()));
    }
    let undefined = || DescriptionError::Undefined { name: name.to_string(), by: by.to_string() };
    let fields = known.get(name).ok_or_else(undefined)?;
    for field in fields {
        if let Base::Message(part) = &field.base {
            collect(part, name, known, used, depth + 1)?;
        }
    }
    used.insert(name.clone(), fields.clone());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const STATE: &str = "# A state.
Header header
uint8 KIND=1
string WORD=a # b
time stamp # when
geometry_msgs/Point pInertia
float64[9] D
string[] names
Own[] parts
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: pkg/Own
char c
byte b
================================================================================
MSG: pkg/Unused
bool x
";

    fn parse(text: &str) -> Result<Description, DescriptionError> {
        Description::parse(TypeName::message("pkg", "State"), text)
    }

    #[test]
    fn a_definition_is_read_as_that_of_ros_2() {
        let state = parse(STATE).unwrap();
        let names: Vec<&str> = state.fields().iter().map(|field| field.name.as_str()).collect();
        assert_eq!(names, ["header", "stamp", "p_inertia", "d", "names", "parts"]);
        assert_eq!(state.fields()[3].arity, Arity::Array(9));
        assert_eq!(state.fields()[4].arity, Arity::Sequence);
        let header = &state.types[&TypeName::message("std_msgs", "Header")];
        assert_eq!(header.iter().map(|field| field.name.as_str()).collect::<Vec<_>>(), ["stamp", "frame_id"]);
        let own = &state.types[&TypeName::message("pkg", "Own")];
        assert_eq!(own[0].base, Base::Primitive(Primitive::U8));
        assert_eq!(own[1].base, Base::Primitive(Primitive::Byte));
        assert!(!state.types.contains_key(&TypeName::message("pkg", "Unused")));
        assert!(state.types.contains_key(&TypeName::message("builtin_interfaces", "Time")));
    }

    #[test]
    fn what_is_no_definition_is_named() {
        assert!(matches!(parse("float64"), Err(DescriptionError::Line { .. })));
        assert!(matches!(parse("float64[x] a"), Err(DescriptionError::Line { .. })));
        assert!(matches!(parse("float64[0] a"), Err(DescriptionError::Line { .. })));
        assert!(matches!(parse("Other a"), Err(DescriptionError::Undefined { .. })));
        assert!(matches!(parse("a/b/c/d a"), Err(DescriptionError::Name(_))));
        assert!(matches!(parse("State a"), Err(DescriptionError::Deep(_))));
        assert_eq!(parse("").unwrap().fields(), []);
    }
}
