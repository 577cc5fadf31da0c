//! Rows of joints against the positions they stand for: a correction of positions leaves of the error of a joint what the
//! ERP says, and opens nothing else. The errors are computed by the module `assembly`, without Bullet.

use ambf_core::bullet::{BodyHandle, Constraint, ConstraintKind, Integrator, RigidBody, Solver, World};
use ambf_dynamics::assembly::{gap, Body, Gap, Joint, Kind, Omission, Range};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

const DT: f64 = 1e-3;
const MASS: f64 = 1.5;
const INERTIA: Vector3<f64> = Vector3::new(0.02, 0.03, 0.04);

fn body(mass: f64, pose: Isometry3<f64>) -> RigidBody {
    RigidBody { inertia: INERTIA * mass, pose, ..super::energy::body(mass, 0.0, 0.0, 0.0) }
}

fn turned(x: f64, y: f64, z: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z))
}

/// A joint whose frame B is at `between` in frame A, on bodies with crooked frames.
struct Case {
    name: &'static str,
    constraint: ConstraintKind,
    kind: Kind,
    between: Isometry3<f64>,
    /// Share of an angle beyond a limit that one correction leaves.
    left: f64,
}

fn cases() -> Vec<Case> {
    let case = |name, constraint, kind, between, left| Case { name, constraint, kind, between, left };
    let at = |x: f64, y: f64, z: f64, rotation| Isometry3::from_parts(Vector3::new(x, y, z).into(), rotation);
    let cone = |swing1, swing2, twist| {
        (
            ConstraintKind::ConeTwist { swing1, swing2, twist },
            Kind::ConeTwist { twist, swing_y: swing2, swing_z: swing1 },
        )
    };
    // Limits in Bullet's sign; the module `assembly` has angles of the opposite sign.
    let six = |limits: [[f64; 2]; 6]| Kind::SixDof {
        linear: std::array::from_fn(|i| Range::new(limits[i][0], limits[i][1])),
        angular: std::array::from_fn(|i| Range::new(-limits[i + 3][1], -limits[i + 3][0])),
    };
    let about_x = |angle: f64| turned(angle, 0.0, 0.0);
    let about_y = |angle: f64| turned(0.0, angle, 0.0);
    let about_z = |angle: f64| turned(0.0, 0.0, angle);
    // 1.001 beyond limits of ±1, and of 0.3 m.
    let (hinge, slider) = (ConstraintKind::Hinge { limits: Some([-1.0, 1.0]) }, [-0.3, 0.3]);
    let (elliptic, elliptic_kind) = cone(0.9, 0.2, 3.0);
    let (twisted, twisted_kind) = cone(1.2, 1.2, 0.5);
    // Locked along all axes but x, along which it has slid; and turned by 1.2 rad about y, where the gradients of the
    // other angles are 2.8 times as long as Bullet's axes.
    let slid = [[-1.0, 1.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]];
    let bent = [[0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [-0.3, 0.3], [-1.4, 1.4], [0.0, 0.0]];
    // Bullet has no row for a locked axis that is exactly at 0.
    let bent_pose = about_z(1e-6) * about_y(1.2) * about_x(0.301);
    vec![
        case(
            "hinge at its limit",
            hinge,
            Kind::Revolute(Range::new(-1.0, 1.0)),
            at(0.0, 0.0, 0.0, about_z(1.001)),
            0.73,
        ),
        case(
            "slider at its limit",
            ConstraintKind::Slider { limits: Some(slider) },
            Kind::Prismatic(Range::new(-0.3, 0.3)),
            at(0.3005, 0.0, 0.0, UnitQuaternion::identity()),
            0.1,
        ),
        case(
            "slider that is twisted",
            ConstraintKind::Slider { limits: Some(slider) },
            Kind::Prismatic(Range::new(-0.3, 0.3)),
            at(0.25, 0.0, 0.0, about_x(1e-3)),
            0.1,
        ),
        case("fixed", ConstraintKind::Fixed, Kind::Fixed, at(2e-4, -3e-4, 1e-4, turned(1e-3, 5e-4, -8e-4)), 0.1),
        case(
            "point to point",
            ConstraintKind::PointToPoint,
            Kind::PointToPoint,
            at(2e-4, -3e-4, 1e-4, turned(0.5, 0.3, 0.2)),
            0.1,
        ),
        // Obliquely to the axes of the ellipse, where its normal is 50 degrees from the swing.
        case("swing", elliptic, elliptic_kind, at(0.0, 0.0, 0.0, turned(0.0, 0.19, 0.3)), 0.7),
        case("twist after a swing", twisted, twisted_kind, at(0.0, 0.0, 0.0, about_y(0.9) * about_x(0.501)), 0.7),
        case(
            "six dof that has slid",
            ConstraintKind::SixDof(slid),
            six(slid),
            at(0.8, 3e-4, -2e-4, turned(1e-3, 1e-3, 1e-3)),
            0.1,
        ),
        case("six dof that is bent", ConstraintKind::SixDof(bent), six(bent), at(0.0, 0.0, 0.0, bent_pose), 0.1),
        case(
            "spring that has slid",
            ConstraintKind::SixDofSpring { limits: slid, springs: [None; 6] },
            six(slid),
            at(0.8, 3e-4, -2e-4, turned(1e-3, 1e-3, 1e-3)),
            0.1,
        ),
    ]
}

/// Error of the joint before and after one sub-step, in which both bodies stay at rest.
fn corrected(case: &Case, mass_a: f64) -> [Gap; 2] {
    let mut world = World::new(Solver::Accurate);
    world.set_integrator(Integrator::RungeKutta);
    let pose_a = Isometry3::from_parts(Vector3::new(0.1, -0.2, 0.3).into(), turned(0.4, -0.7, 1.1));
    let frame_a = Isometry3::from_parts(Vector3::new(0.3, 0.1, -0.2).into(), turned(-0.3, 0.8, 0.2));
    let frame_b = Isometry3::from_parts(Vector3::new(-0.1, 0.35, 0.15).into(), turned(1.0, 0.2, -0.6));
    let pose_b = pose_a * frame_a * case.between * frame_b.inverse();
    let handles = [world.add_body(body(mass_a, pose_a)), world.add_body(body(MASS, pose_b))];
    let constraint = Constraint {
        kind: case.constraint.clone(),
        frame_a,
        frame_b,
        parameters: vec![],
        feedback: false,
        disable_collisions: true,
    };
    world.add_constraint(handles[0], handles[1], &constraint).expect("two bodies");
    let error = |world: &World| {
        let pose = |handle: BodyHandle| world.pose(handle).expect("alive");
        let described = |handle| Body { pose: pose(handle), mass: MASS, inertia: INERTIA, movable: true };
        gap(
            &Joint { kind: case.kind, bodies: [0, 1], frames: [frame_a, frame_b], omission: Omission::NONE },
            &handles.map(described),
        )
    };
    let before = error(&world);
    world.step(DT, 1, DT);
    for handle in handles {
        let (linear, angular) = world.velocity(handle).expect("alive");
        assert!(linear.norm() + angular.norm() < 1e-9, "{}: a correction leaves no velocity", case.name);
    }
    [before, error(&world)]
}

#[test]
fn a_correction_removes_errors_and_opens_nothing() {
    for case in cases() {
        for mass_a in [0.0, 2.0] {
            let [before, after] = corrected(&case, mass_a);
            println!("{} ({mass_a} kg): {before:?} -> {after:?}", case.name);
            assert!(before.exceeds(1e-4, 1e-4), "{}: {before:?}", case.name);
            // To second order in the motion of the correction.
            let slack = 3.0 * (before.distance + before.angle).powi(2) + 1e-9;
            assert!(after.distance <= 0.11 * before.distance + slack, "{}: {before:?} {after:?}", case.name);
            assert!(after.angle <= (case.left + 0.01) * before.angle + slack, "{}: {before:?} {after:?}", case.name);
        }
    }
}

/// The bodies move along tangents: without a target for the curvature of their paths they would part at ω² r h / 2, which
/// is 0.5 m/s here.
#[test]
fn a_motor_holds_a_slider_that_spins() {
    const SPIN: f64 = 40.0;
    let mut world = World::new(Solver::Accurate);
    world.set_integrator(Integrator::RungeKutta);
    let poses = [Vector3::new(-0.3, -0.2, 0.1), Vector3::new(0.3, 0.2, -0.1)]
        .map(|at| Isometry3::translation(at.x, at.y, at.z));
    let handles = poses.map(|pose| world.add_body(RigidBody { inertia: Vector3::repeat(0.05), ..body(MASS, pose) }));
    let frames = [Isometry3::translation(0.4, 0.25, 0.0), Isometry3::translation(-0.2, -0.15, 0.2)];
    let constraint = Constraint {
        kind: ConstraintKind::Slider { limits: None },
        frame_a: frames[0],
        frame_b: frames[1],
        parameters: vec![],
        feedback: false,
        disable_collisions: true,
    };
    let slider = world.add_constraint(handles[0], handles[1], &constraint).expect("two bodies");
    assert!(world.set_motor(slider, true, 0.0, 1e6));
    let omega = Vector3::z() * SPIN;
    for (handle, pose) in handles.iter().zip(&poses) {
        world.set_velocity(*handle, &omega.cross(&pose.translation.vector), &omega);
    }
    let state = |world: &World| {
        let [a, b] = handles.map(|handle| world.pose(handle).expect("alive"));
        let energy = handles.map(|handle| {
            let (linear, angular) = world.velocity(handle).expect("alive");
            MASS * linear.norm_squared() / 2.0 + 0.05 * angular.norm_squared() / 2.0
        });
        (((a * frames[0]).inverse() * (b * frames[1])).translation.x, energy[0] + energy[1])
    };
    let (start, energy) = state(&world);
    let mut moved = 0.0f64;
    for _ in 0..500 {
        world.step(DT, 1, DT);
        moved = moved.max((state(&world).0 - start).abs());
    }
    let lost = 1.0 - state(&world).1 / energy;
    assert!(moved < 2e-3 && lost.abs() < 1e-3, "moved {moved} m, lost {lost} of its energy");
}

/// By radians in each sub-step, where Bullet turns bodies by π/4 at most.
#[test]
fn a_drill_turns_as_far_as_it_spins() {
    const SPIN: f64 = 3000.0;
    let mut world = World::new(Solver::Accurate);
    world.set_integrator(Integrator::RungeKutta);
    let stand = world.add_body(body(0.0, Isometry3::identity()));
    let drill = RigidBody { inertia: Vector3::new(1e-5, 1e-5, 1e-8), ..body(0.02, Isometry3::identity()) };
    let drill = world.add_body(drill);
    let pivot = Isometry3::translation(0.0, 0.0, -0.03);
    let hinge = Constraint {
        kind: ConstraintKind::Hinge { limits: None },
        frame_a: pivot,
        frame_b: pivot,
        parameters: vec![],
        feedback: false,
        disable_collisions: true,
    };
    world.add_constraint(stand, drill, &hinge).expect("two bodies");
    world.set_velocity(drill, &Vector3::zeros(), &(Vector3::z() * SPIN));
    let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * SPIN * DT);
    for _ in 0..200 {
        let before = world.pose(drill).expect("alive").rotation;
        world.step(DT, 1, DT);
        let after = world.pose(drill).expect("alive").rotation;
        assert!((after * before.inverse()).angle_to(&turn) < 1e-6, "{after} after {before}");
    }
    let spin = world.velocity(drill).expect("alive").1;
    assert!((spin - Vector3::z() * SPIN).norm() < 1e-6 * SPIN, "{spin}");
}
