//! What every mesh reader promises, whatever the bytes.

use std::path::Path;

use ambf_core::mesh;

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
    for sub in &mesh.sub_meshes {
        let known = sub.vertices.len();
        assert!(sub.vertices.iter().flatten().all(|x| x.is_finite()));
        assert!(sub.triangles.iter().flatten().all(|&i| (i as usize) < sub.surface_vertices));
        assert!(sub.lines.iter().flatten().all(|&i| (i as usize) < known));
        assert!(sub.surface_vertices <= known && sub.file_vertices.iter().all(|&(_, i)| (i as usize) < known));
        assert!(sub.file_vertices.windows(2).all(|pair| pair[0].0 < pair[1].0));
    }
}
