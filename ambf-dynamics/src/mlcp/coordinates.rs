//! Velocity coordinates of each body in which its mass matrix is the identity.
//!
//! `M` is not given, only rows of `J` and their responses `R = M⁻¹ Jᵀ`. The rows of a body are made orthonormal in the
//! inner product `a M⁻¹ bᵀ` by Gram and Schmidt's method: `G M⁻¹ Gᵀ = 1`. With `q = G R` of each row, `A = J R = Qᵀ Q`.
//! Where all responses of a body are its Jacobians, these are the coordinates.

use super::layout::Layout;
use super::problem::{Rows, StoredRow};
use super::vector::{add_scaled, dot_velocity};

/// Share of its square that a row must have outside of the basis to extend it at first sight.
const INDEPENDENT: f64 = 1e-3;
/// Share below which it counts as within the basis.
const WITHIN: f64 = 1e-14;

/// Which ones of all coordinates those of one row are.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Span {
    /// First coordinate of each side, the side whose body comes first in front.
    pub start: [u32; 2],
    /// Coordinates of each side; 0: none.
    pub size: [u32; 2],
}

impl Span {
    pub fn len(&self) -> usize {
        (self.size[0] + self.size[1]) as usize
    }
}

/// The rows `q` of a problem, by place. Their numbers are in [`Rows::data`].
#[derive(Debug, Default)]
pub(super) struct Coordinates {
    pub spans: Vec<Span>,
    /// Where each row's numbers begin.
    pub offsets: Vec<usize>,
    /// `G` of all bodies, a square matrix by rows for each, and where each begins.
    basis: Vec<f64>,
    basis_start: Vec<usize>,
    rank: Vec<u32>,
    /// Sides of rows whose independence is doubtful: place, side, where their coordinates are.
    postponed: Vec<(u32, usize, usize)>,
    jacobian: Vec<f64>,
    response: Vec<f64>,
    found: bool,
}

impl Coordinates {
    /// To be called where the rows change.
    pub fn reset(&mut self) {
        self.found = false;
    }

    pub fn are_found(&self) -> bool {
        self.found
    }

    /// Finds the coordinates of all rows.
    pub fn find(&mut self, rows: &mut Rows, layout: &Layout) {
        if self.found {
            return;
        }
        self.found = true;
        self.begin(layout);
        rows.begin_coordinates();
        let Rows { rows, data, .. } = rows;
        for (p, &index) in layout.order.iter().enumerate() {
            let row = &rows[index as usize];
            let (sides, span) = ordered_sides(row, layout);
            let mut at = data.len();
            self.offsets.push(at);
            self.spans.push(span);
            data.resize(at + span.len(), 0.0);
            for (side, &size) in sides.into_iter().zip(&span.size) {
                if size == 0 {
                    continue;
                }
                if layout.is_unit[row.sides[side].body as usize] {
                    copy_side(data, row, side, at);
                } else if !self.add_side(data, row, side, at, INDEPENDENT) {
                    self.postponed.push((p as u32, side, at));
                }
                at += size as usize;
            }
        }
        for i in 0..self.postponed.len() {
            let (p, side, at) = self.postponed[i];
            self.add_side(data, &rows[layout.order[p as usize] as usize], side, at, WITHIN);
        }
    }

    fn begin(&mut self, layout: &Layout) {
        self.spans.clear();
        self.offsets.clear();
        self.postponed.clear();
        self.rank.clear();
        self.rank.resize(layout.bodies(), 0);
        self.basis_start.clear();
        let mut end = 0;
        for (body, &start) in layout.coordinate_start.iter().enumerate() {
            self.basis_start.push(end);
            if start != u32::MAX && !layout.is_unit[body] {
                let size = layout.velocity_start[body + 1] - layout.velocity_start[body];
                end += size * size;
            }
        }
        if self.basis.len() < end {
            self.basis.resize(end, 0.0);
        }
    }

    /// Finds the coordinates of one side, and extends the basis where it is independent of it by more than `least`.
    /// Returns `false` where it lies outside of the basis by less.
    fn add_side(&mut self, data: &mut [f64], row: &StoredRow, side: usize, at: usize, least: f64) -> bool {
        let of = &row.sides[side];
        let (body, size) = (of.body as usize, of.size as usize);
        let (data, q) = data.split_at_mut(at);
        let q = &mut q[..size];
        let (mut jacobian, mut response) = (of.jacobian(data), of.response(data));
        let other = &row.sides[1 - side];
        if other.body == of.body {
            self.jacobian.clear();
            self.jacobian.extend(jacobian.iter().zip(other.jacobian(data)).map(|(a, b)| a + b));
            self.response.clear();
            self.response.extend(response.iter().zip(other.response(data)).map(|(a, b)| a + b));
            (jacobian, response) = (&self.jacobian, &self.response);
        }
        let rank = self.rank[body] as usize;
        let basis = &mut self.basis[self.basis_start[body]..][..size * size];
        for (q, g) in q.iter_mut().zip(basis.chunks_exact(size)).take(rank) {
            *q = dot_velocity(g, response);
        }
        if rank == size {
            return true;
        }
        let whole = dot_velocity(jacobian, response);
        let rest = whole - q[..rank].iter().map(|q| q * q).sum::<f64>();
        if rest <= WITHIN * whole {
            return true;
        }
        if rest <= least * whole {
            return false;
        }
        let length = rest.sqrt();
        let (known, new) = basis.split_at_mut(rank * size);
        let new = &mut new[..size];
        new.copy_from_slice(jacobian);
        for (q, g) in q.iter().zip(known.chunks_exact(size)) {
            add_scaled(new, -q, g);
        }
        new.iter_mut().for_each(|value| *value /= length);
        q[rank] = length;
        self.rank[body] += 1;
        true
    }
}

/// Takes the Jacobian of one side for its coordinates.
fn copy_side(data: &mut [f64], row: &StoredRow, side: usize, at: usize) {
    let (of, other) = (&row.sides[side], &row.sides[1 - side]);
    let (data, q) = data.split_at_mut(at);
    let q = &mut q[..of.size as usize];
    q.copy_from_slice(of.jacobian(data));
    if other.body == of.body {
        q.iter_mut().zip(other.jacobian(data)).for_each(|(q, value)| *q += value);
    }
}

/// Sides of a row in the order of their coordinates. Of two sides on the same body the second one is part of the first.
fn ordered_sides(row: &StoredRow, layout: &Layout) -> ([usize; 2], Span) {
    let mut span = Span::default();
    for (k, side) in row.sides.iter().enumerate() {
        if side.is_some() && !(k == 1 && side.body == row.sides[0].body) {
            span.start[k] = layout.coordinate_start[side.body as usize];
            span.size[k] = side.size;
        }
    }
    if span.size[0] == 0 || (span.size[1] > 0 && span.start[1] < span.start[0]) {
        span.start.swap(0, 1);
        span.size.swap(0, 1);
        return ([1, 0], span);
    }
    ([0, 1], span)
}
