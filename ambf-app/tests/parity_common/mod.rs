//! Traces of the C++ simulator, our runs of the same scenes, and how far they are apart.
//!
//! The traces are optional test data in `../shared`, beside the repository. `traces/README.md` there says which scene and which
//! commands each of them was recorded with.
#![allow(dead_code, missing_docs)]

mod compare;
mod reference;
mod run;

pub use compare::{at_rest, compare_bodies, compare_joints, Quantity, Worst};
pub use reference::{bodies, cases, joints, meta, shared, BodyState, Case, JointState, MetaBody, Table};
pub use run::{load_case, simulate, Recording, Start};
