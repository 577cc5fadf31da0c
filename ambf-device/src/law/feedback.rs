use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::controls::{GainChange, Quantity};
use super::rotation::rotation_vector;
use crate::{DeviceForce, DeviceSpec};
use ambf_model::adf;

/// How long the force takes to come back after it was off, s.
const RETURN: f64 = 1.0;

/// What a user feels of an end-effector: the force that pulls the hand to where the root link is.
///
/// `F = −r_l·P_lin·(x_s − x_g)`, `T = −r_a·R_g·P_ang·log(R_gᵀ·R_s)`, turned into the device frame by `R_cᵀ`.
#[derive(Debug, Clone)]
pub(super) struct Feedback {
    linear: f64,
    angular: f64,
    /// Largest gains that the device renders stably.
    max_linear: f64,
    max_angular: f64,
    deadband: f64,
    max_force: f64,
    max_torque: f64,
    /// `r_l`, `r_a`.
    ramps: [f64; 2],
    /// Caps both ramps after the force was off.
    back: f64,
}

impl Feedback {
    pub(super) fn new(device: &adf::InputDevice, spec: &DeviceSpec) -> Self {
        let gain = device.haptic_gain.unwrap_or(adf::HapticGain { linear: 0.0, angular: 0.0 });
        let mut feedback = Self {
            linear: gain.linear,
            angular: gain.angular,
            max_linear: limit(spec.max_stiffness / device.workspace_scaling),
            max_angular: limit(spec.max_angular_stiffness),
            deadband: device.deadband,
            max_force: limit(device.max_force.map_or(spec.max_force, |max| max.min(spec.max_force))),
            max_torque: limit(spec.max_torque),
            ramps: [0.0; 2],
            back: 0.0,
        };
        feedback.limit_gains();
        feedback
    }

    fn limit_gains(&mut self) {
        self.linear = limit(self.linear).min(self.max_linear);
        self.angular = limit(self.angular).min(self.max_angular);
    }

    /// Changes a gain if it is one of the device; the value after it.
    pub(super) fn change(&mut self, change: GainChange) -> Option<f64> {
        let gain = match change.quantity {
            Quantity::DeviceLinearGain => &mut self.linear,
            Quantity::DeviceAngularGain => &mut self.angular,
            _ => return None,
        };
        *gain = change.applied(*gain);
        self.limit_gains();
        Some(if change.quantity == Quantity::DeviceLinearGain { self.linear } else { self.angular })
    }

    /// Gains in use: N/m and N·m/rad.
    pub(super) fn gains(&self) -> (f64, f64) {
        (self.linear, self.angular)
    }

    /// The force is off and will come back from zero.
    pub(super) fn silence(&mut self) {
        self.back = 0.0;
    }

    /// One tick: the force for the reference and the pose of the root link, both in the world. `clutch`: no force as
    /// long as it is pressed.
    pub(super) fn update(
        &mut self,
        reference: &Isometry3<f64>,
        root: &Isometry3<f64>,
        camera: &UnitQuaternion<f64>,
        clutch: bool,
        dt: f64,
    ) -> DeviceForce {
        let [linear, angular] = self.ramps.map(|ramp| ramp.min(self.back));
        self.advance(dt);
        self.back = (self.back + dt / RETURN).min(1.0);
        if clutch {
            return DeviceForce::zero();
        }
        let error = reference.translation.vector - root.translation.vector;
        let turn = root.rotation * rotation_vector(&(root.rotation.inverse() * reference.rotation));
        let force = camera.inverse() * (error * -(linear * self.linear));
        let torque = camera.inverse() * (turn * -(angular * self.angular));
        let force = DeviceForce {
            force: bounded(force, self.deadband, self.max_force),
            torque: bounded(torque, self.deadband, self.max_torque),
            gripper: 0.0,
        };
        if force.is_finite() {
            force
        } else {
            self.silence();
            DeviceForce::zero()
        }
    }

    /// `r += 0.1·dt·P` until 1.
    pub(super) fn advance(&mut self, dt: f64) {
        for (ramp, gain) in self.ramps.iter_mut().zip([self.linear, self.angular]) {
            *ramp = (*ramp + 0.1 * dt * gain).min(1.0);
        }
    }
}

/// A limit that is none, or negative, is 0.
fn limit(value: f64) -> f64 {
    value.max(0.0)
}

/// Zero below the dead band, shortened to `max` above it.
fn bounded(vector: Vector3<f64>, deadband: f64, max: f64) -> Vector3<f64> {
    let length = vector.norm();
    if length < deadband {
        Vector3::zeros()
    } else if length > max {
        vector * (max / length)
    } else {
        vector
    }
}
