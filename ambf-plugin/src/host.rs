//! Holds all plugins of a simulation, calls them in order, and keeps their failures to themselves.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::desk::{Desk, Incoming, Shared};
use super::registry::BUILTIN;
use super::view::Access;
use super::{library, AnyPlugin, Drawings, Host, InitContext, Input, PluginError, Registry, Search, Subject, View};
use crate::ObjectId;
use ambf_device::caught;
use ambf_model::adf::PluginEntry;

/// Panics after which a plugin is closed.
const MAX_PANICS: u32 = 3;
/// What a callback in the physics thread may take.
const PHYSICS_BUDGET: Duration = Duration::from_micros(500);
/// What a callback between pictures may take.
const GRAPHICS_BUDGET: Duration = Duration::from_millis(4);
/// A slow plugin is reported at once, and then at most this often.
const REPORT_PERIOD: Duration = Duration::from_secs(10);

/// What the host needs to know to load plugins.
#[derive(Clone, Default)]
pub struct PluginSetup {
    /// Plugins that are part of the program.
    pub registry: Registry,
    /// Where libraries are looked for.
    pub search: Search,
    /// The command line of the program, which plugins may read.
    pub arguments: Vec<String>,
    /// Simulator plugins of the command line, as written; they are loaded before those of the launch file.
    pub command_line: Vec<PathBuf>,
    /// Simulator plugins of the launch file.
    pub launch: Vec<PluginEntry>,
}

/// What came of loading plugins.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PluginReport {
    /// One line a plugin that is running, in the order of loading.
    pub loaded: Vec<String>,
    /// One line a plugin that is left out: where it is declared, which step failed and why.
    pub problems: Vec<String>,
}

/// Plugins that are called together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Plugins of the world.
    World,
    /// Models and their objects.
    Models,
    /// Plugins of the simulator.
    Simulator,
}

/// Calls before a share of them says anything.
const FEW_CALLS: u32 = 10;
/// A plugin is slow if one of so many calls is.
const SLOW_SHARE: u32 = 20;
/// A plugin is slow, too, if its slow calls take so long together within a [`REPORT_PERIOD`].
const SLOW_TIME: Duration = Duration::from_secs(1);

/// How long callbacks take, in windows of a [`REPORT_PERIOD`]. A few calls that take long are not the plugin's fault on a
/// busy computer, where the thread is preempted.
struct Meter {
    budget: Duration,
    window_end: Option<Instant>,
    calls: u32,
    over: u32,
    /// Total duration of the calls over the budget.
    time: Duration,
    worst: Duration,
    is_reported: bool,
}

impl Meter {
    fn new(budget: Duration) -> Self {
        Self {
            budget,
            window_end: None,
            calls: 0,
            over: 0,
            time: Duration::ZERO,
            worst: Duration::ZERO,
            is_reported: false,
        }
    }

    /// Counts a call that ended at `now`; a clause when the plugin is slow, once a window.
    fn record(&mut self, took: Duration, now: Instant) -> Option<String> {
        if self.window_end.is_none_or(|end| now >= end) {
            *self = Self { window_end: Some(now + REPORT_PERIOD), ..Self::new(self.budget) };
        }
        self.calls += 1;
        if took <= self.budget {
            return None;
        }
        self.over += 1;
        self.time += took;
        self.worst = self.worst.max(took);
        let is_often = self.calls >= FEW_CALLS && self.over * SLOW_SHARE >= self.calls;
        if self.is_reported || !(is_often || self.time >= SLOW_TIME) {
            return None;
        }
        self.is_reported = true;
        let ms = |time: Duration| time.as_secs_f64() * 1e3;
        Some(format!(
            "{} of {} calls took longer than {} ms, the longest {:.2} ms",
            self.over,
            self.calls,
            ms(self.budget),
            ms(self.worst)
        ))
    }
}

struct Slot {
    number: u64,
    handle: String,
    subject: Subject,
    /// Index of the model it belongs to.
    model: Option<usize>,
    /// `None`: it was closed.
    plugin: Option<AnyPlugin>,
    panics: u32,
    physics: Meter,
    graphics: Meter,
}

/// The plugins of a simulation.
pub struct Plugins {
    /// What is loaded from where.
    pub setup: PluginSetup,
    /// In the order of loading.
    slots: Vec<Slot>,
    /// Indices into `slots` in the order of calls.
    world: Vec<usize>,
    models: Vec<usize>,
    simulator: Vec<usize>,
    /// The plugins' end of the exchange.
    pub shared: Arc<Shared>,
    /// The physics thread's end.
    pub incoming: Incoming,
    next_number: u64,
    /// What there is to say.
    pub notices: Vec<String>,
}

/// A plugin that is to be loaded: its entry, what it is declared on, the YAML there.
pub struct Wanted<'a> {
    /// Name and file.
    pub entry: &'a PluginEntry,
    /// What it is declared on.
    pub subject: Subject,
    /// Index of the model to which that belongs.
    pub model: Option<usize>,
    /// Text of the YAML node.
    pub node: String,
    /// Folder of the file, to which relative paths belong.
    pub directory: PathBuf,
}

impl Plugins {
    /// No plugins yet; what they draw will go into `drawings`.
    pub fn new(setup: PluginSetup, drawings: Drawings) -> Self {
        let (shared, incoming) = Shared::new(drawings);
        Self {
            setup,
            slots: Vec::new(),
            world: Vec::new(),
            models: Vec::new(),
            simulator: Vec::new(),
            shared,
            incoming,
            next_number: 0,
            notices: Vec::new(),
        }
    }

    /// Whether any was loaded.
    pub fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// Loads and starts a plugin.
    ///
    /// # Errors
    /// [`PluginError`]: no such file or built-in plugin, another interface, a refusal or a panic of its `init`.
    pub fn load(&mut self, access: &mut dyn Access, wanted: Wanted<'_>) -> Result<(), PluginError> {
        let Wanted { entry, subject, model, node, directory } = wanted;
        let number = self.next_number;
        self.next_number += 1;
        let desk = Arc::new(Desk::new(&entry.name, number, Arc::clone(&self.shared)));
        let made = self.make(entry, subject, &desk);
        let mut plugin = made.inspect_err(|_| self.shared.drawings.close(number))?;
        access.act_as(number);
        let mut context = InitContext {
            world: View::new(access, subject),
            host: Host(desk),
            handle: entry.name.clone(),
            node,
            directory,
            arguments: self.setup.arguments.clone(),
        };
        let started = caught(|| plugin.common().init(&mut context));
        let started = started.unwrap_or_else(|panic| Err(PluginError::Panicked(panic)));
        if let Err(error) = started {
            self.drop_plugin(&entry.name, plugin);
            self.shared.drawings.close(number);
            access.release(number);
            return Err(error);
        }
        self.slots.push(Slot {
            number,
            handle: entry.name.clone(),
            subject,
            model,
            plugin: Some(plugin),
            panics: 0,
            physics: Meter::new(PHYSICS_BUDGET),
            graphics: Meter::new(GRAPHICS_BUDGET),
        });
        Ok(())
    }

    fn make(&self, entry: &PluginEntry, subject: Subject, desk: &Arc<Desk>) -> Result<AnyPlugin, PluginError> {
        let kind = subject.kind();
        if let Some(name) = builtin(entry).or_else(|| stand_in(&self.setup.registry, entry)) {
            return caught(|| self.setup.registry.make(name, kind))
                .unwrap_or_else(|panic| Err(PluginError::Panicked(panic)));
        }
        library::load(&resolve(&self.setup.search, entry)?, kind, desk)
    }

    /// Dropping is foreign code, too.
    fn drop_plugin(&mut self, handle: &str, plugin: AnyPlugin) {
        if let Err(panic) = caught(|| drop(plugin)) {
            self.notices.push(format!("plugin {handle} panicked when it was dropped: {panic}"));
        }
    }

    /// Brings the order of calls up to date. `key` sorts models by theirs and the objects in them; world and simulator
    /// plugins keep the order of loading.
    pub fn arrange<K: Ord>(&mut self, key: impl Fn(usize, Option<ObjectId>) -> K) {
        let of = |slots: &[Slot], wanted: fn(&Subject) -> bool| {
            (0..slots.len()).filter(|&i| slots[i].plugin.is_some() && wanted(&slots[i].subject)).collect::<Vec<_>>()
        };
        self.world = of(&self.slots, |subject| *subject == Subject::World);
        self.simulator = of(&self.slots, |subject| *subject == Subject::Simulator);
        self.models = of(&self.slots, |subject| matches!(subject, Subject::Model(_) | Subject::Object(_)));
        let slots = &self.slots;
        // Stable: plugins of one object keep the order of loading.
        self.models.sort_by_cached_key(|&i| match slots[i].subject {
            Subject::Object(object) => key(slots[i].model.unwrap_or(0), Some(object)),
            _ => key(slots[i].model.unwrap_or(0), None),
        });
    }

    fn order(&self, phase: Phase) -> &[usize] {
        match phase {
            Phase::World => &self.world,
            Phase::Models => &self.models,
            Phase::Simulator => &self.simulator,
        }
    }

    /// Calls the plugins of a phase after a step of `dt` s.
    pub fn update(&mut self, access: &mut dyn Access, phase: Phase, dt: f64) {
        for i in 0..self.order(phase).len() {
            let slot = self.order(phase)[i];
            self.call(access, slot, "physics_update", |plugin, world| plugin.common().physics_update(world, dt));
        }
    }

    /// Tells all plugins of a reset.
    pub fn reset(&mut self, access: &mut dyn Access) {
        for phase in [Phase::World, Phase::Models, Phase::Simulator] {
            for i in 0..self.order(phase).len() {
                let slot = self.order(phase)[i];
                self.call(access, slot, "reset", |plugin, world| plugin.common().reset(world));
            }
        }
    }

    /// Whether any plugin is notified of new models and objects.
    pub fn watches_models(&self) -> bool {
        let watches = |slot: &Slot| matches!(slot.subject, Subject::World | Subject::Model(_));
        self.slots.iter().any(watches)
    }

    /// Tells world plugins, and those of the model itself, of a model and its objects.
    pub fn model_changed(&mut self, access: &mut dyn Access, model: usize, objects: &[ObjectId], added: bool) {
        let what = if added { ("on_object_add", "on_model_add") } else { ("on_object_removal", "on_model_removal") };
        let of = |subject| {
            let slots = self.slots.iter().enumerate();
            slots.filter(|(_, slot)| slot.subject == subject).map(|(i, _)| i).collect::<Vec<_>>()
        };
        let (worlds, own) = (of(Subject::World), of(Subject::Model(model)));
        for &object in objects {
            for &slot in worlds.iter().chain(&own) {
                self.call(access, slot, what.0, |plugin, world| plugin.object_changed(world, added, object));
            }
        }
        for &slot in &worlds {
            self.call(access, slot, what.1, |plugin, world| plugin.model_changed(world, added, model));
        }
    }

    /// Calls all plugins after a picture: world, models and objects, simulator.
    pub fn graphics_update(&mut self) {
        for phase in [Phase::World, Phase::Models, Phase::Simulator] {
            for i in 0..self.order(phase).len() {
                let slot = self.order(phase)[i];
                self.guard(slot, "graphics_update", true, |plugin| plugin.common().graphics_update());
            }
        }
    }

    /// Tells simulator plugins of a use of a window.
    pub fn input(&mut self, input: &Input) {
        let what = match input {
            Input::Key { .. } => "keyboard_update",
            Input::Button { .. } => "mouse_buttons_update",
            Input::Position { .. } => "mouse_position_update",
            Input::Scroll { .. } => "mouse_scroll_update",
        };
        for i in 0..self.simulator.len() {
            self.guard(self.simulator[i], what, true, |plugin| plugin.input(input));
        }
    }

    fn call(
        &mut self,
        access: &mut dyn Access,
        slot: usize,
        what: &str,
        call: impl FnOnce(&mut AnyPlugin, &mut View<'_>),
    ) {
        let Slot { number, subject, .. } = self.slots[slot];
        access.act_as(number);
        self.guard(slot, what, false, |plugin| call(plugin, &mut View::new(access, subject)));
        if self.slots[slot].plugin.is_none() {
            access.release(number);
        }
    }

    /// Calls a plugin; a panic ends here, and the third one ends the plugin.
    fn guard(&mut self, slot: usize, what: &str, graphics: bool, call: impl FnOnce(&mut AnyPlugin)) {
        let held = &mut self.slots[slot];
        let Some(plugin) = &mut held.plugin else { return };
        let begin = Instant::now();
        let outcome = caught(|| call(plugin));
        let end = Instant::now();
        let meter = if graphics { &mut held.graphics } else { &mut held.physics };
        if let Some(clause) = meter.record(end - begin, end) {
            self.notices.push(format!("plugin {} is slow: in {what}, {clause}", held.handle));
        }
        let Err(message) = outcome else { return };
        held.panics += 1;
        let count = held.panics;
        let handle = &held.handle;
        self.notices.push(format!("plugin {handle} panicked in {what} ({count} of {MAX_PANICS}): {message}"));
        if count == MAX_PANICS {
            self.notices.push(format!("plugin {handle} is closed because it panicked {MAX_PANICS} times"));
            self.close_slot(slot);
        }
    }

    /// Closes a plugin unless it is closed.
    fn close_slot(&mut self, slot: usize) {
        let Some(mut plugin) = self.slots[slot].plugin.take() else { return };
        let handle = self.slots[slot].handle.clone();
        if let Err(panic) = caught(|| plugin.common().close()) {
            self.notices.push(format!("plugin {handle} panicked in close: {panic}"));
        }
        self.drop_plugin(&handle, plugin);
        self.shared.drawings.close(self.slots[slot].number);
    }

    /// Closes what `which` is true for: simulator, object, model and world plugins, each in the reverse order of
    /// loading.
    fn close_where(&mut self, mut access: Option<&mut dyn Access>, which: impl Fn(&Slot) -> bool) {
        let rank = |slot: &Slot| match slot.subject {
            Subject::Simulator => 0,
            Subject::Object(_) => 1,
            Subject::Model(_) => 2,
            Subject::World => 3,
        };
        let mut order: Vec<usize> = (0..self.slots.len()).filter(|&i| which(&self.slots[i])).rev().collect();
        order.sort_by_key(|&i| rank(&self.slots[i]));
        for slot in order {
            self.close_slot(slot);
            if let Some(access) = &mut access {
                access.release(self.slots[slot].number);
            }
        }
    }

    /// Closes the plugins of a model and its objects.
    pub fn close_model(&mut self, access: &mut dyn Access, model: usize) {
        self.close_where(Some(access), |slot| slot.model == Some(model));
    }

    /// Closes all plugins.
    pub fn close(&mut self, access: &mut dyn Access) {
        self.close_where(Some(access), |_| true);
    }
}

impl Drop for Plugins {
    fn drop(&mut self) {
        self.close_where(None, |_| true);
    }
}

impl PluginSetup {
    /// Whether there is something to load for an entry, without loading it: nothing of it runs.
    ///
    /// # Errors
    /// [`PluginError::Builtin`], [`PluginError::NotFound`], [`PluginError::Cpp`].
    pub fn check(&self, entry: &PluginEntry) -> Result<(), PluginError> {
        match builtin(entry).or_else(|| stand_in(&self.registry, entry)) {
            Some(name) => self.registry.check(name),
            None => self.search.look_up(entry).map(|_| ()),
        }
    }
}

/// Name of a built-in plugin.
fn builtin(entry: &PluginEntry) -> Option<&str> {
    entry.filename.to_str()?.strip_prefix(BUILTIN)
}

/// The built-in plugin that stands in for a public one of the C++ program.
pub(super) fn stand_in<'n>(registry: &Registry, entry: &PluginEntry) -> Option<&'n str> {
    const STAND_INS: [(&str, &str); 2] = [("libambf_crtk", "crtk"), ("libvolumetric_drilling", "drill")];
    let file = entry.filename.file_name()?.to_str()?;
    let found = STAND_INS.iter().find(|(start, _)| file.starts_with(start));
    found.map(|(_, name)| *name).filter(|name| registry.check(name).is_ok())
}

/// The file of an entry. The dynamic loader is asked for a bare name that no folder holds.
pub(super) fn resolve(search: &Search, entry: &PluginEntry) -> Result<PathBuf, PluginError> {
    match search.look_up(entry) {
        Err(PluginError::NotFound { tried, .. }) if entry.filename.components().count() == 1 => {
            match library::open(Path::new(&entry.filename)) {
                Err(PluginError::Open { why, .. }) => Err(PluginError::NotFound { tried, loader: Some(why) }),
                other => other.map(|_| entry.filename.clone()),
            }
        }
        found => found,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_plugins_are_told_from_preempted_ones() {
        let (budget, begin) = (Duration::from_micros(500), Instant::now());
        let told = |slow_every: u32, slow: Duration| {
            let mut meter = Meter::new(budget);
            let call = |i: u32| match i % slow_every {
                0 => meter.record(slow, begin + Duration::from_millis(u64::from(i))),
                _ => meter.record(Duration::from_micros(50), begin + Duration::from_millis(u64::from(i))),
            };
            (1..30_000).filter_map(call).count()
        };
        assert_eq!(told(1, Duration::from_millis(1)), 3, "always: once a window");
        assert_eq!(told(15, Duration::from_millis(1)), 3, "often");
        assert_eq!(told(100, Duration::from_millis(3)), 0, "one of a hundred calls was preempted");
        assert_eq!(told(15_000, Duration::from_secs(2)), 1, "one call that hangs");
    }

    #[test]
    fn public_plugins_have_stand_ins_where_the_program_has_them() {
        let source = ambf_model::adf::SourcePos { file: Path::new("w.yaml").into(), line: 1, column: 1 };
        let entry = |filename: &str| PluginEntry {
            name: "p".into(),
            filename: filename.into(),
            path: None,
            source: source.clone(),
        };
        let crtk = entry("build/libambf_crtk_simulator_plugin.so");
        let mut registry = Registry::default();
        assert_eq!(stand_in(&registry, &crtk), None);
        registry.add("crtk", |_| None);
        assert_eq!(stand_in(&registry, &crtk), Some("crtk"));
        assert_eq!(stand_in(&registry, &entry("libambf_recording.so")), None);
        assert_eq!(stand_in(&registry, &entry("libvolumetric_drilling.so")), None);
        registry.add("drill", |_| None);
        assert_eq!(stand_in(&registry, &entry("../build/libvolumetric_drilling.so")), Some("drill"));
    }
}
