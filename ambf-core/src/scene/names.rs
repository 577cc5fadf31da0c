//! How objects are named and found.

use std::collections::BTreeMap;
use std::fmt;

/// Objects of one type by qualified identifier, in lexicographic order.
#[derive(Debug, Clone, Default)]
pub struct NameMap(BTreeMap<String, usize>);

/// What a look-up gave.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Found {
    /// The key is exactly the text.
    Exact(usize),
    /// The text is part of this one key only.
    Part(usize, String),
    /// No key holds the text.
    Nothing,
    /// Several keys hold the text.
    Ambiguous(Vec<String>),
}

impl Found {
    /// The object, if there is exactly one.
    pub fn index(&self) -> Option<usize> {
        match self {
            Self::Exact(index) | Self::Part(index, _) => Some(*index),
            Self::Nothing | Self::Ambiguous(_) => None,
        }
    }
}

impl fmt::Display for Found {
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

impl NameMap {
    /// The suffix that makes `key` free: empty, or the first of 1, 2, … 100.
    pub fn free_suffix(&self, key: &str) -> String {
        if !self.0.contains_key(key) {
            return String::new();
        }
        (1..=MAX_SUFFIX)
            .map(|n| n.to_string())
            .find(|suffix| !self.0.contains_key(&format!("{key}{suffix}")))
            .unwrap_or_else(|| MAX_SUFFIX.to_string())
    }

    /// Enters an object under `key` and the first free suffix.
    pub fn insert(&mut self, key: &str, index: usize) {
        let suffix = self.free_suffix(key);
        self.0.insert(format!("{key}{suffix}"), index);
    }

    /// The object whose key is exactly `text`.
    pub fn exact(&self, text: &str) -> Option<usize> {
        self.0.get(text).copied()
    }

    /// The object that [`find`](Self::find) finds, without saying how.
    pub fn index(&self, text: &str) -> Option<usize> {
        self.exact(text).or_else(|| {
            let mut holding = self.0.iter().filter(|(key, _)| key.contains(text));
            let first = holding.next()?;
            holding.next().is_none().then_some(*first.1)
        })
    }

    /// Forgets the objects for which `gone` is true.
    pub fn remove(&mut self, gone: impl Fn(usize) -> bool) {
        self.0.retain(|_, index| !gone(*index));
    }

    /// The object whose key is `text`, else the only one whose key holds `text`.
    pub fn find(&self, text: &str) -> Found {
        if let Some(index) = self.exact(text) {
            return Found::Exact(index);
        }
        let mut holding = self.0.iter().filter(|(key, _)| key.contains(text));
        match (holding.next(), holding.next()) {
            (None, _) => Found::Nothing,
            (Some((key, &index)), None) => Found::Part(index, key.clone()),
            (Some((first, _)), Some((second, _))) => {
                // A few are enough to see what went wrong.
                let rest = holding.take(3).map(|(key, _)| key);
                Found::Ambiguous([first, second].into_iter().chain(rest).cloned().collect())
            }
        }
    }

    /// Keys and objects in lexicographic order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, usize)> {
        self.0.iter().map(|(key, &index)| (key.as_str(), index))
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
        assert_eq!(map.find("BODY base").index(), Some(2));
        for text in ["/env/BODY link1", "BODY base", "BODY link1", "BODY tip"] {
            assert_eq!(map.index(text), map.find(text).index(), "{text}");
        }
        assert_eq!(map.find("BODY link1").index(), None);
        assert_eq!(map.find("BODY tip"), Found::Nothing);
    }
}
