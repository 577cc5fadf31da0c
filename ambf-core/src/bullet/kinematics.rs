use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion};

/// Motion of one body as Bullet gives it: pose of the inertial frame from the motion state, velocities from the body.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C)]
pub struct BodyKinematics {
    /// Position of the inertial frame in the world, m. Interpolated: up to one sub-step old.
    pub origin: [f64; 3],
    /// Rotation matrix of the inertial frame in the world, row by row. Interpolated like [`origin`](Self::origin).
    pub basis: [f64; 9],
    /// Velocity of the centre of mass, m/s, world axes. Not interpolated.
    pub linear_velocity: [f64; 3],
    /// Angular velocity, rad/s, world axes. Not interpolated.
    pub angular_velocity: [f64; 3],
}

impl Default for BodyKinematics {
    fn default() -> Self {
        Self {
            origin: [0.0; 3],
            basis: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            linear_velocity: [0.0; 3],
            angular_velocity: [0.0; 3],
        }
    }
}

impl BodyKinematics {
    /// Pose of the inertial frame in the world.
    pub fn inertial_pose(&self) -> Isometry3<f64> {
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_row_slice(&self.basis));
        Isometry3::from_parts(Translation3::from(self.origin), UnitQuaternion::from_rotation_matrix(&rotation))
    }

    /// Pose of the body frame in the world, with the inverse of the body's inertial offset.
    pub fn body_pose(&self, inertial_offset_inverse: &Isometry3<f64>) -> Isometry3<f64> {
        self.inertial_pose() * inertial_offset_inverse
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn a_body_pose_undoes_the_inertial_offset() {
        let offset = Isometry3::translation(0.0, 0.0, 0.5);
        let state = BodyKinematics { origin: [1.0, 2.0, 3.5], ..Default::default() };
        let pose = state.body_pose(&offset.inverse());
        assert!((pose.translation.vector - Vector3::new(1.0, 2.0, 3.0)).norm() < 1e-15);
    }
}
