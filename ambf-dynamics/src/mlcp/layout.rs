//! Order of the rows and envelope of their matrix; order of the bodies and blocks of their matrix.
//!
//! Bodies are numbered by breadth-first search (Cuthill and McKee 1969) that starts at the far end of another one; a
//! row stands with the later of its bodies. The envelope of a chain is then as wide as one joint, and a factorisation
//! costs time linear in its length. In velocity space bodies have another order, by minimum degree: a factorisation costs
//! time linear in the number of bodies of a tree.

use super::elimination::Elimination;
use super::problem::{Rows, StoredRow, StoredSide};

/// Multiplications by rows that take the time of one in velocity space. There each solution is refined, by one or two more
/// solutions; measured on chains with contacts, where both take about as many multiplications.
const VELOCITY_PENALTY: f64 = 2.0;

/// The coordinates of one body in the matrix of the factorisation in velocity space.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Block {
    /// First coordinate of the body, and how many it has.
    pub start: u32,
    pub size: u32,
    /// Entries in each of its rows of the factor: those of the blocks on its left, then its own.
    pub stride: u32,
    /// Where its entries begin.
    pub offset: usize,
    /// Where the blocks on its left, and those below it, begin.
    left: u32,
    below: u32,
}

/// A block of the factor beside the diagonal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Beside {
    /// Block of the body that shares it.
    pub block: u32,
    /// Where its columns begin in the rows of the later one of the two.
    pub column: u32,
}

/// Rows are numbered by *place* here, which is their position in the matrix.
#[derive(Debug, Default)]
pub(super) struct Layout {
    /// Where the velocity of each body begins, and the end of the last.
    pub velocity_start: Vec<usize>,
    /// Index of the row at each place.
    pub order: Vec<u32>,
    /// Place of each row.
    pub place: Vec<u32>,
    /// First place of each row's envelope.
    pub first: Vec<u32>,
    /// Where the row's entries begin; they end with the diagonal. One more than rows.
    pub start: Vec<usize>,
    /// Multiplications of a factorisation of all rows, and of the assembly of the matrix.
    pub factor_cost: f64,
    pub assembly_cost: f64,
    /// Multiplications to find the velocity of every row, or to apply every impulse.
    pub pass_cost: f64,
    /// First coordinate of each body in velocity space, `u32::MAX` for bodies without rows; and how many there are in
    /// all.
    pub coordinate_start: Vec<u32>,
    pub coordinates: usize,
    /// Bodies with rows, in the order of their coordinates, and where the lists of one more would begin.
    blocks: Vec<Block>,
    /// Blocks of the factor that are not 0: of each body those in its rows, and those in its columns.
    left: Vec<Beside>,
    below: Vec<Beside>,
    elimination: Elimination,
    /// Entries of the matrix in velocity space.
    pub coordinate_entries: usize,
    /// Multiplications to find the coordinates of all rows, to add all rows to the matrix in velocity space, and to
    /// factor it.
    pub coordinate_cost: f64,
    pub scatter_all_cost: f64,
    pub coordinate_factor_cost: f64,
    /// Block of each coordinate's body.
    block_of: Vec<u32>,
    /// Multiplications to add the row at each place to the matrix in velocity space.
    scatter: Vec<f64>,
    /// Whether the mass matrix of each body is the identity: all its responses are its Jacobians.
    pub is_unit: Vec<bool>,
    /// Sizes of the bodies, and body, size and components that are not 0 of each side of the rows, that were arranged.
    arranged_bodies: Vec<usize>,
    arranged: Vec<[(i32, u32, Option<u32>); 2]>,
    body_place: Vec<i32>,
    queue: Vec<u32>,
    neighbours: Vec<u32>,
    neighbour_start: Vec<u32>,
    scratch: Vec<u32>,
}

impl Layout {
    pub fn bodies(&self) -> usize {
        self.velocity_start.len() - 1
    }

    pub fn set_bodies(&mut self, rigid: usize, articulations: impl Iterator<Item = usize>) {
        self.velocity_start.clear();
        self.velocity_start.extend((0..=rigid).map(|body| 6 * body));
        let mut end = 6 * rigid;
        for size in articulations {
            end += size;
            self.velocity_start.push(end);
        }
    }

    /// Orders the rows. Mostly they have the same sides as in the sub-step before, and so the same order.
    pub fn arrange(&mut self, rows: &Rows) {
        let sides = |row: &StoredRow| row.sides.map(|side| (side.body, side.size, side.nonzeros));
        let is_same = self.arranged_bodies == self.velocity_start
            && self.arranged.len() == rows.rows.len()
            && self.arranged.iter().zip(&rows.rows).all(|(before, row)| *before == sides(row));
        if is_same {
            return;
        }
        self.arranged_bodies.clone_from(&self.velocity_start);
        self.arranged.clear();
        self.arranged.extend(rows.rows.iter().map(sides));
        self.find_unit_bodies(&rows.rows);
        if let Some((body, size)) = lone_body(&rows.rows) {
            self.arrange_lone(&rows.rows, body, size);
        } else {
            self.arrange_all(rows);
        }
    }

    fn arrange_all(&mut self, rows: &Rows) {
        self.find_neighbours(&rows.rows);
        self.order_bodies();
        self.order_rows(&rows.rows);
        self.find_envelope(&rows.rows);
        self.find_blocks(&rows.rows);
    }

    fn find_unit_bodies(&mut self, rows: &[StoredRow]) {
        self.is_unit.clear();
        self.is_unit.resize(self.bodies(), true);
        for side in rows.iter().flat_map(|row| &row.sides).filter(|side| side.is_some()) {
            self.is_unit[side.body as usize] &= side.nonzeros.is_some();
        }
    }

    /// Whether velocity space is the cheaper one for two factorisations of all rows, of velocities and of positions.
    pub fn prefers_velocities(&self) -> bool {
        let by_velocities = self.coordinate_cost + 2.0 * (self.scatter_all_cost + self.coordinate_factor_cost);
        VELOCITY_PENALTY * by_velocities < self.assembly_cost + 2.0 * self.factor_cost
    }

    /// Multiplications of a factorisation of all rows.
    pub fn least_factor_cost(&self) -> f64 {
        if self.prefers_velocities() {
            self.scatter_all_cost + self.coordinate_factor_cost
        } else {
            self.factor_cost
        }
    }

    /// Multiplications to add the row at a place to the matrix in velocity space.
    pub fn scatter_cost(&self, place: usize) -> f64 {
        self.scatter[place]
    }

    /// Bodies with rows, in the order of their coordinates.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks[..self.blocks.len() - 1]
    }

    /// Index of the block that begins at a coordinate.
    pub fn block_index(&self, coordinate: u32) -> usize {
        self.block_of[coordinate as usize] as usize
    }

    /// Blocks before this one that share a block of the factor with it, in their order: those in its rows.
    pub fn left(&self, block: usize) -> &[Beside] {
        &self.left[self.blocks[block].left as usize..self.blocks[block + 1].left as usize]
    }

    /// Where the columns of an earlier block begin in the rows of this one, on which a row acts, too.
    pub fn column(&self, block: usize, earlier: usize) -> u32 {
        let left = self.left(block);
        let at = left.partition_point(|beside| (beside.block as usize) < earlier);
        left[at].column
    }

    /// Those after this one: in its columns.
    pub fn below(&self, block: usize) -> &[Beside] {
        &self.below[self.blocks[block].below as usize..self.blocks[block + 1].below as usize]
    }

    /// The same for rows that all act on one body: their order is given, and all entries of the matrix are within the
    /// envelope.
    fn arrange_lone(&mut self, of: &[StoredRow], body: usize, size: u32) {
        let rows = of.len();
        self.order.clear();
        self.order.extend(0..rows as u32);
        self.place.clear();
        self.place.extend(0..rows as u32);
        self.first.clear();
        self.first.resize(rows, 0);
        self.start.clear();
        self.start.extend((0..=rows).map(|p| p * (p + 1) / 2));
        self.scatter.clear();
        self.scatter.extend(of.iter().map(|row| scatter_cost(row, self.is_unit[body])));
        self.coordinate_start.clear();
        self.coordinate_start.resize(self.bodies(), u32::MAX);
        self.coordinate_start[body] = 0;
        self.coordinates = size as usize;
        self.block_of.clear();
        self.block_of.resize(size as usize, 0);
        self.blocks.clear();
        self.left.clear();
        self.below.clear();
        self.blocks.push(Block { size, stride: size, ..Block::default() });
        self.blocks.push(Block { start: size, ..Block::default() });
        let (n, d) = (rows as f64, f64::from(size));
        self.factor_cost = row_costs(n);
        self.assembly_cost = d * n * (n + 1.0) / 2.0;
        self.pass_cost = d * n;
        self.coordinate_entries = (size * size) as usize;
        self.coordinate_cost = if self.is_unit[body] { 0.0 } else { d * d * n };
        self.scatter_all_cost = self.scatter.iter().sum();
        self.coordinate_factor_cost = row_costs(d);
    }

    fn find_neighbours(&mut self, rows: &[StoredRow]) {
        let pair = |row: &StoredRow| (row.sides[0].body, row.sides[1].body);
        let joins = |(a, b): (i32, i32)| a >= 0 && b >= 0 && a != b;
        // Consecutive rows mostly join the same bodies; one edge is enough.
        let is_edge = |i: usize| joins(pair(&rows[i])) && !(i > 0 && pair(&rows[i]) == pair(&rows[i - 1]));
        let bodies = self.bodies();
        self.neighbour_start.clear();
        self.neighbour_start.resize(bodies + 1, 0);
        for i in (0..rows.len()).filter(|&i| is_edge(i)) {
            for side in &rows[i].sides {
                self.neighbour_start[side.body as usize + 1] += 1;
            }
        }
        for body in 0..bodies {
            self.neighbour_start[body + 1] += self.neighbour_start[body];
        }
        self.neighbours.clear();
        self.neighbours.resize(self.neighbour_start[bodies] as usize, 0);
        self.scratch.clear();
        self.scratch.extend_from_slice(&self.neighbour_start);
        for i in (0..rows.len()).filter(|&i| is_edge(i)) {
            let (a, b) = (rows[i].sides[0].body as usize, rows[i].sides[1].body as usize);
            for (from, to) in [(a, b), (b, a)] {
                self.neighbours[self.scratch[from] as usize] = to as u32;
                self.scratch[from] += 1;
            }
        }
    }

    fn order_bodies(&mut self) {
        let bodies = self.bodies();
        self.body_place.clear();
        self.body_place.resize(bodies, -1);
        self.queue.clear();
        for body in 0..bodies {
            if self.body_place[body] >= 0 {
                continue;
            }
            let begin = self.queue.len();
            self.search(body);
            let far_end = self.queue[self.queue.len() - 1] as usize;
            for at in begin..self.queue.len() {
                self.body_place[self.queue[at] as usize] = -1;
            }
            self.queue.truncate(begin);
            self.search(far_end);
        }
    }

    fn search(&mut self, from: usize) {
        let mut at = self.queue.len();
        self.body_place[from] = at as i32;
        self.queue.push(from as u32);
        while at < self.queue.len() {
            let body = self.queue[at] as usize;
            for k in self.neighbour_start[body]..self.neighbour_start[body + 1] {
                let next = self.neighbours[k as usize];
                if self.body_place[next as usize] < 0 {
                    self.body_place[next as usize] = self.queue.len() as i32;
                    self.queue.push(next);
                }
            }
            at += 1;
        }
    }

    /// Counting sort, which keeps the rows of a pair of bodies in their order.
    fn order_rows(&mut self, rows: &[StoredRow]) {
        let body_place = &self.body_place;
        let key = |row: &StoredRow| {
            let places = row.sides.iter().map(|side| if side.is_some() { body_place[side.body as usize] } else { 0 });
            places.max().unwrap_or(0) as usize
        };
        let next = &mut self.scratch;
        next.clear();
        next.resize(body_place.len().max(1) + 1, 0);
        for row in rows {
            next[key(row) + 1] += 1;
        }
        for k in 1..next.len() {
            next[k] += next[k - 1];
        }
        self.order.clear();
        self.order.resize(rows.len(), 0);
        self.place.clear();
        for (i, row) in rows.iter().enumerate() {
            let at = &mut next[key(row)];
            self.order[*at as usize] = i as u32;
            self.place.push(*at);
            *at += 1;
        }
    }

    /// A row reaches back to the first one that shares a body with it.
    fn find_envelope(&mut self, rows: &[StoredRow]) {
        let bodies = self.bodies();
        // First row of each body, then its count of rows so far.
        let none = rows.len() as u32;
        self.scratch.clear();
        self.scratch.resize(bodies, none);
        self.scratch.resize(2 * bodies, 0);
        self.first.clear();
        self.start.clear();
        self.start.push(0);
        (self.factor_cost, self.assembly_cost, self.pass_cost) = (0.0, 0.0, 0.0);
        let mut size = 0;
        for p in 0..rows.len() {
            let mut reach = p as u32;
            for side in rows[self.order[p] as usize].sides.iter().filter(|side| side.is_some()) {
                let body = side.body as usize;
                self.scratch[body] = self.scratch[body].min(p as u32);
                reach = reach.min(self.scratch[body]);
                self.scratch[bodies + body] += 1;
                self.assembly_cost += f64::from(side.size) * f64::from(self.scratch[bodies + body]);
                self.pass_cost += f64::from(side.size);
            }
            self.first.push(reach);
            let width = p - reach as usize + 1;
            size += width;
            self.start.push(size);
            self.factor_cost += (width * width) as f64 / 2.0;
        }
    }

    /// Numbers the coordinates of velocity space and finds which blocks of the factor are not 0.
    fn find_blocks(&mut self, rows: &[StoredRow]) {
        let bodies = self.bodies();
        self.scatter.clear();
        self.coordinate_start.clear();
        self.coordinate_start.resize(bodies, u32::MAX);
        (self.coordinate_cost, self.scatter_all_cost) = (0.0, 0.0);
        for p in 0..self.order.len() {
            let row = &rows[self.order[p] as usize];
            let mut is_unit = true;
            for side in row.sides.iter().filter(|side| side.is_some()) {
                self.coordinate_start[side.body as usize] = 0;
                if !self.is_unit[side.body as usize] {
                    is_unit = false;
                    self.coordinate_cost += f64::from(side.size) * f64::from(side.size);
                }
            }
            let cost = scatter_cost(row, is_unit);
            self.scatter.push(cost);
            self.scatter_all_cost += cost;
        }
        let (velocity_start, coordinate_start) = (&self.velocity_start, &self.coordinate_start);
        let size = |body: usize| (velocity_start[body + 1] - velocity_start[body]) as u32;
        let has_rows = |body: usize| coordinate_start[body] != u32::MAX;
        self.elimination.find(&self.neighbours, &self.neighbour_start, has_rows, size);
        self.blocks.clear();
        self.block_of.clear();
        let mut start = 0;
        for (k, &body) in self.elimination.order.iter().enumerate() {
            let body = body as usize;
            self.coordinate_start[body] = start;
            let size = (self.velocity_start[body + 1] - self.velocity_start[body]) as u32;
            self.block_of.resize((start + size) as usize, k as u32);
            self.blocks.push(Block { start, size, below: self.elimination.start[k], ..Block::default() });
            start += size;
        }
        self.coordinates = start as usize;
        self.blocks.push(Block { start, below: self.elimination.below.len() as u32, ..Block::default() });
        self.find_columns();
    }

    /// Lists the blocks beside the diagonal, of rows and of columns, and counts entries and multiplications.
    fn find_columns(&mut self) {
        let count = self.blocks.len() - 1;
        self.below.clear();
        self.below.extend(self.elimination.below.iter().map(|&body| {
            let block = self.elimination.place(body);
            self.blocks[block as usize + 1].left += 1;
            Beside { block, column: 0 }
        }));
        for k in 0..count {
            self.blocks[k + 1].left += self.blocks[k].left;
        }
        self.left.clear();
        self.left.resize(self.below.len(), Beside { block: 0, column: 0 });
        // How many blocks of each row are listed.
        self.scratch.clear();
        self.scratch.resize(count, 0);
        self.coordinate_factor_cost = 0.0;
        for k in 0..count {
            let Block { size, below, .. } = self.blocks[k];
            let of = &mut self.below[below as usize..self.blocks[k + 1].below as usize];
            of.sort_unstable_by_key(|beside| beside.block);
            let width = f64::from(size);
            let mut above = 0.0;
            for beside in of {
                let row = &mut self.blocks[beside.block as usize];
                beside.column = row.stride;
                row.stride += size;
                let listed = &mut self.scratch[beside.block as usize];
                self.left[(row.left + *listed) as usize] = Beside { block: k as u32, column: beside.column };
                *listed += 1;
                let height = f64::from(row.size);
                self.coordinate_factor_cost += height * width * (above + (width + 1.0) / 2.0 + (height + 1.0) / 2.0);
                above += height;
            }
            self.coordinate_factor_cost += row_costs(width);
        }
        let mut offset = 0;
        for block in &mut self.blocks[..count] {
            block.stride += block.size;
            block.offset = offset;
            offset += block.size as usize * block.stride as usize;
        }
        self.coordinate_entries = offset;
    }
}

/// Multiplications of the Cholesky factorisation of a full matrix with n rows.
fn row_costs(n: f64) -> f64 {
    n * (n + 1.0) * (2.0 * n + 1.0) / 12.0
}

/// Multiplications to add a row to the matrix in velocity space. `is_unit`: its components that are 0 stay so.
fn scatter_cost(row: &StoredRow, is_unit: bool) -> f64 {
    let [a, b] = &row.sides;
    let is_twice = a.is_some() && a.body == b.body;
    let size = if is_twice { a.size } else { a.size + b.size };
    let nonzeros = |side: &StoredSide| side.nonzeros.filter(|_| is_unit).unwrap_or(side.size);
    let lines = (nonzeros(a) + nonzeros(b)).min(size);
    f64::from(lines) * f64::from(size + 1) / 2.0
}

/// The body on which all rows act, each on one side, and its velocity components.
fn lone_body(rows: &[StoredRow]) -> Option<(usize, u32)> {
    let side = |row: &StoredRow| match row.sides {
        [a, b] if a.is_some() && !b.is_some() => Some((a.body, a.size)),
        [a, b] if b.is_some() && !a.is_some() => Some((b.body, b.size)),
        _ => None,
    };
    let first = rows.first().and_then(side)?;
    rows.iter().all(|row| side(row) == Some(first)).then_some((first.0 as usize, first.1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mlcp::{Row, Side};

    #[test]
    fn a_lone_body_is_arranged_like_one_of_many() {
        let mut rows = Rows::default();
        for k in 0..7 {
            let side = Some(Side { body: 1, jacobian: &[1.0; 5], response: &[1.0; 5] });
            rows.add(&Row { sides: if k % 2 == 0 { [side, None] } else { [None, side] }, ..Row::default() });
        }
        let arrange = |rows: &Rows, lone: bool| {
            let mut layout = Layout::default();
            layout.set_bodies(1, [5, 3].into_iter());
            if lone {
                layout.arrange(rows);
            } else {
                layout.find_unit_bodies(&rows.rows);
                layout.arrange_all(rows);
            }
            (layout.arranged, layout.arranged_bodies) = Default::default();
            (layout.queue, layout.neighbours, layout.neighbour_start, layout.body_place, layout.scratch) =
                Default::default();
            layout.elimination = Elimination::default();
            format!("{layout:?}")
        };
        assert_eq!(arrange(&rows, true), arrange(&rows, false));
    }
}
