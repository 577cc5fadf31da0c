//! A node: what it publishes, subscribes and serves.

use std::sync::Arc;

use crate::graph::NodeKey;
use crate::names::{self, TypeName};
use crate::parameters::{ParameterServices, Parameters};
use crate::participant::{Error, Shared};
use crate::publication::Publication;
use crate::qos::Qos;
use crate::service::{Request, Service};
use crate::subscription::Subscription;

/// A node of a participant. It leaves the graph when it, and all that was made of it, has been dropped.
#[derive(Clone)]
pub struct Node(Arc<Membership>);

/// A node's place in the graph.
pub(crate) struct Membership {
    pub shared: Arc<Shared>,
    pub key: NodeKey,
    full_name: String,
}

impl Drop for Membership {
    fn drop(&mut self) {
        self.shared.change_graph(|graph| graph.remove_node(self.key));
    }
}

impl Node {
    pub(crate) fn new(shared: &Arc<Shared>, namespace: &str, name: &str) -> Result<Self, Error> {
        let full_name = format!("{}/{name}", namespace.trim_end_matches('/'));
        let key = shared.new_key();
        let mut exists = false;
        shared.change_graph(|graph| {
            exists = graph.contains(namespace, name);
            if !exists {
                graph.add_node(key, namespace, name);
            }
        });
        if exists {
            return Err(Error::NodeExists(full_name));
        }
        Ok(Self(Arc::new(Membership { shared: Arc::clone(shared), key, full_name })))
    }

    /// Namespace and name: `/name`, or `/namespace/name`.
    pub fn full_name(&self) -> &str {
        &self.0.full_name
    }

    /// Publishes on `topic`, a full name.
    ///
    /// # Errors
    /// [`Error::Name`] or [`Error::Dds`].
    pub fn publish(&self, topic: &str, type_name: &TypeName, qos: Qos) -> Result<Arc<Publication>, Error> {
        names::check_topic(topic)?;
        Publication::new(Arc::clone(&self.0), &names::dds_topic(topic), topic, &type_name.dds(), qos)
    }

    /// Calls `on_message` with the body (CDR, little endian, without the four bytes before it) of each message on `topic`
    /// that has at most `longest` bytes; others are named once. It runs in the participant's thread and must not block.
    ///
    /// # Errors
    /// [`Error::Name`] or [`Error::Dds`].
    pub fn subscribe(
        &self,
        topic: &str,
        type_name: &TypeName,
        qos: Qos,
        longest: usize,
        on_message: impl FnMut(&[u8]) + Send + 'static,
    ) -> Result<Subscription, Error> {
        names::check_topic(topic)?;
        Subscription::new(Arc::clone(&self.0), topic, &type_name.dds(), qos, longest, Box::new(on_message))
    }

    /// Offers the service `name`, a full name, of the type `package/srv/Type`. `on_request` is called in the
    /// participant's thread with each request of at most `longest` bytes, and must not block: requests can be answered
    /// later and elsewhere.
    ///
    /// # Errors
    /// [`Error::Name`] or [`Error::Dds`].
    pub fn serve(
        &self,
        name: &str,
        type_name: &TypeName,
        longest: usize,
        on_request: impl FnMut(Request) + Send + 'static,
    ) -> Result<Service, Error> {
        names::check_topic(name)?;
        Service::new(Arc::clone(&self.0), name, type_name, longest, Box::new(on_request))
    }

    /// Offers `parameters` with the six services that each node of ROS 2 has for them, and `/parameter_events`.
    ///
    /// # Errors
    /// [`Error::Name`] or [`Error::Dds`].
    pub fn serve_parameters(&self, parameters: Arc<dyn Parameters>) -> Result<ParameterServices, Error> {
        ParameterServices::new(self, parameters)
    }
}
