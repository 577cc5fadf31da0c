//! The keys of a file as they are written, for tools that explain a file: places and texts that the descriptions do not
//! keep.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use super::common::SourcePos;
use super::model::ObjectType;
use super::reader::is_version_key;
use super::report::LoadError;
use super::yaml::{Document, Kind, Mark};

/// A kind of file that is part of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum FileKind {
    /// [`Launch`](super::Launch).
    Launch,
    /// [`World`](super::World).
    World,
    /// [`Model`](super::Model).
    Model,
    /// [`InputDevices`](super::InputDevices).
    InputDevices,
    /// [`ColorTable`](super::ColorTable).
    ColorTable,
}

impl FileKind {
    /// What a message calls such a file.
    pub fn words(self) -> &'static str {
        match self {
            Self::Launch => "launch file",
            Self::World => "world",
            Self::Model => "model",
            Self::InputDevices => "input devices",
            Self::ColorTable => "colours",
        }
    }
}

/// Keys that only one kind of file has at its root.
const TELLING_KEYS: [(FileKind, &[&str]); 4] = [
    (FileKind::Launch, &["world config", "input devices config", "color config", "multibody configs"]),
    (FileKind::InputDevices, &["input devices"]),
    // Beside the lists of objects that worlds have not.
    (FileKind::Model, &["high resolution path", "low resolution path", "ignore inter-collision"]),
    (FileKind::World, &["environment", "enclosure", "enclosure size", "max iterations", "skybox", "physics"]),
];

/// The tree of keys and values of a file. An alias is what its anchor is; of two equal keys in a mapping the first
/// counts.
#[derive(Debug)]
pub struct Outline {
    file: Arc<Path>,
    nodes: Vec<Node>,
    root: u32,
}

#[derive(Debug)]
struct Node {
    mark: Mark,
    value: Value,
}

#[derive(Debug)]
enum Value {
    Null,
    Scalar(String),
    List(Vec<u32>),
    Map(BTreeMap<String, (Mark, u32)>),
}

/// A value of an [`Outline`] and the place where its key stands.
#[derive(Clone, Copy, Debug)]
pub struct Entry<'o> {
    outline: &'o Outline,
    mark: Mark,
    node: &'o Node,
}

impl Outline {
    /// Reads a file.
    ///
    /// # Errors
    /// Those of [`load`](super::load) that come before any value is looked at.
    pub fn load(path: &Path) -> Result<Self, LoadError> {
        let bytes = super::read_bytes(path)?;
        super::with_document(&bytes, path, |doc, _| Ok(Self::of(doc, path)))
    }

    /// Reads a text as [`load`](Self::load) reads a file; `path` stands for its name.
    ///
    /// # Errors
    /// As [`load`](Self::load), except that nothing is unreadable.
    pub fn parse(text: &str, path: &Path) -> Result<Self, LoadError> {
        super::with_document(text.as_bytes(), path, |doc, _| Ok(Self::of(doc, path)))
    }

    /// The outline of a file that has no keys, such as one that is not YAML.
    pub fn empty(path: &Path) -> Self {
        let node = Node { mark: Mark { line: 1, column: 1 }, value: Value::Null };
        Self { file: path.into(), nodes: vec![node], root: 0 }
    }

    pub(super) fn of(doc: &Document<'_>, path: &Path) -> Self {
        let text = |id: u32| match &doc.node(id).kind {
            Kind::Scalar(text) => text.clone().into_owned(),
            _ => String::from("null"),
        };
        let node = |id: u32| {
            let node = doc.node(id);
            let value = match &node.kind {
                Kind::Null => Value::Null,
                Kind::Scalar(text) => Value::Scalar(text.clone().into_owned()),
                Kind::List(items) => Value::List(items.clone()),
                Kind::Map(entries) => {
                    let mut map = BTreeMap::new();
                    for &(key, value) in entries {
                        map.entry(text(key)).or_insert((doc.node(key).mark, value));
                    }
                    Value::Map(map)
                }
            };
            Node { mark: node.mark, value }
        };
        let nodes = (0..doc.len()).filter_map(|id| u32::try_from(id).ok()).map(node).collect();
        Self { file: path.into(), nodes, root: doc.root_id() }
    }

    /// The file, as it was named when it was read.
    pub fn file(&self) -> &Arc<Path> {
        &self.file
    }

    /// The root mapping.
    pub fn root(&self) -> Entry<'_> {
        let node = &self.nodes[self.root as usize];
        Entry { outline: self, mark: node.mark, node }
    }

    /// What kind of file it is, by its keys; `None` when none of them tells.
    pub fn kind(&self) -> Option<FileKind> {
        let root = self.root();
        let has = |key: &str| root.get(key).is_some();
        let lists_objects = || ObjectType::ALL.iter().any(|kind| !kind.is_in_worlds() && has(kind.list()));
        let tells = |(kind, keys): &&(FileKind, &[&str])| {
            keys.iter().any(|key| has(key)) || (*kind == FileKind::Model && lists_objects())
        };
        if let Some((kind, _)) = TELLING_KEYS.iter().find(tells) {
            return Some(*kind);
        }
        // What a world and a model share stands alone in worlds only: a model has something that can move.
        if ["gravity", "lights", "cameras"].iter().any(|key| root.get(key).is_some()) {
            return Some(FileKind::World);
        }
        let Value::Map(entries) = &root.node.value else { return None };
        let mut colours = entries.keys().filter(|key| !is_version_key(key)).filter_map(|key| root.get(key)).peekable();
        colours.peek()?;
        colours
            .all(|colour| ["r", "g", "b"].iter().all(|key| colour.get(key).is_some()))
            .then_some(FileKind::ColorTable)
    }
}

impl<'o> Entry<'o> {
    fn of(outline: &'o Outline, mark: Option<Mark>, id: u32) -> Self {
        let node = &outline.nodes[id as usize];
        Self { outline, mark: mark.unwrap_or(node.mark), node }
    }

    /// The value of a key; `None` when this is no mapping or has no such key.
    pub fn get(self, key: &str) -> Option<Self> {
        let Value::Map(entries) = &self.node.value else { return None };
        let &(mark, id) = entries.get(key)?;
        Some(Self::of(self.outline, Some(mark), id))
    }

    /// The keys of a mapping, sorted; nothing for other values.
    pub fn keys(self) -> impl Iterator<Item = &'o str> {
        let entries = match &self.node.value {
            Value::Map(entries) => Some(entries),
            _ => None,
        };
        entries.into_iter().flat_map(|entries| entries.keys().map(String::as_str))
    }

    /// The items of a list; nothing for other values.
    pub fn items(self) -> impl Iterator<Item = Self> {
        let items: &[u32] = match &self.node.value {
            Value::List(items) => items,
            _ => &[],
        };
        items.iter().map(move |&id| Self::of(self.outline, None, id))
    }

    /// The text of a scalar as it is written, without its quotes; `None` for null, lists and mappings.
    pub fn text(self) -> Option<&'o str> {
        match &self.node.value {
            Value::Scalar(text) => Some(text),
            _ => None,
        }
    }

    /// Where the key of the value stands; of the root and of an item of a list, where itself starts.
    pub fn source(self) -> SourcePos {
        SourcePos { file: self.outline.file.clone(), line: self.mark.line, column: self.mark.column }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outline(text: &str) -> Outline {
        let path = Path::new("t.yaml");
        super::super::with_document(text.as_bytes(), path, |doc, _| Ok(Outline::of(doc, path))).expect("read")
    }

    #[test]
    fn places_and_texts() {
        let outline = outline("a: &x {b: '1', b: 2}\nc:\n  - *x\n  - ~\n  - [d]\n");
        let root = outline.root();
        let b = root.get("a").and_then(|a| a.get("b")).expect("a / b");
        assert_eq!((b.text(), b.source().line, b.source().column), (Some("1"), 1, 8));
        let items: Vec<_> = root.get("c").expect("c").items().collect();
        assert_eq!(items.len(), 3);
        assert_eq!(items[0].get("b").and_then(Entry::text), Some("1"));
        assert_eq!((items[1].text(), items[1].items().count()), (None, 0));
        assert_eq!(items[2].items().next().and_then(Entry::text), Some("d"));
        assert_eq!(root.keys().collect::<Vec<_>>(), ["a", "c"]);
        assert!(root.get("e").is_none() && b.get("e").is_none());
    }

    #[test]
    fn kinds_by_keys() {
        for (text, kind) in [
            ("multibody configs: []\n", Some(FileKind::Launch)),
            ("input devices: []\n", Some(FileKind::InputDevices)),
            ("bodies: [A]\ngravity: {x: 0, y: 0, z: 0}\n", Some(FileKind::Model)),
            ("gravity: {x: 0, y: 0, z: 0}\n", Some(FileKind::World)),
            ("environment: e.yaml\nlights: []\n", Some(FileKind::World)),
            ("red: {r: 255, g: 0, b: 0, a: 255}\nblue: &b {r: 0, g: 0, b: 255, a: 255}\n", Some(FileKind::ColorTable)),
            ("ADF Version: 1.0\nred: {r: 255, g: 0, b: 0, a: 255}\n", Some(FileKind::ColorTable)),
            ("red: {r: 255, g: 0, b: 0, a: 255}\nname: x\n", None),
            ("{}\n", None),
        ] {
            assert_eq!(outline(text).kind(), kind, "{text}");
        }
    }
}
