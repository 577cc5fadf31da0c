//! Joints.

use nalgebra::Vector3;

use super::common::Common;
use super::controller::Controller;

/// A joint as written. "rad or m": radians for angular joints, metres for linear ones.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Identity. `passive` excludes the joint and its child from the active lists.
    pub common: Common,
    /// Type with what only that type has.
    pub kind: JointKind,
    /// Identifier of the parent body, blanks kept.
    pub parent: String,
    /// Identifier of the child body, blanks kept.
    pub child: String,
    /// Pivot in the parent's body frame, m, before the parent's scale.
    pub parent_pivot: Vector3<f64>,
    /// Pivot in the child's body frame, m, before the child's scale.
    pub child_pivot: Vector3<f64>,
    /// Joint axis in the parent's body frame: finite, not zero (except for p2p), not normalised.
    pub parent_axis: Vector3<f64>,
    /// Joint axis in the child's body frame: finite, not zero (except for p2p), not normalised.
    pub child_axis: Vector3<f64>,
    /// Rotation of the child about the axis at joint position zero, rad. Default: 0.
    pub child_offset: f64,
    /// Rotation of the joint frame about the parent axis, rad. Default: 0.
    pub joint_offset: f64,
    /// Limits of a one-dof joint; `None`: unlimited.
    pub limits: Option<Limits>,
    /// Position control allowed. Default: `true`.
    pub enable_motor: bool,
    /// Wrench and effort estimation. Default: `false`.
    pub enable_feedback: bool,
    /// Largest motor impulse per 1 ms step for velocity control, N·m·s or N·s, not negative. Default: 0.1.
    pub max_motor_impulse: f64,
    /// Damping of a one-dof spring, N·m·s/rad or N·s/m; other one-dof joints have no use for it. Default: 0.
    pub damping: f64,
    /// Stiffness of a one-dof spring, N·m/rad or N/m. Default: 0.
    pub stiffness: f64,
    /// Rest position of a one-dof spring, rad or m; `None`: the middle of the limits.
    pub equilibrium_point: Option<f64>,
    /// Error reduction parameter. Default: 0.1.
    pub erp: f64,
    /// Constraint force mixing. Default: 0.1.
    pub cfm: f64,
    /// No collision between the two connected bodies. Default: `true`.
    pub ignore_inter_collision: bool,
    /// Joint controller. Default output: force with key `controller`, velocity without it.
    pub controller: Controller,
}

/// Range of a one-dof joint, rad or m. `low` may exceed `high`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Lower limit, rad or m.
    pub low: f64,
    /// Upper limit, rad or m.
    pub high: f64,
}

/// Type of a joint.
#[derive(Clone, Debug, PartialEq)]
pub enum JointKind {
    /// `hinge`, `revolute`, `continuous`.
    Revolute,
    /// `slider`, `prismatic`.
    Prismatic,
    /// `fixed`.
    Fixed,
    /// `spring`, `linear spring`.
    LinearSpring,
    /// `torsion spring`, `torsional spring`, `angular spring`.
    TorsionSpring,
    /// `p2p`: ball joint; axes and offsets have no meaning.
    PointToPoint,
    /// `cone twist`.
    ConeTwist(ConeTwistLimits),
    /// `six dof`.
    SixDof(SixDofLimits),
    /// `six dof spring`.
    SixDofSpring(Box<SixDofSpring>),
    /// Another text: the joint exists, creates no constraint, its position is 0.
    Unknown(String),
}

/// Ranges of a cone twist joint about its three axes: each angle within ± the value, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConeTwistLimits {
    /// Twist span about x, rad. Default: 0.7.
    pub twist: f64,
    /// Swing span about y, rad. Default: 0.7.
    pub swing_y: f64,
    /// Swing span about z, rad. Default: 0.7.
    pub swing_z: f64,
}

impl Default for ConeTwistLimits {
    fn default() -> Self {
        Self { twist: 0.7, swing_y: 0.7, swing_z: 0.7 }
    }
}

/// Ranges of a six-dof joint, one a component. `low` above `high` means: free.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SixDofLimits {
    /// Lower linear limits, m. Default: -1.2 each.
    pub linear_low: Vector3<f64>,
    /// Upper linear limits, m. Default: 1.2 each.
    pub linear_high: Vector3<f64>,
    /// Lower angular limits, rad. Default: -1.2 each.
    pub angular_low: Vector3<f64>,
    /// Upper angular limits, rad. Default: 1.2 each.
    pub angular_high: Vector3<f64>,
}

impl Default for SixDofLimits {
    fn default() -> Self {
        let high = Vector3::repeat(1.2);
        Self { linear_low: -high, linear_high: high, angular_low: -high, angular_high: high }
    }
}

/// A linear and an angular quantity of a six-dof spring.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearAngular {
    /// Along x, y, z.
    pub linear: Vector3<f64>,
    /// About x, y, z.
    pub angular: Vector3<f64>,
}

impl LinearAngular {
    pub(crate) fn repeat(value: f64) -> Self {
        Self { linear: Vector3::repeat(value), angular: Vector3::repeat(value) }
    }
}

/// What a six-dof spring has besides a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SixDofSpring {
    /// Ranges.
    pub limits: SixDofLimits,
    /// Stiffness, N/m and N·m/rad. Default: 1 each.
    pub stiffness: LinearAngular,
    /// Damping, N·s/m and N·m·s/rad. Default: 0.7 each.
    pub damping: LinearAngular,
    /// Rest position, m and rad. Default: 0 each.
    pub equilibrium_point: LinearAngular,
}

impl Default for SixDofSpring {
    fn default() -> Self {
        Self {
            limits: SixDofLimits::default(),
            stiffness: LinearAngular::repeat(1.0),
            damping: LinearAngular::repeat(0.7),
            equilibrium_point: LinearAngular::repeat(0.0),
        }
    }
}
