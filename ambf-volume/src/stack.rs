//! Stacks of pictures as voxels: voxel (x, y, z) is the pixel in column x and row y, counted from below, of picture z.
//!
//! The density is alpha; of grey pictures without transparency it is the grey, of coloured ones the brightest channel.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::Arc;

use ambf_model::adf::ImageStack;
use nalgebra::Vector3;
use thiserror::Error;

use crate::grid::{cells_of, check_size, index_of, Block, Cells, CELLS, EDGE, MAX_LABELS};
use crate::texture::{Texture, TextureError};
use crate::{Coloring, GridError, Label, Voxel, VoxelGrid};

/// Numbers of pictures that are tried.
pub const MAX_PICTURES: u32 = 10_000;

/// Error when a stack of pictures cannot be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum StackError {
    /// Error when no picture is there.
    #[error("no picture is there, for example {}", example.display())]
    NoPicture {
        /// A name that was looked for.
        example: PathBuf,
    },
    /// Error when a picture cannot be read.
    #[error(transparent)]
    Picture(#[from] TextureError),
    /// Error when pictures differ in size.
    #[error("{} has {} x {} pixels, {} has {} x {}: all pictures of a volume have one size",
        file.display(), size[0], size[1], first.display(), of_first[0], of_first[1])]
    Sizes {
        /// The picture that differs.
        file: PathBuf,
        /// Its columns and rows.
        size: [u32; 2],
        /// The first picture.
        first: PathBuf,
        /// Its columns and rows.
        of_first: [u32; 2],
    },
    /// Error when the voxels are too many, or the edges of their box unusable.
    #[error(transparent)]
    Grid(#[from] GridError),
}

/// Eight pictures as bricks, with labels of their own.
struct Layer {
    /// (bricks along y × x).
    cells: Vec<Cells>,
    /// Colours of the labels 1 …; empty where there are too many, and blocks have colours.
    palette: Vec<[u8; 3]>,
    is_colored: bool,
    is_transparent: bool,
}

/// A stack in memory, before it is known what its densities are.
struct Reader<'a> {
    files: &'a [PathBuf],
    size: [usize; 3],
    /// Blocks keep colours: there are too many for labels.
    exact: AtomicBool,
    read: AtomicUsize,
    progress: &'a (dyn Fn(usize, usize) + Sync),
}

/// Reads a stack into a box of `edges`, m; voxels of a density of `iso`, 0 to 1, and more are solid. Pictures are decoded
/// on as many threads as there are processors; `progress` is told how many of how many are read.
///
/// # Errors
/// [`StackError`]. Sizes are checked before memory is taken.
pub fn read(
    stack: &ImageStack,
    edges: Vector3<f64>,
    iso: f64,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<VoxelGrid, StackError> {
    let files = stack.files(MAX_PICTURES);
    let Some(first) = files.first() else {
        return Err(StackError::NoPicture { example: stack.candidates(0).next().unwrap_or_default() });
    };
    let picture = Texture::load(first)?;
    let size = [picture.width as usize, picture.height as usize, files.len()];
    check_size(size)?;
    let mut grid = VoxelGrid::new(size, edges, iso)?;
    let reader = Reader { files: &files, size, exact: AtomicBool::new(false), read: AtomicUsize::new(0), progress };
    let mut layers = reader.layers()?;
    let mut colors: BTreeSet<[u8; 3]> = layers.iter().flat_map(|layer| layer.palette.iter().copied()).collect();
    let is_colored = layers.iter().any(|layer| layer.is_colored);
    let is_exact = || reader.exact.load(Ordering::Relaxed);
    if is_exact() || is_colored && colors.len() > MAX_LABELS {
        // Rare: more colours than labels can name. The pictures are read once more, with a colour for each voxel.
        reader.exact.store(true, Ordering::Relaxed);
        layers = reader.layers()?;
        colors.clear();
    }
    let is_transparent = layers.iter().any(|layer| layer.is_transparent);
    let coloring = match (is_colored, is_transparent) {
        (false, _) => Coloring::Grey,
        (true, false) => Coloring::Opaque,
        (true, true) => Coloring::Labels,
    };
    let places: BTreeMap<[u8; 3], u8> =
        colors.iter().take(MAX_LABELS).zip(1..).map(|(color, label)| (*color, label)).collect();
    let is_plain = coloring == Coloring::Grey || is_exact();
    let labels = match is_plain {
        true => vec![Label::of_color([255; 3])],
        false => colors.iter().map(|&color| Label::of_color(color)).collect(),
    };
    grid.set_labels(labels, coloring);
    let finished = crate::parallel(layers.len(), |z| {
        let layer = &layers[z];
        let named: Vec<u8> = layer.palette.iter().map(|color| if is_plain { 1 } else { places[color] }).collect();
        layer.cells.iter().map(|cells| finish(cells, layer, &named, coloring)).collect::<Vec<_>>()
    });
    drop(layers);
    let across = size[0].div_ceil(EDGE);
    for (z, cells) in finished.into_iter().enumerate() {
        for (at, cells) in cells.into_iter().enumerate() {
            grid.set_cells([at % across, at / across, z], cells);
        }
    }
    grid.rebuild();
    Ok(grid)
}

/// Voxels of a brick as they are, from alpha and the labels of a layer.
fn finish(cells: &Cells, layer: &Layer, named: &[u8], coloring: Coloring) -> Cells {
    let voxel = |density: u8, label: u8, color: Option<[u8; 3]>| {
        if label == 0 {
            return Voxel::default();
        }
        let place = usize::from(label) - 1;
        let color = color.unwrap_or_else(|| layer.palette.get(place).copied().unwrap_or_default());
        let density = match coloring {
            Coloring::Labels => density,
            Coloring::Grey => color[0],
            Coloring::Opaque => color.into_iter().fold(0, u8::max),
        };
        let label = named.get(place).copied().unwrap_or(1);
        if density == 0 {
            Voxel::default()
        } else {
            Voxel { density, label }
        }
    };
    match cells {
        Cells::Uniform(old) => Cells::Uniform(voxel(old.density, old.label, None)),
        Cells::Mixed(old) => {
            let mut block = Block::clone(old);
            for cell in 0..CELLS {
                let color = old.colors.as_ref().map(|colors| colors[cell]);
                let new = voxel(old.density[cell], old.label[cell], color);
                (block.density[cell], block.label[cell]) = (new.density, new.label);
            }
            if coloring == Coloring::Grey {
                block.colors = None;
            }
            cells_of(block)
        }
    }
}

impl Reader<'_> {
    fn layers(&self) -> Result<Vec<Layer>, StackError> {
        self.read.store(0, Ordering::Relaxed);
        let made = crate::parallel(self.size[2].div_ceil(EDGE), |z| self.layer(z));
        made.into_iter().collect()
    }

    fn layer(&self, z: usize) -> Result<Layer, StackError> {
        let files = &self.files[z * EDGE..(z * EDGE + EDGE).min(self.size[2])];
        let mut pictures = Vec::with_capacity(files.len());
        for file in files {
            let picture = Texture::load(file)?;
            let of_first = [self.size[0] as u32, self.size[1] as u32];
            if [picture.width, picture.height] != of_first {
                let (size, first) = ([picture.width, picture.height], self.files[0].clone());
                return Err(StackError::Sizes { file: file.clone(), size, first, of_first });
            }
            (self.progress)(self.read.fetch_add(1, Ordering::Relaxed) + 1, self.files.len());
            pictures.push(picture.rgba);
        }
        let [width, height, _] = self.size;
        let exact = self.exact.load(Ordering::Relaxed);
        let mut layer = Layer { cells: Vec::new(), palette: Vec::new(), is_colored: false, is_transparent: false };
        let mut last = ([0; 3], 0_u8);
        let bricks = [width, height].map(|edge| edge.div_ceil(EDGE));
        for at in 0..bricks[0] * bricks[1] {
            let first = [at % bricks[0] * EDGE, at / bricks[0] * EDGE, 0];
            let mut block = Block::uniform(Voxel::default());
            block.colors = exact.then(|| Box::new([[0; 3]; CELLS]));
            for cell in 0..CELLS {
                let [i, j, k] = index_of(first, cell);
                if i >= width || j >= height || k >= pictures.len() {
                    continue;
                }
                let pixel = &pictures[k][(j * width + i) * 4..][..4];
                let color = [pixel[0], pixel[1], pixel[2]];
                layer.is_transparent |= pixel[3] != 255;
                layer.is_colored |= pixel[3] != 255 || pixel[0] != pixel[1] || pixel[1] != pixel[2];
                if pixel[3] == 0 {
                    continue;
                }
                if let Some(colors) = &mut block.colors {
                    colors[cell] = color;
                    (block.density[cell], block.label[cell]) = (pixel[3], 1);
                    continue;
                }
                if last.1 == 0 || last.0 != color {
                    let known = layer.palette.iter().position(|known| *known == color);
                    let place = known.unwrap_or_else(|| {
                        layer.palette.push(color);
                        layer.palette.len() - 1
                    });
                    // Black of grey pictures is one of up to 256 colours, and is empty in the end.
                    if place >= MAX_LABELS {
                        self.exact.store(true, Ordering::Relaxed);
                        return Ok(layer);
                    }
                    last = (color, place as u8 + 1);
                }
                (block.density[cell], block.label[cell]) = (pixel[3], last.1);
            }
            layer.cells.push(match exact {
                true if block.density == [0; CELLS] => Cells::Uniform(Voxel::default()),
                true => Cells::Mixed(Arc::new(block)),
                false => cells_of(block),
            });
        }
        Ok(layer)
    }
}
