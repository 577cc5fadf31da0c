use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread::Thread;
use std::time::Duration;

use super::WATCHDOG_TIMEOUT;

/// Command of the world: whether a client steps the simulation, and its clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct WorldCommand {
    /// The simulation advances only with `step_clock` while true.
    pub enable_step_throttling: bool,
    /// Each change of value lets `n_skip_steps` iterations through.
    pub step_clock: bool,
    /// Iterations a clock edge lets through; 0 never blocks.
    pub n_skip_steps: u8,
}

/// The step-throttling protocol between the clients of the world and the physics thread.
///
/// While throttling, one clock edge releases exactly [`WorldCommand::n_skip_steps`] iterations. An edge that comes while stepping
/// is still allowed is absorbed. The watchdog ends throttling when world commands stop.
pub struct StepThrottle {
    previous: Mutex<WorldCommand>,
    throttling: AtomicBool,
    allowed: AtomicBool,
    skip: AtomicU32,
    last_post_ns: AtomicU64,
    waiter: Mutex<Option<Thread>>,
}

impl Default for StepThrottle {
    fn default() -> Self {
        Self {
            previous: Mutex::default(),
            throttling: AtomicBool::new(false),
            allowed: AtomicBool::new(true),
            skip: AtomicU32::new(10),
            last_post_ns: AtomicU64::new(0),
            waiter: Mutex::new(None),
        }
    }
}

impl StepThrottle {
    /// Takes a client's command, at `now_ns` on the hub's clock. Every message counts: clock edges are found by comparing it with
    /// the one before.
    pub fn post(&self, command: WorldCommand, now_ns: u64) {
        let mut previous = self.previous.lock().unwrap_or_else(PoisonError::into_inner);
        self.last_post_ns.store(now_ns, Ordering::Release);
        self.skip.store(u32::from(command.n_skip_steps), Ordering::Release);
        self.throttling.store(command.enable_step_throttling, Ordering::Release);
        let edge = command.step_clock != previous.step_clock;
        if !command.enable_step_throttling || edge {
            self.allowed.store(true, Ordering::Release);
        }
        *previous = command;
        drop(previous);
        self.wake();
    }

    /// Whether the world's command stream is alive at `now_ns`.
    pub fn is_live(&self, now_ns: u64) -> bool {
        let last = self.last_post_ns.load(Ordering::Acquire);
        last != 0 && now_ns.saturating_sub(last) <= WATCHDOG_TIMEOUT.as_nanos() as u64
    }

    /// Names the thread that calls [`wait`](Self::wait), so that a command can wake it. Once, before its loop starts.
    pub fn set_waiter(&self, thread: Thread) {
        *self.waiter.lock().unwrap_or_else(PoisonError::into_inner) = Some(thread);
    }

    /// Wakes the waiting physics thread, for example to end.
    pub fn wake(&self) {
        if let Some(thread) = self.waiter.lock().unwrap_or_else(PoisonError::into_inner).as_ref() {
            thread.unpark();
        }
    }

    /// Whether an iteration may go on now.
    pub fn is_open(&self) -> bool {
        !self.throttling.load(Ordering::Acquire) || self.allowed.load(Ordering::Acquire)
    }

    /// Physics thread: waits until an iteration may go on, the stream of world commands dries up, or `give_up` says so. `now_ns`
    /// reads the hub's clock. Blocking here is the purpose of throttling.
    pub fn wait(&self, now_ns: impl Fn() -> u64, give_up: impl Fn() -> bool) {
        let mut spins = 0u32;
        while !self.is_open() && !give_up() {
            if !self.is_live(now_ns()) {
                self.end();
                return;
            }
            // A client that answers at once is met spinning; for all others the core is given back. `post` unparks.
            if spins < 2000 {
                spins += 1;
                std::hint::spin_loop();
            } else {
                std::thread::park_timeout(Duration::from_millis(5));
            }
        }
    }

    /// Physics thread: ends throttling when world commands have stopped; true when it did.
    pub fn check_watchdog(&self, now_ns: u64) -> bool {
        let expired = self.throttling.load(Ordering::Acquire) && !self.is_live(now_ns);
        if expired {
            self.end();
        }
        expired
    }

    fn end(&self) {
        self.throttling.store(false, Ordering::Release);
        self.allowed.store(true, Ordering::Release);
    }

    /// Physics thread: counts an iteration in `counter` after the world has reported its time; true when the client asked for
    /// steps of 0 iterations, which never block.
    pub fn count(&self, counter: &mut u32) -> bool {
        if !self.throttling.load(Ordering::Acquire) {
            *counter = 0;
            return false;
        }
        *counter += 1;
        let skip = self.skip.load(Ordering::Acquire);
        // `>=`: a client that lowers the number half-way is still stopped.
        if skip > 0 && *counter >= skip {
            self.allowed.store(false, Ordering::Release);
            *counter = 0;
        }
        skip == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command(step_clock: bool, n_skip_steps: u8) -> WorldCommand {
        WorldCommand { enable_step_throttling: true, step_clock, n_skip_steps }
    }

    fn run(throttle: &StepThrottle, counter: &mut u32, limit: usize) -> usize {
        (0..limit).take_while(|_| throttle.is_open() && (throttle.count(counter), true).1).count()
    }

    #[test]
    fn an_edge_releases_exactly_n_iterations() {
        let (throttle, mut counter) = (StepThrottle::default(), 0);
        throttle.post(command(false, 5), 1);
        assert_eq!(run(&throttle, &mut counter, 100), 5, "the first message only switches throttling on");
        throttle.post(command(false, 5), 2);
        assert_eq!(run(&throttle, &mut counter, 100), 0, "no edge");
        throttle.post(command(true, 3), 3);
        assert_eq!(run(&throttle, &mut counter, 100), 3);
        throttle.post(command(false, 3), 4);
        throttle.post(command(true, 3), 5);
        assert_eq!(run(&throttle, &mut counter, 100), 3, "the second edge came while stepping was allowed");
    }

    #[test]
    fn zero_steps_never_block_and_are_reported() {
        let (throttle, mut counter) = (StepThrottle::default(), 0);
        throttle.post(command(false, 0), 1);
        assert!(throttle.count(&mut counter));
        assert!(throttle.is_open());
    }

    #[test]
    fn switching_off_or_a_dead_stream_opens() {
        let (throttle, mut counter) = (StepThrottle::default(), 0);
        throttle.post(command(false, 1), 1);
        assert_eq!(run(&throttle, &mut counter, 10), 1);
        throttle.wait(|| 600_000_000, || false);
        assert!(throttle.is_open());
        throttle.post(command(false, 1), 1);
        assert_eq!(run(&throttle, &mut counter, 10), 1);
        throttle.post(WorldCommand::default(), 2);
        assert!(throttle.is_open());
    }

    #[test]
    fn a_post_wakes_the_waiting_thread() {
        let throttle = StepThrottle::default();
        throttle.set_waiter(std::thread::current());
        let mut counter = 0;
        throttle.post(command(false, 1), 1);
        throttle.count(&mut counter);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(Duration::from_millis(20));
                throttle.post(command(true, 1), 1);
            });
            throttle.wait(|| 1, || false);
        });
        assert!(throttle.is_open());
    }
}
