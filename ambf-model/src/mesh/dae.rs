//! Collada (DAE): triangles of the geometries that the scene places, in metres; their materials for what is drawn.
//!
//! Only the XML is left to a library: those that read Collada meshes assert what a damaged file does not hold.

use std::cell::OnceCell;
use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::ops::Range;
use std::path::Path;
use std::rc::Rc;
use std::str::FromStr;

use nalgebra::{Matrix4, Point3, Rotation3, Unit, Vector3};
use roxmltree::{Document, Node, NodeId};

use super::material::{find_texture, MeshMaterial, MeshTexture};
use super::placement::{short_name, Placement, MAX_NODES, MAX_TRIANGLES};
use super::visual::{Corner, Details, Facing, PartDetails, ABSENT};
use super::{decoded, printable, quoted, Files, Mesh, MeshError, Position, Welder, MAX_SUB_MESHES};
use crate::xml::find_excess;

/// Most quotes in one tag and its text: comments may hold many.
const MAX_QUOTES: usize = 4096;

/// Largest `offset` or `stride` attribute taken for real.
const MAX_STRIDE: usize = 1024;

pub(super) fn read(
    path: &Path,
    bytes: Vec<u8>,
    files: &Files,
    mut details: Option<&mut Details>,
) -> Result<Mesh, MeshError> {
    let text = String::from_utf8_lossy(&bytes);
    if let Some((byte, what)) = find_excess(&text, MAX_QUOTES) {
        return Err(MeshError::malformed(path, Position::Byte(byte), what));
    }
    let document = Document::parse(&text).map_err(|e| {
        // The sentence quotes names of the file as they are, and ends with the place.
        let (line, e) = (e.pos().row, e.to_string());
        let what = printable(e.rsplit_once(" at ").map_or(&e, |(what, _)| what), 120);
        MeshError::malformed(path, Position::Line(line), format!("not readable as XML: {what}"))
    })?;
    let ids = document.descendants().filter_map(|n| Some((n.attribute("id")?, n))).collect();
    let file = File { path, document: &document, ids, line_ends: OnceCell::new() };
    let mut geometries = HashMap::new();
    let mut materials = Materials::default();
    let mut mesh = Mesh::default();
    let mut triangle_count = 0;
    for Placed { geometry, instance, transform } in file.placed_geometries()? {
        let placement = Placement::new(transform);
        let primitives = match geometries.get(&geometry.id()) {
            Some(known) => Rc::clone(known),
            None => {
                let primitives = Rc::new(file.primitives(geometry, details.as_deref_mut())?);
                geometries.insert(geometry.id(), Rc::clone(&primitives));
                primitives
            }
        };
        for primitive in primitives.iter() {
            triangle_count += primitive.triangles.len();
            if triangle_count > MAX_TRIANGLES {
                return Err(file.malformed(geometry, format!("more than {MAX_TRIANGLES} triangles after instancing")));
            }
            if mesh.sub_meshes.len() == MAX_SUB_MESHES {
                return Err(file.malformed(geometry, format!("more than {MAX_SUB_MESHES} parts after instancing")));
            }
            mesh.sub_meshes.push(primitive.place(path, &placement)?);
            if let Some(details) = &mut details {
                let facing = Facing::Corners(primitive.place_corners(&placement, &mut details.normals));
                let material = materials.bound(&file, instance, primitive.symbol, files, details);
                details.parts.push(PartDetails { material, facing });
            }
        }
    }
    Ok(mesh)
}

struct File<'a> {
    path: &'a Path,
    document: &'a Document<'a>,
    ids: HashMap<&'a str, Node<'a, 'a>>,
    /// Bytes at which lines end. A file may be worth many messages, and is long.
    line_ends: OnceCell<Vec<usize>>,
}

/// A geometry in the scene.
struct Placed<'a> {
    geometry: Node<'a, 'a>,
    /// The element that places it; `None` in a file without a scene.
    instance: Option<Node<'a, 'a>>,
    /// Into the mesh frame, unit included.
    transform: Matrix4<f64>,
}

/// One `<triangles>`, `<polylist>`, `<polygons>`, `<tristrips>` or `<trifans>`.
struct Primitive<'a> {
    name: String,
    /// What instances bind a material to.
    symbol: Option<&'a str>,
    positions: Numbers,
    /// Indices into `positions`, checked.
    triangles: Vec<[usize; 3]>,
    looks: Looks,
}

/// What a primitive says of its corners besides their positions.
#[derive(Default)]
struct Looks {
    /// Three for each triangle, if wanted: index in [`Details::tex_coords`] and in `normals`, or [`ABSENT`].
    corners: Vec<[u32; 2]>,
    /// Normals that are used, as written.
    normals: Vec<Vector3<f64>>,
}

/// A view of an array of numbers, which many sources can share.
#[derive(Clone)]
struct Numbers {
    numbers: Rc<Vec<f64>>,
    first: usize,
    stride: usize,
}

impl Numbers {
    fn len(&self) -> usize {
        self.numbers.len().saturating_sub(self.first) / self.stride
    }

    /// The first `size` numbers of an index; `None` if it does not exist.
    fn values(&self, index: usize, size: usize) -> Option<&[f64]> {
        let at = index.checked_mul(self.stride)?.checked_add(self.first)?;
        (index < self.len()).then(|| self.numbers.get(at..at + size)).flatten()
    }

    fn get(&self, index: usize) -> Point3<f64> {
        let at = self.first + index * self.stride;
        Point3::from_slice(&self.numbers[at..at + 3])
    }
}

impl Primitive<'_> {
    /// How the corners of the placed triangles look; adds their normals to `normals`.
    fn place_corners(&self, placement: &Placement, normals: &mut Vec<[f32; 3]>) -> Vec<Corner> {
        let first = normals.len() as u32;
        normals.extend(self.looks.normals.iter().map(|normal| placement.normal(*normal)));
        let mut corners = Vec::with_capacity(3 * self.triangles.len());
        for (triangle, looks) in self.triangles.iter().zip(self.looks.corners.as_chunks::<3>().0) {
            let mut order = [0, 1, 2];
            if placement.mirrors() {
                order.swap(1, 2);
            }
            corners.extend(order.map(|k| {
                let [tex_coord, normal] = looks[k];
                let normal = if normal == ABSENT { ABSENT } else { first + normal };
                Corner { shared: triangle[k] as u32, tex_coord, normal, color: ABSENT }
            }));
        }
        corners
    }

    fn place(&self, path: &Path, placement: &Placement) -> Result<super::SubMesh, MeshError> {
        let mut surface = Welder::named(&self.name);
        for (i, triangle) in self.triangles.iter().enumerate() {
            let mut corners = [[0.0; 3]; 3];
            for (k, &index) in triangle.iter().enumerate() {
                corners[k] = placement.position(path, 3 * i + k, self.positions.get(index))?;
            }
            if placement.mirrors() {
                corners.swap(1, 2);
            }
            surface.triangle(corners);
        }
        Ok(surface.finish())
    }
}

fn child<'a>(node: Node<'a, 'a>, name: &str) -> Option<Node<'a, 'a>> {
    node.children().find(|c| c.has_tag_name_local(name))
}

/// Collada files use several namespaces; only the local name counts.
trait LocalName {
    fn has_tag_name_local(&self, name: &str) -> bool;
}

impl LocalName for Node<'_, '_> {
    fn has_tag_name_local(&self, name: &str) -> bool {
        self.is_element() && self.tag_name().name() == name
    }
}

impl<'a> File<'a> {
    fn malformed(&self, node: Node, message: impl Into<String>) -> MeshError {
        MeshError::malformed(self.path, self.line(node), message)
    }

    /// The line in which an element begins.
    fn line(&self, node: Node) -> Position {
        let text = self.document.input_text();
        let ends = self.line_ends.get_or_init(|| text.match_indices('\n').map(|(byte, _)| byte).collect());
        let start = node.range().start;
        Position::Line(ends.partition_point(|end| *end < start) as u32 + 1)
    }

    /// The element that attribute `attribute` of `node` refers to.
    fn target(&self, node: Node<'a, 'a>, attribute: &str) -> Result<Node<'a, 'a>, MeshError> {
        let url = node.attribute(attribute).unwrap_or("");
        let found = self.ids.get(url.strip_prefix('#').unwrap_or(url));
        found
            .copied()
            .ok_or_else(|| self.malformed(node, format!("{attribute}={} refers to nothing in this file", quoted(url))))
    }

    fn numbers<T: FromStr>(&self, node: Node<'a, 'a>) -> Result<Vec<T>, MeshError> {
        let words = node.text().unwrap_or("").split_ascii_whitespace();
        words
            .map(|w| w.parse().map_err(|_| self.malformed(node, format!("expected a number, got {}", quoted(w)))))
            .collect()
    }

    fn small_attribute(&self, node: Node<'a, 'a>, name: &str, default: usize) -> Result<usize, MeshError> {
        match node.attribute(name).map(|text| (text, text.parse())) {
            None => Ok(default),
            Some((_, Ok(number))) if number <= MAX_STRIDE => Ok(number),
            Some((text, _)) => {
                Err(self.malformed(node, format!("{name}={}: expected a number from 0 to {MAX_STRIDE}", quoted(text))))
            }
        }
    }

    /// Every geometry that the scene places. A file without a scene places each geometry once.
    fn placed_geometries(&self) -> Result<Vec<Placed<'a>>, MeshError> {
        let root = self.document.root_element();
        let unit = child(root, "asset").and_then(|a| child(a, "unit")).and_then(|u| u.attribute("meter"));
        let unit: f64 = unit.and_then(|u| u.parse().ok()).unwrap_or(1.0);
        let unit = Matrix4::new_scaling(unit);
        let scene = match child(root, "scene").and_then(|s| child(s, "instance_visual_scene")) {
            Some(instance) => Some(self.target(instance, "url")?),
            None => root.descendants().find(|n| n.has_tag_name_local("visual_scene")),
        };
        let Some(scene) = scene else {
            let geometries = root.descendants().filter(|n| n.has_tag_name_local("geometry"));
            return Ok(geometries.map(|geometry| Placed { geometry, instance: None, transform: unit }).collect());
        };
        let mut placed = Vec::new();
        let mut visited = 0;
        let mut stack = vec![(scene, unit)];
        while let Some((node, parent)) = stack.pop() {
            let mut transform = parent;
            let mut inner = Vec::new();
            for element in node.children().filter(Node::is_element) {
                visited += 1;
                if visited > MAX_NODES {
                    return Err(self.malformed(scene, "the scene is endless: a node seems to contain itself"));
                }
                match element.tag_name().name() {
                    "node" => inner.push(element),
                    "instance_node" => inner.push(self.target(element, "url")?),
                    "instance_geometry" => {
                        let geometry = self.target(element, "url")?;
                        placed.push(Placed { geometry, instance: Some(element), transform });
                    }
                    _ => transform *= self.transform(element)?,
                }
            }
            // Reversed, so that the stack yields them in file order.
            stack.extend(inner.into_iter().rev().map(|element| (element, transform)));
        }
        Ok(placed)
    }

    /// The matrix of a transformation element; identity for any other.
    fn transform(&self, element: Node<'a, 'a>) -> Result<Matrix4<f64>, MeshError> {
        let name = element.tag_name().name();
        let expected = match name {
            "matrix" => 16,
            "rotate" => 4,
            "translate" | "scale" => 3,
            "skew" | "lookat" => {
                return Err(self.malformed(element, format!("<{name}> is not supported; use <matrix>")))
            }
            _ => return Ok(Matrix4::identity()),
        };
        let v: Vec<f64> = self.numbers(element)?;
        if v.len() != expected {
            return Err(self.malformed(element, format!("<{name}> has {expected} numbers, got {}", v.len())));
        }
        Ok(match name {
            "matrix" => Matrix4::from_row_slice(&v),
            "translate" => Matrix4::new_translation(&Vector3::new(v[0], v[1], v[2])),
            "scale" => Matrix4::new_nonuniform_scaling(&Vector3::new(v[0], v[1], v[2])),
            _ => match Unit::try_new(Vector3::new(v[0], v[1], v[2]), 0.0) {
                Some(axis) => Rotation3::from_axis_angle(&axis, v[3].to_radians()).to_homogeneous(),
                None => Matrix4::identity(),
            },
        })
    }

    fn primitives(
        &self,
        geometry: Node<'a, 'a>,
        mut details: Option<&mut Details>,
    ) -> Result<Vec<Primitive<'a>>, MeshError> {
        let mut arrays = HashMap::new();
        let mut primitives = Vec::new();
        let Some(mesh) = child(geometry, "mesh") else { return Ok(primitives) };
        for element in mesh.children().filter(Node::is_element) {
            let kind = element.tag_name().name();
            if !matches!(kind, "triangles" | "polylist" | "polygons" | "tristrips" | "trifans") {
                continue;
            }
            let mut vertex_input = None;
            let mut stride = 1;
            for input in element.children().filter(|c| c.has_tag_name_local("input")) {
                let offset = self.small_attribute(input, "offset", 0)?;
                stride = stride.max(offset + 1);
                if input.attribute("semantic") == Some("VERTEX") {
                    vertex_input = Some((input, offset));
                }
            }
            // An element without any index list is empty, whatever its inputs.
            let Some((input, offset)) = vertex_input else { continue };
            let positions = self.numbers_of(self.position_source(input)?, 3, &mut arrays)?;
            let indices = self.triangles(element, kind, stride)?;
            let triangles = indices.of(offset);
            if let Some(index) = triangles.iter().flatten().find(|&&i| i >= positions.len()) {
                let message = format!("vertex {index} does not exist: the source has {}", positions.len());
                return Err(self.malformed(element, message));
            }
            let symbol = element.attribute("material");
            let name = short_name(symbol.or(geometry.attribute("name")).unwrap_or(""));
            let looks = match &mut details {
                Some(details) => self.looks(element, (input, offset), &indices, &mut arrays, details),
                None => Looks::default(),
            };
            primitives.push(Primitive { name, symbol, positions, triangles, looks });
        }
        Ok(primitives)
    }

    /// Normals and the first texture coordinates of a primitive. What cannot be read is named and left out.
    fn looks(
        &self,
        element: Node<'a, 'a>,
        vertex_input: (Node<'a, 'a>, usize),
        indices: &Indices,
        arrays: &mut Arrays,
        details: &mut Details,
    ) -> Looks {
        let mut looks = Looks { corners: vec![[ABSENT; 2]; 3 * indices.triangles.len()], normals: Vec::new() };
        let Details { tex_coords, warnings, .. } = details;
        for (field, semantic, size) in [(0, "TEXCOORD", 2), (1, "NORMAL", 3)] {
            let Some((source, offset)) = self.look_source(element, vertex_input, semantic) else { continue };
            let numbers = match source.and_then(|source| self.numbers_of(source, size, arrays)) {
                Ok(numbers) => numbers,
                Err(MeshError::Malformed { at, message, .. }) => {
                    warnings.add(self.path, at, format!("{message}; input {semantic} is not used"));
                    continue;
                }
                Err(_) => continue,
            };
            // Only what is used is kept: several primitives may share a long source.
            let mut kept = HashMap::new();
            let mut odd = 0;
            for (corner, &index) in looks.corners.iter_mut().zip(indices.of(offset).as_flattened()) {
                let Some(values) = numbers.values(index, size).filter(|values| values.iter().all(|x| x.abs() < 1e30))
                else {
                    odd += 1;
                    continue;
                };
                corner[field] = *kept.entry(index).or_insert_with(|| match field {
                    0 => {
                        tex_coords.push([values[0] as f32, values[1] as f32]);
                        tex_coords.len() as u32 - 1
                    }
                    _ => {
                        looks.normals.push(Vector3::from_column_slice(values));
                        looks.normals.len() as u32 - 1
                    }
                });
            }
            if odd > 0 {
                let message = format!("{odd} corners have no finite {semantic}; they are drawn without");
                warnings.add(self.path, self.line(element), message);
            }
        }
        looks
    }

    /// Source and offset of an input of a primitive, or of its vertices, other than the position; `None` if it has
    /// none.
    fn look_source(
        &self,
        element: Node<'a, 'a>,
        (vertex_input, vertex_offset): (Node<'a, 'a>, usize),
        semantic: &str,
    ) -> Option<(Result<Node<'a, 'a>, MeshError>, usize)> {
        let input = |node: Node<'a, 'a>| node.children().find(|c| c.attribute("semantic") == Some(semantic));
        if let Some(input) = input(element) {
            let offset = self.small_attribute(input, "offset", 0).ok()?;
            return Some((self.target(input, "source"), offset));
        }
        let input = input(self.target(vertex_input, "source").ok()?)?;
        Some((self.target(input, "source"), vertex_offset))
    }

    /// The `<source>` behind a VERTEX input.
    fn position_source(&self, input: Node<'a, 'a>) -> Result<Node<'a, 'a>, MeshError> {
        let vertices = self.target(input, "source")?;
        let position = vertices.children().find(|c| c.attribute("semantic") == Some("POSITION"));
        self.target(position.ok_or_else(|| self.malformed(vertices, "no input with semantic=\"POSITION\""))?, "source")
    }

    /// The numbers of a source, at least `size` for each index; `arrays` holds those that were read before.
    fn numbers_of(&self, source: Node<'a, 'a>, size: usize, arrays: &mut Arrays) -> Result<Numbers, MeshError> {
        let accessor = child(source, "technique_common").and_then(|t| child(t, "accessor"));
        let accessor = accessor.ok_or_else(|| self.malformed(source, "<source> without an <accessor>"))?;
        let stride = self.small_attribute(accessor, "stride", 1)?;
        let first = self.small_attribute(accessor, "offset", 0)?;
        if stride < size {
            let what = if size == 3 { "positions and normals" } else { "texture coordinates" };
            return Err(self.malformed(accessor, format!("stride {stride}: {what} need {size} numbers")));
        }
        let array = self.target(accessor, "source")?;
        let numbers = match arrays.entry(array.id()) {
            Entry::Occupied(known) => known.get().clone(),
            Entry::Vacant(slot) => {
                let read = self.numbers(array).map(Rc::new);
                slot.insert(read.as_ref().ok().cloned());
                Some(read?)
            }
        };
        let numbers = numbers.ok_or_else(|| self.malformed(array, "what should be numbers is not"))?;
        Ok(Numbers { numbers, first, stride })
    }

    /// Triangles and the indices of their corners; polygons become fans around their first corner.
    fn triangles(&self, element: Node<'a, 'a>, kind: &str, stride: usize) -> Result<Indices, MeshError> {
        let mut all = Indices { stride, numbers: Vec::new(), triangles: Vec::new() };
        let mut sizes: Vec<usize> = match child(element, "vcount") {
            Some(vcount) if kind == "polylist" => self.numbers(vcount)?,
            _ => Vec::new(),
        };
        for list in element.descendants().filter(|n| n.has_tag_name_local("p")) {
            let indices: Vec<usize> = self.numbers(list)?;
            if !indices.len().is_multiple_of(stride) {
                return Err(self.malformed(list, format!("{} indices are no multiple of {stride}", indices.len())));
            }
            let first = all.numbers.len() / stride;
            let corners = first..first + indices.len() / stride;
            all.numbers.extend(indices);
            let triangles = &mut all.triangles;
            match kind {
                "triangles" => {
                    if !corners.len().is_multiple_of(3) {
                        return Err(self.malformed(list, format!("{} corners are no multiple of 3", corners.len())));
                    }
                    triangles.extend(corners.step_by(3).map(|c| [c, c + 1, c + 2]));
                }
                "tristrips" => {
                    let strip = corners.start..corners.end.saturating_sub(2).max(corners.start);
                    let turned = |i: usize| (i - first) % 2 == 1;
                    triangles.extend(strip.map(|c| if turned(c) { [c + 1, c, c + 2] } else { [c, c + 1, c + 2] }));
                }
                "polylist" => {
                    let mut rest = corners;
                    for size in std::mem::take(&mut sizes) {
                        if size > rest.len() {
                            let left = rest.len();
                            return Err(self.malformed(list, format!("a polygon of {size} corners, {left} are left")));
                        }
                        triangles.extend(fan(rest.start..rest.start + size));
                        rest.start += size;
                    }
                }
                _ => triangles.extend(fan(corners)),
            }
        }
        Ok(all)
    }
}

/// Numbers of arrays by element; `None` for one that is damaged, so that it is read only once.
type Arrays = HashMap<NodeId, Option<Rc<Vec<f64>>>>;

/// The index lists of a primitive.
struct Indices {
    /// Indices of one corner.
    stride: usize,
    numbers: Vec<usize>,
    /// Corners of the triangles.
    triangles: Vec<[usize; 3]>,
}

impl Indices {
    /// The index at `offset` of each corner of each triangle.
    fn of(&self, offset: usize) -> Vec<[usize; 3]> {
        self.triangles.iter().map(|corners| corners.map(|corner| self.numbers[corner * self.stride + offset])).collect()
    }
}

fn fan(polygon: Range<usize>) -> impl Iterator<Item = [usize; 3]> {
    let first = polygon.start;
    (first + 1..polygon.end.saturating_sub(1)).map(move |second| [first, second, second + 1])
}

/// Materials that were read before.
#[derive(Default)]
struct Materials<'a> {
    by_effect: HashMap<NodeId, MeshMaterial>,
    /// For each instance: the material of each symbol.
    bindings: HashMap<NodeId, HashMap<&'a str, &'a str>>,
    /// Those that were reported missing.
    unknown: HashSet<&'a str>,
}

impl<'a> Materials<'a> {
    /// The material that `instance` binds to `symbol`; the default where there is none, with a message if there should
    /// be one.
    fn bound(
        &mut self,
        file: &File<'a>,
        instance: Option<Node<'a, 'a>>,
        symbol: Option<&'a str>,
        files: &Files,
        details: &mut Details,
    ) -> MeshMaterial {
        let Some(symbol) = symbol else { return MeshMaterial::default() };
        let bound = instance.and_then(|instance| {
            let bindings = self.bindings.entry(instance.id()).or_insert_with(|| {
                let materials = instance.descendants().filter(|n| n.has_tag_name_local("instance_material"));
                materials.filter_map(|m| Some((m.attribute("symbol")?, m.attribute("target")?))).collect()
            });
            bindings.get(symbol).copied()
        });
        // Many a file leaves out the binding and names the material itself.
        let id = bound.unwrap_or(symbol);
        let material = file.ids.get(id.strip_prefix('#').unwrap_or(id));
        let effect = material
            .filter(|material| material.has_tag_name_local("material"))
            .and_then(|material| child(*material, "instance_effect"))
            .and_then(|instance| file.target(instance, "url").ok());
        match effect {
            Some(effect) => {
                let known = self.by_effect.entry(effect.id());
                known.or_insert_with(|| Effect { file, effect, files }.material(details)).clone()
            }
            None => {
                if self.unknown.insert(symbol) {
                    let message = format!("material {} has no effect; the default material is drawn", quoted(symbol));
                    let place = instance.unwrap_or(file.document.root_element());
                    details.warnings.add(file.path, file.line(place), message);
                }
                MeshMaterial::default()
            }
        }
    }
}

/// An `<effect>`.
struct Effect<'f, 'a> {
    file: &'f File<'a>,
    effect: Node<'a, 'a>,
    files: &'f Files<'f>,
}

/// A colour or a texture.
enum Look<'a> {
    Color([f32; 4]),
    Texture(Node<'a, 'a>),
}

impl<'a> Effect<'_, 'a> {
    fn material(&self, details: &mut Details) -> MeshMaterial {
        let model = self
            .effect
            .descendants()
            .find(|n| ["phong", "blinn", "lambert", "constant"].iter().any(|name| n.has_tag_name_local(name)));
        let Some(model) = model else { return MeshMaterial::default() };
        let mut material = MeshMaterial { shininess: 0.0, ..MeshMaterial::default() };
        let mut look = |name: &str| child(model, name).and_then(|node| self.look(node, details));
        material.diffuse = [0.8; 3];
        match look("diffuse") {
            Some(Look::Color([r, g, b, _])) => material.diffuse = [r, g, b],
            Some(Look::Texture(texture)) => {
                // The texture stands for the colour.
                material.diffuse = [1.0; 3];
                material.diffuse_map = self.texture(texture, details);
            }
            None => {}
        }
        let mut look = |name: &str| child(model, name).and_then(|node| self.look(node, details));
        // As in OBJ files, where a file says nothing.
        material.ambient = match look("ambient") {
            Some(Look::Color([r, g, b, _])) => [r, g, b],
            _ => material.diffuse.map(|x| x / 2.0),
        };
        material.emission = match look("emission") {
            Some(Look::Color([r, g, b, _])) => [r, g, b],
            _ => [0.0; 3],
        };
        material.specular = match look("specular") {
            Some(Look::Color([r, g, b, _])) => [r, g, b],
            Some(Look::Texture(texture)) => {
                material.specular_map = self.texture(texture, details);
                [1.0; 3]
            }
            None if model.has_tag_name_local("lambert") || model.has_tag_name_local("constant") => [0.0; 3],
            None => [0.3; 3],
        };
        if let Some(shininess) = self.float(model, "shininess", details) {
            material.shininess = shininess.clamp(0.0, 128.0);
        }
        material.alpha = self.alpha(model, details);
        let bump = self.effect.descendants().find(|n| n.has_tag_name_local("bump"));
        if let Some(texture) = bump.and_then(|bump| child(bump, "texture")) {
            material.normal_map = self.texture(texture, details);
        }
        material
    }

    fn warn(&self, details: &mut Details, node: Node, message: impl AsRef<str>) {
        details.warnings.add(self.file.path, self.file.line(node), message);
    }

    /// Finite numbers of an element, as many as there should be; a message if they are not.
    fn floats<const N: usize>(&self, node: Node<'a, 'a>, details: &mut Details) -> Option<[f32; N]> {
        let numbers: Option<Vec<f32>> = self.file.numbers(node).ok();
        let numbers = numbers.and_then(|numbers| <[f32; N]>::try_from(numbers).ok());
        let numbers = numbers.filter(|numbers| numbers.iter().all(|x| x.is_finite()));
        if numbers.is_none() {
            self.warn(details, node, format!("expected {N} finite numbers; the default is used"));
        }
        numbers
    }

    fn look(&self, node: Node<'a, 'a>, details: &mut Details) -> Option<Look<'a>> {
        if let Some(texture) = child(node, "texture") {
            return Some(Look::Texture(texture));
        }
        let color = child(node, "color")?;
        // Some exporters leave out the alpha.
        if color.text().unwrap_or("").split_ascii_whitespace().count() == 3 {
            return self.floats(color, details).map(|[r, g, b]| Look::Color([r, g, b, 1.0]));
        }
        self.floats(color, details).map(Look::Color)
    }

    fn float(&self, model: Node<'a, 'a>, name: &str, details: &mut Details) -> Option<f32> {
        let float = child(child(model, name)?, "float")?;
        self.floats(float, details).map(|[x]| x)
    }

    /// Opacity: by the alpha of the transparent colour, or by its brightness, as its attribute `opaque` says. Many
    /// exporters write 0 where they mean opaque; nothing is drawn to be wholly clear, so that 0 is taken for 1.
    fn alpha(&self, model: Node<'a, 'a>, details: &mut Details) -> f32 {
        let transparency = self.float(model, "transparency", details).unwrap_or(1.0);
        let transparent = child(model, "transparent");
        let alpha = match transparent.and_then(|node| Some((node, self.look(node, details)?))) {
            Some((node, Look::Color([r, g, b, a]))) => match node.attribute("opaque") {
                Some("RGB_ZERO") => 1.0 - transparency * (0.212671 * r + 0.715160 * g + 0.072169 * b),
                _ => transparency * a,
            },
            // A texture with an alpha has it itself.
            Some((_, Look::Texture(_))) => 1.0,
            None => transparency,
        };
        if alpha > 0.0 {
            alpha.min(1.0)
        } else {
            1.0
        }
    }

    /// The file of a `<texture>`: through a sampler and a surface, through a sampler alone, or directly.
    fn texture(&self, texture: Node<'a, 'a>, details: &mut Details) -> Option<MeshTexture> {
        let parameter = |sid: &str| {
            let parameters = self.effect.descendants().filter(|n| n.has_tag_name_local("newparam"));
            parameters.into_iter().find(|n| n.attribute("sid") == Some(sid))
        };
        let text = |node: Node<'a, 'a>| node.text().map(str::trim);
        let sid = texture.attribute("texture").unwrap_or("");
        let sampler = parameter(sid).and_then(|p| child(p, "sampler2D"));
        let surface = |sampler: Node<'a, 'a>| {
            let surface = child(parameter(text(child(sampler, "source")?)?)?, "surface")?;
            child(surface, "init_from").and_then(text)
        };
        let image = match sampler {
            Some(sampler) => child(sampler, "instance_image")
                .and_then(|image| image.attribute("url"))
                .map(|url| url.strip_prefix('#').unwrap_or(url))
                .or_else(|| surface(sampler)),
            None => Some(sid),
        };
        let image = image.and_then(|id| self.file.ids.get(id)).filter(|node| node.has_tag_name_local("image"));
        let from = image.and_then(|image| child(*image, "init_from"));
        let name = from.and_then(|from| child(from, "ref").unwrap_or(from).text()).map(str::trim);
        let Some(name) = name.filter(|name| !name.is_empty()) else {
            self.warn(details, texture, format!("texture {} names no image; the plain material is drawn", quoted(sid)));
            return None;
        };
        let name = decoded(name.strip_prefix("file://").unwrap_or(name));
        match find_texture(self.file.path, self.file.path, &name, self.files) {
            Ok(path) => Some(path),
            Err(message) => {
                self.warn(details, texture, message);
                None
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{parse_visual, VisualMesh};

    fn parse(text: impl Into<Vec<u8>>) -> Result<Mesh, MeshError> {
        crate::mesh::parse(text.into(), Path::new("t.dae"))
    }

    /// A unit square with the given primitive element and scene.
    fn document(primitive: &str, scene: &str) -> String {
        format!(
            r##"<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="0.01"/><up_axis>Y_UP</up_axis></asset>
<library_geometries><geometry id="g" name="plate"><mesh>
<source id="s"><float_array id="a" count="12">0 0 0 100 0 0 100 100 0 0 1e2 0</float_array>
<technique_common><accessor source="#a" count="4" stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
{primitive}
</mesh></geometry></library_geometries>
{scene}
</COLLADA>"##
        )
    }

    const INPUT: &str = r##"<input semantic="VERTEX" source="#v" offset="1"/><input semantic="NORMAL" offset="0"/>"##;

    fn triangles() -> String {
        format!(r#"<triangles material="red" count="2">{INPUT}<p>9 0 9 1 9 2 9 0 9 2 9 3</p></triangles>"#)
    }

    fn scene(nodes: &str) -> String {
        format!(
            r##"<library_visual_scenes><visual_scene id="scene">{nodes}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene>"##
        )
    }

    #[test]
    fn every_kind_of_primitive_gives_the_same_square() {
        let expected = parse(document(&triangles(), "")).unwrap();
        assert_eq!(expected.sub_meshes[0].name, "red");
        assert_eq!(expected.sub_meshes[0].vertices[2], [1.0, 1.0, 0.0]);
        assert_eq!(expected.sub_meshes[0].triangles, [[0, 1, 2], [0, 2, 3]]);
        for other in [
            format!("<polylist>{INPUT}<vcount>4</vcount><p>9 0 9 1 9 2 9 3</p></polylist>"),
            format!("<polygons>{INPUT}<p>9 0 9 1 9 2 9 3</p></polygons>"),
            format!("<trifans>{INPUT}<p>9 0 9 1 9 2 9 3</p></trifans>"),
        ] {
            let mesh = parse(document(&other, "")).unwrap();
            assert_eq!(mesh.sub_meshes[0].triangles, expected.sub_meshes[0].triangles, "{other}");
            assert_eq!(mesh.sub_meshes[0].name, "plate");
        }
        let strip = format!("<tristrips>{INPUT}<p>9 1 9 2 9 0 9 3</p></tristrips>");
        let strip = parse(document(&strip, "")).unwrap();
        assert_eq!(strip.sub_meshes[0].triangles, [[0, 1, 2], [2, 1, 3]]);
    }

    #[test]
    fn nodes_place_geometries() {
        let nodes = r##"<node><translate>0 0 200</translate><rotate>0 0 1 90</rotate>
<node><scale>-1 1 1</scale><instance_geometry url="#g"/></node><instance_geometry url="#g"/></node>"##;
        let mesh = parse(document(&triangles(), &scene(nodes))).unwrap();
        assert_eq!(mesh.sub_meshes.len(), 2);
        let near = |p: [f64; 3], q: [f64; 3]| p.iter().zip(q).all(|(a, b)| (a - b).abs() < 1e-12);
        let long = parse(document(&triangles().replace("red", &"é".repeat(5000)), &scene(nodes))).unwrap();
        assert_eq!(long.sub_meshes[1].name, "é".repeat(200));
        // Vertex (1, 0, 0), unmirrored and mirrored; the mirrored triangles are reversed.
        assert!(near(mesh.sub_meshes[0].vertices[1], [0.0, 1.0, 2.0]));
        assert!(near(mesh.sub_meshes[1].vertices[2], [0.0, -1.0, 2.0]));
    }

    /// Looks of a document; the file `wood 1.png` is there.
    fn looks(text: &str) -> (VisualMesh, Vec<String>) {
        let named = |path: &Path| path.ends_with("wood 1.png").then(Vec::new);
        parse_visual(text.into(), Path::new("t.dae"), false, &named).unwrap()
    }

    /// A triangle with normals (0, 0, 1), texture coordinates, and the material "red", bound to an effect with these
    /// keys.
    fn described(effect: &str, nodes: &str) -> String {
        let primitive = r##"<source id="n"><float_array id="na">0 0 3 9 9 9</float_array>
<technique_common><accessor source="#na" count="2" stride="3"/></technique_common></source>
<source id="t"><float_array id="ta">0 0 1 0 1 0.5 9 9</float_array>
<technique_common><accessor source="#ta" count="4" stride="2"/></technique_common></source>
<triangles material="red" count="1"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="NORMAL" source="#n" offset="1"/><input semantic="TEXCOORD" source="#t" offset="2" set="0"/>
<p>0 0 0 1 0 1 2 0 2</p></triangles>"##;
        let library = format!(
            r##"<library_images><image id="i"><init_from>file://wood%201.png</init_from></image></library_images>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="su"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="sa"><sampler2D><source>su</source></sampler2D></newparam>
<technique>{effect}</technique></profile_COMMON></effect></library_effects>"##
        );
        document(primitive, &(library + &scene(nodes)))
    }

    const PLACED: &str = r##"<instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="red" target="#m"/></technique_common></bind_material></instance_geometry>"##;

    #[test]
    fn effects_become_materials() {
        let effect = r#"<phong><emission><color>0 0 0.5 1</color></emission><ambient><color>0.1 0.2 0.3 1</color></ambient>
<diffuse><texture texture="sa" texcoord="UV"/></diffuse><specular><color>1 0 0</color></specular>
<shininess><float>500</float></shininess><transparent opaque="A_ONE"><color>1 1 1 0.5</color></transparent>
<transparency><float>0.5</float></transparency></phong>"#;
        let (mesh, messages) = looks(&described(effect, &format!("<node>{PLACED}</node>")));
        assert!(messages.is_empty(), "{messages:?}");
        let part = &mesh.parts[0];
        assert_eq!(part.name, "red");
        assert_eq!(part.tex_coords, [[0.0, 0.0], [1.0, 0.0], [1.0, 0.5]]);
        assert_eq!(part.normals, [[0.0, 0.0, 1.0]; 3]);
        assert_eq!(
            part.material,
            MeshMaterial {
                ambient: [0.1, 0.2, 0.3],
                diffuse: [1.0; 3],
                specular: [1.0, 0.0, 0.0],
                emission: [0.0, 0.0, 0.5],
                alpha: 0.25,
                shininess: 128.0,
                diffuse_map: Some("wood 1.png".into()),
                ..MeshMaterial::default()
            }
        );
        // What exporters write for opaque.
        let opaque = "<lambert><transparency><float>0</float></transparency></lambert>";
        let (mesh, _) = looks(&described(opaque, &format!("<node>{PLACED}</node>")));
        assert_eq!((mesh.parts[0].material.alpha, mesh.parts[0].material.specular), (1.0, [0.0; 3]));
    }

    #[test]
    fn normals_turn_with_their_node() {
        let nodes = format!(
            "<node><rotate>1 0 0 90</rotate><scale>1 1 -2</scale>{PLACED}</node><node><scale>0 0 0</scale>{PLACED}</node>"
        );
        let (mesh, messages) = looks(&described("<lambert/>", &nodes));
        assert!(messages.is_empty(), "{messages:?}");
        // Mirrored along z: the outside is turned too.
        let near = |n: &[f32; 3], expected: [f32; 3]| n.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(mesh.parts[0].normals.iter().all(|n| near(n, [0.0, 1.0, 0.0])), "{:?}", mesh.parts[0].normals);
        // (100, 100) is corner 2, reversed to corner 1 by the mirror; texture coordinates follow.
        let [_, second, _] = mesh.parts[0].triangles[0];
        assert_eq!(mesh.parts[0].tex_coords[second as usize], [1.0, 0.5]);
        assert_eq!(mesh.parts[1].normals, [[0.0, 0.0, 1.0]; 3]);
    }

    #[test]
    fn looks_that_cannot_be_read_are_named_and_the_mesh_stays() {
        let node = format!("<node>{PLACED}</node>");
        let good = described("<lambert/>", &node);
        for (text, expected) in [
            (good.replace("9 9 9", "9 9 x"), "t.dae:8: expected a number, got 'x'; input NORMAL is not used"),
            (good.replace("1 0 1 2", "1 7 1 2"), "t.dae:12: 1 corners have no finite NORMAL; they are drawn without"),
            (good.replace("0.5 9 9", "nan 9 9"), "t.dae:12: 1 corners have no finite TEXCOORD"),
            (good.replace("\"#t\"", "\"#u\""), "refers to nothing in this file; input TEXCOORD is not used"),
            (good.replace("#m", "#k"), "material 'red' has no effect; the default material is drawn"),
            (
                described("<lambert><diffuse><color>1 2</color></diffuse></lambert>", &node),
                ": expected 4 finite numbers; the default is used",
            ),
            (
                described("<lambert><diffuse><texture texture=\"zz\"/></diffuse></lambert>", &node),
                ": texture 'zz' names no image; the plain material is drawn",
            ),
            (
                described("<lambert><diffuse><texture texture=\"sa\"/></diffuse></lambert>", &node).replace("%20", ""),
                "texture 'wood1.png' is not there (looked for wood1.png); the plain material is drawn",
            ),
        ] {
            let (mesh, messages) = looks(&text);
            assert_eq!(mesh.triangle_count(), 1);
            assert!(messages.len() == 1 && messages[0].contains(expected), "{messages:?}, expected {expected}");
        }
    }

    #[test]
    fn broken_files_are_refused_with_the_line() {
        let endless = r##"<node id="n"><instance_node url="#n"/></node>"##;
        let good = document(&triangles(), "");
        for (text, expected) in [
            (String::new(), ":1: not readable as XML"),
            (good[..good.len() / 2].to_owned(), "not readable as XML"),
            (format!("<a></{}>", "x".repeat(5000)), "xxx…"),
            (format!("<a {}/>", "b=\"1\" ".repeat(100_000)), "too many attributes in one tag"),
            (good.replace("9 3</p>", "9 4</p>"), ":8: vertex 4 does not exist: the source has 4"),
            (good.replace("9 3</p>", "9 -3</p>"), ":8: expected a number, got '-3'"),
            (good.replace("9 3</p>", "9</p>"), ":8: 11 indices are no multiple of 2"),
            (good.replace("\"#s\"", "\"#t\""), ":7: source='#t' refers to nothing"),
            (good.replace("stride=\"3\"", "stride=\"1\""), ":6: stride 1"),
            (good.replace("offset=\"1\"", "offset=\"99999999999999999999\""), ":8: offset="),
            (good.replace("1e2", "inf"), "vertex 5 is not finite"),
            (document(&triangles(), &scene(endless)), "the scene is endless"),
            (document(&triangles(), &scene("<node><matrix>1</matrix></node>")), "<matrix> has 16 numbers, got 1"),
        ] {
            let message = parse(text).unwrap_err().to_string();
            assert!(message.contains(expected) && message.len() < 1000, "{message}");
        }
    }

    #[test]
    fn deep_nesting_does_not_exhaust_the_stack() {
        let depth = 200_000;
        let nodes = "<node>".repeat(depth) + &"</node>".repeat(depth);
        let outcome = parse(document(&triangles(), &scene(&nodes)));
        assert!(outcome.is_err() || outcome.unwrap().sub_meshes.is_empty());
    }
}
