//! Prints where the fake HD library is.

use std::io::Write;
use std::process::ExitCode;

fn main() -> ExitCode {
    match writeln!(std::io::stdout(), "{}", fake_hd::LIBRARY) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("standard output cannot be written: {error}");
            ExitCode::FAILURE
        }
    }
}
