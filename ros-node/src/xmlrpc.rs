//! Calls to a ROS master or node with a time-out: rosrust's own client waits for ever and caches parameters.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs};
use std::time::Duration;

use dxr::{FaultResponse, MethodCall, MethodResponse, Value};
use thiserror::Error;

/// Longest answer that is read, bytes: the parameter tree of one object is far smaller.
const LONGEST_ANSWER: u64 = 16 << 20;

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

    /// Its socket addresses; resolving a name may take seconds.
    ///
    /// # Errors
    /// [`CallError::NoAnswer`] when the name is unknown.
    pub fn addresses(&self) -> Result<Vec<SocketAddr>, CallError> {
        (self.host.as_str(), self.port).to_socket_addrs().map(Iterator::collect).map_err(|e| self.no_answer(e))
    }

    fn no_answer(&self, reason: std::io::Error) -> CallError {
        // A socket's time-out is called "resource temporarily unavailable".
        let reason = match reason.kind() {
            std::io::ErrorKind::WouldBlock => std::io::Error::new(std::io::ErrorKind::TimedOut, "it took too long"),
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

    /// The same, for a question that is asked again and again: `None` when the answer is `last`, letter by letter, and
    /// need not be looked at. `last` becomes the answer if it is a good one.
    ///
    /// # Errors
    /// Those of [`call`](Self::call).
    pub(crate) fn call_unless(
        &self,
        method: &str,
        arguments: Vec<Value>,
        last: &mut String,
    ) -> Result<Option<Value>, CallError> {
        let answer = self.ask(method, arguments)?;
        if answer == *last {
            return Ok(None);
        }
        let value = self.value_of(method, &answer)?;
        *last = answer;
        Ok(Some(value))
    }

    fn not_ros(&self) -> CallError {
        CallError::NotRos(self.uri.clone())
    }

    /// The XML that is answered.
    fn ask(&self, method: &str, arguments: Vec<Value>) -> Result<String, CallError> {
        let mut params = vec![Value::String(self.caller_id.clone())];
        params.extend(arguments);
        let body = MethodCall { name: method.into(), params }.to_xml().map_err(|_| self.not_ros())?;
        let answer = self.post(&body).map_err(|e| self.no_answer(e))?;
        // The head has the time in it.
        let (_head, xml) = answer.split_once("\r\n\r\n").ok_or_else(|| self.not_ros())?;
        Ok(xml.trim().to_owned())
    }

    fn value_of(&self, method: &str, xml: &str) -> Result<Value, CallError> {
        let refused = |reason: String| CallError::Refused { method: method.to_owned(), reason };
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
        let mut last = std::io::Error::from(std::io::ErrorKind::AddrNotAvailable);
        for address in (self.host.as_str(), self.port).to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, self.timeout) {
                Ok(stream) => return self.exchange(stream, body),
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    fn exchange(&self, mut stream: TcpStream, body: &str) -> std::io::Result<String> {
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(self.timeout))?;
        stream.set_write_timeout(Some(self.timeout))?;
        let request = format!(
            "POST /RPC2 HTTP/1.0\r\nHost: {}:{}\r\nContent-Type: text/xml\r\nContent-Length: {}\r\n\r\n{body}",
            self.host,
            self.port,
            body.len()
        );
        stream.write_all(request.as_bytes())?;
        let mut answer = Vec::new();
        stream.take(LONGEST_ANSWER).read_to_end(&mut answer)?;
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
