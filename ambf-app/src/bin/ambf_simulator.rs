//! Steps a scene in real time and talks ROS 1 about it.

use std::process::exit;

use ambf_app::cli::{CliError, Parsed, SimulatorOptions};
use ambf_app::{check, doctor, report, ros, simulator};

fn main() {
    if let Some(ended) = ros_node::serve_master(std::env::args_os().skip(1)) {
        exit(i32::from(ended.is_err()));
    }
    let arguments = match ros::RosArguments::take() {
        Ok(arguments) => arguments,
        Err(error @ ros::ArgumentError::Restart(_)) => {
            report!("{error}; they are ignored");
            ros::RosArguments::default()
        }
        Err(error) => {
            report!("{error}");
            exit(CliError::SIMULATOR_STATUS);
        }
    };
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
    if options.doctor {
        exit(doctor::print(&options.launch_file));
    }
    if options.end_master {
        exit(end_master());
    }
    if let Err(error) = simulator::run(&options, arguments) {
        report!("{error}");
        exit(error.status());
    }
}

/// Ends the master that a simulator left behind; the exit status.
fn end_master() -> i32 {
    let uri = ros_node::master_uri();
    match ros_node::end_master(&uri) {
        Ok(true) => ambf_app::print_line!("the master at {uri} has ended"),
        Ok(false) => ambf_app::print_line!("no master answers at {uri}"),
        Err(error) => {
            report!("{error}");
            return 1;
        }
    }
    0
}
