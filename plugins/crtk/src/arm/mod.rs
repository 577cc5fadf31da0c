//! One arm as a state machine: commands and measurements in, set points and events out. No ROS, no threads, no clock.
//!
//! [`Arm::update`] is called after each step of the physics with what came since. It allocates only where an event has
//! a text of a client's.

mod accept;
mod command;
mod model;
mod motion;
mod state;

pub use command::{
    refused, Command, Frame, FrameName, InstrumentNumber, JointMessage, Level, PoseMessage, Quantity, RatioOf, Refusal,
    WrenchFrame, MAX_FRAME,
};
pub use model::{ArmModel, FrameNames, JawModel, Measured, OnLimit, LIMIT_TOLERANCE};
pub use motion::{pseudo_inverse, wrench_of};
pub use state::{outcome, Dialect, Outcome, State};

use std::sync::Arc;

use nalgebra::{Isometry3, UnitQuaternion, Vector6};

use crate::kinematics::{Coordinates, MAX_JOINTS};
use crate::trajectory::{Shape, Trajectory};

/// Velocity commands stop so long after the last one, s.
pub const VELOCITY_TIMEOUT: f64 = 0.1;

/// Effort commands end so long after the last one, and the arm holds, s: the watchdog of joint commands.
pub const EFFORT_TIMEOUT: f64 = 0.5;

/// What is published as it happens.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// The operating state, also when nothing of it has changed.
    State(OperatingState),
    /// A command was refused.
    Warning {
        /// When, ns.
        stamp: u64,
        /// Why.
        refusal: Refusal,
    },
    /// The last move has ended; at its goal, or before.
    Goal(bool),
    /// Shares of the largest speeds and accelerations that trajectories use.
    Ratios(Ratios),
    /// Which instrument it has; `None`: not known.
    Tool(Option<InstrumentNumber>),
    /// Whether the orientation of the control point is kept.
    OrientationLocked(bool),
}

/// Shares of the largest speeds and accelerations, above 0, at most 1. Default: 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ratios {
    /// Of the speeds.
    pub speed: f64,
    /// Of the accelerations.
    pub acceleration: f64,
}

impl Default for Ratios {
    fn default() -> Self {
        Self { speed: 1.0, acceleration: 1.0 }
    }
}

/// The operating state at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OperatingState {
    /// When, ns; later than that of each event before.
    pub stamp: u64,
    /// State.
    pub state: State,
    /// Homed.
    pub is_homed: bool,
    /// Arm or jaw moves.
    pub is_busy: bool,
}

/// What a joint follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drive {
    /// Positions.
    Position,
    /// Efforts.
    Effort,
}

/// What the joints are to do until the next step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SetPoint {
    /// What counts: positions or efforts.
    pub drive: Drive,
    /// rad or m.
    pub position: Coordinates,
    /// rad/s or m/s.
    pub velocity: Coordinates,
    /// N·m or N.
    pub effort: Coordinates,
    /// Of the efforts, what holds the arm against gravity, N·m or N; zero while that is switched off.
    pub holding: Coordinates,
    /// Whether the arm is held against gravity beside its efforts.
    pub is_lifted: bool,
    /// While efforts count: joints from this one on are held at their positions, to keep an orientation.
    pub positioned_from: usize,
    /// What counts for the jaw.
    pub jaw_drive: Drive,
    /// Angle between the fingers, rad; its speed, rad/s.
    pub jaw: [f64; 2],
    /// N·m.
    pub jaw_effort: f64,
}

/// What the arm does.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "there is one an arm, and nothing here allocates")]
enum Mode {
    /// The set point stays, or was set by a servo command so long ago, s.
    Position { age: f64 },
    /// On its way.
    Follow { path: Trajectory, elapsed: f64, is_move: bool },
    /// Joint speeds.
    Velocity { value: Coordinates, age: f64 },
    /// Twist of the control point, reference axes.
    Twist { value: Vector6<f64>, age: f64 },
    /// Joint efforts.
    Effort { value: Coordinates, age: f64 },
    /// Wrench at the tool.
    Wrench { value: Vector6<f64>, frame: WrenchFrame, age: f64 },
    /// Gravity compensation only.
    Free,
}

impl Mode {
    const HELD: Self = Self::Position { age: f64::INFINITY };

    fn drive(&self) -> Drive {
        match self {
            Self::Effort { .. } | Self::Wrench { .. } | Self::Free => Drive::Effort,
            _ => Drive::Position,
        }
    }

    fn is_move(&self) -> bool {
        matches!(self, Self::Follow { is_move: true, .. })
    }
}

/// An arm.
#[derive(Debug, Clone)]
pub struct Arm {
    model: Arc<ArmModel>,
    state: State,
    is_homed: bool,
    mode: Mode,
    jaw_mode: Mode,
    set_point: SetPoint,
    gravity_compensation: bool,
    absolute_forces: bool,
    ratios: Ratios,
    /// Pose of the base in the reference frame, and that frame's name, where a client has set them.
    base_frame: Option<(Isometry3<f64>, Option<FrameName>)>,
    /// Which instrument it has.
    tool: Option<InstrumentNumber>,
    has_tool: bool,
    /// By how much the joints of the scene are beyond what clients see.
    errors: Coordinates,
    /// Orientation to be kept, reference frame.
    locked: Option<UnitQuaternion<f64>>,
    /// What the last event of the state said.
    reported_busy: bool,
    last_stamp: u64,
    inverse_warned: Option<u64>,
    /// Set points are where the joints are, and home is still ahead.
    is_new: bool,
}

/// What an update works with.
struct Now<'a> {
    stamp: u64,
    measured: &'a Measured,
    events: &'a mut Vec<Event>,
}

impl Arm {
    /// An arm as it is at the start: enabled and homed. The first update sends it home from where it is.
    pub fn new(model: Arc<ArmModel>) -> Self {
        let zero = Coordinates::zeros();
        Self {
            ratios: Ratios::default(),
            base_frame: None,
            tool: model.instrument,
            has_tool: true,
            errors: zero,
            locked: None,
            model,
            state: State::Enabled,
            is_homed: true,
            mode: Mode::HELD,
            jaw_mode: Mode::HELD,
            set_point: SetPoint {
                drive: Drive::Position,
                position: zero,
                velocity: zero,
                effort: zero,
                holding: zero,
                is_lifted: false,
                positioned_from: MAX_JOINTS,
                jaw_drive: Drive::Position,
                jaw: [0.0; 2],
                jaw_effort: 0.0,
            },
            gravity_compensation: true,
            absolute_forces: false,
            reported_busy: false,
            last_stamp: 0,
            inverse_warned: None,
            is_new: true,
        }
    }

    /// The arm's description.
    pub fn model(&self) -> &Arc<ArmModel> {
        &self.model
    }

    /// As at the start, after the scene was reset, with the instrument and the errors that it has. Events go on.
    pub fn reset(&mut self) {
        let Self { last_stamp, tool, errors, .. } = *self;
        *self = Self { last_stamp, tool, errors, ..Self::new(Arc::clone(&self.model)) };
    }

    /// By how much the joints of the scene are beyond what clients see and command, rad or m. Default: 0.
    pub fn errors(&self) -> &Coordinates {
        &self.errors
    }

    /// Sets the errors of the joints, rad or m.
    pub fn set_errors(&mut self, errors: Coordinates) {
        self.errors = errors;
    }

    /// What the joints are to do.
    pub fn set_point(&self) -> &SetPoint {
        &self.set_point
    }

    /// The operating state; its stamp is that of the last event.
    pub fn operating_state(&self) -> OperatingState {
        let Self { state, is_homed, last_stamp: stamp, .. } = *self;
        OperatingState { stamp, state, is_homed, is_busy: self.is_busy() }
    }

    /// Whether wrenches of the body frame are in base axes.
    pub fn has_absolute_forces(&self) -> bool {
        self.absolute_forces
    }

    /// Pose of the base in the reference frame, where a client has set it.
    pub fn base_frame(&self) -> Option<&Isometry3<f64>> {
        self.base_frame.as_ref().map(|(pose, _)| pose)
    }

    /// Name of the reference frame, where a client has set it.
    pub fn reference_name(&self) -> Option<FrameName> {
        self.base_frame.and_then(|(_, name)| name)
    }

    /// Whether it has an instrument; without one, poses are not valid.
    pub fn has_tool(&self) -> bool {
        self.has_tool
    }

    fn is_busy(&self) -> bool {
        self.mode.is_move() || self.jaw_mode.is_move()
    }

    fn accepts_motion(&self) -> bool {
        self.state == State::Enabled && self.is_homed
    }

    /// Takes `commands` in order, then moves the set points on by `dt` s. `stamp`: the time, ns; `measured`: the joints
    /// after the last step.
    pub fn update(
        &mut self,
        stamp: u64,
        dt: f64,
        measured: &Measured,
        commands: impl Iterator<Item = Command>,
        events: &mut Vec<Event>,
    ) {
        let mut now = Now { stamp, measured, events };
        if self.is_new {
            self.begin(&mut now);
        }
        for command in commands {
            self.take(command, &mut now);
        }
        let was_moving = self.is_busy();
        self.advance(dt, &mut now);
        self.advance_jaw(dt, measured);
        if was_moving && !self.is_busy() {
            now.events.push(Event::Goal(true));
        }
        if self.is_busy() != self.reported_busy {
            self.report_state(self.is_busy(), &mut now);
        }
    }

    /// Set points begin where the joints are; from there the arm goes home, without being busy.
    fn begin(&mut self, now: &mut Now<'_>) {
        self.is_new = false;
        self.freeze(now.measured);
        if let Some(home) = self.model.home {
            self.follow(home, Shape::Bounded, false);
        }
        if let Some(jaw) = &self.model.jaw {
            self.follow_jaw(jaw.home, Shape::Bounded, false);
        }
        self.report_state(false, now);
        now.events.extend([Event::Ratios(self.ratios), Event::OrientationLocked(false)]);
        if self.tool.is_none() {
            now.events.push(Event::Tool(None));
        }
    }

    /// Set points are where the joints are, at rest.
    fn freeze(&mut self, measured: &Measured) {
        self.mode = Mode::HELD;
        self.jaw_mode = Mode::HELD;
        self.set_point.position = measured.position;
        self.set_point.velocity = Coordinates::zeros();
        self.set_point.jaw = [measured.jaw[0], 0.0];
    }

    fn report_state(&mut self, is_busy: bool, now: &mut Now<'_>) {
        self.reported_busy = is_busy;
        let stamp = self.next_stamp(now.stamp);
        let Self { state, is_homed, .. } = *self;
        now.events.push(Event::State(OperatingState { stamp, state, is_homed, is_busy }));
    }

    fn next_stamp(&mut self, stamp: u64) -> u64 {
        self.last_stamp = stamp.max(self.last_stamp + 1);
        self.last_stamp
    }

    fn warn(&mut self, refusal: Refusal, now: &mut Now<'_>) {
        let stamp = self.next_stamp(now.stamp);
        now.events.push(Event::Warning { stamp, refusal });
    }

    /// Changes what the arm does. From efforts to positions the set point is where the joints are.
    fn enter(&mut self, mode: Mode, measured: &Measured) {
        if self.mode.drive() == Drive::Effort && mode.drive() == Drive::Position {
            self.set_point.position = measured.position;
            self.set_point.velocity = Coordinates::zeros();
        }
        self.mode = mode;
    }
}

#[cfg(test)]
pub(crate) mod tests;
