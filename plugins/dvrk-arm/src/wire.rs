//! Messages from arms, read from their bytes. Types are known from the connection, not beforehand: the same topic has
//! another type in another release of the robot's software. Nothing is taken for granted about the bytes.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::frames::{is_finite, Wrench};
use crate::inner::Mode;

/// Most numbers in an array that is read: arms have seven joints.
const MAX_NUMBERS: usize = 1 << 10;

/// Bytes not read yet.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn byte(&mut self) -> Option<u8> {
        Some(self.take(1)?[0])
    }

    fn count(&mut self) -> Option<usize> {
        usize::try_from(u32::from_le_bytes(self.take(4)?.try_into().ok()?)).ok()
    }

    fn number(&mut self) -> Option<f64> {
        Some(f64::from_le_bytes(self.take(8)?.try_into().ok()?))
    }

    fn text(&mut self) -> Option<&'a [u8]> {
        let count = self.count()?;
        self.take(count)
    }

    fn numbers(&mut self) -> Option<Vec<f64>> {
        let count = self.count().filter(|&count| count <= MAX_NUMBERS)?;
        (0..count).map(|_| self.number()).collect()
    }

    /// Whether the stamp is a time at all: invalid samples have none.
    fn header(&mut self) -> Option<bool> {
        self.take(4)?;
        let stamp = self.take(8)?;
        self.text()?;
        Some(stamp.iter().any(|&byte| byte != 0))
    }

    fn vector(&mut self) -> Option<Vector3<f64>> {
        Some(Vector3::new(self.number()?, self.number()?, self.number()?))
    }

    /// Position and orientation; a quaternion that is none is an error.
    fn pose(&mut self) -> Option<Isometry3<f64>> {
        let position = self.vector()?;
        let [x, y, z, w] = [self.number()?, self.number()?, self.number()?, self.number()?];
        let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-6)?;
        Some(Isometry3::from_parts(Translation3::from(position), rotation))
    }

    /// All has been read.
    fn end(self) -> Option<()> {
        self.0.is_empty().then_some(())
    }
}

/// A message and whether it has a time stamp; `None` for types without one.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Stamped<T> {
    pub stamped: Option<bool>,
    pub value: T,
}

/// Reads `bytes` with `read` and wants all of them used.
fn whole<T>(bytes: &[u8], read: impl FnOnce(&mut Bytes<'_>) -> Option<T>) -> Option<T> {
    let mut bytes = Bytes(bytes);
    let value = read(&mut bytes)?;
    bytes.end()?;
    Some(value)
}

fn stamped<T>(bytes: &[u8], read: impl FnOnce(&mut Bytes<'_>) -> Option<T>) -> Option<Stamped<T>> {
    whole(bytes, |b| Some(Stamped { stamped: Some(b.header()?), value: read(b)? }))
}

/// Types of [`pose`].
pub(crate) const POSE_TYPES: &[&str] =
    &["geometry_msgs/PoseStamped", "geometry_msgs/TransformStamped", "geometry_msgs/Pose"];

/// A pose; not one with numbers that are not finite.
pub(crate) fn pose(kind: &str, bytes: &[u8]) -> Option<Stamped<Isometry3<f64>>> {
    let pose = match kind {
        "geometry_msgs/PoseStamped" => stamped(bytes, |b| b.pose()),
        "geometry_msgs/TransformStamped" => stamped(bytes, |b| {
            b.text()?;
            b.pose()
        }),
        "geometry_msgs/Pose" => whole(bytes, |b| Some(Stamped { stamped: None, value: b.pose()? })),
        _ => None,
    };
    pose.filter(|pose| is_finite(&pose.value))
}

/// Positions, velocities and efforts.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Joints {
    pub position: Vec<f64>,
    pub velocity: Vec<f64>,
    pub effort: Vec<f64>,
}

/// Types of [`joints`].
pub(crate) const JOINT_TYPES: &[&str] = &["sensor_msgs/JointState", "std_msgs/Float32"];

/// Joints; a lone number is one position.
pub(crate) fn joints(kind: &str, bytes: &[u8]) -> Option<Stamped<Joints>> {
    match kind {
        "sensor_msgs/JointState" => stamped(bytes, |b| {
            for _ in 0..b.count()? {
                b.text()?;
            }
            Some(Joints { position: b.numbers()?, velocity: b.numbers()?, effort: b.numbers()? })
        }),
        "std_msgs/Float32" => whole(bytes, |b| {
            let number = f32::from_le_bytes(b.take(4)?.try_into().ok()?);
            let value = Joints { position: vec![f64::from(number)], ..Joints::default() };
            Some(Stamped { stamped: None, value })
        }),
        _ => None,
    }
}

/// Types of [`wrench`].
pub(crate) const WRENCH_TYPES: &[&str] = &["geometry_msgs/WrenchStamped"];

/// A wrench; not one with numbers that are not finite.
pub(crate) fn wrench(kind: &str, bytes: &[u8]) -> Option<Stamped<Wrench>> {
    if !WRENCH_TYPES.contains(&kind) {
        return None;
    }
    let wrench = stamped(bytes, |b| Some(Wrench { force: b.vector()?, torque: b.vector()? }));
    wrench.filter(|wrench| wrench.value.is_finite())
}

/// Types of [`button`].
pub(crate) const BUTTON_TYPES: &[&str] = &["sensor_msgs/Joy", "std_msgs/Bool"];

/// First button: 0 released, 1 pressed, 2 clicked.
pub(crate) fn button(kind: &str, bytes: &[u8]) -> Option<i32> {
    match kind {
        "sensor_msgs/Joy" => whole(bytes, |b| {
            b.header()?;
            let axes = b.count()?;
            b.take(axes.checked_mul(4)?)?;
            let buttons = b.count()?;
            let buttons = b.take(buttons.checked_mul(4)?)?;
            Some(i32::from_le_bytes(buttons.get(..4)?.try_into().ok()?))
        }),
        "std_msgs/Bool" => whole(bytes, |b| b.byte().map(|byte| i32::from(byte != 0))),
        _ => None,
    }
}

/// What an arm says about itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct State {
    pub name: String,
    /// Homed and busy; `None` where only a name is sent.
    pub homed_busy: Option<(bool, bool)>,
}

impl State {
    /// Whether the arm can be used: enabled, homed and not busy, or, where only a name is sent, not the one of arms that
    /// have not been powered on.
    pub fn is_ready(&self) -> bool {
        match self.homed_busy {
            Some((homed, busy)) => self.name == "ENABLED" && homed && !busy,
            None => self.name != Mode::Uninitialised.name(),
        }
    }
}

/// Types of [`state`].
pub(crate) const STATE_TYPES: &[&str] = &["crtk_msgs/OperatingState", "crtk_msgs/operating_state", "std_msgs/String"];

/// A state.
pub(crate) fn state(kind: &str, bytes: &[u8]) -> Option<State> {
    let name = |text: &[u8]| String::from_utf8_lossy(text).into_owned();
    match kind {
        "crtk_msgs/OperatingState" | "crtk_msgs/operating_state" => whole(bytes, |b| {
            b.header()?;
            Some(State { name: name(b.text()?), homed_busy: Some((b.byte()? != 0, b.byte()? != 0)) })
        }),
        "std_msgs/String" => whole(bytes, |b| Some(State { name: name(b.text()?), homed_busy: None })),
        _ => None,
    }
}

/// Types of [`matrix`].
pub(crate) const MATRIX_TYPES: &[&str] = &["std_msgs/Float64MultiArray"];

/// Numbers of a matrix as they come.
pub(crate) fn matrix(kind: &str, bytes: &[u8]) -> Option<Vec<f64>> {
    if !MATRIX_TYPES.contains(&kind) {
        return None;
    }
    whole(bytes, |b| {
        for _ in 0..b.count()? {
            b.text()?;
            b.take(8)?;
        }
        b.take(4)?;
        b.numbers()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{crtk_msgs, geometry_msgs, sensor_msgs, std_msgs};
    use rosrust::Message;

    /// The bytes without the length of the whole.
    fn body<M: Message>(message: &M) -> Vec<u8> {
        message.encode_vec().unwrap()[4..].to_vec()
    }

    /// The message is read, and no part of it nor more than it.
    fn check<M: Message, T: std::fmt::Debug>(message: &M, read: impl Fn(&str, &[u8]) -> Option<T>) -> T {
        let mut bytes = body(message);
        for end in 0..bytes.len() {
            assert!(read(&M::msg_type(), &bytes[..end]).is_none(), "{end} of {} bytes", bytes.len());
        }
        let value = read(&M::msg_type(), &bytes).unwrap();
        assert!(read("some/Type", &bytes).is_none());
        bytes.push(0);
        assert!(read(&M::msg_type(), &bytes).is_none());
        value
    }

    #[test]
    fn poses_of_all_types() {
        let position = geometry_msgs::Point { x: 1.0, y: 2.0, z: 3.0 };
        let translation = geometry_msgs::Vector3 { x: 1.0, y: 2.0, z: 3.0 };
        let orientation = geometry_msgs::Quaternion { x: 0.0, y: 0.0, z: 2.0, w: 0.0 };
        let mut header = std_msgs::Header { frame_id: "viewer".into(), ..Default::default() };
        let pose_ = geometry_msgs::Pose { position, orientation: orientation.clone() };
        let half_turn = |got: &Stamped<Isometry3<f64>>| {
            assert_eq!(got.value.translation.vector, Vector3::new(1.0, 2.0, 3.0));
            assert!((got.value.rotation.angle() - std::f64::consts::PI).abs() < 1e-12);
        };
        let plain = check(&pose_, pose);
        half_turn(&plain);
        assert_eq!(plain.stamped, None);
        let mut stamped = geometry_msgs::PoseStamped { header: header.clone(), pose: pose_ };
        let got = check(&stamped, pose);
        half_turn(&got);
        assert_eq!(got.stamped, Some(false));
        header.stamp.nsec = 1;
        let transform = geometry_msgs::Transform { translation, rotation: orientation };
        let message = geometry_msgs::TransformStamped { header, child_frame_id: "tip".into(), transform };
        let got = check(&message, pose);
        half_turn(&got);
        assert_eq!(got.stamped, Some(true));
        assert!(pose("geometry_msgs/PoseStamped", &body(&message)).is_none(), "types are not mistaken for each other");
        stamped.pose.orientation.z = 0.0;
        assert!(pose("geometry_msgs/PoseStamped", &body(&stamped)).is_none(), "no quaternion");
        stamped.pose.orientation.w = 1.0;
        stamped.pose.position.x = f64::NAN;
        assert!(pose("geometry_msgs/PoseStamped", &body(&stamped)).is_none());
    }

    #[test]
    fn joints_buttons_states_and_the_rest() {
        let message = sensor_msgs::JointState {
            name: vec!["a".into(), "b".into()],
            position: vec![1.0, 2.0],
            effort: vec![3.0],
            ..Default::default()
        };
        let got = check(&message, joints).value;
        assert_eq!((got.position, got.velocity, got.effort), (vec![1.0, 2.0], vec![], vec![3.0]));
        assert_eq!(check(&std_msgs::Float32 { data: 0.5 }, joints).value.position, [0.5]);
        let joy = sensor_msgs::Joy { axes: vec![0.5], buttons: vec![2, 1], ..Default::default() };
        assert_eq!(check(&joy, button), 2);
        assert_eq!(button("sensor_msgs/Joy", &body(&sensor_msgs::Joy::default())), None, "no button at all");
        assert_eq!(check(&std_msgs::Bool { data: true }, button), 1);
        let operating =
            crtk_msgs::OperatingState { state: "ENABLED".into(), is_homed: true, is_busy: false, ..Default::default() };
        assert_eq!(check(&operating, state), State { name: "ENABLED".into(), homed_busy: Some((true, false)) });
        assert_eq!(check(&std_msgs::String { data: "x".into() }, state).name, "x");
        let mut force = geometry_msgs::WrenchStamped::default();
        force.wrench.force.x = 4.0;
        assert_eq!(check(&force, wrench).value.force.x, 4.0);
        let dimension = std_msgs::MultiArrayDimension { label: "rows".into(), size: 1, stride: 2 };
        let layout = std_msgs::MultiArrayLayout { dim: vec![dimension], data_offset: 0 };
        assert_eq!(check(&std_msgs::Float64MultiArray { layout, data: vec![1.0, 2.0] }, matrix), [1.0, 2.0]);
    }

    #[test]
    fn lengths_that_lie_are_refused() {
        let mut bytes = body(&sensor_msgs::JointState::default());
        let at = bytes.len() - 4;
        bytes[at..].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(joints("sensor_msgs/JointState", &bytes).is_none());
    }
}
