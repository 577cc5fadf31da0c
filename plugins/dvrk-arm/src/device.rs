//! Arms as input devices.

use std::sync::atomic::Ordering;
use std::time::Instant;

use ambf_device::{
    known, Axes, DeviceError, DeviceForce, DeviceInfo, DeviceLog, DeviceSample, DeviceSpec, Driver, InputDevice,
    Presence, Settings,
};

use crate::arm::{Arm, ArmError};
use crate::dialect::Names;
use crate::frames::Wrench;
use crate::options::ArmOptions;
use crate::presence::presence;

/// The driver `dvrk`: each arm is a device whose model name is the arm's name, or that of the setting `arm`.
pub fn driver() -> impl Driver {
    DvrkDriver
}

struct DvrkDriver;

impl From<ArmError> for DeviceError {
    fn from(error: ArmError) -> Self {
        Self::Unavailable(error.to_string())
    }
}

/// Options, with the names of topics checked.
fn options(model: &str, settings: &Settings) -> Result<(ArmOptions, Names), DeviceError> {
    let options = ArmOptions::from_settings(model, settings)?;
    let arm = options.arm.as_deref().unwrap_or(model);
    match Names::new(options.namespace.as_deref(), arm) {
        Some(names) => Ok((options, names)),
        None if settings.text("arm").is_some() && Names::new(None, arm).is_none() => {
            Err(settings.wrong("arm", "the name of an arm: letters, digits and _, a letter first").into())
        }
        None if Names::new(None, arm).is_some() => {
            Err(settings.wrong("namespace", "parts of letters, digits and _ with slashes between").into())
        }
        None => Err(ArmError::Name(arm.to_owned()).into()),
    }
}

impl Driver for DvrkDriver {
    fn name(&self) -> &str {
        "dvrk"
    }

    fn serves(&self, model: &str) -> bool {
        ["MTM", "PSM", "ECM"].iter().any(|kind| model.starts_with(kind)) && Names::new(None, model).is_some()
    }

    /// Arms are named, not searched: one that is not there yet may come later.
    fn find(&self, model: &str, settings: &Settings) -> Result<Vec<DeviceInfo>, DeviceError> {
        let (_, names) = options(model, settings)?;
        Ok(vec![DeviceInfo { model: model.to_owned(), identity: names.identity() }])
    }

    fn presence(&self, info: &DeviceInfo, settings: &Settings) -> Presence {
        match options(&info.model, settings) {
            Ok((options, names)) => presence(&names, &options),
            Err(error) => Presence::NotReady(error.to_string()),
        }
    }

    fn open(
        &self,
        info: &DeviceInfo,
        settings: &Settings,
        log: &DeviceLog,
    ) -> Result<Box<dyn InputDevice>, DeviceError> {
        let (options, _) = options(&info.model, settings)?;
        let options = ArmOptions { motion: false, ..options.with_log(log) };
        let spec = spec(&info.model, options.arm.as_deref().unwrap_or(&info.model), options.send_torque);
        let arm = Arm::connect(&info.model, options)?;
        Ok(Box::new(DvrkDevice { arm: Some(arm), spec, last: DeviceSample::none(Instant::now()) }))
    }
}

/// What an arm can do: as a master of the original, for all arms.
fn spec(model: &str, arm: &str, torque: bool) -> DeviceSpec {
    let (left, right) = (arm.starts_with("MTML"), arm.starts_with("MTMR"));
    let known = known::spec("MTMR").unwrap_or_else(|| DeviceSpec::unknown(model));
    DeviceSpec {
        model: model.to_owned(),
        sensed: Axes { position: true, rotation: true, gripper: !arm.starts_with("ECM") },
        actuated: Axes { position: true, rotation: torque, gripper: false },
        left_hand: left || !right,
        right_hand: right || !left,
        ..known
    }
}

struct DvrkDevice {
    /// `None` once closed.
    arm: Option<Arm>,
    spec: DeviceSpec,
    last: DeviceSample,
}

impl DvrkDevice {
    fn arm(&self) -> Result<&Arm, DeviceError> {
        let closed = || DeviceError::Lost(format!("{}: the device is closed", self.spec.model));
        let arm = self.arm.as_ref().ok_or_else(closed)?;
        if arm.is_dismissed() {
            return Err(DeviceError::Lost(format!("{}: our ROS node was told to shut down", arm.name())));
        }
        Ok(arm)
    }
}

impl InputDevice for DvrkDevice {
    fn spec(&self) -> &DeviceSpec {
        &self.spec
    }

    fn read(&mut self) -> Result<DeviceSample, DeviceError> {
        let arm = self.arm()?;
        let inner = arm.inner();
        let mut sample = self.last;
        if let Some(posed) = inner.posed() {
            sample.stamp = posed.at;
            sample.sequence = posed.sequence;
            sample.position = posed.pose.translation.vector;
            sample.rotation = posed.pose.rotation;
        }
        sample.gripper = self.spec.sensed.gripper.then(|| inner.gripper());
        sample.buttons = inner.buttons();
        sample.valid = inner.is_available() && inner.ready.load(Ordering::Acquire);
        self.last = sample;
        Ok(sample)
    }

    fn write(&mut self, force: &DeviceForce) -> Result<(), DeviceError> {
        let arm = self.arm()?;
        let wrench = Wrench { force: force.force, torque: force.torque };
        // The host sends no such thing; if it did, no force is right.
        let wrench = if wrench.is_finite() { wrench } else { Wrench::zero() };
        arm.inner().command_wrench(&wrench);
        Ok(())
    }

    fn close(&mut self) {
        self.arm = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_device::Setting;

    fn settings(entries: &[(&str, &str)]) -> Settings {
        let entry = |(key, value): &(&str, &str)| {
            ((*key).to_owned(), Setting { value: (*value).to_owned(), place: "devices.yaml:7".into() })
        };
        Settings::new(entries.iter().map(entry).collect(), ".".into())
    }

    #[test]
    fn arms_are_served_by_name() {
        let driver = driver();
        for model in ["MTMR", "MTML", "MTML1", "PSM1", "PSM2", "PSM3", "ECM"] {
            assert!(driver.serves(model), "{model}");
        }
        assert!(!driver.serves("Falcon") && !driver.serves("MTM R") && !driver.serves(""));
        let found = driver.find("MTMR", &settings(&[("namespace", "lab")])).unwrap();
        assert_eq!(found, [DeviceInfo { model: "MTMR".into(), identity: "/lab/MTMR".into() }]);
    }

    #[test]
    fn names_of_no_use_are_errors() {
        let driver = driver();
        let find = |model: &str, list: &[(&str, &str)]| driver.find(model, &settings(list)).unwrap_err().to_string();
        assert!(find("MTM R", &[]).contains("\"MTM R\" is no name of an arm"));
        assert!(find("mine", &[("arm", "MTM-R")]).starts_with("devices.yaml:7: `arm` is `MTM-R`"));
        assert!(find("MTMR", &[("namespace", "a b")]).starts_with("devices.yaml:7: `namespace`"));
        assert!(find("MTMR", &[("homing", "1")]).contains("`homing`"));
        assert!(matches!(Arm::connect("a/b", ArmOptions::default()), Err(ArmError::Name(_))));
    }

    #[test]
    fn specifications_are_those_of_the_table() {
        let right = spec("MTMR", "MTMR", false);
        assert_eq!(
            (right.max_force, right.max_torque, right.max_stiffness, right.max_damping),
            (5.0, 0.1, 1000.0, 20.0)
        );
        assert!(right.right_hand && !right.left_hand && right.sensed.gripper && !right.actuated.rotation);
        assert!(spec("MTML", "MTML2", true).left_hand && !spec("ECM", "ECM", false).sensed.gripper);
    }
}
