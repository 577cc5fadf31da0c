use ambf_device::{DeviceError, Settings};

use crate::firmware::Firmware;

/// Distance of the device frame's origin from the base, m. Not verified against the vendor's library.
const Z0: f64 = 0.125;

/// Keys of `driver settings`.
pub(crate) const KEYS: [&str; 5] = ["event character", "firmware", "port", "transport", "z0"];

/// What the user wants of a device.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Config {
    pub firmware: Option<Firmware>,
    pub z0: f64,
    pub event_character: bool,
}

/// Reads the settings of a device, and the firmware if there is any.
pub(crate) fn config(settings: &Settings) -> Result<Config, DeviceError> {
    let expected = "a distance in m between 0.05 and 0.2";
    let z0 = settings.parsed("z0", expected)?.unwrap_or(Z0);
    if !(0.05..=0.2).contains(&z0) {
        return Err(settings.wrong("z0", expected).into());
    }
    let event_character = settings.boolean("event character")?.unwrap_or(false);
    let firmware = match settings.path("firmware") {
        Some(path) => Some(Firmware::read(&path).map_err(|error| DeviceError::Unavailable(error.to_string()))?),
        None => None,
    };
    Ok(Config { firmware, z0, event_character })
}
