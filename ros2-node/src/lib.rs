//! A ROS 2 node in Rust over RustDDS, without a ROS 2 installation. It knows nothing of the simulator.
//!
//! A [`Participant`] joins a domain of DDS. It has any number of [`Node`]s, each with [`Publication`]s,
//! [`Subscription`]s, [`Service`]s and [`Parameters`]. Messages are bytes: bodies of CDR, little endian, without the four
//! bytes that come before them. A [`Transcoder`] makes them from the bytes of ROS 1 and back, with nothing but the
//! definition of the message, so that one struct serves both.
//!
//! Threads: two of RustDDS, one of the participant, whatever the number of nodes and topics. None of them waits for a
//! peer.
//!
//! Nothing leaves this machine, and nothing from elsewhere is heard, unless `ROS_AUTOMATIC_DISCOVERY_RANGE` or
//! [`Options::range`] says so. What is heard is checked first ([`guard`]).
//!
//! ## Limitations
//! Those of RustDDS 0.15 are in the crate's `README.md`, with what is done about them: the hash of a type
//! ([`Description::type_hash`]) cannot be announced; acknowledged messages are kept for 6 s; other implementations show
//! our topics for up to 60 s after the end; fragments of large messages are sent in one burst. Services cannot be called,
//! only offered. Who wants `/rosout` publishes [`LogLine`]s there.

mod cdr;
mod description;
mod environment;
mod graph;
pub mod guard;
mod hash;
mod log;
pub mod names;
mod node;
mod parameters;
mod participant;
mod publication;
mod qos;
mod service;
mod subscription;
mod transcode;
mod wire;

pub use description::{Arity, Base, Description, DescriptionError, Field, Primitive};
pub use environment::{silent, EnvironmentError, GidLength, Options, Range, Report, HIGHEST_DOMAIN};
pub use log::LogLine;
pub use names::TypeName;
pub use node::Node;
pub use parameters::{Parameter, ParameterServices, Parameters, Value};
pub use participant::{Error, Hold, Participant, Timer};
pub use publication::{Publication, SendError};
pub use qos::{Qos, MAX_WINDOW, MIN_WINDOW};
pub use service::{Request, Service};
pub use subscription::Subscription;
pub use transcode::{TranscodeError, Transcoder, UnusableType};
