//! Services: what is asked about an arm, in the encoding of ROS 1.

mod common;

use ambf_core::control::Profile;
use common::Bench;

fn number(bytes: &[u8], at: usize) -> f64 {
    f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
}

/// A request with these joint positions and the identity as pose, which is not used.
fn forward(positions: &[f64]) -> Vec<u8> {
    let mut bytes = (positions.len() as u32).to_le_bytes().to_vec();
    let pose = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    bytes.extend(positions.iter().chain(&pose).flat_map(|value| value.to_le_bytes()));
    bytes
}

#[test]
fn kinematics_are_answered_there_and_back() {
    let mut bench = Bench::psm(Profile::Legacy);
    bench.run(0.01);
    let q = [0.1, -0.2, 0.15, 0.3, -0.4, 0.5];
    let answer = bench.topics.ask("/PSM1/local/forward_kinematics", &forward(&q)).unwrap();
    // dVRK's table; then a flag and an empty text.
    for (axis, expected) in [0.014945, 0.031684, -0.138463].into_iter().enumerate() {
        assert!((number(&answer, 8 * axis) - expected).abs() < 1e-6);
    }
    assert_eq!(answer[56..], [1, 0, 0, 0, 0]);
    let seen = bench.topics.ask("/PSM1/forward_kinematics", &forward(&q)).unwrap();
    assert_ne!(seen[..56], answer[..56], "the reference is the view of the endoscope");
    let mut request = seen[..56].to_vec();
    request.extend(0_u32.to_le_bytes());
    let back = bench.topics.ask("/PSM1/inverse_kinematics", &request).unwrap();
    assert_eq!(back[..4], 6_u32.to_le_bytes());
    for (joint, expected) in q.into_iter().enumerate() {
        assert!((number(&back, 4 + 8 * joint) - expected).abs() < 1e-8);
    }
    let wrong = bench.topics.ask("/PSM1/forward_kinematics", &forward(&q[..5])).unwrap();
    assert_eq!(wrong[56], 0, "five joints are not enough");
    assert!(bench.topics.ask("/PSM1/inverse_kinematics", &request[1..]).is_err());
    let state = bench.topics.ask("/PSM1/operating_state", &[]).unwrap();
    assert!(state.windows(7).any(|part| part == b"ENABLED"));
}
