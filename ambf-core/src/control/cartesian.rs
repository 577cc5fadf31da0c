use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

use crate::adf::{self, Controller, ControllerOutput};

/// Intervals below this have no derivative, s.
const MIN_DT: f64 = 1e-5;

/// What a [`CartesianController`] wants applied to a body, world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CartesianOutput {
    /// Force (N) at the centre of mass and torque (N·m).
    Wrench(Vector3<f64>, Vector3<f64>),
    /// Linear (m/s) and angular (rad/s) velocity.
    Velocity(Vector3<f64>, Vector3<f64>),
}

/// Position (m, world axes) and rotation vector (rad, body axes) from a pose to the wanted one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CartesianError {
    /// Difference of positions.
    pub linear: Vector3<f64>,
    /// Axis times angle of the remaining rotation; the angle is in [0, 2π].
    pub angular: Vector3<f64>,
}

impl CartesianError {
    /// From `pose` to `target`, both body frames in the world.
    pub fn between(pose: &Isometry3<f64>, target: &Isometry3<f64>) -> Self {
        // By way of the matrix, whose conversion fixes the sign of the quaternion and with it the way round.
        let rest = (pose.rotation.inverse() * target.rotation).to_rotation_matrix();
        let q = UnitQuaternion::from_rotation_matrix(&rest).into_inner();
        let sine_squared = 1.0 - q.w * q.w;
        let axis = if sine_squared < 10.0 * f64::EPSILON { Vector3::x() } else { q.imag() / sine_squared.sqrt() };
        Self {
            linear: target.translation.vector - pose.translation.vector,
            angular: axis * (2.0 * q.w.clamp(-1.0, 1.0).acos()),
        }
    }
}

/// Makes a rotation of a quaternion `[x, y, z, w]` as a client may send it: of any length, even zero. With a norm below
/// 0.1 `w` counts as 1. The flag says whether the norm was outside [0.9, 1.1].
pub fn orientation_of(raw: &[f64; 4]) -> (UnitQuaternion<f64>, bool) {
    let [x, y, z, w] = *raw;
    let q = Quaternion::new(w, x, y, z);
    let norm = q.norm();
    let q = if norm < 0.1 { Quaternion::new(1.0, x, y, z) } else { q };
    (UnitQuaternion::from_quaternion(q), !(0.9..=1.1).contains(&norm))
}

/// Proportional-derivative controller of a body's pose in the legacy profile. I gains are stored and not used.
///
/// `u_lin = P·e + D·Δe/dt` in world axes, `u_ang = R·(P·φ + D·Δφ/dt)` with the rotation vector φ in body axes. The
/// output type of the linear part decides for both.
#[derive(Debug, Clone)]
pub struct CartesianController {
    linear: Controller,
    angular: Controller,
    previous: CartesianError,
}

impl CartesianController {
    /// A controller without memory.
    ///
    /// With the default gains and velocity output the D part makes a dead-beat loop that diverges: it is left out.
    pub fn new(linear: Controller, angular: Controller) -> Self {
        let damped = |mut part: Controller| {
            if part == Controller::default() && part.output != ControllerOutput::Force {
                part.gains.d = 0.0;
            }
            part
        };
        Self { linear: damped(linear), angular: damped(angular), previous: CartesianError::default() }
    }

    /// Output that brings the body frame from `pose` to `target`. `dt` is the interval before, s.
    pub fn update(&mut self, pose: &Isometry3<f64>, target: &Isometry3<f64>, dt: f64) -> CartesianOutput {
        let error = CartesianError::between(pose, target);
        let rate = if dt < MIN_DT { 0.0 } else { 1.0 / dt };
        let linear =
            error.linear * self.linear.gains.p + (error.linear - self.previous.linear) * (self.linear.gains.d * rate);
        let angular = error.angular * self.angular.gains.p
            + (error.angular - self.previous.angular) * (self.angular.gains.d * rate);
        self.previous = error;
        let angular = pose.rotation * angular;
        match self.linear.output {
            ControllerOutput::Force => CartesianOutput::Wrench(linear, angular),
            ControllerOutput::Velocity | ControllerOutput::Position => CartesianOutput::Velocity(linear, angular),
        }
    }

    /// Gains and outputs in use.
    pub fn settings(&self) -> adf::CartesianController {
        adf::CartesianController { linear: self.linear, angular: self.angular }
    }

    /// Uses other gains, linear and angular, from now on; what it remembers stays.
    pub fn set_gains(&mut self, [linear, angular]: [adf::Gains; 2]) {
        (self.linear.gains, self.angular.gains) = (linear, angular);
    }

    /// Forgets everything, as at the start.
    pub fn reset(&mut self) {
        self.previous = CartesianError::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adf::Gains;
    use std::f64::consts::PI;

    fn force(p: f64, d: f64) -> Controller {
        Controller { gains: Gains { p, i: 0.0, d }, output: ControllerOutput::Force }
    }

    #[test]
    fn force_output_has_spring_damper_and_kick() {
        let mut controller = CartesianController::new(force(100.0, 2.0), force(10.0, 1.0));
        let target = Isometry3::translation(0.1, 0.0, 0.0);
        let CartesianOutput::Wrench(f, t) = controller.update(&Isometry3::identity(), &target, 0.001) else {
            panic!("force output")
        };
        assert!((f.x - (10.0 + 2.0 * 0.1 / 0.001)).abs() < 1e-9 && t.norm() == 0.0);
        let CartesianOutput::Wrench(f, _) = controller.update(&Isometry3::identity(), &target, 0.001) else {
            panic!("force output")
        };
        assert!((f.x - 10.0).abs() < 1e-12);
    }

    #[test]
    fn the_default_controller_is_proportional_velocity() {
        let mut controller = CartesianController::new(Controller::default(), Controller::default());
        let target = Isometry3::rotation(Vector3::z() * 0.2);
        let output = controller.update(&Isometry3::identity(), &target, 0.001);
        let CartesianOutput::Velocity(v, w) = output else { panic!("velocity output") };
        assert!(v.norm() == 0.0 && (w - Vector3::z() * 2.0).norm() < 1e-12, "{w}");
    }

    #[test]
    fn rotation_errors_are_in_body_axes() {
        let pose = Isometry3::rotation(Vector3::x() * (PI / 2.0));
        let target = pose * Isometry3::rotation(Vector3::y() * 0.3);
        let error = CartesianError::between(&pose, &target);
        assert!((error.angular - Vector3::y() * 0.3).norm() < 1e-12);
    }

    #[test]
    fn any_quaternion_becomes_a_rotation() {
        assert_eq!(orientation_of(&[0.0; 4]), (UnitQuaternion::identity(), true));
        let (q, odd) = orientation_of(&[0.0, 0.0, 2.0, 0.0]);
        assert!(odd && (q.angle() - PI).abs() < 1e-12);
        assert!(!orientation_of(&[0.0, 0.0, 0.0, 1.0]).1);
    }
}
