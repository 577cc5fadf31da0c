//! Solution for the free rows.

use super::free_factor::Kind;
use super::iterate::Iterate;
use super::problem::Rows;
use super::solver::Solver;
use multiversion::multiversion;

/// Solutions in velocity space, the first one for the change from the impulses at hand, and the share of the fine tolerance at
/// which they end.
const MAX_REFINEMENTS: u32 = 4;
const REFINED: f64 = 1e-2;

/// Applies the impulses at bounds, and finds the velocities that the free rows at `places` have to cause then.
#[multiversion(targets("x86_64+avx2"))]
fn find_targets(iterate: &mut Iterate, rows: &Rows, places: &[u32], targets: &mut Vec<f64>) {
    iterate.apply_bound_impulses(rows);
    targets.clear();
    targets.extend(places.iter().map(|&p| {
        let row = &iterate.variables[p as usize];
        row.target - iterate.row_velocity(rows, row)
    }));
}

/// Applies the impulses at bounds, and those at hand of the free rows at `places`, which the unknowns are at first.
#[multiversion(targets("x86_64+avx2"))]
fn start_unknowns(iterate: &mut Iterate, rows: &Rows, places: &[u32], unknowns: &mut Vec<f64>) {
    iterate.apply_bound_impulses(rows);
    unknowns.clear();
    for &p in places {
        let row = &iterate.variables[p as usize];
        let x = if row.diagonal > 0.0 { row.x } else { 0.0 };
        unknowns.push(x);
        iterate.push(rows, p as usize, x);
    }
}

/// Applies impulses along the rows at `places`.
#[multiversion(targets("x86_64+avx2"))]
fn apply_impulses(iterate: &mut Iterate, rows: &Rows, places: &[u32], impulses: &[f64]) {
    for (&p, &x) in places.iter().zip(impulses) {
        iterate.push(rows, p as usize, x);
    }
}

impl Solver {
    /// Prepares the factorisation if that and a first one fit.
    pub(super) fn assemble(&mut self, limit: f64) -> bool {
        let Self { factor, iterate, layout, .. } = self;
        factor.begin(layout, iterate);
        let preparation = factor.preparation_cost(layout);
        if self.statistics.multiplications + factor.plan(layout, iterate) + preparation > limit {
            return false;
        }
        factor.prepare(&mut self.rows, layout);
        if let Some(coordinates) = factor.coordinates() {
            iterate.enter(coordinates, layout);
        }
        self.statistics.multiplications += preparation;
        true
    }

    /// Brings the factor up to date with the active set if that fits.
    pub(super) fn factorise(&mut self, limit: f64) -> bool {
        let Self { factor, iterate, rows, layout, statistics, .. } = self;
        let cost = factor.plan(layout, iterate);
        if statistics.multiplications + cost > limit && statistics.factorisations > 0 {
            return false;
        }
        statistics.multiplications += factor.update(rows, layout, iterate, cost);
        statistics.factorisations += 1;
        true
    }

    /// Applies the impulses at bounds, and finds those of the free rows that go with them, in `unknowns`. The
    /// velocities are then those of both.
    pub(super) fn solve_free(&mut self) {
        let Self { factor, iterate, rows, layout, unknowns, .. } = self;
        if factor.kind() == Kind::Velocities {
            start_unknowns(iterate, rows, factor.places(), unknowns);
            self.statistics.multiplications += layout.pass_cost;
            if !self.refine_unknowns() {
                self.solve_free_by_rows();
            }
            return;
        }
        find_targets(iterate, rows, factor.places(), unknowns);
        factor.solve(rows, layout, unknowns);
        apply_impulses(iterate, rows, factor.places(), unknowns);
        self.statistics.multiplications += factor.solve_cost(layout) + 3.0 * layout.pass_cost;
    }

    /// Iterative refinement of the unknowns by the equations of the free rows. Returns whether they hold then.
    fn refine_unknowns(&mut self) -> bool {
        let Self { factor, iterate, rows, layout, unknowns, errors, .. } = self;
        let mut before = 0.0;
        for remaining in (0..=MAX_REFINEMENTS).rev() {
            errors.clear();
            let mut largest: f64 = 0.0;
            for (&p, &x) in factor.places().iter().zip(&*unknowns) {
                let row = &iterate.variables[p as usize];
                let error = row.target - iterate.row_velocity(rows, row) - row.cfm * x;
                // Rows that no impulse moves cannot be refined.
                let counts = row.diagonal > 0.0;
                largest = largest.max(if counts { error.abs() } else { 0.0 });
                errors.push(error);
            }
            self.statistics.multiplications += layout.pass_cost;
            if largest <= REFINED * self.fine {
                return true;
            }
            if remaining == 0 || !largest.is_finite() {
                return largest <= self.fine;
            }
            // The next step multiplies the errors by about what the last one has multiplied them by.
            let is_enough = largest * largest <= REFINED * REFINED * self.fine * before;
            before = largest;
            factor.solve(rows, layout, errors);
            for (i, &change) in errors.iter().enumerate() {
                unknowns[i] += change;
                iterate.push(rows, factor.places()[i] as usize, change);
            }
            self.statistics.multiplications += factor.solve_cost(layout) + layout.pass_cost;
            if is_enough {
                return true;
            }
        }
        false
    }

    /// The same by the other factorisation, which is then used for the rest of the solution, if it fits into the
    /// budget.
    fn solve_free_by_rows(&mut self) {
        let Self { factor, iterate, rows, layout, .. } = self;
        let cost = layout.factor_cost + layout.assembly_cost;
        if self.statistics.multiplications + cost > self.direct {
            return;
        }
        factor.use_rows();
        self.statistics.multiplications += factor.preparation_cost(layout);
        factor.prepare(rows, layout);
        let planned = factor.plan(layout, iterate);
        self.statistics.multiplications += factor.update(rows, layout, iterate, planned);
        self.statistics.factorisations += 1;
        self.solve_free();
    }

    /// One step of iterative refinement of the free rows.
    pub(super) fn refine(&mut self) {
        let Self { factor, iterate, rows, layout, unknowns, .. } = self;
        unknowns.clear();
        unknowns.extend(factor.places().iter().map(|&p| -iterate.excess(rows, &iterate.variables[p as usize])));
        factor.solve(rows, layout, unknowns);
        for (&p, &change) in factor.places().iter().zip(&*unknowns) {
            iterate.variables[p as usize].x += change;
        }
        self.statistics.multiplications += factor.solve_cost(layout) + self.layout.pass_cost;
    }
}
