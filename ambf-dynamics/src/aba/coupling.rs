//! Velocities in which the generalised inertia is 1, and linear equations between rates of coordinates.
//!
//! With the generalised inertia H = Lᵀ L and z = L v the kinetic energy is zᵀ z / 2, where v is the base's angular and linear velocity (0
//! if it is fixed) followed by the rates of the coordinates. L has entries along the branches only (Featherstone 2008, section 6.5).

use std::mem::take;

use super::algebra::Vector;
use super::motion::Equations;
use super::Rate;

/// Share of the length of a row for z that is rounding, beside couplings.
const ROUNDING: f64 = 1e-10;

/// A coordinate in a linear equation between rates: the sum of factors times rates is 0. The first of an equation is that of the
/// follower, with the factor 1.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct CoupledCoordinate {
    coordinate: i32,
    factor: f64,
}

#[cfg(test)]
impl From<(i32, f64)> for CoupledCoordinate {
    fn from((coordinate, factor): (i32, f64)) -> Self {
        Self { coordinate, factor }
    }
}

/// The equations, a follower after its leaders, and L.
#[derive(Default)]
pub struct Coupled<'a> {
    pub has_fixed_base: bool,
    /// Of all equations; `ends` has the first that is no more part of each.
    pub terms: &'a [CoupledCoordinate],
    pub ends: &'a [i32],
    /// For each component of v, the previous one on the path to the base; -1: none.
    pub parents: &'a [i32],
    /// L, by rows, and the inverses of its diagonal.
    pub factor: &'a mut [f64],
    pub inverse_diagonal: &'a mut [f64],
    /// Orthonormal rows for z that couplings keep at 0, one after the other; the first `row_count` are there.
    pub rows: &'a mut [f64],
    pub row_count: usize,
    /// Velocities z while rates are coupled.
    pub velocity: &'a mut [f64],
    /// Impulse on one coordinate, as a row for z.
    pub impulse: &'a mut [f64],
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).fold(0.0, |sum, (a, b)| sum + a * b)
}

impl Coupled<'_> {
    /// Whether there are no equations.
    #[inline(always)]
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// The first component of v that is not 0.
    fn first(&self) -> usize {
        if self.has_fixed_base {
            6
        } else {
            0
        }
    }

    /// Gives followers the coordinates that their leaders ask for, rad or m.
    pub fn close(&self, offsets: &[f64], q: &mut [f64]) {
        for (index, offset) in offsets.iter().enumerate() {
            let (follower, leaders) = self.equation(index).split_at(1);
            let part = |sum: f64, term: &CoupledCoordinate| sum - term.factor * q[term.coordinate as usize];
            q[follower[0].coordinate as usize] = leaders.iter().fold(*offset, part);
        }
    }

    fn rows(&self) -> impl Iterator<Item = &[f64]> {
        let n = self.parents.len();
        self.rows[..self.row_count * n].chunks_exact(n.max(1))
    }

    fn equation(&self, index: usize) -> &[CoupledCoordinate] {
        let begin = if index == 0 { 0 } else { self.ends[index - 1] as usize };
        &self.terms[begin..self.ends[index] as usize]
    }

    /// Takes the parts along the rows of couplings out of velocities z.
    fn remove_uncoupled(&self, z: &mut [f64]) {
        for row in self.rows() {
            let part = dot(z, row);
            for (z, row) in z.iter_mut().zip(row) {
                *z -= part * row;
            }
        }
    }

    fn normalise_uncoupled(&self, row: &mut [f64]) {
        let n = self.parents.len();
        for k in (self.first()..n).rev() {
            if row[k] == 0.0 {
                continue;
            }
            row[k] *= self.inverse_diagonal[k];
            let mut j = self.parents[k];
            while let Ok(parent) = usize::try_from(j) {
                row[parent] -= self.factor[k * n + parent] * row[k];
                j = self.parents[parent];
            }
        }
    }

    /// Finds the rows of the couplings for z, made orthonormal by Gram and Schmidt's method. The rows of those whose joints nothing can
    /// move are left out.
    fn find_space(&mut self) {
        let n = self.parents.len();
        self.row_count = 0;
        let row = take(&mut self.velocity);
        for index in 0..self.ends.len() {
            row.fill(0.0);
            for term in self.equation(index) {
                row[6 + term.coordinate as usize] += term.factor;
            }
            self.normalise_uncoupled(row);
            let before = dot(row, row).sqrt();
            // The second time removes what rounding left of the first.
            self.remove_uncoupled(row);
            self.remove_uncoupled(row);
            let after = dot(row, row).sqrt();
            if after > ROUNDING * before {
                let place = &mut self.rows[self.row_count * n..][..n];
                place.iter_mut().zip(&*row).for_each(|(place, row)| *place = row / after);
                self.row_count += 1;
            }
        }
        self.velocity = row;
    }

    /// Transforms a row J of the Jacobian of v into J L⁻¹, the row for z. It is also the response of z to a unit impulse of the row.
    pub fn normalise(&self, row: &mut [f64]) {
        // What is left is rounding where the couplings hold what the row would move.
        self.normalise_uncoupled(row);
        if self.row_count == 0 {
            return;
        }
        let before = dot(row, row);
        self.remove_uncoupled(row);
        if dot(row, row) <= ROUNDING * ROUNDING * before {
            row.fill(0.0);
        }
    }

    /// Acceleration of a coordinate by a unit force on it: the diagonal of the inverse inertia. The base and all other coordinates are free
    /// to move: a light parent of a heavy link moves instead of the link.
    pub fn response(&mut self, coordinate: usize) -> f64 {
        let row = take(&mut self.impulse);
        row.fill(0.0);
        row[6 + coordinate] = 1.0;
        self.normalise(row);
        let sum = dot(row, row);
        self.impulse = row;
        sum
    }

    /// v of z.
    pub fn rates_of(&self, z: &[f64], rate: &mut Rate<'_, f64>) {
        let n = z.len();
        let mut base = [0.0; 6];
        for k in self.first()..n {
            let mut sum = z[k];
            let mut j = self.parents[k];
            while let Ok(parent) = usize::try_from(j) {
                let of_parent = if parent < 6 { base[parent] } else { rate.q[parent - 6] };
                sum -= self.factor[k * n + parent] * of_parent;
                j = self.parents[parent];
            }
            let found = sum * self.inverse_diagonal[k];
            if k < 6 {
                base[k] = found;
            } else {
                rate.q[k - 6] = found;
            }
        }
        rate.angular = Vector::new(base[0], base[1], base[2]);
        rate.linear = Vector::new(base[3], base[4], base[5]);
    }

    /// z of v.
    pub fn coordinates_of(&self, rate: &Rate<'_, f64>, z: &mut [f64]) {
        let n = z.len();
        for (k, z) in z.iter_mut().enumerate() {
            *z = 0.0;
            if k < self.first() {
                continue;
            }
            let mut j = k as i32;
            while let Ok(at) = usize::try_from(j) {
                *z += self.factor[k * n + at] * component(rate, at);
                j = self.parents[at];
            }
        }
    }
}

/// A component of v.
fn component(rate: &Rate<'_, f64>, k: usize) -> f64 {
    let base = [rate.angular.x, rate.angular.y, rate.angular.z, rate.linear.x, rate.linear.y, rate.linear.z];
    if k < 6 {
        base[k]
    } else {
        rate.q[k - 6]
    }
}

impl Equations<'_, '_, f64> {
    /// Factors the generalised inertia. Poses and velocities are up to date. The functions below use L.
    pub fn factor_inertia(&mut self) {
        self.tree.factor(self.coupled.factor, self.coupled.inverse_diagonal);
        if !self.coupled.is_empty() {
            self.coupled.find_space();
        }
    }

    /// Finds the rates, or accelerations, in which the couplings hold and of which the difference from those given has the least kinetic
    /// energy (Gauss's principle of least constraint).
    pub(super) fn couple(&mut self, rate: &mut Rate<'_, f64>) {
        self.factor_inertia();
        let z = take(&mut self.coupled.velocity);
        self.coupled.coordinates_of(rate, z);
        self.coupled.remove_uncoupled(z);
        self.coupled.rates_of(z, rate);
        self.coupled.velocity = z;
        // But for rounding errors they are so already.
        for index in 0..self.coupled.ends.len() {
            let equation = self.coupled.equation(index);
            let leaders = equation[1..].iter();
            let sum = leaders.fold(0.0, |sum, term| sum + term.factor * rate.q[term.coordinate as usize]);
            rate.q[equation[0].coordinate as usize] = -sum;
        }
    }
}
