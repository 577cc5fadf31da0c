use std::ops::{Deref, Index};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, LazyLock};
use std::time::{Duration, Instant};

use arc_swap::{ArcSwap, ArcSwapOption, Guard};
use crossbeam_channel::Receiver;
use parking_lot::Mutex;
use thiserror::Error;

use super::volume::Cuts;
use super::{Channel, Command, Cut, ObjectKind, Order, Rates, Snapshot, SnapshotWriter, StepThrottle, VolumeCommand};
use crate::ids::VolumeId;
use crate::scene::VisualScene;
use ambf_plugin::run::Asked;
use ambf_plugin::SnapshotSlot;

/// An object that has a State and a Command.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectInfo {
    /// What it is and where its state stands.
    pub kind: ObjectKind,
    /// Global prefix and namespace, as written: may hold doubled slashes.
    pub namespace: String,
    /// Communication name: the ADF name and the suffix that tells copies apart.
    pub name: String,
    /// Qualified identifier and suffix.
    pub identifier: String,
    /// How often it is published.
    pub rates: Rates,
}

/// An object of the hub: what it is and where its commands are left.
pub struct HubObject {
    /// What it is.
    pub info: ObjectInfo,
    /// Where its commands are left.
    pub channel: Channel,
    removed: AtomicBool,
}

impl HubObject {
    fn new(info: ObjectInfo) -> Arc<Self> {
        Arc::new(Self { info, channel: Channel::default(), removed: AtomicBool::new(false) })
    }

    /// Whether the object is no longer part of the scene: what is left for it is not read.
    pub fn is_removed(&self) -> bool {
        self.removed.load(Ordering::Acquire)
    }

    /// Whether commands keep coming for the object at `now_ns` on the hub's clock ([`StepThrottle::watch_time`]). Not
    /// for the world: see [`StepThrottle::is_live`].
    pub fn is_live(&self, now_ns: u64) -> bool {
        self.info.kind.is_live(&self.channel, now_ns)
    }
}

/// Stands in the list of a [`Hub`] for all objects that were removed: a simulator may add and remove models for days.
static REMOVED: LazyLock<Arc<HubObject>> = LazyLock::new(|| {
    let info = ObjectInfo {
        kind: ObjectKind::World,
        namespace: String::new(),
        name: String::new(),
        identifier: String::new(),
        rates: Rates::default(),
    };
    Arc::new(HubObject { info, channel: Channel::default(), removed: AtomicBool::new(true) })
});

/// Position of an object in the list of a [`Hub`], for good. It is no index of a scene: those are in [`ObjectKind`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct HubIndex(pub usize);

/// All objects of a hub at one moment. A position names one object for good. In lists that are made after the object was
/// removed, an object without a name stands there that says so.
#[derive(Clone, Default)]
pub struct ObjectList {
    objects: Vec<Arc<HubObject>>,
    /// One bit an object: something waits in its channel.
    pending: Vec<Arc<AtomicU64>>,
}

impl Deref for ObjectList {
    type Target = [Arc<HubObject>];

    fn deref(&self) -> &Self::Target {
        &self.objects
    }
}

impl Index<HubIndex> for ObjectList {
    type Output = Arc<HubObject>;

    fn index(&self, object: HubIndex) -> &Self::Output {
        &self.objects[object.0]
    }
}

impl ObjectList {
    /// The objects with their positions.
    pub fn entries(&self) -> impl Iterator<Item = (HubIndex, &Arc<HubObject>)> {
        self.objects.iter().enumerate().map(|(position, object)| (HubIndex(position), object))
    }

    /// The object at a position, if there is one.
    pub fn get(&self, object: HubIndex) -> Option<&Arc<HubObject>> {
        self.objects.get(object.0)
    }

    fn extend(&mut self, infos: Vec<ObjectInfo>) {
        self.objects.extend(infos.into_iter().map(HubObject::new));
        self.pending.resize_with(self.objects.len().div_ceil(64), Arc::default);
    }

    /// Physics thread: calls `visit` for each object for which something was left since the last call.
    pub fn take_pending(&self, mut visit: impl FnMut(HubIndex)) {
        for (word, bits) in self.pending.iter().enumerate() {
            if bits.load(Ordering::Relaxed) == 0 {
                continue;
            }
            let mut rest = bits.swap(0, Ordering::Acquire);
            while rest != 0 {
                visit(HubIndex(word * 64 + rest.trailing_zeros() as usize));
                rest &= rest - 1;
            }
        }
    }
}

/// Error when a command cannot be accepted. The command before stays in force.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum PostError {
    /// Error when a number in the command is NaN or infinite.
    #[error(
        "a command for \"{0}\" holds a number that is not finite; it is ignored and the one before stays in force"
    )]
    NotFinite(String),
    /// Error when so many commands of volumes wait that there is no room for another one.
    #[error("too many commands of volumes wait to be executed; this one is ignored")]
    Full,
    /// Error when a recording is replayed, in which nobody else moves anything.
    #[error("a recording is replayed: commands and resets of others have no effect until it is over or left")]
    Replaying,
}

/// Resets that are requested.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Resets {
    /// Reset of the world, and when it was last asked for: commands that were posted before are forgotten.
    pub world: Option<Instant>,
    /// Reset of the rigid bodies.
    pub bodies: bool,
}

/// Meeting point of the physics thread and everybody who talks to it. See the [module](super).
pub struct Hub {
    objects: ArcSwap<ObjectList>,
    /// Counts changes of the list of objects.
    generation: AtomicU64,
    changing: Mutex<()>,
    snapshot: SnapshotSlot<Snapshot>,
    /// What can be drawn.
    visuals: ArcSwapOption<VisualScene>,
    /// Why nothing moves.
    lost: ArcSwapOption<String>,
    listeners: AtomicBool,
    throttle: StepThrottle,
    /// Held while an order of steps is carried out; how many there were.
    pub(super) turn: Mutex<u64>,
    /// The number of the order that may hold commands in force; 0: none.
    pub(super) running_order: AtomicU64,
    /// Resets that were done and published.
    resets: AtomicU64,
    reset_world: Asked,
    reset_bodies: AtomicBool,
    start: Instant,
    cuts: Cuts,
    /// A recording is replayed.
    replaying: AtomicBool,
    /// Something was refused for that.
    refused: AtomicBool,
}

impl Hub {
    /// A hub for `objects`.
    pub fn new(objects: Vec<ObjectInfo>) -> Self {
        let mut list = ObjectList::default();
        list.extend(objects);
        Self {
            objects: ArcSwap::from_pointee(list),
            generation: AtomicU64::new(0),
            changing: Mutex::default(),
            snapshot: SnapshotSlot::empty(),
            visuals: ArcSwapOption::empty(),
            lost: ArcSwapOption::empty(),
            listeners: AtomicBool::new(false),
            throttle: StepThrottle::default(),
            turn: Mutex::default(),
            running_order: AtomicU64::new(0),
            resets: AtomicU64::new(0),
            reset_world: Asked::default(),
            reset_bodies: AtomicBool::new(false),
            start: Instant::now(),
            cuts: Cuts::default(),
            replaying: AtomicBool::new(false),
            refused: AtomicBool::new(false),
        }
    }

    /// Says that a recording is replayed, or no longer: meanwhile commands and resets of others are refused. Steps and
    /// throttling are not.
    pub fn set_replaying(&self, replaying: bool) {
        self.replaying.store(replaying, Ordering::Release);
    }

    /// Whether a recording is replayed.
    pub fn is_replaying(&self) -> bool {
        self.replaying.load(Ordering::Acquire)
    }

    /// Whether something that moves the simulation is to be refused now, which is remembered.
    pub(crate) fn refuses(&self) -> bool {
        let refuses = self.is_replaying();
        if refuses {
            self.refused.store(true, Ordering::Release);
        }
        refuses
    }

    /// Whether something was refused because a recording is replayed.
    pub fn has_refused(&self) -> bool {
        self.refused.load(Ordering::Acquire)
    }

    /// Leaves a command of a volume: executed before the next update, after those that came before it. A reset of the
    /// world that is asked for later forgets it.
    ///
    /// # Errors
    /// [`PostError::Full`], [`PostError::Replaying`].
    pub fn post_volume(&self, volume: VolumeId, command: VolumeCommand) -> Result<(), PostError> {
        if self.refuses() {
            return Err(PostError::Replaying);
        }
        self.cuts.post(volume, command).then_some(()).ok_or(PostError::Full)
    }

    /// Commands of volumes that wait.
    pub(crate) fn count_volume_orders(&self) -> usize {
        self.cuts.count()
    }

    /// Physics thread: the next command of a volume.
    pub(crate) fn take_volume_order(&self) -> Option<Order> {
        self.cuts.take()
    }

    /// All cuts from now on, until the receiver is dropped. It holds 1024 that were not read; of more, the newest are lost.
    pub fn follow_cuts(&self) -> Receiver<Arc<Cut>> {
        self.follow_cuts_while(|| true)
    }

    /// As [`follow_cuts`](Self::follow_cuts), but only those that are made while `is_wanted`, which physics asks at each
    /// cut and which has to answer at once. What nobody wants is not copied.
    pub fn follow_cuts_while(&self, is_wanted: impl Fn() -> bool + Send + 'static) -> Receiver<Arc<Cut>> {
        self.cuts.follow(Box::new(is_wanted))
    }

    /// Physics thread: tells of a cut, if somebody wants to know.
    pub(crate) fn tell_cut(&self, make: impl FnOnce() -> Cut) {
        self.cuts.tell(make);
    }

    /// All objects that have a State and a Command; the position in this list names an object below. Models that are
    /// added at run time make it longer.
    pub fn objects(&self) -> Guard<Arc<ObjectList>> {
        self.objects.load()
    }

    /// How often the list of objects changed.
    pub fn generation(&self) -> u64 {
        self.generation.load(Ordering::Acquire)
    }

    /// Physics thread: appends the objects of a new model.
    pub fn add_objects(&self, infos: Vec<ObjectInfo>) {
        let _one_at_a_time = self.changing.lock();
        let mut list = ObjectList::clone(&self.objects.load());
        list.extend(infos);
        self.objects.store(Arc::new(list));
        self.generation.fetch_add(1, Ordering::AcqRel);
    }

    /// Physics thread: says that the objects at these positions are no longer part of the scene.
    pub fn remove_objects(&self, positions: impl IntoIterator<Item = HubIndex>) {
        let _one_at_a_time = self.changing.lock();
        let mut list = ObjectList::clone(&self.objects.load());
        for position in positions {
            let removed = std::mem::replace(&mut list.objects[position.0], Arc::clone(&REMOVED));
            removed.removed.store(true, Ordering::Release);
        }
        self.objects.store(Arc::new(list));
        self.generation.fetch_add(1, Ordering::AcqRel);
    }

    /// The hub's clock: monotonic time since it was made; never 0.
    pub fn now(&self) -> Duration {
        self.start.elapsed().max(Duration::from_nanos(1))
    }

    /// [`now`](Self::now) in ns.
    pub fn now_ns(&self) -> u64 {
        self.now().as_nanos() as u64
    }

    /// Another moment on the hub's clock, ns; 0 if it was before the hub was made.
    pub fn at_ns(&self, moment: Instant) -> u64 {
        moment.saturating_duration_since(self.start).as_nanos() as u64
    }

    /// The newest state of everything; empty before the first physics iteration and while nobody
    /// [listens](Self::set_listening). Hold it briefly.
    pub fn snapshot(&self) -> Guard<Option<Arc<Snapshot>>> {
        self.snapshot.load()
    }

    /// What of the scene can be drawn, anew after each change of the scene; `None` before a simulation is connected.
    pub fn visuals(&self) -> Option<Arc<VisualScene>> {
        self.visuals.load_full()
    }

    /// Physics thread: says what can be drawn now.
    pub fn set_visuals(&self, visuals: VisualScene) {
        self.visuals.store(Some(Arc::new(visuals)));
    }

    /// Why nothing moves, "lost at step 12: …; a reset resumes", when the state was lost; the snapshot is then that of
    /// the step before. Empty while all is well.
    pub fn lost(&self) -> Option<Arc<String>> {
        self.lost.load_full()
    }

    /// Physics thread: says that the state was lost, and why, or, with `None`, that all is well again.
    pub fn set_lost(&self, why: Option<String>) {
        self.lost.store(why.map(Arc::new));
    }

    /// Says that somebody reads snapshots; before that none are made.
    pub fn set_listening(&self) {
        self.listeners.store(true, Ordering::Release);
    }

    /// Whether somebody reads snapshots.
    pub fn is_listening(&self) -> bool {
        self.listeners.load(Ordering::Acquire)
    }

    /// Physics thread: publishes a snapshot through `writer`; false when readers hold all spare ones.
    pub fn publish(&self, writer: &mut SnapshotWriter, fill: impl FnOnce(&mut Snapshot)) -> bool {
        writer.publish(&self.snapshot, fill)
    }

    /// Leaves a command, or changed parameters, for the object at position `object`. What doesn't fit its kind, comes
    /// after the object was removed, or while an [order of steps](Self::step) runs that commands the same object, is
    /// never read.
    ///
    /// # Errors
    /// [`PostError::NotFinite`], [`PostError::Replaying`].
    pub fn post<C: Command>(&self, object: HubIndex, command: &C) -> Result<(), PostError> {
        self.post_for(object, command, 0)
    }

    /// [`post`](Self::post) for the order with the number `order`; 0: for none.
    pub(super) fn post_for<C: Command>(&self, object: HubIndex, command: &C, order: u64) -> Result<(), PostError> {
        let list = self.objects.load();
        let target = &list[object];
        if !command.is_finite() {
            return Err(PostError::NotFinite(target.info.name.clone()));
        }
        if target.is_removed() {
            return Ok(());
        }
        if self.refuses() {
            return Err(PostError::Replaying);
        }
        let (mailbox, now) = (C::mailbox(&target.channel), self.now_ns());
        match order {
            0 => mailbox.post(command, now),
            order => mailbox.post_ordered(command, now, order),
        }
        list.pending[object.0 / 64].fetch_or(1 << (object.0 % 64), Ordering::Release);
        Ok(())
    }

    /// Number of the [order of steps](Self::step) that runs; 0 while none does.
    pub(crate) fn running_order(&self) -> u64 {
        self.running_order.load(Ordering::Acquire)
    }

    /// Step throttling by the world's clients.
    pub fn throttle(&self) -> &StepThrottle {
        &self.throttle
    }

    /// Asks for a [reset of the world](crate::sim::Simulation::reset_world) before the next step; honoured also while
    /// paused or throttled. Commands that were posted before are forgotten, those that come later are not. While a
    /// recording is replayed it is refused.
    pub fn request_world_reset(&self) {
        if self.refuses() {
            return;
        }
        self.reset_world.ask();
        self.throttle.wake();
    }

    /// Asks for a reset of the rigid bodies before the next step; honoured also while paused or throttled. While a
    /// recording is replayed it is refused.
    pub fn request_body_reset(&self) {
        if self.refuses() {
            return;
        }
        self.reset_bodies.store(true, Ordering::Release);
        self.throttle.wake();
    }

    /// Whether a reset waits to be done.
    pub fn reset_requested(&self) -> bool {
        self.reset_world.is_waiting() || self.reset_bodies.load(Ordering::Acquire)
    }

    /// Physics thread: says that a reset was done and its result published.
    pub fn note_reset(&self) {
        self.resets.fetch_add(1, Ordering::AcqRel);
        self.throttle.tell();
    }

    /// How many resets were done and published.
    pub fn resets(&self) -> u64 {
        self.resets.load(Ordering::Acquire)
    }

    /// Physics thread: takes the requested resets.
    pub fn take_resets(&self) -> Resets {
        // The usual case costs no exchange.
        let bodies = self.reset_bodies.load(Ordering::Relaxed) && self.reset_bodies.swap(false, Ordering::AcqRel);
        Resets { world: self.reset_world.take(), bodies }
    }
}

#[cfg(test)]
mod tests {
    use super::super::RigidBodyCommand;
    use super::*;
    use crate::ids::BodyId;

    fn hub(n: usize) -> Hub {
        let object = |i: usize| ObjectInfo {
            kind: ObjectKind::RigidBody(BodyId::new(i), Box::default()),
            namespace: "/ambf/env/".into(),
            name: format!("Box{i}"),
            identifier: format!("/ambf/env/BODY Box{i}"),
            rates: Rates::default(),
        };
        Hub::new((0..n).map(object).collect())
    }

    #[test]
    fn only_objects_with_mail_are_visited() {
        let hub = hub(130);
        for object in [0, 63, 64, 129] {
            hub.post(HubIndex(object), &RigidBodyCommand::default()).unwrap();
        }
        let mut seen = Vec::new();
        hub.objects().take_pending(|object| seen.push(object.0));
        assert_eq!(seen, [0, 63, 64, 129]);
        hub.objects().take_pending(|object| panic!("{object:?} has nothing new"));
    }

    #[test]
    fn a_command_with_nan_is_refused_by_name() {
        let hub = hub(1);
        let command = RigidBodyCommand { joint_commands: vec![f64::NAN], ..Default::default() };
        let error = hub.post(HubIndex(0), &command).unwrap_err();
        assert!(error.to_string().contains("Box0"), "{error}");
        hub.objects().take_pending(|_| panic!("nothing was posted"));
    }

    #[test]
    fn while_a_recording_is_replayed_commands_and_resets_are_refused() {
        let hub = hub(1);
        hub.set_replaying(true);
        assert!(!hub.has_refused());
        let command = RigidBodyCommand::default();
        assert_eq!(hub.post(HubIndex(0), &command), Err(PostError::Replaying));
        assert_eq!(hub.post_volume(VolumeId::new(0), VolumeCommand::Restore), Err(PostError::Replaying));
        hub.request_world_reset();
        hub.request_body_reset();
        assert!(hub.has_refused() && !hub.reset_requested());
        hub.objects().take_pending(|_| panic!("nothing was posted"));
        hub.set_replaying(false);
        hub.post(HubIndex(0), &command).expect("it is over");
        hub.request_body_reset();
        assert!(hub.reset_requested());
    }

    #[test]
    fn the_list_grows_and_positions_stay() {
        let hub = hub(64);
        let before = hub.objects().clone();
        hub.add_objects(vec![before[HubIndex(0)].info.clone()]);
        hub.remove_objects([HubIndex(3)]);
        assert_eq!((hub.objects().len(), before.len(), hub.generation()), (65, 64, 2));
        assert!(before[HubIndex(3)].is_removed() && hub.objects()[HubIndex(3)].is_removed());
        assert_eq!((&*before[HubIndex(3)].info.name, &*hub.objects()[HubIndex(3)].info.name), ("Box3", ""));
        hub.post(HubIndex(3), &RigidBodyCommand::default()).unwrap();
        hub.post(HubIndex(64), &RigidBodyCommand::default()).unwrap();
        hub.post(HubIndex(0), &RigidBodyCommand::default()).unwrap();
        let mut seen = Vec::new();
        hub.objects().take_pending(|object| seen.push(object.0));
        assert_eq!(seen, [0, 64]);
    }
}
