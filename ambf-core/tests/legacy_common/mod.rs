//! The scenes and meshes of the C++ program, which are not part of the repository.
// Each test uses a part of it.
#![allow(dead_code)]

use std::path::{Path, PathBuf};
use std::process::Command;

/// Folder of the legacy scenes and meshes, unpacked; `None`, with a line that says SKIPPED, when this checkout has none.
pub fn legacy() -> Option<PathBuf> {
    let unpack = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/legacy/unpack");
    if !unpack.exists() {
        println!("SKIPPED: no legacy scenes in ../shared/legacy");
        return None;
    }
    let output = Command::new(&unpack).output().expect("unpack runs");
    assert!(output.status.success(), "{output:?}");
    Some(PathBuf::from(String::from_utf8(output.stdout).expect("a path").trim()))
}

/// All mesh files below a folder.
pub fn mesh_files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in folder.read_dir().expect("readable folder").map(|e| e.expect("readable entry").path()) {
        if entry.is_dir() {
            found.extend(mesh_files(&entry));
        } else if ["stl", "obj", "3ds", "dae"].contains(&format_of(&entry).as_str()) {
            found.push(entry);
        }
    }
    found
}

/// Extension of a file in small letters.
pub fn format_of(file: &Path) -> String {
    file.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase()
}
