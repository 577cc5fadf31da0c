//! The thread of an arm that sends its commands.

use std::sync::atomic::Ordering;
use std::time::Instant;

use crate::frames::Wrench;
use crate::inner::{Inner, Mode, Servo, FLUSH};
use crate::outputs::Outputs;
use crate::pace::{Act, Pace, Situation};

/// Sends until the arm is closed, then no force, twice.
pub(crate) fn run(inner: &Inner) {
    inner.claim_sender();
    let mut kind = Mode::Uninitialised;
    let mut pace = Pace::new(0);
    while !inner.closing.load(Ordering::Acquire) {
        let outputs = inner.outputs.load_full();
        let (wrench, servo) = (inner.commanded_wrench(), inner.servo.lock().clone());
        // A mode request ends repetitions; a wrench then counts as withdrawn, which is no force.
        let now_kind = inner.commanding();
        if now_kind != kind {
            if kind == Mode::CartesianEffort {
                send(inner, outputs.as_deref(), &Wrench::zero());
            }
            (kind, pace) = (now_kind, Pace::new(0));
            inner.acts(kind);
        }
        let command = match kind {
            Mode::Uninitialised => None,
            Mode::CartesianEffort => wrench.map(|(number, at, _)| (number, at)),
            Mode::JointPosition | Mode::CartesianPosition => servo.as_ref().map(|(number, at, _)| (*number, *at)),
        };
        let forces = kind == Mode::CartesianEffort;
        let moves = matches!(kind, Mode::JointPosition | Mode::CartesianPosition);
        let situation = Situation {
            now: Instant::now(),
            command,
            clutched: forces && inner.is_clutched(),
            listening: outputs.as_ref().is_some_and(|outputs| moves || outputs.is_felt()),
        };
        let (act, wait) = pace.step(situation);
        let outputs = outputs.as_deref();
        match (act, servo) {
            (Act::Nothing, _) => (),
            // Positions need no zero: the arm holds the last one.
            (Act::Zero, _) if moves => (),
            (Act::Zero, _) => send(inner, outputs, &Wrench::zero()),
            (Act::Clutched, _) => send(inner, outputs, &compensated(inner, Wrench::zero())),
            (Act::Command, _) if forces => {
                let mut wrench = wrench.map_or_else(Wrench::zero, |(_, _, wrench)| wrench);
                if !inner.options.send_torque {
                    wrench.torque = nalgebra::Vector3::zeros();
                }
                send(inner, outputs, &compensated(inner, wrench));
            }
            (Act::Command, Some((_, _, servo))) => {
                if let Some(motion) = outputs.and_then(Outputs::motion) {
                    match servo {
                        Servo::Pose(pose) => motion.servo_pose.send(&pose),
                        Servo::Joints(joints) => motion.servo_joints(&joints),
                    };
                }
            }
            (Act::Command, None) => (),
        }
        std::thread::park_timeout(wait);
    }
    let outputs = inner.outputs.load_full();
    for _ in 0..2 {
        send(inner, outputs.as_deref(), &Wrench::zero());
        std::thread::sleep(FLUSH);
    }
}

/// A wrench of the device frame in the arm's, with the user's own gravity term.
fn compensated(inner: &Inner, wrench: Wrench) -> Wrench {
    let frames = *inner.frames.lock();
    let mut wrench = frames.wrench_to_arm(&wrench);
    if let Some(term) = inner.gravity.lock().as_mut() {
        if let Some(posed) = inner.posed() {
            let joints = inner.joints.lock().position.clone();
            // From the frame of the tip to the axes of the base.
            let tip = frames.to_arm(&posed.pose).rotation;
            let own = term.wrench(&joints, &inner.jacobian.lock()).rotated(&tip);
            wrench = Wrench { force: wrench.force + own.force, torque: wrench.torque + own.torque };
        }
    }
    wrench
}

fn send(inner: &Inner, outputs: Option<&Outputs>, wrench: &Wrench) {
    if outputs.is_some_and(|outputs| outputs.send_wrench(wrench)) {
        inner.sent.fetch_add(1, Ordering::Relaxed);
    }
}
