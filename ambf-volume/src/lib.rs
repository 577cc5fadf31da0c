//! Volumes of voxels: scans that are touched, cut, measured and saved.
//!
//! | module | what is in it |
//! |---|---|
//! | [`grid`] | the voxels: bricks that copies share, and which of them are solid or at a surface |
//! | [`query`] | the nearest voxel, sweeps, rays, distances, without allocation |
//! | [`carve`] | cutting: what a moving shape removes, and at which rate |
//! | [`proxy`] | contact of a tool: where it may be, and the force on the hand |
//! | [`surface`] | the isosurface as triangles |
//! | [`stack`], [`nrrd`], [`save`] | files |
//! | [`texture`] | pictures |
//!
//! All is in the volume's frame, whose origin is the centre of the box, in SI units.

pub mod carve;
pub mod grid;
pub mod nrrd;
pub mod proxy;
pub mod query;
pub mod save;
pub mod stack;
pub mod surface;
pub mod texture;

mod bits;

pub use carve::{Carved, Carver, Rule, Shape, Stroke};
pub use grid::{Coloring, GridError, Label, Voxel, VoxelGrid};

use std::sync::atomic::{AtomicUsize, Ordering};

/// Results of `make` for 0 … `count` − 1, in order, made on as many threads as there are processors.
pub(crate) fn parallel<T: Send>(count: usize, make: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(count);
    if threads <= 1 {
        return (0..count).map(make).collect();
    }
    let next = AtomicUsize::new(0);
    let work = || {
        let mut made = Vec::new();
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            if at >= count {
                return made;
            }
            made.push((at, make(at)));
        }
    };
    let mut all: Vec<_> = std::thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(work)).collect();
        let mut all = work();
        for other in others {
            match other.join() {
                Ok(made) => all.extend(made),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        all
    });
    all.sort_unstable_by_key(|(at, _)| *at);
    all.into_iter().map(|(_, made)| made).collect()
}
