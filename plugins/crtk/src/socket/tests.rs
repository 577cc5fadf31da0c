use std::collections::BTreeMap;

use ambf_plugin::SnapshotWriter;
use nalgebra::Vector3;
use parking_lot::Mutex;

use super::*;
use crate::arm::tests::psm;
use crate::arm::{Arm, Dialect, Frame, Measured};
use crate::bind::Reading;
use crate::exchange::{commands as queue, Inbox};
use crate::kinematics::testing::{coordinates, gap, Random};

fn config(style: Style) -> SocketConfig {
    let bridge = style == Style::Bridge;
    SocketConfig {
        listen: "127.0.0.1:0".parse().unwrap(),
        to: None,
        style,
        rate: if bridge { 60.0 } else { 100.0 },
        tell: if bridge {
            vec![Told::SetPointPose, Told::SetPointJaw]
        } else {
            Told::ALL.iter().map(|(_, told)| *told).collect()
        },
        offset: if bridge {
            UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, std::f64::consts::PI)
        } else {
            UnitQuaternion::identity()
        },
    }
}

/// An arm at home that has just been measured there.
fn status() -> ArmStatus {
    let home = coordinates(&[0.0, 0.0, 0.12, 0.0, 0.0, 0.0]);
    let measured = Measured { position: home, jaw: [0.0; 3], ..Measured::default() };
    let mut arm = Arm::new(Arc::new(psm(Dialect::Src)));
    arm.update(1, 0.001, &measured, std::iter::empty(), &mut Vec::new());
    let mut reading = Reading { measured, ..Reading::default() };
    reading.tool.pose = arm.model().kinematics.chain.forward(&home);
    ArmStatus {
        reading: Some(reading),
        set_point: *arm.set_point(),
        state: arm.operating_state(),
        absolute_forces: false,
        reference_name: None,
        has_tool: true,
    }
}

const STAMP: u64 = 12_500_000_000;

fn told(style: Style, what: Told) -> String {
    message(&config(style), &psm(Dialect::Src), what, &status(), STAMP).unwrap()
}

#[test]
fn the_bridge_says_it_byte_for_byte() {
    let jaw =
        "{\"jaw/setpoint_js\":{\"AutomaticTimestamp\":true,\"Effort\":[0.0],\"Name\":[\"jaw\"],\"Position\":[0.0],\
               \"Timestamp\":12.5,\"Valid\":true,\"Velocity\":[0.0]}}";
    assert_eq!(told(Style::Bridge, Told::SetPointJaw), jaw);
    let pose = told(Style::Bridge, Told::SetPointPose);
    let start = "{\"setpoint_cp\":{\"AutomaticTimestamp\":true,\"Position\":{\"Rotation\":[[";
    assert!(pose.starts_with(start) && pose.ends_with("]},\"Timestamp\":12.5,\"Valid\":true}}"), "{pose}");
    assert!(pose.find("Rotation") < pose.find("Translation"));
}

#[test]
fn everything_is_json_without_blanks_below_1024_bytes() {
    for style in [Style::Bridge, Style::Streamer] {
        for (key, what) in Told::ALL {
            let text = told(style, what);
            assert!(text.len() < 1024 && !text.contains(' '), "{text}");
            assert_eq!(text.ends_with('\n'), style == Style::Streamer);
            let value: Value = serde_json::from_str(&text).unwrap();
            let keys: BTreeMap<&String, &Value> = value.as_object().unwrap().iter().collect();
            assert_eq!(keys.keys().map(|key| key.as_str()).collect::<Vec<_>>(), [key]);
            // Keys are sorted, at all depths; numbers may differ in their last digit after reading.
            let shape = |text: &str| text.chars().filter(|c| !"0123456789.-e".contains(*c)).collect::<String>();
            assert_eq!(shape(&serde_json::to_string(&value).unwrap()), shape(text.trim_end()));
        }
    }
    // Numbers at their longest.
    let mut status = status();
    status.set_point.position = Coordinates::repeat(-1.0 / 3.0);
    status.set_point.velocity = Coordinates::repeat(-1.234_567_890_123_456_7e-300);
    let text = message(&config(Style::Streamer), &psm(Dialect::Src), Told::SetPointJoints, &status, u64::MAX);
    assert!(text.unwrap().len() < 1024);
}

#[test]
fn a_tip_in_front_of_the_arm_is_told_in_front_of_the_headset_and_comes_back() {
    // 400006, the table of the tests: 0.1135 m below the remote centre.
    let text = told(Style::Bridge, Told::SetPointPose);
    let value: Value = serde_json::from_str(&text).unwrap();
    let position = &value["setpoint_cp"]["Position"];
    let place = numbers(&position["Translation"]).unwrap();
    assert!(place[0].abs() + place[1].abs() < 1e-9 && (place[2] - 0.1135).abs() < 1e-9, "{place:?}");
    let back = format!("{{\"move_cp\":{{\"Goal\":{position}}}}}");
    let [Command::Pose { level: Level::Servo, pose, frame: Frame::Base }] =
        commands(&config(Style::Bridge), &psm(Dialect::Src), back.as_bytes()).unwrap()[..]
    else {
        panic!("no pose")
    };
    let own = psm(Dialect::Src).kinematics.chain.forward(&status().set_point.position);
    assert!(gap(&own, &pose) < 1e-9);
}

#[test]
fn moves_are_servo_commands_for_the_bridge_only() {
    let text = br#"{"jaw/move_jp":{"Goal":[0.25]},"move_jp":{"Goal":[0,0,0.1,0,0,0]},"hold":""}"#;
    let levels = |style| {
        let all = commands(&config(style), &psm(Dialect::Src), text).unwrap();
        let level = |command: &Command| match command {
            Command::Jaw { level, .. } | Command::Joints { level, .. } => Some(*level),
            Command::Hold => None,
            other => panic!("{other:?}"),
        };
        let mut levels: Vec<Option<Level>> = all.iter().map(level).collect();
        levels.sort_by_key(Option::is_some);
        levels
    };
    assert_eq!(levels(Style::Bridge), [None, Some(Level::Servo), Some(Level::Servo)]);
    assert_eq!(levels(Style::Streamer), [None, Some(Level::Move), Some(Level::Move)]);
}

#[test]
fn what_is_of_no_use_is_left_out_or_refused() {
    let read = |text: &[u8]| commands(&config(Style::Streamer), &psm(Dialect::Src), text);
    // Unknown keys, missing and null goals, goals of other types.
    for text in [
        &br#"{"dance":{"Goal":[1]}}"#[..],
        br#"{"servo_jp":{}}"#,
        br#"{"servo_jp":{"Goal":null}}"#,
        br#"{"servo_jp":null}"#,
        br#"{"servo_jp":{"Goal":[1,null,2]}}"#,
        br#"{"move_cp":{"Goal":{"Rotation":null,"Translation":[0,0,0]}}}"#,
        br#"{"move_cp":{"Goal":{"Rotation":[[1,0,0],[0,1,0]],"Translation":[0,0,0]}}}"#,
        br#"{"state_command":7}"#,
        b"{}",
    ] {
        assert_eq!(read(text), Ok(vec![]), "{}", String::from_utf8_lossy(text));
    }
    // No object at all.
    for text in [&b""[..], b"[]", b"7", b"{", b"\xff\xfe", b"{\"servo_jp\":{\"Goal\":[1e999]}}"] {
        assert!(read(text).is_err(), "{}", String::from_utf8_lossy(text));
    }
    // As many brackets as fit.
    assert!(read("[".repeat(60_000).as_bytes()).is_err());
    // A rotation that is none, numbers too many: refused by the arm, with a warning.
    for text in [
        &br#"{"servo_cp":{"Goal":{"Rotation":[[1,0,0],[0,1,0],[0,0,-1]],"Translation":[0,0,-0.1]}}}"#[..],
        br#"{"servo_cp":{"Goal":{"Rotation":[[0,0,0],[0,0,0],[0,0,0]],"Translation":[0,0,-0.1]}}}"#,
        br#"{"servo_jp":{"Goal":[1,2,3]}}"#,
    ] {
        assert!(matches!(read(text).unwrap()[..], [Command::Refused { .. }]), "{}", String::from_utf8_lossy(text));
    }
    // Zeros behind the object.
    let padded = [&br#"{"jaw/servo_jp":{"Goal":[0.1]}}"#[..], &[b'\n', 0, 0, 0]].concat();
    assert_eq!(read(&padded), Ok(vec![Command::Jaw { level: Level::Servo, angle: 0.1 }]));
}

/// A streamer with an arm's status, a client's socket, and what came of datagrams.
struct Peer {
    _streamer: Streamer,
    client: UdpSocket,
    arm: SocketAddr,
    inbox: Inbox,
    said: Arc<Mutex<Vec<String>>>,
    writer: SnapshotWriter<Status>,
    slot: Arc<SnapshotSlot<Status>>,
}

impl Peer {
    fn new(mut config: SocketConfig, knows_client: bool) -> Self {
        let client = UdpSocket::bind("127.0.0.1:0").unwrap();
        client.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        if knows_client {
            config.to = Some(client.local_addr().unwrap());
        }
        // A port that is free now.
        config.listen = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let (outbox, inbox) = queue();
        let slot = Arc::new(SnapshotSlot::empty());
        let template = Status { arms: vec![status()], wall_time: STAMP, ..Status::default() };
        let writer = SnapshotWriter::new(template);
        let said = Arc::new(Mutex::new(Vec::new()));
        let heard = Arc::clone(&said);
        let say = move |text: &str| heard.lock().push(text.to_owned());
        let model = Arc::new(psm(Dialect::Src));
        let streamer = Streamer::start(&config, (model, 0), outbox, Arc::clone(&slot), say).unwrap();
        let mut peer = Self { _streamer: streamer, client, arm: config.listen, inbox, said, writer, slot };
        peer.writer.publish(&peer.slot, |_| ());
        peer
    }

    fn send(&self, bytes: &[u8]) {
        self.client.send_to(bytes, self.arm).unwrap();
    }

    fn receive(&self) -> (Value, SocketAddr) {
        let mut bytes = [0; 1024];
        let (count, from) = self.client.recv_from(&mut bytes).unwrap();
        (serde_json::from_slice(&bytes[..count]).unwrap(), from)
    }

    /// Waits for the next commands.
    fn commands(&mut self) -> Vec<Command> {
        let end = Instant::now() + Duration::from_secs(10);
        loop {
            let all: Vec<Command> = self.inbox.take().collect();
            if !all.is_empty() {
                return all;
            }
            assert!(Instant::now() < end, "nothing came");
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

#[test]
fn a_client_that_is_known_is_told_at_the_rate_from_the_port_that_listens() {
    let peer = Peer::new(config(Style::Bridge), true);
    let (first, from) = peer.receive();
    assert_eq!(from, peer.arm);
    assert!(first.get("setpoint_cp").is_some(), "in the order of the configuration");
    let begin = Instant::now();
    let mut counts = BTreeMap::new();
    for _ in 0..120 {
        let (value, _) = peer.receive();
        let key = value.as_object().unwrap().keys().next().unwrap().clone();
        *counts.entry(key).or_insert(0) += 1;
    }
    assert_eq!(counts.values().copied().collect::<Vec<i32>>(), [60, 60]);
    // 60 rounds take a second; a busy machine may be late, but what was missed is not made up for.
    assert!(begin.elapsed() > Duration::from_millis(950), "{:?}", begin.elapsed());
}

#[test]
fn whoever_speaks_is_answered() {
    let mut peer = Peer::new(config(Style::Streamer), false);
    peer.client.set_nonblocking(true).unwrap();
    std::thread::sleep(Duration::from_millis(50));
    assert!(peer.client.recv_from(&mut [0; 1024]).is_err(), "nobody is known yet");
    peer.client.set_nonblocking(false).unwrap();
    peer.send(br#"{"servo_jp":{"Goal":[0.1,0.2,0.1,0.3,0.4,0.5]},"jaw/servo_jp":{"Goal":[0.2]}}"#);
    let taken = peer.commands();
    let value = coordinates(&[0.1, 0.2, 0.1, 0.3, 0.4, 0.5]);
    let expected = Command::Joints { level: Level::Servo, quantity: Quantity::Position, value };
    assert!(taken.contains(&expected) && taken.contains(&Command::Jaw { level: Level::Servo, angle: 0.2 }));
    let keys: Vec<String> =
        (0..7).map(|_| peer.receive().0.as_object().unwrap().keys().next().unwrap().clone()).collect();
    for (key, _) in Told::ALL {
        assert!(keys.iter().any(|told| told == key), "{key} of {keys:?}");
    }
}

#[test]
fn random_datagrams_harm_nobody_and_are_named_once() {
    let mut peer = Peer::new(config(Style::Bridge), true);
    let mut random = Random::new(5);
    let good = br#"{"move_cp":{"Goal":{"Rotation":[[0,1,0],[1,0,0],[0,0,-1]],"Translation":[0.01,0.0,0.12]}}}"#;
    for k in 0..10_000 {
        let mut bytes = good.to_vec();
        if k % 2 == 0 {
            let count = random.within(0.0, 1400.0) as usize;
            bytes = (0..count).map(|_| random.within(0.0, 256.0) as u8).collect();
        } else {
            let at = random.within(0.0, bytes.len() as f64) as usize;
            bytes[at] = random.within(0.0, 256.0) as u8;
        }
        let _ = commands(&config(Style::Bridge), &psm(Dialect::Src), &bytes);
        peer.send(&bytes);
        if k % 100 == 0 {
            peer.inbox.take().for_each(drop);
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    // It still does what it is told. Datagrams may be lost where too many came at once.
    let end = Instant::now() + Duration::from_secs(10);
    let goal = Vector3::new(-0.02, 0.0, -0.1);
    let text = r#"{"move_cp":{"Goal":{"Rotation":[[0,1,0],[1,0,0],[0,0,-1]],"Translation":[0.02,0.0,0.1]}}}"#;
    loop {
        peer.send(text.as_bytes());
        let taken = peer.commands();
        let is_there = |pose: &Isometry3<f64>| (pose.translation.vector - goal).norm() < 1e-9;
        if taken.iter().any(|command| matches!(command, Command::Pose { pose, .. } if is_there(pose))) {
            break;
        }
        assert!(Instant::now() < end);
    }
    assert_eq!(peer.said.lock().len(), 1, "{:?}", peer.said.lock());
}

#[test]
fn a_port_in_use_is_named() {
    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let config = SocketConfig { listen: taken.local_addr().unwrap(), ..config(Style::Bridge) };
    let (outbox, _inbox) = queue();
    let model = Arc::new(psm(Dialect::Src));
    let started = Streamer::start(&config, (model, 0), outbox, Arc::new(SnapshotSlot::empty()), |_| ());
    assert!(started.err().unwrap().contains(&taken.local_addr().unwrap().to_string()));
}
