//! The shipped scenes in profile `accurate`: without outside work and position corrections their energy never grows.

use std::path::Path;

use ambf_core::bullet::EnergyLedger;
use ambf_core::control::Profile;
use ambf_core::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::{Simulation, DEFAULT_SUB_STEP};

/// Energy without what was put in from outside and without what moves bodies out of each other, J.
fn own(found: &EnergyLedger) -> f64 {
    let put_in = found.set_states + found.wrenches + found.motors + found.body_drives + found.outside;
    found.total() - put_in - found.corrections
}

/// Largest growth of that energy within `steps`, largest |unexplained|, and largest of the three energies, J.
fn growth(model: &str, steps: usize) -> [f64; 3] {
    let resources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources");
    let files = SceneFiles {
        world: Some(resources.join("world/world.yaml")),
        models: vec![resources.join("models").join(model)],
    };
    let physics = PhysicsOptions { profile: Some(Profile::Accurate), ..PhysicsOptions::default() };
    let scene = load(&files, &SceneOptions { physics, ..SceneOptions::default() }).scene;
    let mut simulation = Simulation::new(scene, DEFAULT_SUB_STEP);
    simulation.set_energy_ledger(true);
    let mut lowest = own(&simulation.energy());
    let [mut grown, mut unexplained, mut scale] = [0.0f64; 3];
    for _ in 0..steps {
        simulation.update(DEFAULT_SUB_STEP).expect("finite");
        let found = simulation.energy();
        lowest = lowest.min(own(&found));
        grown = grown.max(own(&found) - lowest);
        unexplained = unexplained.max(found.unexplained.abs());
        scale = scale.max(found.kinetic).max(found.potential.abs()).max(found.elastic);
    }
    [grown, unexplained, scale]
}

#[test]
fn no_shipped_scene_gains_energy() {
    for (model, steps) in [
        ("free_bodies.yaml", 1500),
        ("chain.yaml", 3000),
        ("pendulum.yaml", 3000),
        ("four_bar.yaml", 2000),
        ("arm7.yaml", 300),
        ("gripper.yaml", 500),
        ("joints.yaml", 2000),
        ("stack.yaml", 800),
        ("boxes200.yaml", 300),
        ("hanging_arm.urdf", 200),
        ("car.yaml", 1000),
        ("cloth.yaml", 500),
        ("touch.yaml", 1000),
        ("headlamp.yaml", 1000),
        ("teleop.yaml", 300),
    ] {
        let [grown, unexplained, scale] = growth(model, steps);
        println!("{model}: grown {grown:.1e} J, unexplained {unexplained:.1e} J of {scale:.3} J");
        assert!(grown <= 0.01 * scale + 1e-9, "{model}: {grown} of {scale} J");
        assert!(unexplained <= 0.01 * scale + 1e-9, "{model}: {unexplained} of {scale} J");
    }
}

#[test]
fn position_corrections_wind_up_no_spring() {
    let model = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/simulation/spring_beyond_a_light_link.yaml");
    let files = SceneFiles { world: None, models: vec![model] };
    let physics = PhysicsOptions { profile: Some(Profile::Accurate), ..PhysicsOptions::default() };
    let scene = load(&files, &SceneOptions { physics, ..SceneOptions::default() }).scene;
    const STEP: f64 = 0.005;
    let mut simulation = Simulation::new(scene, STEP);
    simulation.set_energy_ledger(true);
    for _ in 0..400 {
        simulation.update(STEP).expect("finite");
        let found = simulation.energy();
        // The spring begins with 17 J.
        assert!(found.elastic < 18.0, "{found:?}");
        assert!(found.unexplained < 5.0, "{found:?}");
    }
}
