//! The arms of the C++ simulator's own scenes, where these are at hand.

mod common;

use ambf_core::bullet::Solver;
use ambf_core::control::Profile;
use ambf_core::scene::PhysicsOptions;
use common::{legacy_arm, LEGACY_ARMS, PROFILES};

fn profile(profile: Profile) -> PhysicsOptions {
    PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() }
}

#[test]
fn they_stand_still_while_they_are_free() {
    for chosen in PROFILES {
        for (name, space, body) in LEGACY_ARMS {
            let Some(mut bench) = legacy_arm(name, profile(chosen)) else { return };
            bench.run(2.0);
            let before = bench.body(body).translation.vector;
            bench.topics.send(&format!("{space}/free"), &[]);
            bench.run(5.0);
            let drift = (bench.body(body).translation.vector - before).norm();
            println!("{chosen:?} {name}: {:.4} mm", drift * 1e3);
            // Their parallelograms are strained by axes and pivots that do not fit, and what gives way moves the tool.
            assert!(drift < 5e-3, "{chosen:?} {name}: {drift} m");
        }
    }
}

/// The parallelogram of this PSM has more joints than a plane needs, with axes that are up to 0.2 deg from parallel, and a
/// ball joint at the remote centre of motion: rigid joints would lock it.
#[test]
fn the_pitch_of_the_psm_obeys() {
    let soft =
        PhysicsOptions { solver: Some(Solver::SequentialImpulse), joint_erp: Some(0.2), ..profile(Profile::Accurate) };
    for physics in [profile(Profile::Legacy), profile(Profile::Accurate), soft] {
        let Some(mut bench) = legacy_arm("psm", physics) else { return };
        bench.run(1.0);
        bench.send_positions("/PSM1/move_jp", &[0.3, 0.3, 0.1, 0.3, 0.3]);
        bench.run(4.0);
        for joint in ["baselink-yawlink", "yawlink-pitchbacklink", "maininsertionlink-toolrolllink"] {
            let position = bench.joint(joint);
            assert!((position - 0.3).abs() < 2e-3, "{joint}: {position} rad");
        }
    }
}
