//! A frame: what is drawn in all windows, and over it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_core::comm::Snapshot;
use ambf_core::plugin::Drawing;
use ambf_core::scene::VisualScene;
use ambf_core::sim::WindowRequest;
use ambf_render::{Highlight, Marker, MarkerShape, Renderer, View};
use nalgebra::Isometry3;
use winit::event_loop::ActiveEventLoop;

use super::{number, App, CameraWindow, StepRate};
use crate::keys;
use crate::labels::{DeviceLabel, Labels};
use crate::panels::PanelContext;
use crate::record;
use crate::shown::{self, Shown};

/// Samples a pixel in windows, where a graphics card draws.
const SAMPLES: u32 = 4;
/// Colour of a picked body, and of the point where it was picked.
const TOMATO: [f32; 3] = [1.0, 99.0 / 255.0, 71.0 / 255.0];
const GREEN_YELLOW: [f32; 4] = [173.0 / 255.0, 1.0, 47.0 / 255.0, 1.0];
/// Pixels of that point.
const PICK_POINT: f32 = 15.0;
/// How long a message stays in the window.
const MESSAGE_TIME: Duration = Duration::from_secs(5);

impl App {
    /// Draws all windows.
    pub(super) fn frame(&mut self, event_loop: &ActiveEventLoop) -> Result<(), String> {
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
        // Plugins are notified.
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
            let file = self.names.next("png");
            if let Some(thread) = record::save(record::read(&gl, size), file, self.news.0.clone()) {
                self.note_writer(thread);
            }
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
