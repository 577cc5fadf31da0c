//! Articulations in a sub-step, with rows whose impulses the tests choose or solve for.

use super::super::articulation::Circumstances;
use super::super::rows::Joint;
use super::*;

const UNBOUNDED: Joint = Joint {
    target: 0.0,
    softness: 0.0,
    impulse: 0.0,
    armature: 0.0,
    friction: 0.0,
    max_rate: INFINITE,
    low: 1.0,
    high: -1.0,
    is_hinge: true,
};

impl World {
    /// With gravity, and nothing that drives or limits the joints.
    fn in_a_scene(mut self) -> Self {
        let mut acceleration = vector(&GRAVITY);
        for i in 0..self.bodies.len() {
            if i == 0 && self.has_fixed_base {
                acceleration = Vector::zero();
            }
            self.of.gravity[i] = acceleration;
            acceleration = vector(&GRAVITY);
        }
        self.of.joints.fill(UNBOUNDED);
        self.of.motion.equations.forces.fill(0.0);
        (self.of.base.rotation, self.of.base.origin) = (self.of.position.rotation, self.of.position.origin);
        self.of.place();
        self
    }

    /// A sub-step, in which the rows of the joints have what impulses they need, and a row on a body a given one.
    fn sub_step(&mut self, push: Option<(usize, [Vector<f64>; 2])>) {
        self.of.circumstances.has_contact = push.is_some();
        self.of.begin_free_motion(H);
        self.of.step_freely(H);
        self.of.end_free_motion(H);
        let size = self.driven.len() + 6;
        let mut z = vec![0.0; size];
        if self.of.has_rows {
            self.of.prepare_rows(H);
            if let Some((body, [force, torque])) = push {
                let equations = &self.of.motion.equations;
                equations.tree.add_jacobian(body, force, torque, false, &mut z);
                equations.coupled.normalise(&mut z);
            }
            self.solve_rows(&mut z);
        }
        self.of.finish(H, &z);
    }

    /// Finds the impulses of the rows of the joints by sequential impulses; `z` has those of others.
    fn solve_rows(&mut self, z: &mut [f64]) {
        let mut jacobians = vec![0.0; self.of.rows.planned.len() * z.len()];
        self.of.rows.write(&self.of.motion, &self.of.row_rate, &mut jacobians);
        for _ in 0..2000 {
            for (row, jacobian) in self.of.rows.planned.iter_mut().zip(jacobians.chunks_exact(z.len())) {
                let speed = row.velocity + jacobian.iter().zip(&*z).fold(0.0, |sum, (j, z)| sum + j * z);
                let total = row.feedforward + row.impulse;
                let wanted = total + (row.target - speed - row.softness * total) / (row.response + row.softness);
                let change = wanted.clamp(row.low, row.high) - total;
                row.impulse += change;
                z.iter_mut().zip(jacobian).for_each(|(z, j)| *z += j * change);
            }
        }
    }

    fn energy(&mut self) -> f64 {
        self.of.note_energy();
        let energy = self.of.account.energy;
        energy.kinetic + energy.potential + energy.elastic
    }
}

fn numbers_of(v: Vector<f64>) -> [f64; 3] {
    [v.x, v.y, v.z]
}

/// An impulse on a body changes the momentum of a free tree by itself, and nothing else does but gravity.
#[test]
fn impulses_change_the_momentum_by_themselves() {
    let kinds = [REVOLUTE, SPHERICAL, PRISMATIC, REVOLUTE];
    for seed in 0..5 {
        let mut world = World::new(&kinds, false, seed, seed + 7).in_a_scene();
        let tree = &world.of.motion.equations.tree;
        let (mass, centre, origin) = (tree.mass(), tree.mass_centre(), tree.origins[3]);
        let before = tree.momentum(centre);
        let (impulse, twist) = (Vector::new(0.3, -0.2, 0.5), Vector::new(0.02, 0.01, -0.03));
        world.sub_step(Some((3, [impulse, twist])));
        let tree = &world.of.motion.equations.tree;
        let after = tree.momentum(tree.mass_centre());
        let wanted = before.linear + vector(&(GRAVITY * mass * H)) + impulse;
        let turned = before.angular + twist + (origin - centre).cross(impulse);
        for (found, wanted) in numbers_of(after.linear).into_iter().zip(numbers_of(wanted)) {
            assert!((found - wanted).abs() < 1e-8, "seed {seed}: {found} N·s, not {wanted}");
        }
        // Where the same momentum has more energy at the new position, the excess is taken from the motion about the mass centre.
        for (found, wanted) in numbers_of(after.angular).into_iter().zip(numbers_of(turned)) {
            assert!((found - wanted).abs() < 1e-4, "seed {seed}: {found} N·m·s, not {wanted}");
        }
    }
}

/// What hangs still pulls at its joints with its weight, whether motors hold it as drives or as rows.
#[test]
fn joints_carry_the_weight_of_what_motors_hold() {
    for by_rows in [false, true] {
        let mut world = World::new(&[REVOLUTE, REVOLUTE, REVOLUTE], true, 2, 3).in_a_scene();
        world.rates().fill(0.0);
        world.of.place();
        world.of.joints.iter_mut().for_each(|joint| (joint.impulse, joint.softness) = (10.0, 1e-9));
        let still = Vector::zero();
        for _ in 0..200 {
            world.of.circumstances = Circumstances { has_reactions: true, ..Circumstances::default() };
            world.sub_step(by_rows.then_some((1, [still, still])));
        }
        let weight: f64 = world.bodies[1..].iter().map(|body| body.mass).sum();
        let roots = world.links.iter().zip(&world.of.reactions[1..]).filter(|(link, _)| link.parent == 0);
        let force = roots.fold(still, |sum, (_, reaction)| sum + reaction.force);
        assert!((three(&force) + GRAVITY * weight).norm() < 1e-5, "{force:?} N, rows: {by_rows}");
        // The forces of motors are fed forward: rows have next to nothing left to do.
        for row in world.of.rows.planned.iter().filter(|_| by_rows) {
            assert!(row.feedforward != 0.0 && row.impulse.abs() < 1e-7, "{row:?}");
        }
    }
}

/// The works in a sub-step explain the change of the energy, with springs, damping, motors and limits, as drives and as rows. Those of
/// rows are the solver's to find.
#[test]
fn works_explain_the_energy() {
    let mut world = World::new(&[REVOLUTE, REVOLUTE, PRISMATIC], true, 4, 5).in_a_scene();
    let spring = Spring { is_angle: true, stiffness: 3.0, damping: 0.05, rest: 0.2, ..Spring::none() };
    world.of.add_spring(spring, 1, false, [1.0, -1.0]);
    (world.of.joints[1].target, world.of.joints[1].softness, world.of.joints[1].impulse) = (0.5, 0.1, 0.01);
    (world.of.joints[2].low, world.of.joints[2].high) = (world.of.position.q[2] - 0.02, world.of.position.q[2] + 0.02);
    let before = world.energy();
    for _ in 0..300 {
        world.of.circumstances = Circumstances { is_accounted: true, ..Circumstances::default() };
        world.sub_step(None);
    }
    let (after, sums) = (world.energy(), world.of.account.sums);
    let works =
        sums.set_states + sums.corrections + sums.contacts + sums.wrenches + sums.damping + sums.motors + sums.limits;
    assert!((after - before - works).abs() < 1e-4, "{} J, explained {works} J: {sums:?}", after - before);
    assert!(sums.damping < -1e-4 && sums.motors.abs() > 1e-4 && sums.limits.abs() > 1e-4, "{sums:?}");
}

/// A limit that is pressed against holds as a row, too, and the energy does not grow when it stops a joint.
#[test]
fn rows_of_limits_hold() {
    let mut world = World::new(&[REVOLUTE, REVOLUTE], true, 6, 7).in_a_scene();
    let (low, high) = (world.of.position.q[0] - 0.05, world.of.position.q[0] + 0.05);
    (world.of.joints[0].low, world.of.joints[0].high) = (low, high);
    let (still, mut reached) = (Vector::zero(), false);
    let mut before = world.energy();
    for _ in 0..1500 {
        world.sub_step(Some((1, [still, still])));
        let (q, after) = (world.of.position.q[0], world.energy());
        assert!(q > low - 1e-4 && q < high + 1e-4, "{q} rad");
        assert!(after < before + 1e-5, "{after} J after {before} J");
        reached = reached || world.of.rows.hit_limit();
        before = after;
    }
    assert!(reached);
}
