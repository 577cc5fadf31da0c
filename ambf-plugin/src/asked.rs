use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Something that any thread asks for and one does, with the time at which it was last asked for: what was posted before
/// that is part of the past, what came after it is not.
pub struct Asked {
    start: Instant,
    /// Since `start`, ns; 0: nobody asks.
    at_ns: AtomicU64,
}

impl Default for Asked {
    fn default() -> Self {
        Self { start: Instant::now(), at_ns: AtomicU64::new(0) }
    }
}

impl Asked {
    /// Asks, now.
    pub fn ask(&self) {
        self.at_ns.fetch_max((self.start.elapsed().as_nanos() as u64).max(1), Ordering::AcqRel);
    }

    /// Whether somebody asks.
    pub fn is_waiting(&self) -> bool {
        self.at_ns.load(Ordering::Acquire) != 0
    }

    /// When it was last asked for, if it was; nobody asks any more then.
    pub fn take(&self) -> Option<Instant> {
        // The usual case costs no exchange.
        let asked = self.is_waiting().then(|| self.at_ns.swap(0, Ordering::AcqRel)).filter(|&at_ns| at_ns != 0);
        asked.map(|at_ns| self.start + Duration::from_nanos(at_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_taken_once_with_the_time_of_the_latest() {
        let asked = Asked::default();
        assert!(!asked.is_waiting() && asked.take().is_none());
        asked.ask();
        let between = Instant::now();
        asked.ask();
        assert!(asked.is_waiting());
        let at = asked.take().expect("asked for");
        assert!(at >= between && at <= Instant::now());
        assert!(!asked.is_waiting() && asked.take().is_none());
    }
}
