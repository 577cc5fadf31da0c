//! `ambf_simulator --doctor`: what this machine can and cannot do for the simulator, and what to do about it.
//!
//! Nothing is changed on the machine: no device is opened, no master started, no window shown. Of arms over ROS a node
//! listens to what they publish anyway.

use std::fmt;
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use ambf_core::adf::{self, InputDevices, Launch};
use ambf_core::device::host::{find_devices, presence_of};
use ambf_core::device::timing::Pacer;
use ambf_core::device::{Drivers, Presence};
use ros_node::{CallError, Peer};

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

/// Looks at everything; takes about a second, and up to some more for each input device that is there and silent.
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
        master(&ros_node::master_uri(), |master| master.call("getPid", Vec::new()).map(drop)),
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

#[cfg(feature = "pictures")]
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

#[cfg(not(feature = "pictures"))]
fn drawing() -> Finding {
    Finding::new("drawing", Verdict::Note, "this program was built without", "build with the feature pictures")
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

/// `answers`: whether a master does.
fn master(uri: &str, answers: impl Fn(&Peer) -> Result<(), CallError>) -> Finding {
    let subject = "ROS 1 master";
    let master = match Peer::new(uri, "/ambf_doctor", Duration::from_secs(1)) {
        Ok(master) => master,
        Err(error) => return Finding::new(subject, Verdict::Bad, error.to_string(), "set ROS_MASTER_URI, or unset it"),
    };
    let is_local =
        || master.addresses().is_ok_and(|addresses| addresses.iter().all(|address| address.ip().is_loopback()));
    match answers(&master) {
        Ok(()) => Finding::new(subject, Verdict::Good, format!("{uri} answers"), ""),
        Err(CallError::NoAnswer { .. }) if is_local() => {
            Finding::new(subject, Verdict::Good, format!("none at {uri}: the simulator will start one"), "")
        }
        Err(why) => {
            let advice = "start roscore there, or set ROS_MASTER_URI; the simulator runs and asks for it every second";
            Finding::new(subject, Verdict::Note, why.to_string(), advice)
        }
    }
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
    let look = |entry: &adf::InputDevice| device(&format!("device {}", entry.identifier), look_at(entry, &drivers));
    listed.entries.iter().flatten().map(look).collect()
}

/// What its driver tells of the device of an entry; `None`: there is none.
///
/// # Errors
/// Why that is not known.
fn look_at(entry: &adf::InputDevice, drivers: &Drivers) -> Result<Option<Presence>, String> {
    let model = &entry.hardware_name;
    let driver = entry.driver.as_ref().map_or_else(|| drivers.serving(model), |name| drivers.named(name));
    let driver = driver.ok_or_else(|| format!("no driver serves {model}"))?;
    let found = find_devices(driver, model, &entry.driver_settings)?;
    let is_wanted = |identity: &str| entry.identity.as_ref().is_none_or(|wanted| wanted == identity);
    let found = found.iter().find(|info| info.model == *model && is_wanted(&info.identity));
    found.map(|info| presence_of(driver, info, &entry.driver_settings)).transpose()
}

fn device(subject: &str, looked: Result<Option<Presence>, String>) -> Finding {
    let (verdict, found) = match looked {
        Ok(Some(Presence::There(what))) if what.is_empty() => (Verdict::Good, "there".to_owned()),
        Ok(Some(Presence::There(what))) => (Verdict::Good, format!("there: {what}")),
        Ok(Some(Presence::NotReady(why))) => (Verdict::Note, format!("not ready: {why}")),
        Ok(Some(Presence::Unknown(why))) => (Verdict::Note, format!("not known: {why}")),
        Ok(None) => (Verdict::Note, "not connected".to_owned()),
        Err(why) => (Verdict::Note, why),
    };
    Finding::new(subject, verdict, found, "docs/devices.md says what each device needs")
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
        let none = |master: &Peer| {
            let reason = std::io::ErrorKind::ConnectionRefused.into();
            Err(CallError::NoAnswer { uri: master.uri().to_owned(), reason })
        };
        assert_eq!(master("http://localhost:11311", none).verdict, Verdict::Good);
        assert_eq!(master("http://192.0.2.1:11311/", none).verdict, Verdict::Note);
        assert_eq!(master("http://192.0.2.1:11311/", |_| Ok(())).verdict, Verdict::Good);
        let other = |master: &Peer| Err(CallError::NotRos(master.uri().to_owned()));
        assert_eq!(master("http://localhost:11311", other).verdict, Verdict::Note, "none can be started there");
        assert_eq!(master("localhost:11311", none).verdict, Verdict::Bad);
    }

    #[test]
    fn devices_are_there_only_if_their_driver_says_so() {
        let of = |looked| device("device A", looked);
        assert_eq!(of(Ok(Some(Presence::There("usb 1-2".into())))).verdict, Verdict::Good);
        for looked in [
            Ok(Some(Presence::NotReady("why".into()))),
            Ok(Some(Presence::Unknown("why".into()))),
            Ok(None),
            Err("why".into()),
        ] {
            let finding = of(looked);
            assert!(finding.verdict == Verdict::Note && !finding.advice.is_empty(), "{finding}");
        }
        let text = "input devices: [A, B, C]\n\
                    A: {hardware name: Mock, root link: l}\nB: {hardware name: Mock, identity: 99, root link: l}\n\
                    C: {hardware name: Loom, root link: l}\n";
        let (list, _) = adf::parse::<InputDevices>(text, Path::new("d.yaml")).unwrap();
        let drivers = devices::drivers();
        let looked: Vec<_> = list.entries.iter().flatten().map(|entry| look_at(entry, &drivers)).collect();
        assert!(matches!(&looked[0], Ok(Some(Presence::There(_)))), "{looked:?}");
        assert_eq!(looked[1], Ok(None));
        assert!(looked[2].is_err());
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
