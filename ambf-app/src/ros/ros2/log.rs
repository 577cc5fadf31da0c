//! What the program says, on `/rosout`.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{sync_channel, Receiver};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use parking_lot::Mutex;
use ros2_node::{LogLine, Node, Participant, Publication, Qos, Timer, TypeName};

use super::transport::Failure;
use crate::report::{self, Level, Listener};

/// Topic of all lines of all nodes.
const TOPIC: &str = "/rosout";

/// Lines that those get who come later, as with other nodes of ROS 2.
const DEPTH: u32 = 1000;

/// How often lines that were said are sent.
const PERIOD: Duration = Duration::from_millis(50);

/// A line that is to be sent.
struct Line {
    level: Level,
    at: Duration,
    text: String,
}

/// Sends what the program says until it is dropped. Lines wait in a bounded queue: those who say them, among them the
/// threads of DDS, never wait. What finds no room is counted, and said.
pub(super) struct Log {
    listener: Arc<Listener>,
    queue: Arc<Queue>,
    _timer: Timer,
}

struct Queue {
    name: String,
    publication: Arc<Publication>,
    lines: Mutex<Receiver<Line>>,
    lost: Arc<AtomicU64>,
}

impl Log {
    /// What is said from now on, on `node`.
    pub fn new(participant: &Participant, node: &Node) -> Result<Self, Failure> {
        // RustDDS keeps as many as are latched, and those that are not acknowledged.
        let qos = Qos { window: 2 * DEPTH, ..Qos::latched().with_depth(DEPTH) };
        let publication = node.publish(TOPIC, &TypeName::message("rcl_interfaces", "Log"), qos)?;
        let (sender, lines) = sync_channel(DEPTH as usize);
        let lost = Arc::<AtomicU64>::default();
        let own_lost = Arc::clone(&lost);
        let listener: Arc<Listener> = Arc::new(move |level: Level, text: &str| {
            let at = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
            if sender.try_send(Line { level, at, text: text.to_owned() }).is_err() {
                own_lost.fetch_add(1, Ordering::Relaxed);
            }
        });
        let name = node.full_name().trim_matches('/').replace('/', ".");
        let queue = Arc::new(Queue { name, publication, lines: Mutex::new(lines), lost });
        let sending = Arc::clone(&queue);
        let timer = participant.call_every(PERIOD, move || sending.send());
        report::add_listener(&listener);
        Ok(Self { listener, queue, _timer: timer })
    }
}

impl Drop for Log {
    fn drop(&mut self) {
        report::remove_listener(&self.listener);
        self.queue.send();
    }
}

impl Queue {
    fn send(&self) {
        let lines = self.lines.lock();
        for Line { level, at, text } in lines.try_iter() {
            self.send_line(level, at, &text);
        }
        let lost = self.lost.swap(0, Ordering::Relaxed);
        if lost > 0 {
            let at = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
            self.send_line(Level::Warn, at, &format!("{lost} lines were said too fast to be sent"));
        }
    }

    fn send_line(&self, level: Level, at: Duration, text: &str) {
        let line = LogLine { at, level: level as u8, name: &self.name, text };
        // Who does not read lines misses them.
        let _ = self.publication.send(&line.encode());
    }
}
