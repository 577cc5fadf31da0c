//! Arms of a scene, offered to clients that speak CRTK (collaborative robotics toolkit), as dVRK software does.
//!
//! Layers, each of which knows only those above it:
//!
//! | module | what it is |
//! |---|---|
//! | [`kinematics`] | chains of joints: forward kinematics, Jacobians, inverse kinematics; numbers only |
//! | [`trajectory`] | how set points move |
//! | [`arm`] | one arm as a state machine: commands and measurements in, set points and events out |
//! | [`config`] | which arms a file offers, and how |
//! | [`messages`], [`topics`] | what is said about an arm and taken from clients, as data |
//! | [`queries`] | services: what clients may ask about an arm |
//! | [`transport`] | how topics reach clients: a trait, and ROS 1 |
//! | [`exchange`], [`serve`] | commands and states between threads; the thread that publishes |
//! | [`bind`], [`grasp`], [`plugin`] | arms in a scene; what their jaws hold; the plugin of the simulator |
//! | [`socket`] | an arm over UDP, in JSON |
//! | [`local`] | arms for clients in this process, without a middleware |
//! | [`seed`] | what differs from run to run: errors of joints, places of bodies |
//! | [`statistics`], [`diagnostics`] | how regularly arms are updated; reports on them |
//!
//! The mathematics is in `README.md`, use in `docs/crtk.md`.

pub mod arm;
pub mod bind;
pub mod config;
pub mod diagnostics;
pub mod exchange;
pub mod grasp;
pub mod kinematics;
pub mod local;
pub mod messages;
pub mod plugin;
pub mod queries;
pub mod seed;
pub mod serve;
pub mod socket;
pub mod statistics;
pub mod topics;
pub mod trajectory;
pub mod transport;
