//! What happens when the window system goes away.

use std::ffi::{c_int, c_void};
use std::sync::atomic::{AtomicBool, Ordering};

/// The connection to the X server broke.
static LOST: AtomicBool = AtomicBool::new(false);

/// Whether the connection to the window system broke.
pub(crate) fn is_lost() -> bool {
    LOST.load(Ordering::Acquire)
}

/// Xlib ends the process when this returns, so it doesn't: only the thread with the windows ever gets here, and the rest of the program
/// goes on without it.
extern "C" fn on_broken_connection(_display: *mut c_void) -> c_int {
    LOST.store(true, Ordering::Release);
    loop {
        std::thread::park();
    }
}

/// Keeps a broken connection to the X server from ending the process.
pub(crate) fn survive() {
    type Handler = extern "C" fn(*mut c_void) -> c_int;
    // SAFETY: loading Xlib runs no code but its own initialisation, and winit has loaded it before where it matters.
    let Ok(library) = (unsafe { libloading::Library::new("libX11.so.6") }) else { return };
    // SAFETY: `XIOErrorHandler XSetIOErrorHandler(XIOErrorHandler)` of Xlib; the handler has the signature that it expects and lives as long
    // as the process.
    unsafe {
        let set = library.get::<unsafe extern "C" fn(Handler) -> *mut c_void>(b"XSetIOErrorHandler\0");
        if let Ok(set) = set {
            set(on_broken_connection);
        }
    }
    // The handler stays in use.
    std::mem::forget(library);
}
