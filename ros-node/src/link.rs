//! The connection to the ROS master: finds it or starts one, announces everything, notices when it goes or forgets us.
//!
//! When the master was restarted, everything is registered again; connections between nodes stay up meanwhile.

use std::io;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use dxr::Value;
use parking_lot::Mutex;

use super::announcement::{Announcement, Direction, Endpoint, Registration, Serves};
use super::calls::text;
use super::graph::Graph;
use super::lasting::{start_master, UNUSED};
use super::log::{LogAggregator, OwnLog, Severity};
use super::master::{local_address, Master};
use super::stop::Stop;
use super::xmlrpc::{CallError, Peer, Session};
use super::Report;

/// How often the master is asked whether it knows us.
const POLL: Duration = Duration::from_secs(1);

/// How long a master may take to start.
const STARTING: Duration = Duration::from_secs(5);

/// Nodes that this process has made.
static NODES: AtomicU64 = AtomicU64::new(0);

impl NodeName {
    /// The full name, in the namespace that `ROS_NAMESPACE` says.
    fn full(&self) -> String {
        if let Self::Full(name) = self {
            return name.clone();
        }
        let namespace = std::env::var("ROS_NAMESPACE").unwrap_or_default();
        let name = self.unique();
        match namespace.trim_matches('/') {
            "" => format!("/{name}"),
            namespace => format!("/{namespace}/{name}"),
        }
    }

    fn unique(&self) -> String {
        let base = match self {
            Self::Exact(name) | Self::Full(name) => return name.clone(),
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
    state: State,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    /// The node serves it; it is not registered at the master.
    Served,
    /// It is registered at the master.
    Announced,
    /// It cannot be served.
    LeftOut,
}

/// What is done when there is no master and its address is one of this machine.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum OwnMaster {
    /// It is waited for.
    #[default]
    None,
    /// Another node of this program starts one, or nobody does: only after so long is it said that there is none.
    Expected(Duration),
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
    /// As it is, with its namespace.
    Full(String),
}

/// How a link is to be.
#[derive(Clone)]
pub struct LinkOptions {
    /// The master.
    pub master: Peer,
    /// Name of the node, without the namespace, which `ROS_NAMESPACE` says.
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
    graph: Arc<Graph>,
    log: Arc<OwnLog>,
    items: Mutex<Vec<Item>>,
    /// Held while something is announced or withdrawn, which can take long.
    changing: Mutex<()>,
    generation: AtomicU64,
    /// Ends everything.
    pub stop: Stop,
}

impl Link {
    /// A link that nobody tends yet; [`Node::start`](super::Node::start) makes one with the threads that do.
    ///
    /// # Errors
    /// When there are no sockets or no thread to be had.
    pub fn new(options: LinkOptions) -> io::Result<Self> {
        let name = options.name.full();
        let log = Arc::new(OwnLog::new(&name));
        let own_log = log.announcement();
        let user = Arc::clone(&options.report);
        let own = Arc::clone(&log);
        let report: Report = Arc::new(move |line| {
            user(line);
            own.line(Severity::Info, SystemTime::now(), &line.to_string());
        });
        let graph = Graph::start(name, &options.master, report)?;
        let link = Self {
            options,
            graph,
            log,
            items: Mutex::default(),
            changing: Mutex::default(),
            generation: AtomicU64::new(0),
            stop: Stop::default(),
        };
        link.add([own_log]);
        Ok(link)
    }

    pub(crate) fn graph(&self) -> &Arc<Graph> {
        &self.graph
    }

    /// Full name of the node.
    pub fn name(&self) -> &str {
        &self.graph.name
    }

    /// Whether somebody listens to the log messages of the node: in general the node `/rosout`.
    pub fn is_log_heard(&self) -> bool {
        self.log.is_heard()
    }

    /// Publishes a log message of the node, of what was said at `at`. Without anybody who listens it is lost. Lines of
    /// the node itself are published anyway.
    pub fn log(&self, severity: Severity, at: SystemTime, text: &str) {
        self.log.line(severity, at, text);
    }

    /// How many times everything was registered with a master that did not know us; 0 before the first time.
    pub fn generation(&self) -> u64 {
        self.generation.load(Ordering::Acquire)
    }

    /// The master, called in the node's name.
    pub fn master(&self) -> Peer {
        self.graph.master()
    }

    /// Whether somebody told the node to shut down (`rosnode kill`).
    pub fn is_dismissed(&self) -> bool {
        self.graph.is_dismissed()
    }

    pub(crate) fn report(&self, line: std::fmt::Arguments<'_>) {
        (self.graph.report)(line);
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

    /// Serves more at once, and announces it soon.
    pub fn add(&self, announcements: impl IntoIterator<Item = Arc<dyn Announcement>>) {
        let serve = |announcement: Arc<dyn Announcement>| {
            let topic = announcement.registration().topic;
            let served = if is_graph_name(&topic) {
                self.graph.open(&announcement.endpoint())
            } else {
                Err("this is no name of a topic or service: expected /NAME/NAME, of letters, digits and underscores"
                    .into())
            };
            let state = match served {
                Ok(other) => {
                    if let Some(other) = other {
                        announcement.share(other);
                    }
                    State::Served
                }
                Err(error) => {
                    self.report(format_args!("ROS: {topic} is left out: {error}"));
                    State::LeftOut
                }
            };
            Item { announcement, state }
        };
        let items: Vec<Item> = announcements.into_iter().map(serve).collect();
        self.items.lock().extend(items);
        self.stop.nudge();
    }

    /// Withdraws `gone`; blocks while the master thinks.
    pub fn remove(&self, gone: &[Arc<dyn Announcement>]) {
        if gone.is_empty() {
            return;
        }
        let _change = self.changing.lock();
        let is_gone = |item: &mut Item| gone.iter().any(|one| Arc::ptr_eq(one, &item.announcement));
        let items: Vec<Item> = self.items.lock().extract_if(.., is_gone).collect();
        self.withdraw(&items);
    }

    /// Serves `items` no longer and tells the master of those it knows.
    fn withdraw(&self, items: &[Item]) {
        let mut session = Session::new(self.master());
        for Item { announcement, state } in items {
            // Nobody else of this node may need the registration.
            let is_last = *state != State::LeftOut && self.graph.close(&announcement.endpoint());
            if !is_last || *state != State::Announced {
                continue;
            }
            let Registration { topic, direction, .. } = announcement.registration();
            let (method, own) = match direction {
                Direction::Publishes => ("unregisterPublisher", text(&self.graph.uri)),
                Direction::Subscribes => ("unregisterSubscriber", text(&self.graph.uri)),
                Direction::Serves => ("unregisterService", text(&self.graph.service_uri())),
            };
            // A master that is away has nothing to forget.
            if let Err(CallError::NoAnswer { .. }) = session.call(method, vec![text(&topic), own]) {
                session.give_up();
            }
        }
    }

    /// Whether `announcement` has neither been withdrawn nor announced meanwhile.
    fn is_served(&self, announcement: &Arc<dyn Announcement>) -> bool {
        let items = self.items.lock();
        items.iter().any(|item| Arc::ptr_eq(&item.announcement, announcement) && item.state == State::Served)
    }

    /// What is served and not announced yet, services last: who has waited for a service finds the topics.
    fn pending(&self) -> Vec<Arc<dyn Announcement>> {
        let served = |item: &&Item| item.state == State::Served;
        let announcement = |item: &Item| Arc::clone(&item.announcement);
        let mut pending: Vec<_> = self.items.lock().iter().filter(served).map(announcement).collect();
        pending.sort_by_key(|announcement| announcement.registration().direction == Direction::Serves);
        pending
    }

    fn mark_announced(&self, done: &Arc<dyn Announcement>) {
        if let Some(item) = self.items.lock().iter_mut().find(|item| Arc::ptr_eq(&item.announcement, done)) {
            item.state = State::Announced;
        }
    }

    /// Tells the master of `announcement`.
    fn register(&self, announcement: &dyn Announcement, session: &mut Session) -> Result<(), CallError> {
        let Registration { topic, message_type, direction } = announcement.registration();
        let (topic, kind, own) = (text(&topic), text(&message_type), text(&self.graph.uri));
        match direction {
            Direction::Publishes => session.call("registerPublisher", vec![topic, kind, own])?,
            Direction::Subscribes => session.call("registerSubscriber", vec![topic, kind, own])?,
            Direction::Serves => session.call("registerService", vec![topic, text(&self.graph.service_uri()), own])?,
        };
        if let Endpoint(Serves::Topic(topic)) = announcement.endpoint() {
            topic.set_announced();
        }
        Ok(())
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.graph.stop();
    }
}

/// Whether `name` is a full name as ROS has them.
fn is_graph_name(name: &str) -> bool {
    let is_part = |part: &str| !part.is_empty() && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    name.strip_prefix('/').is_some_and(|rest| rest.split('/').all(is_part))
}

/// What the link's thread knows.
struct Worker<'a> {
    link: &'a Link,
    /// The master has been reached once.
    is_known: bool,
    embedded: Option<(Master, Option<LogAggregator>)>,
    /// The master did not answer when last asked.
    lost: bool,
    /// The master has forgotten us and not everything is registered again.
    forgotten: bool,
    /// A line about the absence of a master has been written.
    complained: bool,
    /// When it began.
    since: Instant,
}

/// Keeps the link up until it is stopped, then withdraws everything.
pub(crate) fn run(link: &Link) {
    let mut worker = Worker {
        link,
        is_known: false,
        embedded: None,
        lost: false,
        forgotten: false,
        complained: false,
        since: Instant::now(),
    };
    let mut seen = 0;
    loop {
        worker.step();
        // What is added while the last step runs is seen at once.
        if link.stop.is_stopped() || link.is_dismissed() || link.stop.wait_for_news(&mut seen, POLL) {
            break;
        }
    }
    let dismissed = link.is_dismissed();
    worker.withdraw();
    if dismissed {
        link.report(format_args!("ROS: the node was told to shut down"));
        // The embedded master is not ours alone: it serves others until the program ends.
        while !link.stop.wait(Duration::from_secs(3600)) {}
    }
}

impl Worker<'_> {
    fn step(&mut self) {
        if !self.is_known {
            self.connect();
        }
        if self.is_known {
            self.watch();
            if !self.lost {
                self.announce_pending();
            }
        }
    }

    /// Looks for the master; starts one once if there is none and it may be here.
    fn connect(&mut self) {
        let link = self.link;
        let master = link.master();
        if let Err(error) = master.call("getPid", vec![]) {
            if self.complained || self.embedded.is_some() || self.expects_master() {
                return;
            }
            if !self.start_master(&error) {
                link.report(format_args!("ROS: {error}; going on without it and asking again every second"));
                self.complained = true;
                return;
            }
        }
        link.report(format_args!("ROS: node {} at the master {}", link.name(), master.uri()));
        match Peer::new(&link.graph.uri, link.name(), POLL).and_then(|own| own.addresses()) {
            Err(_) => link.report(format_args!(
                "ROS: this machine's name in {} has no address: other nodes cannot connect; set ROS_HOSTNAME or ROS_IP",
                link.graph.uri
            )),
            Ok(_) if link.graph.is_local => (),
            Ok(_) => link.report(format_args!("ROS: programs of other machines can connect, to {}", link.graph.uri)),
        }
        self.set_parameters();
        (self.is_known, self.complained) = (true, false);
    }

    /// Whether there is still time in which another node may start a master.
    fn expects_master(&self) -> bool {
        matches!(self.link.options.own_master, OwnMaster::Expected(within) if self.since.elapsed() < within)
    }

    fn set_parameters(&self) {
        for (name, value) in &self.link.options.parameters {
            let name = format!("{}/{name}", self.link.name());
            if let Err(error) = self.link.master().call("setParam", vec![text(&name), value.clone()]) {
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
            OwnMaster::None | OwnMaster::Expected(_) => false,
            OwnMaster::InProcess => {
                match Master::start(address) {
                    // Without a thread for the logs of all there are still those of each.
                    Ok(master) => self.embedded = Some((master, LogAggregator::start(&link.options.master).ok())),
                    // Perhaps another program has just started one.
                    Err(_) => return link.options.master.call("getPid", vec![]).is_ok(),
                }
                link.report(format_args!("ROS: no master at {uri}: started one in this program, on {address}"));
                true
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
        let link = self.link;
        let has_announced = link.items.lock().iter().any(|item| item.state == State::Announced);
        if !has_announced && !self.lost {
            // It knows a node by its registrations.
            return;
        }
        let master = link.master();
        match master.call("lookupNode", vec![text(link.name())]) {
            Ok(_) => (),
            Err(error) if error.is_refusal() => self.forgotten = has_announced,
            Err(error) => {
                if !self.lost {
                    link.report(format_args!(
                        "ROS: lost the master: {error}; going on and waiting for it to come back"
                    ));
                }
                self.lost = true;
                return;
            }
        }
        if self.forgotten {
            match self.register_again() {
                Ok(()) => {
                    link.report(format_args!(
                        "ROS: the master {} did not know us; everything is registered again",
                        master.uri()
                    ));
                    (self.forgotten, self.lost) = (false, false);
                    link.generation.fetch_add(1, Ordering::AcqRel);
                    link.graph.changed.nudge();
                }
                Err(error) => {
                    if !self.lost {
                        link.report(format_args!("ROS: registering again did not succeed: {error}; trying again"));
                    }
                    self.lost = true;
                }
            }
        } else if std::mem::take(&mut self.lost) {
            link.report(format_args!("ROS: the master {} is back", master.uri()));
        }
    }

    /// Tells a master everything that does not know us.
    fn register_again(&self) -> Result<(), CallError> {
        let link = self.link;
        let _change = link.changing.lock();
        let announced: Vec<_> = {
            let items = link.items.lock();
            let announced = items.iter().filter(|item| item.state == State::Announced);
            announced.map(|item| Arc::clone(&item.announcement)).collect()
        };
        let mut session = Session::new(link.master());
        announced.iter().try_for_each(|announcement| link.register(&**announcement, &mut session))?;
        self.set_parameters();
        Ok(())
    }

    fn announce_pending(&mut self) {
        let link = self.link;
        let mut session = Session::new(link.master());
        loop {
            // Nothing may be removed half announced; others have a turn between two announcements.
            let pending = link.pending();
            if pending.is_empty() {
                break;
            }
            for announcement in pending {
                let _change = link.changing.lock();
                if link.stop.is_stopped() {
                    return;
                }
                if !link.is_served(&announcement) {
                    continue;
                }
                match link.register(&*announcement, &mut session) {
                    Ok(()) => link.mark_announced(&announcement),
                    Err(error) => {
                        if !std::mem::replace(&mut self.complained, true) {
                            let topic = announcement.registration().topic;
                            link.report(format_args!("ROS: {topic}: {error}; trying again"));
                        }
                        return;
                    }
                }
            }
            // Who publishes already is connected to at once.
            link.graph.changed.nudge();
        }
        self.complained = false;
        let _ = link.generation.compare_exchange(0, 1, Ordering::AcqRel, Ordering::Relaxed);
    }

    fn withdraw(&mut self) {
        let _change = self.link.changing.lock();
        let items = std::mem::take(&mut *self.link.items.lock());
        self.link.withdraw(&items);
        self.link.graph.stop();
    }
}
