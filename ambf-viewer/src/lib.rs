//! Windows of a running simulation: one a camera, with mouse, keys, texts and panels.
//!
//! [`Viewer::start`] opens them in a thread of its own, which has a lower priority than physics and devices. It draws
//! the newest snapshot of the [`Hub`], and what is done in a window goes to the simulation through a
//! [`WindowLink`]: nothing here waits for physics, and physics never waits for a picture. When the window
//! system goes away, the rest of the program goes on.
//!
//! Not in: how a scene is drawn, which is `ambf_render`'s; what a gesture does to a camera and what is picked, which is
//! `ambf_core`'s (`scene::CameraGesture`, `sim::WindowRequest`), so that published pictures follow.
//!
//! Begin with `app.rs`: `frame` is one round, `window_event` one use of a window. `keys.rs` has the keys, `panels.rs`
//! the panels, `context.rs` OpenGL.

mod app;
mod connection;
mod context;
mod keys;
mod labels;
mod outbox;
mod panels;
mod place;
mod record;
mod shown;

use std::panic::{catch_unwind, AssertUnwindSafe};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use ambf_core::comm::{Hub, Snapshot};
use ambf_core::device::host::{Controls, DeviceStatus};
use ambf_core::scene::VisualScene;
use ambf_core::sim::{Control, Models, WindowLink};
use ambf_render::{Renderer, Stage};
use crossbeam_channel::{bounded, Sender};
use parking_lot::Mutex;
use thiserror::Error;
use winit::event_loop::EventLoop;
use winit::platform::wayland::EventLoopBuilderExtWayland;
use winit::platform::x11::EventLoopBuilderExtX11;

/// Called once a frame, after all windows were drawn, in the thread that owns the OpenGL context, which is current.
/// What it puts into the markers of the stage stays there and is drawn from the next frame on.
pub type FrameHook = dyn FnMut(&mut Renderer, &mut Stage, &Arc<VisualScene>, &Arc<Snapshot>) + Send;

/// Begins a recording or ends it; a sentence.
pub type RecordSwitch = dyn Fn() -> Result<String, String> + Send + Sync;

/// How long the start waits for the window system.
const START_TIMEOUT: Duration = Duration::from_secs(60);
/// How long the end waits for the thread with the windows.
const STOP_TIMEOUT: Duration = Duration::from_secs(3);
/// Share of the processor that the thread with the windows gets: as a program that was started with `nice -n 5`.
const NICE: i32 = 5;

/// What windows work with.
pub struct ViewerParts {
    /// States of all objects, and what can be drawn.
    pub hub: Arc<Hub>,
    /// Way to the simulation for everything that is done in a window.
    pub link: WindowLink,
    /// Pause and steps.
    pub control: Arc<Control>,
    /// Adding and removing models.
    pub models: Models,
    /// Modes, gains and switches of input devices.
    pub devices: Arc<Controls>,
    /// What is shown of input devices.
    pub board: Arc<DeviceBoard>,
    /// Called after each frame; `None`: nothing is.
    pub hook: Option<Box<FrameHook>>,
    /// Begins a recording, or ends it, and says so, or why not; it may take long. `None`: the key for it does nothing.
    pub record: Option<Arc<RecordSwitch>>,
    /// Problems of the files that were loaded, one line each, for the panel that shows them.
    pub load_report: String,
    /// Says something to the user.
    pub say: Box<dyn Fn(&Said) + Send>,
}

/// Something that windows have to say.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Said {
    /// A line, or several.
    pub text: String,
    /// A picture or a video could not be written.
    pub is_failure: bool,
}

impl Said {
    fn well(text: String) -> Self {
        Self { text, is_failure: false }
    }

    fn failure(text: String) -> Self {
        Self { text, is_failure: true }
    }
}

/// What is shown of input devices; kept up to date by who runs them, a few times a second.
#[derive(Debug, Default)]
pub struct DeviceBoard(Mutex<DeviceNews>);

/// Content of a [`DeviceBoard`].
#[derive(Debug, Clone, Default)]
pub struct DeviceNews {
    /// All devices.
    pub devices: Vec<DeviceStatus>,
    /// What a button or key did last, such as "P_lc = 210.0000"; empty before.
    pub action: String,
    /// The last lines about devices, newest last.
    pub lines: Vec<String>,
}

impl DeviceBoard {
    /// Lines that are kept.
    const LINES: usize = 50;

    /// Changes what is shown.
    pub fn update(&self, change: impl FnOnce(&mut DeviceNews)) {
        let mut news = self.0.lock();
        change(&mut news);
        let surplus = news.lines.len().saturating_sub(Self::LINES);
        news.lines.drain(..surplus);
    }

    /// What is shown now.
    pub fn read(&self) -> DeviceNews {
        self.0.lock().clone()
    }
}

/// Why there are no windows.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ViewerError {
    /// Error when there is no display.
    #[error("there is no display to open windows on: set DISPLAY (or WAYLAND_DISPLAY), or run without windows (-g 0)")]
    NoDisplay,
    /// Error when the display cannot be used; why.
    #[error("windows cannot be opened: {0}; run without windows (-g 0) if they are not needed")]
    Failed(String),
}

/// How windows ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ended {
    /// A window was closed, or a key was pressed that ends the simulation.
    Closed,
    /// The window system or the context went away; why.
    Lost(String),
}

#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    /// Pictures and videos are being completed, which is worth any wait.
    writes: AtomicBool,
    ended: Mutex<Option<Ended>>,
}

impl Shared {
    fn end(&self, how: Ended) {
        self.ended.lock().get_or_insert(how);
    }
}

/// Whether the environment names a display.
pub fn display_is_named() -> bool {
    ["WAYLAND_DISPLAY", "WAYLAND_SOCKET", "DISPLAY"]
        .iter()
        .any(|name| std::env::var_os(name).is_some_and(|value| !value.is_empty()))
}

/// Windows of a running simulation. Dropping it closes them.
pub struct Viewer {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Viewer {
    /// Opens a window for each visible camera, in a thread of its own; cameras that come later get theirs then. Once a
    /// process: the window system cannot be connected a second time.
    ///
    /// # Errors
    /// [`ViewerError::NoDisplay`], [`ViewerError::Failed`].
    pub fn start(parts: ViewerParts) -> Result<Self, ViewerError> {
        if !display_is_named() {
            return Err(ViewerError::NoDisplay);
        }
        let shared = Arc::new(Shared::default());
        let (ready, started) = bounded(1);
        let own = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name("windows".into())
            .spawn(move || run(parts, &own, &ready))
            .map_err(|error| ViewerError::Failed(error.to_string()))?;
        match started.recv_timeout(START_TIMEOUT) {
            Ok(Ok(())) => Ok(Self { shared, thread: Some(thread) }),
            Ok(Err(why)) => Err(ViewerError::Failed(why)),
            Err(_) if connection::is_lost() => Err(ViewerError::Failed("the display closed the connection".into())),
            Err(_) => {
                shared.stop.store(true, Ordering::Release);
                Err(ViewerError::Failed("the window system does not answer".into()))
            }
        }
    }

    /// How the windows ended; `None` while they are open.
    pub fn ended(&self) -> Option<Ended> {
        let said = self.shared.ended.lock().clone();
        said.or_else(|| match connection::is_lost() {
            true => Some(Ended::Lost(connection::BROKEN.into())),
            false if self.thread.as_ref().is_some_and(JoinHandle::is_finished) => {
                Some(Ended::Lost("their thread ended, which is a bug".into()))
            }
            false => None,
        })
    }

    /// Closes all windows, and completes pictures and videos. A window system that does not answer within 3 s is left
    /// alone.
    pub fn stop(mut self) {
        self.end();
    }

    fn end(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
        let Some(thread) = self.thread.take() else { return };
        let deadline = Instant::now() + STOP_TIMEOUT;
        let is_in_time = || !connection::is_lost() && Instant::now() < deadline;
        while !thread.is_finished() && (self.shared.writes.load(Ordering::Acquire) || is_in_time()) {
            std::thread::sleep(Duration::from_millis(2));
        }
        if thread.is_finished() {
            // A panic was reported as the way it ended.
            let _ = thread.join();
        }
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        self.end();
    }
}

/// The thread with the windows.
fn run(parts: ViewerParts, shared: &Arc<Shared>, ready: &Sender<Result<(), String>>) {
    // Without the right to it everything runs at the same priority, which works too.
    let _ = rustix::process::setpriority_process(None, NICE);
    let mut builder = EventLoop::builder();
    EventLoopBuilderExtX11::with_any_thread(&mut builder, true);
    EventLoopBuilderExtWayland::with_any_thread(&mut builder, true);
    let event_loop = match builder.build() {
        Ok(event_loop) => event_loop,
        Err(error) => {
            let _ = ready.send(Err(error.to_string()));
            return;
        }
    };
    connection::survive();
    let mut app = app::App::new(parts, Arc::clone(shared), ready.clone());
    let outcome = catch_unwind(AssertUnwindSafe(|| event_loop.run_app(&mut app)));
    let why = match outcome {
        Ok(Ok(())) => return,
        Ok(Err(error)) => error.to_string(),
        Err(_) => {
            // Closing its windows would panic again.
            std::mem::forget(app);
            match connection::broke_in_this_thread() {
                true => connection::BROKEN.to_owned(),
                false => "their thread panicked, which is a bug".to_owned(),
            }
        }
    };
    let _ = ready.try_send(Err(why.clone()));
    shared.end(Ended::Lost(why));
}
