//! ROS 2: the topics, services and parameters that ROS 1 has, from the same messages.
//!
//! A message is made once, by what makes it for ROS 1, and its bytes are converted ([`ros2_node::Transcoder`]); what
//! clients send takes the same way back. Each object is a node, as in version 3.0 of the C++ program.
//!
//! | thread | what it does |
//! |---|---|
//! | `ros2-publish` | publishes all states, each at its own rate |
//! | `ros2` | receives commands and requests, answers parameters, follows objects that come and go |
//! | two of RustDDS | sockets, discovery |
//! | `ros2-request` | one a request of a service, while it is answered |
//!
//! Arms for CRTK clients ([`ArmTopics`]) have a participant of their own, with the same threads but the first and last.

mod arms;
mod log;
mod objects;
mod parameters;
#[cfg(feature = "pictures")]
mod pictures;
mod transport;

use std::error::Error;
use std::sync::mpsc::channel;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use ambf_core::comm::{Hub, Middleware};
use parking_lot::Mutex;
use ros2_node::{Options, Participant, Timer};
use ros_node::Stop;

use super::arguments::RosArguments;
use super::frames::Frames;
use super::models::ModelHost;
#[cfg(feature = "pictures")]
use super::pictures::PictureTopics;
use super::point_cloud::PointClouds;
use super::recordings::RecordHost;
use super::scheduler;
use super::signal::Waker;
use super::topics::ServeContext;
use super::Extras;
use crate::report;
pub use arms::ArmTopics;
use objects::Objects;
use transport::Program;
pub(super) use transport::Transport;

/// How often the hub's list of objects is compared with what is served.
const POLL: Duration = Duration::from_millis(50);

/// What the ROS 2 side uses besides the hub.
#[derive(Clone, Default)]
pub struct Ros2Options {
    /// What the command line says to ROS. Default: nothing; the node that is the program is then called
    /// `ambf_simulator`.
    pub arguments: RosArguments,
    /// What is published beside the objects.
    pub extras: Extras,
}

/// Serves the objects of a hub to ROS 2.
///
/// Objects that come and go in the hub are followed. `ROS_DOMAIN_ID`, `ROS_AUTOMATIC_DISCOVERY_RANGE` and
/// `ROS_LOCALHOST_ONLY` are honoured; nothing leaves this machine unless they say so.
pub struct Ros2Middleware {
    options: Ros2Options,
    clouds: Arc<PointClouds>,
    models: Option<Arc<dyn ModelHost>>,
    recordings: Option<Arc<dyn RecordHost>>,
    #[cfg(feature = "pictures")]
    pictures: Option<Arc<PictureTopics>>,
    running: Option<Running>,
}

struct Running {
    following: Timer,
    program: Program,
    objects: Arc<Mutex<Objects>>,
    stop: Arc<Stop>,
    waker: Arc<Waker>,
    publisher: JoinHandle<()>,
}

impl Ros2Middleware {
    /// Not started yet.
    pub fn new(options: Ros2Options) -> Self {
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

    /// Adds topics of cameras that publish pictures, for somebody else to publish on: `topics` has them. Default: there
    /// are none.
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
}

impl Middleware for Ros2Middleware {
    /// # Errors
    /// When a variable of the environment has a value that ROS 2 does not know, there is no network, not even loopback,
    /// or no thread can be made.
    fn start(&mut self, hub: Arc<Hub>) -> Result<(), Box<dyn Error + Send + Sync>> {
        if self.running.is_some() {
            return Ok(());
        }
        let Ros2Options { arguments, extras } = self.options.clone();
        let frames = extras.tf.map(|_| Arc::<Frames>::default());
        let participant = Participant::new(Options::from_environment(Arc::new(crate::report::report))?)?;
        hub.set_listening();
        let waker = Arc::<Waker>::default();
        let transport = Arc::new(Transport::new(participant, &arguments));
        let program = transport.program(&arguments);
        let (publisher, entries) = channel();
        let around = ServeContext {
            hub: Arc::clone(&hub),
            waker: Arc::clone(&waker),
            extras,
            frames,
            models: self.models.clone(),
            recordings: self.recordings.clone(),
            steppables: Arc::default(),
            arguments,
            ros2: Some(Arc::clone(&transport)),
            #[cfg(feature = "pictures")]
            pictures: self.pictures.clone(),
        };
        let mut objects = Objects::new(around, publisher, Arc::clone(&self.clouds));
        objects.follow();
        let objects = Arc::new(Mutex::new(objects));
        let stop = Arc::<Stop>::default();
        let publisher = {
            let (stop, waker) = (Arc::clone(&stop), Arc::clone(&waker));
            let thread = std::thread::Builder::new().name("ros2-publish".into());
            thread.spawn(move || scheduler::run(&hub, &entries, &stop, &waker))?
        };
        let followed = Arc::downgrade(&objects);
        let following = transport.participant().call_every(POLL, move || {
            if let Some(objects) = followed.upgrade() {
                objects.lock().follow();
            }
        });
        self.running = Some(Running { following, program, objects, stop, waker, publisher });
        Ok(())
    }

    fn stop(&mut self) {
        let Some(Running { following, program, objects, stop, waker, publisher }) = self.running.take() else { return };
        drop(following);
        stop.stop();
        waker.wake();
        if publisher.join().is_err() {
            report!("ROS 2: the publishing thread had ended with a panic");
        }
        drop(program);
        // Ends the participant with all its nodes.
        drop(objects);
    }
}

impl Drop for Ros2Middleware {
    fn drop(&mut self) {
        self.stop();
    }
}
