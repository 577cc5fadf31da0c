//! The driver against fake arms, over a real ROS master.

mod common;

use std::time::{Duration, Instant};

use ambf_device::{Driver, Presence};
use common::*;
use dvrk_arm::{driver, isometry, Arm, ArmOptions, Dialect, Frames, Mode, Pedal};
use fake_dvrk::{Curve, Fake, FakeOptions, Hand, Machine, Motion, Script};
use nalgebra::{UnitQuaternion, Vector3};

fn fake(namespace: &str, dialect: Dialect, options: FakeOptions) -> Fake {
    share_master();
    let report = std::sync::Arc::new(|line: std::fmt::Arguments<'_>| println!("fake: {line}"));
    Fake::start(FakeOptions { namespace: Some(namespace.to_owned()), dialect, report, ..options }).unwrap()
}

fn right(rate: f64) -> FakeOptions {
    FakeOptions { arms: vec!["MTMR".into()], rate, ..Default::default() }
}

const FORCE: Vector3<f64> = Vector3::new(1.0, 2.0, 3.0);

/// In each dialect: it is found, poses and grippers come right, the handshake is made, forces arrive turned.
#[test]
fn all_dialects_are_found_and_spoken() {
    for (number, dialect) in DIALECTS.into_iter().enumerate() {
        let namespace = format!("spoken{number}");
        let fake = fake(&namespace, dialect, right(200.0));
        let pose = isometry([0.05, -0.02, 0.01, 0.1, 0.2, 0.3]);
        fake.set_pose("MTMR", &pose);
        fake.set_gripper("MTMR", 0.75);
        let mut device = Device::open("MTMR", &[("namespace", &namespace)]);
        device.wait_valid();
        until("the pose", || (device.read().position - pose.translation.vector).norm() < 1e-9);
        until("the gripper", || (device.read().gripper.unwrap() - 0.75).abs() < 1e-9);
        let sample = device.read();
        assert!(sample.rotation.angle_to(&pose.rotation) < 1e-6, "{dialect}");
        assert_eq!(sample.buttons, 0, "{dialect}");
        assert!((device.said)().iter().any(|line| line.contains(&dialect.to_string())), "{:#?}", (device.said)());

        until("the handshake", || fake.switches("MTMR") == (Some(true), Some(true)));
        until("the first wrench", || fake.wrench_count("MTMR") > 0);
        assert_eq!(fake.wrenches("MTMR")[0].wrench.force.norm(), 0.0, "{dialect}: the first is zero");
        device.wait_felt(&fake, "MTMR", FORCE);
        let shown = fake.last_wrench("MTMR").unwrap().wrench;
        let expected = Frames::of("MTMR").origin.rotation * FORCE;
        assert!((shown.force - expected).norm() < 1e-9, "{dialect}: {} instead of {expected}", shown.force);
        assert_eq!(shown.torque.norm(), 0.0);
        if dialect.is_crtk() {
            assert_eq!(fake.commands("MTMR"), Vec::<String>::new(), "nothing is asked of an arm that is ready");
        } else {
            until("the request of a mode", || fake.commands("MTMR") == ["DVRK_EFFORT_CARTESIAN"]);
        }
        fake.set_gripper("MTMR", 0.0);
        until("the closed gripper", || device.read().buttons == 1 && device.read().gripper == Some(0.0));
    }
}

/// What can be told before an arm is opened: nothing reaches it, and its answer is that of the moment.
#[test]
fn arms_are_asked_whether_they_could_be_used() {
    let ask = |arm: &str, namespace: &str| {
        let settings = settings(&[("namespace", namespace)]);
        let info = driver().find(arm, &settings).unwrap().remove(0);
        driver().presence(&info, &settings)
    };
    for (number, dialect) in DIALECTS.into_iter().enumerate() {
        let namespace = format!("asked{number}");
        let fake = fake(&namespace, dialect, right(200.0));
        until("it is there", || match ask("MTMR", &namespace) {
            Presence::There(what) => what.contains(&dialect.to_string()),
            _ => false,
        });
        assert_eq!((fake.commands("MTMR"), fake.switches("MTMR")), (Vec::new(), (None, None)), "it is told nothing");
        let Presence::NotReady(why) = ask("MTML", &namespace) else { panic!("{dialect}: there is no MTML") };
        assert!(why.contains("MTMR"), "who is there instead: {why}");
    }
    let machine = Machine::new("DISABLED", false).unwrap();
    let _fake = fake("unready", Dialect::CrtkPose, FakeOptions { machine, ..right(200.0) });
    until(
        "its state",
        || matches!(ask("MTMR", "unready"), Presence::NotReady(why) if why.contains("DISABLED, not homed")),
    );
    let _silent = fake("silent", Dialect::CrtkPose, FakeOptions { zero_stamps: true, ..right(200.0) });
    until("no pose", || matches!(ask("MTMR", "silent"), Presence::NotReady(why) if why.contains("no valid pose")));
}

/// Late, away, back, and back as another release.
#[test]
fn arms_come_late_go_and_change_their_dialect() {
    let fake = fake("late", Dialect::Legacy, FakeOptions { present: false, ..right(200.0) });
    let mut device = Device::open("MTMR", &[("namespace", "late")]);
    until("it says that it waits", || (device.said)().iter().any(|line| line.contains("waiting for the arm")));
    assert!(!device.read().valid);
    fake.start_node();
    for dialect in [Dialect::Legacy, Dialect::CrtkTransform, Dialect::Ambf, Dialect::CrtkPose, Dialect::CrtkPose] {
        fake.set_dialect(dialect);
        device.wait_valid();
        until("its dialect", || (device.said)().iter().any(|line| line.contains(&dialect.to_string())));
        fake.clear_wrenches("MTMR");
        until("the force", || {
            device.ticks(FORCE, 10);
            fake.last_wrench("MTMR").is_some_and(|shown| shown.wrench.force.norm() > 0.0)
        });
        fake.stop_node();
        until("it is away", || !device.read().valid);
        // The haptic loop goes on meanwhile and nothing breaks.
        device.ticks(Vector3::zeros(), 50);
        let before = device.read();
        assert_eq!(device.read().position, before.position, "the last pose stays");
        fake.start_node();
    }
    device.wait_valid();
}

/// Two arms at 1 kHz each.
#[test]
fn wrenches_flow_at_the_rate_of_the_loop() {
    let fake = fake("rate", Dialect::CrtkPose, FakeOptions { rate: 1000.0, ..Default::default() });
    let mut devices = ["MTMR", "MTML"].map(|arm| (arm, Device::open(arm, &[("namespace", "rate")])));
    for (arm, device) in &mut devices {
        device.wait_valid();
        device.wait_felt(&fake, arm, FORCE);
    }
    let counts = || ["MTMR", "MTML"].map(|arm| fake.wrench_count(arm));
    let (before, begin) = (counts(), Instant::now());
    let longest = std::thread::scope(|scope| {
        let loops = devices.each_mut().map(|(_, device)| scope.spawn(|| device.ticks(FORCE, 3000)));
        loops.map(|thread| thread.join().unwrap())
    });
    let wall = begin.elapsed().as_secs_f64();
    for (after, before) in counts().into_iter().zip(before) {
        let sent = after - before;
        println!("{:.0} wrenches/s, longest tick {longest:?}", sent as f64 / wall);
        // A busy machine holds up the thread that sends, which then sends only the newest.
        assert!(sent >= 3000 / 10, "{sent} of 3000");
        assert!(sent <= 3600, "{sent} of 3000: not doubled either");
    }
}

/// The pedal's press is at the arm's hand within milliseconds.
#[test]
fn the_clutch_takes_the_force_away() {
    let fake = fake("clutch", Dialect::CrtkPose, right(1000.0));
    let mut device = Device::open("MTMR", &[("namespace", "clutch")]);
    device.wait_valid();
    device.wait_felt(&fake, "MTMR", FORCE);
    let mut fastest = Duration::MAX;
    for _ in 0..10 {
        fake.pedal(Pedal::Clutch, 1);
        let pressed = Instant::now();
        until("zero", || {
            device.ticks(FORCE, 1);
            fake.last_wrench("MTMR").is_some_and(|shown| shown.wrench.force.norm() == 0.0)
        });
        fastest = fastest.min(fake.last_wrench("MTMR").unwrap().at.saturating_duration_since(pressed));
        assert_eq!(device.read().buttons, Pedal::Clutch.bit());
        fake.clear_wrenches("MTMR");
        device.ticks(FORCE, 50);
        assert!(fake.wrenches("MTMR").iter().all(|shown| shown.wrench.force.norm() == 0.0), "while it is pressed");
        fake.pedal(Pedal::Clutch, 0);
        device.wait_felt(&fake, "MTMR", FORCE);
    }
    println!("from the press to zero: {fastest:?} at best");
    assert!(fastest < Duration::from_millis(8), "{fastest:?}");
}

#[test]
fn a_stalled_loop_and_a_closed_device_leave_no_force() {
    let fake = fake("watchdog", Dialect::CrtkPose, right(200.0));
    let mut device = Device::open("MTMR", &[("namespace", "watchdog")]);
    device.wait_valid();
    let mut fastest = Duration::MAX;
    for _ in 0..5 {
        device.wait_felt_again(&fake);
        device.ticks(FORCE, 20);
        let stalled = Instant::now();
        // Stalled: the last force is repeated for 50 ms, then there is one zero and silence.
        until("zero", || fake.last_wrench("MTMR").is_some_and(|shown| shown.wrench.force.norm() == 0.0));
        fastest = fastest.min(fake.last_wrench("MTMR").unwrap().at.saturating_duration_since(stalled));
        let (count, published) = (fake.wrench_count("MTMR"), fake.published());
        until("twenty more poses", || fake.published() > published + 20);
        assert_eq!(fake.wrench_count("MTMR"), count, "silence");
        let shown = fake.wrenches("MTMR");
        let zeros = shown.iter().rev().take_while(|shown| shown.wrench.force.norm() == 0.0).count();
        assert_eq!(zeros, 1, "one zero ends it");
    }
    assert!(fastest < Duration::from_millis(150), "repetitions went on: {fastest:?}");

    device.wait_felt_again(&fake);
    device.device.close();
    until("the two zeros", || {
        fake.wrenches("MTMR").iter().rev().take_while(|shown| shown.wrench.force.norm() == 0.0).count() >= 2
    });
    assert!(device.device.read().is_err(), "closed");

    let mut again = Device::open("MTMR", &[("namespace", "watchdog")]);
    again.wait_valid();
    again.wait_felt_again(&fake);
    drop(again);
    until("the zeros of a dropped one", || {
        fake.wrenches("MTMR").iter().rev().take_while(|shown| shown.wrench.force.norm() == 0.0).count() >= 2
    });
}

impl Device {
    fn wait_felt_again(&mut self, fake: &Fake) {
        fake.clear_wrenches("MTMR");
        self.wait_felt(fake, "MTMR", FORCE);
    }
}

/// A tap is 1, 0 and a latched 2: no pressed pedal, also for those who come later.
#[test]
fn taps_are_events() {
    let fake = fake("taps", Dialect::CrtkPose, right(200.0));
    let options = || ArmOptions { namespace: Some("taps".into()), ..Default::default() };
    let arm = Arm::connect("MTMR", options()).unwrap();
    assert!(arm.wait_until_available(PATIENCE));
    fake.pedal(Pedal::Coag, 1);
    until("the press", || arm.is_pressed(Pedal::Coag));
    for value in [1, 0, 2] {
        fake.pedal(Pedal::Camera, value);
    }
    until("the click", || arm.clicks(Pedal::Camera) == 1);
    assert_eq!((arm.is_pressed(Pedal::Camera), arm.buttons()), (false, Pedal::Coag.bit()));
    arm.close();
    let late = Arm::connect("MTMR", options()).unwrap();
    until("what is latched", || late.is_pressed(Pedal::Coag));
    assert!(!late.is_pressed(Pedal::Camera));
}

#[test]
fn samples_without_time_count_where_they_are_valid() {
    for (number, dialect) in DIALECTS.into_iter().enumerate() {
        let namespace = format!("stamps{number}");
        let fake = fake(&namespace, dialect, FakeOptions { zero_stamps: true, ..right(200.0) });
        let mut device = Device::open("MTMR", &[("namespace", &namespace)]);
        if !dialect.is_crtk() {
            device.wait_valid();
            continue;
        }
        until("it is found", || (device.said)().iter().any(|line| line.contains("dialect")));
        let published = fake.published();
        until("many samples", || fake.published() > published + 200);
        assert_eq!(device.read().sequence, 0, "{dialect}: none counts");
        fake.set_zero_stamps(false);
        device.wait_valid();
        fake.set_zero_stamps(true);
        until("it is away", || !device.read().valid);
    }
}

#[test]
fn nothing_homes_unasked() {
    for (number, dialect) in [Dialect::CrtkTransform, Dialect::CrtkPose].into_iter().enumerate() {
        let namespace = format!("homing{number}");
        let machine = Machine::new("DISABLED", false).unwrap();
        let fake = fake(&namespace, dialect, FakeOptions { machine, ..right(200.0) });
        let mut device = Device::open("MTMR", &[("namespace", &namespace)]);
        until("it says why", || (device.said)().iter().any(|line| line.contains("not ready")));
        device.ticks(FORCE, 1500);
        assert_eq!(fake.commands("MTMR"), Vec::<String>::new());
        assert!(!device.read().valid && device.read().sequence > 0, "poses come, but may not be trusted");
        device.device.close();

        let mut asked = Device::open("MTMR", &[("namespace", &namespace), ("home", "true")]);
        asked.wait_valid();
        assert_eq!(fake.commands("MTMR"), ["enable", "home"]);
        fake.fault("MTMR");
        until("the fault", || !asked.read().valid);
        asked.wait_valid();
        assert_eq!(fake.commands("MTMR"), ["enable", "home", "enable"]);
    }
    let fake = fake("homing_legacy", Dialect::Legacy, right(200.0));
    let mut device = Device::open("MTMR", &[("namespace", "homing_legacy"), ("home", "true")]);
    device.wait_valid();
    until("it says so", || (device.said)().iter().any(|line| line.contains("have no effect in this dialect")));
    until("the handshake", || fake.commands("MTMR") == ["DVRK_EFFORT_CARTESIAN"]);
}

/// The interface for programs, in a dialect that has everything.
#[test]
fn an_arm_offers_everything_to_programs() {
    let fake = fake("api", Dialect::CrtkPose, right(500.0));
    let options = ArmOptions { namespace: Some("api".into()), send_torque: true, ..Default::default() };
    let arm = Arm::connect("MTMR", options).unwrap();
    assert!(arm.wait_until_available(PATIENCE) && arm.name() == "/api/MTMR");
    assert_eq!(dvrk_arm::active_arms(Some("api")).unwrap(), ["MTMR"]);
    assert_eq!(arm.dialect(), Some(Dialect::CrtkPose));
    until("its state", || arm.is_ready() && arm.state().as_deref() == Some("ENABLED"));
    let goal = isometry([0.03, 0.02, 0.01, 0.0, 0.1, 0.0]);
    until("a servo command", || {
        arm.servo_pose(&goal).unwrap();
        (arm.pose().to_homogeneous() - goal.to_homogeneous()).norm() < 1e-6
    });
    assert!(arm.is_in_mode(Mode::CartesianPosition));
    let away = isometry([-0.03, 0.0, 0.0, 0.0, 0.0, 0.0]);
    // Sent again until it is reached: on a busy machine the last servo command may arrive after the goal.
    until("a goal is reached", || {
        let heard = arm.move_to_pose(&away).is_ok();
        heard && (arm.position() - away.translation.vector).norm() < 1e-6
    });
    until("joints", || {
        arm.servo_joints(&[0.1; 7]).unwrap();
        fake.joint_command("MTMR") == [0.1; 7]
    });
    assert_eq!(arm.joint_positions().len(), 7);

    // Force and moment keep each other's half; the measured wrench is what the fake shows.
    until("a wrench", || {
        arm.set_force(&Vector3::new(0.5, 0.0, 0.0)).unwrap();
        arm.set_moment(&Vector3::new(0.0, 0.0, 0.05)).unwrap();
        let measured = arm.measured_wrench();
        (measured.force.x - 0.5).abs() < 1e-9 && (measured.torque.z - 0.05).abs() < 1e-9
    });
    // A gravity term of one's own.
    let joints = arm.joint_positions();
    arm.set_gravity_term(2.0, 1.0, move |q| {
        assert_eq!(q.len(), joints.len());
        None
    });
    until("no term", || {
        arm.set_force(&Vector3::zeros()).unwrap();
        arm.set_moment(&Vector3::zeros()).unwrap();
        arm.measured_force().norm() < 1e-9
    });
    arm.set_gravity_term(1.0, 0.0, |q| Some(vec![9.0; q.len()]));
    until("a term, limited", || {
        arm.set_force(&Vector3::zeros()).unwrap();
        (arm.measured_force().norm() - 1.0).abs() < 1e-6
    });
    arm.clear_gravity_term();

    // An origin elsewhere moves the device frame.
    let before = arm.position();
    arm.set_origin_position(&(arm.frames().origin.translation.vector + Vector3::z() * 0.1)).unwrap();
    until("the new origin", || (arm.position() - (before - Vector3::z() * 0.1)).norm() < 1e-6);
    assert!(arm.set_tip_position(&Vector3::new(f64::NAN, 0.0, 0.0)).is_err());
    assert!(arm.set_force(&Vector3::new(f64::INFINITY, 0.0, 0.0)).is_err());

    arm.request("pause").unwrap();
    until("the pause", || !arm.is_ready() && arm.state().as_deref() == Some("PAUSED"));
    arm.request("resume").unwrap();
    until("it goes on", || arm.is_ready());
    assert_eq!(fake.commands("MTMR"), ["pause", "resume"]);
}

/// The closed loop of a hand that gives way and a stiff wall stays stable.
#[test]
fn a_hand_at_a_wall_comes_to_rest() {
    let options = FakeOptions { hand: Some(Hand::default()), ..right(1000.0) };
    let fake = fake("hand", Dialect::CrtkPose, options);
    let mut device = Device::open("MTMR", &[("namespace", "hand")]);
    device.wait_valid();
    // The wall is at z = 0.01 and pushes down with 300 N/m; the hand wants to be at 0.02 with 200 N/m: rest at 0.014.
    fake.set_pose("MTMR", &isometry([0.0, 0.0, 0.02, 0.0, 0.0, 0.0]));
    let mut settled = 0;
    until("it rests", || {
        let z = device.read().position.z;
        device.ticks(Vector3::new(0.0, 0.0, -300.0 * (z - 0.01).max(0.0)), 1);
        settled = if (z - 0.014).abs() < 5e-4 { settled + 1 } else { 0 };
        settled > 300
    });
}

/// Equation 9 at its rate, as the device sees it.
#[test]
fn the_curve_comes_as_it_is() {
    let curve = Curve { size: 0.05, ..Curve::default() };
    let motion = Motion::Curve(curve, UnitQuaternion::identity());
    let script = Script::parse("script", "0 gripper 0\n0.5 gripper 1\n1 loop").unwrap();
    let _fake = fake("curve", Dialect::CrtkTransform, FakeOptions { motion, script, ..right(500.0) });
    let mut device = Device::open("MTMR", &[("namespace", "curve")]);
    device.wait_valid();
    let (mut samples, mut grippers) = (Vec::new(), Vec::new());
    until("a round of the curve", || {
        let sample = device.read();
        if samples.last().is_none_or(|last: &Vector3<f64>| *last != sample.position) {
            samples.push(sample.position);
            grippers.push(sample.gripper.unwrap());
        }
        samples.len() > 800
    });
    for p in &samples {
        // x = S sin, y = S cos, z = 2 S sin.
        assert!((p.z - 2.0 * p.x).abs() < 1e-9, "{p}");
        assert!((p.x.hypot(p.y) - 0.05).abs() < 1e-9, "{p}");
    }
    let reaches = |f: fn(&f64) -> bool| grippers.iter().any(f);
    assert!(reaches(|g| *g < 0.1) && reaches(|g| *g > 0.9), "the gripper moves");
}
