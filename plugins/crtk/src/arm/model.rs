//! What does not change about an arm.

use nalgebra::Isometry3;

use super::command::InstrumentNumber;
use super::state::Dialect;
use crate::kinematics::{Coordinates, Kinematics, Limits};
use crate::trajectory::{Bounds, Shape};

/// What is done with a target beyond a joint's limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OnLimit {
    /// The command is refused with a warning.
    Refuse,
    /// The target is clipped, without a word.
    Clamp,
}

/// Names of the frames in which poses may come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameNames {
    /// Of what is published, and of poses without a frame.
    pub reference: String,
    /// The arm's base.
    pub base: String,
}

/// The jaw of an instrument.
#[derive(Debug, Clone, PartialEq)]
pub struct JawModel {
    /// Range, rad.
    pub limits: Limits,
    /// Largest speed, rad/s.
    pub speed: f64,
    /// Largest acceleration, rad/s².
    pub acceleration: f64,
    /// At the start, rad.
    pub home: f64,
}

/// An arm as it is configured.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmModel {
    /// Name: its topics begin with it.
    pub name: String,
    /// Names of the joints on the wire.
    pub joints: Vec<String>,
    /// Names of the joints of its fingers.
    pub fingers: Vec<String>,
    /// Forward and inverse kinematics.
    pub kinematics: Kinematics,
    /// A range a joint.
    pub limits: Vec<Limits>,
    /// Largest speeds and accelerations.
    pub bounds: Bounds,
    /// Largest efforts, N·m or N; infinite without.
    pub efforts: Coordinates,
    /// Where it goes at the start and at resets; `None`: where it is.
    pub home: Option<Coordinates>,
    /// Its jaw.
    pub jaw: Option<JawModel>,
    /// How it speaks.
    pub dialect: Dialect,
    /// What is done with targets beyond limits.
    pub on_limit: OnLimit,
    /// Names of frames.
    pub frames: FrameNames,
    /// The instrument that the scene has, where it is known.
    pub instrument: Option<InstrumentNumber>,
}

/// A target may be beyond a limit by so much, rad or m.
pub const LIMIT_TOLERANCE: f64 = 1e-6;

impl ArmModel {
    /// Number of joints.
    pub fn count(&self) -> usize {
        self.kinematics.chain.count()
    }

    /// Clips efforts, N·m or N.
    pub(super) fn limit_efforts(&self, efforts: &mut Coordinates) {
        for (effort, most) in efforts.iter_mut().zip(self.efforts.iter()) {
            *effort = effort.max(-most).min(*most);
        }
    }

    /// The course of moves in its dialect.
    pub fn shape(&self) -> Shape {
        match self.dialect {
            Dialect::Contract | Dialect::Plugin => Shape::Straight,
            Dialect::Dvrk => Shape::Bounded,
            Dialect::Src => Shape::Quintic(0.5),
        }
    }
}

/// What the simulation says about an arm after a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// rad or m.
    pub position: Coordinates,
    /// rad/s or m/s.
    pub velocity: Coordinates,
    /// N·m or N; 0 without feedback.
    pub effort: Coordinates,
    /// Efforts that hold the arm against gravity, N·m or N.
    pub holding: Coordinates,
    /// Jaw: angle between the fingers, rad; its speed, rad/s; its effort, N·m.
    pub jaw: [f64; 3],
    /// The base in the world.
    pub base: Isometry3<f64>,
    /// The reference frame in the world.
    pub reference: Isometry3<f64>,
}

impl Default for Measured {
    fn default() -> Self {
        let zero = Coordinates::zeros();
        let identity = Isometry3::identity();
        Self {
            position: zero,
            velocity: zero,
            effort: zero,
            holding: zero,
            jaw: [0.0; 3],
            base: identity,
            reference: identity,
        }
    }
}
