//! Names of topics and parameters.

use std::collections::HashMap;

use ambf_core::comm::ObjectInfo;

use crate::report;

/// A legal absolute ROS graph name made from `parts`: a leading slash, one slash between components, none at the end,
/// and `_` in place of every character that ROS does not allow. True when a character had to be replaced.
pub fn graph_name(parts: &[&str]) -> (String, bool) {
    let mut name = String::new();
    let mut replaced = false;
    for component in parts.iter().flat_map(|part| part.split('/')).filter(|c| !c.is_empty()) {
        name.push('/');
        for c in component.chars() {
            let legal = c.is_ascii_alphanumeric() || c == '_';
            replaced |= !legal;
            name.push(if legal { c } else { '_' });
        }
    }
    if name.is_empty() {
        name.push('/');
    }
    (name, replaced)
}

/// Names in use: the part that all topics and parameters of an object share, `/<namespace>/<name>`.
#[derive(Debug, Default)]
pub struct Names {
    /// Identifiers of the objects that have each name.
    users: HashMap<String, Vec<String>>,
}

impl Names {
    /// The name of `object`.
    ///
    /// Replaced characters and objects that share one name are reported. Sharing is harmless: both publish on the one
    /// topic, and a command reaches both.
    pub fn take(&mut self, object: &ObjectInfo) -> String {
        // An object without a name still gets a topic of its own level, not one that swallows the namespace.
        let own = if object.name.is_empty() { "_" } else { &object.name };
        let (name, replaced) = graph_name(&[&object.namespace, own]);
        if replaced {
            report!(
                "ROS: \"{}/{}\" holds characters that a topic name may not hold; it is published as {name}",
                object.namespace.trim_end_matches('/'),
                object.name
            );
        }
        let users = self.users.entry(name.clone()).or_default();
        if let Some(other) = users.first() {
            report!(
                "ROS: \"{}\" and \"{other}\" share the topics {name}/State and {name}/Command; rename one of them to tell them apart",
                object.identifier
            );
        }
        users.push(object.identifier.clone());
        name
    }

    /// Says that `object` no longer uses `name`.
    pub fn give_back(&mut self, name: &str, object: &ObjectInfo) {
        let Some(users) = self.users.get_mut(name) else { return };
        if let Some(user) = users.iter().position(|user| *user == object.identifier) {
            users.remove(user);
        }
        if users.is_empty() {
            self.users.remove(name);
        }
    }
}

/// [`Names::take`] for each of `objects`, in the same order.
pub fn object_names<'o>(objects: impl IntoIterator<Item = &'o ObjectInfo>) -> Vec<String> {
    let mut names = Names::default();
    objects.into_iter().map(|object| names.take(object)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_core::comm::{ObjectKind, Rates};

    fn object(namespace: &str, name: &str) -> ObjectInfo {
        ObjectInfo {
            kind: ObjectKind::World,
            namespace: namespace.into(),
            name: name.into(),
            identifier: format!("{namespace}BODY {name}"),
            rates: Rates::default(),
        }
    }

    #[test]
    fn slashes_collapse_and_illegal_characters_become_underscores() {
        let name = |parts: &[&str]| graph_name(parts);
        assert_eq!(name(&["/ambf/env/", "psm/baselink", "State"]), ("/ambf/env/psm/baselink/State".into(), false));
        assert_eq!(name(&["//sim1//ambf/env//", "/World/", "Command"]).0, "/sim1/ambf/env/World/Command");
        assert_eq!(name(&["ambf", "1box"]), ("/ambf/1box".into(), false));
        assert_eq!(name(&["/a", "tool-link.é b"]), ("/a/tool_link___b".into(), true));
        assert_eq!(name(&["", "/"]), ("/".into(), false));
    }

    #[test]
    fn shared_names_are_kept() {
        let names = object_names(&[object("/e/", "a-b"), object("/e", "a_b"), object("/e/", "")]);
        assert_eq!(names, ["/e/a_b", "/e/a_b", "/e/_"]);
    }

    #[test]
    fn a_name_that_was_given_back_is_free() {
        let (mut names, a, b) = (Names::default(), object("/e/", "a-b"), object("/e/", "a_b"));
        let name = names.take(&a);
        assert_eq!(names.take(&b), name);
        names.give_back(&name, &a);
        assert!(names.users[&name].iter().eq([&b.identifier]), "the other still has it");
        names.give_back(&name, &b);
        names.give_back(&name, &b);
        assert!(names.users.is_empty());
    }
}
