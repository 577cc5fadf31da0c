use nalgebra::{DMatrix, DVector, Isometry3, Vector3};

use super::*;
use crate::bullet::{
    BodyDrive, Constraint, JointReadings, PlausibleBounds, Ray, RayTarget, RigidBody, Shape, SoftMotor, Solver, Spring,
};

mod external_constraints;
mod several_freedoms;
mod what_may_touch;

const GRAVITY: f64 = 9.81;
/// Moment of inertia of a rod of 1 kg and 1 m about an axis across it, kg·m².
const INERTIA: f64 = 1.0 / 12.0;

fn link(mass: f64, x: f64) -> RigidBody {
    RigidBody {
        mass,
        inertia: Vector3::new(0.01, INERTIA, INERTIA) * mass,
        shape: Shape::sphere(0.01, 0.001),
        pose: Isometry3::translation(x, 0.0, 0.0),
        friction: 0.5,
        rolling_friction: 0.0,
        restitution: 0.0,
        linear_damping: 0.0,
        angular_damping: 0.0,
        gravity: None,
    }
}

fn hinge(kind: ConstraintKind, a: f64, b: f64) -> Constraint {
    Constraint {
        kind,
        frame_a: Isometry3::translation(a, 0.0, 0.0),
        frame_b: Isometry3::translation(b, 0.0, 0.0),
        parameters: vec![],
        feedback: false,
        disable_collisions: true,
    }
}

/// A static body and a chain of links of 1 kg and 1 m along x, gravity along -y; hinges about z.
fn chain(masses: &[f64]) -> (World, Vec<BodyHandle>, Vec<ConstraintHandle>) {
    let mut world = World::with_articulations(Solver::default());
    world.set_gravity(Vector3::new(0.0, -GRAVITY, 0.0));
    world.set_lag(false);
    let mut bodies = vec![world.add_body(link(0.0, 0.0))];
    let mut joints = Vec::new();
    for (i, &mass) in masses.iter().enumerate() {
        bodies.push(world.add_body(link(mass, i as f64 + 0.5)));
        let at = if i == 0 { 0.0 } else { 0.5 };
        let constraint = hinge(ConstraintKind::Hinge { limits: None }, at, -0.5);
        joints.push(world.add_constraint(bodies[i], bodies[i + 1], &constraint).unwrap());
    }
    (world, bodies, joints)
}

/// Absolute angles of such a chain after `time` s from rest along x: Lagrange's equations, Runge-Kutta steps of `h`.
fn chain_angles(masses: &[f64], time: f64, h: f64) -> DVector<f64> {
    let n = masses.len();
    // Way of the centre of mass of link k per angle i.
    let arm = |k: usize, i: usize| {
        if i < k {
            1.0
        } else if i == k {
            0.5
        } else {
            0.0
        }
    };
    let sum = |i, j| (0..n).map(|k| masses[k] * arm(k, i) * arm(k, j)).sum::<f64>();
    let coupling = DMatrix::from_fn(n, n, sum);
    let weight = DVector::from_fn(n, |i, _| (0..n).map(|k| masses[k] * arm(k, i)).sum::<f64>() * GRAVITY);
    let acceleration = |q: &DVector<f64>, v: &DVector<f64>| {
        let inertia = |i, j| if i == j { INERTIA * masses[i] } else { 0.0 };
        let mass = DMatrix::from_fn(n, n, |i, j| coupling[(i, j)] * (q[i] - q[j]).cos() + inertia(i, j));
        let force = DVector::from_fn(n, |i, _| {
            let swing = |j: usize| coupling[(i, j)] * (q[i] - q[j]).sin() * v[j] * v[j];
            -weight[i] * q[i].cos() - (0..n).map(swing).sum::<f64>()
        });
        mass.cholesky().unwrap().solve(&force)
    };
    let (mut q, mut v) = (DVector::zeros(n), DVector::zeros(n));
    for _ in 0..(time / h).round() as usize {
        let (v1, a1) = (v.clone(), acceleration(&q, &v));
        let (v2, a2) = (&v + &a1 * (h / 2.0), acceleration(&(&q + &v1 * (h / 2.0)), &(&v + &a1 * (h / 2.0))));
        let (v3, a3) = (&v + &a2 * (h / 2.0), acceleration(&(&q + &v2 * (h / 2.0)), &(&v + &a2 * (h / 2.0))));
        let (v4, a4) = (&v + &a3 * h, acceleration(&(&q + &v3 * h), &(&v + &a3 * h)));
        q += (v1 + v2 * 2.0 + v3 * 2.0 + v4) * (h / 6.0);
        v += (a1 + a2 * 2.0 + a3 * 2.0 + a4) * (h / 6.0);
    }
    q
}

#[test]
fn chains_are_exact_to_fourth_order() {
    let mut heavy = [1.0; 10];
    heavy[9] = 1000.0;
    for (masses, bound) in [(&[1.0, 1.0][..], 1e-8), (&[1.0; 10], 2e-5), (&heavy, 2e-5)] {
        let (mut world, bodies, joints) = chain(masses);
        world.articulate(&joints).unwrap();
        run(&mut world, 2000);
        let angles = chain_angles(masses, 2.0, 1e-4);
        let mut end = Vector3::zeros();
        for (&body, angle) in bodies[1..].iter().zip(&angles) {
            let half = Vector3::new(angle.cos(), angle.sin(), 0.0) / 2.0;
            let error = (world.pose(body).unwrap().translation.vector - end - half).norm();
            assert!(error < bound, "{} links: {error} m", masses.len());
            end += half * 2.0;
        }
        let mut read = vec![0.0; masses.len()];
        world.read_constraints(&mut read);
        assert!((read[1] - (angles[1] - angles[0])).sin().abs() < 10.0 * bound);
    }
}

fn run(world: &mut World, steps: usize) {
    (0..steps).for_each(|_| {
        world.step(0.001, 1, 0.001);
    });
}

fn poses(world: &World, bodies: &[BodyHandle]) -> Vec<Isometry3<f64>> {
    bodies.iter().map(|&body| world.pose(body).unwrap()).collect()
}

fn farthest(a: &[Isometry3<f64>], b: &[Isometry3<f64>]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a.translation.vector - b.translation.vector).norm()).fold(0.0, f64::max)
}

#[test]
fn an_articulation_moves_as_its_constraints_do_and_can_be_dissolved() {
    let motion = |articulated: bool| {
        let (mut world, bodies, joints) = chain(&[1.0, 2.0, 0.5]);
        world.set_iterations(200);
        let articulation = articulated.then(|| world.articulate(&joints).unwrap());
        let mut seen = Vec::new();
        for step in 0..1000 {
            world.apply_wrench(bodies[3], &Vector3::new(1.0, 3.0, 0.0), &Vector3::new(0.0, 0.0, 0.5));
            if step == 300 {
                world.set_body_gravity(bodies[2], &Vector3::new(0.0, 5.0, 0.0));
            }
            if step == 500 {
                world.set_velocity(bodies[3], &Vector3::new(0.0, 1.0, 0.0), &Vector3::zeros());
            }
            if let (700, Some(articulation)) = (step, articulation) {
                assert!(world.dissolve(articulation) && !world.dissolve(articulation));
            }
            run(&mut world, 1);
            seen.push(poses(&world, &bodies));
        }
        seen
    };
    let (articulated, bodies) = (motion(true), motion(false));
    for (step, (a, b)) in articulated.iter().zip(&bodies).enumerate() {
        let off = farthest(a, b);
        assert!(off < 0.05, "step {step}: {off} m");
    }
}

#[test]
fn a_reset_gives_the_initial_state_bit_for_bit() {
    let (mut world, bodies, joints) = chain(&[1.0, 2.0, 0.5]);
    world.articulate(&joints).unwrap();
    let initial = poses(&world, &bodies);
    let motion = |world: &mut World| {
        run(world, 400);
        poses(world, &bodies)
    };
    let first = motion(&mut world);
    for (&body, pose) in bodies.iter().zip(&initial) {
        world.clear_forces(body);
        world.set_velocity(body, &Vector3::zeros(), &Vector3::zeros());
        world.set_pose(body, pose);
    }
    assert_eq!(motion(&mut world), first);
}

/// A restart sorts lists in which bodies and constraints are found by the places that they had before: bodies beside the
/// tree were taken out of the world instead of its links, and stood still.
#[test]
fn what_is_beside_a_tree_moves_and_is_removed_after_a_restart() {
    let (mut world, bodies, joints) = chain(&[1.0, 2.0, 0.5]);
    let free = [10.0, 11.0].map(|x| world.add_body(link(1.0, x)));
    let weld = world.add_constraint(free[0], free[1], &hinge(ConstraintKind::Fixed, 0.5, -0.5)).unwrap();
    world.articulate(&joints).unwrap();
    let start = poses(&world, &free);
    for _ in 0..2 {
        run(&mut world, 100);
        world.begin_restart();
        for (&body, pose) in free.iter().zip(&start) {
            world.reset_body(body, pose, None);
        }
        world.finish_restart();
        run(&mut world, 100);
        assert!(world.articulation(bodies[1]).is_some());
        for (pose, start) in poses(&world, &free).iter().zip(&start) {
            assert!((pose.translation.vector - start.translation.vector).norm() > 0.01, "it falls");
        }
    }
    assert!(world.remove_constraint(weld));
    world.set_velocity(free[0], &Vector3::new(0.0, 5.0, 0.0), &Vector3::zeros());
    let before = poses(&world, &free);
    run(&mut world, 100);
    let after = poses(&world, &free);
    let moved = |i: usize| after[i].translation.y - before[i].translation.y;
    assert!(moved(0) - moved(1) > 0.5, "they part: {} {}", moved(0), moved(1));
    assert!(world.remove_body(free[0]));
    run(&mut world, 10);
    assert!(poses(&world, &free[1..])[0].translation.vector != after[1].translation.vector, "the other one goes on");
}

#[test]
fn what_is_no_tree_is_refused() {
    let (mut world, bodies, joints) = chain(&[1.0, 1.0, 1.0]);
    assert!(world.articulate(&[]).is_none());
    assert!(world.articulate(&joints[..2]).is_none(), "the third holds a link");
    let mut limits = [[-0.1, 0.1]; 6];
    limits[1] = [0.0; 2];
    let sliding = hinge(ConstraintKind::SixDof(limits), 0.5, -0.5);
    let loose = world.add_body(link(1.0, 3.5));
    let sliding = world.add_constraint(bodies[3], loose, &sliding).unwrap();
    assert!(world.articulate(&joints).is_none(), "a joint that slides along two axes holds a link");
    assert!(world.articulate(&[joints[0], joints[1], joints[2], sliding]).is_none());
    assert!(world.remove_constraint(sliding));
    let anchor = world.add_body(link(0.0, 3.0));
    let closing = world.add_constraint(anchor, bodies[3], &hinge(ConstraintKind::Fixed, 0.0, 0.5)).unwrap();
    assert!(world.articulate(&[joints[0], joints[1], joints[2], closing]).is_none(), "held at both ends");
    assert!(world.remove_constraint(closing));
    let articulation = world.articulate(&joints).unwrap();
    assert!(world.articulate(&joints).is_none(), "twice");
    assert_eq!(world.articulation(bodies[1]), Some(articulation));
    assert!(!world.remove_body(bodies[1]));
    assert!(world.remove_constraint(joints[1]), "which dissolves it");
    assert_eq!(world.articulation(bodies[1]), None);
    run(&mut world, 10);
    let mut rigid = World::new(Solver::default());
    let [a, b] = [0.0, 1.0].map(|x| rigid.add_body(link(x, x)));
    let joint = rigid.add_constraint(a, b, &hinge(ConstraintKind::Fixed, 0.5, -0.5)).unwrap();
    assert!(rigid.articulate(&[joint]).is_none(), "not made for it");
}

#[test]
fn a_free_tree_keeps_its_momentum() {
    let (mut world, bodies, joints) = chain(&[1.0, 2.0, 0.5]);
    world.remove_constraint(joints[0]);
    world.set_gravity(Vector3::zeros());
    world.articulate(&joints[1..]).unwrap();
    world.set_velocity(bodies[1], &Vector3::new(1.0, 2.0, 3.0), &Vector3::new(2.0, -1.0, 4.0));
    let momentum = |world: &World| -> Vector3<f64> {
        [1.0, 2.0, 0.5].iter().zip(&bodies[1..]).map(|(mass, &body)| world.velocity(body).unwrap().0 * *mass).sum()
    };
    run(&mut world, 1);
    let before = momentum(&world);
    assert!((before - Vector3::new(1.0, 2.0, 3.0)).norm() < 1e-12, "{before}");
    run(&mut world, 2000);
    assert!((momentum(&world) - before).norm() < 1e-9);
}

#[test]
fn a_free_tree_that_whips_keeps_its_momentum() {
    let masses = [1.0, 2.0, 0.5, 0.1];
    let (mut world, bodies, joints) = chain(&masses);
    world.remove_constraint(joints[0]);
    world.set_gravity(Vector3::zeros());
    world.articulate(&joints[1..]).unwrap();
    let mut most = 0.0;
    for step in 0..200 {
        // Opposite torques, by which the links would turn by a thousand radians in a step.
        let torque = if step % 20 < 10 { 1e8 } else { -3e7 };
        world.apply_wrench(bodies[4], &Vector3::zeros(), &(Vector3::z() * torque));
        world.apply_wrench(bodies[3], &Vector3::zeros(), &(Vector3::z() * -torque));
        run(&mut world, 1);
        let velocity = |body| world.velocity(body).unwrap().0;
        let momentum: Vector3<f64> = masses.iter().zip(&bodies[1..]).map(|(mass, &body)| velocity(body) * *mass).sum();
        let speeds: f64 = masses.iter().zip(&bodies[1..]).map(|(mass, &body)| velocity(body).norm() * mass).sum();
        most = f64::max(most, speeds);
        assert!(momentum.norm() < 1e-12 * most, "step {step}: {momentum} of {most} N s");
    }
    assert!(most > 100.0, "{most} N s");
}

/// A link on a hinge or slider, horizontal, with gravity along -y, and what holds it.
fn pendulum(constraint: Constraint, articulated: bool) -> (World, BodyHandle, ConstraintHandle) {
    let mut world = World::with_articulations(Solver::default());
    world.set_gravity(Vector3::new(0.0, -GRAVITY, 0.0));
    world.set_iterations(100);
    world.set_lag(false);
    let base = world.add_body(link(0.0, 0.0));
    let body = world.add_body(link(2.0, 0.5));
    let joint = world.add_constraint(base, body, &constraint).unwrap();
    if articulated {
        world.articulate(&[joint]).unwrap();
    }
    (world, body, joint)
}

fn slider(limits: Option<[f64; 2]>) -> Constraint {
    let mut slider = hinge(ConstraintKind::Slider { limits }, 0.5, 0.0);
    // The axis x turned to y.
    let turn = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    slider.frame_a.rotation = turn;
    slider.frame_b.rotation = turn;
    slider
}

/// Once Bullet's slider was asked for the position of the sub-step before, and each rate by a call of its own.
#[test]
fn positions_and_rates_are_read_at_once() {
    let kinds = [
        hinge(ConstraintKind::Hinge { limits: Some([3.0, 9.0]) }, 0.0, -0.5),
        slider(None),
        hinge(ConstraintKind::Fixed, 0.0, -0.5),
    ];
    for (kind, articulated) in kinds.iter().flat_map(|kind| [(kind, true), (kind, false)]) {
        let (mut world, _, joint) = pendulum(kind.clone(), articulated);
        run(&mut world, 300);
        let mut readings = JointReadings::default();
        world.observe_constraints(&mut readings);
        let known = world.coordinate(joint);
        assert_eq!(readings.positions, [known.map_or(0.0, |(position, _)| position)], "{kind:?} {articulated}");
        let has_rate = articulated || matches!(kind.kind, ConstraintKind::Hinge { .. });
        assert_eq!(
            readings.rates,
            [known.filter(|_| has_rate).map_or(0.0, |(_, rate)| rate)],
            "{kind:?} {articulated}"
        );
        assert!(known.is_none_or(|(position, rate)| position != 0.0 && rate != 0.0), "it moves");
        // In the place of what is gone nothing is written.
        readings.positions[0] = 7.0;
        assert!(world.remove_constraint(joint));
        world.observe_constraints(&mut readings);
        assert_eq!(readings.positions, [7.0]);
    }
}

fn position(world: &World) -> f64 {
    let mut position = [0.0];
    world.read_constraints(&mut position);
    position[0]
}

#[test]
fn limits_stop_hinges_and_sliders() {
    for articulated in [true, false] {
        let (mut world, ..) =
            pendulum(hinge(ConstraintKind::Hinge { limits: Some([-0.8, 3.5]) }, 0.0, -0.5), articulated);
        let lowest = (0..3000).map(|_| {
            run(&mut world, 1);
            position(&world)
        });
        let lowest = lowest.fold(f64::MAX, f64::min);
        assert!(lowest > -0.82, "{lowest}");
        assert!((position(&world) + 0.8).abs() < 2e-3, "{articulated}: {}", position(&world));
        let (mut world, body, _) = pendulum(slider(Some([-0.1, 0.2])), articulated);
        run(&mut world, 1000);
        assert!((position(&world) + 0.1).abs() < 1e-3, "{articulated}: {}", position(&world));
        world.set_body_gravity(body, &Vector3::new(0.0, GRAVITY, 0.0));
        run(&mut world, 1000);
        assert!((position(&world) - 0.2).abs() < 1e-3, "{articulated}: {}", position(&world));
    }
}

#[test]
fn motors_hold_what_they_can() {
    for articulated in [true, false] {
        let (mut world, _, joint) = pendulum(hinge(ConstraintKind::Hinge { limits: None }, 0.0, -0.5), articulated);
        assert!(world.set_motor(joint, true, 0.7, 10.0));
        run(&mut world, 1000);
        assert!((position(&world) - 0.7).abs() < 1e-3, "{articulated}: {}", position(&world));
        // Too weak for the weight: impulse a sub-step below torque times step.
        world.set_motor(joint, true, 0.0, 0.5 * 0.001);
        run(&mut world, 200);
        assert!(position(&world) < 0.65, "{articulated}: {}", position(&world));
        world.set_motor(joint, false, 0.0, 10.0);
        let (mut world, _, joint) = pendulum(slider(None), articulated);
        world.set_motor(joint, true, -0.3, 100.0);
        run(&mut world, 1000);
        assert!((position(&world) + 0.3).abs() < 1e-3, "{articulated}: {}", position(&world));
        world.set_motor(joint, true, 0.0, 2.0 * GRAVITY - 2.0);
        run(&mut world, 1000);
        assert!(
            (position(&world) + 1.1).abs() < 5e-3,
            "from 0.3 m/s, 1 m/s² down for 1 s; {articulated}: {}",
            position(&world)
        );
    }
}

#[test]
fn feedback_says_what_the_joint_does() {
    let point = hinge(ConstraintKind::PointToPoint, 0.0, -0.5);
    for make in [hinge(ConstraintKind::Hinge { limits: None }, 0.0, -0.5), slider(None), point] {
        for reversed in [false, true] {
            for swinging in [false, true] {
                let wrench = |articulated: bool| {
                    let mut constraint = Constraint { feedback: true, ..make.clone() };
                    if reversed {
                        std::mem::swap(&mut constraint.frame_a, &mut constraint.frame_b);
                    }
                    let mut world = World::with_articulations(Solver::default());
                    world.set_gravity(Vector3::new(0.0, -GRAVITY, 0.0));
                    world.set_iterations(100);
                    let base = world.add_body(link(0.0, 0.0));
                    let body = world.add_body(link(2.0, 0.5));
                    let (a, b) = if reversed { (body, base) } else { (base, body) };
                    let joint = world.add_constraint(a, b, &constraint).unwrap();
                    if articulated {
                        world.articulate(&[joint]).unwrap();
                    }
                    if !matches!(make.kind, ConstraintKind::PointToPoint) {
                        world.set_motor(joint, !swinging, 0.0, 100.0);
                    }
                    run(&mut world, 300);
                    world.joint_wrench(joint).unwrap()
                };
                let (tree, free) = (wrench(true), wrench(false));
                let mut pairs = vec![(tree.force_a, free.force_a), (tree.force_b, free.force_b)];
                // Bullet omits the torque of a slider's force about a static body.
                if !matches!(make.kind, ConstraintKind::Slider { .. }) {
                    pairs.extend([(tree.torque_a, free.torque_a), (tree.torque_b, free.torque_b)]);
                }
                for (a, b) in pairs {
                    assert!((a - b).norm() < 0.3, "reversed {reversed}, swinging {swinging}: {tree:?} {free:?}");
                }
            }
        }
    }
}

fn spring(axis: usize, stiffness: f64, damping: f64, rest: f64) -> ConstraintKind {
    let (mut limits, mut springs) = ([[0.0; 2]; 6], [None; 6]);
    limits[axis] = [-2.0, 2.0];
    let sign = if axis < 3 { 1.0 } else { -1.0 };
    springs[axis] = Some(Spring { enabled: true, stiffness, damping, equilibrium: Some(sign * rest) });
    ConstraintKind::SixDofSpring { limits, springs }
}

/// Position after `seconds` of a pendulum without gravity whose hinge has a spring: beside it, or instead of it.
fn sprung(articulated: bool, beside: bool, (stiffness, damping): (f64, f64), seconds: f64) -> f64 {
    let mut world = World::with_articulations(Solver::default());
    world.set_iterations(100);
    world.set_lag(false);
    let base = world.add_body(link(0.0, 0.0));
    let body = world.add_body(link(2.0, 0.5));
    let spring = hinge(spring(5, stiffness, damping, 0.5), 0.0, -0.5);
    let mut joints = vec![];
    if beside {
        // The other way round, turned by 0.3 rad.
        let mut turned = Constraint { frame_a: spring.frame_b, frame_b: spring.frame_a, ..spring };
        let turn = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.3);
        turned.frame_a.rotation *= turn;
        let plain = hinge(ConstraintKind::Hinge { limits: None }, 0.0, -0.5);
        joints.push(world.add_constraint(body, base, &turned).unwrap());
        joints.push(world.add_constraint(base, body, &plain).unwrap());
    } else {
        joints.push(world.add_constraint(base, body, &spring).unwrap());
    }
    if articulated {
        let articulation = world.articulate(&joints).unwrap();
        assert_eq!(world.articulation(body), Some(articulation));
    }
    run(&mut world, (seconds * 1000.0) as usize);
    world.pose(body).unwrap().rotation.euler_angles().2
}

#[test]
fn springs_are_part_of_a_tree() {
    let inertia: f64 = 2.0 * (0.25 + INERTIA);
    // From a distance of 0.5 to rest.
    let swing = |(stiffness, damping): (f64, f64), t: f64| {
        let decay = damping / (2.0 * inertia);
        let turn = (stiffness / inertia - decay * decay).sqrt();
        1.0 - (-decay * t).exp() * ((turn * t).cos() + decay / turn * (turn * t).sin())
    };
    for beside in [false, true] {
        for (strength, seconds) in [((10.0, 0.0), 0.7), ((10.0, 0.3), 3.0), ((2e5, 600.0), 1.0)] {
            // Seen from the other end, and turned, it rests elsewhere.
            let rest = if beside { -0.3 - 0.5 } else { 0.5 };
            let (wanted, stiff) = (rest * swing(strength, seconds), strength.0 > 100.0);
            let [tree, free] = [true, false].map(|on| sprung(on, beside, strength, seconds) - wanted);
            assert!(tree.abs() < if stiff { 1e-6 } else { 1e-9 }, "{beside} {strength:?}: {tree}");
            assert!(free.abs() < 0.02, "{beside} {strength:?}: {free}");
        }
    }
    // A spring with another axis than the hinge.
    let (mut world, bodies, joints) = chain(&[1.0]);
    let mut crooked = hinge(spring(5, 1.0, 0.0, 0.0), 0.0, -0.5);
    let turn = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 1.0);
    (crooked.frame_a.rotation, crooked.frame_b.rotation) = (turn, turn);
    let crooked = world.add_constraint(bodies[0], bodies[1], &crooked).unwrap();
    assert!(world.articulate(&[joints[0], crooked]).is_none());
}

#[test]
fn small_vibrations_about_a_loaded_equilibrium_last() {
    // A spring carries a rod of 2 kg, of 1 m, horizontally. The elastic energy is 1e19 times that of the vibration.
    let (stiffness, inertia, first): (f64, f64, f64) = (10.0, 2.0 * (0.25 + INERTIA), 1e-9);
    let mut world = World::with_articulations(Solver::default());
    world.set_gravity(Vector3::new(0.0, -GRAVITY, 0.0));
    world.set_lag(false);
    let base = world.add_body(link(0.0, 0.0));
    let body = world.add_body(link(2.0, 0.5));
    let rest = 2.0 * GRAVITY * 0.5 / stiffness;
    let joint = world.add_constraint(base, body, &hinge(spring(5, stiffness, 0.0, rest), 0.0, -0.5)).unwrap();
    assert!(world.articulate(&[joint]).is_some());
    world.set_velocity(body, &(Vector3::y() * first * 0.5), &(Vector3::z() * first));
    for step in 1..=2000 {
        run(&mut world, 1);
        let wanted = first * ((stiffness / inertia).sqrt() * f64::from(step) * 1e-3).cos();
        let (_, velocity) = world.velocity(body).unwrap();
        assert!((velocity.z - wanted).abs() < 1e-3 * first, "step {step}: {} rad/s, not {wanted}", velocity.z);
    }
}

#[test]
fn drives_give_way_as_their_softness_says() {
    let (mut world, bodies, joints) = chain(&[2.0]);
    world.set_gravity(Vector3::zeros());
    world.articulate(&joints).unwrap();
    let inertia = 2.0 * (0.25 + INERTIA);
    for softness in [0.0, 0.5, 20.0] {
        world.set_velocity(bodies[1], &Vector3::zeros(), &Vector3::zeros());
        assert!(world.set_soft_motor(joints[0], Some(SoftMotor { velocity: 0.3, softness, max_force: 1e5 })));
        run(&mut world, 1);
        // v = 0.3 - softness λ with λ = I v.
        let (_, v) = world.coordinate(joints[0]).unwrap();
        assert!((v - 0.3 / (1.0 + inertia * softness)).abs() < 1e-8, "{softness}: {v}");
    }
    assert!(world.set_soft_motor(joints[0], None));
    let drive = BodyDrive { velocity: [Vector3::y(), Vector3::z() * 2.0], softness: [1e-3, 1e-3] };
    world.set_pose(bodies[1], &Isometry3::translation(0.5, 0.0, 0.0));
    assert!(world.set_body_drive(bodies[1], Some(&drive)));
    run(&mut world, 2);
    assert!((world.velocity(bodies[1]).unwrap().0.y - 1.0).abs() < 0.01);
    assert!(world.set_body_drive(bodies[1], None));
    let articulation = world.articulation(bodies[1]).unwrap();
    assert!(world.dissolve(articulation));
    run(&mut world, 1);
}

#[test]
fn links_touch_are_seen_and_can_be_held() {
    let (mut world, bodies, joints) = chain(&[1.0, 1.0]);
    let floor = Shape::plane(Vector3::y(), -0.4, 0.0);
    let floor = world.add_body(RigidBody { shape: floor, ..link(0.0, 0.0) });
    let loose = world.add_body(RigidBody { pose: Isometry3::translation(1.5, 0.3, 0.0), ..link(0.5, 0.0) });
    world.articulate(&joints).unwrap();
    let mut hits = [None];
    let ray = Ray { from: Vector3::new(1.5, 0.0, 1.0), to: Vector3::new(1.5, 0.0, -1.0) };
    world.cast_rays(&[ray], &mut hits);
    assert_eq!(hits[0].unwrap().target, RayTarget::Body(bodies[2]));
    let ghost = world.add_ghost(Shape::cuboid(Vector3::repeat(0.1), 0.0), &Isometry3::translation(1.5, 0.0, 0.0));
    // The last link grasps the body at its present pose; then the chain falls on the floor with it.
    let grasp = hinge(ConstraintKind::Fixed, 0.0, 0.0);
    let grasp = Constraint { frame_b: Isometry3::translation(0.0, -0.3, 0.0), ..grasp };
    let held = world.add_constraint(bodies[2], loose, &grasp).unwrap();
    run(&mut world, 1);
    let mut sensed = Vec::new();
    world.ghost_overlaps(ghost, &mut sensed);
    assert!(sensed.contains(&bodies[2]), "{sensed:?}");
    assert!(world.articulation(bodies[2]).is_some(), "it is an external constraint");
    let gap = |world: &World| {
        let [link, loose] = [bodies[2], loose].map(|body| world.pose(body).unwrap());
        (link.translation.vector + link.rotation * Vector3::y() * 0.3 - loose.translation.vector).norm()
    };
    let mut contacts = Vec::new();
    let touched = (0..3000).filter(|_| {
        run(&mut world, 1);
        assert!(gap(&world) < 5e-3, "{}", gap(&world));
        assert!(world.pose(bodies[2]).unwrap().translation.y > -0.41);
        world.contacts(bodies[2], 0.01, &mut contacts);
        contacts.iter().any(|contact| contact.other == floor)
    });
    assert!(touched.count() > 10);
    assert_eq!(world.first_lost(&PlausibleBounds::default()), None);
    // It outlives the articulation as a constraint, and other constraints on links dissolve the articulation.
    let ball = hinge(ConstraintKind::SixDof([[1.0, -1.0]; 6]), 0.0, 0.0);
    let ball = world.add_constraint(
        bodies[1],
        bodies[2],
        &Constraint { frame_a: Isometry3::translation(1.0, 0.0, 0.0), ..ball },
    );
    assert!(ball.is_some() && world.articulation(bodies[2]).is_none());
    run(&mut world, 10);
    assert!(world.remove_constraint(held) && world.remove_constraint(ball.unwrap()));
    assert!(world.articulate(&joints).is_some());
    run(&mut world, 10);
    assert_eq!(world.first_lost(&PlausibleBounds::default()), None);
}

#[test]
fn light_links_carry_any_weight() {
    for ratio in [1e5, 1e6] {
        let mut masses = [1.0; 10];
        masses[9] = ratio;
        let (mut world, bodies, joints) = chain(&masses);
        world.articulate(&joints).unwrap();
        run(&mut world, 1000);
        let energy = |(&body, mass): (&BodyHandle, f64)| {
            let (v, w) = world.velocity(body).unwrap();
            let y = world.pose(body).unwrap().translation.y;
            mass * ((v.norm_squared() + INERTIA * w.norm_squared()) / 2.0 + GRAVITY * y)
        };
        let gained: f64 = bodies[1..].iter().zip(masses).map(energy).sum();
        assert!(gained.abs() < 1e-5 * ratio * GRAVITY, "{ratio:e}: {gained} J");
    }
}

#[test]
fn a_lost_tree_recovers() {
    let (mut world, bodies, joints) = chain(&[1.0, 1.0]);
    let initial = poses(&world, &bodies);
    world.articulate(&joints).unwrap();
    world.apply_wrench(bodies[2], &Vector3::repeat(f64::NAN), &Vector3::zeros());
    run(&mut world, 3);
    assert!(world.first_lost(&PlausibleBounds::default()).is_some());
    for (&body, pose) in bodies.iter().zip(&initial) {
        world.clear_forces(body);
        world.set_velocity(body, &Vector3::zeros(), &Vector3::zeros());
        world.set_pose(body, pose);
    }
    world.recover();
    run(&mut world, 300);
    assert_eq!(world.first_lost(&PlausibleBounds::default()), None);
    let (mut fresh, others, joints) = chain(&[1.0, 1.0]);
    fresh.articulate(&joints).unwrap();
    run(&mut fresh, 300);
    assert_eq!(poses(&world, &bodies), poses(&fresh, &others));
}

#[test]
fn the_speed_of_the_whole_does_not_change_the_motion_within() {
    // Light links between heavy ones at 60 rad/s, against limits: the integrator has to watch the energy.
    let bends = |speed: f64| {
        let mut world = World::with_articulations(Solver::Accurate);
        world.set_lag(false);
        let masses = [1.0, 0.01, 0.5, 0.01, 20.0];
        let bodies: Vec<_> =
            masses.iter().enumerate().map(|(i, &mass)| world.add_body(link(mass, i as f64 + 0.5))).collect();
        for (i, pair) in bodies.windows(2).enumerate() {
            let limits = (i % 2 == 1).then_some([-0.5, 0.5]);
            world.add_constraint(pair[0], pair[1], &hinge(ConstraintKind::Hinge { limits }, 0.5, -0.5)).unwrap();
        }
        for (i, &body) in bodies.iter().enumerate() {
            let spin = if i == 0 { 60.0 } else { 0.0 };
            let along = if i == 0 { -30.0 } else { 0.0 };
            world.set_velocity(body, &Vector3::new(0.0, along, speed), &(Vector3::z() * spin));
        }
        run(&mut world, 300);
        let poses: Vec<_> = bodies.iter().map(|&body| world.pose(body).unwrap()).collect();
        poses.windows(2).map(|pair| pair[0].rotation.angle_to(&pair[1].rotation)).collect::<Vec<f64>>()
    };
    let (at_rest, fast) = (bends(0.0), bends(1000.0));
    assert!(at_rest.iter().all(|bend| *bend > 0.0), "{at_rest:?}");
    for (a, b) in at_rest.iter().zip(&fast) {
        assert!((a - b).abs() < 1e-5, "{at_rest:?} {fast:?}");
    }
}
