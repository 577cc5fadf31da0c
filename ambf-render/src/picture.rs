//! What is asked of a picture, and what comes back.

use ambf_core::adf::ShaderProgram;

use crate::view::Eye;

/// What is wanted of a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct PictureRequest {
    /// Pixels from left to right, 1 to 16384.
    pub width: u32,
    /// Pixels from top to bottom, 1 to 16384.
    pub height: u32,
    /// Colour as a lit picture.
    pub color: bool,
    /// Distance along the axis of the camera.
    pub depth: bool,
    /// Which object each pixel shows.
    pub ids: bool,
    /// Surface normals.
    pub normals: bool,
    /// Samples a pixel of the colour, 1 to 8; more than 1 is anti-aliasing. Never used for depth, ids, normals and with
    /// [`preprocessing`](Self::preprocessing).
    pub samples: u32,
    /// The GLSL program that draws all bodies, ghost objects and soft bodies instead of their own (a camera's
    /// `preprocessing shaders`): masks. It is drawn opaque.
    pub preprocessing: Option<ShaderProgram>,
    /// Markers of the stage, frames, sensors and actuators are drawn too.
    pub markers: bool,
}

impl PictureRequest {
    /// Colour only, one sample a pixel, with markers.
    pub fn color(width: u32, height: u32) -> Self {
        Self {
            width,
            height,
            color: true,
            depth: false,
            ids: false,
            normals: false,
            samples: 1,
            preprocessing: None,
            markers: true,
        }
    }
}

/// A picture. All arrays have the top row first, each row from left to right; what was not asked for is empty.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Picture {
    /// Pixels from left to right.
    pub width: u32,
    /// Pixels from top to bottom.
    pub height: u32,
    /// (height x width x 3) red, green, blue.
    pub color: Vec<u8>,
    /// (height x width) distance from the eye along the axis of the camera, m; the far plane where nothing is seen.
    pub depth: Vec<f32>,
    /// (height x width x 2) index of the object in the stage plus 1 ([`Stage::id_name`](crate::Stage::id_name)), and
    /// index of its model plus 1; 0 where nothing is seen.
    pub ids: Vec<[u32; 2]>,
    /// (height x width x 3) unit normal of the surface in the camera's frame, towards the camera; 0 where nothing is
    /// seen.
    pub normals: Vec<[f32; 3]>,
    /// One or two eyes with their projections.
    pub eyes: Vec<Eye>,
    /// For messages about files named in requests that cannot be used; each is said once.
    pub messages: Vec<String>,
}

/// Arrays that a picture is written into, each as that of [`Picture`]; what is not asked for is not touched.
pub struct Planes<'a> {
    /// (height x width x 3) red, green, blue.
    pub color: &'a mut [u8],
    /// (height x width) m along the axis.
    pub depth: &'a mut [f32],
    /// (height x width x 2) object and model.
    pub ids: &'a mut [[u32; 2]],
    /// (height x width x 3) unit normals in the camera's frame.
    pub normals: &'a mut [[f32; 3]],
}

impl Picture {
    /// (height·width x 3) points of the depth in the camera's frame, m, float32, **bottom row first**: (x, y, z) with x
    /// = −depth, y to the right, z up. Empty without depth.
    pub fn points(&self) -> Vec<[f32; 3]> {
        let mut points = vec![[0.0; 3]; self.depth.len()];
        for eye in &self.eyes {
            let Some(inverse) = eye.projection.try_inverse() else { continue };
            for j in 0..eye.height {
                let row = (self.height - 1 - j) as usize * self.width as usize;
                for i in 0..eye.width {
                    let column = (eye.left + i) as usize;
                    let depth = f64::from(self.depth[row + column]);
                    // Clip coordinates of the point: its own depth gives the third one.
                    let z = eye.projection[(2, 2)] * -depth + eye.projection[(2, 3)];
                    let w = eye.projection[(3, 2)] * -depth + eye.projection[(3, 3)];
                    let x = (2.0 * (f64::from(i) + 0.5) / f64::from(eye.width) - 1.0) * w;
                    let y = (2.0 * (f64::from(j) + 0.5) / f64::from(eye.height) - 1.0) * w;
                    let q = inverse * nalgebra::Vector4::new(x, y, z, w);
                    let place = j as usize * self.width as usize + column;
                    points[place] = [
                        -depth as f32 + eye.offset.x as f32,
                        (q.x / q.w + eye.offset.y) as f32,
                        (q.y / q.w + eye.offset.z) as f32,
                    ];
                }
            }
        }
        points
    }
}
