//! Cameras and lights: objects with a pose and parameters, without physics.

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::{Identity, NameMap};
use crate::adf;
use crate::comm::{CameraParameters, Command, LightParameters, PoseCommand};
use crate::control::orientation_of;

/// What cameras and lights share.
#[derive(Debug, Clone)]
pub struct Placed {
    /// Names and publishing rates.
    pub identity: Identity,
    /// Index of the parent body; `None`: the world.
    pub parent: Option<usize>,
    /// Pose in the parent's body frame.
    pub pose: Isometry3<f64>,
    /// Pose that a reset returns to.
    pub initial_pose: Isometry3<f64>,
}

impl Placed {
    pub(super) fn new(identity: Identity, pose: Isometry3<f64>) -> Self {
        Self { identity, parent: None, pose, initial_pose: pose }
    }

    fn set_parent(&mut self, text: &str, bodies: &NameMap) {
        if !text.is_empty() {
            self.parent = bodies.find(text).index().or(self.parent);
        }
    }

    pub(crate) fn apply_command(&mut self, command: &PoseCommand) {
        if command.enabled {
            self.pose = Isometry3::from_parts(command.position.into(), orientation_of(&command.orientation).0);
        }
    }
}

/// A camera. It looks along its −x axis; +y is right in the picture, +z up.
#[derive(Debug, Clone)]
pub struct Camera {
    /// Names and pose.
    pub placed: Placed,
    /// What clients may change.
    pub parameters: CameraParameters,
}

/// A spot light. It shines along its +x axis.
#[derive(Debug, Clone)]
pub struct Light {
    /// Names and pose.
    pub placed: Placed,
    /// What clients may change.
    pub parameters: LightParameters,
}

impl Camera {
    /// Takes over what a client changed. A parent that is not found, or an empty text, leaves the parent as it is.
    pub(crate) fn set_parameters(&mut self, parameters: &CameraParameters, bodies: &NameMap) {
        self.parameters.copy_from(parameters);
        self.placed.set_parent(&parameters.parent_name, bodies);
    }
}

impl Light {
    /// Takes over what a client changed. A parent that is not found, or an empty text, leaves the parent as it is.
    pub(crate) fn set_parameters(&mut self, parameters: &LightParameters, bodies: &NameMap) {
        self.parameters.copy_from(parameters);
        self.placed.set_parent(&parameters.parent_name, bodies);
    }
}

pub(super) fn camera_parameters(camera: &adf::Camera) -> CameraParameters {
    CameraParameters {
        near_plane: camera.clipping_plane.0,
        far_plane: camera.clipping_plane.1,
        field_view_angle: camera.field_view_angle,
        orthographic_view_width: camera.orthographic_view_width.unwrap_or(0.0),
        stereo_eye_separation: camera.stereo.as_ref().map_or(0.2, |stereo| stereo.eye_separation),
        stereo_focal_length: camera.stereo.as_ref().map_or(0.5, |stereo| stereo.focal_length),
        orthographic: camera.orthographic_view_width.is_some(),
        stereo: camera.stereo.is_some(),
        parent_name: camera.parent.clone(),
    }
}

/// Pose of a camera at `location` that looks at `look_at`; identity when the three vectors span no view.
pub(super) fn camera_pose(location: &Vector3<f64>, look_at: &Vector3<f64>, up: &Vector3<f64>) -> Isometry3<f64> {
    let view = || {
        let x = (location - look_at).try_normalize(1e-12)?;
        let y = up.cross(&x).try_normalize(1e-12)?;
        Some(Matrix3::from_columns(&[x, y, x.cross(&y)]))
    };
    match view() {
        Some(columns) => Isometry3::from_parts((*location).into(), rotation(columns)),
        None => Isometry3::identity(),
    }
}

/// Rotation that turns +x to `direction`: the other axes are chosen with z, or y where that is further from `direction`.
pub(super) fn light_rotation(direction: &Vector3<f64>) -> Option<UnitQuaternion<f64>> {
    let x = (direction.norm_squared() >= 1e-4).then(|| direction.normalize())?;
    let (z_sine, y_sine) = (x.cross(&Vector3::z()).norm(), x.cross(&Vector3::y()).norm());
    let other = if z_sine > y_sine { Vector3::z() } else { Vector3::y() };
    let y = x.cross(&other).normalize();
    Some(rotation(Matrix3::from_columns(&[x, y, x.cross(&y).normalize()])))
}

fn rotation(columns: Matrix3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(columns))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_looks_along_minus_x_with_z_up() {
        let pose = camera_pose(&Vector3::new(3.0, 0.0, 1.0), &Vector3::new(0.0, 0.0, 1.0), &Vector3::z());
        assert!((pose.rotation * -Vector3::x() - -Vector3::x()).norm() < 1e-12);
        assert!((pose.rotation * Vector3::z() - Vector3::z()).norm() < 1e-12);
        let above = camera_pose(&Vector3::z(), &Vector3::zeros(), &Vector3::z());
        assert_eq!(above, Isometry3::identity(), "up along the view");
    }

    #[test]
    fn a_light_shines_along_x_in_any_direction() {
        for direction in [-Vector3::z(), Vector3::y() * 3.0, Vector3::new(1.0, -2.0, 0.5)] {
            let turned = light_rotation(&direction).unwrap() * Vector3::x();
            assert!((turned - direction.normalize()).norm() < 1e-12);
        }
        assert!(light_rotation(&Vector3::zeros()).is_none());
    }
}
