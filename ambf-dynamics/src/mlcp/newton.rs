//! Newton's method for contacts whose friction slides (semi-smooth Newton; Alart and Curnier, *Computer Methods in
//! Applied Mechanics and Engineering* 92, 1991).
//!
//! Block pivoting takes the bounds of friction from the normal impulses of the iteration before and converges linearly,
//! at a rate that the coefficient of friction sets, or not at all. Here an impulse of sliding friction is
//! `±coefficient` times the unknown normal impulse, so that the matrix of the free rows is
//!
//! ```text
//! B_ik = A_ik + cfm_i δ_ik + Σ ±coefficient_f A_if    over the sliding rows f of the normal k
//! ```
//!
//! It is not symmetric and is factored densely, which is for small problems only. From a bad active set the iterations
//! cycle; staggered projections (`descent.rs`) find a good one.

use super::iterate::Iterate;
use super::problem::{Rows, State};
use super::solver::Solver;
use multiversion::multiversion;

/// Most rows.
const MAX_ROWS: usize = 150;
/// Most iterations; where more are needed they cycle.
const MAX_ROUNDS: u32 = 5;
/// Most work of an iteration, as a multiple of that of block pivoting.
const CHEAP: f64 = 2.0;
/// Pivot of the elimination, as a share of the largest number of its column, below which the matrix is singular.
const SINGULAR: f64 = 1e-14;

/// Memory of the method.
#[derive(Debug, Default)]
pub(super) struct Newton {
    /// `A`, all rows by all rows, by place, and which rows are known.
    response: Vec<f64>,
    is_known: Vec<bool>,
    /// Impulses and active set before the iterations, by place.
    start: Vec<(f64, State)>,
    /// Places of the unknowns.
    places: Vec<usize>,
    /// Index of each place among the unknowns.
    unknown: Vec<Option<usize>>,
    /// `B` with the right-hand side as last column.
    matrix: Vec<f64>,
}

impl Newton {
    /// To be called where rows change.
    pub fn reset(&mut self, count: usize) {
        let count = if count > MAX_ROWS { 0 } else { count };
        self.is_known.clear();
        self.is_known.resize(count, false);
        if self.response.len() < count * count {
            self.response.resize(count * count, 0.0);
        }
    }

    /// Finds the rows of `A` of the unknowns. Returns how many were not known.
    fn assemble(&mut self, rows: &Rows, iterate: &mut Iterate) -> u32 {
        let (n, mut new) = (iterate.variables.len(), 0);
        for &p in self.places.iter().filter(|&&p| !std::mem::replace(&mut self.is_known[p], true)) {
            iterate.velocities.fill(0.0);
            iterate.push(rows, p, 1.0);
            for (k, response) in self.response[p * n..(p + 1) * n].iter_mut().enumerate() {
                *response = iterate.row_velocity(rows, &iterate.variables[k]);
            }
            new += 1;
        }
        new
    }

    /// Multiplications of an elimination.
    fn cost(unknowns: usize) -> f64 {
        let n = unknowns as f64;
        n * n * (n / 3.0 + 1.0)
    }

    /// Finds which impulses are unknown: those of free rows that impulses move.
    fn find_unknowns(&mut self, iterate: &Iterate) -> usize {
        self.places.clear();
        self.unknown.clear();
        for (p, row) in iterate.variables.iter().enumerate() {
            let is_unknown = row.state == State::Free && row.diagonal > 0.0 && !row.is_fixed();
            self.unknown.push(is_unknown.then_some(self.places.len()));
            if is_unknown {
                self.places.push(p);
            }
        }
        self.places.len()
    }

    /// Solves for the impulses. Returns whether the matrix was regular.
    fn solve(&mut self, iterate: &mut Iterate) -> bool {
        let (n, count) = (iterate.variables.len(), self.places.len());
        let width = count + 1;
        self.matrix.clear();
        self.matrix.resize(count * width, 0.0);
        for (i, &p) in self.places.iter().enumerate() {
            let (row, response) = (&iterate.variables[p], &self.response[p * n..(p + 1) * n]);
            let equation = &mut self.matrix[i * width..(i + 1) * width];
            equation[count] = row.target;
            for (q, other) in iterate.variables.iter().enumerate() {
                match (self.unknown[q], other.slides_with()) {
                    (Some(k), _) => equation[k] += response[q],
                    (None, Some((normal, share))) => match self.unknown[normal] {
                        Some(k) => equation[k] += share * response[q],
                        None => equation[count] -= response[q] * other.x,
                    },
                    (None, None) => equation[count] -= response[q] * other.x,
                }
            }
            equation[i] += row.cfm;
        }
        if !eliminate(&mut self.matrix, count) {
            return false;
        }
        for (i, &p) in self.places.iter().enumerate() {
            iterate.variables[p].x = self.matrix[i * width + count];
        }
        true
    }
}

/// Gauss's elimination with partial pivoting of `count` equations, whose last column becomes the solution. Returns
/// whether they are regular.
#[multiversion(targets("x86_64+avx2"))]
fn eliminate(matrix: &mut [f64], count: usize) -> bool {
    let width = count + 1;
    for k in 0..count {
        let size = |i: usize| matrix[i * width + k].abs();
        let pivot = (k..count).fold(k, |best, i| if size(i) > size(best) { i } else { best });
        let largest = (0..count).fold(0.0, |largest: f64, i| largest.max(size(i)));
        let is_regular = size(pivot) > SINGULAR * largest;
        if !is_regular {
            return false;
        }
        if pivot != k {
            for j in k..width {
                matrix.swap(k * width + j, pivot * width + j);
            }
        }
        let (done, open) = matrix.split_at_mut((k + 1) * width);
        let row = &done[k * width + k..];
        for other in open.chunks_exact_mut(width) {
            let factor = other[k] / row[0];
            if factor != 0.0 {
                other[k..].iter_mut().zip(row).for_each(|(entry, above)| *entry -= factor * above);
            }
        }
    }
    for k in (0..count).rev() {
        let (open, done) = matrix.split_at_mut((k + 1) * width);
        let row = &mut open[k * width..];
        let mut value = row[count];
        for (j, below) in done.chunks_exact(width).enumerate() {
            value -= row[k + 1 + j] * below[count];
        }
        row[count] = value / row[k];
    }
    true
}

impl Solver {
    /// Iterations from the active set at hand, which converge if that is nearly the right one. Returns whether they
    /// did; if not, impulses and active set are those from before.
    pub(super) fn newton(&mut self, limit: f64) -> bool {
        if self.iterate.variables.len() > MAX_ROWS {
            return false;
        }
        self.newton.start.clear();
        self.newton.start.extend(self.iterate.variables.iter().map(|row| (row.x, row.state)));
        let converged = self.newton_rounds(limit);
        if !converged {
            for (row, &(x, state)) in self.iterate.variables.iter_mut().zip(&self.newton.start) {
                (row.x, row.state) = (x, state);
            }
            self.iterate.bound_frictions();
        }
        converged
    }

    fn newton_rounds(&mut self, limit: f64) -> bool {
        self.iterate.bound_frictions();
        self.iterate.move_to_bounds();
        let pass = self.layout.pass_cost;
        for _ in 0..MAX_ROUNDS {
            let elimination = Newton::cost(self.newton.find_unknowns(&self.iterate));
            if elimination > CHEAP * (self.layout.least_factor_cost() + 3.0 * pass) {
                return false;
            }
            let new = self.newton.assemble(&self.rows, &mut self.iterate);
            self.statistics.multiplications += elimination + (2.0 + f64::from(new)) * pass;
            if self.statistics.multiplications > limit || !self.newton.solve(&mut self.iterate) {
                return false;
            }
            self.statistics.factorisations += 1;
            self.iterate.bound_frictions();
            self.iterate.move_to_bounds();
            self.iterate.accumulate(&self.rows);
            // Bounds of friction may have reached their caps.
            if self.update_active_set() == 0 {
                if self.iterate.clamp() {
                    self.iterate.accumulate(&self.rows);
                }
                if self.iterate.merit(&self.rows).residual <= self.accepted {
                    self.record_current(true);
                    return true;
                }
            }
        }
        false
    }
}
