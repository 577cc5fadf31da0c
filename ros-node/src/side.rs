//! Publishing large messages, from a second node of the process.
//!
//! rosrust has one thread a topic that writes to its subscribers in turn: one that reads slowly holds up the others,
//! and one whose call-back takes longer than the time-out of a write is dropped. That does for small messages, which
//! wait in the kernel; it does not for pictures of megabytes. Here each subscriber has a thread of its own and a place
//! for one message: a newer one takes the place of one that still waits. A message is made once, in memory that is used
//! again, and all subscribers are sent the same bytes.
//!
//! rosrust answers who asks its node for topics, and knows only its own. So the topics here belong to a node of their
//! own, [`SideNode`], that exists while it has any.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use dxr::{MethodCall, MethodResponse, Value};
use parking_lot::{Condvar, Mutex};
use rosrust::api::Ros;
use rosrust::error::Error;
use rosrust::Message;

use super::tcpros::{fields, header_of};
use super::topic::{Announcement, Direction, Registration};
use super::xmlrpc::Peer;

/// How long a client may take for its header or its call.
const READ_TIMEOUT: Duration = Duration::from_secs(5);

/// How often a thread that writes or waits looks whether it should end.
const GLANCE: Duration = Duration::from_millis(200);

/// A subscriber that has been sent the same message for longer than this is not worth making messages for.
const STALLED: Duration = Duration::from_secs(2);

/// Longest header of a subscriber and longest call, bytes: the definition of a message is in a header.
const LONGEST: usize = 1 << 20;

/// How many connections there may be at once; further ones are turned away.
const MAX_CONNECTIONS: usize = 256;

/// Messages whose memory is kept for the next ones, a topic.
const KEPT: usize = 3;

/// A second node of the process. It is there while one of its [publications](LargePublication) is announced.
pub struct SideNode {
    suffix: String,
    master: Peer,
    open: Mutex<Option<Arc<Open>>>,
}

impl SideNode {
    /// A node that is called as the node that announces its topics, `_` and `suffix`; `master` is told of them.
    pub fn new(master: Peer, suffix: &str) -> Arc<Self> {
        Arc::new(Self { suffix: suffix.to_owned(), master, open: Mutex::default() })
    }

    /// The running node; makes it run if it doesn't.
    fn open(&self, ros: &Ros) -> Result<Arc<Open>, String> {
        self.open_beside(ros.name(), ros.uri(), ros.bind_address(), ros.hostname())
    }

    /// The same, beside the node `name` at `uri`; it listens at `address` and is reachable under `host`.
    fn open_beside(&self, name: &str, uri: &str, address: &str, host: &str) -> Result<Arc<Open>, String> {
        let mut place = self.open.lock();
        if let Some(open) = &*place {
            return Ok(Arc::clone(open));
        }
        let name = format!("{name}_{}", self.suffix);
        let owner = Peer::new(uri, "/master", Duration::from_millis(500)).map_err(|error| error.to_string())?;
        let master = self.master.called_by(&name);
        let open = Open::start(address, host, name, master, owner)
            .map_err(|error| format!("no socket for a second node: {error}"))?;
        *place = Some(Arc::clone(&open));
        Ok(open)
    }

    /// Ends the node if it has no topics left.
    fn tidy(&self) {
        let unused = self.open.lock().take_if(|open| open.topics.lock().is_empty());
        if let Some(open) = unused {
            open.close();
        }
    }
}

/// A node that runs.
struct Open {
    name: String,
    /// Address of its calls.
    uri: String,
    host: String,
    /// Port of its topics.
    port: u16,
    /// Port of its calls.
    calls: u16,
    /// The master, called in its name.
    master: Peer,
    /// The node that it belongs to.
    owner: Peer,
    topics: Mutex<BTreeMap<String, Arc<Topic>>>,
    connections: AtomicU64,
    closed: AtomicBool,
}

/// One of the connections of a node, while it is open.
struct Place(Arc<Open>);

impl Drop for Place {
    fn drop(&mut self) {
        self.0.connections.fetch_sub(1, Ordering::AcqRel);
    }
}

impl Open {
    fn start(address: &str, host: &str, name: String, master: Peer, owner: Peer) -> io::Result<Arc<Self>> {
        let (topics, calls) = (TcpListener::bind((address, 0))?, TcpListener::bind((address, 0))?);
        let call_port = calls.local_addr()?.port();
        let open = Arc::new(Self {
            name,
            uri: format!("http://{host}:{call_port}/"),
            host: host.to_owned(),
            port: topics.local_addr()?.port(),
            calls: call_port,
            master,
            owner,
            topics: Mutex::default(),
            connections: AtomicU64::new(0),
            closed: AtomicBool::new(false),
        });
        open.accept("ros-large", topics, |open, stream| open.subscribe(stream))?;
        open.accept("ros-large-calls", calls, |open, stream| open.answer(stream)).inspect_err(|_| open.close())?;
        Ok(open)
    }

    /// Serves the clients of `listener`, each in a thread, until the node is closed.
    fn accept(
        self: &Arc<Self>,
        name: &'static str,
        listener: TcpListener,
        serve: fn(&Self, TcpStream) -> io::Result<()>,
    ) -> io::Result<()> {
        let open = Arc::clone(self);
        thread::Builder::new().name(name.into()).spawn(move || {
            for stream in listener.incoming() {
                if open.closed.load(Ordering::Acquire) {
                    return;
                }
                let Ok(stream) = stream else {
                    // Too many open files, for example: trying at once would only keep the processor busy.
                    thread::sleep(Duration::from_millis(100));
                    continue;
                };
                let before = open.connections.fetch_add(1, Ordering::AcqRel);
                let place = Place(Arc::clone(&open));
                if before >= MAX_CONNECTIONS as u64 {
                    continue;
                }
                // Without a thread the client is turned away too; a connection that breaks is the client's business.
                let _ = thread::Builder::new().name(name.into()).spawn(move || {
                    let _ = serve(&place.0, stream);
                });
            }
        })?;
        Ok(())
    }

    fn close(&self) {
        self.closed.store(true, Ordering::Release);
        for topic in self.topics.lock().values() {
            topic.close();
        }
        // The accepting threads end with the next connection.
        for port in [self.port, self.calls] {
            let _ = TcpStream::connect_timeout(&(Ipv4Addr::LOCALHOST, port).into(), Duration::from_millis(50));
        }
    }

    /// Exchanges headers with a subscriber and serves it until it goes or the topic is withdrawn.
    fn subscribe(&self, mut stream: TcpStream) -> io::Result<()> {
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(READ_TIMEOUT))?;
        stream.set_write_timeout(Some(GLANCE))?;
        let mut length = [0; 4];
        stream.read_exact(&mut length)?;
        let mut header = Vec::new();
        let length = u64::from(u32::from_le_bytes(length)).min(LONGEST as u64);
        (&stream).take(length).read_to_end(&mut header)?;
        let fields = fields(&header);
        let field = |key: &str| fields.get(key).map(String::as_str).unwrap_or_default();
        let topic = self.topics.lock().get(field("topic")).cloned();
        let Some(topic) = topic else {
            let why = format!("{} does not publish {}", self.name, super::tcpros::quote(field("topic")));
            return stream.write_all(&header_of(&[("error", &why)]));
        };
        let differs = |key: &str, own: &str| !["*", own].contains(&field(key));
        if differs("md5sum", &topic.md5sum) || differs("type", &topic.kind) {
            let (kind, md5sum) = (&topic.kind, &topic.md5sum);
            let why = format!("{} is a {kind} with the checksum {md5sum}", field("topic"));
            return stream.write_all(&header_of(&[("error", &why)]));
        }
        stream.write_all(&header_of(&[
            ("callerid", &self.name),
            ("latching", "0"),
            ("md5sum", &topic.md5sum),
            ("message_definition", &topic.definition),
            ("topic", field("topic")),
            ("type", &topic.kind),
        ]))?;
        let subscriber = Arc::new(Subscriber {
            name: field("callerid").to_owned(),
            place: Mutex::default(),
            filled: Condvar::new(),
            stream: stream.try_clone()?,
        });
        if !topic.admit(&subscriber) {
            return Ok(());
        }
        let ended = subscriber.serve(&mut stream);
        topic.dismiss(&subscriber);
        ended
    }

    /// Answers one call (XML-RPC over HTTP, one call a connection).
    fn answer(&self, mut stream: TcpStream) -> io::Result<()> {
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(READ_TIMEOUT))?;
        stream.set_write_timeout(Some(READ_TIMEOUT))?;
        let body = read_request(&mut stream)?;
        let body = String::from_utf8_lossy(&body);
        let value = match MethodCall::from_xml(&body) {
            Ok(call) => self.call(&call),
            Err(_) => answer(-1, "this is no call of XML-RPC", Value::Integer(0)),
        };
        let xml = MethodResponse { value }.to_xml().map_err(|error| io::Error::other(error.to_string()))?;
        write!(
            stream,
            "HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\nConnection: close\r\nContent-Length: {}\r\n\r\n{xml}",
            xml.len()
        )
    }

    fn call(&self, call: &MethodCall<'_>) -> Value {
        let text = |text: &str| Value::String(text.to_owned());
        let topics = || self.topics.lock().iter().map(|(name, topic)| (name.clone(), Arc::clone(topic))).collect();
        match &*call.name {
            "requestTopic" => {
                let name = match call.params.get(1) {
                    Some(Value::String(name)) => name.as_str(),
                    _ => "",
                };
                if !self.topics.lock().contains_key(name) {
                    return answer(-1, &format!("{} does not publish {name}", self.name), Value::Integer(0));
                }
                let how = vec![text("TCPROS"), text(&self.host), Value::Integer(i32::from(self.port))];
                answer(1, "ready", Value::Array(how))
            }
            "getPid" => answer(1, "", Value::Integer(std::process::id() as i32)),
            "getMasterUri" => answer(1, "", text(self.master.uri())),
            "getBusStats" => answer(1, "", Value::Array(vec![Value::Array(Vec::new()); 3])),
            "getSubscriptions" => answer(1, "", Value::Array(Vec::new())),
            "getPublications" => {
                let topics: Vec<(String, Arc<Topic>)> = topics();
                let topics = topics.iter().map(|(name, topic)| Value::Array(vec![text(name), text(&topic.kind)]));
                answer(1, "", Value::Array(topics.collect()))
            }
            "getBusInfo" => {
                let topics: Vec<(String, Arc<Topic>)> = topics();
                let mut rows = Vec::new();
                for (name, topic) in &topics {
                    for subscriber in topic.subscribers.lock().iter() {
                        let number = Value::Integer(rows.len() as i32);
                        let row = vec![
                            number,
                            text(&subscriber.name),
                            text("o"),
                            text("TCPROS"),
                            text(name),
                            Value::Boolean(true),
                        ];
                        rows.push(Value::Array(row));
                    }
                }
                answer(1, "", Value::Array(rows))
            }
            "shutdown" => {
                // Whoever ends this node means the program. The answer comes before its end.
                let owner = self.owner.clone();
                let asked = thread::Builder::new().name("ros-large-calls".into()).spawn(move || {
                    let _ = owner.call("shutdown", vec![Value::String("its second node was told to shut down".into())]);
                });
                answer(i32::from(asked.is_ok()), "", Value::Integer(0))
            }
            "publisherUpdate" | "paramUpdate" => answer(1, "", Value::Integer(0)),
            other => answer(-1, &format!("there is no method {other}"), Value::Integer(0)),
        }
    }
}

/// `[code, message, value]`, with which nodes answer.
fn answer(code: i32, message: &str, value: Value) -> Value {
    Value::Array(vec![Value::Integer(code), Value::String(message.to_owned()), value])
}

/// Body of an HTTP request.
fn read_request(stream: &mut TcpStream) -> io::Result<Vec<u8>> {
    let (mut request, mut chunk) = (Vec::new(), [0; 4096]);
    let too_long = || io::Error::new(ErrorKind::InvalidData, "too long");
    let mut begin = None;
    loop {
        let begin = match begin {
            Some(begin) => begin,
            None => match request.windows(4).position(|bytes| bytes == b"\r\n\r\n") {
                Some(end) => *begin.insert(end + 4),
                None => 0,
            },
        };
        if begin > 0 {
            let head = String::from_utf8_lossy(&request[..begin]).to_ascii_lowercase();
            let length = head.lines().find_map(|line| line.strip_prefix("content-length:")?.trim().parse().ok());
            let length: usize = length.ok_or_else(|| io::Error::new(ErrorKind::InvalidData, "no length"))?;
            if length > LONGEST {
                return Err(too_long());
            }
            if request.len() >= begin + length {
                request.truncate(begin + length);
                return Ok(request.split_off(begin));
            }
        }
        if request.len() > 2 * LONGEST {
            return Err(too_long());
        }
        match stream.read(&mut chunk)? {
            0 => return Err(ErrorKind::UnexpectedEof.into()),
            count => request.extend_from_slice(&chunk[..count]),
        }
    }
}

/// What the connections of a topic need.
struct Topic {
    kind: String,
    md5sum: String,
    definition: String,
    subscribers: Mutex<Vec<Arc<Subscriber>>>,
    /// Messages whose memory is used again once no subscriber needs them; none without subscribers.
    kept: Mutex<Vec<Arc<Vec<u8>>>>,
    closed: AtomicBool,
}

impl Topic {
    /// False when the topic has been withdrawn.
    fn admit(&self, subscriber: &Arc<Subscriber>) -> bool {
        let mut subscribers = self.subscribers.lock();
        if self.closed.load(Ordering::Acquire) {
            return false;
        }
        subscribers.push(Arc::clone(subscriber));
        true
    }

    fn dismiss(&self, subscriber: &Arc<Subscriber>) {
        let mut subscribers = self.subscribers.lock();
        subscribers.retain(|other| !Arc::ptr_eq(other, subscriber));
        if subscribers.is_empty() {
            self.kept.lock().clear();
        }
    }

    /// Memory for a message.
    fn memory(&self) -> Vec<u8> {
        let mut kept = self.kept.lock();
        let free = kept.iter().position(|message| Arc::strong_count(message) == 1);
        let mut memory = free.and_then(|free| Arc::into_inner(kept.swap_remove(free))).unwrap_or_default();
        memory.clear();
        memory
    }

    /// Leaves a message for all subscribers.
    fn post(&self, message: Vec<u8>) {
        let message = Arc::new(message);
        let subscribers = self.subscribers.lock();
        subscribers.iter().for_each(|subscriber| subscriber.post(&message));
        let mut kept = self.kept.lock();
        if !subscribers.is_empty() && kept.len() < KEPT {
            kept.push(message);
        }
    }

    fn close(&self) {
        let mut subscribers = self.subscribers.lock();
        self.closed.store(true, Ordering::Release);
        subscribers.drain(..).for_each(|subscriber| subscriber.end());
        self.kept.lock().clear();
    }
}

/// A connection to a subscriber.
struct Subscriber {
    name: String,
    place: Mutex<Waiting>,
    filled: Condvar,
    stream: TcpStream,
}

/// What waits for a subscriber.
#[derive(Default)]
struct Waiting {
    /// The newest message, until the thread takes it.
    next: Option<Arc<Vec<u8>>>,
    /// Since when the thread has been writing the same message.
    writing: Option<Instant>,
    end: bool,
}

impl Subscriber {
    fn post(&self, message: &Arc<Vec<u8>>) {
        let mut place = self.place.lock();
        place.next = Some(Arc::clone(message));
        drop(place);
        self.filled.notify_one();
    }

    fn end(&self) {
        self.place.lock().end = true;
        self.filled.notify_one();
        let _ = self.stream.shutdown(Shutdown::Both);
    }

    fn is_stalled(&self) -> bool {
        self.place.lock().writing.is_some_and(|since| since.elapsed() > STALLED)
    }

    /// Sends what is posted until the subscriber goes or the topic is withdrawn.
    fn serve(&self, stream: &mut TcpStream) -> io::Result<()> {
        stream.set_read_timeout(Some(Duration::from_millis(1)))?;
        loop {
            let message = {
                let mut place = self.place.lock();
                place.writing = None;
                loop {
                    if place.end {
                        return Ok(());
                    }
                    if let Some(message) = place.next.take() {
                        place.writing = Some(Instant::now());
                        break message;
                    }
                    if self.filled.wait_for(&mut place, GLANCE).timed_out() {
                        drop(place);
                        // Subscribers say nothing: whatever comes is dropped, and the end is seen without sending
                        // anything.
                        match stream.read(&mut [0; 64]) {
                            Ok(0) => return Ok(()),
                            Err(error) if !is_timeout(&error) => return Err(error),
                            _ => (),
                        }
                        place = self.place.lock();
                    }
                }
            };
            self.write(stream, &message)?;
        }
    }

    /// Writes all of it, however long the subscriber takes: one that is stopped in a debugger is not to be lost.
    fn write(&self, stream: &mut TcpStream, mut rest: &[u8]) -> io::Result<()> {
        while !rest.is_empty() {
            match stream.write(rest) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => rest = &rest[count..],
                Err(error) if is_timeout(&error) => {
                    if self.place.lock().end {
                        return Err(ErrorKind::ConnectionAborted.into());
                    }
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}

/// A topic of a [`SideNode`], for large messages: each subscriber gets the newest one when it is ready for one.
pub struct LargePublication {
    name: String,
    node: Arc<SideNode>,
    /// Shared by publications of the same name while they are announced.
    topic: Mutex<Arc<Topic>>,
    outgoing: Mutex<Outgoing>,
}

#[derive(Default)]
struct Outgoing {
    /// Name and address of the node while the topic is announced.
    node: Option<(String, String)>,
    /// Number of the next message.
    number: u32,
}

impl LargePublication {
    /// A topic for messages of type `M`.
    pub fn new<M: Message>(node: &Arc<SideNode>, name: String) -> Arc<Self> {
        let topic = Topic {
            kind: M::msg_type(),
            md5sum: M::md5sum(),
            definition: M::msg_definition(),
            subscribers: Mutex::default(),
            kept: Mutex::default(),
            // Opened by `announce`.
            closed: AtomicBool::new(true),
        };
        Arc::new(Self { name, node: Arc::clone(node), topic: Mutex::new(Arc::new(topic)), outgoing: Mutex::default() })
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
        self.topic().subscribers.lock().iter().any(|subscriber| !subscriber.is_stalled())
    }

    /// Makes a message and leaves it for all subscribers; never waits for one. `write` appends the message as it goes
    /// over the wire, without its length; it is told the number of the message, from 0, for the message's header.
    /// Nothing is made when nobody is connected.
    ///
    /// Messages of 4 GiB and more are not sent.
    pub fn send(&self, write: impl FnOnce(&mut Vec<u8>, u32)) {
        let topic = self.topic();
        if topic.subscribers.lock().is_empty() {
            return;
        }
        let mut outgoing = self.outgoing.lock();
        let mut message = topic.memory();
        message.extend([0; 4]);
        write(&mut message, outgoing.number);
        let Ok(length) = u32::try_from(message.len() - 4) else { return };
        message[..4].copy_from_slice(&length.to_le_bytes());
        outgoing.number = outgoing.number.wrapping_add(1);
        topic.post(message);
    }
}

impl LargePublication {
    /// Takes subscribers from now on; the type of the messages.
    fn serve(&self, open: &Open) -> String {
        let mut topics = open.topics.lock();
        let own = topics.entry(self.name.clone()).or_insert_with(|| self.topic());
        own.closed.store(false, Ordering::Release);
        *self.topic.lock() = Arc::clone(own);
        self.outgoing.lock().node = Some((open.name.clone(), open.uri.clone()));
        own.kind.clone()
    }
}

impl Announcement for LargePublication {
    fn registration(&self) -> Registration {
        let (node, uri) = self.outgoing.lock().node.clone().unwrap_or_default();
        Registration {
            topic: self.name.clone(),
            message_type: self.topic().kind.clone(),
            direction: Direction::PublishesAs { node, uri },
        }
    }

    fn announce(&self, ros: &Ros) -> Result<(), Error> {
        let open = self.node.open(ros)?;
        let kind = self.serve(&open);
        let text = |text: &str| Value::String(text.to_owned());
        let arguments = vec![text(&self.name), text(&kind), text(&open.uri)];
        open.master.call("registerPublisher", arguments).map_err(|error| error.to_string())?;
        Ok(())
    }

    fn withdraw(&self) {
        let node = self.outgoing.lock().node.take();
        self.topic().close();
        if let Some(open) = &*self.node.open.lock() {
            open.topics.lock().remove(&self.name);
        }
        if let Some((node, uri)) = node {
            let arguments = vec![Value::String(self.name.clone()), Value::String(uri)];
            // A master that is away has nothing to forget.
            let _ = self.node.master.called_by(&node).call("unregisterPublisher", arguments);
        }
        self.node.tidy();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rosrust::RosMsg;

    const NAME: &str = "/ambf/env/cameras/eye/ImageData";

    /// A type for the headers; its own bytes are never made.
    #[derive(Debug, Clone, Default, PartialEq)]
    struct Large;

    impl RosMsg for Large {
        fn encode<W: Write>(&self, _: W) -> io::Result<()> {
            Ok(())
        }

        fn decode<R: Read>(_: R) -> io::Result<Self> {
            Ok(Self)
        }
    }

    impl Message for Large {
        fn msg_definition() -> String {
            "uint8[] data".into()
        }

        fn md5sum() -> String {
            "0123".into()
        }

        fn msg_type() -> String {
            "test_msgs/Large".into()
        }
    }

    struct Fixture {
        open: Arc<Open>,
        publication: Arc<LargePublication>,
    }

    impl Fixture {
        fn new() -> Self {
            let node = SideNode::new(Peer::new("http://localhost:1/", "/node", GLANCE).unwrap(), "cameras");
            let open = node.open_beside("/node", "http://localhost:1/", "127.0.0.1", "localhost").unwrap();
            let publication = LargePublication::new::<Large>(&node, NAME.into());
            publication.serve(&open);
            Self { open, publication }
        }

        fn connect(&self, header: &[(&str, &str)]) -> (TcpStream, std::collections::HashMap<String, String>) {
            let mut stream = TcpStream::connect(("127.0.0.1", self.open.port)).unwrap();
            stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
            stream.write_all(&header_of(header)).unwrap();
            let answer = fields(&message(&mut stream));
            (stream, answer)
        }

        fn subscribe(&self) -> TcpStream {
            let before = self.count();
            let header = [("callerid", "/me"), ("topic", NAME), ("md5sum", "0123"), ("type", "test_msgs/Large")];
            let (stream, answer) = self.connect(&header);
            assert_eq!((answer["callerid"].as_str(), answer["md5sum"].as_str()), ("/node_cameras", "0123"));
            until("it is connected", || self.count() > before);
            stream
        }

        fn count(&self) -> usize {
            self.publication.topic().subscribers.lock().len()
        }

        fn send(&self, size: usize, byte: u8) {
            self.publication.send(|bytes, number| {
                bytes.extend(number.to_le_bytes());
                bytes.resize(bytes.len() + size, byte);
            });
        }
    }

    impl Drop for Fixture {
        fn drop(&mut self) {
            self.publication.withdraw();
        }
    }

    fn message(stream: &mut TcpStream) -> Vec<u8> {
        let mut length = [0; 4];
        stream.read_exact(&mut length).unwrap();
        let mut message = vec![0; u32::from_le_bytes(length) as usize];
        stream.read_exact(&mut message).unwrap();
        message
    }

    fn until(what: &str, condition: impl Fn() -> bool) {
        let deadline = Instant::now() + Duration::from_secs(20);
        while !condition() {
            assert!(Instant::now() < deadline, "waited in vain: {what}");
            thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn messages_come_whole_and_numbered() {
        let fixture = Fixture::new();
        assert!(!fixture.publication.is_wanted());
        fixture.publication.send(|_, _| panic!("nobody is there"));
        let mut stream = fixture.subscribe();
        assert!(fixture.publication.is_wanted());
        for number in 0..20_u8 {
            fixture.send(100_000, number);
            let message = message(&mut stream);
            assert_eq!((message.len(), message[0], message[100_000]), (100_004, number, number));
        }
    }

    /// One reads nothing, one reads everything at once: the second gets every message, the first the newest when it
    /// reads again.
    #[test]
    fn one_who_does_not_read_delays_nobody_and_misses_the_old() {
        let fixture = Fixture::new();
        let (mut idle, mut busy) = (fixture.subscribe(), fixture.subscribe());
        const SIZE: usize = 10 << 20;
        for number in 0..30 {
            let begin = Instant::now();
            fixture.send(SIZE, number);
            assert!(begin.elapsed() < Duration::from_secs(20), "sending never waits");
            assert_eq!(message(&mut busy)[SIZE], number);
        }
        let kept = fixture.publication.topic().kept.lock().len();
        assert!(kept <= KEPT, "{kept}");
        assert_eq!(message(&mut idle)[SIZE], 0, "the one that was under way");
        assert_eq!(message(&mut idle)[SIZE], 29, "then the newest");
    }

    #[test]
    fn one_who_stalls_is_not_worth_a_message_but_is_kept() {
        let fixture = Fixture::new();
        let mut idle = fixture.subscribe();
        fixture.send(10 << 20, 1);
        until("it counts as stalled", || !fixture.publication.is_wanted());
        assert_eq!(message(&mut idle).len(), (10 << 20) + 4);
        until("it is wanted again", || fixture.publication.is_wanted());
    }

    #[test]
    fn who_goes_is_forgotten_without_a_message() {
        let fixture = Fixture::new();
        let mut stream = fixture.subscribe();
        fixture.send(10, 0);
        message(&mut stream);
        drop(stream);
        until("it is forgotten", || fixture.count() == 0);
        assert!(fixture.publication.topic().kept.lock().is_empty(), "without subscribers there are no messages");
    }

    #[test]
    fn who_wants_something_else_is_told_so() {
        let fixture = Fixture::new();
        for (key, value) in [("topic", "/other"), ("md5sum", "4567"), ("type", "test_msgs/Small")] {
            let mut header =
                vec![("callerid", "/me"), ("topic", NAME), ("md5sum", "0123"), ("type", "test_msgs/Large")];
            header.iter_mut().find(|field| field.0 == key).unwrap().1 = value;
            assert!(fixture.connect(&header).1.contains_key("error"), "{key}");
        }
        let any = [("callerid", "/me"), ("topic", NAME), ("md5sum", "*"), ("type", "*")];
        assert_eq!(fixture.connect(&any).1["type"], "test_msgs/Large");
        assert!(fixture.count() <= 1);
    }

    #[test]
    fn calls_are_answered() {
        let fixture = Fixture::new();
        let peer = Peer::new(&fixture.open.uri, "/me", Duration::from_secs(20)).unwrap();
        let text = |text: &str| Value::String(text.to_owned());
        let protocols = Value::Array(vec![Value::Array(vec![text("TCPROS")])]);
        let how = peer.call("requestTopic", vec![text(NAME), protocols.clone()]).unwrap();
        let port = i32::from(fixture.open.port);
        assert_eq!(how, Value::Array(vec![text("TCPROS"), text("localhost"), Value::Integer(port)]));
        assert!(peer.call("requestTopic", vec![text("/other"), protocols]).unwrap_err().is_refusal());
        assert_eq!(peer.call("getPid", vec![]).unwrap(), Value::Integer(std::process::id() as i32));
        let _stream = fixture.subscribe();
        let Value::Array(rows) = peer.call("getBusInfo", vec![]).unwrap() else { panic!("a list") };
        let Value::Array(row) = &rows[0] else { panic!("a list") };
        assert_eq!((&row[1], &row[4]), (&text("/me"), &text(NAME)));
        assert!(peer.call("sing", vec![]).unwrap_err().is_refusal());
    }

    #[test]
    fn bytes_that_are_no_call_and_no_header_harm_nobody() {
        let fixture = Fixture::new();
        for port in [fixture.open.port, fixture.open.calls] {
            for bytes in [&b"\xff\xff\xff\xff"[..], b"GET / HTTP/1.0\r\n\r\n", b"content-length: 99999999999\r\n\r\n"] {
                let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
                stream.write_all(bytes).unwrap();
                let _ = stream.shutdown(Shutdown::Write);
                let _ = stream.read_to_end(&mut Vec::new());
            }
        }
        let mut stream = fixture.subscribe();
        fixture.send(10, 7);
        assert_eq!(message(&mut stream)[5], 7);
    }

    #[test]
    fn publications_of_one_name_share_their_subscribers_until_one_is_withdrawn() {
        let fixture = Fixture::new();
        let mut stream = fixture.subscribe();
        let other = LargePublication::new::<Large>(&fixture.publication.node, NAME.into());
        other.serve(&fixture.open);
        other.send(|bytes, _| bytes.push(5));
        assert_eq!(message(&mut stream), [5]);
        other.withdraw();
        assert!(matches!(stream.read(&mut [0]), Ok(0) | Err(_)));
    }
}
