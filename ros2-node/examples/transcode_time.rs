//! How long a conversion of a `RigidBodyState` takes: `cargo run --release -p ros2-node --example transcode_time`.

#[path = "../tests/common/mod.rs"]
mod common;

use std::hint::black_box;
use std::time::{Duration, Instant};

use common::{description, rigid_body_state};
use ros2_node::Transcoder;

const CALLS: u32 = 200_000;
const ROUNDS: usize = 15;

/// Median over rounds of the time a call takes.
fn time_of(mut call: impl FnMut()) -> Duration {
    let mut times: Vec<_> = (0..ROUNDS)
        .map(|_| {
            let start = Instant::now();
            (0..CALLS).for_each(|_| call());
            start.elapsed() / CALLS
        })
        .collect();
    times.sort();
    times[ROUNDS / 2]
}

fn main() {
    let transcoder = Transcoder::new(&description("ambf_msgs", "RigidBodyState")).expect("the type is usable");
    let (ros1, mut cdr, mut back) = (rigid_body_state(7), Vec::new(), Vec::new());
    let there = time_of(|| transcoder.to_cdr(black_box(&ros1), &mut cdr).expect("it is a state"));
    let here = time_of(|| transcoder.to_ros1(black_box(&cdr), &mut back).expect("it is a state"));
    println!("RigidBodyState, {} bytes of ROS 1, {} of CDR", ros1.len(), cdr.len());
    println!("ROS 1 to CDR: {there:?}; CDR to ROS 1: {here:?}");
}
