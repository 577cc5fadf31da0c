//! Pictures around the scene.

use ambf_core::adf;
use image::imageops::FilterType;
use nalgebra::Matrix4;

use crate::gl::{self, Current};
use crate::view::Eye;
use crate::{RenderError, Texture};

/// Field of view of the picture around the scene in orthographic views, rad.
const ORTHOGRAPHIC_ANGLE: f64 = 0.7;
/// Layers of the built-in program's texture, as indices in [`adf::Skybox::faces`].
const LAYERS: [usize; 6] = [4, 5, 1, 0, 2, 3];
/// Triangles of a cube; bits 0, 1 and 2 of a corner's index are set where x, y and z are positive.
const CUBE: [u32; 36] =
    [0, 1, 3, 0, 3, 2, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4, 2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 3, 7, 1, 7, 5];

/// Pictures around the scene, for the program that draws them.
pub(crate) enum Sky {
    /// Six layers for the built-in program: front, back, left, right, top, bottom.
    BuiltIn(gl::Texture),
    /// For a program of the user: its index, a cube map, and a cube with edges of 2.
    User { program: usize, faces: gl::Texture, cube: gl::VertexArray },
}

/// Loads the six pictures, for the user's program of this index or for the built-in one.
///
/// # Errors
/// Text for the user.
pub(crate) fn load(gl: &Current<'_>, skybox: &adf::Skybox, program: Option<usize>) -> Result<Sky, String> {
    let faces: Result<Vec<Texture>, _> = skybox.faces.iter().map(|face| Texture::load(face)).collect();
    let faces = faces.map_err(|error| format!("{error}; the sky is not drawn"))?;
    let size = faces.iter().map(|face| face.width.max(face.height)).max().unwrap_or(1);
    let size = size.min(gl.device().most_texels).min(4096);
    let square = |face: Texture| {
        if (face.width, face.height) == (size, size) {
            return face.rgba;
        }
        let picture = image::RgbaImage::from_raw(face.width, face.height, face.rgba).unwrap_or_default();
        image::imageops::resize(&picture, size, size, FilterType::Triangle).into_raw()
    };
    let mut faces: Vec<Vec<u8>> = faces.into_iter().map(square).collect();
    let failed = |error: RenderError| format!("{error}; the sky is not drawn");
    let Some(program) = program else {
        let layers = LAYERS.map(|face| std::mem::take(&mut faces[face]));
        return gl.layers(size, &layers).map(Sky::BuiltIn).map_err(failed);
    };
    // The faces of a cube map have their top row first.
    let top_first = |face: &Vec<u8>| face.rchunks_exact(size as usize * 4).flatten().copied().collect::<Vec<u8>>();
    let faces: Vec<_> = faces.iter().map(top_first).collect();
    let sign = |corner: u32, axis: u32| if corner >> axis & 1 == 1 { 1.0 } else { -1.0 };
    let corners: Vec<f32> = (0..8)
        .flat_map(|corner| [sign(corner, 0), sign(corner, 1), sign(corner, 2), 0.0, 0.0, 0.0, 0.0, 0.0])
        .collect();
    let cube = gl.vertex_array(&corners, gl::Layout::default(), &CUBE).map_err(failed)?;
    Ok(Sky::User { program, faces: gl.cube_map(size, &faces).map_err(failed)?, cube })
}

/// Rotation of the view, and the projection: the sky is infinitely far, so that the position of the eye does not count.
fn view_and_projection(eye: &Eye) -> (Matrix4<f64>, Matrix4<f64>) {
    let mut view = eye.view;
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
    (view, projection)
}

/// From clip coordinates at the far plane to directions in the world.
pub(crate) fn to_world(eye: &Eye) -> Matrix4<f64> {
    let (view, projection) = view_and_projection(eye);
    (projection * view).try_inverse().unwrap_or_else(Matrix4::identity)
}

/// From the axes of a cube map to those of the eye, and the projection, for programs of users. The cube's x, y and z
/// are −y, z and x of the world: seen from within, its pictures are upright and not mirrored.
pub(crate) fn cube_to_eye(eye: &Eye) -> (Matrix4<f64>, Matrix4<f64>) {
    let (view, projection) = view_and_projection(eye);
    #[rustfmt::skip]
    let cube_to_world = Matrix4::new(
         0.0, 0.0, 1.0, 0.0,
        -1.0, 0.0, 0.0, 0.0,
         0.0, 1.0, 0.0, 0.0,
         0.0, 0.0, 0.0, 1.0,
    );
    (view * cube_to_world, projection)
}
