//! A ROS 1 node that outlives its master, on rosrust. It knows nothing of the simulator.
//!
//! rosrust registers a topic once and never looks back, waits for ever for a peer that hangs, and leaves its sockets as
//! they come. What programs need that run beside a robot all day is added here, without changes to rosrust: the master
//! may be absent at the start, restart or hang; one subscriber that stops reading does not starve the others; small
//! messages are sent at once; messages of any type can be received.
//!
//! Large messages are published by a [`SideNode`], with a thread a subscriber.
//!
//! A [`Node`] does everything in threads of its own. Two nodes in one process do not know of each other.
//!
//! Begin with [`Node`] for a program that publishes and listens; with [`Link`] and [`run`] where threads are the
//! program's own. What is announced is an [`Announcement`]: a [`Publication`], a [`RawSubscription`], a
//! [`LargePublication`].
//!
//! Not in: services, of which `ambf_app::ros` has a server; messages, which rosrust generates.

mod embedded;
mod lasting;
mod link;
mod node;
mod side;
mod sockets;
mod stop;
mod subscriber;
pub mod tcpros;
mod topic;
mod xmlrpc;

use std::fmt::Arguments;
use std::sync::Arc;

pub use lasting::{end_master, entries, node, serve_master, start_master, EndError, SERVE_MASTER, UNUSED};
pub use link::{run, tend_connections, tend_sockets, Link, LinkOptions, NodeName, OwnMaster};
pub use node::Node;
pub use side::{LargePublication, SideNode};
pub use stop::Stop;
pub use subscriber::{Publishers, RawReceived, RawSubscription};
pub use topic::{is_permanent, Announcement, Direction, Publication, Registration};
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
