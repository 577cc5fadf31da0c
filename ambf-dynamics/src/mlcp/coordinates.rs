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
/// Share below which it counts as within the basis: errors of responses are of this order.
const WITHIN: f64 = 1e-18;

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

/// What is not known yet of a side.
#[derive(Debug, Clone, Copy)]
struct Open {
    /// Coordinates that are known.
    known: usize,
    /// Whether the row may extend the basis where no other does.
    is_doubtful: bool,
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
    /// `M⁻¹ Gᵀ` of all bodies, likewise.
    responses: Vec<f64>,
    /// Sides of rows that were met before the basis was complete: place, side, where their coordinates are.
    open: Vec<(u32, usize, usize, Open)>,
    sums: [Vec<f64>; 2],
    left: Vec<f64>,
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
                } else if let Some(open) = self.add_side(data, row, side, at, INDEPENDENT) {
                    self.open.push((p as u32, side, at, open));
                }
                at += size as usize;
            }
        }
        let of = |p: u32| &rows[layout.order[p as usize] as usize];
        for i in 0..self.open.len() {
            let (p, side, at, open) = self.open[i];
            if open.is_doubtful {
                self.open[i].3.known =
                    self.add_side(data, of(p), side, at, WITHIN).map_or(usize::MAX, |open| open.known);
            }
        }
        // What extended the basis after these rows.
        for i in 0..self.open.len() {
            let (p, side, at, open) = self.open[i];
            self.complete_side(data, of(p), side, at, open.known);
        }
    }

    fn begin(&mut self, layout: &Layout) {
        self.spans.clear();
        self.offsets.clear();
        self.open.clear();
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
            self.responses.resize(end, 0.0);
        }
    }

    /// Finds the coordinates of one side, all that the basis has so far, and extends the basis where the row is independent of
    /// it by more than `least`. Returns what is not known yet of the side; `None`: nothing.
    fn add_side(&mut self, data: &mut [f64], row: &StoredRow, side: usize, at: usize, least: f64) -> Option<Open> {
        let body = row.sides[side].body as usize;
        let size = row.sides[side].size as usize;
        let (data, q) = data.split_at_mut(at);
        let q = &mut q[..size];
        let (jacobian, response) = whole_side(data, row, side, &mut self.sums);
        let rank = self.rank[body] as usize;
        let from = self.basis_start[body];
        let basis = &mut self.basis[from..from + size * size];
        for (q, g) in q.iter_mut().zip(basis.chunks_exact(size)).take(rank) {
            *q = dot_velocity(g, response);
        }
        if rank == size {
            return None;
        }
        let whole = dot_velocity(jacobian, response);
        let rest = whole - q[..rank].iter().map(|q| q * q).sum::<f64>();
        if rest <= least * whole {
            return Some(Open { known: rank, is_doubtful: rest > WITHIN * whole });
        }
        let (known, new) = basis.split_at_mut(rank * size);
        let responses = &mut self.responses[from..from + size * size];
        let (known_responses, new_response) = responses.split_at_mut(rank * size);
        let (new, new_response) = (&mut new[..size], &mut new_response[..size]);
        new.copy_from_slice(jacobian);
        new_response.copy_from_slice(response);
        remove(new, new_response, &q[..rank], known, known_responses);
        // Once more: what is left of the others then is an error of rounding (Giraud et al., Numerische Mathematik 101, 2005).
        self.left.clear();
        self.left.extend(known.chunks_exact(size).map(|g| dot_velocity(g, new_response)));
        remove(new, new_response, &self.left, known, known_responses);
        let rest = dot_velocity(new, new_response);
        if rest <= WITHIN * whole {
            return Some(Open { known: rank, is_doubtful: false });
        }
        let length = rest.sqrt();
        new.iter_mut().for_each(|value| *value /= length);
        new_response.iter_mut().for_each(|value| *value /= length);
        q[rank] = length;
        self.rank[body] += 1;
        (rank + 1 < size).then_some(Open { known: rank + 1, is_doubtful: false })
    }

    /// Finds the coordinates of one side from the `known`-th on.
    fn complete_side(&mut self, data: &mut [f64], row: &StoredRow, side: usize, at: usize, known: usize) {
        let body = row.sides[side].body as usize;
        let size = row.sides[side].size as usize;
        let (data, q) = data.split_at_mut(at);
        let (_, response) = whole_side(data, row, side, &mut self.sums);
        let basis = &self.basis[self.basis_start[body]..][..size * size];
        let rank = self.rank[body] as usize;
        for (q, g) in q.iter_mut().zip(basis.chunks_exact(size)).take(rank).skip(known) {
            *q = dot_velocity(g, response);
        }
    }
}

/// Subtracts multiples of the rows of a basis, and of their responses.
fn remove(row: &mut [f64], response: &mut [f64], multiples: &[f64], basis: &[f64], responses: &[f64]) {
    let size = row.len();
    for (&q, (g, r)) in multiples.iter().zip(basis.chunks_exact(size).zip(responses.chunks_exact(size))) {
        add_scaled(row, -q, g);
        add_scaled(response, -q, r);
    }
}

/// Jacobian and response of a row on the body of one side: in `sums`, if the other side is on the same body.
fn whole_side<'a>(
    data: &'a [f64],
    row: &StoredRow,
    side: usize,
    sums: &'a mut [Vec<f64>; 2],
) -> (&'a [f64], &'a [f64]) {
    let (of, other) = (&row.sides[side], &row.sides[1 - side]);
    if other.body != of.body {
        return (of.jacobian(data), of.response(data));
    }
    let [jacobian, response] = sums;
    jacobian.clear();
    jacobian.extend(of.jacobian(data).iter().zip(other.jacobian(data)).map(|(a, b)| a + b));
    response.clear();
    response.extend(of.response(data).iter().zip(other.response(data)).map(|(a, b)| a + b));
    (jacobian, response)
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
