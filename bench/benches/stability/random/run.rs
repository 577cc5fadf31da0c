//! An abstract scene, written, loaded and run.

use std::collections::HashMap;
use std::path::Path;
use std::time::Duration;

use ambf_core::adf::Severity;
use ambf_core::bullet::Solver;
use ambf_core::comm::JointCommandType;
use ambf_core::control::Profile;
use ambf_core::ids::{ActuatorId, BodyId, JointId};
use ambf_core::scene::{self, load, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;

use super::adf;
use super::follow::{follow, Outcome, Verdict};
use super::scene::{Order, Scene, Shape};
use super::script::{Action, Event, Script};

/// Settings under which the same scenes are run.
pub const WAYS: [&str; 4] = ["accurate", "legacy", "Dantzig", "pybullet-like"];

/// CPU time after which a run is given up, in units of the simulated time.
pub const PATIENCE: f64 = 20.0;
/// A scene is slow when it takes longer than real time and this many times as long as in `legacy`.
const SLOW: f64 = 10.0;

/// Options of a way.
pub fn physics(way: &str) -> PhysicsOptions {
    let legacy = PhysicsOptions { profile: Some(Profile::Legacy), ..PhysicsOptions::default() };
    match way {
        "accurate" => PhysicsOptions { profile: Some(Profile::Accurate), ..legacy },
        "Dantzig" => PhysicsOptions { solver: Some(Solver::Dantzig), ..legacy },
        "pybullet-like" => PhysicsOptions { iterations: Some(50), joint_erp: Some(0.2), ..legacy },
        _ => legacy,
    }
}

/// Runs a scene; its file is left at `path`, also when the run never comes back.
pub fn run(scene: &Scene, way: &str, path: &Path) -> Outcome {
    match simulation(scene, way, path) {
        Ok((mut simulation, script)) => {
            follow(&mut simulation, &script, Duration::from_secs_f64(PATIENCE * script.span))
        }
        Err(message) => Outcome::refused(message),
    }
}

/// Text of the model with its commands.
///
/// # Errors
/// What is wrong with the file.
pub fn text(scene: &Scene, path: &Path) -> Result<String, String> {
    let (simulation, script) = simulation(scene, "legacy", path)?;
    Ok(script.text(simulation.scene()) + &adf::model(scene))
}

/// Verdict of a run with the cost of `legacy` (µs a sub-step) taken into account.
pub fn with_cost(outcome: &Outcome, step: f64, legacy: Option<f64>) -> Verdict {
    let is_slow = outcome.cost > step * 1e6 && outcome.cost > SLOW * legacy.unwrap_or(0.0);
    match outcome.verdict {
        Verdict::Good | Verdict::Poor if is_slow => Verdict::Slow,
        verdict => verdict,
    }
}

fn simulation(scene: &Scene, way: &str, path: &Path) -> Result<(Simulation, Script), String> {
    let write =
        |path: &Path, text: String| std::fs::write(path, text).map_err(|error| format!("{}: {error}", path.display()));
    write(path, adf::model(scene))?;
    for shape in scene.bodies.iter().filter_map(|body| body.shape) {
        if let Shape::Ground(ground, _) = shape {
            let mesh = path.with_file_name(ground.file());
            // Worlds that run at the same time share the file.
            if !mesh.exists() {
                let own = path.with_extension("obj");
                write(&own, ground.text())?;
                std::fs::rename(&own, &mesh).map_err(|error| format!("{}: {error}", mesh.display()))?;
            }
        }
    }
    let files = SceneFiles { world: None, models: vec![path.to_owned()] };
    let loaded = load(&files, &SceneOptions { physics: physics(way), ..SceneOptions::default() });
    if loaded.report.errors() > 0 {
        let worst = |note: &&scene::Note| note.severity > Severity::Warning;
        let first = loaded.report.notes.iter().find(worst).map(ToString::to_string);
        return Err(first.unwrap_or_else(|| loaded.report.to_string()));
    }
    let script = script(scene, &loaded.scene);
    Ok((Simulation::new(loaded.scene, scene.step), script))
}

/// Commands of an abstract scene, bound to the loaded one. A joint is addressed through its parent, where it is
/// active.
fn script(scene: &Scene, loaded: &scene::Scene) -> Script {
    let joints: HashMap<&str, JointId> = loaded.joints.entries().map(|(id, joint)| (joint.name.as_str(), id)).collect();
    let active = |joint: usize| {
        let &id = joints.get(format!("j{}", scene.joints[joint].id).as_str())?;
        let parent = loaded.joints[id].parent;
        let place = loaded.active_joints(parent).iter().position(|&other| other == id)?;
        Some((parent, place))
    };
    let action = |order: &Order| match *order {
        Order::Joint(joint, kind, value) => {
            let kind = match kind {
                0 => JointCommandType::Effort,
                1 => JointCommandType::Position,
                _ => JointCommandType::Velocity,
            };
            active(joint).map(|(body, place)| Action::Joint(body, place, kind, value))
        }
        Order::Wrench(body, force, torque) => Some(Action::Wrench(BodyId::new(body), force, torque)),
        Order::Twist(body, linear, angular) => Some(Action::Twist(BodyId::new(body), linear, angular)),
        Order::Pose(body, pose) => {
            let q = pose.rotation.coords;
            Some(Action::Pose(BodyId::new(body), pose.translation.vector, [q.x, q.y, q.z, q.w]))
        }
        Order::Reset(kind) => Some(Action::Reset(kind)),
        Order::Hold(actuator, body) => Some(Action::Hold(ActuatorId::new(actuator), body.map(BodyId::new))),
    };
    let event = |command: &super::scene::Command| {
        action(&command.order).map(|action| Event { first: command.first, last: command.last, action })
    };
    Script { step: scene.step, span: scene.span, events: scene.commands.iter().filter_map(event).collect() }
}
