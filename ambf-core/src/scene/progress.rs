//! How far loading is.

use std::fmt;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How far [`load_with_progress`](super::load_with_progress) is, for another thread to show while large scenes are
/// loaded. Written as `meshes: 3 of 45`.
#[derive(Debug, Default)]
pub struct Progress {
    part: AtomicUsize,
    done: AtomicUsize,
    all: AtomicUsize,
}

/// Parts of loading after the first, in which files are read.
#[derive(Debug, Clone, Copy)]
pub(super) enum Part {
    Meshes = 1,
    Hulls,
    Models,
    Articulations,
    Voxels,
}

const PARTS: [&str; 6] = [
    "files",
    "meshes",
    "meshes divided into convex hulls",
    "models built",
    "joints put together",
    "pictures of volumes",
];

impl Progress {
    /// A part begins that consists of `all` pieces.
    pub(super) fn begin(&self, part: Part, all: usize) {
        self.done.store(0, Ordering::Relaxed);
        self.all.store(all, Ordering::Relaxed);
        self.part.store(part as usize, Ordering::Relaxed);
    }

    /// So many of the pieces are done.
    pub(super) fn reach(&self, done: usize) {
        self.done.fetch_max(done, Ordering::Relaxed);
    }

    /// A piece is done.
    pub(super) fn advance(&self) {
        self.done.fetch_add(1, Ordering::Relaxed);
    }
}

impl fmt::Display for Progress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [part, done, all] = [&self.part, &self.done, &self.all].map(|number| number.load(Ordering::Relaxed));
        write!(f, "{}", PARTS[part])?;
        if all > 1 {
            write!(f, ": {} of {all}", done.min(all))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_says_what_is_done_of_how_much() {
        let progress = Progress::default();
        assert_eq!(progress.to_string(), "files");
        progress.begin(Part::Hulls, 3);
        progress.advance();
        assert_eq!(progress.to_string(), "meshes divided into convex hulls: 1 of 3");
        progress.begin(Part::Articulations, 1);
        assert_eq!(progress.to_string(), "joints put together");
    }
}
