//! OpenGL behind safe functions. Nothing outside of this module is `unsafe` in the crate.
//!
//! Every function of OpenGL acts on the context that is current on the calling thread. [`Device::enter`] makes the
//! renderer's context current and returns a [`Current`], whose methods are the only way to OpenGL; that is the
//! invariant on which the `unsafe` blocks of this module rest. What else a call needs (sizes of arrays, names that
//! exist) is checked where the call is.

mod egl;
mod fixed;
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
        let (vendor, renderer, version, most_target, most_texels, most_samples) = unsafe {
            (
                raw.get_parameter_string(glow::VENDOR),
                raw.get_parameter_string(glow::RENDERER),
                raw.get_parameter_string(glow::VERSION),
                raw.get_parameter_i32(glow::MAX_RENDERBUFFER_SIZE),
                raw.get_parameter_i32(glow::MAX_TEXTURE_SIZE),
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

fn bytes<T: Plain>(values: &[T]) -> &[u8] {
    // SAFETY: plain numbers (trait `Plain` is implemented below for those only) have no padding and any bytes may be
    // read.
    unsafe { std::slice::from_raw_parts(values.as_ptr().cast(), std::mem::size_of_val(values)) }
}

/// Numbers and arrays of numbers.
trait Plain {}
impl Plain for f32 {}
impl Plain for u32 {}

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

    fn buffer(&self, target: u32, data: &[u8], usage: u32) -> Result<Owned<glow::Buffer>, RenderError> {
        // SAFETY: the data are a slice, whose length glow passes on.
        unsafe {
            let name = self.raw().create_buffer().map_err(RenderError::Gl)?;
            self.raw().bind_buffer(target, Some(name));
            self.raw().buffer_data_u8_slice(target, data, usage);
            Ok(self.own(name, Name::Buffer))
        }
    }

    /// Uploads vertices of this layout; indices are of these vertices.
    pub(crate) fn vertex_array(
        &self,
        vertices: &[f32],
        layout: Layout,
        indices: &[u32],
    ) -> Result<VertexArray, RenderError> {
        let floats = layout.floats();
        let count = vertices.len() / floats;
        assert!(indices.iter().all(|&index| (index as usize) < count), "an index is of no vertex");
        let gl = self.raw();
        // SAFETY: the attributes lie within the vertices, and the indices are of vertices (checked above).
        unsafe {
            let array = self.own(gl.create_vertex_array().map_err(RenderError::Gl)?, Name::VertexArray);
            gl.bind_vertex_array(Some(array.name));
            let buffer = self.buffer(glow::ARRAY_BUFFER, bytes(vertices), glow::STATIC_DRAW)?;
            let stride = (floats * 4) as i32;
            let mut attributes: Vec<(u32, i32, i32)> = vec![(0, 3, 0), (1, 3, 12), (2, 2, 24)];
            if layout.tangents {
                attributes.extend([(3, 3, 32), (4, 3, 44)]);
            }
            if layout.colors {
                attributes.push((COLOR_ATTRIBUTE, 4, stride - 16));
            }
            for (place, size, offset) in attributes {
                gl.enable_vertex_attrib_array(place);
                gl.vertex_attrib_pointer_f32(place, size, glow::FLOAT, false, stride, offset);
            }
            let index_buffer = self.buffer(glow::ELEMENT_ARRAY_BUFFER, bytes(indices), glow::STATIC_DRAW)?;
            gl.bind_vertex_array(None);
            let result = VertexArray {
                array,
                vertices: buffer,
                _indices: index_buffer,
                count: indices.len().try_into().map_err(|_| RenderError::Gl("a mesh is too large".into()))?,
                floats: vertices.len(),
                layout,
            };
            match gl.get_error() {
                glow::NO_ERROR => Ok(result),
                code => Err(RenderError::Gl(format!("a mesh cannot be stored (error 0x{code:04x})"))),
            }
        }
    }

    /// Replaces all vertices by as many others.
    pub(crate) fn update_vertices(&self, array: &VertexArray, vertices: &[f32]) {
        assert_eq!(vertices.len(), array.floats, "as many vertices as before");
        // SAFETY: the buffer has this size.
        unsafe {
            self.raw().bind_buffer(glow::ARRAY_BUFFER, Some(array.vertices.name));
            self.raw().buffer_data_u8_slice(glow::ARRAY_BUFFER, bytes(vertices), glow::DYNAMIC_DRAW);
        }
    }

    pub(crate) fn instance_buffer(&self) -> Result<InstanceBuffer, RenderError> {
        self.buffer(glow::ARRAY_BUFFER, &[], glow::STREAM_DRAW).map(InstanceBuffer)
    }

    /// Replaces all instances.
    pub(crate) fn upload_instances(&self, buffer: &InstanceBuffer, instances: &[f32]) {
        // SAFETY: the data are a slice.
        unsafe {
            self.raw().bind_buffer(glow::ARRAY_BUFFER, Some(buffer.0.name));
            self.raw().buffer_data_u8_slice(glow::ARRAY_BUFFER, bytes(instances), glow::STREAM_DRAW);
        }
    }

    /// Draws `count` instances from `first` on, out of `uploaded` that are in the buffer.
    pub(crate) fn draw_instances(
        &self,
        array: &VertexArray,
        mode: Mode,
        buffer: &InstanceBuffer,
        first: usize,
        count: usize,
        uploaded: usize,
    ) {
        assert!(first + count <= uploaded, "instances that were not uploaded");
        let gl = self.raw();
        let stride = (INSTANCE_FLOATS * 4) as i32;
        let start = (first * INSTANCE_FLOATS * 4) as i32;
        let floats = [(5, 4, 0), (6, 4, 16), (7, 4, 32), (8, 4, 48), (9, 4, 64), (10, 3, 80), (11, 3, 92)];
        // SAFETY: the attributes of all instances lie within the buffer (checked above); indices were checked at
        // upload.
        unsafe {
            gl.bind_vertex_array(Some(array.array.name));
            gl.bind_buffer(glow::ARRAY_BUFFER, Some(buffer.0.name));
            for (place, size, offset) in floats {
                gl.enable_vertex_attrib_array(place);
                gl.vertex_attrib_pointer_f32(place, size, glow::FLOAT, false, stride, start + offset);
                gl.vertex_attrib_divisor(place, 1);
            }
            gl.enable_vertex_attrib_array(12);
            gl.vertex_attrib_pointer_i32(12, 2, glow::UNSIGNED_INT, stride, start + 104);
            gl.vertex_attrib_divisor(12, 1);
            gl.draw_elements_instanced(mode.code(), array.count, glow::UNSIGNED_INT, 0, count as i32);
            gl.bind_vertex_array(None);
        }
    }

    /// Draws once, without instances, for programs of users.
    pub(crate) fn draw(&self, array: &VertexArray) {
        let gl = self.raw();
        // SAFETY: indices were checked at upload; the attributes of instances are off, so that constants are read.
        unsafe {
            gl.bind_vertex_array(Some(array.array.name));
            for place in 5..13 {
                gl.disable_vertex_attrib_array(place);
            }
            if !array.layout.colors {
                gl.vertex_attrib_4_f32(COLOR_ATTRIBUTE, 1.0, 1.0, 1.0, 1.0);
            }
            if !array.layout.tangents {
                gl.vertex_attrib_4_f32(3, 1.0, 0.0, 0.0, 0.0);
                gl.vertex_attrib_4_f32(4, 0.0, 1.0, 0.0, 0.0);
            }
            gl.draw_elements(glow::TRIANGLES, array.count, glow::UNSIGNED_INT, 0);
            gl.bind_vertex_array(None);
        }
    }

    /// Draws as [`draw`](Self::draw) does, everything at the greatest depth.
    pub(crate) fn draw_farthest(&self, array: &VertexArray) {
        // SAFETY: a state without conditions.
        unsafe { self.raw().depth_range_f32(1.0, 1.0) };
        self.draw(array);
        // SAFETY: as above; the usual range.
        unsafe { self.raw().depth_range_f32(0.0, 1.0) };
    }

    /// Draws one triangle of which the vertex shader knows the corners.
    pub(crate) fn draw_covering(&self) {
        // SAFETY: no vertex attribute is read; without a vertex array that is legal in a compatibility profile.
        unsafe {
            self.raw().bind_vertex_array(None);
            self.raw().draw_arrays(glow::TRIANGLES, 0, 3);
        }
    }

    /// Draws two triangles of which the vertex shader knows the four corners: upper left, upper right, lower left,
    /// lower right.
    pub(crate) fn draw_rectangle(&self) {
        // SAFETY: as in `draw_covering`.
        unsafe {
            self.raw().bind_vertex_array(None);
            self.raw().draw_arrays(glow::TRIANGLE_STRIP, 0, 4);
        }
    }

    /// Compiles and links; the error is what the compiler says.
    pub(crate) fn program(&self, vertex: &str, fragment: &str) -> Result<Program, String> {
        let gl = self.raw();
        self.device.has_compiled.set(true);
        // SAFETY: names are of objects that are made here; sources are strings whose lengths glow passes on.
        unsafe {
            let program = self.own(gl.create_program()?, Name::Program);
            let mut shaders = Vec::new();
            let mut complaint = None;
            for (kind, word, source) in
                [(glow::VERTEX_SHADER, "vertex shader", vertex), (glow::FRAGMENT_SHADER, "fragment shader", fragment)]
            {
                let shader = gl.create_shader(kind)?;
                shaders.push(shader);
                gl.shader_source(shader, source);
                gl.compile_shader(shader);
                if !gl.get_shader_compile_status(shader) {
                    complaint.get_or_insert(format!("{word}: {}", gl.get_shader_info_log(shader).trim()));
                }
                gl.attach_shader(program.name, shader);
            }
            if complaint.is_none() {
                for (place, name) in ATTRIBUTES.into_iter().chain([(COLOR_ATTRIBUTE, "aColor")]) {
                    gl.bind_attrib_location(program.name, place, name);
                }
                for (place, name) in [(0, "o_color"), (0, "o_ids"), (1, "o_normal")] {
                    gl.bind_frag_data_location(program.name, place, name);
                }
                gl.link_program(program.name);
                if !gl.get_program_link_status(program.name) {
                    complaint = Some(format!("linking: {}", gl.get_program_info_log(program.name).trim()));
                }
            }
            for shader in shaders {
                gl.detach_shader(program.name, shader);
                gl.delete_shader(shader);
            }
            match complaint {
                None => Ok(Program { program, locations: RefCell::default() }),
                Some(complaint) => Err(complaint),
            }
        }
    }

    pub(crate) fn use_program(&self, program: Option<&Program>) {
        // SAFETY: the program exists as long as its owner.
        unsafe { self.raw().use_program(program.map(|program| program.program.name)) };
    }

    /// Sets a uniform of the program that is used; nothing if it has none of this name.
    pub(crate) fn uniform(&self, program: &Program, name: &str, value: Uniform<'_>) {
        let gl = self.raw();
        let mut locations = program.locations.borrow_mut();
        if !locations.contains_key(name) {
            // SAFETY: the program exists.
            let location = unsafe { gl.get_uniform_location(program.program.name, name) };
            locations.insert(name.to_owned(), location);
        }
        let Some(Some(location)) = locations.get(name) else { return };
        // SAFETY: the location is of this program; a type that does not fit is an error of OpenGL, which changes
        // nothing.
        unsafe {
            let location = Some(location);
            match value {
                Uniform::Int(value) => gl.uniform_1_i32(location, value),
                Uniform::Float(value) => gl.uniform_1_f32(location, value),
                Uniform::Vec3([x, y, z]) => gl.uniform_3_f32(location, x, y, z),
                Uniform::Vec4([x, y, z, w]) => gl.uniform_4_f32(location, x, y, z, w),
                Uniform::Mat4(matrix) => gl.uniform_matrix_4_f32_slice(location, false, matrix),
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

impl Mode {
    fn code(self) -> u32 {
        match self {
            Mode::Triangles => glow::TRIANGLES,
            Mode::Points => glow::POINTS,
            Mode::Lines => glow::LINES,
        }
    }
}
