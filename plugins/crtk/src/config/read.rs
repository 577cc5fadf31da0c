//! A mapping of a file with getters that say what is wrong.

use ambf_model::adf::Entry;

use super::ConfigError;

/// A mapping.
#[derive(Clone, Copy)]
pub(super) struct Map<'o>(Entry<'o>);

impl<'o> Map<'o> {
    pub fn new(entry: Entry<'o>) -> Self {
        Self(entry)
    }

    pub fn get(&self, key: &str) -> Option<Entry<'o>> {
        self.0.get(key)
    }

    /// The value of a key as it is written, for messages.
    fn shown(entry: Entry<'_>) -> String {
        match entry.text() {
            Some(text) => text.to_owned(),
            None if entry.items().next().is_some() => {
                let items: Vec<String> = entry.items().take(12).map(Self::shown).collect();
                format!("[{}]", items.join(", "))
            }
            None => {
                let keys: Vec<&str> = entry.keys().take(12).collect();
                format!("{{{}}}", keys.join(", "))
            }
        }
    }

    pub fn wrong(&self, key: &str, expected: &str) -> ConfigError {
        let (key, expected) = (key.to_owned(), expected.to_owned());
        match self.get(&key) {
            Some(entry) => ConfigError::Value { place: entry.source(), key, got: Self::shown(entry), expected },
            None => ConfigError::Missing { place: self.0.source(), key, expected },
        }
    }

    pub fn missing(&self, key: &str, expected: &str) -> ConfigError {
        ConfigError::Missing { place: self.0.source(), key: key.to_owned(), expected: expected.to_owned() }
    }

    /// Refuses keys that are not among these.
    pub fn only(&self, known: &[&str]) -> Result<(), ConfigError> {
        match self.0.keys().find(|key| !known.contains(key)) {
            None => Ok(()),
            Some(key) => {
                let place = self.get(key).map_or_else(|| self.0.source(), Entry::source);
                let mut known: Vec<&str> = known.to_vec();
                known.sort_unstable();
                Err(ConfigError::Unknown { place, key: key.to_owned(), known: known.join(", ") })
            }
        }
    }

    pub fn text(&self, key: &str) -> Option<&'o str> {
        self.get(key)?.text().map(str::trim)
    }

    pub fn needed_text(&self, key: &str, expected: &str) -> Result<&'o str, ConfigError> {
        self.text(key).filter(|text| !text.is_empty()).ok_or_else(|| self.wrong(key, expected))
    }

    pub fn texts(&self, key: &str) -> Result<Option<Vec<String>>, ConfigError> {
        let Some(entry) = self.get(key) else { return Ok(None) };
        let texts: Option<Vec<String>> = entry.items().map(|item| item.text().map(str::to_owned)).collect();
        let texts = texts.filter(|texts| !texts.is_empty());
        texts.map(Some).ok_or_else(|| self.wrong(key, "a list of names"))
    }

    pub fn number(&self, key: &str) -> Result<Option<f64>, ConfigError> {
        let Some(entry) = self.get(key) else { return Ok(None) };
        let number = entry.text().and_then(|text| text.trim().parse().ok()).filter(|number: &f64| number.is_finite());
        number.map(Some).ok_or_else(|| self.wrong(key, "a finite number"))
    }

    pub fn numbers(&self, key: &str, count: usize) -> Result<Option<Vec<f64>>, ConfigError> {
        let Some(entry) = self.get(key) else { return Ok(None) };
        let parse = |item: Entry<'_>| item.text()?.trim().parse().ok().filter(|number: &f64| number.is_finite());
        let numbers: Option<Vec<f64>> = entry.items().map(parse).collect();
        let numbers = numbers.filter(|numbers| numbers.len() == count);
        numbers.map(Some).ok_or_else(|| self.wrong(key, &format!("a list of {count} finite numbers")))
    }

    pub fn list(&self, key: &str) -> Result<Option<Vec<f64>>, ConfigError> {
        let Some(entry) = self.get(key) else { return Ok(None) };
        self.numbers(key, entry.items().count())
    }

    pub fn boolean(&self, key: &str) -> Result<Option<bool>, ConfigError> {
        match self.text(key) {
            None if self.get(key).is_none() => Ok(None),
            Some("true" | "yes" | "on" | "1") => Ok(Some(true)),
            Some("false" | "no" | "off" | "0") => Ok(Some(false)),
            _ => Err(self.wrong(key, "true or false")),
        }
    }

    pub fn choice<T: Copy>(&self, key: &str, choices: &[(&str, T)]) -> Result<Option<T>, ConfigError> {
        if self.get(key).is_none() {
            return Ok(None);
        }
        let text = self.text(key).unwrap_or("");
        let found = choices.iter().find(|(name, _)| *name == text).map(|(_, value)| *value);
        let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
        found.map(Some).ok_or_else(|| self.wrong(key, &format!("one of {}", names.join(", "))))
    }
}
