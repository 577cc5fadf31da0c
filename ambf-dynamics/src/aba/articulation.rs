//! An articulation in a sub-step: a tree, what drives and limits its joints, and what rows of a solver do to it.
//!
//! The [free motion](Articulation::begin_free_motion) has no contacts and no constraints to other bodies. Where nothing else acts on the
//! joints that is all: motors, springs and limits are part of the equations of motion. Else the rows of the joints follow from it,
//! [`prepare_rows`](Articulation::prepare_rows) makes what rows act on, and the solver finds impulses.
//! [`finish`](Articulation::finish) moves the articulation.

use std::f64::consts::FRAC_PI_2;

use crate::island::{MAX_CORRECTION_SPEED, SOFT_SPRING};

use super::account::Account;
use super::algebra::{Matrix, Quaternion, Vector};
use super::coupling::{Coupled, CoupledCoordinate};
use super::drives::{DistantLimits, Drive, World, INFINITE};
use super::energy::{is_zero, Momentum};
use super::list::List;
use super::motion::{advance_position, Memory, Motion, Spring, NUMBERS, QUATERNIONS, VECTORS};
use super::rows::{At, Joint, Rows};
use super::scalar::Scalar;
use super::{Body, Driven, Link, Position, Rate, Tree, Work};

/// Largest turn in a sub-step up to which the kinetic energy may grow at the new position, rad: slow motion exchanges energy between
/// sub-steps by truncation errors of either sign, in proportion to the third power of the turn.
const FAST_TURN: f64 = 0.05;
/// Rows are solved with the rates after the free motion and the inertia before it. Largest ratio of the energy of both together to the
/// energy before and after the motion; beyond it rows act on a motion along the tangent instead.
const MAX_CONTRAST: f64 = 2.0;
/// Stiffness times response times h², and damping times response times h, above which a spring is too stiff to be integrated with the
/// motion.
const STIFF: f64 = 0.04;
const STIFFLY_DAMPED: f64 = 0.1;

/// Bounds of the return to limits, see `cpp/position_error.h`.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Bounds {
    /// Largest speed of the return to a limit, m/s, and rate, rad/s.
    pub return_speed: f64,
    /// See [`return_speed`](Self::return_speed).
    pub return_rate: f64,
    /// Share of the violation of a limit that is corrected in a sub-step.
    pub limit_erp: f64,
}

/// What an articulation is made of.
#[derive(Debug)]
pub struct Plan<'a> {
    /// No force moves the base.
    pub has_fixed_base: bool,
    /// Links and their joints.
    pub links: &'a [Link],
    /// Bodies, the base first.
    pub bodies: &'a [Body<f64>],
    /// Places for springs.
    pub springs: usize,
    /// Terms of all couplings, the end of each, and the offsets, rad or m: the sum of factors times coordinates is the offset.
    pub terms: &'a [CoupledCoordinate],
    /// See [`terms`](Self::terms).
    pub ends: &'a [i32],
    /// See [`terms`](Self::terms).
    pub offsets: &'a [f64],
    /// Of corrections.
    pub bounds: Bounds,
}

impl Plan<'_> {
    fn coordinates(&self) -> usize {
        self.links.iter().map(Link::freedoms).sum()
    }

    fn balls(&self) -> usize {
        self.links.iter().filter(|link| link.ball >= 0).count()
    }

    /// For each component of the velocity, the one before it on the path to the base; -1: none.
    fn write_parents(&self, parents: &mut [i32]) {
        for (k, parent) in parents.iter_mut().enumerate() {
            *parent = k as i32 - 1;
        }
        for link in self.links.iter().filter(|link| link.coordinate >= 0) {
            let mut parent = link.parent();
            while parent > 0 && self.links[parent - 1].coordinate < 0 {
                parent = self.links[parent - 1].parent();
            }
            parents[6 + link.coordinate()] = match parent {
                0 if self.has_fixed_base => -1,
                0 => 5,
                _ => (5 + self.links[parent - 1].coordinate() + self.links[parent - 1].freedoms()) as i32,
            };
        }
    }
}

/// Where the memory of an articulation comes from.
pub trait Store<'a> {
    /// New elements.
    fn take<T: 'a>(&mut self, count: usize, make: impl Fn() -> T) -> &'a mut [T];
}

/// A force and a torque, N and N·m, or impulses of them.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Wrench {
    /// At the centre of mass.
    pub force: Vector<f64>,
    /// About it.
    pub torque: Vector<f64>,
}

impl Wrench {
    fn zero() -> Self {
        Self { force: Vector::zero(), torque: Vector::zero() }
    }
}

/// Pose and velocity of a fixed base.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Base {
    /// Orientation.
    pub rotation: Quaternion<f64>,
    /// Centre of mass, m.
    pub origin: Vector<f64>,
    /// m/s.
    pub linear: Vector<f64>,
    /// rad/s.
    pub angular: Vector<f64>,
}

/// What acts in a sub-step, and what is asked for.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct Circumstances {
    /// Steps are semi-implicit Euler steps.
    pub by_euler: bool,
    /// A link touches something.
    pub has_contact: bool,
    /// Constraints to bodies that are no links of it.
    pub is_connected: bool,
    /// Bodies are driven.
    pub is_driven: bool,
    /// A joint has limits of more than one coordinate.
    pub has_wide_limits: bool,
    /// The reactions of joints are to be found.
    pub has_reactions: bool,
    /// The energy is accounted for.
    pub is_accounted: bool,
    /// A fixed base was moved since the last sub-step.
    pub is_moved: bool,
}

/// An articulation: all that is kept of it from sub-step to sub-step.
pub struct Articulation<'a> {
    pub(super) motion: Motion<'a, 'a, f64>,
    /// Motion subspaces and velocity products are those of the poses and velocities: they are not after a step beside other trees.
    pub(super) has_subspaces: bool,
    pub(super) position: Position<'a, f64>,
    pub(super) rate: Rate<'a, f64>,
    /// State at the end of the sub-step without constraint rows.
    pub(super) free_position: Position<'a, f64>,
    pub(super) free_rate: Rate<'a, f64>,
    /// What acts on each body in this sub-step without gravity, N and N·m, and the acceleration by gravity, m/s².
    pub wrenches: &'a mut [Wrench],
    /// See [`wrenches`](Self::wrenches).
    pub gravity: &'a mut [Vector<f64>],
    /// What acts on the joint of each link.
    pub joints: &'a mut [Joint],
    /// Impulses of rows on each body in this sub-step, over its length, N and N·m.
    pub applied: &'a mut [Wrench],
    /// Of this sub-step.
    pub circumstances: Circumstances,
    /// Of this sub-step.
    pub base: Base,
    /// Rows of its joints.
    pub rows: Rows<'a>,
    /// Of the energy.
    pub account: Account<'a>,
    /// Reactions of the joints on the links, and those of springs beside joints, which are no part of these.
    pub reactions: &'a mut [Wrench],
    /// See [`reactions`](Self::reactions).
    pub spring_reactions: &'a mut [Wrench],
    /// The index of the body on whose joint each spring acts; 0: the spring is the joint.
    spring_members: &'a mut [usize],
    offsets: &'a mut [f64],
    /// There are rows in this sub-step.
    pub has_rows: bool,
    /// Kinetic energy of the motion without rows, J, and its internal energy at the end and, with the same rates, at the beginning of the
    /// sub-step.
    pub free_energy: f64,
    free_internal_energy: f64,
    unsolved_energy: f64,
    /// Rates with which rows act: those of the free motion, where the velocity of a free base is such that the linear momentum is that
    /// after the free motion, without what the fed-forward impulses of limits changed, `fed`.
    pub(super) row_rate: Rate<'a, f64>,
    /// That velocity, m/s.
    row_velocity: Vector<f64>,
    fed: Rate<'a, f64>,
    is_fed: bool,
    /// The free motion of this sub-step is along the tangent.
    is_tangential: bool,
    /// Pseudo-velocity of the position correction: moves the articulation in this sub-step and does not change its rates.
    pub(super) correction: Rate<'a, f64>,
    is_corrected: bool,
    /// Change of the rates by the constraint impulses of this sub-step.
    change: Rate<'a, f64>,
    mean_rate: Rate<'a, f64>,
    mean_velocity: &'a mut [f64],
    changed_velocity: &'a mut [f64],
    /// Momenta and velocities of the bodies at the beginning of the sub-step.
    momenta: &'a mut [Wrench],
    velocities: [&'a mut [Vector<f64>]; 2],
}

/// What a sub-step with rows leaves to be restored at the new position.
struct RowMotion {
    /// That of a free base about the mass centre.
    momentum: Momentum<f64>,
    /// Largest internal energy, J.
    energy_limit: f64,
    /// Impulses act from the beginning of the sub-step.
    is_straight: bool,
}

impl<'a> Articulation<'a> {
    /// At rest at the origin, with all coordinates 0.
    pub fn new(store: &mut impl Store<'a>, plan: &Plan<'_>) -> Self {
        let (n, balls, bodies, springs) = (plan.coordinates(), plan.balls(), plan.bodies.len(), plan.springs);
        let (size, most) = (n + 6, Rows::most(n, springs));
        let links = store.take(plan.links.len(), || plan.links[0]);
        links.copy_from_slice(plan.links);
        let own_bodies = store.take(bodies, || plan.bodies[0]);
        own_bodies.copy_from_slice(plan.bodies);
        let matrix = Matrix([Vector::zero(); 3]);
        let tree = Tree {
            has_fixed_base: plan.has_fixed_base,
            splits_damping: false,
            links,
            bodies: own_bodies,
            rotations: store.take(bodies, || matrix),
            origins: store.take(bodies, Vector::zero),
            linear: store.take(bodies, Vector::zero),
            angular: store.take(bodies, Vector::zero),
            arms: store.take(bodies, Vector::zero),
            axes: store.take(bodies, Vector::zero),
            work: store.take(bodies, Work::zero),
        };
        let memory = Memory {
            numbers: store.take(NUMBERS * n, || 0.0),
            vectors: store.take(VECTORS * bodies, Vector::zero),
            quaternions: store.take(QUATERNIONS * balls, Quaternion::identity),
        };
        let (terms, ends) = (store.take(plan.terms.len(), || plan.terms[0]), store.take(plan.ends.len(), || 0));
        terms.copy_from_slice(plan.terms);
        ends.copy_from_slice(plan.ends);
        let parents = store.take(size, || -1);
        plan.write_parents(parents);
        let mut numbers = |count| store.take(count, || 0.0);
        let coupled = Coupled {
            has_fixed_base: plan.has_fixed_base,
            terms,
            ends,
            parents,
            factor: numbers(size * size),
            inverse_diagonal: numbers(size),
            rows: numbers(plan.ends.len() * size),
            row_count: 0,
            velocity: numbers(size),
            impulse: numbers(size),
        };
        let (forces, rest, offsets) = (numbers(n), numbers(n), numbers(plan.offsets.len()));
        offsets.copy_from_slice(plan.offsets);
        let nothing = || Driven { inertia: 0.0, pull: 0.0, is_given: 0.0, given: 0.0, force: 0.0 };
        let distant = DistantLimits::none(0, false);
        let world = World {
            drives: List::new(store.take(most, || Drive::lock(&distant, 0.0))),
            distant: List::new(store.take(n + springs, || distant)),
            driven: store.take(n, nothing),
            given_by: store.take(n, || -1),
            rest,
            steps_until_probe: 0,
            has_mode: false,
        };
        let worlds = store.take(1, World::default);
        worlds[0] = world;
        let driven = store.take(n, nothing);
        let of_springs = List::new(store.take(springs, Spring::none));
        let motion = Motion::new(tree, [n, balls], memory, forces, driven, of_springs, coupled, worlds);
        let mut position = || Position {
            q: store.take(n, || 0.0),
            balls: store.take(balls, Quaternion::identity),
            ..Position::default()
        };
        let (present, free_position, start_position) = (position(), position(), position());
        let mut rate = || Rate { q: store.take(n, || 0.0), ..Rate::default() };
        let (present_rate, free_rate, start_rate) = (rate(), rate(), rate());
        let (row_rate, fed, correction, change, mean_rate) = (rate(), rate(), rate(), rate(), rate());
        let mut wrenches = |count| store.take(count, Wrench::zero);
        let zero = Vector::zero();
        Self {
            has_subspaces: false,
            wrenches: wrenches(bodies),
            applied: wrenches(bodies),
            reactions: wrenches(bodies),
            spring_reactions: wrenches(springs),
            momenta: wrenches(bodies),
            gravity: store.take(bodies, Vector::zero),
            velocities: [store.take(bodies, Vector::zero), store.take(bodies, Vector::zero)],
            mean_velocity: store.take(size, || 0.0),
            changed_velocity: store.take(size, || 0.0),
            joints: store.take(plan.links.len(), Joint::default),
            rows: Rows::new(store, plan.links.len(), [n, springs], plan.bounds),
            account: Account::new(store, bodies, start_position, start_rate),
            spring_members: store.take(springs, || 0),
            circumstances: Circumstances::default(),
            base: Base { rotation: Quaternion::identity(), origin: zero, linear: zero, angular: zero },
            position: present,
            rate: present_rate,
            free_position,
            free_rate,
            row_rate,
            fed,
            correction,
            change,
            mean_rate,
            motion,
            offsets,
            has_rows: false,
            free_energy: 0.0,
            free_internal_energy: 0.0,
            unsolved_energy: 0.0,
            row_velocity: Vector::zero(),
            is_fed: false,
            is_tangential: false,
            is_corrected: false,
        }
    }

    /// Adds a spring that acts on the joint of a body, rad or m: beside it, with limits of its own, or the joint itself or its damping. The
    /// plan has a place for it.
    pub fn add_spring(&mut self, spring: Spring<f64>, member: usize, is_beside: bool, limits: [f64; 2]) {
        let index = self.motion.equations.springs.len();
        self.motion.equations.springs.push(spring);
        self.spring_members[index] = if is_beside { member } else { 0 };
        self.rows.spring_limits[index] = limits;
    }

    /// Forgets what was estimated and what forces there were, after the position was set.
    pub fn forget(&mut self) {
        let world = &mut self.motion.equations.worlds[0];
        (world.has_mode, world.steps_until_probe) = (false, 0);
        self.rows.reset();
    }

    /// Takes over a position that was set, and velocities of all bodies, if they were: finds the rates with the least kinetic energy of the
    /// difference. The velocity of a fixed base is set already.
    pub fn settle(&mut self, velocities: Option<[&[Vector<f64>]; 2]>) {
        self.motion.equations.tree.update_poses(&self.position);
        if let Some([linear, angular]) = velocities {
            self.motion.project(linear, angular, &mut self.rate);
        }
        self.update_velocities();
    }

    /// Brings poses and velocities of the bodies up to date.
    pub fn place(&mut self) {
        self.motion.equations.tree.update_poses(&self.position);
        self.update_velocities();
    }

    fn update_velocities(&mut self) {
        self.has_subspaces = true;
        self.motion.equations.tree.update_velocities(&self.rate);
    }

    /// Brings motion subspaces and velocity products up to date, where they are not.
    fn find_subspaces(&mut self) {
        if !self.has_subspaces {
            self.update_velocities();
        }
    }

    /// Takes over the velocity of a fixed base that is moved. It changes from one sub-step to the next by an impulse, which the joints pass
    /// on.
    fn take_base_velocity(&mut self) {
        let Base { linear, angular, .. } = self.base;
        let numbers = |v: Vector<f64>| [v.x, v.y, v.z];
        let rates = [self.rate.linear, self.rate.angular].map(numbers);
        if rates == [linear, angular].map(numbers) {
            return;
        }
        (self.rate.linear, self.rate.angular) = (linear, angular);
        let tree = &self.motion.equations.tree;
        self.velocities[0].copy_from_slice(tree.linear);
        self.velocities[1].copy_from_slice(tree.angular);
        let [linear, angular] = &self.velocities;
        self.motion.project(linear, angular, &mut self.rate);
        self.update_velocities();
    }

    /// Classifies springs for a sub-step of h s, from the poses at its beginning: soft ones are integrated with the motion, stiff ones become
    /// implicit rows, which cannot overshoot. Those in between are rows of the position problem, too.
    fn choose_springs(&mut self, h: f64) {
        if self.motion.equations.springs.is_empty() {
            return;
        }
        self.find_subspaces();
        let equations = &mut self.motion.equations;
        equations.factor_inertia();
        for spring in &mut *equations.springs {
            let response = equations.coupled.response(spring.coordinate()) * h;
            spring.is_stiff = spring.stiffness * h * response > STIFF || spring.damping * response > STIFFLY_DAMPED;
            spring.settles_in_a_step = spring.is_stiff && spring.stiffness * h * response > 1.0;
            spring.resists_corrections = spring.stiffness * h * response * SOFT_SPRING > 1.0;
        }
    }

    /// Whether nothing acts on it but motors, springs and limits of its joints. Motors and limits of coupled joints may contradict each
    /// other, which rows resolve.
    fn is_alone(&self) -> bool {
        let at = &self.circumstances;
        let has_others = at.has_contact || at.is_connected || at.has_wide_limits || at.is_driven;
        !has_others && self.motion.equations.coupled.is_empty()
    }

    /// Plans the motion over the next sub-step of h s without constraint rows: [`step_freely`](Self::step_freely) makes it, and
    /// [`end_free_motion`](Self::end_free_motion) finds what it leaves to rows.
    pub fn begin_free_motion(&mut self, h: f64) {
        self.motion.by_euler = self.circumstances.by_euler;
        if self.circumstances.is_accounted {
            self.begin_account();
        }
        let tree = &mut self.motion.equations.tree;
        for i in usize::from(tree.has_fixed_base)..tree.bodies.len() {
            let body = &mut tree.bodies[i];
            body.force = self.wrenches[i].force + self.gravity[i] * body.mass;
            body.torque = self.wrenches[i].torque;
        }
        if self.circumstances.has_reactions {
            self.remember_momenta();
        }
        if self.motion.equations.tree.has_fixed_base {
            self.take_base_velocity();
        }
        self.choose_springs(h);
        let at = At { position: &self.position, rate: &self.rate };
        if self.is_alone() {
            self.rows.plan_drives(at, &mut self.motion.equations, self.joints, h);
        } else {
            // Positions are corrected by contacts and external constraints; limits of other coordinates do so in rare cases.
            let is_corrected = self.circumstances.has_contact || self.circumstances.is_connected;
            self.rows.plan_motors(at, &mut self.motion, self.joints, h, is_corrected);
        }
    }

    /// Moves freely over h s.
    pub fn step_freely(&mut self, h: f64) {
        self.find_subspaces();
        self.motion.step(h, &self.position, &self.rate, &mut self.free_position, &mut self.free_rate);
    }

    /// Finds the rows of the joints, and what limits leave to corrections.
    pub fn end_free_motion(&mut self, h: f64) {
        let at = At { position: &self.position, rate: &self.rate };
        let equations = &self.motion.equations;
        if self.rows.are_drives {
            self.rows.take_drives(&equations.worlds[0].drives);
            self.has_rows = false;
            return self.return_to_limits(h);
        }
        self.free_energy = equations.tree.kinetic_energy();
        self.free_internal_energy = equations.tree.internal_energy();
        self.rows.plan_limits(at, equations.tree.links, &equations.springs, self.joints, &self.free_rate, h);
        let with = &self.circumstances;
        self.has_rows = self.rows.any() || with.has_contact || with.is_connected || with.is_driven;
    }

    /// Plans the return of coordinates to limits that the free motion passes as a correction of positions, which does not move the mass
    /// centre of a free base.
    fn return_to_limits(&mut self, h: f64) {
        let drives = &self.motion.equations.worlds[0].drives;
        let ways = [&self.position, &self.free_position];
        if !self.rows.way_to_limits(h, drives, ways, self.correction.q) {
            return;
        }
        self.is_corrected = true;
        self.correction.q.iter_mut().for_each(|q| *q /= h);
        (self.correction.angular, self.correction.linear) = (Vector::zero(), Vector::zero());
        let tree = &mut self.motion.equations.tree;
        if !tree.has_fixed_base {
            tree.update_poses(&self.free_position);
            tree.update_velocities(&self.correction);
            tree.set_momentum(&Momentum::zero(), tree.mass_centre(), &mut self.correction);
        }
    }

    /// Prepares rows: poses are those at the beginning of the sub-step, velocities those of the free motion.
    pub fn prepare_rows(&mut self, h: f64) {
        let momentum = self.motion.equations.tree.linear_momentum();
        self.motion.equations.place(&self.position, &self.free_rate);
        let tree = &mut self.motion.equations.tree;
        self.row_rate.copy(&self.free_rate);
        if !tree.has_fixed_base {
            // The same rates give the mass centre another velocity where a light base turns fast relative to heavy links.
            self.row_rate.linear += (momentum - tree.linear_momentum()) * (1.0 / tree.mass());
            tree.update_velocities(&self.row_rate);
        }
        self.row_velocity = self.row_rate.linear;
        self.unsolved_energy = tree.internal_energy();
        let before_and_after = self.motion.start.energy.or_larger(self.free_internal_energy);
        self.is_tangential = self.unsolved_energy > MAX_CONTRAST * before_and_after;
        if self.is_tangential {
            let (free_position, free_rate) = (&mut self.free_position, &mut self.free_rate);
            self.free_internal_energy =
                self.motion.tangential_step(h, &self.position, &self.rate, free_position, free_rate);
            self.motion.equations.place(&self.position, &self.free_rate);
            let tree = &self.motion.equations.tree;
            self.unsolved_energy = tree.internal_energy();
            self.row_velocity = self.free_rate.linear;
            self.free_energy = tree.kinetic_energy();
            self.row_rate.copy(&self.free_rate);
        }
        self.motion.equations.factor_inertia();
        self.is_fed = self.rows.rates_by_limits(&self.motion.equations.coupled, &mut self.fed);
        if self.is_fed {
            subtract(&mut self.row_rate, &self.fed);
            self.motion.equations.tree.update_velocities(&self.row_rate);
        }
    }

    /// Takes the pseudo-velocities z of the position correction. Returns the largest multiple of the largest correction speed or, of what
    /// turns, of `most_turned` rad/s in the coordinates.
    pub fn set_correction(&mut self, velocities: &[f64], most_turned: f64) -> f64 {
        let (equations, correction) = (&self.motion.equations, &mut self.correction);
        equations.coupled.rates_of(velocities, correction);
        self.is_corrected = true;
        let most_moved = MAX_CORRECTION_SPEED;
        let mut fastest = correction.angular.length() / most_turned;
        fastest = fastest.or_larger(correction.linear.length() / most_moved);
        for link in equations.tree.links {
            for k in 0..link.freedoms() {
                let most = if k < link.sliding as usize { most_moved } else { most_turned };
                fastest = fastest.or_larger(correction.q[link.coordinate() + k].abs() / most);
            }
        }
        fastest
    }

    /// Scales the pseudo-velocities of the position correction.
    pub fn scale_correction(&mut self, factor: f64) {
        let correction = &mut self.correction;
        correction.angular = correction.angular * factor;
        correction.linear = correction.linear * factor;
        correction.q.iter_mut().for_each(|q| *q *= factor);
    }

    /// Moves it over the sub-step of h s. `velocities`: change of z by the impulses of rows, which the rows have.
    pub fn finish(&mut self, h: f64, velocities: &[f64]) {
        // The change of the rates by rows was solved at the old position; at the new position the same rates have another momentum. The
        // momentum of an articulation with a free base changes by forces and impulses only: it is computed at the old position and
        // restored at the new one.
        let fixed_base = self.motion.equations.tree.has_fixed_base;
        let mut motion = RowMotion { momentum: Momentum::zero(), energy_limit: INFINITE, is_straight: false };
        if self.has_rows {
            motion = self.move_by_rows(h, velocities);
        } else {
            self.position.copy(&self.free_position);
            self.rate.copy(&self.free_rate);
        }
        if self.is_corrected {
            if self.circumstances.is_accounted {
                self.book_correction(h);
            }
            advance_position(&self.motion.equations.tree, &mut self.position, h, &self.correction);
        }
        // The free motion ends with the poses and velocities of its bodies.
        let coupled = &self.motion.equations.coupled;
        let mut is_elsewhere = self.has_rows || self.is_corrected || !coupled.is_empty();
        self.is_corrected = false;
        coupled.close(self.offsets, self.position.q);
        if fixed_base {
            let carried = self.motion.equations.tree.is_carried();
            is_elsewhere = is_elsewhere || carried || self.circumstances.is_moved;
            (self.position.rotation, self.position.origin) = (self.base.rotation, self.base.origin);
            (self.rate.linear, self.rate.angular) = (self.base.linear, self.base.angular);
        }
        if is_elsewhere {
            self.place();
        }
        if self.has_rows && !fixed_base {
            self.set_momentum(&motion.momentum);
        }
        self.limit_energy(motion.energy_limit, &motion.momentum);
        // Rows are linear in the motion, and turns of radians in a sub-step are not. Without rows the equations of motion resolve them by
        // parts of the sub-step, and only what no torque causes is too fast.
        let quarter = FRAC_PI_2 / h;
        self.bound_rotation(if self.has_rows { quarter } else { self.motion.start.rotation + quarter });
        if self.circumstances.is_accounted {
            self.end_account(h, motion.is_straight);
        }
        if self.circumstances.has_reactions {
            self.find_reactions(h);
        }
    }

    fn set_momentum(&mut self, momentum: &Momentum<f64>) {
        self.has_subspaces = true;
        let tree = &mut self.motion.equations.tree;
        tree.set_momentum(momentum, tree.mass_centre(), &mut self.rate);
    }

    fn bound_rotation(&mut self, most: f64) {
        let is_fast = self.motion.equations.tree.fastest_coordinate(&self.rate) > most;
        if is_fast || self.rate.angular.length() > most {
            self.find_subspaces();
            self.motion.bound_rotation(&mut self.rate, most);
        }
    }

    /// Whether rows acted on it.
    fn had_impulses(&self) -> bool {
        let any = |wrench: &Wrench| !(is_zero(wrench.force, 0) && is_zero(wrench.torque, 0));
        self.applied[1..].iter().any(any) || self.rows.hit_limit()
    }

    /// Adds the impulses of the rows to the rates, and moves the position by them.
    fn move_by_rows(&mut self, h: f64, velocities: &[f64]) -> RowMotion {
        if self.is_tangential {
            self.mean_rate.copy(&self.rate);
        }
        self.motion.equations.coupled.rates_of(velocities, &mut self.change);
        if self.is_fed {
            subtract(&mut self.change, &self.fed);
        }
        self.rate.angular = self.free_rate.angular + self.change.angular;
        self.rate.linear = self.row_velocity + self.change.linear;
        for ((rate, free), change) in self.rate.q.iter_mut().zip(&*self.free_rate.q).zip(&*self.change.q) {
            *rate = free + change;
        }
        self.motion.equations.place(&self.position, &self.rate);
        let is_straight = self.circumstances.has_contact || self.circumstances.is_connected || self.had_impulses();
        let tree = &self.motion.equations.tree;
        let (turn, solved) = (tree.fastest_rotation(&self.rate) * h, tree.internal_energy());
        let mut energy_limit = self.energy_limit_of_rows(solved, turn, is_straight);
        if self.is_tangential {
            let explained = solved - self.unexplained_energy(h);
            energy_limit = energy_limit.or_smaller(explained.or_larger(0.0));
        }
        // Share of the sub-step for which the rows move the position.
        let followed = match is_straight {
            false => 0.5,
            true if turn > FRAC_PI_2 => FAST_TURN / turn,
            true => 1.0,
        };
        let mut motion = RowMotion { momentum: Momentum::zero(), energy_limit, is_straight };
        if self.motion.equations.tree.has_fixed_base {
            self.advance_by_rows(h, followed, is_straight);
            return motion;
        }
        // The momentum is taken about the mass centre, which is not at the same place in both positions.
        let tree = &mut self.motion.equations.tree;
        let (old_centre, mass) = (tree.mass_centre(), tree.mass());
        tree.update_velocities(&self.change);
        let by_rows = tree.momentum(old_centre);
        tree.update_poses(if self.is_tangential { &self.position } else { &self.free_position });
        tree.update_velocities(&self.free_rate);
        motion.momentum = tree.momentum(tree.mass_centre());
        motion.momentum.linear += by_rows.linear;
        motion.momentum.angular += by_rows.angular;
        // Mass centre at the new position, which momenta imply, too.
        let is_followed = followed == 1.0;
        let centre = if is_followed {
            old_centre + motion.momentum.linear * (h / mass)
        } else {
            tree.mass_centre() + by_rows.linear * (h * followed / mass)
        };
        self.advance_by_rows(h, followed, is_straight);
        if is_followed || !self.is_tangential {
            let tree = &mut self.motion.equations.tree;
            tree.update_poses(&self.position);
            self.position.origin += centre - tree.mass_centre();
        }
        motion
    }

    /// Kinetic energy, J, that the sub-step adds at the old position beyond that at its beginning and the work of forces and impulses, which
    /// is that at the mean of the velocities at its beginning, which `mean_rate` has before, and of the present ones. Forces that bound the
    /// accelerations of the free motion do no work here: where links turn by radians they would otherwise add energy.
    fn unexplained_energy(&mut self, h: f64) -> f64 {
        fn energy(tree: &Tree<'_, f64>) -> f64 {
            if tree.has_fixed_base {
                tree.internal_energy()
            } else {
                tree.kinetic_energy()
            }
        }
        let (equations, mean, rate) = (&mut self.motion.equations, &mut self.mean_rate, &self.rate);
        let present = energy(&equations.tree);
        equations.tree.update_velocities(mean);
        let before = energy(&equations.tree);
        mean.angular = (mean.angular + rate.angular) * (1.0 / 2.0);
        mean.linear = (mean.linear + rate.linear) * (1.0 / 2.0);
        mean.q.iter_mut().zip(&*rate.q).for_each(|(mean, rate)| *mean = (*mean + rate) / 2.0);
        equations.tree.update_velocities(mean);
        equations.coupled.coordinates_of(mean, self.mean_velocity);
        equations.coupled.coordinates_of(&self.change, self.changed_velocity);
        let mut work = equations.work_at_rate(h, &self.position, mean);
        for (mean, changed) in self.mean_velocity.iter().zip(&*self.changed_velocity) {
            work += mean * changed;
        }
        equations.tree.update_velocities(rate);
        // Coriolis forces exchange a part of the energy at the beginning with what the change of the position does.
        present - 2.0 * before - work
    }

    /// Largest internal energy at the new position, J. `solved`: with the rates that rows leave, at the old position, with whose inertia they
    /// were solved; there rows add no energy but the work of motors.
    fn energy_limit_of_rows(&self, solved: f64, turn: f64, is_straight: bool) -> f64 {
        let (unsolved, there) = (self.unsolved_energy, self.free_internal_energy);
        // If rows removed a share of the energy at the old position, the same share is removed at the new one, where inertias may be very
        // different; if they added energy, the same amount is added, or the same share if that is less.
        let is_share = solved < unsolved || unsolved > there;
        let mut limit = if is_share { there * (solved / unsolved) } else { there + (solved - unsolved) };
        // The comparison is false for NaN.
        let is_slow = turn <= FAST_TURN;
        if !is_slow {
            return limit;
        }
        limit *= 1.0 + turn * turn * turn;
        // The work of forces that are constant over the sub-step differs by its second order from that at the old position.
        if is_straight {
            limit
        } else {
            limit + (solved - unsolved).abs()
        }
    }

    /// Moves the position by the free motion and, for the share `followed` of the sub-step, by the change of the rates.
    fn advance_by_rows(&mut self, h: f64, followed: f64, is_straight: bool) {
        let equations = &self.motion.equations;
        // Impulses of contacts, limits and external constraints act from the beginning of the sub-step, so that no link penetrates further.
        if is_straight && followed == 1.0 {
            return advance_position(&equations.tree, &mut self.position, h, &self.rate);
        }
        let (free, position, rate, change) = (&mut self.free_position, &mut self.position, &self.rate, &self.change);
        let by_rate = |k: usize| position.q[k] + h * (rate.q[k] - change.q[k] * followed);
        // Rows that turn links of next to no inertia are not linear, and poses follow them as far as they are. The force of a stiff spring
        // is a row, without which the free motion strains it. Forces of motors are constant over the sub-step: their mean change of the
        // rates is half of `change`. The implicit force of a spring that is at rest at the end of the sub-step acts on the rate there.
        for spring in &*equations.springs {
            if if is_straight { spring.is_stiff } else { spring.settles_in_a_step } {
                free.q[spring.coordinate()] = by_rate(spring.coordinate());
            }
        }
        // Without the force of its limit a link slides out of what turns by radians, as far as it turns.
        for (i, link) in equations.tree.links.iter().enumerate() {
            if !is_straight || link.sliding == 0 || !self.rows.hit_sliding_limit(i + 1, link) {
                continue;
            }
            for k in link.coordinate()..link.coordinate() + link.sliding as usize {
                let way = free.q[k] + h * followed * change.q[k] - position.q[k];
                if way.abs() > (h * rate.q[k]).abs() {
                    free.q[k] = by_rate(k);
                }
            }
        }
        position.copy(free);
        advance_position(&equations.tree, position, h * followed, change);
    }

    /// Limits the internal energy at the new position by scaling the rates of the coordinates and, if restoring the momentum of a free base
    /// raises the energy again, all motion relative to the centre of mass.
    fn limit_energy(&mut self, most: f64, momentum: &Momentum<f64>) {
        if most >= INFINITE {
            return;
        }
        // The comparison is false for NaN.
        let energy = self.motion.equations.tree.internal_energy();
        let is_more = energy > most;
        if !is_more {
            return;
        }
        let share = (most / energy).sqrt();
        self.rate.q.iter_mut().for_each(|q| *q *= share);
        self.update_velocities();
        if self.motion.equations.tree.has_fixed_base {
            return;
        }
        self.set_momentum(momentum);
        let energy = self.motion.equations.tree.internal_energy();
        let is_more = energy > most;
        if !is_more {
            return;
        }
        let share = (most.or_larger(0.0) / energy).sqrt();
        self.motion.equations.tree.scale_internal_velocity(share, &mut self.rate);
        self.update_velocities();
    }

    fn remember_momenta(&mut self) {
        let tree = &self.motion.equations.tree;
        self.velocities[0].copy_from_slice(tree.linear);
        self.velocities[1].copy_from_slice(tree.angular);
        for (i, momentum) in self.momenta.iter_mut().enumerate() {
            *momentum = Wrench { force: tree.linear[i] * tree.bodies[i].mass, torque: tree.angular_momentum(i) };
        }
    }

    /// Finds the reactions of the joints over the sub-step: for each subtree, the change of momentum minus the impulses of all external
    /// forces, divided by h; summed from the leaves to the base.
    fn find_reactions(&mut self, h: f64) {
        let (equations, half, per_step) = (&self.motion.equations, 1.0 / 2.0, 1.0 / h);
        let tree = &equations.tree;
        self.reactions.fill(Wrench::zero());
        for i in (0..tree.bodies.len()).rev() {
            let (body, before) = (&tree.bodies[i], self.momenta[i]);
            let velocity = (self.velocities[0][i] + tree.linear[i]) * half;
            let momentum = (before.torque + tree.angular_momentum(i)) * half;
            let mut outside = body.force - velocity * (body.mass * body.linear_drag);
            let mut twist = body.torque - momentum * body.angular_drag;
            if self.has_rows && i > 0 {
                outside += self.applied[i].force;
                twist += self.applied[i].torque;
            }
            self.reactions[i].force += (tree.linear[i] * body.mass - before.force) * per_step - outside;
            self.reactions[i].torque += (tree.angular_momentum(i) - before.torque) * per_step - twist;
            if i == 0 {
                continue;
            }
            let (link, mut own) = (&tree.links[i - 1], self.reactions[i]);
            let (parent, arm) = (link.parent(), tree.origins[i] - tree.origins[link.parent()]);
            self.reactions[parent].force += own.force;
            self.reactions[parent].torque += own.torque + arm.cross(own.force);
            for s in 0..equations.springs.len() {
                if self.spring_members[s] != i {
                    continue;
                }
                let axis = (&tree.rotations[parent] * link.axis) * self.spring_effort(s, h);
                // Torque about the child's centre of mass of a force at the child's end of the joint.
                let part = if equations.springs[s].is_angle {
                    Wrench { force: Vector::zero(), torque: axis }
                } else {
                    Wrench { force: axis, torque: axis.cross(&tree.rotations[i] * link.arm) }
                };
                own.force -= part.force;
                own.torque -= part.torque;
                self.spring_reactions[s] = part;
            }
            self.reactions[i] = own;
        }
    }

    fn spring_effort(&self, index: usize, h: f64) -> f64 {
        let spring = &self.motion.equations.springs[index];
        if spring.is_stiff {
            return self.rows.spring_impulse(index) / h;
        }
        let k = spring.coordinate();
        -spring.sign * spring.stiffness * spring.displacement(self.position.q[k]) - spring.damping * self.rate.q[k]
    }

    /// Writes the velocities z at the beginning of the sub-step and after its free motion.
    pub fn read_rates(&self, start: &mut [f64], free: &mut [f64]) {
        let coupled = &self.motion.equations.coupled;
        coupled.coordinates_of(&self.rate, start);
        coupled.coordinates_of(&self.row_rate, free);
    }
}

fn subtract(from: &mut Rate<'_, f64>, rate: &Rate<'_, f64>) {
    from.angular -= rate.angular;
    from.linear -= rate.linear;
    from.q.iter_mut().zip(&*rate.q).for_each(|(from, rate)| *from -= rate);
}
