//! Meshes and textures on the graphics card, each loaded once.

use std::collections::{HashMap, HashSet};
use std::fmt;
use std::hash::{Hash, Hasher};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::Arc;

use ambf_core::adf::{Axis, Primitive};
use ambf_core::mesh::{load_visual, Mesh, MeshMaterial, MeshTexture, VisualMesh, VisualMeshPart};
use nalgebra::{Point3, Vector3};
use parking_lot::Mutex;

use crate::gl::{self, Current, Layout, VertexArray};
use crate::stage::Look;
use crate::{RenderError, Texture};

/// Triangles of one material.
pub(crate) struct Part {
    pub(crate) array: VertexArray,
    /// Material of the file.
    pub(crate) look: Look,
    pub(crate) diffuse_map: Option<Arc<gl::Texture>>,
    pub(crate) normal_map: Option<Arc<gl::Texture>>,
    /// Factors of roughness and metalness, if the material is physically based.
    pub(crate) physical_map: Option<Arc<gl::Texture>>,
    /// Bounding sphere.
    pub(crate) center: Point3<f64>,
    /// Its radius.
    pub(crate) radius: f64,
    /// Normal of its triangles, if all of them lie in one plane and face the same way.
    pub(crate) flat: Option<Vector3<f64>>,
    /// A closed surface whose triangles face outwards, of which nobody outside sees a back.
    pub(crate) is_closed: bool,
}

/// A mesh that is loaded.
pub(crate) struct LoadedMesh {
    pub(crate) parts: Vec<Arc<Part>>,
    /// Corners of the bounding box; `None`: it has no vertices.
    pub(crate) bounds: Option<(Vector3<f64>, Vector3<f64>)>,
}

/// A part whose vertices follow the nodes of a soft body.
pub(crate) struct SoftPart {
    /// As uploaded: positions and normals change.
    vertices: Vec<f32>,
    floats: usize,
    /// (vertices x 1) node of each vertex.
    nodes: Vec<u32>,
    triangles: Vec<[u32; 3]>,
    /// (nodes x 3) sums of the normals of the triangles at each node.
    normals: Vec<Vector3<f32>>,
}

/// What messages call a mesh of a description.
const TRIANGLES: &str = "a mesh of the model";

/// What a mesh is made from.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(crate) enum MeshKey {
    /// A file; whether duplicate vertices are welded.
    File(PathBuf, bool),
    /// A shape, as text: its dimensions are floats, which have no hash.
    Shape(String),
    /// Triangles of a description; whether duplicate vertices are welded.
    Triangles(SameMesh, bool),
}

/// A mesh that equals only itself: it is compared by its place, at which it stays as long as it is kept here.
#[derive(Debug, Clone)]
pub(crate) struct SameMesh(Arc<Mesh>);

impl PartialEq for SameMesh {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl Eq for SameMesh {}

impl Hash for SameMesh {
    fn hash<H: Hasher>(&self, state: &mut H) {
        Arc::as_ptr(&self.0).hash(state);
    }
}

impl fmt::Display for MeshKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path, _) => write!(f, "{}", path.display()),
            Self::Shape(_) => f.write_str("a shape"),
            Self::Triangles(..) => f.write_str(TRIANGLES),
        }
    }
}

/// A mesh that is wanted.
#[derive(Debug, Clone)]
pub(crate) struct MeshRequest {
    pub(crate) key: MeshKey,
    shape: Option<Primitive>,
}

impl MeshRequest {
    pub(crate) fn file(path: &Path, remove_duplicates: bool) -> Self {
        Self { key: MeshKey::File(path.to_owned(), remove_duplicates), shape: None }
    }

    pub(crate) fn triangles(mesh: &Arc<Mesh>, remove_duplicates: bool) -> Self {
        Self { key: MeshKey::Triangles(SameMesh(Arc::clone(mesh)), remove_duplicates), shape: None }
    }

    /// A shape of unit size, and the factors that make it as large as `primitive`: shapes of different sizes are drawn
    /// together. Those that no factors make of each other are shapes of their own.
    pub(crate) fn shape(primitive: &Primitive) -> (Self, Vector3<f64>) {
        let about = |axis: Axis, radius: f64, height: f64| match axis {
            Axis::X => Vector3::new(height, radius, radius),
            Axis::Y => Vector3::new(radius, height, radius),
            Axis::Z => Vector3::new(radius, radius, height),
        };
        let (shape, scale) = match *primitive {
            Primitive::Box { size } => (Primitive::Box { size: Vector3::repeat(1.0) }, size),
            Primitive::Sphere { radius } => (Primitive::Sphere { radius: 1.0 }, Vector3::repeat(radius)),
            Primitive::Ellipsoid { radii } => (Primitive::Sphere { radius: 1.0 }, radii),
            Primitive::Cylinder { radius, height, axis } => {
                (Primitive::Cylinder { radius: 1.0, height: 1.0, axis }, about(axis, radius, height))
            }
            Primitive::Cone { radius, height, axis } => {
                (Primitive::Cone { radius: 1.0, height: 1.0, axis }, about(axis, radius, height))
            }
            Primitive::Capsule { .. } | Primitive::Plane { .. } => (primitive.clone(), Vector3::repeat(1.0)),
        };
        (Self { key: MeshKey::Shape(format!("{shape:?}")), shape: Some(shape) }, scale)
    }

    /// Whether nobody outside of the mesh sees the back of a triangle, if it is opaque.
    fn is_closed(&self, mesh: &VisualMesh) -> bool {
        match &self.shape {
            // Angles of a whole turn and of none are not the same place to the last bit.
            Some(shape) => !matches!(shape, Primitive::Plane { .. }),
            None => is_closed(mesh),
        }
    }

    fn read(&self) -> Result<(VisualMesh, Vec<String>), String> {
        match (&self.shape, &self.key) {
            (Some(shape), _) => Ok((VisualMesh::primitive(shape), Vec::new())),
            (None, MeshKey::File(path, remove_duplicates)) => {
                load_visual(path, *remove_duplicates).map_err(|error| format!("{error}; it is not drawn"))
            }
            (None, MeshKey::Triangles(SameMesh(mesh), remove_duplicates)) => {
                let mesh = VisualMesh::of(mesh, Path::new(TRIANGLES), *remove_duplicates);
                mesh.map(|mesh| (mesh, Vec::new())).map_err(|error| format!("{error}; it is not drawn"))
            }
            (None, MeshKey::Shape(_)) => Err("a shape is none".to_owned()),
        }
    }
}

/// All that is loaded.
#[derive(Default)]
pub(crate) struct Library {
    /// `None`: cannot be loaded.
    meshes: HashMap<MeshKey, Option<Arc<LoadedMesh>>>,
    /// `None`: cannot be loaded.
    textures: HashMap<MeshTexture, Option<Arc<gl::Texture>>>,
}

/// `work(index)` for all indices below `count`, by a few threads.
fn in_parallel(count: usize, work: impl Fn(usize) + Sync) {
    let threads = std::thread::available_parallelism().map_or(2, usize::from).min(8).min(count);
    let next = AtomicUsize::new(0);
    let run = || loop {
        let index = next.fetch_add(1, Ordering::Relaxed);
        if index >= count {
            break;
        }
        work(index);
    };
    std::thread::scope(|scope| {
        for _ in 1..threads {
            scope.spawn(run);
        }
        run();
    });
}

/// `make(item)` of all items, by a few threads, in their order.
fn map_in_parallel<T: Sync, R: Send>(items: &[T], make: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let results: Vec<Mutex<Option<R>>> = items.iter().map(|_| Mutex::new(None)).collect();
    in_parallel(items.len(), |index| {
        let made = make(&items[index]);
        *results[index].lock() = Some(made);
    });
    results.into_iter().filter_map(Mutex::into_inner).collect()
}

impl Library {
    /// Loads what is not loaded yet; returns messages about what cannot be.
    pub(crate) fn load(&mut self, gl: &Current<'_>, requests: &[MeshRequest]) -> Vec<String> {
        let mut seen = HashSet::new();
        let missing: Vec<&MeshRequest> = requests
            .iter()
            .filter(|request| !self.meshes.contains_key(&request.key) && seen.insert(&request.key))
            .collect();
        let read = map_in_parallel(&missing, |request| {
            request.read().map(|(mesh, warnings)| {
                let is_closed = request.is_closed(&mesh);
                (mesh, warnings, is_closed)
            })
        });
        let meshes: Vec<&VisualMesh> = read.iter().flatten().map(|(mesh, ..)| mesh).collect();
        let mut messages = self.load_textures(gl, &meshes);
        for (request, read) in missing.into_iter().zip(read) {
            let loaded = read.and_then(|(mesh, warnings, is_closed)| {
                messages.extend(warnings);
                self.upload(gl, &mesh, is_closed).map_err(|error| format!("{}: {error}; it is not drawn", request.key))
            });
            let loaded = loaded.map_err(|message| messages.push(message)).ok();
            self.meshes.insert(request.key.clone(), loaded.map(Arc::new));
        }
        messages
    }

    fn load_textures(&mut self, gl: &Current<'_>, meshes: &[&VisualMesh]) -> Vec<String> {
        let mut wanted: Vec<MeshTexture> = Vec::new();
        for MeshMaterial { diffuse_map, normal_map, physical, .. } in
            meshes.iter().flat_map(|mesh| &mesh.parts).map(|part| &part.material)
        {
            let physical_map = physical.as_ref().and_then(|physical| physical.map.as_ref());
            for texture in diffuse_map.iter().chain(normal_map).chain(physical_map) {
                if !self.textures.contains_key(texture) && !wanted.contains(texture) {
                    wanted.push(texture.clone());
                }
            }
        }
        let most = gl.device().most_texels;
        let mut messages = Vec::new();
        let read = map_in_parallel(&wanted, |texture| match texture {
            MeshTexture::File(path) => Texture::load(path),
            MeshTexture::Embedded { name, bytes } => Texture::parse(bytes, name),
        });
        for (key, texture) in wanted.iter().zip(read) {
            let (MeshTexture::File(path) | MeshTexture::Embedded { name: path, .. }) = key;
            let uploaded = texture.map_err(|error| error.to_string()).and_then(|texture| {
                if texture.width.max(texture.height) > most {
                    return Err(format!(
                        "{}: {} x {} pixels are more than the {most} each way that can be drawn; make the picture smaller",
                        path.display(),
                        texture.width,
                        texture.height
                    ));
                }
                let uploaded = gl.texture(texture.width, texture.height, &texture.rgba);
                uploaded.map_err(|error| format!("{}: {error}", path.display()))
            });
            let uploaded = uploaded.map_err(|message| messages.push(format!("{message}; it is drawn without"))).ok();
            self.textures.insert(key.clone(), uploaded.map(Arc::new));
        }
        messages
    }

    fn upload(&self, gl: &Current<'_>, mesh: &VisualMesh, is_closed: bool) -> Result<LoadedMesh, RenderError> {
        let parts = mesh.parts.iter().filter(|part| !part.triangles.is_empty());
        // Through a transparent part backs of the others are seen.
        let is_closed = is_closed && mesh.parts.iter().all(|part| part.material.alpha >= 1.0);
        let part = |part| self.part(gl, part).map(|(part, _)| Arc::new(Part { is_closed, ..part }));
        let parts: Result<Vec<_>, _> = parts.map(part).collect();
        let widen = |corner: [f32; 3]| Vector3::from(corner.map(f64::from));
        Ok(LoadedMesh { parts: parts?, bounds: mesh.bounds().map(|(low, high)| (widen(low), widen(high))) })
    }

    fn part(&self, gl: &Current<'_>, part: &VisualMeshPart) -> Result<(Part, Vec<f32>), RenderError> {
        let has_coordinates = !part.tex_coords.is_empty();
        let texture = |key: &Option<MeshTexture>| self.textures.get(key.as_ref().filter(|_| has_coordinates)?)?.clone();
        let material = &part.material;
        let normal_map = texture(&material.normal_map).filter(|_| !part.tangents.is_empty());
        let diffuse_map = texture(&material.diffuse_map);
        let physical_map = material.physical.as_ref().and_then(|physical| texture(&physical.map));
        let layout = Layout { tangents: normal_map.is_some(), colors: !part.colors.is_empty() };
        let mut vertices = Vec::with_capacity(part.positions.len() * layout.floats());
        for (index, (position, normal)) in part.positions.iter().zip(&part.normals).enumerate() {
            vertices.extend_from_slice(position);
            vertices.extend_from_slice(normal);
            vertices.extend_from_slice(part.tex_coords.get(index).unwrap_or(&[0.0; 2]));
            if layout.tangents {
                let [x, y, z, side] = part.tangents[index];
                let tangent = Vector3::new(x, y, z);
                vertices.extend_from_slice(tangent.as_slice());
                vertices.extend_from_slice((Vector3::from(*normal).cross(&tangent) * side).as_slice());
            }
            if layout.colors {
                vertices.extend_from_slice(&part.colors[index]);
            }
        }
        let array = gl.vertex_array(&vertices, layout, part.triangles.as_flattened())?;
        let (center, radius) = bounding_sphere(&part.positions);
        let (look, flat) = (Look::of_mesh(material), flat_normal(&part.positions, &part.triangles));
        let part = Part { array, look, diffuse_map, normal_map, physical_map, center, radius, flat, is_closed: false };
        Ok((part, vertices))
    }

    /// A mesh that was asked for before; `None` if it cannot be loaded.
    pub(crate) fn get(&self, key: &MeshKey) -> Option<Arc<LoadedMesh>> {
        self.meshes.get(key)?.clone()
    }

    /// Loads a mesh whose vertices follow `nodes` nodes.
    ///
    /// # Errors
    /// Text for the user.
    pub(crate) fn load_soft(
        &mut self,
        gl: &Current<'_>,
        path: &Path,
        remove_duplicates: bool,
        nodes: usize,
        messages: &mut Vec<String>,
    ) -> Result<Vec<(Arc<Part>, SoftPart)>, String> {
        let (mut mesh, warnings) =
            load_visual(path, remove_duplicates).map_err(|error| format!("{error}; it is not drawn"))?;
        messages.extend(warnings);
        if mesh.parts.iter().any(|part| part.nodes.len() != part.positions.len()) {
            return Err(format!("{}: has vertices without nodes", path.display()));
        }
        // In profile `legacy` only the last part of a mesh is simulated: its vertices are the nodes.
        let vertices = mesh.parts.iter().flat_map(|part| &part.nodes).max().map_or(0, |&last| last as usize + 1);
        let first = u32::try_from(vertices.saturating_sub(nodes)).unwrap_or(u32::MAX);
        let still = mesh.parts.iter().filter(|part| part.nodes.iter().any(|&node| node < first)).count();
        if still == mesh.parts.len() && still > 0 {
            return Err(format!("{}: {vertices} vertices are not the {nodes} nodes of the soft body", path.display()));
        }
        if still > 0 {
            messages.push(format!("{}: {still} parts are not simulated and not drawn", path.display()));
        }
        mesh.parts.retain(|part| part.nodes.iter().all(|&node| node >= first));
        for node in mesh.parts.iter_mut().flat_map(|part| &mut part.nodes) {
            *node -= first;
        }
        messages.extend(self.load_textures(gl, &[&mesh]));
        let mut parts = Vec::new();
        for part in mesh.parts.into_iter().filter(|part| !part.triangles.is_empty()) {
            let (uploaded, vertices) =
                self.part(gl, &part).map_err(|error| format!("{}: {error}; it is not drawn", path.display()))?;
            let floats = uploaded.array.layout.floats();
            let uploaded = Part { flat: None, ..uploaded };
            let normals = vec![Vector3::zeros(); nodes];
            let soft = SoftPart { vertices, floats, nodes: part.nodes, triangles: part.triangles, normals };
            parts.push((Arc::new(uploaded), soft));
        }
        Ok(parts)
    }

    /// Forgets what nothing uses, and what could not be loaded, so that it is tried again when the scene changes.
    pub(crate) fn prune(&mut self) {
        self.meshes.retain(|_, mesh| {
            let is_used = |part: &Arc<Part>| Arc::strong_count(part) > 1;
            mesh.as_ref().is_some_and(|mesh| mesh.parts.iter().any(is_used))
        });
        self.textures.retain(|_, texture| texture.as_ref().is_some_and(|texture| Arc::strong_count(texture) > 1));
    }
}

impl SoftPart {
    /// Moves the vertices to their nodes, with smooth normals; returns the bounding sphere.
    pub(crate) fn follow(&mut self, gl: &Current<'_>, part: &Part, nodes: &[[f64; 3]]) -> (Point3<f64>, f64) {
        let place =
            |node: u32| nodes.get(node as usize).map_or(Vector3::zeros(), |p| Vector3::from(p.map(|x| x as f32)));
        self.normals.fill(Vector3::zeros());
        for triangle in &self.triangles {
            let corners = triangle.map(|vertex| self.nodes[vertex as usize]);
            let [a, b, c] = corners.map(place);
            // Twice the area times the unit normal: larger triangles count more.
            let normal = (b - a).cross(&(c - a));
            for node in corners {
                if let Some(sum) = self.normals.get_mut(node as usize) {
                    *sum += normal;
                }
            }
        }
        for (vertex, &node) in self.vertices.chunks_exact_mut(self.floats).zip(&self.nodes) {
            let normal = self.normals[node as usize].try_normalize(0.0).unwrap_or_else(Vector3::z);
            vertex[..3].copy_from_slice(place(node).as_slice());
            vertex[3..6].copy_from_slice(normal.as_slice());
        }
        gl.update_vertices(&part.array, &self.vertices);
        let positions: Vec<[f32; 3]> =
            self.vertices.chunks_exact(self.floats).map(|vertex| [vertex[0], vertex[1], vertex[2]]).collect();
        bounding_sphere(&positions)
    }
}

impl Look {
    fn of_mesh(material: &MeshMaterial) -> Self {
        let [r, g, b] = material.diffuse;
        Self {
            diffuse: [r, g, b, material.alpha],
            ambient: material.ambient,
            specular: material.specular,
            emission: material.emission,
            shininess: material.shininess.clamp(0.0, 128.0),
            physical: material.physical.as_ref().map(|physical| [physical.metallic, physical.roughness]),
        }
    }
}

/// Around the middle of the bounding box.
fn bounding_sphere(positions: &[[f32; 3]]) -> (Point3<f64>, f64) {
    let points = || positions.iter().map(|p| Point3::from(p.map(f64::from)));
    let (mut low, mut high) = (Point3::from([f64::INFINITY; 3]), Point3::from([f64::NEG_INFINITY; 3]));
    for point in points() {
        low = low.inf(&point);
        high = high.sup(&point);
    }
    if positions.is_empty() {
        return (Point3::origin(), 0.0);
    }
    let center = nalgebra::center(&low, &high);
    let square = points().map(|point| (point - center).norm_squared()).fold(0.0, f64::max);
    (center, square.sqrt())
}

/// Triangles of a surface of revolution about x: rings at (x, radius) with normals (along x, outward). A ring of radius
/// 0 is a point.
pub(crate) fn lathe(rings: &[[f32; 4]], segments: u32) -> (Vec<f32>, Vec<u32>) {
    let (mut vertices, mut indices) = (Vec::new(), Vec::new());
    for [x, radius, along, outward] in rings {
        for segment in 0..=segments {
            let (sine, cosine) = (std::f32::consts::TAU * segment as f32 / segments as f32).sin_cos();
            vertices.extend([*x, radius * cosine, radius * sine, *along, outward * cosine, outward * sine, 0.0, 0.0]);
        }
    }
    for ring in 0..(rings.len() as u32).saturating_sub(1) {
        for segment in 0..segments {
            let a = ring * (segments + 1) + segment;
            let b = a + segments + 1;
            indices.extend([a, a + 1, b, b, a + 1, b + 1]);
        }
    }
    (vertices, indices)
}

impl Part {
    /// A part that no file describes.
    pub(crate) fn of_vertices(gl: &Current<'_>, vertices: &[f32], indices: &[u32]) -> Result<Self, RenderError> {
        let positions: Vec<[f32; 3]> =
            vertices.chunks_exact(gl::VERTEX_FLOATS).map(|vertex| [vertex[0], vertex[1], vertex[2]]).collect();
        let (center, radius) = bounding_sphere(&positions);
        let array = gl.vertex_array(vertices, Layout::default(), indices)?;
        let look = Look::of_color([1.0; 4]);
        let (diffuse_map, normal_map, physical_map) = (None, None, None);
        Ok(Self { array, look, diffuse_map, normal_map, physical_map, center, radius, flat: None, is_closed: false })
    }
}

/// Whether nobody outside of an opaque mesh sees the back of a triangle: each edge is used once in each direction, and
/// each connected piece has a positive volume. Vertices at one place are one. A surface that passes through itself can
/// be inside out in places all the same.
fn is_closed(mesh: &VisualMesh) -> bool {
    let mut places = HashMap::new();
    let mut triangles: Vec<[u32; 3]> = Vec::new();
    for part in &mesh.parts {
        let place = |position: &[f32; 3]| {
            let next = places.len() as u32;
            // Both zeros are one place.
            *places.entry(position.map(|x| (x + 0.0).to_bits())).or_insert(next)
        };
        let place_of: Vec<u32> = part.positions.iter().map(place).collect();
        let joined = part.triangles.iter().map(|triangle| triangle.map(|vertex| place_of[vertex as usize]));
        triangles.extend(joined.filter(|[a, b, c]| a != b && b != c && c != a));
    }
    // The lower place, the higher one and the direction, so that both uses of an edge are neighbours.
    let edge = |(a, b): (u32, u32)| u64::from(a.min(b)) << 33 | u64::from(a.max(b)) << 1 | u64::from(a > b);
    let edges = triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)].map(edge));
    let mut edges: Vec<u64> = edges.collect();
    edges.sort_unstable();
    let (pairs, rest) = edges.as_chunks::<2>();
    if !rest.is_empty() || pairs.iter().any(|[there, back]| there & 1 == 1 || *back != there + 1) {
        return false;
    }
    // Pieces: each place leads to another one of its piece, or is its root.
    let mut leads: Vec<u32> = (0..places.len() as u32).collect();
    let root = |leads: &mut [u32], mut place: u32| {
        while leads[place as usize] != place {
            leads[place as usize] = leads[leads[place as usize] as usize];
            place = leads[place as usize];
        }
        place
    };
    for &[a, b, c] in &triangles {
        for other in [b, c] {
            let (from, to) = (root(&mut leads, other), root(&mut leads, a));
            leads[from as usize] = to;
        }
    }
    let mut positions = vec![Vector3::zeros(); places.len()];
    for (bits, place) in places {
        positions[place as usize] = Vector3::from(bits.map(|bits| f64::from(f32::from_bits(bits))));
    }
    // (places x 1) six times the volume of the piece, at its root, seen from there.
    let mut volumes = vec![0.0; positions.len()];
    for triangle in &triangles {
        let root = root(&mut leads, triangle[0]) as usize;
        let [a, b, c] = triangle.map(|place| positions[place as usize] - positions[root]);
        volumes[root] += a.cross(&b).dot(&c);
    }
    !triangles.is_empty() && triangles.iter().all(|&[a, ..]| volumes[root(&mut leads, a) as usize] > 0.0)
}

/// The normal of all triangles, if they lie in one plane and face the same way.
fn flat_normal(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Option<Vector3<f64>> {
    let corner = |index: u32| Vector3::from(positions[index as usize].map(f64::from));
    let mut plane: Option<(Vector3<f64>, Vector3<f64>)> = None;
    for triangle in triangles {
        let [a, b, c] = triangle.map(corner);
        let across = (b - a).cross(&(c - a));
        let Some(normal) = across.try_normalize(0.0) else { continue };
        let (first, point) = *plane.get_or_insert((normal, a));
        let size = (b - a).norm() + (c - a).norm() + (a - point).norm();
        let is_in_plane = [a, b, c].iter().all(|p| (p - point).dot(&first).abs() <= 1e-6 * size);
        if normal.dot(&first) < 1.0 - 1e-6 || !is_in_plane {
            return None;
        }
    }
    plane.map(|(normal, _)| normal)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closed_shapes_face_outwards() {
        let axes = [Axis::X, Axis::Y, Axis::Z];
        let round = axes.into_iter().flat_map(|axis| {
            [
                Primitive::Cylinder { radius: 0.3, height: 2.0, axis },
                Primitive::Cone { radius: 0.3, height: 2.0, axis },
                Primitive::Capsule { radius: 0.3, height: 2.0, axis },
            ]
        });
        let shapes = [Primitive::Box { size: Vector3::new(1.0, 2.0, 3.0) }, Primitive::Sphere { radius: 0.5 }];
        for shape in shapes.into_iter().chain(round) {
            let mesh = VisualMesh::primitive(&shape);
            assert!(MeshRequest::shape(&shape).0.is_closed(&mesh));
            for part in mesh.parts {
                for triangle in part.triangles {
                    let [a, b, c] = triangle.map(|vertex| Vector3::from(part.positions[vertex as usize]));
                    // The origin is within these convex shapes. Triangles at poles have no area.
                    assert!((b - a).cross(&(c - a)).dot(&(a + b + c)) > -1e-6, "{shape:?}");
                }
            }
        }
        let plane = Primitive::Plane { normal: Vector3::z(), offset: 0.0 };
        assert!(!MeshRequest::shape(&plane).0.is_closed(&VisualMesh::primitive(&plane)));
    }

    /// A box whose faces have vertices of their own, as files have them.
    fn cube() -> VisualMesh {
        VisualMesh::primitive(&Primitive::Box { size: Vector3::repeat(1.0) })
    }

    #[test]
    fn a_mesh_is_closed_if_its_triangles_enclose_bodies_and_face_outwards() {
        assert!(is_closed(&cube()));
        assert!(!is_closed(&VisualMesh { parts: Vec::new() }), "nothing");
        let mut open = cube();
        open.parts[0].triangles.pop();
        assert!(!is_closed(&open), "a triangle is missing");
        let mut turned = cube();
        turned.parts[0].triangles[3].swap(0, 1);
        assert!(!is_closed(&turned), "a triangle faces inwards");
        let mut inside_out = cube();
        inside_out.parts[0].triangles.iter_mut().for_each(|triangle| triangle.swap(0, 1));
        assert!(!is_closed(&inside_out), "all triangles face inwards");
        let mut two_sided = cube();
        two_sided.parts.extend(inside_out.parts.clone());
        assert!(!is_closed(&two_sided), "each triangle stands there once for each side");
        // Another material.
        let mut joined = cube();
        let mut half = joined.parts[0].clone();
        half.triangles = joined.parts[0].triangles.split_off(5);
        joined.parts.push(half);
        assert!(is_closed(&joined), "two parts enclose one body");
        // A second piece beside the first.
        let beside = |mut mesh: VisualMesh| {
            mesh.parts[0].positions.iter_mut().for_each(|position| position[0] += 3.0);
            let mut both = cube();
            both.parts.extend(mesh.parts);
            both
        };
        assert!(is_closed(&beside(cube())));
        assert!(!is_closed(&beside(inside_out)), "one of two pieces is inside out");
        let mut degenerate = cube();
        degenerate.parts[0].triangles.push([0, 0, 1]);
        assert!(is_closed(&degenerate), "a triangle without area changes nothing");
    }

    #[test]
    fn meshes_of_the_shipped_arm_are_closed() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources/meshes/arm7");
        for name in ["base", "shoulder", "upper_arm", "elbow", "forearm", "wrist", "hand", "flange"] {
            let (mesh, _) = load_visual(&folder.join(format!("{name}.obj")), false).unwrap();
            assert!(is_closed(&mesh), "{name}");
        }
    }
}
