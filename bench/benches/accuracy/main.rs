//! Run time against error: `scripts/bench accuracy [--quick] [--only CASE]… [--no-peers]`
//!
//! With `--only` tables are printed and nothing is written; else they go into `docs/benchmarks/accuracy.md`, between
//! its markers, with a figure for each case, and into `docs/benchmarks/accuracy.csv`.

mod compare;
mod contact;
mod growth;
mod lanes;
mod peers;
mod rays;

use ambf_bench::{case, jointed, own, plot, reference, report, statistics, system};
use std::process::exit;
use std::time::Duration;

use case::Case;
use compare::Found;
use lanes::Effort;
use peers::Peers;

/// What `cargo bench` adds to the arguments of every benchmark.
const CARGO_BENCH: &str = "--bench";

/// Name of a case and how it is made, which takes a moment where there is a reference to integrate.
type Entry = (&'static str, fn() -> Case);

const CASES: [Entry; 24] = [
    ("free-rotation", jointed::free_rotating),
    ("free-flight", jointed::free_flying),
    ("pendulum", jointed::pendulum),
    ("double-pendulum", jointed::double_pendulum),
    ("chain10", jointed::chain10),
    ("chain10-heavy", jointed::heavy_chain),
    ("four-bar", jointed::crank_rocker),
    ("window1", jointed::window1),
    ("window10", jointed::window10),
    ("window40", jointed::window40),
    ("bricard", jointed::bricard),
    ("governor", jointed::governor),
    ("arm7", jointed::arm),
    ("bounce", contact::bounce),
    ("bounce-half", contact::bounce_half),
    ("stick", contact::stick),
    ("slide", contact::slide),
    ("slide-oblique", contact::slide_oblique),
    ("roll", contact::roll),
    ("stack10", contact::stack10),
    ("stack2-heavy", contact::stack2),
    ("stack5-heavy", contact::stack5),
    ("spheres", contact::spheres),
    ("spheres-elastic", contact::elastic_spheres),
];

/// The case that has costs only.
const GROWTH: &str = "growth";

/// The case that steps nothing.
const RAYS: &str = "rays";

#[derive(Default)]
struct Wanted {
    quick: bool,
    no_peers: bool,
    /// Empty: all.
    only: Vec<String>,
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    // `cargo test --all-targets` starts it too, without this word.
    if !arguments.iter().any(|argument| argument == CARGO_BENCH) {
        println!("nothing is measured: this is started by `cargo bench` or scripts/bench");
        return;
    }
    let wanted = read(&arguments).unwrap_or_else(|problem| {
        eprintln!("bench: {problem}");
        exit(1);
    });
    let effort = if wanted.quick {
        Effort { rounds: 1, most: Duration::from_millis(60) }
    } else {
        Effort { rounds: 5, most: Duration::from_secs(1) }
    };
    let mut peers = match Peers::start() {
        _ if wanted.no_peers => None,
        Ok(peers) => Some(peers),
        Err(problem) => {
            eprintln!("bench: no other simulators: {problem}");
            None
        }
    };
    let mut machine = report::machine(wanted.quick);
    if let Some(peers) = &peers {
        machine += &format!(" Others: {}.", peers.versions());
    }
    println!("{machine}\n");
    let (mut found, mut sections, mut figures) = (Vec::new(), Vec::new(), Vec::new());
    for (_, make) in CASES.iter().filter(|(name, _)| wanted.wants(name)) {
        let case = make();
        let lanes = lanes::measure(&case, &mut peers, effort);
        let case = Found { case, lanes };
        let section = compare::section(&case);
        println!("{section}");
        sections.push(section);
        figures.push((format!("accuracy-{}.svg", case.case.name), compare::figure(&case)));
        found.push(case);
    }
    if wanted.wants(GROWTH) {
        let (section, figure) = growth::measure(&mut peers, wanted.quick);
        println!("{section}");
        sections.push(section);
        figures.push(("accuracy-growth.svg".into(), figure));
    }
    if wanted.wants(RAYS) {
        let section = rays::measure(wanted.quick);
        println!("{section}");
        sections.push(section);
    }
    let summary = compare::summary(&found);
    if !found.is_empty() {
        println!("{summary}");
    }
    if wanted.only.is_empty() {
        sections.insert(0, summary);
        let csv = report::docs().join("benchmarks/accuracy.csv");
        std::fs::write(csv, compare::csv(&found)).expect("a table can be written");
        report::publish("benchmarks/accuracy.md", "benchmarks", &machine, &sections, &figures);
    }
}

impl Wanted {
    fn wants(&self, name: &str) -> bool {
        self.only.is_empty() || self.only.iter().any(|only| only == name)
    }
}

fn read(arguments: &[String]) -> Result<Wanted, String> {
    let mut wanted = Wanted::default();
    let mut rest = arguments.iter();
    while let Some(argument) = rest.next() {
        match argument.as_str() {
            "--quick" => wanted.quick = true,
            "--no-peers" => wanted.no_peers = true,
            "--only" => match rest.next() {
                Some(name)
                    if [GROWTH, RAYS].contains(&name.as_str()) || CASES.iter().any(|(known, _)| known == name) =>
                {
                    wanted.only.push(name.clone())
                }
                _ => {
                    let names = CASES.map(|(name, _)| name).join(", ");
                    return Err(format!("--only needs one of {names}, {GROWTH}, {RAYS}"));
                }
            },
            CARGO_BENCH => (),
            _ => return Err(format!("{argument} is not known; expected --quick, --only CASE or --no-peers")),
        }
    }
    Ok(wanted)
}
