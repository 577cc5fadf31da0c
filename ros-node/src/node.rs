//! A node with the threads that tend it.

use std::io;
use std::sync::mpsc::{channel, Receiver, RecvTimeoutError};
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use parking_lot::Mutex;

use super::link::{run, tend_connections, tend_sockets, Link, LinkOptions};

/// How long [`Node::stop`] waits for a master that does not answer.
const STOP_TIMEOUT: Duration = Duration::from_secs(2);

/// A node. Topics are added to and removed from its [`link`](Self::link). Dropping it stops it.
pub struct Node {
    link: Arc<Link>,
    /// Disconnects when the last thread has ended. The lock is for nothing but sharing the node between threads.
    ended: Mutex<Option<Receiver<()>>>,
}

impl Node {
    /// A node whose threads run; whether there is a master does not matter.
    ///
    /// # Errors
    /// When no thread can be made.
    pub fn start(options: LinkOptions) -> io::Result<Self> {
        let link = Arc::new(Link::new(options));
        let (alive, ended) = channel::<()>();
        // From here on dropping cleans up whatever has been started.
        let node = Self { link, ended: Mutex::new(Some(ended)) };
        for (name, work) in
            [("ros-sockets", tend_sockets as fn(&Link)), ("ros-connect", tend_connections), ("ros-link", run)]
        {
            let (link, alive) = (Arc::clone(&node.link), alive.clone());
            thread::Builder::new().name(name.into()).spawn(move || {
                let _alive = alive;
                work(&link);
            })?;
        }
        Ok(node)
    }

    /// Where topics are added and removed.
    pub fn link(&self) -> &Arc<Link> {
        &self.link
    }

    /// Withdraws everything. Takes at most 2 s, also when the master does not answer.
    pub fn stop(&self) {
        let Some(ended) = self.ended.lock().take() else { return };
        self.link.stop.stop();
        if ended.recv_timeout(STOP_TIMEOUT) == Err(RecvTimeoutError::Timeout) {
            self.link.report(format_args!("ROS: the master did not let us go within {} s", STOP_TIMEOUT.as_secs()));
        }
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        self.stop();
    }
}
