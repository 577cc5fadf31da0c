//! What the node serves: its sockets, and the calls of other nodes.
//!
//! Two sockets listen: one for the subscribers of all topics and the clients of all services, one for calls. All of it
//! is served by one thread, `ros-io`; large messages have a second one, `ros-large`, that is there when there are any.
//!
//! ## Who gets in
//! If the master is on this machine under a loopback address, and neither `ROS_IP` nor `ROS_HOSTNAME` says otherwise,
//! both sockets are bound to loopback, and publishers of other machines are not listened to. What a `publisherUpdate`
//! says is never believed: the master itself is asked. `shutdown` is obeyed only if it comes from the master's machine
//! or this one. The numbers of connections are bounded, and the lengths of what comes.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream, ToSocketAddrs, UdpSocket};
use std::os::fd::{AsRawFd, RawFd};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use dxr::Value;
use parking_lot::Mutex;

use super::announcement::{Endpoint, Serves};
use super::calls::{answer, text, text_at, Client, Methods};
use super::connections::{listen, Buffer, Came, Count, Listener, Place};
use super::reactor::{Handler, Reactor, Turn};
use super::service::Desk;
use super::stop::Stop;
use super::subscriber::Subscription;
use super::tcpros::{fields, header_of, quote};
use super::topic::{set_options, Topic, Traffic};
use super::xmlrpc::Peer;
use super::Report;

/// How long a client may take for its header.
const HEADER_TIMEOUT: Duration = Duration::from_secs(5);

/// Longest header of a client, bytes: the definition of a message is in it.
const MAX_HEADER: usize = 1 << 20;

/// How many connections to topics and services there may be at once; further ones are turned away.
const MAX_CONNECTIONS: usize = 8192;

/// How many clients may be about to say what they want.
const MAX_GREETING: usize = 512;

/// How many connections there may be for calls.
const MAX_CALLERS: usize = 256;

/// How many different refusals are told apart, so that each is said once.
const MAX_REFUSALS: usize = 256;

/// What the node serves.
pub(crate) struct Graph {
    /// Full name of the node.
    pub name: String,
    /// Name or address of this machine for others.
    host: String,
    /// Address of its calls.
    pub uri: String,
    /// Port of its topics and services.
    port: u16,
    /// Only programs of this machine get in.
    pub is_local: bool,
    master: Peer,
    pub report: Report,
    topics: Mutex<BTreeMap<String, Shared>>,
    subscriptions: Mutex<Vec<Arc<Subscription>>>,
    services: Mutex<BTreeMap<String, Arc<Desk>>>,
    io: Mutex<Option<Reactor>>,
    large: Mutex<Option<Reactor>>,
    /// Nudged when publishers may have changed; stopped with the node.
    pub changed: Stop,
    dismissed: AtomicBool,
    /// What has been said of clients that were refused.
    refusals: Mutex<BTreeSet<String>>,
    greeting: Count,
}

/// A topic and how many publications have it.
struct Shared {
    topic: Arc<Topic>,
    users: usize,
}

impl Graph {
    /// A node called `name` that serves nothing yet.
    ///
    /// # Errors
    /// When there are no sockets or no thread to be had.
    pub fn start(name: String, master: &Peer, report: Report) -> io::Result<Arc<Self>> {
        let (bind, host, is_local) = whereabouts(master);
        let (messages, calls) = (listen(bind, 0)?, listen(bind, 0)?);
        let graph = Arc::new(Self {
            uri: format!("http://{host}:{}/", calls.local_addr()?.port()),
            port: messages.local_addr()?.port(),
            master: master.called_by(&name),
            name,
            host,
            is_local,
            report,
            topics: Mutex::default(),
            subscriptions: Mutex::default(),
            services: Mutex::default(),
            io: Mutex::new(Some(Reactor::start("ros-io")?)),
            large: Mutex::default(),
            changed: Stop::default(),
            dismissed: AtomicBool::new(false),
            refusals: Mutex::default(),
            greeting: Count::default(),
        });
        graph.serve_messages(messages);
        graph.serve_calls(calls);
        Ok(graph)
    }

    fn serve_messages(self: &Arc<Self>, listener: TcpListener) {
        let graph = Arc::downgrade(self);
        let greet = move |stream: TcpStream, place| {
            let Some(graph) = graph.upgrade() else { return };
            if let Some(greeting) = graph.greeting.place(MAX_GREETING) {
                let own = Arc::downgrade(&graph);
                let deadline = Instant::now() + HEADER_TIMEOUT;
                let input = Buffer::default();
                let hello =
                    Hello { stream: Arc::new(stream), input, graph: own, deadline, place: Some(place), greeting };
                graph.serve(Box::new(hello), false);
            }
        };
        self.serve(Box::new(Listener { listener, count: Count::default(), most: MAX_CONNECTIONS, greet }), false);
    }

    fn serve_calls(self: &Arc<Self>, listener: TcpListener) {
        let graph = Arc::downgrade(self);
        let greet = move |stream, place| {
            let Some(graph) = graph.upgrade() else { return };
            let methods: Arc<dyn Methods> = Arc::new(Calls(Arc::downgrade(&graph)));
            graph.serve(Box::new(Client::new(stream, methods, place)), false);
        };
        self.serve(Box::new(Listener { listener, count: Count::default(), most: MAX_CALLERS, greet }), false);
    }

    /// Serves `handler` in the node's thread, or in that of large messages, which is started if need be.
    pub fn serve(&self, handler: Box<dyn Handler>, large: bool) {
        if large {
            let mut reactor = self.large.lock();
            if reactor.is_none() && !self.changed.is_stopped() {
                // Without a second thread the first has to do.
                *reactor = Reactor::start("ros-large").ok();
            }
            if let Some(reactor) = &*reactor {
                return reactor.desk().add(handler);
            }
        }
        if let Some(reactor) = &*self.io.lock() {
            reactor.desk().add(handler);
        }
    }

    /// Ends all connections and threads. Not to be called in one of its threads.
    pub fn stop(&self) {
        self.changed.stop();
        for reactor in [&self.io, &self.large] {
            let reactor = reactor.lock().take();
            drop(reactor);
        }
    }

    /// The master, called in the node's name.
    pub fn master(&self) -> Peer {
        self.master.clone()
    }

    /// Whether somebody told the node to shut down.
    pub fn is_dismissed(&self) -> bool {
        self.dismissed.load(Ordering::Acquire)
    }

    /// `rosrpc://HOST:PORT`: where services are to be had.
    pub fn service_uri(&self) -> String {
        format!("rosrpc://{}:{}", self.host, self.port)
    }

    /// What is listened to.
    pub fn subscriptions(&self) -> Vec<Arc<Subscription>> {
        self.subscriptions.lock().clone()
    }

    /// Serves `endpoint` from now on; what serves in its place if another publication has the topic already.
    ///
    /// # Errors
    /// A sentence when another publication has the topic with another type.
    pub fn open(&self, endpoint: &Endpoint) -> Result<Option<Endpoint>, String> {
        match &endpoint.0 {
            Serves::Topic(topic) => {
                let mut topics = self.topics.lock();
                if let Some(shared) = topics.get_mut(&topic.name) {
                    if shared.topic.kind != topic.kind || shared.topic.traffic != topic.traffic {
                        let (own, other) = (&topic.kind.name, &shared.topic.kind.name);
                        return Err(format!("this node publishes it as {other} already, not as {own}"));
                    }
                    shared.users += 1;
                    return Ok(Some(Endpoint::topic(Arc::clone(&shared.topic))));
                }
                topic.open();
                topics.insert(topic.name.clone(), Shared { topic: Arc::clone(topic), users: 1 });
            }
            Serves::Subscription(subscription) => {
                subscription.open();
                self.subscriptions.lock().push(Arc::clone(subscription));
            }
            Serves::Service(desk) => {
                let mut services = self.services.lock();
                if services.contains_key(&desk.name) {
                    return Err("this node serves it already".into());
                }
                desk.open();
                services.insert(desk.name.clone(), Arc::clone(desk));
            }
        }
        Ok(None)
    }

    /// Serves `endpoint` no longer; whether nothing else of the node needs its registration.
    pub fn close(&self, endpoint: &Endpoint) -> bool {
        match &endpoint.0 {
            Serves::Topic(topic) => {
                let mut topics = self.topics.lock();
                let Some(shared) = topics.get_mut(&topic.name).filter(|shared| Arc::ptr_eq(&shared.topic, topic))
                else {
                    return false;
                };
                shared.users -= 1;
                if shared.users > 0 {
                    return false;
                }
                topics.remove(&topic.name);
                topic.close();
                true
            }
            Serves::Subscription(subscription) => {
                let mut subscriptions = self.subscriptions.lock();
                subscriptions.retain(|other| !Arc::ptr_eq(other, subscription));
                subscription.close();
                !subscriptions.iter().any(|other| other.topic == subscription.topic)
            }
            Serves::Service(desk) => {
                let removed = self.services.lock().remove(&desk.name).is_some();
                desk.close();
                removed
            }
        }
    }

    /// Gives a client what its header asks for; the header to refuse it with.
    fn admit(self: &Arc<Self>, header: &[u8], stream: &Arc<TcpStream>, place: Place) -> Result<(), Vec<u8>> {
        let fields = fields(header);
        let field = |key: &str| fields.get(key).map(String::as_str).unwrap_or_default();
        let refuse = |why: String| {
            self.report_refusal(field("callerid"), &why);
            Err(header_of(&[("error", &why)]))
        };
        if fields.contains_key("service") {
            let desk = self.services.lock().get(field("service")).cloned();
            let Some(desk) = desk else {
                return refuse(format!("{} does not serve {}", self.name, quote(field("service"))));
            };
            desk.admit(fields, Arc::clone(stream), self.name.clone(), place);
            return Ok(());
        }
        let topic = self.topics.lock().get(field("topic")).map(|shared| Arc::clone(&shared.topic));
        let Some(topic) = topic else {
            return Err(header_of(&[("error", &format!("{} does not publish {}", self.name, quote(field("topic"))))]));
        };
        let differs = |key: &str, own: &str| !["*", own].contains(&field(key));
        if differs("md5sum", &topic.kind.md5sum) || differs("type", &topic.kind.name) {
            return refuse(format!(
                "the type of {} is mismatched: it is {} with the checksum {}, the client's is {} with {}: a client with another \
                 version of the message",
                topic.name,
                topic.kind.name,
                topic.kind.md5sum,
                quote(field("type")),
                quote(field("md5sum")),
            ));
        }
        let header = header_of(&[
            ("callerid", &self.name),
            ("latching", if topic.latched { "1" } else { "0" }),
            ("md5sum", &topic.kind.md5sum),
            ("message_definition", &topic.kind.definition),
            ("topic", &topic.name),
            ("type", &topic.kind.name),
        ]);
        let large = topic.traffic == Traffic::Pictures;
        if set_options(stream).is_ok() {
            let caller = field("callerid").to_owned();
            if let Some(serving) = topic.admit(caller, Arc::clone(stream), header, place) {
                self.serve(Box::new(serving), large);
            }
        }
        Ok(())
    }

    /// Says once to the user that a client was refused.
    fn report_refusal(&self, client: &str, why: &str) {
        let line = format!("{} was refused: {why}", quote(client));
        let mut refusals = self.refusals.lock();
        if refusals.len() >= MAX_REFUSALS {
            refusals.clear();
        }
        if refusals.insert(line.clone()) {
            drop(refusals);
            (self.report)(format_args!("ROS: {line}"));
        }
    }

    /// Whether a call from the machine `from` may change the node.
    fn is_trusted(&self, from: IpAddr) -> bool {
        let is_here = from.is_loopback() || TcpListener::bind((from, 0)).is_ok();
        is_here || self.master.addresses().is_ok_and(|all| all.iter().any(|address| address.ip() == from))
    }

    /// `[number, name, direction, "TCPROS", topic, connected]` of each connection.
    fn bus(&self) -> Vec<Value> {
        let mut rows = Vec::new();
        let mut row = |other: &str, direction: &str, topic: &str| {
            let number = Value::Integer(rows.len() as i32);
            let connected = Value::Boolean(true);
            rows.push(Value::Array(vec![number, text(other), text(direction), text("TCPROS"), text(topic), connected]));
        };
        for (name, shared) in &*self.topics.lock() {
            shared.topic.subscriber_names().iter().for_each(|other| row(other, "o", name));
        }
        for subscription in &*self.subscriptions.lock() {
            subscription.publisher_names().iter().for_each(|other| row(other, "i", &subscription.topic));
        }
        rows
    }
}

/// The calls of other nodes and of the master (the slave API of ROS 1).
struct Calls(Weak<Graph>);

impl Methods for Calls {
    fn call(&self, method: &str, arguments: &[Value], from: IpAddr) -> Value {
        let Some(graph) = self.0.upgrade() else { return answer(-1, "the node has ended", Value::Integer(0)) };
        let list = |names: Vec<(String, String)>| {
            Value::Array(names.iter().map(|(name, kind)| Value::Array(vec![text(name), text(kind)])).collect())
        };
        match method {
            "requestTopic" => {
                let name = text_at(arguments, 1);
                if !graph.topics.lock().contains_key(name) {
                    return answer(-1, &format!("{} does not publish {}", graph.name, quote(name)), Value::Integer(0));
                }
                let how = vec![text("TCPROS"), text(&graph.host), Value::Integer(i32::from(graph.port))];
                answer(1, "ready", Value::Array(how))
            }
            "publisherUpdate" => {
                // The master is asked what it says: this may come from anybody.
                graph.changed.nudge();
                answer(1, "", Value::Integer(0))
            }
            "paramUpdate" => answer(1, "", Value::Integer(0)),
            "shutdown" if !graph.is_trusted(from) => answer(-1, "not from this machine", Value::Integer(0)),
            "shutdown" => {
                graph.dismissed.store(true, Ordering::Release);
                answer(1, "", Value::Integer(0))
            }
            "getPid" => answer(1, "", Value::Integer(std::process::id() as i32)),
            "getName" => answer(1, "", text(&graph.name)),
            "getUri" => answer(1, "", text(&graph.uri)),
            "getMasterUri" => answer(1, "", text(graph.master.uri())),
            "getBusStats" => answer(1, "", Value::Array(vec![Value::Array(Vec::new()); 3])),
            "getBusInfo" => answer(1, "", Value::Array(graph.bus())),
            "getPublications" => {
                let topics = graph.topics.lock();
                let kind = |shared: &Shared| shared.topic.kind.name.clone();
                answer(1, "", list(topics.iter().map(|(name, shared)| (name.clone(), kind(shared))).collect()))
            }
            "getSubscriptions" => {
                let subscriptions = graph.subscriptions.lock();
                answer(
                    1,
                    "",
                    list(subscriptions.iter().map(|one| (one.topic.clone(), one.kind().to_owned())).collect()),
                )
            }
            other => answer(-1, &format!("there is no method {}", quote(other)), Value::Integer(0)),
        }
    }
}

/// A client that has not said yet what it wants.
struct Hello {
    stream: Arc<TcpStream>,
    input: Buffer,
    graph: Weak<Graph>,
    deadline: Instant,
    place: Option<Place>,
    #[expect(dead_code, reason = "counts while it lives")]
    greeting: Place,
}

impl Handler for Hello {
    fn socket(&self) -> RawFd {
        self.stream.as_raw_fd()
    }

    fn ready(&mut self) -> Turn {
        let came = self.input.read(&self.stream);
        match (self.input.block(MAX_HEADER), came) {
            (Ok(None), Came::Bytes(_)) => return Turn::Again,
            (Ok(None), Came::Nothing) => return Turn::Wait,
            (Ok(Some(header)), _) => {
                if let (Some(graph), Some(place)) = (self.graph.upgrade(), self.place.take()) {
                    if let Err(refusal) = graph.admit(header, &self.stream, place) {
                        let _ = (&*self.stream).write_all(&refusal);
                    }
                }
            }
            (Ok(None), Came::End) | (Err(_), _) => (),
        }
        Turn::Done
    }

    fn deadline(&self) -> Option<Instant> {
        Some(self.deadline)
    }
}

/// Where a node of this master listens, under which name others reach it, and whether only programs of this machine do.
fn whereabouts(master: &Peer) -> (IpAddr, String, bool) {
    let set = |key: &str| std::env::var(key).ok().filter(|value| !value.is_empty());
    place_of(set("ROS_HOSTNAME").or_else(|| set("ROS_IP")), master)
}

fn place_of(given: Option<String>, master: &Peer) -> (IpAddr, String, bool) {
    let (loopback, any) = (IpAddr::from(Ipv4Addr::LOCALHOST), IpAddr::from(Ipv4Addr::UNSPECIFIED));
    if let Some(host) = given {
        let is_v6 = host.parse::<IpAddr>().is_ok_and(|ip| ip.is_ipv6());
        let is_local = host == "localhost"
            || (host.as_str(), 0).to_socket_addrs().is_ok_and(|mut all| all.all(|a| a.ip().is_loopback()));
        return match (is_v6, is_local) {
            (true, true) => (Ipv6Addr::LOCALHOST.into(), format!("[{host}]"), true),
            (true, false) => (Ipv6Addr::UNSPECIFIED.into(), format!("[{host}]"), false),
            (false, true) => (loopback, host, true),
            (false, false) => (any, host, false),
        };
    }
    match master.addresses() {
        Ok(addresses) if addresses.iter().all(|address| address.ip().is_loopback()) => {
            (loopback, loopback.to_string(), true)
        }
        addresses => (any, own_host(&addresses.unwrap_or_default()), false),
    }
}

/// A name or address of this machine for programs of other machines: its host name if that stands for one of its
/// addresses in the network, otherwise the address from which the master is reached.
fn own_host(master: &[SocketAddr]) -> String {
    let name = rustix::system::uname().nodename().to_string_lossy().into_owned();
    let is_known = (name.as_str(), 0).to_socket_addrs().is_ok_and(|mut all| all.any(|a| !a.ip().is_loopback()));
    if is_known {
        return name;
    }
    // Nothing is sent: connecting a datagram socket chooses its address.
    let reached = master.iter().find_map(|address| {
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).ok()?;
        socket.connect(address).ok()?;
        Some(socket.local_addr().ok()?.ip().to_string())
    });
    reached.unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(given: Option<&str>, master: &str) -> (String, String, bool) {
        let master = Peer::new(master, "/test", Duration::from_secs(1)).unwrap();
        let (bind, host, is_local) = place_of(given.map(str::to_owned), &master);
        (bind.to_string(), host, is_local)
    }

    #[test]
    fn a_master_of_this_machine_keeps_everything_on_loopback_unless_the_user_names_an_address() {
        let local = ("127.0.0.1".to_owned(), "127.0.0.1".to_owned(), true);
        assert_eq!(place(None, "http://localhost:11311/"), local);
        assert_eq!(place(None, "http://127.0.1.1:11311/"), local);
        let master = "http://localhost:11311/";
        assert_eq!(place(Some("localhost"), master), ("127.0.0.1".into(), "localhost".into(), true));
        assert_eq!(place(Some("192.0.2.7"), master), ("0.0.0.0".into(), "192.0.2.7".into(), false));
        assert_eq!(place(Some("2001:db8::7"), master), ("::".into(), "[2001:db8::7]".into(), false));
        assert_eq!(place(Some("::1"), master), ("::1".into(), "[::1]".into(), true));
    }

    #[test]
    fn with_a_master_elsewhere_others_are_told_an_address_that_they_can_reach() {
        let (bind, host, is_local) = place(None, "http://192.0.2.1:11311/");
        assert_eq!((bind.as_str(), is_local), ("0.0.0.0", false));
        assert!(!host.is_empty() && host != "localhost" && !host.starts_with("127."), "{host}");
    }
}
