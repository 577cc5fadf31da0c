//! Batch runs: a scene stepped as fast as it goes, without ROS and without a clock.

mod commands;
mod energy;
#[cfg(feature = "pictures")]
mod pictures;
mod trace;

pub use commands::{CommandError, Commands, Targets};
pub use energy::EnergyWriter;
#[cfg(feature = "pictures")]
pub use pictures::{PictureError, Pictures};
pub use trace::TraceWriter;

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use ambf_core::bullet::SolverStatistics;
use ambf_core::scene::{load, Loaded, SceneOptions};
use ambf_core::sim::{LostState, Simulation};
use thiserror::Error;

use crate::cli::BatchOptions;
use crate::launch;
use crate::plugins;
use crate::process::{self, cpu_seconds, peak_memory_mb};

/// Why a batch run ended early.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum BatchError {
    /// Error when the command line asks for something that does not exist.
    #[error("{0}")]
    Usage(String),
    /// Error when a file could not be loaded.
    #[error("{0}")]
    Load(String),
    /// Error when a command file cannot be used.
    #[error(transparent)]
    Commands(#[from] CommandError),
    /// Error when a trace cannot be written.
    #[error("cannot write the trace {}: {source}", prefix.display())]
    Trace {
        /// Where it should be.
        prefix: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Error when the energy ledger cannot be written.
    #[error("cannot write the energy ledger {}: {source}", path.display())]
    Energy {
        /// Where it should be.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Error when pictures cannot be taken or written.
    #[cfg(feature = "pictures")]
    #[error(transparent)]
    Pictures(#[from] PictureError),
    /// Error when the state became non-finite or implausible.
    #[error(transparent)]
    Lost(#[from] LostState),
    /// Error when SIGINT or SIGTERM ended a run with plugins, after they were closed. Without plugins these end the
    /// program at once.
    #[error("interrupted")]
    Interrupted,
}

impl BatchError {
    /// Exit status of the program: 1 usage, 2 loading, 3 non-finite, 130 interrupted.
    pub fn status(&self) -> i32 {
        match self {
            Self::Usage(_) => 1,
            Self::Load(_) | Self::Commands(_) | Self::Trace { .. } | Self::Energy { .. } => 2,
            #[cfg(feature = "pictures")]
            Self::Pictures(PictureError::Camera(_) | PictureError::Twice(_)) => 1,
            #[cfg(feature = "pictures")]
            Self::Pictures(_) => 2,
            Self::Lost(_) => 3,
            Self::Interrupted => 130,
        }
    }
}

/// What a run cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    steps: u64,
    sim_s: f64,
    load: Duration,
    /// Stepping only.
    wall: Duration,
    bullet: Duration,
    cpu_s: f64,
    /// Wall time of the last quarter of the steps, and their number.
    tail: (Duration, u64),
    peak_rss_mb: f64,
    bodies: usize,
    joints: usize,
    /// The scene is not what its files say: elements had to be dropped.
    incomplete: bool,
    solver: SolverStatistics,
}

impl Summary {
    /// Exit status of the program: 0, or 2 when elements of the scene had to be dropped.
    pub fn status(&self) -> i32 {
        if self.incomplete {
            2
        } else {
            0
        }
    }

    /// One line of JSON. Times in s, a step's in µs, memory in MB; of the solver, sums and maxima over the run.
    pub fn to_json(&self) -> String {
        let per_step = |time: Duration, steps: u64| time.as_secs_f64() * 1e6 / steps.max(1) as f64;
        let solver = &self.solver;
        format!(
            "{{\"steps\":{},\"sim_s\":{},\"load_s\":{:.6},\"wall_s\":{:.6},\"us_per_step\":{:.4},\"bullet_us_per_step\":{:.4},\
             \"peak_rss_mb\":{:.1},\"bodies\":{},\"joints\":{},\"cpu_s\":{:.6},\"tail_us_per_step\":{:.4},\
             \"islands_solved\":{},\"islands_approximate\":{},\"islands_iterated\":{},\"position_problems\":{},\
             \"divided_sub_steps\":{},\"rows\":{},\"factorisations\":{},\"pivots\":{},\"sweeps\":{},\"residual\":{:e},\"joint_gap_m\":{:e},\"joint_angle_rad\":{:e},\
             \"penetration_m\":{:e}}}",
            self.steps,
            self.sim_s,
            self.load.as_secs_f64(),
            self.wall.as_secs_f64(),
            per_step(self.wall, self.steps),
            per_step(self.bullet, self.steps),
            self.peak_rss_mb,
            self.bodies,
            self.joints,
            self.cpu_s,
            per_step(self.tail.0, self.tail.1),
            solver.islands_solved,
            solver.islands_approximate,
            solver.islands_iterated,
            solver.position_problems,
            solver.divided_sub_steps,
            solver.rows,
            solver.factorisations,
            solver.pivots,
            solver.sweeps,
            solver.residual,
            solver.joint_gap,
            solver.joint_angle,
            solver.penetration,
        )
    }
}

/// Loads the scene, steps it, writes the traces. Problems of the scene go to `warn`.
///
/// A file that cannot be used at all ends the run before it starts. A broken element, such as a body whose mesh is
/// missing, is dropped as in the C++ program; the rest runs, and [`Summary::status`] tells.
///
/// # Errors
/// [`BatchError`].
pub fn run(options: &BatchOptions, warn: impl FnOnce(&str)) -> Result<Summary, BatchError> {
    let begin = Instant::now();
    let (mut simulation, incomplete) = load_scene(options, warn)?;
    let names = unique_names(&simulation);
    let commands = match &options.commands {
        Some(path) => {
            let file = path.display().to_string();
            let text = std::fs::read_to_string(path).map_err(|error| BatchError::Load(format!("{file}: {error}")))?;
            Commands::parse(&text, &file, &Targets::new(simulation.scene(), &names))?
        }
        None => Commands::default(),
    };
    let trace_error = |source| BatchError::Trace { prefix: options.trace.clone().unwrap_or_default(), source };
    let mut trace = match &options.trace {
        Some(prefix) => Some(TraceWriter::create(prefix, &simulation, names, options.full).map_err(trace_error)?),
        None => None,
    };
    let energy_error = |source| BatchError::Energy { path: options.energy.clone().unwrap_or_default(), source };
    let mut energy = match &options.energy {
        Some(path) => Some(EnergyWriter::create(path, &mut simulation).map_err(energy_error)?),
        None => None,
    };
    #[cfg(feature = "pictures")]
    let mut pictures = match &options.pictures {
        Some(wanted) => Some(Pictures::create(wanted, &simulation, options.dt)?),
        None => None,
    };
    #[cfg(not(feature = "pictures"))]
    if options.pictures.is_some() {
        return Err(BatchError::Usage("--render: this program was built without pictures (feature `view`)".into()));
    }
    let load = begin.elapsed();

    let has_plugins = simulation.has_plugins();
    let stop = has_plugins.then(process::stop_flag);
    let cpu_before = cpu_seconds();
    let mut wall = Duration::ZERO;
    let mut tail = (Duration::ZERO, 0);
    commands.apply(&mut simulation, 0);
    for step in 0..=options.steps {
        if step > 0 {
            let begin = Instant::now();
            simulation.iterate(options.dt).map_err(|error| name_command(error, &commands, &simulation))?;
            let cost = begin.elapsed();
            wall += cost;
            if step > options.steps - options.steps / 4 {
                tail = (tail.0 + cost, tail.1 + 1);
            }
        }
        if step % options.every == 0 || step == options.steps {
            if let Some(trace) = &mut trace {
                trace.write(&simulation, step).map_err(trace_error)?;
            }
            if let Some(energy) = &mut energy {
                energy.write(&simulation, step).map_err(energy_error)?;
            }
        }
        #[cfg(feature = "pictures")]
        if let Some(pictures) = &mut pictures {
            pictures.take(&simulation, step)?;
        }
        if step > 0 {
            let begin = Instant::now();
            commands.apply(&mut simulation, step);
            wall += begin.elapsed();
        }
        if has_plugins {
            plugins::say(&mut simulation);
        }
        if stop.as_ref().is_some_and(|stop| stop.load(Ordering::Acquire)) {
            plugins::close(&mut simulation);
            return Err(BatchError::Interrupted);
        }
    }
    plugins::close(&mut simulation);
    let cpu_s = cpu_seconds() - cpu_before;
    if let Some(trace) = trace {
        trace.finish().map_err(trace_error)?;
    }
    if let Some(energy) = energy {
        energy.finish().map_err(energy_error)?;
    }
    #[cfg(feature = "pictures")]
    if let Some(pictures) = pictures {
        pictures.finish()?;
    }
    Ok(Summary {
        steps: options.steps,
        sim_s: simulation.sim_time(),
        load,
        wall,
        bullet: simulation.bullet_time(),
        cpu_s,
        tail,
        peak_rss_mb: peak_memory_mb(),
        bodies: simulation.scene().bodies.len(),
        joints: simulation.scene().joints.len(),
        incomplete,
        solver: simulation.take_solver_statistics(),
    })
}

fn load_scene(options: &BatchOptions, warn: impl FnOnce(&str)) -> Result<(Simulation, bool), BatchError> {
    let physics = launch::physics(&options.physics).map_err(BatchError::Usage)?;
    let launch = match options.needs_launch_file() {
        // A launch file without devices or colours is fine here.
        true => {
            let loaded = ambf_core::adf::load(&options.launch_file);
            Some(loaded.map_err(|error| BatchError::Load(format!("launch file {error}")))?.0)
        }
        false => None,
    };
    let (files, missing) =
        launch::scene_files(launch.as_ref(), options.world.as_deref(), &options.model_files, &options.model_indexes);
    if let Some(problem) = missing.into_iter().next() {
        return Err(BatchError::Load(problem));
    }
    let Loaded { scene, report } = load(&files, &SceneOptions { physics, ..SceneOptions::default() });
    if !report.refused.is_empty() {
        return Err(BatchError::Load(report.to_string().trim_end().to_owned()));
    }
    warn(report.to_string().trim_end());
    let mut simulation = Simulation::new(scene, options.dt);
    let listed = launch.as_ref().map(|launch| launch.plugins.as_slice()).unwrap_or_default();
    plugins::load(&mut simulation, listed, &options.plugins, plugins::CrtkFiles::default(), false);
    Ok((simulation, report.errors() > 0))
}

/// Names the line of the command file with the last command of the lost body.
fn name_command(mut error: LostState, commands: &Commands, simulation: &Simulation) -> LostState {
    let body = simulation.scene().bodies.position(|body| body.identity.key() == error.body);
    let latest = |body| commands.latest(body, u64::from(error.step));
    if let Some(place) = body.and_then(|body| simulation.commanders(body).find_map(latest)) {
        error.command = place;
    }
    error
}

/// Names of the bodies as in the ADF; later ones of the same name get the first free of the suffixes 1, 2, …
fn unique_names(simulation: &Simulation) -> Vec<String> {
    // Names that are taken, and the suffix up to which those of a name are.
    let mut taken: HashMap<String, u32> = HashMap::new();
    let mut unique = |name: &str| {
        let Some(mut suffix) = taken.get(name).copied() else {
            taken.insert(name.to_owned(), 0);
            return name.to_owned();
        };
        let candidate = loop {
            suffix += 1;
            let candidate = format!("{name}{suffix}");
            if !taken.contains_key(&candidate) {
                break candidate;
            }
        };
        taken.insert(name.to_owned(), suffix);
        taken.insert(candidate.clone(), 0);
        candidate
    };
    simulation.scene().bodies.iter().map(|body| unique(&body.identity.name)).collect()
}
