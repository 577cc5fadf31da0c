use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// Displacement per velocity of the device and time.
const GAIN: f64 = 10.0;

/// How a device moves its cameras.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraMotion {
    /// Displacement in the axes of each camera, m.
    pub displacement: Vector3<f64>,
    /// New orientation of each camera.
    pub rotation: UnitQuaternion<f64>,
}

impl CameraMotion {
    /// Pose of a camera after the motion.
    pub fn applied(&self, camera: &Isometry3<f64>) -> Isometry3<f64> {
        let position = camera.translation.vector + camera.rotation * self.displacement;
        Isometry3::from_parts(position.into(), self.rotation)
    }
}

/// The camera button: `p_cam += 10·dt·R_cam·v_h`, `R_cam = R_cam,pre·R_pre_hᵀ·R_h`.
#[derive(Debug, Clone, Default)]
pub(super) struct CameraMover {
    /// `R_cam,pre` of the first camera and `R_pre_h`, of the last tick in which the button was up.
    before: Option<(UnitQuaternion<f64>, UnitQuaternion<f64>)>,
}

impl CameraMover {
    /// One tick; `camera`: rotation of the first camera, `None` without cameras. `velocity`: of the hand, device axes,
    /// m/s.
    pub(super) fn update(
        &mut self,
        pressed: bool,
        camera: Option<UnitQuaternion<f64>>,
        hand: UnitQuaternion<f64>,
        velocity: Vector3<f64>,
        dt: f64,
    ) -> Option<CameraMotion> {
        let camera = camera?;
        let (camera_before, hand_before) = match (pressed, self.before) {
            (true, Some(before)) => before,
            _ => {
                self.before = Some((camera, hand));
                if !pressed {
                    return None;
                }
                (camera, hand)
            }
        };
        let rotation = camera_before * hand_before.inverse() * hand;
        let displacement = velocity * (GAIN * dt);
        let rotation = UnitQuaternion::new_normalize(rotation.into_inner());
        let finite = displacement.iter().chain(rotation.coords.iter()).all(|x| x.is_finite());
        finite.then_some(CameraMotion { displacement, rotation })
    }

    /// The hand is not known: a press goes on from the pose in which it is back.
    pub(super) fn interrupt(&mut self) {
        self.before = None;
    }
}

#[cfg(test)]
mod tests {
    use super::super::random::Random;
    use super::*;

    #[test]
    fn a_press_moves_and_turns_from_where_it_began() {
        let mut random = Random::new(7);
        for _ in 0..200 {
            let (camera, hand, now, v) = (random.rotation(), random.rotation(), random.rotation(), random.vector());
            let mut mover = CameraMover::default();
            assert_eq!(mover.update(false, Some(camera), hand, v, 1e-3), None);
            // The camera has followed in the meantime: that changes nothing.
            for seen in [camera, random.rotation()] {
                let motion = mover.update(true, Some(seen), now, v, 1e-3).expect("a motion");
                assert!((motion.displacement - v * 0.01).norm() < 1e-12);
                assert!(motion.rotation.angle_to(&(camera * hand.inverse() * now)) < 1e-7);
            }
        }
    }

    #[test]
    fn without_cameras_and_after_an_interruption_nothing_jumps() {
        let mut mover = CameraMover::default();
        let hand = UnitQuaternion::new(Vector3::x());
        assert_eq!(mover.update(true, None, hand, Vector3::x(), 1e-3), None);
        let camera = UnitQuaternion::new(Vector3::y());
        let motion = mover.update(true, Some(camera), hand, Vector3::zeros(), 1e-3).expect("a motion");
        assert!(motion.rotation.angle_to(&camera) < 1e-7);
        mover.interrupt();
        let turned = UnitQuaternion::new(Vector3::z());
        let motion = mover.update(true, Some(camera), turned, Vector3::zeros(), 1e-3).expect("a motion");
        assert!(motion.rotation.angle_to(&camera) < 1e-7);
    }

    #[test]
    fn displacements_are_in_the_axes_of_each_camera() {
        let camera = Isometry3::new(Vector3::new(1.0, 0.0, 0.0), Vector3::z() * std::f64::consts::FRAC_PI_2);
        let motion = CameraMotion { displacement: Vector3::x(), rotation: UnitQuaternion::identity() };
        let moved = motion.applied(&camera);
        assert!((moved.translation.vector - Vector3::new(1.0, 1.0, 0.0)).norm() < 1e-12);
        assert_eq!(moved.rotation, UnitQuaternion::identity());
    }
}
