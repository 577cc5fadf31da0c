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

    pub(super) fn release_held(&mut self) {
        self.picking = None;
        self.held = None;
        self.outbox.post(WindowRequest::Release);
    }

    pub(super) fn drag_held(&mut self, visuals: &VisualScene, snapshot: &Snapshot) {
        let Some(held) = &self.held else { return };
        let is_gone = held.body.is_some_and(|body| visuals.bodies.get(body).is_none_or(|body| body.object.removed));
        if is_gone {
            self.release_held();
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
                        self.release_held();
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

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Vector3};

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
}
