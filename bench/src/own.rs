//! Our simulator, with its whole pipeline: ADF text, scene, `Simulation::update`.

use std::time::Duration;

use ambf_core::bullet::{Integrator, Solver};
use ambf_core::comm::JointCommandType;
use ambf_core::control::Profile;
use ambf_core::ids::BodyId;
use ambf_core::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;
use rustix::time::{clock_gettime, ClockId};

use super::case::{Case, Family, Run, Samples};
use super::reference::State;
use super::system::System;

/// A way to step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setting {
    pub name: &'static str,
    pub physics: PhysicsOptions,
    /// Put into every joint, each with a comma after it.
    pub joint_keys: &'static str,
}

/// Name of the setting that the goals are about.
pub const ACCURATE: &str = "accurate";
/// Name of the one it is compared to first.
pub const LEGACY: &str = "legacy";

/// The two profiles, then single settings of the legacy one that show where differences come from.
pub fn settings(case: &Case) -> Vec<Setting> {
    let legacy = PhysicsOptions { profile: Some(Profile::Legacy), ..PhysicsOptions::default() };
    let solver = |solver, iterations| PhysicsOptions { solver: Some(solver), iterations: Some(iterations), ..legacy };
    let plain = |name, physics| Setting { name, physics, joint_keys: "" };
    let mut settings = vec![
        plain(LEGACY, legacy),
        plain(ACCURATE, PhysicsOptions { profile: Some(Profile::Accurate), ..PhysicsOptions::default() }),
    ];
    match case.family {
        Family::Free => {
            settings.push(plain("ballistic", PhysicsOptions { integrator: Some(Integrator::Ballistic), ..legacy }))
        }
        Family::Tree | Family::Loop => {
            let stiff = |name, physics| Setting { name, physics, joint_keys: "joint erp: 0.8, joint cfm: 1e-12, " };
            settings.push(plain("SI 50", solver(Solver::SequentialImpulse, 50)));
            settings.push(stiff("SI 50, ERP 0.8", solver(Solver::SequentialImpulse, 50)));
            if case.family == Family::Tree {
                settings.push(stiff("Dantzig, ERP 0.8", solver(Solver::Dantzig, 50)));
            }
        }
        Family::Contact | Family::Bounce => {
            settings.push(plain("SI 50", solver(Solver::SequentialImpulse, 50)));
            settings.push(plain("Dantzig", solver(Solver::Dantzig, 50)));
            if case.name.ends_with("-heavy") {
                settings.push(plain("SI 1000", solver(Solver::SequentialImpulse, 1000)));
            }
        }
    }
    settings
}

/// A scene of ours and its name among the files of the target folder.
pub fn simulation(name: &str, system: &System, setting: &Setting, step: f64) -> Result<Simulation, String> {
    let folder = crate::folder();
    let (world, model) = system.adf(setting.joint_keys);
    let (world_file, model_file) = (folder.join(format!("{name}_world.yaml")), folder.join(format!("{name}.yaml")));
    for (path, text) in [(&world_file, world), (&model_file, model)] {
        std::fs::write(path, text).map_err(|error| format!("{}: {error}", path.display()))?;
    }
    let files = SceneFiles { world: Some(world_file), models: vec![model_file] };
    let mut loaded = load(&files, &SceneOptions { physics: setting.physics, ..SceneOptions::default() });
    if loaded.report.errors() > 0 {
        return Err(loaded.report.to_string());
    }
    // Bodies of the scene, place for place.
    let handles = loaded.scene.world.bodies().to_vec();
    for (body, handle) in system.bodies.iter().zip(handles) {
        if body.velocity.norm() + body.spin.norm() > 0.0 {
            loaded.scene.world.set_velocity(handle, &body.velocity, &body.spin);
        }
    }
    Ok(Simulation::new(loaded.scene, step))
}

/// Runs a case; `Ok(None)` when it takes longer than `most`.
pub fn run(case: &Case, setting: &Setting, step: f64, most: Duration) -> Result<Option<Run>, String> {
    let mut simulation = simulation(case.name, &case.system, setting, step)?;
    let (mut samples, mut cpu, mut tail, mut done) = (Samples::new(), Duration::ZERO, Duration::ZERO, 0_u64);
    for &time in &case.times {
        let until = (time / step).round() as u64;
        let begin = cpu_time();
        let lost = (done..until).any(|index| {
            if let Some(drive) = &case.system.drive {
                let (angle, _) = drive.set_point(index as f64 * step);
                (0..drive.gains.len()).for_each(|joint| {
                    simulation.command_joint(BodyId::new(0), joint, JointCommandType::Position, angle);
                });
            }
            simulation.update(step).is_err()
        });
        tail = cpu_time() - begin;
        cpu += tail;
        done = until;
        if lost {
            break;
        }
        samples.push(states(&simulation));
        if cpu > most {
            return Ok(None);
        }
    }
    Ok(Some(Run { cpu, tail, samples }))
}

/// True poses, not those of motion states, which lag in the legacy profile.
fn states(simulation: &Simulation) -> Vec<State> {
    let world = &simulation.scene().world;
    let state = |&body| {
        let (velocity, spin) = world.velocity(body)?;
        Some(State { pose: world.pose(body)?, velocity, spin })
    };
    world.bodies().iter().map(|body| state(body).expect("nothing is removed")).collect()
}

/// CPU time of this thread.
pub fn cpu_time() -> Duration {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
}
