//! A rospy node that behaves like the proxy arm of AMBF 2.0's teleoperation example.

mod common;

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::channel;

use common::*;
use dvrk_arm::Frames;
use nalgebra::{UnitQuaternion, Vector3};

/// Debian's Python has rospy, others need not.
const PYTHON: &str = "/usr/bin/python3";

struct Proxy(Child);

impl Drop for Proxy {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn the_proxy_of_ambf_works_with_the_driver() {
    let available = Command::new(PYTHON)
        .args(["-c", "import rospy, geometry_msgs, sensor_msgs"])
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    if !available {
        println!("skipped: {PYTHON} has no rospy or messages (Debian: python3-rospy python3-sensor-msgs)");
        return;
    }
    share_master();
    let child = Command::new(PYTHON)
        .args([concat!(env!("CARGO_MANIFEST_DIR"), "/tests/proxy.py"), "MTMR"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn();
    let mut proxy = Proxy(child.unwrap());
    let (lines, forces) = channel();
    let output = BufReader::new(proxy.0.stdout.take().unwrap());
    std::thread::spawn(move || output.lines().map_while(Result::ok).try_for_each(|line| lines.send(line)));

    let mut device = Device::open("MTMR", &[]);
    device.wait_valid();
    assert!((device.said)().iter().any(|line| line.contains("AMBF 2.0")), "{:#?}", (device.said)());
    let input = proxy.0.stdin.as_mut().unwrap();
    writeln!(input, "0.03 -0.02 0.05 0.1 0.2 0.3 0.9").unwrap();
    // Values come one to one, apart from the constant position of the origin; 0.9 of the gripper's range is 43.7°, in
    // ±60° 0.864.
    let frames = Frames::of("MTMR");
    let origin = frames.origin.rotation.inverse() * frames.origin.translation.vector;
    let expected = Vector3::new(0.03, -0.02, 0.05) - origin;
    until("the pose", || (device.read().position - expected).norm() < 1e-6);
    let rotation = UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3);
    assert!(device.read().rotation.angle_to(&rotation) < 1e-4, "{:?}", device.read().rotation.euler_angles());
    let angle: f64 = -3.16 + 0.9 * 4.36;
    let gripper = (angle.to_degrees() + 60.0) / 120.0;
    // It comes as a message of its own.
    until("the angle of the gripper", || (device.read().gripper.unwrap() - gripper).abs() < 1e-9);
    assert_eq!(device.read().buttons, 0, "its closed event has a name that nobody listens to");
    for (value, expected) in [(0.4, 0.0), (0.97, 1.0)] {
        writeln!(proxy.0.stdin.as_mut().unwrap(), "0.03 -0.02 0.05 0.1 0.2 0.3 {value}").unwrap();
        until("the gripper", || device.read().gripper == Some(expected));
    }

    let force = Vector3::new(1.0, 2.0, 3.0);
    let turned = frames.origin.rotation * force;
    until("the force", || {
        device.ticks(force, 20);
        forces.try_iter().any(|line: String| {
            let numbers: Vec<f64> = line.split(' ').map(|word| word.parse().unwrap()).collect();
            (Vector3::from_column_slice(&numbers) - turned).norm() < 1e-9
        })
    });
}
