//! Voxels: a box of cells with a density and a label each, in bricks that copies share until one of them changes.
//!
//! Three levels of 8 each way: a voxel in a brick of 8³, a brick in a chunk of 8³ bricks, a chunk in the grid. A brick
//! whose voxels are all equal takes no memory of its own. Chunks and mixed bricks are shared by reference: a copy of a
//! grid costs one reference a chunk, and a change copies the chunk and the brick in which it is, once.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use thiserror::Error;

use crate::bits::{self, Mask};

/// Voxels along an edge of a brick, and bricks along an edge of a chunk.
pub const EDGE: usize = 8;
/// Voxels of a brick, and bricks of a chunk.
pub const CELLS: usize = EDGE * EDGE * EDGE;
/// Voxels along an edge of a chunk.
pub(crate) const CHUNK: usize = EDGE * EDGE;
/// Most voxels of a grid.
pub const MAX_VOXELS: usize = 1 << 30;
/// Most bricks, which may be full in part only: twice as many as so many voxels need.
const MAX_BRICKS: usize = 2 * MAX_VOXELS / CELLS;
/// Most voxels along an edge.
pub const MAX_EDGE: usize = 1 << 15;
/// Most labels, without the one of empty voxels.
pub const MAX_LABELS: usize = 255;

/// What a voxel holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Voxel {
    /// 0 (empty) to 255.
    pub density: u8,
    /// Position in [`VoxelGrid::labels`]; 0: nothing.
    pub label: u8,
}

/// What voxels of one label have in common.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    /// Red, green and blue.
    pub color: [u8; 3],
    /// Default: empty.
    pub name: String,
    /// Cost of cutting relative to other labels; positive, finite. Default: 1.
    pub hardness: f64,
}

impl Label {
    /// A label without a name, of hardness 1.
    pub fn of_color(color: [u8; 3]) -> Self {
        Self { color, name: String::new(), hardness: 1.0 }
    }
}

/// How voxels have colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coloring {
    /// The colour of the label, with the density as alpha.
    Labels,
    /// Grey as bright as the voxel is dense, opaque.
    Grey,
    /// The brightest channel of the label's colour is the density; opaque.
    Opaque,
}

/// Error when voxels cannot be held or described.
#[derive(Debug, Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum GridError {
    /// Error when a grid would be too large.
    #[error("{} x {} x {} voxels need up to {} MiB; at most {} voxels, {MAX_EDGE} in a row, in {MAX_BRICKS} bricks of {EDGE}³ are possible: reduce the resolution",
        size[0], size[1], size[2], mib(size), MAX_VOXELS)]
    TooLarge {
        /// Voxels along x, y and z.
        size: [usize; 3],
    },
    /// Error when there is no voxel along an edge.
    #[error("a volume of {} x {} x {} voxels is empty; each edge needs at least 1", size[0], size[1], size[2])]
    Empty {
        /// Voxels along x, y and z.
        size: [usize; 3],
    },
    /// Error when edges are not finite and positive.
    #[error("edges of {} x {} x {} m; each has to be positive and finite", edges[0], edges[1], edges[2])]
    Edges {
        /// m.
        edges: [f64; 3],
    },
    /// Error when a list has not one entry a voxel.
    #[error("{got} voxels are given, {expected} were expected")]
    Length {
        /// What was given.
        got: usize,
        /// What was expected.
        expected: usize,
    },
}

/// Upper bound of the memory of voxels, MiB: all bricks mixed.
fn mib(size: &[usize; 3]) -> u128 {
    let bricks = size.iter().fold(1_u128, |product, &edge| product * edge.div_ceil(EDGE) as u128);
    (bricks * (size_of::<Block>() + size_of::<Brick>() + size_of::<Mask>()) as u128) >> 20
}

/// Voxels of a brick that are not all equal, x fastest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Block {
    pub(crate) density: [u8; CELLS],
    pub(crate) label: [u8; CELLS],
    /// Colours of voxels where there are more than labels can name.
    pub(crate) colors: Option<Box<[[u8; 3]; CELLS]>>,
}

impl Block {
    pub(crate) fn uniform(voxel: Voxel) -> Self {
        Self { density: [voxel.density; CELLS], label: [voxel.label; CELLS], colors: None }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Cells {
    Uniform(Voxel),
    Mixed(Arc<Block>),
}

/// Voxels, with what is computed from them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Brick {
    pub(crate) cells: Cells,
    /// Which voxels are solid; `None`: all are or, where [`Chunk::solid`] has no bit, none.
    pub(crate) solid: Option<Arc<Mask>>,
    /// Which solid voxels have an empty one among their 26 neighbours; `None`: no voxel.
    pub(crate) surface: Option<Arc<Mask>>,
}

impl Brick {
    fn voxel(&self, cell: usize) -> Voxel {
        match &self.cells {
            Cells::Uniform(voxel) => *voxel,
            Cells::Mixed(block) => Voxel { density: block.density[cell], label: block.label[cell] },
        }
    }
}

/// 8³ bricks, x fastest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Chunk {
    pub(crate) bricks: Vec<Brick>,
    /// Bricks in which something is solid.
    pub(crate) solid: Mask,
    /// Bricks with a surface.
    pub(crate) surface: Mask,
}

impl Chunk {
    fn empty() -> Self {
        let brick = Brick { cells: Cells::Uniform(Voxel::default()), solid: None, surface: None };
        Self { bricks: vec![brick; CELLS], solid: bits::NONE, surface: bits::NONE }
    }
}

/// Voxels in a box, whose centre is the origin of the volume's frame.
///
/// Voxel (i, j, k) covers [i, i + 1) · h from the lower corner of the box, so that its centre is at i + ½. A copy shares
/// everything with the original.
#[derive(Clone, Debug)]
pub struct VoxelGrid {
    size: [usize; 3],
    spacing: Vector3<f64>,
    /// The smallest density that is solid.
    threshold: u8,
    coloring: Coloring,
    labels: Arc<Vec<Label>>,
    /// Chunks along x, y and z.
    pub(crate) counts: [usize; 3],
    pub(crate) chunks: Vec<Arc<Chunk>>,
}

/// Equal in voxels and in what they stand for.
impl PartialEq for VoxelGrid {
    fn eq(&self, other: &Self) -> bool {
        let head = |grid: &Self| (grid.size, grid.spacing, grid.threshold, grid.coloring);
        head(self) == head(other)
            && self.labels == other.labels
            && self.chunks.iter().zip(&other.chunks).all(|(a, b)| Arc::ptr_eq(a, b) || a == b)
    }
}

/// Refuses sizes that cannot be.
///
/// # Errors
/// [`GridError::Empty`], [`GridError::TooLarge`]. Nothing is reserved before.
pub fn check_size(size: [usize; 3]) -> Result<(), GridError> {
    if size.contains(&0) {
        return Err(GridError::Empty { size });
    }
    let voxels = size.iter().try_fold(1_usize, |product, &edge| product.checked_mul(edge));
    let is_long = size.iter().any(|&edge| edge > MAX_EDGE);
    // Of edges that are not longer, the product is no problem.
    let bricks = || size.iter().map(|edge| edge.div_ceil(EDGE)).product::<usize>();
    if is_long || voxels.is_none_or(|voxels| voxels > MAX_VOXELS) || bricks() > MAX_BRICKS {
        return Err(GridError::TooLarge { size });
    }
    Ok(())
}

impl VoxelGrid {
    /// An empty grid of `size` voxels in a box of `edges`, m.
    ///
    /// `iso` is the density, 0 to 1, from which a voxel is solid; a voxel of density 0 never is.
    ///
    /// # Errors
    /// [`GridError`].
    pub fn new(size: [usize; 3], edges: Vector3<f64>, iso: f64) -> Result<Self, GridError> {
        check_size(size)?;
        if !edges.iter().all(|edge| edge.is_finite() && *edge > 0.0) {
            return Err(GridError::Edges { edges: edges.into() });
        }
        let counts = size.map(|edge| edge.div_ceil(CHUNK));
        // One for all, until something is in it.
        let empty = Arc::new(Chunk::empty());
        let chunks = vec![empty; counts.iter().product()];
        let spacing = Vector3::from_fn(|axis, _| edges[axis] / size[axis] as f64);
        let labels = Arc::new(vec![Label::of_color([0; 3])]);
        let threshold = threshold_of(iso);
        Ok(Self { size, spacing, threshold, coloring: Coloring::Labels, labels, counts, chunks })
    }

    /// A grid whose voxels are given by index.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn from_fn(
        size: [usize; 3],
        edges: Vector3<f64>,
        iso: f64,
        labels: Vec<Label>,
        voxel: impl Fn([usize; 3]) -> Voxel,
    ) -> Result<Self, GridError> {
        let mut grid = Self::new(size, edges, iso)?;
        grid.set_labels(labels, Coloring::Labels);
        let bricks = size.map(|edge| edge.div_ceil(EDGE));
        for z in 0..bricks[2] {
            for y in 0..bricks[1] {
                for x in 0..bricks[0] {
                    let mut block = Block::uniform(Voxel::default());
                    let corner = [x, y, z].map(|brick| brick * EDGE);
                    for cell in 0..CELLS {
                        let index = index_of(corner, cell);
                        if (0..3).all(|axis| index[axis] < size[axis]) {
                            let voxel = voxel(index);
                            (block.density[cell], block.label[cell]) = (voxel.density, voxel.label);
                        }
                    }
                    grid.set_cells([x, y, z], cells_of(block));
                }
            }
        }
        grid.rebuild();
        Ok(grid)
    }

    /// The same box, without anything in it.
    pub fn emptied(&self) -> Self {
        let empty = Arc::new(Chunk::empty());
        Self { chunks: vec![empty; self.chunks.len()], ..self.clone() }
    }

    /// Voxels along x, y and z.
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// Edges of a voxel, m.
    pub fn spacing(&self) -> Vector3<f64> {
        self.spacing
    }

    /// Edges of the box, m.
    pub fn edges(&self) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| self.spacing[axis] * self.size[axis] as f64)
    }

    /// Volume of a voxel, m³.
    pub fn voxel_volume(&self) -> f64 {
        self.spacing.product()
    }

    /// The smallest density that is solid, 1 to 255.
    pub fn threshold(&self) -> u8 {
        self.threshold
    }

    /// How voxels have colours.
    pub fn coloring(&self) -> Coloring {
        self.coloring
    }

    /// (labels x 1); the first stands for nothing.
    pub fn labels(&self) -> &[Label] {
        &self.labels
    }

    /// The label of a name, or of a colour.
    pub fn label_named(&self, name: &str) -> Option<u8> {
        self.labels.iter().skip(1).position(|label| label.name == name).map(|place| place as u8 + 1)
    }

    /// The label of a colour.
    pub fn label_of_color(&self, color: [u8; 3]) -> Option<u8> {
        self.labels.iter().skip(1).position(|label| label.color == color).map(|place| place as u8 + 1)
    }

    /// Names and hardness of the labels whose colours are given; returns those of no voxel's colour.
    pub fn describe_labels(&mut self, described: &[Label]) -> Vec<Label> {
        let labels = Arc::make_mut(&mut self.labels);
        let mut unknown = Vec::new();
        for label in described {
            match labels.iter_mut().skip(1).find(|known| known.color == label.color) {
                Some(known) => known.clone_from(label),
                None => unknown.push(label.clone()),
            }
        }
        unknown
    }

    /// Sets what labels 1 … stand for; those beyond [`MAX_LABELS`] are left out.
    pub(crate) fn set_labels(&mut self, labels: Vec<Label>, coloring: Coloring) {
        let nothing = std::iter::once(Label::of_color([0; 3]));
        self.labels = Arc::new(nothing.chain(labels.into_iter().take(MAX_LABELS)).collect());
        self.coloring = coloring;
    }

    /// Gives the box other edges, m.
    ///
    /// # Errors
    /// [`GridError::Edges`].
    pub fn set_edges(&mut self, edges: Vector3<f64>) -> Result<(), GridError> {
        if !edges.iter().all(|edge| edge.is_finite() && *edge > 0.0) {
            return Err(GridError::Edges { edges: edges.into() });
        }
        self.spacing = Vector3::from_fn(|axis, _| edges[axis] / self.size[axis] as f64);
        Ok(())
    }

    /// Makes voxels solid from another density on, 0 to 1.
    pub fn set_iso(&mut self, iso: f64) {
        let threshold = threshold_of(iso);
        if threshold != self.threshold {
            self.threshold = threshold;
            self.rebuild();
        }
    }

    /// A voxel; `None` outside.
    pub fn voxel(&self, index: [usize; 3]) -> Option<Voxel> {
        self.is_inside(index).then(|| self.brick(index.map(|i| i / EDGE)).voxel(cell_of(index)))
    }

    /// Red, green, blue and alpha of a voxel; `None` outside. Empty voxels have only zeros.
    pub fn color(&self, index: [usize; 3]) -> Option<[u8; 4]> {
        self.is_inside(index).then(|| self.cell_color(self.brick(index.map(|i| i / EDGE)), cell_of(index)))
    }

    pub(crate) fn cell_color(&self, brick: &Brick, cell: usize) -> [u8; 4] {
        let voxel = brick.voxel(cell);
        if voxel == Voxel::default() {
            return [0; 4];
        }
        let [r, g, b] = match (&brick.cells, self.coloring) {
            (_, Coloring::Grey) => [voxel.density; 3],
            (Cells::Mixed(block), _) if block.colors.is_some() => block.colors.as_ref().map_or([0; 3], |c| c[cell]),
            _ => self.labels.get(usize::from(voxel.label)).map_or([255; 3], |label| label.color),
        };
        let alpha = if self.coloring == Coloring::Labels { voxel.density } else { 255 };
        [r, g, b, alpha]
    }

    /// Whether a voxel is solid; outside nothing is.
    pub fn is_solid(&self, index: [usize; 3]) -> bool {
        self.voxel(index).is_some_and(|voxel| voxel.density >= self.threshold)
    }

    /// Whether a voxel is solid and one of its 26 neighbours is not.
    pub fn is_surface(&self, index: [usize; 3]) -> bool {
        let surface = |mask: &Arc<Mask>| bits::has(mask, cell_of(index));
        self.is_inside(index) && self.brick(index.map(|i| i / EDGE)).surface.as_ref().is_some_and(surface)
    }

    /// Solid voxels.
    pub fn count_solid(&self) -> usize {
        let in_brick = |brick: &Brick, place: [usize; 3]| match &brick.solid {
            Some(mask) => bits::count(mask),
            None => bits::count(&self.inside_of(place)),
        };
        let mut solid = 0;
        for (chunk, corner) in self.chunks() {
            solid += bits::ones(&chunk.solid).map(|b| in_brick(&chunk.bricks[b], index_of(corner, b))).sum::<usize>();
        }
        solid
    }

    /// Density between the centres of voxels, by trilinear interpolation, and its gradient, 1/m; 0 to 255. `point` is in
    /// the volume's frame; outside the density is 0.
    pub fn density_at(&self, point: &Point3<f64>) -> (f64, Vector3<f64>) {
        let place = self.to_cells(point).map(|c| c - 0.5);
        let low = place.map(f64::floor);
        let part = place - low;
        let mut corners = [0.0; 8];
        for (corner, density) in corners.iter_mut().enumerate() {
            let index = std::array::from_fn(|axis| low[axis] as i64 + (corner >> axis & 1) as i64);
            *density = f64::from(self.density(index));
        }
        let weight = |axis: usize, corner: usize| if corner >> axis & 1 == 1 { part[axis] } else { 1.0 - part[axis] };
        let (mut value, mut gradient) = (0.0, Vector3::zeros());
        for (corner, density) in corners.into_iter().enumerate() {
            let weights: [f64; 3] = std::array::from_fn(|axis| weight(axis, corner));
            value += density * weights[0] * weights[1] * weights[2];
            for axis in 0..3 {
                let sign = if corner >> axis & 1 == 1 { 1.0 } else { -1.0 };
                gradient[axis] +=
                    sign * density * weights[(axis + 1) % 3] * weights[(axis + 2) % 3] / self.spacing[axis];
            }
        }
        (value, gradient)
    }

    /// Density of a voxel, 0 outside.
    pub(crate) fn density(&self, index: [i64; 3]) -> u8 {
        let inside = (0..3).all(|axis| index[axis] >= 0 && (index[axis] as usize) < self.size[axis]);
        if !inside {
            return 0;
        }
        let index = index.map(|i| i as usize);
        self.brick(index.map(|i| i / EDGE)).voxel(cell_of(index)).density
    }

    /// Centre of a voxel in the volume's frame, m.
    pub fn center(&self, index: [usize; 3]) -> Point3<f64> {
        Point3::from(Vector3::from_fn(|axis, _| self.coordinate(axis, index[axis])))
    }

    /// Coordinate of the centres of voxels with an index along an axis, m.
    pub(crate) fn coordinate(&self, axis: usize, index: usize) -> f64 {
        (index as f64 + 0.5 - 0.5 * self.size[axis] as f64) * self.spacing[axis]
    }

    /// The voxel in which a point of the volume's frame is; `None` outside.
    pub fn index_at(&self, point: &Point3<f64>) -> Option<[usize; 3]> {
        let cell = self.to_cells(point);
        let inside = (0..3).all(|axis| cell[axis] >= 0.0 && cell[axis] < self.size[axis] as f64);
        inside.then(|| std::array::from_fn(|axis| cell[axis] as usize))
    }

    /// From the volume's frame to voxels from the lower corner.
    pub(crate) fn to_cells(&self, point: &Point3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| point[axis] / self.spacing[axis] + 0.5 * self.size[axis] as f64)
    }

    /// All voxels as red, green, blue and alpha: (z × y × x × 4).
    pub fn to_rgba(&self) -> Vec<u8> {
        let mut rgba = vec![0; self.size.iter().product::<usize>() * 4];
        self.each_brick(|corner, brick| {
            if brick.cells != Cells::Uniform(Voxel::default()) {
                self.copy_brick(corner, brick, 4, &mut rgba, |cell, out| {
                    out.copy_from_slice(&self.cell_color(brick, cell));
                });
            }
        });
        rgba
    }

    /// All voxels as densities and labels: twice (z × y × x).
    pub fn to_arrays(&self) -> (Vec<u8>, Vec<u8>) {
        let voxels = self.size.iter().product::<usize>();
        let (mut densities, mut labels) = (vec![0; voxels], vec![0; voxels]);
        self.each_brick(|corner, brick| {
            if brick.cells != Cells::Uniform(Voxel::default()) {
                self.copy_brick(corner, brick, 1, &mut densities, |cell, out| out[0] = brick.voxel(cell).density);
                self.copy_brick(corner, brick, 1, &mut labels, |cell, out| out[0] = brick.voxel(cell).label);
            }
        });
        (densities, labels)
    }

    fn copy_brick(
        &self,
        corner: [usize; 3],
        _brick: &Brick,
        width: usize,
        all: &mut [u8],
        of: impl Fn(usize, &mut [u8]),
    ) {
        for cell in 0..CELLS {
            let [i, j, k] = index_of(corner, cell);
            if self.is_inside([i, j, k]) {
                let place = ((k * self.size[1] + j) * self.size[0] + i) * width;
                of(cell, &mut all[place..place + width]);
            }
        }
    }

    /// Visits bricks in the box with the index of their first voxel.
    pub(crate) fn each_brick(&self, mut visit: impl FnMut([usize; 3], &Brick)) {
        for (chunk, corner) in self.chunks() {
            for (b, brick) in chunk.bricks.iter().enumerate() {
                let first = index_of(corner, b).map(|place| place * EDGE);
                if self.is_inside(first) {
                    visit(first, brick);
                }
            }
        }
    }

    /// First voxels of the bricks in which two grids of one size differ, or may. Bricks that both share are equal.
    pub fn changed_bricks(&self, before: &Self) -> Vec<[usize; 3]> {
        let mut changed = Vec::new();
        self.for_changed_bricks(before, |first| changed.push(first));
        changed
    }

    /// The same, without memory for a list.
    pub fn for_changed_bricks(&self, before: &Self, mut visit: impl FnMut([usize; 3])) {
        for ((now, corner), was) in self.chunks().zip(&before.chunks) {
            if Arc::ptr_eq(now, was) {
                continue;
            }
            for b in 0..CELLS {
                let same = match (&now.bricks[b].cells, &was.bricks[b].cells) {
                    (Cells::Mixed(a), Cells::Mixed(b)) => Arc::ptr_eq(a, b),
                    (a, b) => a == b,
                };
                let first = index_of(corner, b).map(|place| place * EDGE);
                if !same && self.is_inside(first) {
                    visit(first);
                }
            }
        }
    }

    /// Whether some voxels have colours that are not those of their labels.
    pub(crate) fn has_own_colors(&self) -> bool {
        let is_own = |brick: &Brick| matches!(&brick.cells, Cells::Mixed(block) if block.colors.is_some());
        self.chunks.iter().any(|chunk| chunk.bricks.iter().any(is_own))
    }

    /// What graphics cards interpolate in a box of voxels from `low` up to `high`, without it: densities alone of grey
    /// voxels, else red, green, blue and density (z × y × x × channels).
    ///
    /// # Panics
    /// If the box leaves the grid.
    pub fn texels(&self, low: [usize; 3], high: [usize; 3]) -> Vec<u8> {
        assert!((0..3).all(|axis| low[axis] < high[axis] && high[axis] <= self.size[axis]), "a box in the grid");
        let channels = self.channels();
        let size: [usize; 3] = std::array::from_fn(|axis| high[axis] - low[axis]);
        let mut texels = vec![0; size.iter().product::<usize>() * channels];
        let range = |axis: usize| low[axis] / EDGE..high[axis].div_ceil(EDGE);
        for (y, z) in range(2).flat_map(|z| range(1).map(move |y| (y, z))) {
            for x in range(0) {
                let brick = self.brick([x, y, z]);
                if brick.cells == Cells::Uniform(Voxel::default()) {
                    continue;
                }
                for cell in 0..CELLS {
                    let index = index_of([x, y, z].map(|b| b * EDGE), cell);
                    if (0..3).any(|axis| index[axis] < low[axis] || index[axis] >= high[axis]) {
                        continue;
                    }
                    let [i, j, k]: [usize; 3] = std::array::from_fn(|axis| index[axis] - low[axis]);
                    let texel = &mut texels[((k * size[1] + j) * size[0] + i) * channels..][..channels];
                    let density = brick.voxel(cell).density;
                    match texel {
                        [grey] => *grey = density,
                        _ => {
                            let [r, g, b, _] = self.cell_color(brick, cell);
                            texel.copy_from_slice(&[r, g, b, density]);
                        }
                    }
                }
            }
        }
        texels
    }

    /// Channels of [`texels`](Self::texels).
    pub fn channels(&self) -> usize {
        if self.coloring == Coloring::Grey {
            1
        } else {
            4
        }
    }

    /// The largest density that interpolation finds in each brick from `low` up to `high`, without it, by places of
    /// bricks: of its voxels and their neighbours (z × y × x).
    pub fn largest_densities(&self, low: [usize; 3], high: [usize; 3]) -> Vec<u8> {
        let size: [usize; 3] = std::array::from_fn(|axis| high[axis] - low[axis]);
        let bricks = self.size.map(|edge| edge.div_ceil(EDGE));
        let layers = crate::parallel(size[2], |z| {
            let mut layer = Vec::with_capacity(size[0] * size[1]);
            for (x, y) in (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y))) {
                layer.push(self.largest_near([low[0] + x, low[1] + y, low[2] + z], bricks));
            }
            layer
        });
        layers.concat()
    }

    fn largest_near(&self, brick: [usize; 3], bricks: [usize; 3]) -> u8 {
        let around = |axis: usize| brick[axis].saturating_sub(1)..(brick[axis] + 2).min(bricks[axis]);
        let mut largest = 0;
        for (y, z) in around(2).flat_map(|z| around(1).map(move |y| (y, z))) {
            for x in around(0) {
                let at = [x, y, z];
                let Cells::Mixed(block) = &self.brick(at).cells else {
                    let Cells::Uniform(voxel) = self.brick(at).cells else { continue };
                    largest = largest.max(voxel.density);
                    continue;
                };
                // All of the brick itself, of its neighbours the voxels beside it.
                let range = |axis: usize| match at[axis].cmp(&brick[axis]) {
                    std::cmp::Ordering::Less => EDGE - 1..EDGE,
                    std::cmp::Ordering::Equal => 0..EDGE,
                    std::cmp::Ordering::Greater => 0..1,
                };
                for (j, k) in range(2).flat_map(|k| range(1).map(move |j| (j, k))) {
                    let row = EDGE * (j + EDGE * k);
                    largest = range(0).fold(largest, |largest, i| largest.max(block.density[row + i]));
                }
            }
        }
        largest
    }

    /// Bytes of this grid, what it shares with copies included.
    pub fn memory(&self) -> usize {
        let mut chunks: Vec<_> = self.chunks.iter().map(Arc::as_ptr).collect();
        chunks.sort_unstable();
        chunks.dedup();
        let mut bytes = size_of::<Self>() + self.chunks.len() * size_of::<Arc<Chunk>>();
        for (at, chunk) in self.chunks.iter().enumerate() {
            if self.chunks[..at].last().is_some_and(|last| Arc::ptr_eq(last, chunk)) {
                continue;
            }
            bytes += size_of::<Chunk>() + chunk.bricks.capacity() * size_of::<Brick>();
            for brick in &chunk.bricks {
                let masks = usize::from(brick.solid.is_some()) + usize::from(brick.surface.is_some());
                bytes += masks * (size_of::<Mask>() + 16);
                if let Cells::Mixed(block) = &brick.cells {
                    bytes += size_of::<Block>() + 16 + block.colors.as_ref().map_or(0, |_| 3 * CELLS);
                }
            }
        }
        bytes
    }

    pub(crate) fn is_inside(&self, index: [usize; 3]) -> bool {
        (0..3).all(|axis| index[axis] < self.size[axis])
    }

    /// Chunks with the first brick of each.
    pub(crate) fn chunks(&self) -> impl Iterator<Item = (&Arc<Chunk>, [usize; 3])> {
        let [x, y, _] = self.counts;
        self.chunks
            .iter()
            .enumerate()
            .map(move |(at, chunk)| (chunk, [at % x, at / x % y, at / x / y].map(|c| c * EDGE)))
    }

    /// The chunk of a brick, and its place there.
    pub(crate) fn place(&self, brick: [usize; 3]) -> (usize, usize) {
        let chunk = brick.map(|b| b / EDGE);
        ((chunk[2] * self.counts[1] + chunk[1]) * self.counts[0] + chunk[0], cell_of(brick))
    }

    pub(crate) fn brick(&self, brick: [usize; 3]) -> &Brick {
        let (chunk, place) = self.place(brick);
        &self.chunks[chunk].bricks[place]
    }

    pub(crate) fn set_cells(&mut self, brick: [usize; 3], cells: Cells) {
        let (chunk, place) = self.place(brick);
        if self.chunks[chunk].bricks[place].cells != cells {
            Arc::make_mut(&mut self.chunks[chunk]).bricks[place].cells = cells;
        }
    }

    /// Bits of the voxels of a brick that are in the box.
    fn inside_of(&self, brick: [usize; 3]) -> Mask {
        let mut mask = bits::NONE;
        let count = |axis: usize| self.size[axis].saturating_sub(brick[axis] * EDGE).min(EDGE);
        let row = ((1_u16 << count(0)) - 1) as u64;
        let plane = (0..count(1)).fold(0, |plane, y| plane | row << (EDGE * y));
        mask[..count(2)].fill(plane);
        mask
    }

    /// Bits of solid voxels of a brick; bricks outside have none.
    pub(crate) fn solid_of(&self, brick: [i64; 3]) -> Mask {
        let bricks = self.size.map(|edge| edge.div_ceil(EDGE));
        if (0..3).any(|axis| brick[axis] < 0 || brick[axis] as usize >= bricks[axis]) {
            return bits::NONE;
        }
        let brick = brick.map(|b| b as usize);
        let (chunk, place) = self.place(brick);
        let chunk = &self.chunks[chunk];
        match (&chunk.bricks[place].solid, bits::has(&chunk.solid, place)) {
            (_, false) => bits::NONE,
            (Some(mask), _) => **mask,
            (None, _) => self.inside_of(brick),
        }
    }

    /// Computes which voxels of a brick are solid.
    fn find_solid(&self, brick: [usize; 3]) -> Mask {
        match &self.brick(brick).cells {
            Cells::Uniform(voxel) if voxel.density >= self.threshold => self.inside_of(brick),
            Cells::Uniform(_) => bits::NONE,
            Cells::Mixed(block) => {
                let mut mask = bits::NONE;
                for (word, densities) in mask.iter_mut().zip(block.density.as_chunks::<64>().0) {
                    for (bit, &density) in densities.iter().enumerate() {
                        *word |= u64::from(density >= self.threshold) << bit;
                    }
                }
                mask
            }
        }
    }

    pub(crate) fn update_solid(&mut self, brick: [usize; 3]) {
        let found = self.find_solid(brick);
        let is_any = found != bits::NONE;
        // Where all of it, as far as it is in the box, is solid, the mask says nothing.
        let mask = (is_any && found != self.inside_of(brick)).then_some(found);
        let (chunk, place) = self.place(brick);
        let known = &self.chunks[chunk];
        if known.bricks[place].solid.as_deref() != mask.as_ref() || bits::has(&known.solid, place) != is_any {
            let chunk = Arc::make_mut(&mut self.chunks[chunk]);
            chunk.bricks[place].solid = mask.map(Arc::new);
            bits::put(&mut chunk.solid, place, is_any);
        }
    }

    pub(crate) fn update_surface(&mut self, brick: [usize; 3]) {
        let found = self.find_surface(brick);
        let mask = (found != bits::NONE).then_some(found);
        let (chunk, place) = self.place(brick);
        if self.chunks[chunk].bricks[place].surface.as_deref() != mask.as_ref() {
            let chunk = Arc::make_mut(&mut self.chunks[chunk]);
            bits::put(&mut chunk.surface, place, mask.is_some());
            chunk.bricks[place].surface = mask.map(Arc::new);
        }
    }

    /// Solid voxels of a brick that have an empty one among their 26 neighbours.
    fn find_surface(&self, brick: [usize; 3]) -> Mask {
        let at = brick.map(|b| b as i64);
        let own = self.solid_of(at);
        if own == bits::NONE {
            return own;
        }
        // Ten rows of ten rows of ten voxels: those of the brick and one around them.
        let mut rows = [[0_u16; 10]; 10];
        for z in -1..=1_i64 {
            for y in -1..=1_i64 {
                for x in -1..=1_i64 {
                    let mask = self.solid_of([at[0] + x, at[1] + y, at[2] + z]);
                    let range = |offset: i64| match offset {
                        -1 => 7..8,
                        0 => 0..8,
                        _ => 0..1_usize,
                    };
                    for k in range(z) {
                        for j in range(y) {
                            let row = (mask[k] >> (8 * j) & 0xff) as u16;
                            let place = |cell: usize, offset: i64| (cell as i64 + 8 * offset + 1) as usize;
                            let bits = match x {
                                -1 => row >> 7,
                                0 => row << 1,
                                _ => (row & 1) << 9,
                            };
                            rows[place(k, z)][place(j, y)] |= bits;
                        }
                    }
                }
            }
        }
        let mut surface = bits::NONE;
        for (k, word) in surface.iter_mut().enumerate() {
            for j in 0..EDGE {
                let planes = &rows[k..k + 3];
                let all = planes.iter().fold(u16::MAX, |all, plane| all & plane[j] & plane[j + 1] & plane[j + 2]);
                let inner = (all & all >> 1 & all >> 2) as u64 & 0xff;
                *word |= (own[k] >> (8 * j) & 0xff & !inner) << (8 * j);
            }
        }
        surface
    }

    /// Computes all masks anew, on as many threads as there are processors.
    pub(crate) fn rebuild(&mut self) {
        let places: Vec<_> = self.chunks().map(|(_, corner)| corner).collect();
        let bricks = self.size.map(|edge| edge.div_ceil(EDGE));
        let inside = |place: [usize; 3]| (0..3).all(|axis| place[axis] < bricks[axis]);
        // Each pass reads the grid as the pass before has left it, and writes a chunk of its own.
        for pass in
            [Self::with_solid as fn(&Self, usize, &dyn Fn(usize) -> Option<[usize; 3]>) -> _, Self::with_surface]
        {
            let grid = &*self;
            let made = crate::parallel(places.len(), |at| {
                let place = |b: usize| Some(index_of(places[at], b)).filter(|&place| inside(place));
                pass(grid, at, &place)
            });
            for (at, chunk) in made.into_iter().enumerate() {
                if let Some(chunk) = chunk {
                    self.chunks[at] = Arc::new(chunk);
                }
            }
        }
    }

    /// A chunk with which of its bricks are solid, if that is another one.
    fn with_solid(&self, at: usize, place: &dyn Fn(usize) -> Option<[usize; 3]>) -> Option<Chunk> {
        let mut chunk = Chunk::clone(&self.chunks[at]);
        for b in 0..CELLS {
            let Some(brick) = place(b) else { continue };
            let found = self.find_solid(brick);
            bits::put(&mut chunk.solid, b, found != bits::NONE);
            let says = found != bits::NONE && found != self.inside_of(brick);
            chunk.bricks[b].solid = says.then(|| Arc::new(found));
        }
        (chunk != *self.chunks[at]).then_some(chunk)
    }

    fn with_surface(&self, at: usize, place: &dyn Fn(usize) -> Option<[usize; 3]>) -> Option<Chunk> {
        if self.chunks[at].solid == bits::NONE && self.chunks[at].surface == bits::NONE {
            return None;
        }
        let mut chunk = Chunk::clone(&self.chunks[at]);
        for b in 0..CELLS {
            let Some(brick) = place(b) else { continue };
            let found = self.find_surface(brick);
            bits::put(&mut chunk.surface, b, found != bits::NONE);
            chunk.bricks[b].surface = (found != bits::NONE).then(|| Arc::new(found));
        }
        (chunk != *self.chunks[at]).then_some(chunk)
    }

    /// Empties voxels; each is told with its colour of before. Voxels that are empty or outside are passed over. Masks
    /// are right afterwards.
    pub(crate) fn erase(
        &mut self,
        voxels: impl Iterator<Item = [usize; 3]>,
        room: &mut Touched,
        mut tell: impl FnMut([usize; 3], Voxel, [u8; 4]),
    ) {
        let Touched { changed, near } = room;
        changed.clear();
        near.clear();
        for index in voxels {
            if !self.is_inside(index) {
                continue;
            }
            let (at, cell) = (index.map(|i| i / EDGE), cell_of(index));
            let (chunk, place) = self.place(at);
            let brick = &self.chunks[chunk].bricks[place];
            let voxel = brick.voxel(cell);
            if voxel == Voxel::default() {
                continue;
            }
            tell(index, voxel, self.cell_color(brick, cell));
            let brick = &mut Arc::make_mut(&mut self.chunks[chunk]).bricks[place];
            if let Cells::Uniform(voxel) = brick.cells {
                brick.cells = Cells::Mixed(Arc::new(Block::uniform(voxel)));
            }
            if let Cells::Mixed(block) = &mut brick.cells {
                let block = Arc::make_mut(block);
                (block.density[cell], block.label[cell]) = (0, 0);
                if let Some(colors) = &mut block.colors {
                    colors[cell] = [0; 3];
                }
            }
            if changed.last() != Some(&at) {
                changed.push(at);
            }
        }
        changed.sort_unstable();
        changed.dedup();
        let last = self.size.map(|edge| (edge - 1) / EDGE);
        for &brick in changed.iter() {
            // What has become empty gives its memory back.
            let is_empty = |block: &Block| block.density == [0; CELLS] && block.label == [0; CELLS];
            if matches!(&self.brick(brick).cells, Cells::Mixed(block) if is_empty(block)) {
                self.set_cells(brick, Cells::Uniform(Voxel::default()));
            }
            self.update_solid(brick);
            let range = |axis: usize| brick[axis].saturating_sub(1)..=(brick[axis] + 1).min(last[axis]);
            for z in range(2) {
                for y in range(1) {
                    near.extend(range(0).map(|x| [x, y, z]));
                }
            }
        }
        near.sort_unstable();
        near.dedup();
        near.iter().for_each(|&brick| self.update_surface(brick));
    }
}

/// Room for the bricks that a change touches, used again.
#[derive(Clone, Debug, Default)]
pub(crate) struct Touched {
    changed: Vec<[usize; 3]>,
    near: Vec<[usize; 3]>,
}

impl Touched {
    /// Room for a ball of as many voxels: their bricks, each named once a voxel, and once with its neighbours.
    pub(crate) fn with_room(voxels: usize) -> Self {
        // A brick has 8³ voxels; an eighth of that is left for bricks of which the ball has a part only.
        Self { changed: Vec::with_capacity(voxels), near: Vec::with_capacity(27 * voxels.div_ceil(EDGE * EDGE)) }
    }

    pub(crate) fn shrink_to(&mut self, voxels: usize) {
        self.changed.clear();
        self.changed.shrink_to(voxels);
        self.near.clear();
        self.near.shrink_to(27 * voxels.div_ceil(EDGE * EDGE));
    }
}

/// The smallest density from 0 to 255 that is solid.
fn threshold_of(iso: f64) -> u8 {
    (iso * 255.0).ceil().clamp(1.0, 255.0) as u8
}

/// Place of a voxel in its brick, or of a brick in its chunk.
pub(crate) fn cell_of(index: [usize; 3]) -> usize {
    let [x, y, z] = index.map(|i| i % EDGE);
    x + EDGE * (y + EDGE * z)
}

/// The index of a place in the brick, or chunk, that begins at `first`.
pub(crate) fn index_of(first: [usize; 3], cell: usize) -> [usize; 3] {
    [first[0] + cell % EDGE, first[1] + cell / EDGE % EDGE, first[2] + cell / EDGE / EDGE]
}

/// The least memory that holds the voxels of a brick.
pub(crate) fn cells_of(block: Block) -> Cells {
    let first = Voxel { density: block.density[0], label: block.label[0] };
    let is_uniform = block.density == [first.density; CELLS] && block.label == [first.label; CELLS];
    match is_uniform && (block.colors.is_none() || first == Voxel::default()) {
        true => Cells::Uniform(first),
        false => Cells::Mixed(Arc::new(block)),
    }
}
