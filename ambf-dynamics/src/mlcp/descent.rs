//! Impulses within fixed bounds, by Newton's method with an exact line search, and the bounds of friction by turns with it
//! (staggered projections; Kaufman, Sueda, James and Pai, *ACM Transactions on Graphics* 27, 2008).
//!
//! Within fixed bounds the velocities that the impulses give minimise a convex function, the sum of kinetic energy and a
//! potential for each row whose force is the impulse:
//!
//! ```text
//! F(v) = vᵀ M v / 2 + Σ ∫ clamp(s / cfm, low, high) ds up to s = target − J v
//! ```
//!
//! It is quadratic where no impulse passes one of its bounds, and a Newton step leads to the velocities that go with
//! an active set (one iteration of block principal pivoting). Where `F` would grow, only a part of the step is taken, to the
//! minimum on the way, so that the iteration cannot cycle, and ends (Sun, *Applied Mathematics and Optimization* 36, 1997).

use super::iterate::Variable;
use super::pivot::Progress;
use super::problem::State;
use super::solver::Solver;

/// Most turns; where more are needed, friction has no solution.
const MAX_TURNS: u32 = 20;
/// Iterations for which the number of wrong rows need not fall before steps are bounded.
const PATIENCE: i32 = 3;
/// Most bounded iterations.
const MAX_ROUNDS: u32 = 100;
/// Share of the slope at the beginning of a step that may be left at its end.
const FLAT: f64 = 1e-3;
/// Most evaluations of the slope in a step.
const MAX_EVALUATIONS: u32 = 60;
/// Least CFM of a row, as a share of the diagonal.
const MIN_CFM: f64 = 1e-12;

/// One row on the way to a minimum.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Way {
    /// Impulse whose velocities these are, also outside of its bounds, N·s or N·m·s.
    x: f64,
    /// `J v`, m/s or rad/s.
    along: f64,
    /// Change of both in a whole step.
    impulse_change: f64,
    change: f64,
}

/// Bound of one row of friction in the turn before, N·s or N·m·s: with which impulses were found, the one that follows from
/// them, and the difference.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct BoundStep {
    used: f64,
    found: f64,
    change: f64,
}

/// Derivative of the row's potential by its velocity error: the impulse, N·s or N·m·s.
fn force(row: &Variable, along: f64) -> f64 {
    row.clamp((row.target - along) / row.cfm.max(MIN_CFM * row.diagonal))
}

impl Solver {
    /// Alternates between impulses and bounds of friction, from the impulses and the active set at hand. The result replaces
    /// all that were recorded before.
    pub(super) fn alternate(&mut self, limit: f64) {
        self.best.forget();
        for turn in 0..MAX_TURNS {
            self.accelerate_bounds(turn);
            self.best.is_current = false;
            let is_solved = self.descend(limit);
            self.iterate.bound_frictions();
            if !is_solved {
                // The turns before have a result.
                if turn == 0 {
                    self.record_part();
                }
                return;
            }
            // The bounds alone converge linearly.
            if self.record_current(true) <= self.accepted || self.newton(limit) {
                return;
            }
        }
        self.best.is_current = false;
    }

    /// Sets the bounds of friction: those of the normal impulses, and from the third turn on the mean of those of two turns whose
    /// weights would leave the least change if it were linear (Anderson's acceleration; Walker and Ni, *SIAM Journal on
    /// Numerical Analysis* 49, 2011). Those of the normal impulses alone lead to cycles where friction lowers these.
    fn accelerate_bounds(&mut self, turn: u32) {
        let Self { iterate, bound_steps, .. } = self;
        iterate.bound_frictions();
        if turn == 0 {
            bound_steps.clear();
            bound_steps
                .extend(iterate.variables.iter().map(|row| BoundStep { used: row.high, ..BoundStep::default() }));
            return;
        }
        let (mut along, mut square) = (0.0, 0.0);
        for (row, step) in iterate.variables.iter().zip(&*bound_steps).filter(|(row, _)| row.is_friction()) {
            let change = row.high - step.used;
            let difference = (change - step.change) * row.diagonal * row.diagonal;
            along += change * difference;
            square += (change - step.change) * difference;
        }
        let share: f64 = if turn > 1 && square > 0.0 { (along / square).clamp(0.0, 1.0) } else { 0.0 };
        for (row, step) in iterate.variables.iter_mut().zip(bound_steps).filter(|(row, _)| row.is_friction()) {
            let found = row.high;
            row.bound_by(found - share * (found - step.found));
            *step = BoundStep { used: row.high, found, change: found - step.used };
        }
    }

    /// Minimises `F` from the active set at hand. Returns whether the minimum is reached.
    fn descend(&mut self, limit: f64) -> bool {
        let mut progress = Progress::new(PATIENCE);
        loop {
            if !self.factorise(limit) {
                return false;
            }
            self.apply_free_impulses();
            let wrong = self.update_active_set();
            if wrong == 0 {
                return true;
            }
            if !progress.made(wrong, PATIENCE) {
                break;
            }
        }
        self.ways.clear();
        for row in &self.iterate.variables {
            let along = self.iterate.row_velocity(&self.rows, row);
            self.ways.push(Way { x: row.x, along, ..Way::default() });
        }
        self.set_forces();
        for _ in 0..MAX_ROUNDS {
            if !self.factorise(limit) {
                self.take_way();
                return false;
            }
            self.apply_free_impulses();
            let wrong = if self.step() { self.update_active_set() } else { self.set_forces() };
            if wrong == 0 {
                return true;
            }
        }
        self.take_way();
        false
    }

    /// Goes to the impulses at hand as far as `F` falls. Returns whether that is the whole way.
    fn step(&mut self) -> bool {
        let Self { ways, iterate, rows, layout, statistics, .. } = self;
        statistics.multiplications += layout.pass_cost;
        // Kinetic energy along the step: e + t f + t² g / 2.
        let (mut linear, mut square) = (0.0, 0.0);
        for (row, way) in iterate.variables.iter().zip(&mut *ways) {
            way.change = iterate.row_velocity(rows, row) - way.along;
            way.impulse_change = row.x - way.x;
            linear += way.impulse_change * way.along;
            square += way.impulse_change * way.change;
        }
        let slope = |ways: &[Way], t: f64| {
            let forces: f64 = iterate
                .variables
                .iter()
                .zip(ways)
                .filter(|(row, _)| row.diagonal > 0.0)
                .map(|(row, way)| force(row, way.along + t * way.change) * way.change)
                .sum();
            linear + t * square - forces
        };
        let first = slope(ways, 0.0);
        let last = slope(ways, 1.0);
        let mut t = 1.0;
        if first < 0.0 && last > FLAT * -first {
            // False position (Illinois).
            let (mut low, mut high) = ((0.0, first), (1.0, last));
            let mut side = 0;
            for _ in 0..MAX_EVALUATIONS {
                t = (low.0 * high.1 - high.0 * low.1) / (high.1 - low.1);
                let value = slope(ways, t);
                if value.abs() <= FLAT * -first {
                    break;
                }
                if value < 0.0 {
                    low = (t, value);
                    if side == -1 {
                        high.1 /= 2.0;
                    }
                    side = -1;
                } else {
                    high = (t, value);
                    if side == 1 {
                        low.1 /= 2.0;
                    }
                    side = 1;
                }
            }
        }
        for way in &mut *ways {
            way.x += t * way.impulse_change;
            way.along += t * way.change;
        }
        t == 1.0
    }

    /// Sets the active set to that of the velocities on the way. Returns how many rows change.
    fn set_forces(&mut self) -> u32 {
        let mut wrong = 0;
        for (row, way) in self.iterate.variables.iter_mut().zip(&self.ways).filter(|(row, _)| row.diagonal > 0.0) {
            let x = force(row, way.along);
            let state = if x <= row.low {
                State::Low
            } else if x >= row.high {
                State::High
            } else {
                State::Free
            };
            wrong += u32::from(state != row.state);
            row.state = state;
        }
        self.statistics.pivots += wrong;
        wrong
    }

    /// Takes the impulses that the way has reached.
    fn take_way(&mut self) {
        for (row, way) in self.iterate.variables.iter_mut().zip(&self.ways) {
            row.x = way.x;
        }
    }

    /// Records what the iteration has reached within its budget: impulses that add no energy and open no joint.
    fn record_part(&mut self) -> f64 {
        self.iterate.clamp();
        self.iterate.accumulate(&self.rows);
        self.iterate.scale_down(&self.rows);
        self.iterate.bound_frictions();
        self.iterate.accumulate(&self.rows);
        self.statistics.multiplications += 3.0 * self.layout.pass_cost;
        self.close_joints();
        self.record_current(false)
    }

    /// Solves the unbounded rows (joints, springs) exactly for the impulses that all other rows have. This lowers the
    /// objective. One factorisation is made beyond the budget.
    fn close_joints(&mut self) {
        // Without a factorisation before there is no room for one.
        if self.statistics.factorisations == 0 {
            return;
        }
        for row in &mut self.iterate.variables {
            row.state = if row.is_unbounded() { State::Free } else { row.state_of_x() };
        }
        let bounds = |row: &Variable| (row.low, row.high);
        self.bounds.clear();
        self.bounds.extend(self.iterate.variables.iter().map(bounds));
        for row in self.iterate.variables.iter_mut().filter(|row| !row.is_unbounded()) {
            (row.low, row.high, row.state) = (row.x, row.x, State::Low);
        }
        if self.factorise(f64::INFINITY) {
            self.apply_free_impulses();
        }
        for (row, &(low, high)) in self.iterate.variables.iter_mut().zip(&self.bounds) {
            (row.low, row.high) = (low, high);
        }
        self.set_states();
    }
}
