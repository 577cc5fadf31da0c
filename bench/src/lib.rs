//! What the benchmarks share, and what tests need of it.
//!
//! * [`case`], [`jointed`], [`system`]: mechanical systems with known motions; [`mod@reference`]: their solutions in high
//!   precision, by code that shares nothing with the simulator; [`own`]: the same systems in the simulator.
//! * [`script`], [`follow`], [`invariants`], [`work`]: scenes that are driven by scripts and judged by invariants.
//! * [`model_files`]: model files of other people.
//! * [`report`], [`plot`], [`statistics`]: tables, figures and numbers of the pages in `docs/benchmarks`.
//!
//! The programs are in `benches/`; `scripts/bench` runs them.
#![allow(missing_docs, reason = "for the programs of this package")]

pub mod case;
pub mod follow;
pub mod invariants;
pub mod jointed;
pub mod model_files;
pub mod own;
pub mod plot;
pub mod reference;
pub mod report;
pub mod script;
pub mod statistics;
pub mod system;
pub mod work;

use std::path::PathBuf;

/// Folder for files of a run, below the target folder.
pub fn folder() -> PathBuf {
    let program = std::env::current_exe().expect("this program");
    let target = program.ancestors().nth(3).expect("the target folder").join("tmp");
    std::fs::create_dir_all(&target).expect("a folder below the target folder");
    target
}

/// The simulator of the same build; `scripts/bench` builds it.
pub fn simulator() -> PathBuf {
    let program = std::env::current_exe().expect("this program");
    let simulator = program.ancestors().nth(2).expect("a folder of the profile").join("ambf_simulator");
    assert!(simulator.exists(), "no {}: run cargo build --release --bin ambf_simulator", simulator.display());
    simulator
}
