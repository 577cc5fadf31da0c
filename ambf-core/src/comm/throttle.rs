use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicU8, Ordering};
use std::sync::Arc;
use std::thread::Thread;
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex};

use super::followers::Followers;
use super::{Follower, Published, WATCHDOG_TIMEOUT};

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

/// What the physics thread does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Activity {
    /// Iterates, or is about to.
    Runs,
    /// Waits for a client's step.
    Held,
    /// Is paused: by a user, or because the state became non-finite.
    Paused,
}

/// The step-throttling protocol between the clients of the world and the physics thread.
///
/// While throttling, one clock edge releases exactly [`WorldCommand::n_skip_steps`] iterations. An edge that comes
/// while stepping is still allowed is absorbed. Orders ([`order`](Self::order)) are added up instead. The watchdog ends
/// throttling when world commands and orders stop.
pub struct StepThrottle {
    previous: Mutex<WorldCommand>,
    throttling: AtomicBool,
    allowed: AtomicBool,
    skip: AtomicU32,
    last_post_ns: AtomicU64,
    /// When the latest iterations were asked for.
    edge_ns: AtomicU64,
    /// Ordered iterations that are not done.
    ordered: AtomicU32,
    /// The latest iterations were ordered, not clocked.
    by_order: AtomicBool,
    /// How long the client of the latest order may think, ns, and until when.
    patience_ns: AtomicU64,
    patient_until_ns: AtomicU64,
    /// The last ordered iteration is done, but not published.
    unpublished: AtomicBool,
    /// Clocked steps that are done and published.
    clocked_steps: AtomicU64,
    activity: AtomicU8,
    waiter: Mutex<Option<Thread>>,
    followers: Followers,
    /// Guards nothing: what it tells of is atomic.
    told: Mutex<()>,
    changed: Condvar,
}

impl Default for StepThrottle {
    fn default() -> Self {
        Self {
            previous: Mutex::default(),
            throttling: AtomicBool::new(false),
            allowed: AtomicBool::new(true),
            skip: AtomicU32::new(10),
            last_post_ns: AtomicU64::new(0),
            edge_ns: AtomicU64::new(0),
            ordered: AtomicU32::new(0),
            by_order: AtomicBool::new(false),
            patience_ns: AtomicU64::new(0),
            patient_until_ns: AtomicU64::new(0),
            unpublished: AtomicBool::new(false),
            clocked_steps: AtomicU64::new(0),
            activity: AtomicU8::new(Activity::Runs as u8),
            waiter: Mutex::new(None),
            followers: Followers::default(),
            told: Mutex::new(()),
            changed: Condvar::new(),
        }
    }
}

impl StepThrottle {
    /// Takes a client's command, at `now_ns` on the hub's clock. Every message counts: clock edges are found by
    /// comparing it with the one before.
    pub fn post(&self, command: WorldCommand, now_ns: u64) {
        let mut previous = self.previous.lock();
        self.last_post_ns.store(now_ns, Ordering::Release);
        self.skip.store(u32::from(command.n_skip_steps), Ordering::Release);
        let begins = !self.throttling.swap(command.enable_step_throttling, Ordering::AcqRel);
        let edge = command.step_clock != previous.step_clock;
        if !command.enable_step_throttling || edge {
            self.allowed.store(true, Ordering::Release);
            self.by_order.store(false, Ordering::Release);
        }
        if begins || edge {
            self.edge_ns.store(now_ns, Ordering::Release);
        }
        *previous = command;
        drop(previous);
        self.wake();
    }

    /// Holds the physics from now on until iterations are ordered or `patience` has passed since the last of them; at
    /// `now_ns` on the hub's clock.
    pub fn hold(&self, patience: Duration, now_ns: u64) {
        let patience = u64::try_from(patience.as_nanos()).unwrap_or(u64::MAX);
        self.patience_ns.store(patience, Ordering::Release);
        self.patient_until_ns.store(now_ns.saturating_add(patience), Ordering::Release);
        self.by_order.store(true, Ordering::Release);
        self.allowed.store(false, Ordering::Release);
        if !self.throttling.swap(true, Ordering::AcqRel) {
            self.edge_ns.store(now_ns, Ordering::Release);
        }
    }

    /// Lets `steps` iterations through, after those that were ordered before. Call [`hold`](Self::hold) first.
    pub fn order(&self, steps: u32, now_ns: u64) {
        self.edge_ns.store(now_ns, Ordering::Release);
        self.ordered.fetch_add(steps, Ordering::AcqRel);
        self.wake();
    }

    /// Ordered iterations that are still to be done.
    pub fn ordered(&self) -> u32 {
        self.ordered.load(Ordering::Acquire)
    }

    /// Forgets ordered iterations that are not done.
    pub fn cancel(&self) {
        self.ordered.store(0, Ordering::Release);
        self.unpublished.store(false, Ordering::Release);
    }

    /// Whether ordered iterations are still to be done or to be published.
    pub fn is_busy(&self) -> bool {
        self.ordered.load(Ordering::Acquire) > 0 || self.unpublished.load(Ordering::Acquire)
    }

    /// Whether clients hold the simulation between iterations.
    pub fn is_throttling(&self) -> bool {
        self.throttling.load(Ordering::Acquire)
    }

    /// Whether clients order the iterations, so that there is no need to keep time between them.
    pub fn is_stepped_by_orders(&self) -> bool {
        self.throttling.load(Ordering::Acquire) && self.by_order.load(Ordering::Acquire)
    }

    /// Whether the world's command stream is alive at `now_ns`, or an order is in force.
    pub fn is_live(&self, now_ns: u64) -> bool {
        let last = self.last_post_ns.load(Ordering::Acquire);
        let timeout = WATCHDOG_TIMEOUT.as_nanos() as u64;
        last != 0 && now_ns.saturating_sub(last) <= timeout
            || now_ns < self.patient_until_ns.load(Ordering::Acquire)
            || self.is_busy()
    }

    /// The time by which the watchdogs of objects go at `now_ns`: while throttling it stands still from one step to the
    /// next, so that a command that was in force when a step was asked for is so until it is done, and while the client
    /// thinks.
    pub fn watch_time(&self, now_ns: u64) -> u64 {
        if self.throttling.load(Ordering::Acquire) {
            now_ns.min(self.edge_ns.load(Ordering::Acquire))
        } else {
            now_ns
        }
    }

    /// Names the thread that calls [`wait`](Self::wait), so that a command can wake it. Once, before its loop starts.
    pub fn set_waiter(&self, thread: Thread) {
        *self.waiter.lock() = Some(thread);
    }

    /// Names a thread that passes on states. It is unparked when a clocked step is published, and when it
    /// [asks](Follower::wait_from) for it. Not for the physics thread.
    pub fn add_follower(&self, thread: &Thread) -> Arc<Follower> {
        self.followers.add(thread)
    }

    /// Does not unpark the thread of `follower` any more. Not for the physics thread.
    pub fn remove_follower(&self, follower: &Arc<Follower>) {
        self.followers.remove(follower);
    }

    /// When iterations were published.
    pub fn published(&self) -> Published {
        self.followers.published()
    }

    /// Steps that were clocked, not ordered, and are done and published.
    pub fn clocked_steps(&self) -> u64 {
        self.clocked_steps.load(Ordering::Acquire)
    }

    /// Wakes the waiting physics thread, for example to end.
    pub fn wake(&self) {
        if let Some(thread) = self.waiter.lock().as_ref() {
            thread.unpark();
        }
    }

    /// Whether an iteration may go on now.
    pub fn is_open(&self) -> bool {
        !self.throttling.load(Ordering::Acquire)
            || self.allowed.load(Ordering::Acquire)
            || self.ordered.load(Ordering::Acquire) > 0
    }

    /// What the physics thread does.
    pub fn activity(&self) -> Activity {
        match self.activity.load(Ordering::Acquire) {
            x if x == Activity::Held as u8 => Activity::Held,
            x if x == Activity::Paused as u8 => Activity::Paused,
            _ => Activity::Runs,
        }
    }

    /// Physics thread: says what it does.
    pub fn set_activity(&self, activity: Activity) {
        if self.activity.swap(activity as u8, Ordering::AcqRel) != activity as u8 && activity != Activity::Runs {
            self.tell();
        }
    }

    /// Physics thread: waits until an iteration may go on, the stream of world commands dries up, or `give_up` says so.
    /// `now_ns` reads the hub's clock. Blocking here is the purpose of throttling.
    pub fn wait(&self, now_ns: impl Fn() -> u64, give_up: impl Fn() -> bool) {
        let mut spins = 0u32;
        while !self.is_open() && !give_up() {
            self.set_activity(Activity::Held);
            if !self.is_live(now_ns()) {
                self.end();
                break;
            }
            // A client that answers at once is met spinning; for all others the core is given back. `post` unparks.
            if spins < 2000 {
                spins += 1;
                std::hint::spin_loop();
            } else {
                std::thread::park_timeout(Duration::from_millis(5));
            }
        }
        if self.is_open() {
            self.set_activity(Activity::Runs);
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
        self.by_order.store(false, Ordering::Release);
        self.allowed.store(true, Ordering::Release);
    }

    /// Physics thread: counts an iteration in `counter` after the world has reported its time; true when the client
    /// asked for steps of 0 iterations, which never block.
    pub fn count(&self, counter: &mut u32) -> bool {
        if self.ordered.load(Ordering::Acquire) > 0 {
            *counter = 0;
            // Said before the number falls: in between it is never idle.
            self.unpublished.store(true, Ordering::Release);
            let one_less = |steps: u32| Some(steps.saturating_sub(1));
            if self.ordered.fetch_update(Ordering::AcqRel, Ordering::Acquire, one_less).unwrap_or(0) != 1 {
                self.unpublished.store(false, Ordering::Release);
            }
            return false;
        }
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

    /// Physics thread: says that the state of the iteration counted last is published, at `now_ns`.
    pub fn note_published(&self, now_ns: u64) {
        let mut is_clocked = false;
        if self.unpublished.load(Ordering::Acquire) {
            // The client's time to think begins now.
            let until = now_ns.saturating_add(self.patience_ns.load(Ordering::Acquire));
            self.patient_until_ns.store(until, Ordering::Release);
            self.unpublished.store(false, Ordering::Release);
            self.tell();
        } else if !self.is_open() && !self.by_order.load(Ordering::Acquire) {
            self.clocked_steps.fetch_add(1, Ordering::AcqRel);
            is_clocked = true;
        }
        self.followers.note_published(now_ns, is_clocked);
    }

    /// Physics thread: tells those who [wait](Self::wait_until) to look again.
    pub fn tell(&self) {
        drop(self.told.lock());
        self.changed.notify_all();
    }

    /// Not for the physics thread: waits until `is_there`; false after `timeout`.
    pub fn wait_until(&self, timeout: Duration, is_there: impl Fn() -> bool) -> bool {
        let end = Instant::now() + timeout;
        let mut guard = self.told.lock();
        while !is_there() {
            let Some(left) = end.checked_duration_since(Instant::now()) else { return false };
            // Not every change that is waited for is notified.
            let nap = left.min(Duration::from_millis(5));
            self.changed.wait_for(&mut guard, nap);
        }
        true
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

    #[test]
    fn orders_add_up_and_wait_for_their_publication() {
        let (throttle, mut counter) = (StepThrottle::default(), 0);
        throttle.hold(Duration::from_secs(1), 1);
        assert!(!throttle.is_open() && throttle.is_stepped_by_orders());
        throttle.order(3, 2);
        throttle.order(2, 3);
        assert_eq!(run(&throttle, &mut counter, 100), 5);
        assert!(throttle.is_busy(), "not published yet");
        assert!(throttle.is_live(u64::MAX), "a step under way is never given up");
        throttle.note_published(10);
        assert!(!throttle.is_busy());
        assert!(throttle.is_live(1_000_000_000) && !throttle.is_live(1_000_000_010), "then patience begins");
        assert_eq!(throttle.clocked_steps(), 0);
        throttle.order(2, 3);
        throttle.cancel();
        assert_eq!(run(&throttle, &mut counter, 100), 0);
    }

    #[test]
    fn all_followers_are_told_of_a_clocked_step() {
        let (throttle, mut counter) = (StepThrottle::default(), 0);
        let (told, tell) = std::sync::mpsc::channel();
        let (begin, may_go) = (std::sync::Barrier::new(4), AtomicBool::new(false));
        std::thread::scope(|scope| {
            let followers: Vec<_> = (0..3)
                .map(|number| {
                    let (told, begin, may_go) = (told.clone(), &begin, &may_go);
                    scope.spawn(move || {
                        begin.wait();
                        while !may_go.load(Ordering::Acquire) {
                            std::thread::park_timeout(Duration::from_secs(20));
                        }
                        told.send(number).unwrap();
                    })
                })
                .collect();
            begin.wait();
            let _followers: Vec<_> =
                followers.iter().map(|follower| throttle.add_follower(follower.thread())).collect();
            throttle.post(command(false, 1), 1);
            run(&throttle, &mut counter, 10);
            may_go.store(true, Ordering::Release);
            throttle.note_published(2);
            let mut all: Vec<i32> = (0..3).map(|_| tell.recv_timeout(Duration::from_secs(10)).unwrap()).collect();
            all.sort_unstable();
            assert_eq!(all, [0, 1, 2], "none of them waited until it woke by itself");
        });
    }

    #[test]
    fn a_follower_is_woken_by_the_first_states_from_a_time_on() {
        let throttle = StepThrottle::default();
        let follower = throttle.add_follower(&std::thread::current());
        let is_unparked = || {
            let begin = Instant::now();
            std::thread::park_timeout(Duration::from_secs(20));
            begin.elapsed() < Duration::from_secs(10)
        };
        follower.wait_from(Duration::from_nanos(10));
        throttle.note_published(10);
        assert!(is_unparked());
        assert_eq!(throttle.published(), Published { at: Duration::from_nanos(10), interval: Duration::ZERO });
        // One that asked for later states, for none, or has gone is left alone: its next park ends by the clock.
        let sleeps = || {
            let begin = Instant::now();
            std::thread::park_timeout(Duration::from_millis(20));
            begin.elapsed() >= Duration::from_millis(20)
        };
        throttle.note_published(20);
        assert!(sleeps());
        follower.wait_from(Duration::from_nanos(31));
        throttle.note_published(30);
        assert!(sleeps());
        throttle.remove_follower(&follower);
        throttle.note_published(40);
        assert!(sleeps());
        assert_eq!(
            throttle.published(),
            Published { at: Duration::from_nanos(40), interval: Duration::from_nanos(10) }
        );
    }

    #[test]
    fn the_time_of_watchdogs_stands_still_between_steps() {
        let throttle = StepThrottle::default();
        assert_eq!(throttle.watch_time(7), 7);
        throttle.post(command(false, 1), 10);
        throttle.post(command(false, 1), 20);
        assert_eq!(throttle.watch_time(30), 10, "no edge");
        throttle.post(command(true, 1), 40);
        assert_eq!((throttle.watch_time(35), throttle.watch_time(50)), (35, 40));
        throttle.post(WorldCommand::default(), 60);
        assert_eq!(throttle.watch_time(70), 70);
    }
}
