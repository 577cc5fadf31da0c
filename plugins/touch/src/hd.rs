//! The HD interface of OpenHaptics: its symbols, types and numbers as far as the driver needs them, and safe calls of
//! them.

use std::ffi::{c_char, c_void, CStr};
use std::path::PathBuf;
use std::ptr;

use ambf_device::DeviceError;
use libloading::Library;

/// A device that was initialised.
pub(crate) type Handle = u32;
/// A callback that was scheduled.
pub(crate) type ScheduleHandle = u64;
/// What the scheduler calls; it gives back [`DONE`] or [`CONTINUE`].
pub(crate) type Callback = extern "C" fn(*mut c_void) -> u32;

/// The callback is not called again.
pub(crate) const DONE: u32 = 0;
/// The callback is called in the next tick too.
pub(crate) const CONTINUE: u32 = 1;
pub(crate) const INVALID_HANDLE: Handle = 0xFFFF_FFFF;
pub(crate) const DEFAULT_PRIORITY: u16 = 32767;

pub(crate) const CURRENT_BUTTONS: u32 = 0x2000;
pub(crate) const CURRENT_VELOCITY: u32 = 0x2051;
pub(crate) const CURRENT_TRANSFORM: u32 = 0x2052;
pub(crate) const CURRENT_JOINT_ANGLES: u32 = 0x2100;
pub(crate) const CURRENT_GIMBAL_ANGLES: u32 = 0x2150;
pub(crate) const DEVICE_MODEL_TYPE: u32 = 0x2501;
pub(crate) const DEVICE_VENDOR: u32 = 0x2503;
pub(crate) const DEVICE_SERIAL_NUMBER: u32 = 0x2504;
pub(crate) const USABLE_WORKSPACE_DIMENSIONS: u32 = 0x2551;
pub(crate) const CALIBRATION_STYLE: u32 = 0x2555;
pub(crate) const NOMINAL_MAX_FORCE: u32 = 0x2603;
pub(crate) const CURRENT_FORCE: u32 = 0x2700;
/// Deprecated by the vendor, but the only torque that is Cartesian.
pub(crate) const CURRENT_TORQUE: u32 = 0x2701;
pub(crate) const FORCE_OUTPUT: u32 = 0x4000;
pub(crate) const MAX_FORCE_CLAMPING: u32 = 0x4001;

pub(crate) const CALIBRATION_OK: u32 = 0x5000;
pub(crate) const CALIBRATION_NEEDS_UPDATE: u32 = 0x5001;
pub(crate) const CALIBRATION_NEEDS_MANUAL_INPUT: u32 = 0x5002;
pub(crate) const STYLE_ENCODER_RESET: u32 = 1;
pub(crate) const STYLE_AUTO: u32 = 2;
pub(crate) const STYLE_INKWELL: u32 = 4;

pub(crate) const SUCCESS: u32 = 0;
pub(crate) const DEVICE_ALREADY_INITIATED: u32 = 0x0301;

/// The newest error, as `hdGetError` gives it back by value: 12 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ErrorInfo {
    pub code: u32,
    pub internal: i32,
    pub handle: Handle,
}

/// Families of error codes, which the driver treats alike; the later, the worse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum ErrorKind {
    /// A call that this library or device does not know.
    Call,
    /// Motors too warm, force or velocity too large.
    Force,
    /// The device does not answer, or a frame went wrong.
    Device,
    /// The scheduler, or the licence.
    Scheduler,
}

impl ErrorInfo {
    pub fn kind(self) -> ErrorKind {
        match self.code {
            0x0200..=0x02FF => ErrorKind::Force,
            0x0300..=0x04FF => ErrorKind::Device,
            0x0500..=0x06FF => ErrorKind::Scheduler,
            _ => ErrorKind::Call,
        }
    }
}

/// What an error code means.
pub(crate) fn explain(code: u32) -> &'static str {
    match code {
        0x0100..=0x01FF => "a call that it does not know",
        0x0200 => "its motors are too warm",
        0x0201 => "the force was too large",
        0x0202 => "the force changed too fast",
        0x0203 => "it was moved too fast",
        0x0204 => "its forces are off",
        0x0300 => "the device is at fault",
        0x0301 => "another device or program uses it already",
        0x0302 => "the device does not answer",
        0x0303 => "its configuration does not fit",
        0x0304 => "its timer failed",
        0x0400..=0x04FF => "a frame went wrong",
        0x0500 => "a wrong priority",
        0x0501 => "the scheduler is full",
        0x0600 => "the licence of the library is not valid",
        _ => "an unknown error",
    }
}

/// A function of the library; its name goes to `missing` if there is none.
///
/// # Safety
/// `T` must be the type of that function.
unsafe fn symbol<T: Copy>(library: &Library, name: &'static str, missing: &mut Vec<&'static str>) -> Option<T> {
    // SAFETY: the caller names the type.
    let symbol = unsafe { library.get::<T>(name.as_bytes()) };
    symbol.map(|symbol| *symbol).map_err(|_| missing.push(name)).ok()
}

/// Declares a table of functions that are resolved by name.
macro_rules! functions {
    ($(#[$doc:meta])* $table:ident { $($name:ident: fn($($arg:ty),*) $(-> $result:ty)?;)* }) => {
        $(#[$doc])*
        #[allow(non_snake_case, reason = "the fields have the names of the symbols")]
        pub(crate) struct $table {
            $($name: unsafe extern "C" fn($($arg),*) $(-> $result)?,)*
            /// Where the functions are; it outlives them.
            _library: Library,
        }

        #[allow(non_snake_case, reason = "as above")]
        impl $table {
            /// Resolves all functions.
            ///
            /// # Errors
            /// The names of those that are missing.
            pub fn resolve(library: Library) -> Result<Self, Vec<&'static str>> {
                let mut missing = Vec::new();
                $(
                    // SAFETY: this is the type of that function in every version of HD on 64-bit Linux.
                    let $name = unsafe { symbol(&library, stringify!($name), &mut missing) };
                )*
                Ok(Self {
                    $($name: match $name {
                        Some(function) => function,
                        None => return Err(missing),
                    },)*
                    _library: library,
                })
            }
        }
    };
}

functions! {
    /// The functions that the driver calls.
    Hd {
        hdInitDevice: fn(*const c_char) -> Handle;
        hdDisableDevice: fn(Handle);
        hdMakeCurrentDevice: fn(Handle);
        hdGetCurrentDevice: fn() -> Handle;
        hdBeginFrame: fn(Handle);
        hdEndFrame: fn(Handle);
        hdGetError: fn() -> ErrorInfo;
        hdEnable: fn(u32);
        hdGetIntegerv: fn(u32, *mut i32);
        hdGetDoublev: fn(u32, *mut f64);
        hdGetString: fn(u32) -> *const c_char;
        hdSetDoublev: fn(u32, *const f64);
        hdCheckCalibration: fn() -> u32;
        hdUpdateCalibration: fn(u32);
        hdStartScheduler: fn();
        hdStopScheduler: fn();
        hdSetSchedulerRate: fn(u64);
        hdScheduleAsynchronous: fn(Callback, *mut c_void, u16) -> ScheduleHandle;
        hdUnschedule: fn(ScheduleHandle);
    }
}

/// Safe methods for functions that take and give numbers only.
macro_rules! calls {
    ($($(#[$doc:meta])* $name:ident = $symbol:ident($($arg:ident: $type:ty),*) $(-> $result:ty)?;)*) => {
        impl Hd {
            $($(#[$doc])*
            pub fn $name(&self $(, $arg: $type)*) $(-> $result)? {
                // SAFETY: the function takes numbers by value and checks them itself; it belongs to a library that
                // stays loaded.
                unsafe { (self.$symbol)($($arg),*) }
            })*
        }
    };
}

calls! {
    disable_device = hdDisableDevice(device: Handle);
    make_current = hdMakeCurrentDevice(device: Handle);
    current = hdGetCurrentDevice() -> Handle;
    begin_frame = hdBeginFrame(device: Handle);
    end_frame = hdEndFrame(device: Handle);
    /// Takes the newest error from the stack; [`SUCCESS`] when there is none.
    pop_error = hdGetError() -> ErrorInfo;
    enable = hdEnable(capability: u32);
    check_calibration = hdCheckCalibration() -> u32;
    update_calibration = hdUpdateCalibration(style: u32);
    start_scheduler = hdStartScheduler();
    stop_scheduler = hdStopScheduler();
    /// Hz.
    set_scheduler_rate = hdSetSchedulerRate(rate: u64);
    unschedule = hdUnschedule(callback: ScheduleHandle);
}

impl Hd {
    /// Initialises a device; `None` is the default one.
    pub fn init_device(&self, name: Option<&CStr>) -> Handle {
        // SAFETY: the name is null or ends with a zero, and is only read during the call.
        unsafe { (self.hdInitDevice)(name.map_or(ptr::null(), CStr::as_ptr)) }
    }

    /// A whole number of the current device.
    pub fn integer(&self, name: u32) -> i32 {
        // The values asked for are one number; room for more costs nothing should a version of the library think
        // otherwise.
        let mut values = [0; 16];
        // SAFETY: the function writes at most as many numbers as there is room for.
        unsafe { (self.hdGetIntegerv)(name, values.as_mut_ptr()) };
        values[0]
    }

    /// `N` numbers of the current device. Those that the library did not write are not a number.
    pub fn doubles<const N: usize>(&self, name: u32) -> [f64; N] {
        const ROOM: usize = 16;
        assert!(N <= ROOM, "no value of HD has more than 16 numbers that the driver asks for");
        let mut values = [f64::NAN; ROOM];
        // SAFETY: what the driver asks for has at most 16 numbers (a transform), for which there is room.
        unsafe { (self.hdGetDoublev)(name, values.as_mut_ptr()) };
        std::array::from_fn(|i| values[i])
    }

    /// Hands over the three numbers of a force or torque.
    pub fn set_vector(&self, name: u32, values: &[f64; 3]) {
        // SAFETY: forces and torques are three numbers, and are only read during the call.
        unsafe { (self.hdSetDoublev)(name, values.as_ptr()) };
    }

    /// A text of the current device; empty if it has none.
    pub fn text(&self, name: u32) -> String {
        // SAFETY: the function takes a number by value.
        let text = unsafe { (self.hdGetString)(name) };
        if text.is_null() {
            return String::new();
        }
        // SAFETY: texts of the library end with a zero and stay until the next call, which only this thread makes.
        unsafe { CStr::from_ptr(text) }.to_string_lossy().trim().to_owned()
    }

    /// Schedules `callback` with `user`.
    ///
    /// # Safety
    /// `user` must be what `callback` takes it for, until the callback has given back [`DONE`] or was unscheduled.
    pub unsafe fn schedule(&self, callback: Callback, user: *mut c_void, priority: u16) -> ScheduleHandle {
        // SAFETY: the caller answers for `user`.
        unsafe { (self.hdScheduleAsynchronous)(callback, user, priority) }
    }

    /// Takes all errors from the stack and gives back the worst that concerns `device` or no device at all, the newest
    /// of those.
    pub fn worst_error(&self, device: Handle) -> Option<ErrorInfo> {
        let mut worst: Option<ErrorInfo> = None;
        // A stack that never ends must not stop the scheduler.
        for _ in 0..32 {
            let error = self.pop_error();
            if error.code == SUCCESS {
                break;
            }
            let ours = error.handle == device || error.handle == INVALID_HANDLE || device == INVALID_HANDLE;
            if ours && worst.is_none_or(|worst| error.kind() > worst.kind()) {
                worst = Some(error);
            }
        }
        worst
    }
}

/// Names of the vendor's library, in the order in which they are tried.
const NAMES: [&str; 3] = ["libHD.so", "libHD.so.3.0", "libHD.so.3.4"];

/// Opens the library at `path`, or the vendor's from the loader's search path.
///
/// # Errors
/// [`DeviceError::Unavailable`] if there is none, or lacks a function.
pub(crate) fn load(path: Option<&PathBuf>) -> Result<Hd, DeviceError> {
    let open = |name: &std::ffi::OsStr| {
        // SAFETY: what a library does when it is loaded is its maker's business; the user asked for it by naming such a
        // device.
        unsafe { Library::new(name) }
    };
    let (library, name) = match path {
        Some(path) => {
            let library = open(path.as_os_str()).map_err(|error| {
                DeviceError::Unavailable(format!("{}: cannot be opened as the HD library: {error}", path.display()))
            })?;
            (library, path.display().to_string())
        }
        None => NAMES.iter().find_map(|name| Some((open(name.as_ref()).ok()?, (*name).to_owned()))).ok_or_else(|| {
            DeviceError::Unavailable(format!(
                "no HD library ({}) was found: install OpenHaptics and the Touch device driver of 3D Systems, or name the \
                 library with `driver settings: {{library: …}}`",
                NAMES.join(", ")
            ))
        })?,
    };
    Hd::resolve(library).map_err(|missing| {
        DeviceError::Unavailable(format!(
            "{name}: lacks {}, which the HD library of OpenHaptics 3 has",
            missing.join(", ")
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use fake_hd::Fake;
    use std::sync::atomic::{AtomicU32, Ordering};

    functions! {
        /// Functions of HD that the driver does not need.
        Rest {
            hdGetErrorString: fn(u32) -> *const c_char;
            hdDisable: fn(u32);
            hdIsEnabled: fn(u32) -> u8;
            hdGetBooleanv: fn(u32, *mut u8);
            hdGetFloatv: fn(u32, *mut f32);
            hdGetLongv: fn(u32, *mut i64);
            hdSetBooleanv: fn(u32, *const u8);
            hdSetIntegerv: fn(u32, *const i32);
            hdSetFloatv: fn(u32, *const f32);
            hdSetLongv: fn(u32, *const i64);
            hdCheckCalibrationStyle: fn() -> u32;
            hdScheduleSynchronous: fn(Callback, *mut c_void, u16);
            hdWaitForCompletion: fn(ScheduleHandle, u32) -> u8;
            hdGetSchedulerTimeStamp: fn() -> f64;
        }
    }

    extern "C" fn count(user: *mut c_void) -> u32 {
        // SAFETY: the test passes a counter that outlives the scheduler.
        let counter = unsafe { &*user.cast::<AtomicU32>() };
        if counter.fetch_add(1, Ordering::Relaxed) % 3 < 2 {
            CONTINUE
        } else {
            DONE
        }
    }

    #[test]
    fn every_function_works_from_rust() {
        let fake = Fake::new(&[("Arm", "Touch"), ("Other", "Touch")]).unwrap();
        fake.tell("Arm: pose 1 2 3");
        let hd = load(Some(&fake.path().to_owned())).unwrap();
        // SAFETY: loading the fake starts nothing.
        let rest = Rest::resolve(unsafe { Library::new(fake.path()) }.unwrap()).unwrap();

        assert_eq!(hd.init_device(Some(c"Nobody")), INVALID_HANDLE);
        let error = hd.pop_error();
        assert_eq!(error, ErrorInfo { code: 0x0302, internal: -0x0302, handle: INVALID_HANDLE });
        assert_eq!((size_of::<ErrorInfo>(), error.kind()), (12, ErrorKind::Device));
        let device = hd.init_device(Some(c"Arm"));
        hd.make_current(9);
        assert_eq!(hd.pop_error(), ErrorInfo { code: 0x0104, internal: -0x0104, handle: 9 }, "three numbers by value");
        assert_eq!(hd.pop_error(), ErrorInfo { code: SUCCESS, internal: 0, handle: INVALID_HANDLE });
        assert_eq!((hd.current(), hd.text(DEVICE_MODEL_TYPE)), (device, String::from("Touch")));
        hd.enable(FORCE_OUTPUT);
        hd.begin_frame(device);
        assert_eq!(hd.doubles::<16>(CURRENT_TRANSFORM)[12..], [1.0, 2.0, 3.0, 1.0]);
        assert!(hd.doubles::<3>(0x2999).iter().all(|x| x.is_nan()) && hd.pop_error().code == 0x0100);
        hd.set_vector(CURRENT_FORCE, &[0.0, 1.0, 0.0]);
        hd.end_frame(device);
        assert_eq!(fake.newest_force("Arm").unwrap().force, [0.0, 1.0, 0.0]);
        assert_eq!((hd.integer(CALIBRATION_STYLE), hd.check_calibration()), (6, CALIBRATION_OK));
        hd.update_calibration(STYLE_AUTO);
        hd.set_scheduler_rate(1000);
        hd.start_scheduler();
        let counter = AtomicU32::new(0);
        let user = std::ptr::from_ref(&counter).cast_mut().cast();
        // SAFETY: the counter outlives the callback, which has ended when it was counted to three.
        let handle = unsafe { hd.schedule(count, user, DEFAULT_PRIORITY) };
        // SAFETY: the types are those of HD, pointers have room for what is asked for, and the scheduler's callback
        // ends.
        unsafe {
            assert_eq!((rest.hdWaitForCompletion)(handle, 1), 0);
            assert_eq!(counter.load(Ordering::Relaxed), 3);
            (rest.hdScheduleSynchronous)(count, user, 1);
            assert_eq!(counter.load(Ordering::Relaxed), 6);
            assert!((rest.hdGetSchedulerTimeStamp)() >= 0.0);
            hd.unschedule(handle);
            assert_eq!(hd.pop_error().code, 0x0101, "it is over");
            assert_eq!(CStr::from_ptr((rest.hdGetErrorString)(0x0302)), c"device error");
            assert_eq!((rest.hdIsEnabled)(FORCE_OUTPUT), 1);
            (rest.hdDisable)(FORCE_OUTPUT);
            assert_eq!((rest.hdIsEnabled)(FORCE_OUTPUT), 0);
            assert_eq!((rest.hdCheckCalibrationStyle)(), 6);
            hd.begin_frame(device);
            let (mut truth, mut float, mut long) = ([9_u8], [0.0_f32; 3], [-1_i64; 6]);
            (rest.hdGetBooleanv)(0x2001, truth.as_mut_ptr());
            (rest.hdGetFloatv)(0x2050, float.as_mut_ptr());
            (rest.hdGetLongv)(0x2010, long.as_mut_ptr());
            assert_eq!((truth, float, long), ([0], [1.0, 2.0, 3.0], [0; 6]));
            (rest.hdSetFloatv)(CURRENT_FORCE, [0.5_f32, 0.0, 0.0].as_ptr());
            assert_eq!(hd.doubles::<3>(CURRENT_FORCE), [0.5, 0.0, 0.0]);
            (rest.hdSetBooleanv)(CURRENT_FORCE, truth.as_ptr());
            (rest.hdSetIntegerv)(CURRENT_FORCE, [0; 3].as_ptr());
            (rest.hdSetLongv)(CURRENT_FORCE, [0; 3].as_ptr());
            assert_eq!(
                [hd.pop_error().code, hd.pop_error().code, hd.pop_error().code, hd.pop_error().code],
                [0x0103, 0x0103, 0x0103, 0]
            );
            hd.end_frame(device);
        }
        hd.stop_scheduler();
        hd.disable_device(device);
        // The worst first, whatever came last.
        hd.set_scheduler_rate(77);
        assert_eq!(hd.init_device(Some(c"Nobody")), INVALID_HANDLE);
        hd.set_scheduler_rate(77);
        assert_eq!(hd.worst_error(device).map(|error| error.code), Some(0x0302));
        assert_eq!(hd.worst_error(INVALID_HANDLE), None);
    }
}
