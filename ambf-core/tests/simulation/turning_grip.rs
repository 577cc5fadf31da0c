//! A grip that turns keeps what it holds: contacts turn with the bodies.

use std::fmt::Write;

use ambf_core::comm::JointCommandType;
use ambf_core::control::Profile;
use ambf_core::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;

use crate::physics_common::Bench;

/// A hull, so that Bullet finds one point of a pair in a sub-step; what it had found before are the others.
fn block() -> String {
    let mut text = String::new();
    for corner in 0..8 {
        let at = |bit: usize, half: f64| if corner >> bit & 1 == 1 { half } else { -half };
        writeln!(text, "v {} {} {}", at(0, 0.004), at(1, 0.008), at(2, 0.0075)).expect("a string grows");
    }
    for face in ["1 3 4 2", "5 6 8 7", "1 2 6 5", "3 7 8 4", "1 5 7 3", "2 4 8 6"] {
        writeln!(text, "f {face}").expect("a string grows");
    }
    text
}

/// A turntable with two pads on slides, in the middle of which a block of 20 g is held.
fn gripper() -> String {
    let inertial =
        "<inertial><mass value='0.1'/><inertia ixx='1e-4' ixy='0' ixz='0' iyy='1e-4' iyz='0' izz='1e-4'/></inertial>";
    let mut text = format!(
        "<robot name='g'><link name='world'/><link name='table'>{inertial}</link><joint name='turn' type='continuous'><parent \
         link='world'/><child link='table'/><axis xyz='0 0 1'/><limit effort='50' velocity='10'/></joint>"
    );
    for (name, side) in [("left", -1.0), ("right", 1.0)] {
        write!(
            text,
            "<link name='{name}'>{inertial}<collision><geometry><box size='0.01 0.03 0.03'/></geometry></collision></link><joint \
             name='{name} slide' type='prismatic'><origin xyz='{} 0 0'/><parent link='table'/><child link='{name}'/><axis xyz='{} 0 0'/><limit \
             lower='-0.02' upper='0.02' effort='50' velocity='1'/></joint>",
            side * 0.0095,
            -side
        )
        .expect("a string grows");
    }
    text + "</robot>"
}

#[test]
fn a_block_stays_in_jaws_that_turn() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("written");
        path
    };
    write("block.obj", &block());
    let held = "<robot name='b'><link name='block'><inertial><mass value='0.02'/><inertia ixx='1e-6' ixy='0' ixz='0' iyy='1e-6' iyz='0' \
                izz='1e-6'/></inertial><collision><geometry><mesh filename='block.obj'/></geometry></collision></link></robot>";
    let files = SceneFiles {
        world: Some(write("world.yaml", "gravity: {x: 0, y: 0, z: -9.81}\nmax iterations: 50\n")),
        models: vec![write("gripper.urdf", &gripper()), write("block.urdf", held)],
    };
    let physics = PhysicsOptions { profile: Some(Profile::Accurate), ..PhysicsOptions::default() };
    let loaded = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    let mut bench = Bench(Simulation::new(loaded.scene, 0.001));
    let world = bench.body("world");
    let drive = |bench: &mut Bench, rate: f64, steps: u32| {
        for _ in 0..steps {
            bench.0.command_joint(world, 0, JointCommandType::Velocity, rate);
            bench.0.command_joint(world, 1, JointCommandType::Effort, 10.0);
            bench.0.command_joint(world, 2, JointCommandType::Effort, 10.0);
            bench.update(0.001);
        }
    };
    drive(&mut bench, 0.0, 500);
    let seen = |bench: &Bench| bench.pose("table").inv_mul(&bench.pose("block"));
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
