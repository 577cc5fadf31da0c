//! A replay is the recorded motion, bit for bit.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::Arc;
use std::time::Duration;

use ambf_core::adf::{self, Launch};
use ambf_core::comm::{CarveCommand, JointCommandType, ObjectKind, RigidBodyCommand, Snapshot, VehicleCommand};
use ambf_core::control::Profile;
use ambf_core::ids::{BodyId, VehicleId};
use ambf_core::plugin::{AnyPlugin, Plugin, PluginSetup, SimulatorPlugin, View};
use ambf_core::scene::{load, Loaded, PhysicsOptions, PreparedModel, SceneFiles, SceneOptions};
use ambf_core::sim::{Picked, ReplayError, Simulation, Stepper, WindowAnswer, WindowRequest};
use ambf_core::volume::{Rule, Shape};
use ambf_recording::{Replay, ReplayFailure, Step, Writer};
use nalgebra::{Isometry3, Vector3};

fn resources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources")
}

fn simulation(model: &Path, profile: Profile, savable: bool) -> Simulation {
    let files = SceneFiles { world: Some(resources().join("world/world.yaml")), models: vec![model.to_owned()] };
    let physics = PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
    let options = SceneOptions { physics, savable, may_grow: true, ..SceneOptions::default() };
    let Loaded { scene, report } = load(&files, &options);
    assert_eq!(report.errors(), 0, "{report}");
    Simulation::new(scene, 0.001)
}

fn shipped(model: &str, profile: Profile, savable: bool) -> Simulation {
    simulation(&resources().join("models").join(model), profile, savable)
}

/// All bits of a state that others can see.
fn bits(simulation: &Simulation) -> Vec<u64> {
    let Snapshot { bodies, joint_positions, joint_velocities, joint_efforts, views, .. } = simulation.snapshot();
    let bodies = bodies.iter().flat_map(|body| {
        let vectors = body.linear_velocity.into_iter().chain(body.angular_velocity);
        body.origin.into_iter().chain(body.basis).chain(vectors)
    });
    let joints = joint_positions.iter().chain(joint_velocities.iter()).chain(joint_efforts.iter());
    let cameras = views.iter().flat_map(|view| view.pose.to_homogeneous().iter().copied().collect::<Vec<_>>());
    let scene = simulation.scene();
    let nodes = scene.soft_bodies.iter().flat_map(|soft| {
        let mut nodes = vec![[0.0; 3]; soft.nodes];
        soft.read_nodes(&scene.world, &mut nodes);
        nodes.into_flattened()
    });
    let voxels = scene.volumes.iter().filter_map(|volume| volume.voxels());
    let solid = voxels.map(|voxels| voxels.count_solid() as f64);
    let time = [simulation.sim_time(), simulation.lost_time(), f64::from(simulation.sim_step())];
    bodies.chain(joints.copied()).chain(cameras).chain(nodes).chain(solid).chain(time).map(f64::to_bits).collect()
}

/// Commands that keep everything moving.
fn command(simulation: &mut Simulation, step: u32) {
    let t = f64::from(step) * 1e-3;
    let bodies: Vec<BodyId> = simulation.scene().bodies.ids().collect();
    for (number, body) in bodies.into_iter().enumerate() {
        let phase = 7.0 * t + number as f64;
        for joint in 0..simulation.scene().active_joints(body).len() {
            simulation.command_joint(body, joint, JointCommandType::Position, 0.2 * phase.sin());
        }
        if simulation.scene().bodies[body].is_dynamic() && number % 3 == 0 {
            simulation.apply_wrench(body, 0.3 * Vector3::new(phase.cos(), phase.sin(), 0.1), Vector3::zeros());
        }
    }
    let vehicles: Vec<VehicleId> = simulation.scene().vehicles.ids().collect();
    for vehicle in vehicles {
        let drive = VehicleCommand { power: vec![5.0; 4], steering: vec![0.1 * t.sin(); 4], ..Default::default() };
        simulation.command_vehicle(vehicle, &drive);
    }
}

/// Records while `act` works with a simulation, replays, and compares the states after each update. `act` returns those
/// that it saw.
fn check(
    name: &str,
    mut simulation: Simulation,
    act: impl FnOnce(Simulation) -> (Vec<Vec<u64>>, Option<Simulation>),
) -> Replay {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("a.mcap");
    let writer = Writer::start(&file, &mut simulation, "test", true).unwrap_or_else(|error| panic!("{name}: {error}"));
    let (states, simulation) = act(simulation);
    if let Some(mut simulation) = simulation {
        assert!(simulation.stop_recording());
    }
    let summary = writer.finish();
    assert_eq!(summary.problem, None, "{name}");
    assert!(summary.updates > 0 && summary.entries > summary.updates, "{name}: {summary:?}");
    let mut replay = Replay::open(&file).unwrap_or_else(|error| panic!("{name}: {error}"));
    let (mut replayed, _) = replay.load(false).unwrap_or_else(|error| panic!("{name}: {error}"));
    let mut update = 0;
    loop {
        let step = replay.step(&mut replayed).unwrap_or_else(|error| panic!("{name}, update {update}: {error}"));
        if step == Step::End {
            break;
        }
        if let Some(state) = states.get(update) {
            // Not all are kept by those who step more at a time.
            assert!(state.is_empty() || *state == bits(&replayed), "{name}: update {update} is another one");
        }
        update += 1;
    }
    assert_eq!(update as u64, summary.updates, "{name}");
    assert_eq!(replay.recording().end(), Some("stopped"), "{name}");
    replay
}

fn run(simulation: &mut Simulation, steps: u32, states: &mut Vec<Vec<u64>>) {
    for step in 0..steps {
        command(simulation, step);
        let _ = simulation.iterate(0.001);
        states.push(bits(simulation));
    }
}

#[test]
fn every_shipped_scene_is_replayed_in_both_profiles() {
    let launch = adf::load::<Launch>(&resources().join("launch.yaml")).expect("a launch file").0;
    for model in launch.multibody_configs.expect("models") {
        for profile in [Profile::Legacy, Profile::Accurate] {
            let name = format!("{} {profile:?}", model.display());
            check(&name, simulation(&model, profile, false), |mut simulation| {
                let mut states = Vec::new();
                run(&mut simulation, 120, &mut states);
                (states, Some(simulation))
            });
        }
    }
}

#[test]
fn hashes_are_compared_and_resets_are_done() {
    for profile in [Profile::Legacy, Profile::Accurate] {
        check("stack", shipped("stack.yaml", profile, false), |mut simulation| {
            let mut states = Vec::new();
            run(&mut simulation, 700, &mut states);
            simulation.reset_bodies();
            run(&mut simulation, 700, &mut states);
            simulation.reset_world();
            run(&mut simulation, 700, &mut states);
            (states, Some(simulation))
        });
    }
}

#[test]
fn models_that_come_and_go_are_replayed() {
    for profile in [Profile::Legacy, Profile::Accurate] {
        check("pendulum", shipped("pendulum.yaml", profile, false), |mut simulation| {
            let mut states = Vec::new();
            run(&mut simulation, 50, &mut states);
            let model = PreparedModel::read(&resources().join("models/gripper.yaml")).expect("a model");
            let added = simulation.add_model(model).expect("a model");
            run(&mut simulation, 100, &mut states);
            simulation.remove_model(&added.key).expect("it is there");
            run(&mut simulation, 50, &mut states);
            // Those of the model have left.
            let bodies: Vec<BodyId> = simulation.scene().bodies.ids().collect();
            let removed = bodies.into_iter().rev().find_map(|body| simulation.remove_body(body).ok());
            assert!(removed.is_some(), "there is a body left");
            let _ = simulation.iterate(0.001);
            states.push(bits(&simulation));
            (states, Some(simulation))
        });
    }
}

/// Cuts by a tool that is pressed into a volume, and by commands.
#[test]
fn what_is_cut_is_replayed() {
    let simulation = simulation(&resources().join("drill/drill.yaml"), Profile::Accurate, false);
    check("drill", simulation, |mut simulation| {
        let volume = simulation.scene().volumes.ids().next().expect("a volume");
        let drill = simulation.scene().bodies.ids().next().expect("a drill");
        let solid =
            |simulation: &Simulation| simulation.scene().volumes[volume].voxels().map(|voxels| voxels.count_solid());
        let first = solid(&simulation);
        let mut states = Vec::new();
        let mut press = |simulation: &mut Simulation| {
            for _ in 0..150 {
                simulation.apply_wrench(drill, Vector3::new(0.0, 0.0, -3.0), Vector3::zeros());
                let _ = simulation.iterate(0.001);
                states.push(bits(simulation));
            }
        };
        press(&mut simulation);
        assert!(solid(&simulation) < first, "the drill cuts");
        let at = Isometry3::translation(0.0, 0.0, -0.005);
        let shape = Shape::Sphere { radius: 0.003 };
        let command = CarveCommand { shape, from: at, to: at, in_world: true, rule: Rule::All };
        assert!(!simulation.carve(volume, &command).expect("a cut").indices.is_empty());
        simulation.set_tool(volume, 0, Some(false), Some(0.001)).expect("a tool");
        press(&mut simulation);
        simulation.restore_voxels(volume).expect("a volume");
        press(&mut simulation);
        (states, Some(simulation))
    });
}

#[test]
fn a_lost_state_and_what_follows_it_are_replayed() {
    check("lost", shipped("stack.yaml", Profile::Legacy, false), |mut simulation| {
        let mut states = Vec::new();
        run(&mut simulation, 20, &mut states);
        let body = simulation.scene().bodies.ids().last().expect("a body");
        simulation.set_velocity(body, Vector3::repeat(1e300), Vector3::repeat(1e300));
        simulation.iterate(0.001).expect_err("lost");
        states.push(Vec::new());
        simulation.reset_world();
        run(&mut simulation, 100, &mut states);
        (states, Some(simulation))
    });
}

#[test]
fn what_is_done_in_windows_and_through_the_hub_is_replayed() {
    for profile in [Profile::Legacy, Profile::Accurate] {
        check("hub", shipped("gripper.yaml", profile, false), |mut simulation| {
            let hub = simulation.connect();
            let link = simulation.window_link();
            let objects = hub.objects().clone();
            let is_body = |kind: &ObjectKind| matches!(kind, ObjectKind::RigidBody(body, _) if !simulation.scene().active_joints(*body).is_empty());
            let (object, _) = objects.entries().find(|(_, object)| is_body(&object.info.kind)).expect("a body");
            let mut states = Vec::new();
            let mut step = |simulation: &mut Simulation, count: u32| {
                for _ in 0..count {
                    simulation.serve_requests();
                    let _ = simulation.iterate(0.001);
                    states.push(bits(simulation));
                }
            };
            for number in 0..20 {
                let goal = f64::from(number) * 0.01;
                let command = RigidBodyCommand {
                    joint_commands: vec![goal; 2],
                    joint_command_types: vec![JointCommandType::Position; 2],
                    ..RigidBodyCommand::wrench(Vector3::z() * goal, Vector3::zeros())
                };
                hub.post(object, &command).expect("finite");
                step(&mut simulation, 5);
            }
            // The watchdog clears the command.
            std::thread::sleep(ambf_core::comm::WATCHDOG_TIMEOUT + Duration::from_millis(50));
            step(&mut simulation, 20);
            let place = |simulation: &Simulation| {
                let scene = simulation.scene();
                let body = scene.bodies.iter().rfind(|body| body.is_dynamic()).expect("a body");
                body.pose(&scene.world).translation.vector
            };
            let origin = place(&simulation) + 5.0 * Vector3::z();
            link.post(WindowRequest::Pick { origin, direction: -Vector3::z() }).expect("room");
            step(&mut simulation, 3);
            let answer = link.answer();
            assert!(matches!(answer, Some(WindowAnswer::Picked(Picked::Body { .. }))), "{answer:?}");
            for x in 0..30 {
                let origin = origin + Vector3::x() * f64::from(x) * 0.01;
                link.post(WindowRequest::Drag { origin, direction: -Vector3::z() }).expect("room");
                step(&mut simulation, 2);
            }
            link.post(WindowRequest::Release).expect("room");
            link.post(WindowRequest::Gravity(false)).expect("room");
            step(&mut simulation, 50);
            (states, Some(simulation))
        });
    }
}

/// Holds two bodies together for a while after each reset, and counts how often it let them go.
struct Holder {
    bodies: [usize; 2],
    updates: u32,
    held: Option<u64>,
    released: Arc<AtomicU32>,
}

impl Plugin for Holder {
    fn physics_update(&mut self, world: &mut View<'_>, _: f64) {
        self.updates += 1;
        let [a, b] = self.bodies;
        match self.updates {
            20 => self.held = world.attach(a, b).ok(),
            // Refused when it is recorded, and no part of the recording.
            30 => self.held = self.held.filter(|_| world.attach(a, a).is_err()),
            60 => {
                let is_released = self.held.take().is_some_and(|held| world.detach(held).is_ok());
                self.released.fetch_add(u32::from(is_released), Ordering::Relaxed);
            }
            _ => (),
        }
    }

    fn reset(&mut self, _: &mut View<'_>) {
        (self.updates, self.held) = (0, None);
    }
}

impl SimulatorPlugin for Holder {}

/// What a plugin attaches before a recording begins is counted, too.
#[test]
fn what_plugins_attach_and_detach_over_resets_is_replayed() {
    let mut simulation = shipped("stack.yaml", Profile::Accurate, false);
    let dynamic = simulation.scene().bodies.ids().filter(|&body| simulation.scene().bodies[body].is_dynamic());
    let bodies: Vec<usize> = dynamic.map(BodyId::index).collect();
    let (bodies, released) = ([bodies[0], bodies[1]], Arc::new(AtomicU32::new(0)));
    let mut setup = PluginSetup { command_line: vec!["builtin:holder".into()], ..PluginSetup::default() };
    let counter = Arc::clone(&released);
    setup.registry.add("holder", move |_| {
        let holder = Holder { bodies, updates: 0, held: None, released: Arc::clone(&counter) };
        Some(AnyPlugin::Simulator(Box::new(holder)))
    });
    assert_eq!(simulation.load_plugins(setup).problems, Vec::<String>::new());
    run(&mut simulation, 80, &mut Vec::new());
    simulation.reset_world();
    check("attachments", simulation, |mut simulation| {
        let mut states = Vec::new();
        run(&mut simulation, 80, &mut states);
        simulation.reset_world();
        run(&mut simulation, 80, &mut states);
        (states, Some(simulation))
    });
    assert_eq!(released.load(Ordering::Relaxed), 3);
}

#[test]
fn a_state_from_before_a_recording_ends_it_and_none_begins_there() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("a.mcap");
    let mut simulation = shipped("stack.yaml", Profile::Accurate, true);
    let saved = simulation.save().expect("savable");
    let writer = Writer::start(&file, &mut simulation, "test", true).expect("at the start");
    run(&mut simulation, 50, &mut Vec::new());
    simulation.restore(&saved).expect("of this simulation");
    assert!(!simulation.is_recorded());
    run(&mut simulation, 50, &mut Vec::new());
    let summary = writer.finish();
    let problem = summary.problem.expect("it has ended early");
    assert!(problem.contains("a state from before the recording"), "{problem}");
    let replay = Replay::open(&file).expect("a recording");
    assert_eq!((replay.ended(), replay.updates()), ("went back", 50));
    assert!(replay.problem().is_some_and(|problem| problem.contains("is not whole")), "{:?}", replay.problem());
    // Nor after a reset, when a state with motion is restored then.
    let moving = simulation.save().expect("savable");
    simulation.reset_world();
    simulation.restore(&moving).expect("of this simulation");
    let other = folder.path().join("b.mcap");
    let why = Writer::start(&other, &mut simulation, "test", true).expect_err("it is moving").to_string();
    assert!(why.contains("reset"), "{why}");
}

#[test]
fn a_simulation_that_goes_back_is_replayed() {
    let check = |keep: bool| {
        check("restore", shipped("stack.yaml", Profile::Accurate, true), |mut simulation| {
            let mut states = Vec::new();
            if keep {
                simulation.keep_history(true).expect("savable");
            }
            run(&mut simulation, 40, &mut states);
            let saved = simulation.save().expect("savable");
            run(&mut simulation, 70, &mut states);
            simulation.restore(&saved).expect("of this simulation");
            run(&mut simulation, 60, &mut states);
            (states, Some(simulation))
        })
    };
    check(false);
    check(true);
}

#[test]
fn a_stepper_is_recorded_from_its_start_and_from_a_reset() {
    for resets in [false, true] {
        let mut stepper = Stepper::new(shipped("pendulum.yaml", Profile::Accurate, false), 0.001);
        if resets {
            stepper.step(30).expect("sound");
            stepper.reset();
        }
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("a.mcap");
        let writer = Writer::start(&file, stepper.simulation_mut(), "test", true).expect("at the start");
        stepper.step(1500).expect("sound");
        let last = bits(stepper.simulation());
        stepper.simulation_mut().stop_recording();
        let summary = writer.finish();
        assert_eq!((summary.updates, summary.problem), (1501, None));
        let mut replay = Replay::open(&file).expect("a recording");
        let (mut replayed, _) = replay.load(false).expect("the scene");
        while replay.step(&mut replayed).expect("the same") != Step::End {}
        assert_eq!(bits(&replayed), last, "resets: {resets}");
    }
}

#[test]
fn another_motion_is_named_by_its_iteration() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, model) = (folder.path().join("a.mcap"), folder.path().join("a.yaml"));
    let text = |mass: f64| {
        format!("bodies: [BODY a]\njoints: []\nBODY a: {{name: a, mass: {mass}, shape: Sphere, geometry: {{radius: 0.1}}, damping: {{linear: 0.1, angular: 0.1}}, location: {{position: {{x: 0, y: 0, z: 5}}, orientation: {{r: 0, p: 0, y: 0}}}}}}\n")
    };
    std::fs::write(&model, text(1.0)).expect("written");
    let mut recorded = simulation(&model, Profile::Legacy, false);
    let writer = Writer::start(&file, &mut recorded, "test", true).expect("at the start");
    let body = recorded.scene().bodies.ids().last().expect("a body");
    for step in 0..2500 {
        if step >= 1200 {
            recorded.apply_wrench(body, Vector3::x(), Vector3::zeros());
        }
        recorded.iterate(0.001).expect("sound");
    }
    recorded.stop_recording();
    writer.finish();
    std::fs::write(&model, text(2.0)).expect("written");
    let mut replay = Replay::open(&file).expect("a recording");
    let error = replay.load(false).err().expect("the file has changed").to_string();
    assert!(error.contains("a.yaml: has changed since"), "{error}");
    let mut replay = Replay::open(&file).expect("a recording");
    let (mut replayed, _) = replay.load(true).expect("the scene");
    let error = loop {
        match replay.step(&mut replayed) {
            Ok(Step::End) => panic!("the mass is another one"),
            Ok(_) => (),
            Err(ReplayFailure::Replay { error, .. }) => break error,
            Err(error) => panic!("{error}"),
        }
    };
    // Until then both fall alike.
    assert!(matches!(error, ReplayError::Differs { same: 1000, iteration: 2000, .. }), "{error}");
}

#[test]
fn recordings_begin_at_the_start_and_overwrite_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("a.mcap");
    let mut simulation = shipped("pendulum.yaml", Profile::Legacy, false);
    simulation.iterate(0.001).expect("sound");
    simulation.iterate(0.001).expect("sound");
    let why = Writer::start(&file, &mut simulation, "test", true).expect_err("it has moved").to_string();
    assert!(why.contains("reset"), "{why}");
    assert!(!file.exists());
    simulation.reset_world();
    let writer = Writer::start(&file, &mut simulation, "test", true).expect("after a reset");
    let why =
        Writer::start(&folder.path().join("b.mcap"), &mut simulation, "test", true).expect_err("twice").to_string();
    assert!(why.contains("already"), "{why}");
    let why = Writer::start(&file, &mut simulation, "test", true).expect_err("it is there").to_string();
    assert!(why.contains("overwritten"), "{why}");
    simulation.stop_recording();
    drop(writer);
    assert!(file.exists());
}
