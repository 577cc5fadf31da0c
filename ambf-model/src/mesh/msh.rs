//! MuJoCo's binary meshes: four numbers of items, then vertices, normals, texture coordinates and triangles, little-endian.

use std::path::Path;

use super::visual::{Corner, Details, Facing, PartDetails};
use super::{check_finite, Mesh, MeshError, Position, Welder};

/// Numbers of vertices, normals, texture coordinates and triangles.
const HEADER_BYTES: usize = 16;

/// What a file holds.
struct Content<'b> {
    /// Three 32-bit numbers each.
    vertices: &'b [u8],
    /// As many, or empty.
    normals: &'b [u8],
    /// Three indices of vertices each.
    triangles: &'b [u8],
    /// Byte at which the triangles start.
    triangles_at: usize,
}

/// Texture coordinates are not used: such a file has no material.
pub(super) fn read(path: &Path, bytes: &[u8], details: Option<&mut Details>) -> Result<Mesh, MeshError> {
    let content = Content::split(path, bytes)?;
    let vertices: Vec<[f64; 3]> = vectors(content.vertices)
        .enumerate()
        .map(|(number, vertex)| check_finite(path, number, vertex.map(f64::from)))
        .collect::<Result<_, _>>()?;
    let mut surface = Welder::default();
    let mut corners = Vec::new();
    for (number, triangle) in content.triangles.chunks_exact(12).enumerate() {
        let mut positions = [[0.0; 3]; 3];
        for (k, index) in words(triangle).map(i32::from_le_bytes).enumerate() {
            let at = Position::Byte(content.triangles_at + 12 * number + 4 * k);
            let found = usize::try_from(index).ok().and_then(|index| vertices.get(index));
            positions[k] = *found.ok_or_else(|| {
                let count = vertices.len();
                MeshError::malformed(path, at, format!("triangle {number} has vertex {index}, there are {count}"))
            })?;
            corners.push(index as u32);
        }
        surface.triangle(positions);
    }
    if content.triangles.is_empty() {
        // MuJoCo takes the hull of the vertices.
        vertices.iter().for_each(|&vertex| {
            surface.vertex(vertex);
        });
    }
    let surface = surface.finish();
    if let Some(details) = details {
        // A vector that is no direction counts as none.
        details.normals = vectors(content.normals)
            .map(|normal| if normal.iter().all(|x| x.is_finite()) { normal } else { [0.0; 3] })
            .collect();
        let facing = match details.normals.is_empty() {
            true => Facing::Smooth,
            false => {
                let nodes = surface.triangles.as_flattened().iter();
                let corner = |(&node, normal): (&u32, u32)| Corner { normal, ..Corner::bare(node) };
                Facing::Corners(nodes.zip(corners).map(corner).collect())
            }
        };
        details.parts.push(PartDetails { facing, ..PartDetails::default() });
    }
    Ok(Mesh { sub_meshes: vec![surface] })
}

impl<'b> Content<'b> {
    fn split(path: &Path, bytes: &'b [u8]) -> Result<Self, MeshError> {
        let malformed = |at, message: String| MeshError::malformed(path, Position::Byte(at), message);
        let Some((header, rest)) = bytes.split_at_checked(HEADER_BYTES) else {
            return Err(malformed(bytes.len(), format!("the file ends within the MSH header of {HEADER_BYTES} bytes")));
        };
        let mut counts = [0; 4];
        for (k, count) in words(header).map(i32::from_le_bytes).enumerate() {
            let names = ["vertices", "normals", "texture coordinates", "triangles"];
            counts[k] = u64::try_from(count)
                .map_err(|_| malformed(4 * k, format!("the header announces {count} {}", names[k])))?;
        }
        let [vertices, normals, coordinates, triangles] = counts;
        for (name, count) in [("normals", normals), ("texture coordinates", coordinates)] {
            if count != 0 && count != vertices {
                let message =
                    format!("the header announces {count} {name}, expected none or those of {vertices} vertices");
                return Err(malformed(0, message));
            }
        }
        // Below 2^31 each: no overflow.
        let sizes = [12 * vertices, 12 * normals, 8 * coordinates, 12 * triangles];
        let announced = HEADER_BYTES as u64 + sizes.iter().sum::<u64>();
        if announced != bytes.len() as u64 {
            let message = format!("the header announces a file of {announced} bytes, it has {}", bytes.len());
            return Err(malformed(bytes.len(), message));
        }
        let [vertices, normals, coordinates, _] = sizes.map(|size| size as usize);
        let (vertices, rest) = rest.split_at(vertices);
        let (normals, rest) = rest.split_at(normals);
        let triangles = &rest[coordinates..];
        Ok(Self { vertices, normals, triangles, triangles_at: bytes.len() - triangles.len() })
    }
}

fn words(bytes: &[u8]) -> impl Iterator<Item = [u8; 4]> + '_ {
    bytes.chunks_exact(4).map(|word| [word[0], word[1], word[2], word[3]])
}

fn vectors(bytes: &[u8]) -> impl Iterator<Item = [f32; 3]> + '_ {
    bytes.chunks_exact(12).map(|vector| {
        let mut numbers = words(vector).map(f32::from_le_bytes);
        std::array::from_fn(|_| numbers.next().unwrap_or_default())
    })
}

#[cfg(test)]
mod tests {
    use super::super::{parse, parse_visual};
    use super::*;

    const VERTICES: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]];
    const TRIANGLES: [[i32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];

    fn file(vertices: &[[f32; 3]], normals: &[[f32; 3]], coordinates: &[[f32; 2]], triangles: &[[i32; 3]]) -> Vec<u8> {
        let counts = [vertices.len(), normals.len(), coordinates.len(), triangles.len()].map(|count| count as i32);
        let numbers = [vertices.as_flattened(), normals.as_flattened(), coordinates.as_flattened()].concat();
        let mut bytes: Vec<u8> = counts.iter().flat_map(|count| count.to_le_bytes()).collect();
        bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        bytes.extend(triangles.as_flattened().iter().flat_map(|index| index.to_le_bytes()));
        bytes
    }

    fn tetrahedron() -> Vec<u8> {
        file(&VERTICES, &[[1.0, 0.0, 0.0]; 4], &[[0.0; 2]; 4], &TRIANGLES)
    }

    fn read(bytes: Vec<u8>) -> Result<Mesh, MeshError> {
        parse(bytes, Path::new("t.msh"))
    }

    #[test]
    fn vertices_triangles_and_normals() {
        let mesh = read(tetrahedron()).unwrap();
        let sub = &mesh.sub_meshes[0];
        assert_eq!((sub.vertices[2], sub.surface_vertices), ([f64::from(0.1f32), 0.0, 0.0], 4));
        assert_eq!(sub.triangles, [[0, 1, 2], [0, 2, 3], [2, 1, 3], [1, 0, 3]], "in the order of their first use");
        assert_eq!(mesh, read(file(&VERTICES, &[], &[], &TRIANGLES)).unwrap());
        let drawn = |bytes| parse_visual(bytes, Path::new("t.msh"), false, &|_| None).unwrap().0.parts.remove(0);
        let part = drawn(tetrahedron());
        assert_eq!((&part.normals[..], part.tex_coords.len()), (&[[1.0, 0.0, 0.0]; 4][..], 0));
        // Without normals they are those of the surface; so where they are no direction.
        let smooth = drawn(file(&VERTICES, &[], &[], &TRIANGLES)).normals;
        assert!(smooth[0].iter().all(|x| (x + 3f32.sqrt().recip()).abs() < 1e-6), "{smooth:?}");
        assert_eq!(drawn(file(&VERTICES, &[[f32::NAN; 3]; 4], &[], &TRIANGLES)).normals, smooth);
    }

    #[test]
    fn vertices_alone_are_those_of_a_hull() {
        let mesh = read(file(&VERTICES, &[], &[], &[])).unwrap();
        assert_eq!((mesh.vertex_count(), mesh.triangle_count()), (4, 0));
    }

    #[test]
    fn broken_files_are_refused_with_the_place() {
        let with = |at: usize, word: i32| {
            let mut bytes = tetrahedron();
            bytes[at..at + 4].copy_from_slice(&word.to_le_bytes());
            bytes
        };
        let triangles_at = tetrahedron().len() - 48;
        let mut longer = tetrahedron();
        longer.push(0);
        for (bytes, expected) in [
            (vec![0; 15], "(byte 15): the file ends within the MSH header of 16 bytes"),
            (vec![0; 16], "the mesh has no triangles"),
            (with(0, -1), "(byte 0): the header announces -1 vertices"),
            (with(4, 3), "announces 3 normals, expected none or those of 4 vertices"),
            (with(8, i32::MAX), "announces 2147483647 texture coordinates"),
            (with(12, i32::MAX), "announces a file of 25769803908 bytes, it has 192"),
            (tetrahedron()[..100].to_vec(), "announces a file of 192 bytes, it has 100"),
            (longer, "announces a file of 192 bytes, it has 193"),
            (with(triangles_at + 16, 4), "(byte 160): triangle 1 has vertex 4, there are 4"),
            (with(triangles_at, -1), "triangle 0 has vertex -1, there are 4"),
            (with(16 + 12 + 4, f32::NAN.to_bits() as i32), "vertex 1 is not finite"),
        ] {
            let message = read(bytes).unwrap_err().to_string();
            assert!(message.contains(expected), "{expected}: {message}");
        }
    }
}
