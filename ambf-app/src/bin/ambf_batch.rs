//! Steps a scene as fast as it can and writes traces.

use std::process::exit;

use ambf_app::batch;
use ambf_app::cli::{BatchOptions, CliError, Parsed};

fn main() {
    let options = match BatchOptions::parse(std::env::args_os()) {
        Ok(Parsed::Run { options, .. }) => options,
        Ok(Parsed::Print(text)) => return print!("{text}"),
        Err(error) => {
            eprintln!("{error}");
            exit(CliError::BATCH_STATUS);
        }
    };
    let warn = |report: &str| {
        if !report.is_empty() {
            eprintln!("{report}");
        }
    };
    match batch::run(&options, warn) {
        Ok(summary) if options.json => println!("{}", summary.to_json()),
        Ok(_) => (),
        Err(error) => {
            eprintln!("{error}");
            exit(error.status());
        }
    }
}
