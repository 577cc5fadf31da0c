//! The driver against a fake HD library with a real scheduler thread.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;
use std::path::PathBuf;
use std::thread::sleep;
use std::time::{Duration, Instant};

use ambf_device::{
    DeviceError, DeviceForce, DeviceInfo, DeviceLog, DeviceSample, Driver, InputDevice, Setting, Settings,
};
use fake_hd::{Fake, Force};
use nalgebra::{UnitQuaternion, Vector3};
use touch::{Touch, TouchDriver};

const PATIENCE: Duration = Duration::from_secs(20);

fn settings(entries: &[(&str, &str)]) -> Settings {
    let entry = |(key, value): &(&str, &str)| {
        ((*key).to_owned(), Setting { value: (*value).to_owned(), place: String::from("devices.yaml:3") })
    };
    Settings::new(entries.iter().map(entry).collect::<BTreeMap<_, _>>(), PathBuf::from("/devices"))
}

fn open_with(fake: &Fake, device: &str, model: &str, more: &[(&str, &str)]) -> Result<Touch, DeviceError> {
    open_logged(fake, device, model, more, &DeviceLog::new().0)
}

fn open_logged(
    fake: &Fake,
    device: &str,
    model: &str,
    more: &[(&str, &str)],
    log: &DeviceLog,
) -> Result<Touch, DeviceError> {
    let library = fake.path().to_str().unwrap();
    let settings = settings(&[&[("library", library), ("device", device)], more].concat());
    let found = TouchDriver.find(model, &settings)?;
    assert_eq!(found, [DeviceInfo { model: model.to_owned(), identity: device.to_owned() }]);
    TouchDriver.open_touch(&found[0], &settings, log)
}

fn open(fake: &Fake, device: &str) -> Touch {
    open_with(fake, device, "Touch", &[]).unwrap()
}

/// A library with one device, at rest.
fn one() -> (Fake, Touch) {
    let fake = Fake::new(&[("Arm", "Touch")]).unwrap();
    let touch = open(&fake, "Arm");
    (fake, touch)
}

/// Waits until something is so; no test may depend on a quiet machine.
fn until(what: &str, mut so: impl FnMut() -> bool) {
    let start = Instant::now();
    while !so() {
        assert!(start.elapsed() < PATIENCE, "{what} did not happen");
        sleep(Duration::from_micros(300));
    }
}

/// The first sample that is as wanted.
fn sample_where(touch: &mut Touch, what: &str, mut wanted: impl FnMut(&DeviceSample) -> bool) -> DeviceSample {
    let mut sample = touch.read().unwrap();
    until(what, || {
        sample = touch.read().unwrap();
        wanted(&sample)
    });
    sample
}

/// A valid sample measured after now.
fn fresh(touch: &mut Touch) -> DeviceSample {
    let sequence = touch.read().unwrap().sequence;
    sample_where(touch, "a new sample", |sample| sample.valid && sample.sequence > sequence + 1)
}

fn newton(x: f64, y: f64, z: f64) -> DeviceForce {
    DeviceForce { force: Vector3::new(x, y, z), ..DeviceForce::zero() }
}

/// Writes a force until the motors have one that is as wanted.
fn write_until(fake: &Fake, touch: &mut Touch, force: &DeviceForce, wanted: impl Fn(&Force) -> bool) -> Force {
    let mut felt = None;
    until("the force", || {
        touch.write(force).unwrap();
        felt = fake.newest_force("Arm").filter(|felt| wanted(felt));
        felt.is_some()
    });
    felt.unwrap()
}

fn norm(force: &Force) -> f64 {
    Vector3::from(force.force).norm()
}

/// All forces from frame `first` on.
fn forces(fake: &Fake, first: usize) -> Vec<Force> {
    (first..fake.frames("Arm")).map_while(|frame| fake.force("Arm", frame)).collect()
}

#[test]
fn millimetres_of_hd_are_metres_in_the_frame_of_devices() {
    let (fake, mut touch) = one();
    for (pose, expected) in [("0 0 10", [0.01, 0.0, 0.0]), ("10 0 0", [0.0, 0.01, 0.0]), ("0 10 0", [0.0, 0.0, 0.01])] {
        fake.tell(&format!("Arm: pose {pose}"));
        let sample = fresh(&mut touch);
        assert!((sample.position - Vector3::from(expected)).norm() < 1e-12, "{pose}: {:?}", sample.position);
        assert_eq!(sample.linear_velocity, Some(Vector3::zeros()));
    }
}

#[test]
fn rotations_are_in_the_frame_of_devices_and_orthonormal() {
    let (fake, mut touch) = one();
    let turns = [("1 0 0 90", Vector3::y_axis()), ("0 1 0 90", Vector3::z_axis()), ("0 0 1 90", Vector3::x_axis())];
    for (turn, axis) in turns {
        fake.tell(&format!("Arm: turn {turn}"));
        let sample = fresh(&mut touch);
        // The matrix of the library is off by 1e-4.
        let angle = sample.rotation.angle_to(&UnitQuaternion::from_axis_angle(&axis, FRAC_PI_2));
        assert!(angle < 5e-4, "{turn}: {angle}");
        assert!((sample.rotation.norm() - 1.0).abs() < 1e-12);
    }
}

#[test]
fn velocity_agrees_with_the_motion() {
    let (fake, mut touch) = one();
    fake.tell("Arm: circle 40 0.5");
    // Stamps are those of the callback, which may lose its core before it measures: one undisturbed pair is enough.
    until("a velocity that agrees", || {
        let a = fresh(&mut touch);
        let b = sample_where(&mut touch, "5 ms", |b| b.stamp > a.stamp + Duration::from_millis(5));
        let mean = (b.position - a.position) / (b.stamp - a.stamp).as_secs_f64();
        let said = 0.5 * (a.linear_velocity.unwrap() + b.linear_velocity.unwrap());
        // 40 mm at 0.5 Hz: 126 mm/s.
        (mean - said).norm() < 0.02 && (said.norm() - 0.04 * std::f64::consts::PI).abs() < 0.01
    });
}

#[test]
fn buttons_and_angles_come_along() {
    let (fake, mut touch) = one();
    fake.tell("Arm: buttons 2");
    fake.tell("Arm: joints 0.1 0.2 0.3");
    fake.tell("Arm: gimbal -1 -2 -3");
    let sample = fresh(&mut touch);
    assert!(sample.is_pressed(1) && !sample.is_pressed(0));
    assert_eq!(sample.gripper, None);
    assert_eq!((touch.joint_angles(), touch.gimbal_angles()), ([0.1, 0.2, 0.3], [-1.0, -2.0, -3.0]));
    assert_eq!(touch.serial(), "FAKE0000");
}

#[test]
fn forces_reach_the_motors_in_the_frame_of_hd() {
    let (fake, mut touch) = one();
    assert_eq!(fake.tell("Arm: enabled"), "1 1", "force output and clamping are on");
    let felt = write_until(&fake, &mut touch, &newton(1.0, 2.0, -0.5), |felt| norm(felt) > 0.1);
    assert_eq!(felt.force, [2.0, -0.5, 1.0]);
    assert_eq!(felt.torque, [0.0; 3], "a Touch moves no rotation");
}

#[test]
fn torques_are_millinewton_metres() {
    let fake = Fake::new(&[("Arm", "PHANTOM Premium 1.5 6DOF")]).unwrap();
    let mut touch = open_with(&fake, "Arm", "PHANTOM Premium 1.5 6DOF", &[]).unwrap();
    let force = DeviceForce { torque: Vector3::new(0.01, 0.02, 0.03), ..DeviceForce::zero() };
    let felt = write_until(&fake, &mut touch, &force, |felt| felt.torque != [0.0; 3]);
    let off = Vector3::from(felt.torque) - Vector3::new(20.0, 30.0, 10.0);
    assert!(off.norm() < 1e-9, "{felt:?}");
    fake.tell("Arm: pose 0 0 0");
    assert!((fresh(&mut touch).position.z + 0.10).abs() < 1e-12, "its origin is 0.10 m lower");
    // 0.188 N·m is its limit.
    let force = DeviceForce { torque: Vector3::new(0.0, 0.0, 5.0), ..DeviceForce::zero() };
    let felt = write_until(&fake, &mut touch, &force, |felt| felt.torque[1] > 100.0);
    assert!((felt.torque[1] - 188.0).abs() < 1e-9, "{felt:?}");
}

#[test]
fn forces_are_limited_before_the_library_has_to() {
    let (fake, mut touch) = one();
    let first = fake.frames("Arm");
    let felt = write_until(&fake, &mut touch, &newton(0.0, 300.0, 400.0), |felt| norm(felt) > 1.0);
    assert!((norm(&felt) - 3.3).abs() < 1e-9 && (felt.force[0] - 1.98).abs() < 1e-9, "{felt:?}");
    assert!(forces(&fake, first).iter().all(|felt| norm(felt) < 3.3 + 1e-9));
    let nothing = write_until(&fake, &mut touch, &newton(f64::NAN, 0.0, 1.0), |felt| norm(felt) == 0.0);
    assert_eq!(nothing.force, [0.0; 3]);
}

#[test]
fn a_simulator_that_stalls_leaves_no_force() {
    let (fake, mut touch) = one();
    write_until(&fake, &mut touch, &newton(0.0, 0.0, 2.0), |felt| norm(felt) > 1.9);
    touch.write(&newton(0.0, 0.0, 2.0)).unwrap();
    let first = fake.frames("Arm");
    until("the watchdog", || fake.newest_force("Arm").is_some_and(|felt| norm(&felt) == 0.0));
    let written = fake.force("Arm", first - 1).unwrap().time;
    let last =
        forces(&fake, first).iter().filter(|felt| norm(felt) > 0.0).map(|felt| felt.time).fold(written, f64::max);
    // 50 ms, and what a busy machine adds.
    assert!(last - written < 0.3, "forces for {} s", last - written);
    let felt = write_until(&fake, &mut touch, &newton(0.0, 0.0, 1.0), |felt| norm(felt) > 0.5);
    assert_eq!(felt.force, [0.0, 1.0, 0.0], "it comes back by itself");
}

#[test]
fn force_errors_silence_the_device_for_a_tenth_of_a_second() {
    let fake = Fake::new(&[("Arm", "Touch")]).unwrap();
    let (log, said) = DeviceLog::new();
    let mut touch = open_logged(&fake, "Arm", "Touch", &[], &log).unwrap();
    write_until(&fake, &mut touch, &newton(1.0, 0.0, 0.0), |felt| norm(felt) > 0.5);
    let first = fake.frames("Arm");
    fake.tell("Arm: warm 1");
    until("silence and its end", || {
        touch.write(&newton(1.0, 0.0, 0.0)).unwrap();
        // The longest time from one force to the next.
        let times: Vec<f64> =
            forces(&fake, first).iter().filter(|felt| norm(felt) > 0.5).map(|felt| felt.time).collect();
        times.windows(2).any(|pair| pair[1] - pair[0] > 0.09)
    });
    assert!(touch.read().unwrap().valid, "the pose is as good as before");
    let sentences: Vec<String> = said.try_iter().collect();
    assert!(sentences.iter().any(|sentence| sentence.contains("motors are too warm")), "{sentences:?}");
}

#[test]
fn poses_count_once_the_device_is_calibrated() {
    let fake = Fake::new(&[("Arm", "Touch")]).unwrap();
    fake.tell("Arm: calibration manual");
    let (log, said) = DeviceLog::new();
    let mut touch = open_logged(&fake, "Arm", "Touch", &[], &log).unwrap();
    sample_where(&mut touch, "samples", |sample| sample.sequence > 150);
    assert!(!touch.read().unwrap().valid);
    let frames = fake.frames("Arm");
    while fake.frames("Arm") < frames + 50 {
        touch.write(&newton(1.0, 0.0, 0.0)).unwrap();
        sleep(Duration::from_millis(1));
    }
    assert_eq!(norm(&fake.newest_force("Arm").unwrap()), 0.0, "no force without calibration");
    fake.tell("Arm: calibration update");
    sample_where(&mut touch, "calibration", |sample| sample.valid);
    assert!(fake.log().contains(&String::from("calibrate Arm 2")), "auto before inkwell");
    let sentences: Vec<String> = said.try_iter().collect();
    assert!(sentences[0].contains("put the stylus into the inkwell"), "{sentences:?}");
    assert!(sentences.last().unwrap().ends_with("is calibrated"), "{sentences:?}");
}

#[test]
fn inkwell_comes_before_encoder_reset() {
    let fake = Fake::new(&[("Arm", "Touch")]).unwrap();
    fake.tell("Arm: styles 5");
    fake.tell("Arm: calibration update");
    let mut touch = open(&fake, "Arm");
    sample_where(&mut touch, "calibration", |sample| sample.valid);
    assert!(fake.log().contains(&String::from("calibrate Arm 4")), "{:?}", fake.log());
}

#[test]
fn it_ends_in_order() {
    let (fake, mut touch) = one();
    write_until(&fake, &mut touch, &newton(0.0, 0.0, 3.0), |felt| norm(felt) > 2.0);
    touch.close();
    let frames = fake.frames("Arm");
    assert!(forces(&fake, frames - 2).iter().all(|felt| norm(felt) == 0.0), "two frames without force");
    assert_eq!(
        fake.log(),
        ["init Arm", "start", "enable Arm 4001", "enable Arm 4000", "done", "stop", "disable Arm"],
        "clamping before output; callback, scheduler, device"
    );
    assert!(matches!(touch.read(), Err(DeviceError::Lost(_))) && touch.write(&DeviceForce::zero()).is_err());
    drop(touch);
    assert_eq!(fake.log().len(), 7, "nothing is done twice");
    let mut again = open(&fake, "Arm");
    assert!(fresh(&mut again).valid);
}

#[test]
fn dropping_ends_it_too() {
    let (fake, touch) = one();
    drop(touch);
    assert_eq!(fake.log().last().unwrap(), "disable Arm");
}

#[test]
fn two_devices_share_the_scheduler() {
    let fake = Fake::new(&[("Arm", "Touch"), ("Right", "PHANTOM Omni")]).unwrap();
    fake.tell("Arm: pose 0 0 10");
    fake.tell("Right: pose 0 0 20");
    let mut left = open(&fake, "Arm");
    let mut right = open_with(&fake, "Right", "PHANTOM Omni", &[]).unwrap();
    assert_eq!((left.spec().max_stiffness, right.spec().max_stiffness), (400.0, 700.0));
    assert!((fresh(&mut left).position.x - 0.01).abs() < 1e-12);
    assert!((fresh(&mut right).position.x - 0.02).abs() < 1e-12);
    until("forces of their own", || {
        left.write(&newton(1.0, 0.0, 0.0)).unwrap();
        right.write(&newton(2.0, 0.0, 0.0)).unwrap();
        let felt = ["Arm", "Right"].map(|name| fake.newest_force(name).map_or(0.0, |felt| felt.force[2]));
        felt == [1.0, 2.0]
    });
    left.close();
    assert!(fresh(&mut right).valid, "the other goes on");
    assert!(!fake.log().contains(&String::from("stop")));
    right.close();
    assert_eq!(fake.log().iter().filter(|line| *line == "start").count(), 1);
    assert_eq!(fake.log().iter().filter(|line| *line == "stop").count(), 1);
}

#[test]
fn a_device_is_opened_once() {
    let (fake, _touch) = one();
    let error = open_with(&fake, "Arm", "Touch", &[]).err().unwrap();
    assert!(matches!(&error, DeviceError::Unavailable(sentence) if sentence.contains("in use already")), "{error}");
}

#[test]
fn a_frame_of_another_device_is_not_taken_for_ours() {
    let fake = Fake::new(&[("Arm", "Touch"), ("Right", "Touch")]).unwrap();
    fake.tell("current process");
    fake.tell("Arm: pose 0 0 10");
    fake.tell("Right: pose 0 0 20");
    let mut left = open(&fake, "Arm");
    let mut right = open(&fake, "Right");
    fresh(&mut right);
    fresh(&mut left);
    let frames = fake.frames("Arm");
    fake.tell("Arm: steal 500");
    let mut untrusted = 0;
    until("500 frames", || {
        let sample = left.read().unwrap();
        assert!((sample.position.x - 0.01).abs() < 1e-12, "{:?}", sample.position);
        untrusted += usize::from(!sample.valid);
        fake.frames("Arm") > frames + 510
    });
    assert!(untrusted > 0);
    assert!(fresh(&mut left).valid);
}

#[test]
fn what_is_wrong_is_one_sentence_each() {
    let sentence = |result: Result<Touch, DeviceError>| match result.err().unwrap() {
        DeviceError::Unavailable(sentence) => {
            assert!(!sentence.contains('\n'), "{sentence}");
            sentence
        }
        other => panic!("{other:?}"),
    };
    let fake = Fake::new(&[("Arm", "Touch")]).unwrap();
    let wrong = sentence(open_with(&fake, "Nobody", "Touch", &[]));
    assert!(wrong.starts_with("`Nobody` cannot be initialised: the device does not answer (error 0302)"), "{wrong}");
    fake.tell("Arm: fail init");
    assert!(sentence(open_with(&fake, "Arm", "Touch", &[])).contains("0302"));
    fake.tell("Arm: fail ok");
    let other = sentence(open_with(&fake, "Arm", "PHANTOM Omni", &[]));
    assert!(other.contains("`Arm` is a `Touch`, not a `PHANTOM Omni`: write `hardware name: Touch`"), "{other}");
    assert_eq!(fake.log().last().unwrap(), "disable Arm", "it is let go");
    let old = TouchDriver.find("Touch", &settings(&[("library", fake_hd::OLD_LIBRARY)])).unwrap_err().to_string();
    assert!(old.contains("libHD_old.so: lacks hdGetError,"), "{old}");
    let none = TouchDriver.find("Touch", &settings(&[("library", "libHD.so.none")])).unwrap_err();
    assert!(matches!(none, DeviceError::Unavailable(_)));
}

#[test]
fn short_faults_pass_and_long_ones_lose_the_device() {
    let (fake, mut touch) = one();
    fresh(&mut touch);
    fake.tell("Arm: comm 300");
    let bad = sample_where(&mut touch, "a fault", |sample| !sample.valid);
    assert!(sample_where(&mut touch, "recovery", |sample| sample.valid).sequence > bad.sequence);
    fake.tell("Arm: fault on");
    let mut error = None;
    until("the loss", || {
        error = touch.read().err();
        error.is_some()
    });
    assert_eq!(error.unwrap(), DeviceError::Lost(String::from("`Arm` is lost: the device is at fault (error 0300)")));
    touch.close();
    assert!(open_with(&fake, "Arm", "Touch", &[]).is_err(), "still at fault");
    fake.tell("Arm: fault off");
    assert!(fresh(&mut open(&fake, "Arm")).valid, "it comes back");
}

#[test]
fn a_scheduler_that_stands_still_for_a_second_is_forgiven() {
    let (fake, mut touch) = one();
    fresh(&mut touch);
    fake.tell("stall 1");
    let still = sample_where(&mut touch, "the stall", |sample| !sample.valid);
    assert!(still.is_finite());
    assert!(sample_where(&mut touch, "the end of it", |sample| sample.valid).sequence > still.sequence);
}

#[test]
fn closing_does_not_wait_for_a_scheduler_that_stands_still_for_ever() {
    let (fake, mut touch) = one();
    fresh(&mut touch);
    fake.tell("stall 3");
    let mut error = None;
    until("the loss", || {
        error = touch.read().err();
        error.is_some()
    });
    assert!(error.unwrap().to_string().contains("stands still"));
    touch.close();
    assert!(fake.log().contains(&String::from("unschedule")));
    assert!(fresh(&mut open(&fake, "Arm")).valid);
}

#[test]
fn an_error_of_the_scheduler_loses_the_device() {
    let (fake, mut touch) = one();
    fake.tell("error 0600");
    until("the loss", || touch.read().is_err());
    assert!(touch.read().unwrap_err().to_string().contains("licence"));
}

#[test]
fn a_rate_that_is_refused_is_said_and_another_is_used() {
    let fake = Fake::new(&[("Arm", "Touch")]).unwrap();
    let (log, said) = DeviceLog::new();
    let mut touch = open_logged(&fake, "Arm", "Touch", &[("rate", "700")], &log).unwrap();
    fresh(&mut touch);
    assert!(said.try_iter().any(|sentence| sentence.contains("refuses `rate: 700`")));
}

#[test]
fn samples_come_a_thousand_times_a_second() {
    let (_fake, mut touch) = one();
    // A busy machine delays single samples.
    let mut rates = Vec::new();
    let is_right = |rate: &f64| (980.0..=1020.0).contains(rate);
    while rates.len() < 10 && !rates.last().is_some_and(is_right) {
        let first = fresh(&mut touch);
        let last = sample_where(&mut touch, "2000 samples", |sample| sample.sequence >= first.sequence + 2000);
        rates.push((last.sequence - first.sequence) as f64 / (last.stamp - first.stamp).as_secs_f64());
    }
    assert!(rates.last().is_some_and(is_right), "{rates:?}");
}

#[test]
fn a_wall_is_stable_against_a_hand() {
    let (fake, mut touch) = one();
    // A hand of 0.1 kg that wants to be 5 mm inside a wall of 400 N/m at x = 0.
    fake.tell("Arm: hand 0.1 100 4");
    fake.tell("Arm: pose 0 0 -5");
    // At rest 100 (5 mm − d) = 400 d, so d = 1 mm; it must stay there.
    let mut still = Instant::now();
    until("rest at the wall", || {
        let x = touch.read().unwrap().position.x;
        touch.write(&newton((-400.0 * x).max(0.0), 0.0, 0.0)).unwrap();
        assert!(x > -0.007, "{x}");
        if (x + 0.001).abs() > 2e-4 {
            still = Instant::now();
        }
        still.elapsed() > Duration::from_millis(500)
    });
}

#[test]
fn the_default_device_needs_no_name() {
    let fake = Fake::new(&[("Default Device", "Touch")]).unwrap();
    let info = DeviceInfo { model: String::from("Touch"), identity: String::from("Default Device") };
    let settings = settings(&[("library", fake.path().to_str().unwrap())]);
    let mut touch = TouchDriver.open(&info, &settings, &DeviceLog::new().0).unwrap();
    until("a sample", || touch.read().unwrap().valid);
    touch.close();
    assert!(TouchDriver.serves("PHANTOM Desktop") && touch::driver().name() == "touch");
}
