//! Upper bound of the work that motors, controllers and commands have done, from what can be seen outside:
//! coordinates before and after each sub-step.
//!
//! * Effort τ on a coordinate q: ∫ max(τ·q̇, 0) dt.
//! * Controller with output force: the same with |τ| ≤ P·|e| + I·∫|e| dt + D·|ṡ|, where e is the position error
//!   and ṡ the rate of the set point; D·q̇ only takes energy away.
//! * Controller with output velocity, or a velocity command: a motor drives the coordinate to the speed u with at
//!   most F = `max motor impulse` / min(h, 1 ms), and only up to that speed: ∫ F·min(|q̇|, |u|) dt; it stays on
//!   when its command has ended.
//! * Wrench on a body: ∫ max(F·v + τ·ω, 0) dt; ∫ |F||v| + |τ||ω| dt if it turns by more than 0.5 rad in a sub-step.
//! * Resistance sensors: ∫ F·v dt with the largest force of their rays and the largest speed of any body's surface, and
//!   of the points that the rays hit.
//!
//! |q̇| is the larger one of the change of the coordinate over the step and of its rate after the sub-step by the
//! velocities of both bodies: an angle that changes by more than π in a sub-step is not seen from outside, and a sliding
//! coordinate whose bodies turn far is not the integral of its rate.

use std::f64::consts::{PI, TAU};

use ambf_core::adf::{self, ControllerOutput, Gains};
use ambf_core::comm::JointCommandType;
use ambf_core::ids::BodyId;
use ambf_core::scene::{Joint, JointType, Scene, Sensed};
use ambf_core::sim::Simulation;
use nalgebra::{Isometry3, Point3, Vector3};

use super::invariants::description;
use super::script::{Action, Script};

/// `max motor impulse` is meant per this time, s.
const IMPULSE_STEP: f64 = 0.001;

/// Turn of a body in a sub-step from which on its velocities at both ends say little of those in between, rad.
const FAR: f64 = 0.5;

/// A spring that slides across the normal of a contact is moved by other joints.
const LEAST_SHARE: f64 = 0.1;

/// What drives a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Drive {
    None,
    /// N·m or N.
    Effort(f64),
    /// Largest |effort|, N·m or N.
    Controlled(f64),
    /// Target speed, rad/s or m/s; stays on.
    Motor(f64),
}

/// A joint with what it takes to bound its drive.
struct Driven {
    gains: Gains,
    is_force: bool,
    /// N·m or N.
    motor: f64,
    drive: Drive,
    /// Coordinate before the sub-step, its rate in the sub-step before, and the latest set point.
    position: f64,
    rate: f64,
    set_point: Option<f64>,
    /// ∫|e| dt.
    integral: f64,
}

/// Bound of the work since the latest reset, J.
pub struct Work {
    joints: Vec<Driven>,
    step: f64,
    done: f64,
    /// Power of wrenches in the present sub-step: bodies with force and torque.
    wrenches: Vec<(BodyId, nalgebra::Vector3<f64>, nalgebra::Vector3<f64>, f64)>,
    /// Largest force of all resistance sensors, N.
    resistance: f64,
    /// Energy that springs of several coordinates and rays of resistance sensors can hold, J.
    elastic: f64,
}

impl Work {
    /// For sub-steps of `step` s.
    pub fn new(scene: &Scene, step: f64) -> Self {
        let driven = |joint: &Joint| {
            let controller = description(scene, joint).map(|described| described.controller).unwrap_or_default();
            Driven {
                gains: controller.gains,
                is_force: controller.output == ControllerOutput::Force,
                motor: joint.max_motor_impulse / step.min(IMPULSE_STEP),
                drive: Drive::None,
                position: joint.position,
                rate: 0.0,
                set_point: None,
                integral: 0.0,
            }
        };
        let models = || scene.models.iter().map(|model| &model.description);
        Self {
            joints: scene.joints.iter().map(driven).collect(),
            step,
            done: 0.0,
            wrenches: Vec::new(),
            resistance: models().flat_map(|model| &model.sensors).map(resistance).sum(),
            elastic: models().flat_map(|model| &model.joints).map(reserve).sum::<f64>()
                + models()
                    .flat_map(|model| &model.sensors)
                    .map(|sensor| resistance(sensor) * sensor.range)
                    .sum::<f64>(),
        }
    }

    /// Work counts from here.
    pub fn reset(&mut self) {
        self.done = 0.0;
    }

    /// Bound of the work done, J.
    pub fn done(&self) -> f64 {
        self.done
    }

    /// Energy that springs of several coordinates and rays of resistance sensors can hold, J: such springs within their
    /// limits, and what they hold now, which is more where the limits exclude the present pose.
    pub fn elastic_reserve(&self, scene: &Scene) -> f64 {
        self.elastic + scene.joints.iter().map(|joint| held(scene, joint)).sum::<f64>()
    }

    /// Notes what is commanded in sub-step `n`.
    pub fn before(&mut self, simulation: &Simulation, script: &Script, n: u64) {
        let scene = simulation.scene();
        for (driven, joint) in self.joints.iter_mut().zip(&scene.joints) {
            driven.position = joint.position;
            if !matches!(driven.drive, Drive::Motor(_)) {
                driven.drive = Drive::None;
            }
        }
        self.wrenches.clear();
        for event in script.due(n) {
            match event.action {
                Action::Joint(body, index, kind, value) => {
                    if let Some(&joint) = scene.active_joints(body).get(index) {
                        self.joints[joint.index()].command(&scene.joints[joint], kind, value, self.step);
                    }
                }
                Action::Wrench(body, force, torque) => {
                    let power = power(scene, body, &force, &torque, self.step);
                    self.wrenches.push((body, force, torque, power));
                }
                _ => (),
            }
        }
    }

    /// Adds what was done in the sub-step.
    pub fn after(&mut self, simulation: &Simulation) {
        let scene = simulation.scene();
        for (driven, joint) in self.joints.iter_mut().zip(&scene.joints) {
            self.done += driven.work(joint, rate(scene, joint), self.step);
        }
        for (body, force, torque, before) in &self.wrenches {
            self.done += power(scene, *body, force, torque, self.step).max(*before).max(0.0) * self.step;
        }
        if self.resistance > 0.0 {
            let speeds = scene.bodies.entries().filter_map(|(id, body)| {
                let (velocity, spin) = scene.world.velocity(scene.world.bodies()[id.index()])?;
                // No simple body with its own inertia reaches farther than two radii of gyration from its centre of mass.
                let gyration = if body.mass > 0.0 { (body.inertia.amax() / body.mass).sqrt() } else { 0.0 };
                Some(velocity.norm() + spin.norm() * (2.0 * gyration).max(reach_of_rays(scene, id)))
            });
            self.done += self.resistance * speeds.fold(0.0, f64::max) * self.step;
        }
    }
}

impl Driven {
    fn command(&mut self, joint: &Joint, kind: JointCommandType, value: f64, step: f64) {
        self.drive = match kind {
            JointCommandType::Effort => Drive::Effort(value),
            JointCommandType::Velocity => Drive::Motor(value.abs()),
            _ => {
                let goal = joint.limits.map_or(value, |limits| value.min(limits.high).max(limits.low));
                let mut error = goal - joint.position;
                if joint.limits.is_none() && joint.joint_type == JointType::Revolute {
                    error = (error + PI).rem_euclid(TAU) - PI;
                }
                // The first error is taken as a change from 0 or from the present position, whichever is more.
                let jump = self.set_point.map_or(error.abs().max(goal.abs()), |before| (goal - before).abs());
                self.set_point = Some(goal);
                self.integral += error.abs() * step;
                let Gains { p, i, d } = self.gains;
                let output = p.abs() * error.abs() + i.abs() * self.integral + d.abs() * jump / step;
                match self.is_force {
                    true => Drive::Controlled(output),
                    // D acts on the rate of the error, which is not only that of the set point.
                    false => Drive::Motor(output + d.abs() * self.rate.abs()),
                }
            }
        };
    }

    /// Bound of the work in a sub-step of `step` s, J; `after` is the rate of the coordinate after it.
    fn work(&mut self, joint: &Joint, after: f64, step: f64) -> f64 {
        let mut change = joint.position - self.position;
        if joint.limits.is_none() && change.abs() > PI && joint.joint_type == JointType::Revolute {
            change -= TAU.copysign(change);
        }
        // A coordinate says nothing of turns by more than π in a sub-step.
        let wraps = joint.joint_type == JointType::Revolute && after.abs() * step > PI;
        let (before, rate) = (self.rate, if wraps { after } else { change / step });
        self.rate = rate;
        let speed = before.abs().max(rate.abs()).max(after.abs());
        step * match self.drive {
            Drive::None => 0.0,
            Drive::Effort(effort) => (effort * rate).max(effort * before).max(0.0),
            Drive::Controlled(effort) => effort * speed,
            Drive::Motor(target) => self.motor * speed.min(target),
        }
    }
}

/// Largest distance from the centre of mass of a body to the points where rays of sensors hit it, or start from it and
/// hit another one, m.
fn reach_of_rays(scene: &Scene, body: BodyId) -> f64 {
    let centre = scene.world.pose(scene.world.bodies()[body.index()]).unwrap_or_default().translation.vector;
    let hits = scene.sensors.iter().flat_map(|sensor| {
        let frame = scene.bodies[sensor.parent].pose(&scene.world) * sensor.info.pose;
        let seen = sensor.rays.iter().zip(sensor.readings()).filter(|(_, reading)| reading.triggered);
        let points = seen.map(move |(ray, reading)| {
            frame * Point3::from(ray.start + ray.direction * (sensor.info.range * (1.0 - reading.measurement)))
        });
        points.zip(sensor.sensed(&scene.bodies)).map(|(point, sensed)| (point, sensor.parent, sensed))
    });
    let touching = hits.filter(|&(_, parent, sensed)| parent == body || sensed == Sensed::Body(body));
    touching.map(|(point, ..)| (point.coords - centre).norm()).fold(0.0, f64::max)
}

/// Rate of the coordinate of a joint by the velocities of its bodies, rad/s or m/s; 0 for joints that no motor drives.
fn rate(scene: &Scene, joint: &Joint) -> f64 {
    let motion = |body: BodyId| {
        let handle = scene.world.bodies()[body.index()];
        (scene.world.pose(handle).unwrap_or_default(), scene.world.velocity(handle).unwrap_or_default())
    };
    let (parent, (velocity, spin)) = motion(joint.parent);
    let (child, (child_velocity, child_spin)) = motion(joint.child);
    let axis = parent * joint.axis;
    match joint.joint_type {
        JointType::Revolute => axis.dot(&(child_spin - spin)),
        JointType::Prismatic => {
            let pivot = child * Point3::from(joint.frames[1].translation.vector);
            let of = |pose: &Isometry3<f64>, velocity: Vector3<f64>, spin: Vector3<f64>| {
                velocity + spin.cross(&(pivot.coords - pose.translation.vector))
            };
            axis.dot(&(of(&child, child_velocity, child_spin) - of(&parent, velocity, spin)))
        }
        _ => 0.0,
    }
}

/// W that force (N) and torque (N·m) put into a body. If it turns far in a sub-step of `step` s, the power in between is not
/// seen; then it is that of the same speeds along the wrench.
fn power(scene: &Scene, body: BodyId, force: &Vector3<f64>, torque: &Vector3<f64>, step: f64) -> f64 {
    let velocity = scene.world.velocity(scene.world.bodies()[body.index()]);
    velocity.map_or(0.0, |(velocity, spin)| {
        if spin.norm() * step > FAR {
            force.norm() * velocity.norm() + torque.norm() * spin.norm()
        } else {
            force.dot(&velocity) + torque.dot(&spin)
        }
    })
}

/// Energy of a spring with one coordinate, J; 0 for other joints.
pub fn spring_energy(scene: &Scene, joint: &Joint) -> f64 {
    stretched(scene, joint).map_or(0.0, |(stiffness, away)| stiffness * away.powi(2) / 2.0)
}

/// A spring with one coordinate as it is at some moment.
pub struct Spring {
    /// N/m or N·m/rad.
    stiffness: f64,
    /// Distance from rest, m or rad.
    away: f64,
    turns: bool,
    /// Where its joint is, m, and its axis; world axes.
    at: Point3<f64>,
    axis: Vector3<f64>,
}

impl Spring {
    /// Energy that it gains where a body that touches another at `point` is pushed out along `normal` by `depth`, m; J. A
    /// spring that slides does so by the share of the normal along its axis, which counts as at least a tenth; one that
    /// turns by the lever arm of the normal about its axis, which counts as at least `least`, m.
    pub fn pushed_by(&self, point: &Vector3<f64>, normal: &Vector3<f64>, depth: f64, least: f64) -> f64 {
        let share = normal.dot(&self.axis).abs().max(LEAST_SHARE);
        let arm = (point - self.at.coords).cross(normal).dot(&self.axis).abs();
        self.strained_by(depth / share, (depth / arm.max(least)).min(PI))
    }

    /// Energy that it gains where corrections move it by up to `way`, m, or `angle`, rad; J.
    pub fn strained_by(&self, way: f64, angle: f64) -> f64 {
        let by = if self.turns { angle } else { way };
        self.stiffness * by * (self.away.abs() + by / 2.0)
    }
}

/// All springs with one coordinate as they are now.
pub fn springs(scene: &Scene) -> Vec<Spring> {
    let spring = |joint: &Joint| {
        let turns = joint.joint_type == JointType::TorsionSpring;
        let parent = scene.world.pose(scene.world.bodies()[joint.parent.index()]).unwrap_or_default();
        let at = parent * Point3::from(joint.frames[0].translation.vector);
        let axis = parent * joint.axis;
        stretched(scene, joint).map(|(stiffness, away)| Spring { stiffness, away, turns, at, axis })
    };
    scene.joints.iter().filter_map(spring).collect()
}

/// Stiffness of a spring with one coordinate, N/m or N·m/rad, and how far it is from rest, m or rad; `None` for other
/// joints.
fn stretched(scene: &Scene, joint: &Joint) -> Option<(f64, f64)> {
    if !matches!(joint.joint_type, JointType::LinearSpring | JointType::TorsionSpring) {
        return None;
    }
    let (described, limits) = description(scene, joint).zip(joint.limits)?;
    let rest = described.equilibrium_point.unwrap_or((limits.low + limits.high) / 2.0);
    let away = joint.position - rest;
    // An angle is known to whole turns only.
    let away = if joint.joint_type == JointType::TorsionSpring { (away + PI).rem_euclid(TAU) - PI } else { away };
    Some((described.stiffness, away))
}

/// Largest force of a sensor, N.
fn resistance(sensor: &adf::Sensor) -> f64 {
    let adf::SensorKind::Resistance(law) = &sensor.kind else { return 0.0 };
    let rays = match &sensor.rays {
        adf::RaySource::Array(rays) => rays.len() as f64,
        _ => 100.0,
    };
    // The depth that stiffness and damping multiply is a share of the range, at most 1; what sticks slips from a drift
    // of `contact_area` on. Sliding friction only takes energy away.
    let pressing = law.contact_stiffness.abs() + law.contact_damping.abs();
    let scale = if law.variable_friction { pressing } else { 1.0 };
    let sticking = law.contact_area * (law.static_friction.abs() * scale + 2.0 * law.friction_damping.abs());
    rays * (pressing + sticking)
}

/// Energy that a six-dof spring holds now, J: of the translations of its frames, and of the rotation vector between
/// them. 0 for other joints.
fn held(scene: &Scene, joint: &Joint) -> f64 {
    let Some(adf::JointKind::SixDofSpring(spring)) = description(scene, joint).map(|described| &described.kind) else {
        return 0.0;
    };
    let pose = |body: BodyId| scene.world.pose(scene.world.bodies()[body.index()]).unwrap_or_default();
    let [parent, child] = joint.frames;
    let between = (pose(joint.parent) * parent).inverse() * (pose(joint.child) * child);
    let of = |stiffness: &Vector3<f64>, away: Vector3<f64>| stiffness.dot(&away.component_mul(&away)) / 2.0;
    of(&spring.stiffness.linear, between.translation.vector - spring.equilibrium_point.linear)
        + of(&spring.stiffness.angular, between.rotation.scaled_axis() - spring.equilibrium_point.angular)
}

/// Energy that a six-dof spring can hold within its limits, J.
fn reserve(joint: &adf::Joint) -> f64 {
    let adf::JointKind::SixDofSpring(spring) = &joint.kind else { return 0.0 };
    let of = |stiffness: &nalgebra::Vector3<f64>, low: &nalgebra::Vector3<f64>, high: &nalgebra::Vector3<f64>| {
        let range = low.abs().sup(&high.abs());
        stiffness.dot(&range.component_mul(&range)) / 2.0
    };
    let limits = &spring.limits;
    of(&spring.stiffness.linear, &limits.linear_low, &limits.linear_high)
        + of(&spring.stiffness.angular, &limits.angular_low, &limits.angular_high)
}
