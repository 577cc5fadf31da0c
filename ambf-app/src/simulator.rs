//! The life of `ambf_simulator`: loading, running, ending.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use ambf_core::bullet::SolverStatistics;
use ambf_core::comm::{Hub, Middleware, Rates};
use ambf_core::device::host::DeviceHost;
use ambf_core::files;
use ambf_core::scene::{load_with_progress, Loaded, Progress, SceneFiles, SceneOptions, SceneReport};
use ambf_core::sim::{
    Event, LossCause, Models, Playback, ReplayEnd, ReplayEnded, ReplayError, ReplayPlan, Runner, RunnerOptions,
    Simulation, DEFAULT_SUB_STEP,
};
use ambf_recording::{Header, LaterHeader, RecordError, RecordingError, Replay, ReplayFailure, Writer};
use crossbeam_channel::RecvTimeoutError;
use crtk::diagnostics::Board;
use ros_node::OwnMaster;
use thiserror::Error;

#[cfg(feature = "pictures")]
use crate::cameras::CameraService;
use crate::cli::{FollowedRecording, RosVersions, SimulatorOptions};
use crate::devices;
use crate::launch::{self, LaunchError};
use crate::recordings::{check_reached, RecordingDesk};
use crate::report::{report_at, Level, RateLimit};
use crate::ros::{DeviceReports, Extras, ModelHost, ModelReply, RosArguments, RosMiddleware, RosOptions};
#[cfg(feature = "pictures")]
use crate::ros::{PictureTopics, PointClouds};
#[cfg(feature = "ros2")]
use crate::ros::{Ros2Middleware, Ros2Options};
use crate::windows::{self, WindowParts, Windows, WindowsWanted};
use crate::{plugins, print_line, process, report, warn};

/// How often the main thread looks whether it should end.
const POLL: Duration = Duration::from_millis(50);

/// How often it is said how far loading is.
const TELL: Duration = Duration::from_secs(2);

/// Why the simulator could not run.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SimulatorError {
    /// Error when the launch file is of no use.
    #[error(transparent)]
    Launch(#[from] LaunchError),
    /// Error when the command line asks for something that does not exist.
    #[error("{0}")]
    Usage(String),
    /// Error when windows are asked for and cannot be opened.
    #[error("{0}")]
    Windows(String),
    /// Error when a recording is asked for and cannot be written.
    #[error("--record: {0}")]
    Record(#[from] RecordError),
    /// Error when a recording cannot be read, or its scene cannot be loaded.
    #[error("--replay: {0}")]
    Recording(#[from] RecordingError),
    /// Error when a recording has no beginning that can be replayed.
    #[error("--replay: {0}")]
    Replay(#[from] ReplayFailure),
    /// Error when a replay could not go on, or was another motion, which was said when it was found.
    #[error("--replay: {file} was not replayed to its end: {error}")]
    Replayed {
        /// The recording.
        file: String,
        /// Why.
        error: ReplayError,
    },
    /// Error when the physics thread ended by itself: a bug.
    #[error("the physics thread ended unexpectedly; this is a bug, please report it with the lines above")]
    Physics,
}

impl SimulatorError {
    /// Exit status of the program: 255 for a launch file and 1 for windows, as in the C++ program, 2 for wrong usage and
    /// recordings that cannot be written or replayed, 4 for a replay that differs from its recording, 1 for a bug.
    pub fn status(&self) -> i32 {
        match self {
            Self::Launch(_) => 255,
            Self::Replayed { error: ReplayError::Differs { .. }, .. } => 4,
            Self::Usage(_) | Self::Record(_) | Self::Recording(_) | Self::Replay(_) | Self::Replayed { .. } => 2,
            Self::Windows(_) | Self::Physics => 1,
        }
    }
}

/// Loads the scene and runs it until SIGINT, SIGTERM or `rosnode kill`. `arguments`: what the command line says to ROS.
///
/// # Errors
/// [`SimulatorError`]. Everything else that goes wrong is reported, and the simulation goes on with the rest.
pub fn run(options: &SimulatorOptions, arguments: RosArguments) -> Result<(), SimulatorError> {
    let stop = process::stop_flag();
    print_line!(
        "AMBF simulator {} (physics {} Hz{})",
        ambf_version::VERSION,
        options.physics_frequency,
        time_step(options)
    );
    let wants_windows = windows::are_wanted(options.show_gui)?;

    let begin = Instant::now();
    let has_windows = wants_windows != WindowsWanted::No;
    let arms = Board::default();
    let loaded = match &options.replay {
        Some(recording) => load_recording(options, recording)?,
        None => load_simulation(options, has_windows, &arms, &arguments)?,
    };
    let LoadedSimulation { simulation, devices, load_report, writer, header, playback } = loaded;
    if stop.load(Ordering::Acquire) {
        return Ok(());
    }
    print_summary(&simulation, begin.elapsed());
    let wanted = Wanted { windows: wants_windows, load_report, arms, writer, header, playback };
    let outcome = serve(simulation, devices, options, wanted, arguments, &stop);
    report!("stopped");
    outcome
}

fn time_step(options: &SimulatorOptions) -> String {
    if options.fixed_physics_step {
        format!(", fixed steps of {} s", options.speed_factor / f64::from(options.physics_frequency))
    } else {
        String::from(", simulated time follows the clock")
    }
}

/// What runs.
struct LoadedSimulation {
    simulation: Simulation,
    devices: DeviceHost,
    load_report: String,
    /// Of the recording, if one is asked for.
    writer: Option<Writer>,
    /// Of recordings that begin later.
    header: std::io::Result<LaterHeader>,
    /// What is replayed.
    playback: Option<(Playback, ReplayPlan)>,
}

/// What recordings say that they were made by.
const PROGRAM: &str = "ambf_simulator";

/// Loads the scene of a recording, where that begins.
fn load_recording(
    options: &SimulatorOptions,
    recording: &FollowedRecording,
) -> Result<LoadedSimulation, SimulatorError> {
    let since = SystemTime::now();
    let mut replay = Replay::open(&recording.file)?;
    replay.set_rates(rates(options));
    let (mut simulation, found) = replay.load(recording.changed_files)?;
    print_report(&found, options.verbose);
    if let Some(problem) = replay.problem() {
        warn!("--replay: {problem}");
    }
    let from = Some(recording.from).filter(|&from| from > 0.0);
    for (option, time) in [("--continue-at", recording.continue_at), ("--replay-from", from)] {
        check_reached(option, time, &replay).map_err(SimulatorError::Usage)?;
    }
    let header = LaterHeader::of(&simulation, PROGRAM, since);
    let record = |path: &PathBuf| Writer::start(path, &mut simulation, PROGRAM, false);
    let writer = options.record.as_ref().map(record).transpose()?;
    report!(
        "replaying {}: {} updates from {:.3} to {:.3} s, by {}",
        recording.file.display(),
        replay.updates(),
        replay.start_time(),
        replay.end_time(),
        replay.header().program
    );
    let plan = ReplayPlan {
        frequency: (1.0 / replay.mean_interval().max(1e-5)).max(1.0),
        speed: recording.speed,
        fast_until: recording.continue_at.unwrap_or(recording.from),
        leave_at: recording.continue_at,
    };
    let playback = replay.play().map_err(|error| SimulatorError::Usage(format!("--replay: {error}")))?;
    Ok(LoadedSimulation {
        simulation,
        devices: devices::none(),
        load_report: found.to_string(),
        writer,
        header,
        playback: Some((playback, plan)),
    })
}

fn rates(options: &SimulatorOptions) -> Option<Rates> {
    options.publish_frequency.map(|rates| Rates { min: rates.min, max: rates.max })
}

fn load_simulation(
    options: &SimulatorOptions,
    has_windows: bool,
    arms: &Board,
    arguments: &RosArguments,
) -> Result<LoadedSimulation, SimulatorError> {
    let physics = launch::physics(&options.physics).map_err(SimulatorError::Usage)?;
    let (launch, problems) = launch::read_strict(&options.launch_file)?;
    let (files, skipped) = launch::scene_files(Some(&launch), None, &options.model_files, &options.model_indexes);
    skipped.iter().for_each(|problem| report!("{problem}"));

    let since = SystemTime::now();
    let scene_options = SceneOptions {
        prefix: options.namespace.clone(),
        rates: rates(options),
        physics,
        default_profile: None,
        is_one_of_many: false,
        may_grow: devices::are_wanted(&options.devices),
        // Windows show the last minute.
        savable: has_windows,
        joint_wrenches: false,
    };
    let Loaded { scene, report: mut found } = load_telling(&files, &scene_options);
    found.files.insert(0, problems);
    print_report(&found, options.verbose);
    let sub_step = scene.sub_step.unwrap_or(DEFAULT_SUB_STEP);
    let mut simulation = Simulation::new(scene, sub_step);
    let header = LaterHeader::of(&simulation, PROGRAM, since);
    let record = |path: &PathBuf| match options.record_from_reset {
        false => Writer::start(path, &mut simulation, PROGRAM, false),
        true => {
            let header = Header::of(&simulation, PROGRAM).map_err(RecordError::Scene)?;
            files::folder_for(path)
                .map_err(|error| RecordError::Write { file: path.clone(), why: error.to_string() })?;
            let (recorder, writer) = Writer::create(path, &header, false)?;
            simulation.record_from_reset(recorder)?;
            Ok(writer)
        }
    };
    let writer = options.record.as_ref().map(record).transpose()?;
    let (devices, said) = devices::open(&launch, options, &mut simulation);
    said.iter().for_each(|line| report!("{line}"));
    let crtk = plugins::CrtkFiles {
        files: &options.crtk,
        versions: ros_versions(options),
        board: arms.clone(),
        arguments: arguments.clone(),
        seed: options.seed.map(u64::from),
    };
    plugins::load(&mut simulation, &launch.plugins, &options.plugins, crtk, options.verbose);
    Ok(LoadedSimulation { simulation, devices, load_report: found.to_string(), writer, header, playback: None })
}

/// Loads a scene; while that takes long, a line says every now and then how far it is.
fn load_telling(files: &SceneFiles, options: &SceneOptions) -> Loaded {
    let progress = Progress::default();
    std::thread::scope(|scope| {
        let (end, ended) = crossbeam_channel::bounded::<()>(0);
        let progress = &progress;
        let tell = move || {
            while ended.recv_timeout(TELL) == Err(RecvTimeoutError::Timeout) {
                report!("loading: {progress}");
            }
        };
        // Without a thread to say it, nothing is said.
        let _ = std::thread::Builder::new().name("loading".into()).spawn_scoped(scope, tell);
        let loaded = load_with_progress(files, options, progress);
        drop(end);
        loaded
    })
}

/// What windows and clients are to be shown.
struct Wanted {
    windows: WindowsWanted,
    load_report: String,
    /// Arms that are offered to CRTK clients.
    arms: Board,
    writer: Option<Writer>,
    header: std::io::Result<LaterHeader>,
    playback: Option<(Playback, ReplayPlan)>,
}

fn print_report(found: &SceneReport, verbose: bool) {
    let text = if verbose { found.verbose().to_string() } else { found.to_string() };
    for line in text.lines() {
        report_at(level_of(line), format_args!("{line}"));
    }
}

/// How important a line about a file is: problems are written as `PLACE: SEVERITY: SENTENCE`.
fn level_of(line: &str) -> Level {
    let at = |severity: &str| line.find(&format!(": {severity}: ")).unwrap_or(usize::MAX);
    let (error, warning) = (at("error"), at("warning"));
    if error < warning {
        Level::Error
    } else if warning < error {
        Level::Warn
    } else {
        Level::Info
    }
}

fn print_summary(simulation: &Simulation, took: Duration) {
    let scene = simulation.scene();
    // The environment is a model too, but nobody asked for it.
    print_line!(
        "loaded {} model(s): {} bodies, {} joints, in {:.2} s; Ctrl+C ends",
        scene.models.len() - 1,
        scene.bodies.len(),
        scene.joints.len(),
        took.as_secs_f64()
    );
}

fn serve(
    mut simulation: Simulation,
    mut devices: DeviceHost,
    options: &SimulatorOptions,
    wanted: Wanted,
    arguments: RosArguments,
    stop: &AtomicBool,
) -> Result<(), SimulatorError> {
    let hub = simulation.connect();
    let models = simulation.models();
    let link = simulation.window_link();
    let host = Arc::new(Host(models.clone()));
    let desk = Arc::new(RecordingDesk::new(simulation.recordings(), wanted.header, wanted.writer));
    // Before anybody can command something.
    hub.set_replaying(wanted.playback.is_some());
    // Clients of this simulator outlive it, and so does the master they need.
    let own_master = std::env::current_exe().map_or(OwnMaster::InProcess, OwnMaster::Program);
    let extras = Extras { clock: options.clock, tf: options.tf, devices: Arc::default(), arms: wanted.arms };
    extras.devices.set(devices.status());
    simulation.set_simulated_stamps(options.clock);
    #[cfg(feature = "ros2")]
    let ros2_options = Ros2Options { arguments: arguments.clone(), extras: extras.clone() };
    let ros_options = RosOptions { arguments, own_master, extras: extras.clone() };
    let versions = ros_versions(options);
    if versions.has_two() && cfg!(not(feature = "ros2")) {
        report!("this program was built without ROS 2");
    }
    #[cfg(feature = "ros2")]
    let mut ros2 = versions.has_two().then(|| {
        Ros2Middleware::new(ros2_options).with_models(Arc::clone(&host) as _).with_recordings(Arc::clone(&desk) as _)
    });
    let mut ros = versions
        .has_one()
        .then(|| RosMiddleware::new(ros_options).with_models(host).with_recordings(Arc::clone(&desk) as _));
    #[cfg(feature = "pictures")]
    let cameras = {
        let drawn = Drawn::default();
        ros = ros.map(|ros| drawn.on_one(ros));
        #[cfg(feature = "ros2")]
        {
            ros2 = ros2.map(|ros2| drawn.on_two(ros2));
        }
        (versions != RosVersions::None).then(|| CameraService::new(drawn.topics, drawn.clouds))
    };
    if options.hold && versions != RosVersions::None {
        hub.throttle().hold(Duration::MAX, hub.now_ns());
    }
    #[cfg(feature = "ros2")]
    if let Some(Err(error)) = ros2.as_mut().map(|ros2| ros2.start(Arc::clone(&hub))) {
        warn!("ROS 2 is not available: {error}; the simulation runs without");
    }
    if let Some(ros) = &mut ros {
        if let Err(error) = ros.start(Arc::clone(&hub)) {
            warn!("ROS is not available: {error}; the simulation runs without");
        }
    }
    let runner_options = RunnerOptions {
        frequency: f64::from(options.physics_frequency),
        fixed_step: options.fixed_physics_step,
        speed_factor: options.speed_factor,
    };
    let runner = match wanted.playback {
        Some((playback, plan)) => Runner::replay(simulation, runner_options, playback, plan),
        None => Runner::start(simulation, runner_options),
    };
    let parts = WindowParts {
        hub: Arc::clone(&hub),
        link,
        control: Arc::clone(runner.control()),
        models,
        load_report: wanted.load_report,
        desk: Arc::clone(&desk),
        #[cfg(feature = "pictures")]
        cameras,
    };
    let outcome = Windows::start(wanted.windows, parts, &devices).and_then(|mut windows| {
        let replayed = options.replay.as_ref().map(|recording| Replayed::new(recording, &hub));
        let mut followed = Followed { devices: &mut devices, reports: &extras.devices, desk: &desk, replayed };
        follow(&runner, &mut followed, &mut windows, ros.as_ref(), stop)
    });
    let replay_ended = runner.control().replay_ended().cloned();
    let simulation = runner.stop();
    devices.stop().iter().for_each(|line| report!("{line}"));
    if let Some(mut simulation) = simulation {
        plugins::close(&mut simulation);
        if options.verbose {
            report_solver(&simulation.take_solver_statistics());
        }
    }
    // The simulation is gone, and with it the end of the recording that it wrote to.
    desk.finish();
    if let Some(ros) = &mut ros {
        ros.stop();
    }
    #[cfg(feature = "ros2")]
    if let Some(ros2) = &mut ros2 {
        ros2.stop();
    }
    outcome?;
    match (replay_ended.map(|ended| ended.why), &options.replay) {
        (Some(ReplayEnd::Failed(error)), Some(recording)) => {
            Err(SimulatorError::Replayed { file: recording.file.display().to_string(), error })
        }
        _ => Ok(()),
    }
}

/// The versions of ROS that `options` ask for, or the environment if they ask for none.
fn ros_versions(options: &SimulatorOptions) -> RosVersions {
    if options.no_ros {
        return RosVersions::None;
    }
    let of = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    let said = || RosVersions::from_environment(|name| of(name).is_some(), of("ROS_VERSION").as_deref());
    options.ros.unwrap_or_else(said)
}

/// What cameras publish, and points that are drawn, on all versions of ROS.
#[cfg(feature = "pictures")]
#[derive(Default)]
struct Drawn {
    topics: Arc<PictureTopics>,
    clouds: Arc<PointClouds>,
}

#[cfg(feature = "pictures")]
impl Drawn {
    fn on_one(&self, ros: RosMiddleware) -> RosMiddleware {
        ros.with_pictures(Arc::clone(&self.topics)).with_point_clouds(Arc::clone(&self.clouds))
    }

    #[cfg(feature = "ros2")]
    fn on_two(&self, ros: Ros2Middleware) -> Ros2Middleware {
        ros.with_pictures(Arc::clone(&self.topics)).with_point_clouds(Arc::clone(&self.clouds))
    }
}

/// One line about the solver of profile `accurate`; nothing of other solvers, which count nothing.
fn report_solver(found: &SolverStatistics) {
    let SolverStatistics { islands_solved, islands_approximate, islands_iterated, .. } = found;
    if islands_solved + islands_approximate + islands_iterated == 0 {
        return;
    }
    report!(
        "solver: {islands_solved} islands solved, {islands_approximate} approximately, {islands_iterated} by sequential impulses; largest \
         residual {:.1e} m/s or rad/s, joint error {:.1e} m and {:.1e} rad, penetration {:.1e} m",
        found.residual,
        found.joint_gap,
        found.joint_angle,
        found.penetration
    );
}

/// Lets ROS clients add and remove models.
struct Host(Models);

impl ModelHost for Host {
    fn add(&self, file: &Path) -> Result<ModelReply, String> {
        let added = self.0.add(file).map_err(|error| error.to_string())?;
        added.report.lines().for_each(|line| report!("{line}"));
        report!("added {} from {}", added.key, file.display());
        Ok(ModelReply { model: added.key, message: added.report })
    }

    fn remove(&self, model: &str) -> Result<String, String> {
        let key = self.0.remove(model).map_err(|error| error.to_string())?;
        report!("removed {key}");
        Ok(key)
    }

    fn list(&self) -> Vec<(String, PathBuf)> {
        self.0.list().unwrap_or_default()
    }
}

/// What is said of simulated time that was not computed, s.
fn loss(recent: f64, total: f64, cause: LossCause) -> String {
    let lost = format!("{recent:.3} s of simulated time were not computed ({total:.3} s in all)");
    match cause {
        LossCause::Cost => format!("the scene is too heavy for this computer: {lost}"),
        LossCause::Clients => format!("clients held the simulation: {lost}"),
        LossCause::Changes => format!("models were added or removed, or everything was reset: {lost}"),
        _ => format!("the simulation did not run, because it was stopped or other programs had the processor: {lost}"),
    }
}

/// What is said of fixed steps that cost more than their period, s.
fn slow(cost: f64, period: f64) -> String {
    let (cost, period) = (cost * 1e3, period * 1e3);
    format!(
        "simulated time is slower than the clock: an iteration costs {cost:.2} ms, its period is {period:.2} ms; this is said \
         once. No time is lost with -t 1, it only comes later"
    )
}

/// What is looked after while the simulation runs.
struct Followed<'a> {
    devices: &'a mut DeviceHost,
    reports: &'a DeviceReports,
    desk: &'a RecordingDesk,
    replayed: Option<Replayed>,
}

/// What is said of a replay.
struct Replayed {
    file: String,
    hub: Arc<Hub>,
    told_refused: bool,
    /// It was said that it has ended.
    told_end: bool,
}

impl Replayed {
    fn new(recording: &FollowedRecording, hub: &Arc<Hub>) -> Self {
        let file = recording.file.display().to_string();
        Self { file, hub: Arc::clone(hub), told_refused: false, told_end: false }
    }

    /// Says what has become of it.
    fn follow(&mut self, ended: Option<&ReplayEnded>) {
        if self.hub.has_refused() && !std::mem::replace(&mut self.told_refused, true) {
            warn!(
                "a command or reset is refused, because a recording is replayed; this is said once. --continue-at SECONDS leaves the \
                 recording there"
            );
        }
        let Some(ended) = ended.filter(|_| !std::mem::replace(&mut self.told_end, true)) else { return };
        let ReplayEnded { why, is_paused, updates, sim_time, hash } = ended;
        let file = &self.file;
        let what = match why {
            ReplayEnd::Failed(error) => format!("--replay: {file}: {error}"),
            ReplayEnd::Over(Some(problem)) => format!("--replay: {problem}"),
            ReplayEnd::Left => format!("{file} is left"),
            _ => format!("{file} is over"),
        };
        let where_it_is =
            format!("{updates} updates were replayed, to {sim_time} s, where the state has the hash {hash:016x}");
        let then = match is_paused {
            true => "the simulation is paused: go on from here by resuming it (Ctrl+P in a window), or reset it",
            false => "from here on the simulation takes commands",
        };
        match why {
            ReplayEnd::Failed(_) | ReplayEnd::Over(Some(_)) => warn!("{what}; {where_it_is}; {then}"),
            _ => report!("{what}; {where_it_is}; {then}"),
        }
    }
}

/// Prints what the physics thread has to say until the program should end.
fn follow(
    runner: &Runner,
    Followed { devices, reports, desk, replayed }: &mut Followed<'_>,
    windows: &mut Windows,
    ros: Option<&RosMiddleware>,
    stop: &AtomicBool,
) -> Result<(), SimulatorError> {
    let mut empty_steps = RateLimit::default();
    let dismissed = || ros.is_some_and(RosMiddleware::is_dismissed);
    while !stop.load(Ordering::Acquire) && !dismissed() && !windows.were_closed() {
        let news = devices.news();
        for news in &news {
            report!("{}", devices.line(news));
        }
        windows.show_devices(devices, &news);
        desk.look_after();
        if let Some(replayed) = replayed {
            replayed.follow(runner.control().replay_ended());
        }
        if !devices.is_empty() {
            reports.set(devices.status());
        }
        match runner.events().recv_timeout(POLL) {
            Ok(Event::LostTime { recent, total, cause }) => warn!("{}", loss(recent, total, cause)),
            Ok(Event::Slow { cost, period }) => warn!("{}", slow(cost, period)),
            Ok(Event::Lost(problem)) => {
                warn!("{problem}; nothing of that step is published and the simulation is paused: reset it (topic Command/Reset) or end it");
            }
            Ok(Event::EmptySteps) => {
                if empty_steps.is_due() {
                    warn!("a client throttles with n_skip_steps 0, which never blocks");
                }
            }
            Ok(Event::Reset) => report!("reset"),
            Ok(Event::Notice(notice)) => {
                windows.show_notice(&notice);
                report!("{notice}");
            }
            Ok(_) | Err(RecvTimeoutError::Timeout) => (),
            Err(RecvTimeoutError::Disconnected) => return Err(SimulatorError::Physics),
        }
    }
    Ok(())
}
