//! What the mouse does: cameras move, bodies are picked and held.

use ambf_core::comm::Snapshot;
use ambf_core::ids::CameraId;
use ambf_core::plugin::Input;
use ambf_core::scene::{CameraGesture, VisualScene};
use ambf_core::sim::WindowRequest;
use ambf_render::View;
use nalgebra::Vector3;
use winit::dpi::PhysicalPosition;
use winit::event::{ElementState, MouseButton, MouseScrollDelta};
use winit::keyboard::ModifiersState;

use super::{number, App};
use crate::keys;

/// What dragging by one pixel does: m, rad, m; and a tick of the wheel: m.
const PAN: f64 = 0.01;
const LOOK: f64 = 0.3 * std::f64::consts::PI / 180.0;
const ORBIT: f64 = 0.03;
const DOLLY: f64 = 0.1;
/// Factor on all motions while the left Shift key is held.
const FINE: f64 = 0.1;
/// Pixels of a touchpad that count as a tick of a wheel.
const TICK: f64 = 10.0;

/// What a pressed mouse button does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Drag {
    Pan,
    Look,
    Orbit,
    Pick,
}

impl App {
    /// The ray under the pointer of the window of a camera: origin and direction.
    pub(super) fn ray(
        &self,
        camera: CameraId,
        visuals: &VisualScene,
        snapshot: &Snapshot,
    ) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let window = self.windows.iter().find(|window| window.camera == camera)?;
        let view = View::of_camera(&visuals.cameras.get(camera)?.description, snapshot.views.get(camera)?);
        Some(pointer_ray(&view, window.size(), window.cursor?, self.switches.mirrored))
    }

    /// Where what is held is drawn to, m, world axes.
    pub(super) fn goal(&self, visuals: &VisualScene, snapshot: &Snapshot) -> Option<Vector3<f64>> {
        let held = self.held.as_ref()?;
        let (origin, direction) = self.ray(held.camera, visuals, snapshot)?;
        Some(origin + direction * held.distance)
    }

    pub(super) fn pick(&mut self, camera: CameraId) {
        let (Some(visuals), Some(snapshot)) = (self.parts.hub.visuals(), self.parts.hub.snapshot().clone()) else {
            return;
        };
        if let Some((origin, direction)) = self.ray(camera, &visuals, &snapshot) {
            self.picking = Some(camera);
            self.outbox.post(WindowRequest::Pick { origin, direction });
        }
    }

    pub(super) fn let_go(&mut self) {
        self.picking = None;
        self.held = None;
        self.outbox.post(WindowRequest::Release);
    }

    pub(super) fn drag_held(&mut self, visuals: &VisualScene, snapshot: &Snapshot) {
        let Some(held) = &self.held else { return };
        let is_gone = held.body.is_some_and(|body| visuals.bodies.get(body).is_none_or(|body| body.object.removed));
        if is_gone {
            self.let_go();
        } else if let Some((origin, direction)) = self.ray(held.camera, visuals, snapshot) {
            self.outbox.post(WindowRequest::Drag { origin, direction });
        }
    }

    /// Tells plugins of a use of a window.
    pub(super) fn forward(&mut self, input: Input) {
        self.outbox.post(WindowRequest::Input(input));
    }

    pub(super) fn on_button(&mut self, place: usize, button: MouseButton, state: ElementState, is_for_panels: bool) {
        let camera = self.windows[place].camera;
        if state == ElementState::Released {
            if let Some((held, drag)) = self.windows[place].drag {
                if held == button {
                    self.windows[place].drag = None;
                    if drag == Drag::Pick {
                        self.let_go();
                    }
                }
            }
        } else if !is_for_panels && self.windows[place].drag.is_none() {
            let picks = self.switches.picking || self.modifiers == ModifiersState::CONTROL;
            let drag = match button {
                MouseButton::Left if picks => Some(Drag::Pick),
                MouseButton::Left => Some(Drag::Pan),
                MouseButton::Middle if self.left_shift => Some(Drag::Pan),
                MouseButton::Middle => Some(Drag::Orbit),
                MouseButton::Right => Some(Drag::Look),
                _ => None,
            };
            self.windows[place].drag = drag.map(|drag| (button, drag));
            if drag == Some(Drag::Pick) {
                self.pick(camera);
            }
        }
        let number_of_button = match button {
            MouseButton::Left => 0,
            MouseButton::Right => 1,
            MouseButton::Middle => 2,
            MouseButton::Back => 3,
            MouseButton::Forward => 4,
            MouseButton::Other(number) => i32::from(number),
        };
        self.forward(Input::Button {
            window: number(camera),
            button: number_of_button,
            action: i32::from(state == ElementState::Pressed),
            mods: keys::glfw_modifiers(self.modifiers),
        });
    }

    pub(super) fn on_motion(&mut self, place: usize, position: PhysicalPosition<f64>) {
        let fine = if self.left_shift { FINE } else { 1.0 };
        let inverted = self.switches.inverted;
        let window = &mut self.windows[place];
        let camera = window.camera;
        let scale = window.window.scale_factor();
        let before = window.cursor.replace(position).unwrap_or(position);
        let (dx, dy) = ((position.x - before.x) / scale, (position.y - before.y) / scale);
        let drag = window.drag.map(|(_, drag)| drag);
        let multipliers = self.multipliers(camera);
        let dy = if inverted { -dy } else { dy };
        let gesture = match drag {
            Some(Drag::Pan) => {
                let pan = fine * PAN * multipliers.pan;
                Some(CameraGesture::Pan { right: -pan * dx, up: pan * dy })
            }
            Some(Drag::Look) => {
                let look = fine * LOOK * multipliers.rotate;
                Some(CameraGesture::Look { left: look * dx, up: look * dy })
            }
            Some(Drag::Orbit) => {
                let orbit = fine * ORBIT * multipliers.arcball;
                Some(CameraGesture::Orbit { right: -orbit * dx, up: orbit * dy })
            }
            Some(Drag::Pick) | None => None,
        };
        if let Some(gesture) = gesture {
            self.outbox.post(WindowRequest::MoveCamera { camera, gesture });
        }
        self.forward(Input::Position { window: number(camera), x: position.x / scale, y: position.y / scale });
    }

    pub(super) fn on_wheel(&mut self, place: usize, delta: MouseScrollDelta) {
        let camera = self.windows[place].camera;
        let (across, ticks) = match delta {
            MouseScrollDelta::LineDelta(x, y) => (f64::from(x), f64::from(y)),
            MouseScrollDelta::PixelDelta(pixels) => (pixels.x / TICK, pixels.y / TICK),
        };
        let fine = if self.left_shift { FINE } else { 1.0 };
        let forward = fine * DOLLY * self.multipliers(camera).scroll * ticks;
        if forward != 0.0 {
            let gesture = CameraGesture::Dolly { forward };
            self.outbox.post(WindowRequest::MoveCamera { camera, gesture });
        }
        self.forward(Input::Scroll { window: number(camera), x: across, y: ticks });
    }

    pub(super) fn multipliers(&self, camera: CameraId) -> ambf_core::adf::MouseMultipliers {
        let visuals = self.parts.hub.visuals();
        let camera = visuals.as_ref().and_then(|visuals| visuals.cameras.get(camera));
        camera.map(|camera| camera.description.mouse).unwrap_or_default()
    }
}

/// The ray along which a window of `size` pixels shows its scene at the pointer, in pixels from its upper left corner:
/// origin, direction of unit length. `mirrored`: the window shows its picture top to bottom.
pub(super) fn pointer_ray(
    view: &View,
    size: (u32, u32),
    pointer: PhysicalPosition<f64>,
    mirrored: bool,
) -> (Vector3<f64>, Vector3<f64>) {
    let y = if mirrored { f64::from(size.1) - pointer.y } else { pointer.y };
    let ray = view.ray(size.0, size.1, pointer.x, y);
    (ray.origin.coords, ray.direction)
}
