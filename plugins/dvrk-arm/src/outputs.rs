//! What is sent to an arm, in the topics of its dialect.

use std::sync::Arc;

use nalgebra::Isometry3;
use ros_node::{Announcement, Publication};

use crate::dialect::{Dialect, Names};
use crate::frames::Wrench;
use crate::messages::{self, crtk_msgs, geometry_msgs, sensor_msgs, std_msgs};

type Out<M> = Arc<Publication<M>>;

enum WrenchOut {
    Plain(Out<geometry_msgs::Wrench>),
    Stamped(Out<geometry_msgs::WrenchStamped>),
}

pub(crate) enum PoseOut {
    Plain(Out<geometry_msgs::Pose>),
    Stamped(Out<geometry_msgs::PoseStamped>),
    Transform(Out<geometry_msgs::TransformStamped>),
}

impl PoseOut {
    /// Sends a pose in the arm's frames; `false` when nobody listens.
    pub fn send(&self, pose: &Isometry3<f64>) -> bool {
        match self {
            Self::Plain(out) => send(out, || messages::pose(pose)),
            Self::Stamped(out) => {
                send(out, || geometry_msgs::PoseStamped { pose: messages::pose(pose), ..Default::default() })
            }
            Self::Transform(out) => send(out, || geometry_msgs::TransformStamped {
                transform: messages::transform(pose),
                ..Default::default()
            }),
        }
    }
}

enum StateOut {
    /// Modes, and in later releases of the legacy dialect states.
    Names(Out<std_msgs::String>, Option<Out<std_msgs::String>>),
    Commands(Out<crtk_msgs::StringStamped>),
}

/// Topics of motion commands.
pub(crate) struct Motion {
    /// Followed as they come.
    pub servo_pose: PoseOut,
    servo_joints: Out<sensor_msgs::JointState>,
    /// Reached on a path of the arm's own; dialects of CRTK only.
    goals: Option<(PoseOut, Out<sensor_msgs::JointState>)>,
}

/// Topics that are announced for an arm.
pub(crate) struct Outputs {
    pub dialect: Dialect,
    wrench: WrenchOut,
    /// Latched: an arm that comes late gets it, too.
    orientation_lock: Out<std_msgs::Bool>,
    gravity: Out<std_msgs::Bool>,
    /// Not latched: an arm that comes back must not home because of what was said before.
    state: StateOut,
    motion: Option<Motion>,
    announcements: Vec<Arc<dyn Announcement>>,
}

/// Sends what `message` makes if anybody listens.
fn send<M: rosrust::Message>(out: &Publication<M>, message: impl FnOnce() -> M) -> bool {
    let listened = out.has_subscribers();
    if listened {
        out.send(message());
    }
    listened
}

/// Collects what is announced.
struct Maker<'a> {
    names: &'a Names,
    dialect: Dialect,
    announcements: Vec<Arc<dyn Announcement>>,
}

impl Maker<'_> {
    fn keep<M: rosrust::Message>(&mut self, out: Out<M>) -> Out<M> {
        self.announcements.push(Arc::clone(&out) as Arc<dyn Announcement>);
        out
    }

    fn topic<M: rosrust::Message>(&mut self, name: &str) -> Out<M> {
        let out = Publication::new(self.names.topic(self.dialect, name));
        self.keep(out)
    }

    fn latched<M: rosrust::Message>(&mut self, name: &str) -> Out<M> {
        let out = Publication::latched(self.names.topic(self.dialect, name));
        self.keep(out)
    }

    fn pose(&mut self, name: &str) -> PoseOut {
        match self.dialect {
            Dialect::Legacy => PoseOut::Plain(self.topic(name)),
            Dialect::Ambf | Dialect::CrtkTransform => PoseOut::Transform(self.topic(name)),
            Dialect::CrtkPose => PoseOut::Stamped(self.topic(name)),
        }
    }

    fn motion(&mut self) -> Motion {
        let (pose, joints) = match self.dialect {
            Dialect::Legacy => ("set_position_cartesian", "set_position_joint"),
            _ => ("servo_cp", "servo_jp"),
        };
        let goals = self.dialect.is_crtk().then(|| (self.pose("move_cp"), self.topic("move_jp")));
        Motion { servo_pose: self.pose(pose), servo_joints: self.topic(joints), goals }
    }
}

impl Outputs {
    /// The topics of an arm in `dialect`, those of motion only if wanted.
    pub fn new(names: &Names, dialect: Dialect, motion: bool) -> Self {
        let mut maker = Maker { names, dialect, announcements: Vec::new() };
        let (wrench, orientation_lock, gravity, state) = match dialect {
            Dialect::Legacy => (
                WrenchOut::Plain(maker.topic("set_wrench_body")),
                maker.latched("set_wrench_body_orientation_absolute"),
                maker.latched("set_gravity_compensation"),
                StateOut::Names(maker.topic("set_robot_state"), Some(maker.topic("set_desired_state"))),
            ),
            _ => (
                WrenchOut::Stamped(maker.topic("body/servo_cf")),
                maker.latched("body/set_cf_orientation_absolute"),
                maker.latched("use_gravity_compensation"),
                if dialect.is_crtk() {
                    StateOut::Commands(maker.topic("state_command"))
                } else {
                    StateOut::Names(maker.topic("set_robot_state"), None)
                },
            ),
        };
        let motion = motion.then(|| maker.motion());
        let announcements = maker.announcements;
        Self { dialect, wrench, orientation_lock, gravity, state, motion, announcements }
    }

    /// What the link announces.
    pub fn announcements(&self) -> &[Arc<dyn Announcement>] {
        &self.announcements
    }

    /// Whether somebody wants wrenches.
    pub fn is_felt(&self) -> bool {
        match &self.wrench {
            WrenchOut::Plain(out) => out.has_subscribers(),
            WrenchOut::Stamped(out) => out.has_subscribers(),
        }
    }

    /// Sends a wrench in the arm's frames; `false` when nobody listens.
    pub fn send_wrench(&self, wrench: &Wrench) -> bool {
        match &self.wrench {
            WrenchOut::Plain(out) => send(out, || messages::wrench(wrench)),
            WrenchOut::Stamped(out) => {
                send(out, || geometry_msgs::WrenchStamped { wrench: messages::wrench(wrench), ..Default::default() })
            }
        }
    }

    /// Topics of motion commands, if they were wanted.
    pub fn motion(&self) -> Option<&Motion> {
        self.motion.as_ref()
    }

    /// Says that wrenches are in axes fixed to the base and that the arm shall carry its own weight, to all that will
    /// ever listen. `false` when the topics are not announced yet.
    pub fn settle(&self, orientation_lock: bool, gravity: bool) -> bool {
        let announced = self.orientation_lock.is_announced() && self.gravity.is_announced();
        if announced {
            self.orientation_lock.send(std_msgs::Bool { data: orientation_lock });
            self.gravity.send(std_msgs::Bool { data: gravity });
        }
        announced
    }

    /// Asks for a state: the name of a mode, or a command of CRTK. `false` when nobody listens.
    pub fn ask(&self, what: &str) -> bool {
        match &self.state {
            StateOut::Names(modes, states) => {
                let out = states.as_ref().filter(|_| !what.starts_with("DVRK_")).unwrap_or(modes);
                send(out, || std_msgs::String { data: what.to_owned() })
            }
            StateOut::Commands(out) => {
                send(out, || crtk_msgs::StringStamped { string: what.to_owned(), ..Default::default() })
            }
        }
    }

    /// Whether anybody would hear a mode or command that is [asked](Self::ask) for.
    pub fn is_asked(&self) -> bool {
        match &self.state {
            StateOut::Names(modes, _) => modes.has_subscribers(),
            StateOut::Commands(out) => out.has_subscribers(),
        }
    }
}

impl Motion {
    /// Sends joint positions, rad or m.
    pub fn servo_joints(&self, position: &[f64]) -> bool {
        send(&self.servo_joints, || joint_state(position))
    }

    /// Sends a goal; `None` in dialects without goals.
    pub fn move_pose(&self, pose: &Isometry3<f64>) -> Option<bool> {
        self.goals.as_ref().map(|(out, _)| out.send(pose))
    }

    /// The same for joints.
    pub fn move_joints(&self, position: &[f64]) -> Option<bool> {
        self.goals.as_ref().map(|(_, out)| send(out, || joint_state(position)))
    }
}

fn joint_state(position: &[f64]) -> sensor_msgs::JointState {
    sensor_msgs::JointState { position: position.to_vec(), ..Default::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn topics(dialect: Dialect, motion: bool) -> Vec<String> {
        let names = Names::new(None, "MTMR").unwrap();
        let outputs = Outputs::new(&names, dialect, motion);
        let registrations = outputs.announcements().iter().map(|announcement| announcement.registration());
        registrations.map(|registration| format!("{} {}", registration.topic, registration.message_type)).collect()
    }

    #[test]
    fn topics_are_those_of_the_dialect() {
        assert_eq!(
            topics(Dialect::Legacy, true),
            [
                "/dvrk/MTMR/set_wrench_body geometry_msgs/Wrench",
                "/dvrk/MTMR/set_wrench_body_orientation_absolute std_msgs/Bool",
                "/dvrk/MTMR/set_gravity_compensation std_msgs/Bool",
                "/dvrk/MTMR/set_robot_state std_msgs/String",
                "/dvrk/MTMR/set_desired_state std_msgs/String",
                "/dvrk/MTMR/set_position_cartesian geometry_msgs/Pose",
                "/dvrk/MTMR/set_position_joint sensor_msgs/JointState",
            ]
        );
        assert_eq!(
            topics(Dialect::Ambf, false),
            [
                "/MTMR/body/servo_cf geometry_msgs/WrenchStamped",
                "/MTMR/body/set_cf_orientation_absolute std_msgs/Bool",
                "/MTMR/use_gravity_compensation std_msgs/Bool",
                "/MTMR/set_robot_state std_msgs/String",
            ]
        );
        let servo = |dialect| topics(dialect, true).into_iter().filter(|t| t.contains("_cp")).collect::<Vec<_>>();
        assert_eq!(servo(Dialect::Ambf), ["/MTMR/servo_cp geometry_msgs/TransformStamped"]);
        let both = |kind: &str| vec![format!("/MTMR/move_cp {kind}"), format!("/MTMR/servo_cp {kind}")];
        assert_eq!(servo(Dialect::CrtkTransform), both("geometry_msgs/TransformStamped"));
        assert_eq!(servo(Dialect::CrtkPose), both("geometry_msgs/PoseStamped"));
        assert!(topics(Dialect::CrtkPose, false).contains(&"/MTMR/state_command crtk_msgs/StringStamped".to_owned()));
    }
}
