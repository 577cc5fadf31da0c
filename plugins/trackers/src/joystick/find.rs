//! Which input devices there are, as the kernel lists them; nothing is opened.

use std::fs;
use std::path::{Path, PathBuf};

use evdev::{AbsoluteAxisCode, KeyCode, RelativeAxisCode};

/// Joystick or gamepad.
pub(super) const JOYSTICK: &str = "Joystick";
/// A cap with six degrees of freedom.
pub(super) const SPACE_MOUSE: &str = "SpaceMouse";

/// 3Dconnexion, and Logitech, which made them before.
const SPACE_MOUSE_VENDORS: [u32; 2] = [0x256F, 0x046D];
/// Buttons of joysticks and gamepads: from `BTN_JOYSTICK` up to `BTN_DIGI`.
const JOYSTICK_BUTTONS: std::ops::Range<u16> = 0x120..0x140;
/// `INPUT_PROP_ACCELEROMETER`: the motion sensor of a gamepad, which is a device of its own.
const ACCELEROMETER: u16 = 6;

/// An input device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Found {
    /// Where it is plugged in, or what it is called by if that is not known.
    pub identity: String,
    pub name: String,
    /// Device file.
    pub path: PathBuf,
}

/// A set of numbers as the kernel prints it: words in hexadecimal, the lowest last.
struct Bits(Vec<u64>);

impl Bits {
    fn read(path: &Path) -> Self {
        let text = fs::read_to_string(path).unwrap_or_default();
        Self(text.split_whitespace().rev().map(|word| u64::from_str_radix(word, 16).unwrap_or(0)).collect())
    }

    fn has(&self, bit: u16) -> bool {
        self.0.get(usize::from(bit / 64)).is_some_and(|word| word >> (bit % 64) & 1 == 1)
    }
}

/// Devices of a model, in the order of their device files. `sys` is where the kernel lists devices, `/sys`.
pub(super) fn list(sys: &Path, model: &str) -> Vec<Found> {
    let entries = sys.join("class/input").read_dir().into_iter().flatten().flatten();
    let mut numbered: Vec<(u32, PathBuf)> = entries
        .filter_map(|entry| {
            let number = entry.file_name().to_str()?.strip_prefix("event")?.parse().ok()?;
            Some((number, entry.path().join("device")))
        })
        .collect();
    numbered.sort();
    let mut found: Vec<Found> = Vec::new();
    for (number, device) in numbered {
        if model_of(&device) != Some(model) {
            continue;
        }
        let text = |name: &str| fs::read_to_string(device.join(name)).unwrap_or_default().trim().to_owned();
        let name = text("name");
        let known = [text("phys"), text("uniq"), name.clone()].into_iter().find(|text| !text.is_empty());
        let identity = known.unwrap_or_else(|| format!("event{number}"));
        // Two devices behind one port: the second is told apart by its place.
        let numbered = format!("{identity} #");
        let is_same = |other: &&Found| other.identity == identity || other.identity.starts_with(&numbered);
        let same = found.iter().filter(is_same).count();
        let identity = if same == 0 { identity } else { format!("{numbered}{}", same + 1) };
        found.push(Found { identity, name, path: PathBuf::from(format!("/dev/input/event{number}")) });
    }
    found
}

fn model_of(device: &Path) -> Option<&'static str> {
    let bits = |name: &str| Bits::read(&device.join("capabilities").join(name));
    let (absolute, relative, keys) = (bits("abs"), bits("rel"), bits("key"));
    let vendor = fs::read_to_string(device.join("id/vendor")).unwrap_or_default();
    let vendor = u32::from_str_radix(vendor.trim(), 16).unwrap_or(0);
    let six_absolute = (AbsoluteAxisCode::ABS_X.0..=AbsoluteAxisCode::ABS_RZ.0).all(|axis| absolute.has(axis));
    let six_relative = (RelativeAxisCode::REL_X.0..=RelativeAxisCode::REL_RZ.0).all(|axis| relative.has(axis));
    let joystick = JOYSTICK_BUTTONS.clone().any(|button| keys.has(button));
    // Gamepads of Logitech have six axes too, and buttons of gamepads.
    if SPACE_MOUSE_VENDORS.contains(&vendor) && (six_relative || six_absolute && !joystick) {
        return Some(SPACE_MOUSE);
    }
    let two_axes = absolute.has(AbsoluteAxisCode::ABS_X.0) && absolute.has(AbsoluteAxisCode::ABS_Y.0);
    let other = keys.has(KeyCode::BTN_TOUCH.0) || Bits::read(&device.join("properties")).has(ACCELEROMETER);
    (joystick && two_axes && !other).then_some(JOYSTICK)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A folder like `/sys`, removed when dropped.
    pub struct Sys(pub PathBuf);

    impl Sys {
        pub fn new(name: &str) -> Self {
            Self(std::env::temp_dir().join(format!("trackers-{name}-{}", std::process::id())))
        }

        pub fn add(&self, event: u32, files: &[(&str, &str)]) {
            let device = self.0.join(format!("class/input/event{event}/device"));
            for (name, text) in files {
                let path = device.join(name);
                fs::create_dir_all(path.parent().unwrap()).unwrap();
                fs::write(path, format!("{text}\n")).unwrap();
            }
        }
    }

    impl Drop for Sys {
        fn drop(&mut self) {
            drop(fs::remove_dir_all(&self.0));
        }
    }

    #[test]
    fn devices_are_told_apart_by_what_they_can() {
        let sys = Sys::new("find");
        let pad = [("capabilities/abs", "3003f"), ("capabilities/key", "7cdb000000000000 0 0 0 0"), ("name", "Pad")];
        sys.add(10, &[&pad[..], &[("id/vendor", "045e"), ("phys", "usb-0000:00:14.0-1/input0")]].concat());
        sys.add(2, &[&pad[..], &[("id/vendor", "046d"), ("phys", ""), ("uniq", "a0:b1")]].concat());
        sys.add(
            3,
            &[("capabilities/rel", "3f"), ("id/vendor", "046d"), ("phys", "usb-2/input0"), ("name", "SpaceNavigator")],
        );
        sys.add(
            4,
            &[("capabilities/abs", "3f"), ("id/vendor", "256f"), ("phys", "usb-3/input0"), ("name", "SpaceMouse")],
        );
        // A mouse, a touchpad, the motion sensor of a gamepad, a keyboard.
        sys.add(5, &[("capabilities/rel", "903"), ("id/vendor", "046d"), ("capabilities/key", "70000 0 0 0 0")]);
        sys.add(6, &[("capabilities/abs", "3"), ("capabilities/key", "420 1000000000000 0 0 0 0")]);
        sys.add(7, &[&pad[..], &[("properties", "40")]].concat());
        sys.add(8, &[("capabilities/key", "fffffffffffffffe")]);
        let joysticks = list(&sys.0, JOYSTICK);
        let seen: Vec<_> =
            joysticks.iter().map(|found| (found.identity.as_str(), found.path.to_str().unwrap())).collect();
        assert_eq!(seen, [("a0:b1", "/dev/input/event2"), ("usb-0000:00:14.0-1/input0", "/dev/input/event10")]);
        let mice: Vec<_> = list(&sys.0, SPACE_MOUSE).into_iter().map(|found| found.name).collect();
        assert_eq!(mice, ["SpaceNavigator", "SpaceMouse"]);
        assert_eq!(list(Path::new("/nowhere"), JOYSTICK), []);
    }

    #[test]
    fn two_devices_behind_one_port_have_two_identities() {
        let sys = Sys::new("port");
        for (event, port) in [(1, "usb-10"), (2, "usb-1"), (3, "usb-1")] {
            sys.add(event, &[("capabilities/abs", "3"), ("capabilities/key", "100000000 0 0 0 0"), ("phys", port)]);
        }
        let identities: Vec<_> = list(&sys.0, JOYSTICK).into_iter().map(|found| found.identity).collect();
        assert_eq!(identities, ["usb-10", "usb-1", "usb-1 #2"]);
    }
}
