//! Which files a scene is made of.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::Scene;
use crate::adf::{self, CollisionGeometry, Part, PartGeometry, RaySource, VisualGeometry, WheelVisual};
use crate::robot;

/// Images of a volume that are looked for.
const MAX_IMAGES: u32 = 4096;

impl Scene {
    /// All files that the scene was made of, as far as they are there: descriptions, meshes that collide or are drawn,
    /// images of volumes, what descriptions in MJCF include. Sorted, each once; absolute or relative to the working
    /// directory. Models that were removed count no more. Reads descriptions in MJCF.
    ///
    /// ## Limitations
    /// Without what meshes name themselves: textures, material files.
    pub fn used_files(&self) -> Vec<PathBuf> {
        let mut files = BTreeSet::new();
        let (origin, _) = self.origin();
        files.extend(origin.world.iter().cloned());
        files.extend(origin.models.iter().cloned());
        for model in self.models.iter().filter(|model| !model.removed) {
            files.insert(model.description.file.to_path_buf());
            add_files(&model.description, &mut files);
            add_included(&model.description.file, &mut files);
        }
        files.into_iter().filter(|file| file.is_file()).collect()
    }
}

fn add_files(model: &adf::Model, files: &mut BTreeSet<PathBuf>) {
    let mut collision = |geometry: &CollisionGeometry| match geometry {
        CollisionGeometry::Mesh { path, .. } => files.extend([path.clone()]),
        CollisionGeometry::Parts { parts, .. } => files.extend(parts.iter().filter_map(mesh_of)),
        CollisionGeometry::None | CollisionGeometry::Primitive { .. } | CollisionGeometry::Compound(_) => (),
    };
    model.bodies.iter().for_each(|body| collision(&body.collision));
    model.ghosts.iter().for_each(|ghost| collision(&ghost.collision));
    let visuals = model.bodies.iter().map(|body| &body.visual).chain(model.soft_bodies.iter().map(|soft| &soft.visual));
    for visual in visuals {
        match &visual.geometry {
            VisualGeometry::Mesh { path } => files.extend([path.clone()]),
            VisualGeometry::Parts(parts) => files.extend(parts.iter().filter_map(|part| mesh_of(&part.part))),
            VisualGeometry::None | VisualGeometry::Primitive(_) | VisualGeometry::Compound(_) => (),
        }
    }
    files.extend(model.soft_bodies.iter().map(|soft| soft.collision_mesh.clone()));
    let first = |candidates: &[PathBuf]| candidates.iter().find(|path| Path::is_file(path)).cloned();
    for sensor in &model.sensors {
        if let RaySource::Mesh { candidates } = &sensor.rays {
            files.extend(first(candidates));
        }
    }
    for wheel in model.vehicles.iter().flat_map(|vehicle| &vehicle.wheels) {
        if let WheelVisual::Mesh(candidates) = &wheel.visual {
            files.extend(first(candidates));
        }
    }
    for images in model.volumes.iter().filter_map(|volume| volume.images.as_ref()) {
        files.extend(images.files(MAX_IMAGES));
    }
    files.extend(model.volumes.iter().filter_map(|volume| volume.nrrd.clone()));
}

/// Adds what a description in MJCF includes.
fn add_included(file: &Path, files: &mut BTreeSet<PathBuf>) {
    if robot::is_robot(file) {
        // It was read before: what has become of it since is said by its hash.
        if let Ok((_, _, companions)) = robot::load_with_companions(file) {
            files.extend(companions.files.paths().map(Path::to_owned));
        }
    }
}

fn mesh_of(part: &Part) -> Option<PathBuf> {
    match &part.geometry {
        PartGeometry::Mesh { path, .. } => Some(path.clone()),
        PartGeometry::Primitive(_) | PartGeometry::Triangles(_) => None,
    }
}
