//! The participant: what DDS sees of a program, the thread that serves all its nodes, and how it ends.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::Arc;
use std::task::{Wake, Waker};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex};
use rustdds::bytes::Bytes;
use rustdds::dds::CreateError;
use rustdds::qos::policy;
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, QosPolicies, QosPolicyBuilder, RTPSEntity, StatusEvented, TopicKind,
};
use rustix::process::{getrlimit, setrlimit, Resource, Rlimit};

use crate::environment::{Options, Range, Report};
use crate::graph::{self, Graph};
use crate::guard::{Guard, Interfaces, Prefix};
use crate::names::{self, NameError, TypeName};
use crate::node::Node;
use crate::wire::{Raw, RawReader, RawWriter};

/// Shortest time between two messages on `ros_discovery_info`.
const ANNOUNCE_EVERY: Duration = Duration::from_millis(100);

/// How often the thread looks around when nothing wakes it.
const IDLE: Duration = Duration::from_secs(1);

/// After so many new endpoints RustDDS gets time to announce them: it drops announcements when more than a thousand wait.
const BURST: usize = 8;

/// How long that is.
const PAUSE: Duration = Duration::from_millis(1);

/// How long an endpoint is tried again when RustDDS has not yet taken those before it.
const PATIENCE: Duration = Duration::from_secs(2);

/// Open files that programs with hundreds of endpoints need: RustDDS has two a writer and six a reader.
const OPEN_FILES: u64 = 65_536;

/// Why something could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Error when a name is none of ROS 2.
    #[error(transparent)]
    Name(#[from] NameError),
    /// Error when the participant has a node of that name already.
    #[error("there is a node \"{0}\" already")]
    NodeExists(String),
    /// Error when DDS does not work: no network, no free port, no open files left.
    #[error("DDS: {what} could not be made: {why}")]
    Dds {
        /// What could not be made.
        what: String,
        /// What RustDDS says.
        why: CreateError,
    },
    /// Error when no thread can be made.
    #[error("no thread could be made: {0}")]
    Thread(std::io::Error),
}

/// What the thread serves: it is told apart by a number and serves itself when RustDDS has something for it.
pub(crate) trait Source: Send + Sync {
    /// Does what there is to do, and has `waker` woken when there is more. Returns when it wants to be called anyway.
    fn serve(&self, waker: &Waker) -> Option<Instant>;
}

#[derive(Default)]
struct Todo {
    ready: Vec<u64>,
    changed: bool,
    stop: bool,
}

/// How others reach the thread.
#[derive(Default)]
pub(crate) struct Signal {
    todo: Mutex<Todo>,
    condvar: Condvar,
}

impl Signal {
    pub fn ready(&self, source: u64) {
        self.todo.lock().ready.push(source);
        self.condvar.notify_one();
    }

    fn changed(&self) {
        self.todo.lock().changed = true;
        self.condvar.notify_one();
    }

    fn stop(&self) {
        self.todo.lock().stop = true;
        self.condvar.notify_one();
    }
}

struct SourceWaker {
    source: u64,
    signal: Arc<Signal>,
}

impl Wake for SourceWaker {
    fn wake(self: Arc<Self>) {
        self.signal.ready(self.source);
    }
}

/// What everything of a participant shares.
pub(crate) struct Shared {
    pub options: Options,
    pub dds: DomainParticipant,
    publisher: rustdds::Publisher,
    subscriber: rustdds::Subscriber,
    pub graph: Mutex<Graph>,
    pub signal: Arc<Signal>,
    sources: Mutex<HashMap<u64, Arc<dyn Source>>>,
    next_key: AtomicU64,
    made: AtomicUsize,
    held: AtomicUsize,
}

impl Shared {
    pub fn report(&self) -> &Report {
        &self.options.report
    }

    pub fn new_key(&self) -> u64 {
        self.next_key.fetch_add(1, Ordering::Relaxed)
    }

    /// Has the thread serve `source` from now on, at once for the first time.
    pub fn add_source(&self, key: u64, source: Arc<dyn Source>) {
        self.sources.lock().insert(key, source);
        self.signal.ready(key);
    }

    pub fn remove_source(&self, key: u64) {
        // Dropped outside the lock: it may be the last owner, and RustDDS takes its time to close endpoints.
        let source = self.sources.lock().remove(&key);
        drop(source);
    }

    /// Changes the graph and has it announced.
    pub fn change_graph(&self, change: impl FnOnce(&mut Graph)) {
        change(&mut self.graph.lock());
        self.signal.changed();
    }

    pub fn writer(&self, topic: &str, type_name: &str, qos: &QosPolicies) -> Result<RawWriter, Error> {
        self.endpoint(topic, type_name, qos, |topic| {
            self.publisher.create_datawriter_no_key::<Bytes, Raw>(topic, Some(qos.clone()))
        })
    }

    pub fn reader(&self, topic: &str, type_name: &str, qos: &QosPolicies) -> Result<RawReader, Error> {
        self.endpoint(topic, type_name, qos, |topic| {
            self.subscriber.create_simple_datareader_no_key(topic, Some(qos.clone()))
        })
    }

    fn endpoint<T>(
        &self,
        topic: &str,
        type_name: &str,
        qos: &QosPolicies,
        create: impl Fn(&rustdds::Topic) -> Result<T, CreateError>,
    ) -> Result<T, Error> {
        let error = |why| Error::Dds { what: format!("the endpoint of {topic}"), why };
        let kind = TopicKind::NoKey;
        let made = self.dds.create_topic(topic.into(), type_name.into(), qos, kind).map_err(error)?;
        if self.made.fetch_add(1, Ordering::Relaxed) % BURST == BURST - 1 {
            std::thread::sleep(PAUSE);
        }
        let deadline = Instant::now() + PATIENCE;
        loop {
            match create(&made) {
                // Also when a queue to RustDDS's thread is full.
                Err(CreateError::Poisoned { .. }) if Instant::now() < deadline => std::thread::sleep(5 * PAUSE),
                result => return result.map_err(error),
            }
        }
    }
}

/// A program as DDS sees it: nodes with their topics, services and parameters.
///
/// RustDDS has two threads for it, and one serves all nodes: it calls the call-backs of subscriptions and services, one
/// at a time, and announces nodes. What was made of a participant is of no use after it was dropped.
pub struct Participant {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Participant {
    /// Joins the domain.
    ///
    /// # Errors
    /// [`Error::Dds`], [`Error::Thread`].
    pub fn new(options: Options) -> Result<Self, Error> {
        allow_open_files();
        let error = |what: &str| {
            let what = what.to_owned();
            move |why| Error::Dds { what, why }
        };
        let guard = Guard::new(options.range, Interfaces::of_this_machine(), Arc::clone(&options.report));
        let own = guard.own();
        let dds = builder(&options, guard).build().map_err(error("the participant"))?;
        own.get_or_init(|| prefix(&dds));
        let publisher = dds.create_publisher(&QosPolicies::qos_none()).map_err(error("the publisher"))?;
        let subscriber = dds.create_subscriber(&QosPolicies::qos_none()).map_err(error("the subscriber"))?;
        let shared = Arc::new(Shared {
            options,
            dds,
            publisher,
            subscriber,
            graph: Mutex::default(),
            signal: Arc::default(),
            sources: Mutex::default(),
            next_key: AtomicU64::new(0),
            made: AtomicUsize::new(0),
            held: AtomicUsize::new(0),
        });
        let announcements = shared.writer(graph::TOPIC, graph::TYPE, &announcement_qos())?;
        let served = Arc::clone(&shared);
        let thread = std::thread::Builder::new().name("ros2".into());
        let thread = thread.spawn(move || serve(&served, &announcements)).map_err(Error::Thread)?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// A node. Its `namespace` is `/` or parts that each begin with `/`.
    ///
    /// # Errors
    /// [`Error::Name`] or [`Error::NodeExists`].
    pub fn node(&self, namespace: &str, name: &str) -> Result<Node, Error> {
        names::check_namespace(namespace)?;
        names::check_node(name)?;
        Node::new(&self.shared, namespace, name)
    }

    /// Announces no node until what is returned is dropped: what is made together is announced together. Endpoints are
    /// announced at once.
    pub fn hold_announcements(&self) -> Hold {
        self.shared.held.fetch_add(1, Ordering::SeqCst);
        Hold(Arc::clone(&self.shared))
    }

    /// Calls `call` in the participant's thread, at once and then each time that `period` has passed since, until what is
    /// returned is dropped. It may make and drop nodes and what they have.
    pub fn call_every(&self, period: Duration, call: impl FnMut() + Send + 'static) -> Timer {
        let key = self.shared.new_key();
        self.shared.add_source(key, Arc::new(Periodic { period, call: Mutex::new(Box::new(call)) }));
        Timer { shared: Arc::clone(&self.shared), key }
    }

    /// Topics that other participants publish or subscribe, with their types, as ROS 2 calls them. Sorted.
    pub fn topics(&self) -> Vec<(String, String)> {
        let dds = &self.shared.dds;
        let written = dds.discovered_writers().into_iter().map(|writer| {
            let data = writer.publication_topic_data;
            (data.topic_name, data.type_name)
        });
        let read = dds.discovered_readers().into_iter().map(|reader| {
            let data = reader.subscription_topic_data;
            (data.topic_name().clone(), data.type_name().clone())
        });
        let named = written.chain(read).filter_map(|(topic, type_name)| {
            let topic = topic.strip_prefix("rt").filter(|name| name.starts_with('/'))?;
            Some((topic.to_owned(), ros_type(&type_name)?))
        });
        let mut topics: Vec<_> = named.collect();
        topics.sort();
        topics.dedup();
        topics
    }
}

/// `pkg::msg::dds_::Type_` as `pkg/msg/Type`.
fn ros_type(dds: &str) -> Option<String> {
    let parts: Vec<&str> = dds.split("::").collect();
    let [package, kind, "dds_", name] = parts[..] else { return None };
    TypeName::parse(&format!("{package}/{kind}/{}", name.strip_suffix('_')?)).ok().map(|name| name.to_string())
}

/// Something that is called again and again. Dropping it ends that; a call that is going on still finishes.
pub struct Timer {
    shared: Arc<Shared>,
    key: u64,
}

impl Drop for Timer {
    fn drop(&mut self) {
        self.shared.remove_source(self.key);
    }
}

struct Periodic {
    period: Duration,
    call: Mutex<Box<dyn FnMut() + Send>>,
}

impl Source for Periodic {
    fn serve(&self, _: &Waker) -> Option<Instant> {
        (self.call.lock())();
        Some(Instant::now() + self.period)
    }
}

impl Drop for Participant {
    fn drop(&mut self) {
        self.shared.signal.stop();
        // A call-back may be its last owner.
        let thread = self.thread.take().filter(|thread| thread.thread().id() != std::thread::current().id());
        if let Some(Err(_)) = thread.map(JoinHandle::join) {
            (self.shared.report())(format_args!("ROS 2: the thread that serves nodes had ended with a panic"));
        }
    }
}

/// Keeps nodes from being announced.
pub struct Hold(Arc<Shared>);

impl Drop for Hold {
    fn drop(&mut self) {
        self.0.held.fetch_sub(1, Ordering::SeqCst);
        self.0.signal.changed();
    }
}

/// Only packets that `guard` lets through get to RustDDS.
fn builder(options: &Options, mut guard: Guard) -> DomainParticipantBuilder {
    let builder = DomainParticipantBuilder::new(options.domain)
        .packet_filter(move |packet, from| guard.check(packet, from, Instant::now()).is_ok());
    let this_machine = Ipv4Addr::LOCALHOST;
    match options.range {
        Range::Localhost => builder.with_only_networks([this_machine]).listen_address(this_machine),
        Range::Subnet => builder,
        Range::Off => {
            builder.with_only_networks(Vec::<IpAddr>::new()).same_host_loopback(false).listen_address(this_machine)
        }
    }
}

/// With what the identifiers of all that the participant has begin.
fn prefix(dds: &DomainParticipant) -> Prefix {
    let guid = dds.guid().to_bytes();
    std::array::from_fn(|index| guid[index])
}

fn announcement_qos() -> QosPolicies {
    QosPolicyBuilder::new()
        .reliability(policy::Reliability::Reliable { max_blocking_time: rustdds::Duration::ZERO })
        .durability(policy::Durability::TransientLocal)
        .history(policy::History::KeepLast { depth: 1 })
        .build()
}

/// Raises this process's limit of open files as far as it may; endpoints fail with an error where that is too little.
fn allow_open_files() {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    let wanted = maximum.map_or(OPEN_FILES, |maximum| maximum.min(OPEN_FILES));
    if current.is_some_and(|current| current < wanted) {
        let _ = setrlimit(Resource::Nofile, Rlimit { current: Some(wanted), maximum });
    }
}

/// What the thread does until it is stopped.
fn serve(shared: &Arc<Shared>, announcements: &RawWriter) {
    let mut wakers: HashMap<u64, Waker> = HashMap::new();
    let mut later: HashMap<u64, Instant> = HashMap::new();
    let mut announced = None;
    let statuses = shared.dds.status_listener();
    loop {
        let now = Instant::now();
        let due = later.values().min().copied();
        let next_announcement =
            shared.graph.lock().has_changed().then(|| announced.map_or(now, |at: Instant| at + ANNOUNCE_EVERY));
        let held = shared.held.load(Ordering::SeqCst) > 0;
        let wake_at = [Some(now + IDLE), due, next_announcement.filter(|_| !held)].into_iter().flatten().min();
        let Some(ready) = wait(&shared.signal, wake_at.unwrap_or(now)) else { return };
        let now = Instant::now();
        let due = later.iter().filter(|(_, at)| **at <= now).map(|(key, _)| *key);
        let mut keys: Vec<u64> = ready.into_iter().chain(due).collect();
        keys.sort_unstable();
        keys.dedup();
        for key in keys {
            later.remove(&key);
            let source = shared.sources.lock().get(&key).cloned();
            let Some(source) = source else {
                wakers.remove(&key);
                continue;
            };
            let signal = || Arc::clone(&shared.signal);
            let waker = wakers
                .entry(key)
                .or_insert_with(|| Waker::from(Arc::new(SourceWaker { source: key, signal: signal() })));
            later.extend(source.serve(waker).map(|at| (key, at)));
        }
        if next_announcement.is_some_and(|at| at <= now) && shared.held.load(Ordering::SeqCst) == 0 {
            announced = Some(now);
            let message = shared.graph.lock().message(shared.dds.guid(), shared.options.gids);
            if let Err(error) = announcements.write(Bytes::from(message), None) {
                (shared.report())(format_args!("ROS 2: nodes could not be announced: {error}"));
            }
        }
        // Nobody reads them, and RustDDS keeps 2048.
        while statuses.try_recv_status().is_some() {}
    }
}

/// Waits until there is something to do, at most until `until`; `None`: the thread is to end.
fn wait(signal: &Signal, until: Instant) -> Option<Vec<u64>> {
    let mut todo = signal.todo.lock();
    while todo.ready.is_empty() && !todo.changed && !todo.stop {
        if signal.condvar.wait_until(&mut todo, until).timed_out() {
            break;
        }
    }
    todo.changed = false;
    (!todo.stop).then(|| std::mem::take(&mut todo.ready))
}
