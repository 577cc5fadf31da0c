//! Polygon files (PLY), ASCII and binary: what scanners and MeshLab write.
//!
//! A library reads the header and the elements, one at a time and into the few properties that count here. Counts are
//! checked before, because a header may announce anything.

use std::io::ErrorKind;
use std::path::Path;

use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{
    ElementDef, Encoding, Header, Property, PropertyAccess, PropertyAccessResult, PropertyType, ScalarType,
};

use super::material::{find_texture, MeshMaterial};
use super::visual::{Corner, Details, Facing, PartDetails, ABSENT, MAX_TRIANGLES};
use super::{check_finite, printable, quoted, Files, Mesh, MeshError, Position, Welder};

/// Most bytes of a header, comments included.
const MAX_HEADER_BYTES: usize = 1 << 20;

pub(super) fn read(
    path: &Path,
    bytes: Vec<u8>,
    files: &Files,
    mut details: Option<&mut Details>,
) -> Result<Mesh, MeshError> {
    let (header, mut payload) = read_header(path, &bytes)?;
    check_elements(&header, &payload)?;
    let mut vertices = Vertices::default();
    let mut faces = Faces::default();
    for element in header.elements.values() {
        payload.check_count(element)?;
        match element.name.as_str() {
            "vertex" => vertices.read(&mut payload, element, details.as_deref_mut())?,
            "face" => {
                let known = header.elements.get("vertex").map_or(0, |vertices| vertices.count);
                faces.read(&mut payload, element, known, details.as_deref_mut())?;
            }
            // Without properties it has no bytes, however many there are.
            _ if element.properties.is_empty() && header.encoding != Encoding::Ascii => {}
            _ => payload.for_each(element, |_, _: Skipped| Ok(()))?,
        }
    }
    let mut surface = Welder::default();
    for triangle in &faces.triangles {
        // All of them exist: this was checked against the header, and the header against the file.
        surface.triangle(triangle.map(|i| vertices.positions.get(i as usize).copied().unwrap_or_default()));
    }
    if let Some(details) = details {
        let material = material(path, &header, vertices.colors.is_some(), files, details);
        details.parts.push(PartDetails { material, facing: Facing::Corners(corners(&vertices, &faces)) });
    }
    Ok(Mesh { sub_meshes: vec![surface.finish()] })
}

/// The header and what lies behind it.
fn read_header<'a>(path: &'a Path, bytes: &'a [u8]) -> Result<(Header, Payload<'a>), MeshError> {
    if !bytes.starts_with(b"ply") {
        return Err(MeshError::malformed(path, Position::Byte(0), "not a PLY file: it must start with 'ply'"));
    }
    let mut length = 0;
    let mut lines = 0;
    let end = bytes.split_inclusive(|byte| *byte == b'\n').find(|line| {
        length += line.len();
        lines += 1;
        line.trim_ascii() == b"end_header" || length > MAX_HEADER_BYTES
    });
    if end.is_none() || length > MAX_HEADER_BYTES {
        let message = format!("no line 'end_header' in the first {MAX_HEADER_BYTES} bytes");
        return Err(MeshError::malformed(path, Position::Line(lines), message));
    }
    // Comments are in any encoding.
    let text = String::from_utf8_lossy(&bytes[..length]);
    let header = Parser::<Skipped>::new().read_header(&mut Reader::new(text.as_bytes())).map_err(|error| {
        // The library's message quotes the line at any length.
        let line = error.line().unwrap_or(0);
        match text.lines().nth(line.wrapping_sub(1)) {
            Some(content) => {
                let message = format!("not a line of a PLY header: {}", quoted(content));
                MeshError::malformed(path, Position::Line(line as u32), message)
            }
            None => MeshError::malformed(path, Position::Line(1), printable(&error.to_string(), 100)),
        }
    })?;
    let encoding = header.encoding;
    Ok((header, Payload { path, bytes, at: length, line: lines + 1, encoding }))
}

/// Checks that the header describes a surface.
fn check_elements(header: &Header, payload: &Payload) -> Result<(), MeshError> {
    let malformed =
        |message: String| Err(MeshError::malformed(payload.path, Position::Line(payload.line - 1), message));
    let count = |name: &str| header.elements.get(name).map_or(0, |element| element.count);
    let Some(vertices) = header.elements.get("vertex") else {
        return malformed("the header describes no element 'vertex'".to_owned());
    };
    for name in ["x", "y", "z"] {
        if !has_scalar(vertices, &[name]) {
            return malformed(format!("the header describes no number '{name}' of element 'vertex'"));
        }
    }
    if vertices.count > 0 && count("face") == 0 {
        let message = match count("tristrips") {
            0 => {
                "the file has points and no faces: a point cloud neither collides nor is it drawn as a mesh; \
                 make a surface of it first"
            }
            _ => "the file has triangle strips instead of faces; export it with faces",
        };
        return malformed(message.to_owned());
    }
    let Some(faces) = header.elements.get("face").filter(|faces| faces.count > 0) else { return Ok(()) };
    let is_list_of_integers = |name: &&str| {
        use ScalarType::{Double, Float};
        let list = faces.properties.get(*name).map(|property| &property.data_type);
        matches!(list, Some(PropertyType::List(_, inner)) if !matches!(inner, Float | Double))
    };
    if !CORNERS.iter().any(is_list_of_integers) {
        return malformed("the header describes no list of integers 'vertex_indices' of element 'face'".to_owned());
    }
    Ok(())
}

/// Whether the element has a number of one of these names.
fn has_scalar(element: &ElementDef, names: &[&str]) -> bool {
    let is_scalar =
        |name: &&str| element.properties.get(*name).is_some_and(|p| matches!(p.data_type, PropertyType::Scalar(_)));
    names.iter().any(is_scalar)
}

/// Fewest bytes of an element.
fn least_bytes(element: &ElementDef, encoding: Encoding) -> usize {
    let size = |scalar: &ScalarType| match scalar {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    };
    let sizes = element.properties.values().map(|property| match &property.data_type {
        PropertyType::Scalar(scalar) => size(scalar),
        // The number of entries; there may be none.
        PropertyType::List(count, _) => size(count),
    });
    match encoding {
        // A digit for each, and an end of line even without any.
        Encoding::Ascii => element.properties.len().max(1),
        Encoding::BinaryBigEndian | Encoding::BinaryLittleEndian => sizes.sum(),
    }
}

/// What lies behind the header, read from front to back.
struct Payload<'a> {
    path: &'a Path,
    /// The whole file.
    bytes: &'a [u8],
    at: usize,
    /// Line at `at`, from 1; counts in ASCII files only.
    line: u32,
    encoding: Encoding,
}

impl<'a> Payload<'a> {
    fn position(&self) -> Position {
        match self.encoding {
            Encoding::Ascii => Position::Line(self.line),
            Encoding::BinaryBigEndian | Encoding::BinaryLittleEndian => Position::Byte(self.at),
        }
    }

    fn malformed(&self, message: impl Into<String>) -> MeshError {
        MeshError::malformed(self.path, self.position(), message)
    }

    fn rest(&self) -> &'a [u8] {
        self.bytes.get(self.at..).unwrap_or_default()
    }

    /// Checks that the file is long enough for as many elements as the header announces.
    fn check_count(&self, element: &ElementDef) -> Result<(), MeshError> {
        let least = least_bytes(element, self.encoding);
        if element.count.checked_mul(least).is_none_or(|least| least > self.rest().len()) {
            let (count, name, left) = (element.count, quoted(&element.name), self.rest().len());
            return Err(self.malformed(format!(
                "truncated: the header announces {count} elements {name}, for which {left} bytes are left"
            )));
        }
        Ok(())
    }

    /// Reads all of an element, and calls `visit` with the place of each one and its content.
    fn for_each<E: PropertyAccess>(
        &mut self,
        element: &ElementDef,
        mut visit: impl FnMut(Position, E) -> Result<(), MeshError>,
    ) -> Result<(), MeshError> {
        let parser = Parser::new();
        for number in 0..element.count {
            let at = self.position();
            let read = match self.encoding {
                Encoding::Ascii => self.read_line(&parser, element, number)?,
                Encoding::BinaryBigEndian | Encoding::BinaryLittleEndian => {
                    self.read_binary(&parser, element, number)?
                }
            };
            visit(at, read)?;
        }
        Ok(())
    }

    fn truncated(&self, element: &ElementDef, number: usize) -> MeshError {
        let (count, name) = (element.count, quoted(&element.name));
        self.malformed(format!("truncated: the header announces {count} elements {name}, the file holds {number}"))
    }

    fn read_line<E: PropertyAccess>(
        &mut self,
        parser: &Parser<E>,
        element: &ElementDef,
        number: usize,
    ) -> Result<E, MeshError> {
        let line = self.rest().split_inclusive(|byte| *byte == b'\n').next().unwrap_or_default();
        if line.is_empty() {
            return Err(self.truncated(element, number));
        }
        let read = std::str::from_utf8(line).ok().and_then(|text| parser.read_ascii_element(text, element).ok());
        let Some(read) = read else {
            let (name, line) = (quoted(&element.name), String::from_utf8_lossy(line));
            let expected = format!("expected the numbers that the header describes for element {name}");
            return Err(self.malformed(format!("{expected}, got {}", quoted(line.trim_end()))));
        };
        self.at += line.len();
        self.line = self.line.saturating_add(1);
        Ok(read)
    }

    fn read_binary<E: PropertyAccess>(
        &mut self,
        parser: &Parser<E>,
        element: &ElementDef,
        number: usize,
    ) -> Result<E, MeshError> {
        let mut rest = self.rest();
        let read = match self.encoding {
            Encoding::BinaryBigEndian => parser.read_big_endian_element(&mut rest, element),
            _ => parser.read_little_endian_element(&mut rest, element),
        };
        match read {
            Ok(read) => {
                self.at = self.bytes.len() - rest.len();
                Ok(read)
            }
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => Err(self.truncated(element, number)),
            Err(error) => {
                let message = error.to_string();
                let first = message.lines().next().unwrap_or_default();
                Err(self.malformed(format!("element {} {number}: {}", quoted(&element.name), printable(first, 100))))
            }
        }
    }
}

/// An element that is not used.
struct Skipped;

impl PropertyAccess for Skipped {
    fn new() -> Self {
        Self
    }
}

const NORMAL: [&str; 3] = ["nx", "ny", "nz"];
/// Names of u, then of v.
const TEX_COORD: [[&str; 3]; 2] = [["s", "u", "texture_u"], ["t", "v", "texture_v"]];
const COLOR: [&str; 3] = ["red", "green", "blue"];
/// Names of the list of a face's vertices.
const CORNERS: [&str; 2] = ["vertex_indices", "vertex_index"];

/// A vertex as the library reads it. What the header does not describe keeps these values.
struct Vertex {
    position: [f64; 3],
    normal: [f64; 3],
    tex_coord: [f64; 2],
    /// Red, green, blue, alpha.
    color: [f64; 4],
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self { position: [0.0; 3], normal: [0.0; 3], tex_coord: [0.0; 2], color: [1.0; 4] }
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let Some((number, most)) = number(&property) else { return PropertyAccessResult::Ignored };
        let (slot, number) = match name {
            "x" => (&mut self.position[0], number),
            "y" => (&mut self.position[1], number),
            "z" => (&mut self.position[2], number),
            "nx" => (&mut self.normal[0], number),
            "ny" => (&mut self.normal[1], number),
            "nz" => (&mut self.normal[2], number),
            "s" | "u" | "texture_u" => (&mut self.tex_coord[0], number),
            "t" | "v" | "texture_v" => (&mut self.tex_coord[1], number),
            "red" => (&mut self.color[0], number / most),
            "green" => (&mut self.color[1], number / most),
            "blue" => (&mut self.color[2], number / most),
            "alpha" => (&mut self.color[3], number / most),
            _ => return PropertyAccessResult::Ignored,
        };
        *slot = number;
        PropertyAccessResult::Set
    }
}

/// The number of a property that is no list, and what number of its type stands for full colour.
fn number(property: &Property) -> Option<(f64, f64)> {
    Some(match property {
        Property::Char(x) => (f64::from(*x), 127.0),
        Property::UChar(x) => (f64::from(*x), 255.0),
        Property::Short(x) => (f64::from(*x), 32767.0),
        Property::UShort(x) => (f64::from(*x), 65535.0),
        // Some programs write 0 to 255 with a type of 32 bits.
        Property::Int(x) => (f64::from(*x), 255.0),
        Property::UInt(x) => (f64::from(*x), 255.0),
        Property::Float(x) => (f64::from(*x), 1.0),
        Property::Double(x) => (*x, 1.0),
        _ => return None,
    })
}

/// Numbers of a list of integers; empty for any other property.
fn integers(property: Property) -> Vec<i64> {
    fn widened<T: Into<i64>>(list: Vec<T>) -> Vec<i64> {
        list.into_iter().map(Into::into).collect()
    }
    match property {
        Property::ListChar(list) => widened(list),
        Property::ListUChar(list) => widened(list),
        Property::ListShort(list) => widened(list),
        Property::ListUShort(list) => widened(list),
        Property::ListInt(list) => widened(list),
        Property::ListUInt(list) => widened(list),
        _ => Vec::new(),
    }
}

/// A face as the library reads it.
struct Face {
    corners: Vec<i64>,
    /// u and v of each corner, one behind the other; empty where there are none.
    tex_coords: Vec<f32>,
}

impl PropertyAccess for Face {
    fn new() -> Self {
        Self { corners: Vec::new(), tex_coords: Vec::new() }
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        match (name, property) {
            (name, property) if CORNERS.contains(&name) => self.corners = integers(property),
            ("texcoord", Property::ListFloat(list)) => self.tex_coords = list,
            ("texcoord", Property::ListDouble(list)) => {
                self.tex_coords = list.into_iter().map(|x| x as f32).collect();
            }
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}

/// All vertices.
#[derive(Default)]
struct Vertices {
    positions: Vec<[f64; 3]>,
    /// Where theirs start in [`Details::normals`], if there are some; so with the others.
    normals: Option<u32>,
    tex_coords: Option<u32>,
    colors: Option<u32>,
}

impl Vertices {
    fn read(
        &mut self,
        payload: &mut Payload,
        element: &ElementDef,
        mut details: Option<&mut Details>,
    ) -> Result<(), MeshError> {
        let path = payload.path;
        if let Some(details) = &details {
            let has = |names: &[&str]| has_scalar(element, names);
            let has_normals = NORMAL.iter().all(|name| has(&[name]));
            self.normals = has_normals.then_some(details.normals.len() as u32);
            let has_tex_coords = TEX_COORD.iter().all(|names| has(names));
            self.tex_coords = has_tex_coords.then_some(details.tex_coords.len() as u32);
            self.colors = COLOR.iter().all(|name| has(&[name])).then_some(details.colors.len() as u32);
        }
        // Of normals, texture coordinates and colours.
        let mut odd = [0usize; 3];
        payload.for_each(element, |_, vertex: Vertex| {
            self.positions.push(check_finite(path, self.positions.len(), vertex.position)?);
            let Some(details) = &mut details else { return Ok(()) };
            if self.normals.is_some() {
                let normal = finite(vertex.normal.map(|x| x as f32));
                odd[0] += usize::from(normal.is_none());
                details.normals.push(normal.unwrap_or_default());
            }
            if self.tex_coords.is_some() {
                let tex_coord = finite(vertex.tex_coord.map(|x| x as f32));
                odd[1] += usize::from(tex_coord.is_none());
                details.tex_coords.push(tex_coord.unwrap_or_default());
            }
            if self.colors.is_some() {
                let color = finite(vertex.color.map(|x| x as f32));
                odd[2] += usize::from(color.is_none());
                details.colors.push(color.unwrap_or([1.0; 4]).map(|x| x.clamp(0.0, 1.0)));
            }
            Ok(())
        })?;
        if let Some(details) = details {
            let consequences = [
                "normals are not finite; they are computed",
                "texture coordinates are not finite; 0 is used",
                "colours are not finite; white is used",
            ];
            for (odd, consequence) in odd.into_iter().zip(consequences) {
                if odd > 0 {
                    details.warnings.add_general(path, format!("{odd} {consequence}"));
                }
            }
        }
        Ok(())
    }
}

fn finite<const N: usize>(numbers: [f32; N]) -> Option<[f32; N]> {
    numbers.iter().all(|x| x.is_finite()).then_some(numbers)
}

/// The triangles of all faces.
#[derive(Default)]
struct Faces {
    /// Numbers of vertices.
    triangles: Vec<[u32; 3]>,
    /// For each triangle, if faces have texture coordinates: index of each corner in [`Details::tex_coords`], or
    /// [`ABSENT`].
    tex_coords: Vec<[u32; 3]>,
}

impl Faces {
    /// Reads all faces; polygons become fans around their first corner. `known` vertices exist.
    fn read(
        &mut self,
        payload: &mut Payload,
        element: &ElementDef,
        known: usize,
        mut details: Option<&mut Details>,
    ) -> Result<(), MeshError> {
        let path = payload.path;
        let has_tex_coords = matches!(
            element.properties.get("texcoord").map(|property| &property.data_type),
            Some(PropertyType::List(_, ScalarType::Float | ScalarType::Double))
        );
        let mut odd = 0usize;
        let mut number = 0usize;
        payload.for_each(element, |at, face: Face| {
            let corners = face.corners.iter().map(|&corner| match usize::try_from(corner) {
                Ok(index) if index < known => Ok(index as u32),
                _ => {
                    let message = format!("face {number} names vertex {corner}, the file has {known}");
                    Err(MeshError::malformed(path, at, message))
                }
            });
            let corners: Vec<u32> = corners.collect::<Result<_, _>>()?;
            number += 1;
            let Some((&first, others)) = corners.split_first().filter(|(_, others)| others.len() >= 2) else {
                return Ok(());
            };
            self.triangles.extend(others.windows(2).map(|pair| [first, pair[0], pair[1]]));
            let Some(details) = &mut details else { return Ok(()) };
            if self.triangles.len() > MAX_TRIANGLES {
                return Err(MeshError::TooManyTriangles { path: path.to_path_buf(), limit: MAX_TRIANGLES });
            }
            if has_tex_coords {
                let pairs = face.tex_coords.as_chunks::<2>().0;
                let mut indices = Vec::with_capacity(corners.len());
                for corner in 0..corners.len() {
                    indices.push(match pairs.get(corner).copied().and_then(finite) {
                        Some(tex_coord) => {
                            details.tex_coords.push(tex_coord);
                            details.tex_coords.len() as u32 - 1
                        }
                        None => ABSENT,
                    });
                }
                // A face without a texture has an empty list.
                odd += usize::from(!pairs.is_empty() && indices.contains(&ABSENT));
                self.tex_coords.extend(indices[1..].windows(2).map(|pair| [indices[0], pair[0], pair[1]]));
            }
            Ok(())
        })?;
        if let (Some(details), true) = (details, odd > 0) {
            let message = format!("{odd} faces do not have finite texture coordinates for all corners; 0 is used");
            details.warnings.add_general(path, message);
        }
        Ok(())
    }
}

/// The corners of all triangles.
fn corners(vertices: &Vertices, faces: &Faces) -> Vec<Corner> {
    let mut corners = Vec::with_capacity(3 * faces.triangles.len());
    for (i, triangle) in faces.triangles.iter().enumerate() {
        for (k, &vertex) in triangle.iter().enumerate() {
            let of_vertex = |first: Option<u32>| first.map_or(ABSENT, |first| first + vertex);
            // Those of the face come first: it may tear the texture where vertices are shared.
            let of_face = faces.tex_coords.get(i).map(|indices| indices[k]).filter(|index| *index != ABSENT);
            corners.push(Corner {
                shared: vertex,
                tex_coord: of_face.unwrap_or_else(|| of_vertex(vertices.tex_coords)),
                normal: of_vertex(vertices.normals),
                color: of_vertex(vertices.colors),
            });
        }
    }
    corners
}

/// The default, or white where the vertices or a texture have the colour.
fn material(path: &Path, header: &Header, has_colors: bool, files: &Files, details: &mut Details) -> MeshMaterial {
    let mut material = MeshMaterial::default();
    // MeshLab's way to name textures.
    let names = header.comments.iter().filter_map(|comment| comment.strip_prefix("TextureFile"));
    let mut names = names.filter(|name| name.starts_with([' ', '\t'])).map(str::trim);
    if let Some(name) = names.next() {
        match find_texture(path, path, name, files) {
            Ok(texture) => material.diffuse_map = Some(texture),
            Err(message) => details.warnings.add_general(path, message),
        }
        let others = names.count();
        if others > 0 {
            let message = format!("{others} more textures are not drawn: all faces have the first one");
            details.warnings.add_general(path, message);
        }
    }
    if has_colors || material.diffuse_map.is_some() {
        material.diffuse = [1.0; 3];
        material.ambient = [0.5; 3];
    }
    material
}

#[cfg(test)]
mod tests;
