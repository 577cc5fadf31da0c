//! What all arms of a process share: one node, one thread that watches the master, the pedals.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Weak};
use std::time::Duration;

use dxr::Value;
use parking_lot::Mutex;
use ros_node::{Announcement, CallError, Link, LinkOptions, Node, NodeName, OwnMaster, Peer, Stop};

use crate::arm::ArmError;
use crate::dialect::Topics;
use crate::inner::Inner;
use crate::options::Say;
use crate::pedals::{Pedal, Pedals};
use crate::session::{subscribe, Session};
use crate::wire;

/// How often the master is asked what is published.
const POLL: Duration = Duration::from_millis(500);

/// How long the master may take to answer.
const MASTER_TIMEOUT: Duration = Duration::from_secs(1);

/// The hub of this process while there are arms.
static HUB: Mutex<Weak<Hub>> = Mutex::new(Weak::new());

/// An arm and what is known about it.
type Watched = (Weak<Inner>, Arc<Mutex<Session>>);

/// The node of all arms.
pub(crate) struct Hub {
    watch: Arc<Watch>,
    node: Node,
}

/// What the watching thread needs.
struct Watch {
    link: Arc<Link>,
    arms: Arc<Mutex<Vec<Watched>>>,
    boards: PedalBoards,
    stop: Stop,
}

impl Hub {
    /// The hub of this process, started if need be.
    ///
    /// # Errors
    /// [`ArmError::Master`] for a `ROS_MASTER_URI` that is none, [`ArmError::Thread`].
    pub fn get() -> Result<Arc<Self>, ArmError> {
        let mut known = HUB.lock();
        if let Some(hub) = known.upgrade() {
            return Ok(hub);
        }
        let hub = Arc::new(Self::start()?);
        *known = Arc::downgrade(&hub);
        Ok(hub)
    }

    fn start() -> Result<Self, ArmError> {
        let arms = Arc::<Mutex<Vec<Watched>>>::default();
        let voices = Arc::downgrade(&arms);
        // Sentences about the node are said once, by the first arm.
        let report = move |line: std::fmt::Arguments<'_>| {
            let Some(arms) = voices.upgrade() else { return };
            let first = arms.lock().iter().find_map(|(arm, _)| arm.upgrade());
            if let Some(arm) = first {
                (arm.options.say)(&line.to_string());
            }
        };
        let options = LinkOptions {
            master: Peer::new(&ros_node::master_uri(), "/dvrk_arm", MASTER_TIMEOUT)?,
            name: NodeName::Anonymous("dvrk_arm".into()),
            // The simulator starts one if it is to be started.
            own_master: OwnMaster::None,
            parameters: Vec::new(),
            report: Arc::new(report),
        };
        let node = Node::start(options).map_err(ArmError::Thread)?;
        let link = Arc::clone(node.link());
        let watch = Arc::new(Watch { link, arms, boards: PedalBoards::default(), stop: Stop::default() });
        let watching = Arc::clone(&watch);
        let hub = Self { watch, node };
        let thread = std::thread::Builder::new().name("dvrk-watch".into());
        thread.spawn(move || watching.run()).map_err(ArmError::Thread)?;
        Ok(hub)
    }

    /// Looks after an arm from now on.
    pub fn add(&self, inner: &Arc<Inner>) {
        self.watch.arms.lock().push((Arc::downgrade(inner), Arc::default()));
        self.watch.stop.nudge();
    }

    /// Lets go of arms that are closed, soon.
    pub fn tidy(&self) {
        self.watch.stop.nudge();
    }

    /// Whether the node was told to shut down from outside.
    pub fn is_dismissed(&self) -> bool {
        self.node.link().is_dismissed()
    }
}

impl Drop for Hub {
    fn drop(&mut self) {
        self.watch.stop.stop();
        self.node.stop();
    }
}

impl Watch {
    fn run(&self) {
        loop {
            let topics = published(&self.link.master());
            let arms = self.arms.lock().clone();
            for (arm, session) in &arms {
                let open = arm.upgrade().filter(|arm| !arm.closing.load(Ordering::Acquire));
                match (open, &topics) {
                    (Some(arm), Ok(topics)) => session.lock().watch(&arm, topics, &self.link, &self.boards),
                    // The master is away: connections between nodes stay.
                    (Some(_), Err(_)) => (),
                    (None, _) => session.lock().end(&self.link),
                }
            }
            self.arms.lock().retain(|(arm, _)| arm.upgrade().is_some_and(|arm| !arm.closing.load(Ordering::Acquire)));
            drop(arms);
            self.boards.prune(&self.link);
            if self.stop.wait(POLL) {
                return;
            }
        }
    }
}

/// What is published at present, and its types.
///
/// # Errors
/// When the master does not answer.
pub(crate) fn published(master: &Peer) -> Result<Topics, CallError> {
    let Value::Array(list) = master.call("getPublishedTopics", vec![Value::String(String::new())])? else {
        return Err(CallError::NotRos(master.uri().to_owned()));
    };
    let pair = |entry| match entry {
        Value::Array(pair) => match <[Value; 2]>::try_from(pair) {
            Ok([Value::String(topic), Value::String(kind)]) => Some((topic, kind)),
            _ => None,
        },
        _ => None,
    };
    Ok(list.into_iter().filter_map(pair).collect())
}

/// Topics of the pedals and which pedal each is.
type BoardKey = Vec<(String, Pedal)>;

/// Subscriptions of one set of pedals. Shared: who subscribes later would not get what is latched.
pub(crate) struct PedalBoard {
    key: BoardKey,
    pedals: Arc<Pedals>,
    subscriptions: Vec<Arc<dyn Announcement>>,
}

impl PedalBoard {
    pub fn topics(&self) -> &[(String, Pedal)] {
        &self.key
    }

    pub fn pedals(&self) -> Arc<Pedals> {
        Arc::clone(&self.pedals)
    }
}

/// The sets that are in use.
#[derive(Default)]
pub(crate) struct PedalBoards(Mutex<BTreeMap<Vec<String>, Arc<PedalBoard>>>);

impl PedalBoards {
    /// The pedals of those topics; what is wrong with their messages goes to `say`.
    pub fn board(&self, key: BoardKey, link: &Link, say: &Say) -> Arc<PedalBoard> {
        let names = key.iter().map(|(topic, _)| topic.clone()).collect();
        let mut boards = self.0.lock();
        let board = boards.entry(names).or_insert_with(|| {
            let pedals = Arc::<Pedals>::default();
            let listen = |(topic, pedal): &(String, Pedal)| {
                let (pedals, pedal) = (Arc::clone(&pedals), *pedal);
                let take = move |kind: &str, bytes: &[u8]| {
                    pedals.set(pedal, wire::button(kind, bytes)?);
                    Some(())
                };
                let say = Arc::clone(say);
                subscribe(topic.clone(), wire::BUTTON_TYPES, take, move |text| say(&format!("ROS: {text}")))
            };
            let subscriptions: Vec<_> = key.iter().map(listen).collect();
            link.add(subscriptions.iter().map(Arc::clone));
            Arc::new(PedalBoard { key, pedals, subscriptions })
        });
        Arc::clone(board)
    }

    /// Withdraws those that nobody uses any more.
    fn prune(&self, link: &Link) {
        let mut unused = Vec::new();
        self.0.lock().retain(|_, board| {
            let used = Arc::strong_count(board) > 1;
            if !used {
                unused.extend(board.subscriptions.iter().map(Arc::clone));
            }
            used
        });
        link.remove(&unused);
    }
}
