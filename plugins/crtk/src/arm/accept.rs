//! What an arm does with a command: it is taken over, or refused.

use nalgebra::Isometry3;

use super::command::quoted;
use super::{
    outcome, Arm, Command, Drive, Event, Frame, Level, Measured, Mode, Now, Outcome, Quantity, RatioOf, Refusal,
};
use crate::kinematics::Coordinates;

/// A warning about poses without a solution comes at most so often, ns.
const INVERSE_WARNINGS: u64 = 1_000_000_000;

impl Arm {
    pub(super) fn take(&mut self, command: Command, now: &mut Now<'_>) {
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
            self.report_state(true, now);
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
            Command::JointErrors(errors) => self.errors = errors,
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
        self.report_state(self.is_busy(), now);
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
                | Self::JointErrors(_)
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
