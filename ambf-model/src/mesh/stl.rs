//! STL, binary and ASCII.
//!
//! Read here rather than by a library: the known ones take a binary file whose header starts with "solid" for ASCII,
//! stop at the first of several solids, and name no line.

use std::path::Path;

use super::visual::{Details, Facing, PartDetails};
use super::{check_finite, quoted, Mesh, MeshError, Position, Welder};

/// Header text and triangle count.
const HEADER_BYTES: usize = 84;
/// Normal, three corners, attribute.
const TRIANGLE_BYTES: usize = 50;

/// The normals of the file are not used: many exporters write zeros.
pub(super) fn read(path: &Path, bytes: Vec<u8>, details: Option<&mut Details>) -> Result<Mesh, MeshError> {
    let surface =
        if is_ascii(&bytes) { read_ascii(path, &String::from_utf8_lossy(&bytes))? } else { read_binary(path, &bytes)? };
    if let Some(details) = details {
        details.parts.push(PartDetails { facing: Facing::Flat, ..PartDetails::default() });
    }
    Ok(Mesh { sub_meshes: vec![surface.finish()] })
}

fn announced_triangles(bytes: &[u8]) -> Option<usize> {
    let count = bytes.get(80..HEADER_BYTES)?.try_into().ok()?;
    Some(u32::from_le_bytes(count) as usize)
}

/// Binary headers may start with "solid" too, so the size decides first, then whether the start looks like text.
fn is_ascii(bytes: &[u8]) -> bool {
    let announced = announced_triangles(bytes).map(|n| HEADER_BYTES as u64 + (n * TRIANGLE_BYTES) as u64);
    let start = &bytes[..bytes.len().min(512)];
    let word = start.trim_ascii_start();
    announced != Some(bytes.len() as u64)
        && word.len() >= 5
        && word[..5].eq_ignore_ascii_case(b"solid")
        && !start.contains(&0)
}

/// Bytes after the announced triangles are ignored: some exporters append a comment.
fn read_binary(path: &Path, bytes: &[u8]) -> Result<Welder, MeshError> {
    let truncated = |message| MeshError::malformed(path, Position::Byte(bytes.len()), message);
    let announced = announced_triangles(bytes)
        .ok_or_else(|| truncated("the file ends within the STL header of 84 bytes".to_owned()))?;
    let triangles = bytes[HEADER_BYTES..].chunks_exact(TRIANGLE_BYTES);
    let present = triangles.len();
    if present < announced {
        return Err(truncated(format!(
            "truncated: the header announces {announced} triangles, the file holds {present}"
        )));
    }
    let mut surface = Welder::default();
    for (i, triangle) in triangles.take(announced).enumerate() {
        let mut corners = [[0.0; 3]; 3];
        for (k, corner) in triangle[12..48].chunks_exact(12).enumerate() {
            let x = |j: usize| f64::from(f32::from_le_bytes([corner[j], corner[j + 1], corner[j + 2], corner[j + 3]]));
            corners[k] = check_finite(path, 3 * i + k, [x(0), x(4), x(8)])?;
        }
        surface.triangle(corners);
    }
    Ok(surface)
}

/// Only `vertex`, `endfacet`, `solid` and `endsolid` matter; several solids in one file are read as one.
fn read_ascii(path: &Path, text: &str) -> Result<Welder, MeshError> {
    let mut surface = Welder::default();
    let mut corners = Vec::with_capacity(3);
    let mut corner_count = 0;
    let mut open = false;
    let mut line = 0;
    for content in text.lines() {
        line += 1;
        let malformed = |message: String| MeshError::malformed(path, Position::Line(line), message);
        let mut words = content.split_ascii_whitespace();
        let Some(keyword) = words.next() else { continue };
        match keyword.to_ascii_lowercase().as_str() {
            "vertex" => {
                let mut corner = [0.0; 3];
                for x in &mut corner {
                    let word = words.next().unwrap_or("");
                    let number: f32 = word.parse().map_err(|_| {
                        malformed(format!("expected three numbers after 'vertex', got {}", quoted(word)))
                    })?;
                    *x = f64::from(number);
                }
                corners.push(check_finite(path, corner_count, corner)?);
                corner_count += 1;
            }
            "endfacet" => {
                let triangle = <[[f64; 3]; 3]>::try_from(corners.as_slice())
                    .map_err(|_| malformed(format!("a facet has 3 vertices, got {}", corners.len())))?;
                surface.triangle(triangle);
                corners.clear();
            }
            "solid" => open = true,
            "endsolid" => open = false,
            "facet" | "outer" | "endloop" => {}
            other => return Err(malformed(format!("{} is not an STL keyword", quoted(other)))),
        }
    }
    if open || !corners.is_empty() {
        return Err(MeshError::malformed(path, Position::Line(line), "truncated: 'endsolid' is missing"));
    }
    Ok(surface)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fmt::Write;

    const FACETS: [[[f32; 3]; 3]; 4] = [
        [[0.0, 0.0, 0.0], [0.0, 0.1, 0.0], [0.1, 0.0, 0.0]],
        [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.1]],
        [[0.0, 0.0, 0.0], [0.0, 0.0, 0.1], [0.0, 0.1, 0.0]],
        [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]],
    ];

    fn binary(header: &[u8], announced: u32) -> Vec<u8> {
        let mut bytes = header.to_vec();
        bytes.resize(80, b' ');
        bytes.extend(announced.to_le_bytes());
        for facet in FACETS {
            bytes.extend([0; 12]);
            bytes.extend(facet.iter().flatten().flat_map(|x| x.to_le_bytes()));
            bytes.extend([0; 2]);
        }
        bytes
    }

    fn ascii() -> String {
        let mut text = String::from("solid\n");
        for facet in FACETS {
            text += "  facet normal 0 0 0\n    outer loop\n";
            for [x, y, z] in facet {
                writeln!(text, "      vertex {x} {y:e} {z}").unwrap();
            }
            text += "    endloop\n  endfacet\n";
        }
        text + "endsolid\n"
    }

    fn parse(bytes: impl Into<Vec<u8>>) -> Result<Mesh, MeshError> {
        read(Path::new("t.stl"), bytes.into(), None)
    }

    #[test]
    fn binary_and_ascii_agree_bit_for_bit() {
        let mesh = parse(binary(b"made by hand", 4)).unwrap();
        assert_eq!(mesh.sub_meshes[0].vertices.len(), 4);
        assert_eq!(mesh.sub_meshes[0].vertices[1], [0.0, f64::from(0.1f32), 0.0]);
        assert_eq!(mesh.sub_meshes[0].triangles, [[0, 1, 2], [0, 2, 3], [0, 3, 1], [2, 1, 3]]);
        assert_eq!(mesh, parse(ascii()).unwrap());
        assert_eq!(mesh, parse(ascii().to_uppercase()).unwrap());
    }

    #[test]
    fn a_binary_header_may_start_with_solid_or_end_in_a_comment() {
        let plain = parse(binary(b"x", 4)).unwrap();
        assert_eq!(plain, parse(binary(b"solid exported", 4)).unwrap());
        let mut longer = binary(b"solid exported", 4);
        longer.extend(b"trailer");
        assert_eq!(plain, parse(longer).unwrap());
    }

    #[test]
    fn all_solids_of_an_ascii_file_are_read() {
        let mesh = parse(ascii() + &ascii()).unwrap();
        assert_eq!(mesh.triangle_count(), 8);
        assert_eq!(mesh.vertex_count(), 4);
    }

    #[test]
    fn broken_files_are_refused_with_the_place() {
        for (bytes, expected) in [
            (vec![], "header of 84 bytes"),
            (binary(b"x", u32::MAX), "announces 4294967295 triangles, the file holds 4"),
            (binary(b"x", 4)[..200].to_vec(), "announces 4 triangles, the file holds 2"),
            (ascii().replace("endsolid", "").into(), ":30: truncated"),
            (ascii().replacen("vertex 0", "vertex O", 1).into(), ":4: expected three numbers"),
            (ascii().replacen("      vertex 0 0e0 0\n", "", 1).into(), ":7: a facet has 3 vertices, got 2"),
            (ascii().replacen("vertex 0 0e0 0", "vertex 0 nan 0", 1).into(), "vertex 0 is not finite"),
        ] {
            let message = parse(bytes).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        let mut infinite = binary(b"x", 4);
        infinite[84 + 50 + 12 + 4..][..4].copy_from_slice(&f32::INFINITY.to_le_bytes());
        assert!(matches!(parse(infinite), Err(MeshError::NonFinite { vertex: 3, .. })));
    }
}
