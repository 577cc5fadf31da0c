//! What clients may tell an arm, and what is refused.
//!
//! The functions here turn what came into a [`Command`] by what never changes about the arm, so that they can be called
//! in any thread. What cannot be used becomes [`Command::Refused`]: the arm decides whether it is worth a warning.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3, Vector6};
use thiserror::Error;

use super::model::{ArmModel, OnLimit, LIMIT_TOLERANCE};
use super::state::Dialect;
use crate::kinematics::{Coordinates, Instrument, InverseError, Limits};

/// How a command is carried out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// At once.
    Servo,
    /// Smoothed, within the limits of speed and acceleration.
    Interpolate,
    /// As a move to rest.
    Move,
}

/// Of what a joint command is a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// rad or m.
    Position,
    /// rad or m, to be added to the set point.
    Relative,
    /// rad/s or m/s.
    Velocity,
    /// N·m or N.
    Effort,
}

/// In which frame a pose is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Frame {
    /// The arm's reference frame.
    Reference,
    /// The world.
    World,
    /// The arm's base.
    Base,
    /// One that is none of these: known only if a client has named the reference frame so.
    Named(FrameName),
}

/// Most bytes of the name of a frame that a client chooses.
pub const MAX_FRAME: usize = 63;

/// The name of a frame, in place: the physics thread keeps it without allocating.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameName {
    bytes: [u8; MAX_FRAME],
    count: u8,
}

impl FrameName {
    /// `None` for an empty name and for one with more than [`MAX_FRAME`] bytes.
    pub fn new(name: &str) -> Option<Self> {
        let mut bytes = [0; MAX_FRAME];
        bytes.get_mut(..name.len())?.copy_from_slice(name.as_bytes());
        (!name.is_empty()).then_some(Self { bytes, count: name.len() as u8 })
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        // The bytes are those of a text.
        std::str::from_utf8(&self.bytes[..usize::from(self.count)]).unwrap_or_default()
    }
}

/// Number of an instrument: six digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InstrumentNumber([u8; 6]);

impl InstrumentNumber {
    /// The number in the name of a tool: six digits alone, or behind what is separated from them by `_` or `:`, such as
    /// `LARGE_NEEDLE_DRIVER_420006`.
    pub fn of_tool(name: &str) -> Option<Self> {
        let digits: [u8; 6] = name.rsplit(['_', ':']).next()?.as_bytes().try_into().ok()?;
        digits.iter().all(u8::is_ascii_digit).then_some(Self(digits))
    }

    /// Its digits.
    pub fn as_str(&self) -> &str {
        std::str::from_utf8(&self.0).unwrap_or_default()
    }
}

/// What a ratio of trajectories reduces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RatioOf {
    /// Largest speeds and accelerations.
    Both,
    /// Largest speeds.
    Speeds,
    /// Largest accelerations.
    Accelerations,
}

/// In which axes and about which point a wrench is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WrenchFrame {
    /// At the control point, in tool axes, or in base axes if the orientation is absolute.
    Body,
    /// At the origin of the base, in base axes.
    Spatial,
}

/// A command of an arm.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// A state command.
    State(String),
    /// Joint values.
    Joints {
        /// How.
        level: Level,
        /// What.
        quantity: Quantity,
        /// A value a joint.
        value: Coordinates,
    },
    /// A pose of the control point.
    Pose {
        /// How.
        level: Level,
        /// Where.
        pose: Isometry3<f64>,
        /// In which frame.
        frame: Frame,
    },
    /// A twist of the control point in reference axes: m/s, rad/s.
    Twist(Vector6<f64>),
    /// A wrench, N and N·m.
    Wrench {
        /// Force, then torque.
        wrench: Vector6<f64>,
        /// In which frame.
        frame: WrenchFrame,
    },
    /// Stay at the set point.
    Hold,
    /// No effort but what holds the arm against gravity.
    Free,
    /// Whether efforts that hold the arm against gravity are added to commanded efforts.
    GravityCompensation(bool),
    /// Whether wrenches of [`WrenchFrame::Body`] are in base axes.
    AbsoluteForces(bool),
    /// The jaw's angle, rad.
    Jaw {
        /// How.
        level: Level,
        /// The angle between the fingers.
        angle: f64,
    },
    /// The jaw's effort, N·m.
    JawEffort(f64),
    /// Share of the largest speeds and accelerations that trajectories use, above 0, at most 1.
    Ratio {
        /// Of what.
        of: RatioOf,
        /// The share.
        value: f64,
    },
    /// Where the arm's base is from now on in its reference frame, and how that frame is called; `None`: as before.
    BaseFrame {
        /// Pose of the base.
        pose: Isometry3<f64>,
        /// Name of the reference frame.
        name: Option<FrameName>,
    },
    /// Which instrument it has.
    ToolType(InstrumentNumber),
    /// Whether it has an instrument.
    ToolPresent(bool),
    /// The control point keeps this orientation in the reference frame while the arm follows efforts.
    LockOrientation(UnitQuaternion<f64>),
    /// The orientation follows efforts, too.
    UnlockOrientation,
    /// Errors of the joints, rad or m: commands get them added, measurements have them taken off.
    JointErrors(Coordinates),
    /// A setting that cannot be used.
    RefusedSetting(Refusal),
    /// A motion command that cannot be used.
    Refused {
        /// Whether it is a move, whose sender waits for the arm to be busy.
        is_move: bool,
        /// Why.
        refusal: Refusal,
    },
}

/// Why a command is refused.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum Refusal {
    /// Error when the bytes are no message of the type.
    #[error("the message cannot be read")]
    Unreadable,
    /// Error when there are too many or too few values.
    #[error("{got} values, expected {expected}")]
    Count {
        /// How many came.
        got: usize,
        /// How many there should be.
        expected: usize,
    },
    /// Error when a number is NaN or infinite.
    #[error("a number is not finite")]
    NotFinite,
    /// Error when the names of joints are not those of the arm, each once.
    #[error("the joint names are not those of the arm, each once; expected {expected}, or none")]
    Names {
        /// Names, separated by commas.
        expected: String,
    },
    /// Error when a quaternion has no length.
    #[error("the quaternion is zero")]
    Quaternion,
    /// Error when a pose is given in a frame that the arm does not know.
    #[error("the frame `{got}` is not known; expected {expected}")]
    Frame {
        /// The frame.
        got: String,
        /// Those that are known.
        expected: String,
    },
    /// Error when a target is beyond a joint's limits.
    #[error("joint {joint} at {value} is beyond its limits, {lower} to {upper}")]
    Limit {
        /// From 0; the jaw is the one after the last.
        joint: usize,
        /// rad or m.
        value: f64,
        /// rad or m.
        lower: f64,
        /// rad or m.
        upper: f64,
    },
    /// Error when there are no joint coordinates for a pose.
    #[error(transparent)]
    Inverse(#[from] InverseError),
    /// Error when the arm has no jaw.
    #[error("the arm has no jaw")]
    NoJaw,
    /// Error when more moves and state commands wait than are kept.
    #[error("too many commands wait")]
    Full,
    /// Error when a state command is none.
    #[error("`{0}` is no state command")]
    UnknownState(String),
    /// Error when a ratio of speeds or accelerations is not above 0, or above 1.
    #[error("the ratio {0} is not above 0 and at most 1")]
    Ratio(f64),
    /// Error when the name of a frame is too long.
    #[error("the frame `{0}…` has more than {MAX_FRAME} bytes")]
    LongFrame(String),
    /// Error when the name of a tool does not end with six digits.
    #[error("`{0}` is no instrument: expected six digits, or a name that ends with them")]
    NoInstrument(String),
    /// Error when an instrument would have other lengths than that of the scene.
    #[error("the scene's instrument is {own}; that {got} has the same lengths is not known")]
    OtherInstrument {
        /// What it is to be.
        got: String,
        /// What the scene has.
        own: String,
    },
    /// Error when a Cartesian command comes while the arm has no instrument.
    #[error("the arm has no instrument")]
    NoTool,
    /// Error when a state command is not possible now.
    #[error("`{command}` is not possible in the state {state}")]
    State {
        /// The command.
        command: String,
        /// The state.
        state: super::State,
    },
}

/// Longest text of a client that is repeated in a warning, characters.
const MAX_QUOTE: usize = 64;

/// The beginning of what a client wrote.
pub(super) fn quoted(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(MAX_QUOTE).collect()
}

/// Joint values with their names as they came.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JointMessage {
    /// Empty, or a name a joint.
    pub names: Vec<String>,
    /// rad or m.
    pub position: Vec<f64>,
    /// rad/s or m/s.
    pub velocity: Vec<f64>,
    /// N·m or N.
    pub effort: Vec<f64>,
}

/// A pose as it came.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PoseMessage {
    /// Frame.
    pub frame: String,
    /// m.
    pub position: [f64; 3],
    /// x y z w.
    pub orientation: [f64; 4],
}

impl PoseMessage {
    /// The pose. Its quaternion is normalised.
    ///
    /// # Errors
    /// [`Refusal::NotFinite`], [`Refusal::Quaternion`].
    pub fn pose(&self) -> Result<Isometry3<f64>, Refusal> {
        if self.position.iter().any(|value| !value.is_finite()) {
            return Err(Refusal::NotFinite);
        }
        Ok(Isometry3::from_parts(Translation3::from(self.position), rotation_of(self.orientation)?))
    }
}

/// The rotation of a quaternion x y z w, which is normalised.
fn rotation_of(orientation: [f64; 4]) -> Result<UnitQuaternion<f64>, Refusal> {
    if orientation.iter().any(|value| !value.is_finite()) {
        return Err(Refusal::NotFinite);
    }
    let [x, y, z, w] = orientation;
    UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-9).ok_or(Refusal::Quaternion)
}

impl ArmModel {
    /// The command of a joint message.
    pub fn joint_command(&self, level: Level, quantity: Quantity, message: &JointMessage) -> Command {
        self.joint_values(quantity, message)
            .map_or_else(|refusal| refused(level, refusal), |value| Command::Joints { level, quantity, value })
    }

    fn joint_values(&self, quantity: Quantity, message: &JointMessage) -> Result<Coordinates, Refusal> {
        let values = match quantity {
            Quantity::Position | Quantity::Relative => &message.position,
            Quantity::Velocity => &message.velocity,
            Quantity::Effort => &message.effort,
        };
        let expected = self.count();
        if values.len() != expected {
            return Err(Refusal::Count { got: values.len(), expected });
        }
        if values.iter().any(|value| !value.is_finite()) {
            return Err(Refusal::NotFinite);
        }
        let mut ordered = Coordinates::zeros();
        for (value, place) in values.iter().zip(self.places(&message.names)?) {
            ordered[place] = *value;
        }
        if quantity == Quantity::Position {
            self.within_limits(&mut ordered)?;
        }
        Ok(ordered)
    }

    /// For each value the joint that it belongs to.
    fn places(&self, names: &[String]) -> Result<Vec<usize>, Refusal> {
        let count = self.count();
        let are_numbers = names.len() == count && names.iter().enumerate().all(|(i, name)| *name == i.to_string());
        // The challenge's interface takes values by their places, whatever they are called.
        if names.is_empty() || are_numbers || self.dialect == Dialect::Src {
            return Ok((0..count).collect());
        }
        let wrong = || Refusal::Names { expected: self.joints.join(", ") };
        let places: Option<Vec<usize>> =
            names.iter().map(|name| self.joints.iter().position(|joint| joint == name)).collect();
        let places = places.filter(|places| places.len() == count).ok_or_else(wrong)?;
        let all_different = (0..count).all(|joint| places.contains(&joint));
        all_different.then_some(places).ok_or_else(wrong)
    }

    /// Clips targets, or refuses them.
    pub(super) fn within_limits(&self, target: &mut Coordinates) -> Result<(), Refusal> {
        for (joint, limits) in self.limits.iter().enumerate() {
            target[joint] = self.within(joint, target[joint], limits)?;
        }
        Ok(())
    }

    /// Joint coordinates, which may be beyond limits by [`LIMIT_TOLERANCE`] and are clipped then.
    ///
    /// # Errors
    /// [`Refusal::Limit`], also where commands are clipped.
    pub fn joints_within_limits(&self, mut q: Coordinates) -> Result<Coordinates, Refusal> {
        for (joint, limits) in self.limits.iter().enumerate() {
            if !limits.hold(q[joint], LIMIT_TOLERANCE) {
                return Err(Refusal::Limit { joint, value: q[joint], lower: limits.lower, upper: limits.upper });
            }
            q[joint] = limits.clip(q[joint]);
        }
        Ok(q)
    }

    fn within(&self, joint: usize, value: f64, limits: &Limits) -> Result<f64, Refusal> {
        if self.on_limit == OnLimit::Refuse && !limits.hold(value, LIMIT_TOLERANCE) {
            return Err(Refusal::Limit { joint, value, lower: limits.lower, upper: limits.upper });
        }
        Ok(limits.clip(value))
    }

    /// The command of a pose message. `is_local`: poses without a frame are in the base.
    pub fn pose_command(&self, level: Level, message: &PoseMessage, is_local: bool) -> Command {
        let read = || Ok((message.pose()?, self.frame(&message.frame, is_local)?));
        read().map_or_else(|refusal| refused(level, refusal), |(pose, frame)| Command::Pose { level, pose, frame })
    }

    fn frame(&self, name: &str, is_local: bool) -> Result<Frame, Refusal> {
        let known = &self.frames;
        match name {
            "" if is_local => Ok(Frame::Base),
            "" => Ok(Frame::Reference),
            _ if name == known.reference => Ok(Frame::Reference),
            _ if name == known.base || name.strip_suffix("_base") == Some(&self.name) => Ok(Frame::Base),
            "world" => Ok(Frame::World),
            _ => FrameName::new(name).map(Frame::Named).ok_or_else(|| self.unknown_frame(name)),
        }
    }

    /// Why a pose in the frame `name` is refused.
    pub(super) fn unknown_frame(&self, name: &str) -> Refusal {
        let expected = format!("{}, {} or world", self.frames.reference, self.frames.base);
        Refusal::Frame { got: quoted(name), expected }
    }

    /// The command of a ratio.
    pub fn ratio_command(of: RatioOf, value: f64) -> Command {
        if value > 0.0 && value <= 1.0 {
            Command::Ratio { of, value }
        } else {
            Command::RefusedSetting(Refusal::Ratio(value))
        }
    }

    /// The command of a base frame.
    pub fn base_frame_command(&self, message: &PoseMessage) -> Command {
        let name = FrameName::new(&message.frame);
        match message.pose() {
            Ok(_) if name.is_none() && !message.frame.is_empty() => {
                Command::RefusedSetting(Refusal::LongFrame(quoted(&message.frame)))
            }
            Ok(pose) => Command::BaseFrame { pose, name },
            Err(refusal) => Command::RefusedSetting(refusal),
        }
    }

    /// The command of the name of a tool: its lengths must be those of the arm's own.
    pub fn tool_type_command(&self, name: &str) -> Command {
        let Some(number) = InstrumentNumber::of_tool(name.trim()) else {
            return Command::RefusedSetting(Refusal::NoInstrument(quoted(name)));
        };
        match &self.instrument {
            Some(own) if *own != number && !Instrument::are_alike(own.as_str(), number.as_str()) => {
                let (got, own) = (number.as_str().to_owned(), own.as_str().to_owned());
                Command::RefusedSetting(Refusal::OtherInstrument { got, own })
            }
            _ => Command::ToolType(number),
        }
    }

    /// The command of an orientation, x y z w.
    pub fn orientation_command(orientation: [f64; 4]) -> Command {
        match rotation_of(orientation) {
            Ok(rotation) => Command::LockOrientation(rotation),
            Err(refusal) => Command::RefusedSetting(refusal),
        }
    }

    /// The command of errors of the joints: as many as the arm has joints, or fewer, the others then have none.
    pub fn errors_command(&self, values: &[f64]) -> Command {
        let expected = self.count();
        if values.len() > expected {
            return Command::RefusedSetting(Refusal::Count { got: values.len(), expected });
        }
        if values.iter().any(|value| !value.is_finite()) {
            return Command::RefusedSetting(Refusal::NotFinite);
        }
        let mut errors = Coordinates::zeros();
        errors.as_mut_slice()[..values.len()].copy_from_slice(values);
        Command::JointErrors(errors)
    }

    /// The command of a twist, force or torque message.
    pub fn six_command(linear: [f64; 3], angular: [f64; 3], make: impl FnOnce(Vector6<f64>) -> Command) -> Command {
        if linear.iter().chain(&angular).any(|value| !value.is_finite()) {
            return refused(Level::Servo, Refusal::NotFinite);
        }
        let (v, w) = (Vector3::from(linear), Vector3::from(angular));
        make(Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z))
    }

    /// The command of a jaw message: one value.
    pub fn jaw_command(&self, level: Level, quantity: Quantity, message: &JointMessage) -> Command {
        let read = || {
            let jaw = self.jaw.as_ref().ok_or(Refusal::NoJaw)?;
            let values = if quantity == Quantity::Effort { &message.effort } else { &message.position };
            let &[value] = values.as_slice() else {
                return Err(Refusal::Count { got: values.len(), expected: 1 });
            };
            if !value.is_finite() {
                return Err(Refusal::NotFinite);
            }
            match quantity {
                Quantity::Effort => Ok(Command::JawEffort(value)),
                _ => Ok(Command::Jaw { level, angle: self.within(self.count(), value, &jaw.limits)? }),
            }
        };
        read().unwrap_or_else(|refusal| refused(level, refusal))
    }
}

/// A motion command that cannot be used.
pub fn refused(level: Level, refusal: Refusal) -> Command {
    Command::Refused { is_move: level == Level::Move, refusal }
}
