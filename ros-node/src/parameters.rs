//! The parameters of a master: a tree of values with names such as `/robot/arm/gain`.

use std::collections::BTreeMap;

use dxr::Value;

/// Longest name, parts. Trees are written and freed by functions that call themselves for each level.
const MAX_PARTS: usize = 32;

/// All parameters. A structure that is set is a part of the tree, and a part of the tree is read as a structure.
#[derive(Debug, Default)]
pub(crate) struct Tree(BTreeMap<String, Value>);

/// The parts of a full name.
fn parts(name: &str) -> Vec<&str> {
    name.split('/').filter(|part| !part.is_empty()).collect()
}

/// The full name that `name` stands for in a call by `caller`: names without a slash are beside the caller, those with a
/// tilde below it.
pub(crate) fn resolve(name: &str, caller: &str) -> String {
    let full = match name.strip_prefix('~') {
        Some(rest) => format!("{caller}/{rest}"),
        None if name.starts_with('/') => name.to_owned(),
        None => format!("{}/{name}", parent_of(caller)),
    };
    format!("/{}", parts(&full).join("/"))
}

/// The namespace of a full name.
pub(crate) fn parent_of(name: &str) -> &str {
    match name.trim_end_matches('/').rsplit_once('/') {
        Some(("", _)) | None => "/",
        Some((parent, _)) => parent,
    }
}

impl Tree {
    /// The parameter or part of the tree called `name`.
    pub fn get(&self, name: &str) -> Option<Value> {
        let parts = parts(name);
        let Some((last, path)) = parts.split_last() else { return Some(Value::Struct(self.0.clone())) };
        let mut level = &self.0;
        for part in path {
            level = match level.get(*part)? {
                Value::Struct(inner) => inner,
                _ => return None,
            };
        }
        level.get(*last).cloned()
    }

    /// Sets it, in place of what was there; whether that is possible: the whole tree can only be a structure, and a name
    /// has [`MAX_PARTS`] at most.
    pub fn set(&mut self, name: &str, value: Value) -> bool {
        let parts = parts(name);
        if parts.len() > MAX_PARTS {
            return false;
        }
        let Some((last, path)) = parts.split_last() else {
            let Value::Struct(all) = value else { return false };
            self.0 = all;
            return true;
        };
        let mut level = &mut self.0;
        for part in path {
            let next = level.entry((*part).to_owned()).or_insert_with(|| Value::Struct(BTreeMap::new()));
            if !matches!(next, Value::Struct(_)) {
                *next = Value::Struct(BTreeMap::new());
            }
            let Value::Struct(inner) = next else { return false };
            level = inner;
        }
        level.insert((*last).to_owned(), value);
        true
    }

    /// Removes it; whether it was there.
    pub fn remove(&mut self, name: &str) -> bool {
        let parts = parts(name);
        let Some((last, path)) = parts.split_last() else {
            self.0.clear();
            return true;
        };
        let mut level = &mut self.0;
        for part in path {
            let Some(Value::Struct(inner)) = level.get_mut(*part) else { return false };
            level = inner;
        }
        level.remove(*last).is_some()
    }

    /// Full names of all that are no structures, in order.
    pub fn names(&self) -> Vec<String> {
        let mut names = Vec::new();
        // A list instead of calls: a tree may be deep.
        let mut open: Vec<(String, &BTreeMap<String, Value>)> = vec![(String::new(), &self.0)];
        while let Some((prefix, level)) = open.pop() {
            for (key, value) in level {
                let name = format!("{prefix}/{key}");
                match value {
                    Value::Struct(inner) => open.push((name, inner)),
                    _ => names.push(name),
                }
            }
        }
        names.sort_unstable();
        names
    }
}
