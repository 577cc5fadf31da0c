//! Projection of initial poses onto the joints.
//!
//! A file gives every body a pose and every joint a frame on either body; the two contradict each other by what a
//! modelling tool rounded, or by more. [`assemble`] finds poses x that satisfy the joints, g(x) = 0 and h(x) ≤ 0
//! (limits), near the poses x₀ of the file in the metric of the masses: each Gauss–Newton step is the least one, ½ ΔᵀMΔ
//! → min subject to J Δ = −g, hence
//!
//! ```text
//! Δ = −M⁻¹ Jᵀ λ,   (J M⁻¹ Jᵀ + ε D) λ = g,   D = diag(J M⁻¹ Jᵀ) at x₀
//! ```
//!
//! (Levenberg–Marquardt with the damping ε: Nocedal & Wright, *Numerical Optimization*, ch. 10; the projection is that
//! of stabilised DAE integrators: Hairer & Wanner, *Solving Ordinary Differential Equations II*, ch. VII.2.) Limits are
//! an active set: a limit is a row of g while it is violated or while its multiplier pushes the joint inwards.
//!
//! The step is taken from the quasi-definite form of the same equations, \[M Jᵀ; J −εD\], by a block LDLᵀ factorisation
//! in an order of minimum degree: trees have no fill, so that the cost of a step is linear in the number of bodies.
//!
//! The linear rows of a joint, and its angular rows, have the means of their D: the diagonal alone depends on the axes
//! along which an error is resolved, and the sum of squares below would, too.
//!
//! Where the joints contradict each other, the iteration ends at a stationary point of ½ gᵀD⁻¹g, the least-squares
//! compromise in which each row counts with its effective mass, and a limit with a hundredth of it; redundant joints that
//! do not contradict each other are closed exactly. The position problem of a sub-step has the same weights: the
//! compromise stays where it is.
//!
//! Loops with more constraints than they need are such a contradiction as soon as a dimension is rounded, and cannot move.
//! [`omit_redundant_rows`] finds the constraints that repeat others.
//!
//! Where the iteration ends at a compromise although the joints form a tree, because its base is far from where the file
//! has its links, the links are put onto their joints one after the other.
//!
//! ## Limitations
//! The iteration is local: loops whose joints are off by more than about a quarter of a turn may end in another
//! configuration of the mechanism, or at a compromise although a solution exists.

mod factor;
mod island;
mod redundancy;
mod rows;
#[cfg(test)]
mod tests;

use nalgebra::{Isometry3, Matrix3, Vector3};

pub use redundancy::{omit_redundant_rows, Loops};
pub use rows::{gap, Gap};

/// A rigid body.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    /// Pose of the principal inertial frame in the world, m.
    pub pose: Isometry3<f64>,
    /// Mass, kg; of no meaning for a body that is not movable. One that is not positive counts as 1 kg.
    pub mass: f64,
    /// Principal moments of inertia about the axes of `pose`, kg·m². A moment of zero means, as in Bullet, that the
    /// body does not turn about that axis.
    pub inertia: Vector3<f64>,
    /// Whether the body may be displaced.
    pub movable: bool,
}

/// Range of a coordinate, m or rad: equal ends lock it, `low > high` leaves it free.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// Lower end, m or rad.
    pub low: f64,
    /// Upper end, m or rad.
    pub high: f64,
}

impl Range {
    /// No restriction.
    pub const FREE: Self = Self { low: 1.0, high: -1.0 };
    /// Locked at zero.
    pub const LOCKED: Self = Self { low: 0.0, high: 0.0 };

    /// From `low` to `high`.
    pub fn new(low: f64, high: f64) -> Self {
        Self { low, high }
    }

    fn is_locked(&self) -> bool {
        self.low == self.high
    }
}

/// Which relative motions a joint leaves; "x", "y", "z" are axes of its frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// Rotation about z, rad.
    Revolute(Range),
    /// Translation along x, m.
    Prismatic(Range),
    /// No relative motion.
    Fixed,
    /// Rotation about the common origin.
    PointToPoint,
    /// Rotation about the common origin with a twist about x in ± `twist` and a swing in an ellipse with the semi-axes
    /// `swing_y` about y and `swing_z` about z, rad.
    ConeTwist {
        /// Greatest twist about x, rad.
        twist: f64,
        /// Greatest swing about y, rad.
        swing_y: f64,
        /// Greatest swing about z, rad.
        swing_z: f64,
    },
    /// Six coordinates: the origin of frame B in frame A (m), and angles α, β, γ (rad) with the rotation R_z(γ) R_y(β)
    /// R_x(α) from B to A.
    SixDof {
        /// Ranges along x, y, z of frame A, m.
        linear: [Range; 3],
        /// Ranges of α, β, γ, rad.
        angular: [Range; 3],
    },
}

/// A joint between two bodies.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Which relative motions it leaves.
    pub kind: Kind,
    /// Indices of the bodies A and B.
    pub bodies: [usize; 2],
    /// Joint frames in the inertial frames of A and B, m.
    pub frames: [Isometry3<f64>; 2],
    /// Rows that are not asked for.
    pub omission: Omission,
}

/// Rows of a joint that are left out, because the other joints of its loop demand the same: see
/// [`omit_redundant_rows`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Omission {
    /// The axes along which the gap of the joint is resolved into linear rows are the columns of this matrix, in the joint
    /// frame on body `side`. For [`Kind::Prismatic`] the first is x.
    pub axes: Matrix3<f64>,
    /// Body with which these axes turn: 0 is A, 1 is B.
    pub side: usize,
    /// Which of the linear rows are left out.
    pub linear: [bool; 3],
    /// Which of the angular rows, about the axes of frame A, are left out.
    pub angular: [bool; 3],
    /// Errors of these rows from which on they are asked for nevertheless, m and rad.
    pub clearance: Gap,
}

impl Omission {
    /// All rows are asked for, the linear ones along the axes of frame A.
    pub const NONE: Self = Self {
        axes: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        side: 0,
        linear: [false; 3],
        angular: [false; 3],
        clearance: Gap { distance: f64::INFINITY, angle: f64::INFINITY },
    };

    /// Number of rows that are left out.
    pub fn count(&self) -> usize {
        self.linear.iter().chain(&self.angular).filter(|&&is_omitted| is_omitted).count()
    }
}

/// Moves the bodies onto the joints; poses of bodies that are not movable, and of groups of bodies whose joints are
/// closed already (to rounding errors), keep every bit. Returns true when every joint is closed to rounding errors
/// ([`gap`] says how far one is open).
///
/// A group of bodies whose poses would not be finite is left where it is, and so is one whose joints are so entangled, such
/// as hundreds between the same two bodies, that the cost would not be in proportion to their number.
///
/// # Panics
/// When a joint names a body that does not exist.
pub fn assemble(bodies: &mut [Body], joints: &[Joint]) -> bool {
    assemble_coupled(bodies, joints, &[])
}

/// [`assemble`], where joints are coupled, too.
///
/// # Panics
/// When a joint names a body, or a coupling a joint, that does not exist; when a coupling names a joint without a coordinate.
pub fn assemble_coupled(bodies: &mut [Body], joints: &[Joint], couplings: &[Coupling]) -> bool {
    let islands = island::partition(bodies, joints, couplings);
    let mut closed = true;
    for island::Parts { joints: joints_of, couplings: couplings_of } in islands {
        let island = island::Island::new(bodies, joints, couplings, joints_of, couplings_of);
        closed &= island.is_some_and(|island| island.solve(bodies));
    }
    closed
}

/// A linear equation between the coordinates of joints of the kinds [`Revolute`](Kind::Revolute) and
/// [`Prismatic`](Kind::Prismatic), rad and m: the coordinate of the first, the follower, is the sum of those of the others,
/// each times its ratio, plus the offset.
#[derive(Debug, Clone, PartialEq)]
pub struct Coupling {
    /// Index of the joint that follows.
    pub follower: usize,
    /// Indices of the joints that it follows, and the rate of the follower over that of each.
    pub leaders: Vec<(usize, f64)>,
    /// rad or m.
    pub offset: f64,
}
