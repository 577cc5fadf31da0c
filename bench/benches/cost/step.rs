//! What a step costs outside Bullet, and what the skips save.

use super::lanes::{measure, Effort, Lane, Mode};
use super::observed;
use super::plot::{log_lines, Figure, Line};
use super::report::{goal, Section};
use super::scenes::{self, Scene};
use super::statistics::{short, Spread};

const MODES: [Mode; 3] = [Mode::Update, Mode::Loop, Mode::Ros];

/// Boxes that are measured.
const BOXES: [usize; 5] = [1, 10, 50, 100, 200];

/// Highest cost outside Bullet of a small scene whose sensors cast no rays: µs, and µs more for each body.
const SMALL: (f64, f64) = (2.0, 0.05);

/// Cost of a step outside Bullet, without and with ROS; with a figure.
pub fn step(effort: Effort, quick: bool) -> (Section, Figure) {
    let boxes: Vec<Scene> = BOXES.iter().map(|&n| scenes::boxes(n)).collect();
    let quick_ones = |scene: &Scene| ["pendulum", "arm7"].contains(&scene.name.as_str());
    let own = scenes::own().into_iter().filter(|scene| !scene.name.starts_with("boxes"));
    let own = own.filter(|scene| !quick || quick_ones(scene));
    let original = scenes::original();
    let original = original.into_iter().filter(|_| !quick);
    let all: Vec<Scene> = boxes.iter().cloned().chain(own).chain(original).collect();

    let mut section = Section {
        title: "sim/step",
        intro: "µs for a step of 1 ms, as median (10th–90th percentile) of slices in which the ways to step take turns. *Update*: \
                the library alone; *loop*: the physics thread without ROS; *ROS*: the same with ROS up, every topic announced and \
                nobody subscribed. Percentages are the time outside Bullet over the time inside, in the same slice; *other \
                threads* is what the threads that do not step cost, in % of a core.",
        header: &[
            "scene", "bodies", "in Bullet", "outside: update", "outside: loop", "outside: ROS", "update", "loop", "ROS",
            "whole step, ROS/loop",
            "other threads", "C++ in all (observed, other run)",
        ],
        ..Section::default()
    };
    let mut small = Worst::default();
    let mut measured: Vec<Vec<Lane>> = Vec::new();
    for scene in &all {
        let found = measure(effort, &MODES.map(|mode| (mode, scene)));
        let row = match &found {
            Ok(lanes) => {
                if lanes[0].bodies < 200 && lanes[0].rays == 0 {
                    small.see(scene, &lanes[1]);
                }
                row(scene, lanes)
            }
            Err(problem) => {
                [scene.name.clone(), problem.replace('|', "/")].into_iter().chain(vec!["–".into(); 10]).collect()
            }
        };
        eprintln!("sim/step {}", row.join(" | "));
        section.rows.push(row);
        measured.push(found.unwrap_or_default());
    }
    let measured: Vec<_> = measured.into_iter().take(BOXES.len()).collect();
    if let Some([_, bare, ros]) = measured.last().map(Vec::as_slice) {
        let (loop_, ros) = (bare.overhead(), ros.overhead());
        section.remarks.push(goal("at 200 boxes at most 3 % outside Bullet", loop_.median <= 3.0, &percent(loop_)));
        section.remarks.push(goal(
            "with ROS up and nobody subscribed at most 5 % (C++: 33 %)",
            ros.median <= 5.0,
            &percent(ros),
        ));
    }
    section.remarks.push(small.goal());
    section.remarks.push("![Cost of a step over the number of boxes](figures/step-cost.svg)".into());
    (section, figure(&measured))
}

fn row(scene: &Scene, lanes: &[Lane]) -> Vec<String> {
    let mut row = vec![scene.name.clone(), lanes[0].bodies.to_string(), lanes[0].inside().to_string()];
    row.extend(lanes.iter().map(|lane| lane.outside().to_string()));
    row.extend(lanes.iter().map(|lane| percent(lane.overhead())));
    row.push(format!("{:.2}", lanes[2].over(&lanes[1])));
    row.push(percent(lanes[2].others()));
    row.push(observed::cell(observed::step_us(&scene.name)));
    row
}

fn percent(spread: Spread) -> String {
    format!("{:.1} %", spread.median)
}

/// The small scene that comes closest to its limit, or is furthest above it.
#[derive(Default)]
struct Worst {
    share: f64,
    words: String,
}

impl Worst {
    fn see(&mut self, scene: &Scene, lane: &Lane) {
        let (cost, limit) = (lane.outside().median, SMALL.0 + SMALL.1 * lane.bodies as f64);
        if cost / limit > self.share {
            self.share = cost / limit;
            self.words = format!("at worst {} µs of {} µs ({})", short(cost), short(limit), scene.name);
        }
    }

    fn goal(&self) -> String {
        let words =
            format!("in scenes of fewer than 200 bodies without rays at most {} µs + {} µs a body", SMALL.0, SMALL.1);
        goal(&words, self.share <= 1.0, &self.words)
    }
}

fn figure(measured: &[Vec<Lane>]) -> Figure {
    let line = |name, value: &dyn Fn(&[Lane]) -> f64| {
        let points = BOXES.iter().zip(measured).filter(|(_, lanes)| lanes.len() == MODES.len());
        Line { name, points: points.map(|(&n, lanes)| (n as f64, value(lanes))).collect() }
    };
    let observed = BOXES.iter().filter_map(|&n| Some((n as f64, observed::step_us(&format!("boxes{n}"))?)));
    let lines = [
        line("in Bullet", &|lanes| lanes[0].inside().median),
        line("outside, no ROS", &|lanes| lanes[1].outside().median),
        line("outside, ROS up", &|lanes| lanes[2].outside().median),
        Line { name: "C++ in all (other run)", points: observed.collect() },
    ];
    log_lines("Cost of a step of 1 ms", "boxes in contact", "µs", &BOXES.map(|n| n as f64), &lines)
}

/// What is saved where a scene does not need something.
pub fn skip(effort: Effort) -> Section {
    let mut section = Section {
        title: "sim/skip",
        intro: "What a scene does not ask for is skipped. Rows that belong together are the same scene with and without, stepped in turn in one \
                process; the last column is the whole step over that of the first of them.",
        header: &["scene", "load, ms", "in Bullet, µs", "outside, µs", "whole step, ratio"],
        ..Section::default()
    };
    let chain = |feedback| scenes::chain(20, feedback);
    let ball = |kind| scenes::balls(6, kind);
    let variants: [Vec<(&str, Scene)>; 4] = [
        vec![("20 hinges", chain(false)), ("with joint feedback", chain(true))],
        vec![
            ("100 boxes that overlap, no pair may collide", scenes::ghostly_boxes(100)),
            ("100 boxes on each other, all may collide", scenes::boxes(100)),
        ],
        vec![
            ("36 balls on the ground, primitives", ball(None)),
            ("convex meshes", ball(Some("CONVEX_HULL"))),
            ("concave meshes", ball(Some("CONCAVE_MESH"))),
        ],
        scenes::elements(),
    ];
    for group in &variants {
        let lanes: Vec<(Mode, &Scene)> = group.iter().map(|(_, scene)| (Mode::Update, scene)).collect();
        let lanes = match measure(effort, &lanes) {
            Ok(lanes) => lanes,
            Err(problem) => panic!("{}: {problem}", group[0].0),
        };
        for ((name, _), lane) in group.iter().zip(&lanes) {
            let ratio = format!("{:.2}", lane.over(&lanes[0]));
            let load = short(lane.load * 1e3);
            section.rows.push(vec![(*name).into(), load, lane.inside().to_string(), lane.outside().to_string(), ratio]);
        }
    }
    section
}
