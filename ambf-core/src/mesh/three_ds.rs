//! Autodesk 3DS: a tree of chunks, each with a 16-bit id and a 32-bit length that includes these six bytes.

use std::collections::HashMap;
use std::path::Path;

use super::visual::{Details, PartDetails};
use super::{check_finite, Files, Mesh, MeshError, Position, SubMesh, Welder, MAX_SUB_MESHES};

const MAIN: u16 = 0x4D4D;
const EDITOR: u16 = 0x3D3D;
const OBJECT: u16 = 0x4000;
const TRIMESH: u16 = 0x4100;
const VERTICES: u16 = 0x4110;
const FACES: u16 = 0x4120;
const FACE_MATERIAL: u16 = 0x4130;

/// Three corners and a word of flags.
const FACE_BYTES: usize = 8;

pub(super) fn read(
    path: &Path,
    bytes: Vec<u8>,
    _files: &Files,
    details: Option<&mut Details>,
) -> Result<Mesh, MeshError> {
    let mut file = Cursor { path, bytes: &bytes, at: 0, end: bytes.len() };
    let Some((MAIN, mut main)) = file.chunk()? else {
        return Err(MeshError::malformed(path, Position::Byte(0), "not a 3DS file: it must start with chunk 4D4D"));
    };
    let mut mesh = Mesh::default();
    let mut vertex_count = 0;
    while let Some((id, mut editor)) = main.chunk()? {
        if id != EDITOR {
            continue;
        }
        while let Some((id, mut object)) = editor.chunk()? {
            if id != OBJECT {
                continue;
            }
            let name = object.text()?;
            while let Some((id, trimesh)) = object.chunk()? {
                if id == TRIMESH {
                    let at = trimesh.at;
                    let object = Object::read(trimesh, &mut vertex_count)?;
                    mesh.sub_meshes.extend(object.split(&name));
                    if mesh.sub_meshes.len() > MAX_SUB_MESHES {
                        let message = format!("more than {MAX_SUB_MESHES} parts of one material");
                        return Err(MeshError::malformed(path, Position::Byte(at), message));
                    }
                }
            }
        }
    }
    if let Some(details) = details {
        details.parts.resize_with(mesh.sub_meshes.len(), PartDetails::default);
    }
    Ok(mesh)
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
}

impl Object {
    /// `vertex_count` numbers the vertices of the whole file, for messages.
    fn read(mut trimesh: Cursor, vertex_count: &mut usize) -> Result<Self, MeshError> {
        let mut object = Object::default();
        let whole = trimesh.at;
        while let Some((id, mut chunk)) = trimesh.chunk()? {
            match id {
                VERTICES => {
                    let count = usize::from(chunk.word()?);
                    for v in chunk.take(12 * count)?.chunks_exact(12) {
                        let x = |j: usize| f64::from(f32::from_le_bytes([v[j], v[j + 1], v[j + 2], v[j + 3]]));
                        object.vertices.push(check_finite(chunk.path, *vertex_count, [x(0), x(4), x(8)])?);
                        *vertex_count += 1;
                    }
                }
                FACES => object.read_faces(chunk)?,
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

    fn read_faces(&mut self, mut chunk: Cursor) -> Result<(), MeshError> {
        let count = usize::from(chunk.word()?);
        let faces = chunk.take(FACE_BYTES * count)?.chunks_exact(FACE_BYTES);
        self.faces = faces.map(|f| [word_at(f, 0), word_at(f, 2), word_at(f, 4)]).collect();
        self.face_materials = vec![None; count];
        let mut material_indices: HashMap<String, usize> =
            self.materials.iter().enumerate().map(|(i, name)| (name.clone(), i)).collect();
        while let Some((id, mut group)) = chunk.chunk()? {
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

    /// One sub-mesh for each material in order of first use, faces without a material making one too.
    fn split(self, name: &str) -> impl Iterator<Item = SubMesh> {
        let mut parts: Vec<Welder> = Vec::new();
        let mut part_of = HashMap::new();
        for (face, &material) in self.faces.iter().zip(&self.face_materials) {
            let part = *part_of.entry(material).or_insert_with(|| {
                parts.push(Welder::named(material.map_or(name, |m| &self.materials[m])));
                parts.len() - 1
            });
            parts[part].triangle(face.map(|i| self.vertices[usize::from(i)]));
        }
        parts.into_iter().map(Welder::finish)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
    }
}
