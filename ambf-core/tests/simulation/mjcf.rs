//! Models of MuJoCo in motion.

use ambf_core::comm::JointCommandType::{Effort, Position};
use ambf_core::control::Profile;
use ambf_core::scene::{load, Loaded, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;
use nalgebra::Vector3;
use tempfile::TempDir;

use crate::physics_common::{close, near, Bench, DT, WEIGHTLESS};

const PROFILES: [Profile; 2] = [Profile::Legacy, Profile::Accurate];

fn bench(profile: Profile, text: &str) -> Bench {
    let folder = TempDir::new().expect("a temporary folder");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("written");
        path
    };
    let files = SceneFiles { world: Some(write("world.yaml", WEIGHTLESS)), models: vec![write("m.xml", text)] };
    let physics = PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
    let Loaded { scene, report } = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
    assert_eq!(report.errors(), 0, "{report}");
    Bench(Simulation::new(scene, DT))
}

#[test]
fn its_gravity_is_that_of_the_file() {
    for profile in PROFILES {
        let text = "<mujoco><option gravity='0 0 -2'/><worldbody><body name='a'><freejoint/><geom size='0.1'/></body>\
                    <body name='b' pos='1 0 0' gravcomp='1'><freejoint/><geom size='0.1'/></body></worldbody></mujoco>";
        let mut bench = bench(profile, text);
        bench.steps(500);
        close(bench.position("a").z, -0.25, 0.002);
        near(bench.position("b"), [1.0, 0.0, 0.0], 1e-9);
    }
}

#[test]
fn several_joints_of_a_body_are_a_chain() {
    // A disc on a slide along x and a hinge about y: pushed by efforts it moves as if nothing were between.
    let text = "<mujoco><option gravity='0 0 0'/><worldbody><body name='a'><joint name='x' type='slide' axis='1 0 0'/>\
                <joint name='y' axis='0 1 0'/><inertial mass='2' pos='0 0 0' diaginertia='0.5 0.5 0.5'/></body></worldbody></mujoco>";
    for profile in PROFILES {
        let mut bench = bench(profile, text);
        let base = bench.body("world");
        for _ in 0..200 {
            assert!(bench.0.command_joint(base, 0, Effort, 4.0) && bench.0.command_joint(base, 1, Effort, 1.0));
            bench.update(DT);
        }
        let (linear, angular) = bench.velocity("a");
        close(linear.x, 4.0 / 2.0 * 0.2, 0.01);
        close(angular.y, 1.0 / 0.5 * 0.2, 0.01);
    }
}

#[test]
fn springs_swing_about_their_rest() {
    // 1 kg on a spring of 100 N/m: a period of 2π/10 s about 0.1 m.
    let text = "<mujoco><option gravity='0 0 0'/><worldbody><body name='a'><joint name='x' type='slide' axis='1 0 0' stiffness='100' \
                springref='0.1'/><inertial mass='1' pos='0 0 0' diaginertia='1 1 1'/></body></worldbody></mujoco>";
    let mut bench = bench(Profile::Accurate, text);
    let period = std::f64::consts::TAU / 10.0;
    let steps = |share: f64| (share * period / DT).round() as u32;
    bench.steps(steps(0.5));
    close(bench.position("a").x, 0.2, 0.002);
    bench.steps(steps(0.5));
    close(bench.position("a").x, 0.0, 0.002);
}

#[test]
fn time_constants_are_those_of_the_motion() {
    // Critically damped: x = 0.1 (1 − (1 + t / 0.1 s) exp(−t / 0.1 s)) m, whatever the mass is.
    let text = "<mujoco><option gravity='0 0 0'/><worldbody><body name='a'><joint name='x' type='slide' axis='1 0 0' springdamper='0.1 1' \
                springref='0.1'/><inertial mass='3' pos='0 0 0' diaginertia='1 1 1'/></body></worldbody></mujoco>";
    let mut bench = bench(Profile::Accurate, text);
    for share in [1.0f64, 2.0] {
        bench.steps((0.1 / DT).round() as u32);
        close(bench.position("a").x, 0.1 * (1.0 - (1.0 + share) * (-share).exp()), 2e-4);
    }
}

#[test]
fn free_bodies_have_the_damping_of_their_joint() {
    // v = −g / r (1 − exp(−r t)) with r = d / m.
    let text = "<mujoco><option gravity='0 0 -2'/><worldbody><body name='a'><joint type='free' damping='1.5'/><geom size='0.5' mass='1'/>\
                </body></worldbody></mujoco>";
    for profile in PROFILES {
        let mut bench = bench(profile, text);
        bench.steps((1.0 / DT).round() as u32);
        close(bench.velocity("a").0.z, -2.0 / 1.5 * (1.0 - (-1.5f64).exp()), 0.005);
    }
}

#[test]
fn position_actuators_hold_their_target() {
    // kp 50 against a weight: the error is that of MuJoCo, torque over kp.
    let text = "<mujoco><worldbody><body name='a'><joint name='j' axis='0 1 0' damping='1'/>\
                <inertial mass='1' pos='0.5 0 0' diaginertia='0.1 0.1 0.1'/></body></worldbody>\
                <actuator><position joint='j' kp='50' kv='5' gear='2'/></actuator></mujoco>";
    let mut bench = bench(Profile::Accurate, text);
    bench.command("world", 0, Position, 0.0, 4000);
    let q = bench.joint("j").position;
    // gear² · kp · q = weight · arm
    close(200.0 * q, 9.81 * 0.5 * q.cos(), 1e-3);
}

#[test]
fn who_meets_whom() {
    // Two balls of one robot whose bits keep them apart, a floor that meets only one of them, and a pair that is excluded.
    let text = "<mujoco><worldbody><geom name='floor' type='plane' size='1 1 1' contype='1' conaffinity='1'/>\
                <body name='a' pos='0 0 0.3'><freejoint/><geom size='0.1' contype='1' conaffinity='0'/></body>\
                <body name='b' pos='0 0 0.6'><freejoint/><geom size='0.1' contype='2' conaffinity='0'/></body>\
                <body name='c' pos='2 0 0.3'><freejoint/><geom size='0.1'/></body>\
                <body name='d' pos='2 0 0.6'><freejoint/><geom size='0.1'/></body></worldbody>\
                <contact><exclude body1='floor' body2='c'/><exclude body1='world' body2='c'/></contact></mujoco>";
    let text = text.replace("<exclude body1='floor' body2='c'/>", "");
    for profile in PROFILES {
        let mut bench = bench(profile, &text);
        bench.steps(2000);
        close(bench.position("a").z, 0.1, 0.01);
        assert!(bench.position("b").z < -5.0, "it falls through the other ball and the floor");
        assert!(bench.position("c").z < -5.0, "excluded");
        close(bench.position("d").z, 0.1, 0.01);
    }
}

#[test]
fn ellipsoids_rest_on_their_side() {
    let text =
        "<mujoco><worldbody><geom type='plane' size='1 1 1'/><body name='a' pos='0 0 0.12' euler='90 0 0'><freejoint/>\
                <geom type='ellipsoid' size='0.2 0.05 0.1'/></body></worldbody></mujoco>";
    let mut bench = bench(Profile::Accurate, text);
    bench.steps(4000);
    // Its short axis, y, is the upright one now.
    close(bench.position("a").z, 0.05, 0.004);
    let up = bench.pose("a").rotation * Vector3::y();
    close(up.z.abs(), 1.0, 0.02);
}

#[test]
fn coupled_joints_and_loops() {
    let text = "<mujoco><option gravity='0 0 0'/><worldbody>\
                <body name='a'><joint name='p'/><inertial mass='1' pos='0 0 0' diaginertia='1 1 1'/></body>\
                <body name='b' pos='1 0 0'><joint name='q'/><inertial mass='1' pos='0 0 0' diaginertia='1 1 1'/></body></worldbody>\
                <equality><joint joint1='q' joint2='p' polycoef='0 -2 0 0 0'/></equality></mujoco>";
    for profile in PROFILES {
        let mut bench = bench(profile, text);
        bench.command("world", 0, Effort, 1.0, 500);
        let [p, q] = ["p", "q"].map(|name| bench.joint(name).position);
        close(q, -2.0 * p, 1e-3);
        // 1 + 2² kg·m² are turned.
        close(p, 0.5 * (1.0 / 5.0) * 0.25, 0.002);
    }
}
