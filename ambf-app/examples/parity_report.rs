//! Writes `docs/parity.md` and `docs/parity.svg`; called by `scripts/parity`.

#[path = "../tests/parity_common/mod.rs"]
mod parity_common;

use std::fmt::Write as _;
use std::ops::RangeInclusive;
use std::path::Path;
use std::thread;

use parity_common::{
    apart_at_end, at_rest, bodies, cases, compare_bodies, compare_joints, joints, simulate, soft_distances, soft_nodes,
    Case, Quantity, Recording, Start, SHIFTS,
};

const TEXT: &str = include_str!("parity_report.md");

/// Differences that are drawn, as powers of ten.
const DECADES: RangeInclusive<i32> = -16..=0;

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
fn figure(all: &[Measured]) -> String {
    let (width, height, left, top) = (300.0, 260.0, 60.0, 40.0);
    let panels: Vec<_> = all.iter().filter(|one| one.is_chaotic()).collect();
    let full_width = left + panels.len() as f64 * (width + 30.0);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {full_width} {}\" font-family=\"sans-serif\" font-size=\"11\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        top + height + 60.0
    );
    let (low, high) = (f64::from(*DECADES.start()), f64::from(*DECADES.end()));
    for (number, one) in panels.into_iter().enumerate() {
        let x0 = left + number as f64 * (width + 30.0);
        let x = |step: u64| x0 + width * step as f64 / one.case.steps as f64;
        let y = |value: f64| top + height * (high - value.max(1e-300).log10().clamp(low, high)) / (high - low);
        let _ = writeln!(svg, "<text x=\"{x0}\" y=\"{}\" font-weight=\"bold\">{}</text>", top - 8.0, one.case.name);
        for decade in DECADES.step_by(4) {
            let at = y(10f64.powi(decade));
            let _ = writeln!(svg, "<path d=\"M{x0} {at:.1}h{width}\" stroke=\"#ddd\"/>");
            if number == 0 {
                let _ = writeln!(
                    svg,
                    "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">1e{decade} m</text>",
                    x0 - 6.0,
                    at + 4.0
                );
            }
        }
        for second in 0..=one.case.steps / 1000 {
            let (at, below) = (x(second * 1000), top + height + 16.0);
            let _ = writeln!(svg, "<text x=\"{at:.1}\" y=\"{below}\" text-anchor=\"middle\">{second} s</text>");
        }
        let mut line = |other: &parity_common::Bodies, style: &str| {
            let mut path = String::new();
            for &step in &one.steps {
                let apart = compare_bodies(&one.ours.bodies, other, Quantity::Position, step..=step).difference;
                let mark = if path.is_empty() { 'M' } else { 'L' };
                let _ = write!(path, "{mark}{:.1} {:.1}", x(step), y(apart));
            }
            let _ = writeln!(svg, "<path d=\"{path}\" fill=\"none\" {style}/>");
        };
        one.shifted.iter().for_each(|run| line(&run.bodies, "stroke=\"#4a90c2\" stroke-width=\"0.7\""));
        line(&bodies(&one.case), "stroke=\"#c0392b\" stroke-width=\"1.8\"");
    }
    let y = top + height + 40.0;
    let _ = writeln!(
        svg,
        "<path d=\"M{left} {y}h24\" stroke=\"#c0392b\" stroke-width=\"1.8\"/><text x=\"{}\" y=\"{}\">our run and the trace</text>\n\
         <path d=\"M{} {y}h24\" stroke=\"#4a90c2\" stroke-width=\"0.7\"/><text x=\"{}\" y=\"{}\">our run and the same with a start \
         shifted by at most 1e-12 m</text>\n</svg>",
        left + 30.0,
        y + 4.0,
        left + 200.0,
        left + 230.0,
        y + 4.0,
    );
    svg
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
    for (name, contents) in [("parity.md", text), ("parity.svg", figure(&all))] {
        let path = docs.join(name);
        if let Err(error) = std::fs::write(&path, contents) {
            eprintln!("{}: {error}", path.display());
            std::process::exit(1);
        }
    }
}
