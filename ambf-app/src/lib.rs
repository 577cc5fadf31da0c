//! Parts shared by `ambf_simulator` and `ambf_batch`.

pub mod batch;
pub mod check;
pub mod cli;
pub mod devices;
pub mod launch;
pub mod plugins;
pub mod process;
pub mod report;
pub mod ros;
pub mod simulator;
mod windows;
