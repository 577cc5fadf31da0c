//! A scene with end-effectors, devices that drive them, and what is written down of both.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_core::adf::{self, InputDevice, InputDevices};
use ambf_core::control::Profile;
use ambf_core::device::host::{DeviceHost, HostOptions, News};
use ambf_core::device::law::Switches;
use ambf_core::device::{Driver, Drivers};
use ambf_core::plugin::{AnyPlugin, ObjectType, Plugin, PluginKind, PluginSetup, SimulatorPlugin, View};
use ambf_core::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::{Runner, RunnerOptions, Simulation};
use nalgebra::Vector3;
use parking_lot::Mutex;

use super::traced::{Trace, Traced};

/// Bullet's step, s.
pub const SUB_STEP: f64 = 0.001;
/// Most end-effectors of a scene.
pub const TOOLS: usize = 5;
/// Iterations that a log has room for without allocating.
const ROOM: usize = 120_000;

/// A scene to be written and loaded.
#[derive(Debug, Clone, Copy)]
pub struct Scenery {
    pub tools: usize,
    /// Boxes in stacks of two on the ground.
    pub boxes: usize,
    pub profile: Profile,
    /// Controller of the end-effectors, as in a model file.
    pub controller: &'static str,
    /// What pulls the end-effectors down, N/kg.
    pub gravity: f64,
}

/// For a body of 1 kg.
pub const CONTROLLER: &str = "{linear: {P: 1000, I: 0, D: 60}, angular: {P: 10, I: 0, D: 0.5}}";

impl Scenery {
    pub fn new(tools: usize, boxes: usize) -> Self {
        Self { tools, boxes, profile: Profile::Legacy, controller: CONTROLLER, gravity: 0.0 }
    }

    fn model(&self) -> String {
        let mut bodies: Vec<(String, String)> = (0..self.tools).map(|i| (format!("Tool{i}"), self.tool(i))).collect();
        if self.boxes > 0 {
            let ground = "mass: 0, collision shape: Box, collision geometry: {x: 40, y: 40, z: 0.2}, \
                          location: {position: {x: 0, y: 0, z: -0.1}}";
            bodies.push(("Ground".into(), ground.into()));
            bodies.extend((0..self.boxes).map(|i| (format!("Box{i}"), box_at(i, self.boxes))));
        }
        let keys: Vec<_> = bodies.iter().map(|(name, _)| format!("BODY {name}")).collect();
        let mut text = format!("bodies: [{}]\njoints: []\nignore inter-collision: false\n", keys.join(", "));
        for (name, body) in bodies {
            writeln!(text, "BODY {name}: {{name: {name}, {body}}}").expect("a text takes everything");
        }
        text
    }

    fn tool(&self, i: usize) -> String {
        let (controller, down) = (self.controller, -self.gravity);
        format!(
            "mass: 1, inertia: {{ix: 0.01, iy: 0.01, iz: 0.01}}, gravity: {{x: 0, y: 0, z: {down}}}, controller: {controller}, \
             collision shape: Sphere, collision geometry: {{radius: 0.05}}, location: {{position: {{x: {i}, y: 0, z: 10}}}}"
        )
    }

    /// Writes the model file.
    pub fn file(&self) -> PathBuf {
        written("devices_model.yaml", &self.model())
    }

    pub fn load(&self) -> Simulation {
        let world = written("devices_world.yaml", "namespace: /bench/\ngravity: {x: 0, y: 0, z: -9.81}\n");
        let model = self.file();
        let physics = PhysicsOptions { profile: Some(self.profile), ..PhysicsOptions::default() };
        let files = SceneFiles { world: Some(world), models: vec![model] };
        let loaded = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
        assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
        Simulation::new(loaded.scene, SUB_STEP)
    }
}

/// Stacks of two that do not touch each other: what they cost does not change while they rest.
fn box_at(i: usize, n: usize) -> String {
    let side = (1..).find(|side| side * side * 2 >= n).expect("there is a square for every number");
    let place = |i: usize| (i as f64 - side as f64 / 2.0) * 0.15;
    let (x, y, z) = (place(i % side), place(i / side % side), 0.05 + 0.1 * (i / (side * side)) as f64);
    format!(
        "mass: 0.1, restitution: 0, collision shape: Box, collision geometry: {{x: 0.1, y: 0.1, z: 0.1}}, \
         location: {{position: {{x: {x:.3}, y: {y:.3}, z: {z:.3}}}}}"
    )
}

fn written(name: &str, text: &str) -> PathBuf {
    let path = ambf_bench::folder().join(name);
    std::fs::write(&path, text).expect("the target folder can be written");
    path
}

/// One iteration of physics.
#[derive(Debug, Clone, Copy)]
pub struct Iteration {
    pub at: Instant,
    pub sim_time: f64,
    /// Body frames as devices are told, m.
    pub positions: [Vector3<f64>; TOOLS],
    /// m/s, at the end of the step.
    pub velocities: [Vector3<f64>; TOOLS],
}

/// Iterations until now.
#[derive(Debug, Clone, Default)]
pub struct Iterations(Arc<Mutex<Vec<Iteration>>>);

impl Iterations {
    /// All of them.
    pub fn all(&self) -> Vec<Iteration> {
        self.0.lock().clone()
    }

    pub fn push(&self, iteration: Iteration) {
        self.0.lock().push(iteration);
    }
}

/// A plugin that writes down iterations.
struct Watch {
    iterations: Iterations,
    tools: Option<Vec<usize>>,
}

impl Plugin for Watch {
    fn physics_update(&mut self, world: &mut View<'_>, _dt: f64) {
        let at = Instant::now();
        let find = || (0..TOOLS).map_while(|i| world.find(ObjectType::Body, &format!("Tool{i}"))).collect();
        let tools = self.tools.get_or_insert_with(find);
        let mut iteration = Iteration {
            at,
            sim_time: world.clock().sim_time,
            positions: [Vector3::zeros(); TOOLS],
            velocities: [Vector3::zeros(); TOOLS],
        };
        for (place, &tool) in tools.iter().enumerate() {
            if let Some(body) = world.body(tool) {
                iteration.positions[place] = body.pose.translation.vector;
                iteration.velocities[place] = body.linear_velocity;
            }
        }
        self.iterations.push(iteration);
    }
}

impl SimulatorPlugin for Watch {}

/// Lets `simulation` write down its iterations.
pub fn watch(simulation: &mut Simulation) -> Iterations {
    let iterations = Iterations::default();
    iterations.0.lock().reserve(ROOM);
    let mut setup = PluginSetup { command_line: vec!["builtin:watch".into()], ..PluginSetup::default() };
    let log = iterations.clone();
    setup.registry.add("watch", move |kind| {
        let watch = Watch { iterations: log.clone(), tools: None };
        (kind == PluginKind::Simulator).then(|| AnyPlugin::Simulator(Box::new(watch)))
    });
    let report = simulation.load_plugins(setup);
    assert!(report.problems.is_empty(), "{:?}", report.problems);
    iterations
}

/// A device to be had: its driver and its entry.
#[derive(Clone)]
pub struct Wanted {
    pub name: &'static str,
    pub driver: Arc<dyn Driver>,
    /// Keys of its entry beyond those that all have.
    pub keys: String,
}

/// Entries of devices that drive `Tool0`, `Tool1` …, and their drivers.
pub fn entries(wanted: &[Wanted]) -> (Vec<InputDevice>, Vec<Arc<dyn Driver>>, Vec<Trace>) {
    let names: Vec<_> = wanted.iter().map(|device| device.name).collect();
    let mut text = format!("input devices: [{}]\n", names.join(", "));
    let (mut drivers, mut traces): (Vec<Arc<dyn Driver>>, _) = (Vec::new(), Vec::new());
    for (i, device) in wanted.iter().enumerate() {
        let (name, keys) = (device.name, &device.keys);
        let line = format!("{name}: {{driver: traced{i}, root link: BODY Tool{i}, enable on button: false, {keys}}}");
        writeln!(text, "{line}").expect("a text takes everything");
        let (driver, trace) = Traced::new(&format!("traced{i}"), Arc::clone(&device.driver));
        drivers.push(Arc::new(driver));
        traces.push(trace);
    }
    let (list, report) = adf::parse::<InputDevices>(&text, Path::new("devices.yaml")).expect("a device file");
    assert_eq!(report.errors(), 0, "{report}");
    (list.entries.into_iter().flatten().collect(), drivers, traces)
}

/// Devices and physics, each in their threads as in `ambf_simulator`.
pub struct Rig {
    pub traces: Vec<Trace>,
    pub iterations: Iterations,
    host: DeviceHost,
    runner: Option<Runner>,
}

impl Rig {
    pub fn start(mut simulation: Simulation, wanted: &[Wanted], options: RunnerOptions) -> Self {
        let (entries, list, traces) = entries(wanted);
        let mut drivers = Drivers::default();
        list.into_iter().for_each(|driver| drivers.add(driver));
        let switches = Switches { forces: true, ..Switches::default() };
        let host_options = HostOptions { switches, ..HostOptions::default() };
        let entries: Vec<_> = entries.iter().collect();
        let (mut host, said) = DeviceHost::open(&entries, &drivers, &host_options);
        assert!(said.is_empty(), "{said:?}");
        let said = simulation.add_devices(&mut host);
        assert!(said.is_empty(), "{said:?}");
        let iterations = watch(&mut simulation);
        Self { traces, iterations, host, runner: Some(Runner::start(simulation, options)) }
    }

    /// What the host has to say.
    pub fn news(&mut self) -> Vec<News> {
        self.host.news()
    }

    /// Waits until all devices give valid samples, and then for `time`; returns when that was.
    pub fn settle(&self, time: Duration) -> Instant {
        let deadline = Instant::now() + Duration::from_secs(20);
        let begin = Instant::now();
        while !self.traces.iter().all(|trace| trace.is_valid_since(begin)) {
            assert!(Instant::now() < deadline, "a device gives no valid samples: {:?}", self.host.status());
            std::thread::sleep(Duration::from_millis(20));
        }
        std::thread::sleep(time);
        Instant::now()
    }

    /// Ends physics, then the devices.
    pub fn stop(mut self) {
        let runner = self.runner.take().expect("it runs until here");
        let paused = runner.control().is_paused();
        assert!(runner.stop().is_some() && !paused, "physics ends in good order");
        self.host.stop();
    }
}
