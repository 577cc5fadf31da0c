//! Windows of a world.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Weak};
use std::thread::JoinHandle;
use std::time::Duration;

use ambf_core::device::host::Controls;
use ambf_core::device::law::Switches;
use ambf_core::sim::{Control, StepperWindow};
use ambf_viewer::{Viewer, ViewerError, ViewerParts};
use parking_lot::Mutex;

use crate::world::Slot;

/// How often what is done in a window is done in the simulation while nobody steps it.
const SERVICE: Duration = Duration::from_millis(8);

/// The open windows of a world. Dropping it closes them.
pub struct Windows {
    viewer: Option<Viewer>,
    control: Arc<Control>,
    stop: Arc<AtomicBool>,
    service: Option<JoinHandle<()>>,
    /// The process whose threads draw.
    process: u32,
}

impl Windows {
    /// Opens a window for each visible camera of the world in `slot`, whose sentences go to `said`.
    pub fn open(
        window: StepperWindow,
        slot: Weak<Mutex<Slot>>,
        load_report: String,
        said: Arc<Mutex<Vec<String>>>,
    ) -> Result<Self, ViewerError> {
        let control = Arc::clone(&window.control);
        let viewer = Viewer::start(ViewerParts {
            hub: window.hub,
            link: window.link,
            control: window.control,
            models: window.models,
            devices: Arc::new(Controls::new(Switches::default())),
            board: Arc::default(),
            hook: None,
            record: None,
            load_report,
            say: Box::new(move |line| said.lock().push(line.text.clone())),
        })?;
        let stop = Arc::<AtomicBool>::default();
        let own = Arc::clone(&stop);
        let serve = move || {
            while !own.load(Ordering::Acquire) {
                let Some(slot) = slot.upgrade() else { break };
                // Who steps has taken the physics away, and serves the windows himself.
                if let Slot::Here(physics) = &mut *slot.lock() {
                    physics.stepper.serve_window();
                }
                drop(slot);
                std::thread::sleep(SERVICE);
            }
        };
        // Without it the windows are served by the steps alone.
        let service = std::thread::Builder::new().name("ambf-window".into()).spawn(serve).ok();
        Ok(Self { viewer: Some(viewer), control, stop, service, process: std::process::id() })
    }

    /// Whether nobody has closed them.
    pub fn are_open(&self) -> bool {
        self.is_ours() && self.viewer.as_ref().is_some_and(|viewer| viewer.ended().is_none())
    }

    /// Whether the user wants the simulation to wait; single steps that he wants are taken by this.
    pub fn hold(&self) -> bool {
        self.are_open() && self.control.is_paused() && !self.control.take_manual_step()
    }

    /// Whether the next step is a single one.
    pub fn is_paused(&self) -> bool {
        self.are_open() && self.control.is_paused()
    }

    /// In a process that was forked there are no such threads.
    fn is_ours(&self) -> bool {
        self.process == std::process::id()
    }
}

impl Drop for Windows {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if !self.is_ours() {
            std::mem::forget(self.viewer.take());
            std::mem::forget(self.service.take());
            return;
        }
        drop(self.viewer.take());
        if let Some(service) = self.service.take() {
            let _ = service.join();
        }
    }
}
