//! A reset is the start again: whatever was before, what follows is what followed then, bit for bit.

use std::time::{Duration, SystemTime};

use crate::physics_common::load_texts;
use crate::saved_common::{all_shipped, scene_name, shipped, simulation, DT};
use ambf_core::comm::{
    ActuatorCommand, CartesianCommandType, HubIndex, JointCommandType, ObjectKind, PoseCommand, RigidBodyCommand,
    Snapshot, StepOrder, VehicleCommand,
};
use ambf_core::control::Profile;
use ambf_core::ids::ActuatorId;
use ambf_core::scene::{Loaded, PreparedModel};
use ambf_core::sim::{Runner, RunnerOptions, Simulation, Stepper};
use nalgebra::Vector3;

const PROFILES: [Profile; 2] = [Profile::Legacy, Profile::Accurate];

fn profile_name(profile: Profile) -> &'static str {
    match profile {
        Profile::Legacy => "legacy",
        Profile::Accurate => "accurate",
    }
}

/// Everything that is published, but for the clocks, which go on.
fn published(snapshot: &Snapshot) -> String {
    let (stamp, timing) = (SystemTime::UNIX_EPOCH, Default::default());
    let rest = Snapshot { stamp, sim_step: 0, wall_time: 0.0, sim_time: 0.0, timing, ..snapshot.clone() };
    format!("{rest:?}")
}

/// What the body at `object` is told in call `call`, of all kinds.
fn command(object: usize, kind: &ObjectKind, call: usize) -> Option<RigidBodyCommand> {
    let ObjectKind::RigidBody(_, info) = kind else { return None };
    let phase = (object as f64 + call as f64 * 0.3).sin();
    let cartesian = match (object + call / 5) % 4 {
        1 if info.mass < 1.0 => CartesianCommandType::Velocity,
        2 if info.joints.is_empty() => CartesianCommandType::Position,
        _ => CartesianCommandType::Force,
    };
    let joint = |joint: &ambf_core::ids::JointId| joint.index();
    Some(RigidBodyCommand {
        cartesian,
        position: Vector3::new(0.3, phase, 0.2),
        orientation: [0.0, 0.0, 0.0, 1.0],
        force: Vector3::new(phase, 0.0, 0.3),
        linear_velocity: Vector3::new(0.1 * phase, 0.0, 0.0),
        joint_commands: info.joints.iter().map(|id| 0.2 * (phase + joint(id) as f64)).collect(),
        joint_command_types: info.joints.iter().map(|id| (((joint(id) + call / 7) % 3) as i8).into()).collect(),
        ..RigidBodyCommand::default()
    })
}

/// Commands all bodies, and lets actuators take hold of the last body and let go of it.
fn tell(stepper: &mut Stepper, call: usize) {
    let objects = stepper.objects();
    let is_moved = |kind: &ObjectKind| matches!(kind, ObjectKind::RigidBody(_, info) if info.mass > 0.0);
    let mut moved = objects.iter().filter(|object| is_moved(&object.info.kind));
    let held = moved.next_back().map(|object| object.info.identifier.clone()).unwrap_or_default();
    for (object, entry) in objects.entries() {
        if let Some(wanted) = command(object.0, &entry.info.kind, call) {
            *stepper.body_command(object).expect("a body") = wanted;
        }
        if let Some(actuator) = stepper.actuator_command(object) {
            let (actuate, body_name) = ((call / 4).is_multiple_of(2), held.clone());
            *actuator = ActuatorCommand { actuate, body_name, ..ActuatorCommand::default() };
        }
    }
}

/// What is published for a while, at first without commands; what went wrong last, if something did.
fn episode(stepper: &mut Stepper) -> Vec<String> {
    let mut seen = vec![published(stepper.snapshot())];
    for call in 0..45 {
        if call >= 10 {
            tell(stepper, call);
        }
        for _ in 0..4 {
            if let Err(lost) = stepper.step(1) {
                seen.push(lost.to_string());
                return seen;
            }
            seen.push(published(stepper.snapshot()));
        }
    }
    seen
}

fn lose(stepper: &mut Stepper, speed: f64) {
    let objects = stepper.objects();
    for (object, _) in objects.entries() {
        if let Some(command) = stepper.body_command(object) {
            *command = RigidBodyCommand::velocity(Vector3::repeat(speed), Vector3::repeat(speed));
        }
    }
    let lost = stepper.step(20);
    assert!(lost.is_err() && stepper.lost().is_some(), "{speed} m/s are faster than light");
}

fn check(what: &str, again: &[String], first: &[String]) {
    let differs = again.iter().zip(first).position(|(a, b)| a != b);
    if let Some(step) = differs {
        let at = again[step].bytes().zip(first[step].bytes()).position(|(a, b)| a != b).unwrap_or_default();
        let part = |text: &str| text.chars().skip(at.saturating_sub(80)).take(160).collect::<String>();
        panic!("{what}: in step {step}\n  …{}…\nnot …{}…", part(&again[step]), part(&first[step]));
    }
    assert_eq!(again.len(), first.len(), "{what}");
}

/// Episodes were equal to each other in some scenes, and none to the first; after a lost state the first one was lost, too.
#[test]
fn episodes_of_every_shipped_scene_are_that_of_the_start() {
    for files in all_shipped() {
        for profile in PROFILES {
            let mut stepper = Stepper::new(simulation(&files, profile), DT);
            let first = episode(&mut stepper);
            let what = format!("{} {profile:?}", scene_name(&files));
            stepper.reset();
            check(&format!("{what}, after an episode"), &episode(&mut stepper), &first);
            // In the middle of a grip, if there is an actuator.
            (100..133).for_each(|call| {
                tell(&mut stepper, call);
                let _ = stepper.step(2);
            });
            stepper.reset();
            check(&format!("{what}, after more"), &episode(&mut stepper), &first);
            lose(&mut stepper, 1e300);
            stepper.reset();
            check(&format!("{what}, after a loss"), &episode(&mut stepper), &first);
        }
    }
}

#[test]
fn one_reset_restores_whatever_was_lost() {
    for name in ["pendulum.yaml", "arm7.yaml", "stack.yaml", "cloth.yaml", "car.yaml"] {
        for profile in PROFILES {
            let mut stepper = Stepper::new(simulation(&shipped(name), profile), DT);
            let start = published(stepper.snapshot());
            for speed in [1e9, 1e30, 1e308] {
                lose(&mut stepper, speed);
                let (step, time) = (stepper.simulation().sim_step(), stepper.simulation().sim_time());
                stepper.reset();
                assert_eq!(published(stepper.snapshot()), start, "{name} {profile:?} {speed}");
                assert_eq!((stepper.simulation().sim_step(), stepper.simulation().sim_time()), (step, time));
                stepper.step(20).unwrap_or_else(|lost| panic!("{name} {profile:?} {speed}: {lost}"));
            }
        }
    }
}

/// A sheet that is held at two edges, with a ball above it that is to fall into it; `KEYS` of its configuration.
const SHEET: &str = "bodies: [BODY ball]\nsoft bodies: [SHEET]\nsensors: [S]\nnamespace: /t/\n\
    BODY ball: {name: ball, mass: 0.05, location: {position: {x: 0.021, y: -0.034, z: 0.15}}, collision shape: Sphere, \
    collision geometry: {radius: 0.06}}\n\
    S: {name: S, type: Proximity, parent: BODY ball, range: 1, array: [{offset: {x: 0, y: 0, z: 0}, direction: {x: 0, y: 0, z: -1}}]}\n\
    SHEET: {name: sheet, mesh: sheet.obj, mass: 0.2, collision margin: 0.01, config: {kLST: 0.8, kDP: 0.01, kDF: 0.3, \
    piterations: 8KEYS}}\nhigh resolution path: FOLDER\nlow resolution path: FOLDER\n";

fn sheet() -> String {
    let mut text = String::new();
    for i in 0..49 {
        text += &format!("v {} {} 0\n", f64::from(i % 7) * 0.1 - 0.3, f64::from(i / 7) * 0.1 - 0.3);
    }
    for corner in (0..42).filter(|i| i % 7 < 6) {
        text += &format!(
            "f {} {} {}\nf {} {} {}\n",
            corner + 1,
            corner + 2,
            corner + 9,
            corner + 1,
            corner + 9,
            corner + 8
        );
    }
    text
}

/// Among nodes, faces or clusters contacts are found in an order that an episode before had changed.
#[test]
fn episodes_of_soft_bodies_that_touch_are_that_of_the_start() {
    let folder = std::env::temp_dir().join(format!("ambf_reset_soft_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    std::fs::write(folder.join("sheet.obj"), sheet()).expect("written");
    for profile in PROFILES {
        for keys in [
            ", fixed nodes: [0, 6, 42, 48], flags: 1",
            ", fixed nodes: [0, 6, 42, 48], flags: 17, kMT: 0.05",
            ", fixed nodes: [0, 6], flags: 2, clusters: 8",
        ] {
            let model = SHEET.replace("KEYS", keys).replace("FOLDER", &format!("{}/", folder.display()));
            let world = format!("gravity: {{x: 0, y: 0, z: -9.8}}\nphysics: {{profile: {}}}\n", profile_name(profile));
            let Loaded { scene, report } = load_texts(&world, &[&model]);
            assert_eq!(report.errors(), 0, "{report}");
            let mut stepper = Stepper::new(Simulation::new(scene, DT), DT);
            let mut run = |what: &str, first: Option<&[String]>| {
                let mut seen = Vec::new();
                for _ in 0..60 {
                    stepper.step(7).expect("finite");
                    seen.push(published(stepper.snapshot()));
                }
                first.inspect(|first| check(&format!("{profile:?}{keys}, {what}"), &seen, first));
                stepper.reset();
                seen
            };
            let first = run("", None);
            run("second", Some(&first));
            run("third", Some(&first));
        }
    }
    let _ = std::fs::remove_dir_all(&folder);
}

/// The rest of the last step decided how many sub-steps the next ones had.
#[test]
fn episodes_are_equal_where_steps_are_no_multiples_of_sub_steps() {
    for profile in PROFILES {
        let mut stepper = Stepper::new(simulation(&shipped("arm7.yaml"), profile), 0.0026);
        let first = episode(&mut stepper);
        stepper.step(3).expect("finite");
        stepper.reset();
        check(&format!("{profile:?}"), &episode(&mut stepper), &first);
    }
}

/// An order of steps that a reset begins was shifted by an iteration against the first one.
#[test]
fn orders_after_a_reset_are_those_of_the_start() {
    for profile in PROFILES {
        let mut ordered = simulation(&shipped("pendulum.yaml"), profile);
        let hub = ordered.connect();
        hub.set_listening();
        hub.throttle().hold(Duration::MAX, hub.now_ns());
        let runner = Runner::start(ordered, RunnerOptions { fixed_step: true, ..RunnerOptions::default() });
        let run = |reset: bool| {
            let order = |steps, reset| StepOrder { steps, reset, patience: Duration::from_secs(60) };
            let step = |steps, reset| published(&hub.step(order(steps, reset), |_| Ok(())).expect("stepped"));
            [step(0, reset), step(1, false), step(1, false), step(20, false)]
        };
        let first = run(false);
        assert_eq!(run(true), first, "{profile:?}");
        assert_eq!(run(true), first, "{profile:?}");
        runner.stop().expect("no panic");
    }
}

/// A body with an actuator beside another one that it can hold, and a third one.
const GRIP: &str = "bodies: [BODY Hand, BODY Box, BODY Other]\nactuators: [ACTUATOR grip]\nnamespace: /g/\n\
    BODY Hand: {name: Hand, mass: 0, location: {position: {x: 0, y: 0, z: 1}}}\n\
    BODY Box: {name: Box, mass: 1, collision shape: Box, collision geometry: {x: 0.1, y: 0.1, z: 0.1}}\n\
    BODY Other: {name: Other, mass: 1, location: {position: {x: 3, y: 0, z: 0}}, collision shape: Box, \
    collision geometry: {x: 0.1, y: 0.1, z: 0.1}}\n\
    ACTUATOR grip: {name: grip, type: Constraint, parent: BODY Hand}\n";

fn grip(profile: Profile) -> Simulation {
    let world = format!("gravity: {{x: 0, y: 0, z: -10}}\nphysics: {{profile: {}}}\n", profile_name(profile));
    let Loaded { scene, report } = load_texts(&world, &[GRIP]);
    assert_eq!(report.errors(), 0, "{report}");
    Simulation::new(scene, DT)
}

fn object_of(hub: &ambf_core::comm::Hub, name: &str) -> HubIndex {
    let objects = hub.objects();
    let found = objects.entries().find(|(_, object)| object.info.name == name);
    found.unwrap_or_else(|| panic!("no {name}")).0
}

/// A command that was in force, or waited, moved what a reset had put back; an actuator held on.
#[test]
fn a_reset_ends_commands_that_came_before_it_and_no_later_ones() {
    for profile in PROFILES {
        let mut simulation = grip(profile);
        let hub = simulation.connect();
        let [boxed, other, grip] = ["Box", "Other", "grip"].map(|name| object_of(&hub, name));
        let push = RigidBodyCommand::wrench(Vector3::x() * 1e3, Vector3::zeros());
        let hold = ActuatorCommand { actuate: true, body_name: "BODY Box".into(), ..ActuatorCommand::default() };
        let velocity = |simulation: &Simulation, body: usize| {
            let handle = simulation.scene().world.bodies()[body];
            simulation.scene().world.velocity(handle).expect("alive").0
        };
        hub.post(grip, &hold).expect("finite");
        hub.post(other, &push).expect("finite");
        for _ in 0..20 {
            simulation.iterate(DT).expect("finite");
        }
        assert!(simulation.scene().actuators[ActuatorId::new(0)].is_actuated());
        assert!(velocity(&simulation, 2).x > 1.0);
        // This one waits.
        hub.post(boxed, &push).expect("finite");
        simulation.reset_world();
        assert!(!simulation.scene().actuators[ActuatorId::new(0)].is_actuated(), "{profile:?}: it has let go");
        for _ in 0..20 {
            simulation.iterate(DT).expect("finite");
        }
        assert!(!simulation.scene().actuators[ActuatorId::new(0)].is_actuated(), "{profile:?}: it does not hold again");
        let fallen = Vector3::new(0.0, 0.0, -0.2);
        assert!((velocity(&simulation, 1) - fallen).norm() < 1e-3, "{profile:?}: {}", velocity(&simulation, 1));
        assert!((velocity(&simulation, 2) - fallen).norm() < 1e-3, "{profile:?}: {}", velocity(&simulation, 2));

        let mut stepper = Stepper::new(simulation, DT);
        let hub = stepper.window().hub;
        hub.post(other, &push).expect("finite");
        hub.request_world_reset();
        hub.post(boxed, &push).expect("finite");
        stepper.step(20).expect("finite");
        assert!(velocity(stepper.simulation(), 1).x > 1.0, "{profile:?}: it came after the reset was asked for");
        assert!(velocity(stepper.simulation(), 2).x.abs() < 1e-3, "{profile:?}: it came before");
    }
}

#[test]
fn a_reset_of_the_bodies_leaves_commands_and_grips() {
    for profile in PROFILES {
        let mut simulation = grip(profile);
        let hub = simulation.connect();
        let [other, grip] = ["Other", "grip"].map(|name| object_of(&hub, name));
        let hold = ActuatorCommand { actuate: true, body_name: "BODY Box".into(), ..ActuatorCommand::default() };
        hub.post(grip, &hold).expect("finite");
        hub.post(other, &RigidBodyCommand::wrench(Vector3::x() * 10.0, Vector3::zeros())).expect("finite");
        for _ in 0..20 {
            simulation.iterate(DT).expect("finite");
        }
        simulation.reset_bodies();
        let x = |simulation: &Simulation| {
            let handle = simulation.scene().world.bodies()[2];
            simulation.scene().world.pose(handle).expect("alive").translation.x
        };
        assert_eq!(x(&simulation), 3.0, "{profile:?}");
        assert!(simulation.scene().actuators[ActuatorId::new(0)].is_actuated(), "{profile:?}");
        for _ in 0..20 {
            simulation.iterate(DT).expect("finite");
        }
        assert!(x(&simulation) > 3.001, "{profile:?}: {}", x(&simulation));
    }
}

/// Resets of windows were done in a step only, and not at all while the state was lost.
#[test]
fn a_stepper_does_the_resets_of_windows_between_steps_and_after_a_loss() {
    let mut stepper = Stepper::new(simulation(&shipped("pendulum.yaml"), Profile::Accurate), DT);
    let window = stepper.window();
    let start = published(stepper.snapshot());
    stepper.step(50).expect("finite");
    window.hub.request_world_reset();
    stepper.serve_window();
    assert_eq!(published(stepper.snapshot()), start);
    lose(&mut stepper, 1e300);
    window.hub.request_body_reset();
    stepper.step(1).expect("it was reset");
    assert_eq!(published(stepper.snapshot()), start, "a lost state needs a reset of the world");
    assert_eq!(window.hub.snapshot().as_ref().map(|snapshot| published(snapshot)), Some(start));
}

/// Links that were held by their own arm stayed constraints between free bodies for good.
#[test]
fn what_a_grip_took_apart_is_put_together_again() {
    let arm = "bodies: [BODY A, BODY B, BODY C]\njoints: [J, K]\nactuators: [ACTUATOR grip]\n\
        BODY A: {name: A, mass: 0}\n\
        BODY B: {name: B, mass: 1, location: {position: {x: 0.5, y: 0, z: 0}}, inertia: {ix: 0.01, iy: 0.01, iz: 0.01}}\n\
        BODY C: {name: C, mass: 1, location: {position: {x: 1.5, y: 0, z: 0}}, inertia: {ix: 0.01, iy: 0.01, iz: 0.01}}\n\
        J: {name: J, type: revolute, parent: BODY A, child: BODY B, parent pivot: {x: 0, y: 0, z: 0}, \
        child pivot: {x: -0.5, y: 0, z: 0}, parent axis: {x: 0, y: 1, z: 0}, child axis: {x: 0, y: 1, z: 0}}\n\
        K: {name: K, type: revolute, parent: BODY B, child: BODY C, parent pivot: {x: 0.5, y: 0, z: 0}, \
        child pivot: {x: -0.5, y: 0, z: 0}, parent axis: {x: 0, y: 1, z: 0}, child axis: {x: 0, y: 1, z: 0}}\n\
        ACTUATOR grip: {name: grip, type: Constraint, parent: BODY B}\n";
    let Loaded { scene, report } = load_texts("gravity: {x: 0, y: 0, z: -10}\nphysics: {profile: accurate}\n", &[arm]);
    assert_eq!(report.errors(), 0, "{report}");
    let mut stepper = Stepper::new(Simulation::new(scene, DT), DT);
    let is_link = |stepper: &Stepper| {
        let world = &stepper.simulation().scene().world;
        world.articulation(world.bodies()[2]).is_some()
    };
    assert!(is_link(&stepper));
    let first = episode(&mut stepper);
    assert!(!is_link(&stepper), "the actuator has held it");
    stepper.reset();
    assert!(is_link(&stepper));
    check("an arm that holds itself", &episode(&mut stepper), &first);
}

/// Also a model that was added on the way comes back, and every episode from then on is the same.
#[test]
fn models_that_were_added_are_reset_with_the_others() {
    for profile in PROFILES {
        let mut simulation = simulation(&shipped("pendulum.yaml"), profile);
        simulation.connect();
        for _ in 0..30 {
            simulation.iterate(DT).expect("finite");
        }
        for name in ["arm7.yaml", "stack.yaml"] {
            let path = shipped(name).models.remove(0);
            simulation
                .add_model(PreparedModel::read(&path).unwrap_or_else(|error| panic!("{error}")))
                .expect("it is added");
        }
        let mut run = || {
            let last = simulation.scene().bodies.ids().last().expect("a body");
            simulation.set_velocity(last, Vector3::repeat(1e300), Vector3::repeat(1e300));
            assert!((0..3).any(|_| simulation.iterate(DT).is_err()), "{profile:?}");
            simulation.reset_world();
            let mut seen = Vec::new();
            for step in 0..150 {
                for body in simulation.scene().bodies.ids() {
                    for joint in 0..simulation.scene().active_joints(body).len() {
                        let goal = 0.3 * f64::from(step).sin();
                        simulation.command_joint(body, joint, JointCommandType::Position, goal);
                    }
                }
                simulation.iterate(DT).unwrap_or_else(|lost| panic!("{profile:?}: {lost}"));
                seen.push(published(&simulation.snapshot()));
            }
            seen
        };
        let first = run();
        check(&format!("{profile:?}"), &run(), &first);
    }
}

/// What clients have set for good is no command: it stays, also what waits.
#[test]
fn parameters_and_the_motion_of_nobody_survive_a_reset() {
    let mut simulation = simulation(&shipped("car.yaml"), Profile::Legacy);
    let hub = simulation.connect();
    let objects = hub.objects().clone();
    let camera = objects.entries().find_map(|(object, entry)| match &entry.info.kind {
        ObjectKind::Camera(id, parameters) => Some((object, *id, parameters.clone())),
        _ => None,
    });
    let (object, id, mut parameters) = camera.expect("a camera");
    parameters.far_plane = 123.0;
    hub.post(object, &*parameters).expect("finite");
    let there = PoseCommand { enabled: true, position: Vector3::repeat(9.0), ..PoseCommand::default() };
    hub.post(object, &there).expect("finite");
    let vehicle = objects.entries().find(|(_, entry)| matches!(entry.info.kind, ObjectKind::Vehicle(..)));
    let drive = VehicleCommand { power: vec![50.0; 4], steering: vec![0.3; 4], ..VehicleCommand::default() };
    hub.post(vehicle.expect("a car").0, &drive).expect("finite");
    let before = simulation.scene().cameras[id].attached.pose;
    simulation.reset_world();
    simulation.iterate(DT).expect("finite");
    assert_eq!(simulation.scene().cameras[id].parameters.far_plane, 123.0);
    assert_eq!(simulation.scene().cameras[id].attached.pose, before);
    let mut twin = crate::saved_common::simulation(&shipped("car.yaml"), Profile::Legacy);
    for _ in 0..200 {
        simulation.iterate(DT).expect("finite");
    }
    (0..201).for_each(|_| twin.iterate(DT).expect("finite"));
    let bodies = |simulation: &Simulation| format!("{:?}", simulation.snapshot().bodies);
    assert_eq!(bodies(&simulation), bodies(&twin), "nobody drives the car");
}
