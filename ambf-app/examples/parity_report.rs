//! Writes `docs/parity.md` and `docs/parity.svg`; called by `scripts/parity`.

#[path = "../tests/parity_common/mod.rs"]
mod parity_common;

use std::fmt::Write as _;
use std::ops::RangeInclusive;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;

use parity_common::{
    apart_at_end, at_rest, bodies, cases, compare_bodies, compare_joints, joints, simulate, soft_distances, soft_nodes,
    Case, Quantity, Recording, Start, SHIFTS,
};
use serde_json::{json, Value};

const TEXT: &str = include_str!("parity_report.md");

/// A trace and our runs of its scene.
struct Measured {
    case: Case,
    /// Recorded steps.
    steps: Vec<u64>,
    ours: Recording,
    shifted: Vec<Recording>,
    cold: Recording,
}

fn measure(case: &Case) -> Measured {
    let steps: Vec<_> = bodies(case).rows.iter().map(|row| row.0).collect();
    let run = |start| simulate(case, &steps, start);
    Measured {
        ours: run(Start::AsWritten),
        shifted: SHIFTS.iter().map(|&shift| run(Start::Shifted(shift))).collect(),
        cold: run(Start::ColdFriction),
        case: case.clone(),
        steps,
    }
}

impl Measured {
    /// Largest difference of a quantity from the trace.
    fn distance_from_trace(&self, run: &Recording, quantity: Quantity, range: RangeInclusive<u64>) -> Option<f64> {
        use Quantity::{JointEffort, JointPosition, JointVelocity};
        if !matches!(quantity, JointPosition | JointVelocity | JointEffort) {
            return Some(compare_bodies(&run.bodies, &bodies(&self.case), quantity, range).difference);
        }
        let theirs = joints(&self.case);
        (!theirs.names.is_empty()).then(|| compare_joints(&run.joints, &theirs, quantity, range).difference)
    }

    /// Largest difference of positions between our run and one with a shifted start.
    fn spread(&self, range: &RangeInclusive<u64>) -> f64 {
        let apart = |run: &Recording| {
            compare_bodies(&self.ours.bodies, &run.bodies, Quantity::Position, range.clone()).difference
        };
        self.shifted.iter().map(apart).fold(0.0, f64::max)
    }

    fn whole(&self) -> RangeInclusive<u64> {
        0..=self.case.steps
    }

    fn is_chaotic(&self) -> bool {
        self.distance_from_trace(&self.ours, Quantity::Position, self.whole()) > Some(1e-5)
    }
}

/// Two digits; nothing below 1e-12, where only the number of printed digits of the traces is left.
fn short(value: Option<f64>) -> String {
    match value {
        None => "–".into(),
        Some(value) if value < 1e-12 => "< 1e-12".into(),
        Some(value) => format!("{value:.1e}"),
    }
}

fn differences(all: &[Measured], range: impl Fn(&Measured) -> RangeInclusive<u64>) -> String {
    use Quantity::{Angular, JointPosition, JointVelocity, Linear, Position, Rotation};
    let mut table = String::from(
        "| trace | position, m | rotation, rad | velocity, m/s | angular velocity, rad/s | joint position, rad or m | joint velocity, \
         rad/s or m/s |\n|---|---|---|---|---|---|---|\n",
    );
    for one in all {
        let quantities = [Position, Rotation, Linear, Angular, JointPosition, JointVelocity];
        let cells = quantities.map(|quantity| short(one.distance_from_trace(&one.ours, quantity, range(one))));
        let _ = writeln!(table, "| {} | {} |", one.case.name, cells.join(" | "));
    }
    table
}

fn rest(all: &[Measured]) -> String {
    let mut table = String::from(
        "| trace | bodies at rest | largest distance, m | body | the same body in runs with a shifted start, m |\n|---|---|---|---|---|\n",
    );
    for one in all {
        let theirs = bodies(&one.case);
        let names = at_rest(&theirs);
        let apart = names.iter().map(|name| (apart_at_end(&one.ours.bodies, &theirs, name), *name));
        let Some((distance, name)) = apart.max_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
        let spread =
            one.shifted.iter().map(|run| apart_at_end(&one.ours.bodies, &run.bodies, name)).fold(0.0, f64::max);
        let (count, name) = (names.len(), if distance < 1e-12 { "–" } else { name });
        let _ = writeln!(
            table,
            "| {} | {count} | {} | {name} | {} |",
            one.case.name,
            short(Some(distance)),
            short(Some(spread))
        );
    }
    table
}

fn chaos(all: &[Measured]) -> String {
    let mut table = String::from(
        "| trace | first contact, step | 100 steps later, trace | 100 steps later, shifted | whole run, trace | whole run, shifted |\n\
         |---|---|---|---|---|---|\n",
    );
    for one in all {
        let Some(touch) = one.ours.first_contact else { continue };
        let early = 0..=touch + 100;
        let trace = |range| short(one.distance_from_trace(&one.ours, Quantity::Position, range));
        let _ = writeln!(
            table,
            "| {} | {touch} | {} | {} | {} | {} |",
            one.case.name,
            trace(early.clone()),
            short(Some(one.spread(&early))),
            trace(one.whole()),
            short(Some(one.spread(&one.whole()))),
        );
    }
    table
}

fn friction(all: &[Measured]) -> String {
    let mut table = String::from(
        "| trace | warm friction, 100 steps after the first contact, m | cold friction, m | warm, whole run, m | cold, m |\n|---|---|---|---|---|\n",
    );
    for one in all {
        let Some(touch) = one.ours.first_contact else { continue };
        let cell = |run, range| short(one.distance_from_trace(run, Quantity::Position, range));
        let early = 0..=touch + 100;
        let _ = writeln!(
            table,
            "| {} | {} | {} | {} | {} |",
            one.case.name,
            cell(&one.ours, early.clone()),
            cell(&one.cold, early),
            cell(&one.ours, one.whole()),
            cell(&one.cold, one.whole()),
        );
    }
    table
}

fn soft_bodies(cases: &[Case]) -> String {
    let mut table = String::from(
        "| trace | recorded nodes | first 100 steps, m | first 500, m | whole run, m |\n|---|---|---|---|---|\n",
    );
    for case in cases {
        let nodes = soft_nodes(case).iter().filter(|(step, ..)| *step == 0).count();
        let distances = soft_distances(case);
        let until = |last: u64| {
            let early = distances.iter().filter(|(step, _)| *step <= last);
            short(Some(early.map(|(_, distance)| *distance).fold(0.0, f64::max)))
        };
        let _ = writeln!(table, "| {} | {nodes} | {} | {} | {} |", case.name, until(100), until(500), until(u64::MAX));
    }
    table
}

/// One panel a chaotic scene: distance from our run against time, on a logarithmic scale.
fn figure(all: &[Measured]) -> Value {
    let panel = |one: &Measured| {
        let line = |other: &parity_common::Bodies, name: &str, colour: &str, width: f64| {
            let points: Vec<_> = one
                .steps
                .iter()
                .map(|&step| {
                    let apart = compare_bodies(&one.ours.bodies, other, Quantity::Position, step..=step).difference;
                    (step as f64 * 1e-3, apart)
                })
                .collect();
            json!({"name": name, "colour": colour, "width": width, "points": points})
        };
        let shifted = "our run and the same with a start shifted by at most 1e-12 m";
        let mut lines: Vec<_> = one.shifted.iter().map(|run| line(&run.bodies, shifted, "#4a90c2", 0.7)).collect();
        lines.push(line(&bodies(&one.case), "our run and the trace", "#c0392b", 1.8));
        json!({"title": one.case.name, "lines": lines})
    };
    let panels: Vec<_> = all.iter().filter(|one| one.is_chaotic()).map(panel).collect();
    json!({"kind": "panels", "title": "Scenes that amplify rounding errors", "y": "distance of bodies, m",
        "y range": [1e-16, 10.0], "panels": panels})
}

fn main() {
    if ambf_test_support::shared().is_none() {
        eprintln!("no traces of legacy scenes in ../shared: the page would lose their rows");
        std::process::exit(1);
    }
    let (soft, rigid): (Vec<_>, Vec<_>) = cases().into_iter().partition(Case::is_soft);
    let all: Vec<Measured> = thread::scope(|scope| {
        let threads: Vec<_> = rigid.iter().map(|case| scope.spawn(|| measure(case))).collect();
        threads.into_iter().map(|thread| thread.join().expect("measured")).collect()
    });
    let efforts = all.iter().filter_map(|one| one.distance_from_trace(&one.ours, Quantity::JointEffort, one.whole()));
    let effort = efforts.fold(0.0, f64::max);
    let text = TEXT
        .replace("{free}", &all.iter().filter(|one| one.ours.first_contact.is_none()).count().to_string())
        .replace("{count}", &all.len().to_string())
        .replace("{first}", &differences(&all, |_| 0..=100))
        .replace("{whole}", &differences(&all, Measured::whole))
        .replace("{rest}", &rest(&all))
        .replace("{chaos}", &chaos(&all))
        .replace("{effort}", &format!("{effort:.0e}"))
        .replace("{friction}", &friction(&all))
        .replace("{soft}", &soft_bodies(&soft));
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    let drawn = std::fs::write(docs.join("parity.md"), text).and_then(|()| draw(&docs, &figure(&all)));
    if let Err(error) = drawn {
        eprintln!("{}: {error}", docs.display());
        std::process::exit(1);
    }
}

/// Has the figure drawn by `scripts/plot`.
fn draw(docs: &Path, figure: &Value) -> std::io::Result<()> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scripts/plot");
    let mut child = Command::new(script).arg(docs).stdin(Stdio::piped()).spawn()?;
    serde_json::to_writer(child.stdin.take().expect("it is piped"), &json!({"parity.svg": figure}))?;
    child.wait()?.success().then_some(()).ok_or_else(|| std::io::Error::other("scripts/plot failed"))
}
