//! The engine of the profile `accurate`: what is solved, in which order and why is in the crate's `README.md`.
//!
//! In: articulated bodies (Featherstone's algorithm, Runge-Kutta), the direct solver of islands and the corrections to
//! Bullet's rows, soft rows that drive joints and bodies, exact motion of free bodies, continuous collision detection.
//! They are C++ in `cpp/`, behind the C interface of [`ffi`], and act in Bullet's step through the interface that
//! bullet-sys offers engines in `shim/extension.h`.
//!
//! [`tree`] is not part of it: functions of a state that users ask for, in every profile.
//!
//! Not in: bodies, shapes, constraints, queries and memory, which are bullet-sys'; safe owners, which are in
//! `ambf_core::bullet`; when which part of the engine is used, which is the scene's to say. What it relies on within
//! Bullet is listed in bullet-sys' `UPGRADE.md`.
//!
//! Begin with `README.md`, then [`island`] (what is solved, without Bullet) or `cpp/engine.cpp` (where Bullet's step is
//! entered).

pub mod aba;
pub mod assembly;
pub mod ffi;
pub mod island;
pub mod mlcp;
pub mod tree;
