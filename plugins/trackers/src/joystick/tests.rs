//! Joysticks whose events come from a test instead of the kernel.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::{Duration, Instant};

use ambf_device::{DeviceError, DeviceForce, DeviceSample, InputDevice, Setting, Settings};
use evdev::{AbsoluteAxisCode, EventType, InputEvent, KeyCode, RelativeAxisCode};
use nalgebra::{UnitQuaternion, Vector3};

use super::axes::Axes;
use super::device::Events;
use super::find::tests::Sys;
use super::*;

/// A device with these axes and two buttons, of which the second is pressed.
#[derive(Clone)]
struct Pad {
    absolute: &'static [u16],
    relative: &'static [u16],
    events: Arc<Mutex<VecDeque<InputEvent>>>,
    gone: Arc<Mutex<bool>>,
}

impl Events for Pad {
    fn axes(&self, now: Instant) -> io::Result<Axes> {
        let mut axes = Axes::default();
        for code in self.absolute {
            axes.add_absolute(AbsoluteAxisCode(*code), 0, -1000, 1000);
        }
        for code in self.relative {
            axes.add_relative(RelativeAxisCode(*code), now);
        }
        Ok(axes)
    }

    fn buttons(&self) -> io::Result<Vec<(KeyCode, bool)>> {
        Ok(vec![(KeyCode::BTN_SOUTH, false), (KeyCode::BTN_EAST, true)])
    }

    fn fetch(&mut self, events: &mut Vec<InputEvent>) -> io::Result<()> {
        if *self.gone.lock().unwrap() {
            return Err(rustix::io::Errno::NODEV.into());
        }
        let mut waiting = self.events.lock().unwrap();
        if waiting.is_empty() {
            return Err(io::ErrorKind::WouldBlock.into());
        }
        events.extend(waiting.drain(..));
        Ok(())
    }
}

impl Pad {
    fn new(absolute: &'static [u16], relative: &'static [u16]) -> Self {
        Self { absolute, relative, events: Arc::default(), gone: Arc::default() }
    }

    fn gamepad() -> Self {
        Self::new(&[0, 1, 2, 3, 4, 5], &[])
    }

    fn send(&self, kind: EventType, code: u16, value: i32) {
        let mut events = self.events.lock().unwrap();
        events.push_back(InputEvent::new(kind.0, code, value));
        events.push_back(InputEvent::new(EventType::SYNCHRONIZATION.0, 0, 0));
    }

    fn tilt(&self, code: AbsoluteAxisCode, value: i32) {
        self.send(EventType::ABSOLUTE, code.0, value);
    }

    fn open(&self, model: &str, entries: &[(&str, &str)]) -> Joystick<Pad> {
        Joystick::new(self.clone(), model, "usb-1", Options::read(&settings(entries)).unwrap()).unwrap()
    }
}

fn settings(entries: &[(&str, &str)]) -> Settings {
    let entry = |(key, value): &(&str, &str)| {
        ((*key).to_owned(), Setting { value: (*value).to_owned(), place: String::from("devices.yaml:4") })
    };
    Settings::new(entries.iter().map(entry).collect(), PathBuf::new())
}

/// Reads for a while, at least `steps` times.
fn read_on(joystick: &mut Joystick<Pad>, steps: usize) -> Vec<DeviceSample> {
    (0..steps)
        .map(|_| {
            sleep(Duration::from_millis(1));
            joystick.read().unwrap()
        })
        .collect()
}

#[test]
fn in_the_middle_nothing_moves() {
    let pad = Pad::gamepad();
    let mut joystick = pad.open(JOYSTICK, &[]);
    pad.tilt(AbsoluteAxisCode::ABS_X, 99);
    let sample = *read_on(&mut joystick, 20).last().unwrap();
    assert_eq!((sample.position, sample.rotation), (Vector3::zeros(), UnitQuaternion::identity()));
    assert!(sample.valid && sample.gripper.is_none());
    assert!(joystick.write(&DeviceForce::zero()).is_ok() && joystick.spec().max_force == 0.0);
}

#[test]
fn a_tilted_stick_is_a_velocity() {
    let pad = Pad::gamepad();
    let mut joystick = pad.open(JOYSTICK, &[("speed", "0.2"), ("dead zone", "0")]);
    joystick.read().unwrap();
    pad.tilt(AbsoluteAxisCode::ABS_X, 500);
    pad.tilt(AbsoluteAxisCode::ABS_RY, -1000);
    let samples = read_on(&mut joystick, 30);
    assert_eq!(samples[0].linear_velocity, Some(Vector3::new(0.0, 0.1, 0.2)), "to the right and up");
    for pair in samples.windows(2) {
        // Pauses of a busy machine count as 20 ms.
        let dt = (pair[1].stamp - pair[0].stamp).as_secs_f64().min(0.02);
        let moved = pair[1].position - pair[0].position;
        assert!((moved - Vector3::new(0.0, 0.1, 0.2) * dt).norm() < 1e-12);
    }
    pad.tilt(AbsoluteAxisCode::ABS_X, 0);
    pad.tilt(AbsoluteAxisCode::ABS_RY, 0);
    let rest = read_on(&mut joystick, 5);
    assert_eq!(rest[0].position, rest[4].position);
    assert_eq!(rest[4].sequence, rest[0].sequence + 4);
}

#[test]
fn turns_add_up_about_the_axes_of_the_frame() {
    let pad = Pad::gamepad();
    let mut joystick = pad.open(JOYSTICK, &[("turn", "2")]);
    pad.tilt(AbsoluteAxisCode::ABS_RX, -1000);
    let samples = read_on(&mut joystick, 30);
    let (first, last) = (samples[0], samples[29]);
    let turned = (last.rotation * first.rotation.inverse()).scaled_axis();
    let seconds: f64 = samples.windows(2).map(|pair| (pair[1].stamp - pair[0].stamp).as_secs_f64().min(0.02)).sum();
    assert!((turned - Vector3::new(0.0, 0.0, 2.0 * seconds)).norm() < 1e-9, "{turned:?} in {seconds}");
    assert_eq!(last.angular_velocity, Some(Vector3::new(0.0, 0.0, 2.0)));
    assert!((last.rotation.norm() - 1.0).abs() < 1e-12);
}

#[test]
fn in_position_mode_the_stick_is_the_pose() {
    let pad = Pad::gamepad();
    let entries = [("mode", "position"), ("speed", "0.3"), ("dead zone", "0"), ("axes", "-x 0 y 0 rz 0")];
    let mut joystick = pad.open(JOYSTICK, &entries);
    pad.tilt(AbsoluteAxisCode::ABS_X, 1000);
    pad.tilt(AbsoluteAxisCode::ABS_Y, 500);
    pad.tilt(AbsoluteAxisCode::ABS_RZ, -1000);
    let sample = joystick.read().unwrap();
    assert!((sample.position - Vector3::new(-0.3, 0.0, 0.15)).norm() < 1e-12);
    assert!((sample.rotation.scaled_axis() - Vector3::new(0.0, -1.0, 0.0)).norm() < 1e-12);
    assert_eq!(sample.linear_velocity, None);
    pad.tilt(AbsoluteAxisCode::ABS_X, 0);
    assert_eq!(joystick.read().unwrap().position.x, 0.0);
}

#[test]
fn buttons_are_bits_in_the_order_of_their_codes() {
    let pad = Pad::gamepad();
    let mut joystick = pad.open(JOYSTICK, &[]);
    assert_eq!(joystick.read().unwrap().buttons, 0b10, "pressed when it was opened");
    pad.send(EventType::KEY, KeyCode::BTN_SOUTH.0, 1);
    assert_eq!(joystick.read().unwrap().buttons, 0b11);
    pad.send(EventType::KEY, KeyCode::BTN_EAST.0, 0);
    pad.send(EventType::KEY, KeyCode::KEY_A.0, 1);
    assert_eq!(joystick.read().unwrap().buttons, 0b01);
}

#[test]
fn a_trigger_closes_the_gripper() {
    let pad = Pad::gamepad();
    let mut joystick = pad.open(JOYSTICK, &[("gripper", "z")]);
    assert!(joystick.spec().sensed.gripper);
    pad.tilt(AbsoluteAxisCode::ABS_Z, -1000);
    assert_eq!(joystick.read().unwrap().gripper, Some(1.0));
    pad.tilt(AbsoluteAxisCode::ABS_Z, 1000);
    assert_eq!(joystick.read().unwrap().gripper, Some(0.0));
}

#[test]
fn a_space_mouse_that_is_let_go_stops() {
    let pad = Pad::new(&[], &[0, 1, 2, 3, 4, 5]);
    let mut mouse = pad.open(SPACE_MOUSE, &[("dead zone", "0")]);
    pad.send(EventType::RELATIVE, RelativeAxisCode::REL_Z.0, -350);
    let up = mouse.read().unwrap();
    assert_eq!(up.linear_velocity, Some(Vector3::new(0.0, 0.0, 0.1)));
    // It tells nothing more.
    sleep(Duration::from_millis(80));
    assert_eq!(mouse.read().unwrap().linear_velocity, Some(Vector3::zeros()));
}

#[test]
fn unplugging_loses_it() {
    let pad = Pad::gamepad();
    let mut joystick = pad.open(JOYSTICK, &[]);
    assert!(joystick.read().is_ok());
    *pad.gone.lock().unwrap() = true;
    let error = joystick.read().unwrap_err();
    assert!(matches!(&error, DeviceError::Lost(sentence) if sentence.starts_with("`usb-1` is lost")), "{error}");
    let mut other = pad.open(JOYSTICK, &[]);
    other.close();
    assert!(matches!(other.read(), Err(DeviceError::Lost(_))));
}

#[test]
fn devices_are_found_without_opening_them() {
    let sys = Sys::new("driver");
    sys.add(7777, &[("capabilities/abs", "3"), ("capabilities/key", "100000000 0 0 0 0"), ("phys", "usb-1/input0")]);
    let driver = JoystickDriver { sys: sys.0.clone() };
    let found = driver.find(JOYSTICK, &Settings::default()).unwrap();
    assert_eq!(found, [DeviceInfo { model: JOYSTICK.into(), identity: "usb-1/input0".into() }]);
    assert_eq!(driver.find(SPACE_MOUSE, &Settings::default()), Ok(vec![]));
    let log = DeviceLog::new().0;
    let error = driver.open(&found[0], &Settings::default(), &log).err().unwrap().to_string();
    assert!(error.starts_with("`usb-1/input0`: /dev/input/event7777 cannot be opened"), "{error}");
    let gone = DeviceInfo { identity: "usb-2".into(), ..found[0].clone() };
    assert!(driver.open(&gone, &Settings::default(), &log).is_err());
    assert!(driver.find(JOYSTICK, &settings(&[("mode", "both")])).is_err());
    assert!(driver.serves("Joystick") && driver.serves("SpaceMouse") && !driver.serves("Falcon"));
}

#[test]
fn a_file_that_is_no_input_device_refuses() {
    assert!(EventFile::open(std::path::Path::new("/dev/null")).is_err());
}
