//! Sub-steps of the accurate profile: what was commanded is executed before each.

use crate::bullet::ExpectedTurn;
use crate::control::Profile;
use crate::ids::{BodyId, JointId};
use crate::scene::Scene;

/// Sub-steps in which a jump of set points accelerates joints: the first, and those in which controllers of high gain
/// still correct it.
const JUMP_SUB_STEPS: u32 = 4;

/// Joints and bodies that have something to execute in sub-steps.
#[derive(Debug, Clone, Default)]
pub(super) struct ActiveTargets {
    pub joints: Vec<JointId>,
    pub bodies: Vec<BodyId>,
    /// What the latest jump of set points may cause.
    expected: ExpectedTurn,
}

impl ActiveTargets {
    /// Forgets what is no longer in the scene, and makes place for all that it has, so that commands allocate nothing.
    pub fn follow_scene(&mut self, scene: &Scene) {
        self.joints.retain(|&joint| !scene.joints[joint].removed);
        self.bodies.retain(|&body| !scene.body_is_gone(body));
        if scene.profile == Profile::Accurate {
            self.joints.reserve(scene.joints.len());
        }
        if scene.profile == Profile::Accurate || scene.kinematic_bodies {
            self.bodies.reserve(scene.bodies.len());
        }
    }

    /// Keeps the place that was made.
    pub fn restore(&mut self, saved: &Self) {
        self.joints.clone_from(&saved.joints);
        self.bodies.clone_from(&saved.bodies);
        self.expected = saved.expected;
    }

    /// Forgets everything; the place that was made stays.
    pub fn clear(&mut self) {
        self.joints.clear();
        self.bodies.clear();
        self.forget_jumps();
    }

    /// Forgets jumps of set points, so that what follows a reset does not depend on what was before.
    pub fn forget_jumps(&mut self) {
        self.expected = ExpectedTurn::default();
    }

    fn is_empty(&self) -> bool {
        self.joints.is_empty() && self.bodies.is_empty()
    }

    /// Steps the world of `scene` as [`World::step`](crate::bullet::World::step) does. Returns the sub-steps that were
    /// due.
    pub fn step(&mut self, scene: &mut Scene, interval: f64, cap: u32, length: f64) -> u32 {
        if self.is_empty() {
            return scene.world.step(interval, cap, length);
        }
        let Scene { world, joints, bodies, .. } = scene;
        let mut done = 0;
        let jump: f64 = self.joints.iter().map(|&joint| joints[joint].expected_turn(world, bodies)).sum();
        if self.expected.sub_steps == 0 || jump >= self.expected.turn {
            self.expected = ExpectedTurn { turn: jump, sub_steps: JUMP_SUB_STEPS };
        }
        let due = world.step_with(interval, cap, length, self.expected, |world, sub_step| {
            done += 1;
            for &joint in &self.joints {
                joints[joint].drive(world, bodies, sub_step);
            }
            for &body in &self.bodies {
                bodies[body].drive(world, sub_step);
            }
        });
        self.expected.sub_steps = self.expected.sub_steps.saturating_sub(due.min(cap));
        self.joints.retain(|&joint| joints[joint].end_update(done));
        self.bodies.retain(|&body| bodies[body].end_update(done));
        due
    }
}
