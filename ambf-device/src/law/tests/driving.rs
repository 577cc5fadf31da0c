use nalgebra::{Isometry3, UnitQuaternion};

use super::super::random::Random;
use super::*;
use ambf_model::adf::{CartesianController, ControllerOutput};

const GAINS: &str = "  controller gain: {linear: {P: 200, D: 20}, angular: {P: 10, D: 0.5}}";

fn input(reference: Isometry3<f64>, pose: Isometry3<f64>) -> EffectorInput {
    EffectorInput {
        reference,
        pose,
        gripper: 0.5,
        dt: 1e-3,
        nominal_dt: 1e-3,
        force_active: true,
        gripping_assist: true,
    }
}

/// An end-effector whose ramp is done, at rest at `pose`.
fn risen(keys: &str, pose: Isometry3<f64>) -> EndEffector {
    let mut effector = EndEffector::new(&device(keys), &CartesianController::default());
    for _ in 0..2001 {
        effector.tick(&input(pose, pose));
    }
    effector
}

fn force(drive: Option<Drive>) -> Vector3<f64> {
    match drive {
        Some(Drive::Force(u)) => u,
        other => panic!("expected a force: {other:?}"),
    }
}

#[test]
fn forces_are_those_of_the_formula() {
    let mut random = Random::new(31);
    for _ in 0..300 {
        let start = random.pose();
        let mut effector = risen(GAINS, start);
        let mut before: Option<(Vector3<f64>, Vector3<f64>)> = None;
        let (mut reference, mut pose) = (random.pose(), random.pose());
        for _ in 0..20 {
            reference.translation.vector += random.vector() * 1e-3;
            reference.rotation *= UnitQuaternion::new(random.vector() * 1e-2);
            pose.rotation *= UnitQuaternion::new(random.vector() * 1e-2);
            let e = reference.translation.vector - pose.translation.vector;
            let r_g = matrix(&pose.rotation);
            let rest = r_g.transpose() * matrix(&reference.rotation);
            let q = log(&rest);
            if q.norm() > 3.0 {
                break; // the way round may flip, and the matrix formula is imprecise
            }
            let dt = 1e-3 + 1e-3 * random.share();
            let output = effector.tick(&EffectorInput { dt, ..input(reference, pose) });
            if let Some((e_prev, q_prev)) = before {
                let (de, dq) = ((e - e_prev) / dt, (q - q_prev) / dt);
                assert!((force(output.linear) - (200.0 * e + 20.0 * de)).norm() < 1e-6);
                assert!((force(output.angular) - r_g * (10.0 * q + 0.5 * dq)).norm() < 1e-4);
            }
            before = Some((e, q));
        }
    }
}

#[test]
fn the_ramp_takes_two_seconds() {
    let mut effector = EndEffector::new(&device(GAINS), &CartesianController::default());
    let target = Isometry3::translation(0.1, 0.0, 0.0);
    for tick in 0..2500 {
        let share = f64::min(f64::from(tick) * 0.5e-3, 1.0);
        let u = force(effector.tick(&input(target, Isometry3::identity())).linear);
        assert!((u.x - 20.0 * share).abs() < 1e-6, "tick {tick}: {u}");
    }
}

#[test]
fn longer_steps_shrink_the_gain_if_wanted() {
    let target = Isometry3::translation(0.1, 0.0, 0.0);
    for (key, shares) in [("  time scaled gain: true\n", [1.0, 1.0, 0.1]), ("", [1.0, 1.0, 1.0])] {
        let mut effector = risen(&format!("{key}{GAINS}"), Isometry3::identity());
        effector.tick(&input(target, Isometry3::identity()));
        for (dt, share) in [0.5e-3, 1e-3, 10e-3].into_iter().zip(shares) {
            let u = force(effector.tick(&EffectorInput { dt, ..input(target, Isometry3::identity()) }).linear);
            assert!((u.x - 20.0 * share).abs() < 1e-9, "{dt}: {u}");
        }
    }
}

#[test]
fn each_half_has_its_own_output_type_and_velocities_have_no_damping() {
    let mut effector = risen("  controller gain: {angular: {P: 3, D: 1}}", Isometry3::identity());
    let target = Isometry3::new(Vector3::new(0.1, 0.0, 0.0), Vector3::new(0.0, 0.2, 0.0));
    let output = effector.tick(&input(target, Isometry3::identity()));
    assert_eq!(output.linear, Some(Drive::Velocity(Vector3::new(1.0, 0.0, 0.0))), "the default, P = 10, without D");
    // One step after rest the damping of 1 has its full say: 0.2 rad in 1 ms.
    assert!((force(output.angular) - Vector3::new(0.0, 3.0 * 0.2 + 0.2 / 1e-3, 0.0)).norm() < 1e-6);
    // Without `controller gain` the root link keeps its own controller.
    let mut own = CartesianController::default();
    (own.linear.gains.p, own.linear.output) = (70.0, ControllerOutput::Force);
    let mut effector = EndEffector::new(&device(""), &own);
    for _ in 0..2001 {
        effector.tick(&input(target, target));
    }
    let output = effector.tick(&EffectorInput { dt: 0.0, ..input(target, Isometry3::identity()) });
    assert!((force(output.linear).x - 7.0).abs() < 1e-9 && matches!(output.angular, Some(Drive::Velocity(_))));
}

#[test]
fn another_client_silences_both_kinds_of_output() {
    let target = Isometry3::translation(0.1, 0.0, 0.0);
    for keys in [GAINS, ""] {
        let mut effector = risen(keys, Isometry3::identity());
        let silent = EffectorInput { force_active: false, ..input(target, Isometry3::identity()) };
        let output = effector.tick(&silent);
        assert_eq!((output.linear, output.angular), (None, None));
        assert!(output.joints.is_some());
        // It comes back without the kick of a derivative over the time between.
        let output = effector.tick(&input(target, Isometry3::identity()));
        let Some(Drive::Force(u) | Drive::Velocity(u)) = output.linear else { panic!("an output") };
        assert!((u.x - if keys.is_empty() { 1.0 } else { 20.0 }).abs() < 1e-9, "{u}");
    }
}

#[test]
fn a_milliradian_drives_and_half_a_turn_stays_continuous() {
    let axis = Vector3::new(0.0, 0.6, 0.8);
    let turned = |angle: f64| Isometry3::rotation(axis * angle);
    let mut effector = risen(GAINS, Isometry3::identity());
    effector.tick(&input(turned(1e-3), Isometry3::identity()));
    let u = force(effector.tick(&input(turned(1e-3), Isometry3::identity())).angular);
    assert!((u - axis * 1e-2).norm() < 1e-9, "{u}");
    let (step, start) = (1e-4, f64::to_radians(179.0));
    let mut effector = risen(GAINS, Isometry3::identity());
    effector.tick(&input(turned(start), Isometry3::identity()));
    let mut angle = start + step;
    while angle < f64::to_radians(181.0) {
        let u = force(effector.tick(&input(turned(angle), Isometry3::identity())).angular);
        // Past half a turn the other way is shorter. The damping sees a steady turn either way.
        let way = if angle <= std::f64::consts::PI { angle } else { angle - std::f64::consts::TAU };
        assert!((u - axis * (10.0 * way + 0.5 * step / 1e-3)).norm() < 1e-6, "{angle}: {u}");
        angle += step;
    }
}

#[test]
fn after_a_reset_it_rises_anew() {
    let target = Isometry3::translation(0.1, 0.0, 0.0);
    let mut effector = risen(GAINS, target);
    effector.reset();
    // The reference of before, then that of after: no kick of the derivative.
    for (reference, limit) in [(target, 1e-9), (Isometry3::identity(), 1.1), (Isometry3::identity(), 1e-9)] {
        let u = force(effector.tick(&input(reference, Isometry3::identity())).linear);
        assert!(u.norm() < limit, "{u}");
    }
}

#[test]
fn joints_and_grip_follow_the_opening() {
    let mut effector = EndEffector::new(&device(""), &CartesianController::default());
    let mut at = |gripper, gripping_assist| {
        let rest = input(Isometry3::identity(), Isometry3::identity());
        let output = effector.tick(&EffectorInput { gripper, gripping_assist, ..rest });
        (output.joints, output.grip)
    };
    assert_eq!(at(0.0, true), (Some(0.0), Grip::Attach));
    assert_eq!(at(0.49, false), (Some(0.49), Grip::Leave));
    assert_eq!(at(2.0, true), (Some(1.0), Grip::Release));
    let mut effector = EndEffector::new(&device("  enable joint control: false"), &CartesianController::default());
    assert_eq!(effector.tick(&input(Isometry3::identity(), Isometry3::identity())).joints, None);
}

#[test]
fn gains_of_end_effectors_change() {
    let mut effector = EndEffector::new(&device(GAINS), &CartesianController::default());
    let mut change = |quantity, step| effector.change(GainChange { quantity, step });
    assert_eq!(change(Quantity::EffectorLinearGain, -300.0), Some(0.0));
    assert_eq!(change(Quantity::EffectorAngularGain, 1.0), Some(11.0));
    assert_eq!(change(Quantity::EffectorLinearDamping, -30.0), Some(0.01));
    assert_eq!(change(Quantity::EffectorAngularDamping, -30.0), Some(0.0));
    assert_eq!(change(Quantity::DeviceLinearGain, 1.0), None);
}
