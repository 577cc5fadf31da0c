//! Bodies on meshes that do not move, in the accurate profile.
//!
//! Contacts used to be found triangle by triangle: bodies hit the edges between the triangles of a flat floor, and of the
//! points of all triangles those were kept that came last, so that small parts did not come to rest.

use crate::physics_common::{close, load_texts, Bench};
use ambf_core::sim::Simulation;
use nalgebra::Vector3;

/// Squares of a surface along each side.
const SQUARES: u32 = 60;

/// A square surface of 3 m about the origin as OBJ, with heights over x and y.
fn surface(height: impl Fn(f64, f64) -> f64) -> String {
    let at = |i: u32| 3.0 * (f64::from(i) / f64::from(SQUARES) - 0.5);
    let mut text = String::new();
    for (x, y) in (0..=SQUARES).flat_map(|j| (0..=SQUARES).map(move |i| (at(i), at(j)))) {
        text += &format!("v {x} {y} {}\n", height(x, y));
    }
    for (i, j) in (0..SQUARES).flat_map(|j| (0..SQUARES).map(move |i| (i, j))) {
        let a = j * (SQUARES + 1) + i + 1;
        let [b, c, d] = [a + 1, a + SQUARES + 1, a + SQUARES + 2];
        text += &if (i + j) % 2 == 0 {
            format!("f {a} {b} {c}\nf {b} {d} {c}\n")
        } else {
            format!("f {a} {b} {d}\nf {a} {d} {c}\n")
        };
    }
    text
}

/// A surface that does not change along y, through points of x and z, as OBJ.
fn strip(profile: &[(f64, f64)]) -> String {
    let mut text: String = profile.iter().map(|(x, z)| format!("v {x} -1.003 {z}\nv {x} 1.001 {z}\n")).collect();
    for i in 0..profile.len() - 1 {
        let [a, b, c, d] = [1, 2, 3, 4].map(|k| 2 * i + k);
        text += &format!("f {a} {c} {d}\nf {a} {d} {b}\n");
    }
    text
}

/// A body on a surface, with sub-steps of `step` s; `friction` is that of the body, the surface has 1.
fn on(obj: &str, step: f64, shape: &str, place: [f64; 3], friction: f64) -> Bench {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("ground.obj"), obj).expect("written");
    let world = format!("gravity: {{x: 0, y: 0, z: -9.81}}\nphysics: {{profile: accurate, sub step: {step}}}\n");
    let [x, y, z] = place;
    let text = format!(
        "bodies: [BODY Ground, BODY Part]\n\
         BODY Ground: {{name: Ground, mass: 0, mesh: ground.obj, high resolution path: {0}, low resolution path: {0}, \
         friction: {{static: 1, rolling: 0}}, restitution: 0}}\n\
         BODY Part: {{name: Part, location: {{position: {{x: {x}, y: {y}, z: {z}}}}}, {shape}, \
         friction: {{static: {friction}, rolling: 0}}, restitution: 0, damping: {{linear: 0, angular: 0}}}}\n",
        folder.path().display()
    );
    let loaded = load_texts(&world, &[&text]);
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    Bench(Simulation::new(loaded.scene, step))
}

fn run(bench: &mut Bench, step: f64, seconds: f64) {
    (0..(seconds / step).round() as u32).for_each(|_| bench.update(step));
}

const BOX: &str = "mass: 0.1, collision shape: Box, collision geometry: {x: 0.08, y: 0.08, z: 0.04}";
const BALL: &str = "mass: 0.1, collision shape: Sphere, collision geometry: {radius: 0.03}";
const CUBE: &str = "mass: 0.001, collision shape: Box, collision geometry: {x: 0.01, y: 0.01, z: 0.01}";
const ROD: &str = "mass: 0.0002, collision shape: Box, collision geometry: {x: 0.03, y: 0.001, z: 0.001}";
const CAN: &str = "mass: 0.1, collision shape: Cylinder, collision geometry: {radius: 0.03, height: 0.04, axis: z}";
const PILL: &str = "mass: 0.002, collision shape: Capsule, collision geometry: {radius: 0.005, height: 0.03, axis: y}";

#[test]
fn bodies_slide_and_roll_over_a_flat_mesh_as_over_a_plane() {
    for step in [0.001, 0.005] {
        for (shape, half, friction, spin) in [
            (BOX, 0.02, 0.0, 0.0),
            (CAN, 0.02, 0.0, 0.0),
            (CUBE, 0.005, 0.0, 0.0),
            (PILL, 0.005, 0.0, 0.0),
            (BALL, 0.03, 0.5, 1.0 / 0.03),
        ] {
            let mut bench = on(&surface(|_, _| 0.0), step, shape, [-1.3, 0.013, half + 0.0015], friction);
            run(&mut bench, step, 0.2);
            let part = bench.body("Part");
            bench.0.set_velocity(part, Vector3::x(), Vector3::y() * spin);
            bench.update(step);
            let start = bench.position("Part");
            let mut hop: f64 = 0.0;
            for _ in 0..(2.0 / step) as u32 {
                bench.update(step);
                hop = hop.max((bench.position("Part").z - start.z).abs());
            }
            let aside = (bench.position("Part").y - start.y).abs();
            let speed = bench.velocity("Part").0.x;
            assert!((speed - 1.0).abs() < 0.01 && aside < 0.002 && hop < 5e-5, "{shape} {step}: {speed} {aside} {hop}");
        }
    }
}

#[test]
fn small_parts_come_to_rest_on_a_flat_mesh() {
    for shape in [CUBE, ROD, PILL, CAN] {
        let mut bench = on(&surface(|_, _| 0.0), 0.001, shape, [0.0131, 0.0071, 0.04], 0.5);
        let part = bench.body("Part");
        bench.0.set_velocity(part, Vector3::zeros(), Vector3::new(3.0, 1.0, 0.5));
        run(&mut bench, 0.001, 3.0);
        let start = bench.position("Part");
        let mut speed: f64 = 0.0;
        if shape == PILL {
            // It may roll.
            close(start.z, 0.006, 2e-5);
            continue;
        }
        for _ in 0..1000 {
            bench.update(0.001);
            speed = speed.max(bench.velocity("Part").0.norm());
        }
        let way = (bench.position("Part") - start).norm();
        assert!(speed < 1e-3 && way < 2e-5, "{shape}: {speed} m/s, {way} m");
    }
}

#[test]
fn a_body_slides_through_a_smooth_valley_without_loss() {
    for (shape, half) in [(BALL, 0.03), (CUBE, 0.005)] {
        let height = |x: f64| 0.3 * (1.0 - (x * 2.0).cos());
        let mut bench =
            on(&surface(|x, _| height(x)), 0.001, shape, [-0.6, 0.013, height(-0.6) + half * 1.3 + 0.002], 0.0);
        let top = bench.position("Part").z;
        let mut fastest: f64 = 0.0;
        for _ in 0..1000 {
            bench.update(0.001);
            fastest = fastest.max(bench.velocity("Part").0.norm());
        }
        let free = (2.0 * 9.81 * (top - half - 0.001)).sqrt();
        assert!(fastest > 0.95 * free && fastest < 1.01 * free, "{shape}: {fastest} of {free}");
    }
}

#[test]
fn walls_rims_and_ridges_of_a_mesh_still_act() {
    // A step upwards stops what slides against it.
    let mut bench =
        on(&strip(&[(-1.0, 0.0), (0.5, 0.0), (0.5, 0.1), (1.0, 0.1)]), 0.001, BOX, [0.0, 0.013, 0.0215], 0.0);
    bench.throw("Part", Vector3::x());
    run(&mut bench, 0.001, 1.0);
    assert!(bench.position("Part").x < 0.4601, "{}", bench.position("Part"));
    // A rim carries what lies on it by more than half, and no more.
    for (x, is_carried) in [(0.47, true), (0.53, false)] {
        for below in [0.0, 0.3] {
            let profile = [(-1.0, 0.0), (0.5, 0.0), (0.5, -below)];
            let mut bench =
                on(&strip(&profile[..if below > 0.0 { 3 } else { 2 }]), 0.001, BOX, [x, 0.013, 0.0215], 0.5);
            run(&mut bench, 0.001, 1.0);
            let z = bench.position("Part").z;
            assert_eq!((z - 0.021).abs() < 1e-4, is_carried, "{x} {below}: {z}");
        }
    }
    // A ridge carries a box across it.
    let mut bench = on(&strip(&[(-0.5, -0.5), (0.0, 0.0), (0.5, -0.5)]), 0.001, BOX, [0.0, 0.013, 0.0215], 0.5);
    run(&mut bench, 0.001, 0.3);
    close(bench.position("Part").z, 0.021, 1e-4);
}

#[test]
fn slender_parts_do_not_fall_through_a_mesh() {
    for step in [0.001, 0.005] {
        for i in 0..8 {
            let turn = f64::from(i) * 0.17 - 0.6;
            let mut bench = on(&surface(|_, _| 0.0), step, ROD, [0.01, 0.02, 0.2], 0.5);
            let part = bench.body("Part");
            bench.0.set_velocity(part, Vector3::zeros(), Vector3::new(turn, 8.0 * turn, 0.0));
            run(&mut bench, step, 0.5);
            assert!(bench.position("Part").z > 0.0, "{i}: {}", bench.position("Part"));
        }
    }
}
