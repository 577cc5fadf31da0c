//! Questions to voxels: what is nearest, what a moving ball touches first, what a ray meets, how far a structure is.
//!
//! Nothing here allocates. Bricks and voxels are visited from the point outwards, and left out where their distance is
//! above the best found so far (branch and bound); equal distances are decided by the lower index, in the order z, y, x,
//! so that results do not depend on how they are found.

use std::ops::ControlFlow;

use nalgebra::{Point3, Vector3};

use crate::bits::{self, Mask};
use crate::grid::{cell_of, index_of, Brick, Cells, VoxelGrid, CELLS, CHUNK, EDGE};

/// Share of a voxel's edge that the ball of a solid voxel has as radius, where contact is that of balls, as in the C++
/// program's library.
pub const BALL: f64 = 0.7;

/// A voxel, and how far its centre is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Near {
    /// Index along x, y and z.
    pub index: [usize; 3],
    /// From the point to the centre, m.
    pub distance: f64,
}

/// Where a moving ball touches first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// Share of the way, 0 to 1.
    pub part: f64,
    /// Centre of the ball there, m.
    pub center: Point3<f64>,
    /// From the volume to the ball, unit.
    pub normal: Vector3<f64>,
    /// The voxel that is touched.
    pub index: [usize; 3],
}

/// Where a ray enters a solid voxel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// m along the ray.
    pub distance: f64,
    /// The voxel.
    pub index: [usize; 3],
    /// Where the interpolated density reaches that of the surface, m along the ray; within a voxel's diagonal of
    /// [`distance`](Self::distance).
    pub surface: f64,
}

/// How far a point is from a structure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distance {
    /// m; negative inside.
    pub distance: f64,
    /// In which direction the distance grows, unit; zero in the middle of a voxel.
    pub gradient: Vector3<f64>,
    /// The voxel of the structure, inside the one beside it; `None`: what is outside the box.
    pub index: Option<[usize; 3]>,
}

/// Which voxels are looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wanted {
    /// At the surface of what is solid.
    Surface,
    /// Of a label.
    Label(u8),
    /// Of any other label, empty ones included.
    OtherThan(u8),
    /// Not solid.
    Free,
}

/// Which voxels of a brick are wanted.
enum Found {
    All,
    Some(Mask),
}

/// Indices from `low` up to `high`, without it, from `middle` outwards.
fn outward(low: usize, high: usize, middle: usize) -> impl Iterator<Item = usize> {
    let middle = middle.clamp(low, (high - 1).max(low));
    let (mut below, mut above) = (middle, middle);
    std::iter::from_fn(move || {
        // Turns between both sides as long as both have one left.
        if above < high && (above - middle <= middle - below || below == low) {
            above += 1;
            Some(above - 1)
        } else if below > low {
            below -= 1;
            Some(below)
        } else {
            None
        }
    })
}

/// A search for the nearest voxel.
struct Search<'a> {
    grid: &'a VoxelGrid,
    point: [f64; 3],
    /// Voxel in which the point is, or the nearest one.
    middle: [usize; 3],
    wanted: Wanted,
    /// Square of the distance, and place of the voxel in the order z, y, x.
    best: (f64, usize),
    index: Option<[usize; 3]>,
}

impl Search<'_> {
    /// Square of the distance along an axis to the nearest centre of voxels from `low` up to `high`, without it.
    fn gap(&self, axis: usize, low: usize, high: usize) -> f64 {
        let high = high.min(self.grid.size()[axis]);
        let nearest = self.middle[axis].clamp(low, high - 1);
        let gap = self.grid.coordinate(axis, nearest) - self.point[axis];
        gap * gap
    }

    fn is_hopeless(&self, square: f64) -> bool {
        square > self.best.0
    }

    fn chunks(&mut self) {
        let [cx, cy, cz] = self.grid.counts;
        let middle = self.middle.map(|i| i / CHUNK);
        for z in outward(0, cz, middle[2]) {
            let dz = self.gap(2, z * CHUNK, (z + 1) * CHUNK);
            if self.is_hopeless(dz) {
                continue;
            }
            for y in outward(0, cy, middle[1]) {
                let dy = dz + self.gap(1, y * CHUNK, (y + 1) * CHUNK);
                if self.is_hopeless(dy) {
                    continue;
                }
                for x in outward(0, cx, middle[0]) {
                    if !self.is_hopeless(dy + self.gap(0, x * CHUNK, (x + 1) * CHUNK)) {
                        self.bricks([x, y, z]);
                    }
                }
            }
        }
    }

    fn bricks(&mut self, chunk: [usize; 3]) {
        let grid = self.grid;
        let at = (chunk[2] * grid.counts[1] + chunk[1]) * grid.counts[0] + chunk[0];
        let chunk_data = &*grid.chunks[at];
        if self.wanted == Wanted::Surface && chunk_data.surface == bits::NONE {
            return;
        }
        let bricks = grid.size().map(|edge| edge.div_ceil(EDGE));
        let low = chunk.map(|c| c * EDGE);
        let high: [usize; 3] = std::array::from_fn(|axis| (low[axis] + EDGE).min(bricks[axis]));
        let middle = self.middle.map(|i| i / EDGE);
        for z in outward(low[2], high[2], middle[2]) {
            if self.wanted == Wanted::Surface && chunk_data.surface[z - low[2]] == 0 {
                continue;
            }
            let dz = self.gap(2, z * EDGE, (z + 1) * EDGE);
            if self.is_hopeless(dz) {
                continue;
            }
            for y in outward(low[1], high[1], middle[1]) {
                let dy = dz + self.gap(1, y * EDGE, (y + 1) * EDGE);
                if self.is_hopeless(dy) {
                    continue;
                }
                for x in outward(low[0], high[0], middle[0]) {
                    let place = cell_of([x, y, z]);
                    let is_none = self.wanted == Wanted::Surface && !bits::has(&chunk_data.surface, place);
                    if is_none || self.is_hopeless(dy + self.gap(0, x * EDGE, (x + 1) * EDGE)) {
                        continue;
                    }
                    match self.found([x, y, z], &chunk_data.bricks[place]) {
                        Some(Found::All) => {
                            let first = [x, y, z].map(|b| b * EDGE);
                            let nearest = std::array::from_fn(|axis| {
                                let last = (first[axis] + EDGE).min(grid.size()[axis]) - 1;
                                self.middle[axis].clamp(first[axis], last)
                            });
                            self.offer(nearest);
                        }
                        Some(Found::Some(mask)) => self.voxels([x, y, z].map(|b| b * EDGE), &mask),
                        None => {}
                    }
                }
            }
        }
    }

    /// Wanted voxels of a brick; `None`: there is none.
    fn found(&self, at: [usize; 3], brick: &Brick) -> Option<Found> {
        let by_label = |is: &dyn Fn(u8) -> bool| match &brick.cells {
            Cells::Uniform(voxel) => is(voxel.label).then_some(Found::All),
            Cells::Mixed(block) => {
                let mut mask = bits::NONE;
                for (cell, &label) in block.label.iter().enumerate() {
                    mask[cell / 64] |= u64::from(is(label)) << (cell % 64);
                }
                (mask != bits::NONE).then_some(Found::Some(mask))
            }
        };
        match self.wanted {
            Wanted::Surface => brick.surface.as_ref().map(|mask| Found::Some(**mask)),
            Wanted::Label(label) => by_label(&|other| other == label),
            Wanted::OtherThan(label) => by_label(&|other| other != label),
            Wanted::Free => {
                let solid = self.grid.solid_of(at.map(|b| b as i64));
                if solid == bits::NONE {
                    return Some(Found::All);
                }
                let free = solid.map(|word| !word);
                (free != bits::NONE).then_some(Found::Some(free))
            }
        }
    }

    fn voxels(&mut self, first: [usize; 3], mask: &Mask) {
        let size = self.grid.size();
        let squares: [[f64; EDGE]; 3] = std::array::from_fn(|axis| {
            std::array::from_fn(|cell| {
                let gap = self.grid.coordinate(axis, first[axis] + cell) - self.point[axis];
                gap * gap
            })
        });
        let ends: [usize; 3] = std::array::from_fn(|axis| EDGE.min(size[axis] - first[axis]));
        let across = [0, 1].map(|axis| self.gap(axis, first[axis], first[axis] + EDGE));
        let inside = (1_u64 << ends[0]) - 1;
        // Of a row, the cells up to the one in which the point is, and those behind it.
        let before = match self.middle[0].checked_sub(first[0]) {
            Some(middle) => (2_u64 << middle.min(EDGE - 1)) - 1,
            None => 0,
        };
        for (z, &layer) in mask.iter().enumerate().take(ends[2]) {
            let dz = squares[2][z];
            if layer == 0 || self.is_hopeless(dz + across[1] + across[0]) {
                continue;
            }
            for (y, square) in squares[1].iter().enumerate().take(ends[1]) {
                let row = layer >> (EDGE * y) & inside;
                let dy = dz + square;
                if row == 0 || self.is_hopeless(dy + across[0]) {
                    continue;
                }
                // The nearest of each side is nearer than all others of it.
                if let Some(cell) = (row & before).checked_ilog2() {
                    let cell = cell as usize;
                    self.offer_at([first[0] + cell, first[1] + y, first[2] + z], dy + squares[0][cell]);
                }
                if row & !before != 0 {
                    let cell = (row & !before).trailing_zeros() as usize;
                    self.offer_at([first[0] + cell, first[1] + y, first[2] + z], dy + squares[0][cell]);
                }
            }
        }
    }

    fn offer(&mut self, index: [usize; 3]) {
        let mut square = 0.0;
        for axis in [2, 1, 0] {
            let gap = self.grid.coordinate(axis, index[axis]) - self.point[axis];
            square += gap * gap;
        }
        self.offer_at(index, square);
    }

    /// A voxel, and the square of its distance.
    fn offer_at(&mut self, index: [usize; 3], square: f64) {
        if square > self.best.0 {
            return;
        }
        let size = self.grid.size();
        let place = (index[2] * size[1] + index[1]) * size[0] + index[0];
        if (square, place) < self.best {
            (self.best, self.index) = ((square, place), Some(index));
        }
    }
}

impl VoxelGrid {
    /// The solid voxel whose centre is nearest to `point`, at most `most`, m, away.
    pub fn nearest_solid(&self, point: &Point3<f64>, most: f64) -> Option<Near> {
        // In a solid voxel no other centre is nearer. Outside, the nearest one is at the surface.
        match self.index_at(point).filter(|&index| self.is_solid(index)) {
            Some(index) => {
                let distance = (self.center(index) - point).norm();
                (distance <= most).then_some(Near { index, distance })
            }
            None => self.nearest(point, most, Wanted::Surface),
        }
    }

    /// As [`nearest_solid`](Self::nearest_solid); `guess`, where it is solid, bounds the search: the voxel of before,
    /// where a point moves little.
    pub fn nearest_solid_near(&self, point: &Point3<f64>, most: f64, guess: Option<[usize; 3]>) -> Option<Near> {
        let bound = guess.filter(|&index| self.is_solid(index)).map(|index| (self.center(index) - point).norm());
        self.nearest_solid(point, bound.map_or(most, |bound| most.min(bound * (1.0 + 1e-12))))
    }

    /// The solid voxel at a surface whose centre is nearest to `point`, at most `most`, m, away.
    pub fn nearest_surface(&self, point: &Point3<f64>, most: f64) -> Option<Near> {
        self.nearest(point, most, Wanted::Surface)
    }

    /// The voxel in the box that is not solid whose centre is nearest to `point`, at most `most`, m, away.
    pub fn nearest_free(&self, point: &Point3<f64>, most: f64) -> Option<Near> {
        self.nearest(point, most, Wanted::Free)
    }

    fn nearest(&self, point: &Point3<f64>, most: f64, wanted: Wanted) -> Option<Near> {
        if !point.iter().all(|c| c.is_finite()) || most.is_nan() {
            return None;
        }
        let cells = self.to_cells(point);
        let middle = std::array::from_fn(|axis| (cells[axis].max(0.0) as usize).min(self.size()[axis] - 1));
        let best = (most * most, usize::MAX);
        let mut search = Search { grid: self, point: (*point).into(), middle, wanted, best, index: None };
        search.chunks();
        let distance = search.best.0.sqrt();
        search.index.map(|index| Near { index, distance })
    }

    /// How far `point` is from the surface of all solid voxels, or of those of a label: to the nearest centre, less half
    /// an edge of a voxel, and inside to the nearest centre of another voxel. An error of half a voxel is possible, as
    /// voxels are cells. At most `most`, m, away.
    pub fn distance(&self, point: &Point3<f64>, label: Option<u8>, most: f64) -> Option<Distance> {
        let half = 0.5 * self.mean_edge();
        let is_in = self.index_at(point).and_then(|index| self.voxel(index)).is_some_and(|voxel| match label {
            Some(label) => voxel.label == label,
            None => voxel.density >= self.threshold(),
        });
        let of_near = |near: Near, sign: f64| {
            let away = point - self.center(near.index);
            Distance {
                distance: sign * (near.distance - half),
                gradient: sign * away.try_normalize(1e-12).unwrap_or_default(),
                index: Some(near.index),
            }
        };
        if !is_in {
            let wanted = label.map_or(Wanted::Surface, Wanted::Label);
            return self.nearest(point, most + half, wanted).map(|near| of_near(near, 1.0));
        }
        let wanted = label.map_or(Wanted::Free, Wanted::OtherThan);
        let within = self.nearest(point, most + half, wanted).map(|near| of_near(near, -1.0));
        // Beyond the walls of the box everything is empty.
        let edges = 0.5 * self.edges();
        let walls = (0..3).flat_map(|axis| [-1.0, 1.0].map(|sign| (axis, sign)));
        let (axis, sign, depth) = walls
            .map(|(axis, sign)| (axis, sign, edges[axis] - sign * point[axis]))
            .min_by(|a, b| a.2.total_cmp(&b.2))
            .expect("a box has walls");
        let wall = || Distance { distance: -depth, gradient: Vector3::ith(axis, sign), index: None };
        match within {
            Some(within) if -within.distance <= depth => Some(within),
            _ if depth <= most => Some(wall()),
            _ => None,
        }
    }

    /// Geometric mean of a voxel's edges, m.
    pub fn mean_edge(&self) -> f64 {
        self.voxel_volume().cbrt()
    }

    /// Radius of the ball that stands for a solid voxel, m: [`BALL`] of its mean edge.
    pub fn ball(&self) -> f64 {
        BALL * self.mean_edge()
    }

    /// Where the centre of a ball, on its straight way from `from` to `to`, comes first to `reach`, m, of the centre of
    /// a solid voxel at a surface. A ball that begins nearer than that touches at once.
    pub fn sweep(&self, from: &Point3<f64>, to: &Point3<f64>, reach: f64) -> Option<Touch> {
        let way = to - from;
        if !(from.iter().chain(to.iter()).all(|c| c.is_finite()) && reach > 0.0 && reach.is_finite()) {
            return None;
        }
        // Where it begins inside, the nearest voxel decides.
        let start = self.nearest_solid(from, reach).filter(|near| near.distance < reach);
        if let Some(near) = start {
            let away = (from - self.center(near.index)).try_normalize(1e-12);
            let normal = away.or_else(|| (-way).try_normalize(0.0)).unwrap_or_else(Vector3::z);
            return Some(Touch { part: 0.0, center: *from, normal, index: near.index });
        }
        let mut best: (f64, usize) = (1.0, usize::MAX);
        let mut touched = None;
        let size = self.size();
        let length_2 = way.norm_squared();
        self.visit_near(from, to, reach, |first, brick, grid| {
            let Some(mask) = brick.surface.as_deref() else { return ControlFlow::<()>::Continue(()) };
            if entry(grid, first, from, &way, reach) > best.0 {
                return ControlFlow::Continue(());
            }
            for cell in bits::ones(mask) {
                let index = index_of(first, cell);
                let center = grid.center(index);
                let to_start = from - center;
                // |from + t way − c|² = reach², the smaller root.
                let (b, c) = (to_start.dot(&way), to_start.norm_squared() - reach * reach);
                let root = b * b - length_2 * c;
                if b >= 0.0 || root < 0.0 {
                    continue;
                }
                let part = (c / (-b + root.sqrt())).max(0.0);
                let place = (index[2] * size[1] + index[1]) * size[0] + index[0];
                if (part, place) < best {
                    best = (part, place);
                    touched = Some(index);
                }
            }
            ControlFlow::Continue(())
        });
        touched.map(|index| {
            let center = from + way * best.0;
            Touch { part: best.0, center, normal: (center - self.center(index)).normalize(), index }
        })
    }

    /// As [`sweep`](Self::sweep), of a capsule that does not turn, whose ends are at `±half` of its centre, m: the first
    /// touch of its balls and of the cylinder between them.
    pub fn sweep_capsule(
        &self,
        from: &Point3<f64>,
        to: &Point3<f64>,
        half: &Vector3<f64>,
        reach: f64,
    ) -> Option<Touch> {
        let finite = from.iter().chain(to.iter()).chain(half.iter()).all(|c| c.is_finite());
        if !(finite && reach > 0.0 && reach.is_finite()) {
            return None;
        }
        let way = to - from;
        let mut best: Option<(f64, usize, [usize; 3])> = None;
        let size = self.size();
        // Of all solid voxels: it may begin where none of the surface is near.
        let mut visit = |first: [usize; 3], _: &Brick, grid: &Self| {
            for cell in bits::ones(&grid.solid_of(first.map(|i| (i / EDGE) as i64))) {
                let index = index_of(first, cell);
                let Some(part) = capsule_meets(&(grid.center(index) - from), &way, half, reach) else { continue };
                let place = (index[2] * size[1] + index[1]) * size[0] + index[0];
                if best.is_none_or(|(p, at, _)| (part, place) < (p, at)) {
                    best = Some((part, place, index));
                }
            }
            ControlFlow::<()>::Continue(())
        };
        // All bricks near the parallelogram that the axis sweeps.
        let corners = [from - half, from + half, to - half, to + half];
        let low = corners.iter().fold(corners[0], |low, c| low.inf(c));
        let high = corners.iter().fold(corners[0], |high, c| high.sup(c));
        self.visit_box(&low, &high, reach, |first, brick| visit(first, brick, self));
        best.map(|(part, _, index)| {
            let center = from + way * part;
            let offset = self.center(index) - center;
            let along =
                if half.norm_squared() > 0.0 { (offset.dot(half) / half.norm_squared()).clamp(-1.0, 1.0) } else { 0.0 };
            let normal = (half * along - offset).try_normalize(1e-12).unwrap_or_else(Vector3::z);
            Touch { part, center, normal, index }
        })
    }

    /// Solid voxels whose centres are at most `reach`, m, from the segment, in no order that matters.
    pub fn each_solid_near(
        &self,
        from: &Point3<f64>,
        to: &Point3<f64>,
        reach: f64,
        mut visit: impl FnMut([usize; 3], f64),
    ) {
        let way = to - from;
        let length_2 = way.norm_squared();
        let (low, high) = (from.inf(to), from.sup(to));
        let square_reach = reach * reach * (1.0 + 1e-9);
        self.visit_near(from, to, reach, |first, brick, grid| {
            let at = first.map(|i| (i / EDGE) as i64);
            let mask = match (&brick.solid, &brick.cells) {
                (Some(mask), _) => **mask,
                (None, _) => grid.solid_of(at),
            };
            // Rows of voxels of which none can be so near are not looked at, nor the ends of others: the box around the
            // segment is not farther than the segment. Rounding may not hide a voxel.
            let beside = |axis: usize| -> [f64; EDGE] {
                std::array::from_fn(|cell| {
                    let at = grid.coordinate(axis, first[axis] + cell);
                    let gap = (low[axis] - at).max(at - high[axis]).max(0.0);
                    gap * gap
                })
            };
            let (beside_y, beside_z) = (beside(1), beside(2));
            let (start, edge) = (grid.coordinate(0, first[0]), grid.spacing().x);
            for (z, &layer) in mask.iter().enumerate() {
                let in_layer = square_reach - beside_z[z];
                if layer == 0 || in_layer < 0.0 {
                    continue;
                }
                for (y, beside) in beside_y.iter().enumerate() {
                    let row = layer >> (EDGE * y) & 0xff;
                    let in_row = in_layer - beside;
                    if row == 0 || in_row < 0.0 {
                        continue;
                    }
                    let half = in_row.sqrt();
                    // Numbers below 0 become 0.
                    let begin = (((low.x - half - start) / edge + 1.0 - 1e-6) as u32).min(EDGE as u32);
                    let end = (((high.x + half - start) / edge + 1.0 + 1e-6) as u32).min(EDGE as u32);
                    for cell in bits::ones_of(row >> begin << begin & ((1_u64 << end) - 1)) {
                        let index = index_of(first, cell + EDGE * (y + EDGE * z));
                        let offset = grid.center(index) - from;
                        let part = if length_2 > 0.0 { (offset.dot(&way) / length_2).clamp(0.0, 1.0) } else { 0.0 };
                        let square = (offset - way * part).norm_squared();
                        if square <= reach * reach {
                            visit(index, square);
                        }
                    }
                }
            }
            ControlFlow::<()>::Continue(())
        });
    }

    /// Bricks of the box around a thick segment that have something solid and are not farther from it than `reach`.
    fn visit_near<B>(
        &self,
        from: &Point3<f64>,
        to: &Point3<f64>,
        reach: f64,
        mut visit: impl FnMut([usize; 3], &Brick, &Self) -> ControlFlow<B>,
    ) {
        let way = to - from;
        self.visit_box(&from.inf(to), &from.sup(to), reach, |first, brick| {
            match entry(self, first, from, &way, reach) <= 1.0 {
                true => visit(first, brick, self),
                false => ControlFlow::Continue(()),
            }
        });
    }

    /// First and last voxels of what a box, widened by `reach`, has of the grid; `None`: nothing.
    fn cells_of_box(&self, low: &Point3<f64>, high: &Point3<f64>, reach: f64) -> Option<([usize; 3], [usize; 3])> {
        let widened = Vector3::repeat(reach);
        let (low, high) = (self.to_cells(&(low - widened)), self.to_cells(&(high + widened)));
        let size = self.size();
        if (0..3).any(|axis| high[axis] < 0.0 || low[axis] > size[axis] as f64) {
            return None;
        }
        let cell = |c: f64, axis: usize| (c.max(0.0) as usize).min(size[axis] - 1);
        Some((std::array::from_fn(|axis| cell(low[axis], axis)), std::array::from_fn(|axis| cell(high[axis], axis))))
    }

    /// Voxels, solid or not, of the box around a thick segment: an upper bound of what
    /// [`each_solid_near`](Self::each_solid_near) visits.
    pub(crate) fn count_near(&self, from: &Point3<f64>, to: &Point3<f64>, reach: f64) -> usize {
        let cells = self.cells_of_box(&from.inf(to), &from.sup(to), reach);
        cells.map_or(0, |(low, high)| (0..3).map(|axis| high[axis] - low[axis] + 1).product())
    }

    /// Bricks with something solid that a box, widened by `reach`, meets.
    fn visit_box<B>(
        &self,
        low: &Point3<f64>,
        high: &Point3<f64>,
        reach: f64,
        mut visit: impl FnMut([usize; 3], &Brick) -> ControlFlow<B>,
    ) {
        let Some((low, high)) = self.cells_of_box(low, high, reach) else { return };
        let (low, high) = (low.map(|cell| cell / EDGE), high.map(|cell| cell / EDGE));
        let chunk = |range: [usize; 3]| range.map(|b| b / EDGE);
        let (first_chunk, last_chunk) = (chunk(low), chunk(high));
        for cz in first_chunk[2]..=last_chunk[2] {
            for cy in first_chunk[1]..=last_chunk[1] {
                for cx in first_chunk[0]..=last_chunk[0] {
                    let chunk = &self.chunks[(cz * self.counts[1] + cy) * self.counts[0] + cx];
                    if chunk.solid == bits::NONE {
                        continue;
                    }
                    let corner = [cx, cy, cz].map(|c| c * EDGE);
                    let range = |axis: usize| low[axis].max(corner[axis])..=high[axis].min(corner[axis] + EDGE - 1);
                    for z in range(2) {
                        for y in range(1) {
                            for x in range(0) {
                                let place = cell_of([x, y, z]);
                                if bits::has(&chunk.solid, place)
                                    && visit([x, y, z].map(|b| b * EDGE), &chunk.bricks[place]).is_break()
                                {
                                    return;
                                }
                            }
                        }
                    }
                }
            }
        }
    }

    /// The first solid voxel on a ray from `from` in `direction`, at most `most`, m, away. A ray that begins in a solid
    /// voxel meets it at 0.
    pub fn ray(&self, from: &Point3<f64>, direction: &Vector3<f64>, most: f64) -> Option<Hit> {
        let direction = direction.try_normalize(0.0)?;
        if !(from.iter().all(|c| c.is_finite()) && direction.iter().all(|c| c.is_finite()) && most >= 0.0) {
            return None;
        }
        // In voxels from the lower corner; the parameter stays m along the ray.
        let start = self.to_cells(from);
        let step = direction.component_div(&self.spacing());
        let size = self.size();
        let (mut enter, mut leave) = (0.0_f64, most);
        for axis in 0..3 {
            let (a, b) = (-start[axis] / step[axis], (size[axis] as f64 - start[axis]) / step[axis]);
            if step[axis] == 0.0 {
                if !(0.0..size[axis] as f64).contains(&start[axis]) {
                    return None;
                }
            } else {
                (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
            }
        }
        if enter > leave {
            return None;
        }
        let mut at: [usize; 3] =
            std::array::from_fn(|axis| (start[axis] + step[axis] * enter).max(0.0) as usize).map(|i: usize| i);
        at = std::array::from_fn(|axis| at[axis].min(size[axis] - 1));
        let mut distance = enter;
        loop {
            let (chunk, place) = self.place(at.map(|i| i / EDGE));
            let chunk = &self.chunks[chunk];
            let edge = if chunk.solid == bits::NONE {
                CHUNK
            } else if !bits::has(&chunk.solid, place) {
                EDGE
            } else if self.is_solid(at) {
                let surface = self.refine(from, &direction, distance);
                return Some(Hit { distance, index: at, surface });
            } else {
                1
            };
            // Out of the empty block, through the wall that is met first.
            let (mut axis_out, mut out) = (0, f64::INFINITY);
            for axis in 0..3 {
                let low = at[axis] / edge * edge;
                let wall = if step[axis] > 0.0 { low + edge } else { low } as f64;
                let there = (wall - start[axis]) / step[axis];
                if step[axis] != 0.0 && there < out {
                    (axis_out, out) = (axis, there);
                }
            }
            distance = distance.max(out);
            if distance > leave {
                return None;
            }
            for axis in 0..3 {
                let low = at[axis] / edge * edge;
                if axis == axis_out {
                    let next = if step[axis] > 0.0 { (low + edge) as i64 } else { low as i64 - 1 };
                    if next < 0 || next as usize >= size[axis] {
                        return None;
                    }
                    at[axis] = next as usize;
                } else {
                    let high = (low + edge).min(size[axis]) - 1;
                    at[axis] = ((start[axis] + step[axis] * distance).max(0.0) as usize).clamp(low, high);
                }
            }
        }
    }

    /// Where the interpolated density crosses that of the surface, near the entry into a solid voxel.
    fn refine(&self, from: &Point3<f64>, direction: &Vector3<f64>, distance: f64) -> f64 {
        let iso = self.iso_density();
        let reach = self.spacing().norm();
        let is_in = |at: f64| self.density_at(&(from + direction * at)).0 >= iso;
        let steps = 16;
        let at = |step: i32| (distance + reach * f64::from(step - steps / 2) / f64::from(steps / 2)).max(0.0);
        let Some(first) = (1..=steps).find(|&step| !is_in(at(step - 1)) && is_in(at(step))) else { return distance };
        let (mut low, mut high) = (at(first - 1), at(first));
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            if is_in(middle) {
                high = middle;
            } else {
                low = middle;
            }
        }
        0.5 * (low + high)
    }

    /// Density of the surface between solid voxels and others, 0 to 255: between the smallest solid one and the next.
    pub(crate) fn iso_density(&self) -> f64 {
        f64::from(self.threshold()) - 0.5
    }

    /// Where the line from the centre of a solid voxel at the surface to `point`, or, if that is inside, away from it,
    /// leaves what is dense.
    fn on_the_line(&self, center: &Point3<f64>, point: &Point3<f64>, is_in: bool) -> Point3<f64> {
        let iso = self.iso_density();
        let way = if is_in {
            (center - point).try_normalize(1e-12).unwrap_or_else(Vector3::z) * self.spacing().norm()
        } else {
            point - center
        };
        if self.density_at(&(center + way)).0 >= iso {
            return *center;
        }
        // Farther than to the neighbours' centres the voxel reaches nowhere.
        let (mut low, mut high) = (0.0, (self.spacing().norm() / way.norm()).min(1.0));
        if self.density_at(&(center + way * high)).0 >= iso {
            high = 1.0;
        }
        for _ in 0..20 {
            let middle = 0.5 * (low + high);
            if self.density_at(&(center + way * middle)).0 >= iso {
                low = middle;
            } else {
                high = middle;
            }
        }
        center + way * high
    }

    /// Distance from `point` to the surface of interpolated density, and its normal, from the nearest solid voxel: steps
    /// of Newton's method along the gradient, each followed by one along the tangent plane towards the point. At most
    /// `most`, m, from the voxel's centre. Inside it is negative.
    pub fn interpolated_distance(
        &self,
        point: &Point3<f64>,
        most: f64,
        guess: Option<[usize; 3]>,
    ) -> Option<(f64, Vector3<f64>, [usize; 3])> {
        let near = self.nearest_solid_near(point, most, guess)?;
        let is_in = self.density_at(point).0 >= self.iso_density();
        // From inside, the surface is where the nearest solid voxel at it is.
        let near = if is_in { self.nearest_surface(point, f64::INFINITY)? } else { near };
        let center = self.center(near.index);
        let reach = self.spacing().norm();
        let mut foot = center;
        for _ in 0..4 {
            let (density, gradient) = self.density_at(&foot);
            let square = gradient.norm_squared();
            if square < 1e-12 / (reach * reach) {
                break;
            }
            foot += gradient * ((self.iso_density() - density) / square);
            let normal = -gradient / square.sqrt();
            let offset = point - foot;
            foot += offset - normal * normal.dot(&offset);
            let drift = foot - center;
            if drift.norm() > reach {
                foot = center + drift * (reach / drift.norm());
            }
        }
        for _ in 0..3 {
            let (density, gradient) = self.density_at(&foot);
            let square = gradient.norm_squared();
            if square > 1e-12 / (reach * reach) {
                let step = gradient * ((self.iso_density() - density) / square);
                foot += step * (reach / step.norm().max(reach));
            }
        }
        // On the line through the voxel's centre there is a place of the surface, too: where densities jump, the steps
        // may have led away from it.
        let plain = self.on_the_line(&center, point, is_in);
        let (density, gradient) = self.density_at(&foot);
        let off = (self.iso_density() - density).abs() / gradient.norm().max(1e-9);
        let slack = 0.1 * self.spacing().min();
        if off > 0.02 * self.spacing().min() || (point - foot).norm() > (point - plain).norm() + slack {
            foot = plain;
        }
        let (_, gradient) = self.density_at(&foot);
        let offset = point - foot;
        let away = offset.try_normalize(1e-9 * reach).map(|away| if is_in { -away } else { away });
        let normal = away.or_else(|| (-gradient).try_normalize(0.0)).unwrap_or_else(Vector3::z);
        Some((if is_in { -offset.norm() } else { offset.norm() }, normal, near.index))
    }
}

/// Share of a way at which a point comes within `reach` of the centres of a brick's voxels, from below: not later than
/// that. Above 1: never.
fn entry(grid: &VoxelGrid, first: [usize; 3], from: &Point3<f64>, way: &Vector3<f64>, reach: f64) -> f64 {
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for axis in 0..3 {
        let low = grid.coordinate(axis, first[axis]) - reach - from[axis];
        let high = grid.coordinate(axis, (first[axis] + EDGE).min(grid.size()[axis]) - 1) + reach - from[axis];
        if way[axis] == 0.0 {
            if low > 0.0 || high < 0.0 {
                return f64::INFINITY;
            }
            continue;
        }
        let (a, b) = (low / way[axis], high / way[axis]);
        (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
    }
    // Rounding may not hide a voxel at the edge.
    if enter > leave + 1e-9 {
        f64::INFINITY
    } else {
        (enter - 1e-9).max(0.0)
    }
}

/// Share of the way at which a capsule around the origin comes to `reach` of `center`.
fn capsule_meets(center: &Vector3<f64>, way: &Vector3<f64>, half: &Vector3<f64>, reach: f64) -> Option<f64> {
    let first = |a: f64, b: f64, c: f64| {
        // The smaller root of a t² + 2 b t + c in [0, 1], or 0 where it begins below.
        if c <= 0.0 {
            return Some(0.0);
        }
        let root = b * b - a * c;
        (b < 0.0 && root >= 0.0).then(|| c / (-b + root.sqrt())).filter(|t| *t <= 1.0)
    };
    let of_ball = |end: Vector3<f64>| {
        let offset = end - center;
        first(way.norm_squared(), offset.dot(way), offset.norm_squared() - reach * reach)
    };
    let mut best = [of_ball(*half), of_ball(-half)].into_iter().flatten().reduce(f64::min);
    let length_2 = half.norm_squared();
    if length_2 > 0.0 {
        // Across the axis it is a circle; only between the ends it counts.
        let across = |v: &Vector3<f64>| v - half * (v.dot(half) / length_2);
        let (offset, speed) = (-across(center), across(way));
        let touch = first(speed.norm_squared(), offset.dot(&speed), offset.norm_squared() - reach * reach);
        if let Some(part) = touch {
            let along = (center - way * part).dot(half) / length_2;
            if along.abs() <= 1.0 {
                best = Some(best.map_or(part, |best| best.min(part)));
            }
        }
    }
    best
}

const _: () = assert!(CELLS == 512);
