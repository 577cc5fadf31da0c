//! One thread that serves any number of connections.
//!
//! A [`Handler`] owns a socket that does not block. The thread waits until the kernel says that one of them can be read
//! or written (epoll, edge-triggered, by `mio`), and calls its handler. Handlers never wait; what has to wait, an answer
//! of a service or a call to the master, is done in other threads.

use std::collections::{HashMap, HashSet, VecDeque};
use std::io;
use std::os::fd::RawFd;
use std::panic::{catch_unwind, AssertUnwindSafe};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use mio::unix::SourceFd;
use mio::{Events, Interest, Poll, Token, Waker};
use parking_lot::Mutex;

/// The waker's token; sockets count from 0.
const WAKE: Token = Token(usize::MAX);

/// How often deadlines are looked at while there are any, and handlers called that asked for it.
const TICK: Duration = Duration::from_millis(100);

/// What a handler wants next.
pub(crate) enum Turn {
    /// To be called when its socket is ready again.
    Wait,
    /// To be called again after the others: it has more to do and leaves them a turn.
    Again,
    /// To be called again within a tenth of a second: the machine lacks something now.
    Later,
    /// To be dropped. Its socket is closed with it unless it has handed it on.
    Done,
}

/// A socket with what is done when it is ready.
pub(crate) trait Handler: Send {
    /// The socket.
    fn socket(&self) -> RawFd;

    /// Reads and writes as much as goes without waiting. Called once when the socket is new, and at each event.
    fn ready(&mut self) -> Turn;

    /// When it is dropped, should it still be here.
    fn deadline(&self) -> Option<Instant> {
        None
    }
}

/// Where new handlers are handed in, from any thread.
pub(crate) struct Desk {
    fresh: Mutex<Vec<Box<dyn Handler>>>,
    waker: Waker,
    stopped: AtomicBool,
}

impl Desk {
    /// Serves `handler` from now on; drops it when the thread has ended.
    pub fn add(&self, handler: Box<dyn Handler>) {
        if self.stopped.load(Ordering::Acquire) {
            return;
        }
        self.fresh.lock().push(handler);
        self.wake();
    }

    fn wake(&self) {
        // It fails only when the kernel has no memory left for a counter; the next event serves as well.
        let _ = self.waker.wake();
    }
}

/// The thread. Dropping it ends it and drops all handlers.
pub(crate) struct Reactor {
    desk: Arc<Desk>,
    thread: Option<JoinHandle<()>>,
}

impl Reactor {
    /// Starts the thread, called `name`.
    ///
    /// # Errors
    /// When there is no thread or no epoll instance to be had.
    pub fn start(name: &str) -> io::Result<Self> {
        let poll = Poll::new()?;
        let waker = Waker::new(poll.registry(), WAKE)?;
        let desk = Arc::new(Desk { fresh: Mutex::default(), waker, stopped: AtomicBool::new(false) });
        let own = Arc::clone(&desk);
        let thread = std::thread::Builder::new().name(name.into()).spawn(move || Loop::new(poll, own).run())?;
        Ok(Self { desk, thread: Some(thread) })
    }

    /// Where handlers are handed in.
    pub fn desk(&self) -> &Arc<Desk> {
        &self.desk
    }

    /// Ends the thread; all handlers are dropped when this returns.
    pub fn stop(&mut self) {
        self.desk.stopped.store(true, Ordering::Release);
        self.desk.wake();
        if let Some(thread) = self.thread.take() {
            // Panics of handlers are caught; one of the loop itself has been written to standard error.
            let _ = thread.join();
        }
        self.desk.fresh.lock().clear();
    }
}

impl Drop for Reactor {
    fn drop(&mut self) {
        self.stop();
    }
}

struct Loop {
    poll: Poll,
    desk: Arc<Desk>,
    /// By token. Tokens are never used twice, so that a late event of a closed socket means nothing.
    handlers: HashMap<Token, Box<dyn Handler>>,
    next: usize,
    /// Those with a deadline.
    timed: HashSet<Token>,
    /// Those that want another turn.
    again: VecDeque<Token>,
    /// Those that want one at the next tick.
    later: HashSet<Token>,
}

impl Loop {
    fn new(poll: Poll, desk: Arc<Desk>) -> Self {
        let (timed, later) = (HashSet::new(), HashSet::new());
        Self { poll, desk, handlers: HashMap::new(), next: 0, timed, again: VecDeque::new(), later }
    }

    fn run(mut self) {
        let mut events = Events::with_capacity(256);
        let mut ticked = Instant::now();
        while !self.desk.stopped.load(Ordering::Acquire) {
            let wait = match (self.again.is_empty(), self.timed.is_empty() && self.later.is_empty()) {
                (false, _) => Some(Duration::ZERO),
                (true, false) => Some(TICK),
                (true, true) => None,
            };
            match self.poll.poll(&mut events, wait) {
                Err(error) if error.kind() != io::ErrorKind::Interrupted => return,
                _ => (),
            }
            let ready: Vec<Token> = events.iter().map(|event| event.token()).filter(|token| *token != WAKE).collect();
            ready.into_iter().for_each(|token| self.serve(token));
            for token in std::mem::take(&mut self.again) {
                self.serve(token);
            }
            let fresh = std::mem::take(&mut *self.desk.fresh.lock());
            fresh.into_iter().for_each(|handler| self.take_in(handler));
            if ticked.elapsed() >= TICK {
                ticked = Instant::now();
                std::mem::take(&mut self.later).into_iter().for_each(|token| self.serve(token));
                self.drop_overdue();
            }
        }
    }

    fn take_in(&mut self, handler: Box<dyn Handler>) {
        let token = Token(self.next);
        self.next += 1;
        let both = Interest::READABLE | Interest::WRITABLE;
        if self.poll.registry().register(&mut SourceFd(&handler.socket()), token, both).is_ok() {
            self.handlers.insert(token, handler);
            self.serve(token);
        }
    }

    fn serve(&mut self, token: Token) {
        let Some(handler) = self.handlers.get_mut(&token) else { return };
        // A call-back that panics ends its own connection only.
        let turn = catch_unwind(AssertUnwindSafe(|| handler.ready())).unwrap_or(Turn::Done);
        match turn {
            Turn::Wait => (),
            Turn::Again => self.again.push_back(token),
            Turn::Later => {
                self.later.insert(token);
            }
            Turn::Done => return self.close(token),
        }
        match handler.deadline() {
            Some(_) => self.timed.insert(token),
            None => self.timed.remove(&token),
        };
    }

    fn close(&mut self, token: Token) {
        self.timed.remove(&token);
        if let Some(handler) = self.handlers.remove(&token) {
            // Somebody else may hold the socket too: an epoll instance forgets a socket by itself only when it is closed.
            let _ = self.poll.registry().deregister(&mut SourceFd(&handler.socket()));
        }
    }

    fn drop_overdue(&mut self) {
        let now = Instant::now();
        let is_over = |token: &&Token| {
            let deadline = self.handlers.get(*token).and_then(|handler| handler.deadline());
            deadline.is_some_and(|deadline| deadline <= now)
        };
        let overdue: Vec<Token> = self.timed.iter().filter(is_over).copied().collect();
        overdue.into_iter().for_each(|token| self.close(token));
    }
}
