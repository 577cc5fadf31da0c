//! Lanes against each other: errors at equal cost, tables, figures, goals.

use std::cmp::Ordering;

use super::case::{Case, Family, USUAL};
use super::lanes::{Lane, Point};
use super::own::{ACCURATE, LEGACY};
use super::plot::{log_lines, Figure, Line};
use super::report::{goal, Section};
use super::statistics::short;

/// What was found for a case.
pub struct Found {
    pub case: Case,
    pub lanes: Vec<Lane>,
}

impl Found {
    fn lane(&self, name: &str) -> Option<&Lane> {
        self.lanes.iter().find(|lane| lane.name == name)
    }

    /// What a lane gave at 1 ms.
    fn usual(&self, name: &str) -> Option<&Point> {
        self.lane(name)?.at(USUAL)
    }

    /// Lanes whose names begin so.
    fn named<'a>(&'a self, start: &'a str) -> impl Iterator<Item = &'a Lane> {
        self.lanes.iter().filter(move |lane| lane.name.starts_with(start))
    }

    /// The accurate profile's error over that of `other` at 1 ms, at the cost of the latter.
    fn ratio(&self, other: &Lane) -> Option<Ratio> {
        let theirs = other.at(USUAL)?;
        let ours = error_at(self.lane(ACCURATE)?, theirs.cost.median);
        Some(match ours {
            None => Ratio::Dearer,
            Some(ours) if ours.is_infinite() && theirs.error.is_infinite() => Ratio::Neither,
            Some(ours) => Ratio::Of(if theirs.error.is_infinite() { 0.0 } else { ours / theirs.error }),
        })
    }

    /// The worst ratio to any of the lanes whose names begin so.
    fn worst(&self, start: &str) -> Option<Ratio> {
        self.named(start).filter_map(|lane| self.ratio(lane)).max_by(Ratio::compare)
    }
}

/// How the accurate profile compares at equal cost.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Ratio {
    /// Error over error: 0 if only the other fails, infinite if only the accurate profile does.
    Of(f64),
    /// Both fail.
    Neither,
    /// The accurate profile cannot be as cheap.
    Dearer,
}

impl Ratio {
    fn rank(&self) -> f64 {
        match *self {
            Self::Of(ratio) => ratio,
            Self::Neither => 1.0,
            Self::Dearer => f64::INFINITY,
        }
    }

    fn compare(&self, other: &Self) -> Ordering {
        self.rank().total_cmp(&other.rank())
    }

    fn cell(&self) -> String {
        match *self {
            Self::Of(0.0) => "only ours works".into(),
            Self::Of(ratio) if ratio.is_infinite() => "only theirs works".into(),
            Self::Of(ratio) => number(ratio),
            Self::Neither => "both fail".into(),
            Self::Dearer => "never as cheap".into(),
        }
    }
}

/// The smallest error that a lane reaches for at most `cost` µs a simulated ms, between its points by a straight line
/// over logarithms; `None` when it is never that cheap.
pub fn error_at(lane: &Lane, cost: f64) -> Option<f64> {
    let mut points: Vec<(f64, f64)> = lane.points.iter().map(|point| (point.cost.median, point.error)).collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Timings of the same work differ a little.
    let affordable = points.iter().take_while(|point| point.0 <= cost * 1.03).count();
    let (&(below, error), rest) = (points.get(affordable.checked_sub(1)?)?, &points[affordable..]);
    let best = points[..affordable].iter().map(|point| point.1).fold(f64::INFINITY, f64::min);
    let between = rest.first().filter(|next| next.1 > 0.0 && next.1.is_finite() && error > 0.0 && error.is_finite());
    let between = between.map_or(best, |&(above, next)| {
        let share = ((cost / below).ln() / (above / below).ln()).max(0.0);
        (error.ln() + share * (next.ln() - error.ln())).exp()
    });
    Some(best.min(between))
}

/// Three digits, small and large ones with an exponent.
fn number(value: f64) -> String {
    if value.is_infinite() {
        "fails".into()
    } else if value == 0.0 || (0.01..1000.0).contains(&value) {
        short(value)
    } else {
        format!("{value:.1e}")
    }
}

fn error_cell(point: Option<&Point>) -> String {
    point.map_or_else(|| "–".into(), |point| number(point.error))
}

/// All lanes of a case.
pub fn section(found: &Found) -> Section {
    let budget = found.usual(ACCURATE).map(|point| point.cost.median);
    let row = |lane: &Lane| {
        let usual = lane.at(USUAL);
        let largest =
            lane.points.iter().filter(|point| point.error.is_finite()).map(|point| point.step).fold(0.0, f64::max);
        let equal = budget.and_then(|budget| error_at(lane, budget));
        vec![
            lane.problem.as_ref().map_or_else(|| lane.name.clone(), |problem| format!("{} ({problem})", lane.name)),
            error_cell(lane.at(4.0 * USUAL)),
            error_cell(usual),
            error_cell(lane.at(USUAL / 4.0)),
            usual.map_or_else(|| "–".into(), |point| point.cost.to_string()),
            if largest > 0.0 { (largest * 1e3).to_string() } else { "none".into() },
            equal.map_or_else(|| "–".into(), number),
        ]
    };
    Section {
        title: found.case.title,
        intro: found.case.words,
        header: &[
            "setting",
            "error at 4 ms",
            "at 1 ms",
            "at 0.25 ms",
            "µs a step of 1 ms",
            "largest step, ms",
            "error for the cost of `accurate` at 1 ms",
        ],
        rows: found.lanes.iter().map(row).collect(),
        remarks: vec![format!("![{}](accuracy-{}.svg)", found.case.title, found.case.name)],
    }
}

/// Error against cost of all lanes of a case.
pub fn figure(found: &Found) -> Figure {
    // Below this nothing but rounding is compared.
    let points = |lane: &Lane| lane.points.iter().map(|point| (point.cost.median, point.error.max(1e-15))).collect();
    let lines: Vec<Line> = found.lanes.iter().map(|lane| Line { name: &lane.name, points: points(lane) }).collect();
    let ticks: Vec<f64> = (-3..6).flat_map(|decade| [1.0, 3.0].map(|x| x * 10f64.powi(decade))).collect();
    let error = format!("error, {}", found.case.unit);
    log_lines(found.case.title, "µs of CPU time a simulated ms", &error, &ticks, &lines)
}

/// The overview: a row a case, then the goals.
pub fn summary(all: &[Found]) -> Section {
    let cell = |found: &Found, name: &str| match found.usual(name) {
        Some(point) => format!("{} ({})", number(point.error), short(point.cost.median)),
        None => "–".into(),
    };
    let best = |found: &Found, start: &str| {
        let points = found.named(start).filter_map(|lane| Some((lane, lane.at(USUAL)?)));
        let best = points.min_by(|a, b| a.1.error.total_cmp(&b.1.error));
        best.map_or_else(|| "–".into(), |(lane, _)| cell(found, &lane.name))
    };
    let ratio = |found: &Found, start: &str| found.worst(start).map_or_else(|| "–".into(), |ratio| ratio.cell());
    let row = |found: &Found| {
        vec![
            found.case.title.to_owned(),
            found.case.unit.to_owned(),
            cell(found, LEGACY),
            cell(found, ACCURATE),
            best(found, "pybullet"),
            best(found, "MuJoCo"),
            ratio(found, LEGACY),
            ratio(found, "pybullet"),
            ratio(found, "MuJoCo"),
        ]
    };
    Section {
        title: "Overview",
        intro: "Error at a step of 1 ms (µs a step); of several settings of another simulator the best. Then the accurate profile's error at \
                the cost that the other has at 1 ms, over the other's error; of several settings the worst for us. Below 1 we win.",
        header: &[
            "case",
            "error in",
            "legacy",
            "accurate",
            "pybullet",
            "MuJoCo",
            "accurate/legacy at equal cost",
            "accurate/pybullet",
            "accurate/MuJoCo",
        ],
        rows: all.iter().map(row).collect(),
        remarks: goals(all),
    }
}

/// A goal for every case that `applies`: that the worst ratio to lanes that begin with `start` is at most `most`.
fn ratio_goal(all: &[Found], words: &str, start: &str, most: f64, applies: impl Fn(&Found) -> bool) -> Option<String> {
    let ratios: Vec<(&Found, Ratio)> =
        all.iter().filter(|found| applies(found)).filter_map(|found| Some((found, found.worst(start)?))).collect();
    let missed: Vec<String> = ratios
        .iter()
        .filter(|(_, ratio)| ratio.rank() > most)
        .map(|(found, ratio)| format!("{} {}", found.case.name, ratio.cell()))
        .collect();
    let reached = format!("reached in {} of {} cases", ratios.len() - missed.len(), ratios.len());
    let told = if missed.is_empty() { reached } else { format!("{reached}; not in {}", missed.join(", ")) };
    (!ratios.is_empty()).then(|| goal(words, missed.is_empty(), &told))
}

fn goals(all: &[Found]) -> Vec<String> {
    let is = |found: &Found, families: &[Family]| families.contains(&found.case.family);
    let find = |name: &str| all.iter().find(|found| found.case.name == name);
    let mut goals: Vec<Option<String>> = vec![
        ratio_goal(
            all,
            "at equal cost at most a tenth of the error of `legacy` in jointed cases",
            LEGACY,
            0.1,
            |found| is(found, &[Family::Tree, Family::Loop]),
        ),
        ratio_goal(all, "at equal cost at most pybullet's error", "pybullet", 1.0, |_| true),
        ratio_goal(all, "on trees within 10 times of MuJoCo's RK4", "MuJoCo RK4", 10.0, |found| {
            is(found, &[Family::Tree])
        }),
    ];
    let mut at_most = |name: &str, words: &str, most: f64| {
        goals.push(
            find(name)
                .and_then(|found| found.usual(ACCURATE))
                .map(|point| goal(&format!("{words} at 1 ms"), point.error <= most, &number(point.error))),
        );
    };
    at_most("bounce", "a bounce with e = 1 keeps 99.5 % of its energy ten times", 0.005);
    at_most("slide", "a sliding box within 1e-4", 1e-4);
    at_most("slide-oblique", "also across the friction axes within 1e-4", 1e-4);
    let mut stands = |name: &str, words: &str, other: &str, share: f64| {
        let Some(found) = find(name) else { return };
        let (Some(ours), Some(theirs)) = (found.usual(ACCURATE), found.usual(other)) else { return };
        let most = theirs.cost.median * share;
        let met = ours.error.is_finite() && ours.cost.median <= most;
        let state = if ours.error.is_finite() { "stands" } else { "falls" };
        let told = format!("{state} at {} µs, allowed {} µs", short(ours.cost.median), short(most));
        goals.push(Some(goal(words, met, &told)));
    };
    stands("stack2-heavy", "two cubes 1:1000 stand at the cost of Dantzig", "Dantzig", 1.0);
    stands("stack5-heavy", "five cubes 1:1000 stand at a tenth of the cost of 1000 iterations", "SI 1000", 0.1);
    goals.push(find("arm7").and_then(|found| found.lane(ACCURATE)).map(|lane| {
        let largest = lane.points.iter().filter(|point| point.error.is_finite()).map(|point| point.step);
        let largest = largest.fold(0.0, f64::max) * 1e3;
        goal("the arm is stable at 16 ms", largest >= 16.0, &format!("{largest} ms"))
    }));
    goals.into_iter().flatten().collect()
}

/// All points as comma-separated values.
pub fn csv(all: &[Found]) -> String {
    let mut text = String::from("case,setting,step_s,cost_us_per_ms,cost_p10,cost_p90,error,unit\n");
    for found in all {
        for lane in &found.lanes {
            for Point { step, cost, error } in &lane.points {
                let (name, unit) = (found.case.name, found.case.unit);
                // A comma in a name would be another column.
                let setting = lane.name.replace(',', "");
                text += &format!(
                    "{name},{setting},{step},{:.4},{:.4},{:.4},{error:e},{unit}\n",
                    cost.median, cost.low, cost.high
                );
            }
        }
    }
    text
}
