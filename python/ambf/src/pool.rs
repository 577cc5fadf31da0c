//! Many worlds at once, on threads that are kept.

use std::panic::{catch_unwind, AssertUnwindSafe};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;

use ambf_core::sim::LostState;
use crossbeam_channel::{bounded, unbounded, RecvTimeoutError, Sender};
use parking_lot::Mutex;
use pyo3::prelude::*;

use crate::errors;
use crate::world::{slice, Physics, World, SLICE};

type Job = Box<dyn FnOnce() + Send>;

/// Threads that wait for jobs.
struct Pool {
    jobs: Sender<Job>,
    /// The process that they are threads of: they are not there after a fork.
    process: u32,
}

static POOL: Mutex<Option<Pool>> = Mutex::new(None);

impl Pool {
    fn new() -> Self {
        let (jobs, waiting) = unbounded::<Job>();
        let count = std::thread::available_parallelism().map_or(1, usize::from);
        for number in 0..count {
            let waiting = waiting.clone();
            let work = move || waiting.iter().for_each(|job| job());
            // With fewer threads it takes longer; without any, sending fails and the caller does the work.
            let _ = std::thread::Builder::new().name(format!("ambf-step-{number}")).spawn(work);
        }
        Self { jobs, process: std::process::id() }
    }
}

/// Where jobs are left.
fn jobs() -> Sender<Job> {
    let mut pool = POOL.lock();
    if pool.as_ref().is_none_or(|pool| pool.process != std::process::id()) {
        // The channel of the parent process may have been in use when it forked: it is left as it is.
        std::mem::forget(pool.replace(Pool::new()));
    }
    pool.get_or_insert_with(Pool::new).jobs.clone()
}

/// What came of a job.
struct Done {
    index: usize,
    /// `None` after a panic.
    physics: Option<Physics>,
    result: Result<(), LostState>,
}

fn run(index: usize, mut physics: Physics, steps: u32, cancelled: &AtomicBool) -> Done {
    let mut left = steps;
    let stepped = catch_unwind(AssertUnwindSafe(|| {
        while left > 0 && !cancelled.load(Ordering::Relaxed) {
            left -= slice(&mut physics.stepper, left)?;
        }
        Ok(())
    }));
    match stepped {
        Ok(result) => Done { index, physics: Some(physics), result },
        Err(_) => Done { index, physics: None, result: Ok(()) },
    }
}

/// See `_ambf.pyi`.
#[pyfunction]
pub fn step_all(py: Python<'_>, worlds: Vec<Bound<'_, World>>, steps: Vec<u32>) -> PyResult<Vec<Option<Py<PyAny>>>> {
    let mut taken: Vec<Physics> = Vec::with_capacity(worlds.len());
    for world in &worlds {
        match world.get().take(py) {
            Ok(physics) => taken.push(physics),
            Err(error) => {
                for (world, physics) in worlds.iter().zip(taken) {
                    world.get().give(py, Some(physics))?;
                }
                return Err(error);
            }
        }
    }
    let count = taken.len();
    let cancelled = Arc::new(AtomicBool::new(false));
    let (sender, results) = bounded::<Done>(count);
    let jobs = jobs();
    for (index, (physics, steps)) in taken.into_iter().zip(steps).enumerate() {
        let (sender, cancelled) = (sender.clone(), Arc::clone(&cancelled));
        let job: Job = Box::new(move || {
            // There is room for the results of all.
            let _ = sender.send(run(index, physics, steps, &cancelled));
        });
        if let Err(refused) = jobs.send(job) {
            refused.into_inner()();
        }
    }
    drop(sender);
    let mut done: Vec<Option<Done>> = (0..count).map(|_| None).collect();
    let mut interrupted = None;
    loop {
        match py.detach(|| results.recv_timeout(SLICE)) {
            Ok(result) => {
                let index = result.index;
                done[index] = Some(result);
            }
            Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => {
                if let Err(error) = py.check_signals() {
                    cancelled.store(true, Ordering::Relaxed);
                    interrupted = interrupted.or(Some(error));
                }
            }
        }
    }
    let mut problems = Vec::with_capacity(count);
    for (world, done) in worlds.iter().zip(done) {
        let (physics, result) = done.map_or((None, Ok(())), |done| (done.physics, done.result));
        let is_lost = physics.is_none();
        world.get().give(py, physics)?;
        problems.push(match result {
            Err(problem) => Some(errors::non_finite(py, &problem).into_value(py).into_any()),
            Ok(()) if is_lost => Some(errors::closed(py).into_value(py).into_any()),
            Ok(()) => None,
        });
    }
    match interrupted {
        Some(error) => Err(error),
        None => Ok(problems),
    }
}
