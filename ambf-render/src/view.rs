//! Cameras as mathematics: where the eyes are, what their projections are, which ray a pixel looks along.
//!
//! A camera looks along its −x axis, +y is right in the picture and +z up. OpenGL's eye frame is (right, up, backward),
//! so that (x, y, z) of the eye frame are (y, z, x) of the camera. Pixels are counted from the left and from the *top*,
//! their centres are at half integers.

use ambf_core::adf;
use ambf_core::comm::CameraView;
use nalgebra::{Isometry3, Matrix3, Matrix4, Point3, Vector3};

/// Narrowest and widest vertical field of view that is drawn, rad.
const FIELD_OF_VIEW: (f64, f64) = (1e-3, std::f64::consts::PI - 1e-3);

/// How a camera projects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Projection {
    /// Vertical field of view, rad; pixels are square.
    Perspective(f64),
    /// Width of the view, m; pixels are square.
    Orthographic(f64),
    /// OpenGL clip coordinates of a picture of this width / height; pictures of other shapes keep the vertical extent.
    Matrix {
        /// From the eye frame to clip coordinates. Rows 0 and 1 are used, and rows 2 and 3 too.
        matrix: Matrix4<f64>,
        /// Width / height of the picture that it is meant for.
        aspect: f64,
    },
}

/// Two eyes that look in parallel; the left one draws the left half of the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stereo {
    /// Distance of the eyes, m.
    pub separation: f64,
    /// Distance at which the two pictures coincide, m.
    pub focal_length: f64,
}

/// What a picture is taken with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Pose of the camera in the world.
    pub pose: Isometry3<f64>,
    /// Distance of the near clipping plane, m.
    pub near: f64,
    /// Distance of the far clipping plane, m.
    pub far: f64,
    /// How it projects.
    pub projection: Projection,
    /// `None`: one eye.
    pub stereo: Option<Stereo>,
}

/// A part of the picture and how it is projected: the whole for one eye, one half for each of two.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Eye {
    /// Left edge, pixels.
    pub left: u32,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// From the world to the eye frame (right, up, backward).
    pub view: Matrix4<f64>,
    /// From the eye frame to clip coordinates.
    pub projection: Matrix4<f64>,
    /// Position of the eye in the camera's frame, m.
    pub offset: Vector3<f64>,
    /// Whether the rays of the pixels are parallel.
    pub is_orthographic: bool,
}

/// A ray in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelRay {
    /// On the near clipping plane for orthographic views, else the eye, m.
    pub origin: Point3<f64>,
    /// Of unit length.
    pub direction: Vector3<f64>,
}

impl View {
    /// The view of a camera as it is described and as its state says. Intrinsics and projection matrices of the
    /// description are meant for pictures of the published resolution, else of 640 x 480. Planes that are no planes (`0
    /// < near < far`) become 0.1 and 10 m.
    pub fn of_camera(camera: &adf::Camera, state: &CameraView) -> Self {
        let (mut near, mut far) = (state.near_plane, state.far_plane);
        if !(near > 0.0 && far > near && far.is_finite()) {
            (near, far) = (0.1, 10.0);
        }
        let (width, height) = published_size(camera);
        let aspect = f64::from(width) / f64::from(height);
        let given = camera.projection_matrix.map(|matrix| (matrix, aspect)).or_else(|| {
            let intrinsics = camera.intrinsics?;
            Some((intrinsics_matrix(&intrinsics, f64::from(width), f64::from(height), near, far), aspect))
        });
        let projection = match (given, state.orthographic_view_width) {
            (Some((matrix, aspect)), _) => Projection::Matrix { matrix, aspect },
            (None, Some(width)) if width > 0.0 => Projection::Orthographic(width),
            (None, _) => Projection::Perspective(state.field_view_angle),
        };
        let is_stereo = !matches!(projection, Projection::Orthographic(_));
        let stereo = state.stereo.filter(|_| is_stereo);
        Self {
            pose: state.pose,
            near,
            far,
            projection,
            stereo: stereo
                .map(|(separation, focal_length)| Stereo { separation, focal_length: focal_length.max(1e-6) }),
        }
    }

    /// One or two eyes of a picture of `width` x `height` pixels, from left to right.
    pub fn eyes(&self, width: u32, height: u32) -> Vec<Eye> {
        let eye = |left: u32, width: u32, side: f64| {
            let offset = Vector3::new(0.0, side * 0.5 * self.stereo.map_or(0.0, |stereo| stereo.separation), 0.0);
            let pose = self.pose * nalgebra::Translation3::from(offset);
            let mut projection = self.matrix(f64::from(width.max(1)) / f64::from(height.max(1)));
            if let Some(stereo) = &self.stereo {
                // Off-axis: the windows of both eyes coincide at the focal length. A shift of the window by s at the
                // near plane moves the picture by P00 s / near in normalised coordinates.
                let shift = -side * 0.5 * stereo.separation / stereo.focal_length;
                projection[(0, 2)] += projection[(0, 0)] * shift;
            }
            let is_orthographic = matches!(self.projection, Projection::Orthographic(_));
            Eye { left, width, height, view: view_matrix(&pose), projection, offset, is_orthographic }
        };
        match self.stereo {
            None => vec![eye(0, width, 0.0)],
            Some(_) => vec![eye(0, width / 2, -1.0), eye(width / 2, width - width / 2, 1.0)],
        }
    }

    /// Projection for a picture (of one eye) of the given width / height.
    fn matrix(&self, aspect: f64) -> Matrix4<f64> {
        let (near, far) = (self.near, self.far);
        let mut matrix = Matrix4::zeros();
        match self.projection {
            Projection::Perspective(angle) => {
                let angle = if angle.is_finite() { angle.clamp(FIELD_OF_VIEW.0, FIELD_OF_VIEW.1) } else { 0.7 };
                let cotangent = 1.0 / (0.5 * angle).tan();
                matrix[(0, 0)] = cotangent / aspect;
                matrix[(1, 1)] = cotangent;
                depth_rows(&mut matrix, near, far);
            }
            Projection::Orthographic(width) => {
                matrix[(0, 0)] = 2.0 / width;
                matrix[(1, 1)] = 2.0 * aspect / width;
                matrix[(2, 2)] = -2.0 / (far - near);
                matrix[(2, 3)] = -(far + near) / (far - near);
                matrix[(3, 3)] = 1.0;
            }
            Projection::Matrix { matrix: given, aspect: meant } => {
                matrix = given;
                for column in 0..4 {
                    matrix[(0, column)] *= meant / aspect;
                }
            }
        }
        matrix
    }

    /// The ray along which the point (`x`, `y`) of a picture looks, in pixels from the upper left corner.
    pub fn ray(&self, width: u32, height: u32, x: f64, y: f64) -> PixelRay {
        let eyes = self.eyes(width, height);
        let eye = eyes.iter().rev().find(|eye| x >= f64::from(eye.left)).unwrap_or(&eyes[0]);
        eye.ray(x, y)
    }
}

impl Eye {
    /// Homogeneous coordinates of the eye in the world: its position, m, and 1; for parallel rays the unit vector
    /// towards it, and 0.
    pub(crate) fn place(&self) -> [f64; 4] {
        let rotation = self.view.fixed_view::<3, 3>(0, 0);
        let backward = rotation.row(2);
        if self.is_orthographic {
            return [backward[0], backward[1], backward[2], 0.0];
        }
        let position = -(rotation.transpose() * self.view.fixed_view::<3, 1>(0, 3));
        [position[0], position[1], position[2], 1.0]
    }

    /// Camera matrix K of the picture that this eye draws, in pixels from the *eye's* upper left corner: K·(right,
    /// down, forward) is homogeneous in (column, row), and pixel centres are at half integers. `None` for projections
    /// that are no pinhole.
    pub fn camera_matrix(&self) -> Option<Matrix3<f64>> {
        let p = &self.projection;
        let is_pinhole = (p[(3, 2)] + 1.0).abs() < 1e-9
            && [p[(3, 0)], p[(3, 1)], p[(3, 3)], p[(1, 0)], p[(0, 3)], p[(1, 3)]]
                .iter()
                .all(|entry| entry.abs() < 1e-9);
        if !is_pinhole {
            return None;
        }
        let (w, h) = (0.5 * f64::from(self.width), 0.5 * f64::from(self.height));
        // Rows count downwards, the eye's second axis goes up.
        Some(Matrix3::new(
            w * p[(0, 0)],
            // No negative zero.
            0.0 - w * p[(0, 1)],
            w * (1.0 - p[(0, 2)]),
            0.0,
            h * p[(1, 1)],
            h * (1.0 + p[(1, 2)]),
            0.0,
            0.0,
            1.0,
        ))
    }

    /// The ray along which the point (`x`, `y`) of the *whole* picture looks, in pixels from its upper left corner.
    pub fn ray(&self, x: f64, y: f64) -> PixelRay {
        let normalised = [
            2.0 * (x - f64::from(self.left)) / f64::from(self.width.max(1)) - 1.0,
            1.0 - 2.0 * y / f64::from(self.height.max(1)),
        ];
        let inverse = (self.projection * self.view).try_inverse().unwrap_or_else(Matrix4::identity);
        let point = |z: f64| {
            let p = inverse * nalgebra::Vector4::new(normalised[0], normalised[1], z, 1.0);
            Point3::from(p.xyz() / p.w)
        };
        let (near, far) = (point(-1.0), point(0.5));
        let direction = (far - near).try_normalize(0.0).unwrap_or_else(Vector3::x);
        let origin = match self.is_orthographic {
            true => near,
            false => {
                let to_world = self.view.try_inverse().unwrap_or_else(Matrix4::identity);
                Point3::new(to_world[(0, 3)], to_world[(1, 3)], to_world[(2, 3)])
            }
        };
        PixelRay { origin, direction }
    }
}

/// From the world to the eye frame (right, up, backward) of a camera at `pose`.
pub fn view_matrix(pose: &Isometry3<f64>) -> Matrix4<f64> {
    let inverse = pose.inverse().to_homogeneous();
    Matrix4::from_rows(&[inverse.row(1), inverse.row(2), inverse.row(0), inverse.row(3)])
}

/// Size of published pictures of a camera, of its depth if it publishes no picture, else 640 x 480.
pub fn published_size(camera: &adf::Camera) -> (u32, u32) {
    let frame = camera.publish_image.or(camera.publish_depth);
    frame.map_or((640, 480), |frame| (frame.width, frame.height))
}

/// Projection of a pinhole camera whose rows count downwards.
fn intrinsics_matrix(intrinsics: &adf::Intrinsics, width: f64, height: f64, near: f64, far: f64) -> Matrix4<f64> {
    let ((fx, fy), (cx, cy)) = (intrinsics.focal_lengths, intrinsics.principal_point);
    let mut matrix = Matrix4::zeros();
    matrix[(0, 0)] = 2.0 * fx / width;
    // The skew multiplies the row, which counts downwards.
    matrix[(0, 1)] = -2.0 * intrinsics.skew / width;
    matrix[(0, 2)] = (width - 2.0 * cx) / width;
    matrix[(1, 1)] = 2.0 * fy / height;
    matrix[(1, 2)] = (2.0 * cy - height) / height;
    depth_rows(&mut matrix, near, far);
    matrix
}

fn depth_rows(matrix: &mut Matrix4<f64>, near: f64, far: f64) {
    matrix[(2, 2)] = -(far + near) / (far - near);
    matrix[(2, 3)] = -2.0 * far * near / (far - near);
    matrix[(3, 2)] = -1.0;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> View {
        View {
            pose: Isometry3::translation(2.0, 0.0, 0.0),
            near: 0.1,
            far: 10.0,
            projection: Projection::Perspective(0.5),
            stereo: None,
        }
    }

    /// Pixel of a point in the world.
    fn pixel(eye: &Eye, point: Point3<f64>) -> (f64, f64) {
        let clip = eye.projection * eye.view * point.to_homogeneous();
        let (x, y) = (clip.x / clip.w, clip.y / clip.w);
        let left = f64::from(eye.left);
        (left + 0.5 * (x + 1.0) * f64::from(eye.width), 0.5 * (1.0 - y) * f64::from(eye.height))
    }

    #[test]
    fn the_focal_length_follows_from_the_height() {
        let focal = 480.0 / (2.0 * (0.25_f64).tan());
        for width in [640, 800, 200] {
            let eye = view().eyes(width, 480)[0];
            let (x, y) = pixel(&eye, Point3::new(0.0, 0.3, 0.2));
            assert!((x - (f64::from(width) / 2.0 + focal * 0.15)).abs() < 1e-9, "+y is right: {x}");
            assert!((y - (240.0 - focal * 0.1)).abs() < 1e-9, "+z is up: {y}");
            let matrix = eye.camera_matrix().expect("a pinhole");
            let seen = matrix * Vector3::new(0.3, -0.2, 2.0);
            assert!((seen.x / seen.z - x).abs() < 1e-9 && (seen.y / seen.z - y).abs() < 1e-9, "{seen}");
        }
    }

    #[test]
    fn a_ray_goes_through_what_its_pixel_shows() {
        let stereo = View { stereo: Some(Stereo { separation: 0.1, focal_length: 1.5 }), ..view() };
        let orthographic = View { projection: Projection::Orthographic(2.0), ..view() };
        for view in [view(), stereo, orthographic] {
            for eye in view.eyes(640, 480) {
                let point = Point3::new(-0.4, 0.2, 0.1);
                let (x, y) = pixel(&eye, point);
                let ray = view.ray(640, 480, x, y);
                assert_eq!(eye.camera_matrix().is_none(), eye.is_orthographic);
                let off = (point - ray.origin).cross(&ray.direction).norm();
                assert!(off < 1e-9, "{view:?}: {off}");
            }
        }
    }

    #[test]
    fn both_eyes_see_the_focal_point_in_the_middle() {
        let view = View { stereo: Some(Stereo { separation: 0.1, focal_length: 1.5 }), ..view() };
        let eyes = view.eyes(640, 480);
        let point = Point3::new(0.5, 0.0, 0.0);
        assert!((pixel(&eyes[0], point).0 - 160.0).abs() < 1e-9);
        assert!((pixel(&eyes[1], point).0 - 480.0).abs() < 1e-9);
        let nearer = Point3::new(1.0, 0.0, 0.0);
        assert!(pixel(&eyes[0], nearer).0 > 160.0, "what is nearer is seen crosswise");
    }

    #[test]
    fn intrinsics_project_as_a_pinhole() {
        let intrinsics = adf::Intrinsics { focal_lengths: (800.0, 810.0), principal_point: (300.0, 260.0), skew: 2.0 };
        let matrix = intrinsics_matrix(&intrinsics, 640.0, 480.0, 0.1, 10.0);
        let view = View { projection: Projection::Matrix { matrix, aspect: 640.0 / 480.0 }, ..view() };
        let (x, y) = pixel(&view.eyes(640, 480)[0], Point3::new(0.0, 0.3, -0.2));
        // In the frame of the picture (right, down, forward): (0.3, 0.2, 2).
        assert!((x - (800.0 * 0.15 + 2.0 * 0.1 + 300.0)).abs() < 1e-9, "{x}");
        assert!((y - (810.0 * 0.1 + 260.0)).abs() < 1e-9, "{y}");
        let found = view.eyes(640, 480)[0].camera_matrix().expect("a pinhole");
        assert!(
            (found - nalgebra::Matrix3::new(800.0, 2.0, 300.0, 0.0, 810.0, 260.0, 0.0, 0.0, 1.0)).norm() < 1e-9,
            "{found}"
        );
    }
}
