//! What tests of several packages need: where the scenes, meshes, traces and pictures of the C++ program are, which are
//! not part of the repository.

#[cfg(feature = "ros")]
pub mod ros;

use std::path::{Path, PathBuf};
use std::process::Command;

/// Folder with what belongs to others; `None`, with a line that says SKIPPED, when this checkout has none.
pub fn shared() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared").canonicalize().ok();
    if folder.is_none() {
        eprintln!("SKIPPED: no folder ../shared with scenes, traces and pictures of the C++ program");
    }
    folder
}

/// Folder of the legacy scenes and meshes, unpacked; `None`, with a line that says SKIPPED, when this checkout has
/// none.
///
/// # Panics
/// When they cannot be unpacked.
pub fn legacy() -> Option<PathBuf> {
    let output = Command::new(shared()?.join("legacy/unpack")).output().expect("unpack runs");
    assert!(output.status.success(), "{output:?}");
    Some(PathBuf::from(String::from_utf8(output.stdout).expect("a path").trim()))
}

/// All mesh files below a folder that can be read.
///
/// # Panics
/// When the folder cannot be read.
pub fn mesh_files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in folder.read_dir().expect("readable folder").map(|e| e.expect("readable entry").path()) {
        if entry.is_dir() {
            found.extend(mesh_files(&entry));
        } else if ["stl", "obj", "3ds", "dae", "ply", "gltf", "glb", "msh"].contains(&format_of(&entry).as_str()) {
            found.push(entry);
        }
    }
    found
}

/// Extension of a file in small letters.
pub fn format_of(file: &Path) -> String {
    file.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase()
}
