//! What is drawn of a mesh: vertices with normals and texture coordinates, one part a material.
//!
//! The readers of the formats are those of the collision meshes. They make the same [`Mesh`] for both purposes, and, if
//! asked, describe the corners of its triangles besides; here the two are put together.

use std::collections::HashMap;
use std::path::Path;

use nalgebra::{Isometry3, Point3, Vector3};

use super::material::{MeshMaterial, Warnings};
use crate::files::Found;

use super::{checked_size, io_error, not_empty, read_file, reader_of, Files, Mesh, MeshError, SubMesh, ON_DISK};

/// Most triangles of a mesh that is drawn.
pub(crate) const MAX_TRIANGLES: usize = 10_000_000;

/// Largest coordinate of a vertex that is drawn: its square is still a 32-bit number.
const MAX_COORDINATE: f64 = 1e18;

/// No texture coordinate, or no normal.
pub(super) const ABSENT: u32 = u32::MAX;

/// Triangles to draw.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct VisualMesh {
    /// Parts that have triangles, in the order of [`Mesh::sub_meshes`].
    pub parts: Vec<VisualMeshPart>,
}

/// Part of a [`VisualMesh`] with one material.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct VisualMeshPart {
    /// Material name, else object name, else empty.
    pub name: String,
    /// Positions (n × 3) in the mesh frame, in the units of the file (m by convention); finite.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals (n × 3), outwards.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates (n × 2), or empty. v = 0 is the bottom row of the texture; it repeats beyond 0 … 1. Finite.
    pub tex_coords: Vec<[f32; 2]>,
    /// Colours by which the lit colour is multiplied (n × 4), red, green, blue and alpha, 0 to 1, or empty.
    pub colors: Vec<[f32; 4]>,
    /// Directions of growing u (n × 4), or empty: unit vectors at right angles to the normals. The direction of growing
    /// v is w · normal × tangent, with w = 1 or −1. There are some where the material has a normal map and there are
    /// texture coordinates.
    pub tangents: Vec<[f32; 4]>,
    /// Indices (m × 3) into the vertices, counter-clockwise seen from outside. As many as the part of [`Mesh`] has,
    /// degenerate ones included.
    pub triangles: Vec<[u32; 3]>,
    /// For each vertex (n × 1) its node: the index in the vertices of all [`Mesh::sub_meshes`] one behind the other.
    /// Nodes of a soft body are numbered so. In the profile `legacy` a soft body consists of the last filled sub-mesh
    /// only; its node 0 is the first of that one. For primitives, which have no nodes, the vertex's own index.
    pub nodes: Vec<u32>,
    /// How it looks.
    pub material: MeshMaterial,
}

/// A corner of a triangle, as the file describes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Corner {
    /// Corners of a part with the same number share a normal, where one is computed. They are at one place.
    pub shared: u32,
    /// Index in [`Details::tex_coords`], or [`ABSENT`].
    pub tex_coord: u32,
    /// Index in [`Details::normals`], or [`ABSENT`].
    pub normal: u32,
    /// Index in [`Details::colors`], or [`ABSENT`].
    pub color: u32,
}

impl Corner {
    /// A corner of which nothing is known.
    pub(super) fn bare(shared: u32) -> Self {
        Self { shared, tex_coord: ABSENT, normal: ABSENT, color: ABSENT }
    }
}

/// What is known of the corners of a part.
#[derive(Debug, Default)]
pub(super) enum Facing {
    /// Triangles that share a vertex share its normal.
    #[default]
    Smooth,
    /// Each triangle has its own normal.
    Flat,
    /// Three corners for each triangle of the sub-mesh.
    Corners(Vec<Corner>),
}

/// How a sub-mesh looks.
#[derive(Debug, Default)]
pub(super) struct PartDetails {
    pub material: MeshMaterial,
    pub facing: Facing,
}

/// How a mesh looks.
#[derive(Debug, Default)]
pub(super) struct Details {
    /// One for each sub-mesh.
    pub parts: Vec<PartDetails>,
    /// Finite.
    pub tex_coords: Vec<[f32; 2]>,
    /// Finite. One of length 0 means that there is none.
    pub normals: Vec<[f32; 3]>,
    /// Red, green, blue and alpha, 0 to 1.
    pub colors: Vec<[f32; 4]>,
    pub warnings: Warnings,
}

/// Reads how a mesh file looks. Formats as for [`load`](super::load).
///
/// With `remove_duplicates` (key `mesh remove duplicates`) corners at one place share a normal, which is computed: the
/// surface looks smooth, and normals of the file are not used. Texture coordinates stay. Without it, OBJ, Collada, PLY
/// and glTF have the normals of the file; corners without one get the mean over the triangles at their vertex, weighted
/// by area. STL has facets, as a part of a glTF file without normals; 3DS has smoothing groups.
///
/// Also returns messages, each with file and line where there is one, about what is not drawn as written: missing
/// textures and libraries, numbers that are none. At most 51.
///
/// # Errors
/// As [`load`](super::load); besides [`MeshError::TooManyTriangles`] beyond 10 million, [`MeshError::TooFar`].
pub fn load_visual(path: &Path, remove_duplicates: bool) -> Result<(VisualMesh, Vec<String>), MeshError> {
    load_both(path, remove_duplicates).map(|(_, visual, messages)| (visual, messages))
}

/// Reads a mesh file once for both purposes: what [`load`](super::load) and [`load_visual`] give.
///
/// # Errors
/// As [`load_visual`].
pub fn load_both(path: &Path, remove_duplicates: bool) -> Result<(Mesh, VisualMesh, Vec<String>), MeshError> {
    reader_of(path)?;
    both(path, read_file(path)?, &ON_DISK, remove_duplicates)
}

/// Reads the content of a mesh file as [`load_visual`] reads a file; `path` stands for its name. `named` gives the
/// content of the files that the mesh names, `None` for those that are not there. Of textures only the presence counts.
///
/// # Errors
/// As [`load_visual`].
pub fn parse_visual(
    bytes: Vec<u8>,
    path: &Path,
    remove_duplicates: bool,
    named: &dyn Fn(&Path) -> Option<Vec<u8>>,
) -> Result<(VisualMesh, Vec<String>), MeshError> {
    let open = |path: &Path| match named(path) {
        Some(bytes) => checked_size(path, bytes),
        None => Err(io_error(path, std::io::ErrorKind::NotFound.into())),
    };
    let files = Files { open: &open, look: &|path| named(path).map_or(Found::Nothing, |_| Found::File) };
    let bytes = checked_size(path, bytes)?;
    both(path, bytes, &files, remove_duplicates).map(|(_, visual, messages)| (visual, messages))
}

fn both(
    path: &Path,
    bytes: Vec<u8>,
    files: &Files,
    remove_duplicates: bool,
) -> Result<(Mesh, VisualMesh, Vec<String>), MeshError> {
    let mut details = Details::default();
    let mesh = not_empty(path, reader_of(path)?(path, bytes, files, Some(&mut details))?)?;
    let visual = assemble(path, &mesh, &mut details, remove_duplicates)?;
    if visual.parts.is_empty() {
        details.warnings.add_general(path, "the mesh has vertices but no triangles; nothing of it is drawn");
    }
    Ok((mesh, visual, details.warnings.finish(path)))
}

impl VisualMesh {
    /// How a mesh that is in no file looks, as one in STL does. `name` stands for that of the file.
    ///
    /// # Errors
    /// [`MeshError::TooManyTriangles`] beyond 10 million, [`MeshError::TooFar`].
    pub fn of(mesh: &Mesh, name: &Path, remove_duplicates: bool) -> Result<Self, MeshError> {
        let flat = || PartDetails { facing: Facing::Flat, ..PartDetails::default() };
        let parts = mesh.sub_meshes.iter().map(|_| flat()).collect();
        assemble(name, mesh, &mut Details { parts, ..Details::default() }, remove_duplicates)
    }
}

fn assemble(path: &Path, mesh: &Mesh, details: &mut Details, remove_duplicates: bool) -> Result<VisualMesh, MeshError> {
    if mesh.triangle_count() > MAX_TRIANGLES {
        return Err(MeshError::TooManyTriangles { path: path.to_path_buf(), limit: MAX_TRIANGLES });
    }
    let parts = std::mem::take(&mut details.parts);
    let mut visual = VisualMesh::default();
    let mut first_node = 0;
    for (sub, part) in mesh.sub_meshes.iter().zip(parts) {
        if let Some(value) = sub.vertices.iter().find(|v| v.iter().any(|x| x.abs() > MAX_COORDINATE)) {
            return Err(MeshError::TooFar { path: path.to_path_buf(), value: *value, limit: MAX_COORDINATE });
        }
        if !sub.triangles.is_empty() {
            let corners = Corners { sub, part: &part, remove_duplicates };
            let mut drawn = corners.join(details);
            drawn.name.clone_from(&sub.name);
            drawn.nodes.iter_mut().for_each(|node| *node += first_node);
            drawn.material = part.material;
            drawn.add_tangents();
            visual.parts.push(drawn);
        }
        first_node += sub.vertices.len() as u32;
    }
    Ok(visual)
}

/// The triangles of a sub-mesh with what is known of their corners.
struct Corners<'a> {
    sub: &'a SubMesh,
    part: &'a PartDetails,
    remove_duplicates: bool,
}

impl Corners<'_> {
    /// Corner `k` of triangle `i`.
    fn get(&self, i: usize, k: usize) -> Corner {
        let node = self.sub.triangles[i][k];
        match &self.part.facing {
            Facing::Corners(corners) if self.remove_duplicates => {
                Corner { shared: node, normal: ABSENT, ..corners[3 * i + k] }
            }
            Facing::Corners(corners) => corners[3 * i + k],
            // Numbers of facets; there are no other uses of `shared` in such a part.
            Facing::Flat if !self.remove_duplicates => Corner::bare(i as u32),
            Facing::Flat | Facing::Smooth => Corner::bare(node),
        }
    }

    /// Vertices and triangles, without name, tangents and material; nodes are counted from the sub-mesh's first one.
    fn join(&self, Details { tex_coords, normals, colors, .. }: &Details) -> VisualMeshPart {
        let is_flat = matches!(self.part.facing, Facing::Flat) && !self.remove_duplicates;
        let mut part = VisualMeshPart::default();
        let mut vertices = Vertices::new(self.sub.vertices.len());
        for (i, triangle) in self.sub.triangles.iter().enumerate() {
            let indices = std::array::from_fn(|k| {
                let (corner, node) = (self.get(i, k), triangle[k]);
                // No facet shares a vertex with another, so that there is nothing to look up.
                let (index, is_new) = if is_flat { vertices.add(corner) } else { vertices.find_or_add(node, corner) };
                if is_new {
                    part.nodes.push(node);
                    part.positions.push(self.sub.vertices[node as usize].map(|x| x as f32));
                }
                index
            });
            part.triangles.push(indices);
        }
        let corners = vertices.corners;
        let given = |corner: &Corner| {
            let normal = normals.get(corner.normal as usize)?;
            Vector3::from(*normal).cast::<f64>().try_normalize(0.0)
        };
        part.normals = match corners.iter().all(|corner| given(corner).is_some()) {
            true => Vec::new(),
            false => self.smooth_normals(&corners, &part.triangles),
        };
        part.normals.resize(corners.len(), [0.0, 0.0, 1.0]);
        for (normal, corner) in part.normals.iter_mut().zip(&corners) {
            *normal = given(corner).map_or(*normal, |given| given.cast::<f32>().into());
        }
        if corners.iter().any(|corner| corner.tex_coord != ABSENT) {
            let of = |corner: &Corner| tex_coords.get(corner.tex_coord as usize).copied().unwrap_or_default();
            part.tex_coords.extend(corners.iter().map(of));
        }
        if corners.iter().any(|corner| corner.color != ABSENT) {
            let of = |corner: &Corner| colors.get(corner.color as usize).copied().unwrap_or([1.0; 4]);
            part.colors.extend(corners.iter().map(of));
        }
        part
    }

    /// Unit normals of vertices: means over the triangles at those with the same number, weighted by area. Means that
    /// cancel, as where a sheet has two sides, are replaced by the normal of the first triangle.
    fn smooth_normals(&self, vertices: &[Corner], triangles: &[[u32; 3]]) -> Vec<[f32; 3]> {
        let mut numbers: Vec<u32> = vertices.iter().map(|corner| corner.shared).collect();
        numbers.sort_unstable();
        numbers.dedup();
        // Mostly all numbers from 0 are there; in a part of a large file only some.
        let is_dense = numbers.last().is_some_and(|last| *last as usize + 1 == numbers.len());
        let slot = |corner: &Corner| match is_dense {
            true => corner.shared as usize,
            false => numbers.partition_point(|number| *number < corner.shared),
        };
        let slots: Vec<usize> = vertices.iter().map(slot).collect();
        let mut sums = vec![(Vector3::<f64>::zeros(), Vector3::<f64>::zeros()); numbers.len()];
        for (nodes, triangle) in self.sub.triangles.iter().zip(triangles) {
            let [a, b, c] = nodes.map(|node| Vector3::from(self.sub.vertices[node as usize]));
            let cross = (b - a).cross(&(c - a));
            for vertex in triangle {
                let (sum, first) = &mut sums[slots[*vertex as usize]];
                *sum += cross;
                if *first == Vector3::zeros() {
                    *first = cross;
                }
            }
        }
        let unit = |(sum, first): &(Vector3<f64>, Vector3<f64>)| {
            // What is left of opposite normals is rounding errors.
            let least = 1e-9 * first.norm();
            let unit = sum.try_normalize(least).or_else(|| first.try_normalize(0.0)).unwrap_or_else(Vector3::z);
            <[f32; 3]>::from(unit.cast::<f32>())
        };
        let units: Vec<[f32; 3]> = sums.iter().map(unit).collect();
        slots.into_iter().map(|slot| units[slot]).collect()
    }
}

/// Most vertices of a node that are looked through one by one.
const MAX_CHAIN: usize = 16;

/// Corners that became vertices.
struct Vertices {
    corners: Vec<Corner>,
    /// The newest vertex in the chain of each node, or [`ABSENT`].
    newest: Vec<u32>,
    /// The vertex before each one in the chain of its node, or [`ABSENT`]; shorter than `corners` behind the last one
    /// in a chain.
    older: Vec<u32>,
    /// Those for which the chain of their node is too long.
    crowded: HashMap<(u32, Corner), u32>,
}

impl Vertices {
    fn new(nodes: usize) -> Self {
        Self { corners: Vec::new(), newest: vec![ABSENT; nodes], older: Vec::new(), crowded: HashMap::new() }
    }

    /// Index of a new vertex, which is in no chain, and `true`.
    fn add(&mut self, corner: Corner) -> (u32, bool) {
        self.corners.push(corner);
        (self.corners.len() as u32 - 1, true)
    }

    /// Index of the vertex of this corner at `node`, and whether it is new.
    fn find_or_add(&mut self, node: u32, corner: Corner) -> (u32, bool) {
        let newest = self.newest[node as usize];
        let mut vertex = newest;
        let mut length = 0;
        while vertex != ABSENT {
            if self.corners[vertex as usize] == corner {
                return (vertex, false);
            }
            vertex = self.older[vertex as usize];
            length += 1;
        }
        let next = self.corners.len() as u32;
        if length < MAX_CHAIN {
            self.older.resize(next as usize, ABSENT);
            self.older.push(newest);
            self.newest[node as usize] = next;
        } else {
            let vertex = *self.crowded.entry((node, corner)).or_insert(next);
            if vertex != next {
                return (vertex, false);
            }
        }
        self.add(corner)
    }
}

impl VisualMesh {
    /// Least and greatest coordinates of all vertices, in the mesh frame; `None` if there is none.
    pub fn bounds(&self) -> Option<([f32; 3], [f32; 3])> {
        let mut positions = self.parts.iter().flat_map(|part| &part.positions);
        let first = *positions.next()?;
        Some(positions.fold((first, first), |(low, high), position| {
            (std::array::from_fn(|i| low[i].min(position[i])), std::array::from_fn(|i| high[i].max(position[i])))
        }))
    }

    /// Number of triangles of all parts.
    pub fn triangle_count(&self) -> usize {
        self.parts.iter().map(|part| part.triangles.len()).sum()
    }

    /// A copy in the frame in which the mesh frame has pose `pose`.
    pub fn transformed(&self, pose: &Isometry3<f64>) -> VisualMesh {
        let mut mesh = self.clone();
        for part in &mut mesh.parts {
            for position in &mut part.positions {
                *position = (pose * Point3::from(*position).cast::<f64>()).cast::<f32>().into();
            }
            for normal in &mut part.normals {
                *normal = (pose * Vector3::from(*normal).cast::<f64>()).cast::<f32>().into();
            }
            for [x, y, z, _] in &mut part.tangents {
                [*x, *y, *z] = (pose * Vector3::new(*x, *y, *z).cast::<f64>()).cast::<f32>().into();
            }
        }
        mesh
    }

    /// A copy with all positions multiplied by `scale` (dimensionless), as [`Mesh::scaled`]. `None` if a position
    /// overflows.
    pub fn scaled(&self, scale: f64) -> Option<VisualMesh> {
        self.scaled_along([scale; 3])
    }

    /// A copy with x, y and z of all positions multiplied by a factor each (dimensionless), as [`Mesh::scaled_along`]:
    /// an odd number of negative factors mirrors, and reverses the triangles so that they still face outwards. `None`
    /// if a position overflows.
    pub fn scaled_along(&self, scale: [f64; 3]) -> Option<VisualMesh> {
        let mirrors = scale.iter().filter(|factor| **factor < 0.0).count() % 2 == 1;
        // Normals stay at right angles to the surface. Products instead of quotients, so that a factor of 0 is
        // possible.
        let [x, y, z] = scale.map(|factor| factor / scale.iter().fold(f64::MIN_POSITIVE, |most, x| most.max(x.abs())));
        let cofactors = Vector3::new(y * z, z * x, x * y) * if mirrors { -1.0 } else { 1.0 };
        let factors = Vector3::new(x, y, z);
        let mut mesh = self.clone();
        for part in &mut mesh.parts {
            for position in &mut part.positions {
                *position = std::array::from_fn(|i| (f64::from(position[i]) * scale[i]) as f32);
                if position.iter().any(|x| x.is_nan() || f64::from(x.abs()) > MAX_COORDINATE) {
                    return None;
                }
            }
            for normal in &mut part.normals {
                let unscaled = Vector3::from(*normal).cast::<f64>();
                let scaled = unscaled.component_mul(&cofactors).try_normalize(0.0).unwrap_or(unscaled);
                *normal = scaled.cast::<f32>().into();
            }
            for (tangent, normal) in part.tangents.iter_mut().zip(&part.normals) {
                let [x, y, z, w] = *tangent;
                let scaled = Vector3::new(x, y, z).cast::<f64>().component_mul(&factors);
                let scaled = at_right_angles(scaled, Vector3::from(*normal).cast());
                *tangent = [scaled.x as f32, scaled.y as f32, scaled.z as f32, if mirrors { -w } else { w }];
            }
            if mirrors {
                part.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
            }
        }
        Some(mesh)
    }
}

/// Unit vector in direction `tangent` as far as it is at right angles to the unit vector `normal`; any other at right
/// angles if that is none.
fn at_right_angles(tangent: Vector3<f64>, normal: Vector3<f64>) -> Vector3<f64> {
    let projected = tangent - normal * normal.dot(&tangent);
    // A direction that is almost the normal's is left of rounding errors.
    projected.try_normalize(1e-9 * tangent.norm()).unwrap_or_else(|| {
        let axis = if normal.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
        normal.cross(&axis).normalize()
    })
}

impl VisualMeshPart {
    /// Computes the tangents where a normal map needs them.
    fn add_tangents(&mut self) {
        if self.material.normal_map.is_none() || self.tex_coords.is_empty() {
            return;
        }
        // Sums of the directions of growing u and v, weighted by area.
        let mut sums = vec![(Vector3::<f64>::zeros(), Vector3::<f64>::zeros()); self.positions.len()];
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|i| Vector3::from(self.positions[i as usize]).cast::<f64>());
            let [s, t, r] = triangle.map(|i| self.tex_coords[i as usize].map(f64::from));
            let (e1, e2) = (b - a, c - a);
            let (d1, d2) = ([t[0] - s[0], t[1] - s[1]], [r[0] - s[0], r[1] - s[1]]);
            let determinant = d1[0] * d2[1] - d2[0] * d1[1];
            let sign = if determinant < 0.0 { -1.0 } else { 1.0 };
            let area = e1.cross(&e2).norm();
            let weighted = |v: Vector3<f64>| v.try_normalize(0.0).map_or_else(Vector3::zeros, |v| v * area * sign);
            let (u, v) = (weighted(e1 * d2[1] - e2 * d1[1]), weighted(e2 * d1[0] - e1 * d2[0]));
            // Without an area in the texture there are no directions.
            if determinant != 0.0 {
                for i in triangle {
                    sums[*i as usize].0 += u;
                    sums[*i as usize].1 += v;
                }
            }
        }
        let tangent = |((u, v), normal): (&(Vector3<f64>, Vector3<f64>), &[f32; 3])| {
            let normal = Vector3::from(*normal).cast::<f64>();
            let tangent = at_right_angles(*u, normal);
            let w = if normal.cross(&tangent).dot(v) < 0.0 { -1.0 } else { 1.0 };
            [tangent.x as f32, tangent.y as f32, tangent.z as f32, w]
        };
        self.tangents = sums.iter().zip(&self.normals).map(tangent).collect();
    }
}

#[cfg(test)]
mod tests;
