//! How input devices run: `scripts/bench devices [--quick] [--only load|failure|error|clock|latency|pictures]`
//!
//! Without `--only` the tables go into `docs/benchmarks/devices.md`, between its markers, with their figures.

mod clock;
mod error;
mod fleet;
mod isolation;
mod latency;
mod load;
mod pictures;
mod rates;
mod rig;
mod traced;

use ambf_bench::plot::Figure;
use ambf_bench::{plot, report, statistics};
use ambf_test_support::ros as ros_common;
use std::process::exit;
use std::time::Duration;

use report::Section;

/// What `cargo bench` adds to the arguments of every benchmark.
const CARGO_BENCH: &str = "--bench";

/// How much is measured.
pub struct Effort {
    /// From the first valid samples until measuring begins.
    settle: Duration,
    /// How long rates are measured.
    stretch: Duration,
    /// How long the others are watched before a driver fails.
    before: Duration,
    block: Duration,
    block_words: &'static str,
    away: Duration,
    away_words: &'static str,
    /// Of each device and rate.
    readings: usize,
    /// Of the physics loop, Hz.
    rates: &'static [f64],
    /// How long simulated and wall time are compared.
    clock: Duration,
    arms: &'static [usize],
    jumps: usize,
}

const FULL: Effort = Effort {
    settle: Duration::from_secs(2),
    stretch: Duration::from_secs(15),
    before: Duration::from_secs(5),
    block: Duration::from_secs(5),
    block_words: "blocks for 5 s",
    away: Duration::from_secs(3),
    away_words: "loses it for 3 s",
    readings: 5000,
    rates: &[1000.0, 500.0, 200.0, 100.0, 60.0, 30.0, 10.0],
    clock: Duration::from_secs(10),
    arms: &[1, 2, 4],
    jumps: 200,
};

const QUICK: Effort = Effort {
    settle: Duration::from_millis(300),
    stretch: Duration::from_millis(1500),
    before: Duration::from_millis(600),
    block: Duration::from_secs(1),
    block_words: "blocks for 1 s",
    away: Duration::from_secs(1),
    away_words: "loses it for 1 s",
    readings: 500,
    rates: &[1000.0, 100.0, 10.0],
    clock: Duration::from_millis(1200),
    arms: &[1, 4],
    jumps: 12,
};

/// A part of the benchmark: its name, and what gives its section and figures.
type Part = (&'static str, fn(&Effort) -> (Section, Vec<(&'static str, Figure)>));

const PARTS: [Part; 6] = [
    ("load", load::measure),
    ("failure", isolation::measure),
    ("error", error::measure),
    ("clock", clock::measure),
    ("latency", latency::measure),
    ("pictures", pictures::measure),
];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    // `cargo test --all-targets` starts it too, without this word.
    if !arguments.iter().any(|argument| argument == CARGO_BENCH) {
        println!("nothing is measured: this is started by `cargo bench` or scripts/bench");
        return;
    }
    let mut words: Vec<&str> = arguments.iter().map(String::as_str).filter(|word| *word != CARGO_BENCH).collect();
    let quick = words.contains(&"--quick");
    words.retain(|word| *word != "--quick");
    let wanted: Vec<Part> = match words[..] {
        [] => PARTS.to_vec(),
        ["--only", name] if PARTS.iter().any(|part| part.0 == name) => {
            PARTS.into_iter().filter(|part| part.0 == name).collect()
        }
        _ => {
            eprintln!(
                "bench: usage: scripts/bench devices [--quick] [--only load|failure|error|clock|latency|pictures]"
            );
            exit(1);
        }
    };
    // Before any thread is there. To print where a panic came from takes longer than the watchdog, and users do not ask
    // for it.
    std::env::remove_var("RUST_BACKTRACE");
    ros_common::use_own_master();
    let machine = report::machine(quick);
    println!("{machine}\n");
    let effort = if quick { &QUICK } else { &FULL };
    let (mut sections, mut figures) = (Vec::new(), Vec::new());
    for (_, measure) in &wanted {
        let (section, drawn) = measure(effort);
        println!("{section}");
        sections.push(section);
        figures.extend(drawn);
    }
    if wanted.len() == PARTS.len() {
        report::publish("benchmarks/devices.md", "benchmarks", &machine, &sections, &figures);
    }
}
