//! What plugins leave for physics, from any thread, and what they get from it.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU8, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use crossbeam_channel::{bounded, Receiver, Sender};
use parking_lot::Mutex;

use super::asked::Asked;
use super::drawing::{check, Sheet};
use super::traits::Services;
use super::{Command, CommandError, Drawing, Drawings, StateSnapshot};
use crate::snapshot::{SnapshotSlot, SnapshotWriter};

/// Lines that may wait for the log.
const LINES: usize = 256;
/// Commands that may wait for the next step.
const COMMANDS: usize = 4096;

/// Requests that the loop around the simulation looks at.
#[derive(Default)]
pub struct Requests {
    /// A plugin wants the world to be reset.
    pub reset_world: Asked,
    /// A plugin wants all rigid bodies to be reset.
    pub reset_bodies: AtomicBool,
    /// 0 nothing, 1 pause, 2 resume.
    pause: AtomicU8,
    steps: AtomicU32,
}

impl Requests {
    /// Takes the newest request to pause (`true`) or to resume.
    pub fn take_pause(&self) -> Option<bool> {
        match self.pause.load(Ordering::Relaxed) {
            0 => None,
            _ => match self.pause.swap(0, Ordering::AcqRel) {
                0 => None,
                wanted => Some(wanted == 1),
            },
        }
    }

    /// Takes the number of steps that plugins want while the simulation is paused.
    pub fn take_steps(&self) -> u32 {
        match self.steps.load(Ordering::Relaxed) {
            0 => 0,
            _ => self.steps.swap(0, Ordering::AcqRel),
        }
    }

    /// Keeps a request; `false` if the command is none.
    pub fn keep(&self, command: &Command) -> bool {
        match *command {
            Command::ResetWorld => self.reset_world.ask(),
            Command::ResetBodies => self.reset_bodies.store(true, Ordering::Release),
            Command::Pause(pause) => self.pause.store(if pause { 1 } else { 2 }, Ordering::Release),
            Command::Step(steps) => {
                self.steps.fetch_add(steps, Ordering::AcqRel);
            }
            _ => return false,
        }
        true
    }
}

/// Commands, the numbers of the plugins that left them, and when.
type Posted = (Sender<(u64, Instant, Command)>, Receiver<(u64, Instant, Command)>);

/// What all plugins of a simulation share.
pub struct Shared {
    /// 8 kB, taken as `commands`.
    lines: OnceLock<(Sender<String>, Receiver<String>)>,
    /// 430 kB, taken when the first plugin is loaded: most of the hundreds of worlds that learners have are without any.
    commands: OnceLock<Posted>,
    /// Requests to the loop around the simulation.
    pub requests: Requests,
    snapshots: SnapshotSlot<StateSnapshot>,
    /// Somebody reads snapshots.
    wanted: AtomicBool,
    /// What plugins show in windows.
    pub drawings: Drawings,
}

/// Physics' end of [`Shared`].
pub struct Incoming {
    writer: SnapshotWriter<StateSnapshot>,
}

impl Shared {
    /// Both ends; what plugins draw goes into `drawings`.
    pub fn new(drawings: Drawings) -> (Arc<Self>, Incoming) {
        let shared = Self {
            lines: OnceLock::new(),
            commands: OnceLock::new(),
            requests: Requests::default(),
            snapshots: SnapshotSlot::empty(),
            wanted: AtomicBool::new(false),
            drawings,
        };
        let writer = SnapshotWriter::new(StateSnapshot::default());
        (Arc::new(shared), Incoming { writer })
    }

    fn commands(&self) -> &Posted {
        self.commands.get_or_init(|| bounded(COMMANDS))
    }

    fn lines(&self) -> &(Sender<String>, Receiver<String>) {
        self.lines.get_or_init(|| bounded(LINES))
    }

    /// Lines for the log that wait now, oldest first.
    pub fn said(&self) -> impl Iterator<Item = String> + '_ {
        self.lines.get().into_iter().flat_map(|(_, said)| said.try_iter())
    }

    /// Commands that wait now, oldest first, with the numbers of the plugins that left them and the times: a plugin that
    /// posts without end holds nothing up.
    pub fn posted(&self) -> impl Iterator<Item = (u64, Instant, Command)> + '_ {
        self.commands.get().into_iter().flat_map(|(_, posted)| posted.try_iter().take(posted.len()))
    }
}

impl Incoming {
    /// Physics thread: publishes states if somebody reads them.
    pub fn publish(&mut self, shared: &Shared, fill: impl FnOnce(&mut StateSnapshot)) {
        if shared.wanted.load(Ordering::Acquire) {
            // Readers that hold every spare snapshot miss this one.
            let _ = self.writer.publish(&shared.snapshots, fill);
        }
    }
}

/// What one plugin reaches the host by.
pub(crate) struct Desk {
    handle: String,
    number: u64,
    shared: Arc<Shared>,
    /// What a library said about its latest failure.
    failure: Mutex<String>,
    sheet: Sheet,
}

impl Desk {
    pub fn new(handle: &str, number: u64, shared: Arc<Shared>) -> Self {
        let sheet = shared.drawings.open(number);
        // Now, so that a plugin that says or commands something in a step takes no memory for it.
        shared.commands();
        shared.lines();
        Self { handle: handle.to_owned(), number, shared, failure: Mutex::default(), sheet }
    }

    pub fn fail(&self, text: String) {
        *self.failure.lock() = text;
    }

    pub fn take_failure(&self) -> String {
        std::mem::take(&mut self.failure.lock())
    }
}

impl Services for Desk {
    fn say(&self, text: &str) {
        // A full log is no reason to wait.
        let _ = self.shared.lines().0.try_send(format!("plugin {}: {text}", self.handle));
    }

    fn post(&self, command: &Command) -> Result<(), CommandError> {
        if !command.is_finite() {
            return Err(CommandError::NotFinite);
        }
        if self.shared.requests.keep(command) {
            return Ok(());
        }
        self.shared.commands().0.try_send((self.number, Instant::now(), *command)).map_err(|_| CommandError::Full)
    }

    fn snapshot(&self, out: &mut StateSnapshot) -> bool {
        self.shared.wanted.store(true, Ordering::Release);
        let Some(newest) = self.shared.snapshots.load_full() else { return false };
        out.clone_from(&newest);
        true
    }

    fn show(&self, drawings: &[Drawing]) -> Result<(), CommandError> {
        check(drawings)?;
        self.sheet.store(Arc::new(drawings.to_vec()));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn commands_wait_and_requests_are_kept_apart() {
        let (shared, _incoming) = Shared::new(Drawings::default());
        assert!(shared.posted().next().is_none() && shared.said().next().is_none());
        assert!(shared.commands.get().is_none() && shared.lines.get().is_none(), "without plugins there are no queues");
        let desk = Desk::new("p", 7, Arc::clone(&shared));
        assert!(shared.commands.get().is_some() && shared.lines.get().is_some());
        let wrench = Command::Wrench { body: 0, force: Vector3::x(), torque: Vector3::zeros() };
        for command in [Command::ResetWorld, Command::Pause(true), Command::Step(3), Command::Step(4), wrench] {
            desk.post(&command).unwrap();
        }
        let nan = Command::Wrench { body: 0, force: Vector3::repeat(f64::NAN), torque: Vector3::zeros() };
        assert_eq!(desk.post(&nan), Err(CommandError::NotFinite));
        assert_eq!(shared.posted().map(|(plugin, _, command)| (plugin, command)).collect::<Vec<_>>(), [(7, wrench)]);
        let requests = &shared.requests;
        assert!(requests.reset_world.take().is_some() && !requests.reset_bodies.load(Ordering::Relaxed));
        assert_eq!((requests.take_pause(), requests.take_steps()), (Some(true), 7));
        assert_eq!((requests.take_pause(), requests.take_steps()), (None, 0));
        for _ in 0..COMMANDS {
            desk.post(&wrench).unwrap();
        }
        assert_eq!(desk.post(&wrench), Err(CommandError::Full));
    }

    #[test]
    fn snapshots_are_made_for_readers_only() {
        let (shared, mut incoming) = Shared::new(Drawings::default());
        let desk = Desk::new("p", 0, Arc::clone(&shared));
        incoming.publish(&shared, |_| panic!("nobody reads"));
        let mut out = StateSnapshot::default();
        assert!(!desk.snapshot(&mut out));
        incoming.publish(&shared, |snapshot| snapshot.clock.step = 5);
        assert!(desk.snapshot(&mut out));
        assert_eq!(out.clock.step, 5);
    }
}
