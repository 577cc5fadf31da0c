use super::*;
use crate::mesh::parse;

/// A square in the plane z = 0 of two triangles, and a third one that stands on an edge of it.
const CORNER: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 2\nv 1 0 2\n";

fn read(text: &str, remove_duplicates: bool) -> (VisualMesh, Vec<String>) {
    let named = |path: &Path| {
        match path.to_str() {
        Some("m.mtl") => Some(
            b"newmtl a\nKd 1 0 0\nd 0.3\nnewmtl b\nKd 0 1 0\nTr 0.7\nnewmtl c\nKd 0 0 1\nmap_Kd tex/c.png\nbump c.png\n"
                .to_vec(),
        ),
        Some("tex/c.png" | "c.png") => Some(Vec::new()),
        _ => None,
    }
    };
    let (mesh, messages) = parse_visual(text.into(), Path::new("m.obj"), remove_duplicates, &named).unwrap();
    let collides = parse(text.into(), Path::new("m.obj")).unwrap();
    assert_eq!(mesh.triangle_count(), collides.triangle_count());
    (mesh, messages)
}

#[test]
fn an_obj_has_a_part_for_each_material_that_is_used() {
    let text = format!(
        "mtllib m.mtl\n{CORNER}vt 0 0\nusemtl b\nf 1 2 3\nusemtl a\nf 1/1 3/1 4/1\nusemtl c\nf 1/1 5/2 6/-1\nusemtl d\n"
    );
    let (mesh, messages) = read(&text, false);
    let names: Vec<_> = mesh.parts.iter().map(|part| (part.name.as_str(), part.material.diffuse)).collect();
    assert_eq!(names, [("a", [1.0, 0.0, 0.0]), ("b", [0.0, 1.0, 0.0]), ("c", [0.0, 0.0, 1.0])]);
    // d 0.3 and Tr 0.7 say the same.
    assert!((mesh.parts[0].material.alpha - mesh.parts[1].material.alpha).abs() < 1e-6);
    assert_eq!(mesh.parts[0].material.alpha, 0.3);
    assert_eq!(mesh.parts[2].material.diffuse_map, Some("tex/c.png".into()));
    assert_eq!(messages.len(), 2, "{messages:?}");
    assert!(messages[0].starts_with("m.obj:15: material 'd' is not in the library"), "{messages:?}");
    assert!(messages[1].starts_with("m.obj:14: a texture coordinate or normal of this face does not exist"));
    // Nodes count through the vertices of all parts of the collision mesh: 3 of part a, 3 of part b, 3 of part c.
    let nodes: Vec<_> = mesh.parts.iter().map(|part| part.nodes.clone()).collect();
    assert_eq!(nodes, [[0, 1, 2], [3, 4, 5], [6, 7, 8]]);
    let without = read(&text.replace("m.mtl", "none.mtl"), false);
    assert_eq!(without.0.parts.len(), 1);
    assert_eq!(without.0.parts[0].material, MeshMaterial::default());
    assert!(without.1[0].starts_with("m.obj:1: material library 'none.mtl' is not there"), "{:?}", without.1);
    // Materials of no library at all: said once.
    let (mesh, messages) = read(&text.replace("mtllib m.mtl\n", ""), false);
    assert_eq!(mesh.parts.len(), 1);
    assert!(messages[0].starts_with("m.obj:8: material 'b' is asked for, but no line `mtllib FILE`"), "{messages:?}");
    assert_eq!(messages.iter().filter(|message| message.contains("is asked for")).count(), 1, "{messages:?}");
}

#[test]
fn normals_of_a_file_are_used_and_others_are_smooth() {
    // The edge from vertex 1 to 2 belongs to the square (area 1 in two triangles) and to a triangle of area 1.
    let faces = "f 1 2 3\nf 1 3 4\nf 2 1 5\n";
    let (mesh, _) = read(&format!("{CORNER}{faces}"), false);
    let part = &mesh.parts[0];
    assert_eq!(part.positions.len(), 5);
    // At vertex 1 the two triangles upwards, of area 0.5 each, meet that of the wall of area 1, which looks along
    // +y.
    let [x, y, z] = part.normals[0];
    let half = 0.5f32.sqrt();
    assert!(x == 0.0 && (y - half).abs() < 1e-6 && (z - half).abs() < 1e-6, "{x} {y} {z}");
    assert_eq!(part.normals[3], [0.0, 0.0, 1.0]);

    let given = "vn 0 0 2\nvn 1 0 0\nvn 0 0 0\nvn nan 0 0\nf 1//1 2//1 3//1\nf 1//2 3//3 4//4\n";
    let (mesh, messages) = read(&format!("{CORNER}{given}"), false);
    let part = &mesh.parts[0];
    let expected = [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]];
    assert_eq!(part.normals[..4], expected);
    // Zeros and what is no number are replaced by the computed one.
    assert_eq!(part.normals[4..], [[0.0, 0.0, 1.0]; 2]);
    assert_eq!(part.positions[3], part.positions[0]);
    assert_eq!(part.nodes, [0, 1, 2, 0, 2, 3]);
    assert_eq!(messages.len(), 1);
    assert!(messages[0].starts_with("m.obj:10: expected a finite number, got 'nan'; 0 is used"), "{messages:?}");

    // Vertices of their own keep an edge sharp; welded by position it is smooth.
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\nf 5 4 6\n";
    assert_eq!(read(text, false).0.parts[0].normals[0], [0.0, 0.0, 1.0]);
    assert_eq!(read(text, false).0.parts[0].positions.len(), 6);
    let (welded, _) = read(text, true);
    assert_eq!(welded.parts[0].positions.len(), 4);
    assert!((welded.parts[0].normals[0][1] - half).abs() < 1e-6);
}

#[test]
fn removing_duplicates_keeps_seams_of_the_texture() {
    // Vertex 3 and vertex 1 lie on a seam: two texture coordinates each.
    let text = format!(
        "{CORNER}vt 0 0\nvt 1 0\nvt 1 1\nvt .5 .5\nvt .5 1\nvt 0 1\nvn 1 0 0\nf 1/1/1 2/2/1 3/3/1\nf 1/4/1 3/5/1 4/6/1\n"
    );
    let (mesh, _) = read(&text, true);
    let part = &mesh.parts[0];
    assert_eq!(part.tex_coords, [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.5, 0.5], [0.5, 1.0], [0.0, 1.0]]);
    assert_eq!(part.nodes, [0, 1, 2, 0, 2, 3]);
    // The file's normals are replaced.
    assert!(part.normals.iter().all(|normal| *normal == [0.0, 0.0, 1.0]));
    assert!(part.tangents.is_empty());
}

#[test]
fn stl_has_facets_unless_duplicates_are_removed() {
    let mut text = String::from("solid\n");
    for facet in
        [[[0, 0, 0], [0, 1, 0], [1, 0, 0]], [[0, 0, 0], [1, 0, 0], [0, 0, 1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]]]
    {
        text += "facet normal 1 1 1\nouter loop\n";
        text.extend(facet.map(|[x, y, z]| format!("vertex {x} {y} {z}\n")));
        text += "endloop\nendfacet\n";
    }
    text += "endsolid\n";
    let read = |remove| parse_visual(text.clone().into(), Path::new("m.stl"), remove, &|_| None).unwrap().0;
    let flat = &read(false).parts[0];
    assert_eq!(flat.positions.len(), 9);
    assert_eq!(flat.normals[0], [0.0, 0.0, -1.0]);
    assert_eq!(flat.normals[3..6], [[0.0, -1.0, 0.0]; 3]);
    assert_eq!(flat.nodes, [0, 1, 2, 0, 2, 3, 0, 3, 1]);
    let smooth = &read(true).parts[0];
    assert_eq!(smooth.positions.len(), 4);
    let third = -(1.0f32 / 3.0).sqrt();
    assert!(smooth.normals[0].iter().all(|x| (x - third).abs() < 1e-6), "{:?}", smooth.normals[0]);
    assert_eq!(smooth.material, MeshMaterial::default());
}

#[test]
fn tangents_follow_the_texture() {
    let faces = "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n";
    let upright = format!("mtllib m.mtl\nusemtl c\n{CORNER}vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n{faces}");
    let (mesh, _) = read(&upright, false);
    assert_eq!(mesh.parts[0].tangents, [[1.0, 0.0, 0.0, 1.0]; 4]);
    let mirrored = upright.replace("vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1", "vt 1 0\nvt 0 0\nvt 0 1\nvt 1 1");
    assert_eq!(read(&mirrored, false).0.parts[0].tangents, [[-1.0, 0.0, 0.0, -1.0]; 4]);
    // A texture of one point has no directions; the tangents are still at right angles to the normals.
    let point = upright.replace("vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1", "vt 1 0\nvt 1 0\nvt 1 0\nvt 1 0");
    for [x, y, z, w] in &read(&point, false).0.parts[0].tangents {
        assert!((x.hypot(*y) - 1.0).abs() < 1e-6 && *z == 0.0 && *w == 1.0);
    }
    // Where normals are turned by a scale, tangents stay at right angles to them.
    let turned = mesh.transformed(&Isometry3::rotation(Vector3::new(0.3, 0.4, 0.5))).scaled_along([1.0, -3.0, 0.2]);
    let part = &turned.unwrap().parts[0];
    for ([x, y, z, w], [a, b, c]) in part.tangents.iter().zip(&part.normals) {
        assert!((x * a + y * b + z * c).abs() < 1e-6 && *w == -1.0);
    }
}

#[test]
fn many_corners_at_one_vertex_are_found_again() {
    // A fan whose centre has a texture coordinate for each triangle; the triangles come twice.
    let (mut text, mut faces) = (String::from("v 0 0 0\n"), String::new());
    for i in 0..100 {
        let angle = f64::from(i) / 20.0;
        text += &format!("v {} {} 0\nvt {i} 0\n", angle.cos(), angle.sin());
        faces += &format!("f 1/{} {}/1 {}/1\n", i + 1, i % 100 + 2, (i + 1) % 100 + 2);
    }
    let (mesh, _) = read(&format!("{text}{faces}{faces}"), false);
    let part = &mesh.parts[0];
    assert_eq!((part.triangles.len(), part.positions.len()), (200, 200));
    assert_eq!(part.triangles[..100], part.triangles[100..]);
    let centre: Vec<f32> = part.triangles[..100].iter().map(|t| part.tex_coords[t[0] as usize][0]).collect();
    assert_eq!(centre, (0..100).map(|i| i as f32).collect::<Vec<_>>());
}

#[test]
fn degenerate_triangles_are_kept_and_have_normals() {
    let (mesh, _) = read("v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1e-200 0\nf 1 2 3\nf 1 1 2\nf 1 2 4\n", false);
    assert_eq!(mesh.parts[0].triangles.len(), 3);
    assert!(mesh.parts[0].normals.iter().all(|normal| *normal == [0.0, 0.0, 1.0]));
    // A sheet with two sides.
    let (mesh, _) = read("v 0 0 0\nv 0 1 0\nv 1 0 0\nf 1 2 3\nf 3 2 1\n", false);
    assert_eq!(mesh.parts[0].normals, [[0.0, 0.0, -1.0]; 3]);
}

#[test]
fn what_has_no_picture_is_said() {
    let (mesh, messages) = read("v 0 0 0\nv 1 0 0\n", false);
    assert_eq!((mesh.parts.len(), mesh.bounds()), (0, None));
    assert_eq!(messages, ["m.obj: the mesh has vertices but no triangles; nothing of it is drawn"]);
    let far = "v 0 0 0\nv 1e30 0 0\nv 0 1 0\nf 1 2 3\n";
    let error = parse_visual(far.into(), Path::new("m.obj"), false, &|_| None).unwrap_err();
    assert!(matches!(error, MeshError::TooFar { .. }), "{error}");
    assert!(error.to_string().contains("is the unit of the file right?"));
    assert!(parse(far.into(), Path::new("m.obj")).is_ok());
}

#[test]
fn too_many_triangles_are_refused_before_they_are_made() {
    let mut text = String::from("v 0 0 0\nv 1 0 0\nv 0 1 0\nf");
    text += &" 1 2 3".repeat((MAX_TRIANGLES + 3) / 3 + 1);
    let error = parse_visual(text.into(), Path::new("m.obj"), false, &|_| None).unwrap_err();
    assert!(matches!(error, MeshError::TooManyTriangles { .. }), "{error}");
}

#[test]
fn scaling_mirrors_and_keeps_normals_at_right_angles() {
    let (mesh, _) = read("v 0 0 0\nv 1 0 1\nv 0 1 0\nf 1 2 3\n", false);
    let scaled = mesh.scaled_along([2.0, 1.0, -1.0]).unwrap();
    let part = &scaled.parts[0];
    assert_eq!((part.positions[1], part.triangles[0]), ([2.0, 0.0, -1.0], [0, 2, 1]));
    let [a, b, c] = part.triangles[0].map(|i| Vector3::from(part.positions[i as usize]));
    let facing = (b - a).cross(&(c - a)).normalize();
    assert!((facing - Vector3::from(part.normals[0])).norm() < 1e-6, "{facing} {:?}", part.normals[0]);
    assert_eq!(scaled.bounds(), Some(([0.0, 0.0, -1.0], [2.0, 1.0, 0.0])));
    assert!(mesh.scaled(f64::NAN).is_none() && mesh.scaled(1e30).is_none());
    let flat = mesh.scaled_along([1.0, 1.0, 0.0]).unwrap();
    assert!(flat.parts[0].normals.iter().flatten().all(|x| x.is_finite()));
    let turned = mesh.transformed(&Isometry3::new(Vector3::x(), Vector3::z() * std::f64::consts::FRAC_PI_2));
    assert!((Vector3::from(turned.parts[0].positions[1]) - Vector3::new(1.0, 1.0, 1.0)).norm() < 1e-6);
}

#[test]
fn changed_bytes_never_panic() {
    let text = format!(
        "mtllib m.mtl\n{CORNER}vt 0 0\nvt 1 1\nvn 0 0 1\nusemtl c\nf 1/1/1 2/2/1 3/-1/-1 4//1\no x\nf -1 -2/1 -3//1\nl 1 2\n"
    );
    let library = "newmtl c\nKa 1 1 1\nKd 0.5\nNs 10\nd 0.5\nmap_Kd -s 1 1 1 a b.png\nbump -bm 1 n.png\n";
    let whole = format!("{library}\0{text}").into_bytes();
    // Numbers that look random and are the same each time.
    let mut state = 7u64;
    let mut random = move |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    for _ in 0..20_000 {
        let mut changed = whole.clone();
        for _ in 0..=random(5) {
            let at = random(changed.len());
            match random(3) {
                0 => changed[at] = b"0123456789-+./ \n\t\\efvnl\xFF"[random(24)],
                1 => drop(changed.remove(at)),
                _ => changed.insert(at, b"9-./ \ne\0"[random(8)]),
            }
        }
        let split = changed.iter().position(|byte| *byte == 0).unwrap_or(0);
        let (library, mesh) = changed.split_at(split);
        let named = |path: &Path| match path.extension()?.to_str()? {
            "png" => Some(Vec::new()),
            _ => Some(library.to_vec()),
        };
        let Ok((mesh, messages)) = parse_visual(mesh.to_vec(), Path::new("m.obj"), random(2) == 0, &named) else {
            continue;
        };
        assert!(messages.iter().all(|message| message.len() < 1500));
        for part in mesh.parts {
            let numbers = part.positions.as_flattened().iter().chain(part.normals.as_flattened());
            assert!(numbers
                .chain(part.tex_coords.as_flattened())
                .chain(part.tangents.as_flattened())
                .all(|x| x.is_finite()));
            assert!(part.triangles.as_flattened().iter().all(|i| (*i as usize) < part.positions.len()));
        }
    }
}
