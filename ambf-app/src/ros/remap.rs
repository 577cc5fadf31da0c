//! Command line remappings, which the simulator does not honour and rosrust cannot be told to ignore.

use std::convert::Infallible;
use std::ffi::OsString;
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::process::CommandExt;
use std::process::Command;

use crate::report;

/// Starts the program again without arguments of the form `a:=b`, if there are any: rosrust reads them from the process's own
/// arguments, wherever it is used. To be called first in `main`; returns only when there is nothing to do.
///
/// # Errors
/// When the program cannot be started again; it then goes on with the arguments it has.
pub fn without_remappings() -> io::Result<()> {
    let arguments: Vec<OsString> = std::env::args_os().collect();
    let (kept, dropped) = split(&arguments);
    if dropped.is_empty() {
        return Ok(());
    }
    for argument in dropped {
        report!("\"{}\" is ignored: remappings on the command line are not honoured", argument.to_string_lossy());
    }
    let mut command = Command::new(std::env::current_exe()?);
    if let Some(name) = arguments.first() {
        command.arg0(name);
    }
    let failed: Result<Infallible, io::Error> = Err(command.args(kept).exec());
    failed.map(|never| match never {})
}

/// The arguments after the first, with and without `:=`.
fn split(arguments: &[OsString]) -> (Vec<&OsString>, Vec<&OsString>) {
    arguments.iter().skip(1).partition(|argument| !argument.as_bytes().windows(2).any(|pair| pair == b":="))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_remappings_are_dropped() {
        let arguments = ["program:=x", "-l", "1", "__name:=foo", "--ns=/a", "a:=b"].map(OsString::from);
        let (kept, dropped) = split(&arguments);
        assert_eq!(kept, ["-l", "1", "--ns=/a"]);
        assert_eq!(dropped, ["__name:=foo", "a:=b"]);
    }
}
