//! Kinematics of a master, so that a fake arm's joints fit to its pose.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Isometry3, Matrix6, Rotation3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3, Vector6};

/// Joints of a master.
pub(crate) const JOINTS: usize = 7;

type Q = SVector<f64, JOINTS>;
type Jacobian = SMatrix<f64, 6, JOINTS>;

/// Standard Denavit-Hartenberg parameters: rotate about z by q + offset, translate along z by d and along x by a,
/// rotate about x by α.
struct Link {
    alpha: f64,
    a: f64,
    d: f64,
    offset: f64,
}

const fn link(alpha: f64, a: f64, d: f64, offset: f64) -> Link {
    Link { alpha, a, d, offset }
}

const LINKS: [Link; JOINTS] = [
    link(FRAC_PI_2, 0.0, 0.0, -FRAC_PI_2),
    link(0.0, 0.2794, 0.0, -FRAC_PI_2),
    link(-FRAC_PI_2, 0.3645, 0.0, FRAC_PI_2),
    link(FRAC_PI_2, 0.0, 0.1506, 0.0),
    link(-FRAC_PI_2, 0.0, 0.0, 0.0),
    link(FRAC_PI_2, 0.0, 0.0, -FRAC_PI_2),
    link(0.0, 0.0, 0.0, FRAC_PI_2),
];

/// Frames of the base and after each joint, in the base.
fn frames(q: &Q) -> [Isometry3<f64>; JOINTS + 1] {
    let mut frames = [Isometry3::identity(); JOINTS + 1];
    for (i, link) in LINKS.iter().enumerate() {
        let about_z = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), q[i] + link.offset);
        let about_x = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), link.alpha);
        let along = Isometry3::from_parts(Translation3::new(link.a, 0.0, link.d), about_x);
        frames[i + 1] = frames[i] * Isometry3::from_parts(Translation3::identity(), about_z) * along;
    }
    frames
}

/// Pose of the tip in the base.
pub(crate) fn forward(q: &Q) -> Isometry3<f64> {
    frames(q)[JOINTS]
}

/// Body Jacobian: linear, then angular velocity of the tip in its own frame.
pub(crate) fn body_jacobian(q: &Q) -> Jacobian {
    let frames = frames(q);
    let tip = frames[JOINTS];
    let to_tip: Rotation3<f64> = tip.rotation.inverse().to_rotation_matrix();
    let mut jacobian = Jacobian::zeros();
    for (i, frame) in frames[..JOINTS].iter().enumerate() {
        let axis = frame.rotation * Vector3::z();
        let lever = tip.translation.vector - frame.translation.vector;
        jacobian.fixed_view_mut::<3, 1>(0, i).copy_from(&(to_tip * axis.cross(&lever)));
        jacobian.fixed_view_mut::<3, 1>(3, i).copy_from(&(to_tip * axis));
    }
    jacobian
}

/// Joints of a fake master and where its base is.
pub(crate) struct Joints {
    q: Q,
    base: Isometry3<f64>,
    limits: [(f64, f64); JOINTS],
}

impl Joints {
    /// Joints in the middle of the workspace when the tip is at `rest`; those of a left or a right master.
    pub fn new(rest: &Isometry3<f64>, left: bool) -> Self {
        let side = |low: f64, high: f64| if left { (-high, -low) } else { (low, high) };
        let limits = [
            side(-1.134, 0.698),
            (if left { -0.262 } else { -0.314 }, 1.134),
            (-0.873, 0.611),
            side(-1.658, 3.578),
            (-1.658, 3.229),
            (-0.785, 0.785),
            (-8.378, 7.854),
        ];
        let q = Q::from([0.0, 0.4, 0.0, 0.0, FRAC_PI_2, 0.0, 0.0]);
        Self { q, base: rest * forward(&q).inverse(), limits }
    }

    /// Follows the tip as far as limits allow: a few steps of damped least squares.
    pub fn follow(&mut self, tip: &Isometry3<f64>) {
        let goal = self.base.inv_mul(tip);
        for _ in 0..3 {
            let now = forward(&self.q);
            let error = now.inv_mul(&goal);
            let mut step = Vector6::zeros();
            step.fixed_rows_mut::<3>(0).copy_from(&error.translation.vector.cap_magnitude(0.05));
            step.fixed_rows_mut::<3>(3).copy_from(&error.rotation.scaled_axis().cap_magnitude(PI / 8.0));
            let jacobian = body_jacobian(&self.q);
            let damped = jacobian * jacobian.transpose() + Matrix6::identity() * 1e-6;
            let Some(inverse) = damped.try_inverse() else { return };
            self.q += jacobian.transpose() * inverse * step;
            for (q, (low, high)) in self.q.iter_mut().zip(self.limits) {
                *q = q.clamp(low, high);
            }
        }
    }

    /// rad.
    pub fn positions(&self) -> &[f64] {
        self.q.as_slice()
    }

    /// 6 × 7 in columns.
    pub fn jacobian(&self) -> Vec<f64> {
        body_jacobian(&self.q).as_slice().to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_zero_the_links_are_where_the_table_has_them() {
        // Shoulder and elbow: 0.2794 m down, 0.3645 m out, and the platform 0.1506 m.
        let frames = frames(&Q::zeros());
        let upper = frames[2].translation.vector - frames[1].translation.vector;
        assert!((upper.norm() - 0.2794).abs() < 1e-12);
        let reach = frames[4].translation.vector - frames[2].translation.vector;
        assert!((reach.norm() - f64::hypot(0.3645, 0.1506)).abs() < 1e-12);
        assert_eq!(frames[7].translation, frames[4].translation, "the wrist's axes meet");
    }

    #[test]
    fn the_jacobian_is_the_derivative() {
        let q = Q::from([0.1, 0.3, -0.2, 0.4, 0.9, -0.3, 0.5]);
        let jacobian = body_jacobian(&q);
        for i in 0..JOINTS {
            let mut moved = q;
            moved[i] += 1e-6;
            let step = forward(&q).inv_mul(&forward(&moved));
            let linear = step.translation.vector / 1e-6 - jacobian.fixed_view::<3, 1>(0, i);
            let angular = step.rotation.scaled_axis() / 1e-6 - jacobian.fixed_view::<3, 1>(3, i);
            assert!(linear.norm() < 1e-5 && angular.norm() < 1e-5, "joint {}", i + 1);
        }
    }

    #[test]
    fn joints_follow_the_tip() {
        let rest = Isometry3::translation(-0.18, -0.016, -0.262);
        let mut joints = Joints::new(&rest, false);
        for i in 0..200 {
            let t = f64::from(i) * 1e-2;
            let tip = Isometry3::translation(0.03 * t.sin(), 0.02 * t, 0.03 * t.cos() - 0.03) * rest;
            joints.follow(&tip);
            let got = joints.base * forward(&joints.q);
            let error = got.inv_mul(&tip);
            assert!(error.translation.vector.norm() < 1e-3 && error.rotation.angle() < 1e-2, "at {t}: {error}");
        }
    }
}
