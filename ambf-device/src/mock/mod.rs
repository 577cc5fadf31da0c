//! A device without hardware: it draws a curve and records the forces written to it.

mod script;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::thread::sleep;
use std::time::{Duration, Instant};

use nalgebra::{UnitQuaternion, Vector3};
use parking_lot::Mutex;

use super::{known, Axes, DeviceError, DeviceForce, DeviceInfo, DeviceLog, DeviceSample, DeviceSpec};
use super::{Driver, InputDevice, Presence, Settings};
use script::{Button, Fault, Script};

/// Devices that there are of each model.
const UNITS: u32 = 16;
const KEYS: &[&str] = &[
    "tc",
    "scale",
    "a",
    "b",
    "c",
    "offset",
    "orientation",
    "rate",
    "gripper",
    "buttons",
    "hold",
    "read time",
    "faults",
];

/// A force written to a [`MockDriver`]'s device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CommandedForce {
    /// Since the device was opened first, s.
    pub time: f64,
    /// What was commanded.
    pub force: DeviceForce,
}

/// The newest forces of each device, by identity.
type Records = Arc<Mutex<BTreeMap<String, Arc<Mutex<VecDeque<CommandedForce>>>>>>;

/// Forces written to the devices of a [`MockDriver`]; for tests.
#[derive(Debug, Clone, Default)]
pub struct MockRecording(Records);

impl MockRecording {
    /// What was written to the device of that identity, in order; empty if it was never opened.
    pub fn forces(&self, identity: &str) -> Vec<CommandedForce> {
        let records = self.0.lock();
        let record = records.get(identity).cloned();
        drop(records);
        record.map_or_else(Vec::new, |record| record.lock().iter().copied().collect())
    }
}

/// Driver `mock`: devices of the model `Mock`, or of any model for which `driver: mock` is written; identities `0` to
/// `15`.
///
/// The tip draws `P = offset + scale·[a·sin(tc·t), b·cos(tc·t), c·sin(tc·t)]` with a constant orientation; `t` counts
/// from when the device was opened first. Settings:
///
/// | Key | Default | Meaning |
/// |---|---|---|
/// | `tc`, `scale` | 4, 0.1 | rad/s, m |
/// | `a`, `b`, `c` | 1, 1, 2 | of the axes |
/// | `offset` | `0 0 0` | m |
/// | `orientation` | `0 0 0` | roll, pitch, yaw, rad |
/// | `rate` | as often as read | samples per second |
/// | `gripper` | `sine` | 0.5 + 0.5·sin(tc·t); or a number 0…1; or `none` |
/// | `buttons` | none | when which are pressed: `1@2.0-3.5, 0@0-` |
/// | `hold` | of the model | start-up hold, s |
/// | `read time` | 0 | how long each read takes, s |
/// | `faults` | none | `block`, `panic`, `nan`, `invalid`, `lost`, written as buttons are |
#[derive(Debug, Default)]
pub struct MockDriver {
    /// When devices were opened first: faults go on when they are opened again.
    starts: Mutex<BTreeMap<String, Instant>>,
    recording: Option<(MockRecording, usize)>,
}

impl MockDriver {
    /// A driver whose devices keep the newest `capacity` forces each, and where to read them.
    pub fn recording(capacity: usize) -> (Self, MockRecording) {
        let recording = MockRecording::default();
        (Self { recording: Some((recording.clone(), capacity)), ..Self::default() }, recording)
    }
}

impl Driver for MockDriver {
    fn name(&self) -> &str {
        "mock"
    }

    fn serves(&self, model: &str) -> bool {
        model == "Mock"
    }

    fn find(&self, model: &str, settings: &Settings) -> Result<Vec<DeviceInfo>, DeviceError> {
        Plan::read(settings)?;
        let unit = |unit: u32| DeviceInfo { model: model.to_owned(), identity: unit.to_string() };
        Ok((0..UNITS).map(unit).collect())
    }

    fn presence(&self, _info: &DeviceInfo, _settings: &Settings) -> Presence {
        Presence::There("in software".into())
    }

    fn open(
        &self,
        info: &DeviceInfo,
        settings: &Settings,
        _log: &DeviceLog,
    ) -> Result<Box<dyn InputDevice>, DeviceError> {
        let plan = Plan::read(settings)?;
        let mut starts = self.starts.lock();
        let start = *starts.entry(info.identity.clone()).or_insert_with(Instant::now);
        drop(starts);
        if plan.faults.at(start.elapsed().as_secs_f64()).any(|(fault, _)| fault == Fault::Lost) {
            return Err(DeviceError::Unavailable(format!("the mock device {} is away, as scripted", info.identity)));
        }
        let record = self.recording.as_ref().map(|(MockRecording(records), capacity)| {
            let mut records = records.lock();
            let record = records
                .entry(info.identity.clone())
                .or_insert_with(|| Arc::new(Mutex::new(VecDeque::with_capacity((*capacity).max(1)))));
            record.clone()
        });
        let capacity = self.recording.as_ref().map_or(0, |(_, capacity)| (*capacity).max(1));
        Ok(Box::new(MockDevice { spec: plan.spec(&info.model), plan, start, sequence: 0, record, capacity }))
    }
}

/// What the settings say.
#[derive(Debug, Clone)]
struct Plan {
    tc: f64,
    axes: Vector3<f64>,
    offset: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
    rate: Option<f64>,
    gripper: Gripper,
    buttons: Script<Button>,
    hold: Option<f64>,
    read_time: Duration,
    faults: Script<Fault>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Gripper {
    Sine,
    Constant(f64),
    None,
}

impl Plan {
    fn read(settings: &Settings) -> Result<Self, DeviceError> {
        settings.unknown(KEYS)?;
        let number = |key: &str, default: f64, least: f64| -> Result<f64, DeviceError> {
            let value: f64 = settings.parsed(key, "a number")?.unwrap_or(default);
            let fits = value.is_finite() && value >= least;
            fits.then_some(value).ok_or_else(|| settings.wrong(key, "a finite number that makes sense here").into())
        };
        let three = |key: &str| -> Result<Vector3<f64>, DeviceError> {
            let Some(text) = settings.text(key) else { return Ok(Vector3::zeros()) };
            let separators = |c: char| c.is_whitespace() || c == ',';
            let numbers = text.split(separators).filter(|part| !part.is_empty()).map(str::parse);
            let numbers: Option<Vec<f64>> = numbers.map(|number| number.ok().filter(|x: &f64| x.is_finite())).collect();
            let three = numbers.filter(|numbers| numbers.len() == 3);
            three.map(|v| Vector3::new(v[0], v[1], v[2])).ok_or_else(|| settings.wrong(key, "three numbers").into())
        };
        let any = f64::NEG_INFINITY;
        let scale = number("scale", 0.1, any)?;
        let axes = Vector3::new(number("a", 1.0, any)?, number("b", 1.0, any)?, number("c", 2.0, any)?);
        let gripper = match settings.text("gripper").map(str::trim) {
            None | Some("sine") => Gripper::Sine,
            Some("none") => Gripper::None,
            Some(text) => match text.parse() {
                Ok(opening) if (0.0..=1.0).contains(&opening) => Gripper::Constant(opening),
                _ => return Err(settings.wrong("gripper", "`sine`, `none` or a number 0…1").into()),
            },
        };
        let angles = three("orientation")?;
        let rate = number("rate", 0.0, 0.0)?;
        let read_time = number("read time", 0.0, 0.0)?.min(3600.0);
        Ok(Self {
            tc: number("tc", 4.0, any)?,
            axes: axes * scale,
            offset: three("offset")?,
            rotation: UnitQuaternion::from_euler_angles(angles.x, angles.y, angles.z),
            rate: (rate > 0.0).then_some(rate),
            gripper,
            buttons: settings.parsed("buttons", "buttons and times as in `1@2.0-3.5, 0@0-`")?.unwrap_or_default(),
            hold: settings.text("hold").map(|_| number("hold", 0.0, 0.0)).transpose()?,
            read_time: Duration::from_secs_f64(read_time),
            faults: settings
                .parsed("faults", "block, panic, nan, invalid or lost with times, as in `block@3-8`")?
                .unwrap_or_default(),
        })
    }

    /// What is known of the model; without that, a device that can do everything.
    fn spec(&self, model: &str) -> DeviceSpec {
        let all = Axes { position: true, rotation: true, gripper: true };
        let mut spec = known::spec(model).unwrap_or_else(|| DeviceSpec {
            manufacturer: String::from("none"),
            max_force: 5.0,
            max_torque: 0.1,
            max_gripper_force: 3.0,
            max_stiffness: 1000.0,
            max_angular_stiffness: 1.0,
            max_gripper_stiffness: 1000.0,
            max_damping: 20.0,
            workspace_radius: 0.2,
            gripper_max_angle: 1.0,
            sensed: all,
            actuated: all,
            left_hand: true,
            right_hand: true,
            ..DeviceSpec::unknown(model)
        });
        spec.sensed.gripper = self.gripper != Gripper::None;
        spec.start_up_hold = self.hold.unwrap_or(spec.start_up_hold);
        spec
    }

    /// Tip at time `t`, m.
    fn position(&self, t: f64) -> Vector3<f64> {
        let (sin, cos) = (self.tc * t).sin_cos();
        self.offset + self.axes.component_mul(&Vector3::new(sin, cos, sin))
    }

    fn opening(&self, t: f64) -> Option<f64> {
        match self.gripper {
            Gripper::Sine => Some(0.5 + 0.5 * (self.tc * t).sin()),
            Gripper::Constant(opening) => Some(opening),
            Gripper::None => None,
        }
    }
}

struct MockDevice {
    spec: DeviceSpec,
    plan: Plan,
    start: Instant,
    sequence: u64,
    record: Option<Arc<Mutex<VecDeque<CommandedForce>>>>,
    capacity: usize,
}

impl MockDevice {
    fn record(&self, force: DeviceForce) {
        let Some(record) = &self.record else { return };
        let time = self.start.elapsed().as_secs_f64();
        let mut record = record.lock();
        if record.len() >= self.capacity {
            record.pop_front();
        }
        record.push_back(CommandedForce { time, force });
    }

    fn lost(&self) -> Result<(), DeviceError> {
        let time = self.start.elapsed().as_secs_f64();
        if self.plan.faults.at(time).any(|(fault, _)| fault == Fault::Lost) {
            return Err(DeviceError::Lost(String::from("the mock device went away, as scripted")));
        }
        Ok(())
    }
}

impl InputDevice for MockDevice {
    fn spec(&self) -> &DeviceSpec {
        &self.spec
    }

    fn read(&mut self) -> Result<DeviceSample, DeviceError> {
        if !self.plan.read_time.is_zero() {
            sleep(self.plan.read_time);
        }
        self.lost()?;
        let now = self.start.elapsed().as_secs_f64();
        let (mut valid, mut shift) = (true, 0.0);
        for (fault, end) in self.plan.faults.at(now) {
            match fault {
                Fault::Block => sleep(Duration::from_secs_f64((end - now).clamp(0.0, 3600.0))),
                Fault::Panic => panic!("the mock device panics, as scripted"),
                Fault::NotANumber => shift = f64::NAN,
                Fault::Invalid => valid = false,
                Fault::Lost => {}
            }
        }
        let now = self.start.elapsed().as_secs_f64();
        let t = match self.plan.rate {
            Some(rate) => {
                self.sequence = (now * rate) as u64;
                self.sequence as f64 / rate
            }
            None => {
                self.sequence += 1;
                now
            }
        };
        let buttons = self.plan.buttons.at(now).fold(0, |mask, (Button(button), _)| mask | (1 << button));
        Ok(DeviceSample {
            stamp: self.start + Duration::from_secs_f64(t),
            sequence: self.sequence,
            position: self.plan.position(t).add_scalar(shift),
            rotation: self.plan.rotation,
            linear_velocity: None,
            angular_velocity: None,
            gripper: self.plan.opening(t),
            buttons,
            valid,
        })
    }

    fn write(&mut self, force: &DeviceForce) -> Result<(), DeviceError> {
        self.record(*force);
        self.lost()
    }

    fn close(&mut self) {
        self.record(DeviceForce::zero());
    }
}

impl Drop for MockDevice {
    fn drop(&mut self) {
        self.close();
    }
}

#[cfg(test)]
mod tests {
    use super::super::Setting;
    use super::*;

    fn settings(entries: &[(&str, &str)]) -> Settings {
        let setting = |value: &str| Setting { value: value.into(), place: String::from("d.yaml:1") };
        let entries = entries.iter().map(|(key, value)| ((*key).to_owned(), setting(value)));
        Settings::new(entries.collect(), ".".into())
    }

    fn opened(entries: &[(&str, &str)]) -> (Box<dyn InputDevice>, MockRecording) {
        let (driver, recording) = MockDriver::recording(3);
        let settings = settings(entries);
        let info = driver.find("Mock", &settings).expect("devices").remove(0);
        (driver.open(&info, &settings, &DeviceLog::new().0).expect("a device"), recording)
    }

    #[test]
    fn the_curve_is_that_of_the_paper() {
        let plan = Plan::read(&settings(&[("offset", "1, 2 3")])).expect("a plan");
        for t in [0.0f64, 0.1, 2.5] {
            let expected = Vector3::new(1.0, 2.0, 3.0)
                + 0.1 * Vector3::new((4.0 * t).sin(), (4.0 * t).cos(), 2.0 * (4.0 * t).sin());
            assert!((plan.position(t) - expected).norm() < 1e-12);
            assert!((plan.opening(t).expect("a gripper") - 0.5 - 0.5 * (4.0 * t).sin()).abs() < 1e-12);
        }
        let (mut device, _) = opened(&[("tc", "0.5"), ("scale", "0.2"), ("a", "0"), ("c", "0"), ("gripper", "0.25")]);
        let sample = device.read().expect("a sample");
        assert!((sample.position.y - 0.2).abs() < 1e-3 && sample.position.x == 0.0 && sample.valid);
        assert_eq!(sample.gripper, Some(0.25));
    }

    #[test]
    fn samples_come_at_their_rate() {
        let (mut device, _) = opened(&[("rate", "2"), ("buttons", "3@0-, 4@50-")]);
        let samples = [(); 3].map(|()| device.read().expect("a sample"));
        assert_eq!(samples[0], samples[2], "the next one is half a second off");
        assert_eq!(samples[0].buttons, 0b1000);
        let (mut device, _) = opened(&[]);
        assert_ne!(device.read().expect("a sample").sequence, device.read().expect("a sample").sequence);
    }

    #[test]
    fn models_keep_their_limits() {
        let plan = Plan::read(&settings(&[("gripper", "none"), ("hold", "0")])).expect("a plan");
        let spec = plan.spec("Falcon");
        assert_eq!((spec.max_force, spec.start_up_hold, spec.sensed.gripper), (8.0, 0.0, false));
        assert_eq!(plan.spec("Mock").max_stiffness, 1000.0);
    }

    #[test]
    fn forces_are_written_down_and_end_with_zero() {
        let (mut device, recording) = opened(&[]);
        for x in [1.0, 2.0, 3.0] {
            device.write(&DeviceForce { force: Vector3::x() * x, ..DeviceForce::zero() }).expect("written");
        }
        drop(device);
        let forces: Vec<_> = recording.forces("0").iter().map(|entry| entry.force.force.x).collect();
        assert_eq!(forces, [2.0, 3.0, 0.0], "the newest three");
        assert!(recording.forces("1").is_empty());
    }

    #[test]
    fn faults_happen_as_scripted() {
        assert!(opened(&[("faults", "nan@0-")]).0.read().expect("a sample").position.x.is_nan());
        assert!(!opened(&[("faults", "invalid@0-")]).0.read().expect("a sample").valid);
        let (mut device, _) = opened(&[("faults", "block@0-0.05")]);
        let before = Instant::now();
        assert!(device.read().is_ok() && before.elapsed() > Duration::from_millis(30));
        let driver = MockDriver::default();
        let lost = settings(&[("faults", "lost@0-")]);
        let info = driver.find("x", &lost).expect("devices").remove(0);
        assert!(matches!(driver.open(&info, &lost, &DeviceLog::new().0), Err(DeviceError::Unavailable(_))));
    }

    #[test]
    fn wrong_settings_are_named() {
        for (key, value) in [
            ("tc", "fast"),
            ("scale", "inf"),
            ("rate", "-1"),
            ("offset", "1 2"),
            ("gripper", "2"),
            ("buttons", "1"),
            ("hold", "nan"),
            ("colour", "red"),
        ] {
            let error = MockDriver::default().find("Mock", &settings(&[(key, value)])).expect_err(key).to_string();
            assert!(error.starts_with(&format!("d.yaml:1: `{key}` is `{value}`, expected ")), "{error}");
        }
    }
}
