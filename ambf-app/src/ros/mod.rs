//! ROS 1: topics and parameters of the original simulator, through rosrust, and services of our own.
//!
//! | thread | what it does |
//! |---|---|
//! | `ros-publish` | publishes all states, each at its own rate ([`PublishSchedule`](ambf_core::comm::PublishSchedule)) |
//! | `ros-link` | finds or starts the master, announces topics, registers again when the master was restarted |
//! | `ros-objects` | announces and withdraws the topics of objects that come and go |
//! | `ros-parameters` | writes and polls the parameters of cameras, lights and the world |
//! | `ros-connect` | asks the master which clients publish commands |
//! | `ros-listen` | one a client and topic, receives its commands |
//! | `ros-sockets` | sets the options of new sockets |
//! | `ros-master` | a master in this process, when there is one; the simulator starts its own in another process |
//! | `ros-service`, `ros-request` | one a service for its new clients, one a client for its requests |
//! | `ros-large`, `ros-large-calls` | pictures: one for new subscribers, one a subscriber, one for calls of other nodes |
//!
//! rosrust adds two threads for each topic that is published. None of them can hold up the physics: states are read
//! from the hub's newest snapshot and commands are left in its mailboxes.
//!
//! ## Limitations
//! Pictures are published by a node of their own, which is there while a camera publishes
//! ([`SideNode`](ros_node::SideNode) says why). `rosnode info` of the other node fails, because rosrust does not
//! implement `getBusInfo`. The master that is started has no `/rosout_agg`, and `rosparam list` shows namespaces too. A
//! client is connected to up to 0.1 s after it has registered.

mod actuator;
mod arguments;
mod contact;
mod ghost;
pub mod messages;
mod mismatch;
mod models;
pub mod naming;
mod neighbours;
mod objects;
mod parameters;
#[cfg(feature = "view")]
mod pictures;
mod point_cloud;
mod posed;
mod received;
mod rigid_body;
mod scheduler;
mod sensor;
mod service;
mod signal;
mod soft_body;
mod step;
mod topics;
mod vehicle;
mod world;

use std::error::Error;
use std::sync::mpsc::{channel, Receiver, Sender};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use ambf_core::comm::{Hub, Middleware};
use ros_node::{Link, LinkOptions, OwnMaster, Peer};

pub use arguments::RosArguments;
pub use models::{ModelHost, ModelReply};
#[cfg(feature = "view")]
pub use pictures::{CameraTopics, PictureTopics};
pub use point_cloud::{PointCloud, PointClouds};
pub use ros_node::CallError;

use crate::report;
use objects::{ChangeSinks, Objects};
use parameters::Parameters;
use signal::Waker;
use topics::ServeContext;

/// Beginning of the node's name.
const NODE_NAME: &str = "ambf_comm_node";

/// What is appended to the node's name for the node of pictures.
#[cfg(feature = "view")]
const PICTURES: &str = "cameras";

/// How long one call to the master may take before it counts as absent.
const MASTER_TIMEOUT: Duration = Duration::from_secs(1);

/// How long [`RosMiddleware::stop`] waits for a master that does not answer.
const STOP_TIMEOUT: Duration = Duration::from_secs(2);

/// What the ROS side is told besides the hub.
#[derive(Debug, Clone)]
pub struct RosOptions {
    /// What the command line says to ROS. Default: nothing; the node is then called `ambf_comm_node` with process id
    /// and time appended.
    pub arguments: RosArguments,
    /// What is done when no master answers at a local address. Default: one is started in this process.
    pub own_master: OwnMaster,
    /// Haptic devices loaded, shown in the world's state. Default: 0.
    pub n_devices: u8,
}

impl Default for RosOptions {
    fn default() -> Self {
        Self { arguments: RosArguments::default(), own_master: OwnMaster::InProcess, n_devices: 0 }
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
    #[cfg(feature = "view")]
    pictures: Option<Arc<PictureTopics>>,
    running: Option<Running>,
}

struct Running {
    link: Arc<Link>,
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
            #[cfg(feature = "view")]
            pictures: None,
            running: None,
        }
    }

    /// Offers services with which clients add, remove and list models through `host`. Default: there are none.
    pub fn with_models(mut self, host: Arc<dyn ModelHost>) -> Self {
        self.models = Some(host);
        self
    }

    /// Announces topics of cameras that publish pictures, for somebody else to publish on: `topics` has them. Default:
    /// there are none.
    #[cfg(feature = "view")]
    pub fn with_pictures(mut self, topics: Arc<PictureTopics>) -> Self {
        self.pictures = Some(topics);
        self
    }

    /// Whether somebody told the node to shut down (`rosnode kill`).
    pub fn is_dismissed(&self) -> bool {
        self.running.as_ref().is_some_and(|running| running.link.is_dismissed())
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
        let RosOptions { arguments, own_master, n_devices } = self.options.clone();
        mismatch::report_mismatches();
        hub.set_listening();
        let waker = Arc::<Waker>::default();
        let link = Arc::new(Link::new(LinkOptions {
            master: master.clone(),
            name: arguments.node_name(NODE_NAME),
            own_master,
            parameters: arguments.parameters.clone(),
            report: Arc::new(crate::report::report),
        }));
        let (publisher, entries) = channel();
        let (to_parameters, changes) = channel();
        let told = ChangeSinks { link: Arc::clone(&link), publisher, parameters: to_parameters };
        let mut objects = Objects::new(ServeContext {
            hub: Arc::clone(&hub),
            waker: Arc::clone(&waker),
            n_devices,
            #[cfg(feature = "view")]
            pictures: self
                .pictures
                .clone()
                .map(|topics| pictures::Pictures { node: ros_node::SideNode::new(master.clone(), PICTURES), topics }),
            master,
            models: self.models.clone(),
            steppables: Arc::default(),
            arguments,
        });
        objects.follow(&told);
        let (alive, ended) = channel();
        let publisher = {
            let (hub, link, waker) = (Arc::clone(&hub), Arc::clone(&link), Arc::clone(&waker));
            named("ros-publish").spawn(move || scheduler::run(&hub, &entries, &link.stop, &waker))?
        };
        // From here on `stop` cleans up whatever has been started.
        self.running = Some(Running { link: Arc::clone(&link), waker, publisher, ended });
        let parameters = Parameters::new(hub, Arc::clone(&link), changes, Arc::clone(&self.clouds));
        spawn_detached("ros-parameters", &alive, move || parameters.run())?;
        spawn_detached("ros-objects", &alive, move || objects.run(&told))?;
        let swept = Arc::clone(&link);
        spawn_detached("ros-sockets", &alive, move || ros_node::tend_sockets(&swept))?;
        let connected = Arc::clone(&link);
        spawn_detached("ros-connect", &alive, move || ros_node::tend_connections(&connected))?;
        spawn_detached("ros-link", &alive, move || ros_node::run(&link))?;
        Ok(())
    }

    /// Takes at most 2 s, also when the master does not answer.
    fn stop(&mut self) {
        let Some(running) = self.running.take() else { return };
        let deadline = Instant::now() + STOP_TIMEOUT;
        running.link.stop.stop();
        running.waker.wake();
        if running.publisher.join().is_err() {
            report!("ROS: the publishing thread had ended with a panic");
        }
        // Disconnects when the last thread has dropped its sender.
        let left = deadline.saturating_duration_since(Instant::now());
        if running.ended.recv_timeout(left) == Err(std::sync::mpsc::RecvTimeoutError::Timeout) {
            report!("ROS: the master did not let us go within {} s; ended without it", STOP_TIMEOUT.as_secs());
        }
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
