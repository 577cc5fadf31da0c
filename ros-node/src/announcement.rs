//! What the node announces to the master: topics it publishes, topics it subscribes and services.

use std::sync::Arc;

use super::service::Desk;
use super::subscriber::Subscription;
use super::topic::Topic;

/// Which side of a topic the node is on, or that it offers a service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Direction {
    /// Messages go out.
    Publishes,
    /// Messages come in.
    Subscribes,
    /// A service.
    Serves,
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

/// One topic that the node takes part in, or one service: [`Publication`](super::Publication),
/// [`LargePublication`](super::LargePublication), [`RawSubscription`](super::RawSubscription) or
/// [`ServiceServer`](super::ServiceServer). Nobody else can implement it.
pub trait Announcement: Send + Sync {
    /// What is registered at the master.
    fn registration(&self) -> Registration;

    /// What the node's thread serves.
    #[doc(hidden)]
    fn endpoint(&self) -> Endpoint;

    /// Uses what another announcement of the same name has brought, from when it is announced.
    #[doc(hidden)]
    fn share(&self, _with: Endpoint) {}
}

/// What the node's thread serves.
#[doc(hidden)]
pub struct Endpoint(pub(crate) Serves);

pub(crate) enum Serves {
    Topic(Arc<Topic>),
    Subscription(Arc<Subscription>),
    Service(Arc<Desk>),
}

impl Endpoint {
    pub(crate) fn topic(topic: Arc<Topic>) -> Self {
        Self(Serves::Topic(topic))
    }

    pub(crate) fn into_topic(self, use_it: impl FnOnce(Arc<Topic>)) {
        if let Serves::Topic(topic) = self.0 {
            use_it(topic);
        }
    }
}
