//! Runs are reproducible to the last bit: the shipped scenes end in the states whose hashes `golden.txt` holds, in both
//! profiles.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::thread;

use ambf_core::adf::{self, Launch};
use ambf_core::bullet::BodyKinematics;
use ambf_core::control::Profile;
use ambf_core::scene::{load, Loaded, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;

const STEPS: u64 = 500;

/// Set to anything to write `golden.txt` anew.
const REGENERATE: &str = "AMBF_WRITE_GOLDEN";

fn golden_file() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden.txt")
}

fn launch() -> Launch {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources/launch.yaml");
    adf::load::<Launch>(&file).unwrap_or_else(|error| panic!("{error}")).0
}

/// FNV-1a, 64 bits (Fowler, Noll, Vo; RFC 9923): the same on every machine and in every version of Rust.
struct Fnv(u64);

impl Fnv {
    fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    fn add(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }

    fn add_number(&mut self, number: f64) {
        self.add(&number.to_bits().to_le_bytes());
    }
}

/// Hash of the state after [`STEPS`] steps of 1 ms: reported poses and velocities of all bodies, nodes of soft bodies,
/// and all joints.
fn final_hash(world: Option<PathBuf>, model: &Path, profile: Profile) -> u64 {
    let files = SceneFiles { world, models: vec![model.to_owned()] };
    let physics = PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
    let Loaded { scene, report } = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
    assert_eq!(report.errors(), 0, "{report}");
    let mut simulation = Simulation::new(scene, 0.001);
    for _ in 0..STEPS {
        simulation.update(0.001).unwrap_or_else(|error| panic!("{}: {error}", model.display()));
    }
    let scene = simulation.scene();
    let mut states = vec![BodyKinematics::default(); scene.bodies.len()];
    scene.world.read_bodies(&mut states);
    let mut hash = Fnv::new();
    for state in &states {
        let numbers =
            state.origin.iter().chain(&state.basis).chain(&state.linear_velocity).chain(&state.angular_velocity);
        numbers.for_each(|&number| hash.add_number(number));
    }
    for soft in &scene.soft_bodies {
        let mut nodes = vec![[0.0; 3]; soft.nodes];
        soft.read_nodes(&scene.world, &mut nodes);
        nodes.as_flattened().iter().for_each(|&number| hash.add_number(number));
    }
    for joint in &scene.joints {
        [joint.position, joint.velocity, joint.effort].iter().for_each(|&number| hash.add_number(number));
    }
    hash.0
}

/// Hash of what the maths library gives here: it differs in the last bit between processors, and the states with it.
fn maths_hash() -> u64 {
    let mut hash = Fnv::new();
    for i in 0..2000 {
        let x = f64::from(i) * 0.000_917_3 - 0.9;
        [x.sin(), x.cos(), x.atan2(0.3), (x / 2.0).acos(), (x / 2.0).asin(), (1.0 + x.abs()).powf(0.001)]
            .iter()
            .for_each(|&number| hash.add_number(number));
    }
    hash.0
}

/// Two independent runs of every shipped scene in both profiles; names of `accurate` say so.
fn hashes() -> BTreeMap<String, [u64; 2]> {
    let launch = launch();
    let models = launch.multibody_configs.expect("models");
    thread::scope(|scope| {
        let run = |model: &PathBuf, profile| {
            let (world, model) = (launch.world_config.clone(), model.clone());
            scope.spawn(move || final_hash(world, &model, profile))
        };
        let profiles = [(Profile::Legacy, ""), (Profile::Accurate, " (accurate)")];
        let pairs = models.iter().flat_map(|model| profiles.map(|(profile, suffix)| (model, profile, suffix)));
        let threads: Vec<_> =
            pairs.map(|(model, profile, suffix)| (model, suffix, [run(model, profile), run(model, profile)])).collect();
        let results = threads.into_iter().map(|(model, suffix, pair)| {
            let name = model.file_stem().expect("a file name").to_string_lossy() + suffix;
            (name.into_owned(), pair.map(|thread| thread.join().expect("a hash")))
        });
        results.collect()
    })
}

#[test]
fn the_hash_is_fnv_1a() {
    let mut hash = Fnv::new();
    hash.add(b"foobar");
    assert_eq!(hash.0, 0x8594_4171_f739_67e8);
}

#[test]
fn shipped_scenes_end_in_the_known_state() {
    let hashes = hashes();
    for (name, [first, second]) in &hashes {
        assert_eq!(first, second, "{name}: two runs differ");
    }
    let mut text =
        String::from("# State of each shipped scene after 500 steps, as FNV-1a hash. Written by tests/golden.rs.\n");
    let maths = format!("(maths library) {:016x}", maths_hash());
    writeln!(text, "{maths}").expect("written");
    for (name, [hash, _]) in &hashes {
        writeln!(text, "{name} {hash:016x}").expect("written");
    }
    if std::env::var_os(REGENERATE).is_some() {
        std::fs::write(golden_file(), &text).expect("written");
    }
    let known = std::fs::read_to_string(golden_file()).unwrap_or_default();
    if known.lines().all(|line| line != maths) {
        eprintln!("SKIPPED: golden.txt was written with another maths library or processor; only that two runs agree was tested");
        return;
    }
    let changed: Vec<_> = text.lines().filter(|line| known.lines().all(|other| other != *line)).collect();
    assert!(
        text == known,
        "final states are not those in golden.txt:\n    {}\nAnother build of Bullet may cause that, and so may a scene that was edited; \
         if neither is the case, the physics has changed. When that is meant:\n    \
         {REGENERATE}=1 cargo test -p ambf-app --test golden\n",
        changed.join("\n    ")
    );
}
