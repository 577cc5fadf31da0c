//! The subscriber's side of TCPROS: a header of `key=value` fields each way, then messages, each behind its length.
//!
//! Nothing is taken for granted about what a publisher sends: memory grows with the bytes that arrive, not with a
//! length that is announced, and the exchange of headers ends at a fixed time.

use std::collections::HashMap;
use std::io::{self, BufReader, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use rosrust::Message;
use thiserror::Error;

/// How long a publisher may take to answer our header.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);

/// Longest header that is read, bytes: the definition of a message is in it.
const LONGEST_HEADER: usize = 1 << 20;

/// How often a thread without messages looks whether it should end.
const GLANCE: Duration = Duration::from_millis(500);

/// How much memory is made ready for bytes that have been announced only, bytes.
const STEP: usize = 64 << 10;

/// Longest text of a publisher that is repeated to the user, characters.
const LONGEST_QUOTE: usize = 200;

/// Messages that are wanted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Wanted {
    /// `package/Type`, or `*` for any.
    pub kind: String,
    /// Checksum of the type's definition, or `*` for any.
    pub md5sum: String,
    /// The type's definition with all that it is made of.
    pub definition: String,
    /// Longest message, bytes.
    pub longest: usize,
}

impl Wanted {
    /// Any message.
    pub fn any(longest: usize) -> Self {
        Self { kind: "*".into(), md5sum: "*".into(), definition: String::new(), longest }
    }

    /// Messages of type `M`.
    pub fn of<M: Message>(longest: usize) -> Self {
        Self { kind: M::msg_type(), md5sum: M::md5sum(), definition: M::msg_definition(), longest }
    }
}

/// Error when a publisher is not listened to, or not any more.
#[derive(Debug, Error)]
pub(crate) enum SubscribeError {
    /// Error when it is not there, or goes: programs come and go, which is nothing to talk about.
    #[error(transparent)]
    Gone(#[from] io::Error),
    /// Error when there is no way to it: worth a word if it stays like that.
    #[error("{0}")]
    OutOfReach(String),
    /// Error when it does what publishers don't do: worth a word.
    #[error("{0}")]
    Fault(String),
}

/// A connection to a publisher.
pub(crate) struct Incoming<'a, S> {
    reader: BufReader<&'a TcpStream>,
    /// Whether it is time to end.
    stopped: S,
}

impl<'a, S: Fn() -> bool> Incoming<'a, S> {
    /// Bytes from `stream`, until `stopped` says so.
    ///
    /// # Errors
    /// When the connection is down.
    pub fn new(stream: &'a TcpStream, stopped: S) -> io::Result<Self> {
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(GLANCE))?;
        stream.set_write_timeout(Some(GLANCE))?;
        Ok(Self { reader: BufReader::new(stream), stopped })
    }

    /// Says that the node `own` wants `wanted` of `topic`; returns the type that the publisher announces.
    ///
    /// # Errors
    /// [`SubscribeError::Fault`] when the publisher is silent, refuses, or has messages of another type.
    pub fn shake_hands(&mut self, own: &str, topic: &str, wanted: &Wanted) -> Result<String, SubscribeError> {
        let Wanted { kind, md5sum, definition, .. } = wanted;
        let header = header_of(&[
            ("callerid", own),
            ("topic", topic),
            ("type", kind),
            ("md5sum", md5sum),
            ("message_definition", definition),
            ("tcp_nodelay", "1"),
        ]);
        let mut stream: &TcpStream = self.reader.get_ref();
        stream.write_all(&header)?;
        let mut answer = Vec::new();
        let silent = |trouble| match trouble {
            SubscribeError::Gone(error) if error.kind() == ErrorKind::TimedOut => SubscribeError::Fault(format!(
                "it takes the connection and says nothing within {} s",
                HANDSHAKE_TIMEOUT.as_secs()
            )),
            trouble => trouble,
        };
        self.read_block(&mut answer, LONGEST_HEADER, Some(Instant::now() + HANDSHAKE_TIMEOUT)).map_err(silent)?;
        let fields = fields(&answer);
        if let Some(why) = fields.get("error") {
            return Err(SubscribeError::Fault(format!("it refuses us: {}", quote(why))));
        }
        let field = |key: &str| fields.get(key).map(String::as_str).unwrap_or_default();
        let differs = |wanted: &str, key: &str| wanted != "*" && wanted != field(key);
        if field("type").is_empty() {
            return Err(SubscribeError::Fault("its answer is no header of a publisher".into()));
        }
        if differs(kind, "type") || differs(md5sum, "md5sum") {
            return Err(SubscribeError::Fault(format!(
                "it sends {} with the checksum {}, expected {kind} with {md5sum}: a program with another version of the message",
                quote(field("type")),
                quote(field("md5sum")),
            )));
        }
        Ok(field("type").to_owned())
    }

    /// Reads the next message into `message`, however long that takes.
    ///
    /// # Errors
    /// [`SubscribeError::Gone`] at the end, [`SubscribeError::Fault`] when more than `longest` bytes are announced.
    pub fn read_message(&mut self, message: &mut Vec<u8>, longest: usize) -> Result<(), SubscribeError> {
        self.read_block(message, longest, None)
    }

    fn read_block(
        &mut self,
        block: &mut Vec<u8>,
        longest: usize,
        deadline: Option<Instant>,
    ) -> Result<(), SubscribeError> {
        let mut length = [0; 4];
        self.fill(&mut length, deadline)?;
        let length = u32::from_le_bytes(length) as usize;
        if length > longest {
            return Err(SubscribeError::Fault(format!("it announces {length} bytes, {longest} are the most")));
        }
        block.clear();
        while block.len() < length {
            let begin = block.len();
            block.resize(length.min(begin + STEP), 0);
            self.fill(&mut block[begin..], deadline)?;
        }
        Ok(())
    }

    fn fill(&mut self, mut rest: &mut [u8], deadline: Option<Instant>) -> io::Result<()> {
        while !rest.is_empty() {
            if deadline.is_some_and(|deadline| Instant::now() >= deadline) {
                return Err(ErrorKind::TimedOut.into());
            }
            match self.reader.read(rest) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(count) => rest = &mut rest[count..],
                Err(error) if error.kind() == ErrorKind::Interrupted => (),
                // A socket's time-out has either name.
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    if (self.stopped)() {
                        return Err(ErrorKind::Interrupted.into());
                    }
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

/// `text` for a line to the user: printable, and not longer than that.
pub(crate) fn quote(text: &str) -> String {
    let printable = text.trim().chars().map(|c| if c.is_control() { ' ' } else { c });
    let mut quoted: String = printable.take(LONGEST_QUOTE).collect();
    if text.chars().nth(LONGEST_QUOTE).is_some() {
        quoted.push('…');
    }
    if quoted.is_empty() {
        quoted.push_str("(nothing)");
    }
    quoted
}

/// The fields of a connection header without its length; what is no field is left out.
pub fn fields(mut header: &[u8]) -> HashMap<String, String> {
    let mut fields = HashMap::new();
    while let Some((length, rest)) = header.split_first_chunk::<4>() {
        let length = u32::from_le_bytes(*length) as usize;
        let Some((field, rest)) = rest.split_at_checked(length) else { break };
        header = rest;
        if let Some((key, value)) = std::str::from_utf8(field).ok().and_then(|field| field.split_once('=')) {
            fields.insert(key.to_owned(), value.to_owned());
        }
    }
    fields
}

/// `text` behind its length. No text of ours comes near 4 GB.
pub fn block(text: &[u8]) -> Vec<u8> {
    let mut block = (text.len() as u32).to_le_bytes().to_vec();
    block.extend(text);
    block
}

/// A connection header of these fields, behind its length.
pub fn header_of(fields: &[(&str, &str)]) -> Vec<u8> {
    let fields: Vec<u8> = fields.iter().flat_map(|(key, value)| block(format!("{key}={value}").as_bytes())).collect();
    block(&fields)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;
    use std::sync::atomic::{AtomicBool, Ordering};

    fn wanted() -> Wanted {
        Wanted { kind: "a/B".into(), md5sum: "12".into(), definition: "bool x".into(), longest: 100 }
    }

    /// What a subscriber of `wanted` makes of a publisher that reads our header and sends `bytes`: the type, and
    /// messages until the end.
    fn listen(wanted: &Wanted, bytes: Vec<u8>) -> Result<(String, Vec<Vec<u8>>, SubscribeError), SubscribeError> {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let stream = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let publisher = std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let mut length = [0; 4];
            stream.read_exact(&mut length).unwrap();
            let mut header = vec![0; u32::from_le_bytes(length) as usize];
            stream.read_exact(&mut header).unwrap();
            // The subscriber may have closed it already.
            let _ = stream.write_all(&bytes);
            fields(&header)
        });
        let mut incoming = Incoming::new(&stream, || false).unwrap();
        let result = incoming.shake_hands("/me", "/t", wanted).map(|kind| {
            let (mut messages, mut message) = (Vec::new(), Vec::new());
            loop {
                match incoming.read_message(&mut message, wanted.longest) {
                    Ok(()) => messages.push(message.clone()),
                    Err(trouble) => return (kind, messages, trouble),
                }
            }
        });
        let told = publisher.join().unwrap();
        assert_eq!(
            (told["callerid"].as_str(), told["topic"].as_str(), told["tcp_nodelay"].as_str()),
            ("/me", "/t", "1")
        );
        assert_eq!((told["type"].as_str(), told["md5sum"].as_str()), (wanted.kind.as_str(), wanted.md5sum.as_str()));
        result
    }

    fn good() -> Vec<u8> {
        header_of(&[("callerid", "/you"), ("md5sum", "12"), ("type", "a/B")])
    }

    fn fault<T: std::fmt::Debug>(result: Result<T, SubscribeError>) -> String {
        match result.unwrap_err() {
            SubscribeError::Fault(what) => what,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn every_message_of_a_burst_arrives() {
        let mut bytes = good();
        let burst: Vec<Vec<u8>> = (0..1000u32).map(|i| i.to_le_bytes()[..(i % 5) as usize].to_vec()).collect();
        burst.iter().for_each(|message| bytes.extend(block(message)));
        for wanted in [wanted(), Wanted::any(100)] {
            let (kind, messages, end) = listen(&wanted, bytes.clone()).unwrap();
            assert_eq!((kind.as_str(), &messages), ("a/B", &burst));
            assert!(matches!(end, SubscribeError::Gone(_)), "{end}");
        }
    }

    #[test]
    fn other_types_and_refusals_are_told() {
        let other = |kind: &str, sum: &str| fault(listen(&wanted(), header_of(&[("md5sum", sum), ("type", kind)])));
        assert!(other("a/B", "13").contains("a/B with the checksum 13, expected a/B with 12"));
        assert!(other("a/C", "12").contains("it sends a/C"));
        assert!(other("a/B", "*").contains("checksum *"), "any type is no type");
        let refusal = fault(listen(&wanted(), header_of(&[("error", &format!("no\nway{}", "!".repeat(1000)))])));
        assert!(refusal.starts_with("it refuses us: no way!!!") && refusal.chars().count() < 250, "{refusal}");
        assert!(fault(listen(&wanted(), block(b"nonsense"))).contains("no header"));
        assert!(fault(listen(&Wanted::any(1), header_of(&[]))).contains("no header"));
    }

    #[test]
    fn announced_lengths_cost_nothing() {
        let huge = u32::MAX.to_le_bytes();
        assert!(fault(listen(&wanted(), huge.to_vec())).contains("it announces 4294967295 bytes"));
        let (_, messages, end) = listen(&wanted(), [good(), block(b"x"), huge.to_vec()].concat()).unwrap();
        assert_eq!(messages, [b"x"]);
        assert!(
            matches!(&end, SubscribeError::Fault(what) if what.contains("4294967295 bytes, 100 are the most")),
            "{end}"
        );
        // Within the limit, but cut short.
        let length = (1u32 << 30).to_le_bytes();
        let (_, messages, end) =
            listen(&Wanted::any(1 << 30), [good(), length.to_vec(), vec![0; 10]].concat()).unwrap();
        assert!(messages.is_empty() && matches!(end, SubscribeError::Gone(_)), "{end}");
    }

    #[test]
    fn one_who_is_silent_is_left_when_it_is_time_to_end() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let stream = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let stop = AtomicBool::new(false);
        std::thread::scope(|scope| {
            let incoming = Incoming::new(&stream, || stop.load(Ordering::Relaxed));
            let thread = scope.spawn(move || incoming.unwrap().shake_hands("/me", "/t", &wanted()));
            stop.store(true, Ordering::Relaxed);
            assert!(matches!(thread.join().unwrap(), Err(SubscribeError::Gone(_))));
        });
        stop.store(false, Ordering::Relaxed);
        let mut incoming = Incoming::new(&stream, || stop.load(Ordering::Relaxed)).unwrap();
        assert!(fault(incoming.shake_hands("/me", "/t", &wanted())).contains("says nothing within 5 s"));
    }

    #[test]
    fn fields_are_found_in_a_header() {
        let header = header_of(&[("type", "std_msgs/Bool"), ("definition", "a=b"), ("empty", "")]);
        let found = fields(&header[4..]);
        assert_eq!(
            (found["type"].as_str(), found["definition"].as_str(), found["empty"].as_str()),
            ("std_msgs/Bool", "a=b", "")
        );
        assert!(fields(&[255, 255, 255, 255, 1]).is_empty() && fields(&[]).is_empty());
    }
}
