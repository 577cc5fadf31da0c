//! One thread that publishes the states of all objects, each at its own rate.

use std::sync::mpsc::Receiver;
use std::sync::Arc;
use std::time::Duration;

use ambf_core::comm::{Hub, HubIndex, ObjectKind, PublishSchedule, Published, Rates, Snapshot};
use ambf_core::sim::request_short_slices;
use ros_node::{Publication, Stop};
use rosrust::Message;

use super::signal::Waker;
use crate::report;

/// Longest sleep: bounds how late a new listener or the end of a command stream is seen.
const MAX_SLEEP: Duration = Duration::from_millis(20);

/// A topic as the scheduler sees it.
pub(super) trait Outlet: Send {
    /// Whether it is worth making a message.
    fn is_wanted(&self) -> bool;

    /// Makes a message of the newest snapshot and sends it.
    fn publish(&mut self, snapshot: Option<&Snapshot>);

    /// Answers at once, in any thread, whether anybody listens.
    fn watch(&self) -> Watch;
}

/// Whether anybody listens to a topic.
pub(super) type Watch = Box<dyn Fn() -> bool + Send + Sync>;

/// An outlet that makes its messages with a function, which returns `None` while there is nothing to say. That of a latched
/// topic is asked also while nobody listens.
pub(super) struct StateOutlet<M: Message, F> {
    pub publication: Arc<Publication<M>>,
    pub is_latched: bool,
    pub message: F,
}

impl<M: Message, F: FnMut(Option<&Snapshot>) -> Option<M> + Send> Outlet for StateOutlet<M, F> {
    fn is_wanted(&self) -> bool {
        // What is sent before it is announced is not kept.
        let is_heard = self.publication.has_subscribers();
        is_heard || (self.is_latched && self.publication.is_announced())
    }

    fn publish(&mut self, snapshot: Option<&Snapshot>) {
        if let Some(message) = (self.message)(snapshot) {
            self.publication.send(message);
        }
    }

    fn watch(&self) -> Watch {
        let publication = Arc::downgrade(&self.publication);
        Box::new(move || publication.upgrade().is_some_and(|publication| publication.has_subscribers()))
    }
}

/// An outlet and when it is due.
pub(super) struct Entry {
    outlet: Box<dyn Outlet>,
    schedule: PublishSchedule,
    /// Position in the hub.
    object: HubIndex,
    /// Whether commands for the object switch to the fast rate.
    commanded: bool,
    live: bool,
    /// Somebody listened when it was last due.
    wanted: bool,
    /// Lets go of what waits to be told.
    discard: Option<Box<dyn Fn() + Send>>,
}

impl Entry {
    /// An outlet of the object at position `object` at the lower of `rates`, and, if it is `commanded`, at the higher
    /// one while commands come for the object.
    pub fn new(outlet: Box<dyn Outlet>, rates: Rates, object: HubIndex, commanded: bool, now: Duration) -> Self {
        let schedule = PublishSchedule::new(rates, now);
        Self { outlet, schedule, object, commanded, live: false, wanted: false, discard: None }
    }

    /// Calls `discard` whenever it is due and nobody listens.
    pub fn discard_while_unwanted(&mut self, discard: impl Fn() + Send + 'static) {
        self.discard = Some(Box::new(discard));
    }

    /// Follows the command stream; says so when it has stopped.
    fn follow_commands(&mut self, hub: &Hub, now: Duration) {
        if !self.commanded {
            return;
        }
        let live = is_live(hub, self.object, now.as_nanos() as u64);
        if live != self.live {
            self.live = live;
            self.schedule.set_fast(live, now);
            if !live {
                report!("WatchDog expired, Resetting \"{}\" command", hub.objects()[self.object].info.name);
            }
        }
    }
}

/// Whether commands keep coming for the object at position `object`.
pub(super) fn is_live(hub: &Hub, object: HubIndex, now_ns: u64) -> bool {
    let object = &hub.objects()[object];
    match object.info.kind {
        ObjectKind::World => hub.throttle().is_live(now_ns),
        _ => object.is_live(hub.throttle().watch_time(now_ns)),
    }
}

/// Publishes what comes in through `fresh`, each as long as its object exists, until `stop`. `waker` is nudged by the
/// first command of a stream and by the stop.
pub(super) fn run(hub: &Hub, fresh: &Receiver<Vec<Entry>>, stop: &Stop, waker: &Waker) {
    // A subscriber on this machine that each state wakes would otherwise use up its slice before the next state is sent.
    request_short_slices();
    waker.claim();
    let throttle = hub.throttle();
    let follower = throttle.add_follower(&std::thread::current());
    let mut followed = throttle.clocked_steps();
    let mut entries = Vec::new();
    let mut generation = hub.generation();
    while !stop.is_stopped() {
        let before = entries.len();
        entries.extend(fresh.try_iter().flatten());
        let present = hub.generation();
        if present != generation || entries.len() != before {
            generation = present;
            let objects = hub.objects();
            // Its topic is withdrawn elsewhere: that can take long.
            entries.retain(|entry: &Entry| !objects[entry.object].is_removed());
        }
        // A client that clocks the physics waits for the state of the step: it gets it at once.
        let steps = throttle.clocked_steps();
        if std::mem::replace(&mut followed, steps) != steps {
            publish_live(hub, &mut entries);
        }
        let next = publish_due(hub, &mut entries, hub.now(), throttle.published());
        follower.wait_from(next.due);
        if throttle.published().at < next.due {
            // The schedules are absolute: a late wake-up delays one message, it does not lower the rate.
            std::thread::park_timeout(next.latest.saturating_sub(hub.now()).min(MAX_SLEEP));
        }
    }
    throttle.remove_follower(&follower);
}

/// When there is something to do again.
#[derive(Debug, PartialEq, Eq)]
struct Next {
    /// From then on it is done as soon as there are new states, …
    due: Duration,
    /// … and at the latest at this time.
    latest: Duration,
}

/// Publishes the objects for which commands keep coming, whether they are due or not.
fn publish_live(hub: &Hub, entries: &mut [Entry]) {
    let snapshot = hub.snapshot();
    for entry in entries.iter_mut().filter(|entry| entry.live && entry.wanted) {
        entry.outlet.publish(snapshot.as_deref());
    }
}

/// Publishes what is due at `now` and returns when something that is listened to is due next. `published`: when states
/// came.
fn publish_due(hub: &Hub, entries: &mut [Entry], now: Duration, published: Published) -> Next {
    let snapshot = hub.snapshot();
    let snapshot = snapshot.as_deref();
    let mut next = Next { due: Duration::MAX, latest: Duration::MAX };
    for entry in entries {
        entry.follow_commands(hub, now);
        if entry.schedule.poll(now, published) {
            entry.wanted = entry.outlet.is_wanted();
            if entry.wanted {
                entry.outlet.publish(snapshot);
            } else if let Some(discard) = &entry.discard {
                discard();
            }
        }
        // Nobody is woken for topics that nobody listens to; a new listener is seen after the longest sleep.
        if entry.wanted {
            next.due = next.due.min(entry.schedule.next_due());
            next.latest = next.latest.min(entry.schedule.latest(published.interval));
        }
    }
    next
}

#[cfg(test)]
mod tests {
    use super::*;
    use ambf_core::comm::{ObjectInfo, RigidBodyCommand, SnapshotWriter};
    use ambf_core::ids::BodyId;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::mpsc::channel;
    use std::time::Instant;

    struct Counter {
        wanted: bool,
        sent: Arc<AtomicUsize>,
        needs_snapshot: bool,
    }

    impl Outlet for Counter {
        fn is_wanted(&self) -> bool {
            self.wanted
        }

        fn publish(&mut self, snapshot: Option<&Snapshot>) {
            if !self.needs_snapshot || snapshot.is_some() {
                self.sent.fetch_add(1, Ordering::Relaxed);
            }
        }

        fn watch(&self) -> Watch {
            let wanted = self.wanted;
            Box::new(move || wanted)
        }
    }

    fn body(name: &str) -> ObjectInfo {
        ObjectInfo {
            kind: ObjectKind::RigidBody(BodyId::new(0), Box::default()),
            namespace: "/ambf/env/".into(),
            name: name.into(),
            identifier: format!("/ambf/env/BODY {name}"),
            rates: Rates::default(),
        }
    }

    fn entry(wanted: bool, sent: &Arc<AtomicUsize>) -> Entry {
        let outlet = Counter { wanted, sent: Arc::clone(sent), needs_snapshot: true };
        Entry::new(Box::new(outlet), Rates::new(50, 1000).unwrap(), HubIndex(0), true, Duration::ZERO)
    }

    fn simulate(hub: &Hub, entries: &mut [Entry], from_ms: u64, to_ms: u64) {
        for tenth in from_ms * 10..to_ms * 10 {
            let now = Duration::from_micros(tenth * 100);
            publish_due(hub, entries, now, Published { at: now, interval: Duration::from_micros(100) });
        }
    }

    #[test]
    fn rates_follow_the_command_stream_and_unwanted_topics_cost_nothing() {
        let hub = Hub::new(vec![body("a")]);
        let mut writer = SnapshotWriter::new(Snapshot::default());
        let (wanted, unwanted) = (Arc::default(), Arc::default());
        let mut entries = [entry(true, &wanted), entry(false, &unwanted)];
        let count = |sent: &Arc<AtomicUsize>| sent.swap(0, Ordering::Relaxed);

        simulate(&hub, &mut entries, 0, 1000);
        assert_eq!(count(&wanted), 0, "no snapshot yet");
        hub.publish(&mut writer, |s| s.sim_step = 1);
        simulate(&hub, &mut entries, 1000, 2000);
        assert_eq!(count(&wanted), 50);

        // The hub's clock is real and near 0 here, so the stream ends 0.5 s of simulated time after the post.
        hub.post(HubIndex(0), &RigidBodyCommand::default()).unwrap();
        let mut entries = [entry(true, &wanted), entry(false, &unwanted)];
        simulate(&hub, &mut entries, 0, 400);
        assert_eq!(count(&wanted), 400);
        simulate(&hub, &mut entries, 400, 1600);
        let sent = count(&wanted);
        assert!((100..=250).contains(&sent), "{sent}: at most 0.1 s fast plus what the post came late, then 50 Hz");
        assert_eq!(count(&unwanted), 0);
    }

    #[test]
    fn only_topics_with_listeners_cost_wake_ups() {
        let hub = Hub::new(vec![body("a")]);
        let sent = Arc::default();
        let next = |wanted| publish_due(&hub, &mut [entry(wanted, &sent)], Duration::ZERO, Published::default());
        assert_eq!(next(false), Next { due: Duration::MAX, latest: Duration::MAX });
        assert_eq!(next(true), Next { due: Duration::from_millis(20), latest: Duration::from_millis(50) });
    }

    /// How long a state of a topic of 1 Hz takes that is published when the topic is due.
    fn time_of_a_new_state() -> Duration {
        let hub = Hub::new(vec![body("a")]);
        let mut writer = SnapshotWriter::new(Snapshot::default());
        let (stop, waker, sent) = (Stop::default(), Waker::default(), Arc::<AtomicUsize>::default());
        let (sender, fresh) = channel();
        let outlet = Counter { wanted: true, sent: Arc::clone(&sent), needs_snapshot: true };
        let due = hub.now();
        let entry = Entry::new(Box::new(outlet), Rates::new(1, 1).unwrap(), HubIndex(0), false, due);
        sender.send(vec![entry]).unwrap();
        std::thread::scope(|scope| {
            let (hub, stop, waker) = (&hub, &stop, &waker);
            let thread = scope.spawn(move || run(hub, &fresh, stop, waker));
            hub.publish(&mut writer, |snapshot| snapshot.sim_step = 1);
            hub.throttle().note_published(hub.now_ns());
            while sent.load(Ordering::Relaxed) == 0 && hub.now() < due + Duration::from_secs(20) {
                std::thread::sleep(Duration::from_millis(1));
            }
            let time = hub.now() - due;
            assert_eq!(sent.load(Ordering::Relaxed), 1);
            stop.stop();
            waker.wake();
            thread.join().unwrap();
            time
        })
    }

    #[test]
    fn states_are_sent_as_soon_as_they_are_new() {
        // Without new states it would come after 1.5 s; on a busy machine a thread may sleep as long.
        assert!((0..10).any(|_| time_of_a_new_state() < Duration::from_secs(1)));
    }

    #[test]
    fn a_stop_is_prompt() {
        let hub = Hub::new(vec![body("a")]);
        let (stop, waker) = (Stop::default(), Waker::default());
        std::thread::scope(|scope| {
            let thread = scope.spawn(|| run(&hub, &channel().1, &stop, &waker));
            std::thread::sleep(Duration::from_millis(5));
            stop.stop();
            waker.wake();
            thread.join().unwrap();
        });
    }

    #[test]
    fn objects_are_published_from_when_they_come_until_they_go() {
        let hub = Hub::new(vec![body("a")]);
        let mut writer = SnapshotWriter::new(Snapshot::default());
        hub.publish(&mut writer, |s| s.sim_step = 1);
        let (stop, waker, sent) = (Stop::default(), Waker::default(), Arc::default());
        let (sender, fresh) = channel();
        let deadline = Instant::now() + Duration::from_secs(20);
        let wait = |what: &str, condition: &dyn Fn() -> bool| {
            while !condition() {
                assert!(Instant::now() < deadline, "{what}");
                std::thread::sleep(Duration::from_millis(1));
            }
        };
        std::thread::scope(|scope| {
            let (hub, stop, waker) = (&hub, &stop, &waker);
            let thread = scope.spawn(move || run(hub, &fresh, stop, waker));
            sender.send(vec![entry(true, &sent)]).unwrap();
            wait("it is published", &|| sent.load(Ordering::Relaxed) > 0);
            assert_eq!(Arc::strong_count(&sent), 2);
            hub.remove_objects([HubIndex(0)]);
            wait("its outlet is dropped", &|| Arc::strong_count(&sent) == 1);
            sender.send(vec![entry(true, &sent)]).unwrap();
            wait("one that comes too late is dropped at once", &|| Arc::strong_count(&sent) == 1);
            stop.stop();
            waker.wake();
            thread.join().unwrap();
        });
    }
}
