//! Trees of hinges and sliders on a fixed base in joint coordinates, with loops closed by point constraints.
//!
//! Accelerations follow from M(q) q̈ + h(q, q̇) = τ + Jᵀλ with J q̈ = −J̇ q̇. Redundant constraints are
//! left out; after each step of the integration the state is projected back onto closed loops.

use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Translation3, UnitQuaternion, UnitVector3, Vector3};

use super::{extrapolation, State, TOLERANCE};
use crate::system::{Drive, Freedom, Joint, System};

/// Pivots below this share of the largest count as none: loops have redundant constraints.
const RANK: f64 = 1e-7;

struct Link {
    freedom: Freedom,
    /// Coordinate of the parent; `None`: the base.
    parent: Option<usize>,
    /// Axis and pivot in the parent's frame.
    axis: Vector3<f64>,
    pivot: Vector3<f64>,
    /// Initial pose in the parent's frame.
    rest: Isometry3<f64>,
    mass: f64,
    inertia: Vector3<f64>,
}

/// A point of one link that stays on a point of another; coordinates in the links' frames.
struct Tie {
    links: [usize; 2],
    points: [Vector3<f64>; 2],
}

/// A model of a [`System`] in joint coordinates.
pub struct MultiBody {
    links: Vec<Link>,
    ties: Vec<Tie>,
    gravity: Vector3<f64>,
    drive: Option<Drive>,
    /// Body of the system that each link is.
    bodies: Vec<usize>,
    initial_rates: DVector<f64>,
}

/// Where the links are and how they move for given coordinates and rates.
struct Motion {
    states: Vec<State>,
    /// Axes and pivots in the world.
    axes: Vec<Vector3<f64>>,
    pivots: Vec<Vector3<f64>>,
    /// Accelerations without q̈.
    linear: Vec<Vector3<f64>>,
    angular: Vec<Vector3<f64>>,
}

impl MultiBody {
    /// The model of a system whose bodies but the first each have a joint that leads to them.
    pub fn new(system: &System) -> Self {
        let coordinate = |body: usize| system.joints.iter().position(|joint| joint.child == body);
        let link = |joint: &Joint| {
            let (parent, child) = (&system.bodies[joint.parent], &system.bodies[joint.child]);
            Link {
                freedom: joint.freedom,
                parent: coordinate(joint.parent),
                axis: parent.pose.inverse_transform_vector(&joint.axis),
                pivot: parent.pose.inverse_transform_point(&joint.pivot.into()).coords,
                rest: parent.pose.inverse() * child.pose,
                mass: child.mass,
                inertia: child.inertia,
            }
        };
        let tie = |closure: &Joint| {
            let sides = [closure.parent, closure.child];
            let make = |point: Vector3<f64>| Tie {
                links: sides.map(|body| coordinate(body).expect("loops are closed between moving bodies")),
                points: sides.map(|body| system.bodies[body].pose.inverse_transform_point(&point.into()).coords),
            };
            system.closure_points(closure).into_iter().map(make).collect::<Vec<_>>()
        };
        let mut model = Self {
            links: system.joints.iter().map(link).collect(),
            ties: system.closures.iter().flat_map(tie).collect(),
            gravity: system.gravity,
            drive: system.drive.clone(),
            bodies: system.joints.iter().map(|joint| joint.child).collect(),
            initial_rates: DVector::zeros(system.joints.len()),
        };
        model.initial_rates = model.rates_of(system);
        model
    }

    /// The rates that give the bodies their initial velocities.
    fn rates_of(&self, system: &System) -> DVector<f64> {
        let n = self.links.len();
        let motion = self.motion(&vec![0.0; n], &vec![0.0; n]);
        let (mut rows, mut values) = (DMatrix::zeros(6 * n, n), DVector::zeros(6 * n));
        for (i, &body) in self.bodies.iter().enumerate() {
            let (linear, angular) = self.jacobian(&motion, i, &motion.states[i].pose.translation.vector);
            rows.view_mut((6 * i, 0), (3, n)).copy_from(&linear);
            rows.view_mut((6 * i + 3, 0), (3, n)).copy_from(&angular);
            values.fixed_rows_mut::<3>(6 * i).copy_from(&system.bodies[body].velocity);
            values.fixed_rows_mut::<3>(6 * i + 3).copy_from(&system.bodies[body].spin);
        }
        smallest_solution(&rows, &values)
    }

    fn motion(&self, q: &[f64], rates: &[f64]) -> Motion {
        let n = self.links.len();
        let zero = Vector3::zeros();
        let base = State { pose: Isometry3::identity(), velocity: zero, spin: zero };
        let mut motion = Motion {
            states: Vec::with_capacity(n),
            axes: Vec::with_capacity(n),
            pivots: Vec::with_capacity(n),
            linear: Vec::with_capacity(n),
            angular: Vec::with_capacity(n),
        };
        for (i, link) in self.links.iter().enumerate() {
            let parent = link.parent.map_or(base, |p| motion.states[p]);
            let (a, alpha) = link.parent.map_or((zero, zero), |p| (motion.linear[p], motion.angular[p]));
            let axis = parent.pose.rotation * link.axis;
            let pivot = parent.pose.transform_point(&link.pivot.into()).coords;
            let relative = match link.freedom {
                Freedom::Hinge => {
                    let turn = UnitQuaternion::from_axis_angle(&UnitVector3::new_unchecked(link.axis), q[i]);
                    let arm = turn * (link.rest.translation.vector - link.pivot);
                    Isometry3::from_parts(Translation3::from(link.pivot + arm), turn * link.rest.rotation)
                }
                Freedom::Slider => Translation3::from(link.axis * q[i]) * link.rest,
            };
            let pose = parent.pose * relative;
            let (r, w) = (pose.translation.vector - parent.pose.translation.vector, parent.spin);
            let (velocity, spin, linear, angular);
            match link.freedom {
                Freedom::Hinge => {
                    spin = w + axis * rates[i];
                    angular = alpha + w.cross(&axis) * rates[i];
                    let (to, on) = (pivot - parent.pose.translation.vector, pose.translation.vector - pivot);
                    velocity = parent.velocity + w.cross(&to) + spin.cross(&on);
                    linear = a
                        + alpha.cross(&to)
                        + w.cross(&w.cross(&to))
                        + angular.cross(&on)
                        + spin.cross(&spin.cross(&on));
                }
                Freedom::Slider => {
                    (spin, angular) = (w, alpha);
                    velocity = parent.velocity + w.cross(&r) + axis * rates[i];
                    linear = a + alpha.cross(&r) + w.cross(&w.cross(&r)) + 2.0 * w.cross(&axis) * rates[i];
                }
            }
            motion.states.push(State { pose, velocity, spin });
            motion.axes.push(axis);
            motion.pivots.push(pivot);
            motion.linear.push(linear);
            motion.angular.push(angular);
        }
        motion
    }

    /// Jacobians of a point of a link and of its rotation, both (3 x n).
    fn jacobian(&self, motion: &Motion, link: usize, point: &Vector3<f64>) -> (DMatrix<f64>, DMatrix<f64>) {
        let n = self.links.len();
        let (mut linear, mut angular) = (DMatrix::zeros(3, n), DMatrix::zeros(3, n));
        let mut next = Some(link);
        while let Some(i) = next {
            let axis = motion.axes[i];
            match self.links[i].freedom {
                Freedom::Hinge => {
                    linear.set_column(i, &axis.cross(&(point - motion.pivots[i])));
                    angular.set_column(i, &axis);
                }
                Freedom::Slider => linear.set_column(i, &axis),
            }
            next = self.links[i].parent;
        }
        (linear, angular)
    }

    /// Distances of tied points, their Jacobian, and their accelerations without q̈.
    fn constraints(&self, motion: &Motion) -> (DVector<f64>, DMatrix<f64>, DVector<f64>) {
        let (rows, n) = (3 * self.ties.len(), self.links.len());
        let (mut gap, mut jacobian) = (DVector::zeros(rows), DMatrix::zeros(rows, n));
        let mut bias = DVector::zeros(rows);
        for (k, tie) in self.ties.iter().enumerate() {
            for side in 0..2 {
                let (link, sign) = (tie.links[side], if side == 0 { 1.0 } else { -1.0 });
                let state = &motion.states[link];
                let arm = state.pose.rotation * tie.points[side];
                let point = state.pose.translation.vector + arm;
                let acceleration =
                    motion.linear[link] + motion.angular[link].cross(&arm) + state.spin.cross(&state.spin.cross(&arm));
                let (linear, _) = self.jacobian(motion, link, &point);
                let mut rows = gap.fixed_rows_mut::<3>(3 * k);
                rows += point * sign;
                let mut rows = bias.fixed_rows_mut::<3>(3 * k);
                rows += acceleration * sign;
                let mut rows = jacobian.view_mut((3 * k, 0), (3, n));
                rows += linear * sign;
            }
        }
        (gap, jacobian, bias)
    }

    /// M and −h: composite bodies and Newton–Euler forces about the world's origin (Featherstone: Rigid Body Dynamics
    /// Algorithms, 5.3, 6.2).
    fn dynamics(&self, motion: &Motion) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.links.len();
        // Composite bodies: mass, first moment, inertia; and force and torque on them.
        let mut bodies: Vec<(f64, Vector3<f64>, Matrix3<f64>)> = Vec::with_capacity(n);
        let mut wrenches: Vec<(Vector3<f64>, Vector3<f64>)> = Vec::with_capacity(n);
        for (i, link) in self.links.iter().enumerate() {
            let state = &motion.states[i];
            let (centre, turn) = (state.pose.translation.vector, state.pose.rotation.to_rotation_matrix());
            let inertia = turn * Matrix3::from_diagonal(&link.inertia) * turn.transpose();
            let force = (motion.linear[i] - self.gravity) * link.mass;
            let torque = inertia * motion.angular[i] + state.spin.cross(&(inertia * state.spin));
            let cross = centre.cross_matrix();
            bodies.push((link.mass, centre * link.mass, inertia - cross * cross * link.mass));
            wrenches.push((force, torque + centre.cross(&force)));
        }
        for i in (0..n).rev() {
            let Some(parent) = self.links[i].parent else { continue };
            let (body, wrench) = (bodies[i], wrenches[i]);
            let (mass, moment, inertia) = &mut bodies[parent];
            (*mass, *moment, *inertia) = (*mass + body.0, *moment + body.1, *inertia + body.2);
            let (force, torque) = &mut wrenches[parent];
            (*force, *torque) = (*force + wrench.0, *torque + wrench.1);
        }
        // Angular velocity, and velocity of the point at the origin, for a rate of 1.
        let twist = |i: usize| match self.links[i].freedom {
            Freedom::Hinge => (motion.axes[i], motion.pivots[i].cross(&motion.axes[i])),
            Freedom::Slider => (Vector3::zeros(), motion.axes[i]),
        };
        let (mut matrix, mut bias) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for i in 0..n {
            let (w, v) = twist(i);
            bias[i] = -(w.dot(&wrenches[i].1) + v.dot(&wrenches[i].0));
            let (mass, moment, inertia) = &bodies[i];
            let (linear, angular) = (v * *mass + w.cross(moment), moment.cross(&v) + inertia * w);
            let mut next = Some(i);
            while let Some(j) = next {
                let (w, v) = twist(j);
                matrix[(i, j)] = w.dot(&angular) + v.dot(&linear);
                matrix[(j, i)] = matrix[(i, j)];
                next = self.links[j].parent;
            }
        }
        (matrix, bias)
    }

    fn accelerations(&self, time: f64, q: &[f64], rates: &[f64]) -> DVector<f64> {
        let motion = self.motion(q, rates);
        let (mass, mut force) = self.dynamics(&motion);
        if let Some(drive) = &self.drive {
            let (angle, rate) = drive.set_point(time);
            for (i, (p, d)) in drive.gains.iter().enumerate() {
                force[i] += p * (angle - q[i]) + d * (rate - rates[i]);
            }
        }
        let factor = mass.cholesky().expect("every coordinate moves something");
        let free = factor.solve(&force);
        if self.ties.is_empty() {
            return free;
        }
        // With M = L Lᵀ and z = Lᵀ q̈ the constraint force is the smallest change of z that keeps the loops closed
        // (Gauss).
        let (_, jacobian, bias) = self.constraints(&motion);
        let lower = factor.l();
        let missing = -(bias + &jacobian * &free);
        let scaled = lower.solve_lower_triangular(&jacobian.transpose()).expect("it has a diagonal").transpose();
        let change = smallest_solution(&scaled, &missing);
        free + lower.transpose().solve_upper_triangular(&change).expect("it has a diagonal")
    }

    /// Back onto the manifold of closed loops.
    fn project(&self, y: &mut [f64]) {
        if self.ties.is_empty() {
            return;
        }
        let n = self.links.len();
        for _ in 0..2 {
            let (gap, jacobian, _) = self.constraints(&self.motion(&y[..n], &y[n..]));
            let change = smallest_solution(&jacobian, &gap);
            y[..n].iter_mut().zip(&change).for_each(|(y, change)| *y -= change);
        }
        let (_, jacobian, _) = self.constraints(&self.motion(&y[..n], &y[n..]));
        let speed = &jacobian * DVector::from_column_slice(&y[n..]);
        let change = smallest_solution(&jacobian, &speed);
        y[n..].iter_mut().zip(&change).for_each(|(y, change)| *y -= change);
    }

    /// States of all bodies of the system at the given times (s, ascending), the base's first.
    pub fn states(&self, times: &[f64]) -> Vec<Vec<State>> {
        self.states_within(times, TOLERANCE)
    }

    /// The same with another tolerance: badly conditioned M leave no smooth slopes at the tightest.
    pub fn states_within(&self, times: &[f64], tolerance: f64) -> Vec<Vec<State>> {
        let n = self.links.len();
        let mut y = vec![0.0; 2 * n];
        y[n..].copy_from_slice(self.initial_rates.as_slice());
        let mut slope = |time: f64, y: &[f64], out: &mut [f64]| {
            out[..n].copy_from_slice(&y[n..]);
            out[n..].copy_from_slice(self.accelerations(time, &y[..n], &y[n..]).as_slice());
        };
        let mut now = 0.0;
        let still = State { pose: Isometry3::identity(), velocity: Vector3::zeros(), spin: Vector3::zeros() };
        let at = |time: &f64| {
            extrapolation::integrate(&mut slope, &mut y, now, *time, tolerance, &mut |y| self.project(y));
            now = *time;
            let motion = self.motion(&y[..n], &y[n..]);
            let mut states = vec![still; n + 1];
            self.bodies.iter().zip(motion.states).for_each(|(&body, state)| states[body] = state);
            states
        };
        times.iter().map(at).collect()
    }
}

/// The smallest x with A x = b, where some equations may repeat others. Rank-revealing: QR decomposition of Aᵀ with
/// pivots.
fn smallest_solution(a: &DMatrix<f64>, b: &DVector<f64>) -> DVector<f64> {
    let decomposition = a.transpose().col_piv_qr();
    let (q, r) = (decomposition.q(), decomposition.r());
    let mut values = b.clone();
    decomposition.p().permute_rows(&mut values);
    let rank = (0..r.nrows().min(r.ncols())).take_while(|&i| r[(i, i)].abs() > RANK * r[(0, 0)].abs()).count();
    // The pivots put independent equations first: Aᵀ P = Q R, so x = Q y with Rᵀ y = Pᵀ b.
    let independent = r.view((0, 0), (rank, rank)).transpose();
    let y = independent.solve_lower_triangular(&values.rows(0, rank)).expect("its diagonal is not zero");
    q.columns(0, rank) * y
}
