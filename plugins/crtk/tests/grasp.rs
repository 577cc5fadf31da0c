//! What a jaw takes, keeps, loses and lets go of by rules.

mod common;

use std::path::PathBuf;

use common::{resources, Bench, PROFILES};
use nalgebra::Vector3;

/// Free plates of 0.6 mm, weightless: one where the fingers of the shipped PSM are when it is inserted by 0.16 m, one
/// aside.
const BOXES: &str = "bodies: [BODY Needle, BODY Thorn]\njoints: []\nnamespace: /ambf/env/box/\n\
    BODY Needle: {name: Needle, mass: 0.005, \
    collision shape: Box, collision geometry: {x: 0.0006, y: 0.004, z: 0.004}, \
    inertia: {ix: 1.0e-7, iy: 1.0e-7, iz: 1.0e-7}, gravity: {x: 0, y: 0, z: 0}, \
    location: {position: {x: -0.01975, y: 0, z: 0.034209}, orientation: {r: 0, p: -0.523598776, y: 0}}}\n\
    BODY Thorn: {name: Thorn, mass: 0.005, collision shape: Box, collision geometry: {x: 0.0006, y: 0.004, z: 0.004}, \
    inertia: {ix: 1.0e-7, iy: 1.0e-7, iz: 1.0e-7}, gravity: {x: 0, y: 0, z: 0}, \
    location: {position: {x: -0.01975, y: 0.05, z: 0.034209}}}\n";

/// The bench, with the open jaw around the box; `rules` of grasping.
fn around_the_box(profile: ambf_core::control::Profile, rules: &str) -> Bench {
    let folder = tempfile::tempdir().unwrap();
    let (boxes, arms) = (folder.path().join("boxes.yaml"), folder.path().join("arms.yaml"));
    std::fs::write(&boxes, BOXES).unwrap();
    let text = std::fs::read_to_string(resources().join("crtk/psm.yaml")).unwrap();
    let with_rules = text.replace("    jaw:\n", &format!("    grasp: {rules}\n    jaw:\n      home: 0.9\n"));
    std::fs::write(&arms, with_rules).unwrap();
    let models: [PathBuf; 2] = [resources().join("models/psm.yaml"), boxes];
    let mut bench = Bench::new(&models, &arms, profile);
    // The jaw opens on the way home.
    bench.run(3.0);
    turn(&mut bench, 0.0);
    bench
}

fn place(bench: &Bench, name: &str) -> Vector3<f64> {
    bench.body(name).translation.vector
}

/// How far the box is from the tool.
fn apart(bench: &Bench) -> Vector3<f64> {
    bench.body("tool").inverse_transform_vector(&(place(bench, "Needle") - place(bench, "tool")))
}

fn jaw(bench: &mut Bench, angle: f64) {
    bench.send_positions("/PSM1/jaw/move_jp", &[angle]);
    bench.run(2.5);
}

fn turn(bench: &mut Bench, yaw: f64) {
    bench.send_positions("/PSM1/move_jp", &[yaw, 0.0, 0.16, 0.0, 0.0, 0.0]);
    bench.run(0.5);
}

#[test]
fn a_closed_jaw_takes_what_is_between_the_fingers_and_an_open_one_lets_go() {
    for profile in PROFILES {
        let mut bench = around_the_box(profile, "{only: [Need]}");
        let start = place(&bench, "Needle");
        jaw(&mut bench, 0.041);
        jaw(&mut bench, 0.0);
        let taken = apart(&bench);
        turn(&mut bench, 0.5);
        println!("{profile:?}: it slips by {:.4} mm", (apart(&bench) - taken).norm() * 1e3);
        assert!((apart(&bench) - taken).norm() < 5e-4, "{profile:?}: it comes along");
        assert!((place(&bench, "Needle") - start).norm() > 0.02, "{profile:?}");
        // Not yet at 0.079.
        jaw(&mut bench, 0.079);
        turn(&mut bench, -0.5);
        assert!((apart(&bench) - taken).norm() < 5e-4, "{profile:?}: it is kept");
        jaw(&mut bench, 0.9);
        turn(&mut bench, 0.5);
        assert!((apart(&bench) - taken).norm() > 5e-3, "{profile:?}: it stays behind");
    }
}

#[test]
fn what_has_another_name_is_not_taken() {
    let mut bench = around_the_box(ambf_core::control::Profile::Accurate, "{only: [Thorn]}");
    jaw(&mut bench, 0.0);
    let before = apart(&bench);
    jaw(&mut bench, 0.079);
    // Nothing but the fingers themselves could carry it, and they are open.
    jaw(&mut bench, 0.9);
    turn(&mut bench, 0.5);
    assert!((apart(&bench) - before).norm() > 5e-3);
}

#[test]
fn a_reset_lets_go() {
    let mut bench = around_the_box(ambf_core::control::Profile::Accurate, "{}");
    jaw(&mut bench, 0.0);
    let start = Vector3::new(-0.01975, 0.0, 0.034209);
    turn(&mut bench, 0.5);
    assert!((place(&bench, "Needle") - start).norm() > 0.02, "it was taken along");
    bench.simulation.reset_world();
    bench.run(2.0);
    assert!((place(&bench, "Needle") - start).norm() < 3e-3, "it is back, between open fingers");
    turn(&mut bench, 0.5);
    assert!((place(&bench, "Needle") - start).norm() < 0.02, "and is not held");
}
