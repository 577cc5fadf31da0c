//! Block principal pivoting (Júdice and Pires, *Computers & Operations Research* 21, 1994) with bounds of friction that
//! follow the normal impulses.

use super::problem::State;
use super::solver::{Solver, MAX_PIVOT_ROUNDS};

/// Iterations for which the number of wrong rows need not fall before another method is tried.
const PATIENCE: i32 = 1;
/// Change of the impulses at the bounds of friction, as a share of that of the iteration before, up to which the next
/// iteration is cheaper than Newton's method.
const CONTRACTING: f64 = 0.5;
/// That change, as a share of the largest target other than of friction, that needs no further iteration.
const STEADY: f64 = 1e-7;

/// Watches whether fewer and fewer rows are wrong.
pub(super) struct Progress {
    best: u32,
    left: i32,
}

impl Progress {
    pub fn new(patience: i32) -> Self {
        Self { best: u32::MAX, left: patience }
    }

    /// Whether the number fell within the last `patience` iterations.
    pub fn made(&mut self, wrong: u32, patience: i32) -> bool {
        if wrong < self.best {
            self.best = wrong;
            self.left = patience;
        } else {
            self.left -= 1;
        }
        self.left >= 0
    }
}

impl Solver {
    /// Iterations of block pivoting, each followed by new bounds of friction. Fast where few rows change sides; it may
    /// cycle. Returns whether it converged.
    pub(super) fn pivot(&mut self, limit: f64) -> bool {
        let mut stale = true;
        let mut progress = Progress::new(PATIENCE);
        let mut moved_before = f64::INFINITY;
        for _ in 0..MAX_PIVOT_ROUNDS {
            if stale && !self.factorise(limit) {
                return false;
            }
            self.apply_free_impulses();
            let moved = self.iterate.bound_frictions();
            let wrong = self.update_active_set();
            stale = wrong > 0;
            if stale && !progress.made(wrong, PATIENCE) {
                return false;
            }
            if !stale
                && (moved <= STEADY * self.normal_scale || (moved > CONTRACTING * moved_before && self.newton(limit)))
            {
                return true;
            }
            moved_before = if stale { f64::INFINITY } else { moved };
        }
        false
    }

    /// Solves for the free rows and applies their impulses.
    pub(super) fn apply_free_impulses(&mut self) {
        self.solve_free();
        for (&p, &x) in self.factor.places().iter().zip(&self.unknowns) {
            self.iterate.variables[p as usize].x = x;
        }
    }

    /// Moves rows that break their bounds onto them, and rows that pull away from their bounds off them. Returns how
    /// many rows were wrong.
    pub(super) fn update_active_set(&mut self) -> u32 {
        let mut wrong = 0;
        for p in 0..self.iterate.variables.len() {
            let row = &self.iterate.variables[p];
            let state = match row.state {
                State::Free => {
                    if (row.x - row.high) * row.diagonal > self.tolerance {
                        State::High
                    } else if (row.low - row.x) * row.diagonal > self.tolerance {
                        State::Low
                    } else {
                        continue;
                    }
                }
                _ if row.is_fixed() => continue,
                side => {
                    let excess = self.iterate.excess(&self.rows, row);
                    let holds = if side == State::Low { excess >= -self.tolerance } else { excess <= self.tolerance };
                    if holds {
                        continue;
                    }
                    State::Free
                }
            };
            wrong += 1;
            self.iterate.variables[p].state = state;
        }
        self.statistics.pivots += wrong;
        self.statistics.multiplications += self.layout.pass_cost;
        wrong
    }
}
