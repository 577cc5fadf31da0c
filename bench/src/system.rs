//! Systems of rigid bodies and joints that every simulator can build: as ADF text for ours, as JSON for others.

use std::fmt::Write;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde_json::{json, Value};

/// Collision shape of a body, centred on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// Edge lengths, m.
    Box(Vector3<f64>),
    /// Radius, m.
    Sphere(f64),
    /// The plane z = 0, for a body without mass.
    Ground,
}

/// A rigid body.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    /// kg; 0: it does not move.
    pub mass: f64,
    /// Principal moments about its axes, kg·m².
    pub inertia: Vector3<f64>,
    /// Initial pose of the inertial frame in the world.
    pub pose: Isometry3<f64>,
    /// Initial velocity of the centre of mass, m/s, world axes.
    pub velocity: Vector3<f64>,
    /// Initial angular velocity, rad/s, world axes.
    pub spin: Vector3<f64>,
    pub shape: Option<Shape>,
}

impl Body {
    /// What everything is fixed to.
    pub fn fixed(shape: Option<Shape>) -> Self {
        Self {
            mass: 0.0,
            inertia: Vector3::zeros(),
            pose: Isometry3::identity(),
            velocity: Vector3::zeros(),
            spin: Vector3::zeros(),
            shape,
        }
    }

    /// A solid box with the given edge lengths (m) at rest, without a collision shape.
    pub fn cuboid(mass: f64, size: Vector3<f64>, position: Vector3<f64>) -> Self {
        let squares = size.component_mul(&size);
        let inertia = (Vector3::repeat(squares.sum()) - squares) * (mass / 12.0);
        Self { mass, inertia, pose: Isometry3::from(position), ..Self::fixed(None) }
    }

    /// A solid sphere at rest that collides.
    pub fn sphere(mass: f64, radius: f64, position: Vector3<f64>) -> Self {
        let inertia = Vector3::repeat(0.4 * mass * radius * radius);
        Self { mass, inertia, pose: Isometry3::from(position), ..Self::fixed(Some(Shape::Sphere(radius))) }
    }

    /// A solid box at rest that collides.
    pub fn block(mass: f64, size: Vector3<f64>, position: Vector3<f64>) -> Self {
        Self { shape: Some(Shape::Box(size)), ..Self::cuboid(mass, size, position) }
    }
}

/// What a joint leaves free.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Freedom {
    Hinge,
    Slider,
}

/// A joint; pivot (m) and axis in the world, in the initial configuration, where its coordinate is 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joint {
    pub freedom: Freedom,
    pub parent: usize,
    pub child: usize,
    pub pivot: Vector3<f64>,
    pub axis: Vector3<f64>,
}

impl Joint {
    pub fn hinge(parent: usize, child: usize, pivot: Vector3<f64>, axis: Vector3<f64>) -> Self {
        Self { freedom: Freedom::Hinge, parent, child, pivot, axis }
    }
}

/// A position controller in every joint: effort = P·(q* − q) + D·(q̇* − q̇), with the set point q* = `amplitude`·(1 −
/// cos(`rate`·t)).
#[derive(Debug, Clone, PartialEq)]
pub struct Drive {
    /// (P, D) of each joint: N·m/rad, N·m·s/rad.
    pub gains: Vec<(f64, f64)>,
    /// rad.
    pub amplitude: f64,
    /// rad/s.
    pub rate: f64,
}

impl Drive {
    /// Set point and its rate at `time` s, rad and rad/s.
    pub fn set_point(&self, time: f64) -> (f64, f64) {
        let phase = self.rate * time;
        (self.amplitude * (1.0 - phase.cos()), self.amplitude * self.rate * phase.sin())
    }
}

/// Bodies, joints that form a tree on body 0, joints that close loops, and what acts on them.
#[derive(Debug, Clone, PartialEq)]
pub struct System {
    pub bodies: Vec<Body>,
    /// Sorted: parents before children.
    pub joints: Vec<Joint>,
    /// Hinges that close loops.
    pub closures: Vec<Joint>,
    /// A closure is two points on the axis instead of one, for simulators and models that close loops by points: needed
    /// where the loop is not planar.
    pub spatial: bool,
    /// m/s².
    pub gravity: Vector3<f64>,
    /// Coefficient of friction between any two bodies.
    pub friction: f64,
    /// Coefficient of restitution between any two bodies.
    pub restitution: f64,
    pub drive: Option<Drive>,
}

impl System {
    /// Bodies under gravity along −z.
    pub fn of(bodies: Vec<Body>) -> Self {
        Self {
            bodies,
            joints: Vec::new(),
            closures: Vec::new(),
            spatial: false,
            gravity: Vector3::new(0.0, 0.0, -9.81),
            friction: 0.0,
            restitution: 0.0,
            drive: None,
        }
    }

    /// Points that a closure holds together, m, world, initial configuration.
    pub fn closure_points(&self, closure: &Joint) -> Vec<Vector3<f64>> {
        let offsets: &[f64] = if self.spatial { &[-0.1, 0.1] } else { &[0.0] };
        offsets.iter().map(|offset| closure.pivot + closure.axis * *offset).collect()
    }

    /// World file and model file in ADF. `joint_keys` are put into every joint, each with a comma after it.
    pub fn adf(&self, joint_keys: &str) -> (String, String) {
        let world = format!("gravity: {}\nmax iterations: 1000\n", vector(&self.gravity));
        let joints: Vec<_> = self.joints.iter().chain(&self.closures).collect();
        let names = |word: &str, n: usize| (0..n).map(|i| format!("{word} {i}")).collect::<Vec<_>>().join(", ");
        let mut model = format!(
            "namespace: /ambf/env/\nbodies: [{}]\njoints: [{}]\n",
            names("BODY", self.bodies.len()),
            names("JOINT", joints.len())
        );
        let mut line = |text: String| writeln!(model, "{text}").expect("a text takes everything");
        for (i, body) in self.bodies.iter().enumerate() {
            line(self.adf_body(i, body));
        }
        for (i, joint) in joints.into_iter().enumerate() {
            line(self.adf_joint(i, joint, joint_keys));
        }
        (world, model)
    }

    fn adf_body(&self, index: usize, body: &Body) -> String {
        let (r, p, y) = body.pose.rotation.euler_angles();
        // Bullet multiplies the coefficients of the two bodies.
        let (friction, restitution) = (self.friction.sqrt(), self.restitution.sqrt());
        let shape = match body.shape {
            None => String::new(),
            Some(Shape::Box(size)) => format!("collision shape: Box, collision geometry: {}, ", vector(&size)),
            Some(Shape::Sphere(radius)) => {
                format!("collision shape: Sphere, collision geometry: {{radius: {radius:?}}}, ")
            }
            Some(Shape::Ground) => {
                "collision shape: Plane, collision geometry: {normal: {x: 0, y: 0, z: 1}, offset: 0}, ".into()
            }
        };
        format!(
            "BODY {index}: {{name: body{index}, mass: {:?}, inertia: {{ix: {:?}, iy: {:?}, iz: {:?}}}, \
             location: {{position: {}, orientation: {{r: {r:?}, p: {p:?}, y: {y:?}}}}}, {shape}\
             friction: {{static: {friction:?}, rolling: 0}}, restitution: {restitution:?}, \
             damping: {{linear: 0, angular: 0}}}}",
            body.mass,
            body.inertia.x,
            body.inertia.y,
            body.inertia.z,
            vector(&body.pose.translation.vector),
        )
    }

    fn adf_joint(&self, index: usize, joint: &Joint, keys: &str) -> String {
        let kind = match joint.freedom {
            Freedom::Hinge => "revolute",
            Freedom::Slider => "prismatic",
        };
        let side = |word: &str, body: usize| {
            let pose = &self.bodies[body].pose;
            let pivot = pose.inverse_transform_point(&joint.pivot.into()).coords;
            let axis = pose.inverse_transform_vector(&joint.axis);
            format!("{word}: BODY {body}, {word} pivot: {}, {word} axis: {}", vector(&pivot), vector(&axis))
        };
        let controller = self.drive.as_ref().and_then(|drive| drive.gains.get(index));
        let controller = controller
            .map(|(p, d)| format!("controller: {{P: {p:?}, I: 0, D: {d:?}}}, controller output type: FORCE, "));
        format!(
            "JOINT {index}: {{name: joint{index}, type: {kind}, {keys}{}{}, {}}}",
            controller.unwrap_or_default(),
            side("parent", joint.parent),
            side("child", joint.child),
        )
    }

    /// All of it for programs in other languages.
    pub fn json(&self) -> Value {
        let body = |body: &Body| {
            let shape = match body.shape {
                None => Value::Null,
                Some(Shape::Box(size)) => json!({"box": numbers(&size)}),
                Some(Shape::Sphere(radius)) => json!({"sphere": radius}),
                Some(Shape::Ground) => json!({"ground": 0}),
            };
            json!({
                "mass": body.mass, "inertia": numbers(&body.inertia), "position": numbers(&body.pose.translation.vector),
                "quaternion": quaternion(&body.pose.rotation), "velocity": numbers(&body.velocity),
                "spin": numbers(&body.spin), "shape": shape,
            })
        };
        let joint = |joint: &Joint| {
            json!({
                "slider": joint.freedom == Freedom::Slider, "parent": joint.parent, "child": joint.child,
                "pivot": numbers(&joint.pivot), "axis": numbers(&joint.axis),
            })
        };
        let closure = |closure: &Joint| {
            let points: Vec<_> = self.closure_points(closure).iter().map(numbers).collect();
            json!({"a": closure.parent, "b": closure.child, "points": points})
        };
        let drive = self
            .drive
            .as_ref()
            .map(|drive| json!({"gains": drive.gains, "amplitude": drive.amplitude, "rate": drive.rate}));
        json!({
            "bodies": self.bodies.iter().map(body).collect::<Vec<_>>(),
            "joints": self.joints.iter().map(joint).collect::<Vec<_>>(),
            "closures": self.closures.iter().map(closure).collect::<Vec<_>>(),
            "gravity": numbers(&self.gravity), "friction": self.friction, "restitution": self.restitution,
            "drive": drive,
        })
    }
}

fn vector(v: &Vector3<f64>) -> String {
    format!("{{x: {:?}, y: {:?}, z: {:?}}}", v.x, v.y, v.z)
}

fn numbers(v: &Vector3<f64>) -> [f64; 3] {
    [v.x, v.y, v.z]
}

fn quaternion(q: &UnitQuaternion<f64>) -> [f64; 4] {
    [q.i, q.j, q.k, q.w]
}
