//! Drivers of input devices in shared libraries, as their authors see them. This part runs in the library.

use std::ffi::c_void;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use crossbeam_channel::Receiver;
use parking_lot::Mutex;

use super::abi::{slice, RawText};
use super::driver_abi::{
    RawAnswer, RawDevice, RawDriver, RawForce, RawLog, RawSample, RawSettings, RawSpec, LOST, UNAVAILABLE,
};
use super::export::{free, guarded};
use ambf_device::{caught, DeviceError, DeviceInfo, DeviceLog, Driver, InputDevice, Setting, Settings};

/// Makes a shared library of a driver of input devices: the crate's type is `cdylib`, and this stands in it once, with
/// a type that implements [`Driver`](ambf_device::Driver) and [`Default`]. A launch file names it under `device
/// plugins`.
#[macro_export]
macro_rules! export_driver {
    ($driver:ty) => {
        $crate::__export_version! {}

        /// Makes the driver.
        #[unsafe(no_mangle)]
        pub extern "C" fn ambf_driver_create() -> *mut $crate::driver_abi::RawDriver {
            $crate::export_driver(|| Box::new(<$driver as Default>::default()))
        }
    };
}

struct Instance {
    driver: Box<dyn Driver>,
    name: String,
}

/// The part of [`export_driver!`](crate::export_driver) that is the same in all libraries. The driver is never freed.
#[doc(hidden)]
pub fn export_driver(make: impl FnOnce() -> Box<dyn Driver>) -> *mut RawDriver {
    let made = caught(|| {
        let driver = make();
        let name = driver.name().to_owned();
        Instance { driver, name }
    });
    let Ok(instance) = made else { return std::ptr::null_mut() };
    let instance = Box::leak(Box::new(instance));
    let name = RawText::of(&instance.name);
    let instance = std::ptr::from_mut(instance).cast();
    Box::into_raw(Box::new(RawDriver { instance, name, serves, find, open }))
}

/// Runs `work`; its error or panic is reported to the host.
///
/// # Safety
/// `answer` is that of the call that runs.
unsafe fn answering(answer: *const RawAnswer, work: impl FnOnce() -> Result<(), DeviceError>) -> i32 {
    guarded(work, |error, why| {
        let kind = if matches!(error, Some(DeviceError::Lost(_))) { LOST } else { UNAVAILABLE };
        // SAFETY: the caller vouches for it; the text lives until the call returns.
        unsafe { ((*answer).fail)((*answer).context, kind, RawText::of(why)) }
    })
}

/// # Safety
/// The settings and their texts are valid.
unsafe fn settings_of(raw: *const RawSettings) -> Settings {
    // SAFETY: the caller vouches for all of it.
    unsafe {
        let entries = slice((*raw).entries, (*raw).count).unwrap_or_default().iter().map(|entry| {
            let setting = Setting { value: entry.value.read(), place: entry.place.read() };
            (entry.key.read(), setting)
        });
        Settings::new(entries.collect(), PathBuf::from((*raw).directory.read()))
    }
}

/// # Safety
/// `instance` comes from [`export_driver`].
unsafe fn driver<'a>(instance: *mut c_void) -> &'a dyn Driver {
    // SAFETY: the caller vouches for it; a driver is never freed, and shared by all threads.
    unsafe { (*instance.cast::<Instance>()).driver.as_ref() }
}

unsafe extern "C" fn serves(instance: *mut c_void, model: RawText) -> i32 {
    // SAFETY: the host gives our instance and a text of its own.
    let (driver, model) = unsafe { (driver(instance), model.read()) };
    caught(|| i32::from(driver.serves(&model))).unwrap_or(0)
}

unsafe extern "C" fn find(
    instance: *mut c_void,
    answer: *const RawAnswer,
    model: RawText,
    settings: *const RawSettings,
) -> i32 {
    // SAFETY: the host gives our instance, and pointers that live until this returns.
    unsafe {
        let (driver, model, settings) = (driver(instance), model.read(), settings_of(settings));
        answering(answer, || {
            for info in driver.find(&model, &settings)? {
                let (model, identity) = (RawText::of(&info.model), RawText::of(&info.identity));
                ((*answer).found)((*answer).context, model, identity);
            }
            Ok(())
        })
    }
}

struct OpenDevice {
    device: Box<dyn InputDevice>,
    /// The table's texts are in it.
    _spec: Box<ambf_device::DeviceSpec>,
    log: Arc<Mutex<Option<HostLog>>>,
}

/// The host's log; taken away before the device is freed, because the driver may keep its own end for longer.
struct HostLog(RawLog);
// SAFETY: the host's log may be used from any thread as long as the device is open.
unsafe impl Send for HostLog {}

impl HostLog {
    fn say(&self, text: &str) {
        // SAFETY: the log lives as long as the device; the text until the call returns.
        unsafe { (self.0.say)(self.0.context, RawText::of(text)) }
    }
}

/// Passes on what a driver says, until it has dropped its last end of the log.
fn pass_on(sentences: Receiver<String>, log: Arc<Mutex<Option<HostLog>>>) {
    for sentence in sentences {
        if let Some(log) = &*log.lock() {
            log.say(&sentence);
        }
    }
}

unsafe extern "C" fn open(
    instance: *mut c_void,
    answer: *const RawAnswer,
    model: RawText,
    identity: RawText,
    settings: *const RawSettings,
    log: *const RawLog,
) -> *mut RawDevice {
    let mut opened = None;
    // SAFETY: the host gives our instance, a log that lives as long as the device, and pointers that live until this
    // returns.
    unsafe {
        let driver = driver(instance);
        let info = DeviceInfo { model: model.read(), identity: identity.read() };
        let (settings, host_log) = (settings_of(settings), Arc::new(Mutex::new(Some(HostLog(*log)))));
        answering(answer, || {
            let (log, sentences) = DeviceLog::new();
            let passed = Arc::clone(&host_log);
            std::thread::Builder::new()
                .name("device log".into())
                .spawn(move || pass_on(sentences, passed))
                .map_err(|error| DeviceError::Unavailable(error.to_string()))?;
            opened = Some((driver.open(&info, &settings, &log)?, host_log));
            Ok(())
        });
    }
    let Some((device, log)) = opened else { return std::ptr::null_mut() };
    let spec = Box::new(device.spec().clone());
    let raw_spec = RawSpec::of(&spec);
    let open = Box::new(OpenDevice { device, _spec: spec, log });
    let instance = Box::into_raw(open).cast();
    Box::into_raw(Box::new(RawDevice { instance, spec: raw_spec, read, write, close, destroy }))
}

/// # Safety
/// `instance` comes from [`open`], is alive, and is used by nobody else now.
unsafe fn device<'a>(instance: *mut c_void) -> &'a mut dyn InputDevice {
    // SAFETY: the caller vouches for it.
    unsafe { (*instance.cast::<OpenDevice>()).device.as_mut() }
}

unsafe extern "C" fn read(instance: *mut c_void, answer: *const RawAnswer, out: *mut RawSample) -> i32 {
    // SAFETY: the host calls an open device from one thread at a time, with pointers that live until this returns.
    unsafe {
        answering(answer, || {
            let sample = device(instance).read()?;
            out.write(RawSample::of(&sample, Instant::now()));
            Ok(())
        })
    }
}

unsafe extern "C" fn write(instance: *mut c_void, answer: *const RawAnswer, force: *const RawForce) -> i32 {
    // SAFETY: as in `read`.
    unsafe { answering(answer, || device(instance).write(&(&*force).into())) }
}

unsafe extern "C" fn close(instance: *mut c_void, answer: *const RawAnswer) -> i32 {
    // SAFETY: as in `read`.
    unsafe {
        answering(answer, || {
            device(instance).close();
            Ok(())
        })
    }
}

unsafe extern "C" fn destroy(raw: *mut RawDevice) {
    // SAFETY: both boxes come from `open`; the host calls this once, last.
    let open = unsafe { Box::from_raw(Box::from_raw(raw).instance.cast::<OpenDevice>()) };
    let OpenDevice { device, log, .. } = *open;
    let say = |sentence: &str| log.lock().iter().for_each(|log| log.say(sentence));
    free(device, say);
    // The driver may keep its end of the log; the host's is freed now.
    *log.lock() = None;
}
