//! Input devices files.

use std::path::PathBuf;

use nalgebra::{Isometry3, UnitQuaternion};

use super::common::SourcePos;
use super::controller::CartesianController;
use super::reader::{Absent, Map, Range};
use super::report::ProblemKind;
use super::yaml::Mark;
use crate::{Setting, Settings};

/// An input device paired with a simulated end-effector, as written.
#[derive(Clone, Debug, PartialEq)]
pub struct InputDevice {
    /// Name of the entry.
    pub identifier: String,
    /// Model name that the device's driver reports.
    pub hardware_name: String,
    /// Proportional gains of the force feedback; `None`: no feedback.
    pub haptic_gain: Option<HapticGain>,
    /// Wrenches below it are zeroed, N. Default: 0.001.
    pub deadband: f64,
    /// Largest force, N; the device's rated maximum counts too.
    pub max_force: Option<f64>,
    /// As written; without use.
    pub max_jerk: Option<f64>,
    /// Device metres to world metres; positive. Default: 1.
    pub workspace_scaling: f64,
    /// Offset of the tool's orientation. Default: identity.
    pub orientation_offset: UnitQuaternion<f64>,
    /// Buttons.
    pub button_mapping: ButtonMapping,
    /// Draw a sphere at the reference pose. Default: `false`.
    pub visible: bool,
    /// Size of the sphere. Default: 1.
    pub visible_size: f64,
    /// Model file of the simulated end-effector, joined to the file's directory when it was relative.
    pub simulated_multibody: Option<PathBuf>,
    /// Body to drive; `None`: the root body of the model.
    pub root_link: Option<String>,
    /// Initial pose of the root link's body frame in the world, to which the whole model is moved; `None`: the body's
    /// own.
    pub location: Option<Isometry3<f64>>,
    /// Replaces the root link's Cartesian controller.
    pub controller_gain: Option<CartesianController>,
    /// Gripper opening drives the joints. Default: `true`.
    pub enable_joint_control: bool,
    /// Forces start with the first press of button 0. Default: `true`.
    pub enable_on_button: bool,
    /// The proportional gain of the end-effector shrinks in steps that are longer than nominal. Default: `false`.
    pub time_scaled_gain: bool,
    /// Name of the driver; `None`: the one that serves the hardware name.
    pub driver: Option<String>,
    /// Which of several equal devices: USB port, serial number, name of the arm; `None`: the first that is free.
    pub identity: Option<String>,
    /// Settings of the driver.
    pub driver_settings: Settings,
    /// Names of cameras; motion is relative to the first. Empty: all cameras.
    pub pair_cameras: Vec<String>,
    /// Where the entry stands.
    pub source: SourcePos,
}

/// Proportional gains of the force feedback controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HapticGain {
    /// N/m.
    pub linear: f64,
    /// N·m/rad.
    pub angular: f64,
}

/// Button numbers, counted from 0; `None`: no such button (absent or negative).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ButtonMapping {
    /// Clutch.
    pub a1: Option<u32>,
    /// Camera clutch.
    pub a2: Option<u32>,
    /// Gripper, for devices without a gripper sensor; never equal to `a1` or `a2`.
    pub g1: Option<u32>,
    /// Next mode.
    pub next_mode: Option<u32>,
    /// Previous mode.
    pub prev_mode: Option<u32>,
}

/// An input devices file as written.
#[derive(Clone, Debug, PartialEq)]
pub struct InputDevices {
    /// Entries in list order, which is index order. `None`: the entry is unusable; its index stays taken.
    pub entries: Vec<Option<InputDevice>>,
    /// The file.
    pub source: SourcePos,
}

impl InputDevices {
    pub(super) fn read(root: &Map<'_>) -> Self {
        // In the original a wrong value ends the program.
        root.reader().tolerate();
        let devices = Self {
            entries: root.elements_in_place("input devices", "input device", Absent::Dropped, InputDevice::read),
            source: root.reader().source(root.mark),
        };
        root.finish_root();
        devices
    }
}

impl InputDevice {
    fn read(map: &Map<'_>) -> Option<Self> {
        let hardware_name = map.filled("hardware name");
        if hardware_name.is_none() {
            let expected = "the model name the device's driver reports";
            map.reject(ProblemKind::MissingKey, "hardware name", expected);
        }
        let mut deadband = map.real("deadband").unwrap_or(0.001);
        if deadband < 0.0 {
            map.warn(ProblemKind::OutOfRange, "deadband", "at least 0 N", "0 is used");
            deadband = 0.0;
        }
        let device = Self {
            identifier: map.key().to_owned(),
            hardware_name: hardware_name.unwrap_or_default(),
            haptic_gain: map.map_opt("haptic gain").map(|block| {
                let gain = HapticGain { linear: block.need_real("linear"), angular: block.need_real("angular") };
                block.finish();
                gain
            }),
            deadband,
            max_force: map.real("max force"),
            max_jerk: map.real("max jerk"),
            workspace_scaling: map.real_in("workspace scaling", Range::Positive).unwrap_or(1.0),
            orientation_offset: map.rotation("orientation offset").unwrap_or_default(),
            button_mapping: ButtonMapping::read(map),
            visible: map.boolean("visible").unwrap_or(false),
            visible_size: map.real("visible size").unwrap_or(1.0),
            simulated_multibody: map.path_beside("simulated multibody"),
            root_link: map.filled("root link"),
            location: map.pose("location"),
            controller_gain: map.cartesian_controller("controller gain"),
            enable_joint_control: map.boolean("enable joint control").unwrap_or(true),
            enable_on_button: map.boolean("enable on button").unwrap_or(true),
            time_scaled_gain: map.boolean("time scaled gain").unwrap_or(false),
            driver: map.filled("driver"),
            identity: map.filled("identity"),
            driver_settings: settings(map),
            pair_cameras: (map.strings("pair cameras").iter()).map(|(camera, _)| (*camera).to_owned()).collect(),
            source: map.reader().source(map.mark),
        };
        if device.simulated_multibody.is_none() && device.root_link.is_none() {
            let expected = "a model file, or a `root link`";
            map.reject(ProblemKind::MissingKey, "simulated multibody", expected);
        }
        map.ignore(&["cameras"], "it is called `pair cameras` now");
        map.ignore(&["visible color"], "markers have a fixed colour");
        map.finish();
        Some(device)
    }
}

fn settings(map: &Map<'_>) -> Settings {
    let file = map.reader().file().display();
    let setting = |(key, value, mark): (&str, &str, Mark)| {
        (key.to_owned(), Setting { value: value.to_owned(), place: format!("{file}:{}", mark.line) })
    };
    let entries = map.scalars("driver settings").into_iter().map(setting).collect();
    Settings::new(entries, map.reader().dir().to_owned())
}

impl ButtonMapping {
    fn read(map: &Map<'_>) -> Self {
        let block = map.map("button mapping");
        let button = |key| block.int(key).and_then(|i| u32::try_from(i).ok());
        let mut mapping = Self {
            a1: button("a1"),
            a2: button("a2"),
            g1: button("g1"),
            next_mode: button("next mode"),
            prev_mode: button("prev mode"),
        };
        if mapping.g1.is_some() && (mapping.g1 == mapping.a1 || mapping.g1 == mapping.a2) {
            let expected = "another button than `a1` and `a2`";
            let action = "the gripper button is not used";
            block.warn(ProblemKind::OutOfRange, "g1", expected, action);
            mapping.g1 = None;
        }
        block.finish();
        mapping
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clean, read};
    use super::*;

    #[test]
    fn devices() {
        let text = "input devices: [D]\nD:\n  hardware name: Falcon\n  root link: L
  orientation offset: {r: 0, p: 0, y: 1}\n  button mapping: {a1: 0, a2: -1, next mode: 3}
  controller gain: {linear: {P: 1, D: 0}}\n  pair cameras: [c]\n";
        let devices: InputDevices = clean(text);
        let device = devices.entries[0].as_ref().expect("a device");
        assert_eq!((device.identifier.as_str(), device.hardware_name.as_str()), ("D", "Falcon"));
        assert_eq!((device.haptic_gain, device.deadband), (None, 0.001));
        assert_eq!((device.workspace_scaling, device.location), (1.0, None));
        assert!((device.orientation_offset.angle() - 1.0).abs() < 1e-12);
        let buttons = device.button_mapping;
        assert_eq!((buttons.a1, buttons.a2, buttons.next_mode), (Some(0), None, Some(3)));
        assert!(device.enable_joint_control && device.controller_gain.is_some());
    }

    #[test]
    fn keys_that_the_original_lacks() {
        let text = "input devices: [D, E]\nD:\n  hardware name: Falcon\n  root link: L\n  driver: falcon
  identity: 1-2\n  enable on button: false\n  time scaled gain: true
  driver settings: {firmware: f.bin, rate: 250, home: yes, empty: }\nE: {hardware name: x, root link: l}\n";
        let devices: InputDevices = clean(text);
        let [device, other] = [0, 1].map(|i| devices.entries[i].as_ref().expect("a device"));
        assert_eq!((device.driver.as_deref(), device.identity.as_deref()), (Some("falcon"), Some("1-2")));
        assert!(!device.enable_on_button && device.time_scaled_gain);
        let settings = &device.driver_settings;
        assert_eq!(settings.path("firmware"), Some("dir/f.bin".into()));
        assert_eq!(settings.parsed("rate", "a number").unwrap(), Some(250.0));
        assert_eq!((settings.boolean("home").unwrap(), settings.text("empty")), (Some(true), Some("")));
        let error = settings.boolean("firmware").unwrap_err().to_string();
        assert_eq!(error, "dir/t.yaml:9: `firmware` is `f.bin`, expected true or false");
        assert!(other.enable_on_button && !other.time_scaled_gain && other.driver.is_none());
        assert!(other.driver_settings.unknown(&[]).is_ok());
    }

    #[test]
    fn settings_of_a_driver_are_scalars() {
        let text = "input devices: [D]\nD: {hardware name: x, root link: l, driver settings: {a: 1, b: [2]}}\n";
        let (devices, problems) = read::<InputDevices>(text);
        assert_eq!((devices.entries.as_slice(), problems.len()), ([None].as_slice(), 1));
        assert!(problems[0].contains("`D / driver settings / b` is a list of 1, expected a text"), "{problems:?}");
        let text = "input devices: [D]\nD: {hardware name: x, root link: l, driver settings: {a: 1, a: 2}}\n";
        let (devices, problems) = read::<InputDevices>(text);
        let device = devices.entries[0].as_ref().expect("a device");
        assert_eq!((device.driver_settings.text("a"), problems.len()), (Some("1"), 1), "{problems:?}");
    }

    #[test]
    fn wrong_values_drop_one_device_and_keep_its_index() {
        let text = "input devices: [A, B, C, D]\nA: {hardware name: x}\nB: {root link: l}\n\
                    C: {hardware name: x, root link: l, deadband: z}\n\
                    D: {hardware name: x, root link: l, deadband: -1, button mapping: {a1: 1, g1: 1}}\n";
        let (devices, problems) = read::<InputDevices>(text);
        let there: Vec<_> = devices.entries.iter().map(Option::is_some).collect();
        assert_eq!(there, [false, false, false, true]);
        let device = devices.entries[3].as_ref().expect("the last");
        assert_eq!((device.deadband, device.button_mapping.g1), (0.0, None));
        assert_eq!(problems.len(), 5, "{problems:#?}");
    }
}
