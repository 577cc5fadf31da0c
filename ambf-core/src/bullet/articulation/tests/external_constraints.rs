//! External constraints and contacts between articulations and other bodies.

use super::*;
use crate::bullet::{Integrator, SolverSettings};

/// A world like those of profile `accurate`.
fn accurate() -> World {
    let mut world = World::with_articulations(Solver::Accurate);
    world.set_lag(false);
    world.set_integrator(Integrator::RungeKutta);
    world.set_solver_settings(&SolverSettings { joint_erp: 0.9, ..world.solver_settings() });
    world
}

/// A body and its mass.
type Mass = (BodyHandle, f64);

fn add(world: &mut World, mass: f64, x: f64, y: f64) -> Mass {
    (world.add_body(RigidBody { pose: Isometry3::translation(x, y, 0.0), ..link(mass, 0.0) }), mass)
}

/// A free articulation of links of 1 m along x, the middle of the first at `x`.
fn articulated_chain(world: &mut World, masses: &[f64], x: f64, y: f64) -> Vec<Mass> {
    let links: Vec<_> = masses.iter().enumerate().map(|(i, &mass)| add(world, mass, x + i as f64, y)).collect();
    let joint = hinge(ConstraintKind::Hinge { limits: None }, 0.5, -0.5);
    let joints: Vec<_> = links.windows(2).map(|of| world.add_constraint(of[0].0, of[1].0, &joint).unwrap()).collect();
    assert!(world.articulate(&joints).is_some());
    links
}

/// Ties two bodies as they are, at the middle of the second.
fn tie(world: &mut World, a: BodyHandle, b: BodyHandle) -> ConstraintHandle {
    let [pose, other] = [a, b].map(|body| world.pose(body).unwrap());
    let frame_a = pose.inverse() * other;
    world
        .add_constraint(a, b, &Constraint { frame_a, feedback: true, ..hinge(ConstraintKind::Fixed, 0.0, 0.0) })
        .unwrap()
}

/// How far the middle of `b` is from where the tie holds it.
fn gap(world: &World, a: BodyHandle, b: BodyHandle, held_at: &Vector3<f64>) -> f64 {
    let [a, b] = [a, b].map(|body| world.pose(body).unwrap());
    (a * nalgebra::Point3::from(*held_at) - b.translation.vector).coords.norm()
}

/// Momentum, and angular momentum about the origin.
fn momenta(world: &World, bodies: &[Mass]) -> [Vector3<f64>; 2] {
    let (mut linear, mut angular) = (Vector3::zeros(), Vector3::zeros());
    for &(body, mass) in bodies {
        let (pose, (v, w)) = (world.pose(body).unwrap(), world.velocity(body).unwrap());
        let inertia = Vector3::new(0.01, INERTIA, INERTIA) * mass;
        linear += v * mass;
        angular += pose.translation.vector.cross(&v) * mass;
        angular += pose.rotation * inertia.component_mul(&pose.rotation.inverse_transform_vector(&w));
    }
    [linear, angular]
}

/// Runs for 1 s with a force on the first body. Returns the relative errors of the linear and angular momentum.
fn lost(world: &mut World, bodies: &[Mass], force: Vector3<f64>) -> [f64; 2] {
    let mut expected = momenta(world, bodies);
    let (mut linear, mut angular) = (expected[0].norm(), expected[1].norm());
    for _ in 0..1000 {
        let at = |world: &World| world.pose(bodies[0].0).unwrap().translation.vector;
        let before = at(world);
        world.apply_wrench(bodies[0].0, &force, &Vector3::zeros());
        run(world, 1);
        expected[0] += force * 0.001;
        expected[1] += ((before + at(world)) / 2.0).cross(&force) * 0.001;
        linear = linear.max(expected[0].norm());
        angular = angular.max(expected[1].norm());
    }
    let now = momenta(world, bodies);
    [(now[0] - expected[0]).norm() / linear, (now[1] - expected[1]).norm() / angular]
}

const PUSHES: [[f64; 3]; 2] = [[0.0; 3], [0.3, 1.0, 2.0]];

#[test]
fn trees_and_what_they_hold_keep_their_momenta() {
    for push in PUSHES {
        // From the mass of the articulation to a very small one.
        for mass in [5.0, 0.1, 1e-3] {
            let mut world = accurate();
            let mut bodies = articulated_chain(&mut world, &[1.0, 2.0, 0.5], 0.0, 0.0);
            bodies.push(add(&mut world, mass, 2.6, 0.2));
            let (link, held) = (bodies[2].0, bodies[3].0);
            tie(&mut world, link, held);
            assert!(world.articulation(link).is_some());
            world.set_velocity(bodies[0].0, &Vector3::new(0.1, 0.2, -0.1), &Vector3::new(0.5, -0.3, 1.0));
            // Until the held body moves with the articulation.
            run(&mut world, 20);
            let lost = lost(&mut world, &bodies, push.into());
            let gap = gap(&world, link, held, &Vector3::new(0.6, 0.2, 0.0));
            assert!(lost.iter().all(|share| *share < 5e-4), "{push:?}, {mass} kg: {lost:?}");
            assert!(gap < 1e-4, "{push:?}, {mass} kg: {gap} m");
        }
    }
}

#[test]
fn two_tied_trees_keep_their_momenta() {
    for push in PUSHES {
        let mut world = accurate();
        let mut bodies = articulated_chain(&mut world, &[1.0, 2.0], 0.0, 0.0);
        bodies.extend(articulated_chain(&mut world, &[0.5, 0.1], 1.2, 0.3));
        let (link, held) = (bodies[1].0, bodies[2].0);
        tie(&mut world, link, held);
        assert!(bodies.iter().all(|&(body, _)| world.articulation(body).is_some()));
        world.set_velocity(bodies[3].0, &Vector3::new(0.1, 0.2, -0.1), &Vector3::new(0.5, -0.3, 1.0));
        run(&mut world, 20);
        let lost = lost(&mut world, &bodies, push.into());
        let gap = gap(&world, link, held, &Vector3::new(0.2, 0.3, 0.0));
        // With rows positions follow the velocities after the sub-step: a force leads the mass centre by a h² / 2.
        assert!(lost[0] < 1e-9 && lost[1] < 1e-3, "{push:?}: {lost:?}");
        assert!(gap < 1e-4, "{push:?}: {gap} m");
    }
}

#[test]
fn a_tree_hangs_from_a_static_body() {
    let mut world = accurate();
    world.set_gravity(Vector3::new(0.0, -GRAVITY, 0.0));
    let fixture = add(&mut world, 0.0, 0.0, 0.2).0;
    let links = articulated_chain(&mut world, &[1.0, 0.5], 0.0, 0.0);
    let held = tie(&mut world, links[0].0, fixture);
    let before = world.pose(links[0].0).unwrap();
    world.set_pose(
        links[1].0,
        &(Isometry3::translation(0.5, -0.5, 0.0) * Isometry3::rotation(Vector3::z() * -std::f64::consts::FRAC_PI_2)),
    );
    run(&mut world, 1000);
    let moved = world.pose(links[0].0).unwrap().inverse() * before;
    assert!(moved.translation.vector.norm() < 1e-5 && moved.rotation.angle() < 1e-5, "{moved}");
    // The external constraint carries the weight and its torque.
    let wrench = world.joint_wrench(held).unwrap();
    assert!((wrench.force_a - Vector3::y() * 1.5 * GRAVITY).norm() < 1e-6, "{wrench:?}");
    assert!((wrench.torque_a - Vector3::z() * 0.25 * GRAVITY).norm() < 1e-6, "{wrench:?}");
}

#[test]
fn a_tie_that_its_tree_cannot_follow_does_no_harm() {
    // A pendulum has one freedom and its tie six rows; drawn tight, it can only stay.
    let (mut world, bodies, joints) = chain(&[1.0]);
    let fixture = add(&mut world, 0.0, 0.8, 0.1).0;
    world.articulate(&joints).unwrap();
    tie(&mut world, bodies[1], fixture);
    run(&mut world, 2000);
    let moved = world.pose(bodies[1]).unwrap().translation.vector - Vector3::new(0.5, 0.0, 0.0);
    assert!(moved.norm() < 1e-4, "{moved}");
}

#[test]
fn a_tree_that_pushes_a_box_keeps_its_momentum() {
    let mut world = accurate();
    let mut bodies = articulated_chain(&mut world, &[1.0, 0.5], 0.0, 0.0);
    let shape = Shape::cuboid(Vector3::new(0.1, 0.1, 0.1), 0.001);
    let block = RigidBody { shape, pose: Isometry3::translation(1.5, 0.08, 0.03), ..link(0.3, 0.0) };
    bodies.push((world.add_body(block), 0.3));
    let lost = lost(&mut world, &bodies, Vector3::new(2.0, 0.1, 0.0));
    let pushed = world.velocity(bodies[2].0).unwrap().0;
    assert!(pushed.x > 0.1, "it was hit: {pushed}");
    assert!(lost.iter().all(|share| *share < 5e-4), "{lost:?}");
}
