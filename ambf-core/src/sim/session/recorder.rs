//! From the physics thread to the thread that writes: a queue of bytes on which neither waits for the other.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use rtrb::{Consumer, Producer, RingBuffer};
use thiserror::Error;

use super::codec::CodeError;
use super::entry::{Entry, KINDS};
use super::hash::StateHash;
use crate::scene::Scene;

/// Room for entries that the writer has not taken yet, bytes: at 1 kHz half a minute of two arms, so that a disk may be
/// away for as long.
const CAPACITY: usize = 8 << 20;
/// Bytes of an entry's length before it.
const LENGTH: usize = 4;
/// Bytes of a command of a body without its joints, and of other commands but for their texts.
const COMMAND: usize = 160;
/// Bytes of a joint command.
const JOINT_COMMAND: usize = 9;

/// How often a simulation without a clock looks whether there is room again.
const WAIT: Duration = Duration::from_millis(1);

/// How many updates lie between two hashes of the state.
pub const HASH_INTERVAL: u64 = 1000;

/// Why a recording has ended before it was told to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum EarlyEnd {
    /// More entries waited than there is room for.
    #[error("the disk was too slow: more waited to be written than there is room for")]
    Slow,
    /// One entry is longer than the queue.
    #[error(
        "what was done at once takes more than {} bytes, such as a cut of very many voxels: do it in parts",
        CAPACITY
    )]
    TooLarge,
    /// The simulation went back to a state that it had before the recording began.
    #[error("the simulation went back to a state from before the recording, which a replay cannot do")]
    WentBack,
}

/// The physics thread's end: it takes no lock, makes no system call and, once it knows the scene, allocates nothing
/// for commands of usual size.
pub struct Recorder {
    queue: Producer<u8>,
    early_end: Arc<OnceLock<EarlyEnd>>,
    /// Tells recordings of this process apart.
    id: u64,
    count: u64,
    /// The entry that is written, behind its length.
    bytes: Vec<u8>,
    /// What was executed last, by kind and object.
    last: [Vec<Vec<u8>>; KINDS],
    hash: StateHash,
    waits: bool,
}

/// The writer's end.
pub struct Tap {
    queue: Consumer<u8>,
    early_end: Arc<OnceLock<EarlyEnd>>,
    bytes: Vec<u8>,
}

/// Both ends of a recording. `waits`: the simulation waits while the queue is full, for those that run without a clock; else
/// a full queue ends the recording.
pub fn recorder(waits: bool) -> (Recorder, Tap) {
    static NEXT: AtomicU64 = AtomicU64::new(1);
    let (producer, consumer) = RingBuffer::new(CAPACITY);
    let early_end = Arc::new(OnceLock::new());
    let recorder = Recorder {
        queue: producer,
        early_end: Arc::clone(&early_end),
        id: NEXT.fetch_add(1, Ordering::Relaxed),
        count: 0,
        bytes: Vec::with_capacity(4096),
        last: Default::default(),
        hash: StateHash::default(),
        waits,
    };
    (recorder, Tap { queue: consumer, early_end, bytes: Vec::new() })
}

impl Recorder {
    /// Which recording this is, and how many entries it has.
    pub(in crate::sim) fn position(&self) -> (u64, u64) {
        (self.id, self.count)
    }

    /// Makes place for commands of all that the scene has.
    pub(in crate::sim) fn grow(&mut self, scene: &Scene) {
        self.hash.grow(scene);
        let counts = [
            (4, scene.bodies.len()),
            (6, 2 * scene.cameras.len().max(scene.lights.len())),
            (7, scene.soft_bodies.len()),
            (8, scene.actuators.len()),
            (9, scene.vehicles.len()),
        ];
        for (kind, count) in counts {
            let last: &mut Vec<Vec<u8>> = &mut self.last[kind];
            while last.len() < count {
                let joints = match kind {
                    4 => scene.active_joints(crate::ids::BodyId::new(last.len())).len(),
                    _ => 0,
                };
                last.push(Vec::with_capacity(COMMAND + joints * JOINT_COMMAND));
            }
        }
    }

    /// Ends the recording before it was told to; the first reason stays.
    pub(in crate::sim) fn end(&mut self, why: EarlyEnd) {
        let _ = self.early_end.set(why);
    }

    fn has_ended(&self) -> bool {
        self.early_end.get().is_some()
    }

    /// Adds an entry; nothing after the recording has ended.
    pub(in crate::sim) fn note(&mut self, entry: &Entry<'_>) {
        if self.has_ended() {
            return;
        }
        self.bytes.clear();
        self.bytes.extend_from_slice(&[0; LENGTH]);
        entry.write(&mut self.bytes);
        if let Some((kind, object)) = entry.subject() {
            let of_kind = &mut self.last[usize::from(kind)];
            if object >= of_kind.len() {
                of_kind.resize_with(object + 1, Vec::new);
            }
            let last = &mut of_kind[object];
            if *last == self.bytes[LENGTH..] {
                self.bytes.truncate(LENGTH);
                Entry::Same { kind, object }.write(&mut self.bytes);
            } else {
                last.clear();
                last.extend_from_slice(&self.bytes[LENGTH..]);
            }
        }
        let length = (self.bytes.len() - LENGTH) as u32;
        self.bytes[..LENGTH].copy_from_slice(&length.to_le_bytes());
        self.count += 1;
        if self.bytes.len() > CAPACITY {
            return self.end(EarlyEnd::TooLarge);
        }
        while self.queue.push_entire_slice(&self.bytes).is_err() {
            // What nobody takes any more is no loss.
            if self.queue.is_abandoned() || !self.waits {
                return self.end(EarlyEnd::Slow);
            }
            std::thread::sleep(WAIT);
        }
    }

    /// Adds the hash of the present state.
    pub(in crate::sim) fn note_hash(&mut self, scene: &Scene, iteration: u64, sim_time: f64) {
        if !self.has_ended() {
            let hash = self.hash.of(scene);
            self.note(&Entry::Hash { iteration, sim_time, hash });
        }
    }
}

impl Tap {
    /// Calls `each` with the bytes of all entries that wait, one by one.
    pub fn drain(&mut self, mut each: impl FnMut(&[u8])) {
        let waiting = self.queue.slots();
        let Ok(chunk) = self.queue.read_chunk(waiting) else { return };
        self.bytes.clear();
        let (first, second) = chunk.as_slices();
        self.bytes.extend_from_slice(first);
        self.bytes.extend_from_slice(second);
        chunk.commit_all();
        let mut rest = self.bytes.as_slice();
        // Entries are put into the queue whole.
        while let Some((length, behind)) = rest.split_first_chunk::<LENGTH>() {
            let Some((entry, behind)) = behind.split_at_checked(u32::from_le_bytes(*length) as usize) else { break };
            each(entry);
            rest = behind;
        }
    }

    /// Why the recording has ended by itself, if it has. What waits then is the last.
    pub fn early_end(&self) -> Option<EarlyEnd> {
        self.early_end.get().copied()
    }

    /// Whether the simulation records no more, so that what waits now is the last.
    pub fn is_last(&self) -> bool {
        self.queue.is_abandoned()
    }
}

/// Makes entries of bytes again, in their order.
#[derive(Debug, Default)]
pub struct Unpacker {
    last: HashMap<(u8, usize), Vec<u8>>,
}

impl Unpacker {
    /// The entry that `bytes` stand for: what repeats another is that other.
    ///
    /// # Errors
    /// [`CodeError`].
    pub fn unpack(&mut self, bytes: &[u8]) -> Result<Entry<'static>, CodeError> {
        let entry = Entry::read(bytes)?;
        if let Entry::Same { kind, object } = entry {
            return Entry::read(self.last.get(&(kind, object)).ok_or(CodeError::NoneBefore)?);
        }
        if let Some(subject) = entry.subject() {
            let last = self.last.entry(subject).or_default();
            last.clear();
            last.extend_from_slice(bytes);
        }
        Ok(entry)
    }
}

#[cfg(test)]
mod tests {
    use std::borrow::Cow;

    use nalgebra::Vector3;

    use super::*;
    use crate::comm::RigidBodyCommand;

    fn push(body: usize, x: f64) -> Entry<'static> {
        let command = RigidBodyCommand::wrench(Vector3::new(x, 0.0, 0.0), Vector3::zeros());
        Entry::Body { body, command: Cow::Owned(command) }
    }

    #[test]
    fn entries_arrive_in_order_and_repetitions_take_little_room() {
        let (mut recorder, mut tap) = recorder(false);
        let sent = [push(0, 1.0), push(1, 1.0), push(0, 1.0), Entry::ResetWorld {}, push(1, 2.0), push(1, 2.0)];
        sent.iter().for_each(|entry| recorder.note(entry));
        assert_eq!(recorder.position().1, 6);
        let (mut unpacker, mut received, mut lengths) = (Unpacker::default(), Vec::new(), Vec::new());
        tap.drain(|bytes| {
            lengths.push(bytes.len());
            received.push(unpacker.unpack(bytes).expect("an entry"));
        });
        assert_eq!(received, sent);
        assert!(lengths[2] < 10 && lengths[5] < 10 && lengths[4] > 48, "{lengths:?}");
        assert!(!tap.is_last());
        drop(recorder);
        assert!(tap.is_last() && tap.early_end().is_none());
    }

    #[test]
    fn a_full_queue_ends_the_recording_and_what_is_in_it_is_whole() {
        let (mut recorder, mut tap) = recorder(false);
        let mut sent = 0;
        while tap.early_end().is_none() {
            recorder.note(&push(0, f64::from(sent)));
            sent += 1;
        }
        let mut received = Vec::new();
        tap.drain(|bytes| received.push(Entry::read(bytes).expect("whole")));
        assert_eq!(received.len() as i32, sent - 1);
        assert_eq!(tap.early_end(), Some(EarlyEnd::Slow));
        recorder.note(&push(0, 0.0));
        tap.drain(|_| panic!("nothing is recorded any more"));
    }

    #[test]
    fn an_entry_that_never_fits_ends_the_recording_for_that_reason() {
        let (mut recorder, mut tap) = recorder(true);
        recorder.note(&push(0, 1.0));
        recorder.note(&Entry::Note { text: "x".repeat(CAPACITY) });
        assert_eq!(tap.early_end(), Some(EarlyEnd::TooLarge));
        let mut received = 0;
        tap.drain(|_| received += 1);
        assert_eq!(received, 1);
    }

    #[test]
    fn who_has_no_clock_waits_for_room() {
        let (mut recorder, mut tap) = recorder(true);
        let count = 3 * CAPACITY / 60;
        let sender = std::thread::spawn(move || (0..count).for_each(|number| recorder.note(&push(0, number as f64))));
        let mut received = 0;
        while !(tap.is_last() && received == count) {
            tap.drain(|_| received += 1);
            assert_eq!(tap.early_end(), None);
        }
        sender.join().expect("it sends all");
    }

    #[test]
    fn a_repetition_of_nothing_is_an_error() {
        let mut bytes = Vec::new();
        Entry::Same { kind: 4, object: 1 }.write(&mut bytes);
        assert_eq!(Unpacker::default().unpack(&bytes), Err(CodeError::NoneBefore));
    }
}
