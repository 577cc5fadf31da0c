//! Traces of pybullet, runs of our program on the same scenes, and how far they are apart.
#![allow(dead_code, missing_docs)]

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::io::Read;
use std::path::{Path, PathBuf};

use ambf_app::batch::{Commands, Targets};
use ambf_core::scene::{load, JointType, Loaded, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;
use flate2::read::GzDecoder;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// How pybullet simulated a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Each body for itself.
    Rigid,
    /// A tree of links in reduced coordinates.
    Articulated,
}

/// A line of `runs.csv`.
#[derive(Debug, Clone)]
pub struct Run {
    pub name: String,
    pub scene: String,
    pub method: Method,
    /// s.
    pub dt: f64,
    pub steps: u64,
}

/// Largest differences over all bodies and joints of some rows: m, rad, m/s, rad/s; joints: rad or m.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Differences {
    pub position: f64,
    pub rotation: f64,
    pub linear: f64,
    pub angular: f64,
    pub joint: f64,
}

/// Up to which step a run of rigid bodies is the same in both programs; see docs/pybullet.md.
pub fn same_until(run: &Run) -> u64 {
    match run.name.as_str() {
        "pile_all" => 96,
        _ => run.steps,
    }
}

impl Differences {
    /// Of all rows.
    pub fn of(rows: &[(u64, Differences)]) -> Self {
        rows.iter().fold(Self::default(), |a, (_, b)| Self {
            position: raise(a.position, b.position),
            rotation: raise(a.rotation, b.rotation),
            linear: raise(a.linear, b.linear),
            angular: raise(a.angular, b.angular),
            joint: raise(a.joint, b.joint),
        })
    }

    pub fn largest(&self) -> f64 {
        [self.position, self.rotation, self.linear, self.angular, self.joint].into_iter().fold(0.0, raise)
    }
}

/// The larger one; not a number counts as the largest.
fn raise(a: f64, b: f64) -> f64 {
    if b > a || b.is_nan() {
        b
    } else {
        a
    }
}

/// The folder of the traces.
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/traces/pybullet")
}

/// All runs that were recorded.
pub fn runs() -> Vec<Run> {
    let file = folder().join("runs.csv");
    let text = std::fs::read_to_string(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let runs = text.lines().skip(1).map(|line| {
        let cells: Vec<_> = line.split(',').collect();
        let &[name, scene, method, dt, steps, _] = cells.as_slice() else { panic!("{}: {line}", file.display()) };
        let method = match method {
            "rigid" => Method::Rigid,
            "articulated" => Method::Articulated,
            _ => panic!("{}: {line}", file.display()),
        };
        Run { name: name.into(), scene: scene.into(), method, dt: number(dt), steps: number(steps) as u64 }
    });
    runs.collect()
}

/// Differences at each recorded step, in rising order of steps.
pub fn compare(run: &Run, options: &SceneOptions) -> Vec<(u64, Differences)> {
    let bodies = table(&folder().join(format!("{}_bodies.csv.gz", run.name)));
    let joints = match run.method {
        Method::Rigid => BTreeMap::new(),
        Method::Articulated => table(&folder().join(format!("{}_joints.csv.gz", run.name))),
    };
    let mut simulation = start(run, options);
    let mut rows = Vec::new();
    for step in 0..=run.steps {
        if step > 0 {
            simulation.update(run.dt).unwrap_or_else(|error| panic!("{}: {error}", run.name));
        }
        if let Some(states) = bodies.get(&step) {
            let none = BTreeMap::new();
            rows.push((step, differences(&simulation, states, joints.get(&step).unwrap_or(&none))));
        }
    }
    assert_eq!(rows.len(), bodies.len(), "{}: the trace has rows beyond the last step", run.name);
    rows
}

/// The scene of a run, loaded without a complaint, with its first velocities.
fn start(run: &Run, options: &SceneOptions) -> Simulation {
    let models = vec![folder().join(format!("{}.yaml", run.scene))];
    let files = SceneFiles { world: Some(folder().join("world.yaml")), models };
    let Loaded { scene, report } = load(&files, options);
    assert_eq!(report.errors(), 0, "{report}");
    let mut simulation = Simulation::new(scene, run.dt);
    let file = folder().join(format!("{}.txt", run.scene));
    if let Ok(text) = std::fs::read_to_string(&file) {
        let names: Vec<_> = simulation.scene().bodies.iter().map(|body| body.identity.name.to_string()).collect();
        let commands =
            Commands::parse(&text, &file.display().to_string(), &Targets::new(simulation.scene(), &names)).unwrap();
        commands.apply(&mut simulation, 0, run.dt).unwrap();
    }
    simulation
}

fn differences(
    simulation: &Simulation,
    bodies: &BTreeMap<String, Vec<f64>>,
    joints: &BTreeMap<String, Vec<f64>>,
) -> Differences {
    let scene = simulation.scene();
    assert_eq!(scene.bodies.len(), bodies.len(), "bodies of the scene and of the trace");
    let mut largest = Differences::default();
    for (body, &handle) in scene.bodies.iter().zip(scene.world.bodies()) {
        let theirs = &bodies[&*body.identity.name];
        let vector = |i: usize| Vector3::from_column_slice(&theirs[i..i + 3]);
        let pose = scene.world.pose(handle).expect("a live body");
        let (linear, angular) = scene.world.velocity(handle).expect("a live body");
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(theirs[6], theirs[3], theirs[4], theirs[5]));
        largest.position = raise(largest.position, (pose.translation.vector - vector(0)).norm());
        // Not `angle_to`, which cannot tell angles below 1e-8.
        let turn = 2.0 * (pose.rotation.inverse() * rotation).imag().norm();
        largest.rotation = raise(largest.rotation, turn);
        largest.linear = raise(largest.linear, (linear - vector(7)).norm());
        largest.angular = raise(largest.angular, (angular - vector(10)).norm());
    }
    assert!(joints.is_empty() || joints.len() == scene.joints.len(), "joints of the scene and of the trace");
    for joint in scene.joints.iter().filter(|_| !joints.is_empty()) {
        let mut apart = joint.position - joints[&joint.name][0];
        if joint.joint_type == JointType::Revolute {
            // pybullet counts turns, we do not.
            apart = (apart + PI).rem_euclid(TAU) - PI;
        }
        largest.joint = raise(largest.joint, apart.abs());
    }
    largest
}

/// A compressed table with columns `step,name,numbers…`.
fn table(file: &Path) -> BTreeMap<u64, BTreeMap<String, Vec<f64>>> {
    let compressed = std::fs::read(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let mut text = String::new();
    GzDecoder::new(&compressed[..]).read_to_string(&mut text).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    let mut table: BTreeMap<u64, BTreeMap<String, Vec<f64>>> = BTreeMap::new();
    for line in text.lines().skip(1) {
        let mut cells = line.split(',');
        let step = cells.next().and_then(|cell| cell.parse().ok()).unwrap_or_else(|| panic!("{line}"));
        let name = cells.next().unwrap_or_else(|| panic!("{line}")).to_owned();
        table.entry(step).or_default().insert(name, cells.map(number).collect());
    }
    table
}

fn number(text: &str) -> f64 {
    text.parse().unwrap_or_else(|_| panic!("`{text}` is no number"))
}
