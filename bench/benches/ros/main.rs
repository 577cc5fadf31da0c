//! What ROS 1 costs with 200 bodies: start, threads, memory, ports, rates, ages, processor time.
//!
//! Arguments: `--quick`, and other builds of the simulator, which are measured in turns with this one.

use std::fmt::Write as _;
use std::fs;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use ambf_app::ros::messages::ambf_msgs::RigidBodyState;
use ambf_test_support::ros::{call, free_port, publisher_of, until, RawSubscriber};
use dxr::Value;
use rosrust::RosMsg;

/// Bodies of the scene.
const BODIES: usize = 200;

/// Those whose states are read at 2 kHz.
const READ: usize = 5;

/// A simulator and the master that it has started; both end when this is dropped.
struct Live {
    child: Child,
    master: String,
    begin: Instant,
}

impl Live {
    fn start(program: &Path, rate: u32) -> Self {
        let master = format!("http://localhost:{}/", free_port());
        let begin = Instant::now();
        let child = Command::new(program)
            .args(["-g", "0", "-a"])
            .arg(model(rate))
            .args(["--phx_frequency", &rate.max(1000).to_string()])
            .arg("--launch_file")
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources/launch.yaml"))
            .env("ROS_MASTER_URI", &master)
            .env_remove("ROS_HOSTNAME")
            .env_remove("ROS_IP")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the simulator starts");
        Self { child, master, begin }
    }

    /// How many states of the boxes the master lists.
    fn listed(&self) -> usize {
        let Some(Value::Array(parts)) = call(&self.master, "getSystemState", vec![]) else { return 0 };
        ros_node::entries(&parts[0]).filter(|(name, _)| name.contains("/Box") && name.ends_with("/State")).count()
    }

    /// Seconds from the first state that is listed to the last, and from the start to the last.
    fn announce(&self) -> (f64, f64) {
        let mut first = None;
        until("all states", || {
            let listed = self.listed();
            if listed > 0 {
                first.get_or_insert_with(Instant::now);
            }
            listed == BODIES
        });
        (first.map_or(0.0, |first| first.elapsed().as_secs_f64()), self.begin.elapsed().as_secs_f64())
    }

    fn cpu(&self) -> f64 {
        let stat = fs::read_to_string(format!("/proc/{}/stat", self.child.id())).unwrap_or_default();
        let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
        let ticks = |n: usize| fields.get(n).and_then(|text| text.parse::<f64>().ok()).unwrap_or(0.0);
        (ticks(11) + ticks(12)) / 100.0
    }

    fn status(&self, key: &str) -> f64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap_or_default();
        let value = status.lines().find_map(|line| line.strip_prefix(key)?.split_whitespace().nth(1)?.parse().ok());
        value.unwrap_or(f64::NAN)
    }

    /// Listening TCP ports of the simulator, and how many of them other machines can reach.
    fn ports(&self) -> (usize, usize) {
        let folder = format!("/proc/{}/fd", self.child.id());
        let links =
            fs::read_dir(folder).into_iter().flatten().flatten().filter_map(|entry| fs::read_link(entry.path()).ok());
        let sockets: Vec<String> = links.map(|link| link.to_string_lossy().into_owned()).collect();
        let (mut all, mut open) = (0, 0);
        for table in ["/proc/net/tcp", "/proc/net/tcp6"] {
            for line in fs::read_to_string(table).unwrap_or_default().lines().skip(1) {
                let row: Vec<&str> = line.split_whitespace().collect();
                if row[3] == "0A" && sockets.contains(&format!("socket:[{}]", row[9])) {
                    all += 1;
                    open += usize::from(!row[1].starts_with("0100007F"));
                }
            }
        }
        (all, open)
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        // The master goes by itself once nobody is registered; a benchmark does not wait for that.
        if let Some(Value::Integer(pid)) = call(&self.master, "getPid", vec![]) {
            let _ = Command::new("kill").arg(pid.to_string()).status();
        }
    }
}

fn subscribe(node: &str, body: usize) -> RawSubscriber {
    RawSubscriber::connect(node, &format!("/ambf/env/Box{body}/State"))
}

/// Boxes that float and touch nothing, whose states are published at `rate`, Hz; 0: as by default.
fn model(rate: u32) -> PathBuf {
    let names: Vec<String> = (0..BODIES).map(|number| format!("BODY Box{number}")).collect();
    let frequency = match rate {
        0 => String::new(),
        rate => format!(", publish frequency: {{low: {rate}, high: {rate}}}"),
    };
    let mut yaml = format!("bodies: [{}]\nnamespace: /ambf/env/\n", names.join(", "));
    for (number, name) in names.iter().enumerate() {
        let (x, y, z) = (number % 6, number / 6 % 6, number / 36);
        writeln!(
            yaml,
            "{name}: {{name: Box{number}, mass: 0.1, gravity: {{x: 0, y: 0, z: 0}}, collision shape: Box, \
             collision geometry: {{x: 0.1, y: 0.1, z: 0.1}}, \
             location: {{position: {{x: {x}, y: {y}, z: {z}}}}}{frequency}}}"
        )
        .expect("a text takes everything");
    }
    let path = ambf_bench::folder().join(format!("ros{BODIES}-{rate}.yaml"));
    fs::write(&path, yaml).expect("the target folder can be written");
    path
}

/// What is measured, in the order of the table's rows.
struct Figures(Vec<f64>);

const ROWS: [(&str, usize); 13] = [
    ("first state listed to last, s", 2),
    ("start of the program to last, s", 2),
    ("threads", 0),
    ("peak memory, MB", 1),
    ("listening ports", 0),
    ("of these, reachable from other machines", 0),
    ("nobody subscribed: processor, % of a core", 1),
    ("5 of 200 at 2 kHz: rate, Hz", 1),
    ("5 of 200 at 2 kHz: age p50, ms", 3),
    ("5 of 200 at 2 kHz: age p99, ms", 3),
    ("5 of 200 at 2 kHz: processor, % of a core", 1),
    ("200 of 200 at 1 kHz: messages a second", 0),
    ("200 of 200 at 1 kHz: processor, % of a core", 1),
];

fn measure(program: &Path, time: Duration) -> Figures {
    let mut figures = Vec::new();
    {
        let live = Live::start(program, 0);
        let (spread, all) = live.announce();
        std::thread::sleep(Duration::from_secs(1));
        let (ports, open) = live.ports();
        let cpu = live.cpu();
        std::thread::sleep(time);
        let idle = (live.cpu() - cpu) / time.as_secs_f64() * 100.0;
        figures.extend([spread, all, live.status("Threads"), live.status("VmHWM") / 1024.0]);
        figures.extend([ports as f64, open as f64, idle]);
    }
    {
        let live = Live::start(program, 2000);
        live.announce();
        let node = publisher_of(&live.master, "/ambf/env/Box0/State");
        let readers = (0..READ).map(|number| subscribe(&node, number * BODIES / READ));
        let threads: Vec<_> = readers.map(|subscriber| std::thread::spawn(move || ages(subscriber, time))).collect();
        let (cpu, begin) = (live.cpu(), Instant::now());
        let read: Vec<(f64, Vec<f64>)> = threads.into_iter().map(|thread| thread.join().expect("it reads")).collect();
        let used = (live.cpu() - cpu) / begin.elapsed().as_secs_f64() * 100.0;
        let rate = read.iter().map(|(rate, _)| rate).sum::<f64>() / READ as f64;
        let mut ages: Vec<f64> = read.into_iter().flat_map(|(_, ages)| ages).collect();
        ages.sort_by(f64::total_cmp);
        let percentile = |p: usize| ages[(ages.len() - 1) * p / 100];
        figures.extend([rate, percentile(50), percentile(99), used]);
    }
    {
        let live = Live::start(program, 1000);
        live.announce();
        let node = publisher_of(&live.master, "/ambf/env/Box0/State");
        let mut subscribers: Vec<_> = (0..BODIES).map(|body| subscribe(&node, body)).collect();
        let length = subscribers[0].read_block().expect("a state").len() + 4;
        subscribers.iter().for_each(|one| one.stream.set_nonblocking(true).expect("a socket"));
        drain(&mut subscribers, Duration::from_millis(500));
        let (cpu, begin) = (live.cpu(), Instant::now());
        let bytes = drain(&mut subscribers, time);
        let seconds = begin.elapsed().as_secs_f64();
        figures.extend([bytes as f64 / length as f64 / seconds, (live.cpu() - cpu) / seconds * 100.0]);
    }
    Figures(figures)
}

/// Rate of a stream, Hz, and the ages of its states when they come, ms.
fn ages(mut subscriber: RawSubscriber, time: Duration) -> (f64, Vec<f64>) {
    subscriber.count(Duration::from_millis(500));
    let (begin, mut came) = (Instant::now(), Vec::new());
    while begin.elapsed() < time {
        let block = subscriber.read_block().expect("the stream goes on");
        came.push((SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default(), block));
    }
    let rate = came.len() as f64 / begin.elapsed().as_secs_f64();
    let age = |(at, block): (Duration, Vec<u8>)| {
        let stamp = RigidBodyState::decode(&block[..]).expect("a state").header.stamp;
        (at.as_secs_f64() - f64::from(stamp.sec) - f64::from(stamp.nsec) * 1e-9) * 1e3
    };
    (rate, came.into_iter().map(age).collect())
}

/// Reads all that comes for `time`, as one client does; bytes.
fn drain(subscribers: &mut [RawSubscriber], time: Duration) -> usize {
    let (begin, mut bytes, mut buffer) = (Instant::now(), 0, vec![0; 64 << 10]);
    while begin.elapsed() < time {
        for subscriber in &mut *subscribers {
            match subscriber.stream.read(&mut buffer) {
                Ok(count) => bytes += count,
                Err(error) if error.kind() == ErrorKind::WouldBlock => (),
                Err(error) => panic!("the stream ends: {error}"),
            }
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    bytes
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let quick = arguments.iter().any(|argument| argument == "--quick");
    let mut programs = vec![ambf_bench::simulator()];
    programs.extend(arguments.iter().filter(|argument| !argument.starts_with("--")).map(PathBuf::from));
    let (rounds, time) = if quick { (1, Duration::from_secs(2)) } else { (3, Duration::from_secs(5)) };
    let mut measured: Vec<Vec<Figures>> = programs.iter().map(|_| Vec::new()).collect();
    for _ in 0..rounds {
        for (program, figures) in programs.iter().zip(&mut measured) {
            figures.push(measure(program, time));
        }
    }
    let mut table = String::from("| |");
    (0..programs.len()).for_each(|number| {
        let head = if number == 0 { "this build".into() } else { format!("other build {number}") };
        let _ = write!(table, " {head} |");
    });
    table.push_str("\n|---|");
    programs.iter().for_each(|_| table.push_str("--:|"));
    table.push('\n');
    for (row, (name, digits)) in ROWS.iter().enumerate() {
        let _ = write!(table, "| {name} |");
        for figures in &measured {
            let mut values: Vec<f64> = figures.iter().map(|one| one.0[row]).collect();
            values.sort_by(f64::total_cmp);
            let _ = write!(table, " {:.*} |", digits, values[values.len() / 2]);
        }
        table.push('\n');
    }
    println!("{table}");
    if quick {
        return;
    }
    let page = format!(
        "# ROS 1 with {BODIES} bodies\n\nMade by `scripts/bench ros [SIMULATOR]…`: medians of {rounds} runs of {} s, builds in turns, \
         release, on the same machine as the clients. The bodies float, so that physics costs little. `age` is from the time in a \
         state's header to when a client in another process has it; physics then runs at 2 kHz. \"200 of 200\" is one client that reads \
         all states.\n\n{table}",
        time.as_secs()
    );
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/benchmarks/ros.md");
    fs::write(path, page).expect("the page can be written");
}
