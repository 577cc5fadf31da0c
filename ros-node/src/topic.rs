//! What the node announces to the master: topics it publishes, topics it subscribes and services.

use std::sync::Arc;

use parking_lot::Mutex;
use rosrust::api::Ros;
use rosrust::error::{tcpros, Error, ErrorKind};
use rosrust::{Message, Publisher};

use super::subscriber::Publishers;
use super::Report;

/// Queue of every State, as in the original.
const QUEUE: usize = 10;

/// Which side of a topic the node is on, or that it offers a service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Direction {
    /// Messages go out.
    Publishes,
    /// Messages go out from another node of the process.
    PublishesAs {
        /// Its name; empty before it is announced.
        node: String,
        /// Its address.
        uri: String,
    },
    /// Messages come in.
    Subscribes,
    /// A service.
    Serves {
        /// `rosrpc://HOST:PORT`; empty before it is announced.
        uri: String,
    },
}

/// A topic or service as the master knows it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Registration {
    /// Name of the topic or service.
    pub topic: String,
    /// `package/Type`.
    pub message_type: String,
    /// Which side.
    pub direction: Direction,
}

/// One topic that the node takes part in, or one service.
pub trait Announcement: Send + Sync {
    /// What the master is told.
    fn registration(&self) -> Registration;

    /// Opens it and tells the master; blocks while the master thinks.
    ///
    /// # Errors
    /// rosrust's; see [`is_permanent`].
    fn announce(&self, ros: &Ros) -> Result<(), Error>;

    /// Closes it and tells the master; blocks while the master thinks.
    fn withdraw(&self);

    /// Whether it wants to be told who publishes, see [`connect`](Self::connect).
    fn connects(&self) -> bool {
        false
    }

    /// Connects to publishers that it is not connected to, and says through `report` what is wrong with one; returns at
    /// once.
    fn connect(&self, _publishers: &Publishers, _report: &Report) {}
}

/// Whether it is no use to announce the same thing again later.
pub fn is_permanent(error: &Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::Naming(_)
            | ErrorKind::MismatchedType(..)
            | ErrorKind::Tcpros(tcpros::ErrorKind::MessageTypeMismatch(..))
    )
}

/// A topic to publish on. Nothing is sent before it is announced.
pub struct Publication<M: Message> {
    topic: String,
    latched: bool,
    publisher: Mutex<Option<Publisher<M>>>,
}

impl<M: Message> Publication<M> {
    /// A topic whose subscribers get what is sent after they have connected.
    pub fn new(topic: String) -> Arc<Self> {
        Arc::new(Self { topic, latched: false, publisher: Mutex::new(None) })
    }

    /// A topic whose subscribers get the last message too that was sent before they connected.
    pub fn latched(topic: String) -> Arc<Self> {
        Arc::new(Self { topic, latched: true, publisher: Mutex::new(None) })
    }

    /// Whether the master has been told and [`send`](Self::send) has an effect.
    pub fn is_announced(&self) -> bool {
        self.publisher.lock().is_some()
    }

    /// Whether anybody is connected.
    pub fn has_subscribers(&self) -> bool {
        self.publisher.lock().as_ref().is_some_and(|publisher| publisher.subscriber_count() > 0)
    }

    /// Hands `message` to the sending thread of the topic; never waits for the network.
    pub fn send(&self, message: M) {
        if let Some(publisher) = self.publisher.lock().as_ref() {
            // Encoding into memory cannot fail, and a topic that is just being withdrawn needs no message.
            let _ = publisher.send(message);
        }
    }
}

impl<M: Message> Announcement for Publication<M> {
    fn registration(&self) -> Registration {
        Registration { topic: self.topic.clone(), message_type: M::msg_type(), direction: Direction::Publishes }
    }

    fn announce(&self, ros: &Ros) -> Result<(), Error> {
        let mut publisher = ros.publish(&self.topic, QUEUE)?;
        publisher.set_latching(self.latched);
        *self.publisher.lock() = Some(publisher);
        Ok(())
    }

    fn withdraw(&self) {
        // Dropped outside the lock: telling the master can take long.
        let publisher = self.publisher.lock().take();
        drop(publisher);
    }
}
