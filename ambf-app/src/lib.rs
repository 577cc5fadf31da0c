//! Parts shared by `ambf_simulator` and `ambf_batch`.

pub mod cli;
