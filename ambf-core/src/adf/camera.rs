//! Cameras.

use nalgebra::Vector3;

use super::common::{Common, ShaderProgram};

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
