use std::ptr::NonNull;

use ambf_dynamics::ffi as sys;
use nalgebra::{Isometry3, Vector3};
use slotmap::Key;

use crate::adf::CollisionFilter;

use super::{pose_of, raw_pose, ArticulationHandle, BodyHandle, BodyKinematics, Shape, World};

/// What of a body its contacts see.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodySurface {
    /// Coefficient of friction.
    pub friction: f64,
    /// Coefficient of rolling friction.
    pub rolling_friction: f64,
    /// Coefficient of restitution.
    pub restitution: f64,
}

/// Description of a rigid body. Bodies sleep only after [`World::enable_sleeping`].
#[derive(Debug)]
pub struct RigidBody {
    /// Mass, kg; 0: static.
    pub mass: f64,
    /// Principal moments of inertia about the axes of the inertial frame, kg·m²; 0: infinite, no rotation about that
    /// axis.
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
    /// Share of the linear velocity lost in 1 s.
    pub linear_damping: f64,
    /// Share of the angular velocity lost in 1 s.
    pub angular_damping: f64,
    /// Acceleration instead of the world's gravity, m/s².
    pub gravity: Option<Vector3<f64>>,
}

pub(super) struct OwnedBody {
    raw: NonNull<sys::AmbBody>,
    /// Owned because the body refers to it; freed after the body.
    shape: Shape,
    /// Index in the world's lists of bodies.
    index: usize,
    /// Number of constraints and vehicles that refer to the body.
    pub(super) constraint_count: usize,
    pub(super) dynamic: bool,
    /// The articulation of which the body is a link. A fixed base is not a link.
    pub(super) articulation: Option<ArticulationHandle>,
}

/// Bounds of plausible states. A body beyond them got there by a numerical error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlausibleBounds {
    /// Largest speed, m/s, and angular speed, rad/s. Default: 3e8, the speed of light.
    pub speed: f64,
    /// Largest distance of a centre of mass from the origin, m. Default: 1e15, where a number of double precision
    /// resolves 0.1 m.
    pub distance: f64,
}

impl Default for PlausibleBounds {
    fn default() -> Self {
        Self { speed: 3e8, distance: 1e15 }
    }
}

/// What keeps a body from colliding with others for good, at no cost for each pair.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Apart<'a> {
    /// Bodies of one family never collide with each other. Default: 0, none.
    pub family: u32,
    /// Two bodies that are both in groups collide if they share one; a body in none collides with all. Default: none.
    pub groups: &'a [u32],
    /// The number of a model, above 0, and which of its bodies this one collides with. Default: none, with all.
    pub filter: Option<(u32, &'a CollisionFilter)>,
}

impl OwnedBody {
    /// The shape, which the body refers to.
    pub(super) fn shape(&self) -> *mut sys::AmbShape {
        self.shape.raw()
    }
}

impl World {
    /// Adds a body at the end of [`bodies`](Self::bodies).
    pub fn add_body(&mut self, body: RigidBody) -> BodyHandle {
        self.add_body_at(self.body_list.len(), body)
    }

    /// Adds a body at an index of [`bodies`](Self::bodies) whose body was removed, or at the end.
    ///
    /// # Panics
    /// If there is a body at the index, or the list ends before it.
    pub fn add_body_at(&mut self, index: usize, body: RigidBody) -> BodyHandle {
        self.add_body_apart(index, body, Apart::default())
    }

    /// The same of a body that never collides with some others.
    ///
    /// # Panics
    /// If there is a body at the index, or the list ends before it.
    pub fn add_body_apart(&mut self, index: usize, body: RigidBody, apart: Apart<'_>) -> BodyHandle {
        let mut groups = apart.groups.to_vec();
        groups.sort_unstable();
        let sorted = |mut list: Vec<u32>| {
            list.sort_unstable();
            list
        };
        let excluded = sorted(apart.filter.map_or(Vec::new(), |(_, filter)| filter.excluded.clone()));
        let included = sorted(apart.filter.map_or(Vec::new(), |(_, filter)| filter.included.clone()));
        let is_free = self.body_list.get(index).map_or(index == self.body_list.len(), |raw| raw.is_null());
        assert!(is_free, "index {index} of {} is not free", self.body_list.len());
        let _arena = self.enter();
        self.structure += 1;
        // SAFETY: the shape is alive and stays so with the body; numbers are read before the call returns.
        let raw = unsafe {
            sys::amb_body_new(body.mass, body.inertia.as_ptr(), body.shape.raw(), raw_pose(&body.pose).as_ptr())
        };
        let raw = NonNull::new(raw).expect("operator new throws rather than return null");
        // SAFETY: the body is alive; the groups are copied.
        unsafe {
            sys::amb_body_set_surface(raw.as_ptr(), body.friction, body.rolling_friction, body.restitution);
            sys::amb_body_set_damping(raw.as_ptr(), body.linear_damping, body.angular_damping);
            sys::amb_body_set_apart(raw.as_ptr(), apart.family, groups.as_ptr(), groups.len() as i32);
            if let Some((model, filter)) = apart.filter {
                let CollisionFilter { kind, affinity, member, cluster, outer, excluded: _, included: _ } = *filter;
                // Clusters count from 1 there.
                let (cluster, outer) = (cluster + 1, outer.map_or(0, |outer| outer + 1));
                sys::amb_body_set_filter(
                    raw.as_ptr(),
                    model,
                    member,
                    cluster,
                    outer,
                    kind,
                    affinity,
                    excluded.as_ptr(),
                    excluded.len() as i32,
                    included.as_ptr(),
                    included.len() as i32,
                );
            }
        }
        let handle = self.bodies.insert(OwnedBody {
            raw,
            shape: body.shape,
            index,
            constraint_count: 0,
            dynamic: body.mass != 0.0,
            articulation: None,
        });
        // SAFETY: body and world are alive; the world removes the body before it frees it.
        unsafe {
            sys::amb_world_add_body(self.raw.as_ptr(), raw.as_ptr(), handle.data().as_ffi());
            if let Some(gravity) = &body.gravity {
                sys::amb_body_set_gravity(raw.as_ptr(), gravity.as_ptr());
            }
        }
        if index == self.body_list.len() {
            self.body_list.push(raw.as_ptr());
            self.body_order.push(handle);
        } else {
            (self.body_list[index], self.body_order[index]) = (raw.as_ptr(), handle);
        }
        handle
    }

    /// Removes a body and the anchors of soft bodies on it. The indices of other bodies in [`bodies`](Self::bodies) do
    /// not change. False when the handle is stale, or a constraint or vehicle still refers to the body.
    pub fn remove_body(&mut self, handle: BodyHandle) -> bool {
        let _arena = self.enter();
        if self.bodies.get(handle).is_none_or(|body| body.constraint_count > 0) {
            return false;
        }
        let Some(body) = self.bodies.remove(handle) else { return false };
        self.structure += 1;
        self.body_list[body.index] = std::ptr::null_mut();
        self.volumes.retain(|_, part| part.body != handle);
        // SAFETY: the body is in this world, no constraint or vehicle refers to it, removing it drops anchors, and no
        // pointer to it is left after this.
        unsafe {
            sys::amb_world_remove_body(self.raw.as_ptr(), body.raw.as_ptr());
            sys::amb_body_free(body.raw.as_ptr());
        }
        true
    }

    /// Makes a body visual-only: static, at rest, without collisions, ignored by ray casts. Only
    /// [`set_pose`](Self::set_pose) moves it. Anchors of soft bodies on it are removed. False when the handle is stale,
    /// or a constraint or vehicle refers to the body.
    pub fn make_visual_only(&mut self, handle: BodyHandle) -> bool {
        let _arena = self.enter();
        let Some(body) = self.bodies.get_mut(handle).filter(|body| body.constraint_count == 0) else { return false };
        body.dynamic = false;
        self.structure += 1;
        // SAFETY: the body is alive and in this world.
        unsafe { sys::amb_world_make_visual_only(self.raw.as_ptr(), body.raw.as_ptr()) }
        true
    }

    /// Enables continuous collision detection for a body, with which it stops at the first impact within a sub-step
    /// instead of passing through thin obstacles; default: `false`. A sphere inside the body, about its centre of mass,
    /// is swept in sub-steps in which the centre of mass moves further than the radius; a slower body causes no cost.
    /// The body keeps its velocity, and the next sub-step finds the contact.
    ///
    /// False when there is no such sphere: the shape is concave or empty, or the centre of mass is outside.
    ///
    /// ## Limitations
    /// Rotation and the part of the body outside of the sphere are not swept. Links of articulations are not swept.
    /// Soft bodies are no obstacles.
    pub fn set_continuous(&mut self, handle: BodyHandle, enabled: bool) -> bool {
        let Some(body) = self.raw_body(handle) else { return false };
        // SAFETY: world, body and its shape are alive.
        unsafe { sys::amb_world_set_continuous(self.raw.as_ptr(), body, enabled.into()) != 0 }
    }

    /// Disables collisions between two bodies from now on. The test takes constant time, however many such pairs there
    /// are; for many bodies see [`Apart`].
    pub fn ignore_collision(&mut self, a: BodyHandle, b: BodyHandle) {
        let _arena = self.enter();
        if let (Some(a), Some(b)) = (self.raw_body(a), self.raw_body(b)) {
            // SAFETY: world and bodies are alive.
            unsafe { sys::amb_world_ignore_pair(self.raw.as_ptr(), a, b) }
        }
    }

    /// Handles of all bodies, in the order of [`read_bodies`](Self::read_bodies): that of creation, but for those that
    /// took a free index. The entry of a removed body is its stale handle.
    pub fn bodies(&self) -> &[BodyHandle] {
        &self.body_order
    }

    /// Reads the bodies in the order of [`bodies`](Self::bodies), up to the length of `out`. Entries of removed bodies are not written.
    pub fn read_bodies(&self, out: &mut [BodyKinematics]) {
        let n = out.len().min(self.body_list.len());
        // SAFETY: the list holds live bodies and null only; `BodyKinematics` is 18 doubles in the order the shim
        // writes.
        unsafe { sys::amb_bodies_read(self.body_list.as_ptr(), n as i32, out.as_mut_ptr().cast()) }
    }

    /// Index in [`bodies`](Self::bodies) of the first body whose pose or velocity is not finite or, unless it is
    /// static, beyond `bounds`.
    pub fn first_lost(&self, bounds: &PlausibleBounds) -> Option<usize> {
        let (list, n) = (self.body_list.as_ptr(), self.body_list.len() as i32);
        // SAFETY: the list holds live bodies and null only.
        let index = unsafe { sys::amb_bodies_first_lost(list, n, bounds.speed, bounds.distance) };
        usize::try_from(index).ok()
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

    /// Sets world transform and motion state of the inertial frame; velocities do not change, but for that of a
    /// [moved](Self::move_body) body, which is 0 then. The pose of a link is projected onto the joints of its articulation
    /// in the next step, or when joints are read.
    pub fn set_pose(&mut self, handle: BodyHandle, pose: &Isometry3<f64>) {
        let _arena = self.enter();
        if let Some(body) = self.raw_body(handle) {
            // SAFETY: the body is alive; 12 doubles are read.
            unsafe { sys::amb_body_set_pose(body, raw_pose(pose).as_ptr()) }
        }
    }

    /// Moves a body without mass to a pose of its inertial frame over the next sub-step of `length` s, to be called before it
    /// (in [`step_with`](Self::step_with)): it has the velocity of this motion, at a constant twist, in contacts and joints,
    /// and keeps it until it is moved again, [at rest](Self::rest_body) or its pose is set. No effect on a body with mass.
    pub fn move_body(&mut self, handle: BodyHandle, to: &Isometry3<f64>, length: f64) {
        let _arena = self.enter();
        let (Some(from), Some(body)) = (self.pose(handle), self.raw_body(handle)) else { return };
        let linear = (to.translation.vector - from.translation.vector) / length;
        let angular = (to.rotation * from.rotation.inverse()).scaled_axis() / length;
        let velocity: [f64; 6] = std::array::from_fn(|i| if i < 3 { linear[i] } else { angular[i - 3] });
        // SAFETY: the body is alive; 12 and 6 doubles are read.
        unsafe { sys::amb_body_move(body, raw_pose(to).as_ptr(), velocity.as_ptr()) }
    }

    /// Ends the motion of a [moved](Self::move_body) body.
    pub fn rest_body(&mut self, handle: BodyHandle) {
        if let Some(body) = self.raw_body(handle) {
            // SAFETY: the body is alive.
            unsafe { sys::amb_body_rest(body) }
        }
    }

    /// Linear (m/s, of the centre of mass) and angular (rad/s) velocity, world axes.
    pub fn velocity(&self, handle: BodyHandle) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let mut raw = [0.0; 6];
        // SAFETY: the body is alive; 6 doubles are written.
        unsafe { sys::amb_body_velocity(self.raw_body(handle)?, raw.as_mut_ptr()) }
        Some((Vector3::from_column_slice(&raw[..3]), Vector3::from_column_slice(&raw[3..])))
    }

    /// Sets linear (m/s) and angular velocity (rad/s), world axes. The next step projects the velocities of all links
    /// of an articulation onto its joints, with the least kinetic energy of the difference.
    pub fn set_velocity(&mut self, handle: BodyHandle, linear: &Vector3<f64>, angular: &Vector3<f64>) {
        if let Some(body) = self.raw_body(handle) {
            // SAFETY: the body is alive; twice three doubles are read.
            unsafe { sys::amb_body_set_velocity(body, linear.as_ptr(), angular.as_ptr()) }
        }
    }

    /// Adds a force (N) at the centre of mass and a torque (N·m), world axes, for the next step. No effect on static
    /// bodies.
    pub fn apply_wrench(&mut self, handle: BodyHandle, force: &Vector3<f64>, torque: &Vector3<f64>) {
        if let Some(body) = self.raw_body(handle) {
            // SAFETY: the body is alive; twice three doubles are read.
            unsafe { sys::amb_body_apply_wrench(body, force.as_ptr(), torque.as_ptr()) }
        }
    }

    /// Clears the forces applied since the last step.
    pub fn clear_forces(&mut self, handle: BodyHandle) {
        if let Some(body) = self.raw_body(handle) {
            // SAFETY: the body is alive.
            unsafe { sys::amb_body_clear_forces(body) }
        }
    }

    /// Puts a body at a pose (true pose of the inertial frame) at rest, with its own gravity (m/s²) or else the world's, and
    /// lets it forget what acted on it. To be followed by [`recover`](Self::recover).
    pub fn reset_body(&mut self, handle: BodyHandle, pose: &Isometry3<f64>, gravity: Option<&Vector3<f64>>) {
        let _arena = self.enter();
        if let Some(body) = self.raw_body(handle) {
            let gravity = gravity.map_or(std::ptr::null(), |gravity| gravity.as_ptr());
            // SAFETY: the body is alive; 12 doubles are read, and three or null.
            unsafe { sys::amb_body_reset(body, raw_pose(pose).as_ptr(), gravity) }
        }
    }

    /// Sets the mass, kg, above 0, and the principal moments of inertia, kg·m², of a dynamic body; velocities stay. False for
    /// static bodies and stale handles.
    pub fn set_mass(&mut self, handle: BodyHandle, mass: f64, inertia: &Vector3<f64>) -> bool {
        let _arena = self.enter();
        let Some(body) = self.raw_body(handle).filter(|_| self.bodies[handle].dynamic && mass > 0.0) else {
            return false;
        };
        // SAFETY: the body is alive; three doubles are read.
        unsafe { sys::amb_body_set_mass(body, mass, inertia.as_ptr()) }
        true
    }

    /// Sets the surface of a body, also for contacts that are there already.
    pub fn set_surface(&mut self, handle: BodyHandle, surface: &BodySurface) {
        let BodySurface { friction, rolling_friction, restitution } = *surface;
        if let Some(body) = self.raw_body(handle) {
            // SAFETY: the body is alive.
            unsafe { sys::amb_body_set_surface(body, friction, rolling_friction, restitution) }
        }
    }

    /// Sets the shares of the linear and the angular velocity of a body that are lost in 1 s.
    pub fn set_damping(&mut self, handle: BodyHandle, [linear, angular]: [f64; 2]) {
        if let Some(body) = self.raw_body(handle) {
            // SAFETY: the body is alive.
            unsafe { sys::amb_body_set_damping(body, linear, angular) }
        }
    }

    /// Sets the gravity of one body, m/s².
    pub fn set_body_gravity(&mut self, handle: BodyHandle, gravity: &Vector3<f64>) {
        if let Some(body) = self.raw_body(handle) {
            // SAFETY: the body is alive; three doubles are read.
            unsafe { sys::amb_body_set_gravity(body, gravity.as_ptr()) }
        }
    }

    pub(super) fn raw_body(&self, handle: BodyHandle) -> Option<*mut sys::AmbBody> {
        Some(self.bodies.get(handle)?.raw.as_ptr())
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use nalgebra::{Translation3, UnitQuaternion};

    use super::super::tests::{ball, hinge};
    use super::super::{BodyDrive, Constraint, ConstraintKind, Solver};
    use super::*;

    #[test]
    fn a_body_whose_pose_was_set_has_the_inertia_of_that_pose_at_once() {
        // With the other solvers it has that of the pose before for one sub-step, as in plain Bullet.
        for (solver, about) in [(Solver::Accurate, 2.0), (Solver::default(), 1.0)] {
            let mut world = World::new(solver);
            let body = world.add_body(RigidBody { inertia: Vector3::new(1.0, 2.0, 4.0), ..ball(1.0, 0.0) });
            // The second principal axis then points along -x.
            let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), FRAC_PI_2);
            world.set_pose(body, &Isometry3::from_parts(Translation3::identity(), turned));
            world.apply_wrench(body, &Vector3::zeros(), &Vector3::x());
            world.step(0.001, 1, 0.001);
            let (_, angular) = world.velocity(body).unwrap();
            assert!((angular.x - 0.001 / about).abs() < 1e-9, "{solver:?}: {angular}");
        }
    }

    #[test]
    fn a_body_that_is_not_finite_is_found() {
        let mut world = World::new(Solver::default());
        let _ = world.add_body(ball(1.0, 0.0));
        let second = world.add_body(ball(1.0, 1.0));
        let bounds = PlausibleBounds::default();
        assert_eq!(world.first_lost(&bounds), None);
        world.set_velocity(second, &Vector3::new(f64::NAN, 0.0, 0.0), &Vector3::zeros());
        assert_eq!(world.first_lost(&bounds), Some(1));
    }

    #[test]
    fn a_body_beyond_the_bounds_is_found_unless_it_is_static() {
        let mut world = World::new(Solver::default());
        let ground = world.add_body(ball(0.0, 0.0));
        let moving = world.add_body(ball(1.0, 1.0));
        let bounds = PlausibleBounds { speed: 10.0, distance: 100.0 };
        let far = Isometry3::translation(101.0, 0.0, 0.0);
        world.set_pose(ground, &far);
        assert_eq!(world.first_lost(&bounds), None);
        world.set_velocity(moving, &Vector3::new(8.0, 0.0, 5.0), &Vector3::zeros());
        assert_eq!(world.first_lost(&bounds), None);
        for (linear, angular) in [(10.1, 0.0), (0.0, 10.1)] {
            world.set_velocity(moving, &Vector3::repeat(linear), &Vector3::repeat(angular));
            assert_eq!(world.first_lost(&bounds), Some(1));
        }
        world.set_velocity(moving, &Vector3::zeros(), &Vector3::zeros());
        world.set_pose(moving, &far);
        assert_eq!(world.first_lost(&bounds), Some(1));
    }

    #[test]
    fn a_body_can_take_the_index_of_one_that_was_removed() {
        let mut world = World::new(Solver::default());
        let [first, second] = [0.0, 1.0].map(|z| world.add_body(ball(1.0, z)));
        assert!(world.remove_body(first));
        let third = world.add_body_at(0, ball(1.0, 2.0));
        assert_eq!(world.bodies(), [third, second]);
        assert!(world.pose(first).is_none(), "the old handle does not lead to the new body");
        let mut states = [BodyKinematics::default(); 2];
        world.read_bodies(&mut states);
        assert_eq!(states.map(|state| state.origin[0]), [2.0, 1.0]);
        world.set_velocity(third, &Vector3::new(f64::NAN, 0.0, 0.0), &Vector3::zeros());
        assert_eq!(world.first_lost(&PlausibleBounds::default()), Some(0));
    }

    #[test]
    #[should_panic(expected = "index 0 of 1 is not free")]
    fn the_index_of_a_body_is_not_free() {
        let mut world = World::new(Solver::default());
        world.add_body(ball(1.0, 0.0));
        world.add_body_at(0, ball(1.0, 1.0));
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

    /// Each of n bodies at one point had a pair with each other one, as had those without extent, and a bit for it: 1000
    /// took 8 s and 10 000 gigabytes. Up to 1000 bodies plain Bullet's pairs are kept.
    #[test]
    fn bodies_that_are_apart_and_shapes_without_extent_have_no_pairs() {
        for (solver, others) in [(Solver::default(), 1000), (Solver::Accurate, 0)] {
            let mut world = World::new(solver);
            (0..others).for_each(|i| {
                world.add_body(ball(1.0, 10.0 + f64::from(i)));
            });
            let mut add = |count: usize, shape: fn() -> Shape, family: u32, groups: &[u32]| {
                for _ in 0..count {
                    let index = world.bodies().len();
                    let body = RigidBody { shape: shape(), ..ball(1.0, 0.0) };
                    world.add_body_apart(index, body, Apart { family, groups, ..Apart::default() });
                }
                world.pair_count()
            };
            let sphere = || Shape::sphere(0.1, 0.01);
            assert_eq!(add(20, sphere, 1, &[]), 0, "of one family");
            assert_eq!(add(20, Shape::empty, 0, &[]), 0, "without extent");
            assert_eq!(add(5, sphere, 2, &[3, 1]), 100, "with those of another family");
            assert_eq!(add(5, sphere, 2, &[2, 4]), 200, "in groups, but of one family");
            assert_eq!(add(1, sphere, 0, &[4, 0]), 225, "in a group of one half of the others");
        }
    }

    #[test]
    fn what_is_apart_falls_through_each_other_and_meets_others() {
        let mut world = World::new(Solver::default());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        let plane = || Shape::plane(Vector3::z(), -0.2, 0.0);
        let grouped = |groups: &'static [u32]| Apart { groups, ..Apart::default() };
        world.add_body_apart(0, RigidBody { shape: plane(), ..ball(0.0, 0.0) }, grouped(&[1, 2]));
        let at = |x: f64| RigidBody { pose: Isometry3::translation(x, 0.0, 0.0), ..ball(1.0, 0.0) };
        let stays = world.add_body_apart(1, at(0.0), grouped(&[7, 2]));
        let falls = world.add_body_apart(2, at(1.0), grouped(&[3]));
        let free = world.add_body(at(2.0));
        for _ in 0..1000 {
            world.step(0.001, 1, 0.001);
        }
        let height = |body| world.pose(body).unwrap().translation.z;
        assert!((height(stays) + 0.1).abs() < 0.01 && (height(free) + 0.1).abs() < 0.01 && height(falls) < -4.0);
    }

    #[test]
    fn filters_say_which_bodies_of_a_model_collide() {
        let filter = |kind, affinity, member, cluster, outer, excluded: &[u32]| CollisionFilter {
            kind,
            affinity,
            member,
            cluster,
            outer,
            excluded: excluded.to_vec(),
            included: vec![],
        };
        let all = |member, cluster, outer| filter(1, 1, member, cluster, outer, &[]);
        let including = |filter, included: &[u32]| CollisionFilter { included: included.to_vec(), ..filter };
        for (a, b, collide) in [
            (all(1, 1, None), all(2, 2, None), true),
            (all(1, 1, None), all(2, 1, None), false),
            (all(1, 1, None), all(2, 2, Some(1)), false),
            (all(1, 0, None), all(2, 2, None), true),
            (filter(2, 1, 1, 1, None, &[]), filter(1, 4, 2, 2, None, &[]), true),
            (filter(2, 4, 1, 1, None, &[]), filter(1, 1, 2, 2, None, &[]), false),
            (filter(1, 1, 1, 1, None, &[9, 2]), filter(1, 1, 2, 2, None, &[1]), false),
            (
                including(filter(1, 0, 1, 1, None, &[]), &[9, 2]),
                including(filter(1, 0, 2, 2, Some(1), &[1]), &[1]),
                true,
            ),
            (including(filter(1, 0, 1, 1, None, &[]), &[9, 2]), filter(1, 0, 2, 2, None, &[]), false),
        ] {
            for (model, swapped) in [(1, false), (1, true), (2, false)] {
                let mut world = World::new(Solver::default());
                let (first, second) = if swapped { (&b, &a) } else { (&a, &b) };
                let apart = |filter| Apart { filter: Some(filter), ..Apart::default() };
                world.add_body_apart(0, ball(1.0, 0.0), apart((1, first)));
                world.add_body_apart(1, ball(1.0, 0.05), apart((model, second)));
                world.step(0.001, 1, 0.001);
                let expected = collide || model == 2;
                assert_eq!(world.contact_count() > 0, expected, "{first:?} {second:?} {model}");
            }
        }
    }

    /// Bullet looked at all pairs to remove those of one object, and at all bodies and constraints to remove one.
    #[test]
    fn pairs_are_those_of_the_objects_that_are_left() {
        let mut world = World::new(Solver::default());
        let bodies: Vec<_> = (0..30).map(|i| world.add_body(ball(1.0, 0.001 * f64::from(i)))).collect();
        assert_eq!(world.pair_count(), 30 * 29 / 2);
        for (count, &body) in bodies.iter().enumerate().filter(|(i, _)| i % 3 != 1) {
            assert!(world.remove_body(body), "{count}");
        }
        assert_eq!(world.pair_count(), 10 * 9 / 2);
        world.step(0.001, 1, 0.001);
        bodies.iter().for_each(|&body| {
            world.remove_body(body);
        });
        assert_eq!(world.pair_count(), 0);
    }

    /// A ball of 5 mm radius flies from 0.53 m before a wall in the plane x = 0 at it, `angle` rad from straight, with
    /// restitution `e`: how far its centre gets, and its velocity along x after 20 ms.
    fn shot_at(wall: Shape, speed: f64, e: f64, angle: f64, continuous: bool) -> (f64, f64) {
        let mut world = World::new(Solver::default());
        let restitution = e;
        world.add_body(RigidBody { shape: wall, restitution, friction: 0.0, ..ball(0.0, 0.0) });
        let start = Isometry3::translation(-0.53, 0.0, 0.0);
        let shape = Shape::sphere(0.005, 0.001);
        let shot = world.add_body(RigidBody { shape, pose: start, restitution, friction: 0.0, ..ball(0.01, 0.0) });
        assert!(world.set_continuous(shot, continuous) == continuous);
        world.set_velocity(shot, &(speed * Vector3::new(angle.cos(), angle.sin(), 0.0)), &Vector3::zeros());
        let mut furthest = f64::NEG_INFINITY;
        for _ in 0..20 {
            world.step(0.001, 1, 0.001);
            furthest = furthest.max(world.pose(shot).unwrap().translation.x);
        }
        (furthest, world.velocity(shot).unwrap().0.x)
    }

    fn shot_at_wall(speed: f64, e: f64, angle: f64, continuous: bool) -> (f64, f64) {
        let slab = Shape::cuboid(Vector3::new(0.0005, 1.0, 1.0), 0.0001);
        shot_at(slab, speed, e, angle, continuous)
    }

    #[test]
    fn every_kind_of_wall_stops_a_fast_ball() {
        let sheet = [[0.0, -1.0, -1.0], [0.0, 1.0, -1.0], [0.0, 1.0, 1.0], [0.0, -1.0, 1.0]];
        let faces = [[0, 1, 2], [0, 2, 3]];
        let slab = || Shape::cuboid(Vector3::new(0.0005, 0.5, 0.5), 0.0001);
        let walls = [
            Shape::plane(-Vector3::x(), 0.0, 0.0),
            Shape::concave_mesh(&sheet, &faces, 0.001).unwrap(),
            Shape::compound([(slab(), Isometry3::translation(0.0, 0.3, 0.0)), (slab(), Isometry3::identity())]),
        ];
        for (i, wall) in walls.into_iter().enumerate() {
            let (furthest, after) = shot_at(wall, 100.0, 0.0, 0.1, true);
            assert!(furthest < -0.003 && after.abs() < 0.5, "wall {i}: to {furthest} m, then {after} m/s");
        }
    }

    #[test]
    fn a_fast_ball_does_not_pass_a_thin_wall() {
        let speeds = [31.0, 63.7, 100.0, 1000.0];
        assert!(speeds.iter().any(|&speed| shot_at_wall(speed, 0.0, 0.1, false).0 > 0.0), "else nothing is shown");
        for speed in speeds {
            let (furthest, after) = shot_at_wall(speed, 0.0, 0.1, true);
            assert!(furthest < -0.004 && after.abs() < 0.2, "{speed} m/s: to {furthest} m, then {after} m/s");
            let (furthest, after) = shot_at_wall(speed, 1.0, 0.1, true);
            let expected = -speed * 0.1_f64.cos();
            // Faster by what pushes the small overlap apart.
            assert!(furthest < -0.004 && (after - expected).abs() < 0.2, "{speed}: {furthest}, {after}, {expected}");
        }
    }

    #[test]
    fn fast_bodies_meet_each_other() {
        let mut world = World::new(Solver::default());
        let mut shot = |x: f64, y: f64| {
            let shape = Shape::sphere(0.005, 0.001);
            let pose = Isometry3::translation(x, y, 0.0);
            let handle = world.add_body(RigidBody { shape, pose, restitution: 1.0, friction: 0.0, ..ball(0.01, 0.0) });
            world.set_continuous(handle, true);
            world.set_velocity(handle, &Vector3::new(-100.0 * x.signum(), 0.0, 0.0), &Vector3::zeros());
            handle
        };
        let (left, right) = (shot(-0.53, 0.0), shot(0.53, 0.002));
        for _ in 0..10 {
            world.step(0.001, 1, 0.001);
        }
        let x = |handle| world.velocity(handle).unwrap().0.x;
        assert!(x(left) < -50.0 && x(right) > 50.0, "{} {}", x(left), x(right));
    }

    #[test]
    fn what_flies_together_stays_together() {
        // Two balls that approach each other at 20 m/s on a common flight at 100 m/s.
        let mut world = World::new(Solver::default());
        let mut fly = |y: f64, vy: f64| {
            let shape = Shape::sphere(0.005, 0.001);
            let pose = Isometry3::translation(0.0, y, 0.0);
            let handle = world.add_body(RigidBody { shape, pose, restitution: 0.0, friction: 0.0, ..ball(0.01, 0.0) });
            world.set_continuous(handle, true);
            world.set_velocity(handle, &Vector3::new(100.0, vy, 0.0), &Vector3::zeros());
            handle
        };
        let flying = [fly(-0.1, 10.0), fly(0.1, -10.0)];
        for _ in 0..30 {
            world.step(0.001, 1, 0.001);
        }
        let [a, b] = flying.map(|handle| world.pose(handle).unwrap().translation.vector);
        assert!((a.x - 3.0).abs() < 1e-9 && (b.x - 3.0).abs() < 1e-9, "{} m and {} m", a.x, b.x);
        assert!((0.009..0.02).contains(&(b.y - a.y)), "they meet, and neither passes the other: {} m", b.y - a.y);
    }

    #[test]
    fn an_impact_of_one_body_does_not_open_its_joints() {
        // Two balls on a joint fly at a wall one behind the other, which stops the first of them.
        let mut world = World::new(Solver::Accurate);
        let slab = Shape::cuboid(Vector3::new(0.0005, 1.0, 1.0), 0.0001);
        world.add_body(RigidBody { shape: slab, restitution: 0.0, friction: 0.0, ..ball(0.0, 0.0) });
        let mut fly = |x: f64| {
            let shape = Shape::sphere(0.005, 0.001);
            let pose = Isometry3::translation(x, 0.0, 0.0);
            let handle = world.add_body(RigidBody { shape, pose, restitution: 0.0, friction: 0.0, ..ball(0.01, 0.0) });
            world.set_continuous(handle, true);
            world.set_velocity(handle, &Vector3::new(100.0, 0.0, 0.0), &Vector3::zeros());
            handle
        };
        let [first, second] = [fly(-0.45), fly(-0.475)];
        let arm = Isometry3::translation(-0.0125, 0.0, 0.0);
        let joint = Constraint {
            kind: ConstraintKind::PointToPoint,
            frame_a: arm,
            frame_b: arm.inverse(),
            parameters: vec![],
            ..hinge()
        };
        world.add_constraint(first, second, &joint).unwrap();
        // The rows that drive a body have no second body.
        let driven = world.add_body(RigidBody { pose: Isometry3::translation(0.0, 9.0, 0.0), ..ball(1.0, 0.0) });
        world.set_body_drive(driven, Some(&BodyDrive { velocity: [Vector3::zeros(); 2], softness: [1.0; 2] }));
        let pivot = |world: &World, handle, frame: &Isometry3<f64>| {
            world.pose(handle).unwrap() * nalgebra::Point3::from(frame.translation.vector)
        };
        let mut widest: f64 = 0.0;
        for _ in 0..8 {
            world.step(0.001, 1, 0.001);
            let gap = pivot(&world, first, &joint.frame_a) - pivot(&world, second, &joint.frame_b);
            widest = widest.max(gap.norm());
        }
        assert!(world.pose(first).unwrap().translation.x < 0.0, "it met the wall");
        assert!(widest < 1e-3, "a joint opened by {widest} m");
    }

    #[test]
    fn a_fast_slide_is_not_held_up() {
        let mut world = World::new(Solver::default());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.01, 0.0), friction: 0.0, ..ball(0.0, 0.0) });
        let shape = Shape::cuboid(Vector3::repeat(0.01), 0.001);
        let puck = world.add_body(RigidBody { shape, friction: 0.0, ..ball(0.1, 0.0) });
        assert!(world.set_continuous(puck, true));
        world.set_velocity(puck, &Vector3::new(200.0, 0.0, 0.0), &Vector3::zeros());
        for _ in 0..100 {
            world.step(0.001, 1, 0.001);
        }
        let position = world.pose(puck).unwrap().translation;
        assert!((position.x - 20.0).abs() < 0.01 && position.z.abs() < 0.001, "{position}");
    }

    #[test]
    fn what_has_no_inside_is_not_swept() {
        let mut world = World::new(Solver::default());
        let empty = world.add_body(RigidBody { shape: Shape::empty(), ..ball(1.0, 0.0) });
        assert!(!world.set_continuous(empty, true));
        assert!(world.remove_body(empty) && !world.set_continuous(empty, true));
    }

    #[test]
    fn a_visual_only_body_is_moved_by_its_pose_only() {
        let mut world = World::new(Solver::default());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        let visual = world.add_body(ball(1.0, 0.0));
        let falling = world.add_body(RigidBody { pose: Isometry3::translation(0.0, 0.0, 1.0), ..ball(1.0, 0.0) });
        world.set_velocity(visual, &Vector3::x(), &Vector3::x());
        assert!(world.make_visual_only(visual));
        for _ in 0..1000 {
            world.step(0.001, 1, 0.001);
        }
        assert_eq!(world.pose(visual), Some(Isometry3::identity()));
        assert_eq!(world.velocity(visual), Some((Vector3::zeros(), Vector3::zeros())));
        assert!(world.pose(falling).unwrap().translation.z < -3.0, "it passed through");
        let put = Isometry3::translation(0.0, 2.0, 0.0);
        world.set_pose(visual, &put);
        world.step(0.001, 1, 0.001);
        assert_eq!((world.pose(visual), world.motion_state(visual)), (Some(put), Some(put)));
        assert!(world.remove_body(visual) && !world.make_visual_only(visual));
    }
}
