//! Input devices: what a driver offers, and how a device moves a body of the simulation and feels it.
//!
//! In: the traits of drivers ([`Driver`], [`InputDevice`]), the control law ([`law`], pure functions), the threads in
//! which devices run and how they exchange data with the physics ([`host`]), the schedule of loops of a fixed frequency
//! ([`timing`]), a device in software ([`MockDriver`]). Not in: physics, ROS, hardware; drivers of hardware are crates
//! below `plugins/`, which depend on this one alone.

mod caught;
mod driver;
pub mod host;
pub mod known;
mod latest;
pub mod law;
mod mock;
mod sample;
mod spec;
pub mod timing;

pub use ambf_model::{files, text, Setting, SettingError, Settings};
pub use caught::caught;
pub use driver::{DeviceError, DeviceInfo, DeviceLog, Driver, Drivers, InputDevice, Presence};
pub use latest::Latest;
pub use mock::{CommandedForce, MockDriver, MockRecording};
pub use sample::{DeviceForce, DeviceSample};
pub use spec::{Axes, DeviceSpec};
