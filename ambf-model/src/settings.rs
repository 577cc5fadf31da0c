//! Settings of drivers of input devices, as a device file has them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// A setting as written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setting {
    /// Text of the value.
    pub value: String,
    /// `file:line`.
    pub place: String,
}

/// Error when a setting of a device file is of no use.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{place}: `{key}` is `{value}`, expected {expected}")]
pub struct SettingError {
    /// `file:line`.
    pub place: String,
    /// Key.
    pub key: String,
    /// Value as written.
    pub value: String,
    /// What would have been right.
    pub expected: String,
}

/// Settings of a driver: `driver settings` of an entry in a device file, keys and texts as written. Each driver reads
/// its own and ends with [`Settings::unknown`].
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Settings {
    entries: BTreeMap<String, Setting>,
    directory: PathBuf,
}

impl Settings {
    /// Settings of a file in `directory`, to which relative paths belong.
    pub fn new(entries: BTreeMap<String, Setting>, directory: PathBuf) -> Self {
        Self { entries, directory }
    }

    /// Keys and settings, sorted by key.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Setting)> {
        self.entries.iter().map(|(key, setting)| (key.as_str(), setting))
    }

    /// Directory to which relative paths belong.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// Text of `key`.
    pub fn text(&self, key: &str) -> Option<&str> {
        self.entries.get(key).map(|setting| setting.value.as_str())
    }

    /// Value of `key` in a type that is read from text: numbers.
    ///
    /// # Errors
    /// [`SettingError`] for a text that is none.
    pub fn parsed<T: std::str::FromStr>(&self, key: &str, expected: &str) -> Result<Option<T>, SettingError> {
        let Some(text) = self.text(key) else { return Ok(None) };
        text.trim().parse().map(Some).map_err(|_| self.wrong(key, expected))
    }

    /// Truth value of `key`: `true`, `false`, `1`, `0`, `yes`, `no`, `on`, `off`.
    ///
    /// # Errors
    /// [`SettingError`] for another text.
    pub fn boolean(&self, key: &str) -> Result<Option<bool>, SettingError> {
        let Some(text) = self.text(key) else { return Ok(None) };
        match text.trim().to_ascii_lowercase().as_str() {
            "true" | "1" | "yes" | "on" => Ok(Some(true)),
            "false" | "0" | "no" | "off" => Ok(Some(false)),
            _ => Err(self.wrong(key, "true or false")),
        }
    }

    /// Path of `key`; relative ones belong to the directory of the file.
    pub fn path(&self, key: &str) -> Option<PathBuf> {
        self.text(key).map(|text| self.directory.join(Path::new(text)))
    }

    /// The error for a value of `key` that is not what was `expected`.
    pub fn wrong(&self, key: &str, expected: &str) -> SettingError {
        let setting = self.entries.get(key);
        SettingError {
            place: setting.map_or_else(String::new, |setting| setting.place.clone()),
            key: key.to_owned(),
            value: setting.map_or_else(String::new, |setting| setting.value.clone()),
            expected: expected.to_owned(),
        }
    }

    /// The error for the first key that is not among `known`.
    ///
    /// # Errors
    /// [`SettingError`].
    pub fn unknown(&self, known: &[&str]) -> Result<(), SettingError> {
        match self.entries.keys().find(|key| !known.contains(&key.as_str())) {
            Some(key) => Err(self.wrong(key, &format!("one of the keys {}", known.join(", ")))),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> Settings {
        let setting = |value: &str, line| Setting { value: value.into(), place: format!("devices.yaml:{line}") };
        let entries = [("rate", "250", 3), ("home", "Yes", 4), ("firmware", "falcon.bin", 5)];
        Settings::new(entries.map(|(k, v, l)| (k.to_owned(), setting(v, l))).into(), PathBuf::from("dir"))
    }

    #[test]
    fn values_have_types() {
        let settings = settings();
        assert_eq!(settings.parsed::<f64>("rate", "a number").unwrap(), Some(250.0));
        assert_eq!(settings.boolean("home").unwrap(), Some(true));
        assert_eq!(settings.path("firmware"), Some(PathBuf::from("dir/falcon.bin")));
        assert_eq!(settings.boolean("absent").unwrap(), None);
    }

    #[test]
    fn errors_say_where() {
        let settings = settings();
        let error = settings.boolean("rate").unwrap_err().to_string();
        assert_eq!(error, "devices.yaml:3: `rate` is `250`, expected true or false");
        let error = settings.unknown(&["rate", "home"]).unwrap_err().to_string();
        assert!(error.starts_with("devices.yaml:5: `firmware`") && error.contains("rate, home"), "{error}");
        assert!(settings.unknown(&["firmware", "home", "rate"]).is_ok());
    }
}
