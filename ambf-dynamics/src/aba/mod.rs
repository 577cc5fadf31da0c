//! The articulated-body algorithm: accelerations of a tree of bodies under forces.
//!
//! Featherstone, *Rigid Body Dynamics Algorithms* (2008), chapter 7, with all quantities in world axes about the centre of mass of
//! their body, so that matrices need no rotation between links. Accelerations are classical, not spatial. The degrees of freedom of
//! a joint are treated like sliders and hinges between bodies without mass at the same place, the first of which is the nearest to
//! the base. SI units.
//!
//! `Motion` integrates the accelerations over a sub-step. All is generic over the [`Scalar`]: the same source moves one
//! world, and [four](together) side by side. [`articulation`] is what moves: a tree with what drives, limits and constrains its joints.
//! Who calls it is `cpp/articulation.cpp`, through [`ffi`]; the memory is the caller's, which saves it with the state of the world.

mod account;
pub mod algebra;
pub mod articulation;
#[cfg(target_arch = "x86_64")]
mod beside;
mod bounds;
mod coupling;
pub mod drives;
mod energy;
mod factor;
pub mod ffi;
#[cfg(target_arch = "x86_64")]
mod four;
mod list;
mod method;
mod motion;
mod rows;
pub mod scalar;
mod step;
pub mod together;

#[cfg(test)]
mod tests;

use algebra::{Inertia, Matrix, Quaternion, Symmetric, Vector};
use scalar::Scalar;

/// Kinds of joints; the numbers are those of `JointType` in C++.
const FIXED: i32 = 0;
const REVOLUTE: i32 = 1;
const PRISMATIC: i32 = 2;
const FREE: i32 = 4;

/// A link and its joint.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Link {
    parent: i32,
    kind: i32,
    coordinate: i32,
    sliding: i32,
    turning: i32,
    ball: i32,
    axis: Vector<f64>,
    pivot: Vector<f64>,
    rotation: Matrix<f64>,
    arm: Vector<f64>,
    turn: Matrix<f64>,
    turn2: Matrix<f64>,
}

impl Link {
    #[inline(always)]
    fn parent(&self) -> usize {
        self.parent as usize
    }

    /// Index of its first coordinate; only of joints that have one.
    #[inline(always)]
    fn coordinate(&self) -> usize {
        self.coordinate as usize
    }

    #[inline(always)]
    fn freedoms(&self) -> usize {
        (self.sliding + self.turning) as usize
    }

    fn is_equal(&self, other: &Self) -> bool {
        let numbers = |link: &Self| [link.parent, link.kind, link.coordinate, link.sliding, link.turning, link.ball];
        let (turn, other_turn) = (self.rotation.0.iter(), other.rotation.0.iter());
        let vectors = [self.axis, self.pivot, self.arm].into_iter().chain(turn.copied());
        let others = [other.axis, other.pivot, other.arm].into_iter().chain(other_turn.copied());
        let components = |v: Vector<f64>| [v.x, v.y, v.z];
        numbers(self) == numbers(other) && vectors.map(components).eq(others.map(components))
    }
}

/// A body.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Body<S: Scalar> {
    mass: S,
    inertia: Vector<S>,
    linear_drag: S,
    angular_drag: S,
    force: Vector<S>,
    torque: Vector<S>,
}

/// One degree of freedom of a joint: motion subspace S, U = I_A S, D = Sᵀ U and what is left of the force on it.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
struct Freedom<S: Scalar> {
    s_angular: Vector<S>,
    s_linear: Vector<S>,
    u_angular: Vector<S>,
    u_linear: Vector<S>,
    d: S,
    d_inverse: S,
    u: S,
    /// Acceleration that a rigid drive prescribes.
    given: S,
}

/// Intermediate results of a body, world axes.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Work<S: Scalar> {
    /// Of the body alone, and its least principal moment.
    inertia: Symmetric<S>,
    least_inertia: S,
    articulated: Inertia<S>,
    /// Bias.
    torque: Vector<S>,
    force: Vector<S>,
    /// From the parent's centre of mass to the body's.
    r: Vector<S>,
    /// Velocity-product acceleration.
    c_angular: Vector<S>,
    c_linear: Vector<S>,
    alpha: Vector<S>,
    accel: Vector<S>,
    freedoms: [Freedom<S>; 6],
}

impl<S: Scalar> Work<S> {
    #[inline(always)]
    fn zero() -> Self {
        let (zero, vector) = (S::splat(0.0), Vector::zero());
        let freedom = Freedom {
            s_angular: vector,
            s_linear: vector,
            u_angular: vector,
            u_linear: vector,
            d: zero,
            d_inverse: zero,
            u: zero,
            given: zero,
        };
        let inertia = Symmetric::zero();
        Self {
            inertia,
            least_inertia: zero,
            articulated: Inertia::of_body(inertia, zero),
            torque: vector,
            force: vector,
            r: vector,
            c_angular: vector,
            c_linear: vector,
            alpha: vector,
            accel: vector,
            freedoms: [freedom; 6],
        }
    }
}

/// What drives do to a coordinate: they add `inertia` to its articulated inertia D and have added `pull` to the force on it, or
/// prescribe its acceleration where `is_given` is 1. `force` is written: theirs in all.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Driven<S> {
    inertia: S,
    pull: S,
    is_given: S,
    given: S,
    force: S,
}

/// Forces on the coordinates, N·m or N, and what drives do to them; none where that list is empty.
pub struct Forces<'a, S: Scalar> {
    efforts: &'a [S],
    driven: &'a mut [Driven<S>],
}

/// Position: pose of the base, coordinates (rad or m), and rotations of the joints that turn about three axes, in their parents. The
/// three coordinates of such a rotation mean nothing: rotations have no coordinates whose rates are angular velocities.
#[derive(Debug)]
pub struct Position<'a, S: Scalar> {
    rotation: Quaternion<S>,
    origin: Vector<S>,
    q: &'a mut [S],
    balls: &'a mut [Quaternion<S>],
}

impl<S: Scalar> Position<'_, S> {
    #[inline(always)]
    fn copy(&mut self, other: &Position<'_, S>) {
        (self.rotation, self.origin) = (other.rotation, other.origin);
        self.q.copy_from_slice(other.q);
        self.balls.copy_from_slice(other.balls);
    }
}

impl<S: Scalar> Default for Position<'_, S> {
    #[inline(always)]
    fn default() -> Self {
        Self { rotation: Quaternion::identity(), origin: Vector::zero(), q: &mut [], balls: &mut [] }
    }
}

/// Velocity of the base and rates of the coordinates, or accelerations. Rates of a rotation about three axes are the components of the
/// relative angular velocity in the parent's axes.
#[derive(Debug)]
pub struct Rate<'a, S: Scalar> {
    angular: Vector<S>,
    linear: Vector<S>,
    q: &'a mut [S],
}

impl<S: Scalar> Rate<'_, S> {
    #[inline(always)]
    fn copy(&mut self, other: &Rate<'_, S>) {
        (self.angular, self.linear) = (other.angular, other.linear);
        self.q.copy_from_slice(other.q);
    }

    #[inline(always)]
    fn clear(&mut self) {
        (self.angular, self.linear) = (Vector::zero(), Vector::zero());
        self.q.fill(S::splat(0.0));
    }

    /// The three from a coordinate on.
    #[inline(always)]
    fn three(&self, first: usize) -> Vector<S> {
        Vector::new(self.q[first], self.q[first + 1], self.q[first + 2])
    }
}

impl<S: Scalar> Default for Rate<'_, S> {
    #[inline(always)]
    fn default() -> Self {
        Self { angular: Vector::zero(), linear: Vector::zero(), q: &mut [] }
    }
}

/// A tree. Arrays have one element a body, the base first; body i + 1 is link i.
pub struct Tree<'a, S: Scalar> {
    /// No force moves the base. It may be moved all the same, at a constant twist over a step.
    has_fixed_base: bool,
    /// Drag is no part of the equations.
    splits_damping: bool,
    links: &'a [Link],
    bodies: &'a mut [Body<S>],
    rotations: &'a mut [Matrix<S>],
    origins: &'a mut [Vector<S>],
    linear: &'a mut [Vector<S>],
    angular: &'a mut [Vector<S>],
    /// From the pivot of the joint to the centre of mass, and the axis of a joint of one freedom.
    arms: &'a mut [Vector<S>],
    axes: &'a mut [Vector<S>],
    work: &'a mut [Work<S>],
}

impl<S: Scalar> Tree<'_, S> {
    /// Forward kinematics.
    #[inline(always)]
    fn update_poses(&mut self, at: &Position<'_, S>) {
        self.rotations[0] = Matrix::of_quaternion(at.rotation);
        self.origins[0] = at.origin;
        for (i, link) in self.links.iter().enumerate() {
            let parent = self.rotations[link.parent()];
            let mut pivot = self.origins[link.parent()] + &parent * Vector::splat(&link.pivot);
            let rotation = if link.kind == REVOLUTE {
                let (sine, cosine) = at.q[link.coordinate()].sin_cos();
                let versine = S::splat(1.0) - cosine;
                let mut local = Matrix::splat(&link.rotation);
                for ((row, turn), turn2) in local.0.iter_mut().zip(&link.turn.0).zip(&link.turn2.0) {
                    *row = *row + Vector::splat(turn) * sine + Vector::splat(turn2) * versine;
                }
                &parent * &local
            } else if link.ball >= 0 {
                if link.kind == FREE {
                    let way = &at.q[link.coordinate()..];
                    pivot += &parent * Vector::new(way[0], way[1], way[2]);
                }
                &parent * &Matrix::of_quaternion(at.balls[link.ball as usize])
            } else {
                if link.kind == PRISMATIC {
                    pivot += (&parent * Vector::splat(&link.axis)) * at.q[link.coordinate()];
                }
                &parent * &Matrix::splat(&link.rotation)
            };
            self.rotations[i + 1] = rotation;
            if link.freedoms() == 1 {
                self.axes[i + 1] = &parent * Vector::splat(&link.axis);
            }
            self.arms[i + 1] = &rotation * Vector::splat(&link.arm);
            self.origins[i + 1] = pivot + self.arms[i + 1];
        }
    }

    /// Velocities, motion subspaces and velocity-product accelerations; poses are up to date.
    #[inline(always)]
    fn update_velocities(&mut self, rate: &Rate<'_, S>) {
        self.angular[0] = rate.angular;
        self.linear[0] = rate.linear;
        for (i, link) in self.links.iter().enumerate() {
            let w = &mut self.work[i + 1];
            let omega = self.angular[link.parent()];
            w.r = self.origins[i + 1] - self.origins[link.parent()];
            let mut angular = omega;
            let mut linear = self.linear[link.parent()] + omega.cross(w.r);
            w.c_angular = Vector::zero();
            if link.kind == FIXED {
                w.c_linear = omega.cross(omega.cross(w.r));
            } else if link.kind == PRISMATIC {
                let (axis, speed) = (self.axes[i + 1], rate.q[link.coordinate()]);
                w.freedoms[0].s_angular = Vector::zero();
                w.freedoms[0].s_linear = axis;
                w.c_linear = omega.cross(omega.cross(w.r)) + omega.cross(axis) * (S::splat(2.0) * speed);
                linear += axis * speed;
            } else {
                let (parent, arm) = (&self.rotations[link.parent()], self.arms[i + 1]);
                let (sliding, freedoms) = (link.sliding as usize, link.freedoms());
                let rates = &rate.q[link.coordinate()..][..freedoms];
                let mut slide = Vector::zero();
                for (k, &speed) in rates[..sliding].iter().enumerate() {
                    w.freedoms[k].s_angular = Vector::zero();
                    w.freedoms[k].s_linear = parent.column(k);
                    slide += w.freedoms[k].s_linear * speed;
                }
                for (k, &speed) in rates.iter().enumerate().skip(sliding) {
                    let axis = if link.turning == 3 { parent.column(k - sliding) } else { self.axes[i + 1] };
                    let way = axis.cross(arm);
                    w.freedoms[k].s_angular = axis;
                    w.freedoms[k].s_linear = way;
                    angular += axis * speed;
                    linear += way * speed;
                    w.c_angular += omega.cross(axis) * speed;
                }
                w.c_linear =
                    w.c_angular.cross(arm) + omega.cross(omega.cross(w.r - arm)) + angular.cross(angular.cross(arm));
                if sliding > 0 {
                    linear += slide;
                    w.c_linear += omega.cross(slide) * S::splat(2.0);
                }
            }
            self.angular[i + 1] = angular;
            self.linear[i + 1] = linear;
        }
    }

    /// Accelerations under forces. Poses and velocities are up to date, or are brought to those `at` a position: they are undefined
    /// afterwards then.
    #[inline(always)]
    fn find_accelerations(
        &mut self,
        at: Option<&Position<'_, S>>,
        rate: &Rate<'_, S>,
        forces: Forces<'_, S>,
        out: &mut Rate<'_, S>,
    ) {
        if let Some(at) = at {
            self.update_poses(at);
            self.update_velocities(rate);
        }
        [out.angular, out.linear] = self.accelerate(forces.efforts, forces.driven, out.q);
    }

    /// Inertias of the bodies alone.
    #[inline(always)]
    fn set_inertias(&mut self) {
        for i in usize::from(self.has_fixed_base)..self.bodies.len() {
            let (body, w) = (&self.bodies[i], &mut self.work[i]);
            w.inertia = Symmetric::of_moments(&self.rotations[i], body.inertia);
            w.least_inertia = body.inertia.x.or_smaller(body.inertia.y).or_smaller(body.inertia.z);
            w.articulated = Inertia::of_body(w.inertia, body.mass);
        }
    }

    /// Accelerations of the base (angular, linear) and of the coordinates under forces and `efforts`; poses and velocities are up to
    /// date. Without drives there are none.
    #[inline(always)]
    fn accelerate(&mut self, efforts: &[S], drives: &mut [Driven<S>], out: &mut [S]) -> [Vector<S>; 2] {
        self.set_inertias();
        for i in usize::from(self.has_fixed_base)..self.bodies.len() {
            let (body, w, angular) = (&self.bodies[i], &mut self.work[i], self.angular[i]);
            let momentum = w.inertia.times(angular);
            w.torque = angular.cross(momentum) - body.torque;
            w.force = -body.force;
            if !self.splits_damping {
                w.torque += momentum * body.angular_drag;
                w.force += self.linear[i] * (body.mass * body.linear_drag);
            }
        }
        self.sweep::<true>(efforts, drives, out)
    }

    /// U, D and 1 / D of a degree of freedom. The articulated inertia of a link is at least that of the link itself; what the links
    /// beyond it add may cancel but for a rounding error that is larger.
    #[inline(always)]
    fn set_joint_inertia(articulated: &Inertia<S>, least_inertia: S, freedom: &mut Freedom<S>) {
        let (s_angular, s_linear) = (freedom.s_angular, freedom.s_linear);
        let (u_angular, u_linear) = articulated.times(s_angular, s_linear);
        let d = s_angular.dot(u_angular) + s_linear.dot(u_linear);
        freedom.u_angular = u_angular;
        freedom.u_linear = u_linear;
        freedom.d = d.or_larger(s_angular.dot(s_angular) * least_inertia);
        freedom.d_inverse = freedom.d.if_positive(S::splat(1.0) / freedom.d, S::splat(0.0));
    }

    /// Second and third pass of the algorithm: from the leaves to the base and back. Inertias and bias forces of all bodies are set.
    /// Without bias, impulses take the places of forces and changes of velocity those of accelerations.
    #[inline(always)]
    fn sweep<const WITH_BIAS: bool>(
        &mut self,
        efforts: &[S],
        drives: &mut [Driven<S>],
        out: &mut [S],
    ) -> [Vector<S>; 2] {
        let (zero, one) = (S::splat(0.0), S::splat(1.0));
        for (i, link) in self.links.iter().enumerate().rev() {
            let is_last = link.parent() == 0 && self.has_fixed_base;
            let (nearer, farther) = self.work.split_at_mut(i + 1);
            let w = &mut farther[0];
            let (mut torque, mut force) = (w.torque, w.force);
            for k in (0..link.freedoms()).rev() {
                let freedom = &mut w.freedoms[k];
                Self::set_joint_inertia(&w.articulated, w.least_inertia, freedom);
                let coordinate = link.coordinate() + k;
                freedom.u = efforts[coordinate] - freedom.s_angular.dot(torque) - freedom.s_linear.dot(force);
                freedom.given = zero;
                if let Some(drive) = drives.get(coordinate) {
                    let driven = drive.inertia.if_positive(one / (freedom.d + drive.inertia), freedom.d_inverse);
                    freedom.d_inverse = drive.is_given.if_positive(zero, driven);
                    freedom.given = drive.is_given.if_positive(drive.given, zero);
                }
                if is_last && k == 0 {
                    break;
                }
                w.articulated.remove(freedom.u_angular, freedom.u_linear, freedom.d_inverse);
                let acceleration = freedom.u * freedom.d_inverse + freedom.given;
                torque += freedom.u_angular * acceleration;
                force += freedom.u_linear * acceleration;
            }
            if is_last {
                continue;
            }
            if WITH_BIAS {
                let (of_torque, of_force) = w.articulated.times(w.c_angular, w.c_linear);
                torque += of_torque;
                force += of_force;
            }
            let parent = &mut nearer[link.parent()];
            Self::add_to_parent(link, w, parent);
            parent.torque += torque + w.r.cross(force);
            parent.force += force;
        }
        let base = &mut self.work[0];
        base.alpha = Vector::zero();
        base.accel = Vector::zero();
        if !self.has_fixed_base {
            (base.alpha, base.accel) = Self::solve_base(base, &self.bodies[0]);
        }
        let of_base = [base.alpha, base.accel];
        for (i, link) in self.links.iter().enumerate() {
            let (nearer, farther) = self.work.split_at_mut(i + 1);
            let (w, parent) = (&mut farther[0], &nearer[link.parent()]);
            let mut alpha = parent.alpha;
            let mut accel = parent.accel + alpha.cross(w.r);
            if WITH_BIAS {
                alpha += w.c_angular;
                accel += w.c_linear;
            }
            for (k, freedom) in w.freedoms[..link.freedoms()].iter().enumerate() {
                let coordinate = link.coordinate() + k;
                let left = freedom.u - freedom.u_angular.dot(alpha) - freedom.u_linear.dot(accel);
                let acceleration = left * freedom.d_inverse + freedom.given;
                if let Some(drive) = drives.get_mut(coordinate) {
                    drive.force = freedom.d * acceleration - (left - drive.pull);
                }
                alpha += freedom.s_angular * acceleration;
                accel += freedom.s_linear * acceleration;
                out[coordinate] = acceleration;
            }
            w.alpha = alpha;
            w.accel = accel;
        }
        of_base
    }

    /// Adds the articulated inertia of a link, shifted to the parent's centre of mass, to that of the parent. A link with six degrees
    /// of freedom would add nothing but rounding errors.
    #[inline(always)]
    fn add_to_parent(link: &Link, w: &Work<S>, parent: &mut Work<S>) {
        if link.freedoms() < 6 {
            parent.articulated.add(&w.articulated, w.r);
        }
    }

    /// Accelerations (angular, linear) of a free base, by the Cholesky factor of its articulated inertia. The pivots are at least those
    /// of the inertia of the base itself, as in [`set_joint_inertia`](Self::set_joint_inertia).
    #[inline(always)]
    fn solve_base(base: &Work<S>, body: &Body<S>) -> (Vector<S>, Vector<S>) {
        let (p, q) = (-base.torque, -base.force);
        let (right, least) = ([p.x, p.y, p.z, q.x, q.y, q.z], [base.least_inertia, body.mass]);
        let zero = S::splat(0.0);
        let (mut l, mut v) = ([[zero; 6]; 6], [zero; 6]);
        for i in 0..6 {
            for j in 0..=i {
                let mut sum = base.articulated.element(i, j);
                for (a, b) in l[i][..j].iter().zip(&l[j]) {
                    sum -= *a * *b;
                }
                l[i][j] = if i == j { sum.or_larger(least[i / 3]).sqrt() } else { sum / l[j][j] };
            }
            let mut sum = right[i];
            for k in 0..i {
                sum -= l[i][k] * v[k];
            }
            v[i] = sum / l[i][i];
        }
        for i in (0..6).rev() {
            for k in i + 1..6 {
                let part = l[k][i] * v[k];
                v[i] -= part;
            }
            v[i] = v[i] / l[i][i];
        }
        (Vector::new(v[0], v[1], v[2]), Vector::new(v[3], v[4], v[5]))
    }
}
