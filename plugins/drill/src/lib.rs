//! The volumetric drilling plugin of the C++ program as a part of this one: `builtin:drill`, which stands in for the
//! library `libvolumetric_drilling…` (`docs/volumes.md`).
//!
//! It finds the bodies of the drill in a scene, makes of them a tool of each volume that may be cut, and moves the drill
//! by keys. What a tool does is ambf-core's (`scene/tool.rs`): touching, cutting, forces, showing the burr. Topics are
//! those of volumes.
//!
//! | module | what it is |
//! |---|---|
//! | [`options`] | what the command line says |
//! | [`keys`] | what keys of a window do |
//! | [`plugin`] | the plugin |
//!
//! ## Limitations
//! No sound, foot pedal, matcap pictures, panels and gaze marker, and no keys for shadows and looks of volumes.

pub mod keys;
pub mod options;
pub mod plugin;

pub use plugin::{register, NAME};
