//! A master and a node, and clients that speak for themselves byte by byte.
#![allow(dead_code, reason = "each test program uses a part")]

use std::collections::HashMap;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use dxr::{MethodCall, MethodResponse, Value};
use ros_node::tcpros::{fields, header_of};
use ros_node::{Announcement, LinkOptions, Master, Node, NodeName, OwnMaster, Peer};

pub const PATIENCE: Duration = Duration::from_secs(20);

pub fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !condition() {
        assert!(Instant::now() < deadline, "waited in vain: {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

pub fn text(text: &str) -> Value {
    Value::String(text.to_owned())
}

/// A master on a free port of this machine.
pub struct Place {
    pub uri: String,
    _master: Master,
}

impl Place {
    pub fn new() -> Self {
        let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        Self { uri: format!("http://{address}/"), _master: Master::start(address).unwrap() }
    }

    pub fn master(&self) -> Peer {
        Peer::new(&self.uri, "/tester", PATIENCE).unwrap()
    }

    /// A node called `name`, and what it says to its user.
    pub fn node(&self, name: &str) -> (Node, Arc<Mutex<Vec<String>>>) {
        let lines = Arc::<Mutex<Vec<String>>>::default();
        let said = Arc::clone(&lines);
        let node = Node::start(LinkOptions {
            master: Peer::new(&self.uri, name, Duration::from_secs(2)).unwrap(),
            name: NodeName::Full(name.into()),
            own_master: OwnMaster::None,
            parameters: vec![("gain".into(), Value::Double(2.0))],
            report: Arc::new(move |line| said.lock().unwrap().push(line.to_string())),
        });
        (node.unwrap(), lines)
    }

    /// Whether the master lists `name` as published (0), subscribed (1) or served (2).
    pub fn lists(&self, part: usize, name: &str) -> bool {
        let Ok(Value::Array(parts)) = self.master().call("getSystemState", vec![]) else { return false };
        let listed = ros_node::entries(&parts[part]).any(|(listed, users)| listed == name && !users.is_empty());
        listed
    }

    /// Adds `what` to `node` and waits until the master knows.
    pub fn announce(&self, node: &Node, what: Vec<Arc<dyn Announcement>>) {
        let parts: Vec<_> = what.iter().map(|one| one.registration()).collect();
        node.link().add(what);
        for registration in parts {
            until(&registration.topic, || self.lists(registration.direction as usize, &registration.topic));
        }
    }

    /// The node called `name`, as a subscriber calls it.
    pub fn peer(&self, name: &str) -> Peer {
        ros_node::node(&self.master(), name).unwrap()
    }

    /// Port of the topics and services of the node called `name`.
    pub fn port(&self, name: &str, topic: &str) -> u16 {
        let protocols = Value::Array(vec![Value::Array(vec![text("TCPROS")])]);
        match self.peer(name).call("requestTopic", vec![text(topic), protocols]).unwrap() {
            Value::Array(parts) => match parts[..] {
                [_, _, Value::Integer(port)] => port.try_into().unwrap(),
                _ => panic!("{parts:?}"),
            },
            other => panic!("{other:?}"),
        }
    }
}

/// A connection on which a header was exchanged.
pub fn shake_hands(port: u16, header: &[(&str, &str)]) -> (TcpStream, HashMap<String, String>) {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(&header_of(header)).unwrap();
    let answer = fields(&message(&mut stream).expect("an answer"));
    (stream, answer)
}

/// The next block; `None` at the end.
pub fn message(stream: &mut TcpStream) -> Option<Vec<u8>> {
    let mut length = [0; 4];
    stream.read_exact(&mut length).ok()?;
    let mut message = vec![0; u32::from_le_bytes(length) as usize];
    stream.read_exact(&mut message).ok()?;
    Some(message)
}

/// Name and arguments of each call.
pub type Called = Vec<(String, Vec<Value>)>;

/// A node that answers each call as it is told, and says who called what.
pub struct FakeNode {
    pub uri: String,
    pub calls: Arc<Mutex<Called>>,
}

impl FakeNode {
    pub fn new(answer: impl Fn(&str) -> Value + Send + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let uri = format!("http://{}/", listener.local_addr().unwrap());
        let calls = Arc::<Mutex<Called>>::default();
        let heard = Arc::clone(&calls);
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let Ok(mut stream) = stream else { return };
                let mut request = Vec::new();
                let body = loop {
                    let mut chunk = [0; 4096];
                    match stream.read(&mut chunk) {
                        Ok(count) if count > 0 => request.extend(&chunk[..count]),
                        _ => break String::new(),
                    }
                    let all = String::from_utf8_lossy(&request);
                    if all.trim_end().ends_with("</methodCall>") {
                        break all.split_once("\r\n\r\n").unwrap().1.to_owned();
                    }
                };
                let Ok(call) = MethodCall::from_xml(&body) else { continue };
                heard.lock().unwrap().push((call.name.to_string(), call.params.clone()));
                let value = Value::Array(vec![Value::Integer(1), text(""), answer(&call.name)]);
                let xml = MethodResponse { value }.to_xml().unwrap();
                let _ = write!(stream, "HTTP/1.0 200 OK\r\nContent-Type: text/xml\r\n\r\n{xml}");
            }
        });
        Self { uri, calls }
    }

    pub fn called(&self, method: &str) -> usize {
        self.calls.lock().unwrap().iter().filter(|(name, _)| name == method).count()
    }
}
