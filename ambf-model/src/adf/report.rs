//! Problems found while reading, and why a file could not be read at all.

use std::collections::HashMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::common::SourcePos;
use crate::text::one_line;

/// Problems that are kept per file; more are only counted.
const MAX_PROBLEMS: usize = 10_000;

/// How bad a problem is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Severity {
    /// What was chosen where there was a choice; nothing is wrong.
    Info,
    /// Something is not used or not as expected; nothing is dropped.
    Warning,
    /// An element is dropped, or a default replaces what was written.
    Error,
    /// The whole file is refused.
    Fatal,
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Severity::Info => "info",
            Severity::Warning => "warning",
            Severity::Error | Severity::Fatal => "error",
        })
    }
}

/// What kind of problem it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ProblemKind {
    /// A key that nothing reads.
    UnknownKey,
    /// A known key that has no effect where it stands.
    IgnoredKey,
    /// A key that occurs twice in one mapping; the first counts.
    DuplicateKey,
    /// A value that does not convert to the type that is expected.
    WrongType,
    /// A key that is required.
    MissingKey,
    /// An element that is listed but not defined.
    MissingElement,
    /// An element that is defined as null.
    EmptyElement,
    /// A value outside its range.
    OutOfRange,
    /// A number that is infinite or not a number.
    NonFinite,
    /// A text that is none of those expected.
    UnknownValue,
    /// Something is absent that most elements have.
    Absent,
    /// More than one document in the file; only the first is read.
    SecondDocument,
    /// Aliases make the file unreasonably large.
    TooLarge,
    /// Links and joints that form no tree; what was found says how.
    Structure,
}

/// One problem.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Problem {
    /// How bad it is.
    pub severity: Severity,
    /// What it is.
    pub kind: ProblemKind,
    /// Where.
    pub source: SourcePos,
    /// Keys that lead there, joined by ` / `.
    pub path: String,
    /// Last key of the path.
    pub key: String,
    /// What was found; may be empty.
    pub found: String,
    /// What was expected; may be empty.
    pub expected: String,
    /// What is done instead.
    pub action: String,
}

impl ProblemKind {
    /// A short name that stays the same, for tools: `unknown key`.
    pub fn name(self) -> &'static str {
        match self {
            Self::UnknownKey => "unknown key",
            Self::IgnoredKey => "ignored key",
            Self::DuplicateKey => "duplicate key",
            Self::WrongType => "wrong type",
            Self::MissingKey => "missing key",
            Self::MissingElement => "missing element",
            Self::EmptyElement => "empty element",
            Self::OutOfRange => "out of range",
            Self::NonFinite => "not finite",
            Self::UnknownValue => "unknown value",
            Self::Absent => "absent",
            Self::SecondDocument => "second document",
            Self::TooLarge => "too large",
            Self::Structure => "structure",
        }
    }
}

impl Problem {
    /// What is wrong and what is done instead, without place and severity.
    pub fn sentence(&self) -> String {
        let mut sentence = String::new();
        if !self.path.is_empty() {
            sentence += &format!("`{}` ", self.path);
        }
        sentence += &self.what();
        if !self.action.is_empty() {
            sentence += &format!("; {}", self.action);
        }
        sentence
    }

    /// What is wrong, without place and key.
    fn what(&self) -> String {
        use ProblemKind as K;
        match self.kind {
            K::UnknownKey => "is not known".into(),
            K::IgnoredKey => "is not used".into(),
            K::DuplicateKey => "occurs twice".into(),
            K::MissingKey | K::Absent => format!("is missing ({})", self.expected),
            K::MissingElement => "is listed but not defined".into(),
            K::EmptyElement => "is listed but empty".into(),
            K::SecondDocument => "a second document starts".into(),
            K::TooLarge => "aliases make the file too large".into(),
            K::Structure => self.found.clone(),
            K::WrongType | K::OutOfRange | K::NonFinite | K::UnknownValue => {
                format!("is {}, expected {}", self.found, self.expected)
            }
        }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&one_line(&format!("{}: {}: {}", self.source, self.severity, self.sentence())))
    }
}

/// All problems of one or more files, in the order in which they were found.
///
/// Displayed, it groups problems of the same kind and key in one line; [`Report::verbose`] gives one line a problem.
#[derive(Clone, Debug, Default)]
pub struct Report {
    problems: Vec<Problem>,
    /// Warnings, errors, fatal problems, those included that were not kept.
    counts: [usize; 4],
}

impl Report {
    /// The problems; at most 10 000 a file are kept.
    pub fn problems(&self) -> &[Problem] {
        &self.problems
    }

    /// Number of warnings.
    pub fn warnings(&self) -> usize {
        self.counts[Severity::Warning as usize]
    }

    /// Number of errors, fatal ones included.
    pub fn errors(&self) -> usize {
        self.counts[Severity::Error as usize] + self.counts[Severity::Fatal as usize]
    }

    /// Number of problems, remarks included, that are counted and not listed, because there are too many.
    pub fn unlisted(&self) -> usize {
        self.counts.iter().sum::<usize>() - self.problems.len()
    }

    /// True when nothing was found.
    pub fn is_empty(&self) -> bool {
        self.counts == [0; 4]
    }

    /// Appends the problems of another file.
    pub fn append(&mut self, other: Report) {
        self.problems.extend(other.problems);
        for (sum, n) in self.counts.iter_mut().zip(other.counts) {
            *sum += n;
        }
    }

    /// Displays one line a problem.
    pub fn verbose(&self) -> Verbose<'_> {
        Verbose(self)
    }

    pub(crate) fn push(&mut self, problem: Problem) {
        self.counts[problem.severity as usize] += 1;
        // Whatever refuses the file must be seen, however many warnings came before.
        if self.problems.len() < MAX_PROBLEMS
            || (problem.severity == Severity::Fatal && self.counts[Severity::Fatal as usize] < MAX_PROBLEMS)
        {
            self.problems.push(problem);
        }
    }

    pub(crate) fn is_fatal(&self) -> bool {
        self.counts[Severity::Fatal as usize] > 0
    }

    fn write_rest(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rest = self.unlisted();
        if rest > 0 {
            writeln!(f, "{rest} further problems are not listed")?;
        }
        Ok(())
    }
}

/// Display of a [`Report`] with one line a problem.
pub struct Verbose<'a>(&'a Report);

impl fmt::Display for Verbose<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for problem in &self.0.problems {
            writeln!(f, "{problem}")?;
        }
        self.0.write_rest(f)
    }
}

impl fmt::Display for Report {
    /// One line for each file, severity, kind and key; worst first.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const LINES_SHOWN: usize = 3;
        let mut groups: Vec<Vec<&Problem>> = Vec::new();
        let mut index = HashMap::new();
        for problem in &self.problems {
            let id = (&problem.source.file, problem.severity, problem.kind, problem.key.as_str());
            let i = *index.entry(id).or_insert_with(|| {
                groups.push(Vec::new());
                groups.len() - 1
            });
            groups[i].push(problem);
        }
        groups.sort_by_key(|g| std::cmp::Reverse(g[0].severity));
        for group in groups {
            let first = group[0];
            if group.len() == 1 {
                writeln!(f, "{first}")?;
                continue;
            }
            let (file, severity, n) = (first.source.file.display(), first.severity, group.len());
            let mut line = format!("{file}: {severity}: {n} × `{}` {}", first.key, first.what());
            if !first.action.is_empty() {
                line += &format!("; {}", first.action);
            }
            write!(f, "{}: lines ", one_line(&line))?;
            for (i, problem) in group.iter().take(LINES_SHOWN).enumerate() {
                let comma = if i > 0 { ", " } else { "" };
                write!(f, "{comma}{}", problem.source.line)?;
            }
            if group.len() > LINES_SHOWN {
                write!(f, ", … ({} more)", group.len() - LINES_SHOWN)?;
            }
            writeln!(f)?;
        }
        self.write_rest(f)
    }
}

/// Why a file was not read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// Error when the file cannot be opened or read.
    #[error("{}: cannot be read: {source}", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// Error when the file is larger than any scene.
    #[error("{}: larger than the {limit} bytes that are read", file.display())]
    TooLarge {
        /// The file.
        file: PathBuf,
        /// The largest size that is read.
        limit: u64,
    },
    /// Error when the file is not UTF-8 text or holds control characters.
    #[error("{at}: {message}; expected text in UTF-8")]
    NotText {
        /// The first byte that is not text.
        at: SourcePos,
        /// What was found.
        message: String,
    },
    /// Error when the text is not YAML or, in a robot description, not XML.
    #[error("{at}: syntax error: {message}")]
    Syntax {
        /// Where the parser stopped.
        at: SourcePos,
        /// What it did not expect.
        message: String,
    },
    /// Error when the file's `adf version` is not `1.0`.
    #[error("{at}: `adf version` is {found}, expected 1.0")]
    Version {
        /// Where the version stands.
        at: SourcePos,
        /// What it is.
        found: String,
    },
    /// Error when the root of the file is not a mapping.
    #[error("{at}: the file holds {found}, expected a mapping of keys to values")]
    NotAMapping {
        /// Start of the root.
        at: SourcePos,
        /// What the root is.
        found: &'static str,
    },
    /// Error when the root element of a robot description is neither `<robot>` nor `<mujoco>`.
    #[error("{at}: the root element is <{found}>, expected <robot> (URDF) or <mujoco> (MJCF)")]
    NotARobot {
        /// The root element.
        at: SourcePos,
        /// Its name.
        found: String,
    },
    /// Error when a robot description still has to be processed by xacro.
    #[error("{at}: this is xacro, which has to become URDF first: xacro {} > robot.urdf", at.file.display())]
    Xacro {
        /// The first element that is xacro's.
        at: SourcePos,
    },
    /// Error when values do not convert: the original refuses the whole file then. The report lists all of them.
    #[error("{}: refused because of the following\n{report}", file.display())]
    Refused {
        /// The file.
        file: Arc<Path>,
        /// All problems, at least one of them fatal.
        report: Report,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problem(severity: Severity, line: u32) -> Problem {
        Problem {
            severity,
            kind: ProblemKind::IgnoredKey,
            source: SourcePos { file: Path::new("a.yaml").into(), line, column: 3 },
            path: format!("BODY {line} / color"),
            key: "color".into(),
            found: String::new(),
            expected: String::new(),
            action: String::new(),
        }
    }

    #[test]
    fn grouped_and_verbose() {
        let mut report = Report::default();
        for line in [10, 22, 31, 40, 51] {
            report.push(problem(Severity::Warning, line));
        }
        assert_eq!(report.to_string(), "a.yaml: warning: 5 × `color` is not used: lines 10, 22, 31, … (2 more)\n");
        assert_eq!(report.verbose().to_string().lines().count(), 5);
        assert!(report.verbose().to_string().starts_with("a.yaml:10:3: warning: `BODY 10 / color` is not used\n"));
        report.push(problem(Severity::Error, 60));
        assert!(report.to_string().starts_with("a.yaml:60:3: error: `BODY 60 / color`"));
        assert_eq!((report.warnings(), report.errors()), (5, 1));
    }

    #[test]
    fn endless_problems_are_counted_not_kept() {
        let mut report = Report::default();
        for line in 0..20_000 {
            report.push(problem(Severity::Warning, line));
        }
        report.push(problem(Severity::Fatal, 1));
        assert_eq!(report.problems().len(), MAX_PROBLEMS + 1);
        assert!(report.to_string().ends_with("10000 further problems are not listed\n"));
        let mut sum = Report::default();
        sum.append(report);
        assert_eq!((sum.warnings(), sum.errors()), (20_000, 1));
    }
}
