//! Listening to topics.
//!
//! Each publisher that the master lists is connected to until it answers, also after it was restarted. Finding it takes
//! calls that may take long, so that each publishing node is called in a thread of its own ([`tend`]); messages are then
//! received in the node's thread and handed over there. A publisher is believed neither a length nor a type, and one
//! that does what publishers don't do is named once.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::io::{self, ErrorKind, Write};
use std::net::{IpAddr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsRawFd, RawFd};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant};

use dxr::Value;
use parking_lot::Mutex;
use rosrust::Message;

use super::address::resolve;
use super::announcement::{Announcement, Direction, Endpoint, Registration, Serves};
use super::calls::text;
use super::connections::{Buffer, Came};
use super::graph::Graph;
use super::reactor::{Handler, Turn};
use super::tcpros::{fields, header_of, quote};
use super::topic::{set_options, Kind};
use super::xmlrpc::{CallError, Peer};
use super::Report;

/// How long a publisher may take for each step of connecting.
const TIMEOUT: Duration = Duration::from_secs(1);

/// How long a publisher may take to answer our header.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);

/// Longest header that is read, bytes: the definition of a message is in it.
const MAX_HEADER: usize = 1 << 20;

/// Longest message of any type, bytes.
const LONGEST: usize = 16 << 20;

/// Messages that may be longer than this are received in the thread of large messages, bytes.
const LARGE: usize = 1 << 20;

/// Bytes of one publisher that are handled before the others have a turn.
const TURN: usize = 256 << 10;

/// How long a publisher that was connected to in vain is left alone the first time; doubled each time.
const BACK_OFF: Duration = Duration::from_millis(200);

/// Longest such pause for one that is not there: a program that was killed stays on the master's list, and comes back
/// under the same name.
const MAX_ABSENT_PAUSE: Duration = Duration::from_secs(3);

/// All publishers of a topic that are not there are connected to so often together, when there are many: programs that
/// were killed stay on the master's list for good, each under a name of its own if it was made unique.
const PER_ABSENT: Duration = Duration::from_millis(100);

/// After so many attempts in vain a publisher counts as not there.
const ABSENT_ATTEMPTS: u32 = 5;

/// Longest such pause for one that violates the protocol: it may log each attempt.
const MAX_FAULTY_PAUSE: Duration = Duration::from_secs(30);

/// A publisher that there is no way to is named after so many attempts in a row, some seconds: it may be gone by then.
const ATTEMPTS: u32 = 6;

/// The master is asked again after this time although it has not said that anything changed: what it says may get lost.
const DOUBT: Duration = Duration::from_secs(2);

/// Changes that come within this time are looked at together.
const TOGETHER: Duration = Duration::from_millis(5);

/// Publishing nodes that are called at the same time.
const MAX_CALLS: usize = 32;

/// Names of the nodes that publish each topic.
type Publishers = BTreeMap<String, BTreeSet<String>>;

/// A message as it came.
#[derive(Debug, Clone, Copy)]
pub struct RawReceived<'a> {
    /// Its type, `package/Type`, as its publisher says.
    pub kind: &'a str,
    /// Its fields.
    pub body: &'a [u8],
}

type Callback = dyn Fn(RawReceived<'_>) + Send + Sync;

/// Messages that are wanted.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Wanted {
    /// Type and checksum may be `*` for any.
    kind: Kind,
    /// Longest message, bytes.
    longest: usize,
}

/// A topic to listen to. A publisher that does not do as publishers do is named once.
pub struct RawSubscription(Arc<Subscription>);

/// What the threads need of a subscription.
pub(crate) struct Subscription {
    pub topic: String,
    wanted: Wanted,
    on_message: Box<Callback>,
    /// By name of the publishing node.
    lines: Mutex<BTreeMap<String, Line>>,
    closed: AtomicBool,
}

/// A publisher that the master lists.
#[derive(Default)]
struct Line {
    /// It is being called, or connected.
    busy: bool,
    /// The connection, to be ended from outside.
    stream: Option<Arc<TcpStream>>,
    /// Attempts since the last message.
    attempts: u32,
    /// Not before then again.
    not_before: Option<Instant>,
    /// How often it did what publishers don't do.
    faults: u32,
    /// How often in a row there was no way to it.
    unreached: u32,
}

/// Error when a publisher is not listened to, or not any more.
enum Trouble {
    /// It is not there, or goes: programs come and go, which is nothing to talk about.
    Gone,
    /// There is no way to it: worth a word if it stays like that.
    OutOfReach(String),
    /// It does what publishers don't do: worth a word.
    Fault(String),
}

impl RawSubscription {
    /// Messages of any type, of 16 MiB at most. `on_message` runs in a thread of the node, in one at a time, and must
    /// not block.
    pub fn new(topic: String, on_message: impl Fn(RawReceived<'_>) + Send + Sync + 'static) -> Arc<Self> {
        let any = Kind { name: "*".into(), md5sum: "*".into(), definition: String::new() };
        Self::with(topic, Wanted { kind: any, longest: LONGEST }, on_message)
    }

    /// Messages that claim to be an `M`, of `longest` bytes at most; other publishers are not listened to. `on_message`
    /// runs in a thread of the node, in one at a time, and must not block.
    pub fn of<M: Message>(
        topic: String,
        longest: usize,
        on_message: impl Fn(RawReceived<'_>) + Send + Sync + 'static,
    ) -> Arc<Self> {
        Self::with(topic, Wanted { kind: Kind::of::<M>(), longest }, on_message)
    }

    fn with(topic: String, wanted: Wanted, on_message: impl Fn(RawReceived<'_>) + Send + Sync + 'static) -> Arc<Self> {
        let (on_message, closed) = (Box::new(on_message), AtomicBool::new(true));
        Arc::new(Self(Arc::new(Subscription { topic, wanted, on_message, lines: Mutex::default(), closed })))
    }
}

impl Announcement for RawSubscription {
    fn registration(&self) -> Registration {
        let Subscription { topic, wanted, .. } = &*self.0;
        Registration { topic: topic.clone(), message_type: wanted.kind.name.clone(), direction: Direction::Subscribes }
    }

    fn endpoint(&self) -> Endpoint {
        Endpoint(Serves::Subscription(Arc::clone(&self.0)))
    }
}

impl Subscription {
    /// Connects to publishers from now on.
    pub fn open(&self) {
        self.closed.store(false, Ordering::Release);
    }

    /// Ends all connections and makes no more.
    pub fn close(&self) {
        self.closed.store(true, Ordering::Release);
        for stream in self.lines.lock().values().filter_map(|line| line.stream.as_ref()) {
            let _ = stream.shutdown(Shutdown::Both);
        }
    }

    /// Names of the nodes whose messages are received.
    pub fn publisher_names(&self) -> Vec<String> {
        let lines = self.lines.lock();
        lines.iter().filter(|(_, line)| line.stream.is_some()).map(|(name, _)| name.clone()).collect()
    }

    /// `package/Type`, or `*` for any.
    pub fn kind(&self) -> &str {
        &self.wanted.kind.name
    }

    fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }

    fn with_line<T>(&self, publisher: &str, change: impl FnOnce(&mut Line) -> T) -> Option<T> {
        self.lines.lock().get_mut(publisher).map(change)
    }

    /// Of the publishers `listed`, those to connect to now, which are busy from now on; and when there is something to
    /// do next, should nothing change.
    fn choose(&self, listed: Option<&BTreeSet<String>>, now: Instant) -> (Vec<String>, Option<Instant>) {
        let mut lines = self.lines.lock();
        lines.retain(|publisher, line| line.busy || listed.is_some_and(|listed| listed.contains(publisher)));
        let absent = lines.values().filter(|line| line.is_absent()).count();
        let longest = MAX_ABSENT_PAUSE.max(PER_ABSENT * u32::try_from(absent).unwrap_or(u32::MAX));
        let (mut chosen, mut next) = (Vec::new(), None::<Instant>);
        for publisher in listed.into_iter().flatten() {
            let line = lines.entry(publisher.clone()).or_default();
            match line.not_before {
                _ if line.busy => (),
                Some(then) if now + line.slack() < then => next = Some(next.map_or(then, |next| next.min(then))),
                _ => {
                    // The next attempt, should this one fail.
                    let then = line.begin(now, longest);
                    next = Some(next.map_or(then, |next| next.min(then)));
                    chosen.push(publisher.clone());
                }
            }
        }
        (chosen, next)
    }

    /// What becomes of a line that has failed; a word about it if it is worth one.
    fn fail(&self, publisher: &str, trouble: &Trouble, report: &Report) {
        let (topic, name) = (&self.topic, quote(publisher));
        match trouble {
            Trouble::Fault(what) if self.with_line(publisher, |line| line.fault(Instant::now())) == Some(true) => {
                report(format_args!("ROS: {topic}: {name} is not listened to: {what}"));
            }
            Trouble::OutOfReach(what) if self.with_line(publisher, Line::miss) == Some(true) => {
                let what = quote(what);
                report(format_args!("ROS: {topic}: {name} cannot be reached: {what}; trying again and again"));
            }
            Trouble::Gone => {
                self.with_line(publisher, |line| line.unreached = 0);
            }
            Trouble::Fault(_) | Trouble::OutOfReach(_) => (),
        }
    }
}

impl Line {
    /// Another attempt; returns the time of the next one, should it fail, after `longest` at most.
    fn begin(&mut self, now: Instant, longest: Duration) -> Instant {
        self.busy = true;
        let then = now + pause(self.attempts, longest);
        self.not_before = Some(then);
        self.attempts = self.attempts.saturating_add(1);
        then
    }

    /// Whether it has not been there for some time.
    fn is_absent(&self) -> bool {
        self.stream.is_none() && self.attempts >= ABSENT_ATTEMPTS
    }

    /// An attempt may be so early, so that those of many that are not there fall together: before each round of attempts
    /// the master is asked for all that it knows.
    fn slack(&self) -> Duration {
        if self.is_absent() {
            PER_ABSENT
        } else {
            Duration::ZERO
        }
    }

    /// It did what publishers don't do; true for the first time.
    fn fault(&mut self, now: Instant) -> bool {
        self.not_before = Some(now + pause(self.faults, MAX_FAULTY_PAUSE));
        self.faults = self.faults.saturating_add(1);
        self.faults == 1
    }

    /// There was no way to it; true when that has lasted long enough to be worth a word.
    fn miss(&mut self) -> bool {
        self.unreached = self.unreached.saturating_add(1);
        self.unreached == ATTEMPTS
    }
}

/// How long to wait after so many attempts in vain before the last one.
fn pause(attempts: u32, longest: Duration) -> Duration {
    (BACK_OFF * 2u32.pow(attempts.min(10))).min(longest)
}

/// A line that is busy. However it ends, the publisher is connected to again as long as the master lists it.
struct Busy {
    graph: Arc<Graph>,
    subscription: Arc<Subscription>,
    publisher: String,
}

impl Drop for Busy {
    fn drop(&mut self) {
        let end = |line: &mut Line| {
            line.busy = false;
            line.stream.take().is_some()
        };
        // When one fails that was not connected, what is next is settled already.
        if self.subscription.with_line(&self.publisher, end) == Some(true) {
            self.graph.changed.nudge();
        }
    }
}

/// Connects to publishers until the node stops: when the master says that they changed, when a connection has ended,
/// and every now and then.
pub(crate) fn tend(graph: &Arc<Graph>) {
    let mut listing = Listing::default();
    let called = Arc::<Mutex<HashSet<String>>>::default();
    let (mut next, mut seen) = (None::<Instant>, 0);
    loop {
        let doubt = Instant::now() + DOUBT;
        let until = next.map_or(doubt, |next| next.min(doubt));
        let wait = until.saturating_duration_since(Instant::now());
        if graph.changed.wait_for_news(&mut seen, wait) || graph.changed.wait_still(TOGETHER) {
            return;
        }
        next = None;
        let subscriptions = graph.subscriptions();
        if subscriptions.is_empty() {
            continue;
        }
        let topics = subscriptions.iter().map(|subscription| subscription.topic.clone()).collect();
        let publishers = listing.refresh(&graph.master(), topics);
        let mut work = BTreeMap::<String, Vec<Busy>>::new();
        let now = Instant::now();
        for subscription in &subscriptions {
            let (chosen, later) = subscription.choose(publishers.get(&subscription.topic), now);
            next = [next, later].into_iter().flatten().min();
            for publisher in chosen {
                let (graph, subscription) = (Arc::clone(graph), Arc::clone(subscription));
                work.entry(publisher.clone()).or_default().push(Busy { graph, subscription, publisher });
            }
        }
        for (publisher, lines) in work {
            let mut calls = called.lock();
            if calls.len() >= MAX_CALLS || !calls.insert(publisher.clone()) {
                // Its lines end here, and are tried again after their pause.
                continue;
            }
            drop(calls);
            let called = Arc::clone(&called);
            let call = move || {
                call(&publisher, lines);
                called.lock().remove(&publisher);
            };
            // Without a thread the lines end too.
            let _ = std::thread::Builder::new().name("ros-call".into()).spawn(call);
        }
    }
}

/// Finds the node `publisher`, connects each line to it, and hands the connections over to the node's thread.
fn call(publisher: &str, lines: Vec<Busy>) {
    let Some(graph) = lines.first().map(|line| Arc::clone(&line.graph)) else { return };
    let node = find(&graph, publisher);
    for line in lines {
        let connected = match &node {
            Ok(node) => connect(&line, node),
            Err(trouble) => Err(trouble.again()),
        };
        match connected {
            Ok(stream) => hand_over(line, stream),
            Err(trouble) => line.subscription.fail(publisher, &trouble, &graph.report),
        }
    }
}

impl Trouble {
    /// The same for another line.
    fn again(&self) -> Self {
        match self {
            Self::Gone => Self::Gone,
            Self::OutOfReach(what) => Self::OutOfReach(what.clone()),
            Self::Fault(what) => Self::Fault(what.clone()),
        }
    }
}

/// The address of a node, as the master knows it.
fn find(graph: &Graph, publisher: &str) -> Result<Peer, Trouble> {
    let Ok(Value::String(uri)) = graph.master().call("lookupNode", vec![text(publisher)]) else {
        return Err(Trouble::Gone);
    };
    let out_of_reach = |error: CallError| Trouble::OutOfReach(error.to_string());
    let node = Peer::new(&uri, &graph.name, TIMEOUT).map_err(out_of_reach)?;
    if graph.is_local && !node.addresses().map_err(out_of_reach)?.iter().all(is_here) {
        return Err(Trouble::Fault(format!(
            "it is at {}, and only programs of this machine are listened to while the master is on it; set ROS_IP or \
             ROS_HOSTNAME to the address of this machine in your network",
            quote(node.uri())
        )));
    }
    Ok(node)
}

/// Whether an address is one of this machine: only those can be bound.
fn is_here(address: &SocketAddr) -> bool {
    let ip: IpAddr = address.ip();
    ip.is_loopback() || TcpListener::bind((ip, 0)).is_ok()
}

/// A connection to `node` for the messages of the line's topic; our header is sent.
fn connect(line: &Busy, node: &Peer) -> Result<TcpStream, Trouble> {
    let Busy { graph, subscription, .. } = line;
    let protocols = Value::Array(vec![Value::Array(vec![text("TCPROS")])]);
    let answer = node.call("requestTopic", vec![text(&subscription.topic), protocols]);
    let answer = answer.map_err(|error| match error {
        // It has just withdrawn its topic, or itself.
        CallError::Refused { .. } => Trouble::Gone,
        CallError::NoAnswer { reason, .. } if reason.kind() == ErrorKind::ConnectionRefused => Trouble::Gone,
        error => Trouble::OutOfReach(error.to_string()),
    })?;
    let no_address = || Trouble::Fault("it does not say where its messages are to be had".into());
    let Value::Array(parts) = answer else { return Err(no_address()) };
    let [_, Value::String(host), Value::Integer(port), ..] = &parts[..] else { return Err(no_address()) };
    let port = u16::try_from(*port).map_err(|_| no_address())?;
    let out_of_reach = |error: io::Error| match error.kind() {
        ErrorKind::ConnectionRefused => Trouble::Gone,
        _ => Trouble::OutOfReach(format!("{host}:{port}: {error}")),
    };
    let mut last = ErrorKind::AddrNotAvailable.into();
    for address in resolve(host, port).map_err(out_of_reach)? {
        if graph.is_local && !is_here(&address) {
            return Err(Trouble::Fault(format!("its messages come from another machine, {address}")));
        }
        match TcpStream::connect_timeout(&address, TIMEOUT) {
            Ok(stream) => return greet(line, stream).map_err(|_| Trouble::Gone),
            Err(error) => last = error,
        }
    }
    Err(out_of_reach(last))
}

/// Sends our header to a publisher.
fn greet(line: &Busy, mut stream: TcpStream) -> io::Result<TcpStream> {
    let Subscription { topic, wanted: Wanted { kind, .. }, .. } = &*line.subscription;
    stream.set_write_timeout(Some(TIMEOUT))?;
    stream.write_all(&header_of(&[
        ("callerid", &line.graph.name),
        ("topic", topic),
        ("type", &kind.name),
        ("md5sum", &kind.md5sum),
        ("message_definition", &kind.definition),
        ("tcp_nodelay", "1"),
    ]))?;
    set_options(&stream)?;
    stream.set_nonblocking(true)?;
    Ok(stream)
}

fn hand_over(line: Busy, stream: TcpStream) {
    let stream = Arc::new(stream);
    let is_wanted = line.subscription.with_line(&line.publisher, |own| {
        own.stream = Some(Arc::clone(&stream));
        own.unreached = 0;
    });
    if is_wanted.is_none() || line.subscription.is_closed() {
        return;
    }
    let graph = Arc::clone(&line.graph);
    let large = line.subscription.wanted.longest > LARGE;
    let deadline = Some(Instant::now() + HANDSHAKE_TIMEOUT);
    graph.serve(
        Box::new(Listening { line, stream, input: Buffer::default(), kind: None, deadline, is_heard: false }),
        large,
    );
}

/// Receives from one publisher.
struct Listening {
    line: Busy,
    stream: Arc<TcpStream>,
    input: Buffer,
    /// The type that the publisher announces, once it has.
    kind: Option<String>,
    /// When it has to have answered our header.
    deadline: Option<Instant>,
    /// A message has come.
    is_heard: bool,
}

impl Listening {
    /// Uses all blocks that are complete.
    fn use_input(&mut self) -> Result<(), Trouble> {
        let subscription = &*self.line.subscription;
        let Wanted { kind: wanted, longest } = &subscription.wanted;
        let too_long = |length, longest| Trouble::Fault(format!("it announces {length} bytes, {longest} are the most"));
        if self.kind.is_none() {
            let header = self.input.block(MAX_HEADER).map_err(|length| too_long(length, MAX_HEADER))?;
            let Some(header) = header else { return Ok(()) };
            self.kind = Some(announced_kind(header, wanted)?);
            self.deadline = None;
        }
        let kind = self.kind.as_deref().unwrap_or_default();
        while let Some(body) = self.input.block(*longest).map_err(|length| too_long(length, *longest))? {
            if subscription.is_closed() {
                return Err(Trouble::Gone);
            }
            (subscription.on_message)(RawReceived { kind, body });
            if !std::mem::replace(&mut self.is_heard, true) {
                subscription.with_line(&self.line.publisher, |line| line.attempts = 0);
            }
        }
        Ok(())
    }

    fn fail(&self, trouble: &Trouble) {
        self.line.subscription.fail(&self.line.publisher, trouble, &self.line.graph.report);
    }
}

/// The type that a publisher announces in its header.
fn announced_kind(header: &[u8], wanted: &Kind) -> Result<String, Trouble> {
    let fields = fields(header);
    if let Some(why) = fields.get("error") {
        return Err(Trouble::Fault(format!("it refuses us: {}", quote(why))));
    }
    let field = |key: &str| fields.get(key).map(String::as_str).unwrap_or_default();
    let differs = |wanted: &str, key: &str| wanted != "*" && wanted != field(key);
    if field("type").is_empty() {
        return Err(Trouble::Fault("its answer is no header of a publisher".into()));
    }
    if differs(&wanted.name, "type") || differs(&wanted.md5sum, "md5sum") {
        return Err(Trouble::Fault(format!(
            "it sends {} with the checksum {}, expected {} with {}: a program with another version of the message",
            quote(field("type")),
            quote(field("md5sum")),
            wanted.name,
            wanted.md5sum,
        )));
    }
    Ok(field("type").to_owned())
}

impl Handler for Listening {
    fn socket(&self) -> RawFd {
        self.stream.as_raw_fd()
    }

    fn ready(&mut self) -> Turn {
        let mut count = 0;
        while count < TURN {
            match self.input.read(&self.stream) {
                Came::Bytes(bytes) => count += bytes,
                Came::Nothing => return Turn::Wait,
                Came::End => return Turn::Done,
            }
            if let Err(trouble) = self.use_input() {
                self.fail(&trouble);
                return Turn::Done;
            }
        }
        Turn::Again
    }

    fn deadline(&self) -> Option<Instant> {
        self.deadline
    }
}

impl Drop for Listening {
    fn drop(&mut self) {
        if self.deadline.is_some_and(|deadline| deadline <= Instant::now()) {
            let seconds = HANDSHAKE_TIMEOUT.as_secs();
            self.fail(&Trouble::Fault(format!("it takes the connection and says nothing within {seconds} s")));
        }
    }
}

/// Who publishes some topics, as the master says when it is asked again and again. It lists nodes that were killed, too,
/// until it ends.
#[derive(Default)]
struct Listing {
    /// Hash of the last answer.
    answer: Option<u64>,
    topics: BTreeSet<String>,
    publishers: Publishers,
}

impl Listing {
    /// Publishers of `topics` as `master` says now; as it said before when it does not answer.
    fn refresh(&mut self, master: &Peer, topics: BTreeSet<String>) -> &Publishers {
        if !topics.is_subset(&self.topics) {
            // The last answer was not read for all of them.
            self.answer = None;
        }
        self.topics = topics;
        if let Ok(Some(state)) = master.call_unless("getSystemState", vec![], &mut self.answer) {
            self.publishers = publishers(state, &self.topics).unwrap_or_default();
        }
        &self.publishers
    }
}

/// Who publishes `wanted` in a system state: (publishers, subscribers, services), each a list of names with lists of nodes.
fn publishers(state: Value, wanted: &BTreeSet<String>) -> Option<Publishers> {
    let Value::Array(lists) = state else { return None };
    let Some(Value::Array(topics)) = lists.into_iter().next() else { return None };
    let entry = |entry| {
        let Value::Array(pair) = entry else { return None };
        let Ok([Value::String(topic), Value::Array(nodes)]) = <[Value; 2]>::try_from(pair) else { return None };
        let names = nodes.into_iter().filter_map(|node| match node {
            Value::String(name) => Some(name),
            _ => None,
        });
        Some((topic, names.collect()))
    };
    Some(topics.into_iter().filter_map(entry).filter(|(topic, _)| wanted.contains(topic)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_publisher_that_fails_is_tried_less_and_less_often_and_named_once() {
        let (mut line, now) = (Line::default(), Instant::now());
        let mut pauses = |next: &dyn Fn(&mut Line)| {
            let after = |line: &mut Line| {
                next(line);
                line.not_before.unwrap() - now
            };
            let pauses: Vec<_> = (0..40).map(|_| after(&mut line)).collect();
            assert!(pauses.windows(2).all(|pair| pair[0] <= pair[1]));
            (pauses[0], pauses[39])
        };
        let begin = |line: &mut Line| {
            line.begin(now, MAX_ABSENT_PAUSE);
        };
        assert_eq!(pauses(&begin), (BACK_OFF, MAX_ABSENT_PAUSE));
        assert_eq!(pauses(&|line| assert_eq!(line.fault(now), line.faults == 1)), (BACK_OFF, MAX_FAULTY_PAUSE));
    }

    #[test]
    fn a_publisher_is_named_when_there_was_no_way_to_it_several_times_in_a_row() {
        let topic = RawSubscription::new("/t".into(), |_| ()).0.clone();
        let listed = BTreeSet::from(["/p".to_owned()]);
        topic.choose(Some(&listed), Instant::now());
        let lines = Arc::new(Mutex::new(Vec::new()));
        let report: Report = Arc::new({
            let lines = Arc::clone(&lines);
            move |line| lines.lock().push(line.to_string())
        });
        let (late, gone) = (Trouble::OutOfReach("late".into()), Trouble::Gone);
        // As a program that comes and goes and once in a while answers late.
        for _ in 0..20 {
            topic.fail("/p", &gone, &report);
            for _ in 1..ATTEMPTS {
                topic.fail("/p", &late, &report);
            }
        }
        assert_eq!(*lines.lock(), [""; 0]);
        for _ in 0..20 {
            topic.fail("/p", &late, &report);
        }
        assert_eq!(*lines.lock(), ["ROS: /t: /p cannot be reached: late; trying again and again"]);
    }

    #[test]
    fn many_publishers_that_are_gone_are_not_tried_more_often_than_a_few() {
        // Each was tried every 3 s, however many there were.
        let attempts = |count: usize| {
            let topic = RawSubscription::new("/t".into(), |_| ()).0.clone();
            let listed: BTreeSet<String> = (0..count).map(|number| format!("/gone_{number}")).collect();
            let (begin, mut tried, mut rounds) = (Instant::now(), 0, 0);
            let mut now = begin;
            while now < begin + Duration::from_secs(600) {
                let (chosen, next) = topic.choose(Some(&listed), now);
                rounds += 1;
                if now > begin + Duration::from_secs(300) {
                    tried += chosen.len();
                }
                for publisher in chosen {
                    topic.with_line(&publisher, |line| line.busy = false);
                }
                now = next.unwrap();
            }
            assert!(rounds < 6500, "{rounds} rounds in 600 s for {count}");
            tried
        };
        assert!((95..=105).contains(&attempts(1)), "{}", attempts(1));
        for count in [30, 300] {
            let tried = attempts(count);
            assert!((2500..=3200).contains(&tried), "{tried} of {count}: ten a second");
        }
    }

    #[test]
    fn publishers_are_read_from_a_system_state() {
        let text = |text: &str| Value::String(text.into());
        let list = Value::Array;
        let topic = list(vec![text("/t"), list(vec![text("/b"), Value::Integer(3), text("/a")])]);
        let other = list(vec![text("/other"), list(vec![text("/a")])]);
        let state = list(vec![list(vec![topic, other, text("nonsense")]), list(vec![]), list(vec![])]);
        let wanted = BTreeSet::from(["/t".to_owned(), "/quiet".to_owned()]);
        let names = BTreeSet::from(["/a".to_owned(), "/b".to_owned()]);
        assert_eq!(publishers(state, &wanted), Some(Publishers::from([("/t".to_owned(), names)])));
        assert_eq!(publishers(text("nonsense"), &wanted), None);
    }
}
