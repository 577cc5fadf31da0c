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
                            mesh.vertices.push(self.vertex(cube));
                            mesh.vertices.len() as u32 - 1
                        })
                    });
                    mesh.triangles.extend([[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]);
                }
            }
        }
    }

    /// Mean of the places where the surface crosses the edges of a cube.
    fn vertex(&self, cube: [usize; 3]) -> Point3<f64> {
        let iso = self.iso_density();
        let low = cube.map(|i| i as i64 - 1);
        let mut densities = [0.0; 8];
        for (corner, density) in densities.iter_mut().enumerate() {
            *density = f64::from(self.density(std::array::from_fn(|axis| low[axis] + (corner >> axis & 1) as i64)));
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
