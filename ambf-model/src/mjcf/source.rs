//! The texts of a description: its file and those that it includes, as one tree of elements.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crate::adf::{read_bytes, text_of, LoadError, ProblemKind, Severity, SourcePos};
use crate::mesh::Sources;
use crate::xml::{quoted, Element, File};

/// Most files of a description.
const MAX_FILES: usize = 1000;

/// Most bytes of all its files together.
const MAX_BYTES: usize = 64 << 20;

/// Whether a description may look at other files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Surroundings {
    /// Included files and meshes are read from the disk.
    Disk,
    /// There are none: every other file counts as missing.
    Nothing,
}

/// A file and those that it includes.
pub(super) struct Texts {
    /// Path and text of each; the first is the file itself.
    pub all: Vec<(PathBuf, String)>,
    /// By the place of an `include` the index of the text that stands there.
    pub includes: HashMap<SourcePos, usize>,
    /// The files that are included.
    pub sources: Sources,
}

impl Texts {
    /// Reads what `text` includes, and what that includes. A file may be included once, as in MuJoCo.
    pub fn gather(text: String, path: &Path, surroundings: Surroundings) -> Result<Self, LoadError> {
        let mut texts =
            Self { all: vec![(path.to_owned(), text)], includes: HashMap::new(), sources: Sources::default() };
        let mut next = 0;
        let mut bytes = texts.all[0].1.len();
        while next < texts.all.len() {
            let mut found = Vec::new();
            {
                let (own_path, text) = &texts.all[next];
                let file = File::new(text, own_path);
                {
                    let document = file.parse()?;
                    let root = Element::root(&document, &file)?;
                    let expected: &[&str] = if next == 0 { &["mujoco"] } else { &["mujoco", "mujocoinclude"] };
                    let mut waiting = vec![root.expect_tag(expected)?];
                    while let Some(element) = waiting.pop() {
                        if element.tag() == "include" {
                            let number = texts.all.len() + found.len();
                            if let Some(path) = included(&element, path, own_path, surroundings) {
                                let is_new = texts.all.iter().map(|(path, _)| path).chain(&found).all(|p| *p != path);
                                if is_new && number < MAX_FILES {
                                    texts.includes.insert(element.source(), number);
                                    found.push(path);
                                } else {
                                    let expected = if is_new { "fewer files" } else { "each file once" };
                                    let name = quoted(element.attribute("file").unwrap_or_default());
                                    element.problem(
                                        Severity::Fatal,
                                        ProblemKind::Structure,
                                        "file",
                                        &format!("{name}, again"),
                                        expected,
                                        "",
                                    );
                                }
                            }
                        } else {
                            waiting.extend(element.elements());
                        }
                    }
                }
                let report = file.into_report();
                if report.is_fatal() {
                    return Err(LoadError::Refused { file: path.into(), report });
                }
            }
            for path in found {
                texts.sources.add(&path);
                let content = read_bytes(&path)?;
                bytes += content.len();
                if bytes > MAX_BYTES {
                    return Err(LoadError::TooLarge { file: path, limit: MAX_BYTES as u64 });
                }
                let text = text_of(&content, &path)?.to_owned();
                texts.all.push((path, text));
            }
            next += 1;
        }
        Ok(texts)
    }
}

/// A path as it may be written in MJCF: also with backslashes between its parts, as in MuJoCo.
pub(super) fn written_path(text: &str) -> PathBuf {
    text.replace('\\', "/").into()
}

/// The file that an `include` names: beside the main file, or else beside the file in which it stands. `None`: reported.
fn included(element: &Element<'_>, main: &Path, own: &Path, surroundings: Surroundings) -> Option<PathBuf> {
    let name = element.need("file", "the name of a file");
    if name.is_empty() {
        return None;
    }
    let name_here = written_path(name);
    let beside = |file: &Path| file.parent().unwrap_or(Path::new("")).join(&name_here);
    let places = [beside(main), beside(own)];
    let found = places.iter().find(|path| surroundings == Surroundings::Disk && path.is_file());
    if found.is_none() {
        let expected = format!("a file: there is no {}", places[0].display());
        element.problem(Severity::Fatal, ProblemKind::UnknownValue, "file", &quoted(name), &expected, "");
    }
    found.cloned()
}

/// The elements of all texts, each `include` replaced by what the file holds.
pub(super) struct Source<'a> {
    /// The outermost element of each text.
    pub roots: Vec<Element<'a>>,
    pub includes: &'a HashMap<SourcePos, usize>,
}

impl<'a> Source<'a> {
    /// Elements inside, in the order of the files.
    pub fn elements(&self, element: &Element<'a>) -> Vec<Element<'a>> {
        let mut all = Vec::new();
        let inside = |element: &Element<'a>| element.elements().collect::<Vec<_>>().into_iter().rev();
        let mut waiting: Vec<_> = inside(element).collect();
        while let Some(element) = waiting.pop() {
            if element.tag() != "include" {
                all.push(element);
            } else if let Some(&index) = self.includes.get(&element.source()) {
                waiting.extend(inside(&self.roots[index]));
            }
        }
        all
    }

    /// Elements of one kind.
    pub fn children(&self, element: &Element<'a>, tag: &str) -> Vec<Element<'a>> {
        let mut all = self.elements(element);
        all.retain(|element| element.tag() == tag);
        all
    }
}
