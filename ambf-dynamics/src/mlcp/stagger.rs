//! Staggered projections (Kaufman, Sueda, James and Pai, *ACM Transactions on Graphics* 27, 2008): impulses within
//! fixed bounds of friction and those bounds by turns.

use super::pivot::Progress;
use super::problem::State;
use super::solver::{Solver, MAX_PIVOT_ROUNDS, MAX_STAGGER_ROUNDS};

/// Iterations for which the number of wrong rows need not fall before block pivoting within fixed bounds gives up.
const PATIENCE: i32 = 3;
/// Multiplications, of whole factorisations, beyond which there are only as many of them as in block pivoting.
const MAX_STAGGER_WORK: f64 = 1e7;

impl Solver {
    /// Returns whether impulses and bounds of friction go with each other.
    pub(super) fn staggered_projections(&mut self, limit: f64) -> bool {
        // One row at a time is too slow for many.
        let affordable = (MAX_STAGGER_WORK / (self.layout.least_factor_cost() + 1.0)) as u32;
        let mut rounds = affordable.clamp(MAX_PIVOT_ROUNDS, MAX_STAGGER_ROUNDS);
        self.iterate.bound_frictions();
        while rounds > 0 {
            if !self.block_pivot(&mut rounds, limit) && !self.primal_active_set(&mut rounds, limit) {
                return false;
            }
            if self.iterate.bound_frictions() <= self.tolerance {
                return true;
            }
            // The bounds alone converge linearly.
            if self.newton(limit) {
                return true;
            }
        }
        false
    }

    /// One of the factorisations that are left.
    fn next_factor(&mut self, rounds: &mut u32, limit: f64) -> bool {
        if *rounds == 0 || !self.factorise(limit) {
            return false;
        }
        *rounds -= 1;
        true
    }

    /// Block pivoting within fixed bounds, as long as fewer and fewer rows are wrong.
    pub(super) fn block_pivot(&mut self, rounds: &mut u32, limit: f64) -> bool {
        let mut progress = Progress::new(PATIENCE);
        while self.next_factor(rounds, limit) {
            self.apply_free_impulses();
            let wrong = self.update_active_set();
            if wrong == 0 {
                return true;
            }
            if !progress.made(wrong, PATIENCE) {
                return false;
            }
        }
        false
    }

    /// The same problem by a primal active-set method (Nocedal and Wright, *Numerical Optimization*, section 16.5):
    /// from one point within the bounds to a better one, a row at a time, which ends.
    pub(super) fn primal_active_set(&mut self, rounds: &mut u32, limit: f64) -> bool {
        self.set_states();
        for row in &mut self.iterate.variables {
            row.x = row.clamp(row.x);
        }
        while self.next_factor(rounds, limit) {
            self.solve_free();
            if self.step_to_bound() {
                continue;
            }
            self.iterate.accumulate(&self.rows);
            let Some(p) = self.most_violated() else { return true };
            self.iterate.variables[p].state = State::Free;
            self.statistics.pivots += 1;
        }
        false
    }

    /// Moves the free rows towards their unknowns as far as the first bound. Returns whether there was one.
    fn step_to_bound(&mut self) -> bool {
        let Self { factor, iterate, unknowns, .. } = self;
        let (mut step, mut stopped) = (1.0, None);
        for (&p, &unknown) in factor.places().iter().zip(&*unknowns) {
            let row = &iterate.variables[p as usize];
            let way = unknown - row.x;
            let (bound, state) = if way > 0.0 { (row.high, State::High) } else { (row.low, State::Low) };
            let room = bound - row.x;
            if way.abs() > room.abs() && room / way < step {
                step = room / way;
                stopped = Some((p as usize, bound, state));
            }
        }
        for (&p, &unknown) in factor.places().iter().zip(&*unknowns) {
            let row = &mut iterate.variables[p as usize];
            row.x += step * (unknown - row.x);
        }
        if let Some((p, bound, state)) = stopped {
            let row = &mut iterate.variables[p];
            (row.x, row.state) = (bound, state);
            self.statistics.pivots += 1;
        }
        stopped.is_some()
    }

    /// The row at a bound that pulls away from it the most.
    fn most_violated(&mut self) -> Option<usize> {
        let (mut most, mut found) = (self.tolerance, None);
        for (p, row) in self.iterate.variables.iter().enumerate() {
            if row.state == State::Free || row.is_fixed() {
                continue;
            }
            let excess = self.iterate.excess(&self.rows, row);
            let wrong = if row.state == State::Low { -excess } else { excess };
            if wrong > most {
                (most, found) = (wrong, Some(p));
            }
        }
        self.statistics.multiplications += 2.0 * self.layout.pass_cost;
        found
    }
}
