//! Cost of the simulator: `scripts/bench [--quick] [--only GROUP]…`
//!
//! Groups: `step`, `skip`, `start`, `rate`, `overload`, `real-time`. With `--only` the tables are printed and nothing
//! is written; else they go into `docs/benchmarks.md`, between its markers, with their figures.

mod lanes;
mod live;
mod observed;
mod scenes;
mod step;
mod watch;

use ambf_bench::plot::Figure;
use ambf_bench::{plot, report, statistics};
use ambf_test_support::ros as ros_common;
use std::process::exit;
use std::time::Duration;

use lanes::Effort;
use report::Section;

/// What `cargo bench` adds to the arguments of every benchmark.
const CARGO_BENCH: &str = "--bench";

const GROUPS: [&str; 6] = ["step", "skip", "start", "rate", "overload", "real-time"];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.first().is_some_and(|first| first == lanes::WORKER) {
        return lanes::work(&arguments[1..]);
    }
    // `cargo test --all-targets` starts it too, without this word.
    if !arguments.iter().any(|argument| argument == CARGO_BENCH) {
        println!("nothing is measured: this is started by `cargo bench` or scripts/bench");
        return;
    }
    let (quick, only) = match read(&arguments) {
        Ok(wanted) => wanted,
        Err(problem) => {
            eprintln!("bench: {problem}");
            exit(1);
        }
    };
    let machine = report::machine(quick);
    println!("{machine}\n");
    let (mut sections, mut figures) = (Vec::new(), Vec::new());
    for group in GROUPS.into_iter().filter(|group| only.is_empty() || only.iter().any(|name| name == group)) {
        let (section, figure) = run(group, quick);
        println!("{section}");
        sections.push(section);
        figures.extend(figure);
    }
    if only.is_empty() {
        report::publish("benchmarks.md", "figures", &machine, &sections, &figures);
    }
}

/// Whether the run is a quick one, and the groups that are wanted; empty: all.
fn read(arguments: &[String]) -> Result<(bool, Vec<String>), String> {
    let (mut quick, mut only) = (false, Vec::new());
    let mut rest = arguments.iter();
    while let Some(argument) = rest.next() {
        match argument.as_str() {
            "--quick" => quick = true,
            "--only" => match rest.next() {
                Some(group) if GROUPS.contains(&group.as_str()) => only.push(group.clone()),
                _ => return Err(format!("--only needs one of {}", GROUPS.join(", "))),
            },
            CARGO_BENCH => (),
            _ => return Err(format!("{argument} is not known; expected --quick or --only GROUP")),
        }
    }
    Ok((quick, only))
}

fn run(group: &str, quick: bool) -> (Section, Option<(&'static str, Figure)>) {
    let effort = if quick {
        Effort { slice: Duration::from_millis(100), rounds: 5 }
    } else {
        Effort { slice: Duration::from_millis(250), rounds: 7 }
    };
    let seconds = |full, short| Duration::from_secs(if quick { short } else { full });
    match group {
        "step" => {
            let (section, figure) = step::step(effort, quick);
            (section, Some(("step-cost.svg", figure)))
        }
        "skip" => (step::skip(effort), None),
        "start" => {
            let (section, figure) = watch::start_up(if quick { 1 } else { 3 }, quick);
            (section, Some(("memory.svg", figure)))
        }
        "rate" => (watch::rates(seconds(10, 2)), None),
        "overload" => (watch::overload(seconds(10, 3)), None),
        _ => (watch::real_time(seconds(60, 10), quick), None),
    }
}
