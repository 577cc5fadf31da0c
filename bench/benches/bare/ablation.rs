//! What each thing that is left out saves, alone.

use std::fmt::Write as _;

use ambf_core::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;

use super::report::Section;
use super::statistics::Spread;
use super::{cpu, scenes, simulation, update, Plain, DT, WARM_UP};

/// Numbered as in `bare.cpp`; 0 is the plain program.
const SKIPS: [i32; 7] = [0, 1, 2, 4, 8, 16, 31];
/// What a slice of one lane takes, s.
const SLICE: f64 = 0.02;

/// The plain program with each skip alone, in turn.
pub fn skips(rounds: usize) -> Section {
    let mut section = Section {
        title: "bare/ablation",
        intro: "The plain program with each skip alone: CPU time of a step over that without any, median (10th–90th percentile). *Motion states*: \
                integrated when they are read, and nobody does; *prediction*: of motion, only for bodies that are checked continuously; *pairs*: \
                that never collide are found in a bit set instead of a list; *static bodies*: their bounds are not computed in every sub-step; *compounds*: single shapes without \
                an offset lie in none. The first three change no bit and are always on; the others change the order of contacts and are on in `accurate`.",
        header: &["scene", "plain, µs", "motion states", "prediction", "pairs", "static bodies", "compounds", "all"],
        ..Section::default()
    };
    let own = [("floating200", grid(200, "gravity: {x: 0, y: 0, z: 0}", false)), ("apart100", grid(100, "", true))];
    let own = own.map(|(name, model)| (name.to_owned(), written(name, &model)));
    for (name, files) in own.into_iter().chain(scenes()) {
        let lanes: Option<Vec<Plain>> = SKIPS.iter().map(|&skips| Plain::new(&files, skips)).collect();
        let Some(mut lanes) = lanes else { continue };
        lanes.iter_mut().for_each(|lane| lane.step(WARM_UP));
        let steps = steps_of(&mut |steps| lanes[0].step(steps));
        let round = |lanes: &mut Vec<Plain>| lanes.iter_mut().map(|lane| cost(steps, |n| lane.step(n))).collect();
        let rounds: Vec<Vec<f64>> = (0..rounds).map(|_| round(&mut lanes)).collect();
        let spread = |lane: usize, over: bool| {
            let values = rounds.iter().map(|costs| costs[lane] / if over { costs[0] } else { 1.0 });
            Spread::of(values).expect("there are rounds")
        };
        let mut row = vec![name, spread(0, false).to_string()];
        row.extend((1..SKIPS.len()).map(|lane| format!("{:.3}", spread(lane, true))));
        eprintln!("{}", row.join(" | "));
        section.rows.push(row);
    }
    section
}

/// 200 boxes that lie, awake and asleep.
pub fn sleep(rounds: usize) -> Section {
    let mut section = Section {
        title: "sim/sleep",
        intro: "`Simulation::update` of 200 boxes after 8 s, CPU time of a step, µs: awake, and with `--sleep`.",
        header: &["boxes asleep", "awake", "with `--sleep`", "ratio"],
        ..Section::default()
    };
    let Some((_, files)) = scenes().into_iter().find(|(name, _)| name == "boxes200") else { return section };
    let physics = PhysicsOptions { sleep: Some(true), ..PhysicsOptions::default() };
    let asleep = load(&files, &SceneOptions { physics, ..SceneOptions::default() }).scene;
    let mut lanes = [simulation(&files), Simulation::new(asleep, DT)];
    lanes.iter_mut().for_each(|lane| update(lane, 8000));
    let world = &lanes[1].scene().world;
    let sleepers = world.bodies().iter().filter(|&&body| world.is_asleep(body) == Some(true)).count();
    let steps = lanes.each_mut().map(|lane| steps_of(&mut |steps| update(lane, steps)));
    let rounds: Vec<[f64; 2]> =
        (0..rounds).map(|_| [0, 1].map(|i| cost(steps[i], |n| update(&mut lanes[i], n)))).collect();
    let spread = |value: &dyn Fn(&[f64; 2]) -> f64| Spread::of(rounds.iter().map(value)).expect("there are rounds");
    section.rows.push(vec![
        sleepers.to_string(),
        spread(&|costs| costs[0]).to_string(),
        spread(&|costs| costs[1]).to_string(),
        format!("{:.3}", spread(&|costs| costs[1] / costs[0])),
    ]);
    section
}

/// Steps that take a slice.
fn steps_of(step: &mut dyn FnMut(usize)) -> usize {
    (SLICE * 1e6 / cost(200, step)).ceil() as usize
}

/// CPU time of a step, µs.
fn cost(steps: usize, mut step: impl FnMut(usize)) -> f64 {
    let begin = cpu();
    step(steps);
    (cpu() - begin) / steps as f64 * 1e6
}

/// Boxes of 0.1 m in a cube, 0.25 m apart; or none of which may collide, so near that all bounds overlap.
fn grid(n: usize, keys: &str, overlap: bool) -> String {
    let names: Vec<_> = (0..n).map(|i| format!("BODY {i}")).collect();
    let mut text =
        format!("bodies: [{}]\nnamespace: /ambf/env/\nignore inter-collision: {overlap}\n", names.join(", "));
    let pitch = if overlap { 0.01 } else { 0.25 };
    for (i, name) in names.iter().enumerate() {
        let [x, y, z] = [i % 6, i / 6 % 6, i / 36].map(|k| k as f64 * pitch);
        let shape = "collision shape: Box, collision geometry: {x: 0.1, y: 0.1, z: 0.1}";
        writeln!(
            text,
            "{name}: {{name: B{i}, mass: 0.1, location: {{position: {{x: {x:.2}, y: {y:.2}, z: {z:.2}}}}}, {shape}, {keys}}}"
        )
        .expect("a text takes everything");
    }
    text.replace(", }", "}")
}

fn written(name: &str, text: &str) -> SceneFiles {
    let folder = ambf_bench::folder();
    let path = folder.join(format!("bare_{name}.yaml"));
    std::fs::write(&path, text).expect("the target folder can be written");
    SceneFiles { world: None, models: vec![path] }
}
