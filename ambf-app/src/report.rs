//! The programs' only log: one line a fact on standard error.

use std::fmt::Arguments;
use std::io::Write;

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
