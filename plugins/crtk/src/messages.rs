//! Messages as plain structs, what they are in ROS, and reading them from bytes.
//!
//! ROS types are generated at build time from the definitions on `ROSRUST_MSG_PATH` (see `.cargo/config.toml`). What
//! comes from clients is read here, not by rosrust, which reserves memory for as many elements as an array announces.

use nalgebra::{Isometry3, Vector3, Vector6};
use rosrust::{Message as RosMessage, RosMsg};

use crate::arm::{JointMessage, PoseMessage};
use crate::kinematics::Coordinates;
use crate::statistics::Statistics;

#[allow(missing_docs, clippy::all, clippy::pedantic)]
mod generated {
    rosrust::rosmsg_include!(
        cisst_msgs / IntervalStatistics,
        crtk_msgs / OperatingState,
        crtk_msgs / QueryForwardKinematics,
        crtk_msgs / QueryInverseKinematics,
        crtk_msgs / StringStamped,
        crtk_msgs / TriggerOperatingState,
        geometry_msgs / PoseStamped,
        geometry_msgs / Quaternion,
        geometry_msgs / TwistStamped,
        geometry_msgs / WrenchStamped,
        rosgraph_msgs / Clock,
        sensor_msgs / ChannelFloat32,
        sensor_msgs / JointState,
        std_msgs / Bool,
        std_msgs / Empty,
        std_msgs / Float64,
        std_msgs / Float64MultiArray,
        std_msgs / String,
        std_msgs / UInt32
    );
}

pub use generated::{cisst_msgs, crtk_msgs, geometry_msgs, rosgraph_msgs, sensor_msgs, std_msgs};

/// Type of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MessageType {
    /// `sensor_msgs/JointState`.
    Joints,
    /// `geometry_msgs/PoseStamped`.
    Pose,
    /// `geometry_msgs/TwistStamped`.
    Twist,
    /// `geometry_msgs/WrenchStamped`.
    Wrench,
    /// `std_msgs/Float64MultiArray`.
    Matrix,
    /// `crtk_msgs/OperatingState`.
    OperatingState,
    /// `crtk_msgs/StringStamped`.
    StampedText,
    /// `std_msgs/String`.
    Text,
    /// `std_msgs/Bool`.
    Bool,
    /// `std_msgs/Empty`.
    Empty,
    /// `std_msgs/Float64`.
    Number,
    /// `geometry_msgs/Quaternion`.
    Quaternion,
    /// `sensor_msgs/ChannelFloat32`.
    Channel,
    /// `std_msgs/UInt32`.
    Count,
    /// `rosgraph_msgs/Clock`.
    Clock,
    /// `cisst_msgs/IntervalStatistics`.
    Statistics,
}

impl MessageType {
    /// Name of the ROS 1 type, `package/Type`, and its definition with those of the types in it.
    pub fn definition(self) -> (String, String) {
        fn of<M: RosMessage>() -> (String, String) {
            (M::msg_type(), M::msg_definition())
        }
        match self {
            Self::Joints => of::<sensor_msgs::JointState>(),
            Self::Pose => of::<geometry_msgs::PoseStamped>(),
            Self::Twist => of::<geometry_msgs::TwistStamped>(),
            Self::Wrench => of::<geometry_msgs::WrenchStamped>(),
            Self::Matrix => of::<std_msgs::Float64MultiArray>(),
            Self::OperatingState => of::<crtk_msgs::OperatingState>(),
            Self::StampedText => of::<crtk_msgs::StringStamped>(),
            Self::Text => of::<std_msgs::String>(),
            Self::Bool => of::<std_msgs::Bool>(),
            Self::Empty => of::<std_msgs::Empty>(),
            Self::Number => of::<std_msgs::Float64>(),
            Self::Quaternion => of::<geometry_msgs::Quaternion>(),
            Self::Channel => of::<sensor_msgs::ChannelFloat32>(),
            Self::Count => of::<std_msgs::UInt32>(),
            Self::Clock => of::<rosgraph_msgs::Clock>(),
            Self::Statistics => of::<cisst_msgs::IntervalStatistics>(),
        }
    }
}

/// When and in which frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Header {
    /// ns; 0: the data are not valid now.
    pub stamp: u64,
    /// Frame.
    pub frame: String,
}

/// A message that is sent.
#[derive(Debug, Clone, PartialEq)]
pub enum Message {
    /// Joints; vectors are empty where nothing is known.
    Joints(Header, JointMessage),
    /// A pose.
    Pose(Header, Isometry3<f64>),
    /// Linear, then angular velocity.
    Twist(Header, Vector6<f64>),
    /// Force, then torque.
    Wrench(Header, Vector6<f64>),
    /// A Jacobian (6 x columns), row by row, as CRTK has it although its strides say otherwise.
    Jacobian {
        /// Number of columns.
        columns: usize,
        /// Elements row by row.
        data: Vec<f64>,
    },
    /// An operating state.
    OperatingState {
        /// When.
        header: Header,
        /// `ENABLED` and so on.
        state: String,
        /// Homed.
        is_homed: bool,
        /// Busy.
        is_busy: bool,
    },
    /// A text with a time.
    StampedText(Header, String),
    /// A text.
    Text(String),
    /// A number.
    Number(f64),
    /// Yes or no.
    Bool(bool),
    /// That something happened.
    Empty,
    /// Simulated time, ns.
    Clock(u64),
    /// Periods and computing times.
    Statistics(Header, Statistics),
}

fn time(stamp: u64) -> rosrust::Time {
    let seconds = u32::try_from(stamp / 1_000_000_000).unwrap_or(u32::MAX);
    rosrust::Time { sec: seconds, nsec: (stamp % 1_000_000_000) as u32 }
}

pub(crate) fn header(from: &Header) -> std_msgs::Header {
    std_msgs::Header { seq: 0, stamp: time(from.stamp), frame_id: from.frame.clone() }
}

fn vector(v: &Vector3<f64>) -> geometry_msgs::Vector3 {
    geometry_msgs::Vector3 { x: v.x, y: v.y, z: v.z }
}

fn halves(six: &Vector6<f64>) -> [geometry_msgs::Vector3; 2] {
    [0, 3].map(|row| vector(&six.fixed_rows::<3>(row).into_owned()))
}

pub(crate) fn pose(pose: &Isometry3<f64>) -> geometry_msgs::Pose {
    let (p, q) = (pose.translation.vector, pose.rotation.coords);
    geometry_msgs::Pose {
        position: geometry_msgs::Point { x: p.x, y: p.y, z: p.z },
        orientation: geometry_msgs::Quaternion { x: q.x, y: q.y, z: q.z, w: q.w },
    }
}

fn jacobian(columns: usize, data: &[f64]) -> std_msgs::Float64MultiArray {
    let count = u32::try_from(columns).unwrap_or(u32::MAX);
    let dimension = |label: &str, size, stride| std_msgs::MultiArrayDimension { label: label.into(), size, stride };
    let dim = vec![dimension("rows", 6, 1), dimension("cols", count, 6)];
    std_msgs::Float64MultiArray { layout: std_msgs::MultiArrayLayout { dim, data_offset: 0 }, data: data.to_vec() }
}

fn interval_statistics(head: &Header, of: &Statistics) -> cisst_msgs::IntervalStatistics {
    let count = |count: u64| i64::try_from(count).unwrap_or(i64::MAX);
    cisst_msgs::IntervalStatistics {
        header: header(head),
        period_avg: of.period.mean,
        period_std_dev: of.period.deviation,
        period_min: of.period.least,
        period_max: of.period.most,
        compute_time_avg: of.compute.mean,
        compute_time_std_dev: of.compute.deviation,
        compute_time_min: of.compute.least,
        compute_time_max: of.compute.most,
        number_of_samples: count(of.samples),
        number_of_overruns: count(of.overruns),
        statistics_interval: of.interval,
        user_data: 0,
    }
}

/// What is done with a message of a type that is known at compile time.
pub trait WithRos {
    /// What comes of it.
    type Output;

    /// Does it.
    fn with<M: RosMessage>(self, message: M) -> Self::Output;
}

impl Message {
    /// Lets `work` have the message as rosrust has it.
    pub fn with_ros<W: WithRos>(&self, work: W) -> W::Output {
        match self {
            Self::Joints(head, joints) => {
                let JointMessage { names, position, velocity, effort } = joints.clone();
                work.with(sensor_msgs::JointState { header: header(head), name: names, position, velocity, effort })
            }
            Self::Pose(head, at) => work.with(geometry_msgs::PoseStamped { header: header(head), pose: pose(at) }),
            Self::Twist(head, twist) => {
                let [linear, angular] = halves(twist);
                let twist = geometry_msgs::Twist { linear, angular };
                work.with(geometry_msgs::TwistStamped { header: header(head), twist })
            }
            Self::Wrench(head, wrench) => {
                let [force, torque] = halves(wrench);
                let wrench = geometry_msgs::Wrench { force, torque };
                work.with(geometry_msgs::WrenchStamped { header: header(head), wrench })
            }
            Self::Jacobian { columns, data } => work.with(jacobian(*columns, data)),
            Self::OperatingState { header: head, state, is_homed, is_busy } => {
                let (state, is_homed, is_busy) = (state.clone(), *is_homed, *is_busy);
                work.with(crtk_msgs::OperatingState { header: header(head), state, is_homed, is_busy })
            }
            Self::StampedText(head, text) => {
                work.with(crtk_msgs::StringStamped { header: header(head), string: text.clone() })
            }
            Self::Number(number) => work.with(std_msgs::Float64 { data: *number }),
            Self::Bool(truth) => work.with(std_msgs::Bool { data: *truth }),
            Self::Empty => work.with(std_msgs::Empty {}),
            Self::Text(text) => work.with(std_msgs::String { data: text.clone() }),
            Self::Clock(now) => work.with(rosgraph_msgs::Clock { clock: time(*now) }),
            Self::Statistics(head, of) => work.with(interval_statistics(head, of)),
        }
    }

    /// The message in the encoding of ROS 1, without its length.
    pub fn encode(&self) -> Vec<u8> {
        struct Encode;
        impl WithRos for Encode {
            type Output = Vec<u8>;

            fn with<M: RosMessage>(self, message: M) -> Vec<u8> {
                let mut bytes = Vec::new();
                // Writing to memory cannot fail.
                let _ = RosMsg::encode(&message, &mut bytes);
                bytes
            }
        }
        self.with_ros(Encode)
    }
}

/// Most elements of an array that is read: arms have eight joints.
const MAX_ELEMENTS: usize = 256;

/// Longest text that is read, bytes.
const MAX_TEXT: usize = 4096;

/// Bytes not read yet.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn count(&mut self, most: usize) -> Option<usize> {
        let count = u32::from_le_bytes(self.take(4)?.try_into().ok()?);
        usize::try_from(count).ok().filter(|&count| count <= most)
    }

    fn number(&mut self) -> Option<f64> {
        Some(f64::from_le_bytes(self.take(8)?.try_into().ok()?))
    }

    fn numbers<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.number()?;
        }
        Some(numbers)
    }

    fn text(&mut self) -> Option<String> {
        let count = self.count(MAX_TEXT)?;
        Some(String::from_utf8_lossy(self.take(count)?).into_owned())
    }

    fn list<T>(&mut self, mut read: impl FnMut(&mut Self) -> Option<T>) -> Option<Vec<T>> {
        let count = self.count(MAX_ELEMENTS)?;
        (0..count).map(|_| read(self)).collect()
    }

    /// Frame of a header.
    fn header(&mut self) -> Option<String> {
        self.take(12)?;
        self.text()
    }
}

/// Reads all of `bytes`; `None` if they are no such message.
fn whole<T>(bytes: &[u8], read: impl FnOnce(&mut Bytes<'_>) -> Option<T>) -> Option<T> {
    let mut bytes = Bytes(bytes);
    let value = read(&mut bytes)?;
    bytes.0.is_empty().then_some(value)
}

/// Reads a `sensor_msgs/JointState`.
pub fn read_joints(bytes: &[u8]) -> Option<JointMessage> {
    whole(bytes, |b| {
        b.header()?;
        let names = b.list(Bytes::text)?;
        let [position, velocity, effort] = [b.list(Bytes::number)?, b.list(Bytes::number)?, b.list(Bytes::number)?];
        Some(JointMessage { names, position, velocity, effort })
    })
}

/// Reads a `geometry_msgs/PoseStamped`.
pub fn read_pose(bytes: &[u8]) -> Option<PoseMessage> {
    whole(bytes, |b| Some(PoseMessage { frame: b.header()?, position: b.numbers()?, orientation: b.numbers()? }))
}

/// Reads a `geometry_msgs/TwistStamped` or `WrenchStamped`.
pub fn read_six(bytes: &[u8]) -> Option<([f64; 3], [f64; 3])> {
    whole(bytes, |b| {
        b.header()?;
        Some((b.numbers()?, b.numbers()?))
    })
}

/// Reads a `crtk_msgs/StringStamped`.
pub fn read_stamped_text(bytes: &[u8]) -> Option<String> {
    whole(bytes, |b| {
        b.header()?;
        b.text()
    })
}

/// Reads a `std_msgs/Bool`.
pub fn read_bool(bytes: &[u8]) -> Option<bool> {
    whole(bytes, |b| b.take(1).map(|byte| byte[0] != 0))
}

/// Reads a `std_msgs/Float64`.
pub fn read_number(bytes: &[u8]) -> Option<f64> {
    whole(bytes, |b| b.number())
}

/// Reads a `sensor_msgs/ChannelFloat32`: its values.
pub fn read_channel(bytes: &[u8]) -> Option<Vec<f64>> {
    whole(bytes, |b| {
        b.text()?;
        b.list(|b| Some(f64::from(f32::from_le_bytes(b.take(4)?.try_into().ok()?))))
    })
}

/// Reads a `std_msgs/UInt32`.
pub fn read_count(bytes: &[u8]) -> Option<u32> {
    whole(bytes, |b| Some(u32::from_le_bytes(b.take(4)?.try_into().ok()?)))
}

/// Reads a `std_msgs/String`.
pub fn read_text(bytes: &[u8]) -> Option<String> {
    whole(bytes, |b| b.text())
}

/// Reads a `geometry_msgs/Quaternion`: x y z w.
pub fn read_quaternion(bytes: &[u8]) -> Option<[f64; 4]> {
    whole(bytes, |b| b.numbers())
}

/// Reads the request of a `crtk_msgs/QueryForwardKinematics`: joint positions. Its pose is not used.
pub fn read_forward(bytes: &[u8]) -> Option<Vec<f64>> {
    whole(bytes, |b| {
        let positions = b.list(Bytes::number)?;
        b.numbers::<7>()?;
        Some(positions)
    })
}

/// Reads the request of a `crtk_msgs/QueryInverseKinematics`: a pose, without the name of a frame, and joint positions
/// near which the solution is to be.
pub fn read_inverse(bytes: &[u8]) -> Option<(PoseMessage, Vec<f64>)> {
    whole(bytes, |b| {
        let pose = PoseMessage { frame: String::new(), position: b.numbers()?, orientation: b.numbers()? };
        Some((pose, b.list(Bytes::number)?))
    })
}

/// Joint values of an arm of `count` joints.
pub fn joint_list(values: &Coordinates, count: usize) -> Vec<f64> {
    values.as_slice()[..count].to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head() -> Header {
        Header { stamp: 3_000_000_007, frame: "ECM_view".into() }
    }

    #[test]
    fn what_is_sent_is_what_is_read() {
        let joints = JointMessage {
            names: vec!["yaw".into(), "pitch".into()],
            position: vec![0.1, 0.2],
            velocity: vec![],
            effort: vec![0.3],
        };
        let bytes = Message::Joints(head(), joints.clone()).encode();
        assert_eq!(read_joints(&bytes), Some(joints));
        let pose = Isometry3::translation(1.0, 2.0, 3.0);
        let bytes = Message::Pose(head(), pose).encode();
        let expected =
            PoseMessage { frame: "ECM_view".into(), position: [1.0, 2.0, 3.0], orientation: [0.0, 0.0, 0.0, 1.0] };
        assert_eq!(read_pose(&bytes), Some(expected));
        let six = Vector6::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0);
        for message in [Message::Twist(head(), six), Message::Wrench(head(), six)] {
            assert_eq!(read_six(&message.encode()), Some(([1.0, 2.0, 3.0], [4.0, 5.0, 6.0])));
        }
        assert_eq!(read_stamped_text(&Message::StampedText(head(), "home".into()).encode()), Some("home".into()));
    }

    #[test]
    fn bytes_that_are_no_message_are_refused() {
        let joints = JointMessage { position: vec![0.1; 6], ..JointMessage::default() };
        let good = Message::Joints(head(), joints).encode();
        for end in 0..good.len() {
            assert_eq!(read_joints(&good[..end]), None);
        }
        let mut longer = good.clone();
        longer.push(0);
        assert_eq!(read_joints(&longer), None);
        let mut lying = good.clone();
        // The number of names.
        let at = 12 + 4 + "ECM_view".len();
        lying[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
        assert_eq!(read_joints(&lying), None);
        for start in 0..good.len() {
            let mut changed = good.clone();
            changed[start] ^= 0xff;
            let _ = (read_joints(&changed), read_pose(&changed), read_six(&changed), read_stamped_text(&changed));
        }
    }

    #[test]
    fn channels_and_counts_are_read() {
        let channel = sensor_msgs::ChannelFloat32 { name: "errors".into(), values: vec![0.5, -0.25, 0.0] };
        let mut bytes = Vec::new();
        RosMsg::encode(&channel, &mut bytes).unwrap();
        assert_eq!(read_channel(&bytes), Some(vec![0.5, -0.25, 0.0]));
        (0..bytes.len()).for_each(|end| assert_eq!(read_channel(&bytes[..end]), None));
        assert_eq!(read_count(&70_000_u32.to_le_bytes()), Some(70_000));
        assert_eq!(read_count(&[1, 2, 3]), None);
    }

    #[test]
    fn types_are_those_of_the_robot() {
        let sum = |md5: String| md5;
        assert_eq!(sum(geometry_msgs::PoseStamped::md5sum()), "d3812c3cbc69362b77dc0b19b345f8f5");
        assert_eq!(sum(crtk_msgs::OperatingState::md5sum()), "b1bd4021639d9d9c5fbfff78d6ff3158");
        assert_eq!(sum(crtk_msgs::StringStamped::md5sum()), "5e3e46086181199270f1ac3a28a5977f");
        let (name, text) = MessageType::Joints.definition();
        assert_eq!(name, "sensor_msgs/JointState");
        assert!(text.contains("float64[] position") && text.contains("std_msgs/Header"));
    }

    #[test]
    fn jacobians_are_written_row_by_row() {
        struct Take;
        impl WithRos for Take {
            type Output = Vec<u8>;
            fn with<M: RosMessage>(self, message: M) -> Vec<u8> {
                assert_eq!(M::msg_type(), "std_msgs/Float64MultiArray");
                message.encode_vec().unwrap()
            }
        }
        let data: Vec<f64> = (0..12).map(f64::from).collect();
        let bytes = Message::Jacobian { columns: 2, data }.with_ros(Take);
        let numbers: Vec<f64> =
            bytes[bytes.len() - 96..].chunks(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect();
        assert_eq!(numbers[..3], [0.0, 1.0, 2.0]);
    }
}
