use std::collections::BTreeMap;
use std::sync::Arc;

use super::{AnyPlugin, PluginError, PluginKind};

/// What the file name of a built-in plugin begins with.
pub(crate) const BUILTIN: &str = "builtin:";

type Make = Arc<dyn Fn(PluginKind) -> Option<AnyPlugin> + Send + Sync>;

/// Plugins that are part of the program, by name: `filename: builtin:NAME`.
#[derive(Clone, Default)]
pub struct Registry(BTreeMap<String, Make>);

impl Registry {
    /// Adds a plugin; `make` gives a new one of the kind that is wanted, `None` for a kind that it cannot be. A later
    /// one of the same name replaces an earlier one.
    pub fn add(&mut self, name: &str, make: impl Fn(PluginKind) -> Option<AnyPlugin> + Send + Sync + 'static) {
        self.0.insert(name.to_owned(), Arc::new(make));
    }

    /// Names of all, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }

    /// A new plugin.
    ///
    /// # Errors
    /// [`PluginError::Builtin`], [`PluginError::BuiltinKind`].
    pub fn make(&self, name: &str, kind: PluginKind) -> Result<AnyPlugin, PluginError> {
        self.check(name)?;
        let made = self.0.get(name).and_then(|make| make(kind)).filter(|plugin| plugin.kind() == kind);
        made.ok_or_else(|| PluginError::BuiltinKind { name: name.to_owned(), kind })
    }

    /// Whether there is a plugin of that name.
    pub(crate) fn check(&self, name: &str) -> Result<(), PluginError> {
        if self.0.contains_key(name) {
            return Ok(());
        }
        Err(PluginError::Builtin { name: name.to_owned(), known: self.names().map(str::to_owned).collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::super::{ObjectPlugin, Plugin};
    use super::*;

    struct Nothing;
    impl Plugin for Nothing {}
    impl ObjectPlugin for Nothing {}

    #[test]
    fn built_in_plugins_are_made_by_name_and_kind() {
        let mut registry = Registry::default();
        registry.add("nothing", |kind| (kind == PluginKind::Object).then(|| AnyPlugin::Object(Box::new(Nothing))));
        assert!(registry.make("nothing", PluginKind::Object).is_ok());
        let error = registry.make("nothing", PluginKind::World).err().unwrap().to_string();
        assert!(error.contains("world plugin"), "{error}");
        let error = registry.make("other", PluginKind::World).err().unwrap().to_string();
        assert!(error.contains("`other`") && error.contains("nothing"), "{error}");
    }
}
