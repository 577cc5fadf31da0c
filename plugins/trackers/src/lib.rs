//! Input devices that sense a hand and give no force: Razer Hydra, SpaceMouse, joysticks and gamepads.
//!
//! They are what somebody without a haptic device can hold. Both drivers read Linux device files without waiting, so
//! that the host's thread reads them itself; writing a force does nothing.
//!
//! Begin with [`JoystickDriver`] or [`HydraDriver`]: `find` lists device files, `open` gives the device that the host
//! reads. `docs/trackers.md` is the guide.

mod hydra;
mod joystick;

use std::path::Path;
use std::sync::Arc;

use ambf_device::{Axes, DeviceSpec, Driver, Presence};
use rustix::fs::{access, Access};

pub use hydra::HydraDriver;
pub use joystick::JoystickDriver;

/// The drivers `hydra` and `joystick`, for [`Drivers`](ambf_device::Drivers).
pub fn drivers() -> [Arc<dyn Driver>; 2] {
    [Arc::new(HydraDriver::default()), Arc::new(JoystickDriver::default())]
}

/// What can be told of a device by its file, which is not opened.
fn may_open(path: &Path, how: Access) -> Presence {
    match access(path, how) {
        Ok(()) => Presence::There(path.display().to_string()),
        Err(error) => Presence::NotReady(format!(
            "{} cannot be opened: {error}; log in at this computer, or see resources/udev for rules that allow it",
            path.display()
        )),
    }
}

/// A tracker for either hand that senses position and rotation, and no more is known about it than that.
fn tracker(model: &str) -> DeviceSpec {
    DeviceSpec {
        max_force: 0.0,
        max_torque: 0.0,
        max_gripper_force: 0.0,
        max_stiffness: 1000.0,
        max_angular_stiffness: 1.0,
        max_gripper_stiffness: 0.0,
        max_damping: 0.0,
        max_angular_damping: 0.0,
        max_gripper_damping: 0.0,
        gripper_max_angle: 0.0,
        sensed: Axes { position: true, rotation: true, gripper: false },
        left_hand: true,
        right_hand: true,
        ..DeviceSpec::unknown(model)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn device_files_that_cannot_be_opened_are_named() {
        assert_eq!(may_open(Path::new("/dev/null"), Access::READ_OK), Presence::There("/dev/null".into()));
        let Presence::NotReady(why) = may_open(Path::new("/dev/input/none"), Access::READ_OK) else {
            panic!("a file that does not exist")
        };
        assert!(why.contains("/dev/input/none"), "{why}");
    }
}
