//! Topics of arms on ROS 2: the messages of [`crtk`], converted from their encoding in ROS 1.

use std::sync::Arc;

use crtk::messages::{Message, MessageType};
use crtk::topics::Topic;
use crtk::transport::{Receive, Sender, Transport, TransportError};
use parking_lot::Mutex;
use ros2_node::{Description, Node, Options, Participant, Publication, Qos, Subscription, Transcoder, TypeName};

use super::super::signal::RateLimitedLog;

/// Longest message that is taken, bytes.
const LONGEST: usize = 64 << 10;

/// Rate for which messages are kept until they are acknowledged, Hz: arms publish at 100 Hz by default.
const RATE: f64 = 200.0;

/// Topics of ROS 2, in a node of their own. Dropping it ends the node.
pub struct ArmTopics {
    // Dropped in this order: what was made of a participant is of no use after it.
    subscriptions: Vec<Subscription>,
    node: Node,
    _participant: Participant,
}

impl ArmTopics {
    /// A node called `name`, of a participant of its own.
    ///
    /// # Errors
    /// [`TransportError::Other`] when a variable of the environment has a value that ROS 2 does not know, or there is no
    /// network, not even loopback.
    pub fn start(name: &str) -> Result<Self, TransportError> {
        let options = Options::from_environment(Arc::new(crate::report::report)).map_err(other)?;
        let participant = Participant::new(options).map_err(other)?;
        let node = participant.node("/", name).map_err(other)?;
        Ok(Self { subscriptions: Vec::new(), node, _participant: participant })
    }
}

fn other(error: impl std::fmt::Display) -> TransportError {
    TransportError::Other(format!("ROS 2: {error}"))
}

/// Name and converter of a type.
fn kind(message: MessageType) -> Result<(TypeName, Transcoder), TransportError> {
    let (name, definition) = message.definition();
    let name = TypeName::parse(&name).map_err(other)?;
    let description = Description::parse(name.clone(), &definition).map_err(other)?;
    Ok((name, Transcoder::new(&description).map_err(other)?))
}

fn qos(topic: &Topic) -> Qos {
    let qos = if topic.is_latched { Qos::latched() } else { Qos::states(RATE) };
    qos.with_depth(u32::try_from(topic.depth).unwrap_or(u32::MAX))
}

impl Transport for ArmTopics {
    fn advertise(&mut self, topic: &Topic) -> Result<Box<dyn Sender>, TransportError> {
        let (name, transcoder) = kind(topic.message)?;
        let publication = self.node.publish(&topic.name, &name, qos(topic)).map_err(other)?;
        Ok(Box::new(ArmSender { publication, transcoder, cdr: Mutex::default() }))
    }

    /// Readers are volatile: a command that was latched before the arm was there is not for it.
    fn subscribe(&mut self, topic: &Topic, receive: Receive) -> Result<(), TransportError> {
        let (name, transcoder) = kind(topic.message)?;
        let (mut ros1, complaints, own_name) = (Vec::new(), RateLimitedLog::default(), topic.name.clone());
        let on_message = move |body: &[u8]| match transcoder.to_ros1(body, &mut ros1) {
            Ok(()) => receive(&ros1),
            Err(error) => {
                complaints.report(format_args!("ROS 2: {own_name}: {error}; it is ignored"));
            }
        };
        let qos = Qos::new().with_depth(u32::try_from(topic.depth).unwrap_or(u32::MAX));
        let subscription = self.node.subscribe(&topic.name, &name, qos, LONGEST, on_message).map_err(other)?;
        self.subscriptions.push(subscription);
        Ok(())
    }
}

struct ArmSender {
    publication: Arc<Publication>,
    transcoder: Transcoder,
    /// Memory that is used again.
    cdr: Mutex<Vec<u8>>,
}

impl Sender for ArmSender {
    fn is_open(&self) -> bool {
        true
    }

    fn has_receivers(&self) -> bool {
        self.publication.is_matched()
    }

    fn send(&self, message: &Message) {
        let mut cdr = self.cdr.lock();
        if self.transcoder.to_cdr(&message.encode(), &mut cdr).is_ok() {
            // What a client that hangs does not read is lost, and counted.
            let _ = self.publication.send(&cdr);
        }
    }
}
