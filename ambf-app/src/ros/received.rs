//! Messages from clients, whose bytes are looked at before rosrust decodes them, and topics that bring them.
//!
//! rosrust reserves memory for as many elements as an array on the wire announces, before it looks whether they follow:
//! 16 bytes that are no message could end the program.

use std::sync::Arc;

use parking_lot::Mutex;
use ros_node::{Announcement, RawReceived, RawSubscription};
use rosrust::Message;

use super::messages::{ambf_msgs, sensor_msgs, std_msgs};
use super::signal::RateLimitedLog;

/// A message that clients send.
pub(super) trait FromClient: Message {
    /// Walks over the message's texts and arrays; `None` if one does not fit. Types without them have nothing to check.
    fn walk(_wire: &mut Wire<'_>) -> Option<()> {
        Some(())
    }
}

/// The bytes of a message not walked over yet.
pub(super) struct Wire<'a>(&'a [u8]);

impl Wire<'_> {
    pub(super) fn skip(&mut self, bytes: usize) -> Option<()> {
        self.0 = self.0.get(bytes..)?;
        Some(())
    }

    fn count(&mut self) -> Option<usize> {
        let (count, rest) = self.0.split_first_chunk::<4>()?;
        self.0 = rest;
        usize::try_from(u32::from_le_bytes(*count)).ok()
    }

    /// A text, or an array of elements of so many bytes.
    pub(super) fn array(&mut self, element: usize) -> Option<()> {
        let bytes = self.count()?.checked_mul(element)?;
        self.skip(bytes)
    }

    /// An array of booleans. rosrust takes their bytes as they are, and anything but 0 and 1 is no `bool`.
    pub(super) fn booleans(&mut self) -> Option<()> {
        let count = self.count()?;
        let (booleans, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        booleans.iter().all(|&byte| byte <= 1).then_some(())
    }

    /// An array of elements that have texts or arrays.
    fn each(&mut self, walk: impl Fn(&mut Self) -> Option<()>) -> Option<()> {
        (0..self.count()?).try_for_each(|_| walk(self))
    }

    pub(super) fn header(&mut self) -> Option<()> {
        self.skip(12)?;
        self.array(1)
    }
}

impl FromClient for ambf_msgs::ListModelsReq {}
impl FromClient for ambf_msgs::StopRecordingReq {}
impl FromClient for std_msgs::Empty {}
impl FromClient for std_msgs::Float32 {}

/// Sizes on the wire, bytes.
pub(super) const BOOL: usize = 1;
pub(super) const POSE: usize = 7 * 8;
pub(super) const WRENCH: usize = 6 * 8;
pub(super) const TWIST: usize = 6 * 8;

impl FromClient for ambf_msgs::AddModelReq {
    fn walk(wire: &mut Wire<'_>) -> Option<()> {
        wire.array(1)
    }
}

impl FromClient for ambf_msgs::RemoveModelReq {
    fn walk(wire: &mut Wire<'_>) -> Option<()> {
        wire.array(1)
    }
}

impl FromClient for ambf_msgs::StartRecordingReq {
    fn walk(wire: &mut Wire<'_>) -> Option<()> {
        wire.array(1)?;
        wire.skip(BOOL)
    }
}

impl FromClient for ambf_msgs::StepReq {
    fn walk(wire: &mut Wire<'_>) -> Option<()> {
        wire.skip(4 + BOOL + 8)?;
        wire.each(|name| name.array(1))?;
        wire.each(ambf_msgs::RigidBodyCmd::walk)?;
        wire.each(|name| name.array(1))?;
        wire.each(ambf_msgs::ActuatorCmd::walk)?;
        wire.each(|name| name.array(1))
    }
}

impl FromClient for sensor_msgs::PointCloud {
    fn walk(wire: &mut Wire<'_>) -> Option<()> {
        wire.header()?;
        wire.array(3 * 4)?;
        wire.each(|channel| {
            channel.array(1)?;
            channel.array(4)
        })
    }
}

/// The `M` in `body`, the bytes behind the length of the whole.
///
/// # Errors
/// A few words when it is none.
pub(super) fn read<M: FromClient>(body: &[u8]) -> Result<M, String> {
    let message = M::walk(&mut Wire(body)).and_then(|()| M::decode(body).ok());
    message.ok_or_else(|| format!("{} bytes are not a {}", body.len(), M::msg_type()))
}

/// Listens to `topic` for messages of `longest` bytes at most; bytes that are no `M` are named. `on_message` runs in a
/// thread of the node and must not block.
pub(super) fn subscription<M: FromClient>(
    topic: String,
    longest: usize,
    on_message: impl FnMut(M) + Send + 'static,
) -> Arc<dyn Announcement> {
    let (complaints, name) = (RateLimitedLog::default(), topic.clone());
    // Only to share it: messages come one at a time.
    let on_message = Mutex::new(on_message);
    RawSubscription::of::<M>(topic, longest, move |RawReceived { body, .. }| match read(body) {
        Ok(message) => (on_message.lock())(message),
        Err(why) => {
            complaints.report(format_args!("{name}: {why}; they are ignored"));
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body_of<M: Message>(message: &M) -> Vec<u8> {
        message.encode_vec().unwrap().split_off(4)
    }

    /// Every prefix is refused, and so are counts that announce more than follows.
    fn check<M: FromClient>(message: &M, counts: &[usize]) {
        let bytes = body_of(message);
        assert_eq!(read::<M>(&bytes).unwrap(), *message);
        for end in 0..bytes.len() {
            assert!(read::<M>(&bytes[..end]).is_err(), "{end} of {} bytes", bytes.len());
        }
        for &at in counts {
            let mut lying = bytes.clone();
            lying[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
            let error = read::<M>(&lying).unwrap_err();
            assert!(error.contains(&M::msg_type()), "{error}");
        }
    }

    #[test]
    fn bytes_that_are_no_command_are_refused() {
        let command =
            ambf_msgs::RigidBodyCmd { joint_cmds_types: vec![1, 2], joint_cmds: vec![0.5; 3], ..Default::default() };
        let arrays = 16 + 1 + 56 + 96;
        check(&command, &[12, arrays, arrays + 4 + 2]);
        check(&ambf_msgs::WorldCmd { n_skip_steps: 3, ..Default::default() }, &[]);
    }

    #[test]
    fn bytes_that_are_no_command_of_an_element_are_refused() {
        const HEADER: usize = 16;
        let sensor = ambf_msgs::SensorCmd { actuate: vec![true, false], ..Default::default() };
        check(&sensor, &[12, HEADER]);
        let mut neither = body_of(&sensor);
        *neither.last_mut().unwrap() = 2;
        assert!(read::<ambf_msgs::SensorCmd>(&neither).is_err(), "2 is neither true nor false");
        let actuator = ambf_msgs::ActuatorCmd {
            body_name: std_msgs::String { data: "Box".into() },
            sensor_identifier: std_msgs::String { data: "Eye".into() },
            ..Default::default()
        };
        let name = HEADER + BOOL;
        check(&actuator, &[12, name, name + 4 + 3 + BOOL + POSE + BOOL]);
        let vehicle = ambf_msgs::VehicleCmd {
            wheel_steering: vec![0.1, 0.2],
            wheel_power: vec![1.0],
            wheel_brake: vec![],
            ..Default::default()
        };
        let arrays = HEADER + WRENCH;
        check(&vehicle, &[12, arrays, arrays + 4 + 8, arrays + 4 + 8 + 4 + 4]);
        let arrays = HEADER + BOOL + POSE + WRENCH;
        let (joint_cmds, position_controller_mask) = (vec![0.5, 0.25], vec![true]);
        let soft_body = ambf_msgs::SoftBodyCmd { joint_cmds, position_controller_mask, ..Default::default() };
        check(&soft_body, &[12, arrays, arrays + 4 + 8]);
        check(&ambf_msgs::ContactSensorCmd::default(), &[12]);
        check(&ambf_msgs::GhostObjectCmd::default(), &[12]);
    }

    #[test]
    fn bytes_that_are_no_request_are_refused() {
        check(&ambf_msgs::AddModelReq { file: "car.yaml".into() }, &[0]);
        check(&ambf_msgs::RemoveModelReq { model: "car".into() }, &[0]);
        check(&ambf_msgs::StartRecordingReq { file: "a.mcap".into(), reset: true }, &[0]);
        let step = ambf_msgs::StepReq {
            body_names: vec!["/e/box".into()],
            body_commands: vec![ambf_msgs::RigidBodyCmd { joint_cmds: vec![1.0], ..Default::default() }],
            actuator_names: vec!["/e/hand".into()],
            actuator_commands: vec![ambf_msgs::ActuatorCmd::default()],
            observe: vec!["/e/box".into()],
            ..Default::default()
        };
        let bodies = 4 + BOOL + 8;
        let commands = bodies + 4 + 4 + 6;
        let actuators = commands + 4 + 16 + 1 + POSE + WRENCH + TWIST + 4 + 8 + 3 * BOOL;
        check(&step, &[bodies, bodies + 4, commands, commands + 4 + 12, actuators, actuators + 4 + 4 + 7]);
    }

    #[test]
    fn bytes_of_any_kind_end_in_a_message_or_an_error() {
        // A linear congruential generator: the same bytes in every run.
        let mut state = 1u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize
        };
        for _ in 0..5_000 {
            let mut bytes: Vec<u8> = (0..random() % 300).map(|_| random() as u8).collect();
            // Mostly small counts, so that some get far.
            bytes.iter_mut().for_each(|byte| *byte = if random() % 4 > 0 { 0 } else { *byte });
            let _ = read::<ambf_msgs::RigidBodyCmd>(&bytes);
            let _ = read::<ambf_msgs::SensorCmd>(&bytes);
            let _ = read::<ambf_msgs::ActuatorCmd>(&bytes);
            let _ = read::<ambf_msgs::VehicleCmd>(&bytes);
            let _ = read::<ambf_msgs::GhostObjectCmd>(&bytes);
            let _ = read::<ambf_msgs::SoftBodyCmd>(&bytes);
            let _ = read::<ambf_msgs::AddModelReq>(&bytes);
            let _ = read::<ambf_msgs::StartRecordingReq>(&bytes);
            let _ = read::<ambf_msgs::StepReq>(&bytes);
            let _ = read::<sensor_msgs::PointCloud>(&bytes);
        }
    }

    #[test]
    fn bytes_that_are_no_cloud_are_refused() {
        let cloud = sensor_msgs::PointCloud {
            points: vec![Default::default(); 2],
            channels: vec![sensor_msgs::ChannelFloat32 { name: "rgb".into(), values: vec![1.0, 2.0] }],
            ..Default::default()
        };
        let channels = 16 + 4 + 24;
        check(&cloud, &[12, 16, channels, channels + 4, channels + 4 + 4 + 3]);
    }
}
