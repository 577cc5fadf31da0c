//! Typed getters of a [`Map`].

use std::borrow::Cow;

use super::{described, text_of, Absent, Map, Range};
use crate::adf::report::{ProblemKind, Severity};
use crate::adf::scalar;
use crate::adf::yaml::{Kind, Mark, NodeId};

/// Elements or mappings that a list may hold. An entry of three bytes can stand for an element of a kilobyte.
const MAX_ELEMENTS: usize = 100_000;

/// Numbers of a short mapping or list: those of a 4×4 matrix.
const MAX_NUMBERS: usize = 16;

impl<'m> Map<'m> {
    fn scalar<T>(&self, key: &str, expected: &str, convert: impl FnOnce(&str) -> Option<T>) -> Option<T> {
        let node = self.node(key)?;
        let value = match &node.kind {
            Kind::Scalar(text) => convert(text),
            _ => None,
        };
        if value.is_none() {
            self.wrong_type(key, node, expected);
        }
        value
    }

    pub(in crate::adf) fn boolean(&self, key: &str) -> Option<bool> {
        self.scalar(key, "true or false", scalar::boolean)
    }

    /// As [`Map::boolean`]; 0 and 1 count too.
    pub(in crate::adf) fn boolean_or_digit(&self, key: &str) -> Option<bool> {
        self.scalar(key, "true, false, 0 or 1", |text| match text {
            "0" => Some(false),
            "1" => Some(true),
            _ => scalar::boolean(text),
        })
    }

    /// A number that may be infinite or no number.
    pub(in crate::adf) fn any_real(&self, key: &str) -> Option<f64> {
        self.scalar(key, "a number", scalar::real)
    }

    /// A finite number within a range; another one drops the element being read.
    pub(in crate::adf) fn real_in(&self, key: &str, range: Range) -> Option<f64> {
        let value = self.any_real(key)?;
        let kind = if !value.is_finite() {
            ProblemKind::NonFinite
        } else if !range.holds(value) {
            ProblemKind::OutOfRange
        } else {
            return Some(value);
        };
        self.reject(kind, key, range.words());
        None
    }

    pub(in crate::adf) fn real(&self, key: &str) -> Option<f64> {
        self.real_in(key, Range::Any)
    }

    /// A required number; 0 after a problem.
    pub(in crate::adf) fn need_real_in(&self, key: &str, range: Range) -> f64 {
        if !self.has(key) {
            self.missing(key, range.words());
        }
        self.real_in(key, range).unwrap_or(0.0)
    }

    pub(in crate::adf) fn need_real(&self, key: &str) -> f64 {
        self.need_real_in(key, Range::Any)
    }

    pub(in crate::adf) fn int(&self, key: &str) -> Option<i32> {
        self.scalar(key, "an integer", |text| scalar::integer(text)?.try_into().ok())
    }

    pub(in crate::adf) fn uint(&self, key: &str) -> Option<u32> {
        self.scalar(key, "an integer, at least 0", |text| scalar::integer(text)?.try_into().ok())
    }

    pub(in crate::adf) fn need_uint(&self, key: &str) -> u32 {
        if !self.has(key) {
            self.missing(key, "an integer, at least 0");
        }
        self.uint(key).unwrap_or(0)
    }

    /// A text; a null value is the text `null`.
    pub(in crate::adf) fn string(&self, key: &str) -> Option<String> {
        let node = self.node(key)?;
        match &node.kind {
            Kind::Scalar(_) | Kind::Null => {
                let text = text_of(node);
                self.r.spend_text(text).then(|| text.to_owned())
            }
            _ => {
                self.wrong_type(key, node, "a text");
                None
            }
        }
    }

    pub(in crate::adf) fn need_string(&self, key: &str) -> String {
        if !self.has(key) {
            self.missing(key, "a text");
        }
        self.string(key).unwrap_or_default()
    }

    /// A text that is not empty; null counts as absent.
    pub(in crate::adf) fn filled(&self, key: &str) -> Option<String> {
        if self.is_null(key) {
            return None;
        }
        self.string(key).filter(|s| !s.is_empty())
    }

    /// False when the key is absent, null or an empty text.
    pub(in crate::adf) fn is_filled(&self, key: &str) -> bool {
        self.node(key).is_some_and(|node| match &node.kind {
            Kind::Null => false,
            Kind::Scalar(text) => !text.is_empty(),
            Kind::List(_) | Kind::Map(_) => true,
        })
    }

    /// Finite numbers by name, of a mapping that holds nothing else; of a list, or a list of lists, without names.
    /// `None`, unreported, for anything else and for more than [`MAX_NUMBERS`].
    pub(in crate::adf) fn numbers(&self, key: &str) -> Option<Vec<(&'m str, f64)>> {
        let number = |id: NodeId| match &self.r.doc.node(id).kind {
            Kind::Scalar(text) => scalar::real(text).filter(|number| number.is_finite()),
            _ => None,
        };
        let named = |name, id| number(id).map(|number| (name, number));
        match &self.node(key)?.kind {
            Kind::Map(entries) if entries.len() <= MAX_NUMBERS => {
                entries.iter().map(|&(name, id)| named(text_of(self.r.doc.node(name)), id)).collect()
            }
            Kind::List(items) if items.len() <= MAX_NUMBERS => {
                let mut numbers = Vec::new();
                for &id in items {
                    match &self.r.doc.node(id).kind {
                        Kind::List(row) if row.len() <= MAX_NUMBERS => {
                            numbers.extend(row.iter().map(|&id| named("", id)).collect::<Option<Vec<_>>>()?);
                        }
                        _ => numbers.push(named("", id)?),
                    }
                }
                (numbers.len() <= MAX_NUMBERS).then_some(numbers)
            }
            _ => None,
        }
    }

    // --- collections ----------------------------------------------------------------------------------------------

    fn view(&'m self, key: Cow<'m, str>, mark: Mark, id: NodeId) -> Map<'m> {
        let node = self.r.doc.node(id);
        let entries: &[(NodeId, NodeId)] = match &node.kind {
            Kind::Map(entries) => entries,
            Kind::Null => &[],
            Kind::Scalar(_) => {
                self.wrong_type(&key, node, "a mapping");
                &[]
            }
            Kind::List(_) => {
                let (found, what) = (described(node), ProblemKind::WrongType);
                let action = "it counts as empty";
                self.note(Severity::Error, what, node.mark, &key, &found, "a mapping", action);
                &[]
            }
        };
        Map::new(self.r, Some(self), key, mark, Some(id), entries)
    }

    /// A mapping that need not be there.
    pub(in crate::adf) fn map_opt(&'m self, key: &'m str) -> Option<Map<'m>> {
        let (mark, id) = self.entry(key)?;
        Some(self.view(key.into(), mark, id))
    }

    /// A mapping; empty when it is absent.
    pub(in crate::adf) fn map(&'m self, key: &'m str) -> Map<'m> {
        self.map_opt(key).unwrap_or_else(|| Map::new(self.r, Some(self), key.into(), self.mark, None, &[]))
    }

    /// Keys, texts and places of a mapping that holds nothing but scalars; empty when it is absent.
    pub(in crate::adf) fn scalars(&'m self, key: &'m str) -> Vec<(&'m str, &'m str, Mark)> {
        let map = self.map(key);
        let mut scalars = Vec::new();
        for (i, &(name, value)) in map.entries.iter().enumerate() {
            let (name, value) = (text_of(self.r.doc.node(name)), self.r.doc.node(value));
            if map.read[i].replace(true) {
                continue; // it occurs twice, which has been said
            }
            match &value.kind {
                Kind::Scalar(text) if self.r.spend_text(text) => scalars.push((name, text.as_ref(), value.mark)),
                Kind::Scalar(_) => {}
                Kind::Null => scalars.push((name, "", value.mark)),
                _ => map.wrong_type(name, value, "a text or a number"),
            }
        }
        scalars
    }

    fn items(&self, key: &str) -> &'m [NodeId] {
        let Some(node) = self.node(key) else {
            return &[];
        };
        match &node.kind {
            Kind::List(items) if self.r.spend(items.len()) => items,
            Kind::List(_) | Kind::Null => &[],
            Kind::Scalar(_) => {
                let action = "it counts as an empty list";
                self.error(ProblemKind::WrongType, key, "a list", action);
                &[]
            }
            Kind::Map(entries) => {
                if !entries.is_empty() {
                    self.wrong_type(key, node, "a list");
                }
                &[]
            }
        }
    }

    /// The items of a list that stand for elements.
    fn elements_of(&self, key: &str) -> &'m [NodeId] {
        let items = self.items(key);
        if items.len() <= MAX_ELEMENTS {
            return items;
        }
        let expected = format!("at most {MAX_ELEMENTS} of them");
        self.refuse(ProblemKind::OutOfRange, self.place(key), key, &self.found(key), &expected);
        &[]
    }

    /// The mappings of a list.
    pub(in crate::adf) fn maps(&'m self, key: &'m str) -> Vec<Map<'m>> {
        let view = |(i, &id): (usize, &NodeId)| {
            let mark = self.r.doc.node(id).mark;
            self.view(format!("{key}[{i}]").into(), mark, id)
        };
        self.elements_of(key).iter().enumerate().map(view).collect()
    }

    /// The texts of a list.
    pub(in crate::adf) fn strings(&self, key: &str) -> Vec<(&'m str, Mark)> {
        let mut texts = Vec::new();
        for &id in self.elements_of(key) {
            let node = self.r.doc.node(id);
            match node.kind {
                Kind::Scalar(_) | Kind::Null => {
                    let text = text_of(node);
                    if self.r.spend_text(text) {
                        texts.push((text, node.mark));
                    }
                }
                _ => self.wrong_type(key, node, "a list of texts"),
            }
        }
        texts
    }

    /// The integers of a list.
    pub(in crate::adf) fn ints(&self, key: &str) -> Vec<i64> {
        let mut values = Vec::new();
        for &id in self.items(key) {
            let node = self.r.doc.node(id);
            let value = match &node.kind {
                Kind::Scalar(text) => scalar::integer(text).filter(|i| i32::try_from(*i).is_ok()),
                _ => None,
            };
            match value {
                Some(value) => values.push(value),
                None => self.wrong_type(key, node, "a list of integers"),
            }
        }
        values
    }

    /// Reads the elements named by the list `list`.
    pub(in crate::adf) fn elements<T>(
        &'m self,
        list: &str,
        noun: &'static str,
        absent: Absent,
        read: impl Fn(&Map<'_>) -> Option<T>,
    ) -> Vec<T> {
        let elements = self.elements_in_place(list, noun, absent, read);
        elements.into_iter().flatten().collect()
    }

    /// As [`Map::elements`]; dropped elements leave a gap.
    pub(in crate::adf) fn elements_in_place<T>(
        &'m self,
        list: &str,
        noun: &'static str,
        absent: Absent,
        read: impl Fn(&Map<'_>) -> Option<T>,
    ) -> Vec<Option<T>> {
        let element = |(identifier, place): (&'m str, Mark)| match self.entry(identifier) {
            Some((_, id)) if matches!(self.r.doc.node(id).kind, Kind::Null) => {
                let kind = ProblemKind::EmptyElement;
                let note = format!("the {noun} is dropped");
                self.note(Severity::Error, kind, place, identifier, "", "", &note);
                None
            }
            Some((mark, id)) => self.r.element(noun, || {
                let map = self.view(identifier.into(), mark, id);
                let usable = !self.r.spoiled.get();
                usable.then(|| read(&map)).flatten()
            }),
            None => {
                let (severity, note) = match absent {
                    Absent::Made(note) => (Severity::Error, note.to_owned()),
                    Absent::Dropped => (Severity::Error, format!("the {noun} is dropped")),
                    Absent::Refused => (Severity::Fatal, "the file is refused".to_owned()),
                };
                let kind = ProblemKind::MissingElement;
                self.note(severity, kind, place, identifier, "", "", &note);
                let made = matches!(absent, Absent::Made(_));
                let empty = Map::new(self.r, Some(self), identifier.into(), place, None, &[]);
                made.then(|| self.r.element(noun, || read(&empty))).flatten()
            }
        };
        self.strings(list).into_iter().map(element).collect()
    }
}
