//! Grips of hulls: contacts turn with the bodies, and hold turns by their area.

use std::fmt::Write;

use ambf_core::comm::JointCommandType;
use ambf_core::control::Profile;
use ambf_core::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;

use crate::physics_common::Bench;
use nalgebra::Isometry3;

/// A cuboid as a hull, of these half extents, m.
fn block(half: [f64; 3]) -> String {
    let mut text = String::new();
    for corner in 0..8 {
        let at = |bit: usize| if corner >> bit & 1 == 1 { half[bit] } else { -half[bit] };
        writeln!(text, "v {} {} {}", at(0), at(1), at(2)).expect("a string grows");
    }
    for face in ["1 3 4 2", "5 6 8 7", "1 2 6 5", "3 7 8 4", "1 5 7 3", "2 4 8 6"] {
        writeln!(text, "f {face}").expect("a string grows");
    }
    text
}

/// A turntable with two pads of `height` x `height` m on slides, in the middle of which a block is held.
fn gripper(height: f64) -> String {
    let inertial =
        "<inertial><mass value='0.1'/><inertia ixx='1e-4' ixy='0' ixz='0' iyy='1e-4' iyz='0' izz='1e-4'/></inertial>";
    let mut text = format!(
        "<robot name='g'><link name='world'/><link name='table'>{inertial}</link><joint name='turn' type='continuous'><parent \
         link='world'/><child link='table'/><axis xyz='0 0 1'/><limit effort='50' velocity='10'/></joint>"
    );
    for (name, side) in [("left", -1.0), ("right", 1.0)] {
        write!(
            text,
            "<link name='{name}'>{inertial}<collision><geometry><box size='0.01 {height} {height}'/></geometry></collision></link><joint \
             name='{name} slide' type='prismatic'><origin xyz='{} 0 0'/><parent link='table'/><child link='{name}'/><axis xyz='{} 0 0'/><limit \
             lower='-0.02' upper='0.02' effort='50' velocity='1'/></joint>",
            side * 0.0095,
            -side
        )
        .expect("a string grows");
    }
    text + "</robot>"
}

/// The gripper with a hull of these half extents and this mass, kg, `along` m beside its middle.
fn holding(pads: f64, half: [f64; 3], mass: f64, along: f64) -> Bench {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("written");
        path
    };
    write("block.obj", &block(half));
    let held = format!(
        "<robot name='b'><link name='block'><inertial><origin xyz='0 {along} 0'/><mass value='{mass}'/><inertia ixx='1e-6' ixy='0' ixz='0' \
         iyy='1e-6' iyz='0' izz='1e-6'/></inertial><collision><origin xyz='0 {along} 0'/><geometry><mesh filename='block.obj'/></geometry>\
         </collision></link></robot>"
    );
    let files = SceneFiles {
        world: Some(write("world.yaml", "gravity: {x: 0, y: 0, z: -9.81}\nmax iterations: 50\n")),
        models: vec![write("gripper.urdf", &gripper(pads)), write("block.urdf", &held)],
    };
    let physics = PhysicsOptions { profile: Some(Profile::Accurate), ..PhysicsOptions::default() };
    let loaded = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    Bench(Simulation::new(loaded.scene, 0.001))
}

/// Turns at `rate` rad/s while each pad presses with 10 N.
fn drive(bench: &mut Bench, rate: f64, steps: u32) {
    let world = bench.body("world");
    for _ in 0..steps {
        bench.0.command_joint(world, 0, JointCommandType::Velocity, rate);
        bench.0.command_joint(world, 1, JointCommandType::Effort, 10.0);
        bench.0.command_joint(world, 2, JointCommandType::Effort, 10.0);
        bench.update(0.001);
    }
}

/// Pose of the block as seen from the table.
fn seen(bench: &Bench) -> Isometry3<f64> {
    bench.pose("table").inv_mul(&bench.pose("block"))
}

#[test]
fn a_block_stays_in_jaws_that_turn() {
    let mut bench = holding(0.03, [0.004, 0.008, 0.0075], 0.02, 0.0);
    drive(&mut bench, 0.0, 500);
    let before = seen(&bench);
    let mut most = (0.0_f64, 0.0_f64);
    for _ in 0..60 {
        drive(&mut bench, 2.0, 100);
        let change = before.inv_mul(&seen(&bench));
        most = (most.0.max(change.translation.vector.norm()), most.1.max(change.rotation.angle()));
    }
    println!("largest change {} m, {} rad", most.0, most.1);
    assert!(most.0 < 1e-6 && most.1 < 1e-4, "in two turns it slips by {} m and {} rad", most.0, most.1);
}

/// A bar held at its end. With friction μ = 0.25 the corners of two pads of 10 mm, 7.07 mm from the middle, hold a moment of
/// 2 μ 10 N 7.07 mm = 35 mN·m about the normal, less by what carries the weight; the bars have 12 and 74 mN·m.
#[test]
fn a_bar_held_at_its_end_does_not_turn() {
    for (mass, holds) in [(0.05, true), (0.3, false)] {
        let mut bench = holding(0.01, [0.004, 0.03, 0.005], mass, 0.025);
        drive(&mut bench, 0.0, 500);
        let before = seen(&bench);
        drive(&mut bench, 0.0, 3000);
        let change = before.inv_mul(&seen(&bench));
        let (way, turn) = (change.translation.vector.norm(), change.rotation.angle());
        println!("{mass} kg: {way} m, {turn} rad");
        assert_eq!(turn < 1e-3 && way < 1e-4, holds, "{mass} kg: {way} m, {turn} rad");
    }
}
