//! A ROS service: requests over TCP, answers from a function.
//!
//! rosrust has services too, but they send an error after their first answer on each connection, believe any length
//! that a client announces, and keep their address to themselves, which is needed to register again with a master that
//! was restarted. The protocol is TCPROS: a header of `key=value` fields each way, then requests and answers, each
//! behind its length.

use std::collections::HashMap;
use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::time::Duration;

use dxr::Value;
use parking_lot::Mutex;
use ros_node::tcpros::{block, fields, header_of};
use ros_node::{Announcement, Direction, Peer, Registration};
use rosrust::api::Ros;
use rosrust::error::Error;
use rosrust::{RosMsg, ServicePair};

use super::received::{self, FromClient};
use super::signal::RateLimitedLog;

/// Longest header or request, bytes: a request is a file or a name.
const LONGEST: usize = 64 << 10;

/// How long a client may keep us waiting for its header or its first request.
const READ_TIMEOUT: Duration = Duration::from_secs(5);

/// How long a client may take to read an answer.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// How many clients are served at once; the others are turned away.
const MAX_CONNECTIONS: usize = 64;

/// Reads what a service is asked and says what it answers.
type Answer<S> = dyn Fn(<S as ServicePair>::Request) -> <S as ServicePair>::Response + Send + Sync;

/// A service of the node. It answers from when it is announced until it is withdrawn.
pub(super) struct Service<S: ServicePair> {
    desk: Arc<Desk<S>>,
    master: Peer,
    open: Mutex<Option<Open>>,
}

/// What is known where requests are answered.
struct Desk<S: ServicePair> {
    /// Name of the service.
    name: String,
    answer: Box<Answer<S>>,
    complaints: RateLimitedLog,
}

struct Open {
    uri: String,
    port: u16,
    /// In the name of the node.
    master: Peer,
    connections: Arc<Connections>,
}

impl<S> Service<S>
where
    S: ServicePair,
    S::Request: FromClient,
{
    /// `answer` runs in a thread of its own for each client, so in several at once; it may block.
    pub fn new(
        name: String,
        master: Peer,
        answer: impl Fn(S::Request) -> S::Response + Send + Sync + 'static,
    ) -> Arc<Self> {
        let desk = Desk { name, answer: Box::new(answer), complaints: RateLimitedLog::default() };
        Arc::new(Self { desk: Arc::new(desk), master, open: Mutex::default() })
    }

    /// Listens at `address` and registers it as one of the node `name` at `uri`, reachable under `host`.
    fn listen(&self, address: &str, host: &str, name: &str, uri: &str) -> Result<(), String> {
        let in_vain = |error: io::Error| format!("no socket for the service: {error}");
        let listener = TcpListener::bind((address, 0)).map_err(in_vain)?;
        let port = listener.local_addr().map_err(in_vain)?.port();
        let connections = Connections::new(name);
        let (desk, shared) = (Arc::clone(&self.desk), Arc::clone(&connections));
        std::thread::Builder::new()
            .name("ros-service".into())
            .spawn(move || accept(&listener, &desk, &shared))
            .map_err(in_vain)?;
        let open =
            Open { uri: format!("rosrpc://{host}:{port}"), port, master: self.master.called_by(name), connections };
        let text = |s: &str| Value::String(s.to_owned());
        let registered = open.master.call("registerService", vec![text(&self.desk.name), text(&open.uri), text(uri)]);
        if let Err(error) = registered {
            open.close();
            return Err(error.to_string());
        }
        *self.open.lock() = Some(open);
        Ok(())
    }
}

impl Open {
    /// Ends all threads of the service, apart from those in which a request is being answered: they end with it.
    fn close(&self) {
        self.connections.close();
        // `accept` ends with the next connection.
        let _ = TcpStream::connect_timeout(&(Ipv4Addr::LOCALHOST, self.port).into(), Duration::from_millis(50));
    }
}

impl<S> Announcement for Service<S>
where
    S: ServicePair,
    S::Request: FromClient,
{
    fn registration(&self) -> Registration {
        let uri = self.open.lock().as_ref().map(|open| open.uri.clone()).unwrap_or_default();
        Registration {
            topic: self.desk.name.clone(),
            message_type: S::msg_type(),
            direction: Direction::Serves { uri },
        }
    }

    fn announce(&self, ros: &Ros) -> Result<(), Error> {
        self.listen(ros.bind_address(), ros.hostname(), ros.name(), ros.uri()).map_err(Error::from)
    }

    fn withdraw(&self) {
        let Some(open) = self.open.lock().take() else { return };
        open.close();
        // A master that does not answer finds out by itself.
        let arguments = vec![Value::String(self.desk.name.clone()), Value::String(open.uri)];
        let _ = open.master.call("unregisterService", arguments);
    }
}

struct Connections {
    /// Name of the node.
    node: String,
    /// Clients that are being served; `None` once the service is closed.
    clients: Mutex<Option<HashMap<u64, TcpStream>>>,
}

impl Connections {
    fn new(node: &str) -> Arc<Self> {
        Arc::new(Self { node: node.to_owned(), clients: Mutex::new(Some(HashMap::new())) })
    }

    fn is_closed(&self) -> bool {
        self.clients.lock().is_none()
    }

    fn close(&self) {
        for stream in self.clients.lock().take().into_iter().flat_map(HashMap::into_values) {
            let _ = stream.shutdown(Shutdown::Both);
        }
    }

    /// Makes a place for the client number `number`, unless there are too many.
    fn admit(self: &Arc<Self>, number: u64, stream: &TcpStream) -> Option<Place> {
        let mut clients = self.clients.lock();
        let clients = clients.as_mut().filter(|clients| clients.len() < MAX_CONNECTIONS)?;
        clients.insert(number, stream.try_clone().ok()?);
        Some(Place { number, connections: Arc::clone(self) })
    }
}

/// One of the connections while it is open.
struct Place {
    number: u64,
    connections: Arc<Connections>,
}

impl Drop for Place {
    fn drop(&mut self) {
        if let Some(clients) = self.connections.clients.lock().as_mut() {
            clients.remove(&self.number);
        }
    }
}

/// Takes clients until the service is closed.
fn accept<S>(listener: &TcpListener, desk: &Arc<Desk<S>>, connections: &Arc<Connections>)
where
    S: ServicePair,
    S::Request: FromClient,
{
    for (number, stream) in (0..).zip(listener.incoming()) {
        if connections.is_closed() {
            return;
        }
        let Ok(stream) = stream else {
            // Too many open files, for example: trying at once would only keep the processor busy.
            std::thread::sleep(Duration::from_millis(100));
            continue;
        };
        let Some(place) = connections.admit(number, &stream) else { continue };
        let desk = Arc::clone(desk);
        // Without a thread the client is turned away too.
        let _ = std::thread::Builder::new().name("ros-request".into()).spawn(move || {
            // A connection that breaks is the client's business.
            let _ = desk.serve(stream, &place.connections.node);
        });
    }
}

impl<S> Desk<S>
where
    S: ServicePair,
    S::Request: FromClient,
{
    /// Answers the client at `stream` in the name of `node` until it has enough.
    fn serve(&self, mut stream: TcpStream, node: &str) -> io::Result<()> {
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
        stream.set_read_timeout(Some(READ_TIMEOUT))?;
        let Ok(header) = read_block(&mut stream)? else { return Ok(()) };
        let fields = fields(&header);
        if let Some(mismatch) = self.mismatch(&fields) {
            self.complaints.report(format_args!("a client was refused: {mismatch}"));
            return stream.write_all(&header_of(&[("error", &mismatch)]));
        }
        let md5sum = S::md5sum();
        stream.write_all(&header_of(&[
            ("callerid", node),
            ("md5sum", &md5sum),
            ("service", &self.name),
            ("type", &S::msg_type()),
            ("request_type", &format!("{}Request", S::msg_type())),
            ("response_type", &format!("{}Response", S::msg_type())),
        ]))?;
        let is_set = |field: &str| fields.get(field).is_some_and(|value| value == "1");
        if is_set("probe") {
            return Ok(());
        }
        loop {
            let request = match read_block(&mut stream)? {
                Ok(request) => request,
                // What follows cannot be made sense of.
                Err(length) => {
                    let why = format!("a request has {length} bytes, {LONGEST} are the most");
                    self.complaints.report(format_args!("{}: {why}", self.name));
                    return stream.write_all(&refusal(&why));
                }
            };
            let answer = match received::read(&request) {
                Ok(request) => {
                    let mut answer = vec![1];
                    answer.extend((self.answer)(request).encode_vec()?);
                    answer
                }
                Err(error) => {
                    self.complaints.report(format_args!("{}: {error}; it is refused", self.name));
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
        let field = |key: &str| fields.get(key).map(String::as_str).unwrap_or_default();
        if field("service") != self.name {
            return Some(format!("this is the service {}, not \"{}\"", self.name, field("service")));
        }
        let (expected, actual) = (S::md5sum(), field("md5sum"));
        (actual != "*" && actual != expected).then(|| {
            let (name, kind) = (&self.name, S::msg_type());
            format!("{name} is a {kind} with the checksum {expected}, the client's has \"{actual}\"; is it built with our ambf_msgs?")
        })
    }
}

/// A length and as many bytes, which are returned; the length alone if it is too long to be taken.
fn read_block(stream: &mut TcpStream) -> io::Result<Result<Vec<u8>, u32>> {
    let mut length = [0; 4];
    stream.read_exact(&mut length)?;
    let length = u32::from_le_bytes(length);
    if length as usize > LONGEST {
        return Ok(Err(length));
    }
    let mut block = vec![0; length as usize];
    stream.read_exact(&mut block)?;
    Ok(Ok(block))
}

/// An answer that says that there is none.
fn refusal(why: &str) -> Vec<u8> {
    let mut answer = vec![0];
    answer.extend(block(why.as_bytes()));
    answer
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::messages::ambf_msgs::{AddModel, AddModelReq, AddModelRes};
    use rosrust::Message;

    const NAME: &str = "/env/World/add_model";

    /// A service that repeats the file as the model's name.
    struct Fixture {
        open: Open,
        thread: Option<std::thread::JoinHandle<()>>,
    }

    impl Fixture {
        fn new() -> Self {
            let listener = TcpListener::bind("127.0.0.1:0").unwrap();
            let port = listener.local_addr().unwrap().port();
            let answer =
                |request: AddModelReq| AddModelRes { success: true, model: request.file, message: String::new() };
            let complaints = RateLimitedLog::default();
            let desk = Arc::new(Desk::<AddModel> { name: NAME.into(), answer: Box::new(answer), complaints });
            let connections = Connections::new("/node");
            let shared = Arc::clone(&connections);
            let thread = Some(std::thread::spawn(move || accept(&listener, &desk, &shared)));
            let master = Peer::new("http://localhost:1/", "/node", Duration::from_millis(1)).unwrap();
            Self { open: Open { uri: String::new(), port, master, connections }, thread }
        }

        fn connect(&self) -> TcpStream {
            let stream = TcpStream::connect(("127.0.0.1", self.open.port)).unwrap();
            stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
            stream
        }

        /// A client that says `more` besides what every client says, and the answer to its header.
        fn client(&self, more: &[(&str, &str)]) -> (TcpStream, HashMap<String, String>) {
            let md5sum = AddModel::md5sum();
            let mut says = HashMap::from([("service", NAME), ("callerid", "/me"), ("md5sum", md5sum.as_str())]);
            says.extend(more.iter().copied());
            let mut stream = self.connect();
            stream.write_all(&header_of(&says.into_iter().collect::<Vec<_>>())).unwrap();
            let header = fields(&read_block(&mut stream).unwrap().unwrap());
            (stream, header)
        }
    }

    impl Drop for Fixture {
        fn drop(&mut self) {
            self.open.close();
            self.thread.take().unwrap().join().unwrap();
        }
    }

    fn ask(stream: &mut TcpStream, request: &[u8]) -> (bool, Vec<u8>) {
        stream.write_all(request).unwrap();
        let mut success = [2];
        stream.read_exact(&mut success).unwrap();
        (success == [1], read_block(stream).unwrap().unwrap())
    }

    fn request(file: &str) -> Vec<u8> {
        AddModelReq { file: file.into() }.encode_vec().unwrap()
    }

    fn assert_closed(stream: &mut TcpStream) {
        // Closed with unread bytes it is reset, which is an end too.
        assert!(!matches!(stream.read(&mut [0]), Ok(1)), "nothing follows");
    }

    #[test]
    fn a_request_is_answered_and_the_connection_ends_unless_it_is_to_persist() {
        let fixture = Fixture::new();
        let (mut once, header) = fixture.client(&[]);
        assert_eq!((header["type"].as_str(), header["callerid"].as_str()), ("ambf_msgs/AddModel", "/node"));
        assert_eq!(header["md5sum"], AddModel::md5sum());
        let (success, answer) = ask(&mut once, &request("car.yaml"));
        assert!(success);
        assert_eq!(AddModelRes::decode(&answer[..]).unwrap().model, "car.yaml");
        assert_closed(&mut once);
        let (mut persistent, _) = fixture.client(&[("persistent", "1"), ("md5sum", "*")]);
        for file in ["a", "b", ""] {
            let (success, answer) = ask(&mut persistent, &request(file));
            assert!(success);
            assert_eq!(AddModelRes::decode(&answer[..]).unwrap().model, file);
        }
    }

    #[test]
    fn a_probe_is_told_the_type() {
        let (mut stream, header) = Fixture::new().client(&[("probe", "1"), ("md5sum", "*")]);
        assert_eq!((header["type"].as_str(), header["service"].as_str()), ("ambf_msgs/AddModel", NAME));
        assert_closed(&mut stream);
    }

    #[test]
    fn who_means_something_else_is_told_so() {
        let fixture = Fixture::new();
        for (field, value) in [("md5sum", "992ce8a1687cec8c8bd883ec73ca41d1"), ("service", "/other")] {
            let (mut stream, header) = fixture.client(&[(field, value)]);
            assert!(header["error"].contains(value), "{header:?}");
            assert_closed(&mut stream);
        }
    }

    #[test]
    fn bytes_that_are_no_request_are_refused_and_the_service_goes_on() {
        let fixture = Fixture::new();
        let (mut stream, _) = fixture.client(&[("persistent", "1")]);
        let mut lying = request("car.yaml");
        lying[4..8].copy_from_slice(&u32::MAX.to_le_bytes());
        let text = |answer: Vec<u8>| String::from_utf8(answer).unwrap();
        let (success, why) = ask(&mut stream, &lying);
        assert!(!success && text(why).contains("AddModel"));
        let (success, why) = ask(&mut stream, &(u32::MAX).to_le_bytes());
        assert!(!success && text(why).contains("4294967295 bytes"));
        assert_closed(&mut stream);
        for header in [&[0; 4][..], &[255; 200], &[8, 0, 0, 0, 255, 255, 255, 255, 1, 2, 3, 4]] {
            let mut stream = fixture.connect();
            stream.write_all(header).unwrap();
            let _ = read_block(&mut stream);
        }
        assert!(ask(&mut fixture.client(&[]).0, &request("car.yaml")).0);
    }

    #[test]
    fn silent_clients_keep_nobody_out_until_there_are_too_many() {
        let fixture = Fixture::new();
        let mut silent: Vec<_> = (1..MAX_CONNECTIONS).map(|_| fixture.connect()).collect();
        assert!(ask(&mut fixture.client(&[]).0, &request("car.yaml")).0);
        silent.extend([fixture.connect(), fixture.connect()]);
        let deadline = std::time::Instant::now() + Duration::from_secs(20);
        let count = || fixture.open.connections.clients.lock().as_ref().unwrap().len();
        while count() < MAX_CONNECTIONS {
            assert!(std::time::Instant::now() < deadline);
            std::thread::sleep(Duration::from_millis(1));
        }
        assert_closed(&mut fixture.connect());
        drop(silent);
        while count() > 0 {
            assert!(std::time::Instant::now() < deadline);
            std::thread::sleep(Duration::from_millis(1));
        }
        assert!(ask(&mut fixture.client(&[]).0, &request("car.yaml")).0);
    }

    #[test]
    fn closing_ends_everything() {
        let fixture = Fixture::new();
        let (mut stream, _) = fixture.client(&[("persistent", "1")]);
        assert!(ask(&mut stream, &request("car.yaml")).0);
        drop(fixture);
        assert_closed(&mut stream);
    }
}
