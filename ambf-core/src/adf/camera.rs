//! Cameras.

use nalgebra::Vector3;

use super::common::{Common, ShaderProgram};
use super::reader::{Map, Range};
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
}

/// A published picture or point cloud.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PublishedFrame {
    /// Every n-th frame, at least 1. Default: 1 for pictures, 10 for depth.
    pub interval: u32,
    /// Width in pixels. Default: 640.
    pub width: u32,
    /// Height in pixels. Default: 480.
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
    /// Stored only. Default: 0.
    pub bias: f64,
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
        let camera = Self {
            common: map.common(base),
            parent: map.filled("parent").unwrap_or_default(),
            // An orientation beside the coordinates is replaced by that of the view.
            location: (map.flat_pose("location")).unwrap_or_default().translation.vector,
            look_at: map.vector("look at").unwrap_or_default(),
            up: map.vector("up").unwrap_or(Vector3::z()),
            clipping_plane: map.map_opt("clipping plane").map_or((0.1, 10.0), |planes| {
                let near_far = (planes.need_real("near"), planes.need_real("far"));
                planes.finish();
                near_far
            }),
            field_view_angle: map.real("field view angle").unwrap_or(0.7),
            orthographic_view_width: map.real("orthographic view width"),
            stereo: map.map_opt("stereo").map(|block| {
                let stereo = Stereo {
                    mode: block.need_string("mode"),
                    eye_separation: block.need_real("eye separation"),
                    focal_length: block.need_real("focal length"),
                };
                block.finish();
                stereo
            }),
            monitor: map.uint("monitor"),
            controlling_devices: (map.strings("controlling devices").iter())
                .map(|(device, _)| (*device).to_owned())
                .collect(),
            visible: map.boolean("visible").unwrap_or(true),
            publish_image: PublishedFrame::read(map, IMAGE_KEYS, 1),
            publish_depth: PublishedFrame::read(map, DEPTH_KEYS, 10),
            depth_noise: DepthNoise::read(map),
            preprocessing_shaders: map.shaders("preprocessing shaders"),
            depth_compute_shaders: map.shaders("depth compute shaders"),
            multipass: map.boolean("multipass").unwrap_or(false),
            mouse: MouseMultipliers::read(map),
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

impl PublishedFrame {
    fn read(map: &Map<'_>, [switch, interval, resolution]: FrameKeys, every: u32) -> Option<Self> {
        let published = map.boolean(switch).unwrap_or(false);
        let mut frame = Self { interval: map.uint(interval).unwrap_or(every).max(1), width: 640, height: 480 };
        if let Some(block) = map.map_opt(resolution) {
            let size = ["width", "height"].map(|key| {
                let pixels = block.need_real_in(key, Range::Positive);
                if pixels > MAX_PIXELS {
                    let expected = format!("at most {MAX_PIXELS} pixels");
                    block.reject(ProblemKind::OutOfRange, key, &expected);
                }
                pixels.clamp(1.0, MAX_PIXELS) as u32
            });
            [frame.width, frame.height] = size;
            block.finish();
        }
        published.then_some(frame)
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
    use super::super::tests::{clean, refused};
    use super::super::Model;
    use super::*;

    #[test]
    fn cameras() {
        let text = "cameras: [C, D]\nC: {}\nD:\n  location: {x: 1, y: 2, z: 3}\n  clipping plane: {near: 0.5, far: 2}
  publish image: Yes\n  publish image resolution: {width: 320.0, height: 240}\n  publish image interval: 0
  publish depth interval: 3\n  publish depth noise: {mean: 0.2, std dev: 0.3}\n  monitor: 2
  mouse control multipliers: {pan: 2}\n  controlling devices: [a, b]\n";
        let cameras = clean::<Model>(text).cameras;
        assert_eq!(cameras[0].up, Vector3::z());
        assert_eq!((cameras[0].clipping_plane, cameras[0].monitor), ((0.1, 10.0), None));
        assert!(cameras[0].visible && cameras[0].publish_image.is_none());
        let frame = PublishedFrame { interval: 1, width: 320, height: 240 };
        assert_eq!(cameras[1].publish_image, Some(frame));
        assert_eq!(cameras[1].publish_depth, None);
        assert_eq!(cameras[1].depth_noise.map(|n| n.std_dev), Some(0.3));
        assert_eq!((cameras[1].mouse.pan, cameras[1].mouse.scroll), (2.0, 1.0));
        assert_eq!(cameras[1].controlling_devices, ["a", "b"]);
        let text = "cameras: [C]\nC: {clipping plane: {near: 1}}\n";
        assert!(refused::<Model>(text)[0].contains("`C / clipping plane / far` is missing"));
    }
}
