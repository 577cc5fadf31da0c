//! What joints exert on their children, as a force-torque sensor in the joint would say.

use crate::physics_common::{load_texts_with, near, Bench};
use ambf_core::comm::{JointCommandType, Wrench};
use ambf_core::scene::SceneOptions;
use ambf_core::sim::Simulation;
use nalgebra::Vector3;

const G: f64 = 9.81;

/// A tab of 1 g on a base, and on the tab, by a fixed joint, a load of 1 kg that is 0.1 m aside. `enable feedback` isn't there.
fn model(kind: &str, base_mass: f64) -> String {
    let axis = if kind == "prismatic" { "{x: 0, y: 0, z: 1}" } else { "{x: 1, y: 0, z: 0}" };
    let limits = match kind {
        "prismatic" | "revolute" => "joint limits: {low: 0, high: 0}",
        _ => "",
    };
    format!(
        "
bodies: [BODY base, BODY tab, BODY load]
joints: [JOINT j, JOINT k]
namespace: /ambf/env/t/
BODY base: {{name: base, mass: {base_mass}, location: {{position: {{x: 0, y: 0, z: 0}}}}, shape: Box, geometry: &b {{x: 0.1, y: 0.1, z: 0.1}}, collision shape: Box, collision geometry: *b}}
BODY tab: {{name: tab, mass: 0.001, location: {{position: {{x: 0, y: 0, z: 0.1}}}}, shape: Box, geometry: &t {{x: 0.1, y: 0.1, z: 0.01}}, collision shape: Box, collision geometry: *t}}
BODY load: {{name: load, mass: 1, location: {{position: {{x: 0, y: 0.1, z: 0.14}}}}, shape: Box, geometry: &l {{x: 0.05, y: 0.05, z: 0.05}}, collision shape: Box, collision geometry: *l}}
JOINT j:
  name: j
  type: {kind}
  parent: BODY base
  child: BODY tab
  parent pivot: {{x: 0, y: 0, z: 0.08}}
  child pivot: {{x: 0, y: 0, z: -0.02}}
  parent axis: {axis}
  child axis: {axis}
  {limits}
JOINT k:
  name: k
  type: fixed
  parent: BODY tab
  child: BODY load
  parent pivot: {{x: 0, y: 0.1, z: 0.04}}
  child pivot: {{x: 0, y: 0, z: 0}}
  parent axis: {{x: 0, y: 0, z: 1}}
  child axis: {{x: 0, y: 0, z: 1}}
"
    )
}

fn bench(physics: &str, model: &str, dt: f64) -> Bench {
    let world =
        format!("gravity: {{x: 0, y: 0, z: -{G}}}\nmax iterations: 50\nphysics: {{{physics}, sub step: {dt}}}\n");
    let loaded = load_texts_with(&world, &[model], &SceneOptions { joint_wrenches: true, ..SceneOptions::default() });
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    Bench(Simulation::new(loaded.scene, dt))
}

#[track_caller]
fn like(found: &Wrench, force: [f64; 3], torque: [f64; 3], tolerance: f64) {
    near(found.force, force, tolerance);
    near(found.torque, torque, tolerance);
}

#[test]
fn joints_of_all_kinds_carry_the_weight_and_its_moment() {
    for kind in ["prismatic", "fixed", "revolute"] {
        for (physics, tolerance) in [("profile: accurate", 1e-6), ("profile: accurate, articulated: false", 2e-2)] {
            for dt in [0.001, 0.005] {
                let mut bench = bench(physics, &model(kind, 0.0), dt);
                (0..(0.4 / dt) as u32).for_each(|_| bench.update(dt));
                // The load hangs 0.1 m along y beside the joint: the joint pushes up, and against its turn about x.
                like(&bench.joint("j").wrench, [0.0, 0.0, 1.001 * G], [0.1 * G, 0.0, 0.0], tolerance);
                like(&bench.joint("k").wrench, [0.0, 0.0, G], [0.0; 3], tolerance);
            }
        }
    }
}

#[test]
fn a_free_base_that_stands_on_nothing_carries_nothing() {
    let mut bench = bench("profile: accurate", &model("fixed", 2.0), 0.001);
    bench.steps(100);
    for joint in ["j", "k"] {
        like(&bench.joint(joint).wrench, [0.0; 3], [0.0; 3], 1e-6);
    }
}

#[test]
fn profile_legacy_says_what_bullet_applied() {
    let mut bench = bench("profile: legacy", &model("fixed", 0.0), 0.001);
    bench.steps(500);
    let [j, k] = ["j", "k"].map(|joint| bench.joint(joint).wrench);
    println!("{} {}", j.force, k.force);
    // The softness of its joints takes a part of the impulses.
    assert!(j.force.z > 1.0 && k.force.z > 1.0 && j.force.z > k.force.z, "{} {}", j.force, k.force);
    assert_eq!(bench.joint("j").effort, 0.0, "no `enable feedback`, no effort");
}

#[test]
fn a_ball_that_swings_is_held_in_its_circle() {
    // A ball joint and a hinge, without gravity's moment about the pivot at the lowest point: m g + m v²/l.
    for (kind, length) in [("p2p", 0.3), ("revolute", 0.3)] {
        let model = format!(
            "
bodies: [BODY base, BODY bob]
joints: [JOINT j]
namespace: /ambf/env/t/
BODY base: {{name: base, mass: 0, location: {{position: {{x: 0, y: 0, z: 0}}}}, mesh: ''}}
BODY bob:
  name: bob
  mass: 2
  inertia: {{ix: 0.01, iy: 0.01, iz: 0.01}}
  inertial offset: {{position: {{x: 0, y: 0, z: 0}}, orientation: {{r: 0, p: 0, y: 0}}}}
  location: {{position: {{x: 0, y: 0, z: -{length}}}}}
  mesh: ''
  damping: {{linear: 0, angular: 0}}
JOINT j:
  name: j
  type: {kind}
  parent: BODY base
  child: BODY bob
  parent pivot: {{x: 0, y: 0, z: 0}}
  child pivot: {{x: 0, y: 0, z: {length}}}
  parent axis: {{x: 0, y: 1, z: 0}}
  child axis: {{x: 0, y: 1, z: 0}}
  damping: 0
"
        );
        let mut bench = bench("profile: accurate", &model, 0.0001);
        let body = bench.body("bob");
        let rate = 2.0;
        bench.0.set_velocity(body, Vector3::new(-rate * length, 0.0, 0.0), Vector3::new(0.0, rate, 0.0));
        bench.update(0.0001);
        let held = 2.0 * (G + rate * rate * length);
        like(&bench.joint("j").wrench, [0.0, 0.0, held], [0.0; 3], 2e-2);
    }
}

#[test]
fn commanded_efforts_go_through_the_joint() {
    let free = model("prismatic", 0.0).replace("joint limits: {low: 0, high: 0}", "joint limits: {low: -1, high: 1}");
    let mut bench = bench("profile: accurate", &free, 0.001);
    bench.command("base", 0, JointCommandType::Effort, 1.001 * G, 50);
    like(&bench.joint("j").wrench, [0.0, 0.0, 1.001 * G], [0.1 * G, 0.0, 0.0], 1e-6);
    bench.steps(2);
    like(&bench.joint("j").wrench, [0.0; 3], [0.0; 3], 1e-6);
}

#[test]
fn what_lies_on_a_link_counts() {
    let weight = "
bodies: [BODY weight]
joints: []
namespace: /ambf/env/w/
BODY weight: {name: weight, mass: 0.5, location: {position: {x: -0.03, y: -0.03, z: 0.116}}, shape: Box, geometry: &w {x: 0.02, y: 0.02, z: 0.02}, collision shape: Box, collision geometry: *w}
";
    let world = format!("gravity: {{x: 0, y: 0, z: -{G}}}\nmax iterations: 50\nphysics: {{profile: accurate}}\n");
    let options = SceneOptions { joint_wrenches: true, ..SceneOptions::default() };
    let loaded = load_texts_with(&world, &[&model("fixed", 0.0), weight], &options);
    let mut bench = Bench(Simulation::new(loaded.scene, 0.001));
    bench.steps(1000);
    let wanted = [0.1 * G - 0.03 * 0.5 * G, 0.03 * 0.5 * G, 0.0];
    like(&bench.joint("j").wrench, [0.0, 0.0, 1.501 * G], wanted, 1e-3);
}
