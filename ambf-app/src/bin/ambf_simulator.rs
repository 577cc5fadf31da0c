//! Steps a scene in real time and talks ROS 1 about it.

use std::process::exit;

use ambf_app::cli::{CliError, Parsed, SimulatorOptions};
use ambf_app::report::exit_status;
use ambf_app::{check, doctor, print_line, report, ros, simulator};

fn main() {
    exit(exit_status(run(), CliError::SIMULATOR_UNWRITTEN));
}

/// The exit status, if all that is said arrives.
fn run() -> i32 {
    if let Some(ended) = ros_node::serve_master(std::env::args_os().skip(1)) {
        return i32::from(ended.is_err());
    }
    let arguments = match ros::RosArguments::take() {
        Ok(arguments) => arguments,
        Err(error @ ros::ArgumentError::Restart(_)) => {
            report!("{error}; they are ignored");
            ros::RosArguments::default()
        }
        Err(error) => {
            report!("{error}");
            return CliError::SIMULATOR_STATUS;
        }
    };
    let options = match SimulatorOptions::parse(std::env::args_os()) {
        Ok(Parsed::Run { options, notes }) => {
            notes.iter().for_each(|note| report!("{note}"));
            options
        }
        Ok(Parsed::Print(text)) => {
            print_line!("{}", text.trim_end());
            return 0;
        }
        Err(error) => {
            report!("{error}");
            return CliError::SIMULATOR_STATUS;
        }
    };
    if let Some(check) = &options.check {
        return check::print(check);
    }
    if options.doctor {
        return doctor::print(&options.launch_file);
    }
    if options.end_master {
        return end_master();
    }
    match simulator::run(&options, arguments) {
        Ok(()) => 0,
        Err(error) => {
            report!("{error}");
            error.status()
        }
    }
}

/// Ends the master that a simulator left behind; the exit status.
fn end_master() -> i32 {
    let uri = ros_node::master_uri();
    match ros_node::end_master(&uri) {
        Ok(true) => print_line!("the master at {uri} has ended"),
        Ok(false) => print_line!("no master answers at {uri}"),
        Err(error) => {
            report!("{error}");
            return 1;
        }
    }
    0
}
