//! Energies and momenta of a tree, from the poses and velocities of its bodies.

use super::algebra::{Matrix, Vector};
use super::motion::{Equations, Motion, Spring};
use super::scalar::Scalar;
use super::{Position, Rate, Tree};

/// Linear (N·s) and angular (N·m·s) momentum, or a force and a torque.
#[derive(Debug, Clone, Copy)]
pub struct Momentum<S: Scalar> {
    pub linear: Vector<S>,
    pub angular: Vector<S>,
}

impl<S: Scalar> Momentum<S> {
    #[inline(always)]
    pub fn zero() -> Self {
        Self { linear: Vector::zero(), angular: Vector::zero() }
    }
}

#[inline(always)]
fn over<S: Scalar>(v: Vector<S>, number: S) -> Vector<S> {
    v * (S::splat(1.0) / number)
}

impl<S: Scalar> Tree<'_, S> {
    /// Whether a fixed base moves, in one of the worlds.
    #[inline(always)]
    pub fn is_carried(&self) -> bool {
        self.has_fixed_base
            && [self.linear[0], self.angular[0]].into_iter().any(|v| (0..S::WORLDS).any(|world| !is_zero(v, world)))
    }

    /// The velocity that a body would have with a fixed base that moves if all joints were rigid.
    #[inline(always)]
    fn carried_linear(&self, body: usize) -> Vector<S> {
        self.linear[0] + self.angular[0].cross(self.origins[body] - self.origins[0])
    }

    /// Kinetic energy of all bodies, J.
    #[inline(always)]
    pub fn kinetic_energy(&self) -> S {
        let mut sum = S::splat(0.0);
        for i in usize::from(self.has_fixed_base)..self.bodies.len() {
            let local = self.rotations[i].transposed_times(self.angular[i]);
            let body = &self.bodies[i];
            sum += body.mass * self.linear[i].square() + local.dot(local.times(body.inertia));
        }
        sum / S::splat(2.0)
    }

    /// Linear momentum of all bodies, N·s.
    #[inline(always)]
    pub fn linear_momentum(&self) -> Vector<S> {
        let mut sum = Vector::zero();
        for (velocity, body) in self.linear.iter().zip(&*self.bodies) {
            sum += *velocity * body.mass;
        }
        sum
    }

    /// kg
    #[inline(always)]
    pub fn mass(&self) -> S {
        let mut sum = S::splat(0.0);
        for body in &*self.bodies {
            sum += body.mass;
        }
        sum
    }

    /// Centre of mass, m.
    #[inline(always)]
    pub fn mass_centre(&self) -> Vector<S> {
        let mut sum = Vector::zero();
        for (origin, body) in self.origins.iter().zip(&*self.bodies) {
            sum += *origin * body.mass;
        }
        over(sum, self.mass())
    }

    /// Sum of the external forces, N.
    #[inline(always)]
    pub fn total_force(&self) -> Vector<S> {
        let mut sum = Vector::zero();
        for body in &*self.bodies {
            sum += body.force;
        }
        sum
    }

    /// Internal energy, J: the kinetic energy without that of the centre of mass if the base is free, and relative to the base if that is
    /// fixed: it depends neither on the speed of a fall nor on that at which a base is moved.
    #[inline(always)]
    pub fn internal_energy(&self) -> S {
        let two = S::splat(2.0);
        if !self.has_fixed_base {
            let of_centre = self.linear_momentum().square() / (two * self.mass());
            return (self.kinetic_energy() - of_centre).or_larger(S::splat(0.0));
        }
        if !self.is_carried() {
            return self.kinetic_energy();
        }
        let mut sum = S::splat(0.0);
        for i in 1..self.bodies.len() {
            let local = self.rotations[i].transposed_times(self.angular[i] - self.angular[0]);
            let body = &self.bodies[i];
            sum +=
                body.mass * (self.linear[i] - self.carried_linear(i)).square() + local.dot(local.times(body.inertia));
        }
        sum / two
    }

    /// Power of the forces on all bodies that a moved base carries, W: it does not change the internal energy.
    #[inline(always)]
    pub fn carrying_power(&self) -> S {
        let mut power = S::splat(0.0);
        if self.is_carried() {
            for i in 1..self.bodies.len() {
                let body = &self.bodies[i];
                power += body.force.dot(self.carried_linear(i)) + body.torque.dot(self.angular[0]);
            }
        }
        power
    }

    /// Kinetic energy of all bodies in a rigid turn with a base that is turned, J. Its change with the joints is the work of the
    /// centrifugal forces on the motion relative to the base; those of Coriolis do none.
    #[inline(always)]
    pub fn centrifugal_energy(&self) -> S {
        let mut sum = S::splat(0.0);
        for i in 1..self.bodies.len() {
            let local = self.rotations[i].transposed_times(self.angular[0]);
            let (body, arm) = (&self.bodies[i], self.origins[i] - self.origins[0]);
            sum += body.mass * self.angular[0].cross(arm).square() + local.dot(local.times(body.inertia));
        }
        sum / S::splat(2.0)
    }

    /// Angular momentum of a body about its own centre of mass, N·m·s.
    #[inline(always)]
    pub fn angular_momentum(&self, body: usize) -> Vector<S> {
        let rotation = &self.rotations[body];
        rotation * rotation.transposed_times(self.angular[body]).times(self.bodies[body].inertia)
    }

    /// Momentum of all bodies about a point.
    #[inline(always)]
    pub fn momentum(&self, about: Vector<S>) -> Momentum<S> {
        let mut sum = Momentum::zero();
        for i in 0..self.bodies.len() {
            let part = self.linear[i] * self.bodies[i].mass;
            sum.linear += part;
            sum.angular += self.angular_momentum(i) + (self.origins[i] - about).cross(part);
        }
        sum
    }

    /// Rates of change of the momentum about a point by the external forces and torques and by the drag that the equations of motion
    /// hold, N and N·m.
    #[inline(always)]
    pub fn wrench(&self, about: Vector<S>) -> Momentum<S> {
        let mut sum = Momentum::zero();
        for (i, body) in self.bodies.iter().enumerate() {
            let (mut force, mut torque) = (body.force, body.torque);
            if !self.splits_damping {
                force -= self.linear[i] * (body.mass * body.linear_drag);
                torque -= self.angular_momentum(i) * body.angular_drag;
            }
            sum.linear += force;
            sum.angular += torque + (self.origins[i] - about).cross(force);
        }
        sum
    }

    /// Power that drag adds to the internal energy, W, at least 0: joined bodies of different drag that fall accelerate each other.
    #[inline(always)]
    pub fn drag_power(&self) -> S {
        let mut power = S::splat(0.0);
        if self.has_fixed_base && !self.is_carried() {
            return power;
        }
        if self.has_fixed_base {
            for i in 1..self.bodies.len() {
                let (body, velocity) = (&self.bodies[i], self.linear[i]);
                power -= body.mass * body.linear_drag * velocity.dot(velocity - self.carried_linear(i))
                    + body.angular_drag * self.angular_momentum(i).dot(self.angular[i] - self.angular[0]);
            }
        } else {
            let whole = over(self.linear_momentum(), self.mass());
            for (velocity, body) in self.linear.iter().zip(&*self.bodies) {
                power -= body.mass * body.linear_drag * velocity.dot(*velocity - whole);
            }
        }
        power.or_larger(S::splat(0.0))
    }

    /// Power of the external torques, W.
    #[inline(always)]
    pub fn twist_power(&self) -> S {
        let mut power = S::splat(0.0);
        for (omega, body) in self.angular.iter().zip(&*self.bodies) {
            power += body.torque.dot(*omega);
        }
        power
    }

    /// Angular velocity of a link relative to its parent, rad/s.
    #[inline(always)]
    pub fn joint_speed(link: &super::Link, rate: &Rate<'_, S>) -> S {
        match link.turning {
            0 => S::splat(0.0),
            1 => rate.q[link.coordinate()].abs(),
            _ => rate.three(link.coordinate() + link.sliding as usize).length(),
        }
    }

    /// Largest of these, rad/s.
    #[inline(always)]
    pub fn fastest_coordinate(&self, rate: &Rate<'_, S>) -> S {
        let mut fastest = S::splat(0.0);
        for link in self.links {
            fastest = fastest.or_larger(Self::joint_speed(link, rate));
        }
        fastest
    }

    /// Largest angular velocity of a body or joint, rad/s.
    #[inline(always)]
    pub fn fastest_rotation(&self, rate: &Rate<'_, S>) -> S {
        let mut square = S::splat(0.0);
        for omega in &*self.angular {
            square = square.or_larger(omega.square());
        }
        square.sqrt().or_larger(self.fastest_coordinate(rate))
    }

    /// Largest component of rates or accelerations.
    #[inline(always)]
    pub fn largest_component(rate: &Rate<'_, S>) -> S {
        let mut most = rate.linear.length().or_larger(rate.angular.length());
        for q in &*rate.q {
            most = most.or_larger(q.abs());
        }
        most
    }
}

#[inline(always)]
pub fn is_zero<S: Scalar>(v: Vector<S>, world: usize) -> bool {
    v.x.of(world) == 0.0 && v.y.of(world) == 0.0 && v.z.of(world) == 0.0
}

impl Tree<'_, f64> {
    /// Multiplies all velocities relative to the centre of mass by `share`; the rates are those of the bodies.
    pub fn scale_internal_velocity(&self, share: f64, rate: &mut Rate<'_, f64>) {
        rate.q.iter_mut().for_each(|q| *q *= share);
        if self.has_fixed_base {
            return;
        }
        // The velocity of the centre of mass is kept.
        let velocity = over(self.linear_momentum(), self.mass());
        rate.angular = rate.angular * share;
        rate.linear = velocity + (rate.linear - velocity) * share;
    }

    /// Adds a rigid motion of the whole tree, which has a free base, so that its momentum about a point becomes that given.
    pub fn set_momentum(&mut self, wanted: &Momentum<f64>, about: Vector<f64>, rate: &mut Rate<'_, f64>) {
        let (mass, centre) = (self.mass(), self.mass_centre());
        let mut inertia = [[0.0; 3]; 3];
        for (i, body) in self.bodies.iter().enumerate() {
            let (arm, rotation) = (self.origins[i] - centre, &self.rotations[i].0);
            let arms = [arm.x, arm.y, arm.z];
            for (row, sums) in inertia.iter_mut().enumerate() {
                let scaled = rotation[row].times(body.inertia);
                for (column, sum) in sums.iter_mut().enumerate() {
                    *sum += scaled.dot(rotation[column]);
                    if row == column {
                        *sum += body.mass * arm.square();
                    }
                    *sum -= arms[column] * (arms[row] * body.mass);
                }
            }
        }
        let present = self.momentum(about);
        let change = wanted.linear - present.linear;
        let turn = solve_three(&inertia, wanted.angular - present.angular - (centre - about).cross(change));
        rate.angular += turn;
        rate.linear += change * (1.0 / mass) + turn.cross(self.origins[0] - centre);
        self.update_velocities(rate);
    }
}

/// Solves three linear equations; a singular matrix gives 0.
fn solve_three(rows: &[[f64; 3]; 3], b: Vector<f64>) -> Vector<f64> {
    let matrix = Matrix(rows.map(|[x, y, z]| Vector::new(x, y, z)));
    let (x, y, z) = (matrix.column(0), matrix.column(1), matrix.column(2));
    let normal = y.cross(z);
    let determinant = x.dot(normal);
    if determinant == 0.0 {
        return Vector::zero();
    }
    over(Vector::new(b.dot(normal), x.dot(b.cross(z)), x.dot(y.cross(b))), determinant)
}

/// Work of forces, generalised forces and springs, J: on the motion relative to the centre of mass if the base is free and to the base if
/// it is fixed, and on that of the centre of mass.
#[derive(Debug, Clone, Copy)]
pub struct Works<S> {
    pub internal: S,
    pub of_mass_centre: S,
}

impl<S: Scalar> Spring<S> {
    /// Wrapped half a turn away from the rest position, where the elastic energy is continuous; rad or m.
    #[inline(always)]
    pub fn displacement(&self, q: S) -> S {
        let x = self.sign * q + self.offset - self.rest;
        if self.is_angle {
            x.wrapped()
        } else {
            x
        }
    }
}

impl<S: Scalar> Equations<'_, '_, S> {
    /// Elastic energy, J, of the springs that are integrated with the motion.
    #[inline(always)]
    pub fn elastic_energy(&self, at: &Position<'_, S>) -> S {
        let mut sum = S::splat(0.0);
        for spring in self.springs.iter().filter(|spring| !spring.is_stiff) {
            let x = spring.displacement(at.q[spring.coordinate()]);
            sum += spring.stiffness * x * x;
        }
        sum / S::splat(2.0)
    }
}

impl<S: Scalar> Motion<'_, '_, S> {
    /// Works between the position at the beginning of the step and `to`, whose poses and velocities are the present ones.
    #[inline(always)]
    pub fn works_of_forces(&self, h: f64, from: &Position<'_, S>, to: &Position<'_, S>) -> Works<S> {
        let (zero, equations) = (S::splat(0.0), &self.equations);
        let tree = &equations.tree;
        // Forces are constant, so that their work is exact.
        let elastic = if equations.springs.is_empty() { zero } else { equations.elastic_energy(to) };
        let mut works = Works { internal: self.start.elastic_energy - elastic, of_mass_centre: zero };
        let mut moved = Vector::zero();
        for (i, body) in tree.bodies.iter().enumerate() {
            let way = tree.origins[i] - self.start_origins[i];
            works.internal += body.force.dot(way);
            moved += way * body.mass;
        }
        if !tree.has_fixed_base {
            works.of_mass_centre = tree.total_force().dot(moved) / tree.mass();
        }
        works.internal -= works.of_mass_centre;
        for k in 0..to.q.len() {
            let way = to.q[k] - from.q[k];
            // The forces that bound accelerations may take energy and add none.
            let bounding = (equations.forces[k] - self.unbounded[k]) * way;
            works.internal += self.unbounded[k] * way + bounding.or_smaller(zero);
        }
        if tree.is_carried() {
            works.internal += tree.centrifugal_energy() - self.start.centrifugal_energy;
            works.internal -= S::splat(h / 2.0) * (self.start.carrying_power + tree.carrying_power());
        }
        works
    }
}

impl Equations<'_, '_, f64> {
    /// Bound of the work of all forces over h s at the velocities of the bodies and this rate at a position, J. All elastic energy of
    /// springs that are integrated with the motion counts.
    pub fn work_at_rate(&self, h: f64, at: &Position<'_, f64>, rate: &Rate<'_, f64>) -> f64 {
        let (tree, mut power) = (&self.tree, 0.0);
        let is_carried = tree.is_carried();
        for (i, body) in tree.bodies.iter().enumerate() {
            let zero = Vector::zero();
            let (way, turn) = if is_carried { (tree.carried_linear(i), tree.angular[0]) } else { (zero, zero) };
            power += body.force.dot(tree.linear[i] - way) + body.torque.dot(tree.angular[i] - turn);
        }
        for (force, speed) in self.forces.iter().zip(&*rate.q) {
            power += force * speed;
        }
        h * power + self.elastic_energy(at)
    }
}

impl Motion<'_, '_, f64> {
    /// Bound of the rounding error of the work of forces, efforts and springs in a step at this position, J: it is the sum of differences
    /// of positions, of elastic energies and of displacements of springs, which nearly cancel at rest.
    pub fn rounding_of_work(&self, at: &Position<'_, f64>) -> f64 {
        const OPERATIONS: f64 = 8.0;
        let mut sum = 0.0;
        for (body, origin) in self.equations.tree.bodies.iter().zip(&*self.start_origins) {
            sum += body.force.length() * origin.length();
        }
        for (force, q) in self.equations.forces.iter().zip(&*at.q) {
            sum += (force * q).abs();
        }
        for spring in self.equations.springs.iter().filter(|spring| !spring.is_stiff) {
            let q = at.q[spring.coordinate()];
            let x = spring.displacement(q).abs();
            sum += spring.stiffness * x * (x + q.abs() + spring.offset.abs() + spring.rest.abs());
        }
        OPERATIONS * f64::EPSILON * sum
    }
}
