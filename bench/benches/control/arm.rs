//! An arm under position control at every step.

use std::time::Duration;

use ambf_core::bullet::Solver;
use ambf_core::control::Profile;
use ambf_core::scene::PhysicsOptions;

use super::case::Case;
use super::own::{self, Setting};
use super::plot::{log_lines, Figure, Line};
use super::report::{goal, Section};
use super::{jointed, number};

/// 1 … 32 ms.
const STEPS: [f64; 6] = [0.001, 0.002, 0.004, 0.008, 0.016, 0.032];
/// Error that pybullet's Featherstone links have at 1 ms, rad.
const PYBULLET: f64 = 7.7e-4;

fn settings() -> [Setting; 4] {
    let physics = |profile| PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
    let dantzig = |profile| PhysicsOptions { solver: Some(Solver::Dantzig), ..physics(profile) };
    let (plain, stiff) = ("", "joint erp: 0.8, joint cfm: 1e-12, ");
    [
        Setting { name: "legacy", physics: physics(Profile::Legacy), joint_keys: plain },
        Setting { name: "legacy, Dantzig", physics: dantzig(Profile::Legacy), joint_keys: stiff },
        Setting { name: "accurate", physics: physics(Profile::Accurate), joint_keys: plain },
        Setting { name: "accurate, Dantzig", physics: dantzig(Profile::Accurate), joint_keys: stiff },
    ]
}

/// Error of a run; infinite when the arm fell or flew away.
fn error(case: &Case, setting: &Setting, step: f64) -> f64 {
    let run = own::run(case, setting, step, Duration::from_secs(60)).expect("the scene of the arm loads");
    run.map_or(f64::INFINITY, |run| case.error(&run))
}

/// The table and its figure.
pub fn measure() -> (Section, Figure) {
    // Compared at multiples of the longest step.
    let case = jointed::arm_at(12, 20);
    let settings = settings();
    let errors = settings.each_ref().map(|setting| STEPS.map(|step| error(&case, setting, step)));
    let row = |(setting, errors): (&Setting, &[f64; 6])| {
        std::iter::once(setting.name.to_owned()).chain(errors.map(number)).collect::<Vec<_>>()
    };
    let largest_stable = STEPS.iter().zip(&errors[2]).take_while(|(_, error)| error.is_finite()).last();
    let largest = largest_stable.map_or("none".into(), |(step, _)| format!("{} ms", step * 1000.0));
    let lines: Vec<_> = settings
        .iter()
        .zip(&errors)
        .map(|(setting, errors)| Line {
            name: setting.name,
            points: STEPS
                .iter()
                .map(|step| step * 1000.0)
                .zip(errors.iter().copied())
                .filter(|p| p.1.is_finite())
                .collect(),
        })
        .collect();
    let figure = log_lines(
        "Arm of 7 joints under position control",
        "step, ms",
        "error, rad",
        &STEPS.map(|step| step * 1000.0),
        &lines,
    );
    let section = Section {
        title: "Arm of 7 joints: step against error",
        intro: "Every joint follows 0.3·(1 − cos 4t) rad for 3.8 s with torques of its own P and D; a command a step. Error: largest difference \
                of a joint's angle from that with the same controllers in continuous time, rad. !: beyond 0.5 rad, or lost. \"Dantzig\": with \
                that solver and a joint ERP of 0.8; there the controllers of the two profiles are all that differs.",
        header: &["", "1 ms", "2 ms", "4 ms", "8 ms", "16 ms", "32 ms"],
        rows: settings.iter().zip(&errors).map(row).collect(),
        remarks: vec![
            goal("`accurate` is stable at 16 ms", errors[2][4].is_finite(), &format!("largest stable step {largest}")),
            goal("`accurate` is as near as pybullet at 1 ms, 7.7e-4 rad", errors[2][0] <= PYBULLET, &number(errors[2][0])),
            "![Step against error](../figures/control-arm.svg)".into(),
        ],
    };
    (section, figure)
}
