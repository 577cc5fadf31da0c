//! Volumes: stacks of pictures as textures in three dimensions.

use std::sync::Arc;

use ambf_core::adf::{ImageStack, Volume};

use crate::gl::{self, Current};
use crate::Texture;

/// Numbers of pictures that are tried.
const MAX_PICTURES: u32 = 10_000;

/// Most bytes of the voxels of a volume.
const MAX_BYTES: usize = 1 << 30;

/// Voxels along an edge of a block. What is empty is passed over block by block.
const BLOCK: usize = 8;

/// Voxels on the graphics card.
pub(crate) struct Voxels {
    /// Red, green, blue and density; of grey pictures the grey is all four.
    pub(crate) texture: gl::Texture,
    /// The largest density that interpolation can find in each block.
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
    pub(crate) fn new(voxels: &Arc<Voxels>, volume: &Volume) -> Self {
        let most = voxels.size.iter().max().copied().unwrap_or(1) as f64;
        let samples = (4.0 * volume.quality * most).clamp(1.0, 16384.0);
        let value = volume.iso_surface_value as f32;
        Self {
            voxels: Arc::clone(voxels),
            value,
            samples: (samples / (volume.dimensions.norm() * volume.scale)) as f32,
            // Beside the surface interpolation mixes colours with those outside, black, as it mixes densities.
            tint: if voxels.is_grey { 1.0 } else { 1.0 / value.max(1.0 / 255.0) },
        }
    }
}

/// The volumes that are loaded, each stack once.
#[derive(Default)]
pub(crate) struct Stacks(Vec<(ImageStack, Arc<Voxels>)>);

impl Stacks {
    /// Reads a stack, unless it is there.
    pub(crate) fn load(&mut self, gl: &Current<'_>, stack: &ImageStack) -> Result<Arc<Voxels>, String> {
        if let Some((_, voxels)) = self.0.iter().find(|(known, _)| known == stack) {
            return Ok(Arc::clone(voxels));
        }
        let read = Pixels::read(stack)?;
        let [width, height, depth] = read.size;
        let most = gl.device().most_texels_of_volumes;
        if let Some(edge) = read.size.into_iter().find(|&edge| edge > most) {
            return Err(format!("{edge} voxels in a row; {most} are possible here: scale the pictures down"));
        }
        let channels = if read.is_grey { 1 } else { 4 };
        let blocks = read.blocks();
        let count = read.size.map(|edge| edge.div_ceil(BLOCK));
        let store = |size: [usize; 3], texels: &[u8], channels| gl.volume(size, texels, channels);
        let stored = store([width, height, depth], &read.texels, channels)
            .and_then(|texture| Ok((texture, store(count, &blocks, 1)?)));
        let (texture, blocks) = stored.map_err(|error| error.to_string())?;
        let voxels = Arc::new(Voxels { texture, blocks, size: read.size, is_grey: read.is_grey });
        self.0.push((stack.clone(), Arc::clone(&voxels)));
        Ok(voxels)
    }

    /// Lets those go that no scene has any more.
    pub(crate) fn prune(&mut self) {
        self.0.retain(|(_, voxels)| Arc::strong_count(voxels) > 1);
    }
}

/// The pictures of a stack.
struct Pixels {
    /// Voxel (x, y, z) is the pixel in column x, row y from below, of picture z: (z × y × x × channels).
    texels: Vec<u8>,
    size: [usize; 3],
    /// One channel instead of four.
    is_grey: bool,
}

impl Pixels {
    fn read(stack: &ImageStack) -> Result<Self, String> {
        let files = stack.files(MAX_PICTURES);
        let Some(first) = files.first() else {
            let sought = stack.candidates(0).next().unwrap_or_default();
            return Err(format!("no picture is there, for example {}", sought.display()));
        };
        let mut voxels = Channels::default();
        let mut size = None;
        for file in &files {
            let picture = Texture::load(file).map_err(|error| error.to_string())?;
            let (width, height) = *size.get_or_insert((picture.width, picture.height));
            if (picture.width, picture.height) != (width, height) {
                return Err(format!(
                    "{} has {} x {} pixels, {} has {width} x {height}: all pictures of a volume have one size",
                    file.display(),
                    picture.width,
                    picture.height,
                    first.display()
                ));
            }
            voxels.append(&picture, files.len())?;
        }
        let (width, height) = size.unwrap_or_default();
        let (texels, is_grey) = voxels.finish();
        Ok(Self { texels, size: [width as usize, height as usize, files.len()], is_grey })
    }

    /// The largest density near each block, (blocks along z × y × x): of its voxels and their neighbours, between which a
    /// place in the block is interpolated.
    fn blocks(&self) -> Vec<u8> {
        let count = self.size.map(|edge| edge.div_ceil(BLOCK));
        let (channels, density) = if self.is_grey { (1, 0) } else { (4, 3) };
        let [width, height, _] = self.size;
        let mut blocks = Vec::with_capacity(count.iter().product());
        let range = |block: usize, edge: usize| (block * BLOCK).saturating_sub(1)..((block + 1) * BLOCK + 1).min(edge);
        for z in 0..count[2] {
            for y in 0..count[1] {
                for x in 0..count[0] {
                    let mut largest = 0;
                    for (k, j) in range(z, self.size[2]).flat_map(|k| range(y, height).map(move |j| (k, j))) {
                        let row = (k * height + j) * width;
                        let voxels = range(x, width).map(|i| self.texels[(row + i) * channels + density]);
                        largest = voxels.fold(largest, u8::max);
                    }
                    blocks.push(largest);
                }
            }
        }
        blocks
    }
}

/// Pixels of pictures, one after the other: of one channel as long as all of them are grey, then of four.
#[derive(Default)]
struct Channels {
    texels: Vec<u8>,
    is_colored: bool,
    is_transparent: bool,
}

impl Channels {
    /// Appends one of `pictures` pictures of equal size.
    fn append(&mut self, picture: &Texture, pictures: usize) -> Result<(), String> {
        let pixels = || picture.rgba.chunks_exact(4);
        self.is_transparent |= pixels().any(|pixel| pixel[3] != 255);
        if !self.is_colored && pixels().any(|pixel| pixel[0] != pixel[1] || pixel[1] != pixel[2] || pixel[3] != 255) {
            self.is_colored = true;
            let grey = std::mem::take(&mut self.texels);
            self.reserve(picture, pictures)?;
            self.texels.extend(grey.into_iter().flat_map(|grey| [grey, grey, grey, 255]));
        } else if self.texels.is_empty() {
            self.reserve(picture, pictures)?;
        }
        match self.is_colored {
            true => self.texels.extend_from_slice(&picture.rgba),
            false => self.texels.extend(pixels().map(|pixel| pixel[0])),
        }
        Ok(())
    }

    /// Takes the memory of all pictures.
    fn reserve(&mut self, picture: &Texture, pictures: usize) -> Result<(), String> {
        let channels = if self.is_colored { 4 } else { 1 };
        let bytes = picture.width as usize * picture.height as usize * channels * pictures;
        if bytes > MAX_BYTES {
            let (there, most) = (bytes >> 20, MAX_BYTES >> 20);
            return Err(format!("its voxels need {there} MiB; at most {most} are possible: scale the pictures down"));
        }
        self.texels.try_reserve_exact(bytes).map_err(|error| error.to_string())
    }

    /// All voxels, and whether they have one channel. Where nothing is transparent, the brightness of coloured pictures
    /// is the density.
    fn finish(mut self) -> (Vec<u8>, bool) {
        if self.is_colored && !self.is_transparent {
            for voxel in self.texels.chunks_exact_mut(4) {
                voxel[3] = voxel[0].max(voxel[1]).max(voxel[2]);
            }
        }
        (self.texels, !self.is_colored)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_know_what_interpolation_finds_in_them() {
        let mut texels = vec![0; 20 * 9 * 8];
        // The first voxel of the second block along x, in the last row, which is the only one of the second along y.
        texels[(3 * 9 + 8) * 20 + 8] = 7;
        let pixels = Pixels { texels, size: [20, 9, 8], is_grey: true };
        // It is a neighbour of the first blocks too, and of none farther away.
        assert_eq!(pixels.blocks(), [7, 7, 0, 7, 7, 0]);
    }

    #[test]
    fn density_is_alpha_or_grey_or_else_the_brightness() {
        let voxels = |pictures: &[[u8; 4]]| {
            let mut voxels = Channels::default();
            for rgba in pictures {
                voxels.append(&Texture { width: 1, height: 1, rgba: rgba.to_vec() }, pictures.len()).unwrap();
            }
            voxels.finish()
        };
        assert_eq!(voxels(&[[9, 9, 9, 255], [5, 5, 5, 255]]), (vec![9, 5], true));
        assert_eq!(voxels(&[[9, 9, 9, 255], [5, 7, 6, 255]]), (vec![9, 9, 9, 9, 5, 7, 6, 7], false));
        assert_eq!(voxels(&[[0, 0, 0, 0], [5, 7, 6, 200]]), (vec![0, 0, 0, 0, 5, 7, 6, 200], false));
    }
}
