//! A Hydra whose device file is a socket that keeps messages apart, as the kernel keeps reports.

use std::collections::BTreeMap;
use std::io;
use std::os::unix::net::UnixDatagram;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use ambf_device::{DeviceError, DeviceForce, InputDevice, Setting, Settings};
use nalgebra::{UnitQuaternion, Vector3};

use super::hidraw::Hid;
use super::report::tests::report;
use super::report::{self, FEATURE};
use super::*;

/// The computer's end of a base.
struct File {
    reports: UnixDatagram,
    features: Arc<Mutex<Vec<[u8; FEATURE]>>>,
    refusals: u32,
    gone: Arc<Mutex<bool>>,
}

impl Hid for File {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        if *self.gone.lock().unwrap() {
            return Err(rustix::io::Errno::NODEV.into());
        }
        self.reports.recv(bytes)
    }

    fn set_feature(&mut self, report: [u8; FEATURE]) -> io::Result<()> {
        if self.refusals > 0 {
            self.refusals -= 1;
            return Err(rustix::io::Errno::PIPE.into());
        }
        self.features.lock().unwrap().push(report);
        Ok(())
    }
}

/// The other end.
struct Base {
    reports: UnixDatagram,
    features: Arc<Mutex<Vec<[u8; FEATURE]>>>,
    gone: Arc<Mutex<bool>>,
}

fn base() -> (Base, File) {
    let (ours, theirs) = UnixDatagram::pair().unwrap();
    theirs.set_nonblocking(true).unwrap();
    let (features, gone) = (Arc::default(), Arc::default());
    let base = Base { reports: ours, features: Arc::clone(&features), gone: Arc::clone(&gone) };
    (base, File { reports: theirs, features, refusals: 0, gone })
}

fn start(file: File, streams: &Streams, controller: usize) -> Hydra<File> {
    let stream = streams.join("usb-1", controller).unwrap();
    Hydra::start(file, stream, controller, "usb-1 controller", 3.0).unwrap()
}

const STRAIGHT: [i16; 4] = [i16::MAX, 0, 0, 0];

#[test]
fn it_starts_streaming_even_if_it_hesitates() {
    let (base, mut file) = base();
    file.refusals = 3;
    let mut hydra = start(file, &Streams::default(), 0);
    assert_eq!(*base.features.lock().unwrap(), [report::streaming(true)]);
    assert!(!hydra.read().unwrap().valid, "nothing was measured yet");
}

#[test]
fn reports_become_samples() {
    let (base, file) = base();
    let mut hydra = start(file, &Streams::default(), 1);
    // Twice the same: the filter starts there.
    for _ in 0..2 {
        base.reports.send(&report(1, [10, -600, -50], STRAIGHT, 0x05, 255)).unwrap();
    }
    let sample = hydra.read().unwrap();
    assert!(sample.valid && sample.is_finite());
    assert_eq!((sample.sequence, sample.buttons, sample.gripper), (2, 5, Some(0.0)));
    // p' = M p = (0.6, −0.01, 0.05), and the grab point by R' = M Rz(90°) = diag(−1, 1, −1).
    let q = Vector3::new(0.6, -0.01, 0.05) + Vector3::new(-0.047, 0.035, 0.0);
    assert!((sample.position - Vector3::new(-q.x - 0.5, -q.y, q.z)).norm() < 1e-9, "{:?}", sample.position);
    let half = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI);
    assert!(sample.rotation.angle_to(&half) < 1e-9, "{:?}", sample.rotation);
    assert_eq!(hydra.read().unwrap().sequence, 2, "the same again");
    assert!(hydra.write(&DeviceForce::zero()).is_ok());
    assert_eq!((hydra.spec().max_force, hydra.spec().start_up_hold), (0.0, 5.0));
}

#[test]
fn rubbish_is_left_out() {
    let (base, file) = base();
    let mut hydra = start(file, &Streams::default(), 0);
    base.reports.send(&[1, 2, 3]).unwrap();
    base.reports.send(&[0; 90]).unwrap();
    base.reports.send(&[0xFF; 200]).unwrap();
    base.reports.send(&report(0, [0, -500, 0], STRAIGHT, 0, 0)).unwrap();
    let sample = hydra.read().unwrap();
    assert!(sample.valid && sample.is_finite() && sample.gripper == Some(1.0));
}

#[test]
fn a_base_that_falls_silent_is_not_trusted_and_then_lost() {
    let (base, file) = base();
    let mut hydra = start(file, &Streams::default(), 0);
    base.reports.send(&report(0, [0, -500, 0], STRAIGHT, 0, 0)).unwrap();
    assert!(hydra.read().unwrap().valid);
    let start = Instant::now();
    let mut doubted = false;
    let error = loop {
        match hydra.read() {
            Ok(sample) => doubted |= !sample.valid,
            Err(error) => break error,
        }
        assert!(start.elapsed() < Duration::from_secs(20));
        std::thread::sleep(Duration::from_millis(5));
    };
    assert!(doubted || start.elapsed() > Duration::from_secs(3));
    assert!(error.to_string().contains("sends nothing"), "{error}");
}

#[test]
fn unplugging_loses_it() {
    let (base, file) = base();
    let mut hydra = start(file, &Streams::default(), 0);
    *base.gone.lock().unwrap() = true;
    assert!(matches!(hydra.read(), Err(DeviceError::Lost(_))));
}

#[test]
fn the_stream_stops_with_the_second_controller() {
    let ((one, left), (two, right)) = (base(), base());
    let streams = Streams::default();
    let mut left = start(left, &streams, 0);
    let right = start(right, &streams, 1);
    left.close();
    assert_eq!(one.features.lock().unwrap().len(), 1);
    drop(right);
    assert_eq!(*two.features.lock().unwrap(), [report::streaming(true), report::streaming(false)]);
    assert!(matches!(left.read(), Err(DeviceError::Lost(_))));
}

fn settings(key: &str, value: &str) -> Settings {
    let setting = Setting { value: value.to_owned(), place: String::from("devices.yaml:9") };
    Settings::new(BTreeMap::from([(key.to_owned(), setting)]), PathBuf::new())
}

#[test]
fn settings_are_checked() {
    let driver = HydraDriver { sys: PathBuf::from("/nowhere"), streams: Streams::default() };
    assert_eq!(driver.find(MODEL, &settings(CORNER, "12.5")), Ok(vec![]));
    for (key, value) in [(CORNER, "0"), (CORNER, "500"), (CORNER, "NaN"), (CORNER, "fast"), ("corner", "3")] {
        let error = driver.find(MODEL, &settings(key, value)).unwrap_err().to_string();
        assert!(error.starts_with("devices.yaml:9: `corner"), "{error}");
    }
    assert!(driver.serves("Razer Hydra") && !driver.serves("Razor Hydra"));
}

#[test]
fn a_base_that_is_not_there_cannot_be_opened() {
    let driver = HydraDriver { sys: PathBuf::from("/nowhere"), streams: Streams::default() };
    let info = DeviceInfo { model: MODEL.to_owned(), identity: identity("usb-1", 0) };
    let error = driver.open(&info, &Settings::default(), &DeviceLog::new().0).err().unwrap();
    assert_eq!(error, DeviceError::Unavailable(String::from("`usb-1 controller 0` is not plugged in")));
}
