//! What is drawn, in which order, with which programs.

use std::collections::hash_map::Entry;
use std::collections::HashMap;
use std::path::PathBuf;

use ambf_core::adf::ShaderProgram;
use ambf_core::files;
use nalgebra::{Matrix3, Matrix4, Point3, Vector3};

use crate::gl::{self, Cull, Current, FixedMaterial, InstanceBuffer, Mode, Program, Uniform};
use crate::lights::{self, narrow, Light, ShadowMap};
use crate::meshes::Part;
use crate::shaders::{self, Lit};
use crate::sky::{self, Sky};
use crate::stage::{Backdrop, Look};
use crate::view::Eye;
use crate::volumes::Isosurface;
use crate::RenderError;

/// How something is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Style {
    /// By the lights.
    Lit,
    /// By a program of the user, by its index.
    User(usize),
    /// In its diffuse colour: edges of triangles.
    Outline,
    /// In its diffuse colour: points of this size in pixels.
    Points(f32),
    /// In its diffuse colour: lines.
    Lines,
}

/// A part at a place.
pub(crate) struct Drawable<'a> {
    pub(crate) part: &'a Part,
    /// (3 x 4) from the part to the world, row by row.
    pub(crate) rows: [f32; 12],
    pub(crate) look: Look,
    pub(crate) ids: [u32; 2],
    pub(crate) style: Style,
    /// Bounding sphere in the world.
    pub(crate) center: Point3<f64>,
    pub(crate) radius: f64,
    /// Whether it is a body, ghost object or soft body, and no marker.
    pub(crate) is_object: bool,
    /// Whether it is a sheet: soft bodies are.
    pub(crate) is_sheet: bool,
    /// The part is the box of these voxels, in which the surface is looked for.
    pub(crate) isosurface: Option<&'a Isosurface>,
}

impl Drawable<'_> {
    /// From the part to the world.
    fn pose(&self) -> Matrix4<f64> {
        let r = self.rows.map(f64::from);
        Matrix4::new(r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11], 0.0, 0.0, 0.0, 1.0)
    }
}

/// Instances of one part.
pub(crate) struct Run<'a> {
    pub(crate) part: &'a Part,
    pub(crate) first: usize,
    pub(crate) count: usize,
}

/// Instances as they are uploaded, successive ones of one part together.
#[derive(Default)]
pub(crate) struct Batches<'a> {
    pub(crate) instances: Vec<f32>,
    /// (instances x 1) index of the drawable.
    order: Vec<usize>,
    pub(crate) runs: Vec<Run<'a>>,
}

impl<'a> Batches<'a> {
    pub(crate) fn new(drawables: &[Drawable<'a>], order: impl Iterator<Item = usize>) -> Self {
        let mut batches = Self::default();
        for index in order {
            let drawable = &drawables[index];
            let first = batches.count();
            let before = batches.order.last().map(|&before| &drawables[before]);
            let goes_on = before.is_some_and(|before| {
                std::ptr::eq(before.part, drawable.part)
                    && before.style == drawable.style
                    && before.look.physical.is_some() == drawable.look.physical.is_some()
                    && before.isosurface.is_none()
                    && drawable.isosurface.is_none()
            });
            batches.push(drawable);
            batches.order.push(index);
            match batches.runs.last_mut().filter(|_| goes_on) {
                Some(run) => run.count += 1,
                None => batches.runs.push(Run { part: drawable.part, first, count: 1 }),
            }
        }
        batches
    }

    fn push(&mut self, drawable: &Drawable<'_>) {
        let look = &drawable.look;
        let out = &mut self.instances;
        out.extend_from_slice(&drawable.rows);
        out.extend_from_slice(&look.diffuse);
        out.extend_from_slice(&look.ambient);
        out.push(look.shininess);
        out.extend_from_slice(&look.specular_or_physical());
        out.extend_from_slice(&look.emission);
        out.extend(drawable.ids.map(f32::from_bits));
    }

    /// Number of instances.
    pub(crate) fn count(&self) -> usize {
        self.order.len()
    }
}

/// Indices of what is at least partly within a view.
pub(crate) fn visible(drawables: &[Drawable<'_>], clip: &Matrix4<f64>) -> Vec<usize> {
    let planes: Vec<_> = (0..6)
        .map(|i| {
            let row = clip.row(i / 2);
            let plane = if i % 2 == 0 { clip.row(3) + row } else { clip.row(3) - row };
            let length = plane.fixed_columns::<3>(0).norm();
            if length > 0.0 {
                plane / length
            } else {
                plane
            }
        })
        .collect();
    let is_seen = |drawable: &Drawable<'_>| {
        let center = drawable.center.to_homogeneous();
        // What is not finite is left to OpenGL.
        !planes.iter().any(|plane| (plane * center)[0] < -drawable.radius)
    };
    (0..drawables.len()).filter(|&index| is_seen(&drawables[index])).collect()
}

/// Programs, each compiled when it is needed first.
#[derive(Default)]
pub(crate) struct Programs {
    lit: HashMap<Lit, Program>,
    /// Of surfaces, of voxels.
    depth: [Option<Program>; 2],
    /// Without normals, with them; of surfaces, of voxels.
    ids: [[Option<Program>; 2]; 2],
    unlit: Option<Program>,
    /// Of surfaces, of voxels.
    mask: [Option<Program>; 2],
    sky: Option<Program>,
    backdrop: Option<Program>,
    /// `None`: cannot be used.
    user: Vec<Option<Program>>,
    user_index: HashMap<(PathBuf, PathBuf), usize>,
}

fn compiled<'a>(
    slot: &'a mut Option<Program>,
    gl: &Current<'_>,
    vertex: &str,
    fragment: &str,
) -> Result<&'a Program, RenderError> {
    match slot {
        Some(program) => Ok(program),
        None => Ok(slot.insert(gl.program(vertex, fragment).map_err(RenderError::Gl)?)),
    }
}

impl Programs {
    pub(crate) fn depth(&mut self, gl: &Current<'_>) -> Result<&Program, RenderError> {
        compiled(&mut self.depth[0], gl, shaders::DEPTH_VERTEX, shaders::DEPTH_FRAGMENT)
    }

    fn depth_of_voxels(&mut self, gl: &Current<'_>) -> Result<&Program, RenderError> {
        compiled(&mut self.depth[1], gl, &shaders::voxels_vertex(false), &shaders::voxels_depth())
    }

    fn ids(&mut self, gl: &Current<'_>, normals: bool, of_voxels: bool) -> Result<&Program, RenderError> {
        let vertex = if of_voxels { shaders::voxels_vertex(true) } else { shaders::ids_vertex() };
        let fragment = if of_voxels { shaders::voxels_ids(normals) } else { shaders::ids(normals) };
        compiled(&mut self.ids[usize::from(of_voxels)][usize::from(normals)], gl, &vertex, &fragment)
    }

    fn unlit(&mut self, gl: &Current<'_>) -> Result<&Program, RenderError> {
        compiled(&mut self.unlit, gl, shaders::VERTEX, shaders::UNLIT_FRAGMENT)
    }

    fn mask(&mut self, gl: &Current<'_>, of_voxels: bool) -> Result<&Program, RenderError> {
        match of_voxels {
            true => compiled(&mut self.mask[1], gl, &shaders::voxels_vertex(false), &shaders::voxels_mask()),
            false => compiled(&mut self.mask[0], gl, shaders::VERTEX, shaders::MASK_FRAGMENT),
        }
    }

    fn sky(&mut self, gl: &Current<'_>) -> Result<&Program, RenderError> {
        compiled(&mut self.sky, gl, shaders::SKY_VERTEX, shaders::SKY_FRAGMENT)
    }

    fn backdrop(&mut self, gl: &Current<'_>) -> Result<&Program, RenderError> {
        compiled(&mut self.backdrop, gl, shaders::BACKDROP_VERTEX, shaders::BACKDROP_FRAGMENT)
    }

    fn lit(&mut self, gl: &Current<'_>, lit: Lit) -> Result<&Program, RenderError> {
        Ok(match self.lit.entry(lit) {
            Entry::Occupied(entry) => entry.into_mut(),
            Entry::Vacant(entry) => entry.insert(gl.program(&lit.vertex(), &lit.fragment()).map_err(RenderError::Gl)?),
        })
    }

    /// Index of a program of a user; `None` with a message the first time when it cannot be used.
    pub(crate) fn user(
        &mut self,
        gl: &Current<'_>,
        files: &ShaderProgram,
        messages: &mut Vec<String>,
    ) -> Option<usize> {
        let key = (files.vertex.clone(), files.fragment.clone());
        let index = match self.user_index.get(&key) {
            Some(index) => *index,
            None => {
                let program = user_program(gl, files).map_err(|message| messages.push(message)).ok();
                self.user.push(program);
                self.user_index.insert(key, self.user.len() - 1);
                self.user.len() - 1
            }
        };
        self.user[index].is_some().then_some(index)
    }
}

/// Most bytes of a shader.
const MAX_SHADER: u64 = 1 << 20;

fn user_program(gl: &Current<'_>, files: &ShaderProgram) -> Result<Program, String> {
    let read = |path: &PathBuf| {
        let bytes = files::read(path, MAX_SHADER).map_err(|error| format!("{}: {error}", path.display()))?;
        match bytes.len() as u64 > MAX_SHADER {
            true => Err(format!("{}: a shader of more than the {MAX_SHADER} bytes that are read", path.display())),
            false => Ok(String::from_utf8_lossy(&bytes).replace('\0', " ")),
        }
    };
    let fallback = "the built-in material is drawn instead";
    let sources = read(&files.vertex).and_then(|vertex| Ok((vertex, read(&files.fragment)?)));
    let (vertex, fragment) = sources.map_err(|error| format!("{error}; {fallback}"))?;
    let compiled = gl.program(&vertex, &fragment).or_else(|error| {
        // What is wrong is said of the shaders as they were written.
        gl.program(&lenient(&vertex), &lenient(&fragment)).map_err(|_| error)
    });
    compiled.map_err(|error| {
        let (vertex, fragment) = (files.vertex.display(), files.fragment.display());
        format!("the shaders {vertex} and {fragment} do not work: {error}; {fallback}")
    })
}

/// A shader with functions that some drivers have and the GLSL specification does not: `texture` before GLSL 1.30, and
/// with three coordinates for a picture of two. Shaders written for such drivers count on both.
fn lenient(shader: &str) -> String {
    const FUNCTIONS: &str = "vec4 texture(sampler2D map, vec2 place) { return texture2D(map, place); } \
                             vec4 texture(sampler2D map, vec3 place) { return texture2D(map, place.xy); }";
    let goes_first = |line: &&str| {
        let directive = line.trim_start().strip_prefix('#').map(str::trim_start);
        directive.is_some_and(|word| word.starts_with("version") || word.starts_with("extension"))
    };
    let mut lines: Vec<&str> = shader.lines().collect();
    let head = lines.iter().rposition(goes_first).map_or(0, |at| at + 1);
    // Messages of the compiler still name the file's lines.
    let functions = format!("{FUNCTIONS}\n#line {}", head + 1);
    lines.insert(head, &functions);
    lines.join("\n") + "\n"
}

/// What a picture is drawn with, for all its eyes.
pub(crate) struct Pass<'a> {
    pub(crate) gl: &'a Current<'a>,
    pub(crate) programs: &'a mut Programs,
    pub(crate) buffer: &'a InstanceBuffer,
    pub(crate) drawables: &'a [Drawable<'a>],
    pub(crate) lights: &'a [Light],
    pub(crate) maps: &'a [Option<ShadowMap>],
    /// A shadow map in which nothing is in shadow.
    pub(crate) no_shadow: &'a gl::Texture,
    pub(crate) sky: Option<&'a Sky>,
    /// Pictures behind the scene with their textures.
    pub(crate) backdrops: Vec<(&'a Backdrop, &'a gl::Texture)>,
    /// One white texel.
    pub(crate) white: &'a gl::Texture,
    pub(crate) normal_maps: bool,
    /// Programs whose uniforms of lights are set.
    pub(crate) lit_programs: Vec<Lit>,
}

/// How bodies are drawn as masks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Mask {
    /// By our program.
    Built,
    /// By a program of the user.
    User(usize),
}

impl Pass<'_> {
    /// What an eye sees, opaque drawables first by part, then transparent ones back to front.
    fn order(&self, eye: &Eye, all_opaque: bool) -> (Vec<usize>, Vec<usize>) {
        let seen = visible(self.drawables, &(eye.projection * eye.view));
        let is_transparent = |index: &usize| !all_opaque && self.drawables[*index].look.is_transparent();
        let (mut transparent, mut opaque): (Vec<_>, Vec<_>) = seen.into_iter().partition(is_transparent);
        let distance = |index: usize| -(eye.view.transform_point(&self.drawables[index].center)).z;
        // Near ones first: what they hide need not be shaded. Parts stay together.
        let mut nearest: HashMap<*const Part, f64> = HashMap::new();
        for &index in &opaque {
            let near = nearest.entry(std::ptr::from_ref(self.drawables[index].part)).or_insert(f64::INFINITY);
            *near = near.min(distance(index) - self.drawables[index].radius);
        }
        let place = |index: usize| {
            let part = std::ptr::from_ref(self.drawables[index].part);
            (nearest[&part], part as usize, distance(index))
        };
        opaque.sort_by(|&a, &b| {
            let ((near_a, part_a, a), (near_b, part_b, b)) = (place(a), place(b));
            near_a.total_cmp(&near_b).then(part_a.cmp(&part_b)).then(a.total_cmp(&b))
        });
        transparent.sort_by(|&a, &b| distance(b).total_cmp(&distance(a)));
        (opaque, transparent)
    }

    /// Colour and depth of one eye.
    pub(crate) fn color(&mut self, eye: &Eye, mask: Option<Mask>) -> Result<(), RenderError> {
        let gl = self.gl;
        gl.viewport(eye.left, eye.width, eye.height);
        gl.clear(true);
        let (opaque, transparent) = self.order(eye, mask.is_some());
        let batches = Batches::new(self.drawables, opaque.iter().chain(&transparent).copied());
        gl.upload_instances(self.buffer, &batches.instances);
        let first_transparent = opaque.len();
        for run in batches.runs.iter().filter(|run| run.first < first_transparent) {
            // A run may reach from opaque into transparent drawables.
            let count = run.count.min(first_transparent - run.first);
            gl.state(false, true, self.culled(eye, &batches.order[run.first..run.first + count]));
            self.run(eye, &batches, run.first, count, mask)?;
        }
        if let Some(sky) = self.sky.filter(|_| mask.is_none()) {
            self.sky(eye, sky)?;
        }
        for (backdrop, picture) in self.backdrops.iter().filter(|_| mask.is_none()) {
            gl.state(true, false, Cull::None);
            let program = self.programs.backdrop(gl)?;
            gl.use_program(Some(program));
            let [left, top, width, height] = backdrop.area;
            let (across, down) = (2.0 / f64::from(eye.width), 2.0 / f64::from(eye.height));
            let area = [(left - f64::from(eye.left)) * across - 1.0, 1.0 - top * down, width * across, height * down];
            gl.uniform(program, "u_area", Uniform::Vec4(area.map(|x| x as f32)));
            gl.uniform(program, "u_color", Uniform::Vec4(backdrop.color));
            gl.uniform(program, "u_picture", Uniform::Int(0));
            gl.bind_texture(0, Some(picture));
            gl.draw_rectangle();
        }
        for run in batches.runs.iter().filter(|run| run.first + run.count > first_transparent) {
            let first = run.first.max(first_transparent);
            for index in first..run.first + run.count {
                // Both walls of a hollow body, the far one first.
                let walls: &[Cull] = match self.drawables[batches.order[index]].isosurface {
                    Some(_) => &[back_walls(eye)],
                    None => &[Cull::Front, Cull::Back],
                };
                for &cull in walls {
                    gl.state(true, false, cull);
                    self.run(eye, &batches, index, 1, mask)?;
                }
            }
        }
        Ok(())
    }

    fn run(
        &mut self,
        eye: &Eye,
        batches: &Batches<'_>,
        first: usize,
        count: usize,
        mask: Option<Mask>,
    ) -> Result<(), RenderError> {
        let gl = self.gl;
        let drawable = &self.drawables[batches.order[first]];
        let style = match mask.filter(|_| drawable.is_object && drawable.isosurface.is_none()) {
            Some(Mask::User(index)) => Style::User(index),
            _ => drawable.style,
        };
        let (program, mode) = match style {
            Style::User(index) => return self.user_run(eye, &batches.order[first..first + count], index),
            Style::Lit if mask.is_some() && drawable.is_object => {
                (self.programs.mask(gl, drawable.isosurface.is_some())?, Mode::Triangles)
            }
            Style::Lit => {
                let part = drawable.part;
                let normal_map = part.normal_map.as_ref().filter(|_| self.normal_maps);
                let physical = drawable.look.physical.is_some();
                let physical_map = part.physical_map.as_ref().filter(|_| physical);
                let shininess = drawable.look.shininess;
                let looks = || batches.order[first..first + count].iter().map(|&index| &self.drawables[index].look);
                let is_shared = looks().all(|look| look.shininess == shininess);
                let lit = Lit {
                    textured: part.diffuse_map.is_some() || normal_map.is_some() || physical_map.is_some(),
                    normal_map: normal_map.is_some(),
                    colored: part.array.layout.colors,
                    physical,
                    physical_map: physical_map.is_some(),
                    glossy: !physical && looks().any(|look| look.specular != [0.0; 3]),
                    squarings: shaders::squarings(shininess).filter(|_| is_shared && !physical),
                    isosurface: drawable.isosurface.is_some(),
                    ..lights::lit(self.lights)
                };
                let program = self.programs.lit(gl, lit)?;
                gl.use_program(Some(program));
                if lit.textured {
                    gl.bind_texture(0, Some(part.diffuse_map.as_deref().unwrap_or(self.white)));
                    gl.uniform(program, "u_diffuse_map", Uniform::Int(0));
                }
                if let Some(map) = normal_map {
                    gl.bind_texture(1, Some(map));
                    gl.uniform(program, "u_normal_map", Uniform::Int(1));
                }
                if let Some(map) = physical_map {
                    gl.bind_texture(2, Some(map));
                    gl.uniform(program, "u_physical_map", Uniform::Int(2));
                }
                if lit.physical {
                    set_eye(gl, program, eye);
                }
                if !self.lit_programs.contains(&lit) {
                    self.lit_programs.push(lit);
                    lights::set_lights(gl, program, self.lights, self.maps);
                }
                let backward = eye.view.fixed_view::<1, 3>(2, 0);
                gl.uniform(program, "u_backward", Uniform::Vec3(std::array::from_fn(|i| backward[i] as f32)));
                (program, Mode::Triangles)
            }
            Style::Outline => (self.programs.unlit(gl)?, Mode::Triangles),
            Style::Points(_) => (self.programs.unlit(gl)?, Mode::Points),
            Style::Lines => (self.programs.unlit(gl)?, Mode::Lines),
        };
        match style {
            Style::Outline => gl.outlines(),
            Style::Points(_) => gl.sized_points(),
            _ => {}
        }
        gl.use_program(Some(program));
        if let Style::Points(size) = style {
            gl.uniform(program, "u_point_size", Uniform::Float(size.clamp(1.0, 255.0)));
        }
        gl.uniform(program, "u_clip", Uniform::Mat4(&narrow(&(eye.projection * eye.view))));
        set_voxels(gl, program, drawable, eye);
        gl.draw_instances(&drawable.part.array, mode, self.buffer, first, count, batches.count());
        Ok(())
    }

    fn sky(&mut self, eye: &Eye, sky: &Sky) -> Result<(), RenderError> {
        let gl = self.gl;
        gl.state(false, false, Cull::None);
        match sky {
            Sky::BuiltIn(layers) => {
                let program = self.programs.sky(gl)?;
                gl.use_program(Some(program));
                gl.uniform(program, "u_to_world", Uniform::Mat4(&narrow(&sky::to_world(eye))));
                gl.uniform(program, "u_faces", Uniform::Int(0));
                gl.bind_texture(0, Some(layers));
                gl.draw_covering();
            }
            Sky::User { program, faces, cube } => {
                let Some(Some(program)) = self.programs.user.get(*program) else { return Ok(()) };
                let (view, projection) = sky::cube_to_eye(eye);
                gl.use_program(Some(program));
                gl.uniform(program, "viewMat", Uniform::Mat4(&narrow(&view)));
                gl.uniform(program, "projectionMat", Uniform::Mat4(&narrow(&projection)));
                gl.uniform(program, "skybox", Uniform::Int(0));
                gl.bind_texture(0, Some(faces));
                gl.draw_farthest(cube);
            }
        }
        Ok(())
    }

    /// Programs of users know no instances: one object after the other, by the state of the fixed-function pipeline.
    fn user_run(&mut self, eye: &Eye, order: &[usize], index: usize) -> Result<(), RenderError> {
        let gl = self.gl;
        let Some(Some(program)) = self.programs.user.get(index) else { return Ok(()) };
        gl.use_program(Some(program));
        gl.fixed_scene(&narrow(&eye.view), &narrow(&eye.projection), &lights::fixed_lights(self.lights));
        let part = self.drawables[order[0]].part;
        let normal_map = part.normal_map.as_ref().filter(|_| self.normal_maps);
        for (unit, name) in [(0, "diffuseMap"), (1, "shadowMap"), (2, "normalMap")] {
            gl.uniform(program, name, Uniform::Int(unit));
        }
        gl.uniform(program, "uTextureEnabled", Uniform::Int(part.diffuse_map.is_some().into()));
        gl.uniform(program, "vEnableNormalMapping", Uniform::Int(normal_map.is_some().into()));
        gl.bind_texture(0, Some(part.diffuse_map.as_deref().unwrap_or(self.white)));
        gl.bind_texture(1, Some(lights::last_map(self.lights, self.maps).unwrap_or(self.no_shadow)));
        gl.bind_texture(2, Some(normal_map.map_or(self.white, |map| map.as_ref())));
        for &place in order {
            let drawable = &self.drawables[place];
            let pose = drawable.pose();
            let Look { diffuse, ambient, specular, emission, shininess, .. } = drawable.look;
            let solid = |[r, g, b]: [f32; 3]| [r, g, b, diffuse[3]];
            let material = FixedMaterial {
                ambient: solid(ambient),
                diffuse,
                specular: solid(specular),
                emission: solid(emission),
                shininess,
            };
            gl.fixed_object(&narrow(&(eye.view * pose)), &material);
            gl.draw(&part.array);
        }
        Ok(())
    }

    /// Ids, and normals if they are wanted, of one eye; transparent drawables count as opaque ones.
    pub(crate) fn flat(&mut self, eye: &Eye, normals: bool) -> Result<(), RenderError> {
        let gl = self.gl;
        gl.viewport(eye.left, eye.width, eye.height);
        gl.state(false, true, Cull::None);
        gl.clear_flat(normals);
        for of_voxels in self.kinds() {
            self.programs.ids(gl, normals, of_voxels)?;
            let program = &self.programs.ids[usize::from(of_voxels)][usize::from(normals)];
            let Some(program) = program else { return Ok(()) };
            gl.use_program(Some(program));
            // Rows of the view are right, up and backward; the camera's axes are backward, right, up.
            for (name, row) in [("u_camera_x", 2), ("u_camera_y", 0), ("u_camera_z", 1)] {
                let axis = eye.view.fixed_view::<1, 3>(row, 0);
                gl.uniform(program, name, Uniform::Vec3(std::array::from_fn(|i| axis[i] as f32)));
            }
            self.plain(eye, program, |drawable| {
                drawable.style.is_solid() && drawable.isosurface.is_some() == of_voxels
            });
        }
        Ok(())
    }

    /// Depth of one eye; transparent drawables have none.
    pub(crate) fn depth(&mut self, eye: &Eye) -> Result<(), RenderError> {
        let gl = self.gl;
        gl.viewport(eye.left, eye.width, eye.height);
        gl.state(false, true, Cull::None);
        gl.clear(false);
        for of_voxels in self.kinds() {
            match of_voxels {
                true => self.programs.depth_of_voxels(gl)?,
                false => self.programs.depth(gl)?,
            };
            let Some(program) = &self.programs.depth[usize::from(of_voxels)] else { return Ok(()) };
            gl.use_program(Some(program));
            self.plain(eye, program, |drawable| {
                let is_seen = drawable.style.is_solid() && !drawable.look.is_transparent();
                is_seen && drawable.isosurface.is_some() == of_voxels
            });
        }
        Ok(())
    }

    /// Surfaces, and voxels (`true`) if there are any.
    fn kinds(&self) -> impl Iterator<Item = bool> {
        let has_voxels = self.drawables.iter().any(|drawable| drawable.isosurface.is_some());
        [false, true].into_iter().take(if has_voxels { 2 } else { 1 })
    }

    fn plain(&self, eye: &Eye, program: &Program, which: impl Fn(&Drawable<'_>) -> bool) {
        let gl = self.gl;
        let clip = eye.projection * eye.view;
        gl.uniform(program, "u_clip", Uniform::Mat4(&narrow(&clip)));
        let (order, _) = self.order(eye, true);
        let batches = Batches::new(self.drawables, order.into_iter().filter(|&index| which(&self.drawables[index])));
        gl.upload_instances(self.buffer, &batches.instances);
        for run in &batches.runs {
            gl.state(false, true, self.culled(eye, &batches.order[run.first..run.first + run.count]));
            set_voxels(gl, program, &self.drawables[batches.order[run.first]], eye);
            gl.draw_instances(&run.part.array, Mode::Triangles, self.buffer, run.first, run.count, batches.count());
        }
    }

    /// Which faces need not be drawn of these opaque drawables of one part: the backs of closed surfaces that lie
    /// wholly in front of the eye. Nobody sees them, but a software renderer shades those that come first.
    fn culled(&self, eye: &Eye, order: &[usize]) -> Cull {
        if self.drawables[order[0]].isosurface.is_some() {
            return back_walls(eye);
        }
        // What mirrors takes fronts for backs; projections of OpenGL turn a right-handed frame into a left-handed one.
        if !self.drawables[order[0]].part.is_closed || eye.projection.determinant() >= 0.0 {
            return Cull::None;
        }
        let clip = eye.projection * eye.view;
        let near = clip.row(3) + clip.row(2);
        let length = near.fixed_columns::<3>(0).norm();
        let is_seen_from_outside = |drawable: &Drawable<'_>| {
            let r = &drawable.rows;
            let rows = Matrix3::new(r[0], r[1], r[2], r[4], r[5], r[6], r[8], r[9], r[10]);
            let distance = (near * drawable.center.to_homogeneous())[0];
            drawable.style == Style::Lit && distance > drawable.radius * length && rows.determinant() > 0.0
        };
        match order.iter().all(|&index| is_seen_from_outside(&self.drawables[index])) {
            true => Cull::Back,
            false => Cull::None,
        }
    }
}

/// What leaves the far walls of a closed part: each pixel looks for a surface of voxels once, also where the eye is among
/// them.
fn back_walls(eye: &Eye) -> Cull {
    if eye.projection.determinant() < 0.0 {
        Cull::Front
    } else {
        Cull::Back
    }
}

fn set_eye(gl: &Current<'_>, program: &Program, eye: &Eye) {
    gl.uniform(program, "u_eye", Uniform::Vec4(eye.place().map(|x| x as f32)));
}

/// Sets what a program of voxels needs, if `drawable` has any.
fn set_voxels(gl: &Current<'_>, program: &Program, drawable: &Drawable<'_>, eye: &Eye) {
    let Some(isosurface) = drawable.isosurface else { return };
    let Some(to_box) = drawable.pose().try_inverse() else { return };
    let to_voxels = Matrix4::new_translation(&Vector3::repeat(0.5)) * to_box;
    set_eye(gl, program, eye);
    gl.uniform(program, "u_to_voxels", Uniform::Mat4(&narrow(&to_voxels)));
    gl.uniform(program, "u_value", Uniform::Float(isosurface.value));
    gl.uniform(program, "u_samples", Uniform::Float(isosurface.samples));
    gl.uniform(program, "u_tint", Uniform::Float(isosurface.tint));
    for (unit, name, texture) in
        [(0, "u_voxels", &isosurface.voxels.texture), (1, "u_blocks", &isosurface.voxels.blocks)]
    {
        gl.uniform(program, name, Uniform::Int(unit as i32));
        gl.bind_texture(unit, Some(texture));
    }
}

impl Style {
    /// Triangles that are filled.
    pub(crate) fn is_solid(self) -> bool {
        matches!(self, Style::Lit | Style::User(_))
    }
}
