use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use ambf_plugin::SnapshotWriter;
use crossbeam_channel::bounded;
use nalgebra::{UnitQuaternion, Vector3};
use parking_lot::Mutex;

use super::*;
use crate::arm::tests::psm;
use crate::arm::{Arm, Measured, OperatingState, Quantity, State};
use crate::exchange::commands;
use crate::kinematics::testing::coordinates;
use crate::queries::Service;
use crate::topics::{topics, Extras};
use crate::transport::Answer;

/// A transport that keeps what is sent.
#[derive(Clone, Default)]
struct Memory {
    sent: Arc<Mutex<Vec<(String, Message)>>>,
    receivers: Arc<Mutex<Vec<(String, Receive)>>>,
    is_open: Arc<AtomicBool>,
}

struct MemorySender(Memory, String);

impl Sender for MemorySender {
    fn is_open(&self) -> bool {
        self.0.is_open.load(Ordering::Acquire)
    }

    fn has_receivers(&self) -> bool {
        self.is_open()
    }

    fn send(&self, message: &Message) {
        self.0.sent.lock().push((self.1.clone(), message.clone()));
    }
}

impl Transport for Memory {
    fn advertise(&mut self, topic: &Topic) -> Result<Box<dyn Sender>, TransportError> {
        Ok(Box::new(MemorySender(self.clone(), topic.name.clone())))
    }

    fn subscribe(&mut self, topic: &Topic, receive: Receive) -> Result<(), TransportError> {
        self.receivers.lock().push((topic.name.clone(), receive));
        Ok(())
    }

    fn serve(&mut self, _: &Service, _: Answer) -> Result<(), TransportError> {
        Ok(())
    }
}

fn offered(dialect: Dialect, memory: &Memory, outbox: &Arc<Outbox>) -> Offered {
    let model = Arc::new(psm(dialect));
    let all = topics(&model, "/PSM1", Extras { tool_type: true, ..Extras::default() });
    let texts = Texts { tool_type: Some("420006".into()), info: Vec::new() };
    let mut transports: Vec<Box<dyn Transport>> = vec![Box::new(memory.clone())];
    Offered::open((&model, &all), (1000.0, ClockKind::Wall), texts, outbox, &mut transports).unwrap()
}

fn status() -> ArmStatus {
    let measured = Measured { position: coordinates(&[0.1, -0.2, 0.15, 0.3, -0.4, 0.5]), ..Measured::default() };
    let mut reading = Reading { measured, ..Reading::default() };
    let arm = Arm::new(Arc::new(psm(Dialect::Dvrk)));
    reading.tool.pose = arm.model().kinematics.chain.forward(&reading.measured.position);
    ArmStatus {
        reading: Some(reading),
        set_point: *arm.set_point(),
        state: arm.operating_state(),
        absolute_forces: false,
        reference_name: None,
        has_tool: true,
    }
}

impl Memory {
    fn last(&self, name: &str) -> Option<Message> {
        self.sent.lock().iter().rev().find(|(topic, _)| topic == name).map(|(_, message)| message.clone())
    }
}

#[test]
fn latched_messages_wait_for_an_open_topic() {
    let memory = Memory::default();
    let (outbox, _inbox) = commands();
    let mut arm = offered(Dialect::Contract, &memory, &outbox);
    let state = OperatingState { stamp: 7, state: State::Paused, is_homed: true, is_busy: false };
    arm.tell(&Event::State(state));
    assert!(memory.sent.lock().is_empty());
    memory.is_open.store(true, Ordering::Release);
    arm.publish(&status(), 5);
    assert_eq!(memory.last("/PSM1/tool_type"), Some(Message::Text("420006".into())));
    let Some(Message::OperatingState { header, state, .. }) = memory.last("/PSM1/operating_state") else {
        panic!("no state")
    };
    assert_eq!((header.stamp, state.as_str()), (7, "PAUSED"));
    let count = memory.sent.lock().len();
    arm.publish(&status(), 6);
    let again = memory.sent.lock()[count..].iter().filter(|(name, _)| name == "/PSM1/tool_type").count();
    assert_eq!(again, 0, "once is enough");
}

#[test]
fn the_statistics_of_a_window_are_sent_once() {
    let memory = Memory::default();
    memory.is_open.store(true, Ordering::Release);
    let (outbox, _inbox) = commands();
    let mut arm = offered(Dialect::Dvrk, &memory, &outbox);
    let mut statistics = Statistics::default();
    arm.tell_statistics(&statistics, 1);
    assert_eq!(memory.last("/PSM1/period_statistics"), None, "no window is over");
    (statistics.window, statistics.samples) = (1, 1000);
    arm.tell_statistics(&statistics, 2);
    memory.sent.lock().iter().for_each(|(name, message)| {
        if name == "/PSM1/period_statistics" {
            assert!(matches!(message, Message::Statistics(header, told) if header.stamp == 2 && told.samples == 1000));
            // The header, nine numbers, and three counts.
            assert_eq!(message.encode().len(), 4 + 8 + 4 + "ECM_view".len() + 12 * 8);
        }
    });
    let count = memory.sent.lock().len();
    arm.tell_statistics(&statistics, 3);
    assert_eq!(memory.sent.lock().len(), count);
}

#[test]
fn all_topics_of_a_publication_carry_one_stamp_and_the_frame() {
    let memory = Memory::default();
    memory.is_open.store(true, Ordering::Release);
    let (outbox, _inbox) = commands();
    let mut arm = offered(Dialect::Dvrk, &memory, &outbox);
    memory.sent.lock().clear();
    arm.publish(&status(), 42);
    let sent = memory.sent.lock().clone();
    assert!(sent.len() >= 13, "{}", sent.len());
    for (name, message) in &sent {
        let (Message::Joints(header, _)
        | Message::Pose(header, _)
        | Message::Twist(header, _)
        | Message::Wrench(header, _)) = message
        else {
            continue;
        };
        assert_eq!(header.stamp, 42, "{name}");
        let is_in_base = name.contains("local/") || name.contains("_cf");
        assert_eq!(header.frame, if is_in_base { "PSM1_base" } else { "ECM_view" }, "{name}");
    }
}

#[test]
fn without_a_position_to_go_to_the_set_point_is_not_valid() {
    let memory = Memory::default();
    memory.is_open.store(true, Ordering::Release);
    let (outbox, _inbox) = commands();
    let mut arm = offered(Dialect::Dvrk, &memory, &outbox);
    let mut status = status();
    status.set_point.drive = Drive::Effort;
    arm.publish(&status, 42);
    let Some(Message::Pose(header, _)) = memory.last("/PSM1/setpoint_cp") else { panic!("no set point") };
    assert_eq!(header.stamp, 0);
    let Some(Message::Joints(header, joints)) = memory.last("/PSM1/setpoint_js") else { panic!("no set point") };
    assert_eq!((header.stamp, joints.effort.len()), (42, 6));
}

#[test]
fn what_comes_is_a_command_or_a_refusal() {
    let memory = Memory::default();
    let (outbox, mut inbox) = commands();
    let _arm = offered(Dialect::Dvrk, &memory, &outbox);
    let receive = |name: &str, bytes: &[u8]| {
        let receivers = memory.receivers.lock();
        let (_, receive) = receivers.iter().find(|(topic, _)| topic == name).unwrap();
        receive(bytes);
    };
    let joints = JointMessage { position: vec![0.1; 6], ..JointMessage::default() };
    let bytes = Message::Joints(Header::default(), joints).encode();
    receive("/PSM1/move_jp", &bytes);
    receive("/PSM1/move_jp", &bytes[1..]);
    receive("/PSM1/hold", &[]);
    receive("/PSM1/hold", &[1]);
    let taken: Vec<Command> = inbox.take().collect();
    assert!(matches!(taken[0], Command::Joints { level: Level::Move, quantity: Quantity::Position, .. }));
    assert_eq!(taken[1], Command::Refused { is_move: true, refusal: Refusal::Unreadable });
    assert_eq!(taken[2], Command::Hold);
    assert_eq!(taken[3], Command::Refused { is_move: false, refusal: Refusal::Unreadable });
    // Whatever the bytes are.
    for (_, receive) in memory.receivers.lock().iter() {
        for length in 0..bytes.len() {
            receive(&bytes[..length]);
            receive(&vec![0xff; length]);
            let _ = inbox.take().count();
        }
    }
}

#[test]
fn two_transports_say_the_same_and_share_one_queue() {
    let memories = [Memory::default(), Memory::default()];
    memories.iter().for_each(|memory| memory.is_open.store(true, Ordering::Release));
    let (outbox, mut inbox) = commands();
    let model = Arc::new(psm(Dialect::Dvrk));
    let all = topics(&model, "/PSM1", Extras::default());
    let mut transports: Vec<Box<dyn Transport>> = Vec::new();
    memories.iter().for_each(|memory| transports.push(Box::new(memory.clone())));
    let served = (1000.0, ClockKind::Wall);
    let mut arm = Offered::open((&model, &all), served, Texts::default(), &outbox, &mut transports).unwrap();
    arm.publish(&status(), 42);
    arm.tell(&Event::Goal(true));
    let sent = |memory: &Memory| memory.sent.lock().clone();
    assert!(sent(&memories[0]).len() > 10);
    assert_eq!(sent(&memories[0]), sent(&memories[1]), "numbers and stamps");
    for (turn, memory) in memories.iter().cycle().take(6).enumerate() {
        let receivers = memory.receivers.lock();
        let (_, receive) = receivers.iter().find(|(topic, _)| topic == "/PSM1/trajectory_j/set_ratio").unwrap();
        receive(&Message::Number(0.1 * (turn + 1) as f64).encode());
        // The newest servo command counts, from wherever it came.
        let (_, servo) = receivers.iter().find(|(topic, _)| topic == "/PSM1/servo_jp").unwrap();
        let position = vec![0.01 * turn as f64, 0.0, 0.1, 0.0, 0.0, 0.0];
        servo(&Message::Joints(Header::default(), JointMessage { position, ..JointMessage::default() }).encode());
    }
    let taken: Vec<Command> = inbox.take().collect();
    let ratios = taken.iter().filter_map(|command| match command {
        Command::Ratio { value, .. } => Some(*value),
        _ => None,
    });
    let expected: Vec<f64> = (1..=6).map(|turn| 0.1 * f64::from(turn)).collect();
    assert_eq!(ratios.collect::<Vec<_>>(), expected, "in the order of arrival");
    let servo: Vec<&Command> = taken.iter().filter(|command| matches!(command, Command::Joints { .. })).collect();
    assert!(matches!(servo[..], [Command::Joints { value, .. }] if (value[0] - 0.05).abs() < 1e-12));
}

#[test]
fn a_moving_view_sees_a_still_tool_move() {
    let turn = UnitQuaternion::from_euler_angles(0.2, 0.4, -0.3);
    let tool = Moving { pose: Isometry3::translation(0.1, 0.2, 0.3), ..Moving::default() };
    let reference = Moving {
        pose: Isometry3::from_parts(Vector3::new(0.0, 0.1, 0.5).into(), turn),
        twist: Vector6::new(0.01, -0.02, 0.03, 0.4, -0.5, 0.6),
    };
    let seen = relative_twist(&tool, &reference);
    const DT: f64 = 1e-6;
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.4, -0.5, 0.6) * DT) * turn;
    let moved = Vector3::new(0.0, 0.1, 0.5) + Vector3::new(0.01, -0.02, 0.03) * DT;
    let later = Isometry3::from_parts(moved.into(), rotation);
    let (before, after) = (reference.pose.inv_mul(&tool.pose), later.inv_mul(&tool.pose));
    let linear = (after.translation.vector - before.translation.vector) / DT;
    let angular = (after.rotation * before.rotation.inverse()).scaled_axis() / DT;
    assert!((seen.fixed_rows::<3>(0) - linear).norm() < 1e-5);
    assert!((seen.fixed_rows::<3>(3) - angular).norm() < 1e-5);
}

#[test]
fn the_publisher_ends_with_the_events_and_sends_them_in_order() {
    let memory = Memory::default();
    memory.is_open.store(true, Ordering::Release);
    let (outbox, _inbox) = commands();
    let arm = offered(Dialect::Contract, &memory, &outbox);
    let slot = Arc::new(SnapshotSlot::empty());
    let mut writer = SnapshotWriter::new(Status { arms: vec![status()], ..Status::default() });
    writer.publish(&slot, |status| status.wall_time = wall_time());
    let (sender, events) = bounded(64);
    let lines = Arc::new(Mutex::new(Vec::new()));
    let log = Arc::clone(&lines);
    let told = Told::new(move |line| log.lock().push(line.to_owned()));
    let publisher =
        Publisher { arms: vec![(0, arm)], status: slot, events, clock: Vec::new(), transports: Vec::new(), told };
    let thread = thread::spawn(|| publisher.run());
    for stamp in 1..=20 {
        let state = OperatingState { stamp, state: State::Enabled, is_homed: true, is_busy: stamp % 2 == 0 };
        sender.send((0, Event::State(state))).unwrap();
    }
    let deadline = Instant::now() + Duration::from_secs(20);
    while memory.last("/PSM1/measured_js").is_none() {
        assert!(Instant::now() < deadline, "nothing is published");
        thread::yield_now();
    }
    let unknown = |got: &str| Refusal::Frame { got: got.into(), expected: "PSM1_base".into() };
    for refusal in [unknown("a"), Refusal::Unreadable, unknown("b"), Refusal::Unreadable] {
        sender.send((0, Event::Warning { stamp: 21, refusal })).unwrap();
    }
    drop(sender);
    thread.join().unwrap();
    // Commands in an unknown frame used to be dropped without a word in the dialects that have no topic for warnings.
    let once = |refusal: Refusal| format!("PSM1: {refusal}; this reason is said once");
    assert_eq!(*lines.lock(), [once(unknown("a")), once(Refusal::Unreadable)]);
    let sent = memory.sent.lock();
    let stamps: Vec<u64> = (sent.iter())
        .filter_map(|(_, message)| match message {
            Message::OperatingState { header, .. } => Some(header.stamp),
            _ => None,
        })
        .collect();
    assert_eq!(stamps, (1..=20).collect::<Vec<_>>());
}
