//! Reads every mesh of the legacy scenes, where they have been unpacked; says SKIPPED otherwise.

use std::collections::BTreeMap;
use std::time::Instant;

use ambf_model::mesh::{load, MeshCache, MeshError};
use ambf_test_support::{format_of, legacy, mesh_files};

#[test]
fn every_legacy_mesh_is_read() {
    let Some(folder) = legacy() else { return };
    let files = mesh_files(&folder);
    assert!(files.len() > 1000, "only {} mesh files in {}", files.len(), folder.display());

    let cache = MeshCache::new();
    let requests: Vec<_> = files.iter().map(|f| (f.clone(), 1.0)).collect();
    let start = Instant::now();
    cache.preload(&requests, &|| ());
    let elapsed = start.elapsed();

    let mut per_format: BTreeMap<String, (usize, usize, usize)> = BTreeMap::new();
    for file in &files {
        let Ok(mesh) = cache.get(file, 1.0) else { continue };
        let counts = per_format.entry(format_of(file)).or_default();
        counts.0 += 1;
        counts.1 += mesh.triangle_count();
        counts.2 += mesh.vertex_count();
        for sub in &mesh.sub_meshes {
            let known = sub.vertices.len() as u32;
            assert!(sub.triangles.iter().flatten().chain(sub.lines.iter().flatten()).all(|&i| i < known));
        }
    }
    for (format, (count, triangles, vertices)) in &per_format {
        println!("{format}: {count} files, {triangles} triangles, {vertices} vertices");
    }
    // Some exports of things that are not meshes are a bare header; no scene uses them, and the C++ program refuses
    // them too.
    let (empty, broken): (Vec<_>, Vec<_>) =
        cache.errors().into_iter().partition(|e| matches!(**e, MeshError::Empty { .. }));
    println!("{} files in {:.3} s, {} of them empty", files.len(), elapsed.as_secs_f64(), empty.len());
    for error in &empty {
        let MeshError::Empty { path } = &**error else { unreachable!("partitioned above") };
        assert_eq!(path.metadata().expect("existing file").len(), 84, "{} has triangles", path.display());
    }
    let broken: Vec<_> = broken.iter().map(ToString::to_string).collect();
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

/// The nodes of a soft body are the welded vertices in order, so a trace of the C++ program shows its order.
#[test]
fn cloth_vertices_come_in_the_recorded_order() {
    let Some(folder) = legacy() else { return };
    let mesh = load(&folder.join("descriptions/multi-bodies/sb/low_res/cloth.3DS")).expect("readable cloth");
    assert_eq!(mesh.sub_meshes.len(), 1);
    // Some nodes of the trace at step 0; the body stands at y = 2.
    for (node, recorded) in [
        (0, [-0.389722645283, 2.67708837986, 0.0]),
        (7, [-0.389722645283, 1.49218374491, -0.00436517223716]),
        (21, [0.389722645283, 1.32291162014, -0.00436517223716]),
        (42, [0.389722645283, 2.50781625509, -0.0218258611858]),
        (385, [-0.389722645283, 1.83072790504, -0.0349213778973]),
    ] {
        let [x, y, z] = mesh.sub_meshes[0].vertices[node];
        for (ours, theirs) in [x, y + 2.0, z].into_iter().zip(recorded) {
            assert!((ours - theirs).abs() < 1e-10, "node {node}: {:?}, recorded {recorded:?}", [x, y + 2.0, z]);
        }
    }
}
