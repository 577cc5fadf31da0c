//! Parts shared by `ambf_simulator` and `ambf_batch`.

pub mod batch;
#[cfg(feature = "view")]
pub mod cameras;
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
