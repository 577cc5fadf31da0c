//! Topics of arms: messages from what a step has left, commands from what comes.

use std::collections::HashSet;
use std::mem::{discriminant, Discriminant};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use ambf_plugin::SnapshotSlot;
use crossbeam_channel::{Receiver, RecvTimeoutError};
use nalgebra::{Isometry3, Vector6};

use crate::arm::{
    refused, wrench_of, ArmModel, Command, Dialect, Drive, Event, FrameName, JointMessage, Level, OperatingState,
    RatioOf, Ratios, Refusal, WrenchFrame,
};
use crate::bind::{Moving, Reading};
use crate::config::ClockKind;
use crate::exchange::{ArmStatus, Outbox, Status};
use crate::messages::{self, Header, Message};
use crate::statistics::Statistics;
use crate::topics::{Carries, Input, Output, Topic};
use crate::transport::{Receive, Sender, Transport, TransportError};

/// A status that is older shows that the simulation is paused.
pub(crate) const PAUSED: Duration = Duration::from_millis(100);

/// ns since 1970.
pub fn wall_time() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(now.as_nanos()).unwrap_or(u64::MAX)
}

/// What is said about an arm by itself, not by a state.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Texts {
    /// Number of its instrument.
    pub tool_type: Option<String>,
    /// What its user should know, at the start.
    pub info: Vec<String>,
}

/// A topic that is sent on all transports.
struct Outlet {
    output: Output,
    senders: Vec<Box<dyn Sender>>,
    /// Of a latched topic: what each sender was not open for yet.
    waiting: Vec<Option<Message>>,
}

impl Outlet {
    fn is_wanted(&self) -> bool {
        self.senders.iter().any(|sender| sender.has_receivers())
    }

    fn send(&self, message: &Message) {
        self.senders.iter().filter(|sender| sender.has_receivers()).for_each(|sender| sender.send(message));
    }

    /// Sends what those who come later have to see, too.
    fn keep(&mut self, message: &Message) {
        for (sender, waiting) in self.senders.iter().zip(&mut self.waiting) {
            if sender.is_open() {
                sender.send(message);
            } else {
                *waiting = Some(message.clone());
            }
        }
    }

    fn catch_up(&mut self) {
        for (sender, waiting) in self.senders.iter().zip(&mut self.waiting) {
            if sender.is_open() {
                waiting.take().iter().for_each(|message| sender.send(message));
            }
        }
    }
}

/// What an arm says of itself, whoever carries it.
pub(crate) struct Face {
    pub model: Arc<ArmModel>,
    /// Name of the frame of what is published, where a client has set it.
    pub reference: Option<FrameName>,
}

/// One arm as clients see it.
pub struct Offered {
    face: Face,
    clock: ClockKind,
    period: Duration,
    due: Instant,
    texts: Texts,
    outlets: Vec<Outlet>,
    /// The last window whose statistics were sent.
    window: u64,
}

impl Offered {
    /// Opens the topics of an arm on all transports.
    ///
    /// # Errors
    /// [`TransportError`].
    pub fn open(
        (model, topics): (&Arc<ArmModel>, &[Topic]),
        (rate, clock): (f64, ClockKind),
        texts: Texts,
        outbox: &Arc<Outbox>,
        transports: &mut [Box<dyn Transport>],
    ) -> Result<Self, TransportError> {
        let mut outlets = Vec::new();
        for topic in topics {
            match topic.carries {
                Carries::Out(output) => {
                    let senders = transports.iter_mut().map(|transport| transport.advertise(topic));
                    let senders = senders.collect::<Result<Vec<_>, _>>()?;
                    let waiting = senders.iter().map(|_| None).collect();
                    outlets.push(Outlet { output, senders, waiting });
                }
                Carries::In(input) => {
                    let (model, outbox) = (Arc::clone(model), Arc::clone(outbox));
                    let receive: Receive = Arc::new(move |bytes| outbox.post(command(&model, input, bytes)));
                    for transport in transports.iter_mut() {
                        transport.subscribe(topic, Arc::clone(&receive))?;
                    }
                }
            }
        }
        let period = Duration::from_secs_f64(1.0 / rate);
        let face = Face { model: Arc::clone(model), reference: None };
        let mut offered = Self { face, clock, period, due: Instant::now(), texts, outlets, window: 0 };
        offered.introduce();
        Ok(offered)
    }

    /// Sends what never changes.
    fn introduce(&mut self) {
        if let Some(tool_type) = self.texts.tool_type.take() {
            self.keep(Output::ToolType, &Message::Text(tool_type));
        }
        let info = std::mem::take(&mut self.texts.info);
        info.into_iter().for_each(|text| self.say(Output::Info, wall_time(), text));
    }

    /// Sends what those have to see, too, who come later.
    fn keep(&mut self, output: Output, message: &Message) {
        self.outlets.iter_mut().filter(|outlet| outlet.output == output).for_each(|outlet| outlet.keep(message));
    }

    fn say(&mut self, output: Output, stamp: u64, text: String) {
        let message = match self.face.model.dialect {
            Dialect::Dvrk => Message::Text(text),
            _ => Message::StampedText(self.face.header(stamp, false), text),
        };
        self.outlets.iter().filter(|outlet| outlet.output == output).for_each(|outlet| outlet.send(&message));
    }

    /// Tells clients of an event.
    fn tell(&mut self, event: &Event) {
        match event {
            Event::Warning { stamp, refusal } => self.say(Output::Warning, *stamp, refusal.to_string()),
            Event::Goal(reached) => self.keep(Output::GoalReached, &Message::Bool(*reached)),
            Event::Ratios(Ratios { speed, acceleration }) => {
                self.keep(Output::Ratio(RatioOf::Speeds), &Message::Number(*speed));
                self.keep(Output::Ratio(RatioOf::Accelerations), &Message::Number(*acceleration));
                self.keep(Output::Ratio(RatioOf::Both), &Message::Number(speed.min(*acceleration)));
            }
            Event::Tool(Some(number)) => self.keep(Output::ToolType, &Message::Text(number.as_str().to_owned())),
            Event::Tool(None) => self.keep(Output::ToolTypeRequest, &Message::Empty),
            Event::OrientationLocked(locked) => self.keep(Output::OrientationLocked, &Message::Bool(*locked)),
            Event::State(state) => {
                let full = self.face.operating_state(state);
                let text = Message::StampedText(self.face.header(state.stamp, false), state.state.to_string());
                self.keep(Output::OperatingState, &full);
                self.keep(Output::StateName, &text);
            }
        }
    }

    /// Sends the topics that are sent all the time.
    fn publish(&mut self, status: &ArmStatus, stamp: u64) {
        self.outlets.iter_mut().for_each(Outlet::catch_up);
        self.face.reference = status.reference_name;
        let Some(reading) = &status.reading else { return };
        for outlet in self.outlets.iter().filter(|outlet| outlet.output.is_periodic() && outlet.is_wanted()) {
            if let Some(message) = self.face.message(outlet.output, status, reading, stamp) {
                outlet.send(&message);
            }
        }
    }

    /// Sends the statistics of a window that is over, once.
    fn tell_statistics(&mut self, statistics: &Statistics, stamp: u64) {
        if std::mem::replace(&mut self.window, statistics.window) == statistics.window {
            return;
        }
        let message = Message::Statistics(self.face.header(stamp, false), *statistics);
        self.outlets
            .iter()
            .filter(|outlet| outlet.output == Output::Statistics)
            .for_each(|outlet| outlet.send(&message));
    }
}

impl Face {
    fn header(&self, stamp: u64, is_local: bool) -> Header {
        let frames = &self.model.frames;
        let world = is_local && self.model.dialect == Dialect::Plugin;
        let frame = match is_local {
            _ if world => "world",
            true => &frames.base,
            false => self.reference.as_ref().map_or(frames.reference.as_str(), FrameName::as_str),
        };
        Header { stamp, frame: frame.to_owned() }
    }

    /// What a periodic topic, or that of the operating state, says after a step.
    pub fn message(&self, output: Output, status: &ArmStatus, reading: &Reading, stamp: u64) -> Option<Message> {
        let (measured, set_point) = (&reading.measured, &status.set_point);
        // Without an instrument there is no control point.
        let of_tool = |is_local| {
            let stamp = if status.has_tool { stamp } else { 0 };
            self.header(stamp, is_local)
        };
        let chain = &self.model.kinematics.chain;
        Some(match output {
            Output::MeasuredJoints => {
                let effort = self.list(&measured.effort);
                self.joints(stamp, self.list(&measured.position), self.list(&measured.velocity), effort)
            }
            Output::SetPointJoints => {
                let is_effort = set_point.drive == Drive::Effort;
                let effort = if is_effort { self.list(&set_point.effort) } else { Vec::new() };
                self.joints(stamp, self.list(&set_point.position), self.list(&set_point.velocity), effort)
            }
            Output::MeasuredPose { is_local } => {
                Message::Pose(of_tool(is_local), self.place(is_local, reading, &reading.tool.pose))
            }
            Output::SetPointPose { is_local } => {
                let mut header = of_tool(is_local);
                if set_point.drive == Drive::Effort {
                    header.stamp = 0;
                }
                let pose = reading.base.pose * chain.forward(&set_point.position);
                Message::Pose(header, self.place(is_local, reading, &pose))
            }
            Output::MeasuredTwist => Message::Twist(of_tool(false), relative_twist(&reading.tool, &reading.reference)),
            Output::MeasuredWrench(frame) => {
                let jacobian = match frame {
                    WrenchFrame::Spatial => chain.spatial_jacobian(&measured.position),
                    WrenchFrame::Body if status.absolute_forces => chain.jacobian(&measured.position),
                    WrenchFrame::Body => chain.body_jacobian(&measured.position),
                };
                Message::Wrench(of_tool(true), wrench_of(&jacobian, &measured.effort))
            }
            Output::Jacobian(frame) => {
                let jacobian = match frame {
                    WrenchFrame::Spatial => chain.spatial_jacobian(&measured.position),
                    WrenchFrame::Body => chain.body_jacobian(&measured.position),
                };
                let columns = self.model.count();
                let data = (0..6).flat_map(|row| (0..columns).map(move |column| jacobian[(row, column)])).collect();
                Message::Jacobian { columns, data }
            }
            Output::MeasuredJaw => {
                let [position, velocity, effort] = measured.jaw;
                self.jaw(stamp, position, velocity, Some(effort))
            }
            Output::SetPointJaw => {
                let effort = (set_point.jaw_drive == Drive::Effort).then_some(set_point.jaw_effort);
                self.jaw(stamp, set_point.jaw[0], set_point.jaw[1], effort)
            }
            Output::BaseInWorld => Message::Pose(Header { stamp, frame: "world".into() }, reading.base.pose),
            Output::OperatingState => self.operating_state(&status.state),
            // Not of a state.
            _ => return None,
        })
    }

    fn operating_state(&self, state: &OperatingState) -> Message {
        let header = self.header(state.stamp, false);
        let (is_homed, is_busy) = (state.is_homed, state.is_busy);
        Message::OperatingState { header, state: state.state.to_string(), is_homed, is_busy }
    }

    /// A pose in the world as it is published.
    fn place(&self, is_local: bool, reading: &Reading, pose: &Isometry3<f64>) -> Isometry3<f64> {
        match is_local {
            // What the C++ plugin calls local is the world.
            true if self.model.dialect == Dialect::Plugin => *pose,
            true => reading.base.pose.inv_mul(pose),
            false => reading.reference.pose.inv_mul(pose),
        }
    }

    fn list(&self, values: &crate::kinematics::Coordinates) -> Vec<f64> {
        messages::joint_list(values, self.model.joints.len())
    }

    fn joints(&self, stamp: u64, position: Vec<f64>, velocity: Vec<f64>, effort: Vec<f64>) -> Message {
        let mut names = self.model.joints.clone();
        if self.model.dialect == Dialect::Src {
            // As its interface has them: the names of the fingers too, no efforts, no frame.
            names.extend(self.model.fingers.iter().cloned());
            let joints = JointMessage { names, position, velocity, effort: Vec::new() };
            return Message::Joints(Header { stamp, frame: String::new() }, joints);
        }
        Message::Joints(self.header(stamp, false), JointMessage { names, position, velocity, effort })
    }

    fn jaw(&self, stamp: u64, position: f64, velocity: f64, effort: Option<f64>) -> Message {
        let joints = JointMessage {
            names: vec!["jaw".into()],
            position: vec![position],
            velocity: vec![velocity],
            effort: effort.into_iter().collect(),
        };
        Message::Joints(self.header(stamp, false), joints)
    }
}

/// Twist of a frame seen from another that moves, too, in the axes of that.
pub fn relative_twist(tool: &Moving, reference: &Moving) -> Vector6<f64> {
    let halves = |twist: &Vector6<f64>| (twist.fixed_rows::<3>(0).into_owned(), twist.fixed_rows::<3>(3).into_owned());
    let ((v, w), (v_ref, w_ref)) = (halves(&tool.twist), halves(&reference.twist));
    let apart = tool.pose.translation.vector - reference.pose.translation.vector;
    let to_reference = reference.pose.rotation.inverse();
    let linear = to_reference * (v - v_ref - w_ref.cross(&apart));
    let angular = to_reference * (w - w_ref);
    Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
}

/// The command that the bytes of a message are.
pub fn command(model: &ArmModel, input: Input, bytes: &[u8]) -> Command {
    let level = match input {
        Input::Joints(level, _) | Input::Pose { level, .. } | Input::Jaw(level, _) => level,
        _ => Level::Servo,
    };
    let read = match input {
        Input::Joints(level, quantity) => {
            messages::read_joints(bytes).map(|joints| model.joint_command(level, quantity, &joints))
        }
        Input::Pose { level, is_local } => {
            messages::read_pose(bytes).map(|pose| model.pose_command(level, &pose, is_local))
        }
        Input::Twist => messages::read_six(bytes).map(|(v, w)| ArmModel::six_command(v, w, Command::Twist)),
        Input::Wrench(frame) => messages::read_six(bytes)
            .map(|(f, t)| ArmModel::six_command(f, t, |wrench| Command::Wrench { wrench, frame })),
        Input::Jaw(level, quantity) => {
            messages::read_joints(bytes).map(|joints| model.jaw_command(level, quantity, &joints))
        }
        Input::State => messages::read_stamped_text(bytes).map(Command::State),
        Input::Hold => bytes.is_empty().then_some(Command::Hold),
        Input::Free => bytes.is_empty().then_some(Command::Free),
        Input::GravityCompensation => messages::read_bool(bytes).map(Command::GravityCompensation),
        Input::AbsoluteForces => messages::read_bool(bytes).map(Command::AbsoluteForces),
        Input::Ratio(of) => messages::read_number(bytes).map(|value| ArmModel::ratio_command(of, value)),
        Input::BaseFrame => messages::read_pose(bytes).map(|pose| model.base_frame_command(&pose)),
        Input::ToolType => messages::read_text(bytes).map(|name| model.tool_type_command(&name)),
        Input::ToolPresent => messages::read_bool(bytes).map(Command::ToolPresent),
        Input::LockOrientation => messages::read_quaternion(bytes).map(ArmModel::orientation_command),
        Input::UnlockOrientation => bytes.is_empty().then_some(Command::UnlockOrientation),
        Input::JointErrors => messages::read_channel(bytes).map(|values| model.errors_command(&values)),
        Input::Seed => None,
    };
    read.unwrap_or_else(|| refused(level, Refusal::Unreadable))
}

/// The thread that publishes: states when they are due, events at once.
pub struct Publisher {
    /// Sets of topics, each with the place of its arm in the status; an arm may have several.
    pub arms: Vec<(usize, Offered)>,
    /// Newest status.
    pub status: Arc<SnapshotSlot<Status>>,
    /// Events: which arm, what. It ends when nobody can send any more.
    pub events: Receiver<(usize, Event)>,
    /// `/clock`, where somebody uses simulated time.
    pub clock: Vec<Box<dyn Sender>>,
    /// Keeps the transports until the end.
    pub transports: Vec<Box<dyn Transport>>,
    /// What the user of the simulator is told: refused commands, each arm and reason once. Not every dialect has a topic
    /// for that, and not every client listens.
    pub told: Told,
}

/// Tells the user of the simulator of refused commands, each arm and reason once.
pub struct Told {
    say: Box<dyn Fn(&str) + Send>,
    said: HashSet<(usize, Discriminant<Refusal>)>,
}

impl Told {
    /// By `say`.
    pub fn new(say: impl Fn(&str) + Send + 'static) -> Self {
        Self { say: Box::new(say), said: HashSet::new() }
    }

    fn tell(&mut self, arm: usize, name: &str, event: &Event) {
        if let Event::Warning { refusal, .. } = event {
            if self.said.insert((arm, discriminant(refusal))) {
                (self.say)(&format!("{name}: {refusal}; this reason is said once"));
            }
        }
    }
}

impl Publisher {
    /// Publishes until the events end.
    pub fn run(mut self) {
        loop {
            let due = self.arms.iter().map(|(_, arm)| arm.due).min().unwrap_or_else(|| Instant::now() + PAUSED);
            match self.events.recv_deadline(due) {
                Ok((arm, event)) => {
                    for (_, offered) in self.arms.iter_mut().filter(|(owner, _)| *owner == arm) {
                        // Each arm and reason is said once, by the first of its names.
                        self.told.tell(arm, &offered.face.model.name, &event);
                        offered.tell(&event);
                    }
                }
                Err(RecvTimeoutError::Timeout) => self.publish(),
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    /// Publishes the arms that are due, all from one step.
    fn publish(&mut self) {
        let now = Instant::now();
        let status = self.status.load_full();
        let wall = wall_time();
        let is_paused =
            status.as_ref().is_none_or(|status| Duration::from_nanos(wall.saturating_sub(status.wall_time)) > PAUSED);
        if let Some(status) = &status {
            let clock = Message::Clock(status.sim_time);
            self.clock.iter().filter(|sender| sender.has_receivers()).for_each(|sender| sender.send(&clock));
        }
        for (index, arm) in self.arms.iter_mut().filter(|(_, arm)| arm.due <= now) {
            arm.due += arm.period;
            if arm.due < now {
                // What was missed is not made up for.
                arm.due = now + arm.period;
            }
            let Some(status) = &status else {
                arm.outlets.iter_mut().for_each(Outlet::catch_up);
                continue;
            };
            let stamp = match (arm.clock, is_paused) {
                (ClockKind::Wall, false) => status.wall_time,
                (ClockKind::Wall, true) => wall,
                (ClockKind::Sim, false) => status.sim_time,
                (ClockKind::Sim, true) => 0,
            };
            if let Some(own) = status.arms.get(*index) {
                arm.publish(own, stamp);
                arm.tell_statistics(&status.statistics, stamp);
            }
        }
    }
}

#[cfg(test)]
mod tests;
