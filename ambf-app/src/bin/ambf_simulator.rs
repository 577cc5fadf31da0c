//! Steps a scene in real time and talks ROS 1 about it.

use std::process::exit;

use ambf_app::cli::{CliError, Parsed, SimulatorOptions};
use ambf_app::{check, report, ros, simulator};

fn main() {
    if let Err(error) = ros::without_remappings() {
        report!("{error}");
    }
    let options = match SimulatorOptions::parse(std::env::args_os()) {
        Ok(Parsed::Run { options, notes }) => {
            notes.iter().for_each(|note| report!("{note}"));
            options
        }
        Ok(Parsed::Print(text)) => return ambf_app::print_line!("{}", text.trim_end()),
        Err(error) => {
            ambf_app::report!("{error}");
            exit(CliError::SIMULATOR_STATUS);
        }
    };
    if let Some(check) = &options.check {
        exit(check::print(check));
    }
    if let Err(error) = simulator::run(&options) {
        report!("{error}");
        exit(error.status());
    }
}
