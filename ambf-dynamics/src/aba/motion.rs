//! The motion of a tree over a sub-step: what it consists of, and the accelerations.

use std::mem::take;

use super::algebra::{Quaternion, Vector};
use super::coupling::Coupled;
use super::drives::{Instant, World};
use super::list::List;
use super::scalar::Scalar;
use super::{Driven, Forces, Position, Rate, Tree};

/// Generalised force -sign k (x - rest) - d q' on a coordinate q, where x = sign q + offset, wrapped to [-π, π] if it is an angle.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Spring<S> {
    pub(super) coordinate: i32,
    pub(super) is_angle: bool,
    pub(super) sign: S,
    pub(super) offset: S,
    /// N·m/rad or N/m.
    pub(super) stiffness: S,
    /// N·m·s/rad or N·s/m.
    pub(super) damping: S,
    pub(super) rest: S,
    /// Too stiff for explicit integration with the step: not one of the forces here, but a drive or a row.
    pub(super) is_stiff: bool,
    pub(super) resists_corrections: bool,
    pub(super) settles_in_a_step: bool,
}

impl Spring<f64> {
    /// One without force.
    pub(super) fn none() -> Self {
        Self {
            coordinate: 0,
            is_angle: false,
            sign: 1.0,
            offset: 0.0,
            stiffness: 0.0,
            damping: 0.0,
            rest: 0.0,
            is_stiff: false,
            resists_corrections: false,
            settles_in_a_step: false,
        }
    }
}

impl<S> Spring<S> {
    #[inline(always)]
    pub(super) fn coordinate(&self) -> usize {
        self.coordinate as usize
    }
}

/// Of the beginning of the step, and what is estimated from step to step.
#[derive(Debug, Clone, Copy)]
pub struct Start<S> {
    /// Internal and elastic energy, J.
    pub energy: S,
    pub elastic_energy: S,
    /// Largest angular velocity of a link or joint, rad/s.
    pub rotation: S,
    /// See [`Tree::carrying_power`] and [`Tree::centrifugal_energy`].
    pub carrying_power: S,
    pub centrifugal_energy: S,
    /// Square of the angular frequency of the fastest mode of vibration, 1/s².
    pub stiffness: S,
}

impl<S: Scalar> Start<S> {
    /// Before the first step.
    #[inline(always)]
    pub(super) fn zero() -> Self {
        let zero = S::splat(0.0);
        Self {
            energy: zero,
            elastic_energy: zero,
            rotation: zero,
            carrying_power: zero,
            centrifugal_energy: zero,
            stiffness: zero,
        }
    }
}

/// Numbers a coordinate, vectors a body, and quaternions a ball joint that the memory of a motion has.
pub const NUMBERS: usize = 16;
/// See [`NUMBERS`].
pub const VECTORS: usize = 3;
/// See [`NUMBERS`].
pub const QUATERNIONS: usize = 6;

/// Memory of a motion.
pub struct Memory<'a, S: Scalar> {
    pub numbers: &'a mut [S],
    pub vectors: &'a mut [Vector<S>],
    pub quaternions: &'a mut [Quaternion<S>],
}

/// A tree and what acts on it.
pub struct Equations<'a, 'w, S: Scalar> {
    pub tree: Tree<'a, S>,
    pub springs: List<'a, Spring<S>>,
    pub coupled: Coupled<'a>,
    /// On each coordinate, N·m or N, constant over a step.
    pub forces: &'a mut [S],
    pub efforts: &'a mut [S],
    pub driven: &'a mut [Driven<S>],
    /// At most as many as there are numbers in a [`Scalar`].
    pub(super) worlds: &'a mut [World<'w>],
    /// Length of the step, s, while drives act in it; else 0.
    pub drive_step: f64,
}

/// A tree that moves over a step.
pub struct Motion<'a, 'w, S: Scalar> {
    pub equations: Equations<'a, 'w, S>,
    /// By semi-implicit Euler steps instead of the classical Runge-Kutta method.
    pub by_euler: bool,
    pub start: Start<S>,
    pub start_rate: Rate<'a, S>,
    pub start_origins: &'a mut [Vector<S>],
    /// Forces without what bounds the acceleration, during a step.
    pub unbounded: &'a mut [S],
    /// Shape of the fastest mode of vibration.
    pub mode: &'a mut [S],
    pub stage: Position<'a, S>,
    pub part: Position<'a, S>,
    pub stage_rate: Rate<'a, S>,
    pub part_rate: Rate<'a, S>,
    pub slopes: [Rate<'a, S>; 4],
    pub speeds: [Rate<'a, S>; 4],
    pub ball_spins: [&'a mut [Quaternion<S>]; 4],
    /// Linear and angular.
    pub wanted: [&'a mut [Vector<S>]; 2],
}

/// The first elements, which are taken away.
#[inline(always)]
pub(super) fn cut<'a, T>(block: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let (first, rest) = take(block).split_at_mut(count);
    *block = rest;
    first
}

/// A world; where there are fewer than numbers in a [`Scalar`], the first stands for those that are missing.
#[inline(always)]
pub(super) fn of<'a, 'b>(worlds: &'a [World<'b>], world: usize) -> &'a World<'b> {
    worlds.get(world).unwrap_or(&worlds[0])
}

impl<'a, 'w, S: Scalar> Motion<'a, 'w, S> {
    /// Of a tree with these numbers of coordinates and ball joints.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)]
    pub(super) fn new(
        tree: Tree<'a, S>,
        [coordinates, balls]: [usize; 2],
        memory: Memory<'a, S>,
        forces: &'a mut [S],
        driven: &'a mut [Driven<S>],
        springs: List<'a, Spring<S>>,
        coupled: Coupled<'a>,
        worlds: &'a mut [World<'w>],
    ) -> Self {
        let Memory { mut numbers, mut vectors, mut quaternions } = memory;
        let bodies = tree.bodies.len();
        let mut numbers = || cut(&mut numbers, coordinates);
        let mut vectors = || cut(&mut vectors, bodies);
        let mut quaternions = || cut(&mut quaternions, balls);
        let rate = |q| Rate { angular: Vector::zero(), linear: Vector::zero(), q };
        let mut position = |q| Position { q, balls: quaternions(), ..Position::default() };
        Self {
            unbounded: numbers(),
            mode: numbers(),
            start_rate: rate(numbers()),
            start_origins: vectors(),
            equations: Equations {
                tree,
                springs,
                coupled,
                forces,
                efforts: numbers(),
                driven,
                worlds,
                drive_step: 0.0,
            },
            by_euler: false,
            start: Start::zero(),
            stage: position(numbers()),
            part: position(numbers()),
            stage_rate: rate(numbers()),
            part_rate: rate(numbers()),
            slopes: [rate(numbers()), rate(numbers()), rate(numbers()), rate(numbers())],
            speeds: [rate(numbers()), rate(numbers()), rate(numbers()), rate(numbers())],
            ball_spins: [quaternions(), quaternions(), quaternions(), quaternions()],
            wanted: [vectors(), vectors()],
        }
    }
}

impl<S: Scalar> Equations<'_, '_, S> {
    /// Brings poses and velocities of the bodies up to date.
    #[inline(always)]
    pub fn place(&mut self, at: &Position<'_, S>, rate: &Rate<'_, S>) {
        self.tree.update_poses(at);
        self.tree.update_velocities(rate);
    }

    /// Accelerations under external forces, springs and drives. Poses and velocities are those of the position and rate, unless
    /// `is_placed` is false: they are undefined afterwards then.
    #[inline(always)]
    pub fn accelerate(&mut self, at: &Position<'_, S>, rate: &Rate<'_, S>, out: &mut Rate<'_, S>, is_placed: bool) {
        self.efforts.copy_from_slice(self.forces);
        let has_drives = self.drive_step > 0.0;
        if has_drives {
            for (world, of_world) in self.worlds.iter().enumerate() {
                of_world.add_bounds(self.drive_step, self.efforts, world);
            }
            for (effort, driven) in self.efforts.iter_mut().zip(&*self.driven) {
                *effort += driven.pull;
            }
        }
        for spring in self.springs.iter().filter(|spring| !spring.is_stiff) {
            let k = spring.coordinate();
            let elastic = spring.sign * spring.stiffness * spring.displacement(at.q[k]);
            self.efforts[k] -= elastic + spring.damping * rate.q[k];
        }
        let is_coupled = !self.coupled.is_empty();
        if is_coupled && !is_placed {
            self.place(at, rate);
        }
        let driven: &mut [Driven<S>] = if has_drives { self.driven } else { &mut [] };
        let forces = Forces { efforts: self.efforts, driven };
        let at = (!is_placed && !is_coupled).then_some(at);
        S::find_accelerations(&mut self.tree, at, rate, forces, out);
        if is_coupled {
            S::couple(self, out);
        }
    }

    /// Gives the drives in their present states to the equations of motion; `start`: rates at the beginning of the step, as below.
    #[inline(always)]
    fn load_drives(&mut self, start: &Rate<'_, S>) {
        for (world, of_world) in self.worlds.iter_mut().enumerate() {
            of_world.load(self.drive_step, start, world);
        }
        let worlds = &*self.worlds;
        for (k, driven) in self.driven.iter_mut().enumerate() {
            *driven = Driven {
                inertia: S::of_worlds(|world| of(worlds, world).driven[k].inertia),
                pull: S::of_worlds(|world| of(worlds, world).driven[k].pull),
                is_given: S::of_worlds(|world| of(worlds, world).driven[k].is_given),
                given: S::of_worlds(|world| of(worlds, world).driven[k].given),
                force: S::splat(0.0),
            };
        }
    }

    /// Lets each world do something with its drives and the last evaluation. Whether one of them says so.
    #[inline(always)]
    fn any_world(
        &mut self,
        start: &Rate<'_, S>,
        acceleration: &Rate<'_, S>,
        mut act: impl FnMut(&mut World<'_>, &Instant<'_, S>) -> bool,
    ) -> bool {
        let mut any = false;
        for (world, of_world) in self.worlds.iter_mut().enumerate() {
            let (h, driven) = (self.drive_step, &*self.driven);
            any |= act(of_world, &Instant { world, h, start, acceleration, driven });
        }
        any
    }

    /// Finds the accelerations at the beginning of the step and the states of the drives that go with them, by principal pivoting.
    #[inline(always)]
    pub fn settle_drives(&mut self, from: &Position<'_, S>, start: &Rate<'_, S>, out: &mut Rate<'_, S>) {
        // Largest number of evaluations in which all drives that are wrong change their states at once, and in all; with one change at
        // a time the method ends (Murty's least-index rule).
        const MAX_BLOCK_ROUNDS: usize = 6;
        const MAX_ROUNDS: usize = 40;
        self.worlds.iter_mut().for_each(World::plan);
        for round in 0.. {
            self.load_drives(start);
            self.accelerate(from, start, out, true);
            let changed = self.any_world(start, out, |world, at| {
                world.measure(at);
                round < MAX_ROUNDS && world.pivot(at, round >= MAX_BLOCK_ROUNDS)
            });
            if !changed {
                break;
            }
        }
        self.worlds.iter_mut().for_each(World::keep_start);
    }

    /// Accelerations within the step, where motors may reach their bounds.
    #[inline(always)]
    pub fn accelerate_driven(
        &mut self,
        start: &Rate<'_, S>,
        at: &Position<'_, S>,
        rate: &Rate<'_, S>,
        out: &mut Rate<'_, S>,
        is_placed: bool,
    ) {
        loop {
            self.accelerate(at, rate, out, is_placed);
            let is_saturated = |world: &mut World<'_>, at: &Instant<'_, S>| {
                world.measure(at);
                world.saturate()
            };
            if self.drive_step == 0.0 || !self.any_world(start, out, is_saturated) {
                break;
            }
            self.load_drives(start);
        }
    }

    /// Accelerations at the beginning once more, with the states that the drives had there.
    #[inline(always)]
    pub fn begin_again(&mut self, from: &Position<'_, S>, start: &Rate<'_, S>, out: &mut Rate<'_, S>) {
        self.place(from, start);
        self.worlds.iter_mut().for_each(World::return_to_start);
        if self.drive_step > 0.0 {
            self.load_drives(start);
        }
        self.accelerate_driven(start, from, start, out, true);
    }

    /// Adds `time` s of the step with the forces of the last evaluation, at the rates there.
    #[inline(always)]
    pub fn add_drive_sums(&mut self, time: f64, rate: &Rate<'_, S>) {
        if self.drive_step == 0.0 {
            return;
        }
        let share = time / self.drive_step;
        for (world, of_world) in self.worlds.iter_mut().enumerate() {
            of_world.add_sums(share, rate, world);
        }
    }

    /// Largest rate or acceleration of a world's joints that no drive accelerates, rad/s or rad/s².
    #[inline(always)]
    pub fn fastest_undriven(&self, world: usize, rate: &Rate<'_, S>) -> f64 {
        let mut fastest = 0.0_f64;
        for link in self.tree.links {
            if !self.is_driven(world, link) {
                fastest = fastest.or_larger(Tree::joint_speed(link, rate).of(world));
            }
        }
        fastest
    }

    /// Whether drives determine the acceleration of a joint.
    #[inline(always)]
    pub fn is_driven(&self, world: usize, link: &super::Link) -> bool {
        self.drive_step > 0.0 && link.freedoms() == 1 && self.worlds[world].is_driven(link.coordinate())
    }
}

/// Adds h times rate to a position; rotations by the exponential map.
#[inline(always)]
pub fn advance_position<S: Scalar>(tree: &Tree<'_, S>, position: &mut Position<'_, S>, h: f64, rate: &Rate<'_, S>) {
    let h = S::splat(h);
    position.origin += rate.linear * h;
    for (q, speed) in position.q.iter_mut().zip(&*rate.q) {
        *q += h * *speed;
    }
    position.rotation = position.rotation.turned(rate.angular, h);
    for link in tree.links.iter().filter(|link| link.ball >= 0) {
        let ball = &mut position.balls[link.ball as usize];
        *ball = ball.turned(rate.three(link.coordinate() + link.sliding as usize), h);
    }
}

/// `to` becomes `from` plus h times a slope.
#[inline(always)]
pub fn advance<S: Scalar>(to: &mut Rate<'_, S>, from: &Rate<'_, S>, h: f64, slope: &Rate<'_, S>) {
    let h = S::splat(h);
    to.angular = from.angular + slope.angular * h;
    to.linear = from.linear + slope.linear * h;
    for ((to, from), slope) in to.q.iter_mut().zip(&*from.q).zip(&*slope.q) {
        *to = *from + h * *slope;
    }
}
