//! Drivers of input devices in shared libraries, as the host sees them.

use std::cell::RefCell;
use std::ffi::c_void;
use std::panic::resume_unwind;
use std::ptr::NonNull;
use std::sync::Arc;
use std::time::Instant;

use super::abi::{RawText, DONE, PANICKED};
use super::driver_abi::{
    CreateDriverFn, RawAnswer, RawDevice, RawDriver, RawForce, RawLog, RawSample, RawSetting, RawSettings, LOST,
};
use super::host::resolve;
use super::{library, PluginError, Search};
use ambf_device::{
    DeviceError, DeviceForce, DeviceInfo, DeviceLog, DeviceSample, DeviceSpec, Driver, InputDevice, Settings,
};
use ambf_model::adf::PluginEntry;

const CREATE: &str = "ambf_driver_create";

/// Loads a driver of input devices from a shared library: an entry of `device plugins` in a launch file. Nothing is
/// opened yet.
///
/// # Errors
/// [`PluginError`], as for plugins; [`PluginError::NoDriver`].
pub fn load_driver(search: &Search, entry: &PluginEntry) -> Result<Arc<dyn Driver>, PluginError> {
    let file = resolve(search, entry)?;
    let library = library::open(&file)?;
    // SAFETY: the type is that of the interface, whose version is ours.
    let create = unsafe { library::symbol::<CreateDriverFn>(library, &file, CREATE)? };
    // SAFETY: what is returned is null or a table of the interface that is never freed.
    let raw = unsafe { create().as_ref() };
    let raw = *raw.ok_or(PluginError::NoDriver { file, said: String::new() })?;
    // SAFETY: the name lives as long as the driver.
    let name = unsafe { raw.name.read() };
    Ok(Arc::new(ForeignDriver { raw, name }))
}

struct ForeignDriver {
    raw: RawDriver,
    name: String,
}

// SAFETY: the interface demands of a driver that it can be called from any thread, from several at a time.
unsafe impl Send for ForeignDriver {}
// SAFETY: as above.
unsafe impl Sync for ForeignDriver {}

/// What a library says during one call.
#[derive(Default)]
struct Said {
    failure: RefCell<(u32, String)>,
    found: RefCell<Vec<DeviceInfo>>,
}

impl Said {
    fn answer(&self) -> RawAnswer {
        RawAnswer { context: std::ptr::from_ref(self).cast(), fail, found }
    }

    fn error(&self) -> DeviceError {
        let (kind, text) = self.failure.take();
        let text = if text.is_empty() { "it failed without a reason".to_owned() } else { text };
        if kind == LOST {
            DeviceError::Lost(text)
        } else {
            DeviceError::Unavailable(text)
        }
    }

    /// A panic in the library is one here, too: who deals with drivers deals with that.
    fn check(&self, status: i32) -> Result<(), DeviceError> {
        match status {
            DONE => Ok(()),
            PANICKED => resume_unwind(Box::new(self.failure.take().1)),
            _ => Err(self.error()),
        }
    }
}

unsafe extern "C" fn fail(context: *const c_void, kind: u32, text: RawText) {
    // SAFETY: the library gives the context of the call that runs, in its thread, and a text of its own.
    unsafe { *(*context.cast::<Said>()).failure.borrow_mut() = (kind, text.read()) };
}

unsafe extern "C" fn found(context: *const c_void, model: RawText, identity: RawText) {
    // SAFETY: as above.
    unsafe {
        let info = DeviceInfo { model: model.read(), identity: identity.read() };
        (*context.cast::<Said>()).found.borrow_mut().push(info);
    }
}

unsafe extern "C" fn say(context: *const c_void, text: RawText) {
    // SAFETY: the log lives as long as the device; a `DeviceLog` may be used from any thread.
    unsafe { (*context.cast::<DeviceLog>()).say(text.read()) }
}

/// Calls `call` with settings as the library takes them.
fn with_settings<T>(settings: &Settings, call: impl FnOnce(*const RawSettings) -> T) -> T {
    let directory = settings.directory().to_string_lossy();
    let entries: Vec<RawSetting> = settings
        .iter()
        .map(|(key, setting)| RawSetting {
            key: RawText::of(key),
            value: RawText::of(&setting.value),
            place: RawText::of(&setting.place),
        })
        .collect();
    call(&RawSettings { entries: entries.as_ptr(), count: entries.len() as u64, directory: RawText::of(&directory) })
}

impl Driver for ForeignDriver {
    fn name(&self) -> &str {
        &self.name
    }

    fn serves(&self, model: &str) -> bool {
        // SAFETY: the driver is never freed; the text lives until the call returns.
        unsafe { (self.raw.serves)(self.raw.instance, RawText::of(model)) == 1 }
    }

    fn find(&self, model: &str, settings: &Settings) -> Result<Vec<DeviceInfo>, DeviceError> {
        let said = Said::default();
        let answer = said.answer();
        // SAFETY: the driver is never freed; all pointers live until the call returns.
        let status = with_settings(settings, |settings| unsafe {
            (self.raw.find)(self.raw.instance, &answer, RawText::of(model), settings)
        });
        said.check(status)?;
        Ok(said.found.take())
    }

    fn open(
        &self,
        info: &DeviceInfo,
        settings: &Settings,
        log: &DeviceLog,
    ) -> Result<Box<dyn InputDevice>, DeviceError> {
        let said = Said::default();
        let answer = said.answer();
        let log = Box::new(log.clone());
        let raw_log = Box::new(RawLog { context: std::ptr::from_ref(&*log).cast(), say });
        let (model, identity) = (RawText::of(&info.model), RawText::of(&info.identity));
        // SAFETY: the driver is never freed; the log stays with the device; all other pointers live until the call
        // returns.
        let raw = with_settings(settings, |settings| unsafe {
            (self.raw.open)(self.raw.instance, &answer, model, identity, settings, &*raw_log)
        });
        let raw = NonNull::new(raw).ok_or_else(|| said.error())?;
        // SAFETY: the table and its texts live until `destroy`.
        let spec = unsafe { raw.as_ref().spec.read() };
        Ok(Box::new(ForeignDevice { raw, spec, closed: false, _log: (log, raw_log) }))
    }
}

struct ForeignDevice {
    raw: NonNull<RawDevice>,
    spec: DeviceSpec,
    closed: bool,
    /// The library has their addresses.
    _log: (Box<DeviceLog>, Box<RawLog>),
}

// SAFETY: the interface demands of a device that it can be called from any thread, from one at a time.
unsafe impl Send for ForeignDevice {}

impl ForeignDevice {
    /// Calls a function of the table.
    fn call(&mut self, call: impl FnOnce(&RawDevice, &RawAnswer) -> i32) -> Result<(), DeviceError> {
        let said = Said::default();
        // SAFETY: the table lives until `destroy`, which only `drop` calls.
        let status = call(unsafe { self.raw.as_ref() }, &said.answer());
        said.check(status)
    }
}

impl InputDevice for ForeignDevice {
    fn spec(&self) -> &DeviceSpec {
        &self.spec
    }

    fn read(&mut self) -> Result<DeviceSample, DeviceError> {
        let mut sample = RawSample::default();
        // SAFETY: the device is alive; both pointers live until the call returns.
        self.call(|raw, answer| unsafe { (raw.read)(raw.instance, answer, &mut sample) })?;
        Ok(sample.read(Instant::now()))
    }

    fn write(&mut self, force: &DeviceForce) -> Result<(), DeviceError> {
        let force = RawForce::from(force);
        // SAFETY: as above.
        self.call(|raw, answer| unsafe { (raw.write)(raw.instance, answer, &force) })
    }

    fn close(&mut self) {
        if !std::mem::replace(&mut self.closed, true) {
            // SAFETY: as above. What fails here concerns a device that is gone.
            let _ = self.call(|raw, answer| unsafe { (raw.close)(raw.instance, answer) });
        }
    }
}

impl Drop for ForeignDevice {
    fn drop(&mut self) {
        // `close` may pass on a panic, after which the device is still to be freed.
        struct Free(NonNull<RawDevice>);
        impl Drop for Free {
            fn drop(&mut self) {
                // SAFETY: it is called once, last.
                unsafe { (self.0.as_ref().destroy)(self.0.as_ptr()) }
            }
        }
        let _free = Free(self.raw);
        if !std::thread::panicking() {
            self.close();
        }
    }
}
