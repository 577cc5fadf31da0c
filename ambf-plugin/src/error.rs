use std::path::PathBuf;

use ambf_model::files::{look, Found};
use thiserror::Error;

use super::PluginKind;

/// Why a plugin is left out: which step failed, and why. The simulation goes on without it.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum PluginError {
    /// Error when there is no such file.
    #[error("no such library: looked for {}{}", Listed(.tried), .loader.as_ref().map(|why| format!(" and in the system's folders ({why})")).unwrap_or_default())]
    NotFound {
        /// Files that would have been taken.
        tried: Vec<PathBuf>,
        /// What the dynamic loader said to the bare name.
        loader: Option<String>,
    },
    /// Error for a plugin of the C++ program.
    #[error("it is a compiled plugin of the C++ program, which cannot be loaded: {advice}")]
    Cpp {
        /// What to do instead.
        advice: String,
    },
    /// Error when the dynamic loader refuses the file.
    #[error("the dynamic loader cannot open it: {why}")]
    Open {
        /// Library.
        file: PathBuf,
        /// What the loader says.
        why: String,
    },
    /// Error when the library lacks a function.
    #[error("{} is no plugin: it has no function `{symbol}`", file.display())]
    Symbol {
        /// Library.
        file: PathBuf,
        /// Function.
        symbol: String,
    },
    /// Error when the library was made for another version of the interface.
    #[error("{} was made for version {found} of the plugin interface, this program has version {expected}: build it again", file.display())]
    Version {
        /// Library.
        file: PathBuf,
        /// Its version.
        found: u32,
        /// Ours.
        expected: u32,
    },
    /// Error when the library makes no plugin of the kind that is wanted.
    #[error("{} made no {} plugin{}", file.display(), kind.words(), Said(.said))]
    Nothing {
        /// Library.
        file: PathBuf,
        /// What was wanted.
        kind: PluginKind,
        /// What the library said.
        said: String,
    },
    /// Error when the library makes no driver.
    #[error("{} made no driver of input devices{}", file.display(), Said(.said))]
    NoDriver {
        /// Library.
        file: PathBuf,
        /// What the library said.
        said: String,
    },
    /// Error when no built-in plugin has the name.
    #[error("there is no built-in plugin `{name}`; there is {}", if known.is_empty() { "none".to_owned() } else { known.join(", ") })]
    Builtin {
        /// Name.
        name: String,
        /// What there is.
        known: Vec<String>,
    },
    /// Error when a built-in plugin is of another kind.
    #[error("the built-in plugin `{name}` cannot be a {} plugin", kind.words())]
    BuiltinKind {
        /// Name.
        name: String,
        /// What was wanted.
        kind: PluginKind,
    },
    /// Error when the plugin itself says that it cannot work.
    #[error("it cannot start: {0}")]
    Init(String),
    /// Error when it panicked while it started.
    #[error("it panicked at its start: {0}")]
    Panicked(String),
}

impl PluginError {
    /// What a plugin's `init` says when it cannot work.
    pub fn init(why: impl Into<String>) -> Self {
        Self::Init(why.into())
    }
}

impl From<String> for PluginError {
    fn from(why: String) -> Self {
        Self::Init(why)
    }
}

impl From<&str> for PluginError {
    fn from(why: &str) -> Self {
        Self::Init(why.to_owned())
    }
}

struct Listed<'a>(&'a [PathBuf]);

impl std::fmt::Display for Listed<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (i, path) in self.0.iter().enumerate() {
            write!(f, "{}{}", if i > 0 { ", " } else { "" }, path.display())?;
            if let Found::Other(kind) = look(path) {
                write!(f, " (which is {kind})")?;
            }
        }
        Ok(())
    }
}

struct Said<'a>(&'a str);

impl std::fmt::Display for Said<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.0.is_empty() {
            Ok(())
        } else {
            write!(f, ": {}", self.0)
        }
    }
}
