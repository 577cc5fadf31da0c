//! The driver while the program of fake arms is killed.

#[path = "../../../dvrk-arm/tests/common/mod.rs"]
mod common;

use common::*;

/// A node that was killed stays in the master's list; another release that takes its place is found all the same.
#[test]
fn a_killed_node_does_not_hide_the_next_one() {
    share_master();
    let start = |dialect: &str| {
        let fake = std::process::Command::new(env!("CARGO_BIN_EXE_fake_dvrk"))
            .args(["MTMR", "--quiet", "--namespace", "killed", "--dialect", dialect])
            .spawn();
        Killed(fake.unwrap())
    };
    let mut device = Device::open("MTMR", &[("namespace", "killed")]);
    for dialect in ["ambf", "legacy", "crtk"] {
        let node = start(dialect);
        device.wait_valid();
        drop(node);
        until("it is away", || !device.read().valid);
    }
    let late = Device::open("MTMR", &[("namespace", "killed")]);
    until("it is said", || (late.said)().iter().any(|line| line.contains("no valid pose comes")));
}

/// A process that ends as by `kill -9`.
struct Killed(std::process::Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
