//! One arm as a state machine: commands and measurements in, set points and events out. No ROS, no threads, no clock.
//!
//! [`Arm::update`] is called after each step of the physics with what came since. It allocates only where an event has
//! a text of a client's.

mod command;
mod model;
mod state;

pub use command::{
    refused, Command, Frame, FrameName, InstrumentNumber, JointMessage, Level, PoseMessage, Quantity, RatioOf, Refusal,
    WrenchFrame, LONGEST_FRAME,
};
pub use model::{ArmModel, FrameNames, JawModel, Measured, OnLimit, LIMIT_TOLERANCE};
pub use state::{outcome, Dialect, Outcome, State};

use std::sync::Arc;

use nalgebra::{Isometry3, Matrix6, UnitQuaternion, Vector6};

use crate::kinematics::{Coordinates, Jacobian, MAX_JOINTS};
use crate::trajectory::{Bounds, Point, Shape, Trajectory};
use command::quoted;

/// Velocity commands stop so long after the last one, s.
pub const VELOCITY_TIMEOUT: f64 = 0.1;

/// Effort commands end so long after the last one, and the arm holds, s: the watchdog of joint commands.
pub const EFFORT_TIMEOUT: f64 = 0.5;

/// Joints that place the control point while its orientation is kept by the others: those of a master's arm.
const POSITIONING_JOINTS: usize = 3;

/// A warning about poses without a solution comes at most so often, ns.
const INVERSE_WARNINGS: u64 = 1_000_000_000;

/// What clients are told as it happens.
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
    /// Orientation to be kept, reference frame.
    locked: Option<UnitQuaternion<f64>>,
    /// What the last event of the state said.
    told_busy: bool,
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
            told_busy: false,
            last_stamp: 0,
            inverse_warned: None,
            is_new: true,
        }
    }

    /// The arm's description.
    pub fn model(&self) -> &Arc<ArmModel> {
        &self.model
    }

    /// As at the start, after the scene was reset, with the instrument that it has. Events go on.
    pub fn reset(&mut self) {
        *self = Self { last_stamp: self.last_stamp, tool: self.tool, ..Self::new(Arc::clone(&self.model)) };
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
        if self.is_busy() != self.told_busy {
            self.tell_state(self.is_busy(), &mut now);
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
        self.tell_state(false, now);
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

    fn tell_state(&mut self, is_busy: bool, now: &mut Now<'_>) {
        self.told_busy = is_busy;
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

    fn take(&mut self, command: Command, now: &mut Now<'_>) {
        let moved = self.is_busy();
        let is_move = command.is_move();
        // A move that takes the place of another, of the arm or of the jaw.
        let replaces = is_move && if command.is_of_jaw() { self.jaw_mode.is_move() } else { self.mode.is_move() };
        match command {
            Command::State(text) => self.take_state(&text, now),
            Command::Refused { refusal: refusal @ Refusal::Full, .. } => self.warn(refusal, now),
            Command::RefusedSetting(refusal) => self.warn(refusal, now),
            command if command.is_setting() => self.take_setting(command, now),
            command => {
                let taken = if self.accepts_motion() { self.take_motion(command, now) } else { Ok(false) };
                let is_lost = is_move && !matches!(taken, Ok(true));
                if let Err(refusal) = taken {
                    self.refuse(refusal, now);
                }
                if is_lost || replaces {
                    now.events.push(Event::Goal(false));
                }
            }
        }
        if moved && !self.is_busy() {
            // It was ended before its goal.
            now.events.push(Event::Goal(false));
        }
        if is_move {
            // Whoever sent it waits for this, whatever came of it; the end follows when nothing moves.
            self.tell_state(true, now);
        }
    }

    /// Settings count in all states.
    fn take_setting(&mut self, command: Command, now: &mut Now<'_>) {
        match command {
            Command::GravityCompensation(on) => self.gravity_compensation = on,
            Command::AbsoluteForces(on) => self.absolute_forces = on,
            Command::Ratio { of, value } => {
                if of != RatioOf::Accelerations {
                    self.ratios.speed = value;
                }
                if of != RatioOf::Speeds {
                    self.ratios.acceleration = value;
                }
                now.events.push(Event::Ratios(self.ratios));
            }
            Command::BaseFrame { pose, name } => self.base_frame = Some((pose, name)),
            Command::ToolType(number) => {
                self.tool = Some(number);
                now.events.push(Event::Tool(self.tool));
            }
            Command::ToolPresent(present) => self.has_tool = present,
            Command::LockOrientation(rotation) => {
                self.locked = Some(rotation);
                now.events.push(Event::OrientationLocked(true));
            }
            Command::UnlockOrientation => {
                self.locked = None;
                now.events.push(Event::OrientationLocked(false));
            }
            _ => (),
        }
    }

    fn refuse(&mut self, refusal: Refusal, now: &mut Now<'_>) {
        if matches!(refusal, Refusal::Inverse(_)) {
            let is_due = self.inverse_warned.is_none_or(|last| now.stamp >= last + INVERSE_WARNINGS);
            if !is_due {
                return;
            }
            self.inverse_warned = Some(now.stamp);
        }
        self.warn(refusal, now);
    }

    fn take_state(&mut self, text: &str, now: &mut Now<'_>) {
        let accepted = self.accepts_motion();
        match outcome(text, self.state, self.model.dialect) {
            Outcome::Is(state) => self.state = state,
            Outcome::Homed(homed) => self.is_homed = homed,
            Outcome::Refused => {
                let state = self.state;
                return self.warn(Refusal::State { command: quoted(text.trim()), state }, now);
            }
            Outcome::Unknown => return self.warn(Refusal::UnknownState(quoted(text.trim())), now),
        }
        if accepted && !self.accepts_motion() {
            self.freeze(now.measured);
        }
        self.tell_state(self.is_busy(), now);
    }

    /// Whether anything comes of it.
    fn take_motion(&mut self, command: Command, now: &mut Now<'_>) -> Result<bool, Refusal> {
        let is_cartesian = matches!(command, Command::Pose { .. } | Command::Twist(_) | Command::Wrench { .. });
        if is_cartesian && !self.has_tool {
            return Err(Refusal::NoTool);
        }
        match command {
            Command::Joints { level, quantity, value } => self.take_joints(level, quantity, value, now)?,
            Command::Pose { level, pose, frame } => {
                let goal = self.goal(&pose, frame, now.measured)?;
                self.go(level, goal, now.measured);
            }
            Command::Twist(value) => self.enter(Mode::Twist { value, age: 0.0 }, now.measured),
            Command::Wrench { wrench: value, frame } => {
                self.enter(Mode::Wrench { value, frame, age: 0.0 }, now.measured);
            }
            Command::Hold => self.enter(Mode::HELD, now.measured),
            Command::Free => self.enter(Mode::Free, now.measured),
            Command::Jaw { level, angle } => self.take_jaw(level, angle, now.measured),
            Command::JawEffort(effort) => {
                let mut value = Coordinates::zeros();
                value[0] = effort;
                self.jaw_mode = Mode::Effort { value, age: 0.0 };
            }
            Command::Refused { refusal, .. } => return Err(refusal),
            // The others are no motion.
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn take_joints(
        &mut self,
        level: Level,
        quantity: Quantity,
        value: Coordinates,
        now: &mut Now<'_>,
    ) -> Result<(), Refusal> {
        match quantity {
            Quantity::Position => self.go(level, value, now.measured),
            Quantity::Relative => {
                let mut goal = self.origin(level, now.measured) + value;
                self.model.within_limits(&mut goal)?;
                self.go(level, goal, now.measured);
            }
            Quantity::Velocity => self.enter(Mode::Velocity { value, age: 0.0 }, now.measured),
            Quantity::Effort => self.enter(Mode::Effort { value, age: 0.0 }, now.measured),
        }
        Ok(())
    }

    /// What relative commands are added to.
    fn origin(&self, level: Level, measured: &Measured) -> Coordinates {
        match self.mode {
            Mode::Follow { ref path, .. } if level != Level::Servo => *path.goal(),
            _ if self.mode.drive() == Drive::Effort => measured.position,
            _ => self.set_point.position,
        }
    }

    /// Joint coordinates for a pose, within the limits.
    fn goal(&self, pose: &Isometry3<f64>, frame: Frame, measured: &Measured) -> Result<Coordinates, Refusal> {
        let in_base = match frame {
            Frame::Base => *pose,
            Frame::World => measured.base.inv_mul(pose),
            Frame::Reference => measured.base.inv_mul(&(measured.reference * pose)),
            Frame::Named(name) if self.reference_name() == Some(name) => {
                measured.base.inv_mul(&(measured.reference * pose))
            }
            Frame::Named(name) => return Err(self.model.unknown_frame(name.as_str())),
        };
        let present = self.origin(Level::Servo, measured);
        let model = &self.model;
        let mut goal = model.kinematics.inverse(&in_base, &present, &model.limits)?;
        model.within_limits(&mut goal)?;
        Ok(goal)
    }

    /// Changes what the arm does. From efforts to positions the set point is where the joints are.
    fn enter(&mut self, mode: Mode, measured: &Measured) {
        if self.mode.drive() == Drive::Effort && mode.drive() == Drive::Position {
            self.set_point.position = measured.position;
            self.set_point.velocity = Coordinates::zeros();
        }
        self.mode = mode;
    }

    fn go(&mut self, level: Level, goal: Coordinates, measured: &Measured) {
        match level {
            Level::Servo => self.servo(goal, measured),
            Level::Interpolate => {
                self.enter(Mode::HELD, measured);
                self.follow(goal, Shape::Bounded, false);
            }
            Level::Move => {
                if self.mode.drive() == Drive::Effort {
                    self.enter(Mode::HELD, measured);
                }
                self.follow(goal, self.model.shape(), true);
            }
        }
    }

    /// The set point jumps; its speed is guessed from how it jumped before.
    fn servo(&mut self, goal: Coordinates, measured: &Measured) {
        let since = match self.mode {
            Mode::Position { age } if age > 0.0 && age < VELOCITY_TIMEOUT => Some(age),
            _ => None,
        };
        self.enter(Mode::Position { age: 0.0 }, measured);
        let jump = goal - self.set_point.position;
        self.set_point.velocity = since.map_or_else(Coordinates::zeros, |since| jump / since);
        self.set_point.position = goal;
    }

    fn follow(&mut self, goal: Coordinates, shape: Shape, is_move: bool) {
        let start = Point { position: self.set_point.position, velocity: self.set_point.velocity };
        let path = Trajectory::new(shape, start, goal, &self.reduced(&self.model.bounds));
        self.mode = Mode::Follow { path, elapsed: 0.0, is_move };
    }

    /// Bounds of trajectories.
    fn reduced(&self, bounds: &Bounds) -> Bounds {
        Bounds { speed: bounds.speed * self.ratios.speed, acceleration: bounds.acceleration * self.ratios.acceleration }
    }

    fn take_jaw(&mut self, level: Level, angle: f64, measured: &Measured) {
        if self.jaw_mode.drive() == Drive::Effort {
            self.set_point.jaw = [measured.jaw[0], 0.0];
            self.jaw_mode = Mode::HELD;
        }
        match level {
            Level::Servo => {
                self.jaw_mode = Mode::HELD;
                self.set_point.jaw = [angle, 0.0];
            }
            Level::Interpolate => self.follow_jaw(angle, Shape::Bounded, false),
            Level::Move => self.follow_jaw(angle, self.model.shape(), true),
        }
    }

    fn follow_jaw(&mut self, angle: f64, shape: Shape, is_move: bool) {
        let Some(jaw) = &self.model.jaw else { return };
        let first = |value: f64, others: f64| {
            let mut all = Coordinates::repeat(others);
            all[0] = value;
            all
        };
        let [position, velocity] = self.set_point.jaw;
        let start = Point { position: first(position, 0.0), velocity: first(velocity, 0.0) };
        let bounds = Bounds { speed: first(jaw.speed, 1.0), acceleration: first(jaw.acceleration, 1.0) };
        let path = Trajectory::new(shape, start, first(angle, 0.0), &self.reduced(&bounds));
        self.jaw_mode = Mode::Follow { path, elapsed: 0.0, is_move };
    }

    fn advance(&mut self, dt: f64, now: &mut Now<'_>) {
        let measured = now.measured;
        match self.mode {
            Mode::Position { ref mut age } => {
                *age += dt;
                if *age >= VELOCITY_TIMEOUT {
                    self.set_point.velocity = Coordinates::zeros();
                }
            }
            Mode::Follow { path, elapsed, is_move } => {
                let elapsed = elapsed + dt;
                let point = path.at(elapsed);
                (self.set_point.position, self.set_point.velocity) = (point.position, point.velocity);
                self.mode =
                    if elapsed < path.duration() { Mode::Follow { path, elapsed, is_move } } else { Mode::HELD };
            }
            Mode::Velocity { value, ref mut age } => {
                *age += dt;
                let age = *age;
                self.integrate(value, age, dt);
            }
            Mode::Twist { value, ref mut age } => {
                *age += dt;
                let age = *age;
                let speeds = self.speeds_of(&value, measured);
                self.integrate(speeds, age, dt);
            }
            Mode::Effort { ref mut age, .. } | Mode::Wrench { ref mut age, .. } => {
                *age += dt;
                if *age > EFFORT_TIMEOUT {
                    self.enter(Mode::HELD, measured);
                }
            }
            Mode::Free => (),
        }
        self.set_point.drive = self.mode.drive();
        self.set_point.positioned_from = MAX_JOINTS;
        if self.set_point.drive == Drive::Effort {
            let before = self.set_point.position;
            self.set_point.position = measured.position;
            self.set_point.velocity = Coordinates::zeros();
            self.keep_orientation(&before, dt, measured);
            let is_lifted = self.gravity_compensation || self.mode == Mode::Free;
            self.set_point.is_lifted = is_lifted;
            self.set_point.holding = if is_lifted { measured.holding } else { Coordinates::zeros() };
            self.set_point.effort = self.efforts(measured) + self.set_point.holding;
            self.model.limit_efforts(&mut self.set_point.effort);
        }
    }

    /// While the orientation is locked, joints after the third are where they keep it, by at most their largest speeds;
    /// the first three follow efforts. `before`: set points of the last step.
    fn keep_orientation(&mut self, before: &Coordinates, dt: f64, measured: &Measured) {
        let Some(locked) = self.locked.filter(|_| self.model.count() >= POSITIONING_JOINTS + 3) else { return };
        let goal = measured.base.rotation.inverse() * measured.reference.rotation * locked;
        let mut begin = measured.position;
        for joint in POSITIONING_JOINTS..self.model.count() {
            begin[joint] = before[joint];
        }
        let kept = self.model.kinematics.orient(&goal, &begin, POSITIONING_JOINTS, &self.model.limits);
        for joint in POSITIONING_JOINTS..self.model.count() {
            let most = self.model.bounds.speed[joint] * dt;
            self.set_point.position[joint] = begin[joint] + (kept[joint] - begin[joint]).clamp(-most, most);
        }
        self.set_point.positioned_from = POSITIONING_JOINTS;
    }

    fn integrate(&mut self, speeds: Coordinates, age: f64, dt: f64) {
        if age > VELOCITY_TIMEOUT {
            self.mode = Mode::HELD;
            self.set_point.velocity = Coordinates::zeros();
            return;
        }
        let before = self.set_point.position;
        for (joint, limits) in self.model.limits.iter().enumerate() {
            let most = self.model.bounds.speed[joint];
            self.set_point.position[joint] = limits.clip(before[joint] + speeds[joint].clamp(-most, most) * dt);
        }
        if dt > 0.0 {
            self.set_point.velocity = (self.set_point.position - before) / dt;
        }
    }

    /// Joint speeds for a twist of the control point in reference axes, damped near singular places.
    fn speeds_of(&self, twist: &Vector6<f64>, measured: &Measured) -> Coordinates {
        let to_base = measured.base.rotation.inverse() * measured.reference.rotation;
        let mut in_base = Vector6::zeros();
        in_base.fixed_rows_mut::<3>(0).copy_from(&(to_base * twist.fixed_rows::<3>(0)));
        in_base.fixed_rows_mut::<3>(3).copy_from(&(to_base * twist.fixed_rows::<3>(3)));
        let jacobian = self.model.kinematics.chain.jacobian(&self.set_point.position);
        pseudo_inverse(&jacobian, &in_base)
    }

    /// Efforts of the mode.
    fn efforts(&self, measured: &Measured) -> Coordinates {
        let chain = &self.model.kinematics.chain;
        match &self.mode {
            Mode::Effort { value, .. } => *value,
            Mode::Wrench { value, frame, .. } => {
                let jacobian = match frame {
                    WrenchFrame::Spatial => chain.spatial_jacobian(&measured.position),
                    WrenchFrame::Body if self.absolute_forces => chain.jacobian(&measured.position),
                    WrenchFrame::Body => chain.body_jacobian(&measured.position),
                };
                jacobian.tr_mul(value)
            }
            _ => Coordinates::zeros(),
        }
    }

    fn advance_jaw(&mut self, dt: f64, measured: &Measured) {
        match self.jaw_mode {
            Mode::Follow { path, elapsed, is_move } => {
                let elapsed = elapsed + dt;
                let point = path.at(elapsed);
                self.set_point.jaw = [point.position[0], point.velocity[0]];
                let follow = Mode::Follow { path, elapsed, is_move };
                self.jaw_mode = if elapsed < path.duration() { follow } else { Mode::HELD };
            }
            Mode::Effort { value, ref mut age } => {
                *age += dt;
                self.set_point.jaw = [measured.jaw[0], 0.0];
                self.set_point.jaw_effort = value[0];
                if *age > EFFORT_TIMEOUT {
                    self.jaw_mode = Mode::HELD;
                }
            }
            _ => (),
        }
        self.set_point.jaw_drive = self.jaw_mode.drive();
    }
}

impl Command {
    /// Whether it changes how the arm behaves, and moves nothing.
    fn is_setting(&self) -> bool {
        matches!(
            self,
            Self::GravityCompensation(_)
                | Self::AbsoluteForces(_)
                | Self::Ratio { .. }
                | Self::BaseFrame { .. }
                | Self::ToolType(_)
                | Self::ToolPresent(_)
                | Self::LockOrientation(_)
                | Self::UnlockOrientation
        )
    }

    fn is_of_jaw(&self) -> bool {
        matches!(self, Self::Jaw { .. } | Self::JawEffort(_))
    }

    fn is_move(&self) -> bool {
        match self {
            Self::Joints { level, .. } | Self::Pose { level, .. } | Self::Jaw { level, .. } => *level == Level::Move,
            Self::Refused { is_move, .. } => *is_move,
            _ => false,
        }
    }
}

/// Joint values x with J x ≈ y, least in norm, damped: Jᵀ (J Jᵀ + λ² I)⁻¹ y.
pub fn pseudo_inverse(jacobian: &Jacobian, twist: &Vector6<f64>) -> Coordinates {
    let square = jacobian * jacobian.transpose();
    let damping = 1e-8 * square.diagonal().max().max(1e-12);
    let inverse = (square + Matrix6::identity() * damping).cholesky();
    inverse.map_or_else(Coordinates::zeros, |inverse| jacobian.transpose() * inverse.solve(twist))
}

/// The wrench F with Jᵀ F ≈ τ, least in norm, damped: J (Jᵀ J + λ² I)⁻¹ τ, by the matrix of 6 × 6.
pub fn wrench_of(jacobian: &Jacobian, efforts: &Coordinates) -> Vector6<f64> {
    let square = jacobian * jacobian.transpose();
    let damping = 1e-8 * square.diagonal().max().max(1e-12);
    let inverse = (square + Matrix6::identity() * damping).cholesky();
    inverse.map_or_else(Vector6::zeros, |inverse| inverse.solve(&(jacobian * efforts)))
}

#[cfg(test)]
pub(crate) mod tests;
