//! How well controllers follow, at every step and outer rate: `scripts/bench control [--only arm|rates]`
//!
//! Without `--only` the tables go into `docs/benchmarks/control.md`, between its markers, with a figure each. Errors
//! only: the same on every computer.

mod arm;
mod rates;

use ambf_bench::plot::Figure;
use ambf_bench::{case, jointed, own, plot, report};
use std::process::exit;

use report::Section;

/// What `cargo bench` adds to the arguments of every benchmark.
const CARGO_BENCH: &str = "--bench";

/// A part of the benchmark: its name, and what gives its section and figure.
type Part = (&'static str, fn() -> (Section, Figure));

const PARTS: [Part; 2] = [("arm", arm::measure), ("rates", rates::measure)];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    // `cargo test --all-targets` starts it too, without this word.
    if !arguments.iter().any(|argument| argument == CARGO_BENCH) {
        println!("nothing is measured: this is started by `cargo bench` or scripts/bench");
        return;
    }
    let words: Vec<&str> = arguments.iter().map(String::as_str).filter(|word| *word != CARGO_BENCH).collect();
    let wanted: Vec<Part> = match words[..] {
        [] => PARTS.to_vec(),
        ["--only", name] if PARTS.iter().any(|part| part.0 == name) => {
            PARTS.into_iter().filter(|part| part.0 == name).collect()
        }
        _ => {
            eprintln!("bench: usage: scripts/bench control [--only arm|rates]");
            exit(1);
        }
    };
    let mut results = Vec::new();
    for (name, measure) in &wanted {
        let (section, figure) = measure();
        println!("{section}");
        results.push((section, (format!("control-{name}.svg"), figure)));
    }
    if wanted.len() == PARTS.len() {
        let (sections, figures): (Vec<_>, Vec<_>) = results.into_iter().unzip();
        report::publish("benchmarks/control.md", "figures", "any; nothing here is a time.", &sections, &figures);
    }
}

/// An error, or that there is none to speak of.
fn number(error: f64) -> String {
    if error.is_finite() {
        format!("{error:.1e}")
    } else {
        "!".into()
    }
}
