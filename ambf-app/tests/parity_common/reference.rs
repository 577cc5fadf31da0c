//! Reads the traces and what was written down about their scenes.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::Command;

use ambf_core::adf::{self, Launch};
use ambf_core::scene::SceneFiles;
use flate2::read::GzDecoder;
use nalgebra::{Quaternion, Vector3};

/// A trace and how to run its scene.
#[derive(Debug, Clone)]
pub struct Case {
    pub name: String,
    pub files: SceneFiles,
    pub commands: Option<PathBuf>,
    pub steps: u64,
    /// What all files of the trace begin with.
    pub prefix: PathBuf,
}

impl Case {
    fn file(&self, rest: &str) -> PathBuf {
        let mut path = self.prefix.clone().into_os_string();
        path.push(rest);
        path.into()
    }

    /// Whether the scene has soft bodies.
    pub fn is_soft(&self) -> bool {
        self.file("_softnodes.csv.gz").exists()
    }
}

/// The traces of our own scenes, and where they are at hand those of legacy scenes, which belong to others.
pub fn cases() -> Vec<Case> {
    let own = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/traces/cpp");
    let world = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources/world/world.yaml");
    let mut cases = listed(&own, &own.join("scenes"), Some(&world), |scene| Some(own.join(scene)));
    let Some(shared) = ambf_test_support::shared() else { return cases };
    let legacy = ambf_test_support::legacy().expect("legacy scenes beside the traces");
    let launch_file = legacy.join("descriptions/launch.yaml");
    let launch = adf::load::<Launch>(&launch_file).unwrap_or_else(|error| panic!("{error}")).0;
    let models = launch.multibody_configs.expect("a list of models");
    let world = launch.world_config.as_deref();
    cases.extend(listed(&shared.join("traces"), &shared.join("scenes"), world, |scene| {
        match (scene.strip_prefix("launch index "), scene.strip_prefix("legacy/…/")) {
            (Some(index), _) => Some(models[index.parse::<usize>().expect("an index")].clone()),
            (_, Some(file)) => Some(legacy.join("descriptions").join(file)),
            _ => None,
        }
    }));
    cases
}

/// The traces in the table of `folder/README.md` whose model `model` finds. Files of commands are relative to `scenes`.
fn listed(folder: &Path, scenes: &Path, world: Option<&Path>, model: impl Fn(&str) -> Option<PathBuf>) -> Vec<Case> {
    let readme = folder.join("README.md");
    let text = std::fs::read_to_string(&readme).unwrap_or_else(|error| panic!("{}: {error}", readme.display()));
    let mut names = Vec::new();
    let rows = text.lines().filter_map(|line| {
        let cells: Vec<_> = line.split('|').map(|cell| cell.trim().trim_matches('`')).collect();
        let &["", name, scene, commands, steps, ""] = cells.as_slice() else { return None };
        let steps = steps.parse().ok()?;
        names.push(name.to_owned());
        let commands = (commands != "–").then(|| scenes.join(commands));
        let files = SceneFiles { world: world.map(Path::to_owned), models: vec![model(scene)?] };
        Some(Case { name: name.into(), files, commands, steps, prefix: folder.join(name) })
    });
    let cases: Vec<_> = rows.collect();
    for entry in folder.read_dir().expect("traces") {
        let name = entry.expect("an entry").file_name().to_string_lossy().into_owned();
        if let Some(trace) = name.strip_suffix("_bodies.csv.gz") {
            assert!(names.iter().any(|name| name == trace), "{}: no row for the trace `{trace}`", readme.display());
        }
    }
    cases
}

/// States of several objects over time.
#[derive(Debug, Clone, Default)]
pub struct Table<T> {
    pub names: Vec<String>,
    /// Step, simulated time (s), one state a name.
    pub rows: Vec<(u64, f64, Vec<T>)>,
}

/// Pose as reported and velocity of a body: m, m/s, rad/s, world axes. The quaternion has length 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyState {
    pub position: Vector3<f64>,
    pub rotation: Quaternion<f64>,
    pub linear: Vector3<f64>,
    pub angular: Vector3<f64>,
}

/// What a joint reports: rad or m, rad/s or m/s, N·m or N.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JointState {
    pub kind: u8,
    pub parent: String,
    pub child: String,
    pub position: f64,
    pub velocity: f64,
    pub effort: f64,
}

/// The bodies of a trace.
pub fn bodies(case: &Case) -> Table<BodyState> {
    read_table(&case.file("_bodies.csv.gz"), 16, |cells| {
        let number = |i: usize| number(cells[i]);
        let vector = |i: usize| Vector3::new(number(i), number(i + 1), number(i + 2));
        BodyState {
            position: vector(0),
            // The C++ program's conversion from a matrix does not always give a unit quaternion.
            rotation: Quaternion::new(number(6), number(3), number(4), number(5)).normalize(),
            linear: vector(7),
            angular: vector(10),
        }
    })
}

/// The joints of a trace; none when the scene has none.
pub fn joints(case: &Case) -> Table<JointState> {
    let file = case.file("_joints.csv.gz");
    if !file.exists() {
        return Table::default();
    }
    read_table(&file, 9, |cells| JointState {
        kind: cells[0].parse().expect("a type"),
        parent: cells[1].into(),
        child: cells[2].into(),
        position: number(cells[3]),
        velocity: number(cells[4]),
        effort: number(cells[5]),
    })
}

/// The nodes of a trace's soft body that were recorded: step, node, position (m, world).
pub fn soft_nodes(case: &Case) -> Vec<(u64, usize, Vector3<f64>)> {
    let text = unpacked(&case.file("_softnodes.csv.gz"));
    let rows = text.lines().skip(1).map(|line| {
        let cells: Vec<_> = line.split(',').collect();
        let &[step, _, _, node, x, y, z] = cells.as_slice() else { panic!("{}: {line}", case.name) };
        let index = |text: &str| text.parse().expect("a number");
        (index(step), index(node) as usize, Vector3::new(number(x), number(y), number(z)))
    });
    rows.collect()
}

fn number(text: &str) -> f64 {
    text.parse().unwrap_or_else(|_| panic!("`{text}` is no number"))
}

fn unpacked(file: &Path) -> String {
    let compressed = std::fs::read(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let mut text = String::new();
    GzDecoder::new(&compressed[..]).read_to_string(&mut text).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    text
}

fn read_table<T>(file: &Path, columns: usize, state: impl Fn(&[&str]) -> T) -> Table<T> {
    let text = unpacked(file);
    let mut table = Table { names: Vec::new(), rows: Vec::new() };
    for line in text.lines().skip(1) {
        let cells: Vec<_> = line.split(',').collect();
        assert_eq!(cells.len(), columns, "{}: {line}", file.display());
        let step = cells[0].parse().expect("a step");
        if table.rows.last().is_none_or(|row| row.0 != step) {
            table.rows.push((step, number(cells[1]), Vec::new()));
        }
        if table.rows.len() == 1 {
            table.names.push(cells[2].into());
        }
        let row = table.rows.last_mut().expect("just pushed");
        assert_eq!(table.names[row.2.len()], cells[2], "{}: step {step}", file.display());
        row.2.push(state(&cells[3..]));
    }
    assert!(table.rows.iter().all(|row| row.2.len() == table.names.len()), "{}: incomplete", file.display());
    table
}

/// What the C++ program made of a body's description.
#[derive(Debug, Clone)]
pub struct MetaBody {
    pub name: String,
    pub mass: f64,
    pub inertia: Vector3<f64>,
    pub inertial_offset: Vector3<f64>,
    pub passive: bool,
    /// Joint and child of each, in order.
    pub active_joints: Vec<(String, String)>,
}

/// The bodies in `NAME_meta.txt`, and the names and types of the joints.
pub fn meta(case: &Case) -> (Vec<MetaBody>, Vec<(String, u8)>) {
    let file = case.file("_meta.txt");
    let text = std::fs::read_to_string(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let after = |line: &str, mark: &str| {
        let begin = line.find(mark).unwrap_or_else(|| panic!("no `{mark}` in {line}")) + mark.len();
        line[begin..].to_owned()
    };
    let until = |text: String, end: &str| text.split(end).next().expect("a first part").to_owned();
    let vector = |line: &str, mark: &str| {
        let list = until(after(line, mark), ")");
        Vector3::from_iterator(list.split(',').map(number))
    };
    let (mut bodies, mut joints) = (Vec::new(), Vec::new());
    for line in text.lines() {
        if line.starts_with("BODY ") {
            let list = after(line, "active_joints:");
            let pairs = list.split('[').skip(1).map(|pair| {
                let (joint, child) = pair.trim().trim_end_matches(']').split_once("->").expect("joint->child");
                (joint.to_owned(), child.to_owned())
            });
            bodies.push(MetaBody {
                name: until(after(line, " name=\""), "\""),
                mass: number(&until(after(line, " mass="), " ")),
                inertia: vector(line, "inertia=("),
                inertial_offset: vector(line, "inertial_offset_pos=("),
                passive: after(line, "passive=").starts_with('1'),
                active_joints: pairs.collect(),
            });
        } else if line.starts_with("JOINT ") {
            let kind = after(line, " type=").trim().parse().expect("a type");
            joints.push((until(after(line, " name=\""), "\""), kind));
        }
    }
    (bodies, joints)
}
