//! The connection to the ROS master: finds it or starts one, announces everything, notices when it goes or forgets us.
//!
//! rosrust registers a topic once and never looks back. When the master was restarted, the same registrations are made
//! again with calls of our own, in the name and with the address of the running node: connections between nodes stay up
//! meanwhile.

use std::collections::HashSet;
use std::mem::discriminant;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::Arc;
use std::time::Duration;

use dxr::Value;
use parking_lot::Mutex;
use rosrust::api::Ros;

use super::embedded::{local_address, EmbeddedMaster};
use super::lasting::{start_master, UNUSED};
use super::sockets::Sockets;
use super::stop::Stop;
use super::subscriber::Listing;
use super::topic::{is_permanent, Announcement, Direction, Registration};
use super::xmlrpc::{CallError, Peer};
use super::Report;

/// How often the master is asked whether it knows us.
const POLL: Duration = Duration::from_secs(1);

/// How often the master is asked who publishes: it tells only rosrust by itself, which does not pass it on. Costs a
/// master with 400 topics about 2 ms of computing each time.
const CONNECT_POLL: Duration = Duration::from_millis(100);

/// How long a master may take to start.
const STARTING: Duration = Duration::from_secs(5);

/// Type of the log topic that rosrust opens for each node.
const ROSOUT: &str = "/rosout";

/// Nodes that this process has made.
static NODES: AtomicU64 = AtomicU64::new(0);

impl NodeName {
    fn to_use(&self) -> String {
        let base = match self {
            Self::Exact(name) => return name.clone(),
            Self::Anonymous(base) => base,
        };
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        let name = format!("{base}_{}_{}", std::process::id(), now.as_millis());
        // Another node of this process may come up in the same millisecond, and would be shut down in favour of this
        // one.
        match NODES.fetch_add(1, Ordering::Relaxed) {
            0 => name,
            earlier => format!("{name}_{earlier}"),
        }
    }
}

struct Item {
    announcement: Arc<dyn Announcement>,
    /// Number of its announcement, unique in the link; `None` before.
    announced: Option<u64>,
}

impl Item {
    fn new(announcement: Arc<dyn Announcement>) -> Self {
        Self { announcement, announced: None }
    }
}

/// What is done when there is no master and its address is one of this machine.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum OwnMaster {
    /// It is waited for.
    #[default]
    None,
    /// One is started in this process; it ends with the program.
    InProcess,
    /// This program is started to be one ([`start_master`](super::start_master)); it lasts as long as somebody uses it.
    Program(PathBuf),
}

/// How a node is called.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NodeName {
    /// Process id and time are appended, and a number if it is not the first of the process.
    Anonymous(String),
    /// As it is; a node of the same name is shut down by the master.
    Exact(String),
}

/// How a link is to be.
#[derive(Clone)]
pub struct LinkOptions {
    /// The master.
    pub master: Peer,
    /// Name of the node, without namespace.
    pub name: NodeName,
    /// What is done without a master.
    pub own_master: OwnMaster,
    /// Private parameters, name and value, that are set when the node is made.
    pub parameters: Vec<(String, Value)>,
    /// Where it says what its user should know.
    pub report: Report,
}

/// What the threads of a node share.
pub struct Link {
    options: LinkOptions,
    items: Mutex<Vec<Item>>,
    /// Held while something is announced or withdrawn, which can take long.
    changing: Mutex<()>,
    announcements: AtomicU64,
    /// Name and address of the node once there is one.
    node: Mutex<Option<(String, String)>>,
    generation: AtomicU64,
    dismissed: AtomicBool,
    /// Ends everything.
    pub stop: Stop,
    sockets: Sockets,
}

impl Link {
    /// A link that nobody tends yet, see [`run`] and [`tend_sockets`].
    pub fn new(options: LinkOptions) -> Self {
        let sockets = Sockets::new(&options.report);
        Self {
            options,
            items: Mutex::default(),
            changing: Mutex::default(),
            announcements: AtomicU64::new(0),
            node: Mutex::new(None),
            generation: AtomicU64::new(0),
            dismissed: AtomicBool::new(false),
            stop: Stop::default(),
            sockets,
        }
    }

    /// How many times everything was registered with a master that did not know us; 0 before the first time.
    pub fn generation(&self) -> u64 {
        self.generation.load(Ordering::Acquire)
    }

    /// The master, called in the node's name once there is a node.
    pub fn master(&self) -> Peer {
        match &*self.node.lock() {
            Some((name, _)) => self.options.master.called_by(name),
            None => self.options.master.clone(),
        }
    }

    /// Whether somebody told the node to shut down (`rosnode kill`).
    pub fn is_dismissed(&self) -> bool {
        self.dismissed.load(Ordering::Acquire)
    }

    pub(crate) fn report(&self, line: std::fmt::Arguments<'_>) {
        (self.options.report)(line);
    }

    /// Waits until a master that was just started answers; false when it does not, or the link is stopped.
    fn await_master(&self) -> bool {
        for _ in 0..STARTING.as_millis() / 10 {
            if self.options.master.call("getPid", vec![]).is_ok() {
                return true;
            }
            if self.stop.wait(Duration::from_millis(10)) {
                break;
            }
        }
        false
    }

    /// Announces more soon.
    pub fn add(&self, announcements: impl IntoIterator<Item = Arc<dyn Announcement>>) {
        self.items.lock().extend(announcements.into_iter().map(Item::new));
        self.stop.nudge();
    }

    /// Withdraws `gone`; blocks while the master thinks.
    pub fn remove(&self, gone: &[Arc<dyn Announcement>]) {
        if gone.is_empty() {
            return;
        }
        let _change = self.changing.lock();
        let key = |announcement: &dyn Announcement| {
            let Registration { topic, direction, .. } = announcement.registration();
            (topic, discriminant(&direction))
        };
        let keys: HashSet<_> = gone.iter().map(|announcement| key(&**announcement)).collect();
        // rosrust closes a topic for all who share it: the others have to open it again.
        let touched =
            self.items.lock().extract_if(.., |item| keys.contains(&key(&*item.announcement))).collect::<Vec<_>>();
        let own = self.node.lock().as_ref().and_then(|(_, uri)| own_peer(uri).ok());
        let published = touched.iter().filter(|item| item.announced.is_some()).map(|item| key(&*item.announcement));
        let published: HashSet<_> =
            published.filter(|(_, side)| *side == discriminant(&Direction::Publishes)).collect();
        let ports = published.iter().filter_map(|(topic, _)| port_of(own.as_ref()?, topic)).collect();
        touched.iter().for_each(|item| item.announcement.withdraw());
        end_listeners(ports);
        let others = touched.into_iter().map(|item| item.announcement);
        self.add(others.filter(|other| !gone.iter().any(|one| Arc::ptr_eq(one, other))));
    }

    /// The first that is not announced yet.
    fn next_pending(&self) -> Option<Arc<dyn Announcement>> {
        self.items.lock().iter().find(|item| item.announced.is_none()).map(|item| Arc::clone(&item.announcement))
    }

    fn mark_announced(&self, done: &Arc<dyn Announcement>) {
        let number = self.announcements.fetch_add(1, Ordering::Relaxed);
        let mut items = self.items.lock();
        if let Some(item) = items.iter_mut().find(|item| Arc::ptr_eq(&item.announcement, done)) {
            item.announced = Some(number);
        }
    }

    /// What is announced, each with the number of its announcement.
    fn registrations(&self) -> Vec<(u64, Registration)> {
        let items = self.items.lock();
        items.iter().filter_map(|item| Some((item.announced?, item.announcement.registration()))).collect()
    }
}

/// What the link's thread knows.
struct Worker<'a> {
    link: &'a Link,
    node: Option<Ros>,
    embedded: Option<EmbeddedMaster>,
    /// The master did not answer when last asked.
    lost: bool,
    /// The master has forgotten us and has not been told everything again.
    forgotten: bool,
    /// A line about the absence of a master has been written.
    complained: bool,
}

/// Keeps the link up until it is stopped, then withdraws everything.
pub fn run(link: &Link) {
    let mut worker = Worker { link, node: None, embedded: None, lost: false, forgotten: false, complained: false };
    loop {
        worker.step();
        if link.stop.is_stopped() || worker.dismissed() || link.stop.wait(POLL) {
            break;
        }
    }
    let dismissed = worker.dismissed();
    link.dismissed.store(dismissed, Ordering::Release);
    worker.withdraw();
    if dismissed {
        link.report(format_args!("ROS: the node was told to shut down"));
        // The embedded master is not ours alone: it serves others until the program ends.
        while !link.stop.wait(Duration::from_secs(3600)) {}
    }
}

impl Worker<'_> {
    /// Somebody called the node's `shutdown` (`rosnode kill`).
    fn dismissed(&self) -> bool {
        self.node.as_ref().is_some_and(|node| !node.is_ok())
    }

    fn step(&mut self) {
        if self.node.is_none() {
            self.connect();
        }
        if self.node.is_some() {
            self.watch();
        }
        if !self.lost {
            self.announce_pending();
        }
    }

    /// Makes the node as soon as there is a master; starts a master once if there is none and it may be here.
    fn connect(&mut self) {
        let master = &self.link.options.master;
        if let Err(error) = master.call("getPid", vec![]) {
            if self.complained || self.embedded.is_some() {
                return;
            }
            if !self.start_master(&error) {
                self.link.report(format_args!("ROS: {error}; going on without it and asking again every second"));
                self.complained = true;
                return;
            }
        }
        match Ros::new(&self.link.options.name.to_use()) {
            Ok(node) => {
                self.link.sockets.sweep();
                self.link.report(format_args!("ROS: node {} at the master {}", node.name(), master.uri()));
                if own_peer(node.uri()).and_then(|own| own.addresses()).is_err() {
                    self.link.report(format_args!(
                        "ROS: this machine is called \"{}\", which has no address: other nodes cannot connect; set ROS_HOSTNAME or ROS_IP",
                        node.hostname()
                    ));
                }
                *self.link.node.lock() = Some((node.name().to_owned(), node.uri().to_owned()));
                self.set_parameters(node.name());
                self.node = Some(node);
                self.complained = false;
            }
            Err(error) if !self.complained => {
                self.link.report(format_args!(
                    "ROS: no node could be made: {}; asking again every second",
                    full_text(&error)
                ));
                self.complained = true;
            }
            Err(_) => (),
        }
    }

    fn set_parameters(&self, node: &str) {
        for (name, value) in &self.link.options.parameters {
            let name = format!("{node}/{name}");
            if let Err(error) = self.link.master().call("setParam", vec![Value::String(name.clone()), value.clone()]) {
                self.link.report(format_args!("ROS: the parameter {name} is not set: {error}"));
            }
        }
    }

    /// True when there is now a master, ours or somebody else's.
    fn start_master(&mut self, why: &CallError) -> bool {
        if !matches!(why, CallError::NoAnswer { .. }) {
            return false;
        }
        let Some(address) = local_address(&self.link.options.master) else { return false };
        let (link, uri) = (self.link, self.link.options.master.uri());
        match &self.link.options.own_master {
            OwnMaster::None => false,
            OwnMaster::InProcess => {
                match EmbeddedMaster::start(address, Arc::clone(&link.options.report)) {
                    Ok(embedded) => self.embedded = Some(embedded),
                    // Perhaps another program has just started one.
                    Err(_) => return link.options.master.call("getPid", vec![]).is_ok(),
                }
                if link.await_master() {
                    link.report(format_args!("ROS: no master at {uri}: started one in this program, on {address}"));
                    return true;
                }
                self.embedded = None;
                false
            }
            OwnMaster::Program(program) => match start_master(program, address) {
                Ok(process) if link.await_master() => {
                    link.report(format_args!(
                        "ROS: no master at {uri}: started one on {address} (process {process}); it ends {} s after the last node has gone",
                        UNUSED.as_secs()
                    ));
                    true
                }
                Ok(_) => false,
                Err(error) => {
                    link.report(format_args!("ROS: {} cannot be started to be a master: {error}", program.display()));
                    false
                }
            },
        }
    }

    /// Asks the master whether it knows us, and registers everything again if it does not.
    fn watch(&mut self) {
        let Some(node) = &self.node else { return };
        let master = self.link.master();
        match master.call("lookupNode", vec![Value::String(node.name().to_owned())]) {
            Ok(_) => (),
            Err(error) if error.is_refusal() => self.forgotten = true,
            Err(error) => {
                if !self.lost {
                    self.link.report(format_args!(
                        "ROS: lost the master: {error}; going on and waiting for it to come back"
                    ));
                }
                self.lost = true;
                return;
            }
        }
        if self.forgotten {
            let _change = self.link.changing.lock();
            match register_again(&self.link.registrations(), node, &master) {
                Ok(()) => {
                    self.link.report(format_args!(
                        "ROS: the master {} did not know us; everything is registered again",
                        master.uri()
                    ));
                    (self.forgotten, self.lost) = (false, false);
                    self.link.generation.fetch_add(1, Ordering::AcqRel);
                }
                Err(error) => {
                    if !self.lost {
                        self.link.report(format_args!("ROS: registering again did not succeed: {error}; trying again"));
                    }
                    self.lost = true;
                }
            }
        } else if std::mem::take(&mut self.lost) {
            self.link.report(format_args!("ROS: the master {} is back", master.uri()));
        }
    }

    fn announce_pending(&mut self) {
        let Some(node) = &self.node else { return };
        loop {
            // Nothing may be removed half announced.
            let _change = self.link.changing.lock();
            let Some(announcement) = self.link.next_pending() else { break };
            if self.link.stop.is_stopped() {
                return;
            }
            match announcement.announce(node) {
                Ok(()) => self.link.sockets.sweep(),
                Err(error) => {
                    let Registration { topic, .. } = announcement.registration();
                    if !is_permanent(&error) {
                        if !self.complained {
                            self.link.report(format_args!("ROS: {topic}: {}; trying again", full_text(&error)));
                            self.complained = true;
                        }
                        return;
                    }
                    self.link.report(format_args!("ROS: {topic} is left out: {}", full_text(&error)));
                }
            }
            self.link.mark_announced(&announcement);
            if announcement.connects() {
                // Who publishes already is connected to at once.
                self.link.stop.nudge();
            }
        }
        self.complained = false;
        let _ = self.link.generation.compare_exchange(0, 1, Ordering::AcqRel, Ordering::Relaxed);
    }

    fn withdraw(&mut self) {
        let _change = self.link.changing.lock();
        let items = std::mem::take(&mut *self.link.items.lock());
        let Some(node) = self.node.take() else { return };
        items.iter().filter(|item| item.announced.is_some()).for_each(|item| item.announcement.withdraw());
        // Withdraws the log topic.
        node.shutdown_sender().shutdown();
        // Only a call from outside ends the node's server thread.
        if let Ok(own) = own_peer(node.uri()) {
            let _ = own.call("shutdown", vec![Value::String("end of the program".into())]);
        }
        drop(node);
        end_listeners(self.link.sockets.ports());
    }
}

/// Lets the threads end that wait for the next subscriber of a withdrawn topic at `ports`: they do so with the next
/// connection.
fn end_listeners(ports: Vec<u16>) {
    for port in ports {
        let address = (std::net::Ipv4Addr::LOCALHOST, port).into();
        let _ = std::net::TcpStream::connect_timeout(&address, Duration::from_millis(50));
    }
}

/// Our own node at `uri`, called as the master does it.
fn own_peer(uri: &str) -> Result<Peer, CallError> {
    Peer::new(uri, "/master", Duration::from_millis(500))
}

/// Connects to publishers until the link is stopped.
pub fn tend_connections(link: &Link) {
    let mut listing = Listing::default();
    while !link.stop.wait(CONNECT_POLL) {
        let listening: Vec<_> = link
            .items
            .lock()
            .iter()
            .filter(|item| item.announced.is_some() && item.announcement.connects())
            .map(|item| Arc::clone(&item.announcement))
            .collect();
        if listening.is_empty() {
            continue;
        }
        let publishers = listing.refresh(&link.master());
        listening.iter().for_each(|item| item.connect(publishers, &link.options.report));
    }
}

/// Tends the sockets of the node until the link is stopped.
pub fn tend_sockets(link: &Link) {
    let mut bounded: HashSet<u64> = HashSet::new();
    while !link.stop.wait(POLL) {
        link.sockets.sweep();
        let uri = link.node.lock().as_ref().map(|(_, uri)| uri.clone());
        let Some(Ok(own)) = uri.as_deref().map(own_peer) else { continue };
        let mut ports = HashSet::new();
        for (number, Registration { topic, direction, .. }) in link.registrations() {
            if direction == Direction::Publishes && !bounded.contains(&number) && !link.stop.is_stopped() {
                ports.extend(port_of(&own, &topic));
                bounded.insert(number);
            }
        }
        if !ports.is_empty() {
            link.sockets.bound_handshakes(&ports);
        }
    }
}

/// Port on which `node` serves `topic`.
fn port_of(node: &Peer, topic: &str) -> Option<u16> {
    let protocols = Value::Array(vec![Value::Array(vec![Value::String("TCPROS".into())])]);
    match node.call("requestTopic", vec![Value::String(topic.to_owned()), protocols]) {
        Ok(Value::Array(parts)) => match parts.get(2) {
            Some(&Value::Integer(port)) => port.try_into().ok(),
            _ => None,
        },
        _ => None,
    }
}

/// Registers all of `registrations` of `node` with a master that does not know them.
fn register_again(registrations: &[(u64, Registration)], node: &Ros, master: &Peer) -> Result<(), CallError> {
    let text = |s: &str| Value::String(s.to_owned());
    let own = own_peer(node.uri())?;
    for (_, registration) in registrations {
        let arguments = vec![text(&registration.topic), text(&registration.message_type), text(node.uri())];
        match &registration.direction {
            Direction::Serves { uri } => {
                master.call("registerService", vec![text(&registration.topic), text(uri), text(node.uri())])?;
            }
            Direction::Publishes => {
                master.call("registerPublisher", arguments)?;
            }
            Direction::PublishesAs { node, uri } => {
                let arguments = vec![text(&registration.topic), text(&registration.message_type), text(uri)];
                master.called_by(node).call("registerPublisher", arguments)?;
            }
            Direction::Subscribes => {
                let publishers = master.call("registerSubscriber", arguments)?;
                // The node learns about publishers as it would from the master. An empty list would make it forget
                // connections that are still up.
                if matches!(&publishers, Value::Array(list) if !list.is_empty()) {
                    let _ = own.call("publisherUpdate", vec![text(&registration.topic), publishers]);
                }
            }
        }
    }
    master.call("registerPublisher", vec![text(ROSOUT), text("rosgraph_msgs/Log"), text(node.uri())])?;
    Ok(())
}

/// The error and what caused it, in one line.
fn full_text(error: &rosrust::error::Error) -> String {
    error.iter().map(ToString::to_string).collect::<Vec<_>>().join(": ")
}
