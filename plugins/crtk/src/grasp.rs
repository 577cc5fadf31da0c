//! Grasping by rules: a jaw that is closed on a free object holds it, whatever friction would do.
//!
//! The object is taken when the jaw is commanded to `close` or less and all fingers touch it near the middle of the
//! jaw; it is released at `open`. An object that is torn away is lost until the jaw has opened.

use ambf_plugin::{ObjectType, Touch, View};
use nalgebra::{Isometry3, Point3, Vector3};

/// Names of objects that can be held in the scene, and angles.
#[derive(Debug, Clone, PartialEq)]
pub struct GraspConfig {
    /// Jaw angle at which an object is taken, rad. Default: 0.04.
    pub close: f64,
    /// Jaw angle at which it is released, rad; above `close`. Default: 0.08.
    pub open: f64,
    /// Parts of the names of objects that can be held; empty: any. Default: empty.
    pub only: Vec<String>,
    /// How far the middle of the contacts may be from that of the jaw, m. Default: 0.008.
    pub distance: f64,
    /// Middle of the jaw in the tool's frame, along z, m. Default: 0.0072, less the tip's offset.
    pub centre: f64,
}

/// Surfaces that are nearer than this touch each other, m.
const TOUCHING: f64 = 1e-4;

/// An object that is farther than this from where it was taken is torn away, m.
const TORN_DISTANCE: f64 = 0.005;

/// The same for angles, rad.
const TORN_ANGLE: f64 = 15.0 * std::f64::consts::PI / 180.0;

/// What the jaw does.
#[derive(Debug, Clone, Copy, PartialEq)]
enum State {
    /// Nothing is held.
    Empty,
    /// `object` is held by the attachment, at this pose in the tool's body.
    Holds { object: usize, attachment: u64, pose: Isometry3<f64> },
    /// Its object was torn away, and it has not opened since.
    Lost,
}

/// The rules of one jaw, and what it holds.
#[derive(Debug)]
pub struct Grasp {
    rules: GraspConfig,
    fingers: Vec<usize>,
    tool: usize,
    /// Bodies that are never held: those of the arm.
    own: Vec<usize>,
    state: State,
    /// Memory that is used again.
    touches: Vec<Touch>,
    candidates: Vec<(usize, Vector3<f64>, u32)>,
}

impl Grasp {
    /// `fingers`, `tool` and `own` are bodies: those of the jaw, that to which objects are fixed, and all of the arm.
    pub fn new(rules: GraspConfig, fingers: Vec<usize>, tool: usize, own: Vec<usize>) -> Self {
        let (touches, candidates) = (Vec::with_capacity(64), Vec::with_capacity(16));
        Self { rules, fingers, tool, own, state: State::Empty, touches, candidates }
    }

    /// The object that is held.
    pub fn held(&self) -> Option<usize> {
        match self.state {
            State::Holds { object, .. } => Some(object),
            _ => None,
        }
    }

    /// Grasps, keeps or releases after a step. `jaw`: angle to which the jaw is commanded, rad; `point`: the control
    /// point.
    pub fn update(&mut self, world: &mut View<'_>, jaw: f64, point: &Isometry3<f64>) {
        if jaw >= self.rules.open {
            return self.release(world);
        }
        match self.state {
            State::Holds { object, attachment, pose } if self.is_torn(world, object, &pose) => {
                // An object that has left the scene needs no release.
                let _ = world.detach(attachment);
                self.state = State::Lost;
            }
            State::Empty if jaw <= self.rules.close => {
                if let Some(object) = self.between(world, point) {
                    self.take(world, object);
                }
            }
            _ => (),
        }
    }

    /// Lets go, and may take again.
    pub fn release(&mut self, world: &mut View<'_>) {
        if let State::Holds { attachment, .. } = std::mem::replace(&mut self.state, State::Empty) {
            let _ = world.detach(attachment);
        }
    }

    fn take(&mut self, world: &mut View<'_>, object: usize) {
        let Some(pose) = self.in_tool(world, object) else { return };
        if let Ok(attachment) = world.attach(object, self.tool) {
            self.state = State::Holds { object, attachment, pose };
        }
    }

    fn in_tool(&self, world: &View<'_>, object: usize) -> Option<Isometry3<f64>> {
        Some(world.body(self.tool)?.inertial_pose.inv_mul(&world.body(object)?.inertial_pose))
    }

    fn is_torn(&self, world: &View<'_>, object: usize, taken: &Isometry3<f64>) -> bool {
        self.in_tool(world, object).is_none_or(|now| {
            let apart = taken.inv_mul(&now);
            apart.translation.vector.norm() > TORN_DISTANCE || apart.rotation.angle() > TORN_ANGLE
        })
    }

    /// The free object that all fingers touch near the middle of the jaw.
    fn between(&mut self, world: &View<'_>, point: &Isometry3<f64>) -> Option<usize> {
        self.candidates.clear();
        for (finger, &body) in self.fingers.iter().enumerate() {
            world.contacts(body, &mut self.touches)?;
            for touch in self.touches.iter().filter(|touch| touch.distance <= TOUCHING) {
                let Some(other) = touch.body.filter(|other| !self.own.contains(other)) else { continue };
                let bit = 1_u32 << (finger % 32);
                match self.candidates.iter_mut().find(|(candidate, ..)| *candidate == other) {
                    Some((_, sum, by)) if *by & bit == 0 => (*sum, *by) = (*sum + touch.point, *by | bit),
                    Some(_) => (),
                    None => self.candidates.push((other, touch.point, bit)),
                }
            }
        }
        let count = self.fingers.len();
        let middle = point * Point3::new(0.0, 0.0, self.rules.centre);
        let fits = |&&(other, sum, by): &&(usize, Vector3<f64>, u32)| {
            by.count_ones() as usize == count.min(32)
                && (sum / count as f64 - middle.coords).norm() <= self.rules.distance
                && world.body(other).is_some_and(|body| body.mass > 0.0)
                && self.may_be_held(world, other)
        };
        self.candidates.iter().find(fits).map(|(other, ..)| *other)
    }

    fn may_be_held(&self, world: &View<'_>, object: usize) -> bool {
        let name = || world.name(ambf_plugin::ObjectId::new(ObjectType::Body, object)).unwrap_or_default();
        self.rules.only.is_empty() || {
            let name = name();
            self.rules.only.iter().any(|part| name.contains(part.as_str()))
        }
    }
}
