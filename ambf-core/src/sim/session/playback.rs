//! A recording on its way to a simulation that runs in real time.
//!
//! A thread reads it, and the models that are added in it, at the [`Feed`]; the physics thread follows it, at the
//! [`Playback`], without waiting for a disk. What was followed goes back, so that memory is freed where it was taken.

use std::collections::VecDeque;
use std::sync::{Arc, OnceLock};

use rtrb::{Consumer, Producer, RingBuffer};

use super::replay::{prepared, Prepared};
use super::{Entry, ReplayError, Replayed, Replayer};
use crate::sim::{LostState, Simulation};

/// Entries that are read ahead: some tenths of a second of two arms at 1 kHz.
const AHEAD: usize = 4096;
/// Bytes of entries, as [`Entry::write`] writes them, from which on no more are read ahead: lists of joints and of voxels may
/// be long.
pub const AHEAD_BYTES: usize = 64 << 20;

/// An entry, and what was read for it.
struct Ahead {
    entry: Entry<'static>,
    prepared: Option<Box<Prepared>>,
}

/// The reader's end. Dropping it ends the recording.
pub struct Feed {
    /// Bytes of each entry that is under way, and whether a model was read for it, in order.
    sizes: VecDeque<(usize, bool)>,
    /// Bytes of all of them.
    bytes: usize,
    /// Whether a model is under way.
    has_model: bool,
    /// An entry that is measured.
    written: Vec<u8>,
    entries: Producer<Ahead>,
    used: Consumer<Entry<'static>>,
    problem: Arc<OnceLock<String>>,
}

/// The physics thread's end.
pub struct Playback {
    entries: Consumer<Ahead>,
    used: Producer<Entry<'static>>,
    problem: Arc<OnceLock<String>>,
    replayer: Replayer,
    /// Simulated time that has passed since the update before, s.
    passed: f64,
}

/// Both ends, of a recording whose beginning `replayer` has followed.
pub fn playback(replayer: Replayer) -> (Feed, Playback) {
    let (producer, consumer) = RingBuffer::new(AHEAD);
    // Room for all that can be under way.
    let (giver, taker) = RingBuffer::new(AHEAD + 1);
    let problem = Arc::new(OnceLock::new());
    let feed = Feed {
        sizes: VecDeque::new(),
        bytes: 0,
        has_model: false,
        written: Vec::new(),
        entries: producer,
        used: taker,
        problem: Arc::clone(&problem),
    };
    (feed, Playback { entries: consumer, used: giver, problem, replayer, passed: 0.0 })
}

impl Feed {
    /// Hands the next entry over; gives it back while there is no room for it. Reads the files of a model that is added, when
    /// the one before was added: meshes are large.
    pub fn push(&mut self, entry: Entry<'static>) -> Option<Entry<'static>> {
        // They come back in the order in which they went.
        while self.used.pop().is_ok() {
            let (bytes, is_model) = self.sizes.pop_front().unwrap_or((0, false));
            self.bytes -= bytes;
            self.has_model &= !is_model;
        }
        let is_model = matches!(entry, Entry::AddModel { .. });
        if self.bytes >= AHEAD_BYTES || self.entries.is_full() || (is_model && self.has_model) {
            return Some(entry);
        }
        self.written.clear();
        entry.write(&mut self.written);
        self.sizes.push_back((self.written.len(), is_model));
        self.bytes += self.written.len();
        self.has_model |= is_model;
        let prepared = prepared(&entry);
        match self.entries.push(Ahead { entry, prepared }) {
            Ok(()) => None,
            Err(rtrb::PushError::Full(Ahead { entry, .. })) => Some(entry),
        }
    }

    /// Whether nobody follows any more.
    pub fn is_abandoned(&self) -> bool {
        self.entries.is_abandoned()
    }

    /// Ends the recording early, and says why.
    pub fn fail(self, why: String) {
        let _ = self.problem.set(why);
    }
}

/// What was followed.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::sim) enum Played {
    /// An update, by which simulated time has passed, s, with what was lost before it.
    Update(f64),
    /// An update, in which the state was lost, as it was when this was recorded.
    Lost(LostState),
    /// A reset, or another change that is to be seen before the next update.
    Change,
    /// Nothing: the reader is not as fast.
    Waits,
    /// The recording is over.
    End,
}

impl Playback {
    /// Follows the recording up to and with the next update, or up to a change that is to be seen before.
    ///
    /// # Errors
    /// [`ReplayError`]; the replay cannot go on.
    pub(in crate::sim) fn update(&mut self, simulation: &mut Simulation) -> Result<Played, ReplayError> {
        loop {
            // Looked at first, so that nothing comes after what is taken now.
            let is_last = self.entries.is_abandoned();
            let Ok(Ahead { entry, prepared }) = self.entries.pop() else {
                return Ok(if is_last { Played::End } else { Played::Waits });
            };
            match entry {
                Entry::Update { interval, .. } => self.passed += interval,
                Entry::LoseTime { seconds } => self.passed += seconds,
                _ => (),
            }
            let replayed = self.replayer.apply_prepared(simulation, &entry, prepared);
            let is_change = is_change(&entry);
            self.give_back(entry);
            match replayed? {
                Replayed::Update => return Ok(Played::Update(std::mem::take(&mut self.passed))),
                Replayed::Lost(lost) => {
                    self.passed = 0.0;
                    return Ok(Played::Lost(lost));
                }
                Replayed::Note(text) => simulation.notices.push(format!("noted: {text}")),
                _ if is_change => return Ok(Played::Change),
                _ => (),
            }
        }
    }

    /// Follows the recording from an update to where its state was published: hash and commands.
    ///
    /// # Errors
    /// [`ReplayError`]; the replay cannot go on.
    pub(in crate::sim) fn exchange(&mut self, simulation: &mut Simulation) -> Result<(), ReplayError> {
        while self.entries.peek().is_ok_and(|ahead| is_command(&ahead.entry)) {
            let Ok(Ahead { entry, prepared }) = self.entries.pop() else { break };
            let replayed = self.replayer.apply_prepared(simulation, &entry, prepared);
            self.give_back(entry);
            replayed?;
        }
        Ok(())
    }

    /// Why the recording ended early, if it did.
    pub(in crate::sim) fn problem(&self) -> Option<String> {
        self.problem.get().cloned()
    }

    fn give_back(&mut self, entry: Entry<'static>) {
        // Without a reader it is freed here.
        let _ = self.used.push(entry);
    }
}

/// What changes what is seen while nothing moves.
fn is_change(entry: &Entry<'_>) -> bool {
    matches!(
        entry,
        Entry::ResetBodies {}
            | Entry::ResetWorld {}
            | Entry::Restore { .. }
            | Entry::AddModel { .. }
            | Entry::RemoveModel { .. }
            | Entry::RemoveBody { .. }
    )
}

/// What stands between an update and its publication.
fn is_command(entry: &Entry<'_>) -> bool {
    matches!(
        entry,
        Entry::Hash { .. }
            | Entry::Body { .. }
            | Entry::Joint { .. }
            | Entry::Pose { .. }
            | Entry::SoftBody { .. }
            | Entry::Actuator { .. }
            | Entry::Vehicle { .. }
            | Entry::Camera { .. }
            | Entry::Light { .. }
            | Entry::Plugin { .. }
            | Entry::Carve { .. }
            | Entry::RestoreVoxels { .. }
            | Entry::Tool { .. }
    )
}

#[cfg(test)]
mod tests {
    use std::borrow::Cow;

    use super::*;
    use crate::comm::RigidBodyCommand;

    #[test]
    fn what_is_read_ahead_is_bounded_in_bytes() {
        let (mut feed, mut playback) = playback(Replayer::new([]));
        let command = RigidBodyCommand { joint_commands: vec![0.0; 1 << 20], ..RigidBodyCommand::default() };
        let entry = || Entry::Body { body: 0, command: Cow::Owned(command.clone()) };
        let pushed = (0..AHEAD).take_while(|_| feed.push(entry()).is_none()).count();
        assert!((4..=9).contains(&pushed), "{pushed} of 8 MiB each");
        let follow = |playback: &mut Playback| {
            while let Ok(followed) = playback.entries.pop() {
                playback.give_back(followed.entry);
            }
        };
        for _ in 0..2 {
            assert!(feed.push(Entry::ResetBodies {}).is_some(), "it is full");
            follow(&mut playback);
            assert!((0..pushed).all(|_| feed.push(entry()).is_none()), "what was followed makes room");
        }
        // A single one may be as long as it is.
        follow(&mut playback);
        let command = RigidBodyCommand { joint_commands: vec![0.0; AHEAD_BYTES / 8 + 1], ..command.clone() };
        assert!(feed.push(Entry::Body { body: 0, command: Cow::Owned(command) }).is_none());
        assert!(feed.push(Entry::ResetBodies {}).is_some());
    }

    #[test]
    fn models_are_read_where_the_recording_is_read() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("m.yaml");
        std::fs::write(&file, "bodies: [BODY A]\nBODY A: {name: A, mass: 1}\n").expect("written");
        let (mut feed, mut playback) = playback(Replayer::new([]));
        let add = || Entry::AddModel { file: file.display().to_string() };
        assert!(feed.push(add()).is_none());
        std::fs::remove_file(&file).expect("it is there");
        assert!(feed.push(add()).is_some(), "one model at a time");
        assert!(feed.push(Entry::ResetBodies {}).is_none(), "what follows is read");
        let mut found = || {
            let Ahead { entry, prepared } = playback.entries.pop().expect("it was pushed");
            playback.give_back(entry);
            prepared.map(|prepared| prepared.is_ok())
        };
        assert_eq!([found(), found()], [Some(true), None]);
        assert!(feed.push(add()).is_none());
        assert_eq!(found(), Some(false));
    }
}
