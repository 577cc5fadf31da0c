//! Drivers of input devices in shared libraries.

use std::collections::BTreeMap;
use std::panic::{catch_unwind, AssertUnwindSafe};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::plugin_common::library_of;
use ambf_core::adf::{self, Launch, PluginEntry};
use ambf_core::device::{DeviceError, DeviceForce, DeviceInfo, DeviceLog, Setting, Settings};
use ambf_core::plugin::{load_driver, Search};
use nalgebra::Vector3;

fn entry(filename: &Path) -> PluginEntry {
    let text = format!("device plugins: [{{name: knobs, filename: {}}}]\n", filename.display());
    let (launch, _) = adf::parse::<Launch>(&text, Path::new("launch.yaml")).unwrap();
    launch.device_plugins.into_iter().next().unwrap()
}

fn settings(entries: &[(&str, &str)]) -> Settings {
    let setting = |value: &str| Setting { value: value.to_owned(), place: "devices.yaml:3".into() };
    let entries: BTreeMap<_, _> = entries.iter().map(|(key, value)| ((*key).to_owned(), setting(value))).collect();
    Settings::new(entries, PathBuf::from("dir"))
}

#[test]
fn a_driver_of_a_library_is_as_any_other() {
    let driver = load_driver(&Search::default(), &entry(&library_of("faulty_driver"))).unwrap();
    assert_eq!((driver.name(), driver.serves("Knob"), driver.serves("Falcon")), ("knob", true, false));
    let found = driver.find("Knob", &settings(&[("count", "2")])).unwrap();
    let info = |i| DeviceInfo { model: "Knob".into(), identity: format!("port {i}") };
    assert_eq!(found, [info(0), info(1)]);
    let error = driver.find("Knob", &settings(&[("count", "many")])).unwrap_err();
    assert_eq!(error.to_string(), "devices.yaml:3: `count` is `many`, expected a whole number");
    let panic = catch_unwind(AssertUnwindSafe(|| driver.find("Knob", &settings(&[("count", "100")])))).unwrap_err();
    assert_eq!(panic.downcast_ref::<String>().map(String::as_str), Some("too many knobs"));

    let (log, said) = DeviceLog::new();
    let mut device = driver.open(&found[1], &settings(&[]), &log).unwrap();
    assert_eq!((device.spec().model.as_str(), device.spec().max_force), ("Knob", 4.0));
    assert!(device.spec().sensed.position && device.spec().left_hand && !device.spec().right_hand);
    let force = Vector3::new(0.25, -1.0, 3.0);
    device.write(&DeviceForce { force, ..DeviceForce::zero() }).unwrap();
    let sample = device.read().unwrap();
    assert_eq!((sample.position, sample.sequence, sample.valid), (force, 1, true));
    assert!(sample.stamp.elapsed() < Duration::from_secs(60) && sample.linear_velocity.is_none());
    device.close();
    let mut lines = Vec::new();
    let begin = Instant::now();
    while lines.len() < 2 && begin.elapsed() < Duration::from_secs(60) {
        lines.extend(said.recv_timeout(Duration::from_millis(100)));
    }
    assert_eq!(lines, ["port 1 is open", "closed"]);
    drop(device);
    assert_eq!(said.try_iter().count(), 0, "it is closed once");
}

#[test]
fn what_fails_in_a_library_is_told() {
    let driver = load_driver(&Search::default(), &entry(&library_of("faulty_driver"))).unwrap();
    let (log, _said) = DeviceLog::new();
    let info = DeviceInfo { model: "Knob".into(), identity: "port 0".into() };
    let open = |fault: &str| driver.open(&info, &settings(&[("fault", fault)]), &log);
    let error = open("open").err().unwrap();
    assert_eq!(error, DeviceError::Unavailable("no permission".into()));
    let mut lost = open("lost").unwrap();
    assert_eq!(lost.read().unwrap_err(), DeviceError::Lost("unplugged".into()));
    let mut panicking = open("panic").unwrap();
    let panic = catch_unwind(AssertUnwindSafe(|| panicking.read())).unwrap_err();
    assert_eq!(panic.downcast_ref::<String>().map(String::as_str), Some("as told"));
}

#[test]
fn a_library_of_plugins_is_no_driver() {
    let error = load_driver(&Search::default(), &entry(&library_of("faulty_plugin"))).err().unwrap().to_string();
    assert!(error.contains("it has no function `ambf_driver_create`"), "{error}");
    let error = load_driver(&Search::default(), &entry(Path::new("/nowhere/knob.so"))).err().unwrap().to_string();
    assert!(error.contains("no such library: looked for /nowhere/knob.so"), "{error}");
}
