//! What is drawn into: making, copying and reading back.

use glow::{HasContext as _, PixelPackData};

use super::{Current, Name, Target, TargetKind};
use crate::RenderError;

impl Current<'_> {
    /// # Errors
    /// [`RenderError::Gl`] if the driver cannot draw into it.
    pub(crate) fn target(&self, width: u32, height: u32, kind: TargetKind) -> Result<Target, RenderError> {
        let gl = self.raw();
        let (w, h) = (width as i32, height as i32);
        // SAFETY: attachments are made here and owned by the target.
        unsafe {
            let framebuffer = self.own(gl.create_framebuffer().map_err(RenderError::Gl)?, Name::Framebuffer);
            gl.bind_framebuffer(glow::FRAMEBUFFER, Some(framebuffer.name));
            let mut renderbuffers = Vec::new();
            let mut attach = |place: u32, format: u32, samples: u32| -> Result<(), RenderError> {
                let name = gl.create_renderbuffer().map_err(RenderError::Gl)?;
                renderbuffers.push(self.own(name, Name::Renderbuffer));
                gl.bind_renderbuffer(glow::RENDERBUFFER, Some(name));
                match samples {
                    0 | 1 => gl.renderbuffer_storage(glow::RENDERBUFFER, format, w, h),
                    samples => {
                        let samples = samples.min(self.device.most_samples) as i32;
                        gl.renderbuffer_storage_multisample(glow::RENDERBUFFER, samples, format, w, h);
                    }
                }
                gl.framebuffer_renderbuffer(glow::FRAMEBUFFER, place, glow::RENDERBUFFER, Some(name));
                Ok(())
            };
            let mut depth = None;
            match kind {
                TargetKind::Color(samples) => {
                    attach(glow::COLOR_ATTACHMENT0, glow::RGBA8, samples)?;
                    attach(glow::DEPTH_ATTACHMENT, glow::DEPTH_COMPONENT32F, samples)?;
                    gl.draw_buffers(&[glow::COLOR_ATTACHMENT0]);
                }
                TargetKind::Flat(normals) => {
                    attach(glow::COLOR_ATTACHMENT0, glow::RG32UI, 1)?;
                    attach(glow::DEPTH_ATTACHMENT, glow::DEPTH_COMPONENT32F, 1)?;
                    match normals {
                        true => {
                            attach(glow::COLOR_ATTACHMENT1, glow::RGBA32F, 1)?;
                            gl.draw_buffers(&[glow::COLOR_ATTACHMENT0, glow::COLOR_ATTACHMENT1]);
                        }
                        false => gl.draw_buffers(&[glow::COLOR_ATTACHMENT0]),
                    }
                }
                TargetKind::Shadow => {
                    let texture = self.shadow_texture(w, h, None)?;
                    let name = Some(texture.texture.name);
                    gl.framebuffer_texture_2d(glow::FRAMEBUFFER, glow::DEPTH_ATTACHMENT, glow::TEXTURE_2D, name, 0);
                    gl.draw_buffers(&[glow::NONE]);
                    gl.read_buffer(glow::NONE);
                    depth = Some(texture);
                }
            }
            let status = gl.check_framebuffer_status(glow::FRAMEBUFFER);
            let code = gl.get_error();
            gl.bind_framebuffer(glow::FRAMEBUFFER, None);
            if status != glow::FRAMEBUFFER_COMPLETE || code != glow::NO_ERROR {
                let what = match kind {
                    TargetKind::Color(samples) => format!("colours with {samples} samples"),
                    TargetKind::Flat(_) => "ids and depth".to_owned(),
                    TargetKind::Shadow => "shadows".to_owned(),
                };
                return Err(RenderError::Gl(format!(
                    "nothing can be drawn into {width} x {height} pixels ({what}, status 0x{status:04x}, error 0x{code:04x})"
                )));
            }
            Ok(Target { framebuffer, _renderbuffers: renderbuffers, depth, width, height })
        }
    }

    /// What is drawn goes to `target`.
    pub(crate) fn bind_target(&self, target: &Target) {
        // SAFETY: the frame buffer exists as long as its owner.
        unsafe { self.raw().bind_framebuffer(glow::FRAMEBUFFER, Some(target.framebuffer.name)) };
    }

    /// The frame buffer that is bound for drawing, to be bound again.
    pub(crate) fn bound(&self) -> Option<glow::Framebuffer> {
        // SAFETY: a query.
        unsafe { self.raw().get_parameter_framebuffer(glow::DRAW_FRAMEBUFFER_BINDING) }
    }

    /// Bits of the depth buffer of the frame buffer that is bound; 0 without one.
    pub(crate) fn bound_depth_bits(&self) -> i32 {
        // SAFETY: a query, which a compatibility profile answers.
        unsafe { self.raw().get_parameter_i32(glow::DEPTH_BITS) }
    }

    /// Binds what [`bound`](Self::bound) gave.
    pub(crate) fn bind_again(&self, bound: Option<glow::Framebuffer>) {
        // SAFETY: it was bound at the beginning of the same call, and its owner is the caller of that.
        unsafe { self.raw().bind_framebuffer(glow::FRAMEBUFFER, bound) };
    }

    /// Copies the colours of `from` into what [`bound`](Self::bound) gave, `mirrored` top to bottom, and binds that.
    pub(crate) fn copy_to_bound(&self, from: &Target, bound: Option<glow::Framebuffer>, mirrored: bool) {
        let (w, h) = (from.width as i32, from.height as i32);
        let (bottom, top) = if mirrored { (h, 0) } else { (0, h) };
        // SAFETY: both frame buffers exist: `bound` was bound at the beginning of the same call. Sizes are clipped by
        // OpenGL.
        unsafe {
            let gl = self.raw();
            gl.bind_framebuffer(glow::READ_FRAMEBUFFER, Some(from.framebuffer.name));
            gl.bind_framebuffer(glow::DRAW_FRAMEBUFFER, bound);
            gl.blit_framebuffer(0, 0, w, h, 0, bottom, w, top, glow::COLOR_BUFFER_BIT, glow::NEAREST);
            gl.bind_framebuffer(glow::FRAMEBUFFER, bound);
        }
    }

    /// Copies the colours of `from` into a target of the same size, samples joined.
    pub(crate) fn copy(&self, from: &Target, to: &Target) {
        // SAFETY: all of this module's targets live as long as their owners.
        unsafe { self.raw().disable(glow::SCISSOR_TEST) };
        self.copy_to_bound(from, Some(to.framebuffer.name), false);
    }

    fn read(&self, target: &Target, buffer: u32, format: u32, kind: u32, pixel_bytes: usize, out: &mut Vec<u8>) {
        out.resize(target.width as usize * target.height as usize * pixel_bytes, 0);
        let gl = self.raw();
        // SAFETY: the buffer has room for all pixels, without padding between rows (alignment 1).
        unsafe {
            gl.bind_framebuffer(glow::READ_FRAMEBUFFER, Some(target.framebuffer.name));
            gl.bind_buffer(glow::PIXEL_PACK_BUFFER, None);
            if buffer != glow::NONE {
                gl.read_buffer(buffer);
            }
            gl.pixel_store_i32(glow::PACK_ALIGNMENT, 1);
            gl.pixel_store_i32(glow::PACK_ROW_LENGTH, 0);
            let (w, h) = (target.width as i32, target.height as i32);
            gl.read_pixels(0, 0, w, h, format, kind, PixelPackData::Slice(Some(&mut out[..])));
        }
    }

    /// RGBA bytes, bottom row first.
    pub(crate) fn read_color(&self, target: &Target, out: &mut Vec<u8>) {
        self.read(target, glow::COLOR_ATTACHMENT0, glow::RGBA, glow::UNSIGNED_BYTE, 4, out);
    }

    /// Values of the depth buffer as native f32, bottom row first.
    pub(crate) fn read_depth(&self, target: &Target, out: &mut Vec<u8>) {
        self.read(target, glow::NONE, glow::DEPTH_COMPONENT, glow::FLOAT, 4, out);
    }

    /// Two native u32 a pixel, bottom row first.
    pub(crate) fn read_ids(&self, target: &Target, out: &mut Vec<u8>) {
        self.read(target, glow::COLOR_ATTACHMENT0, glow::RG_INTEGER, glow::UNSIGNED_INT, 8, out);
    }

    /// Four native f32 a pixel, bottom row first.
    pub(crate) fn read_normals(&self, target: &Target, out: &mut Vec<u8>) {
        self.read(target, glow::COLOR_ATTACHMENT1, glow::RGBA, glow::FLOAT, 16, out);
    }
}
