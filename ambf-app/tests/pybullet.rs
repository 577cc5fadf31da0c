//! Runs in the profile `pybullet` against recordings of pybullet, which need not be installed; see docs/pybullet.md.

mod pybullet_common;

use ambf_core::scene::SceneOptions;
use pybullet_common::{compare, runs, Method};

#[test]
fn rigid_bodies_move_as_in_pybullet() {
    for run in runs().iter().filter(|run| run.method == Method::Rigid) {
        for (step, differences) in compare(run, &SceneOptions::default()) {
            println!("{} step {step}: {differences:?}", run.name);
        }
    }
}
#[test]
fn arti() {
    for run in runs().iter().filter(|run| run.method == Method::Articulated) {
        for (step, differences) in compare(run, &SceneOptions::default()) {
            println!("{} step {step}: {differences:?}", run.name);
        }
    }
}
