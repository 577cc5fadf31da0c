//! The windows: events, frames, and what is common to all of them.

mod actions;
mod pointer;

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_core::comm::Snapshot;
use ambf_core::ids::{BodyId, CameraId};
use ambf_core::plugin::{Drawing, Input};
use ambf_core::scene::VisualScene;
use ambf_core::sim::{Picked, WindowAnswer, WindowRequest};
use ambf_render::{Highlight, Marker, MarkerShape, Renderer, Stage, View};
use crossbeam_channel::{unbounded, Receiver, Sender};
use glutin::surface::{Surface, WindowSurface};
use nalgebra::Isometry3;
use winit::application::ApplicationHandler;
use winit::dpi::{PhysicalPosition, PhysicalSize};
use winit::event::{ElementState, KeyEvent, MouseButton, StartCause, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow};
use winit::keyboard::{KeyCode, ModifiersState, PhysicalKey};
use winit::monitor::MonitorHandle;
use winit::window::{Window, WindowId};

use crate::context::Context;
use crate::keys;
use crate::labels::{Counter, DeviceLabel, Labels};
use crate::outbox::Outbox;
use crate::panels::{PanelContext, Panels};
use crate::place::{monitor_index, title, window_area, Area};
use crate::record::{self, Video};
use crate::shown::{self, Shown};
use crate::{Ended, Shared, ViewerParts};
use pointer::Drag;

/// Time between two frames, at least: 120 Hz at most.
const FRAME: Duration = Duration::from_nanos(1_000_000_000 / 120);
/// Samples a pixel in windows, where a graphics card draws.
const SAMPLES: u32 = 4;
/// Texels from left to right of the texture of letters, at most.
const FONT_TEXELS: usize = 2048;
/// Colour of a picked body, and of the point where it was picked.
const TOMATO: [f32; 3] = [1.0, 99.0 / 255.0, 71.0 / 255.0];
const GREEN_YELLOW: [f32; 4] = [173.0 / 255.0, 1.0, 47.0 / 255.0, 1.0];
/// Pixels of that point.
const PICK_POINT: f32 = 15.0;
/// How long a message stays in the window.
const MESSAGE_TIME: Duration = Duration::from_secs(5);

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
    news: (Sender<String>, Receiver<String>),
    message: Option<(Instant, String)>,
    panels: Panels,
    screenshot: Option<CameraId>,
    video: Option<(CameraId, Video)>,
}

/// What of [`ViewerParts`] is used all the time.
pub(crate) struct Parts {
    pub hub: Arc<ambf_core::comm::Hub>,
    pub control: Arc<ambf_core::sim::Control>,
    pub models: ambf_core::sim::Models,
    pub devices: Arc<ambf_core::device::host::Controls>,
    pub board: Arc<crate::DeviceBoard>,
    hook: Option<Box<crate::FrameHook>>,
    say: Box<dyn Fn(&str) + Send>,
}

impl App {
    pub fn new(parts: ViewerParts, shared: Arc<Shared>, ready: Sender<Result<(), String>>) -> Self {
        let now = Instant::now();
        let ViewerParts { hub, link, control, models, devices, board, hook, load_report, say } = parts;
        hub.set_listening();
        Self {
            outbox: Outbox::new(link),
            parts: Parts { hub, control, models, devices, board, hook, say },
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
        }
    }

    /// Prints a line.
    fn say(&self, line: &str) {
        (self.parts.say)(line);
    }

    /// Prints a line and shows it in the windows for a while.
    fn tell(&mut self, line: String) {
        self.say(&line);
        self.message = Some((Instant::now(), line));
    }

    fn end(&mut self, event_loop: &ActiveEventLoop, how: Ended) {
        if let (Ended::Lost(why), Some(ready)) = (&how, self.ready.take()) {
            let _ = ready.try_send(Err(why.clone()));
        }
        self.shared.end(how);
        event_loop.exit();
    }

    /// Makes windows for cameras that came and closes those of cameras that went.
    fn follow_cameras(&mut self, event_loop: &ActiveEventLoop, visuals: &VisualScene) -> Result<(), String> {
        if self.seen == Some(visuals.generation) {
            return Ok(());
        }
        self.seen = Some(visuals.generation);
        let is_there = |camera: CameraId| {
            visuals.cameras.get(camera).is_some_and(|camera| !camera.object.removed && camera.description.visible)
        };
        for place in
            (0..self.windows.len()).rev().filter(|&place| !is_there(self.windows[place].camera)).collect::<Vec<_>>()
        {
            let window = self.windows.remove(place);
            self.close(window);
        }
        for camera in visuals.cameras.ids() {
            let has_window = self.windows.iter().any(|window| window.camera == camera);
            if is_there(camera) && !has_window && !self.said.contains(&camera) {
                if let Err(why) = self.open(event_loop, visuals, camera) {
                    if self.windows.is_empty() {
                        return Err(why);
                    }
                    self.said.push(camera);
                    self.say(&format!("camera {} has no window: {why}", visuals.cameras[camera].object.name));
                }
            }
        }
        Ok(())
    }

    fn close(&mut self, mut window: CameraWindow) {
        if let Some(context) = &self.context {
            if context.make_current(&window.surface).is_ok() {
                window.painter.destroy();
            }
        }
        if self.held.as_ref().is_some_and(|held| held.camera == window.camera) {
            self.let_go();
        }
        if self.video.as_ref().is_some_and(|(camera, _)| *camera == window.camera) {
            self.finish_video();
        }
    }

    fn open(&mut self, event_loop: &ActiveEventLoop, visuals: &VisualScene, camera: CameraId) -> Result<(), String> {
        let Some(context) = &self.context else { return Err("no OpenGL".into()) };
        let description = &visuals.cameras[camera].description;
        let monitors: Vec<MonitorHandle> = event_loop.available_monitors().collect();
        let (monitor, is_missing) = monitor_index(description.monitor, camera.index(), monitors.len());
        if is_missing {
            (self.parts.say)(&format!(
                "camera {}: there is no monitor {}, only {}; its window opens on monitor {monitor}",
                visuals.cameras[camera].object.name,
                description.monitor.unwrap_or_default(),
                monitors.len()
            ));
        }
        let nth = self.windows.iter().filter(|window| window.monitor == monitor).count();
        let mut attributes = Window::default_attributes()
            .with_title(title(camera.index(), &description.controlling_devices))
            .with_resizable(true);
        match monitors.get(monitor).map(area_of).filter(|area| area.width > 0 && area.height > 0) {
            Some(screen) => {
                let area = window_area(&screen, description.window_resolution, nth);
                attributes = attributes
                    .with_position(PhysicalPosition::new(area.left, area.top))
                    .with_inner_size(PhysicalSize::new(area.width, area.height));
            }
            None => attributes = attributes.with_inner_size(PhysicalSize::new(640, 480)),
        }
        let window = event_loop.create_window(context.attributes(attributes)).map_err(|error| error.to_string())?;
        let surface = context.surface(&window)?;
        context.make_current(&surface)?;
        context.swap_at_once(&surface);
        let gl = self.gl.get_or_insert_with(|| {
            // SAFETY: a context is current, whose functions the display finds.
            Arc::new(unsafe { glow::Context::from_loader_function_cstr(|name| context.find(name)) })
        });
        let painter = egui_glow::Painter::new(Arc::clone(gl), "", None, false).map_err(|error| error.to_string())?;
        let egui = egui::Context::default();
        egui.set_theme(egui::Theme::Light);
        egui.options_mut(|options| options.zoom_with_keyboard = false);
        let input = egui_winit::State::new(
            egui.clone(),
            egui::ViewportId::ROOT,
            &window,
            Some(window.scale_factor() as f32),
            None,
            // It is as wide as this allows, and it is there twice: 2 MB each where textures may have 16384 texels.
            Some(painter.max_texture_side().min(FONT_TEXELS)),
        );
        self.windows.push(CameraWindow {
            camera,
            painter,
            surface,
            window,
            egui,
            input,
            cursor: None,
            drag: None,
            labels: Labels::default(),
            pictures: Vec::new(),
            monitor,
            full_screen: None,
            has_focus: false,
            is_hidden: false,
        });
        self.windows.sort_by_key(|window| window.camera);
        Ok(())
    }

    /// Draws all windows.
    fn frame(&mut self, event_loop: &ActiveEventLoop) -> Result<(), String> {
        let Some(visuals) = self.parts.hub.visuals() else { return Ok(()) };
        self.follow_cameras(event_loop, &visuals)?;
        if let Some(ready) = self.ready.take() {
            let _ = ready.try_send(Ok(()));
        }
        let Some(snapshot) = self.parts.hub.snapshot().clone() else { return Ok(()) };
        self.hear(&visuals);
        self.drag_held(&visuals, &snapshot);
        self.panels.tick(&self.parts, &mut self.outbox, &snapshot);
        self.outbox.flush();
        self.check_full_screen();
        let Some(context) = &self.context else { return Ok(()) };
        match self.windows.first() {
            Some(window) => context.make_current(&window.surface)?,
            // Images of hidden cameras may be wanted.
            None => context.make_current_without_window()?,
        }
        if self.renderer.is_none() {
            // SAFETY: the context is current on this thread, and is so in each frame and when windows are closed;
            // nothing else uses it.
            let renderer = unsafe { Renderer::in_current_context(|name| context.find(name)) };
            self.renderer = Some(renderer.map_err(|error| error.to_string())?);
        }
        let Some(mut renderer) = self.renderer.take() else { return Ok(()) };
        let drawn = self.draw(&mut renderer, &visuals, &snapshot);
        self.renderer = Some(renderer);
        drawn?;
        // Plugins are told.
        self.outbox.post(WindowRequest::Drawn);
        Ok(())
    }

    fn draw(
        &mut self,
        renderer: &mut Renderer,
        visuals: &Arc<VisualScene>,
        snapshot: &Arc<Snapshot>,
    ) -> Result<(), String> {
        let now = Instant::now();
        self.frames.count(now);
        self.count_steps(now, snapshot);
        self.stage.highlight =
            self.held.as_ref().and_then(|held| held.body).map(|body| Highlight { body, color: TOMATO });
        for message in renderer.prepare(&mut self.stage, visuals, snapshot) {
            self.say(&message);
        }
        let foreign = self.stage.markers.len();
        self.add_markers(visuals, snapshot);
        let samples = if renderer.is_software() { 1 } else { SAMPLES };
        let drawings = self.outbox.drawings();
        let mut windows = std::mem::take(&mut self.windows);
        let mut outcome = Ok(());
        for window in windows.iter_mut().filter(|window| !window.is_hidden) {
            outcome = self.draw_window(window, renderer, visuals, snapshot, samples, &drawings);
            if outcome.is_err() {
                break;
            }
        }
        self.windows = windows;
        // What is shown for the user of the windows is not part of published pictures.
        self.stage.markers.truncate(foreign);
        outcome?;
        if let Some(hook) = &mut self.parts.hook {
            hook(renderer, &mut self.stage, visuals, snapshot);
        }
        Ok(())
    }

    fn draw_window(
        &mut self,
        window: &mut CameraWindow,
        renderer: &mut Renderer,
        visuals: &Arc<VisualScene>,
        snapshot: &Arc<Snapshot>,
        samples: u32,
        drawings: &[Arc<Vec<Drawing>>],
    ) -> Result<(), String> {
        let size = window.size();
        let (Some(camera), Some(state)) = (visuals.cameras.get(window.camera), snapshot.views.get(window.camera))
        else {
            return Ok(());
        };
        let (Some(context), Some(gl)) = (&self.context, self.gl.clone()) else { return Ok(()) };
        if size.0 == 0 || size.1 == 0 {
            return Ok(());
        }
        context.make_current(&window.surface)?;
        let view = View::of_camera(&camera.description, state);
        let common = self.stage.markers.len();
        self.stage.markers.extend(shown::markers(drawings, number(window.camera)));
        self.stage.backdrops = shown::backdrops(drawings, number(window.camera), size, &view.eyes(size.0, size.1));
        let drawn = renderer.draw(&mut self.stage, &view, size, samples, self.switches.mirrored);
        self.stage.markers.truncate(common);
        self.stage.backdrops.clear();
        if let Err(error) = drawn {
            // A window that is too narrow for two eyes is no reason to end.
            if !matches!(error, ambf_render::RenderError::Size { .. }) {
                return Err(error.to_string());
            }
        }
        if !self.switches.labels_stand {
            window.labels = self.labels(camera, snapshot);
        }
        let (eyes, mirrored) = (view.eyes(size.0, size.1), self.switches.mirrored);
        let plugins = Shown { drawings, window: number(window.camera), size, eyes, mirrored };
        self.draw_texts(window, &gl, size, visuals, snapshot, &plugins);
        if self.screenshot == Some(window.camera) {
            self.screenshot = None;
            record::save(record::read(&gl, size), record::free_name("png"), self.news.0.clone());
        }
        self.film(window.camera, &gl, size);
        window.window.pre_present_notify();
        match &self.context {
            Some(context) => context.swap(&window.surface),
            None => Ok(()),
        }
    }

    /// Labels, texts of plugins, messages, help and panels.
    fn draw_texts(
        &mut self,
        window: &mut CameraWindow,
        gl: &glow::Context,
        size: (u32, u32),
        visuals: &Arc<VisualScene>,
        snapshot: &Arc<Snapshot>,
        plugins: &Shown<'_>,
    ) {
        let raw = window.input.take_egui_input(&window.window);
        let egui = window.egui.clone();
        let (labels, pictures) = (&window.labels, &mut window.pictures);
        let (help, camera) = (self.switches.help, window.camera);
        let message =
            self.message.as_ref().filter(|(since, _)| since.elapsed() < MESSAGE_TIME).map(|(_, text)| text.clone());
        let panels = &mut self.panels;
        let mut wishes = PanelContext {
            parts: &self.parts,
            stage: &mut self.stage,
            visuals,
            snapshot,
            camera,
            picked: &mut self.last_picked,
            messages: Vec::new(),
            actions: Vec::new(),
            load: Vec::new(),
            remove: Vec::new(),
            requests: Vec::new(),
            span: self.outbox.span(),
        };
        let output = egui.run(raw, |ui| {
            let painter = ui.layer_painter(egui::LayerId::background());
            plugins.paint_pictures(&painter, pictures, ui.pixels_per_point());
            labels.paint(&painter, size, ui.pixels_per_point());
            plugins.paint_texts(&painter, ui.pixels_per_point());
            if let Some(text) = &message {
                show_message(ui, text);
            }
            if help {
                show_help(ui);
            }
            panels.show(ui, &mut wishes);
        });
        let PanelContext { messages, actions, load, remove, requests, .. } = wishes;
        window.input.handle_platform_output(&window.window, output.platform_output);
        let shapes = window.egui.tessellate(output.shapes, output.pixels_per_point);
        // SAFETY: the context is current in this thread.
        unsafe {
            use glow::HasContext;
            gl.bind_framebuffer(glow::FRAMEBUFFER, None);
        }
        window.painter.paint_and_update_textures(
            [size.0, size.1],
            output.pixels_per_point,
            &shapes,
            &output.textures_delta,
        );
        requests.into_iter().for_each(|request| self.outbox.post(request));
        messages.into_iter().for_each(|message| self.tell(message));
        actions.into_iter().for_each(|action| self.act(action, camera));
        self.change_models(remove, load);
    }

    /// Removes models, then loads files, in a thread of its own: reading may take long, and windows go on meanwhile.
    fn change_models(&mut self, remove: Vec<Arc<str>>, load: Vec<PathBuf>) {
        if remove.is_empty() && load.is_empty() {
            return;
        }
        let (models, done) = (self.parts.models.clone(), self.news.0.clone());
        let work = move || {
            for key in remove {
                let _ = done.send(match models.remove(&key) {
                    Ok(key) => format!("removed {key}"),
                    Err(error) => error.to_string(),
                });
            }
            for file in load {
                let _ = done.send(match models.add(&file) {
                    Ok(added) if added.report.is_empty() => format!("added {} from {}", added.key, file.display()),
                    Ok(added) => format!("added {} from {}:\n{}", added.key, file.display(), added.report),
                    Err(error) => format!("{} is not added: {error}", file.display()),
                });
            }
        };
        if let Err(error) = std::thread::Builder::new().name("models".into()).spawn(work) {
            self.tell(format!("models are not changed: {error}"));
        }
    }

    fn labels(&self, camera: &ambf_core::scene::VisualCamera, snapshot: &Snapshot) -> Labels {
        let news = self.parts.board.read();
        let name = &*camera.object.name;
        let is_named =
            |names: &[String]| names.iter().any(|other| other == name || camera.object.identifier.ends_with(&**other));
        let devices = news.devices.iter().filter(|device| device.cameras.is_empty() || is_named(&device.cameras));
        let action = if news.action.is_empty() { self.action.clone() } else { news.action };
        Labels {
            graphics: self.frames.rate(),
            physics: self.steps.rate,
            wall_time: self.parts.hub.now().as_secs_f64() + self.wall_offset,
            sim_time: snapshot.sim_time,
            mode: self.parts.devices.switches().mode.name(),
            action,
            controlling: camera.description.controlling_devices.clone(),
            devices: devices
                .map(|device| DeviceLabel {
                    name: device.name.clone(),
                    model: device.model.clone(),
                    rate: device.loops.latest,
                })
                .collect(),
            paused: self.parts.control.is_paused(),
        }
    }

    fn count_steps(&mut self, now: Instant, snapshot: &Snapshot) {
        let open = now.saturating_duration_since(self.steps.start).as_secs_f64();
        if open >= 1.0 {
            let steps = snapshot.sim_step.wrapping_sub(self.steps.step);
            self.steps = StepRate { start: now, step: snapshot.sim_step, rate: f64::from(steps) / open };
        }
        if snapshot.sim_step != self.frame_of_wall {
            self.frame_of_wall = snapshot.sim_step;
            self.wall_offset = snapshot.wall_time - self.parts.hub.now().as_secs_f64();
        }
    }

    fn add_markers(&mut self, visuals: &VisualScene, snapshot: &Snapshot) {
        if let Some(goal) = self.goal(visuals, snapshot) {
            let at = goal.map(|x| x as f32).into();
            self.stage.markers.push(Marker {
                shape: MarkerShape::Points(vec![at], PICK_POINT),
                pose: Isometry3::identity(),
                color: GREEN_YELLOW,
            });
        }
        self.panels.add_markers(&mut self.stage, visuals, snapshot);
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
        while let Ok(line) = self.news.1.try_recv() {
            self.tell(line);
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
        if let Some(action) = keys::action(key, self.modifiers) {
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

fn area_of(monitor: &MonitorHandle) -> Area {
    let (place, size) = (monitor.position(), monitor.size());
    Area { left: place.x, top: place.y, width: size.width, height: size.height }
}

fn show_message(ui: &egui::Context, text: &str) {
    let place = egui::Area::new("message".into()).anchor(egui::Align2::LEFT_BOTTOM, [10.0, -80.0]);
    place.interactable(false).show(ui, |ui| {
        egui::Frame::popup(ui.style()).show(ui, |ui| ui.label(text));
    });
}

fn show_help(ui: &egui::Context) {
    let place = egui::Area::new("help".into()).anchor(egui::Align2::CENTER_CENTER, [0.0, 0.0]);
    place.interactable(false).show(ui, |ui| {
        let paper = egui::Color32::from_white_alpha(225);
        egui::Frame::popup(ui.style()).fill(paper).show(ui, |ui| {
            // In two columns, so that it fits into windows as they open.
            let half = keys::HELP.len().div_ceil(2);
            ui.horizontal_top(|ui| {
                for (column, rows) in keys::HELP.chunks(half).enumerate() {
                    egui::Grid::new(("keys", column)).spacing([10.0, 0.0]).min_row_height(0.0).show(ui, |ui| {
                        for (key, what) in rows {
                            ui.label(egui::RichText::new(*key).small().strong());
                            ui.label(egui::RichText::new(*what).small());
                            ui.end_row();
                        }
                    });
                }
            });
        });
    });
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
        if let Some((_, video)) = self.video.take() {
            let line = video.finish();
            self.say(&line);
        }
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

#[cfg(test)]
mod tests {
    use std::path::Path;

    use nalgebra::Vector3;

    use super::actions::is_model_file;
    use super::pointer::pointer_ray;
    use super::*;

    /// A ball of 0.05 m with its centre at `point` is what the ray under the pixel where that is seen meets.
    #[test]
    fn row_58_the_body_under_the_pointer_is_picked_in_stereo_orthographic_and_mirrored_views() {
        use ambf_render::{Projection, Stereo};
        let pose = Isometry3::new(Vector3::new(2.0, 0.1, 0.3), Vector3::new(0.1, 0.05, -0.05));
        let size = (641, 480);
        let perspective = View { pose, near: 0.1, far: 10.0, projection: Projection::Perspective(1.4), stereo: None };
        let stereo = View { stereo: Some(Stereo { separation: 0.2, focal_length: 1.5 }), ..perspective };
        let orthographic = View { projection: Projection::Orthographic(3.0), ..perspective };
        let points = [[0.0, 0.1, 0.2], [-0.5, -0.3, 0.1], [0.4, 0.3, 0.0]].map(Vector3::from);
        for (view, eyes) in [(perspective, 1), (stereo, 2), (orthographic, 1)] {
            assert_eq!(view.eyes(size.0, size.1).len(), eyes);
            for (mirrored, point) in [false, true].iter().flat_map(|m| points.iter().map(move |p| (*m, *p))) {
                for eye in view.eyes(size.0, size.1) {
                    // Where the renderer puts the point: projection, then the part of the window that the eye has, from
                    // the upper edge; mirrored windows count from the lower one.
                    let clip = eye.projection * eye.view * point.push(1.0);
                    let (x, y) = (clip.x / clip.w, clip.y / clip.w);
                    assert!(x.abs() < 0.99 && y.abs() < 0.99, "in the picture");
                    let up = if mirrored { -y } else { y };
                    let pointer = PhysicalPosition {
                        x: f64::from(eye.left) + 0.5 * (x + 1.0) * f64::from(eye.width),
                        y: 0.5 * (1.0 - up) * f64::from(eye.height),
                    };
                    let distance = |mirrored| {
                        let (origin, direction) = pointer_ray(&view, size, pointer, mirrored);
                        assert!((direction.norm() - 1.0).abs() < 1e-12);
                        assert!(direction.dot(&(point - origin)) > 0.0, "ahead");
                        (point - origin).cross(&direction).norm()
                    };
                    assert!(distance(mirrored) < 1e-6, "{view:?} {mirrored}: {}", distance(mirrored));
                    let is_off_centre = y.abs() > 0.1;
                    assert!(!is_off_centre || distance(!mirrored) > 0.05, "the other way up it is another body");
                }
            }
        }
    }

    #[test]
    fn row_67_only_models_may_be_dropped() {
        for name in ["a.yaml", "b.YAML", "/x/c.ambf", "d.e.AMBF"] {
            assert!(is_model_file(Path::new(name)), "{name}");
        }
        for name in ["a.txt", "yaml", "a.Yaml", "a.yml", ""] {
            assert!(!is_model_file(Path::new(name)), "{name}");
        }
    }
}
