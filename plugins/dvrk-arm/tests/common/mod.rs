//! A ROS master, fake arms and a haptic loop.
#![allow(dead_code)]

use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

use ambf_device::{DeviceForce, DeviceInfo, DeviceLog, DeviceSample, Driver, InputDevice, Setting, Settings};
use dvrk_arm::{driver, Dialect};
use fake_dvrk::{Fake, FakeOptions};
use nalgebra::Vector3;

/// How long a condition may take to become true on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(30);

pub const DIALECTS: [Dialect; 4] = [Dialect::Legacy, Dialect::Ambf, Dialect::CrtkTransform, Dialect::CrtkPose];

/// Waits until `condition` holds.
pub fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !condition() {
        assert!(Instant::now() < deadline, "waited {} s in vain: {what}", PATIENCE.as_secs());
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Debian's `rosmaster`; killed when dropped.
pub struct Master(Child);

impl Master {
    /// On a port; `None` where it is not installed.
    pub fn start(port: u16) -> Option<Self> {
        let child = Command::new("rosmaster")
            .args(["--core", "-p", &port.to_string()])
            .env("ROS_LOG_DIR", concat!(env!("CARGO_TARGET_TMPDIR"), "/ros_log"))
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        let master = child.ok().map(Self)?;
        until("the master answers", || TcpStream::connect(("127.0.0.1", port)).is_ok());
        Some(master)
    }
}

impl Drop for Master {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Points this process at a master on a free port; returns the port.
pub fn choose_master() -> u16 {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    std::env::set_var("ROS_MASTER_URI", format!("http://localhost:{port}/"));
    std::env::set_var("ROS_HOSTNAME", "localhost");
    port
}

/// The master of all tests of a file, Debian's or, where that is not installed, an embedded one.
pub fn share_master() {
    static MASTER: OnceLock<(Option<Mutex<Master>>, Option<Fake>)> = OnceLock::new();
    MASTER.get_or_init(|| {
        let port = choose_master();
        let master = Master::start(port);
        let embedded = master.is_none().then(|| {
            let arms = vec!["Nobody".to_owned()];
            Fake::start(FakeOptions { arms, embedded_master: true, ..Default::default() }).unwrap()
        });
        until("a master", || TcpStream::connect(("127.0.0.1", port)).is_ok());
        // Statics are not dropped: the master must not outlive the tests.
        if let Some(master) = &master {
            end_with_us(master.0.id());
        }
        (master.map(Mutex::new), embedded)
    });
}

/// A shell that waits for the end of this process and then ends `child`.
fn end_with_us(child: u32) {
    let script =
        format!("while kill -0 {} 2>/dev/null; do sleep 0.5; done; kill {child} 2>/dev/null", std::process::id());
    let shell = Command::new("sh").args(["-c", &script]).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    drop(shell.expect("a shell"));
}

pub fn settings(entries: &[(&str, &str)]) -> Settings {
    let entry = |(key, value): &(&str, &str)| {
        ((*key).to_owned(), Setting { value: (*value).to_owned(), place: "devices.yaml:7".into() })
    };
    Settings::new(entries.iter().map(entry).collect(), ".".into())
}

/// A device and what it has said.
pub struct Device {
    pub device: Box<dyn InputDevice>,
    pub said: Box<dyn Fn() -> Vec<String> + Send>,
}

impl Device {
    /// The arm of that name with settings.
    pub fn open(arm: &str, entries: &[(&str, &str)]) -> Self {
        let settings = settings(entries);
        let (log, said) = DeviceLog::new();
        let driver = driver();
        let info: DeviceInfo = driver.find(arm, &settings).unwrap().remove(0);
        let device = driver.open(&info, &settings, &log).unwrap();
        let all = Arc::new(Mutex::new(Vec::new()));
        let said = move || {
            let mut all = all.lock().unwrap();
            all.extend(said.try_iter());
            all.clone()
        };
        Self { device, said: Box::new(said) }
    }

    pub fn read(&mut self) -> DeviceSample {
        self.device.read().unwrap()
    }

    /// Waits for a valid sample.
    pub fn wait_valid(&mut self) {
        let deadline = Instant::now() + PATIENCE;
        while !self.read().valid {
            assert!(Instant::now() < deadline, "not valid; said: {:#?}", (self.said)());
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Writes a force and reads, at 1 kHz for so many ticks; the longest tick's work.
    pub fn ticks(&mut self, force: Vector3<f64>, count: u32) -> Duration {
        let (mut next, mut longest) = (Instant::now(), Duration::ZERO);
        for _ in 0..count {
            let begin = Instant::now();
            self.device.read().unwrap();
            self.device.write(&DeviceForce { force, ..DeviceForce::zero() }).unwrap();
            longest = longest.max(begin.elapsed());
            next += Duration::from_millis(1);
            std::thread::sleep(next.saturating_duration_since(Instant::now()));
        }
        longest
    }

    /// Ticks until a force arrives at the fake arm.
    pub fn wait_felt(&mut self, fake: &Fake, arm: &str, force: Vector3<f64>) {
        let deadline = Instant::now() + PATIENCE;
        while !fake.last_wrench(arm).is_some_and(|shown| shown.wrench.force.norm() > 0.0) {
            assert!(Instant::now() < deadline, "no force came; said: {:#?}", (self.said)());
            self.ticks(force, 20);
        }
    }
}
