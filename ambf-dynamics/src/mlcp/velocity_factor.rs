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
use super::layout::Layout;
use super::problem::State;
use super::vector::{add_scaled, dot, dot_velocity, dots};

/// Weight times diagonal of a row beyond which its removal would leave too large an error of rounding in the matrix.
const HEAVY: f64 = 1e8;
/// Rows of the same bodies that are added together.
const GROUP: usize = 4;
/// Velocity components of a rigid body.
const BODY: usize = 6;

/// `1 + Qᵀ W Q` and its Cholesky factor. A row of the matrix holds the columns from the first coordinate of its
/// envelope to the last one of its own body.
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
    pub fn update(&mut self, layout: &Layout, coordinates: &Coordinates, variables: &[Variable]) {
        if !self.anew && self.changes.is_empty() {
            return;
        }
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
                add_group(matrix, layout, &coordinates.data, span, *group);
            }
            _ => group.iter().for_each(|&one| add_group(matrix, layout, &coordinates.data, span, [one])),
        };
        let mut add = |matrix: &mut [f64], p: usize, change: f64| {
            let span = coordinates.spans[p];
            if count == GROUP || span != shared {
                flush(matrix, &group[..count], &shared);
                (count, shared) = (0, span);
            }
            group[count] = (coordinates.offsets[p], change);
            count += 1;
        };
        if self.anew {
            for (p, &weight) in self.wanted.iter().enumerate().filter(|(_, &weight)| weight > 0.0) {
                add(&mut self.matrix, p, weight);
            }
        } else {
            for &p in &self.changes {
                add(&mut self.matrix, p as usize, self.wanted[p as usize] - self.weights[p as usize]);
            }
        }
        flush(&mut self.matrix, &group[..count], &shared);
        std::mem::swap(&mut self.weights, &mut self.wanted);
        self.valid = true;
        let changed = self.changes.iter().filter_map(|&p| coordinates.spans[p as usize].first());
        let first = if self.anew { 0 } else { changed.min().unwrap_or(0) };
        self.factorise(layout, first);
    }

    fn begin(&mut self, layout: &Layout) {
        self.matrix.clear();
        self.matrix.resize(layout.coordinate_entries, 0.0);
        for block in &layout.blocks {
            let (offset, stride, size) = (block.offset, block.stride as usize, block.size as usize);
            for k in 0..size {
                self.matrix[offset + k * stride + stride - size + k] = 1.0;
            }
        }
    }

    /// Finds the factor from the block of the coordinate `first` on: its rows depend on those before them only.
    fn factorise(&mut self, layout: &Layout, first: u32) {
        let block = if first == 0 { 0 } else { layout.block_index(first) };
        // Every entry is written below, or has been.
        self.factor.resize(self.matrix.len(), 0.0);
        self.inverse_diagonal.truncate(layout.blocks.get(block).map_or(0, |block| block.start as usize));
        for (b, block) in layout.blocks.iter().enumerate().skip(block) {
            if block.size as usize == BODY && block.stride > block.size {
                self.factorise_body(layout, b);
            } else {
                self.factorise_rows(layout, b);
            }
        }
    }

    /// The rows of a rigid body, all at a time: they share their envelope but for its end.
    fn factorise_body(&mut self, layout: &Layout, b: usize) {
        let block = &layout.blocks[b];
        let (first, stride) = (block.first as usize, block.stride as usize);
        let (done, rows) = self.factor.split_at_mut(block.offset);
        let from = &self.matrix[block.offset..block.offset + BODY * stride];
        self.columns.clear();
        self.columns.extend((0..stride).map(|c| std::array::from_fn::<_, BODY, _>(|r| from[r * stride + c])));
        // Blocks from the first of the envelope to before this one.
        for before in &layout.blocks[block.first_block as usize..b] {
            let (start, stride) = (before.start as usize, before.stride as usize);
            let low = first.max(before.first as usize);
            for column in start..start + before.size as usize {
                let other = before.offset + (column - start) * stride;
                let other = &done[other + low - before.first as usize..other + column - before.first as usize];
                let (known, open) = self.columns.split_at_mut(column - first);
                let sums = dots(&known[low - first..], |c| other[c]);
                let inverse = self.inverse_diagonal[column];
                open[0].iter_mut().zip(sums).for_each(|(entry, sum)| *entry = (*entry - sum) * inverse);
            }
        }
        let own = stride - BODY;
        for j in 0..BODY {
            let (known, open) = self.columns.split_at_mut(own + j);
            let sums = dots(known, |c| known[c][j]);
            let inverse = inverse_root(open[0][j] - sums[j]);
            self.inverse_diagonal.push(inverse);
            for k in j + 1..BODY {
                open[0][k] = (open[0][k] - sums[k]) * inverse;
            }
        }
        for (r, row) in rows[..BODY * stride].chunks_exact_mut(stride).enumerate() {
            row.iter_mut().zip(&self.columns).for_each(|(entry, column)| *entry = column[r]);
        }
    }

    /// The rows of a body, one after the other.
    fn factorise_rows(&mut self, layout: &Layout, b: usize) {
        let block = &layout.blocks[b];
        let (first, stride, size) = (block.first as usize, block.stride as usize, block.size as usize);
        for k in 0..size {
            let at = block.offset + k * stride;
            let (done, row) = self.factor.split_at_mut(at);
            let row = &mut row[..stride];
            row.copy_from_slice(&self.matrix[at..at + stride]);
            // Blocks from the first of the envelope to this one.
            for before in &layout.blocks[block.first_block as usize..=b] {
                let columns = if before.start == block.start { k } else { before.size as usize };
                let low = first.max(before.first as usize);
                for j in 0..columns {
                    let column = before.start as usize + j;
                    let other = before.offset + j * before.stride as usize;
                    let other = &done[other + low - before.first as usize..other + column - before.first as usize];
                    let (known, open) = row.split_at_mut(column - first);
                    open[0] = (open[0] - dot(&known[low - first..], other)) * self.inverse_diagonal[column];
                }
            }
            let diagonal = stride - size + k;
            let rest = row[diagonal] - dot(&row[..diagonal], &row[..diagonal]);
            self.inverse_diagonal.push(inverse_root(rest));
        }
    }

    /// Replaces the right-hand side of the free rows, in the order of `places`, by their impulses.
    pub fn solve(&mut self, layout: &Layout, coordinates: &Coordinates, unknowns: &mut [f64]) {
        let right = &mut self.right;
        right.clear();
        right.resize(layout.coordinates, 0.0);
        for (&p, b) in self.places.iter().zip(&*unknowns) {
            let p = p as usize;
            let scaled = self.weights[p] * b;
            for_sides(coordinates, p, |start, q| add_scaled_velocity(&mut right[start..start + q.len()], scaled, q));
        }
        for block in &layout.blocks {
            let (first, stride, size) = (block.first as usize, block.stride as usize, block.size as usize);
            for k in 0..size {
                let (row, at) = (block.offset + k * stride, block.start as usize + k);
                let sum = dot(&self.factor[row..row + at - first], &right[first..at]);
                right[at] = (right[at] - sum) * self.inverse_diagonal[at];
            }
        }
        for block in layout.blocks.iter().rev() {
            let (first, stride, size) = (block.first as usize, block.stride as usize, block.size as usize);
            for k in (0..size).rev() {
                let (row, at) = (block.offset + k * stride, block.start as usize + k);
                let value = right[at] * self.inverse_diagonal[at];
                right[at] = value;
                add_scaled(&mut right[first..at], -value, &self.factor[row..row + at - first]);
            }
        }
        for (&p, b) in self.places.iter().zip(unknowns) {
            let p = p as usize;
            let mut rest = *b;
            for_sides(coordinates, p, |start, q| rest -= dot_velocity(q, &right[start..start + q.len()]));
            *b = self.weights[p] * rest;
        }
    }
}

/// Inverse of a diagonal entry of the factor. The eigenvalues are at least 1; less is an error of rounding.
fn inverse_root(rest: f64) -> f64 {
    1.0 / rest.max(0.5).sqrt()
}

#[inline(always)]
fn for_sides(coordinates: &Coordinates, p: usize, mut act: impl FnMut(usize, &[f64])) {
    let (span, offset) = (&coordinates.spans[p], coordinates.offsets[p]);
    let (first, second) = (span.size[0] as usize, span.size[1] as usize);
    if first > 0 {
        act(span.start[0] as usize, &coordinates.data[offset..offset + first]);
    }
    if second > 0 {
        act(span.start[1] as usize, &coordinates.data[offset + first..offset + first + second]);
    }
}

#[inline(always)]
fn add_scaled_velocity(y: &mut [f64], a: f64, x: &[f64]) {
    match (<&mut [f64; 6]>::try_from(&mut *y), <&[f64; 6]>::try_from(x)) {
        (Ok(y), Ok(x)) => add_scaled(y, a, x),
        _ => add_scaled(y, a, x),
    }
}

/// Adds `Σ change · q qᵀ` of rows on the same bodies, given by where their numbers lie and their change of weight.
fn add_group<const N: usize>(matrix: &mut [f64], layout: &Layout, data: &[f64], span: &Span, group: [(usize, f64); N]) {
    let (a, b) = (span.size[0] as usize, span.size[1] as usize);
    let weights = group.map(|(_, change)| change);
    let first = group.map(|(offset, _)| &data[offset..offset + a]);
    if a > 0 {
        let block = layout.block_at(span.start[0]);
        let column = (span.start[0] - block.first) as usize;
        add_block(&mut matrix[block.offset + column..], block.stride as usize, first, first, weights, true);
    }
    if b > 0 {
        let second = group.map(|(offset, _)| &data[offset + a..offset + a + b]);
        let block = layout.block_at(span.start[1]);
        let stride = block.stride as usize;
        let column = (span.start[0] - block.first) as usize;
        add_block(&mut matrix[block.offset + column..], stride, second, first, weights, false);
        let column = (span.start[1] - block.first) as usize;
        add_block(&mut matrix[block.offset + column..], stride, second, second, weights, true);
    }
}

/// Adds `Σ weight · left rightᵀ`; only up to the diagonal where that is in question and the block is large.
#[inline]
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
