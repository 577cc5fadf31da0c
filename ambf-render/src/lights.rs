//! Lights of a scene, and their shadow maps.

use std::hash::{DefaultHasher, Hash, Hasher};

use nalgebra::{Isometry3, Matrix4, Point3, Vector3};

use crate::draw::{visible, Batches, Drawable, Programs};
use crate::gl::{Cull, Current, FixedLight, InstanceBuffer, Mode, Program, Target, TargetKind, Texture, Uniform};
use crate::shaders::{Lit, SHADOW_UNIT};
use crate::stage::Built;
use crate::RenderError;

/// Lights that are drawn; further ones shine on nothing.
pub(crate) const MAX_LIGHTS: usize = 8;
/// Where shadow maps begin, m.
const SHADOW_NEAR: f64 = 0.1;
/// Widest angle of a shadow map, rad: at 180 degrees its scale would vanish.
const WIDEST_SHADOW: f64 = 160.0 / 180.0 * std::f64::consts::PI;
/// Colours cast no shadow beyond this distance, m.
const MAX_SHADOW: f64 = 1000.0;

/// A light as it shines.
pub(crate) struct Light {
    position: Vector3<f64>,
    axis: Vector3<f64>,
    /// Half angle, rad, at most 90 degrees.
    cutoff: f64,
    exponent: f64,
    attenuation: [f64; 3],
    /// Index in the list of shadow maps, and from the world to clip coordinates of its target.
    shadow: Option<(usize, Matrix4<f64>)>,
}

/// That part of a shadow map in which there are casters, and what it was drawn of. Around it nothing is in shadow.
pub(crate) struct ShadowMap {
    target: Target,
    of: u64,
    /// Where the target may hold something; the rest is empty.
    used: Area,
    /// From the world to clip coordinates of the target.
    clip: Matrix4<f64>,
}

/// Texels: left, bottom, right, top.
type Area = [u32; 4];

/// A part of a shadow map has so many sizes each way, so that a caster that moves a little needs no other target.
const SHADOW_STEPS: u32 = 8;

impl Built {
    /// The lights, with shadow maps that are up to date.
    pub(crate) fn lights(
        &self,
        gl: &Current<'_>,
        programs: &mut Programs,
        buffer: &InstanceBuffer,
        casters: &[Drawable<'_>],
        maps: &mut Vec<Option<ShadowMap>>,
    ) -> Result<Vec<Light>, RenderError> {
        let visuals = self.visuals.clone();
        let shining = visuals.lights.iter().zip(&self.snapshot.spots).enumerate();
        let shining = shining.filter(|(_, (light, _))| !light.object.removed).take(MAX_LIGHTS);
        let mut lights = Vec::new();
        let mut bytes_of_casters = None;
        for (index, (light, spot)) in shining {
            let description = &light.description;
            let cutoff = if spot.cutoff_angle.is_finite() { spot.cutoff_angle } else { 0.7 };
            let cutoff = cutoff.clamp(0.0, std::f64::consts::FRAC_PI_2);
            let attenuation = description.attenuation.map_or([1.0, 0.0, 0.0], |a| [a.constant, a.linear, a.quadratic]);
            let mut shining = Light {
                position: spot.pose.translation.vector,
                axis: spot.pose.rotation * Vector3::x(),
                cutoff,
                exponent: description.spot_exponent.clamp(0.0, 128.0),
                attenuation,
                shadow: None,
            };
            let size = match description.shadow_quality {
                quality @ 1..=5 => (128_u32 << quality).min(gl.device().most_texels),
                _ => 0,
            };
            if size > 0 && cutoff > 0.0 {
                let hash = *bytes_of_casters.get_or_insert_with(|| hash_of(casters, self.soft_version));
                if maps.len() <= index {
                    maps.resize_with(index + 1, || None);
                }
                let clip = shadow_clip(&spot.pose, cutoff, casters);
                let mut hasher = DefaultHasher::new();
                hash.hash(&mut hasher);
                size.hash(&mut hasher);
                clip.iter().for_each(|number| number.to_bits().hash(&mut hasher));
                let of = hasher.finish();
                let map = &mut maps[index];
                if map.as_ref().is_none_or(|map| map.of != of) {
                    let drawn = draw_map(gl, programs, buffer, casters, &shining.position, map.take(), &clip, size)?;
                    *map = Some(ShadowMap { of, ..drawn });
                }
                shining.shadow = map.as_ref().map(|map| (index, map.clip));
            }
            lights.push(shining);
        }
        Ok(lights)
    }
}

/// What the shadow maps depend on, beside the lights.
fn hash_of(casters: &[Drawable<'_>], soft_version: u64) -> u64 {
    let mut hasher = DefaultHasher::new();
    soft_version.hash(&mut hasher);
    for caster in casters {
        std::ptr::from_ref(caster.part).hash(&mut hasher);
        for number in caster.rows {
            number.to_bits().hash(&mut hasher);
        }
    }
    hasher.finish()
}

/// From the world to the clip coordinates of a light's map, which reaches as far as the casters do.
fn shadow_clip(pose: &Isometry3<f64>, cutoff: f64, casters: &[Drawable<'_>]) -> Matrix4<f64> {
    let position = Point3::from(pose.translation.vector);
    let reach = casters.iter().map(|caster| (caster.center - position).norm() + caster.radius);
    let far = reach.filter(|reach| reach.is_finite()).fold(2.0 * SHADOW_NEAR, f64::max).min(MAX_SHADOW);
    let cotangent = 1.0 / (0.5 * (2.0 * cutoff).min(WIDEST_SHADOW)).tan();
    let near = SHADOW_NEAR;
    let mut projection = Matrix4::zeros();
    projection[(0, 0)] = cotangent;
    projection[(1, 1)] = cotangent;
    projection[(2, 2)] = -(far + near) / (far - near);
    projection[(2, 3)] = -2.0 * far * near / (far - near);
    projection[(3, 2)] = -1.0;
    // The eye frame (right, up, backward) of a light that shines along its +x.
    let inverse = pose.inverse().to_homogeneous();
    let view = Matrix4::from_rows(&[
        -inverse.row(1),
        inverse.row(2).into_owned(),
        -inverse.row(0),
        inverse.row(3).into_owned(),
    ]);
    projection * view
}

/// Whether a caster leaves a light's map empty: a flat part of which the light sees the front.
fn is_lit_plane(caster: &Drawable<'_>, light: &Vector3<f64>) -> bool {
    let Some(normal) = caster.part.flat.filter(|_| !caster.is_sheet) else { return false };
    let rows = caster.rows.map(f64::from);
    let row = |i: usize| Vector3::new(rows[4 * i], rows[4 * i + 1], rows[4 * i + 2]);
    let (x, y, z) = (row(0), row(1), row(2));
    // The cofactors of the linear part carry normals.
    let normal = Vector3::new(y.cross(&z).dot(&normal), z.cross(&x).dot(&normal), x.cross(&y).dot(&normal));
    normal.dot(&(light - caster.center.coords)) > 0.0
}

/// Where a caster may be in a map of `size` x `size` texels.
fn area_of(caster: &Drawable<'_>, clip: &Matrix4<f64>, size: u32) -> Area {
    let whole = [0, 0, size, size];
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for corner in 0..8 {
        let side = |axis: usize| if corner >> axis & 1 == 0 { -caster.radius } else { caster.radius };
        let corner = clip * (caster.center + Vector3::new(side(0), side(1), side(2))).to_homogeneous();
        // Behind the light, or not finite.
        if corner.w.partial_cmp(&SHADOW_NEAR) != Some(std::cmp::Ordering::Greater) {
            return whole;
        }
        for axis in 0..2 {
            let place = 0.5 * (corner[axis] / corner.w + 1.0) * f64::from(size);
            low[axis] = low[axis].min(place);
            high[axis] = high[axis].max(place);
        }
    }
    // Casts saturate; one texel more on each side.
    let [left, bottom] = low.map(|place| (place.floor() - 1.0).max(0.0) as u32);
    let [right, top] = high.map(|place| ((place.ceil() + 1.0).max(0.0) as u32).min(size));
    [left.min(right), bottom.min(top), right, top]
}

fn united(a: Area, b: Area) -> Area {
    let is_empty = |area: Area| area[0] >= area[2] || area[1] >= area[3];
    match (is_empty(a), is_empty(b)) {
        (true, _) => b,
        (_, true) => a,
        _ => [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])],
    }
}

/// Draws what a light sees, in place of `before`: back faces only, so that closed bodies don't shade their own lit sides. A
/// sheet has no back: both of its sides are drawn, a little farther away than they are. Of a map of `size` x `size` texels
/// that part is stored in which there are casters, and emptied where there were some: where the processor draws, emptying
/// a large map costs more than a scene.
#[allow(clippy::too_many_arguments)] // what is drawn with, and what is drawn
fn draw_map(
    gl: &Current<'_>,
    programs: &mut Programs,
    buffer: &InstanceBuffer,
    casters: &[Drawable<'_>],
    light: &Vector3<f64>,
    before: Option<ShadowMap>,
    clip: &Matrix4<f64>,
    size: u32,
) -> Result<ShadowMap, RenderError> {
    let program = programs.depth(gl)?;
    let casts = |i: &usize| casters[*i].isosurface.is_none() && !is_lit_plane(&casters[*i], light);
    let seen: Vec<usize> = visible(casters, clip).into_iter().filter(casts).collect();
    let area = seen.iter().map(|&i| area_of(&casters[i], clip, size)).fold([0; 4], united);
    let [width, height] =
        [area[2] - area[0], area[3] - area[1]].map(|n| n.max(1).next_multiple_of(size / SHADOW_STEPS).min(size));
    // Another size would round otherwise: what is seen must not depend on what was drawn before.
    let fits = |map: &ShadowMap| (map.target.width, map.target.height) == (width, height);
    let (target, filled) = match before.filter(fits) {
        Some(map) => (map.target, map.used),
        None => (gl.target(width, height, TargetKind::Shadow)?, [0, 0, width, height]),
    };
    let (x, y) = (area[0].min(size - width), area[1].min(size - height));
    let used = [area[0] - x, area[1] - y, area[2] - x, area[3] - y];
    // From the clip coordinates of the map to those of the part that begins at (x, y).
    let (across, up) = (f64::from(size) / f64::from(width), f64::from(size) / f64::from(height));
    let mut part = Matrix4::new_nonuniform_scaling(&Vector3::new(across, up, 1.0));
    part[(0, 3)] = across - 1.0 - 2.0 * f64::from(x) / f64::from(width);
    part[(1, 3)] = up - 1.0 - 2.0 * f64::from(y) / f64::from(height);
    let clip = &(part * clip);
    let [left, bottom, right, top] = united(filled, used);
    gl.bind_target(&target);
    gl.viewport(0, width, height);
    gl.scissor([left, bottom, right - left, top - bottom]);
    gl.clear(false);
    gl.use_program(Some(program));
    gl.uniform(program, "u_clip", Uniform::Mat4(&narrow(clip)));
    let (sheets, bodies): (Vec<_>, Vec<_>) = seen.into_iter().partition(|&i| casters[i].is_sheet);
    for (seen, cull) in [(bodies, Cull::Front), (sheets, Cull::None)] {
        gl.state(false, true, cull);
        gl.push_back(cull == Cull::None);
        let batches = Batches::new(casters, seen.into_iter());
        gl.upload_instances(buffer, &batches.instances);
        for run in &batches.runs {
            gl.draw_instances(&run.part.array, Mode::Triangles, buffer, run.first, run.count, batches.count());
        }
    }
    gl.push_back(false);
    Ok(ShadowMap { target, of: 0, used, clip: *clip })
}

/// Column by column.
pub(crate) fn narrow(matrix: &Matrix4<f64>) -> [f32; 16] {
    std::array::from_fn(|i| matrix.as_slice()[i] as f32)
}

fn narrow3(vector: &Vector3<f64>) -> [f32; 3] {
    std::array::from_fn(|i| vector[i] as f32)
}

/// From clip coordinates (−1 to 1) to those of textures (0 to 1).
fn to_texture(clip: &Matrix4<f64>) -> Matrix4<f64> {
    Matrix4::new_translation(&Vector3::repeat(0.5)) * Matrix4::new_scaling(0.5) * clip
}

/// What of a lit program depends on the lights.
pub(crate) fn lit(lights: &[Light]) -> Lit {
    let bits = |is: fn(&Light) -> bool| {
        lights.iter().enumerate().filter(|(_, light)| is(light)).fold(0, |bits, (index, _)| bits | 1 << index)
    };
    Lit {
        lights: lights.len() as u32,
        shadows: bits(|light| light.shadow.is_some()),
        exponents: bits(|light| light.exponent > 0.0),
        attenuated: bits(|light| light.attenuation != [1.0, 0.0, 0.0]),
        textured: false,
        normal_map: false,
        colored: false,
        physical: false,
        physical_map: false,
        glossy: false,
        squarings: None,
        isosurface: false,
    }
}

/// Sets the uniforms of the lights, and binds their shadow maps.
pub(crate) fn set_lights(gl: &Current<'_>, program: &Program, lights: &[Light], maps: &[Option<ShadowMap>]) {
    for (index, light) in lights.iter().enumerate() {
        let set = |name: &str, value: Uniform<'_>| gl.uniform(program, &format!("u_{name}_{index}"), value);
        set("position", Uniform::Vec3(narrow3(&light.position)));
        let cosine = light.cutoff.cos();
        set("axis", Uniform::Vec3(narrow3(&(light.axis / cosine))));
        set("spot", Uniform::Vec4([cosine as f32, light.exponent as f32, 0.0, 0.0]));
        set("attenuation", Uniform::Vec3(light.attenuation.map(|x| x as f32)));
        if let Some((map, clip)) = &light.shadow {
            set("shadow_clip", Uniform::Mat4(&narrow(&to_texture(clip))));
            let unit = SHADOW_UNIT + index as u32;
            set("shadow", Uniform::Int(unit as i32));
            gl.bind_texture(unit, depth_of(maps, *map));
        }
    }
}

fn depth_of(maps: &[Option<ShadowMap>], index: usize) -> Option<&Texture> {
    maps.get(index)?.as_ref()?.target.depth.as_ref()
}

/// The map of the last light that casts shadows, for programs of users.
pub(crate) fn last_map<'a>(lights: &[Light], maps: &'a [Option<ShadowMap>]) -> Option<&'a Texture> {
    let (map, _) = lights.iter().rev().find_map(|light| light.shadow.as_ref())?;
    depth_of(maps, *map)
}

/// The lights for programs of users.
pub(crate) fn fixed_lights(lights: &[Light]) -> Vec<FixedLight> {
    let fixed = |light: &Light| FixedLight {
        position: narrow3(&light.position),
        axis: narrow3(&light.axis),
        cutoff: light.cutoff.to_degrees().min(90.0) as f32,
        exponent: light.exponent as f32,
        attenuation: light.attenuation.map(|x| x as f32),
        shadow: light.shadow.as_ref().map(|(_, clip)| {
            let texture = to_texture(clip);
            std::array::from_fn(|row| std::array::from_fn(|column| texture[(row, column)] as f32))
        }),
    };
    lights.iter().map(fixed).collect()
}
