//! A body that follows a commanded curve, for every rate at which commands come.

use ambf_core::control::Profile;
use ambf_core::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;
use nalgebra::Vector3;

use super::number;
use super::plot::{log_lines, Figure, Line};
use super::report::Section;

/// Commands and updates a second; sub-steps are of 1 ms.
const RATES: [f64; 7] = [1000.0, 500.0, 200.0, 100.0, 60.0, 30.0, 10.0];
const SUB_STEP: f64 = 0.001;
/// Errors count from here to there, s.
const SPAN: (f64, f64) = (2.0, 10.0);

const WORLD: &str = "namespace: /bench/\ngravity: {x: 0, y: 0, z: 0}\nmax iterations: 1000\n";

/// A body of 1 kg; its controllers.
const CONTROLLERS: [(&str, &str); 3] = [
    ("force, P 1000, D 60", "controller: {linear: {P: 1000, I: 0, D: 60}, angular: {P: 10, I: 0, D: 0.5}}"),
    ("force, P 4000, D 40", "controller: {linear: {P: 4000, I: 0, D: 40}, angular: {P: 10, I: 0, D: 0.5}}"),
    ("default: velocity, P 10", ""),
];

const PROFILES: [(&str, Profile); 2] = [("legacy", Profile::Legacy), ("accurate", Profile::Accurate)];

/// The commanded curve.
fn curve(t: f64) -> Vector3<f64> {
    Vector3::new((4.0 * t).sin(), (4.0 * t).cos(), 2.0 * (4.0 * t).sin()) * 0.1
}

fn simulation(controller: &str, profile: Profile) -> Simulation {
    let folder = ambf_bench::folder();
    let (world, model) = (folder.join("rates_world.yaml"), folder.join("rates.yaml"));
    let body = format!(
        "bodies: [BODY tool]\njoints: []\nBODY tool:\n  name: tool\n  mass: 1\n  inertia: {{ix: 0.01, iy: 0.01, iz: 0.01}}\n  \
         location: {{position: {{x: 0, y: 0.1, z: 0}}}}\n  {controller}\n"
    );
    for (path, text) in [(&world, WORLD), (&model, &body)] {
        std::fs::write(path, text).expect("the target folder can be written to");
    }
    let physics = PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
    let files = SceneFiles { world: Some(world), models: vec![model] };
    let loaded = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
    assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
    Simulation::new(loaded.scene, SUB_STEP)
}

/// Root mean square of the distance from the curve, m, at the ends of updates; infinite if the body is lost.
fn error(controller: &str, profile: Profile, rate: f64) -> f64 {
    let mut simulation = simulation(controller, profile);
    let body = simulation.scene().bodies.position(|body| &*body.identity.name == "tool").expect("the tool");
    let (mut sum, mut count) = (0.0, 0.0);
    while simulation.sim_time() < SPAN.1 {
        simulation.follow_pose(body, curve(simulation.sim_time()), [0.0, 0.0, 0.0, 1.0]);
        if simulation.update(1.0 / rate).is_err() {
            return f64::INFINITY;
        }
        let scene = simulation.scene();
        let pose = scene.world.pose(scene.world.bodies()[body.index()]).expect("nothing is removed");
        if simulation.sim_time() >= SPAN.0 {
            sum += (pose.translation.vector - curve(simulation.sim_time())).norm_squared();
            count += 1.0;
        }
    }
    let error = f64::sqrt(sum / count);
    // Farther off than if it had not moved at all.
    if error < 0.5 {
        error
    } else {
        f64::INFINITY
    }
}

/// The table and its figure.
pub fn measure() -> (Section, Figure) {
    let runs: Vec<_> = CONTROLLERS
        .iter()
        .flat_map(|(name, controller)| PROFILES.map(|profile| (*name, *controller, profile)))
        .map(|(name, controller, (profile, kind))| (name, profile, RATES.map(|rate| error(controller, kind, rate))))
        .collect();
    let row = |(name, profile, errors): &(&str, &str, [f64; 7])| {
        [(*name).to_owned(), (*profile).to_owned()].into_iter().chain(errors.map(number)).collect::<Vec<_>>()
    };
    let line = |name, (_, _, errors): &(&str, &str, [f64; 7])| Line {
        name,
        points: RATES.iter().copied().zip(*errors).filter(|point| point.1.is_finite()).collect(),
    };
    let names = ["P 1000, legacy", "P 1000, accurate", "P 4000, legacy", "P 4000, accurate"];
    let lines: Vec<_> = names.into_iter().zip(&runs).map(|(name, run)| line(name, run)).collect();
    let figure = log_lines("Body that follows a curve", "commands a second", "error, m", &RATES, &lines);
    let section = Section {
        title: "Body on a curve: outer rate against error",
        intro: "A body of 1 kg without gravity gets pose commands on P(t) = P₀ + 0.1·(sin 4t, cos 4t, 2 sin 4t) m. Commands and updates come at \
                the outer rate, sub-steps are of 1 ms. Error: root mean square of the distance from the curve, m, from 2 to 10 s, at the ends of \
                updates. !: lost. Between commands, `accurate` lets a set point that moves steadily go on.",
        header: &["controller", "profile", "1000 Hz", "500 Hz", "200 Hz", "100 Hz", "60 Hz", "30 Hz", "10 Hz"],
        rows: runs.iter().map(row).collect(),
        remarks: vec!["![Outer rate against error](../figures/control-rates.svg)".into()],
    };
    (section, figure)
}
