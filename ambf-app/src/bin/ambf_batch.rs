//! Steps a scene as fast as it can and writes traces.

use std::process::exit;

use ambf_app::batch;
use ambf_app::cli::{BatchOptions, CliError, Parsed};

fn main() {
    let options = match BatchOptions::parse(std::env::args_os()) {
        Ok(Parsed::Run { options, .. }) => options,
        Ok(Parsed::Print(text)) => return ambf_app::print_line!("{}", text.trim_end()),
        Err(error) => {
            ambf_app::report!("{error}");
            exit(CliError::BATCH_STATUS);
        }
    };
    if let Some(check) = &options.check {
        exit(ambf_app::check::print(check));
    }
    let warn = |report: &str| {
        if !report.is_empty() {
            ambf_app::report!("{report}");
        }
    };
    match batch::run(&options, warn) {
        Ok(summary) => {
            if options.json {
                ambf_app::print_line!("{}", summary.to_json());
            }
            exit(summary.status());
        }
        Err(error) => {
            ambf_app::report!("{error}");
            exit(error.status());
        }
    }
}
