//! When plugins are called, in which order, and what becomes of those that fail.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::plugin_common::{launch_entry, pendulum, probes, world, Stage};
use ambf_core::comm::Hub;
use ambf_core::ids::BodyId;
use ambf_core::plugin::{Input, ObjectType, PluginSetup};
use ambf_core::scene::PreparedModel;
use ambf_core::sim::{Event, Runner, RunnerOptions, Simulation};

/// World, two models (added in the order b, a) and simulator plugins from the command line and the launch file.
fn full(stage: &Stage) -> Simulation {
    let mut simulation = stage.scene(&world(), &[&pendulum("/b/", "b"), &pendulum("/a/", "a")]);
    let launch = launch_entry("launch");
    let setup = PluginSetup { command_line: vec!["builtin:probe".into()], launch: vec![launch], ..stage.setup() };
    let report = simulation.load_plugins(setup);
    // The launch file of this test is not on the disk.
    assert!(report.problems.len() == 1 && report.problems[0].contains("own keys"), "{:?}", report.problems);
    assert_eq!(report.loaded.len(), 12, "{:?}", report.loaded);
    simulation
}

const LOADED: [&str; 12] = [
    "world1",
    "world2",
    "b-base",
    "b-arm",
    "b-joint",
    "b-model",
    "a-base",
    "a-arm",
    "a-joint",
    "a-model",
    "builtin:probe",
    "launch",
];
/// Models by key; in a model the model, then its objects by type and identifier.
const CALLED: [&str; 12] = [
    "world1",
    "world2",
    "a-model",
    "a-arm",
    "a-base",
    "a-joint",
    "b-model",
    "b-arm",
    "b-base",
    "b-joint",
    "builtin:probe",
    "launch",
];

fn lines(names: &[&str], what: &str) -> Vec<String> {
    names.iter().map(|name| format!("{name}:{what}")).collect()
}

fn only(log: Vec<String>, what: &str) -> Vec<String> {
    log.into_iter().filter(|line| line.ends_with(&format!(":{what}"))).collect()
}

#[test]
fn plugins_are_loaded_called_and_closed_in_order() {
    let stage = Stage::new();
    let mut simulation = full(&stage);
    assert_eq!(only(stage.log.take(), "init"), lines(&LOADED, "init"));
    for _ in 0..100 {
        simulation.iterate(0.001).unwrap();
        assert_eq!(stage.log.take(), lines(&CALLED, "physics_update"));
    }
    simulation.reset_bodies();
    assert_eq!(stage.log.take(), Vec::<String>::new(), "a reset of bodies calls nothing");
    simulation.reset_world();
    assert_eq!(stage.log.take(), lines(&CALLED, "reset"));
    simulation.close_plugins();
    let closed = [
        "launch",
        "builtin:probe",
        "a-joint",
        "a-arm",
        "a-base",
        "b-joint",
        "b-arm",
        "b-base",
        "a-model",
        "b-model",
        "world2",
        "world1",
    ];
    assert_eq!(stage.log.take(), lines(&closed, "close"));
    simulation.close_plugins();
    simulation.iterate(0.001).unwrap();
    drop(simulation);
    assert_eq!(stage.log.take(), Vec::<String>::new(), "each is closed once");
}

#[test]
fn every_plugin_is_told_the_step_that_was_made() {
    let stage = Stage::new();
    let mut simulation = full(&stage);
    stage.log.take();
    let steps = [0.001, 0.002, 0.0005, 0.0, -1.0, f64::NAN, 0.004];
    for interval in steps {
        simulation.iterate(interval).unwrap();
    }
    for handle in CALLED {
        let told = stage.log.steps_of(handle);
        assert_eq!(told, [0.001, 0.002, 0.0005, 0.004], "{handle}");
        assert!((told.iter().sum::<f64>() - simulation.sim_time()).abs() < 1e-12);
    }
}

fn wait_until(what: &str, done: impl Fn() -> bool) {
    let begin = Instant::now();
    while !done() {
        assert!(begin.elapsed() < Duration::from_secs(20), "{what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn paused_plugins_rest_and_manual_steps_call_all_alike() {
    let stage = Stage::new();
    let mut simulation = full(&stage);
    stage.log.take();
    let _ = simulation.connect();
    let runner = Runner::start(simulation, RunnerOptions { fixed_step: true, ..RunnerOptions::default() });
    runner.control().set_paused(true);
    let count = || CALLED.map(|handle| stage.log.count(&format!("{handle}:physics_update")));
    wait_until("nothing is called while paused", || {
        let before = count();
        std::thread::sleep(Duration::from_millis(100));
        count() == before
    });
    let mut expected = count();
    for steps in [10, 1] {
        expected = expected.map(|n| n + steps);
        runner.control().step(steps as u32);
        wait_until("steps were made", || count() == expected);
    }
    let simulation = runner.stop().expect("no panic");
    assert_eq!(count(), expected, "ten and one and no more");
    let told = stage.log.steps_of("launch");
    assert!((told.iter().sum::<f64>() - simulation.sim_time()).abs() < 1e-9);
    drop(simulation);
    assert_eq!(only(stage.log.take(), "close").len(), 12);
}

fn reset_through(stage: &Stage, request: impl FnOnce(&Hub)) -> Vec<String> {
    let mut simulation = full(stage);
    stage.log.take();
    let hub = simulation.connect();
    let runner = Runner::start(simulation, RunnerOptions::default());
    runner.control().set_paused(true);
    request(&hub);
    wait_until("the reset is reported", || runner.events().try_iter().any(|event| event == Event::Reset));
    drop(runner);
    only(stage.log.take(), "reset")
}

#[test]
fn a_reset_by_a_client_reaches_all_kinds_once() {
    let stage = Stage::new();
    assert_eq!(reset_through(&stage, |hub| hub.request_world_reset()), lines(&CALLED, "reset"));
    let stage = Stage::new();
    assert_eq!(reset_through(&stage, |hub| hub.request_body_reset()), Vec::<String>::new());
}

#[test]
fn a_plugin_that_cannot_start_is_left_out_and_never_closed() {
    let stage = Stage::new();
    let world = format!("{}\n", probes(&["good", "fails", "x panics in init", "last"]));
    let mut simulation = stage.scene(&world, &[]);
    let report = simulation.load_plugins(stage.setup());
    assert_eq!(report.loaded.len(), 2, "{:?}", report.loaded);
    let [failed, panicked] = report.problems.as_slice() else { panic!("{:?}", report.problems) };
    assert!(failed.contains("world.yaml:1:") && failed.contains("plugin fails (builtin:probe)"), "{failed}");
    assert!(failed.ends_with("it cannot start: as told"), "{failed}");
    assert!(panicked.ends_with("it panicked at its start: as told in init"), "{panicked}");
    drop(simulation);
    assert_eq!(only(stage.log.take(), "close"), lines(&["last", "good"], "close"));
}

#[test]
fn what_cannot_be_found_is_named_with_the_paths_tried() {
    let stage = Stage::new();
    let world = "plugins:\n  - {name: p, filename: libabsent_of_tests.so, path: own}\n  - {filename: x.so}\n  \
                 - {name: b, filename: 'builtin:absent'}\n  - {name: c, filename: libambf_crtk_simulator_plugin.so}\n";
    let mut simulation = stage.scene_with_errors(world);
    let mut setup = stage.setup();
    setup.search.folders = vec![PathBuf::from("/nowhere")];
    let problems = simulation.load_plugins(setup).problems;
    let [absent, builtin, cpp] = problems.as_slice() else { panic!("{problems:#?}") };
    let own = stage.folder.join("own/libabsent_of_tests.so");
    for part in ["world.yaml:2:", &own.display().to_string(), "/nowhere/libabsent_of_tests.so", "system's folders"] {
        assert!(absent.contains(part), "{part} is not in {absent}");
    }
    assert!(builtin.contains("no built-in plugin `absent`; there is probe"), "{builtin}");
    assert!(cpp.contains("C++") && cpp.contains("does not serve the CRTK topics"), "{cpp}");
    simulation.iterate(0.001).unwrap();
}

#[test]
fn a_panic_stays_in_its_plugin_and_the_third_one_closes_it() {
    for (what, calls) in [("physics_update", 3), ("reset", 3), ("graphics_update", 3)] {
        let stage = Stage::new();
        let bad = format!("bad panics in {what}");
        let mut simulation = stage.simulation(&probes(&["before", &bad, "after"]), &[]);
        let mut notices = Vec::new();
        for _ in 0..5 {
            simulation.iterate(0.001).unwrap();
            simulation.reset_world();
            simulation.plugins_after_picture();
            notices.extend(simulation.take_notices());
        }
        let count = |handle: &str, what: &str| stage.log.count(&format!("{handle}:{what}"));
        assert_eq!((count("before", what), count("after", what)), (5, 5));
        assert_eq!((count(&bad, what), count(&bad, "close")), (calls, 1), "{what}");
        let third = format!("plugin {bad} panicked in {what} (3 of 3): as told in {what}");
        assert!(notices.contains(&third), "{notices:?}");
        assert!(notices.iter().any(|notice| notice.contains("is closed because it panicked 3 times")), "{notices:?}");
        drop(simulation);
        assert_eq!(count(&bad, "close"), 1, "not again at the end");
    }
}

#[test]
fn panics_in_rare_callbacks_are_caught_too() {
    let stage = Stage::new();
    let callbacks = ["on_object_add", "on_model_add", "on_object_removal", "on_model_removal", "close"];
    let names: Vec<String> = callbacks.iter().map(|what| format!("{what} panics in {what}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut simulation = stage.simulation(&probes(&names), &[&pendulum("/a/", "a")]);
    simulation.remove_model("/a/m0.yaml").unwrap();
    let window = ["keyboard_update", "mouse_buttons_update", "mouse_position_update", "mouse_scroll_update"];
    simulation.close_plugins();
    let notices = simulation.take_notices();
    for what in callbacks {
        assert!(notices.iter().any(|notice| notice.contains(&format!("panicked in {what}"))), "{what}: {notices:#?}");
    }

    let command_line: Vec<PathBuf> = vec!["builtin:probe".into()];
    for (what, input) in window.into_iter().zip([
        Input::Key { window: 0, key: 65, scancode: 0, action: 1, mods: 0 },
        Input::Button { window: 0, button: 0, action: 1, mods: 0 },
        Input::Position { window: 0, x: 1.0, y: 2.0 },
        Input::Scroll { window: 0, x: 0.0, y: 1.0 },
    ]) {
        let mut setup = PluginSetup { command_line: command_line.clone(), ..stage.setup() };
        setup.launch = vec![launch_entry(&format!("bad panics in {what}"))];
        let mut simulation = stage.scene("gravity: {x: 0, y: 0, z: 0}\n", &[]);
        simulation.load_plugins(setup);
        stage.log.take();
        simulation.plugins_input(&input);
        assert_eq!(stage.log.take(), [format!("builtin:probe:{what}"), format!("bad panics in {what}:{what}")]);
        // On a busy machine it may also be said that a callback takes long.
        let notices = simulation.take_notices();
        assert_eq!(notices.iter().filter(|notice| notice.contains("panicked")).count(), 1, "{notices:?}");
    }
}

#[test]
fn models_that_come_and_go_bring_their_plugins_and_are_announced() {
    let stage = Stage::new();
    let world = format!("{}\nnamespace: /w/\n", probes(&["w"]));
    let mut simulation = stage.simulation(&world, &[]);
    stage.log.take();
    let guest = stage.write("guest.yaml", &pendulum("/g/", "g"));
    let added = simulation.add_model(PreparedModel::read(&guest).unwrap()).expect("something is built");
    assert_eq!((added.report.as_str(), added.incomplete), ("", false));
    let notes = |sign: &str| {
        let mut lines = Vec::new();
        for object in ["/g/BODY Arm", "/g/BODY Base", "/g/J"] {
            lines.extend([format!("w:{object} {sign}"), "w:NOTE".into(), format!("g-model:{object} {sign}")]);
        }
        let what =
            if sign == "+" { ("on_object_add", "on_model_add") } else { ("on_object_removal", "on_model_removal") };
        let mut lines: Vec<String> = lines.into_iter().map(|line| line.replace("NOTE", what.0)).collect();
        lines.extend([format!("w:model /g/guest.yaml {sign}"), format!("w:{}", what.1)]);
        lines
    };
    let mut expected = lines(&["g-base", "g-arm", "g-joint", "g-model"], "init");
    expected.extend(notes("+"));
    assert_eq!(stage.log.take(), expected);
    simulation.iterate(0.001).unwrap();
    let order = ["w", "g-model", "g-arm", "g-base", "g-joint"];
    assert_eq!(stage.log.take(), lines(&order, "physics_update"));

    simulation.remove_model("guest").unwrap();
    let mut gone = notes("-");
    gone.extend(lines(&["g-joint", "g-arm", "g-base", "g-model"], "close"));
    assert_eq!(stage.log.take(), gone);
    // The same in the places of the first.
    let places = simulation.scene().bodies.len();
    let added = simulation.add_model(PreparedModel::read(&guest).unwrap()).expect("something is built");
    assert_eq!((added.report.as_str(), simulation.scene().bodies.len()), ("", places));
    assert_eq!(stage.log.take(), expected);
    simulation.remove_model("guest").unwrap();
    assert_eq!(stage.log.take(), gone);
    simulation.iterate(0.001).unwrap();
    assert_eq!(stage.log.take(), lines(&["w"], "physics_update"));
    drop(simulation);
    assert_eq!(stage.log.take(), lines(&["w"], "close"));
}

#[test]
fn plugins_are_told_what_stands_where_they_are_declared() {
    let stage = Stage::new();
    let plugin = |name: &str| probes(&[name]);
    let model = format!(
        "bodies: [BODY B]\nghost objects: [G]\nsensors: [S]\nactuators: [A]\ncameras: [C]\nlights: [L]\nvolumes: [V]\n{}\nown: 1\n\
         BODY B:\n  name: B\n  mass: 1\n  # a comment\n  {}\n  crtk config: {{a: [1, 'x y']}}\n\
         G: {{name: G, {}, collision shape: Sphere, collision geometry: {{radius: 0.1}}}}\n\
         S: {{name: S, {}, type: Proximity, parent: BODY B, array: [{{offset: {{x: 0, y: 0, z: 0}}, direction: {{x: 0, y: 0, z: -1}}}}]}}\n\
         A: {{name: A, {}, type: Constraint, parent: BODY B}}\n\
         C: {{name: C, {}, location: {{x: 1, y: 0, z: 0}}, look at: {{x: 0, y: 0, z: 0}}, up: {{x: 0, y: 0, z: 1}}}}\n\
         L: {{name: L, {}, location: {{x: 1, y: 0, z: 0}}}}\nV: {{name: V, {}}}\n",
        plugin("model"), plugin("body"), plugin("ghost"), plugin("sensor"), plugin("actuator"), plugin("camera"),
        plugin("light"), plugin("volume"),
    );
    let path = stage.write("sub/model.yaml", &model);
    let files = ambf_core::scene::SceneFiles { world: None, models: vec![path.clone()] };
    let loaded = ambf_core::scene::load(&files, &Default::default());
    let mut simulation = Simulation::new(loaded.scene, 0.001);
    let report = simulation.load_plugins(stage.setup());
    assert_eq!(report.problems, Vec::<String>::new());
    let told = stage.told.lock().unwrap().clone();
    let handles: Vec<_> = told.iter().map(|(handle, ..)| handle.as_str()).collect();
    assert_eq!(handles, ["body", "ghost", "sensor", "actuator", "camera", "light", "volume", "model"]);
    assert!(told.iter().all(|(_, _, directory)| directory == path.parent().unwrap()));
    let node = |handle: &str| &told.iter().find(|(other, ..)| other == handle).unwrap().1;
    assert_eq!(*node("model"), model);
    let entry = "plugins: [{name: body, filename: \"builtin:probe\"}]";
    assert_eq!(*node("body"), format!("name: B\nmass: 1\n{entry}\ncrtk config: {{a: [1, x y]}}\n"));
    assert!(node("volume").starts_with("name: V\n"), "{}", node("volume"));
}

#[test]
fn a_scene_without_plugins_is_bit_for_bit_the_same() {
    let stage = Stage::new();
    let bare = |text: &str| {
        let kept: Vec<_> = text.split("plugins: [").collect();
        let rest = kept[1..].iter().map(|part| part.split_once(']').unwrap().1);
        std::iter::once(kept[0]).chain(rest).collect::<String>().replace(", }", "}")
    };
    let model = pendulum("/a/", "a");
    let run = |mut simulation: Simulation| {
        let mut bits = Vec::new();
        for step in 0..500 {
            simulation.apply_wrench(
                BodyId::new(1),
                nalgebra::Vector3::new(0.0, 0.0, f64::from(step % 7)),
                Default::default(),
            );
            simulation.iterate(0.001).unwrap();
            let mut states = vec![Default::default(); simulation.scene().bodies.len()];
            simulation.scene().world.read_bodies(&mut states);
            bits.extend(states);
        }
        bits
    };
    let without = run(stage.scene(&bare(&world()), &[&bare(&model)]));
    let mut empty = stage.scene(&bare(&world()), &[&bare(&model)]);
    assert_eq!(empty.load_plugins(PluginSetup::default()), Default::default());
    assert!(!empty.has_plugins());
    assert!(without == run(empty), "loading no plugins changes nothing");
    let probed = stage.simulation(&world(), &[&model]);
    assert!(probed.has_plugins());
    assert!(without == run(probed), "plugins that only look change nothing");
}

#[test]
fn slow_plugins_are_named() {
    struct Slow;
    impl ambf_core::plugin::Plugin for Slow {
        fn physics_update(&mut self, _: &mut ambf_core::plugin::View<'_>, _: f64) {
            std::thread::sleep(Duration::from_millis(2));
        }
    }
    impl ambf_core::plugin::WorldPlugin for Slow {}
    let stage = Stage::new();
    let mut setup = stage.setup();
    setup.registry.add("slow", |_| Some(ambf_core::plugin::AnyPlugin::World(Box::new(Slow))));
    let mut simulation = stage.scene("plugins: [{name: snail, filename: 'builtin:slow'}]\n", &[]);
    assert_eq!(simulation.load_plugins(setup).problems, Vec::<String>::new());
    for _ in 0..20 {
        simulation.iterate(0.001).unwrap();
    }
    let notices = simulation.take_notices();
    let [notice] = notices.as_slice() else { panic!("once, not always: {notices:?}") };
    assert!(notice.starts_with("plugin snail is slow: in physics_update, "), "{notice}");
    assert!(notice.contains(" of 10 calls took longer than 0.5 ms"), "{notice}");
}

#[test]
fn a_late_iteration_is_divided_into_short_ones() {
    const LATE: Duration = Duration::from_millis(40);
    /// Sleeps once, and writes down the intervals after that.
    struct Late {
        updates: u32,
        intervals: Arc<Mutex<Vec<f64>>>,
    }
    impl ambf_core::plugin::Plugin for Late {
        fn physics_update(&mut self, _: &mut ambf_core::plugin::View<'_>, dt: f64) {
            self.updates += 1;
            match self.updates {
                0..200 => {}
                200 => std::thread::sleep(LATE),
                _ => self.intervals.lock().unwrap().push(dt),
            }
        }
    }
    impl ambf_core::plugin::WorldPlugin for Late {}
    let stage = Stage::new();
    let intervals = Arc::new(Mutex::new(Vec::new()));
    let mut setup = stage.setup();
    let kept = Arc::clone(&intervals);
    setup.registry.add("late", move |_| {
        Some(ambf_core::plugin::AnyPlugin::World(Box::new(Late { updates: 0, intervals: Arc::clone(&kept) })))
    });
    let world = "max iterations: 1000\nplugins: [{name: late, filename: 'builtin:late'}]\n";
    let mut simulation = stage.scene(world, &[]);
    assert_eq!(simulation.load_plugins(setup).problems, Vec::<String>::new());
    let runner = Runner::start(simulation, RunnerOptions::default());
    let begin = Instant::now();
    let simulated = || intervals.lock().unwrap().iter().sum::<f64>();
    while simulated() < 2.0 * LATE.as_secs_f64() {
        assert!(begin.elapsed() < Duration::from_secs(60), "simulated so far: {} s", simulated());
        std::thread::sleep(Duration::from_millis(5));
    }
    let simulation = runner.stop().expect("physics has not panicked");
    assert_eq!(simulation.lost_time(), 0.0);
    let longest = intervals.lock().unwrap().iter().copied().fold(0.0, f64::max);
    // Two periods; more only where a busy machine makes iterations expensive.
    assert!(longest < LATE.as_secs_f64() / 3.0, "{longest} s");
}

impl Stage {
    /// A scene from a world file with mistakes.
    fn scene_with_errors(&self, world: &str) -> Simulation {
        let path = self.write("world.yaml", world);
        let files = ambf_core::scene::SceneFiles { world: Some(path), models: vec![] };
        let loaded = ambf_core::scene::load(&files, &Default::default());
        assert_eq!(loaded.report.errors(), 1, "the entry without a name: {}", loaded.report);
        assert!(Path::new(&self.folder).is_dir());
        Simulation::new(loaded.scene, 0.001)
    }
}

#[test]
fn volumes_keep_their_indices_when_models_come_and_go() {
    let stage = Stage::new();
    let mut simulation = stage.simulation(&world(), &[]);
    stage.log.take();
    let volume = |name: &str| {
        stage.write(
            &format!("{name}.yaml"),
            &format!("volumes: [V]\nnamespace: /{name}/\nV: {{name: {name}, {}}}\n", probes(&[name])),
        )
    };
    let empty = stage.write("empty.yaml", "bodies: []\nnamespace: /e/\n");
    let add = |simulation: &mut Simulation, file: &Path| {
        let added = simulation.add_model(PreparedModel::read(file).expect("a model")).expect("something is built");
        assert!(!added.incomplete, "{}", added.report);
        added.key
    };
    let gap = add(&mut simulation, &empty);
    add(&mut simulation, &volume("first"));
    let index = |simulation: &Simulation, name: &str| simulation.scene().find_object(ObjectType::Volume, name);
    assert_eq!(index(&simulation, "first"), Some(0));
    simulation.remove_model(&gap).expect("it is there");
    add(&mut simulation, &volume("second"));
    assert_eq!((index(&simulation, "first"), index(&simulation, "second")), (Some(0), Some(1)));
    let inits: Vec<_> = stage.log.take().into_iter().filter(|line| line.ends_with(":init")).collect();
    assert_eq!(inits, lines(&["first", "second"], "init"));
}
