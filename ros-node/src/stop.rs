//! A signal to end.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

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
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Says stop, for good.
    pub fn stop(&self) {
        self.lock().stopped = true;
        self.changed.notify_all();
    }

    /// Ends the present [`wait`](Self::wait) of everybody early.
    pub fn nudge(&self) {
        self.lock().nudges += 1;
        self.changed.notify_all();
    }

    /// Whether it is time to end.
    pub fn is_stopped(&self) -> bool {
        self.lock().stopped
    }

    /// Waits for `time`, a nudge or the stop; true when it is time to end.
    pub fn wait(&self, time: Duration) -> bool {
        let state = self.lock();
        let nudges = state.nudges;
        let waiting = |s: &mut State| !s.stopped && s.nudges == nudges;
        self.changed.wait_timeout_while(state, time, waiting).unwrap_or_else(PoisonError::into_inner).0.stopped
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
