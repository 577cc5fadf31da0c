//! What plugins can see and do.

use std::sync::mpsc::{channel, Receiver, Sender};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::plugin_common::Stage;
use ambf_core::comm::JointCommandType;
use ambf_core::plugin::{
    AnyPlugin, BodyState, Command, CommandError, Host, InitContext, ObjectId, ObjectType, Plugin, PluginError,
    PluginSetup, SimulatorPlugin, StateSnapshot, View,
};
use ambf_core::sim::{Event, Runner, RunnerOptions, Simulation};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

type Work = Box<dyn FnOnce(&mut View<'_>) + Send>;

/// Does in its next update what it is sent.
struct Hand {
    work: Receiver<Work>,
    host: Sender<Host>,
}

impl Plugin for Hand {
    fn init(&mut self, context: &mut InitContext<'_>) -> Result<(), PluginError> {
        self.work.try_iter().for_each(|work| work(&mut context.world));
        self.host.send(context.host()).map_err(|error| error.to_string().into())
    }

    fn physics_update(&mut self, world: &mut View<'_>, _: f64) {
        self.work.try_iter().for_each(|work| work(world));
    }
}

impl SimulatorPlugin for Hand {}

struct Bench {
    simulation: Simulation,
    work: Sender<Work>,
    host: Host,
    _stage: Stage,
}

const SCENE: &str = "bodies: [BODY Floor, BODY Ball, BODY Base, BODY Arm]\njoints: [J]\nsensors: [S]\nactuators: [A]\n\
    ghost objects: [G]\ncameras: [C]\nnamespace: /s/\n\
    BODY Floor: {name: Floor, mass: 0, collision shape: Box, collision geometry: {x: 4, y: 4, z: 0.2}, \
    location: {position: {x: 0, y: 0, z: -0.1}}}\n\
    BODY Ball: {name: Ball, mass: 2, location: {position: {x: 0, y: 0, z: 0.5}}, damping: {linear: 0, angular: 0}, \
    collision shape: Sphere, collision geometry: {radius: 0.1}}\n\
    BODY Base: {name: Base, mass: 0, location: {position: {x: 1, y: 0, z: 1}}, \
    collision shape: Sphere, collision geometry: {radius: 0.01}}\n\
    BODY Arm: {name: Arm, mass: 1, location: {position: {x: 1.5, y: 0, z: 1}}, inertia: {ix: 0.01, iy: 0.01, iz: 0.01}, \
    collision shape: Sphere, collision geometry: {radius: 0.05}}\n\
    J: {name: J, type: revolute, parent: BODY Base, child: BODY Arm, parent pivot: {x: 0, y: 0, z: 0}, \
    child pivot: {x: -0.5, y: 0, z: 0}, parent axis: {x: 0, y: 1, z: 0}, child axis: {x: 0, y: 1, z: 0}, \
    joint limits: {low: -1, high: 2}, controller: {P: 100, I: 0, D: 5}}\n\
    S: {name: S, type: Proximity, parent: BODY Base, range: 2, array: [{offset: {x: -1, y: 0, z: 0}, direction: {x: 0, y: 0, z: -1}}]}\n\
    A: {name: A, type: Constraint, parent: BODY Base}\n\
    G: {name: G, collision shape: Sphere, collision geometry: {radius: 0.2}, location: {position: {x: 0, y: 0, z: 3}}}\n\
    C: {name: C, location: {x: 3, y: 0, z: 1}, look at: {x: 0, y: 0, z: 1}, up: {x: 0, y: 0, z: 1}}\n";

const WEIGHTLESS: &str = "gravity: {x: 0, y: 0, z: 0}\nmax iterations: 50\n";

impl Bench {
    fn new(world: &str) -> Self {
        Self::beginning(world, |_| ())
    }

    /// With what the plugin does when it begins.
    fn beginning(world: &str, begin: impl FnOnce(&mut View<'_>) + Send + 'static) -> Self {
        let stage = Stage::new();
        let mut simulation = stage.scene(world, &[SCENE]);
        let (work, work_out) = channel::<Work>();
        work.send(Box::new(begin)).unwrap();
        let (host, host_out) = channel();
        let hand = Arc::new(Mutex::new(Some(Hand { work: work_out, host })));
        let mut setup = PluginSetup { command_line: vec!["builtin:hand".into()], ..stage.setup() };
        setup.registry.add("hand", move |_| Some(AnyPlugin::Simulator(Box::new(hand.lock().unwrap().take()?))));
        assert_eq!(simulation.load_plugins(setup).problems, Vec::<String>::new());
        Self { simulation, work, host: host_out.recv().unwrap(), _stage: stage }
    }

    fn step(&mut self, steps: usize) {
        for _ in 0..steps {
            self.simulation.iterate(0.001).unwrap();
        }
    }

    /// Makes a step, and does `work` after it.
    fn with<T: Send + 'static>(&mut self, work: impl FnOnce(&mut View<'_>) -> T + Send + 'static) -> T {
        let (answer, answered) = channel();
        self.work.send(Box::new(move |world| answer.send(work(world)).unwrap())).unwrap();
        self.step(1);
        answered.recv().expect("the plugin did it")
    }

    fn body(&mut self, name: &'static str) -> BodyState {
        self.with(move |world| {
            let index = world.find(ObjectType::Body, name).unwrap();
            world.body(index).unwrap()
        })
    }
}

const BALL: usize = 1;
const BASE: usize = 2;
const ARM: usize = 3;

fn close(a: f64, b: f64, tolerance: f64) {
    assert!((a - b).abs() <= tolerance, "{a} is not {b}");
}

#[test]
fn objects_are_found_by_name_and_identifier() {
    let mut bench = Bench::new(WEIGHTLESS);
    bench.with(|world| {
        for text in ["Ball", "/s/BODY Ball", "BODY Ball"] {
            assert_eq!(world.find(ObjectType::Body, text), Some(BALL), "{text}");
        }
        assert_eq!(world.find(ObjectType::Body, "BODY B"), None, "two of them");
        assert_eq!((world.find(ObjectType::Joint, "J"), world.find(ObjectType::Joint, "K")), (Some(0), None));
        assert_eq!((world.count(ObjectType::Body), world.count(ObjectType::Sensor), world.model_count()), (4, 1, 2));
        assert_eq!(world.find_model("m0.yaml"), Some(1));
        let ball = ObjectId::new(ObjectType::Body, BALL);
        assert_eq!(world.name(ball).as_deref(), Some("Ball"));
        assert_eq!(world.identifier(ball).as_deref(), Some("/s/BODY Ball"));
        assert_eq!(world.model_of(ball), Some(1));
        assert_eq!(world.model_key(1).as_deref(), Some("/s/m0.yaml"));
        assert!(world.model_file(1).unwrap().ends_with("/m0.yaml"));
        for kind in ObjectType::ALL {
            let absent = ObjectId::new(kind, 99);
            assert_eq!((world.name(absent), world.pose(absent), world.model_of(absent)), (None, None, None));
        }
        assert!(world.body(99).is_none() && world.joint(99).is_none() && world.model_key(99).is_none());
    });
}

#[test]
fn forces_velocities_and_poses_act_in_the_next_step() {
    let mut bench = Bench::new(WEIGHTLESS);
    bench.with(|world| world.apply_wrench(BALL, Vector3::new(20.0, 0.0, 0.0), Vector3::zeros()).unwrap());
    close(bench.body("Ball").linear_velocity.x, 0.01, 1e-9);
    close(bench.body("Ball").linear_velocity.x, 0.01, 1e-9);
    // Off the centre: it turns, too.
    bench.with(|world| {
        let centre = world.body(BALL).unwrap().inertial_pose.translation.vector;
        world.apply_force_at(BALL, Vector3::new(0.0, 2.0, 0.0), centre + Vector3::new(0.1, 0.0, 0.0)).unwrap();
    });
    let state = bench.body("Ball");
    // torque 0.2 N·m on 2/5 m r² = 0.008 kg·m² for 1 ms
    close(state.angular_velocity.z, 0.2 / state.inertia.z * 0.001, 1e-6);
    bench.with(|world| world.set_velocity(BALL, Vector3::new(0.0, 0.0, 3.0), Vector3::zeros()).unwrap());
    close(bench.body("Ball").linear_velocity.z, 3.0, 1e-9);
    let goal = Isometry3::from_parts(Vector3::new(-1.0, 0.5, 2.0).into(), UnitQuaternion::identity());
    let state = bench.with(move |world| {
        world.set_velocity(BALL, Vector3::zeros(), Vector3::zeros()).unwrap();
        world.set_pose(BALL, goal).unwrap();
        world.body(BALL).unwrap()
    });
    assert!((state.pose.translation.vector - goal.translation.vector).norm() < 1e-12, "{:?}", state.pose);
    bench.with(move |world| world.follow_pose(BASE, goal).unwrap());
    assert!((bench.body("Base").pose.translation.vector - goal.translation.vector).norm() < 1e-12);
}

#[test]
fn a_controller_of_its_own_holds_a_joint() {
    let mut bench = Bench::new("gravity: {x: 0, y: 0, z: -10}\nmax iterations: 50\n");
    let state = bench.with(|world| world.joint(0).unwrap());
    assert_eq!((state.parent, state.child, state.limits), (BASE, ARM, (-1.0, 2.0)));
    for _ in 0..2000 {
        bench.with(|world| {
            let joint = world.joint(0).unwrap();
            let effort = 200.0 * (0.5 - joint.position) - 10.0 * joint.velocity;
            world.command_joint(0, JointCommandType::Effort, effort).unwrap();
        });
    }
    // What is left holds the weight: 200 · error = m g · 0.5 · cos.
    close(bench.with(|world| world.joint(0).unwrap().position), 0.5, 0.03);
}

#[test]
fn attached_bodies_move_together_until_they_are_let_go() {
    let mut bench = Bench::new(WEIGHTLESS);
    let number = bench.with(|world| {
        assert_eq!(world.attach(BALL, BALL), Err(CommandError::Refused));
        assert_eq!(world.attach(BALL, 99), Err(CommandError::NoObject));
        world.attach(BALL, BASE).unwrap()
    });
    let pull = |bench: &mut Bench| {
        for _ in 0..100 {
            bench.with(|world| world.apply_wrench(BALL, Vector3::new(5.0, 0.0, 0.0), Vector3::zeros()).unwrap());
        }
        bench.body("Ball").pose.translation.x
    };
    close(pull(&mut bench), 0.0, 1e-3);
    bench.with(move |world| {
        world.detach(number).unwrap();
        assert_eq!(world.detach(number), Err(CommandError::NoObject), "only once");
    });
    assert!(pull(&mut bench) > 0.005);
    // Those that are left go with the plugin, and with the model.
    bench.with(|world| world.attach(BALL, BASE).map(|_| ()).unwrap());
    let held = bench.simulation.scene().world.constraints().len();
    bench.simulation.close_plugins();
    bench.simulation.update(0.001).unwrap();
    assert!(bench.simulation.remove_model("/s/m0.yaml").is_ok() && held > 1);
}

#[test]
fn attachments_go_before_the_bodies_of_a_removed_model() {
    let mut bench = Bench::new(WEIGHTLESS);
    let number = bench.with(|world| world.attach(BALL, BASE).unwrap());
    bench.simulation.remove_model("/s/m0.yaml").unwrap();
    bench.with(move |world| {
        assert_eq!(world.detach(number), Err(CommandError::NoObject));
        assert!(world.body(BALL).is_none() && world.joint(0).is_none());
        let wrench = world.apply_wrench(BALL, Vector3::x(), Vector3::zeros());
        assert_eq!(wrench, Err(CommandError::NoObject));
    });
}

#[test]
fn sensors_rays_contacts_and_ghosts_are_seen() {
    let mut bench = Bench::new("gravity: {x: 0, y: 0, z: -10}\nmax iterations: 50\n");
    bench.step(1500);
    bench.with(|world| {
        let mut readings = vec![7.0];
        world.sensor_readings(0, &mut readings).unwrap();
        // From 1 m above the floor down on the ball, whose top is at 0.2 m: 0.8 m of 2 m.
        assert_eq!(readings.len(), 1);
        close(readings[0], 0.6, 1e-3);
        let hit = world.cast_ray(Vector3::new(0.0, 0.0, 2.0), Vector3::new(0.0, 0.0, -1.0)).unwrap();
        assert_eq!(hit.body, Some(BALL));
        close(hit.point.z, 0.2, 2e-3);
        close(hit.normal.z, 1.0, 1e-6);
        assert_eq!(world.cast_ray(Vector3::new(9.0, 0.0, 2.0), Vector3::new(9.0, 0.0, -1.0)), None);
        let mut touches = Vec::new();
        world.contacts(BALL, &mut touches).unwrap();
        let impulse: f64 = touches.iter().map(|touch| touch.impulse).sum();
        assert!(touches.iter().all(|touch| touch.body == Some(0)), "{touches:?}");
        close(impulse, 2.0 * 10.0 * 0.001, 1e-3);
        assert_eq!((world.contacts(99, &mut touches), touches.len()), (None, 0));
        assert_eq!(world.ghost_bodies(0).unwrap(), Vec::<usize>::new());
        let up = Isometry3::translation(0.0, 0.0, 3.0);
        world.set_pose(BALL, up).unwrap();
    });
    bench.step(2);
    assert_eq!(bench.with(|world| world.ghost_bodies(0).unwrap()).first(), Some(&BALL));
}

#[test]
fn actuators_and_cameras_obey() {
    let mut bench = Bench::new(WEIGHTLESS);
    bench.with(|world| {
        assert_eq!(world.is_holding(0), Some(false));
        world.execute(&Command::Hold { actuator: 0, body: Some(BALL) }).unwrap();
        assert_eq!(world.is_holding(0), Some(true));
        world.execute(&Command::Hold { actuator: 0, body: None }).unwrap();
        assert_eq!(world.is_holding(0), Some(false));
        let camera = ObjectId::new(ObjectType::Camera, world.find(ObjectType::Camera, "/s/C").unwrap());
        let pose = Isometry3::translation(0.0, 1.0, 0.0);
        world.execute(&Command::Place { object: camera, pose }).unwrap();
        assert_eq!(world.pose(camera), Some(pose));
        let body = ObjectId::new(ObjectType::Body, BALL);
        assert_eq!(world.execute(&Command::Place { object: body, pose }), Err(CommandError::Refused));
        let wheel = Command::Drive { vehicle: 0, wheel: 0, steering: 0.0, power: 0.0, brake: 0.0 };
        assert_eq!(world.execute(&wheel), Err(CommandError::NoObject));
        assert_eq!(world.execute(&Command::SoftForce { soft: 0, force: Vector3::x() }), Err(CommandError::NoObject));
    });
}

#[test]
fn numbers_that_are_not_finite_are_refused() {
    let mut bench = Bench::new(WEIGHTLESS);
    bench.with(|world| {
        let nan = Vector3::repeat(f64::NAN);
        assert_eq!(world.apply_wrench(BALL, nan, Vector3::zeros()), Err(CommandError::NotFinite));
        assert_eq!(world.set_velocity(BALL, Vector3::zeros(), nan), Err(CommandError::NotFinite));
        let pose = Isometry3::translation(f64::INFINITY, 0.0, 0.0);
        assert_eq!(world.set_pose(BALL, pose), Err(CommandError::NotFinite));
        assert_eq!(world.follow_pose(BALL, pose), Err(CommandError::NotFinite));
        let joint = world.command_joint(0, JointCommandType::Position, f64::NAN);
        assert_eq!(joint, Err(CommandError::NotFinite));
    });
    bench.step(10);
}

#[test]
fn other_threads_post_commands_and_read_states() {
    let mut bench = Bench::new(WEIGHTLESS);
    let host = bench.host.clone();
    let worker = std::thread::spawn(move || {
        let mut states = StateSnapshot::default();
        assert!(!host.snapshot(&mut states), "nobody asked before");
        host.post(&Command::Wrench { body: BALL, force: Vector3::new(0.0, 2.0, 0.0), torque: Vector3::zeros() })
            .unwrap();
        host.post(&Command::Wrench { body: 99, force: Vector3::zeros(), torque: Vector3::zeros() }).unwrap();
        host.say("hello");
        host
    });
    let host = worker.join().unwrap();
    bench.step(1);
    let mut states = StateSnapshot::default();
    assert!(host.snapshot(&mut states));
    assert_eq!((states.clock.step, states.bodies.len(), states.joints.len()), (1, 4, 1));
    close(states.clock.sim_time, 0.001, 0.0);
    close(states.bodies[BALL].linear_velocity.y, 0.001, 1e-12);
    let notices = bench.simulation.take_notices();
    assert!(notices.contains(&"plugin builtin:hand: hello".to_owned()), "{notices:?}");
    assert!(notices.iter().any(|notice| notice.contains("there is no such object")), "{notices:?}");
}

#[test]
fn plugins_reset_pause_and_step_the_loop() {
    let bench = Bench::new("gravity: {x: 0, y: 0, z: -10}\nmax iterations: 50\n");
    let Bench { simulation, host, _stage, .. } = bench;
    let runner = Runner::start(simulation, RunnerOptions { fixed_step: true, ..RunnerOptions::default() });
    let until = |what: &str, done: &mut dyn FnMut() -> bool| {
        let begin = Instant::now();
        while !done() {
            assert!(begin.elapsed() < Duration::from_secs(20), "{what}");
            std::thread::sleep(Duration::from_millis(2));
        }
    };
    let mut states = StateSnapshot::default();
    until("it falls", &mut || host.snapshot(&mut states) && states.bodies[BALL].pose.translation.z < 0.4);
    host.post(&Command::Pause(true)).unwrap();
    until("it is paused", &mut || runner.control().is_paused());
    // The iteration that found the command still goes to its end.
    let mut paused_at = 0;
    until("it rests", &mut || {
        let before = std::mem::replace(&mut paused_at, states.clock.step);
        std::thread::sleep(Duration::from_millis(100));
        host.snapshot(&mut states) && states.clock.step == paused_at && paused_at == before
    });
    host.post(&Command::Step(7)).unwrap();
    until("it stepped", &mut || host.snapshot(&mut states) && states.clock.step == paused_at + 7);
    host.post(&Command::ResetWorld).unwrap();
    until("it is reset", &mut || runner.events().try_iter().any(|event| event == Event::Reset));
    assert!(runner.control().is_paused(), "a reset leaves the pause alone");
    host.post(&Command::Pause(false)).unwrap();
    until("it goes on", &mut || host.snapshot(&mut states) && states.clock.step > paused_at + 7);
    assert!(states.bodies[BALL].pose.translation.z > 0.3, "from its first place: {:?}", states.bodies[BALL].pose);
    drop(runner);
}

#[test]
fn a_plugin_that_asks_for_a_reset_in_its_update_gets_it_before_the_next_step() {
    let mut bench = Bench::new("gravity: {x: 0, y: 0, z: -10}\nmax iterations: 50\n");
    bench.step(200);
    bench.with(|world| world.execute(&Command::ResetWorld).unwrap());
    let state = bench.body("Ball");
    close(state.inertial_pose.translation.z, 0.5, 1e-4);
    close(state.linear_velocity.z, -0.01, 1e-3);
}

/// What a plugin had attached, or left to be done, acted on after the reset.
#[test]
fn a_reset_undoes_what_plugins_did_but_for_what_they_began_with() {
    let (number, first) = channel();
    let begin = move |world: &mut View<'_>| {
        number.send(world.attach(BALL, BASE).unwrap()).unwrap();
    };
    let mut bench = Bench::beginning(WEIGHTLESS, begin);
    let first = first.recv().unwrap();
    let second = bench.with(move |world| {
        world.execute(&Command::Detach { attachment: first }).unwrap();
        world.attach(ARM, BALL).unwrap()
    });
    let push = |body| Command::Wrench { body, force: Vector3::z() * 100.0, torque: Vector3::zeros() };
    bench.host.post(&push(BALL)).unwrap();
    bench.host.post(&Command::ResetWorld).unwrap();
    bench.host.post(&push(ARM)).unwrap();
    bench.step(1);
    assert_eq!(bench.body("Ball").linear_velocity, Vector3::zeros(), "it was left before, and the ball is held again");
    assert!(bench.body("Arm").linear_velocity.z > 0.01, "it was left after");
    bench.with(move |world| {
        let detach = |attachment| Command::Detach { attachment };
        assert_eq!(world.execute(&detach(second)), Err(CommandError::NoObject));
        assert!(world.execute(&detach(first)).is_ok(), "under the same number");
    });
}
