//! A recording on its way to a simulation that runs in real time.
//!
//! A thread reads it, at the [`Feed`]; the physics thread follows it, at the [`Playback`], without waiting for a disk. What
//! was followed goes back, so that memory is freed where it was taken.

use std::sync::{Arc, OnceLock};

use rtrb::{Consumer, Producer, RingBuffer};

use super::{Entry, ReplayError, Replayed, Replayer};
use crate::sim::{LostState, Simulation};

/// Entries that are read ahead: some tenths of a second of two arms at 1 kHz.
const AHEAD: usize = 4096;

/// The reader's end. Dropping it ends the recording.
pub struct Feed {
    entries: Producer<Entry<'static>>,
    used: Consumer<Entry<'static>>,
    problem: Arc<OnceLock<String>>,
}

/// The physics thread's end.
pub struct Playback {
    entries: Consumer<Entry<'static>>,
    used: Producer<Entry<'static>>,
    problem: Arc<OnceLock<String>>,
    replayer: Replayer,
}

/// Both ends, of a recording whose beginning `replayer` has followed.
pub fn playback(replayer: Replayer) -> (Feed, Playback) {
    let (producer, consumer) = RingBuffer::new(AHEAD);
    // Room for all that can be under way.
    let (giver, taker) = RingBuffer::new(AHEAD + 1);
    let problem = Arc::new(OnceLock::new());
    let feed = Feed { entries: producer, used: taker, problem: Arc::clone(&problem) };
    (feed, Playback { entries: consumer, used: giver, problem, replayer })
}

impl Feed {
    /// Hands the next entry over; gives it back while there is no room for it.
    pub fn push(&mut self, entry: Entry<'static>) -> Option<Entry<'static>> {
        while self.used.pop().is_ok() {}
        match self.entries.push(entry) {
            Ok(()) => None,
            Err(rtrb::PushError::Full(entry)) => Some(entry),
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
        let mut passed = 0.0;
        loop {
            // Looked at first, so that nothing comes after what is taken now.
            let is_last = self.entries.is_abandoned();
            let Ok(entry) = self.entries.pop() else {
                return Ok(if is_last { Played::End } else { Played::Waits });
            };
            match entry {
                Entry::Update { interval, .. } => passed += interval,
                Entry::LoseTime { seconds } => passed += seconds,
                _ => (),
            }
            let replayed = self.replayer.apply(simulation, &entry);
            let is_change = is_change(&entry);
            self.give_back(entry);
            match replayed? {
                Replayed::Update => return Ok(Played::Update(passed)),
                Replayed::Lost(lost) => return Ok(Played::Lost(lost)),
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
        while self.entries.peek().is_ok_and(is_command) {
            let Ok(entry) = self.entries.pop() else { break };
            let replayed = self.replayer.apply(simulation, &entry);
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
