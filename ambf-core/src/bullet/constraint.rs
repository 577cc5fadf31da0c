use bullet_sys as sys;
use nalgebra::Isometry3;

use super::raw_pose;

/// A constraint to be made between bodies A and B.
#[derive(Debug, Clone, PartialEq)]
pub struct Constraint {
    /// Type and what only that type has.
    pub kind: ConstraintKind,
    /// Joint frame in the inertial frame of A.
    pub frame_a: Isometry3<f64>,
    /// Joint frame in the inertial frame of B.
    pub frame_b: Isometry3<f64>,
    /// Bullet's own parameters: what, value, axis (-1 where the type has no axes).
    pub parameters: Vec<(ConstraintParameter, f64, i32)>,
    /// Estimate the reaction on both bodies.
    pub feedback: bool,
    /// A and B do not collide.
    pub disable_collisions: bool,
}

/// Type of a constraint. "Limits" are `[low, high]`; low above high means free where six axes are given.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "made once a joint and dropped at once")]
pub enum ConstraintKind {
    /// Rotation about z of the joint frames; limits in rad.
    Hinge {
        /// `None`: unlimited.
        limits: Option<[f64; 2]>,
    },
    /// Translation along x of the joint frames; limits in m.
    Slider {
        /// `None`: unlimited.
        limits: Option<[f64; 2]>,
    },
    /// No relative motion.
    Fixed,
    /// The origins of the joint frames coincide.
    PointToPoint,
    /// Ball joint that swings and twists within spans, rad.
    ConeTwist {
        /// Span about z.
        swing1: f64,
        /// Span about y.
        swing2: f64,
        /// Span about x.
        twist: f64,
    },
    /// Six limited axes: linear x, y, z in m, angular x, y, z in rad, in Bullet's sign.
    SixDof([[f64; 2]; 6]),
    /// Six limited axes with springs.
    SixDofSpring {
        /// As for [`SixDof`](Self::SixDof).
        limits: [[f64; 2]; 6],
        /// `None`: Bullet's defaults stay on that axis, no spring.
        springs: [Option<Spring>; 6],
    },
}

/// A spring on one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spring {
    /// Whether it acts.
    pub enabled: bool,
    /// N/m or N·m/rad.
    pub stiffness: f64,
    /// N·s/m or N·m·s/rad.
    pub damping: f64,
    /// Rest position, m or rad, in Bullet's sign.
    pub equilibrium: Option<f64>,
}

/// Bullet's parameters of a constraint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i32)]
pub enum ConstraintParameter {
    /// Error reduction.
    Erp = 1,
    /// Error reduction at limits.
    StopErp = 2,
    /// Constraint force mixing.
    Cfm = 3,
}

impl ConstraintKind {
    /// What is read of a constraint as its position.
    pub(super) fn reading(&self) -> u8 {
        let reading = match self {
            Self::Hinge { .. } => sys::AmbReading::AmbReading_HingeAngle,
            Self::Slider { .. } => sys::AmbReading::AmbReading_SliderPosition,
            Self::SixDofSpring { springs, .. } => match springs {
                [None, None, Some(_), None, None, None] => sys::AmbReading::AmbReading_AxisDistance,
                [None, None, None, None, None, Some(_)] => sys::AmbReading::AmbReading_AxisAngle,
                _ => sys::AmbReading::AmbReading_None,
            },
            _ => sys::AmbReading::AmbReading_None,
        };
        reading as u8
    }
}

/// Makes the Bullet constraint; the caller frees it.
///
/// # Safety
/// `a` and `b` are live bodies, different from each other, that outlive the result.
pub(super) unsafe fn make(
    a: *mut sys::AmbBody,
    b: *mut sys::AmbBody,
    constraint: &Constraint,
) -> *mut sys::AmbConstraint {
    let (raw_a, raw_b) = (raw_pose(&constraint.frame_a), raw_pose(&constraint.frame_b));
    let (frame_a, frame_b) = (raw_a.as_ptr(), raw_b.as_ptr());
    // SAFETY: the caller vouches for the bodies; frames are 12 doubles, of which a point-to-point joint reads the first three; each
    // set function is called on the type it casts to.
    unsafe {
        match &constraint.kind {
            ConstraintKind::Hinge { limits } => {
                let raw = sys::amb_hinge_new(a, b, frame_a, frame_b);
                if let Some([low, high]) = *limits {
                    sys::amb_hinge_set_limit(raw, low, high);
                }
                raw
            }
            ConstraintKind::Slider { limits } => {
                let raw = sys::amb_slider_new(a, b, frame_a, frame_b);
                if let Some([low, high]) = *limits {
                    sys::amb_slider_set_limit(raw, low, high);
                }
                sys::amb_slider_lock_rotation(raw);
                raw
            }
            ConstraintKind::Fixed => sys::amb_fixed_new(a, b, frame_a, frame_b),
            ConstraintKind::PointToPoint => sys::amb_point_to_point_new(a, b, frame_a, frame_b),
            &ConstraintKind::ConeTwist { swing1, swing2, twist } => {
                let raw = sys::amb_cone_twist_new(a, b, frame_a, frame_b);
                sys::amb_cone_twist_set_limit(raw, swing1, swing2, twist);
                raw
            }
            ConstraintKind::SixDof(limits) => {
                let raw = sys::amb_six_dof_new(a, b, frame_a, frame_b);
                for (axis, &[low, high]) in (0..).zip(limits) {
                    sys::amb_six_dof_set_limit(raw, axis, low, high);
                }
                raw
            }
            ConstraintKind::SixDofSpring { limits, springs } => {
                let raw = sys::amb_six_dof_spring_new(a, b, frame_a, frame_b);
                for (axis, (&[low, high], spring)) in (0..).zip(limits.iter().zip(springs)) {
                    sys::amb_six_dof_spring_set_limit(raw, axis, low, high);
                    if let Some(spring) = spring {
                        let enabled = spring.enabled.into();
                        sys::amb_six_dof_spring_set_spring(raw, axis, enabled, spring.stiffness, spring.damping);
                        if let Some(equilibrium) = spring.equilibrium {
                            sys::amb_six_dof_spring_set_equilibrium(raw, axis, equilibrium);
                        }
                    }
                }
                raw
            }
        }
    }
}
