//! A value of a few words that one thread writes and others read, without locks and without waiting.

use std::sync::atomic::{fence, AtomicU64, Ordering};

/// `N` words with one writer. A reader gets all words of one write, or none: a sequence lock whose words are atomics (H.-J. Boehm, "Can seqlocks
/// get along with programming language memory models?", 2012).
#[derive(Debug)]
pub(crate) struct Slot<const N: usize> {
    /// Odd while a write is under way; 0 before the first.
    version: AtomicU64,
    words: [AtomicU64; N],
}

impl<const N: usize> Slot<N> {
    pub fn new() -> Self {
        Self { version: AtomicU64::new(0), words: std::array::from_fn(|_| AtomicU64::new(0)) }
    }

    /// Leaves new words. Only one thread may do so.
    pub fn write(&self, words: &[u64; N]) {
        let version = self.version.load(Ordering::Relaxed);
        self.version.store(version.wrapping_add(1), Ordering::Relaxed);
        // No word of this write may be seen with the version before it.
        fence(Ordering::Release);
        for (slot, word) in self.words.iter().zip(words) {
            slot.store(*word, Ordering::Relaxed);
        }
        self.version.store(version.wrapping_add(2), Ordering::Release);
    }

    /// The newest words; `None` before the first write and when a write got in the way of every attempt, whereupon the reader keeps what it has.
    pub fn read(&self) -> Option<[u64; N]> {
        // A writer that lost its core in the middle of a write may not come back soon.
        for _ in 0..8 {
            let version = self.version.load(Ordering::Acquire);
            if version == 0 {
                return None;
            }
            let words = std::array::from_fn(|i| self.words[i].load(Ordering::Relaxed));
            fence(Ordering::Acquire);
            if version & 1 == 0 && self.version.load(Ordering::Relaxed) == version {
                return Some(words);
            }
            std::hint::spin_loop();
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicBool;
    use std::thread;

    #[test]
    fn nothing_is_read_before_the_first_write() {
        let slot = Slot::<2>::new();
        assert_eq!(slot.read(), None);
        slot.write(&[3, 4]);
        assert_eq!(slot.read(), Some([3, 4]));
    }

    #[test]
    fn words_of_two_writes_are_never_mixed() {
        let slot = Slot::<8>::new();
        let done = AtomicBool::new(false);
        let reads = thread::scope(|scope| {
            let reader = scope.spawn(|| {
                let (mut reads, mut last) = (0_u64, 0);
                while !done.load(Ordering::Relaxed) || reads == 0 {
                    let Some(words) = slot.read() else { continue };
                    assert!(words.iter().all(|word| *word == words[0]), "{words:?}");
                    assert!(words[0] >= last, "{} after {last}", words[0]);
                    last = words[0];
                    reads += 1;
                }
                reads
            });
            for i in 1..=200_000 {
                slot.write(&[i; 8]);
            }
            done.store(true, Ordering::Relaxed);
            reader.join().expect("the reader saw whole writes only")
        });
        assert!(reads > 0);
    }
}
