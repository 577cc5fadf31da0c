//! The programs' only log: one line a fact on standard error.

use std::fmt::Arguments;
use std::io::Write;
use std::time::{Duration, Instant};

/// Writes one line to standard error. A closed standard error is not worth a panic: the line is then lost.
pub fn report(line: Arguments<'_>) {
    // One call, so that lines of different threads do not mix.
    let _ = std::io::stderr().write_all(format!("{line}\n").as_bytes());
}

/// Formats like [`println!`] and writes one line to standard error.
#[macro_export]
macro_rules! report {
    ($($part:tt)*) => { $crate::report::report(::std::format_args!($($part)*)) };
}

/// Writes one line to standard output; it is lost when nobody reads.
pub fn print_line(line: Arguments<'_>) {
    let _ = std::io::stdout().write_all(format!("{line}\n").as_bytes());
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
