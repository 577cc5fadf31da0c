//! A node with the threads that tend it.

use std::io;
use std::sync::mpsc::{channel, Receiver, RecvTimeoutError};
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use parking_lot::Mutex;

use super::link::{run, Link, LinkOptions};
use super::subscriber;

/// How long [`Node::stop`] waits for a master that does not answer.
const STOP_TIMEOUT: Duration = Duration::from_secs(2);

/// A node. Topics and services are added to and removed from its [`link`](Self::link). Dropping it stops it.
pub struct Node {
    link: Arc<Link>,
    /// Disconnects when the last thread has ended. The lock is for nothing but sharing the node between threads.
    ended: Mutex<Option<Receiver<()>>>,
}

impl Node {
    /// A node whose threads run; whether there is a master does not matter.
    ///
    /// # Errors
    /// When there are no sockets or no thread to be had.
    pub fn start(options: LinkOptions) -> io::Result<Self> {
        let link = Arc::new(Link::new(options)?);
        let (alive, ended) = channel::<()>();
        // From here on dropping cleans up whatever has been started.
        let node = Self { link, ended: Mutex::new(Some(ended)) };
        for (name, work) in [("ros-connect", (|link| subscriber::tend(link.graph())) as fn(&Link)), ("ros-link", run)] {
            let (link, alive) = (Arc::clone(&node.link), alive.clone());
            thread::Builder::new().name(name.into()).spawn(move || {
                let _alive = alive;
                work(&link);
            })?;
        }
        Ok(node)
    }

    /// Where topics and services are added and removed.
    pub fn link(&self) -> &Arc<Link> {
        &self.link
    }

    /// Withdraws everything. Takes at most 2 s, also when the master does not answer.
    pub fn stop(&self) {
        let Some(ended) = self.ended.lock().take() else { return };
        self.link.stop.stop();
        self.link.graph().changed.stop();
        if ended.recv_timeout(STOP_TIMEOUT) == Err(RecvTimeoutError::Timeout) {
            let seconds = STOP_TIMEOUT.as_secs();
            self.link.report(format_args!("ROS: the master did not let us go within {seconds} s; ended without it"));
        }
        self.link.graph().stop();
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        self.stop();
    }
}
