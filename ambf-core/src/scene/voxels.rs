//! Voxels of volumes: read once for all worlds of this process, and kept for as long as one of them uses them.

use std::path::PathBuf;
use std::sync::{Arc, LazyLock, Weak};

use ambf_volume::{nrrd, stack, Label, VoxelGrid};
use nalgebra::{Isometry3, Vector3};
use parking_lot::Mutex;

use super::progress::{Part, Progress};
use crate::adf::{self, ImageStack, VolumeLabel};
use crate::mesh::Sources;

/// All that voxels depend on, beside the contents of their files.
#[derive(Debug, Clone, PartialEq)]
struct Key {
    images: Option<ImageStack>,
    nrrd: Option<PathBuf>,
    edges: Option<Vector3<f64>>,
    iso: f64,
    labels: Vec<VolumeLabel>,
}

/// Voxels, and what was found when they were read.
#[derive(Debug, Clone)]
pub(super) struct ReadVoxels {
    pub grid: Arc<VoxelGrid>,
    /// Where the file says that the volume is.
    pub pose: Isometry3<f64>,
    /// For the load report.
    pub notes: Vec<String>,
}

/// What some world has read.
struct Kept {
    key: Key,
    grid: Weak<VoxelGrid>,
    pose: Isometry3<f64>,
    notes: Vec<String>,
    sources: Sources,
}

static KEPT: LazyLock<Mutex<Vec<Kept>>> = LazyLock::new(Mutex::default);

/// Voxels that a scene needs which is being built.
#[derive(Default)]
pub(super) struct VoxelFiles(Mutex<Vec<(Key, Result<ReadVoxels, String>)>>);

impl VoxelFiles {
    /// Reads the voxels of a volume, unless they are there.
    pub fn preload(&self, volume: &adf::Volume, progress: &Progress) {
        let Some(key) = Key::of(volume) else { return };
        if self.0.lock().iter().all(|(known, _)| *known != key) {
            let read = key.shared(progress);
            self.0.lock().push((key, read));
        }
    }

    /// The voxels of a volume, or why there are none; `None`: none are asked for.
    pub fn get(&self, volume: &adf::Volume) -> Option<Result<ReadVoxels, String>> {
        let key = Key::of(volume)?;
        self.preload(volume, &Progress::default());
        self.0.lock().iter().find(|(known, _)| *known == key).map(|(_, read)| read.clone())
    }
}

impl Key {
    fn of(volume: &adf::Volume) -> Option<Self> {
        let adf::Volume { images, nrrd, dimensions, scale, .. } = volume;
        let nrrd = nrrd.clone().filter(|_| images.is_none());
        if images.is_none() && nrrd.is_none() {
            return None;
        }
        let is_given = images.is_some() || volume.has_dimensions;
        Some(Self {
            images: images.clone(),
            nrrd,
            edges: is_given.then(|| dimensions * *scale),
            iso: volume.iso_surface_value,
            labels: volume.labels.clone(),
        })
    }

    /// What another world has read, if it would be read again now; else reads it.
    fn shared(&self, progress: &Progress) -> Result<ReadVoxels, String> {
        let known = {
            let kept = KEPT.lock();
            let known = kept.iter().filter(|kept| kept.key == *self);
            let read = |kept: &Kept| {
                let grid = kept.grid.upgrade()?;
                let (pose, notes) = (kept.pose, kept.notes.clone());
                Some((ReadVoxels { grid, pose, notes }, kept.sources.clone()))
            };
            known.filter_map(read).collect::<Vec<_>>()
        };
        // Files are asked for without the lock: they may be on a slow network.
        if let Some((read, _)) = known.into_iter().find(|(_, sources)| sources.are_current()) {
            return Ok(read);
        }
        let mut sources = Sources::default();
        let files = self.images.as_ref().map(|images| images.files(stack::MAX_PICTURES)).unwrap_or_default();
        files.iter().chain(&self.nrrd).for_each(|file| sources.add(file));
        if let Some(images) = &self.images {
            // A picture that comes changes the folder.
            sources.add(&images.path);
        }
        let is_settled = sources.are_settled();
        let read = self.read(progress)?;
        if is_settled && sources.are_current() {
            let mut kept = KEPT.lock();
            kept.retain(|kept| kept.grid.strong_count() > 0);
            let grid = Arc::downgrade(&read.grid);
            kept.push(Kept { key: self.clone(), grid, pose: read.pose, notes: read.notes.clone(), sources });
        }
        Ok(read)
    }

    fn read(&self, progress: &Progress) -> Result<ReadVoxels, String> {
        let (mut grid, pose, mut notes) = match (&self.images, &self.nrrd) {
            (Some(images), _) => {
                progress.begin(Part::Voxels, images.count as usize);
                let reached = |done, _| progress.reach(done);
                let edges = self.edges.unwrap_or(Vector3::repeat(1.0));
                let grid = stack::read(images, edges, self.iso, &reached).map_err(|error| error.to_string())?;
                (grid, Isometry3::identity(), Vec::new())
            }
            (None, Some(file)) => {
                progress.begin(Part::Voxels, 1);
                let nrrd::Loaded { mut grid, pose, notes } =
                    nrrd::read(file, self.iso).map_err(|error| error.to_string())?;
                if let Some(edges) = self.edges {
                    grid.set_edges(edges).map_err(|error| error.to_string())?;
                }
                let notes = notes.into_iter().map(|note| format!("{}: {note}", file.display())).collect();
                (grid, pose, notes)
            }
            (None, None) => return Err("neither pictures nor a file are named".to_owned()),
        };
        if !self.labels.is_empty() {
            let of_file =
                |label: &VolumeLabel| Label { color: label.color, name: label.name.clone(), hardness: label.hardness };
            let labels: Vec<_> = self.labels.iter().map(of_file).collect();
            for unknown in grid.describe_labels(&labels) {
                let [r, g, b] = unknown.color;
                notes.push(format!("no voxel has the colour of label `{}` ({r}, {g}, {b})", unknown.name));
            }
        }
        Ok(ReadVoxels { grid: Arc::new(grid), pose, notes })
    }
}
