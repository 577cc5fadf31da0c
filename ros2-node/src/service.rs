//! A service that a node offers, over two topics of DDS.
//!
//! A reply refers to its request in the headers of RTPS (the "enhanced" mapping of DDS-RPC), as Fast DDS and Connext do
//! it. CycloneDDS does it within the messages; its programs cannot call services.

use std::sync::{Arc, Weak};
use std::task::Waker;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use rustdds::bytes::Bytes;
use rustdds::{SampleIdentity, WriteOptionsBuilder, GUID};

use crate::names::{self, TypeName};
use crate::node::Membership;
use crate::participant::{Error, Source};
use crate::publication::{Inner, SendError};
use crate::qos::Qos;
use crate::subscription::Incoming;

/// How long a reply waits for its client's subscription to be found.
const WAIT_FOR_CLIENT: Duration = Duration::from_secs(5);

/// Replies that wait at most; of more the oldest are lost.
const WAITING_REPLIES: usize = 256;

/// Kinds of endpoints that subscribe, the last byte of an identifier: without and with a key (DDSI-RTPS 2.5, table 9.1).
const READERS: [u8; 2] = [0x04, 0x07];

/// Bytes of a participant's identifier, with which those of its endpoints begin.
const PREFIX: usize = 12;

/// A service that a node offers. Dropping it ends that.
pub struct Service {
    inner: Arc<Server>,
}

/// What is done with a request.
type OnRequest = Box<dyn FnMut(Request) + Send>;

struct Server {
    incoming: Incoming,
    replies: Arc<Inner>,
    waiting: Mutex<Vec<Waiting>>,
    on_request: Mutex<OnRequest>,
    own: Weak<Server>,
}

struct Waiting {
    until: Instant,
    to: SampleIdentity,
    body: Bytes,
}

/// A request, to be answered once, from any thread, now or later.
pub struct Request {
    body: Vec<u8>,
    from: SampleIdentity,
    server: Weak<Server>,
}

impl Request {
    /// Its bytes: CDR, little endian, without the four bytes before the body.
    pub fn body(&self) -> &[u8] {
        &self.body
    }

    /// Answers it with the body of a reply. Without effect when the service has ended.
    pub fn reply(self, body: &[u8]) {
        if let Some(server) = self.server.upgrade() {
            server.reply(self.from, Bytes::copy_from_slice(body));
        }
    }
}

impl Service {
    pub(crate) fn new(
        node: Arc<Membership>,
        name: &str,
        type_name: &TypeName,
        longest: usize,
        on_request: OnRequest,
    ) -> Result<Self, Error> {
        let shared = Arc::clone(&node.shared);
        let (requests, replies) = names::dds_service(name);
        let replies = Inner::new(Arc::clone(&node), &replies, name, &type_name.response().dds(), Qos::new())?;
        let incoming = Incoming::new(node, &requests, name, &type_name.request().dds(), Qos::new(), longest)?;
        let source = incoming.source;
        let inner = Arc::new_cyclic(|own| Server {
            incoming,
            replies,
            waiting: Mutex::default(),
            on_request: Mutex::new(on_request),
            own: own.clone(),
        });
        shared.add_source(source, Arc::clone(&inner) as Arc<dyn Source>);
        Ok(Self { inner })
    }

    /// Its name.
    pub fn name(&self) -> &str {
        self.inner.replies.topic()
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.inner.incoming.node.shared.remove_source(self.inner.incoming.source);
    }
}

impl Server {
    fn reply(&self, to: SampleIdentity, body: Bytes) {
        if self.is_found(&to) {
            self.send(to, body);
            return;
        }
        // Its client has just come: what is sent now, it would miss.
        let mut waiting = self.waiting.lock();
        if waiting.len() >= WAITING_REPLIES {
            waiting.remove(0);
        }
        waiting.push(Waiting { until: Instant::now() + WAIT_FOR_CLIENT, to, body });
        drop(waiting);
        self.incoming.node.shared.signal.ready(self.incoming.source);
    }

    fn send(&self, to: SampleIdentity, body: Bytes) {
        let options = WriteOptionsBuilder::new().related_sample_identity(to).build();
        // Full: a client hangs. What it has not read, others cannot be told until the topic has been made anew.
        if let Err(SendError::Full) = self.replies.write(body, options) {
            (self.incoming.node.shared.report())(format_args!("ROS 2: {}: a reply is lost", self.replies.topic()));
        }
        // It may wait.
        self.incoming.node.shared.signal.ready(self.incoming.source);
    }

    /// Whether the client's subscription to replies is known: that which its request names, as those of Fast DDS do; a process may
    /// have had others before. Of a request that names none, any of its participant.
    fn is_found(&self, to: &SampleIdentity) -> bool {
        let client = to.writer_guid.to_bytes();
        let length = if READERS.contains(&client[client.len() - 1]) { client.len() } else { PREFIX };
        self.replies.has_reader(|reader: &GUID| reader.to_bytes()[..length] == client[..length])
    }

    /// Sends replies that have waited for their client, or long enough.
    fn send_waiting(&self) -> Option<Instant> {
        let now = Instant::now();
        let waiting = std::mem::take(&mut *self.waiting.lock());
        let (due, rest): (Vec<_>, Vec<_>) =
            waiting.into_iter().partition(|reply| reply.until <= now || self.is_found(&reply.to));
        due.into_iter().for_each(|reply| self.send(reply.to, reply.body));
        let next = rest.iter().map(|reply| reply.until).min();
        self.waiting.lock().splice(0..0, rest);
        next
    }
}

impl Source for Server {
    fn serve(&self, waker: &Waker) -> Option<Instant> {
        let renewal = self.replies.tend(waker);
        let mut on_request = self.on_request.lock();
        self.incoming.take(waker, |body, from| on_request(Request { body, from, server: self.own.clone() }));
        drop(on_request);
        [renewal, self.send_waiting()].into_iter().flatten().min()
    }
}
