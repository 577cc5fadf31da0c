//! Topics of an arm, as data: what they are called, of which type, in which direction, and how they are delivered.

use crate::arm::{ArmModel, Dialect, Level, Quantity, RatioOf, WrenchFrame};
use crate::messages::MessageType;

/// What a topic brings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Output {
    /// Joints as measured.
    MeasuredJoints,
    /// Joints as they are to be.
    SetPointJoints,
    /// Pose as measured; local: in the base.
    MeasuredPose {
        /// In the base, else in the reference frame.
        is_local: bool,
    },
    /// Pose as it is to be.
    SetPointPose {
        /// In the base, else in the reference frame.
        is_local: bool,
    },
    /// Twist of the control point.
    MeasuredTwist,
    /// Wrench that the efforts of the joints make.
    MeasuredWrench(WrenchFrame),
    /// Jacobian.
    Jacobian(WrenchFrame),
    /// Jaw as measured.
    MeasuredJaw,
    /// Jaw as it is to be.
    SetPointJaw,
    /// Operating state, at each event.
    OperatingState,
    /// Name of the state, at each event.
    StateName,
    /// What users should know.
    Info,
    /// Refused commands.
    Warning,
    /// Faults.
    Error,
    /// Number of the instrument.
    ToolType,
    /// The base in the world.
    BaseInWorld,
    /// Periods and computing times, at the end of each window.
    Statistics,
    /// Whether the last move has come to its goal, when it has ended.
    GoalReached,
    /// Share of the limits of trajectories, when it changes.
    Ratio(RatioOf),
    /// That the number of the instrument is to be published.
    ToolTypeRequest,
    /// Whether the orientation is kept.
    OrientationLocked,
}

impl Output {
    /// Whether it is sent all the time; else when something happens.
    pub fn is_periodic(self) -> bool {
        use Output::{Error, Info, Statistics, Warning};
        !self.is_latched() && !matches!(self, Info | Warning | Error | Statistics)
    }

    /// Whether those who come later get the last one, too.
    pub fn is_latched(self) -> bool {
        use Output::{GoalReached, OperatingState, OrientationLocked, Ratio, StateName, ToolType, ToolTypeRequest};
        matches!(
            self,
            OperatingState | StateName | ToolType | GoalReached | Ratio(_) | ToolTypeRequest | OrientationLocked
        )
    }
}

/// What a topic takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Input {
    /// Joint values.
    Joints(Level, Quantity),
    /// A pose; local: without a frame it is in the base.
    Pose {
        /// How.
        level: Level,
        /// In the base, else in the reference frame.
        is_local: bool,
    },
    /// A twist.
    Twist,
    /// A wrench.
    Wrench(WrenchFrame),
    /// A jaw command.
    Jaw(Level, Quantity),
    /// A state command.
    State,
    /// Hold.
    Hold,
    /// Free.
    Free,
    /// Gravity compensation on or off.
    GravityCompensation,
    /// Axes of wrenches.
    AbsoluteForces,
    /// Share of the limits of trajectories.
    Ratio(RatioOf),
    /// Pose of the base in the reference frame.
    BaseFrame,
    /// Name of the instrument.
    ToolType,
    /// Whether there is an instrument.
    ToolPresent,
    /// An orientation to be kept.
    LockOrientation,
    /// Nothing is kept.
    UnlockOrientation,
    /// Errors of the joints.
    JointErrors,
    /// The seed of a run. It is no arm's.
    Seed,
}

/// Direction of a topic and what it carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Carries {
    /// To clients.
    Out(Output),
    /// From clients.
    In(Input),
}

/// A topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic {
    /// Full name, from `/` on.
    pub name: String,
    /// Type of its messages.
    pub message: MessageType,
    /// Direction and content.
    pub carries: Carries,
    /// Whether a new subscriber gets the last message (ROS 1: latched, ROS 2: transient local).
    pub is_latched: bool,
    /// Messages that are kept for a slow peer.
    pub depth: usize,
}

/// Which topics an arm has beyond those of its dialect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Extras {
    /// Those of the real dVRK, except `status`.
    pub dvrk: bool,
    /// There is a number of an instrument.
    pub tool_type: bool,
    /// What it has is no jaw but a gripper, which is only measured: a master.
    pub gripper: bool,
}

/// Builds the list.
struct List {
    space: String,
    topics: Vec<Topic>,
    depth: usize,
}

impl List {
    fn out(&mut self, name: &str, message: MessageType, output: Output) {
        let is_latched = output.is_latched();
        let is_state = matches!(output, Output::OperatingState | Output::StateName);
        let depth = if is_latched && !is_state { 1 } else { self.depth };
        let name = format!("{}/{name}", self.space);
        self.topics.push(Topic { name, message, carries: Carries::Out(output), is_latched, depth });
    }

    fn input(&mut self, name: &str, message: MessageType, input: Input) {
        let depth = match input {
            Input::Joints(Level::Move, _) | Input::Pose { level: Level::Move, .. } | Input::Jaw(Level::Move, _) => 10,
            Input::Joints(..) | Input::Pose { .. } | Input::Jaw(..) | Input::Twist | Input::Wrench(_) => 1,
            _ => 10,
        };
        let name = format!("{}/{name}", self.space);
        self.topics.push(Topic { name, message, carries: Carries::In(input), is_latched: false, depth });
    }

    fn states(&mut self) {
        self.out("measured_js", MessageType::Joints, Output::MeasuredJoints);
        self.out("setpoint_js", MessageType::Joints, Output::SetPointJoints);
        self.out("measured_cp", MessageType::Pose, Output::MeasuredPose { is_local: false });
        self.out("setpoint_cp", MessageType::Pose, Output::SetPointPose { is_local: false });
        self.out("measured_cv", MessageType::Twist, Output::MeasuredTwist);
        self.out("operating_state", MessageType::OperatingState, Output::OperatingState);
    }

    fn local_poses(&mut self) {
        self.out("local/measured_cp", MessageType::Pose, Output::MeasuredPose { is_local: true });
        self.out("local/setpoint_cp", MessageType::Pose, Output::SetPointPose { is_local: true });
    }

    fn motion(&mut self) {
        self.input("state_command", MessageType::StampedText, Input::State);
        for (level, prefix) in [(Level::Servo, "servo"), (Level::Move, "move"), (Level::Interpolate, "interpolate")] {
            let joints = Input::Joints(level, Quantity::Position);
            self.input(&format!("{prefix}_jp"), MessageType::Joints, joints);
            let pose = Input::Pose { level, is_local: false };
            self.input(&format!("{prefix}_cp"), MessageType::Pose, pose);
        }
    }

    fn jaw(&mut self) {
        self.out("jaw/measured_js", MessageType::Joints, Output::MeasuredJaw);
        self.out("jaw/setpoint_js", MessageType::Joints, Output::SetPointJaw);
        self.input("jaw/servo_jp", MessageType::Joints, Input::Jaw(Level::Servo, Quantity::Position));
        self.input("jaw/move_jp", MessageType::Joints, Input::Jaw(Level::Move, Quantity::Position));
    }

    fn robot(&mut self, has_jaw: bool) {
        for (space, frame) in [("body", WrenchFrame::Body), ("spatial", WrenchFrame::Spatial)] {
            self.out(&format!("{space}/measured_cf"), MessageType::Wrench, Output::MeasuredWrench(frame));
            self.out(&format!("{space}/jacobian"), MessageType::Matrix, Output::Jacobian(frame));
            self.input(&format!("{space}/servo_cf"), MessageType::Wrench, Input::Wrench(frame));
        }
        self.out("period_statistics", MessageType::Statistics, Output::Statistics);
        self.input("servo_jv", MessageType::Joints, Input::Joints(Level::Servo, Quantity::Velocity));
        self.input("servo_cv", MessageType::Twist, Input::Twist);
        self.input("servo_jr", MessageType::Joints, Input::Joints(Level::Servo, Quantity::Relative));
        self.input("move_jr", MessageType::Joints, Input::Joints(Level::Move, Quantity::Relative));
        self.input("servo_jf", MessageType::Joints, Input::Joints(Level::Servo, Quantity::Effort));
        self.input("hold", MessageType::Empty, Input::Hold);
        self.input("free", MessageType::Empty, Input::Free);
        self.input("use_gravity_compensation", MessageType::Bool, Input::GravityCompensation);
        self.input("body/set_cf_orientation_absolute", MessageType::Bool, Input::AbsoluteForces);
        self.out("goal_reached", MessageType::Bool, Output::GoalReached);
        for (end, of) in [("", RatioOf::Both), ("_v", RatioOf::Speeds), ("_a", RatioOf::Accelerations)] {
            self.out(&format!("trajectory_j/ratio{end}"), MessageType::Number, Output::Ratio(of));
            self.input(&format!("trajectory_j/set_ratio{end}"), MessageType::Number, Input::Ratio(of));
        }
        self.input("set_base_frame", MessageType::Pose, Input::BaseFrame);
        if has_jaw {
            self.input("jaw/servo_jf", MessageType::Joints, Input::Jaw(Level::Servo, Quantity::Effort));
            self.input("set_tool_type", MessageType::Text, Input::ToolType);
            self.out("tool_type_request", MessageType::Empty, Output::ToolTypeRequest);
            self.input("emulate_tool_present", MessageType::Bool, Input::ToolPresent);
        }
    }

    fn master(&mut self) {
        self.input("lock_orientation", MessageType::Quaternion, Input::LockOrientation);
        self.input("unlock_orientation", MessageType::Empty, Input::UnlockOrientation);
        self.out("orientation_locked", MessageType::Bool, Output::OrientationLocked);
    }

    fn challenge(&mut self, has_jaw: bool) {
        self.out("measured_js", MessageType::Joints, Output::MeasuredJoints);
        self.out("measured_cp", MessageType::Pose, Output::MeasuredPose { is_local: true });
        self.out("measured_cv", MessageType::Twist, Output::MeasuredTwist);
        self.out("T_b_w", MessageType::Pose, Output::BaseInWorld);
        self.input("servo_jp", MessageType::Joints, Input::Joints(Level::Servo, Quantity::Position));
        self.input("move_jp", MessageType::Joints, Input::Joints(Level::Move, Quantity::Position));
        self.input("servo_jv", MessageType::Joints, Input::Joints(Level::Servo, Quantity::Velocity));
        self.input("servo_cp", MessageType::Pose, Input::Pose { level: Level::Servo, is_local: true });
        self.input("move_cp", MessageType::Pose, Input::Pose { level: Level::Move, is_local: true });
        if has_jaw {
            // The interface of 2026 has the first spelling, others the second.
            self.out("jaw/measure_js", MessageType::Joints, Output::MeasuredJaw);
            self.out("jaw/measured_js", MessageType::Joints, Output::MeasuredJaw);
            self.input("jaw/servo_jp", MessageType::Joints, Input::Jaw(Level::Servo, Quantity::Position));
        }
    }
}

/// Topics of an arm whose names begin with `space`, such as `/PSM1`.
pub fn topics(model: &ArmModel, space: &str, extras: Extras) -> Vec<Topic> {
    let depth = if model.dialect == Dialect::Src { 1 } else { 10 };
    let mut list = List { space: space.trim_end_matches('/').to_owned(), topics: Vec::new(), depth };
    let has_jaw = model.jaw.is_some();
    if model.dialect == Dialect::Src {
        list.challenge(has_jaw);
        return list.topics;
    }
    list.states();
    list.motion();
    let text = if model.dialect == Dialect::Dvrk { MessageType::Text } else { MessageType::StampedText };
    let info = if model.dialect == Dialect::Dvrk { "status" } else { "info" };
    list.out(info, text, Output::Info);
    list.out("warning", text, Output::Warning);
    list.out("error", text, Output::Error);
    if model.dialect != Dialect::Dvrk {
        list.out("state", MessageType::StampedText, Output::StateName);
    }
    let is_robot = extras.dvrk || model.dialect == Dialect::Dvrk;
    if (has_jaw && !extras.gripper) || is_robot || model.dialect == Dialect::Plugin {
        list.local_poses();
    }
    match has_jaw {
        true if extras.gripper => list.out("gripper/measured_js", MessageType::Joints, Output::MeasuredJaw),
        true => list.jaw(),
        false => (),
    }
    if extras.tool_type || (is_robot && has_jaw && !extras.gripper) {
        list.out("tool_type", MessageType::Text, Output::ToolType);
    }
    if is_robot {
        list.robot(has_jaw && !extras.gripper);
        if extras.gripper {
            list.master();
        }
    }
    list.topics
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::tests::psm;

    fn names(dialect: Dialect, jaw: bool) -> Vec<String> {
        let mut model = psm(dialect);
        if !jaw {
            model.jaw = None;
        }
        let extras = Extras { tool_type: jaw, ..Extras::default() };
        let mut names: Vec<String> =
            topics(&model, "/PSM1", extras).into_iter().map(|topic| topic.name["/PSM1/".len()..].to_owned()).collect();
        names.sort();
        names
    }

    #[test]
    fn the_contract_has_these_topics() {
        let expected = "error info interpolate_cp interpolate_jp jaw/measured_js jaw/move_jp jaw/servo_jp \
             jaw/setpoint_js local/measured_cp local/setpoint_cp measured_cp measured_cv measured_js move_cp move_jp \
             operating_state servo_cp servo_jp setpoint_cp setpoint_js state state_command tool_type warning";
        assert_eq!(names(Dialect::Contract, true).join(" "), expected);
        let ecm = names(Dialect::Contract, false);
        assert!(!ecm.iter().any(|name| name.starts_with("jaw/") || name.starts_with("local/")));
    }

    #[test]
    fn the_robot_has_what_its_component_asks_for() {
        let all = names(Dialect::Dvrk, true);
        for name in "hold free state_command servo_cp servo_jp body/servo_cf use_gravity_compensation operating_state \
                     setpoint_js measured_js setpoint_cp measured_cp measured_cv error warning status jaw/servo_jp \
                     period_statistics \
                     jaw/setpoint_js jaw/measured_js"
            .split_whitespace()
        {
            assert!(all.iter().any(|other| other == name), "{name}");
        }
        // dvrk_arm_from_ros, by type.
        let types = [
            ("hold free", MessageType::Empty),
            ("state_command", MessageType::StampedText),
            ("servo_cp setpoint_cp measured_cp", MessageType::Pose),
            ("servo_jp setpoint_js measured_js jaw/servo_jp jaw/setpoint_js jaw/measured_js", MessageType::Joints),
            ("body/servo_cf", MessageType::Wrench),
            ("use_gravity_compensation", MessageType::Bool),
            ("operating_state", MessageType::OperatingState),
            ("measured_cv", MessageType::Twist),
            ("period_statistics", MessageType::Statistics),
            ("error warning status", MessageType::Text),
        ];
        let offered = topics(&psm(Dialect::Dvrk), "/a", Extras::default());
        for (names, message) in types {
            for name in names.split(' ') {
                let topic = offered.iter().find(|topic| topic.name == format!("/a/{name}")).unwrap();
                assert_eq!(topic.message, message, "{name}");
            }
        }
        assert!(topics(&psm(Dialect::Dvrk), "/a", Extras::default())
            .iter()
            .filter(|topic| matches!(topic.carries, Carries::Out(Output::Warning | Output::Info | Output::Error)))
            .all(|topic| topic.message == MessageType::Text));
    }

    #[test]
    fn a_master_has_a_gripper_that_is_only_measured() {
        let extras = Extras { dvrk: true, gripper: true, ..Extras::default() };
        let all = topics(&psm(Dialect::Dvrk), "/MTMR", extras);
        let named = |part: &str| all.iter().filter(|topic| topic.name.contains(part)).count();
        assert_eq!((named("/gripper/measured_js"), named("/gripper/"), named("/jaw/")), (1, 1, 0));
        assert_eq!((named("/lock_orientation"), named("/unlock_orientation"), named("_locked")), (1, 1, 1));
        assert_eq!(named("tool_"), 0);
    }

    #[test]
    fn names_are_different_and_events_are_latched() {
        for dialect in [Dialect::Contract, Dialect::Dvrk, Dialect::Src, Dialect::Plugin] {
            let all = topics(&psm(dialect), "/PSM1/", Extras { dvrk: true, tool_type: true, gripper: false });
            let mut names: Vec<&str> = all.iter().map(|topic| topic.name.as_str()).collect();
            names.sort_unstable();
            let count = names.len();
            names.dedup();
            assert_eq!(names.len(), count);
            for topic in &all {
                let last = topic.name.rsplit('/').next().unwrap_or_default();
                let events = "operating_state state tool_type tool_type_request goal_reached ratio ratio_v ratio_a orientation_locked";
                assert_eq!(topic.is_latched, events.split(' ').any(|event| event == last), "{}", topic.name);
            }
        }
    }
}
