//! Projected Gauss–Seidel, alone and with subspace minimisation (Silcowitz, Niebe and Erleben, *The Visual Computer*
//! 26, 2010).

use super::problem::State;
use super::solver::{Solver, MIN_SWEEPS};

/// Share of the largest target which a sweep must change to be followed by another one; what is left is the next step's
/// to do.
const SETTLED: f64 = 1e-3;
/// Sweeps within which the largest change must fall by `PROGRESS`, else there are no more.
const PATIENCE: u32 = 10;
const PROGRESS: f64 = 0.9;
/// Subspace minimisations within which the largest change must fall so.
const POLISH_PATIENCE: u32 = 3;
/// Sweeps between two subspace minimisations.
const SWEEPS: u32 = 3;
/// Most factorisations of one subspace minimisation.
const INNER_ROUNDS: u32 = 3;
/// Most subspace minimisations.
const MAX_POLISH_ROUNDS: u32 = 20;

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
    pub(super) fn sweep(&mut self) -> f64 {
        self.sweep_with::<true>()
    }

    /// One sweep within the bounds that friction has, by which [`energy`](super::iterate::Iterate::energy) never grows.
    pub(super) fn sweep_within_bounds(&mut self) {
        self.sweep_with::<false>();
    }

    fn sweep_with<const BOUNDS_FOLLOW: bool>(&mut self) -> f64 {
        let mut largest: f64 = 0.0;
        for p in 0..self.iterate.variables.len() {
            if BOUNDS_FOLLOW {
                self.iterate.bound_friction(p);
            }
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

    /// Sweeps find which rows are at their bounds, a factorisation solves the others. The energy never grows within
    /// fixed bounds, so that the result is at least as good as that of the sweeps. Ends where it converges, makes no
    /// progress or the budget ends. Returns whether it converged.
    pub(super) fn pgs_polish(&mut self, budget: f64, direct: f64) -> bool {
        self.iterate.accumulate(&self.rows);
        let mut count = 0;
        let (mut least, mut since) = (f64::INFINITY, 0);
        for _ in 0..MAX_POLISH_ROUNDS {
            let mut change = 0.0;
            for _ in 0..SWEEPS {
                if count >= MIN_SWEEPS && self.statistics.multiplications + self.sweep_cost() > budget {
                    self.set_states();
                    return false;
                }
                count += 1;
                change = self.sweep();
                if change <= self.tolerance {
                    self.set_states();
                    return true;
                }
            }
            since += 1;
            if change <= PROGRESS * least {
                (least, since) = (change, 0);
            }
            if since > POLISH_PATIENCE {
                break;
            }
            self.minimise_subspace(direct);
        }
        self.sweep();
        self.set_states();
        false
    }

    fn minimise_subspace(&mut self, limit: f64) {
        for _ in 0..INNER_ROUNDS {
            self.set_states();
            if !self.factorise(limit) {
                return;
            }
            let before = self.iterate.energy(&self.rows);
            self.saved.clear();
            self.saved.extend(self.iterate.variables.iter().map(|row| row.x));
            self.solve_free();
            let step = self.project_free();
            if step == 1.0 {
                return;
            }
            if self.iterate.energy(&self.rows) <= before {
                continue;
            }
            // The projection went too far: as far as the first bound the energy falls.
            self.move_free(step);
            return;
        }
    }

    /// Takes the unknowns, each within its bounds. Returns the share of the way to them at which the first bound is
    /// met.
    fn project_free(&mut self) -> f64 {
        let Self { factor, iterate, unknowns, .. } = self;
        let mut step: f64 = 1.0;
        for (&p, &unknown) in factor.places().iter().zip(&*unknowns) {
            let row = &mut iterate.variables[p as usize];
            let way = unknown - row.x;
            let room = if way > 0.0 { row.high } else { row.low } - row.x;
            if way.abs() > room.abs() {
                step = step.min(room / way);
            }
            row.x = row.clamp(unknown);
        }
        iterate.accumulate(&self.rows);
        self.statistics.multiplications += 3.0 * self.layout.pass_cost;
        step
    }

    fn move_free(&mut self, step: f64) {
        let Self { factor, iterate, unknowns, saved, .. } = self;
        for (&p, &unknown) in factor.places().iter().zip(&*unknowns) {
            let old = saved[p as usize];
            let row = &mut iterate.variables[p as usize];
            row.x = row.clamp(old + step * (unknown - old));
        }
        iterate.accumulate(&self.rows);
        self.statistics.multiplications += self.layout.pass_cost;
    }

    /// Active set of the impulses at hand.
    pub(super) fn set_states(&mut self) {
        for row in &mut self.iterate.variables {
            row.state = row.state_of_x();
        }
        debug_assert!(self.iterate.variables.iter().all(|row| row.state == State::Free || row.x.is_finite()));
    }
}
