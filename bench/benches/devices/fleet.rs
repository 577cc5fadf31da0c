//! The five devices of the paper: the simulator's own drivers, with fakes in place of hardware.

use std::sync::Arc;
use std::time::Duration;

use fake_dvrk::{Curve, Fake as FakeDvrk, FakeOptions, Motion};
use fake_hd::Fake as FakeHd;
use nalgebra::UnitQuaternion;

use super::rig::Wanted;

/// Names of the devices.
pub const NAMES: [&str; 5] = ["Falcon 1", "Falcon 2", "Touch", "MTMR", "MTML"];
/// Place of the Touch among them.
pub const TOUCH: usize = 2;
/// Name of the Touch in its library: what the driver looks for by itself.
pub const STYLUS: &str = "Default Device";

/// Fakes that run as long as this lives.
pub struct Fleet {
    pub wanted: Vec<Wanted>,
    pub hd: FakeHd,
    _dvrk: FakeDvrk,
}

impl Fleet {
    pub fn start() -> Self {
        let motion = Motion::Curve(Curve::default(), UnitQuaternion::identity());
        let dvrk = arms(&NAMES[3..], motion);
        let hd = FakeHd::new(&[(STYLUS, "Touch")]).expect("a copy of the library");
        hd.tell(&format!("{STYLUS}: circle 40 0.5"));
        let falcon: Arc<dyn ambf_core::device::Driver> = Arc::new(fake_falcon::driver());
        let arm: Arc<dyn ambf_core::device::Driver> = Arc::new(dvrk_arm::driver());
        let gain = "haptic gain: {linear: 10, angular: 0}";
        let falcon_keys =
            |i| format!("hardware name: Falcon, identity: fake-{i}, {gain}, driver settings: {{transport: fake}}");
        let touch_keys = format!(
            "hardware name: Touch, identity: {STYLUS}, haptic gain: {{linear: 100, angular: 0}}, driver settings: {{library: {}}}",
            hd.path().display()
        );
        let arm_keys = |name: &str| format!("hardware name: {name}, {gain}");
        let keys = [falcon_keys(1), falcon_keys(2), touch_keys, arm_keys("MTMR"), arm_keys("MTML")];
        let drivers = [&falcon, &falcon, &touch::driver(), &arm, &arm].map(Arc::clone);
        let wanted = NAMES.into_iter().zip(drivers).zip(keys);
        let wanted = wanted.map(|((name, driver), keys)| Wanted { name, driver, keys }).collect();
        Self { wanted, hd, _dvrk: dvrk }
    }
}

/// Fake arms that publish a thousand times a second on the process's own ROS master, which they start if need be.
pub fn arms(names: &[&str], motion: Motion) -> FakeDvrk {
    let arms = names.iter().map(|name| (*name).to_owned()).collect();
    let fake = FakeDvrk::start(FakeOptions { arms, rate: 1000.0, motion, embedded_master: true, ..Default::default() });
    let fake = fake.expect("a fake node");
    while fake.published() == 0 {
        std::thread::sleep(Duration::from_millis(20));
    }
    fake
}
