//! Who an object is to its clients.

use std::sync::Arc;

use crate::adf;
use crate::comm::{ObjectInfo, ObjectKind, Rates};
use crate::ids::ModelId;

/// Names and publishing rates of an object with a State and a Command.
#[derive(Debug, Clone, PartialEq)]
pub struct Identity {
    /// Name without suffix, as in children's names.
    pub name: Arc<str>,
    /// Suffix that tells copies apart; usually empty.
    pub suffix: String,
    /// Global prefix and namespace.
    pub namespace: String,
    /// Mapping key in the file.
    pub identifier: String,
    /// Prefix, namespace, mapping key and suffix: what names the object to clients, and what their commands name it by.
    pub qualified: Arc<str>,
    /// No State, no Command.
    pub passive: bool,
    /// How often it is published.
    pub rates: Rates,
    /// Its model.
    pub model: ModelId,
}

impl Identity {
    pub(super) fn new(common: &adf::Common, namespace: String, suffix: String, rates: Rates, model: ModelId) -> Self {
        Self {
            name: common.name.as_str().into(),
            qualified: format!("{namespace}{}{suffix}", common.identifier).into(),
            suffix,
            namespace,
            identifier: common.identifier.clone(),
            passive: common.passive,
            rates,
            model,
        }
    }

    /// Qualified identifier: prefix, namespace and identifier.
    pub fn key(&self) -> String {
        format!("{}{}", self.namespace, self.identifier)
    }

    /// Name with the suffix that tells copies apart: the last part of its topics.
    pub fn communication_name(&self) -> String {
        format!("{}{}", self.name, self.suffix)
    }

    /// Prefix, namespace and name with suffix: what lists of objects call it, and where its topics are.
    pub fn topic(&self) -> String {
        format!("{}{}{}", self.namespace, self.name, self.suffix)
    }

    /// The description for clients; `None` for a passive object, and where `kind` has none.
    pub(super) fn object(&self, kind: impl FnOnce() -> Option<ObjectKind>) -> Option<ObjectInfo> {
        let kind = if self.passive { None } else { kind() }?;
        Some(ObjectInfo {
            kind,
            namespace: self.namespace.clone(),
            name: self.communication_name(),
            identifier: self.key() + &self.suffix,
            rates: self.rates,
        })
    }
}
