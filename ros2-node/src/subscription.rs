//! A topic that a node listens to.

use std::sync::Arc;
use std::task::Waker;
use std::time::Instant;

use parking_lot::Mutex;
use rustdds::{SampleIdentity, SequenceNumber};

use crate::graph::Side;
use crate::names;
use crate::node::Membership;
use crate::participant::{Error, Source};
use crate::qos::Qos;
use crate::wire::{Limit, RawReader};

/// Messages of one topic that are taken before others have their turn.
const TURN: usize = 100;

/// A topic that a node listens to. Dropping it ends that; a call-back that runs just then still finishes.
pub struct Subscription {
    inner: Arc<Listener>,
    source: u64,
}

/// What is done with a message.
type OnMessage = Box<dyn FnMut(&[u8]) + Send>;

struct Listener {
    incoming: Incoming,
    on_message: Mutex<OnMessage>,
}

impl Subscription {
    pub(crate) fn new(
        node: Arc<Membership>,
        topic: &str,
        dds_type: &str,
        qos: Qos,
        longest: usize,
        on_message: OnMessage,
    ) -> Result<Self, Error> {
        let shared = Arc::clone(&node.shared);
        let incoming = Incoming::new(node, &names::dds_topic(topic), topic, dds_type, qos, longest)?;
        let source = incoming.source;
        let inner = Arc::new(Listener { incoming, on_message: Mutex::new(on_message) });
        shared.add_source(source, Arc::clone(&inner) as Arc<dyn Source>);
        Ok(Self { inner, source })
    }

    /// Its name.
    pub fn topic(&self) -> &str {
        &self.inner.incoming.topic
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        self.inner.incoming.node.shared.remove_source(self.source);
    }
}

impl Source for Listener {
    fn serve(&self, waker: &Waker) -> Option<Instant> {
        let mut on_message = self.on_message.lock();
        self.incoming.take(waker, |body, _| on_message(&body));
        None
    }
}

/// The endpoint itself, also for services.
pub(crate) struct Incoming {
    pub node: Arc<Membership>,
    pub source: u64,
    topic: String,
    longest: usize,
    reader: Mutex<RawReader>,
    complained: Mutex<bool>,
}

impl Incoming {
    pub fn new(
        node: Arc<Membership>,
        dds_topic: &str,
        topic: &str,
        dds_type: &str,
        qos: Qos,
        longest: usize,
    ) -> Result<Self, Error> {
        let reader = node.shared.reader(dds_topic, dds_type, &qos.of_reader())?;
        let guid = reader.guid();
        node.shared.change_graph(|graph| graph.add(node.key, Side::Reads, guid));
        Ok(Self {
            source: node.shared.new_key(),
            node,
            topic: topic.into(),
            longest,
            reader: Mutex::new(reader),
            complained: Mutex::new(false),
        })
    }

    /// Hands over messages that are there, with what a reply would have to refer to, and has `waker` woken when more come.
    pub fn take(&self, waker: &Waker, mut with: impl FnMut(Vec<u8>, SampleIdentity)) {
        let reader = self.reader.lock();
        reader.set_waker(Some(waker.clone()));
        reader.drain_read_notifications();
        for _ in 0..TURN {
            match reader.try_take_one_with(Limit(self.longest)) {
                Ok(None) => return,
                Ok(Some(sample)) => {
                    let identity =
                        reply_identity(sample.writer_guid(), sample.sequence_number, sample.related_sample_identity());
                    match sample.into_value() {
                        Ok(body) => with(body, identity),
                        Err(length) => self.complain(format_args!("{length} bytes, more than {}", self.longest)),
                    }
                }
                Err(error) => self.complain(format_args!("{error}")),
            }
        }
        // There may be more.
        self.node.shared.signal.ready(self.source);
    }

    /// Once a topic.
    fn complain(&self, why: std::fmt::Arguments<'_>) {
        if !std::mem::replace(&mut *self.complained.lock(), true) {
            (self.node.shared.report())(format_args!(
                "ROS 2: {}: a message is ignored: {why}; this is said once",
                self.topic
            ));
        }
    }
}

/// What a reply refers to: the request, or what the request names instead. Fast DDS names the subscription that waits for
/// the reply, and leaves the number open.
fn reply_identity(writer: rustdds::GUID, number: SequenceNumber, related: Option<SampleIdentity>) -> SampleIdentity {
    let mut identity = related.unwrap_or(SampleIdentity { writer_guid: writer, sequence_number: number });
    if identity.sequence_number == SequenceNumber::UNKNOWN {
        identity.sequence_number = number;
    }
    identity
}

impl Drop for Incoming {
    fn drop(&mut self) {
        let guid = self.reader.get_mut().guid();
        self.node.shared.change_graph(|graph| graph.remove(self.node.key, Side::Reads, guid));
    }
}
