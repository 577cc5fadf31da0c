//! The thread of one device.

use std::panic::{catch_unwind, AssertUnwindSafe};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicU8, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};
use nalgebra::{Isometry3, Vector3};

use super::claim::Claim;
use super::exchange::{CameraSum, Controls, DeviceEnd, Followed, Hand, STALE};
use super::rates::{Counter, Periods};
use super::{DeviceEvent, News};
use crate::law::{HapticInput, HapticLoop, HapticOutput, WorldView};
use crate::timing::Pacer;
use crate::{caught, DeviceError, DeviceForce, DeviceLog, DeviceSample, DeviceSpec, InputDevice, Latest};
use ambf_model::adf;

/// First wait before a lost device is opened again; it doubles up to the second.
const BACK_OFF: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(5)];
/// A device that has run for so long is waited for from the start again.
const STEADY: Duration = Duration::from_secs(10);
/// How often a thread without a device looks whether it should end.
const IDLE: Duration = Duration::from_millis(10);

/// What a device's thread does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Stage {
    Opening,
    Running,
    Lost,
    Ended,
}

/// What other threads see of a device's thread.
pub(super) struct Shared {
    pub stop: AtomicBool,
    stage: AtomicU8,
    /// When the last tick ended or a call of the driver began, ns after `epoch`.
    beat: AtomicU64,
    epoch: Instant,
    pub loops: Periods,
    pub samples: Periods,
    /// Bits of what was written to the device last: force, torque, gripper.
    force: Latest<7>,
}

impl Shared {
    pub fn new() -> Self {
        Self {
            stop: AtomicBool::new(false),
            stage: AtomicU8::new(Stage::Opening as u8),
            beat: AtomicU64::new(0),
            epoch: Instant::now(),
            loops: Periods::default(),
            samples: Periods::default(),
            force: Latest::new(),
        }
    }

    /// Wait-free; only the device's thread calls it.
    fn keep_force(&self, force: &DeviceForce) {
        let DeviceForce { force: f, torque: t, gripper } = force;
        self.force.store([f.x, f.y, f.z, t.x, t.y, t.z, *gripper].map(f64::to_bits));
    }

    /// What was written to the device last; nothing before, and while it is not running.
    pub fn force(&self) -> DeviceForce {
        let Some(words) = self.force.newest().filter(|_| self.stage() == Stage::Running) else {
            return DeviceForce::zero();
        };
        let [a, b, c, d, e, f, gripper] = words.map(f64::from_bits);
        DeviceForce { force: Vector3::new(a, b, c), torque: Vector3::new(d, e, f), gripper }
    }

    pub fn stage(&self) -> Stage {
        [Stage::Opening, Stage::Running, Stage::Lost, Stage::Ended][usize::from(self.stage.load(Ordering::Acquire))]
    }

    fn set_stage(&self, stage: Stage) {
        self.beat(Instant::now());
        self.stage.store(stage as u8, Ordering::Release);
    }

    fn beat(&self, now: Instant) {
        self.beat.store(now.saturating_duration_since(self.epoch).as_nanos() as u64, Ordering::Release);
    }

    /// How long the thread has been in one call of the driver or of the system.
    pub fn silence(&self) -> Duration {
        self.epoch.elapsed().saturating_sub(Duration::from_nanos(self.beat.load(Ordering::Acquire)))
    }

    fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::Acquire)
    }
}

/// What comes of the first opening.
pub(super) enum Opened {
    Ready,
    /// It may come later.
    Later(String),
    /// It is of no use; the thread has ended.
    Refused(String),
}

/// How loops keep time, and what all of them share.
#[derive(Clone)]
pub(super) struct Timing {
    pub period: Duration,
    /// Interval of each tick, s; `None`: as measured.
    pub fixed: Option<f64>,
    /// One of them has said how urgently their threads run.
    pub told_urgency: Arc<AtomicBool>,
}

/// What a device moves.
pub(super) struct Coupling {
    pub end: DeviceEnd,
    /// Initial pose of the root link's body frame.
    pub root: Isometry3<f64>,
}

pub(super) struct Worker {
    /// Place among the devices of the host.
    pub index: usize,
    pub entry: adf::InputDevice,
    pub claim: Claim,
    pub timing: Timing,
    pub controls: Arc<Controls>,
    pub shared: Arc<Shared>,
    pub log: DeviceLog,
    pub news: Sender<News>,
    pub opened: Sender<(usize, Opened)>,
    pub coupling: Receiver<Coupling>,
}

/// Why a device is no longer used.
struct Fault(String);

impl From<DeviceError> for Fault {
    fn from(error: DeviceError) -> Self {
        Self(error.to_string())
    }
}

/// Calls a driver. A panic of it becomes a fault.
fn guarded<T>(what: &str, call: impl FnOnce() -> Result<T, DeviceError>) -> Result<T, Fault> {
    match caught(call) {
        Ok(result) => result.map_err(Fault::from),
        Err(panic) => Err(Fault(format!("its driver panicked in `{what}`: {panic}"))),
    }
}

/// An open device. It is closed once, however that ends.
struct Open(Option<Box<dyn InputDevice>>);

impl Open {
    fn device(&mut self) -> &mut dyn InputDevice {
        self.0.as_mut().expect("it is taken only when it is closed").as_mut()
    }

    fn read(&mut self) -> Result<DeviceSample, Fault> {
        let device = self.device();
        guarded("read", || device.read())
    }

    fn write(&mut self, force: &DeviceForce) -> Result<(), Fault> {
        let device = self.device();
        guarded("write", || device.write(force))
    }

    /// Lets go of the device.
    fn close(self) {}
}

impl Drop for Open {
    fn drop(&mut self) {
        if let Some(mut device) = self.0.take() {
            // A driver that panics while it closes has nothing more to lose; nor has one that panics when it is
            // dropped.
            let _ = caught(|| device.close());
            let _ = caught(|| drop(device));
        }
    }
}

impl Worker {
    /// Body of the thread.
    pub fn run(self) {
        let shared = Arc::clone(&self.shared);
        // What goes wrong here is a bug of the host: the device is closed by its own `drop`, others run on.
        let outcome = catch_unwind(AssertUnwindSafe(|| self.work()));
        shared.set_stage(Stage::Ended);
        if let Err(panic) = outcome {
            std::panic::resume_unwind(panic);
        }
    }

    fn work(&self) {
        let first = self.open();
        let opened = match &first {
            Ok(_) => Opened::Ready,
            Err(error @ DeviceError::Lost(_)) => Opened::Later(error.to_string()),
            Err(error) => Opened::Refused(error.to_string()),
        };
        let refused = matches!(opened, Opened::Refused(_));
        // The host waits for a while only.
        let _ = self.opened.try_send((self.index, opened));
        if refused {
            return;
        }
        let mut device = first.ok();
        let Some(coupling) = self.wait_for_coupling() else {
            return device.into_iter().for_each(|(open, _)| self.part(open));
        };
        let mut hand = Haptic::new(coupling);
        let (mut wait, mut lost_at) = (BACK_OFF[0], Instant::now());
        while !self.shared.is_stopping() {
            let Some((mut open, spec)) = device.take() else {
                if self.sleep(wait) {
                    wait = (wait * 2).min(BACK_OFF[1]);
                    device = self.open().ok();
                    if device.is_some() {
                        self.tell(DeviceEvent::Back { after: lost_at.elapsed() });
                    }
                }
                continue;
            };
            hand.begin(self, &spec);
            let begun = Instant::now();
            match self.serve(&mut open, &mut hand) {
                Ok(()) => self.part(open),
                Err(Fault(why)) => {
                    lost_at = Instant::now();
                    if begun.elapsed() > STEADY {
                        wait = BACK_OFF[0];
                    }
                    self.shared.set_stage(Stage::Lost);
                    hand.let_go(self);
                    self.tell(DeviceEvent::Lost { why });
                    open.close();
                }
            }
        }
    }

    fn tell(&self, event: DeviceEvent) {
        // Nobody reads: the event is dropped.
        let _ = self.news.try_send(News { device: self.index, event });
    }

    /// Opens the device; threads that its driver starts meanwhile run as any other.
    fn open(&self) -> Result<(Open, DeviceSpec), DeviceError> {
        self.shared.set_stage(Stage::Opening);
        let Claim { driver, info, settings } = &self.claim;
        let opened = caught(|| {
            let device = driver.open(info, settings, &self.log)?;
            let spec = device.spec().clone();
            Ok((Open(Some(device)), spec))
        });
        let lost = |panic| DeviceError::Lost(format!("its driver panicked in `open`: {panic}"));
        let opened = opened.unwrap_or_else(|panic| Err(lost(panic)));
        if opened.is_err() {
            self.shared.set_stage(Stage::Lost);
        }
        opened
    }

    fn wait_for_coupling(&self) -> Option<Coupling> {
        loop {
            match self.coupling.recv_timeout(IDLE) {
                Ok(coupling) => return Some(coupling),
                Err(RecvTimeoutError::Disconnected) => return None,
                Err(RecvTimeoutError::Timeout) if self.shared.is_stopping() => return None,
                Err(RecvTimeoutError::Timeout) => self.shared.beat(Instant::now()),
            }
        }
    }

    /// False when the thread should end instead.
    fn sleep(&self, time: Duration) -> bool {
        let begin = Instant::now();
        while begin.elapsed() < time {
            if self.shared.is_stopping() {
                return false;
            }
            self.shared.beat(Instant::now());
            std::thread::sleep(IDLE);
        }
        true
    }

    /// Ticks until the thread should end.
    fn serve(&self, open: &mut Open, hand: &mut Haptic) -> Result<(), Fault> {
        // A tick that comes too late for the next one is not caught up: the hand has moved on.
        let mut pacer = Pacer::new(self.timing.period, 0);
        let outcome = pacer.be_urgent();
        if !self.timing.told_urgency.swap(true, Ordering::Relaxed) {
            self.tell(DeviceEvent::Urgency(outcome));
        }
        self.shared.set_stage(Stage::Running);
        let outcome = loop {
            if self.shared.is_stopping() {
                break Ok(());
            }
            if let Err(fault) = hand.tick(self, open) {
                // At once, not with the watchdog of a device that gets nothing more.
                let _ = open.write(&DeviceForce::zero());
                break Err(fault);
            }
            pacer.wait();
        };
        pacer.be_normal();
        hand.loops.interrupt(&self.shared.loops);
        hand.samples.interrupt(&self.shared.samples);
        outcome
    }

    /// Leaves a device that works: its last force is none.
    fn part(&self, mut open: Open) {
        let _ = open.write(&DeviceForce::zero());
        open.close();
    }
}

/// What a device's thread remembers from tick to tick, also while the device is away.
struct Haptic {
    coupling: Coupling,
    law: Option<HapticLoop>,
    followed: Followed,
    cameras: CameraSum,
    /// When the last sample was read; `None`: none was since the device was opened.
    last: Option<Instant>,
    physics_start: Option<Instant>,
    resets: u64,
    sequence: Option<u64>,
    loops: Counter,
    samples: Counter,
}

impl Haptic {
    fn new(coupling: Coupling) -> Self {
        Self {
            coupling,
            law: None,
            followed: Followed::default(),
            cameras: CameraSum::default(),
            last: None,
            physics_start: None,
            resets: 0,
            sequence: None,
            loops: Counter::new(),
            samples: Counter::new(),
        }
    }

    /// The device is there, for the first time or again.
    fn begin(&mut self, worker: &Worker, spec: &DeviceSpec) {
        let root = self.coupling.root;
        self.law.get_or_insert_with(|| HapticLoop::new(&worker.entry, spec, root));
        self.last = None;
        self.sequence = None;
    }

    /// One tick: read, compute, feel.
    fn tick(&mut self, worker: &Worker, open: &mut Open) -> Result<(), Fault> {
        let shared = &*worker.shared;
        let begin = Instant::now();
        shared.beat(begin);
        let mut sample = open.read()?;
        let now = Instant::now();
        shared.beat(now);
        if !sample.is_finite() {
            return Err(Fault("it sent a value that is not finite".into()));
        }
        // After a gap the hand may be anywhere: the reference goes on from where it is, and forces rise from zero.
        let interval = self.last.replace(now).map(|last| now.saturating_duration_since(last));
        sample.valid &= interval.is_some_and(|interval| interval <= STALE);
        let interval = interval.unwrap_or(worker.timing.period);
        let output = self.compute(worker, sample, now, interval);
        let force = if output.force.is_finite() { output.force } else { DeviceForce::zero() };
        open.write(&force)?;
        shared.keep_force(&force);
        shared.beat(Instant::now());
        self.loops.count(&shared.loops, begin);
        if self.sequence.replace(sample.sequence) != Some(sample.sequence) {
            self.samples.count(&shared.samples, now);
        }
        Ok(())
    }

    fn compute(&mut self, worker: &Worker, sample: DeviceSample, now: Instant, interval: Duration) -> HapticOutput {
        let state = *self.coupling.end.state.read();
        let started = state.stamp.is_some();
        if started {
            self.physics_start.get_or_insert(now);
        }
        let law = self.law.as_mut().expect("it is made when the device is opened");
        let switches = worker.controls.switches();
        let mut changed = None;
        self.followed.catch_up(&worker.controls, |change| changed = law.change(change).map(|value| (change, value)));
        let output = law.tick(&HapticInput {
            sample,
            view: WorldView {
                root: (started && state.is_there).then_some(state.pose),
                camera: state.camera,
                paused: state.paused,
                stale: state.stamp.is_none_or(|stamp| now.saturating_duration_since(stamp) > STALE),
                reset: std::mem::replace(&mut self.resets, state.resets) != state.resets,
            },
            time: self.physics_start.map_or(0.0, |start| now.saturating_duration_since(start).as_secs_f64()),
            dt: worker.timing.fixed.unwrap_or(interval.as_secs_f64()),
            switches,
        });
        if output.mode_steps != 0 {
            let mode = worker.controls.step_mode(output.mode_steps);
            worker.tell(DeviceEvent::Mode(mode));
        }
        if let Some(change) = output.gain {
            worker.controls.change(change);
        }
        if let Some((change, value)) = changed {
            worker.tell(DeviceEvent::Gain(change.quantity, value));
        }
        if let Some(motion) = &output.camera {
            self.cameras.add(motion);
        }
        self.coupling.end.hand.write(Hand {
            reference: output.reference,
            gripper: output.gripper,
            cameras: self.cameras,
        });
        output
    }

    /// The device is away: its end-effector stays where it is.
    fn let_go(&mut self, worker: &Worker) {
        let now = Instant::now();
        self.compute(worker, DeviceSample::none(now), now, worker.timing.period);
        self.last = None;
    }
}
