//! The asynchronous multi-body framework as a library: no ROS, no window, no command line.

pub mod adf;
pub mod bullet;
pub mod comm;
pub mod control;
pub mod device;
pub mod mesh;
pub mod plugin;
pub mod scene;
pub mod sim;
pub mod urdf;
mod xml;
