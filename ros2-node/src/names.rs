//! Names of topics, nodes and types: what ROS 2 allows, and what they are called in DDS.

use std::collections::HashSet;
use std::fmt;

/// Longest topic name that ROS 2 allows, characters.
pub const MAX_TOPIC: usize = 247;

/// Longest node name that ROS 2 allows, characters.
pub const MAX_NODE: usize = 255;

/// A topic name that ROS 2 allows, made from `name`, at most `longest` characters.
///
/// Between slashes only letters, digits and `_` of ASCII are allowed, and no digit at the beginning. Other characters
/// become `_`, a digit at the beginning gets `_` before it, empty parts vanish. A name that is too long ends with a
/// hash of what it was, so that two of them stay different. The result begins with `/`.
pub fn clean_topic(name: &str, longest: usize) -> String {
    let mut clean = String::with_capacity(name.len() + 1);
    for part in name.split('/').filter(|part| !part.is_empty()) {
        clean.push('/');
        push_clean(&mut clean, part);
    }
    if clean.is_empty() {
        clean.push_str("/_");
    }
    shortened(clean, name, longest)
}

/// A node name that ROS 2 allows, made from the name of a topic or object: what separates parts becomes `_`.
pub fn clean_node(name: &str) -> String {
    let joined = name.split('/').filter(|part| !part.is_empty()).collect::<Vec<_>>().join("_");
    let mut clean = String::with_capacity(joined.len() + 1);
    push_clean(&mut clean, if joined.is_empty() { "_" } else { &joined });
    shortened(clean, name, MAX_NODE)
}

fn push_clean(clean: &mut String, part: &str) {
    if part.starts_with(|first: char| first.is_ascii_digit()) {
        clean.push('_');
    }
    clean.extend(part.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }));
}

fn shortened(mut clean: String, original: &str, longest: usize) -> String {
    if clean.len() > longest {
        clean.truncate(longest.saturating_sub(9));
        clean.push_str(&format!("_{:08x}", fnv1a(original.as_bytes())));
    }
    clean
}

/// The hash FNV-1a of 32 bits (draft-eastlake-fnv): the same in every run.
fn fnv1a(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0x811c_9dc5, |hash, &byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193))
}

/// Names in use; one that comes again gets `_2`, `_3`, … appended.
#[derive(Debug, Default)]
pub struct NameSet(HashSet<String>);

impl NameSet {
    /// `name`, or where that is in use, `name` with the first free number appended; in use from now on.
    pub fn claim(&mut self, name: String) -> String {
        if self.0.insert(name.clone()) {
            return name;
        }
        let mut number = 2u64;
        loop {
            let numbered = format!("{name}_{number}");
            if self.0.insert(numbered.clone()) {
                return numbered;
            }
            number += 1;
        }
    }

    /// Makes `name` free again.
    pub fn release(&mut self, name: &str) {
        self.0.remove(name);
    }
}

/// Why a name is none.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NameError {
    /// Error when a name has no characters or an empty part.
    #[error("the name \"{0}\" is empty or has an empty part")]
    Empty(String),
    /// Error when a name is too long.
    #[error("the name \"{name}\" has {} characters, more than {longest}", name.len())]
    Long {
        /// The name.
        name: String,
        /// Characters that are allowed.
        longest: usize,
    },
    /// Error when a part has characters other than letters, digits and `_`, or begins with a digit.
    #[error(
        "the name \"{0}\" has a part with characters other than letters, digits and _, or one that begins with a digit"
    )]
    Characters(String),
    /// Error when the name of a topic or namespace does not begin with `/`.
    #[error("the name \"{0}\" does not begin with /")]
    Relative(String),
    /// Error when a type is not written `package/msg/Type` or `package/srv/Type`.
    #[error("\"{0}\" is not a type: package/msg/Type or package/srv/Type was expected")]
    Type(String),
}

/// Checks the name of a topic or service, with its namespace.
///
/// # Errors
/// What is wrong with it.
pub fn check_topic(name: &str) -> Result<(), NameError> {
    check_length(name, MAX_TOPIC)?;
    let parts = name.strip_prefix('/').ok_or_else(|| NameError::Relative(name.into()))?;
    parts.split('/').try_for_each(|part| check_part(part, name))
}

/// Checks the name of a node, without its namespace.
///
/// # Errors
/// What is wrong with it.
pub fn check_node(name: &str) -> Result<(), NameError> {
    check_length(name, MAX_NODE)?;
    check_part(name, name)
}

/// Checks a namespace: `/`, or parts that each begin with it.
///
/// # Errors
/// What is wrong with it.
pub fn check_namespace(name: &str) -> Result<(), NameError> {
    if name == "/" {
        return Ok(());
    }
    check_topic(name)
}

fn check_length(name: &str, longest: usize) -> Result<(), NameError> {
    if name.len() > longest {
        return Err(NameError::Long { name: name.into(), longest });
    }
    Ok(())
}

fn check_part(part: &str, whole: &str) -> Result<(), NameError> {
    let first = part.bytes().next().ok_or_else(|| NameError::Empty(whole.into()))?;
    if first.is_ascii_digit() || !part.bytes().all(|c| c.is_ascii_alphanumeric() || c == b'_') {
        return Err(NameError::Characters(whole.into()));
    }
    Ok(())
}

/// Whether a type is a message or one half of a service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Kind {
    /// `package/msg/Type`.
    Message,
    /// `package/srv/Type`.
    Service,
}

impl Kind {
    fn folder(self) -> &'static str {
        match self {
            Self::Message => "msg",
            Self::Service => "srv",
        }
    }
}

/// The name of a type: `package/msg/Type` or `package/srv/Type`.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TypeName {
    /// The package it is defined in.
    pub package: String,
    /// Message or service.
    pub kind: Kind,
    /// Its own name.
    pub name: String,
}

impl TypeName {
    /// The message `name` of `package`.
    pub fn message(package: &str, name: &str) -> Self {
        Self { package: package.into(), kind: Kind::Message, name: name.into() }
    }

    /// The type that is written `text`: `package/msg/Type`, `package/srv/Type`, or `package/Type` for a message.
    ///
    /// # Errors
    /// [`NameError::Type`] when it is none of these.
    pub fn parse(text: &str) -> Result<Self, NameError> {
        let error = || NameError::Type(text.into());
        let parts: Vec<&str> = text.split('/').collect();
        let (package, kind, name) = match parts[..] {
            [package, "msg", name] | [package, name] => (package, Kind::Message, name),
            [package, "srv", name] => (package, Kind::Service, name),
            _ => return Err(error()),
        };
        check_part(package, text).map_err(|_| error())?;
        check_part(name, text).map_err(|_| error())?;
        Ok(Self { package: package.into(), kind, name: name.into() })
    }

    /// What DDS calls it: `package::msg::dds_::Type_`.
    pub fn dds(&self) -> String {
        format!("{}::{}::dds_::{}_", self.package, self.kind.folder(), self.name)
    }

    /// The type of a service's requests.
    pub fn request(&self) -> Self {
        self.half("Request")
    }

    /// The type of a service's replies.
    pub fn response(&self) -> Self {
        self.half("Response")
    }

    fn half(&self, which: &str) -> Self {
        Self { name: format!("{}_{which}", self.name), ..self.clone() }
    }
}

impl fmt::Display for TypeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.package, self.kind.folder(), self.name)
    }
}

/// What DDS calls the topic `name`.
pub fn dds_topic(name: &str) -> String {
    format!("rt{name}")
}

/// What DDS calls the topics of requests and replies of the service `name`.
pub fn dds_service(name: &str) -> (String, String) {
    (format!("rq{name}Request"), format!("rr{name}Reply"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cleaned(name: &str) -> String {
        let clean = clean_topic(name, MAX_TOPIC);
        assert_eq!(check_topic(&clean), Ok(()), "{name}");
        clean
    }

    #[test]
    fn names_are_cleaned_as_those_of_the_third_version() {
        assert_eq!(cleaned("/ambf/env/psm1/baselink/State"), "/ambf/env/psm1/baselink/State");
        assert_eq!(cleaned("/ambf/env//a b-c.d(e)[f]"), "/ambf/env/a_b_c_d_e__f_");
        assert_eq!(cleaned("ambf/env/"), "/ambf/env");
        assert_eq!(cleaned("/a__b/x_/_x/ABC"), "/a__b/x_/_x/ABC");
    }

    #[test]
    fn a_part_that_begins_with_a_digit_gets_an_underscore_before_it() {
        assert_eq!(cleaned("/ambf/env/psm1/tool_id/420006"), "/ambf/env/psm1/tool_id/_420006");
        assert_eq!(clean_node("/1/a"), "_1_a");
    }

    #[test]
    fn other_characters_and_empty_names_become_valid() {
        assert_eq!(cleaned("/Größe/~{x}"), "/Gr__e/__x_");
        assert_eq!(cleaned(""), "/_");
        assert_eq!(cleaned("///"), "/_");
        assert_eq!(check_node(&clean_node("")), Ok(()));
        assert_eq!(clean_node("/ambf/env/psm1/base link"), "ambf_env_psm1_base_link");
    }

    #[test]
    fn long_names_are_cut_and_stay_different() {
        let (one, other) = ("a".repeat(300), "a".repeat(301));
        let (clean_one, clean_other) = (cleaned(&one), cleaned(&other));
        assert_eq!(clean_one.len(), MAX_TOPIC);
        assert_ne!(clean_one, clean_other);
        assert_eq!(check_node(&clean_node(&one)), Ok(()));
        assert_eq!(clean_node(&one).len(), MAX_NODE);
    }

    #[test]
    fn names_that_are_equal_get_numbers() {
        let mut names = NameSet::default();
        assert_eq!(names.claim("/a".into()), "/a");
        assert_eq!(names.claim("/a_2".into()), "/a_2");
        assert_eq!(names.claim("/a".into()), "/a_3");
        names.release("/a");
        assert_eq!(names.claim("/a".into()), "/a");
    }

    #[test]
    fn names_that_ros_refuses_are_refused() {
        assert!(matches!(check_topic("a"), Err(NameError::Relative(_))));
        assert!(matches!(check_topic("/"), Err(NameError::Empty(_))));
        assert!(matches!(check_topic("/a//b"), Err(NameError::Empty(_))));
        assert!(matches!(check_topic("/a/1"), Err(NameError::Characters(_))));
        assert!(matches!(check_topic("/a b"), Err(NameError::Characters(_))));
        assert!(matches!(check_topic(&format!("/{}", "a".repeat(247))), Err(NameError::Long { .. })));
        assert!(matches!(check_node("a/b"), Err(NameError::Characters(_))));
        assert_eq!(check_namespace("/"), Ok(()));
    }

    #[test]
    fn types_and_topics_have_their_names_of_dds() {
        let state = TypeName::parse("ambf_msgs/msg/RigidBodyState").unwrap();
        assert_eq!(state, TypeName::parse("ambf_msgs/RigidBodyState").unwrap());
        assert_eq!(state.dds(), "ambf_msgs::msg::dds_::RigidBodyState_");
        assert_eq!(state.to_string(), "ambf_msgs/msg/RigidBodyState");
        let step = TypeName::parse("ambf_msgs/srv/Step").unwrap();
        assert_eq!(step.request().dds(), "ambf_msgs::srv::dds_::Step_Request_");
        assert_eq!(step.response().dds(), "ambf_msgs::srv::dds_::Step_Response_");
        for wrong in ["", "Type", "a/b/c", "a/msg/b/c", "a/msg/b c"] {
            assert!(TypeName::parse(wrong).is_err(), "{wrong}");
        }
        assert_eq!(dds_topic("/a/b"), "rt/a/b");
        assert_eq!(dds_service("/a/srv"), ("rq/a/srvRequest".into(), "rr/a/srvReply".into()));
    }
}
