//! Devices that do what a test tells them, and scenes for them.
#![allow(dead_code, missing_docs)]

use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_core::adf::{self, InputDevice as Entry, InputDevices};
use ambf_core::control::Profile;
use ambf_core::device::host::{DeviceHost, HostOptions};
use ambf_core::device::law::Switches;
use ambf_core::device::{
    Axes, DeviceError, DeviceForce, DeviceInfo, DeviceLog, DeviceSample, DeviceSpec, Driver, Drivers, InputDevice,
    Settings,
};
use ambf_core::scene::{load, PhysicsOptions, SceneFiles, SceneOptions};
use ambf_core::sim::Simulation;
use nalgebra::{UnitQuaternion, Vector3};
use parking_lot::Mutex;
use tempfile::TempDir;

/// What goes wrong in the next read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Trouble {
    Block(Duration),
    Panic,
    NotFinite,
    Lost,
}

/// What opening the device gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Opening {
    Good,
    Unavailable,
    Lost,
    Panic,
    Hang(Duration),
}

/// The hand of a device.
#[derive(Debug, Clone, Copy)]
pub struct Pose {
    pub position: Vector3<f64>,
    pub rotation: UnitQuaternion<f64>,
    pub gripper: Option<f64>,
    pub buttons: u32,
    pub valid: bool,
}

/// One device, seen from the test.
pub struct Puppet {
    pub identity: String,
    pose: Mutex<Pose>,
    trouble: Mutex<Option<Trouble>>,
    opening: Mutex<Opening>,
    force: Mutex<Option<DeviceForce>>,
    pub opened: AtomicU32,
    pub closed: AtomicU32,
    pub reads: AtomicU64,
    pub writes: AtomicU64,
    pub writes_when_closed: AtomicU64,
    /// The force that was there when it was closed last, as bits.
    left: AtomicU64,
}

impl Puppet {
    fn new(identity: &str) -> Arc<Self> {
        let rotation = UnitQuaternion::identity();
        Arc::new(Self {
            identity: identity.into(),
            pose: Mutex::new(Pose {
                position: Vector3::zeros(),
                rotation,
                gripper: Some(1.0),
                buttons: 0,
                valid: true,
            }),
            trouble: Mutex::default(),
            opening: Mutex::new(Opening::Good),
            force: Mutex::default(),
            opened: AtomicU32::new(0),
            closed: AtomicU32::new(0),
            reads: AtomicU64::new(0),
            writes: AtomicU64::new(0),
            writes_when_closed: AtomicU64::new(0),
            left: AtomicU64::new(0),
        })
    }

    pub fn set(&self, change: impl FnOnce(&mut Pose)) {
        change(&mut self.pose.lock());
    }

    pub fn make(&self, trouble: Trouble) {
        *self.trouble.lock() = Some(trouble);
    }

    pub fn set_opening(&self, opening: Opening) {
        *self.opening.lock() = opening;
    }

    /// The newest force, N; 0 before the first.
    pub fn force(&self) -> f64 {
        self.force.lock().map_or(0.0, |force| force.force.norm() + force.torque.norm())
    }

    /// The force with which it was closed last, N.
    pub fn left(&self) -> f64 {
        f64::from_bits(self.left.load(Ordering::Relaxed))
    }

    pub fn reads(&self) -> u64 {
        self.reads.load(Ordering::Relaxed)
    }

    pub fn opened(&self) -> u32 {
        self.opened.load(Ordering::Relaxed)
    }

    pub fn closed(&self) -> u32 {
        self.closed.load(Ordering::Relaxed)
    }
}

struct Opened {
    puppet: Arc<Puppet>,
    spec: DeviceSpec,
    is_open: bool,
}

impl InputDevice for Opened {
    fn spec(&self) -> &DeviceSpec {
        &self.spec
    }

    fn read(&mut self) -> Result<DeviceSample, DeviceError> {
        let puppet = &self.puppet;
        let sequence = puppet.reads.fetch_add(1, Ordering::Relaxed);
        let pose = *puppet.pose.lock();
        let mut sample = DeviceSample {
            sequence,
            position: pose.position,
            rotation: pose.rotation,
            gripper: pose.gripper,
            buttons: pose.buttons,
            valid: pose.valid,
            ..DeviceSample::none(Instant::now())
        };
        let trouble = puppet.trouble.lock().take();
        match trouble {
            None => (),
            Some(Trouble::Block(time)) => std::thread::sleep(time),
            Some(Trouble::Panic) => panic!("the driver was told to"),
            Some(Trouble::NotFinite) => sample.position.x = f64::NAN,
            Some(Trouble::Lost) => return Err(DeviceError::Lost("unplugged".into())),
        }
        Ok(sample)
    }

    fn write(&mut self, force: &DeviceForce) -> Result<(), DeviceError> {
        assert!(force.is_finite());
        *self.puppet.force.lock() = Some(*force);
        self.puppet.writes.fetch_add(1, Ordering::Relaxed);
        if !self.is_open {
            self.puppet.writes_when_closed.fetch_add(1, Ordering::Relaxed);
        }
        Ok(())
    }

    fn close(&mut self) {
        self.is_open = false;
        self.puppet.left.store(self.puppet.force().to_bits(), Ordering::Relaxed);
        self.puppet.closed.fetch_add(1, Ordering::Relaxed);
    }
}

/// A driver of devices of the model `Puppet`.
pub struct Puppeteer(pub Vec<Arc<Puppet>>);

impl Driver for Puppeteer {
    fn name(&self) -> &str {
        "puppets"
    }

    fn serves(&self, model: &str) -> bool {
        model == "Puppet"
    }

    fn find(&self, _: &str, _: &Settings) -> Result<Vec<DeviceInfo>, DeviceError> {
        let info = |puppet: &Arc<Puppet>| DeviceInfo { model: "Puppet".into(), identity: puppet.identity.clone() };
        Ok(self.0.iter().map(info).collect())
    }

    fn open(&self, info: &DeviceInfo, _: &Settings, log: &DeviceLog) -> Result<Box<dyn InputDevice>, DeviceError> {
        let puppet = self.0.iter().find(|puppet| puppet.identity == info.identity).expect("it was found").clone();
        let opening = *puppet.opening.lock();
        match opening {
            Opening::Good => (),
            Opening::Unavailable => return Err(DeviceError::Unavailable("no library".into())),
            Opening::Lost => return Err(DeviceError::Lost("silent".into())),
            Opening::Panic => panic!("cannot open"),
            Opening::Hang(time) => std::thread::sleep(time),
        }
        puppet.opened.fetch_add(1, Ordering::Relaxed);
        log.say("open");
        Ok(Box::new(Opened { puppet, spec: spec(), is_open: true }))
    }
}

pub fn spec() -> DeviceSpec {
    DeviceSpec {
        max_force: 5.0,
        max_torque: 1.0,
        max_stiffness: 1000.0,
        max_angular_stiffness: 10.0,
        sensed: Axes { position: true, rotation: true, gripper: true },
        start_up_hold: 0.0,
        ..DeviceSpec::unknown("Puppet")
    }
}

pub fn puppets(identities: &[&str]) -> (Vec<Arc<Puppet>>, Drivers) {
    let puppets: Vec<_> = identities.iter().map(|identity| Puppet::new(identity)).collect();
    let mut drivers = Drivers::default();
    drivers.add(Arc::new(Puppeteer(puppets.clone())));
    (puppets, drivers)
}

/// A folder of a test's files.
pub struct Folder(pub TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(TempDir::new().expect("a temporary folder"))
    }

    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        std::fs::write(self.0.path().join(name), text).expect("written");
        self.0.path().join(name)
    }

    /// Entries of a device file.
    pub fn entries(&self, text: &str) -> Vec<Entry> {
        let (devices, report) = adf::load::<InputDevices>(&self.write("devices.yaml", text)).expect("a device file");
        assert_eq!(report.errors(), 0, "{report}");
        devices.entries.into_iter().map(|entry| entry.expect("a good entry")).collect()
    }

    pub fn simulation(&self, models: &[&str], profile: Profile) -> Simulation {
        let world = self.write("world.yaml", WORLD);
        let write = |(i, text): (usize, &&str)| self.write(&format!("model{i}.yaml"), text);
        let files = SceneFiles { world: Some(world), models: models.iter().enumerate().map(write).collect() };
        let physics = PhysicsOptions { profile: Some(profile), ..PhysicsOptions::default() };
        let loaded = load(&files, &SceneOptions { physics, may_grow: true, ..SceneOptions::default() });
        assert_eq!(loaded.report.errors(), 0, "{}", loaded.report);
        Simulation::new(loaded.scene, 0.001)
    }
}

/// Opens devices and gives them end-effectors.
///
/// # Panics
/// When one is left out.
pub fn coupled(entries: &[Entry], drivers: &Drivers, forces: bool, simulation: &mut Simulation) -> DeviceHost {
    let switches = Switches { forces, ..Switches::default() };
    let options = HostOptions { switches, ..HostOptions::default() };
    let (mut host, problems) = DeviceHost::open(&entries.iter().collect::<Vec<_>>(), drivers, &options);
    assert!(problems.is_empty(), "{problems:?}");
    let said = simulation.add_devices(&mut host);
    assert!(!said.iter().any(|line| line.contains("left out")), "{said:?}");
    host
}

/// Waits until `condition` holds.
#[track_caller]
pub fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !condition() {
        assert!(begin.elapsed() < Duration::from_secs(30), "waiting for: {what}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Weightless, with a camera whose axes are those of the world.
pub const WORLD: &str = "gravity: {x: 0, y: 0, z: 0}\nmax iterations: 50\ncameras: [camera1]\nnamespace: /w/\n\
    camera1: {name: camera1, location: {x: 1, y: 0, z: 0}, look at: {x: 0, y: 0, z: 0}, up: {x: 0, y: 0, z: 1}}\n";

/// Two free boxes.
pub const BOXES: &str = "bodies: [BODY left, BODY right]\nnamespace: /b/\n\
    BODY left: {name: left, mass: 1, location: {position: {x: 0, y: -1, z: 0}}, collision shape: Box, \
      collision geometry: {x: 0.1, y: 0.1, z: 0.1}}\n\
    BODY right: {name: right, mass: 1, location: {position: {x: 0, y: 1, z: 0}}, collision shape: Box, \
      collision geometry: {x: 0.1, y: 0.1, z: 0.1}}\n";

/// Entries for both boxes, with force feedback from the start.
pub const BOTH: &str = "input devices: [A, B]\n\
    A: {hardware name: Puppet, root link: BODY left, haptic gain: {linear: 10, angular: 0}, enable on button: false, \
      button mapping: {a1: 1}, controller gain: {linear: {P: 100, D: 20}, angular: {P: 1, D: 0.2}}}\n\
    B: {hardware name: Puppet, root link: BODY right, haptic gain: {linear: 10, angular: 0}, enable on button: false, \
      button mapping: {a1: 1}, controller gain: {linear: {P: 100, D: 20}, angular: {P: 1, D: 0.2}}}\n";

/// A gripper whose palm carries a finger on a hinge and a ray that looks along x.
pub const GRIPPER: &str = "bodies: [BODY palm, BODY finger]\njoints: [JOINT hinge]\nsensors: [SENSOR eye]\nnamespace: /g/\n\
    BODY palm: {name: palm, mass: 0.5, location: {position: {x: 1, y: 2, z: 3}}, inertia: {ix: 0.01, iy: 0.01, iz: 0.01}, \
      controller: {linear: {P: 200, D: 20}, angular: {P: 2, D: 0.2}}}\n\
    BODY finger: {name: finger, mass: 0.1, location: {position: {x: 1.1, y: 2, z: 3}}, inertia: {ix: 0.001, iy: 0.001, iz: 0.001}}\n\
    JOINT hinge: {name: hinge, type: revolute, parent: BODY palm, child: BODY finger, parent axis: {x: 0, y: 0, z: 1}, \
      child axis: {x: 0, y: 0, z: 1}, parent pivot: {x: 0.05, y: 0, z: 0}, child pivot: {x: -0.05, y: 0, z: 0}, \
      joint limits: {low: -0.2, high: 0.6}}\n\
    SENSOR eye: {name: eye, type: Proximity, parent: BODY palm, range: 0.3, array: \
      [{offset: {x: 0, y: 0, z: 0.03}, direction: {x: 1, y: 0, z: 0}}, {offset: {x: 0, y: 0, z: 0.04}, direction: {x: 1, y: 0, z: 0}}]}\n";
