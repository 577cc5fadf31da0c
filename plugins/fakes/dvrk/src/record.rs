//! Wrenches that a fake arm was told to show.

use std::collections::VecDeque;
use std::time::Instant;

use dvrk_arm::Wrench;

/// How many are kept: five minutes at 1 kHz.
const MOST: usize = 300_000;

/// A wrench as it came.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shown {
    /// When it came.
    pub at: Instant,
    /// In the arm's frames.
    pub wrench: Wrench,
}

/// The last wrenches of an arm.
#[derive(Debug, Default)]
pub(crate) struct Record {
    shown: VecDeque<Shown>,
    /// All that ever came.
    pub count: u64,
    /// The first so many are taken already.
    taken: u64,
}

impl Record {
    pub fn push(&mut self, wrench: Wrench) {
        if self.shown.len() == MOST {
            self.shown.pop_front();
        }
        self.shown.push_back(Shown { at: Instant::now(), wrench });
        self.count += 1;
    }

    /// All that are kept.
    pub fn all(&self) -> Vec<Shown> {
        self.shown.iter().copied().collect()
    }

    /// The last one.
    pub fn last(&self) -> Option<Shown> {
        self.shown.back().copied()
    }

    /// Those that came since the last call, as far as they are kept.
    pub fn fresh(&mut self) -> Vec<Shown> {
        let new = usize::try_from(self.count - self.taken).unwrap_or(usize::MAX).min(self.shown.len());
        self.taken = self.count;
        self.shown.iter().skip(self.shown.len() - new).copied().collect()
    }

    pub fn clear(&mut self) {
        self.shown.clear();
        self.taken = self.count;
    }
}
