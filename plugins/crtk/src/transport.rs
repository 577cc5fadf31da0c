//! How topics reach clients: [`Transport`], and that of ROS 1.
//!
//! A transport has two verbs. What is sent is a [`Message`]: [`Message::encode`] gives its bytes in the encoding of
//! ROS 1, [`MessageType::definition`] its type and definition, for transports that encode anew. What is received are
//! bytes in that encoding.

use std::any::Any;
use std::sync::Arc;
use std::time::Duration;

use ros_node::{
    Announcement, LinkOptions, Node, NodeName, OwnMaster, Peer, Publication, RawSubscription, Report, ServiceKind,
    ServiceServer,
};
use rosrust::Message as RosMessage;
use thiserror::Error;

use crate::messages::{
    cisst_msgs, crtk_msgs, geometry_msgs, rosgraph_msgs, sensor_msgs, std_msgs, Message, MessageType, WithRos,
};
use crate::queries::{Service, ServiceType};
use crate::topics::Topic;

/// Why topics cannot be offered.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TransportError {
    /// Error when the address of the ROS master is none.
    #[error(transparent)]
    Master(#[from] ros_node::CallError),
    /// Error when no thread can be made.
    #[error("the threads of the ROS node cannot be made: {0}")]
    Thread(#[from] std::io::Error),
    /// Error of another transport.
    #[error("{0}")]
    Other(String),
}

/// Called with each message that comes, from a thread of the transport's; it returns at once.
pub type Receive = Arc<dyn Fn(&[u8]) + Send + Sync>;

/// Answers a request with the bytes of a message, or with a sentence why there is none. It is called in a thread of the
/// transport's, in several at once, and does not wait.
pub type Answer = Arc<dyn Fn(&[u8]) -> Result<Vec<u8>, String> + Send + Sync>;

/// A topic that is published.
pub trait Sender: Send {
    /// Whether what is sent now is sent, or kept for those who come later.
    fn is_open(&self) -> bool;

    /// Whether anybody listens.
    fn has_receivers(&self) -> bool;

    /// Sends without waiting for the network.
    fn send(&self, message: &Message);
}

/// A middleware.
pub trait Transport: Send {
    /// Opens a topic for sending.
    ///
    /// # Errors
    /// [`TransportError`].
    fn advertise(&mut self, topic: &Topic) -> Result<Box<dyn Sender>, TransportError>;

    /// Listens to a topic.
    ///
    /// # Errors
    /// [`TransportError`].
    fn subscribe(&mut self, topic: &Topic, receive: Receive) -> Result<(), TransportError>;

    /// Offers a service.
    ///
    /// # Errors
    /// [`TransportError`].
    fn serve(&mut self, service: &Service, answer: Answer) -> Result<(), TransportError>;
}

/// Makes the transports of an instance.
pub type Connect = Arc<dyn Fn() -> Result<Vec<Box<dyn Transport>>, TransportError> + Send + Sync>;

/// Longest message that is taken, bytes.
const LONGEST: usize = 64 << 10;

/// How long the program's other node may take to find or start a master.
const OTHERS_MASTER: Duration = Duration::from_secs(8);

/// How long a call to the master may take.
const TIMEOUT: Duration = Duration::from_secs(1);

/// Topics of ROS 1, in a node of their own. Dropping it ends the node.
pub struct Ros1 {
    node: Node,
    report: Report,
}

impl Ros1 {
    /// A node whose name begins with `name`; the master may come later.
    ///
    /// # Errors
    /// [`TransportError`].
    pub fn start(name: &str, report: Report) -> Result<Self, TransportError> {
        let master = Peer::new(&ros_node::master_uri(), &format!("/{name}"), TIMEOUT)?;
        let node = Node::start(LinkOptions {
            master,
            name: NodeName::Anonymous(name.into()),
            own_master: OwnMaster::Expected(OTHERS_MASTER),
            parameters: Vec::new(),
            report: Arc::clone(&report),
        })?;
        Ok(Self { node, report })
    }

    fn announce(&self, announcement: Arc<dyn Announcement>) {
        self.node.link().add([announcement]);
    }

    fn publication<M: RosMessage>(&self, topic: &Topic) -> Box<dyn Sender> {
        let name = topic.name.clone();
        let publication = if topic.is_latched { Publication::<M>::latched(name) } else { Publication::new(name) };
        self.announce(Arc::clone(&publication) as Arc<dyn Announcement>);
        Box::new(Ros1Sender { publication })
    }

    fn subscription<M: RosMessage>(&self, topic: &Topic, receive: Receive) {
        let on_message = move |message: ros_node::RawReceived<'_>| receive(message.body);
        self.announce(RawSubscription::of::<M>(topic.name.clone(), LONGEST, on_message));
    }
}

struct Ros1Sender<M: RosMessage> {
    publication: Arc<Publication<M>>,
}

impl<M: RosMessage> Sender for Ros1Sender<M> {
    fn is_open(&self) -> bool {
        self.publication.is_announced()
    }

    fn has_receivers(&self) -> bool {
        self.publication.has_subscribers()
    }

    fn send(&self, message: &Message) {
        struct To<'a>(&'a dyn Any);
        impl WithRos for To<'_> {
            type Output = ();

            fn with<N: RosMessage>(self, message: N) {
                // A message of another type than the topic's would be a bug, and is not sent.
                if let Some(publication) = self.0.downcast_ref::<Arc<Publication<N>>>() {
                    // A stamp of 0 says that the data are not valid now.
                    publication.send_as_is(&message);
                }
            }
        }
        message.with_ros(To(&self.publication));
    }
}

impl Transport for Ros1 {
    fn advertise(&mut self, topic: &Topic) -> Result<Box<dyn Sender>, TransportError> {
        Ok(match topic.message {
            MessageType::Joints => self.publication::<sensor_msgs::JointState>(topic),
            MessageType::Pose => self.publication::<geometry_msgs::PoseStamped>(topic),
            MessageType::Twist => self.publication::<geometry_msgs::TwistStamped>(topic),
            MessageType::Wrench => self.publication::<geometry_msgs::WrenchStamped>(topic),
            MessageType::Matrix => self.publication::<std_msgs::Float64MultiArray>(topic),
            MessageType::OperatingState => self.publication::<crtk_msgs::OperatingState>(topic),
            MessageType::StampedText => self.publication::<crtk_msgs::StringStamped>(topic),
            MessageType::Text => self.publication::<std_msgs::String>(topic),
            MessageType::Bool => self.publication::<std_msgs::Bool>(topic),
            MessageType::Empty => self.publication::<std_msgs::Empty>(topic),
            MessageType::Clock => self.publication::<rosgraph_msgs::Clock>(topic),
            MessageType::Statistics => self.publication::<cisst_msgs::IntervalStatistics>(topic),
            MessageType::Number => self.publication::<std_msgs::Float64>(topic),
            MessageType::Quaternion => self.publication::<geometry_msgs::Quaternion>(topic),
            MessageType::Channel => self.publication::<sensor_msgs::ChannelFloat32>(topic),
            MessageType::Count => self.publication::<std_msgs::UInt32>(topic),
        })
    }

    fn subscribe(&mut self, topic: &Topic, receive: Receive) -> Result<(), TransportError> {
        match topic.message {
            MessageType::Joints => self.subscription::<sensor_msgs::JointState>(topic, receive),
            MessageType::Pose => self.subscription::<geometry_msgs::PoseStamped>(topic, receive),
            MessageType::Twist => self.subscription::<geometry_msgs::TwistStamped>(topic, receive),
            MessageType::Wrench => self.subscription::<geometry_msgs::WrenchStamped>(topic, receive),
            MessageType::Matrix => self.subscription::<std_msgs::Float64MultiArray>(topic, receive),
            MessageType::OperatingState => self.subscription::<crtk_msgs::OperatingState>(topic, receive),
            MessageType::StampedText => self.subscription::<crtk_msgs::StringStamped>(topic, receive),
            MessageType::Text => self.subscription::<std_msgs::String>(topic, receive),
            MessageType::Bool => self.subscription::<std_msgs::Bool>(topic, receive),
            MessageType::Empty => self.subscription::<std_msgs::Empty>(topic, receive),
            MessageType::Clock => self.subscription::<rosgraph_msgs::Clock>(topic, receive),
            MessageType::Statistics => self.subscription::<cisst_msgs::IntervalStatistics>(topic, receive),
            MessageType::Number => self.subscription::<std_msgs::Float64>(topic, receive),
            MessageType::Quaternion => self.subscription::<geometry_msgs::Quaternion>(topic, receive),
            MessageType::Channel => self.subscription::<sensor_msgs::ChannelFloat32>(topic, receive),
            MessageType::Count => self.subscription::<std_msgs::UInt32>(topic, receive),
        }
        Ok(())
    }

    fn serve(&mut self, service: &Service, answer: Answer) -> Result<(), TransportError> {
        let ServiceType { name, md5sum, .. } = service.query.kind();
        let kind = ServiceKind { name, md5sum, longest: LONGEST };
        let report = Arc::clone(&self.report);
        let complain = move |what: &str| report(format_args!("ROS: {what}"));
        self.announce(ServiceServer::new(service.name.clone(), kind, move |request| answer(request), complain));
        Ok(())
    }
}
