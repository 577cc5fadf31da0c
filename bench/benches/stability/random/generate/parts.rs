//! Small parts – needles, rings, plates, cubes – that fall onto meshes and thin plates.

use std::f64::consts::PI;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::super::scene::{Ground, Relief, Shape};
use super::Draft;

impl Draft {
    /// Adds a ground and parts above it to some scenes, in place of all else in half of these.
    pub(super) fn small_parts(&mut self) {
        if !self.dice.chance(0.2) {
            return;
        }
        let length = self.style.length;
        let all_else = self.dice.chance(0.5);
        if !all_else {
            let (step, gravity) = (self.scene.step, Vector3::new(0.0, 0.0, -9.8));
            self.scene.features.clear();
            if step > 0.001 {
                self.feature("step above 1 ms");
            }
            let lists = (&mut self.scene.bodies, &mut self.scene.joints, &mut self.scene.commands);
            (*lists.0, *lists.1, *lists.2) = (Vec::new(), Vec::new(), Vec::new());
            let others = (&mut self.scene.sensors, &mut self.scene.actuators, &mut self.scene.ghosts);
            (*others.0, *others.1, *others.2) = (Vec::new(), Vec::new(), Vec::new());
            (self.scene.gravity, self.scene.ignore_collision) = (gravity, false);
        }
        let lowest = self.scene.bodies.iter().map(|body| body.pose.translation.z).fold(0.0, f64::min);
        let side = length * self.dice.pick(&[3.0, 20.0]);
        let cells = self.dice.pick(&[1, 4, 15, 40]);
        let relief = match self.dice.index(4) {
            0 | 1 => Relief::Flat,
            2 => Relief::Waves(self.dice.pick(&[0.002, 0.02])),
            _ => Relief::Tray(0.05),
        };
        let (shape, drop) = if self.dice.chance(0.6) {
            self.feature("ground of triangles");
            (Shape::Ground(Ground { relief, cells }, side), 0.0)
        } else {
            self.feature("thin plate");
            let thick = length * self.dice.decades(0.003, 0.05);
            (Shape::Box(Vector3::new(side, side, thick)), thick / 2.0)
        };
        let place = Isometry3::translation(0.0, 0.0, lowest - 1.5 * length - drop);
        let ground = self.body(0.0, Vector3::repeat(length), place, Some(shape));
        self.centre(ground, place);
        let size = length * self.dice.decades(0.03, 0.3);
        for n in 0..self.dice.count(1, 12) {
            let high = if self.dice.chance(0.3) { 0.1 } else { 1.0 } * length + size * n as f64;
            let far = self.dice.vector(0.3 * length);
            let at = Vector3::new(far.x, far.y, place.translation.z + drop + high);
            let turn = if self.dice.chance(0.4) { UnitQuaternion::identity() } else { self.dice.rotation(PI) };
            self.part(size, Isometry3::from_parts(at.into(), turn));
        }
    }

    /// One part of about this size, m.
    fn part(&mut self, size: f64, pose: Isometry3<f64>) {
        let thin = size * self.dice.decades(0.02, 0.2);
        let shape = match self.dice.index(6) {
            0 => Shape::Box(Vector3::new(thin, thin, size)),
            1 => Shape::Capsule(thin / 2.0, size),
            2 => Shape::Cylinder(thin / 2.0, size),
            3 => Shape::Box(Vector3::new(size, size * self.dice.between(0.5, 1.0), thin)),
            4 => Shape::Box(Vector3::repeat(size * 0.3)),
            _ => Shape::Ring(size / 2.0 - thin, size / 2.0, thin, self.dice.pick(&[8, 16])),
        };
        self.feature(match shape {
            Shape::Ring(..) => "rings",
            Shape::Box(edges) if edges.x == edges.z => "small cubes",
            Shape::Box(edges) if edges.x > edges.z => "small plates",
            _ => "needles",
        });
        let edges = match shape {
            Shape::Box(edges) => edges,
            Shape::Ring(..) => Vector3::new(size, size, thin),
            _ => Vector3::new(thin, thin, size),
        };
        let mass = (edges.product() * self.dice.decades(500.0, 8000.0)).clamp(1e-6, 1e3);
        let body = self.body(mass, edges, pose, Some(shape));
        self.centre(body, pose);
    }

    /// The shape of a body lies about its body frame, at `pose`.
    fn centre(&mut self, body: usize, pose: Isometry3<f64>) {
        let body = &mut self.scene.bodies[body];
        (body.offset, body.pose) = (Vector3::zeros(), pose);
    }
}
