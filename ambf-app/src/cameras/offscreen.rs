//! Pictures without a window.

use std::io;
use std::sync::mpsc::{channel, Receiver, RecvTimeoutError};
use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_core::comm::Hub;
use ambf_render::{Renderer, Stage};
use ros_node::Stop;

use super::service::CameraService;
use crate::report;

/// Shortest time from frame to frame: 120 Hz, as in the C++ program.
const FRAME: Duration = Duration::from_nanos(1_000_000_000 / 120);

/// How far frames may be behind and still catch up.
const MAX_DELAY: Duration = Duration::from_millis(100);

/// How often it looks whether somebody subscribes, while nobody does.
const GLANCE: Duration = Duration::from_millis(50);

/// How long the renderer is kept for the next subscriber.
const KEPT: Duration = Duration::from_secs(5);

/// How long it is until a renderer that could not be made is tried again.
const RETRY: Duration = Duration::from_secs(2);

/// How long [`OffscreenCameras::stop`] waits for a picture that is being drawn.
const STOP_TIMEOUT: Duration = Duration::from_secs(5);

/// Priority of the thread (`nice`): drawing takes what physics leaves.
const NICE: i32 = 10;

/// A thread that renders for cameras where there is no window. It makes a renderer when somebody subscribes, and gives
/// it back 5 s after the last subscriber has gone; without subscribers there is no graphics context. Frames come at 120
/// Hz at most, and later if drawing takes longer. Dropping it stops it.
pub struct OffscreenCameras {
    stop: Arc<Stop>,
    ended: Receiver<()>,
}

impl OffscreenCameras {
    /// Starts the thread. Where no renderer can be made, that is reported, with advice, and everything else goes on.
    ///
    /// # Errors
    /// When no thread can be made.
    pub fn start(hub: Arc<Hub>, service: CameraService) -> io::Result<Self> {
        let stop = Arc::<Stop>::default();
        let (alive, ended) = channel::<()>();
        let worker = Worker { hub, service, stop: Arc::clone(&stop), drawing: None, trouble: String::new() };
        std::thread::Builder::new().name("cameras".into()).spawn(move || {
            let _alive = alive;
            worker.run();
        })?;
        Ok(Self { stop, ended })
    }

    /// Ends the thread; waits 5 s at most.
    pub fn stop(self) {
        drop(self);
    }
}

impl Drop for OffscreenCameras {
    fn drop(&mut self) {
        self.stop.stop();
        if self.ended.recv_timeout(STOP_TIMEOUT) == Err(RecvTimeoutError::Timeout) {
            report!("cameras: a picture takes longer than {} s; ended without it", STOP_TIMEOUT.as_secs());
        }
    }
}

struct Worker {
    hub: Arc<Hub>,
    service: CameraService,
    stop: Arc<Stop>,
    drawing: Option<(Renderer, Stage)>,
    /// Why there is no renderer, as it was reported.
    trouble: String,
}

impl Worker {
    fn run(mut self) {
        // Threads that OpenGL starts inherit it. Nobody may be refused a lower priority.
        let _ = rustix::process::setpriority_process(None, NICE);
        let mut idle_since = Instant::now();
        let mut next = Instant::now();
        let mut retry_at = Instant::now();
        while !self.stop.is_stopped() {
            if !self.service.is_wanted() {
                if idle_since.elapsed() > KEPT {
                    self.drawing = None;
                }
                self.stop.wait(GLANCE);
                continue;
            }
            idle_since = Instant::now();
            if retry_at > idle_since {
                self.stop.wait(GLANCE);
                continue;
            }
            if !self.has_renderer() {
                retry_at = idle_since + RETRY;
                continue;
            }
            self.frame();
            // A picture that took longer than a frame is caught up with in frames in which none is due, so that every
            // fourth of 120 frames a second is 30 pictures a second.
            let now = Instant::now();
            next = if now > next + MAX_DELAY { now } else { next + FRAME };
            self.stop.wait(next.saturating_duration_since(now));
        }
    }

    /// Makes a renderer if there is none.
    fn has_renderer(&mut self) -> bool {
        if self.drawing.is_some() {
            return true;
        }
        match Renderer::offscreen() {
            Ok(renderer) => {
                let how = if renderer.is_software() { ", on the processor" } else { "" };
                report!("cameras: drawn by {}{how}", renderer.device());
                self.drawing = Some((renderer, Stage::default()));
                true
            }
            Err(error) => {
                let error = error.to_string();
                if error != self.trouble {
                    report!("cameras: {error}; everything else goes on");
                    self.trouble = error;
                }
                false
            }
        }
    }

    fn frame(&mut self) {
        let Some((renderer, stage)) = &mut self.drawing else { return };
        if !self.service.is_due() {
            return self.service.pass();
        }
        // Before the first step nothing is anywhere.
        let Some(snapshot) = self.hub.snapshot().clone() else { return };
        let Some(visuals) = self.hub.visuals() else { return };
        let messages = renderer.prepare(stage, &visuals, &snapshot);
        messages.iter().for_each(|message| report!("{message}"));
        self.service.frame(renderer, stage, &visuals, &snapshot);
    }
}
