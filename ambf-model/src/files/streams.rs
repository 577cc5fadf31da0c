//! Standard output.

use std::io::{self, Write};
use std::os::fd::AsFd;

use super::WriteError;

fn failed(source: io::Error) -> WriteError {
    WriteError { place: "standard output".into(), source }
}

/// Writes to standard output at once, without a panic.
///
/// # Errors
/// [`WriteError`], for which [`is_unread`](WriteError::is_unread) tells whether only nobody reads any more.
pub fn print(text: &str) -> Result<(), WriteError> {
    let mut out = io::stdout().lock();
    // In one call as far as possible, so that lines of different threads do not mix.
    out.write_all(text.as_bytes()).and_then(|()| out.flush()).map_err(failed)
}

/// Makes sure that what was printed has arrived, as far as that can be asked: some file systems tell when a file is closed.
///
/// # Errors
/// As [`print()`].
pub fn close_output() -> Result<(), WriteError> {
    io::stdout().flush().map_err(failed)?;
    // A copy of the descriptor, since the original is the library's.
    let copy = io::stdout().as_fd().try_clone_to_owned().map_err(failed)?;
    nix::unistd::close(copy).map_err(|error| failed(error.into()))
}
