//! Reads the original's scenes, which lie outside the repository in `../shared/legacy`, and counts what is in them.

use std::path::{Path, PathBuf};

use ambf_model::adf::{self, ColorTable, InputDevices, Launch, LoadError, Model, Report, World};
use ambf_test_support::legacy;

fn yaml_files(dir: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(dir).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            yaml_files(&path, files);
        } else if path.extension().is_some_and(|e| e == "yaml") {
            files.push(path);
        }
    }
}

#[derive(Debug, Default, PartialEq)]
struct Counts {
    models: usize,
    bodies: usize,
    joints: usize,
    sensors: usize,
    actuators: usize,
    soft_bodies: usize,
    vehicles: usize,
    cameras: usize,
    lights: usize,
    devices: usize,
}

/// Errors as `file name: path` that the shipped files are known to have.
const KNOWN_ERRORS: [&str; 1] = ["cylinder.yaml: SENSOR Proximity / array"];

#[test]
fn all_legacy_files() {
    let Some(dir) = legacy() else { return };
    let dir = dir.join("descriptions");
    let mut files = Vec::new();
    yaml_files(&dir, &mut files);
    files.sort();
    assert_eq!(files.len(), 71);
    let mut counts = Counts::default();
    let mut refused = Vec::new();
    let mut report = Report::default();
    for file in &files {
        let path = file.to_string_lossy();
        let mut model = |m: Model| {
            counts.models += 1;
            counts.bodies += m.bodies.len();
            counts.joints += m.joints.len();
            counts.sensors += m.sensors.len();
            counts.actuators += m.actuators.len();
            counts.soft_bodies += m.soft_bodies.len();
            counts.vehicles += m.vehicles.len();
            counts.cameras += m.cameras.len();
            counts.lights += m.lights.len();
        };
        let result = if path.ends_with("launch.yaml") {
            adf::load::<Launch>(file).map(|(launch, report)| {
                assert_eq!(launch.multibody_configs.map(|m| m.len()), Some(23));
                report
            })
        } else if path.ends_with("world.yaml") {
            adf::load::<World>(file).map(|(world, report)| {
                counts.cameras += world.cameras.len();
                counts.lights += world.lights.len();
                report
            })
        } else if path.contains("input_devices") {
            adf::load::<InputDevices>(file).map(|(devices, report)| {
                counts.devices += devices.entries.iter().flatten().count();
                report
            })
        } else if path.ends_with("colors.yaml") {
            adf::load::<ColorTable>(file).map(|(table, report)| {
                assert_eq!(table.colors.len(), 143);
                assert_eq!(table.colors["red_indian"], [0xcd, 0x5c, 0x5c, 0xff]);
                report
            })
        } else {
            adf::load::<Model>(file).map(|(m, report)| {
                model(m);
                report
            })
        };
        match result {
            Ok(found) => report.append(found),
            Err(error) => refused.push((file.clone(), error)),
        }
    }
    let [(file, LoadError::Syntax { at, .. })] = refused.as_slice() else { panic!("{refused:#?}") };
    assert!(file.ends_with("puzzles/compound_example.yaml"));
    assert_eq!(at.line, 84, "{}", refused[0].1);
    println!("{report}");
    let errors: Vec<String> = (report.problems().iter())
        .filter(|p| p.severity > adf::Severity::Warning)
        .map(|p| {
            let name = p.source.file.file_name().unwrap_or_default();
            format!("{}: {}", name.to_string_lossy(), p.path)
        })
        .collect();
    assert_eq!(errors, KNOWN_ERRORS);
    let expected = Counts {
        models: 64,
        bodies: 753,
        joints: 656,
        sensors: 19, // of 20: one has no rays, which drops it in the original too
        actuators: 3,
        soft_bodies: 2,
        vehicles: 1,
        cameras: 4,
        lights: 4,
        devices: 14,
    };
    assert_eq!(counts, expected);
}
