//! Bodies and joints.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::super::scene::{Kind, Shape};
use super::Draft;

impl Draft {
    /// Adds one mechanism.
    pub(super) fn mechanism(&mut self) {
        let length = self.style.length;
        // A second mechanism may stand in the first.
        let origin = if self.scene.bodies.is_empty() {
            Vector3::zeros()
        } else {
            self.feature("two mechanisms");
            let far = self.dice.pick(&[1.0, 4.0]);
            self.dice.vector(length * far)
        };
        match self.dice.index(20) {
            0..=6 => self.tree(&origin),
            7..=8 => self.chain(&origin),
            9..=11 => self.polygon(&origin),
            12..=13 => self.parallelogram(&origin),
            14..=15 => self.pulled_body(&origin),
            16..=17 => self.gripper(&origin),
            _ => self.pile(&origin),
        }
    }

    /// A base, static or free.
    fn base(&mut self, origin: &Vector3<f64>) -> usize {
        let size = Vector3::repeat(self.style.length * 0.4);
        let is_free = self.dice.chance(0.35);
        let mass = if is_free { self.mass() } else { 0.0 };
        self.feature(if is_free { "free base" } else { "static base" });
        let shape = self.style.collides.then_some(Shape::Box(size));
        self.body(mass, size, Isometry3::from(*origin), shape)
    }

    /// Any joint type, the usual ones most often.
    fn kind(&mut self) -> Kind {
        match self.dice.index(24) {
            0..=11 => Kind::Revolute,
            12 | 13 => Kind::Continuous,
            14..=16 => Kind::Prismatic,
            17 | 18 => {
                self.feature("fixed joints");
                Kind::Fixed
            }
            19 => {
                self.feature("ball joints");
                Kind::PointToPoint
            }
            20 => {
                self.feature("cone twist");
                Kind::ConeTwist([0.0; 3].map(|_| self.dice.decades(0.05, 2.0)))
            }
            21 => {
                self.feature("six dof");
                let range = if self.dice.chance(0.3) { 0.0 } else { self.dice.decades(1e-3, 1.0) };
                Kind::SixDof(range * self.style.length, self.dice.decades(0.01, 1.0))
            }
            _ => self.spring(),
        }
    }

    /// A joint with a spring.
    fn spring(&mut self) -> Kind {
        self.feature("springs");
        let load = (self.style.mass * 9.8).max(1e-6);
        let stiffness = load / self.style.length * self.dice.decades(1.0, 1e5);
        let damping = if self.dice.chance(0.4) { 0.0 } else { stiffness * self.dice.decades(1e-4, 1e-1) };
        let square = self.style.length * self.style.length;
        match self.dice.index(3) {
            0 => {
                let rest = self.dice.chance(0.5).then(|| self.style.length * self.dice.between(-0.5, 0.5));
                Kind::LinearSpring(stiffness, damping, rest)
            }
            1 => {
                let rest = self.dice.chance(0.5).then(|| self.dice.between(-0.5, 0.5));
                Kind::TorsionSpring(stiffness * square, damping * square, rest)
            }
            _ => {
                let ranges = (self.style.length * self.dice.decades(1e-3, 1.0), self.dice.decades(1e-3, 1.0));
                Kind::SixDofSpring {
                    ranges,
                    stiffness: (stiffness, stiffness * square),
                    damping: (damping, damping * square),
                }
            }
        }
    }

    /// Coordinate at the start, rad or m: mostly zero.
    fn start(&mut self, kind: &Kind) -> f64 {
        match kind {
            Kind::Revolute | Kind::Continuous if self.dice.chance(0.3) => self.dice.between(-1.5, 1.5),
            Kind::Prismatic if self.dice.chance(0.3) => self.style.length * self.dice.between(-0.3, 0.3),
            _ => 0.0,
        }
    }

    /// Links that branch off one another.
    fn tree(&mut self, origin: &Vector3<f64>) {
        self.feature("tree");
        let base = self.base(origin);
        let mut tips = vec![(base, *origin)];
        for _ in 0..self.dice.count(1, 10) {
            // Usually the latest link grows on.
            let from = if self.dice.chance(0.7) { tips.len() - 1 } else { self.dice.index(tips.len()) };
            let (parent, start) = tips[from];
            let direction = if self.dice.chance(0.5) { self.dice.axis() } else { self.dice.direction() };
            let end = start + direction * self.style.length * self.dice.between(0.3, 1.0);
            let mass = self.mass();
            let child = self.link(mass, &start, &end);
            let kind = self.kind();
            let axis = self.dice.axis();
            let at = self.start(&kind);
            self.join(kind, parent, child, &start, &axis, at);
            tips.push((child, end));
        }
    }

    /// An arm: one link after another, often with a heavy load.
    fn chain(&mut self, origin: &Vector3<f64>) {
        self.feature("chain");
        let mut parent = self.base(origin);
        let mut start = *origin;
        let links = self.dice.count(3, 16);
        let straight = self.dice.chance(0.5).then(|| self.dice.direction());
        for i in 0..links {
            let direction = straight.unwrap_or_else(|| self.dice.direction());
            let end = start + direction * self.style.length * self.dice.between(0.3, 0.6);
            let mut mass = self.mass();
            if i == links - 1 && self.dice.chance(0.3) {
                self.feature("heavy end of a chain");
                mass = (mass * 100.0).min(1e3);
            }
            let child = self.link(mass, &start, &end);
            let axis = self.dice.axis();
            self.join(Kind::Revolute, parent, child, &start, &axis, 0.0);
            (parent, start) = (child, end);
        }
    }

    /// A closed loop of hinges, planar or not.
    fn polygon(&mut self, origin: &Vector3<f64>) {
        self.feature("closed loop");
        let n = self.dice.count(3, 7);
        let is_planar = self.dice.chance(0.7);
        if !is_planar {
            self.feature("spatial loop");
        }
        let turn = self.dice.rotation(PI);
        let normal = turn * Vector3::z();
        let mut corners = Vec::new();
        for i in 0..n {
            let (angle, radius) = (TAU * i as f64 / n as f64, self.style.length * self.dice.between(0.6, 1.2));
            let height = if is_planar { 0.0 } else { self.style.length * self.dice.between(-0.3, 0.3) };
            corners.push(origin + turn * Vector3::new(radius * angle.cos(), radius * angle.sin(), height));
        }
        let is_held = self.dice.chance(0.7);
        let mut links = Vec::new();
        for i in 0..n {
            let mass = if i == 0 && is_held { 0.0 } else { self.mass() };
            links.push(self.link(mass, &corners[i], &corners[(i + 1) % n]));
        }
        for i in 0..n {
            let axis = if is_planar { normal } else { self.dice.axis() };
            let kind = match self.dice.index(8) {
                0 => self.kind(),
                1 => Kind::PointToPoint,
                _ => Kind::Revolute,
            };
            // Blender writes the closing joint either way round.
            let (parent, child) = match i == 0 && self.dice.chance(0.5) {
                true => (links[0], links[n - 1]),
                false => (links[(i + n - 1) % n], links[i]),
            };
            self.join(kind, parent, child, &corners[i], &axis, 0.0);
        }
    }

    /// Equal bars between two rails: loops with one constraint too many.
    fn parallelogram(&mut self, origin: &Vector3<f64>) {
        self.feature("parallelogram");
        let (length, bars) = (self.style.length, self.dice.count(2, 4));
        let turn = self.dice.rotation(PI);
        let lean = self.dice.between(-0.8, 0.8);
        let place = |x: f64, y: f64| origin + turn * Vector3::new(x + y * lean.sin(), y * lean.cos(), 0.0);
        let wide = length * (bars - 1) as f64;
        let rail = if self.dice.chance(0.8) { 0.0 } else { self.mass() };
        let low = self.link(rail, &place(0.0, 0.0), &place(wide, 0.0));
        let mass = self.mass();
        let high = self.link(mass, &place(0.0, length), &place(wide, length));
        let axis = turn * Vector3::z();
        for i in 0..bars {
            let x = length * i as f64;
            let mass = self.mass();
            let bar = self.link(mass, &place(x, 0.0), &place(x, length));
            self.join(Kind::Revolute, low, bar, &place(x, 0.0), &axis, 0.0);
            self.join(Kind::Revolute, bar, high, &place(x, length), &axis, 0.0);
        }
        if self.dice.chance(0.5) {
            // Something to carry.
            let start = place(wide, length);
            let end = start + self.dice.direction() * length * 0.5;
            let mass = self.mass();
            let child = self.link(mass, &start, &end);
            let kind = self.kind();
            self.join(kind, high, child, &start, &axis, 0.0);
        }
    }

    /// One body that several static ones hold, not always in a way that can be.
    fn pulled_body(&mut self, origin: &Vector3<f64>) {
        self.feature("several static bodies hold one");
        let length = self.style.length;
        let end = origin + self.dice.direction() * length;
        let mass = self.mass();
        let middle = self.link(mass, origin, &end);
        for _ in 0..self.dice.count(2, 4) {
            let point = origin + (end - origin) * self.dice.roll();
            let away = self.dice.direction() * length * self.dice.between(0.2, 1.0);
            let size = Vector3::repeat(length * 0.1);
            let shape = (self.style.collides && self.dice.chance(0.3)).then_some(Shape::Box(size));
            let anchor = self.body(0.0, size, Isometry3::from(point + away), shape);
            let kind = match self.dice.index(5) {
                0 => Kind::PointToPoint,
                1 | 2 => self.spring(),
                _ => self.kind(),
            };
            let axis = self.dice.axis();
            self.join(kind, anchor, middle, &point, &axis, 0.0);
        }
    }

    /// Two jaws on a palm that close on an object.
    fn gripper(&mut self, origin: &Vector3<f64>) {
        self.feature("gripper");
        let length = self.style.length;
        let palm = self.base(origin);
        let slides = self.dice.chance(0.5);
        let collides = std::mem::replace(&mut self.style.collides, true);
        let side = Vector3::x();
        for sign in [-1.0, 1.0] {
            let root = origin + side * (sign * length * 0.35) - Vector3::z() * (length * 0.25);
            let tip = root - Vector3::z() * length;
            let mass = self.mass();
            let jaw = self.link(mass, &root, &tip);
            let (kind, axis) = match slides {
                true => (Kind::Prismatic, side * -sign),
                false => (Kind::Revolute, Vector3::y() * sign),
            };
            let joint = self.join(kind, palm, jaw, &root, &axis, 0.0);
            let range = if slides { 0.35 * length } else { 0.5 };
            self.scene.joints[joint].limits = Some((0.0, range));
        }
        let size = Vector3::repeat(length * self.dice.between(0.2, 0.6));
        let middle = origin - Vector3::z() * length;
        let shape = if self.dice.chance(0.5) { Shape::Box(size) } else { Shape::Sphere(size.x / 2.0) };
        let mass = self.mass();
        self.body(mass, size, Isometry3::from(middle), Some(shape));
        self.style.collides = collides;
    }

    /// Loose bodies that fall onto each other.
    fn pile(&mut self, origin: &Vector3<f64>) {
        self.feature("pile");
        let length = self.style.length;
        for i in 0..self.dice.count(2, 10) {
            let size = Vector3::from_fn(|_, _| length * self.dice.between(0.1, 0.6));
            let lift = if self.dice.chance(0.3) { 0.2 } else { 0.7 };
            let place = origin + Vector3::z() * (length * lift * i as f64) + self.dice.vector(0.1 * length);
            let turn = if self.dice.chance(0.5) { UnitQuaternion::identity() } else { self.dice.rotation(PI) };
            let shape = match self.dice.index(6) {
                0 => Shape::Sphere(size.x / 2.0),
                1 => Shape::Cylinder(size.x / 2.0, size.z),
                2 => Shape::Capsule(size.x / 4.0, size.z.max(size.x)),
                3 => Shape::Cone(size.x / 2.0, size.z),
                _ => Shape::Box(size),
            };
            let mass = self.mass();
            self.body(mass, size, Isometry3::from_parts(place.into(), turn), Some(shape));
        }
    }
}
