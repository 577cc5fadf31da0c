//! Joysticks, gamepads and SpaceMouse through Linux' input events.

mod axes;
mod device;
mod find;
mod options;

use std::io::ErrorKind;
use std::path::PathBuf;

use ambf_device::{DeviceError, DeviceInfo, DeviceLog, Driver, InputDevice, Presence, Settings};
use rustix::fs::Access;

use device::{EventFile, Joystick};
use find::{JOYSTICK, SPACE_MOUSE};
use options::Options;

/// Driver `joystick`, for the models `Joystick` and `SpaceMouse`. The identity of a device is where it is plugged in.
///
/// Settings: `mode`, `rate` (axes are velocities, the pose is what they add up to; the default) or `position` (axes are
/// the pose); `speed` at full deflection, m/s or m (0.1); `turn`, rad/s or rad (1); `dead zone`, part of the whole
/// (0.1); `axes`, which axis moves x, y, z and turns about them, as in `y x -ry 0 0 -rx` (default: what suits the
/// device); `gripper`, axis that closes the gripper (default: none).
#[derive(Debug, Clone)]
pub struct JoystickDriver {
    sys: PathBuf,
}

impl Default for JoystickDriver {
    fn default() -> Self {
        Self { sys: PathBuf::from("/sys") }
    }
}

impl Driver for JoystickDriver {
    fn name(&self) -> &str {
        "joystick"
    }

    fn serves(&self, model: &str) -> bool {
        [JOYSTICK, SPACE_MOUSE].contains(&model)
    }

    fn find(&self, model: &str, settings: &Settings) -> Result<Vec<DeviceInfo>, DeviceError> {
        Options::read(settings)?;
        let found = find::list(&self.sys, model).into_iter();
        Ok(found.map(|found| DeviceInfo { model: model.to_owned(), identity: found.identity }).collect())
    }

    fn presence(&self, info: &DeviceInfo, _settings: &Settings) -> Presence {
        let listed = find::list(&self.sys, &info.model);
        match listed.iter().find(|found| found.identity == info.identity) {
            Some(found) => crate::may_open(&found.path, Access::READ_OK),
            None => Presence::NotReady(format!("`{}` is not plugged in", info.identity)),
        }
    }

    fn open(
        &self,
        info: &DeviceInfo,
        settings: &Settings,
        log: &DeviceLog,
    ) -> Result<Box<dyn InputDevice>, DeviceError> {
        let options = Options::read(settings)?;
        let name = &info.identity;
        let found = find::list(&self.sys, &info.model)
            .into_iter()
            .find(|found| found.identity == *name)
            .ok_or_else(|| DeviceError::Unavailable(format!("`{name}` is not plugged in")))?;
        let events = EventFile::open(&found.path).map_err(|error| {
            let hint = if error.kind() == ErrorKind::PermissionDenied {
                "; log in at this computer, or see resources/udev for rules that allow it"
            } else {
                ""
            };
            DeviceError::Unavailable(format!("`{name}`: {} cannot be opened: {error}{hint}", found.path.display()))
        })?;
        log.say(format!("`{name}` is a {}", found.name));
        Ok(Box::new(Joystick::new(events, &info.model, name, options)?))
    }
}

#[cfg(test)]
mod tests;
