//! Pictures as files: PNG for colours, NumPy arrays, OpenEXR and PNG of 16 bits for depths. The same numbers give the
//! same bytes.

use std::io::{self, Write};
use std::path::Path;

use ambf_core::files::{Output, WriteError};
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageError};

use crate::Picture;

/// How depths are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DepthFormat {
    /// A NumPy array, float32 (height x width), m.
    #[default]
    Npy,
    /// OpenEXR, one channel `Z` of 32 bit floats, m, not compressed.
    Exr,
    /// PNG, 16 bits a pixel, mm; 0 where nothing is seen or what is seen is further away than 65.535 m.
    Png16,
}

impl DepthFormat {
    /// Names as in command lines.
    pub const NAMES: [(&'static str, Self); 3] = [("npy", Self::Npy), ("exr", Self::Exr), ("png16", Self::Png16)];

    /// By its name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::NAMES.iter().find(|(known, _)| *known == name).map(|(_, format)| *format)
    }

    /// Extension of its files, without a dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Npy => "npy",
            Self::Exr => "exr",
            Self::Png16 => "png",
        }
    }
}

impl Picture {
    /// Writes the colours as PNG, 8 bits a channel.
    ///
    /// # Errors
    /// [`WriteError`]; the file of before, or none, is there then.
    pub fn write_color(&self, file: &Path) -> Result<(), WriteError> {
        write_rgb_png(file, &self.color, (self.width, self.height))
    }

    /// Writes the depths. `far` is the distance of the far clipping plane, m: what is there is nothing.
    ///
    /// # Errors
    /// [`WriteError`]; the file of before, or none, is there then.
    pub fn write_depth(&self, file: &Path, format: DepthFormat, far: f64) -> Result<(), WriteError> {
        match format {
            DepthFormat::Npy => {
                let bytes = self.depth.iter().flat_map(|depth| depth.to_le_bytes());
                write_npy(file, "<f4", &[self.height, self.width], bytes)
            }
            DepthFormat::Exr => write_exr(file, (self.width, self.height), &self.depth),
            DepthFormat::Png16 => {
                let nothing = depth_of_nothing(far);
                let bytes: Vec<u8> = (self.depth.iter())
                    // The encoder takes native numbers.
                    .flat_map(|&depth| millimetres(depth, nothing).to_ne_bytes())
                    .collect();
                write_png(file, &bytes, (self.width, self.height), ExtendedColorType::L16)
            }
        }
    }

    /// Writes the ids of objects as a NumPy array, int32 (height x width); 0 where nothing is seen.
    ///
    /// # Errors
    /// [`WriteError`]; the file of before, or none, is there then.
    pub fn write_ids(&self, file: &Path) -> Result<(), WriteError> {
        let bytes = self.ids.iter().flat_map(|[object, _]| object.to_le_bytes());
        write_npy(file, "<i4", &[self.height, self.width], bytes)
    }
}

/// Writes colours, (height x width x 3) with the top row first, as PNG.
///
/// # Errors
/// [`WriteError`]; the file of before, or none, is there then.
pub fn write_rgb_png(file: &Path, rgb: &[u8], size: (u32, u32)) -> Result<(), WriteError> {
    write_png(file, rgb, size, ExtendedColorType::Rgb8)
}

/// Numbers of 16 bits are native.
fn write_png(
    file: &Path,
    bytes: &[u8],
    (width, height): (u32, u32),
    kind: ExtendedColorType,
) -> Result<(), WriteError> {
    Output::write_whole(file, |out| {
        PngEncoder::new(out).write_image(bytes, width, height, kind).map_err(|error| match error {
            ImageError::IoError(error) => error,
            other => io::Error::other(other),
        })
    })
}

/// Depth that counts as nothing: the far plane, less what rounding of a depth buffer makes of it.
fn depth_of_nothing(far: f64) -> f32 {
    (far * (1.0 - 1e-4)) as f32
}

fn millimetres(depth: f32, nothing: f32) -> u16 {
    let distance = (1e3 * f64::from(depth)).round();
    match depth < nothing && distance <= f64::from(u16::MAX) {
        // Not negative; what is no number becomes 0.
        true => distance as u16,
        false => 0,
    }
}

/// A NumPy file of version 1.0, in C order.
fn write_npy(file: &Path, kind: &str, shape: &[u32], bytes: impl Iterator<Item = u8>) -> Result<(), WriteError> {
    let shape: Vec<String> = shape.iter().map(|size| format!("{size},")).collect();
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({}), }}", shape.join(" "));
    // Magic, version, length of the header, header and line feed are a multiple of 64 bytes.
    let rest = (10 + header.len() + 1).next_multiple_of(64) - (10 + header.len() + 1);
    header.extend(std::iter::repeat_n(' ', rest));
    header.push('\n');
    let length = u16::try_from(header.len()).map_err(io::Error::other);
    Output::write_whole(file, |out| {
        out.write_all(b"\x93NUMPY\x01\x00")?;
        out.write_all(&length?.to_le_bytes())?;
        out.write_all(header.as_bytes())?;
        out.write_all(&bytes.collect::<Vec<u8>>())
    })
}

/// A single part OpenEXR file of scan lines with one channel of 32 bit floats, as
/// <https://openexr.com/en/latest/OpenEXRFileLayout.html> says.
fn write_exr(file: &Path, (width, height): (u32, u32), values: &[f32]) -> Result<(), WriteError> {
    let mut header: Vec<u8> = Vec::new();
    header.extend(20_000_630_u32.to_le_bytes());
    header.extend(2_u32.to_le_bytes());
    let mut attribute = |name: &str, kind: &str, value: &[u8]| {
        for text in [name, kind] {
            header.extend(text.as_bytes());
            header.push(0);
        }
        header.extend((value.len() as u32).to_le_bytes());
        header.extend(value);
    };
    let numbers = |numbers: &[u32]| numbers.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<u8>>();
    // Name; FLOAT; not perceptually linear, which is one byte and three reserved ones; sampled at each pixel; end of
    // the list.
    let mut channels = b"Z\0".to_vec();
    channels.extend(numbers(&[2, 0, 1, 1]));
    channels.push(0);
    attribute("channels", "chlist", &channels);
    attribute("compression", "compression", &[0]);
    let window = numbers(&[0, 0, width - 1, height - 1]);
    attribute("dataWindow", "box2i", &window);
    attribute("displayWindow", "box2i", &window);
    attribute("lineOrder", "lineOrder", &[0]);
    attribute("pixelAspectRatio", "float", &1.0_f32.to_le_bytes());
    attribute("screenWindowCenter", "v2f", &[0; 8]);
    attribute("screenWindowWidth", "float", &1.0_f32.to_le_bytes());
    header.push(0);

    Output::write_whole(file, |out| {
        out.write_all(&header)?;
        let row_bytes = 4 * u64::from(width);
        let first = header.len() as u64 + 8 * u64::from(height);
        for row in 0..u64::from(height) {
            out.write_all(&(first + row * (8 + row_bytes)).to_le_bytes())?;
        }
        for (row, values) in values.chunks_exact(width as usize).enumerate() {
            out.write_all(&(row as u32).to_le_bytes())?;
            out.write_all(&(row_bytes as u32).to_le_bytes())?;
            for value in values {
                out.write_all(&value.to_le_bytes())?;
            }
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(write: impl FnOnce(&Path) -> Result<(), WriteError>, name: &str) -> Vec<u8> {
        let file = std::env::temp_dir().join(format!("ambf_render_{}_{name}", std::process::id()));
        write(&file).expect("written");
        let bytes = std::fs::read(&file).expect("readable");
        std::fs::remove_file(&file).expect("removed");
        bytes
    }

    fn picture() -> Picture {
        let depth = vec![0.5, 1.2346, 10.0, 70.0, 0.0004, 2.0];
        let ids = vec![[3, 1], [0, 0], [258, 2], [1, 1], [1, 1], [1, 1]];
        Picture { width: 3, height: 2, depth, ids, color: (0..18).collect(), ..Picture::default() }
    }

    #[test]
    fn arrays_have_a_header_that_numpy_reads() {
        let bytes = written(|file| picture().write_ids(file), "ids.npy");
        let data = bytes.len() - 24;
        assert_eq!((&bytes[..8], data % 64), (&b"\x93NUMPY\x01\x00"[..], 0));
        assert_eq!(usize::from(u16::from_le_bytes([bytes[8], bytes[9]])), data - 10);
        let header = std::str::from_utf8(&bytes[10..data]).expect("text");
        assert!(header.starts_with("{'descr': '<i4', 'fortran_order': False, 'shape': (2, 3,), }"), "{header}");
        assert!(header.ends_with('\n'));
        assert_eq!(bytes[data..data + 12], [3, 0, 0, 0, 0, 0, 0, 0, 2, 1, 0, 0]);
        let bytes = written(|file| picture().write_depth(file, DepthFormat::Npy, 10.0), "depth.npy");
        assert_eq!(bytes[bytes.len() - 4..], 2.0_f32.to_le_bytes());
    }

    #[test]
    fn depths_in_millimetres() {
        let bytes = written(|file| picture().write_depth(file, DepthFormat::Png16, 100.0), "depth.png");
        let image = image::load_from_memory(&bytes).expect("a picture").into_luma16();
        assert_eq!((image.dimensions(), image.into_raw()), ((3, 2), vec![500, 1235, 10_000, 0, 0, 2000]));
        let bytes = written(|file| picture().write_depth(file, DepthFormat::Png16, 10.0), "far.png");
        let image = image::load_from_memory(&bytes).expect("a picture").into_luma16();
        assert_eq!(image.into_raw(), [500, 1235, 0, 0, 0, 2000]);
    }

    #[test]
    fn rows_of_exr_files_are_where_their_table_says() {
        let bytes = written(|file| picture().write_depth(file, DepthFormat::Exr, 10.0), "depth.exr");
        assert_eq!(bytes[..8], [0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0]);
        let second = bytes.len() - 20;
        let table = second - 20 - 16;
        let offset = |place: usize| u64::from_le_bytes(std::array::from_fn(|i| bytes[place + i])) as usize;
        assert_eq!((offset(table), offset(table + 8)), (second - 20, second));
        assert_eq!(bytes[second..second + 8], [1, 0, 0, 0, 12, 0, 0, 0]);
        assert_eq!(bytes[second + 8..second + 12], 70.0_f32.to_le_bytes());
    }

    #[test]
    fn a_folder_that_is_missing_is_an_error() {
        for format in DepthFormat::NAMES {
            assert!(picture().write_depth(Path::new("/no/such/folder/x"), format.1, 10.0).is_err(), "{format:?}");
        }
        let error = picture().write_color(Path::new("/no/such/folder/x.png")).expect_err("no folder");
        assert_eq!(error.source.kind(), io::ErrorKind::NotFound);
    }
}
