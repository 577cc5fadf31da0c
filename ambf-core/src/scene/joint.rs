//! A live joint: its frames, the constraint it becomes, what is read of it and what commands do to it.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Unit, UnitQuaternion, Vector3};

use super::targets::JointTarget;
use super::{Bodies, Body};
use crate::adf::{self, ControllerOutput, JointKind, Limits, SixDofLimits, SourcePos, IMPULSE_STEP};
use crate::bullet::{Constraint, ConstraintHandle, ConstraintKind, ConstraintParameter, Resistance, Spring, World};
use crate::comm::{JointCommandType, Wrench};
use crate::control::{shortest_angle, JointController, Profile};
use crate::ids::{BodyId, JointId, ModelId};

/// What kind of coordinate a joint has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointType {
    /// Angle about an axis.
    Revolute,
    /// Distance along an axis.
    Prismatic,
    /// Distance along an axis, driven by a spring.
    LinearSpring,
    /// Angle about an axis, driven by a spring.
    TorsionSpring,
    /// Ball joint, no coordinate.
    PointToPoint,
    /// No freedom.
    Fixed,
    /// Limited ball joint, no coordinate.
    ConeTwist,
    /// No single coordinate.
    SixDof,
    /// No single coordinate.
    SixDofSpring,
    /// Unknown type: creates no constraint.
    Unknown,
}

impl JointType {
    /// The number the C++ program has for it in its traces.
    pub fn code(self) -> u8 {
        match self {
            Self::Revolute => 0,
            Self::Prismatic => 1,
            Self::LinearSpring => 2,
            Self::TorsionSpring => 3,
            Self::PointToPoint => 4,
            Self::Fixed => 5,
            Self::ConeTwist => 6,
            Self::SixDof => 7,
            Self::SixDofSpring => 8,
            Self::Unknown => 9,
        }
    }

    /// Its name in model files, or in words of this project.
    pub fn name(self) -> &'static str {
        match self {
            Self::Revolute => "revolute",
            Self::Prismatic => "prismatic",
            Self::LinearSpring => "linear spring",
            Self::TorsionSpring => "torsion spring",
            Self::PointToPoint => "p2p",
            Self::Fixed => "fixed",
            Self::ConeTwist => "cone twist",
            Self::SixDof => "six dof",
            Self::SixDofSpring => "six dof spring",
            Self::Unknown => "unknown",
        }
    }

    pub(super) fn is_angular(self) -> bool {
        matches!(self, Self::Revolute | Self::TorsionSpring)
    }

    pub(super) fn is_linear(self) -> bool {
        matches!(self, Self::Prismatic | Self::LinearSpring)
    }

    pub(super) fn has_motor(self) -> bool {
        matches!(self, Self::Revolute | Self::Prismatic)
    }
}

impl From<&JointKind> for JointType {
    fn from(kind: &JointKind) -> Self {
        match kind {
            JointKind::Revolute => Self::Revolute,
            JointKind::Prismatic => Self::Prismatic,
            JointKind::LinearSpring => Self::LinearSpring,
            JointKind::TorsionSpring => Self::TorsionSpring,
            JointKind::PointToPoint => Self::PointToPoint,
            JointKind::Fixed => Self::Fixed,
            JointKind::ConeTwist(_) => Self::ConeTwist,
            JointKind::SixDof(_) => Self::SixDof,
            JointKind::SixDofSpring(_) => Self::SixDofSpring,
            JointKind::Unknown(_) => Self::Unknown,
        }
    }
}

/// What a joint follows: its position is the sum of those of its leaders, each times the ratio beside it, plus the offset.
#[derive(Debug, Clone, PartialEq)]
pub struct JointCoupling {
    /// The leaders, and the rate of the follower over that of each.
    pub leaders: Vec<(JointId, f64)>,
    /// rad or m.
    pub offset: f64,
}

impl JointCoupling {
    /// The position that the leaders ask for where theirs are `position`, rad or m.
    pub fn asked(&self, position: impl Fn(JointId) -> f64) -> f64 {
        self.offset + self.leaders.iter().map(|&(leader, ratio)| ratio * position(leader)).sum::<f64>()
    }
}

/// A joint of a [`Scene`](super::Scene).
#[derive(Debug, Clone)]
pub struct Joint {
    /// Name without suffix.
    pub name: String,
    /// Prefix, namespace and identifier.
    pub key: String,
    /// What kind of coordinate it has.
    pub joint_type: JointType,
    /// The parent body.
    pub parent: BodyId,
    /// The child body.
    pub child: BodyId,
    /// The model that describes it.
    pub model: ModelId,
    /// Left out of states and joint commands, with its child.
    pub passive: bool,
    /// Range of the coordinate, rad or m.
    pub limits: Option<Limits>,
    /// Position commands are obeyed.
    pub enable_motor: bool,
    /// N·m·s or N·s a sub-step of 1 ms.
    pub max_motor_impulse: f64,
    /// What it loses, and what its drive can do at most.
    pub drive_train: adf::DriveTrain,
    /// What it follows.
    pub coupling: Option<JointCoupling>,
    /// Reactions are estimated.
    pub feedback: bool,
    /// Its wrench is measured.
    pub(crate) is_measured: bool,
    /// rad or m after the latest iteration.
    pub position: f64,
    /// rad/s or m/s: difference of positions over the interval before.
    pub velocity: f64,
    /// N·m or N along the axis, on the parent; 0 without feedback.
    pub effort: f64,
    /// What the joint exerts on its child in place of the parent, the mean over the latest sub-step: force, and torque about
    /// the child's end of the joint, world axes. Impulses of limits, motors and springs of the joint count, in the accurate
    /// profile also commanded efforts; corrections of positions, which are no forces, don't. 0 unless it is measured:
    /// `enable feedback`, or [`SceneOptions::joint_wrenches`](super::SceneOptions::joint_wrenches).
    pub wrench: Wrench,
    /// Where it is defined.
    pub source: SourcePos,
    /// Joint axis in the parent's inertial frame, of length 1.
    pub axis: Vector3<f64>,
    /// Joint frames in the inertial frames of parent and child; they are one where the coordinate is 0.
    pub frames: [Isometry3<f64>; 2],
    pub(crate) handle: Option<ConstraintHandle>,
    /// Where its position stands among those that are read of Bullet's constraints.
    pub(crate) place: Option<usize>,
    /// It was taken out of the scene.
    pub removed: bool,
    pub(crate) controller: JointController,
    pub(crate) output: ControllerOutput,
    pub(crate) target: JointTarget,
}

/// What of a [`Joint`] changes while the simulation runs, beside what Bullet knows.
#[derive(Debug, Clone)]
pub(super) struct SavedJoint {
    limits: Option<Limits>,
    drive_train: adf::DriveTrain,
    position: f64,
    velocity: f64,
    effort: f64,
    wrench: Wrench,
    controller: JointController,
    target: JointTarget,
}

impl Joint {
    pub(super) fn save(&self) -> SavedJoint {
        // All fields by name, so that no new one is forgotten.
        let Self {
            name: _,
            key: _,
            joint_type: _,
            parent: _,
            child: _,
            model: _,
            passive: _,
            limits,
            enable_motor: _,
            max_motor_impulse: _,
            drive_train,
            coupling: _,
            feedback: _,
            is_measured: _,
            position,
            velocity,
            effort,
            wrench,
            source: _,
            axis: _,
            frames: _,
            handle: _,
            place: _,
            removed: _,
            controller,
            output: _,
            target,
        } = self;
        SavedJoint {
            limits: *limits,
            drive_train: *drive_train,
            position: *position,
            velocity: *velocity,
            effort: *effort,
            wrench: *wrench,
            controller: controller.clone(),
            target: target.clone(),
        }
    }

    pub(super) fn restore(&mut self, saved: &SavedJoint) {
        let SavedJoint { limits, drive_train, position, velocity, effort, wrench, controller, target } = saved;
        (self.limits, self.drive_train) = (*limits, *drive_train);
        (self.position, self.velocity, self.effort, self.wrench) = (*position, *velocity, *effort, *wrench);
        self.controller.clone_from(controller);
        self.target.clone_from(target);
    }

    pub(super) fn new(
        joint: &adf::Joint,
        key: String,
        (parent, child): (BodyId, BodyId),
        model: ModelId,
        (frames, axis): ([Isometry3<f64>; 2], Vector3<f64>),
        constraint: Option<(ConstraintHandle, usize)>,
        is_measured: bool,
    ) -> Self {
        Self {
            name: joint.common.name.clone(),
            key,
            joint_type: JointType::from(&joint.kind),
            parent,
            child,
            model,
            passive: joint.common.passive,
            limits: joint.limits,
            enable_motor: joint.enable_motor,
            max_motor_impulse: joint.max_motor_impulse,
            drive_train: joint.drive_train,
            coupling: None,
            feedback: joint.enable_feedback,
            is_measured,
            position: 0.0,
            velocity: 0.0,
            effort: 0.0,
            wrench: Wrench::default(),
            source: joint.common.source.clone(),
            axis,
            frames,
            handle: constraint.map(|(handle, _)| handle),
            place: constraint.map(|(_, place)| place),
            removed: false,
            controller: JointController::new(joint.controller.gains),
            output: joint.controller.output,
            target: JointTarget::new(&joint.controller),
        }
    }

    /// Forgets what is remembered of the motion; the position is to be observed.
    pub(super) fn reset(&mut self) {
        self.effort = 0.0;
        self.wrench = Wrench::default();
        self.controller.reset();
        self.target.reset();
    }

    /// Stores a new position and the velocity that follows over `dt` s, at the end of which the rate is `rate` or not known.
    pub(crate) fn observe(&mut self, position: f64, dt: f64, rate: Option<f64>) {
        let mut difference = position - self.position;
        if self.joint_type.is_angular() {
            // Angles are known up to whole turns. Across ±π the C++ program reports a spike.
            let turned = rate.unwrap_or_default() * dt;
            difference -= TAU * ((difference - turned) / TAU).round();
        }
        self.velocity = if dt < 1e-5 { 0.0 } else { difference / dt };
        self.position = position;
    }

    /// Takes the [wrench](Self::wrench) from the reaction of the constraint.
    pub(crate) fn measure(&mut self, world: &World, bodies: &Bodies) {
        let child = bodies[self.child].handle;
        let (Some(reaction), Some(pose)) =
            (self.handle.and_then(|handle| world.joint_wrench(handle)), world.pose(child))
        else {
            return;
        };
        let [pushed, turned] = self.target.exerted_on_child(self.joint_type);
        let force = reaction.force_b + pushed;
        let arm = pose.rotation * self.frames[1].translation.vector;
        self.wrench = Wrench { force, torque: reaction.torque_b + turned - arm.cross(&force) };
    }

    /// Reaction along the axis from the feedback on the parent, rotated into its inertial frame.
    pub(crate) fn estimate_effort(&mut self, force_on_parent: &Vector3<f64>, torque_on_parent: &Vector3<f64>) {
        if self.joint_type.is_angular() {
            self.effort = self.axis.dot(torque_on_parent);
        } else if self.joint_type.is_linear() {
            self.effort = self.axis.dot(force_on_parent);
        }
    }

    /// Applies one joint command at simulated `time` s, as the legacy profile does.
    pub(crate) fn apply_command(
        &mut self,
        world: &mut World,
        bodies: &Bodies,
        kind: JointCommandType,
        value: f64,
        time: f64,
    ) {
        match kind {
            JointCommandType::Effort => self.apply_effort(world, bodies, value),
            JointCommandType::Velocity => self.set_motor(world, true, value),
            JointCommandType::Position => self.apply_position(world, bodies, value, time),
            JointCommandType::Unknown(_) => (),
        }
    }

    fn apply_position(&mut self, world: &mut World, bodies: &Bodies, value: f64, time: f64) {
        if !self.enable_motor || !self.joint_type.has_motor() {
            return;
        }
        let (process, set_point) = match self.limits {
            // Not `clamp`: the limits may be the wrong way round.
            Some(Limits { low, high }) => (self.position, value.min(high).max(low)),
            None if self.joint_type == JointType::Revolute => {
                (0.0, shortest_angle(self.position, value, Profile::Legacy))
            }
            None => (self.position, value),
        };
        let output = self.controller.update(process, set_point, time);
        match self.output {
            ControllerOutput::Force => self.apply_effort(world, bodies, output),
            ControllerOutput::Velocity | ControllerOutput::Position => self.set_motor(world, true, output),
        }
    }

    fn apply_effort(&mut self, world: &mut World, bodies: &Bodies, effort: f64) {
        self.set_motor(world, false, 0.0);
        let (parent, child) = (bodies[self.parent].handle, bodies[self.child].handle);
        let Some(pose) = world.pose(parent) else { return };
        let along = pose.rotation * self.axis * self.possible_effort(effort);
        let zero = Vector3::zeros();
        if self.joint_type.is_angular() {
            world.apply_wrench(parent, &zero, &-along);
            world.apply_wrench(child, &zero, &along);
        } else if self.joint_type.is_linear() {
            world.apply_wrench(parent, &-along, &zero);
            world.apply_wrench(child, &along, &zero);
        }
    }

    /// Switches the motor off.
    pub(crate) fn stop_motor(&self, world: &mut World) {
        self.set_motor(world, false, 0.0);
    }

    /// Gains of its position controller.
    pub fn gains(&self) -> adf::Gains {
        self.controller.gains()
    }

    /// The part of an effort, N·m or N, that its drive has.
    pub(super) fn possible_effort(&self, effort: f64) -> f64 {
        self.drive_train.max_effort.map_or(effort, |most| effort.clamp(-most, most))
    }

    /// The part of a wanted rate, rad/s or m/s, that its drive has.
    pub(super) fn possible_rate(&self, rate: f64) -> f64 {
        self.drive_train.max_rate.map_or(rate, |most| rate.clamp(-most, most))
    }

    fn set_motor(&self, world: &mut World, enabled: bool, velocity: f64) {
        let strength = match self.joint_type {
            JointType::Prismatic => self.max_motor_impulse / IMPULSE_STEP,
            _ => self.max_motor_impulse,
        };
        if let Some(handle) = self.handle {
            // Not bounded by the largest rate, which the constraint keeps: this motor gives way in proportion to what it misses.
            world.set_motor(handle, enabled, velocity, strength);
        }
    }
}

/// Joint frames in the inertial frames of parent and child, and the joint axis in the parent's.
pub(super) fn frames(
    joint: &adf::Joint,
    parent: &Body,
    child: &Body,
) -> (Isometry3<f64>, Isometry3<f64>, Vector3<f64>) {
    let (to_parent, to_child) = (&parent.inertial_offset_inverse, &child.inertial_offset_inverse);
    let axis_a = to_parent.rotation * unit(&joint.parent_axis);
    let axis_b = to_child.rotation * unit(&joint.child_axis);
    let pivot_a = to_parent * nalgebra::Point3::from(joint.parent_pivot * parent.scale);
    let pivot_b = to_child * nalgebra::Point3::from(joint.child_pivot * child.scale);
    let own_axis = if joint.kind == JointKind::Prismatic { Vector3::x() } else { Vector3::z() };

    let to_axis = rotation_between(&own_axis, &axis_a);
    let joint_turn = about(&axis_a, joint.joint_offset);
    let (rotation_a, rotation_b) = match &joint.child_rotation {
        None => {
            let child_to_parent = rotation_between(&axis_b, &axis_a);
            let child_turn = about(&axis_a, joint.child_offset);
            (joint_turn * to_axis, child_to_parent.inverse() * child_turn.inverse() * joint_turn * to_axis)
        }
        Some(child_in_parent) => {
            // The C++ program's rotation misses an axis that is nearly parallel to its own by up to 0.001 rad.
            let rest = UnitQuaternion::rotation_between(&(to_axis * own_axis), &axis_a).unwrap_or_default();
            let rotation_a = joint_turn * rest * to_axis;
            let child_in_parent = to_parent.rotation * child_in_parent * child.inertial_offset.rotation;
            (rotation_a, child_in_parent.inverse() * rotation_a)
        }
    };
    (Isometry3::from_parts(pivot_a.into(), rotation_a), Isometry3::from_parts(pivot_b.into(), rotation_b), axis_a)
}

fn unit(v: &Vector3<f64>) -> Vector3<f64> {
    // Only point-to-point joints may have a zero axis, and they don't use it.
    v.try_normalize(0.0).unwrap_or_else(Vector3::z)
}

fn about(axis: &Vector3<f64>, angle: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Unit::new_normalize(*axis), angle)
}

/// An angle below the first counts as none, one above the second as half a turn: the C++ program's numbers.
const NEARLY_NONE: f64 = 0.001;
#[allow(clippy::approx_constant, reason = "the C++ program's number, not π")]
const NEARLY_HALF_TURN: f64 = 3.14;

/// The rotation from `u` to `v` with the C++ program's choice of axis where it is not unique.
fn rotation_between(u: &Vector3<f64>, v: &Vector3<f64>) -> UnitQuaternion<f64> {
    let angle = angle_between(u, v);
    let axis = if angle < NEARLY_NONE {
        Vector3::z()
    } else if angle > NEARLY_HALF_TURN {
        let off_x = angle_between(u, &Vector3::x());
        if off_x > NEARLY_NONE && off_x < NEARLY_HALF_TURN {
            u.cross(&Vector3::x())
        } else {
            v.cross(&Vector3::y())
        }
    } else {
        u.cross(v)
    };
    about(&axis, angle)
}

fn angle_between(u: &Vector3<f64>, v: &Vector3<f64>) -> f64 {
    let lengths = u.norm() * v.norm();
    if lengths < 1e-9 {
        0.0
    } else {
        (u.dot(v) / lengths).clamp(-1.0, 1.0).acos()
    }
}

/// What resists its motion; `None` for joints without a drive, and those that nothing resists.
pub(super) fn resistance(joint: &adf::Joint) -> Option<Resistance> {
    let adf::DriveTrain { damping, armature, friction, max_effort: _, max_rate } = joint.drive_train;
    let has_any = damping > 0.0 || armature > 0.0 || friction > 0.0 || max_rate.is_some();
    (JointType::from(&joint.kind).has_motor() && has_any).then(|| resistance_of(&joint.drive_train))
}

/// What resists the motion of a joint with a drive.
pub(super) fn resistance_of(drive_train: &adf::DriveTrain) -> Resistance {
    let adf::DriveTrain { damping, armature, friction, max_effort: _, max_rate } = *drive_train;
    Resistance { damping, armature, friction, max_rate: max_rate.unwrap_or(f64::INFINITY) }
}

/// The Bullet constraint that a joint becomes; `None` for an unknown type.
///
/// `erp`: share of the position error that every joint corrects in a sub-step, without giving way to its load. `None`:
/// as the description and Bullet's own defaults say.
pub(super) fn constraint(
    joint: &adf::Joint,
    frame_a: Isometry3<f64>,
    frame_b: Isometry3<f64>,
    erp: Option<f64>,
) -> Option<Constraint> {
    use ConstraintParameter::{Cfm, Erp, StopErp};
    let limits = joint.limits.map(|Limits { low, high }| [low, high]);
    let stiff = erp;
    let (erp, cfm) = stiff.map_or((joint.erp, joint.cfm), |erp| (erp, 0.0));
    // Of these types Bullet knows errors of their limits only; a locked axis is one.
    let all_axes = || stiff.map_or(vec![], |erp| (0..6).map(|axis| (StopErp, erp, axis)).collect());
    let one_axis = |axis| if stiff.is_some() { all_axes() } else { vec![(StopErp, erp, axis), (Cfm, cfm, axis)] };
    let (kind, parameters) = match &joint.kind {
        JointKind::Revolute => (ConstraintKind::Hinge { limits }, vec![(Erp, erp, -1), (Cfm, cfm, -1)]),
        JointKind::Prismatic => (ConstraintKind::Slider { limits }, vec![(Cfm, cfm, -1)]),
        JointKind::Fixed => (ConstraintKind::Fixed, all_axes()),
        JointKind::PointToPoint => (ConstraintKind::PointToPoint, vec![(Erp, erp, -1), (Cfm, cfm, -1)]),
        JointKind::LinearSpring => (one_axis_spring(joint, 2), one_axis(2)),
        JointKind::TorsionSpring => (one_axis_spring(joint, 5), one_axis(5)),
        JointKind::ConeTwist(span) => {
            let kind = ConstraintKind::ConeTwist { swing1: span.swing_z, swing2: span.swing_y, twist: span.twist };
            (kind, vec![])
        }
        JointKind::SixDof(limits) => (ConstraintKind::SixDof(six_limits(limits)), all_axes()),
        JointKind::SixDofSpring(spring) => {
            let axis = |i: usize| {
                let pick = |v: &adf::LinearAngular| if i < 3 { v.linear[i] } else { v.angular[i - 3] };
                // Bullet's angles have the opposite sign.
                let sign = if i < 3 { 1.0 } else { -1.0 };
                Some(Spring {
                    enabled: true,
                    stiffness: pick(&spring.stiffness),
                    damping: pick(&spring.damping),
                    equilibrium: Some(sign * pick(&spring.equilibrium_point)),
                })
            };
            let springs = std::array::from_fn(axis);
            (ConstraintKind::SixDofSpring { limits: six_limits(&spring.limits), springs }, all_axes())
        }
        JointKind::Unknown(_) => return None,
    };
    Some(Constraint {
        kind,
        frame_a,
        frame_b,
        parameters,
        feedback: joint.enable_feedback,
        disable_collisions: joint.ignore_inter_collision,
    })
}

fn six_limits(limits: &SixDofLimits) -> [[f64; 2]; 6] {
    std::array::from_fn(|i| {
        if i < 3 {
            [limits.linear_low[i], limits.linear_high[i]]
        } else {
            // Bullet's angles have the opposite sign.
            [-limits.angular_high[i - 3], -limits.angular_low[i - 3]]
        }
    })
}

fn one_axis_spring(joint: &adf::Joint, axis: usize) -> ConstraintKind {
    // Bullet's angles have the opposite sign.
    let sign = if axis < 3 { 1.0 } else { -1.0 };
    let mut limits = [[0.0; 2]; 6];
    let mut springs = [None; 6];
    let mut spring = Spring { enabled: false, stiffness: joint.stiffness, damping: joint.damping, equilibrium: None };
    if let Some(Limits { low, high }) = joint.limits {
        limits[axis] = if axis < 3 { [low, high] } else { [-high, -low] };
        spring.enabled = true;
        spring.equilibrium = Some(sign * joint.equilibrium_point.unwrap_or((low + high) / 2.0));
    }
    springs[axis] = Some(spring);
    ConstraintKind::SixDofSpring { limits, springs }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_carry_one_axis_to_the_other() {
        let axes =
            [Vector3::x(), Vector3::y(), Vector3::z(), -Vector3::x(), -Vector3::z(), Vector3::new(1.0, 2.0, -3.0)];
        for u in &axes {
            for v in &axes {
                let turned = rotation_between(u, v) * unit(u);
                assert!((turned - unit(v)).norm() < 2e-3, "{u} to {v} gives {turned}");
            }
        }
        assert!((rotation_between(&Vector3::x(), &Vector3::y()).angle() - TAU / 4.0).abs() < 1e-12);
    }
}
