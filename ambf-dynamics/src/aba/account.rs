//! The energy of an articulation, and the works in a sub-step that explain its changes.

use super::algebra::Vector;
use super::articulation::{Articulation, Store};
use super::motion::Spring;
use super::rows::At;
use super::{Position, Rate};

/// Energies of an articulation, J.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Energy {
    /// Of the motion of all bodies.
    pub kinetic: f64,
    /// Of gravity, 0 at the origin of the world.
    pub potential: f64,
    /// Of springs.
    pub elastic: f64,
}

impl Energy {
    fn total(self) -> f64 {
        self.kinetic + self.potential + self.elastic
    }
}

/// Works that explain changes of the energy, J, as `AmbEnergy` has them.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct Sums {
    /// States that were set.
    pub set_states: f64,
    /// Corrections of positions.
    pub corrections: f64,
    /// Poses that are ahead of velocities.
    pub contacts: f64,
    /// External forces and torques but gravity.
    pub wrenches: f64,
    /// Damping and stiff springs.
    pub damping: f64,
    /// Motors.
    pub motors: f64,
    /// Limits.
    pub limits: f64,
}

/// Accounts of the energy, which are kept where that is asked for.
pub struct Account<'a> {
    /// After the last sub-step.
    pub energy: Energy,
    /// Since they were taken last.
    pub sums: Sums,
    /// Time by which the poses are ahead of the velocities, s.
    pub pose_lead: f64,
    /// State at the beginning of the sub-step.
    position: Position<'a, f64>,
    rate: Rate<'a, f64>,
    origins: &'a mut [Vector<f64>],
    linear: &'a mut [Vector<f64>],
    angular: &'a mut [Vector<f64>],
    /// Power of the angular damping, W.
    drag: f64,
    /// Change by position corrections of the elastic energy of stiff springs, whose damping work is computed from their rows, J.
    corrected: f64,
}

impl<'a> Account<'a> {
    pub(super) fn new(
        store: &mut impl Store<'a>,
        bodies: usize,
        position: Position<'a, f64>,
        rate: Rate<'a, f64>,
    ) -> Self {
        let mut vectors = || store.take(bodies, Vector::zero);
        Self {
            energy: Energy::default(),
            sums: Sums::default(),
            pose_lead: 0.0,
            position,
            rate,
            origins: vectors(),
            linear: vectors(),
            angular: vectors(),
            drag: 0.0,
            corrected: 0.0,
        }
    }
}

/// Midpoint rate of a cubic through two values and their rates.
fn middle_of(way: Vector<f64>, before: Vector<f64>, after: Vector<f64>, h: f64) -> Vector<f64> {
    way * (1.5 / h) - (before + after) * (1.0 / 4.0)
}

fn elastic(spring: &Spring<f64>, q: f64) -> f64 {
    let x = spring.displacement(q);
    spring.stiffness * x * x / 2.0
}

impl Articulation<'_> {
    /// Takes the present energy, with potential and elastic energy evaluated where the velocities are.
    pub fn note_energy(&mut self) {
        let (tree, by) = (&self.motion.equations.tree, self.account.pose_lead);
        let mut sum = Energy { kinetic: tree.kinetic_energy(), ..Energy::default() };
        for i in usize::from(tree.has_fixed_base)..tree.bodies.len() {
            let weight = self.gravity[i] * tree.bodies[i].mass;
            sum.potential -= weight.dot(tree.origins[i] - tree.linear[i] * by);
        }
        for spring in &*self.motion.equations.springs {
            let k = spring.coordinate();
            sum.elastic += elastic(spring, self.position.q[k] - self.rate.q[k] * by);
        }
        self.account.energy = sum;
    }

    /// Adds the energy of states that were set since the last sub-step, and stores the state at the beginning of this one.
    pub(super) fn begin_account(&mut self) {
        let before = self.account.energy.total();
        self.note_energy();
        let (tree, account) = (&self.motion.equations.tree, &mut self.account);
        account.sums.set_states += account.energy.total() - before;
        account.position.copy(&self.position);
        account.rate.copy(&self.rate);
        account.origins.copy_from_slice(tree.origins);
        account.linear.copy_from_slice(tree.linear);
        account.angular.copy_from_slice(tree.angular);
        (account.drag, account.corrected) = (0.0, 0.0);
        for i in usize::from(tree.has_fixed_base)..tree.bodies.len() {
            account.drag += tree.bodies[i].angular_drag * tree.angular[i].dot(tree.angular_momentum(i));
        }
    }

    /// Adds the work of the pseudo-velocities, before they move the position over h s.
    pub(super) fn book_correction(&mut self, h: f64) {
        self.motion.equations.place(&self.position, &self.correction);
        let (tree, mut work) = (&self.motion.equations.tree, 0.0);
        for i in usize::from(tree.has_fixed_base)..tree.bodies.len() {
            work -= self.gravity[i].dot(tree.linear[i]) * tree.bodies[i].mass * h;
        }
        for spring in &*self.motion.equations.springs {
            let k = spring.coordinate();
            let q = self.position.q[k];
            let change = elastic(spring, q + self.correction.q[k] * h) - elastic(spring, q);
            work += change;
            if spring.is_stiff {
                self.account.corrected += change;
            }
        }
        self.account.sums.corrections += work;
    }

    /// Adds the work in a sub-step of h s except that of rows. `is_straight`: the positions moved by the new rates (semi-implicit Euler).
    pub(super) fn end_account(&mut self, h: f64, is_straight: bool) {
        let (tree, account) = (&self.motion.equations.tree, &mut self.account);
        let (next, lead) = (if is_straight { h / 2.0 } else { 0.0 }, account.pose_lead);
        let (mut changed, mut wrenches, mut damping) = (0.0, 0.0, -account.drag * h / 2.0 - account.corrected);
        for i in usize::from(tree.has_fixed_base)..tree.bodies.len() {
            let body = &tree.bodies[i];
            let (weight, before, after) = (self.gravity[i] * body.mass, account.linear[i], tree.linear[i]);
            let mean_way = (before + after) * (h / 2.0);
            let way = if is_straight { mean_way } else { tree.origins[i] - account.origins[i] };
            changed += weight.dot(before) * (next - lead);
            wrenches +=
                (body.force - weight).dot(way) + body.torque.dot(account.angular[i] + tree.angular[i]) * (h / 2.0);
            let middle = middle_of(way, before, after, h);
            damping -= body.mass * body.linear_drag * h / 6.0
                * (before.square() + 4.0 * middle.square() + after.square())
                + body.angular_drag * tree.angular[i].dot(tree.angular_momentum(i)) * h / 2.0;
        }
        for spring in &*self.motion.equations.springs {
            let k = spring.coordinate();
            let (q, before, after) = (account.position.q[k], account.rate.q[k], self.rate.q[k]);
            changed += elastic(spring, q - before * next) - elastic(spring, q - before * lead);
            if spring.is_stiff {
                // The work of its row is the change of elastic energy plus the damping work.
                damping += elastic(spring, self.position.q[k] - after * next) - elastic(spring, q - before * next);
            } else {
                let mean_way = (before + after) * (h / 2.0);
                let way = if is_straight { mean_way } else { self.position.q[k] - q };
                let middle = 1.5 * way / h - (before + after) / 4.0;
                damping -= spring.damping * h / 6.0 * (before * before + 4.0 * middle * middle + after * after);
            }
        }
        let from = At { position: &account.position, rate: &account.rate };
        let to = At { position: &self.position, rate: &self.rate };
        let works = self.rows.works(&self.motion.equations.worlds[0].drives, from, to, next);
        let sums = &mut account.sums;
        sums.contacts += changed;
        sums.wrenches += wrenches;
        sums.damping += damping + works.damping;
        sums.motors += works.motors;
        sums.limits += works.limits;
        account.pose_lead = next;
        self.note_energy();
    }
}
