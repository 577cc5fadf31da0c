use std::sync::atomic::{fence, AtomicU64, Ordering};

/// How often a reader that meets a writer tries again: a writer needs some tens of nanoseconds unless it is
/// interrupted.
const TRIES: usize = 64;

/// The newest `N` numbers that belong together, handed between threads without any of them waiting: a sequence lock
/// whose words are atomics (H.-J. Boehm, "Can seqlocks get along with programming language memory models?", 2012).
#[derive(Debug)]
pub struct Latest<const N: usize> {
    /// Odd while somebody writes.
    sequence: AtomicU64,
    words: [AtomicU64; N],
}

impl<const N: usize> Default for Latest<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Latest<N> {
    /// All zero, never stored.
    pub fn new() -> Self {
        Self { sequence: AtomicU64::new(0), words: std::array::from_fn(|_| AtomicU64::new(0)) }
    }

    /// Stores numbers; `false` when another thread stores at this very moment, whose numbers then count.
    pub fn store(&self, words: [u64; N]) -> bool {
        let even = self.sequence.load(Ordering::Relaxed) & !1;
        if self.sequence.compare_exchange(even, even + 1, Ordering::Acquire, Ordering::Relaxed).is_err() {
            return false;
        }
        fence(Ordering::Release);
        for (word, value) in self.words.iter().zip(words) {
            word.store(value, Ordering::Relaxed);
        }
        self.sequence.store(even + 2, Ordering::Release);
        true
    }

    /// The numbers; `None` before there were any and when a writer was interrupted in the middle, whereupon a reader
    /// keeps what it has.
    pub fn newest(&self) -> Option<[u64; N]> {
        self.load().filter(|(count, _)| *count > 0).map(|(_, words)| words)
    }

    /// The numbers and how often there were new ones; `None` when a writer was interrupted in the middle.
    pub fn load(&self) -> Option<(u64, [u64; N])> {
        for _ in 0..TRIES {
            let before = self.sequence.load(Ordering::Acquire);
            if before & 1 == 0 {
                let words = std::array::from_fn(|i| self.words[i].load(Ordering::Relaxed));
                fence(Ordering::Acquire);
                if self.sequence.load(Ordering::Relaxed) == before {
                    return Some((before / 2, words));
                }
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

    #[test]
    fn numbers_are_counted() {
        let latest = Latest::<2>::new();
        assert_eq!((latest.load(), latest.newest()), (Some((0, [0, 0])), None));
        assert!(latest.store([3, 4]) && latest.store([5, 6]));
        assert_eq!((latest.load(), latest.newest()), (Some((2, [5, 6])), Some([5, 6])));
    }

    #[test]
    fn numbers_that_belong_together_stay_together() {
        let (latest, done) = (Latest::<8>::new(), AtomicBool::new(false));
        std::thread::scope(|scope| {
            for writer in 0..2u64 {
                let (latest, done) = (&latest, &done);
                scope.spawn(move || {
                    for i in 0..200_000u64 {
                        latest.store([i * 2 + writer; 8]);
                    }
                    done.store(true, Ordering::Relaxed);
                });
            }
            let (mut seen, mut last) = (0, 0);
            while !done.load(Ordering::Relaxed) || seen == 0 {
                if let Some((sequence, words)) = latest.load() {
                    assert!(words.iter().all(|&word| word == words[0]), "{words:?}");
                    assert!(sequence >= last);
                    (seen, last) = (seen + 1, sequence);
                }
            }
        });
    }
}
