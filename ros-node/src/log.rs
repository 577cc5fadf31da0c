//! Log messages as ROS has them: each node publishes its own on `/rosout`, and one node repeats all on `/rosout_agg`.

use std::io;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use rosrust::msg::rosgraph_msgs::Log;

use super::announcement::Announcement;
use super::link::{LinkOptions, NodeName, OwnMaster};
use super::node::Node;
use super::subscriber::RawSubscription;
use super::topic::Publication;
use super::xmlrpc::Peer;

/// Topic of the log messages of each node.
const OWN: &str = "/rosout";

/// Topic of the log messages of all nodes.
const ALL: &str = "/rosout_agg";

/// Name of the node that repeats all.
pub(crate) const AGGREGATOR: &str = "/rosout";

/// Longest log message, bytes.
const LONGEST: usize = 1 << 20;

/// How important a log message is; the numbers are those of `rosgraph_msgs/Log`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Severity {
    /// For those who look for a mistake.
    Debug = 1,
    /// Something has happened.
    Info = 2,
    /// Something is not as it should be.
    Warn = 4,
    /// Something cannot be done.
    Error = 8,
    /// The program ends.
    Fatal = 16,
}

/// A node's own log messages.
pub(crate) struct OwnLog {
    name: String,
    publication: Arc<Publication<Log>>,
}

impl OwnLog {
    /// Of the node called `name`.
    pub fn new(name: &str) -> Self {
        Self { name: name.to_owned(), publication: Publication::new(OWN.into()) }
    }

    pub fn announcement(&self) -> Arc<dyn Announcement> {
        Arc::clone(&self.publication) as Arc<dyn Announcement>
    }

    /// Whether anybody listens.
    pub fn is_heard(&self) -> bool {
        self.publication.has_subscribers()
    }

    /// Publishes a line for the user, said at `at`.
    pub fn line(&self, severity: Severity, at: SystemTime, text: &str) {
        if !self.is_heard() {
            return;
        }
        let since = at.duration_since(UNIX_EPOCH).unwrap_or_default();
        let mut log =
            Log { level: severity as i8, name: self.name.clone(), msg: text.to_owned(), ..Default::default() };
        log.header.stamp = rosrust::Time { sec: since.as_secs() as u32, nsec: since.subsec_nanos() };
        self.publication.send(log);
    }
}

/// A node called `/rosout` that repeats the log messages of all nodes on `/rosout_agg`, as `roscore` brings one. It
/// lives until it is dropped.
pub(crate) struct LogAggregator {
    _node: Node,
}

impl LogAggregator {
    /// A node of the master at `master`.
    ///
    /// # Errors
    /// When there are no sockets or no thread to be had.
    pub fn start(master: &Peer) -> io::Result<Self> {
        let node = Node::start(LinkOptions {
            master: master.clone(),
            name: NodeName::Full(AGGREGATOR.into()),
            own_master: OwnMaster::None,
            parameters: Vec::new(),
            report: super::silent(),
        })?;
        let all = Publication::<Log>::new(ALL.into());
        let out = Arc::clone(&all);
        let own = RawSubscription::of::<Log>(OWN.into(), LONGEST, move |message| out.send_encoded(message.body));
        node.link().add([all as Arc<dyn Announcement>, own]);
        Ok(Self { _node: node })
    }
}
