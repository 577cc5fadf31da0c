//! What keys and panels order: switches, pictures and videos, the full screen, files.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use ambf_core::device::law::{GainChange, Quantity, RotationRule, Status};
use ambf_core::ids::CameraId;
use ambf_core::sim::WindowRequest;
use nalgebra::Vector3;
use winit::window::Fullscreen;

use super::{App, FullScreen};
use crate::keys::{self, Action};
use crate::record::{self, Video};
use crate::{Ended, Said};

/// How long a window manager may take to fill the screen, before it is done without one.
const FULL_SCREEN_TIMEOUT: Duration = Duration::from_millis(400);

impl App {
    pub(super) fn film(&mut self, camera: CameraId, gl: &glow::Context, size: (u32, u32)) {
        let Some((filmed, video)) = &mut self.video else { return };
        if *filmed != camera {
            return;
        }
        if video.is_broken() || !video.fits(size) {
            self.finish_video();
        } else if video.wants(size, Instant::now()) {
            video.add(record::read(gl, size));
        }
    }

    /// Ends the video, in a thread of its own.
    pub(super) fn finish_video(&mut self) {
        let Some((_, video)) = self.video.take() else { return };
        let done = self.news.0.clone();
        let finish = move || {
            let _ = done.send(video.finish());
        };
        match std::thread::Builder::new().name("video end".into()).spawn(finish) {
            Ok(thread) => self.note_writer(thread),
            Err(error) => self.pass_on(Said::failure(format!("the end of the video is not known: {error}"))),
        }
    }

    /// Keeps a thread that completes a file, to be waited for at the end.
    pub(super) fn note_writer(&mut self, thread: JoinHandle<()>) {
        self.writers.retain(|writer| !writer.is_finished());
        self.writers.push(thread);
    }

    pub(super) fn switch_video(&mut self, camera: CameraId) {
        if self.video.is_some() {
            return self.finish_video();
        }
        let Some(window) = self.windows.iter().find(|window| window.camera == camera) else { return };
        match Video::start(self.names.next("mp4"), window.size()) {
            Ok(video) => {
                let line = format!("video begins: {}", video.file.display());
                self.video = Some((camera, video));
                self.tell(line);
            }
            Err(why) => self.pass_on(Said::failure(why)),
        }
    }

    /// Begins or ends a recording, in a thread of its own: files are read for it, and written.
    pub(super) fn switch_recording(&mut self) {
        let Some(record) = self.parts.record.clone() else {
            return self.tell("recordings are begun and ended by who steps this simulation".into());
        };
        let done = self.news.0.clone();
        let switch = move || {
            let _ = done.send(record().map_or_else(Said::failure, Said::well));
        };
        match std::thread::Builder::new().name("record key".into()).spawn(switch) {
            Ok(thread) => self.note_writer(thread),
            Err(error) => self.pass_on(Said::failure(format!("no recording: {error}"))),
        }
    }

    /// Lets windows fill their monitors, or gives them their places back.
    pub(super) fn switch_full_screen(&mut self) {
        self.switches.full_screen = !self.switches.full_screen;
        self.say(if self.switches.full_screen { "full screen" } else { "windows" });
        let mut filled: Vec<usize> = Vec::new();
        // Of several windows of a monitor the one with the focus fills it.
        let mut order: Vec<usize> = (0..self.windows.len()).collect();
        order.sort_by_key(|&place| !self.windows[place].has_focus);
        for place in order {
            let full = self.switches.full_screen;
            let window = &mut self.windows[place];
            if full && !filled.contains(&window.monitor) {
                filled.push(window.monitor);
                window.full_screen = Some(FullScreen {
                    since: Instant::now(),
                    place: window.window.outer_position().ok(),
                    size: window.window.inner_size(),
                    forced: false,
                });
                let monitor = window.window.available_monitors().nth(window.monitor);
                window.window.set_fullscreen(Some(Fullscreen::Borderless(monitor)));
            } else if let (false, Some(before)) = (full, window.full_screen.take()) {
                window.window.set_fullscreen(None);
                if let Some(place) = before.place {
                    window.window.set_outer_position(place);
                }
                let _ = window.window.request_inner_size(before.size);
            }
        }
    }

    /// Without a window manager nobody fills the screen: then it is done here.
    pub(super) fn check_full_screen(&mut self) {
        for window in &mut self.windows {
            let Some(full) = &mut window.full_screen else { continue };
            if full.forced || full.since.elapsed() < FULL_SCREEN_TIMEOUT {
                continue;
            }
            full.forced = true;
            let Some(monitor) = window.window.available_monitors().nth(window.monitor) else { continue };
            if window.window.inner_size() != monitor.size() {
                window.window.set_outer_position(monitor.position());
                let _ = window.window.request_inner_size(monitor.size());
            }
        }
    }

    pub(super) fn load(&mut self, file: PathBuf) {
        if !is_model_file(&file) {
            return self.tell(format!("{} is no model: files end with .yaml, .YAML, .ambf or .AMBF", file.display()));
        }
        self.change_models(Vec::new(), vec![file]);
    }

    pub(super) fn change_gain(&mut self, quantity: Quantity, step: f64) {
        self.parts.devices.change(GainChange { quantity, step });
        if self.parts.board.read().devices.is_empty() {
            // There is no gain yet: the change is shown.
            self.action = Status::Gain(quantity, step).to_string();
            let line = self.action.clone();
            self.say(&line);
        }
    }

    /// Does what a key asks for, in the window of a camera.
    pub(super) fn act(&mut self, action: Action, camera: CameraId) {
        let on = |on: bool| if on { "on" } else { "off" };
        let hub = Arc::clone(&self.parts.hub);
        match action {
            Action::Close => self.shared.end(Ended::Closed),
            Action::ResetBodies => {
                self.say("reset of all rigid bodies");
                hub.request_body_reset();
            }
            Action::ResetWorld => {
                self.say("reset of the world");
                hub.request_world_reset();
            }
            Action::ResetCameras => {
                self.say("reset of all cameras");
                self.outbox.post(WindowRequest::ResetCameras);
            }
            Action::RemovePicked => match self.last_picked.take() {
                Some((body, identifier)) => {
                    self.stage.own_frames.remove(&identifier);
                    self.release_held();
                    self.outbox.post(WindowRequest::RemoveBody(body));
                }
                None => self.tell("no body was picked: pick one first (p, then the left button)".into()),
            },
            Action::Pause => {
                let paused = !self.parts.control.is_paused();
                self.parts.control.set_paused(paused);
                self.say(if paused { "paused" } else { "resumed" });
            }
            Action::Step(steps) => {
                if self.parts.control.is_paused() {
                    self.parts.control.step(steps);
                }
            }
            Action::NormalMaps => {
                self.stage.normal_maps_off = !self.stage.normal_maps_off;
                self.say(&format!("normal maps {}", on(!self.stage.normal_maps_off)));
            }
            Action::FrameOfPicked => match self.last_picked.clone() {
                Some((_, identifier)) => {
                    if !self.stage.own_frames.remove(&identifier) {
                        self.stage.own_frames.insert(identifier.clone());
                    }
                    let shown = self.stage.frames != self.stage.own_frames.contains(&identifier);
                    self.say(&format!("frame of {identifier} {}", on(shown)));
                }
                None => self.tell("no body was picked: pick one first (p, then the left button)".into()),
            },
            Action::Frames => {
                self.stage.frames = !self.stage.frames;
                self.stage.own_frames.clear();
                self.say(&format!("frames {}", on(self.stage.frames)));
            }
            Action::Sensors => {
                let shown = hub.visuals().is_some_and(|visuals| visuals.sensors.iter().any(|sensor| sensor.visible));
                self.stage.sensors = Some(!self.stage.sensors.unwrap_or(shown));
                self.say(&format!("sensors {}", on(self.stage.sensors == Some(true))));
            }
            Action::Actuators => {
                let shown =
                    hub.visuals().is_some_and(|visuals| visuals.actuators.iter().any(|actuator| actuator.visible));
                self.stage.actuators = Some(!self.stage.actuators.unwrap_or(shown));
                self.say(&format!("actuators {}", on(self.stage.actuators == Some(true))));
            }
            Action::Help => {
                self.switches.help = !self.switches.help;
                if self.switches.help {
                    keys::HELP.iter().for_each(|(key, what)| self.say(&format!("{key:24} {what}")));
                }
            }
            Action::FullScreen => self.switch_full_screen(),
            Action::Mirror => {
                self.switches.mirrored = !self.switches.mirrored;
                self.say(&format!("mirrored windows {}", on(self.switches.mirrored)));
            }
            Action::InvertMouse => {
                self.switches.inverted = !self.switches.inverted;
                self.say(&format!("inverted mouse {}", on(self.switches.inverted)));
            }
            Action::Picking => {
                self.switches.picking = !self.switches.picking;
                self.say(&format!("picking {}", on(self.switches.picking)));
            }
            Action::Labels => {
                self.switches.labels_stand = !self.switches.labels_stand;
                self.say(&format!("updating of texts {}", on(!self.switches.labels_stand)));
            }
            Action::GrippingAssist => {
                let assist = !self.parts.devices.switches().gripping_assist;
                self.parts.devices.set_gripping_assist(assist);
                self.say(&format!("gripping assist {}", on(assist)));
            }
            Action::NextMode => {
                let mode = self.parts.devices.step_mode(1);
                self.parts.board.update(|news| news.action.clear());
                self.action.clear();
                self.say(&format!("mode of the device buttons: {}", mode.name()));
            }
            Action::CameraRotation => {
                self.parts.devices.set_rotation(RotationRule::Camera);
                self.say("hands turn tools in the camera's frame");
            }
            Action::WorldRotation => {
                self.parts.devices.set_rotation(RotationRule::Absolute);
                self.say("hands turn tools in the world's frame");
            }
            Action::Gravity(enabled) => {
                self.say(&format!("gravity {}", on(enabled)));
                self.outbox.post(WindowRequest::Gravity(enabled));
            }
            Action::Gain(quantity, step) => self.change_gain(quantity, step),
            Action::Panels => self.panels.switch_all(camera),
            Action::Panel(panel) => self.panels.switch(panel, camera),
            Action::FitCamera => self.fit(camera),
            Action::Screenshot => self.screenshot = Some(camera),
            Action::Video => self.switch_video(camera),
            Action::Record => self.switch_recording(),
        }
    }

    /// Moves a camera along its view so that everything is seen.
    pub(super) fn fit(&mut self, camera: CameraId) {
        let Some((center, radius)) = self.stage.bounds() else {
            return self.tell("there is nothing to be seen".into());
        };
        self.look_at(camera, center.coords, radius);
    }

    pub(super) fn look_at(&mut self, camera: CameraId, center: Vector3<f64>, radius: f64) {
        let (Some(snapshot), Some(window)) =
            (self.parts.hub.snapshot().clone(), self.windows.iter().find(|window| window.camera == camera))
        else {
            return;
        };
        let Some(state) = snapshot.views.get(camera) else { return };
        let (width, height) = window.size();
        let half = 0.5 * state.field_view_angle.clamp(0.05, 3.0);
        // Of the two angles of the view the narrower one.
        let across = (half.tan() * f64::from(width) / f64::from(height.max(1))).atan();
        let distance = (radius / half.min(across).sin()).max(0.5);
        let mut pose = state.pose;
        pose.translation.vector = center + pose.rotation * Vector3::new(distance, 0.0, 0.0);
        self.outbox.post(WindowRequest::PlaceCamera { camera, pose, distance });
    }
}

/// Whether a dropped file is taken for a model.
pub(super) fn is_model_file(file: &Path) -> bool {
    let extension = file.extension().and_then(|extension| extension.to_str());
    extension.is_some_and(|extension| ["yaml", "YAML", "ambf", "AMBF"].contains(&extension))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

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
