//! Stability: `scripts/bench stability [--quick] [--only FAMILY]…`; search for failures in random scenes:
//! `scripts/bench stability --random N [--seed S]`, see [`random`].
//!
//! With `--only` tables are printed and nothing is written; else they go into `docs/benchmarks/stability.md`, between
//! its markers, with a map of all of it.

// Shared with the other benchmarks, which use more of it.
mod families;
mod map;
mod random;
mod trial;

use ambf_bench::{jointed, report, system};
use std::process::exit;
use std::time::Duration;

use ambf_core::bullet::Solver;
use ambf_core::control::Profile;
use ambf_core::scene::PhysicsOptions;

use families::Family;
use map::Block;
use report::Section;
use trial::{Outcome, Verdict};

/// What `cargo bench` adds to the arguments of every benchmark.
const CARGO_BENCH: &str = "--bench";

const WAYS: [&str; 4] = ["legacy", "accurate", "100 iterations", "Dantzig"];

fn physics(way: &str) -> PhysicsOptions {
    let legacy = PhysicsOptions { profile: Some(Profile::Legacy), ..PhysicsOptions::default() };
    match way {
        "accurate" => PhysicsOptions { profile: Some(Profile::Accurate), ..legacy },
        "100 iterations" => PhysicsOptions { iterations: Some(100), ..legacy },
        "Dantzig" => PhysicsOptions { solver: Some(Solver::Dantzig), ..legacy },
        _ => legacy,
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    // `cargo test --all-targets` starts it too, without this word.
    if !arguments.iter().any(|argument| argument == CARGO_BENCH) {
        println!("nothing is measured: this is started by `cargo bench` or scripts/bench");
        return;
    }
    let random = random::Options::read(&arguments).unwrap_or_else(|problem| {
        eprintln!("bench: {problem}");
        exit(1);
    });
    if let Some(options) = random {
        return random::search(&options);
    }
    let families = families::all();
    let (quick, only) = read(&arguments, &families).unwrap_or_else(|problem| {
        eprintln!("bench: {problem}");
        exit(1);
    });
    let ways = if quick { &WAYS[..2] } else { &WAYS[..] };
    let machine = report::machine(quick);
    let (mut sections, mut blocks) = (Vec::new(), Vec::new());
    for family in families.iter().filter(|family| only.is_empty() || only.iter().any(|name| name == family.name)) {
        let (section, block) = measure(family, ways, quick);
        println!("{section}");
        sections.push(section);
        blocks.push(block);
    }
    sections.insert(0, summary(&blocks));
    println!("{}", sections[0]);
    if only.is_empty() {
        report::publish(
            "benchmarks/stability.md",
            "benchmarks",
            &machine,
            &sections,
            &[("stability.svg", map::draw(&blocks))],
        );
    }
}

/// Whether the run is a quick one, and the families that are wanted; empty: all.
fn read(arguments: &[String], families: &[Family]) -> Result<(bool, Vec<String>), String> {
    let (mut quick, mut only) = (false, Vec::new());
    let mut rest = arguments.iter();
    while let Some(argument) = rest.next() {
        match argument.as_str() {
            "--quick" => quick = true,
            "--only" => match rest.next() {
                Some(name) if families.iter().any(|family| family.name == name) => only.push(name.clone()),
                _ => {
                    let names: Vec<_> = families.iter().map(|family| family.name).collect();
                    return Err(format!("--only needs one of {}", names.join(", ")));
                }
            },
            CARGO_BENCH => (),
            _ => return Err(format!("{argument} is not known; expected --quick or --only FAMILY")),
        }
    }
    Ok((quick, only))
}

fn measure(family: &Family, ways: &[&'static str], quick: bool) -> (Section, Block) {
    let values = if quick && family.is_long() { &[20.0] } else { family.values };
    let most = Duration::from_secs(match (quick, family.is_long()) {
        (true, _) => 5,
        (false, false) => 30,
        (false, true) => 300,
    });
    let wanted = |way: &str| !family.is_long() || WAYS[..2].contains(&way);
    let mut rows: Vec<Vec<String>> = values.iter().map(|&value| vec![family.label(value)]).collect();
    let mut block = Block { title: family.title, rows: Vec::new() };
    let mut message = None;
    for &way in ways {
        let mut verdicts = Vec::new();
        for (row, &value) in rows.iter_mut().zip(values) {
            if !wanted(way) {
                row.push(String::new());
                continue;
            }
            let outcome = trial::run(family.name, (family.make)(value), physics(way), most);
            row.push(cell(family, &outcome));
            verdicts.push((family.label(value), outcome.verdict));
            message = message.or(outcome.message.map(|text| format!("{way}, {}: “{text}”.", family.label(value))));
        }
        if !verdicts.is_empty() {
            block.rows.push((way, verdicts));
        }
    }
    let header: &[&str] = match ways.len() {
        2 => &["difficulty", WAYS[0], WAYS[1]],
        _ => &["difficulty", WAYS[0], WAYS[1], WAYS[2], WAYS[3]],
    };
    let mut remarks = vec![format!("Difficulty: {}.", family.difficulty)];
    remarks.extend(message.map(|text| format!("First state that was lost: {text}")));
    (Section { title: family.title, intro: family.words, header, rows, remarks }, block)
}

/// Verdict and what was seen, each with three digits at most.
fn cell(family: &Family, outcome: &Outcome) -> String {
    let seen = &outcome.seen;
    let mut parts = vec![format!("**{}**", outcome.verdict.name())];
    let mut add = |name: &str, value: f64| {
        if value.is_finite() {
            parts.push(format!("{name} {}", short(value)));
        }
    };
    add("energy ×", seen.energy);
    add("gap", seen.gap);
    add("depth", seen.depth);
    add(family.stray, seen.stray);
    parts.join("; ")
}

fn short(value: f64) -> String {
    match value.abs() {
        0.0 => "0".into(),
        size if (0.01..1e3).contains(&size) => format!("{value:.2}"),
        _ => format!("{value:.0e}"),
    }
}

/// How many cells of each verdict.
fn summary(blocks: &[Block]) -> Section {
    let mut rows: Vec<Vec<String>> = Vec::new();
    for way in WAYS {
        let cells: Vec<Verdict> = (blocks.iter().flat_map(|block| &block.rows))
            .filter(|row| row.0 == way)
            .flat_map(|row| row.1.iter().map(|cell| cell.1))
            .collect();
        let count = |verdict| cells.iter().filter(|&&cell| cell == verdict).count().to_string();
        if !cells.is_empty() {
            let all = [Verdict::Good, Verdict::Poor, Verdict::Exploded, Verdict::NotFinite, Verdict::Slow].map(count);
            rows.push(std::iter::once(way.to_owned()).chain(all).collect());
        }
    }
    Section {
        title: "All scenes",
        intro: "Number of scenes that ended so.",
        header: &["way", "good", "poor", "exploded", "not finite", "too slow"],
        rows,
        remarks: vec!["![Verdicts by difficulty](stability.svg)".into()],
    }
}
