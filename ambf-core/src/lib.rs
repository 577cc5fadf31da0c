//! The asynchronous multi-body framework as a library: no ROS, no window, no command line.

pub mod comm;
pub mod mesh;
