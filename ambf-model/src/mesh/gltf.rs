//! glTF 2.0.
use std::path::Path;
use super::visual::Details;
use super::{Files, Mesh, MeshError, Position};
/// Reads.
pub(super) fn read(path: &Path, _bytes: Vec<u8>, _files: &Files, _details: Option<&mut Details>) -> Result<Mesh, MeshError> {
    Err(MeshError::malformed(path, Position::Whole, "glTF is not read yet"))
}
