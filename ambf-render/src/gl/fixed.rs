//! The few functions of the fixed-function pipeline that programs of users depend on: they read `gl_LightSource`,
//! `gl_FrontMaterial`, `gl_ModelViewMatrix`, `gl_EyePlaneS` and their like; and `glReleaseShaderCompiler`. `glow` has none
//! of them.

use std::ffi::{c_void, CStr};

const MODELVIEW: u32 = 0x1700;
const PROJECTION: u32 = 0x1701;
const LIGHT0: u32 = 0x4000;
const AMBIENT: u32 = 0x1200;
const DIFFUSE: u32 = 0x1201;
const SPECULAR: u32 = 0x1202;
const POSITION: u32 = 0x1203;
const SPOT_DIRECTION: u32 = 0x1204;
const SPOT_EXPONENT: u32 = 0x1205;
const SPOT_CUTOFF: u32 = 0x1206;
const CONSTANT_ATTENUATION: u32 = 0x1207;
const LINEAR_ATTENUATION: u32 = 0x1208;
const QUADRATIC_ATTENUATION: u32 = 0x1209;
const EMISSION: u32 = 0x1600;
const SHININESS: u32 = 0x1601;
const LIGHT_MODEL_AMBIENT: u32 = 0x0B53;
const FRONT_AND_BACK: u32 = 0x0408;
const TEXTURE1: u32 = 0x84C1;
const TEXTURE0: u32 = 0x84C0;
const EYE_PLANE: u32 = 0x2502;
const TEXTURE_COORDINATES: [u32; 4] = [0x2000, 0x2001, 0x2002, 0x2003];
/// Lights that the fixed-function pipeline has.
const MAX_LIGHTS: u32 = 8;

/// A spot light in world coordinates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FixedLight {
    /// m.
    pub(crate) position: [f32; 3],
    /// Of unit length.
    pub(crate) axis: [f32; 3],
    /// Half angle of the cone, degrees, 0 to 90.
    pub(crate) cutoff: f32,
    pub(crate) exponent: f32,
    /// Constant, linear and quadratic.
    pub(crate) attenuation: [f32; 3],
    /// From the world to coordinates of its shadow map, row by row; `None`: no shadows.
    pub(crate) shadow: Option<[[f32; 4]; 4]>,
}

/// A material.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FixedMaterial {
    pub(crate) ambient: [f32; 4],
    pub(crate) diffuse: [f32; 4],
    pub(crate) specular: [f32; 4],
    pub(crate) emission: [f32; 4],
    /// 0 to 128.
    pub(crate) shininess: f32,
}

type Nothing = unsafe extern "system" fn();
type OneEnum = unsafe extern "system" fn(u32);
type Matrix = unsafe extern "system" fn(*const f32);
type Vector = unsafe extern "system" fn(u32, *const f32);
type NamedVector = unsafe extern "system" fn(u32, u32, *const f32);

/// Addresses of the functions.
pub(super) struct Functions {
    matrix_mode: OneEnum,
    active_texture: OneEnum,
    load_matrix: Matrix,
    light_model: Vector,
    light: NamedVector,
    material: NamedVector,
    tex_gen: NamedVector,
    /// Of OpenGL 4.1.
    release_shader_compiler: Option<Nothing>,
}

impl Functions {
    /// `None` if the context has no fixed-function pipeline.
    ///
    /// # Safety
    /// A context is current, and `find` gives the addresses of its functions, null for those it does not have.
    pub(super) unsafe fn load(mut find: impl FnMut(&CStr) -> *const c_void) -> Option<Self> {
        let mut get = |name: &CStr| {
            let address = find(name);
            (!address.is_null()).then_some(address)
        };
        // SAFETY: each type is the signature that the OpenGL specification gives to the function of this name.
        unsafe {
            Some(Self {
                matrix_mode: std::mem::transmute::<*const c_void, OneEnum>(get(c"glMatrixMode")?),
                active_texture: std::mem::transmute::<*const c_void, OneEnum>(get(c"glActiveTexture")?),
                load_matrix: std::mem::transmute::<*const c_void, Matrix>(get(c"glLoadMatrixf")?),
                light_model: std::mem::transmute::<*const c_void, Vector>(get(c"glLightModelfv")?),
                light: std::mem::transmute::<*const c_void, NamedVector>(get(c"glLightfv")?),
                material: std::mem::transmute::<*const c_void, NamedVector>(get(c"glMaterialfv")?),
                tex_gen: std::mem::transmute::<*const c_void, NamedVector>(get(c"glTexGenfv")?),
                release_shader_compiler: get(c"glReleaseShaderCompiler")
                    .map(|address| std::mem::transmute::<*const c_void, Nothing>(address)),
            })
        }
    }

    /// The compiler's memory can be freed, until the next shader.
    pub(super) fn release_shader_compiler(&self) {
        if let Some(release) = self.release_shader_compiler {
            // SAFETY: as in `scene`.
            unsafe { release() };
        }
    }

    pub(super) fn scene(&self, view: &[f32; 16], projection: &[f32; 16], lights: &[FixedLight]) {
        // SAFETY: the context is current (only `Current` calls this); every pointer is to as many floats as the
        // parameter has (16 for matrices, 4 for vectors, 1 for numbers).
        unsafe {
            (self.matrix_mode)(PROJECTION);
            (self.load_matrix)(projection.as_ptr());
            (self.matrix_mode)(MODELVIEW);
            // Positions, directions and planes are taken to eye coordinates by the matrix that is loaded when they are
            // set.
            (self.load_matrix)(view.as_ptr());
            (self.light_model)(LIGHT_MODEL_AMBIENT, [0.2_f32, 0.2, 0.2, 1.0].as_ptr());
            for (index, place) in (LIGHT0..LIGHT0 + MAX_LIGHTS).enumerate() {
                let set = |name: u32, value: &[f32; 4]| (self.light)(place, name, value.as_ptr());
                let number = |name: u32, value: f32| (self.light)(place, name, &raw const value);
                let Some(light) = lights.get(index) else {
                    for name in [AMBIENT, DIFFUSE, SPECULAR] {
                        set(name, &[0.0, 0.0, 0.0, 1.0]);
                    }
                    continue;
                };
                let [x, y, z] = light.position;
                set(POSITION, &[x, y, z, 1.0]);
                let [x, y, z] = light.axis;
                set(SPOT_DIRECTION, &[x, y, z, 0.0]);
                set(AMBIENT, &[0.4, 0.4, 0.4, 1.0]);
                set(DIFFUSE, &[0.7, 0.7, 0.7, 1.0]);
                set(SPECULAR, &[1.0; 4]);
                number(SPOT_CUTOFF, light.cutoff);
                number(SPOT_EXPONENT, light.exponent.clamp(0.0, 128.0));
                let names = [CONSTANT_ATTENUATION, LINEAR_ATTENUATION, QUADRATIC_ATTENUATION];
                for (name, value) in names.into_iter().zip(light.attenuation) {
                    number(name, value.max(0.0));
                }
            }
            if let Some(planes) = lights.iter().filter_map(|light| light.shadow).next_back() {
                (self.active_texture)(TEXTURE1);
                for (coordinate, plane) in TEXTURE_COORDINATES.into_iter().zip(planes) {
                    (self.tex_gen)(coordinate, EYE_PLANE, plane.as_ptr());
                }
                (self.active_texture)(TEXTURE0);
            }
        }
    }

    pub(super) fn object(&self, model_view: &[f32; 16], material: &FixedMaterial) {
        // SAFETY: as in `scene`.
        unsafe {
            (self.load_matrix)(model_view.as_ptr());
            let set = |name: u32, value: &[f32; 4]| (self.material)(FRONT_AND_BACK, name, value.as_ptr());
            set(AMBIENT, &material.ambient);
            set(DIFFUSE, &material.diffuse);
            set(SPECULAR, &material.specular);
            set(EMISSION, &material.emission);
            let shininess = material.shininess.clamp(0.0, 128.0);
            (self.material)(FRONT_AND_BACK, SHININESS, &raw const shininess);
        }
    }
}
