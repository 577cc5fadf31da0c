//! Recordings that a simulation follows in real time, with clients who look, step and try to command.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_core::comm::{Activity, Hub, HubIndex, ObjectKind, PostError, RigidBodyCommand, StepError, StepOrder};
use ambf_core::scene::{load, SceneFiles, SceneOptions};
use ambf_core::sim::{
    ModelError, ReplayEnd, ReplayError, ReplayPlan, Runner, RunnerOptions, Simulation, WindowAnswer, WindowRequest,
};
use ambf_recording::{Replay, Writer};
use nalgebra::Vector3;

const UPDATES: u32 = 1500;

fn resources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources")
}

/// A recording of a pendulum that is pushed about, and `reset` in between; the hash of its last state.
fn recorded(folder: &Path, reset: bool) -> (PathBuf, u64) {
    let file = folder.join("a.mcap");
    let files = SceneFiles {
        world: Some(resources().join("world/world.yaml")),
        models: vec![resources().join("models/pendulum.yaml")],
    };
    let mut simulation = Simulation::new(load(&files, &SceneOptions::default()).scene, 0.001);
    let writer = Writer::start(&file, &mut simulation, "test", true).expect("at the start");
    let body = simulation.scene().bodies.ids().last().expect("a body");
    for update in 0..UPDATES {
        if update == 700 && reset {
            simulation.reset_world();
        }
        if update == 900 {
            simulation.annotate("stage: swing");
        }
        simulation.apply_wrench(body, Vector3::repeat(f64::from(update).sin()), Vector3::zeros());
        simulation.iterate(0.001).expect("sound");
    }
    let hash = simulation.state_hash();
    simulation.stop_recording();
    assert_eq!(writer.finish().problem, None);
    (file, hash)
}

struct Live {
    runner: Runner,
    hub: Arc<Hub>,
    window: ambf_core::sim::WindowLink,
    models: ambf_core::sim::Models,
}

impl Live {
    fn start(file: &Path, plan: ReplayPlan) -> Self {
        let mut replay = Replay::open(file).expect("a recording");
        let (mut simulation, _) = replay.load(false).expect("its scene");
        let hub = simulation.connect();
        hub.set_listening();
        hub.set_replaying(true);
        let (window, models) = (simulation.window_link(), simulation.models());
        let options = RunnerOptions { fixed_step: true, ..RunnerOptions::default() };
        let runner = Runner::replay(simulation, options, replay.play().expect("a thread"), plan);
        Self { runner, hub, window, models }
    }

    fn step(&self) -> u32 {
        self.hub.snapshot().as_ref().map_or(0, |snapshot| snapshot.sim_step)
    }

    fn body(&self) -> HubIndex {
        let objects = self.hub.objects();
        let bodies = objects.entries().filter(|(_, object)| matches!(object.info.kind, ObjectKind::RigidBody(..)));
        bodies.map(|(position, _)| position).last().expect("a body")
    }
}

fn wait(what: &str, is_there: impl Fn() -> bool) {
    let begin = Instant::now();
    while !is_there() {
        assert!(begin.elapsed() < Duration::from_secs(60), "{what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn it_takes_as_long_as_it_took_and_ends_paused_in_the_same_state() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, hash) = recorded(folder.path(), true);
    let begin = Instant::now();
    let live = Live::start(&file, ReplayPlan { speed: 2.0, ..ReplayPlan::default() });
    wait("the end", || live.runner.control().replay_ended().is_some());
    let took = begin.elapsed().as_secs_f64();
    assert!(took > 0.5 * 0.9 * f64::from(UPDATES) * 1e-3, "{took} s");
    let ended = live.runner.control().replay_ended().expect("it has").clone();
    assert_eq!((ended.why, ended.hash), (ReplayEnd::Over(None), hash));
    assert_eq!((ended.updates, ended.is_paused), (u64::from(UPDATES), true));
    assert!(live.runner.control().is_paused() && !live.hub.is_replaying());
    assert_eq!(live.step(), UPDATES);
    // A reset ends the pause, and who takes over moves it.
    live.hub.request_world_reset();
    wait("it goes on", || live.step() > UPDATES);
    live.hub.post(live.body(), &RigidBodyCommand::default()).expect("commands are taken again");
    let mut simulation = live.runner.stop().expect("no panic");
    assert!(simulation.take_notices().is_empty());
}

#[test]
fn clients_pause_step_and_look_and_command_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, hash) = recorded(folder.path(), true);
    let live = Live::start(&file, ReplayPlan { speed: 0.01, ..ReplayPlan::default() });
    let control = live.runner.control();
    wait("it begins", || live.step() > 0);
    control.set_paused(true);
    std::thread::sleep(Duration::from_millis(50));
    let step = live.step();
    control.step(7);
    wait("seven steps", || live.step() == step + 7);
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(live.step(), step + 7);
    // Looking from elsewhere is seen, other requests are refused.
    let camera = ambf_core::ids::CameraId::new(0);
    let seen = || live.hub.snapshot().as_ref().map(|snapshot| snapshot.views[camera].pose);
    let before = seen();
    let gesture = ambf_core::scene::CameraGesture::Pan { right: 1.0, up: 0.0 };
    live.window.post(WindowRequest::MoveCamera { camera, gesture }).expect("there is room");
    wait("the camera has moved", || seen() != before);
    live.window.post(WindowRequest::RemoveBody(ambf_core::ids::BodyId::new(0))).expect("there is room");
    wait("an answer", || match live.window.answer() {
        Some(WindowAnswer::Removed(Err(why))) => why.contains("is replayed"),
        _ => false,
    });
    assert!(!live.hub.has_refused());
    assert_eq!(live.models.remove("pendulum").expect_err("refused"), ModelError::Replaying);
    assert!(live.hub.has_refused());
    let push = RigidBodyCommand::wrench(Vector3::repeat(1e3), Vector3::zeros());
    assert_eq!(live.hub.post(live.body(), &push), Err(PostError::Replaying));
    live.hub.request_world_reset();
    control.set_paused(false);
    wait("it is resumed", || live.hub.throttle().activity() != Activity::Paused);
    // Steps that are ordered are those of the recording.
    let order = |steps| StepOrder { steps, reset: false, patience: Duration::from_secs(60) };
    let first = live.hub.step(order(0), |_| Ok(())).expect("held").sim_step;
    for steps in [1, 5, 100] {
        let before = live.step();
        assert_eq!(live.hub.step(order(steps), |_| Ok(())).expect("stepped").sim_step, before + steps);
    }
    assert_eq!(live.step(), first + 106);
    let reset = StepOrder { reset: true, ..order(1) };
    assert_eq!(live.hub.step(reset, |_| Ok(())), Err(StepError::Command(PostError::Replaying)));
    let refused = live.hub.step(order(1), |commands| commands.post(live.body(), &push));
    assert_eq!(refused, Err(StepError::Command(PostError::Replaying)));
    // All of it, however fast: the state is the recorded one.
    live.hub.step(order(UPDATES - live.step()), |_| Ok(())).expect("stepped");
    live.hub.throttle().post(Default::default(), live.hub.now_ns());
    wait("the end", || control.replay_ended().is_some());
    assert_eq!(control.replay_ended().map(|ended| ended.hash), Some(hash));
    // A reset ends the pause of the replay's end, not a later one.
    control.set_paused(false);
    wait("it is resumed", || live.step() > UPDATES);
    control.set_paused(true);
    live.hub.request_world_reset();
    std::thread::sleep(Duration::from_millis(200));
    assert!(control.is_paused());
}

#[test]
fn it_is_left_where_it_is_said_and_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, _) = recorded(folder.path(), true);
    let plan = ReplayPlan { fast_until: 1.1995, leave_at: Some(1.1995), speed: 1e-3, ..ReplayPlan::default() };
    let live = Live::start(&file, plan);
    wait("it is left", || live.runner.control().replay_ended().is_some());
    let ended = live.runner.control().replay_ended().expect("it is").clone();
    assert_eq!((ended.why, ended.updates, ended.is_paused), (ReplayEnd::Left, 1200, false));
    wait("it goes on", || live.step() > UPDATES);
    live.hub.post(live.body(), &RigidBodyCommand::default()).expect("commands are taken");
    // The state where it was left is that of the recording.
    let mut replay = Replay::open(&file).expect("a recording");
    let (mut simulation, _) = replay.load(false).expect("its scene");
    (0..1200).for_each(|_| drop(replay.step(&mut simulation).expect("the same")));
    assert_eq!(simulation.state_hash(), ended.hash);
}

#[test]
fn another_motion_is_named_and_pauses() {
    let folder = tempfile::tempdir().expect("a folder");
    let (file, _) = recorded(folder.path(), false);
    let mut replay = Replay::open(&file).expect("a recording");
    let (mut simulation, _) = replay.load(false).expect("its scene");
    let body = simulation.scene().bodies.ids().last().expect("a body");
    simulation.apply_wrench(body, Vector3::repeat(10.0), Vector3::zeros());
    let plan = ReplayPlan { fast_until: 10.0, ..ReplayPlan::default() };
    let runner = Runner::replay(simulation, RunnerOptions::default(), replay.play().expect("a thread"), plan);
    wait("the end", || runner.control().replay_ended().is_some());
    let ended = runner.control().replay_ended().expect("it has");
    let iteration = match ended.why {
        ReplayEnd::Failed(ReplayError::Differs { iteration, .. }) => iteration,
        ref other => panic!("{other:?}"),
    };
    assert_eq!((iteration, ended.is_paused), (1000, true));
}
