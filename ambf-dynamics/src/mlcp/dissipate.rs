//! Approximations that add no energy and open no joint.
//!
//! Within fixed bounds that contain 0 the objective `xᵀ (A + cfm) x / 2 - targetᵀ x` has a least value of at most 0,
//! and what gets there by descent never gains energy. The bounds of friction are not fixed, but its impulses can be
//! left out, and then added with normal impulses that stay: two problems with fixed bounds.

use super::iterate::Variable;
use super::solver::Solver;

/// Sweeps for either problem where it is not solved directly: at least, where the best approximation gains energy, and
/// at most.
const MIN_SWEEPS: u32 = 4;
const MAX_SWEEPS: u32 = 10;
/// Most factorisations for either.
const MAX_ROUNDS: u32 = 10;
/// Most solutions for given friction, and factorisations of each.
const MAX_HOLDS: u32 = 3;
const MAX_HOLD_ROUNDS: u32 = 200;

impl Solver {
    /// Looks for impulses of a lower objective than the best approximation, which is at hand, has. A few sweeps are
    /// made beyond the budget where that gains energy.
    pub(super) fn dissipate(&mut self, budget: f64) {
        let gains_energy = self.best_objective() > 0.0;
        let has_friction = self.iterate.variables.iter().any(|row| row.is_friction());
        if !gains_energy && (!has_friction || self.statistics.multiplications + 2.0 * self.sweep_cost() > budget) {
            return;
        }
        let sweeps = if gains_energy { MIN_SWEEPS } else { 0 };
        self.solve_without_friction(sweeps, budget);
        self.add_friction(sweeps, budget);
        self.record();
    }

    /// Solves all rows but those of friction exactly for the friction that the best approximation, which is at hand,
    /// has: where friction has no solution, or none is found, what is missed shall be friction, and not a joint, a limit
    /// or a contact. Friction that exceeds its bounds for the new normal impulses is lowered to them a few times. These
    /// problems have fixed bounds, and thus solutions; the objective does not grow. Returns whether the best approximation is
    /// now such a solution.
    pub(super) fn hold_friction(&mut self, limit: f64) -> bool {
        // Without a factorisation before there is no room for one.
        if self.statistics.factorisations == 0 {
            return false;
        }
        let mut objective = self.best_objective().max(0.0);
        let tolerance = std::mem::replace(&mut self.tolerance, self.accepted);
        self.save_impulses();
        let mut is_held = false;
        for _ in 0..MAX_HOLDS {
            let is_solved = self.solve_for_friction(limit);
            let now = self.iterate.energy(&self.rows);
            // Not `>`, which is false for what is not a number.
            if !(is_solved && now <= objective) {
                self.restore_impulses();
                break;
            }
            (objective, is_held) = (now, true);
            self.save_impulses();
            if !self.lower_frictions() {
                break;
            }
        }
        self.restore_impulses();
        self.iterate.bound_frictions();
        self.tolerance = tolerance;
        if is_held {
            self.keep_current();
        }
        is_held
    }

    /// Solves the problem within fixed bounds, from the saved impulses.
    fn solve_within_bounds(&mut self, limit: f64) -> bool {
        self.set_states();
        let mut rounds = MAX_HOLD_ROUNDS;
        if self.block_pivot(&mut rounds, limit) {
            return true;
        }
        for (row, &x) in self.iterate.variables.iter_mut().zip(&self.saved) {
            row.x = row.clamp(x);
        }
        self.primal_active_set(&mut rounds, limit)
    }

    /// Solves all other rows for the impulses that friction has, from the saved impulses, and finds the velocities.
    fn solve_for_friction(&mut self, limit: f64) -> bool {
        for row in self.iterate.variables.iter_mut().filter(|row| row.is_friction()) {
            (row.low, row.high) = (row.x, row.x);
        }
        let is_solved = self.solve_within_bounds(limit);
        self.iterate.variables.iter_mut().for_each(|row| row.x = row.clamp(row.x));
        self.iterate.accumulate(&self.rows);
        is_solved
    }

    /// Brings friction within the bounds that the normal impulses give. Returns whether it exceeded them.
    fn lower_frictions(&mut self) -> bool {
        self.iterate.bound_frictions();
        let mut exceeded = false;
        for row in self.iterate.variables.iter_mut().filter(|row| row.is_friction()) {
            let x = row.clamp(row.x);
            exceeded |= x != row.x;
            row.x = x;
        }
        exceeded
    }

    fn save_impulses(&mut self) {
        self.saved.clear();
        self.saved.extend(self.iterate.variables.iter().map(|row| row.x));
    }

    /// Loads the saved impulses, and finds their velocities.
    fn restore_impulses(&mut self) {
        for (row, &x) in self.iterate.variables.iter_mut().zip(&self.saved) {
            row.x = x;
        }
        self.iterate.accumulate(&self.rows);
    }

    /// Solves the unbounded rows (joints, springs) of an approximation exactly for the impulses that all other rows
    /// have: what an approximation misses shall be a limit or a contact, and not open a joint. Where it has missed a
    /// joint, this lowers the objective. One factorisation is made beyond the budget.
    pub(super) fn close_joints(&mut self) {
        let mut joints =
            self.iterate.variables.iter().filter(|row| row.is_unbounded() && row.diagonal > 0.0).peekable();
        // Without a factorisation before there is no room for one.
        if self.statistics.factorisations == 0 || joints.peek().is_none() {
            return;
        }
        self.statistics.multiplications += self.layout.pass_cost;
        let is_missed = |row: &Variable| self.iterate.excess(&self.rows, row).abs() > self.accepted;
        if !joints.any(is_missed) {
            return;
        }
        self.bounds.clear();
        self.bounds.extend(self.iterate.variables.iter().map(|row| (row.low, row.high)));
        for row in self.iterate.variables.iter_mut().filter(|row| !row.is_unbounded()) {
            (row.low, row.high) = (row.x, row.x);
        }
        self.set_states();
        let mut rounds = 1;
        let is_solved = self.block_pivot(&mut rounds, f64::INFINITY);
        for (row, &(low, high)) in self.iterate.variables.iter_mut().zip(&self.bounds) {
            (row.low, row.high) = (low, high);
        }
        self.set_states();
        if is_solved {
            self.record();
        } else {
            self.best.is_current = false;
        }
    }

    fn solve_without_friction(&mut self, sweeps: u32, budget: f64) {
        for row in self.iterate.variables.iter_mut().filter(|row| row.is_friction()) {
            (row.low, row.high, row.x) = (0.0, 0.0, 0.0);
        }
        self.iterate.accumulate(&self.rows);
        self.iterate.scale_down(&self.rows);
        self.iterate.accumulate(&self.rows);
        self.minimise_within_bounds(sweeps, budget);
    }

    /// Friction for the normal impulses at hand.
    fn add_friction(&mut self, sweeps: u32, budget: f64) {
        self.iterate.bound_frictions();
        self.bounds.clear();
        self.bounds.extend(self.iterate.variables.iter().map(|row| (row.low, row.high)));
        for p in 0..self.iterate.variables.len() {
            if let Some(normal) = self.iterate.variables[p].normal() {
                let row = &mut self.iterate.variables[normal];
                (row.low, row.high) = (row.x, row.x);
            }
        }
        self.minimise_within_bounds(sweeps, budget);
        for (row, &(low, high)) in self.iterate.variables.iter_mut().zip(&self.bounds) {
            (row.low, row.high) = (low, high);
        }
        self.set_states();
    }

    /// Lowers the objective within the bounds, from impulses within them, with their velocities.
    fn minimise_within_bounds(&mut self, sweeps: u32, budget: f64) {
        let before = self.iterate.energy(&self.rows);
        self.save_impulses();
        self.set_states();
        let mut rounds = MAX_ROUNDS;
        // Without a factorisation before there is no room for one.
        if self.statistics.factorisations > 0 && self.block_pivot(&mut rounds, budget) {
            self.iterate.variables.iter_mut().for_each(|row| row.x = row.clamp(row.x));
            self.iterate.accumulate(&self.rows);
            if self.iterate.energy(&self.rows) <= before {
                return;
            }
        }
        self.restore_impulses();
        for count in 0..MAX_SWEEPS {
            if count >= sweeps && self.statistics.multiplications + self.sweep_cost() > budget {
                return;
            }
            self.sweep_within_bounds();
        }
    }
}
