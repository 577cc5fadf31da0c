//! Files that keep convex hulls, so that a mesh is divided once and not at each start.
//!
//! A file is named by the [`Key`] of its hulls. All numbers in it are of 8 bytes, least significant byte first: a magic
//! number, the key (2), the number of hulls, for each hull its number of vertices and their coordinates, and a hash of
//! everything before. What is not exactly so is not used.

use std::io::Write;
use std::path::PathBuf;

use super::decompose::MAX_VERTICES;
use super::{Fnv, Hull, Key};
use crate::adf::ConvexDecomposition;
use crate::files::{self, Output, WriteError};
use crate::mesh::SubMesh;

/// First word of a file: "AMBFHUL1".
const MAGIC: u64 = u64::from_le_bytes(*b"AMBFHUL1");

/// Words of the largest file.
const MAX_WORDS: usize = 5 + ConvexDecomposition::MAX_HULLS as usize * (1 + 3 * MAX_VERTICES);

/// How far a vertex may lie outside the bounding box of its mesh, as a share of the size of the box: rounding.
const SLACK: f64 = 1e-9;

/// A folder with such files, which need not exist yet.
pub(super) struct Store(PathBuf);

impl Store {
    pub fn new(folder: PathBuf) -> Self {
        Self(folder)
    }

    fn path(&self, key: Key) -> PathBuf {
        self.0.join(format!("{:032x}.hulls", key.0))
    }

    /// The hulls that were kept under a key. `None`: there are none, or not such as `sub` could have.
    pub fn read(&self, key: Key, sub: &SubMesh) -> Option<Vec<Hull>> {
        let path = self.path(key);
        let bytes = files::read(&path, 8 * MAX_WORDS as u64).ok()?;
        if bytes.len() > 8 * MAX_WORDS {
            return None;
        }
        let (words, rest) = bytes.as_chunks::<8>();
        let words: Vec<u64> = words.iter().map(|&word| u64::from_le_bytes(word)).collect();
        let hulls = rest.is_empty().then(|| parse(key, &words))??;
        fits(&hulls, sub).then_some(hulls)
    }

    /// Keeps hulls under a key. Who reads at the same time finds the file of before or the new one.
    ///
    /// # Errors
    /// When the folder or the file cannot be written.
    pub fn write(&self, key: Key, hulls: &[Hull]) -> Result<(), WriteError> {
        let path = self.path(key);
        files::folder_for(&path)?;
        Output::write_whole(&path, |out| {
            words_of(key, hulls).into_iter().try_for_each(|word| out.write_all(&word.to_le_bytes()))
        })
    }
}

fn words_of(key: Key, hulls: &[Hull]) -> Vec<u64> {
    let mut words = vec![MAGIC, key.0 as u64, (key.0 >> 64) as u64, hulls.len() as u64];
    for hull in hulls {
        words.push(hull.len() as u64);
        words.extend(hull.as_flattened().iter().map(|x| x.to_bits()));
    }
    words.push(sum(&words));
    words
}

fn sum(words: &[u64]) -> u64 {
    let mut hash = Fnv::new();
    words.iter().for_each(|&word| hash.add(word));
    (hash.0 ^ hash.0 >> 64) as u64
}

fn parse(key: Key, words: &[u64]) -> Option<Vec<Hull>> {
    let (&end, words) = words.split_last()?;
    let [MAGIC, low, high, count, ref rest @ ..] = *words else { return None };
    if end != sum(words) || u128::from(low) | u128::from(high) << 64 != key.0 {
        return None;
    }
    let mut rest = rest;
    let mut hulls = Vec::new();
    for _ in 0..usize::try_from(count).ok().filter(|&count| count <= ConvexDecomposition::MAX_HULLS as usize)? {
        let (&vertices, after) = rest.split_first()?;
        let vertices = usize::try_from(vertices).ok().filter(|&vertices| vertices <= MAX_VERTICES)?;
        let coordinates = after.get(..3 * vertices)?;
        rest = &after[3 * vertices..];
        hulls.push(coordinates.as_chunks().0.iter().map(|vertex| vertex.map(f64::from_bits)).collect());
    }
    rest.is_empty().then_some(hulls)
}

/// Whether all vertices are within the bounding box of the sub-mesh.
fn fits(hulls: &[Hull], sub: &SubMesh) -> bool {
    (0..3).all(|axis| {
        let (low, high) = sub
            .vertices
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v[axis]), high.max(v[axis])));
        let slack = SLACK * (high - low + high.abs() + low.abs());
        hulls.iter().flatten().all(|v| v[axis] >= low - slack && v[axis] <= high + slack)
    })
}
