//! A ROS 2 node in Rust over RustDDS, without a ROS 2 installation. It knows nothing of the simulator.
mod description;
mod hash;
pub mod names;
mod transcode;

pub use description::{Arity, Base, Description, DescriptionError, Field, Primitive};
pub use transcode::{TranscodeError, Transcoder, UnusableType};
