//! A signal to end.

use std::time::Duration;

use parking_lot::{Condvar, Mutex};

/// Tells threads to end, and wakes those that wait for it.
#[derive(Debug, Default)]
pub struct Stop {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    stopped: bool,
    nudges: u64,
}

impl Stop {
    /// Says stop, for good.
    pub fn stop(&self) {
        self.state.lock().stopped = true;
        self.changed.notify_all();
    }

    /// Ends the present [`wait`](Self::wait) of everybody early.
    pub fn nudge(&self) {
        self.state.lock().nudges += 1;
        self.changed.notify_all();
    }

    /// Whether it is time to end.
    pub fn is_stopped(&self) -> bool {
        self.state.lock().stopped
    }

    /// Waits for `time` or the stop, whatever nudges come; true when it is time to end.
    pub(crate) fn wait_still(&self, time: Duration) -> bool {
        let mut state = self.state.lock();
        self.changed.wait_while_for(&mut state, |s| !s.stopped, time);
        state.stopped
    }

    /// Waits until there have been other nudges than the `seen`, which are those up to now afterwards, for `time` at
    /// most; true when it is time to end.
    pub(crate) fn wait_for_news(&self, seen: &mut u64, time: Duration) -> bool {
        let mut state = self.state.lock();
        let before = *seen;
        self.changed.wait_while_for(&mut state, |s| !s.stopped && s.nudges == before, time);
        *seen = state.nudges;
        state.stopped
    }

    /// Waits for `time`, a nudge or the stop; true when it is time to end.
    pub fn wait(&self, time: Duration) -> bool {
        let mut state = self.state.lock();
        let nudges = state.nudges;
        self.changed.wait_while_for(&mut state, |s| !s.stopped && s.nudges == nudges, time);
        state.stopped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_ends_waits() {
        let stop = Stop::default();
        assert!(!stop.wait(Duration::from_millis(1)));
        std::thread::scope(|scope| {
            let waiter = scope.spawn(|| stop.wait(Duration::from_secs(60)));
            stop.stop();
            assert!(waiter.join().unwrap());
        });
        assert!(stop.is_stopped() && stop.wait(Duration::from_secs(60)));
    }
}
