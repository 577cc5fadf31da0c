//! Cost on top of a plain C++ Bullet program: `scripts/bench bare [--quick]`
//!
//! The program, `bullet-sys/bare/bare.cpp`, gets a scene that was built in the ordinary way and steps its bodies and
//! constraints in a plain `btDiscreteDynamicsWorld` with Bullet's own near callback, list of ignored pairs and motion
//! states. Both must come to the same state, bit for bit, before anything is measured. `ablation.rs` tells what leaving
//! out each thing alone saves.

mod ablation;

use ambf_bench::plot::Figure;
use ambf_bench::{report, statistics};
use std::path::{Path, PathBuf};
use std::process::exit;
use std::time::Duration;

use ambf_core::adf::{self, Launch};
use ambf_core::bullet::BodyKinematics;
use ambf_core::scene::{load, SceneFiles, SceneOptions};
use ambf_core::sim::{Runner, RunnerOptions, Simulation};
use bullet_sys::AmbWorld;
use report::{goal, Section};
use statistics::{short, Spread};

/// Length of a step, s.
const DT: f64 = 0.001;
/// Steps after which states are compared and measuring begins: boxes have landed, robots have settled.
const WARM_UP: usize = 1500;
/// What a slice of one lane takes, s.
const SLICE: f64 = 0.05;
/// Times that a scene is loaded.
const PAIRS: usize = 5;
/// Steps of the plain program below this, µs, are too short for a ratio.
const SMALL: f64 = 10.0;
/// Wanted: cost of an iteration over that of the plain program.
const GOAL: f64 = 1.03;

/// The plain program's world, in C++.
#[repr(C)]
struct Bare {
    _opaque: [u8; 0],
}

extern "C" {
    fn bare_take(world: *mut AmbWorld, skips: i32) -> *mut Bare;
    fn bare_step(bare: *mut Bare, steps: i32, dt: f64);
    fn bare_states(bare: *const Bare, out: *mut f64);
    fn bare_cpu_seconds() -> f64;
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    // `cargo test --all-targets` starts it too, without this word.
    if !arguments.iter().any(|argument| argument == "--bench") {
        println!("nothing is measured: this is started by `cargo bench` or scripts/bench bare");
        return;
    }
    if let Some(unknown) = arguments.iter().find(|argument| !["--bench", "--quick"].contains(&argument.as_str())) {
        eprintln!("bench bare: {unknown} is not known; expected --quick");
        exit(1);
    }
    let quick = arguments.iter().any(|argument| argument == "--quick");
    let machine = report::machine(quick);
    println!("{machine}\n");
    let rounds = if quick { 15 } else { 60 };
    let sections = [measure(rounds), ablation::skips(rounds / 2), ablation::sleep(rounds / 2)];
    sections.iter().for_each(|section| println!("{section}"));
    if !quick {
        report::publish("benchmarks/bare.md", "figures", &machine, &sections, &[] as &[(&str, Figure)]);
    }
}

/// Name, world and model; those of the original program only where `AMBF_ROOT_PATH` leads to them.
fn scenes() -> Vec<(String, SceneFiles)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace");
    let mut found = listed(&root.join("resources/launch.yaml"), &["boxes200", "arm7", "pendulum"]);
    if let Some(root) = std::env::var_os("AMBF_ROOT_PATH") {
        let launch = Path::new(&root).join("ambf_models/descriptions/launch.yaml");
        found.extend(listed(&launch, &["blender-psm", "puzzle1", "blender-pr2"]));
    }
    found
}

fn listed(launch: &Path, names: &[&str]) -> Vec<(String, SceneFiles)> {
    let Ok((launch, _)) = adf::load::<Launch>(launch) else { return Vec::new() };
    let models = launch.multibody_configs.unwrap_or_default();
    let find = |&name: &&str| {
        let model: &PathBuf = models.iter().find(|model| model.file_stem().is_some_and(|stem| stem == name))?;
        let files = SceneFiles { world: launch.world_config.clone(), models: vec![model.clone()] };
        Some((name.to_owned(), files))
    };
    names.iter().filter_map(find).collect()
}

fn simulation(files: &SceneFiles) -> Simulation {
    Simulation::new(load(files, &SceneOptions::default()).scene, DT)
}

/// A scene in the plain program, which leaves out what the bits say: see [`ablation`].
struct Plain {
    bare: *mut Bare,
    bodies: usize,
}

impl Plain {
    /// `None` for a scene with more than rigid bodies and joints.
    fn new(files: &SceneFiles, skips: i32) -> Option<Self> {
        let simulation = simulation(files);
        let bodies = simulation.scene().bodies.len();
        // SAFETY: the world is alive; nothing of the simulation is used or freed from here on, if the plain program
        // takes it.
        let bare = unsafe { bare_take(simulation.scene().world.as_raw(), skips) };
        if bare.is_null() {
            return None;
        }
        std::mem::forget(simulation);
        Some(Self { bare, bodies })
    }

    fn step(&mut self, steps: usize) {
        // SAFETY: `bare_take` made it, and nothing frees it.
        unsafe { bare_step(self.bare, steps as i32, DT) }
    }

    fn states(&self) -> Vec<BodyKinematics> {
        let mut states = vec![BodyKinematics::default(); self.bodies];
        // SAFETY: as many bodies as states, each of 18 doubles.
        unsafe { bare_states(self.bare, states.as_mut_ptr().cast()) }
        states
    }
}

fn cpu() -> f64 {
    // SAFETY: takes nothing.
    unsafe { bare_cpu_seconds() }
}

fn update(simulation: &mut Simulation, steps: usize) {
    for _ in 0..steps {
        simulation.update(DT).unwrap_or_else(|problem| panic!("{problem}"));
    }
}

/// A scene in both programs, in the same state.
struct Pair {
    plain: Plain,
    ours: Option<Simulation>,
    /// In a slice.
    steps: usize,
}

impl Pair {
    /// `None` for a scene that the plain program cannot have.
    fn new(name: &str, files: &SceneFiles) -> Option<Self> {
        let (mut plain, mut ours) = (Plain::new(files, 0)?, simulation(files));
        plain.step(WARM_UP);
        ours.connect();
        update(&mut ours, WARM_UP);
        let mut states = vec![BodyKinematics::default(); plain.bodies];
        ours.scene().world.read_bodies(&mut states);
        assert_eq!(plain.states(), states, "{name}: the two programs are not the same");
        let begin = cpu();
        plain.step(200);
        let steps = (SLICE * 200.0 / (cpu() - begin)).ceil() as usize;
        Some(Self { plain, ours: Some(ours), steps })
    }

    /// CPU time of a step in each way, µs: the plain program, `Simulation::update`, the physics thread with a hub.
    fn slice(&mut self) -> [f64; 3] {
        let per_step = |cost: f64, steps: f64| cost / steps * 1e6;
        let begin = cpu();
        self.plain.step(self.steps);
        let plain = cpu() - begin;
        let mut ours = self.ours.take().expect("it comes back after every slice");
        let begin = cpu();
        update(&mut ours, self.steps);
        let updated = cpu() - begin;
        let (first, begin) = (ours.sim_step(), cpu());
        // So often that it never waits: each iteration simulates 1 ms.
        let options = RunnerOptions { frequency: 1e9, fixed_step: true, speed_factor: 1e9 * DT };
        let runner = Runner::start(ours, options);
        std::thread::sleep(Duration::from_secs_f64(SLICE));
        let ours = runner.stop().expect("the physics thread ends in good order");
        let (looped, loop_steps) = (cpu() - begin, f64::from(ours.sim_step() - first));
        self.ours = Some(ours);
        let steps = self.steps as f64;
        [per_step(plain, steps), per_step(updated, steps), per_step(looped, loop_steps)]
    }
}

fn measure(rounds: usize) -> Section {
    let mut section = Section {
        title: "bare",
        intro: "CPU time of a step of 1 ms, µs, median (10th–90th percentile) of slices in which the three take turns in one process. *Plain*: the C++ \
                loop; *update*: `Simulation::update`, which also reads joints and efforts, looks for states that are not finite and takes \
                the time; *loop*: the physics thread with its hub, clock, commands and statistics, nobody listening. Profile `legacy`. Before measuring, the plain \
                program and ours have come to the same states, bit for bit.",
        header: &["scene", "bodies", "plain", "update", "loop", "update/plain", "loop/plain", "loop − plain, µs"],
        ..Section::default()
    };
    let mut worst: (f64, String) = (0.0, "nothing".into());
    for (name, files) in scenes() {
        // Where memory happens to lie makes some per cent: each pair lies elsewhere.
        let pairs: Option<Vec<Pair>> = (0..PAIRS).map(|_| Pair::new(&name, &files)).collect();
        let Some(mut pairs) = pairs else { continue };
        let slices: Vec<[f64; 3]> = (0..rounds).map(|round| pairs[round % PAIRS].slice()).collect();
        let spread = |value: &dyn Fn(&[f64; 3]) -> f64| Spread::of(slices.iter().map(value)).expect("there are slices");
        let mut row = vec![name.clone(), pairs[0].plain.bodies.to_string()];
        row.extend((0..3).map(|way| spread(&|slice| slice[way]).to_string()));
        let ratios = [1, 2].map(|way| spread(&|slice| slice[way] / slice[0]));
        row.extend(ratios.iter().map(|ratio| format!("{ratio:.3}")));
        row.push(spread(&|slice| slice[2] - slice[0]).to_string());
        eprintln!("{}", row.join(" | "));
        section.rows.push(row);
        if ratios[1].median > worst.0 && spread(&|slice| slice[0]).median >= SMALL {
            worst = (ratios[1].median, format!("at worst {:.3} ({name})", ratios[1].median));
        }
    }
    let words = format!(
        "an iteration of the loop costs at most {GOAL} times the plain program's step, where that takes at least {} µs",
        short(SMALL)
    );
    section.remarks.push(goal(&words, worst.0 <= GOAL, &worst.1));
    section
}
