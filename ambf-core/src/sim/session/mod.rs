//! Recordings: what enters a simulation, in the order in which the physics thread consumed it, so that another process
//! can make the same motion again, bit for bit.
//!
//! Whatever changes the motion passes [`Physics::note`](super::physics::Physics::note) at the place where it is done.
//! A [`Recorder`] takes it from there as bytes to the [`Tap`] of a thread that writes; a file format is not known here.
//! [`Simulation::replay`] does what an [`Entry`] says. How a motion came about does not matter to a replay: commands
//! stand in a recording when they are executed, so mailboxes, watchdogs, orders of steps, plugins and clocks need none.

mod codec;
mod entry;
mod hash;
mod playback;
mod recorder;
mod replay;

pub use codec::CodeError;
pub use entry::Entry;
pub(super) use playback::Played;
pub use playback::{playback, Feed, Playback, AHEAD_BYTES};
pub use recorder::{recorder, EarlyEnd, Recorder, Tap, Unpacker, HASH_INTERVAL};
pub use replay::{ReplayError, Replayed, Replayer};

use std::borrow::Cow;
use std::path::Path;

use thiserror::Error;

use super::Simulation;

/// A path as recordings name it: absolute.
pub(super) fn recorded_path(path: &Path) -> String {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned()).display().to_string()
}

/// Error when a recording cannot begin now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum StartError {
    /// Error when the simulation has moved or was commanded since its start or last reset.
    #[error("a recording begins at the start or directly after a reset of the world, before anything is commanded")]
    Moved,
    /// Error when something was changed that a reset keeps: models, bodies, parameters, gravity, gains of input devices, what
    /// plugins did while they began.
    #[error("models, bodies, parameters or gains of input devices were changed since the start, or plugins began, which a reset does not undo: begin the recording before that")]
    Changed,
    /// Error when it is recorded already.
    #[error("the simulation is recorded already")]
    Recorded,
    /// Error when a recording is replayed, which is recorded from its beginning or not at all.
    #[error("a recording is replayed: begin a recording of that with the program, or after it is over, with a reset of the world")]
    Replaying,
    /// Error when the physics thread does not answer in time, because it has ended or is held up.
    #[error("the simulation does not answer")]
    NoAnswer,
}

/// What happened since the start or the last reset of the world.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SinceStart {
    updates: u64,
    /// Something that a reset undoes.
    moved: bool,
    /// Something that a reset keeps.
    changed: bool,
}

impl SinceStart {
    pub fn note(&mut self, entry: &Entry<'_>) {
        match entry {
            Entry::Update { .. } => self.updates += 1,
            Entry::ResetWorld {} => *self = Self { changed: self.changed, ..Self::default() },
            Entry::AddModel { .. }
            | Entry::RemoveModel { .. }
            | Entry::RemoveBody { .. }
            | Entry::Parameters { .. }
            | Entry::Camera { .. }
            | Entry::Light { .. }
            | Entry::Gravity { .. }
            | Entry::Gain { .. }
            // What plugins do while they begin is done again in a reset.
            | Entry::Plugin { begins: true, .. } => self.changed = true,
            Entry::Again {}
            | Entry::LoseTime { .. }
            | Entry::Hash { .. }
            | Entry::Start { .. }
            | Entry::Device { .. }
            | Entry::Period { .. }
            // A recording begins with the tools that there are.
            | Entry::NewTool { .. }
            | Entry::Note { .. } => (),
            _ => self.moved = true,
        }
    }

    /// A state was restored: the start is known by its resets alone.
    pub fn note_restored(&mut self) {
        self.moved = true;
    }
}

impl Simulation {
    /// Records everything from now on through `recorder`: at the start, or directly after a reset of the world. An
    /// update that was made since, as a [`Stepper`](super::Stepper) makes one when it is made or reset, is part of it.
    ///
    /// # Errors
    /// [`StartError`]; nothing is recorded then.
    pub fn start_recording(&mut self, mut recorder: Recorder) -> Result<(), StartError> {
        self.check_recordable()?;
        if !self.is_at_start() {
            return Err(StartError::Moved);
        }
        let physics = &self.physics;
        let since = physics.since_start;
        recorder.grow(&physics.scene);
        let start = if since.updates == 0 { physics.time } else { physics.time_before };
        recorder.note(&Entry::Start {
            iteration: start.iteration,
            sim_time: start.sim_time,
            lost_time: start.lost_time,
            attachments: self.plugin_state.next_attachment,
        });
        for (id, tool) in physics.scene.added_tools() {
            recorder.note(&Entry::NewTool { volume: id.index(), tool: Cow::Borrowed(tool) });
        }
        self.note_devices(&mut recorder);
        if since.updates > 0 {
            let time = self.physics.time;
            recorder.note(&Entry::Update { iteration: time.iteration, interval: time.interval });
        }
        self.physics.recorder = Some(Box::new(recorder));
        Ok(())
    }

    /// Whether a recording can begin now, or after the next reset of the world.
    ///
    /// # Errors
    /// [`StartError`], but [`StartError::Moved`].
    pub(super) fn check_recordable(&self) -> Result<(), StartError> {
        match &self.physics {
            physics if physics.recorder.is_some() => Err(StartError::Recorded),
            physics if physics.since_start.changed => Err(StartError::Changed),
            _ => Ok(()),
        }
    }

    /// Whether it is where it began, or where a reset of the world has put it.
    pub(super) fn is_at_start(&self) -> bool {
        let since = self.physics.since_start;
        !since.moved && since.updates <= 1
    }

    /// A number that tells states apart: FNV-1a over the numbers of poses and velocities of all bodies, coordinates of
    /// joints and nodes of soft bodies, as recordings hold it.
    pub fn state_hash(&self) -> u64 {
        let mut hash = hash::StateHash::default();
        hash.grow(&self.physics.scene);
        hash.of(&self.physics.scene)
    }

    /// Records no more; whether it was recorded.
    pub fn stop_recording(&mut self) -> bool {
        self.physics.recorder.take().is_some()
    }

    /// Whether it is recorded, or was until the recording ended by itself.
    pub fn is_recorded(&self) -> bool {
        self.physics.recorder.is_some()
    }

    /// Puts a note into the recording, such as the name of a stage; nothing if there is none.
    pub fn annotate(&mut self, text: &str) {
        self.physics.note(&Entry::Note { text: text.to_owned() });
    }
}
