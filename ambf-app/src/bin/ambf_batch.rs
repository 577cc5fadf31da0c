//! Steps a scene as fast as it can and writes traces.

use std::process::exit;

use ambf_app::batch;
use ambf_app::cli::{BatchOptions, CliError, Parsed};
use ambf_app::report::{exit_status, print_document};
use ambf_app::{check, print_line, report};

fn main() {
    exit(exit_status(run(), CliError::BATCH_UNWRITTEN));
}

/// The exit status, if all that is said arrives.
fn run() -> i32 {
    let options = match BatchOptions::parse(std::env::args_os()) {
        Ok(Parsed::Run { options, .. }) => options,
        Ok(Parsed::Print(text)) => {
            print_line!("{}", text.trim_end());
            return 0;
        }
        Err(error) => {
            report!("{error}");
            return CliError::BATCH_STATUS;
        }
    };
    if let Some(files) = &options.check {
        return check::print(files);
    }
    let warn = |problems: &str| {
        if !problems.is_empty() {
            report!("{problems}");
        }
    };
    match batch::run(&options, warn) {
        Ok(summary) => {
            if options.json {
                print_document(&summary.to_json());
            }
            summary.status()
        }
        Err(error) => {
            report!("{error}");
            error.status()
        }
    }
}
