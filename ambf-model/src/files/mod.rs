//! Files that programs read and write, the same for all of them.
//!
//! * [`read`] takes regular files only: a named pipe or a device is refused by its kind before it can block.
//! * [`Output`] and [`Unfinished`] are files that are there when they are complete, and not before: what fails half way
//!   leaves the file of before, or none.
//! * [`print`](print()) writes to standard output and says whether it arrived.

mod output;
mod reading;
mod streams;

pub use output::{folder_for, Output, Unfinished, WriteError};
pub use reading::{look, open, read, read_text, Found};
pub use streams::{close_output, print};
