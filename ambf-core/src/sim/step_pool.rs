//! Steps of many worlds that know nothing of each other, on several threads.
//!
//! The thread that asks for the steps makes them itself. Helpers take worlds from the same list while it does; one that
//! comes too late finds nothing to do and nobody has waited for it. So a call ends at the latest when the caller has
//! stepped all worlds that nobody else had begun, and those that helpers had begun are done.
//!
//! Whether helpers are asked at all is measured ([`choice`]): where cores are taken by other programs, or a step costs
//! less than waking somebody up, the caller steps the worlds in turn as if there were no pool.
//!
//! What a world does never depends on the thread that steps it: it is moved there as a whole, and one thread at a time
//! has it.

mod choice;

use std::collections::BTreeMap;
use std::ops::Range;
use std::panic::{catch_unwind, AssertUnwindSafe};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::Arc;
use std::thread::Thread;
use std::time::{Duration, Instant};

use crossbeam_channel::{bounded, Receiver, Sender, TryRecvError};
use parking_lot::Mutex;

use super::LostState;
use ambf_dynamics::aba::together;
use choice::{Choice, Way};

/// Something that makes iterations, such as a [`Stepper`](super::Stepper).
pub trait Steps: Send + 'static {
    /// As many as so many are stepped side by side by a thread: see [`together`].
    const SIDE_BY_SIDE: usize = 1;

    /// Makes at least one and up to `at_most` (above 0) iterations; how many were made. It should return after about
    /// 0.1 s, because a caller that wants to stop is heeded between two calls.
    ///
    /// # Errors
    /// When no further iteration is possible.
    fn advance(&mut self, at_most: u32) -> Result<u32, LostState>;
}

/// What came of one of the worlds of a [`Batch`].
#[derive(Debug)]
pub struct Stepped<S> {
    /// The world; `None`: it panicked and is gone.
    pub world: Option<S>,
    /// Iterations that were not made.
    pub left: u32,
    /// Why not, unless the batch was cancelled.
    pub result: Result<(), LostState>,
}

/// A chunk of worlds takes about so long: taking it from the list then costs next to nothing.
const CHUNK: Duration = Duration::from_micros(20);

/// How long the caller looks for the end of what helpers have begun, before it sleeps.
const LOOK: Duration = Duration::from_micros(50);

/// A caller that comes back within this time finds helpers awake.
const MOST_GAP: Duration = Duration::from_micros(150);

/// Weight of the latest call in means over calls.
const WEIGHT: f64 = 0.1;

/// Threads that help to step worlds. They end when the pool is dropped.
///
/// Any number of threads may have a [`Batch`] at a time; they share the helpers.
pub struct StepPool<S> {
    invitations: Sender<Arc<Shared<S>>>,
    helpers: usize,
    /// How long a helper without work looks for more before it sleeps, ns.
    patience_ns: Arc<AtomicU64>,
    memory: Mutex<Memory>,
}

/// What earlier calls have shown.
#[derive(Default)]
struct Memory {
    kinds: BTreeMap<Kind, Known>,
    latest_end: Option<Instant>,
    /// Mean time between two calls, s.
    gap: f64,
}

/// Calls that cost about the same: powers of two of the number of worlds and of the mean number of iterations.
type Kind = (u32, u32);

#[derive(Default)]
struct Known {
    choice: Choice,
    /// Mean time that a world takes in a call, s; 0: not known.
    cost: f64,
}

impl<S: Steps> StepPool<S> {
    /// Starts `helpers` threads, or as many as the system allows. A caller of its own has a core, too, so that one less
    /// than there are cores is right.
    pub fn new(helpers: usize) -> Self {
        // An invitation that finds no room would only be one more for helpers that have not come yet.
        let (invitations, waiting) = bounded::<Arc<Shared<S>>>(helpers.max(1));
        let patience_ns = Arc::new(AtomicU64::new(0));
        let start = |number: usize| {
            let (waiting, patience) = (waiting.clone(), Arc::clone(&patience_ns));
            let help = move || {
                while let Some(batch) = next_invitation(&waiting, &patience) {
                    batch.help();
                }
            };
            std::thread::Builder::new().name(format!("ambf-step-{number}")).spawn(help).is_ok()
        };
        let helpers = (0..helpers).take_while(|number| start(*number)).count();
        Self { invitations, helpers, patience_ns, memory: Mutex::default() }
    }

    /// Begins to step worlds, each by a number of iterations. The thread that calls this has to
    /// [work](Batch::work_until) on the batch.
    pub fn begin(&self, worlds: impl IntoIterator<Item = (S, u32)>) -> Batch<'_, S> {
        let places: Vec<_> = worlds.into_iter().map(|(world, steps)| Place::new(world, steps)).collect();
        let (count, iterations) = (places.len(), places.iter().map(|place| u64::from(place.left)).sum());
        let begin = Instant::now();
        let kind = kind_of(count, iterations);
        let can_help = self.helpers > 0 && count > 1 && iterations > 0;
        let (way, cost) = if can_help { self.recall(kind, begin) } else { (Way::Alone, 0.0) };
        let work = match way {
            Way::Alone => Work::Alone { groups: groups_of(places, 1), next: 0, cancelled: false },
            Way::Helped => self.invite(groups_of(places, self.helpers + 1), cost),
        };
        Batch { pool: self, work, begin, kind, way: can_help.then_some(way), iterations }
    }

    /// `cost`: of a world, s.
    fn invite(&self, groups: Vec<Group<S>>, cost: f64) -> Work<S> {
        let size = groups.first().map_or(0, |group| group.0.len());
        let chunk = chunk_of(groups.len(), self.helpers + 1, cost * size as f64);
        let chunks = groups.len().div_ceil(chunk);
        let shared = Arc::new(Shared {
            next: AtomicUsize::new(0),
            unfinished: AtomicUsize::new(groups.len()),
            cancelled: AtomicBool::new(false),
            caller: std::thread::current(),
            chunk,
            groups: groups.into_iter().map(Mutex::new).collect(),
        });
        for _ in 1..chunks.min(self.helpers + 1) {
            let _ = self.invitations.try_send(Arc::clone(&shared));
        }
        Work::Helped { shared, claimed: 0..0 }
    }

    fn recall(&self, kind: Kind, now: Instant) -> (Way, f64) {
        let mut memory = self.memory.lock();
        if let Some(end) = memory.latest_end.take() {
            // A long pause says that sleeping is right, however long it was.
            let gap = now.duration_since(end).min(4 * MOST_GAP).as_secs_f64();
            memory.gap += WEIGHT * (gap - memory.gap);
        }
        let patience = if memory.gap < MOST_GAP.as_secs_f64() { 2.0 * memory.gap + 10e-6 } else { 0.0 };
        self.patience_ns.store((1e9 * patience) as u64, Ordering::Relaxed);
        memory.kinds.get(&kind).map_or((Way::Helped, 0.0), |known| (known.choice.way(), known.cost))
    }

    fn remember(&self, batch: &Batch<'_, S>, count: usize) {
        let Some(way) = batch.way else { return };
        let now = Instant::now();
        let took = now.duration_since(batch.begin);
        let mut memory = self.memory.lock();
        memory.latest_end = Some(now);
        let known = memory.kinds.entry(batch.kind).or_default();
        let threads = if way == Way::Helped { (self.helpers + 1).min(count) } else { 1 };
        let cost = took.as_secs_f64() * threads as f64 / count as f64;
        known.cost = if known.cost == 0.0 { cost } else { known.cost + WEIGHT * (cost - known.cost) };
        known.choice.record(way, batch.iterations, took);
    }
}

/// Worlds that are being stepped. Dropped before its end, it waits for what helpers have begun, and the worlds are
/// dropped, too.
pub struct Batch<'p, S: Steps> {
    pool: &'p StepPool<S>,
    work: Work<S>,
    begin: Instant,
    kind: Kind,
    /// `None`: there is nothing to choose.
    way: Option<Way>,
    iterations: u64,
}

enum Work<S> {
    /// For the caller, in turn.
    Alone { groups: Vec<Group<S>>, next: usize, cancelled: bool },
    /// For all. `claimed`: what the caller has taken from the list and not done yet.
    Helped { shared: Arc<Shared<S>>, claimed: Range<usize> },
}

impl<S: Steps> Batch<'_, S> {
    /// Steps worlds, then waits for those that helpers have begun, until the end or `deadline`; whether all is done.
    /// At least one advance is made, so that repeated calls come to an end whatever the deadline. It is meant for the
    /// thread that began the batch; another one would wait until its deadline.
    pub fn work_until(&mut self, deadline: Instant) -> bool {
        match &mut self.work {
            Work::Alone { groups, next, cancelled } => {
                while let Some(group) = groups.get_mut(*next) {
                    if !group.step(Some(deadline), || *cancelled) {
                        return false;
                    }
                    *next += 1;
                }
                true
            }
            Work::Helped { shared, claimed } => shared.work(claimed, deadline),
        }
    }

    /// Lets nothing begin that has not begun; what is being stepped stops after its present advance. The caller still
    /// has to work until the end.
    pub fn cancel(&mut self) {
        // Its time says nothing about other calls.
        self.way = None;
        match &mut self.work {
            Work::Alone { cancelled, .. } => *cancelled = true,
            Work::Helped { shared, .. } => shared.cancelled.store(true, Ordering::Relaxed),
        }
    }

    /// Works until the end; the worlds, in the order in which they were given.
    pub fn finish(mut self) -> Vec<Stepped<S>> {
        self.complete();
        let mut done = Vec::new();
        let mut take = |group: &mut Group<S>| done.extend(group.0.iter_mut().map(Place::take));
        match &mut self.work {
            Work::Alone { groups, .. } => groups.iter_mut().for_each(take),
            Work::Helped { shared, .. } => shared.groups.iter().for_each(|group| take(&mut group.lock())),
        }
        self.pool.remember(&self, done.len());
        done
    }

    fn complete(&mut self) {
        while !self.work_until(Instant::now() + Duration::from_secs(1)) {}
    }
}

impl<S: Steps> Drop for Batch<'_, S> {
    fn drop(&mut self) {
        if let Work::Helped { shared, .. } = &self.work {
            if shared.unfinished.load(Ordering::Acquire) > 0 {
                self.cancel();
                self.complete();
            }
        }
    }
}

/// A world, and what is left to do.
struct Place<S> {
    world: Option<S>,
    left: u32,
    result: Result<(), LostState>,
}

impl<S> Place<S> {
    fn new(world: S, steps: u32) -> Self {
        Self { world: Some(world), left: steps, result: Ok(()) }
    }

    fn take(&mut self) -> Stepped<S> {
        let result = std::mem::replace(&mut self.result, Ok(()));
        Stepped { world: self.world.take(), left: self.left, result }
    }
}

impl<S: Steps> Place<S> {
    fn is_done(&self) -> bool {
        self.left == 0 || self.result.is_err() || self.world.is_none()
    }

    /// Steps the world to its end, or until about `until`.
    fn step(&mut self, until: Option<Instant>, is_cancelled: impl Fn() -> bool) {
        let Self { world, left, result } = self;
        while *left > 0 && result.is_ok() && !is_cancelled() {
            let Some(present) = world.as_mut() else { return };
            match catch_unwind(AssertUnwindSafe(|| present.advance(*left))) {
                Ok(Ok(made)) => *left = left.saturating_sub(made.max(1)),
                Ok(Err(problem)) => *result = Err(problem),
                Err(_) => {
                    // Nobody knows in what state it is; what its destructor does is caught, too.
                    let _ = catch_unwind(AssertUnwindSafe(|| drop(world.take())));
                }
            }
            if until.is_some_and(|until| Instant::now() >= until) {
                return;
            }
        }
    }
}

/// Worlds that a thread steps side by side.
struct Group<S>(Vec<Place<S>>);

impl<S: Steps> Group<S> {
    /// Steps the worlds to their ends, or until about `until`; whether they are at their ends.
    fn step(&mut self, until: Option<Instant>, is_cancelled: impl Fn() -> bool) -> bool {
        let is_cancelled = &is_cancelled;
        let mut tasks: Vec<_> = self.0.iter_mut().map(|place| || place.step(until, is_cancelled)).collect();
        together::run(&mut tasks.iter_mut().map(|task| task as &mut dyn FnMut()).collect::<Vec<_>>());
        drop(tasks);
        is_cancelled() || self.0.iter().all(Place::is_done)
    }
}

/// Groups for so many threads, in the order of the worlds.
fn groups_of<S: Steps>(places: Vec<Place<S>>, threads: usize) -> Vec<Group<S>> {
    let size = places.len().div_ceil(threads).clamp(1, S::SIDE_BY_SIDE);
    let mut places = places.into_iter().peekable();
    std::iter::from_fn(|| places.peek().is_some().then(|| Group(places.by_ref().take(size).collect()))).collect()
}

/// What caller and helpers have in common.
struct Shared<S> {
    /// Who has taken the index of a group from the list has it alone.
    groups: Vec<Mutex<Group<S>>>,
    /// First group that nobody has taken.
    next: AtomicUsize,
    /// So many are taken at a time.
    chunk: usize,
    /// Groups that are not done.
    unfinished: AtomicUsize,
    cancelled: AtomicBool,
    caller: Thread,
}

impl<S: Steps> Shared<S> {
    /// Takes groups from the list; none are left if it is empty.
    fn claim(&self) -> Range<usize> {
        let count = self.groups.len();
        if self.next.load(Ordering::Relaxed) >= count {
            return count..count;
        }
        let first = self.next.fetch_add(self.chunk, Ordering::Relaxed).min(count);
        first..(first + self.chunk).min(count)
    }

    fn step(&self, index: usize, until: Option<Instant>) -> bool {
        self.groups[index].lock().step(until, || self.cancelled.load(Ordering::Relaxed))
    }

    /// What a helper does.
    fn help(&self) {
        loop {
            let claimed = self.claim();
            if claimed.is_empty() {
                return;
            }
            let count = claimed.len();
            for index in claimed {
                self.step(index, None);
            }
            self.finished(count);
        }
    }

    /// What the caller does; whether all is done.
    fn work(&self, claimed: &mut Range<usize>, deadline: Instant) -> bool {
        loop {
            if claimed.start >= claimed.end {
                *claimed = self.claim();
            }
            let Some(index) = claimed.clone().next() else { return self.wait(deadline) };
            if !self.step(index, Some(deadline)) {
                return false;
            }
            claimed.start = index + 1;
            self.finished(1);
        }
    }

    /// Waits for what helpers have begun; whether it is done.
    fn wait(&self, deadline: Instant) -> bool {
        let sleep = Instant::now() + LOOK;
        while self.unfinished.load(Ordering::Acquire) > 0 {
            let now = Instant::now();
            if now >= deadline {
                return false;
            }
            if now < sleep {
                std::hint::spin_loop();
            } else {
                std::thread::park_timeout(deadline - now);
            }
        }
        true
    }

    /// The locks of their places order what was done to worlds before this.
    fn finished(&self, count: usize) {
        if self.unfinished.fetch_sub(count, Ordering::AcqRel) == count {
            self.caller.unpark();
        }
    }
}

/// Waits for work; `None`: the pool is gone.
fn next_invitation<S>(waiting: &Receiver<Arc<Shared<S>>>, patience_ns: &AtomicU64) -> Option<Arc<Shared<S>>> {
    let patience = Duration::from_nanos(patience_ns.load(Ordering::Relaxed));
    if patience > Duration::ZERO {
        let begin = Instant::now();
        while begin.elapsed() < patience {
            match waiting.try_recv() {
                Ok(batch) => return Some(batch),
                Err(TryRecvError::Disconnected) => return None,
                Err(TryRecvError::Empty) => (0..8).for_each(|_| std::hint::spin_loop()),
            }
        }
    }
    waiting.recv().ok()
}

fn kind_of(count: usize, iterations: u64) -> Kind {
    let mean = iterations / count.max(1) as u64;
    (count.max(1).ilog2(), mean.max(1).ilog2())
}

/// Groups that are taken at a time, of `count` on so many `threads`, when one costs `cost` s.
fn chunk_of(count: usize, threads: usize, cost: f64) -> usize {
    let enough = if cost > 0.0 { (CHUNK.as_secs_f64() / cost) as usize } else { 1 };
    // Each thread gets several, so that all end at about the same time.
    enough.clamp(1, (count / (3 * threads)).max(1))
}

#[cfg(test)]
mod tests {
    use std::thread::ThreadId;

    use super::*;
    use crate::sim::Loss;

    /// Sums of a pseudo-random sequence, which depend on the order of steps.
    #[derive(Debug, Default)]
    struct Counter {
        number: u64,
        made: u32,
        /// Iterations in an advance.
        slice: u32,
        fails_at: Option<u32>,
        panics_at: Option<u32>,
        /// What it waits for before its first iteration.
        gate: Option<Arc<AtomicBool>>,
        thread: Option<ThreadId>,
    }

    impl Counter {
        fn new(number: u64) -> Self {
            Self { number, slice: 7, ..Self::default() }
        }
    }

    impl Steps for Counter {
        fn advance(&mut self, at_most: u32) -> Result<u32, LostState> {
            self.thread = Some(std::thread::current().id());
            while self.gate.as_ref().is_some_and(|gate| !gate.load(Ordering::Acquire)) {
                std::thread::yield_now();
            }
            let count = at_most.min(self.slice);
            for _ in 0..count {
                assert_ne!(Some(self.made), self.panics_at, "as wanted");
                if Some(self.made) == self.fails_at {
                    return Err(lost());
                }
                self.number = self.number.wrapping_mul(6364136223846793005).wrapping_add(u64::from(self.made));
                self.made += 1;
            }
            Ok(count)
        }
    }

    fn lost() -> LostState {
        let (body, command) = ("box".into(), "none".into());
        LostState { body, loss: Loss::NonFinite, joint: None, step: 1, command }
    }

    fn step(pool: &StepPool<Counter>, worlds: Vec<Counter>, steps: u32) -> Vec<Counter> {
        let done = pool.begin(worlds.into_iter().map(|world| (world, steps))).finish();
        done.into_iter().map(|done| done.world.expect("nobody panicked")).collect()
    }

    #[test]
    fn many_are_stepped_as_each_alone() {
        let pool = StepPool::new(3);
        for count in [0, 1, 2, 3, 8, 100] {
            let mut together: Vec<_> = (0..count).map(Counter::new).collect();
            let mut alone: Vec<_> = (0..count).map(Counter::new).collect();
            for steps in [1, 0, 50, 1] {
                together = step(&pool, together, steps);
                let mut left = steps;
                while left > 0 {
                    left -= alone.iter_mut().map(|world| world.advance(left).expect("no error")).max().unwrap_or(left);
                }
                let seen = |worlds: &[Counter]| worlds.iter().map(|w| (w.number, w.made)).collect::<Vec<_>>();
                assert_eq!(seen(&together), seen(&alone), "{count} worlds, {steps} steps");
            }
        }
    }

    #[test]
    fn nobody_waits_for_helpers_that_do_not_come() {
        let pool = StepPool::new(2);
        // Both helpers are held by the worlds of others.
        let gate = Arc::new(AtomicBool::new(false));
        std::thread::scope(|scope| {
            let held = scope.spawn(|| {
                let worlds: Vec<_> =
                    (0..3).map(|i| Counter { gate: Some(Arc::clone(&gate)), ..Counter::new(i) }).collect();
                step(&pool, worlds, 5)
            });
            let is_open = Arc::clone(&gate);
            let done = step(&pool, (0..50).map(Counter::new).collect(), 20);
            assert!(!is_open.load(Ordering::Acquire));
            assert!(done.iter().all(|world| world.made == 20));
            gate.store(true, Ordering::Release);
            assert!(held.join().unwrap().iter().all(|world| world.made == 5));
        });
    }

    #[test]
    fn helpers_take_part_and_their_worlds_come_back() {
        let gate = Arc::new(AtomicBool::new(false));
        // The caller is held by the first world until the helper has stepped the second one.
        struct Opens(Counter, Arc<AtomicBool>);
        impl Steps for Opens {
            fn advance(&mut self, at_most: u32) -> Result<u32, LostState> {
                let made = self.0.advance(at_most)?;
                if self.0.gate.is_none() {
                    self.1.store(true, Ordering::Release);
                }
                Ok(made)
            }
        }
        let pool = StepPool::new(1);
        let first = Counter { gate: Some(Arc::clone(&gate)), ..Counter::new(1) };
        let worlds = [Opens(first, Arc::clone(&gate)), Opens(Counter::new(2), Arc::clone(&gate))];
        let done = pool.begin(worlds.map(|world| (world, 3))).finish();
        let threads: Vec<_> = done.iter().map(|done| done.world.as_ref().and_then(|world| world.0.thread)).collect();
        assert_ne!(threads[0], threads[1]);
        assert!(done.iter().all(|done| done.left == 0));
    }

    #[test]
    fn what_goes_wrong_in_one_world_stays_there() {
        let pool = StepPool::new(2);
        let mut worlds: Vec<_> = (0..6).map(Counter::new).collect();
        worlds[1].fails_at = Some(4);
        worlds[4].panics_at = Some(9);
        let done = pool.begin(worlds.into_iter().map(|world| (world, 30))).finish();
        for (index, done) in done.iter().enumerate() {
            assert_eq!(done.result, if index == 1 { Err(lost()) } else { Ok(()) });
            assert_eq!(
                done.world.as_ref().map(|world| world.made),
                [Some(30), Some(4), None][[0, 1, 0, 0, 2, 0][index]]
            );
        }
    }

    #[test]
    fn a_cancelled_batch_ends_after_whole_advances() {
        let pool = StepPool::new(2);
        let mut batch = pool.begin((0..5).map(|i| (Counter::new(i), u32::MAX)));
        assert!(!batch.work_until(Instant::now()));
        batch.cancel();
        let done = batch.finish();
        for done in &done {
            let made = done.world.as_ref().expect("nobody panicked").made;
            assert_eq!((made % 7, made + done.left), (0, u32::MAX));
        }
    }

    #[test]
    fn a_batch_that_is_dropped_and_a_pool_without_helpers() {
        let pool = StepPool::new(0);
        drop(pool.begin([(Counter::new(1), u32::MAX)]));
        assert!(step(&pool, (0..9).map(Counter::new).collect(), 8).iter().all(|world| world.made == 8));
    }
}
