//! Command lines of the two programs.
//!
//! [`SimulatorOptions`] keeps the rules of the original simulator: any unique prefix of a long name, booleans that need
//! a value, unknown options ignored (and named). [`BatchOptions`] is strict. Neither ends the process: the caller
//! prints what it gets and leaves with the exit status that goes with it.

mod batch;
mod filter;
mod launch_file;
mod simulator;
mod values;

pub use batch::{BatchOptions, PictureOptions, ReplayOptions};
pub use simulator::{DeviceSelection, FollowedRecording, PublishFrequency, RosVersions, SimulatorOptions};

use std::path::PathBuf;

use ambf_core::adf::PhysicsProfile;
use clap::error::ErrorKind;

/// What a command line asks for.
#[derive(Debug, Clone, PartialEq)]
pub enum Parsed<T> {
    /// Run with these options.
    Run {
        /// The options.
        options: T,
        /// One line each about what was ignored or adjusted, for standard error; empty if all was used as written.
        notes: Vec<String>,
    },
    /// Print this text (help or version) on standard output and leave with exit status 0.
    Print(String),
}

/// Why a command line can't be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CliError {
    /// Error when an option is malformed, given twice or lacks its value; the text names it and says what was expected.
    #[error("{0}")]
    Usage(String),
    /// Error when an argument isn't valid UTF-8.
    #[error("error: the argument {0:?} is not valid UTF-8; rename the file or option so that it is")]
    NotUtf8(std::ffi::OsString),
}

impl CliError {
    /// Exit status of `ambf_simulator` for an unusable command line: 2.
    pub const SIMULATOR_STATUS: i32 = 2;
    /// Exit status of `ambf_batch` for an unusable command line: 1.
    pub const BATCH_STATUS: i32 = 1;
    /// Exit status of `ambf_simulator` when something that was asked for, or said, could not be written: 1.
    pub const SIMULATOR_UNWRITTEN: i32 = 1;
    /// The same of `ambf_batch`: 2.
    pub const BATCH_UNWRITTEN: i32 = 2;
}

/// How Bullet solves and integrates; `None` leaves a choice to the world file and then to the profile.
#[derive(Debug, Clone, Default, PartialEq, Eq, clap::Args)]
#[command(next_help_heading = "Physics")]
pub struct PhysicsOptions {
    /// Behaviour of the physics: legacy, accurate or pybullet [default: the world file's, else legacy]
    #[arg(long, value_parser = values::profile(), value_name = "PROFILE", hide_possible_values = true)]
    pub profile: Option<PhysicsProfile>,
    /// Constraint solver, by name [default: the profile's]
    #[arg(long, value_name = "NAME")]
    pub solver: Option<String>,
    /// Solver iterations in each sub-step, at least 1 [default: the profile's]
    #[arg(long, value_name = "N", value_parser = values::count)]
    pub iterations: Option<u32>,
    /// Integrator, by name [default: the profile's]
    #[arg(long, value_name = "NAME")]
    pub integrator: Option<String>,
    /// Let bodies at rest sleep until something moves them [default: the world file's, else no]
    #[arg(long, value_name = "BOOL", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    #[arg(value_parser = values::boolean)]
    pub sleep: Option<bool>,
    /// Put joints that form trees into reduced coordinates [default: the world file's, else yes in the accurate
    /// profile]
    #[arg(long, value_name = "BOOL", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    #[arg(value_parser = values::boolean)]
    pub articulated: Option<bool>,
}

/// What `--check` was asked to look at.
///
/// Paths are as typed: relative ones are relative to the working directory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CheckOptions {
    /// Files to check, each with what it names; the launch file when neither files nor models are named.
    pub files: Vec<PathBuf>,
    /// Model files and indexes into the launch file's list that are checked as they are loaded, one after the other
    /// into one world.
    pub together: Option<(Vec<PathBuf>, Vec<usize>)>,
    /// Launch file, for [`together`](Self::together) and for the names of colours. It need not exist.
    pub launch_file: PathBuf,
    /// World file used instead of the launch file's; `None`: that.
    pub world: Option<PathBuf>,
    /// Whether to print JSON instead of text; default: `false`.
    pub json: bool,
}

impl CheckOptions {
    /// `models` and `indexes` are those that the command line names.
    fn new(files: Vec<PathBuf>, models: Vec<PathBuf>, indexes: Vec<usize>, launch_file: PathBuf, json: bool) -> Self {
        let together = (!models.is_empty() || !indexes.is_empty()).then_some((models, indexes));
        let files = if files.is_empty() && together.is_none() { vec![launch_file.clone()] } else { files };
        Self { files, together, launch_file, world: None, json }
    }
}

/// The arguments as text.
fn utf8(argv: impl IntoIterator<Item = std::ffi::OsString>) -> Result<Vec<String>, CliError> {
    argv.into_iter().map(|argument| argument.into_string().map_err(CliError::NotUtf8)).collect()
}

/// Help and version are no errors; everything else is.
fn print_or_fail<T>(error: &clap::Error) -> Result<Parsed<T>, CliError> {
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => Ok(Parsed::Print(error.to_string())),
        _ => Err(CliError::Usage(error.to_string().trim_end().to_owned())),
    }
}
