//! Motors and limits of trees in the accurate profile, however strong and fast they are.

use crate::physics_common::{load_texts, Bench};
use ambf_core::comm::JointCommandType::{self, Effort, Position, Velocity};
use ambf_core::sim::Simulation;

const WORLD: &str = "gravity: {x: 0, y: 0, z: -9.81}\nmax iterations: 50\nphysics: {profile: accurate}\n";
const STEPS: [f64; 4] = [0.001, 0.002, 0.005, 0.01];

fn bench(model: &str, step: f64) -> Bench {
    let loaded = load_texts(WORLD, &[model]);
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    Bench(Simulation::new(loaded.scene, step))
}

/// A link of 0.05 kg·m² that turns about the vertical through its centre of mass; more keys of the joint.
fn wheel(keys: &str, step: f64) -> Bench {
    let model = format!(
        "bodies: [BODY base, BODY link]\njoints: [JOINT hinge]\nBODY base: {{name: base, mass: 0}}\n\
         BODY link: {{name: link, mass: 2, inertia: {{ix: 0.05, iy: 0.05, iz: 0.05}}, damping: {{linear: 0, angular: 0}}}}\n\
         JOINT hinge: {{name: hinge, type: revolute, parent: BODY base, child: BODY link, parent axis: {{x: 0, y: 0, z: 1}}, \
         child axis: {{x: 0, y: 0, z: 1}}, parent pivot: {{x: 0, y: 0, z: 0}}, child pivot: {{x: 0, y: 0, z: 0}}{keys}}}\n"
    );
    bench(&model, step)
}

/// An arm of four links of 0.2 m whose hinges have limits of ±1.5 rad and velocity controllers, which no torque bounds.
fn arm(masses: [f64; 4], step: f64) -> Bench {
    let mut model = String::from(
        "bodies: [BODY base, BODY l0, BODY l1, BODY l2, BODY l3]\njoints: [JOINT j0, JOINT j1, JOINT j2, JOINT j3]\n\
         ignore inter-collision: true\nBODY base: {name: base, mass: 0}\n",
    );
    for (i, mass) in masses.into_iter().enumerate() {
        let axis = ["{x: 0, y: 1, z: 0}", "{x: 0, y: 0, z: 1}"][i % 2];
        let (parent, pivot) = if i == 0 { ("base".to_owned(), 0.0) } else { (format!("l{}", i - 1), 0.1) };
        model += &format!(
            "BODY l{i}: {{name: l{i}, mass: {mass}, inertia: {{ix: {0}, iy: {1}, iz: {1}}}, \
             location: {{position: {{x: {2}, y: 0, z: 0}}}}}}\n\
             JOINT j{i}: {{name: j{i}, type: revolute, parent: BODY {parent}, child: BODY l{i}, parent axis: {axis}, \
             child axis: {axis}, parent pivot: {{x: {pivot}, y: 0, z: 0}}, child pivot: {{x: -0.1, y: 0, z: 0}}, \
             joint limits: {{low: -1.5, high: 1.5}}, controller: {{P: 30, I: 0, D: 0.4}}, \
             controller output type: VELOCITY, max motor impulse: 2000}}\n",
            mass * 1.5e-4,
            mass * 3.4e-3,
            0.1 + 0.2 * i as f64,
        );
    }
    bench(&model, step)
}

fn positions(bench: &Bench) -> [f64; 4] {
    std::array::from_fn(|i| bench.joint(&format!("j{i}")).position)
}

fn command(bench: &mut Bench, kind: JointCommandType, values: &[f64], step: f64) {
    let base = bench.body("base");
    for (i, &value) in values.iter().enumerate() {
        assert!(bench.0.command_joint(base, i, kind, value));
    }
    bench.update(step);
}

#[test]
fn joints_stay_within_their_limits_when_set_points_jump() {
    for masses in [[5.0, 5.0, 1.0, 1.0], [0.02, 2.0, 0.01, 0.5]] {
        for step in STEPS {
            let mut bench = arm(masses, step);
            let mut before = [0.0; 4];
            for i in 0..(1.2 / step) as u32 {
                let to = if f64::from(i) * step < 0.4 { 1.4 } else { -1.4 };
                command(&mut bench, Position, &[to, -to, to, -to], step);
                let now = positions(&bench);
                for (at, was) in now.iter().zip(before) {
                    assert!(at.abs() < 1.5, "{masses:?}, {step} s, step {i}: {now:?}");
                    assert!(
                        (at - was).abs() <= 0.1 + 1e-9,
                        "{masses:?}, {step} s, step {i}: from {before:?} to {now:?}"
                    );
                }
                before = now;
            }
            assert!(before.iter().all(|at| (at.abs() - 1.4).abs() < 0.02), "{masses:?}, {step} s: {before:?}");
        }
    }
}

#[test]
fn a_motor_rests_at_the_limit_into_which_it_drives() {
    for step in STEPS {
        for speed in [3.0, 30.0] {
            for impulse in [0.01, 0.1, 1000.0] {
                let mut bench =
                    wheel(&format!(", joint limits: {{low: -0.5, high: 0.5}}, max motor impulse: {impulse}"), step);
                let mut worst: f64 = 0.0;
                for i in 0..(2.0 / step) as u32 {
                    command(&mut bench, Velocity, &[speed], step);
                    let beyond = bench.joint("hinge").position - 0.5;
                    assert!(beyond < 1e-9, "{step} s, {speed} rad/s, {impulse} N·m·s: {beyond:e} beyond the limit");
                    if f64::from(i) * step > 1.0 {
                        worst = worst.max(beyond.abs());
                    }
                }
                assert!(worst < 1e-6, "{step} s, {speed} rad/s, {impulse} N·m·s: unrest of {worst:e}");
            }
        }
    }
}

#[test]
fn a_joint_turns_as_fast_as_its_torque_makes_it() {
    for (step, torque) in [(0.001, 500.0), (0.005, 100.0), (0.01, 100.0)] {
        let mut bench = wheel("", step);
        let count = (0.5 / step) as u32;
        for _ in 0..count {
            command(&mut bench, Effort, &[torque], step);
        }
        let (speed, right) = (bench.velocity("link").1.z, torque / 0.05 * 0.5);
        assert!((speed - right).abs() < 1e-6 * right, "{step} s: {speed} for {right} rad/s");
        // The mean over the last step, in which it turns by more than half a turn.
        let told = bench.joint("hinge").velocity;
        assert!((told - right).abs() < 0.02 * right, "{step} s: {told} for {right} rad/s");
    }
}

/// Two jaws of 1 kg that close on a box of 100 g, which stands on the ground, to 0.25 mm within it on either side.
fn jaws(impulse: f64, step: f64) -> Bench {
    let mut model = String::from(
        "bodies: [BODY base, BODY left, BODY right, BODY ground, BODY box]\njoints: [JOINT left, JOINT right]\n\
         BODY base: {name: base, mass: 0, location: {position: {x: 0, y: 0, z: 0.3}}}\n\
         BODY ground: {name: ground, mass: 0, collision shape: BOX, collision geometry: {x: 0.3, y: 0.3, z: 0.02}, \
         location: {position: {x: 0, y: 0, z: -0.01}}}\n\
         BODY box: {name: box, mass: 0.1, collision shape: BOX, collision geometry: {x: 0.02, y: 0.01, z: 0.03}, \
         friction: {static: 0.5}, location: {position: {x: 0, y: 0.0002, z: 0.015}}}\n",
    );
    for (name, side) in [("left", 1.0), ("right", -1.0)] {
        model += &format!(
            "BODY {name}: {{name: {name}, mass: 1, inertia: {{ix: 4.0e-4, iy: 4.0e-4, iz: 4.0e-4}}, collision shape: BOX, \
             collision geometry: {{x: 0.006, y: 0.01, z: 0.01}}, friction: {{static: 0.5}}, \
             location: {{position: {{x: 0, y: {y}, z: 0.015}}}}}}\n\
             JOINT {name}: {{name: {name}, type: prismatic, parent: BODY base, child: BODY {name}, \
             parent axis: {{x: 0, y: {side}, z: 0}}, child axis: {{x: 0, y: {side}, z: 0}}, \
             parent pivot: {{x: 0, y: {y}, z: -0.285}}, child pivot: {{x: 0, y: 0, z: 0}}, \
             joint limits: {{low: -0.02, high: 0.02}}, controller: {{P: 30, I: 0, D: 0.4}}, \
             controller output type: VELOCITY, max motor impulse: {impulse}}}\n",
            y = 0.02 * side,
        );
    }
    bench(&model, step)
}

#[test]
fn jaws_hold_what_they_grip_with_any_bound_of_their_motors() {
    for step in [0.001, 0.005] {
        for impulse in [0.01, 2.0, 500.0] {
            let mut bench = jaws(impulse, step);
            let (mut fastest, mut unrest) = (0.0_f64, 0.0_f64);
            for i in 0..(2.5 / step) as u32 {
                let at = (f64::from(i) * step / 0.5).min(1.0) * -0.01025;
                command(&mut bench, Position, &[at, at], step);
                let (linear, angular) = bench.velocity("box");
                let speed = linear.norm() + 0.015 * angular.norm();
                fastest = fastest.max(speed);
                if f64::from(i) * step > 1.5 {
                    unrest = unrest.max(speed);
                }
            }
            assert!(fastest < 0.1, "{step} s, {impulse}: {fastest} m/s");
            assert!(unrest < 1e-3, "{step} s, {impulse}: {unrest} m/s");
            let width = bench.position("left").y - bench.position("right").y;
            assert!((0.0199..0.0202).contains(&width), "{step} s, {impulse}: the jaws are {width} m apart");
        }
    }
}

#[test]
fn a_joint_whose_limits_are_equal_does_not_move() {
    for step in STEPS {
        let mut bench = wheel(", joint limits: {low: 0.2, high: 0.2}", step);
        for _ in 0..(1.0 / step) as u32 {
            command(&mut bench, Velocity, &[5.0], step);
        }
        let at = bench.joint("hinge").position;
        assert!((at - 0.2).abs() < 1e-6, "{step} s: {at}");
    }
}

/// A light link on a free base: impacts at limits leave the mass centre where it falls.
#[test]
fn limits_do_not_move_the_mass_centre_of_a_free_base() {
    let model = "bodies: [BODY base, BODY link]\njoints: [JOINT slide]\n\
         BODY base: {name: base, mass: 2, inertia: {ix: 0.05, iy: 0.05, iz: 0.05}, damping: {linear: 0, angular: 0}}\n\
         BODY link: {name: link, mass: 1, inertia: {ix: 0.02, iy: 0.02, iz: 0.02}, damping: {linear: 0, angular: 0}, \
         location: {position: {x: 0.2, y: 0, z: 0}}}\n\
         JOINT slide: {name: slide, type: prismatic, parent: BODY base, child: BODY link, parent axis: {x: 1, y: 0, z: 0}, \
         child axis: {x: 1, y: 0, z: 0}, parent pivot: {x: 0.2, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}, \
         joint limits: {low: -0.05, high: 0.05}}\n";
    for step in STEPS {
        let mut bench = bench(model, step);
        for _ in 0..(0.5 / step) as u32 {
            command(&mut bench, Effort, &[20.0], step);
            let centre = (bench.position("base").x * 2.0 + bench.position("link").x) / 3.0;
            assert!((centre - 0.2 / 3.0).abs() < 1e-6, "{step} s: {centre}");
        }
        let at = bench.joint("slide").position;
        assert!((at - 0.05).abs() < 1e-6, "{step} s: {at}");
    }
}
