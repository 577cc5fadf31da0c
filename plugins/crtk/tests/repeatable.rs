//! The same commands in the same iterations give the same trajectory, to the last bit.

mod common;

use common::{Bench, PROFILES};
use crtk::messages::{Header, Message};
use nalgebra::Isometry3;

/// Bit patterns of the tool's pose after each tenth of a second.
fn trajectory(profile: ambf_core::control::Profile) -> Vec<u64> {
    let mut bench = Bench::psm(profile);
    let mut bits = Vec::new();
    let mut record = |bench: &mut Bench| {
        bench.run(0.1);
        let pose: Isometry3<f64> = bench.body("tool");
        bits.extend(pose.translation.vector.iter().chain(pose.rotation.coords.iter()).map(|value| value.to_bits()));
    };
    record(&mut bench);
    bench.topics.send("/PSM1/trajectory_j/set_ratio", &Message::Number(0.5).encode());
    bench.send_positions("/PSM1/move_jp", &[0.3, 0.2, 0.15, 0.5, 0.3, -0.2]);
    bench.send_positions("/PSM1/jaw/move_jp", &[0.6]);
    (0..5).for_each(|_| record(&mut bench));
    let pose = Message::Pose(Header { stamp: 0, frame: "PSM1_base".into() }, Isometry3::translation(0.01, 0.0, -0.12));
    bench.topics.send("/PSM1/servo_cp", &pose.encode());
    record(&mut bench);
    bench.topics.send("/PSM1/free", &[]);
    (0..3).for_each(|_| record(&mut bench));
    bits
}

#[test]
fn the_same_commands_in_the_same_steps_give_the_same_bits() {
    for profile in PROFILES {
        let first = trajectory(profile);
        assert!(first[..7] != first[first.len() - 7..], "it moves");
        assert_eq!(first, trajectory(profile), "{profile:?}");
    }
}
