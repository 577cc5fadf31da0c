//! How objects are named and found.

mod parts;

use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap};
use std::fmt;

use parts::{Holding, Parts};

/// Objects of one type, with ids `I`, by qualified identifier, in lexicographic order.
#[derive(Debug, Clone)]
pub struct NameMap<I> {
    objects: BTreeMap<String, I>,
    /// The keys by what is part of them; made when a text that is no key is looked up.
    parts: RefCell<Option<Parts>>,
    /// For names of which there are copies, a suffix below which none is free.
    least_free: HashMap<String, u32>,
}

impl<I> Default for NameMap<I> {
    fn default() -> Self {
        Self { objects: BTreeMap::new(), parts: RefCell::default(), least_free: HashMap::new() }
    }
}

/// What a look-up gave.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Found<I> {
    /// The key is exactly the text.
    Exact(I),
    /// The text is part of this one key only.
    Part(I, String),
    /// No key holds the text.
    Nothing,
    /// Several keys hold the text.
    Ambiguous(Vec<String>),
}

impl<I: Copy> Found<I> {
    /// The object, if there is exactly one.
    pub fn id(&self) -> Option<I> {
        match self {
            Self::Exact(id) | Self::Part(id, _) => Some(*id),
            Self::Nothing | Self::Ambiguous(_) => None,
        }
    }
}

impl<I> fmt::Display for Found<I> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exact(_) => write!(f, "found"),
            Self::Part(_, key) => write!(f, "taken for part of `{key}`"),
            Self::Nothing => write!(f, "not found"),
            Self::Ambiguous(keys) => write!(f, "part of several: `{}`", keys.join("`, `")),
        }
    }
}

/// Suffixes that are tried to make a name unique.
const MAX_SUFFIX: u32 = 100;
/// Keys that are named where several hold a text.
const MAX_AMBIGUOUS: usize = 5;

impl<I: Copy> NameMap<I> {
    /// The suffix that makes `key` free: empty, or the first of 1, 2, … 100.
    pub fn free_suffix(&self, key: &str) -> String {
        if !self.objects.contains_key(key) {
            return String::new();
        }
        let least = self.least_free.get(key).copied().unwrap_or(1);
        (least..MAX_SUFFIX)
            .map(|n| n.to_string())
            .find(|suffix| !self.objects.contains_key(&format!("{key}{suffix}")))
            .unwrap_or_else(|| MAX_SUFFIX.to_string())
    }

    /// Enters an object under `key` and the first free suffix.
    pub fn insert(&mut self, key: &str, id: I) {
        let suffix = self.free_suffix(key);
        let name = format!("{key}{suffix}");
        if let Ok(taken) = suffix.parse() {
            self.least_free.insert(key.to_owned(), taken);
        }
        let is_new = !self.objects.contains_key(&name);
        if let Some(parts) = self.parts.get_mut().as_mut().filter(|_| is_new) {
            parts.add(&name);
        }
        self.objects.insert(name, id);
    }

    /// The object whose key is exactly `text`.
    pub fn exact(&self, text: &str) -> Option<I> {
        self.objects.get(text).copied()
    }

    /// The object that [`find`](Self::find) finds, without saying how.
    pub fn id(&self, text: &str) -> Option<I> {
        self.find(text).id()
    }

    /// Forgets the objects for which `gone` is true.
    pub fn remove(&mut self, gone: impl Fn(I) -> bool) {
        self.objects.retain(|_, id| !gone(*id));
        self.parts = RefCell::default();
        self.least_free.clear();
    }

    /// The object whose key is `text`, else the only one whose key holds `text`.
    pub fn find(&self, text: &str) -> Found<I> {
        if let Some(id) = self.exact(text) {
            return Found::Exact(id);
        }
        let mut parts = self.parts.borrow_mut();
        let parts = parts.get_or_insert_with(|| {
            let mut parts = Parts::default();
            self.objects.keys().for_each(|key| parts.add(key));
            parts
        });
        match parts.holding(text) {
            Holding::Nothing => Found::Nothing,
            Holding::One(key) => self.exact(&key).map_or(Found::Nothing, |id| Found::Part(id, key)),
            // A few are enough to see what went wrong.
            Holding::Several(keys) => Found::Ambiguous(keys.into_iter().take(MAX_AMBIGUOUS).collect()),
        }
    }

    /// Keys in lexicographic order.
    pub fn keys(&self) -> impl Iterator<Item = &str> {
        self.objects.keys().map(String::as_str)
    }

    /// Keys and objects in lexicographic order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, I)> {
        self.objects.iter().map(|(key, &id)| (key.as_str(), id))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_get_the_first_free_suffix() {
        let mut map = NameMap::default();
        for index in 0..3 {
            map.insert("/env/BODY a", index);
        }
        let keys: Vec<_> = map.iter().collect();
        assert_eq!(keys, [("/env/BODY a", 0), ("/env/BODY a1", 1), ("/env/BODY a2", 2)]);
        assert_eq!(map.free_suffix("/env/BODY b"), "");
    }

    #[test]
    fn a_part_of_a_name_is_enough_if_it_is_the_only_one() {
        let mut map = NameMap::default();
        map.insert("/env/BODY link1", 0);
        map.insert("/env/BODY link10", 1);
        map.insert("/env/BODY base", 2);
        assert_eq!(map.find("/env/BODY link1"), Found::Exact(0));
        assert_eq!(map.find("BODY base").id(), Some(2));
        for text in ["/env/BODY link1", "BODY base", "BODY link1", "BODY tip"] {
            assert_eq!(map.id(text), map.find(text).id(), "{text}");
        }
        assert_eq!(map.find("BODY link1").id(), None);
        assert_eq!(map.find("BODY tip"), Found::Nothing);
    }
}
