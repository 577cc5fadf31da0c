//! Textures: pictures, layers, cube maps, shadow maps.

use glow::{HasContext as _, PixelUnpackData};

use super::{Current, Name, Texture};
use crate::RenderError;

impl Current<'_> {
    /// A texture of RGBA bytes, bottom row first, that repeats; with mip maps and linear filter.
    pub(crate) fn texture(&self, width: u32, height: u32, rgba: &[u8]) -> Result<Texture, RenderError> {
        assert_eq!(rgba.len(), width as usize * height as usize * 4, "size of a texture");
        let gl = self.raw();
        // SAFETY: the slice has the size that is named (checked above).
        unsafe {
            let texture = self.own(gl.create_texture().map_err(RenderError::Gl)?, Name::Texture);
            gl.bind_texture(glow::TEXTURE_2D, Some(texture.name));
            gl.pixel_store_i32(glow::UNPACK_ALIGNMENT, 1);
            gl.tex_image_2d(
                glow::TEXTURE_2D,
                0,
                glow::RGBA8 as i32,
                width as i32,
                height as i32,
                0,
                glow::RGBA,
                glow::UNSIGNED_BYTE,
                PixelUnpackData::Slice(Some(rgba)),
            );
            gl.generate_mipmap(glow::TEXTURE_2D);
            let set = |name, value: u32| gl.tex_parameter_i32(glow::TEXTURE_2D, name, value as i32);
            set(glow::TEXTURE_MIN_FILTER, glow::LINEAR_MIPMAP_LINEAR);
            set(glow::TEXTURE_MAG_FILTER, glow::LINEAR);
            set(glow::TEXTURE_WRAP_S, glow::REPEAT);
            set(glow::TEXTURE_WRAP_T, glow::REPEAT);
            match gl.get_error() {
                glow::NO_ERROR => Ok(Texture { texture, target: glow::TEXTURE_2D }),
                code => Err(RenderError::Gl(format!("a texture cannot be stored (error 0x{code:04x})"))),
            }
        }
    }

    /// Six square pictures of one size as layers, bottom row first, clamped to their edges.
    pub(crate) fn layers(&self, size: u32, layers: &[Vec<u8>]) -> Result<Texture, RenderError> {
        let side = size as i32;
        assert!(layers.iter().all(|layer| layer.len() == square(size)), "size of a layer");
        let joined = layers.concat();
        self.clamped(glow::TEXTURE_2D_ARRAY, |gl, target| {
            let (format, kind, pixels) = (glow::RGBA, glow::UNSIGNED_BYTE, PixelUnpackData::Slice(Some(&joined)));
            // SAFETY: the slice has the size that is named (checked above).
            unsafe {
                let internal = glow::RGBA8 as i32;
                gl.tex_image_3d(target, 0, internal, side, side, layers.len() as i32, 0, format, kind, pixels);
            }
        })
    }

    /// Voxels of one channel, which stands for all four, or of four: (z × y × x × channels), clamped to their edges, with
    /// linear filter.
    pub(crate) fn volume(&self, size: [usize; 3], texels: &[u8], channels: usize) -> Result<Texture, RenderError> {
        assert_eq!(texels.len(), size.iter().product::<usize>() * channels, "size of a volume");
        let [width, height, depth] = size.map(|edge| edge as i32);
        let (internal, format) = if channels == 1 { (glow::R8, glow::RED) } else { (glow::RGBA8, glow::RGBA) };
        self.clamped(glow::TEXTURE_3D, |gl, target| {
            let (kind, pixels) = (glow::UNSIGNED_BYTE, PixelUnpackData::Slice(Some(texels)));
            // SAFETY: the slice has the size that is named (checked above).
            unsafe {
                gl.tex_image_3d(target, 0, internal as i32, width, height, depth, 0, format, kind, pixels);
                if channels == 1 {
                    for channel in [glow::TEXTURE_SWIZZLE_G, glow::TEXTURE_SWIZZLE_B, glow::TEXTURE_SWIZZLE_A] {
                        gl.tex_parameter_i32(target, channel, glow::RED as i32);
                    }
                }
            }
        })
    }

    /// Stores voxels of a [`volume`](Self::volume) anew, from `low` up to `high`, without it: (z × y × x × channels).
    pub(crate) fn update_volume(
        &self,
        texture: &Texture,
        low: [usize; 3],
        high: [usize; 3],
        texels: &[u8],
        channels: usize,
    ) -> Result<(), RenderError> {
        let size: [usize; 3] = std::array::from_fn(|axis| high[axis] - low[axis]);
        assert_eq!(texels.len(), size.iter().product::<usize>() * channels, "size of a part of a volume");
        let ([x, y, z], [width, height, depth]) = (low.map(|i| i as i32), size.map(|edge| edge as i32));
        let format = if channels == 1 { glow::RED } else { glow::RGBA };
        let (kind, pixels) = (glow::UNSIGNED_BYTE, PixelUnpackData::Slice(Some(texels)));
        let gl = self.raw();
        // SAFETY: the texture exists as long as its owner, and the slice has the size that is named (checked above).
        unsafe {
            gl.bind_texture(texture.target, Some(texture.texture.name));
            gl.pixel_store_i32(glow::UNPACK_ALIGNMENT, 1);
            gl.tex_sub_image_3d(texture.target, 0, x, y, z, width, height, depth, format, kind, pixels);
            match gl.get_error() {
                glow::NO_ERROR => Ok(()),
                code => Err(RenderError::Gl(format!("a part of a texture cannot be stored (error 0x{code:04x})"))),
            }
        }
    }

    /// A cube map of six squares, red, green, blue and alpha, the top row first: towards x, −x, y, −y, z, −z.
    pub(crate) fn cube_map(&self, size: u32, faces: &[Vec<u8>]) -> Result<Texture, RenderError> {
        let side = size as i32;
        assert!(faces.len() == 6 && faces.iter().all(|face| face.len() == square(size)), "size of a face");
        self.clamped(glow::TEXTURE_CUBE_MAP, |gl, _| {
            for (face, place) in faces.iter().zip(glow::TEXTURE_CUBE_MAP_POSITIVE_X..) {
                let (format, kind, pixels) = (glow::RGBA, glow::UNSIGNED_BYTE, PixelUnpackData::Slice(Some(face)));
                // SAFETY: each slice has the size that is named (checked above).
                unsafe { gl.tex_image_2d(place, 0, glow::RGBA8 as i32, side, side, 0, format, kind, pixels) };
            }
        })
    }

    /// A texture that ends at its edges, without smaller versions; `fill` stores its pixels, rows without gaps.
    fn clamped(&self, target: u32, fill: impl FnOnce(&glow::Context, u32)) -> Result<Texture, RenderError> {
        let gl = self.raw();
        // SAFETY: the texture is made and bound here.
        unsafe {
            let texture = self.own(gl.create_texture().map_err(RenderError::Gl)?, Name::Texture);
            gl.bind_texture(target, Some(texture.name));
            gl.pixel_store_i32(glow::UNPACK_ALIGNMENT, 1);
            fill(gl, target);
            for (name, value) in [
                (glow::TEXTURE_MIN_FILTER, glow::LINEAR),
                (glow::TEXTURE_MAG_FILTER, glow::LINEAR),
                (glow::TEXTURE_WRAP_S, glow::CLAMP_TO_EDGE),
                (glow::TEXTURE_WRAP_T, glow::CLAMP_TO_EDGE),
                (glow::TEXTURE_WRAP_R, glow::CLAMP_TO_EDGE),
            ] {
                gl.tex_parameter_i32(target, name, value as i32);
            }
            match gl.get_error() {
                glow::NO_ERROR => Ok(Texture { texture, target }),
                code => Err(RenderError::Gl(format!("a texture cannot be stored (error 0x{code:04x})"))),
            }
        }
    }

    pub(crate) fn bind_texture(&self, unit: u32, texture: Option<&Texture>) {
        // SAFETY: the texture exists as long as its owner.
        unsafe {
            self.raw().active_texture(glow::TEXTURE0 + unit);
            match texture {
                Some(texture) => self.raw().bind_texture(texture.target, Some(texture.texture.name)),
                None => self.raw().bind_texture(glow::TEXTURE_2D, None),
            }
            self.raw().active_texture(glow::TEXTURE0);
        }
    }

    /// A shadow map of one texel, in which nothing is in shadow.
    pub(crate) fn no_shadow(&self) -> Result<Texture, RenderError> {
        self.shadow_texture(1, 1, Some(1.0))
    }

    pub(super) fn shadow_texture(&self, width: i32, height: i32, texel: Option<f32>) -> Result<Texture, RenderError> {
        assert!(texel.is_none() || (width, height) == (1, 1), "one texel");
        let gl = self.raw();
        let data = texel.map(|texel| texel.to_ne_bytes());
        // SAFETY: the slice holds one float for one texel (checked above), or there is none.
        unsafe {
            let texture = self.own(gl.create_texture().map_err(RenderError::Gl)?, Name::Texture);
            gl.bind_texture(glow::TEXTURE_2D, Some(texture.name));
            gl.tex_image_2d(
                glow::TEXTURE_2D,
                0,
                glow::DEPTH_COMPONENT32F as i32,
                width,
                height,
                0,
                glow::DEPTH_COMPONENT,
                glow::FLOAT,
                PixelUnpackData::Slice(data.as_ref().map(|data| data.as_slice())),
            );
            let set = |name, value: u32| gl.tex_parameter_i32(glow::TEXTURE_2D, name, value as i32);
            set(glow::TEXTURE_MIN_FILTER, glow::LINEAR);
            set(glow::TEXTURE_MAG_FILTER, glow::LINEAR);
            set(glow::TEXTURE_WRAP_S, glow::CLAMP_TO_BORDER);
            set(glow::TEXTURE_WRAP_T, glow::CLAMP_TO_BORDER);
            set(glow::TEXTURE_COMPARE_MODE, glow::COMPARE_REF_TO_TEXTURE);
            set(glow::TEXTURE_COMPARE_FUNC, glow::LEQUAL);
            gl.tex_parameter_f32_slice(glow::TEXTURE_2D, glow::TEXTURE_BORDER_COLOR, &[1.0; 4]);
            Ok(Texture { texture, target: glow::TEXTURE_2D })
        }
    }
}

/// Bytes of a square picture of four channels.
fn square(size: u32) -> usize {
    size as usize * size as usize * 4
}
