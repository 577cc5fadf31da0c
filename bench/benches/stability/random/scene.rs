//! Abstract description of a scene: what the generator draws, the shrinker simplifies and [`super::adf`] writes as
//! ADF.

use std::collections::BTreeSet;

use nalgebra::{Isometry3, Vector3};

/// Collision shape, centred on the inertial frame; lengths in m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// Edge lengths.
    Box(Vector3<f64>),
    /// Radius.
    Sphere(f64),
    /// Radius and total height along z.
    Cylinder(f64, f64),
    /// Radius and total height along z, caps included.
    Capsule(f64, f64),
    /// Radius and height along z.
    Cone(f64, f64),
    /// The plane z = 0 of the body frame.
    Plane,
    /// Boxes around the z axis: radius of the hole, outer radius, height, number of boxes.
    Ring(f64, f64, f64, usize),
    /// A mesh of triangles, and the length of its side.
    Ground(Ground, f64),
}

/// What a mesh of a ground looks like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Relief {
    Flat,
    /// Waves of this height, as a share of the side.
    Waves(f64),
    /// Flat, with a wall of this height around it, as a share of the side.
    Tray(f64),
}

/// A square of triangles about the origin, its side along x and y 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ground {
    pub relief: Relief,
    /// Cells along a side; each has two triangles.
    pub cells: usize,
}

impl Ground {
    /// Name of its file.
    pub fn file(&self) -> String {
        match self.relief {
            Relief::Flat => format!("flat_{}.obj", self.cells),
            Relief::Waves(height) => format!("waves_{}_{height}.obj", self.cells),
            Relief::Tray(height) => format!("tray_{}_{height}.obj", self.cells),
        }
    }

    /// Text of its file (Wavefront OBJ), the triangles counter-clockwise as seen from above and from inside.
    pub fn text(&self) -> String {
        let at = |i: usize| i as f64 / self.cells as f64 - 0.5;
        let mut points = Vec::new();
        for (j, i) in (0..=self.cells).flat_map(|j| (0..=self.cells).map(move |i| (j, i))) {
            let (x, y) = (at(i), at(j));
            let z = match self.relief {
                Relief::Waves(height) => height / 2.0 * ((20.0 * x).sin() + (17.0 * y).cos()),
                _ => 0.0,
            };
            points.push([x, y, z]);
        }
        let place = |i: usize, j: usize| j * (self.cells + 1) + i;
        let mut squares: Vec<[usize; 4]> = (0..self.cells)
            .flat_map(|j| (0..self.cells).map(move |i| (i, j)))
            .map(|(i, j)| [place(i, j), place(i + 1, j), place(i + 1, j + 1), place(i, j + 1)])
            .collect();
        if let Relief::Tray(height) = self.relief {
            let last = self.cells;
            let edge = (0..last).map(|i| (i, 0)).chain((0..last).map(|j| (last, j)));
            let edge = edge.chain((0..last).map(|i| (last - i, last))).chain((0..last).map(|j| (0, last - j)));
            let edge: Vec<usize> = edge.map(|(i, j)| place(i, j)).collect();
            let first = points.len();
            edge.iter().for_each(|&low| points.push([points[low][0], points[low][1], height]));
            squares.extend((0..edge.len()).map(|n| {
                let next = (n + 1) % edge.len();
                [edge[next], edge[n], first + n, first + next]
            }));
        }
        let point = |[x, y, z]: &[f64; 3]| format!("v {x:?} {y:?} {z:?}\n");
        let face = |[a, b, c, d]: &[usize; 4]| {
            let [a, b, c, d] = [a + 1, b + 1, c + 1, d + 1];
            format!("f {a} {b} {c}\nf {a} {c} {d}\n")
        };
        points.iter().map(point).chain(squares.iter().map(face)).collect()
    }
}

/// Gains (P, D) of a Cartesian controller: linear, angular; and its output type.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseGains {
    pub linear: (f64, f64),
    pub angular: (f64, f64),
    /// Key `controller output type`; `None`: the key is absent.
    pub output: Option<&'static str>,
}

/// A rigid body. `None`: the key is absent, and ADF's default holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    /// Number in its name; stays when other bodies are removed.
    pub id: usize,
    /// kg; 0: static.
    pub mass: f64,
    /// Principal moments, kg·m²; `None`: estimated from the shape.
    pub inertia: Option<Vector3<f64>>,
    /// Position of the inertial frame in the body frame, m.
    pub offset: Vector3<f64>,
    /// Initial pose of the body frame in the world.
    pub pose: Isometry3<f64>,
    pub shape: Option<Shape>,
    /// Static and rolling.
    pub friction: Option<(f64, f64)>,
    /// Linear and angular, 1/s.
    pub damping: Option<(f64, f64)>,
    pub restitution: Option<f64>,
    /// m.
    pub margin: Option<f64>,
    pub groups: Vec<u32>,
    pub controller: Option<PoseGains>,
}

impl Body {
    /// Takes the shape away; an inertia that was estimated from it is given instead, as that of a box.
    pub fn drop_shape(&mut self) {
        if let Some(shape) = self.shape.take().filter(|_| self.mass > 0.0 && self.inertia.is_none()) {
            let size = match shape {
                Shape::Box(size) => size,
                Shape::Sphere(radius) => Vector3::repeat(2.0 * radius),
                Shape::Cylinder(radius, height) | Shape::Capsule(radius, height) | Shape::Cone(radius, height) => {
                    Vector3::new(2.0 * radius, 2.0 * radius, height)
                }
                Shape::Ring(_, outer, height, _) => Vector3::new(2.0 * outer, 2.0 * outer, height),
                Shape::Plane | Shape::Ground(..) => Vector3::zeros(),
            };
            let squares = size.component_mul(&size);
            self.inertia = Some((Vector3::repeat(squares.sum()) - squares) * (self.mass / 12.0));
        }
    }

    /// Changes the mass (kg) of a body that has one, its inertia with it.
    pub fn set_mass(&mut self, mass: f64) {
        if self.mass > 0.0 {
            self.inertia = self.inertia.map(|inertia| inertia * (mass / self.mass));
            self.mass = mass;
        }
    }
}

/// Type of a joint and what only that type has.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    Revolute,
    Continuous,
    Prismatic,
    Fixed,
    PointToPoint,
    /// Stiffness (N/m), damping (N·s/m), equilibrium (m).
    LinearSpring(f64, f64, Option<f64>),
    /// Stiffness (N·m/rad), damping (N·m·s/rad), equilibrium (rad).
    TorsionSpring(f64, f64, Option<f64>),
    /// Spans about x, y, z, rad.
    ConeTwist([f64; 3]),
    /// Half ranges of all linear (m) and all angular (rad) coordinates.
    SixDof(f64, f64),
    /// Half ranges, then stiffness and damping of all linear and all angular coordinates.
    SixDofSpring {
        ranges: (f64, f64),
        stiffness: (f64, f64),
        damping: (f64, f64),
    },
}

/// A joint, in the frames of its bodies as ADF has it.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Number in its name; stays when other joints are removed.
    pub id: usize,
    pub kind: Kind,
    /// Indices into [`Scene::bodies`].
    pub parent: usize,
    pub child: usize,
    /// m, in the body frames.
    pub pivots: [Vector3<f64>; 2],
    /// Axes in the body frames, of any length but zero.
    pub axes: [Vector3<f64>; 2],
    /// Rotation of the child about the axis at coordinate 0, rad.
    pub offset: f64,
    /// rad or m.
    pub limits: Option<(f64, f64)>,
    /// P, I, D.
    pub controller: Option<[f64; 3]>,
    /// Key `controller output type`.
    pub output: Option<&'static str>,
    /// N·m·s or N·s per 1 ms.
    pub max_impulse: Option<f64>,
    /// ERP and CFM.
    pub softness: Option<(f64, f64)>,
    /// Key `ignore inter-collision`.
    pub ignore_collision: Option<bool>,
    pub feedback: bool,
    pub passive: bool,
    /// Coordinate at the start, rad or m.
    pub start: f64,
    /// The joint that it follows, by its number, with ratio and offset.
    pub coupling: Option<(usize, f64, f64)>,
}

/// A sensor with an array of parallel rays along z of its frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// Index of the body that carries it.
    pub parent: usize,
    /// m, in the body frame.
    pub location: Vector3<f64>,
    /// m.
    pub range: f64,
    /// Rays along one edge of the square array.
    pub rays: usize,
    /// Distance of neighbouring rays, m.
    pub pitch: f64,
    /// Contact stiffness, contact damping, static friction of a resistance sensor; `None`: a proximity sensor.
    pub resistance: Option<[f64; 3]>,
}

/// A box that damps what overlaps it.
#[derive(Debug, Clone, PartialEq)]
pub struct Ghost {
    pub pose: Isometry3<f64>,
    /// m.
    pub size: Vector3<f64>,
}

/// What a client does in each sub-step of a range; joints, bodies and actuators by index into the lists of the
/// [`Scene`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// Joint; 0 effort, 1 position, 2 velocity; set point.
    Joint(usize, u8, f64),
    /// Body; force, N; torque, N·m, at the centre of mass, world axes.
    Wrench(usize, Vector3<f64>, Vector3<f64>),
    /// Body; m/s; rad/s, world axes.
    Twist(usize, Vector3<f64>, Vector3<f64>),
    /// Body; pose of the body frame in the world.
    Pose(usize, Isometry3<f64>),
    /// 0 bodies, others world.
    Reset(u8),
    /// Actuator, body that it holds from now on; `None`: it lets go.
    Hold(usize, Option<usize>),
}

/// An order from sub-step `first` to `last`, both included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    pub first: u64,
    pub last: u64,
    pub order: Order,
}

/// A scene and what is done to it.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Length of a sub-step, s.
    pub step: f64,
    /// Simulated time, s.
    pub span: f64,
    /// m/s².
    pub gravity: Vector3<f64>,
    /// Bodies of the model do not collide with each other.
    pub ignore_collision: bool,
    pub bodies: Vec<Body>,
    pub joints: Vec<Joint>,
    pub sensors: Vec<Sensor>,
    /// Bodies that carry constraint actuators, by index.
    pub actuators: Vec<usize>,
    pub ghosts: Vec<Ghost>,
    pub commands: Vec<Command>,
    /// Features that the generator put in, for the statistics.
    pub features: BTreeSet<&'static str>,
}

impl Scene {
    /// Takes out a body with all that refers to it.
    pub fn remove_body(&mut self, body: usize) {
        let joints: Vec<_> = (0..self.joints.len())
            .rev()
            .filter(|&j| self.joints[j].parent == body || self.joints[j].child == body)
            .collect();
        joints.into_iter().for_each(|joint| self.remove_joint(joint));
        for actuator in (0..self.actuators.len()).rev().filter(|&a| self.actuators[a] == body).collect::<Vec<_>>() {
            self.remove_actuator(actuator);
        }
        self.sensors.retain(|sensor| sensor.parent != body);
        self.commands.retain(|command| match command.order {
            Order::Wrench(b, ..) | Order::Twist(b, ..) | Order::Pose(b, _) | Order::Hold(_, Some(b)) => b != body,
            _ => true,
        });
        let shift = |index: &mut usize| *index -= usize::from(*index > body);
        self.bodies.remove(body);
        self.joints.iter_mut().for_each(|joint| {
            shift(&mut joint.parent);
            shift(&mut joint.child);
        });
        self.sensors.iter_mut().for_each(|sensor| shift(&mut sensor.parent));
        self.actuators.iter_mut().for_each(shift);
        for command in &mut self.commands {
            match &mut command.order {
                Order::Wrench(b, ..) | Order::Twist(b, ..) | Order::Pose(b, _) | Order::Hold(_, Some(b)) => shift(b),
                _ => (),
            }
        }
    }

    /// Takes out a joint with its commands.
    pub fn remove_joint(&mut self, joint: usize) {
        self.joints.remove(joint);
        self.commands.retain(|command| !matches!(command.order, Order::Joint(j, ..) if j == joint));
        for command in &mut self.commands {
            if let Order::Joint(j, ..) = &mut command.order {
                *j -= usize::from(*j > joint);
            }
        }
    }

    /// Takes out an actuator with its commands.
    pub fn remove_actuator(&mut self, actuator: usize) {
        self.actuators.remove(actuator);
        self.commands.retain(|command| !matches!(command.order, Order::Hold(a, _) if a == actuator));
        for command in &mut self.commands {
            if let Order::Hold(a, _) = &mut command.order {
                *a -= usize::from(*a > actuator);
            }
        }
    }
}
