use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;

use ambf_device::{caught, Axes, DeviceError, DeviceForce, DeviceLog, DeviceSample, DeviceSpec, InputDevice};
use nalgebra::Vector3;
use triple_buffer::{triple_buffer, Input, Output};

use crate::motion::Wanted;
use crate::settings::Config;
use crate::transport::{Bus, TransportError};
use crate::worker::{Problem, Status, Worker};
use crate::MODEL;

/// A Falcon that is open, and the thread that talks to it.
pub struct FalconDevice {
    spec: DeviceSpec,
    bus: Arc<dyn Bus>,
    wanted: Input<Wanted>,
    status: Output<Status>,
    stop: Arc<AtomicBool>,
    ended: Arc<OnceLock<String>>,
    thread: Option<JoinHandle<()>>,
}

impl FalconDevice {
    pub(crate) fn open(
        bus: &Arc<dyn Bus>,
        identity: &str,
        config: Config,
        log: &DeviceLog,
    ) -> Result<Self, DeviceError> {
        let now = bus.now();
        let (wanted, wanted_reader) = triple_buffer(&Wanted { force: Vector3::zeros(), since: now });
        let (published, status) = triple_buffer(&Status::none(now));
        let stop = Arc::new(AtomicBool::new(false));
        let ended = Arc::new(OnceLock::new());
        if let Some(firmware) = config.firmware.as_ref().filter(|firmware| !firmware.is_known()) {
            log.say(format!("Falcon {identity}: firmware of {} bytes is not known to work", firmware.len()));
        }
        let mut worker =
            Worker::new(Arc::clone(bus), identity, config, log.clone(), Arc::clone(&stop), wanted_reader, published);
        worker.begin().map_err(|problem| {
            let text = format!("Falcon {identity}: {problem}");
            match problem {
                Problem::Transport(TransportError::Gone | TransportError::TimedOut) => DeviceError::Lost(text),
                _ => DeviceError::Unavailable(text),
            }
        })?;
        let thread = std::thread::Builder::new()
            .name(format!("falcon {identity}"))
            .spawn({
                let (ended, identity) = (Arc::clone(&ended), identity.to_owned());
                move || {
                    let why = run(worker);
                    // The only writer.
                    drop(ended.set(format!("Falcon {identity}: {why}")));
                }
            })
            .map_err(|error| DeviceError::Unavailable(format!("Falcon {identity}: no thread for it: {error}")))?;
        Ok(Self { spec: spec(), bus: Arc::clone(bus), wanted, status, stop, ended, thread: Some(thread) })
    }

    /// What is known of the device: more than a sample.
    pub fn status(&mut self) -> Status {
        *self.status.read()
    }

    fn alive(&self) -> Result<(), DeviceError> {
        match self.ended.get() {
            Some(why) => Err(DeviceError::Lost(why.clone())),
            None => Ok(()),
        }
    }
}

/// Talks to the device until it is told to stop, or there is no point in going on; says why.
fn run(mut worker: Worker) -> String {
    let result = caught(|| {
        while !worker.is_stopped() {
            if let Err(problem) = worker.step() {
                return problem.to_string();
            }
        }
        String::from("it was closed")
    });
    // After a panic the link has rested the motors while the stack was unwound; otherwise it does now. A second panic
    // is no reason to stay.
    drop(caught(|| worker.end()));
    result.unwrap_or_else(|panic| format!("its driver panicked: {panic}"))
}

impl InputDevice for FalconDevice {
    fn spec(&self) -> &DeviceSpec {
        &self.spec
    }

    fn read(&mut self) -> Result<DeviceSample, DeviceError> {
        self.alive()?;
        Ok(self.status.read().sample)
    }

    fn write(&mut self, force: &DeviceForce) -> Result<(), DeviceError> {
        self.alive()?;
        self.wanted.write(Wanted { force: force.force, since: self.bus.now() });
        Ok(())
    }

    fn close(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // Its panics are caught inside.
            drop(thread.join());
        }
    }
}

impl Drop for FalconDevice {
    fn drop(&mut self) {
        self.close();
    }
}

/// What a Falcon can do, as the vendor's library has it.
fn spec() -> DeviceSpec {
    let position = Axes { position: true, ..Axes::default() };
    DeviceSpec {
        manufacturer: String::from("Novint Technologies"),
        max_force: 8.0,
        max_torque: 0.0,
        max_gripper_force: 0.0,
        max_stiffness: 3000.0,
        max_angular_stiffness: 0.0,
        max_gripper_stiffness: 0.0,
        max_damping: 20.0,
        max_angular_damping: 0.0,
        max_gripper_damping: 0.0,
        workspace_radius: 0.04,
        gripper_max_angle: 0.0,
        sensed: position,
        actuated: position,
        left_hand: true,
        right_hand: true,
        ..DeviceSpec::unknown(MODEL)
    }
}
