//! Autodesk 3DS: a tree of chunks, each with a 16-bit id and a 32-bit length that includes these six bytes.

use std::collections::HashMap;
use std::path::Path;

use super::material::{find_texture, MeshMaterial};
use super::visual::{Corner, Details, Facing, PartDetails, ABSENT};
use super::{check_finite, quoted, Files, Mesh, MeshError, Position, SubMesh, Welder, MAX_SUB_MESHES};

const MAIN: u16 = 0x4D4D;
const EDITOR: u16 = 0x3D3D;
const OBJECT: u16 = 0x4000;
const TRIMESH: u16 = 0x4100;
const VERTICES: u16 = 0x4110;
const FACES: u16 = 0x4120;
const FACE_MATERIAL: u16 = 0x4130;
const TEX_COORDS: u16 = 0x4140;
const SMOOTHING: u16 = 0x4150;

const MATERIAL: u16 = 0xAFFF;
const MATERIAL_NAME: u16 = 0xA000;
const AMBIENT: u16 = 0xA010;
const DIFFUSE: u16 = 0xA020;
const SPECULAR: u16 = 0xA030;
const SHININESS: u16 = 0xA040;
const TRANSPARENCY: u16 = 0xA050;
const DIFFUSE_MAP: u16 = 0xA200;
const SPECULAR_MAP: u16 = 0xA204;
const BUMP_MAP: u16 = 0xA230;
const MAP_NAME: u16 = 0xA300;

/// Three corners and a word of flags.
const FACE_BYTES: usize = 8;

pub(super) fn read(
    path: &Path,
    bytes: Vec<u8>,
    files: &Files,
    mut details: Option<&mut Details>,
) -> Result<Mesh, MeshError> {
    let mut file = Cursor { path, bytes: &bytes, at: 0, end: bytes.len() };
    let Some((MAIN, mut main)) = file.chunk()? else {
        return Err(MeshError::malformed(path, Position::Byte(0), "not a 3DS file: it must start with chunk 4D4D"));
    };
    let mut mesh = Mesh::default();
    let mut vertex_count = 0;
    // They may come behind the objects that use them.
    let mut materials: HashMap<String, MeshMaterial> = HashMap::new();
    let mut used_materials: Vec<Option<String>> = Vec::new();
    while let Some((id, mut editor)) = main.chunk()? {
        if id != EDITOR {
            continue;
        }
        while let Some((id, mut object)) = editor.chunk()? {
            if let (MATERIAL, Some(details)) = (id, &mut details) {
                read_material(object, files, details, &mut materials);
                continue;
            }
            if id != OBJECT {
                continue;
            }
            let name = object.text()?;
            while let Some((id, trimesh)) = object.chunk()? {
                if id == TRIMESH {
                    let at = trimesh.at;
                    let object = Object::read(trimesh, &mut vertex_count, details.as_deref_mut())?;
                    let (parts, materials) = object.split(&name, details.as_deref_mut());
                    mesh.sub_meshes.extend(parts);
                    used_materials.extend(materials);
                    if mesh.sub_meshes.len() > MAX_SUB_MESHES {
                        let message = format!("more than {MAX_SUB_MESHES} parts of one material");
                        return Err(MeshError::malformed(path, Position::Byte(at), message));
                    }
                }
            }
        }
    }
    if let Some(details) = details {
        for (part, used) in details.parts.iter_mut().zip(used_materials) {
            if let Some(material) = used.and_then(|name| materials.get(&name)) {
                part.material.clone_from(material);
            }
        }
    }
    Ok(mesh)
}

/// Adds the material of a chunk to `materials`. What cannot be read is named and keeps the default.
fn read_material(chunk: Cursor, files: &Files, details: &mut Details, materials: &mut HashMap<String, MeshMaterial>) {
    let (path, at) = (chunk.path, chunk.at);
    let mut material = MeshMaterial::default();
    let mut name = String::new();
    let mut textures = Vec::new();
    let outcome = material_keys(chunk, &mut name, &mut material, &mut textures);
    if let Err(MeshError::Malformed { at, message, .. }) = outcome {
        details.warnings.add(path, at, format!("{message}; the rest of material {} is not used", quoted(&name)));
    }
    for (kind, texture) in textures {
        let slot = match kind {
            DIFFUSE_MAP => &mut material.diffuse_map,
            SPECULAR_MAP => &mut material.specular_map,
            _ => &mut material.normal_map,
        };
        match find_texture(path, path, &texture, files) {
            Ok(file) => *slot = Some(file),
            Err(message) => details.warnings.add(path, Position::Byte(at), message),
        }
    }
    materials.entry(name).or_insert(material);
}

fn material_keys(
    mut chunk: Cursor,
    name: &mut String,
    material: &mut MeshMaterial,
    textures: &mut Vec<(u16, String)>,
) -> Result<(), MeshError> {
    while let Some((id, mut content)) = chunk.chunk()? {
        match id {
            MATERIAL_NAME => *name = content.text()?,
            AMBIENT => material.ambient = content.color()?.unwrap_or(material.ambient),
            DIFFUSE => material.diffuse = content.color()?.unwrap_or(material.diffuse),
            SPECULAR => material.specular = content.color()?.unwrap_or(material.specular),
            // In parts of the largest.
            SHININESS => material.shininess = content.fraction()?.map_or(material.shininess, |part| 128.0 * part),
            TRANSPARENCY => material.alpha = content.fraction()?.map_or(material.alpha, |part| 1.0 - part),
            DIFFUSE_MAP | SPECULAR_MAP | BUMP_MAP => {
                while let Some((inner, mut content)) = content.chunk()? {
                    if inner == MAP_NAME {
                        textures.push((id, content.text()?));
                    }
                }
            }
            _ => {}
        }
    }
    Ok(())
}

/// A part of the file that is read from front to back.
struct Cursor<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
    end: usize,
}

impl<'a> Cursor<'a> {
    fn malformed(&self, message: impl Into<String>) -> MeshError {
        MeshError::malformed(self.path, Position::Byte(self.at), message)
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], MeshError> {
        if count > self.end - self.at {
            return Err(self.malformed(format!("truncated: {count} bytes expected, {} left", self.end - self.at)));
        }
        self.at += count;
        Ok(&self.bytes[self.at - count..self.at])
    }

    fn word(&mut self) -> Result<u16, MeshError> {
        Ok(word_at(self.take(2)?, 0))
    }

    /// Text up to the next zero byte.
    fn text(&mut self) -> Result<String, MeshError> {
        let rest = &self.bytes[self.at..self.end];
        let length = rest.iter().position(|&b| b == 0).ok_or_else(|| self.malformed("name without an end"))?;
        self.at += length + 1;
        Ok(String::from_utf8_lossy(&rest[..length]).into_owned())
    }

    /// The next chunk's id and content, or `None` at the end.
    fn chunk(&mut self) -> Result<Option<(u16, Cursor<'a>)>, MeshError> {
        if self.at == self.end {
            return Ok(None);
        }
        let start = self.at;
        let id = self.word()?;
        let length = self.take(4)?;
        let length = u32::from_le_bytes([length[0], length[1], length[2], length[3]]) as usize;
        if length < 6 || length > self.end - start {
            self.at = start;
            let room = self.end - start;
            return Err(self.malformed(format!("chunk {id:04X} claims {length} bytes, {room} are there")));
        }
        self.at = start + length;
        Ok(Some((id, Cursor { at: start + 6, end: start + length, ..*self })))
    }
}

impl Cursor<'_> {
    fn float(&mut self) -> Result<f32, MeshError> {
        Ok(float_at(self.take(4)?, 0))
    }

    /// The first colour among the chunks of this one: three 32-bit numbers, or three bytes.
    fn color(&mut self) -> Result<Option<[f32; 3]>, MeshError> {
        while let Some((id, mut content)) = self.chunk()? {
            let color = match id {
                0x0010 | 0x0013 => [content.float()?, content.float()?, content.float()?],
                0x0011 | 0x0012 => {
                    let bytes = content.take(3)?;
                    [bytes[0], bytes[1], bytes[2]].map(|x| f32::from(x) / 255.0)
                }
                _ => continue,
            };
            if color.iter().any(|x| !x.is_finite()) {
                return Err(
                    self.malformed(format!("a colour of ({}, {}, {}), expected numbers", color[0], color[1], color[2]))
                );
            }
            return Ok(Some(color));
        }
        Ok(None)
    }

    /// The first percentage among the chunks of this one, 0 to 1.
    fn fraction(&mut self) -> Result<Option<f32>, MeshError> {
        while let Some((id, mut content)) = self.chunk()? {
            let fraction = match id {
                0x0030 => f32::from(content.word()? as i16) / 100.0,
                0x0031 => content.float()?,
                _ => continue,
            };
            if !fraction.is_finite() {
                return Err(self.malformed(format!("a percentage of {fraction}")));
            }
            return Ok(Some(fraction.clamp(0.0, 1.0)));
        }
        Ok(None)
    }
}

fn float_at(bytes: &[u8], at: usize) -> f32 {
    f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn word_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

/// One triangle mesh of the file.
#[derive(Default)]
struct Object {
    vertices: Vec<[f64; 3]>,
    faces: Vec<[u16; 3]>,
    materials: Vec<String>,
    /// Index into `materials` of every face, where it has one.
    face_materials: Vec<Option<usize>>,
    /// One for each vertex, or fewer; only where looks are wanted.
    tex_coords: Vec<[f32; 2]>,
    /// Smoothing groups of each face, a bit each; empty where there are none or looks are not wanted.
    smoothing: Vec<u32>,
}

impl Object {
    /// `vertex_count` numbers the vertices of the whole file, for messages.
    fn read(
        mut trimesh: Cursor,
        vertex_count: &mut usize,
        mut details: Option<&mut Details>,
    ) -> Result<Self, MeshError> {
        let mut object = Object::default();
        let whole = trimesh.at;
        while let Some((id, mut chunk)) = trimesh.chunk()? {
            match id {
                VERTICES => {
                    let count = usize::from(chunk.word()?);
                    for v in chunk.take(12 * count)?.chunks_exact(12) {
                        let x = |j: usize| f64::from(float_at(v, j));
                        object.vertices.push(check_finite(chunk.path, *vertex_count, [x(0), x(4), x(8)])?);
                        *vertex_count += 1;
                    }
                }
                FACES => object.read_faces(chunk, details.as_deref_mut())?,
                TEX_COORDS => {
                    if let Some(details) = &mut details {
                        object.read_tex_coords(chunk, details);
                    }
                }
                _ => {}
            }
        }
        let known = object.vertices.len();
        if let Some(index) = object.faces.iter().flatten().find(|&&i| usize::from(i) >= known) {
            trimesh.at = whole;
            return Err(trimesh.malformed(format!("a face names vertex {index}, the object has {known}")));
        }
        Ok(object)
    }

    fn read_tex_coords(&mut self, mut chunk: Cursor, details: &mut Details) {
        let path = chunk.path;
        let mut read = || {
            let count = usize::from(chunk.word()?);
            let tex_coords = chunk.take(8 * count)?.chunks_exact(8).map(|uv| [float_at(uv, 0), float_at(uv, 4)]);
            Ok(tex_coords.collect::<Vec<[f32; 2]>>())
        };
        match read() {
            Ok(mut tex_coords) => {
                let mut odd = 0;
                for uv in tex_coords.iter_mut().filter(|uv| !uv.iter().all(|x| x.is_finite())) {
                    *uv = [0.0; 2];
                    odd += 1;
                }
                if odd > 0 {
                    let message = format!("{odd} texture coordinates are not finite; 0 is used");
                    details.warnings.add(path, Position::Byte(chunk.at), message);
                }
                self.tex_coords = tex_coords;
            }
            Err(MeshError::Malformed { at, message, .. }) => {
                details.warnings.add(path, at, format!("{message}; texture coordinates are not used"));
            }
            Err(_) => {}
        }
    }

    fn read_faces(&mut self, mut chunk: Cursor, mut details: Option<&mut Details>) -> Result<(), MeshError> {
        let count = usize::from(chunk.word()?);
        let faces = chunk.take(FACE_BYTES * count)?.chunks_exact(FACE_BYTES);
        self.faces = faces.map(|f| [word_at(f, 0), word_at(f, 2), word_at(f, 4)]).collect();
        self.face_materials = vec![None; count];
        let mut material_indices: HashMap<String, usize> =
            self.materials.iter().enumerate().map(|(i, name)| (name.clone(), i)).collect();
        while let Some((id, mut group)) = chunk.chunk()? {
            if let (SMOOTHING, Some(details)) = (id, &mut details) {
                match group.take(4 * count) {
                    Ok(bytes) => self.smoothing = bytes.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect(),
                    Err(_) => details.warnings.add(
                        group.path,
                        Position::Byte(group.at),
                        format!("{count} smoothing groups do not fit here; all faces are smooth"),
                    ),
                }
            }
            if id != FACE_MATERIAL {
                continue;
            }
            let name = group.text()?;
            let material = *material_indices.entry(name).or_insert_with_key(|name| {
                self.materials.push(name.clone());
                self.materials.len() - 1
            });
            for _ in 0..group.word()? {
                let face = group.word()?;
                *self
                    .face_materials
                    .get_mut(usize::from(face))
                    .ok_or_else(|| group.malformed(format!("material on face {face}, the object has {count}")))? =
                    Some(material);
            }
        }
        Ok(())
    }

    /// One sub-mesh for each material in order of first use, faces without a material making one too; and the names of
    /// the materials.
    fn split(&self, name: &str, details: Option<&mut Details>) -> (Vec<SubMesh>, Vec<Option<String>>) {
        let mut parts: Vec<Welder> = Vec::new();
        let mut materials: Vec<Option<usize>> = Vec::new();
        let mut part_of = HashMap::new();
        let mut part_of_face = Vec::with_capacity(self.faces.len());
        for (face, &material) in self.faces.iter().zip(&self.face_materials) {
            let part = *part_of.entry(material).or_insert_with(|| {
                parts.push(Welder::named(material.map_or(name, |m| &self.materials[m])));
                materials.push(material);
                parts.len() - 1
            });
            parts[part].triangle(face.map(|i| self.vertices[usize::from(i)]));
            part_of_face.push(part);
        }
        if let Some(details) = details {
            let first = details.tex_coords.len() as u32;
            details.tex_coords.extend_from_slice(&self.tex_coords);
            let mut corners: Vec<Vec<Corner>> = vec![Vec::new(); parts.len()];
            for ((face, shared), part) in self.faces.iter().zip(self.shared_normals()).zip(part_of_face) {
                corners[part].extend(face.iter().zip(shared).map(|(&vertex, shared)| {
                    let has_tex_coord = usize::from(vertex) < self.tex_coords.len();
                    let tex_coord = if has_tex_coord { first + u32::from(vertex) } else { ABSENT };
                    Corner { shared, tex_coord, normal: ABSENT, color: ABSENT }
                }));
            }
            let described = |corners| PartDetails { facing: Facing::Corners(corners), ..PartDetails::default() };
            details.parts.extend(corners.into_iter().map(described));
        }
        let name = |material: Option<usize>| material.map(|m| self.materials[m].clone());
        (parts.into_iter().map(Welder::finish).collect(), materials.into_iter().map(name).collect())
    }

    /// For each corner of each face a number that those corners at its vertex share that are smoothed with it: whose
    /// faces have a smoothing group in common, directly or through others. Without groups in the file, all of the
    /// vertex.
    fn shared_normals(&self) -> Vec<[u32; 3]> {
        if self.smoothing.len() != self.faces.len() {
            return self.faces.iter().map(|face| face.map(u32::from)).collect();
        }
        // Sets of groups at each vertex that have none in common with each other: 32 at most.
        let mut sets: Vec<Vec<u32>> = vec![Vec::new(); self.vertices.len()];
        for (face, &groups) in self.faces.iter().zip(&self.smoothing).filter(|(_, groups)| **groups != 0) {
            for &vertex in face {
                let sets = &mut sets[usize::from(vertex)];
                let mut joined = groups;
                sets.retain(|set| {
                    let touches = set & groups != 0;
                    joined |= if touches { *set } else { 0 };
                    !touches
                });
                sets.push(joined);
            }
        }
        let mut next = 0;
        let firsts: Vec<u32> = sets
            .iter()
            .map(|sets| {
                next += sets.len() as u32;
                next - sets.len() as u32
            })
            .collect();
        let mut number = |vertex: u16, groups: u32| {
            let vertex = usize::from(vertex);
            match sets[vertex].iter().position(|set| set & groups != 0) {
                Some(set) => firsts[vertex] + set as u32,
                // Not smoothed with anything.
                None => {
                    next += 1;
                    next - 1
                }
            }
        };
        self.faces.iter().zip(&self.smoothing).map(|(face, &groups)| face.map(|v| number(v, groups))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{parse_visual, VisualMesh};

    fn chunk(id: u16, content: Vec<u8>) -> Vec<u8> {
        let mut bytes = id.to_le_bytes().to_vec();
        bytes.extend((content.len() as u32 + 6).to_le_bytes());
        bytes.extend(content);
        bytes
    }

    fn words(words: &[u16]) -> Vec<u8> {
        words.iter().flat_map(|w| w.to_le_bytes()).collect()
    }

    /// A square of two triangles, the second with material "red".
    fn square(corner: f32, last_index: u16) -> Vec<u8> {
        let mut vertices = words(&[4]);
        for x in [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, corner, 1.0, 0.0, 0.0, 1.0, 0.0f32] {
            vertices.extend(x.to_le_bytes());
        }
        let mut faces = words(&[2, 0, 1, 2, 0, 0, 2, last_index, 7]);
        faces.extend(chunk(FACE_MATERIAL, [b"red\0".to_vec(), words(&[1, 1])].concat()));
        let trimesh = [chunk(0x4160, vec![0; 48]), chunk(FACES, faces), chunk(VERTICES, vertices)].concat();
        let object = [b"plate\0".to_vec(), chunk(0x4600, vec![]), chunk(TRIMESH, trimesh)].concat();
        chunk(MAIN, [chunk(2, vec![3, 0, 0, 0]), chunk(EDITOR, chunk(OBJECT, object))].concat())
    }

    fn parse(bytes: Vec<u8>) -> Result<Mesh, MeshError> {
        crate::mesh::parse(bytes, Path::new("t.3ds"))
    }

    #[test]
    fn one_sub_mesh_a_material() {
        let mesh = parse(square(1.0, 3)).unwrap();
        let names: Vec<_> = mesh.sub_meshes.iter().map(|s| s.name.as_str()).collect();
        assert_eq!(names, ["plate", "red"]);
        assert_eq!(mesh.sub_meshes[0].vertices, [[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]);
        assert_eq!(mesh.sub_meshes[1].vertices, [[0.0; 3], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
    }

    fn floats(numbers: &[f32]) -> Vec<u8> {
        numbers.iter().flat_map(|x| x.to_le_bytes()).collect()
    }

    /// A roof of two faces over the edge from vertex 0 to 1, each face in the given smoothing groups, with a material.
    fn roof(groups: [u32; 2]) -> Vec<u8> {
        let vertices = [words(&[4]), floats(&[0.0, 0.0, 1.0, 0.0, 2.0, 1.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0])].concat();
        let tex_coords = [words(&[4]), floats(&[0.0, 0.0, 1.0, 0.0, 1.0, 0.5, f32::NAN, 2.0])].concat();
        let smoothing: Vec<u8> = groups.iter().flat_map(|g| g.to_le_bytes()).collect();
        let material = chunk(FACE_MATERIAL, [b"red\0".to_vec(), words(&[2, 0, 1])].concat());
        let faces = [words(&[2, 0, 2, 1, 0, 0, 1, 3, 0]), material, chunk(SMOOTHING, smoothing)].concat();
        let trimesh = [chunk(VERTICES, vertices), chunk(FACES, faces), chunk(TEX_COORDS, tex_coords)].concat();
        let object = chunk(OBJECT, [b"roof\0".to_vec(), chunk(TRIMESH, trimesh)].concat());
        let percent = |id, percent| chunk(id, chunk(0x0030, words(&[percent])));
        let map = |id, name: &[u8]| chunk(id, [chunk(0x0030, words(&[100])), chunk(MAP_NAME, name.to_vec())].concat());
        let material = [
            chunk(MATERIAL_NAME, b"red\0".to_vec()),
            chunk(AMBIENT, chunk(0x0011, vec![51, 0, 0])),
            chunk(DIFFUSE, chunk(0x0010, floats(&[1.0, 0.5, 0.25]))),
            percent(SHININESS, 50),
            percent(TRANSPARENCY, 75),
            map(DIFFUSE_MAP, b"WOOD.JPG\0"),
            map(BUMP_MAP, b"none.jpg\0"),
        ];
        chunk(MAIN, chunk(EDITOR, [object, chunk(MATERIAL, material.concat())].concat()))
    }

    fn looks(bytes: Vec<u8>, remove_duplicates: bool) -> (VisualMesh, Vec<String>) {
        let named = |path: &Path| path.ends_with("WOOD.JPG").then(Vec::new);
        parse_visual(bytes, Path::new("t.3ds"), remove_duplicates, &named).unwrap()
    }

    #[test]
    fn materials_are_read_wherever_they_stand() {
        let (mesh, messages) = looks(roof([1, 1]), false);
        let part = &mesh.parts[0];
        assert_eq!(part.name, "red");
        assert_eq!((part.material.ambient, part.material.diffuse), ([0.2, 0.0, 0.0], [1.0, 0.5, 0.25]));
        assert_eq!((part.material.shininess, part.material.alpha), (64.0, 0.25));
        assert_eq!(part.material.diffuse_map, Some("WOOD.JPG".into()));
        assert_eq!(part.tex_coords, [[0.0, 0.0], [1.0, 0.5], [1.0, 0.0], [0.0, 0.0]]);
        assert_eq!(messages.len(), 2, "{messages:?}");
        assert!(messages[0].contains("1 texture coordinates are not finite; 0 is used"), "{messages:?}");
        assert!(messages[1].contains("texture 'none.jpg' is not there"), "{messages:?}");
    }

    #[test]
    fn faces_of_common_smoothing_groups_are_smooth() {
        let ridge = |bytes, remove_duplicates| {
            let (mesh, _) = looks(bytes, remove_duplicates);
            let part = &mesh.parts[0];
            let top = |normal: &&[f32; 3]| normal[2] > 0.999;
            (part.positions.len(), part.normals.iter().filter(top).count())
        };
        // Vertices, and those of them that look upwards.
        assert_eq!(ridge(roof([1, 3]), false), (4, 2));
        assert_eq!(ridge(roof([1, 2]), false), (6, 0));
        assert_eq!(ridge(roof([0, 0]), false), (6, 0));
        assert_eq!(ridge(roof([0, 0]), true), (4, 2));
    }

    #[test]
    fn broken_files_are_refused_with_the_place() {
        for (bytes, expected) in [
            (vec![], "(byte 0): not a 3DS file"),
            (b"solid not 3ds at all".to_vec(), "chunk 6F73 claims"),
            (square(1.0, 4), "a face names vertex 4, the object has 4"),
            (square(f32::NAN, 3), "vertex 2 is not finite"),
        ] {
            let message = parse(bytes).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn truncation_and_flipped_bytes_never_panic() {
        let whole = square(1.0, 3);
        for length in 0..whole.len() {
            assert!(parse(whole[..length].to_vec()).is_err(), "{length} bytes");
        }
        for at in 0..whole.len() {
            let mut broken = whole.clone();
            broken[at] = 0xFF;
            // Most are errors; a changed coordinate or name is not. What counts is that it returns.
            if let Ok(mesh) = parse(broken) {
                assert!(mesh.triangle_count() <= 2);
            }
        }
        let whole = roof([1, 2]);
        for at in 0..whole.len() {
            for byte in [0, 1, 0x7F, 0xFF] {
                let mut broken = whole.clone();
                broken[at] = byte;
                // What collides must not depend on whether looks are read.
                let collides = parse(broken.clone()).map(|mesh| mesh.triangle_count());
                let drawn = parse_visual(broken, Path::new("t.3ds"), false, &|_| None);
                if matches!(drawn, Err(MeshError::TooFar { .. })) {
                    continue;
                }
                assert_eq!(collides.ok(), drawn.ok().map(|(mesh, _)| mesh.triangle_count()), "byte {at} is {byte}");
            }
        }
    }
}
