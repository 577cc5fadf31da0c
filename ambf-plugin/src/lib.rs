//! Plugins: code of others that runs with the simulation.
//!
//! Four kinds ([`SimulatorPlugin`], [`WorldPlugin`], [`ModelPlugin`], [`ObjectPlugin`]) share the callbacks of
//! [`Plugin`]. A program has some built in ([`Registry`]); others come from shared libraries that
//! [`export_plugin!`](crate::export_plugin) makes, or that are written in any language against the C interface in
//! [`abi`]. Both are the same to the simulation: what a plugin can see and do is [`View`], and what crosses between a
//! library and the program is plain data.
//!
//! `Simulation::load_plugins` of ambf-core loads what the files of a scene and a command line ask for. Nothing a
//! plugin does wrong stops the simulation, except what no program can stop: memory that is corrupted, and a callback
//! that never returns.
//!
//! Begin with [`Plugin`] and `docs/plugins.md`, whose examples are compiled here; `resources/plugins/recorder` and
//! `marker` are whole libraries. `traits.rs` has the callbacks, `view.rs` what they can see, `host.rs` who calls them,
//! `export.rs` and `library.rs` both sides of the C interface.
//!
//! Not in: the scene and its physics; ambf-core implements what [`View`] shows ([`run::Access`]).

/// The examples of the guide are compiled.
#[cfg(doctest)]
#[doc = include_str!("../../docs/plugins.md")]
struct Guide;

pub mod abi;
mod asked;
mod command;
mod desk;
mod drawing;
pub mod driver_abi;
mod driver_export;
mod driver_library;
mod error;
mod export;
mod host;
mod keys;
mod library;
mod object;
mod registry;
mod search;
mod snapshot;
mod state;
#[cfg(test)]
mod tests;
mod traits;
mod view;

/// How files are read and written: a recording is there when it is complete.
pub use ambf_model::files;
pub use command::{Command, CommandError, JointCommandType};
pub use drawing::{Drawing, DrawingShape, Drawings, Pixels, TextPlace, MAX_DRAWINGS, MAX_PIXELS, MAX_POINTS, MAX_TEXT};
#[doc(hidden)]
pub use driver_export::export_driver;
pub use driver_library::load_driver;
pub use error::PluginError;
#[doc(hidden)]
pub use export::export;
pub use host::{PluginReport, PluginSetup};
pub use keys::key_name;
pub use object::{ObjectId, ObjectType};
pub use registry::Registry;
pub use search::Search;
pub use snapshot::{SnapshotSlot, SnapshotWriter};
pub use state::{BodyState, Clock, Hit, JointFrame, JointState, StateSnapshot, ToolState, Touch};
pub use traits::{
    AnyPlugin, Host, InitContext, Input, ModelPlugin, ObjectPlugin, Plugin, PluginKind, SimulatorPlugin, Subject,
    WorldPlugin,
};
pub use view::View;

/// What a program needs that runs plugins.
pub mod run {
    pub use crate::asked::Asked;
    pub use crate::desk::{Incoming, Requests, Shared};
    pub use crate::host::{Phase, Plugins, Wanted};
    pub use crate::view::{Access, TextOf};
}
