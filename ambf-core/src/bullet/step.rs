//! Steps of a world, and the division of sub-steps in which jointed bodies turn fast.

use ambf_dynamics::ffi as sys;

use super::{Solver, World};

/// Largest turn of a jointed body in a sub-step before the sub-step is divided, rad. Rows of joints are linear in the
/// motion: a turn of θ opens a joint by θ²/2 times its lever arm.
const MAX_TURN: f64 = 0.1;
/// Most parts of a sub-step for the turn of bodies: what they may cost.
const MAX_PARTS: f64 = 16.0;
/// Expected turn from which on a sub-step is divided, rad, and into how many parts. How far the bodies that are driven
/// turn others is not known.
const MAX_EXPECTED_TURN: f64 = 0.05;
const PARTS_FOR_EXPECTED: f64 = 4.0;

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

/// Turn of jointed bodies that is expected for another reason than their velocities, such as a jump of set points.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ExpectedTurn {
    /// In a sub-step, rad.
    pub turn: f64,
    /// Number of sub-steps, from the next on, in which it is expected.
    pub sub_steps: u32,
}

impl World {
    /// Advances by `interval` s in sub-steps of `sub_step` s, at most `max_sub_steps` of them. Returns how many were
    /// due; those above `max_sub_steps` are lost. A remainder is kept for the next call. Applied forces are cleared.
    ///
    /// With [`Solver::Accurate`] a sub-step in which a jointed body would turn by more than 0.1 rad is divided into up to
    /// 16 parts. Joints of articulations do not count, as their free motion is divided by itself, and worlds with
    /// soft bodies never divide: the stiffness of cloth depends on the length of a sub-step.
    pub fn step(&mut self, interval: f64, max_sub_steps: u32, sub_step: f64) -> u32 {
        if self.divides() {
            return self.step_with(interval, max_sub_steps, sub_step, ExpectedTurn::default(), |_, _| ());
        }
        let _arena = self.enter();
        let cap = max_sub_steps.clamp(1, i32::MAX as u32) as i32;
        // SAFETY: the world and everything in it are alive.
        unsafe { sys::amb_world_step(self.raw.as_ptr(), interval, cap, sub_step) }.max(0) as u32
    }

    /// As [`step`](Self::step); `before` is called before each sub-step or part of one. `expected` is a turn for a
    /// reason that `before` brings about.
    pub fn step_with(
        &mut self,
        interval: f64,
        max_sub_steps: u32,
        sub_step: f64,
        expected: ExpectedTurn,
        mut before: impl FnMut(&mut Self, SubStep),
    ) -> u32 {
        let _arena = self.enter();
        let cap = max_sub_steps.clamp(1, i32::MAX as u32);
        // SAFETY: the world and everything in it are alive.
        let due = unsafe { sys::amb_world_begin_step(self.raw.as_ptr(), interval, cap as i32, sub_step) }.max(0) as u32;
        let count = due.min(cap);
        let duration = f64::from(count) * sub_step;
        for index in 0..count {
            let parts = self.parts_of(sub_step, if index < expected.sub_steps { expected.turn } else { 0.0 });
            let length = sub_step / f64::from(parts);
            let mut part = 0;
            while part < parts {
                // SAFETY: as above.
                let is_last = part > 0 && unsafe { sys::amb_world_continue_sub_step(self.raw.as_ptr()) } == 0;
                let count = if is_last { parts - part } else { 1 };
                let start = f64::from(index) * sub_step + f64::from(part) * length;
                let length = length * f64::from(count);
                before(self, SubStep { length, start, whole: sub_step, duration });
                // SAFETY: as above.
                unsafe { sys::amb_world_advance(self.raw.as_ptr(), length, sub_step) }
                part += count;
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
    fn parts_of(&mut self, sub_step: f64, expected_turn: f64) -> u32 {
        if !self.divides() {
            return 1;
        }
        // SAFETY: the world and everything in it are alive.
        let turn = unsafe { sys::amb_world_jointed_turn_rate(self.raw.as_ptr()) } * sub_step;
        // A turn that is not a number is left for the check of the state.
        let parts = if turn > MAX_TURN { (turn / MAX_TURN).ceil() } else { 1.0 };
        let for_expected = if expected_turn > MAX_EXPECTED_TURN { PARTS_FOR_EXPECTED } else { 1.0 };
        let parts = parts.min(MAX_PARTS).max(for_expected) as u32;
        if parts > 1 {
            // SAFETY: as above.
            unsafe { sys::amb_world_count_division(self.raw.as_ptr()) }
        }
        parts
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Vector3};

    use super::super::tests::{ball, hinge};
    use super::super::{BodyHandle, Constraint, ConstraintKind, RigidBody, Shape};
    use super::*;

    const G: f64 = 10.0;
    const DT: f64 = 0.001;

    /// Two balls on a ball joint between them that turn about z together at `rate` rad/s in free fall, and a ball that
    /// rests on the ground.
    fn spinning(mut world: World, rate: f64) -> (World, [BodyHandle; 3]) {
        world.set_gravity(Vector3::new(0.0, 0.0, -G));
        world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), 0.0, 0.0), ..ball(0.0, 0.0) });
        let at = |x: f64, z: f64| RigidBody { pose: Isometry3::translation(x, 0.0, z), ..ball(1.0, 0.0) };
        let [a, b] = [-0.2, 0.2].map(|x| world.add_body(at(x, 50.0)));
        let rests = world.add_body(at(3.0, 0.1));
        let frame = |x: f64| Isometry3::translation(x, 0.0, 0.0);
        let joint = Constraint {
            kind: ConstraintKind::PointToPoint,
            frame_a: frame(0.2),
            frame_b: frame(-0.2),
            parameters: vec![],
            ..hinge()
        };
        world.add_constraint(a, b, &joint).unwrap();
        let spin = Vector3::z() * rate;
        world.set_velocity(a, &Vector3::new(0.0, -0.2 * rate, 0.0), &spin);
        world.set_velocity(b, &Vector3::new(0.0, 0.2 * rate, 0.0), &spin);
        (world, [a, b, rests])
    }

    #[test]
    fn sub_steps_of_jointed_bodies_that_turn_fast_are_divided() {
        // 0.1 rad in a sub-step, and just beyond; 16 parts at most.
        for (rate, parts) in [(99.0, 1), (101.0, 2), (299.0, 3), (1e4, 16)] {
            let (mut world, _) = spinning(World::new(Solver::Accurate), rate);
            let mut lengths = Vec::new();
            assert_eq!(world.step_with(DT, 10, DT, ExpectedTurn::default(), |_, sub_step| lengths.push(sub_step)), 1);
            assert_eq!(lengths.len(), parts, "{rate}");
            for (index, part) in lengths.iter().enumerate() {
                assert!((part.length * parts as f64 - DT).abs() < 1e-15 && part.is_first() == (index == 0), "{part:?}");
                assert!((part.start - index as f64 * part.length).abs() < 1e-15, "{part:?}");
                assert_eq!((part.whole, part.duration), (DT, DT));
            }
            assert_eq!(world.take_statistics().divided_sub_steps, u64::from(parts > 1), "{rate}");
        }
    }

    #[test]
    fn sub_steps_in_which_a_turn_is_expected_are_divided() {
        for (turn, parts) in [(0.0, 1), (0.05, 1), (0.06, 4), (9.0, 4)] {
            let (mut world, _) = spinning(World::new(Solver::Accurate), 0.0);
            let mut starts = Vec::new();
            let expected = ExpectedTurn { turn, sub_steps: 2 };
            assert_eq!(world.step_with(3.0 * DT, 10, DT, expected, |_, sub_step| starts.push(sub_step.start)), 3);
            assert_eq!(starts.len(), 2 * parts + 1, "{turn} rad in the first two of three sub-steps");
            assert!((starts[starts.len() - 1] - 2.0 * DT).abs() < 1e-15, "{starts:?}");
        }
    }

    #[test]
    fn other_worlds_never_divide() {
        let expected = ExpectedTurn { turn: 1.0, sub_steps: 1 };
        for world in [World::new(Solver::SequentialImpulse), World::with_soft_bodies(Solver::Accurate)] {
            let (mut world, _) = spinning(world, 1e3);
            let mut count = 0;
            world.step_with(DT, 10, DT, expected, |_, _| count += 1);
            assert_eq!(count, 1);
        }
    }

    #[test]
    fn division_changes_neither_time_nor_forces() {
        let (mut world, [a, b, rests]) = spinning(World::new(Solver::Accurate), 500.0);
        let (mut contacts, mut fallen) = (Vec::new(), 0.0);
        for step in 0..200 {
            world.step(DT, 10, DT);
            let speeds = [a, b].map(|body| world.velocity(body).unwrap().0.z);
            // Velocities are those of half a sub-step, or half a part, before the poses.
            let lag = (f64::from(step + 1) * DT * G + (speeds[0] + speeds[1]) / 2.0) / G;
            assert!((-1e-9..0.5 * DT + 1e-9).contains(&lag), "{step}: {lag}");
            fallen = 50.0 - (world.pose(a).unwrap().translation.z + world.pose(b).unwrap().translation.z) / 2.0;
            world.contacts(rests, 0.0, &mut contacts);
            let impulse: f64 = contacts.iter().map(|contact| contact.impulse).sum();
            assert!(step < 50 || (impulse - G * DT).abs() < 1e-6, "{step}: {impulse} N·s a sub-step");
        }
        assert!(world.take_statistics().divided_sub_steps > 150, "they turn for the whole time");
        assert!((fallen - G * 0.2 * 0.2 / 2.0).abs() < 1e-9, "{fallen} m");
    }

    #[test]
    fn turns_are_bounded_and_momentum_is_kept() {
        let (mut world, [a, b, _]) = spinning(World::new(Solver::Accurate), 1e5);
        world.set_gravity(Vector3::zeros());
        let common = Vector3::new(1.0, 2.0, 3.0);
        for body in [a, b] {
            let (linear, spin) = world.velocity(body).unwrap();
            world.set_velocity(body, &(linear + common), &spin);
        }
        for _ in 0..20 {
            world.step(DT, 10, DT);
            let [(va, wa), (vb, wb)] = [a, b].map(|body| world.velocity(body).unwrap());
            assert!(((va + vb) / 2.0 - common).norm() < 1e-9, "{va} {vb}");
            let turn = wa.norm().max(wb.norm()) * DT / MAX_PARTS;
            assert!(turn < 0.5 + 1e-9, "{turn} rad in a part");
            let pivot = |body, x| world.pose(body).unwrap() * nalgebra::Point3::new(x, 0.0, 0.0);
            let gap = (pivot(a, 0.2) - pivot(b, -0.2)).norm();
            assert!(gap < 0.2 * 0.5 * 0.5, "{gap} m, more than the square of the turn, of both bodies, opens");
        }
        // A turn about the line through the pivots opens nothing.
        let (mut world, [a, b, _]) = spinning(World::new(Solver::Accurate), 0.0);
        world.set_gravity(Vector3::zeros());
        for body in [a, b] {
            world.set_velocity(body, &Vector3::zeros(), &(Vector3::x() * 1e4));
        }
        world.step(DT, 10, DT);
        assert!((world.velocity(a).unwrap().1.x - 1e4).abs() < 1.0, "{}", world.velocity(a).unwrap().1);
    }
}
