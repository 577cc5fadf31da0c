//! Values as bytes: numbers little-endian, lists with their length before them, enumerations by number.

use std::borrow::Cow;

use ambf_volume::{Rule, Shape};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use thiserror::Error;

use crate::adf::{Gains, ObjectType, ToolBall, ToolBurr, VolumeTool};
use crate::comm::{
    ActuatorCommand, CameraParameters, CartesianCommandType, CarveCommand, JointCommandType, LightParameters,
    PoseCommand, RigidBodyCommand, SoftBodyCommand, VehicleCommand,
};
use crate::ids::{BodyId, JointId};
use crate::plugin::{Command, ObjectId};
use crate::scene::{CameraGesture, ParameterChange, StateChange};

/// Error when bytes are no entry of a recording.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum CodeError {
    /// Error when bytes are missing at the end.
    #[error("an entry ends before it is complete")]
    Short,
    /// Error when bytes are left over.
    #[error("an entry is {0} bytes longer than expected")]
    Long(usize),
    /// Error when a number stands for nothing this version knows: the recording was made by a later one, or is corrupt.
    #[error("{what} {number} is not known: the recording was made by a later version, or is corrupt")]
    Unknown {
        /// What the number stands for.
        what: &'static str,
        /// The number.
        number: u64,
    },
    /// Error when an entry repeats another that is not there.
    #[error("an entry repeats one that is not there")]
    NoneBefore,
    /// Error when a text is not UTF-8.
    #[error("a text is not UTF-8")]
    Text,
}

/// Bytes that are read from the front.
pub(super) struct Source<'a>(pub &'a [u8]);

impl<'a> Source<'a> {
    fn bytes(&mut self, count: usize) -> Result<&'a [u8], CodeError> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(CodeError::Short)?;
        self.0 = rest;
        Ok(taken)
    }
}

/// A value that can be written as bytes and read again, bit for bit.
pub(super) trait Coded: Sized {
    fn put(&self, out: &mut Vec<u8>);
    fn take(from: &mut Source<'_>) -> Result<Self, CodeError>;
}

macro_rules! numbers {
    ($($type:ty),*) => {$(
        impl Coded for $type {
            fn put(&self, out: &mut Vec<u8>) {
                out.extend_from_slice(&self.to_le_bytes());
            }

            fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
                let bytes = from.bytes(std::mem::size_of::<Self>())?;
                Ok(Self::from_le_bytes(bytes.try_into().expect("as many bytes as were asked for")))
            }
        }
    )*};
}

numbers!(u8, i8, u32, u64, i64, f64);

impl Coded for bool {
    fn put(&self, out: &mut Vec<u8>) {
        out.push(u8::from(*self));
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        match u8::take(from)? {
            0 => Ok(false),
            1 => Ok(true),
            other => Err(CodeError::Unknown { what: "truth value", number: other.into() }),
        }
    }
}

/// Indices; worlds have fewer than 2³² objects.
impl Coded for usize {
    fn put(&self, out: &mut Vec<u8>) {
        u32::try_from(*self).unwrap_or(u32::MAX).put(out);
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        Ok(u32::take(from)? as Self)
    }
}

impl Coded for String {
    fn put(&self, out: &mut Vec<u8>) {
        self.len().put(out);
        out.extend_from_slice(self.as_bytes());
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        let length = usize::take(from)?;
        String::from_utf8(from.bytes(length)?.to_vec()).map_err(|_| CodeError::Text)
    }
}

impl<T: Coded> Coded for Vec<T> {
    fn put(&self, out: &mut Vec<u8>) {
        self.len().put(out);
        self.iter().for_each(|item| item.put(out));
    }

    /// Memory is taken as items are read: a length says nothing about what follows.
    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        let count = usize::take(from)?;
        // Each item takes a byte at least.
        if count > from.0.len() {
            return Err(CodeError::Short);
        }
        (0..count).map(|_| T::take(from)).collect()
    }
}

impl<T: Coded> Coded for Option<T> {
    fn put(&self, out: &mut Vec<u8>) {
        self.is_some().put(out);
        if let Some(value) = self {
            value.put(out);
        }
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        bool::take(from)?.then(|| T::take(from)).transpose()
    }
}

impl<T: Coded, const N: usize> Coded for [T; N] {
    fn put(&self, out: &mut Vec<u8>) {
        self.iter().for_each(|item| item.put(out));
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        let items = (0..N).map(|_| T::take(from)).collect::<Result<Vec<_>, _>>()?;
        Ok(items.try_into().unwrap_or_else(|_| unreachable!("as many items as were read")))
    }
}

impl<A: Coded, B: Coded> Coded for (A, B) {
    fn put(&self, out: &mut Vec<u8>) {
        self.0.put(out);
        self.1.put(out);
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        Ok((A::take(from)?, B::take(from)?))
    }
}

impl<T: Coded + Clone> Coded for Cow<'_, T> {
    fn put(&self, out: &mut Vec<u8>) {
        T::put(self, out);
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        T::take(from).map(Cow::Owned)
    }
}

impl Coded for Vector3<f64> {
    fn put(&self, out: &mut Vec<u8>) {
        self.iter().for_each(|number| number.put(out));
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        Ok(Self::from(<[f64; 3]>::take(from)?))
    }
}

/// x, y, z, w, as they are.
impl Coded for UnitQuaternion<f64> {
    fn put(&self, out: &mut Vec<u8>) {
        self.coords.iter().for_each(|number| number.put(out));
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        let [x, y, z, w] = <[f64; 4]>::take(from)?;
        Ok(Self::new_unchecked(Quaternion::new(w, x, y, z)))
    }
}

impl Coded for Isometry3<f64> {
    fn put(&self, out: &mut Vec<u8>) {
        self.translation.vector.put(out);
        self.rotation.put(out);
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        let translation = Translation3::from(Vector3::take(from)?);
        Ok(Self::from_parts(translation, UnitQuaternion::take(from)?))
    }
}

macro_rules! ids {
    ($($id:ty),*) => {$(
        impl Coded for $id {
            fn put(&self, out: &mut Vec<u8>) {
                self.index().put(out);
            }

            fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
                usize::take(from).map(Self::new)
            }
        }
    )*};
}

ids!(BodyId, JointId);

impl Coded for ObjectType {
    fn put(&self, out: &mut Vec<u8>) {
        out.push(*self as u8);
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        let number = u8::take(from)?;
        let found = Self::ALL.into_iter().find(|kind| *kind as u8 == number);
        found.ok_or(CodeError::Unknown { what: "object type", number: number.into() })
    }
}

macro_rules! structs {
    ($($type:ident { $($field:ident),* })*) => {$(
        impl Coded for $type {
            fn put(&self, out: &mut Vec<u8>) {
                // All fields by name, so that no new one is forgotten.
                let Self { $($field),* } = self;
                $($field.put(out);)*
            }

            fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
                // In the order in which they are written here.
                $(let $field = Coded::take(from)?;)*
                Ok(Self { $($field),* })
            }
        }
    )*};
}

structs! {
    ObjectId { kind, index }
    PoseCommand { enabled, position, orientation }
    SoftBodyCommand { force }
    ActuatorCommand {
        actuate, body_name, use_offset, offset_position, offset_orientation, use_sensor_data, sensor_identifier
    }
    CarveCommand { shape, from, to, in_world, rule }
    VolumeTool { body, tip, cursors, rate, on, stiffness, damping, friction, largest_force, burrs }
    ToolBall { position, radius }
    ToolBurr { body, radius, rate, count }
    VehicleCommand { force, torque, steering, power, brake, full_brake }
    CameraParameters {
        near_plane, far_plane, field_view_angle, orthographic_view_width, stereo_eye_separation, stereo_focal_length,
        orthographic, stereo, parent_name
    }
    LightParameters { cutoff_angle, parent_name }
    Gains { p, i, d }
    StateChange { positions, rates, poses, twists }
    ParameterChange {
        masses, inertias, frictions, restitutions, dampings, gravity, gravities, body_gains, colors, limits,
        joint_dampings, joint_frictions, joint_gains
    }
}

impl Coded for Shape {
    fn put(&self, out: &mut Vec<u8>) {
        match self {
            Self::Sphere { radius } => (0_u8, *radius).put(out),
            Self::Capsule { radius, half_length } => (1_u8, [*radius, *half_length]).put(out),
            Self::Box { half_edges } => (2_u8, *half_edges).put(out),
            Self::Voxels(voxels) => {
                3_u8.put(out);
                voxels.put(out);
            }
        }
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        Ok(match u8::take(from)? {
            0 => Self::Sphere { radius: Coded::take(from)? },
            1 => {
                let [radius, half_length] = Coded::take(from)?;
                Self::Capsule { radius, half_length }
            }
            2 => Self::Box { half_edges: Coded::take(from)? },
            3 => Self::Voxels(Coded::take(from)?),
            number => return Err(CodeError::Unknown { what: "shape of a cut", number: number.into() }),
        })
    }
}

impl Coded for Rule {
    fn put(&self, out: &mut Vec<u8>) {
        match *self {
            Self::All => 0_u8.put(out),
            Self::Rate { rate, interval } => (1_u8, [rate, interval]).put(out),
            Self::Count(voxels) => (2_u8, voxels).put(out),
        }
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        Ok(match u8::take(from)? {
            0 => Self::All,
            1 => {
                let [rate, interval] = Coded::take(from)?;
                Self::Rate { rate, interval }
            }
            2 => Self::Count(Coded::take(from)?),
            number => return Err(CodeError::Unknown { what: "rule of a cut", number: number.into() }),
        })
    }
}

impl Coded for JointCommandType {
    fn put(&self, out: &mut Vec<u8>) {
        let number = match *self {
            Self::Effort => 0,
            Self::Position => 1,
            Self::Velocity => 2,
            Self::Unknown(other) => other,
        };
        number.put(out);
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        i8::take(from).map(Self::from)
    }
}

/// Only the fields that its type gives a meaning; flags about what is published are no part of it.
impl Coded for RigidBodyCommand {
    fn put(&self, out: &mut Vec<u8>) {
        let pair = |number: i8, first: &[f64], second: &[f64], out: &mut Vec<u8>| {
            number.put(out);
            first.iter().chain(second).for_each(|number| number.put(out));
        };
        match self.cartesian {
            CartesianCommandType::Force => pair(0, self.force.as_slice(), self.torque.as_slice(), out),
            CartesianCommandType::Position => pair(1, self.position.as_slice(), &self.orientation, out),
            CartesianCommandType::Velocity => {
                pair(2, self.linear_velocity.as_slice(), self.angular_velocity.as_slice(), out);
            }
            CartesianCommandType::Unknown(other) => pair(other, &[], &[], out),
        }
        self.joint_commands.put(out);
        self.joint_command_types.put(out);
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        let mut command = Self { cartesian: i8::take(from)?.into(), ..Self::default() };
        match command.cartesian {
            CartesianCommandType::Force => (command.force, command.torque) = Coded::take(from)?,
            CartesianCommandType::Position => (command.position, command.orientation) = Coded::take(from)?,
            CartesianCommandType::Velocity => {
                (command.linear_velocity, command.angular_velocity) = Coded::take(from)?;
            }
            CartesianCommandType::Unknown(_) => (),
        }
        command.joint_commands = Coded::take(from)?;
        command.joint_command_types = Coded::take(from)?;
        Ok(command)
    }
}

impl Coded for CameraGesture {
    fn put(&self, out: &mut Vec<u8>) {
        match *self {
            Self::Pan { right, up } => (0_u8, [right, up]).put(out),
            Self::Shift(by) => (1_u8, by).put(out),
            Self::Look { left, up } => (2_u8, [left, up]).put(out),
            Self::Orbit { right, up } => (3_u8, [right, up]).put(out),
            Self::Dolly { forward } => (4_u8, forward).put(out),
        }
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        let number = u8::take(from)?;
        let mut two = || <[f64; 2]>::take(from);
        Ok(match number {
            0 => two().map(|[right, up]| Self::Pan { right, up })?,
            1 => Self::Shift(Coded::take(from)?),
            2 => two().map(|[left, up]| Self::Look { left, up })?,
            3 => two().map(|[right, up]| Self::Orbit { right, up })?,
            4 => Self::Dolly { forward: Coded::take(from)? },
            number => return Err(CodeError::Unknown { what: "camera gesture", number: number.into() }),
        })
    }
}

/// Commands of plugins that move something; what a plugin asks of the loop is recorded as what the loop does.
impl Coded for Command {
    fn put(&self, out: &mut Vec<u8>) {
        match *self {
            Self::Wrench { body, force, torque } => ((0_u8, body), (force, torque)).put(out),
            Self::Velocity { body, linear, angular } => ((1_u8, body), (linear, angular)).put(out),
            Self::Pose { body, pose } => ((2_u8, body), pose).put(out),
            Self::FollowPose { body, pose } => ((3_u8, body), pose).put(out),
            Self::Joint { joint, kind, value } => ((4_u8, joint), (kind, value)).put(out),
            Self::Place { object, pose } => ((5_u8, object), pose).put(out),
            Self::Hold { actuator, body } => ((6_u8, actuator), body).put(out),
            Self::Drive { vehicle, wheel, steering, power, brake } => {
                ((7_u8, vehicle), (wheel, [steering, power, brake])).put(out);
            }
            Self::SoftForce { soft, force } => ((8_u8, soft), force).put(out),
            Self::PullNode { soft, node, goal } => ((9_u8, soft), (node, goal)).put(out),
            Self::Attach { body, to } => ((10_u8, body), to).put(out),
            Self::Detach { attachment } => (11_u8, attachment).put(out),
            Self::ResetWorld => 12_u8.put(out),
            Self::ResetBodies => 13_u8.put(out),
            Self::Pause(pause) => (14_u8, pause).put(out),
            Self::Step(steps) => (15_u8, steps).put(out),
        }
    }

    fn take(from: &mut Source<'_>) -> Result<Self, CodeError> {
        let number = u8::take(from)?;
        macro_rules! fields {
            ($variant:ident { $($field:ident),* }) => {{
                $(let $field = Coded::take(from)?;)*
                Self::$variant { $($field),* }
            }};
        }
        Ok(match number {
            0 => fields!(Wrench { body, force, torque }),
            1 => fields!(Velocity { body, linear, angular }),
            2 => fields!(Pose { body, pose }),
            3 => fields!(FollowPose { body, pose }),
            4 => fields!(Joint { joint, kind, value }),
            5 => fields!(Place { object, pose }),
            6 => fields!(Hold { actuator, body }),
            7 => fields!(Drive { vehicle, wheel, steering, power, brake }),
            8 => fields!(SoftForce { soft, force }),
            9 => fields!(PullNode { soft, node, goal }),
            10 => fields!(Attach { body, to }),
            11 => fields!(Detach { attachment }),
            12 => Self::ResetWorld,
            13 => Self::ResetBodies,
            14 => Self::Pause(Coded::take(from)?),
            15 => Self::Step(Coded::take(from)?),
            number => return Err(CodeError::Unknown { what: "command of a plugin", number: number.into() }),
        })
    }
}
