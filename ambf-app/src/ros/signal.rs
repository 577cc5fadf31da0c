//! Small helpers of the ROS threads: a waker, and complaints that do not flood the log.

use std::collections::BTreeSet;
use std::fmt::Display;
use std::sync::OnceLock;
use std::thread::Thread;

use parking_lot::Mutex;

use crate::report::RateLimit;
use crate::warn;

/// Wakes one thread that parks.
#[derive(Debug, Default)]
pub(super) struct Waker(OnceLock<Thread>);

impl Waker {
    /// The present thread is the one to wake.
    pub fn claim(&self) {
        let _ = self.0.set(std::thread::current());
    }

    /// Ends its present or next park.
    pub fn wake(&self) {
        if let Some(thread) = self.0.get() {
            thread.unpark();
        }
    }
}

/// Reports about one topic, at most one line a second: a client may publish nonsense at 1 kHz.
#[derive(Debug, Default)]
pub(super) struct RateLimitedLog(Mutex<RateLimit>);

impl RateLimitedLog {
    /// Reports `what` unless something was reported within the last second; true when it did.
    pub fn report(&self, what: impl Display) -> bool {
        let due = self.0.lock().is_due();
        if due {
            warn!("ROS: {what}");
        }
        due
    }
}

/// Which of a few things have been said already.
#[derive(Debug, Default)]
pub(super) struct OnceLog(Mutex<BTreeSet<&'static str>>);

impl OnceLog {
    /// Those of `things` that come for the first time.
    pub fn first_of(&self, things: impl Iterator<Item = &'static str>) -> Vec<&'static str> {
        let mut things = things.peekable();
        if things.peek().is_none() {
            return Vec::new();
        }
        let mut said = self.0.lock();
        things.filter(|thing| said.insert(thing)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn complaints_come_once_a_second() {
        let complaints = RateLimitedLog::default();
        assert!(complaints.report("a test line"));
        assert!(!complaints.report("one too many"));
    }

    #[test]
    fn a_thing_is_new_once() {
        let said = OnceLog::default();
        assert_eq!(said.first_of(["a", "b"].into_iter()), ["a", "b"]);
        assert_eq!(said.first_of(["b", "c"].into_iter()), ["c"]);
        assert!(said.first_of(["a"].into_iter()).is_empty());
    }
}
