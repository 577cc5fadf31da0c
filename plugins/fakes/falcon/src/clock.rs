use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time of fake devices: the computer's, or one that only passes while somebody waits, so that nothing depends on how
/// busy the computer is.
#[derive(Debug, Clone)]
pub struct Clock {
    begin: Instant,
    /// ns since the beginning, of a time of its own.
    own: Option<Arc<AtomicU64>>,
}

impl Clock {
    /// The computer's.
    pub fn real() -> Self {
        Self { begin: Instant::now(), own: None }
    }

    /// One that passes while somebody waits. For one thread: two that wait would both make it pass.
    pub fn stepped() -> Self {
        Self { begin: Instant::now(), own: Some(Arc::default()) }
    }

    /// Now.
    pub fn now(&self) -> Instant {
        match &self.own {
            Some(own) => self.begin + Duration::from_nanos(own.load(Ordering::Acquire)),
            None => Instant::now(),
        }
    }

    /// Waits until `time`.
    pub(crate) fn wait_until(&self, time: Instant) {
        match &self.own {
            Some(own) => {
                own.fetch_max(time.saturating_duration_since(self.begin).as_nanos() as u64, Ordering::AcqRel);
            }
            None => std::thread::sleep(time.saturating_duration_since(Instant::now())),
        }
    }

    /// Waits for `duration`; a real clock's thread may be unparked before.
    pub(crate) fn park(&self, duration: Duration) {
        match &self.own {
            Some(_) => self.wait_until(self.now() + duration),
            None => std::thread::park_timeout(duration),
        }
    }
}
