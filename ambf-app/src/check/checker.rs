//! From file to file: what is named is checked too.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use ambf_core::adf::{
    self, ColorTable, FileKind, InputDevices, Launch, LoadError, ObjectType, Outline, Report, SourcePos, World,
};
use ambf_core::files::{look, Found};
use ambf_core::robot;
use ambf_core::scene::{load, read_model, Loaded, Note, SceneFiles, SceneOptions};

use super::companions::{canonical, listed_names, Companions, Looked, Place};
use super::files::Files;
use super::finding::{Finding, Level};
use super::pass::Pass;
use super::summary::{built, written, Counts, Row};
use super::{device, model, original, view, Checked};
use crate::cli::CheckOptions;
use crate::launch;

/// Names of colours, and the file they come from.
#[derive(Debug)]
struct Colours {
    file: PathBuf,
    table: ColorTable,
}

impl Colours {
    fn load(file: &Path) -> Option<Arc<Self>> {
        let (table, _) = adf::load::<ColorTable>(file).ok()?;
        Some(Arc::new(Self { file: file.to_owned(), table }))
    }

    /// The table that a launch file names; what is wrong with either is said where they are checked.
    fn beside(launch_file: &Path) -> Option<Arc<Self>> {
        let (launch, _) = adf::load::<Launch>(launch_file).ok()?;
        Self::load(&launch.color_config?)
    }

    fn knows(&self, name: &str) -> bool {
        name == "random" || self.table.colors.contains_key(name)
    }
}

/// What the file that names another one says about it.
#[derive(Debug, Clone, Default)]
struct Context {
    /// World that models are built in; `None`: an empty one.
    world: Option<PathBuf>,
    /// Colour table of the launch file.
    colours: Option<Arc<Colours>>,
    /// Place that names the file.
    named_at: Option<SourcePos>,
    /// Models are built later, together with others.
    built_elsewhere: bool,
}

/// Goes from file to file and collects what is found.
#[derive(Default)]
pub(super) struct Checker {
    findings: Vec<Finding>,
    rows: Vec<Row>,
    /// Files by canonical path: how each was named first.
    names: HashMap<PathBuf, Arc<Path>>,
    order: HashMap<Arc<Path>, usize>,
    /// Elements of worlds without a model.
    empty_worlds: HashMap<Option<PathBuf>, Counts>,
    colours: Option<Arc<Colours>>,
    /// By row: plugins whose libraries are there.
    plugins: HashMap<usize, usize>,
    /// By canonical path: names that a model did not find when it was built on its own.
    unfound: HashMap<PathBuf, Vec<Note>>,
    /// Names that worlds did not find without models.
    unfound_by_worlds: HashMap<Option<PathBuf>, Vec<Note>>,
    /// What was not found by a file alone, and stands in other models: it is no finding, or one with an addition.
    elsewhere: Vec<(Note, Option<String>)>,
}

impl Checker {
    /// `launch_file` gives the names of colours to files that no other launch file names.
    pub fn new(launch_file: &Path) -> Self {
        Self { colours: Colours::beside(launch_file), ..Self::default() }
    }

    /// Checks a file that the command line names.
    pub fn named(&mut self, path: &Path) {
        self.file(path, None, &Context::default());
    }

    /// Checks a file unless it was checked before.
    fn file(&mut self, path: &Path, expected: Option<FileKind>, context: &Context) {
        if self.names.contains_key(&canonical(path)) {
            return;
        }
        let name: Arc<Path> = path.into();
        self.names.insert(canonical(path), Arc::clone(&name));
        self.order.insert(name, self.order.len());
        let row = self.rows.len();
        let kind = expected.map_or("?", FileKind::words);
        self.rows.push(Row { file: path.display().to_string(), kind, ..Row::default() });

        // It is read more than once, which a pipe cannot give.
        if let Found::Other(kind) = look(path) {
            let place = SourcePos { file: path.into(), line: 0, column: 0 };
            let sentence = format!("is {kind}, expected a file; it is not checked");
            return self.findings.push(Finding::new(Level::Error, "unreadable", place, &[], &sentence));
        }
        let is_robot = robot::is_robot(path);
        let outline = match if is_robot { Ok(Outline::empty(path)) } else { Outline::load(path) } {
            Ok(outline) => outline,
            Err(error) => return self.unreadable(&error, path, expected, context),
        };
        let kind = if is_robot { FileKind::Model } else { self.kind(&outline, expected, context) };
        self.rows[row].kind = kind.words();
        self.rows[row].written = written(&outline, kind);
        self.rows[row].built = Some(Counts::default());
        match kind {
            FileKind::Launch => self.launch(&outline, row),
            FileKind::World => self.world(&outline, row, context),
            FileKind::Model => self.model(&outline, row, context),
            FileKind::InputDevices => self.devices(&outline, row, context),
            FileKind::ColorTable => self.color_table(&outline, row),
        }
    }

    fn unreadable(&mut self, error: &LoadError, path: &Path, expected: Option<FileKind>, context: &Context) {
        let mut finding = Finding::of_error(error, path);
        if expected == Some(FileKind::World) {
            finding.original = Some(original::WORLD_UNUSABLE);
        }
        if let (Some(place), true) = (&context.named_at, finding.place.line == 0) {
            finding.sentence += &format!("; it is named in {place}");
        }
        self.findings.push(finding);
    }

    /// What a file is taken for.
    fn kind(&mut self, outline: &Outline, expected: Option<FileKind>, context: &Context) -> FileKind {
        let found = outline.kind();
        let say =
            |sentence: String| Finding::new(Level::Warning, "kind of file", outline.root().source(), &[], &sentence);
        match (expected, found) {
            (Some(expected), Some(found)) if expected != found => {
                let place = context.named_at.as_ref().map_or(String::new(), |place| format!(" in {place}"));
                let (expected_words, found) = (expected.words(), found.words());
                self.findings.push(say(format!("is named as {expected_words}{place}, its keys are those of: {found}")));
                expected
            }
            (Some(expected), _) => expected,
            (None, Some(found)) => found,
            (None, None) => {
                self.findings.push(say("no key tells what this file is; it is taken for a model".into()));
                FileKind::Model
            }
        }
    }

    /// Reads a file and takes over what the reader has to say.
    fn read<T: adf::Description>(&mut self, outline: &Outline, row: usize) -> Option<T> {
        self.described(adf::load::<T>(outline.file()), outline, row)
    }

    fn described<T>(&mut self, read: Result<(T, Report), LoadError>, outline: &Outline, row: usize) -> Option<T> {
        let elements = Elements::of(outline);
        match read {
            Ok((description, report)) => {
                self.report(&report, &elements, row);
                Some(description)
            }
            Err(LoadError::Refused { report, .. }) => {
                self.report(&report, &elements, row);
                None
            }
            Err(error) => {
                self.findings.push(Finding::of_error(&error, outline.file()));
                None
            }
        }
    }

    fn report(&mut self, report: &Report, elements: &Elements<'_>, row: usize) {
        let row = &mut self.rows[row];
        for problem in report.problems() {
            match problem.kind {
                adf::ProblemKind::UnknownKey => row.unknown_keys += 1,
                adf::ProblemKind::IgnoredKey => row.ignored_keys += 1,
                _ => (),
            }
            let default = row.kind;
            self.findings.push(Finding::of_problem(problem, elements.kind_of(&problem.path).unwrap_or(default)));
        }
        let unlisted = report.unlisted();
        if unlisted > 0 {
            let place = SourcePos { file: Path::new(&row.file).into(), line: 0, column: 0 };
            let sentence = format!("{unlisted} further problems are not listed");
            let level = if report.errors() > 0 { Level::Error } else { Level::Warning };
            self.findings.push(Finding::new(level, "too many", place, &[], &sentence));
        }
    }

    fn launch(&mut self, outline: &Outline, row: usize) {
        let Some(launch) = self.read::<Launch>(outline, row) else { return };
        let mut pass = Pass::new(outline);
        pass.plugins(&["plugins"], &launch.plugins);
        pass.plugins(&["device plugins"], &launch.device_plugins);
        let models = launch.multibody_configs.clone().unwrap_or_default();
        let named = [&launch.world_config, &launch.input_devices_config, &launch.color_config];
        let exist = |paths: &mut dyn Iterator<Item = &PathBuf>| paths.filter(|path| path.is_file()).count();
        let (mut built, mut others) = (Counts::default(), Files::default());
        built.set("models", exist(&mut models.iter()));
        named.into_iter().flatten().for_each(|path| drop(others.other(path)));
        self.rows[row].others = others.others();
        self.rows[row].built = Some(built);
        self.take(pass, row);

        let root = outline.root();
        let colours = launch.color_config.as_deref().and_then(Colours::load);
        let at = |key: &str| Context {
            world: launch.world_config.clone(),
            colours: colours.clone(),
            named_at: root.get(key).map(|entry| entry.source()),
            built_elsewhere: false,
        };
        for (key, kind, path) in [
            ("world config", FileKind::World, &launch.world_config),
            ("input devices config", FileKind::InputDevices, &launch.input_devices_config),
            ("color config", FileKind::ColorTable, &launch.color_config),
        ] {
            if let Some(path) = path {
                self.file(path, Some(kind), &at(key));
            }
        }
        let places = root.get("multibody configs").into_iter().flat_map(|list| list.items());
        for (model, entry) in models.iter().zip(places) {
            let context = Context { named_at: Some(entry.source()), ..at("multibody configs") };
            self.file(model, Some(FileKind::Model), &context);
        }
        self.look_in_other_models(launch.world_config.as_deref(), &models);
    }

    /// Looks in the other models of a launch file for what its world and each model did not find without them.
    fn look_in_other_models(&mut self, world: Option<&Path>, models: &[PathBuf]) {
        let companions = Companions::new(world, models);
        let of_world = self.unfound_by_worlds.get(&world.map(Path::to_owned)).cloned().unwrap_or_default();
        let mut seen = HashSet::new();
        for subject in std::iter::once(None).chain((0..models.len()).map(Some)) {
            let file = subject.map(|model| models[model].as_path()).or(world);
            let notes = match subject {
                None => of_world.clone(),
                Some(model) => {
                    let path = canonical(&models[model]);
                    let notes = self.unfound.get(&path).filter(|_| seen.insert(path.clone())).cloned();
                    let is_of_world = |note: &Note| of_world.iter().any(|other| other.source == note.source);
                    notes.unwrap_or_default().into_iter().filter(|note| !is_of_world(note)).collect()
                }
            };
            // What the file itself lists, but was dropped, is no matter of other models, even if one has the like.
            let own = if notes.is_empty() { Vec::new() } else { file.map(listed_names).unwrap_or_default() };
            let is_own =
                |note: &Note| note.wanted.as_ref().is_some_and(|text| own.iter().any(|name| name.contains(text)));
            let notes: Vec<Note> = notes.into_iter().filter(|note| !is_own(note)).collect();
            if notes.is_empty() {
                continue;
            }
            let known = notes.len();
            let Looked { notes, places, revealed } = companions.look(subject, notes);
            self.findings.extend(notes[known..].iter().chain(&revealed).map(Finding::of_note));
            let mut needed: Vec<Vec<usize>> = Vec::new();
            for (note, place) in notes.into_iter().zip(places) {
                let addition = match place {
                    Place::Nowhere => continue,
                    Place::Before(other) => Some(format!(
                        "; it is in {}, which the launch file lists later: list that file before this one, or load it first (`-l {other},{}`)",
                        models[other].display(),
                        subject.unwrap_or_default(),
                    )),
                    Place::With(others) => {
                        self.findings.push(needs(&note, subject, &others, models));
                        if !needed.contains(&others) {
                            needed.push(others);
                        }
                        None
                    }
                };
                self.elsewhere.push((note, addition));
            }
            let Some(row) = file.and_then(|file| self.row_of(file)).filter(|_| !needed.is_empty()) else { continue };
            if let Some(model) = subject {
                let first: Vec<usize> = needed.iter().filter_map(|others| others.first().copied()).collect();
                self.rows[row].built = Some(companions.built_with(model, &first));
            }
            let shown = |others: &Vec<usize>| others.iter().map(|&other| models[other].display().to_string()).collect();
            self.rows[row].needs = needed.iter().map(shown).collect();
        }
    }

    /// The line of a file in the table.
    fn row_of(&self, path: &Path) -> Option<usize> {
        self.names.get(&canonical(path)).and_then(|name| self.order.get(name).copied())
    }

    fn world(&mut self, outline: &Outline, row: usize, context: &Context) {
        let Some(world) = self.read::<World>(outline, row) else { return };
        let mut pass = Pass::new(outline);
        view::world(&mut pass, &world);
        self.take(pass, row);
        let path = outline.file().to_path_buf();
        let mut built = self.empty_world(Some(&path));
        // The environment is a file of its own, with a line of its own.
        for what in ["bodies", "joints"] {
            built.set(what, 0);
        }
        self.rows[row].built = Some(only_written(built, &self.rows[row].written));
        if let Some(environment) = &world.environment {
            let named_at = outline.root().get("environment").map(|entry| entry.source());
            let context = Context { named_at, world: None, built_elsewhere: false, ..context.clone() };
            self.file(environment, Some(FileKind::Model), &context);
        }
    }

    fn model(&mut self, outline: &Outline, row: usize, context: &Context) {
        let first = self.findings.len();
        let described = self.described(read_model(outline.file()), outline, row);
        if let Some(described) = &described {
            let mut pass = Pass::new(outline);
            model::model(&mut pass, described);
            self.take(pass, row);
            self.look_up_colours(outline, row, context);
        }
        if robot::is_robot(outline.file()) {
            // All there is to say of the C++ program.
            self.findings[first..].iter_mut().for_each(|finding| finding.original = None);
            self.findings.push(Finding::differs(&original::ROBOT_DESCRIPTION, outline.root(), &[]));
            if let Some(described) = &described {
                self.rows[row].written.set("bodies", described.bodies.len());
                self.rows[row].written.set("joints", described.joints.len());
            }
        }
        if context.built_elsewhere {
            self.rows[row].built = None;
        } else if described.is_some() {
            let world = context.world.as_deref();
            let (built, unfound) = self.build(world, &[outline.file().to_path_buf()]);
            self.rows[row].built = Some(built);
            self.unfound.insert(canonical(outline.file()), unfound);
        }
    }

    fn devices(&mut self, outline: &Outline, row: usize, context: &Context) {
        let Some(devices) = self.read::<InputDevices>(outline, row) else { return };
        let mut pass = Pass::new(outline);
        let mut built = Counts::default();
        built.set("devices", devices.entries.iter().flatten().count());
        self.rows[row].built = Some(built);
        let mut models = Vec::new();
        for device in devices.entries.iter().flatten() {
            device::differences(&mut pass, device);
            let Some(path) = &device.simulated_multibody else { continue };
            let entry = pass.entry(&device.identifier).and_then(|entry| entry.get("simulated multibody"));
            let place = entry.map_or_else(|| device.source.clone(), |entry| entry.source());
            let keys = [device.identifier.as_str(), "simulated multibody"];
            pass.other_file(&place, &keys, path, "the device is dropped");
            if path.is_file() {
                device::root_link(&mut pass, device, path);
                models.push((path.clone(), place));
            }
        }
        self.take(pass, row);
        for (path, place) in models {
            let context = Context { named_at: Some(place), ..context.clone() };
            self.file(&path, Some(FileKind::Model), &context);
        }
    }

    fn color_table(&mut self, outline: &Outline, row: usize) {
        let Some(table) = self.read::<ColorTable>(outline, row) else { return };
        let mut built = Counts::default();
        built.set("colours", table.colors.len());
        self.rows[row].built = Some(built);
    }

    /// Checks models as `-l` and `-a` load them: one after the other into one world.
    pub fn together(&mut self, options: &CheckOptions, model_files: &[PathBuf], indexes: &[usize]) {
        let needs_launch = options.world.is_none() || !indexes.is_empty();
        let launch = needs_launch.then(|| adf::load::<Launch>(&options.launch_file));
        let launch = match launch {
            Some(Ok((launch, _))) => Some(launch),
            Some(Err(_)) => {
                // Says what is wrong with it.
                self.file(&options.launch_file, Some(FileKind::Launch), &Context::default());
                None
            }
            None => None,
        };
        let (files, skipped) = launch::scene_files(launch.as_ref(), options.world.as_deref(), model_files, indexes);
        let place = SourcePos { file: options.launch_file.as_path().into(), line: 0, column: 0 };
        for sentence in skipped {
            self.findings.push(Finding::new(Level::Error, "no such model", place.clone(), &[], &sentence));
        }
        let alone = files.models.len() == 1;
        let context = Context { world: files.world.clone(), built_elsewhere: !alone, ..Context::default() };
        if let Some(world) = &files.world {
            self.file(world, Some(FileKind::World), &context);
        }
        for model in &files.models {
            self.file(model, Some(FileKind::Model), &context);
        }
        if !alone && !files.models.is_empty() {
            let (built, _) = self.build(files.world.as_deref(), &files.models);
            let rows: Vec<usize> = files.models.iter().filter_map(|path| self.row_of(path)).collect();
            let written = rows.iter().fold(Counts::default(), |sum, &row| sum.plus(&self.rows[row].written));
            let plugins = rows.iter().filter_map(|row| self.plugins.get(row)).sum();
            self.plugins.insert(self.rows.len(), plugins);
            let file = format!("{} models together", files.models.len());
            self.rows.push(Row { file, kind: "scene", written, built: Some(built), ..Row::default() });
        }
    }

    /// Builds models in a world and takes over the remarks on it; what the models have made, and the remarks on names
    /// that were not found.
    fn build(&mut self, world: Option<&Path>, models: &[PathBuf]) -> (Counts, Vec<Note>) {
        let empty = self.empty_world(world);
        let files = SceneFiles { world: world.map(Path::to_owned), models: models.to_vec() };
        let Loaded { scene, report } = load(&files, &SceneOptions::default());
        self.findings.extend(report.notes.iter().map(Finding::of_note));
        (built(&scene).minus(&empty), unfound(report.notes))
    }

    /// What a world has before any model is in it.
    fn empty_world(&mut self, world: Option<&Path>) -> Counts {
        let world = world.map(Path::to_owned);
        if let Some(counts) = self.empty_worlds.get(&world) {
            return *counts;
        }
        let files = SceneFiles { world: world.clone(), models: Vec::new() };
        let Loaded { scene, report } = load(&files, &SceneOptions::default());
        self.findings.extend(report.notes.iter().map(Finding::of_note));
        let counts = built(&scene);
        self.unfound_by_worlds.insert(world.clone(), unfound(report.notes));
        self.empty_worlds.insert(world, counts);
        counts
    }

    /// Takes over what a walk over a file found.
    fn take(&mut self, pass: Pass<'_>, place: usize) {
        let row = &mut self.rows[place];
        row.meshes = pass.files.meshes();
        let others = pass.files.others();
        row.others.named += others.named;
        row.others.found += others.found;
        row.kept = pass.kept();
        *self.plugins.entry(place).or_default() += pass.plugins;
        self.findings.extend(pass.findings);
    }

    /// Colours by name have no effect, but a name that is in no table is a mistake even so.
    fn look_up_colours(&mut self, outline: &Outline, row: usize, context: &Context) {
        let Some(colours) = context.colours.clone().or_else(|| self.colours.clone()) else { return };
        let root = outline.root();
        let mut named = 0;
        for list in ["bodies", "soft bodies", "ghost objects", "volumes"] {
            let listed = root.get(list).into_iter().flat_map(|list| list.items()).filter_map(|name| name.text());
            for identifier in listed {
                let Some(color) = root.get(identifier).and_then(|element| element.get("color")) else { continue };
                let Some(name) = color.text().filter(|name| !name.is_empty()) else { continue };
                named += 1;
                if !colours.knows(name) {
                    let sentence = format!("is `{name}`, which {} does not hold", colours.file.display());
                    let path = [identifier, "color"];
                    self.findings.push(Finding::new(
                        Level::Warning,
                        "unknown colour",
                        color.source(),
                        &path,
                        &sentence,
                    ));
                }
            }
        }
        if named > 0 {
            self.rows[row].kept.push(("colour by name", named));
        }
    }

    /// Puts the findings in order and leaves out what is said twice.
    pub fn finish(mut self) -> Checked {
        let mut spelling: HashMap<Arc<Path>, Arc<Path>> = HashMap::new();
        let mut respell = |place: &mut SourcePos| {
            let file = &place.file;
            let name = spelling
                .entry(Arc::clone(file))
                .or_insert_with(|| self.names.get(&canonical(file)).unwrap_or(file).clone());
            place.file = Arc::clone(name);
        };
        self.findings.iter_mut().for_each(|finding| respell(&mut finding.place));
        let mut elsewhere: HashMap<(SourcePos, String), Option<String>> = HashMap::new();
        for (mut note, addition) in self.elsewhere {
            respell(&mut note.source);
            // Of several launch files the one whose models have the name counts.
            elsewhere
                .entry((note.source, note.message))
                .and_modify(|known| *known = known.take().and(addition.clone()))
                .or_insert(addition);
        }
        self.findings.retain_mut(|finding| {
            let key = (finding.place.clone(), finding.sentence.clone());
            match elsewhere.get(&key).filter(|_| finding.kind == "scene") {
                Some(None) => false,
                Some(Some(addition)) => {
                    finding.sentence += addition;
                    true
                }
                None => true,
            }
        });
        let last = self.order.len();
        let key = |finding: &Finding| {
            let file = self.order.get(&finding.place.file).copied().unwrap_or(last);
            (file, finding.place.line, finding.place.column, std::cmp::Reverse(finding.level))
        };
        // Stable: what was found first stays first.
        self.findings.sort_by_key(key);
        // Missing files are remarks of the scene too.
        let missing: HashSet<_> = (self.findings.iter())
            .filter(|finding| finding.kind == "missing file" && finding.level == Level::Error)
            .map(|finding| (Arc::clone(&finding.place.file), finding.path.clone()))
            .filter_map(|(file, path)| Some((file, path.split(" / ").next()?.to_owned())))
            .collect();
        // Robot descriptions keep no places of keys: what they miss stands where the body does.
        let missing_parts: HashSet<_> = (self.findings.iter())
            .filter(|finding| finding.kind == "missing file" && finding.level == Level::Error)
            .map(|finding| finding.place.clone())
            .collect();
        let known = |finding: &Finding| {
            let dropped = finding.sentence.strip_prefix('`').and_then(|text| text.split_once("` is dropped"));
            let of = |(identifier, _): (&str, &str)| (Arc::clone(&finding.place.file), identifier.to_owned());
            let is_part = missing_parts.contains(&finding.place) && finding.sentence.contains("is left out");
            finding.kind == "scene" && (is_part || dropped.is_some_and(|dropped| missing.contains(&of(dropped))))
        };
        let mut said = HashSet::new();
        let mut findings = Vec::with_capacity(self.findings.len());
        for finding in self.findings {
            if !known(&finding) && said.insert((finding.place.clone(), finding.sentence.clone())) {
                findings.push(finding);
            }
        }
        for (row, plugins) in self.plugins {
            if let Some(built) = &mut self.rows[row].built {
                built.set("plugins", plugins);
            }
        }
        Checked { findings, rows: self.rows }
    }
}

/// The remarks on names that led to nothing, or to several objects.
fn unfound(notes: Vec<Note>) -> Vec<Note> {
    notes.into_iter().filter(|note| note.wanted.is_some()).collect()
}

/// Says that an element of the model `subject`, or of a world, needs one of the models `others`.
fn needs(note: &Note, subject: Option<usize>, others: &[usize], models: &[PathBuf]) -> Finding {
    let mut finding = Finding::of_note(note);
    (finding.level, finding.kind) = (Level::Info, "other model");
    let files: Vec<_> = others.iter().map(|&other| models[other].display().to_string()).collect();
    let mut together: Vec<usize> = subject.into_iter().chain(others.first().copied()).collect();
    together.sort_unstable();
    let together = together.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
    let (element, wanted) = (&finding.path, note.wanted.as_deref().unwrap_or_default());
    let whom = if subject.is_some() { "this model is to be loaded together with" } else { "it is found together with" };
    let one = if files.len() > 1 { "one of them" } else { "that file" };
    finding.sentence =
        format!("`{element}` needs `{wanted}`, which is in {}; {whom} {one} (`-l {together}`)", files.join(" or "));
    finding
}

/// A world makes a light and a camera that no file asks for.
fn only_written(mut built: Counts, written: &Counts) -> Counts {
    for what in ["lights", "cameras"] {
        if written.get(what) == 0 {
            built.set(what, 0);
        }
    }
    built
}

/// What kind of element the elements of a file are.
struct Elements<'o>(HashMap<&'o str, &'static str>);

impl<'o> Elements<'o> {
    fn of(outline: &'o Outline) -> Self {
        let types = ObjectType::ALL.iter().map(|kind| (kind.list(), kind.words()));
        let mut kinds = HashMap::new();
        for (list, kind) in types.chain([("input devices", "input device")]) {
            let items = outline.root().get(list).into_iter().flat_map(|list| list.items());
            for identifier in items.filter_map(|name| name.text()) {
                kinds.entry(identifier).or_insert(kind);
            }
        }
        Self(kinds)
    }

    /// The kind of the element that a problem's path starts with.
    fn kind_of(&self, path: &str) -> Option<&'static str> {
        self.0.get(path.split(" / ").next()?).copied()
    }
}
