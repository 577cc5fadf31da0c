//! The extension module `ambf._ambf`: the simulator without ROS for Python. What users see is the package `ambf` around
//! it.
//!
//! A `World` owns a [`Stepper`](ambf_core::sim::Stepper). States are written into, and commands read from, NumPy arrays
//! that live as long as anyone holds them; both happens only while Python's global lock is held, so that a thread which
//! reads an array while another one steps the physics sees the states of one step.
//!
//! Begin with `world.rs`: `World::step` takes the physics out of its slot, puts the commands of the arrays in force,
//! steps without Python's lock, and writes the states into the arrays. `drawing.rs` draws, `view.rs` opens windows,
//! `arms.rs` lets CRTK clients reach arms, `pool.rs` steps many worlds at once, `batch.rs` many of one scene with common arrays, `tree.rs` answers questions about mechanisms.
//!
//! Not in: names, shapes and checks of arguments that users see, which are in `python/ambf/simulation.py`; ROS, which
//! is `ambf_client`'s.

mod arms;
mod arrays;
mod batch;
mod commands;
mod contacts;
mod drawing;
mod errors;
mod load;
mod names;
mod parameters;
mod pool;
mod recording;
mod tree;
mod view;
mod volumes;
mod world;

use pyo3::pymodule;

#[pymodule]
mod _ambf {
    /// Version of the simulator, with the commit if it is known.
    #[pymodule_export]
    #[allow(non_upper_case_globals, reason = "Python's name")]
    const version: &str = ambf_version::VERSION;

    #[pymodule_export]
    use super::batch::Batch;
    #[pymodule_export]
    use super::pool::{shared_descriptions, shared_shapes, stack_states, step_all};
    #[pymodule_export]
    use super::recording::Replay;
    #[pymodule_export]
    use super::tree::Tree;
    #[pymodule_export]
    use super::world::{State, World};
}
