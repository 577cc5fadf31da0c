use ambf_device::{DeviceError, SettingError, Settings};

use super::axes::{self, Map};

/// Settings of the driver, read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Options {
    /// Axes are velocities, and what they add up to is the pose; otherwise they are the pose.
    pub rates: bool,
    /// At full deflection: m/s, or m.
    pub speed: f64,
    /// At full deflection: rad/s, or rad.
    pub turn: f64,
    /// Part of the whole around the middle that counts as the middle.
    pub dead_zone: f64,
    /// `None`: what suits the device.
    pub map: Option<Map>,
    /// Axis that closes the gripper.
    pub gripper: Option<(u16, f64)>,
}

const KEYS: [&str; 6] = ["mode", "speed", "turn", "dead zone", "axes", "gripper"];

impl Options {
    /// # Errors
    /// [`DeviceError::Setting`].
    pub fn read(settings: &Settings) -> Result<Self, DeviceError> {
        settings.unknown(&KEYS)?;
        let rates = match settings.text("mode").map(str::trim) {
            None | Some("rate") => true,
            Some("position") => false,
            Some(_) => return Err(settings.wrong("mode", "rate or position").into()),
        };
        let number = |key: &str, default: f64, range: std::ops::RangeInclusive<f64>| -> Result<f64, SettingError> {
            let expected = format!("a number, {} to {}", range.start(), range.end());
            match settings.parsed::<f64>(key, &expected)? {
                None => Ok(default),
                Some(value) if range.contains(&value) => Ok(value),
                Some(_) => Err(settings.wrong(key, &expected)),
            }
        };
        let map = match settings.text("axes") {
            None => None,
            Some(text) => Some(Map::parse(text).ok_or_else(|| {
                let expected = format!(
                    "six axes for x y z and the turns about them, each a name, a name with a minus, or 0, as in `y x -rz 0 0 -z`; names are {}",
                    axes::names()
                );
                settings.wrong("axes", &expected)
            })?),
        };
        let gripper = match settings.text("gripper").map(str::trim) {
            None => None,
            Some(word) => Some(
                axes::source(word)
                    .ok_or_else(|| settings.wrong("gripper", &format!("an axis out of {}", axes::names())))?,
            ),
        };
        Ok(Self {
            rates,
            speed: number("speed", 0.1, 0.0..=10.0)?,
            turn: number("turn", 1.0, 0.0..=20.0)?,
            dead_zone: number("dead zone", 0.1, 0.0..=0.9)?,
            map,
            gripper,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_device::Setting;
    use std::path::PathBuf;

    fn read(entries: &[(&str, &str)]) -> Result<Options, DeviceError> {
        let entry = |(key, value): &(&str, &str)| {
            ((*key).to_owned(), Setting { value: (*value).to_owned(), place: String::from("devices.yaml:4") })
        };
        Options::read(&Settings::new(entries.iter().map(entry).collect(), PathBuf::new()))
    }

    #[test]
    fn settings_have_defaults() {
        let options = read(&[]).unwrap();
        let expected = Options { rates: true, speed: 0.1, turn: 1.0, dead_zone: 0.1, map: None, gripper: None };
        assert_eq!(options, expected);
        let options =
            read(&[("mode", "position"), ("speed", "0.3"), ("gripper", "-rz"), ("axes", "x y z rx ry rz")]).unwrap();
        assert!(!options.rates && options.speed == 0.3 && options.gripper == Some((5, -1.0)) && options.map.is_some());
    }

    #[test]
    fn wrong_ones_are_named() {
        for (key, value, expected) in [
            ("mode", "velocity", "rate or position"),
            ("speed", "-1", "a number, 0 to 10"),
            ("speed", "NaN", "a number, 0 to 10"),
            ("dead zone", "1", "0 to 0.9"),
            ("axes", "x y", "six axes"),
            ("gripper", "trigger", "throttle"),
            ("deadzone", "0.1", "one of the keys"),
        ] {
            let error = read(&[(key, value)]).unwrap_err().to_string();
            assert!(
                error.starts_with(&format!("devices.yaml:4: `{key}` is `{value}`")) && error.contains(expected),
                "{error}"
            );
        }
    }
}
