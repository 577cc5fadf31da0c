//! What the command line says to nodes of ROS 2, `--ros-args … --`, as arguments of ROS 1 that mean the same.

use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};

use ambf_core::files;
use saphyr_parser::{Event, Parser, ScanError};

use crate::report::Level;

/// What begins the arguments for ROS, and what ends them.
const BEGIN: &str = "--ros-args";
const END: &str = "--";

/// Name of the node that is the program, unless it is given another.
pub(super) const PROGRAM: &str = "ambf_simulator";

/// Deepest nesting of a file of parameters.
const MAX_DEPTH: usize = 32;

/// Largest file of parameters that is read, bytes.
const MAX_FILE: u64 = 1 << 20;

/// Why arguments for ROS are of no use.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ArgumentError {
    /// Error when the program cannot be started again without its arguments for ROS.
    #[error("the program cannot be started again without its arguments for ROS: {0}")]
    Restart(io::Error),
    /// Error when an argument between `--ros-args` and `--` is none of ROS 2.
    #[error(
        "\"{0}\" is no argument of --ros-args: expected -r FROM:=TO, -p NAME:=VALUE, --params-file FILE, --log-level LEVEL, \
         --enable-rosout-logs or --disable-rosout-logs, and -- before other arguments"
    )]
    Unknown(String),
    /// Error when nothing stands behind an argument that wants something.
    #[error("{flag}: expected {expected} after it, found the end")]
    Missing {
        /// The argument.
        flag: String,
        /// What it wants.
        expected: &'static str,
    },
    /// Error when what stands behind an argument is not what it wants.
    #[error("{flag} \"{found}\": expected {expected}")]
    Malformed {
        /// The argument.
        flag: String,
        /// What stands behind it.
        found: String,
        /// What it wants.
        expected: &'static str,
    },
    /// Error when a file of parameters cannot be read.
    #[error("--params-file {}: {why}", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// Why not.
        why: io::Error,
    },
    /// Error when a file of parameters is none.
    #[error("--params-file {}: {why}; expected NODE: {{ros__parameters: {{NAME: VALUE}}}}", file.display())]
    Content {
        /// The file.
        file: PathBuf,
        /// What is wrong, and where.
        why: String,
    },
}

/// What an argument wants behind it.
const RULE: &str = "FROM:=TO with full or relative names of topics or services, __ns:=/NAMESPACE or __node:=NAME";
const PARAMETER: &str = "NAME:=VALUE";
const LEVEL: &str = "debug, info, warn, error or fatal";
const FILE: &str = "the name of a file";

/// The arguments without those between `--ros-args` and `--` or the end, and those as ROS 1 has them.
///
/// # Errors
/// [`ArgumentError`].
pub(super) fn extract(
    arguments: impl Iterator<Item = OsString>,
) -> Result<(Vec<OsString>, Vec<String>), ArgumentError> {
    let (mut kept, mut taken) = (Vec::new(), Vec::new());
    let mut arguments = arguments.peekable();
    while let Some(argument) = arguments.next() {
        if argument != BEGIN {
            kept.push(argument);
            continue;
        }
        while let Some(flag) = arguments.next_if(|next| next != END) {
            // Those of two launch files are often written one behind the other.
            if flag != BEGIN {
                take_flag(&text(&flag), &mut arguments, &mut taken)?;
            }
        }
        let _end = arguments.next();
    }
    Ok((kept, taken))
}

fn text(argument: &OsString) -> String {
    argument.to_string_lossy().into_owned()
}

fn take_flag(
    flag: &str,
    rest: &mut impl Iterator<Item = OsString>,
    taken: &mut Vec<String>,
) -> Result<(), ArgumentError> {
    let mut value = |expected: &'static str| {
        rest.next().map(|value| text(&value)).ok_or(ArgumentError::Missing { flag: flag.to_owned(), expected })
    };
    let malformed = |found: String, expected| Err(ArgumentError::Malformed { flag: flag.to_owned(), found, expected });
    match flag {
        "-r" | "--remap" => {
            let found = value(RULE)?;
            match rule(&found) {
                Some(rule) => taken.push(rule),
                None => return malformed(found, RULE),
            }
        }
        "-p" | "--param" => {
            let found = value(PARAMETER)?;
            match found.split_once(":=").filter(|(name, _)| is_parameter(name)) {
                Some(_) => taken.push(format!("_{found}")),
                None => return malformed(found, PARAMETER),
            }
        }
        "--log-level" => {
            let found = value(LEVEL)?;
            // Of one logger: those of others are none of ours.
            let (logger, level) = found.split_once(":=").unwrap_or((PROGRAM, &found));
            match Level::named(level) {
                Some(_) if logger == PROGRAM => taken.push(format!("__log_level:={level}")),
                Some(_) => (),
                None => return malformed(found, LEVEL),
            }
        }
        "--params-file" => {
            let file = PathBuf::from(value(FILE)?);
            taken.extend(parameters_in(&file)?.into_iter().map(|(name, value)| format!("_{name}:={value}")));
        }
        "--enable-rosout-logs" => taken.push("__rosout:=true".into()),
        "--disable-rosout-logs" => taken.push("__rosout:=false".into()),
        _ => return Err(ArgumentError::Unknown(flag.to_owned())),
    }
    Ok(())
}

/// A remapping as ROS 1 has it; `None` for what is none.
fn rule(text: &str) -> Option<String> {
    let (from, to) = text.split_once(":=")?;
    match from {
        "__ns" => is_name(to, true).then(|| text.to_owned()),
        "__node" | "__name" => (is_name(to, false) && !to.contains('/')).then(|| format!("__name:={to}")),
        _ => (is_name(from, false) && is_name(to, false)).then(|| text.to_owned()),
    }
}

/// Whether `name` is one of ROS 2, and a full one if that is asked for.
fn is_name(name: &str, full: bool) -> bool {
    let relative = name.strip_prefix('/');
    if full && relative.is_none() {
        return false;
    }
    let is_part = |part: &str| {
        part.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
            && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    (full && name == "/") || relative.unwrap_or(name).split('/').all(is_part)
}

fn is_parameter(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || "_./-".contains(c))
}

/// Names and values of the parameters in `file` that are for this program: those of all nodes and of the program's, and
/// those of objects, which have their full names, of any node.
fn parameters_in(file: &Path) -> Result<Vec<(String, String)>, ArgumentError> {
    let error = |why| ArgumentError::File { file: file.to_owned(), why };
    let text = files::read_text(file, MAX_FILE).map_err(error)?;
    let all = leaves(&text).map_err(|why| ArgumentError::Content { file: file.to_owned(), why })?;
    let mut parameters = Vec::new();
    for (path, value) in all {
        let at = path.iter().position(|key| key == "ros__parameters").filter(|&at| at > 0 && at + 1 < path.len());
        let Some(at) = at else {
            let why = format!("\"{}\" is no parameter of a node", path.join(": "));
            return Err(ArgumentError::Content { file: file.to_owned(), why });
        };
        let (node, name) = (path[..at].join("/"), path[at + 1..].join("."));
        let is_ours = matches!(node.trim_start_matches('/'), "**" | "*" | PROGRAM);
        if (is_ours || name.starts_with('/')) && is_parameter(&name) {
            parameters.push((name, value));
        }
    }
    Ok(parameters)
}

/// Each scalar of a YAML text with the keys above it; a list of scalars is one, written `[a, b]`.
fn leaves(text: &str) -> Result<Vec<(Vec<String>, String)>, String> {
    let scan = |error: &ScanError| format!("{error}");
    let (mut found, mut parser) = (Vec::new(), Parser::new_from_str(text));
    let mut path: Vec<String> = Vec::new();
    // For each open mapping, whether its next scalar is a key; a list is kept apart.
    let mut open: Vec<bool> = Vec::new();
    let mut list: Option<Vec<String>> = None;
    while let Some(event) = parser.next_event() {
        let (event, span) = event.map_err(|error| scan(&error))?;
        let line = span.start.line();
        let refused = |what: &str| Err(format!("line {line}: {what}"));
        match event {
            Event::Scalar(scalar, ..) => match (&mut list, open.last_mut()) {
                (Some(list), _) => list.push(scalar.into_owned()),
                (None, Some(is_key)) if *is_key => {
                    path.push(scalar.into_owned());
                    *is_key = false;
                }
                (None, Some(is_key)) => {
                    *is_key = true;
                    found.push((path.clone(), scalar.into_owned()));
                    path.pop();
                }
                (None, None) => return refused("a mapping was expected"),
            },
            Event::MappingStart(..) if list.is_some() || open.last() == Some(&true) || open.len() > MAX_DEPTH => {
                return refused("a mapping is not expected here");
            }
            Event::MappingStart(..) => open.push(true),
            Event::MappingEnd => {
                open.pop();
                if let Some(is_key) = open.last_mut() {
                    *is_key = true;
                    path.pop();
                }
            }
            Event::SequenceStart(..) if list.is_some() || open.last() != Some(&false) => {
                return refused("a list is not expected here");
            }
            Event::SequenceStart(..) => list = Some(Vec::new()),
            Event::SequenceEnd => {
                found.push((path.clone(), format!("[{}]", list.take().unwrap_or_default().join(", "))));
                path.pop();
                open.last_mut().into_iter().for_each(|is_key| *is_key = true);
            }
            Event::Alias(..) => return refused("aliases are not read"),
            _ => (),
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn extracted(line: &[&str]) -> Result<(Vec<OsString>, Vec<String>), ArgumentError> {
        extract(line.iter().map(OsString::from))
    }

    #[test]
    fn arguments_of_ros_2_become_those_of_ros_1() {
        let line = "program -l 1 --ros-args -r /a/State:=b -r __ns:=/lab --remap __node:=sim -p rate:=50 --param \
                    a.b:=x:=y --log-level WARN --log-level rcl:=debug --disable-rosout-logs -- --verbose --ros-args -r c:=d";
        let (kept, taken) = extracted(&line.split_whitespace().collect::<Vec<_>>()).unwrap();
        assert_eq!(kept, ["program", "-l", "1", "--verbose"]);
        let expected = [
            "/a/State:=b",
            "__ns:=/lab",
            "__name:=sim",
            "_rate:=50",
            "_a.b:=x:=y",
            "__log_level:=WARN",
            "__rosout:=false",
            "c:=d",
        ];
        assert_eq!(taken, expected);
        assert_eq!(extracted(&["program", "--", "x"]).unwrap().0, ["program", "--", "x"]);
    }

    #[test]
    fn what_is_wrong_says_what_was_expected() {
        for (line, words) in [
            (&["-r"][..], &["-r", "FROM:=TO", "end"][..]),
            (&["-r", "a=b"], &["\"a=b\"", "FROM:=TO"]),
            (&["-r", "a:=1b"], &["\"a:=1b\"", "FROM:=TO"]),
            (&["-r", "node:a:=b"], &["node:a:=b", "FROM:=TO"]),
            (&["-r", "__ns:=lab"], &["__ns:=lab", "__ns:=/NAMESPACE"]),
            (&["-r", "__node:=a/b"], &["__node:=a/b", "__node:=NAME"]),
            (&["-r", "~/a:=b"], &["~/a:=b", "FROM:=TO"]),
            (&["-p", ":=1"], &["-p", "NAME:=VALUE"]),
            (&["-p", "node:a:=1"], &["-p", "NAME:=VALUE"]),
            (&["--log-level", "loud"], &["loud", "debug, info, warn, error or fatal"]),
            (&["--params-file", "/no/such/file"], &["/no/such/file", "No such file"]),
            (&["-l", "1"], &["\"-l\"", "and -- before other arguments"]),
        ] {
            let error = extracted(&[&["program", "--ros-args"], line].concat()).unwrap_err().to_string();
            assert!(words.iter().all(|word| error.contains(word)), "{line:?}: {error}");
        }
    }

    #[test]
    fn files_have_parameters_of_nodes() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("parameters.yaml");
        let read = |text: &str| {
            std::fs::write(&file, text).unwrap();
            parameters_in(&file)
        };
        let text = "/**:\n  ros__parameters:\n    rate: 50\n    a: {b: text, c: true}\n    list: [/x, /y]\n\
                    ambf_simulator: {ros__parameters: {own: 1.5}}\n\
                    ambf_env_lights_lamp:\n  ros__parameters: {/ambf/env/lights/lamp/cutoff_angle: 0.3, other: 1}\n\
                    someone: {ros__parameters: {theirs: 1}}\n";
        let expected = [
            ("rate", "50"),
            ("a.b", "text"),
            ("a.c", "true"),
            ("list", "[/x, /y]"),
            ("own", "1.5"),
            ("/ambf/env/lights/lamp/cutoff_angle", "0.3"),
        ];
        assert_eq!(read(text).unwrap(), expected.map(|(name, value)| (name.to_owned(), value.to_owned())));
        assert!(read("").unwrap().is_empty());
        for wrong in ["a", "a: 1", "a: {b: 1}", "ros__parameters: {a: 1}", "a: [b, {c: d}]", "- a", "a: {", "a: *b"] {
            let error = read(wrong).unwrap_err().to_string();
            assert!(error.contains("parameters.yaml") && error.contains("ros__parameters"), "{wrong}: {error}");
        }
    }
}
