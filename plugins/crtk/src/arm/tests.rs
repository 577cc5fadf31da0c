#![allow(clippy::approx_constant, reason = "limits as the dVRK simulators write them")]

use std::iter::{empty, once};

use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::kinematics::testing::{coordinates, gap, random_psm, Random};
use crate::kinematics::{DhTable, Instrument, Inverse, Kinematics, Limits, PsmInverse};
use crate::trajectory::Bounds;

const DT: f64 = 1e-3;
const SECOND: u64 = 1_000_000_000;
const HOME: [f64; 6] = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0];

pub(crate) fn psm(dialect: Dialect) -> ArmModel {
    let limits = [
        (-1.5708, 1.5708),
        (-0.7854, 0.7854),
        (0.0, 0.24),
        (-4.53786, 4.53786),
        (-1.2217, 1.2217),
        (-1.39626, 1.39626),
    ];
    let names = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"];
    ArmModel {
        name: "PSM1".into(),
        joints: names.map(String::from).into(),
        fingers: vec!["left".into(), "right".into()],
        kinematics: Kinematics {
            chain: DhTable::psm(&Instrument::LARGE_NEEDLE_DRIVER).chain(),
            inverse: Inverse::Psm(PsmInverse::from(&Instrument::LARGE_NEEDLE_DRIVER)),
        },
        limits: limits.map(|(lower, upper)| Limits { lower, upper }).into(),
        bounds: Bounds {
            speed: Coordinates::from([5.0, 5.0, 0.4, 50.0, 50.0, 50.0, 1.0, 1.0]),
            acceleration: Coordinates::repeat(20.0),
        },
        efforts: Coordinates::repeat(f64::INFINITY),
        home: Some(coordinates(&HOME)),
        jaw: Some(JawModel {
            limits: Limits { lower: -0.349, upper: 1.396 },
            speed: 0.4,
            acceleration: 10.0,
            home: 0.0,
        }),
        dialect,
        on_limit: if dialect == Dialect::Contract { OnLimit::Refuse } else { OnLimit::Clamp },
        frames: FrameNames { reference: "ECM_view".into(), base: dialect.base_frame("PSM1") },
        instrument: InstrumentNumber::of_tool("420006"),
    }
}

/// An arm whose joints are where they are told to be.
struct Bench {
    arm: Arm,
    measured: Measured,
    stamp: u64,
    events: Vec<Event>,
}

impl Bench {
    fn new(dialect: Dialect) -> Self {
        Self::of(psm(dialect))
    }

    fn of(model: ArmModel) -> Self {
        let measured = Measured { position: coordinates(&HOME), ..Measured::default() };
        let mut bench = Self { arm: Arm::new(Arc::new(model)), measured, stamp: SECOND, events: Vec::new() };
        bench.step(empty());
        bench.events.clear();
        bench
    }

    fn step(&mut self, commands: impl Iterator<Item = Command>) {
        self.stamp += SECOND / 1000;
        self.arm.update(self.stamp, DT, &self.measured, commands, &mut self.events);
        let set_point = self.arm.set_point();
        if set_point.drive == Drive::Position {
            self.measured.velocity = (set_point.position - self.measured.position) / DT;
            self.measured.position = set_point.position;
        }
        if set_point.jaw_drive == Drive::Position {
            self.measured.jaw[0] = set_point.jaw[0];
        }
    }

    fn tell(&mut self, command: Command) {
        self.step(once(command));
    }

    fn state(&mut self, text: &str) {
        self.tell(Command::State(text.into()));
    }

    fn joints(&mut self, level: Level, values: &[f64]) {
        let message = JointMessage { position: values.to_vec(), ..JointMessage::default() };
        let command = self.arm.model().joint_command(level, Quantity::Position, &message);
        self.tell(command);
    }

    fn jaw(&mut self, level: Level, angle: f64) {
        let message = JointMessage { position: vec![angle], ..JointMessage::default() };
        let command = self.arm.model().jaw_command(level, Quantity::Position, &message);
        self.tell(command);
    }

    /// Until nothing moves; how long it took, s.
    fn rest(&mut self) -> f64 {
        for k in 0..20_000 {
            if !self.arm.is_busy() {
                return f64::from(k) * DT;
            }
            self.step(empty());
        }
        panic!("it does not come to rest");
    }

    /// What was said about being busy, and the warnings.
    fn said(&mut self) -> (Vec<bool>, Vec<Refusal>) {
        let mut busy = Vec::new();
        let mut refusals = Vec::new();
        for event in self.events.drain(..) {
            match event {
                Event::State(state) => busy.push(state.is_busy),
                Event::Warning { refusal, .. } => refusals.push(refusal),
                _ => (),
            }
        }
        (busy, refusals)
    }

    /// Whether moves came to their goals, as was said.
    fn goals(&mut self) -> Vec<bool> {
        let goal = |event| if let Event::Goal(reached) = event { Some(reached) } else { None };
        self.events.drain(..).filter_map(goal).collect()
    }

    fn position(&self) -> &Coordinates {
        &self.arm.set_point().position
    }
}

#[test]
fn it_starts_enabled_homed_and_at_home() {
    let mut arm = Arm::new(Arc::new(psm(Dialect::Contract)));
    let measured = Measured::default();
    let mut events = Vec::new();
    arm.update(SECOND, DT, &measured, empty(), &mut events);
    let expected = OperatingState { stamp: SECOND, state: State::Enabled, is_homed: true, is_busy: false };
    let settings = [Event::Ratios(Ratios::default()), Event::OrientationLocked(false)];
    assert_eq!(events, [&[Event::State(expected)], &settings[..]].concat());
    for k in 0..1000 {
        arm.update(SECOND + k, DT, &measured, empty(), &mut events);
    }
    assert_eq!(arm.set_point().position, coordinates(&HOME));
    assert_eq!(events.len(), 3, "going home at the start is not busy");
}

#[test]
fn every_move_is_busy_and_then_not() {
    let mut bench = Bench::new(Dialect::Contract);
    bench.joints(Level::Move, &[0.5, 0.0, 0.1, 0.0, 0.0, 0.0]);
    bench.rest();
    assert_eq!(bench.said(), (vec![true, false], vec![]));
    assert_eq!(bench.position()[0], 0.5);
    bench.joints(Level::Move, &[0.5, 0.0, 0.1, 0.0, 0.0, 0.0]);
    assert_eq!(bench.said(), (vec![true, false], vec![]), "to where it is");
    bench.joints(Level::Move, &[0.5]);
    let (busy, refusals) = bench.said();
    assert_eq!((busy, refusals), (vec![true, false], vec![Refusal::Count { got: 1, expected: 6 }]));
    bench.jaw(Level::Move, 0.2);
    assert!((bench.rest() - 0.5).abs() < 2.0 * DT);
    assert_eq!(bench.said(), (vec![true, false], vec![]));
    bench.state("disable");
    bench.said();
    bench.joints(Level::Move, &HOME);
    assert_eq!(bench.said(), (vec![true, false], vec![]), "not accepted, without a word");
    assert_eq!(bench.position()[0], 0.5);
}

#[test]
fn a_second_move_is_busy_again_and_the_set_point_goes_on() {
    let mut bench = Bench::new(Dialect::Dvrk);
    bench.joints(Level::Move, &[0.5, 0.3, 0.1, 0.0, 0.0, 0.0]);
    let mut last = *bench.arm.set_point();
    for k in 0..3000 {
        if k == 100 {
            bench.joints(Level::Move, &[-0.5, -0.3, 0.2, 1.0, 0.0, 0.0]);
        } else {
            bench.step(empty());
        }
        let now = *bench.arm.set_point();
        let bounds = &bench.arm.model().bounds;
        for i in 0..6 {
            let jump = (now.velocity[i] - last.velocity[i]).abs();
            assert!(jump <= bounds.acceleration[i] * DT * 1.001 + 1e-9, "joint {i} at {k}: {jump}");
        }
        last = now;
    }
    assert_eq!(bench.said().0, [true, true, false]);
    assert_eq!(bench.position()[0], -0.5);
}

#[test]
fn moves_end_together_without_exceeding_a_speed() {
    let mut bench = Bench::new(Dialect::Contract);
    bench.joints(Level::Move, &[1.0, 0.5, 0.04, 1.0, 0.2, -0.2]);
    let mut last = *bench.position();
    let mut moving = [0; 6];
    for k in 0..400 {
        bench.step(empty());
        let now = *bench.position();
        for i in 0..6 {
            let speed = (now[i] - last[i]).abs() / DT;
            assert!(speed <= bench.arm.model().bounds.speed[i] * (1.0 + 1e-9));
            if now[i] != last[i] {
                moving[i] = k;
            }
        }
        last = now;
    }
    assert!(moving.iter().all(|&k| k == moving[0]), "{moving:?}");
    assert!((f64::from(moving[0]) * DT - 0.2).abs() < 3.0 * DT, "0.08 m at 0.4 m/s and 1 rad at 5 rad/s");
    assert_eq!(last, coordinates(&[1.0, 0.5, 0.04, 1.0, 0.2, -0.2]));
}

#[test]
fn servo_ends_a_move_and_is_never_busy() {
    let mut bench = Bench::new(Dialect::Contract);
    bench.joints(Level::Move, &[1.0, 0.0, 0.12, 0.0, 0.0, 0.0]);
    bench.jaw(Level::Move, 0.3);
    bench.said();
    bench.joints(Level::Servo, &[0.1, 0.0, 0.12, 0.0, 0.0, 0.0]);
    assert_eq!(bench.position()[0], 0.1);
    assert!(bench.arm.is_busy(), "the jaw still moves");
    bench.jaw(Level::Servo, 0.1);
    assert!(!bench.arm.is_busy());
    assert_eq!(bench.said().0, [false]);
    for _ in 0..100 {
        bench.joints(Level::Servo, &[0.2, 0.0, 0.12, 0.0, 0.0, 0.0]);
    }
    assert_eq!(bench.said().0, Vec::<bool>::new());
}

#[test]
fn pausing_stops_a_move_for_good() {
    let mut bench = Bench::new(Dialect::Contract);
    bench.joints(Level::Move, &[1.0, 0.0, 0.12, 0.0, 0.0, 0.0]);
    for _ in 0..50 {
        bench.step(empty());
    }
    bench.measured.position[0] = 0.2;
    bench.state(" PAUSE ");
    assert_eq!(bench.position()[0], 0.2, "the set point is where the arm is");
    assert_eq!(bench.said().0, [true, false]);
    bench.state("resume");
    for _ in 0..100 {
        bench.step(empty());
    }
    assert_eq!((bench.position()[0], bench.said().0), (0.2, vec![false]));
}

#[test]
fn state_commands_are_told_once_each() {
    let mut bench = Bench::new(Dialect::Contract);
    for k in 0..1000 {
        bench.state(if k % 2 == 0 { "disable" } else { "enable" });
    }
    let stamps: Vec<u64> = (bench.events.iter())
        .map(|event| match event {
            Event::State(state) => state.stamp,
            other => panic!("{other:?} is not due"),
        })
        .collect();
    assert_eq!(stamps.len(), 1000);
    assert!(stamps.windows(2).all(|pair| pair[0] < pair[1]));
    bench.events.clear();
    // All in one step, at one time.
    let burst = (0..100).map(|_| Command::State("enable".into()));
    bench.step(burst);
    assert!(bench.events.windows(2).all(|pair| match pair {
        [Event::State(a), Event::State(b)] => a.stamp < b.stamp,
        _ => false,
    }));
    bench.events.clear();
    bench.state("jump");
    bench.state("resume");
    let (busy, refusals) = bench.said();
    assert!(busy.is_empty());
    assert_eq!(refusals[0], Refusal::UnknownState("jump".into()));
    assert_eq!(refusals[1], Refusal::State { command: "resume".into(), state: State::Enabled });
}

#[test]
fn an_arm_that_is_not_homed_takes_no_motion() {
    let mut bench = Bench::new(Dialect::Contract);
    bench.state("unhome");
    bench.said();
    bench.joints(Level::Servo, &[0.3, 0.0, 0.12, 0.0, 0.0, 0.0]);
    bench.joints(Level::Servo, &[f64::NAN, 0.0, 0.12, 0.0, 0.0, 0.0]);
    bench.jaw(Level::Servo, 0.3);
    assert_eq!(bench.said(), (vec![], vec![]));
    assert_eq!((bench.position()[0], bench.arm.set_point().jaw[0]), (0.0, 0.0));
    bench.state("home");
    bench.joints(Level::Servo, &[0.3, 0.0, 0.12, 0.0, 0.0, 0.0]);
    assert_eq!(bench.position()[0], 0.3);
}

#[test]
fn joints_are_ordered_by_their_names() {
    let model = psm(Dialect::Contract);
    let command = |names: &[&str], position: &[f64]| {
        let names = names.iter().map(|name| (*name).to_owned()).collect();
        let message = JointMessage { names, position: position.to_vec(), ..JointMessage::default() };
        model.joint_command(Level::Servo, Quantity::Position, &message)
    };
    let value = |command| match command {
        Command::Joints { value, .. } => Some(value),
        _ => None,
    };
    let values = [0.1, 0.2, 0.03, 0.4, 0.5, 0.6];
    let expected = coordinates(&values);
    assert_eq!(value(command(&[], &values)), Some(expected));
    assert_eq!(value(command(&["0", "1", "2", "3", "4", "5"], &values)), Some(expected));
    let turned = ["wrist_yaw", "wrist_pitch", "roll", "insertion", "pitch", "yaw"];
    assert_eq!(value(command(&turned, &[0.6, 0.5, 0.4, 0.03, 0.2, 0.1])), Some(expected));
    for names in [
        &["yaw", "pitch"][..],
        &["yaw", "yaw", "insertion", "roll", "wrist_pitch", "wrist_yaw"],
        &["yaw", "pitch", "insertion", "roll", "wrist_pitch", "elbow"],
        &["1", "0", "2", "3", "4", "5"],
    ] {
        let refusal = command(names, &values);
        assert!(matches!(refusal, Command::Refused { refusal: Refusal::Names { .. }, .. }), "{refusal:?}");
    }
}

#[test]
fn what_is_no_command_is_refused_with_one_warning() {
    let mut bench = Bench::new(Dialect::Contract);
    let before = *bench.position();
    let model = Arc::clone(bench.arm.model());
    let pose = PoseMessage { orientation: [0.0, 0.0, 0.0, 1.0], ..PoseMessage::default() };
    let bad = [
        PoseMessage { orientation: [0.0; 4], ..pose.clone() },
        PoseMessage { position: [f64::INFINITY, 0.0, 0.0], ..pose.clone() },
        PoseMessage { frame: "moon".into(), ..pose },
    ];
    for message in &bad {
        bench.tell(model.pose_command(Level::Servo, message, false));
    }
    let (_, refusals) = bench.said();
    assert_eq!(refusals[..2], [Refusal::Quaternion, Refusal::NotFinite]);
    assert!(refusals[2].to_string().contains("moon") && refusals[2].to_string().contains("ECM_view"));
    for values in [&[][..], &[0.0; 5], &[0.0; 7], &[0.0, f64::NAN, 0.0, 0.0, 0.0, 0.0]] {
        bench.joints(Level::Servo, values);
    }
    for angle in [f64::NAN, 2.0] {
        bench.jaw(Level::Servo, angle);
    }
    assert_eq!(bench.said().1.len(), 6);
    assert_eq!(*bench.position(), before);
}

#[test]
fn limits_are_refused_or_clipped() {
    for (beyond, refused) in [(2e-6, true), (5e-7, false)] {
        let mut bench = Bench::new(Dialect::Contract);
        bench.joints(Level::Servo, &[1.5708 + beyond, 0.0, 0.12, 0.0, 0.0, 0.0]);
        assert_eq!(bench.said().1.len(), usize::from(refused));
        assert_eq!(bench.position()[0], if refused { 0.0 } else { 1.5708 });
    }
    let mut bench = Bench::new(Dialect::Dvrk);
    bench.joints(Level::Servo, &[9.0, 0.0, 0.12, 0.0, 0.0, 0.0]);
    assert_eq!((bench.position()[0], bench.said().1), (1.5708, vec![]));
}

fn pose_message(pose: &Isometry3<f64>, frame: &str) -> PoseMessage {
    let q = pose.rotation.coords;
    PoseMessage { frame: frame.into(), position: pose.translation.vector.into(), orientation: [q.x, q.y, q.z, q.w] }
}

/// Clients of the challenge name the frame as its interface does; their poses were refused.
#[test]
fn the_base_has_the_name_of_the_dialect_and_the_common_one() {
    for (dialect, name) in
        [(Dialect::Contract, "PSM1_base"), (Dialect::Src, "PSM1/baselink"), (Dialect::Src, "PSM1_base")]
    {
        let mut bench = Bench::new(dialect);
        let model = Arc::clone(bench.arm.model());
        let mut q = coordinates(&HOME);
        q[0] += 0.1;
        let pose = model.kinematics.chain.forward(&q);
        bench.tell(model.pose_command(Level::Servo, &pose_message(&pose, name), false));
        assert_eq!(bench.said().1, []);
        assert!(gap(&model.kinematics.chain.forward(bench.position()), &pose) < 1e-9, "{name}");
        bench.tell(model.pose_command(Level::Servo, &pose_message(&pose, "PSM2/baselink"), false));
        assert!(matches!(bench.said().1[..], [Refusal::Frame { .. }]), "another arm's");
    }
}

#[test]
fn one_place_in_three_frames_is_one_place() {
    let mut bench = Bench::new(Dialect::Contract);
    let turn = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.5);
    bench.measured.base = Isometry3::from_parts(Vector3::new(0.1, 0.2, 0.3).into(), turn);
    bench.measured.reference = Isometry3::from_parts(Vector3::new(-0.1, 0.0, 0.4).into(), turn.inverse());
    let model = Arc::clone(bench.arm.model());
    let mut random = Random::new(61);
    for _ in 0..100 {
        let mut q = random_psm(&mut random);
        (q[0], q[1], q[4]) = (q[0] * 0.9, q[1] * 0.8, q[4] * 0.8);
        let in_base = model.kinematics.chain.forward(&q);
        let in_world = bench.measured.base * in_base;
        let in_reference = bench.measured.reference.inv_mul(&in_world);
        for (pose, frame) in
            [(in_base, "PSM1_base"), (in_world, "world"), (in_reference, "ECM_view"), (in_reference, "")]
        {
            bench.joints(Level::Servo, &HOME);
            bench.tell(model.pose_command(Level::Servo, &pose_message(&pose, frame), false));
            assert_eq!(bench.said().1, []);
            assert!(gap(&model.kinematics.chain.forward(bench.position()), &in_base) < 1e-9, "{frame}");
        }
        bench.tell(model.pose_command(Level::Servo, &pose_message(&in_base, ""), true));
        assert!(gap(&model.kinematics.chain.forward(bench.position()), &in_base) < 1e-9, "local");
    }
}

#[test]
fn places_out_of_reach_keep_the_target_and_are_named_once_a_second() {
    let mut bench = Bench::new(Dialect::Contract);
    let model = Arc::clone(bench.arm.model());
    let above = pose_message(&Isometry3::translation(0.0, 0.01, 0.2), "PSM1_base");
    for _ in 0..2500 {
        bench.tell(model.pose_command(Level::Servo, &above, false));
    }
    let (busy, refusals) = bench.said();
    assert_eq!((busy.len(), refusals.len()), (0, 3));
    assert_eq!(*bench.position(), coordinates(&HOME));
    bench.tell(model.pose_command(Level::Move, &above, false));
    assert_eq!(bench.said().0, [true, false]);
}

#[test]
fn speeds_stop_soon_after_the_last_command() {
    let mut bench = Bench::new(Dialect::Dvrk);
    bench.tell(Command::Joints { level: Level::Servo, quantity: Quantity::Velocity, value: coordinates(&[0.5]) });
    for _ in 0..500 {
        bench.step(empty());
    }
    assert!((bench.position()[0] - 0.5 * VELOCITY_TIMEOUT).abs() < 1e-3, "{}", bench.position()[0]);
    assert_eq!(bench.arm.set_point().velocity, Coordinates::zeros());
    let before = bench.arm.model().kinematics.chain.forward(bench.position());
    bench.tell(Command::Twist(Vector6::new(0.1, 0.0, 0.0, 0.0, 0.0, 0.0)));
    for _ in 0..50 {
        bench.step(empty());
    }
    let after = bench.arm.model().kinematics.chain.forward(bench.position());
    let moved = after.translation.vector - before.translation.vector;
    assert!((moved - Vector3::new(0.0051, 0.0, 0.0)).norm() < 1e-4, "{moved}");
    assert!((after.rotation.inverse() * before.rotation).angle() < 1e-3);
}

#[test]
fn wrenches_do_the_work_that_the_tool_does() {
    let mut bench = Bench::new(Dialect::Dvrk);
    bench.tell(Command::GravityCompensation(false));
    let wrench = Vector6::new(0.4, -0.2, 1.0, 0.01, 0.02, -0.03);
    let chain = bench.arm.model().kinematics.chain.clone();
    let speeds = coordinates(&[0.1, -0.2, 0.05, 0.3, 0.1, -0.4]);
    for (frame, absolute) in [(WrenchFrame::Body, false), (WrenchFrame::Body, true), (WrenchFrame::Spatial, false)] {
        bench.tell(Command::AbsoluteForces(absolute));
        bench.tell(Command::Wrench { wrench, frame });
        let set_point = bench.arm.set_point();
        assert_eq!(set_point.drive, Drive::Effort);
        let twist = match (frame, absolute) {
            (WrenchFrame::Spatial, _) => chain.spatial_jacobian(&bench.measured.position) * speeds,
            (_, true) => chain.jacobian(&bench.measured.position) * speeds,
            _ => chain.body_jacobian(&bench.measured.position) * speeds,
        };
        assert!((set_point.effort.dot(&speeds) - wrench.dot(&twist)).abs() < 1e-12);
        let jacobian = chain.body_jacobian(&bench.measured.position);
        if (frame, absolute) == (WrenchFrame::Body, false) {
            assert!((wrench_of(&jacobian, &set_point.effort) - wrench).norm() < 1e-4);
        }
    }
    for _ in 0..600 {
        bench.step(empty());
    }
    assert_eq!(bench.arm.set_point().drive, Drive::Position, "the last one is too old");
}

#[test]
fn free_arms_are_held_against_gravity_and_hold_again_where_they_are() {
    let mut bench = Bench::new(Dialect::Dvrk);
    bench.measured.holding = coordinates(&[0.0, 0.5, -1.0]);
    bench.tell(Command::GravityCompensation(false));
    bench.tell(Command::Free);
    assert_eq!(bench.arm.set_point().effort, bench.measured.holding);
    bench.measured.position[1] = 0.25;
    bench.tell(Command::Hold);
    assert_eq!((bench.arm.set_point().drive, bench.position()[1]), (Drive::Position, 0.25));
}

#[test]
fn relative_moves_add_up() {
    let mut bench = Bench::new(Dialect::Dvrk);
    let by = |level| Command::Joints { level, quantity: Quantity::Relative, value: coordinates(&[0.1]) };
    bench.tell(by(Level::Move));
    bench.tell(by(Level::Move));
    bench.rest();
    assert!((bench.position()[0] - 0.2).abs() < 1e-12);
    bench.tell(by(Level::Servo));
    assert!((bench.position()[0] - 0.3).abs() < 1e-12);
}

#[test]
fn interpolated_goals_are_followed_smoothly_and_not_busy() {
    let mut bench = Bench::new(Dialect::Dvrk);
    let mut last = *bench.arm.set_point();
    for k in 0..1000 {
        if k % 20 == 0 {
            let goal = 0.2 * (f64::from(k) * 0.005).sin();
            bench.joints(Level::Interpolate, &[goal, 0.0, 0.12, 0.0, 0.0, 0.0]);
        } else {
            bench.step(empty());
        }
        let now = *bench.arm.set_point();
        assert!((now.velocity[0] - last.velocity[0]).abs() <= 20.0 * DT * 1.001 + 1e-9);
        last = now;
    }
    assert_eq!(bench.said(), (vec![], vec![]));
}

#[test]
fn a_reset_is_as_the_start() {
    let mut bench = Bench::new(Dialect::Contract);
    bench.joints(Level::Move, &[1.0, 0.0, 0.12, 0.0, 0.0, 0.0]);
    bench.state("disable");
    let before = bench.arm.operating_state().stamp;
    bench.events.clear();
    bench.arm.reset();
    bench.step(empty());
    let state = bench.arm.operating_state();
    assert_eq!((state.state, state.is_homed, state.is_busy), (State::Enabled, true, false));
    assert!(state.stamp > before);
    assert_eq!(bench.said().0, [false]);
}

#[test]
fn a_lost_place_in_the_queue_is_a_warning_in_any_state() {
    let mut bench = Bench::new(Dialect::Contract);
    bench.state("disable");
    bench.said();
    bench.tell(refused(Level::Servo, Refusal::Full));
    assert_eq!(bench.said().1, [Refusal::Full]);
}

#[test]
fn each_move_is_told_to_have_reached_its_goal_or_not() {
    let away = [0.5, 0.0, 0.12, 0.0, 0.0, 0.0];
    let mut bench = Bench::new(Dialect::Dvrk);
    bench.joints(Level::Move, &HOME);
    bench.rest();
    assert_eq!(bench.goals(), [true], "of no length");
    bench.joints(Level::Move, &away);
    bench.step(empty());
    assert_eq!(bench.goals(), [false; 0], "on its way");
    bench.joints(Level::Move, &HOME);
    bench.rest();
    assert_eq!(bench.goals(), [false, true], "another took its place");
    bench.joints(Level::Move, &away);
    bench.joints(Level::Servo, &HOME);
    assert_eq!(bench.goals(), [false], "a servo command ended it");
    bench.joints(Level::Move, &away);
    bench.jaw(Level::Move, 0.5);
    bench.rest();
    assert_eq!(bench.goals(), [true], "arm and jaw together");
    bench.joints(Level::Move, &HOME);
    bench.state("pause");
    assert_eq!(bench.goals(), [false]);
    bench.joints(Level::Move, &HOME);
    assert_eq!(bench.goals(), [false], "it was not taken");
    bench.state("resume");
    bench.joints(Level::Move, &[0.0]);
    assert_eq!(bench.goals(), [false], "it was refused");
}

#[test]
fn ratios_slow_moves_down() {
    let goal = [0.5, 0.0, 0.12, 0.0, 0.0, 0.0];
    let took = |commands: &[Command]| {
        let mut bench = Bench::new(Dialect::Dvrk);
        commands.iter().for_each(|command| bench.tell(command.clone()));
        bench.joints(Level::Move, &goal);
        bench.rest()
    };
    let (full, none) = (took(&[]), [0.0, -0.5, 1.0001, f64::NAN]);
    // 0.5 rad at most 5 rad/s and 20 rad/s²: accelerations decide, 2 sqrt(d / a).
    assert!((full - 2.0 * (0.5_f64 / 20.0).sqrt()).abs() < 0.003, "{full}");
    let quarter = took(&[ArmModel::ratio_command(RatioOf::Accelerations, 0.25)]);
    assert!((quarter - 2.0 * full).abs() < 0.005, "{quarter}");
    // 0.5 rad/s, with ramps of 25 ms.
    let slow = took(&[ArmModel::ratio_command(RatioOf::Speeds, 0.1)]);
    assert!((slow - 1.025).abs() < 0.005, "{slow}");
    let both = took(&[ArmModel::ratio_command(RatioOf::Both, 0.1)]);
    assert!((both - 1.25).abs() < 0.005, "{both}");
    let mut bench = Bench::new(Dialect::Dvrk);
    for value in none {
        bench.tell(ArmModel::ratio_command(RatioOf::Both, value));
    }
    let (_, refusals) = bench.said();
    assert!(refusals.len() == 4 && refusals.iter().all(|refusal| matches!(refusal, Refusal::Ratio(_))));
    bench.tell(ArmModel::ratio_command(RatioOf::Both, 0.5));
    bench.tell(ArmModel::ratio_command(RatioOf::Speeds, 1.0));
    let told = |event: &Event| {
        if let Event::Ratios(ratios) = event {
            Some((ratios.speed, ratios.acceleration))
        } else {
            None
        }
    };
    assert_eq!(bench.events.iter().filter_map(told).collect::<Vec<_>>(), [(0.5, 0.5), (1.0, 0.5)]);
    bench.arm.reset();
    bench.events.clear();
    bench.step(empty());
    assert_eq!(bench.events.iter().filter_map(told).collect::<Vec<_>>(), [(1.0, 1.0)]);
}

#[test]
fn a_named_frame_is_known_once_the_reference_is_called_so() {
    let mut bench = Bench::new(Dialect::Dvrk);
    let place = bench.arm.model().kinematics.chain.forward(&coordinates(&[0.1, 0.1, 0.1, 0.0, 0.0, 0.0]));
    let message = |pose: &Isometry3<f64>, frame: &str| {
        let (p, q) = (pose.translation.vector, pose.rotation.coords);
        PoseMessage { frame: frame.into(), position: p.into(), orientation: [q.x, q.y, q.z, q.w] }
    };
    let model = Arc::clone(bench.arm.model());
    let go = |frame: &str| model.pose_command(Level::Servo, &message(&place, frame), false);
    bench.tell(go("camera"));
    assert!(matches!(&bench.said().1[..], [Refusal::Frame { got, .. }] if got == "camera"));
    let base = Isometry3::translation(0.1, 0.2, 0.3);
    bench.tell(model.base_frame_command(&message(&base, "camera")));
    assert_eq!(bench.arm.base_frame(), Some(&base));
    // What the plugin does with it.
    bench.measured.reference = bench.measured.base * base.inverse();
    let seen = base * place;
    bench.tell(model.pose_command(Level::Servo, &message(&seen, "camera"), false));
    assert_eq!(bench.said().1, []);
    let there = model.kinematics.chain.forward(bench.position());
    assert!(gap(&there, &place) < 1e-9);
    bench.tell(go("moon"));
    assert_eq!(bench.said().1.len(), 1);
    let long = model.base_frame_command(&message(&base, &"x".repeat(MAX_FRAME + 1)));
    assert!(matches!(long, Command::RefusedSetting(Refusal::LongFrame(_))));
}

#[test]
fn an_instrument_can_be_named_if_its_lengths_are_the_same() {
    let mut bench = Bench::new(Dialect::Dvrk);
    let model = Arc::clone(bench.arm.model());
    bench.tell(model.tool_type_command("LARGE_NEEDLE_DRIVER_400006"));
    assert!(bench.events.contains(&Event::Tool(InstrumentNumber::of_tool("400006"))));
    assert_eq!(bench.said().1, []);
    bench.tell(model.tool_type_command("420093"));
    bench.tell(model.tool_type_command("scissors"));
    bench.tell(model.tool_type_command("4200061"));
    let refusals = bench.said().1;
    assert!(matches!(
        &refusals[..],
        [Refusal::OtherInstrument { .. }, Refusal::NoInstrument(_), Refusal::NoInstrument(_)]
    ));
    let mut nameless = psm(Dialect::Dvrk);
    nameless.instrument = None;
    assert!(matches!(nameless.tool_type_command("420093"), Command::ToolType(_)));
    let mut arm = Arm::new(Arc::new(nameless));
    let mut events = Vec::new();
    arm.update(SECOND, DT, &Measured::default(), empty(), &mut events);
    assert!(events.contains(&Event::Tool(None)), "it asks for it");
}

#[test]
fn without_an_instrument_there_are_no_poses() {
    let mut bench = Bench::new(Dialect::Dvrk);
    let place = bench.arm.model().kinematics.chain.forward(&coordinates(&HOME));
    let go = Command::Pose { level: Level::Move, pose: place, frame: Frame::Base };
    bench.tell(Command::ToolPresent(false));
    assert!(!bench.arm.has_tool());
    bench.tell(go.clone());
    assert_eq!(bench.said().1, [Refusal::NoTool]);
    bench.joints(Level::Move, &HOME);
    bench.rest();
    assert_eq!(bench.said().1, [], "joints move");
    bench.tell(Command::ToolPresent(true));
    bench.tell(go);
    assert_eq!(bench.said().1, []);
}

/// A master as dVRK's table has it.
fn master() -> ArmModel {
    let free = Limits { lower: -3.0, upper: 3.0 };
    let names = ["yaw", "shoulder", "elbow", "platform", "pitch", "wrist_yaw", "roll"];
    let chain = DhTable::mtm().chain();
    ArmModel {
        name: "MTMR".into(),
        joints: names.map(String::from).into(),
        kinematics: Kinematics { chain, inverse: Inverse::None },
        limits: vec![free; 7],
        home: None,
        jaw: None,
        instrument: None,
        ..psm(Dialect::Dvrk)
    }
}

#[test]
fn a_locked_orientation_is_kept_while_the_arm_is_led_about() {
    let start = [0.1, 0.2, 0.1, 0.0, 0.5, 0.1, 0.2, 0.0];
    let mut bench = Bench::of(master());
    bench.measured.position = coordinates(&start);
    bench.tell(Command::Free);
    let model = Arc::clone(bench.arm.model());
    let rotation = |q: &Coordinates| model.kinematics.chain.forward(q).rotation;
    let locked = rotation(&bench.measured.position);
    bench.tell(Command::LockOrientation(locked));
    assert!(bench.events.contains(&Event::OrientationLocked(true)));
    for k in 1..=1000 {
        // A hand leads the first joints; the others are where they are told to be.
        let set_point = *bench.arm.set_point();
        assert_eq!((set_point.drive, set_point.positioned_from), (Drive::Effort, 3));
        bench.measured.position = set_point.position;
        for (joint, begin) in start.iter().enumerate().take(3) {
            bench.measured.position[joint] = begin + 0.2 * (f64::from(k) * 2e-3).sin();
        }
        bench.step(empty());
        let kept = bench.arm.set_point().position;
        assert!(rotation(&kept).angle_to(&locked) < 1e-6, "step {k}: {}", rotation(&kept).angle_to(&locked));
    }
    assert!((bench.measured.position - coordinates(&start)).amax() > 0.1, "it was led about");
    // A goal that is far is come to at the largest speeds, which are 50 rad/s at the wrist here.
    let turned = locked * UnitQuaternion::from_euler_angles(0.3, 0.0, 0.0);
    bench.tell(Command::LockOrientation(turned));
    assert!(rotation(&bench.arm.set_point().position).angle_to(&turned) > 0.1);
    for _ in 0..50 {
        bench.measured.position = bench.arm.set_point().position;
        bench.step(empty());
    }
    assert!(rotation(&bench.arm.set_point().position).angle_to(&turned) < 1e-6);
    bench.tell(Command::UnlockOrientation);
    assert_eq!(bench.arm.set_point().positioned_from, MAX_JOINTS);
    assert!(bench.events.contains(&Event::OrientationLocked(false)));
}
