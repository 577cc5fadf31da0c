//! Limits, motors, stiff springs and dampers, dry friction and largest rates of the joints of an articulation: as drives, which are part
//! of its equations of motion, or as rows of a solver.
//!
//! The forces of motors and stiff springs in the last sub-step are fed forward as generalised forces in the free motion over the next one,
//! and their rows solve for the change only (second order in h). An impulse alone would act at the position at the beginning of the
//! sub-step, after a free motion as if no motor held the articulation.

use std::ffi::c_int;

use super::algebra::Vector;
use super::articulation::{Bounds, Store};
use super::coupling::Coupled;
use super::drives::{DistantLimits, Drive, INFINITE};
use super::list::List;
use super::motion::{Equations, Motion, Spring};
use super::scalar::Scalar;
use super::{Link, Position, Rate};

/// Coefficient of restitution of a hinge at its limits, as in Bullet; that of a slider or spring is 0.
const HINGE_BOUNCE: f64 = 0.3;
/// Largest acceleration times h² under fed-forward forces, rad; for a slider that angle times the distance between the centres of mass
/// that it joins, m. Beyond it the motion depends too nonlinearly on the forces: after a jump of a set point the last force of the
/// controller would be repeated where the controller reverses it.
const MAX_FEEDFORWARD_MOTION: f64 = 0.02;
/// Difference of accelerations times h² up to which fed-forward forces are not refuted, rad or m.
const LEAST_REFUTED: f64 = 1e-6;
/// Share of the largest rate from which on there is a row: those of other joints may still speed up what is slower than that after the
/// free motion.
const NEAR_LARGEST_RATE: f64 = 0.5;
/// Share of the range in which limits may stop a joint that begins to move.
const NEAR_LIMIT: f64 = 0.01;

/// Sources of rows that are no forces of motors, springs and friction.
const LIMIT: i32 = -1;
/// See [`LIMIT`].
const LARGEST_RATE: i32 = -2;

/// What acts on the joint of a link of one freedom in a sub-step.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct Joint {
    /// Motor: the rate that it leads to, rad/s or m/s; its softness, change of rate per impulse; its largest impulse in the sub-step, N·m·s
    /// or N·s, 0: there is none.
    pub target: f64,
    /// See [`target`](Self::target).
    pub softness: f64,
    /// See [`target`](Self::target).
    pub impulse: f64,
    /// Inertia of the rotor, kg·m² or kg.
    pub armature: f64,
    /// Dry friction, N·m or N.
    pub friction: f64,
    /// Largest rate, rad/s or m/s; infinite: none.
    pub max_rate: f64,
    /// Limits, rad or m; low > high: none.
    pub low: f64,
    /// See [`low`](Self::low).
    pub high: f64,
    /// It is a hinge; else a slider or a spring.
    pub is_hinge: bool,
}

impl Joint {
    fn bounds_rate(&self) -> bool {
        self.max_rate < INFINITE
    }
}

/// A row of a joint, which gives its coordinate the rate target - softness * impulse, or its impulse is one of the bounds.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// The coordinate on which it acts.
    pub coordinate: c_int,
    /// rad/s or m/s.
    pub target: f64,
    /// Change of rate per impulse.
    pub softness: f64,
    /// Bounds of the impulse, N·m·s or N·s.
    pub low: f64,
    /// See [`low`](Self::low).
    pub high: f64,
    /// Motor: its coordinate; stiff spring: the number of coordinates plus the index of the spring; then friction and rotors, by
    /// coordinates; negative: a limit or a largest rate.
    pub source: c_int,
    /// Impulse of the fed-forward force, which is part of the free motion.
    pub feedforward: f64,
    /// Pseudo-velocity that corrects the position error, rad/s or m/s.
    pub correction: f64,
    /// Its rate is an angular velocity.
    pub is_angle: bool,
    /// Impulse in the last sub-step of the limit of a coordinate.
    pub guess: f64,
    /// If not 0, the row acts between a link, by the index of its body, and the parent: force and torque about its centre of mass on the
    /// link by a unit impulse of the row, world axes.
    pub member: c_int,
    /// See [`member`](Self::member).
    pub force: Vector<f64>,
    /// See [`member`](Self::member).
    pub torque: Vector<f64>,
    /// Its impulse in the sub-step, of a force that is fed forward the change only.
    pub impulse: f64,
    /// Rate after the free motion, rad/s or m/s, and change of rate by a unit impulse.
    pub velocity: f64,
    /// See [`velocity`](Self::velocity).
    pub response: f64,
    /// Limits: that, or what a stiff spring or controller on the coordinate leaves of it.
    pub softest: f64,
}

impl Row {
    /// A row of a limit without bounds.
    pub(super) fn limit(coordinate: usize, is_angle: bool) -> Self {
        Self {
            coordinate: coordinate as c_int,
            target: 0.0,
            softness: 0.0,
            low: -INFINITE,
            high: INFINITE,
            source: LIMIT,
            feedforward: 0.0,
            correction: 0.0,
            is_angle,
            guess: 0.0,
            member: 0,
            force: Vector::zero(),
            torque: Vector::zero(),
            impulse: 0.0,
            velocity: 0.0,
            response: 0.0,
            softest: 0.0,
        }
    }

    fn coordinate(&self) -> usize {
        self.coordinate as usize
    }

    fn is_limit_of_coordinate(&self) -> bool {
        self.source == LIMIT && self.member == 0
    }
}

/// A row of the limits of a joint of several coordinates.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct WideRow {
    /// Index of the body of the link.
    pub member: c_int,
    /// Bounds of the impulse.
    pub low: f64,
    /// See [`low`](Self::low).
    pub high: f64,
    /// Rate that corrects the error, rad/s or m/s.
    pub correction: f64,
    /// On the link, see [`Row::member`].
    pub force: Vector<f64>,
    /// See [`force`](Self::force).
    pub torque: Vector<f64>,
}

/// Works in a sub-step, J, of what rows and drives of joints are.
#[derive(Debug, Clone, Copy, Default)]
pub struct Works {
    /// Motors and rotors.
    pub motors: f64,
    /// Stiff springs and friction.
    pub damping: f64,
    /// Limits and largest rates.
    pub limits: f64,
}

/// The one that is nearer to 0 of two numbers of the same sign; else 0.
fn common_part(a: f64, b: f64) -> f64 {
    match (a * b > 0.0, a.abs() < b.abs()) {
        (false, _) => 0.0,
        (true, true) => a,
        (true, false) => b,
    }
}

/// Position and rates from which rows are planned.
#[derive(Clone, Copy)]
pub(super) struct At<'a, 'b> {
    pub position: &'a Position<'b, f64>,
    pub rate: &'a Rate<'b, f64>,
}

/// The rows of an articulation.
pub struct Rows<'a> {
    /// Those of this sub-step.
    pub planned: List<'a, Row>,
    /// Of the limits of joints of several coordinates, given for this sub-step.
    pub wide: List<'a, WideRow>,
    /// Limits of the coordinates of springs by their own limits, rad or m; low > high: none.
    pub spring_limits: &'a mut [[f64; 2]],
    coordinates: usize,
    bounds: Bounds,
    /// Force of each source in the last sub-step, N·m or N, and impulse of the limits of each coordinate, N·m·s or N·s.
    forces: &'a mut [f64],
    limit_impulses: &'a mut [f64],
    /// Impulse of the fed-forward force of the limit of each coordinate, and its velocities z, see [`Coupled`].
    limit_feedforward: &'a mut [f64],
    steady_impulses: &'a mut [f64],
    fed_velocity: &'a mut [f64],
    /// Impulse with which the limit of each coordinate holds it in the free motion, also as a part of the force of its motor.
    held_by_limits: &'a mut [f64],
    feeds_limits: bool,
    /// What is planned is part of the equations of motion of this sub-step.
    pub are_drives: bool,
    step: f64,
    acceleration: Rate<'a, f64>,
    with_feedforward: Rate<'a, f64>,
    fed_forces: &'a mut [f64],
    /// Rates of the coordinates at the beginning of this sub-step, and their change in the last one, as if it had lasted as long.
    last_rate: &'a mut [f64],
    last_change: &'a mut [f64],
}

impl<'a> Rows<'a> {
    /// Largest number of rows of the limits of a joint of several coordinates.
    pub const WIDE: usize = 6;

    /// Largest number of drives, or of rows without those of joints of several coordinates: two limits, a motor, a rotor, friction and two
    /// largest rates for each coordinate, two limits and a force for each spring.
    pub fn most(coordinates: usize, springs: usize) -> usize {
        7 * coordinates + 3 * springs
    }

    /// Without forces.
    pub(super) fn new(store: &mut impl Store<'a>, links: usize, [n, springs]: [usize; 2], bounds: Bounds) -> Self {
        let wide = Self::WIDE * (links + 1);
        let no_row = || WideRow {
            member: 0,
            low: 0.0,
            high: 0.0,
            correction: 0.0,
            force: Vector::zero(),
            torque: Vector::zero(),
        };
        let planned = store.take(Self::most(n, springs) + wide, || Row::limit(0, false));
        let mut numbers = |count| store.take(count, || 0.0);
        let rate = |q| Rate { q, ..Rate::default() };
        Self {
            forces: numbers(3 * n + springs),
            limit_impulses: numbers(n),
            limit_feedforward: numbers(n),
            steady_impulses: numbers(n),
            fed_velocity: numbers(n + 6),
            held_by_limits: numbers(n),
            acceleration: rate(numbers(n)),
            with_feedforward: rate(numbers(n)),
            fed_forces: numbers(n),
            last_rate: numbers(n),
            last_change: numbers(n),
            planned: List::new(planned),
            wide: List::new(store.take(wide, no_row)),
            spring_limits: store.take(springs, || [1.0, -1.0]),
            coordinates: n,
            bounds,
            feeds_limits: false,
            are_drives: false,
            step: 0.0,
        }
    }

    /// Discards the forces of the last sub-step, after the position was set.
    pub fn reset(&mut self) {
        self.planned.clear();
        for each in [
            &mut self.forces,
            &mut self.limit_impulses,
            &mut self.limit_feedforward,
            &mut self.held_by_limits,
            &mut self.steady_impulses,
            &mut self.fed_velocity,
            &mut self.last_rate,
            &mut self.last_change,
        ] {
            each.fill(0.0);
        }
        (self.feeds_limits, self.are_drives) = (false, false);
    }

    /// Whether there are rows, or forces of limits in the free motion that rows are to know.
    pub fn any(&self) -> bool {
        !self.are_drives && (!self.planned.is_empty() || self.feeds_limits)
    }

    /// Source of the friction on a coordinate: those of friction follow those of springs.
    fn friction_of(&self, coordinate: usize) -> usize {
        self.coordinates + self.spring_limits.len() + coordinate
    }

    /// Source of the inertia of the rotor of a coordinate: those of rotors follow those of friction.
    fn rotor_of(&self, coordinate: usize) -> usize {
        self.friction_of(self.coordinates) + coordinate
    }

    fn is_motor(&self, row: &Row) -> bool {
        (0..self.coordinates as i32).contains(&row.source)
    }

    /// Angle that is wrapped to within π of the centre of its limits, or displacement.
    fn coordinate_within(at: At<'_, '_>, k: usize, [low, high]: [f64; 2], is_angle: bool) -> f64 {
        let (q, centre) = (at.position.q[k], (low + high) / 2.0);
        if is_angle {
            centre + (q - centre).wrapped()
        } else {
            q
        }
    }

    /// Rate without a force of the spring at the end of a sub-step of h s, rad/s or m/s.
    fn target_of(at: At<'_, '_>, spring: &Spring<f64>, h: f64) -> f64 {
        let push = spring.sign * spring.stiffness * spring.displacement(at.position.q[spring.coordinate()]);
        -push / (spring.damping + h * spring.stiffness)
    }

    /// Keeps the rates at the beginning of this sub-step of h s, how they changed in the last one, and the forces and impulses of that.
    fn remember(&mut self, at: At<'_, '_>, h: f64) {
        for ((last, change), rate) in self.last_rate.iter_mut().zip(&mut *self.last_change).zip(&*at.rate.q) {
            *change = if self.step > 0.0 { (rate - *last) * (h / self.step) } else { 0.0 };
            *last = *rate;
        }
        self.forces.fill(0.0);
        // What holds a joint at its limit is fed forward, and what stops it there is not.
        self.steady_impulses.copy_from_slice(self.limit_impulses);
        self.limit_impulses.fill(0.0);
        for row in &*self.planned {
            if row.source >= 0 {
                self.forces[row.source as usize] = (row.feedforward + row.impulse) / self.step;
            } else if row.is_limit_of_coordinate() && row.impulse != 0.0 {
                self.limit_impulses[row.coordinate()] = row.impulse;
            }
        }
    }

    fn add_drive(&mut self, drives: &mut List<'_, Drive>, drive: Drive, source: i32) {
        self.planned.push(Row { source, ..drive.row() });
        drives.push(drive);
    }

    fn drive_limits(
        &mut self,
        at: At<'_, '_>,
        drives: &mut List<'_, Drive>,
        distant: &mut DistantLimits,
        [low, high]: [f64; 2],
        bounce: f64,
        h: f64,
    ) {
        if low > high {
            return;
        }
        let k = distant.coordinate as usize;
        let q = Self::coordinate_within(at, k, [low, high], distant.is_angle);
        if low == high {
            return self.add_drive(drives, Drive::lock(distant, q - low), LIMIT);
        }
        for (side, limit) in [(1.0, low), (-1.0, high)] {
            let (gap, speed) = (side * (q - limit), side * at.rate.q[k]);
            if gap > NEAR_LIMIT * (high - low) && gap + 2.0 * h * speed > 0.0 {
                *(if side > 0.0 { &mut distant.below } else { &mut distant.above }) = gap;
                continue;
            }
            let mut target = if gap < 0.0 { 0.0 } else { -gap / h };
            if bounce > 0.0 && gap + h * speed < 0.0 {
                target = target.or_larger(-bounce * speed);
            }
            self.add_drive(drives, Drive::limit(distant, side, side * target, gap), LIMIT);
        }
    }

    /// Instead of rows, where nothing else acts on the articulation: hands motors, stiff springs and limits to its equations of motion.
    pub(super) fn plan_drives(
        &mut self,
        at: At<'_, '_>,
        equations: &mut Equations<'_, '_, f64>,
        joints: &[Joint],
        h: f64,
    ) {
        self.remember(at, h);
        self.planned.clear();
        let world = &mut equations.worlds[0];
        let (drives, distant_limits) = (&mut world.drives, &mut world.distant);
        drives.clear();
        distant_limits.clear();
        equations.forces.fill(0.0);
        (self.feeds_limits, self.are_drives, self.step) = (false, true, h);
        for (link, joint) in equations.tree.links.iter().zip(joints).filter(|(link, _)| link.freedoms() == 1) {
            let (k, is_angle, rate) = (link.coordinate(), joint.is_hinge, at.rate.q[link.coordinate()]);
            let unbounded = |target, softness| Drive::new(k, is_angle, target, softness, -INFINITE, INFINITE);
            if joint.impulse > 0.0 {
                let motor = Drive::new(k, is_angle, joint.target, joint.softness, -joint.impulse, joint.impulse);
                self.add_drive(drives, motor, k as i32);
            }
            // The inertia of a rotor resists any change of the rate that it has.
            if joint.armature > 0.0 {
                self.add_drive(drives, unbounded(rate, 1.0 / joint.armature), self.rotor_of(k) as i32);
            }
            let friction = joint.friction * h;
            if friction > 0.0 {
                let source = self.friction_of(k) as i32;
                self.add_drive(drives, Drive::new(k, is_angle, 0.0, 0.0, -friction, friction), source);
            }
            let mut distant = DistantLimits::none(k, is_angle);
            let most = joint.max_rate;
            for side in [1.0, -1.0] {
                if !joint.bounds_rate() {
                    break;
                }
                if side * rate > -most / 2.0 {
                    *(if side > 0.0 { &mut distant.backward } else { &mut distant.forward }) = most;
                } else {
                    self.add_drive(drives, Drive::limit(&distant, side, -side * most, INFINITE), LARGEST_RATE);
                }
            }
            let bounce = if joint.is_hinge { HINGE_BOUNCE } else { 0.0 };
            self.drive_limits(at, drives, &mut distant, [joint.low, joint.high], bounce, h);
            if distant.any() {
                distant_limits.push(distant);
            }
        }
        for (i, spring) in equations.springs.iter().enumerate() {
            let (k, is_angle) = (spring.coordinate(), spring.is_angle);
            if spring.is_stiff {
                let softness = 1.0 / (h * (spring.damping + h * spring.stiffness));
                let drive = Drive::new(k, is_angle, Self::target_of(at, spring, h), softness, -INFINITE, INFINITE);
                self.add_drive(drives, drive, (self.coordinates + i) as i32);
            }
            let mut distant = DistantLimits::none(k, is_angle);
            self.drive_limits(at, drives, &mut distant, self.spring_limits[i], 0.0, h);
            if distant.any() {
                distant_limits.push(distant);
            }
        }
    }

    /// Keeps what the drives did in the sub-step.
    pub(super) fn take_drives(&mut self, drives: &[Drive]) {
        // Limits that were distant.
        for limit in drives.iter().skip(self.planned.len()) {
            let source = if limit.bounds_rate() { LARGEST_RATE } else { LIMIT };
            self.planned.push(Row { source, ..limit.row() });
        }
        for (row, drive) in self.planned.iter_mut().zip(drives) {
            let mean = drive.mean_impulse();
            (row.feedforward, row.impulse) = if row.source < 0 { (0.0, mean) } else { (mean, 0.0) };
        }
    }

    fn add_feedforward_row(&mut self, mut row: Row, h: f64, forces: &mut [f64]) {
        row.feedforward = (self.forces[row.source as usize] * h).or_larger(row.low).or_smaller(row.high);
        let is_measured = row.feedforward.abs() < INFINITE;
        if !is_measured {
            row.feedforward = 0.0;
        }
        forces[row.coordinate()] += row.feedforward / h;
        self.planned.push(row);
    }

    /// Plans the rows of motors and stiff springs of a sub-step of h s, whose fed-forward forces are added to the equations of motion.
    /// Springs that are not stiff resist the corrections of positions where there are any.
    pub(super) fn plan_motors(
        &mut self,
        at: At<'_, '_>,
        motion: &mut Motion<'_, '_, f64>,
        joints: &[Joint],
        h: f64,
        is_corrected: bool,
    ) {
        self.remember(at, h);
        self.are_drives = false;
        let equations = &mut motion.equations;
        equations.worlds[0].drives.clear();
        equations.worlds[0].distant.clear();
        self.feed_limits_forward(h);
        self.step = h;
        self.planned.clear();
        self.feeds_limits = self.limit_feedforward.iter().any(|impulse| *impulse != 0.0);
        for (force, impulse) in equations.forces.iter_mut().zip(&*self.limit_feedforward) {
            *force = impulse / h;
        }
        for (link, joint) in equations.tree.links.iter().zip(joints).filter(|(link, _)| link.freedoms() == 1) {
            let k = link.coordinate();
            let row = Row::limit(k, false);
            if joint.impulse > 0.0 {
                let (target, softness, most) = (joint.target, joint.softness, joint.impulse);
                let motor = Row { target, softness, low: -most, high: most, source: k as i32, ..row };
                self.add_feedforward_row(motor, h, equations.forces);
            }
            if joint.armature > 0.0 {
                let (target, softness, source) = (at.rate.q[k], 1.0 / joint.armature, self.rotor_of(k) as i32);
                self.add_feedforward_row(Row { target, softness, source, ..row }, h, equations.forces);
            }
            let friction = joint.friction * h;
            if friction > 0.0 {
                let source = self.friction_of(k) as i32;
                self.add_feedforward_row(Row { low: -friction, high: friction, source, ..row }, h, equations.forces);
            }
        }
        for (i, spring) in equations.springs.iter().enumerate() {
            let give = spring.damping + h * spring.stiffness;
            let (softness, source) = (1.0 / (h * give), (self.coordinates + i) as i32);
            let row = Row { softness, source, ..Row::limit(spring.coordinate(), false) };
            if spring.is_stiff {
                // The implicit force -k (x + h q') - d q' at the end of the sub-step, written as a soft row.
                let row = Row { target: Self::target_of(at, spring, h), ..row };
                self.add_feedforward_row(row, h, equations.forces);
            } else if spring.resists_corrections && is_corrected {
                // No impulse: the spring only resists corrections.
                self.planned.push(Row { low: 0.0, high: 0.0, ..row });
            }
        }
        self.drop_wrong_feedforward(at, motion, h);
    }

    /// What presses a joint against its limit is part of the free motion, which would turn the joint beyond it: the impulse of the limit is
    /// fed forward, too.
    fn feed_limits_forward(&mut self, h: f64) {
        self.limit_feedforward.fill(0.0);
        self.held_by_limits.fill(0.0);
        for i in 0..self.planned.len() {
            let row = self.planned[i];
            if !row.is_limit_of_coordinate() || row.impulse == 0.0 {
                continue;
            }
            let k = row.coordinate();
            // A motor may press a joint with a million times the force that moves it: the force of the limit is subtracted from it.
            let motor = self.planned.iter().find(|row| self.is_motor(row) && row.coordinate() == k);
            if let Some(source) = motor.map(|motor| motor.source as usize) {
                self.forces[source] += row.impulse / self.step;
                self.held_by_limits[k] += row.impulse / self.step * h;
            } else {
                self.limit_feedforward[k] += common_part(row.impulse, self.steady_impulses[k]) / self.step * h;
                self.held_by_limits[k] = self.limit_feedforward[k];
            }
        }
    }

    /// Drops all fed-forward forces if one of them accelerates the articulation too much, or if the acceleration of the last sub-step
    /// refutes them: the forces of a chain balance each other.
    fn drop_wrong_feedforward(&mut self, at: At<'_, '_>, motion: &mut Motion<'_, '_, f64>, h: f64) {
        if !self.feeds_limits && self.planned.iter().all(|row| row.feedforward == 0.0) {
            return;
        }
        let equations = &mut motion.equations;
        equations.place(at.position, at.rate);
        equations.accelerate(at.position, at.rate, &mut self.acceleration, true);
        let mut is_large = false;
        for link in equations.tree.links {
            for k in 0..link.freedoms() {
                let is_slide = k < link.sliding as usize;
                let scale = if is_slide { link.arm.length() + link.pivot.length() } else { 1.0 };
                // The comparison is false for NaN, which counts as large.
                let way = self.acceleration.q[link.coordinate() + k].abs() * h * h;
                let is_small = way <= MAX_FEEDFORWARD_MOTION * scale;
                is_large = is_large || !is_small;
            }
        }
        if !is_large && !self.is_refuted(at, equations, h) {
            return;
        }
        self.planned.iter_mut().for_each(|row| row.feedforward = 0.0);
        self.limit_feedforward.fill(0.0);
        self.held_by_limits.fill(0.0);
        self.feeds_limits = false;
        equations.forces.fill(0.0);
    }

    /// Whether a coordinate with a fed-forward force accelerated in the last sub-step as it does without all these forces rather than with
    /// them. Then contacts or external constraints balance them, which are not part of the free motion: they would have to stop what the
    /// forces accelerate.
    fn is_refuted(&mut self, at: At<'_, '_>, equations: &mut Equations<'_, '_, f64>, h: f64) -> bool {
        let misses = |found: &Rate<'_, f64>, last: &[f64], k: usize| (found.q[k] * h - last[k]).abs() * h;
        let fed = |forces: &[f64], k: usize| forces[k] != 0.0;
        let (last, all) = (&*self.last_change, 0..self.coordinates);
        let any = |k: usize| fed(equations.forces, k) && misses(&self.acceleration, last, k) > LEAST_REFUTED;
        if !all.clone().any(any) {
            return false;
        }
        std::mem::swap(&mut self.with_feedforward, &mut self.acceleration);
        self.fed_forces.copy_from_slice(equations.forces);
        equations.forces.fill(0.0);
        equations.accelerate(at.position, at.rate, &mut self.acceleration, true);
        equations.forces.copy_from_slice(self.fed_forces);
        all.into_iter().any(|k| {
            let without = misses(&self.acceleration, last, k);
            fed(equations.forces, k) && misses(&self.with_feedforward, last, k) > LEAST_REFUTED + without
        })
    }

    /// `driven`: rate that a stiff spring on the coordinate would give it if nothing else held it, rad/s or m/s.
    #[allow(clippy::too_many_arguments)]
    fn plan_limit(
        &mut self,
        at: At<'_, '_>,
        free: &Rate<'_, f64>,
        k: usize,
        limits: [f64; 2],
        is_angle: bool,
        bounce: f64,
        driven: f64,
        h: f64,
    ) {
        let [low, high] = limits;
        if low > high {
            return;
        }
        let most = if is_angle { self.bounds.return_rate } else { self.bounds.return_speed };
        let (q, erp, row) =
            (Self::coordinate_within(at, k, limits, is_angle), self.bounds.limit_erp, Row::limit(k, is_angle));
        if low == high {
            let correction = ((low - q) * erp / h).or_smaller(most).or_larger(-most);
            self.planned.push(Row { correction, guess: self.limit_impulses[k], ..row });
            return;
        }
        for (side, limit) in [(1.0, low), (-1.0, high)] {
            // Distance to the limit (negative: violated), and speed away from it.
            let (gap, speed) = (side * (q - limit), side * free.q[k]);
            // The joint rebounds from the velocity before the sub-step, not from what motors give it while they press it against its
            // limit.
            let speed_before = side * at.rate.q[k];
            let is_fed = side * self.limit_feedforward[k] > 0.0;
            if gap + h * speed.or_smaller(side * driven) >= 0.0 && gap >= 0.0 && !is_fed {
                continue;
            }
            let mut target = if gap < 0.0 { 0.0 } else { -gap / h };
            if bounce > 0.0 && gap + h * speed_before < 0.0 {
                target = target.or_larger(-bounce * speed_before);
            }
            let correction = if gap < 0.0 { (-gap / h * erp).or_smaller(most) } else { -gap / h };
            self.planned.push(Row {
                target: side * target,
                low: if side > 0.0 { 0.0 } else { -INFINITE },
                high: if side > 0.0 { INFINITE } else { 0.0 },
                correction: side * correction,
                guess: side * (side * self.limit_impulses[k]).or_larger(0.0),
                ..row
            });
            return;
        }
    }

    /// What would exceed the largest rate is brought back to it.
    fn plan_largest_rate(&mut self, free: &Rate<'_, f64>, k: usize, joint: &Joint) {
        let (rate, most) = (free.q[k], joint.max_rate);
        if !joint.bounds_rate() || rate.abs() <= NEAR_LARGEST_RATE * most {
            return;
        }
        let (side, row) = (if rate > 0.0 { 1.0 } else { -1.0 }, Row::limit(k, joint.is_hinge));
        let (low, high) = if side > 0.0 { (-INFINITE, 0.0) } else { (0.0, INFINITE) };
        self.planned.push(Row { target: side * most, low, high, source: LARGEST_RATE, ..row });
    }

    fn plan_wide_limits(&mut self, member: usize, link: &Link) {
        for i in 0..self.wide.len() {
            let limit = self.wide[i];
            if limit.member as usize != member {
                continue;
            }
            let is_angle = is_zero(limit.force);
            // A ball joint itself holds its pivots together.
            if !is_angle && link.sliding == 0 {
                continue;
            }
            let most = if is_angle { self.bounds.return_rate } else { self.bounds.return_speed };
            let (WideRow { low, high, force, torque, member, .. }, row) =
                (limit, Row::limit(link.coordinate(), is_angle));
            let correction = limit.correction.clamp(-most, most);
            self.planned.push(Row { low, high, correction, member, force, torque, ..row });
        }
    }

    /// Plans the rows of limits, after the free motion over the sub-step of h s to the rates `free` under the forces of motors.
    pub(super) fn plan_limits(
        &mut self,
        at: At<'_, '_>,
        links: &[Link],
        springs: &[Spring<f64>],
        joints: &[Joint],
        free: &Rate<'_, f64>,
        h: f64,
    ) {
        for (i, (link, joint)) in links.iter().zip(joints).enumerate() {
            self.plan_wide_limits(i + 1, link);
            if link.freedoms() != 1 {
                continue;
            }
            let (k, is_hinge) = (link.coordinate(), joint.is_hinge);
            self.plan_largest_rate(free, k, joint);
            let bounce = if is_hinge { HINGE_BOUNCE } else { 0.0 };
            self.plan_limit(at, free, k, [joint.low, joint.high], is_hinge, bounce, 0.0, h);
        }
        for (i, spring) in springs.iter().enumerate() {
            let driven = if spring.is_stiff { Self::target_of(at, spring, h) } else { 0.0 };
            let (k, limits) = (spring.coordinate(), self.spring_limits[i]);
            self.plan_limit(at, free, k, limits, spring.is_angle, 0.0, driven, h);
        }
    }

    /// Writes the rates that the fed-forward impulses of limits give at the old position, and returns false if there are none. Rows have the
    /// whole impulses and act on the motion without these. The inertia is factored.
    pub(super) fn rates_by_limits(&mut self, coupled: &Coupled<'_>, fed: &mut Rate<'_, f64>) -> bool {
        if !self.feeds_limits {
            return false;
        }
        self.fed_velocity[..6].fill(0.0);
        self.fed_velocity[6..].copy_from_slice(self.limit_feedforward);
        coupled.normalise(self.fed_velocity);
        coupled.rates_of(self.fed_velocity, fed);
        true
    }

    /// Whether a limit had an impulse.
    pub fn hit_limit(&self) -> bool {
        self.planned.iter().any(|row| {
            // An impulse that was fed forward held the joint during the free motion, too.
            row.source == LIMIT
                && row.impulse != 0.0
                && (row.member > 0 || self.held_by_limits[row.coordinate()] == 0.0)
        })
    }

    /// Whether a limit stopped a sliding coordinate of a link, by the index of its body.
    pub(super) fn hit_sliding_limit(&self, member: usize, link: &Link) -> bool {
        self.planned.iter().any(|row| {
            let is_of_it = match row.member {
                0 => (0..link.sliding).contains(&(row.coordinate - link.coordinate)),
                of => of as usize == member,
            };
            row.source == LIMIT && !row.is_angle && row.impulse != 0.0 && is_of_it
        })
    }

    /// Impulse of a stiff spring, N·m·s or N·s.
    pub fn spring_impulse(&self, spring: usize) -> f64 {
        let source = (self.coordinates + spring) as i32;
        let row = self.planned.iter().find(|row| row.source == source);
        row.map_or(0.0, |row| row.feedforward + row.impulse)
    }

    /// Writes the rows for z of all that is planned, one after the other, and what they do. `free`: rates of the motion without them. The
    /// inertia is factored.
    pub(super) fn write(&mut self, motion: &Motion<'_, '_, f64>, free: &Rate<'_, f64>, jacobians: &mut [f64]) {
        let (tree, coupled) = (&motion.equations.tree, &motion.equations.coupled);
        for i in 0..self.planned.len() {
            let size = self.coordinates + 6;
            let (row, jacobian) = (&mut self.planned[i], &mut jacobians[i * size..][..size]);
            row.impulse = 0.0;
            row.velocity = 0.0;
            if row.member == 0 {
                jacobian[6 + row.coordinate()] = 1.0;
                row.velocity = free.q[row.coordinate()];
            } else {
                let member = row.member as usize;
                tree.add_jacobian(member, row.force, row.torque, true, jacobian);
                let link = &tree.links[member - 1];
                for k in link.coordinate()..link.coordinate() + link.freedoms() {
                    row.velocity += jacobian[6 + k] * free.q[k];
                }
            }
            coupled.normalise(jacobian);
            row.response = jacobian.iter().fold(0.0, |sum, part| sum + part * part);
        }
        // A stiff spring or controller on the coordinate of a limit reduces its response, and the limit must hold it, too.
        for i in 0..self.planned.len() {
            let row = self.planned[i];
            let mut softest = row.response;
            if row.source < 0 && row.member == 0 {
                let drives =
                    self.planned.iter().filter(|drive| drive.coordinate == row.coordinate && drive.softness > 0.0);
                softest = drives.fold(softest, |softest, drive| softest.or_smaller(drive.softness));
            }
            self.planned[i].softest = softest;
        }
    }

    /// Work of drives, or of the fed-forward forces of rows over the motion from a position and rates to those that there are now, J. Where
    /// poses are ahead of velocities by `pose_lead` s, it is that of the rates.
    pub(super) fn works(&self, drives: &[Drive], from: At<'_, '_>, to: At<'_, '_>, pose_lead: f64) -> Works {
        let mut works = Works::default();
        for (i, row) in self.planned.iter().enumerate() {
            let k = row.coordinate();
            let work = if self.are_drives {
                drives[i].work()
            } else {
                let way = if pose_lead > 0.0 {
                    (from.rate.q[k] + to.rate.q[k]) * pose_lead
                } else {
                    to.position.q[k] - from.position.q[k]
                };
                row.feedforward / self.step * way
            };
            let is_rotor = row.source >= self.rotor_of(0) as i32;
            *(match row.source < 0 {
                true => &mut works.limits,
                false if self.is_motor(row) || is_rotor => &mut works.motors,
                false => &mut works.damping,
            }) += work;
        }
        works
    }

    /// Finds displacements `back`, rad or m, by which coordinates return that passed their limits in a step of h s with drives, and by a
    /// share of what they were beyond them before. Returns whether there are any.
    pub(super) fn way_to_limits(
        &self,
        h: f64,
        drives: &[Drive],
        [from, to]: [&Position<'_, f64>; 2],
        back: &mut [f64],
    ) -> bool {
        let mut found = false;
        for drive in drives.iter().filter(|drive| drive.is_limit()) {
            let k = drive.coordinate();
            let most = if drive.is_angle() { self.bounds.return_rate } else { self.bounds.return_speed } * h;
            let Some(way) = drive.way_back(to.q[k] - from.q[k], self.bounds.limit_erp, most) else { continue };
            if !found {
                back.fill(0.0);
            }
            found = true;
            back[k] = way;
        }
        found
    }
}

fn is_zero(v: Vector<f64>) -> bool {
    super::energy::is_zero(v, 0)
}
