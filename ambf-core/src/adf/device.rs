//! Input devices files.

use std::path::PathBuf;

use nalgebra::{Isometry3, UnitQuaternion};

use super::common::SourcePos;
use super::controller::CartesianController;

/// An input device paired with a simulated end-effector, as written.
#[derive(Clone, Debug, PartialEq)]
pub struct InputDevice {
    /// Name of the entry.
    pub identifier: String,
    /// Model name that the device's driver reports.
    pub hardware_name: String,
    /// Proportional gains of the force feedback; `None`: 10 and 10 with derivative gains of 1.
    pub haptic_gain: Option<HapticGain>,
    /// Wrenches below it are zeroed, N. Default: 0.001.
    pub deadband: f64,
    /// As written, N; the device's rated maximum is used instead.
    pub max_force: Option<f64>,
    /// As written; without use.
    pub max_jerk: Option<f64>,
    /// Device metres to world metres; positive. Default: 1.
    pub workspace_scaling: f64,
    /// Offset of the tool's orientation. Default: identity.
    pub orientation_offset: UnitQuaternion<f64>,
    /// Buttons.
    pub button_mapping: ButtonMapping,
    /// Draw a sphere at the reference pose. Default: `false`.
    pub visible: bool,
    /// Size of the sphere. Default: 1.
    pub visible_size: f64,
    /// Model file of the simulated end-effector, joined to the file's directory when it was relative.
    pub simulated_multibody: Option<PathBuf>,
    /// Body to drive; `None`: the root body of the model.
    pub root_link: Option<String>,
    /// Initial pose of the root link's inertial frame in the world; `None`: the body's own.
    pub location: Option<Isometry3<f64>>,
    /// Replaces the root link's Cartesian controller.
    pub controller_gain: Option<CartesianController>,
    /// Gripper opening drives the joints. Default: `true`.
    pub enable_joint_control: bool,
    /// Names of cameras; motion is relative to the first. Empty: all cameras.
    pub pair_cameras: Vec<String>,
    /// Where the entry stands.
    pub source: SourcePos,
}

/// Proportional gains of the force feedback controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HapticGain {
    /// N/m.
    pub linear: f64,
    /// N·m/rad.
    pub angular: f64,
}

/// Button numbers, counted from 0; `None`: no such button (absent or negative).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ButtonMapping {
    /// Clutch.
    pub a1: Option<u32>,
    /// Camera clutch.
    pub a2: Option<u32>,
    /// Gripper, for devices without a gripper sensor; never equal to `a1` or `a2`.
    pub g1: Option<u32>,
    /// Next mode.
    pub next_mode: Option<u32>,
    /// Previous mode.
    pub prev_mode: Option<u32>,
}
