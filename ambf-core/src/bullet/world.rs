use std::ptr::NonNull;

use bullet_sys as sys;
use nalgebra::{Isometry3, Vector3};
use slotmap::{new_key_type, SlotMap};

use super::constraint::make;
use super::{pose_of, raw_pose, BodyKinematics, Constraint, ConstraintKind, Integrator, Shape, Solver};

new_key_type! {
    /// Names a body of a [`World`].
    pub struct BodyHandle;
    /// Names a constraint of a [`World`].
    pub struct ConstraintHandle;
}

/// A rigid body to be made. It never sleeps.
#[derive(Debug)]
pub struct RigidBody {
    /// kg; 0: static.
    pub mass: f64,
    /// Principal moments about the axes of the inertial frame, kg·m²; 0: no rotation about that axis.
    pub inertia: Vector3<f64>,
    /// Shape, in the inertial frame.
    pub shape: Shape,
    /// Pose of the inertial frame in the world.
    pub pose: Isometry3<f64>,
    /// Coefficient of friction.
    pub friction: f64,
    /// Coefficient of rolling friction.
    pub rolling_friction: f64,
    /// Coefficient of restitution.
    pub restitution: f64,
    /// Share of linear velocity lost in 1 s.
    pub linear_damping: f64,
    /// Share of angular velocity lost in 1 s.
    pub angular_damping: f64,
    /// Acceleration instead of the world's gravity, m/s².
    pub gravity: Option<Vector3<f64>>,
}

/// Reaction of a joint on its two bodies in the last sub-step: N and N·m, world axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct JointWrench {
    /// Force on A.
    pub force_a: Vector3<f64>,
    /// Torque on A.
    pub torque_a: Vector3<f64>,
    /// Force on B.
    pub force_b: Vector3<f64>,
    /// Torque on B.
    pub torque_b: Vector3<f64>,
}

struct OwnedBody {
    raw: NonNull<sys::AmbBody>,
    /// Kept alive for the body; freed after it.
    _shape: Shape,
    constraints: usize,
}

#[derive(Clone, Copy, PartialEq)]
enum Motor {
    None,
    Hinge,
    Slider,
}

struct OwnedConstraint {
    raw: NonNull<sys::AmbConstraint>,
    bodies: [BodyHandle; 2],
    motor: Motor,
}

/// A Bullet world with the bodies, shapes and constraints in it. SI units, z up by convention only.
pub struct World {
    raw: NonNull<sys::AmbWorld>,
    bodies: SlotMap<BodyHandle, OwnedBody>,
    constraints: SlotMap<ConstraintHandle, OwnedConstraint>,
    /// Bodies in order of creation, for bulk reads; `body_order` names them.
    body_list: Vec<*mut sys::AmbBody>,
    body_order: Vec<BodyHandle>,
    /// Constraints in order of creation with what is read of each.
    constraint_list: Vec<*mut sys::AmbConstraint>,
    constraint_order: Vec<ConstraintHandle>,
    readings: Vec<u8>,
}

// SAFETY: Bullet's objects have no thread affinity, the world owns all objects it refers to, and it is not `Sync`: whoever holds it
// is the only thread that calls into them.
unsafe impl Send for World {}

impl Drop for World {
    fn drop(&mut self) {
        for handle in self.constraints.keys().collect::<Vec<_>>() {
            self.remove_constraint(handle);
        }
        for handle in self.bodies.keys().collect::<Vec<_>>() {
            self.remove_body(handle);
        }
        // SAFETY: made in `new`, freed once, here; nothing is left in it.
        unsafe { sys::amb_world_free(self.raw.as_ptr()) }
    }
}

impl World {
    /// An empty world without gravity.
    pub fn new(solver: Solver) -> Self {
        // SAFETY: a number that the enum of the shim has.
        let raw = unsafe { sys::amb_world_new(solver as i32) };
        let mut world = Self {
            raw: NonNull::new(raw).expect("operator new throws rather than return null"),
            bodies: SlotMap::with_key(),
            constraints: SlotMap::with_key(),
            body_list: Vec::new(),
            body_order: Vec::new(),
            constraint_list: Vec::new(),
            constraint_order: Vec::new(),
            readings: Vec::new(),
        };
        world.set_gravity(Vector3::zeros());
        world
    }

    /// Sets gravity, m/s², also of all dynamic bodies in the world.
    pub fn set_gravity(&mut self, gravity: Vector3<f64>) {
        // SAFETY: the world is alive; three doubles are read.
        unsafe { sys::amb_world_set_gravity(self.raw.as_ptr(), gravity.as_ptr()) }
    }

    /// Sets the number of iterations of the solver. Default: 10.
    pub fn set_iterations(&mut self, iterations: u32) {
        // SAFETY: the world is alive.
        unsafe { sys::amb_world_set_iterations(self.raw.as_ptr(), iterations.min(100_000) as i32) }
    }

    /// Sets the error reduction of joints without their own (`erp`) and of contacts (`erp2`). Default: 0.2 each.
    pub fn set_error_reduction(&mut self, erp: f64, erp2: f64) {
        // SAFETY: the world is alive.
        unsafe { sys::amb_world_set_erp(self.raw.as_ptr(), erp, erp2) }
    }

    /// Chooses how free bodies are moved.
    pub fn set_integrator(&mut self, integrator: Integrator) {
        // SAFETY: the world is alive and stays where it is: it is the callback's user pointer.
        unsafe { sys::amb_world_set_ballistic(self.raw.as_ptr(), (integrator == Integrator::Ballistic).into()) }
    }

    /// Whether motion states lag up to a sub-step behind the poses. Default: `true`.
    pub fn set_lag(&mut self, lag: bool) {
        // SAFETY: the world is alive.
        unsafe { sys::amb_world_set_lag(self.raw.as_ptr(), lag.into()) }
    }

    /// Adds a body.
    pub fn add_body(&mut self, body: RigidBody) -> BodyHandle {
        // SAFETY: the shape is alive and stays so with the body; numbers are read before the call returns.
        let raw = unsafe {
            sys::amb_body_new(body.mass, body.inertia.as_ptr(), body.shape.raw(), raw_pose(&body.pose).as_ptr())
        };
        let raw = NonNull::new(raw).expect("operator new throws rather than return null");
        // SAFETY: body and world are alive; the world removes the body before it frees it.
        unsafe {
            sys::amb_body_set_surface(raw.as_ptr(), body.friction, body.rolling_friction, body.restitution);
            sys::amb_body_set_damping(raw.as_ptr(), body.linear_damping, body.angular_damping);
            sys::amb_world_add_body(self.raw.as_ptr(), raw.as_ptr());
            if let Some(gravity) = &body.gravity {
                sys::amb_body_set_gravity(raw.as_ptr(), gravity.as_ptr());
            }
        }
        let handle = self.bodies.insert(OwnedBody { raw, _shape: body.shape, constraints: 0 });
        self.body_list.push(raw.as_ptr());
        self.body_order.push(handle);
        handle
    }

    /// Removes a body. False when it is not there or a constraint still holds it.
    pub fn remove_body(&mut self, handle: BodyHandle) -> bool {
        if self.bodies.get(handle).is_none_or(|body| body.constraints > 0) {
            return false;
        }
        let Some(body) = self.bodies.remove(handle) else { return false };
        self.body_list.retain(|&raw| raw != body.raw.as_ptr());
        self.body_order.retain(|&other| other != handle);
        // SAFETY: the body is in this world, no constraint refers to it, and no pointer to it is left after this.
        unsafe {
            sys::amb_world_remove_body(self.raw.as_ptr(), body.raw.as_ptr());
            sys::amb_body_free(body.raw.as_ptr());
        }
        true
    }

    /// Adds a constraint from `a` to `b`; `None` when one of them is not there or both are the same.
    pub fn add_constraint(
        &mut self,
        a: BodyHandle,
        b: BodyHandle,
        constraint: &Constraint,
    ) -> Option<ConstraintHandle> {
        if a == b {
            return None;
        }
        let (raw_a, raw_b) = (self.raw_body(a)?, self.raw_body(b)?);
        // SAFETY: both bodies are alive and different, and outlive the constraint: `remove_body` refuses while it exists.
        let raw = unsafe { make(raw_a, raw_b, constraint) };
        let raw = NonNull::new(raw).expect("operator new throws rather than return null");
        // SAFETY: constraint and world are alive; the constraint is removed from the world before it is freed.
        unsafe {
            for &(parameter, value, axis) in &constraint.parameters {
                sys::amb_constraint_set_param(raw.as_ptr(), parameter as i32, value, axis);
            }
            sys::amb_world_add_constraint(self.raw.as_ptr(), raw.as_ptr(), constraint.disable_collisions.into());
            if constraint.feedback {
                sys::amb_constraint_enable_feedback(raw.as_ptr());
            }
        }
        for handle in [a, b] {
            self.bodies[handle].constraints += 1;
        }
        let motor = match constraint.kind {
            ConstraintKind::Hinge { .. } => Motor::Hinge,
            ConstraintKind::Slider { .. } => Motor::Slider,
            _ => Motor::None,
        };
        self.constraint_list.push(raw.as_ptr());
        self.readings.push(constraint.kind.reading());
        let handle = self.constraints.insert(OwnedConstraint { raw, bodies: [a, b], motor });
        self.constraint_order.push(handle);
        Some(handle)
    }

    /// Removes a constraint; false when it is not there.
    pub fn remove_constraint(&mut self, handle: ConstraintHandle) -> bool {
        let Some(constraint) = self.constraints.remove(handle) else { return false };
        for body in constraint.bodies {
            self.bodies[body].constraints -= 1;
        }
        if let Some(place) = self.constraint_list.iter().position(|&raw| raw == constraint.raw.as_ptr()) {
            self.constraint_list.remove(place);
            self.constraint_order.remove(place);
            self.readings.remove(place);
        }
        // SAFETY: the constraint is in this world, and no pointer to it is left after this.
        unsafe {
            sys::amb_world_remove_constraint(self.raw.as_ptr(), constraint.raw.as_ptr());
            sys::amb_constraint_free(constraint.raw.as_ptr());
        }
        true
    }

    /// The two bodies never collide from now on. Found in constant time, however many such pairs there are.
    pub fn ignore_collision(&mut self, a: BodyHandle, b: BodyHandle) {
        if let (Some(a), Some(b)) = (self.raw_body(a), self.raw_body(b)) {
            // SAFETY: world and bodies are alive.
            unsafe { sys::amb_world_ignore_pair(self.raw.as_ptr(), a, b) }
        }
    }

    /// Advances by `interval` s in sub-steps of `sub_step` s, at most `max_sub_steps` of them. Returns how many were due; those
    /// above `max_sub_steps` are lost. A remainder is kept for the next call. Applied forces are cleared.
    pub fn step(&mut self, interval: f64, max_sub_steps: u32, sub_step: f64) -> u32 {
        let cap = max_sub_steps.clamp(1, i32::MAX as u32) as i32;
        // SAFETY: the world and everything in it are alive.
        unsafe { sys::amb_world_step(self.raw.as_ptr(), interval, cap, sub_step) }.max(0) as u32
    }

    /// Forgets contacts and what the solver starts from, and revives bodies that Bullet switched off because their state was not finite.
    /// To be called after poses and velocities were set back to finite values.
    pub fn recover(&mut self) {
        // SAFETY: the world and everything in it are alive.
        unsafe { sys::amb_world_recover(self.raw.as_ptr()) }
    }

    /// Handles of all constraints in order of creation: the order of [`read_constraints`](Self::read_constraints).
    pub fn constraints(&self) -> &[ConstraintHandle] {
        &self.constraint_order
    }

    /// Contact points after the last sub-step.
    pub fn contact_count(&self) -> usize {
        // SAFETY: the world is alive.
        unsafe { sys::amb_world_contact_count(self.raw.as_ptr()) }.max(0) as usize
    }

    /// Handles of all bodies in order of creation: the order of [`read_bodies`](Self::read_bodies).
    pub fn bodies(&self) -> &[BodyHandle] {
        &self.body_order
    }

    /// Reads all bodies in order of creation, as many as `out` has place for.
    pub fn read_bodies(&self, out: &mut [BodyKinematics]) {
        let n = out.len().min(self.body_list.len());
        // SAFETY: the list holds live bodies only; `BodyKinematics` is 18 doubles in the order the shim writes.
        unsafe { sys::amb_bodies_read(self.body_list.as_ptr(), n as i32, out.as_mut_ptr().cast()) }
    }

    /// The first body whose pose or velocity is not finite, as its place in [`bodies`](Self::bodies).
    pub fn first_non_finite(&self) -> Option<usize> {
        // SAFETY: the list holds live bodies only.
        let index = unsafe { sys::amb_bodies_first_non_finite(self.body_list.as_ptr(), self.body_list.len() as i32) };
        usize::try_from(index).ok()
    }

    /// Reads the position of all constraints in order of creation, as many as `out` has place for: angle of a hinge (rad),
    /// position of a slider (m), of a spring on z (m or rad), 0 for others.
    pub fn read_constraints(&self, out: &mut [f64]) {
        let n = out.len().min(self.constraint_list.len());
        // SAFETY: the lists are of the same length, hold live constraints only, and each reading fits the constraint's type.
        unsafe {
            sys::amb_constraints_read(
                self.constraint_list.as_ptr(),
                self.readings.as_ptr(),
                n as i32,
                out.as_mut_ptr(),
            );
        }
    }

    /// Brings what [`read_constraints`](Self::read_constraints) gives up to the present poses: the position of a slider is otherwise that
    /// of the last solver pass. For use after poses were set.
    pub fn refresh_constraints(&mut self) {
        // SAFETY: the list holds live constraints only, whose bodies are alive.
        unsafe { sys::amb_constraints_refresh(self.constraint_list.as_ptr(), self.constraint_list.len() as i32) }
    }

    /// Switches the motor of a hinge (velocity in rad/s, `max` the largest impulse a sub-step, N·m·s) or slider (m/s, largest force,
    /// N). False for other constraints.
    pub fn set_motor(&mut self, handle: ConstraintHandle, enabled: bool, velocity: f64, max: f64) -> bool {
        let Some(constraint) = self.constraints.get(handle) else { return false };
        let raw = constraint.raw.as_ptr();
        // SAFETY: the constraint is alive and of the type that the call casts it to.
        unsafe {
            match constraint.motor {
                Motor::Hinge => sys::amb_hinge_set_motor(raw, enabled.into(), velocity, max),
                Motor::Slider => sys::amb_slider_set_motor(raw, enabled.into(), velocity, max),
                Motor::None => return false,
            }
        }
        true
    }

    /// Reaction of a joint with feedback in the last sub-step; zero without feedback.
    pub fn joint_wrench(&self, handle: ConstraintHandle) -> Option<JointWrench> {
        let mut out = [0.0; 12];
        // SAFETY: the constraint is alive; 12 doubles are written.
        unsafe { sys::amb_constraint_feedback(self.constraints.get(handle)?.raw.as_ptr(), out.as_mut_ptr()) }
        let vector = |i: usize| Vector3::from_column_slice(&out[i..i + 3]);
        Some(JointWrench { force_a: vector(0), torque_a: vector(3), force_b: vector(6), torque_b: vector(9) })
    }

    /// True pose of the inertial frame in the world, not interpolated.
    pub fn pose(&self, handle: BodyHandle) -> Option<Isometry3<f64>> {
        let mut raw = [0.0; 12];
        // SAFETY: the body is alive; 12 doubles are written.
        unsafe { sys::amb_body_pose(self.raw_body(handle)?, raw.as_mut_ptr()) }
        Some(pose_of(&raw))
    }

    /// Pose of the inertial frame from the motion state: up to one sub-step old.
    pub fn motion_state(&self, handle: BodyHandle) -> Option<Isometry3<f64>> {
        let mut raw = [0.0; 12];
        // SAFETY: the body is alive; 12 doubles are written.
        unsafe { sys::amb_body_motion_state(self.raw_body(handle)?, raw.as_mut_ptr()) }
        Some(pose_of(&raw))
    }

    /// Sets world transform and motion state of the inertial frame; velocities stay.
    pub fn set_pose(&mut self, handle: BodyHandle, pose: &Isometry3<f64>) {
        if let Some(body) = self.raw_body(handle) {
            // SAFETY: the body is alive; 12 doubles are read.
            unsafe { sys::amb_body_set_pose(body, raw_pose(pose).as_ptr()) }
        }
    }

    /// Linear (m/s, of the centre of mass) and angular (rad/s) velocity, world axes.
    pub fn velocity(&self, handle: BodyHandle) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let mut raw = [0.0; 6];
        // SAFETY: the body is alive; 6 doubles are written.
        unsafe { sys::amb_body_velocity(self.raw_body(handle)?, raw.as_mut_ptr()) }
        Some((Vector3::from_column_slice(&raw[..3]), Vector3::from_column_slice(&raw[3..])))
    }

    /// Sets linear and angular velocity, world axes.
    pub fn set_velocity(&mut self, handle: BodyHandle, linear: &Vector3<f64>, angular: &Vector3<f64>) {
        if let Some(body) = self.raw_body(handle) {
            // SAFETY: the body is alive; twice three doubles are read.
            unsafe { sys::amb_body_set_velocity(body, linear.as_ptr(), angular.as_ptr()) }
        }
    }

    /// Adds a force (N) at the centre of mass and a torque (N·m), world axes, for the next step. No effect on static bodies.
    pub fn apply_wrench(&mut self, handle: BodyHandle, force: &Vector3<f64>, torque: &Vector3<f64>) {
        if let Some(body) = self.raw_body(handle) {
            // SAFETY: the body is alive; twice three doubles are read.
            unsafe { sys::amb_body_apply_wrench(body, force.as_ptr(), torque.as_ptr()) }
        }
    }

    /// Forgets the forces applied since the last step.
    pub fn clear_forces(&mut self, handle: BodyHandle) {
        if let Some(body) = self.raw_body(handle) {
            // SAFETY: the body is alive.
            unsafe { sys::amb_body_clear_forces(body) }
        }
    }

    /// Sets the gravity of one body, m/s².
    pub fn set_body_gravity(&mut self, handle: BodyHandle, gravity: &Vector3<f64>) {
        if let Some(body) = self.raw_body(handle) {
            // SAFETY: the body is alive; three doubles are read.
            unsafe { sys::amb_body_set_gravity(body, gravity.as_ptr()) }
        }
    }

    fn raw_body(&self, handle: BodyHandle) -> Option<*mut sys::AmbBody> {
        Some(self.bodies.get(handle)?.raw.as_ptr())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ball(mass: f64, x: f64) -> RigidBody {
        RigidBody {
            mass,
            inertia: Vector3::repeat(0.004 * mass),
            shape: Shape::sphere(0.1, 0.001),
            pose: Isometry3::translation(x, 0.0, 0.0),
            friction: 0.5,
            rolling_friction: 0.0,
            restitution: 0.0,
            linear_damping: 0.0,
            angular_damping: 0.0,
            gravity: None,
        }
    }

    fn hinge() -> Constraint {
        Constraint {
            kind: ConstraintKind::Hinge { limits: None },
            frame_a: Isometry3::identity(),
            frame_b: Isometry3::translation(-1.0, 0.0, 0.0),
            parameters: vec![],
            feedback: true,
            disable_collisions: true,
        }
    }

    #[test]
    fn bullet_is_the_double_precision_build() {
        // SAFETY: takes nothing.
        assert_eq!(unsafe { sys::amb_scalar_size() }, 8);
    }

    #[test]
    fn a_ball_falls_and_its_motion_state_lags_one_step() {
        let mut world = World::new(Solver::default());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        let handle = world.add_body(ball(1.0, 0.0));
        for _ in 0..100 {
            assert_eq!(world.step(0.001, 10, 0.001), 1);
        }
        // Semi-implicit Euler: z = -g dt² k (k+1) / 2.
        let z = |k: f64| -10.0 * 1e-6 * k * (k + 1.0) / 2.0;
        assert!((world.pose(handle).unwrap().translation.z - z(100.0)).abs() < 1e-12);
        let mut states = [BodyKinematics::default()];
        world.read_bodies(&mut states);
        assert!((states[0].origin[2] - z(99.0)).abs() < 1e-12);
        assert!((states[0].linear_velocity[2] + 1.0).abs() < 1e-12);
    }

    #[test]
    fn ballistic_flight_is_exact_and_contact_ends_it() {
        let mut world = World::new(Solver::default());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        world.set_integrator(Integrator::Ballistic);
        world.set_lag(false);
        world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -2.0, 0.0), ..ball(0.0, 0.0) });
        let handle = world.add_body(ball(1.0, 0.0));
        world.set_velocity(handle, &Vector3::new(1.0, 0.0, 2.0), &Vector3::zeros());
        for _ in 0..500 {
            world.step(0.001, 1, 0.001);
        }
        let expected = Vector3::new(0.5, 0.0, 2.0 * 0.5 - 5.0 * 0.25);
        assert!((world.pose(handle).unwrap().translation.vector - expected).norm() < 1e-12);
        assert_eq!(world.pose(handle), world.motion_state(handle), "no lag");
        for _ in 0..2000 {
            world.step(0.001, 1, 0.001);
        }
        assert!((world.pose(handle).unwrap().translation.z + 1.9).abs() < 1e-3, "it rests on the plane");
    }

    #[test]
    fn sub_steps_above_the_cap_are_reported() {
        let mut world = World::new(Solver::default());
        assert_eq!(world.step(0.0256, 10, 0.001), 25);
        assert_eq!(world.step(0.0005, 10, 0.001), 1, "the remainder was kept");
    }

    #[test]
    fn stale_handles_do_nothing() {
        let mut world = World::new(Solver::default());
        let (a, b) = (world.add_body(ball(0.0, 0.0)), world.add_body(ball(1.0, 1.0)));
        let joint = world.add_constraint(a, b, &hinge()).unwrap();
        assert!(!world.remove_body(b), "a joint holds it");
        assert!(world.remove_constraint(joint));
        assert!(!world.remove_constraint(joint));
        assert!(!world.set_motor(joint, true, 1.0, 1.0));
        assert!(world.joint_wrench(joint).is_none());
        assert!(world.remove_body(b));
        assert!(world.pose(b).is_none());
        world.apply_wrench(b, &Vector3::x(), &Vector3::x());
        assert!(world.add_constraint(a, b, &hinge()).is_none());
        assert!(world.add_constraint(a, a, &hinge()).is_none());
        world.step(0.001, 1, 0.001);
    }

    #[test]
    fn a_motor_turns_its_hinge_and_feedback_carries_the_weight() {
        let mut world = World::new(Solver::default());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        let (a, b) = (world.add_body(ball(0.0, 0.0)), world.add_body(ball(2.0, 1.0)));
        let joint = world.add_constraint(a, b, &hinge()).unwrap();
        world.set_motor(joint, true, 1.0, 10.0);
        for _ in 0..500 {
            world.step(0.001, 1, 0.001);
        }
        let mut angle = [0.0];
        world.read_constraints(&mut angle);
        assert!((angle[0] - 0.5).abs() < 0.01, "{}", angle[0]);
        let wrench = world.joint_wrench(joint).unwrap();
        assert!((wrench.force_b.z - 20.0).abs() < 0.1, "{wrench:?}");
    }

    #[test]
    fn ignored_pairs_fall_through_each_other() {
        let drop_onto_plane = |ignore: bool| {
            let mut world = World::new(Solver::default());
            world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
            let plane = world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.2, 0.0), ..ball(0.0, 0.0) });
            let falling = world.add_body(ball(1.0, 0.0));
            if ignore {
                world.ignore_collision(plane, falling);
            }
            for _ in 0..1000 {
                world.step(0.001, 1, 0.001);
            }
            world.pose(falling).unwrap().translation.z
        };
        assert!((drop_onto_plane(false) + 0.1).abs() < 0.01);
        assert!(drop_onto_plane(true) < -4.0);
    }

    #[test]
    fn a_body_that_is_not_finite_is_found() {
        let mut world = World::new(Solver::default());
        let _ = world.add_body(ball(1.0, 0.0));
        let second = world.add_body(ball(1.0, 1.0));
        assert_eq!(world.first_non_finite(), None);
        world.set_velocity(second, &Vector3::new(f64::NAN, 0.0, 0.0), &Vector3::zeros());
        assert_eq!(world.first_non_finite(), Some(1));
    }

    #[test]
    fn a_lost_body_recovers() {
        let mut world = World::new(Solver::default());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.1, 0.0), ..ball(0.0, 0.0) });
        let lost = world.add_body(ball(1.0, 0.0));
        for _ in 0..10 {
            world.step(0.001, 1, 0.001);
        }
        world.set_velocity(lost, &Vector3::repeat(f64::NAN), &Vector3::zeros());
        for _ in 0..3 {
            world.step(0.001, 1, 0.001);
        }
        assert_eq!(world.first_non_finite(), Some(1));
        world.set_velocity(lost, &Vector3::zeros(), &Vector3::zeros());
        world.set_pose(lost, &Isometry3::identity());
        world.recover();
        for _ in 0..500 {
            world.step(0.001, 1, 0.001);
        }
        assert_eq!(world.first_non_finite(), None);
        assert!(world.pose(lost).unwrap().translation.z.abs() < 0.01, "it rests on the plane again");
    }

    #[test]
    fn every_solver_holds_a_pendulum() {
        for (name, solver) in Solver::NAMES {
            let mut world = World::new(solver);
            world.set_gravity(Vector3::new(0.0, -10.0, 0.0));
            let (a, b) = (world.add_body(ball(0.0, 0.0)), world.add_body(ball(1.0, 1.0)));
            world.add_constraint(a, b, &hinge()).unwrap();
            for _ in 0..300 {
                world.step(0.001, 1, 0.001);
            }
            let distance = world.pose(b).unwrap().translation.vector.norm();
            assert!((distance - 1.0).abs() < 1e-3, "{name}: {distance}");
            assert_eq!(Solver::from_name(name), Some(solver));
        }
    }
}
