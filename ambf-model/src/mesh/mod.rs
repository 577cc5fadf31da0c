//! Mesh files → triangles.
//!
//! [`load`] reads what collides of one file, [`MeshCache`] shares what many bodies use; [`load_visual`] reads what is
//! drawn, with normals, texture coordinates and materials, through the same readers. Positions are in the units of the
//! file (metres by convention), multiplied by nothing. 32-bit numbers, as in STL, 3DS and glTF, are widened exactly;
//! text formats are read as `f64`, except ASCII STL and ASCII PLY, whose numbers have the precision of their binary
//! twins.

mod cache;
mod dae;
mod gltf;
mod material;
mod msh;
mod obj;
mod parts;
mod placement;
mod ply;
mod primitive;
mod sources;
mod stl;
mod three_ds;
mod visual;

use std::cell::RefCell;
use std::collections::HashMap;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::files::{self, Found};

pub use cache::MeshCache;
pub use material::{MeshMaterial, MeshTexture, MetallicRoughness};
pub use parts::{enclosed_volume, has_holes};
pub use sources::Sources;
use visual::Details;
pub(crate) use visual::MAX_TRIANGLES;
pub use visual::{load_both, load_visual, parse_visual, VisualMesh, VisualMeshPart};

/// Largest file that is read, in bytes. Far above any usable collision mesh; stops a wrong path from eating the memory.
const MAX_FILE_BYTES: u64 = 512 << 20;

/// Sub-meshes that are made of one file. One costs more than the few bytes that ask for it.
const MAX_SUB_MESHES: usize = 100_000;

/// Triangles and lines of one mesh file, split as the file's materials and objects demand.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// In file order, at least one. STL has one; OBJ max(number of materials, number of objects, 1), faces assigned by
    /// material and the surplus ones empty; 3DS one for each material used by each object; Collada and glTF one for
    /// each primitive of each placed geometry; PLY and MSH one.
    pub sub_meshes: Vec<SubMesh>,
}

/// Part of a [`Mesh`].
///
/// Vertices are welded: no two are closer than 1e-14 in each coordinate, and their order is that of their first use by
/// a triangle corner, in file order.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SubMesh {
    /// Material name, else object name, else empty.
    pub name: String,
    /// Positions (n × 3) in the mesh frame. The first [`surface_vertices`](Self::surface_vertices) ones belong to
    /// triangles, the rest only to lines.
    pub vertices: Vec<[f64; 3]>,
    /// Indices into [`vertices`](Self::vertices), counter-clockwise seen from outside. May contain degenerate
    /// triangles.
    pub triangles: Vec<[u32; 3]>,
    /// Indices into [`vertices`](Self::vertices); OBJ `l` elements only, a polyline is split into its segments.
    pub lines: Vec<[u32; 2]>,
    /// (triangles × 1) part of the file that each triangle belongs to: OBJ faces after the same `o`, `g` and `usemtl`,
    /// numbered as they come. Empty: they belong to one.
    pub parts: Vec<u32>,
    /// Number of leading vertices that belong to the surface, as opposed to lines. A file of bare OBJ vertices counts
    /// them all.
    pub surface_vertices: usize,
    /// OBJ only, else empty: pairs (vertex number in the file, counted from 0; index into
    /// [`vertices`](Self::vertices)), sorted by the former. Several file vertices may share an index.
    pub file_vertices: Vec<(u32, u32)>,
}

/// Where in a file a problem was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Position {
    /// Line of a text file, counted from 1.
    Line(u32),
    /// Byte offset in a binary file.
    Byte(usize),
    /// No line or byte: the message names the part of the file.
    Whole,
}

impl fmt::Display for Position {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Position::Line(line) => write!(f, ":{line}"),
            Position::Byte(byte) => write!(f, " (byte {byte})"),
            Position::Whole => Ok(()),
        }
    }
}

/// Why a mesh file was refused.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum MeshError {
    /// Error when the file cannot be opened or read, or is a directory.
    #[error("{}: cannot read the mesh: {source}", path.display())]
    Io {
        /// The mesh file, or the material file it names.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// Error when the extension names no known format.
    #[error("{}: mesh format '{extension}' is not known; use stl, obj, 3ds, dae, ply, gltf, glb or msh", path.display())]
    UnknownFormat {
        /// The mesh file.
        path: PathBuf,
        /// Its extension as written; empty when there is none.
        extension: String,
    },
    /// Error when the file is larger than any mesh should be.
    #[error("{}: {bytes} bytes are too many for a mesh (limit {MAX_FILE_BYTES}); reduce its triangles", path.display())]
    TooLarge {
        /// The mesh file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
    },
    /// Error when the content breaks the rules of its format: truncated, bad number, index out of range.
    #[error("{}{at}: {message}", path.display())]
    Malformed {
        /// The mesh file.
        path: PathBuf,
        /// Where.
        at: Position,
        /// What was found and what was expected.
        message: String,
    },
    /// Error when a coordinate is NaN or infinite, in the file or after scaling.
    #[error("{}: vertex {vertex} is not finite: {}", path.display(), point(value))]
    NonFinite {
        /// The mesh file.
        path: PathBuf,
        /// Number of the vertex, from 0: in the file's vertex list where it has one (OBJ, 3DS, PLY, glTF, MSH), else
        /// of the triangle corner.
        vertex: usize,
        /// The offending position.
        value: [f64; 3],
    },
    /// Error when the file is well formed but holds no triangle (for OBJ: not even a vertex).
    #[error("{}: the mesh has no triangles", path.display())]
    Empty {
        /// The mesh file.
        path: PathBuf,
    },
    /// Error when a mesh has more triangles than can be drawn. It may still collide.
    #[error("{}: more than {limit} triangles cannot be drawn; reduce them, or draw another mesh than the one that collides", path.display())]
    TooManyTriangles {
        /// The mesh file.
        path: PathBuf,
        /// Most triangles of a mesh that is drawn.
        limit: usize,
    },
    /// Error when a vertex is too far from the origin for the 32-bit numbers of a drawn mesh. It may still collide.
    #[error("{}: a vertex at {} is too far away to be drawn (limit {limit:e}); is the unit of the file right?", path.display(), point(value))]
    TooFar {
        /// The mesh file.
        path: PathBuf,
        /// The offending position.
        value: [f64; 3],
        /// Largest coordinate.
        limit: f64,
    },
    /// Error when a mesh is asked for with a scale that is NaN or infinite.
    #[error("{}: scale {scale} is not a finite number", path.display())]
    Scale {
        /// The mesh file.
        path: PathBuf,
        /// What was asked for.
        scale: f64,
    },
}

impl MeshError {
    fn malformed(path: &Path, at: Position, message: impl Into<String>) -> Self {
        let (path, message) = (path.to_path_buf(), message.into());
        MeshError::Malformed { path, at, message }
    }
}

/// Reads a mesh file; the format follows the extension, in any letter case: `stl` (binary or ASCII), `obj`, `3ds`,
/// `dae`, `ply` (binary or ASCII), `gltf`, `glb`, `msh` (that of MuJoCo).
///
/// glTF says that +y is up and +z is forward. In ADF +z is up, so that a point (x, y, z) of a glTF file becomes (x, −z,
/// y), as in Blender and Drake. No other format is turned.
///
/// # Errors
/// See [`MeshError`]. A missing OBJ material library is not an error: the file then counts as one without materials. A
/// missing buffer of a glTF file is one.
///
/// # Limitations
/// * OBJ: free-form curves and surfaces are skipped. Faces with fewer than three corners are skipped.
/// * 3DS: objects are taken as stored; key frames and mirrored object matrices are ignored.
/// * Collada: `<up_axis>` is ignored (robot descriptions expect coordinates as written), the unit and the node
///   transforms are applied; skins, splines and lines are skipped.
/// * PLY: only vertices and polygons are read, no triangle strips. Points without faces are an error.
/// * MSH: texture coordinates are skipped. Of a file without triangles the vertices are read.
/// * glTF: version 2.0, without compression and without sparse accessors. The default scene is read, else the first,
///   else all nodes. Skins are drawn as their nodes place them; morph targets, animations, points and lines are
///   skipped. Of textures the base colour, metalness with roughness, and normals are drawn, all with the texture
///   coordinates of the first of them, repeated beyond 0 … 1, and untransformed. Masks of textures are drawn opaque.
pub fn load(path: &Path) -> Result<Mesh, MeshError> {
    let reader = reader_of(path)?;
    not_empty(path, reader(path, read_file(path)?, &ON_DISK, None)?)
}

/// Reads a mesh file as [`load`] does, and tells which files that depends on, also those that were looked for in vain:
/// `sources` gets them.
///
/// # Errors
/// As [`load`].
pub fn load_with_sources(path: &Path, sources: &mut Sources) -> Result<Mesh, MeshError> {
    let reader = reader_of(path)?;
    sources.add(path);
    let bytes = read_file(path)?;
    let named = RefCell::new(sources);
    let open = |path: &Path| {
        named.borrow_mut().add(path);
        read_file(path)
    };
    let look = |path: &Path| {
        named.borrow_mut().add(path);
        files::look(path)
    };
    not_empty(path, reader(path, bytes, &Files { open: &open, look: &look }, None)?)
}

/// Reads the content of a mesh file as [`load`] reads a file; `path` stands for its name. No file is opened: the
/// material libraries that an OBJ names and the buffers that a glTF names count as missing.
///
/// # Errors
/// As [`load`].
pub fn parse(bytes: Vec<u8>, path: &Path) -> Result<Mesh, MeshError> {
    let reader = reader_of(path)?;
    let open = |path: &Path| Err(io_error(path, io::ErrorKind::NotFound.into()));
    not_empty(path, reader(path, checked_size(path, bytes)?, &Files { open: &open, look: &|_| Found::Nothing }, None)?)
}

fn checked_size(path: &Path, bytes: Vec<u8>) -> Result<Vec<u8>, MeshError> {
    if bytes.len() as u64 > MAX_FILE_BYTES {
        return Err(MeshError::TooLarge { path: path.to_path_buf(), bytes: bytes.len() as u64 });
    }
    Ok(bytes)
}

/// The files that a mesh names.
struct Files<'a> {
    /// Reads one.
    open: &'a dyn Fn(&Path) -> Result<Vec<u8>, MeshError>,
    /// What is there.
    look: &'a dyn Fn(&Path) -> Found,
}

const ON_DISK: Files<'static> = Files { open: &read_file, look: &files::look };

/// Reads the mesh, and into the details, if wanted, how it looks: one for each sub-mesh.
type Reader = fn(&Path, Vec<u8>, &Files, Option<&mut Details>) -> Result<Mesh, MeshError>;

fn reader_of(path: &Path) -> Result<Reader, MeshError> {
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    Ok(match extension.to_ascii_lowercase().as_str() {
        "stl" => |path, bytes, _, details| stl::read(path, bytes, details),
        "obj" => obj::read,
        "3ds" => three_ds::read,
        "dae" => dae::read,
        "ply" => ply::read,
        "gltf" | "glb" => gltf::read,
        "msh" => |path, bytes, _, details| msh::read(path, &bytes, details),
        _ => return Err(MeshError::UnknownFormat { path: path.to_path_buf(), extension: extension.into_owned() }),
    })
}

fn not_empty(path: &Path, mesh: Mesh) -> Result<Mesh, MeshError> {
    if mesh.sub_meshes.iter().all(|s| s.vertices.is_empty()) {
        return Err(MeshError::Empty { path: path.to_path_buf() });
    }
    Ok(mesh)
}

fn io_error(path: &Path, source: io::Error) -> MeshError {
    MeshError::Io { path: path.to_path_buf(), source }
}

/// Reads a regular file of bounded size.
fn read_file(path: &Path) -> Result<Vec<u8>, MeshError> {
    let bytes = files::read(path, MAX_FILE_BYTES).map_err(|source| io_error(path, source))?;
    match bytes.len() as u64 > MAX_FILE_BYTES {
        true => Err(MeshError::TooLarge {
            path: path.to_path_buf(),
            bytes: std::fs::metadata(path).map_or(0, |found| found.len()),
        }),
        false => Ok(bytes),
    }
}

impl Mesh {
    /// A copy with all positions multiplied by `scale` (dimensionless). A negative scale mirrors, and reverses the
    /// triangles so that they still face outwards.
    pub fn scaled(&self, scale: f64) -> Mesh {
        self.scaled_along([scale; 3])
    }

    /// A copy with x, y and z of all positions multiplied by a factor each (dimensionless). An odd number of negative
    /// factors mirrors, and reverses the triangles so that they still face outwards.
    pub fn scaled_along(&self, scale: [f64; 3]) -> Mesh {
        let mirrors = scale.iter().filter(|factor| **factor < 0.0).count() % 2 == 1;
        let mut mesh = self.clone();
        for sub in &mut mesh.sub_meshes {
            for vertex in &mut sub.vertices {
                *vertex = [vertex[0] * scale[0], vertex[1] * scale[1], vertex[2] * scale[2]];
            }
            if mirrors {
                sub.triangles.iter_mut().for_each(|t| t.swap(1, 2));
            }
        }
        mesh
    }

    /// A mesh of one part with these triangles, or, if there are none, with these vertices; `None`: an index is out of range, or a
    /// number is not finite.
    pub(crate) fn of_triangles(vertices: &[[f64; 3]], triangles: &[[usize; 3]]) -> Option<Mesh> {
        let is_finite = vertices.as_flattened().iter().all(|number| number.is_finite());
        let exists = triangles.as_flattened().iter().all(|index| *index < vertices.len());
        if !(is_finite && exists) {
            return None;
        }
        let mut surface = Welder::default();
        triangles.iter().for_each(|triangle| surface.triangle(triangle.map(|index| vertices[index])));
        if triangles.is_empty() {
            vertices.iter().for_each(|vertex| {
                surface.vertex(*vertex);
            });
        }
        Some(Mesh { sub_meshes: vec![surface.finish()] })
    }

    /// Number of triangles of all sub-meshes.
    pub fn triangle_count(&self) -> usize {
        self.sub_meshes.iter().map(|s| s.triangles.len()).sum()
    }

    /// Number of vertices of all sub-meshes.
    pub fn vertex_count(&self) -> usize {
        self.sub_meshes.iter().map(|s| s.vertices.len()).sum()
    }
}

/// Collects triangles into a welded [`SubMesh`].
///
/// The C++ program merges vertices by a hash of their position that distinct vertices can share; comparing positions
/// has no such collisions.
#[derive(Default)]
struct Welder {
    sub_mesh: SubMesh,
    index_of: HashMap<[u64; 3], u32>,
}

/// Coordinates closer than this, in the units of the file, are the same.
const SAME_POSITION: f64 = 1e-14;

impl Welder {
    fn named(name: &str) -> Self {
        let mut welder = Welder::default();
        welder.sub_mesh.name = name.to_owned();
        welder
    }

    /// Index of the vertex at `position`, which must be finite.
    fn vertex(&mut self, position: [f64; 3]) -> u32 {
        // Exporters leave 1e-17 where they mean 0. Adding 0 turns -0 into 0, so that bit equality is numeric equality.
        let key = position.map(|x| ((x / SAME_POSITION).round() + 0.0).to_bits());
        let next = self.sub_mesh.vertices.len() as u32;
        let index = *self.index_of.entry(key).or_insert(next);
        if index == next {
            self.sub_mesh.vertices.push(position);
        }
        index
    }

    fn triangle(&mut self, corners: [[f64; 3]; 3]) {
        let triangle = corners.map(|p| self.vertex(p));
        self.sub_mesh.triangles.push(triangle);
    }

    /// Ends the surface: vertices added from now on belong to lines only.
    fn end_surface(&mut self) {
        self.sub_mesh.surface_vertices = self.sub_mesh.vertices.len();
    }

    fn finish(mut self) -> SubMesh {
        if self.sub_mesh.lines.is_empty() {
            self.end_surface();
        }
        self.sub_mesh
    }
}

/// Coordinates as they stand in a message.
fn point([x, y, z]: &[f64; 3]) -> String {
    format!("({x:?}, {y:?}, {z:?})")
}

/// A word of the file as it may stand in a message: printable and short.
fn quoted(word: &str) -> String {
    format!("'{}'", printable(word, 40))
}

/// The first `limit` characters of a text, those that cannot be printed escaped.
fn printable(text: &str, limit: usize) -> String {
    let start: String = text.chars().take(limit).collect();
    format!("{}{}", start.escape_debug(), if start.len() < text.len() { "…" } else { "" })
}

/// A part of a URL with its `%20` and the like as characters.
fn decoded(url: &str) -> String {
    let mut bytes = Vec::new();
    let mut rest = url.as_bytes();
    while let [first, behind @ ..] = rest {
        let digits = behind.get(..2).and_then(|digits| std::str::from_utf8(digits).ok());
        let code = digits.filter(|_| *first == b'%').and_then(|digits| u8::from_str_radix(digits, 16).ok());
        bytes.push(code.unwrap_or(*first));
        rest = if code.is_some() { &behind[2..] } else { behind };
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

fn check_finite(path: &Path, vertex: usize, value: [f64; 3]) -> Result<[f64; 3], MeshError> {
    if value.iter().all(|x| x.is_finite()) {
        Ok(value)
    } else {
        Err(MeshError::NonFinite { path: path.to_path_buf(), vertex, value })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn welding_keeps_first_use_order_and_all_but_rounding_errors() {
        let tiny = 1e-13;
        let mut w = Welder::default();
        w.triangle([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        w.triangle([[-0.0, 1.7e-17, -0.0], [tiny, 0.0, 0.0], [1.0, -0.0, 0.0]]);
        let sub = w.finish();
        assert_eq!(sub.vertices, [[1.0, 0.0, 0.0], [0.0; 3], [0.0, 1.0, 0.0], [tiny, 0.0, 0.0]]);
        assert_eq!(sub.triangles, [[0, 1, 2], [1, 3, 0]]);
        assert_eq!(sub.surface_vertices, 4);
    }

    #[test]
    fn given_triangles_are_checked_and_drawn() {
        let corners = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]];
        let mesh = Mesh::of_triangles(&corners, &[[0, 2, 4], [0, 1, 3]]).unwrap();
        assert_eq!(mesh.sub_meshes[0].triangles, [[0, 1, 2], [0, 2, 3]], "welded");
        assert_eq!(Mesh::of_triangles(&corners, &[]).unwrap().vertex_count(), 4);
        assert_eq!(Mesh::of_triangles(&corners, &[[0, 1, 5]]), None);
        assert_eq!(Mesh::of_triangles(&[[0.0, f64::NAN, 0.0]], &[]), None);
        let normals = |smooth| VisualMesh::of(&mesh, Path::new("m"), smooth).unwrap().parts.remove(0).normals;
        assert_eq!(normals(false), [[[0.0, 0.0, -1.0]; 3], [[0.0, -1.0, 0.0]; 3]].concat());
        assert_eq!(normals(true).len(), 4);
        let far = Mesh::of_triangles(&[[1e30; 3], [0.0; 3], [1.0; 3]], &[[0, 1, 2]]).unwrap();
        assert!(matches!(VisualMesh::of(&far, Path::new("m"), false), Err(MeshError::TooFar { .. })));
    }

    #[test]
    fn a_negative_scale_mirrors_and_reverses() {
        let mut w = Welder::default();
        w.triangle([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]]);
        let mesh = Mesh { sub_meshes: vec![w.finish()] }.scaled(-2.0);
        assert_eq!(mesh.sub_meshes[0].vertices[2], [0.0, 0.0, -6.0]);
        assert_eq!(mesh.sub_meshes[0].triangles, [[0, 2, 1]]);
        let mesh = mesh.scaled_along([-0.5, -1.0, 2.0]);
        assert_eq!(mesh.sub_meshes[0].vertices[2], [0.0, 0.0, -12.0]);
        assert_eq!(mesh.sub_meshes[0].triangles, [[0, 2, 1]]);
    }

    #[test]
    fn messages_quote_garbage_safely() {
        assert_eq!(quoted("1.0x"), "'1.0x'");
        assert_eq!(quoted("\u{1b}[31m"), "'\\u{1b}[31m'");
        assert_eq!(quoted(&"9".repeat(1000)).chars().count(), 43);
    }

    #[test]
    fn unreadable_paths_are_errors() {
        let dir = std::env::temp_dir();
        assert!(matches!(load(&dir.join("none.stl")), Err(MeshError::Io { .. })));
        assert!(
            matches!(load(Path::new("a.fbx")), Err(MeshError::UnknownFormat { extension, .. }) if extension == "fbx")
        );
        assert!(
            matches!(load(Path::new("plain")), Err(MeshError::UnknownFormat { extension, .. }) if extension.is_empty())
        );
        assert!(matches!(read_file(&dir), Err(MeshError::Io { .. })));
    }
}
