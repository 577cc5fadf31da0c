//! What happens in the vendor's scheduler thread, a thousand times a second, for one device: samples out, forces in, no
//! locks, no waiting.

use std::ffi::c_void;
use std::panic::{catch_unwind, AssertUnwindSafe};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use ambf_device::{DeviceForce, Latest};
use nalgebra::{UnitQuaternion, Vector3};

use crate::convert::{self, MILLI};
use crate::hd::{self, ErrorInfo, ErrorKind, Handle};
use crate::library::HdLibrary;
use crate::models::{self, Facts};

const MS: u64 = 1_000_000;
/// A force older than this is not sent, ns.
const WATCHDOG: u64 = 50 * MS;
/// No force after a force error, ns.
const MUTE: u64 = 100 * MS;
/// Between two looks at the calibration, ns.
const CALIBRATION: u64 = 100 * MS;
/// A device that is at fault for so long is lost, ns.
const LOST: u64 = 500 * MS;
/// Frames without force at the end.
const LAST_FRAMES: u32 = 2;

/// [`Shared::phase`]: the callback was not called yet.
pub(crate) const WAITING: u32 = 0;
/// [`Shared::phase`]: [`Shared::facts`] are known and samples come.
pub(crate) const RUNNING: u32 = 1;
/// [`Shared::phase`]: the callback will never be called again.
pub(crate) const FINISHED: u32 = 2;
/// [`Shared::lost`]: the callback panicked; other values are error codes.
pub(crate) const PANICKED: u32 = u32::MAX;

/// What the device measured in a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Measured {
    /// ns after [`Shared::origin`].
    pub stamp: u64,
    pub sequence: u64,
    pub position: Vector3<f64>,
    pub rotation: UnitQuaternion<f64>,
    pub velocity: Vector3<f64>,
    pub buttons: u32,
    pub valid: bool,
    /// Base, shoulder, elbow, rad.
    pub joints: [f64; 3],
    /// The three of the gimbal, rad.
    pub gimbal: [f64; 3],
}

const SAMPLE_WORDS: usize = 20;

impl Measured {
    pub fn nothing() -> Self {
        Self {
            stamp: 0,
            sequence: 0,
            position: Vector3::zeros(),
            rotation: UnitQuaternion::identity(),
            velocity: Vector3::zeros(),
            buttons: 0,
            valid: false,
            joints: [0.0; 3],
            gimbal: [0.0; 3],
        }
    }

    fn to_words(self) -> [u64; SAMPLE_WORDS] {
        let numbers = self.position.iter().chain(self.rotation.coords.iter()).chain(self.velocity.iter());
        let mut numbers = numbers.chain(&self.joints).chain(&self.gimbal).map(|x| x.to_bits());
        let head = [self.stamp, self.sequence, u64::from(self.buttons), u64::from(self.valid)];
        std::array::from_fn(|i| head.get(i).copied().or_else(|| numbers.next()).unwrap_or(0))
    }

    pub fn from_words(words: &[u64; SAMPLE_WORDS]) -> Self {
        let x = |i: usize| f64::from_bits(words[4 + i]);
        Self {
            stamp: words[0],
            sequence: words[1],
            buttons: words[2] as u32,
            valid: words[3] == 1,
            position: Vector3::new(x(0), x(1), x(2)),
            rotation: UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(x(6), x(3), x(4), x(5))),
            velocity: Vector3::new(x(7), x(8), x(9)),
            joints: [x(10), x(11), x(12)],
            gimbal: [x(13), x(14), x(15)],
        }
    }
}

/// What the scheduler's thread and the host's thread share.
#[derive(Debug)]
pub(crate) struct Shared {
    /// Stamps count from here.
    pub origin: Instant,
    /// Written by the callback.
    pub sample: Latest<SAMPLE_WORDS>,
    /// Written by the host: stamp, force, torque.
    pub force: Latest<7>,
    pub phase: AtomicU32,
    pub facts: OnceLock<Facts>,
    /// Asks the callback to end.
    pub closing: AtomicBool,
    /// State of the calibration as HD names it; 0 before the first look.
    pub calibration: AtomicU32,
    /// Styles of calibration that the device knows.
    pub styles: AtomicU32,
    /// Newest force error, for the log.
    pub force_error: AtomicU32,
    /// Why the device is lost; 0 while it is not.
    pub lost: AtomicU32,
    /// When the callback was called last, ns.
    pub beat: AtomicU64,
    /// Makes the next tick panic.
    #[cfg(test)]
    pub panic: AtomicBool,
}

impl Shared {
    pub fn new() -> Self {
        Self {
            origin: Instant::now(),
            sample: Latest::new(),
            force: Latest::new(),
            phase: AtomicU32::new(WAITING),
            facts: OnceLock::new(),
            closing: AtomicBool::new(false),
            calibration: AtomicU32::new(0),
            styles: AtomicU32::new(0),
            force_error: AtomicU32::new(0),
            lost: AtomicU32::new(0),
            beat: AtomicU64::new(0),
            #[cfg(test)]
            panic: AtomicBool::new(false),
        }
    }

    /// ns since the origin.
    pub fn now(&self) -> u64 {
        u64::try_from(self.origin.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }

    /// Leaves a force for the next ticks. Only the host's thread may do so.
    pub fn leave_force(&self, force: &DeviceForce) {
        let force = if force.is_finite() { *force } else { DeviceForce::zero() };
        let mut numbers = force.force.iter().chain(force.torque.iter()).map(|x| x.to_bits());
        let now = self.now();
        self.force.store(std::array::from_fn(|i| if i == 0 { now } else { numbers.next().unwrap_or(0) }));
    }
}

/// State of the callback of a device. Only the scheduler's thread touches it.
pub(crate) struct Servo {
    library: Arc<HdLibrary>,
    device: Handle,
    shared: Arc<Shared>,
    set_up: bool,
    max_force: f64,
    max_torque: f64,
    /// Added to z, m.
    offset: f64,
    style: u32,
    next_calibration: u64,
    /// Newest force of the slot, with its stamp.
    force: [u64; 7],
    muted_until: u64,
    fault_since: Option<u64>,
    last: Measured,
    last_frames: u32,
}

impl Servo {
    pub fn new(library: Arc<HdLibrary>, device: Handle, shared: Arc<Shared>) -> Self {
        Self {
            library,
            device,
            shared,
            set_up: false,
            max_force: 0.0,
            max_torque: 0.0,
            offset: 0.0,
            style: 0,
            next_calibration: 0,
            force: [0; 7],
            muted_until: 0,
            fault_since: None,
            last: Measured::nothing(),
            last_frames: 0,
        }
    }

    /// One tick; gives back what the callback gives back.
    fn tick(&mut self) -> u32 {
        let library = self.library.clone();
        let hd = &library.hd;
        hd.make_current(self.device);
        if !self.set_up {
            self.set_up(hd);
        }
        let now = self.shared.now();
        self.shared.beat.store(now, Ordering::Relaxed);
        #[cfg(test)]
        assert!(!self.shared.panic.swap(false, Ordering::Relaxed), "a test asked for it");
        let closing = self.shared.closing.load(Ordering::Acquire);
        if !closing && now >= self.next_calibration {
            self.next_calibration = now + CALIBRATION;
            self.calibrate(hd);
        }

        hd.begin_frame(self.device);
        let transform = hd.doubles::<16>(hd::CURRENT_TRANSFORM);
        let velocity = hd.doubles::<3>(hd::CURRENT_VELOCITY);
        let buttons = hd.integer(hd::CURRENT_BUTTONS);
        let joints = hd.doubles::<3>(hd::CURRENT_JOINT_ANGLES);
        let gimbal = hd.doubles::<3>(hd::CURRENT_GIMBAL_ANGLES);
        // Another thread that initialises a device makes that one current, in the middle of this frame.
        let ours = hd.current() == self.device;
        if !ours {
            hd.make_current(self.device);
        }
        let (force, torque) = if closing { Default::default() } else { self.newest_force(now) };
        hd.set_vector(hd::CURRENT_FORCE, &convert::to_hd(force));
        if self.max_torque > 0.0 {
            hd.set_vector(hd::CURRENT_TORQUE, &convert::to_hd(torque / MILLI));
        }
        hd.end_frame(self.device);

        let fine = match hd.worst_error(self.device).map(|error| (error.kind(), error)) {
            None | Some((ErrorKind::Call, _)) => {
                self.fault_since = None;
                true
            }
            Some((ErrorKind::Force, error)) => {
                self.muted_until = now + MUTE;
                self.shared.force_error.store(error.code, Ordering::Relaxed);
                true
            }
            Some((ErrorKind::Device, error)) => {
                self.fault(now, error);
                false
            }
            Some((ErrorKind::Scheduler, error)) => {
                self.shared.lost.store(error.code, Ordering::Relaxed);
                return hd::DONE;
            }
        };
        self.publish(now, fine && ours, &transform, velocity, buttons, joints, gimbal);
        if closing {
            self.last_frames += 1;
            if self.last_frames >= LAST_FRAMES {
                return hd::DONE;
            }
        }
        hd::CONTINUE
    }

    /// What is done once, here because all calls that concern the current device belong into one thread.
    fn set_up(&mut self, hd: &hd::Hd) {
        self.set_up = true;
        let facts = Facts {
            model: hd.text(hd::DEVICE_MODEL_TYPE),
            vendor: hd.text(hd::DEVICE_VENDOR),
            serial: hd.text(hd::DEVICE_SERIAL_NUMBER),
            max_force: hd.doubles::<1>(hd::NOMINAL_MAX_FORCE)[0],
            workspace: hd.doubles::<6>(hd::USABLE_WORKSPACE_DIMENSIONS),
        };
        let (spec, offset) = models::spec(&facts);
        (self.max_force, self.max_torque, self.offset) = (spec.max_force, spec.max_torque, offset);
        let styles = hd.integer(hd::CALIBRATION_STYLE) as u32;
        let preferred = [hd::STYLE_AUTO, hd::STYLE_INKWELL, hd::STYLE_ENCODER_RESET];
        self.style = preferred.into_iter().find(|style| styles & style != 0).unwrap_or(0);
        hd.enable(hd::MAX_FORCE_CLAMPING);
        hd.enable(hd::FORCE_OUTPUT);
        // Values that a device does not have are none of the next frame's errors.
        hd.worst_error(self.device);
        self.shared.styles.store(styles, Ordering::Relaxed);
        // Nobody else sets it.
        drop(self.shared.facts.set(facts));
        self.shared.phase.store(RUNNING, Ordering::Release);
    }

    /// Looks how the calibration is, and updates it if that is all it needs.
    fn calibrate(&mut self, hd: &hd::Hd) {
        let state = hd.check_calibration();
        if state == hd::CALIBRATION_NEEDS_UPDATE && self.style != 0 {
            hd.update_calibration(self.style);
        }
        // What came of the update is seen at the next look: until then the pose is not trusted.
        self.shared.calibration.store(state, Ordering::Relaxed);
    }

    /// Force [N] and torque [N·m] to be sent: the newest of the host, none if that is too old or after a force error.
    fn newest_force(&mut self, now: u64) -> (Vector3<f64>, Vector3<f64>) {
        if let Some(words) = self.shared.force.newest() {
            self.force = words;
        }
        let old = now.saturating_sub(self.force[0]) > WATCHDOG || self.force[0] == 0;
        if old || now < self.muted_until || self.fault_since.is_some() || !self.last.valid {
            return Default::default();
        }
        let x = |i: usize| f64::from_bits(self.force[i]);
        let force = Vector3::new(x(1), x(2), x(3)).cap_magnitude(self.max_force);
        let torque = Vector3::new(x(4), x(5), x(6)).cap_magnitude(self.max_torque);
        (force, torque)
    }

    /// Notes that the device is at fault, and that it is lost if this goes on.
    fn fault(&mut self, now: u64, error: ErrorInfo) {
        let since = *self.fault_since.get_or_insert(now);
        if now.saturating_sub(since) > LOST {
            self.shared.lost.store(error.code, Ordering::Relaxed);
        }
    }

    #[allow(clippy::too_many_arguments, reason = "the values of one frame, as they were read")]
    fn publish(
        &mut self,
        now: u64,
        fine: bool,
        transform: &[f64; 16],
        velocity: [f64; 3],
        buttons: i32,
        joints: [f64; 3],
        gimbal: [f64; 3],
    ) {
        let calibrated = self.shared.calibration.load(Ordering::Relaxed) == hd::CALIBRATION_OK;
        let position = convert::position(transform) + Vector3::new(0.0, 0.0, self.offset);
        let rotation = convert::rotation(transform).filter(|_| fine && position.iter().all(|x| x.is_finite()));
        self.last = match rotation {
            Some(rotation) => Measured {
                stamp: now,
                sequence: self.last.sequence + 1,
                position,
                rotation,
                velocity: convert::vector(velocity) * MILLI,
                buttons: (buttons & 0xF) as u32,
                valid: calibrated,
                joints,
                gimbal,
            },
            // Nothing was measured: the last pose stays, and is not to be trusted.
            None => Measured { valid: false, ..self.last },
        };
        self.shared.sample.store(self.last.to_words());
    }

    /// One frame without force, whatever state the last one was left in.
    fn quiet(&self) {
        let hd = &self.library.hd;
        hd.make_current(self.device);
        hd.begin_frame(self.device);
        hd.set_vector(hd::CURRENT_FORCE, &[0.0; 3]);
        if self.max_torque > 0.0 {
            hd.set_vector(hd::CURRENT_TORQUE, &[0.0; 3]);
        }
        hd.end_frame(self.device);
        hd.worst_error(self.device);
    }
}

/// What the scheduler calls; `user` is a [`Servo`] from [`Box::into_raw`].
pub(crate) extern "C" fn callback(user: *mut c_void) -> u32 {
    let finished = {
        // SAFETY: `HdLibrary::open` schedules this with a servo that lives until `FINISHED` is seen, which is stored
        // below, last. The scheduler has one thread, so nobody else has a reference to it.
        let servo = unsafe { &mut *user.cast::<Servo>() };
        match catch_unwind(AssertUnwindSafe(|| servo.tick())) {
            Ok(hd::CONTINUE) => None,
            Ok(_) => Some(servo.shared.clone()),
            Err(_) => {
                servo.quiet();
                servo.shared.lost.store(PANICKED, Ordering::Relaxed);
                Some(servo.shared.clone())
            }
        }
    };
    match finished {
        None => hd::CONTINUE,
        Some(shared) => {
            shared.phase.store(FINISHED, Ordering::Release);
            hd::DONE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_survives_the_slot() {
        let measured = Measured {
            stamp: 5,
            sequence: 6,
            position: Vector3::new(1.0, 2.0, 3.0),
            rotation: UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3),
            velocity: Vector3::new(4.0, 5.0, 6.0),
            buttons: 3,
            valid: true,
            joints: [7.0, 8.0, 9.0],
            gimbal: [10.0, 11.0, 12.0],
        };
        assert_eq!(Measured::from_words(&measured.to_words()), measured);
    }

    #[test]
    fn a_force_that_is_no_number_is_none() {
        let shared = Shared::new();
        shared.leave_force(&DeviceForce { force: Vector3::new(1.0, f64::NAN, 0.0), ..DeviceForce::zero() });
        let words = shared.force.newest().unwrap();
        assert!(words[0] > 0 && words[1..].iter().all(|word| *word == 0));
    }
}
