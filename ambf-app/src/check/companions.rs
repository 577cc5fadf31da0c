//! Names of a model, or of a world, that stand in another model of the same launch file.
//!
//! A launch file lists models that belong together and models of which the user picks one. So each is built alone
//! first, and only what is not found then is looked for in the others, one at a time: no model is judged by what else
//! is in the list.

use std::cell::OnceCell;
use std::path::{Path, PathBuf};

use ambf_core::adf::{Entry, Outline, Severity, SourcePos};
use ambf_core::robot;
use ambf_core::scene::{load, read_model, Loaded, Note, SceneFiles, SceneOptions};

use super::summary::{built, Counts};

/// Models that are named as having a name; more are not looked for.
const MAX_NAMED: usize = 3;

/// The models of a launch file, each as another one sees it.
pub(super) struct Companions<'l> {
    world: Option<&'l Path>,
    models: &'l [PathBuf],
    canonical: Vec<PathBuf>,
    /// By model: qualified identifiers of what a name can mean.
    names: Vec<OnceCell<Vec<String>>>,
}

/// Where a name stands that is not found without other models.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Place {
    /// In no other model.
    Nowhere,
    /// In each of these models, in the order of the list.
    With(Vec<usize>),
    /// In this model, which is listed later: it would have to be loaded before.
    Before(usize),
}

/// What the other models have for a file.
#[derive(Debug, Default)]
pub(super) struct Looked {
    /// Names that were looked for: those that were asked for, then those that their elements look for once they are
    /// found.
    pub notes: Vec<Note>,
    /// Where each of them stands.
    pub places: Vec<Place>,
    /// What else is wrong with the elements once their names are found.
    pub revealed: Vec<Note>,
}

impl<'l> Companions<'l> {
    pub fn new(world: Option<&'l Path>, models: &'l [PathBuf]) -> Self {
        Self {
            world,
            models,
            canonical: models.iter().map(|path| canonical(path)).collect(),
            names: vec![OnceCell::new(); models.len()],
        }
    }

    /// Looks for what `notes` on the model `subject`, or on the world, did not find.
    pub fn look(&self, subject: Option<usize>, notes: Vec<Note>) -> Looked {
        let mut looked = Looked { notes, ..Looked::default() };
        // One of the models for each name that was found.
        let mut needed: Vec<usize> = Vec::new();
        while looked.places.len() < looked.notes.len() {
            let places = self.places(subject, &looked.notes[looked.places.len()..], &needed);
            let first = places.iter().filter_map(|place| match place {
                Place::With(models) => models.first().copied(),
                Place::Nowhere | Place::Before(_) => None,
            });
            let known = needed.len();
            needed.extend(first);
            let is_mended = needed.len() > known;
            looked.places.extend(places);
            if is_mended {
                self.reveal(&mut looked, &order(subject, &needed));
            }
        }
        looked
    }

    /// What is said about elements whose names are found when `models` are loaded.
    fn reveal(&self, looked: &mut Looked, models: &[usize]) {
        for remark in self.load(models).report.notes {
            let is_mended = |(note, place): (&Note, &Place)| {
                matches!(place, Place::With(_)) && is_same_place(&note.source, &remark.source)
            };
            let is_known = |note: &Note| note.wanted == remark.wanted && is_same_place(&note.source, &remark.source);
            if !looked.notes.iter().zip(&looked.places).any(is_mended) {
                continue;
            }
            if remark.wanted.is_none() {
                if is_fault(&remark) && !looked.revealed.contains(&remark) {
                    looked.revealed.push(remark);
                }
            } else if !looked.notes.iter().any(is_known) {
                looked.notes.push(remark);
            }
        }
    }

    /// Where names stand that `notes` on `subject` did not find with the models `with`.
    fn places(&self, subject: Option<usize>, notes: &[Note], with: &[usize]) -> Vec<Place> {
        let mut found: Vec<Vec<usize>> = vec![Vec::new(); notes.len()];
        let mut before: Vec<Option<usize>> = vec![None; notes.len()];
        for other in 0..self.models.len() {
            let is_subject = subject.is_some_and(|subject| self.canonical[subject] == self.canonical[other]);
            if is_subject || with.contains(&other) || self.canonical[..other].contains(&self.canonical[other]) {
                continue;
            }
            let asked = |&n: &usize| found[n].len() < MAX_NAMED && self.may_hold(other, notes[n].wanted.as_deref());
            let asked: Vec<usize> = (0..notes.len()).filter(asked).collect();
            if asked.is_empty() {
                continue;
            }
            let others: Vec<usize> = with.iter().copied().chain([other]).collect();
            let remarks = self.load(&order(subject, &others)).report.notes;
            let (open, mended): (Vec<_>, Vec<_>) = asked.into_iter().partition(|&n| is_open(&remarks, &notes[n]));
            mended.into_iter().for_each(|n| found[n].push(other));
            let Some(subject) = subject.filter(|&subject| subject < other) else { continue };
            if open.iter().any(|&n| before[n].is_none()) {
                let mut others = order(None, &others);
                others.push(subject);
                let remarks = self.load(&others).report.notes;
                for n in open.into_iter().filter(|&n| !is_open(&remarks, &notes[n])) {
                    before[n].get_or_insert(other);
                }
            }
        }
        let place = |(models, before): (Vec<usize>, Option<usize>)| match (models.is_empty(), before) {
            (false, _) => Place::With(models),
            (true, Some(model)) => Place::Before(model),
            (true, None) => Place::Nowhere,
        };
        found.into_iter().zip(before).map(place).collect()
    }

    /// What becomes of the model `subject` when `others` are loaded too.
    pub fn built_with(&self, subject: usize, others: &[usize]) -> Counts {
        let all = order(Some(subject), others);
        let without: Vec<usize> = all.iter().copied().filter(|&model| model != subject).collect();
        built(&self.load(&all).scene).minus(&built(&self.load(&without).scene))
    }

    fn load(&self, models: &[usize]) -> Loaded {
        let models = models.iter().map(|&model| self.models[model].clone()).collect();
        load(&SceneFiles { world: self.world.map(Path::to_owned), models }, &SceneOptions::default())
    }

    /// Whether a model has anything that `text` can mean. Says it without building the model.
    fn may_hold(&self, model: usize, text: Option<&str>) -> bool {
        let names = self.names[model].get_or_init(|| names_of(&self.models[model]));
        text.is_some_and(|text| names.iter().any(|name| name.contains(text)))
    }
}

/// Models in the order of the list, each once.
fn order(subject: Option<usize>, others: &[usize]) -> Vec<usize> {
    let mut all: Vec<usize> = others.iter().copied().chain(subject).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// Qualified identifiers of what elements of other models can name.
fn names_of(path: &Path) -> Vec<String> {
    let Ok((model, _)) = read_model(path) else { return Vec::new() };
    let bodies = model.bodies.iter().map(|body| &body.common);
    let cameras = model.cameras.iter().map(|camera| &camera.common);
    let lights = model.lights.iter().map(|light| &light.common);
    let ghosts = model.ghosts.iter().map(|ghost| &ghost.common);
    let all = bodies.chain(cameras).chain(lights).chain(ghosts);
    all.map(|common| format!("{}{}", common.namespace, common.identifier)).collect()
}

/// Qualified identifiers of what a file lists and others can name, also of what is dropped when the file is built.
pub(super) fn listed_names(path: &Path) -> Vec<String> {
    if robot::is_robot(path) {
        return names_of(path);
    }
    let Ok(outline) = Outline::load(path) else { return Vec::new() };
    let root = outline.root();
    let namespace_of =
        |entry: Option<Entry<'_>>| entry.and_then(|entry| entry.get("namespace")?.text().map(str::to_owned));
    let file = namespace_of(Some(root)).unwrap_or_default();
    let lists = ["bodies", "cameras", "lights", "ghost objects"].into_iter().filter_map(|list| root.get(list));
    let identifiers = lists.flat_map(Entry::items).filter_map(Entry::text);
    let qualified = |identifier: &str| match namespace_of(root.get(identifier)) {
        Some(own) if own.starts_with('/') => format!("{own}{identifier}"),
        Some(own) => format!("{file}{own}{identifier}"),
        None => format!("{file}{identifier}"),
    };
    identifiers.map(qualified).collect()
}

/// Whether the name of `note` is looked for in vain in a scene with these remarks too.
fn is_open(remarks: &[Note], note: &Note) -> bool {
    remarks.iter().any(|remark| remark.wanted == note.wanted && is_same_place(&remark.source, &note.source))
}

/// Whether a remark is about a mistake, not about where a name was found.
fn is_fault(note: &Note) -> bool {
    note.severity > Severity::Info && note.wanted.is_none() && !note.message.contains("is taken from another model")
}

fn is_same_place(a: &SourcePos, b: &SourcePos) -> bool {
    (a.line, a.column) == (b.line, b.column) && (a.file == b.file || canonical(&a.file) == canonical(&b.file))
}

/// The one name of a file that has several.
pub(super) fn canonical(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}
