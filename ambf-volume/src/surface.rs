//! The isosurface as triangles, by surface nets (Gibson 1998, *Constrained Elastic Surface Nets*): a vertex in each cube
//! of eight neighbouring voxel centres that the surface crosses, at the mean of where it crosses the cube's edges, and a
//! quadrilateral for each pair of neighbouring voxels of which one is solid. What is outside the box is empty.
//!
//! Each edge is used as often in one direction as in the other: the surface is closed and oriented, its normals to the
//! outside.

use std::collections::HashMap;

use nalgebra::Point3;

use crate::bits;
use crate::grid::{index_of, VoxelGrid, CELLS, EDGE};

/// A closed surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// (vertices x 3) m, in the volume's frame.
    pub vertices: Vec<Point3<f64>>,
    /// (triangles x 3) vertices, anticlockwise from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Volume inside, m³, by the divergence theorem.
    pub fn volume(&self) -> f64 {
        let six = |[a, b, c]: &[u32; 3]| {
            let [a, b, c] = [a, b, c].map(|v| self.vertices[*v as usize].coords);
            a.cross(&b).dot(&c)
        };
        self.triangles.iter().map(six).sum::<f64>() / 6.0
    }
}

/// Voxels of a [`Patch`] beyond its brick, each way.
const BEYOND: usize = 2;
/// Voxels along an edge of what a [`Patch`] depends on.
const SPAN: usize = EDGE + 2 * BEYOND;

/// The surface at one brick, for contact: triangles of the brick, then those around them. Room is kept from one brick to
/// the next.
#[derive(Clone, Debug)]
pub struct Patch {
    /// (vertices x 3) m, in the volume's frame.
    pub vertices: Vec<[f64; 3]>,
    /// (triangles x 3) vertices, anticlockwise from outside.
    pub triangles: Vec<[u32; 3]>,
    /// The first so many triangles are those of the brick. All that share a vertex with them are there.
    pub own: usize,
    /// Densities of the brick's voxels and of those up to [`BEYOND`] from it, x fastest.
    densities: Box<[u8; SPAN * SPAN * SPAN]>,
    /// Vertex of each cube, plus 1; 0: none yet.
    known: Box<[u32; SPAN * SPAN * SPAN]>,
}

impl Default for Patch {
    fn default() -> Self {
        let (densities, known) = (Box::new([0; SPAN * SPAN * SPAN]), Box::new([0; SPAN * SPAN * SPAN]));
        Self { vertices: Vec::new(), triangles: Vec::new(), own: 0, densities, known }
    }
}

/// Share of the extent of a patch by which a flat one may be uneven.
const FLAT: f64 = 1e-9;

impl Patch {
    /// Makes one rectangle, of two triangles, of a brick's surface if that and all that touches it is in one plane across an
    /// axis: a body that lies on a flat face then has fewer triangles below it. The surface is the same, and so is what the
    /// triangles around it tell of its sides: that it goes on there.
    pub fn merge_flat(&mut self) {
        let Some(first) = self.vertices.first() else { return };
        let (mut least, mut most) = (*first, *first);
        for (vertex, axis) in self.vertices.iter().flat_map(|vertex| (0..3).map(move |axis| (vertex, axis))) {
            least[axis] = least[axis].min(vertex[axis]);
            most[axis] = most[axis].max(vertex[axis]);
        }
        let extent = (0..3).map(|axis| most[axis] - least[axis]).fold(0.0, f64::max);
        let Some(axis) = (0..3).find(|&axis| most[axis] - least[axis] <= FLAT * extent) else { return };
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let own = &self.triangles[..self.own];
        let corner = |vertex: u32| [self.vertices[vertex as usize][u], self.vertices[vertex as usize][v]];
        let (mut low, mut high, mut area) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2], 0.0);
        for triangle in own {
            let [a, b, c] = triangle.map(corner);
            // Twice the area, positive if it is seen anticlockwise from the end of the axis.
            area += (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            for k in 0..2 {
                low[k] = low[k].min(a[k]).min(b[k]).min(c[k]);
                high[k] = high[k].max(a[k]).max(b[k]).max(c[k]);
            }
        }
        let whole = 2.0 * (high[0] - low[0]) * (high[1] - low[1]);
        if own.len() <= 2 || (area.abs() - whole).abs() > FLAT * whole {
            return;
        }
        let level = first[axis];
        let point = |[x, y]: [f64; 2]| {
            let mut point = [level; 3];
            (point[u], point[v]) = (x, y);
            point
        };
        let middle = [0, 1].map(|k| (low[k] + high[k]) / 2.0);
        let beyond = [0, 1].map(|k| [2.0 * low[k] - high[k], 2.0 * high[k] - low[k]]);
        let corners = [low, [high[0], low[1]], high, [low[0], high[1]]];
        let around = [
            [middle[0], beyond[1][0]],
            [beyond[0][1], middle[1]],
            [middle[0], beyond[1][1]],
            [beyond[0][0], middle[1]],
        ];
        self.vertices.clear();
        self.vertices.extend(corners.into_iter().chain(around).map(point));
        self.triangles.clear();
        self.triangles.extend([[0, 1, 2], [0, 2, 3], [1, 0, 4], [2, 1, 5], [3, 2, 6], [0, 3, 7]]);
        if area < 0.0 {
            self.triangles.iter_mut().for_each(|triangle| triangle.swap(0, 1));
        }
        self.own = 2;
    }
}

/// Place of a voxel in what a [`Patch`] depends on.
fn in_span([x, y, z]: [usize; 3]) -> usize {
    x + SPAN * (y + SPAN * z)
}

/// A solid voxel and a neighbour that is not: the cubes around the edge between their centres, in the order in which the
/// quadrilateral is seen anticlockwise from the neighbour. A cube is named by the sum of its lowest voxel and (1, 1, 1).
fn cubes_around(voxel: [usize; 3], axis: usize, up: bool) -> [[usize; 3]; 4] {
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut corners = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(a, b)| {
        let mut cube = voxel;
        cube[axis] += usize::from(up);
        cube[u] += a;
        cube[v] += b;
        cube
    });
    if !up {
        corners.reverse();
    }
    corners
}

impl VoxelGrid {
    /// The whole isosurface.
    pub fn mesh(&self) -> Mesh {
        let mut mesh = Mesh::default();
        let mut known = HashMap::new();
        for (chunk, corner) in self.chunks() {
            for b in bits::ones(&chunk.surface) {
                self.add_brick(index_of(corner, b), &mut mesh, &mut known);
            }
        }
        mesh
    }

    /// Triangles between the solid voxels of a brick, by its place among bricks, and their neighbours. Those of all
    /// bricks together are the [`mesh`](Self::mesh).
    pub fn brick_mesh(&self, brick: [usize; 3]) -> Mesh {
        let mut mesh = Mesh::default();
        if (0..3).all(|axis| brick[axis] * EDGE < self.size()[axis]) {
            self.add_brick(brick, &mut mesh, &mut HashMap::new());
        }
        mesh
    }

    fn add_brick(&self, brick: [usize; 3], mesh: &mut Mesh, known: &mut HashMap<[usize; 3], u32>) {
        let Some(surface) = self.brick(brick).surface.as_deref() else { return };
        let first = brick.map(|b| b * EDGE);
        for cell in (0..CELLS).filter(|&cell| bits::has(surface, cell)) {
            let voxel = index_of(first, cell);
            for axis in 0..3 {
                for up in [false, true] {
                    let mut beside = voxel.map(|i| i as i64);
                    beside[axis] += if up { 1 } else { -1 };
                    if self.density(beside) >= self.threshold() {
                        continue;
                    }
                    let quad = cubes_around(voxel, axis, up).map(|cube| {
                        *known.entry(cube).or_insert_with(|| {
                            let low = cube.map(|i| i as i64 - 1);
                            let density = |corner: [usize; 3]| {
                                self.density(std::array::from_fn(|axis| low[axis] + corner[axis] as i64))
                            };
                            mesh.vertices.push(self.vertex(low, density));
                            mesh.vertices.len() as u32 - 1
                        })
                    });
                    mesh.triangles.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
                }
            }
        }
    }

    /// The first brick with a surface from brick `from` on, in the order x, y, z, of those from `low` to `high`, both
    /// included and within the grid.
    pub fn next_surface_brick(&self, low: [usize; 3], high: [usize; 3], from: [usize; 3]) -> Option<[usize; 3]> {
        let [mut x, mut y, mut z] = from;
        while z <= high[2] {
            while y <= high[1] {
                while x <= high[0] {
                    let (chunk, place) = self.place([x, y, z]);
                    let surface = &self.chunks[chunk].surface;
                    if bits::has(surface, place) {
                        return Some([x, y, z]);
                    }
                    // Chunks are skipped as a whole.
                    x = if *surface == bits::NONE { (x / EDGE + 1) * EDGE } else { x + 1 };
                }
                (x, y) = (low[0], y + 1);
            }
            (y, z) = (low[1], z + 1);
        }
        None
    }

    /// The surface at a brick, by its place among bricks, in place of what was in `patch`. It depends on the voxels of the
    /// 27 bricks around this one.
    pub fn patch(&self, brick: [usize; 3], patch: &mut Patch) {
        patch.vertices.clear();
        patch.triangles.clear();
        patch.own = 0;
        patch.known.fill(0);
        let first = brick.map(|b| (b * EDGE) as i64 - BEYOND as i64);
        let span = || (0..SPAN).flat_map(|z| (0..SPAN).flat_map(move |y| (0..SPAN).map(move |x| [x, y, z])));
        for at in span() {
            let index = std::array::from_fn(|axis| first[axis] + at[axis] as i64);
            patch.densities[in_span(at)] = self.density(index);
        }
        let is_own = |at: [usize; 3]| at.iter().all(|i| (BEYOND..BEYOND + EDGE).contains(i));
        let is_near = |at: [usize; 3]| at.iter().all(|i| (1..SPAN - 1).contains(i));
        span().filter(|&at| is_own(at)).for_each(|at| self.add_faces(at, first, patch));
        patch.own = patch.triangles.len();
        if patch.own > 0 {
            span().filter(|&at| is_near(at) && !is_own(at)).for_each(|at| self.add_faces(at, first, patch));
        }
    }

    /// Adds the triangles between a voxel of a patch, if it is solid, and its neighbours; `first`: the voxel that is the
    /// patch's (0, 0, 0).
    fn add_faces(&self, at: [usize; 3], first: [i64; 3], patch: &mut Patch) {
        if patch.densities[in_span(at)] < self.threshold() {
            return;
        }
        for axis in 0..3 {
            for up in [false, true] {
                let mut beside = at;
                beside[axis] = if up { at[axis] + 1 } else { at[axis] - 1 };
                if patch.densities[in_span(beside)] >= self.threshold() {
                    continue;
                }
                let quad = cubes_around(at, axis, up).map(|cube| {
                    if patch.known[in_span(cube)] == 0 {
                        let low = cube.map(|i| i - 1);
                        let density = |corner: [usize; 3]| {
                            patch.densities[in_span(std::array::from_fn(|axis| low[axis] + corner[axis]))]
                        };
                        let vertex = self.vertex(std::array::from_fn(|axis| first[axis] + low[axis] as i64), density);
                        patch.vertices.push(vertex.coords.into());
                        patch.known[in_span(cube)] = patch.vertices.len() as u32;
                    }
                    patch.known[in_span(cube)] - 1
                });
                patch.triangles.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
            }
        }
    }

    /// Mean of the places where the surface crosses the edges of a cube, by its lowest voxel and the densities of its
    /// corners.
    fn vertex(&self, low: [i64; 3], density: impl Fn([usize; 3]) -> u8) -> Point3<f64> {
        let iso = self.iso_density();
        let mut densities = [0.0; 8];
        for (corner, at) in densities.iter_mut().enumerate() {
            *at = f64::from(density(std::array::from_fn(|axis| corner >> axis & 1)));
        }
        let (mut sum, mut crossings) = ([0.0; 3], 0.0);
        for corner in 0..8 {
            for axis in (0..3).filter(|axis| corner >> axis & 1 == 0) {
                let (a, b) = (densities[corner], densities[corner | 1 << axis]);
                if (a >= iso) == (b >= iso) {
                    continue;
                }
                for (along, sum) in sum.iter_mut().enumerate() {
                    *sum += if along == axis { (a - iso) / (a - b) } else { (corner >> along & 1) as f64 };
                }
                crossings += 1.0;
            }
        }
        let (size, spacing) = (self.size(), self.spacing());
        let coordinate = |axis: usize| {
            let cells = low[axis] as f64 + 0.5 + sum[axis] / crossings;
            (cells - 0.5 * size[axis] as f64) * spacing[axis]
        };
        Point3::new(coordinate(0), coordinate(1), coordinate(2))
    }
}
