//! Services of an arm, which ask about it and change nothing: its kinematics, its state.

use std::sync::Arc;

use ambf_plugin::SnapshotSlot;
use rosrust::{Message as RosMessage, RosMsg, ServicePair};

use crate::arm::{ArmModel, PoseMessage};
use crate::exchange::{ArmStatus, Status};
use crate::kinematics::Coordinates;
use crate::messages::{self, crtk_msgs, Header};
use crate::transport::Answer;

/// What is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Query {
    /// The pose of the control point for joint positions: in the base if local, else in the reference frame as it is now.
    Forward {
        /// In the base.
        is_local: bool,
    },
    /// Joint positions for a pose in the reference frame as it is now.
    Inverse,
    /// The operating state.
    State,
}

/// Type of a service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServiceType {
    /// `package/Type`.
    pub name: String,
    /// Checksum of its definition, as ROS 1 makes it.
    pub md5sum: String,
    /// Definition of the request, with those of the types in it.
    pub request: String,
    /// The same of the response.
    pub response: String,
}

/// A service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Service {
    /// Full name, from `/` on.
    pub name: String,
    /// What is asked.
    pub query: Query,
}

impl Query {
    /// Its type.
    pub fn kind(self) -> ServiceType {
        fn of<S: ServicePair>() -> ServiceType
        where
            S::Request: RosMessage,
            S::Response: RosMessage,
        {
            let (request, response) = (S::Request::msg_definition(), S::Response::msg_definition());
            ServiceType { name: S::msg_type(), md5sum: S::md5sum(), request, response }
        }
        match self {
            Self::Forward { .. } => of::<crtk_msgs::QueryForwardKinematics>(),
            Self::Inverse => of::<crtk_msgs::QueryInverseKinematics>(),
            Self::State => of::<crtk_msgs::TriggerOperatingState>(),
        }
    }
}

/// Services of an arm whose names begin with `space`, such as `/PSM1`.
pub fn services(space: &str, has_tool: bool) -> Vec<Service> {
    let space = space.trim_end_matches('/');
    let named = |name: &str, query| Service { name: format!("{space}/{name}"), query };
    let mut all = vec![named("operating_state", Query::State)];
    if has_tool {
        all.push(named("forward_kinematics", Query::Forward { is_local: false }));
        all.push(named("local/forward_kinematics", Query::Forward { is_local: true }));
        all.push(named("inverse_kinematics", Query::Inverse));
    }
    all
}

/// What answers `query` about the arm `model`, which is at `place` in `status`.
pub fn answers(query: Query, model: &Arc<ArmModel>, place: usize, status: &Arc<SnapshotSlot<Status>>) -> Answer {
    let (model, status) = (Arc::clone(model), Arc::clone(status));
    Arc::new(move |request| {
        let status = status.load_full();
        let arm = status.as_ref().and_then(|status| status.arms.get(place));
        answer(query, &model, arm, request)
    })
}

fn answer(query: Query, model: &ArmModel, status: Option<&ArmStatus>, request: &[u8]) -> Result<Vec<u8>, String> {
    let unreadable = || "the request cannot be read".to_owned();
    match query {
        Query::Forward { is_local } => {
            let positions = messages::read_forward(request).ok_or_else(unreadable)?;
            let found = forward(model, status, &positions, is_local);
            let (result, message) = outcome(&found);
            let cp = messages::pose(&found.unwrap_or_default());
            encoded(&crtk_msgs::QueryForwardKinematicsRes { cp, result, message })
        }
        Query::Inverse => {
            let (pose, near) = messages::read_inverse(request).ok_or_else(unreadable)?;
            let found = inverse(model, status, &pose, &near);
            let (result, message) = outcome(&found);
            let jp = found.map(|q| messages::joint_list(&q, model.count())).unwrap_or_default();
            encoded(&crtk_msgs::QueryInverseKinematicsRes { jp, result, message })
        }
        Query::State => {
            let state = status.ok_or("the simulation has made no step yet")?.state;
            let head = Header { stamp: state.stamp, frame: model.frames.reference.clone() };
            let operating_state = crtk_msgs::OperatingState {
                header: messages::header(&head),
                state: state.state.to_string(),
                is_homed: state.is_homed,
                is_busy: state.is_busy,
            };
            encoded(&crtk_msgs::TriggerOperatingStateRes { operating_state })
        }
    }
}

fn outcome<T>(found: &Result<T, String>) -> (bool, String) {
    (found.is_ok(), found.as_ref().err().cloned().unwrap_or_default())
}

fn encoded(message: &impl RosMessage) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    RosMsg::encode(message, &mut bytes).map_err(|error| error.to_string())?;
    Ok(bytes)
}

/// Joint positions of the arm: as many as it has, finite.
fn coordinates(model: &ArmModel, positions: &[f64]) -> Result<Coordinates, String> {
    let expected = model.count();
    if positions.len() != expected {
        return Err(format!("{} values, expected {expected}", positions.len()));
    }
    if positions.iter().any(|value| !value.is_finite()) {
        return Err("a number is not finite".into());
    }
    let mut q = Coordinates::zeros();
    q.as_mut_slice()[..expected].copy_from_slice(positions);
    Ok(q)
}

/// What is known of the arm in the scene.
fn reading(status: Option<&ArmStatus>) -> Result<&crate::bind::Reading, String> {
    status.and_then(|status| status.reading.as_ref()).ok_or_else(|| "the arm is not in the scene".into())
}

fn forward(
    model: &ArmModel,
    status: Option<&ArmStatus>,
    positions: &[f64],
    is_local: bool,
) -> Result<nalgebra::Isometry3<f64>, String> {
    let in_base = model.kinematics.chain.forward(&coordinates(model, positions)?);
    if is_local {
        return Ok(in_base);
    }
    let reading = reading(status)?;
    Ok(reading.reference.pose.inv_mul(&(reading.base.pose * in_base)))
}

fn inverse(
    model: &ArmModel,
    status: Option<&ArmStatus>,
    pose: &PoseMessage,
    near: &[f64],
) -> Result<Coordinates, String> {
    let pose = pose.pose().map_err(|refusal| refusal.to_string())?;
    let reading = reading(status)?;
    let near = if near.is_empty() { reading.measured.position } else { coordinates(model, near)? };
    let in_base = reading.base.pose.inv_mul(&(reading.reference.pose * pose));
    let q = model.kinematics.inverse(&in_base, &near, &model.limits).map_err(|error| error.to_string())?;
    model.joints_within_limits(q).map_err(|refusal| refusal.to_string())
}
