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
//!
//! ## Limitations
//! No pictures of cameras and no point clouds.

mod arms;
mod objects;
mod parameters;
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
use super::scheduler;
use super::signal::Waker;
use super::topics::ServeContext;
use super::Extras;
use crate::report;
pub use arms::ArmTopics;
use objects::Objects;
pub(super) use transport::Transport;

/// How often the hub's list of objects is compared with what is served.
const POLL: Duration = Duration::from_millis(50);

/// What the ROS 2 side is told besides the hub.
#[derive(Clone, Default)]
pub struct Ros2Options {
    /// What is published beside the objects.
    pub extras: Extras,
}

/// Serves the objects of a hub to ROS 2.
///
/// Objects that come and go in the hub are followed. `ROS_DOMAIN_ID`, `ROS_AUTOMATIC_DISCOVERY_RANGE` and
/// `ROS_LOCALHOST_ONLY` are honoured; nothing leaves this machine unless they say so.
pub struct Ros2Middleware {
    options: Ros2Options,
    models: Option<Arc<dyn ModelHost>>,
    running: Option<Running>,
}

struct Running {
    following: Timer,
    objects: Arc<Mutex<Objects>>,
    stop: Arc<Stop>,
    waker: Arc<Waker>,
    publisher: JoinHandle<()>,
}

impl Ros2Middleware {
    /// Not started yet.
    pub fn new(options: Ros2Options) -> Self {
        Self { options, models: None, running: None }
    }

    /// Offers services with which clients add, remove and list models through `host`. Default: there are none.
    pub fn with_models(mut self, host: Arc<dyn ModelHost>) -> Self {
        self.models = Some(host);
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
        let Ros2Options { extras } = self.options.clone();
        let frames = extras.tf.map(|_| Arc::<Frames>::default());
        let participant = Participant::new(Options::from_environment(Arc::new(crate::report::report))?)?;
        hub.set_listening();
        let waker = Arc::<Waker>::default();
        let transport = Arc::new(Transport::new(participant));
        let (publisher, entries) = channel();
        let around = ServeContext {
            hub: Arc::clone(&hub),
            waker: Arc::clone(&waker),
            extras,
            frames,
            models: self.models.clone(),
            steppables: Arc::default(),
            arguments: RosArguments::default(),
            ros2: Some(Arc::clone(&transport)),
            #[cfg(feature = "view")]
            pictures: None,
        };
        let mut objects = Objects::new(around, publisher);
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
        self.running = Some(Running { following, objects, stop, waker, publisher });
        Ok(())
    }

    fn stop(&mut self) {
        let Some(Running { following, objects, stop, waker, publisher }) = self.running.take() else { return };
        drop(following);
        stop.stop();
        waker.wake();
        if publisher.join().is_err() {
            report!("ROS 2: the publishing thread had ended with a panic");
        }
        // Ends the participant with all its nodes.
        drop(objects);
    }
}

impl Drop for Ros2Middleware {
    fn drop(&mut self) {
        self.stop();
    }
}
