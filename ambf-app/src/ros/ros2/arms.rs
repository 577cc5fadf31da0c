//! Topics of arms on ROS 2: the messages of [`crtk`], converted from their encoding in ROS 1.

use std::sync::Arc;

use crtk::messages::{Message, MessageType};
use crtk::queries::Service;
use crtk::topics::Topic;
use crtk::transport::{Answer, Receive, Sender, Transport, TransportError};
use parking_lot::Mutex;
use ros2_node::names::Kind;
use ros2_node::{
    Description, Node, Options, Participant, Publication, Qos, Request, Subscription, Transcoder, TypeName,
};

use super::super::arguments::RosArguments;
use super::super::signal::RateLimitedLog;

/// Longest message that is taken, bytes.
const LONGEST: usize = 64 << 10;

/// Rate for which messages are kept until they are acknowledged, Hz: arms publish at 100 Hz by default.
const RATE: f64 = 200.0;

/// Topics of ROS 2, in a node of their own. Dropping it ends the node.
pub struct ArmTopics {
    // Dropped in this order: what was made of a participant is of no use after it.
    subscriptions: Vec<Subscription>,
    services: Vec<ros2_node::Service>,
    node: Node,
    _participant: Participant,
}

impl ArmTopics {
    /// A node called `name`, in the namespace that the command line says, of a participant of its own.
    ///
    /// # Errors
    /// [`TransportError::Other`] when a variable of the environment has a value that ROS 2 does not know, or there is no
    /// network, not even loopback.
    pub fn start(name: &str, arguments: &RosArguments) -> Result<Self, TransportError> {
        let options = Options::from_environment(Arc::new(crate::report::report)).map_err(other)?;
        let participant = Participant::new(options).map_err(other)?;
        let namespace = arguments.namespace.as_deref().unwrap_or("/");
        let node = participant.node(namespace, name).map_err(other)?;
        Ok(Self { subscriptions: Vec::new(), services: Vec::new(), node, _participant: participant })
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

    /// Requests are answered in the thread `ros2`: answers do not wait.
    fn serve(&mut self, service: &Service, answer: Answer) -> Result<(), TransportError> {
        let kind = service.query.kind();
        let type_name = TypeName { kind: Kind::Service, ..TypeName::parse(&kind.name).map_err(other)? };
        let half = |name: TypeName, text: &str| -> Result<Transcoder, TransportError> {
            Transcoder::new(&Description::parse(name, text).map_err(other)?).map_err(other)
        };
        let request = half(type_name.request(), &kind.request)?;
        let response = half(type_name.response(), &kind.response)?;
        let (complaints, own_name) = (RateLimitedLog::default(), service.name.clone());
        let (mut ros1, mut cdr) = (Vec::new(), Vec::new());
        let on_request = move |asked: Request| {
            let read = request.to_ros1(asked.body(), &mut ros1).map_err(|error| error.to_string());
            let answered = read.and_then(|()| answer(&ros1));
            let written =
                answered.and_then(|bytes| response.to_cdr(&bytes, &mut cdr).map_err(|error| error.to_string()));
            match written {
                Ok(()) => asked.reply(&cdr),
                // A client of ROS 2 cannot be told.
                Err(why) => {
                    complaints.report(format_args!("ROS 2: {own_name}: {why}; it is ignored"));
                }
            }
        };
        self.services.push(self.node.serve(&service.name, &type_name, LONGEST, on_request).map_err(other)?);
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
