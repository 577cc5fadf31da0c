//! Soft motors of joints and drives of bodies as rows of the constraint solver. They are implicit: they act on the
//! velocity at the end of a sub-step and cannot overshoot it.

use ambf_dynamics::ffi as sys;
use nalgebra::Vector3;

use super::constraint::Motor;
use super::{BodyHandle, ConstraintHandle, World};

/// A row of the constraint solver that drives the coordinate q of a hinge (rad) or slider (m): `q̇ = velocity −
/// softness · impulse`, with an impulse within ± `max_force` h in a sub-step of h s.
///
/// Without softness it is a velocity motor. [`spring`](crate::control::spring) gives the values for a spring with
/// damper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SoftMotor {
    /// Target rate at the end of the sub-step, rad/s or m/s.
    pub velocity: f64,
    /// Change of the rate per impulse (compliance), rad/s per N·m·s or m/s per N·s; not negative.
    pub softness: f64,
    /// Largest force, N·m or N.
    pub max_force: f64,
}

/// What resists the motion of a hinge or slider, as rows of the constraint solver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resistance {
    /// Viscous damping, N·m·s/rad or N·s/m, not negative: effort = −damping · rate.
    pub damping: f64,
    /// Inertia of the rotor, kg·m² or kg, not negative: effort = −armature · acceleration.
    pub armature: f64,
    /// Dry friction, N·m or N, not negative: the largest effort against the motion.
    pub friction: f64,
    /// Largest rate, rad/s or m/s: whatever effort keeps it. Infinite: unbounded.
    pub max_rate: f64,
}

/// Rows of the constraint solver that drive the centre of mass of a body, world axes: each component of the velocity is
/// that of `velocity` less `softness` times its impulse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyDrive {
    /// Linear, m/s, and angular, rad/s, at the end of the sub-step.
    pub velocity: [Vector3<f64>; 2],
    /// Softness of the linear rows, 1/kg, and of the angular rows, 1/(kg·m²); not negative.
    pub softness: [f64; 2],
}

impl World {
    /// Enables the soft motor of a hinge or slider instead of its Bullet motor; `None` disables it. The motor has no
    /// impulse towards a limit that is reached. False for other constraints.
    pub fn set_soft_motor(&mut self, handle: ConstraintHandle, drive: Option<SoftMotor>) -> bool {
        let _arena = self.enter();
        let Some(raw) = self.raw_constraint(handle) else { return false };
        // SAFETY: the constraint is alive.
        unsafe {
            match drive {
                Some(SoftMotor { velocity, softness, max_force }) => {
                    sys::amb_constraint_set_soft_motor(raw, velocity, softness, max_force) != 0
                }
                None => {
                    sys::amb_constraint_clear_soft_motor(raw);
                    true
                }
            }
        }
    }

    /// Sets what resists the motion of a hinge or slider. An [articulation](Self::articulate) that has no place for damping of
    /// the joint is made anew, which forgets contacts of its bodies.
    pub fn set_resistance(&mut self, handle: ConstraintHandle, resistance: Resistance) {
        let Some(raw) = self.raw_constraint(handle) else { return };
        let Resistance { damping, armature, friction, max_rate } = resistance;
        let has_place = {
            let _arena = self.enter();
            // SAFETY: the constraint is alive.
            unsafe { sys::amb_constraint_set_resistance(raw, damping, armature, friction, max_rate) != 0 }
        };
        if !has_place {
            self.articulate_anew(handle);
        }
    }

    /// Sets the limits of a hinge (rad) or slider (m) at which it is held; `None`: unlimited. False for other constraints.
    pub fn set_limits(&mut self, handle: ConstraintHandle, limits: Option<[f64; 2]>) -> bool {
        let _arena = self.enter();
        let (Some(raw), Some(motor)) = (self.raw_constraint(handle), self.motor_of(handle)) else { return false };
        // For both, a lower limit above the upper one stands for none.
        let [low, high] = limits.unwrap_or([1.0, -1.0]);
        // SAFETY: the constraint is alive, and of the type that the function casts to.
        unsafe {
            match motor {
                Motor::Hinge => sys::amb_hinge_set_limit(raw, low, high),
                Motor::Slider => sys::amb_slider_set_limit(raw, low, high),
                Motor::None => return false,
            }
        }
        true
    }

    /// Coordinate of a hinge (rad, within π of the middle of its limits, without them of 0) or slider (m), and its rate,
    /// from the present poses and velocities. `None` for other constraints.
    pub fn coordinate(&self, handle: ConstraintHandle) -> Option<(f64, f64)> {
        let _arena = self.enter();
        let mut out = [0.0; 2];
        // SAFETY: the constraint is alive; two doubles are written.
        let known = unsafe { sys::amb_constraint_coordinate(self.raw_constraint(handle)?, out.as_mut_ptr()) };
        (known != 0).then_some((out[0], out[1]))
    }

    /// Whether a constraint is a joint of an articulation.
    pub fn is_articulated(&self, handle: ConstraintHandle) -> bool {
        self.constraints.get(handle).is_some_and(|constraint| constraint.articulation.is_some())
    }

    /// Drives a dynamic body from now on; `None` ends it. The first call for a body creates its rows. False for static
    /// bodies and stale handles.
    pub fn set_body_drive(&mut self, handle: BodyHandle, drive: Option<&BodyDrive>) -> bool {
        let _arena = self.enter();
        let Some(raw) = self.raw_body(handle).filter(|_| self.bodies[handle].dynamic) else { return false };
        let Some(BodyDrive { velocity: [linear, angular], softness }) = drive else {
            // SAFETY: the body is alive.
            unsafe { sys::amb_body_clear_drive(raw) };
            return true;
        };
        let velocity = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z];
        // SAFETY: world and body are alive; six and two doubles are read.
        unsafe { sys::amb_body_set_drive(self.raw.as_ptr(), raw, velocity.as_ptr(), softness.as_ptr()) }
        true
    }

    /// Sets the velocity of a dynamic body so that it has this one at the end of a sub-step of `dt` s in which only
    /// gravity acts on it.
    pub fn hold_velocity(&mut self, handle: BodyHandle, linear: &Vector3<f64>, angular: &Vector3<f64>, dt: f64) {
        let Some(raw) = self.raw_body(handle).filter(|_| self.bodies[handle].dynamic) else { return };
        // SAFETY: world and body are alive; twice three doubles are read.
        unsafe { sys::amb_body_hold_velocity(self.raw.as_ptr(), raw, linear.as_ptr(), angular.as_ptr(), dt) }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;

    use super::super::tests::{ball, hinge};
    use super::super::{
        BodyKinematics, Constraint, ConstraintKind, ExpectedTurn, Integrator, RigidBody, Shape, Solver,
    };
    use super::*;

    fn falling(lag: bool, soft: bool) -> World {
        let mut world =
            if soft { World::with_soft_bodies(Solver::default()) } else { World::new(Solver::WarmFriction) };
        world.set_gravity(Vector3::new(0.1, 0.0, -10.0));
        world.set_lag(lag);
        if !lag {
            world.set_integrator(Integrator::Ballistic);
        }
        world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.15, 0.0), ..ball(0.0, 0.0) });
        let a = world.add_body(ball(1.0, 0.0));
        world.add_body(ball(1.0, 0.5));
        let b = world.add_body(ball(2.0, 1.5));
        world.add_constraint(a, b, &hinge()).unwrap();
        world
    }

    fn states(world: &World) -> [BodyKinematics; 4] {
        let mut states = [BodyKinematics::default(); 4];
        world.read_bodies(&mut states);
        states
    }

    #[test]
    fn a_step_in_pieces_is_bullets_own_bit_for_bit() {
        // Remainders, no sub-step, more than the cap.
        let intervals = [0.001, 0.0004, 0.0004, 0.0004, 0.0163, 0.002, 0.0501, 0.00099];
        for (lag, soft) in [(true, false), (false, false), (true, true)] {
            let (mut whole, mut pieces) = (falling(lag, soft), falling(lag, soft));
            for interval in intervals.iter().cycle().take(200) {
                let pushed = whole.bodies()[2];
                for world in [&mut whole, &mut pieces] {
                    world.apply_wrench(pushed, &Vector3::new(0.0, 3.0, 0.1), &Vector3::new(0.0, 0.01, 0.2));
                }
                let mut calls = 0;
                let due = pieces.step_with(*interval, 20, 0.001, ExpectedTurn::default(), |_, sub_step| {
                    calls += 1;
                    assert!(sub_step.length == 0.001 && sub_step.duration <= 0.0201, "{sub_step:?}");
                });
                assert_eq!(whole.step(*interval, 20, 0.001), due);
                assert_eq!(calls, due.min(20));
                assert_eq!(states(&whole), states(&pieces));
            }
        }
    }

    /// A ball of 2 kg on a slider along x.
    fn slider(solver: Solver) -> (World, ConstraintHandle) {
        let mut world = World::new(solver);
        let slider = add_slider(&mut world);
        (world, slider)
    }

    fn add_slider(world: &mut World) -> ConstraintHandle {
        let (a, b) = (world.add_body(ball(0.0, 0.0)), world.add_body(ball(2.0, 0.0)));
        let kind = ConstraintKind::Slider { limits: Some([-1.0, 0.25]) };
        let slider = Constraint { kind, frame_b: Isometry3::identity(), parameters: vec![], ..hinge() };
        world.add_constraint(a, b, &slider).unwrap()
    }

    #[test]
    fn every_solver_gives_way_as_the_softness_says() {
        for (name, solver) in Solver::NAMES {
            // Softer and harder than 1/m.
            for softness in [20.0, 0.5, 1e-3] {
                let (mut world, slider) = slider(solver);
                assert!(world.set_soft_motor(slider, Some(SoftMotor { velocity: 0.3, softness, max_force: 1e5 })));
                world.step(0.001, 1, 0.001);
                // v = 0.3 - softness λ with λ = m v.
                let wanted = 0.3 / (1.0 + 2.0 * softness);
                let (x, v) = world.coordinate(slider).unwrap();
                assert!(
                    (v - wanted).abs() < 1e-6 && (x - 0.001 * v).abs() < 1e-12,
                    "{name}, {softness}: {v}, {wanted}"
                );
            }
        }
    }

    #[test]
    fn a_link_gives_way_as_the_softness_says() {
        for softness in [20.0, 0.5, 1e-3] {
            let mut world = World::with_articulations(Solver::default());
            let slider = add_slider(&mut world);
            world.articulate(&[slider]).expect("an articulation");
            world.set_soft_motor(slider, Some(SoftMotor { velocity: 0.3, softness, max_force: f64::INFINITY }));
            world.step(0.001, 1, 0.001);
            let (x, v) = world.coordinate(slider).unwrap();
            let wanted = 0.3 / (1.0 + 2.0 * softness);
            // The way of a link follows from the rates at both ends of the sub-step.
            assert!((v - wanted).abs() < 1e-6 && (x - 0.0005 * v).abs() < 1e-9, "{softness}: {x}, {v}, {wanted}");
        }
    }

    #[test]
    fn impulses_are_bounded_and_limits_are_not_torn_at() {
        let (mut world, slider) = slider(Solver::default());
        let drive = SoftMotor { velocity: 1.0, softness: 0.0, max_force: 10.0 };
        world.set_soft_motor(slider, Some(drive));
        for _ in 0..10 {
            world.step(0.001, 1, 0.001);
        }
        assert!((world.coordinate(slider).unwrap().1 - 10.0 * 0.01 / 2.0).abs() < 1e-9);
        world.set_soft_motor(slider, Some(SoftMotor { max_force: 1e9, ..drive }));
        for _ in 0..1000 {
            world.step(0.001, 1, 0.001);
        }
        let (x, v) = world.coordinate(slider).unwrap();
        assert!((x - 0.25).abs() < 2e-3 && v.abs() < 1e-3, "{x}, {v}");
        world.set_soft_motor(slider, Some(SoftMotor { velocity: -1.0, ..drive }));
        for _ in 0..100 {
            world.step(0.001, 1, 0.001);
        }
        assert!(world.coordinate(slider).unwrap().0 < 0.25, "it comes back");
        let before = world.coordinate(slider).unwrap().1;
        assert!(world.set_soft_motor(slider, None));
        world.step(0.001, 1, 0.001);
        assert!((world.coordinate(slider).unwrap().1 - before).abs() < 1e-9, "nothing drives it");
    }

    #[test]
    fn a_body_is_driven_and_let_go() {
        let mut world = World::new(Solver::default());
        world.set_integrator(Integrator::Ballistic);
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        let body = world.add_body(ball(2.0, 0.0));
        // Springs of softness 1/m: half of the velocity that gravity gives is left.
        let drive = BodyDrive { velocity: [Vector3::zeros(), Vector3::y()], softness: [0.5, 0.0] };
        assert!(world.set_body_drive(body, Some(&drive)));
        world.step(0.001, 1, 0.001);
        let (v, w) = world.velocity(body).unwrap();
        assert!((v.z + 0.005).abs() < 1e-7 && (w.y - 1.0).abs() < 1e-9, "{v} {w}");
        assert!((world.pose(body).unwrap().translation.z - 0.001 * v.z).abs() < 1e-12, "not in free flight");
        assert!(world.set_body_drive(body, None));
        let before = v.z;
        world.step(0.001, 1, 0.001);
        assert!((world.velocity(body).unwrap().0.z - before + 0.01).abs() < 1e-12);
        world.set_body_drive(body, Some(&drive));
        assert!(world.remove_body(body), "its rows go with it");
        assert!(!world.set_body_drive(body, Some(&drive)));
        world.step(0.001, 1, 0.001);
    }

    #[test]
    fn a_held_velocity_is_that_of_the_way() {
        for integrator in [Integrator::Euler, Integrator::Ballistic] {
            let mut world = World::new(Solver::default());
            world.set_integrator(integrator);
            world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
            let body = world.add_body(ball(2.0, 0.0));
            for _ in 0..100 {
                world.hold_velocity(body, &Vector3::x(), &Vector3::z(), 0.001);
                world.step(0.001, 1, 0.001);
            }
            let pose = world.pose(body).unwrap();
            assert!((pose.translation.vector - Vector3::x() * 0.1).norm() < 1e-12, "{integrator:?}: {pose}");
        }
    }
}
