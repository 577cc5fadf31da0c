//! A driver of input devices that does what its settings say: for tests of drivers in shared libraries.

use std::time::Instant;

use ambf_core::device::{
    Axes, DeviceError, DeviceForce, DeviceInfo, DeviceLog, DeviceSample, DeviceSpec, Driver, InputDevice, Settings,
};
use nalgebra::Vector3;

ambf_core::export_driver!(Knob);

#[derive(Default)]
struct Knob;

struct OpenKnob {
    spec: DeviceSpec,
    fault: String,
    sequence: u64,
    force: Vector3<f64>,
    log: DeviceLog,
}

impl Driver for Knob {
    fn name(&self) -> &str {
        "knob"
    }

    fn serves(&self, model: &str) -> bool {
        model == "Knob"
    }

    fn find(&self, model: &str, settings: &Settings) -> Result<Vec<DeviceInfo>, DeviceError> {
        settings.unknown(&["count", "fault"])?;
        let count: u32 = settings.parsed("count", "a whole number")?.unwrap_or(1);
        assert!(count < 100, "too many knobs");
        let info = |i| DeviceInfo { model: model.to_owned(), identity: format!("port {i}") };
        Ok((0..count).map(info).collect())
    }

    fn open(
        &self,
        info: &DeviceInfo,
        settings: &Settings,
        log: &DeviceLog,
    ) -> Result<Box<dyn InputDevice>, DeviceError> {
        let fault = settings.text("fault").unwrap_or_default().to_owned();
        if fault == "open" {
            return Err(DeviceError::Unavailable("no permission".into()));
        }
        log.say(format!("{} is open", info.identity));
        let sensed = Axes { position: true, ..Axes::default() };
        let spec = DeviceSpec { max_force: 4.0, sensed, left_hand: true, ..DeviceSpec::unknown(&info.model) };
        Ok(Box::new(OpenKnob { spec, fault, sequence: 0, force: Vector3::zeros(), log: log.clone() }))
    }
}

impl InputDevice for OpenKnob {
    fn spec(&self) -> &DeviceSpec {
        &self.spec
    }

    fn read(&mut self) -> Result<DeviceSample, DeviceError> {
        self.sequence += 1;
        match self.fault.as_str() {
            "lost" => return Err(DeviceError::Lost("unplugged".into())),
            "panic" => panic!("as told"),
            _ => (),
        }
        let mut sample = DeviceSample::none(Instant::now());
        (sample.sequence, sample.position, sample.valid) = (self.sequence, self.force, true);
        Ok(sample)
    }

    fn write(&mut self, force: &DeviceForce) -> Result<(), DeviceError> {
        self.force = force.force;
        Ok(())
    }

    fn close(&mut self) {
        self.log.say("closed");
    }
}
