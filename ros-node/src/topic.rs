//! Topics that the node publishes.
//!
//! A message is encoded once, into memory that is used again, and written at once, in the thread that sends it, to each
//! subscriber whose socket takes it: no other thread has to wake up. What a socket does not take waits, and the node's
//! thread goes on when there is room again. At most some messages wait for a subscriber; newer ones take the place of
//! the oldest. So nobody waits for a subscriber that is slow, and none of them for another.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::os::fd::{AsRawFd, RawFd};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use parking_lot::Mutex;
use rosrust::{Clock, Message};

use super::announcement::{Announcement, Direction, Endpoint, Registration};
use super::connections::Place;
use super::reactor::{Handler, Turn};

/// Messages that wait for a subscriber at most, as in the C++ simulator.
const QUEUE: usize = 10;

/// A subscriber that takes nothing for so long is disconnected: a robot's node connects again when it comes to itself.
const STUCK: Duration = Duration::from_secs(5);

/// A subscriber of large messages that has been sent the same one for longer than this is not worth making messages
/// for.
const STALLED: Duration = Duration::from_secs(2);

/// Messages whose memory is kept for the next ones, a topic.
const KEPT: usize = 3;

/// How a topic treats its subscribers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Traffic {
    /// Small messages that all count: some wait; who takes none for [`STUCK`] is disconnected.
    States,
    /// Large messages of which only the newest counts: one waits. Nobody is disconnected: a viewer that is stopped in a
    /// debugger is not to be lost.
    Pictures,
}

/// What a type of messages is, for headers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Kind {
    /// `package/Type`.
    pub name: String,
    /// Checksum of the definition.
    pub md5sum: String,
    /// The definition with all that it is made of.
    pub definition: String,
}

impl Kind {
    pub fn of<M: Message>() -> Self {
        Self { name: M::msg_type(), md5sum: M::md5sum(), definition: M::msg_definition() }
    }
}

/// What the connections of a topic need.
pub(crate) struct Topic {
    pub name: String,
    pub kind: Kind,
    pub latched: bool,
    pub traffic: Traffic,
    subscribers: Mutex<Vec<Arc<Subscriber>>>,
    /// Length of the above, which is asked for more often than it changes.
    count: AtomicUsize,
    /// The last message of a latched topic.
    last: Mutex<Option<Arc<Vec<u8>>>>,
    /// Messages whose memory is used again once no subscriber needs them; none without subscribers.
    kept: Mutex<Vec<Arc<Vec<u8>>>>,
    /// Whether subscribers are taken.
    open: AtomicBool,
    /// Whether it is registered at the master.
    announced: AtomicBool,
    /// Number of the next message.
    sequence: Arc<AtomicUsize>,
}

impl Topic {
    pub(crate) fn new(name: String, kind: Kind, latched: bool, traffic: Traffic) -> Arc<Self> {
        Arc::new(Self {
            name,
            kind,
            latched,
            traffic,
            subscribers: Mutex::default(),
            count: AtomicUsize::new(0),
            last: Mutex::default(),
            kept: Mutex::default(),
            open: AtomicBool::new(false),
            announced: AtomicBool::new(false),
            sequence: Arc::default(),
        })
    }

    /// Takes subscribers from now on.
    pub fn open(&self) {
        self.open.store(true, Ordering::Release);
    }

    /// Disconnects all subscribers and takes no more.
    pub fn close(&self) {
        let mut subscribers = self.subscribers.lock();
        self.open.store(false, Ordering::Release);
        self.announced.store(false, Ordering::Release);
        subscribers.drain(..).for_each(|subscriber| subscriber.disconnect());
        self.count.store(0, Ordering::Release);
        self.kept.lock().clear();
    }

    pub fn set_announced(&self) {
        self.announced.store(true, Ordering::Release);
    }

    pub fn has_subscribers(&self) -> bool {
        self.count.load(Ordering::Acquire) > 0
    }

    /// Names of the connected nodes.
    pub fn subscriber_names(&self) -> Vec<String> {
        self.subscribers.lock().iter().map(|subscriber| subscriber.name.clone()).collect()
    }

    /// Takes the subscriber `name` at `stream`, to which `header` is sent first; `None` when the topic has been
    /// withdrawn. The handler serves it.
    pub fn admit(
        self: &Arc<Self>,
        name: String,
        stream: Arc<TcpStream>,
        header: Vec<u8>,
        place: Place,
    ) -> Option<Serving> {
        let depth = match self.traffic {
            Traffic::States => QUEUE,
            Traffic::Pictures => 1,
        };
        let subscriber = Arc::new(Subscriber { name, depth, stream, queue: Mutex::default() });
        let mut subscribers = self.subscribers.lock();
        if !self.open.load(Ordering::Acquire) {
            return None;
        }
        subscriber.post(&Arc::new(header));
        if let Some(last) = &*self.last.lock() {
            subscriber.post(last);
        }
        subscribers.push(Arc::clone(&subscriber));
        self.count.store(subscribers.len(), Ordering::Release);
        Some(Serving { topic: Arc::clone(self), subscriber, _place: place })
    }

    fn dismiss(&self, subscriber: &Arc<Subscriber>) {
        let mut subscribers = self.subscribers.lock();
        subscribers.retain(|other| !Arc::ptr_eq(other, subscriber));
        self.count.store(subscribers.len(), Ordering::Release);
        if subscribers.is_empty() {
            self.kept.lock().clear();
        }
    }

    /// Memory for a message; what is in it first is the place of its length.
    fn memory(&self) -> Vec<u8> {
        let mut kept = self.kept.lock();
        let free = kept.iter().position(|message| Arc::strong_count(message) == 1);
        let mut memory = free.and_then(|free| Arc::into_inner(kept.swap_remove(free))).unwrap_or_default();
        memory.clear();
        memory.extend([0; 4]);
        memory
    }

    /// Sends a message that has been written into [`memory`](Self::memory). One of 4 GiB and more is not sent.
    fn post(&self, mut message: Vec<u8>) {
        let Ok(length) = u32::try_from(message.len() - 4) else { return };
        message[..4].copy_from_slice(&length.to_le_bytes());
        let message = Arc::new(message);
        let subscribers = self.subscribers.lock();
        if self.latched && self.open.load(Ordering::Acquire) {
            *self.last.lock() = Some(Arc::clone(&message));
        }
        subscribers.iter().for_each(|subscriber| subscriber.post(&message));
        let mut kept = self.kept.lock();
        if !subscribers.is_empty() && kept.len() < KEPT {
            kept.push(message);
        }
    }

    /// Whether anybody would notice a message.
    fn is_heard(&self) -> bool {
        self.has_subscribers() || (self.latched && self.open.load(Ordering::Acquire))
    }
}

/// A connection to a subscriber.
struct Subscriber {
    name: String,
    /// Messages that may wait behind the one that is being written.
    depth: usize,
    stream: Arc<TcpStream>,
    queue: Mutex<Queue>,
}

/// What waits for a subscriber.
#[derive(Default)]
struct Queue {
    /// Messages, the oldest first.
    waiting: VecDeque<Arc<Vec<u8>>>,
    /// Bytes of the first one that have been written.
    written: usize,
    /// Since when the socket has taken nothing.
    stuck: Option<Instant>,
    /// Since when the first message has been on its way.
    begun: Option<Instant>,
    /// The connection is down.
    broken: bool,
}

impl Subscriber {
    /// Sends `message` now or, if others wait, after them; never blocks.
    fn post(&self, message: &Arc<Vec<u8>>) {
        let mut queue = self.queue.lock();
        if queue.broken {
            return;
        }
        if self.depth > 1 && queue.stuck.is_some_and(|since| since.elapsed() > STUCK) {
            queue.broken = true;
            queue.waiting.clear();
            // The node's thread notices and forgets it.
            let _ = self.stream.shutdown(Shutdown::Both);
            return;
        }
        if queue.waiting.len() > self.depth {
            // The first one has to be finished once it is begun.
            let oldest = usize::from(queue.written > 0);
            queue.waiting.remove(oldest);
        }
        queue.waiting.push_back(Arc::clone(message));
        if queue.waiting.len() == 1 {
            queue.begun = Some(Instant::now());
            queue.flush(&self.stream);
        }
    }

    /// Sends what waits as far as the socket takes it.
    fn flush(&self) {
        self.queue.lock().flush(&self.stream);
    }

    fn is_broken(&self) -> bool {
        self.queue.lock().broken
    }

    fn is_stalled(&self) -> bool {
        self.queue.lock().begun.is_some_and(|since| since.elapsed() > STALLED)
    }

    fn disconnect(&self) {
        self.queue.lock().broken = true;
        let _ = self.stream.shutdown(Shutdown::Both);
    }
}

impl Queue {
    fn flush(&mut self, mut stream: &TcpStream) {
        while let Some(message) = self.waiting.front() {
            match stream.write(&message[self.written..]) {
                Ok(count) => {
                    self.stuck = None;
                    self.written += count;
                    if self.written == message.len() {
                        self.waiting.pop_front();
                        self.written = 0;
                        self.begun = (!self.waiting.is_empty()).then(Instant::now);
                    }
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => (),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    self.stuck.get_or_insert_with(Instant::now);
                    return;
                }
                Err(_) => {
                    self.broken = true;
                    self.waiting.clear();
                    return;
                }
            }
        }
    }
}

/// Serves one subscriber of a topic.
pub(crate) struct Serving {
    topic: Arc<Topic>,
    subscriber: Arc<Subscriber>,
    _place: Place,
}

impl Handler for Serving {
    fn socket(&self) -> RawFd {
        self.subscriber.stream.as_raw_fd()
    }

    fn ready(&mut self) -> Turn {
        self.subscriber.flush();
        // Subscribers say nothing: whatever comes is dropped, a little at a time, and so their end is noticed.
        let mut ignored = [0; 1024];
        match (&*self.subscriber.stream).read(&mut ignored) {
            _ if self.subscriber.is_broken() => Turn::Done,
            Ok(0) => Turn::Done,
            Ok(_) => Turn::Again,
            Err(error) if error.kind() == ErrorKind::Interrupted => Turn::Again,
            Err(error) if error.kind() == ErrorKind::WouldBlock => Turn::Wait,
            Err(_) => Turn::Done,
        }
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        self.topic.dismiss(&self.subscriber);
        self.subscriber.disconnect();
    }
}

/// The clock of this machine, for headers without a time.
struct WallClock;

impl Clock for WallClock {
    fn now(&self) -> rosrust::Time {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        rosrust::Time { sec: since.as_secs() as u32, nsec: since.subsec_nanos() }
    }

    fn sleep(&self, _: rosrust::Duration) {}

    fn wait_until(&self, _: rosrust::Time) {}
}

/// A topic of small messages to publish on. Nothing is sent before it is announced.
pub struct Publication<M: Message> {
    /// Shared by publications of the same name while they are announced.
    topic: Mutex<Arc<Topic>>,
    clock: Arc<dyn Clock>,
    messages: std::marker::PhantomData<fn(M)>,
}

impl<M: Message> Publication<M> {
    /// A topic whose subscribers get what is sent after they have connected.
    pub fn new(topic: String) -> Arc<Self> {
        Self::with(topic, false)
    }

    /// A topic whose subscribers get the last message too that was sent before they connected.
    pub fn latched(topic: String) -> Arc<Self> {
        Self::with(topic, true)
    }

    fn with(topic: String, latched: bool) -> Arc<Self> {
        let topic = Mutex::new(Topic::new(topic, Kind::of::<M>(), latched, Traffic::States));
        Arc::new(Self { topic, clock: Arc::new(WallClock), messages: std::marker::PhantomData })
    }

    fn topic(&self) -> Arc<Topic> {
        Arc::clone(&self.topic.lock())
    }

    /// Whether it is registered at the master.
    pub fn is_announced(&self) -> bool {
        self.topic().announced.load(Ordering::Acquire)
    }

    /// Whether anybody is connected.
    pub fn has_subscribers(&self) -> bool {
        self.topic().has_subscribers()
    }

    /// Sends a message of type `M` that is encoded already, without its length; otherwise as [`send`](Self::send).
    pub fn send_encoded(&self, body: &[u8]) {
        let topic = self.topic();
        if topic.is_heard() {
            let mut memory = topic.memory();
            memory.extend_from_slice(body);
            topic.post(memory);
        }
    }

    /// Sends `message`, in whose header a number and a time that are 0 are filled in; never waits for the network.
    /// Without subscribers it is not even encoded, unless the topic is latched.
    pub fn send(&self, mut message: M) {
        let topic = self.topic();
        if topic.is_heard() {
            message.set_header(&self.clock, &topic.sequence);
            Self::post(&topic, &message);
        }
    }

    /// Sends `message` with its header as it is: a time of 0 says in some protocols that the data are not valid now.
    /// Otherwise as [`send`](Self::send).
    pub fn send_as_is(&self, message: &M) {
        let topic = self.topic();
        if topic.is_heard() {
            Self::post(&topic, message);
        }
    }

    fn post(topic: &Topic, message: &M) {
        let mut memory = topic.memory();
        // Encoding into memory cannot fail.
        if message.encode(&mut memory).is_ok() {
            topic.post(memory);
        }
    }
}

impl<M: Message> Announcement for Publication<M> {
    fn registration(&self) -> Registration {
        registration(&self.topic())
    }

    fn endpoint(&self) -> Endpoint {
        Endpoint::topic(self.topic())
    }

    fn share(&self, endpoint: Endpoint) {
        endpoint.into_topic(|topic| *self.topic.lock() = topic);
    }
}

fn registration(topic: &Topic) -> Registration {
    Registration { topic: topic.name.clone(), message_type: topic.kind.name.clone(), direction: Direction::Publishes }
}

/// A topic of large messages, pictures for example: each subscriber gets the newest one when it is ready for one.
pub struct LargePublication {
    name: String,
    /// Shared by publications of the same name while they are announced.
    topic: Mutex<Arc<Topic>>,
    /// Messages are made one at a time.
    sending: Mutex<()>,
}

impl LargePublication {
    /// A topic for messages of type `M`.
    pub fn new<M: Message>(name: String) -> Arc<Self> {
        let topic = Mutex::new(Topic::new(name.clone(), Kind::of::<M>(), false, Traffic::Pictures));
        Arc::new(Self { name, topic, sending: Mutex::default() })
    }

    fn topic(&self) -> Arc<Topic> {
        Arc::clone(&self.topic.lock())
    }

    /// Name of the topic.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether somebody is connected who has not stopped reading: one to whom the same message has been sent for more
    /// than 2 s does not count.
    pub fn is_wanted(&self) -> bool {
        let topic = self.topic();
        topic.has_subscribers() && topic.subscribers.lock().iter().any(|subscriber| !subscriber.is_stalled())
    }

    /// Makes a message and sends it to all subscribers; never waits for one. `write` appends the message as it goes over
    /// the wire, without its length; it is told the number of the message, from 0, for the message's header. Nothing is
    /// made when nobody is connected.
    ///
    /// Messages of 4 GiB and more are not sent.
    pub fn send(&self, write: impl FnOnce(&mut Vec<u8>, u32)) {
        let topic = self.topic();
        if !topic.has_subscribers() {
            return;
        }
        let _turn = self.sending.lock();
        let mut message = topic.memory();
        write(&mut message, topic.sequence.fetch_add(1, Ordering::AcqRel) as u32);
        topic.post(message);
    }
}

impl Announcement for LargePublication {
    fn registration(&self) -> Registration {
        registration(&self.topic())
    }

    fn endpoint(&self) -> Endpoint {
        Endpoint::topic(self.topic())
    }

    fn share(&self, endpoint: Endpoint) {
        endpoint.into_topic(|topic| *self.topic.lock() = topic);
    }
}

/// Options of a connection over which messages go: small ones are sent at once, and a peer that vanished without a word
/// is noticed.
///
/// # Errors
/// When the connection is down.
pub(crate) fn set_options(stream: &TcpStream) -> io::Result<()> {
    use rustix::net::sockopt;
    stream.set_nodelay(true)?;
    sockopt::set_socket_keepalive(stream, true)?;
    sockopt::set_tcp_keepidle(stream, KEEP_ALIVE)?;
    sockopt::set_socket_send_buffer_size(stream, SEND_BUFFER)?;
    Ok(())
}

/// A peer that vanished without a word is noticed after this much silence and a few unanswered probes.
const KEEP_ALIVE: Duration = Duration::from_secs(10);

/// What the kernel may hold back for one subscriber, bytes: some hundred states, or a part of a picture. Left to itself it
/// takes megabytes: old messages, for one that does not read.
const SEND_BUFFER: usize = 256 << 10;
