//! Topics and services of ROS 2 from the messages of ROS 1.

use std::any::Any;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Weak};
use std::time::{SystemTime, UNIX_EPOCH};

use ambf_core::comm::{Rates, Snapshot};
use parking_lot::Mutex;
use ros2_node::names::Kind;
use ros2_node::{
    Description, Node, Parameters, Participant, Publication, Qos, Request, Subscription, TranscodeError, Transcoder,
    TypeName, UnusableType, Value,
};
use rosrust::{Message, RosMsg, ServicePair};

use super::super::arguments::RosArguments;
use super::super::messages::ambf_msgs;
use super::super::models;
use super::super::point_cloud::PointClouds;
use super::super::received::{self, FromClient};
use super::super::recordings;
use super::super::ros_args::PROGRAM;
use super::super::scheduler::{Outlet, Watch};
use super::super::signal::RateLimitedLog;
use super::super::step;
use super::super::topics::ServeContext;
use super::log::Log;
use super::parameters::{from_command_line, CloudTopics, Given};
use crate::{report, warn};

/// Longest request of a service, bytes, as with ROS 1.
const MAX_REQUEST: usize = 64 << 10;

/// Requests of a service that are answered at the same time; of more, clients get no answer.
const REQUESTS_AT_ONCE: usize = 16;

/// Where the stamp of a header is in ROS 1, and its bytes.
const STAMP: std::ops::Range<usize> = 4..12;

pub(super) type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Makes what one node after the other has.
pub(in super::super) struct Transport {
    participant: Participant,
    /// Namespace of all nodes.
    namespace: String,
    /// Parameters of objects: full names and values that they are to have from the beginning.
    values: Vec<(String, Value)>,
    current: Mutex<Option<NodeParts>>,
}

/// The node that is the program. Dropping it ends it.
pub(super) struct Program {
    // Dropped in this order.
    _log: Option<Log>,
    _node: NodeParts,
}

/// A node with what it has. Dropping it ends that.
pub(in super::super) struct NodeParts {
    node: Option<Node>,
    parts: Vec<Box<dyn Any + Send>>,
}

impl Transport {
    pub fn new(participant: Participant, arguments: &RosArguments) -> Self {
        let namespace = arguments.namespace.clone().unwrap_or_else(|| "/".into());
        let values = arguments.of_objects.iter();
        let values = values.filter_map(|(name, value)| Some((name.clone(), from_command_line(value)?))).collect();
        Self { participant, namespace, values, current: Mutex::default() }
    }

    pub fn participant(&self) -> &Participant {
        &self.participant
    }

    /// The node that is the program: its parameters, and `/rosout`.
    pub(super) fn program(&self, arguments: &RosArguments) -> Program {
        self.begin(arguments.name.as_deref().unwrap_or(PROGRAM));
        if !arguments.parameters.is_empty() {
            self.serve_parameters(Given::new(&arguments.parameters));
        }
        let log = || self.with_node("/rosout", |node| Log::new(&self.participant, node));
        Program { _log: (!arguments.no_log).then(log).flatten(), _node: self.finish() }
    }

    /// What is made from now on belongs to a new node.
    pub fn begin(&self, node: &str) {
        let node = self.participant.node(&self.namespace, node).map_err(|error| report!("ROS 2: {error}")).ok();
        *self.current.lock() = Some(NodeParts { node, parts: Vec::new() });
    }

    /// What is made from now on belongs to the node of `parts`.
    pub fn resume(&self, parts: NodeParts) {
        *self.current.lock() = Some(parts);
    }

    /// What was made since [`begin`](Self::begin) or [`resume`](Self::resume), with what was resumed.
    pub fn finish(&self) -> NodeParts {
        self.current.lock().take().unwrap_or(NodeParts { node: None, parts: Vec::new() })
    }

    /// Has `make` use the current node; what goes wrong is reported.
    fn with_node<T>(&self, name: &str, make: impl FnOnce(&Node) -> Result<T, Failure>) -> Option<T> {
        let node = self.current.lock().as_ref()?.node.clone()?;
        make(&node).map_err(|error| report!("ROS 2: {name}: {error}")).ok()
    }

    fn keep(&self, part: impl Any + Send) {
        if let Some(current) = &mut *self.current.lock() {
            current.parts.push(Box::new(part));
        }
    }

    /// An outlet for `topic`, whose last message subscribers get that come later if it is latched; `None` where that
    /// cannot be.
    pub fn publish<M: Message>(
        &self,
        topic: &str,
        rates: Rates,
        is_latched: bool,
        message: impl FnMut(Option<&Snapshot>) -> Option<M> + Send + 'static,
    ) -> Option<Box<dyn Outlet>> {
        let made = self.with_node(topic, |node| {
            let (name, description) = described::<M>()?;
            let stamped = description.fields().first().is_some_and(|field| field.name == "header");
            let qos = if is_latched { Qos::latched() } else { Qos::states(f64::from(rates.max)) };
            let publication = node.publish(topic, &name, qos)?;
            Ok((publication, Converted::new(&description)?, stamped))
        });
        let (publication, bytes, stamped) = made?;
        Some(Box::new(StateOutlet { publication, message, bytes, stamped, is_latched }))
    }

    /// A topic of the current node whose last message subscribers get that come later; `None` where that cannot be.
    pub fn latched<M: Message>(&self, topic: &str) -> Option<Latched> {
        self.large::<M>(topic, Qos::latched()).map(|(publication, bytes)| Latched { publication, bytes })
    }

    /// A topic for large messages of type `M`, which ends with the current node; `None` where that cannot be.
    pub(super) fn large<M: Message>(&self, topic: &str, qos: Qos) -> Option<(Weak<Publication>, Converted)> {
        let made = self.with_node(topic, |node| {
            let (name, description) = described::<M>()?;
            Ok((node.publish(topic, &name, qos)?, Converted::new(&description)?))
        });
        let (publication, bytes) = made?;
        let weak = Arc::downgrade(&publication);
        self.keep(publication);
        Some((weak, bytes))
    }

    /// Calls `on_message` with messages of at most `longest` bytes; bytes that are no `M` are named.
    pub fn subscribe<M: FromClient>(&self, topic: &str, longest: usize, on_message: impl FnMut(M) + Send + 'static) {
        let made = self.with_node(topic, |node| subscription(node, topic, longest, on_message));
        made.into_iter().for_each(|subscription| self.keep(subscription));
    }

    /// The services of the world whose topics begin with `name`.
    pub fn serve_world(&self, around: &ServeContext, name: &str) {
        let (hub, steppables) = (Arc::clone(&around.hub), Arc::clone(&around.steppables));
        let own_name = |service: &str| around.arguments.mapped(format!("{name}/{service}"));
        self.serve::<ambf_msgs::Step>(&own_name("Step"), move |request| step::reply(&hub, &steppables, &request));
        if let Some(host) = &around.recordings {
            let (starter, stopper) = (Arc::clone(host), Arc::clone(host));
            self.serve::<ambf_msgs::StartRecording>(&own_name("StartRecording"), move |request| {
                recordings::start(&*starter, &request)
            });
            self.serve::<ambf_msgs::StopRecording>(&own_name("StopRecording"), move |_| recordings::stop(&*stopper));
        }
        let Some(host) = &around.models else { return };
        let (adder, remover, lister) = (Arc::clone(host), Arc::clone(host), Arc::clone(host));
        self.serve::<ambf_msgs::AddModel>(&own_name("AddModel"), move |request| models::add(&*adder, &request));
        self.serve::<ambf_msgs::RemoveModel>(&own_name("RemoveModel"), move |request| {
            models::remove(&*remover, &request)
        });
        self.serve::<ambf_msgs::ListModels>(&own_name("ListModels"), move |request| models::list(&*lister, &request));
    }

    /// The service `name`. `answer` runs in a thread of its own for each request.
    fn serve<S: ServicePair>(&self, name: &str, answer: impl Fn(S::Request) -> S::Response + Send + Sync + 'static)
    where
        S::Request: FromClient,
        S::Response: Message,
    {
        let made = self.with_node(name, |node| {
            let type_name = TypeName { kind: Kind::Service, ..TypeName::parse(&S::msg_type())? };
            let half = |name: TypeName, text: String| -> Result<Transcoder, Failure> {
                Ok(Transcoder::new(&Description::parse(name, &text)?)?)
            };
            let request = half(type_name.request(), S::Request::msg_definition())?;
            let response = half(type_name.response(), S::Response::msg_definition())?;
            let service =
                Arc::new(Answering { name: name.into(), request, response, answer, busy: AtomicUsize::new(0) });
            let on_request = move |request| Answering::take::<S>(&service, request);
            Ok(node.serve(name, &type_name, MAX_REQUEST, on_request)?)
        });
        made.into_iter().for_each(|service| self.keep(service));
    }

    /// Offers `parameters` on the current node; those that the command line gives values have these.
    pub fn serve_parameters(&self, parameters: Arc<dyn Parameters>) {
        let all = parameters.all();
        for (name, value) in self.values.iter().filter(|(name, _)| all.iter().any(|own| own.name == *name)) {
            if let Err(why) = parameters.set(name, value) {
                warn!("ROS 2: the parameter {name} is not set: {why}");
            }
        }
        let made = self.with_node("parameters", |node| Ok(node.serve_parameters(parameters)?));
        made.into_iter().for_each(|services| self.keep(services));
    }

    /// Listens to clouds of points for `clouds`, on topics that the parameter of `world` on the current node lists.
    pub fn serve_clouds(&self, clouds: &Arc<PointClouds>, world: &str) {
        let topics = self.with_node(world, |node| CloudTopics::new(clouds, node, world));
        topics.into_iter().for_each(|topics| self.serve_parameters(topics));
    }
}

/// Name and description of `M`.
fn described<M: Message>() -> Result<(TypeName, Description), Failure> {
    let name = TypeName::parse(&M::msg_type())?;
    let description = Description::parse(name.clone(), &M::msg_definition())?;
    Ok((name, description))
}

/// Calls `on_message` with the messages of at most `longest` bytes that come on `topic`; bytes that are no `M` are named.
pub(super) fn subscription<M: FromClient>(
    node: &Node,
    topic: &str,
    longest: usize,
    mut on_message: impl FnMut(M) + Send + 'static,
) -> Result<Subscription, Failure> {
    let (name, description) = described::<M>()?;
    let mut bytes = Converted::new(&description)?;
    let (complaints, topic_name) = (RateLimitedLog::default(), topic.to_owned());
    let on_bytes = move |body: &[u8]| match bytes.read(body) {
        Ok(message) => on_message(message),
        Err(why) => {
            complaints.report(format_args!("{topic_name}: {why}; they are ignored"));
        }
    };
    Ok(node.subscribe(topic, &name, Qos::new(), longest, on_bytes)?)
}

/// Bytes on their way, whose memory is used again.
pub(super) struct Converted {
    pub transcoder: Transcoder,
    pub ros1: Vec<u8>,
    pub cdr: Vec<u8>,
}

impl Converted {
    fn new(description: &Description) -> Result<Self, UnusableType> {
        Ok(Self { transcoder: Transcoder::new(description)?, ros1: Vec::new(), cdr: Vec::new() })
    }

    /// The `M` in `body`, checked as one of ROS 1.
    fn read<M: FromClient>(&mut self, body: &[u8]) -> Result<M, String> {
        let error = |error: TranscodeError| format!("{} bytes are not a {}: {error}", body.len(), M::msg_type());
        self.transcoder.to_ros1(body, &mut self.ros1).map_err(error)?;
        received::read(&self.ros1)
    }
}

/// A topic for messages that seldom change.
pub(in super::super) struct Latched {
    publication: Weak<Publication>,
    bytes: Converted,
}

impl Latched {
    /// Sends a message of the topic's type.
    pub fn send(&mut self, message: &impl Message) {
        let Converted { transcoder, ros1, cdr } = &mut self.bytes;
        ros1.clear();
        // Encoding into memory cannot fail, and what was encoded is a message.
        if message.encode(&mut *ros1).is_ok() && transcoder.to_cdr(ros1, cdr).is_ok() {
            let _ = self.publication.upgrade().map(|publication| publication.send(cdr));
        }
    }
}

/// An outlet that makes its messages with a function, which returns `None` while there is nothing to say.
struct StateOutlet<F> {
    publication: Arc<Publication>,
    message: F,
    bytes: Converted,
    /// Whether the message begins with a header.
    stamped: bool,
    is_latched: bool,
}

impl<M: Message, F: FnMut(Option<&Snapshot>) -> Option<M> + Send> Outlet for StateOutlet<F> {
    fn is_wanted(&self) -> bool {
        self.is_latched || self.publication.is_matched()
    }

    fn publish(&mut self, snapshot: Option<&Snapshot>) {
        let Some(message) = (self.message)(snapshot) else { return };
        let Converted { transcoder, ros1, cdr } = &mut self.bytes;
        ros1.clear();
        // Encoding into memory cannot fail, and what was encoded is a message.
        if message.encode(&mut *ros1).is_err() {
            return;
        }
        if let Some(stamp) = ros1.get_mut(STAMP).filter(|_| self.stamped) {
            // ROS 1 sends the time of sending then.
            if *stamp == [0; 8] {
                stamp.copy_from_slice(&now());
            }
        }
        if transcoder.to_cdr(ros1, cdr).is_ok() {
            // What a client that hangs does not read is lost, and counted.
            let _ = self.publication.send(cdr);
        }
    }

    fn watch(&self) -> Watch {
        let publication = Arc::downgrade(&self.publication);
        Box::new(move || publication.upgrade().is_some_and(|publication| publication.is_matched()))
    }
}

/// Seconds and nanoseconds since 1970, the same in ROS 1 and 2.
fn now() -> [u8; 8] {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    stamp(since.as_secs(), since.subsec_nanos())
}

fn stamp(seconds: u64, nanoseconds: u32) -> [u8; 8] {
    let mut bytes = [0; 8];
    bytes[..4].copy_from_slice(&(seconds as u32).to_le_bytes());
    bytes[4..].copy_from_slice(&nanoseconds.to_le_bytes());
    bytes
}

/// A service that is being offered.
struct Answering<F> {
    name: String,
    request: Transcoder,
    response: Transcoder,
    answer: F,
    busy: AtomicUsize,
}

impl<F> Answering<F> {
    /// Answers `request` in a thread of its own: it may take long.
    fn take<S: ServicePair>(service: &Arc<Self>, request: Request)
    where
        S::Request: FromClient,
        F: Fn(S::Request) -> S::Response + Send + Sync + 'static,
    {
        if service.busy.fetch_add(1, Ordering::SeqCst) >= REQUESTS_AT_ONCE {
            service.busy.fetch_sub(1, Ordering::SeqCst);
            return report!("ROS 2: {}: a request is ignored: {REQUESTS_AT_ONCE} are being answered", service.name);
        }
        let own = Arc::clone(service);
        let thread = std::thread::Builder::new().name("ros2-request".into());
        let started = thread.spawn(move || {
            match own.reply::<S>(request.body()) {
                Ok(reply) => request.reply(&reply),
                Err(why) => report!("ROS 2: {}: {why}; it is ignored", own.name),
            }
            own.busy.fetch_sub(1, Ordering::SeqCst);
        });
        if let Err(error) = started {
            service.busy.fetch_sub(1, Ordering::SeqCst);
            report!("ROS 2: {}: no thread for a request: {error}", service.name);
        }
    }

    fn reply<S: ServicePair>(&self, body: &[u8]) -> Result<Vec<u8>, String>
    where
        S::Request: FromClient,
        F: Fn(S::Request) -> S::Response,
    {
        let (mut ros1, mut cdr) = (Vec::new(), Vec::new());
        self.request.to_ros1(body, &mut ros1).map_err(|error| error.to_string())?;
        let answer = (self.answer)(received::read(&ros1)?);
        ros1.clear();
        answer.encode(&mut ros1).map_err(|error| error.to_string())?;
        self.response.to_cdr(&ros1, &mut cdr).map_err(|error| error.to_string())?;
        Ok(cdr)
    }
}
