//! What the program says, on `/rosout` of ROS 1, where programs that use rosconsole say it, too.

use std::cell::Cell;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{sync_channel, Receiver};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant, SystemTime};

use ros_node::{Link, Report, Severity};

use super::named;
use crate::report::{self, Level, Listener};

/// Lines that wait at most; more are counted, and said.
const WAITING: usize = 1000;

/// How long the first lines wait for somebody to listen: the node `/rosout` hears of us after we have registered.
const PATIENCE: Duration = Duration::from_secs(10);

/// How often is looked whether somebody listens, meanwhile.
const LOOK: Duration = Duration::from_millis(20);

thread_local! {
    /// What is said in this thread now is of a node that publishes it by itself.
    static IS_OF_NODE: Cell<bool> = const { Cell::new(false) };
}

/// Where a node of this program says what its user should know: its lines are not published a second time.
pub(crate) fn of_node() -> Report {
    Arc::new(|line| {
        IS_OF_NODE.set(true);
        report::report(line);
        IS_OF_NODE.set(false);
    })
}

/// A line that is to be sent.
struct Line {
    severity: Severity,
    at: SystemTime,
    text: String,
}

/// Sends what the program says until it is dropped. Lines wait in a bounded queue: those who say them never wait.
pub(super) struct Log {
    listener: Arc<Listener>,
}

impl Log {
    /// What is said from now on, and what was said before anybody listened, as lines of the node of `link`.
    ///
    /// # Errors
    /// When no thread can be made.
    pub fn start(link: &Arc<Link>) -> io::Result<Self> {
        let (sender, lines) = sync_channel(WAITING);
        let lost = Arc::<AtomicU64>::default();
        let own_lost = Arc::clone(&lost);
        let link = Arc::clone(link);
        named("ros-log").spawn(move || send(&link, &lines, &lost))?;
        let listener: Arc<Listener> = Arc::new(move |level: Level, text: &str| {
            if IS_OF_NODE.get() {
                return;
            }
            let line = Line { severity: severity(level), at: SystemTime::now(), text: text.to_owned() };
            if sender.try_send(line).is_err() {
                own_lost.fetch_add(1, Ordering::Relaxed);
            }
        });
        report::add_listener(&listener);
        Ok(Self { listener })
    }
}

impl Drop for Log {
    /// The thread ends with the last line.
    fn drop(&mut self) {
        report::remove_listener(&self.listener);
    }
}

fn severity(level: Level) -> Severity {
    match level {
        Level::Debug => Severity::Debug,
        Level::Info => Severity::Info,
        Level::Warn => Severity::Warn,
        Level::Error => Severity::Error,
        Level::Fatal => Severity::Fatal,
    }
}

fn send(link: &Link, lines: &Receiver<Line>, lost: &AtomicU64) {
    let until = Instant::now() + PATIENCE;
    while let Ok(Line { severity, at, text }) = lines.recv() {
        while !link.is_log_heard() && Instant::now() < until && !link.stop.is_stopped() {
            thread::sleep(LOOK);
        }
        link.log(severity, at, &text);
        let lost = lost.swap(0, Ordering::Relaxed);
        if lost > 0 {
            link.log(Severity::Warn, SystemTime::now(), &format!("{lost} lines were said too fast to be sent"));
        }
    }
}
