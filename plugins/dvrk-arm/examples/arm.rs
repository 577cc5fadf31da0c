//! Holds the tip of a master where it is, with a virtual spring, for ten seconds.
//!
//! `cargo run -p dvrk-arm --example arm -- MTMR`; without a robot, run
//! `cargo run --bin fake_dvrk -- MTMR --start-master --rate 1000 --size 0.01` in another shell first.

use std::error::Error;
use std::time::{Duration, Instant};

use dvrk_arm::{Arm, ArmOptions, Pedal, Wrench};

/// N/m.
const STIFFNESS: f64 = 100.0;

/// N.
const MOST: f64 = 3.0;

fn main() -> Result<(), Box<dyn Error>> {
    let name = std::env::args().nth(1).unwrap_or_else(|| String::from("MTMR"));
    let arm = Arm::connect(&name, ArmOptions::default())?;
    if !arm.wait_until_available(Duration::from_secs(10)) {
        return Err(format!("{} does not publish its pose; is its node running?", arm.name()).into());
    }
    while !arm.is_ready() {
        println!("{} is {:?}: power and home it from its console", arm.name(), arm.state());
        std::thread::sleep(Duration::from_secs(1));
    }
    // Poses are in the device frame: x towards the user, y to the right, z up.
    let mut anchor = arm.position();
    println!("{} speaks {:?}, holding it at {:.3?} m", arm.name(), arm.dialect(), anchor.as_slice());
    let (begin, mut clicks) = (Instant::now(), arm.clicks(Pedal::Camera));
    while begin.elapsed() < Duration::from_secs(10) {
        if arm.is_pressed(Pedal::Clutch) || arm.clicks(Pedal::Camera) != clicks {
            (anchor, clicks) = (arm.position(), arm.clicks(Pedal::Camera));
        }
        let force = (STIFFNESS * (anchor - arm.position())).cap_magnitude(MOST);
        // Who stops calling this for 50 ms takes the force away.
        arm.set_wrench(&Wrench { force, ..Wrench::zero() })?;
        std::thread::sleep(Duration::from_millis(1));
    }
    println!("gripper {:.2}, {} wrenches sent", arm.gripper(), arm.wrenches_sent());
    // Sends no force, twice.
    arm.close();
    Ok(())
}
