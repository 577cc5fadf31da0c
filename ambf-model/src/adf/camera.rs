//! Cameras.

use nalgebra::{Matrix4, Vector3};

use super::common::{Common, ShaderProgram};
use super::reader::Map;
use super::report::ProblemKind;
use super::values::Base;

/// A camera as written. It looks from `location` at `look_at`; both and `up` are in the parent's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Identity, communication, plugins.
    pub common: Common,
    /// Name of the parent object; empty: the world.
    pub parent: String,
    /// Position, m. Default: zero.
    pub location: Vector3<f64>,
    /// Point in the middle of the picture, m. Default: zero.
    pub look_at: Vector3<f64>,
    /// Upward direction. Default: (0, 0, 1).
    pub up: Vector3<f64>,
    /// Near and far clipping planes, m. Default: 0.1 and 10.
    pub clipping_plane: (f64, f64),
    /// Vertical field of view, rad. Default: 0.7.
    pub field_view_angle: f64,
    /// Width of an orthographic view, m; `None`: perspective.
    pub orthographic_view_width: Option<f64>,
    /// Stereo; `None`: mono.
    pub stereo: Option<Stereo>,
    /// Monitor for the window. Default: `None`.
    pub monitor: Option<u32>,
    /// Names shown in the window's title.
    pub controlling_devices: Vec<String>,
    /// Show a window. Default: `true`.
    pub visible: bool,
    /// Publish the picture; `None`: don't.
    pub publish_image: Option<PublishedFrame>,
    /// Publish a point cloud; `None`: don't.
    pub publish_depth: Option<PublishedFrame>,
    /// Key `publish image samples`: samples a pixel of published pictures, 1 to 8; more than 1 smooths edges. Default:
    /// 1.
    pub image_samples: u32,
    /// Noise on the depth; `None`: none.
    pub depth_noise: Option<DepthNoise>,
    /// Shaders run on the picture.
    pub preprocessing_shaders: Option<ShaderProgram>,
    /// Shaders that compute the depth.
    pub depth_compute_shaders: Option<ShaderProgram>,
    /// Multi-pass transparency. Default: `false`.
    pub multipass: bool,
    /// Factors on the speed of the mouse.
    pub mouse: MouseMultipliers,
    /// Width and height of the window, pixels; `None`: not given.
    pub window_resolution: Option<(u32, u32)>,
    /// Key `intrinsics`, or `camera intrinsics`; `None`: the field of view counts.
    pub intrinsics: Option<Intrinsics>,
    /// Projection matrix (4 x 4) instead of the field of view; `None`: not given.
    pub projection_matrix: Option<Matrix4<f64>>,
}

/// What a calibrated camera is described by, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    /// Focal lengths along x and y, above 0.
    pub focal_lengths: (f64, f64),
    /// Principal point.
    pub principal_point: (f64, f64),
    /// Skew. Default: 0.
    pub skew: f64,
}

/// A published picture or point cloud.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PublishedFrame {
    /// Every n-th frame, at least 1. Default: 1 for pictures, 10 for depth.
    pub interval: u32,
    /// Width in pixels, 1 to 16384. Default: 640 for pictures, that of pictures for depth.
    pub width: u32,
    /// Height in pixels, 1 to 16384. Default: 480 for pictures, that of pictures for depth.
    pub height: u32,
}

/// Passive left-right stereo.
#[derive(Clone, Debug, PartialEq)]
pub struct Stereo {
    /// Mode as written; every text means passive left-right.
    pub mode: String,
    /// Distance of the eyes, m.
    pub eye_separation: f64,
    /// Focal length, m.
    pub focal_length: f64,
}

/// Additive Gaussian noise on the depth, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthNoise {
    /// Mean, m.
    pub mean: f64,
    /// Standard deviation, m. Default: 0.001.
    pub std_dev: f64,
    /// Added to the mean, m. Default: 0.
    pub bias: f64,
    /// What the noise of a run is made from; the same seed gives the same noise. Default: `None`, the clock.
    pub seed: Option<u32>,
}

/// Factors on the speed of the mouse. Default: 1 each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MouseMultipliers {
    /// Factor on panning.
    pub pan: f64,
    /// Factor on rotating.
    pub rotate: f64,
    /// Factor on scrolling.
    pub scroll: f64,
    /// Factor on the arc ball.
    pub arcball: f64,
}

impl Default for MouseMultipliers {
    fn default() -> Self {
        Self { pan: 1.0, rotate: 1.0, scroll: 1.0, arcball: 1.0 }
    }
}

impl Camera {
    pub(super) fn read(map: &Map<'_>, base: &Base) -> Option<Self> {
        // Depth has the size of pictures, as in the C++ program, unless it has a size of its own.
        let (publish_image, size) = PublishedFrame::read(map, IMAGE_KEYS, 1, (640, 480));
        let (publish_depth, _) = PublishedFrame::read(map, DEPTH_KEYS, 10, size);
        let camera = Self {
            common: map.common(base),
            parent: map.filled("parent").unwrap_or_default(),
            // An orientation beside the coordinates is replaced by that of the view.
            location: (map.flat_pose("location")).unwrap_or_default().translation.vector,
            look_at: map.vector("look at").unwrap_or_default(),
            up: map.vector("up").unwrap_or(Vector3::z()),
            clipping_plane: clipping_plane(map),
            field_view_angle: map.real("field view angle").map_or(FIELD_OF_VIEW, |angle| {
                if angle > 0.0 && angle < std::f64::consts::PI {
                    return angle;
                }
                map.warn(ProblemKind::OutOfRange, "field view angle", "an angle between 0 and pi rad", "0.7 is used");
                FIELD_OF_VIEW
            }),
            orthographic_view_width: map.real("orthographic view width").filter(|width| {
                if *width <= 0.0 {
                    let expected = "a width above 0 m";
                    map.warn(ProblemKind::OutOfRange, "orthographic view width", expected, "the view is a perspective");
                }
                *width > 0.0
            }),
            stereo: map.map_opt("stereo").map(|block| {
                let mut stereo = Stereo {
                    mode: block.need_string("mode"),
                    eye_separation: block.need_real("eye separation"),
                    focal_length: block.need_real("focal length"),
                };
                if stereo.focal_length < MIN_FOCAL_LENGTH {
                    let (expected, used) = ("a length above 0 m", format!("{MIN_FOCAL_LENGTH} is used"));
                    block.warn(ProblemKind::OutOfRange, "focal length", expected, &used);
                    stereo.focal_length = MIN_FOCAL_LENGTH;
                }
                block.finish();
                stereo
            }),
            monitor: map.uint("monitor"),
            controlling_devices: (map.strings("controlling devices").iter())
                .map(|(device, _)| (*device).to_owned())
                .collect(),
            visible: map.boolean("visible").unwrap_or(true),
            publish_image,
            publish_depth,
            image_samples: map.uint("publish image samples").map_or(1, |samples| {
                if !(1..=MAX_SAMPLES).contains(&samples) {
                    let expected = format!("1 to {MAX_SAMPLES} samples a pixel");
                    map.warn(ProblemKind::OutOfRange, "publish image samples", &expected, "the nearest is used");
                }
                samples.clamp(1, MAX_SAMPLES)
            }),
            depth_noise: DepthNoise::read(map),
            preprocessing_shaders: map.shaders("preprocessing shaders"),
            depth_compute_shaders: map.shaders("depth compute shaders"),
            multipass: map.boolean("multipass").unwrap_or(false),
            mouse: MouseMultipliers::read(map),
            window_resolution: window_resolution(map),
            intrinsics: Intrinsics::read(map),
            projection_matrix: understood(map, "projection matrix", "4 rows of 4 numbers", |numbers| {
                let is_list = numbers.len() == 16 && numbers.iter().all(|(name, _)| name.is_empty());
                is_list.then(|| Matrix4::from_row_iterator(numbers.iter().map(|(_, number)| *number)))
            }),
        };
        map.finish();
        Some(camera)
    }
}

/// Keys: switch, interval, resolution.
type FrameKeys = [&'static str; 3];

const IMAGE_KEYS: FrameKeys = ["publish image", "publish image interval", "publish image resolution"];
const DEPTH_KEYS: FrameKeys = ["publish depth", "publish depth interval", "publish depth resolution"];

/// Largest edge of a published picture in pixels.
const MAX_PIXELS: f64 = 16384.0;

/// Most samples a pixel.
const MAX_SAMPLES: u32 = 8;

/// Vertical field of view where none is given, rad.
const FIELD_OF_VIEW: f64 = 0.7;

/// Near and far plane where none are given, m.
const PLANES: (f64, f64) = (0.1, 10.0);

/// Shortest focal length of stereo, m.
const MIN_FOCAL_LENGTH: f64 = 1e-6;

fn clipping_plane(map: &Map<'_>) -> (f64, f64) {
    let Some(planes) = map.map_opt("clipping plane") else { return PLANES };
    let (near, far) = (planes.need_real("near"), planes.need_real("far"));
    planes.finish();
    if near > 0.0 && far > near {
        return (near, far);
    }
    // What is not there has been reported, and drops the camera.
    if planes.is_filled("near") && planes.is_filled("far") {
        let used = format!("{} and {} are used", PLANES.0, PLANES.1);
        map.warn(ProblemKind::OutOfRange, "clipping plane", "0 < near < far, in m", &used);
    }
    PLANES
}

/// Reads numbers that only what is drawn depends on: what is not understood is reported and refuses nothing.
fn understood<T>(map: &Map<'_>, key: &str, expected: &str, read: impl Fn(&[(&str, f64)]) -> Option<T>) -> Option<T> {
    if !map.is_filled(key) {
        return None;
    }
    let value = map.numbers(key).and_then(|numbers| read(&numbers));
    if value.is_none() {
        map.warn(ProblemKind::UnknownValue, key, expected, "it is not used");
    }
    value
}

/// The number called `name`.
fn named(numbers: &[(&str, f64)], name: &str) -> Option<f64> {
    numbers.iter().find(|(other, _)| *other == name).map(|(_, number)| *number)
}

fn window_resolution(map: &Map<'_>) -> Option<(u32, u32)> {
    let expected = format!("{{width, height}} in pixels, from 1 to {MAX_PIXELS}");
    understood(map, "window resolution", &expected, |numbers| {
        let [width, height] = match numbers {
            &[("", width), ("", height)] => [width, height],
            _ => [named(numbers, "width")?, named(numbers, "height")?],
        };
        let is_size = |pixels: f64| (1.0..=MAX_PIXELS).contains(&pixels);
        (is_size(width) && is_size(height)).then_some((width as u32, height as u32))
    })
}

impl Intrinsics {
    /// The second name is that of later versions of the C++ program.
    fn read(map: &Map<'_>) -> Option<Self> {
        let expected = "{fx, fy, cx, cy} and optionally s, in pixels, with focal lengths above 0";
        let [own, other] = ["intrinsics", "camera intrinsics"].map(|key| {
            understood(map, key, expected, |numbers| {
                let of = |name| named(numbers, name);
                let intrinsics = Self {
                    focal_lengths: (of("fx")?, of("fy")?),
                    principal_point: (of("cx")?, of("cy")?),
                    skew: of("s").unwrap_or(0.0),
                };
                let (fx, fy) = intrinsics.focal_lengths;
                (fx > 0.0 && fy > 0.0).then_some(intrinsics)
            })
        });
        own.or(other)
    }
}

impl PublishedFrame {
    /// What is published, if it is, and its size in any case.
    fn read(
        map: &Map<'_>,
        [switch, interval, resolution]: FrameKeys,
        every: u32,
        (width, height): (u32, u32),
    ) -> (Option<Self>, (u32, u32)) {
        let published = map.boolean(switch).unwrap_or(false);
        let every = map.uint(interval).unwrap_or(every);
        if every == 0 {
            map.warn(ProblemKind::OutOfRange, interval, "a number of pictures from 1", "1 is used");
        }
        let mut frame = Self { interval: every.max(1), width, height };
        if let Some(block) = map.map_opt(resolution) {
            let size = ["width", "height"].map(|key| {
                let pixels = block.need_real(key);
                let nearest = pixels.clamp(1.0, MAX_PIXELS);
                // What is not there has been reported, and drops the camera.
                if block.is_filled(key) && !(1.0..=MAX_PIXELS).contains(&pixels) {
                    let expected = format!("1 to {MAX_PIXELS} pixels");
                    block.warn(ProblemKind::OutOfRange, key, &expected, &format!("{nearest} is used"));
                }
                nearest as u32
            });
            [frame.width, frame.height] = size;
            block.finish();
        }
        (published.then_some(frame), (frame.width, frame.height))
    }
}

impl DepthNoise {
    fn read(map: &Map<'_>) -> Option<Self> {
        let block = map.map_opt("publish depth noise")?;
        let other_spelling = block.real("std dev");
        let noise = Self {
            mean: block.need_real("mean"),
            std_dev: block.real("std_dev").or(other_spelling).unwrap_or(0.001),
            bias: block.real("bias").unwrap_or(0.0),
            seed: block.uint("seed"),
        };
        block.finish();
        Some(noise)
    }
}

impl MouseMultipliers {
    fn read(map: &Map<'_>) -> Self {
        let block = map.map("mouse control multipliers");
        let factor = |key| block.real(key).unwrap_or(1.0);
        let multipliers =
            Self { pan: factor("pan"), rotate: factor("rotate"), scroll: factor("scroll"), arcball: factor("arcball") };
        block.finish();
        multipliers
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clean, read, refused};
    use super::super::Model;
    use super::*;

    #[test]
    fn cameras() {
        let text = "cameras: [C, D]\nC: {}\nD:\n  location: {x: 1, y: 2, z: 3}\n  clipping plane: {near: 0.5, far: 2}
  publish image: Yes\n  publish image resolution: {width: 320.0, height: 240}\n  publish image interval: 4
  publish depth interval: 3\n  publish depth noise: {mean: 0.2, std dev: 0.3, seed: 7}\n  monitor: 2
  mouse control multipliers: {pan: 2}\n  controlling devices: [a, b]\n";
        let cameras = clean::<Model>(text).cameras;
        assert_eq!(cameras[0].up, Vector3::z());
        assert_eq!((cameras[0].clipping_plane, cameras[0].monitor), ((0.1, 10.0), None));
        assert!(cameras[0].visible && cameras[0].publish_image.is_none());
        let frame = PublishedFrame { interval: 4, width: 320, height: 240 };
        assert_eq!(cameras[1].publish_image, Some(frame));
        assert_eq!(cameras[1].publish_depth, None);
        assert_eq!(cameras[1].depth_noise.map(|n| (n.std_dev, n.seed)), Some((0.3, Some(7))));
        assert_eq!((cameras[1].mouse.pan, cameras[1].mouse.scroll), (2.0, 1.0));
        assert_eq!(cameras[1].controlling_devices, ["a", "b"]);
        let depth = |more: &str| {
            let text = format!(
                "cameras: [C]\nC: {{publish depth: true, publish image resolution: {{width: 32, height: 24}}{more}}}\n"
            );
            clean::<Model>(&text).cameras[0].publish_depth.map(|frame| (frame.interval, frame.width, frame.height))
        };
        assert_eq!(depth(""), Some((10, 32, 24)), "the size of pictures, though none are published");
        assert_eq!(depth(", publish depth resolution: {width: 8, height: 6}"), Some((10, 8, 6)));
        let text = "cameras: [C]\nC: {clipping plane: {near: 1}}\n";
        assert!(refused::<Model>(text)[0].contains("`C / clipping plane / far` is missing"));
    }

    /// Row 21 of the checklist, and other values that no picture can be taken with.
    #[test]
    fn values_outside_their_range_are_replaced_with_a_warning() {
        let text = "cameras: [C]\nC:\n  clipping plane: {near: 2, far: 1}\n  field view angle: 4\n  orthographic view width: -1\n\
                    \x20 stereo: {mode: PASSIVE, eye separation: 0.1, focal length: 0}\n  publish image: true\n\
                    \x20 publish image interval: 0\n  publish image resolution: {width: 0, height: 20000}\n  publish image samples: 99\n";
        let (model, problems) = read::<Model>(text);
        let camera = &model.cameras[0];
        assert_eq!((camera.clipping_plane, camera.field_view_angle), ((0.1, 10.0), 0.7));
        assert_eq!(camera.orthographic_view_width, None);
        assert_eq!(camera.stereo.as_ref().map(|stereo| stereo.focal_length), Some(1e-6));
        assert_eq!(camera.publish_image, Some(PublishedFrame { interval: 1, width: 1, height: 16384 }));
        assert_eq!(camera.image_samples, 8);
        assert_eq!(problems.len(), 8, "{problems:#?}");
        assert!(problems.iter().any(|line| line.contains("publish image interval") && line.contains("1 is used")));
    }

    #[test]
    fn intrinsics_and_windows() {
        let text = "cameras: [C, D]\nC: {window resolution: {width: 1280, height: 720}, \
                    camera intrinsics: {fx: 800, fy: 810.5, cx: 640, cy: 360}}\n\
                    D:\n  intrinsics: {fx: 1, fy: 2, cx: 3, cy: 4, s: 5}\n  window resolution: [640, 480]\n  \
                    projection matrix: [[1, 2, 3, 4], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, -1, 0]]\n";
        let cameras = clean::<Model>(text).cameras;
        let expected = Intrinsics { focal_lengths: (800.0, 810.5), principal_point: (640.0, 360.0), skew: 0.0 };
        assert_eq!((cameras[0].intrinsics, cameras[0].window_resolution), (Some(expected), Some((1280, 720))));
        assert_eq!(
            (cameras[1].intrinsics.map(|i| i.skew), cameras[1].window_resolution),
            (Some(5.0), Some((640, 480)))
        );
        let matrix = cameras[1].projection_matrix.expect("a matrix");
        assert_eq!((matrix[(0, 3)], matrix[(3, 2)], matrix[(3, 3)]), (4.0, -1.0, 0.0));
        // No mistake in them refuses the file.
        let text = "cameras: [C, D]\nC: {intrinsics: {fx: 0, fy: 1, cx: 1, cy: 1}, camera intrinsics: red, window resolution: ''}\n\
                    D: {projection matrix: [1, 2], window resolution: {width: 1e9, height: 1}}\n";
        let (model, problems) = read::<Model>(text);
        assert_eq!((model.cameras.len(), problems.len()), (2, 4), "{problems:#?}");
        assert!(problems[0].contains("`C / intrinsics` is a mapping, expected {fx, fy, cx, cy}"), "{problems:#?}");
        assert!(model.cameras.iter().all(|c| c.intrinsics.is_none() && c.window_resolution.is_none()));
    }
}
