//! Answers to calls of other nodes: XML-RPC over HTTP/1.1, several calls a connection.

use std::io::{ErrorKind, Write};
use std::net::{IpAddr, SocketAddr, TcpStream};
use std::os::fd::{AsRawFd, RawFd};
use std::sync::Arc;
use std::time::{Duration, Instant};

use dxr::{MethodCall, MethodResponse, Value};

use super::connections::{Buffer, Came, Place};
use super::reactor::{Handler, Turn};

/// Longest call, bytes: a parameter tree at most.
const LONGEST: usize = 4 << 20;

/// Longest head of a request, bytes.
const MAX_HEAD: usize = 16 << 10;

/// Deepest nesting of lists and structures. The reader of XML calls itself for each, and a stack is finite.
const DEEPEST: usize = 64;

/// How long a client may take for its call and for reading the answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// How long a connection may be idle between two calls.
const IDLE: Duration = Duration::from_secs(30);

/// What can be called. It must not wait for anybody.
pub(crate) trait Methods: Send + Sync {
    /// Answers `[code, message, value]` to a call from the machine `from`. The caller's name is the first of
    /// `arguments`.
    fn call(&self, method: &str, arguments: &[Value], from: IpAddr) -> Value;
}

/// `[code, message, value]`, with which nodes and masters answer.
pub(crate) fn answer(code: i32, message: &str, value: Value) -> Value {
    Value::Array(vec![Value::Integer(code), Value::String(message.to_owned()), value])
}

/// A text as a value.
pub(crate) fn text(text: &str) -> Value {
    Value::String(text.to_owned())
}

/// The text at `place` of `arguments`; empty if there is none.
pub(crate) fn text_at(arguments: &[Value], place: usize) -> &str {
    match arguments.get(place) {
        Some(Value::String(text)) => text,
        _ => "",
    }
}

/// Whether lists and structures of `xml` are nested deeper than a reader can bear.
pub(crate) fn is_too_deep(xml: &str) -> bool {
    let mut depth = 0usize;
    for tag in xml.split('<').skip(1) {
        if tag.starts_with("array") || tag.starts_with("struct") {
            depth += 1;
        } else if tag.starts_with("/array") || tag.starts_with("/struct") {
            depth = depth.saturating_sub(1);
        }
        if depth > DEEPEST {
            return true;
        }
    }
    false
}

/// A client that calls.
pub(crate) struct Client {
    stream: TcpStream,
    from: IpAddr,
    methods: Arc<dyn Methods>,
    input: Buffer,
    output: Vec<u8>,
    written: usize,
    /// The connection ends with the answer.
    is_last: bool,
    deadline: Instant,
    _place: Place,
}

impl Client {
    /// `stream` does not block.
    pub fn new(stream: TcpStream, methods: Arc<dyn Methods>, place: Place) -> Self {
        let nobody = IpAddr::from([0, 0, 0, 0]);
        let from = stream.peer_addr().map_or(nobody, |address: SocketAddr| address.ip().to_canonical());
        let _ = stream.set_nodelay(true);
        let (input, output) = (Buffer::default(), Vec::new());
        let deadline = Instant::now() + PATIENCE;
        Self { stream, from, methods, input, output, written: 0, is_last: false, deadline, _place: place }
    }

    /// Writes what is left of an answer; whether all of it is written.
    fn flush(&mut self) -> Result<bool, ()> {
        while self.written < self.output.len() {
            match self.stream.write(&self.output[self.written..]) {
                Ok(count) => self.written += count,
                Err(error) if error.kind() == ErrorKind::Interrupted => (),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(false),
                Err(_) => return Err(()),
            }
        }
        self.output.clear();
        self.written = 0;
        Ok(true)
    }

    /// Answers the next call that is complete; whether there was one. An error means that the connection is of no use.
    fn answer_next(&mut self) -> Result<bool, ()> {
        let rest = self.input.rest();
        let Some(head) = rest.windows(4).position(|bytes| bytes == b"\r\n\r\n") else {
            return if rest.len() > MAX_HEAD { Err(()) } else { Ok(false) };
        };
        let request = Head::read(&rest[..head]).ok_or(())?;
        let begin = head + 4;
        if rest.len() < begin + request.length {
            return Ok(false);
        }
        let body = String::from_utf8_lossy(&rest[begin..begin + request.length]).into_owned();
        self.input.take(begin + request.length);
        let value = self.value(&body);
        let xml = MethodResponse { value }.to_xml().map_err(|_| ())?;
        self.is_last = !request.keep_alive;
        let connection = if self.is_last { "close" } else { "keep-alive" };
        // A client that speaks HTTP/1.0 is answered in it: it need not know keep-alive.
        let version = if request.is_1_0 { "1.0" } else { "1.1" };
        let head = format!(
            "HTTP/{version} 200 OK\r\nContent-Type: text/xml\r\nConnection: {connection}\r\nContent-Length: {}\r\n\r\n",
            xml.len()
        );
        self.output.extend(head.bytes());
        self.output.extend(xml.bytes());
        Ok(true)
    }

    fn value(&self, body: &str) -> Value {
        if is_too_deep(body) {
            return answer(-1, "lists and structures are nested too deep", Value::Integer(0));
        }
        match MethodCall::from_xml(body) {
            Ok(call) => self.methods.call(&call.name, &call.params, self.from),
            Err(_) => answer(-1, "this is no call of XML-RPC", Value::Integer(0)),
        }
    }
}

/// What counts in the head of a request.
struct Head {
    length: usize,
    keep_alive: bool,
    is_1_0: bool,
}

impl Head {
    fn read(bytes: &[u8]) -> Option<Self> {
        let head = std::str::from_utf8(bytes).ok()?.to_ascii_lowercase();
        let mut lines = head.lines();
        let first = lines.next()?;
        let (mut length, mut connection) = (None, None);
        for (key, value) in lines.filter_map(|line| line.split_once(':')) {
            match key.trim() {
                "content-length" => length = value.trim().parse().ok(),
                "connection" => connection = Some(value.trim().to_owned()),
                _ => (),
            }
        }
        let is_1_0 = !first.ends_with("http/1.1");
        let keep_alive = match connection.as_deref() {
            Some("close") => false,
            Some("keep-alive") => true,
            _ => !is_1_0,
        };
        Some(Self { length: length.filter(|length| *length <= LONGEST)?, keep_alive, is_1_0 })
    }
}

impl Handler for Client {
    fn socket(&self) -> RawFd {
        self.stream.as_raw_fd()
    }

    fn ready(&mut self) -> Turn {
        match self.flush() {
            Ok(true) if self.is_last => return Turn::Done,
            Ok(true) => (),
            Ok(false) => return Turn::Wait,
            Err(()) => return Turn::Done,
        }
        match self.answer_next() {
            Ok(true) => {
                self.deadline = Instant::now() + IDLE;
                return Turn::Again;
            }
            Ok(false) => (),
            Err(()) => return Turn::Done,
        }
        match self.input.read(&self.stream) {
            Came::Bytes(_) => Turn::Again,
            Came::Nothing => Turn::Wait,
            Came::End => Turn::Done,
        }
    }

    fn deadline(&self) -> Option<Instant> {
        Some(self.deadline)
    }
}
