//! A context without a window, by EGL.

use std::ffi::{c_void, CStr};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::Arc;

use khronos_egl as egl;
use parking_lot::Mutex;

use crate::RenderError;

type Egl = egl::DynamicInstance<egl::EGL1_5>;

const PLATFORM_DEVICE: egl::Enum = 0x313F;
const PLATFORM_SURFACELESS: egl::Enum = 0x31DD;
const DEFAULT_DISPLAY: *mut c_void = std::ptr::null_mut();
/// Most devices that are looked at.
const MAX_DEVICES: usize = 16;

/// A context without a surface.
pub(super) struct Offscreen {
    egl: Arc<Egl>,
    display: egl::Display,
    context: egl::Context,
    /// The process that it was made in.
    process: u32,
}

// SAFETY: EGL's functions may be called from any thread; the context is current on one thread at a time, because it is
// made current for the duration of one call of a renderer (`&mut`) and released after it. Displays and contexts are
// plain handles.
unsafe impl Send for Offscreen {}

/// The process that has loaded the library; 0: none has. The threads and locks of the library are those of that
/// process: in a process that was forked from it every call could wait for ever.
static PROCESS: AtomicU32 = AtomicU32::new(0);

/// Fails in a process that was forked from one that has used the library.
fn check_process() -> Result<(), RenderError> {
    match PROCESS.load(Ordering::Acquire) {
        0 => Ok(()),
        process if process == std::process::id() => Ok(()),
        _ => Err(RenderError::Forked),
    }
}

/// The library and the displays that are initialised: a display belongs to the process, so it is never terminated.
fn library() -> Result<Arc<Egl>, RenderError> {
    // Before the lock: another thread of the parent process may have held it while that process was copied.
    check_process()?;
    PROCESS.store(std::process::id(), Ordering::Release);
    static LIBRARY: Mutex<Option<Arc<Egl>>> = Mutex::new(None);
    let mut library = LIBRARY.lock();
    if let Some(egl) = &*library {
        return Ok(Arc::clone(egl));
    }
    // SAFETY: libEGL is a system library whose initialisers may run at any time.
    let egl = unsafe { Egl::load_required_from_filename("libEGL.so.1") };
    let egl = Arc::new(egl.map_err(|error| RenderError::NoContext(error.to_string()))?);
    *library = Some(Arc::clone(&egl));
    Ok(egl)
}

impl Offscreen {
    /// On the first device that can: graphics cards, then Mesa's surfaceless platform (software), then the default
    /// display.
    pub(super) fn new() -> Result<Self, RenderError> {
        let egl = library()?;
        let mut why = "no EGL display".to_owned();
        for display in displays(&egl) {
            match Self::on(&egl, display) {
                Ok(context) => return Ok(context),
                Err(error) => why = error,
            }
        }
        Err(RenderError::NoContext(why))
    }

    fn on(egl: &Arc<Egl>, display: egl::Display) -> Result<Self, String> {
        egl.initialize(display).map_err(|error| error.to_string())?;
        let extensions = egl.query_string(Some(display), egl::EXTENSIONS).map_err(|error| error.to_string())?;
        if !extensions.to_string_lossy().contains("EGL_KHR_surfaceless_context") {
            return Err("EGL has no contexts without surfaces".into());
        }
        egl.bind_api(egl::OPENGL_API).map_err(|error| format!("EGL has no OpenGL: {error}"))?;
        let wanted = [egl::RENDERABLE_TYPE, egl::OPENGL_BIT, egl::SURFACE_TYPE, egl::PBUFFER_BIT, egl::NONE];
        let config = egl.choose_first_config(display, &wanted).map_err(|error| error.to_string())?;
        // Some surfaceless platforms have no such configuration, and need none.
        let config = config.unwrap_or_else(|| {
            // SAFETY: EGL_NO_CONFIG_KHR is the null pointer.
            unsafe { egl::Config::from_ptr(std::ptr::null_mut()) }
        });
        let attributes = [
            egl::CONTEXT_MAJOR_VERSION,
            3,
            egl::CONTEXT_MINOR_VERSION,
            3,
            egl::CONTEXT_OPENGL_PROFILE_MASK,
            egl::CONTEXT_OPENGL_COMPATIBILITY_PROFILE_BIT,
            egl::NONE,
        ];
        let context = egl
            .create_context(display, config, None, &attributes)
            .map_err(|error| format!("no OpenGL 3.3 with the compatibility profile: {error}"))?;
        let offscreen = Self { egl: Arc::clone(egl), display, context, process: std::process::id() };
        offscreen.make_current().map_err(|error| error.to_string())?;
        offscreen.release();
        Ok(offscreen)
    }

    /// # Errors
    /// [`RenderError::Forked`] in a process that was forked from that of the context.
    pub(super) fn make_current(&self) -> Result<(), RenderError> {
        check_process()?;
        let current = self
            .egl
            .bind_api(egl::OPENGL_API)
            .and_then(|()| self.egl.make_current(self.display, None, None, Some(self.context)));
        current.map_err(|error| RenderError::Gl(format!("the context cannot be used: {error}")))
    }

    pub(super) fn release(&self) {
        // A context that is lost cannot be released; there is nothing to do about it.
        let _ = self.egl.make_current(self.display, None, None, None);
    }

    pub(super) fn find(&self, name: &CStr) -> *const c_void {
        let address = name.to_str().ok().and_then(|name| self.egl.get_proc_address(name));
        address.map_or(std::ptr::null(), |function| function as *const c_void)
    }
}

impl Drop for Offscreen {
    fn drop(&mut self) {
        // In a process that was forked the context stays: it is the parent's.
        if self.process == std::process::id() {
            let _ = self.egl.destroy_context(self.display, self.context);
        }
    }
}

/// Displays that may be drawn on, best first.
fn displays(egl: &Egl) -> Vec<egl::Display> {
    let mut displays = Vec::new();
    let extensions = egl.query_string(None, egl::EXTENSIONS).map(|text| text.to_string_lossy().into_owned());
    let extensions = extensions.unwrap_or_default();
    // SAFETY: the platforms take the handles that their extensions name: a device of `eglQueryDevicesEXT`, or the
    // default display.
    let mut platform = |kind, handle| unsafe {
        if let Ok(display) = egl.get_platform_display(kind, handle, &[egl::ATTRIB_NONE]) {
            displays.push(display);
        }
    };
    if extensions.contains("EGL_EXT_platform_device") {
        for device in hardware(egl) {
            platform(PLATFORM_DEVICE, device);
        }
    }
    if extensions.contains("EGL_MESA_platform_surfaceless") {
        platform(PLATFORM_SURFACELESS, DEFAULT_DISPLAY);
    }
    // SAFETY: the default display is always legal.
    displays.extend(unsafe { egl.get_display(egl::DEFAULT_DISPLAY) });
    displays
}

/// Devices that are graphics cards.
fn hardware(egl: &Egl) -> Vec<*mut c_void> {
    type QueryDevices = unsafe extern "system" fn(egl::Int, *mut *mut c_void, *mut egl::Int) -> egl::Boolean;
    type QueryString = unsafe extern "system" fn(*mut c_void, egl::Int) -> *const std::ffi::c_char;
    let functions = egl.get_proc_address("eglQueryDevicesEXT").zip(egl.get_proc_address("eglQueryDeviceStringEXT"));
    let Some((devices, string)) = functions else { return Vec::new() };
    let mut found = [std::ptr::null_mut(); MAX_DEVICES];
    let mut count = 0;
    // SAFETY: the signatures are those of EGL_EXT_device_enumeration and EGL_EXT_device_query; the array has the size
    // that is passed.
    let (string, ok) = unsafe {
        let query = std::mem::transmute::<extern "system" fn(), QueryDevices>(devices);
        let string = std::mem::transmute::<extern "system" fn(), QueryString>(string);
        (string, query(MAX_DEVICES as egl::Int, found.as_mut_ptr(), &raw mut count))
    };
    let count = usize::try_from(count).unwrap_or(0).min(MAX_DEVICES);
    let is_hardware = |device: &*mut c_void| {
        // SAFETY: the device comes from EGL; the text is static or null.
        let extensions = unsafe {
            let text = string(*device, egl::EXTENSIONS);
            (!text.is_null()).then(|| CStr::from_ptr(text).to_string_lossy().into_owned())
        };
        extensions.is_some_and(|text| !text.contains("EGL_MESA_device_software"))
    };
    if ok == egl::TRUE {
        found[..count].iter().copied().filter(is_hardware).collect()
    } else {
        Vec::new()
    }
}
