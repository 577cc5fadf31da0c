//! Loads a shipped scene, steps it, and prints where a body is.
//!
//!     cargo run -p ambf-core --example step_scene [MODEL FILE] [BODY]

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use ambf_core::control::Profile;
use ambf_core::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;

/// Length of an iteration and of its one sub-step, s.
const STEP: f64 = 0.001;

fn main() -> ExitCode {
    let resources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources");
    let mut arguments = std::env::args().skip(1);
    let model = arguments.next().map_or_else(|| resources.join("models/pendulum.yaml"), PathBuf::from);
    let name = arguments.next().unwrap_or_else(|| "Link".into());

    // Loading never fails: what is of no use is left out, and the report says so.
    let files = SceneFiles { world: Some(resources.join("world/world.yaml")), models: vec![model] };
    let physics = PhysicsOptions { profile: Some(Profile::Accurate), ..PhysicsOptions::default() };
    let loaded = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
    print!("{}", loaded.report);

    let mut simulation = Simulation::new(loaded.scene, STEP);
    let Some(body) = simulation.scene().bodies.position(|body| *body.identity.name == *name) else {
        eprintln!("there is no body `{name}`");
        return ExitCode::FAILURE;
    };
    for step in 1..=1000 {
        // An error means that a number is not finite any more, or not plausible; a reset would bring the scene back.
        if let Err(lost) = simulation.update(STEP) {
            eprintln!("{lost}");
            return ExitCode::FAILURE;
        }
        if step % 100 == 0 {
            // The body frame in the world: position in m, orientation as roll, pitch, yaw about fixed axes in rad.
            let scene = simulation.scene();
            let pose = scene.bodies[body].pose(&scene.world);
            let p = pose.translation.vector;
            let (roll, pitch, yaw) = pose.rotation.euler_angles();
            println!(
                "{:.1} s: {name} at ({:.4}, {:.4}, {:.4}), turned ({roll:.4}, {pitch:.4}, {yaw:.4})",
                simulation.sim_time(),
                p.x,
                p.y,
                p.z
            );
        }
    }
    ExitCode::SUCCESS
}
