//! glTF 2.0, as JSON (`gltf`) and in a binary container (`glb`): triangles of the meshes that the scene places, turned
//! so that +z is up.
//!
//! Colours of materials and vertices are linear in glTF; they become displayed values, which all other formats hold.
//!
//! A library knows the names and types of the JSON. Indices, lengths and offsets are checked here, where they are used.

use std::borrow::Cow;
use std::cell::{Cell, OnceCell};
use std::collections::{HashMap, HashSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

use base64::engine::general_purpose::{GeneralPurpose, GeneralPurposeConfig};
use base64::engine::DecodePaddingMode;
use base64::Engine;
use gltf_json::accessor::{Accessor, ComponentType, Type};
use gltf_json::material::{AlphaMode, Material};
use gltf_json::mesh::{Mode, Primitive, Semantic};
use gltf_json::validation::Checked;
use gltf_json::{Image, Index, Root};
use nalgebra::{Matrix4, Point3, Quaternion, UnitQuaternion, Vector3};

use super::material::{find_texture, MeshMaterial, MeshTexture, MetallicRoughness};
use super::placement::{short_name, Placement, MAX_NODES, MAX_TRIANGLES};
use super::visual::{Corner, Details, Facing, PartDetails};
use super::{decoded, printable, quoted, Files, Mesh, MeshError, Position, SubMesh, Welder};
use super::{MAX_FILE_BYTES, MAX_SUB_MESHES};

/// First bytes of a binary container.
const MAGIC: &[u8] = b"glTF";

/// Bytes of the header of a binary container, and of the header of each chunk in it.
const HEADER_BYTES: usize = 12;
const CHUNK_HEADER_BYTES: usize = 8;

/// Most objects and lists of the JSON, and most values: one takes a few bytes of the file and hundreds of bytes of memory. Lists count as
/// objects do, because the library takes a list for an object, the fields in order: `[]` is a material.
const MAX_OBJECTS: usize = 2_000_000;
const MAX_VALUES: usize = 8_000_000;

/// Objects and lists that any file may have, and least bytes for each further one: a short node, `{"mesh":0,"children":[1]}`, has two in
/// 25 bytes.
const FEW_OBJECTS: usize = 10_000;
const BYTES_OF_OBJECT: usize = 8;

/// Longest name of the file of a buffer, in bytes.
const MAX_FILE_NAME: usize = 1024;

pub(super) fn read(
    path: &Path,
    bytes: Vec<u8>,
    files: &Files,
    mut details: Option<&mut Details>,
) -> Result<Mesh, MeshError> {
    let (json, binary) = match bytes.starts_with(MAGIC) {
        true => split_container(path, &bytes)?,
        false => (0..bytes.len(), None),
    };
    let root = read_json(path, &bytes, json)?;
    check_version(path, &root)?;
    check_extensions(path, &root, details.as_deref_mut())?;
    let buffers = root.buffers.iter().map(|_| OnceCell::new()).collect();
    let file = File { path, root: &root, binary, files, buffers, loaded: Cell::new(0) };
    let mut materials = Materials::default();
    // A mesh may be placed many times; its messages are given once.
    let mut reported = HashSet::new();
    let mut mesh = Mesh::default();
    let mut triangle_count = 0usize;
    for Placed { mesh: index, node, transform } in file.placed_meshes()? {
        let Some(placed) = root.meshes.get(index) else { continue };
        let placement = Placement::new(transform);
        for (number, primitive) in placed.primitives.iter().enumerate() {
            let what = format!("mesh {index}, primitive {number}");
            let Some(surface) = file.surface(primitive, &what)? else { continue };
            triangle_count = triangle_count.saturating_add(surface.triangle_count());
            if triangle_count > MAX_TRIANGLES {
                return Err(file.malformed(format!("more than {MAX_TRIANGLES} triangles after instancing")));
            }
            if mesh.sub_meshes.len() == MAX_SUB_MESHES {
                return Err(file.malformed(format!("more than {MAX_SUB_MESHES} parts after instancing")));
            }
            let material = primitive.material.and_then(|material| root.materials.get(material.value()));
            let names = [
                material.and_then(|material| material.name.as_deref()),
                placed.name.as_deref(),
                node.and_then(|node| root.nodes.get(node)).and_then(|node| node.name.as_deref()),
            ];
            let name = names.into_iter().flatten().find(|name| !name.is_empty()).unwrap_or_default();
            mesh.sub_meshes.push(surface.place(path, &what, &short_name(name), &placement)?);
            if let Some(details) = &mut details {
                let is_first = reported.insert((index, number));
                let mut looks = Looks { file: &file, surface: &surface, what: &what, is_first, details };
                let part = looks.read(primitive, &placement, &mut materials);
                details.parts.push(part);
            }
        }
    }
    Ok(mesh)
}

/// Where the JSON of a binary container is, and the bytes of its binary chunk.
fn split_container<'a>(path: &Path, bytes: &'a [u8]) -> Result<(Range<usize>, Option<&'a [u8]>), MeshError> {
    let error = |at: usize, message: String| MeshError::malformed(path, Position::Byte(at), message);
    let malformed = |at: usize, message: String| Err(error(at, message));
    let number = |at: usize| match bytes.get(at..).and_then(|rest| rest.first_chunk::<4>()) {
        Some(number) => Ok(u32::from_le_bytes(*number)),
        None => Err(error(at, "truncated: the file ends within a header".to_owned())),
    };
    let version = number(4)?;
    if version != 2 {
        return malformed(4, format!("the container has version {version}; only glTF 2.0 can be read"));
    }
    let length = number(8)? as usize;
    if length > bytes.len() {
        return malformed(8, format!("truncated: the header announces {length} bytes, the file has {}", bytes.len()));
    }
    let mut json = None;
    let mut at = HEADER_BYTES;
    while at < length {
        let start = at.saturating_add(CHUNK_HEADER_BYTES);
        let (size, kind) = (number(at)? as usize, number(at.saturating_add(4))?);
        let end = start.saturating_add(size);
        if end > length {
            let left = length.saturating_sub(start);
            return malformed(at, format!("truncated: a chunk of {size} bytes, {left} are left"));
        }
        match (&json, &kind.to_le_bytes()) {
            (None, b"JSON") => json = Some(start..end),
            (None, _) => break,
            (Some(json), b"BIN\0") => return Ok((json.clone(), bytes.get(start..end))),
            _ => {}
        }
        at = end;
    }
    match json {
        Some(json) => Ok((json, None)),
        None => malformed(HEADER_BYTES, "the container must begin with a chunk of type 'JSON'".to_owned()),
    }
}

fn read_json(path: &Path, bytes: &[u8], json: Range<usize>) -> Result<Root, MeshError> {
    let is_container = json.start > 0;
    let start = json.start;
    let text = bytes.get(json).unwrap_or_default();
    let count = |wanted: u8| text.iter().filter(|byte| **byte == wanted).count();
    let most = MAX_OBJECTS.min(FEW_OBJECTS + text.len() / BYTES_OF_OBJECT);
    if count(b'{').saturating_add(count(b'[')) > most || count(b',') > MAX_VALUES {
        let message = format!("more than {most} JSON objects and lists, or {MAX_VALUES} values");
        return Err(MeshError::malformed(path, Position::Whole, message));
    }
    // Not `deserialize::from_slice`, which would be compiled once more here, for half a minute.
    Root::from_slice(text).map_err(|error| {
        let at = if is_container {
            let lines = text.split_inclusive(|byte| *byte == b'\n').take(error.line().saturating_sub(1));
            Position::Byte(start + lines.map(<[u8]>::len).sum::<usize>() + error.column().saturating_sub(1))
        } else {
            Position::Line(error.line() as u32)
        };
        // The sentence quotes texts of the file as they are, and ends with the place.
        let sentence = error.to_string();
        let what = printable(sentence.rsplit_once(" at line ").map_or(&sentence, |(what, _)| what), 120);
        MeshError::malformed(path, at, format!("not readable as glTF 2.0: {what}"))
    })
}

fn check_version(path: &Path, root: &Root) -> Result<(), MeshError> {
    // Later versions 2.x can be read, unless the file says that they cannot.
    let least = root.asset.min_version.as_deref();
    if !root.asset.version.starts_with("2.") || least.is_some_and(|least| least != "2.0") {
        let version = quoted(least.unwrap_or(&root.asset.version));
        let message = format!("glTF of version {version}; only 2.0 can be read");
        return Err(MeshError::malformed(path, Position::Whole, message));
    }
    Ok(())
}

/// Extensions that change how geometry is stored and are read.
const KNOWN: [&str; 2] = ["KHR_mesh_quantization", "KHR_texture_transform"];

/// How the names of extensions begin that change only looks, or what is not read at all.
const LOOKS: [&str; 7] = [
    "KHR_materials_",
    "ADOBE_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "MSFT_texture_",
    "KHR_lights_",
    "KHR_animation_",
];

fn check_extensions(path: &Path, root: &Root, mut details: Option<&mut Details>) -> Result<(), MeshError> {
    for name in &root.extensions_required {
        if KNOWN.contains(&name.as_str()) {
            continue;
        }
        if LOOKS.iter().any(|start| name.starts_with(start)) {
            if let Some(details) = &mut details {
                let message = format!("the extension {} is not used; the looks differ", quoted(name));
                details.warnings.add_general(path, message);
            }
            continue;
        }
        let remedy = match name.contains("compression") {
            true => "export it without compression",
            false => "export it without this extension",
        };
        let message = format!("the file requires the extension {}, which cannot be read; {remedy}", quoted(name));
        return Err(MeshError::malformed(path, Position::Whole, message));
    }
    Ok(())
}

/// A glTF file, and what it refers to.
struct File<'a> {
    path: &'a Path,
    root: &'a Root,
    /// The binary chunk of a container.
    binary: Option<&'a [u8]>,
    files: &'a Files<'a>,
    /// Buffers that were read before; `None` for one that cannot be read, so that it is tried once.
    buffers: Vec<OnceCell<Option<Cow<'a, [u8]>>>>,
    /// Bytes of all buffers that were read.
    loaded: Cell<u64>,
}

/// A mesh in the scene.
struct Placed {
    /// Index in [`Root::meshes`]; it exists.
    mesh: usize,
    /// Index in [`Root::nodes`]; `None` in a file without nodes.
    node: Option<usize>,
    /// Into the mesh frame: +z is up.
    transform: Matrix4<f64>,
}

impl<'a> File<'a> {
    fn malformed(&self, message: impl Into<String>) -> MeshError {
        MeshError::malformed(self.path, Position::Whole, message)
    }

    /// Error when an index is beyond the end of its array.
    fn absent(&self, what: &str, index: usize, count: usize) -> MeshError {
        self.malformed(format!("{what} {index} does not exist: the file has {count}"))
    }

    /// Every mesh that the scene places, in file order. A file without nodes places each mesh once.
    fn placed_meshes(&self) -> Result<Vec<Placed>, MeshError> {
        let Root { scene, scenes, nodes, meshes, .. } = self.root;
        // In glTF +y is up: (x, y, z) becomes (x, −z, y).
        #[rustfmt::skip]
        let upright = Matrix4::new(
            1.0, 0.0, 0.0, 0.0,
            0.0, 0.0, -1.0, 0.0,
            0.0, 1.0, 0.0, 0.0,
            0.0, 0.0, 0.0, 1.0,
        );
        if nodes.is_empty() {
            return Ok((0..meshes.len()).map(|mesh| Placed { mesh, node: None, transform: upright }).collect());
        }
        let number = scene.map_or(0, |scene| scene.value());
        let roots: Vec<usize> = match scenes.get(number) {
            Some(scene) => scene.nodes.iter().map(|node| node.value()).collect(),
            None if scene.is_some() => return Err(self.absent("scene", number, scenes.len())),
            None => {
                let children: HashSet<usize> =
                    nodes.iter().flat_map(|node| node.children.iter().flatten()).map(|child| child.value()).collect();
                (0..nodes.len()).filter(|node| !children.contains(node)).collect()
            }
        };
        let mut placed = Vec::new();
        let mut visited = 0usize;
        // Reversed, so that the stack yields them in file order.
        let mut stack: Vec<(usize, Matrix4<f64>)> = roots.into_iter().rev().map(|node| (node, upright)).collect();
        while let Some((index, parent)) = stack.pop() {
            let node = nodes.get(index).ok_or_else(|| self.absent("node", index, nodes.len()))?;
            let transform = parent * self.transform(index)?;
            visited = visited.saturating_add(1);
            if let Some(mesh) = node.mesh.map(|mesh| mesh.value()) {
                let content = meshes.get(mesh).ok_or_else(|| self.absent("mesh", mesh, meshes.len()))?;
                visited = visited.saturating_add(content.primitives.len());
                placed.push(Placed { mesh, node: Some(index), transform });
            }
            let children = node.children.as_deref().unwrap_or_default();
            if visited.saturating_add(stack.len()).saturating_add(children.len()) > MAX_NODES {
                return Err(self.malformed("the scene is endless: a node seems to contain itself"));
            }
            stack.extend(children.iter().rev().map(|child| (child.value(), transform)));
        }
        Ok(placed)
    }

    /// The transform of a node into its parent.
    fn transform(&self, index: usize) -> Result<Matrix4<f64>, MeshError> {
        let Some(node) = self.root.nodes.get(index) else { return Ok(Matrix4::identity()) };
        if let Some(matrix) = node.matrix {
            return Ok(Matrix4::from_column_slice(&matrix.map(f64::from)));
        }
        let translation = Vector3::from(node.translation.unwrap_or_default()).cast::<f64>();
        let scale = Vector3::from(node.scale.unwrap_or([1.0; 3])).cast::<f64>();
        let [x, y, z, w] = node.rotation.unwrap_or_default().0.map(f64::from);
        let Some(rotation) = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 0.0) else {
            return Err(self.malformed(format!("node {index}: the rotation has length 0")));
        };
        Ok(Matrix4::new_translation(&translation) * rotation.to_homogeneous() * Matrix4::new_nonuniform_scaling(&scale))
    }

    /// The content of a buffer.
    fn buffer(&self, index: usize) -> Result<&[u8], MeshError> {
        let slot = self.buffers.get(index).ok_or_else(|| self.absent("buffer", index, self.buffers.len()))?;
        let mut outcome = Ok(());
        let content = slot.get_or_init(|| match self.read_buffer(index) {
            Ok(content) => Some(content),
            Err(error) => {
                outcome = Err(error);
                None
            }
        });
        outcome?;
        content.as_deref().ok_or_else(|| self.malformed(format!("buffer {index} cannot be read")))
    }

    fn read_buffer(&self, index: usize) -> Result<Cow<'a, [u8]>, MeshError> {
        let buffer = self.root.buffers.get(index).ok_or_else(|| self.absent("buffer", index, self.buffers.len()))?;
        let content = match (&buffer.uri, self.binary) {
            (Some(uri), _) => {
                let content = match data_of(uri) {
                    Some(data) => data.map_err(|message| self.malformed(format!("buffer {index}: {message}")))?,
                    None => self.named_file(index, uri)?,
                };
                self.loaded.set(self.loaded.get().saturating_add(content.len() as u64));
                if self.loaded.get() > MAX_FILE_BYTES {
                    return Err(self.malformed(format!("its buffers have more than {MAX_FILE_BYTES} bytes")));
                }
                Cow::Owned(content)
            }
            (None, Some(binary)) if index == 0 => Cow::Borrowed(binary),
            (None, _) => {
                let message = format!("buffer {index} has no uri, and there is no binary chunk for it");
                return Err(self.malformed(message));
            }
        };
        let announced = buffer.byte_length.0;
        if announced > content.len() as u64 {
            let found = content.len();
            return Err(self.malformed(format!("truncated: buffer {index} has {found} bytes, announced {announced}")));
        }
        Ok(content)
    }

    /// Reads the file of a buffer, which is named relative to the folder of this one.
    fn named_file(&self, index: usize, uri: &str) -> Result<Vec<u8>, MeshError> {
        let name = decoded(uri);
        if name.is_empty() || name.len() > MAX_FILE_NAME || name.contains('\0') {
            return Err(self.malformed(format!("buffer {index}: {} is no name of a file", quoted(&name))));
        }
        let place = self.path.parent().map_or_else(PathBuf::new, Path::to_path_buf).join(&name);
        (self.files.open)(&place).map_err(|error| {
            let why = match error {
                MeshError::Io { source, .. } => source.to_string(),
                MeshError::TooLarge { bytes, .. } => format!("{bytes} bytes are too many"),
                other => message_of(other),
            };
            let name = printable(&name, 100);
            self.malformed(format!("buffer {index}: '{name}' cannot be read: {}", printable(&why, 100)))
        })
    }

    /// The content of a buffer view.
    fn view(&self, index: usize) -> Result<&[u8], MeshError> {
        let views = &self.root.buffer_views;
        let view = views.get(index).ok_or_else(|| self.absent("buffer view", index, views.len()))?;
        let buffer = self.buffer(view.buffer.value())?;
        let range = || {
            let start = usize::try_from(view.byte_offset.unwrap_or_default().0).ok()?;
            let end = start.checked_add(usize::try_from(view.byte_length.0).ok()?)?;
            buffer.get(start..end)
        };
        range().ok_or_else(|| {
            let (number, found) = (view.buffer.value(), buffer.len());
            let (offset, length) = (view.byte_offset.unwrap_or_default().0, view.byte_length.0);
            self.malformed(format!(
                "buffer view {index} has {length} bytes from byte {offset} of buffer {number}, which has {found}"
            ))
        })
    }

    /// The numbers of an accessor, which must be of one of the given types.
    fn numbers(&self, index: Index<Accessor>, types: &[Type], what: &str) -> Result<Numbers<'_>, MeshError> {
        let (index, accessors) = (index.value(), &self.root.accessors);
        let malformed = |message: String| Err(self.malformed(format!("{what}: accessor {index} {message}")));
        let Some(accessor) = accessors.get(index) else {
            return malformed(format!("does not exist: the file has {}", accessors.len()));
        };
        if accessor.sparse.is_some() {
            return malformed("is sparse, which cannot be read; export it without sparse accessors".to_owned());
        }
        let (Checked::Valid(component), Checked::Valid(kind)) = (&accessor.component_type, &accessor.type_) else {
            return malformed("has an unknown type".to_owned());
        };
        if !types.contains(kind) {
            return malformed(format!("has the type {}, expected {}", type_name(kind), listed(types)));
        }
        let Some(view_index) = accessor.buffer_view.map(|view| view.value()) else {
            return malformed("has no buffer view".to_owned());
        };
        let view = self.view(view_index)?;
        let size = component.0.size().saturating_mul(kind.multiplicity());
        let stride = self.root.buffer_views.get(view_index).and_then(|view| view.byte_stride);
        let stride = stride.map_or(size, |stride| stride.0);
        if stride < size {
            return malformed(format!("has elements of {size} bytes, buffer view {view_index} has one each {stride}"));
        }
        let content = || {
            let start = usize::try_from(accessor.byte_offset.unwrap_or_default().0).ok()?;
            let count = usize::try_from(accessor.count.0).ok()?;
            let length = match count.checked_sub(1) {
                Some(others) => others.checked_mul(stride)?.checked_add(size)?,
                None => 0,
            };
            Some((view.get(start..start.checked_add(length)?)?, count))
        };
        let Some((bytes, count)) = content() else {
            let (count, offset) = (accessor.count.0, accessor.byte_offset.unwrap_or_default().0);
            return malformed(format!(
                "has {count} elements each {stride} bytes from byte {offset} of buffer view {view_index}, which has {} bytes",
                view.len()
            ));
        };
        let (size, component, normalized) = (kind.multiplicity(), component.0, accessor.normalized);
        Ok(Numbers { bytes, stride, count, size, component, normalized })
    }

    /// The triangles of a primitive; `None` if it has none by its kind.
    fn surface(&self, primitive: &Primitive, what: &str) -> Result<Option<Surface<'_>>, MeshError> {
        let mode = match primitive.mode {
            Checked::Valid(mode @ (Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan)) => mode,
            Checked::Valid(_) => return Ok(None),
            Checked::Invalid => return Err(self.malformed(format!("{what}: the mode is none of glTF"))),
        };
        // As the standard says of primitives without positions.
        let Some(positions) = attribute(primitive, Semantic::Positions) else { return Ok(None) };
        let positions = self.numbers(positions, &[Type::Vec3], what)?;
        let indices = match primitive.indices {
            Some(indices) => Some(self.numbers(indices, &[Type::Scalar], what)?),
            None => None,
        };
        if let Some(indices) = &indices {
            use ComponentType::{U16, U32, U8};
            if !matches!(indices.component, U8 | U16 | U32) {
                let found = indices.component.as_gl_enum();
                let expected = "5121, 5123 or 5125 (unsigned numbers of 8, 16 or 32 bits)";
                return Err(self.malformed(format!("{what}: indices of component type {found}, expected {expected}")));
            }
        }
        let corners = indices.as_ref().unwrap_or(&positions).count;
        if mode == Mode::Triangles && !corners.is_multiple_of(3) {
            return Err(self.malformed(format!("{what}: {corners} corners are no multiple of 3")));
        }
        Ok(Some(Surface { mode, positions, indices, corners }))
    }
}

fn attribute(primitive: &Primitive, semantic: Semantic) -> Option<Index<Accessor>> {
    primitive.attributes.get(&Checked::Valid(semantic)).copied()
}

fn listed(types: &[Type]) -> String {
    types.iter().map(type_name).collect::<Vec<_>>().join(" or ")
}

/// As it is written in files.
fn type_name(kind: &Type) -> &'static str {
    match kind {
        Type::Scalar => "SCALAR",
        Type::Vec2 => "VEC2",
        Type::Vec3 => "VEC3",
        Type::Vec4 => "VEC4",
        Type::Mat2 => "MAT2",
        Type::Mat3 => "MAT3",
        Type::Mat4 => "MAT4",
    }
}

/// The sentence of an error, without the file's name where it has a place in it.
fn message_of(error: MeshError) -> String {
    match error {
        MeshError::Malformed { message, .. } => message,
        other => printable(&other.to_string(), 200),
    }
}

/// What a `data:` URI holds; `None` for any other.
fn data_of(uri: &str) -> Option<Result<Vec<u8>, String>> {
    // Some exporters leave out the padding.
    const BASE64: GeneralPurpose = GeneralPurpose::new(
        &base64::alphabet::STANDARD,
        GeneralPurposeConfig::new()
            .with_decode_padding_mode(DecodePaddingMode::Indifferent)
            .with_decode_allow_trailing_bits(true),
    );
    let content = uri.strip_prefix("data:")?;
    let Some((_, data)) = content.split_once(',').filter(|(kind, _)| kind.ends_with(";base64")) else {
        return Some(Err(format!("a data URI must be encoded in base64, got {}", quoted(uri))));
    };
    Some(BASE64.decode(data).map_err(|error| format!("not readable as base64: {}", printable(&error.to_string(), 100))))
}

/// Numbers of an accessor within its buffer.
struct Numbers<'b> {
    /// From the first element to the end of the last.
    bytes: &'b [u8],
    /// Bytes from one element to the next, at least those of an element.
    stride: usize,
    /// Elements.
    count: usize,
    /// Numbers of each element.
    size: usize,
    component: ComponentType,
    /// Integers stand for fractions of the largest.
    normalized: bool,
}

impl Numbers<'_> {
    /// The first `N` numbers of an element; `None` if it does not exist or has fewer.
    fn get<const N: usize>(&self, index: usize) -> Option<[f64; N]> {
        if index >= self.count || N > self.size {
            return None;
        }
        let mut bytes = self.bytes.get(index.checked_mul(self.stride)?..)?;
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            let (component, rest) = bytes.split_at_checked(self.component.size())?;
            *number = self.number(component)?;
            bytes = rest;
        }
        Some(numbers)
    }

    fn number(&self, bytes: &[u8]) -> Option<f64> {
        let (number, most) = match (self.component, bytes) {
            (ComponentType::I8, &[a]) => (f64::from(a as i8), f64::from(i8::MAX)),
            (ComponentType::U8, &[a]) => (f64::from(a), f64::from(u8::MAX)),
            (ComponentType::I16, &[a, b]) => (f64::from(i16::from_le_bytes([a, b])), f64::from(i16::MAX)),
            (ComponentType::U16, &[a, b]) => (f64::from(u16::from_le_bytes([a, b])), f64::from(u16::MAX)),
            (ComponentType::U32, &[a, b, c, d]) => (f64::from(u32::from_le_bytes([a, b, c, d])), f64::from(u32::MAX)),
            (ComponentType::F32, &[a, b, c, d]) => return Some(f64::from(f32::from_le_bytes([a, b, c, d]))),
            _ => return None,
        };
        Some(if self.normalized { (number / most).max(-1.0) } else { number })
    }
}

/// Triangles of a primitive.
struct Surface<'b> {
    mode: Mode,
    positions: Numbers<'b>,
    /// Vertices of the corners; in order where there are none.
    indices: Option<Numbers<'b>>,
    corners: usize,
}

impl Surface<'_> {
    fn triangle_count(&self) -> usize {
        match self.mode {
            Mode::Triangles => self.corners / 3,
            _ => self.corners.saturating_sub(2),
        }
    }

    /// The vertices of all triangles, counter-clockwise seen from outside where the placement mirrors nothing; `None`
    /// for a corner without.
    fn triangles(&self) -> impl Iterator<Item = [Option<usize>; 3]> + '_ {
        (0..self.triangle_count()).map(|i| {
            // No overflow: there are more corners than triangles, and each is in the file.
            let corners = match self.mode {
                Mode::Triangles => [3 * i, 3 * i + 1, 3 * i + 2],
                Mode::TriangleFan => [0, i + 1, i + 2],
                _ if i % 2 == 1 => [i, i + 2, i + 1],
                _ => [i, i + 1, i + 2],
            };
            corners.map(|corner| self.vertex(corner))
        })
    }

    fn vertex(&self, corner: usize) -> Option<usize> {
        match &self.indices {
            // Integers, as was checked.
            Some(indices) => indices.get::<1>(corner).map(|[index]| index as usize),
            None => Some(corner),
        }
    }

    fn place(&self, path: &Path, what: &str, name: &str, placement: &Placement) -> Result<SubMesh, MeshError> {
        let mut surface = Welder::named(name);
        for triangle in self.triangles() {
            let mut corners = [[0.0; 3]; 3];
            for (corner, vertex) in corners.iter_mut().zip(triangle) {
                let position = vertex.and_then(|vertex| Some((vertex, self.positions.get::<3>(vertex)?)));
                let Some((vertex, position)) = position else {
                    let (vertex, known) = (vertex.unwrap_or_default(), self.positions.count);
                    let message = format!("{what}: vertex {vertex} does not exist: there are {known}");
                    return Err(MeshError::malformed(path, Position::Whole, message));
                };
                *corner = placement.position(path, vertex, Point3::from(position))?;
            }
            if placement.mirrors() {
                corners.swap(1, 2);
            }
            surface.triangle(corners);
        }
        Ok(surface.finish())
    }
}

/// Reads how a placed primitive looks. What cannot be read is named and left out.
struct Looks<'l, 'f> {
    file: &'l File<'f>,
    surface: &'l Surface<'l>,
    /// The primitive, for messages.
    what: &'l str,
    /// Whether the primitive was not placed before.
    is_first: bool,
    details: &'l mut Details,
}

impl<'l> Looks<'l, '_> {
    fn read(&mut self, primitive: &Primitive, placement: &Placement, materials: &mut Materials) -> PartDetails {
        let look = materials.of(self.file, primitive.material, self.details);
        let normals = self.numbers(primitive, Semantic::Normals, &[Type::Vec3]);
        let tex_coords = self.numbers(primitive, Semantic::TexCoords(look.set), &[Type::Vec2]);
        let mut colors = self.numbers(primitive, Semantic::Colors(0), &[Type::Vec3, Type::Vec4]);
        // Integers are always fractions here.
        colors.iter_mut().for_each(|colors| colors.normalized = true);
        let mut material = look.material.clone();
        if primitive.material.is_none() && colors.is_some() {
            // The colours stand alone.
            material.diffuse = [1.0; 3];
            material.ambient = [0.5; 3];
        }
        if normals.is_none() && tex_coords.is_none() && colors.is_none() {
            return PartDetails { material, facing: Facing::Flat };
        }
        let mut odd = [0usize; 3];
        let mut known: HashMap<usize, Corner> = HashMap::new();
        let mut corners = Vec::with_capacity(self.surface.triangle_count().saturating_mul(3));
        let details = &mut *self.details;
        for (i, triangle) in self.surface.triangles().enumerate() {
            let [a, b, c] = triangle.map(|vertex| {
                // All of them exist: the surface was placed before.
                let vertex = vertex.unwrap_or_default();
                let corner = known.entry(vertex).or_insert_with(|| {
                    let mut corner = Corner::bare(vertex as u32);
                    if let Some(normals) = &normals {
                        match normals.get::<3>(vertex).filter(is_finite) {
                            Some(normal) => {
                                corner.normal = details.normals.len() as u32;
                                details.normals.push(placement.normal(Vector3::from(normal)));
                            }
                            None => odd[0] += 1,
                        }
                    }
                    if let Some(tex_coords) = &tex_coords {
                        match tex_coords.get::<2>(vertex).filter(is_finite) {
                            Some([u, v]) => {
                                corner.tex_coord = details.tex_coords.len() as u32;
                                // In glTF v = 0 is the top row of the texture.
                                details.tex_coords.push([u as f32, (1.0 - v) as f32]);
                            }
                            None => odd[1] += 1,
                        }
                    }
                    if let Some(colors) = &colors {
                        let color = colors.get::<4>(vertex).or_else(|| {
                            let [r, g, b] = colors.get::<3>(vertex)?;
                            Some([r, g, b, 1.0])
                        });
                        match color.filter(is_finite) {
                            Some([r, g, b, a]) => {
                                let alpha = if look.blends { a.clamp(0.0, 1.0) as f32 } else { 1.0 };
                                let [r, g, b] = [r, g, b].map(displayed);
                                corner.color = details.colors.len() as u32;
                                details.colors.push([r, g, b, alpha]);
                            }
                            None => odd[2] += 1,
                        }
                    }
                    corner
                });
                // As the standard says: a surface without normals has facets.
                if normals.is_none() {
                    Corner { shared: i as u32, ..*corner }
                } else {
                    *corner
                }
            });
            corners.extend(if placement.mirrors() { [a, c, b] } else { [a, b, c] });
        }
        for (odd, semantic) in odd.into_iter().zip(["NORMAL", "TEXCOORD", "COLOR_0"]) {
            if odd > 0 && self.is_first {
                let message =
                    format!("{}: {odd} vertices have no finite {semantic}; they are drawn without", self.what);
                self.details.warnings.add_general(self.file.path, message);
            }
        }
        PartDetails { material, facing: Facing::Corners(corners) }
    }

    /// The numbers of an attribute that concerns looks; `None` if it is absent or cannot be read.
    fn numbers(&mut self, primitive: &Primitive, semantic: Semantic, types: &[Type]) -> Option<Numbers<'l>> {
        let file = self.file;
        let name = semantic.to_string();
        match file.numbers(attribute(primitive, semantic)?, types, self.what) {
            Ok(numbers) => Some(numbers),
            Err(error) => {
                if self.is_first {
                    let message = format!("{}; {name} is not used", message_of(error));
                    self.details.warnings.add_general(file.path, message);
                }
                None
            }
        }
    }
}

/// Whether all numbers are ones of 32 bits.
fn is_finite<const N: usize>(numbers: &[f64; N]) -> bool {
    numbers.iter().all(|x| x.abs() < 1e30)
}

/// The displayed value of a linear one: sRGB encodes it, from 0 to 1.
fn displayed(linear: f64) -> f32 {
    let linear = linear.clamp(0.0, 1.0);
    let encoded = if linear <= 0.0031308 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    encoded.clamp(0.0, 1.0) as f32
}

/// A material that was read before.
#[derive(Clone, Default)]
struct Look {
    material: MeshMaterial,
    /// The texture coordinates that it uses.
    set: u32,
    /// Whether the alpha of vertices counts.
    blends: bool,
}

/// Materials and pictures that were read before.
#[derive(Default)]
struct Materials {
    looks: HashMap<usize, Look>,
    /// `None` for one that cannot be read, which was said.
    pictures: HashMap<usize, Option<MeshTexture>>,
    /// Bytes of pictures that are parts of buffers.
    embedded: usize,
    /// Whether it was said that masks are not drawn.
    said_masks: bool,
}

impl Materials {
    /// The material of an index; the default where there is none, with a message if there should be one.
    fn of(&mut self, file: &File, index: Option<Index<Material>>, details: &mut Details) -> Look {
        let Some(index) = index.map(|index| index.value()) else { return Look::default() };
        if let Some(known) = self.looks.get(&index) {
            return known.clone();
        }
        let look = match file.root.materials.get(index) {
            Some(material) => self.read(file, index, material, details),
            None => {
                let message = format!("material {index} does not exist; the default material is drawn");
                details.warnings.add_general(file.path, message);
                Look::default()
            }
        };
        self.looks.insert(index, look.clone());
        look
    }

    fn read(&mut self, file: &File, index: usize, material: &Material, details: &mut Details) -> Look {
        let what = format!("material {index}");
        let model = &material.pbr_metallic_roughness;
        let [r, g, b, factor_alpha] = model.base_color_factor.0;
        let diffuse = [r, g, b].map(|x| displayed(f64::from(x)));
        let base = model.base_color_texture.as_ref();
        let roughness = model.metallic_roughness_texture.as_ref();
        let normal = material.normal_texture.as_ref();
        let is_transformed =
            |info: &gltf_json::texture::Info| info.extensions.as_ref().is_some_and(|e| e.texture_transform.is_some());
        let mut look = Look::default();
        let warn = |details: &mut Details, message: &str| {
            details.warnings.add_general(file.path, format!("{what}: {message}"));
        };
        if base.is_some_and(is_transformed) || roughness.is_some_and(is_transformed) {
            warn(details, "KHR_texture_transform is not used; the texture lies differently");
        }
        let sets = [base.map(|t| t.tex_coord), roughness.map(|t| t.tex_coord), normal.map(|t| t.tex_coord)];
        look.set = sets.into_iter().flatten().next().unwrap_or(0);
        if sets.into_iter().flatten().any(|set| set != look.set) {
            warn(details, &format!("all textures are drawn with TEXCOORD_{}", look.set));
        }
        if normal.is_some_and(|normal| normal.scale != 1.0) {
            warn(details, "the scale of the normal texture is not used");
        }
        let alpha = match material.alpha_mode {
            Checked::Valid(AlphaMode::Opaque) => 1.0,
            Checked::Valid(AlphaMode::Blend) => {
                look.blends = true;
                factor_alpha.clamp(0.0, 1.0)
            }
            Checked::Valid(AlphaMode::Mask) => {
                if base.is_some() && !self.said_masks {
                    self.said_masks = true;
                    warn(details, "masks of textures are drawn opaque");
                }
                if factor_alpha >= material.alpha_cutoff.unwrap_or_default().0 {
                    1.0
                } else {
                    0.0
                }
            }
            Checked::Invalid => {
                warn(details, "the alphaMode is none of glTF; it is drawn opaque");
                1.0
            }
        };
        let emission = match material.emissive_texture {
            // The factor alone would let all of it glow.
            Some(_) => {
                warn(details, "the emissive texture is not drawn");
                [0.0; 3]
            }
            None => material.emissive_factor.0.map(|x| displayed(f64::from(x))),
        };
        let mut texture = |index: usize| self.texture(file, &what, index, details);
        let diffuse_map = base.and_then(|base| texture(base.index.value()));
        let normal_map = normal.and_then(|normal| texture(normal.index.value()));
        let map = roughness.and_then(|roughness| texture(roughness.index.value()));
        look.material = MeshMaterial {
            ambient: diffuse.map(|x| x / 2.0),
            diffuse,
            emission,
            alpha,
            diffuse_map,
            normal_map,
            physical: Some(MetallicRoughness {
                metallic: model.metallic_factor.0.clamp(0.0, 1.0),
                roughness: model.roughness_factor.0.clamp(0.0, 1.0),
                map,
            }),
            ..MeshMaterial::default()
        };
        look
    }

    /// The picture of a texture; `None` with a message if it cannot be read.
    fn texture(&mut self, file: &File, what: &str, index: usize, details: &mut Details) -> Option<MeshTexture> {
        let source = file.root.textures.get(index).map(|texture| texture.source.value());
        let image = source.and_then(|source| Some((source, file.root.images.get(source)?)));
        let Some((number, image)) = image else {
            let message =
                format!("{what}: texture {index} has no picture that can be read; the plain material is drawn");
            details.warnings.add_general(file.path, message);
            return None;
        };
        if let Some(known) = self.pictures.get(&number) {
            return known.clone();
        }
        let picture = match self.picture(file, number, image) {
            Ok(picture) => Some(picture),
            Err(message) => {
                details.warnings.add_general(file.path, format!("{what}: {message}"));
                None
            }
        };
        self.pictures.insert(number, picture.clone());
        picture
    }

    /// # Errors
    /// A sentence that says what is wrong and what is drawn.
    fn picture(&mut self, file: &File, number: usize, image: &Image) -> Result<MeshTexture, String> {
        let unreadable = |why: String| format!("picture {number}: {why}; the plain material is drawn");
        let bytes = match (&image.uri, image.buffer_view) {
            (Some(uri), _) => match data_of(uri) {
                Some(data) => data.map_err(unreadable)?,
                None => return find_texture(file.path, file.path, &decoded(uri), file.files),
            },
            (None, Some(view)) => {
                let bytes = file.view(view.value()).map_err(|error| unreadable(message_of(error)))?;
                // Views may overlap, but pictures do not need to.
                self.embedded = self.embedded.saturating_add(bytes.len());
                let there = file.loaded.get().saturating_add(file.binary.map_or(0, |binary| binary.len() as u64));
                if self.embedded as u64 > there {
                    return Err(unreadable("the pictures of the file overlap".to_owned()));
                }
                bytes.to_vec()
            }
            (None, None) => return Err(unreadable("it has neither a uri nor a buffer view".to_owned())),
        };
        let name = format!("{} (picture {number})", file.path.display());
        Ok(MeshTexture::Embedded { name: name.into(), bytes: bytes.into() })
    }
}

#[cfg(test)]
mod tests;
