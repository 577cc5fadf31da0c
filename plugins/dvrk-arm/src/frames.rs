//! From the frames of an arm to those of a device.
//!
//! The arm reports the pose of its tip in its reference frame (for a master: the stereo viewer). What a device reports
//! is `T_ee = T_o⁻¹ · T_m · T_t` with the origin `T_o` in the reference frame and an offset `T_t` of the tip; commands
//! go the other way, `T_cmd = T_o · T · T_t⁻¹`. Wrenches are only rotated: `F_cmd = R_o · F`.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Force and torque.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Wrench {
    /// N.
    pub force: Vector3<f64>,
    /// N·m.
    pub torque: Vector3<f64>,
}

impl Wrench {
    /// None.
    pub fn zero() -> Self {
        Self::default()
    }

    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        self.force.iter().chain(self.torque.iter()).all(|x| x.is_finite())
    }

    /// The same in a frame that is rotated.
    pub(crate) fn rotated(&self, rotation: &UnitQuaternion<f64>) -> Self {
        Self { force: rotation * self.force, torque: rotation * self.torque }
    }
}

/// Yaw of the origin of masters, rad, as the original has it: 6e-6 less than a right angle.
#[allow(clippy::approx_constant)]
const YAW: f64 = 1.57079;

/// Origin and tip offset of an arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frames {
    /// `T_o`, m, in the arm's reference frame.
    pub origin: Isometry3<f64>,
    /// `T_t`, m, in the frame of the tip.
    pub tip: Isometry3<f64>,
}

impl Frames {
    /// Those of the original for the arm of that name: constants for names that begin with `MTML` or `MTMR`, identities
    /// for all others.
    pub fn of(arm: &str) -> Self {
        let x = match arm.get(..4) {
            Some("MTMR") => -0.181_025,
            Some("MTML") => 0.181_025,
            _ => return Self { origin: Isometry3::identity(), tip: Isometry3::identity() },
        };
        Self {
            origin: isometry([x, -0.0163, -0.2620, 0.0, 0.0, -YAW]),
            tip: isometry([0.0, 0.0, 0.0, 0.0, std::f64::consts::FRAC_PI_2, 0.0]),
        }
    }

    /// Device pose of a pose that the arm reports.
    pub fn to_device(&self, measured: &Isometry3<f64>) -> Isometry3<f64> {
        self.origin.inv_mul(&(measured * self.tip))
    }

    /// What to tell the arm so that the device pose becomes `pose`.
    pub fn to_arm(&self, pose: &Isometry3<f64>) -> Isometry3<f64> {
        self.origin * pose * self.tip.inverse()
    }

    /// What to tell the arm so that `wrench` is felt in the device frame.
    pub fn wrench_to_arm(&self, wrench: &Wrench) -> Wrench {
        wrench.rotated(&self.origin.rotation)
    }

    /// A wrench that the arm reports, in the device frame.
    pub fn wrench_to_device(&self, wrench: &Wrench) -> Wrench {
        wrench.rotated(&self.origin.rotation.inverse())
    }
}

/// Position, m, and roll, pitch and yaw about fixed axes, rad: `R = Rz(y)·Ry(p)·Rx(r)`.
pub fn isometry([x, y, z, roll, pitch, yaw]: [f64; 6]) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(roll, pitch, yaw))
}

/// Whether all numbers are finite.
pub(crate) fn is_finite(pose: &Isometry3<f64>) -> bool {
    pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|x| x.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_master_at_its_origin_is_at_zero() {
        for (arm, x) in [("MTMR", -0.181025), ("MTML", 0.181025)] {
            let at = isometry([x, -0.0163, -0.2620, 0.0, 0.0, 0.0]);
            assert_eq!(Frames::of(arm).to_device(&at).translation.vector.norm(), 0.0, "{arm}");
        }
    }

    #[test]
    fn x_is_towards_the_user_y_to_the_right_z_up() {
        // Device position (−d_y, d_x, d_z), apart from the 6e-6 rad of the constant.
        for (arm, x) in [("MTMR", -0.181025), ("MTML1", 0.181025)] {
            let at = isometry([x + 0.01, -0.0163 + 0.02, -0.2620 + 0.03, 0.3, -0.2, 0.1]);
            let p = Frames::of(arm).to_device(&at).translation.vector;
            assert!((p - Vector3::new(-0.02, 0.01, 0.03)).norm() < 3e-7, "{arm}: {p}");
            let exact = 6.326_794_9e-6;
            assert!(
                (p.x - (-0.02 * f64::cos(exact) + 0.01 * f64::sin(exact))).abs() < 1e-9,
                "as written, not rounded: {p}"
            );
        }
    }

    #[test]
    fn rotations_are_those_of_the_formula() {
        let frames = Frames::of("MTML");
        let measured = isometry([0.1, 0.2, 0.3, 3.058663, -1.055021, -1.500306]);
        // Rz(yaw) · R_m · Ry(π/2), by matrices.
        let expected = nalgebra::Rotation3::from_euler_angles(0.0, 0.0, YAW)
            * nalgebra::Rotation3::from_euler_angles(3.058663, -1.055021, -1.500306)
            * nalgebra::Rotation3::from_euler_angles(0.0, std::f64::consts::FRAC_PI_2, 0.0);
        let got = frames.to_device(&measured).rotation.to_rotation_matrix();
        assert!((got.matrix() - expected.matrix()).norm() < 1e-12);
    }

    #[test]
    fn commands_are_the_inverse() {
        for arm in ["MTMR", "MTML", "PSM1"] {
            let frames = Frames::of(arm);
            let pose = isometry([0.01, -0.02, 0.03, 0.4, 0.5, 0.6]);
            let there = frames.to_arm(&pose);
            assert!((frames.to_device(&there).to_homogeneous() - pose.to_homogeneous()).norm() < 1e-12, "{arm}");
        }
        assert_eq!(
            Frames::of("PSM1").to_arm(&isometry([1.0, 2.0, 3.0, 0.0, 0.0, 0.0])).translation.vector,
            Vector3::new(1.0, 2.0, 3.0)
        );
    }

    #[test]
    fn wrenches_are_rotated_only() {
        let frames = Frames::of("MTMR");
        let wrench = Wrench { force: Vector3::new(1.0, 2.0, 3.0), torque: Vector3::new(0.1, 0.0, 0.0) };
        let sent = frames.wrench_to_arm(&wrench);
        // Rz(−90°): (x, y) → (y, −x).
        assert!((sent.force - Vector3::new(2.0, -1.0, 3.0)).norm() < 2e-5);
        assert!((frames.wrench_to_device(&sent).force - wrench.force).norm() < 1e-12);
        assert!((sent.torque - Vector3::new(0.0, -0.1, 0.0)).norm() < 1e-6);
    }
}
