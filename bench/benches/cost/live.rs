//! `ambf_simulator` as a process, watched from outside through ROS and `/proc`.

use std::fs::read_to_string;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use ambf_app::ros::messages::ambf_msgs::{RigidBodyState, Timing};
use rosrust::RosMsg;

use super::ros_common::{free_port, publisher_of, RawSubscriber};
use super::scenes::Scene;

/// A running simulator; it ends when this is dropped.
pub struct Live {
    child: Child,
    master: String,
    pub begin: Instant,
}

impl Live {
    /// Starts the simulator on a master of its own.
    pub fn start(scene: &Scene, options: &[&str]) -> Self {
        let port = free_port();
        let begin = Instant::now();
        let child = Command::new(ambf_bench::simulator())
            .args(["-g", "0"])
            .args(scene.arguments())
            .args(options)
            .env("ROS_MASTER_URI", format!("http://localhost:{port}/"))
            .env("ROS_HOSTNAME", "localhost")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the simulator starts");
        Self { child, master: format!("http://localhost:{port}/"), begin }
    }

    /// Subscribes a topic once it is there.
    pub fn subscribe(&self, topic: &str) -> RawSubscriber {
        RawSubscriber::connect(&publisher_of(&self.master, topic), topic)
    }

    /// CPU time so far, s.
    pub fn cpu(&self) -> f64 {
        let stat = read_to_string(format!("/proc/{}/stat", self.child.id())).unwrap_or_default();
        let rest = stat.rsplit(')').next().unwrap_or_default();
        let ticks = |n: usize| rest.split_whitespace().nth(n).and_then(|text| text.parse::<f64>().ok()).unwrap_or(0.0);
        (ticks(11) + ticks(12)) / 100.0
    }

    /// A number of `/proc/PID/status`.
    fn status(&self, key: &str) -> f64 {
        let status = read_to_string(format!("/proc/{}/status", self.child.id())).unwrap_or_default();
        let value = status.lines().find_map(|line| line.strip_prefix(key)?.split_whitespace().nth(1)?.parse().ok());
        value.unwrap_or(f64::NAN)
    }

    /// Largest memory so far, MB.
    pub fn peak_memory(&self) -> f64 {
        self.status("VmHWM") / 1024.0
    }

    pub fn threads(&self) -> f64 {
        self.status("Threads")
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A message and when it came, from the start of the reading.
pub type Arrival<M> = (Duration, M);

/// Reads messages for `time`, after dropping those of the first half second, in which a connection settles.
pub fn read<M: RosMsg>(subscriber: &mut RawSubscriber, time: Duration) -> Vec<Arrival<M>> {
    let settled = Instant::now() + Duration::from_millis(500);
    while Instant::now() < settled {
        subscriber.read_block().expect("the stream goes on");
    }
    let begin = Instant::now();
    let mut blocks = Vec::new();
    while begin.elapsed() < time {
        let block = subscriber.read_block().expect("the stream goes on");
        blocks.push((begin.elapsed(), block));
    }
    // Decoded afterwards: a reader that computes would be measured too.
    let decoded = |(at, block): (Duration, Vec<u8>)| (at, M::decode(&block[..]).expect("a message of that type"));
    blocks.into_iter().map(decoded).collect()
}

/// Rate of a stream between its first and its last message, Hz.
pub fn rate<M>(stream: &[Arrival<M>]) -> f64 {
    match stream {
        [(first, _), .., (last, _)] => (stream.len() - 1) as f64 / (*last - *first).as_secs_f64(),
        _ => 0.0,
    }
}

/// Gaps between messages in ms, sorted.
pub fn gaps<M>(stream: &[Arrival<M>]) -> Vec<f64> {
    let mut gaps: Vec<f64> = stream.windows(2).map(|pair| (pair[1].0 - pair[0].0).as_secs_f64() * 1e3).collect();
    gaps.sort_by(f64::total_cmp);
    gaps
}

/// Different states a second in a stream of a body, Hz.
pub fn distinct(stream: &[Arrival<RigidBodyState>]) -> f64 {
    let changes = stream.windows(2).filter(|pair| pair[0].1.sim_step != pair[1].1.sim_step).count();
    let time =
        stream.last().map_or(0.0, |(at, _)| at.as_secs_f64()) - stream.first().map_or(0.0, |(at, _)| at.as_secs_f64());
    changes as f64 / time
}

/// Iterations a second of the physics loop, Hz.
pub fn physics_rate(timing: &[Arrival<Timing>]) -> f64 {
    match timing {
        [(_, first), .., (_, last)] => (last.sim_step - first.sim_step) as f64 / (last.wall_time - first.wall_time),
        _ => 0.0,
    }
}
