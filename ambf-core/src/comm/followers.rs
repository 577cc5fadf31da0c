use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;
use std::thread::Thread;
use std::time::Duration;

use arc_swap::ArcSwap;

/// The newest interval counts for one part in this many in the running mean.
const PARTS: u64 = 16;

/// A thread that passes on states, and the time from which it waits for new ones.
#[derive(Debug)]
pub struct Follower {
    thread: Thread,
    /// On the hub's clock, ns; `u64::MAX`: it does not wait.
    from_ns: AtomicU64,
}

impl Follower {
    /// Asks for the states that are published at `from` or later on the hub's clock: the thread is unparked once, by the
    /// first of them. It must look at [`Published::at`] once more before it parks: that state may be there.
    pub fn wait_from(&self, from: Duration) {
        self.from_ns.store(u64::try_from(from.as_nanos()).unwrap_or(u64::MAX), Ordering::SeqCst);
    }
}

/// When states were published.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Published {
    /// The newest ones, on the hub's clock; zero before the first.
    pub at: Duration,
    /// Running mean of the time between two publications; zero before the second.
    pub interval: Duration,
}

/// The threads that pass on states, and when there were new ones.
#[derive(Default)]
pub(super) struct Followers {
    /// Read by the physics thread without a lock.
    threads: ArcSwap<Vec<Arc<Follower>>>,
    published_ns: AtomicU64,
    interval_ns: AtomicU64,
}

impl Followers {
    pub fn add(&self, thread: &Thread) -> Arc<Follower> {
        let follower = Arc::new(Follower { thread: thread.clone(), from_ns: AtomicU64::new(u64::MAX) });
        self.threads.rcu(|before| before.iter().chain([&follower]).cloned().collect::<Vec<_>>());
        follower
    }

    pub fn remove(&self, follower: &Arc<Follower>) {
        let is_other = |other: &&Arc<Follower>| !Arc::ptr_eq(other, follower);
        self.threads.rcu(|before| before.iter().filter(is_other).cloned().collect::<Vec<_>>());
    }

    pub fn published(&self) -> Published {
        Published {
            at: Duration::from_nanos(self.published_ns.load(Ordering::SeqCst)),
            interval: Duration::from_nanos(self.interval_ns.load(Ordering::Relaxed)),
        }
    }

    /// Physics thread: says that states were published at `now_ns`, and unparks those who wait for them, or `all`.
    pub fn note_published(&self, now_ns: u64, all: bool) {
        let before = self.published_ns.swap(now_ns, Ordering::SeqCst);
        if before > 0 {
            let (newest, mean) = (now_ns.saturating_sub(before), self.interval_ns.load(Ordering::Relaxed));
            let mean = if mean == 0 { newest } else { (mean * (PARTS - 1)).saturating_add(newest) / PARTS };
            self.interval_ns.store(mean, Ordering::Relaxed);
        }
        for follower in self.threads.load().iter() {
            if all || follower.from_ns.load(Ordering::SeqCst) <= now_ns {
                follower.from_ns.store(u64::MAX, Ordering::SeqCst);
                follower.thread.unpark();
            }
        }
    }
}
