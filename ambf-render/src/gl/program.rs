//! Programs of shaders and their uniforms.

use std::cell::RefCell;

use glow::HasContext as _;

use super::{Current, Name, Program, Uniform, ATTRIBUTES, COLOR_ATTRIBUTE};

impl Current<'_> {
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
}
