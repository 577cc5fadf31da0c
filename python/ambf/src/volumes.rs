//! Volumes for Python: what is asked of voxels, and cuts.

use std::path::Path;

use ambf_core::comm::CarveCommand;
use ambf_core::ids::VolumeId;
use ambf_core::scene::{Scene, VolumeError};
use ambf_core::text::lines;
use ambf_core::volume::save::save;
use ambf_core::volume::{Carved, Rule, Shape, VoxelGrid};
use nalgebra::{Isometry3, Point3, Vector3};
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::world::Physics;

/// Voxels along x, y and z; edges of a voxel, m; pose in the world; (labels) name, colour and hardness.
pub type Info = ([usize; 3], [f64; 3], [f64; 7], Vec<(String, [u8; 3], f64)>);

/// (voxels x 3) indices, (voxels x 4) colours, (voxels x 1) labels, volume in m³.
pub type Cut<'py> = (Bound<'py, PyArray2<u32>>, Bound<'py, PyArray2<u8>>, Bound<'py, PyArray1<u8>>, f64);

/// (z x y x x) densities and labels.
pub type Voxels<'py> = (Bound<'py, PyArray3<u8>>, Bound<'py, PyArray3<u8>>);

/// Names of all volumes that are in the scene.
pub fn names(scene: &Scene) -> Vec<String> {
    ids(scene).map(|id| scene.volumes[id].attached.identity.key()).collect()
}

fn ids(scene: &Scene) -> impl Iterator<Item = VolumeId> + '_ {
    let there = scene
        .volumes
        .entries()
        .filter(|(_, volume)| scene.models.get(volume.attached.identity.model).is_some_and(|model| !model.removed));
    there.map(|(id, _)| id)
}

/// The volume at an index.
pub fn id(scene: &Scene, volume: usize) -> Result<VolumeId, VolumeError> {
    ids(scene).nth(volume).ok_or(VolumeError::Unknown)
}

fn grid(scene: &Scene, volume: usize) -> Result<(&VoxelGrid, Isometry3<f64>), VolumeError> {
    let volume = &scene.volumes[id(scene, volume)?];
    let grid = volume.voxels().ok_or_else(|| VolumeError::Empty(volume.attached.identity.key()))?;
    Ok((grid, scene.global_pose(volume.attached.parent, &volume.attached.pose)))
}

/// The exception for a volume that cannot be used so.
pub fn error(problem: &VolumeError) -> PyErr {
    PyValueError::new_err(lines(&problem.to_string()).into_owned())
}

/// What of a volume does not change when it is cut, and where it is.
pub fn info(scene: &Scene, volume: usize) -> Result<Info, VolumeError> {
    let (grid, pose) = grid(scene, volume)?;
    let (position, turn) = (pose.translation.vector, pose.rotation.coords);
    let labels = grid.labels().iter().map(|label| (label.name.clone(), label.color, label.hardness)).collect();
    let pose = [position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w];
    Ok((grid.size(), grid.spacing().into(), pose, labels))
}

/// A shape of its name and numbers, m.
pub fn shape(kind: &str, numbers: &[f64], voxels: Vec<[i64; 3]>) -> PyResult<Shape> {
    match (kind, numbers) {
        ("sphere", &[radius]) => Ok(Shape::Sphere { radius }),
        ("capsule", &[radius, half_length]) => Ok(Shape::Capsule { radius, half_length }),
        ("box", &[x, y, z]) => Ok(Shape::Box { half_edges: 0.5 * Vector3::new(x, y, z) }),
        ("voxels", []) => Ok(Shape::Voxels(voxels)),
        _ => Err(PyValueError::new_err(format!("{} is no shape with {} numbers", lines(kind), numbers.len()))),
    }
}

/// Cuts; what was removed.
pub fn carve(physics: &mut Physics, volume: usize, command: &CarveCommand) -> Result<Carved, VolumeError> {
    let volume = id(physics.stepper.simulation().scene(), volume)?;
    physics.stepper.carve(volume, command)
}

/// What was removed, as arrays.
pub fn cut(py: Python<'_>, carved: Carved) -> PyResult<Cut<'_>> {
    let count = carved.indices.len();
    let indices = PyArray1::from_vec(py, carved.indices.into_iter().flatten().collect::<Vec<_>>());
    let colors = PyArray1::from_vec(py, carved.colors.into_iter().flatten().collect::<Vec<_>>());
    let labels = PyArray1::from_vec(py, carved.labels);
    Ok((indices.reshape([count, 3])?, colors.reshape([count, 4])?, labels, carved.volume))
}

/// Densities and labels of all voxels.
pub fn voxels<'py>(py: Python<'py>, grid: &VoxelGrid) -> PyResult<Voxels<'py>> {
    let (densities, labels) = py.detach(|| grid.to_arrays());
    let [x, y, z] = grid.size();
    let shaped = |all: Vec<u8>| PyArray1::from_vec(py, all).reshape([z, y, x]);
    Ok((shaped(densities)?, shaped(labels)?))
}

/// (points x 4) distance, m, and the direction in which it grows, world axes; a distance is infinite where nothing is
/// within `most` m.
pub fn distances(
    scene: &Scene,
    volume: usize,
    points: &[[f64; 3]],
    label: Option<u8>,
    most: f64,
) -> Result<Vec<f64>, VolumeError> {
    let (grid, pose) = grid(scene, volume)?;
    let mut numbers = Vec::with_capacity(4 * points.len());
    for point in points {
        let local = pose.inverse_transform_point(&Point3::from(*point));
        match grid.distance(&local, label, most) {
            Some(found) => {
                numbers.push(found.distance);
                numbers.extend((pose * found.gradient).iter());
            }
            None => numbers.extend([f64::INFINITY, 0.0, 0.0, 0.0]),
        }
    }
    Ok(numbers)
}

/// The voxels of now, which stay as they are when the volume is cut.
pub fn shared(scene: &Scene, volume: usize) -> Result<std::sync::Arc<VoxelGrid>, VolumeError> {
    let found = &scene.volumes[id(scene, volume)?];
    found.voxels().cloned().ok_or_else(|| VolumeError::Empty(found.attached.identity.key()))
}

/// Where a volume is, in the frame of its parent: what its file or its location says.
pub fn location(scene: &Scene, volume: usize) -> Result<Isometry3<f64>, VolumeError> {
    Ok(scene.volumes[id(scene, volume)?].attached.pose)
}

/// Writes voxels to files, with the pose of the volume.
pub fn write(grid: &VoxelGrid, path: &Path, prefix: &str, pose: &Isometry3<f64>) -> PyResult<()> {
    save(grid, path, prefix, pose).map_err(|problem| {
        let message = lines(&problem.to_string()).into_owned();
        pyo3::exceptions::PyOSError::new_err(message)
    })
}

/// How much is removed, by its name: `all`, `rate` in m³/s during s, `count` of voxels.
pub fn rule(kind: &str, numbers: &[f64]) -> PyResult<Rule> {
    match (kind, numbers) {
        ("all", []) => Ok(Rule::All),
        ("rate", &[rate, interval]) => Ok(Rule::Rate { rate, interval }),
        ("count", &[count]) if count >= 0.0 && count < f64::from(u32::MAX) => Ok(Rule::Count(count as usize)),
        _ => Err(PyValueError::new_err(format!("{} is no rule with {} numbers", lines(kind), numbers.len()))),
    }
}
