use super::*;
use crate::mesh::{parse_visual, VisualMesh};

fn parse(bytes: impl Into<Vec<u8>>) -> Result<Mesh, MeshError> {
    crate::mesh::parse(bytes.into(), Path::new("t.ply"))
}

/// Looks of a file; the file `wood 1.png` is there.
fn looks(bytes: impl Into<Vec<u8>>) -> (VisualMesh, Vec<String>) {
    let named = |path: &Path| path.ends_with("wood 1.png").then(Vec::new);
    parse_visual(bytes.into(), Path::new("t.ply"), false, &named).unwrap()
}

/// A square and a triangle that stands on one of its edges, with an element that nobody knows.
fn ascii() -> String {
    "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 5\nproperty float x\nproperty float y\n\
         property double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement other 1\n\
         property list uchar short numbers\nproperty int one\nelement face 3\nproperty list uchar int vertex_indices\n\
         end_header\n0 0 0 255 0 0\n1 0 0 0 255 0\n1 1 0 0 0 51\n0 0.1 0 0 0 0\n0 0 2.5e0 9 9 9\n3 1 2 -3 7\n\
         4 0 1 2 3\n2 0 1\n3 1 0 4\n"
        .to_owned()
}

/// The same in binary.
fn binary(big_endian: bool) -> Vec<u8> {
    let (header, payload) = ascii().split_once("end_header\n").map(|(h, p)| (h.to_owned(), p.to_owned())).unwrap();
    let format = if big_endian { "binary_big_endian" } else { "binary_little_endian" };
    let mut bytes = (header.replace("ascii", format) + "end_header\n").into_bytes();
    let mut add = |mut number: Vec<u8>| {
        if big_endian {
            number.reverse();
        }
        bytes.extend(number);
    };
    let lines: Vec<Vec<f64>> =
        payload.lines().map(|line| line.split(' ').map(|word| word.parse().unwrap()).collect()).collect();
    for vertex in &lines[..5] {
        add((vertex[0] as f32).to_le_bytes().to_vec());
        add((vertex[1] as f32).to_le_bytes().to_vec());
        add(vertex[2].to_le_bytes().to_vec());
        vertex[3..].iter().for_each(|x| add(vec![*x as u8]));
    }
    add(vec![3]);
    lines[5][1..4].iter().for_each(|x| add((*x as i16).to_le_bytes().to_vec()));
    add((lines[5][4] as i32).to_le_bytes().to_vec());
    for face in &lines[6..] {
        add(vec![face[0] as u8]);
        face[1..].iter().for_each(|x| add((*x as i32).to_le_bytes().to_vec()));
    }
    bytes
}

#[test]
fn all_encodings_agree() {
    let mesh = parse(ascii()).unwrap();
    let part = &mesh.sub_meshes[0];
    assert_eq!(part.triangles, [[0, 1, 2], [0, 2, 3], [1, 0, 4]]);
    assert_eq!(part.vertices[3], [0.0, f64::from(0.1f32), 0.0]);
    assert_eq!(part.vertices[4], [0.0, 0.0, 2.5]);
    assert_eq!(part.surface_vertices, 5);
    let (drawn, messages) = looks(ascii());
    assert!(messages.is_empty(), "{messages:?}");
    for big_endian in [false, true] {
        assert_eq!(parse(binary(big_endian)).unwrap(), mesh);
        assert_eq!(looks(binary(big_endian)).0, drawn);
    }
    assert_eq!(parse(ascii().replace('\n', "\r\n")).unwrap(), mesh);
    assert_eq!(parse(ascii().replace("vertex_indices", "vertex_index")).unwrap(), mesh);
}

#[test]
fn vertices_have_colours() {
    let (mesh, _) = looks(ascii());
    let part = &mesh.parts[0];
    assert_eq!(part.colors[..3], [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 0.2, 1.0]]);
    assert_eq!((part.material.diffuse, part.material.ambient), ([1.0; 3], [0.5; 3]));
    let text = ascii().replace("uchar red", "float red").replace("uchar blue", "uchar alpha");
    let (mesh, _) = looks(text.replace("blue", "x"));
    assert!(mesh.parts[0].colors.is_empty());
    assert_eq!(mesh.parts[0].material, MeshMaterial::default());
}

#[test]
fn vertices_have_normals_and_texture_coordinates() {
    let text = "ply\nformat ascii 1.0\ncomment TextureFile wood 1.png\ncomment TextureFile b.png\nelement vertex 3\n\
                    property float x\nproperty float y\nproperty float z\nproperty float nx\nproperty float ny\n\
                    property float nz\nproperty float U\nproperty float V\nproperty float red\nproperty ushort green\n\
                    property int blue\nproperty float alpha\nelement face 1\n\
                    property list uchar uint vertex_indices\nend_header\n0 0 0 2 0 0 0 0 0.5 65535 51 0.25\n\
                    1 0 0 0 0 0 1 0 9 0 0 1\n0 1 0 1 0 0 0.5 1 1e39 0 0 1\n3 0 1 2\n";
    for (u, v) in [("s", "t"), ("u", "v"), ("texture_u", "texture_v")] {
        let (mesh, messages) = looks(text.replace('U', u).replace('V', v));
        let part = &mesh.parts[0];
        assert_eq!(part.tex_coords, [[0.0, 0.0], [1.0, 0.0], [0.5, 1.0]]);
        assert_eq!(part.normals, [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]);
        assert_eq!(part.colors, [[0.5, 1.0, 0.2, 0.25], [1.0, 0.0, 0.0, 1.0], [1.0; 4]]);
        assert_eq!(part.material.diffuse_map, Some("wood 1.png".into()));
        assert_eq!(part.material.diffuse, [1.0; 3]);
        assert_eq!(messages.len(), 2, "{messages:?}");
        assert_eq!(messages[0], "t.ply: 1 colours are not finite; white is used");
        assert!(messages[1].contains("1 more textures are not drawn"), "{messages:?}");
    }
    let (mesh, messages) = looks(text.replace("wood", "stone"));
    assert_eq!(mesh.parts[0].material.diffuse_map, None);
    assert!(messages[1].contains("texture 'stone 1.png' is not there"), "{messages:?}");
}

#[test]
fn faces_may_tear_the_texture() {
    let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                    element face 3\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\n\
                    property int texnumber\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 6 0 0 1 0 1 1 0\n\
                    4 0 2 3 0 8 0.5 0.5 1 1 0 1 0 0 0\n3 0 1 2 0 0\n";
    let (mesh, messages) = looks(text);
    assert!(messages.is_empty(), "{messages:?}");
    let part = &mesh.parts[0];
    assert_eq!(part.tex_coords[..4], [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.5, 0.5]]);
    assert_eq!(part.nodes[..4], [0, 1, 2, 0]);
    assert_eq!(part.triangles.len(), 4);
    let (_, messages) = looks(text.replace("6 0 0 1 0 1 1 0", "4 0 0 1 0 0"));
    assert!(messages[0].contains("1 faces do not have finite texture coordinates"), "{messages:?}");
}

#[test]
fn faces_may_come_before_vertices() {
    let text = "ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int vertex_indices\nelement vertex 3\n\
                    property int x\nproperty int y\nproperty int z\nend_header\n3 0 1 2\n0 0 0\n1 0 0\n0 -1 0\n";
    assert_eq!(parse(text).unwrap().sub_meshes[0].vertices[2], [0.0, -1.0, 0.0]);
    assert!(parse(text.replace("3 0 1 2", "3 0 1 3")).is_err());
}

#[test]
fn broken_files_are_refused_with_the_place() {
    let good = ascii();
    let mut announced = binary(false);
    let at = announced.windows(8).position(|w| w == b"vertex 5").unwrap();
    announced.splice(at..at + 8, *b"vertex 99999999");
    for (bytes, expected) in [
        (Vec::new(), " (byte 0): not a PLY file"),
        (b"plywood".to_vec(), ":1: no line 'end_header' in the first"),
        (b"ply\nend_header\n".to_vec(), ":1: No format line found."),
        (good.replace("float x", "floaty x").into(), ":5: not a line of a PLY header: 'property floaty x'"),
        (good.replace("float x", "float w").into(), ":16: the header describes no number 'x' of element 'vertex'"),
        (good.replace("vertex 5", "point 5").into(), ":16: the header describes no element 'vertex'"),
        (good.replace("face 3", "face 0").into(), ":16: the file has points and no faces: a point cloud neither"),
        (good.replace("element face", "element tristrips").into(), "has triangle strips instead of faces"),
        (good.replace("uchar int v", "uchar float v").into(), "no list of integers 'vertex_indices'"),
        (good.replace("vertex 5", "vertex 99999999999").into(), ":17: truncated: the header announces 99999999999"),
        (good.replace("vertex 5", "vertex 99999999999999999999").into(), ":4: not a line of a PLY header"),
        (good.replace("1 1 0 0 0 51", "1 one 0 0 0 51").into(), ":19: expected the numbers that the header"),
        (good.replace("0 0 51", "0 0 256").into(), ":19: expected the numbers"),
        (good.replace("4 0 1 2 3", "4 0 1 2 5").into(), ":23: face 0 names vertex 5, the file has 5"),
        (good.replace("4 0 1 2 3", "4 0 1 2 -1").into(), ":23: face 0 names vertex -1, the file has 5"),
        (good.replace("4 0 1 2 3", "99999999999 0 1").into(), ":23: expected the numbers"),
        (
            good.replace("\n3 1 0 4\n", "\n").into(),
            ":25: truncated: the header announces 3 elements 'face', the file holds 2",
        ),
        (good.replace("2.5e0", "1e999").into(), "vertex 4 is not finite"),
        (binary(true)[..binary(true).len() - 1].to_vec(), "announces 3 elements 'face', the file holds 2"),
        (announced, "truncated: the header announces 99999999 elements 'vertex', for which"),
    ] {
        let message = parse(bytes).unwrap_err().to_string();
        assert!(message.contains(expected) && message.len() < 500, "{message}, expected {expected}");
    }
    let empty = good.replace("vertex 5", "vertex 0").replace("face 3", "face 0");
    assert!(matches!(parse(empty), Err(MeshError::Empty { .. })));
    assert!(matches!(parse(good.replace("4 0 1 2 3", "0").replace("3 1 0 4", "0")), Err(MeshError::Empty { .. })));
}

#[test]
fn elements_without_properties_end() {
    let nothing = |count: &str| format!("element nothing {count}\nelement face");
    let text = ascii().replace("element face", &nothing("18446744073709551615"));
    assert!(parse(text).unwrap_err().to_string().contains("truncated: the header announces 18446744073709551615"));
    let mut bytes = binary(false);
    let at = bytes.windows(12).position(|w| w == b"element face").unwrap();
    bytes.splice(at..at + 12, nothing("18446744073709551615").bytes());
    assert_eq!(parse(bytes).unwrap(), parse(ascii()).unwrap());
}

#[test]
fn changed_bytes_never_panic() {
    let textured = "ply\nformat ascii 1.0\ncomment TextureFile a.png\nelement vertex 3\nproperty float x\n\
                        property float y\nproperty float z\nproperty float s\nproperty float t\nproperty float nx\n\
                        property float ny\nproperty float nz\nelement face 1\nproperty list uchar int vertex_index\n\
                        property list uchar float texcoord\nend_header\n0 0 0 1 1 0 0 1\n1 0 0 1 0 0 0 1\n\
                        0 1 0 0 0 0 0 1\n3 0 1 2 6 0 0 1 1 1 0\n";
    let whole = [ascii().into_bytes(), binary(false), binary(true), textured.into()];
    // Numbers that look random and are the same each time.
    let mut state = 7u64;
    let mut random = move |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    for round in 0..20_000 {
        let mut changed = whole[round % whole.len()].clone();
        for _ in 0..=random(4) {
            let at = random(changed.len());
            match random(4) {
                0 => changed[at] = b"0123456789-+./ \n\tebfvly\xFF\0"[random(25)],
                1 => drop(changed.remove(at)),
                2 => changed[at] ^= 1 << random(8),
                _ => changed.insert(at, b"9-./ \ne\0"[random(8)]),
            }
        }
        // What collides must not depend on whether looks are read.
        let collides = parse(changed.clone()).map(|mesh| mesh.triangle_count());
        let drawn = parse_visual(changed, Path::new("t.ply"), random(2) == 0, &|_| Some(Vec::new()));
        if matches!(drawn, Err(MeshError::TooFar { .. })) {
            continue;
        }
        if let Err(error) = &collides {
            assert!(error.to_string().len() < 1000, "{error}");
        }
        let Ok((mesh, messages)) = drawn else {
            assert!(collides.is_err());
            continue;
        };
        assert_eq!(collides.unwrap(), mesh.triangle_count());
        assert!(messages.iter().all(|message| message.len() < 1500));
        for part in mesh.parts {
            let numbers = part.positions.as_flattened().iter().chain(part.normals.as_flattened());
            assert!(numbers.chain(part.tex_coords.as_flattened()).all(|x| x.is_finite()));
            assert!(part.colors.as_flattened().iter().all(|x| (0.0..=1.0).contains(x)));
            assert!(part.triangles.as_flattened().iter().all(|i| (*i as usize) < part.positions.len()));
        }
    }
}
