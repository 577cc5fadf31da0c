//! The C interface of drivers of input devices: plain data and tables of functions. Its version is that of
//! [`abi`](super::abi).

use std::ffi::c_void;
use std::time::{Duration, Instant};

use nalgebra::{Quaternion, UnitQuaternion};

use super::abi::{rotation, RawText};
use ambf_device::{Axes, DeviceForce, DeviceSample, DeviceSpec};

/// Kind of a failure: what is needed is not there.
pub(crate) const UNAVAILABLE: u32 = 0;
/// Kind of a failure: the device is lost.
pub(crate) const LOST: u32 = 1;

/// Where a function of a driver says what it has to say, valid until it returns.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct RawAnswer {
    /// Given back to each function.
    pub context: *const c_void,
    /// Explains the failure that is about to be returned: 0 what is needed is not there, 1 the device is lost.
    pub fail: unsafe extern "C" fn(context: *const c_void, kind: u32, text: RawText),
    /// While looking for devices: there is this one.
    pub found: unsafe extern "C" fn(context: *const c_void, model: RawText, identity: RawText),
}

/// Where a device says what its user should know, from any thread, as long as it is open.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct RawLog {
    /// Given back to the function.
    pub context: *const c_void,
    /// Says a sentence, without waiting.
    pub say: unsafe extern "C" fn(context: *const c_void, text: RawText),
}

/// A setting of a device file.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct RawSetting {
    /// Key.
    pub key: RawText,
    /// Text of the value.
    pub value: RawText,
    /// `file:line`.
    pub place: RawText,
}

/// The settings of a device file.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct RawSettings {
    /// First setting.
    pub entries: *const RawSetting,
    /// How many.
    pub count: u64,
    /// Directory to which relative paths belong.
    pub directory: RawText,
}

/// What a device can do; see [`DeviceSpec`].
#[derive(Clone, Copy)]
#[repr(C)]
pub struct RawSpec {
    /// Model name.
    pub model: RawText,
    /// Who makes it.
    pub manufacturer: RawText,
    /// Largest force (N), torque (N·m), gripper force (N).
    pub max_force: [f64; 3],
    /// Largest stiffness of position (N/m), rotation (N·m/rad), gripper (N/m).
    pub max_stiffness: [f64; 3],
    /// Largest damping of position (N·s/m), rotation (N·m·s/rad), gripper (N·s/m).
    pub max_damping: [f64; 3],
    /// m.
    pub workspace_radius: f64,
    /// rad.
    pub gripper_max_angle: f64,
    /// s.
    pub start_up_hold: f64,
    /// Bits: 1 position, 2 rotation, 4 gripper.
    pub sensed: u32,
    /// The same.
    pub actuated: u32,
    /// Bits: 1 left, 2 right.
    pub hands: u32,
}

/// A measurement; see [`DeviceSample`].
#[derive(Clone, Copy, Default)]
#[repr(C)]
pub struct RawSample {
    /// How long ago it was measured, s.
    pub age: f64,
    /// Counts measurements.
    pub sequence: u64,
    /// m.
    pub position: [f64; 3],
    /// Quaternion x, y, z, w.
    pub rotation: [f64; 4],
    /// m/s; counts with flag 2.
    pub linear_velocity: [f64; 3],
    /// rad/s; counts with flag 4.
    pub angular_velocity: [f64; 3],
    /// 0 closed … 1 open; counts with flag 8.
    pub gripper: f64,
    /// One bit each.
    pub buttons: u32,
    /// Bits: 1 the pose may be trusted, 2 linear velocity, 4 angular velocity, 8 gripper.
    pub flags: u32,
}

/// What the user should feel; see [`DeviceForce`].
#[derive(Clone, Copy, Default)]
#[repr(C)]
pub struct RawForce {
    /// N.
    pub force: [f64; 3],
    /// N·m.
    pub torque: [f64; 3],
    /// N.
    pub gripper: f64,
}

/// A device that is open. Its functions are called from one thread at a time and return 0, 1 if they failed, 2 if they
/// panicked.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct RawDevice {
    /// Given back to each function.
    pub instance: *mut c_void,
    /// What it can do; its texts live as long as the device.
    pub spec: RawSpec,
    /// The newest measurement.
    pub read: unsafe extern "C" fn(instance: *mut c_void, answer: *const RawAnswer, out: *mut RawSample) -> i32,
    /// Lets the user feel a force.
    pub write: unsafe extern "C" fn(instance: *mut c_void, answer: *const RawAnswer, force: *const RawForce) -> i32,
    /// Sends a force of zero and closes the device; called once, before `destroy`.
    pub close: unsafe extern "C" fn(instance: *mut c_void, answer: *const RawAnswer) -> i32,
    /// Frees the device and this table.
    pub destroy: unsafe extern "C" fn(device: *mut RawDevice),
}

/// A driver. Its functions may be called from any thread, also from several at a time. It is never freed.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct RawDriver {
    /// Given back to each function.
    pub instance: *mut c_void,
    /// Name, as `driver` in device files.
    pub name: RawText,
    /// Whether devices of that model name are this driver's: 0 or 1.
    pub serves: unsafe extern "C" fn(instance: *mut c_void, model: RawText) -> i32,
    /// Tells `found` of each device that is there; 0, 1 or 2 as above.
    pub find: unsafe extern "C" fn(
        instance: *mut c_void,
        answer: *const RawAnswer,
        model: RawText,
        settings: *const RawSettings,
    ) -> i32,
    /// Opens a device; null: it failed. `log` lives as long as the device.
    pub open: unsafe extern "C" fn(
        instance: *mut c_void,
        answer: *const RawAnswer,
        model: RawText,
        identity: RawText,
        settings: *const RawSettings,
        log: *const RawLog,
    ) -> *mut RawDevice,
}

/// Type of the exported function `ambf_driver_create`; null: it failed.
pub type CreateDriverFn = unsafe extern "C" fn() -> *mut RawDriver;

fn axes(bits: u32) -> Axes {
    Axes { position: bits & 1 != 0, rotation: bits & 2 != 0, gripper: bits & 4 != 0 }
}

fn bits(axes: Axes) -> u32 {
    u32::from(axes.position) | u32::from(axes.rotation) << 1 | u32::from(axes.gripper) << 2
}

impl RawSpec {
    /// Borrows the texts of `spec`.
    pub(crate) fn of(spec: &DeviceSpec) -> Self {
        Self {
            model: RawText::of(&spec.model),
            manufacturer: RawText::of(&spec.manufacturer),
            max_force: [spec.max_force, spec.max_torque, spec.max_gripper_force],
            max_stiffness: [spec.max_stiffness, spec.max_angular_stiffness, spec.max_gripper_stiffness],
            max_damping: [spec.max_damping, spec.max_angular_damping, spec.max_gripper_damping],
            workspace_radius: spec.workspace_radius,
            gripper_max_angle: spec.gripper_max_angle,
            start_up_hold: spec.start_up_hold,
            sensed: bits(spec.sensed),
            actuated: bits(spec.actuated),
            hands: u32::from(spec.left_hand) | u32::from(spec.right_hand) << 1,
        }
    }

    /// # Safety
    /// The texts are valid.
    pub(crate) unsafe fn read(&self) -> DeviceSpec {
        // SAFETY: the caller vouches for the texts.
        let (model, manufacturer) = unsafe { (self.model.read(), self.manufacturer.read()) };
        let [max_force, max_torque, max_gripper_force] = self.max_force;
        let [max_stiffness, max_angular_stiffness, max_gripper_stiffness] = self.max_stiffness;
        let [max_damping, max_angular_damping, max_gripper_damping] = self.max_damping;
        DeviceSpec {
            manufacturer,
            max_force,
            max_torque,
            max_gripper_force,
            max_stiffness,
            max_angular_stiffness,
            max_gripper_stiffness,
            max_damping,
            max_angular_damping,
            max_gripper_damping,
            workspace_radius: self.workspace_radius,
            gripper_max_angle: self.gripper_max_angle,
            sensed: axes(self.sensed),
            actuated: axes(self.actuated),
            left_hand: self.hands & 1 != 0,
            right_hand: self.hands & 2 != 0,
            start_up_hold: self.start_up_hold,
            ..DeviceSpec::unknown(&model)
        }
    }
}

impl RawSample {
    pub(crate) fn of(sample: &DeviceSample, now: Instant) -> Self {
        let flag = |is: bool, bit: u32| if is { bit } else { 0 };
        Self {
            age: now.saturating_duration_since(sample.stamp).as_secs_f64(),
            sequence: sample.sequence,
            position: sample.position.into(),
            rotation: sample.rotation.coords.into(),
            linear_velocity: sample.linear_velocity.unwrap_or_default().into(),
            angular_velocity: sample.angular_velocity.unwrap_or_default().into(),
            gripper: sample.gripper.unwrap_or_default(),
            buttons: sample.buttons,
            flags: flag(sample.valid, 1)
                | flag(sample.linear_velocity.is_some(), 2)
                | flag(sample.angular_velocity.is_some(), 4)
                | flag(sample.gripper.is_some(), 8),
        }
    }

    /// The sample. Numbers that are not finite stay so: the device layer looks for them.
    pub(crate) fn read(&self, now: Instant) -> DeviceSample {
        let age = Duration::try_from_secs_f64(self.age.max(0.0)).unwrap_or(Duration::MAX);
        let rotation = match self.rotation.iter().any(|x| x.is_nan()) {
            true => UnitQuaternion::new_unchecked(Quaternion::from(self.rotation)),
            false => rotation(self.rotation).unwrap_or_default(),
        };
        let with = |bit: u32| self.flags & bit != 0;
        DeviceSample {
            stamp: now.checked_sub(age).unwrap_or(now),
            sequence: self.sequence,
            position: self.position.into(),
            rotation,
            linear_velocity: with(2).then(|| self.linear_velocity.into()),
            angular_velocity: with(4).then(|| self.angular_velocity.into()),
            gripper: with(8).then_some(self.gripper),
            buttons: self.buttons,
            valid: with(1),
        }
    }
}

impl From<&DeviceForce> for RawForce {
    fn from(force: &DeviceForce) -> Self {
        Self { force: force.force.into(), torque: force.torque.into(), gripper: force.gripper }
    }
}

impl From<&RawForce> for DeviceForce {
    fn from(raw: &RawForce) -> Self {
        Self { force: raw.force.into(), torque: raw.torque.into(), gripper: raw.gripper }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn samples_cross_unchanged() {
        let now = Instant::now() + Duration::from_secs(10);
        let mut sample = DeviceSample::none(now - Duration::from_millis(3));
        sample.rotation = UnitQuaternion::from_euler_angles(0.1, -0.2, 3.0);
        sample.position = Vector3::new(0.1, 0.2, 0.3);
        (sample.sequence, sample.buttons, sample.valid) = (9, 5, true);
        let back = |sample: &DeviceSample| RawSample::of(sample, now).read(now);
        assert_eq!(back(&sample), sample);
        sample.linear_velocity = Some(Vector3::x());
        sample.angular_velocity = Some(Vector3::y());
        sample.gripper = Some(0.5);
        assert_eq!(back(&sample), sample);
        sample.position.x = f64::NAN;
        assert!(!back(&sample).is_finite(), "seen by the device layer, not hidden");
    }

    #[test]
    fn nonsense_of_a_library_is_tamed() {
        let now = Instant::now();
        let raw = RawSample { age: f64::NAN, rotation: [0.0; 4], ..RawSample::default() };
        assert_eq!((raw.read(now).stamp, raw.read(now).rotation), (now, UnitQuaternion::identity()));
        let raw = RawSample { age: f64::INFINITY, rotation: [0.0, 0.0, 0.0, 2.0], ..RawSample::default() };
        assert_eq!(raw.read(now).rotation, UnitQuaternion::identity());
        let nan = RawSample { rotation: [f64::NAN, 0.0, 0.0, 1.0], ..RawSample::default() };
        assert!(!nan.read(now).is_finite());
    }

    #[test]
    fn specs_cross_unchanged() {
        let spec = DeviceSpec {
            max_force: 8.9,
            max_angular_stiffness: 3.0,
            max_gripper_damping: 0.3,
            sensed: Axes { position: true, rotation: false, gripper: true },
            actuated: Axes { position: true, rotation: true, gripper: false },
            right_hand: true,
            start_up_hold: 5.0,
            ..DeviceSpec::unknown("Ω")
        };
        // SAFETY: the texts live in `spec`.
        assert_eq!(unsafe { RawSpec::of(&spec).read() }, spec);
    }
}
