//! Listening to messages of any type, on connections of our own.
//!
//! rosrust's subscribers do not try again when a connection fails, wait for ever for a publisher that hangs, and do not ask for small messages to
//! be sent at once. Here each publisher that the master lists is connected to until it answers, also after it was restarted, and its thread hands
//! each message over directly.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use dxr::Value;
use rosrust::api::Ros;
use rosrust::error::Error;

use super::topic::{Announcement, Direction, Registration};
use super::xmlrpc::Peer;

/// How long a publisher may take for each step of connecting.
const TIMEOUT: Duration = Duration::from_secs(1);

/// Longest message or header that is read, bytes.
const LONGEST: usize = 16 << 20;

/// How often a thread without messages looks whether it should end.
const GLANCE: Duration = Duration::from_millis(500);

/// Names of the nodes that publish each topic.
pub type Publishers = BTreeMap<String, Vec<String>>;

/// A message as it came.
#[derive(Debug, Clone, Copy)]
pub struct RawReceived<'a> {
    /// Its type, `package/Type`, as its publisher says.
    pub kind: &'a str,
    /// Its fields.
    pub body: &'a [u8],
}

type Handler = dyn Fn(RawReceived<'_>) + Send + Sync;

/// A topic to listen to, whatever is the type of its messages.
pub struct RawSubscription {
    shared: Arc<Shared>,
}

struct Shared {
    topic: String,
    master: Peer,
    on_message: Box<Handler>,
    /// Name and address of our node while it listens.
    node: Mutex<Option<(String, String)>>,
    /// By name of the publishing node; `None` while it is being connected to.
    connections: Mutex<BTreeMap<String, Option<TcpStream>>>,
    stop: AtomicBool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl RawSubscription {
    /// `on_message` runs in a thread of each publisher's and must not block.
    pub fn new(master: Peer, topic: String, on_message: impl Fn(RawReceived<'_>) + Send + Sync + 'static) -> Arc<Self> {
        let shared = Shared {
            topic,
            master,
            on_message: Box::new(on_message),
            node: Mutex::default(),
            connections: Mutex::default(),
            stop: AtomicBool::new(false),
        };
        Arc::new(Self { shared: Arc::new(shared) })
    }
}

impl Announcement for RawSubscription {
    fn registration(&self) -> Registration {
        Registration { topic: self.shared.topic.clone(), message_type: "*".into(), direction: Direction::Subscribes }
    }

    /// The master may fail: it is told again when it does not know us.
    fn announce(&self, ros: &Ros) -> Result<(), Error> {
        let shared = &self.shared;
        shared.stop.store(false, Ordering::Release);
        *lock(&shared.node) = Some((ros.name().to_owned(), ros.uri().to_owned()));
        let text = |s: &str| Value::String(s.to_owned());
        let arguments = vec![text(&shared.topic), text("*"), text(ros.uri())];
        shared.master.called_by(ros.name()).call("registerSubscriber", arguments).map_err(|error| error.to_string())?;
        Ok(())
    }

    fn withdraw(&self) {
        let shared = &self.shared;
        shared.stop.store(true, Ordering::Release);
        for stream in lock(&shared.connections).values().flatten() {
            let _ = stream.shutdown(Shutdown::Both);
        }
        if let Some((name, uri)) = lock(&shared.node).take() {
            let arguments = vec![Value::String(shared.topic.clone()), Value::String(uri)];
            // A master that is away has nothing to forget.
            let _ = shared.master.called_by(&name).call("unregisterSubscriber", arguments);
        }
    }

    fn connects(&self) -> bool {
        true
    }

    fn connect(&self, publishers: &Publishers) {
        let Some((own, _)) = lock(&self.shared.node).clone() else { return };
        for publisher in publishers.get(&self.shared.topic).into_iter().flatten() {
            let mut connections = lock(&self.shared.connections);
            if connections.contains_key(publisher) {
                continue;
            }
            connections.insert(publisher.clone(), None);
            drop(connections);
            let (shared, publisher, own) = (Arc::clone(&self.shared), publisher.clone(), own.clone());
            let thread = std::thread::Builder::new().name("ros-listen".into());
            let (failed, name) = (Arc::clone(&self.shared), publisher.clone());
            let spawned = thread.spawn(move || {
                // Whatever goes wrong, it is tried again as long as the master lists that publisher.
                let _ = shared.listen(&publisher, &own);
                lock(&shared.connections).remove(&publisher);
            });
            if spawned.is_err() {
                lock(&failed.connections).remove(&name);
            }
        }
    }
}

impl Shared {
    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Acquire)
    }

    /// Connects to a publisher and hands over what it sends, until it or we end.
    fn listen(&self, publisher: &str, own: &str) -> io::Result<()> {
        let mut stream = self.connect(publisher, own)?;
        let kind = self.shake_hands(&mut stream, own)?;
        stream.set_read_timeout(Some(GLANCE))?;
        lock(&self.connections).insert(publisher.to_owned(), Some(stream.try_clone()?));
        let mut message = Vec::new();
        while !self.is_stopped() {
            self.read_block(&mut stream, &mut message, None)?;
            (self.on_message)(RawReceived { kind: &kind, body: &message });
        }
        Ok(())
    }

    fn connect(&self, publisher: &str, own: &str) -> io::Result<TcpStream> {
        let bad = |what: String| io::Error::other(what);
        let master = self.master.called_by(own);
        let uri = master.call("lookupNode", vec![Value::String(publisher.to_owned())]);
        let Ok(Value::String(uri)) = uri else { return Err(bad(format!("{publisher} is not known"))) };
        let node = Peer::new(&uri, own, TIMEOUT).map_err(|error| bad(error.to_string()))?;
        let protocols = Value::Array(vec![Value::Array(vec![Value::String("TCPROS".into())])]);
        let answer = node.call("requestTopic", vec![Value::String(self.topic.clone()), protocols]);
        let answer = answer.map_err(|error| bad(error.to_string()))?;
        let Value::Array(parts) = answer else { return Err(bad("no address".into())) };
        let (Some(Value::String(host)), Some(&Value::Integer(port))) = (parts.get(1), parts.get(2)) else {
            return Err(bad("no address".into()));
        };
        let port = u16::try_from(port).map_err(|_| bad("no port".into()))?;
        let mut last = bad(format!("{host} has no address"));
        for address in (host.as_str(), port).to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, TIMEOUT) {
                Ok(stream) => return Ok(stream),
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    /// Says who we are and what we want; returns the type of the messages.
    fn shake_hands(&self, stream: &mut TcpStream, own: &str) -> io::Result<String> {
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(TIMEOUT))?;
        stream.set_write_timeout(Some(TIMEOUT))?;
        let callerid = format!("callerid={own}");
        let topic = format!("topic={}", self.topic);
        let fields = [callerid.as_str(), topic.as_str(), "type=*", "md5sum=*", "message_definition=", "tcp_nodelay=1"];
        let mut header = Vec::new();
        for field in fields {
            header.extend(u32::try_from(field.len()).unwrap_or(0).to_le_bytes());
            header.extend(field.as_bytes());
        }
        stream.write_all(&u32::try_from(header.len()).unwrap_or(0).to_le_bytes())?;
        stream.write_all(&header)?;
        let mut answer = Vec::new();
        self.read_block(stream, &mut answer, Some(5))?;
        type_of(&answer).ok_or_else(|| io::Error::from(ErrorKind::InvalidData))
    }

    /// A length and so many bytes; silence is no error, except more than `patience` times in a row.
    fn read_block(&self, stream: &mut TcpStream, block: &mut Vec<u8>, patience: Option<u32>) -> io::Result<()> {
        let mut length = [0; 4];
        self.fill(stream, &mut length, patience)?;
        let length = u32::from_le_bytes(length) as usize;
        if length > LONGEST {
            return Err(ErrorKind::InvalidData.into());
        }
        block.resize(length, 0);
        self.fill(stream, block, patience)
    }

    fn fill(&self, stream: &mut TcpStream, mut rest: &mut [u8], patience: Option<u32>) -> io::Result<()> {
        let mut silent = 0;
        while !rest.is_empty() {
            match stream.read(rest) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(count) => rest = &mut rest[count..],
                Err(error) if error.kind() == ErrorKind::Interrupted => (),
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    silent += 1;
                    if self.is_stopped() || patience.is_some_and(|most| silent >= most) {
                        return Err(error);
                    }
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

/// Field `type` of a connection header; `None` if there is none, as in a refusal.
fn type_of(mut header: &[u8]) -> Option<String> {
    while let Some((length, rest)) = header.split_first_chunk::<4>() {
        let (field, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        if let Some(kind) = field.strip_prefix(b"type=") {
            return Some(String::from_utf8_lossy(kind).into_owned());
        }
        header = rest;
    }
    None
}

/// Who publishes what, as the master of `master` says.
pub(crate) fn publishers(master: &Peer) -> Option<Publishers> {
    let Ok(Value::Array(lists)) = master.call("getSystemState", vec![]) else { return None };
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
    fn the_type_is_found_in_a_header() {
        let header = |fields: &[&str]| -> Vec<u8> {
            let field = |f: &&str| [&(f.len() as u32).to_le_bytes()[..], f.as_bytes()].concat();
            fields.iter().flat_map(field).collect()
        };
        let good = header(&["md5sum=1", "type=std_msgs/Bool", "callerid=/a"]);
        assert_eq!(type_of(&good).as_deref(), Some("std_msgs/Bool"));
        assert_eq!(type_of(&header(&["error=no such topic"])), None);
        assert_eq!(type_of(&[255, 255, 255, 255, 1]), None);
    }
}
