//! Options of `ambf_simulator`.

use super::values::{boolean, count, haptic_frequency, indexes, paths, positive, ros_versions, whole};
use super::{filter, launch_file, print_or_fail, utf8, CheckOptions, CliError, Parsed, PhysicsOptions};
use clap::{CommandFactory, FromArgMatches};
use std::ffi::OsString;
use std::path::PathBuf;

/// Model that is loaded when the command line names none.
const DEFAULT_MODEL: usize = 1;

/// What `ambf_simulator` was asked to do.
///
/// Paths are as typed: relative ones are relative to the working directory.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatorOptions {
    /// Input devices to load; default: none.
    pub devices: DeviceSelection,
    /// Whether forces may be sent to input devices; default: `false`.
    pub force_feedback: bool,
    /// Target frequency of the physics loop, in Hz, 1…100 000; default: 1000.
    pub physics_frequency: u32,
    /// Target frequency of each haptic loop, in Hz, 1…100 000; default: 1000.
    pub haptic_frequency: u32,
    /// `true`: each physics iteration simulates `speed_factor / physics_frequency` seconds; `false` (default): as much
    /// time as has passed on the clock.
    pub fixed_physics_step: bool,
    /// The same for the haptic loops; default: `false`.
    pub fixed_haptic_step: bool,
    /// Publish frequencies of all objects; `None` (default): each object's own.
    pub publish_frequency: Option<PublishFrequency>,
    /// Whether to open camera windows; default, `None`: where there is a display.
    pub show_gui: Option<bool>,
    /// Text put before the namespace of every object; default: empty.
    pub namespace: String,
    /// Simulated seconds per second on the clock with a fixed physics step, above 0; 1 (default) without.
    pub speed_factor: f64,
    /// Simulator plugins, in load order.
    pub plugins: Vec<PathBuf>,
    /// Configurations of arms that are offered to CRTK clients.
    pub crtk: Vec<PathBuf>,
    /// What differs from run to run is drawn from it. Default: nothing does.
    pub seed: Option<u32>,
    /// Launch file. It need not exist.
    pub launch_file: PathBuf,
    /// Model files, loaded first.
    pub model_files: Vec<PathBuf>,
    /// Indexes into the launch file's list of models, from 0, loaded after the files. May be out of range or repeated.
    pub model_indexes: Vec<usize>,
    /// Whether to run without any ROS communication; default: `false`.
    pub no_ros: bool,
    /// Which versions of ROS to talk; `None` (default): what the environment says.
    pub ros: Option<RosVersions>,
    /// Whether `/clock` is published, and stamps are simulated time; default: `false`.
    pub clock: bool,
    /// How often the poses of all bodies are published on `/tf`, Hz, with what is loaded as URDF beside; `None`
    /// (default): not at all.
    pub tf: Option<u32>,
    /// Whether to end the ROS master that was left behind, instead of simulating; default: `false`.
    pub end_master: bool,
    /// Whether the physics waits for the first step that a client asks for; default: `false`.
    pub hold: bool,
    /// Whether to print more about loading and running; default: `false`.
    pub verbose: bool,
    /// Solver and profile.
    pub physics: PhysicsOptions,
    /// Recording to write; `None`: none.
    pub record: Option<PathBuf>,
    /// Whether it begins with the first reset of the world instead of at the start; default: `false`.
    pub record_from_reset: bool,
    /// Recording to replay instead of simulating the models that are named; `None`: simulate.
    pub replay: Option<FollowedRecording>,
    /// Files to check instead of simulating; `None`: simulate.
    pub check: Option<CheckOptions>,
    /// Whether to say what this machine can do, instead of simulating; default: `false`.
    pub doctor: bool,
}

/// A recording, and how it is followed.
#[derive(Debug, Clone, PartialEq)]
pub struct FollowedRecording {
    /// Its file.
    pub file: PathBuf,
    /// Simulated seconds per second on the clock, above 0; default: 1.
    pub speed: f64,
    /// Simulated time up to which it goes as fast as it can, s; default: 0.
    pub from: f64,
    /// Simulated time, s, from which on clients and users move the simulation; up to there it goes as fast as it can. `None`
    /// (default): all of it is replayed, then the simulation pauses.
    pub continue_at: Option<f64>,
    /// Whether files of the scene may have changed; default: `false`.
    pub changed_files: bool,
}

/// Versions of ROS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RosVersions {
    /// None at all.
    None,
    /// ROS 1.
    One,
    /// ROS 2.
    Two,
    /// Both at once.
    Both,
}

impl RosVersions {
    /// Names on the command line.
    pub const NAMES: [(&str, Self); 4] =
        [("1", Self::One), ("2", Self::Two), ("both", Self::Both), ("none", Self::None)];

    /// The version that the environment speaks of: ROS 1 where there is a master (`ROS_MASTER_URI`), ROS 2 where there is
    /// none, but `ROS_VERSION` is 2 or `ROS_DOMAIN_ID` is set; otherwise ROS 1. `is_set`: whether a variable is set;
    /// `version`: `ROS_VERSION`.
    pub fn from_environment(is_set: impl Fn(&str) -> bool, version: Option<&str>) -> Self {
        let is_two = version == Some("2") || is_set("ROS_DOMAIN_ID");
        if is_two && !is_set("ROS_MASTER_URI") {
            Self::Two
        } else {
            Self::One
        }
    }

    /// Whether ROS 1 is one of them.
    pub fn has_one(self) -> bool {
        matches!(self, Self::One | Self::Both)
    }

    /// Whether ROS 2 is one of them.
    pub fn has_two(self) -> bool {
        matches!(self, Self::Two | Self::Both)
    }
}

/// Which entries of the launch file's list of input devices are loaded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DeviceSelection {
    /// The first so many.
    First(usize),
    /// Those at these indexes, from 0. May be out of range or repeated.
    Indexes(Vec<usize>),
}

/// Frequencies at which the state of an object is published, in Hz, `min <= max`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PublishFrequency {
    /// While no commands arrive.
    pub min: u32,
    /// While commands arrive.
    pub max: u32,
}

impl Default for PublishFrequency {
    /// 50 Hz and 1000 Hz.
    fn default() -> Self {
        Self { min: 50, max: 1000 }
    }
}

impl SimulatorOptions {
    /// The command line as clap knows it, for completions and manual pages.
    pub fn command() -> clap::Command {
        Arguments::command()
    }

    /// Reads a command line, program name included.
    ///
    /// Ignored words, indexes that are no numbers and values without effect are reported in the notes.
    ///
    /// # Errors
    /// [`CliError::Usage`] when a value is missing or malformed, an option is given twice or a shortened name is
    /// ambiguous; [`CliError::NotUtf8`] when an argument isn't text.
    pub fn parse(argv: impl IntoIterator<Item = OsString>) -> Result<Parsed<Self>, CliError> {
        let mut command = Arguments::command();
        // Adds --help and --version, which the filter has to know.
        command.build();
        let (kept, ignored) = filter::known_options(&command, &utf8(argv)?)?;
        let arguments = command.try_get_matches_from(kept).and_then(|matches| Arguments::from_arg_matches(&matches));
        match arguments {
            Ok(arguments) => {
                let is_file = |word: &String| arguments.check && !word.starts_with('-');
                let (files, ignored): (Vec<_>, Vec<_>) = ignored.into_iter().partition(is_file);
                let mut notes: Vec<String> =
                    ignored.iter().map(|word| format!("ignored on the command line: {word}")).collect();
                let options = arguments.into_options(files.into_iter().map(PathBuf::from).collect(), &mut notes);
                Ok(Parsed::Run { options, notes })
            }
            Err(error) => print_or_fail(&error),
        }
    }
}

/// The command line as it is written; help texts are for the user.
#[derive(Debug, clap::Parser)]
#[command(
    name = "ambf_simulator",
    version = ambf_version::VERSION,
    about = "Simulates the multi-body models of a launch file in real time and talks ROS 1 about them.",
    after_help = "\
BOOL is true, yes, on, 1 or false, no, off, 0. Long names may be shortened: --launch. A value may be attached: -l1, --ns=/a.
Without -l and -a, -l 1 is assumed. Unknown options are ignored and named.
With --check, words that belong to no option are files to check; without any, what -l and -a name, else the launch file.
Exit status of --check: 0 nothing is dropped, 1 the report could not be written, 2 something is refused or dropped.

Environment: ROS_MASTER_URI, ROS_IP, ROS_HOSTNAME; AMBF_ROOT_PATH, AMBF_RESOURCES (folder of launch.yaml);
AMBF_PLUGIN_PATH (folders of plugins, separated by colons).

Examples:
  ambf_simulator -g false -l 1,3
  ambf_simulator -g 0 -a robot.yaml,table.yaml -p 2000
  ambf_simulator -g 0 -t 1 -p 1000 --ns /left --launch_file launch.yaml
  ambf_simulator --replay run.mcap -s 0.5 --replay-from 12
  ambf_simulator --check robot.yaml world.yaml"
)]
struct Arguments {
    /// Launch file [default: launch.yaml in $AMBF_ROOT_PATH/ambf_models/descriptions, $AMBF_RESOURCES or resources]
    #[arg(long = "launch_file", value_name = "FILE", help_heading = "Scene")]
    launch_file: Option<PathBuf>,
    /// Models to load: indexes into the launch file's list, from 0
    #[arg(short = 'l', long = "load_multibodies", value_name = "INDEX,…", help_heading = "Scene")]
    model_indexes: Option<String>,
    /// Model files to load, before those of -l
    #[arg(short = 'a', long = "load_multibody_files", value_name = "FILE,…", help_heading = "Scene")]
    model_files: Option<String>,
    /// Simulator plugins to load
    #[arg(long, value_name = "FILE,…", help_heading = "Scene")]
    plugins: Option<String>,
    /// Offer the arms of these configurations to CRTK clients
    #[arg(long, value_name = "FILE,…", help_heading = "ROS")]
    crtk: Option<String>,
    /// Draw what differs from run to run, such as errors of joints: the same seed, the same run
    #[arg(long, value_name = "N", help_heading = "ROS")]
    seed: Option<u32>,
    /// Open camera windows [default: where there is a display]
    #[arg(short = 'g', long = "show_gui", value_name = "BOOL", value_parser = boolean)]
    #[arg(help_heading = "Scene", action = clap::ArgAction::Set)]
    show_gui: Option<bool>,

    /// Target frequency of the physics loop, Hz
    #[arg(short = 'p', long = "phx_frequency", value_name = "HZ", default_value = "1000")]
    #[arg(value_parser = count, help_heading = "Time")]
    physics_frequency: u32,
    /// Fixed physics interval 1/frequency instead of following the clock
    #[arg(short = 't', long = "fixed_phx_timestep", value_name = "BOOL", default_value = "false", value_parser = boolean)]
    #[arg(help_heading = "Time", action = clap::ArgAction::Set)]
    fixed_physics_step: bool,
    /// Factor on the fixed physics interval; with --replay: on the speed of the recording
    #[arg(short = 's', long = "sim_speed_factor", value_name = "FACTOR", default_value = "1", value_parser = positive)]
    #[arg(help_heading = "Time")]
    speed_factor: f64,

    /// Number of input devices to load, from the first of the list on
    #[arg(short = 'n', long = "ndevs", value_name = "N", default_value = "0", help_heading = "Input devices")]
    #[arg(value_parser = whole)]
    device_count: usize,
    /// Input devices to load: indexes into the list, from 0; -n is then ignored
    #[arg(short = 'i', long = "load_devices", value_name = "INDEX,…", help_heading = "Input devices")]
    device_indexes: Option<String>,
    /// Send forces to the devices
    #[arg(short = 'e', long = "enableforces", value_name = "BOOL", default_value = "false", value_parser = boolean)]
    #[arg(help_heading = "Input devices", action = clap::ArgAction::Set)]
    force_feedback: bool,
    /// Target frequency of each haptic loop, Hz
    #[arg(short = 'd', long = "htx_frequency", value_name = "HZ", default_value = "1000")]
    #[arg(value_parser = haptic_frequency, help_heading = "Input devices")]
    haptic_frequency: u32,
    /// Fixed haptic interval 1/frequency instead of following the clock
    #[arg(short = 'f', long = "fixed_htx_timestep", value_name = "BOOL", default_value = "false", value_parser = boolean)]
    #[arg(help_heading = "Input devices", action = clap::ArgAction::Set)]
    fixed_haptic_step: bool,

    /// Text put before the namespace of all topics and parameters
    #[arg(long, value_name = "PREFIX", default_value = "", hide_default_value = true, help_heading = "ROS")]
    ns: String,
    /// Publish frequency of all objects while commands arrive, Hz [default: each object's own, usually 1000]
    #[arg(long = "override_max_comm_freq", value_name = "HZ", help_heading = "ROS")]
    #[arg(value_parser = count)]
    max_publish_frequency: Option<u32>,
    /// Publish frequency of all objects otherwise, Hz [default: each object's own, usually 50]
    #[arg(long = "override_min_comm_freq", value_name = "HZ", help_heading = "ROS")]
    #[arg(value_parser = count)]
    min_publish_frequency: Option<u32>,
    /// No ROS at all
    #[arg(long = "no_ros", value_name = "BOOL", num_args = 0..=1, require_equals = true, help_heading = "ROS")]
    #[arg(default_value = "false", default_missing_value = "true", value_parser = boolean, hide_default_value = true)]
    #[arg(action = clap::ArgAction::Set)]
    no_ros: bool,
    /// Which ROS: 1, 2, both or none [default: 1, unless only variables of ROS 2 are set]
    #[arg(long, value_name = "VERSION", help_heading = "ROS", value_parser = ros_versions())]
    #[arg(hide_possible_values = true)]
    ros: Option<RosVersions>,
    /// Publish /clock, and stamp with simulated time
    #[arg(long, value_name = "BOOL", num_args = 0..=1, require_equals = true, help_heading = "ROS")]
    #[arg(default_value = "false", default_missing_value = "true", value_parser = boolean, hide_default_value = true)]
    #[arg(action = clap::ArgAction::Set)]
    clock: bool,
    /// Publish the poses of all bodies on /tf, so often [default: 50], and what is loaded as robot_description
    #[arg(long, value_name = "HZ", num_args = 0..=1, require_equals = true, help_heading = "ROS")]
    #[arg(default_missing_value = "50", value_parser = count)]
    tf: Option<u32>,
    /// Make the first step of the physics when a client asks for it, with the service World/step or by throttling
    #[arg(long, value_name = "BOOL", num_args = 0..=1, require_equals = true, help_heading = "ROS")]
    #[arg(default_value = "false", default_missing_value = "true", value_parser = boolean, hide_default_value = true)]
    #[arg(action = clap::ArgAction::Set)]
    hold: bool,
    /// End the ROS master that a simulator started and left behind, instead of simulating
    #[arg(long = "end-master", help_heading = "ROS")]
    end_master: bool,

    #[command(flatten)]
    physics: PhysicsOptions,

    /// Write a recording, from which the run can be made again
    #[arg(long, value_name = "FILE", help_heading = "Recordings")]
    record: Option<PathBuf>,
    /// Begin it with the first reset of the world
    #[arg(long = "record-from-reset", requires = "record", help_heading = "Recordings")]
    record_from_reset: bool,
    /// Replay a recording in real time, with topics, pictures and windows; what others command is refused meanwhile
    #[arg(long, value_name = "FILE", help_heading = "Recordings")]
    replay: Option<PathBuf>,
    /// Replay it as fast as it goes up to this simulated time, in real time from there
    #[arg(long = "replay-from", value_name = "SECONDS", value_parser = positive, help_heading = "Recordings")]
    replay_from: Option<f64>,
    /// Replay it as fast as it goes up to this simulated time, and take commands from there on
    #[arg(long = "continue-at", value_name = "SECONDS", value_parser = positive, help_heading = "Recordings")]
    continue_at: Option<f64>,
    /// Replay also when files of the scene have changed since
    #[arg(long = "changed-files", help_heading = "Recordings")]
    changed_files: bool,

    /// Print more about loading and running
    #[arg(long, value_name = "BOOL", num_args = 0..=1, require_equals = true, help_heading = None)]
    #[arg(default_value = "false", default_missing_value = "true", value_parser = boolean, hide_default_value = true)]
    #[arg(action = clap::ArgAction::Set)]
    verbose: bool,

    /// Check files instead of simulating: say what is wrong with them, what they hold and what becomes of it
    #[arg(long, help_heading = "Check")]
    check: bool,
    /// Say what this machine can and cannot do for the simulator, instead of simulating
    #[arg(long, help_heading = "Check")]
    doctor: bool,
    /// Print what --check finds as JSON
    #[arg(long, help_heading = "Check")]
    json: bool,
}

impl Arguments {
    /// A sentence for each option that says what a recording says.
    fn unused_in_replays(&self) -> impl Iterator<Item = String> {
        let named = [
            (self.model_indexes.is_some(), "-l"),
            (self.model_files.is_some(), "-a"),
            (self.plugins.is_some(), "--plugins"),
            (self.crtk.is_some(), "--crtk"),
            (self.seed.is_some(), "--seed"),
            (self.launch_file.is_some(), "--launch_file"),
            (self.device_count > 0, "-n"),
            (self.device_indexes.is_some(), "-i"),
            (!self.ns.is_empty(), "--ns"),
            (self.physics != PhysicsOptions::default(), "the solver and profile"),
            (self.record_from_reset, "--record-from-reset"),
        ];
        let named = named.into_iter().filter(|(is_named, _)| *is_named);
        named.map(|(_, option)| format!("{option}: ignored, because the recording of --replay says what is simulated"))
    }

    fn into_options(self, files: Vec<PathBuf>, notes: &mut Vec<String>) -> SimulatorOptions {
        let mut numbers = |option: &str, text: &str| {
            let (indexes, others) = indexes(text);
            notes.extend(
                others.iter().map(|part| format!("{option}: {part:?} is no index (0, 1, 2, …) and is skipped")),
            );
            indexes
        };
        let model_files = self.model_files.as_deref().map(paths).unwrap_or_default();
        let model_indexes = match self.model_indexes.as_deref() {
            Some(text) => numbers("-l", text),
            None if model_files.is_empty() => vec![DEFAULT_MODEL],
            None => Vec::new(),
        };
        let devices = match self.device_indexes.as_deref().map(str::trim) {
            Some(text) if !text.is_empty() => DeviceSelection::Indexes(numbers("-i", text)),
            _ => DeviceSelection::First(self.device_count),
        };
        if self.replay.is_some() {
            notes.extend(self.unused_in_replays());
        } else if self.replay_from.is_some() || self.continue_at.is_some() || self.changed_files {
            notes.push(
                "--replay-from, --continue-at and --changed-files have an effect only with --replay and are ignored"
                    .to_owned(),
            );
        }
        let replay = self.replay.map(|file| FollowedRecording {
            file,
            speed: self.speed_factor,
            from: self.replay_from.unwrap_or(0.0),
            continue_at: self.continue_at,
            changed_files: self.changed_files,
        });
        let speed_factor = if self.fixed_physics_step || self.speed_factor == 1.0 {
            self.speed_factor
        } else if replay.is_some() {
            1.0
        } else {
            notes.push("--sim_speed_factor has an effect only with -t 1 and is ignored".to_owned());
            1.0
        };
        if self.json && !self.check {
            notes.push("--json has an effect only with --check and is ignored".to_owned());
        }
        let launch_file = self.launch_file.unwrap_or_else(launch_file::default);
        let check = self.check.then(|| {
            let indexes = if self.model_indexes.is_some() { model_indexes.clone() } else { Vec::new() };
            CheckOptions::new(files, model_files.clone(), indexes, launch_file.clone(), self.json)
        });
        let publish_frequency = publish_frequency(self.min_publish_frequency, self.max_publish_frequency, notes);
        SimulatorOptions {
            devices,
            force_feedback: self.force_feedback,
            physics_frequency: self.physics_frequency,
            haptic_frequency: self.haptic_frequency,
            fixed_physics_step: self.fixed_physics_step,
            fixed_haptic_step: self.fixed_haptic_step,
            publish_frequency,
            show_gui: self.show_gui,
            namespace: self.ns,
            speed_factor,
            plugins: self.plugins.as_deref().map(paths).unwrap_or_default(),
            crtk: self.crtk.as_deref().map(paths).unwrap_or_default(),
            seed: self.seed,
            launch_file,
            model_files,
            model_indexes,
            no_ros: self.no_ros,
            ros: self.ros,
            clock: self.clock,
            tf: self.tf,
            hold: self.hold,
            end_master: self.end_master,
            verbose: self.verbose,
            physics: self.physics,
            record: self.record,
            record_from_reset: self.record_from_reset,
            replay,
            check,
            doctor: self.doctor,
        }
    }
}

/// Either value activates both; the maximum is applied first, then the minimum, each refused if it crosses the other.
fn publish_frequency(min: Option<u32>, max: Option<u32>, notes: &mut Vec<String>) -> Option<PublishFrequency> {
    if min.is_none() && max.is_none() {
        return None;
    }
    let mut frequency = PublishFrequency::default();
    match max {
        Some(max) if max < frequency.min => notes.push(format!(
            "--override_max_comm_freq {max} is below the minimum of {} Hz and is ignored",
            frequency.min
        )),
        Some(max) => frequency.max = max,
        None => {}
    }
    match min {
        Some(min) if min > frequency.max => notes.push(format!(
            "--override_min_comm_freq {min} is above the maximum of {} Hz and is ignored",
            frequency.max
        )),
        Some(min) => frequency.min = min,
        None => {}
    }
    Some(frequency)
}

#[cfg(test)]
mod tests;
