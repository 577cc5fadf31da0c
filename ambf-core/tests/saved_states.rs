//! Saved states: what is restored goes on as it did, bit for bit.

mod saved_common;

use ambf_core::bullet::Solver;
use ambf_core::control::Profile;
use ambf_core::scene::{PhysicsOptions, PreparedModel};
use ambf_core::sim::{SavedState, StateError};
use saved_common::*;

fn physics(profile: Profile) -> PhysicsOptions {
    PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() }
}

#[test]
fn every_shipped_scene_goes_on_as_it_did() {
    for files in all_shipped() {
        for profile in [Profile::Legacy, Profile::Accurate] {
            let what = format!("{} {profile:?}", scene_name(&files));
            check(&what, &files, physics(profile), 100, 200);
        }
    }
}
