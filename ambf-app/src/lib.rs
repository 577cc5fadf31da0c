//! Parts of the programs `ambf_simulator` and `ambf_batch`. A library only so that benchmarks, reports, tests and fuzz
//! targets can use them.
//!
//! In: command lines ([`cli`]), the life of both programs ([`simulator`], [`batch`]), what explains files ([`check`]),
//! ROS 1 topics and services ([`ros`]), pictures of cameras over ROS (`cameras`), which drivers and plugins there are
//! ([`devices`], [`plugins`]), and the only log ([`report`](mod@report)).
//!
//! Not in: physics, which is `ambf_core`'s; ROS 1 as such, which is `ros_node`'s; pictures, which are `ambf_render`'s
//! (left out without the feature `pictures`), and windows, which are `ambf_viewer`'s (left out without `view`).
//!
//! Begin with [`simulator::run`] and [`batch::run`]; for ROS with the table at the top of [`ros`].

pub mod batch;
#[cfg(feature = "pictures")]
pub mod cameras;
pub mod check;
pub mod cli;
pub mod devices;
pub mod doctor;
pub mod launch;
pub mod plugins;
pub mod process;
mod recordings;
pub mod report;
pub mod ros;
pub mod simulator;
mod windows;
