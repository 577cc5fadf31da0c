//! Reads how every mesh of the legacy scenes looks, where they have been unpacked; says SKIPPED otherwise.

use std::time::Instant;

use ambf_model::mesh::{load, load_both, MeshError};
use ambf_test_support::{legacy, mesh_files};

#[test]
fn every_legacy_mesh_can_be_drawn() {
    let Some(folder) = legacy() else { return };
    let files = mesh_files(&folder);
    assert!(files.len() > 1000, "only {} mesh files in {}", files.len(), folder.display());

    let start = Instant::now();
    let (mut drawn, mut empty, mut triangles, mut vertices, mut textured) = (0, 0, 0, 0, 0);
    let mut messages = Vec::new();
    for (number, file) in files.iter().enumerate() {
        // Both ways of normals are tried; each file one of them.
        let remove_duplicates = number % 3 == 0;
        let (mesh, visual, notes) = match load_both(file, remove_duplicates) {
            Ok(both) => both,
            // A bare header; no scene uses it.
            Err(MeshError::Empty { .. }) => {
                empty += 1;
                continue;
            }
            Err(error) => panic!("{error}"),
        };
        // What collides is the same, whether or not looks are read with it.
        assert!(mesh == load(file).expect("read before"), "{}", file.display());
        assert_eq!(visual.triangle_count(), mesh.triangle_count(), "{}", file.display());
        let nodes: Vec<[f64; 3]> = mesh.sub_meshes.iter().flat_map(|sub| sub.vertices.iter().copied()).collect();
        for part in &visual.parts {
            let count = part.positions.len();
            assert!(part.nodes.len() == count && part.normals.len() == count);
            assert!(part.tex_coords.is_empty() || part.tex_coords.len() == count);
            assert!(part.triangles.as_flattened().iter().all(|&i| (i as usize) < count));
            for (position, &node) in part.positions.iter().zip(&part.nodes) {
                assert_eq!(*position, nodes[node as usize].map(|x| x as f32), "{}", file.display());
            }
            for [x, y, z] in &part.normals {
                assert!((x * x + y * y + z * z - 1.0).abs() < 1e-4, "{}: normal {x} {y} {z}", file.display());
            }
            assert!(part.tex_coords.as_flattened().iter().all(|x| x.is_finite()));
            vertices += count;
            textured += usize::from(part.material.diffuse_map.is_some());
        }
        triangles += visual.triangle_count();
        drawn += 1;
        messages.extend(notes);
    }
    let elapsed = start.elapsed().as_secs_f64();
    println!("{drawn} files, {triangles} triangles, {vertices} vertices, {textured} textured parts, {elapsed:.1} s");
    println!("{empty} files are empty; {} messages, for example:", messages.len());
    messages.iter().step_by(messages.len() / 8 + 1).for_each(|message| println!("  {message}"));
    assert!(textured > 40, "only {textured} parts have a texture");
    // Nothing else than files that the archive has not got.
    for message in &messages {
        assert!(message.contains("is not there"), "{message}");
    }
}
