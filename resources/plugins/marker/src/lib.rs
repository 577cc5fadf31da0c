//! A plugin for windows: it shows the time and the last key, and marks a body.
//!
//! With `ambf_simulator --plugins libambf_marker.so` each window has a line with the simulated time, the number of the
//! frame and the last key. The key `b` shows a green ball above the body that is highest, with the body's name, or
//! hides it; the key `k` a blue sky behind the scene and the colours of the axes in the upper right corner. Keys and
//! buttons are written to the log.

use std::sync::Arc;

use ambf_plugin::{
    key_name, Drawing, DrawingShape, Host, InitContext, ObjectId, ObjectType, Pixels, Plugin, PluginError,
    SimulatorPlugin, TextPlace, View,
};
use nalgebra::{Isometry3, Vector3};

ambf_plugin::export_plugin! { simulator: Tool }

/// Shows time, frames and the last key in the windows, and marks the body that is highest.
#[derive(Default)]
struct Tool {
    host: Option<Host>,
    frames: u64,
    time: f64,
    key: String,
    pointer: (f64, f64),
    marks: bool,
    /// Sky and legend, while they are shown; made once.
    pictures: Option<[Arc<Pixels>; 2]>,
    /// Place and name of the highest body.
    highest: Option<(Vector3<f64>, String)>,
}

impl Plugin for Tool {
    fn init(&mut self, context: &mut InitContext<'_>) -> Result<(), PluginError> {
        self.host = Some(context.host());
        Ok(())
    }

    fn physics_update(&mut self, world: &mut View<'_>, _dt: f64) {
        self.time = world.clock().sim_time;
        if !self.marks {
            return;
        }
        let place = |body| world.body(body).map(|state| (body, state.pose.translation.vector));
        let bodies = (0..world.count(ObjectType::Body)).filter_map(place);
        let highest = bodies.max_by(|a, b| a.1.z.total_cmp(&b.1.z));
        self.highest = highest.map(|(body, place)| {
            (place, world.name(ObjectId::new(ObjectType::Body, body)).unwrap_or_default().to_owned())
        });
    }

    fn graphics_update(&mut self) {
        self.frames += 1;
        if self.frames == 1 {
            self.say("the first frame was drawn".into());
        }
        let line = format!("{:.1} s, frame {}, key {}", self.time, self.frames, self.key);
        let mut drawings = vec![Drawing {
            shape: DrawingShape::Text {
                text: line,
                place: TextPlace::Pixels(12.0, 60.0),
                height: 18.0,
                panel: Some([0.1, 0.1, 0.4, 0.8]),
            },
            ..Drawing::text("", TextPlace::Scene)
        }];
        drawings[0].color = [1.0; 4];
        if let (true, Some((place, name))) = (self.marks, &self.highest) {
            let pose = Isometry3::translation(place.x, place.y, place.z + 0.5);
            drawings.push(Drawing::new(DrawingShape::Sphere(0.1), pose, [0.0, 1.0, 0.0, 1.0]));
            drawings.push(Drawing { pose, ..Drawing::text(name, TextPlace::Scene) });
        }
        if let Some([sky, legend]) = &self.pictures {
            let picture = |pixels: &Arc<Pixels>, place, height, is_behind| {
                let shape = DrawingShape::Picture { pixels: Arc::clone(pixels), place, height, is_behind };
                Drawing::new(shape, Isometry3::identity(), [1.0; 4])
            };
            drawings.push(picture(sky, TextPlace::Share(0.0, 0.0), 0.0, true));
            drawings.push(picture(legend, TextPlace::Pixels(-100.0, 10.0), 30.0, false));
        }
        if let Some(Err(error)) = self.host.as_ref().map(|host| host.show(&drawings)) {
            self.say(format!("nothing is shown: {error}"));
        }
    }
}

impl Tool {
    fn say(&self, line: String) {
        if let Some(host) = &self.host {
            host.say(line);
        }
    }
}

/// One column from blue to white.
fn sky() -> Option<Pixels> {
    Pixels::new(1, 64, (0..64).map(|row| [3 * row, 3 * row, 255, 255]).collect())
}

/// Red, green and blue squares.
fn legend() -> Option<Pixels> {
    Pixels::new(3, 1, vec![[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255]])
}

impl SimulatorPlugin for Tool {
    fn keyboard_update(&mut self, window: u32, key: i32, _scancode: i32, action: i32, mods: i32) {
        let names = [(1, "Shift+"), (2, "Ctrl+"), (4, "Alt+"), (8, "Super+")];
        let held: String = names.iter().filter(|(bit, _)| mods & bit != 0).map(|(_, name)| *name).collect();
        self.key = format!("{held}{}", key_name(key).unwrap_or("without a name"));
        if self.key == "B" && action == 1 {
            self.marks = !self.marks;
        }
        if self.key == "K" && action == 1 {
            self.pictures = match self.pictures.take() {
                Some(_) => None,
                None => sky().zip(legend()).map(|pair| <[_; 2]>::from(pair).map(Arc::new)),
            };
        }
        self.say(format!("key {} in window {window}, frame {}", self.key, self.frames));
    }

    fn mouse_buttons_update(&mut self, window: u32, button: i32, action: i32, mods: i32) {
        let (x, y) = self.pointer;
        let what = if action == 1 { "pressed" } else { "released" };
        self.say(format!("button {button} {what} in window {window} at {x:.0}, {y:.0}, modifiers {mods}"));
    }

    fn mouse_position_update(&mut self, _window: u32, x: f64, y: f64) {
        self.pointer = (x, y);
    }
}
