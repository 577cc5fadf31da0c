//! Kinematics of arms with up to [`MAX_JOINTS`] coordinates. Everything has a fixed size, so that nothing here
//! allocates. Twists and Jacobians have the linear part first. SI units.

mod chain;
mod dls;
mod gravity;
mod table;
mod wrist;

pub use chain::{Chain, ChainError, ChainJoint, Motion};
pub use dls::{DampedLeastSquares, DlsSettings};
pub use gravity::{holding_efforts, Load};
pub use table::{DhJoint, DhTable, Instrument};
pub use wrist::{EcmInverse, PsmInverse};

use nalgebra::{Isometry3, SMatrix, SVector, UnitQuaternion};
use thiserror::Error;

/// Most coordinates of an arm.
pub const MAX_JOINTS: usize = 8;

/// Joint coordinates, rad or m, in the order of the arm; those that it lacks are 0.
pub type Coordinates = SVector<f64, MAX_JOINTS>;

/// (6 x joints), linear rows first: m/rad or 1, rad/rad or rad/m. Columns of joints that the arm lacks are 0.
pub type Jacobian = SMatrix<f64, 6, MAX_JOINTS>;

/// Range of a coordinate, rad or m; infinite where there is none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Lower end.
    pub lower: f64,
    /// Upper end.
    pub upper: f64,
}

impl Limits {
    /// No limits.
    pub const NONE: Self = Self { lower: f64::NEG_INFINITY, upper: f64::INFINITY };

    /// Whether `value` is inside, or outside by `tolerance` at most.
    pub fn hold(&self, value: f64, tolerance: f64) -> bool {
        value >= self.lower - tolerance && value <= self.upper + tolerance
    }

    /// The value in the range that is nearest. Limits in the wrong order give the lower one.
    pub fn clip(&self, value: f64) -> f64 {
        value.min(self.upper).max(self.lower)
    }
}

/// Why there are no joint coordinates for a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum InverseError {
    /// Error when the goal is at or above the remote centre, where the instrument cannot be.
    #[error("the goal is not below the remote centre")]
    RemoteCentre,
    /// Error when the goal leaves a joint undetermined.
    #[error("the goal is singular: it leaves a joint undetermined")]
    Singular,
    /// Error when the iteration did not come near the goal.
    #[error("the goal is out of reach")]
    Unreachable,
    /// Error when the arm has no inverse kinematics.
    #[error("the arm has no inverse kinematics")]
    None,
}

/// Inverse kinematics of an arm.
#[derive(Debug, Clone, PartialEq)]
pub enum Inverse {
    /// Closed form of a PSM.
    Psm(PsmInverse),
    /// Closed form of an ECM: position, and the roll that comes nearest.
    Ecm(EcmInverse),
    /// Iteration on any chain.
    Iterative(DampedLeastSquares),
    /// None: Cartesian commands are refused.
    None,
}

/// What an arm can compute about itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Kinematics {
    /// Joints from the base to the control point.
    pub chain: Chain,
    /// The way back.
    pub inverse: Inverse,
}

impl Kinematics {
    /// Joint coordinates that bring the control point to `goal` (in the base), near `present`. Limits are looked at by
    /// the iteration only; the closed forms give the solution whose wrist does not fold back.
    ///
    /// # Errors
    /// [`InverseError`].
    pub fn inverse(
        &self,
        goal: &Isometry3<f64>,
        present: &Coordinates,
        limits: &[Limits],
    ) -> Result<Coordinates, InverseError> {
        match &self.inverse {
            Inverse::Psm(psm) => psm.solve(goal, present, limits),
            Inverse::Ecm(ecm) => ecm.solve(goal, present, limits),
            Inverse::Iterative(method) => method.solve(&self.chain, goal, present, limits),
            Inverse::None => Err(InverseError::None),
        }
    }

    /// Joint coordinates near `present` that turn the control point to `goal` (in the base), with joints from `first` on
    /// only. Redundant joints move as little as possible; what is out of reach is come near.
    pub fn orient(
        &self,
        goal: &UnitQuaternion<f64>,
        present: &Coordinates,
        first: usize,
        limits: &[Limits],
    ) -> Coordinates {
        dls::orient(&self.chain, goal, present, first, limits)
    }
}

#[cfg(test)]
pub(crate) mod testing {
    use super::*;

    /// Numbers without a pattern (Marsaglia 2003), the same in each run.
    pub struct Random(u64);

    impl Random {
        pub fn new(seed: u64) -> Self {
            Self(seed | 1)
        }

        /// Uniform in a range.
        pub fn within(&mut self, lower: f64, upper: f64) -> f64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            lower + (upper - lower) * ((self.0 >> 11) as f64 / (1u64 << 53) as f64)
        }
    }

    /// Distance (m) and angle (rad) between two poses, added.
    pub fn gap(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
        (a.translation.vector - b.translation.vector).norm() + (a.rotation.inverse() * b.rotation).scaled_axis().norm()
    }

    pub fn coordinates(values: &[f64]) -> Coordinates {
        let mut q = Coordinates::zeros();
        q.as_mut_slice()[..values.len()].copy_from_slice(values);
        q
    }

    /// Limits of a Classic PSM.
    pub const PSM_LIMITS: [Limits; 6] = [
        Limits { lower: -1.588, upper: 1.588 },
        Limits { lower: -0.925, upper: 0.925 },
        Limits { lower: 0.03, upper: 0.24 },
        Limits { lower: -3.054, upper: 3.054 },
        Limits { lower: -1.396, upper: 1.396 },
        Limits { lower: -1.396, upper: 1.396 },
    ];

    pub fn random_psm(random: &mut Random) -> Coordinates {
        coordinates(&PSM_LIMITS.map(|limits| random.within(limits.lower, limits.upper)))
    }
}
