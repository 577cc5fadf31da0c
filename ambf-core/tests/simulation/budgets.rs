//! The budget of the solver of profile `accurate` bounds what a sub-step costs, also where it finds no solution.

use std::path::Path;

use ambf_core::bullet::AccurateSettings;
use ambf_core::control::Profile;
use ambf_core::scene::{load, Loaded, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::DEFAULT_SUB_STEP;
use nalgebra::Vector3;

/// Thirteen bodies in loops that contradict each other and in contact, turned fast. They took up to 64 budgets a sub-step: each
/// of its 16 parts had one of its own, and took it four times. 8 to 29 ms a step, 50 to 160 times the cost of `legacy`.
#[test]
fn a_sub_step_without_a_solution_takes_a_few_budgets() {
    let model = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/simulation/entangled.yaml");
    let files = SceneFiles { world: None, models: vec![model] };
    let physics = PhysicsOptions { profile: Some(Profile::Accurate), ..PhysicsOptions::default() };
    let Loaded { mut scene, report } = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
    assert_eq!(report.errors(), 0, "{report}");
    let bodies = scene.world.bodies().to_vec();
    let settings = AccurateSettings::default();
    let (mut approximate, mut divided, mut most) = (0, 0, 0.0_f64);
    for step in 0..300 {
        if step % 20 == 0 {
            for (index, &body) in bodies.iter().enumerate() {
                let spin = Vector3::new(300.0, -200.0 * index as f64, 100.0);
                scene.world.set_velocity(body, &Vector3::zeros(), &spin);
            }
        }
        scene.world.step(DEFAULT_SUB_STEP, 1, DEFAULT_SUB_STEP);
        let found = scene.world.take_statistics();
        let islands = found.islands_solved + found.islands_approximate;
        if islands == 0 {
            continue;
        }
        (approximate, divided) = (approximate + found.islands_approximate, divided + found.divided_sub_steps);
        // At least the rows of an island, in the mean of the parts.
        let rows = found.rows as f64 / islands as f64;
        most = most.max(found.multiplications / (settings.base_budget + settings.budget_per_row * rows));
    }
    println!("{approximate} approximations, {divided} divided sub-steps, at most {most} budgets");
    assert!(approximate > 100 && divided > 100, "{approximate} {divided}");
    assert!(most < 16.0, "{most} budgets");
}
