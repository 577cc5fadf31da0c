//! Wavefront OBJ: positions, faces, lines, materials; normals and texture coordinates for what is drawn.
//!
//! Read here rather than by a library: `tobj` takes a polyline `l a b c` for a triangle, panics on a short colour in
//! the material file, and names no line.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::Path;

use super::material::{read_library, LibraryFile, MeshMaterial, Warnings};
use super::visual::{Corner, Details, Facing, PartDetails, ABSENT, MAX_TRIANGLES};
use super::{check_finite, quoted, Files, Mesh, MeshError, Position, Welder, MAX_SUB_MESHES};

/// A face or polyline: its corners are `corners[start..]` up to the start of the next one.
struct Element {
    start: usize,
    material: usize,
    /// Number of the object, group and material that it belongs to, by their names.
    part: u32,
    line: u32,
    is_face: bool,
}

/// What a file says, before it is split into sub-meshes.
#[derive(Default)]
struct Contents {
    positions: Vec<[f64; 3]>,
    /// Vertex numbers from 0, of all elements; may point past `positions`.
    corners: Vec<usize>,
    elements: Vec<Element>,
    materials: Vec<(String, MeshMaterial)>,
    objects: Vec<String>,
    /// Texture coordinate and normal of each of `corners`, if wanted: indices into `details`, or [`ABSENT`].
    looks: Option<Vec<[u32; 2]>>,
}

/// `files` has the material libraries that the file names.
pub(super) fn read(
    path: &Path,
    bytes: Vec<u8>,
    files: &Files,
    mut details: Option<&mut Details>,
) -> Result<Mesh, MeshError> {
    let contents = parse(path, &String::from_utf8_lossy(&bytes), files, details.as_deref_mut())?;
    let name = |i: usize| match contents.materials.is_empty() {
        true => contents.objects.get(i).map_or("", |name| name),
        false => contents.materials.get(i).map_or("", |(name, _)| name),
    };
    let count = contents.materials.len().max(contents.objects.len()).max(1);
    let mut parts: Vec<Part> = (0..count).map(|i| Part::named(name(i))).collect();

    // Lines come after all faces, so that the vertices that only lines use come last.
    contents.for_each(path, true, |element, corners| {
        parts[element.material].add_face(corners, element.part, &contents.positions);
    })?;
    if let Some(details) = details {
        contents.describe(path, count, details)?;
    }
    if contents.elements.iter().all(|e| !e.is_face) {
        // A bare list of vertices can still serve as a point cloud.
        for number in 0..contents.positions.len() {
            parts[0].vertex(number, &contents.positions);
        }
    }
    parts.iter_mut().for_each(|p| p.welder.end_surface());
    contents.for_each(path, false, |element, corners| {
        parts[element.material].add_polyline(corners, &contents.positions);
    })?;
    Ok(Mesh { sub_meshes: parts.into_iter().map(Part::finish).collect() })
}

/// A sub-mesh under construction.
struct Part {
    welder: Welder,
    file_vertices: BTreeMap<u32, u32>,
}

impl Part {
    fn named(name: &str) -> Self {
        Part { welder: Welder::named(name), file_vertices: BTreeMap::new() }
    }

    fn vertex(&mut self, number: usize, positions: &[[f64; 3]]) -> u32 {
        let index = self.welder.vertex(positions[number]);
        self.file_vertices.insert(number as u32, index);
        index
    }

    /// Splits a polygon into a fan around its first corner.
    fn add_face(&mut self, corners: &[usize], part: u32, positions: &[[f64; 3]]) {
        if corners.len() < 3 {
            return;
        }
        let fan: Vec<u32> = corners.iter().map(|&c| self.vertex(c, positions)).collect();
        let triangles = fan[1..].windows(2).map(|pair| [fan[0], pair[0], pair[1]]);
        self.welder.sub_mesh.triangles.extend(triangles);
        self.welder.sub_mesh.parts.resize(self.welder.sub_mesh.triangles.len(), part);
    }

    fn add_polyline(&mut self, corners: &[usize], positions: &[[f64; 3]]) {
        let ends: Vec<u32> = corners.iter().map(|&c| self.vertex(c, positions)).collect();
        self.welder.sub_mesh.lines.extend(ends.windows(2).map(|pair| [pair[0], pair[1]]));
    }

    fn finish(self) -> super::SubMesh {
        let mut sub_mesh = self.welder.sub_mesh;
        if sub_mesh.parts.windows(2).all(|pair| pair[0] == pair[1]) {
            sub_mesh.parts = Vec::new();
        }
        sub_mesh.file_vertices = self.file_vertices.into_iter().collect();
        sub_mesh
    }
}

impl Contents {
    /// Calls `visit` with every face, or every polyline, and its corners, in file order.
    fn for_each(&self, path: &Path, faces: bool, mut visit: impl FnMut(&Element, &[usize])) -> Result<(), MeshError> {
        let ends = self.elements.iter().skip(1).map(|e| e.start).chain([self.corners.len()]);
        for (element, end) in self.elements.iter().zip(ends).filter(|(e, _)| e.is_face == faces) {
            let corners = &self.corners[element.start..end];
            if let Some(number) = corners.iter().find(|&&c| c >= self.positions.len()) {
                let message = format!(
                    "vertex {} does not exist: the file has {}",
                    number.saturating_add(1),
                    self.positions.len()
                );
                return Err(MeshError::malformed(path, Position::Line(element.line), message));
            }
            visit(element, corners);
        }
        Ok(())
    }

    /// Adds how each of the `count` sub-meshes looks, with the corners of its triangles in the order of
    /// [`Part::add_face`].
    fn describe(&self, path: &Path, count: usize, details: &mut Details) -> Result<(), MeshError> {
        let mut triangles = 0;
        self.for_each(path, true, |_, corners| triangles += corners.len().saturating_sub(2))?;
        if triangles > MAX_TRIANGLES {
            return Err(MeshError::TooManyTriangles { path: path.to_path_buf(), limit: MAX_TRIANGLES });
        }
        let material = |i: usize| self.materials.get(i).map(|(_, material)| material.clone()).unwrap_or_default();
        let mut parts: Vec<PartDetails> =
            (0..count).map(|i| PartDetails { material: material(i), facing: Facing::Corners(Vec::new()) }).collect();
        let looks = self.looks.as_deref().unwrap_or(&[]);
        let Details { warnings, tex_coords, normals, .. } = details;
        self.for_each(path, true, |element, corners| {
            if corners.len() < 3 {
                return;
            }
            let mut is_known = true;
            let mut known = |index: u32, count: usize| {
                let known = index == ABSENT || (index as usize) < count;
                is_known &= known;
                if known {
                    index
                } else {
                    ABSENT
                }
            };
            let described: Vec<Corner> = corners
                .iter()
                .zip(&looks[element.start..])
                .map(|(&number, &[tex_coord, normal])| Corner {
                    shared: number as u32,
                    tex_coord: known(tex_coord, tex_coords.len()),
                    normal: known(normal, normals.len()),
                    color: ABSENT,
                })
                .collect();
            if !is_known {
                let message =
                    "a texture coordinate or normal of this face does not exist; the face is drawn without it";
                warnings.add(path, Position::Line(element.line), message);
            }
            if let Facing::Corners(all) = &mut parts[element.material].facing {
                all.extend(described[1..].windows(2).flat_map(|pair| [described[0], pair[0], pair[1]]));
            }
        })?;
        details.parts = parts;
        Ok(())
    }
}

fn parse(path: &Path, text: &str, files: &Files, mut details: Option<&mut Details>) -> Result<Contents, MeshError> {
    let mut contents = Contents { looks: details.is_some().then(Vec::new), ..Contents::default() };
    // The first of a name counts.
    let mut material_indices = HashMap::new();
    // Each is read once.
    let mut libraries: HashMap<String, Vec<(String, MeshMaterial)>> = HashMap::new();
    // Named once.
    let mut unknown_materials = HashSet::new();
    let mut material = 0;
    // Object, group and material as they are called, and their number.
    let (mut names, mut part) = ([const { String::new() }; 3], 0);
    let mut part_numbers = HashMap::from([(names.clone(), part)]);
    let mut continued = String::new();
    for (line, content) in (1..).zip(text.lines()) {
        // A backslash at the end joins a line with the next.
        if let Some(begin) = content.trim_end().strip_suffix('\\') {
            continued.push_str(begin);
            continued.push(' ');
            continue;
        }
        let joined = std::mem::take(&mut continued) + content;
        let content = joined.trim();
        let (keyword, rest) = content.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((content, ""));
        let rest = rest.trim();
        if let Some(kind) = ["o", "g", "usemtl"].iter().position(|known| *known == keyword) {
            rest.clone_into(&mut names[kind]);
            let next = part_numbers.len() as u32;
            part = *part_numbers.entry(names.clone()).or_insert(next);
        }
        match keyword {
            "v" => {
                let position = parse_position(rest)
                    .map_err(|message| MeshError::malformed(path, Position::Line(line), message))?;
                contents.positions.push(check_finite(path, contents.positions.len(), position)?);
            }
            "f" | "l" => {
                let start = contents.corners.len();
                let known = contents.positions.len();
                for word in rest.split_ascii_whitespace() {
                    let corner = parse_corner(word, known).ok_or_else(|| {
                        let message = format!("expected a vertex number such as 3, -1 or 3/1/2, got {}", quoted(word));
                        MeshError::malformed(path, Position::Line(line), message)
                    })?;
                    contents.corners.push(corner);
                    if let (Some(looks), Some(details)) = (&mut contents.looks, &mut details) {
                        let known = [details.tex_coords.len(), details.normals.len()];
                        looks.push(parse_looks(word, known).unwrap_or_else(|| {
                            let message = format!("expected a corner such as 3/1/2, got {}", quoted(word));
                            details.warnings.add(path, Position::Line(line), message);
                            [ABSENT; 2]
                        }));
                        // A face of n corners makes n - 2 triangles.
                        if looks.len() > 3 * MAX_TRIANGLES {
                            return Err(MeshError::TooManyTriangles { path: path.to_path_buf(), limit: MAX_TRIANGLES });
                        }
                    }
                }
                contents.elements.push(Element { start, material, part, line, is_face: keyword == "f" });
            }
            "vt" => {
                if let Some(details) = &mut details {
                    let at = Position::Line(line);
                    details.tex_coords.push(parse_numbers(rest, 1, path, at, &mut details.warnings));
                }
            }
            "vn" => {
                if let Some(details) = &mut details {
                    let at = Position::Line(line);
                    // A normal of zeros is none: one is computed.
                    details.normals.push(parse_numbers(rest, 3, path, at, &mut details.warnings));
                }
            }
            "o" => contents.objects.push(rest.to_owned()),
            "mtllib" => {
                let known = match libraries.entry(rest.to_owned()) {
                    Entry::Occupied(known) => known.into_mut(),
                    Entry::Vacant(slot) => {
                        let at = Position::Line(line);
                        let warnings = details.as_deref_mut().map(|details| &mut details.warnings);
                        slot.insert(materials(path, rest, files, at, warnings)?)
                    }
                };
                for (name, looks) in known.iter() {
                    material_indices.entry(name.clone()).or_insert(contents.materials.len());
                    contents.materials.push((name.clone(), looks.clone()));
                }
            }
            // An unknown name leaves the material as it is, as the C++ program does.
            "usemtl" => match (material_indices.get(rest), &mut details) {
                (Some(known), _) => material = *known,
                // Without any library the message about that is enough.
                (None, Some(details)) if !material_indices.is_empty() && unknown_materials.insert(rest.to_owned()) => {
                    let message = format!("material {} is not in the library; the one before stays", quoted(rest));
                    details.warnings.add(path, Position::Line(line), message);
                }
                // Said once for the file.
                (None, Some(details)) if libraries.is_empty() && unknown_materials.is_empty() => {
                    unknown_materials.insert(rest.to_owned());
                    let message = format!(
                        "material {} is asked for, but no line `mtllib FILE` before names a library; faces of all materials \
                         are one part, which as a convex hull has no holes",
                        quoted(rest)
                    );
                    details.warnings.add(path, Position::Line(line), message);
                }
                _ => {}
            },
            _ => {}
        }
        if contents.objects.len().max(contents.materials.len()) > MAX_SUB_MESHES {
            let message = format!("more than {MAX_SUB_MESHES} objects or materials");
            return Err(MeshError::malformed(path, Position::Line(line), message));
        }
    }
    Ok(contents)
}

fn parse_position(rest: &str) -> Result<[f64; 3], String> {
    let mut words = rest.split_ascii_whitespace();
    let mut position = [0.0; 3];
    for x in &mut position {
        let word = words.next().unwrap_or("");
        *x = word.parse().map_err(|_| format!("expected three numbers after 'v', got {}", quoted(word)))?;
    }
    Ok(position)
}

/// Vertex number from 0 of a corner `v`, `v/vt`, `v//vn` or `v/vt/vn`; negative ones count back from the `known`
/// vertices.
fn parse_corner(word: &str, known: usize) -> Option<usize> {
    let number: i64 = word.split('/').next()?.parse().ok()?;
    match number {
        0 => None,
        1.. => usize::try_from(number - 1).ok(),
        _ => usize::try_from(known as i64 + number).ok(),
    }
}

/// Texture coordinate and normal of a corner `v`, `v/vt`, `v//vn` or `v/vt/vn` as numbers from 0; negative ones count
/// back from the `known` ones.
fn parse_looks(word: &str, known: [usize; 2]) -> Option<[u32; 2]> {
    let mut looks = [ABSENT; 2];
    let mut fields = word.split('/').skip(1);
    for (look, known) in looks.iter_mut().zip(known) {
        let Some(field) = fields.next().filter(|field| !field.is_empty()) else { continue };
        let number = parse_corner(field, known)?;
        *look = u32::try_from(number).ok().filter(|number| *number != ABSENT)?;
    }
    Some(looks)
}

/// The first N numbers of a line; at least `least` must be there, the rest is 0. All are 0 if one is no finite number.
fn parse_numbers<const N: usize>(
    rest: &str,
    least: usize,
    path: &Path,
    at: Position,
    warnings: &mut Warnings,
) -> [f32; N] {
    let mut numbers = [0.0; N];
    let mut words = rest.split_ascii_whitespace();
    for (i, number) in numbers.iter_mut().enumerate() {
        let word = match words.next() {
            None if i >= least => break,
            word => word.unwrap_or(""),
        };
        match word.parse::<f32>() {
            Ok(x) if x.is_finite() => *number = x,
            _ => {
                warnings.add(path, at, format!("expected a finite number, got {}; 0 is used", quoted(word)));
                return [0.0; N];
            }
        }
    }
    numbers
}

/// The materials in the library `name` beside the mesh `path`; none when there is no such file. How they look is only
/// read where `warnings` can be given.
fn materials(
    path: &Path,
    name: &str,
    files: &Files,
    at: Position,
    warnings: Option<&mut Warnings>,
) -> Result<Vec<(String, MeshMaterial)>, MeshError> {
    let library = path.with_file_name(name);
    let bytes = match (files.open)(&library) {
        Err(MeshError::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
            if let Some(warnings) = warnings {
                let message = format!("material library {} is not there; the default material is drawn", quoted(name));
                warnings.add(path, at, message);
            }
            return Ok(Vec::new());
        }
        other => other?,
    };
    let file = LibraryFile { mesh: path, library: &library, files };
    Ok(read_library(&String::from_utf8_lossy(&bytes), &file, warnings))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse_text(text: &str) -> Result<Mesh, MeshError> {
        crate::mesh::parse(text.into(), Path::new("t.obj"))
    }

    const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

    #[test]
    fn polygons_become_fans_in_order_of_use() {
        let mesh = parse_text(&format!("{SQUARE}vt 0 0\nvn 0 0 1\nf 2/1/1 3//1 \\\n 4 -4\n")).unwrap();
        let sub = &mesh.sub_meshes[0];
        assert_eq!(sub.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(sub.vertices[0], [1.0, 0.0, 0.0]);
        assert_eq!(sub.file_vertices, [(0, 3), (1, 0), (2, 1), (3, 2)]);
    }

    #[test]
    fn text_is_read_as_f64_and_equal_vertices_are_welded() {
        let mesh = parse_text("v 0.1 0 0\nv 1 0 0 0.5 0.5 0.5\nv 0 1 0\nv 0.1 -0 0\nf 1 2 3\nf 4 3 2\n").unwrap();
        let sub = &mesh.sub_meshes[0];
        assert_eq!(sub.vertices[0][0], 0.1);
        assert_eq!(sub.triangles, [[0, 1, 2], [0, 2, 1]]);
        assert_eq!(sub.file_vertices, [(0, 0), (1, 1), (2, 2), (3, 0)]);
    }

    #[test]
    fn materials_split_the_mesh_and_lines_are_kept() {
        let dir = std::env::temp_dir().join(format!("ambf_obj_{}", std::process::id()));
        std::fs::create_dir_all(&dir).unwrap();
        std::fs::write(dir.join("two colours.mtl"), "newmtl red\nKd 1\nnewmtl deep blue\nnewmtl unused\n").unwrap();
        let text = format!(
            "mtllib two colours.mtl\no a\n{SQUARE}v 2 2 2\nusemtl deep blue\nl 1 5 2\nf 1 2 3\nusemtl red\nf 1 3 4\nusemtl none\nf 4 3 1\n"
        );
        std::fs::write(dir.join("t.OBJ"), text).unwrap();
        let mesh = crate::mesh::load(&dir.join("t.OBJ")).unwrap();
        std::fs::remove_dir_all(&dir).unwrap();
        let names: Vec<_> = mesh.sub_meshes.iter().map(|s| s.name.as_str()).collect();
        assert_eq!(names, ["red", "deep blue", "unused"]);
        assert_eq!(mesh.sub_meshes[0].triangles, [[0, 1, 2], [2, 1, 0]]);
        let blue = &mesh.sub_meshes[1];
        assert_eq!((blue.triangles.as_slice(), blue.surface_vertices), (&[[0, 1, 2]][..], 3));
        assert_eq!((blue.lines.as_slice(), blue.vertices[3]), (&[[0, 3], [3, 1]][..], [2.0; 3]));
        assert!(mesh.sub_meshes[2].vertices.is_empty());
    }

    #[test]
    fn more_objects_than_materials_leave_empty_parts() {
        let mesh = parse_text(&format!("mtllib missing.mtl\no first\n{SQUARE}f 1 2 3\no second\nf 1 3 4\n")).unwrap();
        assert_eq!(mesh.sub_meshes.len(), 2);
        assert_eq!(mesh.sub_meshes[0].triangles.len(), 2);
        assert_eq!(mesh.sub_meshes[1].name, "second");
        assert!(mesh.sub_meshes[1].vertices.is_empty());
    }

    #[test]
    fn bare_vertices_are_a_point_cloud() {
        let mesh = parse_text(SQUARE).unwrap();
        assert_eq!((mesh.vertex_count(), mesh.triangle_count()), (4, 0));
        assert_eq!(mesh.sub_meshes[0].surface_vertices, 4);
    }

    #[test]
    fn broken_files_are_refused_with_the_line() {
        for (text, expected) in [
            ("v 0 0\n", ":1: expected three numbers"),
            ("v 0 0 x\n", "got 'x'"),
            ("v 0 0 0\nv 0 nan 0\n", "vertex 1 is not finite"),
            ("v 0 0 0\n\nf 1 1 2\n", ":3: vertex 2 does not exist: the file has 1"),
            ("v 0 0 0\nf 1 0 1\n", ":2: expected a vertex number"),
            ("v 0 0 0\nf -2 1 1\n", ":2: expected a vertex number"),
            ("v 0 0 0\nl 1 9223372036854775807\n", ":2: vertex 9223372036854775807 does not exist"),
            ("f 1//9223372036854775807 2 99999999999999999999\n", ":1: expected a vertex number"),
        ] {
            let message = parse_text(text).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
