//! A ROS 1 node that outlives its master. It knows nothing of the simulator.
//!
//! It speaks ROS 1's own protocols in all roles: publisher, subscriber, service, and a master when there is none. All
//! connections of a node are served by one thread (two, when there are large messages), whatever their number. What
//! programs need that run beside a robot all day is part of it: the master may be absent at the start, restart or hang;
//! one subscriber that stops reading does not starve the others; small messages are sent at once; messages of any type
//! can be received; no peer is believed a length; while the master is on this machine, only programs of this machine get
//! in. Messages are those that rosrust generates.
//!
//! | thread | what it does | file |
//! |---|---|---|
//! | `ros-io` | accepts connections, sends what did not go at once, receives, answers calls | `reactor.rs`, `graph.rs` |
//! | `ros-large` | the same for large messages, while there are any | |
//! | `ros-link` | finds or starts the master, registers, notices when the master goes or forgets | `link.rs` |
//! | `ros-connect` | asks the master who publishes | `subscriber.rs` |
//! | `ros-call` | one a publishing node while it is being connected to | `subscriber.rs` |
//! | `ros-request` | one a client of a service | `service.rs` |
//! | `ros-master`, `ros-notice` | a master in this process; one a node while it is told something | `master.rs` |
//!
//! Begin with [`Node`]. What is announced is an [`Announcement`]: a [`Publication`], a [`RawSubscription`], a
//! [`LargePublication`], a [`ServiceServer`]. Two nodes in one process do not know of each other.
//!
//! Not in: clients of services; messages, which rosrust generates; UDP; simulated time.

mod address;
mod announcement;
mod calls;
mod connections;
mod graph;
mod lasting;
mod link;
mod log;
mod master;
mod node;
mod parameters;
mod reactor;
mod service;
mod stop;
mod subscriber;
pub mod tcpros;
mod topic;
mod xmlrpc;

use std::fmt::Arguments;
use std::sync::Arc;

pub use announcement::{Announcement, Direction, Registration};
pub use lasting::{end_master, entries, node, serve_master, start_master, EndError, SERVE_MASTER, UNUSED};
pub use link::{Link, LinkOptions, NodeName, OwnMaster};
pub use log::Severity;
pub use master::Master;
pub use node::Node;
pub use service::{ServiceKind, ServiceServer};
pub use stop::Stop;
pub use subscriber::{RawReceived, RawSubscription};
pub use topic::{LargePublication, Publication};
pub use xmlrpc::{CallError, Peer};

/// Where a node says what its user should know, a line at a time; called from any thread.
pub type Report = Arc<dyn Fn(Arguments<'_>) + Send + Sync>;

/// Says nothing.
pub fn silent() -> Report {
    Arc::new(|_| ())
}

/// Address of the master: `ROS_MASTER_URI`, or `http://localhost:11311/` where that is not set.
pub fn master_uri() -> String {
    let uri = std::env::var("ROS_MASTER_URI").ok().filter(|uri| !uri.is_empty());
    uri.unwrap_or_else(|| String::from("http://localhost:11311/"))
}

/// Lets this process open as many sockets and files as the system permits, usually half a million, instead of the 1024 that it
/// is given at first: each subscriber of each topic needs one. To be called by programs with many topics.
pub fn allow_many_connections() {
    use rustix::process::{getrlimit, setrlimit, Resource, Rlimit};
    let limit = getrlimit(Resource::Nofile);
    // A refusal leaves what there was.
    let _ = setrlimit(Resource::Nofile, Rlimit { current: limit.maximum, ..limit });
}
