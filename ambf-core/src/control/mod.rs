//! Controllers as pure functions of numbers: they know no world and are tested without one.

mod cartesian;
mod drive;
mod joint;

pub use cartesian::{orientation_of, CartesianController, CartesianError, CartesianOutput};
pub(crate) use drive::agreement;
pub use drive::{
    spring, JointDriver, PoseAction, PoseDriver, Quantity, Scheme, SetpointMotion, SoftVelocity, TrackingError,
};
pub use joint::{shortest_angle, JointController};

/// Which physics is wanted where the C++ program and the best result differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Profile {
    /// What the C++ program does, number for number as far as Bullet allows. The default.
    #[default]
    Legacy,
    /// The most accurate result: Bullet's collision detection with the engine of ambf-dynamics.
    Accurate,
}
