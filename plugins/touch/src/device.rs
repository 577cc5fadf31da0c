use std::sync::atomic::Ordering;
use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_device::{DeviceError, DeviceForce, DeviceLog, DeviceSample, DeviceSpec, InputDevice};

use crate::hd;
use crate::library::{HdLibrary, Opened};
use crate::models;
use crate::servo::{self, Measured};

/// A sample older than this is not to be trusted, ns.
const STALE: u64 = 50_000_000;
/// A scheduler that stands still for so long is lost, ns.
const LOST: u64 = 2_000_000_000;

/// Force errors that go on are said no more often.
const BETWEEN_SENTENCES: Duration = Duration::from_secs(5);

/// A device of the Touch and Phantom family that is open.
pub struct Touch {
    library: Arc<HdLibrary>,
    /// `None` once it was closed.
    opened: Option<Opened>,
    spec: DeviceSpec,
    serial: String,
    name: String,
    log: DeviceLog,
    newest: Measured,
    /// State of the calibration that was said last.
    said: u32,
    /// When a force error was said last.
    said_force: Option<Instant>,
}

impl Touch {
    pub(crate) fn new(library: Arc<HdLibrary>, opened: Opened, name: &str, log: &DeviceLog) -> Self {
        let facts = opened.shared.facts.get();
        let spec = facts.map_or_else(|| DeviceSpec::unknown(""), |facts| models::spec(facts).0);
        let serial = facts.map_or_else(String::new, |facts| facts.serial.clone());
        Self {
            library,
            opened: Some(opened),
            spec,
            serial,
            name: name.to_owned(),
            log: log.clone(),
            newest: Measured::nothing(),
            said: 0,
            said_force: None,
        }
    }

    /// Serial number as the library names it; may be empty.
    pub fn serial(&self) -> &str {
        &self.serial
    }

    /// Angles of base, shoulder and elbow at the last [`read`](InputDevice::read), rad, as the library measures them.
    pub fn joint_angles(&self) -> [f64; 3] {
        self.newest.joints
    }

    /// Angles of the three joints of the gimbal at the last [`read`](InputDevice::read), rad, as the library measures
    /// them.
    pub fn gimbal_angles(&self) -> [f64; 3] {
        self.newest.gimbal
    }

    /// Tells the user what changed in the calibration, and that forces are off.
    fn report(&mut self) {
        let Some(opened) = &self.opened else { return };
        let calibration = opened.shared.calibration.load(Ordering::Relaxed);
        if calibration != self.said {
            let styles = opened.shared.styles.load(Ordering::Relaxed);
            let what = match calibration {
                hd::CALIBRATION_OK => "is calibrated",
                hd::CALIBRATION_NEEDS_UPDATE if styles & (hd::STYLE_AUTO | hd::STYLE_INKWELL) == 0 => {
                    "is being calibrated: hold it where all its links are at right angles"
                }
                hd::CALIBRATION_NEEDS_UPDATE => "is being calibrated",
                hd::CALIBRATION_NEEDS_MANUAL_INPUT => "needs calibration: put the stylus into the inkwell",
                _ => "does not say how its calibration is",
            };
            self.log.say(format!("`{}` {what}", self.name));
            self.said = calibration;
        }
        let error = opened.shared.force_error.swap(0, Ordering::Relaxed);
        if error != 0 && self.said_force.is_none_or(|said| said.elapsed() > BETWEEN_SENTENCES) {
            self.log.say(format!(
                "`{}` is without force for 0.1 s: {} (error {error:04x})",
                self.name,
                hd::explain(error)
            ));
            self.said_force = Some(Instant::now());
        }
    }

    fn lost(&self) -> DeviceError {
        DeviceError::Lost(format!("`{}` is closed", self.name))
    }
}

impl InputDevice for Touch {
    fn spec(&self) -> &DeviceSpec {
        &self.spec
    }

    fn read(&mut self) -> Result<DeviceSample, DeviceError> {
        self.report();
        let Some(opened) = &self.opened else { return Err(self.lost()) };
        let shared = &opened.shared;
        match shared.lost.load(Ordering::Relaxed) {
            0 => {}
            servo::PANICKED => {
                return Err(DeviceError::Lost(format!("the callback of `{}` panicked; its forces are off", self.name)))
            }
            code => {
                return Err(DeviceError::Lost(format!(
                    "`{}` is lost: {} (error {code:04x})",
                    self.name,
                    hd::explain(code)
                )))
            }
        }
        if let Some(words) = shared.sample.newest() {
            self.newest = Measured::from_words(&words);
        }
        let now = shared.now();
        if now.saturating_sub(shared.beat.load(Ordering::Relaxed)) > LOST {
            return Err(DeviceError::Lost(format!(
                "`{}` is lost: the scheduler of the HD library stands still",
                self.name
            )));
        }
        let newest = &self.newest;
        Ok(DeviceSample {
            stamp: shared.origin + Duration::from_nanos(newest.stamp),
            sequence: newest.sequence,
            position: newest.position,
            rotation: newest.rotation,
            linear_velocity: newest.velocity.iter().all(|x| x.is_finite()).then_some(newest.velocity),
            angular_velocity: None,
            gripper: None,
            buttons: newest.buttons,
            // Of the sample, not of the scheduler: after a pause that runs before it has measured.
            valid: newest.valid && now.saturating_sub(newest.stamp) <= STALE,
        })
    }

    fn write(&mut self, force: &DeviceForce) -> Result<(), DeviceError> {
        let Some(opened) = &self.opened else { return Err(self.lost()) };
        opened.shared.leave_force(force);
        Ok(())
    }

    fn close(&mut self) {
        if let Some(opened) = self.opened.take() {
            self.library.close(opened);
        }
    }
}

impl Drop for Touch {
    fn drop(&mut self) {
        self.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_of_the_callback_ends_in_zero_force_and_not_in_the_library() {
        let fake = fake_hd::Fake::new(&[("Arm", "Touch")]).unwrap();
        let library = HdLibrary::shared(Some(fake.path().to_owned())).unwrap();
        let log = DeviceLog::new().0;
        let mut touch = Touch::new(library.clone(), library.open("Arm", None, &log).unwrap(), "Arm", &log);
        let mut force = DeviceForce::zero();
        force.force.z = 1.0;
        let start = Instant::now();
        while fake.newest_force("Arm").is_none_or(|felt| felt.force[1] == 0.0) {
            touch.write(&force).unwrap();
            assert!(start.elapsed() < Duration::from_secs(20));
        }
        touch.opened.as_ref().unwrap().shared.panic.store(true, Ordering::Relaxed);
        let error = loop {
            touch.write(&force).unwrap();
            match touch.read() {
                // A busy machine may take seconds to print the panic's backtrace, in the scheduler's thread.
                Err(error) if !error.to_string().contains("stands still") => break error,
                _ => assert!(start.elapsed() < Duration::from_secs(60)),
            }
        };
        assert!(error.to_string().contains("panicked"), "{error}");
        assert_eq!(fake.newest_force("Arm").unwrap().force, [0.0; 3]);
        touch.close();
        assert_eq!(fake.log().last().unwrap(), "disable Arm");
    }
}
