//! A topic that a node publishes on.

use std::collections::{BTreeSet, VecDeque};
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::Arc;
use std::task::{Context, Poll, Waker};
use std::time::{Duration, Instant};

use futures_core::Stream;
use parking_lot::Mutex;
use rustdds::bytes::Bytes;
use rustdds::dds::WriteError;
use rustdds::{DataWriterStatus, RTPSEntity, StatusEvented, WriteOptions, WriteOptionsBuilder, GUID};

use crate::graph::Side;
use crate::node::Membership;
use crate::participant::{Error, Shared, Source};
use crate::qos::Qos;
use crate::wire::RawWriter;

/// Changes of subscriptions that RustDDS remembers for a publication; more than that are forgotten.
const REMEMBERED_CHANGES: usize = 4;

/// Shortest time between two times that a publication is made anew.
const RENEW_EVERY: Duration = Duration::from_secs(2);

/// How long no message can be sent until a publication is made anew. RustDDS takes everything that was ever sent as not
/// acknowledged by a new subscription until it has acknowledged something, which takes Fast DDS about 0.1 s.
const PATIENCE: Duration = Duration::from_millis(150);

/// How long others have to find a publication that was made anew, until they get what waits.
const HOLD: Duration = Duration::from_millis(100);

/// Messages that a publication without subscriptions may go on holding. RustDDS frees messages when subscriptions
/// acknowledge them: those that the last one has left unacknowledged stay, up to the window of the [`Qos`], until another
/// one comes.
const MAX_UNACKNOWLEDGED: u64 = 64;

/// How often messages that wait are tried again.
const RETRY: Duration = Duration::from_millis(5);

/// Messages that wait meanwhile, at most, and their bytes; one may always wait.
const MAX_WAITING: usize = 1024;
const MAX_WAITING_BYTES: usize = 8 << 20;

/// Why a message was not sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SendError {
    /// Error when a subscription has not acknowledged messages for so long that no more are kept.
    #[error("a subscription does not acknowledge messages")]
    Full,
    /// Error when RustDDS has ended.
    #[error("DDS has ended")]
    Ended,
}

/// A topic that a node publishes on. Dropping it ends that.
pub struct Publication {
    inner: Arc<Inner>,
}

/// The endpoint itself, also for services.
pub(crate) struct Inner {
    node: Arc<Membership>,
    source: u64,
    dds_topic: String,
    topic: String,
    dds_type: String,
    qos: Qos,
    state: Mutex<State>,
    matched: AtomicUsize,
    renewals: AtomicU64,
    lost: AtomicU64,
}

struct State {
    writer: RawWriter,
    readers: BTreeSet<GUID>,
    /// What those that come later get, to be said again when the publication is made anew.
    last: Option<Bytes>,
    /// What could not be sent yet, in order.
    waiting: VecDeque<(Bytes, WriteOptions)>,
    /// When it began that nothing can be sent.
    full_since: Option<Instant>,
    /// Nothing is sent before.
    hold_until: Option<Instant>,
    renewed: Option<Instant>,
    /// Messages sent since it was made or made anew.
    sent: u64,
    complained: bool,
}

impl State {
    /// Sends a message, unless others wait.
    ///
    /// # Errors
    /// With the message when it cannot be sent yet; without when RustDDS has ended.
    fn write(&mut self, body: Bytes, options: &WriteOptions) -> Result<(), Option<Bytes>> {
        match self.writer.write_with_options(body, options.clone()) {
            Ok(_) => {
                self.full_since = None;
                self.sent += 1;
                Ok(())
            }
            Err(WriteError::WouldBlock { data }) => {
                self.full_since.get_or_insert_with(Instant::now);
                Err(Some(data))
            }
            Err(_) => Err(None),
        }
    }

    /// Sends what waits, as far as that is possible.
    ///
    /// # Errors
    /// When RustDDS has ended.
    fn send_waiting(&mut self) -> Result<(), SendError> {
        if self.hold_until.is_some_and(|until| until > Instant::now()) {
            return Ok(());
        }
        self.hold_until = None;
        while let Some((body, options)) = self.waiting.pop_front() {
            match self.write(body, &options) {
                Ok(()) => (),
                Err(Some(body)) => {
                    self.waiting.push_front((body, options));
                    break;
                }
                Err(None) => return Err(SendError::Ended),
            }
        }
        Ok(())
    }

    fn has_room(&self, bytes: usize) -> bool {
        let waiting: usize = self.waiting.iter().map(|(body, _)| body.len()).sum();
        self.waiting.is_empty() || self.waiting.len() < MAX_WAITING && waiting + bytes <= MAX_WAITING_BYTES
    }
}

impl Publication {
    pub(crate) fn new(
        node: Arc<Membership>,
        dds_topic: &str,
        topic: &str,
        dds_type: &str,
        qos: Qos,
    ) -> Result<Arc<Self>, Error> {
        let inner = Inner::new(node, dds_topic, topic, dds_type, qos)?;
        inner.shared().add_source(inner.source, Arc::clone(&inner) as Arc<dyn Source>);
        Ok(Arc::new(Self { inner }))
    }

    /// Its name.
    pub fn topic(&self) -> &str {
        &self.inner.topic
    }

    /// Whether anybody gets what is sent. Costs next to nothing.
    pub fn is_matched(&self) -> bool {
        self.subscriptions() > 0
    }

    /// How many subscriptions get what is sent.
    pub fn subscriptions(&self) -> usize {
        self.inner.matched.load(Ordering::Relaxed)
    }

    /// How often it was made anew.
    pub fn renewals(&self) -> u64 {
        self.inner.renewals.load(Ordering::Relaxed)
    }

    /// Messages that were not sent because a subscription did not acknowledge those before.
    pub fn lost(&self) -> u64 {
        self.inner.lost.load(Ordering::Relaxed)
    }

    /// Sends a message whose body (CDR, little endian, without the four bytes before it) is `body`. Never waits for a
    /// subscription. Without one nothing is sent, and it is kept only if it is latched.
    ///
    /// A reliable subscription that does not acknowledge messages, because its program hangs, makes RustDDS keep them.
    /// When that are as many as the window of the [`Qos`], messages wait, at most 1024 and 8 MB; others are lost. A new
    /// subscription has the same effect until it has acknowledged something. When that lasts for 0.15 s, the publication is
    /// made anew, every two seconds at most: others find the new one within some milliseconds, and get what waits 0.1 s
    /// later.
    ///
    /// # Errors
    /// [`SendError`] when it is lost.
    pub fn send(&self, body: &[u8]) -> Result<(), SendError> {
        if !self.is_matched() && !self.inner.qos.latched {
            return Ok(());
        }
        self.inner.write(Bytes::copy_from_slice(body), WriteOptions::default())
    }
}

impl Drop for Publication {
    fn drop(&mut self) {
        self.inner.shared().remove_source(self.inner.source);
    }
}

impl Inner {
    pub fn new(
        node: Arc<Membership>,
        dds_topic: &str,
        topic: &str,
        dds_type: &str,
        qos: Qos,
    ) -> Result<Arc<Self>, Error> {
        let writer = node.shared.writer(dds_topic, dds_type, &qos.of_writer())?;
        let guid = writer.guid();
        node.shared.change_graph(|graph| graph.add(node.key, Side::Writes, guid));
        Ok(Arc::new(Self {
            source: node.shared.new_key(),
            node,
            dds_topic: dds_topic.into(),
            topic: topic.into(),
            dds_type: dds_type.into(),
            qos,
            state: Mutex::new(State {
                writer,
                readers: BTreeSet::new(),
                last: None,
                waiting: VecDeque::new(),
                full_since: None,
                hold_until: None,
                renewed: None,
                sent: 0,
                complained: false,
            }),
            matched: AtomicUsize::new(0),
            lost: AtomicU64::new(0),
            renewals: AtomicU64::new(0),
        }))
    }

    pub fn shared(&self) -> &Arc<Shared> {
        &self.node.shared
    }

    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// Whether one of its readers satisfies `is_it`.
    pub fn has_reader(&self, is_it: impl Fn(&GUID) -> bool) -> bool {
        self.state.lock().readers.iter().any(is_it)
    }

    pub fn write(&self, body: Bytes, options: WriteOptions) -> Result<(), SendError> {
        let mut state = self.state.lock();
        if self.qos.latched {
            state.last = Some(body.clone());
        }
        state.send_waiting()?;
        let unsent = if state.waiting.is_empty() && state.hold_until.is_none() {
            match state.write(body, &options) {
                Ok(()) => return Ok(()),
                Err(None) => return Err(SendError::Ended),
                Err(Some(body)) => body,
            }
        } else {
            body
        };
        if !state.has_room(unsent.len()) {
            self.lost.fetch_add(1, Ordering::Relaxed);
            return Err(SendError::Full);
        }
        if state.waiting.is_empty() {
            self.shared().signal.ready(self.source);
        }
        state.waiting.push_back((unsent, options));
        Ok(())
    }

    /// Takes the changes of subscriptions that RustDDS has remembered.
    fn follow(&self, state: &mut State, waker: &Waker) {
        let mut changes = 0;
        let mut mismatch = false;
        {
            let State { writer, readers, .. } = &mut *state;
            let mut stream = writer.as_async_status_stream();
            let mut context = Context::from_waker(waker);
            while let Poll::Ready(Some(status)) = Pin::new(&mut stream).poll_next(&mut context) {
                changes += 1;
                match status {
                    DataWriterStatus::PublicationMatched { current, reader, .. } if current.count_change() > 0 => {
                        readers.insert(reader);
                    }
                    DataWriterStatus::PublicationMatched { reader, .. } => {
                        readers.remove(&reader);
                    }
                    DataWriterStatus::OfferedIncompatibleQos { .. } => mismatch = true,
                    _ => {}
                }
            }
        }
        if changes >= REMEMBERED_CHANGES {
            self.count_anew(state);
        }
        if mismatch && !std::mem::replace(&mut state.complained, true) {
            (self.shared().report())(format_args!(
                "ROS 2: {}: a subscription asks for more than is offered (reliable, {}) and gets nothing",
                self.topic,
                if self.qos.latched { "transient local" } else { "volatile" }
            ));
        }
        // Those who are about to find it count already.
        if state.hold_until.is_none() {
            self.matched.store(state.readers.len(), Ordering::Relaxed);
        }
    }

    /// RustDDS may have forgotten changes: whoever subscribes the topic counts.
    fn count_anew(&self, state: &mut State) {
        let offered = self.qos.of_writer();
        let all = self.shared().dds.discovered_readers().into_iter();
        let of_topic = all.filter(|reader| *reader.subscription_topic_data.topic_name() == self.dds_topic);
        let matching =
            of_topic.filter(|reader| offered.compliance_failure_wrt(&reader.subscription_topic_data.qos()).is_none());
        state.readers = matching.map(|reader| reader.reader_proxy.remote_reader_guid).collect();
    }

    /// Replaces the endpoint by a new one, which has nothing unacknowledged; when it is possible, if it is not yet.
    fn renew(&self, state: &mut State) -> Option<Instant> {
        let allowed = state.renewed.map(|at| at + RENEW_EVERY);
        if let Some(at) = allowed.filter(|at| *at > Instant::now()) {
            return Some(at);
        }
        state.renewed = Some(Instant::now());
        let is_left = state.readers.is_empty() && state.waiting.is_empty();
        (state.full_since, state.hold_until) = (None, Some(Instant::now() + HOLD));
        let shared = self.shared();
        match shared.writer(&self.dds_topic, &self.dds_type, &self.qos.of_writer()) {
            Ok(writer) => {
                let old = std::mem::replace(&mut state.writer, writer);
                let (old_guid, guid) = (old.guid(), state.writer.guid());
                state.readers.clear();
                state.sent = 0;
                self.renewals.fetch_add(1, Ordering::Relaxed);
                drop(old);
                shared.change_graph(|graph| {
                    graph.remove(self.node.key, Side::Writes, old_guid);
                    graph.add(self.node.key, Side::Writes, guid);
                });
                if let Some(last) = state.last.clone().filter(|_| state.waiting.is_empty()) {
                    let _ = state.writer.write_with_options(last, WriteOptionsBuilder::new().build());
                }
                if !is_left {
                    (shared.report())(format_args!(
                        "ROS 2: {}: a subscription does not acknowledge messages; the topic was published anew",
                        self.topic
                    ));
                }
            }
            Err(error) => (shared.report())(format_args!("ROS 2: {}: {error}", self.topic)),
        }
        None
    }

    /// What [`Source::serve`] does.
    pub fn tend(&self, waker: &Waker) -> Option<Instant> {
        let mut state = self.state.lock();
        let _ = state.send_waiting();
        let must_renew = !state.waiting.is_empty() && state.full_since.is_some_and(|since| since.elapsed() >= PATIENCE);
        let later = if must_renew { self.renew(&mut state) } else { None };
        let has_more = !state.waiting.is_empty() || state.hold_until.is_some();
        let next = later.or_else(|| has_more.then(|| Instant::now() + RETRY));
        self.follow(&mut state, waker);
        let is_left = !self.qos.latched && state.readers.is_empty() && state.waiting.is_empty();
        if is_left && state.hold_until.is_none() && state.sent > MAX_UNACKNOWLEDGED {
            // What was sent is of no use to those who come later.
            let later = self.renew(&mut state);
            self.follow(&mut state, waker);
            let hold = state.hold_until.map(|_| Instant::now() + RETRY);
            return [next, later, hold].into_iter().flatten().min();
        }
        next
    }
}

impl Source for Inner {
    fn serve(&self, waker: &Waker) -> Option<Instant> {
        self.tend(waker)
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        let guid = self.state.get_mut().writer.guid();
        self.node.shared.change_graph(|graph| graph.remove(self.node.key, Side::Writes, guid));
    }
}
