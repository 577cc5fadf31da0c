//! The matrix `A = J M⁻¹ Jᵀ` of a problem, without CFM.

use super::layout::Layout;
use super::problem::{Rows, StoredSide};
use super::vector::dot_velocity;
use multiversion::multiversion;

/// Lower triangle of `A`, stored by envelope: see [`Layout`].
#[derive(Debug, Default)]
pub(super) struct Matrix {
    pub entries: Vec<f64>,
    pub diagonal: Vec<f64>,
    /// Sides of rows by body, each with its place: `sides[start[b]..next[b]]` are those entered so far.
    sides: Vec<(u32, StoredSide)>,
    start: Vec<u32>,
    next: Vec<u32>,
    assembled: bool,
}

impl Matrix {
    /// Finds the diagonal only; sweeps need no more.
    pub fn begin(&mut self, rows: &Rows, layout: &Layout) {
        self.assembled = false;
        self.diagonal.clear();
        for &row in &layout.order {
            let [a, b] = rows.rows[row as usize].sides;
            let mut sum = 0.0;
            for of in [a, b] {
                for by in [a, b] {
                    if of.is_some() && of.body == by.body {
                        sum += dot_velocity(of.jacobian(&rows.data), by.response(&rows.data));
                    }
                }
            }
            self.diagonal.push(sum);
        }
    }

    pub fn is_assembled(&self) -> bool {
        self.assembled
    }

    /// Finds all entries; only pairs of rows that share a body are visited.
    pub fn assemble(&mut self, rows: &Rows, layout: &Layout) {
        if self.assembled {
            return;
        }
        self.assembled = true;
        self.list_sides(rows, layout);
        self.entries.clear();
        self.entries.resize(layout.start[layout.order.len()], 0.0);
        fill(self, rows, layout);
    }

    #[inline(always)]
    fn fill(&mut self, rows: &Rows, layout: &Layout) {
        for (p, &row) in layout.order.iter().enumerate() {
            let entries = &mut self.entries[layout.start[p]..layout.start[p + 1]];
            let first = layout.first[p];
            let sides = rows.rows[row as usize].sides;
            for of in sides.iter().filter(|side| side.is_some()) {
                let body = of.body as usize;
                let jacobian = of.jacobian(&rows.data);
                for (q, by) in &self.sides[self.start[body] as usize..self.next[body] as usize] {
                    entries[(q - first) as usize] += dot_velocity(jacobian, by.response(&rows.data));
                }
            }
            let last = entries.len() - 1;
            entries[last] = self.diagonal[p];
            for side in sides.into_iter().filter(StoredSide::is_some) {
                let at = &mut self.next[side.body as usize];
                self.sides[*at as usize] = (p as u32, side);
                *at += 1;
            }
        }
    }

    fn list_sides(&mut self, rows: &Rows, layout: &Layout) {
        self.start.clear();
        self.start.resize(layout.bodies() + 1, 0);
        let mut count = 0;
        for side in rows.rows.iter().flat_map(|row| &row.sides).filter(|side| side.is_some()) {
            self.start[side.body as usize + 1] += 1;
            count += 1;
        }
        for body in 0..layout.bodies() {
            self.start[body + 1] += self.start[body];
        }
        self.next.clear();
        self.next.extend_from_slice(&self.start);
        self.sides.resize(count, (0, StoredSide::NONE));
    }
}

/// [`Matrix::fill`].
#[multiversion(targets("x86_64+avx2"))]
fn fill(matrix: &mut Matrix, rows: &Rows, layout: &Layout) {
    matrix.fill(rows, layout);
}
