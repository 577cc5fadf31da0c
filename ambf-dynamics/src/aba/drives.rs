//! Motors, stiff springs and limits of the coordinates of a tree as parts of its equations of motion.
//!
//! A drive that gives the rate v' = target - c x at the end of a step of h s by its impulse x has, at any instant of the step, the
//! force f = (target - v0 - h a) / (c h), where v0 is the rate at the beginning and a the acceleration at that instant. That is linear
//! in a: 1 / c is added to the articulated inertia D of the coordinate, and (target - v0) / (c h) to the force on it. With the weights
//! of any Runge-Kutta method the mean of f is x / h, so that the step ends with v' exactly and keeps the order of the method. A rigid
//! drive (c = 0) prescribes the acceleration (target - v0) / h, as in Featherstone's hybrid dynamics (Rigid Body Dynamics Algorithms,
//! 2008, section 9.2).

use super::list::List;
use super::rows::Row;
use super::scalar::Scalar;
use super::{Driven, Rate};

/// What Bullet takes for infinite.
pub const INFINITE: f64 = 1e30;
/// Share of a rate or impulse that counts as rounding.
const ROUNDING: f64 = 1e-9;

/// What bounds a drive.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DriveState {
    /// Nothing.
    Free,
    /// Its impulse is the lower bound.
    Low,
    /// Its impulse is the upper bound.
    High,
}

/// A motor, a stiff spring or a limit of a coordinate, which acts over the whole step: with the impulse x in it, N·m·s or N·s, the rate
/// at its end is target - softness x, or x is one of its bounds.
#[derive(Debug, Clone, Copy)]
pub struct Drive {
    coordinate: i32,
    /// rad/s or m/s.
    target: f64,
    /// Change of rate per impulse; 0: rigid.
    softness: f64,
    /// Bounds of the impulse.
    low: f64,
    high: f64,
    is_limit: bool,
    /// Limit: 1 where it bounds the coordinate from below, -1 from above; 0 where it holds it. Else 0.
    side: f64,
    /// Limit: distance at the beginning of the step, rad or m, negative if it is violated; of a bound of the rate it is infinite.
    gap: f64,
    is_angle: bool,
    state: DriveState,
    /// At the beginning of the step.
    start_state: DriveState,
    /// At the last evaluation; and mean over the step, with its work, J.
    impulse: f64,
    mean_impulse: f64,
    work: f64,
}

/// Limits of a coordinate and bounds of its rate that the step will not reach unless a rate more than doubles; infinite: none.
#[derive(Debug, Clone, Copy)]
pub struct DistantLimits {
    pub(super) coordinate: i32,
    pub(super) is_angle: bool,
    /// Distances from the lower and the upper limit, rad or m.
    pub(super) below: f64,
    pub(super) above: f64,
    /// Bounds of the rate in either direction, rad/s or m/s, positive.
    pub(super) backward: f64,
    pub(super) forward: f64,
}

impl DistantLimits {
    /// Those of a coordinate that has none.
    pub(super) fn none(coordinate: usize, is_angle: bool) -> Self {
        let (coordinate, none) = (coordinate as i32, INFINITE);
        Self { coordinate, is_angle, below: none, above: none, backward: none, forward: none }
    }

    /// Whether there are some.
    pub(super) fn any(&self) -> bool {
        [self.below, self.above, self.backward, self.forward].into_iter().any(|limit| limit < INFINITE)
    }
}

impl Drive {
    /// A motor or spring.
    pub(super) fn new(coordinate: usize, is_angle: bool, target: f64, softness: f64, low: f64, high: f64) -> Self {
        Self {
            coordinate: coordinate as i32,
            target,
            softness,
            low,
            high,
            is_limit: false,
            side: 0.0,
            gap: 0.0,
            is_angle,
            state: DriveState::Free,
            start_state: DriveState::Free,
            impulse: 0.0,
            mean_impulse: 0.0,
            work: 0.0,
        }
    }

    /// The drive that keeps a rate above (side 1) or below (-1) the target where it has to; see [`gap`](Self::gap).
    pub(super) fn limit(distant: &DistantLimits, side: f64, target: f64, gap: f64) -> Self {
        let is_below = side > 0.0;
        let (low, high) = if is_below { (0.0, INFINITE) } else { (-INFINITE, 0.0) };
        let drive = Self::new(distant.coordinate as usize, distant.is_angle, target, 0.0, low, high);
        Self { is_limit: true, side, gap, state: Self::planned_state_of(side), ..drive }
    }

    /// The limit that holds a coordinate, which is `gap` rad or m beside it.
    pub(super) fn lock(distant: &DistantLimits, gap: f64) -> Self {
        let drive = Self::new(distant.coordinate as usize, distant.is_angle, 0.0, 0.0, -INFINITE, INFINITE);
        Self { is_limit: true, gap, ..drive }
    }

    /// A motor of at most this impulse either way.
    #[cfg(test)]
    pub(super) fn motor(coordinate: usize, target: f64, softness: f64, most: f64) -> Self {
        Self::new(coordinate, true, target, softness, -most, most)
    }

    /// Mean impulse in the step, and what bounded it.
    #[cfg(test)]
    pub(super) fn mean(&self) -> (f64, DriveState) {
        (self.mean_impulse, self.state)
    }

    /// Mean impulse in the step.
    pub(super) fn mean_impulse(&self) -> f64 {
        self.mean_impulse
    }

    /// As a row of the same coordinate, target and bounds, of a limit.
    pub(super) fn row(&self) -> Row {
        let &Self { target, softness, low, high, is_angle, .. } = self;
        Row { target, softness, low, high, ..Row::limit(self.coordinate(), is_angle) }
    }

    /// Whether it is a limit of a coordinate or its rate.
    pub(super) fn is_limit(&self) -> bool {
        self.is_limit
    }

    /// Whether its coordinate is an angle.
    pub(super) fn is_angle(&self) -> bool {
        self.is_angle
    }

    /// By how much the coordinate of a limit is to return, rad or m, after a step with a displacement `way`: by a share `erp` of a violation
    /// that there was before, and by at most `most`. Nothing if the limit is not violated.
    pub(super) fn way_back(&self, way: f64, erp: f64, most: f64) -> Option<f64> {
        let holds = self.side == 0.0;
        let side = if holds { 1.0 } else { self.side };
        let gap = self.gap + side * way;
        if if holds { gap == 0.0 } else { gap >= 0.0 } {
            return None;
        }
        // A limit that was violated before is returned to at a bounded speed.
        Some(side * if self.gap < 0.0 || holds { (-gap * erp).clamp(-most, most) } else { -gap })
    }

    pub(super) fn coordinate(&self) -> usize {
        self.coordinate as usize
    }

    fn is_rigid(&self) -> bool {
        self.softness <= 0.0
    }

    fn is_free(&self) -> bool {
        self.state == DriveState::Free
    }

    fn bound(&self) -> f64 {
        if self.state == DriveState::Low {
            self.low
        } else {
            self.high
        }
    }

    /// Whether it bounds the rate, not the coordinate.
    pub(super) fn bounds_rate(&self) -> bool {
        self.gap >= INFINITE
    }

    /// Whether a limit is passed with a rate that leads on, after a step with a displacement `way` and the rate `speed` at its end.
    fn is_passed(&self, way: f64, speed: f64) -> bool {
        let is_reached = self.bounds_rate() || self.gap + self.side * way < 0.0;
        is_reached && self.side * (speed - self.target) < 0.0
    }

    /// State with which the search begins: limits do not hold.
    fn planned_state(&self) -> DriveState {
        Self::planned_state_of(self.side)
    }

    fn planned_state_of(side: f64) -> DriveState {
        match side {
            side if side > 0.0 => DriveState::Low,
            side if side < 0.0 => DriveState::High,
            _ => DriveState::Free,
        }
    }

    /// Work of the drives in the step, J.
    pub(super) fn work(&self) -> f64 {
        self.work
    }

    /// Whether the force is one that has a measure.
    pub(super) fn is_measured(&self) -> bool {
        self.impulse.abs() < INFINITE
    }
}

/// The drives of a world.
#[derive(Default)]
pub(super) struct World<'a> {
    pub drives: List<'a, Drive>,
    /// Where the step reaches one of these, it is added to the drives and the step made again.
    pub distant: List<'a, DistantLimits>,
    /// What drives do to each coordinate, and which one prescribes its acceleration; -1: none.
    pub driven: &'a mut [Driven<f64>],
    pub given_by: &'a mut [i32],
    pub rest: &'a mut [f64],
    /// Steps until the mode of vibration is estimated again; it is not known before the first time.
    pub steps_until_probe: i32,
    pub has_mode: bool,
}

/// Rates and forces of a world at an instant of a step of h s.
pub(super) struct Instant<'a, S: Scalar> {
    pub world: usize,
    pub h: f64,
    /// Rates at the beginning of the step.
    pub start: &'a Rate<'a, S>,
    pub acceleration: &'a Rate<'a, S>,
    pub driven: &'a [Driven<S>],
}

impl<S: Scalar> Instant<'_, S> {
    #[inline(always)]
    fn start(&self, k: usize) -> f64 {
        self.start.q[k].of(self.world)
    }

    #[inline(always)]
    fn change(&self, k: usize) -> f64 {
        self.h * self.acceleration.q[k].of(self.world)
    }

    #[inline(always)]
    fn force(&self, k: usize) -> f64 {
        self.driven[k].force.of(self.world)
    }
}

impl World<'_> {
    /// States with which the search begins.
    pub fn plan(&mut self) {
        self.drives.iter_mut().for_each(|drive| drive.state = drive.planned_state());
    }

    /// Sets what the drives in their present states add to the equations of motion.
    #[inline(always)]
    pub fn load<S: Scalar>(&mut self, h: f64, start: &Rate<'_, S>, world: usize) {
        self.driven.fill(Driven { inertia: 0.0, pull: 0.0, is_given: 0.0, given: 0.0, force: 0.0 });
        self.given_by.fill(-1);
        let drives = &*self.drives;
        for (i, drive) in drives.iter().enumerate().filter(|(_, drive)| drive.is_free()) {
            let k = drive.coordinate();
            if !drive.is_rigid() {
                self.driven[k].inertia += 1.0 / drive.softness;
                self.driven[k].pull += (drive.target - start.q[k].of(world)) / (drive.softness * h);
                continue;
            }
            // Where several rigid drives act, a motor that leads away from a limit overrules it, and a limit any other motor. A joint
            // whose limits are equal does not move.
            let is_locked = drive.is_limit && drive.side == 0.0;
            let prevails = match usize::try_from(self.given_by[k]).map(|other| &drives[other]) {
                Err(_) => true,
                Ok(other) => {
                    is_locked
                        || (drive.is_limit && (other.target - drive.target) * drive.side < 0.0)
                        || (!drive.is_limit
                            && other.is_limit
                            && other.side != 0.0
                            && (drive.target - other.target) * other.side >= 0.0)
                }
            };
            if prevails {
                self.given_by[k] = i as i32;
            }
        }
        for (k, (driven, given)) in self.driven.iter_mut().zip(&*self.given_by).enumerate() {
            if let Ok(given) = usize::try_from(*given) {
                driven.is_given = 1.0;
                driven.given = (drives[given].target - start.q[k].of(world)) / h;
            }
        }
    }

    /// Adds the forces of the drives that are at a bound.
    #[inline(always)]
    pub fn add_bounds<S: Scalar>(&self, h: f64, efforts: &mut [S], world: usize) {
        for drive in self.drives.iter().filter(|drive| !drive.is_free()) {
            efforts[drive.coordinate()].add_in(world, drive.bound() / h);
        }
    }

    /// Finds the impulses that the drives would have if the last evaluation held over the whole step.
    #[inline(always)]
    pub fn measure<S: Scalar>(&mut self, at: &Instant<'_, S>) {
        for (k, rest) in self.rest.iter_mut().enumerate() {
            *rest = at.force(k) * at.h;
        }
        let drives = &mut *self.drives;
        for drive in drives.iter_mut().filter(|drive| !(drive.is_free() && drive.is_rigid())) {
            let k = drive.coordinate();
            if drive.is_free() {
                drive.impulse = (drive.target - at.start(k) - at.change(k)) / drive.softness;
                self.rest[k] -= drive.impulse;
            } else {
                drive.impulse = drive.bound();
            }
        }
        // What holds a coordinate at its limit is the motor that presses it there, as far as it has to, and else the limit.
        for of_limits in [false, true] {
            for i in 0..drives.len() {
                let drive = drives[i];
                if !drive.is_free() || !drive.is_rigid() || drive.is_limit != of_limits {
                    continue;
                }
                let (k, mut bounds) = (drive.coordinate(), [-INFINITE, INFINITE]);
                let given = self.given_by[k] as usize;
                if given != i {
                    let holder = drives[given];
                    let is_locked = holder.is_limit && holder.side == 0.0;
                    let helps = !of_limits && !is_locked;
                    bounds = [
                        if helps && holder.side >= 0.0 { drive.low } else { 0.0 },
                        if helps && holder.side <= 0.0 { drive.high } else { 0.0 },
                    ];
                }
                drives[i].impulse = self.rest[k].or_larger(bounds[0]).or_smaller(bounds[1]);
                self.rest[k] -= drives[i].impulse;
            }
        }
    }

    /// Drives that would have to be stronger than they are get the largest impulse they have; that of a limit is one of forces without
    /// measure. Returns whether one did.
    pub fn saturate(&mut self) -> bool {
        let mut changed = false;
        for drive in &mut *self.drives {
            // Which limits hold is known since the beginning of the step.
            if !drive.is_free() || drive.side * drive.impulse < 0.0 {
                continue;
            }
            let slack = ROUNDING * drive.impulse.abs();
            if drive.impulse > drive.high + slack {
                drive.state = DriveState::High;
            } else if drive.impulse < drive.low - slack {
                drive.state = DriveState::Low;
            } else {
                continue;
            }
            changed = true;
        }
        changed
    }

    /// Changes the states of drives that the last evaluation contradicts, or that of the first of them. Returns whether there was one.
    #[inline(always)]
    pub fn pivot<S: Scalar>(&mut self, at: &Instant<'_, S>, one_only: bool) -> bool {
        let mut changed = false;
        for i in 0..self.drives.len() {
            if changed && one_only {
                break;
            }
            let drive = self.drives[i];
            let k = drive.coordinate();
            let (start, change) = (at.start(k), at.change(k));
            let speed = start + change;
            let rounding = ROUNDING * (drive.target.abs() + start.abs() + change.abs());
            let given = self.given_by[k];
            let mut state = drive.state;
            if drive.is_limit && drive.side == 0.0 {
                continue;
            }
            if drive.is_limit {
                if !drive.is_free() {
                    if drive.side * (speed - drive.target) < -rounding {
                        state = DriveState::Free;
                    }
                } else if if given == i as i32 {
                    drive.side * drive.impulse < -ROUNDING * (at.force(k) * at.h).abs()
                } else {
                    drive.side * (speed - drive.target) > rounding
                } {
                    state = drive.planned_state();
                }
            } else if drive.is_free() {
                let (slack, missed) = (ROUNDING * drive.impulse.abs(), drive.target - speed);
                // Friction that a motor overcomes acts in full.
                let is_overruled = drive.is_rigid() && given != i as i32 && !self.drives[given as usize].is_limit;
                if drive.impulse > drive.high + slack || (is_overruled && missed > rounding) {
                    state = DriveState::High;
                }
                if drive.impulse < drive.low - slack || (is_overruled && missed < -rounding) {
                    state = DriveState::Low;
                }
            } else {
                let asked = drive.target - speed - drive.softness * drive.bound();
                if if drive.state == DriveState::High { asked < -rounding } else { asked > rounding } {
                    state = DriveState::Free;
                }
            }
            changed = changed || drive.state != state;
            self.drives[i].state = state;
        }
        changed
    }

    pub fn keep_start(&mut self) {
        self.drives.iter_mut().for_each(|drive| drive.start_state = drive.state);
    }

    pub fn return_to_start(&mut self) {
        self.drives.iter_mut().for_each(|drive| drive.state = drive.start_state);
    }

    pub fn begin_sums(&mut self) {
        self.drives.iter_mut().for_each(|drive| (drive.mean_impulse, drive.work) = (0.0, 0.0));
    }

    /// Adds `time` s of the step with the forces of the last evaluation, at the rates there.
    #[inline(always)]
    pub fn add_sums<S: Scalar>(&mut self, share: f64, rate: &Rate<'_, S>, world: usize) {
        for drive in &mut *self.drives {
            let impulse = drive.impulse * share;
            drive.mean_impulse += impulse;
            drive.work += impulse * rate.q[drive.coordinate()].of(world);
        }
    }

    /// Whether drives determine the acceleration of a coordinate.
    pub fn is_driven(&self, coordinate: usize) -> bool {
        self.given_by[coordinate] >= 0 || self.driven[coordinate].inertia > 0.0
    }

    /// Lets limits act that the step passes and leaves with a rate that leads on, although the accelerations at its beginning did not:
    /// those that are no drives yet are added. `way` and `speed` are those of a coordinate. Returns whether there are such limits; where
    /// `looks_only`, that is all.
    #[inline(always)]
    pub fn catch_limits(
        &mut self,
        h: f64,
        looks_only: bool,
        way: impl Fn(usize) -> f64,
        speed: impl Fn(usize) -> f64,
    ) -> bool {
        let mut caught = false;
        for drive in &mut *self.drives {
            let k = drive.coordinate();
            if drive.side != 0.0 && !drive.is_free() && drive.gap >= 0.0 && drive.is_passed(way(k), speed(k)) {
                caught = true;
                if !looks_only {
                    drive.start_state = DriveState::Free;
                }
            }
        }
        for limits in &*self.distant {
            let k = limits.coordinate as usize;
            let (way, speed) = (way(k), speed(k));
            let passed = [
                (speed < -limits.backward, 1.0, -limits.backward, INFINITE),
                (speed > limits.forward, -1.0, -limits.forward, INFINITE),
                (limits.below + way < 0.0, 1.0, -limits.below / h, limits.below),
                (limits.above - way < 0.0, -1.0, -limits.above / h, limits.above),
            ];
            for (is_reached, side, target, gap) in passed {
                if !is_reached {
                    continue;
                }
                let drive = Drive::limit(limits, side, side * target, gap);
                if drive.is_passed(way, speed) {
                    caught = true;
                    if !looks_only {
                        self.drives.push(drive);
                    }
                }
            }
        }
        caught
    }
}
