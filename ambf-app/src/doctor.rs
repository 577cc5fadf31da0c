//! `ambf_simulator --doctor`: what this machine can and cannot do for the simulator, and what to do about it.
//!
//! Nothing is changed on the machine: no device is opened, no master started, no window shown.

use std::fmt;
use std::fs;
use std::net::{TcpStream, ToSocketAddrs};
use std::path::Path;
use std::time::{Duration, Instant};

use ambf_core::adf::{self, InputDevices, Launch};
use ambf_core::device::host::find_devices;
use ambf_core::device::timing::Pacer;

use crate::devices;
use crate::print_line;

/// How good what was found is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// As it should be.
    Good,
    /// Something is missing that not everybody needs.
    Note,
    /// Something that the simulator needs for what it was asked.
    Bad,
}

/// One thing that was looked at.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// What was looked at.
    pub subject: String,
    /// How good it is.
    pub verdict: Verdict,
    /// What is there.
    pub found: String,
    /// What to do about it; empty where nothing is to be done.
    pub advice: String,
}

impl Finding {
    fn new(subject: &str, verdict: Verdict, found: impl Into<String>, advice: &str) -> Self {
        let advice = if verdict == Verdict::Good { String::new() } else { advice.to_owned() };
        Self { subject: subject.to_owned(), verdict, found: found.into(), advice }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { subject, verdict, found, advice } = self;
        let word = match verdict {
            Verdict::Good => "ok",
            Verdict::Note => "note",
            Verdict::Bad => "BAD",
        };
        write!(f, "{word:<5} {subject:<20} {found}")?;
        if !advice.is_empty() {
            write!(f, "\n{:27}-> {advice}", "")?;
        }
        Ok(())
    }
}

/// Prints what is found; `launch_file` names the devices that are looked for. Returns the exit status: 1 if anything is
/// bad.
pub fn print(launch_file: &Path) -> i32 {
    let findings = examine(launch_file);
    findings.iter().for_each(|finding| print_line!("{finding}"));
    i32::from(findings.iter().any(|finding| finding.verdict == Verdict::Bad))
}

/// Looks at everything; takes about a second, and two more if a ROS master does not answer.
pub fn examine(launch_file: &Path) -> Vec<Finding> {
    let text = |file: &str| fs::read_to_string(file).unwrap_or_default();
    let mut findings = vec![
        processors(std::thread::available_parallelism().map_or(1, usize::from), &text("/proc/loadavg")),
        kernel(&text("/proc/sys/kernel/osrelease")),
        priority(urgency(), &text("/proc/self/limits")),
        punctuality(&mut lateness()),
        open_files(&text("/proc/self/limits")),
        drawing(),
        display(|name| std::env::var(name).ok()),
        master(&ros_node::master_uri(), answers),
        ros2_buffer(&text("/proc/sys/net/core/rmem_default")),
        scenes(launch_file),
    ];
    findings.extend(input_devices(launch_file));
    findings
}

fn processors(count: usize, load: &str) -> Finding {
    let load: f64 = load.split(' ').next().and_then(|number| number.parse().ok()).unwrap_or(0.0);
    let found = format!("{count} to use, load {load:.1}");
    let (verdict, advice) = match count {
        1 => (Verdict::Note, "physics, ROS and drawing share one: use -g 0, or more processors"),
        _ if load > count as f64 => {
            (Verdict::Note, "other programs want more than there is: physics will fall behind the clock at times")
        }
        _ => (Verdict::Good, ""),
    };
    Finding::new("processors", verdict, found, advice)
}

/// Linux since 6.12 heeds requests for short slices of time.
fn kernel(release: &str) -> Finding {
    let release = release.trim();
    let mut numbers = release.split(['.', '-']).map_while(|part| part.parse::<u32>().ok());
    let version = (numbers.next().unwrap_or(0), numbers.next().unwrap_or(0));
    let verdict = if version >= (6, 12) { Verdict::Good } else { Verdict::Note };
    let advice =
        "Linux since 6.12 keeps physics on time beside threads that draw; before, its period varies by some 3 ms then";
    Finding::new("kernel", verdict, format!("Linux {release}"), advice)
}

/// Whether a thread may run before all others.
fn urgency() -> Result<(), String> {
    let ask = || Pacer::new(Duration::from_millis(1), 1).be_urgent();
    std::thread::spawn(ask).join().unwrap_or_else(|_| Err("the thread ended".into()))
}

fn priority(urgency: Result<(), String>, limits: &str) -> Finding {
    let verdict = if urgency.is_ok() { Verdict::Good } else { Verdict::Note };
    let found = match urgency {
        Ok(()) => "device threads may run before all others (SCHED_FIFO)".to_owned(),
        Err(why) => {
            format!("refused ({why}); the limit is {}", limit(limits, "Max realtime priority").unwrap_or("unknown"))
        }
    };
    let advice =
        "haptics: write \"@realtime - rtprio 99\" to /etc/security/limits.d/99-realtime.conf, join the group realtime \
                  (groupadd realtime; usermod -aG realtime $USER), log in again";
    Finding::new("real-time priority", verdict, found, advice)
}

/// The soft limit called `name` in `/proc/self/limits`.
fn limit<'l>(limits: &'l str, name: &str) -> Option<&'l str> {
    limits.lines().find_map(|line| line.strip_prefix(name))?.split_whitespace().next()
}

/// How late ticks at 1 kHz come, s.
fn lateness() -> Vec<f64> {
    let period = Duration::from_millis(1);
    let mut pacer = Pacer::new(period, 1);
    let mut last = Instant::now();
    let mut late = |_| {
        pacer.wait();
        let now = Instant::now();
        let since = now - std::mem::replace(&mut last, now);
        (since.as_secs_f64() - period.as_secs_f64()).max(0.0)
    };
    (0..500).map(&mut late).collect()
}

fn punctuality(late: &mut [f64]) -> Finding {
    late.sort_by(f64::total_cmp);
    let at = |share: f64| late.get((late.len() as f64 * share) as usize).copied().unwrap_or(0.0) * 1e3;
    let (p99, longest) = (at(0.99), late.last().copied().unwrap_or(0.0) * 1e3);
    let found = format!("a loop at 1 kHz comes late by {p99:.2} ms at most in 99 of 100 periods, {longest:.2} ms once");
    let verdict = if p99 < 0.5 { Verdict::Good } else { Verdict::Note };
    let advice =
        "end other programs, or give virtual machines processors of their own; force feedback wants less than 0.5 ms";
    Finding::new("punctuality", verdict, found, advice)
}

fn open_files(limits: &str) -> Finding {
    let hard = limits.lines().find_map(|line| line.strip_prefix("Max open files"));
    let most = hard.and_then(|line| line.split_whitespace().nth(1)).unwrap_or("unknown");
    // One a connection: a client that listens to all of 200 objects has as many.
    let verdict = if most.parse().is_ok_and(|most: u64| most < 4096) { Verdict::Note } else { Verdict::Good };
    let advice = "many ROS clients of large scenes need one each: raise nofile in /etc/security/limits.conf";
    Finding::new("open files", verdict, format!("at most {most}"), advice)
}

#[cfg(feature = "view")]
fn drawing() -> Finding {
    let advice = "windows and cameras: apt install libegl1 libgl1-mesa-dri, or the driver of the graphics card";
    match ambf_render::Renderer::offscreen() {
        Ok(renderer) if renderer.is_software() => {
            let found = format!("{} (the processor draws)", renderer.device());
            let advice = "large pictures at 30 Hz want a graphics card whose driver offers EGL";
            Finding::new("drawing", Verdict::Note, found, advice)
        }
        Ok(renderer) => Finding::new("drawing", Verdict::Good, renderer.device(), ""),
        Err(error) => Finding::new("drawing", Verdict::Bad, error.to_string(), advice),
    }
}

#[cfg(not(feature = "view"))]
fn drawing() -> Finding {
    Finding::new("drawing", Verdict::Note, "this program was built without", "build with the feature view")
}

fn display(variable: impl Fn(&str) -> Option<String>) -> Finding {
    let named = ["WAYLAND_DISPLAY", "DISPLAY"].into_iter().find_map(|name| {
        let value = variable(name).filter(|value| !value.is_empty())?;
        Some(format!("{name} is {value}"))
    });
    let verdict = if named.is_some() { Verdict::Good } else { Verdict::Note };
    let advice = "no windows will open; cameras still publish pictures";
    Finding::new("display", verdict, named.unwrap_or_else(|| "none".into()), advice)
}

/// `answers`: whether somebody listens at an address, HOST:PORT.
fn master(uri: &str, answers: impl Fn(&str) -> Result<(), String>) -> Finding {
    let address = uri.trim_start_matches("http://").trim_end_matches('/');
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let is_local = ["localhost", "127.0.0.1", "[::1]"].contains(&host);
    match answers(address) {
        Ok(()) => Finding::new("ROS 1 master", Verdict::Good, format!("{uri} answers"), ""),
        Err(_) if is_local => {
            Finding::new("ROS 1 master", Verdict::Good, format!("none at {uri}: the simulator will start one"), "")
        }
        Err(why) => {
            let advice = "start roscore there, or set ROS_MASTER_URI; the simulator runs and asks for it every second";
            Finding::new("ROS 1 master", Verdict::Note, format!("{uri} does not answer: {why}"), advice)
        }
    }
}

fn answers(address: &str) -> Result<(), String> {
    let mut why = "no address".to_owned();
    for address in address.to_socket_addrs().map_err(|error| error.to_string())? {
        match TcpStream::connect_timeout(&address, Duration::from_secs(1)) {
            Ok(_) => return Ok(()),
            Err(error) => why = error.to_string(),
        }
    }
    Err(why)
}

/// The receive buffer that ROS 2 programs on this machine have unless they ask for another.
fn ros2_buffer(default: &str) -> Finding {
    let bytes: u64 = default.trim().parse().unwrap_or(0);
    let verdict = if bytes >= 4_000_000 { Verdict::Good } else { Verdict::Note };
    let advice = "only for raw images over ROS 2: sysctl net.core.rmem_default=4000000 net.core.rmem_max=4000000, or subscribe to \
                  ImageData/compressed";
    Finding::new("ROS 2 buffers", verdict, format!("{bytes} bytes (net.core.rmem_default)"), advice)
}

fn scenes(launch_file: &Path) -> Finding {
    match adf::load::<Launch>(launch_file) {
        Ok((launch, _)) => {
            let count = launch.multibody_configs.map_or(0, |models| models.len());
            let found = format!("{} lists {count} models", launch_file.display());
            Finding::new("launch file", Verdict::Good, found, "")
        }
        Err(error) => {
            let advice = "name one with --launch_file, or set AMBF_RESOURCES to the folder that holds it";
            Finding::new("launch file", Verdict::Bad, error.to_string(), advice)
        }
    }
}

/// What there is of the input devices that the launch file's list names.
fn input_devices(launch_file: &Path) -> Vec<Finding> {
    let launch = adf::load::<Launch>(launch_file).ok().map(|(launch, _)| launch);
    let file = launch.and_then(|launch| launch.input_devices_config);
    let Some(Ok((listed, _))) = file.map(|file| adf::load::<InputDevices>(&file)) else { return Vec::new() };
    let drivers = devices::drivers();
    let look = |entry: &adf::InputDevice| {
        let model = &entry.hardware_name;
        let driver = entry.driver.as_ref().map_or_else(|| drivers.serving(model), |name| drivers.named(name));
        let found = driver.ok_or_else(|| format!("no driver serves {model}"));
        let found = found.and_then(|driver| find_devices(driver, model, &entry.driver_settings));
        device(&format!("device {}", entry.identifier), found.map(|found| found.len()))
    };
    listed.entries.iter().flatten().map(look).collect()
}

/// `found`: how many there are, or why that is not known.
fn device(subject: &str, found: Result<usize, String>) -> Finding {
    match found {
        Ok(0) => Finding::new(subject, Verdict::Note, "not connected", "docs/devices.md says what each device needs"),
        Ok(_) => Finding::new(subject, Verdict::Good, "there", ""),
        Err(why) => Finding::new(subject, Verdict::Note, why, "docs/devices.md says what each device needs"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_and_limits_are_read() {
        assert_eq!(kernel("6.12.3-amd64\n").verdict, Verdict::Good);
        assert_eq!(kernel("7.0").verdict, Verdict::Good);
        assert_eq!(kernel("6.1.0-37-amd64").verdict, Verdict::Note);
        assert_eq!(kernel("").verdict, Verdict::Note);
        let limits = "Limit                     Soft Limit           Hard Limit           Units\n\
                      Max open files            1024                 2048                 files\n\
                      Max realtime priority     0                    0                    \n";
        assert_eq!(limit(limits, "Max realtime priority"), Some("0"));
        assert_eq!(open_files(limits).verdict, Verdict::Note);
        assert!(priority(Err("not permitted".into()), limits).found.contains("not permitted"));
        assert_eq!(priority(Ok(()), limits).verdict, Verdict::Good);
    }

    #[test]
    fn masters_of_this_machine_need_not_be_there() {
        let nobody = |_: &str| Err("refused".to_owned());
        assert_eq!(master("http://localhost:11311", nobody).verdict, Verdict::Good);
        assert_eq!(master("http://robot:11311/", nobody).verdict, Verdict::Note);
        let asked = |address: &str| if address == "robot:11311" { Ok(()) } else { Err(address.to_owned()) };
        assert_eq!(master("http://robot:11311/", asked).verdict, Verdict::Good);
    }

    #[test]
    fn percentiles_are_of_the_sorted_list() {
        let mut late: Vec<f64> = (0..100).rev().map(|index| f64::from(index) * 1e-5).collect();
        let found = punctuality(&mut late);
        assert_eq!(found.verdict, Verdict::Note);
        assert!(found.found.contains("0.99 ms at most"), "{found}");
        assert_eq!(punctuality(&mut []).verdict, Verdict::Good);
    }

    #[test]
    fn what_is_good_needs_no_advice() {
        let line = processors(8, "0.52 0.58 0.59 1/467 12\n").to_string();
        assert!(line.starts_with("ok    processors") && !line.contains("->"), "{line}");
        assert_eq!(processors(2, "9.1 0 0").verdict, Verdict::Note);
        assert!(processors(1, "").to_string().contains("-> "));
    }

    #[test]
    fn a_missing_launch_file_is_bad_and_the_rest_is_still_told() {
        let findings = examine(Path::new("/nowhere/launch.yaml"));
        let of = |subject: &str| findings.iter().find(|finding| finding.subject == subject).expect("a finding");
        assert_eq!(of("launch file").verdict, Verdict::Bad);
        assert!(of("punctuality").found.contains("1 kHz"));
    }
}
