//! Runs in the profile `pybullet` against recordings of pybullet, which need not be installed; see docs/pybullet.md.

mod pybullet_common;

use ambf_core::bullet::Preset;
use ambf_core::control::Profile;
use ambf_core::scene::{PhysicsOptions, SceneOptions};
use pybullet_common::{compare, runs, same_until, Differences, Method, Run};

fn all(method: Method) -> Vec<Run> {
    let runs: Vec<_> = runs().into_iter().filter(|run| run.method == method).collect();
    assert!(runs.len() >= 8, "only {} runs", runs.len());
    runs
}

#[test]
fn rigid_bodies_move_as_in_pybullet() {
    for run in all(Method::Rigid) {
        let rows = compare(&run, &SceneOptions::default());
        for (step, differences) in rows.iter().filter(|row| row.0 <= same_until(&run)) {
            assert!(differences.largest() <= 1e-12, "{} step {step}: {differences:?}", run.name);
            // Positions and velocities to the last bit; rotations are compared as quaternions, which we get from a
            // matrix in another way.
            let bits = [differences.position, differences.linear, differences.angular];
            assert_eq!(bits, [0.0; 3], "{} step {step}", run.name);
        }
    }
}

#[test]
fn the_settings_of_the_profile_are_needed() {
    let run = runs().into_iter().find(|run| run.name == "tumble").expect("a run");
    let physics = PhysicsOptions { profile: Some(Profile::Legacy), ..PhysicsOptions::default() };
    let legacy = compare(&run, &SceneOptions { physics, ..SceneOptions::default() });
    assert!(Differences::of(&legacy).position > 1e-3);
    let physics = PhysicsOptions { preset: Some(Preset::PyBullet), ..physics };
    let by_option = compare(&run, &SceneOptions { physics, ..SceneOptions::default() });
    assert!(Differences::of(&by_option).largest() <= 1e-12);
}

/// Both programs are of first order in the step, each with an error of its own; so is the difference between them: half
/// the step, half the difference.
#[test]
fn trees_of_joints_approach_pybullets_links_with_the_step() {
    // Largest difference of positions at 1 ms, m: measured 2.0e-5, 3.9e-3, 2.1e-3, 1.1e-3.
    let bounds = [("pendulum", 3e-5), ("double_pendulum", 5e-3), ("cart", 3e-3), ("arm7", 1.5e-3)];
    let runs = all(Method::Articulated);
    for (name, bound) in bounds {
        let run = |name: &str| runs.iter().find(|run| run.name == name).unwrap_or_else(|| panic!("{name}"));
        let largest = |name: &str| Differences::of(&compare(run(name), &SceneOptions::default()));
        let (whole, half) = (largest(name), largest(&format!("{name}_half")));
        assert!(whole.position < bound, "{name}: {whole:?}");
        for (whole, half) in [
            (whole.position, half.position),
            (whole.rotation, half.rotation),
            (whole.linear, half.linear),
            (whole.angular, half.angular),
            (whole.joint, half.joint),
        ] {
            assert!(half < 0.6 * whole, "{name}: {whole:e} with the whole step, {half:e} with half of it");
        }
    }
}
