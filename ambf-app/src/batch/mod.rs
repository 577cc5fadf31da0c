//! Batch runs: a scene stepped as fast as it goes, without ROS and without a clock.

mod commands;
mod energy;
mod outputs;
#[cfg(feature = "pictures")]
mod pictures;
mod trace;

pub use commands::{Addressee, CommandError, Commands, Targets};
pub use energy::EnergyWriter;
#[cfg(feature = "pictures")]
pub use pictures::{PictureError, Pictures};
pub use trace::TraceWriter;

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use ambf_core::adf::{Launch, PluginEntry};
use ambf_core::bullet::SolverStatistics;
use ambf_core::files::{self, WriteError};
use ambf_core::scene::{load, Loaded, SceneOptions};
use ambf_core::sim::{LostState, Nearness, ReplayError, Simulation};
use ambf_recording::{RecordError, RecordingError, Replay, ReplayFailure, Step, Writer};
use thiserror::Error;

use outputs::Outputs;

use crate::cli::BatchOptions;
use crate::process::{self, cpu_seconds, peak_memory_mb};
use crate::recordings::check_reached;
use crate::{launch, plugins, report, warn};

/// Largest command file that is read, bytes.
const MAX_COMMANDS: u64 = 64 << 20;

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
    /// Error when a file cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// Error when pictures cannot be taken or written.
    #[cfg(feature = "pictures")]
    #[error(transparent)]
    Pictures(#[from] PictureError),
    /// Error when the state became non-finite or implausible.
    #[error(transparent)]
    Lost(#[from] LostState),
    /// Error when a recording cannot be written.
    #[error("--record: {0}")]
    Record(#[from] RecordError),
    /// Error when a recording has ended before the run was over.
    #[error("--record: {0}")]
    RecordingEnded(String),
    /// Error when a recording cannot be read.
    #[error("--replay: {0}")]
    Recording(#[from] RecordingError),
    /// Error when a recording cannot be replayed, or the replay is another motion.
    #[error("--replay: {0}")]
    Replay(#[from] ReplayFailure),
    /// Error when SIGINT or SIGTERM ended a run with plugins or files, after they were closed. Without these it ends the
    /// program at once.
    #[error("interrupted")]
    Interrupted,
}

impl BatchError {
    /// Exit status of the program: 1 usage, 2 loading or writing, 3 non-finite, 4 a replay that differs from its recording,
    /// 130 interrupted.
    pub fn status(&self) -> i32 {
        match self {
            Self::Usage(_) => 1,
            Self::Load(_) | Self::Commands(_) | Self::Write(_) | Self::Record(_) | Self::RecordingEnded(_) => 2,
            Self::Replay(ReplayFailure::Replay { error: ReplayError::Differs { .. }, .. }) => 4,
            Self::Recording(_) | Self::Replay(_) => 2,
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
/// Files are there when they are complete: when the run is over, however it ends.
///
/// A file that cannot be used at all ends the run before it starts. A broken element, such as a body whose mesh is
/// missing, is dropped as in the C++ program; the rest runs, and [`Summary::status`] tells.
///
/// # Errors
/// [`BatchError`].
pub fn run(options: &BatchOptions, warn: impl FnOnce(&str)) -> Result<Summary, BatchError> {
    let begin = Instant::now();
    let mut replay = options.replay.as_ref().map(|wanted| Replay::open(&wanted.file)).transpose()?;
    let LoadedScene { mut simulation, incomplete, plugins: listed } = match &mut replay {
        Some(replay) => load_recording(options, replay, warn)?,
        None => load_scene(options, warn)?,
    };
    let writer =
        options.record.as_ref().map(|path| Writer::start(path, &mut simulation, "ambf_batch", true)).transpose()?;
    if replay.is_none() {
        // Recorded, too: what plugins do while they begin is a part of the start.
        plugins::load(&mut simulation, &listed, &options.plugins, plugins::CrtkFiles::default(), false);
    }
    let plan = Plan::new(options, replay.as_ref());
    let (commands, mut outputs) = match prepare(options, &plan, &mut simulation) {
        Ok(prepared) => prepared,
        Err(problem) => {
            plugins::close(&mut simulation);
            simulation.stop_recording();
            if let Some(more) = writer.and_then(|writer| end_recording(writer, true)) {
                report!("--record: {more}");
            }
            return Err(problem);
        }
    };
    let load = begin.elapsed();

    let stop = (simulation.has_plugins() || !outputs.is_empty()).then(process::stop_flag);
    simulation.measure_bullet_time();
    let cpu_before = cpu_seconds();
    let mut cost = Cost::default();
    let mut run = Run {
        plan,
        simulation: &mut simulation,
        commands: &commands,
        outputs: &mut outputs,
        stop: stop.as_deref(),
        cost: &mut cost,
    };
    let outcome = run.all(replay.as_mut());
    plugins::close(&mut simulation);
    let cpu_s = cpu_seconds() - cpu_before;
    simulation.stop_recording();
    let steps = *outcome.as_ref().unwrap_or(&0);
    let recorded = writer.and_then(|writer| end_recording(writer, outcome.is_err())).map(BatchError::RecordingEnded);
    let mut problems = outcome.err().into_iter().chain(outputs.finish()).chain(recorded);
    if let Some(first) = problems.next() {
        problems.for_each(|problem| report!("{problem}"));
        return Err(first);
    }
    let solver = simulation.take_solver_statistics();
    if let Some(warning) = missed_rows(&solver) {
        warn!("{warning}");
    }
    Ok(Summary {
        steps,
        sim_s: simulation.sim_time(),
        load,
        wall: cost.wall,
        bullet: simulation.bullet_time(),
        cpu_s,
        tail: cost.tail,
        peak_rss_mb: peak_memory_mb(),
        bodies: simulation.scene().bodies.len(),
        joints: simulation.scene().joints.len(),
        incomplete,
        solver,
    })
}

/// Commands and outputs of a run.
fn prepare(
    options: &BatchOptions,
    plan: &Plan,
    simulation: &mut Simulation,
) -> Result<(Commands, Outputs), BatchError> {
    let names = unique_names(simulation);
    let commands = match &options.commands {
        Some(path) => {
            let file = path.display().to_string();
            let text =
                files::read_text(path, MAX_COMMANDS).map_err(|error| BatchError::Load(format!("{file}: {error}")))?;
            Commands::parse(&text, &file, &Targets::new(simulation.scene(), &names))?
        }
        None => Commands::default(),
    };
    let outputs = Outputs::create(options, plan, simulation, names)?;
    Ok((commands, outputs))
}

/// Completes a recording; what was wrong with it. If the run `failed` before its first update, there is nothing in it, and
/// the file would only be in the way of the next run.
fn end_recording(writer: Writer, failed: bool) -> Option<String> {
    let recorded = writer.finish();
    if failed && recorded.updates == 0 {
        let removed = std::fs::remove_file(&recorded.file);
        return removed.err().map(|error| format!("{}: {error}", recorded.file.display()));
    }
    recorded.problem
}

/// Residual from which a run is not as its file says, m/s or rad/s.
const LARGE_RESIDUAL: f64 = 1.0;

/// A warning where the solver of profile `accurate` missed contacts or joints by much.
fn missed_rows(found: &SolverStatistics) -> Option<String> {
    let SolverStatistics { islands_solved, islands_approximate, islands_iterated, residual, .. } = *found;
    (islands_approximate > 0 && residual >= LARGE_RESIDUAL).then(|| {
        format!(
            "warning: {islands_approximate} of {} groups of joints and contacts were solved approximately, the worst to {residual:.1e} m/s or \
             rad/s: light bodies between hard contacts, joints or motors that contradict each other; a smaller `--dt`, more inertia or less \
             `max motor impulse` helps",
            islands_solved + islands_approximate + islands_iterated
        )
    })
}

/// Wall time of steps.
#[derive(Default)]
struct Cost {
    wall: Duration,
    /// Of the last quarter of the steps, and their number.
    tail: (Duration, u64),
}

/// How many steps are made, and how.
#[derive(Debug, Clone, Copy)]
struct Plan {
    /// Of a recording.
    replayed: u64,
    /// Simulated time at which a recording is left, s.
    leave_at: f64,
    /// With commands of the user.
    own: u64,
    /// Interval of the latter, s.
    dt: f64,
    /// Interval of all, in the mean, s.
    mean_dt: f64,
}

impl Plan {
    fn new(options: &BatchOptions, replay: Option<&Replay>) -> Self {
        let dt = options.dt;
        let (Some(replay), Some(wanted)) = (replay, &options.replay) else {
            return Self { replayed: 0, leave_at: 0.0, own: options.steps, dt, mean_dt: dt };
        };
        let mean_dt = if replay.mean_interval() > 0.0 { replay.mean_interval() } else { dt };
        match wanted.continue_at {
            Some(leave_at) => {
                Self { replayed: replay.updates(), leave_at, own: wanted.steps.unwrap_or(0), dt, mean_dt }
            }
            None => {
                let replayed = wanted.steps.unwrap_or(u64::MAX).min(replay.updates());
                Self { replayed, leave_at: f64::INFINITY, own: 0, dt, mean_dt }
            }
        }
    }

    fn steps(&self) -> u64 {
        self.replayed.saturating_add(self.own)
    }
}

/// What a run works with.
struct Run<'a> {
    plan: Plan,
    simulation: &'a mut Simulation,
    commands: &'a Commands,
    outputs: &'a mut Outputs,
    stop: Option<&'a AtomicBool>,
    cost: &'a mut Cost,
}

impl Run<'_> {
    /// Makes all steps, or as many as come before it is stopped; how many were made.
    fn all(&mut self, replay: Option<&mut Replay>) -> Result<u64, BatchError> {
        let Some(replay) = replay else { return self.step(None) };
        self.outputs.write(self.simulation, 0)?;
        let made = self.follow(replay)?;
        // Where it is left is known only now.
        self.plan.replayed = made;
        self.outputs.end_at(self.simulation, self.plan.steps(), made)?;
        match self.plan.own {
            0 => Ok(made),
            _ => self.step(Some(made)),
        }
    }

    /// Replays a recording, until it is over or left; how many steps were made.
    fn follow(&mut self, replay: &mut Replay) -> Result<u64, BatchError> {
        let (mut made, mut lost) = (0, None);
        while made < self.plan.replayed && self.simulation.sim_time() < self.plan.leave_at {
            let begin = Instant::now();
            let step = replay.step(self.simulation)?;
            self.count(made + 1, begin.elapsed());
            match step {
                Step::Update => {
                    lost = None;
                    made += 1;
                    self.outputs.write(self.simulation, made)?;
                }
                Step::Lost(problem) => {
                    made += 1;
                    lost = Some(problem);
                }
                Step::End => break,
            }
            self.look_up()?;
        }
        if made == self.plan.replayed && self.plan.leave_at.is_infinite() && made == replay.updates() {
            // What stands behind the last step: its hash.
            replay.step(self.simulation)?;
        }
        lost.map_or(Ok(made), |lost| Err(lost.into()))
    }

    /// Makes steps with the user's commands, after those that were replayed, if any; how many there are in all.
    fn step(&mut self, replayed: Option<u64>) -> Result<u64, BatchError> {
        let before = replayed.unwrap_or(0);
        self.commands.apply(self.simulation, 0, self.plan.dt)?;
        for step in 0..=self.plan.own {
            if step > 0 {
                let begin = Instant::now();
                let outcome = self.simulation.iterate(self.plan.dt);
                outcome.map_err(|error| name_command(error, self.commands, self.simulation))?;
                self.count(before + step, begin.elapsed());
            }
            if step > 0 || replayed.is_none() {
                self.outputs.write(self.simulation, before + step)?;
            }
            if step > 0 {
                let begin = Instant::now();
                self.commands.apply(self.simulation, step, self.plan.dt)?;
                self.cost.wall += begin.elapsed();
            }
            if self.simulation.has_plugins() {
                plugins::say(self.simulation);
            }
            self.look_up()?;
        }
        Ok(before + self.plan.own)
    }

    fn count(&mut self, step: u64, took: Duration) {
        let steps = self.plan.steps();
        self.cost.wall += took;
        if step > steps - steps / 4 {
            self.cost.tail = (self.cost.tail.0 + took, self.cost.tail.1 + 1);
        }
    }

    fn look_up(&self) -> Result<(), BatchError> {
        match self.stop.is_some_and(|stop| stop.load(Ordering::Acquire)) {
            true => Err(BatchError::Interrupted),
            false => Ok(()),
        }
    }
}

fn load_recording(
    options: &BatchOptions,
    replay: &mut Replay,
    warn: impl FnOnce(&str),
) -> Result<LoadedScene, BatchError> {
    let tolerant = options.replay.as_ref().is_some_and(|wanted| wanted.changed_files);
    let (simulation, report) = replay.load(tolerant)?;
    warn(report.to_string().trim_end());
    if let Some(problem) = replay.problem() {
        warn!("warning: --replay: {problem}");
    }
    let leave_at = options.replay.as_ref().and_then(|wanted| wanted.continue_at);
    check_reached("--continue-at", leave_at, replay).map_err(BatchError::Usage)?;
    Ok(LoadedScene { simulation, incomplete: report.errors() > 0, plugins: Vec::new() })
}

/// A loaded scene.
struct LoadedScene {
    simulation: Simulation,
    /// Elements had to be dropped.
    incomplete: bool,
    /// Plugins that the launch file lists.
    plugins: Vec<PluginEntry>,
}

fn load_scene(options: &BatchOptions, warn: impl FnOnce(&str)) -> Result<LoadedScene, BatchError> {
    let physics = launch::physics(&options.physics).map_err(BatchError::Usage)?;
    let launch = read_launch(options)?;
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
    Ok(LoadedScene {
        simulation: Simulation::new(scene, options.dt),
        incomplete: report.errors() > 0,
        plugins: launch.map(|launch| launch.plugins).unwrap_or_default(),
    })
}

/// The launch file, if it has to be read. One without devices or colours is fine.
fn read_launch(options: &BatchOptions) -> Result<Option<Launch>, BatchError> {
    if !options.needs_launch_file() {
        return Ok(None);
    }
    let loaded = ambf_core::adf::load(&options.launch_file);
    Ok(Some(loaded.map_err(|error| BatchError::Load(format!("launch file {error}")))?.0))
}

/// Names the line of the command file with the last command of the lost body, or of the nearest to it.
fn name_command(mut error: LostState, commands: &Commands, simulation: &Simulation) -> LostState {
    let scene = simulation.scene();
    let lost = scene.bodies.position(|body| body.identity.key() == error.body).map(|body| simulation.nearness(body));
    let near = |to| match (to, &lost) {
        (Addressee::Body(body), Some(near)) => near[body],
        _ => Nearness::Apart,
    };
    if let Some((place, to)) = commands.latest(u64::from(error.step), near) {
        let identity = match to {
            Addressee::Body(body) => &scene.bodies[body].identity,
            Addressee::Vehicle(vehicle) => &scene.vehicles[vehicle].identity,
            Addressee::Volume(volume) => &scene.volumes[volume].attached.identity,
        };
        error.command = format!("{place} to `{}`", identity.key());
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
