//! What happens when the window system goes away.

use std::cell::Cell;
use std::ffi::{c_int, c_void};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Once;

/// The connection to the X server broke.
static LOST: AtomicBool = AtomicBool::new(false);

/// What is said then.
pub(crate) const BROKEN: &str = "the connection to the display broke";

thread_local! {
    /// The library that talks to the window system has panicked in this thread.
    static BROKE_HERE: Cell<bool> = const { Cell::new(false) };
}

/// Whether the library that talks to the window system has panicked in this thread: it does so when the connection is
/// gone.
pub(crate) fn broke_in_this_thread() -> bool {
    BROKE_HERE.get()
}

/// Keeps such panics out of the output: they are no bugs, and one line says what happened.
fn quieten() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            let is_of_windows = std::thread::current().name() == Some("windows");
            if is_of_windows && panic.location().is_some_and(|place| place.file().contains("/winit-")) {
                BROKE_HERE.set(true);
            } else {
                before(panic);
            }
        }));
    });
}

/// Whether the connection to the window system broke.
pub(crate) fn is_lost() -> bool {
    LOST.load(Ordering::Acquire)
}

/// Xlib ends the process when this returns, so it doesn't: only the thread with the windows ever gets here, and the
/// rest of the program goes on without it.
extern "C" fn on_broken_connection(_display: *mut c_void) -> c_int {
    LOST.store(true, Ordering::Release);
    loop {
        std::thread::park();
    }
}

/// Keeps a broken connection to the X server from ending the process.
pub(crate) fn survive() {
    quieten();
    type Handler = extern "C" fn(*mut c_void) -> c_int;
    // SAFETY: loading Xlib runs no code but its own initialisation, and winit has loaded it before where it matters.
    let Ok(library) = (unsafe { libloading::Library::new("libX11.so.6") }) else { return };
    // SAFETY: `XIOErrorHandler XSetIOErrorHandler(XIOErrorHandler)` of Xlib; the handler has the signature that it
    // expects and lives as long as the process.
    unsafe {
        let set = library.get::<unsafe extern "C" fn(Handler) -> *mut c_void>(b"XSetIOErrorHandler\0");
        if let Ok(set) = set {
            set(on_broken_connection);
        }
    }
    // The handler stays in use.
    std::mem::forget(library);
}
