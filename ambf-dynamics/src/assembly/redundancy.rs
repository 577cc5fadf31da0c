//! Rows of loops that repeat what other rows demand.

use std::collections::{HashMap, HashSet};

use nalgebra::{DVector, Isometry3, Matrix3, SymmetricEigen, UnitQuaternion, Vector3};

use super::island::{partition, Island, Parts};
use super::rows::{rows, Gap, Row};
use super::{Body, Joint, Kind, Omission, Range};

/// Sine of the angle between a row and the span of the rows before it, up to which it may be redundant. In real files it
/// is up to 0.01 (pivots that are off by a few tenths of a mm, axes by half a degree).
const DEPENDENT: f64 = 0.03;

/// The same, up to which a row counts as redundant to rounding errors.
const EXACT: f64 = 1e-6;

/// Errors of redundant rows in a displaced mechanism, rad and as a share of the lever arm: up to the first the solver copes
/// with them, beyond the second the row is a constraint of its own.
const HARMLESS: f64 = 1e-5;
const TOLERATED: f64 = 0.01;

/// Error from which on rows that are left out are asked for nevertheless, rad and as a share of the lever arm: so many times
/// the largest misfit within [`DISPLACEMENT`], which grows with the displacement, between two bounds.
const GROWTH: f64 = 4.0;
const LEAST_CLEARANCE: f64 = 0.01;
const CLEARANCE: f64 = 0.02;

/// Displacement of the mechanism to see whether rows stay redundant, rad; how many displacements are tried.
const DISPLACEMENT: f64 = 0.3;
const SAMPLES: usize = 6;

/// Least and greatest turn of a body in a displacement that says anything, as a share of [`DISPLACEMENT`].
const LEAST_DISPLACEMENT: f64 = 0.1;
const MOST_DISPLACEMENT: f64 = 4.0;

/// Loops with more rows than that are left as they are: the cost of this analysis is of the third order.
const MAX_ROWS: usize = 500;

/// Least lever arm of a body as a share of the longest.
const LEAST_ARM: f64 = 1e-3;

/// Joints that form closed loops, of which some rows are left out.
#[derive(Debug, Clone, PartialEq)]
pub struct Loops {
    /// All of them: without one of these the others do not imply what is left out.
    pub joints: Vec<usize>,
    /// Joints of which rows are left out, with their largest misfit in the displacements that were tried.
    pub omitted: Vec<(usize, Gap)>,
}

/// Leaves out those rows of the joints of closed loops that the other rows imply to within the inaccuracies of a file, and
/// returns the loops of which there are some. To be called with assembled bodies; [`assemble`](super::assemble) then closes
/// the rows that are left.
///
/// A mechanism such as a parallelogram with a third bar, or with a ball joint at its remote centre of motion, has more
/// constraints than it needs. It moves only if its dimensions are exact. A file rounds them: as rigid constraints its
/// joints then lock the mechanism, and a least-squares compromise between them pulls it back to where they fit best. As
/// in other programs of multi-body dynamics, such rows are left out.
///
/// The rows of the joints of a spanning tree, and then those of the joints that close loops, are orthogonalised one after
/// the other, in coordinates in which the rotation of each body counts with its longest lever arm, without masses. A row
/// (of linear rows: a direction, an eigenvector of the Gram matrix of the residuals) whose residual is below 0.03 is a
/// candidate. It may also be a row of a singular configuration. So the mechanism is displaced by 0.3 rad along random
/// motions that the other rows allow, and projected onto these: a candidate that is violated by more than 0.01 rad, or
/// 0.01 of the lever arm, is a constraint of its own and stays. So do joints whose rows are violated by less than 1e-5: the
/// solver copes with them, in all configurations. What is left out comes into force again where it is violated by more than
/// four times what was found, at least 0.01 and at most 0.02 rad, or of the lever arm.
pub fn omit_redundant_rows(bodies: &[Body], joints: &mut [Joint]) -> Vec<Loops> {
    let mut all = Vec::new();
    for Parts { joints: joints_of, .. } in partition(bodies, joints, &[]) {
        let in_loops = joints_of_loops(bodies, joints, joints_of);
        let Some(mechanism) = Mechanism::new(bodies, joints, &in_loops) else { continue };
        let mut omitted = Vec::new();
        for (&index, (omission, misfit)) in in_loops.iter().zip(mechanism.omissions()) {
            if omission.count() > 0 {
                joints[index].omission = omission;
                omitted.push((index, misfit));
            }
        }
        if !omitted.is_empty() {
            all.push(Loops { joints: in_loops, omitted });
        }
    }
    all
}

/// Without the joints of bodies that hang on one joint only, again and again. All bodies that do not move are one.
fn joints_of_loops(bodies: &[Body], joints: &[Joint], mut joints_of: Vec<usize>) -> Vec<usize> {
    let mut joints_at: HashMap<usize, Vec<usize>> = HashMap::new();
    for &joint in &joints_of {
        joints[joint].bodies.into_iter().for_each(|body| joints_at.entry(body).or_default().push(joint));
    }
    let mut degrees: HashMap<usize, usize> = joints_at.iter().map(|(&body, at)| (body, at.len())).collect();
    let hangs = |degrees: &HashMap<usize, usize>, body: usize| bodies[body].movable && degrees[&body] == 1;
    let mut hanging: Vec<usize> = degrees.keys().copied().filter(|&body| hangs(&degrees, body)).collect();
    let mut is_gone = HashSet::new();
    while let Some(body) = hanging.pop() {
        let Some(&joint) = joints_at[&body].iter().find(|joint| !is_gone.contains(*joint)) else { continue };
        is_gone.insert(joint);
        for body in joints[joint].bodies {
            degrees.entry(body).and_modify(|degree| *degree -= 1);
            if hangs(&degrees, body) {
                hanging.push(body);
            }
        }
    }
    joints_of.retain(|joint| !is_gone.contains(joint));
    joints_of
}

/// The bodies and joints of loops, by themselves.
struct Mechanism {
    bodies: Vec<Body>,
    joints: Vec<Joint>,
    /// Joints in the order in which their rows are orthogonalised; how many of them are those of a spanning tree.
    order: Vec<usize>,
    tree: usize,
    /// Where the coordinates of each body begin; `None`: it does not move.
    starts: Vec<Option<usize>>,
    /// Longest lever arm of each body, m.
    arms: Vec<f64>,
    /// Number of coordinates.
    size: usize,
}

/// What is found at one configuration.
struct Selection {
    omissions: Vec<Omission>,
    /// Orthonormal basis of the rows that stay.
    basis: Vec<DVector<f64>>,
}

impl Mechanism {
    /// `None` where there are no loops, or too large ones.
    fn new(bodies: &[Body], joints: &[Joint], loops: &[usize]) -> Option<Self> {
        let mut named: Vec<usize> = loops.iter().flat_map(|&joint| joints[joint].bodies).collect();
        named.sort_unstable();
        named.dedup();
        let place = |body: usize| named.binary_search(&body).unwrap_or_default();
        let mut own: Vec<Body> = named.iter().map(|&body| bodies[body].clone()).collect();
        let own_joints: Vec<Joint> = loops
            .iter()
            .map(|&joint| {
                let Joint { kind, bodies, frames, .. } = &joints[joint];
                // Limits do not say what the joints of a loop imply.
                let kind = without_limits(kind);
                Joint { kind, bodies: bodies.map(place), frames: *frames, omission: Omission::NONE }
            })
            .collect();
        // A mechanism that floats is held by one of its bodies.
        if own.iter().all(|body| body.movable) {
            own.first_mut()?.movable = false;
        }
        let mut arms = vec![0.0f64; own.len()];
        for joint in &own_joints {
            for (&body, frame) in joint.bodies.iter().zip(&joint.frames) {
                arms[body] = arms[body].max(frame.translation.vector.norm());
            }
        }
        let moving = own.iter().zip(&arms).filter(|(body, _)| body.movable);
        let longest = moving.map(|(_, arm)| *arm).fold(0.0, f64::max);
        if !(longest > 0.0 && longest.is_finite()) {
            return None;
        }
        arms.iter_mut().for_each(|arm| *arm = arm.max(LEAST_ARM * longest));
        let mut size = 0;
        let starts = own.iter().map(|body| {
            body.movable.then(|| {
                size += 6;
                size - 6
            })
        });
        let starts = starts.collect();
        let mut mechanism = Self { order: Vec::new(), tree: 0, bodies: own, joints: own_joints, starts, arms, size };
        let rows: usize = mechanism.joints.iter().map(|joint| locked(&joint.kind)).sum();
        if rows > MAX_ROWS {
            return None;
        }
        mechanism.find_order();
        (mechanism.tree < mechanism.order.len()).then_some(mechanism)
    }

    /// Joints of many rows come first, so that those of few rows, such as a ball joint at the remote centre of motion of an
    /// arm, close loops.
    fn find_order(&mut self) {
        let mut joints: Vec<usize> = (0..self.joints.len()).collect();
        joints.sort_by_key(|&joint| {
            std::cmp::Reverse((!may_omit(&self.joints[joint].kind), locked(&self.joints[joint].kind)))
        });
        // The bodies that do not move are one component.
        let mut component: Vec<usize> =
            self.bodies.iter().enumerate().map(|(index, body)| if body.movable { index } else { usize::MAX }).collect();
        let (mut tree, mut closing) = (Vec::new(), Vec::new());
        for joint in joints {
            let [a, b] = self.joints[joint].bodies.map(|body| component[body]);
            if a == b {
                closing.push(joint);
            } else {
                component.iter_mut().filter(|of| **of == b).for_each(|of| *of = a);
                tree.push(joint);
            }
        }
        self.tree = tree.len();
        self.order = tree;
        self.order.extend(closing);
    }

    /// A row in scaled coordinates.
    fn coordinates(&self, joint: usize, row: &Row) -> DVector<f64> {
        let mut vector = DVector::zeros(self.size);
        for (&body, twist) in self.joints[joint].bodies.iter().zip(&row.jacobians) {
            let Some(start) = self.starts[body] else { continue };
            for axis in 0..3 {
                vector[start + axis] += twist[axis];
                vector[start + 3 + axis] += twist[3 + axis] / self.arms[body];
            }
        }
        vector
    }

    /// The rows that can be left out at `poses`, except for those of `needed` joints.
    fn select(&self, poses: &[Isometry3<f64>], needed: &[bool]) -> Selection {
        let mut found = Selection { omissions: vec![Omission::NONE; self.joints.len()], basis: Vec::new() };
        let (tree, closing) = self.order.split_at(self.tree);
        let (first, last): (Vec<usize>, Vec<usize>) =
            closing.iter().partition(|&&joint| needed[joint] || !may_omit(&self.joints[joint].kind));
        for &joint in tree.iter().chain(&first) {
            for row in self.rows(joint, poses).iter().filter(|row| row.is_locked()) {
                let row = self.coordinates(joint, row);
                let length = row.norm();
                found.add(row, EXACT * length);
            }
        }
        for joint in last {
            found.omissions[joint] = self.divide(joint, poses, &mut found);
        }
        found
    }

    fn rows(&self, joint: usize, poses: &[Isometry3<f64>]) -> [Row; 6] {
        let joint = &self.joints[joint];
        rows(joint, &joint.bodies.map(|body| poses[body]))
    }

    /// Divides the rows of a joint into those that are redundant after those of `found`, and others, which it adds.
    fn divide(&self, joint: usize, poses: &[Isometry3<f64>], found: &mut Selection) -> Omission {
        let all = self.rows(joint, poses);
        let mut omission = Omission::NONE;
        // Angular rows come after the three linear ones, in the order of their axes.
        let is_asked: [bool; 6] = std::array::from_fn(|row| all[row].is_locked());
        let kind = &self.joints[joint].kind;
        for row in (0..6).filter(|&row| is_asked[row] && !may_omit_row(kind, row)) {
            found.add(self.coordinates(joint, &all[row]), 0.0);
        }
        let mut angular: Vec<usize> = (3..6).filter(|&row| is_asked[row] && may_omit_row(kind, row)).collect();
        while !angular.is_empty() {
            let residual = |row: usize| {
                let row = self.coordinates(joint, &all[row]);
                let length = row.norm();
                found.residual(row) / length.max(f64::MIN_POSITIVE)
            };
            let residuals: Vec<DVector<f64>> = angular.iter().map(|&row| residual(row)).collect();
            let largest = (0..residuals.len()).max_by(|&a, &b| residuals[a].norm().total_cmp(&residuals[b].norm()));
            let Some(largest) = largest.filter(|&index| residuals[index].norm() > DEPENDENT) else { break };
            found.add(residuals[largest].clone(), 0.0);
            angular.remove(largest);
        }
        angular.into_iter().for_each(|row| omission.angular[row - 3] = true);
        self.divide_linear(joint, &all, &mut omission, found);
        omission
    }

    /// The same for linear rows: directions are the eigenvectors of the Gram matrix of their residuals.
    fn divide_linear(&self, joint: usize, all: &[Row; 6], omission: &mut Omission, found: &mut Selection) {
        let given: [DVector<f64>; 3] = std::array::from_fn(|axis| self.coordinates(joint, &all[axis]));
        let length = given.iter().map(|row| row.norm()).fold(f64::MIN_POSITIVE, f64::max);
        let residuals = given.map(|row| found.residual(row) / length);
        let kind = &self.joints[joint].kind;
        let is_asked: [bool; 3] = std::array::from_fn(|axis| all[axis].is_locked() && may_omit_row(kind, axis));
        // The row of another axis is an eigenvector by itself, with the largest eigenvalue.
        const FREE: f64 = 2.0;
        let gram = Matrix3::from_fn(|i, j| match (is_asked[i] && is_asked[j], i == j) {
            (true, _) => residuals[i].dot(&residuals[j]),
            (false, true) => FREE,
            (false, false) => 0.0,
        });
        if !gram.iter().all(|value| value.is_finite()) {
            return;
        }
        let mut eigen = SymmetricEigen::new(gram);
        if let Some(free) = (0..3).find(|&axis| !is_asked[axis]) {
            let column = eigen.eigenvectors.column_iter().position(|column| column[free].abs() > 0.5).unwrap_or(free);
            eigen.eigenvectors.swap_columns(free, column);
            eigen.eigenvalues.swap_rows(free, column);
        }
        for axis in (0..3).filter(|&axis| is_asked[axis]) {
            let direction = eigen.eigenvectors.column(axis);
            let row = &residuals[0] * direction[0] + &residuals[1] * direction[1] + &residuals[2] * direction[2];
            omission.linear[axis] = row.norm() <= DEPENDENT;
            if !omission.linear[axis] {
                found.add(row, 0.0);
            }
        }
        if omission.linear.contains(&true) {
            omission.axes = eigen.eigenvectors;
        }
    }

    /// What can be left out of each joint, and its largest misfit.
    fn omissions(&self) -> Vec<(Omission, Gap)> {
        let poses: Vec<Isometry3<f64>> = self.bodies.iter().map(|body| body.pose).collect();
        let mut needed = vec![false; self.joints.len()];
        let nothing = || vec![(Omission::NONE, Gap::default()); self.joints.len()];
        // Each round finds at least one joint more that is needed.
        for _ in 0..=self.joints.len() {
            let found = self.select(&poses, &needed);
            let everything = self.select(&poses, &vec![true; self.joints.len()]);
            // What is left out has to let the mechanism move.
            if found.basis.len() == everything.basis.len() || found.basis.len() >= self.size {
                return nothing();
            }
            let Some(misfits) = self.misfits(&poses, &found) else { return nothing() };
            let mut all_fit = true;
            for (joint, misfit) in misfits.iter().enumerate() {
                if misfit.exceeds(TOLERATED * self.arm_of(joint), TOLERATED) {
                    (needed[joint], all_fit) = (true, false);
                }
            }
            if all_fit {
                let sides = self.sides(&poses, &found, &needed);
                let omit = |joint: usize| {
                    let is_harmless = !misfits[joint].exceeds(HARMLESS * self.arm_of(joint), HARMLESS);
                    let arm = self.arm_of(joint);
                    let clearance = Gap {
                        distance: (GROWTH * misfits[joint].distance).clamp(LEAST_CLEARANCE * arm, CLEARANCE * arm),
                        angle: (GROWTH * misfits[joint].angle).clamp(LEAST_CLEARANCE, CLEARANCE),
                    };
                    let omission = if is_harmless { Omission::NONE } else { Omission { clearance, ..sides[joint] } };
                    (omission, misfits[joint])
                };
                return (0..self.joints.len()).map(omit).collect();
            }
        }
        nothing()
    }

    /// The shorter lever arm of the bodies of a joint that move, m.
    fn arm_of(&self, joint: usize) -> f64 {
        let moving = self.joints[joint].bodies.into_iter().filter(|&body| self.bodies[body].movable);
        moving.map(|body| self.arms[body]).fold(f64::INFINITY, f64::min)
    }

    /// Configurations to which the mechanism can be moved if the rows of `found` are left out.
    fn displacements<'a>(
        &'a self,
        poses: &'a [Isometry3<f64>],
        found: &'a Selection,
    ) -> impl Iterator<Item = Vec<Isometry3<f64>>> + 'a {
        let joints: Vec<Joint> = self
            .joints
            .iter()
            .zip(&found.omissions)
            .map(|(joint, &omission)| Joint { omission, ..joint.clone() })
            .collect();
        let mut numbers = Numbers(1);
        (0..SAMPLES).filter_map(move |_| {
            let random = DVector::from_fn(self.size, |_, _| numbers.next());
            let motion = found.residual(random);
            let turn = |body: usize| {
                self.starts[body].map_or(0.0, |start| motion.fixed_rows::<3>(start + 3).norm() / self.arms[body])
            };
            let shift = |body: usize| {
                self.starts[body].map_or(0.0, |start| motion.fixed_rows::<3>(start).norm() / self.arms[body])
            };
            let turned = (0..self.bodies.len()).map(turn).fold(0.0, f64::max);
            let moved = (0..self.bodies.len()).map(shift).fold(0.0, f64::max);
            // Sliders alone turn nothing.
            let rate = if turned > EXACT * moved { turned } else { moved };
            let share = DISPLACEMENT / rate;
            if !share.is_finite() {
                return None;
            }
            let mut bodies = self.bodies.clone();
            for (index, body) in bodies.iter_mut().enumerate() {
                let Some(start) = self.starts[index] else { continue };
                let shift: Vector3<f64> = motion.fixed_rows::<3>(start) * share;
                let turn: Vector3<f64> = motion.fixed_rows::<3>(start + 3) * (share / self.arms[index]);
                body.pose.translation.vector = poses[index].translation.vector + shift;
                body.pose.rotation = UnitQuaternion::from_scaled_axis(turn) * poses[index].rotation;
            }
            Island::new(&bodies, &joints, &[], (0..joints.len()).collect(), Vec::new())?.solve(&mut bodies);
            let closed = joints
                .iter()
                .enumerate()
                .all(|(index, joint)| !super::gap(joint, &bodies).exceeds(EXACT * self.arm_of(index), EXACT));
            let way = |(index, body): (usize, &Body)| {
                let turn = body.pose.rotation.angle_to(&poses[index].rotation);
                let shift = (body.pose.translation.vector - poses[index].translation.vector).norm();
                turn.max(shift / self.arms[index])
            };
            let most = bodies.iter().enumerate().map(way).fold(0.0, f64::max);
            let says = closed
                && most >= LEAST_DISPLACEMENT * DISPLACEMENT
                && (turned <= EXACT * moved
                    || bodies.iter().zip(poses).all(|(body, pose)| {
                        body.pose.rotation.angle_to(&pose.rotation) <= MOST_DISPLACEMENT * DISPLACEMENT
                    }));
            says.then(|| bodies.iter().map(|body| body.pose).collect())
        })
    }

    /// Largest misfit of each joint in displaced configurations; `None` where there is none that says anything.
    fn misfits(&self, poses: &[Isometry3<f64>], found: &Selection) -> Option<Vec<Gap>> {
        let mut misfits = vec![Gap::default(); self.joints.len()];
        let mut is_known = false;
        for displaced in self.displacements(poses, found) {
            is_known = true;
            for ((joint, omission), misfit) in self.joints.iter().zip(&found.omissions).zip(&mut misfits) {
                if omission.count() == 0 {
                    continue;
                }
                let mut gap = Gap::default();
                for row in rows(joint, &joint.bodies.map(|body| displaced[body])).iter().filter(|row| row.is_locked()) {
                    let part = if row.angular { &mut gap.angle } else { &mut gap.distance };
                    *part = part.hypot(row.error());
                }
                misfit.distance = misfit.distance.max(gap.distance);
                misfit.angle = misfit.angle.max(gap.angle);
            }
        }
        is_known.then_some(misfits)
    }

    /// The omissions of `found`, with linear axes that turn with the body in which the redundant direction is constant:
    /// along the third bar of a parallelogram it is constant in the bar.
    fn sides(&self, poses: &[Isometry3<f64>], found: &Selection, needed: &[bool]) -> Vec<Omission> {
        let mut omissions = found.omissions.clone();
        let mut agreement = vec![[0.0f64; 2]; self.joints.len()];
        let sole = |omission: &Omission| {
            let mut omitted = (0..3).filter(|&axis| omission.linear[axis]);
            omitted.next().filter(|_| omitted.next().is_none()).map(|axis| omission.axes.column(axis).into_owned())
        };
        let frame = |joint: &Joint, side: usize, poses: &[Isometry3<f64>]| {
            poses[joint.bodies[side]].rotation * joint.frames[side].rotation
        };
        for displaced in self.displacements(poses, found) {
            let there = self.select(&displaced, needed);
            for (index, joint) in self.joints.iter().enumerate() {
                let (Some(before), Some(after)) = (sole(&found.omissions[index]), sole(&there.omissions[index])) else {
                    continue;
                };
                let [before, after] = [frame(joint, 0, poses) * before, frame(joint, 0, &displaced) * after];
                for (side, agreed) in agreement[index].iter_mut().enumerate() {
                    let carried = frame(joint, side, &displaced) * (frame(joint, side, poses).inverse() * before);
                    *agreed += carried.dot(&after).abs();
                }
            }
        }
        for ((joint, omission), [a, b]) in self.joints.iter().zip(&mut omissions).zip(agreement) {
            if b > a + EXACT && matches!(joint.kind, Kind::Revolute(_) | Kind::PointToPoint) {
                omission.side = 1;
                let to_b = frame(joint, 1, poses).inverse() * frame(joint, 0, poses);
                omission.axes = to_b.to_rotation_matrix().matrix() * omission.axes;
            }
        }
        omissions
    }
}

impl Selection {
    /// What of a row is orthogonal to the basis; twice, so that rounding errors are, too.
    fn residual(&self, mut row: DVector<f64>) -> DVector<f64> {
        for _ in 0..2 {
            for direction in &self.basis {
                let along = direction.dot(&row);
                row.axpy(-along, direction, 1.0);
            }
        }
        row
    }

    /// Adds a row whose residual is longer than `least` to the basis.
    fn add(&mut self, row: DVector<f64>, least: f64) {
        let residual = self.residual(row);
        let length = residual.norm();
        if length > least {
            self.basis.push(residual / length);
        }
    }
}

/// Rows that a joint without its limits has.
fn locked(kind: &Kind) -> usize {
    match kind {
        Kind::Revolute(_) | Kind::Prismatic(_) => 5,
        Kind::Fixed => 6,
        Kind::PointToPoint | Kind::ConeTwist { .. } => 3,
        Kind::SixDof { linear, angular } => linear.iter().chain(angular).filter(|range| range.is_locked()).count(),
    }
}

/// Whether a row can be left out: not that of a coordinate which is locked by its limits.
fn may_omit_row(kind: &Kind, row: usize) -> bool {
    match kind {
        Kind::Revolute(_) => row < 5,
        Kind::Prismatic(_) => row > 0,
        Kind::PointToPoint => row < 3,
        _ => false,
    }
}

/// Whether rows of such a joint can be left out.
fn may_omit(kind: &Kind) -> bool {
    matches!(kind, Kind::Revolute(_) | Kind::Prismatic(_) | Kind::PointToPoint)
}

fn without_limits(kind: &Kind) -> Kind {
    let free = |range: &Range| if range.is_locked() { *range } else { Range::FREE };
    match kind {
        Kind::Revolute(range) => Kind::Revolute(free(range)),
        Kind::Prismatic(range) => Kind::Prismatic(free(range)),
        Kind::ConeTwist { .. } => Kind::PointToPoint,
        Kind::SixDof { linear, angular } => {
            Kind::SixDof { linear: linear.each_ref().map(free), angular: angular.each_ref().map(free) }
        }
        Kind::Fixed | Kind::PointToPoint => *kind,
    }
}

/// Numbers in -1…1 that look random.
struct Numbers(u32);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(self.0 >> 8) / f64::from(1u32 << 23) - 1.0
    }
}
