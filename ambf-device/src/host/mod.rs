//! Runs devices: each in a thread of its own, which nothing that another device or the physics does can hold up.
//!
//! A thread reads its device, computes the reference pose for the end-effector and the force for the hand
//! ([`law`](super::law)), and writes the force, about a thousand times a second. A driver that fails, panics or sends
//! what is not finite is closed and opened again after a while; meanwhile its end-effector stays where it is. With the
//! physics thread it exchanges the newest values through slots that never wait.

mod claim;
mod exchange;
mod rates;
mod worker;

pub use claim::{find_devices, presence_of};
pub use exchange::{quantity, BodyState, CameraSum, Controls, Followed, Hand, PhysicsEnd, StandIn};
pub use rates::Rate;

use std::fmt;
use std::sync::atomic::Ordering;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{bounded, Receiver, Sender};
use nalgebra::Isometry3;

use super::law::{Mode, Quantity, Switches};
use super::{DeviceForce, DeviceLog, Drivers};
use ambf_model::adf;
use claim::{claim, Claim};
use exchange::{couple, STALE};
use worker::{Coupling, Opened, Shared, Stage, Timing, Worker};

/// Ticks a second, see [`HostOptions::frequency`].
const FREQUENCY: (f64, f64) = (50.0, 10_000.0);
/// How long the start waits for devices to open; what takes longer comes later.
const OPEN_TIMEOUT: Duration = Duration::from_secs(5);
/// How long the end waits for drivers; what takes longer is abandoned.
const STOP_TIMEOUT: Duration = Duration::from_secs(2);
/// News that may wait; more are dropped: the log is not worth a stalled device.
const NEWS: usize = 256;

/// How devices run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HostOptions {
    /// Ticks a second of each device, 50…10000: what is beyond counts as the bound. Default: 1000.
    pub frequency: f64,
    /// Every interval counts as `speed_factor / frequency` instead of what the clock says. Default: `false`.
    pub fixed_step: bool,
    /// Simulated per real time with fixed steps. Default: 1.
    pub speed_factor: f64,
    /// Switches at the start.
    pub switches: Switches,
}

impl Default for HostOptions {
    fn default() -> Self {
        Self { frequency: 1000.0, fixed_step: false, speed_factor: 1.0, switches: Switches::default() }
    }
}

/// What a device does at present.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeviceState {
    /// It is being opened.
    Opening,
    /// It runs.
    Running,
    /// Its driver has not returned from a call for more than 50 ms: its end-effector stays where it is.
    Stalled,
    /// It is away: it will be opened again.
    Lost,
    /// Its thread has ended.
    Closed,
}

/// A device of a host as it is now.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceStatus {
    /// Name of its entry.
    pub name: String,
    /// Model name.
    pub model: String,
    /// Which one of several.
    pub identity: String,
    /// Names of the cameras that it is paired with, as its entry says; empty: all.
    pub cameras: Vec<String>,
    /// What it does.
    pub state: DeviceState,
    /// Ticks of its thread.
    pub loops: Rate,
    /// Measurements of the device: never more than ticks.
    pub samples: Rate,
    /// The last force and torque written to it, N and N·m; nothing unless it runs.
    pub force: DeviceForce,
}

impl fmt::Display for DeviceStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, model, loops, samples, .. } = self;
        write!(f, "{name} [{model}]: {loops}; samples {:.0} Hz", samples.mean)
    }
}

/// Something that happened to a device and is worth a line in the log.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum DeviceEvent {
    /// It was closed and will be opened again.
    Lost {
        /// What went wrong.
        why: String,
    },
    /// It was opened again.
    Back {
        /// How long it was away.
        after: Duration,
    },
    /// Its driver does not return from a call.
    Stalled,
    /// Its driver has returned.
    Resumed,
    /// Whether the system runs the threads of devices before all others (`SCHED_FIFO`), or why not; said by one of
    /// them.
    Urgency(Result<(), String>),
    /// Its buttons have changed the mode of all devices.
    Mode(Mode),
    /// A gain of its force feedback has a new value.
    Gain(Quantity, f64),
    /// Its driver has something to say.
    Said(String),
}

/// An event and the place of its device in [`DeviceHost::status`].
#[derive(Debug, Clone, PartialEq)]
pub struct News {
    /// Place of the device.
    pub device: usize,
    /// What happened.
    pub event: DeviceEvent,
}

/// A device that was claimed.
struct Unit {
    entry: adf::InputDevice,
    claim: Claim,
    shared: Arc<Shared>,
    said: Receiver<String>,
    coupling: Option<Sender<Coupling>>,
    thread: Option<JoinHandle<()>>,
    was_stalled: bool,
    /// It is of no use, or has nothing to move.
    is_left_out: bool,
}

impl Unit {
    /// Ends its thread.
    fn leave_out(&mut self) {
        self.coupling = None;
        self.is_left_out = true;
    }

    fn is_stalled(&self) -> bool {
        self.shared.stage() == Stage::Running && self.shared.silence() > STALE
    }

    fn state(&self) -> DeviceState {
        match self.shared.stage() {
            _ if self.is_left_out => DeviceState::Closed,
            Stage::Opening => DeviceState::Opening,
            Stage::Running if self.is_stalled() => DeviceState::Stalled,
            Stage::Running => DeviceState::Running,
            Stage::Lost => DeviceState::Lost,
            Stage::Ended => DeviceState::Closed,
        }
    }

    fn status(&self) -> DeviceStatus {
        DeviceStatus {
            name: self.entry.identifier.clone(),
            model: self.claim.info.model.clone(),
            identity: self.claim.info.identity.clone(),
            cameras: self.entry.pair_cameras.clone(),
            state: self.state(),
            loops: self.shared.loops.read(),
            samples: self.shared.samples.read(),
            force: self.shared.force(),
        }
    }
}

/// The devices of a program, each in its thread. Dropping it ends them as [`stop`](Self::stop) does.
pub struct DeviceHost {
    units: Vec<Unit>,
    controls: Arc<Controls>,
    news: Receiver<News>,
}

impl DeviceHost {
    /// Finds and opens a device for each entry: the first of its model that no entry before it has. Devices that no
    /// entry claims are never opened. What could not be opened is left out, with one sentence each; others go on. A
    /// device that is there but does not answer is taken and may come later.
    ///
    /// Their threads do nothing until `Simulation::add_devices` of ambf-core gives them something to move.
    pub fn open(entries: &[&adf::InputDevice], drivers: &Drivers, options: &HostOptions) -> (Self, Vec<String>) {
        let mut problems = Vec::new();
        let mut claimed: Vec<Claim> = Vec::new();
        let mut claims = Vec::new();
        for &entry in entries {
            match claim(entry, drivers, &claimed) {
                Ok(claim) => {
                    claimed.push(claim.clone());
                    claims.push((entry.clone(), claim));
                }
                Err(why) => problems.push(left_out(entry, &why)),
            }
        }
        let controls = Arc::new(Controls::new(options.switches));
        let (news_sender, news) = bounded(NEWS);
        let (opened_sender, opened) = bounded(claims.len());
        // No force may end before the next tick, and no number may be none.
        let frequency = options.frequency.max(FREQUENCY.0).min(FREQUENCY.1);
        let timing = Timing {
            period: Duration::from_secs_f64(1.0 / frequency),
            fixed: options.fixed_step.then(|| options.speed_factor / frequency),
            told_urgency: Arc::default(),
        };
        let mut host = Self { units: Vec::new(), controls, news };
        for (entry, claim) in claims {
            host.spawn(entry, claim, &timing, &news_sender, &opened_sender);
        }
        host.wait_until_open(&opened, &mut problems);
        (host, problems)
    }

    fn spawn(
        &mut self,
        entry: adf::InputDevice,
        claim: Claim,
        timing: &Timing,
        news: &Sender<News>,
        opened: &Sender<(usize, Opened)>,
    ) {
        let (log, said) = DeviceLog::new();
        let (coupling_sender, coupling) = bounded(1);
        let shared = Arc::new(Shared::new());
        let index = self.units.len();
        let worker = Worker {
            index,
            entry: entry.clone(),
            claim: claim.clone(),
            timing: timing.clone(),
            controls: Arc::clone(&self.controls),
            shared: Arc::clone(&shared),
            log,
            news: news.clone(),
            opened: opened.clone(),
            coupling,
        };
        let thread = std::thread::Builder::new()
            .name(format!("haptic {index}"))
            .spawn(move || worker.run())
            .expect("a thread can be started: no device runs without it");
        let coupling = Some(coupling_sender);
        let (thread, was_stalled, is_left_out) = (Some(thread), false, false);
        self.units.push(Unit { entry, claim, shared, said, coupling, thread, was_stalled, is_left_out });
    }

    fn wait_until_open(&mut self, opened: &Receiver<(usize, Opened)>, problems: &mut Vec<String>) {
        let deadline = Instant::now() + OPEN_TIMEOUT;
        let mut silent: Vec<usize> = (0..self.units.len()).collect();
        while !silent.is_empty() {
            let Ok((index, outcome)) = opened.recv_deadline(deadline) else { break };
            silent.retain(|&other| other != index);
            let unit = &mut self.units[index];
            match outcome {
                Opened::Ready => (),
                Opened::Later(why) => problems.push(format!("{}: {why}; waiting for it", unit.entry.identifier)),
                Opened::Refused(why) => {
                    problems.push(left_out(&unit.entry, &why));
                    unit.leave_out();
                }
            }
        }
        for index in silent {
            let name = &self.units[index].entry.identifier;
            let seconds = OPEN_TIMEOUT.as_secs();
            problems.push(format!("{name}: its driver has not opened it within {seconds} s; waiting for it"));
        }
    }

    /// Entries of the devices that wait for something to move, with their places.
    pub fn waiting(&self) -> Vec<(usize, adf::InputDevice)> {
        let waiting = self.units.iter().enumerate().filter(|(_, unit)| unit.coupling.is_some());
        waiting.map(|(index, unit)| (index, unit.entry.clone())).collect()
    }

    /// Lets a device move a body that starts at `root` (body frame in the world).
    pub fn couple(&mut self, index: usize, root: Isometry3<f64>) -> PhysicsEnd {
        let (physics, device) = couple(root);
        if let Some(sender) = self.units[index].coupling.take() {
            // A thread that has ended needs nothing any more.
            let _ = sender.try_send(Coupling { end: device, root });
        }
        physics
    }

    /// Ends the thread of a device that has nothing to move.
    pub fn release(&mut self, index: usize) {
        self.units[index].leave_out();
    }

    /// What all devices share.
    pub fn controls(&self) -> &Arc<Controls> {
        &self.controls
    }

    /// Number of devices that were opened or are waited for.
    pub fn len(&self) -> usize {
        self.units.len()
    }

    /// Whether there is no device.
    pub fn is_empty(&self) -> bool {
        self.units.is_empty()
    }

    /// All devices, in the order of their entries.
    pub fn status(&self) -> Vec<DeviceStatus> {
        self.units.iter().map(Unit::status).collect()
    }

    /// What has happened since the last call. To be called now and then: what waits too long is dropped.
    pub fn news(&mut self) -> Vec<News> {
        let mut news = Vec::new();
        for (device, unit) in self.units.iter_mut().enumerate() {
            news.extend(unit.said.try_iter().map(|text| News { device, event: DeviceEvent::Said(text) }));
            let stalled = unit.is_stalled();
            if std::mem::replace(&mut unit.was_stalled, stalled) != stalled {
                let event = if stalled { DeviceEvent::Stalled } else { DeviceEvent::Resumed };
                // One that is lost has more to say than that it has returned.
                if stalled || unit.shared.stage() == Stage::Running {
                    news.push(News { device, event });
                }
            }
        }
        news.extend(self.news.try_iter());
        news
    }

    /// One line for the log.
    pub fn line(&self, news: &News) -> String {
        let status = self.units[news.device].status();
        let name = &status.name;
        match &news.event {
            DeviceEvent::Lost { why } => format!("{status}; lost: {why}"),
            DeviceEvent::Back { after } => format!("{status}; back after {:.1} s", after.as_secs_f64()),
            DeviceEvent::Stalled => {
                format!("{status}; its driver does not return: its end-effector stays where it is until it does")
            }
            DeviceEvent::Resumed => format!("{status}; its driver has returned"),
            DeviceEvent::Urgency(Ok(())) => "device threads go before all others (SCHED_FIFO)".into(),
            DeviceEvent::Urgency(Err(why)) => {
                format!("device threads run as any other: SCHED_FIFO is refused ({why})")
            }
            DeviceEvent::Mode(mode) => format!("mode of the device buttons: {}", mode.name()),
            DeviceEvent::Gain(quantity, value) => format!("{name}: {} = {value:.4}", quantity.label()),
            DeviceEvent::Said(text) => format!("{name}: {text}"),
        }
    }

    /// Ends all threads: no force, then closed. One whose driver does not return within 2 s is abandoned. Returns a
    /// line with its rates for each device.
    pub fn stop(mut self) -> Vec<String> {
        self.end()
    }

    fn end(&mut self) -> Vec<String> {
        for unit in &mut self.units {
            unit.shared.stop.store(true, Ordering::Release);
            unit.coupling = None;
        }
        let deadline = Instant::now() + STOP_TIMEOUT;
        let mut lines = Vec::new();
        for unit in &mut self.units {
            let Some(thread) = unit.thread.take() else { continue };
            while !thread.is_finished() && Instant::now() < deadline {
                std::thread::sleep(Duration::from_millis(1));
            }
            let status = unit.status();
            if !thread.is_finished() {
                let seconds = STOP_TIMEOUT.as_secs();
                lines.push(format!("{status}; its driver has not returned within {seconds} s and is abandoned"));
            } else if thread.join().is_err() {
                lines.push(format!("{status}; its thread panicked, which is a bug"));
            } else if !unit.is_left_out {
                lines.push(status.to_string());
            }
        }
        lines
    }
}

impl Drop for DeviceHost {
    fn drop(&mut self) {
        self.end();
    }
}

fn left_out(entry: &adf::InputDevice, why: &str) -> String {
    format!("{}: device `{}` is left out: {why}", entry.source, entry.identifier)
}
