//! Services of the node: requests over TCP, answers from a function.
//!
//! The protocol is TCPROS: a header of `key=value` fields each way, then requests and answers, each behind its length.
//! Each client has a thread while it is connected, because an answer may take long.

use std::collections::HashMap;
use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;

use super::announcement::{Announcement, Direction, Endpoint, Registration, Serves};
use super::connections::{Count, Place};
use super::tcpros::{block, header_of, quote};

/// How long a client may keep us waiting for its first request.
const READ_TIMEOUT: Duration = Duration::from_secs(5);

/// How long a client may take to read an answer.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// How many clients of a service are served at once; the others are turned away.
const MAX_CLIENTS: usize = 64;

/// The type of a service, for headers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServiceKind {
    /// `package/Type`.
    pub name: String,
    /// Checksum of the definition.
    pub md5sum: String,
    /// Longest request, bytes.
    pub longest: usize,
}

/// Answers a request, the bytes of a message, with the bytes of a message, or with a sentence why there is none.
type Answer = dyn Fn(&[u8]) -> Result<Vec<u8>, String> + Send + Sync;

/// Is told what a client did that clients don't do; the first word is the service's name.
type Complaint = dyn Fn(&str) + Send + Sync;

/// What is known where requests are answered.
pub(crate) struct Desk {
    /// Name of the service.
    pub name: String,
    pub kind: ServiceKind,
    answer: Box<Answer>,
    complain: Box<Complaint>,
    count: Count,
    /// Clients that are being served; `None` while the service is not announced.
    clients: Mutex<Option<HashMap<u64, Arc<TcpStream>>>>,
}

/// A service of the node. It answers from when it is announced until it is withdrawn.
pub struct ServiceServer(Arc<Desk>);

impl ServiceServer {
    /// A service called `name`. `answer` runs in a thread of its own for each client, so in several at once; it may
    /// block. `complain` is told what a client did wrong.
    pub fn new(
        name: String,
        kind: ServiceKind,
        answer: impl Fn(&[u8]) -> Result<Vec<u8>, String> + Send + Sync + 'static,
        complain: impl Fn(&str) + Send + Sync + 'static,
    ) -> Arc<Self> {
        let (answer, complain) = (Box::new(answer), Box::new(complain));
        let desk = Desk { name, kind, answer, complain, count: Count::default(), clients: Mutex::default() };
        Arc::new(Self(Arc::new(desk)))
    }
}

impl Announcement for ServiceServer {
    fn registration(&self) -> Registration {
        Registration {
            topic: self.0.name.clone(),
            message_type: self.0.kind.name.clone(),
            direction: Direction::Serves,
        }
    }

    fn endpoint(&self) -> Endpoint {
        Endpoint(Serves::Service(Arc::clone(&self.0)))
    }
}

impl Desk {
    /// Takes clients from now on.
    pub fn open(&self) {
        self.clients.lock().get_or_insert_default();
    }

    /// Ends all connections, apart from those in which a request is being answered: they end with it.
    pub fn close(&self) {
        for stream in self.clients.lock().take().into_iter().flat_map(HashMap::into_values) {
            let _ = stream.shutdown(Shutdown::Both);
        }
    }

    /// Serves the client at `stream`, whose header has these fields, in a thread of its own, in the name of `node`.
    pub fn admit(self: Arc<Self>, fields: HashMap<String, String>, stream: Arc<TcpStream>, node: String, place: Place) {
        let Some(own_place) = self.count.place(MAX_CLIENTS) else { return };
        // Without a thread the client is turned away.
        let _ = std::thread::Builder::new().name("ros-request".into()).spawn(move || {
            let (_place, _own_place) = (place, own_place);
            static CLIENTS: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(0);
            let number = CLIENTS.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            match &mut *self.clients.lock() {
                Some(clients) => clients.insert(number, Arc::clone(&stream)),
                None => return,
            };
            // A connection that breaks is the client's business.
            let _ = self.serve(&fields, &stream, &node);
            if let Some(clients) = &mut *self.clients.lock() {
                clients.remove(&number);
            }
        });
    }

    fn serve(&self, fields: &HashMap<String, String>, mut stream: &TcpStream, node: &str) -> io::Result<()> {
        stream.set_nonblocking(false)?;
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
        stream.set_read_timeout(Some(READ_TIMEOUT))?;
        if let Some(mismatch) = self.mismatch(fields) {
            (self.complain)(&format!("a client was refused: {mismatch}"));
            return stream.write_all(&header_of(&[("error", &mismatch)]));
        }
        let kind = &self.kind.name;
        stream.write_all(&header_of(&[
            ("callerid", node),
            ("md5sum", &self.kind.md5sum),
            ("service", &self.name),
            ("type", kind),
            ("request_type", &format!("{kind}Request")),
            ("response_type", &format!("{kind}Response")),
        ]))?;
        let is_set = |field: &str| fields.get(field).is_some_and(|value| value == "1");
        if is_set("probe") {
            return Ok(());
        }
        loop {
            let request = match read_block(stream, self.kind.longest)? {
                Ok(request) => request,
                // What follows cannot be made sense of.
                Err(length) => {
                    let why = format!("a request has {length} bytes, {} are the most", self.kind.longest);
                    (self.complain)(&format!("{}: {why}", self.name));
                    return stream.write_all(&refusal(&why));
                }
            };
            let answer = match (self.answer)(&request) {
                Ok(bytes) => [&[1][..], &block(&bytes)].concat(),
                Err(error) => {
                    (self.complain)(&format!("{}: {error}; it is refused", self.name));
                    refusal(&error)
                }
            };
            stream.write_all(&answer)?;
            if !is_set("persistent") {
                return Ok(());
            }
            stream.set_read_timeout(None)?;
        }
    }

    /// A sentence when a client with these header fields means something else.
    fn mismatch(&self, fields: &HashMap<String, String>) -> Option<String> {
        let actual = fields.get("md5sum").map(String::as_str).unwrap_or_default();
        let ServiceKind { name: kind, md5sum: expected, .. } = &self.kind;
        (actual != "*" && actual != expected).then(|| {
            format!(
                "{} is a {kind} with the checksum {expected}, the client's has \"{}\": a client with another version of the service",
                self.name,
                quote(actual)
            )
        })
    }
}

/// A length and as many bytes, which are returned; the length alone if it is more than `longest`.
fn read_block(mut stream: &TcpStream, longest: usize) -> io::Result<Result<Vec<u8>, u32>> {
    let mut length = [0; 4];
    stream.read_exact(&mut length)?;
    let length = u32::from_le_bytes(length);
    if length as usize > longest {
        return Ok(Err(length));
    }
    let mut block = Vec::new();
    // Memory grows with the bytes that come.
    stream.take(u64::from(length)).read_to_end(&mut block)?;
    if block.len() < length as usize {
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    Ok(Ok(block))
}

/// An answer that says that there is none.
fn refusal(why: &str) -> Vec<u8> {
    let mut answer = vec![0];
    answer.extend(block(why.as_bytes()));
    answer
}
