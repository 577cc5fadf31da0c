//! Bodies that lie with a line on a face, in the accurate profile: they touch at both ends of it.

use crate::physics_common::{close, load_texts, Bench};
use ambf_core::comm::JointCommandType;
use ambf_core::sim::Simulation;

/// A body of 45 g with the axis y between two pads on slides.
fn pinched(shape: &str) -> String {
    let surface = "friction: {static: 0.8367, rolling: 0}, restitution: 0, damping: {linear: 0, angular: 0}";
    let pad = |name: &str, x: f64| {
        format!(
            "BODY {name}: {{name: {name}, mass: 0.1, location: {{position: {{x: {x}, y: 0, z: 0.1}}}}, shape: Box, geometry: &{name} {{x: 0.01, y: \
             0.03, z: 0.03}}, collision shape: Box, collision geometry: *{name}, {surface}}}\n"
        )
    };
    let slide = |name: &str, pad: &str, x: f64, along: f64| {
        format!(
            "JOINT {name}: {{name: {name}, type: prismatic, parent: BODY base, child: BODY {pad}, parent pivot: {{x: {x}, y: 0, z: -0.1}}, child \
             pivot: {{x: 0, y: 0, z: 0}}, parent axis: {{x: {along}, y: 0, z: 0}}, child axis: {{x: {along}, y: 0, z: 0}}, joint limits: {{low: \
             -0.05, high: 0.05}}}}\n"
        )
    };
    format!(
        "bodies: [BODY base, BODY lp, BODY rp, BODY held]\njoints: [JOINT jl, JOINT jr]\nnamespace: /ambf/env/t/\nBODY base: {{name: base, mass: 0, \
         location: {{position: {{x: 0, y: 0, z: 0.2}}}}, shape: Box, geometry: {{x: 0.001, y: 0.001, z: 0.001}}}}\n{}{}BODY held: {{name: held, \
         mass: 0.045, location: {{position: {{x: 0, y: 0, z: 0.1}}}}, shape: {shape}, geometry: &held {{radius: 0.004, height: 0.05, axis: y}}, \
         collision shape: {shape}, collision geometry: *held, {surface}}}\n{}{}",
        pad("lp", -0.009),
        pad("rp", 0.009),
        slide("jl", "lp", -0.009, 1.0),
        slide("jr", "rp", 0.009, -1.0)
    )
}

#[test]
fn what_is_pinched_along_its_side_does_not_turn() {
    for (shape, step, force) in
        [("Capsule", 0.001, 60.0), ("Capsule", 0.002, 12.0), ("Capsule", 0.005, 60.0), ("Cylinder", 0.005, 60.0)]
    {
        let world = format!(
            "gravity: {{x: 0, y: 0, z: -9.81}}\nmax iterations: 50\nphysics: {{profile: accurate, sub step: {step}}}\n"
        );
        let loaded = load_texts(&world, &[&pinched(shape)]);
        assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
        let mut bench = Bench(Simulation::new(loaded.scene, step));
        let base = bench.body("base");
        let hold = |bench: &mut Bench, seconds: f64| {
            for _ in 0..(seconds / step).round() as u32 {
                for joint in 0..2 {
                    bench.0.command_joint(base, joint, JointCommandType::Effort, force);
                }
                bench.update(step);
            }
        };
        hold(&mut bench, 1.0);
        let start = bench.pose("held");
        hold(&mut bench, 60.0);
        let (end, what) = (bench.pose("held"), format!("{shape}, {force} N, {step} s"));
        let turn = start.rotation.angle_to(&end.rotation);
        println!("{what}: {turn} rad, {} m", end.translation.z - start.translation.z);
        assert!(turn < 1e-4, "{what}: {turn} rad in a minute");
        assert!((start.translation.z - end.translation.z).abs() < 60e-6, "{what}");
    }
}

#[test]
fn a_capsule_rests_on_a_box_with_both_ends_and_rolls_off() {
    let model = |x: f64, turn: f64| {
        format!(
            "bodies: [BODY table, BODY pill]\njoints: []\nnamespace: /ambf/env/t/\nBODY table: {{name: table, mass: 0, location: {{position: {{x: 0, \
             y: 0, z: -0.05}}}}, shape: Box, geometry: &t {{x: 0.2, y: 0.1, z: 0.1}}, collision shape: Box, collision geometry: *t}}\nBODY pill: \
             {{name: pill, mass: 0.01, location: {{position: {{x: {x}, y: 0, z: 0.005}}, orientation: {{r: 0, p: 0, y: {turn}}}}}, shape: Capsule, \
             geometry: &p {{radius: 0.005, height: 0.04, axis: y}}, collision shape: Capsule, collision geometry: *p, restitution: 0, damping: \
             {{linear: 0, angular: 0}}}}\n"
        )
    };
    let world = "gravity: {x: 0, y: 0, z: -9.81}\nmax iterations: 50\nphysics: {profile: accurate}\n";
    for (x, turn, ends) in [(0.0, 0.3, 0.03), (0.095, std::f64::consts::FRAC_PI_2, 0.02)] {
        let loaded = load_texts(world, &[&model(x, turn)]);
        let mut bench = Bench(Simulation::new(loaded.scene, 0.001));
        bench.steps(500);
        let mut contacts = Vec::new();
        let (scene, pill) = (bench.0.scene(), bench.body("pill"));
        scene.world.contacts(scene.world.bodies()[pill.index()], f64::INFINITY, &mut contacts);
        let [a, b] = &contacts[..] else { panic!("two contacts instead of {contacts:?}") };
        close((a.point - b.point).norm(), ends, 1e-4);
        close(a.impulse + b.impulse, 0.01 * 9.81 * 0.001, 1e-8);
        close(bench.position("pill").z, 0.005, 2e-6);
    }
    // On a ramp of its own it would roll; pushed, it rolls off the edge of the table.
    let loaded = load_texts(world, &[&model(0.0, 0.0)]);
    let mut bench = Bench(Simulation::new(loaded.scene, 0.001));
    bench.steps(10);
    bench.throw("pill", nalgebra::Vector3::new(0.6, 0.0, 0.0));
    bench.steps(150);
    let (linear, angular) = bench.velocity("pill");
    assert!((linear.x - 0.005 * angular.y).abs() < 2e-3 && linear.x > 0.3, "it rolls: {linear} {angular}");
    close(linear.y.abs() + angular.z.abs() * 0.01, 0.0, 1e-3);
    bench.steps(250);
    assert!(bench.position("pill").z < -0.01, "{}", bench.position("pill"));
}

#[test]
fn a_domed_hull_stands_on_its_middle() {
    let (folder, radius, rings, around) = (tempfile::tempdir().expect("a folder"), 0.03, 16, 24);
    let mut text = format!("o ball\nv 0 0 {radius}\nv 0 0 {}\n", -radius);
    for ring in 1..rings {
        let (height, wide) = (std::f64::consts::PI * f64::from(ring) / f64::from(rings)).sin_cos();
        for i in 0..around {
            let (y, x) = (std::f64::consts::TAU * f64::from(i) / f64::from(around)).sin_cos();
            text += &format!("v {} {} {}\n", radius * height * x, radius * height * y, radius * wide);
        }
    }
    // A hull needs points; faces are for the reader.
    for i in 0..around {
        text += &format!("f 1 {} {}\n", 3 + i, 3 + (i + 1) % around);
    }
    for i in 3..=2 + (rings - 1) * around - 2 {
        text += &format!("f {i} {} {}\n", i + 1, i + 2);
    }
    text += &format!("f 2 {} {}\n", 3 + (rings - 2) * around, 4 + (rings - 2) * around);
    std::fs::write(folder.path().join("ball.obj"), text).expect("written");
    let model = format!(
        "bodies: [BODY table, BODY ball]\nBODY table: {{name: table, mass: 0, location: {{position: {{x: 0, y: 0, z: -0.05}}}}, collision shape: \
         Box, collision geometry: {{x: 0.2, y: 0.2, z: 0.1}}}}\nBODY ball: {{name: ball, mass: 0.1, inertia: {{ix: 3.6e-5, iy: 3.6e-5, iz: 3.6e-5}}, \
         mesh: ball.obj, high resolution path: {0}, low resolution path: {0}, collision mesh type: CONVEX_HULL, collision margin: 1e-5, inertial \
         offset: {{position: {{x: 0, y: 0, z: 0}}}}, location: {{position: {{x: 0, y: 0, z: {radius}}}}}}}\n",
        folder.path().display()
    );
    let world = "gravity: {x: 0, y: 0, z: -9.81}\nmax iterations: 50\nphysics: {profile: accurate}\n";
    let loaded = load_texts(world, &[&model]);
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    let mut bench = Bench(Simulation::new(loaded.scene, 0.001));
    bench.steps(100);
    close(bench.position("ball").z, radius, 5e-5);
}
