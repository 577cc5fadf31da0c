//! Model files of other people, and the world that they are loaded into.

use std::path::{Path, PathBuf};

/// The world of the simulator without options.
pub fn default_world() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../resources/world/world.yaml")
}

/// All files with the name of a model (`.yaml`, `.yml`, `.urdf`) that are `paths` or below them, in the order of their
/// names.
pub fn below(paths: &[PathBuf]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    paths.iter().for_each(|path| add(path, &mut found));
    found
}

fn add(path: &Path, found: &mut Vec<PathBuf>) {
    if path.is_dir() {
        let mut entries: Vec<_> =
            std::fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
        entries.sort();
        entries.iter().for_each(|entry| add(entry, found));
    } else if path.extension().is_some_and(|extension| extension == "yaml" || extension == "yml" || extension == "urdf")
    {
        found.push(path.to_owned());
    }
}
