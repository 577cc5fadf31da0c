//! The vendor's library as all devices of the process share it: one scheduler, devices come and go.

use std::ffi::CString;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use ambf_device::{DeviceError, DeviceLog};
use parking_lot::Mutex;

use crate::hd::{self, Handle, Hd, ScheduleHandle};
use crate::servo::{self, Servo, Shared};

/// Name that stands for the default device of the library.
pub(crate) const DEFAULT_DEVICE: &str = "Default Device";
/// How long the scheduler may take to call a callback for the first time, or the last.
const PATIENCE: Duration = Duration::from_secs(2);
const LAST_PATIENCE: Duration = Duration::from_millis(200);

/// Libraries that were loaded, by what was asked for. They stay until the program ends: threads of theirs may run in
/// them.
static LIBRARIES: Mutex<Vec<(Option<PathBuf>, Arc<HdLibrary>)>> = Mutex::new(Vec::new());

/// A library that was loaded.
pub(crate) struct HdLibrary {
    pub hd: Hd,
    control: Mutex<Control>,
}

/// What only opening and closing touches, never the scheduler's thread.
#[derive(Default)]
struct Control {
    /// Names of devices that are open.
    open: Vec<String>,
    /// Rate that was asked for, Hz.
    rate: Option<u64>,
}

/// A device that was opened. [`HdLibrary::close`] ends it.
pub(crate) struct Opened {
    name: String,
    device: Handle,
    callback: ScheduleHandle,
    servo: ServoBox,
    pub shared: Arc<Shared>,
}

/// The state that the scheduler has a pointer to.
struct ServoBox(*mut Servo);

// SAFETY: a servo is `Send`; the pointer is only used to free it, after the callback has ended.
unsafe impl Send for ServoBox {}

impl HdLibrary {
    /// The library at `path`, or the vendor's; loaded once.
    ///
    /// # Errors
    /// [`DeviceError::Unavailable`] if it cannot be loaded.
    pub fn shared(path: Option<PathBuf>) -> Result<Arc<Self>, DeviceError> {
        let mut libraries = LIBRARIES.lock();
        if let Some((_, library)) = libraries.iter().find(|(known, _)| *known == path) {
            return Ok(library.clone());
        }
        let library = Arc::new(Self { hd: hd::load(path.as_ref())?, control: Mutex::default() });
        libraries.push((path, library.clone()));
        Ok(library)
    }

    /// Opens the device of that name, starts the scheduler if it does not run, and waits for the first sample.
    ///
    /// # Errors
    /// [`DeviceError::Unavailable`] if there is no such device, [`DeviceError::Lost`] if the scheduler does not answer.
    pub fn open(self: &Arc<Self>, name: &str, rate: Option<u64>, log: &DeviceLog) -> Result<Opened, DeviceError> {
        let mut control = self.control.lock();
        if control.open.iter().any(|open| open == name) {
            return Err(DeviceError::Unavailable(format!(
                "`{name}` is in use already: give each entry its own `driver settings: {{device: …}}`"
            )));
        }
        let device = self.init(name)?;
        if control.open.is_empty() {
            control.rate = None;
        }
        self.set_rate(&mut control, rate, log);
        if control.open.is_empty() {
            self.hd.start_scheduler();
            if let Some(error) = self.hd.worst_error(hd::INVALID_HANDLE) {
                self.hd.disable_device(device);
                return Err(DeviceError::Unavailable(format!(
                    "the scheduler of the HD library does not start: {} (error {:04x})",
                    hd::explain(error.code),
                    error.code
                )));
            }
        }

        let shared = Arc::new(Shared::new());
        let servo = Box::into_raw(Box::new(Servo::new(self.clone(), device, shared.clone())));
        // SAFETY: the callback takes its argument for a servo; this one is freed only after the callback has ended.
        let callback = unsafe { self.hd.schedule(servo::callback, servo.cast(), hd::DEFAULT_PRIORITY) };
        let opened = Opened { name: name.to_owned(), device, callback, servo: ServoBox(servo), shared };
        control.open.push(name.to_owned());
        if wait(PATIENCE, || opened.shared.phase.load(Ordering::Acquire) != servo::WAITING) {
            return Ok(opened);
        }
        let why = self.hd.worst_error(device).map_or("it never calls back", |error| hd::explain(error.code));
        self.end(&mut control, opened);
        Err(DeviceError::Lost(format!("the scheduler of the HD library does not serve `{name}`: {why}")))
    }

    fn init(&self, name: &str) -> Result<Handle, DeviceError> {
        let text = CString::new(name)
            .map_err(|_| DeviceError::Unavailable(String::from("the name of the device has a zero in it")))?;
        let device = self.hd.init_device((name != DEFAULT_DEVICE).then_some(text.as_c_str()));
        let error = self.hd.worst_error(hd::INVALID_HANDLE);
        match error {
            None if device != hd::INVALID_HANDLE => Ok(device),
            _ => {
                let code = error.map_or(0, |error| error.code);
                if device != hd::INVALID_HANDLE {
                    self.hd.disable_device(device);
                }
                let hint = if code == hd::DEVICE_ALREADY_INITIATED {
                    "close the other program, or name another device"
                } else {
                    "see that it is plugged in, that the vendor's set-up tool knows it by this name, and that its serial port may be read and \
                     written"
                };
                Err(DeviceError::Unavailable(format!(
                    "`{name}` cannot be initialised: {} (error {code:04x}); {hint}",
                    hd::explain(code)
                )))
            }
        }
    }

    /// Asks for a rate; the scheduler has only one for all devices.
    fn set_rate(&self, control: &mut Control, rate: Option<u64>, log: &DeviceLog) {
        let Some(rate) = rate else { return };
        if control.rate.is_some_and(|other| other != rate) {
            log.say(format!(
                "`rate: {rate}` is left out: another device has set the rate of the scheduler that all share"
            ));
            return;
        }
        self.hd.set_scheduler_rate(rate);
        match self.hd.worst_error(hd::INVALID_HANDLE) {
            Some(error) => log.say(format!(
                "the HD library refuses `rate: {rate}` ({}, error {:04x}) and keeps its own",
                hd::explain(error.code),
                error.code
            )),
            None => control.rate = Some(rate),
        }
    }

    /// Ends a device: no force, one more frame, no more callbacks, the scheduler if it was the last, the device.
    pub fn close(&self, opened: Opened) {
        self.end(&mut self.control.lock(), opened);
    }

    fn end(&self, control: &mut Control, opened: Opened) {
        let finished = || opened.shared.phase.load(Ordering::Acquire) == servo::FINISHED;
        opened.shared.closing.store(true, Ordering::Release);
        let ended = wait(LAST_PATIENCE, finished);
        if !ended {
            self.hd.unschedule(opened.callback);
        }
        control.open.retain(|name| *name != opened.name);
        if control.open.is_empty() {
            self.hd.stop_scheduler();
        }
        self.hd.disable_device(opened.device);
        self.hd.worst_error(hd::INVALID_HANDLE);
        if ended {
            // SAFETY: the pointer is that of `Box::into_raw`, and the callback that used it has said that it is over.
            drop(unsafe { Box::from_raw(opened.servo.0) });
        }
        // Otherwise the scheduler stands still, perhaps in the callback: what it may come back to stays.
    }
}

/// Whether something happens in time.
fn wait(patience: Duration, mut happens: impl FnMut() -> bool) -> bool {
    let start = Instant::now();
    while !happens() {
        if start.elapsed() > patience {
            return false;
        }
        thread::sleep(Duration::from_micros(500));
    }
    true
}
