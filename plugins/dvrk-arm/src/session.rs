//! Finds out how an arm speaks, listens and shakes hands; run by the thread that watches the master.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant};

use ros_node::{Announcement, Link, RawReceived, RawSubscription};

use crate::dialect::{readings, Dialect, DialectChoice, Reading, Topics};
use crate::hub::{PedalBoard, PedalBoards};
use crate::inner::{Inner, Mode};
use crate::outputs::Outputs;
use crate::pedals::pedal_topics;
use crate::wire::{self, Stamped};

/// Least time between two requests to enable or home.
const ASK_AGAIN: Duration = Duration::from_secs(2);

/// Most such requests until the arm's state changes.
const MAX_REQUESTS: u32 = 3;

/// An arm that is listed but silent for so long may speak another dialect, if that is listed too.
const SILENCE: Duration = Duration::from_secs(2);

/// What the watching thread knows about an arm.
#[derive(Default)]
pub(crate) struct Session {
    dialect: Option<Dialect>,
    /// Found once; topics of a node that starts come one after the other.
    doubted: Option<Dialect>,
    /// When a pose of it was there, or this dialect was found.
    heard: Option<Instant>,
    /// When any dialect was found first.
    listed: Option<Instant>,
    /// When poses came, or came again.
    posed: Option<Instant>,
    inputs: Vec<Arc<dyn Announcement>>,
    outputs: Option<Arc<Outputs>>,
    pedals: Option<Arc<PedalBoard>>,
    settled: bool,
    /// A mode was requested from the present listener.
    asked_mode: bool,
    asked: u32,
    asked_at: Option<Instant>,
    asked_in: Option<wire::State>,
    available: bool,
    said_waiting: bool,
    said_unready: bool,
    said_missing: bool,
    said_found: bool,
}

impl Session {
    /// One look at an arm; `topics` is what is published at present.
    pub fn watch(&mut self, inner: &Arc<Inner>, topics: &Topics, link: &Link, boards: &PedalBoards) {
        match self.speaks(inner, topics) {
            found if found == self.dialect => self.doubted = None,
            // It is away; when it comes back it speaks as before, or is found to have changed.
            None => self.doubted = None,
            Some(Dialect::Ambf)
                if inner.options.dialect == DialectChoice::Auto && self.doubted != Some(Dialect::Ambf) =>
            {
                self.doubted = Some(Dialect::Ambf);
            }
            Some(found) => {
                // Two may be listed and both be silent: they are tried in turn, without a word.
                let listed = inner.names.dialects(inner.options.dialect, topics);
                let is_guess = self.dialect.is_some_and(|now| listed.contains(&now));
                self.switch(inner, found, link, is_guess);
            }
        }
        let Some(dialect) = self.dialect else {
            if !std::mem::replace(&mut self.said_waiting, true) {
                inner.say("waiting for the arm: nobody publishes its pose yet");
            }
            return;
        };
        let wanted = pedal_topics(dialect, inner.names.root(dialect), inner.options.clutch_source, topics);
        if self.pedals.as_ref().is_none_or(|board| board.topics() != wanted) {
            let board = boards.board(wanted, link, &inner.options.say);
            inner.set_pedals(board.pedals());
            self.pedals = Some(board);
        }
        if dialect.is_crtk() && inner.state.lock().is_none() {
            // One that publishes no state is taken as it is.
            let silent = !topics.contains_key(&inner.names.topic(dialect, "operating_state"));
            inner.ready.store(silent, Ordering::Release);
        }
        self.settle(inner);
        self.report(inner);
    }

    /// The dialect in which the arm speaks, as far as is known.
    fn speaks(&mut self, inner: &Inner, topics: &Topics) -> Option<Dialect> {
        let listed = inner.names.dialects(inner.options.dialect, topics);
        if inner.is_available() {
            self.heard = Some(Instant::now());
        }
        let silent = self.heard.is_none_or(|heard| heard.elapsed() > SILENCE);
        let now = self.dialect.filter(|now| listed.contains(now));
        let other = || listed.iter().copied().find(|listed| Some(*listed) != now);
        match now {
            Some(now) if silent => other().or(Some(now)),
            Some(now) => Some(now),
            None => other(),
        }
    }

    /// Lets go of all topics.
    pub fn end(&mut self, link: &Link) {
        let inputs = std::mem::take(&mut self.inputs);
        link.remove(&inputs);
        if let Some(outputs) = self.outputs.take() {
            link.remove(outputs.announcements());
        }
        self.pedals = None;
    }

    fn switch(&mut self, inner: &Arc<Inner>, dialect: Dialect, link: &Link, is_guess: bool) {
        inner.outputs.store(None);
        self.end(link);
        let (heard, listed) = (Some(Instant::now()), self.listed.or_else(|| Some(Instant::now())));
        let Self { posed, said_missing, .. } = *self;
        *self = Self { dialect: Some(dialect), heard, listed, posed, said_missing, ..Self::default() };
        if !is_guess {
            self.say_found(inner);
        }
        inner.speak(dialect);
        let has_jaw = inner.names.arm().starts_with("PSM");
        let subscriptions = readings(dialect, has_jaw).into_iter();
        self.inputs = subscriptions.map(|(name, reading)| listen(inner, dialect, name, reading)).collect();
        let outputs = Arc::new(Outputs::new(&inner.names, dialect, inner.options.motion));
        link.add(self.inputs.iter().map(Arc::clone).chain(outputs.announcements().iter().map(Arc::clone)));
        inner.outputs.store(Some(Arc::clone(&outputs)));
        self.outputs = Some(outputs);
    }

    /// The handshake, as far as it can be made at present.
    fn settle(&mut self, inner: &Inner) {
        let Some(outputs) = &self.outputs else { return };
        if !self.settled {
            self.settled = outputs.settle(true, true);
        }
        if !outputs.dialect.is_crtk() {
            let wanted = inner.options.enable || inner.options.home;
            if wanted && !std::mem::replace(&mut self.said_unready, true) {
                inner.say("`enable` and `home` have no effect in this dialect: power on and home it from its console");
            }
            let heard = outputs.is_asked();
            self.asked_mode = heard && (self.asked_mode || outputs.ask(Mode::CartesianEffort.name()));
            return;
        }
        let state = inner.state.lock().clone();
        let Some(wire::State { name, homed_busy: Some((homed, busy)) }) = &state else { return };
        let wish = match (name.as_str(), *homed) {
            ("ENABLED", true) => None,
            ("ENABLED", false) => Some(("home", inner.options.home)),
            _ => Some(("enable", inner.options.enable)),
        };
        let Some((command, allowed)) = wish else {
            (self.said_unready, self.asked) = (false, 0);
            return;
        };
        if !allowed {
            if !std::mem::replace(&mut self.said_unready, true) {
                inner.say(&format!(
                    "not ready, held still: {command} it from its console, or set `{command}: true` in its driver settings"
                ));
            }
            return;
        }
        if self.asked_in != state {
            (self.asked, self.asked_in) = (0, state.clone());
        }
        let patient = self.asked_at.is_some_and(|at| at.elapsed() < ASK_AGAIN) || *busy;
        if !patient && self.asked < MAX_REQUESTS && outputs.ask(command) {
            (self.asked, self.asked_at) = (self.asked + 1, Some(Instant::now()));
            inner.say(&format!("is told to {command}"));
            if self.asked == MAX_REQUESTS {
                inner.say(&format!("is not told to {command} again until its state changes"));
            }
        }
    }

    /// Says how the arm speaks, unless that was said.
    fn say_found(&mut self, inner: &Inner) {
        if let Some(dialect) = self.dialect.filter(|_| !std::mem::replace(&mut self.said_found, true)) {
            inner.say(&format!("found, dialect {dialect}"));
        }
    }

    fn report(&mut self, inner: &Inner) {
        let available = inner.is_available();
        match (std::mem::replace(&mut self.available, available), available) {
            (false, true) => {
                (self.posed, self.said_missing) = (Some(Instant::now()), false);
                self.say_found(inner);
                inner.say("poses come");
            }
            (true, false) => inner.say("no poses come any more; held still until they do"),
            _ => (),
        }
        let long = |since: Option<Instant>| since.is_some_and(|since| since.elapsed() > SILENCE);
        let is_stateless = || !inner.ready.load(Ordering::Acquire) && inner.state.lock().is_none();
        let missing = match available {
            _ if self.said_missing => return,
            false if self.posed.is_none() && long(self.listed) => {
                "the master lists it, but no valid pose comes: is its node alive, and does it reach this computer (ROS_IP)?"
            }
            true if long(self.posed) && is_stateless() => {
                "poses come, but not its operating_state, which is listed: held still until it does"
            }
            _ => return,
        };
        self.said_missing = true;
        inner.say(missing);
    }
}

/// Listens to one topic of an arm.
fn listen(inner: &Arc<Inner>, dialect: Dialect, name: &str, reading: Reading) -> Arc<dyn Announcement> {
    let accepted = match reading {
        Reading::Pose => wire::POSE_TYPES,
        Reading::Joints | Reading::Gripper => wire::JOINT_TYPES,
        Reading::Wrench => wire::WRENCH_TYPES,
        Reading::Closed => wire::BUTTON_TYPES,
        Reading::State => wire::STATE_TYPES,
        Reading::Jacobian => wire::MATRIX_TYPES,
    };
    let topic = inner.names.topic(dialect, name);
    let inner = Arc::clone(inner);
    let say = Arc::clone(&inner);
    subscribe(
        topic,
        accepted,
        move |kind, bytes| take(&inner, dialect, reading, kind, bytes),
        move |text| say.say(text),
    )
}

/// Messages of `accepted` types go to `take`; others, and bytes that are none, are named once.
pub(crate) fn subscribe(
    topic: String,
    accepted: &'static [&'static str],
    take: impl Fn(&str, &[u8]) -> Option<()> + Send + Sync + 'static,
    say: impl Fn(&str) + Send + Sync + 'static,
) -> Arc<dyn Announcement> {
    let (name, said) = (topic.clone(), AtomicBool::new(false));
    RawSubscription::new(topic, move |RawReceived { kind, body }| {
        if !accepted.contains(&kind) {
            if !said.swap(true, Ordering::Relaxed) {
                say(&format!("{name}: messages of type {kind} are not understood, expected {}", accepted.join(" or ")));
            }
        } else if take(kind, body).is_none() && !said.swap(true, Ordering::Relaxed) {
            let length = body.len();
            say(&format!("{name}: a message of {length} bytes is no valid {kind}; it and others like it are left out"));
        }
    })
}

/// Takes a message in; `None` if it is none.
fn take(inner: &Inner, dialect: Dialect, reading: Reading, kind: &str, bytes: &[u8]) -> Option<()> {
    // Robots that speak CRTK mark samples that are not valid by leaving out the time.
    fn valid<T>(dialect: Dialect, message: Stamped<T>) -> Option<T> {
        (!dialect.is_crtk() || message.stamped != Some(false)).then_some(message.value)
    }
    match reading {
        Reading::Pose => {
            if let Some(pose) = valid(dialect, wire::pose(kind, bytes)?) {
                inner.take_pose(&pose);
            }
        }
        Reading::Joints => {
            if let Some(joints) = valid(dialect, wire::joints(kind, bytes)?) {
                *inner.joints.lock() = joints;
            }
        }
        Reading::Gripper => {
            let joints = valid(dialect, wire::joints(kind, bytes)?);
            if let Some(&angle) = joints.as_ref().and_then(|joints| joints.position.first()) {
                inner.take_gripper(angle);
            }
        }
        Reading::Wrench => {
            if let Some(wrench) = valid(dialect, wire::wrench(kind, bytes)?) {
                *inner.measured_wrench.lock() = wrench;
            }
        }
        Reading::Closed => inner.take_closed(wire::button(kind, bytes)? != 0),
        Reading::State => inner.take_state(wire::state(kind, bytes)?),
        Reading::Jacobian => *inner.jacobian.lock() = wire::matrix(kind, bytes)?,
    }
    Some(())
}
