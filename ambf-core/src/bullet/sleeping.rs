use bullet_sys as sys;

use super::{BodyHandle, World};

/// Thresholds of the linear (m/s) and angular (rad/s) speed below which bodies fall asleep. Bullet's 0.8 m/s and 1
/// rad/s would stop a pendulum of 1 m with an amplitude of 10°.
const SLEEP_BELOW: [f64; 2] = [0.02, 0.1];

/// The same for bodies that nothing but contacts can carry. Ten iterations of sequential impulses leave the bodies of a
/// heap with up to 0.05 m/s and 0.3 rad/s for ever, so that one of 200 always is faster than [`SLEEP_BELOW`].
const RESTS_BELOW: [f64; 2] = [0.08, 0.5];

impl World {
    /// Updates AABBs of static bodies only when their pose is set, not in every sub-step. This changes the order of
    /// pairs, and hence the order of contact rows in the solver.
    pub fn freeze_static_aabbs(&mut self) {
        let _arena = self.enter();
        // SAFETY: the world and everything in it are alive.
        unsafe { sys::amb_world_freeze_static_aabbs(self.raw.as_ptr()) }
    }

    /// Enables sleeping: the bodies of an island fall asleep together when all of them have been slower than 0.02 m/s
    /// and 0.1 rad/s for 2 s. For a body without constraints under a gravity of at least 1 m/s², which therefore rests
    /// on something, it is 0.08 m/s and 0.5 rad/s. Sleeping bodies keep their pose, have zero velocity and take hardly any time. A body
    /// wakes up, with its neighbours, when its pose, velocity, force, motor or constraints are changed through this
    /// interface, and when the AABB of an awake body overlaps its own. Vehicles never sleep. Includes
    /// [`freeze_static_aabbs`](Self::freeze_static_aabbs). Default: disabled.
    ///
    /// False, and no effect, for a world with soft bodies: their contact forces would not wake a body.
    pub fn enable_sleeping(&mut self) -> bool {
        let _arena = self.enter();
        if self.has_soft_bodies {
            return false;
        }
        // SAFETY: the world and everything in it are alive.
        unsafe { sys::amb_world_enable_sleeping(self.raw.as_ptr(), SLEEP_BELOW.as_ptr(), RESTS_BELOW.as_ptr()) }
        true
    }

    /// Whether a body is asleep; false for static bodies. `None` when the handle is stale.
    pub fn is_asleep(&self, handle: BodyHandle) -> Option<bool> {
        // SAFETY: the body is alive.
        Some(unsafe { sys::amb_body_is_asleep(self.raw_body(handle)?) } != 0)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Vector3};

    use super::super::tests::{ball, hinge};
    use super::super::{BodyKinematics, RigidBody, Shape, Solver};
    use super::*;

    fn run(world: &mut World, seconds: f64) {
        for _ in 0..(seconds * 1000.0) as usize {
            world.step(0.001, 1, 0.001);
        }
    }

    fn cube(mass: f64, z: f64) -> RigidBody {
        let pose = Isometry3::translation(0.0, 0.0, z);
        RigidBody { shape: Shape::cuboid(Vector3::repeat(0.1), 0.001), pose, ..ball(mass, 0.0) }
    }

    /// A table of 0.2 m on which two cubes lie, asleep.
    fn stack() -> (World, [BodyHandle; 3]) {
        let mut world = World::new(Solver::default());
        assert!(world.enable_sleeping());
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        let bodies = [cube(0.0, 0.0), cube(1.0, 0.2), cube(1.0, 0.4)].map(|body| world.add_body(body));
        run(&mut world, 1.5);
        assert_eq!(bodies.map(|body| world.is_asleep(body)), [Some(false); 3], "not yet");
        run(&mut world, 1.5);
        assert_eq!(bodies.map(|body| world.is_asleep(body)), [Some(false), Some(true), Some(true)]);
        (world, bodies)
    }

    fn height(world: &World, body: BodyHandle) -> f64 {
        world.pose(body).unwrap().translation.z
    }

    #[test]
    fn a_sleeping_body_stays_and_is_read_completely() {
        let (mut world, [_, low, high]) = stack();
        let before = [low, high].map(|body| world.pose(body).unwrap());
        run(&mut world, 1.0);
        assert_eq!([low, high].map(|body| world.pose(body).unwrap()), before);
        let mut states = [BodyKinematics::default(); 3];
        world.read_bodies(&mut states);
        for (state, pose) in states[1..].iter().zip(before) {
            assert_eq!((state.linear_velocity, state.angular_velocity), ([0.0; 3], [0.0; 3]));
            assert!((state.inertial_pose().translation.vector - pose.translation.vector).norm() < 1e-15);
        }
        assert!((before[1].translation.z - 0.4).abs() < 0.002);
        assert!(world.contact_count() >= 8, "contacts are remembered");
    }

    #[test]
    fn what_is_acted_on_wakes_its_neighbours() {
        type Act = fn(&mut World, BodyHandle);
        let acts: [(&str, Act); 4] = [
            ("force", |world, body| world.apply_wrench(body, &Vector3::x(), &Vector3::zeros())),
            ("velocity", |world, body| world.set_velocity(body, &Vector3::zeros(), &Vector3::zeros())),
            ("gravity", |world, body| world.set_body_gravity(body, &Vector3::zeros())),
            ("pose", |world, body| world.set_pose(body, &Isometry3::translation(0.0, 0.0, 0.21))),
        ];
        for (name, act) in acts {
            let (mut world, [_, low, high]) = stack();
            world.apply_wrench(low, &Vector3::zeros(), &Vector3::zeros());
            run(&mut world, 0.01);
            assert_eq!(world.is_asleep(low), Some(true), "no force is no reason");
            act(&mut world, low);
            run(&mut world, 0.001);
            assert_eq!([low, high].map(|body| world.is_asleep(body)), [Some(false); 2], "{name}");
            run(&mut world, 3.5);
            assert_eq!(world.is_asleep(high), Some(true), "{name}: asleep again");
        }
    }

    #[test]
    fn what_loses_its_support_falls() {
        type Act = fn(&mut World, [BodyHandle; 3]);
        let acts: [(&str, Act); 4] = [
            ("put away", |world, [table, ..]| world.set_pose(table, &Isometry3::translation(5.0, 0.0, 0.0))),
            ("removed", |world, [table, ..]| assert!(world.remove_body(table))),
            ("made visual-only", |world, [table, ..]| assert!(world.make_visual_only(table))),
            ("ignored", |world, [table, low, _]| world.ignore_collision(table, low)),
        ];
        for (name, act) in acts {
            let (mut world, bodies) = stack();
            act(&mut world, bodies);
            run(&mut world, 0.3);
            assert!(height(&world, bodies[1]) < -0.1, "{name}: {}", height(&world, bodies[1]));
        }
        // The dynamic one between them.
        let (mut world, [_, low, high]) = stack();
        world.set_pose(low, &Isometry3::translation(5.0, 0.0, 0.0));
        run(&mut world, 0.5);
        assert!((height(&world, high) - 0.2).abs() < 0.01, "{}", height(&world, high));
    }

    #[test]
    fn a_static_body_that_is_moved_pushes_what_slept() {
        let (mut world, [table, low, high]) = stack();
        for i in 1..=100 {
            world.set_pose(table, &Isometry3::translation(0.0, 0.0, 1e-3 * f64::from(i)));
            run(&mut world, 0.01);
        }
        assert!((height(&world, low) - 0.3).abs() < 0.01 && (height(&world, high) - 0.5).abs() < 0.01);
        // One that comes from afar.
        run(&mut world, 3.0);
        assert_eq!(world.is_asleep(high), Some(true));
        let wall = world.add_body(cube(0.0, 3.0));
        run(&mut world, 0.01);
        assert_eq!(world.is_asleep(high), Some(true));
        world.set_pose(wall, &Isometry3::translation(0.15, 0.0, 0.5));
        run(&mut world, 0.5);
        assert!(world.pose(high).unwrap().translation.x < -0.02);
    }

    #[test]
    fn joints_wake_what_they_hold() {
        let mut world = World::new(Solver::default());
        world.enable_sleeping();
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        // The hinge's axis is vertical: nothing moves until a motor does.
        let (a, b) = (world.add_body(ball(0.0, 0.0)), world.add_body(ball(2.0, 1.0)));
        let joint = world.add_constraint(a, b, &hinge()).unwrap();
        run(&mut world, 3.0);
        assert_eq!(world.is_asleep(b), Some(true));
        world.set_motor(joint, false, 0.0, 1.0);
        run(&mut world, 0.01);
        assert_eq!(world.is_asleep(b), Some(true), "a motor that stays off changes nothing");
        world.set_motor(joint, true, 1.0, 10.0);
        run(&mut world, 0.5);
        let mut angle = [0.0];
        world.read_constraints(&mut angle);
        assert!((angle[0] - 0.5).abs() < 0.02, "{}", angle[0]);
        world.set_motor(joint, true, 0.0, 10.0);
        run(&mut world, 3.0);
        assert_eq!(world.is_asleep(b), Some(true));
        // The other body of its joint is moved without a contact.
        world.set_pose(a, &Isometry3::translation(0.0, 0.0, 0.5));
        run(&mut world, 2.0);
        assert!((height(&world, b) - 0.5).abs() < 0.05, "{}", height(&world, b));
        run(&mut world, 3.0);
        assert_eq!(world.is_asleep(b), Some(true));
        assert!(world.remove_constraint(joint));
        run(&mut world, 0.5);
        assert!(height(&world, b) < -0.5);
    }

    #[test]
    fn a_pendulum_goes_on_swinging() {
        let mut world = World::new(Solver::default());
        world.enable_sleeping();
        let (a, b) = (world.add_body(ball(0.0, 0.0)), world.add_body(ball(2.0, 1.0)));
        world.add_constraint(a, b, &hinge()).unwrap();
        // It hangs along x; at the lowest point it has the speed of an amplitude of 10°.
        world.set_gravity(Vector3::new(10.0, 0.0, 0.0));
        world.set_velocity(b, &Vector3::new(0.0, 0.55, 0.0), &Vector3::new(0.0, 0.0, 0.55));
        for _ in 0..20 {
            run(&mut world, 0.5);
            assert_eq!(world.is_asleep(b), Some(false));
        }
    }

    /// Cubes of 0.2 m in a heap on the ground, turned and placed by a small generator of numbers.
    fn heap(solver: Solver, seed: u32, count: usize) -> (World, Vec<BodyHandle>) {
        let mut world = World::new(solver);
        world.enable_sleeping();
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.1, 0.0), friction: 0.9, ..ball(0.0, 0.0) });
        let mut state = seed;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24) - 0.5
        };
        let mut bodies = Vec::new();
        for i in 0..count {
            let place = [i % 4, i / 4 % 4, i / 16].map(|k| 0.3 * k as f64 + 0.1 * random());
            let turn = Vector3::from_fn(|_, _| 0.5 * random());
            let pose = Isometry3::new(place.into(), turn);
            bodies.push(world.add_body(RigidBody { pose, angular_damping: 0.5, ..cube(0.1, 0.0) }));
        }
        (world, bodies)
    }

    #[test]
    fn a_heap_comes_to_rest_whatever_solves_it() {
        for solver in [Solver::default(), Solver::Accurate] {
            let (mut world, bodies) = heap(solver, 1, 60);
            let asleep = |world: &World| bodies.iter().filter(|&&body| world.is_asleep(body) == Some(true)).count();
            let mut seconds = 0;
            while asleep(&world) < bodies.len() {
                assert!(seconds < 60, "{solver:?}: {} of {} sleep", asleep(&world), bodies.len());
                run(&mut world, 1.0);
                seconds += 1;
            }
            // It stays where it is, and one that is pushed wakes those that it lies on.
            let poses: Vec<_> = bodies.iter().map(|&body| world.pose(body)).collect();
            run(&mut world, 1.0);
            assert_eq!(poses, bodies.iter().map(|&body| world.pose(body)).collect::<Vec<_>>());
            world.apply_wrench(bodies[0], &Vector3::new(0.0, 0.0, 1e-3), &Vector3::zeros());
            run(&mut world, 0.002);
            assert!(asleep(&world) < bodies.len() - 1, "{solver:?}");
        }
    }

    #[test]
    fn what_only_contacts_carry_may_be_faster_when_it_falls_asleep() {
        // Slides on without friction, at speeds between both thresholds.
        let slides = |gravity: f64| {
            let mut world = World::new(Solver::default());
            world.enable_sleeping();
            let ground = RigidBody { shape: Shape::plane(Vector3::z(), -0.1, 0.0), friction: 0.0, ..ball(0.0, 0.0) };
            world.add_body(ground);
            let body = world.add_body(RigidBody { friction: 0.0, ..cube(1.0, 0.0) });
            world.set_gravity(Vector3::new(0.0, 0.0, -gravity));
            world.set_velocity(body, &Vector3::new(0.05, 0.0, 0.0), &Vector3::zeros());
            run(&mut world, 3.0);
            world.is_asleep(body) == Some(false)
        };
        assert!(!slides(10.0), "it rests");
        assert!(slides(0.1), "it would fall too slowly to tell");
        assert!(slides(0.0), "it floats");
    }

    #[test]
    fn a_body_that_comes_near_wakes_it() {
        let (mut world, [_, low, high]) = stack();
        let falling = world.add_body(cube(1.0, 2.0));
        run(&mut world, 0.2);
        assert_eq!(world.is_asleep(high), Some(true));
        run(&mut world, 0.8);
        assert_eq!([low, high].map(|body| world.is_asleep(body)), [Some(false); 2]);
        assert!((height(&world, falling) - 0.6).abs() < 0.02);
    }

    #[test]
    fn gravity_and_recovery_wake_everything() {
        let (mut world, [_, low, high]) = stack();
        world.set_gravity(Vector3::new(0.0, 0.0, 10.0));
        run(&mut world, 0.3);
        assert!(height(&world, high) > 0.6 && height(&world, low) > 0.4);
        let (mut world, [_, low, _]) = stack();
        world.recover();
        run(&mut world, 0.001);
        assert_eq!(world.is_asleep(low), Some(false));
        run(&mut world, 3.0);
        assert_eq!(world.is_asleep(low), Some(true));
    }

    #[test]
    fn static_bodies_at_rest_are_still_seen_where_they_are_put() {
        let mut world = World::new(Solver::default());
        world.freeze_static_aabbs();
        world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
        let table = world.add_body(cube(0.0, 0.0));
        let falling = world.add_body(cube(1.0, 3.0));
        run(&mut world, 0.1);
        world.set_pose(table, &Isometry3::translation(0.0, 0.0, 1.0));
        run(&mut world, 1.5);
        assert!((height(&world, falling) - 1.2).abs() < 0.01, "{}", height(&world, falling));
        assert_eq!(world.is_asleep(falling), Some(false), "only static ones rest");
        assert!(!World::with_soft_bodies(Solver::default()).enable_sleeping());
    }

    #[test]
    fn motion_states_are_the_same_however_often_they_are_read() {
        let run = |every: usize| {
            let mut world = World::new(Solver::default());
            world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
            let body = world.add_body(cube(1.0, 0.0));
            world.set_velocity(body, &Vector3::x(), &Vector3::new(1.0, 2.0, 3.0));
            let mut seen = Vec::new();
            for i in 0..400 {
                // Steps of no, one and several sub-steps.
                world.step(0.0001 * (i % 37) as f64, 10, 0.001);
                if i == 200 {
                    world.set_pose(body, &Isometry3::translation(1.0, 0.0, 0.0));
                }
                let read = (i % every == 0).then(|| world.motion_state(body).unwrap());
                if i % 8 == 0 {
                    seen.extend(read);
                }
            }
            seen
        };
        assert_eq!(run(1), run(8));
    }
}
