//! Listening to topics on connections of our own.
//!
//! rosrust's subscribers do not try again when a connection fails, wait for ever for a publisher that hangs, lose
//! messages that come in bursts, believe any length that is announced, and do not ask for small messages to be sent at
//! once. Here each publisher that the master lists is connected to until it answers, also after it was restarted, and
//! its thread hands each message over directly.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, ErrorKind};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant};

use dxr::Value;
use parking_lot::Mutex;
use rosrust::api::Ros;
use rosrust::error::Error;
use rosrust::Message;

use super::tcpros::{quote, Incoming, SubscribeError, Wanted};
use super::topic::{Announcement, Direction, Registration};
use super::xmlrpc::{CallError, Peer};
use super::Report;

/// How long a publisher may take for each step of connecting.
const TIMEOUT: Duration = Duration::from_secs(1);

/// Longest message of any type, bytes.
const LONGEST: usize = 16 << 20;

/// How long a publisher that was connected to in vain is left alone the first time; doubled each time.
const BACK_OFF: Duration = Duration::from_millis(200);

/// Longest such pause for one that is not there: a program that was killed stays on the master's list, and comes back
/// under the same name.
const LONGEST_ABSENCE: Duration = Duration::from_secs(3);

/// Longest such pause for one that does what publishers don't do: it may say something about each attempt.
const LONGEST_PENANCE: Duration = Duration::from_secs(30);

/// A publisher that there is no way to is named after so many attempts in a row, some seconds: it may be gone by then.
const ATTEMPTS: u32 = 6;

/// Names of the nodes that publish each topic.
pub type Publishers = BTreeMap<String, BTreeSet<String>>;

/// A message as it came.
#[derive(Debug, Clone, Copy)]
pub struct RawReceived<'a> {
    /// Its type, `package/Type`, as its publisher says.
    pub kind: &'a str,
    /// Its fields.
    pub body: &'a [u8],
}

type Handler = dyn Fn(RawReceived<'_>) + Send + Sync;

/// A topic to listen to. A publisher that does not do as publishers do is named once.
pub struct RawSubscription {
    shared: Arc<Shared>,
}

struct Shared {
    topic: String,
    wanted: Wanted,
    master: Peer,
    on_message: Box<Handler>,
    /// Name and address of our node while it listens.
    node: Mutex<Option<(String, String)>>,
    /// By name of the publishing node.
    lines: Mutex<BTreeMap<String, Line>>,
    stop: AtomicBool,
}

/// A publisher that the master lists.
#[derive(Default)]
struct Line {
    /// A thread looks after it.
    busy: bool,
    /// The connection, to be ended from outside.
    stream: Option<TcpStream>,
    /// Attempts since the last message.
    attempts: u32,
    /// Not before then again.
    not_before: Option<Instant>,
    /// How often it did what publishers don't do.
    faults: u32,
}

impl RawSubscription {
    /// Messages of any type, of 16 MiB at most. `on_message` runs in a thread of each publisher's and must not block.
    pub fn new(master: Peer, topic: String, on_message: impl Fn(RawReceived<'_>) + Send + Sync + 'static) -> Arc<Self> {
        Self::with(master, topic, Wanted::any(LONGEST), on_message)
    }

    /// Messages that claim to be an `M`, of `longest` bytes at most; other publishers are not listened to. `on_message`
    /// runs in a thread of each publisher's and must not block.
    pub fn of<M: Message>(
        master: Peer,
        topic: String,
        longest: usize,
        on_message: impl Fn(RawReceived<'_>) + Send + Sync + 'static,
    ) -> Arc<Self> {
        Self::with(master, topic, Wanted::of::<M>(longest), on_message)
    }

    fn with(
        master: Peer,
        topic: String,
        wanted: Wanted,
        on_message: impl Fn(RawReceived<'_>) + Send + Sync + 'static,
    ) -> Arc<Self> {
        let shared = Shared {
            topic,
            wanted,
            master,
            on_message: Box::new(on_message),
            node: Mutex::default(),
            lines: Mutex::default(),
            stop: AtomicBool::new(false),
        };
        Arc::new(Self { shared: Arc::new(shared) })
    }
}

impl Announcement for RawSubscription {
    fn registration(&self) -> Registration {
        let Shared { topic, wanted, .. } = &*self.shared;
        Registration { topic: topic.clone(), message_type: wanted.kind.clone(), direction: Direction::Subscribes }
    }

    /// The master may fail: it is told again when it does not know us.
    fn announce(&self, ros: &Ros) -> Result<(), Error> {
        let shared = &self.shared;
        shared.stop.store(false, Ordering::Release);
        *shared.node.lock() = Some((ros.name().to_owned(), ros.uri().to_owned()));
        let text = |s: &str| Value::String(s.to_owned());
        let arguments = vec![text(&shared.topic), text(&shared.wanted.kind), text(ros.uri())];
        shared.master.called_by(ros.name()).call("registerSubscriber", arguments).map_err(|error| error.to_string())?;
        Ok(())
    }

    fn withdraw(&self) {
        let shared = &self.shared;
        shared.stop.store(true, Ordering::Release);
        for stream in shared.lines.lock().values().filter_map(|line| line.stream.as_ref()) {
            let _ = stream.shutdown(Shutdown::Both);
        }
        if let Some((name, uri)) = shared.node.lock().take() {
            let arguments = vec![Value::String(shared.topic.clone()), Value::String(uri)];
            // A master that is away has nothing to forget.
            let _ = shared.master.called_by(&name).call("unregisterSubscriber", arguments);
        }
    }

    fn connects(&self) -> bool {
        true
    }

    fn connect(&self, publishers: &Publishers, report: &Report) {
        let Some((own, _)) = self.shared.node.lock().clone() else { return };
        let listed = publishers.get(&self.shared.topic);
        let mut lines = self.shared.lines.lock();
        lines.retain(|publisher, line| line.busy || listed.is_some_and(|listed| listed.contains(publisher)));
        let now = Instant::now();
        for publisher in listed.into_iter().flatten() {
            let line = lines.entry(publisher.clone()).or_default();
            if line.busy || line.not_before.is_some_and(|then| now < then) {
                continue;
            }
            line.begin(now);
            let call = Call { shared: Arc::clone(&self.shared), publisher: publisher.clone() };
            let (own, report) = (own.clone(), Arc::clone(report));
            let thread = std::thread::Builder::new().name("ros-listen".into());
            // Without a thread the call ends here, and the lock must be free for that.
            drop(lines);
            let _ = thread.spawn(move || call.run(&own, &report));
            lines = self.shared.lines.lock();
        }
    }
}

impl Line {
    /// Another attempt; the time of the next one, should it fail, is settled now.
    fn begin(&mut self, now: Instant) {
        self.busy = true;
        self.not_before = Some(now + pause(self.attempts, LONGEST_ABSENCE));
        self.attempts = self.attempts.saturating_add(1);
    }

    /// It did what publishers don't do; true for the first time.
    fn fault(&mut self, now: Instant) -> bool {
        self.not_before = Some(now + pause(self.faults, LONGEST_PENANCE));
        self.faults = self.faults.saturating_add(1);
        self.faults == 1
    }
}

/// How long to wait after so many attempts in vain before the last one.
fn pause(attempts: u32, longest: Duration) -> Duration {
    (BACK_OFF * 2u32.pow(attempts.min(10))).min(longest)
}

/// One publisher, as long as its thread runs.
struct Call {
    shared: Arc<Shared>,
    publisher: String,
}

impl Drop for Call {
    /// However the thread ends, the publisher is connected to again as long as the master lists it.
    fn drop(&mut self) {
        self.with_line(|line| (line.busy, line.stream) = (false, None));
    }
}

impl Call {
    fn with_line<T>(&self, change: impl FnOnce(&mut Line) -> T) -> Option<T> {
        self.shared.lines.lock().get_mut(&self.publisher).map(change)
    }

    fn run(&self, own: &str, report: &Report) {
        let topic = &self.shared.topic;
        let publisher = quote(&self.publisher);
        match self.listen(own) {
            Err(SubscribeError::Fault(what)) if self.with_line(|line| line.fault(Instant::now())) == Some(true) => {
                report(format_args!("ROS: {topic}: {publisher} is not listened to: {what}"));
            }
            Err(SubscribeError::OutOfReach(what)) if self.with_line(|line| line.attempts) == Some(ATTEMPTS) => {
                report(format_args!(
                    "ROS: {topic}: {publisher} cannot be reached: {}; trying again and again",
                    quote(&what)
                ));
            }
            _ => (),
        }
    }

    /// Connects to the publisher and hands over what it sends, until it or we end.
    fn listen(&self, own: &str) -> Result<(), SubscribeError> {
        let shared = &*self.shared;
        let stream = self.connect(own)?;
        let stopped = || shared.stop.load(Ordering::Acquire);
        let held = stream.try_clone()?;
        self.with_line(|line| line.stream = Some(held));
        let mut incoming = Incoming::new(&stream, stopped)?;
        let kind = incoming.shake_hands(own, &shared.topic, &shared.wanted)?;
        let (mut message, mut is_first) = (Vec::new(), true);
        while !stopped() {
            incoming.read_message(&mut message, shared.wanted.longest)?;
            if std::mem::take(&mut is_first) {
                self.with_line(|line| line.attempts = 0);
            }
            (shared.on_message)(RawReceived { kind: &kind, body: &message });
        }
        Ok(())
    }

    fn connect(&self, own: &str) -> Result<TcpStream, SubscribeError> {
        let Self { shared, publisher } = self;
        let master = shared.master.called_by(own);
        let uri = master.call("lookupNode", vec![Value::String(publisher.clone())]);
        let Ok(Value::String(uri)) = uri else { return Err(io::Error::from(ErrorKind::NotFound).into()) };
        let node = Peer::new(&uri, own, TIMEOUT).map_err(|error| SubscribeError::OutOfReach(error.to_string()))?;
        let protocols = Value::Array(vec![Value::Array(vec![Value::String("TCPROS".into())])]);
        let answer = node.call("requestTopic", vec![Value::String(shared.topic.clone()), protocols]);
        let answer = answer.map_err(|error| match error {
            // It has just withdrawn its topic, or itself.
            CallError::Refused { .. } => io::Error::from(ErrorKind::NotFound).into(),
            CallError::NoAnswer { reason, .. } if reason.kind() == ErrorKind::ConnectionRefused => reason.into(),
            error => SubscribeError::OutOfReach(error.to_string()),
        })?;
        let no_address = || SubscribeError::Fault("it does not say where its messages are to be had".into());
        let Value::Array(parts) = answer else { return Err(no_address()) };
        let [_, Value::String(host), Value::Integer(port), ..] = &parts[..] else { return Err(no_address()) };
        let port = u16::try_from(*port).map_err(|_| no_address())?;
        let out_of_reach = |error: io::Error| match error.kind() {
            ErrorKind::ConnectionRefused => SubscribeError::Gone(error),
            _ => SubscribeError::OutOfReach(format!("{host}:{port}: {error}")),
        };
        let mut last = ErrorKind::AddrNotAvailable.into();
        for address in (host.as_str(), port).to_socket_addrs().map_err(out_of_reach)? {
            match TcpStream::connect_timeout(&address, TIMEOUT) {
                Ok(stream) => return Ok(stream),
                Err(error) => last = error,
            }
        }
        Err(out_of_reach(last))
    }
}

/// Who publishes what, as the master says when it is asked again and again.
#[derive(Default)]
pub(crate) struct Listing {
    answer: String,
    publishers: Publishers,
}

impl Listing {
    /// What `master` says now; what it said before when it does not answer.
    pub fn refresh(&mut self, master: &Peer) -> &Publishers {
        if let Ok(Some(state)) = master.call_unless("getSystemState", vec![], &mut self.answer) {
            self.publishers = publishers(state).unwrap_or_default();
        }
        &self.publishers
    }
}

/// Who publishes what in a system state: (publishers, subscribers, services), each a list of names with lists of nodes.
fn publishers(state: Value) -> Option<Publishers> {
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
    Some(topics.into_iter().filter_map(entry).collect())
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
        assert_eq!(pauses(&|line| line.begin(now)), (BACK_OFF, LONGEST_ABSENCE));
        assert_eq!(pauses(&|line| assert_eq!(line.fault(now), line.faults == 1)), (BACK_OFF, LONGEST_PENANCE));
    }

    #[test]
    fn publishers_are_read_from_a_system_state() {
        let text = |text: &str| Value::String(text.into());
        let list = Value::Array;
        let topic = list(vec![text("/t"), list(vec![text("/b"), Value::Integer(3), text("/a")])]);
        let state = list(vec![list(vec![topic, text("nonsense")]), list(vec![]), list(vec![])]);
        let names = BTreeSet::from(["/a".to_owned(), "/b".to_owned()]);
        assert_eq!(publishers(state), Some(Publishers::from([("/t".to_owned(), names)])));
        assert_eq!(publishers(text("nonsense")), None);
    }
}
