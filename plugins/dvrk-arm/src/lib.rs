//! Arms of a da Vinci Research Kit (dVRK) over ROS 1: masters MTML and MTMR, slaves PSM1 to PSM3, ECM, and arms of any
//! other name.
//!
//! * [`driver`] makes them input devices of the simulator.
//! * [`Arm`] offers them to other programs.
//! * [`Names`], [`pedal_topics`] and [`messages`] are names and types of topics, for nodes that stand in for the
//!   robot's, as `fake_dvrk` does.
//!
//! The four ways in which releases of the robot's software name and type their topics, [`Dialect`], are told apart
//! automatically.
//!
//! | thread | what it does |
//! |---|---|
//! | `dvrk-ARM` | one an arm: sends commands, watches that they are not old |
//! | `dvrk-watch` | asks the master every 0.5 s what is published; finds arms and shakes hands with them |
//! | `ros-link`, `ros-sockets` | tend the one node that all arms share, see [`ros_node`] |
//!
//! A thread is added for each topic that is listened to and has a publisher; rosrust adds two for each that is
//! published.

mod arm;
mod device;
mod dialect;
mod frames;
mod gravity;
mod hub;
mod inner;
pub mod messages;
mod options;
mod outputs;
mod pace;
mod pedals;
mod presence;
mod sender;
mod session;
mod wire;

pub use arm::{active_arms, Arm, ArmError};
pub use device::driver;
pub use dialect::{Dialect, DialectChoice, Names, Topics};
pub use frames::{isometry, Frames, Wrench};
pub use gravity::tip_wrench;
pub use inner::Mode;
pub use options::{ArmOptions, Say, SETTINGS};
pub use pedals::{pedal_topics, ClutchSource, Pedal};
