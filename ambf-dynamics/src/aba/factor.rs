//! The factor of the generalised inertia, and rows of the Jacobian.

use super::algebra::Vector;
use super::Tree;

impl Tree<'_, f64> {
    /// Finds the rates with the least kinetic energy of the difference between the velocities of the bodies and those wanted; writes
    /// those of the coordinates and returns those of a free base (angular, linear). Poses are up to date, velocities are those that
    /// the base gives to bodies without rates of joints.
    pub fn project(
        &mut self,
        linear: &[Vector<f64>],
        angular: &[Vector<f64>],
        efforts: &[f64],
        out: &mut [f64],
    ) -> [Vector<f64>; 2] {
        self.set_inertias();
        for i in usize::from(self.has_fixed_base)..self.bodies.len() {
            let (mut turn, mut way) = (angular[i], linear[i]);
            if self.has_fixed_base {
                turn -= self.angular[0];
                way -= self.linear[0] + self.angular[0].cross(self.origins[i] - self.origins[0]);
            }
            let w = &mut self.work[i];
            w.torque = -w.inertia.times(turn);
            w.force = way * -self.bodies[i].mass;
        }
        self.sweep::<false>(efforts, &mut [], out)
    }

    /// Writes L, where the generalised inertia is Lᵀ L, by rows, and the inverses of its diagonal. The first six components are those of
    /// the base, angular first; they are left out where it is fixed. Poses and velocities are up to date.
    ///
    /// Row k of L is U / √D of degree of freedom k, projected onto each joint on the path to the base (Featherstone 2008, section 6.5).
    /// This is more accurate than factoring the generalised inertia, where large numbers cancel if heavy links hang on light ones.
    pub fn factor(&mut self, factor: &mut [f64], inverse_diagonal: &mut [f64]) {
        let n = inverse_diagonal.len();
        self.set_inertias();
        for (i, link) in self.links.iter().enumerate().rev() {
            let is_last = link.parent() == 0 && self.has_fixed_base;
            for f in (0..link.freedoms()).rev() {
                let w = &mut self.work[i + 1];
                Self::set_joint_inertia(&w.articulated, w.least_inertia, &mut w.freedoms[f]);
                let freedom = w.freedoms[f];
                let k = 6 + link.coordinate() + f;
                let inverse = freedom.d_inverse.sqrt();
                inverse_diagonal[k] = inverse;
                let row = &mut factor[k * n..][..n];
                row[k] = if inverse > 0.0 { 1.0 / inverse } else { 0.0 };
                let (mut torque, force) = (freedom.u_angular * inverse, freedom.u_linear * inverse);
                let (mut before, mut body) = (f, i + 1);
                while body > 0 {
                    let (joint, at) = (&self.links[body - 1], &self.work[body]);
                    for (j, other) in at.freedoms[..before].iter().enumerate() {
                        row[6 + joint.coordinate() + j] = other.s_angular.dot(torque) + other.s_linear.dot(force);
                    }
                    torque += at.r.cross(force);
                    body = joint.parent();
                    before = if body > 0 { self.links[body - 1].freedoms() } else { 0 };
                }
                row[..6].copy_from_slice(&[torque.x, torque.y, torque.z, force.x, force.y, force.z]);
                if !is_last || f > 0 {
                    let articulated = &mut self.work[i + 1].articulated;
                    articulated.remove(freedom.u_angular, freedom.u_linear, freedom.d_inverse);
                }
            }
            if !is_last {
                let (nearer, farther) = self.work.split_at_mut(i + 1);
                Self::add_to_parent(link, &farther[0], &mut nearer[link.parent()]);
            }
        }
        if !self.has_fixed_base {
            self.factor_base(factor, inverse_diagonal);
        }
    }

    fn factor_base(&self, factor: &mut [f64], inverse_diagonal: &mut [f64]) {
        let (n, base) = (inverse_diagonal.len(), &self.work[0]);
        for k in 0..6 {
            for j in 0..=k {
                factor[k * n + j] = base.articulated.element(k, j);
            }
        }
        for k in (0..6).rev() {
            let least = if k < 3 { base.least_inertia } else { self.bodies[0].mass };
            let diagonal = if factor[k * n + k] < least { least } else { factor[k * n + k] };
            inverse_diagonal[k] = if diagonal > 0.0 { 1.0 / diagonal.sqrt() } else { 0.0 };
            factor[k * n + k] = diagonal;
            for i in 0..=k {
                factor[k * n + i] *= inverse_diagonal[k];
            }
            for i in 0..k {
                for j in 0..=i {
                    factor[i * n + j] -= factor[k * n + i] * factor[k * n + j];
                }
            }
        }
    }

    /// Adds to a row of the Jacobian of the velocities the part of an impulse along `force` at the centre of mass of a body, and along
    /// `torque`; with the coordinates of its own joint only, an impulse between it and its parent.
    pub fn add_jacobian(
        &self,
        body: usize,
        force: Vector<f64>,
        torque: Vector<f64>,
        of_joint_only: bool,
        row: &mut [f64],
    ) {
        let (mut body, mut twist) = (body, torque);
        while body > 0 {
            let (link, w) = (&self.links[body - 1], &self.work[body]);
            for (k, freedom) in w.freedoms[..link.freedoms()].iter().enumerate() {
                row[6 + link.coordinate() + k] += freedom.s_angular.dot(twist) + freedom.s_linear.dot(force);
            }
            if of_joint_only {
                return;
            }
            twist += w.r.cross(force);
            body = link.parent();
        }
        if self.has_fixed_base {
            return;
        }
        for (sum, part) in row.iter_mut().zip([twist.x, twist.y, twist.z, force.x, force.y, force.z]) {
            *sum += part;
        }
    }
}
