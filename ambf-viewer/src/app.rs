//! The windows: events, frames, and what is common to all of them.

mod actions;
mod frame;
mod pointer;
mod windows;

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use ambf_core::ids::{BodyId, CameraId};
use ambf_core::plugin::Input;
use ambf_core::scene::VisualScene;
use ambf_core::sim::{Picked, WindowAnswer, WindowRequest};
use ambf_render::{Renderer, Stage};
use crossbeam_channel::{unbounded, Receiver, Sender};
use glutin::surface::{Surface, WindowSurface};
use winit::application::ApplicationHandler;
use winit::dpi::{PhysicalPosition, PhysicalSize};
use winit::event::{ElementState, KeyEvent, MouseButton, StartCause, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow};
use winit::keyboard::{KeyCode, ModifiersState, PhysicalKey};
use winit::window::{Window, WindowId};

use crate::context::Context;
use crate::keys;
use crate::labels::{Counter, Labels};
use crate::outbox::Outbox;
use crate::panels::Panels;
use crate::record::{Names, Video};
use crate::shown;
use crate::{Ended, Said, Shared, ViewerParts};
use pointer::Drag;

/// Time between two frames, at least: 120 Hz at most.
const FRAME: Duration = Duration::from_nanos(1_000_000_000 / 120);

/// A window, with the place that it had before it filled the screen.
#[derive(Debug, Clone, Copy)]
struct FullScreen {
    since: Instant,
    place: Option<PhysicalPosition<i32>>,
    size: PhysicalSize<u32>,
    /// It was done without a window manager.
    forced: bool,
}

/// The window of a camera.
pub(crate) struct CameraWindow {
    /// Index of the camera.
    pub camera: CameraId,
    painter: egui_glow::Painter,
    // Goes before the window.
    surface: Surface<WindowSurface>,
    window: Window,
    pub egui: egui::Context,
    input: egui_winit::State,
    /// Pixels from the upper left corner; `None` before the pointer was seen.
    cursor: Option<PhysicalPosition<f64>>,
    drag: Option<(MouseButton, Drag)>,
    labels: Labels,
    /// Pictures of plugins.
    pictures: shown::Pictures,
    monitor: usize,
    full_screen: Option<FullScreen>,
    has_focus: bool,
    is_hidden: bool,
}

impl CameraWindow {
    fn size(&self) -> (u32, u32) {
        let size = self.window.inner_size();
        (size.width, size.height)
    }
}

/// What is held by the mouse.
#[derive(Debug, Clone)]
struct Held {
    camera: CameraId,
    body: Option<BodyId>,
    /// From the eye, m.
    distance: f64,
}

/// States of keys, common to all windows.
#[derive(Debug, Default)]
struct Switches {
    picking: bool,
    mirrored: bool,
    inverted: bool,
    full_screen: bool,
    labels_stand: bool,
    help: bool,
}

/// Counts physics iterations of the last full second.
#[derive(Debug)]
struct StepRate {
    start: Instant,
    step: u32,
    rate: f64,
}

/// All windows.
pub(crate) struct App {
    outbox: Outbox,
    parts: Parts,
    shared: Arc<Shared>,
    ready: Option<Sender<Result<(), String>>>,
    windows: Vec<CameraWindow>,
    renderer: Option<Renderer>,
    gl: Option<Arc<glow::Context>>,
    context: Option<Context>,
    stage: Stage,
    /// Cameras that windows were made for, by the generation of the scene.
    seen: Option<u64>,
    /// Cameras whose windows could not be made, or whose monitors are missing, which was said.
    said: Vec<CameraId>,
    next_frame: Instant,
    frames: Counter,
    steps: StepRate,
    switches: Switches,
    modifiers: ModifiersState,
    left_shift: bool,
    /// Camera of the pick that waits for its answer.
    picking: Option<CameraId>,
    held: Option<Held>,
    /// Index and qualified identifier of the body that was picked last.
    last_picked: Option<(BodyId, String)>,
    action: String,
    /// Wall time of the simulation minus the hub's clock, s.
    wall_offset: f64,
    frame_of_wall: u32,
    news: (Sender<Said>, Receiver<Said>),
    message: Option<(Instant, String)>,
    panels: Panels,
    screenshot: Option<CameraId>,
    video: Option<(CameraId, Video)>,
    names: Names,
    /// Threads that complete pictures and videos.
    writers: Vec<JoinHandle<()>>,
}

/// What of [`ViewerParts`] is used all the time.
pub(crate) struct Parts {
    pub hub: Arc<ambf_core::comm::Hub>,
    pub control: Arc<ambf_core::sim::Control>,
    pub models: ambf_core::sim::Models,
    pub devices: Arc<ambf_core::device::host::Controls>,
    pub board: Arc<crate::DeviceBoard>,
    hook: Option<Box<crate::FrameHook>>,
    record: Option<Arc<crate::RecordSwitch>>,
    say: Box<dyn Fn(&Said) + Send>,
}

impl App {
    pub fn new(parts: ViewerParts, shared: Arc<Shared>, ready: Sender<Result<(), String>>) -> Self {
        let now = Instant::now();
        let ViewerParts { hub, link, control, models, devices, board, hook, record, load_report, say } = parts;
        hub.set_listening();
        Self {
            outbox: Outbox::new(link),
            parts: Parts { hub, control, models, devices, board, hook, record, say },
            shared,
            ready: Some(ready),
            windows: Vec::new(),
            renderer: None,
            gl: None,
            context: None,
            stage: Stage::default(),
            seen: None,
            said: Vec::new(),
            next_frame: now,
            frames: Counter::new(now),
            steps: StepRate { start: now, step: 0, rate: 0.0 },
            switches: Switches::default(),
            modifiers: ModifiersState::empty(),
            left_shift: false,
            picking: None,
            held: None,
            last_picked: None,
            action: String::new(),
            wall_offset: 0.0,
            frame_of_wall: 0,
            news: unbounded(),
            message: None,
            panels: Panels::new(load_report),
            screenshot: None,
            video: None,
            names: Names::default(),
            writers: Vec::new(),
        }
    }

    /// Prints a line.
    fn say(&self, line: &str) {
        (self.parts.say)(&Said::well(line.to_owned()));
    }

    /// Prints a line and shows it in the windows for a while.
    fn tell(&mut self, line: String) {
        self.pass_on(Said::well(line));
    }

    /// The same for a failure, too.
    fn pass_on(&mut self, said: Said) {
        (self.parts.say)(&said);
        self.message = Some((Instant::now(), said.text));
    }

    fn end(&mut self, event_loop: &ActiveEventLoop, how: Ended) {
        if let (Ended::Lost(why), Some(ready)) = (&how, self.ready.take()) {
            let _ = ready.try_send(Err(why.clone()));
        }
        self.shared.end(how);
        event_loop.exit();
    }

    /// Removes models, then loads files, in a thread of its own: reading may take long, and windows go on meanwhile.
    fn change_models(&mut self, remove: Vec<Arc<str>>, load: Vec<PathBuf>) {
        if remove.is_empty() && load.is_empty() {
            return;
        }
        let (models, done) = (self.parts.models.clone(), self.news.0.clone());
        let work = move || {
            for key in remove {
                let _ = done.send(Said::well(match models.remove(&key) {
                    Ok(key) => format!("removed {key}"),
                    Err(error) => error.to_string(),
                }));
            }
            for file in load {
                let _ = done.send(Said::well(match models.add(&file) {
                    Ok(added) if added.report.is_empty() => format!("added {} from {}", added.key, file.display()),
                    Ok(added) => format!("added {} from {}:\n{}", added.key, file.display(), added.report),
                    Err(error) => format!("{} is not added: {error}", file.display()),
                }));
            }
        };
        if let Err(error) = std::thread::Builder::new().name("models".into()).spawn(work) {
            self.tell(format!("models are not changed: {error}"));
        }
    }

    /// Takes what came of requests, and what threads have to say.
    fn hear(&mut self, visuals: &VisualScene) {
        while let Some(answer) = self.outbox.answer() {
            match answer {
                WindowAnswer::Picked(picked) => {
                    // The button may be up by now.
                    let Some(camera) = self.picking.take() else { continue };
                    match picked {
                        Picked::Nothing => (),
                        Picked::Body { body, name, distance, .. } => {
                            self.say(&format!("User picked AF rigid body: {name}"));
                            let identifier = visuals.bodies.get(body).map(|body| body.object.identifier.to_string());
                            self.last_picked = Some((body, identifier.unwrap_or_default()));
                            self.held = Some(Held { camera, body: Some(body), distance });
                        }
                        Picked::Node { name, distance, .. } => {
                            self.say(&format!("User picked AF soft body: {name}"));
                            self.held = Some(Held { camera, body: None, distance });
                        }
                    }
                }
                WindowAnswer::Removed(Ok(name)) => self.tell(format!("removed body {name}")),
                WindowAnswer::Removed(Err(why)) | WindowAnswer::NoHistory(why) => self.tell(why),
                _ => (),
            }
        }
        self.hear_threads();
    }

    fn hear_threads(&mut self) {
        while let Ok(said) = self.news.1.try_recv() {
            self.pass_on(said);
        }
    }

    fn on_key(&mut self, camera: CameraId, event: &KeyEvent) {
        let PhysicalKey::Code(key) = event.physical_key else { return };
        if key == KeyCode::ShiftLeft {
            self.left_shift = event.state == ElementState::Pressed;
        }
        if event.state == ElementState::Released {
            return;
        }
        let action = keys::action(key, self.modifiers);
        // What begins and ends a file does so once, however long its keys are held.
        if let Some(action) =
            action.filter(|it| !(event.repeat && matches!(it, keys::Action::Record | keys::Action::Video)))
        {
            self.act(action, camera);
        }
        self.forward(Input::Key {
            window: number(camera),
            key: keys::glfw_key(key),
            scancode: winit::platform::scancode::PhysicalKeyExtScancode::to_scancode(event.physical_key)
                .map_or(-1, |scancode| scancode as i32),
            action: if event.repeat { 2 } else { 1 },
            mods: keys::glfw_modifiers(self.modifiers),
        });
    }
}

/// Number of the window of a camera, as its title says.
fn number(camera: CameraId) -> u32 {
    u32::try_from(camera.index() + 1).unwrap_or(u32::MAX)
}

impl ApplicationHandler for App {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.context.is_none() {
            match Context::new(event_loop) {
                Ok(context) => self.context = Some(context),
                Err(why) => self.end(event_loop, Ended::Lost(why)),
            }
        }
    }

    fn new_events(&mut self, _: &ActiveEventLoop, _: StartCause) {}

    fn window_event(&mut self, event_loop: &ActiveEventLoop, id: WindowId, event: WindowEvent) {
        let Some(place) = self.windows.iter().position(|window| window.window.id() == id) else { return };
        let window = &mut self.windows[place];
        let camera = window.camera;
        // Panels see events first; what they use goes no further.
        let is_used = window.input.on_window_event(&window.window, &event).consumed && self.panels.are_open(camera);
        let wants_keys = window.egui.wants_keyboard_input();
        let is_over_panel = window.egui.wants_pointer_input();
        match event {
            WindowEvent::CloseRequested => self.end(event_loop, Ended::Closed),
            WindowEvent::Resized(_) | WindowEvent::ScaleFactorChanged { .. } => {
                if let Some(context) = &self.context {
                    context.resize(&window.surface, &window.window);
                }
            }
            WindowEvent::Occluded(hidden) => window.is_hidden = hidden,
            WindowEvent::Focused(focus) => {
                window.has_focus = focus;
                if !focus {
                    self.left_shift = false;
                }
            }
            WindowEvent::ModifiersChanged(modifiers) => {
                self.modifiers = modifiers.state();
                self.left_shift &= self.modifiers.shift_key();
            }
            WindowEvent::KeyboardInput { event, is_synthetic: false, .. } if !wants_keys && !is_used => {
                self.on_key(camera, &event);
                if self.shared.ended.lock().is_some() {
                    event_loop.exit();
                }
            }
            WindowEvent::CursorMoved { position, .. } => self.on_motion(place, position),
            WindowEvent::MouseInput { state, button, .. } => {
                self.on_button(place, button, state, is_used || is_over_panel)
            }
            WindowEvent::MouseWheel { delta, .. } if !is_used && !is_over_panel => self.on_wheel(place, delta),
            WindowEvent::DroppedFile(file) => self.load(file),
            _ => (),
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        if self.shared.stop.load(Ordering::Acquire) {
            return self.end(event_loop, Ended::Closed);
        }
        let now = Instant::now();
        if now >= self.next_frame {
            self.next_frame = (self.next_frame + FRAME).max(now);
            if let Err(why) = self.frame(event_loop) {
                return self.end(event_loop, Ended::Lost(why));
            }
        }
        event_loop.set_control_flow(ControlFlow::WaitUntil(self.next_frame));
    }

    fn exiting(&mut self, _: &ActiveEventLoop) {
        self.shared.writes.store(true, Ordering::Release);
        self.finish_video();
        // A panic was printed, and is nothing to wait for.
        std::mem::take(&mut self.writers).into_iter().for_each(|writer| drop(writer.join()));
        self.hear_threads();
        self.shared.writes.store(false, Ordering::Release);
        self.outbox.post(WindowRequest::Release);
        // What was made in the context goes while it is current.
        let is_current = match (&self.context, self.windows.first()) {
            (Some(context), Some(window)) => context.make_current(&window.surface).is_ok(),
            (Some(context), None) => context.make_current_without_window().is_ok(),
            (None, _) => false,
        };
        let (renderer, stage) = (self.renderer.take(), std::mem::take(&mut self.stage));
        match is_current {
            true => drop((stage, renderer)),
            // The context is lost, and all that was in it.
            false => std::mem::forget((stage, renderer)),
        }
        for window in std::mem::take(&mut self.windows) {
            self.close(window);
        }
    }
}
