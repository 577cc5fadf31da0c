//! What mechanisms fall onto, and what looks at or holds them.

use std::f64::consts::PI;

use nalgebra::{Isometry3, Vector3};

use super::super::scene::{Ghost, PoseGains, Sensor, Shape};
use super::Draft;

impl Draft {
    /// Adds a floor, obstacles, sensors, actuators, ghosts and controllers of bodies.
    pub(super) fn surroundings(&mut self) {
        let length = self.style.length;
        let lowest = self.scene.bodies.iter().map(|body| body.pose.translation.z).fold(0.0, f64::min);
        let moving: Vec<usize> = (0..self.scene.bodies.len()).filter(|&i| self.scene.bodies[i].mass > 0.0).collect();
        if self.dice.chance(0.5) {
            let below = if self.dice.chance(0.25) { -0.2 } else { self.dice.between(0.5, 2.0) };
            self.feature(if below < 0.0 { "floor cuts the mechanism" } else { "floor" });
            let place = Vector3::new(0.0, 0.0, lowest - below * length);
            let (shape, drop) = match self.dice.chance(0.6) {
                true => (Shape::Plane, 0.0),
                false => (Shape::Box(Vector3::new(20.0, 20.0, 0.4) * length), 0.2 * length),
            };
            let floor =
                self.body(0.0, Vector3::repeat(length), Isometry3::from(place - Vector3::z() * drop), Some(shape));
            // A plane lies in the inertial frame.
            let offset = std::mem::take(&mut self.scene.bodies[floor].offset);
            self.scene.bodies[floor].pose.translation.vector += offset;
        }
        if self.dice.chance(0.15) {
            self.feature("obstacle");
            let size = Vector3::from_fn(|_, _| length * self.dice.between(0.2, 1.5));
            let place = self.dice.vector(length);
            let turn = self.dice.rotation(PI);
            let mass = if self.dice.chance(0.5) { 0.0 } else { self.mass() };
            self.body(mass, size, Isometry3::from_parts(place.into(), turn), Some(Shape::Box(size)));
        }
        if moving.is_empty() {
            return;
        }
        if self.dice.chance(0.12) {
            self.feature("proximity sensor");
            let parent = self.dice.pick(&moving);
            self.sensor(parent, None);
        }
        if self.dice.chance(0.12) {
            self.feature("resistance sensor");
            let stiffness = self.style.mass * 9.8 / length * self.dice.decades(1.0, 1e3);
            let damping = if self.dice.chance(0.5) { 0.0 } else { stiffness * self.dice.decades(1e-4, 0.01) };
            let law = [stiffness, damping, self.dice.roll()];
            let parent = self.dice.pick(&moving);
            self.sensor(parent, Some(law));
        }
        if self.dice.chance(0.1) {
            let parent = self.dice.pick(&moving);
            self.scene.actuators.push(parent);
        }
        if self.dice.chance(0.08) {
            self.feature("ghost object");
            let size = Vector3::repeat(length * self.dice.between(0.5, 3.0));
            let pose = Isometry3::from(self.dice.vector(length));
            self.scene.ghosts.push(Ghost { pose, size });
        }
        if self.dice.chance(0.3) {
            let body = self.dice.pick(&moving);
            let p = self.style.mass / length * 9.8 * self.style.gain * self.dice.decades(1.0, 1e3);
            let d = p * self.dice.decades(1e-3, 1.0);
            let square = length * length;
            let output = self.dice.chance(0.2).then_some("VELOCITY");
            let gains = PoseGains { linear: (p, d), angular: (p * square, d * square), output };
            self.scene.bodies[body].controller = Some(gains);
        }
    }

    fn sensor(&mut self, parent: usize, resistance: Option<[f64; 3]>) {
        let length = self.style.length;
        let sensor = Sensor {
            parent,
            location: self.dice.vector(0.1 * length),
            range: length * self.dice.between(0.1, 1.0),
            rays: self.dice.count(1, 4),
            pitch: 0.05 * length,
            resistance,
        };
        self.scene.sensors.push(sensor);
    }
}
