//! The asynchronous multi-body framework as a library: no ROS, no window, no command line.

pub mod bullet;
pub mod comm;
pub mod control;
pub mod plugin;
pub mod scene;
pub mod sim;

pub use ambf_device as device;
pub use ambf_model::{adf, mesh, urdf};
