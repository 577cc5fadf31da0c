//! Voxels as files that others read: stacks of pictures, and the surface as STL or PLY.

use std::io::{self, Cursor, Write};
use std::path::{Path, PathBuf};

use ambf_model::files::{folder_for, Output, WriteError};
use image::{ExtendedColorType, ImageEncoder};
use nalgebra::Isometry3;
use thiserror::Error;

use crate::surface::Mesh;
use crate::{nrrd, Coloring, VoxelGrid};

/// Error when voxels cannot be saved.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SaveError {
    /// Error when a file cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// Error when the extension names no format.
    #[error("{}: unknown format; end the name in .nrrd, .stl or .ply, or name a folder", path.display())]
    Format {
        /// What was asked for.
        path: PathBuf,
    },
    /// Error when a picture cannot be encoded.
    #[error("{}: {what}", path.display())]
    Encode {
        /// The file.
        path: PathBuf,
        /// What the encoder said.
        what: String,
    },
}

/// Saves voxels as what the name says: `.nrrd`, `.stl` or `.ply`; a name without an extension is a folder, in which the
/// pictures `prefix<i>.png` are made. `pose` is that of the box's centre, left-posterior-superior, which only `.nrrd`
/// holds; meshes are in the volume's frame.
///
/// # Errors
/// [`SaveError`].
pub fn save(grid: &VoxelGrid, path: &Path, prefix: &str, pose: &Isometry3<f64>) -> Result<(), SaveError> {
    match path.extension().map(|extension| extension.to_ascii_lowercase()) {
        None => pictures(grid, path, prefix).map(|_| ()),
        Some(extension) if extension == "nrrd" => Ok(nrrd::write(grid, path, pose)?),
        Some(extension) if extension == "stl" => Ok(stl(&grid.mesh(), path)?),
        Some(extension) if extension == "ply" => Ok(ply(&grid.mesh(), path)?),
        Some(_) => Err(SaveError::Format { path: path.to_path_buf() }),
    }
}

/// Writes a picture a layer, `folder/prefix<i>.png` from 0 on, row 0 of the voxels lowest: what the C++ program loads
/// with these `images`. Returns their number.
///
/// # Errors
/// [`SaveError`].
pub fn pictures(grid: &VoxelGrid, folder: &Path, prefix: &str) -> Result<usize, SaveError> {
    let [width, height, depth] = grid.size();
    let grey = grid.coloring() == Coloring::Grey;
    let kind = match grid.coloring() {
        Coloring::Grey => (1, ExtendedColorType::L8),
        Coloring::Opaque => (3, ExtendedColorType::Rgb8),
        Coloring::Labels => (4, ExtendedColorType::Rgba8),
    };
    folder_for(&folder.join("picture"))?;
    let written = crate::parallel(depth, |z| {
        let path = folder.join(format!("{prefix}{z}.png"));
        let mut pixels = Vec::with_capacity(width * height * kind.0);
        for j in (0..height).rev() {
            for i in 0..width {
                let color = grid.color([i, j, z]).unwrap_or_default();
                pixels.extend_from_slice(if grey { &color[..1] } else { &color[..kind.0] });
            }
        }
        let mut png = Cursor::new(Vec::new());
        let encoder = image::codecs::png::PngEncoder::new(&mut png);
        encoder
            .write_image(&pixels, width as u32, height as u32, kind.1)
            .map_err(|error| SaveError::Encode { path: path.clone(), what: error.to_string() })?;
        Output::write_whole(&path, |file| file.write_all(png.get_ref()))?;
        Ok(())
    });
    written.into_iter().collect::<Result<Vec<_>, SaveError>>().map(|written| written.len())
}

/// Writes a binary STL, m.
///
/// # Errors
/// [`WriteError`].
pub fn stl(mesh: &Mesh, path: &Path) -> Result<(), WriteError> {
    Output::write_whole(path, |file| {
        let mut out = io::BufWriter::new(file);
        out.write_all(&[0; 80])?;
        out.write_all(&(mesh.triangles.len() as u32).to_le_bytes())?;
        for triangle in &mesh.triangles {
            let corners = triangle.map(|v| mesh.vertices[v as usize]);
            let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
            let normal = normal.try_normalize(0.0).unwrap_or_default();
            let numbers = normal.iter().chain(corners.iter().flat_map(|corner| corner.iter()));
            for number in numbers {
                out.write_all(&(*number as f32).to_le_bytes())?;
            }
            out.write_all(&[0; 2])?;
        }
        out.flush()
    })
}

/// Writes a binary PLY with shared vertices, m.
///
/// # Errors
/// [`WriteError`].
pub fn ply(mesh: &Mesh, path: &Path) -> Result<(), WriteError> {
    Output::write_whole(path, |file| {
        let mut out = io::BufWriter::new(file);
        write!(
            out,
            "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty double x\nproperty double y\n\
             property double z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
            mesh.vertices.len(),
            mesh.triangles.len()
        )?;
        for number in mesh.vertices.iter().flat_map(|vertex| vertex.iter()) {
            out.write_all(&number.to_le_bytes())?;
        }
        for triangle in &mesh.triangles {
            out.write_all(&[3])?;
            for vertex in triangle {
                out.write_all(&vertex.to_le_bytes())?;
            }
        }
        out.flush()
    })
}
