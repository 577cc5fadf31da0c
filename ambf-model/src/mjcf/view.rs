//! Cameras and lights.

use nalgebra::{Isometry3, Vector3};

use super::settings::{choice, direction, finish, BOOLEANS, POSE};
use crate::adf::{Attenuation, Camera, Common, Intrinsics, Light, MouseMultipliers, ProblemKind};
use crate::xml::{quoted, Element};

/// Clipping planes of cameras, m: from close to a gripper to the end of a hall.
const CLIPPING: (f64, f64) = (0.01, 100.0);

/// Field of view without one, degrees.
const FIELD_OF_VIEW: f64 = 45.0;

/// What a light element and its defaults say.
#[derive(Debug, Clone)]
pub(super) struct LightText {
    is_active: bool,
    is_directional: bool,
    casts_shadow: bool,
    position: Vector3<f64>,
    direction: [f64; 3],
    attenuation: [f64; 3],
    /// Half opening, degrees.
    cutoff: f64,
    exponent: f64,
}

impl Default for LightText {
    fn default() -> Self {
        Self {
            is_active: true,
            is_directional: false,
            casts_shadow: true,
            position: Vector3::zeros(),
            direction: [0.0, 0.0, -1.0],
            attenuation: [1.0, 0.0, 0.0],
            cutoff: 45.0,
            exponent: 10.0,
        }
    }
}

impl LightText {
    pub fn apply(&mut self, element: &Element<'_>) {
        let read = [
            "name",
            "class",
            "active",
            "directional",
            "type",
            "castshadow",
            "pos",
            "dir",
            "attenuation",
            "cutoff",
            "exponent",
            "mode",
            "target",
        ];
        let colours = ["ambient", "diffuse", "specular", "intensity", "bulbradius", "softness", "range", "texture"];
        finish(element, &read, &[("lights are white", &colours[..])], &[]);
        self.is_active = choice(element, "active", &BOOLEANS).unwrap_or(self.is_active);
        self.is_directional = choice(element, "directional", &BOOLEANS).unwrap_or(self.is_directional);
        let types = [("spot", false), ("point", false), ("image", false), ("directional", true)];
        self.is_directional = choice(element, "type", &types).unwrap_or(self.is_directional);
        self.casts_shadow = choice(element, "castshadow", &BOOLEANS).unwrap_or(self.casts_shadow);
        self.position = element.vector("pos").unwrap_or(self.position);
        self.direction = element.numbers("dir").unwrap_or(self.direction);
        self.attenuation = element.numbers("attenuation").unwrap_or(self.attenuation);
        self.cutoff = element.real("cutoff").unwrap_or(self.cutoff);
        self.exponent = element.real("exponent").unwrap_or(self.exponent);
    }

    /// The light in a frame that is `outer` in the body's; `None`: it is off.
    pub fn light(
        &self,
        common: Common,
        parent: String,
        outer: &Isometry3<f64>,
        element: &Element<'_>,
    ) -> Option<Light> {
        check_mode(element);
        let towards = direction(self.direction).unwrap_or(-Vector3::z_axis());
        let [constant, linear, quadratic] = self.attenuation;
        self.is_active.then(|| Light {
            common,
            parent,
            location: outer * Isometry3::translation(self.position.x, self.position.y, self.position.z),
            direction: Some(outer.rotation * towards.into_inner()),
            spot_exponent: if self.is_directional { 0.0 } else { self.exponent },
            // Light from one direction: a spot so wide that nothing is outside.
            cutoff_angle: if self.is_directional { 1.5 } else { self.cutoff.clamp(1.0, 90.0).to_radians() },
            shadow_quality: if self.casts_shadow { 2 } else { 0 },
            attenuation: Some(Attenuation { constant, linear, quadratic }),
        })
    }
}

/// Names what of `mode` is not done.
fn check_mode(element: &Element<'_>) {
    if let Some(mode) = element.attribute("mode").filter(|mode| *mode != "fixed") {
        let action = "it moves and turns with its body";
        element.warn(ProblemKind::UnknownValue, "mode", &quoted(mode), "fixed", action);
    }
}

/// A camera whose frame is `pose` in the body's. `None`, reported, if it cannot see anything.
pub(super) fn camera(
    element: &Element<'_>,
    fov: Option<f64>,
    common: Common,
    parent: String,
    pose: &Isometry3<f64>,
) -> Option<Camera> {
    let read = [
        &[
            "name",
            "class",
            "mode",
            "target",
            "fovy",
            "resolution",
            "focal",
            "focalpixel",
            "principal",
            "principalpixel",
            "sensorsize",
        ][..],
        &["orthographic", "projection"],
        &POSE,
    ]
    .concat();
    finish(element, &read, &[("it changes nothing in the picture", &["user", "ipd", "output"][..])], &[]);
    check_mode(element);
    let fov = element.real("fovy").or(fov).unwrap_or(FIELD_OF_VIEW);
    let is_orthographic = choice(element, "orthographic", &BOOLEANS) == Some(true)
        || choice(element, "projection", &[("perspective", false), ("orthographic", true)]) == Some(true);
    let most = if is_orthographic { f64::INFINITY } else { 180.0 };
    if !(fov > 0.0 && fov < most) {
        let expected = "an angle above 0 and below 180 degrees";
        element.error(ProblemKind::OutOfRange, "fovy", &fov.to_string(), expected, "the camera is left out");
        return None;
    }
    let resolution: Option<[f64; 2]> = element.numbers("resolution");
    let pixels = resolution.map(|size| size.map(|n| n.clamp(1.0, 16384.0) as u32)).filter(|size| *size != [1, 1]);
    let per_length = pixels.zip(element.numbers::<2>("sensorsize")).filter(|(_, size)| size.iter().all(|x| *x > 0.0));
    let per_length =
        per_length.map(|([w, h], [x, y])| [f64::from(w) / x, f64::from(h) / y]).filter(|[x, y]| x.max(*y) < 1e100);
    let scaled = |name| {
        let numbers = element.numbers::<2>(name)?;
        per_length.map(|[x, y]| [numbers[0] * x, numbers[1] * y])
    };
    let focal =
        element.numbers("focalpixel").or_else(|| scaled("focal")).filter(|f: &[f64; 2]| f.iter().all(|x| *x > 0.0));
    let off = element.numbers("principalpixel").or_else(|| scaled("principal")).unwrap_or([0.0; 2]);
    let intrinsics = focal.zip(pixels).map(|([fx, fy], [w, h])| Intrinsics {
        focal_lengths: (fx, fy),
        principal_point: (f64::from(w) / 2.0 + off[0], f64::from(h) / 2.0 + off[1]),
        skew: 0.0,
    });
    let location = pose.translation.vector;
    Some(Camera {
        common,
        parent,
        location,
        // Cameras look along −z, with y up.
        look_at: location - pose.rotation * Vector3::z(),
        up: pose.rotation * Vector3::y(),
        clipping_plane: CLIPPING,
        field_view_angle: if is_orthographic { FIELD_OF_VIEW.to_radians() } else { fov.to_radians() },
        orthographic_view_width: is_orthographic.then_some(fov),
        stereo: None,
        monitor: None,
        controlling_devices: Vec::new(),
        // One of many: who looks through it asks for its pictures.
        visible: false,
        publish_image: None,
        publish_depth: None,
        image_samples: 1,
        depth_noise: None,
        preprocessing_shaders: None,
        depth_compute_shaders: None,
        multipass: false,
        mouse: MouseMultipliers::default(),
        window_resolution: pixels.map(|[width, height]| (width, height)),
        intrinsics,
        projection_matrix: None,
    })
}
