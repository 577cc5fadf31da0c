//! Whether the files that a file names are there.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use ambf_core::files::{look as look_at, Found};

use super::summary::Presence;

/// Files that were looked for on behalf of one file, each once.
#[derive(Debug, Default)]
pub(super) struct Files {
    meshes: BTreeMap<PathBuf, bool>,
    others: BTreeMap<PathBuf, bool>,
}

impl Files {
    /// Looks for a mesh; `None` when it is there, else why not.
    pub fn mesh(&mut self, path: &Path) -> Option<String> {
        look(&mut self.meshes, path)
    }

    /// The first of several places that exists, by its number; counted as one mesh.
    pub fn first_mesh(&mut self, candidates: &[PathBuf]) -> Option<usize> {
        let found = candidates.iter().position(|path| path.is_file());
        if let Some(path) = candidates.get(found.unwrap_or(0)) {
            self.meshes.insert(path.clone(), found.is_some());
        }
        found
    }

    /// Looks for a file that is no mesh.
    pub fn other(&mut self, path: &Path) -> Option<String> {
        look(&mut self.others, path)
    }

    pub fn meshes(&self) -> Presence {
        presence(&self.meshes)
    }

    pub fn others(&self) -> Presence {
        presence(&self.others)
    }
}

fn presence(files: &BTreeMap<PathBuf, bool>) -> Presence {
    Presence { named: files.len(), found: files.values().filter(|there| **there).count() }
}

fn look(known: &mut BTreeMap<PathBuf, bool>, path: &Path) -> Option<String> {
    let why = why_not(path);
    known.insert(path.to_owned(), why.is_none());
    why
}

/// Why there is no such file; `None` when there is one. Only its existence is asked for: opening a pipe would block.
fn why_not(path: &Path) -> Option<String> {
    let shown = path.display();
    match std::fs::metadata(path) {
        Ok(metadata) if metadata.is_file() => None,
        Ok(_) => Some(match look_at(path) {
            Found::Other(kind) => format!("{shown} is {kind}, expected a file"),
            _ => format!("{shown} is no file"),
        }),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Some(match other_case(path) {
            Some(name) => format!("{shown} does not exist; `{name}` does: names are case sensitive"),
            None => format!("{shown} does not exist"),
        }),
        Err(error) => Some(format!("{shown}: {error}")),
    }
}

/// Entries of a folder that are looked at for a name in other letter case.
const MAX_ENTRIES: usize = 10_000;

/// A file in the same folder whose name differs only in letter case.
fn other_case(path: &Path) -> Option<String> {
    let wanted = path.file_name()?.to_string_lossy().to_lowercase();
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let entries = std::fs::read_dir(folder).ok()?.take(MAX_ENTRIES).filter_map(Result::ok);
    let mut names: Vec<_> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names.into_iter().find(|name| name.to_lowercase() == wanted)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_file_counts_once_and_other_spellings_are_named() {
        let folder = std::env::temp_dir().join(format!("ambf_check_files_{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("A.STL"), "").unwrap();
        let mut files = Files::default();
        assert_eq!(files.mesh(&folder.join("A.STL")), None);
        assert_eq!(files.mesh(&folder.join("A.STL")), None);
        let why = files.mesh(&folder.join("a.stl")).expect("missing");
        assert!(why.contains("`A.STL`"), "{why}");
        let places = [folder.join("b.stl"), folder.join("A.STL")];
        assert_eq!((files.first_mesh(&places), files.first_mesh(&places[..1])), (Some(1), None));
        assert!(files.other(&folder).expect("a folder").ends_with("is a folder, expected a file"));
        assert_eq!(files.meshes(), Presence { named: 3, found: 1 });
        std::fs::remove_dir_all(folder).unwrap();
    }
}
