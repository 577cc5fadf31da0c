//! What can enter a simulation, as values that can be written and read again.

use std::borrow::Cow;

use nalgebra::{Isometry3, Vector3};

use super::codec::{CodeError, Coded, Source};
use crate::adf::VolumeTool;
use crate::comm::{
    ActuatorCommand, CameraParameters, CarveCommand, JointCommandType, LightParameters, PoseCommand, RigidBodyCommand,
    SoftBodyCommand, VehicleCommand,
};
use crate::plugin::{Command, ObjectId};
use crate::scene::{CameraGesture, ParameterChange, StateChange};

macro_rules! entries {
    ($($(#[$doc:meta])* $number:literal $variant:ident { $($(#[$field_doc:meta])* $field:ident: $type:ty),* $(,)? })*) => {
        /// Something that entered a simulation, or that it did by itself and a replay has to do, too. A recording is a
        /// list of these in the order in which the physics thread consumed them: all between two
        /// [`Update`](Self::Update)s acts in the second one.
        ///
        /// Objects are named by index in order of creation, as for plugins.
        #[derive(Debug, Clone, PartialEq)]
        #[non_exhaustive]
        pub enum Entry<'a> {
            $($(#[$doc])* $variant { $($(#[$field_doc])* $field: $type),* },)*
        }

        impl Entry<'_> {
            /// Appends the entry as bytes.
            pub fn write(&self, out: &mut Vec<u8>) {
                match self {
                    $(Self::$variant { $($field),* } => {
                        let number: u8 = $number;
                        number.put(out);
                        $($field.put(out);)*
                    })*
                }
            }
        }

        impl Entry<'static> {
            /// Reads an entry that [`write`](Entry::write) wrote. Never fails by more than an error, whatever the bytes
            /// are, and takes no more memory than some times their number.
            ///
            /// # Errors
            /// [`CodeError`] when these are not the bytes of one entry.
            pub fn read(bytes: &[u8]) -> Result<Self, CodeError> {
                let mut from = Source(bytes);
                let entry = match u8::take(&mut from)? {
                    $($number => {
                        $(let $field = Coded::take(&mut from)?;)*
                        Self::$variant { $($field),* }
                    })*
                    number => return Err(CodeError::Unknown { what: "entry", number: number.into() }),
                };
                match from.0.len() {
                    0 => Ok(entry),
                    rest => Err(CodeError::Long(rest)),
                }
            }
        }
    };
}

// Numbers stay: they are what files hold. New entries get new numbers.
entries! {
    /// An update: what was entered since the one before acts in it.
    1 Update {
        /// Number of the update, from 1.
        iteration: u64,
        /// s.
        interval: f64,
    }
    /// Simulated time passed in which nothing moved.
    2 LoseTime {
        /// s.
        seconds: f64,
    }
    /// The latest update was taken back after a reset: the next one is made in its place.
    3 Again {}
    /// A command was executed for a body.
    4 Body {
        /// Body.
        body: usize,
        /// The command.
        command: Cow<'a, RigidBodyCommand>,
    }
    /// A joint was commanded.
    5 Joint {
        /// Body that the joint is below.
        body: usize,
        /// Which of its active joints.
        index: usize,
        /// What the value is.
        kind: JointCommandType,
        /// N·m or N, rad or m, rad/s or m/s.
        value: f64,
    }
    /// A command was executed for a camera or a light.
    6 Pose {
        /// Camera or light.
        object: ObjectId,
        /// The command.
        command: Cow<'a, PoseCommand>,
    }
    /// A command was executed for a soft body.
    7 SoftBody {
        /// Soft body.
        soft: usize,
        /// The command.
        command: Cow<'a, SoftBodyCommand>,
    }
    /// A command was executed for an actuator.
    8 Actuator {
        /// Actuator.
        actuator: usize,
        /// The command.
        command: Cow<'a, ActuatorCommand>,
    }
    /// A command was executed for a vehicle.
    9 Vehicle {
        /// Vehicle.
        vehicle: usize,
        /// The command.
        command: Cow<'a, VehicleCommand>,
    }
    /// Parameters of a camera were set.
    10 Camera {
        /// Camera.
        camera: usize,
        /// The parameters.
        parameters: Cow<'a, CameraParameters>,
    }
    /// Parameters of a light were set.
    11 Light {
        /// Light.
        light: usize,
        /// The parameters.
        parameters: Cow<'a, LightParameters>,
    }
    /// A plugin did something.
    12 Plugin {
        /// Number of the plugin.
        plugin: u64,
        /// It did so while it was loaded: resets return to what it attached.
        begins: bool,
        /// What it did.
        command: Command,
    }
    /// A plugin was closed; what it held is released.
    13 PluginGone {
        /// Number of the plugin.
        plugin: u64,
    }
    /// The rigid bodies were reset.
    14 ResetBodies {}
    /// Everything was reset.
    15 ResetWorld {}
    /// A model was added.
    16 AddModel {
        /// Its file.
        file: String,
    }
    /// A model was removed.
    17 RemoveModel {
        /// Its key.
        key: String,
    }
    /// A body was removed.
    18 RemoveBody {
        /// Body.
        body: usize,
    }
    /// A state was set.
    19 State {
        /// What was set.
        change: Cow<'a, StateChange>,
    }
    /// Masses, surfaces, limits, gains, gravity or colours were set.
    20 Parameters {
        /// What was set.
        change: Cow<'a, ParameterChange>,
    }
    /// A camera or a light was put somewhere.
    21 Place {
        /// Camera or light.
        object: ObjectId,
        /// Pose in its parent's frame.
        pose: Isometry3<f64>,
    }
    /// A camera was moved in a window.
    22 MoveCamera {
        /// Camera.
        camera: usize,
        /// How.
        gesture: CameraGesture,
    }
    /// A camera was put somewhere in a window.
    23 LookFrom {
        /// Camera.
        camera: usize,
        /// Pose in the world.
        pose: Isometry3<f64>,
        /// Distance of the point that it looks at, m.
        distance: f64,
    }
    /// All cameras were put back.
    24 ResetCameras {}
    /// Gravity was switched.
    25 Gravity {
        /// As the world file says; else none.
        on: bool,
    }
    /// What a ray met was taken hold of.
    26 Pick {
        /// Start of the ray, m, world axes.
        origin: Vector3<f64>,
        /// Direction, of unit length.
        direction: Vector3<f64>,
    }
    /// What is held was moved.
    27 Drag {
        /// Start of the ray, m, world axes.
        origin: Vector3<f64>,
        /// Direction, of unit length.
        direction: Vector3<f64>,
    }
    /// What was held was let go.
    28 Release {}
    /// A node of a soft body was taken hold of.
    29 PickNode {
        /// Soft body.
        soft: usize,
        /// Node.
        node: usize,
        /// Where it is drawn to, m, world axes; `None`: it is let go.
        goal: Option<Vector3<f64>>,
    }
    /// The simulation went back to a state that it had while it was recorded.
    30 Restore {
        /// How many entries had been recorded when the state was saved.
        position: u64,
        /// Cameras stayed where they were.
        keep_cameras: bool,
        /// Simulated time of the state, s.
        sim_time: f64,
    }
    /// An input device got an end-effector. Devices are numbered in the order of these entries.
    31 Device {
        /// File of its entry.
        file: String,
        /// Line of its entry in the file, from 1.
        line: u64,
        /// Name of its entry.
        name: String,
    }
    /// How long an update is meant to be, for gains of input devices.
    32 Period {
        /// s.
        period: f64,
    }
    /// An input device has moved.
    33 Hand {
        /// Device.
        device: usize,
        /// Where the root link should be: body frame in the world.
        reference: Isometry3<f64>,
        /// 0 closed … 1 open.
        gripper: f64,
    }
    /// An input device has moved its cameras.
    34 HandCameras {
        /// Device.
        device: usize,
        /// Ticks in which it moved them, since it was coupled.
        ticks: u64,
        /// Sum of the motions, m, in the axes of each camera; rotation in the parent.
        moved: Isometry3<f64>,
    }
    /// A gain of the end-effector of an input device was changed.
    35 Gain {
        /// Device.
        device: usize,
        /// Which gain.
        quantity: u8,
        /// By how much.
        step: f64,
    }
    /// The gripping assist was switched.
    36 Assist {
        /// Whether it is on.
        on: bool,
    }
    /// What the state was after the latest update.
    37 Hash {
        /// Number of the update.
        iteration: u64,
        /// Simulated time, s.
        sim_time: f64,
        /// Hash of the state.
        hash: u64,
    }
    /// What was executed last for the same object is executed again: written in place of the entry.
    38 Same {
        /// Number of the kind of entry.
        kind: u8,
        /// Object.
        object: usize,
    }
    /// Somebody has noted something.
    39 Note {
        /// What.
        text: String,
    }
    /// The recording begins here, with everything as it is after loading or a reset of the world.
    40 Start {
        /// Updates until now.
        iteration: u64,
        /// Simulated time, s.
        sim_time: f64,
        /// Of that what was never integrated, s.
        lost_time: f64,
        /// Number of the latest attachment of a plugin: they go on over resets.
        attachments: u64,
    }
    /// A volume was cut.
    41 Carve {
        /// Volume.
        volume: usize,
        /// How.
        command: Cow<'a, CarveCommand>,
    }
    /// A volume got its first voxels back.
    42 RestoreVoxels {
        /// Volume.
        volume: usize,
    }
    /// A tool of a volume was switched or changed.
    43 Tool {
        /// Volume.
        volume: usize,
        /// Its place in the list of the volume's tools.
        tool: usize,
        /// Whether it cuts; `None`: as it was.
        on: Option<bool>,
        /// Radius of its tip, m; `None`: as it was.
        radius: Option<f64>,
    }
    /// A plugin has added a tool to a volume.
    44 NewTool {
        /// Volume.
        volume: usize,
        /// The tool.
        tool: Cow<'a, VolumeTool>,
    }
}

/// Entries of commands that stay in force, and are therefore executed in each iteration.
impl Entry<'_> {
    /// Kind and object of such a command: the same again is written as [`Entry::Same`].
    pub(super) fn subject(&self) -> Option<(u8, usize)> {
        match self {
            Self::Body { body, .. } => Some((4, *body)),
            Self::Pose { object, .. } => Some((6, 2 * object.index + usize::from(object.kind == CAMERA))),
            Self::SoftBody { soft, .. } => Some((7, *soft)),
            Self::Actuator { actuator, .. } => Some((8, *actuator)),
            Self::Vehicle { vehicle, .. } => Some((9, *vehicle)),
            _ => None,
        }
    }
}

/// How many kinds of entries have a [subject](Entry::subject): their numbers are smaller than this.
pub(super) const KINDS: usize = 10;

const CAMERA: crate::adf::ObjectType = crate::adf::ObjectType::Camera;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adf::{ObjectType, ToolBall, ToolBurr};
    use crate::comm::CartesianCommandType;
    use ambf_volume::{Rule, Shape};

    fn round_trip(entry: &Entry<'_>) {
        let mut bytes = Vec::new();
        entry.write(&mut bytes);
        assert_eq!(&Entry::read(&bytes).expect("an entry"), entry);
        for end in 0..bytes.len() {
            assert!(Entry::read(&bytes[..end]).is_err(), "{entry:?} cut to {end} bytes");
        }
        bytes.push(0);
        assert_eq!(Entry::read(&bytes), Err(CodeError::Long(1)));
    }

    #[test]
    fn entries_are_read_as_they_were_written() {
        let pose = Isometry3::new(Vector3::new(1.0, -2.0, 1e-300), Vector3::new(0.1, 0.2, 0.3));
        let force = RigidBodyCommand {
            joint_commands: vec![0.5, -0.0],
            joint_command_types: vec![JointCommandType::Position, JointCommandType::Unknown(-7)],
            ..RigidBodyCommand::wrench(Vector3::x(), Vector3::y())
        };
        let unknown = RigidBodyCommand { cartesian: CartesianCommandType::Unknown(9), ..Default::default() };
        for command in [
            force,
            RigidBodyCommand::velocity(Vector3::x(), Vector3::z()),
            RigidBodyCommand::pose(Vector3::x(), [0.0, 0.0, 0.0, 1.0]),
            unknown,
        ] {
            round_trip(&Entry::Body { body: 3, command: Cow::Owned(command) });
        }
        let change = ParameterChange { gravity: Some(Vector3::z()), ..Default::default() };
        round_trip(&Entry::Parameters { change: Cow::Owned(change) });
        for command in [
            Command::Attach { body: 1, to: 2 },
            Command::PullNode { soft: 0, node: 7, goal: None },
            Command::Drive { vehicle: 0, wheel: 3, steering: 0.1, power: 2.0, brake: 0.0 },
            Command::Place { object: ObjectId::new(ObjectType::Light, 1), pose },
        ] {
            round_trip(&Entry::Plugin { plugin: 5, begins: true, command });
        }
        for (shape, rule) in [
            (Shape::Sphere { radius: 1e-3 }, Rule::All),
            (Shape::Capsule { radius: 1e-3, half_length: 0.0 }, Rule::Rate { rate: 1e-8, interval: 1e-3 }),
            (Shape::Voxels(vec![[1, -2, 3]]), Rule::Count(7)),
        ] {
            let command = CarveCommand { shape, from: pose, to: Isometry3::identity(), in_world: true, rule };
            round_trip(&Entry::Carve { volume: 1, command: Cow::Owned(command) });
        }
        round_trip(&Entry::Tool { volume: 0, tool: 1, on: Some(true), radius: None });
        let ball = ToolBall { position: Vector3::x(), radius: 0.001 };
        let tool = VolumeTool {
            body: "drill".into(),
            tip: ball,
            cursors: vec![ball],
            rate: 3e-8,
            on: false,
            stiffness: 700.0,
            damping: 1.0,
            friction: 0.1,
            largest_force: 3.3,
            burrs: vec![ToolBurr { body: "6mm".into(), radius: 0.003, rate: 3e-8, count: 10 }],
        };
        round_trip(&Entry::NewTool { volume: 0, tool: Cow::Owned(tool) });
        round_trip(&Entry::MoveCamera { camera: 1, gesture: CameraGesture::Shift(Vector3::x()) });
        round_trip(&Entry::Note { text: "stage: knot".into() });
        round_trip(&Entry::Again {});
        round_trip(&Entry::Start { iteration: 7, sim_time: 0.5, lost_time: 0.25, attachments: 3 });
    }

    #[test]
    fn what_is_no_entry_is_an_error() {
        assert_eq!(Entry::read(&[200]), Err(CodeError::Unknown { what: "entry", number: 200 }));
        assert_eq!(Entry::read(&[]), Err(CodeError::Short));
        // A list that announces more than there is.
        let mut bytes = vec![19];
        bytes.extend_from_slice(&u32::MAX.to_le_bytes());
        assert_eq!(Entry::read(&bytes), Err(CodeError::Short));
        assert_eq!(Entry::read(&[39, 1, 0, 0, 0, 0xff]), Err(CodeError::Text));
    }
}
