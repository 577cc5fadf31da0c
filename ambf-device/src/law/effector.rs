use nalgebra::{Isometry3, Vector3};

use super::controls::{GainChange, Quantity};
use super::gripper::Grip;
use super::rotation::{rotation_vector, rotation_vector_change};
use ambf_model::adf::{self, CartesianController, Controller, ControllerOutput};

/// Steps below this have no derivative, s.
const MIN_DT: f64 = 1e-5;
/// The ramps rise by this each second.
const RAMP: f64 = 0.5;

/// What one half of the root link's controller wants, world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drive {
    /// Apply: force at the centre of mass in N, or torque in N·m.
    Force(Vector3<f64>),
    /// Set: velocity in m/s, or angular velocity in rad/s.
    Velocity(Vector3<f64>),
}

/// What an end-effector is to follow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EffectorInput {
    /// Newest reference pose of its device, world.
    pub reference: Isometry3<f64>,
    /// Body frame of the root link in the world, from its motion state.
    pub pose: Isometry3<f64>,
    /// Opening of the gripper, 0…1.
    pub gripper: f64,
    /// The step that is about to be made, s.
    pub dt: f64,
    /// Nominal period of the physics loop, s; for `time scaled gain`.
    pub nominal_dt: f64,
    /// Whether the active control type of the root link is *force*: otherwise a client drives it and the device does
    /// not.
    pub force_active: bool,
    /// Whether the gripping assist is on.
    pub gripping_assist: bool,
}

/// What is to be done with an end-effector in this step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EffectorOutput {
    /// Translation of the root link; `None`: leave it alone.
    pub linear: Option<Drive>,
    /// Rotation of the root link; `None`: leave it alone.
    pub angular: Option<Drive>,
    /// Opening that all joints below the root link are commanded to, see [`joint_target`](super::joint_target); `None`:
    /// joint control is off.
    pub joints: Option<f64>,
    /// Gripping assist.
    pub grip: Grip,
}

/// The physics side of a device: what drives the root link of its end-effector. One per device; nothing here allocates
/// or waits.
///
/// `u_l = r·(P_lin·ts·e + D_lin·Δe/dt)` with `e = x_s − x_g`; `u_a = r·R_g·(P_ang·ts·q + D_ang·Δq/dt)` with `q =
/// log(R_gᵀ·R_s)`. The ramp `r` rises from 0 to 1 in 2 s. `ts` is 1, or with `time scaled gain` the ratio of nominal to
/// real step, at most 1. Each half honours its own output type. A velocity output has no D part: with it the loop
/// diverges. I gains are not used. The derivative is zero in the first step, after a reset and after steps in which the
/// controller was not active.
#[derive(Debug, Clone)]
pub struct EndEffector {
    linear: Controller,
    angular: Controller,
    time_scaled: bool,
    joint_control: bool,
    ramp: f64,
    previous: Option<(Vector3<f64>, Vector3<f64>)>,
}

impl EndEffector {
    /// `root`: the root link's own controller, which `controller gain` of the device replaces.
    pub fn new(device: &adf::InputDevice, root: &CartesianController) -> Self {
        let controller = device.controller_gain.unwrap_or(*root);
        Self {
            linear: controller.linear,
            angular: controller.angular,
            time_scaled: device.time_scaled_gain,
            joint_control: device.enable_joint_control,
            ramp: 0.0,
            previous: None,
        }
    }

    /// To be called once before each step of the world, and not while no step will be made: forces would pile up.
    pub fn tick(&mut self, input: &EffectorInput) -> EffectorOutput {
        let gripper = if input.gripper.is_finite() { input.gripper.clamp(0.0, 1.0) } else { 0.5 };
        let mut output = EffectorOutput {
            linear: None,
            angular: None,
            joints: self.joint_control.then_some(gripper),
            grip: Grip::of(gripper, input.gripping_assist),
        };
        let dt = if input.dt.is_finite() { input.dt.max(0.0) } else { 0.0 };
        let ramp = self.ramp;
        self.ramp = (ramp + RAMP * dt).min(1.0);
        let finite = |pose: &Isometry3<f64>| {
            pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|x| x.is_finite())
        };
        if !input.force_active || !finite(&input.reference) || !finite(&input.pose) {
            self.previous = None;
            return output;
        }
        let linear = input.reference.translation.vector - input.pose.translation.vector;
        let angular = rotation_vector(&(input.pose.rotation.inverse() * input.reference.rotation));
        let changes = match self.previous {
            Some((e, q)) if dt >= MIN_DT => ((linear - e) / dt, rotation_vector_change(&q, &angular) / dt),
            _ => (Vector3::zeros(), Vector3::zeros()),
        };
        self.previous = Some((linear, angular));
        let scale = if self.time_scaled && input.nominal_dt > 0.0 && dt > input.nominal_dt {
            input.nominal_dt / dt
        } else {
            1.0
        };
        let drive = |part: &Controller, error: Vector3<f64>, change: Vector3<f64>| {
            let proportional = error * (part.gains.p * scale);
            let drive = match part.output {
                ControllerOutput::Force => proportional + change * part.gains.d,
                ControllerOutput::Velocity | ControllerOutput::Position => proportional,
            };
            drive * ramp
        };
        let forces = [(self.linear, linear, changes.0), (self.angular, angular, changes.1)];
        let [u_l, u_a] = forces.map(|(part, error, change)| drive(&part, error, change));
        let as_output = |part: &Controller, u: Vector3<f64>| {
            let drive = match part.output {
                ControllerOutput::Force => Drive::Force(u),
                ControllerOutput::Velocity | ControllerOutput::Position => Drive::Velocity(u),
            };
            u.iter().all(|x| x.is_finite()).then_some(drive)
        };
        output.linear = as_output(&self.linear, u_l);
        output.angular = as_output(&self.angular, input.pose.rotation * u_a);
        output
    }

    /// The world was reset: all starts anew, the ramp too, so that what the device refers to may arrive a few steps
    /// later.
    pub fn reset(&mut self) {
        self.previous = None;
        self.ramp = 0.0;
    }

    /// Changes a gain if it is one of end-effectors; the value after it.
    pub fn change(&mut self, change: GainChange) -> Option<f64> {
        let gain = match change.quantity {
            Quantity::EffectorLinearGain => &mut self.linear.gains.p,
            Quantity::EffectorAngularGain => &mut self.angular.gains.p,
            Quantity::EffectorLinearDamping => &mut self.linear.gains.d,
            Quantity::EffectorAngularDamping => &mut self.angular.gains.d,
            Quantity::DeviceLinearGain | Quantity::DeviceAngularGain => return None,
        };
        *gain = change.applied(*gain);
        Some(*gain)
    }
}
