//! Convex hulls that stand for meshes which are not convex: made once, then kept in memory and on disk.
//!
//! [`decompose`](decompose::decompose) divides a mesh, [`store`] keeps the result in a file, and [`HullCache`] does
//! both on demand.

mod decompose;
mod store;

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::Arc;

use parking_lot::Mutex;

use self::decompose::{decompose, Divided};
use self::store::Store;
use super::progress::{Part, Progress};
use super::voxels::VoxelFiles;
use crate::adf::{ConvexDecomposition, Severity};
use crate::mesh::{enclosed_volume, has_holes, Mesh, MeshCache, SubMesh};

/// Share of a hull that its mesh does not enclose, from which on it is said.
const HOLLOW: f64 = 0.5;

/// Vertices (n × 3) of a convex hull in the frame of its mesh, m.
pub(super) type Hull = Vec<[f64; 3]>;

/// The convex hulls (vertices, n × 3, m) that collide instead of a sub-mesh with `collision mesh type:
/// CONVEX_DECOMPOSITION`, made anew: what a scene does, without its files. The whole sub-mesh as one hull if it cannot
/// be divided; none if it has no triangle.
pub fn convex_hulls(sub: &SubMesh, wanted: &ConvexDecomposition) -> Vec<Vec<[f64; 3]>> {
    HullCache::in_folder(None).hulls_of(sub, wanted).to_vec()
}

/// What the convex hull of a mesh does to its shape, if users should know it.
pub(super) fn hull_remark(sub: &SubMesh) -> Option<String> {
    const KEEPS: &str = "`collision mesh type: CONVEX_DECOMPOSITION` of a model file keeps them";
    if has_holes(&sub.triangles) {
        return Some(format!("the convex hull of its collision mesh closes the holes in it; {KEEPS}"));
    }
    let enclosed = enclosed_volume(&sub.vertices, &sub.triangles)?;
    let filled = 1.0 - enclosed / decompose::hull_volume(&sub.vertices);
    let percent = 100.0 * filled;
    (filled > HOLLOW)
        .then(|| format!("the convex hull of its collision mesh fills hollows, {percent:.0} % of it; {KEEPS}"))
}

/// What names the hulls of a sub-mesh: a hash of its surface and of the parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Key(u128);

/// A mesh file, its scale, and how it is divided.
pub(super) type WantedHulls = (PathBuf, f64, ConvexDecomposition);

/// What collision shapes and volumes are made from.
pub(super) struct CollisionMeshes {
    /// Mesh files.
    pub files: MeshCache,
    /// Convex hulls that stand for parts of them.
    pub hulls: HullCache,
    /// Voxels of volumes.
    pub voxels: VoxelFiles,
}

impl CollisionMeshes {
    /// Nothing is read yet.
    pub fn new() -> Self {
        Self { files: MeshCache::new(), hulls: HullCache::new(), voxels: VoxelFiles::default() }
    }
}

/// Convex hulls of the sub-meshes of a scene.
pub(super) struct HullCache {
    store: Option<Store>,
    made: Mutex<HashMap<Key, Arc<[Hull]>>>,
    remarks: Mutex<Vec<(Severity, String)>>,
}

impl HullCache {
    /// A cache that keeps hulls in `ambf/convex-hulls` of the user's cache folder: `$XDG_CACHE_HOME`, else
    /// `$HOME/.cache`; in memory only if there is neither.
    pub fn new() -> Self {
        let folder = |name| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
        let home = folder("XDG_CACHE_HOME").or_else(|| Some(folder("HOME")?.join(".cache")));
        Self::in_folder(home.map(|home| home.join("ambf").join("convex-hulls")))
    }

    fn in_folder(folder: Option<PathBuf>) -> Self {
        Self { store: folder.map(Store::new), made: Mutex::default(), remarks: Mutex::default() }
    }

    /// The hulls of a sub-mesh; none if it has no surface.
    pub fn hulls_of(&self, sub: &SubMesh, wanted: &ConvexDecomposition) -> Arc<[Hull]> {
        let key = Key::of(sub, wanted);
        if let Some(known) = self.made.lock().get(&key) {
            return Arc::clone(known);
        }
        // Two threads may make the same hulls: both get the same ones.
        let hulls: Arc<[Hull]> = self.read_or_make(key, sub, wanted).into();
        if decompose::close_up(sub, &hulls) {
            let message = "the convex hulls of its collision mesh partly close its holes or hollows; more hulls, a finer resolution or a \
                           lower concavity (`convex decomposition` of a model file) keep them open";
            self.remark(Severity::Info, message.to_owned());
        }
        self.made.lock().insert(key, Arc::clone(&hulls));
        hulls
    }

    /// What users should know of the hulls that were made since the last call.
    pub fn take_remarks(&self) -> Vec<(Severity, String)> {
        std::mem::take(&mut *self.remarks.lock())
    }

    /// Makes hulls of all sub-meshes of these meshes, in parallel. Meshes that cannot be read are left out.
    pub fn preload(&self, meshes: &MeshCache, wanted: &[WantedHulls], progress: &Progress) {
        let read: Vec<(Arc<Mesh>, ConvexDecomposition)> = wanted
            .iter()
            .filter_map(|(path, scale, parameters)| Some((meshes.get(path, *scale).ok()?, *parameters)))
            .collect();
        let jobs: Vec<(&SubMesh, &ConvexDecomposition)> = read
            .iter()
            .flat_map(|(mesh, parameters)| mesh.sub_meshes.iter().map(move |sub| (sub, parameters)))
            .collect();
        let mut seen = std::collections::HashSet::new();
        let jobs: Vec<_> = jobs.into_iter().filter(|(sub, parameters)| seen.insert(Key::of(sub, parameters))).collect();
        progress.begin(Part::Hulls, jobs.len());
        if jobs.is_empty() {
            // Counting cores reads files of the system.
            return;
        }
        let threads = std::thread::available_parallelism().map_or(1, usize::from).min(jobs.len());
        let next = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for _ in 0..threads {
                scope.spawn(|| {
                    while let Some((sub, parameters)) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
                        self.hulls_of(sub, parameters);
                        progress.advance();
                    }
                });
            }
        });
    }

    fn read_or_make(&self, key: Key, sub: &SubMesh, wanted: &ConvexDecomposition) -> Vec<Hull> {
        if let Some(kept) = self.store.as_ref().and_then(|store| store.read(key, sub)) {
            return kept;
        }
        match decompose(sub, wanted) {
            Divided::Hulls(hulls) => {
                if let Some(Err(error)) = self.store.as_ref().map(|store| store.write(key, &hulls)) {
                    self.remark(Severity::Info, format!("its convex hulls are made at each start: {error}"));
                }
                hulls
            }
            Divided::NoSurface => Vec::new(),
            Divided::Failed => {
                let message = "a part of its mesh could not be divided into convex hulls; the hull of the whole part \
                               is used";
                self.remark(Severity::Warning, message.to_owned());
                vec![sub.vertices[..sub.surface_vertices.min(sub.vertices.len())].to_vec()]
            }
        }
    }

    fn remark(&self, severity: Severity, message: String) {
        self.remarks.lock().push((severity, message));
    }
}

impl Key {
    /// Changes with everything that the hulls depend on, the method included.
    fn of(sub: &SubMesh, wanted: &ConvexDecomposition) -> Self {
        let ConvexDecomposition { hulls, resolution, concavity } = *wanted;
        let mut hash = Fnv::new();
        let head = [decompose::METHOD, hulls.into(), resolution.into(), concavity.to_bits()];
        head.into_iter().for_each(|word| hash.add(word));
        [sub.vertices.len(), sub.triangles.len()].into_iter().for_each(|count| hash.add(count as u64));
        sub.vertices.as_flattened().iter().for_each(|x| hash.add(x.to_bits()));
        sub.triangles.as_flattened().iter().for_each(|&corner| hash.add(corner.into()));
        Self(hash.0)
    }
}

/// The hash FNV-1a of 128 bits (Fowler, Noll, Vo), over words instead of bytes.
struct Fnv(u128);

impl Fnv {
    fn new() -> Self {
        Self(0x6c62_272e_07bb_0142_62b8_2175_6295_c58d)
    }

    fn add(&mut self, word: u64) {
        self.0 = (self.0 ^ u128::from(word)).wrapping_mul(0x0100_0000_0000_0000_0000_013b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A block of 3 × 1 × 1 m on whose ends stand blocks of 1 m: a U, closed, 2 m high.
    pub(super) fn channel() -> SubMesh {
        let mut sub = SubMesh::default();
        for [low, high] in
            [[[0.0, 0.0, 0.0], [3.0, 1.0, 1.0]], [[0.0, 0.0, 1.0], [1.0, 1.0, 2.0]], [[2.0, 0.0, 1.0], [3.0, 1.0, 2.0]]]
        {
            let first = sub.vertices.len() as u32;
            let corner =
                |i: usize| [0, 1, 2].map(|axis: usize| if i >> axis & 1 == 0 { low[axis] } else { high[axis] });
            sub.vertices.extend((0..8).map(corner));
            let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
            for [a, b, c, d] in faces {
                sub.triangles.extend([[a, b, c], [a, c, d]].map(|triangle| triangle.map(|corner: u32| corner + first)));
            }
        }
        sub.surface_vertices = sub.vertices.len();
        sub
    }

    fn bits(hulls: &[Hull]) -> Vec<u64> {
        hulls.iter().flat_map(|hull| hull.as_flattened().iter().map(|x| x.to_bits())).collect()
    }

    #[test]
    fn hulls_are_kept_on_disk_and_read_again() {
        let folder = tempfile::tempdir().expect("a folder");
        let place = folder.path().join("ambf").join("convex-hulls");
        let cache = || HullCache::in_folder(Some(place.clone()));
        let (sub, wanted) = (channel(), ConvexDecomposition::default());
        let made = cache().hulls_of(&sub, &wanted);
        assert_eq!(made.len(), 3, "{made:?}");
        let files: Vec<_> = std::fs::read_dir(&place).expect("the folder").map(|file| file.unwrap().path()).collect();
        let [file] = &files[..] else { panic!("one file instead of {files:?}") };
        let written = std::fs::read(file).expect("readable");

        // What is in the file counts, as long as it can be what was written: here a hull was moved by 0.5 m.
        let moved: Vec<Hull> =
            made.iter().map(|hull| hull.iter().map(|&[x, y, z]| [x, 0.5 * y, z]).collect()).collect();
        cache().store.expect("a store").write(Key::of(&sub, &wanted), &moved).expect("writable");
        let again = cache();
        assert_eq!(bits(&again.hulls_of(&sub, &wanted)), bits(&moved));
        assert!(again.take_remarks().is_empty());

        // A file that is damaged, cut short, empty, another mesh's or no file: made and written again.
        let mut damaged = written.clone();
        damaged[100] ^= 1;
        let mut foreign = written.clone();
        foreign[12] ^= 1;
        let long = [&written[..], &[0]].concat();
        for wrong in [&damaged, &foreign, &long, &written[..written.len() - 1], &[], b"something else"] {
            std::fs::write(file, wrong).expect("writable");
            assert_eq!(bits(&cache().hulls_of(&sub, &wanted)), bits(&made));
            assert_eq!(std::fs::read(file).expect("readable"), written);
        }
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_worth_a_note() {
        let folder = tempfile::tempdir().expect("a folder");
        let blocked = folder.path().join("file");
        std::fs::write(&blocked, "no folder").expect("writable");
        let cache = HullCache::in_folder(Some(blocked.join("ambf")));
        assert_eq!(cache.hulls_of(&channel(), &ConvexDecomposition::default()).len(), 3);
        let remarks = cache.take_remarks();
        let [(Severity::Info, message)] = &remarks[..] else { panic!("{remarks:?}") };
        assert!(message.contains(&blocked.display().to_string()), "{message}");
        // Not once for each body.
        cache.hulls_of(&channel(), &ConvexDecomposition::default());
        assert!(cache.take_remarks().is_empty());
    }

    #[test]
    fn keys_change_with_the_mesh_and_the_parameters() {
        let wanted = ConvexDecomposition::default();
        let mut keys = vec![Key::of(&channel(), &wanted)];
        keys.push(Key::of(&channel(), &ConvexDecomposition { hulls: 31, ..wanted }));
        keys.push(Key::of(&channel(), &ConvexDecomposition { resolution: 63, ..wanted }));
        keys.push(Key::of(&channel(), &ConvexDecomposition { concavity: 0.006, ..wanted }));
        let mut sub = channel();
        sub.vertices[3][1] += 1e-15;
        keys.push(Key::of(&sub, &wanted));
        sub.triangles.swap(0, 1);
        keys.push(Key::of(&sub, &wanted));
        let different: std::collections::HashSet<_> = keys.iter().collect();
        assert_eq!(different.len(), keys.len());
        assert_eq!(keys[0], Key::of(&channel(), &wanted));
    }
}
