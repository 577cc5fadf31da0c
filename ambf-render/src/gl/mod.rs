//! OpenGL behind safe functions. Nothing outside of this module is `unsafe` in the crate.
//!
//! Every function of OpenGL acts on the context that is current on the calling thread. [`Device::enter`] makes the
//! renderer's context current and returns a [`Current`], whose methods are the only way to OpenGL; that is the
//! invariant on which the `unsafe` blocks of this module rest. What else a call needs (sizes of arrays, names that
//! exist) is checked where the call is.

mod arrays;
mod egl;
mod fixed;
mod program;
mod target;
mod texture;

use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use std::ffi::{c_void, CStr};
use std::sync::Arc;

use glow::HasContext as _;
use parking_lot::Mutex;

pub(crate) use self::fixed::{FixedLight, FixedMaterial};
use crate::RenderError;

/// Places of vertex attributes in all programs: those of a vertex, then those of an instance.
pub(crate) const ATTRIBUTES: [(u32, &str); 13] = [
    (0, "aPosition"),
    (1, "aNormal"),
    (2, "aTexCoord"),
    (3, "aTangent"),
    (4, "aBitangent"),
    (5, "i_row_x"),
    (6, "i_row_y"),
    (7, "i_row_z"),
    (8, "i_diffuse"),
    (9, "i_ambient"),
    (10, "i_specular"),
    (11, "i_emission"),
    (12, "i_ids"),
];
/// Place of the colour of a vertex, which is white where a mesh has none.
const COLOR_ATTRIBUTE: u32 = 13;
/// Floats of an instance: three rows of its pose, diffuse and alpha, ambient and shininess, specular, emission, two
/// ids.
pub(crate) const INSTANCE_FLOATS: usize = 28;
/// Floats of a vertex: position, normal, texture coordinates.
pub(crate) const VERTEX_FLOATS: usize = 8;

/// What the vertices of an array have behind position, normal and texture coordinates, in this order.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Layout {
    /// Tangent and bitangent, 6 floats.
    pub(crate) tangents: bool,
    /// Red, green, blue and alpha, 4 floats.
    pub(crate) colors: bool,
}

impl Layout {
    /// Floats of a vertex.
    pub(crate) fn floats(self) -> usize {
        VERTEX_FLOATS + if self.tangents { 6 } else { 0 } + if self.colors { 4 } else { 0 }
    }
}

/// What is deleted when the context is current the next time.
enum Name {
    Buffer(glow::Buffer),
    VertexArray(glow::VertexArray),
    Texture(glow::Texture),
    Framebuffer(glow::Framebuffer),
    Renderbuffer(glow::Renderbuffer),
    Program(glow::Program),
}

type Bin = Arc<Mutex<Vec<Name>>>;

/// An object of OpenGL that is deleted after its owner.
struct Owned<T: Copy> {
    name: T,
    bin: Bin,
    wrap: fn(T) -> Name,
}

impl<T: Copy> Drop for Owned<T> {
    fn drop(&mut self) {
        self.bin.lock().push((self.wrap)(self.name));
    }
}

/// Where the context comes from.
enum Backing {
    /// Our own, without a window.
    Offscreen(egl::Offscreen),
    /// The caller's, current at every call.
    Callers,
}

/// A context with its functions and limits.
pub(crate) struct Device {
    raw: glow::Context,
    fixed: fixed::Functions,
    bin: Bin,
    backing: Backing,
    /// Something was compiled since the compiler was released.
    has_compiled: Cell<bool>,
    /// Vendor, device and version.
    pub(crate) description: String,
    /// Drawn by the processor.
    pub(crate) is_software: bool,
    /// Most pixels of a target each way.
    pub(crate) most_pixels: u32,
    /// Most texels of a texture each way.
    pub(crate) most_texels: u32,
    /// Most texels of a texture of three dimensions each way.
    pub(crate) most_texels_of_volumes: usize,
    /// Most samples a pixel.
    most_samples: u32,
}

/// Proof that the context of a device is current on this thread.
pub(crate) struct Current<'a> {
    device: &'a Device,
}

impl Drop for Current<'_> {
    fn drop(&mut self) {
        if let Backing::Offscreen(context) = &self.device.backing {
            context.release();
        }
    }
}

impl Device {
    pub(crate) fn offscreen() -> Result<Self, RenderError> {
        let context = egl::Offscreen::new()?;
        context.make_current()?;
        let find = |name: &CStr| context.find(name);
        // SAFETY: the context is current, and its own functions are looked up.
        let (raw, fixed) = unsafe { (glow::Context::from_loader_function_cstr(find), fixed::Functions::load(find)) };
        let device = Self::new(raw, fixed, Backing::Offscreen(context));
        if device.as_ref().is_ok_and(|device| device.is_software) {
            // The C library gives memory at the end of its heap back to the system when it is twice as much as the largest
            // block that was freed (mallopt(3), M_TRIM_THRESHOLD). The renderer would get its own anew for each picture,
            // page by page, for a tenth of the time.
            drop(std::hint::black_box(Vec::<u8>::with_capacity(8 << 20)));
        }
        if let Ok(Device { backing: Backing::Offscreen(context), .. }) = &device {
            context.release();
        }
        device
    }

    /// # Safety
    /// A context is current on this thread, `find` gives the addresses of its functions, and it is current whenever the
    /// device or what is made with it is used.
    pub(crate) unsafe fn in_current_context(mut find: impl FnMut(&CStr) -> *const c_void) -> Result<Self, RenderError> {
        // SAFETY: promised by the caller.
        let (raw, fixed) =
            unsafe { (glow::Context::from_loader_function_cstr(&mut find), fixed::Functions::load(&mut find)) };
        Self::new(raw, fixed, Backing::Callers)
    }

    fn new(raw: glow::Context, fixed: Option<fixed::Functions>, backing: Backing) -> Result<Self, RenderError> {
        // SAFETY: the context is current (both callers); these are queries without pointers.
        let (vendor, renderer, version, most_target, most_texels, most_voxels, most_samples) = unsafe {
            (
                raw.get_parameter_string(glow::VENDOR),
                raw.get_parameter_string(glow::RENDERER),
                raw.get_parameter_string(glow::VERSION),
                raw.get_parameter_i32(glow::MAX_RENDERBUFFER_SIZE),
                raw.get_parameter_i32(glow::MAX_TEXTURE_SIZE),
                raw.get_parameter_i32(glow::MAX_3D_TEXTURE_SIZE),
                raw.get_parameter_i32(glow::MAX_SAMPLES),
            )
        };
        let known = raw.version();
        if (known.major, known.minor) < (3, 3) {
            return Err(RenderError::Gl(format!(
                "version 3.3 with the compatibility profile is needed, there is {version}; update the graphics driver"
            )));
        }
        let Some(fixed) = fixed else {
            return Err(RenderError::Gl(format!("the compatibility profile is needed, there is {version}")));
        };
        let is_software =
            ["llvmpipe", "softpipe", "swrast", "SwiftShader"].iter().any(|software| renderer.contains(software));
        let natural = |number: i32| u32::try_from(number).unwrap_or(0);
        Ok(Self {
            raw,
            fixed,
            bin: Bin::default(),
            backing,
            has_compiled: Cell::default(),
            description: format!("{vendor}, {renderer}, OpenGL {version}"),
            is_software,
            most_pixels: natural(most_target.min(most_texels)).min(16384),
            most_texels: natural(most_texels).min(16384),
            most_texels_of_volumes: natural(most_voxels) as usize,
            most_samples: natural(most_samples).max(1),
        })
    }

    /// Makes the context current on this thread until the value that is returned ends.
    pub(crate) fn enter(&self) -> Result<Current<'_>, RenderError> {
        if let Backing::Offscreen(context) = &self.backing {
            context.make_current()?;
        }
        let current = Current { device: self };
        current.empty_bin();
        // Since then pictures were drawn, for which Mesa has made machine code: the memory of all that is 10 MB.
        if self.has_compiled.take() {
            self.fixed.release_shader_compiler();
            give_memory_back();
        }
        Ok(current)
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        // Objects of a context of our own go with it; those of the caller's are deleted as the caller keeps the context
        // current.
        if let Backing::Callers = self.backing {
            Current { device: self }.empty_bin();
        }
    }
}

/// Vertices and triangles.
pub(crate) struct VertexArray {
    array: Owned<glow::VertexArray>,
    vertices: Owned<glow::Buffer>,
    _indices: Owned<glow::Buffer>,
    /// Number of indices.
    count: i32,
    /// Size of the vertex buffer.
    floats: usize,
    pub(crate) layout: Layout,
}

/// A buffer of instances that all vertex arrays share.
pub(crate) struct InstanceBuffer(Owned<glow::Buffer>);

/// A texture.
pub(crate) struct Texture {
    texture: Owned<glow::Texture>,
    target: u32,
}

/// A program with its uniforms.
pub(crate) struct Program {
    program: Owned<glow::Program>,
    locations: RefCell<HashMap<String, Option<glow::UniformLocation>>>,
}

/// What is drawn into.
pub(crate) struct Target {
    framebuffer: Owned<glow::Framebuffer>,
    /// Attachments that live as long as the frame buffer.
    _renderbuffers: Vec<Owned<glow::Renderbuffer>>,
    pub(crate) depth: Option<Texture>,
    pub(crate) width: u32,
    pub(crate) height: u32,
}

/// Attachments of a [`Target`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum TargetKind {
    /// RGBA8 and depth, with this many samples a pixel.
    Color(u32),
    /// Ids (2 x u32) and depth, and normals (4 x f32) if they are wanted.
    Flat(bool),
    /// Depth as a texture that is compared with.
    Shadow,
}

/// What is sent to a uniform.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Uniform<'a> {
    Int(i32),
    Float(f32),
    Vec3([f32; 3]),
    Vec4([f32; 4]),
    /// Column by column.
    Mat4(&'a [f32; 16]),
}

/// Which faces are left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Cull {
    None,
    Front,
    Back,
}

/// What is made of the indices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Mode {
    Triangles,
    Points,
    Lines,
}

/// Gives memory that was freed back to the system; the C library keeps what is not at the end of a heap.
fn give_memory_back() {
    #[cfg(target_env = "gnu")]
    {
        unsafe extern "C" {
            fn malloc_trim(pad: usize) -> std::ffi::c_int;
        }
        // SAFETY: the signature is that of glibc; it touches only memory that nobody holds.
        unsafe { malloc_trim(0) };
    }
}

impl Current<'_> {
    pub(crate) fn device(&self) -> &Device {
        self.device
    }

    fn own<T: Copy>(&self, name: T, wrap: fn(T) -> Name) -> Owned<T> {
        Owned { name, bin: Arc::clone(&self.device.bin), wrap }
    }

    fn raw(&self) -> &glow::Context {
        &self.device.raw
    }

    fn empty_bin(&self) {
        let names = std::mem::take(&mut *self.device.bin.lock());
        let gl = self.raw();
        for name in names {
            // SAFETY: the context is current, the name was made in it and its owner is gone.
            unsafe {
                match name {
                    Name::Buffer(name) => gl.delete_buffer(name),
                    Name::VertexArray(name) => gl.delete_vertex_array(name),
                    Name::Texture(name) => gl.delete_texture(name),
                    Name::Framebuffer(name) => gl.delete_framebuffer(name),
                    Name::Renderbuffer(name) => gl.delete_renderbuffer(name),
                    Name::Program(name) => gl.delete_program(name),
                }
            }
        }
    }

    /// The first error since the last call of this function.
    pub(crate) fn error(&self) -> Option<String> {
        // SAFETY: a query.
        match unsafe { self.raw().get_error() } {
            glow::NO_ERROR => None,
            glow::OUT_OF_MEMORY => Some("out of memory".into()),
            glow::CONTEXT_LOST => Some("the context is lost".into()),
            code => Some(format!("error 0x{code:04x}")),
        }
    }

    /// Forgets errors that others left.
    pub(crate) fn clear_errors(&self) {
        for _ in 0..16 {
            if self.error().is_none() {
                break;
            }
        }
    }

    pub(crate) fn viewport(&self, left: u32, width: u32, height: u32) {
        // SAFETY: numbers only. The scissor keeps clearing within the viewport.
        unsafe {
            self.raw().viewport(left as i32, 0, width as i32, height as i32);
            self.raw().scissor(left as i32, 0, width as i32, height as i32);
            self.raw().enable(glow::SCISSOR_TEST);
        }
    }

    /// Keeps clearing and drawing within a part of the viewport: left, bottom, width, height.
    pub(crate) fn scissor(&self, [left, bottom, width, height]: [u32; 4]) {
        // SAFETY: numbers only.
        unsafe { self.raw().scissor(left as i32, bottom as i32, width as i32, height as i32) };
    }

    /// Clears colour (white), if there is one, and depth within the viewport and the scissor.
    pub(crate) fn clear(&self, color: bool) {
        // SAFETY: numbers only.
        unsafe {
            self.raw().depth_mask(true);
            self.raw().color_mask(true, true, true, true);
            self.raw().clear_color(1.0, 1.0, 1.0, 1.0);
            self.raw().clear_depth_f32(1.0);
            let bits = if color { glow::COLOR_BUFFER_BIT } else { 0 };
            self.raw().clear(bits | glow::DEPTH_BUFFER_BIT);
        }
    }

    /// Clears ids, normals if there are any, and depth within the viewport.
    pub(crate) fn clear_flat(&self, normals: bool) {
        // SAFETY: numbers only; slices have four components.
        unsafe {
            self.raw().depth_mask(true);
            self.raw().clear_buffer_u32_slice(glow::COLOR, 0, &[0; 4]);
            if normals {
                self.raw().clear_buffer_f32_slice(glow::COLOR, 1, &[0.0; 4]);
            }
            self.raw().clear_buffer_f32_slice(glow::DEPTH, 0, &[1.0]);
        }
    }

    /// Sets the whole state that drawing depends on: callers draw with the same context.
    pub(crate) fn state(&self, blend: bool, depth_write: bool, cull: Cull) {
        let gl = self.raw();
        // SAFETY: numbers only.
        unsafe {
            gl.enable(glow::DEPTH_TEST);
            gl.depth_func(glow::LEQUAL);
            gl.depth_mask(depth_write);
            gl.color_mask(true, true, true, true);
            gl.disable(glow::STENCIL_TEST);
            gl.disable(glow::FRAMEBUFFER_SRGB);
            gl.disable(glow::DITHER);
            gl.front_face(glow::CCW);
            gl.polygon_mode(glow::FRONT_AND_BACK, glow::FILL);
            match blend {
                true => {
                    gl.enable(glow::BLEND);
                    gl.blend_equation(glow::FUNC_ADD);
                    // The alpha of a window stays 1.
                    gl.blend_func_separate(glow::SRC_ALPHA, glow::ONE_MINUS_SRC_ALPHA, glow::ZERO, glow::ONE);
                }
                false => gl.disable(glow::BLEND),
            }
            match cull {
                Cull::None => gl.disable(glow::CULL_FACE),
                Cull::Front | Cull::Back => {
                    gl.enable(glow::CULL_FACE);
                    gl.cull_face(if cull == Cull::Front { glow::FRONT } else { glow::BACK });
                }
            }
        }
    }

    /// Depths are a little larger than they are, so that a surface in a shadow map does not shade itself.
    pub(crate) fn push_back(&self, is_on: bool) {
        // SAFETY: numbers only.
        unsafe {
            match is_on {
                true => {
                    self.raw().enable(glow::POLYGON_OFFSET_FILL);
                    self.raw().polygon_offset(2.0, 4.0);
                }
                false => self.raw().disable(glow::POLYGON_OFFSET_FILL),
            }
        }
    }

    /// Triangles are drawn as their edges, until [`state`](Self::state) is called.
    pub(crate) fn outlines(&self) {
        // SAFETY: numbers only.
        unsafe { self.raw().polygon_mode(glow::FRONT_AND_BACK, glow::LINE) };
    }

    /// Points are as large as the program says.
    pub(crate) fn sized_points(&self) {
        // SAFETY: numbers only.
        unsafe { self.raw().enable(glow::PROGRAM_POINT_SIZE) };
    }

    /// Leaves a state in which others draw: nothing bound, no scissor, no depth test.
    pub(crate) fn leave(&self) {
        let gl = self.raw();
        // SAFETY: numbers only.
        unsafe {
            gl.use_program(None);
            gl.disable(glow::SCISSOR_TEST);
            gl.disable(glow::DEPTH_TEST);
            gl.disable(glow::CULL_FACE);
            gl.disable(glow::BLEND);
            gl.depth_mask(true);
            gl.bind_buffer(glow::ARRAY_BUFFER, None);
            gl.active_texture(glow::TEXTURE0);
            gl.bind_texture(glow::TEXTURE_2D, None);
        }
    }

    /// State of the fixed-function pipeline that programs of users read: lights, in world coordinates.
    pub(crate) fn fixed_scene(&self, view: &[f32; 16], projection: &[f32; 16], lights: &[FixedLight]) {
        self.device.fixed.scene(view, projection, lights);
    }

    /// Pose of an object in eye coordinates, and its material.
    pub(crate) fn fixed_object(&self, model_view: &[f32; 16], material: &FixedMaterial) {
        self.device.fixed.object(model_view, material);
    }
}
