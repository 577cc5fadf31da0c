//! Both profiles on real files: `scripts/bench profiles [--quick] [FILE|FOLDER]…`
//!
//! Every model file is loaded into the default world and stepped [`STEPS`] x 1 ms without commands, in `legacy` and in
//! `accurate`. Nobody knows what the bodies of a file that somebody else wrote should do, but `accurate` must not be
//! wilder than `legacy`. Without files the models of the C++ program are taken, if they are there, and the page
//! `docs/benchmarks/profiles.md` is written.

// Shared with the other benchmarks, which use more of it.

use ambf_bench::plot::Figure;
use ambf_bench::{model_files, report};
use std::path::Path;
use std::process::exit;
use std::time::Duration;

use ambf_core::control::Profile;
use ambf_core::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;
use nalgebra::Vector3;
use rustix::time::{clock_gettime, ClockId};

use report::Section;

/// What `cargo bench` adds to the arguments of every benchmark.
const CARGO_BENCH: &str = "--bench";
const STEPS: u32 = 3000;
const STEP: f64 = 1e-3;
/// Slices of a run, in which the two profiles take turns, so that both see the same load of the machine.
const SLICES: u32 = 10;
/// Bodies slower than this at the end rest, m/s.
const REST: f64 = 0.02;
/// Bodies that rest in `legacy` at the end must rest in `accurate` until this time at the latest, s: a body without
/// friction slides until damping stops it.
const REST_UNTIL: f64 = 30.0;
/// Fastest body of `accurate`: at most this times that of `legacy`, and this much more, m/s; the same of the farthest,
/// m.
const FACTOR: f64 = 1.5;
const FASTER: f64 = 2.0;
const FARTHER: f64 = 1.0;
/// Most cost of `accurate`, as a multiple of that of `legacy`.
const COST: f64 = 3.0;

/// One profile on one file.
struct Run {
    simulation: Option<Simulation>,
    start: Vec<Vector3<f64>>,
    /// Fastest body, m/s; of the last tenth, too.
    fastest: f64,
    at_end: f64,
    /// Longest way of a body from its start, m.
    farthest: f64,
    cost: Duration,
    lost: Option<u32>,
    /// Time from which all bodies rest, s, if [`Run::wait_for_rest`] was called and it came.
    rests_from: Option<f64>,
}

impl Run {
    /// `None`: the file is refused.
    fn new(file: &Path, world: &Path, profile: Profile) -> Option<Self> {
        let files = SceneFiles { world: Some(world.to_owned()), models: vec![file.to_owned()] };
        let physics = PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
        let loaded = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
        if !loaded.report.refused.is_empty() || loaded.scene.bodies.is_empty() {
            return None;
        }
        let simulation = Simulation::new(loaded.scene, STEP);
        let world = &simulation.scene().world;
        let start = world.bodies().iter().map(|&body| world.pose(body).expect("alive").translation.vector).collect();
        Some(Self {
            simulation: Some(simulation),
            start,
            fastest: 0.0,
            at_end: 0.0,
            farthest: 0.0,
            cost: Duration::ZERO,
            lost: None,
            rests_from: None,
        })
    }

    /// Steps on until no body has moved faster than [`REST`] in the last `steps`, or until [`REST_UNTIL`].
    fn wait_for_rest(&mut self, steps: u32) {
        let Some(simulation) = self.simulation.as_mut() else { return };
        let mut slow = 0;
        while slow < steps && simulation.sim_time() < REST_UNTIL && simulation.update(STEP).is_ok() {
            let world = &simulation.scene().world;
            let is_slow = |&body| world.velocity(body).is_none_or(|(linear, _)| linear.norm() <= REST);
            slow = if world.bodies().iter().all(is_slow) { slow + 1 } else { 0 };
        }
        if slow >= steps {
            self.rests_from = Some(simulation.sim_time() - f64::from(slow) * STEP);
        }
    }

    fn slice(&mut self, steps: u32, last: bool) {
        let Some(simulation) = self.simulation.as_mut() else { return };
        self.at_end = 0.0;
        for _ in 0..steps {
            let begin = cpu_time();
            let result = simulation.update(STEP);
            self.cost += cpu_time() - begin;
            if result.is_err() {
                self.lost = Some(simulation.sim_step());
                self.fastest = f64::INFINITY;
                self.simulation = None;
                return;
            }
            let world = &simulation.scene().world;
            for (&body, start) in world.bodies().iter().zip(&self.start) {
                let speed = world.velocity(body).map_or(0.0, |(linear, _)| linear.norm());
                self.fastest = self.fastest.max(speed);
                if last {
                    self.at_end = self.at_end.max(speed);
                }
                let way = world.pose(body).map_or(0.0, |pose| (pose.translation.vector - start).norm());
                self.farthest = self.farthest.max(way);
            }
        }
    }
}

/// CPU time of this thread: what others do on the machine doesn't count.
fn cpu_time() -> Duration {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
}

/// Both profiles on one file.
struct Comparison {
    name: String,
    legacy: Run,
    accurate: Run,
}

impl Comparison {
    fn new(name: String, file: &Path, world: &Path, steps: u32) -> Option<Self> {
        let mut legacy = Run::new(file, world, Profile::Legacy)?;
        let mut accurate = Run::new(file, world, Profile::Accurate)?;
        for slice in 1..=SLICES {
            legacy.slice(steps / SLICES, slice == SLICES);
            accurate.slice(steps / SLICES, slice == SLICES);
        }
        let mut comparison = Self { name, legacy, accurate };
        if comparison.moves_longer() {
            comparison.accurate.wait_for_rest(steps / SLICES);
        }
        Some(comparison)
    }

    /// Whether bodies that rest in `legacy` at the end of the run still move in `accurate`.
    fn moves_longer(&self) -> bool {
        self.legacy.lost.is_none() && self.legacy.at_end < REST && self.accurate.at_end > REST
    }

    fn cost_ratio(&self) -> f64 {
        self.accurate.cost.as_secs_f64() / self.legacy.cost.as_secs_f64().max(1e-9)
    }

    /// What is wrong with `accurate`, in few words.
    fn faults(&self) -> Vec<&'static str> {
        let (l, a) = (&self.legacy, &self.accurate);
        let mut faults = Vec::new();
        let mut add = |wrong: bool, words: &'static str| {
            if wrong {
                faults.push(words);
            }
        };
        add(a.lost.is_some(), "lost");
        add(a.fastest > FACTOR * l.fastest + FASTER, "faster");
        add(a.farthest > FACTOR * l.farthest + FARTHER, "farther");
        add(self.moves_longer() && a.rests_from.is_none(), "does not rest");
        add(self.cost_ratio() > COST, "cost");
        faults
    }

    fn row(&self, steps: u32) -> Vec<String> {
        let number = |value: f64| match value {
            value if value.is_infinite() => "lost".to_owned(),
            value if value < 1e-4 => "0".to_owned(),
            value => format!("{value:.3}"),
        };
        let us = |run: &Run| format!("{:.1}", run.cost.as_secs_f64() * 1e6 / f64::from(steps));
        let (l, a) = (&self.legacy, &self.accurate);
        vec![
            format!("`{}`", self.name),
            number(l.fastest),
            number(a.fastest),
            number(l.at_end),
            number(a.at_end),
            number(l.farthest),
            number(a.farthest),
            us(l),
            us(a),
            format!("{:.2}", self.cost_ratio()),
            self.faults().join(", "),
            a.rests_from.map_or(String::new(), |time| format!("{time:.1}")),
        ]
    }
}

fn main() {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    // `cargo test --all-targets` starts it too, without this word.
    if !arguments.iter().any(|argument| argument == CARGO_BENCH) {
        println!("nothing is measured: this is started by `cargo bench` or scripts/bench");
        return;
    }
    arguments.retain(|argument| argument != CARGO_BENCH);
    let quick = arguments.iter().any(|argument| argument == "--quick");
    arguments.retain(|argument| argument != "--quick");
    let is_own = arguments.is_empty();
    if is_own {
        let Some(root) = std::env::var_os("AMBF_ROOT_PATH") else {
            eprintln!("bench: the models of the C++ program are not there; name files or folders");
            exit(1);
        };
        arguments.push(Path::new(&root).join("ambf_models/descriptions/multi-bodies").display().to_string());
    }
    let steps = if quick { STEPS / 3 } else { STEPS };
    let world = model_files::default_world();
    let mut comparisons = Vec::new();
    for argument in &arguments {
        let root = Path::new(argument);
        for file in model_files::below(&[root.to_owned()]) {
            let name = file.strip_prefix(root).ok().filter(|name| !name.as_os_str().is_empty()).unwrap_or(&file);
            let Some(comparison) = Comparison::new(name.display().to_string(), &file, &world, steps) else { continue };
            println!("{}", comparison.row(steps).join(" | "));
            comparisons.push(comparison);
        }
    }
    if comparisons.is_empty() {
        eprintln!("bench: no model file that loads in {}", arguments.join(", "));
        exit(1);
    }
    let mut ratios: Vec<f64> = comparisons.iter().map(Comparison::cost_ratio).collect();
    ratios.sort_by(f64::total_cmp);
    let median = ratios.get(ratios.len() / 2).copied().unwrap_or(f64::NAN);
    let dearest = ratios.last().copied().unwrap_or(f64::NAN);
    let count = |word: &str| comparisons.iter().filter(|one| one.faults().contains(&word)).count();
    let behave = comparisons.iter().filter(|one| one.faults().iter().all(|&fault| fault == "cost")).count();
    let words = format!("{behave} of {}", comparisons.len());
    let section = Section {
        title: "Both profiles on model files of the C++ program",
        intro: "`legacy` / `accurate`: speed of the fastest body, m/s; the same at the end of the run (the last tenth); longest way of a \
                body from its start, m; cost of a step, µs, and their ratio. Faults are those of `accurate`; the last column is the time \
                from which bodies rest in it that rest in `legacy` earlier, s.",
        header: &[
            "file", "fastest", "accurate", "at end", "accurate", "farthest", "accurate", "µs", "accurate", "ratio", "faults",
            "rests from",
        ],
        rows: comparisons.iter().map(|one| one.row(steps)).collect(),
        remarks: vec![
            report::goal("every file behaves in `accurate`", behave == comparisons.len(), &words),
            report::goal("median cost at most 1.5 of `legacy`'s", median <= 1.5, &format!("{median:.2}")),
            report::goal("cost of each file at most 3 of `legacy`'s", count("cost") == 0, &format!("{dearest:.2} at most")),
        ],
    };
    if is_own && !quick {
        println!("{section}");
        let none: [(&str, Figure); 0] = [];
        report::publish("benchmarks/profiles.md", "benchmarks", &report::machine(quick), &[section], &none);
    } else {
        section.remarks.iter().for_each(|remark| println!("{remark}"));
    }
}
