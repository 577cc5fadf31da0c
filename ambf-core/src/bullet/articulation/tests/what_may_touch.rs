//! Worlds with articulations in which nothing may touch: sub-steps look for no pairs, and bounds follow when somebody asks.

use super::*;

const H: f64 = 0.001;

/// A ball of 0.1 m radius, at rest.
fn ball_at(x: f64, y: f64) -> RigidBody {
    let pose = Isometry3::translation(x, y, 0.0);
    RigidBody { shape: Shape::sphere(0.1, 0.001), pose, ..link(1.0, 0.0) }
}

/// A world under gravity along -y with two balls, 1 m apart, the first of which moves at the second at 2 m/s; a joint that
/// holds nothing between them keeps them from touching.
fn passing() -> (World, [BodyHandle; 2], ConstraintHandle) {
    passing_with(Solver::Accurate)
}

fn passing_with(solver: Solver) -> (World, [BodyHandle; 2], ConstraintHandle) {
    let mut world = World::with_articulations(solver);
    world.set_exact_rays(true);
    let balls = [0.0, 1.0].map(|x| world.add_body(ball_at(x, 0.0)));
    let free = Constraint { disable_collisions: true, ..hinge(ConstraintKind::SixDof([[1.0, -1.0]; 6]), 0.0, 0.0) };
    let joint = world.add_constraint(balls[0], balls[1], &free).unwrap();
    world.set_velocity(balls[0], &(Vector3::x() * 2.0), &Vector3::zeros());
    (world, balls, joint)
}

fn step(world: &mut World, count: usize) {
    (0..count).for_each(|_| {
        world.step(H, 1, H);
    });
}

#[test]
fn no_pairs_are_looked_for_where_nothing_may_touch() {
    let (mut world, [ball, _], _) = passing();
    step(&mut world, 500);
    assert!((world.pose(ball).unwrap().translation.x - 1.0).abs() < 1e-9, "they are at one point");
    assert_eq!(world.pair_count(), 0, "and nobody has looked");
    world.add_body(ball_at(5.0, 0.0));
    step(&mut world, 1);
    assert_eq!(world.pair_count(), 1, "a third ball may touch both");
}

/// Its AABBs decide in which order later pairs are found.
#[test]
fn bullets_order_of_pairs_stays() {
    let (mut world, ..) = passing_with(Solver::default());
    step(&mut world, 500);
    assert_eq!(world.pair_count(), 1);
}

#[test]
fn rays_meet_bodies_where_they_have_gone() {
    let (mut world, [ball, other], _) = passing();
    let sees = |world: &World, x: f64| {
        let mut hits = [None];
        let [from, to] = [-1.0, 1.0].map(|y| Vector3::new(x, y, 0.0));
        world.cast_rays(&[Ray { from, to }], &mut hits);
        hits[0].map(|hit| hit.target)
    };
    step(&mut world, 3000);
    assert_eq!(sees(&world, 6.0), Some(RayTarget::Body(ball)));
    assert_eq!(sees(&world, 1.0), Some(RayTarget::Body(other)));
    assert_eq!(sees(&world, 0.0), None);
    step(&mut world, 1000);
    assert_eq!(sees(&world, 8.0), Some(RayTarget::Body(ball)), "again later");
}

#[test]
fn what_comes_later_is_touched() {
    let (mut world, [ball, _], _) = passing();
    step(&mut world, 3000);
    let wall = world.add_body(RigidBody { mass: 0.0, inertia: Vector3::zeros(), ..ball_at(7.0, 0.0) });
    step(&mut world, 500);
    assert!(world.pose(ball).unwrap().translation.x < 6.85, "{}", world.pose(ball).unwrap().translation.x);
    assert!(world.remove_body(wall));
    world.set_velocity(ball, &(Vector3::x() * 2.0), &Vector3::zeros());
    step(&mut world, 500);
    assert!(world.pose(ball).unwrap().translation.x > 7.0, "and what has gone is not");
}

#[test]
fn a_joint_that_goes_lets_its_bodies_touch() {
    let (mut world, [ball, other], joint) = passing();
    step(&mut world, 300);
    assert!(world.remove_constraint(joint));
    step(&mut world, 200);
    let [first, second] = [ball, other].map(|body| world.pose(body).unwrap().translation.x);
    assert!(second - first > 0.19, "{first} {second}");
    assert!(second > 1.01, "it was pushed: {second}");
}

#[test]
fn contacts_that_a_joint_forbids_go_when_its_bodies_part() {
    let (mut world, [ball, other], joint) = passing();
    assert!(world.remove_constraint(joint));
    step(&mut world, 402);
    assert_eq!(world.contact_count(), 1);
    let free = Constraint { disable_collisions: true, ..hinge(ConstraintKind::SixDof([[1.0, -1.0]; 6]), 0.0, 0.0) };
    world.add_constraint(ball, other, &free).unwrap();
    // Bullet keeps them while the AABBs overlap.
    step(&mut world, 2);
    for (body, x) in [(ball, -3.0), (other, 3.0)] {
        world.set_pose(body, &Isometry3::translation(x, 0.0, 0.0));
    }
    step(&mut world, 3);
    assert_eq!((world.contact_count(), world.pair_count()), (0, 0));
}
