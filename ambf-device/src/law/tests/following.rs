use nalgebra::{Isometry3, UnitQuaternion};

use super::super::random::Random;
use super::*;

/// References by sections "Position" and "Orientation" of the document, with matrices and the hand as is.
struct Oracle {
    r_init: Matrix3<f64>,
    r_off: Matrix3<f64>,
    r_c: Matrix3<f64>,
    s: f64,
    x_p: Vector3<f64>,
    r_p: Matrix3<f64>,
    o_s: Vector3<f64>,
    r_o: Matrix3<f64>,
    x_s: Vector3<f64>,
    r_s: Matrix3<f64>,
    down: bool,
}

impl Oracle {
    fn tick(&mut self, hand: &Isometry3<f64>, pressed: bool, hold: bool, rule: RotationRule) {
        let (x_h, r_h) = (hand.translation.vector, matrix(&hand.rotation));
        if pressed && !self.down {
            (self.o_s, self.r_o) = (self.x_s, self.r_s);
        }
        if pressed || hold {
            (self.x_p, self.r_p) = (x_h, r_h);
        }
        self.down = pressed;
        self.x_s = self.o_s + self.s * self.r_c * (x_h - self.x_p);
        self.r_s = match rule {
            RotationRule::Absolute => self.r_init * self.r_off * r_h * self.r_off.transpose(),
            RotationRule::Camera => self.r_o * self.r_c * self.r_p.transpose() * r_h * self.r_c.transpose(),
        };
    }
}

#[test]
fn references_are_those_of_the_formulas() {
    let mut random = Random::new(11);
    for trial in 0..60 {
        let rule = if trial % 2 == 0 { RotationRule::Absolute } else { RotationRule::Camera };
        let (root, camera) = (random.pose(), random.rotation());
        let (s, [r, p, y]) = (0.1 + 10.0 * random.share(), [(); 3].map(|()| 3.0 * random.signed()));
        let keys = format!(
            "  workspace scaling: {s}\n  orientation offset: {{r: {r}, p: {p}, y: {y}}}\n  button mapping: {{a1: 4, a2: 7}}"
        );
        let mut hand = Hand::new(&keys, "MTMR", root);
        hand.input.view.camera = Some(camera);
        hand.input.switches.rotation = rule;
        hand.input.dt = 0.01;
        let mut oracle = Oracle {
            r_init: matrix(&root.rotation),
            r_off: matrix(&UnitQuaternion::from_euler_angles(r, p, y)),
            r_c: matrix(&camera),
            s,
            x_p: Vector3::zeros(),
            r_p: Matrix3::identity(),
            o_s: root.translation.vector,
            r_o: matrix(&root.rotation),
            x_s: root.translation.vector,
            r_s: matrix(&root.rotation),
            down: false,
        };
        let mut pose = random.pose();
        for _ in 0..800 {
            pose.translation.vector += random.vector() * 1e-2;
            pose.rotation *= UnitQuaternion::new(random.vector() * 0.05);
            // Presses of some length, of either button, in any order.
            if random.one_in(40) {
                hand.input.sample.buttons = if random.one_in(2) { 1 << 4 } else { 1 << 7 };
            } else if random.one_in(20) {
                hand.input.sample.buttons = 0;
            }
            (hand.input.sample.position, hand.input.sample.rotation) = (pose.translation.vector, pose.rotation);
            let output = hand.tick();
            let time = hand.input.time;
            oracle.tick(&pose, hand.input.sample.buttons != 0, time < 3.0, rule);
            assert_eq!(output.holding, time < 3.0);
            assert!((output.reference.translation.vector - oracle.x_s).norm() < 1e-9, "at {time}");
            // The orientation catches up with the hand in the first second.
            if rule == RotationRule::Camera || time > 1.1 {
                assert!((matrix(&output.reference.rotation) - oracle.r_s).norm() < 1e-9, "at {time}");
            }
        }
    }
}

#[test]
fn one_centimetre_of_the_hand_is_five_along_the_camera() {
    let camera = UnitQuaternion::new(Vector3::new(0.4, -0.3, 1.2));
    let mut hand = Hand::new("  workspace scaling: 5", "MTMR", Isometry3::identity());
    hand.input.view.camera = Some(camera);
    let mut hand = hand.settled();
    hand.input.sample.position.x += 0.01;
    let moved = hand.tick().reference.translation.vector;
    assert!((moved - matrix(&camera).column(0) * 0.05).norm() < 1e-12);
}

#[test]
fn the_clutch_freezes_exactly_and_releases_without_a_jump() {
    let mut hand = Hand::new("  workspace scaling: 3\n  button mapping: {a1: 1}", "MTMR", Isometry3::identity());
    hand.input.switches.rotation = RotationRule::Camera;
    let mut hand = hand.settled();
    let mut other = Hand::new("  workspace scaling: 3\n  button mapping: {a1: 1}", "MTML", Isometry3::identity());
    other.input.time = 10.0;
    let mut random = Random::new(5);
    let mut last = hand.tick().reference;
    let mut frozen = None;
    for tick in 0..6000 {
        let step = random.vector() * 1e-3;
        for hand in [&mut hand, &mut other] {
            hand.input.sample.position += step;
            hand.input.sample.rotation *= UnitQuaternion::new(step);
        }
        let pressed = tick % 1000 >= 500;
        hand.input.sample.buttons = u32::from(pressed) << 1;
        let output = hand.tick();
        assert_eq!(output.clutch, pressed);
        if pressed {
            let frozen = frozen.get_or_insert(last).translation;
            assert_eq!(output.reference.translation, frozen);
            assert!(apart(&output.reference, &last).1 < 1e-12);
        } else {
            frozen = None;
            let (moved, turned) = apart(&output.reference, &last);
            assert!((moved - 3.0 * step.norm()).abs() < 1e-9 && (turned - step.norm()).abs() < 1e-9);
        }
        last = output.reference;
        // The other device moves on whatever the first one does.
        let output = other.tick();
        assert!(!output.clutch && !output.holding);
    }
    let whole = other.input.sample.position * 3.0;
    let lost = other.tick().reference.translation.vector - whole;
    assert!(lost.norm() < 3.0 * 2e-3, "only the first sample is lost: {lost}");
}

#[test]
fn nothing_moves_during_the_start_up_hold() {
    for (model, hold) in [("Falcon", 3.0), ("Razer Hydra", 5.0)] {
        let root = Isometry3::translation(1.0, 2.0, 3.0);
        let mut hand = Hand::new("  workspace scaling: 2", model, root);
        while hand.input.time + hand.input.dt < hold {
            hand.input.sample.position += Vector3::new(1e-4, 0.0, 0.0);
            let output = hand.tick();
            assert_eq!((output.reference.translation, output.holding), (root.translation, true));
        }
        let before = hand.input.sample.position;
        hand.input.time = hold;
        hand.input.sample.position += Vector3::new(1e-3, 0.0, 0.0);
        let moved = hand.tick().reference.translation.vector - root.translation.vector;
        assert!((moved - (hand.input.sample.position - before) * 2.0).norm() < 1e-12, "{model}: {moved}");
    }
}

/// Does `away` to the input for a while, in which the hand moves and turns, and says how far the reference was from
/// rest at most, before and in the second after it.
fn jump(rule: RotationRule, away: impl Fn(&mut HapticInput)) -> (f64, f64) {
    let mut hand = Hand::new("  workspace scaling: 4", "MTMR", Isometry3::translation(0.1, 0.2, 0.3));
    hand.input.switches.rotation = rule;
    let mut hand = hand.settled();
    hand.input.sample.position = Vector3::new(0.02, 0.0, 0.01);
    let before = hand.tick().reference;
    let (good, mut worst) = (hand.input, (0.0f64, 0.0f64));
    for _ in 0..50 {
        away(&mut hand.input);
        let output = hand.tick();
        assert!(output.holding && output.force == crate::DeviceForce::zero());
        let (x, r) = apart(&output.reference, &before);
        worst = (worst.0.max(x), worst.1.max(r));
    }
    hand.input = good;
    hand.input.sample.position += Vector3::new(0.05, -0.02, 0.0);
    hand.input.sample.rotation *= UnitQuaternion::new(Vector3::new(0.0, 1.5, 0.3));
    let mut last = before;
    for _ in 0..1000 {
        let output = hand.tick();
        let (x, _) = apart(&output.reference, &before);
        // The orientation may catch up, but not at once.
        let (_, r) = apart(&output.reference, &last);
        worst = (worst.0.max(x), worst.1.max(r));
        last = output.reference;
    }
    hand.input.sample.position.x += 0.01;
    let (moved, _) = apart(&hand.tick().reference, &last);
    assert!((moved - 0.04).abs() < 1e-9, "it follows again");
    worst
}

#[test]
fn interruptions_hold_the_reference_and_end_without_a_jump() {
    let interruptions: [fn(&mut HapticInput); 8] = [
        |input| input.sample.valid = false,
        |input| input.sample.position.x = f64::NAN,
        |input| input.sample.rotation = UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(0.0, 0.0, 0.0, 0.0)),
        |input| input.sample.gripper = Some(f64::INFINITY),
        |input| input.view.root = None,
        |input| input.view.root = Some(Isometry3::translation(f64::NAN, 0.0, 0.0)),
        |input| input.view.camera = Some(UnitQuaternion::new(Vector3::new(f64::NAN, 0.0, 0.0))),
        |input| input.view.paused = true,
    ];
    for away in interruptions {
        let (x, r) = jump(RotationRule::Camera, away);
        assert!(x < 1e-12 && r < 1e-7, "{x} m, {r} rad");
        let (x, r) = jump(RotationRule::Absolute, away);
        assert!(x < 1e-12 && r < 2e-3, "{x} m, {r} rad");
    }
}

#[test]
fn changing_the_rule_does_not_jump() {
    let mut random = Random::new(3);
    let mut hand = Hand::new("  orientation offset: {r: 1, p: 0, y: 2}", "MTMR", random.pose());
    hand.input.view.camera = Some(random.rotation());
    let mut hand = hand.settled();
    let mut last = hand.tick().reference;
    for tick in 0..5000 {
        if tick % 1500 == 0 {
            hand.input.switches.rotation = match hand.input.switches.rotation {
                RotationRule::Absolute => RotationRule::Camera,
                RotationRule::Camera => RotationRule::Absolute,
            };
        }
        hand.input.sample.rotation *= UnitQuaternion::new(Vector3::new(1e-3, 0.0, 0.0));
        let reference = hand.tick().reference;
        assert!(apart(&reference, &last).1 < 6e-3, "at {tick}");
        last = reference;
    }
}

#[test]
fn a_camera_that_turns_does_not_move_the_tool_of_a_hand_at_rest() {
    for rule in [RotationRule::Absolute, RotationRule::Camera] {
        let mut hand = Hand::new("  workspace scaling: 2", "MTMR", Isometry3::identity());
        hand.input.view.camera = Some(UnitQuaternion::identity());
        hand.input.switches.rotation = rule;
        let mut hand = hand.settled();
        hand.input.sample.position = Vector3::new(0.1, 0.0, 0.0);
        let before = hand.tick().reference;
        let camera = UnitQuaternion::new(Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
        hand.input.view.camera = Some(camera);
        let (moved, turned) = apart(&hand.tick().reference, &before);
        assert!(moved < 1e-12 && turned < 1e-7);
        // From now on x of the hand is y of the world.
        hand.input.sample.position.x += 0.01;
        let way = hand.tick().reference.translation.vector - before.translation.vector;
        assert!((way - Vector3::new(0.0, 0.02, 0.0)).norm() < 1e-12, "{way}");
    }
}

#[test]
fn a_reset_returns_to_the_initial_pose_and_goes_on_from_there() {
    let root = Isometry3::new(Vector3::new(0.3, 0.0, 1.0), Vector3::new(0.0, 0.5, 0.0));
    let mut hand = Hand::new("  workspace scaling: 5", "MTMR", root);
    hand.input.switches.rotation = RotationRule::Camera;
    let mut hand = hand.settled();
    hand.input.sample.position = Vector3::new(0.1, 0.1, 0.1);
    hand.input.sample.rotation = UnitQuaternion::new(Vector3::new(0.0, 0.0, 1.0));
    let (moved, turned) = apart(&hand.tick().reference, &root);
    assert!(moved > 0.1 && turned > 0.1);
    hand.input.view.reset = true;
    let (moved, turned) = apart(&hand.tick().reference, &root);
    assert!(moved < 1e-12 && turned < 1e-7);
    hand.input.view.reset = false;
    hand.input.sample.position.y += 0.01;
    let (moved, _) = apart(&hand.tick().reference, &root);
    assert!((moved - 0.05).abs() < 1e-12);
}

#[test]
fn the_camera_button_moves_cameras_and_freezes_the_tool() {
    let mut hand = Hand::new("  button mapping: {a1: 1, a2: 2}", "MTMR", Isometry3::identity());
    let camera = UnitQuaternion::new(Vector3::new(0.2, 0.0, 0.0));
    hand.input.view.camera = Some(camera);
    hand.input.sample.linear_velocity = Some(Vector3::new(0.0, 0.1, 0.0));
    let mut hand = hand.settled();
    let before = hand.tick();
    assert_eq!(before.camera, None);
    hand.input.sample.buttons = 1 << 2;
    let turn = UnitQuaternion::new(Vector3::new(0.0, 0.0, 0.1));
    hand.input.sample.rotation *= turn;
    hand.input.sample.position.y += 0.01;
    let output = hand.tick();
    let motion = output.camera.expect("a motion");
    assert!(output.camera_pressed && output.status == Some(Status::Camera));
    assert!((motion.displacement - Vector3::new(0.0, 1e-3, 0.0)).norm() < 1e-12);
    assert!(motion.rotation.angle_to(&(camera * turn)) < 1e-7);
    assert_eq!(output.reference.translation, before.reference.translation);
    hand.input.sample.buttons = 0;
    assert_eq!(hand.tick().status, Some(Status::Cleared));
}

#[test]
fn a_camera_that_turns_all_the_time_loses_no_motion_of_the_hand() {
    let mut hand = Hand::new("  workspace scaling: 2", "MTMR", Isometry3::identity()).settled();
    let mut expected = hand.tick().reference.translation.vector;
    for tick in 0..500 {
        let camera = UnitQuaternion::new(Vector3::new(0.0, 2e-3 * f64::from(tick), 0.0));
        hand.input.view.camera = Some(camera);
        let step = Vector3::new(1e-4, 0.0, -2e-4);
        hand.input.sample.position += step;
        expected += matrix(&camera) * step * 2.0;
        let moved = hand.tick().reference.translation.vector;
        assert!((moved - expected).norm() < 1e-9, "tick {tick}");
    }
}

#[test]
fn what_was_pressed_or_moved_during_an_interruption_does_nothing_after_it() {
    let keys = "  button mapping: {a1: 1, a2: 2, next mode: 3}";
    let mut hand = Hand::new(keys, "MTMR", Isometry3::identity());
    hand.input.view.camera = Some(UnitQuaternion::identity());
    let mut hand = hand.settled();
    hand.tick();
    hand.input.sample.valid = false;
    hand.tick();
    hand.input.sample.valid = true;
    hand.input.sample.buttons = 0b1100;
    hand.input.sample.position.x = 0.3;
    let output = hand.tick();
    assert_eq!((output.mode_steps, output.status), (0, None));
    assert!(output.camera_pressed);
    // The velocity that is estimated knows nothing of where the hand was before.
    assert_eq!(output.camera.expect("a motion").displacement, Vector3::zeros());
}

#[test]
fn cameras_stop_when_nothing_new_is_measured() {
    let mut hand = Hand::new("  button mapping: {a2: 2}", "MTMR", Isometry3::identity());
    hand.input.view.camera = Some(UnitQuaternion::identity());
    let mut hand = hand.settled();
    hand.input.sample.buttons = 0b100;
    for measured in [None, Some(Vector3::new(0.0, 1.0, 0.0))] {
        hand.input.sample.linear_velocity = measured;
        for _ in 0..20 {
            hand.input.sample.position.y += 1e-3;
            hand.tick();
        }
        // The same sample again and again.
        let moved: Vec<_> =
            (0..200).map(|_| hand.device.tick(&hand.input).camera.expect("a motion").displacement.y).collect();
        assert!((moved[0] - 0.01).abs() < 1e-9 && moved[199] == 0.0, "{moved:?}");
    }
}
