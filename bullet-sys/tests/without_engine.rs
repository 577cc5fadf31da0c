//! Worlds without an engine are plain Bullet's, whatever solver and kind is asked for.

use std::ptr;

use bullet_sys::*;

const DT: f64 = 1e-3;
const STEPS: i32 = 200;
const GRAVITY: f64 = -9.81;

fn pose(x: f64) -> [f64; 12] {
    [x, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
}

/// Two balls, the second at x = 1 m, after [`STEPS`] steps under gravity along z: joined by a hinge about y through the
/// first, which is static then, or free. Origin and velocity of the second.
fn second_ball(solver: i32, kind: u32, hinged: bool) -> ([f64; 3], [f64; 6]) {
    let (mut at, mut velocity) = ([0.0; 12], [0.0; 6]);
    // SAFETY: everything is freed once, in the order that the headers ask for; arrays have the sizes that they name.
    unsafe {
        let world = amb_world_new(solver, kind as i32, 32, ptr::null_mut(), ptr::null());
        amb_world_set_gravity(world, [0.0, 0.0, GRAVITY].as_ptr());
        let shape = amb_shape_sphere(0.1, 0.001);
        let first_mass = if hinged { 0.0 } else { 1.0 };
        let bodies = [(0.0, first_mass), (1.0, 1.0)]
            .map(|(x, mass)| amb_body_new(mass, [0.004; 3].as_ptr(), shape, pose(x).as_ptr()));
        for (body, handle) in bodies.into_iter().zip(1..) {
            amb_world_add_body(world, body, handle);
        }
        // Frames whose z axis is the bodies' y axis, at the first ball.
        let frame = |x: f64| [x, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0];
        let hinge = hinged.then(|| amb_hinge_new(bodies[0], bodies[1], frame(0.0).as_ptr(), frame(-1.0).as_ptr()));
        if let Some(hinge) = hinge {
            amb_world_add_constraint(world, hinge, 1);
        }
        for _ in 0..STEPS {
            assert_eq!(amb_world_step(world, DT, 1, DT), 1);
        }
        amb_body_pose(bodies[1], at.as_mut_ptr());
        amb_body_velocity(bodies[1], velocity.as_mut_ptr());
        if let Some(hinge) = hinge {
            let mut angle = 0.0;
            let reading = AmbReading::AmbReading_HingeAngle as u8;
            amb_constraints_read([hinge].as_ptr(), &reading, 1, &mut angle);
            let expected = (-at[2]).atan2(at[0]);
            assert!((angle.abs() - expected).abs() < 1e-3, "{angle} rad, the ball is at {expected} rad");
            amb_world_remove_constraint(world, hinge);
            amb_constraint_free(hinge);
        }
        for body in bodies {
            amb_world_remove_body(world, body);
            amb_body_free(body);
        }
        amb_world_free(world);
        amb_shape_free(shape);
    }
    ([at[0], at[1], at[2]], velocity)
}

#[test]
fn bodies_fall_in_every_kind_of_world_and_with_every_solver() {
    use AmbSolver::*;
    use AmbWorldKind::*;
    let n = f64::from(STEPS);
    for kind in [AmbWorldKind_Rigid, AmbWorldKind_Soft, AmbWorldKind_Articulated] {
        for solver in AmbSolver_SequentialImpulse..=AmbSolver_Accurate {
            let (at, velocity) = second_ball(solver as i32, kind, false);
            assert!((velocity[2] - GRAVITY * n * DT).abs() < 1e-12, "{kind} {solver}: {velocity:?}");
            // Semi-implicit Euler.
            let fallen = GRAVITY * DT * DT * n * (n + 1.0) / 2.0;
            assert!((at[2] - fallen).abs() < 1e-12 && at[0] == 1.0, "{kind} {solver}: {at:?}");
        }
    }
}

#[test]
fn what_an_engine_would_solve_is_solved_by_sequential_impulses() {
    let plain = second_ball(AmbSolver::AmbSolver_SequentialImpulse as i32, AmbWorldKind::AmbWorldKind_Rigid, true);
    let asked = second_ball(AmbSolver::AmbSolver_Accurate as i32, AmbWorldKind::AmbWorldKind_Articulated, true);
    assert_eq!(plain, asked);
    let [x, _, z] = plain.0;
    assert!((x.hypot(z) - 1.0).abs() < 1e-3, "the hinge holds it: {plain:?}");
}
