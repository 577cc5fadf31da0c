//! Bodies without mass that commands move: they have the velocity of their motion in contacts and joints.

use crate::physics_common::{close, load_texts, near, turned, Bench};
use ambf_core::sim::Simulation;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// A plate that is moved, and a box on it.
const PLATFORM: &str = "
bodies: [BODY plate, BODY box]
joints: []
namespace: /ambf/env/t/
BODY plate:
  name: plate
  mass: 0
  location: {position: {x: 0, y: 0, z: -0.05}}
  shape: Box
  geometry: &plate {x: 1, y: 1, z: 0.1}
  collision shape: Box
  collision geometry: *plate
  friction: {static: 1, rolling: 0}
BODY box:
  name: box
  mass: 1
  location: {position: {x: 0.1, y: 0, z: 0.05}}
  shape: Box
  geometry: &box {x: 0.1, y: 0.1, z: 0.1}
  collision shape: Box
  collision geometry: *box
  friction: {static: 0.8, rolling: 0}
  damping: {linear: 0, angular: 0}
";

/// A beam along x that is moved and turned, with a body of 1 kg on a joint 0.2 m from its middle.
fn beam(kind: &str, axis: &str) -> String {
    format!(
        "
bodies: [BODY beam, BODY load]
joints: [JOINT j]
namespace: /ambf/env/t/
BODY beam: {{name: beam, mass: 0, location: {{position: {{x: 0, y: 0, z: 0}}}}, shape: Box, geometry: {{x: 1, y: 0.1, z: 0.1}}}}
BODY load:
  name: load
  mass: 1
  inertia: {{ix: 0.01, iy: 0.02, iz: 0.03}}
  location: {{position: {{x: 0.2, y: 0, z: -0.3}}}}
  inertial offset: {{position: {{x: 0, y: 0, z: 0}}, orientation: {{r: 0, p: 0, y: 0}}}}
  mesh: ''
  damping: {{linear: 0, angular: 0}}
JOINT j:
  name: j
  type: {kind}
  parent: BODY beam
  child: BODY load
  parent pivot: {{x: 0.2, y: 0, z: 0}}
  child pivot: {{x: 0, y: 0, z: 0.3}}
  parent axis: {axis}
  child axis: {axis}
  damping: 0
"
    )
}

fn world(gravity: f64, physics: &str) -> String {
    format!("gravity: {{x: 0, y: 0, z: {gravity}}}\nmax iterations: 50\nphysics: {{{physics}}}\n")
}

/// Steps of `dt` s.
fn bench(world: &str, model: &str, dt: f64) -> Bench {
    let loaded = load_texts(world, &[model]);
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    Bench(Simulation::new(loaded.scene, dt))
}

fn at(x: f64, z: f64) -> Isometry3<f64> {
    Isometry3::translation(x, 0.0, z)
}

/// Commands a velocity, m/s and rad/s, in `steps` updates of `dt` s.
fn drive(bench: &mut Bench, name: &str, linear: Vector3<f64>, angular: Vector3<f64>, steps: u32, dt: f64) {
    let body = bench.body(name);
    for _ in 0..steps {
        bench.0.set_velocity(body, linear, angular);
        bench.update(dt);
    }
}

/// Where the box is after the plate has been moved by 0.5 m within 1 s, and how fast it was at the end of 1 s at 0.3 m/s.
fn carried(physics: &str, dt: f64) -> (f64, f64) {
    let mut bench = bench(&world(-9.81, &format!("{physics}, sub step: {dt}")), PLATFORM, dt);
    let steps = |seconds: f64| (seconds / dt).round() as u32;
    (0..steps(0.2)).for_each(|_| bench.update(dt));
    let start = bench.position("box").x;
    for k in 0..steps(1.0) {
        let x = 0.25 * (1.0 - (std::f64::consts::PI * f64::from(k) * dt).cos());
        bench.follow("plate", &at(x, -0.05));
        bench.update(dt);
    }
    (0..steps(0.3)).for_each(|_| bench.update(dt));
    let way = bench.position("box").x - start;
    bench.0.reset_bodies();
    drive(&mut bench, "plate", Vector3::x() * 0.3, Vector3::zeros(), steps(1.0), dt);
    let twist = bench.velocity("plate").0;
    let speed = bench.velocity("box").0.x;
    assert!((twist.x - if speed.abs() < 0.1 { 0.0 } else { 0.3 }).abs() < 1e-9, "{physics}: {twist}");
    (0..3).for_each(|_| bench.update(dt));
    assert_eq!(bench.velocity("plate").0, Vector3::zeros(), "{physics}: it stands where nobody moves it");
    (way, speed)
}

#[test]
fn what_lies_on_a_moved_plate_goes_along() {
    let key = "profile: legacy, kinematic bodies: true";
    for physics in ["profile: accurate", "profile: accurate, articulated: false", "profile: pybullet", key] {
        for dt in [0.001, 0.005] {
            let (way, speed) = carried(physics, dt);
            assert!((way - 0.5).abs() < 0.01 && (speed - 0.3).abs() < 0.01, "{physics} {dt} s: {way} m, {speed} m/s");
        }
    }
}

#[test]
fn profile_legacy_leaves_it_where_it_was_like_the_cpp_program() {
    let (way, speed) = carried("profile: legacy", 0.001);
    assert!(way.abs() < 1e-3 && speed.abs() < 1e-3, "{way} m, {speed} m/s");
    let (way, _) = carried("profile: accurate, kinematic bodies: false", 0.001);
    assert!(way.abs() < 1e-3, "{way} m");
}

#[test]
fn what_lies_on_a_plate_that_turns_goes_round() {
    let mut bench = bench(&world(-9.81, "profile: accurate"), PLATFORM, 0.001);
    bench.steps(100);
    drive(&mut bench, "plate", Vector3::zeros(), Vector3::z() * 1.5, 1000, 0.001);
    // At first it slides until friction has given it the velocity.
    let (angle, place) = (1.5f64 - 1.5 * 1.5 * 0.1 / (2.0 * 0.8 * 9.81), bench.position("box"));
    near(place, [0.1 * angle.cos(), 0.1 * angle.sin(), place.z], 1e-3);
    close(turned(&bench.pose("box").rotation, &UnitQuaternion::from_euler_angles(0.0, 0.0, angle)), 0.0, 2e-3);
    close(turned(&bench.pose("plate").rotation, &UnitQuaternion::from_euler_angles(0.0, 0.0, 1.5)), 0.0, 1e-9);
}

#[test]
fn a_turn_about_the_body_frame_does_not_depend_on_where_the_inertial_frame_is() {
    let offset = "inertial offset: {position: {x: 0.3, y: 0.1, z: 0}, orientation: {r: 0, p: 0, y: 1}}";
    let model = PLATFORM.replacen("  mass: 0\n", &format!("  mass: 0\n  {offset}\n"), 1);
    let mut bench = bench(&world(0.0, "profile: accurate"), &model, 0.001);
    drive(&mut bench, "plate", Vector3::x(), Vector3::z() * 3.0, 1000, 0.001);
    near(bench.position("plate"), [1.0, 0.0, -0.05], 1e-9);
    close(turned(&bench.pose("plate").rotation, &UnitQuaternion::from_euler_angles(0.0, 0.0, 3.0)), 0.0, 1e-9);
}

#[test]
fn jumps_throw_nothing_about() {
    let mut bench = bench(&world(-9.81, "profile: accurate"), PLATFORM, 0.001);
    bench.steps(200);
    for k in 0..100 {
        // To and fro by 0.2 m, every few steps, and a bit into the box.
        let x = if k / 3 % 2 == 0 { 0.2 } else { 0.0 };
        bench.follow("plate", &at(x, -0.0499));
        bench.update(0.001);
        let speed = bench.velocity("box").0.norm();
        assert!(speed < 0.06, "{k}: {speed} m/s");
    }
    // Moved by commands, then put elsewhere by a reset.
    drive(&mut bench, "plate", Vector3::x(), Vector3::zeros(), 100, 0.001);
    bench.0.reset_bodies();
    assert_eq!(bench.velocity("plate").0, Vector3::zeros());
    bench.steps(20);
    assert!(bench.velocity("box").0.norm() < 1e-2, "{}", bench.velocity("box").0);
}

#[test]
fn a_base_that_moves_steadily_is_one_at_rest_of_another_observer() {
    for axis in ["{x: 0, y: 1, z: 0}", "{x: 1, y: 0, z: 0}"] {
        let model = beam("revolute", axis);
        let new = || bench(&world(-9.81, "profile: accurate"), &model, 0.001);
        let (mut moved, mut thrown) = (new(), new());
        let speed = Vector3::new(2.0, -1.0, 0.5);
        thrown.throw("load", -speed);
        for _ in 0..20 {
            drive(&mut moved, "beam", speed, Vector3::zeros(), 100, 0.001);
            thrown.steps(100);
            close(moved.joint("j").position, thrown.joint("j").position, 1e-9);
            near(moved.velocity("load").0 - speed, thrown.velocity("load").0.into(), 1e-8);
        }
    }
}

#[test]
fn a_slider_on_a_beam_that_turns_is_flung_outwards() {
    for omega in [1.0, -4.0] {
        let model = beam("prismatic", "{x: 1, y: 0, z: 0}");
        let mut bench = bench(&world(0.0, "profile: accurate"), &model, 0.001);
        drive(&mut bench, "beam", Vector3::zeros(), Vector3::z() * omega, 400, 0.001);
        let phase = 0.4 * omega;
        // It is at rest relative to the beam when that begins to turn.
        close(bench.joint("j").position, 0.2 * (phase.cosh() - 1.0), 2e-7);
        let place = bench.position("load");
        near(place, [0.2 * phase.cosh() * phase.cos(), 0.2 * phase.cosh() * phase.sin(), -0.3], 1e-6);
        close(bench.velocity("load").1.z, omega, 1e-9);
    }
}

/// The shipped gripper with a block between its fingers.
fn gripper(physics: &str) -> Bench {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../resources/models/gripper.yaml");
    let text = std::fs::read_to_string(path).expect("the shipped model");
    let mut bench = bench(&world(-9.81, physics), &text, 0.001);
    bench.steps(500);
    bench
}

#[test]
fn fingers_of_a_moved_palm_carry_what_they_hold() {
    for physics in ["profile: accurate", "profile: accurate, articulated: false"] {
        let mut bench = gripper(physics);
        let start = bench.position("block").y;
        drive(&mut bench, "palm", Vector3::y() * 0.1, Vector3::zeros(), 400, 0.001);
        let way = bench.position("block").y - start;
        assert!(way >= 0.035, "{physics}: {way} m of 0.04");
        for finger in ["leftfinger", "rightfinger"] {
            near(bench.velocity(finger).0, [0.0, 0.1, 0.0], 2e-3);
        }
        // The lift.
        let (from, block) = (bench.pose("palm"), bench.position("block").z);
        for k in 1..=1000 {
            bench.follow("palm", &(Isometry3::translation(0.0, 0.0, 0.2e-3 * f64::from(k)) * from));
            bench.update(0.001);
        }
        bench.steps(300);
        let rise = bench.position("block").z - block;
        assert!(rise >= 0.198, "{physics}: {rise} m of 0.2");
    }
}
