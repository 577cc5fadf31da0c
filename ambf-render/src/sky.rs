//! Pictures around the scene.

use ambf_core::adf;
use image::imageops::FilterType;
use nalgebra::Matrix4;

use crate::gl::{self, Current};
use crate::view::Eye;
use crate::{RenderError, Texture};

/// Field of view of the picture around the scene in orthographic views, rad.
const ORTHOGRAPHIC_ANGLE: f64 = 0.7;
/// Layers of the texture, as indices in [`adf::Skybox::faces`].
const LAYERS: [usize; 6] = [4, 5, 1, 0, 2, 3];

/// Loads the six pictures: front, back, left, right, top, bottom.
///
/// # Errors
/// Text for the user.
pub(crate) fn load(gl: &Current<'_>, skybox: &adf::Skybox) -> Result<gl::Texture, String> {
    let faces: Result<Vec<Texture>, _> = LAYERS.iter().map(|&face| Texture::load(&skybox.faces[face])).collect();
    let faces = faces.map_err(|error| format!("{error}; the sky is not drawn"))?;
    let size = faces.iter().map(|face| face.width.max(face.height)).max().unwrap_or(1);
    let size = size.min(gl.device().most_texels).min(4096);
    let layer = |face: Texture| {
        if (face.width, face.height) == (size, size) {
            return face.rgba;
        }
        let picture = image::RgbaImage::from_raw(face.width, face.height, face.rgba).unwrap_or_default();
        image::imageops::resize(&picture, size, size, FilterType::Triangle).into_raw()
    };
    let layers: Vec<Vec<u8>> = faces.into_iter().map(layer).collect();
    gl.layers(size, &layers).map_err(|error: RenderError| format!("{error}; the sky is not drawn"))
}

/// From clip coordinates at the far plane to directions in the world.
pub(crate) fn to_world(eye: &Eye) -> Matrix4<f64> {
    let mut view = eye.view;
    // The sky is infinitely far: the position of the eye does not count.
    (view[(0, 3)], view[(1, 3)], view[(2, 3)]) = (0.0, 0.0, 0.0);
    let mut projection = eye.projection;
    if eye.is_orthographic {
        let cotangent = 1.0 / (0.5 * ORTHOGRAPHIC_ANGLE).tan();
        projection = Matrix4::zeros();
        projection[(0, 0)] = cotangent * f64::from(eye.height.max(1)) / f64::from(eye.width.max(1));
        projection[(1, 1)] = cotangent;
        projection[(2, 2)] = -1.0;
        projection[(2, 3)] = -1.0;
        projection[(3, 2)] = -1.0;
    }
    (projection * view).try_inverse().unwrap_or_else(Matrix4::identity)
}
