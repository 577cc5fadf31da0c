//! Plugins that write down how they are called, and scenes that have them.
#![allow(missing_docs)]

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};

use ambf_core::plugin::{
    AnyPlugin, InitContext, ModelPlugin, ObjectId, ObjectPlugin, Plugin, PluginError, PluginKind, PluginReport,
    PluginSetup, Registry, SimulatorPlugin, View, WorldPlugin,
};
use ambf_core::scene::{load, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;

/// What plugins were called with, in order: `handle:callback`, and the `dt` of physics updates.
#[derive(Clone, Default)]
pub struct Log(pub Arc<Mutex<Vec<(String, f64)>>>);

impl Log {
    fn push(&self, handle: &str, what: &str, dt: f64) {
        self.0.lock().unwrap().push((format!("{handle}:{what}"), dt));
    }

    /// Takes what was written.
    pub fn take(&self) -> Vec<String> {
        std::mem::take(&mut *self.0.lock().unwrap()).into_iter().map(|(line, _)| line).collect()
    }

    pub fn count(&self, line: &str) -> usize {
        self.0.lock().unwrap().iter().filter(|(written, _)| written == line).count()
    }

    /// The steps that a plugin was told of.
    pub fn steps_of(&self, handle: &str) -> Vec<f64> {
        let line = format!("{handle}:physics_update");
        self.0.lock().unwrap().iter().filter(|(written, _)| *written == line).map(|(_, dt)| *dt).collect()
    }
}

/// Writes down every call, and panics in the one that its `panics in` names.
pub struct Probe {
    log: Log,
    handle: String,
    panics_in: String,
    pub node: Arc<Mutex<Vec<(String, String, PathBuf)>>>,
}

impl Probe {
    fn note(&self, what: &str, dt: f64) {
        self.log.push(&self.handle, what, dt);
        if self.panics_in == what {
            panic!("as told in {what}");
        }
    }
}

impl Plugin for Probe {
    fn init(&mut self, context: &mut InitContext<'_>) -> Result<(), PluginError> {
        self.handle = context.handle().to_owned();
        let told = (self.handle.clone(), context.node().to_owned(), context.directory().to_owned());
        self.node.lock().unwrap().push(told);
        if let Some((_, what)) = self.handle.split_once(" panics in ") {
            self.panics_in = what.to_owned();
        }
        self.note("init", 0.0);
        if self.handle.contains("fails") {
            return Err("as told".into());
        }
        Ok(())
    }

    fn physics_update(&mut self, _: &mut View<'_>, dt: f64) {
        self.note("physics_update", dt);
    }

    fn graphics_update(&mut self) {
        self.note("graphics_update", 0.0);
    }

    fn reset(&mut self, _: &mut View<'_>) {
        self.note("reset", 0.0);
    }

    fn close(&mut self) {
        self.note("close", 0.0);
    }
}

impl SimulatorPlugin for Probe {
    fn keyboard_update(&mut self, _: u32, _: i32, _: i32, _: i32, _: i32) {
        self.note("keyboard_update", 0.0);
    }

    fn mouse_buttons_update(&mut self, _: u32, _: i32, _: i32, _: i32) {
        self.note("mouse_buttons_update", 0.0);
    }

    fn mouse_position_update(&mut self, _: u32, _: f64, _: f64) {
        self.note("mouse_position_update", 0.0);
    }

    fn mouse_scroll_update(&mut self, _: u32, _: f64, _: f64) {
        self.note("mouse_scroll_update", 0.0);
    }
}

impl WorldPlugin for Probe {
    fn on_model_add(&mut self, world: &mut View<'_>, model: usize) {
        let key = world.model_key(model).unwrap();
        self.log.push(&self.handle, &format!("model {key} +"), 0.0);
        self.note("on_model_add", 0.0);
    }

    fn on_model_removal(&mut self, world: &mut View<'_>, model: usize) {
        let key = world.model_key(model).unwrap();
        self.log.push(&self.handle, &format!("model {key} -"), 0.0);
        self.note("on_model_removal", 0.0);
    }

    fn on_object_add(&mut self, world: &mut View<'_>, object: ObjectId) {
        self.log.push(&self.handle, &format!("{} +", world.identifier(object).unwrap()), 0.0);
        self.note("on_object_add", 0.0);
    }

    fn on_object_removal(&mut self, world: &mut View<'_>, object: ObjectId) {
        self.log.push(&self.handle, &format!("{} -", world.identifier(object).unwrap()), 0.0);
        self.note("on_object_removal", 0.0);
    }
}

impl ModelPlugin for Probe {
    fn on_object_add(&mut self, world: &mut View<'_>, object: ObjectId) {
        self.log.push(&self.handle, &format!("{} +", world.identifier(object).unwrap()), 0.0);
    }

    fn on_object_removal(&mut self, world: &mut View<'_>, object: ObjectId) {
        self.log.push(&self.handle, &format!("{} -", world.identifier(object).unwrap()), 0.0);
    }
}

impl ObjectPlugin for Probe {}

/// A scene in a folder of its own, whose plugins are probes.
pub struct Stage {
    pub folder: PathBuf,
    pub log: Log,
    /// Handle, node and directory that each probe was given.
    pub told: Arc<Mutex<Vec<(String, String, PathBuf)>>>,
}

impl Stage {
    pub fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("ambf_plugins_{}_{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let folder = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&folder).unwrap();
        Self { folder, log: Log::default(), told: Arc::default() }
    }

    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, text).unwrap();
        path
    }

    pub fn setup(&self) -> PluginSetup {
        let mut registry = Registry::default();
        let (log, told) = (self.log.clone(), Arc::clone(&self.told));
        registry.add("probe", move |kind| {
            let probe =
                Probe { log: log.clone(), handle: String::new(), panics_in: String::new(), node: Arc::clone(&told) };
            Some(match kind {
                PluginKind::Simulator => AnyPlugin::Simulator(Box::new(probe)),
                PluginKind::World => AnyPlugin::World(Box::new(probe)),
                PluginKind::Model => AnyPlugin::Model(Box::new(probe)),
                PluginKind::Object => AnyPlugin::Object(Box::new(probe)),
            })
        });
        PluginSetup { registry, ..PluginSetup::default() }
    }

    /// A scene without its plugins.
    pub fn scene(&self, world: &str, models: &[&str]) -> Simulation {
        let files = SceneFiles {
            world: Some(self.write("world.yaml", world)),
            models: models.iter().enumerate().map(|(i, text)| self.write(&format!("m{i}.yaml"), text)).collect(),
        };
        let loaded = load(&files, &SceneOptions::default());
        assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
        Simulation::new(loaded.scene, 0.001)
    }

    /// A scene with its plugins; all of them must start.
    pub fn simulation(&self, world: &str, models: &[&str]) -> Simulation {
        let mut simulation = self.scene(world, models);
        let PluginReport { problems, .. } = simulation.load_plugins(self.setup());
        assert_eq!(problems, Vec::<String>::new());
        simulation
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// `plugins: [...]` with probes of these names.
pub fn probes(names: &[&str]) -> String {
    let entries: Vec<_> = names.iter().map(|name| format!("{{name: {name}, filename: 'builtin:probe'}}")).collect();
    format!("plugins: [{}]", entries.join(", "))
}

/// An entry of a launch file.
pub fn launch_entry(name: &str) -> ambf_core::adf::PluginEntry {
    let text = format!("plugins: [{{name: {name}, filename: 'builtin:probe'}}]\n");
    let (launch, _) = ambf_core::adf::parse::<ambf_core::adf::Launch>(&text, Path::new("launch.yaml")).unwrap();
    launch.plugins.into_iter().next().unwrap()
}

/// A model of a pendulum, with probes on the model, both bodies and the joint, whose names begin with `prefix`.
pub fn pendulum(namespace: &str, prefix: &str) -> String {
    let on = |what: &str| probes(&[&format!("{prefix}-{what}")]);
    format!(
        "bodies: [BODY Base, BODY Arm]\njoints: [J]\nnamespace: {namespace}\n{model}\n\
         BODY Base: {{name: Base, mass: 0, {ball}, {base}}}\n\
         BODY Arm: {{name: Arm, mass: 1, {ball}, location: {{position: {{x: 0.5, y: 0, z: 0}}}}, \
         inertia: {{ix: 0.01, iy: 0.01, iz: 0.01}}, {arm}}}\n\
         J: {{name: J, type: revolute, parent: BODY Base, child: BODY Arm, parent pivot: {{x: 0, y: 0, z: 0}}, \
         child pivot: {{x: -0.5, y: 0, z: 0}}, parent axis: {{x: 0, y: 1, z: 0}}, child axis: {{x: 0, y: 1, z: 0}}, {joint}}}\n",
        ball = "collision shape: Sphere, collision geometry: {radius: 0.01}",
        model = on("model"),
        base = on("base"),
        arm = on("arm"),
        joint = on("joint"),
    )
}

/// A world file with two probes.
pub fn world() -> String {
    format!("gravity: {{x: 0, y: 0, z: -10}}\nmax iterations: 50\nnamespace: /w/\n{}\n", probes(&["world1", "world2"]))
}

/// The shared library that an example of this crate makes. It is built first, unless `AMBF_EXAMPLES_ARE_BUILT` is set:
/// `scripts/test` has built all and runs lints beside the tests, for which cargo would wait.
pub fn library_of(example: &str) -> PathBuf {
    let program = std::env::current_exe().unwrap();
    let profile = program.ancestors().nth(2).unwrap();
    let library = profile.join(format!("examples/lib{example}.so"));
    if std::env::var_os("AMBF_EXAMPLES_ARE_BUILT").is_some() {
        return library;
    }
    let mut build = std::process::Command::new(env!("CARGO"));
    // As `cargo test --workspace` builds it: with the features of all packages, so that nothing is compiled twice.
    build.args(["build", "--quiet", "--workspace", "--example", example]);
    build.current_dir(env!("CARGO_MANIFEST_DIR")).arg("--target-dir").arg(profile.parent().unwrap());
    if profile.ends_with("release") {
        build.arg("--release");
    }
    let output = build.output().expect("cargo");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    library
}
