//! A walk over one file that has been read: what all kinds of elements have in common.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use ambf_core::adf::{Common, Entry, Material, Outline, PluginEntry, ShaderProgram, SourcePos};

use ambf_core::plugin::PluginSetup;

use super::files::Files;
use super::finding::{Finding, Level};
use super::original::{self, Difference};
use crate::plugins;

/// Collects what is worth saying about a file beside the problems that the reader met.
pub(super) struct Pass<'a> {
    pub outline: &'a Outline,
    pub files: Files,
    pub findings: Vec<Finding>,
    /// What only pictures show, by name.
    kept: BTreeMap<&'static str, usize>,
    /// Topics of the file's objects and the first object that has them.
    topics: HashMap<String, String>,
    setup: PluginSetup,
    /// Plugins whose libraries are there.
    pub plugins: usize,
}

impl<'a> Pass<'a> {
    pub fn new(outline: &'a Outline) -> Self {
        Self {
            outline,
            files: Files::default(),
            findings: Vec::new(),
            kept: BTreeMap::new(),
            topics: HashMap::new(),
            setup: plugins::setup(&[], &[], plugins::CrtkFiles::default()),
            plugins: 0,
        }
    }

    /// What only pictures show, sorted by name.
    pub fn kept(&self) -> Vec<(&'static str, usize)> {
        self.kept.iter().map(|(what, n)| (*what, *n)).collect()
    }

    /// Counts something that only pictures show.
    pub fn keep(&mut self, what: &'static str) {
        *self.kept.entry(what).or_default() += 1;
    }

    /// The element of this name as it is written; `None` when it is listed but not defined.
    pub fn entry(&self, identifier: &str) -> Option<Entry<'a>> {
        self.outline.root().get(identifier)
    }

    /// Where a key of an element stands, or the element.
    pub fn place(&self, common: &Common, key: &str) -> SourcePos {
        let key = self.entry(&common.identifier).and_then(|entry| entry.get(key));
        key.map_or_else(|| common.source.clone(), Entry::source)
    }

    pub fn say(&mut self, level: Level, kind: &'static str, place: SourcePos, path: &[&str], sentence: &str) {
        self.findings.push(Finding::new(level, kind, place, path, sentence));
    }

    /// Notes a difference in an element; nothing when the element is not defined.
    pub fn differs(&mut self, difference: &Difference, identifier: &str) {
        if let Some(entry) = self.entry(identifier) {
            self.findings.push(Finding::differs(difference, entry, &[identifier]));
        }
    }

    /// Notes a difference in the file as a whole.
    pub fn root_differs(&mut self, difference: &Difference) {
        self.findings.push(Finding::differs(difference, self.outline.root(), &[]));
    }

    /// Looks for a mesh; `consequence` is what comes of its absence.
    pub fn mesh(&mut self, level: Level, common: &Common, key: &str, path: &Path, consequence: &str) {
        if let Some(why) = self.files.mesh(path) {
            self.missing(level, common, key, &why, consequence);
            return;
        }
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        match extension.to_str() {
            Some("dae" | "ply" | "gltf" | "glb" | "msh") => self.differs(&original::DAE_MESH, &common.identifier),
            Some("stl" | "obj" | "3ds") => (),
            _ => {
                let why = format!("{} is of no known format (stl, obj, 3ds, dae, ply, gltf, glb, msh)", path.display());
                self.missing(level, common, key, &why, consequence);
            }
        }
    }

    /// Says that a file an element names is not there.
    pub fn missing(&mut self, level: Level, common: &Common, key: &str, why: &str, consequence: &str) {
        let place = self.place(common, key);
        let path = [common.identifier.as_str(), key];
        self.say(level, "missing file", place, &path, &format!("cannot be used: {why}; {consequence}"));
        if let Some(finding) = self.findings.last_mut() {
            finding.action = consequence.to_owned();
            finding.original = match (level, key) {
                (Level::Warning, "mesh") => Some(original::VISUAL_MESH_MISSING),
                (Level::Warning, "images") => Some(original::IMAGES_MISSING),
                _ => None,
            };
        }
    }

    /// Looks for a file beside meshes at `path` in the outline.
    pub fn other_file(&mut self, place: &SourcePos, path: &[&str], file: &Path, consequence: &str) {
        if let Some(why) = self.files.other(file) {
            let sentence = format!("cannot be used: {why}; {consequence}");
            self.say(Level::Warning, "missing file", place.clone(), path, &sentence);
        }
    }

    /// Looks for a pair of shaders.
    pub fn shaders(&mut self, place: &SourcePos, path: &[&str], program: Option<&ShaderProgram>) {
        let Some(program) = program else { return };
        self.keep("shader program");
        for file in [&program.vertex, &program.fragment] {
            self.other_file(place, path, file, "the shaders are not used");
        }
    }

    pub fn material(&mut self, material: Option<&Material>) {
        if material.is_some() {
            self.keep("material");
        }
    }

    /// Looks for the libraries of plugins. They are not opened: what is in them could run.
    pub fn plugins(&mut self, path: &[&str], plugins: &[PluginEntry]) {
        for plugin in plugins {
            let Err(error) = self.setup.check(plugin) else {
                self.plugins += 1;
                continue;
            };
            let library = plugin.filename.display();
            let sentence = format!("lists `{}` ({library}), which is left out: {error}", plugin.name);
            self.say(Level::Warning, "plugin", plugin.source.clone(), path, &sentence);
        }
    }

    /// What every element has; `topics`: an object of its type talks to clients.
    pub fn common(&mut self, common: &Common, topics: bool) {
        self.plugins(&[&common.identifier, "plugins"], &common.plugins);
        if let Some((low, high)) = common.publish_frequency {
            if low <= high && original_rates(low, high) != (low, high) {
                self.differs(&original::PUBLISH_FREQUENCY, &common.identifier);
            }
        }
        if !topics || common.passive {
            return;
        }
        let legal = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '/';
        if !common.name.chars().chain(common.namespace.chars()).all(legal) {
            self.differs(&original::NAME_CHARACTERS, &common.identifier);
        }
        let topic = format!("{}/{}", common.namespace.trim_end_matches('/'), common.name);
        if self.topics.insert(topic, common.identifier.clone()).is_some_and(|other| other != common.identifier) {
            self.differs(&original::SAME_TOPICS, &common.identifier);
        }
    }
}

/// What the C++ program makes of written publishing rates, Hz: each is checked against the other's value of before.
fn original_rates(low: u32, high: u32) -> (u32, u32) {
    let (mut min, mut max) = (50, 1000);
    if low <= max {
        min = low;
    }
    if high >= min {
        max = high;
    }
    (min, max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_of_the_original() {
        assert_eq!(original_rates(60, 2000), (60, 2000));
        assert_eq!(original_rates(1500, 2000), (50, 2000));
        assert_eq!(original_rates(2000, 2000), (50, 2000));
        assert_eq!(original_rates(10, 20), (10, 20));
    }
}
