//! What `ambf_simulator` says of its own life, and how it ends.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crossbeam_channel::{unbounded, Receiver};

fn resources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources")
}

/// A simulator without ROS and windows; killed in the end.
struct Simulator {
    child: Child,
    lines: Receiver<String>,
}

impl Simulator {
    fn start(arguments: &str) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_ambf_simulator"))
            .args(["--no_ros", "-g", "0", "--launch_file"])
            .arg(resources().join("launch.yaml"))
            .args(arguments.split_whitespace())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("it starts");
        let (sender, lines) = unbounded();
        let streams: [Box<dyn std::io::Read + Send>; 2] =
            [Box::new(child.stdout.take().expect("piped")), Box::new(child.stderr.take().expect("piped"))];
        for stream in streams {
            let sender = sender.clone();
            std::thread::spawn(move || {
                BufReader::new(stream).lines().map_while(Result::ok).for_each(|line| drop(sender.send(line)));
            });
        }
        Self { child, lines }
    }

    /// The first line that holds `part`; `None`: there is none within `seconds`.
    fn line(&self, part: &str, seconds: u64) -> Option<String> {
        let end = Instant::now() + Duration::from_secs(seconds);
        std::iter::from_fn(|| self.lines.recv_deadline(end).ok()).find(|line| line.contains(part))
    }

    fn signal(&self, signal: &str) {
        let sent = Command::new("kill").args([signal, &self.child.id().to_string()]).status().expect("kill runs");
        assert!(sent.success());
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn a_stop_from_outside_is_not_blamed_on_the_scene() {
    let simulator = Simulator::start("-l 0");
    simulator.line("loaded 1 model", 60).expect("it starts");
    // On a busy machine the first ones may come before the physics runs.
    let mut stops = (0..20).map(|_| {
        simulator.signal("-STOP");
        std::thread::sleep(Duration::from_millis(1500));
        simulator.signal("-CONT");
        simulator.line("were not computed", 3)
    });
    // This used to be a scene that is too heavy for the computer.
    let line = stops.find_map(|line| line).expect("it says what it has not computed");
    assert!(line.starts_with("the simulation did not run, because it was stopped"), "{line}");
}
