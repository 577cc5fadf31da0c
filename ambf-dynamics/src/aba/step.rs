//! A step of a tree.
//!
//! Mostly it is one step of the [method](super::method) with the accelerations at its beginning. Where an articulation vibrates or turns
//! too fast for that, where it passes limits, or where the internal energy grows by more than the work of all forces, the step is made
//! anew in more parts, or with the limits; of worlds side by side each of these alone.

use std::mem::take;

use super::algebra::Vector;
use super::drives::{Drive, World};
use super::energy::{Momentum, Works};
use super::motion::{advance_position, of, Motion};
use super::scalar::Scalar;
use super::{Position, Rate, Tree};

/// Change of the internal energy, and of the angular momentum of a free base, that is tolerated as truncation error of a step: as a share
/// of the energy and of the work in the step, and of the angular momenta of all bodies.
const MAX_GROWTH: f64 = 1e-4;
/// Largest phase of a vibration in a step (the method is stable up to 2.8 rad), and largest turn of a body, rad.
const MAX_PHASE: f64 = 1.5;
const MAX_TURN: f64 = 0.3;
/// Largest decay rate times step: the method is unstable from 2.8 on, and inaccurate from a tenth of that.
const MAX_DECAY: f64 = 0.2;
/// Rounding error of the internal energy, as a share of the kinetic energy.
const ROUNDING: f64 = 1e-12;
/// Change of a rate in a step by the acceleration at its beginning, m/s or rad/s, that no real force causes.
const MAX_CHANGE: f64 = 1e15;
/// Largest number of parts, and by how much it grows.
const MAX_PARTS: usize = 100;
const REFINEMENT: usize = 4;
const PROBES_AT_FIRST: usize = 10;
const STEPS_BETWEEN_PROBES: i32 = 16;
const QUARTER_TURN: f64 = std::f64::consts::FRAC_PI_2;

/// At the beginning of a step.
#[derive(Clone, Copy)]
struct Begun<S: Scalar> {
    momentum: Momentum<S>,
    wrench: Momentum<S>,
    /// Powers of drag and torques, W, and the most that torques do in the step, J.
    drag: S,
    twist: S,
    most_twisted: S,
}

/// Energy at the end of a step, J: `allowed` by what there was and the work in it.
#[derive(Clone, Copy)]
struct Balance<S> {
    after: S,
    allowed: S,
    slack: S,
}

/// What rates and momentum are to be at the end of a step, where they are not.
struct Slip<S: Scalar> {
    wanted: Momentum<S>,
    present: Momentum<S>,
    /// Above 0 where it is so.
    has_slipped: S,
    has_turned: S,
}

/// Whether damping has to be split off from the other forces.
pub(super) fn is_stiff(bodies: &[super::Body<f64>], h: f64) -> bool {
    bodies.iter().any(|body| body.linear_drag.or_larger(body.angular_drag) * h > MAX_DECAY)
}

impl<S: Scalar> Motion<'_, '_, S> {
    #[inline(always)]
    fn begin(&mut self, h: f64, from: &Position<'_, S>) -> Begun<S> {
        let tree = &self.equations.tree;
        self.start.energy = tree.internal_energy();
        let (mut momentum, mut wrench) = (Momentum::zero(), Momentum::zero());
        if !tree.has_fixed_base {
            let centre = tree.mass_centre();
            momentum = tree.momentum(centre);
            wrench = tree.wrench(centre);
        }
        let drag = tree.drag_power();
        self.start.rotation = tree.fastest_rotation(&self.start_rate);
        self.start.elastic_energy =
            if self.equations.springs.is_empty() { S::splat(0.0) } else { self.equations.elastic_energy(from) };
        self.start.carrying_power = tree.carrying_power();
        self.start.centrifugal_energy = if tree.is_carried() { tree.centrifugal_energy() } else { S::splat(0.0) };
        self.start_origins.copy_from_slice(tree.origins);
        // The rotation in the step grows by a quarter of a turn at most, and with it the work of torques beyond that which other forces
        // take: velocities that diverge say nothing about it.
        let mut most_twisted = S::splat(0.0);
        let most_turned = self.start.rotation * S::splat(h) + S::splat(QUARTER_TURN);
        for body in &*tree.bodies {
            most_twisted += body.torque.length() * most_turned;
        }
        Begun { momentum, wrench, drag, twist: tree.twist_power(), most_twisted }
    }

    /// Accelerations at the beginning, and the estimate of the fastest mode.
    #[inline(always)]
    fn begin_slopes(&mut self, h: f64, from: &Position<'_, S>) {
        let (equations, start, slope) = (&mut self.equations, &self.start_rate, &mut self.slopes[0]);
        equations.drive_step = if equations.worlds.iter().all(|world| world.drives.is_empty()) { 0.0 } else { h };
        if equations.drive_step > 0.0 {
            equations.settle_drives(from, start, slope);
        } else {
            equations.accelerate(from, start, slope, true);
        }
        if !from.q.is_empty() {
            self.probe(from);
        }
        self.unbounded.copy_from_slice(self.equations.forces);
    }

    /// Steps of a power iteration for the fastest mode of vibration, of the worlds where it is time.
    #[inline(always)]
    fn probe(&mut self, from: &Position<'_, S>) {
        let mut most = 0;
        let mut probes = [0; 4];
        for (world, of_world) in self.equations.worlds.iter_mut().enumerate() {
            of_world.steps_until_probe -= 1;
            if of_world.steps_until_probe >= 0 {
                continue;
            }
            probes[world] = 1;
            if !std::mem::replace(&mut of_world.has_mode, true) {
                probes[world] = PROBES_AT_FIRST;
                // The fastest modes of chains are zigzags.
                for (k, mode) in self.mode.iter_mut().enumerate() {
                    let zigzag = if k % 2 == 1 { -1.0 } else { 1.0 } * (1.0 + 0.3 * (k % 3) as f64);
                    let before = *mode;
                    *mode = S::of_worlds(|other| if other == world { zigzag } else { before.of(other) });
                }
            }
            of_world.steps_until_probe = STEPS_BETWEEN_PROBES;
            most = most.max(probes[world]);
        }
        for i in 0..most {
            let is_due = S::of_worlds(|world| if i < probes[world] { 1.0 } else { 0.0 });
            self.update_fastest_mode(from, is_due);
        }
    }

    /// One step of a power iteration for the fastest mode about the present motion, in worlds where `is_due` is positive. `slopes[0]` is
    /// the present acceleration.
    #[inline(always)]
    fn update_fastest_mode(&mut self, at: &Position<'_, S>, is_due: S) {
        // Displacement of the finite difference, rad or m.
        const SHIFT: f64 = 1e-6;
        let (stage, found, equations) = (&mut self.stage, &mut self.stage_rate, &mut self.equations);
        found.clear();
        found.q.copy_from_slice(self.mode);
        stage.copy(at);
        advance_position(&equations.tree, stage, SHIFT, found);
        equations.place(stage, &self.start_rate);
        equations.accelerate(stage, &self.start_rate, found, true);
        let mut square = S::splat(0.0);
        for (q, slope) in found.q.iter_mut().zip(&*self.slopes[0].q) {
            *q -= *slope;
            square += *q * *q;
        }
        let length = square.sqrt();
        self.start.stiffness = is_due.if_positive(length / S::splat(SHIFT), self.start.stiffness);
        let is_found = S::of_worlds(|world| {
            let (length, is_due) = (length.of(world), is_due.of(world));
            if is_due > 0.0 && length > 0.0 && length < super::drives::INFINITE {
                1.0
            } else {
                0.0
            }
        });
        for (mode, q) in self.mode.iter_mut().zip(&*found.q) {
            *mode = is_found.if_positive(*q / length, *mode);
        }
    }

    /// The number of parts of a world's step is the next integer, if this is above 1.
    #[inline(always)]
    fn phases(&self, h: f64) -> S {
        let h = S::splat(h);
        let vibration = h * self.start.stiffness.sqrt() / S::splat(MAX_PHASE);
        vibration.or_larger(h * self.start.rotation / S::splat(MAX_TURN))
    }

    #[inline(always)]
    fn balance(&mut self, h: f64, from: &Position<'_, S>, to: &Position<'_, S>, begun: &Begun<S>) -> Balance<S> {
        let half = S::splat(h / 2.0);
        // The work of torques uses the mean angular velocity.
        let twist = self.equations.tree.twist_power();
        let Works { internal, of_mass_centre } = self.works_of_forces(h, from, to);
        let by_drives = S::of_worlds(|world| {
            of(self.equations.worlds, world).drives.iter().fold(internal.of(world), |sum, drive| sum + drive.work())
        });
        let twisted = (half * (begun.twist + twist)).or_smaller(begun.most_twisted + by_drives.abs());
        let work = by_drives + twisted + half * (begun.drag + self.equations.tree.drag_power());
        let (energy, lifted) = (self.start.energy, of_mass_centre.abs());
        // Of a method of first order the root of that share.
        let growth = S::splat(if self.by_euler { MAX_GROWTH.sqrt() } else { MAX_GROWTH });
        let slack =
            growth * (energy + work.abs()) + S::splat(ROUNDING) * (self.equations.tree.kinetic_energy() + lifted);
        Balance { after: self.equations.tree.internal_energy(), allowed: energy + work, slack }
    }

    /// How the momentum of a free base is wrong. It changes by external forces and the drag alone. Where links turn by radians in a part
    /// of the step, the truncation errors of base and joints together are a force on the mass centre and a torque about it, whose energy
    /// no balance of the internal energy sees.
    #[inline(always)]
    fn slip(&self, h: f64, begun: &Begun<S>) -> Slip<S> {
        let tree = &self.equations.tree;
        let centre = tree.mass_centre();
        let (present, after) = (tree.momentum(centre), tree.wrench(centre));
        let (half, h) = (S::splat(h / 2.0), S::splat(h));
        let wanted = Momentum {
            linear: begun.momentum.linear + (begun.wrench.linear + after.linear) * half,
            angular: begun.momentum.angular + (begun.wrench.angular + after.angular) * half,
        };
        // The mean wrench is that of the trapezoidal rule, of lower order than the method where velocities are smooth.
        let slipped = (wanted.linear - present.linear).length() - h * (after.linear - begun.wrench.linear).length();
        let mut scale = S::splat(0.0);
        let velocity = present.linear * (S::splat(1.0) / tree.mass());
        for (i, body) in tree.bodies.iter().enumerate() {
            let (arm, way) = (tree.origins[i] - centre, tree.linear[i] - velocity);
            scale += tree.angular_momentum(i).length() + arm.cross(way).length() * body.mass;
        }
        let turned = (wanted.angular - present.angular).length();
        let tolerance = (S::splat(MAX_GROWTH) * scale).or_larger(h * (after.angular - begun.wrench.angular).length());
        Slip { wanted, present, has_slipped: slipped, has_turned: turned - tolerance }
    }

    /// The step where nothing has to be made anew. Returns the worlds, a bit each, of which it is not the step: what is written of them is
    /// to be made anew by [`step`](Motion::step).
    #[inline(always)]
    pub fn straight_step(
        &mut self,
        h: f64,
        from: &Position<'_, S>,
        rate: &Rate<'_, S>,
        to: &mut Position<'_, S>,
        new_rate: &mut Rate<'_, S>,
    ) -> u32 {
        let mut others = 0;
        self.equations.place(from, rate);
        self.start_rate.copy(rate);
        let begun = self.begin(h, from);
        self.begin_slopes(h, from);
        let (largest, phases) = (Tree::largest_component(&self.slopes[0]), self.phases(h));
        for world in 0..self.equations.worlds.len() {
            let is_measured = h * largest.of(world) < MAX_CHANGE;
            let is_bounded = self.equations.fastest_undriven(world, &self.slopes[0]) <= QUARTER_TURN / (h * h);
            let holds = self.equations.worlds[world].drives.iter().all(Drive::is_measured);
            others |= u32::from(!(is_measured && is_bounded && holds && phases.of(world) <= 1.0)) << world;
        }
        self.divided_step(h, 1, from, rate, to, new_rate);
        self.equations.place(to, new_rate);
        let Balance { after, allowed, slack } = self.balance(h, from, to, &begun);
        for (world, of_world) in self.equations.worlds.iter_mut().enumerate() {
            let after = after.of(world);
            let is_kept = after.is_finite() && (after <= 0.0 || after <= allowed.of(world) + slack.of(world));
            let way = |k: usize| to.q[k].of(world) - from.q[k].of(world);
            let passes = of_world.catch_limits(h, true, way, |k| new_rate.q[k].of(world));
            others |= u32::from(!is_kept || passes) << world;
        }
        if !self.equations.tree.has_fixed_base {
            let slip = self.slip(h, &begun);
            for world in 0..self.equations.worlds.len() {
                let is_right = slip.has_slipped.of(world) <= 0.0 && slip.has_turned.of(world) <= 0.0;
                others |= u32::from(!is_right) << world;
            }
        }
        self.equations.drive_step = 0.0;
        others
    }

    /// Integrates over h s in equal parts. `slopes[0]` is the acceleration at the beginning.
    #[inline(always)]
    fn divided_step(
        &mut self,
        h: f64,
        parts: usize,
        from: &Position<'_, S>,
        rate: &Rate<'_, S>,
        to: &mut Position<'_, S>,
        new_rate: &mut Rate<'_, S>,
    ) {
        self.equations.worlds.iter_mut().for_each(World::begin_sums);
        let length = h / parts as f64;
        self.part_step(length, from, rate, to, new_rate);
        for _ in 1..parts {
            let (mut part, mut part_rate) = (take(&mut self.part), take(&mut self.part_rate));
            part.copy(to);
            part_rate.copy(new_rate);
            self.equations.place(&part, &part_rate);
            self.equations.accelerate_driven(&self.start_rate, &part, &part_rate, &mut self.slopes[0], true);
            self.part_step(length, &part, &part_rate, to, new_rate);
            (self.part, self.part_rate) = (part, part_rate);
        }
    }
}

impl Motion<'_, '_, f64> {
    /// Integrates over h s. Poses and velocities are those of `from` and `rate`; afterwards they are those of `to` and `new_rate`. The step
    /// is divided into parts if the articulation vibrates or turns too fast for it, and further while the kinetic energy grows by more
    /// than the work of all forces. Damping that is stiff for h is split off (Strang splitting): it acts for h / 2 before and after.
    ///
    /// Drives act in it: limits are found to be reached or not, and motors within their bounds, by the accelerations at the beginning; a
    /// limit that is passed nevertheless makes the step again.
    pub fn step(
        &mut self,
        h: f64,
        from: &Position<'_, f64>,
        rate: &Rate<'_, f64>,
        to: &mut Position<'_, f64>,
        new_rate: &mut Rate<'_, f64>,
    ) {
        self.equations.tree.splits_damping = is_stiff(self.equations.tree.bodies, h);
        self.start_rate.copy(rate);
        if self.equations.tree.splits_damping {
            let mut start = take(&mut self.start_rate);
            self.apply_damping(h / 2.0, from, &mut start);
            self.start_rate = start;
        }
        let begun = self.begin(h, from);
        self.begin_slopes(h, from);
        // Forces without measure end in a state that is not finite, which stops the simulation with a word about it.
        let is_measured = h * Tree::largest_component(&self.slopes[0]) < MAX_CHANGE;
        if is_measured {
            self.bound_acceleration(h, from);
        }
        let phases = self.phases(h);
        // The comparison is false for NaN.
        let mut parts = if phases > 1.0 { phases.ceil().or_smaller(MAX_PARTS as f64) as usize } else { 1 };
        // Limits and motors that would hold such forces hide them from the accelerations.
        let holds = self.equations.worlds[0].drives.iter().all(Drive::is_measured);
        let (mut scale, mut has_caught) = (1.0, false);
        let mut start = take(&mut self.stage_rate);
        start.copy(&self.start_rate);
        loop {
            self.divided_step(h, parts, from, &start, to, new_rate);
            self.equations.place(to, new_rate);
            let Balance { mut after, allowed, slack } = self.balance(h, from, to, &begun);
            // With velocities that overflow in the step, `after` and `slack` are infinite. Near rest the energy is rounded to 0, and what
            // drag takes is more: nothing can be removed then.
            let is_kept = after.is_finite()
                && (after <= 0.0 || after <= allowed + slack || after <= allowed + slack + self.rounding_of_work(from));
            if is_kept {
                let (way, speed) = (|k: usize| to.q[k] - from.q[k], |k: usize| new_rate.q[k]);
                if has_caught || !self.equations.worlds[0].catch_limits(h, false, way, speed) {
                    break;
                }
                has_caught = true;
                self.equations.drive_step = h;
            } else if parts >= MAX_PARTS {
                // The largest number of parts was not enough: the excess energy is removed by scaling the velocities.
                let mut most = allowed;
                if !after.is_finite() && is_measured {
                    most = self.tangential_step(h, from, &start, to, new_rate);
                    after = self.equations.tree.internal_energy();
                }
                // At rest both are 0. The comparison is false for NaN, which is to be lost.
                scale = if most >= after { 1.0 } else { (most.or_larger(0.0) / after).sqrt() };
                break;
            } else {
                parts = (parts * REFINEMENT).min(MAX_PARTS);
            }
            self.equations.begin_again(from, &start, &mut self.slopes[0]);
        }
        self.stage_rate = start;
        if !holds {
            scale = f64::NAN;
        }
        self.equations.drive_step = 0.0;
        self.equations.forces.swap_with_slice(self.unbounded);
        // In this order: velocities of which only little is left may be so large that the momentum is lost to rounding.
        if scale < 1.0 || scale.is_nan() {
            self.equations.tree.scale_internal_velocity(scale, new_rate);
            self.equations.tree.update_velocities(new_rate);
        }
        if !self.equations.tree.has_fixed_base {
            self.restore_momentum(h, &begun, new_rate);
        }
        if self.equations.tree.splits_damping {
            self.apply_damping(h / 2.0, to, new_rate);
        }
    }

    fn restore_momentum(&mut self, h: f64, begun: &Begun<f64>, rate: &mut Rate<'_, f64>) {
        let Slip { mut wanted, present, has_slipped, has_turned } = self.slip(h, begun);
        if has_turned > 0.0 {
            wanted.linear = if has_slipped > 0.0 { wanted.linear } else { present.linear };
            self.equations.tree.set_momentum(&wanted, self.equations.tree.mass_centre(), rate);
        } else if has_slipped > 0.0 {
            rate.linear += (wanted.linear - present.linear) * (1.0 / self.equations.tree.mass());
            self.equations.tree.update_velocities(rate);
        }
    }

    /// Damping over h s: the velocities of all bodies decay, and their projection onto the joints gives the new rates.
    fn apply_damping(&mut self, h: f64, at: &Position<'_, f64>, rate: &mut Rate<'_, f64>) {
        self.equations.place(at, rate);
        let [linear, angular] = self.wanted.each_mut().map(take);
        for (i, body) in self.equations.tree.bodies.iter().enumerate() {
            linear[i] = self.equations.tree.linear[i] * (-body.linear_drag * h).exp();
            angular[i] = self.equations.tree.angular[i] * (-body.angular_drag * h).exp();
        }
        self.project(linear, angular, rate);
        self.wanted = [linear, angular];
        self.equations.tree.update_velocities(rate);
    }

    /// Instead of the last step: moves over h s along the tangent, with constant rates, without forces but those on the centre of mass of a
    /// free base. Near singular positions of links of next to no inertia the rates are finite for an instant only, and no step of useful
    /// length follows them. Returns the internal energy that the work of the forces leaves at most, J.
    pub fn tangential_step(
        &mut self,
        h: f64,
        from: &Position<'_, f64>,
        rate: &Rate<'_, f64>,
        to: &mut Position<'_, f64>,
        new_rate: &mut Rate<'_, f64>,
    ) -> f64 {
        new_rate.copy(rate);
        if !self.equations.tree.has_fixed_base {
            new_rate.linear += self.equations.tree.total_force() * (h / self.equations.tree.mass());
        }
        to.copy(from);
        advance_position(&self.equations.tree, to, h, new_rate);
        self.equations.place(to, new_rate);
        (self.start.energy + self.works_of_forces(h, from, to).internal).or_larger(0.0)
    }

    /// Projects velocities of the bodies onto the joints: finds the rates with the least kinetic energy of the difference. Poses are up to
    /// date. The velocity of a fixed base, which is that of `rate`, is given.
    pub fn project(&mut self, linear: &[Vector<f64>], angular: &[Vector<f64>], rate: &mut Rate<'_, f64>) {
        // Sets the motion subspaces of the joints; with rates of 0 there is no bias.
        self.stage_rate.clear();
        if self.equations.tree.has_fixed_base {
            (self.stage_rate.angular, self.stage_rate.linear) = (rate.angular, rate.linear);
        }
        self.equations.tree.update_velocities(&self.stage_rate);
        self.equations.efforts.fill(0.0);
        [rate.angular, rate.linear] = self.equations.tree.project(linear, angular, self.equations.efforts, rate.q);
        if !self.equations.coupled.is_empty() {
            self.equations.couple(rate);
        }
        if self.equations.tree.has_fixed_base {
            (rate.angular, rate.linear) = (self.stage_rate.angular, self.stage_rate.linear);
        }
    }
}
