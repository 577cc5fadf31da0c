//! The running simulation as its clients see it: time, pause, throttling, commands, resets, loss of a state.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_core::comm::{
    CartesianCommandType, Hub, HubIndex, HubObject, JointCommandType, ObjectKind, RigidBodyCommand, Snapshot,
    StepError, StepOrder, WorldCommand,
};
use ambf_core::ids::{BodyId, JointId};
use ambf_core::scene::{load, SceneFiles, SceneOptions};
use ambf_core::sim::{Event, LossCause, Runner, RunnerOptions, Simulation, DEFAULT_SUB_STEP};
use nalgebra::Vector3;

const FIXED: RunnerOptions = RunnerOptions { frequency: 1000.0, fixed_step: true, speed_factor: 1.0 };

fn simulation(model: &str) -> Simulation {
    let resources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources");
    let models: Vec<PathBuf> = vec![resources.join("models").join(model)];
    let files = SceneFiles { world: Some(resources.join("world/world.yaml")), models };
    let loaded = load(&files, &SceneOptions::default());
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    Simulation::new(loaded.scene, DEFAULT_SUB_STEP)
}

struct Running {
    runner: Runner,
    hub: Arc<Hub>,
}

impl Running {
    fn start(model: &str, options: RunnerOptions) -> Self {
        let mut simulation = simulation(model);
        let hub = simulation.connect();
        hub.set_listening();
        Self { runner: Runner::start(simulation, options), hub }
    }

    fn object(&self, name: &str) -> (HubIndex, BodyId) {
        let found = self.hub.objects().entries().find_map(|(place, object)| match object.info.kind {
            ObjectKind::RigidBody(index, _) if object.info.name == name => Some((place, index)),
            _ => None,
        });
        found.unwrap_or_else(|| panic!("no body {name}"))
    }

    fn state(&self) -> Snapshot {
        let begin = Instant::now();
        loop {
            if let Some(snapshot) = self.hub.snapshot().as_deref() {
                return snapshot.clone();
            }
            assert!(begin.elapsed() < Duration::from_secs(20), "no state");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn wait_for(&self, what: &str, mut condition: impl FnMut(&Snapshot) -> bool) -> Snapshot {
        let begin = Instant::now();
        loop {
            let state = self.state();
            if condition(&state) {
                return state;
            }
            assert!(begin.elapsed() < Duration::from_secs(20), "waited in vain for {what}");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn wait_for_event(&self, what: &str, mut condition: impl FnMut(&Event) -> bool) -> Event {
        loop {
            let event = self.runner.events().recv_timeout(Duration::from_secs(20));
            let event = event.unwrap_or_else(|_| panic!("waited in vain for {what}"));
            if condition(&event) {
                return event;
            }
        }
    }

    /// Waits until the state stays the same for longer than a busy machine lets physics wait: a held simulation.
    fn settle(&self) -> Snapshot {
        let (mut state, mut since) = (self.state(), Instant::now());
        self.wait_for("rest", |now| {
            if now.sim_step != state.sim_step {
                (state, since) = (now.clone(), Instant::now());
            }
            since.elapsed() > Duration::from_millis(200)
        })
    }
}

#[test]
fn fixed_steps_are_exact() {
    let running = Running::start("pendulum.yaml", FIXED);
    let state = running.wait_for("100 steps", |state| state.sim_step > 100);
    assert!((state.sim_time - f64::from(state.sim_step) * 0.001).abs() < 1e-9);
    assert_eq!(state.timing.lost_time, 0.0);
}

#[test]
fn simulated_time_follows_the_clock() {
    let running = Running::start("pendulum.yaml", RunnerOptions::default());
    for _ in 0..20 {
        std::thread::sleep(Duration::from_millis(10));
        let state = running.state();
        // The state was written at wall_time; its simulated time was chosen at the start of that iteration.
        let behind = state.wall_time - state.sim_time;
        assert!((0.0..0.5).contains(&behind), "{behind}");
    }
}

#[test]
fn paused_time_does_not_count_and_manual_steps_do() {
    let running = Running::start("pendulum.yaml", RunnerOptions::default());
    running.wait_for("a start", |state| state.sim_step > 10);
    running.runner.control().set_paused(true);
    let held = running.settle();
    std::thread::sleep(Duration::from_millis(300));
    running.runner.control().step(10);
    let stepped = running.wait_for("ten steps", |state| state.sim_step == held.sim_step + 10);
    assert_eq!(running.settle().sim_step, held.sim_step + 10, "ten and no more");
    assert!(stepped.sim_time - held.sim_time < 0.25, "the pause was not made up for");
    running.runner.control().set_paused(false);
    let resumed = running.wait_for("going on", |state| state.sim_step > stepped.sim_step);
    assert!(resumed.sim_time > stepped.sim_time && resumed.sim_time - stepped.sim_time < 0.25);
}

#[test]
fn a_throttling_client_gets_exactly_its_steps() {
    let running = Running::start("pendulum.yaml", FIXED);
    let post = |step_clock, n_skip_steps| {
        let command = WorldCommand { enable_step_throttling: true, step_clock, n_skip_steps };
        running.hub.throttle().post(command, running.hub.now_ns());
    };
    running.state();
    post(false, 5);
    let mut clock = false;
    let mut step = running.settle().sim_step;
    for _ in 0..10 {
        clock = !clock;
        post(clock, 5);
        step += 5;
        let state = running.wait_for("five steps", |state| state.sim_step >= step);
        assert_eq!(state.sim_step, step);
    }
    let released = running.wait_for("the watchdog", |state| state.sim_step > step + 50);
    assert!(released.sim_step > step + 50, "a client that stops sending does not hold the simulation for ever");
}

#[test]
fn a_joint_command_moves_its_joint_until_the_watchdog_lets_go() {
    let running = Running::start("pendulum.yaml", FIXED);
    let (object, _) = running.object("Base");
    let command = RigidBodyCommand {
        joint_commands: vec![0.3, 1.0, 2.0],
        joint_command_types: vec![JointCommandType::Position, JointCommandType::Unknown(7)],
        ..Default::default()
    };
    running.wait_for("the set point", |state| {
        running.hub.post(object, &command).unwrap();
        (state.joint_positions[JointId::new(0)] - 0.3).abs() < 0.05
            && state.joint_velocities[JointId::new(0)].abs() < 0.05
    });
    running.wait_for("letting go", |state| (state.joint_positions[JointId::new(0)] - 0.3).abs() > 0.3);
}

#[test]
fn a_wrench_acts_and_a_reset_brings_everything_back() {
    let running = Running::start("free_bodies.yaml", FIXED);
    let (object, index) = running.object("Box");
    let start = running.state().bodies[index].origin;
    let command = RigidBodyCommand { force: Vector3::new(50.0, 0.0, 0.0), ..Default::default() };
    running.wait_for("motion", |state| {
        running.hub.post(object, &command).unwrap();
        state.bodies[index].origin[0] - start[0] > 0.5
    });
    running.hub.post(object, &RigidBodyCommand::default()).unwrap();
    let before = running.state();
    running.hub.request_world_reset();
    running.wait_for_event("the reset", |event| *event == Event::Reset);
    let after = running.wait_for("the start", |state| (state.bodies[index].origin[0] - start[0]).abs() < 0.1);
    assert!(after.sim_step >= before.sim_step && after.sim_time >= before.sim_time, "time goes on");
}

#[test]
fn a_reset_is_seen_while_paused() {
    let running = Running::start("pendulum.yaml", FIXED);
    let (_, link) = running.object("Link");
    let swung = running.wait_for("motion", |state| state.joint_positions[JointId::new(0)].abs() > 0.1);
    running.runner.control().set_paused(true);
    let held = running.settle();
    running.hub.request_body_reset();
    let reset = running.wait_for("the start", |state| state.joint_positions[JointId::new(0)].abs() < 1e-9);
    assert_ne!(reset.bodies[link].origin, swung.bodies[link].origin);
    assert_eq!((reset.sim_step, reset.sim_time), (held.sim_step, held.sim_time));
}

#[test]
fn a_lost_state_pauses_is_named_and_is_never_seen() {
    let running = Running::start("free_bodies.yaml", FIXED);
    let (object, index) = running.object("Box");
    let fling = RigidBodyCommand {
        cartesian: CartesianCommandType::Velocity,
        linear_velocity: Vector3::new(1e308, 1e308, 0.0),
        angular_velocity: Vector3::repeat(1e308),
        ..Default::default()
    };
    running.state();
    running.hub.post(object, &fling).unwrap();
    let event = running.wait_for_event("the loss", |event| matches!(event, Event::Lost(_)));
    let Event::Lost(problem) = event else { unreachable!("just matched") };
    let text = problem.to_string();
    assert!(
        text.contains("last command: velocity (1e308, 1e308, 0.0) m/s") && text.contains("to `/ambf/env/BODY Box`"),
        "{text}"
    );
    assert!(running.runner.control().is_paused());
    let told = running.hub.lost().expect("clients are told");
    assert_eq!(*told, format!("lost at step {}: {text}; a reset resumes", problem.step));
    let order = StepOrder { steps: 1, reset: false, patience: Duration::from_secs(1) };
    assert_eq!(running.hub.step(order, |_| Ok(())).unwrap_err(), StepError::Lost(told.to_string()));
    let finite = |state: &Snapshot| state.bodies.iter().all(|body| body.origin.iter().all(|x| x.is_finite()));
    assert!(finite(&running.state()));

    running.hub.post(object, &RigidBodyCommand::default()).unwrap();
    running.hub.request_world_reset();
    let step = running.state().sim_step;
    let state = running.wait_for("going on", |state| state.sim_step > step + 100);
    assert!(finite(&state) && state.bodies[index].origin[2] > -2.0);
    assert_eq!(running.hub.lost(), None);
}

#[test]
fn the_hub_survives_many_clients_at_once() {
    let running = Running::start("free_bodies.yaml", FIXED);
    std::thread::scope(|scope| {
        for client in 0..4_u32 {
            let running = &running;
            scope.spawn(move || {
                let objects = running.hub.objects().clone();
                let is_body = |object: &HubObject| matches!(object.info.kind, ObjectKind::RigidBody(..));
                let bodies: Vec<HubIndex> =
                    objects.entries().filter(|(_, object)| is_body(object)).map(|(position, _)| position).collect();
                for i in 0..5000 {
                    let force = Vector3::new(0.0, 0.0, f64::from(client * 5000 + i) * 1e-6);
                    let command =
                        RigidBodyCommand { force, joint_commands: vec![0.0; i as usize % 7], ..Default::default() };
                    running.hub.post(bodies[i as usize % bodies.len()], &command).unwrap();
                    drop(running.hub.snapshot());
                }
            });
        }
    });
    let step = running.state().sim_step;
    running.wait_for("going on", |state| state.sim_step > step + 10);
}

#[test]
fn time_for_which_clients_held_the_simulation_is_not_blamed_on_the_scene() {
    let running = Running::start("pendulum.yaml", RunnerOptions::default());
    running.wait_for("a start", |state| state.sim_step > 10);
    let command = WorldCommand { enable_step_throttling: true, step_clock: false, n_skip_steps: 5 };
    running.hub.throttle().post(command, running.hub.now_ns());
    // Until the watchdog lets go. This was said to be a scene that is too heavy for the computer.
    running.wait_for_event(
        "what was lost",
        |event| matches!(event, Event::LostTime { cause: LossCause::Clients, recent, .. } if *recent > 0.1),
    );
}
