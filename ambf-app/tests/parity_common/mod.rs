//! Traces of the C++ simulator, our runs of the same scenes, and how far they are apart.
//!
//! Those of our own scenes are in `tests/traces/cpp`; those of legacy scenes are optional test data in `../shared`,
//! beside the repository. A `README.md` in either folder says which scene and which commands each was recorded with.
#![allow(dead_code, unused_imports, missing_docs)]

mod compare;
mod reference;
mod run;

pub use compare::{apart_at_end, at_rest, compare_bodies, compare_joints, Quantity};
pub use reference::{bodies, cases, joints, meta, soft_nodes, BodyState, Case, Table};
/// Bodies of a trace or a run.
pub type Bodies = Table<BodyState>;
pub use run::{load_case, simulate, soft_distances, Recording, Start};

/// Shifts (m) of the start whose effect shows how predictable a scene is. Far below what any file or clock can tell.
pub const SHIFTS: [f64; 6] = [1e-12, -1e-12, 1e-13, -1e-13, 1e-14, -1e-14];
