//! What the programs say: their only log, one line a fact on standard error, and what they were asked for on standard output.

use std::collections::VecDeque;
use std::fmt::Arguments;
use std::io::{ErrorKind, Write};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_core::files::{self, WriteError};
use ambf_core::text;
use parking_lot::{Mutex, RwLock};

/// How important a line is; the numbers are those of `rcl_interfaces/msg/Log` and of ROS 2's loggers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Level {
    /// For those who look for a mistake.
    Debug = 10,
    /// Something has happened.
    Info = 20,
    /// Something is not as it should be, and the program goes on.
    Warn = 30,
    /// Something cannot be done.
    Error = 40,
    /// The program ends.
    Fatal = 50,
}

impl Level {
    /// All, the least important first, with their names.
    pub const ALL: [(Self, &'static str); 5] = [
        (Self::Debug, "debug"),
        (Self::Info, "info"),
        (Self::Warn, "warn"),
        (Self::Error, "error"),
        (Self::Fatal, "fatal"),
    ];

    /// The level called `name`, in small or capital letters.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|(_, own)| own.eq_ignore_ascii_case(name)).map(|(level, _)| level)
    }
}

/// The least important level that is written.
static LEAST: AtomicU8 = AtomicU8::new(Level::Debug as u8);

/// Who else gets lines.
static LISTENERS: RwLock<Vec<Arc<Listener>>> = RwLock::new(Vec::new());

/// Lines that were said before anybody listened, such as those about the files of a scene: for who listens then.
static EARLY: Mutex<VecDeque<(Level, String)>> = Mutex::new(VecDeque::new());

/// Most early lines that are kept: the last ones.
const MAX_EARLY_LINES: usize = 200;

/// Gets lines with their level, in the thread that reports them: must neither report nor wait.
pub type Listener = dyn Fn(Level, &str) + Send + Sync;

/// Writes nothing that is less important than `level` from now on. Default: [`Level::Debug`].
pub fn set_level(level: Level) {
    LEAST.store(level as u8, Ordering::Relaxed);
}

/// Gives every line to `listener`, too, until it is [removed](remove_listener); also the last ones (200 at most) of those
/// that were said before there was the first listener.
pub fn add_listener(listener: &Arc<Listener>) {
    let mut listeners = LISTENERS.write();
    listeners.push(Arc::clone(listener));
    EARLY.lock().iter().for_each(|(level, line)| listener(*level, line));
}

/// Gives no more lines to `listener`.
pub fn remove_listener(listener: &Arc<Listener>) {
    LISTENERS.write().retain(|other| !Arc::ptr_eq(other, listener));
}

/// Writes one line of the level [`Level::Info`], as [`report_at`] does.
pub fn report(line: Arguments<'_>) {
    report_at(Level::Info, line);
}

/// Writes one line to standard error, or several, as [`text::lines`] shows them: what files, messages and clients hold
/// is no part of the terminal's language. One that does not arrive is not worth a panic; [`exit_status`] tells.
pub fn report_at(level: Level, line: Arguments<'_>) {
    if (level as u8) < LEAST.load(Ordering::Relaxed) {
        return;
    }
    let mut line = text::lines(&line.to_string()).into_owned();
    {
        let listeners = LISTENERS.read();
        if listeners.is_empty() {
            let mut early = EARLY.lock();
            if early.len() == MAX_EARLY_LINES {
                early.pop_front();
            }
            early.push_back((level, line.clone()));
        }
        listeners.iter().for_each(|listener| listener(level, &line));
    }
    line.push('\n');
    // One call, so that lines of different threads do not mix.
    let written = std::io::stderr().write_all(line.as_bytes());
    if written.is_err_and(|error| error.kind() != ErrorKind::BrokenPipe) {
        INCOMPLETE.store(true, Ordering::Relaxed);
    }
}

/// Formats like [`println!`] and writes one line to standard error.
#[macro_export]
macro_rules! report {
    ($($part:tt)*) => { $crate::report::report(::std::format_args!($($part)*)) };
}

/// [`report!`] for what is not as it should be: a line of the level [`Level::Warn`].
#[macro_export]
macro_rules! warn {
    ($($part:tt)*) => {
        $crate::report::report_at($crate::report::Level::Warn, ::std::format_args!($($part)*))
    };
}

/// Whether something that was asked for, or said, has not arrived.
static INCOMPLETE: AtomicBool = AtomicBool::new(false);

/// Whether it was said already that standard output cannot be written.
static OUTPUT_FAILED: AtomicBool = AtomicBool::new(false);

/// Writes one line to standard output, or several, as [`text::lines`] shows them. What does not arrive is said once on standard error and makes another
/// [`exit_status`], unless nobody reads any more.
pub fn print_line(line: Arguments<'_>) {
    note_output(files::print(&text::lines(&format!("{line}\n"))));
}

/// Writes a document for other programs to standard output, as it is. As [`print_line`] otherwise.
pub fn print_document(document: &str) {
    note_output(files::print(&format!("{document}\n")));
}

fn note_output(written: Result<(), WriteError>) {
    let Err(error) = written else { return };
    if !error.is_unread() && !OUTPUT_FAILED.swap(true, Ordering::Relaxed) {
        report_failure(format_args!("{error}"));
    }
}

/// Says that something that was asked for could not be written: a line of the level [`Level::Error`], and another
/// [`exit_status`].
pub fn report_failure(line: Arguments<'_>) {
    INCOMPLETE.store(true, Ordering::Relaxed);
    report_at(Level::Error, line);
}

/// The exit status of a program that ends with `status`: `failed` instead of 0 if something that was asked for, or said,
/// could not be written.
pub fn exit_status(status: i32, failed: i32) -> i32 {
    note_output(files::close_output());
    match status {
        0 if INCOMPLETE.load(Ordering::Relaxed) => failed,
        status => status,
    }
}

/// Formats like [`println!`], without its panic when standard output is closed.
#[macro_export]
macro_rules! print_line {
    ($($part:tt)*) => { $crate::report::print_line(::std::format_args!($($part)*)) };
}

/// Lets at most one line a second through.
#[derive(Debug, Default)]
pub struct RateLimit(Option<Instant>);

impl RateLimit {
    /// Whether a line may be written now, which then counts as written.
    pub fn is_due(&mut self) -> bool {
        let due = self.0.is_none_or(|last| last.elapsed() >= Duration::from_secs(1));
        if due {
            self.0 = Some(Instant::now());
        }
        due
    }
}
