//! Bodies that joints hold together, and the iteration that closes these joints.

use nalgebra::{Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};

use super::factor::Factor;
use super::rows::{admissible, coordinate, coupling_error, rows, Demand, Row};
use super::{Body, Coupling, Joint};

/// Relative damping ε of the first steps: it leaves alone what hardly changes the errors, such as the one soft motion
/// of a loop whose hinges are nearly parallel, and closes all else at a rate of about ε a step (iterated Tikhonov
/// regularisation).
const FIRM_DAMPING: f64 = 1e-5;

/// Number of these steps.
const FIRM_STEPS: usize = 10;

/// Compliance of limits relative to that of joints: where they contradict each other, limits yield, as in the position
/// problem of a sub-step.
const YIELDING: f64 = 100.0;

/// Bounds of the damping of later steps.
const MIN_DAMPING: f64 = 1e-10;
const MAX_DAMPING: f64 = 1e6;

/// Later steps that are tried.
const MAX_STEPS: usize = 120;

/// Among so many of them the objective has to fall by a tenth: joints that contradict each other end here.
const PATIENCE: usize = 20;

/// Steps that shorten the displacement once the joints are closed.
const MAX_REFINEMENTS: usize = 8;

/// A refinement that lowers the squared displacement by less than this share is the last.
const MIN_REFINEMENT: f64 = 1e-6;

/// Greatest rotation of a body in a step, rad: linearisation holds for less than that.
const MAX_TURN: f64 = 0.5;

/// Errors up to this times the size of the coordinates are rounding errors, m and rad.
const ROUNDING: f64 = 1e-14;

/// Least moment of inertia as a share of the body's greatest.
const MIN_MOMENT: f64 = 1e-3;

/// Least radius of gyration as a share of the longest lever arm of the body's joints: bodies with less, whose inertia
/// the file did not mean seriously, would turn wildly to save a little translation.
const MIN_GYRATION: f64 = 0.05;

/// Joints and couplings of an island, by index.
#[derive(Default)]
pub(super) struct Parts {
    pub joints: Vec<usize>,
    pub couplings: Vec<usize>,
}

/// Groups of joints that movable bodies and couplings connect; joints without a movable body are in none.
pub(super) fn partition(bodies: &[Body], joints: &[Joint], couplings: &[Coupling]) -> Vec<Parts> {
    let mut parents: Vec<usize> = (0..bodies.len()).collect();
    fn root(parents: &mut [usize], mut body: usize) -> usize {
        while parents[body] != body {
            parents[body] = parents[parents[body]];
            body = parents[body];
        }
        body
    }
    for joint in joints {
        let [a, b] = joint.bodies;
        if bodies[a].movable && bodies[b].movable {
            let (a, b) = (root(&mut parents, a), root(&mut parents, b));
            parents[b] = a;
        }
    }
    let moved = |joint: usize| joints[joint].bodies.into_iter().find(|&body| bodies[body].movable);
    let moved_by = |coupling: &Coupling| joints_of(coupling).find_map(moved);
    for coupling in couplings {
        let Some(first) = moved_by(coupling) else { continue };
        for other in joints_of(coupling).filter_map(moved) {
            let (a, b) = (root(&mut parents, first), root(&mut parents, other));
            parents[b] = a;
        }
    }
    let mut islands: Vec<Parts> = Vec::new();
    let mut island_of = vec![usize::MAX; bodies.len()];
    for index in 0..joints.len() {
        let Some(body) = moved(index) else { continue };
        let root = root(&mut parents, body);
        if island_of[root] == usize::MAX {
            island_of[root] = islands.len();
            islands.push(Parts::default());
        }
        islands[island_of[root]].joints.push(index);
    }
    for (index, coupling) in couplings.iter().enumerate() {
        if let Some(body) = moved_by(coupling) {
            islands[island_of[root(&mut parents, body)]].couplings.push(index);
        }
    }
    islands
}

/// The joints of a coupling, the follower first.
fn joints_of(coupling: &Coupling) -> impl Iterator<Item = usize> + '_ {
    std::iter::once(coupling.follower).chain(coupling.leaders.iter().map(|&(joint, _)| joint))
}

/// A coupling of an island.
struct Tie<'a> {
    coupling: &'a Coupling,
    /// Its joints, the follower first, each with the factor of its coordinate in the error and the places of its bodies.
    joints: Vec<(&'a Joint, f64, [usize; 2])>,
    /// Nodes of its bodies that move, and the index of the coupling of each in the factor.
    nodes: Vec<(usize, usize)>,
    /// m or rad.
    error: f64,
    /// Effective inverse mass at the poses of the file, 1/kg or 1/(kg·m²).
    compliance: f64,
}

/// A joint of an island.
struct Member<'a> {
    joint: &'a Joint,
    /// Nodes of its bodies; `None`: not movable.
    nodes: [Option<usize>; 2],
    /// Indices of its couplings in the factor.
    couplings: [usize; 2],
    rows: [Row; 6],
    /// Side on which a limit was active in the step before: 1 upper, −1 lower, 0 not.
    active: [f64; 6],
    /// Effective inverse mass of each row at the poses of the file, 1/kg or 1/(kg·m²).
    compliance: Vector6<f64>,
}

impl Member<'_> {
    /// Which end of its range a row is held at in this step: 1 the upper, −1 the lower, 0 none. A limit that was active
    /// stays so until its multiplier pulls.
    fn side(&self, row: usize) -> f64 {
        let Row { demand: Demand::Within(range), value, .. } = &self.rows[row] else { return 0.0 };
        if *value > range.high {
            1.0
        } else if *value < range.low {
            -1.0
        } else {
            self.active[row]
        }
    }

    /// Error of a row in this step; `None`: nothing is asked of it.
    fn error(&self, row: usize) -> Option<f64> {
        let Row { demand, value, .. } = &self.rows[row];
        match demand {
            Demand::None => None,
            Demand::Zero => Some(*value),
            Demand::Within(range) if range.is_locked() => Some(value - range.low),
            Demand::Within(range) => match self.side(row) {
                side if side > 0.0 => Some(value - range.high),
                side if side < 0.0 => Some(value - range.low),
                _ => None,
            },
        }
    }

    /// Part of the objective ½ gᵀD⁻¹g, and the greatest error.
    fn objective(&self) -> (f64, f64) {
        let (mut sum, mut worst) = (0.0, 0.0f64);
        for (row, compliance) in self.rows.iter().zip(&self.compliance) {
            let error = row.error();
            sum += 0.5 * error * error / compliance;
            worst = worst.max(error.abs());
        }
        (sum, worst)
    }
}

/// A group of bodies and the joints between them.
pub(super) struct Island<'a> {
    /// Index of the body of each node.
    bodies: Vec<usize>,
    /// Diagonal of M by node, principal axes, kg and kg·m²; 0 in place of a moment about which the body doesn't turn.
    masses: Vec<Vector6<f64>>,
    members: Vec<Member<'a>>,
    ties: Vec<Tie<'a>>,
    factor: Factor,
    /// Poses of all bodies that the joints name: of the nodes, then of the others.
    poses: Vec<Isometry3<f64>>,
    /// The same, as the file has them.
    file: Vec<Isometry3<f64>>,
    /// For each member places of its bodies in `poses`.
    places: Vec<[usize; 2]>,
    /// Size of the coordinates, m; at least 1.
    size: f64,
    values: Vec<Vector6<f64>>,
}

impl<'a> Island<'a> {
    /// `None` where its joints are too entangled for a factorisation.
    pub fn new(
        bodies: &[Body],
        joints: &'a [Joint],
        couplings: &'a [Coupling],
        joints_of: Vec<usize>,
        couplings_of: Vec<usize>,
    ) -> Option<Self> {
        let tied = couplings_of.iter().flat_map(|&coupling| self::joints_of(&couplings[coupling]));
        // Joints between bodies that do not move are in no island, and may be coupled.
        let named: Vec<usize> = joints_of.iter().copied().chain(tied).collect();
        let named = || named.iter().flat_map(|&joint| joints[joint].bodies);
        let distinct = |movable: bool| {
            let mut list: Vec<usize> = named().filter(|&body| bodies[body].movable == movable).collect();
            list.sort_unstable();
            list.dedup();
            list
        };
        let (nodes, fixed) = (distinct(true), distinct(false));
        let poses: Vec<_> = nodes.iter().chain(&fixed).map(|&body| bodies[body].pose).collect();
        let place = |body: usize| match nodes.binary_search(&body) {
            Ok(node) => node,
            Err(_) => nodes.len() + fixed.binary_search(&body).unwrap_or_default(),
        };
        let places: Vec<[usize; 2]> = joints_of.iter().map(|&joint| joints[joint].bodies.map(place)).collect();
        let mut edges = Vec::new();
        let mut members = Vec::with_capacity(joints_of.len());
        let mut arms = vec![0.0f64; nodes.len()];
        for (index, (&joint, places)) in joints_of.iter().zip(&places).enumerate() {
            let joint = &joints[joint];
            let mut member = Member {
                joint,
                nodes: places.map(|place| (place < nodes.len()).then_some(place)),
                couplings: [0; 2],
                rows: rows(joint, &places.map(|place| poses[place])),
                active: [0.0; 6],
                compliance: Vector6::repeat(1.0),
            };
            for side in 0..2 {
                let Some(node) = member.nodes[side] else { continue };
                member.couplings[side] = edges.len();
                edges.push((node, nodes.len() + index));
                arms[node] = arms[node].max(joint.frames[side].translation.vector.norm());
            }
            members.push(member);
        }
        let mut ties = Vec::with_capacity(couplings_of.len());
        for (index, &coupling) in couplings_of.iter().enumerate() {
            let coupling = &couplings[coupling];
            let factors = std::iter::once(1.0).chain(coupling.leaders.iter().map(|&(_, ratio)| -ratio));
            let joints: Vec<_> = self::joints_of(coupling)
                .zip(factors)
                .map(|(joint, factor)| (&joints[joint], factor, joints[joint].bodies.map(place)))
                .collect();
            let mut moved: Vec<usize> =
                joints.iter().flat_map(|(_, _, places)| *places).filter(|&place| place < nodes.len()).collect();
            moved.sort_unstable();
            moved.dedup();
            let first = edges.len();
            edges.extend(moved.iter().map(|&node| (node, nodes.len() + joints_of.len() + index)));
            let nodes = moved.into_iter().zip(first..).collect();
            ties.push(Tie { coupling, joints, nodes, error: 0.0, compliance: 1.0 });
        }
        let masses: Vec<_> = nodes.iter().zip(arms).map(|(&body, arm)| generalised_mass(&bodies[body], arm)).collect();
        let size = poses.iter().map(|pose| pose.translation.vector.amax()).fold(1.0, f64::max);
        let mut island = Self {
            values: vec![Vector6::zeros(); nodes.len() + members.len() + ties.len()],
            factor: Factor::new(nodes.len(), members.len() + ties.len(), &edges)?,
            bodies: nodes,
            masses,
            members,
            ties,
            file: poses.clone(),
            poses,
            places,
            size,
        };
        island.weigh();
        Some(island)
    }

    /// Sets the compliances D: the diagonal of J M⁻¹ Jᵀ, of which the linear and the angular rows that lock a joint
    /// have their means, so that the compromise does not depend on the axes along which an error is resolved.
    fn weigh(&mut self) {
        let mut most = 0.0f64;
        for index in 0..self.members.len() {
            let mut compliance = Vector6::zeros();
            for side in 0..2 {
                let Some(node) = self.members[index].nodes[side] else { continue };
                let jacobian = self.jacobian(index, side);
                for row in 0..6 {
                    for column in 0..6 {
                        let mass = self.masses[node][column];
                        if mass > 0.0 {
                            compliance[row] += jacobian[(row, column)].powi(2) / mass;
                        }
                    }
                }
            }
            most = most.max(compliance.amax());
            let rows = &self.members[index].rows;
            for angular in [false, true] {
                let of = || (0..6).filter(|&row| rows[row].is_locked() && rows[row].angular == angular);
                let mean = of().map(|row| compliance[row]).sum::<f64>() / of().count().max(1) as f64;
                of().for_each(|row| compliance[row] = mean);
            }
            for row in (0..6).filter(|&row| !rows[row].is_locked()) {
                compliance[row] *= YIELDING;
            }
            self.members[index].compliance = compliance;
        }
        for index in 0..self.ties.len() {
            let tie = &self.ties[index];
            let of = |&(node, _): &(usize, usize)| -> f64 {
                let (row, masses) = (self.tie_row(tie, node), &self.masses[node]);
                row.iter().zip(masses).filter(|(_, mass)| **mass > 0.0).map(|(value, mass)| value * value / mass).sum()
            };
            let compliance = tie.nodes.iter().map(of).sum();
            self.ties[index].compliance = compliance;
            most = most.max(compliance);
        }
        // Rows that nothing can change.
        let least = if most > 0.0 && most.is_finite() { most * 1e-12 } else { 1.0 };
        for member in &mut self.members {
            member.compliance.apply(|value| *value = value.max(least));
        }
        for tie in &mut self.ties {
            tie.compliance = tie.compliance.max(least);
        }
    }

    /// Derivatives of the error of a coupling by velocity (world axes) and angular velocity (principal axes) of the body of a
    /// node.
    fn tie_row(&self, tie: &Tie<'_>, node: usize) -> Vector6<f64> {
        let mut twist = Vector6::zeros();
        for (joint, factor, places) in &tie.joints {
            let row = coordinate(joint, &places.map(|place| self.poses[place]));
            for side in (0..2).filter(|&side| places[side] == node) {
                twist += row.jacobians[side] * *factor;
            }
        }
        let turn = self.poses[node].rotation.inverse() * twist.fixed_rows::<3>(3).into_owned();
        for axis in 0..3 {
            twist[3 + axis] = if self.masses[node][3 + axis] > 0.0 { turn[axis] } else { 0.0 };
        }
        twist
    }

    /// Derivatives of a joint's rows by velocity (world axes) and angular velocity (principal axes) of one of its
    /// bodies.
    fn jacobian(&self, member: usize, side: usize) -> Matrix6<f64> {
        let place = self.places[member][side];
        let to_body = self.poses[place].rotation.inverse();
        let mut jacobian = Matrix6::zeros();
        for (index, row) in self.members[member].rows.iter().enumerate() {
            let twist = &row.jacobians[side];
            let turn = to_body * twist.fixed_rows::<3>(3).into_owned();
            for axis in 0..3 {
                jacobian[(index, axis)] = twist[axis];
                if self.masses.get(place).is_some_and(|mass| mass[3 + axis] > 0.0) {
                    jacobian[(index, 3 + axis)] = turn[axis];
                }
            }
        }
        jacobian
    }

    fn evaluate(&mut self) -> (f64, f64) {
        let (mut sum, mut worst) = (0.0, 0.0f64);
        for (member, places) in self.members.iter_mut().zip(&self.places) {
            member.rows = rows(member.joint, &places.map(|place| self.poses[place]));
            let (part, error) = member.objective();
            sum += part;
            worst = worst.max(error);
        }
        for tie in &mut self.ties {
            let row = |index: usize| {
                let (joint, _, places) = &tie.joints[index];
                coordinate(joint, &places.map(|place| self.poses[place]))
            };
            let leaders =
                tie.coupling.leaders.iter().enumerate().map(|(index, &(_, ratio))| (row(index + 1).value, ratio));
            tie.error = coupling_error(&row(0), leaders, tie.coupling.offset);
            sum += 0.5 * tie.error * tie.error / tie.compliance;
            worst = worst.max(tie.error.abs());
        }
        (sum, worst)
    }

    /// Closes the joints and moves the bodies. True when all errors are rounding errors.
    pub fn solve(mut self, bodies: &mut [Body]) -> bool {
        let (objective, worst) = self.evaluate();
        if worst <= self.rounding() || !objective.is_finite() {
            return worst <= self.rounding();
        }
        let mut closed = self.close_firmly();
        if !closed {
            let compromise = self.poses.clone();
            closed = self.close_at_any_cost();
            if !closed {
                self.poses = compromise;
            }
        }
        if closed {
            self.refine();
        } else {
            closed = self.hang();
        }
        for (&body, pose) in self.bodies.iter().zip(&self.poses) {
            bodies[body].pose = *pose;
        }
        closed
    }

    /// Puts each body of a tree onto its joint, from the bodies that are not movable, or else the heaviest one, outwards: a
    /// tree can always be closed, however far its base was moved. The coordinates of the joints are those of the file, as
    /// far as their ranges allow. False, and nothing changes, where the joints form loops or a coordinate is no number.
    fn hang(&mut self) -> bool {
        let (nodes, all) = (self.bodies.len(), self.poses.len());
        let mut hangs = vec![false; all];
        hangs[nodes..].fill(true);
        if nodes == all {
            let heaviest = (0..nodes).max_by(|&a, &b| self.masses[a][0].total_cmp(&self.masses[b][0]));
            heaviest.into_iter().for_each(|node| hangs[node] = true);
        }
        let mut joints_of = vec![Vec::new(); all];
        for (index, places) in self.places.iter().enumerate() {
            places.iter().for_each(|&place| joints_of[place].push(index));
        }
        let mut waiting: Vec<usize> = (0..all).filter(|&place| hangs[place]).collect();
        let mut is_used = vec![false; self.members.len()];
        let mut poses = self.file.clone();
        while let Some(parent) = waiting.pop() {
            for &index in &joints_of[parent] {
                if std::mem::replace(&mut is_used[index], true) {
                    continue;
                }
                let [a, b] = self.places[index];
                let child = if a == parent { b } else { a };
                if std::mem::replace(&mut hangs[child], true) {
                    return false;
                }
                let Joint { kind, frames, .. } = self.members[index].joint;
                let world = |place: usize, side: usize| self.file[place] * frames[side];
                let between = admissible(kind, &(world(a, 0).inverse() * world(b, 1)));
                poses[child] = if a == parent {
                    poses[a] * frames[0] * between * frames[1].inverse()
                } else {
                    poses[b] * frames[1] * between.inverse() * frames[0].inverse()
                };
                waiting.push(child);
            }
        }
        let before = self.poses.clone();
        self.return_to(&poses);
        let closed = self.evaluate().1 <= 100.0 * self.rounding();
        if !closed {
            self.return_to(&before);
        }
        closed
    }

    /// Greatest error that is a rounding error, m and rad.
    fn rounding(&self) -> f64 {
        ROUNDING * self.size
    }

    /// Steps of the same damping, which end at the compromise if the joints contradict each other. True when they are
    /// closed.
    fn close_firmly(&mut self) -> bool {
        let (mut objective, mut worst) = self.evaluate();
        let mut best = self.poses.clone();
        for _ in 0..FIRM_STEPS {
            if worst <= self.rounding() || self.step(FIRM_DAMPING, 0.0).is_none() {
                break;
            }
            let (trial, error) = self.evaluate();
            if trial >= objective {
                break;
            }
            best.clone_from(&self.poses);
            (objective, worst) = (trial, error);
        }
        self.return_to(&best);
        worst <= self.rounding()
    }

    /// Levenberg–Marquardt steps; the damping follows Nielsen (Madsen, Nielsen, Tingleff, *Methods for non-linear least
    /// squares problems*, 2004, ch. 3.2). True when all joints are closed.
    fn close_at_any_cost(&mut self) -> bool {
        let (mut objective, mut worst) = self.evaluate();
        let mut best = self.poses.clone();
        let (mut damping, mut growth) = (FIRM_DAMPING, 2.0);
        let mut mark = objective;
        for index in 1..=MAX_STEPS {
            if worst <= self.rounding() || damping > MAX_DAMPING {
                break;
            }
            if index % PATIENCE == 0 {
                if objective > 0.9 * mark {
                    break;
                }
                mark = objective;
            }
            let predicted = self.step(damping, 0.0);
            let (trial, error) = self.evaluate();
            match predicted {
                Some(predicted) if trial < objective => {
                    let gain = (objective - trial) / (objective - predicted).max(f64::MIN_POSITIVE);
                    damping = (damping * (1.0 - (2.0 * gain - 1.0).powi(3)).clamp(1.0 / 3.0, 2.0)).max(MIN_DAMPING);
                    growth = 2.0;
                    best.clone_from(&self.poses);
                    (objective, worst) = (trial, error);
                }
                _ => {
                    self.return_to(&best);
                    damping *= growth;
                    growth *= 2.0;
                }
            }
        }
        self.return_to(&best);
        // The last digits may depend on the order of sums.
        worst <= 100.0 * self.rounding()
    }

    /// Goes along the joints towards the poses of the file, as far as that shortens the displacement: Newton steps of
    /// the projection.
    fn refine(&mut self) {
        let mut best = self.poses.clone();
        let mut cost = self.displacement();
        for _ in 0..MAX_REFINEMENTS {
            let limit = 100.0 * self.rounding();
            let is_closed = self.step(MIN_DAMPING, 1.0).is_some() && {
                self.evaluate();
                self.close_firmly();
                self.evaluate().1 <= limit
            };
            let trial = self.displacement();
            // Not `>=`, which is false for what is not a number.
            if !(is_closed && trial < cost) {
                break;
            }
            best.clone_from(&self.poses);
            let progress = (cost - trial) / cost;
            cost = trial;
            if progress < MIN_REFINEMENT {
                break;
            }
        }
        self.return_to(&best);
    }

    fn return_to(&mut self, poses: &[Isometry3<f64>]) {
        self.poses.clone_from_slice(poses);
        self.members.iter_mut().for_each(|member| member.active = [0.0; 6]);
        self.evaluate();
    }

    /// Displacement of a node from the pose of the file: m in world axes, rad in principal axes.
    fn displaced(&self, node: usize) -> Vector6<f64> {
        let (now, file) = (&self.poses[node], &self.file[node]);
        let shift = now.translation.vector - file.translation.vector;
        let turn = (file.rotation.inverse() * now.rotation).scaled_axis();
        Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
    }

    /// Squared displacement in the metric of the masses, kg·m².
    fn displacement(&self) -> f64 {
        let of = |(node, mass): (usize, &Vector6<f64>)| mass.dot(&self.displaced(node).map(|value| value * value));
        self.masses.iter().enumerate().map(of).sum()
    }

    /// Moves `poses` by one step: towards closed joints and, by `back` times the displacement, towards the poses of the
    /// file. Returns the objective that linearisation predicts; `None` where there is no step.
    fn step(&mut self, damping: f64, back: f64) -> Option<f64> {
        let n = self.bodies.len();
        self.factor.clear();
        for (node, mass) in self.masses.iter().enumerate() {
            self.factor.diagonal[node] = Matrix6::from_diagonal(&mass.map(|mass| if mass > 0.0 { mass } else { 1.0 }));
            let pull = if back == 0.0 { Vector6::zeros() } else { self.displaced(node).component_mul(mass) * -back };
            self.values[node] = pull;
        }
        for index in 0..self.members.len() {
            let errors: [Option<f64>; 6] = std::array::from_fn(|row| self.members[index].error(row));
            for side in 0..2 {
                if self.members[index].nodes[side].is_none() {
                    continue;
                }
                let mut jacobian = self.jacobian(index, side);
                for (row, error) in errors.iter().enumerate() {
                    if error.is_none() {
                        jacobian.row_mut(row).fill(0.0);
                    }
                }
                self.factor.couple(self.members[index].couplings[side], &jacobian);
            }
            let compliance = &self.members[index].compliance;
            self.factor.diagonal[n + index] = Matrix6::from_diagonal(&(compliance * -damping));
            self.values[n + index] = Vector6::from_fn(|row, _| -errors[row].unwrap_or(0.0));
        }
        let first_tie = n + self.members.len();
        for (index, tie) in self.ties.iter().enumerate() {
            for &(node, edge) in &tie.nodes {
                let mut jacobian = Matrix6::zeros();
                jacobian.set_row(0, &self.tie_row(tie, node).transpose());
                self.factor.couple(edge, &jacobian);
            }
            // Of six rows one is in use.
            self.factor.diagonal[first_tie + index] = Matrix6::from_diagonal_element(-damping * tie.compliance);
            self.values[first_tie + index] = Vector6::new(-tie.error, 0.0, 0.0, 0.0, 0.0, 0.0);
        }
        self.factor.factor()?;
        self.factor.solve(&mut self.values);
        let turn = |value: &Vector6<f64>| Vector3::new(value[3], value[4], value[5]);
        let most = self.values[..n].iter().map(|value| turn(value).norm()).fold(0.0, f64::max);
        if !most.is_finite() {
            return None;
        }
        let share = (MAX_TURN / most).min(1.0);
        for node in 0..n {
            let value = self.values[node] * share;
            let pose = &mut self.poses[node];
            let moved = pose.translation.vector + value.fixed_rows::<3>(0);
            // Rounding errors of products of rotations must not pile up.
            let turned = pose.rotation.into_inner() * UnitQuaternion::from_scaled_axis(turn(&value)).into_inner();
            *pose = Isometry3::from_parts(Translation3::from(moved), UnitQuaternion::new_normalize(turned));
        }
        let multipliers = self.values[first_tie..].iter().map(|value| value[0]);
        let of_tie = |(tie, multiplier): (&Tie<'_>, f64)| 0.5 * (damping * multiplier).powi(2) * tie.compliance;
        let mut predicted: f64 = self.ties.iter().zip(multipliers).map(of_tie).sum();
        for (member, multipliers) in self.members.iter_mut().zip(&self.values[n..first_tie]) {
            // g + J Δ = ε D λ
            predicted += 0.5 * damping * damping * member.compliance.dot(&multipliers.map(|value| value * value));
            for row in 0..6 {
                let side = member.side(row);
                member.active[row] = if multipliers[row] * side > 0.0 { side } else { 0.0 };
            }
        }
        Some(predicted)
    }
}

/// Diagonal of the mass matrix in principal axes. `arm`: longest lever arm of the body's joints, m.
fn generalised_mass(body: &Body, arm: f64) -> Vector6<f64> {
    let mass = if body.mass > 0.0 && body.mass.is_finite() { body.mass } else { 1.0 };
    let greatest = body.inertia.max();
    let least = (greatest * MIN_MOMENT).max(mass * (MIN_GYRATION * arm).powi(2));
    let moment = |moment: f64| if moment > 0.0 { moment.max(least) } else { 0.0 };
    Vector6::new(mass, mass, mass, moment(body.inertia.x), moment(body.inertia.y), moment(body.inertia.z))
}
