//! What the linter found: one place, one sentence.

use std::fmt;

use ambf_core::adf::{Entry, LoadError, Problem, Severity, SourcePos};
use ambf_core::scene::Note;
use ambf_core::text::one_line;
use serde_json::{json, Value};

use super::original::{self, Difference};

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Fine here; another program, or the author, may expect something else.
    Info,
    /// Something is not used or not as expected; nothing is dropped.
    Warning,
    /// An element is dropped, a default replaces what was written, or the whole file is refused.
    Error,
}

impl Level {
    /// `info`, `warning` or `error`.
    pub fn word(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

impl From<Severity> for Level {
    fn from(severity: Severity) -> Self {
        match severity {
            Severity::Info => Self::Info,
            Severity::Warning => Self::Warning,
            Severity::Error | Severity::Fatal => Self::Error,
        }
    }
}

/// One finding. Texts may be empty where there is nothing to say.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// How bad it is.
    pub level: Level,
    /// What kind of finding it is, in few words that stay the same.
    pub kind: &'static str,
    /// Where.
    pub place: SourcePos,
    /// Keys that lead there, joined by ` / `.
    pub path: String,
    /// Last key of the path.
    pub key: String,
    /// What was found.
    pub found: String,
    /// What was expected.
    pub expected: String,
    /// What is done instead.
    pub action: String,
    /// All of it in one sentence, without place and level.
    pub sentence: String,
    /// What the C++ program does where that is something else.
    pub original: Option<&'static str>,
}

impl Finding {
    /// A finding of the linter itself at an entry of a file: `` `path` sentence``.
    pub(super) fn new(level: Level, kind: &'static str, place: SourcePos, path: &[&str], sentence: &str) -> Self {
        let joined = path.join(" / ");
        let quoted = if joined.is_empty() { String::new() } else { format!("`{joined}` ") };
        Self {
            level,
            kind,
            place,
            key: path.last().copied().unwrap_or_default().to_owned(),
            path: joined,
            found: String::new(),
            expected: String::new(),
            action: String::new(),
            sentence: quoted + sentence,
            original: None,
        }
    }

    /// Something that is fine here and different in the C++ program.
    pub(super) fn differs(difference: &Difference, entry: Entry<'_>, path: &[&str]) -> Self {
        let mut whole = path.to_vec();
        if !difference.key.is_empty() {
            whole.push(difference.key);
        }
        let place = entry.get(difference.key).unwrap_or(entry).source();
        let mut finding = Self::new(Level::Info, difference.kind, place, &whole, difference.here);
        finding.original = Some(difference.original).filter(|text| !text.is_empty());
        finding
    }

    /// A problem that the reader met in an element called `element`.
    pub(super) fn of_problem(problem: &Problem, element: &str) -> Self {
        Self {
            level: problem.severity.into(),
            kind: problem.kind.name(),
            place: problem.source.clone(),
            path: problem.path.clone(),
            key: problem.key.clone(),
            found: problem.found.clone(),
            expected: problem.expected.clone(),
            action: problem.action.clone(),
            sentence: problem.sentence(),
            original: original::of_problem(element, problem),
        }
    }

    /// A remark made while the scene was built.
    pub(super) fn of_note(note: &Note) -> Self {
        let mut finding = Self::new(note.severity.into(), "scene", note.source.clone(), &[], &note.message);
        // Messages begin with the element that they are about.
        if let Some((element, _)) = note.message.strip_prefix('`').and_then(|text| text.split_once('`')) {
            finding.path = element.to_owned();
            finding.key = element.to_owned();
        }
        finding
    }

    /// Why a file could not be read at all.
    pub(super) fn of_error(error: &LoadError, file: &std::path::Path) -> Self {
        let whole = SourcePos { file: file.into(), line: 0, column: 0 };
        let (kind, place) = match error {
            LoadError::NotText { at, .. } => ("no text", at.clone()),
            LoadError::Syntax { at, .. } => ("syntax", at.clone()),
            LoadError::Xacro { at } => ("xacro", at.clone()),
            LoadError::NotARobot { at, .. } => ("no robot", at.clone()),
            LoadError::Version { at, .. } => ("version", at.clone()),
            LoadError::NotAMapping { at, .. } => ("no mapping", at.clone()),
            LoadError::TooLarge { .. } => ("too large", whole),
            _ => ("unreadable", whole),
        };
        let text = error.to_string();
        // The place goes before the level.
        let sentence = text.strip_prefix(&format!("{place}: ")).unwrap_or(&text);
        let mut finding = Self::new(Level::Error, kind, place, &[], sentence);
        finding.action = "the file is refused".into();
        finding.sentence += "; the file is refused";
        finding
    }

    /// The finding as an object of JSON.
    pub fn to_json(&self) -> Value {
        json!({
            "severity": self.level.word(),
            "kind": self.kind,
            "file": self.place.file.display().to_string(),
            "line": self.place.line,
            "column": self.place.column,
            "path": self.path,
            "key": self.key,
            "found": self.found,
            "expected": self.expected,
            "action": self.action,
            "message": self.sentence,
            "original": self.original,
        })
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&one_line(&format!("{}: {}: {}", self.place, self.level.word(), self.sentence)))?;
        match self.original {
            Some(original) => write!(f, " (the C++ program: {original})"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn an_error_names_its_place_once() {
        let error = ambf_core::adf::parse::<ambf_core::adf::Model>("a: [\n", Path::new("m.yaml")).unwrap_err();
        let line = Finding::of_error(&error, Path::new("m.yaml")).to_string();
        assert!(line.starts_with("m.yaml:2:1: error: syntax error: "), "{line}");
        assert_eq!(line.matches("m.yaml").count(), 1, "{line}");
    }

    #[test]
    fn levels_are_ordered() {
        assert!(Level::Info < Level::Warning && Level::Warning < Level::from(Severity::Fatal));
    }
}
