//! Search for failures: `scripts/bench stability --random N --seed S`, also in files of other people ([`files`]).
//!
//! Scenes are drawn ([`generate`]), written as ADF ([`adf`]), run in several ways ([`run`]) and judged by
//! invariants ([`ambf_bench::invariants`]). A scene in which `accurate` fails is shrunk ([`shrink`]) to a small file
//! that fails in the same way.

mod adf;
mod dice;
mod files;
mod generate;
mod report;
mod run;
mod scene;
mod shrink;

use ambf_bench::{follow, script};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use follow::{Outcome, Verdict};
use parking_lot::Mutex;
use run::WAYS;

/// What is searched.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Number of scenes.
    pub scenes: u64,
    pub seed: u64,
    /// First scene.
    pub first: u64,
    /// Only the accurate profile is run.
    pub only_accurate: bool,
    /// Worlds that run at the same time.
    pub threads: usize,
    /// Failing scenes are shrunk.
    pub shrink: bool,
    /// Scenes that pass are written too.
    pub keep_all: bool,
    /// Where failing scenes are written.
    pub keep: PathBuf,
    /// Model files, and folders of them, that get random commands; empty: scenes are drawn instead.
    pub files: Vec<PathBuf>,
}

/// Words for a wrong command line.
const USAGE: &str =
    "expected --random N [--files FILE|FOLDER]… [--seed S] [--first I] [--only-accurate] [--threads T] [--no-shrink] [--keep DIR] [--keep-all]";

impl Options {
    /// Reads the command line; `None` without `--random`.
    ///
    /// # Errors
    /// A sentence about the first word that is not understood.
    pub fn read(arguments: &[String]) -> Result<Option<Self>, String> {
        if !arguments.iter().any(|argument| argument == "--random") {
            return Ok(None);
        }
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        let keep = ambf_bench::folder().join("random");
        let mut options = Self {
            scenes: 0,
            seed: 1,
            first: 0,
            only_accurate: false,
            threads,
            shrink: true,
            keep_all: false,
            keep,
            files: Vec::new(),
        };
        let mut rest = arguments.iter();
        while let Some(argument) = rest.next() {
            let mut number =
                || rest.next().and_then(|text| text.parse::<u64>().ok()).ok_or(format!("{argument}: {USAGE}"));
            match argument.as_str() {
                "--random" => options.scenes = number()?,
                "--seed" => options.seed = number()?,
                "--first" => options.first = number()?,
                "--threads" => options.threads = number()?.max(1) as usize,
                "--only-accurate" => options.only_accurate = true,
                "--no-shrink" => options.shrink = false,
                "--keep-all" => options.keep_all = true,
                "--files" => options.files.push(rest.next().ok_or(USAGE)?.into()),
                "--keep" => options.keep = rest.next().ok_or(USAGE)?.into(),
                super::CARGO_BENCH => (),
                _ => return Err(format!("{argument} is not known; {USAGE}")),
            }
        }
        Ok(Some(options))
    }
}

/// A scene with what became of it in each way.
struct Tried {
    index: u64,
    scene: scene::Scene,
    outcomes: Vec<(&'static str, Outcome)>,
}

impl Tried {
    /// Verdict of a way, the cost of `legacy` taken into account.
    fn verdict(&self, way: &str) -> Option<Verdict> {
        let legacy = self.outcome("legacy").map(|outcome| outcome.cost);
        self.outcome(way).map(|outcome| run::with_cost(outcome, self.scene.step, legacy))
    }

    fn outcome(&self, way: &str) -> Option<&Outcome> {
        self.outcomes.iter().find(|(name, _)| *name == way).map(|(_, outcome)| outcome)
    }
}

/// Runs all scenes and prints what was found.
///
/// # Panics
/// When the folder for failing scenes cannot be written.
pub fn search(options: &Options) {
    if !options.files.is_empty() {
        return files::search(options);
    }
    std::fs::create_dir_all(&options.keep).expect("the folder of --keep can be made");
    let ways = if options.only_accurate { &WAYS[..1] } else { &WAYS[..] };
    let (next, all) = (AtomicU64::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for worker in 0..options.threads {
            let (next, all) = (&next, &all);
            scope.spawn(move || {
                let path = options.keep.join(format!("running_{worker}.yaml"));
                loop {
                    let n = next.fetch_add(1, Ordering::Relaxed);
                    if n >= options.scenes {
                        break;
                    }
                    let tried = try_scene(options, options.first + n, ways, &path);
                    all.lock().push(tried);
                }
                // A file that stays tells which scene never came back.
                let _ = std::fs::remove_file(&path);
            });
        }
    });
    let mut all = all.into_inner();
    all.sort_by_key(|tried| tried.index);
    report::print(options, ways, &all);
}

fn try_scene(options: &Options, index: u64, ways: &[&'static str], path: &Path) -> Tried {
    let scene = generate::scene(options.seed, index);
    let outcomes = ways.iter().map(|&way| (way, run::run(&scene, way, path))).collect();
    let tried = Tried { index, scene, outcomes };
    let verdict = tried.verdict("accurate").unwrap_or(Verdict::Good);
    if verdict > Verdict::Good || options.keep_all {
        let name = format!("{}_{}_{}", verdict.name(), options.seed, index);
        let small = match options.shrink && !matches!(verdict, Verdict::Good | Verdict::Refused) {
            true => tried.outcome("accurate").map(|outcome| shrink::shrink(&tried.scene, outcome, path)),
            false => None,
        };
        let small = small.unwrap_or_else(|| tried.scene.clone());
        let words = report::words(&tried);
        let text = run::text(&small, path).unwrap_or_else(|problem| format!("# {problem}\n{}", adf::model(&small)));
        let file = options.keep.join(format!("{name}.yaml"));
        std::fs::write(&file, format!("# Scene {index} of seed {}: {words}\n{text}", options.seed))
            .expect("the folder of --keep can be written");
        println!("{words}: {}", file.display());
    }
    tried
}
