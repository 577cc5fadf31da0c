//! XML with the place of everything in it, and the problems found in it.
//!
//! `roxmltree` is used as it is, not through a URDF crate: those stop at the first problem and don't say where it is.

use std::cell::RefCell;
use std::ops::RangeInclusive;
use std::path::Path;
use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use roxmltree::{Document, Node, ParsingOptions};

use super::{find_excess, MAX_NODES};
use crate::adf::{LoadError, Problem, ProblemKind, Report, Severity, SourcePos};

/// Most quotes in one tag.
const MAX_QUOTES: usize = 512;

/// Longest name, bytes. Names are repeated in each object that refers to them.
const MAX_NAME: usize = 255;

/// Largest number that is taken for a quantity: its products still are numbers.
const MAX_NUMBER: f64 = 1e100;

/// Most elements, from the inside, that lead to the place of a problem: bodies may lie in bodies without end.
const MOST_OUTER: usize = 4;

/// Columns in lines longer than this are counted in bytes, not in characters: some tools write everything in one line.
const LONG_LINE: usize = 4096;

/// A file while it is read.
pub(crate) struct File<'t> {
    text: &'t str,
    path: Arc<Path>,
    /// Byte at which the document starts: blanks and comments before the XML declaration, which XML does not allow, are
    /// left out.
    start: usize,
    /// Byte at which each line starts.
    lines: Vec<usize>,
    report: RefCell<Report>,
}

impl<'t> File<'t> {
    pub fn new(text: &'t str, path: &Path) -> Self {
        let starts = text.bytes().enumerate().filter(|(_, b)| *b == b'\n').map(|(i, _)| i + 1);
        Self {
            text,
            path: path.into(),
            start: before_declaration(text),
            lines: std::iter::once(0).chain(starts).collect(),
            report: RefCell::new(Report::default()),
        }
    }

    pub fn path(&self) -> &Arc<Path> {
        &self.path
    }

    pub fn into_report(self) -> Report {
        self.report.into_inner()
    }

    /// The file as a whole.
    pub fn start(&self) -> SourcePos {
        SourcePos { file: self.path.clone(), line: 0, column: 0 }
    }

    /// The document.
    fn document(&self) -> &'t str {
        &self.text[self.start..]
    }

    /// The place of a byte of the document.
    fn source(&self, byte: usize) -> SourcePos {
        let byte = self.start + byte;
        let line = self.lines.partition_point(|&start| start <= byte);
        let start = self.lines[line - 1];
        let before = self.text.get(start..byte).unwrap_or_default();
        let column = 1 + if before.len() > LONG_LINE { before.len() } else { before.chars().count() };
        let short = |n| u32::try_from(n).unwrap_or(u32::MAX);
        SourcePos { file: self.path.clone(), line: short(line), column: short(column) }
    }

    /// Parses the text.
    pub fn parse(&self) -> Result<Document<'t>, LoadError> {
        if let Some((byte, what)) = find_excess(self.document(), MAX_QUOTES) {
            return Err(self.syntax(Some(byte), what));
        }
        let options = ParsingOptions { nodes_limit: MAX_NODES, ..ParsingOptions::default() };
        Document::parse_with_options(self.document(), options).map_err(|error| {
            use roxmltree::Error as E;
            let (row, column) = (error.pos().row, error.pos().col);
            let first = self.source(0);
            let column = if row > 1 { column } else { column.saturating_add(first.column - 1) };
            let line = row.saturating_add(first.line - 1);
            let at = SourcePos { file: self.path.clone(), line, column };
            match &error {
                E::UnknownNamespace(prefix, _) if prefix == "xacro" => LoadError::Xacro { at },
                E::DtdDetected => self.syntax(
                    self.document().find("<!DOCTYPE"),
                    "a DOCTYPE is not read; write out its entities and delete it",
                ),
                E::NodesLimitReached => self.syntax(None, "too many elements for a robot"),
                _ => {
                    // The parser ends its sentences with the place.
                    let message = error.to_string();
                    let message = message.rsplit_once(" at ").map_or(message.as_str(), |(start, _)| start);
                    LoadError::Syntax { at, message: shortened(message, 200) }
                }
            }
        })
    }

    fn syntax(&self, byte: Option<usize>, message: &str) -> LoadError {
        LoadError::Syntax { at: self.source(byte.unwrap_or(0)), message: message.to_owned() }
    }
}

/// Length of the blanks and comments before an XML declaration; 0 where anything else stands there, or no declaration
/// follows.
fn before_declaration(text: &str) -> usize {
    let mut rest = text.trim_start();
    while let Some((_, behind)) = rest.strip_prefix("<!--").and_then(|comment| comment.split_once("-->")) {
        rest = behind.trim_start();
    }
    if rest.starts_with("<?xml") {
        text.len() - rest.len()
    } else {
        0
    }
}

/// A text as it may stand in a message.
fn shortened(text: &str, length: usize) -> String {
    let start: String = text.chars().take(length).collect();
    format!("{}{}", start.escape_debug(), if start.len() < text.len() { "…" } else { "" })
}

/// A text of the file in a message.
pub(crate) fn quoted(text: &str) -> String {
    format!("`{}`", shortened(text, 60))
}

/// What tells elements of a file apart.
pub(crate) type Id = roxmltree::NodeId;

/// An element of a file.
#[derive(Clone, Copy)]
pub(crate) struct Element<'a> {
    node: Node<'a, 'a>,
    file: &'a File<'a>,
}

impl<'a> Element<'a> {
    /// The outermost element of a document.
    ///
    /// # Errors
    /// xacro is left to be done.
    pub fn root(document: &'a Document<'a>, file: &'a File<'a>) -> Result<Self, LoadError> {
        let is_xacro = |node: &Node| node.tag_name().namespace().is_some_and(|uri| uri.contains("xacro"));
        match document.descendants().find(is_xacro) {
            Some(node) => Err(LoadError::Xacro { at: file.source(node.range().start) }),
            None => Ok(Self { node: document.root_element(), file }),
        }
    }

    /// The element itself.
    ///
    /// # Errors
    /// It is none of those that a robot description starts with.
    pub fn expect_tag(self, tags: &[&str]) -> Result<Self, LoadError> {
        match tags.contains(&self.tag()) {
            true => Ok(self),
            false => Err(LoadError::NotARobot { at: self.source(), found: shortened(self.tag(), 60) }),
        }
    }

    pub fn file(&self) -> &'a File<'a> {
        self.file
    }

    /// What tells the element from all others of the file.
    pub fn id(&self) -> Id {
        self.node.id()
    }

    pub fn tag(&self) -> &'a str {
        self.node.tag_name().name()
    }

    pub fn source(&self) -> SourcePos {
        self.file.source(self.node.range().start)
    }

    /// Elements inside, extensions of other programs (in a namespace of their own) not among them.
    pub fn elements(&self) -> impl Iterator<Item = Element<'a>> + use<'a> {
        let own = self.node.tag_name().namespace();
        let file = self.file;
        let children = self.node.children().filter(move |c| c.is_element() && c.tag_name().namespace() == own);
        children.map(move |node| Element { node, file })
    }

    pub fn children(&self, tag: &'static str) -> impl Iterator<Item = Element<'a>> + use<'a> {
        self.elements().filter(move |e| e.tag() == tag)
    }

    /// The element `tag` inside; the first, if there are more.
    pub fn child(&self, tag: &'static str) -> Option<Element<'a>> {
        let mut all = self.children(tag);
        let first = all.next();
        if let Some(second) = all.next() {
            second.problem(Severity::Warning, ProblemKind::DuplicateKey, "", "", "", "the first counts");
        }
        first
    }

    /// Text of an element that holds nothing else.
    pub fn text(&self) -> &'a str {
        self.node.text().unwrap_or_default().trim()
    }

    pub fn attribute(&self, name: &str) -> Option<&'a str> {
        self.node.attribute(name)
    }

    /// Names of its attributes that are in no namespace, in file order.
    pub fn attribute_names(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        self.node.attributes().filter(|attribute| attribute.namespace().is_none()).map(|attribute| attribute.name())
    }

    /// An attribute that cannot be missing.
    pub fn need(&self, name: &'static str, expected: &str) -> &'a str {
        self.attribute(name).unwrap_or_else(|| {
            self.problem(Severity::Fatal, ProblemKind::MissingKey, name, "", expected, "");
            ""
        })
    }

    /// Attribute `name` that names the element, or another one: not empty, not too long.
    pub fn need_name(&self, name: &'static str, expected: &str) -> &'a str {
        let text = self.need(name, expected);
        if self.attribute(name).is_some() && (text.is_empty() || text.len() > MAX_NAME) {
            let expected = format!("{expected} of 1 to {MAX_NAME} bytes");
            self.problem(Severity::Fatal, ProblemKind::OutOfRange, name, &quoted(text), &expected, "");
            return "";
        }
        text
    }

    /// An attribute of `N` numbers; `None` when it is absent or was reported.
    pub fn numbers<const N: usize>(&self, name: &'static str) -> Option<[f64; N]> {
        <[f64; N]>::try_from(self.numbers_in(name, N..=N)?).ok()
    }

    /// An attribute of as many numbers as `counts` allows; `None` when it is absent or was reported.
    pub fn numbers_in(&self, name: &'static str, counts: RangeInclusive<usize>) -> Option<Vec<f64>> {
        let text = self.attribute(name)?;
        let expected = || match (*counts.start(), *counts.end()) {
            (1, 1) => "a number".to_owned(),
            (least, most) if least == most => format!("{least} numbers with blanks between them"),
            (least, usize::MAX) => format!("at least {least} numbers with blanks between them"),
            (least, most) => format!("{least} to {most} numbers with blanks between them"),
        };
        let words = text.split_ascii_whitespace().take(counts.end().saturating_add(1));
        let parsed: Result<Vec<f64>, _> = words.map(str::parse::<f64>).collect();
        let Some(numbers) = parsed.ok().filter(|numbers| counts.contains(&numbers.len())) else {
            self.problem(Severity::Fatal, ProblemKind::WrongType, name, &quoted(text), &expected(), "");
            return None;
        };
        if !numbers.iter().all(|x| x.abs() <= MAX_NUMBER) {
            let expected = format!("{}, finite and below {MAX_NUMBER:e}", expected());
            self.problem(Severity::Fatal, ProblemKind::NonFinite, name, &quoted(text), &expected, "");
            return None;
        }
        Some(numbers)
    }

    pub fn real(&self, name: &'static str) -> Option<f64> {
        self.numbers::<1>(name).map(|[x]| x)
    }

    /// A number that cannot be missing.
    pub fn need_real(&self, name: &'static str) -> Option<f64> {
        self.need(name, "a number");
        self.real(name)
    }

    pub fn vector(&self, name: &'static str) -> Option<Vector3<f64>> {
        self.numbers::<3>(name).map(Vector3::from)
    }

    /// Lengths that cannot be missing; `None` when they were reported.
    pub fn lengths<const N: usize>(&self, name: &'static str) -> Option<[f64; N]> {
        self.need(name, if N == 1 { "a length in m" } else { "lengths in m" });
        let lengths = self.numbers::<N>(name)?;
        if lengths.iter().all(|x| *x > 0.0) {
            return Some(lengths);
        }
        let found = quoted(self.attribute(name).unwrap_or_default());
        self.error(ProblemKind::OutOfRange, name, &found, "lengths above 0", "the shape is left out");
        None
    }

    /// Element `origin` inside: `xyz` in m, `rpy` in rad about fixed axes, R = Rz(y)·Ry(p)·Rx(r). Default: identity.
    pub fn origin(&self) -> Isometry3<f64> {
        let Some(origin) = self.child("origin") else { return Isometry3::identity() };
        origin.finish(&["xyz", "rpy"], &[]);
        let xyz = origin.vector("xyz").unwrap_or_default();
        let rpy = origin.vector("rpy").unwrap_or_default();
        Isometry3::from_parts(Translation3::from(xyz), UnitQuaternion::from_euler_angles(rpy.x, rpy.y, rpy.z))
    }

    /// Names the attributes, elements and texts that nothing reads.
    pub fn finish(&self, attributes: &[&str], elements: &[&str]) {
        for attribute in self.node.attributes() {
            if attribute.namespace().is_none() && !attributes.contains(&attribute.name()) {
                self.problem(Severity::Warning, ProblemKind::UnknownKey, attribute.name(), "", "", "it is ignored");
            }
        }
        let own = self.node.tag_name().namespace();
        let stray = |node: &Node| node.is_text() && node.text().is_some_and(|text| !text.trim().is_empty());
        if self.node.children().any(|node| stray(&node)) {
            let action = "a text between its elements is ignored";
            self.problem(Severity::Warning, ProblemKind::WrongType, "", "mixed with text", "elements only", action);
        }
        for node in self.node.children().filter(Node::is_element) {
            if node.tag_name().namespace() != own || !elements.contains(&node.tag_name().name()) {
                let element = Element { node, file: self.file };
                element.problem(Severity::Warning, ProblemKind::UnknownKey, "", "", "", "it is ignored");
            }
        }
    }

    /// Names an attribute, or with an empty `name` the element itself, that is known and has no effect.
    pub fn ignored(&self, name: &str, why: &str) {
        self.problem(Severity::Warning, ProblemKind::IgnoredKey, name, "", "", why);
    }

    pub fn warn(&self, kind: ProblemKind, name: &str, found: &str, expected: &str, action: &str) {
        self.problem(Severity::Warning, kind, name, found, expected, action);
    }

    pub fn error(&self, kind: ProblemKind, name: &str, found: &str, expected: &str, action: &str) {
        self.problem(Severity::Error, kind, name, found, expected, action);
    }

    /// Reports a problem of an attribute, or with an empty `name` of the element itself.
    pub fn problem(
        &self,
        severity: Severity,
        kind: ProblemKind,
        name: &str,
        found: &str,
        expected: &str,
        action: &str,
    ) {
        let at = self.node.attributes().find(|a| a.name() == name).map_or(self.node.range().start, |a| a.range().start);
        let mut path: Vec<String> = self
            .node
            .ancestors()
            .filter(|n| n.is_element() && (n.parent_element().is_some() || *n == self.node))
            .take(MOST_OUTER)
            .map(|n| match n.attribute("name") {
                Some(own) if !own.trim().is_empty() => {
                    format!("{} {}", shortened(n.tag_name().name(), 60), shortened(own, 60))
                }
                _ => shortened(n.tag_name().name(), 60),
            })
            .collect();
        path.reverse();
        if !name.is_empty() {
            path.push(shortened(name, 60));
        }
        let key = if name.is_empty() { self.tag() } else { name };
        self.file.report.borrow_mut().push(Problem {
            severity,
            kind,
            source: self.file.source(at),
            path: path.join(" / "),
            key: shortened(key, 60),
            found: found.to_owned(),
            expected: expected.to_owned(),
            action: action.to_owned(),
        });
    }
}
