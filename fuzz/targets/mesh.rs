//! What every mesh reader promises, whatever the bytes.

use std::path::Path;

use ambf_model::mesh;

/// Reads `data` as a file of this name and checks the mesh or message that comes of it.
pub fn check(data: &[u8], name: &str) {
    let mesh = match mesh::parse(data.to_vec(), Path::new(name)) {
        Ok(mesh) => mesh,
        Err(error) => {
            let message = error.to_string();
            assert!(message.starts_with(name) && message.len() < 1000, "{message}");
            return;
        }
    };
    assert!(mesh.vertex_count() > 0);
    // Looks are read by the same reader and must not change what collides.
    let drawn = check_visual(data, name, &|_| None);
    assert!(drawn.is_none_or(|drawn| drawn == mesh.triangle_count()));
    for sub in &mesh.sub_meshes {
        let known = sub.vertices.len();
        assert!(sub.vertices.iter().flatten().all(|x| x.is_finite()));
        assert!(sub.triangles.iter().flatten().all(|&i| (i as usize) < sub.surface_vertices));
        assert!(sub.lines.iter().flatten().all(|&i| (i as usize) < known));
        assert!(sub.surface_vertices <= known && sub.file_vertices.iter().all(|&(_, i)| (i as usize) < known));
        assert!(sub.file_vertices.windows(2).all(|pair| pair[0].0 < pair[1].0));
    }
}

/// Reads how `data` looks and checks it; `named` gives the files that it names. Number of triangles, `None` if it is
/// refused.
pub fn check_visual(data: &[u8], name: &str, named: &dyn Fn(&Path) -> Option<Vec<u8>>) -> Option<usize> {
    let remove_duplicates = data.len() % 2 == 1;
    let (mesh, messages) = match mesh::parse_visual(data.to_vec(), Path::new(name), remove_duplicates, named) {
        Ok(read) => read,
        Err(error) => {
            let message = error.to_string();
            assert!(message.starts_with(name) && message.len() < 1000, "{message}");
            return None;
        }
    };
    assert!(messages.len() <= 51 && messages.iter().all(|message| message.len() < 2000), "{messages:?}");
    for part in &mesh.parts {
        let count = part.positions.len();
        assert!(part.nodes.len() == count && part.normals.len() == count && !part.triangles.is_empty());
        assert!(part.tex_coords.is_empty() || part.tex_coords.len() == count);
        assert!(part.colors.is_empty() || part.colors.len() == count);
        assert!(part.colors.as_flattened().iter().all(|x| (0.0..=1.0).contains(x)));
        assert!(part.tangents.is_empty() || part.tangents.len() == count);
        assert!(part.triangles.as_flattened().iter().all(|&i| (i as usize) < count));
        let vectors = part.positions.as_flattened().iter().chain(part.tangents.as_flattened());
        assert!(vectors.chain(part.tex_coords.as_flattened()).all(|x| x.is_finite()));
        assert!(part.normals.iter().all(|[x, y, z]| (x * x + y * y + z * z - 1.0).abs() < 1e-3));
        let material = &part.material;
        let colors = [material.ambient, material.diffuse, material.specular, material.emission];
        assert!(colors.as_flattened().iter().all(|x| x.is_finite()));
        assert!((0.0..=1.0).contains(&material.alpha) && (0.0..=128.0).contains(&material.shininess));
        let physical = material.physical.iter().flat_map(|physical| [physical.metallic, physical.roughness]);
        assert!(physical.into_iter().all(|x| (0.0..=1.0).contains(&x)));
    }
    Some(mesh.triangle_count())
}
