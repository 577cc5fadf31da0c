//! Commands in the accurate profile: executed in every sub-step, whatever the outer rate is.

use crate::physics_common::{close, near, Bench};
use ambf_core::comm::JointCommandType::{Effort, Position, Velocity};
use ambf_core::comm::{CartesianCommandType, RigidBodyCommand};
use nalgebra::{Isometry3, Vector3};

const WORLD: &str =
    "namespace: /w/\ngravity: {x: 0, y: 0, z: -10}\nmax iterations: 1000\nphysics: {profile: accurate}\n";
const OUTER: [f64; 5] = [0.0005, 0.001, 0.002, 0.02, 0.1];

/// A link of 2 kg that turns about the vertical through its centre of mass, I = 0.05 kg·m²; more keys of the joint.
fn wheel(joint: &str) -> Bench {
    Bench::new(
        WORLD,
        &format!(
            "bodies: [BODY base, BODY link]\njoints: [JOINT hinge]\n\
             BODY base: {{name: base, mass: 0}}\n\
             BODY link: {{name: link, mass: 2, inertia: {{ix: 0.05, iy: 0.05, iz: 0.05}}, damping: {{linear: 0, angular: 0}}}}\n\
             JOINT hinge:\n  {{name: hinge, type: revolute, parent: BODY base, child: BODY link, parent axis: {{x: 0, y: 0, z: 1}}, \
             child axis: {{x: 0, y: 0, z: 1}}, parent pivot: {{x: 0, y: 0, z: 0}}, child pivot: {{x: 0, y: 0, z: 0}}{joint}}}\n"
        ),
    )
}

/// A body of 1 kg; its keys.
fn body(keys: &str) -> Bench {
    let model = format!(
        "bodies: [BODY tool]\njoints: []\nBODY tool: {{name: tool, mass: 1, inertia: {{ix: 0.01, iy: 0.01, iz: 0.01}}, damping: {{linear: 0, angular: 0}}{keys}}}\n"
    );
    Bench::new(WORLD, &model)
}

fn hold(bench: &mut Bench, kind: ambf_core::comm::JointCommandType, value: f64, outer: f64, seconds: f64) {
    let base = bench.body("base");
    for _ in 0..(seconds / outer).round() as u32 {
        assert!(bench.0.command_joint(base, 0, kind, value));
        bench.update(outer);
    }
}

#[test]
fn the_default_motor_has_its_time_constant_at_every_outer_rate() {
    for outer in OUTER {
        let mut bench = wheel("");
        hold(&mut bench, Position, 0.5, outer, 0.2);
        // (1 + D)/P = 0.2 s; the motor's 100 N·m reach its velocity within a sub-step.
        close(bench.joint("hinge").position, 0.5 * (1.0 - (-1.0_f64).exp()), 2e-3);
    }
}

#[test]
fn a_spring_is_stable_at_every_gain_and_outer_rate_and_goes_when_nobody_asks() {
    for outer in OUTER {
        for (p, d) in [(20.0, 2.0), (2e4, 60.0), (1e8, 1e4)] {
            let mut bench = wheel(&format!(", controller: {{P: {p}, I: 0, D: {d}}}"));
            hold(&mut bench, Position, 0.5, outer, 1.6);
            close(bench.joint("hinge").position, 0.5, 1e-3);
        }
        let mut bench = wheel(", controller: {P: 20, I: 0, D: 2}");
        hold(&mut bench, Position, 0.5, outer, 0.1);
        bench.update(0.001);
        let spin = bench.velocity("link").1.z;
        bench.update(0.01);
        close(bench.velocity("link").1.z, spin, 1e-9);
        assert!(spin > 0.5, "it was on its way: {spin}");
    }
}

#[test]
fn an_effort_lasts_for_all_sub_steps_and_a_motor_beyond_them() {
    for outer in OUTER {
        let mut bench = wheel("");
        hold(&mut bench, Effort, 0.1, outer, 0.4);
        close(bench.velocity("link").1.z, 0.1 / 0.05 * 0.4, 1e-6);
        hold(&mut bench, Velocity, 3.0, outer, 0.1);
        bench.update(0.1);
        close(bench.velocity("link").1.z, 3.0, 1e-6);
        hold(&mut bench, Effort, 0.0, outer, 0.1);
        bench.update(0.001);
        close(bench.velocity("link").1.z, 3.0, 1e-6);
    }
}

#[test]
fn a_body_follows_its_goal_at_every_outer_rate() {
    let target = Isometry3::new(Vector3::new(0.1, -0.2, 0.3), Vector3::new(0.0, 0.4, 0.0));
    for outer in OUTER {
        let mut spring = body(", controller: {linear: {P: 4000, I: 0, D: 40}, angular: {P: 100, I: 0, D: 1}}");
        let mut motor = body("");
        for _ in 0..(2.0 / outer) as u32 {
            spring.follow("tool", &target);
            spring.update(outer);
            motor.follow("tool", &target);
            motor.update(outer);
        }
        // It sags by m g / P.
        near(spring.position("tool"), [0.1, -0.2, 0.3 - 10.0 / 4000.0], 1e-4);
        close(spring.pose("tool").rotation.angle_to(&target.rotation), 0.0, 1e-4);
        near(motor.position("tool"), [0.1, -0.2, 0.3], 1e-6);
        spring.update(0.001);
        let before = spring.velocity("tool").0.z;
        spring.update(0.01);
        close(spring.velocity("tool").0.z, before - 0.1, 1e-6);
    }
}

#[test]
fn a_commanded_velocity_is_kept_against_gravity() {
    for outer in OUTER {
        let mut bench = body("");
        let tool = bench.body("tool");
        let command = RigidBodyCommand {
            cartesian: CartesianCommandType::Velocity,
            linear_velocity: Vector3::new(0.5, 0.0, 0.25),
            ..RigidBodyCommand::default()
        };
        for _ in 0..(0.4 / outer).round() as u32 {
            bench.0.command_body(tool, &command);
            bench.update(outer);
        }
        near(bench.position("tool"), [0.2, 0.0, 0.1], 1e-9);
    }
}

#[test]
fn a_goal_beyond_all_numbers_is_reported_and_forgotten_by_a_reset() {
    let mut bench = body(", controller: {linear: {P: 4000, I: 0, D: 40}, angular: {P: 100, I: 0, D: 1}}");
    bench.follow("tool", &Isometry3::translation(1e307, 0.0, 0.0));
    assert!(bench.0.update(0.001).is_err());
    bench.0.reset_bodies();
    bench.steps(10);
    near(bench.position("tool"), [0.0, 0.0, -10.0 * 1e-4 / 2.0], 1e-4);
}
