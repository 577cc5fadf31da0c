//! Plugins of the programs: what is built in, where libraries are looked for, what is said about them.

use std::path::PathBuf;

use ambf_core::adf::PluginEntry;
use ambf_core::plugin::{PluginReport, PluginSetup, Registry, Search};
use ambf_core::sim::Simulation;

use crate::report;

/// Plugins that are part of the programs.
pub fn registry() -> Registry {
    Registry::default()
}

/// What is to be loaded, and from where.
pub fn setup(launch: &[PluginEntry], command_line: &[PathBuf]) -> PluginSetup {
    PluginSetup {
        registry: registry(),
        search: Search::from_environment(),
        arguments: std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect(),
        command_line: command_line.to_vec(),
        launch: launch.to_vec(),
    }
}

/// Loads the plugins that a scene, a launch file and a command line ask for; each one that is left out is named, the others too if `verbose`.
pub fn load(simulation: &mut Simulation, launch: &[PluginEntry], command_line: &[PathBuf], verbose: bool) {
    let PluginReport { loaded, problems } = simulation.load_plugins(setup(launch, command_line));
    if verbose {
        loaded.iter().for_each(|line| report!("{line} is running"));
    }
    problems.iter().for_each(|line| report!("{line}"));
    say(simulation);
}

/// Closes all plugins, and prints what they have to say about it.
pub fn close(simulation: &mut Simulation) {
    simulation.close_plugins();
    say(simulation);
}

/// Prints what plugins have to say.
pub fn say(simulation: &mut Simulation) {
    simulation.take_notices().iter().for_each(|notice| report!("{notice}"));
}
