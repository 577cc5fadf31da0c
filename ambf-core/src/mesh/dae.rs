//! Collada (DAE): triangles of the geometries that the scene places, in metres.
//!
//! Only the XML is left to a library: those that read Collada meshes assert what a damaged file does not hold.

use std::collections::hash_map::Entry;
use std::collections::HashMap;
use std::path::Path;
use std::rc::Rc;
use std::str::FromStr;

use nalgebra::{Matrix4, Point3, Rotation3, Unit, Vector3};
use roxmltree::{Document, Node, NodeId};

use super::visual::{Details, PartDetails};
use super::{check_finite, printable, quoted, Files, Mesh, MeshError, Position, Welder, MAX_SUB_MESHES};
use crate::xml::find_excess;

/// Elements of nodes and triangles that one file may expand to: nested instances can grow exponentially, or for ever.
const MAX_ELEMENTS: usize = 1_000_000;
const MAX_TRIANGLES: usize = 10_000_000;

/// Most quotes in one tag and its text: comments may hold many.
const MAX_QUOTES: usize = 4096;

/// Largest `offset` or `stride` attribute taken for real.
const MAX_STRIDE: usize = 1024;

pub(super) fn read(
    path: &Path,
    bytes: Vec<u8>,
    _files: &Files,
    details: Option<&mut Details>,
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
    let file = File { path, document: &document, ids };
    let mut geometries = HashMap::new();
    let mut mesh = Mesh::default();
    let mut triangle_count = 0;
    for (geometry, transform) in file.placed_geometries()? {
        let primitives = match geometries.get(&geometry.id()) {
            Some(known) => Rc::clone(known),
            None => {
                let primitives = Rc::new(file.primitives(geometry)?);
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
            mesh.sub_meshes.push(primitive.place(path, &transform)?);
        }
    }
    if let Some(details) = details {
        details.parts.resize_with(mesh.sub_meshes.len(), PartDetails::default);
    }
    Ok(mesh)
}

struct File<'a> {
    path: &'a Path,
    document: &'a Document<'a>,
    ids: HashMap<&'a str, Node<'a, 'a>>,
}

/// One `<triangles>`, `<polylist>`, `<polygons>`, `<tristrips>` or `<trifans>`.
struct Primitive {
    name: String,
    positions: Positions,
    /// Indices into `positions`, checked.
    triangles: Vec<[usize; 3]>,
}

/// A view of an array of numbers, which many sources can share.
#[derive(Clone)]
struct Positions {
    numbers: Rc<Vec<f64>>,
    first: usize,
    stride: usize,
}

impl Positions {
    fn len(&self) -> usize {
        self.numbers.len().saturating_sub(self.first) / self.stride
    }

    fn get(&self, index: usize) -> Point3<f64> {
        let at = self.first + index * self.stride;
        Point3::from_slice(&self.numbers[at..at + 3])
    }
}

impl Primitive {
    fn place(&self, path: &Path, transform: &Matrix4<f64>) -> Result<super::SubMesh, MeshError> {
        let mirrored = transform.fixed_view::<3, 3>(0, 0).determinant() < 0.0;
        let mut surface = Welder::named(&self.name);
        for (i, triangle) in self.triangles.iter().enumerate() {
            let mut corners = [[0.0; 3]; 3];
            for (k, &index) in triangle.iter().enumerate() {
                let position = transform.transform_point(&self.positions.get(index));
                corners[k] = check_finite(path, 3 * i + k, position.into())?;
            }
            if mirrored {
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
        let line = self.document.text_pos_at(node.range().start).row;
        MeshError::malformed(self.path, Position::Line(line), message)
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

    /// Every geometry that the scene places, with its transform into the mesh frame (unit included). A file without a scene
    /// places each geometry once.
    fn placed_geometries(&self) -> Result<Vec<(Node<'a, 'a>, Matrix4<f64>)>, MeshError> {
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
            return Ok(geometries.map(|g| (g, unit)).collect());
        };
        let mut placed = Vec::new();
        let mut visited = 0;
        let mut stack = vec![(scene, unit)];
        while let Some((node, parent)) = stack.pop() {
            let mut transform = parent;
            let mut inner = Vec::new();
            for element in node.children().filter(Node::is_element) {
                visited += 1;
                if visited > MAX_ELEMENTS {
                    return Err(self.malformed(scene, "the scene is endless: a node seems to contain itself"));
                }
                match element.tag_name().name() {
                    "node" => inner.push(element),
                    "instance_node" => inner.push(self.target(element, "url")?),
                    "instance_geometry" => placed.push((self.target(element, "url")?, transform)),
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

    fn primitives(&self, geometry: Node<'a, 'a>) -> Result<Vec<Primitive>, MeshError> {
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
            let positions = self.positions(self.position_source(input)?, &mut arrays)?;
            let triangles = self.triangles(element, kind, stride, offset)?;
            if let Some(index) = triangles.iter().flatten().find(|&&i| i >= positions.len()) {
                let message = format!("vertex {index} does not exist: the source has {}", positions.len());
                return Err(self.malformed(element, message));
            }
            let name = element.attribute("material").or(geometry.attribute("name")).unwrap_or("").to_owned();
            primitives.push(Primitive { name, positions, triangles });
        }
        Ok(primitives)
    }

    /// The `<source>` behind a VERTEX input.
    fn position_source(&self, input: Node<'a, 'a>) -> Result<Node<'a, 'a>, MeshError> {
        let vertices = self.target(input, "source")?;
        let position = vertices.children().find(|c| c.attribute("semantic") == Some("POSITION"));
        self.target(position.ok_or_else(|| self.malformed(vertices, "no input with semantic=\"POSITION\""))?, "source")
    }

    /// The positions of a source; `arrays` holds the numbers that were read before.
    fn positions(
        &self,
        source: Node<'a, 'a>,
        arrays: &mut HashMap<NodeId, Rc<Vec<f64>>>,
    ) -> Result<Positions, MeshError> {
        let accessor = child(source, "technique_common").and_then(|t| child(t, "accessor"));
        let accessor = accessor.ok_or_else(|| self.malformed(source, "<source> without an <accessor>"))?;
        let stride = self.small_attribute(accessor, "stride", 1)?;
        let first = self.small_attribute(accessor, "offset", 0)?;
        if stride < 3 {
            return Err(self.malformed(accessor, format!("stride {stride}: positions need 3 numbers")));
        }
        let array = self.target(accessor, "source")?;
        let numbers = match arrays.entry(array.id()) {
            Entry::Occupied(known) => Rc::clone(known.get()),
            Entry::Vacant(slot) => Rc::clone(slot.insert(Rc::new(self.numbers(array)?))),
        };
        Ok(Positions { numbers, first, stride })
    }

    /// Triangles of position indices; polygons become fans around their first corner.
    fn triangles(
        &self,
        element: Node<'a, 'a>,
        kind: &str,
        stride: usize,
        offset: usize,
    ) -> Result<Vec<[usize; 3]>, MeshError> {
        let mut triangles = Vec::new();
        let mut sizes: Vec<usize> = match child(element, "vcount") {
            Some(vcount) if kind == "polylist" => self.numbers(vcount)?,
            _ => Vec::new(),
        };
        for list in element.descendants().filter(|n| n.has_tag_name_local("p")) {
            let indices: Vec<usize> = self.numbers(list)?;
            if !indices.len().is_multiple_of(stride) {
                return Err(self.malformed(list, format!("{} indices are no multiple of {stride}", indices.len())));
            }
            let corners: Vec<usize> = indices.chunks_exact(stride).map(|c| c[offset]).collect();
            match kind {
                "triangles" => {
                    if !corners.len().is_multiple_of(3) {
                        return Err(self.malformed(list, format!("{} corners are no multiple of 3", corners.len())));
                    }
                    triangles.extend(corners.chunks_exact(3).map(|c| [c[0], c[1], c[2]]));
                }
                "tristrips" => {
                    let strip = corners.windows(3).enumerate();
                    triangles
                        .extend(strip.map(|(i, c)| if i % 2 == 0 { [c[0], c[1], c[2]] } else { [c[1], c[0], c[2]] }));
                }
                "polylist" => {
                    let mut rest = corners.as_slice();
                    for size in std::mem::take(&mut sizes) {
                        let polygon = rest.get(..size).ok_or_else(|| {
                            self.malformed(list, format!("a polygon of {size} corners, {} are left", rest.len()))
                        })?;
                        rest = &rest[size..];
                        triangles.extend(fan(polygon));
                    }
                }
                _ => triangles.extend(fan(&corners)),
            }
        }
        Ok(triangles)
    }
}

fn fan(polygon: &[usize]) -> impl Iterator<Item = [usize; 3]> + '_ {
    polygon.get(1..).unwrap_or(&[]).windows(2).map(|pair| [polygon[0], pair[0], pair[1]])
}

#[cfg(test)]
mod tests {
    use super::*;

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
        // Vertex (1, 0, 0), unmirrored and mirrored; the mirrored triangles are reversed.
        assert!(near(mesh.sub_meshes[0].vertices[1], [0.0, 1.0, 2.0]));
        assert!(near(mesh.sub_meshes[1].vertices[2], [0.0, -1.0, 2.0]));
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
