//! What the threads of one arm share.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicU8, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::Thread;
use std::time::{Duration, Instant};

use ambf_device::Latest;
use arc_swap::{ArcSwap, ArcSwapOption};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use parking_lot::Mutex;

use crate::dialect::{Dialect, Names};
use crate::frames::{Frames, Wrench};
use crate::gravity::GravityTerm;
use crate::options::ArmOptions;
use crate::outputs::Outputs;
use crate::pedals::{Pedal, Pedals};
use crate::wire::{Joints, State};

/// What kind of command counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Mode {
    /// None yet.
    Uninitialised = 0,
    /// Joint positions.
    JointPosition = 1,
    /// Poses of the tip.
    CartesianPosition = 2,
    /// Wrenches at the tip.
    CartesianEffort = 3,
}

impl Mode {
    const ALL: [Self; 4] = [Self::Uninitialised, Self::JointPosition, Self::CartesianPosition, Self::CartesianEffort];

    /// Its name in the legacy and AMBF dialects.
    pub fn name(self) -> &'static str {
        match self {
            Self::Uninitialised => "DVRK_UNINITIALIZED",
            Self::JointPosition => "DVRK_POSITION_JOINT",
            Self::CartesianPosition => "DVRK_POSITION_CARTESIAN",
            Self::CartesianEffort => "DVRK_EFFORT_CARTESIAN",
        }
    }

    fn from_number(number: u8) -> Self {
        Self::ALL.into_iter().find(|mode| *mode as u8 == number).unwrap_or(Self::Uninitialised)
    }

    fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| mode.name() == name)
    }
}

/// A motion command in the arm's frames.
#[derive(Debug, Clone)]
pub(crate) enum Servo {
    Pose(Isometry3<f64>),
    Joints(Vec<f64>),
}

/// A pose and when it came.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Posed {
    pub at: Instant,
    /// Counts poses.
    pub sequence: u64,
    /// Device frame.
    pub pose: Isometry3<f64>,
}

/// After the last command on a topic, so that it arrives before what follows on another topic and before the topic ends.
pub(crate) const FLUSH: Duration = Duration::from_millis(20);

/// One arm.
pub(crate) struct Inner {
    pub names: Names,
    pub options: ArmOptions,
    epoch: Instant,
    pub frames: Mutex<Frames>,
    /// Nanoseconds since the epoch, position, quaternion (x, y, z, w) in the device frame.
    pose: Latest<8>,
    /// Angle, rad; not finite before the first message.
    gripper: AtomicU64,
    /// Angles of the closed and the open gripper.
    gripper_range: Latest<2>,
    closed: AtomicBool,
    pub pedals: ArcSwap<Pedals>,
    pub joints: Mutex<Joints>,
    pub measured_wrench: Mutex<Wrench>,
    pub state: Mutex<Option<State>>,
    /// The arm's state allows it to be used.
    pub ready: AtomicBool,
    /// 6 × n in columns.
    pub jacobian: Mutex<Vec<f64>>,
    pub gravity: Mutex<Option<GravityTerm>>,
    pub outputs: ArcSwapOption<Outputs>,
    /// Nanoseconds since the epoch, force and torque in the device frame.
    wrench: Latest<7>,
    pub servo: Mutex<Option<(u64, Instant, Servo)>>,
    mode: AtomicU8,
    /// Kind of the newest command.
    commanding: AtomicU8,
    /// Kind of the command that the thread that sends is busy with.
    acting: AtomicU8,
    /// Wrenches that were sent.
    pub sent: AtomicU64,
    pub closing: AtomicBool,
    /// The thread that sends.
    sender: OnceLock<Thread>,
}

impl Inner {
    pub fn new(names: Names, arm: &str, options: ArmOptions) -> Self {
        let frames = options.frames.unwrap_or_else(|| Frames::of(arm));
        let inner = Self {
            names,
            options,
            epoch: Instant::now(),
            frames: Mutex::new(frames),
            pose: Latest::new(),
            gripper: AtomicU64::new(f64::NAN.to_bits()),
            gripper_range: Latest::new(),
            closed: AtomicBool::new(false),
            pedals: ArcSwap::default(),
            joints: Mutex::default(),
            measured_wrench: Mutex::default(),
            state: Mutex::default(),
            ready: AtomicBool::new(false),
            jacobian: Mutex::default(),
            gravity: Mutex::default(),
            outputs: ArcSwapOption::empty(),
            wrench: Latest::new(),
            servo: Mutex::default(),
            mode: AtomicU8::new(Mode::Uninitialised as u8),
            commanding: AtomicU8::new(Mode::Uninitialised as u8),
            acting: AtomicU8::new(Mode::Uninitialised as u8),
            sent: AtomicU64::new(0),
            closing: AtomicBool::new(false),
            sender: OnceLock::new(),
        };
        inner.speak(Dialect::CrtkPose);
        inner
    }

    /// Says a sentence about the arm.
    pub fn say(&self, sentence: &str) {
        (self.options.say)(&format!("{}: {sentence}", self.names.identity()));
    }

    /// The arm now speaks `dialect`: what was known about it is not any more.
    pub fn speak(&self, dialect: Dialect) {
        let (closed, open) = self.options.gripper_range(dialect);
        self.gripper_range.store([closed.to_bits(), open.to_bits()]);
        self.gripper.store(f64::NAN.to_bits(), Ordering::Release);
        self.closed.store(false, Ordering::Release);
        *self.state.lock() = None;
        self.ready.store(!dialect.is_crtk(), Ordering::Release);
    }

    fn nanoseconds(&self, at: Instant) -> u64 {
        u64::try_from(at.saturating_duration_since(self.epoch).as_nanos()).unwrap_or(u64::MAX)
    }

    fn instant(&self, nanoseconds: u64) -> Instant {
        self.epoch + Duration::from_nanos(nanoseconds)
    }

    /// A pose has come, in the arm's frames.
    pub fn take_pose(&self, measured: &Isometry3<f64>) {
        let pose = self.frames.lock().to_device(measured);
        let (p, q) = (pose.translation, pose.rotation.coords);
        let numbers = [p.x, p.y, p.z, q.x, q.y, q.z, q.w].map(f64::to_bits);
        let mut words = [self.nanoseconds(Instant::now()); 8];
        words[1..].copy_from_slice(&numbers);
        self.pose.store(words);
    }

    /// The newest pose, without waiting for anybody; `None` before the first, or when one is just being stored.
    pub fn posed(&self) -> Option<Posed> {
        let (sequence, words) = self.pose.load().filter(|(sequence, _)| *sequence > 0)?;
        let [_, x, y, z, i, j, k, w] = words.map(f64::from_bits);
        let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k));
        let pose = Isometry3::from_parts(Translation3::new(x, y, z), rotation);
        Some(Posed { at: self.instant(words[0]), sequence, pose })
    }

    /// The gripper's angle has come, rad.
    pub fn take_gripper(&self, angle: f64) {
        if angle.is_finite() {
            self.gripper.store(angle.to_bits(), Ordering::Release);
        }
    }

    /// rad; `None` before the first message.
    pub fn gripper_angle(&self) -> Option<f64> {
        Some(f64::from_bits(self.gripper.load(Ordering::Acquire))).filter(|angle| angle.is_finite())
    }

    /// 0 closed … 1 open, 0.5 before the first message.
    pub fn gripper(&self) -> f64 {
        let range = self.gripper_range.load();
        match (self.gripper_angle(), range) {
            (Some(angle), Some((_, words))) => {
                let [closed, open] = words.map(f64::from_bits);
                (angle.clamp(closed, open) - closed) / (open - closed)
            }
            _ => 0.5,
        }
    }

    pub fn take_closed(&self, closed: bool) {
        self.closed.store(closed, Ordering::Release);
    }

    /// Bit 0 gripper closed, then the pedals.
    pub fn buttons(&self) -> u32 {
        self.pedals.load().pressed() | u32::from(self.closed.load(Ordering::Acquire))
    }

    /// A state has come; says what it means for the user if it is news.
    pub fn take_state(&self, state: State) {
        self.ready.store(state.is_ready(), Ordering::Release);
        if let Some(mode) = Mode::from_name(&state.name) {
            self.mode.store(mode as u8, Ordering::Release);
        }
        let mut known = self.state.lock();
        let news = known.as_ref().is_none_or(|known| {
            (&known.name, known.homed_busy.map(|(homed, _)| homed))
                != (&state.name, state.homed_busy.map(|(homed, _)| homed))
        });
        let sentence = match state.homed_busy {
            Some((true, _)) => format!("{}, homed", state.name),
            Some((false, _)) => format!("{}, not homed", state.name),
            None => state.name.clone(),
        };
        *known = Some(state);
        drop(known);
        if news {
            self.say(&sentence);
        }
    }

    /// Whether a pose of it is new enough.
    pub fn is_available(&self) -> bool {
        self.posed().is_some_and(|posed| posed.at.elapsed() <= self.options.timeout)
    }

    /// As the arm says, or as the last command has it.
    pub fn mode(&self) -> Mode {
        Mode::from_number(self.mode.load(Ordering::Acquire))
    }

    /// Kind of the newest command; uninitialised after a request of a mode, which ends repetitions.
    pub fn commanding(&self) -> Mode {
        Mode::from_number(self.commanding.load(Ordering::Acquire))
    }

    /// No command is repeated any more until the next one. Waits until that is so and the last one has left: each
    /// topic has its own connection, so a command sent just before could arrive after what the caller sends next.
    pub fn stop_commands(&self) {
        let before = self.commanding.swap(Mode::Uninitialised as u8, Ordering::AcqRel);
        self.wake();
        let deadline = Instant::now() + Duration::from_millis(100);
        while Mode::from_number(self.acting.load(Ordering::Acquire)) != Mode::Uninitialised && Instant::now() < deadline
        {
            std::thread::sleep(Duration::from_micros(200));
        }
        if Mode::from_number(before) != Mode::Uninitialised {
            std::thread::sleep(FLUSH);
        }
    }

    /// The thread that sends has done with commands of other kinds.
    pub fn acts(&self, kind: Mode) {
        self.acting.store(kind as u8, Ordering::Release);
    }

    fn command(&self, mode: Mode) {
        self.mode.store(mode as u8, Ordering::Release);
        self.commanding.store(mode as u8, Ordering::Release);
        self.wake();
    }

    /// Leaves a wrench in the device frame for the thread that sends; waits for nobody.
    pub fn command_wrench(&self, wrench: &Wrench) {
        let (f, t) = (wrench.force, wrench.torque);
        let mut words = [self.nanoseconds(Instant::now()); 7];
        words[1..].copy_from_slice(&[f.x, f.y, f.z, t.x, t.y, t.z].map(f64::to_bits));
        if self.wrench.store(words) {
            self.command(Mode::CartesianEffort);
        }
    }

    /// The newest wrench, its number and when it was given.
    pub fn commanded_wrench(&self) -> Option<(u64, Instant, Wrench)> {
        let (number, words) = self.wrench.load().filter(|(number, _)| *number > 0)?;
        let [_, a, b, c, d, e, f] = words.map(f64::from_bits);
        let wrench = Wrench { force: Vector3::new(a, b, c), torque: Vector3::new(d, e, f) };
        Some((number, self.instant(words[0]), wrench))
    }

    /// Leaves a motion command for the thread that sends.
    pub fn command_servo(&self, servo: Servo) {
        let mode = match servo {
            Servo::Pose(_) => Mode::CartesianPosition,
            Servo::Joints(_) => Mode::JointPosition,
        };
        let mut slot = self.servo.lock();
        let number = slot.as_ref().map_or(0, |(number, ..)| *number) + 1;
        *slot = Some((number, Instant::now(), servo));
        drop(slot);
        self.command(mode);
    }

    pub fn is_clutched(&self) -> bool {
        self.buttons() & Pedal::Clutch.bit() != 0
    }

    /// Pedals from now on.
    pub fn set_pedals(&self, pedals: Arc<Pedals>) {
        if let Some(thread) = self.sender.get() {
            pedals.wake(thread.clone());
        }
        self.pedals.store(pedals);
    }

    /// The present thread sends for the arm.
    pub fn claim_sender(&self) {
        let _ = self.sender.set(std::thread::current());
        self.pedals.load().wake(std::thread::current());
    }

    pub fn wake(&self) {
        if let Some(thread) = self.sender.get() {
            thread.unpark();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::isometry;

    fn arm(options: ArmOptions) -> Inner {
        let say = Arc::new(|_: &str| ());
        Inner::new(Names::new(None, "MTMR").unwrap(), "MTMR", ArmOptions { say, ..options })
    }

    #[test]
    fn grippers_have_a_range_for_each_dialect() {
        let inner = arm(ArmOptions::default());
        assert_eq!(inner.gripper(), 0.5, "before the first message");
        let check = |dialect, angles: [(f64, f64); 4]| {
            inner.speak(dialect);
            for (degrees, expected) in angles {
                inner.take_gripper(degrees.to_radians());
                assert!((inner.gripper() - expected).abs() < 1e-12, "{dialect}: {degrees}°: {}", inner.gripper());
            }
        };
        check(Dialect::CrtkPose, [(0.0, 0.0), (30.0, 0.5), (60.0, 1.0), (-10.0, 0.0)]);
        check(Dialect::CrtkTransform, [(0.0, 0.0), (15.0, 0.25), (60.0, 1.0), (75.0, 1.0)]);
        check(Dialect::Ambf, [(-60.0, 0.0), (0.0, 0.5), (60.0, 1.0), (-180.0, 0.0)]);
        check(Dialect::Legacy, [(-60.0, 0.0), (30.0, 0.75), (60.0, 1.0), (90.0, 1.0)]);
        inner.take_gripper(f64::NAN);
        assert_eq!(inner.gripper(), 1.0, "what is no angle is no news");
        let own = arm(ArmOptions { gripper: Some((0.2, 0.6)), ..Default::default() });
        own.take_gripper(0.3);
        assert!((own.gripper() - 0.25).abs() < 1e-12);
    }

    #[test]
    fn poses_are_counted_and_come_in_device_frames() {
        let inner = arm(ArmOptions::default());
        assert!(inner.posed().is_none() && !inner.is_available());
        inner.take_pose(&isometry([-0.181025, -0.0163, -0.1620, 0.0, 0.0, 0.0]));
        let posed = inner.posed().unwrap();
        assert_eq!(posed.sequence, 1);
        assert!((posed.pose.translation.vector - Vector3::new(0.0, 0.0, 0.1)).norm() < 1e-12);
        assert!(inner.is_available());
    }

    #[test]
    fn states_make_an_arm_ready() {
        let inner = arm(ArmOptions::default());
        let ready = |name: &str, homed_busy| {
            inner.take_state(State { name: name.into(), homed_busy });
            inner.ready.load(Ordering::Acquire)
        };
        assert!(ready("ENABLED", Some((true, false))));
        assert!(!ready("ENABLED", Some((false, false))) && !ready("ENABLED", Some((true, true))));
        assert!(!ready("FAULT", Some((true, false))) && !ready("PAUSED", Some((true, false))));
        assert!(!ready("DVRK_UNINITIALIZED", None) && ready("DVRK_EFFORT_CARTESIAN", None));
        assert_eq!(inner.mode(), Mode::CartesianEffort);
    }
}
