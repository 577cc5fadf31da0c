//! Recordings: of worlds that are stepped here, and replayed in worlds of their own.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use ambf_core::sim::Stepper;
use ambf_core::text;
use ambf_recording::Step;
use parking_lot::Mutex;
use pyo3::prelude::*;

use crate::errors;
use crate::world::{Physics, World, SLICE};

/// A recording that is replayed; see `_ambf.pyi`.
#[pyclass(frozen, module = "ambf._ambf")]
pub struct Replay {
    replay: Mutex<ambf_recording::Replay>,
}

#[pymethods]
impl Replay {
    /// A recording, and a world at its beginning.
    #[staticmethod]
    fn open(py: Python<'_>, file: PathBuf, changed_files: bool) -> PyResult<(Self, World)> {
        let opened = py.detach(|| {
            let mut replay = ambf_recording::Replay::open(&file).map_err(|error| error.to_string())?;
            let (simulation, report) = replay.load(changed_files).map_err(|error| error.to_string())?;
            let interval = if replay.mean_interval() > 0.0 { replay.mean_interval() } else { simulation.sub_step() };
            Ok((replay, Stepper::at_rest(simulation, interval), report))
        });
        let (replay, stepper, report) = opened.map_err(|problem: String| errors::recording(py, &problem))?;
        let warnings = report.to_string().lines().map(|line| text::lines(line).into_owned()).collect();
        let slot = Arc::new(Mutex::new(crate::world::Slot::Away));
        let world = World::around(py, slot, Physics::new(stepper), warnings, 0)?;
        Ok((Self { replay: Mutex::new(replay) }, world))
    }

    /// Program and processor that recorded; updates, mean interval, and time at the end.
    fn about(&self) -> (String, String, u64, f64, f64) {
        let replay = self.replay.lock();
        let header = replay.header();
        let (program, processor) = (header.program.clone(), header.processor.clone());
        (program, processor, replay.updates(), replay.mean_interval(), replay.end_time())
    }

    /// How it ended, and a sentence where it is not whole.
    fn ended(&self) -> (String, Option<String>) {
        let replay = self.replay.lock();
        (replay.ended().to_owned(), replay.problem().map(str::to_owned))
    }

    /// World file, model files, and all files with their SHA-256.
    #[allow(clippy::type_complexity, reason = "of Python")]
    fn files(&self) -> (Option<PathBuf>, Vec<PathBuf>, Vec<(PathBuf, String)>) {
        let replay = self.replay.lock();
        let header = replay.header();
        let used = header.used.iter().map(|file| (file.path.clone(), file.sha256.clone())).collect();
        (header.files.world.clone(), header.files.models.clone(), used)
    }

    /// Times and texts of what was noted.
    fn notes(&self) -> Vec<(f64, String)> {
        self.replay.lock().notes().to_vec()
    }

    /// What was commanded last: position of each joint, and pose of each body, in the order of the arrays of a world; NaN
    /// where nothing was.
    fn targets(&self, world: &World) -> (Vec<f64>, Vec<[f64; 7]>) {
        let replay = self.replay.lock();
        let targets = replay.targets();
        let (bodies, joints) = world.ids();
        let joint = |joint| targets.joints.get(joint).copied().unwrap_or(f64::NAN);
        let body = |body| targets.bodies.get(body).copied().unwrap_or([f64::NAN; 7]);
        (joints.iter().map(joint).collect(), bodies.iter().map(body).collect())
    }

    /// Lets a world do what it did in at most `updates` updates, and until `until` s; how many were made, and whether the
    /// recording is over. Its states are shown after the last.
    fn advance(&self, py: Python<'_>, world: &World, updates: u64, until: f64) -> PyResult<(u64, bool)> {
        let mut physics = world.take_away(py)?;
        let (mut made, mut is_over) = (0, false);
        let mut problem = None;
        while made < updates && !is_over && problem.is_none() && physics.stepper.simulation().sim_time() < until {
            let outcome = py.detach(|| {
                let mut replay = self.replay.lock();
                let begin = Instant::now();
                physics.stepper.follow(|simulation| {
                    let (mut count, mut ended) = (0, false);
                    while made + count < updates && simulation.sim_time() < until && begin.elapsed() < SLICE {
                        match replay.step(simulation)? {
                            Step::Update | Step::Lost(_) => count += 1,
                            Step::End => {
                                ended = true;
                                break;
                            }
                        }
                    }
                    Ok::<_, ambf_recording::ReplayFailure>((count, ended))
                })
            });
            match outcome {
                Ok((count, ended)) => (made, is_over) = (made + count, ended),
                Err(failure) => problem = Some(errors::recording(py, &failure.to_string())),
            }
            problem = problem.or_else(|| py.check_signals().err());
        }
        world.give(py, Some(physics))?;
        problem.map_or(Ok((made, is_over)), Err)
    }
}
