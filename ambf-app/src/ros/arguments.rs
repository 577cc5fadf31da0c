//! What the command line says to ROS: `__name:=`, `__ns:=`, remappings of topics and services, private parameters; or the
//! same as nodes of ROS 2 take it ([`ros_args`](super::ros_args)). Both act on both versions.
//!
//! The master's address, the namespace and the like go into the environment, where all nodes of this process look,
//! those of drivers and arms too. A program must not change its environment while it has threads, so it starts itself
//! again without these arguments and hands them on in its new environment.

use std::convert::Infallible;
use std::env;
use std::ffi::OsString;
use std::io;
use std::os::unix::process::CommandExt;
use std::process::Command;

use dxr::Value;
use ros_node::NodeName;

use super::naming::graph_name;
use super::ros_args::{self, ArgumentError};
use crate::report::{self, Level};
use crate::warn;

/// Environment variable in which the arguments are handed on, with [`SEPARATOR`] between them.
const CARRIED: &str = "AMBF_ROS_ARGUMENTS";

/// ASCII's unit separator: in no name that ROS allows.
const SEPARATOR: char = '\u{1f}';

/// Arguments that have environment variables of the same meaning.
const IN_ENVIRONMENT: [(&str, &str); 4] =
    [("__ns", "ROS_NAMESPACE"), ("__master", "ROS_MASTER_URI"), ("__hostname", "ROS_HOSTNAME"), ("__ip", "ROS_IP")];

/// What a command line says to ROS. The namespace, master and host name are in the environment.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RosArguments {
    /// Name of the node, instead of one that is made unique.
    pub name: Option<String>,
    /// Topics and services: full names, and what they are called instead.
    pub mappings: Vec<(String, String)>,
    /// Private parameters of the node: name and value.
    pub parameters: Vec<(String, Value)>,
    /// Namespace of the nodes of ROS 2; those of ROS 1 have it from the environment.
    pub namespace: Option<String>,
    /// Parameters of objects: full names and values. On ROS 1 they are on the parameter server, for anybody to set.
    pub of_objects: Vec<(String, Value)>,
    /// Nothing less important is written or sent.
    pub level: Option<Level>,
    /// Whether `/rosout` of ROS 2 is left out.
    pub no_log: bool,
}

impl RosArguments {
    /// Takes the arguments of the form `a:=b` from this process: starts the program again without them, if there are
    /// any. To be called first in `main`, before there are threads; returns what the start before has handed on. What
    /// cannot be used is reported, and a level of lines comes into force.
    ///
    /// # Errors
    /// [`ArgumentError::Restart`] when the program cannot be started again, others when what is between `--ros-args` and
    /// `--` is of no use.
    pub fn take() -> Result<Self, ArgumentError> {
        let (plain, of_ros2) = ros_args::extract(env::args_os())?;
        let (kept, mut taken) = split(plain.into_iter());
        taken.extend(of_ros2.into_iter().map(OsString::from));
        if taken.is_empty() {
            let carried = env::var(CARRIED).unwrap_or_default();
            let namespace = env::var("ROS_NAMESPACE").unwrap_or_default();
            let (arguments, complaints) = Self::parse(carried.split(SEPARATOR), &namespace);
            complaints.iter().for_each(|complaint| warn!("{complaint}"));
            arguments.level.into_iter().for_each(report::set_level);
            return Ok(arguments);
        }
        let mut command = Command::new(env::current_exe().map_err(ArgumentError::Restart)?);
        if let Some(name) = env::args_os().next() {
            command.arg0(name);
        }
        let text = |argument: &OsString| argument.to_string_lossy().into_owned();
        let taken: Vec<String> = taken.iter().map(text).collect();
        for (key, variable) in IN_ENVIRONMENT {
            if let Some(value) = taken.iter().find_map(|argument| argument.strip_prefix(key)?.strip_prefix(":=")) {
                command.env(variable, value);
            }
        }
        command.env(CARRIED, taken.join(&SEPARATOR.to_string()));
        let failed: Result<Infallible, io::Error> = Err(command.args(kept).exec());
        failed.map(|never| match never {}).map_err(ArgumentError::Restart)
    }

    /// The arguments, and a sentence for each that cannot be used. Names without a leading slash are below `namespace`.
    fn parse<'a>(carried: impl Iterator<Item = &'a str>, namespace: &str) -> (Self, Vec<String>) {
        let (mut arguments, mut complaints) = (Self::default(), Vec::new());
        for argument in carried.filter(|argument| !argument.is_empty()) {
            let mut ignored = |why: &str| complaints.push(format!("\"{argument}\" is ignored: {why}"));
            let Some((key, value)) = argument.split_once(":=") else { continue };
            if let Some(special) = key.strip_prefix("__") {
                arguments.take_special(special, value);
                let is_known = ["log", "log_level", "rosout"].contains(&special)
                    || IN_ENVIRONMENT.iter().any(|(known, _)| *known == key);
                if special == "name" && is_base_name(value) {
                    arguments.name = Some(value.to_owned());
                } else if special == "name" {
                    ignored("the name of a node has letters, digits and underscores only, and begins with a letter");
                } else if !is_known {
                    ignored("no such argument of ROS is known");
                }
            } else if let Some(parameter) = key.strip_prefix("_").filter(|name| name.starts_with('/')) {
                arguments.of_objects.push((parameter.to_owned(), parameter_value(value)));
            } else if let Some(parameter) = key.strip_prefix('_') {
                arguments.parameters.push((parameter.to_owned(), parameter_value(value)));
            } else {
                match (resolve(key, namespace), resolve(value, namespace)) {
                    (Some(from), Some(to)) => arguments.mappings.push((from, to)),
                    _ => ignored("expected NAME:=NAME, with names of topics or services"),
                }
            }
        }
        (arguments, complaints)
    }

    /// What stands behind `__` and has no place in the environment of ROS 2.
    fn take_special(&mut self, key: &str, value: &str) {
        match key {
            "ns" => self.namespace = resolve(value, "").or((value == "/").then(|| value.to_owned())),
            "log_level" => self.level = Level::named(value),
            "rosout" => self.no_log = value == "false",
            _ => (),
        }
    }

    /// How the node is called; `base` is the beginning of a name that is made unique.
    pub(super) fn node_name(&self, base: &str) -> NodeName {
        self.name.clone().map_or_else(|| NodeName::Anonymous(base.to_owned()), NodeName::Exact)
    }

    /// What the topic or service `name` is called.
    pub(crate) fn mapped(&self, name: String) -> String {
        self.mappings.iter().find(|(from, _)| *from == name).map_or(name, |(_, to)| to.clone())
    }
}

/// The arguments after the first: those without `:=`, and those with it.
fn split(arguments: impl Iterator<Item = OsString>) -> (Vec<OsString>, Vec<OsString>) {
    arguments.skip(1).partition(|argument| !argument.as_encoded_bytes().windows(2).any(|pair| pair == b":="))
}

fn is_base_name(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_alphabetic()) && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

/// The full name, as `graph_name` makes it; `None` for what is no name of a topic or service.
fn resolve(name: &str, namespace: &str) -> Option<String> {
    let parts = if name.starts_with('/') { ["", name] } else { [namespace, name] };
    let (full, replaced) = graph_name(&parts);
    (!name.trim_matches('/').is_empty() && !replaced).then_some(full)
}

/// As roscpp reads it: a whole number, a number, a truth value, else text.
fn parameter_value(text: &str) -> Value {
    if let Ok(number) = text.parse() {
        return Value::Integer(number);
    }
    match (text.parse::<f64>(), text) {
        (Ok(number), _) if number.is_finite() => Value::Double(number),
        (_, "true" | "True" | "TRUE") => Value::Boolean(true),
        (_, "false" | "False" | "FALSE") => Value::Boolean(false),
        _ => Value::String(text.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_for_ros_is_taken() {
        let arguments = ["program:=x", "-l", "1", "__name:=foo", "--ns=/a", "a:=b"].map(OsString::from);
        let (kept, taken) = split(arguments.into_iter());
        assert_eq!(kept, ["-l", "1", "--ns=/a"]);
        assert_eq!(taken, ["__name:=foo", "a:=b"]);
    }

    #[test]
    fn names_are_resolved_and_values_have_types() {
        let carried = [
            "__name:=sim",
            "__log:=/tmp/x.log",
            "__ns:=/lab",
            "chatter:=/lab//talk/",
            "/a/State:=b/State",
            "_rate:=50",
            "_gain:=0.5",
            "_on:=true",
            "_who:=me:=you",
        ];
        let (arguments, complaints) = RosArguments::parse(carried.into_iter(), "/lab");
        assert_eq!(complaints, [""; 0]);
        assert_eq!(arguments.node_name("base"), NodeName::Exact("sim".into()));
        assert_eq!(arguments.namespace.as_deref(), Some("/lab"));
        let pair = |a: &str, b: &str| (a.to_owned(), b.to_owned());
        assert_eq!(arguments.mappings, [pair("/lab/chatter", "/lab/talk"), pair("/a/State", "/lab/b/State")]);
        assert_eq!(arguments.mapped("/a/State".into()), "/lab/b/State");
        assert_eq!(arguments.mapped("/a/Command".into()), "/a/Command");
        let values = [
            ("rate", Value::Integer(50)),
            ("gain", Value::Double(0.5)),
            ("on", Value::Boolean(true)),
            ("who", Value::String("me:=you".into())),
        ];
        assert_eq!(arguments.parameters, values.map(|(name, value)| (name.to_owned(), value)));
    }

    #[test]
    fn objects_parameters_levels_and_logs_are_told_apart() {
        let carried = ["_/e/lamp/cutoff_angle:=0.5", "__log_level:=Error", "__rosout:=false", "_x:=1"];
        let (arguments, complaints) = RosArguments::parse(carried.into_iter(), "");
        assert_eq!(complaints, [""; 0]);
        assert_eq!(arguments.of_objects, [("/e/lamp/cutoff_angle".to_owned(), Value::Double(0.5))]);
        assert_eq!(arguments.parameters, [("x".to_owned(), Value::Integer(1))]);
        assert_eq!((arguments.level, arguments.no_log), (Some(Level::Error), true));
    }

    #[test]
    fn what_cannot_be_used_is_named() {
        let (arguments, complaints) =
            RosArguments::parse(["__name:=a/b", "__what:=1", "a b:=c", ":=d", "e:=/"].into_iter(), "");
        assert_eq!(arguments, RosArguments::default());
        assert_eq!(complaints.len(), 5, "{complaints:?}");
        assert!(complaints[0].contains("\"__name:=a/b\" is ignored"), "{complaints:?}");
        let (none, complaints) = RosArguments::parse("".split(SEPARATOR), "");
        assert_eq!((none.node_name("base"), complaints.len()), (NodeName::Anonymous("base".into()), 0));
    }
}
