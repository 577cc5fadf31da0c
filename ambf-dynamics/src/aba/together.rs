//! Several worlds side by side: trees that differ in numbers only move four at a time.
//!
//! Each world runs on a stack of its own, all on one thread. Where a tree is to move it waits until those of the others are, or the others
//! have ended; then trees with the same joints move in the registers of AVX2, and all go on. What a world does depends on its own numbers
//! only, to the bit.

use super::articulation::Articulation;

/// Number of worlds in a register.
pub const SIDE_BY_SIDE: usize = 4;

/// A free motion over h s that an articulation is to make.
#[derive(Debug, Clone, Copy)]
pub struct Request {
    pub(super) articulation: *mut Articulation<'static>,
    pub(super) h: f64,
}

impl Request {
    /// Makes it.
    ///
    /// # Safety
    /// Nobody else uses the articulation meanwhile.
    pub(super) unsafe fn answer(&self) {
        // SAFETY: by the contract of this function.
        unsafe { (*self.articulation).step_freely(self.h) }
    }
}

/// Whether worlds are computed side by side on this processor; else [`run`] runs one after the other.
pub fn is_supported() -> bool {
    #[cfg(target_arch = "x86_64")]
    return std::arch::is_x86_feature_detected!("avx2");
    #[cfg(not(target_arch = "x86_64"))]
    return false;
}

/// # Safety
/// None; as that of the other.
#[cfg(not(target_arch = "x86_64"))]
pub(super) unsafe fn wait(_: &Request) -> bool {
    false
}

/// Runs tasks, each of which moves a world.
#[cfg(not(target_arch = "x86_64"))]
pub fn run(tasks: &mut [&mut dyn FnMut()]) {
    tasks.iter_mut().for_each(|task| task());
}

#[cfg(target_arch = "x86_64")]
pub use stacks::run;
#[cfg(target_arch = "x86_64")]
pub(super) use stacks::wait;

#[cfg(target_arch = "x86_64")]
mod stacks {
    use std::cell::{Cell, RefCell};
    use std::panic::{catch_unwind, resume_unwind, AssertUnwindSafe};
    use std::thread::Result;

    use corosensei::stack::DefaultStack;
    use corosensei::{Coroutine, CoroutineResult, Yielder};

    use super::super::beside::Beside;
    use super::{is_supported, Request, SIDE_BY_SIDE};

    /// Size of a stack: as threads have it.
    const STACK: usize = 2 << 20;

    thread_local! {
        /// Where the world that runs on this thread waits; null: it does not.
        static WAITING: Cell<*const Yielder<(), Request>> = const { Cell::new(std::ptr::null()) };
        static STACKS: RefCell<Vec<DefaultStack>> = const { RefCell::new(Vec::new()) };
        static BESIDE: Cell<Beside> = Cell::default();
    }

    /// Waits until the request is answered; `false`: nobody will.
    ///
    /// # Safety
    /// The pointers of the request hold while it waits.
    pub unsafe fn wait(request: &Request) -> bool {
        let waiting = WAITING.get();
        // SAFETY: the coroutine that has set it runs, or this thread would not be here.
        let Some(yielder) = (unsafe { waiting.as_ref() }) else { return false };
        // SAFETY: the arena that this thread is in is that of the world, which waits.
        let arena = unsafe { bullet_sys::amb_arena_enter(std::ptr::null_mut()) };
        yielder.suspend(*request);
        // SAFETY: as above.
        unsafe { bullet_sys::amb_arena_enter(arena) };
        WAITING.set(waiting);
        true
    }

    /// A world on a stack of its own.
    type World = Coroutine<(), Request, Result<()>, DefaultStack>;

    /// Runs tasks, each of which moves a world, side by side on this thread until all have ended.
    ///
    /// # Panics
    /// If one of them does, when all have ended.
    pub fn run(tasks: &mut [&mut dyn FnMut()]) {
        let is_alone = tasks.len() < 2 || !is_supported() || !WAITING.get().is_null();
        let mut problem = None;
        for some in tasks.chunks_mut(if is_alone { 1 } else { SIDE_BY_SIDE }) {
            problem = run_some(some, is_alone).err().or(problem);
        }
        if let Some(problem) = problem {
            resume_unwind(problem);
        }
    }

    fn run_some(tasks: &mut [&mut dyn FnMut()], is_alone: bool) -> Result<()> {
        let stacks: Option<Vec<DefaultStack>> = if is_alone { None } else { tasks.iter().map(|_| stack()).collect() };
        // Without memory for stacks they run one after the other.
        let Some(stacks) = stacks else {
            return tasks.iter_mut().map(|task| catch_unwind(AssertUnwindSafe(task))).fold(Ok(()), Result::and);
        };
        let mut outcome = Ok(());
        let mut worlds: Vec<World> = tasks.iter_mut().zip(stacks).map(|(task, stack)| world(task, stack)).collect();
        let mut beside = BESIDE.take();
        beside.begin();
        let mut requests = Vec::with_capacity(worlds.len());
        loop {
            for world in worlds.iter_mut().filter(|world| !world.done()) {
                match world.resume(()) {
                    CoroutineResult::Yield(request) => requests.push(request),
                    CoroutineResult::Return(result) => outcome = outcome.and(result),
                }
                WAITING.set(std::ptr::null());
            }
            if requests.is_empty() {
                break;
            }
            // SAFETY: the processor has AVX2; worlds have trees of their own, which wait with them.
            unsafe { beside.answer(&requests) };
            requests.clear();
        }
        BESIDE.set(beside);
        STACKS.with_borrow_mut(|stacks| stacks.extend(worlds.into_iter().map(World::into_stack)));
        outcome
    }

    fn stack() -> Option<DefaultStack> {
        STACKS.with_borrow_mut(Vec::pop).or_else(|| DefaultStack::new(STACK).ok())
    }

    fn world(task: &mut &mut dyn FnMut(), stack: DefaultStack) -> World {
        let run = |yielder: &Yielder<(), Request>, ()| {
            WAITING.set(yielder);
            catch_unwind(AssertUnwindSafe(task))
        };
        // SAFETY: `run_some` lets it end before it returns, so that the task outlives it; a panic does not leave it.
        unsafe { Coroutine::with_stack_unchecked(stack, run) }
    }
}
