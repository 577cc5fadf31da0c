//! Typed access to the tree, with every problem reported where it stands.
//!
//! A [`Map`] is a mapping seen from one place. Its getters mark a key as read, convert its value and report what does
//! not fit; [`Map::finish`] reports the keys that nobody asked for. The caller always gets a usable value and goes on,
//! so that all problems of a file are found in one go; whether the value counts is decided at the end from the report
//! ([`Severity::Fatal`] refuses the file) and from [`Reader::element`] (an error drops the element).

mod access;

use std::borrow::Cow;
use std::cell::{Cell, RefCell};
use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::sync::Arc;

use super::common::SourcePos;
use super::report::{Problem, ProblemKind, Report, Severity};
use super::yaml::{Document, Kind, Mark, Node, NodeId};

/// The key that holds the version of the format.
const VERSION_KEY: &str = "adf version";

/// Whether a key at the root of a file holds the version of the format: `adf version`, in any letter case.
pub fn is_version_key(key: &str) -> bool {
    key.eq_ignore_ascii_case(VERSION_KEY)
}

/// Mappings with more keys are indexed instead of searched.
const SMALL_MAP: usize = 24;

/// Range of a number.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Range {
    Any,
    NotNegative,
    Positive,
    /// More than 0, at most 1.
    Share,
}

impl Range {
    fn holds(self, x: f64) -> bool {
        match self {
            Range::Any => true,
            Range::NotNegative => x >= 0.0,
            Range::Positive => x > 0.0,
            Range::Share => x > 0.0 && x <= 1.0,
        }
    }

    pub(super) fn words(self) -> &'static str {
        match self {
            Range::Any => "a finite number",
            Range::NotNegative => "a finite number, at least 0",
            Range::Positive => "a finite number above 0",
            Range::Share => "a number above 0, at most 1",
        }
    }
}

/// What becomes of an element that is listed but not defined; the original takes it for an empty mapping.
#[derive(Clone, Copy)]
pub(super) enum Absent {
    /// It is made from defaults; the text says what that gives.
    Made(&'static str),
    /// It is dropped.
    Dropped,
    /// The file is refused.
    Refused,
}

/// A file while it is read.
pub(super) struct Reader<'t> {
    doc: &'t Document<'t>,
    file: Arc<Path>,
    report: RefCell<Report>,
    /// What a value that does not convert means: the file is refused, or the element is dropped.
    conversion: Cell<Severity>,
    /// What is being read, for messages; "" outside elements.
    element: Cell<&'static str>,
    /// An error was found in the element being read.
    spoiled: Cell<bool>,
    /// Entries that may still be looked at: with aliases a small file can have endlessly many.
    work: Cell<usize>,
    /// Mappings whose duplicate or unknown keys were reported; aliases show the same ones again.
    seen: RefCell<HashSet<NodeId>>,
    finished: RefCell<HashSet<NodeId>>,
}

impl<'t> Reader<'t> {
    pub(super) fn new(doc: &'t Document<'t>, file: Arc<Path>) -> Self {
        Self {
            doc,
            file,
            report: RefCell::default(),
            conversion: Cell::new(Severity::Fatal),
            element: Cell::new(""),
            spoiled: Cell::new(false),
            work: Cell::new(2_000_000 + 20 * doc.len()),
            seen: RefCell::default(),
            finished: RefCell::default(),
        }
    }

    pub(super) fn file(&self) -> &Arc<Path> {
        &self.file
    }

    /// Directory of the file, empty when the file was named without one.
    pub(super) fn dir(&self) -> &Path {
        self.file.parent().unwrap_or(Path::new(""))
    }

    pub(super) fn into_report(self) -> Report {
        self.report.into_inner()
    }

    pub(super) fn source(&self, mark: Mark) -> SourcePos {
        SourcePos { file: self.file.clone(), line: mark.line, column: mark.column }
    }

    /// Reads an element called `noun` in messages; `None` when an error was found in it.
    pub(super) fn element<T>(&self, noun: &'static str, read: impl FnOnce() -> Option<T>) -> Option<T> {
        let outer = (self.element.replace(noun), self.spoiled.replace(false));
        let value = read().filter(|_| !self.spoiled.get());
        self.element.set(outer.0);
        self.spoiled.set(outer.1);
        value
    }

    /// As [`Reader::element`]; a value that does not convert drops the element instead of the file.
    pub(super) fn tolerant_element<T>(&self, noun: &'static str, read: impl FnOnce() -> Option<T>) -> Option<T> {
        let outer = self.conversion.replace(Severity::Error);
        let value = self.element(noun, read);
        self.conversion.set(outer);
        value
    }

    /// From here on a value that does not convert drops its element instead of the file.
    pub(super) fn tolerate(&self) {
        self.conversion.set(Severity::Error);
    }

    /// Drops the element being read.
    pub(super) fn spoil(&self) {
        self.spoiled.set(true);
    }

    fn dropped(&self) -> String {
        match self.element.get() {
            "" => "the default is used".into(),
            noun => format!("the {noun} is dropped"),
        }
    }

    /// Copying a text is work too: an alias can ask for a long one again and again.
    fn spend_text(&self, text: &str) -> bool {
        self.spend(1 + text.len() / 16)
    }

    /// False when the work left does not suffice; the file is refused then.
    fn spend(&self, work: usize) -> bool {
        let left = self.work.get();
        if left >= work {
            self.work.set(left - work);
            return true;
        }
        if left > 0 {
            self.work.set(0);
            self.report.borrow_mut().push(Problem {
                severity: Severity::Fatal,
                kind: ProblemKind::TooLarge,
                source: self.source(Mark::default()),
                path: String::new(),
                key: String::new(),
                found: String::new(),
                expected: String::new(),
                action: "the file is refused".into(),
            });
        }
        false
    }
}

/// A mapping seen from one place; null and absent ones are empty.
pub struct Map<'m> {
    r: &'m Reader<'m>,
    parent: Option<&'m Map<'m>>,
    key: Cow<'m, str>,
    /// Where its key stands.
    pub(super) mark: Mark,
    id: Option<NodeId>,
    entries: &'m [(NodeId, NodeId)],
    read: Vec<Cell<bool>>,
    index: Option<HashMap<&'m str, usize>>,
}

fn text_of<'m>(node: &'m Node<'m>) -> &'m str {
    match &node.kind {
        Kind::Scalar(text) => text,
        _ => "null",
    }
}

/// What a message shows of a text.
fn shortened(text: &str) -> Cow<'_, str> {
    const SHOWN: usize = 80;
    match text.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}…", &text[..end]).into(),
        None => text.into(),
    }
}

fn described(node: &Node<'_>) -> String {
    match &node.kind {
        Kind::Null => "empty".into(),
        Kind::Scalar(text) => format!("`{}`", shortened(text)),
        Kind::List(items) => format!("a list of {}", items.len()),
        Kind::Map(_) => "a mapping".into(),
    }
}

impl<'m> Map<'m> {
    /// The root of a file whose root is a mapping.
    pub(super) fn root(r: &'m Reader<'m>, entries: &'m [(NodeId, NodeId)]) -> Self {
        Self::new(r, None, "".into(), r.doc.root().mark, None, entries)
    }

    fn new(
        r: &'m Reader<'m>,
        parent: Option<&'m Map<'m>>,
        key: Cow<'m, str>,
        mark: Mark,
        id: Option<NodeId>,
        entries: &'m [(NodeId, NodeId)],
    ) -> Self {
        let entries = if r.spend(entries.len() + 1) { entries } else { &[] };
        let mut map =
            Self { r, parent, key, mark, id, entries, read: vec![Cell::new(false); entries.len()], index: None };
        let first_look = id.is_none_or(|id| r.seen.borrow_mut().insert(id));
        let mut duplicates = Vec::new();
        if entries.len() > SMALL_MAP {
            let mut index = HashMap::with_capacity(entries.len());
            for (i, &(key, _)) in entries.iter().enumerate() {
                match index.entry(text_of(r.doc.node(key))) {
                    std::collections::hash_map::Entry::Occupied(_) => duplicates.push(i),
                    std::collections::hash_map::Entry::Vacant(slot) => {
                        slot.insert(i);
                    }
                }
            }
            map.index = Some(index);
        } else if first_look {
            let name = |i: usize| text_of(r.doc.node(entries[i].0));
            duplicates.extend((1..entries.len()).filter(|&i| (0..i).any(|j| name(i) == name(j))));
        }
        if first_look {
            for &i in &duplicates {
                let node = r.doc.node(entries[i].0);
                let what = ProblemKind::DuplicateKey;
                let note = "the first one is used";
                map.note(Severity::Warning, what, node.mark, text_of(node), "", "", note);
            }
        }
        for i in duplicates {
            map.read[i].set(true);
        }
        map
    }

    pub(super) fn reader(&self) -> &'m Reader<'m> {
        self.r
    }

    /// Key under which the mapping stands.
    pub(super) fn key(&self) -> &str {
        &self.key
    }

    fn path(&self, key: &str) -> String {
        let mut parts = Vec::new();
        if !key.is_empty() {
            parts.push(shortened(key));
        }
        let mut map = Some(self);
        while let Some(m) = map {
            if !m.key.is_empty() {
                parts.push(shortened(&m.key));
            }
            map = m.parent;
        }
        parts.reverse();
        parts.join(" / ")
    }

    /// Records a problem. An error also drops the element being read only if the caller says so ([`Reader::spoil`]).
    #[allow(clippy::too_many_arguments)] // the parts of one message
    fn note(
        &self,
        severity: Severity,
        kind: ProblemKind,
        mark: Mark,
        key: &str,
        found: &str,
        expected: &str,
        action: &str,
    ) {
        if self.r.work.get() == 0 {
            return; // values are made up from here on
        }
        let path = self.path(key);
        let last = if key.is_empty() { &self.key } else { key };
        self.r.report.borrow_mut().push(Problem {
            severity,
            kind,
            source: self.r.source(mark),
            key: shortened(last).into_owned(),
            path,
            found: found.to_owned(),
            expected: expected.to_owned(),
            action: action.to_owned(),
        });
    }

    fn position(&self, key: &str) -> Option<usize> {
        if let Some(index) = &self.index {
            return index.get(key).copied();
        }
        (self.entries.iter()).position(|&(k, _)| text_of(self.r.doc.node(k)) == key)
    }

    fn entry(&self, key: &str) -> Option<(Mark, NodeId)> {
        let i = self.position(key)?;
        self.read[i].set(true);
        let (key, value) = self.entries[i];
        Some((self.r.doc.node(key).mark, value))
    }

    fn node(&self, key: &str) -> Option<&'m Node<'m>> {
        self.entry(key).map(|(_, id)| self.r.doc.node(id))
    }

    /// Place of a key's value, or of the mapping.
    fn place(&self, key: &str) -> Mark {
        self.position(key).map_or(self.mark, |i| self.r.doc.node(self.entries[i].1).mark)
    }

    // --- presence -------------------------------------------------------------------------------------------------

    /// True when the key is there, even if its value is null.
    pub(super) fn has(&self, key: &str) -> bool {
        self.position(key).is_some()
    }

    /// True when the key is there and holds a mapping.
    pub(super) fn is_map(&self, key: &str) -> bool {
        self.node(key).is_some_and(|n| matches!(n.kind, Kind::Map(_)))
    }

    /// True when the key is there but null.
    pub(super) fn is_null(&self, key: &str) -> bool {
        self.node(key).is_some_and(|n| matches!(n.kind, Kind::Null))
    }

    /// Keys that something else of the element replaces; they need no message.
    pub(super) fn skip(&self, keys: &[&str]) {
        for key in keys {
            self.entry(key);
        }
    }

    /// Warns about keys that are known but have no effect; `why` completes "is not used; …".
    pub(super) fn ignore(&self, keys: &[&str], why: &str) {
        for key in keys {
            if let Some((mark, _)) = self.entry(key) {
                let (kind, found) = (ProblemKind::IgnoredKey, self.found(key));
                self.note(Severity::Warning, kind, mark, key, &found, "", why);
            }
        }
    }

    /// Says that a key which is read has no effect here; `why` completes "is not used; …".
    pub(super) fn remark(&self, key: &str, why: &str) {
        let (found, place) = (self.found(key), self.place(key));
        self.note(Severity::Info, ProblemKind::IgnoredKey, place, key, &found, "", why);
    }

    /// Keys that were not read, without duplicates.
    pub(super) fn unread_keys(&self) -> Vec<&'m str> {
        let entries = self.entries.iter().zip(&self.read);
        let unread = entries.filter(|(_, read)| !read.get());
        unread.map(|(&(key, _), _)| text_of(self.r.doc.node(key))).collect()
    }

    /// Warns about the keys that were not read.
    pub(super) fn finish(&self) {
        if self.id.is_some_and(|id| !self.r.finished.borrow_mut().insert(id)) {
            return;
        }
        for (i, &(key, _)) in self.entries.iter().enumerate() {
            if !self.read[i].get() {
                let key = self.r.doc.node(key);
                let kind = ProblemKind::UnknownKey;
                self.note(Severity::Warning, kind, key.mark, text_of(key), "", "", self.may_be_for_plugins());
            }
        }
    }

    /// Plugins are given the mapping that declares them, with keys of their own.
    fn may_be_for_plugins(&self) -> &'static str {
        if self.has("plugins") {
            "its plugins may read it"
        } else {
            ""
        }
    }

    /// As [`Map::finish`] for a root, whose keys may also serve to hold anchors.
    pub(super) fn finish_root(&self) {
        for (i, &(key, value)) in self.entries.iter().enumerate() {
            let (key, value) = (self.r.doc.node(key), self.r.doc.node(value));
            if self.read[i].get() || value.anchored {
                continue;
            }
            let (kind, why) = match value.kind {
                Kind::Map(_) => (ProblemKind::IgnoredKey, "no list names it"),
                _ => (ProblemKind::UnknownKey, self.may_be_for_plugins()),
            };
            self.note(Severity::Warning, kind, key.mark, text_of(key), "", "", why);
        }
    }

    /// Key `adf version` unless it is 1.0 or absent. In other letter case, as later versions write it, it only says
    /// something about the file: what it says is reported, the file is read.
    pub(super) fn other_version(&self) -> Option<(Mark, String)> {
        for (i, &(key, value)) in self.entries.iter().enumerate() {
            let (key, value) = (text_of(self.r.doc.node(key)), self.r.doc.node(value));
            if key == VERSION_KEY || !is_version_key(key) {
                continue;
            }
            if !self.read[i].replace(true) && text_of(value) != "1.0" {
                let action = "the file is read as version 1.0";
                let (kind, found) = (ProblemKind::UnknownValue, described(value));
                self.note(Severity::Warning, kind, value.mark, key, &found, "1.0", action);
            }
        }
        let node = self.node(VERSION_KEY)?;
        (text_of(node) != "1.0").then(|| (node.mark, described(node)))
    }

    /// Warns when the file holds more than the first document.
    pub(super) fn warn_second_document(&self) {
        if let Some(mark) = self.r.doc.second {
            let kind = ProblemKind::SecondDocument;
            let note = "only the first is read";
            self.note(Severity::Warning, kind, mark, "", "", "", note);
        }
    }

    // --- problems the callers find --------------------------------------------------------------------------------

    /// Reports a value that is used all the same.
    pub(super) fn warn(&self, kind: ProblemKind, key: &str, expected: &str, action: &str) {
        let found = self.found(key);
        let place = self.place(key);
        self.note(Severity::Warning, kind, place, key, &found, expected, action);
    }

    /// Reports a value that something replaces; the element stays.
    pub(super) fn error(&self, kind: ProblemKind, key: &str, expected: &str, action: &str) {
        let found = self.found(key);
        let place = self.place(key);
        self.note(Severity::Error, kind, place, key, &found, expected, action);
    }

    /// Reports a value that drops the element being read.
    pub(super) fn reject(&self, kind: ProblemKind, key: &str, expected: &str) {
        let action = self.r.dropped();
        self.error(kind, key, expected, &action);
        self.r.spoil();
    }

    /// Reports numbers, once converted, that drop the element being read.
    pub(super) fn reject_numbers(&self, key: &str, numbers: &[f64], expected: &str) {
        let numbers: Vec<_> = numbers.iter().map(f64::to_string).collect();
        let found = format!("({})", numbers.join(", "));
        let action = self.r.dropped();
        self.note(Severity::Error, ProblemKind::OutOfRange, self.place(key), key, &found, expected, &action);
        self.r.spoil();
    }

    fn found(&self, key: &str) -> String {
        self.position(key).map_or(String::new(), |i| described(self.r.doc.node(self.entries[i].1)))
    }

    /// Reports a value that does not convert.
    fn refuse(&self, kind: ProblemKind, mark: Mark, key: &str, found: &str, expected: &str) {
        let severity = self.r.conversion.get();
        let action = match severity {
            Severity::Fatal => "the file is refused".into(),
            _ => self.r.dropped(),
        };
        self.note(severity, kind, mark, key, found, expected, &action);
        self.r.spoil();
    }

    fn wrong_type(&self, key: &str, node: &Node<'_>, expected: &str) {
        let found = described(node);
        self.refuse(ProblemKind::WrongType, node.mark, key, &found, expected);
    }

    /// Reports that a required key is missing.
    pub(super) fn missing(&self, key: &str, expected: &str) {
        self.refuse(ProblemKind::MissingKey, self.mark, key, "", expected);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clean, read, refused};
    use super::super::Model;

    #[test]
    fn duplicate_keys_first_wins() {
        let (model, problems) = read::<Model>("namespace: /a/\nnamespace: /b/\n");
        assert_eq!(model.namespace, "/a/");
        let expected = "dir/t.yaml:2:1: warning: `namespace` occurs twice; the first one is used";
        assert_eq!(problems, [expected]);
    }

    #[test]
    fn duplicate_keys_of_a_large_mapping() {
        let mut text: String = (0..100).map(|i| format!("k{i}: &a{i} 1\n")).collect();
        text.push_str("k7: 2\n");
        let (_, problems) = read::<Model>(&text);
        assert_eq!(problems.len(), 1);
        assert!(problems[0].contains(":101:1: warning: `k7` occurs twice"));
    }

    #[test]
    fn listed_elements_that_are_absent_or_null() {
        let text = "bodies: [A, B]\nsoft bodies: [C]\nghost objects: [D]\nlights: [E]\nB:\n";
        let (model, problems) = read::<Model>(text);
        assert_eq!(model.bodies.len(), 1);
        assert_eq!(model.bodies[0].common.identifier, "A");
        assert_eq!((model.bodies[0].mass, model.soft_bodies.len()), (1.0, 0));
        assert_eq!((model.ghosts.len(), model.lights.len()), (0, 1));
        let errors: Vec<_> = problems.iter().filter(|p| p.contains("error")).collect();
        assert_eq!(errors.len(), 5, "{problems:#?}");
        assert!(errors[1].contains(":1:13: error: `B` is listed but empty; the body is dropped"));
        let problems = refused::<Model>("joints: [J]\n");
        assert_eq!(problems.len(), 1);
        assert!(problems[0].contains("`J` is listed but not defined; the file is refused"));
    }

    #[test]
    fn subscripted_scalars_refuse_the_file() {
        let text = "bodies: [A]\nA: {mass: 1, damping: 0.1}\n";
        let problems = refused::<Model>(text);
        assert!(problems[0].contains("`A / damping` is `0.1`, expected a mapping"));
        let problems = refused::<Model>("bodies: [A]\nA: 3\n");
        assert_eq!(problems.len(), 1, "{problems:?}");
    }

    #[test]
    fn all_wrong_values_are_reported() {
        let text = "bodies: [A]\nA: {mass: x, restitution: 0x1, name: [1]}\nignore inter-collision: 1\n";
        assert_eq!(refused::<Model>(text).len(), 4);
    }

    #[test]
    fn a_scalar_for_a_list_is_an_empty_list() {
        let (model, problems) = read::<Model>("bodies: BODY a\n");
        assert!(model.bodies.is_empty());
        assert!(problems[0].contains("error: `bodies` is `BODY a`, expected a list"));
    }

    #[test]
    fn quoted_scalars_convert_like_plain_ones() {
        let text = "ignore inter-collision: 'True'\ngravity: {x: '1', y: \" 2e0 \", z: 0}\n";
        let model: Model = clean(text);
        assert!(model.ignore_inter_collision);
        assert_eq!(model.gravity.map(|g| g.y), Some(2.0));
    }

    #[test]
    fn anchors_are_shared_and_merge_keys_are_not_expanded() {
        let text = "g: &g {x: 1, y: 2, z: 3}\ngravity: *g\n";
        assert_eq!(clean::<Model>(text).gravity.map(|g| g.z), Some(3.0));
        let text = "m: &m {x: 1, y: 2}\ngravity: {<<: *m, z: 3}\n";
        let problems = refused::<Model>(text);
        assert!(problems[0].contains("`gravity / x` is missing"), "{problems:?}");
    }

    #[test]
    fn nulls() {
        let text = "bodies: [A]\nnamespace:\nA: {name: ~, mass: 0, location: , mesh: }\n";
        let (model, _) = read::<Model>(text);
        assert_eq!(model.namespace, "");
        assert_eq!(model.bodies[0].common.name, "null");
        assert_eq!(model.bodies[0].location, nalgebra::Isometry3::identity());
        let problems = refused::<Model>("bodies: [A]\nA: {mass: }\n");
        let expected = "t.yaml:2:9: error: `A / mass` is empty, expected a number; the file is refused";
        assert!(problems.iter().any(|p| p == expected), "{problems:?}");
    }

    #[test]
    fn root_keys_that_hold_anchors_need_no_message() {
        let text = "a: &a 1\nb: 2\nc: {d: 3}\n";
        let (_, problems) = read::<Model>(text);
        assert_eq!(problems.len(), 2);
        assert!(problems[0].contains("2:1: warning: `b` is not known"));
        assert!(problems[1].contains("3:1: warning: `c` is not used; no list names it"));
    }

    #[test]
    fn keys_beside_plugins_may_be_theirs() {
        let plugins = "plugins: [{name: p, filename: p.so}]";
        let text = format!("{plugins}\nb: 2\nbodies: [A]\nA: {{name: A, mass: 0, {plugins}, c: 1}}\n");
        let (_, problems) = read::<Model>(&text);
        for line in ["2:1: warning: `b`", "4:61: warning: `A / c`"] {
            let expected = format!("dir/t.yaml:{line} is not known; its plugins may read it");
            assert!(problems.contains(&expected), "{problems:?}");
        }
    }
}
