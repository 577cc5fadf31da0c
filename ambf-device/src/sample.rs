use std::time::Instant;

use nalgebra::{UnitQuaternion, Vector3};

/// What a device measured at one moment. Its frame is right-handed: x out of the device towards the user, y to the
/// user's right, z up, the origin near the centre of the workspace.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DeviceSample {
    /// When it was measured.
    pub stamp: Instant,
    /// Counts what the device measured; the same number twice is the same measurement.
    pub sequence: u64,
    /// Tip, m.
    pub position: Vector3<f64>,
    /// Orientation of the tip; identity for devices that do not sense it.
    pub rotation: UnitQuaternion<f64>,
    /// m/s; `None`: it is estimated from positions.
    pub linear_velocity: Option<Vector3<f64>>,
    /// rad/s, in the device frame; `None`: it is estimated from rotations.
    pub angular_velocity: Option<Vector3<f64>>,
    /// 0 closed … 1 open; `None`: no gripper is sensed.
    pub gripper: Option<f64>,
    /// Pressed buttons, one bit each.
    pub buttons: u32,
    /// Whether the pose may be trusted: not before homing, not while the device is away. Where it may not, the
    /// end-effector holds still as if clutched and no force is sent.
    pub valid: bool,
}

impl DeviceSample {
    /// A sample of a device that has not measured anything yet.
    pub fn none(stamp: Instant) -> Self {
        Self {
            stamp,
            sequence: 0,
            position: Vector3::zeros(),
            rotation: UnitQuaternion::identity(),
            linear_velocity: None,
            angular_velocity: None,
            gripper: None,
            buttons: 0,
            valid: false,
        }
    }

    /// Whether button `index` is pressed; `false` beyond bit 31.
    pub fn is_pressed(&self, index: u32) -> bool {
        self.buttons.checked_shr(index).is_some_and(|bits| bits & 1 == 1)
    }

    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        let vectors = [Some(self.position), self.linear_velocity, self.angular_velocity];
        vectors.iter().flatten().all(|v| v.iter().all(|x| x.is_finite()))
            && self.rotation.coords.iter().all(|x| x.is_finite())
            && self.gripper.is_none_or(f64::is_finite)
    }
}

/// What a device should let its user feel, in the frame of [`DeviceSample`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DeviceForce {
    /// At the tip, N.
    pub force: Vector3<f64>,
    /// N·m.
    pub torque: Vector3<f64>,
    /// Opens the gripper, N.
    pub gripper: f64,
}

impl DeviceForce {
    /// No force at all.
    pub fn zero() -> Self {
        Self::default()
    }

    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        self.force.iter().chain(self.torque.iter()).all(|x| x.is_finite()) && self.gripper.is_finite()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buttons_beyond_the_mask_are_not_pressed() {
        let mut sample = DeviceSample::none(Instant::now());
        sample.buttons = 0x8000_0001;
        let pressed = [0, 1, 31, 32, u32::MAX].map(|index| sample.is_pressed(index));
        assert_eq!(pressed, [true, false, true, false, false]);
    }

    #[test]
    fn non_finite_numbers_are_seen_wherever_they_are() {
        let good = DeviceSample::none(Instant::now());
        assert!(good.is_finite());
        let mut bad = [good; 3];
        bad[0].position.y = f64::NAN;
        bad[1].angular_velocity = Some(Vector3::new(0.0, f64::INFINITY, 0.0));
        bad[2].gripper = Some(f64::NAN);
        assert!(bad.iter().all(|sample| !sample.is_finite()));
        assert!(!DeviceForce { gripper: f64::NAN, ..DeviceForce::zero() }.is_finite());
    }
}
