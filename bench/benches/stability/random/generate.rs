//! Scenes like those that people draw: mechanisms of the usual kinds, with the usual sloppiness and the usual
//! excesses.
//!
//! A scene has a style, drawn once, that says how large, heavy, sloppy and strong things are in it. Structures are
//! built in the world at the initial configuration; joints then get their frames in the bodies.

mod mechanisms;
mod orders;
mod parts;
mod surroundings;

use std::collections::BTreeSet;
use std::f64::consts::PI;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::super::families::Dice;
use super::dice;
use super::scene::{Body, Joint, Kind, Scene, Shape};

/// Habits of whoever drew the scene.
struct Style {
    /// Length of a link, m.
    length: f64,
    /// Mass of a link, kg, and the factor by which masses scatter.
    mass: f64,
    mass_ratio: f64,
    /// How inertias are given.
    inertia: Inertia,
    /// Error of joint frames, m and rad.
    slop: (f64, f64),
    /// Probability of a link that reaches into others.
    overlap: f64,
    /// Probability of joint limits, and of limits that exclude the start.
    limits: f64,
    beyond: f64,
    /// Probability of a joint controller, and the factor on its gains.
    controllers: f64,
    gain: f64,
    /// Body frames are turned at random.
    turned: bool,
    damping: Option<(f64, f64)>,
    collides: bool,
    softness: Option<(f64, f64)>,
    /// Probability that joined bodies collide with each other.
    neighbours: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Inertia {
    /// From the shape.
    Estimated,
    /// Of a solid body of the link's size.
    Solid,
    /// Almost none about one axis.
    Rod,
    /// Almost none at all.
    Tiny,
    /// A hundred times too large.
    Huge,
}

/// A scene that grows.
struct Draft {
    dice: Dice,
    style: Style,
    scene: Scene,
}

/// Scene `index` of `seed`.
pub fn scene(seed: u64, index: u64) -> Scene {
    let mut dice = dice::of(seed, index);
    let mut features = BTreeSet::new();
    let style = style(&mut dice, &mut features);
    let step = match dice.index(10) {
        0 => 0.00025,
        1 => 0.0005,
        2 => 0.002,
        3 => dice.pick(&[0.004, 0.005, 0.008]),
        _ => 0.001,
    };
    if step > 0.001 {
        features.insert("step above 1 ms");
    }
    let gravity = match dice.index(12) {
        0 => Vector3::zeros(),
        1 => Vector3::new(0.0, 9.8, 0.0),
        _ => Vector3::new(0.0, 0.0, -9.8),
    };
    let scene = Scene {
        step,
        span: 2.0,
        gravity,
        ignore_collision: style.collides && dice.chance(0.15),
        bodies: Vec::new(),
        joints: Vec::new(),
        sensors: Vec::new(),
        actuators: Vec::new(),
        ghosts: Vec::new(),
        commands: Vec::new(),
        features,
    };
    let mut draft = Draft { dice, style, scene };
    draft.mechanism();
    if draft.dice.chance(0.25) {
        draft.mechanism();
    }
    draft.surroundings();
    draft.orders();
    couple(&mut draft.scene, draft.style.length, &mut dice::of(!seed, index));
    // As above: draws of their own.
    draft.dice = dice::of(seed.rotate_left(32), index);
    draft.small_parts();
    draft.scene
}

/// Couples joints of some scenes. `length`: of the style, m; `dice`: of their own, so that all else is as without couplings.
fn couple(scene: &mut Scene, length: f64, dice: &mut Dice) {
    if !dice.chance(0.15) {
        return;
    }
    let is_driven = |joint: &Joint| matches!(joint.kind, Kind::Revolute | Kind::Continuous | Kind::Prismatic);
    let driven: Vec<usize> = (0..scene.joints.len()).filter(|&joint| is_driven(&scene.joints[joint])).collect();
    // A follower comes after its leader in the list: there are no circles.
    for (place, &follower) in driven.iter().enumerate().skip(1) {
        if !dice.chance(0.4) {
            continue;
        }
        let leader = &scene.joints[driven[dice.index(place)]];
        let slides = |joint: &Joint| joint.kind == Kind::Prismatic;
        let unit = length.powi(i32::from(slides(&scene.joints[follower])) - i32::from(slides(leader)));
        let ratio = dice.pick(&[-1.0, 1.0, -0.5, 2.0, -3.0, 0.1]) * unit;
        let offset = scene.joints[follower].start - ratio * leader.start;
        scene.joints[follower].coupling = Some((leader.id, ratio, offset));
        scene.features.insert("couplings");
    }
}

fn style(dice: &mut Dice, features: &mut BTreeSet<&'static str>) -> Style {
    let length = if dice.chance(0.6) { dice.decades(0.03, 1.0) } else { dice.decades(1e-3, 10.0) };
    if length < 0.02 {
        features.insert("scale below 2 cm");
    }
    let usual = (500.0 * length.powi(3)).clamp(1e-4, 1e3);
    let mass = match dice.index(4) {
        0 => 1.0,
        1 => dice.decades(1e-4, 1e3),
        _ => usual * dice.decades(0.1, 10.0),
    };
    let mass_ratio = match dice.index(10) {
        0 => 1e3,
        1..=3 => 30.0,
        _ => 3.0,
    };
    if mass_ratio >= 1e3 {
        features.insert("mass ratios to 1e6");
    }
    let inertia = match dice.index(20) {
        0..=8 => Inertia::Estimated,
        9..=16 => Inertia::Solid,
        17 => Inertia::Rod,
        18 => Inertia::Tiny,
        _ => Inertia::Huge,
    };
    match inertia {
        Inertia::Rod => _ = features.insert("inertia of rods"),
        Inertia::Tiny => _ = features.insert("inertia of nearly nothing"),
        Inertia::Huge => _ = features.insert("inertia too large"),
        _ => (),
    }
    let slop = match dice.index(6) {
        0 | 1 => (0.0, 0.0),
        2 => (1e-6, 1e-6),
        3 => (1e-4 * dice.roll(), 1e-3 * dice.roll()),
        4 => (dice.decades(1e-4, 1e-2).min(0.2 * length), dice.decades(1e-3, 3e-2)),
        _ => (dice.decades(1e-3, 0.3) * length, dice.decades(1e-3, 0.3)),
    };
    if slop.0 > 1e-2 * length || slop.1 > 0.03 {
        features.insert("joint frames wrong");
    } else if slop.0 > 1e-7 {
        features.insert("joint frames sloppy");
    }
    let gain = if dice.chance(0.2) { dice.decades(1e-3, 1e5) } else { dice.decades(0.3, 3.0) };
    if gain > 1e3 {
        features.insert("gains absurd");
    }
    let damping = match dice.index(4) {
        0 => Some((0.0, 0.0)),
        1 => Some((dice.decades(0.01, 1.0), dice.decades(0.01, 1.0))),
        _ => None,
    };
    if damping == Some((0.0, 0.0)) {
        features.insert("no damping");
    }
    let softness = match dice.index(8) {
        0 => Some((0.9, 0.0)),
        1 => Some((dice.decades(1e-3, 1.0), dice.decades(1e-6, 1.0))),
        _ => None,
    };
    let limits = if dice.chance(0.6) { 0.7 } else { 0.0 };
    Style {
        length,
        mass,
        mass_ratio,
        inertia,
        slop,
        overlap: if dice.chance(0.4) { 0.5 } else { 0.05 },
        limits,
        beyond: if dice.chance(0.25) { 0.3 } else { 0.02 },
        controllers: if dice.chance(0.6) { 0.8 } else { 0.0 },
        gain,
        turned: dice.chance(0.4),
        damping,
        collides: dice.chance(0.75),
        softness,
        neighbours: if dice.chance(0.12) { 0.5 } else { 0.0 },
    }
}

impl Draft {
    fn feature(&mut self, name: &'static str) {
        self.scene.features.insert(name);
    }

    /// Mass of a link, kg.
    fn mass(&mut self) -> f64 {
        let ratio = self.style.mass_ratio;
        (self.style.mass * self.dice.decades(1.0 / ratio, ratio)).clamp(1e-4, 1e3)
    }

    /// Adds a body whose shape has its middle at `pose` and its long side along z of it; returns its index.
    fn body(&mut self, mass: f64, size: Vector3<f64>, pose: Isometry3<f64>, shape: Option<Shape>) -> usize {
        let squares = size.component_mul(&size);
        let solid = (Vector3::repeat(squares.sum()) - squares) * (mass.max(1e-9) / 12.0);
        let inertia = match self.style.inertia {
            // Without a shape nothing can be estimated.
            Inertia::Estimated => shape.is_none().then_some(solid),
            Inertia::Solid => Some(solid),
            Inertia::Rod => Some(Vector3::new(solid.x, solid.y, solid.z.min(1e-4 * solid.x))),
            Inertia::Tiny => Some(Vector3::repeat(self.dice.decades(1e-9, 1e-6))),
            Inertia::Huge => Some(solid * 100.0),
        };
        let offset = match self.dice.chance(0.4) {
            true => self.dice.vector(0.3 * size.min()),
            false => Vector3::zeros(),
        };
        let damping = self.style.damping;
        self.scene.bodies.push(Body {
            id: self.scene.bodies.len(),
            mass,
            inertia: inertia.filter(|_| mass > 0.0),
            offset,
            pose: pose * Isometry3::from(-offset),
            shape,
            friction: self.dice.chance(0.5).then_some((0.5, 0.01)),
            damping,
            restitution: self.dice.chance(0.3).then_some(0.0),
            margin: self.dice.chance(0.5).then_some(0.001),
            groups: vec![0],
            controller: None,
        });
        self.scene.bodies.len() - 1
    }

    /// A link from `start` to `end` (m, world).
    fn link(&mut self, mass: f64, start: &Vector3<f64>, end: &Vector3<f64>) -> usize {
        let along = end - start;
        let length = along.norm().max(1e-4);
        let thick = length * self.dice.between(0.08, 0.3);
        // Most links leave their neighbours room; others reach into them.
        let reach = if self.dice.chance(self.style.overlap) { self.dice.between(1.0, 1.4) } else { 0.7 };
        if reach >= 1.0 && self.style.collides {
            self.feature("links overlap");
        }
        let tall = length * reach;
        let shape = match self.dice.index(4) {
            0 => Shape::Capsule(thick / 2.0, tall),
            1 => Shape::Cylinder(thick / 2.0, tall),
            2 if self.dice.chance(0.3) => Shape::Sphere(tall / 2.0),
            _ => Shape::Box(Vector3::new(thick, thick, tall)),
        };
        let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &along)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
        let about = if self.style.turned { self.dice.between(-PI, PI) } else { 0.0 };
        let rotation = rotation * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), about);
        let pose = Isometry3::from_parts(((start + end) / 2.0).into(), rotation);
        let shape = self.style.collides.then_some(shape);
        self.body(mass, Vector3::new(thick, thick, length), pose, shape)
    }

    /// Joins two bodies at a point and axis of the world, at coordinate `at`; the frames get the errors of the style.
    fn join(
        &mut self,
        kind: Kind,
        parent: usize,
        child: usize,
        point: &Vector3<f64>,
        axis: &Vector3<f64>,
        at: f64,
    ) -> usize {
        let (slide, turn) = self.style.slop;
        let axis = axis.normalize();
        let at_angle = if matches!(kind, Kind::Prismatic | Kind::LinearSpring(..)) { 0.0 } else { at };
        let at_length = at - at_angle;
        let mut pivots = [Vector3::zeros(); 2];
        let mut axes = [Vector3::zeros(); 2];
        for (side, body) in [parent, child].into_iter().enumerate() {
            let inverse = self.scene.bodies[body].pose.inverse();
            // At coordinate `at` the child's pivot is that far along the axis.
            let place = if side == 0 { point - axis * at_length } else { *point };
            pivots[side] = (inverse * nalgebra::Point3::from(place)).coords + self.dice.vector(slide / 2.0);
            axes[side] = self.dice.rotation(turn / 2.0) * (inverse * axis);
        }
        // Rotation of the child about the axis beyond the least one that aligns the axes.
        let [a, b] = axes;
        let aligned = UnitQuaternion::rotation_between(&b, &a).unwrap_or_default();
        let relative = self.scene.bodies[parent].pose.rotation.inverse() * self.scene.bodies[child].pose.rotation;
        let rest = relative * aligned.inverse();
        let angle = 2.0 * rest.imag().dot(&a.normalize()).atan2(rest.w);
        let offset = (angle - at_angle + PI).rem_euclid(2.0 * PI) - PI;
        let limits = self.limits(&kind, at);
        let softness = self.style.softness;
        let id = self.scene.joints.len();
        let is_driven = matches!(kind, Kind::Revolute | Kind::Continuous | Kind::Prismatic);
        let controller = (is_driven && self.dice.chance(self.style.controllers)).then(|| self.gains());
        self.scene.joints.push(Joint {
            id,
            kind,
            parent,
            child,
            pivots,
            axes,
            offset: if offset.abs() < 1e-12 { 0.0 } else { offset },
            limits,
            controller,
            output: (controller.is_some() && self.dice.chance(0.15)).then_some("VELOCITY"),
            max_impulse: (is_driven && self.dice.chance(0.4)).then(|| self.dice.decades(1e-3, 1e2)),
            softness,
            ignore_collision: self.dice.chance(self.style.neighbours).then_some(false),
            feedback: self.dice.chance(0.1),
            passive: self.dice.chance(0.03),
            start: at,
            coupling: None,
        });
        if self.scene.joints[id].ignore_collision.is_some() {
            self.feature("joined bodies collide");
        }
        id
    }

    /// P, I, D: people tune P to the load and guess the rest.
    fn gains(&mut self) -> [f64; 3] {
        let load = (self.style.mass * 9.8 * self.style.length).max(1e-6);
        let p = load * self.style.gain * self.dice.decades(3.0, 300.0);
        let i = if self.dice.chance(0.2) { p * self.dice.decades(0.01, 1.0) } else { 0.0 };
        if i > 0.0 {
            self.feature("integral gain");
        }
        let d = match self.dice.index(4) {
            0 => 0.0,
            1 => p * self.dice.decades(1e-4, 1e-2),
            2 => p * 0.1,
            _ => p * self.dice.decades(1e-3, 10.0),
        };
        [p, i, d]
    }

    fn limits(&mut self, kind: &Kind, at: f64) -> Option<(f64, f64)> {
        let range = match kind {
            Kind::Revolute | Kind::TorsionSpring(..) => 1.5,
            Kind::Prismatic | Kind::LinearSpring(..) => self.style.length,
            _ => return None,
        };
        let is_spring = matches!(kind, Kind::LinearSpring(..) | Kind::TorsionSpring(..));
        if !is_spring && !self.dice.chance(self.style.limits) {
            return None;
        }
        let (below, above) = (range * self.dice.roll(), range * self.dice.roll());
        if self.dice.chance(self.style.beyond) {
            self.feature("limits exclude the start");
            let past = range * self.dice.decades(1e-3, 0.5);
            return Some(if self.dice.chance(0.5) {
                (at + past, at + past + above)
            } else {
                (at - past - below, at - past)
            });
        }
        if self.dice.chance(0.15) {
            self.feature("limit at the start");
            return Some((at, at + above));
        }
        Some((at - below, at + above))
    }
}
