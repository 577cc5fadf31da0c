//! Steps of a world, and the division of sub-steps in which jointed bodies turn fast.

use ambf_dynamics::ffi as sys;

use super::{Solver, World};

/// Largest turn of a jointed body in a sub-step before the sub-step is divided, rad. Rows of joints are linear in the
/// motion: a turn of θ opens a joint by θ²/2 times its lever arm.
const MAX_TURN: f64 = 0.2;
/// Most parts of a sub-step: what they may cost.
const MAX_PARTS: f64 = 4.0;

/// A sub-step, or one of its parts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SubStep {
    /// Length, s.
    pub length: f64,
    /// Time since the beginning of the step, s.
    pub start: f64,
    /// Length of the whole sub-step, s.
    pub whole: f64,
    /// Length of all sub-steps of the step, s.
    pub duration: f64,
}

impl SubStep {
    /// Whether the step begins with it.
    pub fn is_first(&self) -> bool {
        self.start == 0.0
    }
}

impl World {
    /// Advances by `interval` s in sub-steps of `sub_step` s, at most `max_sub_steps` of them. Returns how many were
    /// due; those above `max_sub_steps` are lost. A remainder is kept for the next call. Applied forces are cleared.
    ///
    /// With [`Solver::Accurate`] a sub-step in which a jointed body would turn by more than 0.2 rad is divided into up to
    /// four parts. Joints of articulations do not count, as their free motion is divided by itself, and worlds with
    /// soft bodies never divide: the stiffness of cloth depends on the length of a sub-step.
    pub fn step(&mut self, interval: f64, max_sub_steps: u32, sub_step: f64) -> u32 {
        if self.divides() {
            return self.step_with(interval, max_sub_steps, sub_step, |_, _| ());
        }
        let _arena = self.enter();
        let cap = max_sub_steps.clamp(1, i32::MAX as u32) as i32;
        // SAFETY: the world and everything in it are alive.
        unsafe { sys::amb_world_step(self.raw.as_ptr(), interval, cap, sub_step) }.max(0) as u32
    }

    /// As [`step`](Self::step); `before` is called before each sub-step or part of one.
    pub fn step_with(
        &mut self,
        interval: f64,
        max_sub_steps: u32,
        sub_step: f64,
        mut before: impl FnMut(&mut Self, SubStep),
    ) -> u32 {
        let _arena = self.enter();
        let cap = max_sub_steps.clamp(1, i32::MAX as u32);
        // SAFETY: the world and everything in it are alive.
        let due = unsafe { sys::amb_world_begin_step(self.raw.as_ptr(), interval, cap as i32, sub_step) }.max(0) as u32;
        let count = due.min(cap);
        let duration = f64::from(count) * sub_step;
        for index in 0..count {
            let parts = self.parts_of(sub_step);
            let length = sub_step / f64::from(parts);
            for part in 0..parts {
                let start = f64::from(index) * sub_step + f64::from(part) * length;
                before(self, SubStep { length, start, whole: sub_step, duration });
                // SAFETY: as above.
                unsafe { sys::amb_world_advance(self.raw.as_ptr(), length, sub_step) }
            }
        }
        // SAFETY: as above.
        unsafe { sys::amb_world_finish_step(self.raw.as_ptr()) }
        due
    }

    fn divides(&self) -> bool {
        self.solver == Solver::Accurate && !self.has_soft_bodies
    }

    /// Parts of the sub-step of this length, s, that follows.
    fn parts_of(&mut self, sub_step: f64) -> u32 {
        if !self.divides() {
            return 1;
        }
        // SAFETY: the world and everything in it are alive.
        let turn = unsafe { sys::amb_world_jointed_turn_rate(self.raw.as_ptr()) } * sub_step;
        // A turn that is not a number is left for the check of the state.
        if turn.is_nan() || turn <= MAX_TURN {
            return 1;
        }
        // SAFETY: as above.
        unsafe { sys::amb_world_count_division(self.raw.as_ptr()) }
        (turn / MAX_TURN).ceil().min(MAX_PARTS) as u32
    }
}
