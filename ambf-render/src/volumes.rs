//! Volumes: voxels as textures in three dimensions.

use std::sync::Arc;

use ambf_core::adf::Volume;
use ambf_core::volume::grid::EDGE;
use ambf_core::volume::{Coloring, VoxelGrid};

use crate::gl::{self, Current};

/// Most bytes of the voxels of a volume.
const MAX_BYTES: usize = 1 << 30;

/// Most boxes in which voxels that were cut are sent.
const MAX_BOXES: usize = 32;

/// Voxels on the graphics card.
pub(crate) struct Voxels {
    /// Red, green, blue and density; of grey voxels the density is all four.
    pub(crate) texture: gl::Texture,
    /// The largest density that interpolation can find in each brick.
    pub(crate) blocks: gl::Texture,
    /// Voxels along x, y and z.
    size: [usize; 3],
    is_grey: bool,
}

/// Voxels as a volume shows them.
#[derive(Clone)]
pub(crate) struct Isosurface {
    pub(crate) voxels: Arc<Voxels>,
    /// The density beyond which a place is inside, 0 to 1.
    pub(crate) value: f32,
    /// Samples along a ray, 1/m.
    pub(crate) samples: f32,
    /// Factor on the colours of the voxels.
    pub(crate) tint: f32,
}

impl Isosurface {
    /// `diagonal` of the box in m.
    pub(crate) fn new(voxels: &Arc<Voxels>, volume: &Volume, diagonal: f64) -> Self {
        let most = voxels.size.iter().max().copied().unwrap_or(1) as f64;
        let samples = (4.0 * volume.quality * most).clamp(1.0, 16384.0);
        let value = volume.iso_surface_value as f32;
        Self {
            voxels: Arc::clone(voxels),
            value,
            samples: (samples / diagonal) as f32,
            // Beside the surface interpolation mixes colours with those outside, black, as it mixes densities.
            tint: if voxels.is_grey { 1.0 } else { 1.0 / value.max(1.0 / 255.0) },
        }
    }
}

/// The voxels that are loaded, with what they show: equal ones once.
#[derive(Default)]
pub(crate) struct Stacks {
    loaded: Vec<(Arc<VoxelGrid>, Arc<Voxels>)>,
    /// Bytes of voxels that were sent to the graphics card.
    pub(crate) sent: u64,
}

impl Stacks {
    /// Loads voxels, unless they are there.
    pub(crate) fn load(&mut self, gl: &Current<'_>, grid: &Arc<VoxelGrid>) -> Result<Arc<Voxels>, String> {
        if let Some((_, voxels)) = self.loaded.iter().find(|(known, _)| Arc::ptr_eq(known, grid)) {
            return Ok(Arc::clone(voxels));
        }
        let size = grid.size();
        let most = gl.device().most_texels_of_volumes;
        if let Some(edge) = size.into_iter().find(|&edge| edge > most) {
            return Err(format!("{edge} voxels in a row; {most} are possible here: reduce the resolution"));
        }
        let channels = grid.channels();
        let bytes = size.iter().product::<usize>() * channels;
        if bytes > MAX_BYTES {
            let (there, most) = (bytes >> 20, MAX_BYTES >> 20);
            return Err(format!("its voxels need {there} MiB; at most {most} are possible: reduce the resolution"));
        }
        let count = size.map(|edge| edge.div_ceil(EDGE));
        let stored = gl.volume(size, &grid.texels([0; 3], size), channels).and_then(|texture| {
            let blocks = gl.volume(count, &grid.largest_densities([0; 3], count), 1)?;
            Ok((texture, blocks))
        });
        let (texture, blocks) = stored.map_err(|error| error.to_string())?;
        self.sent += bytes as u64;
        let voxels = Arc::new(Voxels { texture, blocks, size, is_grey: grid.coloring() == Coloring::Grey });
        self.loaded.push((Arc::clone(grid), Arc::clone(&voxels)));
        Ok(voxels)
    }

    /// Lets `shown`, of which one item has the only copy beside ours, show `now`: bricks that changed are sent. What
    /// others show, too, is loaded anew.
    pub(crate) fn follow(
        &mut self,
        gl: &Current<'_>,
        shown: &mut Arc<Voxels>,
        now: &Arc<VoxelGrid>,
    ) -> Result<(), String> {
        let Some(place) = self.loaded.iter().position(|(_, voxels)| Arc::ptr_eq(voxels, shown)) else { return Ok(()) };
        let before = Arc::clone(&self.loaded[place].0);
        if Arc::ptr_eq(&before, now) {
            return Ok(());
        }
        let is_known = self.loaded.iter().any(|(known, _)| Arc::ptr_eq(known, now));
        if is_known || Arc::strong_count(shown) > 2 || before.size() != now.size() {
            *shown = self.load(gl, now)?;
            self.prune();
            return Ok(());
        }
        self.loaded[place].0 = Arc::clone(now);
        let size = now.size();
        let bricks = size.map(|edge| edge.div_ceil(EDGE));
        for (low, high) in boxes(&now.changed_bricks(&before)) {
            let first = low.map(|brick| brick * EDGE);
            let end: [usize; 3] = std::array::from_fn(|axis| (high[axis] * EDGE).min(size[axis]));
            let texels = now.texels(first, end);
            gl.update_volume(&shown.texture, first, end, &texels, now.channels()).map_err(|error| error.to_string())?;
            self.sent += texels.len() as u64;
            // Neighbours may have lost a voxel beside them.
            let low = low.map(|brick| brick.saturating_sub(1));
            let high = std::array::from_fn(|axis| (high[axis] + 1).min(bricks[axis]));
            let largest = now.largest_densities(low, high);
            gl.update_volume(&shown.blocks, low, high, &largest, 1).map_err(|error| error.to_string())?;
        }
        Ok(())
    }

    /// Lets those go that no scene has any more.
    pub(crate) fn prune(&mut self) {
        self.loaded.retain(|(_, voxels)| Arc::strong_count(voxels) > 1);
    }
}

/// Boxes, by places of bricks from a lowest up to one without it, that hold all bricks whose first voxels are given.
fn boxes(changed: &[[usize; 3]]) -> Vec<([usize; 3], [usize; 3])> {
    let mut bricks: Vec<_> = changed.iter().map(|first| first.map(|i| i / EDGE)).collect();
    bricks.sort_unstable_by_key(|&[x, y, z]| (z, y, x));
    let mut boxes: Vec<_> = bricks.into_iter().map(|brick| (brick, brick.map(|b| b + 1))).collect();
    // What is joined along an axis has the same extent along the others.
    for axis in 0..3 {
        boxes.sort_by_key(|(low, high): &([usize; 3], [usize; 3])| {
            let others = [(axis + 1) % 3, (axis + 2) % 3].map(|other| (low[other], high[other]));
            (others, low[axis])
        });
        boxes.dedup_by(|next, kept| {
            let is_beside = next.0[axis] == kept.1[axis];
            let is_same =
                |other: usize| other == axis || (next.0[other], next.1[other]) == (kept.0[other], kept.1[other]);
            let joins = is_beside && (0..3).all(is_same);
            if joins {
                kept.1[axis] = next.1[axis];
            }
            joins
        });
    }
    boxes.sort_unstable_by_key(|&([x, y, z], _)| (z, y, x));
    let around = |group: &[([usize; 3], [usize; 3])]| {
        let low = |axis: usize| group.iter().map(|(low, _)| low[axis]).min().unwrap_or(0);
        let high = |axis: usize| group.iter().map(|(_, high)| high[axis]).max().unwrap_or(0);
        (std::array::from_fn(low), std::array::from_fn(high))
    };
    boxes.chunks(boxes.len().div_ceil(MAX_BOXES).max(1)).map(around).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_boxes_hold_all_that_changed() {
        let cube: Vec<[usize; 3]> = (0..27).map(|at| [at % 3, at / 3 % 3, at / 9].map(|b| (b + 4) * EDGE)).collect();
        assert_eq!(boxes(&cube), [([4; 3], [7; 3])]);
        let scattered: Vec<[usize; 3]> =
            (0..500).map(|at| [at * 7 % 64, at * 13 % 64, at * 29 % 64].map(|b| b * EDGE)).collect();
        let found = boxes(&scattered);
        assert!(found.len() <= MAX_BOXES);
        for brick in scattered.iter().map(|first| first.map(|i| i / EDGE)) {
            let holds = |(low, high): &([usize; 3], [usize; 3])| (0..3).all(|a| (low[a]..high[a]).contains(&brick[a]));
            assert!(found.iter().any(holds), "{brick:?}");
        }
        assert!(boxes(&[]).is_empty());
    }
}
