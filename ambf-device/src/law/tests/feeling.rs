use nalgebra::{Isometry3, UnitQuaternion};

use super::super::random::Random;
use super::*;
use crate::DeviceForce;

/// A hand whose reference is `error` away from its root link, enabled, with no dead band.
fn pulling(keys: &str, model: &str, error: Vector3<f64>) -> Hand {
    let mut hand = Hand::new(&format!("  enable on button: false\n{keys}"), model, Isometry3::identity());
    hand.input.view.root = Some(Isometry3::from_parts((-error).into(), UnitQuaternion::identity()));
    hand
}

#[test]
fn forces_rise_within_a_second_at_a_gain_of_ten() {
    let mut hand =
        pulling("  haptic gain: {linear: 10, angular: 0}\n  deadband: 0", "MTMR", Vector3::new(0.01, 0.0, 0.0));
    for tick in 0..1500 {
        let share = f64::min(f64::from(tick) * 1e-3, 1.0);
        let force = hand.tick().force.force;
        assert!((force - Vector3::new(-0.1 * share, 0.0, 0.0)).norm() < 1e-9, "tick {tick}: {force}");
    }
}

#[test]
fn forces_need_the_switch_and_a_first_press() {
    let mut hand = pulling("  haptic gain: {linear: 10, angular: 0}", "MTMR", Vector3::new(0.1, 0.0, 0.0));
    hand.device =
        HapticLoop::new(&device("  haptic gain: {linear: 10, angular: 0}"), &spec("MTMR"), Isometry3::identity());
    let output = hand.run(2.0);
    assert!(output.force == DeviceForce::zero() && !output.enabled);
    assert!(hand.press(0).enabled);
    let output = hand.tick();
    assert!(output.enabled && output.force.force.norm() < 1e-2, "it begins at zero");
    assert!((hand.run(1.0).force.force.x + 1.0).abs() < 1e-9, "for good");
    hand.input.switches.forces = false;
    assert_eq!(hand.tick().force, DeviceForce::zero());
}

#[test]
fn the_force_is_that_of_the_formula() {
    let mut random = Random::new(21);
    for _ in 0..300 {
        let (p_lin, p_ang) = (20.0 * random.share(), random.share());
        let keys = format!(
            "  haptic gain: {{linear: {p_lin}, angular: {p_ang}}}\n  deadband: 0.01\n  enable on button: false\n  max force: 4"
        );
        let (initial, root, camera, turn) = (random.pose(), random.pose(), random.rotation(), random.rotation());
        let mut hand = Hand::new(&keys, "delta.6", initial);
        hand.input.view.camera = Some(camera);
        hand.input.view.root = Some(root);
        hand.input.sample.rotation = turn;
        // Both ramps done: the slower one rises with a tenth of the gain.
        hand.input.dt = 0.02;
        let reference = hand.run(2.0 + 12.0 / f64::min(p_lin, p_ang).max(0.05)).reference;
        let force = hand.tick().force;
        let [r_c, r_g, r_s] = [camera, root.rotation, reference.rotation].map(|rotation| matrix(&rotation));
        let share = |p: f64| (0.1 * p * hand.input.time).min(1.0);
        let f = -share(p_lin) * p_lin * (reference.translation.vector - root.translation.vector);
        let t = -share(p_ang) * p_ang * (r_g * log(&(r_g.transpose() * r_s)));
        let bounded = |v: Vector3<f64>, max: f64| match v.norm() {
            length if length < 0.01 => Vector3::zeros(),
            length if length > max => v * (max / length),
            _ => v,
        };
        if share(p_lin) >= 1.0 && share(p_ang) >= 1.0 {
            assert!((force.force - r_c.transpose() * bounded(f, 4.0)).norm() < 1e-6, "{force:?}");
            assert!((force.torque - r_c.transpose() * bounded(t, 0.2)).norm() < 1e-6, "{force:?}");
        }
    }
}

#[test]
fn dead_band_and_limits() {
    let felt = |keys: &str, model: &str, x: f64| {
        let mut hand = pulling(keys, model, Vector3::new(x, 0.0, 0.0));
        hand.run(1.5).force.force.x
    };
    let keys = "  haptic gain: {linear: 10, angular: 0}\n  deadband: 0.5";
    assert_eq!(felt(keys, "Falcon", 0.049), 0.0);
    assert!((felt(keys, "Falcon", 0.051) + 0.51).abs() < 1e-9);
    assert!((felt(keys, "Falcon", 5.0) + 8.0).abs() < 1e-9, "what the device is rated for");
    let keys = "  haptic gain: {linear: 10, angular: 0}\n  max force: 2";
    assert!((felt(keys, "Falcon", 5.0) + 2.0).abs() < 1e-9, "what the file allows");
    assert_eq!(felt(keys, "Razer Hydra", 5.0), 0.0, "a tracker");
    assert_eq!(felt("", "Falcon", 5.0), 0.0, "no gain, no feedback");
    let keys = "  haptic gain: {linear: 10, angular: 0}\n  max force: -1";
    assert_eq!(felt(keys, "Falcon", 5.0), 0.0);
}

#[test]
fn gains_stay_below_what_the_device_renders() {
    let keys = "  haptic gain: {linear: 700, angular: 9}\n  workspace scaling: 10";
    let mut device = HapticLoop::new(&device(keys), &spec("MTMR"), Isometry3::identity());
    assert_eq!(device.gains(), (100.0, 1.0));
    let change = |quantity, step| GainChange { quantity, step };
    assert_eq!(device.change(change(Quantity::DeviceLinearGain, 5.0)), Some(100.0));
    assert_eq!(device.change(change(Quantity::DeviceLinearGain, -5.0)), Some(95.0));
    assert_eq!(device.change(change(Quantity::DeviceAngularGain, -5.0)), Some(0.0));
    assert_eq!(device.change(change(Quantity::EffectorLinearGain, -5.0)), None);
    assert_eq!(device.gains(), (95.0, 0.0));
}

#[test]
fn forces_are_off_at_once_and_come_back_from_zero() {
    let interruptions: [fn(&mut HapticInput); 6] = [
        |input| input.view.paused = true,
        |input| input.view.stale = true,
        |input| input.sample.valid = false,
        |input| input.sample.rotation = UnitQuaternion::new(Vector3::new(f64::NAN, 0.0, 0.0)),
        |input| input.view.root = Some(Isometry3::translation(f64::INFINITY, 0.0, 0.0)),
        |input| input.switches.forces = false,
    ];
    for away in interruptions {
        let mut hand = pulling("  haptic gain: {linear: 50, angular: 0}", "MTMR", Vector3::new(0.02, 0.0, 0.0));
        assert!((hand.run(1.5).force.force.x + 1.0).abs() < 1e-9);
        let good = hand.input;
        away(&mut hand.input);
        assert_eq!(hand.tick().force, DeviceForce::zero());
        hand.input = good;
        for tick in 0..1500 {
            let share = f64::min(f64::from(tick) * 1e-3, 1.0);
            assert!((hand.tick().force.force.x + share).abs() < 2e-3, "tick {tick}");
        }
    }
}

#[test]
fn the_clutch_sends_no_force() {
    let keys = "  haptic gain: {linear: 10, angular: 0}\n  button mapping: {a1: 3}";
    let mut hand = pulling(keys, "MTMR", Vector3::new(0.1, 0.0, 0.0));
    hand.run(1.5);
    let pressed = hand.press(3);
    assert!(pressed.clutch && pressed.force == DeviceForce::zero());
    assert!((hand.tick().force.force.x + 1.0).abs() < 1e-9);
}

#[test]
fn a_milliradian_is_felt() {
    let mut hand = pulling("  haptic gain: {linear: 0, angular: 1}\n  deadband: 0", "sigma.7", Vector3::zeros());
    hand.input.view.root = Some(Isometry3::rotation(Vector3::new(0.0, 1e-3, 0.0)));
    // A gain of 1 takes ten seconds to rise.
    let torque = hand.run(11.0).force.torque;
    assert!((torque - Vector3::new(0.0, 1e-3, 0.0)).norm() < 1e-9, "{torque}");
}

#[test]
fn modes_and_gains_follow_the_buttons() {
    let keys = "  button mapping: {a1: 1, a2: 2, next mode: 3, prev mode: 4}";
    let mut hand = Hand::new(keys, "Falcon", Isometry3::identity()).settled();
    let output = hand.press(3);
    assert_eq!((output.mode_steps, output.status), (1, Some(Status::Cleared)));
    hand.input.switches.mode = Mode::GripperJaw;
    assert_eq!(hand.tick().mode_steps, 0);
    // The Falcon senses no gripper and this one has no button for it: its opening is a state.
    assert!((hand.press(1).gripper - 0.6).abs() < 1e-12);
    hand.tick();
    for _ in 0..3 {
        hand.press(2);
        hand.tick();
    }
    assert!((hand.tick().gripper - 0.3).abs() < 1e-12);
    assert_eq!(hand.press(4).mode_steps, -1);
    hand.tick();
    for (mode, step) in Mode::ALL[2..].iter().zip([10.0, 1.0, 1.0, 1.0, 5.0, 1.0]) {
        hand.input.switches.mode = *mode;
        let quantity = mode.quantity().expect("a gain");
        let output = hand.press(1);
        assert_eq!(output.gain, Some(GainChange { quantity, step }));
        assert!(!output.clutch, "the clutch belongs to another mode");
        assert_eq!(hand.tick().gain, None);
        assert_eq!(hand.press(2).gain, Some(GainChange { quantity, step: -step }));
        hand.tick();
    }
}

/// Whatever comes in, what goes out is finite and limited.
#[test]
fn nothing_but_finite_numbers_comes_out() {
    let odd = [0.0, 1.0, -1.0, 1e-320, 1e308, -1e308, f64::INFINITY, f64::NEG_INFINITY, f64::NAN, 1e154];
    let mut random = Random::new(99);
    let keys = "  haptic gain: {linear: 100, angular: 1}\n  enable on button: false\n  workspace scaling: 8\n  \
                button mapping: {a1: 1, a2: 2, next mode: 3, prev mode: 4}";
    let mut hand = Hand::new(keys, "sigma.7", Isometry3::identity());
    let mut effector = EndEffector::new(
        &device("  controller gain: {linear: {P: 200, D: 20}, angular: {P: 9, D: 1}}"),
        &Default::default(),
    );
    let mut felt = 0;
    for _ in 0..20_000 {
        let number = |random: &mut Random| {
            if random.one_in(12) {
                odd[(random.share() * odd.len() as f64) as usize % odd.len()]
            } else {
                random.signed()
            }
        };
        let rotation = |random: &mut Random| {
            let rotation = random.rotation();
            if random.one_in(10) {
                UnitQuaternion::new_unchecked(*rotation * number(random))
            } else {
                rotation
            }
        };
        let input = &mut hand.input;
        input.sample.rotation = rotation(&mut random);
        input.view.camera = (!random.one_in(9)).then(|| rotation(&mut random));
        let root = rotation(&mut random);
        input.sample.position = Vector3::from_fn(|_, _| number(&mut random));
        input.sample.linear_velocity = random.one_in(3).then(|| Vector3::from_fn(|_, _| number(&mut random)));
        input.sample.gripper = random.one_in(2).then(|| number(&mut random));
        input.sample.buttons = (random.share() * 64.0) as u32;
        let position = Vector3::from_fn(|_, _| number(&mut random));
        input.view.root = Some(Isometry3::from_parts(position.into(), root));
        input.view.reset = random.one_in(50);
        input.switches.rotation = if random.one_in(2) { RotationRule::Absolute } else { RotationRule::Camera };
        input.switches.mode = Mode::from_index((random.share() * 255.0) as u8);
        input.dt = number(&mut random);
        input.time = if random.one_in(5) { number(&mut random) } else { 10.0 };
        input.sample.sequence += 1;
        let output = hand.device.tick(&hand.input);
        let finite = |pose: &Isometry3<f64>| {
            pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|x| x.is_finite())
        };
        assert!(finite(&output.reference) && output.force.is_finite() && (0.0..=1.0).contains(&output.gripper));
        assert!(output.force.force.norm() <= 12.0 + 1e-9 && output.force.torque.norm() <= 0.2 + 1e-9);
        assert!(output.camera.is_none_or(|motion| finite(&motion.applied(&Isometry3::identity()))));
        felt += u32::from(output.force != DeviceForce::zero());
        let driven = effector.tick(&EffectorInput {
            reference: if random.one_in(2) { output.reference } else { Isometry3::from_parts(position.into(), root) },
            pose: hand.input.view.root.expect("a pose"),
            gripper: number(&mut random),
            dt: number(&mut random),
            nominal_dt: number(&mut random),
            force_active: !random.one_in(4),
            gripping_assist: true,
        });
        for drive in [driven.linear, driven.angular].into_iter().flatten() {
            let (Drive::Force(u) | Drive::Velocity(u)) = drive;
            assert!(u.iter().all(|x| x.is_finite()));
        }
        assert!(driven.joints.is_some_and(|opening| (0.0..=1.0).contains(&opening)));
    }
    assert!(felt > 100, "the test must reach forces: {felt}");
}
