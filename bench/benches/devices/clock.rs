//! Simulated against wall time.

use ambf_core::sim::{Runner, RunnerOptions};

use super::load::{heavy_boxes, warm_up};
use super::plot::{linear_lines, Figure, Line};
use super::report::{goal, Section};
use super::rig::{watch, Scenery, TOOLS};
use super::Effort;

/// Every so many points of a line make it into the figure.
const POINTS: usize = 150;

/// (wall, simulated) time since the first iteration, s.
fn run(boxes: usize, fixed_step: bool, effort: &Effort) -> Vec<(f64, f64)> {
    let mut simulation = Scenery::new(TOOLS, boxes).load();
    warm_up(&mut simulation);
    let iterations = watch(&mut simulation);
    let runner = Runner::start(simulation, RunnerOptions { fixed_step, ..RunnerOptions::default() });
    std::thread::sleep(effort.clock);
    assert!(runner.stop().is_some(), "physics ends in good order");
    let all = iterations.all();
    let first = all.first().expect("iterations");
    all.iter().map(|it| ((it.at - first.at).as_secs_f64(), it.sim_time - first.sim_time)).collect()
}

/// The table and its figure.
pub fn measure(effort: &Effort) -> (Section, Vec<(&'static str, Figure)>) {
    let boxes = heavy_boxes();
    let cases = [
        ("light, dynamic step", 0, false),
        ("light, fixed step", 0, true),
        ("heavy, dynamic step", boxes, false),
        ("heavy, fixed step", boxes, true),
    ];
    let (mut rows, mut lines, mut shares) = (Vec::new(), Vec::new(), Vec::new());
    for (name, boxes, fixed) in cases {
        let points = run(boxes, fixed, effort);
        let (wall, simulated) = *points.last().expect("points");
        // In iterations a slow computer may make up for later.
        let behind = points.iter().map(|(wall, simulated)| wall - simulated).fold(0.0, f64::max);
        shares.push(simulated / wall);
        rows.push(vec![
            name.to_owned(),
            format!("{:.0}", points.len() as f64 / wall),
            format!("{:.4}", simulated / wall),
            format!("{:.1}", behind * 1e3),
        ]);
        let every = (points.len() / POINTS).max(1);
        lines.push(Line { name, points: points.into_iter().step_by(every).collect() });
    }
    let most = lines.iter().flat_map(|line| &line.points).map(|point| point.1).fold(1e-9, f64::max);
    let figure = linear_lines("Simulated and wall time", "wall time, s", "simulated time, s", most, &lines);
    let section = Section {
        title: "Simulated against wall time",
        intro: "The physics loop alone, at 1000 Hz. Dynamic: each iteration simulates the wall time that has passed; fixed: always 1 ms, so that \
                whatever makes an iteration late is lost. Where physics is slower than real time, time is lost with both.",
        header: &["scene", "iterations, Hz", "simulated / wall", "most behind, ms"],
        rows,
        remarks: vec![
            goal(
                "with light physics and the dynamic step, simulated time is wall time within 0.1 %",
                (shares[0] - 1.0).abs() <= 1e-3,
                &format!("{:.4}; with the fixed step {:.4}", shares[0], shares[1]),
            ),
            "![Simulated against wall time](devices-clock.svg)".into(),
        ],
    };
    (section, vec![("devices-clock.svg", figure)])
}
