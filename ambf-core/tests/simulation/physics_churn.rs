//! Things come and go while the world runs: handles of what is gone do nothing, the places of others stay.

use crate::soft_common::{ball, cloth, world};
use ambf_core::bullet::{
    BodyHandle, BodyKinematics, Constraint, ConstraintHandle, ConstraintKind, GhostHandle, PlausibleBounds, Ray,
    RigidBody, Shape, SoftBody, SoftBodyHandle, SoftConfig, Solver, VehicleHandle, Wheel, World,
};
use nalgebra::{Isometry3, Vector3};

/// Knuth's linear congruential generator.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % n
    }

    fn real(&mut self) -> f64 {
        self.below(1000) as f64 / 1000.0
    }

    fn place(&mut self) -> Vector3<f64> {
        Vector3::new(self.real() - 0.5, self.real() - 0.5, 0.1 + self.real())
    }

    fn one<T: Copy>(&mut self, of: &[T]) -> Option<T> {
        (!of.is_empty()).then(|| of[self.below(of.len())])
    }
}

fn hinge() -> Constraint {
    Constraint {
        kind: ConstraintKind::Hinge { limits: None },
        frame_a: Isometry3::identity(),
        frame_b: Isometry3::translation(-0.3, 0.0, 0.0),
        parameters: vec![],
        feedback: true,
        disable_collisions: true,
    }
}

fn wheel(random: &mut Random) -> Wheel {
    Wheel {
        connection: random.place(),
        direction: -Vector3::z(),
        axle: -Vector3::y(),
        rest_length: 0.1,
        radius: 0.05,
        is_front: true,
        stiffness: 5.88,
        damping_relaxation: 0.88,
        damping_compression: 0.83,
        friction_slip: 10.5,
        roll_influence: 0.1,
    }
}

fn shape(random: &mut Random) -> Shape {
    const TETRAHEDRON: [[f64; 3]; 4] = [[0.0; 3], [0.3, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 0.3]];
    const FACES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
    match random.below(5) {
        0 => Shape::cuboid(Vector3::repeat(0.1), 0.01),
        1 => Shape::convex_hull(&TETRAHEDRON, 0.01),
        2 => Shape::concave_mesh(&TETRAHEDRON, &FACES, 0.01).expect("a mesh"),
        3 => Shape::compound((0..3).map(|i| {
            let pose = Isometry3::translation(0.1 * f64::from(i), 0.0, 0.0);
            (Shape::sphere(0.1, 0.0), pose)
        })),
        _ => Shape::sphere(0.1, 0.0),
    }
}

fn soft(random: &mut Random) -> SoftBody {
    let flags = [1, 2, 16, 17, 18, 34, 50, 0x7fff_ffff][random.below(8)];
    SoftBody {
        pose: Isometry3::translation(random.real() - 0.5, random.real() - 0.5, 0.2 + random.real()),
        config: SoftConfig { flags, kDP: 0.01, ..cloth(4).config },
        clusters: [None, Some(0), Some(3)][random.below(3)],
        bending_distance: Some(2),
        randomize: true,
        fixed_nodes: if random.below(2) == 0 { vec![] } else { vec![0] },
        pose_matching: random.below(2) == 0,
        ..cloth(4)
    }
}

#[derive(Default)]
struct Things {
    bodies: Vec<BodyHandle>,
    constraints: Vec<ConstraintHandle>,
    ghosts: Vec<GhostHandle>,
    vehicles: Vec<VehicleHandle>,
    cloths: Vec<SoftBodyHandle>,
}

/// Adds or removes something, whether it is still there or not.
fn churn(world: &mut World, things: &mut Things, random: &mut Random) {
    let pose = Isometry3::from(random.place());
    let (a, b) = (random.one(&things.bodies), random.one(&things.bodies));
    let soft_body = random.one(&things.cloths);
    match random.below(16) {
        0..=2 => things.bodies.push(world.add_body(RigidBody { shape: shape(random), pose, ..ball(1.0, 0.0) })),
        3..=4 => drop(a.map(|body| world.remove_body(body))),
        5 => things.constraints.extend(a.zip(b).and_then(|(a, b)| world.add_constraint(a, b, &hinge()))),
        6..=7 => drop(random.one(&things.constraints).map(|handle| world.remove_constraint(handle))),
        8 => things.ghosts.push(world.add_ghost(shape(random), &pose)),
        9 => drop(random.one(&things.ghosts).map(|handle| world.remove_ghost(handle))),
        10 => {
            let wheels = [wheel(random), wheel(random)];
            things.vehicles.extend(a.and_then(|body| world.add_vehicle(body, &wheels)));
        }
        11 => drop(random.one(&things.vehicles).map(|handle| world.remove_vehicle(handle))),
        12 => things.cloths.push(world.add_soft_body(&soft(random)).expect("a cloth")),
        13 => drop(soft_body.map(|handle| world.remove_soft_body(handle))),
        14 => {
            if let (Some(soft), Some(body)) = (soft_body, a) {
                if !world.add_anchor(soft, random.below(16), body, &Vector3::zeros(), 1.0, random.below(2) == 0) {
                    world.remove_anchors(soft, body);
                }
            }
        }
        _ => {
            if let Some(handle) = soft_body {
                world.restore_soft_body(handle);
            }
            if let (Some(a), Some(b)) = (a, b) {
                world.ignore_collision(a, b);
            }
            a.filter(|_| random.below(4) == 0).map(|body| world.make_visual_only(body));
        }
    }
}

#[test]
fn things_come_and_go() {
    for seed in 0..8 {
        let (mut world, mut random, mut things) = (world(), Random(seed), Things::default());
        world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), 0.0, 0.0), ..ball(0.0, 0.0) });
        let (mut states, mut angles) = (Vec::new(), Vec::new());
        let (mut contacts, mut overlaps, mut hits) = (Vec::new(), Vec::new(), [None; 20]);
        for _ in 0..400 {
            churn(&mut world, &mut things, &mut random);
            world.step(0.002, 2, 0.001);
            states.resize(world.bodies().len(), BodyKinematics::default());
            angles.resize(world.constraints().len(), 0.0);
            world.read_bodies(&mut states);
            world.read_constraints(&mut angles);
            world.refresh_constraints();
            let rays = [(); 20].map(|()| Ray { from: random.place(), to: random.place() });
            world.cast_rays(&rays, &mut hits);
            if let (Some(body), Some(ghost)) = (random.one(&things.bodies), random.one(&things.ghosts)) {
                world.contacts(body, 0.0, &mut contacts);
                world.ghost_overlaps(ghost, &mut overlaps);
                assert!(contacts.iter().all(|contact| world.pose(contact.other).is_some()), "a live body");
                assert!(overlaps.iter().all(|&other| world.pose(other).is_some()), "a live body");
            }
            for (place, &handle) in world.bodies().iter().enumerate() {
                let Some(pose) = world.motion_state(handle) else { continue };
                // Clusters of soft bodies that meet edge on edge may lose their numbers, and those of what they touch.
                let same =
                    pose == states[place].inertial_pose() || !pose.translation.vector.iter().all(|x| x.is_finite());
                assert!(same, "body {place} is not in its place");
            }
        }
    }
}

#[test]
fn removed_bodies_and_joints_leave_holes() {
    let mut world = World::new(Solver::default());
    let bodies = [0.0, 1.0, 2.0, 3.0].map(|x| world.add_body(ball(1.0, x)));
    let joints = [0, 1, 2].map(|i| world.add_constraint(bodies[i], bodies[i + 1], &hinge()).expect("a joint"));
    assert!(world.remove_constraint(joints[0]) && world.remove_constraint(joints[1]));
    assert!(world.remove_body(bodies[1]));
    world.set_velocity(bodies[3], &Vector3::repeat(f64::NAN), &Vector3::zeros());
    assert_eq!(world.first_lost(&PlausibleBounds::default()), Some(3));
    world.set_velocity(bodies[3], &Vector3::zeros(), &Vector3::zeros());
    assert_eq!((world.bodies(), world.constraints()), (&bodies[..], &joints[..]));

    let added = world.add_body(ball(1.0, 4.0));
    assert_eq!(world.bodies()[4], added);
    let before = BodyKinematics { origin: [9.0; 3], ..BodyKinematics::default() };
    let mut states = [before; 5];
    world.read_bodies(&mut states);
    assert_eq!(states.map(|state| state.origin[0]), [0.0, 9.0, 2.0, 3.0, 4.0]);
    let mut angles = [9.0; 3];
    world.refresh_constraints();
    world.read_constraints(&mut angles);
    assert_eq!(angles, [9.0, 9.0, 0.0]);

    // The place of a removed body in the sets of ignored ones is not used again.
    world.ignore_collision(bodies[0], added);
    assert!(world.remove_body(added));
    let ground = world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.2, 0.0), ..ball(0.0, 0.0) });
    world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
    for _ in 0..1000 {
        world.step(0.001, 1, 0.001);
    }
    let z = world.pose(bodies[0]).expect("live").translation.z;
    assert!((z + 0.1).abs() < 0.01, "it lies on the ground, at {z}");
    assert!(world.remove_body(ground));
}

#[test]
fn bodies_in_contact_can_be_told_to_ignore_each_other() {
    let mut world = World::new(Solver::default());
    world.set_gravity(Vector3::new(0.0, 0.0, -10.0));
    let ground = world.add_body(RigidBody { shape: Shape::plane(Vector3::z(), -0.1, 0.0), ..ball(0.0, 0.0) });
    let lying = world.add_body(ball(1.0, 0.0));
    for step in 0..2000 {
        if step == 1000 {
            assert!(world.pose(lying).expect("live").translation.z > -0.01);
            world.ignore_collision(ground, lying);
        }
        world.step(0.001, 1, 0.001);
    }
    let z = world.pose(lying).expect("live").translation.z;
    assert!((z + 5.0).abs() < 0.1, "it has fallen for 1 s, to {z}");
}
