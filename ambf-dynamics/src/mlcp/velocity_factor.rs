//! Factorisation of the free rows in velocity space, by the formula of Sherman, Morrison and Woodbury (Hager, *SIAM
//! Review* 31, 1989).
//!
//! With rows `q` in coordinates where `A = Q Qᵀ`, see [`Coordinates`], and weights `W = diag(1 / cfm)` of the free
//! rows,
//!
//! ```text
//! (Q Qᵀ + diag(cfm)) x = b      is      (1 + Qᵀ W Q) y = Qᵀ W b,   x = W (b − Q y).
//! ```
//!
//! The matrix has as many rows as there are velocity components, however many rows the problem has. Its eigenvalues are
//! at least 1. Where CFM is small, digits of `x` cancel: the caller refines.

use super::coordinates::{Coordinates, Span};
use super::iterate::Variable;
use super::layout::{Block, Layout};
use super::problem::State;
use super::vector::{add_scaled, add_velocity, dot, dot_velocity, dots};
use multiversion::multiversion;

/// Weight times diagonal of a row beyond which its removal would leave too large an error of rounding in the matrix.
const HEAVY: f64 = 1e8;
/// Rows of the same bodies that are added together.
const GROUP: usize = 4;
/// Velocity components of a rigid body.
const BODY: usize = 6;

/// The rows `q`, and the numbers of [`Rows::data`](super::problem::Rows::data).
#[derive(Debug, Clone, Copy)]
pub(super) struct Numbers<'a> {
    pub coordinates: &'a Coordinates,
    pub data: &'a [f64],
}

/// `1 + Qᵀ W Q` and its Cholesky factor, by blocks of two bodies; a row holds the blocks that are not 0 in the factor, see
/// [`Layout::left`].
#[derive(Debug, Default)]
pub(super) struct VelocityFactor {
    /// Places of the free rows.
    pub places: Vec<u32>,
    /// Weight of each place within the matrix; 0: not free.
    weights: Vec<f64>,
    /// The weights that the plan wants.
    wanted: Vec<f64>,
    /// Rows that changed sides since the last update.
    changes: Vec<u32>,
    matrix: Vec<f64>,
    factor: Vec<f64>,
    inverse_diagonal: Vec<f64>,
    /// The rows of one rigid body in the factor, by columns.
    columns: Vec<[f64; BODY]>,
    right: Vec<f64>,
    /// The part of the right-hand side that belongs to the rows of one body.
    part: Vec<f64>,
    /// Blocks whose rows are out of date.
    stale: Vec<bool>,
    /// Where the columns of other blocks begin in the rows of one body.
    column_of: Vec<u32>,
    valid: bool,
    /// Whether the changes are to be made on a new matrix.
    anew: bool,
}

impl VelocityFactor {
    /// To be called where rows or CFM change.
    pub fn reset(&mut self) {
        self.valid = false;
    }

    /// Finds the rows that change sides. Returns the multiplications that an update will take.
    pub fn plan(&mut self, layout: &Layout, variables: &[Variable]) -> f64 {
        if !self.valid {
            self.weights.clear();
            self.weights.resize(variables.len(), 0.0);
        }
        let (mut whole, mut part, mut heavy) = (0.0, 0.0, false);
        self.changes.clear();
        self.wanted.clear();
        for (p, row) in variables.iter().enumerate() {
            let weight = match row.state {
                State::Free if row.diagonal > 0.0 => row.inverse_cfm,
                _ => 0.0,
            };
            self.wanted.push(weight);
            let cost = layout.scatter_cost(p);
            if weight > 0.0 {
                whole += cost;
            }
            if weight != self.weights[p] {
                heavy |= self.weights[p] * row.diagonal > HEAVY;
                part += cost;
                self.changes.push(p as u32);
            }
        }
        self.anew = !self.valid || heavy || part > whole;
        let factor = if self.anew || part > 0.0 { layout.coordinate_factor_cost } else { 0.0 };
        factor + if self.anew { whole } else { part }
    }

    /// Brings the factor up to date with the plan.
    pub fn update(&mut self, layout: &Layout, of: Numbers, variables: &[Variable]) {
        if self.anew || !self.changes.is_empty() {
            update(self, layout, of, variables);
        }
    }

    #[inline(always)]
    fn add_changes(&mut self, layout: &Layout, of: Numbers, variables: &[Variable]) {
        if self.anew {
            self.begin(layout);
        }
        self.places.clear();
        let free = variables.iter().enumerate().filter(|(_, row)| row.state == State::Free);
        self.places.extend(free.map(|(p, _)| p as u32));
        let mut group = [(0, 0.0); GROUP];
        let mut count = 0;
        let mut shared = Span::default();
        let flush = |matrix: &mut [f64], group: &[(usize, f64)], span: &Span| match group.len() {
            0 => {}
            GROUP => {
                let group: &[(usize, f64); GROUP] = group.try_into().expect("the length is that of a group");
                add_group(matrix, layout, of.data, span, *group);
            }
            _ => group.iter().for_each(|&one| add_group(matrix, layout, of.data, span, [one])),
        };
        let mut add = |matrix: &mut [f64], p: usize, change: f64| {
            let span = of.coordinates.spans[p];
            if count == GROUP || span != shared {
                flush(matrix, &group[..count], &shared);
                (count, shared) = (0, span);
            }
            group[count] = (of.coordinates.offsets[p], change);
            count += 1;
        };
        self.stale.clear();
        self.stale.resize(layout.blocks().len(), self.anew);
        if self.anew {
            for (p, &weight) in self.wanted.iter().enumerate().filter(|(_, &weight)| weight > 0.0) {
                add(&mut self.matrix, p, weight);
            }
        } else {
            for &p in &self.changes {
                add(&mut self.matrix, p as usize, self.wanted[p as usize] - self.weights[p as usize]);
                let span = &of.coordinates.spans[p as usize];
                for side in (0..2).filter(|&side| span.size[side] > 0) {
                    self.stale[layout.block_index(span.start[side])] = true;
                }
            }
        }
        flush(&mut self.matrix, &group[..count], &shared);
        std::mem::swap(&mut self.weights, &mut self.wanted);
        self.valid = true;
        self.factorise(layout);
    }

    #[inline(always)]
    fn begin(&mut self, layout: &Layout) {
        self.matrix.clear();
        self.matrix.resize(layout.coordinate_entries, 0.0);
        for block in layout.blocks() {
            let (offset, stride, size) = (block.offset, block.stride as usize, block.size as usize);
            for k in 0..size {
                self.matrix[offset + k * stride + stride - size + k] = 1.0;
            }
        }
    }

    /// Finds the rows of the factor that are out of date, or depend on some that are.
    #[inline(always)]
    fn factorise(&mut self, layout: &Layout) {
        // Every entry is written below, or has been.
        self.factor.resize(self.matrix.len(), 0.0);
        self.inverse_diagonal.resize(layout.coordinates, 0.0);
        self.column_of.resize(layout.blocks().len(), 0);
        for (b, block) in layout.blocks().iter().enumerate() {
            let left = layout.left(b);
            self.stale[b] |= left.iter().any(|beside| self.stale[beside.block as usize]);
            if !self.stale[b] {
                continue;
            }
            for beside in left {
                self.column_of[beside.block as usize] = beside.column;
            }
            if block.size as usize == BODY && block.stride > block.size {
                self.factorise_body(layout, b);
            } else {
                self.factorise_rows(layout, b);
            }
        }
    }

    /// The rows of a rigid body, all at a time: they have the same columns.
    #[inline(always)]
    fn factorise_body(&mut self, layout: &Layout, b: usize) {
        let block = &layout.blocks()[b];
        let stride = block.stride as usize;
        let own = stride - BODY;
        let (done, rows) = self.factor.split_at_mut(block.offset);
        let from = &self.matrix[block.offset..block.offset + BODY * stride];
        self.columns.clear();
        self.columns.extend((0..stride).map(|c| std::array::from_fn::<_, BODY, _>(|r| from[r * stride + c])));
        for beside in layout.left(b) {
            let (k, at) = (beside.block as usize, beside.column as usize);
            let before = &layout.blocks()[k];
            let (start, width, stride) = (before.start as usize, before.size as usize, before.stride as usize);
            let diagonal = before.offset + stride - width;
            for j in 0..width {
                let other = &done[diagonal + j * stride..][..j];
                let (known, open) = self.columns.split_at_mut(at + j);
                let sums = products(&known[at..], other);
                let inverse = self.inverse_diagonal[start + j];
                open[0].iter_mut().zip(sums).for_each(|(entry, sum)| *entry = (*entry - sum) * inverse);
            }
            let (known, open) = self.columns.split_at_mut(at + width);
            let known = &known[at..];
            for beside in layout.below(k).iter().take_while(|beside| (beside.block as usize) < b) {
                let after = &layout.blocks()[beside.block as usize];
                let column = self.column_of[beside.block as usize] as usize - at - width;
                let (from, stride) = (after.offset + beside.column as usize, after.stride as usize);
                for (c, entries) in open[column..column + after.size as usize].iter_mut().enumerate() {
                    let sums = products(known, &done[from + c * stride..][..width]);
                    entries.iter_mut().zip(sums).for_each(|(entry, sum)| *entry -= sum);
                }
            }
        }
        for j in 0..BODY {
            let (known, open) = self.columns.split_at_mut(own + j);
            let sums = dots(known, |c| known[c][j]);
            let inverse = inverse_root(open[0][j] - sums[j]);
            self.inverse_diagonal[block.start as usize + j] = inverse;
            for k in j + 1..BODY {
                open[0][k] = (open[0][k] - sums[k]) * inverse;
            }
        }
        for (r, row) in rows[..BODY * stride].chunks_exact_mut(stride).enumerate() {
            row.iter_mut().zip(&self.columns).for_each(|(entry, column)| *entry = column[r]);
        }
    }

    /// The rows of a body, one after the other.
    #[inline(always)]
    fn factorise_rows(&mut self, layout: &Layout, b: usize) {
        let block = &layout.blocks()[b];
        let (stride, size) = (block.stride as usize, block.size as usize);
        let own = stride - size;
        for r in 0..size {
            let from = block.offset + r * stride;
            let (done, row) = self.factor.split_at_mut(from);
            let row = &mut row[..stride];
            row.copy_from_slice(&self.matrix[from..from + stride]);
            for beside in layout.left(b) {
                let (k, at) = (beside.block as usize, beside.column as usize);
                let before = &layout.blocks()[k];
                let (start, width, stride) = (before.start as usize, before.size as usize, before.stride as usize);
                let diagonal = before.offset + stride - width;
                for j in 0..width {
                    let other = &done[diagonal + j * stride..][..j];
                    row[at + j] = (row[at + j] - dot(&row[at..at + j], other)) * self.inverse_diagonal[start + j];
                }
                let (known, open) = row.split_at_mut(at + width);
                let known = &known[at..];
                for beside in layout.below(k).iter().take_while(|beside| (beside.block as usize) < b) {
                    let after = &layout.blocks()[beside.block as usize];
                    let column = self.column_of[beside.block as usize] as usize - at - width;
                    let (from, stride) = (after.offset + beside.column as usize, after.stride as usize);
                    for (c, entry) in open[column..column + after.size as usize].iter_mut().enumerate() {
                        *entry -= dot(known, &done[from + c * stride..][..width]);
                    }
                }
            }
            for j in 0..r {
                let other = &done[block.offset + j * stride..][..own + j];
                let inverse = self.inverse_diagonal[block.start as usize + j];
                row[own + j] = (row[own + j] - dot(&row[..own + j], other)) * inverse;
            }
            let rest = row[own + r] - dot(&row[..own + r], &row[..own + r]);
            self.inverse_diagonal[block.start as usize + r] = inverse_root(rest);
        }
    }

    /// Replaces the right-hand side of the free rows, in the order of `places`, by their impulses.
    pub fn solve(&mut self, layout: &Layout, of: Numbers, unknowns: &mut [f64]) {
        solve(self, layout, of, unknowns);
    }

    #[inline(always)]
    fn substitute(&mut self, layout: &Layout, of: Numbers, unknowns: &mut [f64]) {
        let (right, part) = (&mut self.right, &mut self.part);
        right.clear();
        right.resize(layout.coordinates, 0.0);
        for (&p, b) in self.places.iter().zip(&*unknowns) {
            let p = p as usize;
            let scaled = self.weights[p] * b;
            for_sides(of, p, |start, q| add_velocity(&mut right[start..start + q.len()], scaled, q));
        }
        // The parts of the right-hand side that belong to the columns of a body's rows.
        let segments = |b: usize| {
            let block = &layout.blocks()[b];
            let of = |block: &Block| block.start as usize..(block.start + block.size) as usize;
            let left = layout.left(b).iter().map(move |beside| of(&layout.blocks()[beside.block as usize]));
            left.chain([of(block)])
        };
        let gather = |right: &[f64], part: &mut Vec<f64>, b: usize| {
            part.clear();
            segments(b).for_each(|segment| part.extend_from_slice(&right[segment]));
        };
        for (b, block) in layout.blocks().iter().enumerate() {
            let (stride, size, start) = (block.stride as usize, block.size as usize, block.start as usize);
            gather(right, part, b);
            for r in 0..size {
                let (row, at) = (block.offset + r * stride, stride - size + r);
                part[at] =
                    (part[at] - dot(&self.factor[row..row + at], &part[..at])) * self.inverse_diagonal[start + r];
            }
            right[start..start + size].copy_from_slice(&part[stride - size..]);
        }
        for (b, block) in layout.blocks().iter().enumerate().rev() {
            let (stride, size, start) = (block.stride as usize, block.size as usize, block.start as usize);
            gather(right, part, b);
            for r in (0..size).rev() {
                let (row, at) = (block.offset + r * stride, stride - size + r);
                let value = part[at] * self.inverse_diagonal[start + r];
                part[at] = value;
                add_scaled(&mut part[..at], -value, &self.factor[row..row + at]);
            }
            let mut from = 0;
            for segment in segments(b) {
                let length = segment.len();
                right[segment].copy_from_slice(&part[from..from + length]);
                from += length;
            }
        }
        for (&p, b) in self.places.iter().zip(unknowns) {
            let p = p as usize;
            let mut rest = *b;
            for_sides(of, p, |start, q| rest -= dot_velocity(q, &right[start..start + q.len()]));
            *b = self.weights[p] * rest;
        }
    }
}

/// [`VelocityFactor::update`].
#[multiversion(targets("x86_64+avx2"))]
fn update(factor: &mut VelocityFactor, layout: &Layout, of: Numbers, variables: &[Variable]) {
    factor.add_changes(layout, of, variables);
}

/// [`VelocityFactor::solve`].
#[multiversion(targets("x86_64+avx2"))]
fn solve(factor: &mut VelocityFactor, layout: &Layout, of: Numbers, unknowns: &mut [f64]) {
    factor.substitute(layout, of, unknowns);
}

/// Sums of the columns, each times a number of the other row.
#[inline(always)]
fn products(columns: &[[f64; BODY]], other: &[f64]) -> [f64; BODY] {
    let mut sums = [0.0; BODY];
    for (column, factor) in columns.iter().zip(other) {
        for r in 0..BODY {
            sums[r] += column[r] * factor;
        }
    }
    sums
}

/// Inverse of a diagonal entry of the factor. The eigenvalues are at least 1; less is an error of rounding.
fn inverse_root(rest: f64) -> f64 {
    1.0 / rest.max(0.5).sqrt()
}

#[inline(always)]
fn for_sides(of: Numbers, p: usize, mut act: impl FnMut(usize, &[f64])) {
    let (span, offset) = (&of.coordinates.spans[p], of.coordinates.offsets[p]);
    let (first, second) = (span.size[0] as usize, span.size[1] as usize);
    if first > 0 {
        act(span.start[0] as usize, &of.data[offset..offset + first]);
    }
    if second > 0 {
        act(span.start[1] as usize, &of.data[offset + first..offset + first + second]);
    }
}

/// Adds `Σ change · q qᵀ` of rows on the same bodies, given by where their numbers lie and their change of weight.
#[inline(always)]
fn add_group<const N: usize>(matrix: &mut [f64], layout: &Layout, data: &[f64], span: &Span, group: [(usize, f64); N]) {
    let (a, b) = (span.size[0] as usize, span.size[1] as usize);
    let weights = group.map(|(_, change)| change);
    let first = group.map(|(offset, _)| &data[offset..offset + a]);
    // Of the rows of a block, from a column on, and how many entries these have.
    let rows_of = |index: usize, column: u32| {
        let block = &layout.blocks()[index];
        (block.offset + column as usize, block.stride as usize)
    };
    let diagonal = |index: usize| layout.blocks()[index].stride - layout.blocks()[index].size;
    if a > 0 {
        let block = layout.block_index(span.start[0]);
        let (at, stride) = rows_of(block, diagonal(block));
        add_block(&mut matrix[at..], stride, first, first, weights, true);
    }
    if b > 0 {
        let second = group.map(|(offset, _)| &data[offset + a..offset + a + b]);
        let block = layout.block_index(span.start[1]);
        let (at, stride) = rows_of(block, layout.column(block, layout.block_index(span.start[0])));
        add_block(&mut matrix[at..], stride, second, first, weights, false);
        let (at, stride) = rows_of(block, diagonal(block));
        add_block(&mut matrix[at..], stride, second, second, weights, true);
    }
}

/// Adds `Σ weight · left rightᵀ`; only up to the diagonal where that is in question and the block is large.
#[inline(always)]
fn add_block<const N: usize>(
    matrix: &mut [f64],
    stride: usize,
    left: [&[f64]; N],
    right: [&[f64]; N],
    weights: [f64; N],
    is_diagonal: bool,
) {
    let sized = |side: [&[f64]; N]| {
        let mut out = [[0.0; 6]; N];
        for (out, side) in out.iter_mut().zip(side) {
            *out = side.try_into().ok()?;
        }
        Some(out)
    };
    if let (Some(left), Some(right)) = (sized(left), sized(right)) {
        for k in 0..6 {
            let row: &mut [f64; 6] = (&mut matrix[k * stride..k * stride + 6]).try_into().expect("six columns");
            for r in 0..N {
                let scale = weights[r] * left[r][k];
                for j in 0..6 {
                    row[j] += scale * right[r][j];
                }
            }
        }
        return;
    }
    let size = left[0].len();
    for k in 0..size {
        let columns = if is_diagonal { k + 1 } else { right[0].len() };
        let row = &mut matrix[k * stride..k * stride + columns];
        let scales: [f64; N] = std::array::from_fn(|r| weights[r] * left[r][k]);
        // Coordinates that are not on the way from the base to the link.
        if scales == [0.0; N] {
            continue;
        }
        let right = right.map(|side| &side[..columns]);
        for (j, entry) in row.iter_mut().enumerate() {
            let mut sum = *entry;
            for r in 0..N {
                sum += scales[r] * right[r][j];
            }
            *entry = sum;
        }
    }
}
