//! Plugins of the programs: what is built in, where libraries are looked for, what is said about them.

use std::path::PathBuf;
use std::sync::Arc;

use ambf_core::adf::PluginEntry;
use ambf_core::device::Drivers;
use ambf_core::plugin::{load_driver, PluginReport, PluginSetup, Registry, Search};
use ambf_core::sim::Simulation;
use crtk::diagnostics::Board;
use crtk::queries::Service;
use crtk::topics::Topic;
use crtk::transport::{Answer, Connect, Receive, Ros1, Sender, Transport, TransportError};

use crate::cli::RosVersions;
use crate::report;
use crate::ros::RosArguments;

/// Arms that are offered to CRTK clients.
#[derive(Clone)]
pub struct CrtkFiles<'a> {
    /// Configurations that the command line names.
    pub files: &'a [PathBuf],
    /// Versions of ROS to offer them on.
    pub versions: RosVersions,
    /// Where there is to be seen how they are.
    pub board: Board,
    /// What the command line says to ROS: topics and services that are called otherwise.
    pub arguments: RosArguments,
    /// What differs from run to run is drawn from it.
    pub seed: Option<u64>,
}

impl Default for CrtkFiles<'_> {
    /// No arms.
    fn default() -> Self {
        let (versions, board, arguments) = (RosVersions::None, Board::default(), RosArguments::default());
        Self { files: &[], versions, board, arguments, seed: None }
    }
}

/// Beginning of the name of the node that offers arms.
const CRTK_NODE: &str = "ambf_crtk";

/// The middlewares on which arms are offered.
fn connect(versions: RosVersions, arguments: RosArguments) -> Connect {
    Arc::new(move || {
        let mut transports: Vec<Box<dyn Transport>> = Vec::new();
        if versions.has_one() {
            let inner = Ros1::start(CRTK_NODE, crate::ros::of_node())?;
            transports.push(Box::new(Mapped { inner, arguments: arguments.clone() }));
        }
        #[cfg(feature = "ros2")]
        if versions.has_two() {
            let inner = crate::ros::ArmTopics::start(CRTK_NODE, &arguments)?;
            transports.push(Box::new(Mapped { inner, arguments: arguments.clone() }));
        }
        Ok(transports)
    })
}

/// A transport whose topics and services are called as the command line says.
struct Mapped<T> {
    inner: T,
    arguments: RosArguments,
}

impl<T> Mapped<T> {
    fn topic(&self, topic: &Topic) -> Topic {
        Topic { name: self.arguments.mapped(topic.name.clone()), ..topic.clone() }
    }
}

impl<T: Transport> Transport for Mapped<T> {
    fn advertise(&mut self, topic: &Topic) -> Result<Box<dyn Sender>, TransportError> {
        let topic = self.topic(topic);
        self.inner.advertise(&topic)
    }

    fn subscribe(&mut self, topic: &Topic, receive: Receive) -> Result<(), TransportError> {
        let topic = self.topic(topic);
        self.inner.subscribe(&topic, receive)
    }

    fn serve(&mut self, service: &Service, answer: Answer) -> Result<(), TransportError> {
        let service = Service { name: self.arguments.mapped(service.name.clone()), ..service.clone() };
        self.inner.serve(&service, answer)
    }
}

/// What is to be loaded, and from where.
pub fn setup(launch: &[PluginEntry], command_line: &[PathBuf], crtk: CrtkFiles<'_>) -> PluginSetup {
    let mut registry = Registry::default();
    let arms = crtk::plugin::register(
        &mut registry,
        crtk.files,
        &connect(crtk.versions, crtk.arguments),
        &crtk.board,
        crtk.seed,
    );
    drill::register(&mut registry);
    PluginSetup {
        registry,
        search: Search::from_environment(),
        arguments: std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect(),
        command_line: command_line.iter().cloned().chain(arms).collect(),
        launch: launch.to_vec(),
    }
}

/// Loads the plugins that a scene, a launch file and a command line ask for; each one that is left out is named, the
/// others too if `verbose`.
pub fn load(
    simulation: &mut Simulation,
    launch: &[PluginEntry],
    command_line: &[PathBuf],
    crtk: CrtkFiles<'_>,
    verbose: bool,
) {
    let PluginReport { loaded, problems } = simulation.load_plugins(setup(launch, command_line, crtk));
    if verbose {
        loaded.iter().for_each(|line| report!("{line} is running"));
    }
    problems.iter().for_each(|line| report!("{line}"));
    say(simulation);
}

/// Adds the drivers of input devices that a launch file names to those of the program; a sentence for each one that is
/// left out.
pub fn add_drivers(drivers: &mut Drivers, entries: &[PluginEntry]) -> Vec<String> {
    let search = Search::from_environment();
    let mut problems = Vec::new();
    for entry in entries {
        match load_driver(&search, entry) {
            Ok(driver) => drivers.add(driver),
            Err(error) => {
                let PluginEntry { name, filename, source, .. } = entry;
                problems.push(format!("{source}: device plugin {name} ({}) is left out: {error}", filename.display()));
            }
        }
    }
    problems
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
