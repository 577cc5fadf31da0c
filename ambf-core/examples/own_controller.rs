//! A controller of one's own at every step: a pendulum is swung to an angle and held there against gravity by joint
//! efforts.
//!
//!     cargo run -p ambf-core --example own_controller

use std::error::Error;
use std::path::Path;

use ambf_core::comm::JointCommandType;
use ambf_core::scene::{load, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;

/// Length of an iteration and of its one sub-step, s.
const STEP: f64 = 0.001;
/// Where the joint is to be, rad: the link, which starts level, points upwards then.
const SET_POINT: f64 = -1.2;
/// Gains, N·m/rad and N·m·s/rad.
const GAINS: (f64, f64) = (60.0, 8.0);
/// Mass of the link, kg, distance of its centre of mass from the joint, m, and gravity, m/s², as the files say.
const LOAD: (f64, f64, f64) = (1.0, 0.25, 9.81);

/// Torque on the child about the joint's axis, N·m: feed-forward of gravity, spring and damper.
fn effort(position: f64, velocity: f64) -> f64 {
    let (mass, arm, gravity) = LOAD;
    // At position 0 the link is level, and its weight turns it the positive way.
    let weight = mass * gravity * arm * position.cos();
    GAINS.0 * (SET_POINT - position) - GAINS.1 * velocity - weight
}

fn main() -> Result<(), Box<dyn Error>> {
    let resources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources");
    let files = SceneFiles {
        world: Some(resources.join("world/world.yaml")),
        models: vec![resources.join("models/pendulum.yaml")],
    };
    let loaded = load(&files, &SceneOptions::default());
    if loaded.report.errors() > 0 {
        return Err(loaded.report.to_string().into());
    }
    let mut simulation = Simulation::new(loaded.scene, STEP);
    let base = simulation.scene().bodies.position(|body| &*body.identity.name == "Base").ok_or("no `Base`")?;
    // Joint commands belong to a body and count the joints below it: here there is one.
    let joint = simulation.scene().active_joints(base)[0];

    for step in 0..=3000 {
        let state = &simulation.scene().joints[joint];
        let (position, velocity) = (state.position, state.velocity);
        if step % 500 == 0 {
            println!("{:.1} s: {position:8.4} rad, {velocity:8.4} rad/s", simulation.sim_time());
        }
        // A command lasts for one update: it is given anew before each.
        simulation.command_joint(base, 0, JointCommandType::Effort, effort(position, velocity));
        simulation.update(STEP)?;
    }
    let error = (simulation.scene().joints[joint].position - SET_POINT).abs();
    if error > 1e-3 {
        return Err(format!("the joint is off its set point by {error:.4} rad").into());
    }
    Ok(())
}
