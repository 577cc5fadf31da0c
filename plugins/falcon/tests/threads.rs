//! The driver as a host uses it, with its threads, against fakes on the computer's clock. Times are generous: the
//! computer may be busy.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_device::{DeviceError, DeviceForce, DeviceLog, DeviceSample, Driver, InputDevice, Setting, Settings};
use fake_falcon::{Aim, Clock, FakeBus, FakeFalcon, Fault, Hand, Setup};
use falcon::{FalconDriver, State, MODEL};
use nalgebra::Vector3;

const PATIENCE: Duration = Duration::from_secs(60);

fn settings(entries: &[(&str, &str)]) -> Settings {
    let entry = |(n, (key, value)): (usize, &(&str, &str))| {
        (key.to_string(), Setting { value: value.to_string(), place: format!("devices.yaml:{}", n + 1) })
    };
    Settings::new(entries.iter().enumerate().map(entry).collect::<BTreeMap<_, _>>(), "no/such".into())
}

/// A driver with two fakes: both home in two seconds at most, also on a busy machine, then rest 1 cm to the right and 1 cm to the left.
fn bench() -> (FalconDriver, Vec<FakeFalcon>) {
    let setup = |identity: &str, right: f64| {
        let script = move |time: f64| {
            let out = if time < 2.0 { 0.03 * (4.0 * std::f64::consts::PI * time).sin() } else { 0.0 };
            Aim { position: Vector3::new(out, right, 0.0), grip: 0x4 }
        };
        Setup { hand: Hand::firm(Arc::new(script)), ..Setup::new(identity) }
    };
    let bus = FakeBus::new(Clock::real(), [setup("fake-1", 0.01), setup("fake-2", -0.01)]);
    let falcons = bus.falcons().to_vec();
    (falcon::driver().with_bus("fake", Arc::new(bus)), falcons)
}

type Sentences = Box<dyn Fn() -> Vec<String>>;

fn open(driver: &FalconDriver, number: usize) -> (Box<dyn InputDevice>, Sentences) {
    let settings = settings(&[("transport", "fake")]);
    let info = &driver.find(MODEL, &settings).unwrap()[number];
    let (log, sentences) = DeviceLog::new();
    (driver.open(info, &settings, &log).unwrap(), Box::new(move || sentences.try_iter().collect()))
}

/// Ticks like a host that asks for 1 N along x until `done`.
fn tick(device: &mut dyn InputDevice, mut done: impl FnMut(&DeviceSample) -> bool) -> DeviceSample {
    let begin = Instant::now();
    loop {
        let sample = device.read().unwrap();
        if done(&sample) {
            return sample;
        }
        assert!(begin.elapsed() < PATIENCE, "{sample:?}");
        device.write(&DeviceForce { force: Vector3::x(), ..DeviceForce::zero() }).unwrap();
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// How many commands at the end are those of letting go: no force, and a dark ring.
fn goodbyes(falcon: &FakeFalcon) -> u64 {
    let commands = falcon.commands();
    commands.iter().rev().take_while(|command| command.motors == [0; 3] && command.control == 1).count() as u64
}

#[test]
fn two_devices_are_used_at_once_and_closed_at_rest() {
    let (driver, fakes) = bench();
    let (mut right, _) = open(&driver, 0);
    let (mut left, _) = open(&driver, 1);
    assert!(fakes.iter().all(FakeFalcon::is_open));
    let sample = tick(&mut *right, |sample| sample.valid);
    assert!((sample.position - Vector3::new(0.0, 0.01, 0.0)).norm() < 0.04, "{}", sample.position);
    tick(&mut *right, |_| fakes[0].motors() != [0; 3]);
    let sample = tick(&mut *left, |sample| sample.valid && (sample.position.y + 0.01).abs() < 1e-4);
    assert_eq!(sample.buttons, 1);
    let spec = right.spec();
    assert_eq!((spec.model.as_str(), spec.max_force, spec.max_stiffness), (MODEL, 8.0, 3000.0));

    // Each exchanges on its own: the host does nothing meanwhile.
    let before = fakes.iter().map(FakeFalcon::count).collect::<Vec<_>>();
    let begin = Instant::now();
    while fakes.iter().zip(&before).any(|(fake, before)| fake.count() < before + 500) {
        assert!(begin.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(10));
    }

    tick(&mut *right, |_| fakes[0].motors() != [0; 3]);
    right.close();
    assert!(goodbyes(&fakes[0]) == 3 && !fakes[0].is_open());
    assert!(matches!(right.read(), Err(DeviceError::Lost(text)) if text == "Falcon fake-1: it was closed"));
    tick(&mut *left, |_| fakes[1].motors() != [0; 3]);
    drop(left);
    assert!(goodbyes(&fakes[1]) == 3 && !fakes[1].is_open());
}

#[test]
fn a_host_that_stops_asking_leaves_no_force() {
    let (driver, fakes) = bench();
    let (mut device, _) = open(&driver, 0);
    tick(&mut *device, |_| fakes[0].motors() != [0; 3]);
    let begin = Instant::now();
    while fakes[0].motors() != [0; 3] {
        assert!(begin.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn a_panic_ends_in_rest_and_the_device_can_be_opened_again() {
    for count in [1, 2] {
        let (driver, fakes) = bench();
        let (mut device, _) = open(&driver, 0);
        tick(&mut *device, |_| fakes[0].motors() != [0; 3]);
        let (mut other, _) = open(&driver, 1);
        // The second hits the zeros that follow the first.
        fakes[0].inject(Fault::Panic, count);
        let begin = Instant::now();
        let error = loop {
            if let Err(error) = device.read() {
                break error;
            }
            assert!(begin.elapsed() < PATIENCE);
            std::thread::sleep(Duration::from_millis(1));
        };
        let expected = "Falcon fake-1: its driver panicked: a fault that was asked for";
        assert_eq!(error, DeviceError::Lost(expected.into()));
        assert!(device.write(&DeviceForce::zero()).is_err());
        assert_eq!(goodbyes(&fakes[0]), 4 - count);
        assert!(!fakes[0].is_open());
        tick(&mut *other, |sample| sample.valid);
        drop(device);
        let (mut device, _) = open(&driver, 0);
        tick(&mut *device, |sample| sample.valid);
    }
}

#[test]
fn an_unplugged_device_comes_back_by_itself() {
    let (driver, fakes) = bench();
    let (mut device, sentences) = open(&driver, 0);
    tick(&mut *device, |sample| sample.valid);
    fakes[0].unplug();
    tick(&mut *device, |sample| !sample.valid);
    fakes[0].plug();
    tick(&mut *device, |sample| sample.valid);
    let sentences = sentences();
    let lost = sentences.iter().filter(|sentence| sentence.contains("is lost: it is not plugged in")).count();
    assert_eq!(lost, 1, "{sentences:?}");
}

#[test]
fn a_device_that_is_away_is_closed_at_once() {
    let (driver, fakes) = bench();
    let (mut device, _) = open(&driver, 0);
    fakes[0].unplug();
    tick(&mut *device, |sample| !sample.valid);
    let begin = Instant::now();
    device.close();
    // It looks for the device every second, but does not sleep over the end.
    assert!(begin.elapsed() < PATIENCE / 2);
}

#[test]
fn devices_are_found_without_being_opened() {
    let (driver, fakes) = bench();
    let all = settings(&[("transport", "fake")]);
    let identities = |settings: &Settings| -> Vec<String> {
        driver.find(MODEL, settings).unwrap().into_iter().map(|info| info.identity).collect()
    };
    assert_eq!(identities(&all), ["fake-1", "fake-2"]);
    assert_eq!(identities(&settings(&[("transport", "fake"), ("port", "fake-2")])), ["fake-2"]);
    assert_eq!(identities(&settings(&[("transport", "fake"), ("port", "1-7")])), [""; 0]);
    assert_eq!(driver.find("PHANTOM Omni", &all).unwrap(), []);
    assert!(driver.serves("Falcon") && !driver.serves("falcon") && driver.name() == "falcon");
    assert!(fakes.iter().all(|fake| !fake.is_open() && fake.requests().is_empty()));
    fakes[0].unplug();
    assert_eq!(identities(&all), ["fake-2"]);
}

#[test]
fn a_device_has_one_user() {
    let (driver, fakes) = bench();
    let (_device, _) = open(&driver, 0);
    let all = settings(&[("transport", "fake")]);
    let info = &driver.find(MODEL, &all).unwrap()[0];
    let (log, _sentences) = DeviceLog::new();
    let again = driver.open(info, &all, &log).err().unwrap();
    assert_eq!(again, DeviceError::Unavailable("Falcon fake-1: another program uses it".into()));
    fakes[1].unplug();
    let gone = driver.open(&ambf_device::DeviceInfo { identity: "fake-2".into(), ..info.clone() }, &all, &log);
    assert_eq!(gone.err().unwrap(), DeviceError::Lost("Falcon fake-2: it is not plugged in".into()));
}

#[test]
fn settings_that_are_wrong_are_named() {
    let (driver, _fakes) = bench();
    let (log, _sentences) = DeviceLog::new();
    let found = driver.find(MODEL, &settings(&[("transport", "fake")])).unwrap();
    let error = |entries: &[(&str, &str)]| {
        let entries = [&[("transport", "fake")], entries].concat();
        driver.open(&found[0], &settings(&entries), &log).err().unwrap().to_string()
    };
    assert_eq!(
        error(&[("frimware", "x")]),
        "devices.yaml:2: `frimware` is `x`, expected one of the keys event character, firmware, port, transport, z0"
    );
    assert!(error(&[("z0", "far")]).starts_with("devices.yaml:2: `z0` is `far`, expected a distance in m"));
    assert!(error(&[("z0", "NaN")]).contains("`z0` is `NaN`"));
    assert!(error(&[("z0", "125")]).contains("between 0.05 and 0.2"));
    assert!(error(&[("event character", "perhaps")]).contains("expected true or false"));
    assert!(error(&[("firmware", "nvent.bin")]).starts_with("firmware no/such/nvent.bin: "));
    let wrong = driver.find(MODEL, &settings(&[("transport", "serial")])).unwrap_err().to_string();
    assert_eq!(wrong, "devices.yaml:1: `transport` is `serial`, expected usb or fake");
    assert!(driver.find(MODEL, &settings(&[("speed", "1")])).is_err());
}

#[test]
fn z0_moves_the_origin() {
    let (driver, _fakes) = bench();
    let settings = settings(&[("transport", "fake"), ("z0", "0.115"), ("port", "fake-1")]);
    let info = &driver.find(MODEL, &settings).unwrap()[0];
    let (log, _sentences) = DeviceLog::new();
    let mut device = driver.open_falcon(info, &settings, &log).unwrap();
    tick(&mut device, |sample| sample.valid && (sample.position - Vector3::new(0.01, 0.01, 0.0)).norm() < 1e-4);
    let status = device.status();
    assert_eq!((status.state, status.homed), (State::Ready, [true; 3]));
    assert!(status.exchanges > 100);
}
