//! A ROS master of our own, for when nobody else runs one: names of nodes, topics and services, and parameters.
//!
//! It is what nodes and ROS's own programs expect of `rosmaster`: the same calls, answers and notices to nodes.
//! It has no `/rosout_agg`; a [`LogAggregator`](super::log::LogAggregator) beside it makes that.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::time::Duration;

use dxr::Value;
use parking_lot::Mutex;

use super::calls::{answer, text, text_at, Client, Methods};
use super::connections::{listen, Count, Listener};
use super::parameters::{parent_of, resolve, Tree};
use super::reactor::Reactor;
use super::xmlrpc::Peer;

/// How many connections there may be; further ones are turned away.
const MAX_CALLERS: usize = 1024;

/// How long a node may take to be told something.
const TIMEOUT: Duration = Duration::from_secs(1);

/// How many nodes are told something at the same time.
const MAX_NOTICES: usize = 32;

/// A ROS master in this process. It lives until it is dropped.
pub struct Master {
    _reactor: Reactor,
}

impl Master {
    /// Serves on `address`.
    ///
    /// # Errors
    /// When the port is taken or no thread can be made.
    pub fn start(address: SocketAddr) -> io::Result<Self> {
        let listener = listen(address.ip(), address.port())?;
        let host = if address.ip().is_unspecified() { "localhost".into() } else { address.ip().to_string() };
        let uri = format!("http://{host}:{}/", address.port());
        let registry = Arc::new(Registry { uri, state: Mutex::default(), notices: Arc::default() });
        registry.state.lock().parameters.set("/rosdistro", text("noetic\n"));
        registry.state.lock().parameters.set("/rosversion", text("1.16.0\n"));
        let reactor = Reactor::start("ros-master")?;
        let desk = Arc::downgrade(reactor.desk());
        let greet = move |stream, place| {
            if let Some(desk) = desk.upgrade() {
                desk.add(Box::new(Client::new(stream, Arc::clone(&registry) as Arc<dyn Methods>, place)));
            }
        };
        let listener = Listener { listener, count: Count::default(), most: MAX_CALLERS, greet };
        reactor.desk().add(Box::new(listener));
        Ok(Self { _reactor: reactor })
    }
}

/// Where a master for `peer` has to listen so that `peer` reaches it: on loopback for a loopback address, on all
/// interfaces for another address of this machine; `None` when the address is that of another machine.
pub fn local_address(peer: &Peer) -> Option<SocketAddr> {
    let addresses = peer.addresses().ok()?;
    let v4 = addresses.iter().find(|address| address.is_ipv4());
    let address = *v4.or(addresses.first())?;
    if address.ip().is_loopback() {
        return Some(address);
    }
    // Only an address of this machine can be bound.
    TcpListener::bind((address.ip(), 0)).ok()?;
    let any: IpAddr = if address.is_ipv4() { Ipv4Addr::UNSPECIFIED.into() } else { Ipv6Addr::UNSPECIFIED.into() };
    Some(SocketAddr::new(any, address.port()))
}

/// Who is registered for something: name and address of each node, in the order in which they came.
type Users = Vec<(String, String)>;

#[derive(Default)]
struct State {
    /// Address of each node that has registered anything.
    nodes: BTreeMap<String, String>,
    publishers: BTreeMap<String, Users>,
    subscribers: BTreeMap<String, Users>,
    /// Node and address of each service.
    services: BTreeMap<String, (String, String)>,
    /// Type of each topic that ever had one.
    types: BTreeMap<String, String>,
    parameters: Tree,
    /// Nodes that are told when a parameter or one below it changes.
    parameter_subscribers: BTreeMap<String, Users>,
}

/// What the master knows.
struct Registry {
    uri: String,
    state: Mutex<State>,
    notices: Arc<Notices>,
}

/// Adds a user, or moves it to its new address.
fn enter(users: &mut Users, node: &str, uri: &str) {
    match users.iter_mut().find(|(name, _)| name == node) {
        Some(user) => user.1 = uri.to_owned(),
        None => users.push((node.to_owned(), uri.to_owned())),
    }
}

/// Takes `node` at `uri` out of the users of `name`; whether it was one.
fn leave(lists: &mut BTreeMap<String, Users>, name: &str, node: &str, uri: &str) -> bool {
    let Some(users) = lists.get_mut(name) else { return false };
    let before = users.len();
    users.retain(|(name, address)| name != node || address != uri);
    let left = users.len() < before;
    if users.is_empty() {
        lists.remove(name);
    }
    left
}

fn uris(users: Option<&Users>) -> Value {
    Value::Array(users.into_iter().flatten().map(|(_, uri)| text(uri)).collect())
}

impl State {
    /// Enters the address of a node. One that was known at another address has been replaced: it loses what it had.
    /// Returns its old address.
    fn know(&mut self, node: &str, uri: &str) -> Option<String> {
        let before = self.nodes.insert(node.to_owned(), uri.to_owned()).filter(|before| before != uri)?;
        for lists in [&mut self.publishers, &mut self.subscribers, &mut self.parameter_subscribers] {
            lists.values_mut().for_each(|users| users.retain(|(name, _)| name != node));
            lists.retain(|_, users| !users.is_empty());
        }
        self.services.retain(|_, (owner, _)| owner != node);
        Some(before)
    }

    /// Forgets a node that has nothing registered any more.
    fn tidy(&mut self, node: &str) {
        let has = |lists: &BTreeMap<String, Users>| lists.values().flatten().any(|(name, _)| name == node);
        let is_used = has(&self.publishers)
            || has(&self.subscribers)
            || has(&self.parameter_subscribers)
            || self.services.values().any(|(owner, _)| owner == node);
        if !is_used {
            self.nodes.remove(node);
        }
    }

    /// Publishers, subscribers and services, each a list of names with lists of nodes.
    fn system_state(&self) -> Value {
        let list = |lists: &BTreeMap<String, Users>| {
            let names = |users: &Users| Value::Array(users.iter().map(|(name, _)| text(name)).collect());
            Value::Array(lists.iter().map(|(name, users)| Value::Array(vec![text(name), names(users)])).collect())
        };
        let services = self.services.iter();
        let services =
            services.map(|(name, (owner, _))| Value::Array(vec![text(name), Value::Array(vec![text(owner)])]));
        Value::Array(vec![list(&self.publishers), list(&self.subscribers), Value::Array(services.collect())])
    }
}

impl Registry {
    fn register(&self, caller: &str, method: &str, arguments: &[Value]) -> Value {
        let name = resolve(text_at(arguments, 1), caller);
        let (second, uri) = (text_at(arguments, 2), text_at(arguments, 3));
        if uri.is_empty() || name == "/" {
            return answer(-1, "expected a name, a type or address, and the address of the node", Value::Integer(0));
        }
        let mut state = self.state.lock();
        if let Some(before) = state.know(caller, uri) {
            self.notices.shut_down(&before, caller);
        }
        match method {
            "registerService" => {
                state.services.insert(name.clone(), (caller.to_owned(), second.to_owned()));
                answer(1, &format!("{caller} serves {name}"), Value::Integer(1))
            }
            "registerPublisher" => {
                if second != "*" || !state.types.contains_key(&name) {
                    state.types.insert(name.clone(), second.to_owned());
                }
                enter(state.publishers.entry(name.clone()).or_default(), caller, uri);
                self.tell_subscribers(&state, &name);
                answer(1, &format!("{caller} publishes {name}"), uris(state.subscribers.get(&name)))
            }
            _ => {
                if second != "*" && !state.types.contains_key(&name) {
                    state.types.insert(name.clone(), second.to_owned());
                }
                enter(state.subscribers.entry(name.clone()).or_default(), caller, uri);
                answer(1, &format!("{caller} subscribes to {name}"), uris(state.publishers.get(&name)))
            }
        }
    }

    fn unregister(&self, caller: &str, method: &str, arguments: &[Value]) -> Value {
        let (name, uri) = (resolve(text_at(arguments, 1), caller), text_at(arguments, 2));
        let mut state = self.state.lock();
        let left = match method {
            "unregisterService" => {
                let is_own = state.services.get(&name).is_some_and(|(owner, api)| owner == caller && api == uri);
                is_own && state.services.remove(&name).is_some()
            }
            "unregisterPublisher" => {
                let left = leave(&mut state.publishers, &name, caller, uri);
                if left {
                    self.tell_subscribers(&state, &name);
                }
                left
            }
            _ => leave(&mut state.subscribers, &name, caller, uri),
        };
        state.tidy(caller);
        let what = if left { "is unregistered" } else { "was not registered" };
        answer(1, &format!("{caller} {what}: {name}"), Value::Integer(i32::from(left)))
    }

    /// Tells the subscribers of `topic` who publishes it now.
    fn tell_subscribers(&self, state: &State, topic: &str) {
        let publishers = uris(state.publishers.get(topic));
        for (_, uri) in state.subscribers.get(topic).into_iter().flatten() {
            self.notices.tell(uri, Notice::Publishers, topic, publishers.clone());
        }
    }

    /// Tells who follows a parameter that it, one above it or one below it has changed.
    fn tell_parameter(&self, state: &State, key: &str) {
        let is_at_or_below = |key: &str, of: &str| key == of || of == "/" || key.starts_with(&format!("{of}/"));
        for (followed, users) in &state.parameter_subscribers {
            let changed = if is_at_or_below(key, followed) {
                key
            } else if is_at_or_below(followed, key) {
                followed
            } else {
                continue;
            };
            let value = state.parameters.get(changed).unwrap_or_else(|| Value::Struct(BTreeMap::new()));
            for (_, uri) in users {
                self.notices.tell(uri, Notice::Parameter, changed, value.clone());
            }
        }
    }

    fn parameter(&self, caller: &str, method: &str, arguments: &[Value]) -> Value {
        let key = resolve(
            text_at(arguments, if method == "subscribeParam" || method == "unsubscribeParam" { 2 } else { 1 }),
            caller,
        );
        let mut state = self.state.lock();
        let unknown = |value| answer(-1, &format!("the parameter {key} is not set"), value);
        match method {
            "getParam" => match state.parameters.get(&key) {
                Some(value) => answer(1, &format!("parameter {key}"), value),
                None => unknown(Value::Integer(0)),
            },
            "hasParam" => answer(1, &key, Value::Boolean(state.parameters.get(&key).is_some())),
            "setParam" => {
                let Some(value) = arguments.get(2) else { return answer(-1, "expected a value", Value::Integer(0)) };
                if !state.parameters.set(&key, value.clone()) {
                    return answer(
                        -1,
                        "the root can be set to a structure only, and a name has 32 parts at most",
                        Value::Integer(0),
                    );
                }
                self.tell_parameter(&state, &key);
                answer(1, &format!("parameter {key} set"), Value::Integer(0))
            }
            "deleteParam" => {
                if !state.parameters.remove(&key) {
                    return unknown(Value::Integer(0));
                }
                self.tell_parameter(&state, &key);
                answer(1, &format!("parameter {key} deleted"), Value::Integer(0))
            }
            "subscribeParam" => {
                let uri = text_at(arguments, 1);
                if let Some(before) = state.know(caller, uri) {
                    self.notices.shut_down(&before, caller);
                }
                enter(state.parameter_subscribers.entry(key.clone()).or_default(), caller, uri);
                let value = state.parameters.get(&key).unwrap_or_else(|| Value::Struct(BTreeMap::new()));
                answer(1, &format!("{caller} follows {key}"), value)
            }
            _ => {
                let left = leave(&mut state.parameter_subscribers, &key, caller, text_at(arguments, 1));
                state.tidy(caller);
                answer(1, "", Value::Integer(i32::from(left)))
            }
        }
    }

    /// The name of the parameter `key` in the namespace of the caller or the nearest one above it.
    fn search(&self, caller: &str, key: &str) -> Value {
        let parameters = &self.state.lock().parameters;
        let not_found = || answer(-1, &format!("no parameter {key} is found"), Value::Integer(0));
        if key.starts_with('/') {
            let found = parameters.get(key).is_some();
            return if found { answer(1, "", text(key)) } else { not_found() };
        }
        // What counts is the first part of the name.
        let first = key.split('/').next().unwrap_or_default();
        let mut namespace = caller.to_owned();
        loop {
            let name = |part: &str| format!("{}/{part}", namespace.trim_end_matches('/'));
            if parameters.get(&name(first)).is_some() {
                return answer(1, "", text(&name(key)));
            }
            if namespace == "/" {
                return not_found();
            }
            namespace = parent_of(&namespace).to_owned();
        }
    }

    fn pairs<'a>(pairs: impl Iterator<Item = (&'a String, &'a String)>) -> Value {
        Value::Array(pairs.map(|(name, kind)| Value::Array(vec![text(name), text(kind)])).collect())
    }
}

impl Methods for Registry {
    fn call(&self, method: &str, arguments: &[Value], _from: IpAddr) -> Value {
        let caller = resolve(text_at(arguments, 0), "/");
        let (caller, first) = (caller.as_str(), text_at(arguments, 1));
        match method {
            "registerService" | "registerSubscriber" | "registerPublisher" => self.register(caller, method, arguments),
            "unregisterService" | "unregisterSubscriber" | "unregisterPublisher" => {
                self.unregister(caller, method, arguments)
            }
            "lookupNode" => match self.state.lock().nodes.get(&resolve(first, caller)) {
                Some(uri) => answer(1, "node api", text(uri)),
                None => answer(-1, &format!("unknown node [{first}]"), text("")),
            },
            "lookupService" => match self.state.lock().services.get(&resolve(first, caller)) {
                Some((_, uri)) => answer(1, "rosrpc URI", text(uri)),
                None => answer(-1, "no provider", text("")),
            },
            "getPublishedTopics" => {
                let state = self.state.lock();
                let below = if first.is_empty() { String::from("/") } else { resolve(first, caller) };
                let below = format!("{}/", below.trim_end_matches('/'));
                let published = state.types.iter();
                let published = published.filter(|(name, _)| state.publishers.contains_key(*name));
                answer(1, "current topics", Self::pairs(published.filter(|(name, _)| name.starts_with(&below))))
            }
            "getTopicTypes" => answer(1, "current types", Self::pairs(self.state.lock().types.iter())),
            "getSystemState" => answer(1, "current system state", self.state.lock().system_state()),
            "getUri" | "getMasterUri" => answer(1, "", text(&self.uri)),
            "getPid" => answer(1, "", Value::Integer(std::process::id() as i32)),
            "getName" => answer(1, "", text("/master")),
            "getParam" | "hasParam" | "setParam" | "deleteParam" | "subscribeParam" | "unsubscribeParam" => {
                self.parameter(caller, method, arguments)
            }
            "searchParam" => self.search(caller, first),
            "getParamNames" => {
                let names = self.state.lock().parameters.names();
                answer(1, "parameter names", Value::Array(names.iter().map(|name| text(name)).collect()))
            }
            "publisherUpdate" | "paramUpdate" => answer(1, "", Value::Integer(0)),
            "getPublications" | "getSubscriptions" | "getBusInfo" => answer(1, "", Value::Array(Vec::new())),
            "getBusStats" => answer(1, "", Value::Array(vec![Value::Array(Vec::new()); 3])),
            other => answer(-1, &format!("there is no method {other}"), Value::Integer(0)),
        }
    }
}

/// What a node is told about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Notice {
    Publishers,
    Parameter,
    Shutdown,
}

/// What waits to be told to one node; only the newest of each kind and name counts.
type Waiting = BTreeMap<(Notice, String), Value>;

/// What waits to be told to nodes: each is told in a thread of its own, so that one that hangs delays nobody.
#[derive(Default)]
struct Notices(Mutex<Queues>);

#[derive(Default)]
struct Queues {
    /// By address of the node.
    waiting: BTreeMap<String, Waiting>,
    /// Addresses of those that are being told.
    busy: BTreeSet<String>,
}

impl Notices {
    fn tell(self: &Arc<Self>, uri: &str, notice: Notice, name: &str, value: Value) {
        let mut queues = self.0.lock();
        queues.waiting.entry(uri.to_owned()).or_default().insert((notice, name.to_owned()), value);
        if queues.busy.len() >= MAX_NOTICES || !queues.busy.insert(uri.to_owned()) {
            // Whoever is told now is told this too, or the thread that is done first takes it.
            return;
        }
        drop(queues);
        let (notices, own) = (Arc::clone(self), uri.to_owned());
        let started = std::thread::Builder::new().name("ros-notice".into()).spawn(move || notices.run(own));
        if started.is_err() {
            self.0.lock().busy.remove(uri);
        }
    }

    /// Tells a node that another one has taken its name.
    fn shut_down(self: &Arc<Self>, uri: &str, name: &str) {
        self.tell(uri, Notice::Shutdown, name, text("a node of the same name has come"));
    }

    /// Tells the node at `uri` what waits, then others that wait and nobody tells.
    fn run(&self, mut uri: String) {
        loop {
            let Some(waiting) = self.0.lock().waiting.remove(&uri) else {
                let mut queues = self.0.lock();
                // It may have come in between.
                if queues.waiting.contains_key(&uri) {
                    continue;
                }
                queues.busy.remove(&uri);
                let Some(next) = queues.waiting.keys().find(|uri| !queues.busy.contains(*uri)).cloned() else { return };
                queues.busy.insert(next.clone());
                uri = next;
                continue;
            };
            let Ok(node) = Peer::new(&uri, "/master", TIMEOUT) else { continue };
            for ((notice, name), value) in waiting {
                let told = match notice {
                    Notice::Publishers => node.call("publisherUpdate", vec![text(&name), value]),
                    Notice::Parameter => node.call("paramUpdate", vec![text(&name), value]),
                    Notice::Shutdown => node.call("shutdown", vec![value]),
                };
                // One that is not there is not told the rest.
                if told.is_err_and(|error| !error.is_refusal()) {
                    break;
                }
            }
        }
    }
}
