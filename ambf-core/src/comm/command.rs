use std::fmt;

use super::JointCommandType;
use nalgebra::Vector3;

use super::{Channel, Mailbox};

/// What the Cartesian part of a [`RigidBodyCommand`] asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CartesianCommandType {
    /// Force and torque at the centre of mass, world axes, held until the next command.
    #[default]
    Force,
    /// Pose of the body frame in the world: set directly on a static body, followed by the body's Cartesian controller
    /// otherwise.
    Position,
    /// Linear and angular velocity, world axes.
    Velocity,
    /// A value no client should send: nothing is applied.
    Unknown(i8),
}

impl From<i8> for CartesianCommandType {
    fn from(wire: i8) -> Self {
        match wire {
            0 => Self::Force,
            1 => Self::Position,
            2 => Self::Velocity,
            other => Self::Unknown(other),
        }
    }
}

/// A value that can wait in a [`Mailbox`](super::Mailbox) and be cleared by the watchdog.
pub trait Command: Default + Send {
    /// Overwrites `self` with `other`, reusing the memory of `self`.
    fn copy_from(&mut self, other: &Self);

    /// What is left of the command when no further one came within [`WATCHDOG_TIMEOUT`](super::WATCHDOG_TIMEOUT).
    fn expire(&mut self);

    /// Whether every number in it is finite.
    fn is_finite(&self) -> bool;

    /// Where commands of this type wait.
    fn mailbox(channel: &Channel) -> &Mailbox<Self>
    where
        Self: Sized;
}

fn all_finite<'a>(numbers: impl IntoIterator<Item = &'a f64>) -> bool {
    numbers.into_iter().all(|x| x.is_finite())
}

/// Command of one rigid body. The default asks for nothing: zero force, no joint commands.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RigidBodyCommand {
    /// What the Cartesian fields ask for.
    pub cartesian: CartesianCommandType,
    /// Position of the body frame in the world, m (for [`CartesianCommandType::Position`]).
    pub position: Vector3<f64>,
    /// Orientation of the body frame in the world as a quaternion `[x, y, z, w]`, as received: its norm is not checked
    /// here.
    pub orientation: [f64; 4],
    /// Force at the centre of mass, N, world axes.
    pub force: Vector3<f64>,
    /// Torque, N·m, world axes.
    pub torque: Vector3<f64>,
    /// Velocity of the centre of mass, m/s, world axes.
    pub linear_velocity: Vector3<f64>,
    /// Angular velocity, rad/s, world axes.
    pub angular_velocity: Vector3<f64>,
    /// (n x 1) value for the i-th active joint of the body; entries beyond the last joint are ignored.
    pub joint_commands: Vec<f64>,
    /// (m x 1) type of each joint command; missing ones count as [`JointCommandType::Effort`], surplus ones are
    /// ignored.
    pub joint_command_types: Vec<JointCommandType>,
    /// Asks for the children's names in the state from now on.
    pub publish_children_names: bool,
    /// Asks for the joints' names in the state from now on.
    pub publish_joint_names: bool,
    /// Asks for joint positions, velocities and efforts in the state while this command is in force.
    pub publish_joint_positions: bool,
}

impl RigidBodyCommand {
    /// A force (N) at the centre of mass and a torque (N·m), world axes.
    pub fn wrench(force: Vector3<f64>, torque: Vector3<f64>) -> Self {
        Self { cartesian: CartesianCommandType::Force, force, torque, ..Self::default() }
    }

    /// A linear velocity (m/s) and an angular one (rad/s), world axes.
    pub fn velocity(linear_velocity: Vector3<f64>, angular_velocity: Vector3<f64>) -> Self {
        Self { cartesian: CartesianCommandType::Velocity, linear_velocity, angular_velocity, ..Self::default() }
    }

    /// A pose of the body frame in the world, m; `orientation` is a quaternion `[x, y, z, w]`.
    pub fn pose(position: Vector3<f64>, orientation: [f64; 4]) -> Self {
        Self { cartesian: CartesianCommandType::Position, position, orientation, ..Self::default() }
    }
}

impl RigidBodyCommand {
    /// Whether it moves nothing: no force, and no joint command but efforts of 0.
    pub fn is_idle(&self) -> bool {
        let mut joints = self.joints();
        let cartesian = match self.cartesian {
            CartesianCommandType::Force => self.force == Vector3::zeros() && self.torque == Vector3::zeros(),
            CartesianCommandType::Position | CartesianCommandType::Velocity => false,
            CartesianCommandType::Unknown(_) => true,
        };
        cartesian && joints.all(|(_, kind, value)| kind == JointCommandType::Effort && value == 0.0)
    }

    /// Index, type and value of each joint command.
    fn joints(&self) -> impl Iterator<Item = (usize, JointCommandType, f64)> + '_ {
        let kinds = self.joint_command_types.iter().copied().chain(std::iter::repeat(JointCommandType::Effort));
        self.joint_commands.iter().zip(kinds).enumerate().map(|(index, (&value, kind))| (index, kind, value))
    }
}

/// Joint commands that are named; further ones are counted.
const JOINTS_SHOWN: usize = 6;

/// What it asks for, in words, in SI units and radians; efforts of 0 are left out.
impl fmt::Display for RigidBodyCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let vector = |v: &Vector3<f64>| format!("({:?}, {:?}, {:?})", v.x, v.y, v.z);
        let mut parts = match self.cartesian {
            _ if self.is_idle() => vec![String::from("nothing")],
            CartesianCommandType::Force if self.force == Vector3::zeros() && self.torque == Vector3::zeros() => {
                Vec::new()
            }
            CartesianCommandType::Force => {
                vec![format!("force {} N, torque {} N·m", vector(&self.force), vector(&self.torque))]
            }
            CartesianCommandType::Position => {
                let [x, y, z, w] = self.orientation;
                vec![format!("position {} m, orientation ({x:?}, {y:?}, {z:?}, {w:?})", vector(&self.position))]
            }
            CartesianCommandType::Velocity => {
                let (linear, angular) = (vector(&self.linear_velocity), vector(&self.angular_velocity));
                vec![format!("velocity {linear} m/s, {angular} rad/s")]
            }
            CartesianCommandType::Unknown(_) => Vec::new(),
        };
        let mut joints = self.joints().filter(|(_, kind, value)| *kind != JointCommandType::Effort || *value != 0.0);
        for (index, kind, value) in joints.by_ref().take(JOINTS_SHOWN) {
            parts.push(match kind {
                JointCommandType::Effort => format!("joint {index} effort {value:?}"),
                JointCommandType::Position => format!("joint {index} position {value:?}"),
                JointCommandType::Velocity => format!("joint {index} velocity {value:?}"),
                JointCommandType::Unknown(other) => format!("joint {index} type {other}, which is none"),
            });
        }
        let rest = joints.count();
        if rest > 0 {
            parts.push(format!("{rest} more joints"));
        }
        f.write_str(&parts.join(", "))
    }
}

impl Command for RigidBodyCommand {
    fn copy_from(&mut self, other: &Self) {
        let mut joint_commands = std::mem::take(&mut self.joint_commands);
        let mut joint_command_types = std::mem::take(&mut self.joint_command_types);
        joint_commands.clear();
        joint_commands.extend_from_slice(&other.joint_commands);
        joint_command_types.clear();
        joint_command_types.extend_from_slice(&other.joint_command_types);
        *self = Self { joint_commands, joint_command_types, ..*other };
    }

    /// Zero force, every joint command an effort of 0; array lengths, pose, twist and publish flags stay.
    fn expire(&mut self) {
        self.cartesian = CartesianCommandType::Force;
        self.force = Vector3::zeros();
        self.torque = Vector3::zeros();
        self.joint_commands.fill(0.0);
        self.joint_command_types.fill(JointCommandType::Effort);
    }

    fn is_finite(&self) -> bool {
        let vectors = [&self.position, &self.force, &self.torque, &self.linear_velocity, &self.angular_velocity];
        all_finite(vectors.into_iter().flatten()) && all_finite(&self.orientation) && all_finite(&self.joint_commands)
    }

    fn mailbox(channel: &Channel) -> &Mailbox<Self> {
        &channel.body
    }
}

/// Command of a camera or a light.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PoseCommand {
    /// While true the local pose is set to the fields below in each iteration.
    pub enabled: bool,
    /// Position in the parent's body frame (world without a parent), m.
    pub position: Vector3<f64>,
    /// Orientation as a quaternion `[x, y, z, w]`, as received.
    pub orientation: [f64; 4],
}

impl Command for PoseCommand {
    fn copy_from(&mut self, other: &Self) {
        *self = other.clone();
    }

    fn expire(&mut self) {
        self.enabled = false;
    }

    fn is_finite(&self) -> bool {
        all_finite(&self.position) && all_finite(&self.orientation)
    }

    fn mailbox(channel: &Channel) -> &Mailbox<Self> {
        &channel.pose
    }
}

/// Command of a soft body.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SoftBodyCommand {
    /// Force, N, world axes, shared among the nodes by mass.
    pub force: Vector3<f64>,
}

impl Command for SoftBodyCommand {
    fn copy_from(&mut self, other: &Self) {
        self.clone_from(other);
    }

    /// Zero force.
    fn expire(&mut self) {
        self.force = Vector3::zeros();
    }

    fn is_finite(&self) -> bool {
        all_finite(&self.force)
    }

    fn mailbox(channel: &Channel) -> &Mailbox<Self> {
        &channel.soft_body
    }
}

/// Command of a constraint actuator. The default holds nothing.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ActuatorCommand {
    /// Hold something; `false` releases it.
    pub actuate: bool,
    /// Text that names the rigid body to hold.
    pub body_name: String,
    /// Hold the body at the offset below instead of where it is.
    pub use_offset: bool,
    /// Position of the actuator in the body's inertial frame, m.
    pub offset_position: Vector3<f64>,
    /// Orientation of the actuator in the body's inertial frame, a quaternion `[x, y, z, w]`, as received.
    pub offset_orientation: [f64; 4],
    /// Hold what the rays of a sensor hit, not the body named above.
    pub use_sensor_data: bool,
    /// Text that names the sensor.
    pub sensor_identifier: String,
}

impl Command for ActuatorCommand {
    fn copy_from(&mut self, other: &Self) {
        self.clone_from(other);
    }

    /// Releases what is held.
    fn expire(&mut self) {
        self.actuate = false;
        self.body_name.clear();
    }

    fn is_finite(&self) -> bool {
        all_finite(&self.offset_position) && all_finite(&self.offset_orientation)
    }

    fn mailbox(channel: &Channel) -> &Mailbox<Self> {
        &channel.actuator
    }
}

/// Command of a sensor or a ghost object. It has no effect, but raises the rate at which the object is published.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SensorCommand;

impl Command for SensorCommand {
    fn copy_from(&mut self, _: &Self) {}

    fn expire(&mut self) {}

    fn is_finite(&self) -> bool {
        true
    }

    fn mailbox(channel: &Channel) -> &Mailbox<Self> {
        &channel.sensor
    }
}

/// Command of a vehicle. The default lets it roll.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct VehicleCommand {
    /// Force at the centre of mass of the chassis, N, world axes.
    pub force: Vector3<f64>,
    /// Torque on the chassis, N·m, world axes.
    pub torque: Vector3<f64>,
    /// (n x 1) steering angle of each wheel, rad, clamped to its limits; surplus entries are ignored, missing ones
    /// leave the wheel as it is.
    pub steering: Vec<f64>,
    /// (n x 1) engine force of each wheel, N, clamped to ± its maximum.
    pub power: Vec<f64>,
    /// (n x 1) brake of each wheel, N·s: the largest impulse of a sub-step, clamped to 0 and its maximum.
    pub brake: Vec<f64>,
    /// No power and full brake on all wheels.
    pub full_brake: bool,
}

impl Command for VehicleCommand {
    fn copy_from(&mut self, other: &Self) {
        self.clone_from(other);
    }

    /// No force, no torque, all wheels at 0, brake released; array lengths stay.
    fn expire(&mut self) {
        self.force = Vector3::zeros();
        self.torque = Vector3::zeros();
        self.steering.fill(0.0);
        self.power.fill(0.0);
        self.brake.fill(0.0);
        self.full_brake = false;
    }

    fn is_finite(&self) -> bool {
        let arrays = [&self.steering, &self.power, &self.brake];
        all_finite(&self.force) && all_finite(&self.torque) && all_finite(arrays.into_iter().flatten())
    }

    fn mailbox(channel: &Channel) -> &Mailbox<Self> {
        &channel.vehicle
    }
}

/// What a client may change of a camera through parameters.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CameraParameters {
    /// Near clipping plane, m.
    pub near_plane: f64,
    /// Far clipping plane, m.
    pub far_plane: f64,
    /// Vertical field of view, rad; used in perspective projection.
    pub field_view_angle: f64,
    /// Width of the view, m; used in orthographic projection.
    pub orthographic_view_width: f64,
    /// Distance between the eyes, m.
    pub stereo_eye_separation: f64,
    /// Focal length of the stereo pair, m.
    pub stereo_focal_length: f64,
    /// Orthographic instead of perspective projection.
    pub orthographic: bool,
    /// Passive left/right stereo instead of mono.
    pub stereo: bool,
    /// Text that names the parent object; empty: the parent is left as it is.
    pub parent_name: String,
}

/// What a client may change of a light through parameters.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LightParameters {
    /// Half angle of the spot's cone, rad.
    pub cutoff_angle: f64,
    /// Text that names the parent object; empty: the parent is left as it is.
    pub parent_name: String,
}

macro_rules! parameters_as_command {
    ($type:ty, $mailbox:ident, [$($number:ident),*]) => {
        impl Command for $type {
            fn copy_from(&mut self, other: &Self) {
                self.clone_from(other);
            }

            /// Parameters stay in force for good.
            fn expire(&mut self) {}

            fn is_finite(&self) -> bool {
                all_finite(&[$(self.$number),*])
            }

            fn mailbox(channel: &Channel) -> &Mailbox<Self> {
                &channel.$mailbox
            }
        }
    };
}

parameters_as_command!(
    CameraParameters,
    camera,
    [near_plane, far_plane, field_view_angle, orthographic_view_width, stereo_eye_separation, stereo_focal_length]
);
parameters_as_command!(LightParameters, light, [cutoff_angle]);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expiry_keeps_lengths_and_flags_but_moves_nothing() {
        let mut command = RigidBodyCommand {
            cartesian: CartesianCommandType::Velocity,
            force: Vector3::x(),
            joint_commands: vec![1.0, 2.0],
            joint_command_types: vec![JointCommandType::Position],
            publish_joint_names: true,
            ..Default::default()
        };
        command.expire();
        assert_eq!(command.cartesian, CartesianCommandType::Force);
        assert_eq!(command.force, Vector3::zeros());
        assert_eq!(command.joint_commands, [0.0, 0.0]);
        assert_eq!(command.joint_command_types, [JointCommandType::Effort]);
        assert!(command.publish_joint_names);
    }

    #[test]
    fn commands_are_said_in_words() {
        let said = |command: &RigidBodyCommand| command.to_string();
        assert_eq!(said(&RigidBodyCommand::default()), "nothing");
        let velocity = RigidBodyCommand::velocity(Vector3::new(1e308, 0.0, -0.5), Vector3::zeros());
        assert_eq!(said(&velocity), "velocity (1e308, 0.0, -0.5) m/s, (0.0, 0.0, 0.0) rad/s");
        let joints = RigidBodyCommand {
            joint_commands: vec![0.0, 0.3, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0],
            joint_command_types: vec![JointCommandType::Effort, JointCommandType::Position, JointCommandType::Velocity],
            ..Default::default()
        };
        let expected = "joint 1 position 0.3, joint 2 velocity 2.0, joint 3 effort 1.0, joint 4 effort 1.0, \
                        joint 5 effort 1.0, joint 6 effort 1.0, 2 more joints";
        assert_eq!(said(&joints), expected);
        let mut expired = RigidBodyCommand { force: Vector3::x(), ..joints };
        assert!(!expired.is_idle());
        expired.expire();
        assert!(expired.is_idle());
    }

    #[test]
    fn a_copy_reuses_memory() {
        let long = RigidBodyCommand { joint_commands: vec![1.0; 64], ..Default::default() };
        let mut target = RigidBodyCommand::default();
        target.copy_from(&long);
        let place = target.joint_commands.as_ptr();
        target.copy_from(&RigidBodyCommand { joint_commands: vec![2.0; 3], ..Default::default() });
        assert_eq!(target.joint_commands, [2.0; 3]);
        assert_eq!(target.joint_commands.as_ptr(), place);
    }

    #[test]
    fn one_bad_number_is_seen_wherever_it_hides() {
        let mut command = RigidBodyCommand::default();
        assert!(command.is_finite());
        command.joint_commands.push(f64::NAN);
        assert!(!command.is_finite());
        assert!(!PoseCommand { orientation: [0.0, 0.0, f64::INFINITY, 0.0], ..Default::default() }.is_finite());
    }
}
