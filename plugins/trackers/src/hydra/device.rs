use std::io::{self, ErrorKind};
use std::thread;
use std::time::{Duration, Instant};

use ambf_device::{Axes, DeviceError, DeviceForce, DeviceSample, DeviceSpec, InputDevice};

use super::filter::LowPass;
use super::hidraw::Hid;
use super::report::{self, FEATURE};
use super::streams::Stream;
use crate::tracker;

/// The base does not always take the first report that starts it.
const ATTEMPTS: u32 = 50;
const BETWEEN_ATTEMPTS: Duration = Duration::from_millis(50);
/// A pose older than this is not to be trusted.
const STALE: Duration = Duration::from_millis(100);
/// A base that is silent for so long is lost.
const LOST: Duration = Duration::from_secs(2);
/// More reports than the kernel keeps.
const MAX_REPORTS: u32 = 128;

/// Name of the model.
pub(super) const MODEL: &str = "Razer Hydra";

/// One of the two controllers of a Hydra.
pub(super) struct Hydra<F: Hid> {
    /// `None` once it was closed.
    file: Option<F>,
    /// Keeps the stream of the base running while one of its controllers is in use.
    stream: Stream,
    controller: usize,
    name: String,
    filter: LowPass,
    spec: DeviceSpec,
    sample: DeviceSample,
    heard: Instant,
}

impl<F: Hid> Hydra<F> {
    /// Starts the stream of a base and reads controller 0 or 1 of it.
    ///
    /// # Errors
    /// When the base does not take the report that starts it.
    pub fn start(mut file: F, stream: Stream, controller: usize, name: &str, corner: f64) -> Result<Self, DeviceError> {
        let mut attempt = 1;
        while let Err(error) = file.set_feature(report::streaming(true)) {
            if attempt == ATTEMPTS || is_gone(&error) {
                return Err(DeviceError::Unavailable(format!("`{name}` does not start: {error}")));
            }
            attempt += 1;
            thread::sleep(BETWEEN_ATTEMPTS);
        }
        let now = Instant::now();
        Ok(Self {
            file: Some(file),
            stream,
            controller,
            name: name.to_owned(),
            filter: LowPass::new(corner),
            spec: spec(),
            sample: DeviceSample::none(now),
            heard: now,
        })
    }

    fn lost(&self, why: impl std::fmt::Display) -> DeviceError {
        DeviceError::Lost(format!("`{}` is lost: {why}", self.name))
    }

    /// Takes one report, if it is one.
    fn take(&mut self, bytes: &[u8], now: Instant) {
        let Some(controller) = report::parse(bytes, self.controller) else { return };
        let (position, rotation) = self.filter.pass(controller.position, controller.rotation);
        let (position, rotation) = report::to_device(position, rotation);
        self.heard = now;
        self.sample = DeviceSample {
            stamp: now,
            sequence: self.sample.sequence + 1,
            position,
            rotation,
            linear_velocity: None,
            angular_velocity: None,
            gripper: Some(1.0 - controller.trigger),
            buttons: controller.buttons,
            valid: true,
        };
    }
}

fn is_gone(error: &io::Error) -> bool {
    matches!(rustix::io::Errno::from_io_error(error), Some(rustix::io::Errno::NODEV | rustix::io::Errno::NXIO))
}

fn spec() -> DeviceSpec {
    DeviceSpec {
        manufacturer: String::from("Razer"),
        workspace_radius: 0.5,
        gripper_max_angle: 30_f64.to_radians(),
        sensed: Axes { position: true, rotation: true, gripper: true },
        start_up_hold: 5.0,
        ..tracker(MODEL)
    }
}

impl<F: Hid> InputDevice for Hydra<F> {
    fn spec(&self) -> &DeviceSpec {
        &self.spec
    }

    fn read(&mut self) -> Result<DeviceSample, DeviceError> {
        let Some(mut file) = self.file.take() else { return Err(self.lost("it is closed")) };
        let now = Instant::now();
        let mut bytes = [0; FEATURE];
        let mut result = Ok(());
        for _ in 0..MAX_REPORTS {
            match file.read(&mut bytes) {
                Ok(0) => {
                    result = Err(self.lost("its file has ended"));
                    break;
                }
                Ok(length) => self.take(&bytes[..length], now),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => {
                    result = Err(self.lost(error));
                    break;
                }
            }
        }
        self.file = Some(file);
        result?;
        let silence = now.saturating_duration_since(self.heard);
        if silence > LOST {
            return Err(self.lost("it sends nothing"));
        }
        Ok(DeviceSample { valid: self.sample.valid && silence <= STALE, ..self.sample })
    }

    fn write(&mut self, _force: &DeviceForce) -> Result<(), DeviceError> {
        // There is nothing that could move.
        Ok(())
    }

    fn close(&mut self) {
        let Some(mut file) = self.file.take() else { return };
        self.stream.leave(|| {
            // A base that was unplugged needs not be stopped.
            drop(file.set_feature(report::streaming(false)));
        });
    }
}

impl<F: Hid> Drop for Hydra<F> {
    fn drop(&mut self) {
        self.close();
    }
}
