//! The same scenes with joints in reduced coordinates and without: commands, limits and states come out the same.

use crate::physics_common::{load_texts, Bench};
use ambf_core::comm::JointCommandType;
use ambf_core::sim::Simulation;
use nalgebra::Vector3;

/// A base, two hinged links and a finger on a slider; gravity along z, everything is damped a little.
const ARM: &str = "bodies: [BODY Base, BODY Upper, BODY Lower, BODY Finger]\njoints: [JOINT A, JOINT B, JOINT C]\n\
    BODY Base: {name: Base, mass: 0}\n\
    BODY Upper: {name: Upper, mass: 2, inertia: {ix: 0.01, iy: 0.03, iz: 0.03}, location: {position: {x: 0.25, y: 0, z: 0}}}\n\
    BODY Lower: {name: Lower, mass: 1, inertia: {ix: 0.01, iy: 0.02, iz: 0.02}, location: {position: {x: 0.75, y: 0, z: 0}}}\n\
    BODY Finger: {name: Finger, mass: 0.2, inertia: {ix: 0.001, iy: 0.001, iz: 0.001}, \
    location: {position: {x: 1, y: 0, z: 0}}}\n\
    JOINT A: {name: A, type: revolute, parent: BODY Base, child: BODY Upper, parent axis: {x: 0, y: 1, z: 0}, \
    child axis: {x: 0, y: 1, z: 0}, parent pivot: {x: 0, y: 0, z: 0}, child pivot: {x: -0.25, y: 0, z: 0}, \
    joint limits: {low: -1.2, high: 1.2}, enable feedback: true, controller: {P: 5000, I: 0, D: 200}, max motor impulse: 0.2}\n\
    JOINT B: {name: B, type: revolute, parent: BODY Upper, child: BODY Lower, parent axis: {x: 0, y: 1, z: 0}, \
    child axis: {x: 0, y: 1, z: 0}, parent pivot: {x: 0.25, y: 0, z: 0}, child pivot: {x: -0.25, y: 0, z: 0}, \
    enable feedback: true, controller: {P: 5000, I: 0, D: 200}, max motor impulse: 0.2}\n\
    JOINT C: {name: C, type: prismatic, parent: BODY Lower, child: BODY Finger, parent axis: {x: 1, y: 0, z: 0}, \
    child axis: {x: 1, y: 0, z: 0}, parent pivot: {x: 0.25, y: 0, z: 0}, child pivot: {x: 0, y: 0, z: 0}, \
    joint limits: {low: 0, high: 0.1}, enable feedback: true, controller: {P: 5000, I: 0, D: 200}, max motor impulse: 0.1}\n";

const JOINTS: [&str; 3] = ["A", "B", "C"];

fn bench(articulated: bool) -> Bench {
    bench_with(articulated, "rk4")
}

fn world(articulated: bool, integrator: &str) -> String {
    format!(
        "gravity: {{x: 0, y: 0, z: -10}}\nmax iterations: 50\n\
         physics: {{profile: accurate, articulated: {articulated}, iterations: 100, integrator: {integrator}}}\n"
    )
}

fn bench_with(articulated: bool, integrator: &str) -> Bench {
    let bench = Bench::new(&world(articulated, integrator), ARM);
    let scene = bench.0.scene();
    let link = scene.world.bodies()[bench.body("Lower").index()];
    assert_eq!(scene.world.articulation(link).is_some(), articulated);
    bench
}

/// What a run leaves.
#[derive(Debug)]
struct Outcome {
    positions: [f64; 3],
    velocities: [f64; 3],
    efforts: [f64; 3],
    finger: Vector3<f64>,
}

/// With trees and without.
fn both(run: impl Fn(&mut Bench)) -> [Outcome; 2] {
    [true, false].map(|articulated| {
        let mut bench = bench(articulated);
        run(&mut bench);
        let of = |value: fn(&ambf_core::scene::Joint) -> f64| JOINTS.map(|name| value(bench.joint(name)));
        Outcome {
            positions: of(|joint| joint.position),
            velocities: of(|joint| joint.velocity),
            efforts: of(|joint| joint.effort),
            finger: bench.position("Finger"),
        }
    })
}

#[track_caller]
fn alike(run: impl Fn(&mut Bench), place: f64, speed: f64, effort: f64) {
    let [tree, free] = both(run);
    let far = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(far(&tree.positions, &free.positions) < place, "positions {tree:?} {free:?}");
    assert!(far(&tree.velocities, &free.velocities) < speed, "velocities {tree:?} {free:?}");
    assert!(far(&tree.efforts, &free.efforts) < effort, "efforts {tree:?} {free:?}");
    assert!((tree.finger - free.finger).norm() < place, "places {tree:?} {free:?}");
}

fn hold(bench: &mut Bench, kind: JointCommandType, values: [f64; 3], steps: u32) {
    let base = bench.body("Base");
    for _ in 0..steps {
        for (index, &value) in values.iter().enumerate() {
            assert!(bench.0.command_joint(base, index, kind, value));
        }
        bench.steps(1);
    }
}

#[test]
fn free_fall_of_the_arm_and_its_limits() {
    alike(|bench| bench.steps(100), 2e-3, 0.05, 1.0);
    for articulated in [true, false] {
        let mut bench = bench(articulated);
        bench.steps(4000);
        let positions = JOINTS.map(|name| bench.joint(name).position);
        assert!(positions[0] < 1.25 && (-2e-3..0.102).contains(&positions[2]), "{articulated}: {positions:?}");
    }
}

#[test]
fn efforts() {
    alike(|bench| hold(bench, JointCommandType::Effort, [-14.5, -3.5, 0.5], 200), 5e-3, 0.1, 2.0);
}

#[test]
fn velocities() {
    alike(|bench| hold(bench, JointCommandType::Velocity, [0.3, -0.5, 0.02], 1000), 2e-3, 1e-2, 0.5);
}

#[test]
fn positions() {
    alike(|bench| hold(bench, JointCommandType::Position, [-0.4, 0.6, 0.05], 2000), 2e-3, 2e-3, 0.2);
    let [tree, _] = both(|bench| hold(bench, JointCommandType::Position, [-0.4, 0.6, 0.05], 3000));
    for (found, wanted) in tree.positions.iter().zip([-0.4, 0.6, 0.05]) {
        assert!((found - wanted).abs() < 5e-3, "{found} instead of {wanted}");
    }
}

#[test]
fn forces_and_velocities_of_bodies() {
    let push = |bench: &mut Bench| {
        // The finger then is short of its end stop, at which hundredths of a millimetre decide how it bounces.
        for _ in 0..80 {
            bench.push("Finger", Vector3::new(3.0, 5.0, 12.0));
            bench.steps(1);
        }
    };
    alike(push, 1e-4, 0.05, 5.0);
    let throw = |bench: &mut Bench| {
        bench.throw("Lower", Vector3::new(0.0, 0.0, 1.0));
        bench.steps(20);
    };
    alike(throw, 5e-3, 0.2, 20.0);
}

#[test]
fn integrators_of_a_falling_arm_have_their_orders() {
    let fall = |integrator, sub_step| {
        let loaded = load_texts(&world(true, integrator), &[ARM]);
        let mut bench = Bench(Simulation::new(loaded.scene, sub_step));
        (0..(0.15_f64 / sub_step).round() as u32).for_each(|_| bench.update(sub_step));
        JOINTS.map(|name| bench.joint(name).position)
    };
    let exact = fall("rk4", 0.000125);
    let error = |integrator, sub_step| {
        fall(integrator, sub_step).iter().zip(&exact).map(|(q, right)| (q - right).abs()).fold(0.0, f64::max)
    };
    let (coarse, fine) = (error("euler", 0.001), error("euler", 0.0005));
    assert!((1.8..2.2).contains(&(coarse / fine)) && coarse < 1e-2, "euler: {coarse} {fine}");
    assert!(error("rk4", 0.001) < 1e-5 * coarse, "rk4: {}", error("rk4", 0.001));
}

#[test]
fn controllers_hold_an_arm_with_either_integrator() {
    let held = |integrator| {
        let mut bench = bench_with(true, integrator);
        hold(&mut bench, JointCommandType::Position, [0.4, -0.8, 0.06], 1500);
        JOINTS.map(|name| bench.joint(name).position)
    };
    for (euler, rk4) in held("euler").into_iter().zip(held("rk4")) {
        assert!((euler - rk4).abs() < 1e-6, "{euler} {rk4}");
    }
}

#[test]
fn a_reset_repeats_the_motion_bit_for_bit() {
    let mut bench = bench(true);
    let run = |bench: &mut Bench| {
        bench.steps(300);
        JOINTS.map(|name| bench.joint(name).position)
    };
    let first = run(&mut bench);
    bench.0.reset_bodies();
    assert_eq!(JOINTS.map(|name| bench.joint(name).position), [0.0; 3]);
    assert_eq!(run(&mut bench), first);
}

#[test]
fn only_the_accurate_profile_makes_trees_and_says_so() {
    for (physics, wanted) in [
        ("{}", false),
        ("{profile: legacy}", false),
        ("{profile: legacy, articulated: true}", true),
        ("{profile: accurate}", true),
        ("{profile: accurate, articulated: false}", false),
    ] {
        let loaded = load_texts(&format!("physics: {physics}\n"), &[ARM]);
        let said = loaded.report.to_string().contains("reduced coordinates");
        assert_eq!((said, loaded.scene.world.has_articulations()), (wanted, wanted), "{physics}: {}", loaded.report);
    }
}
