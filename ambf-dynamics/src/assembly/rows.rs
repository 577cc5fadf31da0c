//! Rows of a joint: its position errors and their derivatives.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Translation3, UnitQuaternion, UnitVector3, Vector3, Vector6};

use super::{Body, Joint, Kind, Omission, Range};

/// How far a joint is open: violated limits count, free coordinates do not.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Gap {
    /// Distance, m.
    pub distance: f64,
    /// Angle, rad.
    pub angle: f64,
}

impl Gap {
    /// Whether it exceeds `distance` (m) or `angle` (rad).
    pub fn exceeds(&self, distance: f64, angle: f64) -> bool {
        self.distance > distance || self.angle > angle
    }
}

/// Constraint of a row on its coordinate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Demand {
    /// Nothing.
    None,
    /// To be zero.
    Zero,
    /// To lie within `low`…`high`.
    Within(Range),
}

/// A coordinate of a joint with its derivatives by the twists of the bodies.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    pub demand: Demand,
    /// m or rad.
    pub value: f64,
    /// Whether the coordinate is an angle.
    pub angular: bool,
    /// Derivatives by the velocity (m/s) of the centre of mass and the angular velocity (rad/s) of A and B, in world
    /// axes.
    pub jacobians: [Vector6<f64>; 2],
}

impl Row {
    const NONE: Self = Self {
        demand: Demand::None,
        value: 0.0,
        angular: false,
        jacobians: [Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0); 2],
    };

    /// Whether the coordinate has one admissible value.
    pub fn is_locked(&self) -> bool {
        match self.demand {
            Demand::None => false,
            Demand::Zero => true,
            Demand::Within(range) => range.is_locked(),
        }
    }

    /// Error: the coordinate itself, or by how much it exceeds its range (negative below it).
    pub fn error(&self) -> f64 {
        match self.demand {
            Demand::None => 0.0,
            Demand::Zero => self.value,
            Demand::Within(range) => outside(self.value, &range),
        }
    }
}

fn outside(value: f64, range: &Range) -> f64 {
    (value - range.high).max(0.0) + (value - range.low).min(0.0)
}

/// How far `joint` is open at the poses of `bodies`.
pub fn gap(joint: &Joint, bodies: &[Body]) -> Gap {
    let mut gap = Gap::default();
    for row in rows(joint, &joint.bodies.map(|body| bodies[body].pose)) {
        let part = if row.angular { &mut gap.angle } else { &mut gap.distance };
        *part = part.hypot(row.error());
    }
    gap
}

/// The row of the coordinate that a joint leaves free, with its derivatives.
///
/// # Panics
/// When the joint is neither revolute nor prismatic.
pub(super) fn coordinate(joint: &Joint, poses: &[Isometry3<f64>; 2]) -> Row {
    let rows = rows(joint, poses);
    match joint.kind {
        Kind::Revolute(_) => rows[5],
        Kind::Prismatic(_) => rows[0],
        _ => panic!("a joint without a single coordinate is coupled"),
    }
}

/// The error of a coupling of `own`, the row of the follower, to `others` with their ratios: an angle counts up to whole turns.
pub(super) fn coupling_error(own: &Row, others: impl Iterator<Item = (f64, f64)>, offset: f64) -> f64 {
    let error = own.value - others.map(|(value, ratio)| value * ratio).sum::<f64>() - offset;
    if own.angular {
        wrap(error)
    } else {
        error
    }
}

/// Position of the joint frames and what is needed for rows.
struct Frames {
    /// World poses of the joint frames on A and B.
    world: [Isometry3<f64>; 2],
    /// From the centre of mass of A, and of B, to the origin of the frame on B, m.
    arms: [Vector3<f64>; 2],
    /// From the origin of the frame on A to that on B, m.
    gap: Vector3<f64>,
    omission: Omission,
    /// Filled so far.
    rows: [Row; 6],
    n: usize,
}

/// The rows of `joint` with its bodies at `poses`; unused ones are at the end.
pub(super) fn rows(joint: &Joint, poses: &[Isometry3<f64>; 2]) -> [Row; 6] {
    let world = [poses[0] * joint.frames[0], poses[1] * joint.frames[1]];
    let origin = world[1].translation.vector;
    let mut frames = Frames {
        arms: [origin - poses[0].translation.vector, origin - poses[1].translation.vector],
        gap: origin - world[0].translation.vector,
        world,
        omission: joint.omission,
        rows: [Row::NONE; 6],
        n: 0,
    };
    match joint.kind {
        Kind::Revolute(range) => {
            frames.coincide();
            frames.hinge(2, range);
        }
        Kind::Prismatic(range) => {
            frames.linear(0, wanted(range));
            frames.linear(1, Demand::Zero);
            frames.linear(2, Demand::Zero);
            frames.align(&UnitQuaternion::identity());
        }
        Kind::Fixed => {
            frames.coincide();
            frames.align(&UnitQuaternion::identity());
        }
        Kind::PointToPoint => frames.coincide(),
        Kind::ConeTwist { twist, swing_y, swing_z } => {
            frames.coincide();
            frames.cone(twist, swing_y, swing_z);
        }
        Kind::SixDof { linear, angular } => {
            (0..3).for_each(|axis| frames.linear(axis, wanted(linear[axis])));
            frames.six_dof_angles(&angular);
        }
    }
    frames.rows
}

fn within(clearance: f64) -> Demand {
    Demand::Within(Range::new(-clearance, clearance))
}

fn wanted(range: Range) -> Demand {
    // A comparison that is also false for what is not a number.
    if range.low <= range.high {
        Demand::Within(range)
    } else {
        Demand::None
    }
}

impl Frames {
    fn axis(&self, of: usize, axis: usize) -> Vector3<f64> {
        self.world[of].rotation * Vector3::ith(axis, 1.0)
    }

    fn push(&mut self, demand: Demand, value: f64, jacobians: [Vector6<f64>; 2], angular: bool) {
        self.rows[self.n] = Row { demand, value, angular, jacobians };
        self.n += 1;
    }

    /// The gap along an axis of frame A, which turns with A, or along one of those that the omission names.
    fn linear(&mut self, axis: usize, demand: Demand) {
        let Omission { axes, side, linear, clearance, .. } = self.omission;
        let along = self.world[side].rotation * (axes * Vector3::ith(axis, 1.0));
        // The arms end at the origin of the frame in which the axis is not fixed: its turning is counted in.
        let back = if side == 0 { Vector3::zeros() } else { self.gap };
        let arms = self.arms.map(|arm| arm - back);
        let jacobians = [twist(-along, -arms[0].cross(&along)), twist(along, arms[1].cross(&along))];
        let demand = if linear[axis] { within(clearance.distance) } else { demand };
        self.push(demand, self.gap.dot(&along), jacobians, false);
    }

    /// The origins coincide.
    fn coincide(&mut self) {
        (0..3).for_each(|axis| self.linear(axis, Demand::Zero));
    }

    /// A coordinate that changes with the angular velocity of B against A along `direction`.
    fn angular(&mut self, direction: &Vector3<f64>, value: f64, demand: Demand) {
        let jacobians = [twist(Vector3::zeros(), -direction), twist(Vector3::zeros(), *direction)];
        self.push(demand, value, jacobians, true);
    }

    /// What is asked of the angle about an axis of frame A that the joint locks.
    fn asked_about(&self, axis: usize) -> Demand {
        if self.omission.angular[axis] {
            within(self.omission.clearance.angle)
        } else {
            Demand::Zero
        }
    }

    /// Frame B is turned against frame A by `target`, seen in frame A: three rows of the rotation vector of the
    /// deviation.
    fn align(&mut self, target: &UnitQuaternion<f64>) {
        let deviation = self.world[1].rotation * (self.world[0].rotation * target).inverse();
        let vector = deviation.scaled_axis();
        for axis in 0..3 {
            let along = self.axis(0, axis);
            self.angular(&along, vector.dot(&along), self.asked_about(axis));
        }
    }

    /// The `axis` of both frames is the same, and the angle about it is in `range`.
    fn hinge(&mut self, axis: usize, range: Range) {
        let (own, other) = (self.axis(0, axis), self.axis(1, axis));
        let normal = own.cross(&other);
        let angle = normal.norm().atan2(own.dot(&other));
        // The direction of a half turn is not unique.
        let direction = normal.try_normalize(1e-300).unwrap_or_else(|| self.axis(0, (axis + 1) % 3));
        for across in [(axis + 1) % 3, (axis + 2) % 3] {
            let along = self.axis(0, across);
            self.angular(&along, angle * direction.dot(&along), self.asked_about(across));
        }
        let (first, second) = (self.axis(0, (axis + 1) % 3), self.axis(0, (axis + 2) % 3));
        let turned = self.axis(1, (axis + 1) % 3);
        let angle = turned.dot(&second).atan2(turned.dot(&first));
        self.angular(&own, nearest(angle, &range), wanted(range));
    }

    /// Swing of axis x in an ellipse, and twist about it: the decomposition of Bullet's `btConeTwistConstraint`.
    fn cone(&mut self, most_twist: f64, swing_y: f64, swing_z: f64) {
        let (own, other) = (self.axis(0, 0), self.axis(1, 0));
        let normal = other.cross(&own);
        let angle = normal.norm().atan2(own.dot(&other));
        let direction = normal.try_normalize(1e-300).unwrap_or_else(|| self.axis(1, 1));
        // Radius of the ellipse in the direction of the swing.
        let in_b = self.world[1].rotation.inverse() * direction;
        let (y, z) = (in_b.y / swing_y.max(1e-9), in_b.z / swing_z.max(1e-9));
        let most = in_b.y.hypot(in_b.z) / y.hypot(z);
        self.angular(&-direction, angle, Demand::Within(Range::new(f64::NEG_INFINITY, most)));
        let swing = UnitQuaternion::rotation_between(&other, &own)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&UnitVector3::new_unchecked(direction), PI));
        let rest = self.world[0].rotation.inverse() * swing * self.world[1].rotation;
        let along = (own + other) / (1.0 + own.dot(&other)).max(1e-6);
        self.angular(&along, wrap(2.0 * rest.i.atan2(rest.w)), wanted(Range::new(-most_twist, most_twist)));
    }

    fn six_dof_angles(&mut self, ranges: &[Range; 3]) {
        let locked = ranges.map(|range| range.is_locked());
        let is_zero = |axis: usize| ranges[axis] == Range::LOCKED;
        if locked == [true; 3] {
            let target = UnitQuaternion::from_euler_angles(ranges[0].low, ranges[1].low, ranges[2].low);
            return self.align(&target);
        }
        if let Some(free) = (0..3).find(|&axis| is_zero((axis + 1) % 3) && is_zero((axis + 2) % 3)) {
            return self.hinge(free, ranges[free]);
        }
        let relative = self.world[0].rotation.inverse() * self.world[1].rotation;
        let (alpha, beta, gamma) = relative.euler_angles();
        // Near β = ±π/2 the other two angles are not unique, and their derivatives would grow without bound.
        let cosine = beta.cos().max(0.05);
        let (sin, cos) = gamma.sin_cos();
        let towards_alpha = Vector3::new(cos, sin, 0.0) / cosine;
        let directions = [towards_alpha, Vector3::new(-sin, cos, 0.0), Vector3::z() + towards_alpha * beta.sin()];
        for (axis, angle) in [alpha, beta, gamma].into_iter().enumerate() {
            let direction = self.world[0].rotation * directions[axis];
            self.angular(&direction, nearest(angle, &ranges[axis]), wanted(ranges[axis]));
        }
    }
}

fn twist(linear: Vector3<f64>, angular: Vector3<f64>) -> Vector6<f64> {
    Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
}

/// The pose of frame B in frame A that a joint allows and that is near `pose`: its free coordinates are kept, as far as
/// their ranges allow, and the others are those of a closed joint.
pub(super) fn admissible(kind: &Kind, pose: &Isometry3<f64>) -> Isometry3<f64> {
    let turned = |rotation| Isometry3::from_parts(Translation3::identity(), rotation);
    let about = |axis: usize, range: &Range| {
        let angle = wrap(2.0 * pose.rotation.imag()[axis].atan2(pose.rotation.w));
        turned(UnitQuaternion::from_scaled_axis(Vector3::ith(axis, bounded(nearest(angle, range), range))))
    };
    match kind {
        Kind::Revolute(range) => about(2, range),
        Kind::Prismatic(range) => Isometry3::translation(bounded(pose.translation.x, range), 0.0, 0.0),
        Kind::Fixed => Isometry3::identity(),
        Kind::PointToPoint => turned(pose.rotation),
        Kind::ConeTwist { .. } => {
            let joint =
                Joint { kind: *kind, bodies: [0, 1], frames: [Isometry3::identity(); 2], omission: Omission::NONE };
            let closed = turned(pose.rotation);
            let is_open = rows(&joint, &[Isometry3::identity(), closed]).iter().any(|row| row.error() != 0.0);
            if is_open {
                Isometry3::identity()
            } else {
                closed
            }
        }
        Kind::SixDof { linear, angular } => {
            let origin = Vector3::from_fn(|axis, _| bounded(pose.translation.vector[axis], &linear[axis]));
            let is_zero = |axis: usize| angular[axis] == Range::LOCKED;
            let rotation = match (0..3).find(|&axis| is_zero((axis + 1) % 3) && is_zero((axis + 2) % 3)) {
                Some(axis) => about(axis, &angular[axis]).rotation,
                None => {
                    let (alpha, beta, gamma) = pose.rotation.euler_angles();
                    let angle = |axis: usize, angle: f64| bounded(nearest(angle, &angular[axis]), &angular[axis]);
                    UnitQuaternion::from_euler_angles(angle(0, alpha), angle(1, beta), angle(2, gamma))
                }
            };
            Isometry3::from_parts(origin.into(), rotation)
        }
    }
}

/// The value, or the end of its range that is next to it.
fn bounded(value: f64, range: &Range) -> f64 {
    // Not `clamp`, which panics where the ends are the wrong way round.
    if range.low <= range.high {
        value.min(range.high).max(range.low)
    } else {
        value
    }
}

/// In −π…π.
fn wrap(angle: f64) -> f64 {
    let rest = angle.rem_euclid(TAU);
    if rest > PI {
        rest - TAU
    } else {
        rest
    }
}

/// The angle, by whole turns nearest to the middle of the range.
fn nearest(angle: f64, range: &Range) -> f64 {
    let middle = (range.low + range.high) / 2.0;
    if range.low <= range.high && middle.is_finite() {
        middle + wrap(angle - middle)
    } else {
        angle
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(a: [f64; 3], b: [f64; 3]) -> Isometry3<f64> {
        Isometry3::new(Vector3::from(a), Vector3::from(b))
    }

    fn kinds() -> Vec<Kind> {
        let narrow = Range::new(-0.01, 0.01);
        vec![
            Kind::Revolute(narrow),
            Kind::Prismatic(narrow),
            Kind::Fixed,
            Kind::PointToPoint,
            Kind::ConeTwist { twist: 0.01, swing_y: 0.02, swing_z: 0.02 },
            Kind::SixDof { linear: [narrow; 3], angular: [narrow; 3] },
            Kind::SixDof { linear: [Range::LOCKED; 3], angular: [Range::LOCKED, Range::LOCKED, narrow] },
        ]
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        const STEP: f64 = 1e-6;
        for kind in kinds() {
            let frames = [pose([0.1, 0.2, -0.3], [0.3, -0.8, 0.4]), pose([-0.2, 0.1, 0.2], [-0.5, 0.2, 0.9])];
            let body = pose([1.0, 2.0, 3.0], [0.4, 1.1, -0.6]);
            // Small errors: the axes of rows are those at closed joints.
            let error = pose([2e-3, -1e-3, 3e-3], [3e-4, -2e-4, 4e-4]);
            let free = match kind {
                Kind::ConeTwist { .. } => pose([0.0; 3], [0.1, 0.2, -0.3]),
                Kind::SixDof { angular: [Range { low: 0.0, .. }, ..], .. } | Kind::Revolute(_) => {
                    pose([0.0; 3], [0.0, 0.0, 0.5])
                }
                Kind::SixDof { .. } => pose([0.1, 0.2, 0.3], [0.4, -0.3, 0.5]),
                Kind::Prismatic(_) => pose([0.3, 0.0, 0.0], [0.0; 3]),
                _ => Isometry3::identity(),
            };
            let poses = [body, body * frames[0] * free * error * frames[1].inverse()];
            let joint = Joint { kind, bodies: [0, 1], frames, omission: Omission::NONE };
            let at = rows(&joint, &poses);
            for (moved, axis) in (0..2).flat_map(|moved| (0..6).map(move |axis| (moved, axis))) {
                let shifted = |step: f64| {
                    let mut poses = poses;
                    let delta = Vector6::ith(axis, step);
                    poses[moved].translation.vector += delta.fixed_rows::<3>(0);
                    poses[moved].rotation =
                        UnitQuaternion::from_scaled_axis(delta.fixed_rows::<3>(3).into_owned()) * poses[moved].rotation;
                    rows(&joint, &poses)
                };
                let (after, before) = (shifted(STEP), shifted(-STEP));
                for (index, row) in at.iter().enumerate().filter(|(_, row)| row.demand != Demand::None) {
                    let measured = (after[index].value - before[index].value) / (2.0 * STEP);
                    let exact = row.jacobians[moved][axis];
                    assert!(
                        (measured - exact).abs() < 2e-3,
                        "{kind:?} row {index} by {moved}/{axis}: {measured} {exact}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_closed_joint_has_no_gap_and_an_open_one_says_how_far() {
        let body = |pose| Body { pose, mass: 1.0, inertia: Vector3::repeat(1.0), movable: true };
        let frames = [pose([0.1, 0.2, -0.3], [0.3, -0.8, 0.4]), pose([-0.2, 0.1, 0.2], [-0.5, 0.2, 0.9])];
        let a = pose([1.0, 2.0, 3.0], [0.4, 1.1, -0.6]);
        let between = |relative: Isometry3<f64>, kind| {
            let bodies = [body(a), body(a * frames[0] * relative * frames[1].inverse())];
            gap(&Joint { kind, bodies: [0, 1], frames, omission: Omission::NONE }, &bodies)
        };
        for kind in kinds() {
            let gap = between(Isometry3::identity(), kind);
            assert!(gap.distance < 1e-15 && gap.angle < 1e-15, "{kind:?}: {gap:?}");
        }
        let turned = |axis: usize| {
            Isometry3::from_parts(
                nalgebra::Translation3::new(0.3, 0.0, 0.4),
                UnitQuaternion::from_scaled_axis(Vector3::ith(axis, 0.3)),
            )
        };
        let range = Range::new(-0.1, 0.1);
        let close = |gap: Gap, distance: f64, angle: f64| {
            assert!((gap.distance - distance).abs() < 1e-12 && (gap.angle - angle).abs() < 1e-12, "{gap:?}");
        };
        close(between(turned(2), Kind::Revolute(range)), 0.5, 0.2);
        close(between(turned(2), Kind::Revolute(Range::FREE)), 0.5, 0.0);
        close(between(turned(1), Kind::Revolute(Range::FREE)), 0.5, 0.3);
        close(between(turned(2), Kind::Prismatic(range)), 0.2f64.hypot(0.4), 0.3);
        close(between(turned(2), Kind::Fixed), 0.5, 0.3);
        close(between(turned(2), Kind::PointToPoint), 0.5, 0.0);
        let cone = |swing_y, swing_z, twist| Kind::ConeTwist { twist, swing_y, swing_z };
        close(between(turned(0), cone(0.1, 0.1, 0.1)), 0.5, 0.2);
        close(between(turned(1), cone(0.1, 0.5, 0.1)), 0.5, 0.2);
        close(between(turned(2), cone(0.5, 0.1, 0.1)), 0.5, 0.2);
        let six = |angular| Kind::SixDof { linear: [range, Range::FREE, Range::LOCKED], angular };
        close(between(turned(1), six([Range::FREE, range, Range::FREE])), 0.2f64.hypot(0.4), 0.2);
        close(between(turned(1), six([Range::LOCKED; 3])), 0.2f64.hypot(0.4), 0.3);
    }
}
