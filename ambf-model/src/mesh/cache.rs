//! Meshes shared between bodies.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread;

use parking_lot::Mutex;

use super::{check_finite, load_with_sources, Mesh, MeshError, Sources};

/// One thread loads, while others that want the same wait without a lock on the whole.
type Cell = Arc<OnceLock<Result<Arc<Mesh>, Arc<MeshError>>>>;

/// Canonical path and bit pattern of the scale.
type Key = (PathBuf, u64);

/// Loads every mesh file once, and makes every scaled copy once.
///
/// The key is the canonical path, so that different spellings of a path share a mesh, and the scale. Errors are kept
/// too: a file is tried once, and all who ask for it get the same `Arc`. May be used from several threads.
#[derive(Debug, Default)]
pub struct MeshCache {
    outcomes: Mutex<HashMap<Key, Cell>>,
    /// What each file was read from, by its canonical path.
    sources: Mutex<HashMap<PathBuf, Sources>>,
}

impl MeshCache {
    /// An empty cache.
    pub fn new() -> Self {
        Self::default()
    }

    /// The mesh in file `path`, positions multiplied by `scale` (dimensionless).
    ///
    /// # Errors
    /// As [`load`](super::load); [`MeshError::Scale`] when `scale` is not finite, [`MeshError::NonFinite`] when scaling overflows.
    pub fn get(&self, path: &Path, scale: f64) -> Result<Arc<Mesh>, Arc<MeshError>> {
        if !scale.is_finite() {
            return Err(Arc::new(MeshError::Scale { path: path.to_path_buf(), scale }));
        }
        let cell = self.cell(path, scale);
        let outcome = cell.get_or_init(|| {
            if scale == 1.0 {
                self.read(path).map(Arc::new).map_err(Arc::new)
            } else {
                scaled(path, &*self.get(path, 1.0)?, scale).map(Arc::new).map_err(Arc::new)
            }
        });
        outcome.clone()
    }

    fn read(&self, path: &Path) -> Result<Mesh, MeshError> {
        let mut sources = Sources::default();
        let read = load_with_sources(path, &mut sources);
        self.sources.lock().insert(canonical(path), sources);
        read
    }

    /// The files that the mesh in file `path` was made of; `None`: nobody has asked for it.
    pub fn sources(&self, path: &Path) -> Option<Sources> {
        self.sources.lock().get(&canonical(path)).cloned()
    }

    fn cell(&self, path: &Path, scale: f64) -> Cell {
        let mut outcomes = self.outcomes.lock();
        Arc::clone(outcomes.entry((canonical(path), scale.to_bits())).or_default())
    }

    /// Loads all `requests` (path, scale) on as many threads as the machine has cores. What fails is found again by
    /// [`get`](Self::get) and [`errors`](Self::errors). `after_each` is called after each of them, by these threads.
    pub fn preload(&self, requests: &[(PathBuf, f64)], after_each: &(dyn Fn() + Sync)) {
        if requests.is_empty() {
            // Counting cores reads files of the system.
            return;
        }
        let next = AtomicUsize::new(0);
        let workers = thread::available_parallelism().map_or(1, usize::from).min(requests.len());
        thread::scope(|scope| {
            for _ in 0..workers {
                scope.spawn(|| {
                    while let Some((path, scale)) = requests.get(next.fetch_add(1, Ordering::Relaxed)) {
                        // The outcome stays in the cache.
                        let _ = self.get(path, *scale);
                        after_each();
                    }
                });
            }
        });
    }

    /// Every error of [`get`](Self::get) so far once, however many asked for the file, sorted by message.
    pub fn errors(&self) -> Vec<Arc<MeshError>> {
        let outcomes = self.outcomes.lock();
        let mut errors: Vec<_> = outcomes.values().filter_map(|cell| cell.get()?.as_ref().err().cloned()).collect();
        errors.sort_by_cached_key(|e| e.to_string());
        // A scaled request hands on the error of the file itself.
        errors.dedup_by(|a, b| Arc::ptr_eq(a, b));
        errors
    }
}

fn canonical(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_path_buf())
}

fn scaled(path: &Path, mesh: &Mesh, scale: f64) -> Result<Mesh, MeshError> {
    let mesh = mesh.scaled(scale);
    for sub in &mesh.sub_meshes {
        for (i, vertex) in sub.vertices.iter().enumerate() {
            check_finite(path, i, *vertex)?;
        }
    }
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let dir = std::env::temp_dir().join(format!("ambf_{name}_{}", std::process::id()));
        std::fs::create_dir_all(&dir).unwrap();
        std::fs::write(dir.join("a.obj"), "v 0 0 0\nv 1 0 0\nv 0 1e300 0\nf 1 2 3\n").unwrap();
        std::fs::write(dir.join("bad.obj"), "v 0 0\n").unwrap();
        dir
    }

    #[test]
    fn a_mesh_is_shared_by_canonical_path_and_scale() {
        let dir = folder("cache_share");
        let cache = MeshCache::new();
        cache.preload(&[(dir.join("a.obj"), 1.0), (dir.join("./a.obj"), 0.5), (dir.join("a.obj"), 1.0)], &|| ());
        // Served from memory from here on.
        let one = cache.get(&dir.join("a.obj"), 1.0).unwrap();
        assert!(Arc::ptr_eq(&one, &cache.get(&dir.join(".").join("a.obj"), 1.0).unwrap()));
        let half = cache.get(&dir.join("a.obj"), 0.5).unwrap();
        assert!(Arc::ptr_eq(&half, &cache.get(&dir.join("a.obj"), 0.5).unwrap()));
        assert_eq!(half.sub_meshes[0].vertices[1], [0.5, 0.0, 0.0]);
        assert!(cache.errors().is_empty());
        std::fs::remove_dir_all(dir).unwrap();
    }

    #[test]
    fn errors_are_kept_once_a_file() {
        let dir = folder("cache_errors");
        let cache = MeshCache::new();
        let requests: Vec<_> = [1.0, 2.0, 3.0].iter().map(|&s| (dir.join("bad.obj"), s)).collect();
        cache.preload(&requests, &|| ());
        cache.preload(&[(dir.join("absent.stl"), 1.0)], &|| ());
        assert_eq!(cache.errors().len(), 2);
        assert!(cache.errors()[0].to_string().contains("absent.stl"));
        // A file repaired later does not change what others already got.
        std::fs::write(dir.join("bad.obj"), "v 0 0 0\n").unwrap();
        let first = cache.get(&dir.join("bad.obj"), 1.0).unwrap_err();
        assert!(Arc::ptr_eq(&first, &cache.get(&dir.join("bad.obj"), 2.0).unwrap_err()));
        std::fs::remove_dir_all(dir).unwrap();
    }

    #[test]
    fn a_scale_that_breaks_the_numbers_is_refused() {
        let dir = folder("cache_scale");
        let cache = MeshCache::new();
        let get = |scale| cache.get(&dir.join("a.obj"), scale).unwrap_err();
        assert!(matches!(*get(f64::NAN), MeshError::Scale { .. }));
        assert!(matches!(*get(1e10), MeshError::NonFinite { vertex: 2, .. }));
        std::fs::remove_dir_all(dir).unwrap();
    }
}
