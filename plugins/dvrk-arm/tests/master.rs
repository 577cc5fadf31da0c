//! The ROS master dies and comes back, and the arm's node with it.

mod common;

use common::*;
use fake_dvrk::{Fake, FakeOptions};
use nalgebra::Vector3;

const FORCE: Vector3<f64> = Vector3::new(0.0, 0.0, 1.0);

#[test]
fn the_driver_outlives_the_master() {
    let port = choose_master();
    // Nobody is there: the device opens and waits.
    let mut device = Device::open("MTML", &[]);
    device.ticks(FORCE, 20);
    assert!(!device.read().valid);
    let Some(master) = Master::start(port) else {
        println!("skipped: rosmaster is not installed (Debian: python3-rosmaster)");
        return;
    };
    let options = || FakeOptions { arms: vec!["MTML".into()], rate: 200.0, ..Default::default() };
    let fake = Fake::start(options()).unwrap();
    device.wait_valid();
    device.wait_felt(&fake, "MTML", FORCE);

    // The master alone dies: what is connected stays.
    drop(master);
    let count = fake.wrench_count("MTML");
    device.ticks(FORCE, 1500);
    assert!(device.read().valid, "poses go on");
    assert!(fake.wrench_count("MTML") > count + 1000, "so do forces");
    let master = Master::start(port).unwrap();
    until("both are registered again", || {
        device.ticks(FORCE, 100);
        (device.said)().iter().any(|line| line.contains("registered again"))
    });
    assert!(device.read().valid);

    // Both die and come back.
    drop(fake);
    drop(master);
    until("the arm is away", || !device.read().valid);
    let _master = Master::start(port).unwrap();
    let fake = Fake::start(options()).unwrap();
    device.wait_valid();
    device.wait_felt(&fake, "MTML", FORCE);
    device.device.close();
    until("the zeros", || {
        fake.wrenches("MTML").iter().rev().take_while(|shown| shown.wrench.force.norm() == 0.0).count() >= 2
    });
}
