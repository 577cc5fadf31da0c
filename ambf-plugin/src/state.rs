use nalgebra::{Isometry3, Vector3};

use super::abi::{RawBody, RawClock, RawJoint, RawTouch};

/// Where time stands.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Clock {
    /// Simulated time: the sum of all steps, s.
    pub sim_time: f64,
    /// The step just made, s; 0 before the first.
    pub dt: f64,
    /// Steps made.
    pub step: u64,
}

/// State of a rigid body.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BodyState {
    /// Body frame in the world as it is reported to clients: in profile `legacy` up to one sub-step old.
    pub pose: Isometry3<f64>,
    /// Inertial frame (centre of mass, principal axes) in the world at the end of the step.
    pub inertial_pose: Isometry3<f64>,
    /// Velocity of the centre of mass, m/s, world axes.
    pub linear_velocity: Vector3<f64>,
    /// rad/s, world axes.
    pub angular_velocity: Vector3<f64>,
    /// kg; 0 is static.
    pub mass: f64,
    /// Principal moments of inertia, kg·m².
    pub inertia: Vector3<f64>,
}

/// State of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointState {
    /// rad or m.
    pub position: f64,
    /// rad/s or m/s.
    pub velocity: f64,
    /// N·m or N along the axis; 0 without feedback.
    pub effort: f64,
    /// Limits (lower, upper), rad or m; infinite without.
    pub limits: (f64, f64),
    /// Parent body.
    pub parent: usize,
    /// Child body.
    pub child: usize,
}

/// Where a joint with one coordinate is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointFrame {
    /// Whether the coordinate is an angle about the axis; else a distance along it.
    pub is_angular: bool,
    /// A point of the axis in the parent's inertial frame, m.
    pub pivot: Vector3<f64>,
    /// Direction of the axis in the parent's inertial frame, of unit length.
    pub axis: Vector3<f64>,
}

/// What a tool of a volume does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToolState {
    /// Radius of its tip, m.
    pub radius: f64,
    /// Whether it cuts what it touches.
    pub is_on: bool,
    /// Whether its tip touches.
    pub is_touching: bool,
    /// On its body, N, world axes.
    pub force: Vector3<f64>,
}

/// What a ray meets first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Rigid body; `None`: a soft body or a ghost object.
    pub body: Option<usize>,
    /// m, world axes.
    pub point: Vector3<f64>,
    /// Normal of the surface, of unit length, world axes.
    pub normal: Vector3<f64>,
    /// Share of the way from start to end, 0 to 1.
    pub fraction: f64,
}

/// A point where a body touches another, or nearly does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Touch {
    /// The other body; `None`: one that is not part of the scene's list.
    pub body: Option<usize>,
    /// On the surface of the body that was asked about, m, world axes.
    pub point: Vector3<f64>,
    /// From the other body to this one, of unit length, world axes.
    pub normal: Vector3<f64>,
    /// m; negative where they overlap.
    pub distance: f64,
    /// Along the normal in the last sub-step, N·s.
    pub impulse: f64,
}

/// The states of all bodies and joints after one step, by index. A removed one keeps its place with its last state.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StateSnapshot {
    /// When.
    pub clock: Clock,
    /// (bodies x 1).
    pub bodies: Vec<BodyState>,
    /// (joints x 1).
    pub joints: Vec<JointState>,
}

impl From<Clock> for RawClock {
    fn from(clock: Clock) -> Self {
        Self { sim_time: clock.sim_time, dt: clock.dt, step: clock.step }
    }
}

impl From<RawClock> for Clock {
    fn from(raw: RawClock) -> Self {
        Self { sim_time: raw.sim_time, dt: raw.dt, step: raw.step }
    }
}

impl From<&BodyState> for RawBody {
    fn from(state: &BodyState) -> Self {
        Self {
            pose: (&state.pose).into(),
            inertial_pose: (&state.inertial_pose).into(),
            linear_velocity: state.linear_velocity.into(),
            angular_velocity: state.angular_velocity.into(),
            mass: state.mass,
            inertia: state.inertia.into(),
        }
    }
}

impl From<&RawBody> for BodyState {
    fn from(raw: &RawBody) -> Self {
        Self {
            pose: raw.pose.pose().unwrap_or_default(),
            inertial_pose: raw.inertial_pose.pose().unwrap_or_default(),
            linear_velocity: raw.linear_velocity.into(),
            angular_velocity: raw.angular_velocity.into(),
            mass: raw.mass,
            inertia: raw.inertia.into(),
        }
    }
}

impl From<&JointState> for RawJoint {
    fn from(state: &JointState) -> Self {
        Self {
            position: state.position,
            velocity: state.velocity,
            effort: state.effort,
            lower: state.limits.0,
            upper: state.limits.1,
            parent: state.parent as u64,
            child: state.child as u64,
        }
    }
}

impl From<&RawJoint> for JointState {
    fn from(raw: &RawJoint) -> Self {
        Self {
            position: raw.position,
            velocity: raw.velocity,
            effort: raw.effort,
            limits: (raw.lower, raw.upper),
            parent: raw.parent as usize,
            child: raw.child as usize,
        }
    }
}

fn raw_body(body: Option<usize>) -> i64 {
    body.map_or(-1, |body| body as i64)
}

impl From<&Hit> for RawTouch {
    fn from(hit: &Hit) -> Self {
        Self {
            body: raw_body(hit.body),
            point: hit.point.into(),
            normal: hit.normal.into(),
            distance: hit.fraction,
            impulse: 0.0,
        }
    }
}

impl From<&RawTouch> for Hit {
    fn from(raw: &RawTouch) -> Self {
        Self {
            body: usize::try_from(raw.body).ok(),
            point: raw.point.into(),
            normal: raw.normal.into(),
            fraction: raw.distance,
        }
    }
}

impl From<&Touch> for RawTouch {
    fn from(touch: &Touch) -> Self {
        Self {
            body: raw_body(touch.body),
            point: touch.point.into(),
            normal: touch.normal.into(),
            distance: touch.distance,
            impulse: touch.impulse,
        }
    }
}

impl From<&RawTouch> for Touch {
    fn from(raw: &RawTouch) -> Self {
        Self {
            body: usize::try_from(raw.body).ok(),
            point: raw.point.into(),
            normal: raw.normal.into(),
            distance: raw.distance,
            impulse: raw.impulse,
        }
    }
}
