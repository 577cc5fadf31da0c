//! Calls to a ROS master or node, with a time-out.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use dxr::{FaultResponse, MethodCall, MethodResponse, Value};
use thiserror::Error;

use super::address::resolve;
use super::calls::is_too_deep;

/// Longest answer that is read, bytes: the parameter tree of one object is far smaller.
const MAX_ANSWER: u64 = 16 << 20;

/// Error when a call to a master or node did not succeed.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CallError {
    /// Error when an address is not `http://HOST:PORT/`.
    #[error(
        "\"{0}\" is not an address of a ROS master: expected http://HOST:PORT/, for example http://localhost:11311/"
    )]
    BadUri(String),
    /// Error when nobody answers in time.
    #[error("{uri} does not answer: {reason}")]
    NoAnswer {
        /// Who was asked.
        uri: String,
        /// What the system says.
        reason: std::io::Error,
    },
    /// Error when somebody answers who does not speak XML-RPC.
    #[error("{0} answers, but not like a ROS master")]
    NotRos(String),
    /// Error when the call was understood and refused.
    #[error("{method} was refused: {reason}")]
    Refused {
        /// What was asked for.
        method: String,
        /// What was answered.
        reason: String,
    },
}

impl CallError {
    /// Whether the other side was there and said no, in contrast to not being reached.
    pub fn is_refusal(&self) -> bool {
        matches!(self, Self::Refused { .. })
    }
}

/// A master or node that can be called. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Peer {
    uri: String,
    host: String,
    port: u16,
    caller_id: String,
    timeout: Duration,
}

impl Peer {
    /// The peer at `uri` (`http://HOST:PORT/`), called in the name of `caller_id`. `timeout` holds for connecting and
    /// for each wait for data.
    ///
    /// # Errors
    /// [`CallError::BadUri`].
    pub fn new(uri: &str, caller_id: &str, timeout: Duration) -> Result<Self, CallError> {
        let bad = || CallError::BadUri(uri.to_owned());
        let rest = uri.trim().strip_prefix("http://").ok_or_else(bad)?;
        let authority = rest.split('/').next().unwrap_or_default();
        let (host, port) = authority.rsplit_once(':').unwrap_or((authority, "11311"));
        let host = host.trim_start_matches('[').trim_end_matches(']');
        let port = port.parse().map_err(|_| bad())?;
        if host.is_empty() || port == 0 {
            return Err(bad());
        }
        Ok(Self { uri: uri.trim().to_owned(), host: host.to_owned(), port, caller_id: caller_id.to_owned(), timeout })
    }

    /// The same peer, called in another name.
    pub fn called_by(&self, caller_id: &str) -> Self {
        Self { caller_id: caller_id.to_owned(), ..self.clone() }
    }

    /// In whose name it is called.
    pub fn caller(&self) -> &str {
        &self.caller_id
    }

    /// Its address as given.
    pub fn uri(&self) -> &str {
        &self.uri
    }

    /// Its socket addresses; resolving a name may take seconds. `localhost` is 127.0.0.1 where the system does not know it.
    ///
    /// # Errors
    /// [`CallError::NoAnswer`] when the name is unknown.
    pub fn addresses(&self) -> Result<Vec<SocketAddr>, CallError> {
        resolve(&self.host, self.port).map_err(|error| self.no_answer(error))
    }

    fn no_answer(&self, reason: std::io::Error) -> CallError {
        // A socket's time-out is called "resource temporarily unavailable".
        let reason = match reason.kind() {
            ErrorKind::WouldBlock => std::io::Error::new(ErrorKind::TimedOut, "it took too long"),
            _ => reason,
        };
        CallError::NoAnswer { uri: self.uri.clone(), reason }
    }

    /// Calls `method` with the caller's name and `arguments`, and returns the third part of `[1, message, value]`.
    ///
    /// # Errors
    /// [`CallError::NoAnswer`], [`CallError::NotRos`], and [`CallError::Refused`] when the code is not 1.
    pub fn call(&self, method: &str, arguments: Vec<Value>) -> Result<Value, CallError> {
        let answer = self.ask(method, arguments)?;
        self.value_of(method, &answer)
    }

    /// The same, for a question that is asked again and again: `None` when the hash of the answer is `last`, and it need
    /// not be looked at. `last` becomes the hash of the answer if it is a good one.
    ///
    /// # Errors
    /// Those of [`call`](Self::call).
    pub(crate) fn call_unless(
        &self,
        method: &str,
        arguments: Vec<Value>,
        last: &mut Option<u64>,
    ) -> Result<Option<Value>, CallError> {
        let answer = self.ask(method, arguments)?;
        let mut hasher = DefaultHasher::new();
        answer.hash(&mut hasher);
        let hash = Some(hasher.finish());
        if hash == *last {
            return Ok(None);
        }
        let value = self.value_of(method, &answer)?;
        *last = hash;
        Ok(Some(value))
    }

    fn not_ros(&self) -> CallError {
        CallError::NotRos(self.uri.clone())
    }

    /// The XML of a call.
    fn body(&self, method: &str, arguments: Vec<Value>) -> Result<String, CallError> {
        let mut params = vec![Value::String(self.caller_id.clone())];
        params.extend(arguments);
        MethodCall { name: method.into(), params }.to_xml().map_err(|_| self.not_ros())
    }

    /// The XML that is answered.
    fn ask(&self, method: &str, arguments: Vec<Value>) -> Result<String, CallError> {
        let body = self.body(method, arguments)?;
        let answer = self.post(&body).map_err(|e| self.no_answer(e))?;
        // The head has the time in it.
        let (_head, xml) = answer.split_once("\r\n\r\n").ok_or_else(|| self.not_ros())?;
        Ok(xml.trim().to_owned())
    }

    fn value_of(&self, method: &str, xml: &str) -> Result<Value, CallError> {
        let refused = |reason: String| CallError::Refused { method: method.to_owned(), reason };
        if is_too_deep(xml) {
            return Err(self.not_ros());
        }
        let value = match MethodResponse::from_xml(xml) {
            Ok(response) => response.value,
            Err(_) => match FaultResponse::from_xml(xml) {
                Ok(response) => return Err(refused(response.fault.string().to_owned())),
                Err(_) => return Err(self.not_ros()),
            },
        };
        match value {
            Value::Array(parts) => match <[Value; 3]>::try_from(parts) {
                Ok([Value::Integer(1), _, value]) => Ok(value),
                Ok([_, Value::String(message), _]) => Err(refused(message)),
                _ => Err(self.not_ros()),
            },
            _ => Err(self.not_ros()),
        }
    }

    /// HTTP/1.0, so that the answer ends with the connection and is never chunked.
    fn post(&self, body: &str) -> std::io::Result<String> {
        let mut stream = self.connect()?;
        stream.write_all(self.request(body, "1.0").as_bytes())?;
        let mut answer = Vec::new();
        stream.take(MAX_ANSWER).read_to_end(&mut answer)?;
        Ok(String::from_utf8_lossy(&answer).into_owned())
    }

    fn connect(&self) -> std::io::Result<TcpStream> {
        let mut last = std::io::Error::from(ErrorKind::AddrNotAvailable);
        for address in resolve(&self.host, self.port)? {
            match TcpStream::connect_timeout(&address, self.timeout) {
                Ok(stream) => {
                    stream.set_nodelay(true)?;
                    stream.set_read_timeout(Some(self.timeout))?;
                    stream.set_write_timeout(Some(self.timeout))?;
                    return Ok(stream);
                }
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    fn request(&self, body: &str, version: &str) -> String {
        let (host, port, length) = (&self.host, self.port, body.len());
        format!(
            "POST /RPC2 HTTP/{version}\r\nHost: {host}:{port}\r\nContent-Type: text/xml\r\nContent-Length: {length}\r\n\r\n{body}"
        )
    }
}

/// Calls to one peer over one connection, for many calls in a row.
pub(crate) struct Session {
    peer: Peer,
    stream: Option<TcpStream>,
    /// It did not answer: further calls fail at once.
    given_up: bool,
}

impl Session {
    pub fn new(peer: Peer) -> Self {
        Self { peer, stream: None, given_up: false }
    }

    /// Fails all further calls.
    pub fn give_up(&mut self) {
        self.given_up = true;
    }

    /// As [`Peer::call`].
    ///
    /// # Errors
    /// The same.
    pub fn call(&mut self, method: &str, arguments: Vec<Value>) -> Result<Value, CallError> {
        if self.given_up {
            return Err(self.peer.no_answer(ErrorKind::TimedOut.into()));
        }
        let body = self.peer.body(method, arguments)?;
        // A connection that was kept may have been closed meanwhile: then a new one is tried.
        if let Some(stream) = self.stream.take() {
            match self.exchange(stream, &body) {
                Ok(xml) => return self.peer.value_of(method, &xml),
                // It is there and takes too long.
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    return Err(self.peer.no_answer(error))
                }
                Err(_) => (),
            }
        }
        let exchanged = self.peer.connect().and_then(|stream| self.exchange(stream, &body));
        let xml = exchanged.map_err(|error| self.peer.no_answer(error))?;
        self.peer.value_of(method, &xml)
    }

    /// Sends `body` and returns the body of the answer; keeps the connection if the peer does.
    fn exchange(&mut self, mut stream: TcpStream, body: &str) -> std::io::Result<String> {
        stream.write_all(self.peer.request(body, "1.1").as_bytes())?;
        let (mut answer, mut chunk) = (Vec::new(), [0; 4096]);
        let head_end = loop {
            if let Some(end) = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n") {
                break end;
            }
            match stream.read(&mut chunk)? {
                0 => return Err(ErrorKind::UnexpectedEof.into()),
                count => answer.extend_from_slice(&chunk[..count]),
            }
            if answer.len() as u64 > MAX_ANSWER {
                return Err(ErrorKind::InvalidData.into());
            }
        };
        let head = String::from_utf8_lossy(&answer[..head_end]).to_ascii_lowercase();
        let mut answer = answer.split_off(head_end + 4);
        let field = |key: &str| head.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(':').map(str::trim));
        let length = field("content-length").and_then(|length| length.parse::<u64>().ok());
        match length {
            Some(length) if length <= MAX_ANSWER => {
                let missing = length.saturating_sub(answer.len() as u64);
                (&stream).take(missing).read_to_end(&mut answer)?;
                if (answer.len() as u64) < length {
                    return Err(ErrorKind::UnexpectedEof.into());
                }
                let is_kept = field("connection").map_or(head.starts_with("http/1.1"), |value| value == "keep-alive");
                self.stream = is_kept.then_some(stream);
            }
            Some(_) => return Err(ErrorKind::InvalidData.into()),
            // It ends with the connection.
            None => {
                stream.take(MAX_ANSWER).read_to_end(&mut answer)?;
            }
        }
        Ok(String::from_utf8_lossy(&answer).into_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    fn peer(port: u16, timeout_ms: u64) -> Peer {
        Peer::new(&format!("http://127.0.0.1:{port}"), "/me", Duration::from_millis(timeout_ms)).unwrap()
    }

    /// Answers one call with `xml`.
    fn answering(xml: &'static str) -> u16 {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let mut request = [0; 4096];
            let _ = stream.read(&mut request);
            let _ = write!(stream, "HTTP/1.0 200 OK\r\nContent-Type: text/xml\r\n\r\n{xml}");
        });
        port
    }

    #[test]
    fn addresses_are_checked() {
        for bad in ["", "localhost:11311", "http://", "http://host:no", "http://:1", "https://host:1", "http://h:0"] {
            assert!(Peer::new(bad, "/me", Duration::ZERO).is_err(), "{bad}");
        }
        let ipv6 = Peer::new("http://[::1]:11311/", "/me", Duration::ZERO).unwrap();
        assert_eq!(ipv6.addresses().unwrap(), ["[::1]:11311".parse().unwrap()]);
    }

    #[test]
    fn answers_are_told_apart() {
        let ok = "<?xml version='1.0'?><methodResponse><params><param><value><array><data><value><int>1</int></value>\
                  <value><string></string></value><value><int>7</int></value></data></array></value></param></params></methodResponse>";
        assert_eq!(peer(answering(ok), 1000).call("getPid", vec![]).unwrap(), Value::Integer(7));
        let refused = "<?xml version='1.0'?><methodResponse><params><param><value><array><data><value><int>-1</int></value>\
                  <value><string>unknown node</string></value><value><string></string></value></data></array></value></param></params></methodResponse>";
        let error = peer(answering(refused), 1000).call("lookupNode", vec![]).unwrap_err();
        assert!(error.is_refusal() && error.to_string().contains("unknown node"), "{error}");
        let error = peer(answering("<html>hello</html>"), 1000).call("getPid", vec![]).unwrap_err();
        assert!(matches!(error, CallError::NotRos(_)), "{error}");
    }

    #[test]
    fn one_who_accepts_and_is_silent_is_given_up() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let error = peer(listener.local_addr().unwrap().port(), 100).call("getPid", vec![]).unwrap_err();
        assert!(matches!(error, CallError::NoAnswer { .. }), "{error}");
    }
}
