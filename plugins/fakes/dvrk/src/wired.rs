//! The topics of a fake arm in one dialect.

use std::sync::{Arc, Weak};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use dvrk_arm::messages::{self, crtk_msgs, geometry_msgs, sensor_msgs, std_msgs};
use dvrk_arm::{pedal_topics, ClutchSource, Dialect, Names, Pedal, Topics, Wrench};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use ros_node::{Announcement, Publication, RawReceived, RawSubscription};
use rosrust::Message;

use crate::machine::Machine;
use crate::{Told, World};

type Out<M> = Arc<Publication<M>>;

enum PoseOut {
    Stamped(Out<geometry_msgs::PoseStamped>),
    Transform(Out<geometry_msgs::TransformStamped>),
}

enum StateOut {
    Name(Out<std_msgs::String>),
    Old(Out<crtk_msgs::operating_state>),
    New(Out<crtk_msgs::OperatingState>),
}

/// What one arm publishes.
pub(crate) struct WiredArm {
    pose: PoseOut,
    twist: Out<geometry_msgs::TwistStamped>,
    joints: Out<sensor_msgs::JointState>,
    gripper: Out<sensor_msgs::JointState>,
    wrench: Out<geometry_msgs::WrenchStamped>,
    jacobian: Out<std_msgs::Float64MultiArray>,
    closed: Out<std_msgs::Bool>,
    state: StateOut,
    /// Only that it is there matters.
    status: Option<Out<std_msgs::Empty>>,
    said_closed: Option<bool>,
    said_state: Option<(Machine, bool)>,
    last: Option<(Instant, Isometry3<f64>)>,
}

/// All topics of a node.
pub(crate) struct Wired {
    dialect: Dialect,
    pub arms: Vec<WiredArm>,
    pedals: Vec<(Pedal, Out<sensor_msgs::Joy>)>,
    pub announcements: Vec<Arc<dyn Announcement>>,
}

/// Collects what is announced.
struct Maker {
    world: Weak<World>,
    arm: usize,
    announcements: Vec<Arc<dyn Announcement>>,
}

impl Maker {
    fn out<M: Message>(&mut self, topic: String) -> Out<M> {
        let out = Publication::new(topic);
        self.announcements.push(Arc::clone(&out) as Arc<dyn Announcement>);
        out
    }

    fn latched<M: Message>(&mut self, topic: String) -> Out<M> {
        let out = Publication::latched(topic);
        self.announcements.push(Arc::clone(&out) as Arc<dyn Announcement>);
        out
    }

    fn hear<M: Message>(&mut self, topic: String, read: impl Fn(M) -> Told + Send + Sync + 'static) {
        let (world, arm) = (Weak::clone(&self.world), self.arm);
        let heard = move |RawReceived { kind, body }: RawReceived<'_>| {
            // As a real node, which does not even connect to messages of another type.
            let message = (kind == M::msg_type()).then(|| M::decode(body).ok()).flatten();
            if let (Some(world), Some(message)) = (world.upgrade(), message) {
                world.hear(arm, read(message));
            }
        };
        self.announcements.push(RawSubscription::new(topic, heard));
    }
}

fn from_wrench(wrench: &geometry_msgs::Wrench) -> Told {
    let vector = |v: &geometry_msgs::Vector3| Vector3::new(v.x, v.y, v.z);
    Told::Wrench(Wrench { force: vector(&wrench.force), torque: vector(&wrench.torque) })
}

fn from_parts(p: [f64; 3], q: &geometry_msgs::Quaternion) -> Told {
    let q = nalgebra::Quaternion::new(q.w, q.x, q.y, q.z);
    Told::Pose(Isometry3::from_parts(Vector3::from(p).into(), UnitQuaternion::new_normalize(q)))
}

impl Wired {
    pub fn new(world: &Arc<World>, dialect: Dialect) -> Self {
        let root = world.names[0].root(dialect).to_owned();
        let mut maker = Maker { world: Arc::downgrade(world), arm: 0, announcements: Vec::new() };
        let mut arms = Vec::new();
        for (arm, names) in world.names.iter().enumerate() {
            maker.arm = arm;
            arms.push(wire(&mut maker, names, dialect));
        }
        let none = Topics::new();
        let topics = pedal_topics(dialect, &root, ClutchSource::Pedal, &none);
        let pedals = topics.into_iter().map(|(topic, pedal)| (pedal, maker.latched(topic))).collect();
        Self { dialect, arms, pedals, announcements: maker.announcements }
    }

    /// Sends a message of a pedal.
    pub fn pedal(&self, pedal: Pedal, value: i32) {
        for (_, out) in self.pedals.iter().filter(|(other, _)| *other == pedal) {
            out.send(sensor_msgs::Joy { buttons: vec![value], ..Default::default() });
        }
    }

    /// Whether the last topic is announced.
    pub fn is_announced(&self) -> bool {
        self.pedals.last().is_none_or(|(_, out)| out.is_announced())
    }
}

fn wire(maker: &mut Maker, names: &Names, dialect: Dialect) -> WiredArm {
    let topic = |name: &str| names.topic(dialect, name);
    let legacy = dialect == Dialect::Legacy;
    let pick = |old: &str, new: &str| topic(if legacy { old } else { new });
    if legacy {
        maker.hear(topic("set_wrench_body"), |message: geometry_msgs::Wrench| from_wrench(&message));
        maker.hear(topic("set_position_cartesian"), |message: geometry_msgs::Pose| {
            let p = message.position;
            from_parts([p.x, p.y, p.z], &message.orientation)
        });
    } else {
        maker.hear(topic("body/servo_cf"), |message: geometry_msgs::WrenchStamped| from_wrench(&message.wrench));
        for name in ["servo_cp", "move_cp"] {
            if dialect == Dialect::CrtkPose {
                maker.hear(topic(name), |message: geometry_msgs::PoseStamped| {
                    let p = message.pose.position;
                    from_parts([p.x, p.y, p.z], &message.pose.orientation)
                });
            } else {
                maker.hear(topic(name), |message: geometry_msgs::TransformStamped| {
                    let p = message.transform.translation;
                    from_parts([p.x, p.y, p.z], &message.transform.rotation)
                });
            }
        }
    }
    let lock = pick("set_wrench_body_orientation_absolute", "body/set_cf_orientation_absolute");
    maker.hear(lock, |message: std_msgs::Bool| Told::OrientationLock(message.data));
    let gravity = pick("set_gravity_compensation", "use_gravity_compensation");
    maker.hear(gravity, |message: std_msgs::Bool| Told::Gravity(message.data));
    let joints = pick("set_position_joint", "servo_jp");
    maker.hear(joints, |message: sensor_msgs::JointState| Told::Joints(message.position));
    if dialect.is_crtk() {
        maker.hear(topic("state_command"), |message: crtk_msgs::StringStamped| Told::Command(message.string));
    } else {
        maker.hear(topic("set_robot_state"), |message: std_msgs::String| Told::Command(message.data));
    }
    let state = match dialect {
        Dialect::CrtkPose => StateOut::New(maker.latched(topic("operating_state"))),
        Dialect::CrtkTransform => StateOut::Old(maker.latched(topic("operating_state"))),
        _ => StateOut::Name(maker.latched(topic("robot_state"))),
    };
    let pose = match dialect {
        Dialect::Legacy => PoseOut::Stamped(maker.out(topic("position_cartesian_current"))),
        Dialect::CrtkPose => PoseOut::Stamped(maker.out(topic("measured_cp"))),
        _ => PoseOut::Transform(maker.out(topic("measured_cp"))),
    };
    WiredArm {
        pose,
        twist: maker.out(pick("twist_body_current", "measured_cv")),
        joints: maker.out(pick("state_joint_current", "measured_js")),
        gripper: maker.out(pick("state_gripper_current", "gripper/measured_js")),
        wrench: maker.out(pick("wrench_body_current", "body/measured_cf")),
        jacobian: maker.out(pick("jacobian_body", "body/jacobian")),
        closed: maker.latched(pick("gripper_closed_event", "gripper/closed")),
        state,
        status: (dialect == Dialect::Ambf).then(|| maker.out(topic("status"))),
        said_closed: None,
        said_state: None,
        last: None,
    }
}

/// What an arm is at one moment, in its own frames.
pub(crate) struct Moment<'a> {
    pub now: Instant,
    pub pose: Isometry3<f64>,
    /// 0 … 1.
    pub gripper: f64,
    pub joints: &'a [f64],
    /// 6 × n in columns.
    pub jacobian: &'a [f64],
    pub wrench: Wrench,
    pub machine: &'a Machine,
    pub zero_stamps: bool,
}

impl WiredArm {
    /// Publishes everything once, headers as they are: a fake must be able to send samples that are not valid.
    pub fn publish(&mut self, dialect: Dialect, moment: &Moment<'_>) {
        let header = || std_msgs::Header { stamp: stamp(moment.zero_stamps), ..Default::default() };
        match &self.pose {
            PoseOut::Stamped(out) => {
                let pose = messages::pose(&moment.pose);
                out.send_as_is(&geometry_msgs::PoseStamped { header: header(), pose });
            }
            PoseOut::Transform(out) => out.send_as_is(&geometry_msgs::TransformStamped {
                header: header(),
                transform: messages::transform(&moment.pose),
                ..Default::default()
            }),
        }
        let (v, w) = self.velocity(moment);
        let twist = geometry_msgs::Twist { linear: messages::vector(&v), angular: messages::vector(&w) };
        self.twist.send_as_is(&geometry_msgs::TwistStamped { header: header(), twist });
        let joints =
            sensor_msgs::JointState { header: header(), position: moment.joints.to_vec(), ..Default::default() };
        self.joints.send_as_is(&joints);
        self.jacobian.send(std_msgs::Float64MultiArray { data: moment.jacobian.to_vec(), ..Default::default() });
        let most = f64::to_radians(60.0);
        let closed = if dialect.is_crtk() { 0.0 } else { -most };
        let angle = closed + moment.gripper * (most - closed);
        let gripper = sensor_msgs::JointState { header: header(), position: vec![angle], ..Default::default() };
        self.gripper.send_as_is(&gripper);
        let wrench = messages::wrench(&moment.wrench);
        self.wrench.send_as_is(&geometry_msgs::WrenchStamped { header: header(), wrench });
        if let Some(status) = &self.status {
            status.send(std_msgs::Empty {});
        }
        self.say(moment);
    }

    /// Latched messages, when there is news.
    fn say(&mut self, moment: &Moment<'_>) {
        let closed = moment.gripper <= 0.0;
        if self.said_closed != Some(closed) && self.closed.is_announced() {
            self.closed.send(std_msgs::Bool { data: closed });
            self.said_closed = Some(closed);
        }
        let machine = moment.machine;
        let news = Some((machine.clone(), machine.is_busy()));
        let announced = match &self.state {
            StateOut::Name(out) => out.is_announced(),
            StateOut::Old(out) => out.is_announced(),
            StateOut::New(out) => out.is_announced(),
        };
        if self.said_state == news || !announced {
            return;
        }
        let (state, is_homed, is_busy) = (machine.state.to_owned(), machine.homed, machine.is_busy());
        match &self.state {
            StateOut::Name(out) => {
                let name = if machine.state == "ENABLED" { "DVRK_EFFORT_CARTESIAN" } else { "DVRK_UNINITIALIZED" };
                out.send(std_msgs::String { data: name.into() });
            }
            StateOut::Old(out) => {
                let header = std_msgs::Header::default();
                out.send(crtk_msgs::operating_state { header, state, is_homed, is_busy });
            }
            StateOut::New(out) => {
                let header = std_msgs::Header::default();
                out.send(crtk_msgs::OperatingState { header, state, is_homed, is_busy });
            }
        }
        self.said_state = news;
    }

    /// Linear and angular velocity since the last time, in the arm's base.
    fn velocity(&mut self, moment: &Moment<'_>) -> (Vector3<f64>, Vector3<f64>) {
        let last = self.last.replace((moment.now, moment.pose));
        let Some((at, pose)) = last else { return Default::default() };
        let dt = moment.now.saturating_duration_since(at).as_secs_f64();
        if dt <= 0.0 {
            return Default::default();
        }
        let linear = (moment.pose.translation.vector - pose.translation.vector) / dt;
        (linear, (moment.pose.rotation * pose.rotation.inverse()).scaled_axis() / dt)
    }
}

impl Wired {
    /// Publishes one arm.
    pub fn publish(&mut self, arm: usize, moment: &Moment<'_>) {
        let dialect = self.dialect;
        self.arms[arm].publish(dialect, moment);
    }
}

fn stamp(zero: bool) -> rosrust::Time {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    if zero {
        rosrust::Time { sec: 0, nsec: 0 }
    } else {
        rosrust::Time { sec: since.as_secs() as u32, nsec: since.subsec_nanos() }
    }
}
