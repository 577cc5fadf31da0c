//! An arm over UDP: one JSON object a datagram, as the dVRK's socket streamer and the peg-transfer competition's bridge to
//! its headset have them. One thread an arm; it uses the same status and the same outbox as the topics.
//!
//! ## Limitations
//! Of what the dVRK's streamer can be configured to send, there are the commands of [`Told`].

use std::fmt::Write as _;
use std::io::ErrorKind;
use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use ambf_plugin::SnapshotSlot;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion};
use serde_json::Value;

use crate::arm::{ArmModel, Command, Drive, JointMessage, Level, OperatingState, PoseMessage, Quantity};
use crate::exchange::{ArmStatus, Outbox, Status};
use crate::kinematics::Coordinates;
use crate::messages::joint_list;

/// Readers of these datagrams have buffers of 1024 bytes: longer ones are not sent.
pub const LONGEST: usize = 1023;

/// Whose datagrams they are like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Style {
    /// The competition's bridge: no frames, nothing behind the object; moves are carried out as servo commands.
    Bridge,
    /// The dVRK's streamer: frames, a newline behind the object, `null` for empty lists; moves are moves.
    Streamer,
}

/// What is told, each in a datagram of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Told {
    /// `setpoint_cp`, in the base.
    SetPointPose,
    /// `measured_cp`, in the base.
    MeasuredPose,
    /// `setpoint_js`.
    SetPointJoints,
    /// `measured_js`.
    MeasuredJoints,
    /// `jaw/setpoint_js`.
    SetPointJaw,
    /// `jaw/measured_js`.
    MeasuredJaw,
    /// `operating_state`, when it has changed.
    OperatingState,
}

impl Told {
    /// All, with their keys.
    pub const ALL: [(&'static str, Self); 7] = [
        ("setpoint_cp", Self::SetPointPose),
        ("measured_cp", Self::MeasuredPose),
        ("setpoint_js", Self::SetPointJoints),
        ("measured_js", Self::MeasuredJoints),
        ("jaw/setpoint_js", Self::SetPointJaw),
        ("jaw/measured_js", Self::MeasuredJaw),
        ("operating_state", Self::OperatingState),
    ];

    fn key(self) -> &'static str {
        Self::ALL.iter().find(|(_, told)| *told == self).map_or("", |(key, _)| key)
    }
}

/// How an arm is offered over UDP.
#[derive(Debug, Clone, PartialEq)]
pub struct SocketConfig {
    /// Where it listens, and from where it sends.
    pub listen: SocketAddr,
    /// Who is told; `None`: whoever sent the last datagram.
    pub to: Option<SocketAddr>,
    /// Whose datagrams they are like.
    pub style: Style,
    /// Rounds a second.
    pub rate: f64,
    /// What is told in a round, in order.
    pub tell: Vec<Told>,
    /// Rotation O between the client and the base: poses are told as Oᵀ · pose, and taken as O · pose. Default: none.
    pub offset: UnitQuaternion<f64>,
}

/// The thread of an arm. Dropping it ends the thread.
pub struct Streamer {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Streamer {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has said so.
            let _ = thread.join();
        }
    }
}

impl Streamer {
    /// Opens the socket of the arm at `index` of the status and starts its thread. `say`: tells the user of the simulator.
    ///
    /// # Errors
    /// A sentence when the address cannot be bound, or no thread can be made.
    pub fn start(
        config: &SocketConfig,
        (model, index): (Arc<ArmModel>, usize),
        outbox: Arc<Outbox>,
        status: Arc<SnapshotSlot<Status>>,
        say: impl Fn(&str) + Send + 'static,
    ) -> Result<Self, String> {
        let listen = config.listen;
        let bound = UdpSocket::bind(listen);
        let socket = bound.map_err(|error| format!("{}: UDP {listen} cannot be used: {error}", model.name))?;
        let ends = Arc::new(AtomicBool::new(false));
        let stream = Stream {
            to: config.to,
            config: config.clone(),
            model,
            index,
            outbox,
            status,
            socket,
            say: Box::new(say),
            complained: false,
            state: None,
        };
        let seen = Arc::clone(&ends);
        let thread = std::thread::Builder::new().name("crtk-udp".into()).spawn(move || stream.run(&seen));
        let thread = thread.map_err(|error| format!("no thread can be made: {error}"))?;
        Ok(Self { ends, thread: Some(thread) })
    }
}

struct Stream {
    config: SocketConfig,
    model: Arc<ArmModel>,
    index: usize,
    outbox: Arc<Outbox>,
    status: Arc<SnapshotSlot<Status>>,
    socket: UdpSocket,
    to: Option<SocketAddr>,
    say: Box<dyn Fn(&str) + Send>,
    /// A datagram of no use is named once.
    complained: bool,
    /// The state that was told last.
    state: Option<OperatingState>,
}

impl Stream {
    fn run(mut self, ends: &AtomicBool) {
        let period = Duration::from_secs_f64(1.0 / self.config.rate);
        let mut due = Instant::now();
        let mut bytes = vec![0; 65536];
        while !ends.load(Ordering::Acquire) {
            let now = Instant::now();
            if now >= due {
                self.tell();
                // What was missed is not made up for.
                due = (due + period).max(now);
            }
            let rest = due.saturating_duration_since(Instant::now()).max(Duration::from_micros(50));
            // A time-out of 0 would be none; that of the platform cannot fail otherwise.
            let _ = self.socket.set_read_timeout(Some(rest));
            match self.socket.recv_from(&mut bytes) {
                Ok((count, from)) => {
                    if self.config.to.is_none() {
                        self.to = Some(from);
                    }
                    self.take(&bytes[..count], from);
                }
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => (),
                // Nobody listens where the last datagram went; the next may be heard.
                Err(_) => std::thread::sleep(rest.min(Duration::from_millis(1))),
            }
        }
    }

    fn tell(&mut self) {
        let (Some(to), Some(status)) = (self.to, self.status.load_full()) else { return };
        let Some(arm) = status.arms.get(self.index) else { return };
        for &told in &self.config.tell {
            if told == Told::OperatingState && self.state.replace(arm.state) == Some(arm.state) {
                continue;
            }
            let text = message(&self.config, &self.model, told, arm, status.wall_time);
            if let Some(text) = text.filter(|text| text.len() <= LONGEST) {
                // A peer that is not there yet may come.
                let _ = self.socket.send_to(text.as_bytes(), to);
            }
        }
    }

    fn take(&mut self, bytes: &[u8], from: SocketAddr) {
        match commands(&self.config, &self.model, bytes) {
            Ok(commands) => commands.into_iter().for_each(|command| self.outbox.post(command)),
            Err(why) if !self.complained => {
                self.complained = true;
                let name = &self.model.name;
                (self.say)(&format!("{name}: a datagram from {from} is of no use: {why}; this is said once"));
            }
            Err(_) => (),
        }
    }
}

// --- out --------------------------------------------------------------------------------------------------------------

/// The text of a datagram; `None` where nothing is known. `stamp`: ns since 1970.
pub fn message(config: &SocketConfig, model: &ArmModel, told: Told, arm: &ArmStatus, stamp: u64) -> Option<String> {
    let reading = arm.reading.as_ref()?;
    let (measured, set_point) = (&reading.measured, &arm.set_point);
    let is_jaw = matches!(told, Told::SetPointJaw | Told::MeasuredJaw);
    if is_jaw && model.jaw.is_none() {
        return None;
    }
    let seconds = stamp as f64 * 1e-9;
    let joints = |values: &Coordinates| joint_list(values, model.joints.len());
    let no_effort = || vec![0.0; model.joints.len()];
    let inner = match told {
        Told::SetPointPose => {
            let pose = model.kinematics.chain.forward(&set_point.position);
            pose_text(config, model, &pose, seconds, arm.has_tool && set_point.drive == Drive::Position)
        }
        Told::MeasuredPose => {
            let pose = reading.base.pose.inv_mul(&reading.tool.pose);
            pose_text(config, model, &pose, seconds, arm.has_tool)
        }
        Told::SetPointJoints => {
            let effort = if set_point.drive == Drive::Effort { joints(&set_point.effort) } else { no_effort() };
            let all = [joints(&set_point.position), joints(&set_point.velocity), effort];
            joints_text(config, &model.joints, all, seconds)
        }
        Told::MeasuredJoints => {
            let all = [joints(&measured.position), joints(&measured.velocity), joints(&measured.effort)];
            joints_text(config, &model.joints, all, seconds)
        }
        Told::SetPointJaw => {
            let all = [set_point.jaw[0], set_point.jaw[1], set_point.jaw_effort].map(|value| vec![value]);
            joints_text(config, &["jaw".into()], all, seconds)
        }
        Told::MeasuredJaw => joints_text(config, &["jaw".into()], measured.jaw.map(|value| vec![value]), seconds),
        Told::OperatingState => {
            let OperatingState { state, is_homed, is_busy, .. } = arm.state;
            format!(
                "{{\"AutomaticTimestamp\":true,\"IsBusy\":{is_busy},\"IsHomed\":{is_homed},\"State\":\"{state}\",\
                 \"Timestamp\":{seconds:?},\"Valid\":true}}"
            )
        }
    };
    let end = if config.style == Style::Streamer { "\n" } else { "" };
    Some(format!("{{\"{}\":{inner}}}{end}", told.key()))
}

/// Numbers between brackets; what is not finite, which JSON has no word for, is `null`.
fn list(values: impl IntoIterator<Item = f64>) -> String {
    let mut text = String::from("[");
    for (place, value) in values.into_iter().enumerate() {
        let comma = if place == 0 { "" } else { "," };
        let written = if value.is_finite() {
            // 0 has no sign here.
            write!(text, "{comma}{:?}", value + 0.0)
        } else {
            write!(text, "{comma}null")
        };
        // Writing to memory cannot fail.
        let _ = written;
    }
    text.push(']');
    text
}

fn pose_text(config: &SocketConfig, model: &ArmModel, pose: &Isometry3<f64>, seconds: f64, valid: bool) -> String {
    let told = config.offset.inverse() * pose;
    let matrix = told.rotation.to_rotation_matrix();
    let rows: Vec<String> = (0..3).map(|row| list((0..3).map(|column| matrix[(row, column)]))).collect();
    let position = list(told.translation.vector.iter().copied());
    let [moving, reference] = match config.style {
        Style::Bridge => [String::new(), String::new()],
        Style::Streamer => {
            [format!("\"MovingFrame\":\"{}\",", model.name), format!("\"ReferenceFrame\":\"{}\",", model.frames.base)]
        }
    };
    // The bridge's poses are always valid.
    let valid = valid || config.style == Style::Bridge;
    format!(
        "{{\"AutomaticTimestamp\":true,{moving}\"Position\":{{\"Rotation\":[{}],\"Translation\":{position}}},{reference}\
         \"Timestamp\":{seconds:?},\"Valid\":{valid}}}",
        rows.join(",")
    )
}

fn joints_text(config: &SocketConfig, names: &[String], values: [Vec<f64>; 3], seconds: f64) -> String {
    let [position, velocity, effort] = values.map(|values| match config.style {
        Style::Streamer if values.is_empty() => "null".to_owned(),
        _ => list(values),
    });
    let names: Vec<String> = names.iter().map(|name| Value::from(name.as_str()).to_string()).collect();
    format!(
        "{{\"AutomaticTimestamp\":true,\"Effort\":{effort},\"Name\":[{}],\"Position\":{position},\
         \"Timestamp\":{seconds:?},\"Valid\":true,\"Velocity\":{velocity}}}",
        names.join(",")
    )
}

// --- in ---------------------------------------------------------------------------------------------------------------

/// The commands of a datagram, in the order of its keys' names. Keys that are not known, and commands whose goal is missing
/// or `null`, are left out; bytes of zero and blanks behind the object do not matter.
///
/// # Errors
/// A sentence when it is no JSON object.
pub fn commands(config: &SocketConfig, model: &ArmModel, bytes: &[u8]) -> Result<Vec<Command>, String> {
    let end = bytes.iter().rposition(|&byte| byte != 0 && !byte.is_ascii_whitespace()).map_or(0, |last| last + 1);
    let value: Value = serde_json::from_slice(&bytes[..end]).map_err(|error| error.to_string())?;
    let Value::Object(keys) = value else { return Err("it is no object".into()) };
    Ok(keys.iter().filter_map(|(key, payload)| command(config, model, key, payload)).collect())
}

fn command(config: &SocketConfig, model: &ArmModel, key: &str, payload: &Value) -> Option<Command> {
    let moves = if config.style == Style::Bridge { Level::Servo } else { Level::Move };
    let goal = payload.get("Goal");
    let joints = |level, quantity, goal: Option<&Value>| {
        let values = numbers(goal?)?;
        let empty = JointMessage::default();
        let message = match quantity {
            Quantity::Velocity => JointMessage { velocity: values, ..empty },
            Quantity::Effort => JointMessage { effort: values, ..empty },
            _ => JointMessage { position: values, ..empty },
        };
        Some(model.joint_command(level, quantity, &message))
    };
    let pose = |level| Some(model.pose_command(level, &pose_message(config, goal?)?, true));
    let jaw = |level| {
        let position = numbers(goal?)?;
        Some(model.jaw_command(level, Quantity::Position, &JointMessage { position, ..JointMessage::default() }))
    };
    match key {
        "servo_jp" => joints(Level::Servo, Quantity::Position, goal),
        "move_jp" => joints(moves, Quantity::Position, goal),
        "servo_jr" => joints(Level::Servo, Quantity::Relative, goal),
        "move_jr" => joints(moves, Quantity::Relative, goal),
        "servo_jv" => joints(Level::Servo, Quantity::Velocity, goal.or(payload.get("Velocity"))),
        "servo_jf" => joints(Level::Servo, Quantity::Effort, payload.get("ForceTorque").or(goal)),
        "servo_cp" => pose(Level::Servo),
        "move_cp" => pose(moves),
        "jaw/servo_jp" => jaw(Level::Servo),
        "jaw/move_jp" => jaw(moves),
        "hold" => Some(Command::Hold),
        "free" => Some(Command::Free),
        "state_command" => payload.as_str().map(|text| Command::State(text.to_owned())),
        _ => None,
    }
}

/// Most numbers of a list that is read.
const MOST: usize = 64;

fn numbers(value: &Value) -> Option<Vec<f64>> {
    let list = value.as_array().filter(|list| list.len() <= MOST)?;
    list.iter().map(Value::as_f64).collect()
}

/// A rotation matrix may be off by so much in each element of its product with its transpose.
const ROUNDED: f64 = 1e-2;

fn pose_message(config: &SocketConfig, goal: &Value) -> Option<PoseMessage> {
    let rows = goal.get("Rotation")?.as_array().filter(|rows| rows.len() == 3)?;
    let rows: Vec<f64> = rows.iter().map(numbers).collect::<Option<Vec<_>>>()?.concat();
    let place = numbers(goal.get("Translation")?)?;
    let (&[x, y, z], true) = (place.as_slice(), rows.len() == 9) else { return None };
    let matrix = Matrix3::from_row_slice(&rows);
    let gap = (matrix.transpose() * matrix - Matrix3::identity()).abs().max();
    // Not a rotation, or a mirror image: the arm refuses the quaternion.
    let is_rotation = gap < ROUNDED && matrix.determinant() > 0.0;
    let rotation = Rotation3::from_matrix_eps(
        &if is_rotation { matrix } else { Matrix3::identity() },
        1e-12,
        100,
        Rotation3::identity(),
    );
    let pose = config.offset * Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from(rotation));
    let q = pose.rotation.coords;
    let orientation = if is_rotation { [q.x, q.y, q.z, q.w] } else { [0.0; 4] };
    let position = pose.translation.vector.into();
    Some(PoseMessage { frame: String::new(), position, orientation })
}

#[cfg(test)]
mod tests;
