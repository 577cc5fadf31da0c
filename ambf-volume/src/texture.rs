//! Pictures on surfaces.

use std::io::{self, Cursor};
use std::path::{Path, PathBuf};

use ambf_model::files;
use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};
use thiserror::Error;

/// Most pixels each way; also what common graphics cards take.
const MAX_PIXELS: u32 = 16384;

/// Most bytes of a picture in memory, and of a file.
const MAX_BYTES: u64 = 256 << 20;

/// A picture as it is put on a surface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Texture {
    /// Pixels from left to right, at least 1.
    pub width: u32,
    /// Pixels from bottom to top, at least 1.
    pub height: u32,
    /// Red, green, blue and alpha (height × width × 4), the bottom row first; alpha 255 is opaque and is not multiplied
    /// in.
    pub rgba: Vec<u8>,
}

/// Why a texture cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TextureError {
    /// Error when the file cannot be opened or read, or is no regular file.
    #[error("{}: cannot read the texture: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// Error when neither content nor extension tell a format that can be read.
    #[error("{}: no known picture format; convert it to png, jpg, bmp, gif, ppm or tga", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
    /// Error when the picture, or its file, is too large.
    #[error("{}: {what} is too large; at most {MAX_PIXELS} pixels each way and 256 MiB are possible: scale it down", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// What is too large.
        what: String,
    },
    /// Error when the file is damaged or of an unusual kind of its format.
    #[error("{}: not readable as {format}: {what}; save it anew, for example as an 8-bit png", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Name of the format.
        format: &'static str,
        /// What the decoder said.
        what: String,
    },
}

impl Texture {
    /// Reads a picture: bmp, gif (its first frame), jpg, png, ppm and its relatives, tga. The content tells the format;
    /// where it does not (tga), the extension does. Deeper pictures are reduced to 8 bits a channel; a missing alpha is
    /// opaque.
    ///
    /// # Errors
    /// See [`TextureError`]. The size is checked before anything is decoded.
    pub fn load(path: &Path) -> Result<Self, TextureError> {
        let io_error = |source| TextureError::Io { path: path.to_path_buf(), source };
        Self::parse(&files::read(path, MAX_BYTES).map_err(io_error)?, path)
    }

    /// Reads the content of a picture file as [`load`](Self::load) reads a file; `path` stands for its name.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, TextureError> {
        let too_large = |what: String| TextureError::TooLarge { path: path.to_path_buf(), what };
        if bytes.len() as u64 > MAX_BYTES {
            return Err(too_large("the file".to_owned()));
        }
        let unknown = || TextureError::UnknownFormat { path: path.to_path_buf() };
        let format = image::guess_format(bytes).or_else(|_| ImageFormat::from_path(path)).map_err(|_| unknown())?;
        let name = *format.extensions_str().first().ok_or_else(unknown)?;
        let failed = |error: ImageError| match error {
            ImageError::Unsupported(_) if !format.reading_enabled() => unknown(),
            ImageError::Limits(_) => too_large("the picture".to_owned()),
            // One line, and not longer than a message should be.
            other => TextureError::Malformed {
                path: path.to_path_buf(),
                format: name,
                what: other.to_string().trim().chars().take(200).collect::<String>().escape_debug().to_string(),
            },
        };
        let mut limits = Limits::default();
        limits.max_image_width = Some(MAX_PIXELS);
        limits.max_image_height = Some(MAX_PIXELS);
        limits.max_alloc = Some(MAX_BYTES);
        let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
        reader.limits(limits);
        let decoder = reader.into_decoder().map_err(failed)?;
        let (width, height) = decoder.dimensions();
        let in_memory = decoder.total_bytes().max(4 * u64::from(width) * u64::from(height));
        if width > MAX_PIXELS || height > MAX_PIXELS || in_memory > MAX_BYTES {
            return Err(too_large(format!("a picture of {width} x {height} pixels")));
        }
        let mut picture = DynamicImage::from_decoder(decoder).map_err(failed)?.into_rgba8();
        if picture.width() == 0 || picture.height() == 0 {
            let what = "it has no pixels".to_owned();
            return Err(TextureError::Malformed { path: path.to_path_buf(), format: name, what });
        }
        // Texture coordinates grow upwards.
        image::imageops::flip_vertical_in_place(&mut picture);
        Ok(Self { width: picture.width(), height: picture.height(), rgba: picture.into_raw() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgba, RgbaImage};

    /// Red and green above, blue and clear white below.
    fn picture() -> RgbaImage {
        let colors = [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 255, 0]];
        RgbaImage::from_fn(2, 2, |x, y| Rgba(colors[(2 * y + x) as usize]))
    }

    fn encoded(format: ImageFormat) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        let picture = DynamicImage::from(picture());
        let opaque = DynamicImage::from(picture.to_rgb8());
        let picture = if matches!(format, ImageFormat::Png | ImageFormat::Tga) { picture } else { opaque };
        picture.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    }

    const FORMATS: [(ImageFormat, &str); 6] = [
        (ImageFormat::Png, "t.png"),
        (ImageFormat::Bmp, "t.bmp"),
        (ImageFormat::Gif, "t.gif"),
        (ImageFormat::Pnm, "t.ppm"),
        (ImageFormat::Tga, "t.TGA"),
        (ImageFormat::Jpeg, "t.jpeg"),
    ];

    #[test]
    fn all_formats_have_the_bottom_row_first() {
        for (format, name) in FORMATS {
            let texture = Texture::parse(&encoded(format), Path::new(name)).unwrap();
            assert_eq!((texture.width, texture.height, texture.rgba.len()), (2, 2, 16), "{name}");
            if format == ImageFormat::Jpeg {
                // Colours of so small a picture are mixed; the order is tested with a larger one.
                continue;
            }
            let alpha = if matches!(format, ImageFormat::Png | ImageFormat::Tga) { 0 } else { 255 };
            let expected = [[0, 0, 255, 255], [255, 255, 255, alpha], [255, 0, 0, 255], [0, 255, 0, 255]];
            assert_eq!(texture.rgba.as_chunks::<4>().0, expected, "{name}");
        }
        let mut bytes = Cursor::new(Vec::new());
        let halves = image::RgbImage::from_fn(32, 32, |_, y| if y < 16 { [0; 3].into() } else { [255; 3].into() });
        DynamicImage::from(halves).write_to(&mut bytes, ImageFormat::Jpeg).unwrap();
        let texture = Texture::parse(&bytes.into_inner(), Path::new("t.jpg")).unwrap();
        assert!(texture.rgba[0] > 250 && texture.rgba[32 * 32 * 4 - 4] < 5);
    }

    #[test]
    fn the_content_tells_the_format() {
        let texture = Texture::parse(&encoded(ImageFormat::Png), Path::new("t.jpg")).unwrap();
        assert_eq!(texture.rgba[..4], [0, 0, 255, 255]);
    }

    #[test]
    fn deep_and_grey_pictures_become_8_bit_colours() {
        let grey = image::ImageBuffer::from_fn(1, 2, |_, y| image::Luma([if y == 0 { 0xFFFFu16 } else { 0x8080 }]));
        let mut bytes = Cursor::new(Vec::new());
        DynamicImage::from(grey).write_to(&mut bytes, ImageFormat::Png).unwrap();
        let texture = Texture::parse(&bytes.into_inner(), Path::new("t.png")).unwrap();
        assert_eq!(texture.rgba, [0x80, 0x80, 0x80, 255, 255, 255, 255, 255]);
    }

    #[test]
    fn sizes_are_checked_before_decoding() {
        let error = |bytes: &[u8], name| Texture::parse(bytes, Path::new(name)).unwrap_err();
        // Headers without the pixels that they announce.
        let wide = error(b"P6 16385 1 255 ", "t.ppm");
        assert!(matches!(wide, TextureError::TooLarge { .. }), "{wide}");
        let many = error(b"P6 16384 16384 255 ", "t.ppm");
        assert!(many.to_string().contains("scale it down"), "{many}");
        assert!(matches!(many, TextureError::TooLarge { .. }), "{many}");
        let missing = error(b"P6 8192 8192 255 ", "t.ppm");
        assert!(matches!(missing, TextureError::Malformed { .. }), "{missing}");
        // A png of 2 x 2 pixels that says 100 000 x 2; the checksum of the header is wrong then, or the size is
        // refused.
        let mut png = encoded(ImageFormat::Png);
        png[16..20].copy_from_slice(&100_000u32.to_be_bytes());
        error(&png, "t.png");
    }

    #[test]
    fn what_cannot_be_read_is_named() {
        let message = |bytes: &[u8], name| Texture::parse(bytes, Path::new(name)).unwrap_err().to_string();
        assert!(message(b"hello, world", "t.txt").starts_with("t.txt: no known picture format"));
        assert!(message(b"", "t").contains("no known picture format"));
        // Formats of the library that are not built in.
        assert!(message(b"RIFF\x00\x00\x00\x00WEBPVP8 ", "t.webp").contains("no known picture format"));
        assert!(message(b"", "t.png").starts_with("t.png: not readable as png"));
        assert!(message(b"P6 0 0 255 ", "t.ppm").starts_with("t.ppm: "));
        let missing = Texture::load(Path::new("/nowhere/t.png")).unwrap_err();
        assert!(matches!(missing, TextureError::Io { .. }));
        assert!(matches!(Texture::load(&std::env::temp_dir()), Err(TextureError::Io { .. })));
    }

    #[test]
    fn truncated_and_changed_files_never_panic() {
        // Numbers that look random and are the same each time.
        let mut state = 1u64;
        let mut random = move |below: usize| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize % below
        };
        for (format, name) in FORMATS {
            let whole = encoded(format);
            for length in 0..whole.len() {
                let _ = Texture::parse(&whole[..length], Path::new(name));
            }
            for _ in 0..2000 {
                let mut changed = whole.clone();
                for _ in 0..=random(4) {
                    let at = random(changed.len());
                    changed[at] = [0, 1, 0x7F, 0x80, 0xFF, random(256) as u8][random(6)];
                }
                if let Ok(texture) = Texture::parse(&changed, Path::new(name)) {
                    let pixels = u64::from(texture.width) * u64::from(texture.height);
                    assert!(pixels > 0 && texture.rgba.len() as u64 == 4 * pixels);
                }
            }
        }
    }
}
