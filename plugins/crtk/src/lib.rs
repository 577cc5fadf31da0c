//! Arms of a scene, offered to clients that speak CRTK (collaborative robotics toolkit), as dVRK software does.
//!
//! Layers, each of which knows only those above it:
//!
//! | module | what it is |
//! |---|---|
//! | [`kinematics`] | chains of joints: forward kinematics, Jacobians, inverse kinematics; numbers only |
//! | [`trajectory`] | how set points move |
//! | [`arm`] | one arm as a state machine: commands and measurements in, set points and events out |
//!
//! The mathematics is in `README.md`, use in `docs/crtk.md`.

pub mod arm;
pub mod config;
pub mod kinematics;
pub mod messages;
pub mod topics;
pub mod trajectory;
