//! Many worlds at once, on threads that are kept.

use std::collections::HashMap;
use std::panic::{catch_unwind, AssertUnwindSafe};
use std::sync::Arc;
use std::time::Instant;

use ambf_core::sim::{LostState, StepPool, Stepped, Steps};
use ambf_core::together;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use parking_lot::Mutex;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::errors;
use crate::world::{slice, Physics, World, SLICE};

impl Steps for Physics {
    const SIDE_BY_SIDE: usize = together::SIDE_BY_SIDE;

    fn advance(&mut self, at_most: u32) -> Result<u32, LostState> {
        slice(&mut self.stepper, at_most)
    }
}

/// The pool, and the process that its threads belong to: they are not there after a fork.
static POOL: Mutex<Option<(u32, Arc<StepPool<Physics>>)>> = Mutex::new(None);

fn pool() -> Arc<StepPool<Physics>> {
    let mut kept = POOL.lock();
    let process = std::process::id();
    match &*kept {
        Some((owner, pool)) if *owner == process => Arc::clone(pool),
        _ => {
            // The caller is a thread, too.
            let helpers = std::thread::available_parallelism().map_or(0, |count| count.get() - 1);
            let made = Arc::new(StepPool::new(helpers));
            // The pool of the parent process may have been in use when it forked: it is left as it is.
            std::mem::forget(kept.replace((process, Arc::clone(&made))));
            made
        }
    }
}

/// Iterations of each world.
#[derive(FromPyObject)]
pub enum Counts {
    Same(u32),
    Each(Vec<u32>),
}

/// See `_ambf.pyi`.
#[pyfunction]
pub fn step_all(
    py: Python<'_>,
    worlds: Vec<Bound<'_, World>>,
    steps: Counts,
) -> PyResult<Option<Vec<Option<Py<PyAny>>>>> {
    if let Counts::Each(steps) = &steps {
        if steps.len() != worlds.len() {
            let problem = format!("{} numbers of steps for {} simulations", steps.len(), worlds.len());
            return Err(PyValueError::new_err(problem));
        }
    }
    let mut places = HashMap::new();
    for (index, world) in worlds.iter().enumerate() {
        if let Some(first) = places.insert(world.as_ptr(), index) {
            let problem = format!("simulations {first} and {index} are the same one: each can be given once");
            return Err(PyValueError::new_err(problem));
        }
    }
    let steps_of = |index: usize| match &steps {
        Counts::Same(steps) => *steps,
        Counts::Each(steps) => steps[index],
    };
    if let [world] = &worlds[..] {
        // Threads could do nothing for it.
        let (stepped, interrupted) = step_alone(py, world.get().take(py)?, steps_of(0));
        return give_all(py, &worlds, [stepped], interrupted);
    }
    let taken = take_all(py, &worlds)?;
    let pool = pool();
    let mut batch = pool.begin(taken.into_iter().enumerate().map(|(index, physics)| (physics, steps_of(index))));
    let mut interrupted = None;
    while !py.detach(|| batch.work_until(Instant::now() + SLICE)) {
        if let Err(error) = py.check_signals() {
            batch.cancel();
            interrupted.get_or_insert(error);
        }
    }
    give_all(py, &worlds, batch.finish(), interrupted)
}

/// Steps a world in this thread, until it is done, fails or is interrupted.
fn step_alone(py: Python<'_>, physics: Physics, steps: u32) -> (Stepped<Physics>, Option<PyErr>) {
    let mut stepped = Stepped { world: Some(physics), left: steps, result: Ok(()) };
    while let (Some(physics), 1..) = (&mut stepped.world, stepped.left) {
        let left = stepped.left;
        match py.detach(|| catch_unwind(AssertUnwindSafe(|| slice(&mut physics.stepper, left)))) {
            Ok(Ok(made)) => stepped.left -= made,
            Ok(Err(problem)) => {
                stepped.result = Err(problem);
                break;
            }
            Err(_) => {
                // Nobody knows in what state it is; what its destructor does is caught, too.
                let world = stepped.world.take();
                let _ = py.detach(|| catch_unwind(AssertUnwindSafe(|| drop(world))));
            }
        }
        if stepped.left > 0 {
            if let Err(interrupted) = py.check_signals() {
                return (stepped, Some(interrupted));
            }
        }
    }
    (stepped, None)
}

/// Gives all back, also after an array that could not be written; what went wrong in each, or `None` if nothing did.
fn give_all(
    py: Python<'_>,
    worlds: &[Bound<'_, World>],
    stepped: impl IntoIterator<Item = Stepped<Physics>>,
    interrupted: Option<PyErr>,
) -> PyResult<Option<Vec<Option<Py<PyAny>>>>> {
    let mut problems: Option<Vec<_>> = None;
    let mut refreshed = Ok(());
    for (index, (world, done)) in worlds.iter().zip(stepped).enumerate() {
        let problem = match (&done.result, &done.world) {
            (Err(problem), _) => Some(errors::non_finite(py, problem)),
            (Ok(()), None) => Some(errors::closed(py)),
            (Ok(()), Some(_)) => None,
        };
        refreshed = refreshed.and(world.get().give(py, done.world));
        if let Some(problem) = problem {
            let all = problems.get_or_insert_with(|| worlds.iter().map(|_| None).collect());
            all[index] = Some(problem.into_value(py).into_any());
        }
    }
    refreshed?;
    match interrupted {
        Some(error) => Err(error),
        None => Ok(problems),
    }
}

/// Iterations, simulated times, and numbers of several worlds.
type Stacked<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>);

/// See `_ambf.pyi`.
#[pyfunction]
pub fn stack_states<'py>(py: Python<'py>, worlds: Vec<Bound<'py, World>>) -> PyResult<Stacked<'py>> {
    let mut numbers = Vec::new();
    let mut width = 0;
    for (index, world) in worlds.iter().enumerate() {
        world.get().append_states(py, &mut numbers)?;
        numbers.push(0.0);
        if index == 0 {
            width = numbers.len();
            numbers.reserve(width * (worlds.len() - 1));
        }
        if numbers.len() != width * (index + 1) {
            let problem =
                format!("simulation {index} has other numbers of bodies, joints, rays or actuators than the first");
            return Err(PyValueError::new_err(problem));
        }
    }
    let (steps, times): (Vec<_>, Vec<_>) = worlds.iter().map(|world| world.get().shown()).unzip();
    let steps = PyArray1::from_vec(py, steps);
    let numbers = PyArray1::from_vec(py, numbers).reshape([worlds.len(), width])?;
    Ok((steps, PyArray1::from_vec(py, times), numbers))
}

/// See `_ambf.pyi`.
#[pyfunction]
pub fn shared_shapes() -> usize {
    ambf_core::scene::shared_shapes()
}

/// See `_ambf.pyi`.
#[pyfunction]
pub fn shared_descriptions() -> usize {
    ambf_core::scene::shared_descriptions()
}

/// Takes the physics of all worlds, or of none.
fn take_all(py: Python<'_>, worlds: &[Bound<'_, World>]) -> PyResult<Vec<Physics>> {
    let mut taken: Vec<Physics> = Vec::with_capacity(worlds.len());
    for world in worlds {
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
    Ok(taken)
}
