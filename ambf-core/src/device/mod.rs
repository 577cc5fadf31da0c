//! Input devices: what a driver offers, and how a device moves a body of the simulation and feels it.

mod driver;
pub mod host;
pub mod known;
mod latest;
pub mod law;
mod mock;
mod sample;
mod settings;
mod spec;

pub use driver::{DeviceError, DeviceInfo, DeviceLog, Driver, Drivers, InputDevice};
pub use latest::Latest;
pub use mock::{CommandedForce, MockDriver, MockRecording};
pub use sample::{DeviceForce, DeviceSample};
pub use settings::{Setting, Settings};
pub use spec::{Axes, DeviceSpec};
