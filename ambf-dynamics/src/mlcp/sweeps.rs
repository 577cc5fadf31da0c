//! Projected Gauss–Seidel.

use super::problem::State;
use super::solver::{Solver, MIN_SWEEPS};

/// Share of the largest target which a sweep must change to be followed by another one; what is left is the next step's
/// to do.
const SETTLED: f64 = 1e-3;
/// Sweeps within which the largest change must fall by `PROGRESS`, else there are no more.
const PATIENCE: u32 = 10;
const PROGRESS: f64 = 0.9;

impl Solver {
    /// Multiplications of one sweep: the velocity of each row, and its impulse.
    pub(super) fn sweep_cost(&self) -> f64 {
        2.0 * self.layout.pass_cost + self.layout.order.len() as f64
    }

    /// Sweeps from the impulses at hand until they hardly change velocities, make no progress or the budget ends; a few
    /// in any case.
    pub(super) fn sweeps(&mut self, budget: f64) {
        self.iterate.accumulate(&self.rows);
        let settled = self.tolerance.max(SETTLED * self.scale);
        let (mut count, mut least, mut since) = (0, f64::INFINITY, 0);
        while count < MIN_SWEEPS || (since <= PATIENCE && self.statistics.multiplications + self.sweep_cost() <= budget)
        {
            count += 1;
            let change = self.sweep();
            if change <= self.tolerance || (change <= settled && count >= MIN_SWEEPS) {
                break;
            }
            since += 1;
            if change <= PROGRESS * least {
                (least, since) = (change, 0);
            }
        }
        self.set_states();
    }

    /// One sweep. Returns the largest change, as a velocity.
    fn sweep(&mut self) -> f64 {
        let mut largest: f64 = 0.0;
        for p in 0..self.iterate.variables.len() {
            self.iterate.bound_friction(p);
            let row = &self.iterate.variables[p];
            if row.diagonal <= 0.0 {
                continue;
            }
            let x = row.clamp(row.x - self.iterate.excess(&self.rows, row) / row.diagonal);
            let change = x - row.x;
            if change == 0.0 {
                continue;
            }
            largest = largest.max(change.abs() * row.diagonal);
            self.iterate.variables[p].x = x;
            self.iterate.push(&self.rows, p, change);
        }
        self.statistics.sweeps += 1;
        self.statistics.multiplications += self.sweep_cost();
        largest
    }

    /// Active set of the impulses at hand.
    pub(super) fn set_states(&mut self) {
        for row in &mut self.iterate.variables {
            row.state = row.state_of_x();
        }
        debug_assert!(self.iterate.variables.iter().all(|row| row.state == State::Free || row.x.is_finite()));
    }
}
