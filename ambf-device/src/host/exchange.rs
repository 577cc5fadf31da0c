//! What passes between the physics thread and the thread of a device: the newest value each way, by single-writer slots
//! that never wait.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicU8, Ordering};
use std::time::{Duration, Instant};

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use triple_buffer::{triple_buffer, Input, Output};

use crate::law::{self, GainChange, Mode, Quantity, RotationRule, Switches, UNKNOWN_OPENING};

/// What is older than this says nothing about the present any more.
pub(crate) const STALE: Duration = Duration::from_millis(50);

/// State of the body that a device moves, sent to it after each iteration.
#[derive(Debug, Clone, Copy)]
pub struct BodyState {
    /// When it was written; `None`: physics has not started.
    pub stamp: Option<Instant>,
    /// Body frame in the world.
    pub pose: Isometry3<f64>,
    /// The body is part of the scene.
    pub is_there: bool,
    /// Rotation of the first paired camera in its parent, if there is one.
    pub camera: Option<UnitQuaternion<f64>>,
    /// No steps are made.
    pub paused: bool,
    /// Resets of the body until now.
    pub resets: u64,
}

/// What a device tells the physics thread, in each tick.
#[derive(Debug, Clone, Copy)]
pub struct Hand {
    /// Where the root link should be: body frame in the world.
    pub reference: Isometry3<f64>,
    /// 0 closed … 1 open.
    pub gripper: f64,
    /// Motion of the paired cameras in all ticks until now.
    pub cameras: CameraSum,
}

/// How far a device has moved its cameras since it was coupled: as a sum no tick is lost between two iterations.
#[derive(Debug, Clone, Copy, Default)]
pub struct CameraSum {
    /// Ticks in which they were moved.
    ticks: u64,
    /// m, in the axes of each camera.
    moved: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
}

impl CameraSum {
    /// Adds the motion of a tick.
    pub fn add(&mut self, motion: &law::CameraMotion) {
        self.ticks += 1;
        self.moved += motion.displacement;
        self.rotation = motion.rotation;
    }

    /// Ticks in which they were moved, and the sum of the motions: the rotation is that of the latest one.
    pub fn parts(&self) -> (u64, Isometry3<f64>) {
        (self.ticks, Isometry3::from_parts(self.moved.into(), self.rotation))
    }

    /// The sum with these [`parts`](Self::parts).
    pub fn from_parts(ticks: u64, moved: &Isometry3<f64>) -> Self {
        Self { ticks, moved: moved.translation.vector, rotation: moved.rotation }
    }

    /// The motion since `before`, if there was one.
    pub fn since(&self, before: &Self) -> Option<law::CameraMotion> {
        let motion = law::CameraMotion { displacement: self.moved - before.moved, rotation: self.rotation };
        (self.ticks != before.ticks).then_some(motion)
    }
}

/// The physics thread's end of the exchange with a device.
pub struct PhysicsEnd {
    /// Takes the state of the body that the device moves.
    pub state: Input<BodyState>,
    /// Gives the newest target of the device.
    pub hand: Output<Hand>,
}

/// The device thread's end.
pub(crate) struct DeviceEnd {
    pub state: Output<BodyState>,
    pub hand: Input<Hand>,
}

/// Both ends of a coupling of a device to a body at `pose`.
pub(crate) fn couple(pose: Isometry3<f64>) -> (PhysicsEnd, DeviceEnd) {
    let body = BodyState { stamp: None, pose, is_there: true, camera: None, paused: true, resets: 0 };
    let hand = Hand { reference: pose, gripper: UNKNOWN_OPENING, cameras: CameraSum::default() };
    let ((state_in, state_out), (hand_in, hand_out)) = (triple_buffer(&body), triple_buffer(&hand));
    (PhysicsEnd { state: state_in, hand: hand_out }, DeviceEnd { state: state_out, hand: hand_in })
}

/// Stands in for a device whose motion was recorded.
pub struct StandIn(DeviceEnd);

impl StandIn {
    /// Moves a body at `pose` (body frame in the world).
    pub fn new(pose: Isometry3<f64>) -> (PhysicsEnd, Self) {
        let (physics, device) = couple(pose);
        (physics, Self(device))
    }

    /// Leaves what the device told the physics thread.
    pub fn send(&mut self, hand: Hand) {
        self.0.hand.write(hand);
    }
}

const QUANTITIES: [Quantity; 6] = [
    Quantity::EffectorLinearGain,
    Quantity::EffectorAngularGain,
    Quantity::EffectorLinearDamping,
    Quantity::EffectorAngularDamping,
    Quantity::DeviceLinearGain,
    Quantity::DeviceAngularGain,
];

/// The quantity with a number, as `quantity as u8` gives it.
pub fn quantity(number: u8) -> Option<Quantity> {
    QUANTITIES.get(usize::from(number)).copied()
}

/// What is common to all devices of a program, for any thread to read and change: the mode of the buttons, gains, and
/// switches.
#[derive(Debug)]
pub struct Controls {
    mode: AtomicU8,
    /// Sums of the changes of each quantity, as bits of f64.
    changes: [AtomicU64; QUANTITIES.len()],
    /// Counts changes.
    revision: AtomicU64,
    forces: AtomicBool,
    assist: AtomicBool,
    camera_rotation: AtomicBool,
}

impl Controls {
    /// Controls that begin with `switches`.
    pub fn new(switches: Switches) -> Self {
        Self {
            mode: AtomicU8::new(switches.mode as u8),
            changes: [const { AtomicU64::new(0) }; QUANTITIES.len()],
            revision: AtomicU64::new(0),
            forces: AtomicBool::new(switches.forces),
            assist: AtomicBool::new(switches.gripping_assist),
            camera_rotation: AtomicBool::new(switches.rotation == RotationRule::Camera),
        }
    }

    /// All switches as they are now.
    pub fn switches(&self) -> Switches {
        Switches {
            forces: self.forces.load(Ordering::Relaxed),
            mode: Mode::from_index(self.mode.load(Ordering::Relaxed)),
            rotation: match self.camera_rotation.load(Ordering::Relaxed) {
                true => RotationRule::Camera,
                false => RotationRule::Absolute,
            },
            gripping_assist: self.assist.load(Ordering::Relaxed),
        }
    }

    /// Goes `steps` modes on, or back; returns the new one.
    pub fn step_mode(&self, steps: i8) -> Mode {
        let stepped = |mode| Mode::from_index(mode).stepped(steps);
        let step = |mode| Some(stepped(mode) as u8);
        let (Ok(before) | Err(before)) = self.mode.fetch_update(Ordering::Relaxed, Ordering::Relaxed, step);
        stepped(before)
    }

    /// Changes a gain of all devices.
    pub fn change(&self, change: GainChange) {
        let sum = &self.changes[change.quantity as usize];
        let add = |bits| Some((f64::from_bits(bits) + change.step).to_bits());
        let _ = sum.fetch_update(Ordering::Relaxed, Ordering::Relaxed, add);
        self.revision.fetch_add(1, Ordering::Release);
    }

    /// Lets devices send forces, or not.
    pub fn set_forces(&self, on: bool) {
        self.forces.store(on, Ordering::Relaxed);
    }

    /// Switches the gripping assist.
    pub fn set_gripping_assist(&self, on: bool) {
        self.assist.store(on, Ordering::Relaxed);
    }

    /// Chooses how rotations of hands are taken.
    pub fn set_rotation(&self, rule: RotationRule) {
        self.camera_rotation.store(rule == RotationRule::Camera, Ordering::Relaxed);
    }
}

/// Changes of gains as one follower has seen them.
#[derive(Debug, Clone, Default)]
pub struct Followed {
    revision: u64,
    sums: [f64; QUANTITIES.len()],
}

impl Followed {
    /// Calls `apply` with what has changed since the last call.
    pub fn catch_up(&mut self, controls: &Controls, mut apply: impl FnMut(GainChange)) {
        let revision = controls.revision.load(Ordering::Acquire);
        if std::mem::replace(&mut self.revision, revision) == revision {
            return;
        }
        for (quantity, seen) in QUANTITIES.into_iter().zip(&mut self.sums) {
            let sum = f64::from_bits(controls.changes[quantity as usize].load(Ordering::Relaxed));
            let step = sum - std::mem::replace(seen, sum);
            if step != 0.0 {
                apply(GainChange { quantity, step });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_are_numbered_in_order() {
        for (index, quantity) in QUANTITIES.into_iter().enumerate() {
            assert_eq!(quantity as usize, index);
        }
    }

    #[test]
    fn every_follower_sees_every_change_once() {
        let controls = Controls::new(Switches::default());
        let mut followers = [Followed::default(), Followed::default()];
        let change = |quantity, step| controls.change(GainChange { quantity, step });
        change(Quantity::DeviceLinearGain, 5.0);
        let mut seen = Vec::new();
        followers[0].catch_up(&controls, |change| seen.push((change.quantity, change.step)));
        change(Quantity::DeviceLinearGain, 5.0);
        change(Quantity::EffectorLinearGain, -10.0);
        for follower in &mut followers {
            follower.catch_up(&controls, |change| seen.push((change.quantity, change.step)));
            follower.catch_up(&controls, |change| panic!("{change:?} twice"));
        }
        use Quantity::{DeviceLinearGain, EffectorLinearGain};
        let expected = [
            (DeviceLinearGain, 5.0),
            (EffectorLinearGain, -10.0),
            (DeviceLinearGain, 5.0),
            (EffectorLinearGain, -10.0),
            (DeviceLinearGain, 10.0),
        ];
        assert_eq!(seen, expected);
    }

    #[test]
    fn switches_are_what_was_set() {
        let controls = Controls::new(Switches::default());
        assert_eq!(controls.switches(), Switches::default());
        assert_eq!(controls.step_mode(-1), Mode::DeviceAngularGain);
        controls.set_forces(true);
        controls.set_gripping_assist(false);
        controls.set_rotation(RotationRule::Camera);
        let mode = Mode::DeviceAngularGain;
        let expected = Switches { forces: true, mode, rotation: RotationRule::Camera, gripping_assist: false };
        assert_eq!(controls.switches(), expected);
        assert_eq!(controls.step_mode(1), Mode::CameraClutch);
    }

    #[test]
    fn motions_of_cameras_add_up() {
        let mut sum = CameraSum::default();
        let before = sum;
        let rotation = UnitQuaternion::new(Vector3::z());
        sum.add(&law::CameraMotion { displacement: Vector3::x(), rotation: UnitQuaternion::identity() });
        sum.add(&law::CameraMotion { displacement: Vector3::y(), rotation });
        let motion = sum.since(&before).expect("a motion");
        assert_eq!((motion.displacement, motion.rotation), (Vector3::new(1.0, 1.0, 0.0), rotation));
        assert!(sum.since(&sum).is_none());
    }
}
