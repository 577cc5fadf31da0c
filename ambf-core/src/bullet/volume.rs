//! Volumes that collide: parts of bodies whose triangles Bullet's shape asks for brick by brick, from voxels that may change.

use std::ffi::c_void;
use std::ptr::NonNull;
use std::sync::Arc;

use ambf_dynamics::ffi as sys;
use ambf_volume::grid::EDGE;
use ambf_volume::surface::Patch;
use ambf_volume::VoxelGrid;
use nalgebra::Isometry3;

use super::world::VolumePartHandle;
use super::{raw_pose, BodyHandle, World};

/// What the shim's callbacks are given.
struct Source {
    grid: Arc<VoxelGrid>,
    patch: Patch,
}

/// A volume that is part of a body.
pub(super) struct VolumePart {
    pub(super) body: BodyHandle,
    /// Owned by the shape of the body.
    shape: NonNull<sys::AmbShape>,
    /// Owned by the shape.
    source: NonNull<Source>,
}

/// Three indices as numbers of the grid.
///
/// # Safety
/// `raw` points at three numbers, none of them negative.
unsafe fn indices(raw: *const i32) -> [usize; 3] {
    // SAFETY: that is the contract.
    unsafe { std::array::from_fn(|axis| *raw.add(axis) as usize) }
}

/// See `AmbVolumeSource::next`.
unsafe extern "C" fn next(data: *mut c_void, low: *const i32, high: *const i32, brick: *mut i32) -> i32 {
    // SAFETY: `data` is the source that the shape was made with, which nobody else uses during the call: the world is borrowed by
    // whoever steps it or casts rays. Indices are three numbers within the grid each, but for `brick`, which may be beyond in x.
    let (source, low, high, from) =
        unsafe { (&*data.cast::<Source>(), indices(low), indices(high), indices(brick.cast_const())) };
    let Some(found) = source.grid.next_surface_brick(low, high, from) else { return 0 };
    for (axis, index) in found.into_iter().enumerate() {
        // SAFETY: three numbers may be written.
        unsafe { *brick.add(axis) = index as i32 };
    }
    1
}

/// See `AmbVolumeSource::mesh`.
unsafe extern "C" fn mesh(data: *mut c_void, brick: *const i32, out: *mut sys::AmbBrickMesh) {
    // SAFETY: as in `next`; `out` may be written.
    let (Source { grid, patch }, brick, out) = unsafe { (&mut *data.cast::<Source>(), indices(brick), &mut *out) };
    grid.patch(brick, patch);
    patch.merge_flat();
    *out = sys::AmbBrickMesh {
        vertices: patch.vertices.as_ptr().cast(),
        triangles: patch.triangles.as_ptr().cast(),
        // A brick has less than 10⁴ triangles.
        vertex_count: patch.vertices.len() as i32,
        triangle_count: patch.triangles.len() as i32,
        own: patch.own as i32,
    };
}

/// See `AmbVolumeSource::release`.
unsafe extern "C" fn release(data: *mut c_void) {
    // SAFETY: `data` comes from `Box::into_raw` and is released once.
    drop(unsafe { Box::from_raw(data.cast::<Source>()) });
}

impl World {
    /// Lets a body collide with the surface of voxels, as well as with its shape; `pose` is that of the volume in the inertial
    /// frame. Mass and inertia stay. Contacts are those of concave meshes: volumes and planes do not touch each other. `None`: the handle is stale, or the body is a link of an articulation.
    pub fn add_volume(
        &mut self,
        handle: BodyHandle,
        grid: &Arc<VoxelGrid>,
        pose: &Isometry3<f64>,
    ) -> Option<VolumePartHandle> {
        let body = self.raw_body(handle)?;
        // SAFETY: the body is alive.
        if unsafe { sys::amb_body_is_link(body) } != 0 {
            return None;
        }
        let half = grid.edges() / 2.0;
        let most = half + grid.spacing() / 2.0;
        let source = Box::into_raw(Box::new(Source { grid: Arc::clone(grid), patch: Patch::default() }));
        let description = sys::AmbVolumeSource {
            bricks: grid.size().map(|edge| edge.div_ceil(EDGE) as i32),
            low: (-half).into(),
            brick: (grid.spacing() * EDGE as f64).into(),
            voxel: grid.spacing().into(),
            // What is solid at the walls of the box ends less than a voxel beyond the centres of its voxels, half a voxel beyond the
            // walls where the threshold is low.
            bounds: [-most.x, -most.y, -most.z, most.x, most.y, most.z],
            data: source.cast(),
            next: Some(next),
            mesh: Some(mesh),
            release: Some(release),
        };
        // SAFETY: the source is alive until it is released; numbers are read before the call returns.
        let shape = unsafe { sys::amb_shape_volume(&raw const description) };
        let (shape, source) = (NonNull::new(shape)?, NonNull::new(source)?);
        let whole = self.bodies.get(handle)?.shape();
        // In no arena, as all shapes: what is never written to is part of no saved state.
        // SAFETY: both shapes are alive; that of the body takes the other.
        unsafe { sys::amb_shape_add_part(whole, shape.as_ptr(), raw_pose(pose).as_ptr()) };
        let _arena = self.enter();
        self.structure += 1;
        // SAFETY: the body is in this world and no link.
        unsafe { sys::amb_body_shape_changed(body) };
        Some(self.volumes.insert(VolumePart { body: handle, shape, source }))
    }

    /// Gives a volume other voxels, of the same size, edges and threshold: the surface is made again where bricks of the two
    /// differ. `wakes`: bodies that sleep near it wake if something has changed.
    pub fn set_voxels(&mut self, handle: VolumePartHandle, grid: &Arc<VoxelGrid>, wakes: bool) {
        let Some(part) = self.volumes.get_mut(handle) else { return };
        // SAFETY: the shape owns the source, the body the shape, and the entry goes with the body; nothing steps the world now.
        let source = unsafe { part.source.as_mut() };
        if Arc::ptr_eq(&source.grid, grid) {
            return;
        }
        let mut is_changed = false;
        grid.for_changed_bricks(&source.grid, |first| {
            is_changed = true;
            let brick = first.map(|voxel| (voxel / EDGE) as i32);
            // SAFETY: the shape is alive and a volume.
            unsafe { sys::amb_shape_volume_changed(part.shape.as_ptr(), brick.as_ptr()) };
        });
        source.grid = Arc::clone(grid);
        let body = part.body;
        if let (true, true, Some(body)) = (is_changed, wakes, self.raw_body(body)) {
            let _arena = self.enter();
            // SAFETY: the body is alive.
            unsafe { sys::amb_body_wake_neighbours(body) };
        }
    }
}
