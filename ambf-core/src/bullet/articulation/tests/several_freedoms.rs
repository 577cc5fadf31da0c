//! Joints of articulations with three and six degrees of freedom.

use super::*;

fn ball(a: f64, b: f64) -> Constraint {
    hinge(ConstraintKind::PointToPoint, a, b)
}

#[test]
fn a_top_precesses_steadily() {
    // A rod of 2 kg turns about its axis, x, on a ball joint at its end, tilted by `tilt` from the vertical, and precesses
    // at the smaller root of A W^2 cos(tilt) - C s W + m g l = 0 (Landau and Lifshitz, Mechanics, section 35), with the
    // moments A about the joint and C about the axis, and the spin s about the axis.
    let (mass, tilt, spin): (f64, f64, f64) = (2.0, 0.6, 300.0);
    let (across, along) = (mass * (0.25 + INERTIA), mass * 0.01);
    let momentum = along * spin;
    let weight = mass * GRAVITY * 0.5;
    // The top is above the joint and its axis points up: its weight tips it.
    let by = 2.0 * across * tilt.cos();
    let precession = (momentum - (momentum * momentum - 2.0 * by * weight).sqrt()) / by;
    let mut world = World::with_articulations(Solver::default());
    world.set_gravity(Vector3::new(0.0, -GRAVITY, 0.0));
    world.set_lag(false);
    let base = world.add_body(link(0.0, 0.0));
    let axis = Vector3::new(tilt.sin(), tilt.cos(), 0.0);
    let turn = nalgebra::UnitQuaternion::rotation_between(&Vector3::x(), &axis).unwrap();
    let pose = Isometry3::from_parts((axis * 0.5).into(), turn);
    let body = world.add_body(RigidBody { pose, ..link(mass, 0.0) });
    let joint = world.add_constraint(base, body, &ball(0.0, -0.5)).unwrap();
    assert!(world.articulate(&[joint]).is_some());
    let along_axis = spin - precession * tilt.cos();
    let omega = axis * along_axis + Vector3::y() * precession;
    world.set_velocity(body, &omega.cross(&(axis * 0.5)), &omega);
    let h = 1e-4;
    for step in 1..=20_000 {
        world.step(h, 1, h);
        let center = world.pose(body).unwrap().translation.vector;
        let angle = precession * f64::from(step) * h;
        let wanted = Vector3::new(tilt.sin() * angle.cos(), tilt.cos(), -tilt.sin() * angle.sin()) * 0.5;
        assert!((center - wanted).norm() < 1e-6, "step {step}: {center}, not {wanted}");
    }
}

/// A free chain of links of 1 m, turning and bending: a ball joint, a hinge and a joint that leaves all motions.
fn thrown() -> (World, Vec<BodyHandle>) {
    let mut world = World::with_articulations(Solver::default());
    world.set_lag(false);
    let bodies: Vec<_> =
        [1.0, 2.0, 0.5, 1.5].iter().enumerate().map(|(i, &mass)| world.add_body(link(mass, i as f64))).collect();
    let mut wide = [[-10.0, 10.0]; 6];
    wide[4] = [-1.5, 1.5];
    let free = hinge(ConstraintKind::SixDof(wide), 0.5, -0.5);
    let kinds = [ball(0.5, -0.5), hinge(ConstraintKind::Hinge { limits: None }, 0.5, -0.5), free];
    let joints: Vec<_> = (0..3).map(|i| world.add_constraint(bodies[i], bodies[i + 1], &kinds[i]).unwrap()).collect();
    assert!(world.articulate(&joints).is_some());
    for (i, &body) in bodies.iter().enumerate() {
        let i = i as f64;
        world.set_velocity(body, &Vector3::new(0.5, i, 1.0 - i), &Vector3::new(3.0 - i, i, 2.0 * i - 1.0));
    }
    (world, bodies)
}

/// Linear momentum, angular momentum about the origin, and kinetic energy.
fn conserved(world: &World, bodies: &[BodyHandle]) -> (Vector3<f64>, Vector3<f64>, f64) {
    let (mut linear, mut angular, mut energy) = (Vector3::zeros(), Vector3::zeros(), 0.0);
    for (&body, mass) in bodies.iter().zip([1.0, 2.0, 0.5, 1.5]) {
        let (pose, (v, w)) = (world.pose(body).unwrap(), world.velocity(body).unwrap());
        let inertia = Vector3::new(0.01, INERTIA, INERTIA) * mass;
        let own = pose.rotation * inertia.component_mul(&pose.rotation.inverse_transform_vector(&w));
        linear += v * mass;
        angular += pose.translation.vector.cross(&v) * mass + own;
        energy += (mass * v.norm_squared() + w.dot(&own)) / 2.0;
    }
    (linear, angular, energy)
}

#[test]
fn a_free_chain_keeps_energy_and_momenta_to_fourth_order() {
    let after = |steps: u32| {
        let (mut world, bodies) = thrown();
        let h = 1.0 / f64::from(steps);
        // The first step projects the velocities onto the joints.
        world.step(1e-9, 1, 1e-9);
        let before = conserved(&world, &bodies);
        (0..steps).for_each(|_| {
            world.step(h, 1, h);
        });
        for pair in bodies[..3].windows(2) {
            let [a, b] = [pair[0], pair[1]].map(|body| world.pose(body).unwrap());
            let gap = a * nalgebra::Point3::new(0.5, 0.0, 0.0) - b * nalgebra::Point3::new(-0.5, 0.0, 0.0);
            assert!(gap.norm() < 1e-12, "{gap}");
        }
        let now = conserved(&world, &bodies);
        let lost = [(now.0 - before.0).norm(), (now.1 - before.1).norm(), (now.2 - before.2).abs()];
        (poses(&world, &bodies), lost)
    };
    let (exact, lost) = after(16_000);
    assert!(lost.iter().all(|error| *error < 1e-9), "{lost:?}");
    let errors = [500, 1000].map(|steps| farthest(&after(steps).0, &exact));
    assert!(errors[1] < 1e-7, "{errors:?}");
    assert!((10.0..25.0).contains(&(errors[0] / errors[1])), "not of fourth order: {errors:?}");
}

#[test]
fn poses_and_velocities_that_are_set_last() {
    let (mut world, bodies, joints) = chain(&[1.0, 2.0]);
    joints.into_iter().for_each(|joint| assert!(world.remove_constraint(joint)));
    world.set_gravity(Vector3::zeros());
    let joints =
        [(0, 0.0), (1, 0.5)].map(|(i, at)| world.add_constraint(bodies[i], bodies[i + 1], &ball(at, -0.5)).unwrap());
    assert!(world.articulate(&joints).is_some());
    let turn = nalgebra::UnitQuaternion::from_euler_angles(0.4, -1.1, 2.0);
    let pose = Isometry3::from_parts((turn * Vector3::new(0.5, 0.0, 0.0)).into(), turn);
    let bend = turn * nalgebra::UnitQuaternion::from_euler_angles(-2.5, 0.3, 0.7);
    let end = turn * Vector3::x() + bend * Vector3::new(0.5, 0.0, 0.0);
    world.set_pose(bodies[1], &pose);
    world.set_pose(bodies[2], &Isometry3::from_parts(end.into(), bend));
    run(&mut world, 1);
    let seen = poses(&world, &bodies[1..]);
    assert!(seen[0].rotation.angle_to(&turn) < 1e-12 && seen[1].rotation.angle_to(&bend) < 1e-12, "{seen:?}");
    let omega = Vector3::new(0.3, -0.2, 0.5);
    world.set_velocity(bodies[1], &omega.cross(&(turn * Vector3::new(0.5, 0.0, 0.0))), &omega);
    world.set_velocity(bodies[2], &omega.cross(&end), &omega);
    run(&mut world, 1);
    for body in &bodies[1..] {
        let (_, seen) = world.velocity(*body).unwrap();
        assert!((seen - omega).norm() < 1e-2, "{seen}");
    }
}

#[test]
fn limits_of_a_rotation_hold_and_add_no_energy() {
    let range = [-0.5, 0.5];
    let cone = ConstraintKind::ConeTwist { swing1: 0.5, swing2: 0.5, twist: 0.3 };
    let six_dof = ConstraintKind::SixDof([[0.0; 2], [0.0; 2], [0.0; 2], [-0.3, 0.3], range, range]);
    // The two angles of a six-dof joint are limited each by itself.
    for (kind, most) in [(cone, 0.53), (six_dof, 0.73)] {
        for reversed in [false, true] {
            let mut world = World::with_articulations(Solver::Accurate);
            world.set_gravity(Vector3::new(0.0, -GRAVITY, 0.0));
            world.set_lag(false);
            let base = world.add_body(link(0.0, 0.0));
            let body = world.add_body(link(2.0, 0.5));
            let mut joint = hinge(kind.clone(), 0.0, -0.5);
            let (mut a, mut b) = (base, body);
            if reversed {
                std::mem::swap(&mut joint.frame_a, &mut joint.frame_b);
                (a, b) = (body, base);
            }
            let joint = world.add_constraint(a, b, &joint).unwrap();
            assert!(world.articulate(&[joint]).is_some());
            // It swings to a side, too, and twists.
            let omega = Vector3::new(2.0, 1.5, 0.0);
            world.set_velocity(body, &omega.cross(&Vector3::new(0.5, 0.0, 0.0)), &omega);
            let energy = |world: &World| {
                let (pose, (v, w)) = (world.pose(body).unwrap(), world.velocity(body).unwrap());
                let local = pose.rotation.inverse_transform_vector(&w);
                let kinetic = 2.0 * v.norm_squared()
                    + local.dot(&(Vector3::new(0.01, INERTIA, INERTIA) * 2.0).component_mul(&local));
                kinetic / 2.0 + 2.0 * GRAVITY * pose.translation.y
            };
            let first = energy(&world);
            for _ in 0..4000 {
                run(&mut world, 1);
                let pose = world.pose(body).unwrap();
                let swing = (pose.rotation * Vector3::x()).angle(&Vector3::x());
                assert!(swing < most, "{kind:?}, reversed {reversed}: {swing}");
                assert!(energy(&world) < first + 1e-3, "{kind:?}, reversed {reversed}: {} J", energy(&world) - first);
            }
            // The angles of a six-dof joint are Euler angles from its first body on.
            if reversed && most > 0.6 {
                continue;
            }
            let (roll, _, swing) = world.pose(body).unwrap().rotation.euler_angles();
            assert!(roll.abs() < 0.31, "{kind:?}, reversed {reversed}: twist {roll}");
            assert!((swing + 0.5).abs() < 3e-3, "{kind:?}, reversed {reversed}: swing {swing}");
        }
    }
}

#[test]
fn limits_of_displacements_hold() {
    let mut world = World::with_articulations(Solver::Accurate);
    world.set_gravity(Vector3::new(0.0, -GRAVITY, 0.0));
    world.set_lag(false);
    let base = world.add_body(link(0.0, 0.0));
    let body = world.add_body(link(2.0, 0.5));
    let joint = hinge(ConstraintKind::SixDof([[-0.1, 0.2]; 6]), 0.0, -0.5);
    let joint = world.add_constraint(base, body, &joint).unwrap();
    assert!(world.articulate(&[joint]).is_some());
    let pivot = |world: &World| world.pose(body).unwrap() * nalgebra::Point3::new(-0.5, 0.0, 0.0);
    // It falls by 0.1 m and tilts, because the limit holds it at its end.
    for _ in 0..3000 {
        run(&mut world, 1);
        assert!(pivot(&world).y > -0.11, "{}", pivot(&world));
    }
    let tilt = world.pose(body).unwrap().rotation.euler_angles().2;
    assert!((pivot(&world).y + 0.1).abs() < 1e-3 && (tilt + 0.2).abs() < 2e-2, "{}, {tilt} rad", pivot(&world));
    world.set_body_gravity(body, &Vector3::new(3.0, GRAVITY, 0.0));
    run(&mut world, 3000);
    assert!((pivot(&world).coords - Vector3::new(0.2, 0.2, 0.0)).norm() < 1e-3, "{}", pivot(&world));
}

#[test]
fn long_ropes_that_collide_stay_constraints() {
    let articulates = |links: usize, collides: bool| {
        let mut world = World::with_articulations(Solver::default());
        let shape = || if collides { Shape::sphere(0.01, 0.001) } else { Shape::empty() };
        let mass = |i: usize| if i == 0 { 0.0 } else { 1.0 };
        let bodies: Vec<_> =
            (0..=links).map(|i| world.add_body(RigidBody { shape: shape(), ..link(mass(i), i as f64) })).collect();
        let joints: Vec<_> =
            bodies.windows(2).map(|pair| world.add_constraint(pair[0], pair[1], &ball(0.5, -0.5)).unwrap()).collect();
        world.articulate(&joints).is_some()
    };
    assert!(articulates(33, true) && !articulates(34, true) && articulates(34, false));
}
