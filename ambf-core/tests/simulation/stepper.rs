//! Steps in the caller's thread: what a runner does for orders, number for number.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::time::Duration;

use crate::saved_common::{shipped, simulation, DT};
use ambf_core::comm::{
    CartesianCommandType, Hub, HubIndex, JointCommandType, ObjectKind, OrderedCommands, RigidBodyCommand, Snapshot,
    StepOrder,
};
use ambf_core::control::Profile;
use ambf_core::sim::{Runner, RunnerOptions, Simulation, Stepper};
use nalgebra::Vector3;

const PROFILES: [Profile; 2] = [Profile::Legacy, Profile::Accurate];
const SCENES: [&str; 3] = ["arm7.yaml", "gripper.yaml", "joints.yaml"];

fn load(scene: &str, profile: Profile) -> Simulation {
    simulation(&shipped(scene), profile)
}

/// What the body at `object` is told in call `call`, of all kinds; `None`: nothing new.
fn command(object: usize, kind: &ObjectKind, call: usize) -> Option<RigidBodyCommand> {
    let ObjectKind::RigidBody(_, info) = kind else { return None };
    if (object + call).is_multiple_of(3) {
        return None;
    }
    let phase = (object as f64 + call as f64 * 0.3).sin();
    let cartesian = match (object + call / 5) % 4 {
        1 if info.mass < 1.0 => CartesianCommandType::Velocity,
        2 if info.joints.is_empty() => CartesianCommandType::Position,
        _ => CartesianCommandType::Force,
    };
    Some(RigidBodyCommand {
        cartesian,
        position: Vector3::new(0.3, phase, 0.2),
        orientation: [0.0, 0.0, 0.0, 1.0],
        force: Vector3::new(phase, 0.0, 0.3),
        linear_velocity: Vector3::new(0.1 * phase, 0.0, 0.0),
        joint_commands: info.joints.iter().map(|&joint| 0.2 * (phase + joint.index() as f64)).collect(),
        joint_command_types: info
            .joints
            .iter()
            .map(|joint| JointCommandType::from(((joint.index() + call / 7) % 3) as i8))
            .collect(),
        ..RigidBodyCommand::default()
    })
}

/// The bits of what is published, but for the clock.
fn bits(snapshot: &Snapshot) -> Vec<u64> {
    let mut numbers: Vec<f64> = vec![f64::from(snapshot.sim_step), snapshot.sim_time];
    for body in &snapshot.bodies {
        numbers
            .extend(body.origin.iter().chain(&body.basis).chain(&body.linear_velocity).chain(&body.angular_velocity));
    }
    numbers.extend(snapshot.joint_positions.iter().chain(&snapshot.joint_velocities).chain(&snapshot.joint_efforts));
    numbers.extend(snapshot.sensors.iter().flatten().map(|reading| reading.measurement));
    numbers.iter().map(|number| number.to_bits()).collect()
}

/// How many iterations call `call` makes, and whether it begins with a reset.
fn schedule(call: usize) -> (u32, bool) {
    ([1, 2, 7, 1, 20][call % 5], call.is_multiple_of(23))
}

fn drive(stepper: &mut Stepper, call: usize) -> Vec<u64> {
    let (steps, reset) = schedule(call);
    if reset {
        stepper.reset();
    }
    for (object, entry) in stepper.objects().entries() {
        if let Some(wanted) = command(object.0, &entry.info.kind, call) {
            *stepper.body_command(object).expect("a body") = wanted;
        }
    }
    stepper.step(steps).expect("finite");
    bits(stepper.snapshot())
}

fn order(hub: &Arc<Hub>, call: usize) -> Vec<u64> {
    let (steps, reset) = schedule(call);
    let order = StepOrder { steps, reset, patience: Duration::from_secs(60) };
    let post = |commands: &OrderedCommands| {
        let objects = hub.objects().clone();
        for (object, entry) in objects.entries() {
            let told = |call| command(object.0, &entry.info.kind, call);
            // What a stepper keeps the watchdog would clear where calls take long.
            let again = || call.checked_sub(1).filter(|_| !reset).and_then(told);
            if let Some(command) = told(call).or_else(again) {
                commands.post(object, &command)?;
            }
        }
        Ok(())
    };
    bits(&hub.step(order, post).expect("stepped"))
}

#[test]
fn orders_of_a_runner_have_the_same_results() {
    for scene in SCENES {
        for profile in PROFILES {
            let mut ordered = load(scene, profile);
            let hub = ordered.connect();
            hub.set_listening();
            hub.throttle().hold(Duration::MAX, hub.now_ns());
            let runner = Runner::start(ordered, RunnerOptions { fixed_step: true, ..RunnerOptions::default() });
            let mut stepper = Stepper::new(load(scene, profile), DT);
            for call in 0..60 {
                assert_eq!(drive(&mut stepper, call), order(&hub, call), "{scene} {profile:?}, call {call}");
            }
            runner.stop().expect("no panic");
        }
    }
}

#[test]
fn what_others_post_meanwhile_does_not_reach_commanded_objects() {
    let with = |noise: bool| {
        let mut ordered = load("joints.yaml", Profile::Accurate);
        let hub = ordered.connect();
        hub.set_listening();
        hub.throttle().hold(Duration::MAX, hub.now_ns());
        let runner = Runner::start(ordered, RunnerOptions { fixed_step: true, ..RunnerOptions::default() });
        let bodies: Vec<HubIndex> = hub.objects().entries().map(|(object, _)| object).collect();
        let push = |z: f64| RigidBodyCommand { force: Vector3::new(0.0, 0.0, z), ..RigidBodyCommand::default() };
        let done = AtomicBool::new(!noise);
        let states = std::thread::scope(|scope| {
            scope.spawn(|| {
                while !done.load(Ordering::Acquire) {
                    bodies.iter().for_each(|&body| hub.post(body, &push(100.0)).expect("finite"));
                }
            });
            let states: Vec<_> = (0..200)
                .map(|call| {
                    let order = StepOrder { steps: 1 + call % 3, reset: false, patience: Duration::from_secs(60) };
                    let post = |commands: &OrderedCommands| {
                        bodies.iter().try_for_each(|&body| commands.post(body, &push(f64::from(call % 5))))
                    };
                    bits(&hub.step(order, post).expect("stepped"))
                })
                .collect();
            done.store(true, Ordering::Release);
            states
        });
        runner.stop().expect("no panic");
        states
    };
    assert!(with(true) == with(false));
}

#[test]
fn how_steps_are_divided_into_calls_makes_no_difference() {
    let run = |calls: &[u32]| {
        let mut stepper = Stepper::new(load("arm7.yaml", Profile::Accurate), DT);
        calls.iter().for_each(|&steps| stepper.step(steps).expect("finite"));
        bits(stepper.snapshot())
    };
    let whole = run(&[100]);
    assert_eq!(whole, run(&[1; 100]));
    assert_eq!(whole, run(&[33, 0, 67]));
    let mut stepper = Stepper::new(load("arm7.yaml", Profile::Accurate), DT);
    let mut left = 100;
    while left > 0 {
        let mut asked = 0;
        let go_on = || {
            asked += 1;
            asked < 9
        };
        left -= stepper.step_while(left, go_on).expect("finite");
    }
    assert_eq!(whole, bits(stepper.snapshot()));
}

#[test]
fn threads_make_no_difference() {
    for profile in PROFILES {
        let alone: Vec<u64> = {
            let mut stepper = Stepper::new(load("arm7.yaml", profile), DT);
            (0..40).flat_map(|call| drive(&mut stepper, call)).collect()
        };
        let steppers: Vec<Stepper> = (0..4).map(|_| Stepper::new(load("arm7.yaml", profile), DT)).collect();
        std::thread::scope(|scope| {
            for mut stepper in steppers {
                let alone = &alone;
                scope.spawn(move || {
                    let seen: Vec<u64> = (0..40).flat_map(|call| drive(&mut stepper, call)).collect();
                    assert!(seen == *alone, "{profile:?}");
                });
            }
        });
    }
}

#[test]
fn a_saved_state_goes_on_as_it_did() {
    for scene in SCENES {
        for profile in PROFILES {
            let mut stepper = Stepper::new(load(scene, profile), DT);
            (0..20).for_each(|call| drop(drive(&mut stepper, call)));
            let state = stepper.save().expect("savable");
            let then = bits(stepper.snapshot());
            let first: Vec<_> = (20..40).map(|call| drive(&mut stepper, call)).collect();
            stepper.restore(&state).expect("its own state");
            assert_eq!(bits(stepper.snapshot()), then);
            let second: Vec<_> = (20..40).map(|call| drive(&mut stepper, call)).collect();
            assert!(first == second, "{scene} {profile:?}");
        }
    }
}

#[test]
fn a_lost_state_is_told_until_a_reset() {
    let mut stepper = Stepper::new(load("arm7.yaml", Profile::Legacy), DT);
    let is_moved =
        |kind: &ObjectKind| matches!(kind, ObjectKind::RigidBody(_, info) if info.mass > 0.0 && info.joints.is_empty());
    let objects = stepper.objects();
    let (object, _) = objects.entries().find(|(_, entry)| is_moved(&entry.info.kind)).expect("the flange");
    let before = bits(stepper.snapshot());
    let push = |stepper: &mut Stepper, force: f64| {
        stepper.body_command(object).expect("a body").force = Vector3::new(force, 0.0, 0.0);
    };
    push(&mut stepper, 1e308);
    let problem = stepper.step(50).expect_err("more than there are numbers for");
    assert!(problem.step > 1 && problem.body.contains("arm7"), "{problem}");
    assert_eq!(bits(stepper.snapshot()), before, "what was published is sound");
    push(&mut stepper, 0.0);
    assert_eq!(stepper.step(1), Err(problem.clone()));
    assert_eq!(stepper.lost(), Some(&problem));
    stepper.reset();
    stepper.step(50).expect("all is well again");
    assert!(stepper.snapshot().joint_positions.iter().all(|position| position.is_finite()));
}
