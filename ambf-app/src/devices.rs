//! Which drivers of input devices the programs have, and which devices they are asked for.

use std::sync::Arc;

use ambf_core::adf::{self, InputDevice, InputDevices, Launch};
use ambf_core::device::host::{DeviceHost, DeviceState, HostOptions};
use ambf_core::device::law::Switches;
use ambf_core::device::{Drivers, MockDriver};
use ambf_core::sim::Simulation;
use ambf_core::text::has_entries;

use crate::cli::{DeviceSelection, SimulatorOptions};
use crate::plugins;

/// All drivers of this program. Where two serve a model, the first does unless the device file names another.
pub fn drivers() -> Drivers {
    let mut drivers = Drivers::default();
    drivers.add(Arc::new(dvrk_arm::driver()));
    drivers.add(Arc::new(fake_falcon::driver()));
    drivers.add(touch::driver());
    trackers::drivers().into_iter().for_each(|driver| drivers.add(driver));
    drivers.add(Arc::new(MockDriver::default()));
    drivers
}

/// Whether any device is asked for.
pub fn are_wanted(selection: &DeviceSelection) -> bool {
    match selection {
        DeviceSelection::First(count) => *count > 0,
        DeviceSelection::Indexes(indexes) => !indexes.is_empty(),
    }
}

/// Opens the devices that the command line asks for, out of the device file of a launch file, and gives each its
/// end-effector. Nothing that goes wrong keeps the others from going on; it is in the sentences.
pub fn open(launch: &Launch, options: &SimulatorOptions, simulation: &mut Simulation) -> (DeviceHost, Vec<String>) {
    let mut said = Vec::new();
    let file = launch.input_devices_config.as_deref();
    let listed = match file.filter(|_| are_wanted(&options.devices)).map(adf::load::<InputDevices>) {
        Some(Ok((devices, report))) => {
            said.extend(report.to_string().lines().map(str::to_owned));
            devices.entries
        }
        Some(Err(error)) => {
            said.push(format!("input devices {error}; the simulation runs without"));
            Vec::new()
        }
        None => Vec::new(),
    };
    let entries = selected(&listed, &options.devices, &mut said);
    let host_options = HostOptions {
        frequency: f64::from(options.haptic_frequency),
        fixed_step: options.fixed_haptic_step,
        speed_factor: options.speed_factor,
        switches: Switches { forces: options.force_feedback, ..Switches::default() },
    };
    let mut drivers = drivers();
    if !entries.is_empty() {
        said.extend(plugins::add_drivers(&mut drivers, &launch.device_plugins));
    }
    let (mut host, problems) = DeviceHost::open(&entries, &drivers, &host_options);
    said.extend(problems);
    said.extend(simulation.add_devices(&mut host));
    for status in host.status().iter().filter(|status| status.state != DeviceState::Closed) {
        said.push(format!("device {} [{} {}]", status.name, status.model, status.identity));
    }
    (host, said)
}

/// No devices at all.
pub fn none() -> DeviceHost {
    DeviceHost::open(&[], &Drivers::default(), &HostOptions::default()).0
}

/// The entries that are asked for; what is not there is said.
fn selected<'e>(
    listed: &'e [Option<InputDevice>],
    selection: &DeviceSelection,
    said: &mut Vec<String>,
) -> Vec<&'e InputDevice> {
    let indexes: Vec<usize> = match selection {
        DeviceSelection::First(count) => {
            if *count > listed.len() {
                said.push(format!("-n {count}: the list of input devices has {}", listed.len()));
            }
            (0..*count.min(&listed.len())).collect()
        }
        DeviceSelection::Indexes(indexes) => indexes.clone(),
    };
    let mut entries = Vec::new();
    for index in indexes {
        match listed.get(index) {
            Some(Some(entry)) => entries.push(entry),
            Some(None) => said.push(format!("input device {index} is left out: its entry is of no use")),
            None => {
                let list = has_entries(listed.len());
                said.push(format!("there is no input device {index}: the list {list}; it is skipped"));
            }
        }
    }
    entries
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listed() -> Vec<Option<InputDevice>> {
        let text = "input devices: [A, B, C]\nA: {hardware name: x, root link: l}\nB: {root link: l}\n\
                    C: {hardware name: y, root link: l}\n";
        adf::parse::<InputDevices>(text, std::path::Path::new("devices.yaml")).expect("a list").0.entries
    }

    fn names(selection: &DeviceSelection) -> (Vec<String>, usize) {
        let (listed, mut said) = (listed(), Vec::new());
        let entries = selected(&listed, selection, &mut said);
        (entries.iter().map(|entry| entry.identifier.clone()).collect(), said.len())
    }

    #[test]
    fn the_first_ones_are_taken() {
        assert_eq!(names(&DeviceSelection::First(0)), (vec![], 0));
        assert_eq!(names(&DeviceSelection::First(1)), (vec!["A".into()], 0));
        assert_eq!(names(&DeviceSelection::First(9)), (vec!["A".into(), "C".into()], 2));
    }

    #[test]
    fn wrong_indexes_are_said_and_the_others_go_on() {
        let (found, said) = names(&DeviceSelection::Indexes(vec![2, 7, 1, 0]));
        assert_eq!((found, said), (vec!["C".into(), "A".into()], 2));
    }
}
