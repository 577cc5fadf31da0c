//! Input devices that sense a hand and give no force: Razer Hydra, SpaceMouse, joysticks and gamepads.
//!
//! They are what somebody without a haptic device can hold. Both drivers read Linux device files without waiting, so that the host's thread reads
//! them itself; writing a force does nothing.

mod hydra;
mod joystick;

use std::sync::Arc;

use ambf_core::device::Driver;

pub use hydra::HydraDriver;
pub use joystick::JoystickDriver;

/// The drivers `hydra` and `joystick`, for [`Drivers`](ambf_core::device::Drivers).
pub fn drivers() -> [Arc<dyn Driver>; 2] {
    [Arc::new(HydraDriver::default()), Arc::new(JoystickDriver::default())]
}
