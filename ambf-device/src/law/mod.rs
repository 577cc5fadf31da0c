//! The laws by which a device moves an end-effector and feels it: plain functions of numbers, without threads, clocks
//! or a world. `docs/devices.md` has the formulas and the symbols used here.

mod camera;
mod controls;
mod effector;
mod feedback;
mod gripper;
mod haptic;
#[cfg(test)]
mod random;
mod reference;
mod rotation;
#[cfg(test)]
mod tests;
mod velocity;

pub use camera::CameraMotion;
pub use controls::{Buttons, GainChange, Mode, Quantity, Status};
pub use effector::{Drive, EffectorInput, EffectorOutput, EndEffector};
pub use gripper::{joint_target, Grip, UNKNOWN_OPENING};
pub use haptic::{HapticInput, HapticLoop, HapticOutput, Switches, WorldView};
pub use reference::RotationRule;
pub use rotation::{rotation_vector, rotation_vector_change};
pub use velocity::VelocityEstimator;
