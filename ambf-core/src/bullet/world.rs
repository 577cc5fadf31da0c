use std::cell::RefCell;
use std::ptr::NonNull;

use ambf_dynamics::ffi as sys;
use nalgebra::Vector3;
use slotmap::{new_key_type, SlotMap};

use super::arena::{Arena, ArenaGuard};
use super::articulation::OwnedArticulation;
use super::body::OwnedBody;
use super::constraint::OwnedConstraint;
use super::coupling::OwnedCoupling;
use super::ghost::OwnedGhost;
use super::soft_world::OwnedSoftBody;
use super::vehicle::OwnedVehicle;
use super::volume::VolumePart;
use super::{Integrator, Solver};

new_key_type! {
    /// Names a body of a [`World`].
    pub struct BodyHandle;
    /// Names a constraint of a [`World`].
    pub struct ConstraintHandle;
    /// Names a ghost of a [`World`].
    pub struct GhostHandle;
    /// Names a vehicle of a [`World`].
    pub struct VehicleHandle;
    /// Names a soft body of a [`World`].
    pub struct SoftBodyHandle;
    /// Names an articulation of a [`World`].
    pub struct ArticulationHandle;
    /// Names a volume that is part of a body of a [`World`].
    pub struct VolumePartHandle;
}

/// Address space of the arena of a world that can be saved, bytes: a hundred times the memory of the largest scenes.
const MAX_ARENA_BYTES: u64 = 4 << 30;

/// A Bullet world with all that is in it. SI units, z up by convention only.
pub struct World {
    pub(super) raw: NonNull<sys::AmbWorld>,
    pub(super) has_soft_bodies: bool,
    pub(super) solver: Solver,
    pub(super) integrator: Integrator,
    pub(super) has_articulations: bool,
    pub(super) articulations: SlotMap<ArticulationHandle, OwnedArticulation>,
    /// Constraints of the articulations that were made, in that order: also of those that other constraints have
    /// dissolved since.
    pub(super) trees: Vec<Vec<ConstraintHandle>>,
    pub(super) bodies: SlotMap<BodyHandle, OwnedBody>,
    pub(super) constraints: SlotMap<ConstraintHandle, OwnedConstraint>,
    pub(super) couplings: Vec<OwnedCoupling>,
    pub(super) ghosts: SlotMap<GhostHandle, OwnedGhost>,
    pub(super) vehicles: SlotMap<VehicleHandle, OwnedVehicle>,
    pub(super) soft_bodies: SlotMap<SoftBodyHandle, OwnedSoftBody>,
    /// Those of removed bodies are gone.
    pub(super) volumes: SlotMap<VolumePartHandle, VolumePart>,
    /// Bodies for bulk reads; `body_order` names them. A removed body leaves null until another takes its index.
    pub(super) body_list: Vec<*mut sys::AmbBody>,
    pub(super) body_order: Vec<BodyHandle>,
    /// Constraints in order of creation, and the kind of reading of each. A removed constraint leaves null.
    pub(super) constraint_list: Vec<*mut sys::AmbConstraint>,
    pub(super) constraint_order: Vec<ConstraintHandle>,
    pub(super) readings: Vec<u8>,
    /// Indices of removed constraints in these lists.
    pub(super) free_indices: Vec<usize>,
    /// Buffers for the results of queries, kept between calls.
    pub(super) scratch: RefCell<Scratch>,
    /// Number of additions and removals of bodies, soft bodies, ghosts and vehicles.
    pub(super) structure: u64,
    /// Memory of all objects of the shim, the engine and Bullet, if the world can be saved. Dropped after everything in
    /// it.
    pub(super) arena: Option<Arena>,
}

/// Kinds of objects that a world can have beside rigid bodies and their constraints.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WorldKind {
    /// None: [`World::new`].
    Rigid,
    /// [`World::with_soft_bodies`].
    Soft,
    /// [`World::with_articulations`].
    Articulated,
}

/// Results of queries as the shim writes them.
#[derive(Default)]
pub(super) struct Scratch {
    pub(super) contacts: Vec<sys::AmbContact>,
    pub(super) overlaps: Vec<sys::AmbHandle>,
}

// SAFETY: Bullet's objects have no thread affinity, the world owns all objects it refers to, and it is not `Sync`:
// whoever holds it is the only thread that calls into them.
unsafe impl Send for World {}

impl Drop for World {
    fn drop(&mut self) {
        let _arena = self.enter();
        for handle in self.vehicles.keys().collect::<Vec<_>>() {
            self.remove_vehicle(handle);
        }
        for handle in self.constraints.keys().collect::<Vec<_>>() {
            self.remove_constraint(handle);
        }
        for handle in self.soft_bodies.keys().collect::<Vec<_>>() {
            self.remove_soft_body(handle);
        }
        for handle in self.ghosts.keys().collect::<Vec<_>>() {
            self.remove_ghost(handle);
        }
        for handle in self.bodies.keys().collect::<Vec<_>>() {
            self.remove_body(handle);
        }
        // SAFETY: made in `make`, freed once, here; nothing is left in it.
        unsafe { sys::amb_world_free(self.raw.as_ptr()) }
    }
}

impl World {
    /// Contact manifolds for which a world has memory from the start, where no other number is given.
    pub const MANIFOLDS: u16 = 1024;

    /// An empty world without gravity, for rigid bodies.
    pub fn new(solver: Solver) -> Self {
        Self::with_room(solver, WorldKind::Rigid, Self::MANIFOLDS)
    }

    /// An empty world without gravity, for rigid and soft bodies. Rigid bodies that meet no soft body move as in a
    /// plain world, bit for bit.
    pub fn with_soft_bodies(solver: Solver) -> Self {
        Self::with_room(solver, WorldKind::Soft, Self::MANIFOLDS)
    }

    /// An empty world without gravity, for rigid bodies whose constraints may be [articulated](Self::articulate).
    /// Contacts have two directions of friction.
    pub fn with_articulations(solver: Solver) -> Self {
        Self::with_room(solver, WorldKind::Articulated, Self::MANIFOLDS)
    }

    /// An empty world without gravity with memory for a number of contact manifolds, 1.7 kB each, which is taken at
    /// once. Further manifolds, of pairs of bodies that come close, are allocated one by one during a step.
    pub fn with_room(solver: Solver, kind: WorldKind, manifolds: u16) -> Self {
        Self::make(solver, kind, manifolds, None)
    }

    /// An empty world whose state can be saved; its motion is that of a world that cannot, bit for bit. `None`: the
    /// process has no address space left.
    pub fn savable(solver: Solver, kind: WorldKind) -> Option<Self> {
        Self::savable_within(MAX_ARENA_BYTES, solver, kind)
    }

    /// The same with an arena of at most `bytes`.
    pub(super) fn savable_within(bytes: u64, solver: Solver, kind: WorldKind) -> Option<Self> {
        Arena::new(bytes).map(|arena| Self::make(solver, kind, 0, Some(arena)))
    }

    fn make(solver: Solver, kind: WorldKind, manifolds: u16, arena: Option<Arena>) -> Self {
        let raw_kind = match kind {
            WorldKind::Rigid => sys::AmbWorldKind::AmbWorldKind_Rigid,
            WorldKind::Soft => sys::AmbWorldKind::AmbWorldKind_Soft,
            WorldKind::Articulated => sys::AmbWorldKind::AmbWorldKind_Articulated,
        };
        let place = arena.as_ref().map_or(std::ptr::null_mut(), Arena::as_ptr);
        // SAFETY: the tables are static and have the layouts that the headers beside them describe.
        unsafe {
            sys::amb_set_islands(std::ptr::from_ref(ambf_dynamics::island::ffi::table()).cast());
            sys::amb_set_trees(std::ptr::from_ref(ambf_dynamics::aba::ffi::table()).cast());
        }
        // SAFETY: numbers that the enums of the shim have; the arena is this world's alone and goes after it; the
        // engine is static.
        let raw = unsafe {
            let engine = sys::amb_dynamics_engine();
            sys::amb_world_new(solver as i32, raw_kind as i32, i32::from(manifolds), place, engine)
        };
        let mut world = Self {
            raw: NonNull::new(raw).expect("operator new throws rather than return null"),
            solver,
            integrator: Integrator::default(),
            has_soft_bodies: kind == WorldKind::Soft,
            has_articulations: kind == WorldKind::Articulated,
            articulations: SlotMap::with_key(),
            trees: Vec::new(),
            bodies: SlotMap::with_key(),
            constraints: SlotMap::with_key(),
            couplings: Vec::new(),
            ghosts: SlotMap::with_key(),
            vehicles: SlotMap::with_key(),
            soft_bodies: SlotMap::with_key(),
            volumes: SlotMap::with_key(),
            body_list: Vec::new(),
            body_order: Vec::new(),
            constraint_list: Vec::new(),
            constraint_order: Vec::new(),
            readings: Vec::new(),
            free_indices: Vec::new(),
            scratch: RefCell::default(),
            structure: 0,
            arena,
        };
        world.set_gravity(Vector3::zeros());
        world.set_defaults(solver);
        world
    }

    /// Enters the arena of this world until the guard is dropped. Needed for every call that may allocate.
    pub(super) fn enter(&self) -> ArenaGuard {
        ArenaGuard::new(self.arena.as_ref())
    }

    /// The method that solves contacts and constraints.
    pub fn solver(&self) -> Solver {
        self.solver
    }

    /// The integrator of free bodies.
    pub fn integrator(&self) -> Integrator {
        self.integrator
    }

    /// The shim's world, for functions that this interface does not offer. This world keeps ownership; a caller must
    /// not change anything that this world keeps track of. Not for worlds that can be saved.
    pub fn as_raw(&self) -> *mut sys::AmbWorld {
        self.raw.as_ptr()
    }

    /// Whether soft bodies may be added.
    pub fn has_soft_bodies(&self) -> bool {
        self.has_soft_bodies
    }

    /// Sets gravity, m/s², also of all dynamic bodies and soft bodies in the world.
    pub fn set_gravity(&mut self, gravity: Vector3<f64>) {
        let _arena = self.enter();
        // SAFETY: the world is alive; three doubles are read.
        unsafe { sys::amb_world_set_gravity(self.raw.as_ptr(), gravity.as_ptr()) }
    }

    /// Sets the number of iterations of the solver. Default: 10.
    pub fn set_iterations(&mut self, iterations: u32) {
        // SAFETY: the world is alive.
        unsafe { sys::amb_world_set_iterations(self.raw.as_ptr(), iterations.min(100_000) as i32) }
    }

    /// Sets the integrator of free bodies.
    pub fn set_integrator(&mut self, integrator: Integrator) {
        self.integrator = integrator;
        // SAFETY: the world is alive and stays where it is: it is the callback's user pointer.
        unsafe { sys::amb_world_set_integrator(self.raw.as_ptr(), integrator as i32) }
    }

    /// Whether articulations are integrated by the semi-implicit Euler method, one evaluation of the accelerations a sub-step,
    /// instead of the classical Runge-Kutta method. Default: `false`.
    pub fn set_trees_by_euler(&mut self, by_euler: bool) {
        // SAFETY: the world is alive.
        unsafe { sys::amb_world_set_trees_by_euler(self.raw.as_ptr(), by_euler.into()) }
    }

    /// Whether motion states lag up to a sub-step behind the poses. Default: `true`.
    pub fn set_lag(&mut self, lag: bool) {
        // SAFETY: the world is alive.
        unsafe { sys::amb_world_set_lag(self.raw.as_ptr(), lag.into()) }
    }

    /// Discards contacts, warm-starting impulses, the time that is left of the last step and all else that is remembered
    /// of the motion, and reactivates bodies that Bullet disabled because their state was not finite. To be called after
    /// poses and velocities were set to finite values.
    pub fn recover(&mut self) {
        let _arena = self.enter();
        let (list, n) = (self.constraint_list.as_ptr(), self.constraint_list.len() as i32);
        // SAFETY: the world and everything in it are alive; the list holds constraints of this world and null only.
        unsafe {
            sys::amb_constraints_recover(list, n);
            sys::amb_world_recover(self.raw.as_ptr());
        }
    }

    /// Pairs of objects whose bounding boxes overlap, which the narrow phase looks at. Bodies that are [apart](super::Apart) and
    /// shapes without extent have none with [`Solver::Accurate`], and beyond 1000 objects with the other solvers, whose order
    /// of contacts up to then is plain Bullet's.
    pub fn pair_count(&self) -> usize {
        // SAFETY: the world is alive.
        unsafe { sys::amb_world_pair_count(self.raw.as_ptr()) }.max(0) as usize
    }

    /// Contact points of rigid bodies after the last sub-step; those of ghosts do not count.
    pub fn contact_count(&self) -> usize {
        // SAFETY: the world is alive.
        unsafe { sys::amb_world_contact_count(self.raw.as_ptr()) }.max(0) as usize
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;

    use super::super::tests::{ball, hinge};
    use super::super::{BodyKinematics, Constraint, PlausibleBounds, RigidBody, Shape};
    use super::*;

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

    /// Rotation vector of the error and energy gained, relative, of an asymmetric body after 10 s of free flight.
    fn free_flight(integrator: Integrator, dt: f64) -> (f64, f64) {
        let inertia = Vector3::new(0.16 + 0.81, 0.01 + 0.81, 0.01 + 0.16) * (10.0 / 12.0);
        let start = Vector3::new(0.1, 5.0, 0.1);
        let mut world = World::new(Solver::default());
        world.set_integrator(integrator);
        world.set_gravity(Vector3::new(0.0, 0.0, -9.81));
        let body = world.add_body(RigidBody { mass: 10.0, inertia, ..ball(10.0, 0.0) });
        world.set_velocity(body, &Vector3::new(-2.0, 2.0, 8.0), &start);
        // Euler's equations with quaternions, at a fine step of the same order but in the body's axes.
        let (mut q, mut w) = (nalgebra::Quaternion::identity(), start);
        let slope = |q: &nalgebra::Quaternion<f64>, w: &Vector3<f64>| {
            let torque = (inertia.component_mul(w)).cross(w);
            (*q * nalgebra::Quaternion::from_imag(*w) * 0.5, torque.component_div(&inertia))
        };
        let h = 1e-4;
        for _ in 0..100_000 {
            let (q1, w1) = slope(&q, &w);
            let (q2, w2) = slope(&(q + q1 * (h / 2.0)), &(w + w1 * (h / 2.0)));
            let (q3, w3) = slope(&(q + q2 * (h / 2.0)), &(w + w2 * (h / 2.0)));
            let (q4, w4) = slope(&(q + q3 * h), &(w + w3 * h));
            q += (q1 + q2 * 2.0 + q3 * 2.0 + q4) * (h / 6.0);
            w += (w1 + w2 * 2.0 + w3 * 2.0 + w4) * (h / 6.0);
        }
        for _ in 0..(10.0 / dt).round() as usize {
            world.step(dt, 1, dt);
        }
        let pose = world.pose(body).unwrap();
        let error = pose.rotation.angle_to(&nalgebra::UnitQuaternion::from_quaternion(q));
        let turned = pose.rotation.inverse() * world.velocity(body).unwrap().1;
        let energy = |w: &Vector3<f64>| inertia.dot(&w.component_mul(w));
        (error, energy(&turned) / energy(&start) - 1.0)
    }

    #[test]
    fn runge_kutta_turns_a_free_body_as_eulers_equations_say() {
        let (error, gained) = free_flight(Integrator::RungeKutta, 1e-3);
        assert!(error < 1e-9, "{error:e}");
        assert!(gained.abs() < 1e-10, "{gained:e}");
        let (coarse, _) = free_flight(Integrator::RungeKutta, 8e-3);
        assert!(coarse > 100.0 * error && coarse < 1e-5, "of fourth order: {coarse:e}");
        assert!(free_flight(Integrator::Ballistic, 1e-3).0 > 0.1, "Bullet's own rotation is of first order");
    }

    #[test]
    fn runge_kutta_is_exact_under_force_and_damping() {
        let mut world = World::new(Solver::default());
        world.set_integrator(Integrator::RungeKutta);
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        let body = world.add_body(RigidBody { linear_damping: 0.3, angular_damping: 0.5, ..ball(1.0, 0.0) });
        world.set_velocity(body, &Vector3::new(1.0, 0.0, 2.0), &Vector3::new(0.0, 0.0, 3.0));
        for _ in 0..50 {
            world.step(0.02, 1, 0.02);
        }
        // v' = g - c v.
        let c = -(0.7f64.ln());
        let v = |v0: f64, g: f64| v0 * 0.7 + g * 0.3 / c;
        let x = |v0: f64, g: f64| v0 * 0.3 / c + g * (1.0 - 0.3 / c) / c;
        let (linear, angular) = world.velocity(body).unwrap();
        assert!((linear - Vector3::new(v(1.0, 0.0), 0.0, v(2.0, -10.0))).norm() < 1e-12, "{linear}");
        assert!((angular.z - 1.5).abs() < 1e-12, "{angular}");
        let expected = Vector3::new(x(1.0, 0.0), 0.0, x(2.0, -10.0));
        assert!((world.pose(body).unwrap().translation.vector - expected).norm() < 1e-12);
    }

    #[test]
    fn runge_kutta_follows_a_torque_that_spins_a_body_up_in_one_sub_step() {
        // A torque, fixed in the world, that would turn a thin rod by 40 rad about its axis in one sub-step.
        let (inertia, dt) = (Vector3::new(6e-6, 6e-6, 2e-7), 4e-3);
        let torque = Vector3::new(0.2, -0.3, 1.0);
        let mut world = World::new(Solver::default());
        world.set_integrator(Integrator::RungeKutta);
        let body = world.add_body(RigidBody { inertia, ..ball(0.05, 0.0) });
        world.apply_wrench(body, &Vector3::zeros(), &torque);
        world.step(dt, 1, dt);
        let (pose, omega) = (world.pose(body).unwrap(), world.velocity(body).unwrap().1);
        let momentum = pose.rotation * inertia.component_mul(&pose.rotation.inverse_transform_vector(&omega));
        // The angular momentum is the impulse of the torque, whatever the body does.
        let impulse = torque * dt;
        assert!((momentum - impulse).norm() < 1e-4 * impulse.norm(), "{momentum}, not {impulse}");
    }

    #[test]
    fn runge_kutta_leaves_what_is_held_to_the_solver() {
        let swing = |integrator| {
            let mut world = World::new(Solver::default());
            world.set_integrator(integrator);
            world.set_gravity(Vector3::new(0.0, -10.0, 0.0));
            let (a, b) = (world.add_body(ball(0.0, 0.0)), world.add_body(ball(1.0, 1.0)));
            let joint = Constraint { disable_collisions: false, ..hinge() };
            world.add_constraint(a, b, &joint).unwrap();
            for _ in 0..300 {
                world.step(0.001, 1, 0.001);
            }
            world.pose(b).unwrap()
        };
        assert_eq!(swing(Integrator::RungeKutta), swing(Integrator::Euler));
    }

    #[test]
    fn sub_steps_above_the_cap_are_reported() {
        let mut world = World::new(Solver::default());
        assert_eq!(world.step(0.0256, 10, 0.001), 25);
        assert_eq!(world.step(0.0005, 10, 0.001), 1, "the remainder was kept");
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
        assert_eq!(world.first_lost(&PlausibleBounds::default()), Some(1));
        world.set_velocity(lost, &Vector3::zeros(), &Vector3::zeros());
        world.set_pose(lost, &Isometry3::identity());
        world.recover();
        for _ in 0..500 {
            world.step(0.001, 1, 0.001);
        }
        assert_eq!(world.first_lost(&PlausibleBounds::default()), None);
        assert!(world.pose(lost).unwrap().translation.z.abs() < 0.01, "it rests on the plane again");
    }
}
