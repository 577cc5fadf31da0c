use std::fmt;

use nalgebra::{Isometry3, Vector3};
use thiserror::Error;

use super::abi::{RawCommand, RawPose};
use crate::{ObjectId, ObjectType};

/// What one entry of the joint commands of a rigid body asks of its joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum JointCommandType {
    /// Effort: N·m (revolute) or N (prismatic).
    #[default]
    Effort,
    /// Position: rad or m, followed by the joint's controller.
    Position,
    /// Velocity: rad/s or m/s, by the joint's motor.
    Velocity,
    /// A value no client should send: the joint is left alone.
    Unknown(i8),
}

impl From<i8> for JointCommandType {
    fn from(wire: i8) -> Self {
        match wire {
            0 => Self::Effort,
            1 => Self::Position,
            2 => Self::Velocity,
            other => Self::Unknown(other),
        }
    }
}

/// What a plugin can make the simulation do. Objects are named by index in order of creation; vectors are in world
/// axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    /// Adds a force (N) at the centre of mass and a torque (N·m) to a body for the next step.
    Wrench {
        /// Rigid body.
        body: usize,
        /// N.
        force: Vector3<f64>,
        /// N·m.
        torque: Vector3<f64>,
    },
    /// Sets the velocity of a body; a static one is moved by it for one step.
    Velocity {
        /// Rigid body.
        body: usize,
        /// Velocity of the centre of mass, m/s.
        linear: Vector3<f64>,
        /// rad/s.
        angular: Vector3<f64>,
    },
    /// Puts the body frame at a pose in the world at once; velocities stay.
    Pose {
        /// Rigid body.
        body: usize,
        /// Body frame in the world.
        pose: Isometry3<f64>,
    },
    /// Lets the body's Cartesian controller follow a pose for one step; a static body is put there.
    FollowPose {
        /// Rigid body.
        body: usize,
        /// Body frame in the world.
        pose: Isometry3<f64>,
    },
    /// Commands a joint for the next step: effort, or its controller by position, or its motor by velocity.
    Joint {
        /// Joint.
        joint: usize,
        /// What the value is.
        kind: JointCommandType,
        /// N·m or N, rad or m, rad/s or m/s.
        value: f64,
    },
    /// Puts a camera, a light, a ghost object or a volume at a pose in its parent's frame.
    Place {
        /// Camera, light, ghost object or volume.
        object: ObjectId,
        /// Pose in the parent's frame.
        pose: Isometry3<f64>,
    },
    /// Fixes a body to an actuator where it is, or releases what it holds.
    Hold {
        /// Actuator.
        actuator: usize,
        /// Rigid body; `None`: release.
        body: Option<usize>,
    },
    /// Drives a wheel of a vehicle until the next command.
    Drive {
        /// Vehicle.
        vehicle: usize,
        /// Wheel.
        wheel: usize,
        /// rad, clamped to the wheel's limits.
        steering: f64,
        /// N, clamped to ± the wheel's maximum.
        power: f64,
        /// N·s, clamped to 0 and the wheel's maximum.
        brake: f64,
    },
    /// Adds a force (N) to a soft body for the next step, shared among its nodes by mass.
    SoftForce {
        /// Soft body.
        soft: usize,
        /// N.
        force: Vector3<f64>,
    },
    /// Draws a node of a soft body towards a point before each sub-step from now on, or releases it.
    PullNode {
        /// Soft body.
        soft: usize,
        /// Node.
        node: usize,
        /// m; `None`: release.
        goal: Option<Vector3<f64>>,
    },
    /// Holds two bodies together as they are now, until it is undone or the plugin is closed.
    Attach {
        /// Rigid body.
        body: usize,
        /// Another rigid body.
        to: usize,
    },
    /// Undoes an attachment of this plugin.
    Detach {
        /// What attaching gave.
        attachment: u64,
    },
    /// Asks for a reset of all objects before the next step; honoured also while paused.
    ResetWorld,
    /// Asks for a reset of the rigid bodies before the next step; honoured also while paused.
    ResetBodies,
    /// Pauses or resumes, if the program can.
    Pause(bool),
    /// Lets so many steps through while paused.
    Step(u32),
}

/// What it asks for, by the numbers of the objects.
impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Wrench { body, .. } => write!(f, "a wrench on body {body}"),
            Self::Velocity { body, .. } => write!(f, "a velocity of body {body}"),
            Self::Pose { body, .. } => write!(f, "a pose of body {body}"),
            Self::FollowPose { body, .. } => write!(f, "a pose for body {body} to follow"),
            Self::Joint { joint, .. } => write!(f, "a command of joint {joint}"),
            Self::Place { object, .. } => write!(f, "a pose of {} {}", object.kind.words(), object.index),
            Self::Hold { actuator, body: Some(body) } => write!(f, "body {body} for actuator {actuator} to hold"),
            Self::Hold { actuator, body: None } => write!(f, "a release by actuator {actuator}"),
            Self::Drive { vehicle, wheel, .. } => write!(f, "a drive of wheel {wheel} of vehicle {vehicle}"),
            Self::SoftForce { soft, .. } => write!(f, "a force on soft body {soft}"),
            Self::PullNode { soft, node, .. } => write!(f, "a pull at node {node} of soft body {soft}"),
            Self::Attach { body, to } => write!(f, "an attachment of body {body} to body {to}"),
            Self::Detach { attachment } => write!(f, "the end of attachment {attachment}"),
            Self::ResetWorld => f.write_str("a reset of the world"),
            Self::ResetBodies => f.write_str("a reset of the rigid bodies"),
            Self::Pause(true) => f.write_str("a pause"),
            Self::Pause(false) => f.write_str("the end of a pause"),
            Self::Step(steps) => write!(f, "{steps} steps of a pause"),
        }
    }
}

/// Why a command was not executed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum CommandError {
    /// Error when there is no such object, or no longer.
    #[error("there is no such object")]
    NoObject,
    /// Error when a number is NaN or infinite, or a quaternion has no length.
    #[error("a number is not finite or an orientation is none")]
    NotFinite,
    /// Error when the object cannot do that, such as a body attached to itself.
    #[error("the object cannot do that")]
    Refused,
    /// Error when the simulation is not within reach: outside a callback that physics makes, or in another thread.
    #[error("the simulation can be changed only in a callback of the physics thread; elsewhere, post the command")]
    Outside,
    /// Error when more commands wait than are kept.
    #[error("too many commands wait")]
    Full,
    /// Error when the other side of the interface does not know the command.
    #[error("the command is not known")]
    Unknown,
    /// Error when more is to be shown in windows than they take.
    #[error("too much is to be shown at a time")]
    TooMuch,
}

impl CommandError {
    pub(crate) const ALL: [Self; 7] =
        [Self::NoObject, Self::NotFinite, Self::Refused, Self::Outside, Self::Full, Self::Unknown, Self::TooMuch];

    /// −1, −2, … in the order above.
    pub(crate) fn status(self) -> i64 {
        -1 - Self::ALL.iter().position(|error| *error == self).unwrap_or(0) as i64
    }

    pub(crate) fn of_status(status: i64) -> Self {
        let place = usize::try_from(status.saturating_neg() - 1);
        place.ok().and_then(|place| Self::ALL.get(place).copied()).unwrap_or(Self::Unknown)
    }
}

/// A result as a number: that of an error is negative.
pub(crate) fn status_of(result: Result<u64, CommandError>) -> i64 {
    result.map_or_else(CommandError::status, |value| value as i64)
}

/// The result with a number.
pub(crate) fn of_status(status: i64) -> Result<u64, CommandError> {
    u64::try_from(status).map_err(|_| CommandError::of_status(status))
}

/// An object that is not there, where one may be left out.
const NOBODY: i64 = -1;

impl Command {
    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        let vector = |v: &Vector3<f64>| v.iter().all(|x| x.is_finite());
        let finite_pose = |pose: &Isometry3<f64>| RawPose::from(pose).pose().is_some();
        match self {
            Self::Wrench { force, torque, .. } => vector(force) && vector(torque),
            Self::Velocity { linear, angular, .. } => vector(linear) && vector(angular),
            Self::Pose { pose, .. } | Self::FollowPose { pose, .. } | Self::Place { pose, .. } => finite_pose(pose),
            Self::Joint { value, .. } => value.is_finite(),
            Self::Drive { steering, power, brake, .. } => [steering, power, brake].iter().all(|x| x.is_finite()),
            Self::SoftForce { force, .. } => vector(force),
            Self::PullNode { goal, .. } => goal.as_ref().is_none_or(vector),
            Self::Hold { .. } | Self::Attach { .. } | Self::Detach { .. } => true,
            Self::ResetWorld | Self::ResetBodies | Self::Pause(_) | Self::Step(_) => true,
        }
    }

    pub(crate) fn raw(&self) -> RawCommand {
        let raw = |code, index: usize| RawCommand { code, index: index as u64, ..RawCommand::default() };
        let six = |a: &Vector3<f64>, b: &Vector3<f64>| [a.x, a.y, a.z, b.x, b.y, b.z, 0.0, 0.0];
        let three = |v: &Vector3<f64>| six(v, &Vector3::zeros());
        let seven = |pose: &Isometry3<f64>| {
            let RawPose { position: [x, y, z], orientation: [i, j, k, w] } = pose.into();
            [x, y, z, i, j, k, w, 0.0]
        };
        match *self {
            Self::Wrench { body, force, torque } => RawCommand { numbers: six(&force, &torque), ..raw(1, body) },
            Self::Velocity { body, linear, angular } => RawCommand { numbers: six(&linear, &angular), ..raw(2, body) },
            Self::Pose { body, pose } => RawCommand { numbers: seven(&pose), ..raw(3, body) },
            Self::FollowPose { body, pose } => RawCommand { numbers: seven(&pose), ..raw(4, body) },
            Self::Joint { joint, kind, value } => {
                let kind = match kind {
                    JointCommandType::Effort => 0,
                    JointCommandType::Position => 1,
                    JointCommandType::Velocity => 2,
                    JointCommandType::Unknown(_) => u32::MAX,
                };
                RawCommand { kind, numbers: three(&Vector3::new(value, 0.0, 0.0)), ..raw(5, joint) }
            }
            Self::Place { object, pose } => {
                RawCommand { kind: object.kind as u32, numbers: seven(&pose), ..raw(6, object.index) }
            }
            Self::Hold { actuator, body } => {
                RawCommand { other: body.map_or(NOBODY, |body| body as i64), ..raw(7, actuator) }
            }
            Self::Drive { vehicle, wheel, steering, power, brake } => RawCommand {
                other: wheel as i64,
                numbers: three(&Vector3::new(steering, power, brake)),
                ..raw(8, vehicle)
            },
            Self::SoftForce { soft, force } => RawCommand { numbers: three(&force), ..raw(9, soft) },
            Self::PullNode { soft, node, goal } => RawCommand {
                kind: u32::from(goal.is_some()),
                other: node as i64,
                numbers: three(&goal.unwrap_or_default()),
                ..raw(10, soft)
            },
            Self::Attach { body, to } => RawCommand { other: to as i64, ..raw(11, body) },
            Self::Detach { attachment } => RawCommand { index: attachment, ..raw(12, 0) },
            Self::ResetWorld => raw(13, 0),
            Self::ResetBodies => raw(14, 0),
            Self::Pause(pause) => RawCommand { kind: u32::from(pause), ..raw(15, 0) },
            Self::Step(steps) => RawCommand { kind: steps, ..raw(16, 0) },
        }
    }

    pub(crate) fn from_raw(raw: &RawCommand) -> Result<Self, CommandError> {
        let n = &raw.numbers;
        let first = Vector3::new(n[0], n[1], n[2]);
        let second = Vector3::new(n[3], n[4], n[5]);
        let pose = || {
            let raw = RawPose { position: [n[0], n[1], n[2]], orientation: [n[3], n[4], n[5], n[6]] };
            raw.pose().ok_or(CommandError::NotFinite)
        };
        let index = usize::try_from(raw.index).map_err(|_| CommandError::NoObject)?;
        let other = || usize::try_from(raw.other).map_err(|_| CommandError::NoObject);
        let command = match raw.code {
            1 => Self::Wrench { body: index, force: first, torque: second },
            2 => Self::Velocity { body: index, linear: first, angular: second },
            3 => Self::Pose { body: index, pose: pose()? },
            4 => Self::FollowPose { body: index, pose: pose()? },
            5 => {
                let kind = match raw.kind {
                    0 => JointCommandType::Effort,
                    1 => JointCommandType::Position,
                    2 => JointCommandType::Velocity,
                    _ => return Err(CommandError::Unknown),
                };
                Self::Joint { joint: index, kind, value: n[0] }
            }
            6 => {
                let kind = ObjectType::from_number(raw.kind).ok_or(CommandError::Unknown)?;
                Self::Place { object: ObjectId { kind, index }, pose: pose()? }
            }
            7 => Self::Hold { actuator: index, body: if raw.other == NOBODY { None } else { Some(other()?) } },
            8 => Self::Drive { vehicle: index, wheel: other()?, steering: n[0], power: n[1], brake: n[2] },
            9 => Self::SoftForce { soft: index, force: first },
            10 => Self::PullNode { soft: index, node: other()?, goal: (raw.kind != 0).then_some(first) },
            11 => Self::Attach { body: index, to: other()? },
            12 => Self::Detach { attachment: raw.index },
            13 => Self::ResetWorld,
            14 => Self::ResetBodies,
            15 => Self::Pause(raw.kind != 0),
            16 => Self::Step(raw.kind),
            _ => return Err(CommandError::Unknown),
        };
        if command.is_finite() {
            Ok(command)
        } else {
            Err(CommandError::NotFinite)
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    #[test]
    fn commands_are_said_in_words() {
        let place = Command::Place { object: ObjectId::new(ObjectType::Ghost, 2), pose: Isometry3::identity() };
        assert_eq!(place.to_string(), "a pose of ghost object 2");
        let wrench = Command::Wrench { body: 3, force: Vector3::x(), torque: Vector3::y() };
        assert_eq!(wrench.to_string(), "a wrench on body 3");
    }

    #[test]
    fn commands_cross_the_interface_unchanged() {
        let v = Vector3::new(1.0, -2.0, 3.0);
        let pose = Isometry3::from_parts(v.into(), UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3));
        for command in [
            Command::Wrench { body: 3, force: v, torque: -v },
            Command::Velocity { body: 3, linear: v, angular: -v },
            Command::Pose { body: 1, pose },
            Command::FollowPose { body: 1, pose },
            Command::Joint { joint: 2, kind: JointCommandType::Effort, value: 5.0 },
            Command::Joint { joint: 2, kind: JointCommandType::Position, value: 5.0 },
            Command::Joint { joint: 2, kind: JointCommandType::Velocity, value: -5.0 },
            Command::Place { object: ObjectId::new(ObjectType::Light, 4), pose },
            Command::Hold { actuator: 0, body: Some(0) },
            Command::Hold { actuator: 0, body: None },
            Command::Drive { vehicle: 0, wheel: 3, steering: 0.1, power: 2.0, brake: 3.0 },
            Command::SoftForce { soft: 0, force: v },
            Command::PullNode { soft: 0, node: 7, goal: Some(v) },
            Command::PullNode { soft: 0, node: 7, goal: None },
            Command::Attach { body: 1, to: 0 },
            Command::Detach { attachment: u64::MAX >> 1 },
            Command::ResetWorld,
            Command::ResetBodies,
            Command::Pause(true),
            Command::Pause(false),
            Command::Step(10),
        ] {
            assert_eq!(Command::from_raw(&command.raw()), Ok(command));
        }
    }

    #[test]
    fn what_is_no_command_is_refused() {
        let refused = |raw: RawCommand| Command::from_raw(&raw).unwrap_err();
        assert_eq!(refused(RawCommand { code: 0, ..Default::default() }), CommandError::Unknown);
        assert_eq!(refused(RawCommand { code: 5, kind: 9, ..Default::default() }), CommandError::Unknown);
        assert_eq!(refused(RawCommand { code: 3, ..Default::default() }), CommandError::NotFinite, "no orientation");
        let numbers = [f64::INFINITY; 8];
        assert_eq!(refused(RawCommand { code: 1, numbers, ..Default::default() }), CommandError::NotFinite);
        assert_eq!(refused(RawCommand { code: 11, other: -1, ..Default::default() }), CommandError::NoObject);
    }

    #[test]
    fn every_error_has_its_number() {
        for error in CommandError::ALL {
            assert_eq!(CommandError::of_status(error.status()), error);
        }
        assert_eq!(CommandError::of_status(i64::MIN), CommandError::Unknown);
    }
}
