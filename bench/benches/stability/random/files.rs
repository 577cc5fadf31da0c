//! The same search with files of other people: `--files FILE|FOLDER`, each under `--random N` sequences of random
//! commands.
//!
//! A file is loaded into the default world. Commands are those of clients: set points of all or some joints that jump
//! by up to the range of the joint, wrenches, velocities and poses of bodies, resets, grips of actuators.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use ambf_bench::follow::{follow, Outcome, Verdict, VERDICTS};
use ambf_bench::model_files;
use ambf_bench::script::{Action, Event, Script};
use ambf_core::comm::JointCommandType;
use ambf_core::ids::{ActuatorId, BodyId, JointId};
use ambf_core::scene::{load, JointType, Scene, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;
use nalgebra::UnitQuaternion;
use parking_lot::Mutex;

use super::super::families::Dice;
use super::run::{physics, with_cost, PATIENCE, WAYS};
use super::{dice, report, Options};

/// Simulated time of a run, s.
const SPAN: f64 = 2.0;
/// Sub-steps, s.
const STEPS: [f64; 6] = [0.0005, 0.001, 0.001, 0.001, 0.002, 0.004];
/// Share of the range of a joint that set points jump by.
const JUMPS: [f64; 4] = [0.1, 0.3, 0.6, 1.0];
/// Range of a joint without limits, rad or m.
const TURN: f64 = PI;
const SLIDE: f64 = 0.2;

/// A file under one sequence of commands.
struct Tried {
    file: usize,
    sequence: u64,
    /// Sub-step, s.
    step: f64,
    /// What is commanded, as [`Script::parse`] reads it.
    script: String,
    outcomes: Vec<(&'static str, Outcome)>,
}

impl Tried {
    fn outcome(&self, way: &str) -> Option<&Outcome> {
        self.outcomes.iter().find(|(name, _)| *name == way).map(|(_, outcome)| outcome)
    }

    /// Verdict of a way, the cost of `legacy` taken into account.
    fn verdict(&self, way: &str) -> Option<Verdict> {
        let legacy = self.outcome("legacy").map(|outcome| outcome.cost);
        self.outcome(way).map(|outcome| with_cost(outcome, self.step, legacy))
    }
}

/// Runs all files and prints what was found.
///
/// # Panics
/// When the folder for failures cannot be written.
pub fn search(options: &Options) {
    std::fs::create_dir_all(&options.keep).expect("the folder of --keep can be made");
    let ways = if options.only_accurate { &WAYS[..1] } else { &WAYS[..2] };
    let files = model_files::below(&options.files);
    let (next, all) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..options.threads {
            let (next, all, files) = (&next, &all, &files);
            scope.spawn(move || loop {
                let n = next.fetch_add(1, Ordering::Relaxed);
                let Some(file) = files.get(n) else { break };
                for sequence in options.first..options.first + options.scenes {
                    let Some(tried) = try_file(options.seed, n, file, sequence, ways) else { break };
                    keep(options, file, &tried);
                    all.lock().push(tried);
                }
            });
        }
    });
    print(options, ways, &files, &all.into_inner());
}

/// The file loaded for a way of running it; `None`: it is refused, or nothing in it moves.
fn simulation(file: &Path, way: &str, step: f64) -> Option<Simulation> {
    let files = SceneFiles { world: Some(model_files::default_world()), models: vec![file.to_owned()] };
    let loaded = load(&files, &SceneOptions { physics: physics(way), ..SceneOptions::default() });
    let moves = loaded.scene.bodies.iter().any(|body| body.mass > 0.0);
    (loaded.report.refused.is_empty() && moves).then(|| Simulation::new(loaded.scene, step))
}

fn try_file(seed: u64, place: usize, file: &Path, sequence: u64, ways: &[&'static str]) -> Option<Tried> {
    let mut dice = dice::of(seed, sequence.wrapping_mul(0x1_0001).wrapping_add(place as u64));
    let step = dice.pick(&STEPS);
    let mut outcomes = Vec::new();
    let mut commands = None;
    for &way in ways {
        let mut simulation = simulation(file, way, step)?;
        // The same commands in each way: a scene differs by its physics only.
        let script = commands.get_or_insert_with(|| draw(&mut dice, simulation.scene(), step));
        outcomes.push((way, follow(&mut simulation, script, Duration::from_secs_f64(PATIENCE * SPAN))));
    }
    let script = simulation(file, WAYS[0], step)
        .zip(commands)
        .map_or(String::new(), |(simulation, script)| script.text(simulation.scene()));
    Some(Tried { file: place, sequence, step, script, outcomes })
}

/// Commands for a scene.
fn draw(dice: &mut Dice, scene: &Scene, step: f64) -> Script {
    let steps = (SPAN / step) as u64;
    let mut events = Vec::new();
    let moving: Vec<BodyId> = scene.bodies.entries().filter(|(_, body)| body.mass > 0.0).map(|(id, _)| id).collect();
    if dice.chance(0.85) {
        joints(dice, scene, steps, &mut events);
    }
    let size = scene.joints.iter().map(|joint| joint.frames[0].translation.vector.norm()).fold(0.05, f64::max);
    let mut some = |dice: &mut Dice, action: Action| {
        let first = dice.index(steps as usize * 6 / 10) as u64;
        let length = if dice.chance(0.3) { 1 } else { (steps as f64 * dice.decades(0.01, 0.4)) as u64 };
        events.push(Event { first, last: first + length.max(1) - 1, action });
    };
    let body = dice.pick(&moving);
    if dice.chance(0.15) {
        let force = scene.bodies[body].mass * 9.8 * dice.decades(0.1, 30.0);
        let action = Action::Wrench(body, dice.vector(force), dice.vector(force * size));
        some(dice, action);
    }
    if dice.chance(0.1) {
        let speed = size * dice.decades(0.1, 30.0);
        let action = Action::Twist(body, dice.vector(speed), dice.vector(10.0));
        some(dice, action);
    }
    if dice.chance(0.12) {
        let pose = scene.world.pose(scene.world.bodies()[body.index()]).unwrap_or_default()
            * scene.bodies[body].inertial_offset_inverse;
        let far = dice.pick(&[0.1, 1.0, 10.0]);
        let shift = dice.vector(size * far);
        let q: UnitQuaternion<f64> = pose.rotation * dice.rotation(PI);
        let action = Action::Pose(body, pose.translation.vector + shift, [q.i, q.j, q.k, q.w]);
        some(dice, action);
    }
    if dice.chance(0.1) {
        let at = dice.index(steps as usize) as u64;
        events.push(Event { first: at, last: at, action: Action::Reset(dice.index(3) as u8) });
    }
    if !scene.actuators.is_empty() && dice.chance(0.5) {
        let actuator = ActuatorId::new(dice.index(scene.actuators.len()));
        let at = dice.index(steps as usize / 2) as u64;
        events.push(Event { first: at, last: at, action: Action::Hold(actuator, Some(body)) });
        let at = at + steps / 4;
        events.push(Event { first: at, last: at, action: Action::Hold(actuator, None) });
    }
    Script { step, span: SPAN, events }
}

/// Set points of joints that jump a few times, in some or all joints at once.
fn joints(dice: &mut Dice, scene: &Scene, steps: u64, events: &mut Vec<Event>) {
    let kind = match dice.index(8) {
        0 => JointCommandType::Effort,
        1 => JointCommandType::Velocity,
        _ => JointCommandType::Position,
    };
    // Efforts in units of what carries the child alone.
    let strength = dice.decades(1.0, 30.0);
    let (count, jump, share) = (dice.count(1, 4) as u64, dice.pick(&JUMPS), dice.pick(&[0.3, 1.0, 1.0]));
    let end = if dice.chance(0.6) { steps * 6 / 10 } else { steps };
    // Each joint from its own body: what is passive there cannot be commanded.
    let active: Vec<(BodyId, usize, JointId)> = scene
        .bodies
        .entries()
        .flat_map(|(body, _)| {
            scene.active_joints(body).iter().enumerate().map(move |(place, &joint)| (body, place, joint))
        })
        .filter(|&(body, _, joint)| scene.joints[joint].parent == body)
        .collect();
    for n in 0..count {
        let (first, last) = (end * n / count, end * (n + 1) / count - 1);
        for &(body, place, id) in &active {
            let joint = &scene.joints[id];
            let slides = match joint.joint_type {
                JointType::Prismatic => true,
                JointType::Revolute => false,
                _ => continue,
            };
            if !dice.chance(share) {
                continue;
            }
            let range = if slides { SLIDE } else { TURN };
            let (low, high) = joint
                .limits
                .filter(|limits| limits.low < limits.high)
                .map_or((-range, range), |limits| (limits.low.max(-10.0), limits.high.min(10.0)));
            let value = match kind {
                JointCommandType::Effort => {
                    let arm = if slides { 1.0 } else { joint.frames[1].translation.vector.norm().max(0.01) };
                    scene.bodies[joint.child].mass * 9.8 * arm * dice.between(-1.0, 1.0) * strength
                }
                JointCommandType::Velocity => range * dice.between(-1.0, 1.0) * dice.decades(0.1, 10.0),
                _ => joint.position + (low + (high - low) * dice.roll() - joint.position) * jump,
            };
            events.push(Event { first, last, action: Action::Joint(body, place, kind, value) });
        }
    }
}

/// Writes the commands of a failure beside its name.
fn keep(options: &Options, file: &Path, tried: &Tried) {
    let verdict = tried.verdict(WAYS[0]).unwrap_or(Verdict::Good);
    if verdict == Verdict::Good && !options.keep_all {
        return;
    }
    let name = file.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().replace(' ', "_"));
    let path = options.keep.join(format!("{}_{}_{}_{name}.commands", verdict.name(), options.seed, tried.sequence));
    let outcome = tried.outcome(WAYS[0]).map_or(String::new(), report::seen);
    let words = format!("{}, sequence {}: {}; {outcome}", file.display(), tried.sequence, verdict.name());
    std::fs::write(&path, format!("# {words}\n{}", tried.script)).expect("the folder of --keep can be written");
    println!("{words}: {}", path.display());
}

/// Prints the verdicts of each way, in all and of each file in which one is not good.
fn print(options: &Options, ways: &[&'static str], files: &[PathBuf], all: &[Tried]) {
    println!("\n### Files under random commands\n\n{} sequences each, seed {}.\n", options.scenes, options.seed);
    let names: Vec<_> = VERDICTS.iter().map(|verdict| verdict.name()).collect();
    println!("| file | way | {} |\n|---|{}", names.join(" | "), "---|".repeat(names.len() + 1));
    let row = |name: &str, way: &str, tried: &[&Tried]| {
        let count = |verdict: &Verdict| tried.iter().filter(|one| one.verdict(way) == Some(*verdict)).count();
        let counts: Vec<_> = VERDICTS.iter().map(|verdict| count(verdict).to_string()).collect();
        println!("| {name} | {way} | {} |", counts.join(" | "));
    };
    let everything: Vec<_> = all.iter().collect();
    let tried_files = (0..files.len()).filter(|&place| all.iter().any(|tried| tried.file == place)).count();
    ways.iter().for_each(|way| row(&format!("all {tried_files}"), way, &everything));
    for (place, file) in files.iter().enumerate() {
        let of_it: Vec<_> = all.iter().filter(|tried| tried.file == place).collect();
        if of_it.iter().any(|tried| tried.verdict(WAYS[0]) != Some(Verdict::Good)) {
            ways.iter().for_each(|way| row(&format!("`{}`", file.display()), way, &of_it));
        }
    }
}
