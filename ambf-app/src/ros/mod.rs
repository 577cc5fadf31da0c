//! ROS 1: topics, parameters and services of the original simulator, and some of our own.
//!
//! | thread | what it does |
//! |---|---|
//! | `ros-publish` | publishes all states, each at its own rate ([`PublishSchedule`](ambf_core::comm::PublishSchedule)) |
//! | `ros-objects` | announces and withdraws the topics of objects that come and go |
//! | `ros-log` | sends what the program says on `/rosout` |
//! | `ros-parameters` | writes and polls the parameters of cameras, lights and the world |
//!
//! The others are those of the [node](ros_node). None of them can hold up the physics: states are read from the hub's
//! newest snapshot and commands are left in its mailboxes.

mod arguments;
mod diagnostics;
mod frames;
mod log;
pub mod messages;
mod models;
pub mod naming;
mod neighbours;
mod objects;
mod parameters;
#[cfg(feature = "pictures")]
mod pictures;
mod point_cloud;
mod received;
mod recordings;
#[cfg(feature = "ros2")]
mod ros2;
mod ros_args;
mod scheduler;
mod service;
mod signal;
mod step;
mod topics;

use std::error::Error;
use std::sync::mpsc::{channel, Receiver, Sender};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use ambf_core::comm::{Hub, Middleware};
use ros_node::{LinkOptions, Node, OwnMaster, Peer};

pub use arguments::RosArguments;
pub use diagnostics::DeviceReports;
pub(crate) use log::of_node;
pub use models::{ModelHost, ModelReply};
#[cfg(feature = "pictures")]
pub(crate) use pictures::PictureTopic;
#[cfg(feature = "pictures")]
pub use pictures::{CameraTopics, PictureTopics};
pub use point_cloud::{PointCloud, PointClouds};
pub use recordings::{RecordHost, RecordReply};
#[cfg(feature = "ros2")]
pub use ros2::{ArmTopics, Ros2Middleware, Ros2Options};
pub use ros_args::ArgumentError;
pub use ros_node::CallError;

use crate::report;
use frames::Frames;
use log::Log;
use objects::{ChangeSinks, Objects};
use parameters::{DescriptionParameter, Parameters};
use signal::Waker;
use topics::ServeContext;

/// Beginning of the node's name.
const NODE_NAME: &str = "ambf_comm_node";

/// Parameter with the URDF of what is loaded.
const ROBOT_DESCRIPTION: &str = "/robot_description";

/// How long one call to the master may take before it counts as absent.
const MASTER_TIMEOUT: Duration = Duration::from_secs(1);

/// How long [`RosMiddleware::stop`] waits for threads that wait for a master that does not answer.
const STOP_TIMEOUT: Duration = Duration::from_secs(2);

/// What is published beside the objects of a hub.
#[derive(Clone, Default)]
pub struct Extras {
    /// Whether `/clock` is published. The simulation must then stamp with simulated time
    /// ([`set_simulated_stamps`](ambf_core::sim::Simulation::set_simulated_stamps)). Default: `false`.
    pub clock: bool,
    /// How often the poses of all bodies are published on `/tf`, Hz; the parameter `robot_description` then holds what
    /// is loaded as URDF. Default, `None`: neither.
    pub tf: Option<u32>,
    /// Reports on the haptic devices, whose number is in the world's state. Default: none.
    pub devices: Arc<DeviceReports>,
    /// Arms that are offered to CRTK clients. Default: none.
    pub arms: crtk::diagnostics::Board,
}

/// What the ROS side uses besides the hub.
#[derive(Clone)]
pub struct RosOptions {
    /// What the command line says to ROS. Default: nothing; the node is then called `ambf_comm_node` with process id
    /// and time appended.
    pub arguments: RosArguments,
    /// What is done when no master answers at a local address. Default: one is started in this process.
    pub own_master: OwnMaster,
    /// What is published beside the objects.
    pub extras: Extras,
}

impl Default for RosOptions {
    fn default() -> Self {
        Self { arguments: RosArguments::default(), own_master: OwnMaster::InProcess, extras: Extras::default() }
    }
}

/// Serves the objects of a hub to ROS 1.
///
/// Objects that come and go in the hub are followed. The environment (`ROS_MASTER_URI`, `ROS_IP`, `ROS_HOSTNAME`,
/// `ROS_NAMESPACE`) is honoured. Without a master, one is started if the address is one of this machine
/// ([`RosOptions::own_master`]); otherwise the simulation goes on and the master is asked for every second.
pub struct RosMiddleware {
    options: RosOptions,
    clouds: Arc<PointClouds>,
    models: Option<Arc<dyn ModelHost>>,
    recordings: Option<Arc<dyn RecordHost>>,
    #[cfg(feature = "pictures")]
    pictures: Option<Arc<PictureTopics>>,
    running: Option<Running>,
}

struct Running {
    node: Node,
    _log: Log,
    waker: Arc<Waker>,
    publisher: JoinHandle<()>,
    /// Threads that may hang with the master: each drops a sender when it ends.
    ended: Receiver<()>,
}

impl RosMiddleware {
    /// Not started yet.
    pub fn new(options: RosOptions) -> Self {
        Self {
            options,
            clouds: Arc::default(),
            models: None,
            recordings: None,
            #[cfg(feature = "pictures")]
            pictures: None,
            running: None,
        }
    }

    /// Offers services with which clients add, remove and list models through `host`. Default: there are none.
    pub fn with_models(mut self, host: Arc<dyn ModelHost>) -> Self {
        self.models = Some(host);
        self
    }

    /// Offers services with which clients begin and end recordings through `host`. Default: there are none.
    pub fn with_recordings(mut self, host: Arc<dyn RecordHost>) -> Self {
        self.recordings = Some(host);
        self
    }

    /// Announces topics of cameras that publish pictures, for somebody else to publish on: `topics` has them. Default:
    /// there are none.
    #[cfg(feature = "pictures")]
    pub fn with_pictures(mut self, topics: Arc<PictureTopics>) -> Self {
        self.pictures = Some(topics);
        self
    }

    /// Adds point clouds that clients publish to `clouds`. Default: its own.
    pub fn with_point_clouds(mut self, clouds: Arc<PointClouds>) -> Self {
        self.clouds = clouds;
        self
    }

    /// Whether somebody told the node to shut down (`rosnode kill`).
    pub fn is_dismissed(&self) -> bool {
        self.running.as_ref().is_some_and(|running| running.node.link().is_dismissed())
    }

    /// Point clouds that clients publish, to be drawn.
    pub fn point_clouds(&self) -> Arc<PointClouds> {
        Arc::clone(&self.clouds)
    }
}

impl Middleware for RosMiddleware {
    /// # Errors
    /// When `ROS_MASTER_URI` is malformed ([`CallError::BadUri`]) or no thread can be made.
    fn start(&mut self, hub: Arc<Hub>) -> Result<(), Box<dyn Error + Send + Sync>> {
        if self.running.is_some() {
            return Ok(());
        }
        let master = Peer::new(&ros_node::master_uri(), &format!("/{NODE_NAME}"), MASTER_TIMEOUT)?;
        let RosOptions { arguments, own_master, extras } = self.options.clone();
        let frames = extras.tf.map(|_| Arc::<Frames>::default());
        hub.set_listening();
        ros_node::allow_many_connections();
        let waker = Arc::<Waker>::default();
        let node = Node::start(LinkOptions {
            master,
            name: arguments.node_name(NODE_NAME),
            own_master,
            parameters: arguments.parameters.clone(),
            report: log::of_node(),
        })?;
        let link = Arc::clone(node.link());
        let log = Log::start(&link)?;
        let (publisher, entries) = channel();
        let (to_parameters, changes) = channel();
        let sinks = ChangeSinks { link: Arc::clone(&link), publisher, parameters: to_parameters };
        let mut objects = Objects::new(ServeContext {
            hub: Arc::clone(&hub),
            waker: Arc::clone(&waker),
            extras,
            frames: frames.clone(),
            #[cfg(feature = "pictures")]
            pictures: self.pictures.clone(),
            models: self.models.clone(),
            recordings: self.recordings.clone(),
            steppables: Arc::default(),
            arguments: arguments.clone(),
            #[cfg(feature = "ros2")]
            ros2: None,
        });
        objects.follow(&sinks);
        let (alive, ended) = channel();
        let publisher = {
            let (hub, link, waker) = (Arc::clone(&hub), Arc::clone(&link), Arc::clone(&waker));
            named("ros-publish").spawn(move || scheduler::run(&hub, &entries, &link.stop, &waker))?
        };
        // From here on `stop` cleans up whatever has been started.
        self.running = Some(Running { node, _log: log, waker, publisher, ended });
        let description =
            frames.map(|frames| DescriptionParameter::new(arguments.mapped(ROBOT_DESCRIPTION.into()), frames));
        let parameters = Parameters::new(hub, link, changes, Arc::clone(&self.clouds), description);
        spawn_detached("ros-parameters", &alive, move || parameters.run())?;
        spawn_detached("ros-objects", &alive, move || objects.run(&sinks))?;
        Ok(())
    }

    /// Takes some seconds at most, also when the master does not answer.
    fn stop(&mut self) {
        let Some(running) = self.running.take() else { return };
        running.node.link().stop.stop();
        running.waker.wake();
        if running.publisher.join().is_err() {
            report!("ROS: the publishing thread had ended with a panic");
        }
        running.node.stop();
        // Disconnects when the last thread has dropped its sender. Those of a master that hangs are left behind.
        let _ = running.ended.recv_timeout(STOP_TIMEOUT);
    }
}

impl Drop for RosMiddleware {
    fn drop(&mut self) {
        self.stop();
    }
}

fn named(name: &str) -> std::thread::Builder {
    std::thread::Builder::new().name(name.into())
}

/// A thread that holds a clone of `alive` until it ends, however it ends.
fn spawn_detached(name: &str, alive: &Sender<()>, work: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
    let alive = alive.clone();
    named(name).spawn(move || {
        let _alive = alive;
        work();
    })?;
    Ok(())
}
