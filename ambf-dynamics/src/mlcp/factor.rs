//! Cholesky factorisation of the free rows of a matrix, stored by envelope (George and Liu, *Computer Solution of Large
//! Sparse Positive Definite Systems*, 1981, chapter 4).

use super::layout::Layout;
use super::matrix::Matrix;
use super::vector::{add_scaled, dot, dots};
use multiversion::multiversion;

/// Share of its diagonal below which the pivot of a row counts as zero: the row depends on those before it, and its
/// impulse is 0.
const DEPENDENT: f64 = 1e-13;
/// Rows with one envelope that are found together at most: a joint has up to six.
const GROUP: usize = 6;

/// `L` with `L Lᵀ = A + diag(cfm)` for the free rows, in the order of their places.
///
/// A row of `L` depends on the rows before it only: after changes of the set of free rows, the factor is made anew from
/// the first changed place on, with the same bits as a whole factorisation.
#[derive(Debug, Default)]
pub(super) struct EnvelopeFactor {
    /// Places of the free rows.
    pub places: Vec<u32>,
    first: Vec<u32>,
    start: Vec<usize>,
    entries: Vec<f64>,
    inverse_diagonal: Vec<f64>,
    /// Free rows before each place, one more than places.
    count: Vec<u32>,
    /// Places for which the factor holds.
    valid: usize,
    /// The rows of a group by columns, each of `GROUP` entries or less.
    columns: Vec<f64>,
}

impl EnvelopeFactor {
    /// To be called where the matrix changes.
    pub fn reset(&mut self) {
        self.valid = 0;
    }

    /// Finds the first place where the factor is out of date, and the multiplications that an update will take at most.
    pub fn plan(&mut self, layout: &Layout, is_free: impl Fn(usize) -> bool) -> f64 {
        let n = layout.order.len();
        self.count.resize(n + 1, 0);
        if self.valid == 0 {
            self.count[0] = 0;
        }
        let mut p = 0;
        while p < self.valid && is_free(p) == (self.count[p + 1] > self.count[p]) {
            p += 1;
        }
        self.valid = p;
        let mut cost = 0.0;
        for p in p..n {
            let free = is_free(p);
            self.count[p + 1] = self.count[p] + u32::from(free);
            if free {
                let width = f64::from(self.count[p + 1] - self.count[layout.first[p] as usize]);
                cost += width * width / 2.0;
            }
        }
        cost
    }

    /// Brings the factor up to date with the plan. Returns the multiplications.
    pub fn update(&mut self, layout: &Layout, matrix: &Matrix, cfm: impl Fn(usize) -> f64) -> f64 {
        update(self, layout, matrix, cfm)
    }

    #[inline(always)]
    fn add_groups(&mut self, layout: &Layout, matrix: &Matrix, cfm: impl Fn(usize) -> f64) -> f64 {
        let n = layout.order.len();
        let kept = self.count[self.valid] as usize;
        self.places.truncate(kept);
        self.first.truncate(kept);
        self.inverse_diagonal.truncate(kept);
        self.start.truncate(kept + 1);
        if self.start.is_empty() {
            self.start.push(0);
        }
        if self.entries.len() < matrix.entries.len() {
            self.entries.resize(matrix.entries.len(), 0.0);
        }
        let mut work = 0;
        let mut group = [0; GROUP];
        let mut p = self.valid;
        while p < n {
            // Free rows whose envelopes begin at the same place, as those of a joint do.
            let mut size = 0;
            while p < n && size < GROUP && (size == 0 || layout.first[p] == layout.first[group[0]]) {
                if self.count[p + 1] > self.count[p] {
                    group[size] = p;
                    size += 1;
                }
                p += 1;
            }
            work += match size {
                0 => 0,
                1 => self.add_rows::<1>(&group, layout, matrix, &cfm),
                2 => self.add_rows::<2>(&group, layout, matrix, &cfm),
                3 => self.add_rows::<3>(&group, layout, matrix, &cfm),
                4 => self.add_rows::<4>(&group, layout, matrix, &cfm),
                5 => self.add_rows::<5>(&group, layout, matrix, &cfm),
                _ => self.add_rows::<GROUP>(&group, layout, matrix, &cfm),
            };
        }
        self.valid = n;
        work as f64
    }

    /// Adds N rows whose envelopes begin at one place. Returns the multiplications.
    #[inline(always)]
    fn add_rows<const N: usize>(
        &mut self,
        group: &[usize],
        layout: &Layout,
        matrix: &Matrix,
        cfm: impl Fn(usize) -> f64,
    ) -> usize {
        let rows: [usize; N] = std::array::from_fn(|r| group[r]);
        let from = rows.map(|p| &matrix.entries[layout.start[p]..layout.start[p + 1]]);
        let first_place = layout.first[rows[0]];
        let (m, reach) = (self.places.len(), self.count[first_place as usize] as usize);
        let own = m - reach;
        // What is not written yet goes into sums that are not used.
        if self.columns.len() < (own + N) * N {
            self.columns.resize((own + N) * N, 0.0);
        }
        let (columns, _) = self.columns.as_chunks_mut::<N>();
        let mut work = 0;
        let before = self.places[reach..].iter().zip(&self.first[reach..]);
        let before = before.zip(&self.start[reach..]).zip(&self.inverse_diagonal[reach..]);
        for (i, (((&place, &first), &start), &inverse)) in before.enumerate() {
            let first = first as usize;
            let low = reach.max(first);
            let k = reach + i;
            let other = &self.entries[start + (low - first)..start + (k - first)];
            let (known, open) = columns.split_at_mut(i);
            let sums = dots(&known[low - reach..], |c| other[c]);
            for r in 0..N {
                open[0][r] = (from[r][(place - first_place) as usize] - sums[r]) * inverse;
            }
            work += N * (k - low);
        }
        for j in 0..N {
            let p = rows[j];
            let (columns, _) = self.columns.as_chunks::<N>();
            let known = &columns[..own + j];
            let sums = dots(known, |c| known[c][j]);
            let used = self.start[m + j];
            self.entries[used..used + own + j].iter_mut().zip(known).for_each(|(entry, column)| *entry = column[j]);
            let inverse = self.push(p, reach, matrix.diagonal[p] + cfm(p), sums[j]);
            let (columns, _) = self.columns.as_chunks_mut::<N>();
            for r in j + 1..N {
                columns[own + j][r] = (from[r][p - first_place as usize] - sums[r]) * inverse;
            }
            work += (N - j - 1) * (own + j) + own + j;
        }
        work
    }

    /// Ends a row of which all but the diagonal is known. Returns the inverse of the diagonal, 0 of a dependent row.
    fn push(&mut self, p: usize, reach: usize, diagonal: f64, squares: f64) -> f64 {
        let rest = diagonal - squares;
        let inverse = if rest > DEPENDENT * diagonal { 1.0 / rest.sqrt() } else { 0.0 };
        let m = self.places.len();
        self.places.push(p as u32);
        self.first.push(reach as u32);
        self.start.push(self.start[m] + (m - reach));
        self.inverse_diagonal.push(inverse);
        inverse
    }

    /// Replaces the right-hand side of the free rows, in the order of `places`, by their impulses.
    pub fn solve(&self, unknowns: &mut [f64]) {
        solve(self, unknowns);
    }

    #[inline(always)]
    fn substitute(&self, unknowns: &mut [f64]) {
        for i in 0..self.places.len() {
            let reach = self.first[i] as usize;
            let row = &self.entries[self.start[i]..self.start[i + 1]];
            unknowns[i] = (unknowns[i] - dot(row, &unknowns[reach..i])) * self.inverse_diagonal[i];
        }
        for i in (0..self.places.len()).rev() {
            let value = unknowns[i] * self.inverse_diagonal[i];
            unknowns[i] = value;
            let row = &self.entries[self.start[i]..self.start[i + 1]];
            add_scaled(&mut unknowns[self.first[i] as usize..i], -value, row);
        }
    }

    /// Multiplications of [`Self::solve`].
    pub fn solve_cost(&self) -> f64 {
        2.0 * self.start[self.places.len()] as f64
    }
}

/// [`EnvelopeFactor::update`].
#[multiversion(targets("x86_64+avx2"))]
fn update<F: Fn(usize) -> f64>(factor: &mut EnvelopeFactor, layout: &Layout, matrix: &Matrix, cfm: F) -> f64 {
    factor.add_groups(layout, matrix, cfm)
}

/// [`EnvelopeFactor::solve`].
#[multiversion(targets("x86_64+avx2"))]
fn solve(factor: &EnvelopeFactor, unknowns: &mut [f64]) {
    factor.substitute(unknowns);
}
