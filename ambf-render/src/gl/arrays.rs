//! Arrays of vertices and of instances, and drawing them.

use glow::HasContext as _;

use super::{Current, InstanceBuffer, Layout, Mode, Name, Owned, VertexArray, COLOR_ATTRIBUTE, INSTANCE_FLOATS};
use crate::RenderError;

/// Numbers and arrays of numbers.
trait Plain {}
impl Plain for f32 {}
impl Plain for u32 {}

fn bytes<T: Plain>(values: &[T]) -> &[u8] {
    // SAFETY: plain numbers (trait `Plain` is implemented below for those only) have no padding and any bytes may be
    // read.
    unsafe { std::slice::from_raw_parts(values.as_ptr().cast(), std::mem::size_of_val(values)) }
}

impl Current<'_> {
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
