//! Windows of cameras: opened and closed as cameras come and go.

use std::sync::Arc;

use ambf_core::ids::CameraId;
use ambf_core::scene::VisualScene;
use winit::dpi::{PhysicalPosition, PhysicalSize};
use winit::event_loop::ActiveEventLoop;
use winit::monitor::MonitorHandle;
use winit::window::Window;

use super::{App, CameraWindow};
use crate::labels::Labels;
use crate::place::{monitor_index, title, window_area, Area};

/// Texels from left to right of the texture of letters, at most.
const FONT_TEXELS: usize = 2048;

impl App {
    /// Makes windows for cameras that came and closes those of cameras that went.
    pub(super) fn follow_cameras(&mut self, event_loop: &ActiveEventLoop, visuals: &VisualScene) -> Result<(), String> {
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

    pub(super) fn close(&mut self, mut window: CameraWindow) {
        if let Some(context) = &self.context {
            if context.make_current(&window.surface).is_ok() {
                window.painter.destroy();
            }
        }
        if self.held.as_ref().is_some_and(|held| held.camera == window.camera) {
            self.release_held();
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
            self.say(&format!(
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
}

fn area_of(monitor: &MonitorHandle) -> Area {
    let (place, size) = (monitor.position(), monitor.size());
    Area { left: place.x, top: place.y, width: size.width, height: size.height }
}
