//! Trees, loops, contradictions, limits and masses.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::{assemble, assemble_coupled, gap, omit_redundant_rows, Body, Coupling, Joint, Kind, Omission, Range};

/// Largest error of a closed joint, m and rad.
const CLOSED: f64 = 1e-12;

fn at(x: f64, y: f64, z: f64) -> Isometry3<f64> {
    Isometry3::translation(x, y, z)
}

fn turned(axis: Vector3<f64>) -> Isometry3<f64> {
    Isometry3::rotation(axis)
}

/// A rod of 1 kg and 1 m along x, or whatever is at `pose`.
fn rod(pose: Isometry3<f64>) -> Body {
    Body { pose, mass: 1.0, inertia: Vector3::new(0.01, 0.08, 0.09), movable: true }
}

fn ground() -> Body {
    Body { pose: Isometry3::identity(), mass: 0.0, inertia: Vector3::zeros(), movable: false }
}

fn joint(kind: Kind, bodies: [usize; 2], frames: [Isometry3<f64>; 2]) -> Joint {
    Joint { kind, bodies, frames, omission: Omission::NONE }
}

/// Whatever errors couplings have, m and rad.
fn coupling_errors(bodies: &[Body], joints: &[Joint], couplings: &[Coupling]) -> f64 {
    let q = |index: usize| {
        let Joint { kind, bodies: of, frames, .. } = &joints[index];
        let between = (bodies[of[0]].pose * frames[0]).inverse() * bodies[of[1]].pose * frames[1];
        if matches!(kind, Kind::Revolute(_)) {
            between.rotation.scaled_axis().z
        } else {
            between.translation.x
        }
    };
    let error = |coupling: &Coupling| {
        q(coupling.follower)
            - coupling.leaders.iter().map(|&(joint, ratio)| ratio * q(joint)).sum::<f64>()
            - coupling.offset
    };
    couplings.iter().map(|coupling| error(coupling).abs()).fold(0.0, f64::max)
}

#[test]
fn coupled_joints_are_closed_with_the_least_motion() {
    // A screw and a differential on the ground; the loop of a parallelogram whose cranks are coupled is closed, too.
    let slide = Kind::Prismatic(Range::FREE);
    let on = |body: usize, kind: Kind, y: f64| joint(kind, [0, body], [at(0.0, y, 0.0), Isometry3::identity()]);
    let couplings = [
        Coupling { follower: 1, leaders: vec![(0, 0.1)], offset: 0.2 },
        Coupling { follower: 2, leaders: vec![(0, 0.5), (1, -2.0)], offset: 0.0 },
    ];
    let joints = [on(1, HINGE, 0.0), on(2, slide, 1.0), on(3, HINGE, 2.0)];
    let mut bodies = vec![ground(), rod(turned(Vector3::z() * 0.3)), rod(at(0.1, 1.0, 0.0)), rod(at(0.0, 2.0, 0.0))];
    assert!(assemble_coupled(&mut bodies, &joints, &couplings));
    all_closed(&joints, &bodies);
    assert!(coupling_errors(&bodies, &joints, &couplings) < CLOSED);
    // All three give way.
    assert!((bodies[1].pose.rotation.angle() - 0.3).abs() > 1e-3 && (bodies[2].pose.translation.x - 0.1).abs() > 1e-3);
    let closed = bodies.clone();
    assert!(assemble_coupled(&mut bodies, &joints, &couplings));
    assert_eq!(bodies, closed, "closed ones keep every bit");

    // Two couplings of one joint contradict each other.
    let other = Coupling { offset: 0.3, ..couplings[0].clone() };
    assert!(!assemble_coupled(&mut bodies, &joints, &[couplings[0].clone(), other]));
    all_closed(&joints, &bodies);
}

const HINGE: Kind = Kind::Revolute(Range::FREE);

/// Numbers in -1…1 that look random.
struct Numbers(u32);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(self.0 >> 8) / f64::from(1u32 << 23) - 1.0
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::new(self.next(), self.next(), self.next())
    }

    /// Shifts and turns a pose by up to `distance` m and `angle` rad an axis.
    fn disturb(&mut self, pose: &mut Isometry3<f64>, distance: f64, angle: f64) {
        pose.translation.vector += self.vector() * distance;
        pose.rotation = UnitQuaternion::from_scaled_axis(self.vector() * angle) * pose.rotation;
    }
}

#[track_caller]
fn all_closed(joints: &[Joint], bodies: &[Body]) {
    for (index, joint) in joints.iter().enumerate() {
        let gap = gap(joint, bodies);
        assert!(!gap.exceeds(CLOSED, CLOSED), "joint {index}: {gap:?}");
    }
}

/// Half the sum of squared displacements, each with its mass or moment, kg·m².
fn cost(bodies: &[Body], from: &[Body]) -> f64 {
    let of = |(body, from): (&Body, &Body)| {
        let turn = (from.pose.rotation.inverse() * body.pose.rotation).scaled_axis();
        let shift = body.pose.translation.vector - from.pose.translation.vector;
        0.5 * (body.mass * shift.norm_squared() + body.inertia.dot(&turn.component_mul(&turn)))
    };
    bodies.iter().zip(from).filter(|(body, _)| body.movable).map(of).sum()
}

/// A tree of `n` bodies on the ground with joints of all kinds, closed.
fn tree(n: usize) -> (Vec<Body>, Vec<Joint>) {
    let mut numbers = Numbers(1);
    let (mut bodies, mut joints) = (vec![ground()], Vec::new());
    let kinds = [
        HINGE,
        Kind::Prismatic(Range::new(-0.1, 0.1)),
        Kind::Fixed,
        Kind::PointToPoint,
        Kind::ConeTwist { twist: 0.4, swing_y: 0.5, swing_z: 0.6 },
        Kind::SixDof {
            linear: [Range::LOCKED; 3],
            angular: [Range::new(-0.3, 0.3), Range::LOCKED, Range::new(-0.1, 0.2)],
        },
        Kind::Revolute(Range::new(-0.1, 0.1)),
    ];
    for index in 1..=n {
        let parent = if index % 5 == 0 { index / 2 } else { index - 1 };
        let frame = |numbers: &mut Numbers| {
            let rotation = UnitQuaternion::from_scaled_axis(numbers.vector());
            Isometry3::from_parts(Translation3::from(numbers.vector() * 0.5), rotation)
        };
        let frames = [frame(&mut numbers), frame(&mut numbers)];
        let mass = 10f64.powf(2.0 * numbers.next());
        let pose = bodies[parent].pose * frames[0] * frames[1].inverse();
        bodies.push(Body {
            pose,
            mass,
            inertia: (numbers.vector() + Vector3::repeat(1.5)) * 0.02 * mass,
            movable: true,
        });
        joints.push(joint(kinds[index % kinds.len()], [parent, index], frames));
    }
    (bodies, joints)
}

#[test]
fn a_tree_closes_however_far_its_base_was_moved() {
    for (turn, inertia) in [(0.5, 1.0), (2.0, 1e-6), (3.0, 1e-9)] {
        let (mut bodies, joints) = tree(60);
        let mut numbers = Numbers(3);
        bodies[0].pose = Isometry3::new(Vector3::new(0.8, 0.3, 0.5), numbers.vector() * turn);
        bodies.iter_mut().for_each(|body| body.inertia *= inertia);
        let ground = bodies[0].pose;
        assert!(assemble(&mut bodies, &joints), "{turn} rad, {inertia}");
        all_closed(&joints, &bodies);
        assert_eq!(bodies[0].pose, ground);
    }
}

#[test]
fn trees_close_exactly_and_the_ground_stays() {
    let (mut bodies, joints) = tree(200);
    all_closed(&joints, &bodies);
    let mut numbers = Numbers(7);
    for body in &mut bodies[1..] {
        numbers.disturb(&mut body.pose, 2e-3, 5e-3);
    }
    let before = bodies.clone();
    assert!(assemble(&mut bodies, &joints));
    all_closed(&joints, &bodies);
    assert_eq!(bodies[0], before[0]);
    for (body, before) in bodies.iter().zip(&before) {
        let moved = (body.pose.translation.vector - before.pose.translation.vector).norm();
        assert!(moved < 0.05, "{moved}");
    }
}

#[test]
fn what_is_closed_keeps_every_bit_and_so_does_what_no_joint_holds() {
    // Poses whose products are exact.
    let mut bodies = vec![ground(), rod(at(0.5, 0.0, 0.0)), rod(at(3.0, 0.1, 0.2)), rod(at(1.5, 0.0, 0.25))];
    let joints = [
        joint(HINGE, [0, 1], [at(0.0, 0.0, 0.0), at(-0.5, 0.0, 0.0)]),
        joint(Kind::PointToPoint, [1, 3], [at(0.5, 0.0, 0.25), at(-0.5, 0.0, 0.0)]),
    ];
    let before = bodies.clone();
    assert!(assemble(&mut bodies, &joints));
    assert_eq!(bodies, before);
}

/// A four-bar linkage of hinges about z: crank, coupler and rocker on the ground.
fn four_bar() -> (Vec<Body>, Vec<Joint>) {
    let bodies = vec![
        ground(),
        rod(at(0.0, 0.5, 0.0) * turned(Vector3::z() * FRAC_PI_2)),
        rod(at(0.5, 1.0, 0.0)),
        rod(at(1.0, 0.5, 0.0) * turned(Vector3::z() * -FRAC_PI_2)),
    ];
    let (back, front) = (at(-0.5, 0.0, 0.0), at(0.5, 0.0, 0.0));
    let joints = vec![
        joint(HINGE, [0, 1], [at(0.0, 0.0, 0.0), back]),
        joint(HINGE, [1, 2], [front, back]),
        joint(HINGE, [2, 3], [front, back]),
        joint(HINGE, [3, 0], [front, at(1.0, 0.0, 0.0)]),
    ];
    (bodies, joints)
}

#[test]
fn a_four_bar_linkage_that_is_off_by_a_millimetre_closes() {
    // Hinges about parallel axes: three of the rows are redundant.
    let (mut bodies, joints) = four_bar();
    let mut numbers = Numbers(3);
    for body in &mut bodies[1..] {
        numbers.disturb(&mut body.pose, 1e-3, 1e-3);
    }
    let before = bodies.clone();
    assert!(assemble(&mut bodies, &joints));
    all_closed(&joints, &bodies);
    for (body, before) in bodies.iter().zip(&before) {
        let moved = (body.pose.translation.vector - before.pose.translation.vector).norm();
        assert!(moved < 4e-3, "{moved}");
    }
}

#[test]
fn displacements_are_least_in_the_metric_of_the_masses() {
    let (mut bodies, joints) = four_bar();
    (bodies[1].mass, bodies[2].mass) = (5.0, 0.3);
    let mut numbers = Numbers(5);
    for body in &mut bodies[1..] {
        numbers.disturb(&mut body.pose, 1e-3, 1e-3);
    }
    let file = bodies.clone();
    assert!(assemble(&mut bodies, &joints));
    let least = cost(&bodies, &file);
    // The one motion that the linkage has: each other pose on its joints is farther from the file.
    for angle in [-1e-3, -1e-4, 1e-4, 1e-3] {
        let mut others = bodies.clone();
        let turn = turned(Vector3::z() * angle);
        others[1].pose = turn * others[1].pose;
        others[3].pose = at(1.0, 0.0, 0.0) * turn * at(-1.0, 0.0, 0.0) * others[3].pose;
        others[2].pose.translation.vector += Vector3::new(-angle, 0.0, 0.0);
        assert!(cost(&others, &file) > least, "{angle}: {} {least}", cost(&others, &file));
    }
}

#[test]
fn a_heavy_body_moves_less_than_a_light_one() {
    // The gap is on the line through the centres of mass: nothing turns.
    let mut bodies = vec![rod(at(0.0, 0.0, 0.0)), rod(at(1.01, 0.0, 0.0))];
    bodies[1].mass = 9.0;
    let joints = [joint(Kind::PointToPoint, [0, 1], [at(0.5, 0.0, 0.0), at(-0.5, 0.0, 0.0)])];
    assert!(assemble(&mut bodies, &joints));
    all_closed(&joints, &bodies);
    assert!((bodies[0].pose.translation.x - 0.009).abs() < 1e-12, "{}", bodies[0].pose);
    assert!((bodies[1].pose.translation.x - 1.009).abs() < 1e-12, "{}", bodies[1].pose);
    assert!(bodies.iter().all(|body| body.pose.rotation.angle() < 1e-12));
}

#[test]
fn contradictory_joints_end_at_the_least_squares_compromise() {
    // Two fixed joints to the ground that ask for places 2 mm apart, and another island.
    let mut bodies = vec![ground(), rod(at(0.3, 0.0, 0.0)), rod(at(5.0, 0.001, 0.0))];
    let joints = [
        joint(Kind::Fixed, [0, 1], [at(0.0, 0.0, 0.001), at(-0.3, 0.0, 0.0)]),
        joint(Kind::Fixed, [0, 1], [at(0.0, 0.0, -0.001), at(-0.3, 0.0, 0.0)]),
        joint(Kind::Prismatic(Range::FREE), [0, 2], [at(4.0, 0.0, 0.0), at(0.0, 0.0, 0.0)]),
    ];
    assert!(!assemble(&mut bodies, &joints));
    assert!(
        bodies[1].pose.translation.vector.metric_distance(&Vector3::new(0.3, 0.0, 0.0)) < 1e-9,
        "{}",
        bodies[1].pose
    );
    for joint in &joints[..2] {
        let gap = gap(joint, &bodies);
        assert!((gap.distance - 1e-3).abs() < 1e-5 && gap.angle < 1e-5, "{gap:?}");
    }
    all_closed(&joints[2..], &bodies);
    // Again from there: nothing is left to gain.
    let before = bodies.clone();
    assemble(&mut bodies, &joints);
    let moved = bodies[1].pose.translation.vector.metric_distance(&before[1].pose.translation.vector);
    assert!(moved < 1e-8, "{moved}");
}

#[test]
fn the_compromise_does_not_depend_on_the_axes_of_the_frames() {
    // Thin rods in a triangle whose hinges are not parallel.
    let thin = |pose| Body { inertia: Vector3::new(1e-4, 0.08, 0.09), ..rod(pose) };
    let closed_with = |turn: f64| {
        let mut bodies =
            vec![ground(), thin(at(0.5, 0.0, 0.0)), thin(at(1.0, 0.5, 0.0) * turned(Vector3::z() * FRAC_PI_2))];
        let about = Isometry3::rotation(Vector3::z() * turn);
        let frame = |x: f64, skew: Vector3<f64>| at(x, 0.0, 0.0) * turned(skew) * about;
        let level = Vector3::zeros();
        let joints = [
            joint(HINGE, [0, 1], [frame(0.0, level), frame(-0.5, Vector3::x() * 0.2)]),
            joint(HINGE, [1, 2], [frame(0.5, Vector3::y() * 0.1), frame(-0.5, level)]),
            joint(HINGE, [2, 0], [frame(0.5, level), at(1.0, 1.0, 0.0) * turned(Vector3::x() * 0.1) * about]),
        ];
        assert!(!assemble(&mut bodies, &joints));
        bodies
    };
    let level = closed_with(0.0);
    for turn in [0.3, 0.8, 1.4] {
        for (body, other) in level.iter().zip(&closed_with(turn)).skip(1) {
            let apart = body.pose.inverse() * other.pose;
            assert!(apart.translation.vector.norm() < 1e-6 && apart.rotation.angle() < 1e-6, "{turn} rad: {apart}");
        }
    }
}

#[test]
fn a_loop_that_is_too_short_is_stretched_and_named() {
    // Two rods of 1 m cannot reach 2.1 m.
    let mut bodies = vec![ground(), rod(at(0.5, 0.0, 0.0)), rod(at(1.6, 0.0, 0.0))];
    let (back, front) = (at(-0.5, 0.0, 0.0), at(0.5, 0.0, 0.0));
    let joints = [
        joint(HINGE, [0, 1], [at(0.0, 0.0, 0.0), back]),
        joint(HINGE, [1, 2], [front, back]),
        joint(HINGE, [2, 0], [front, at(2.1, 0.0, 0.0)]),
    ];
    assert!(!assemble(&mut bodies, &joints));
    let gaps: Vec<f64> = joints.iter().map(|joint| gap(joint, &bodies).distance).collect();
    assert!((gaps.iter().sum::<f64>() - 0.1).abs() < 1e-9, "{gaps:?}");
    assert!(gaps.iter().all(|&gap| gap > 0.01), "{gaps:?}");
}

#[test]
fn limits_that_are_violated_are_met_and_others_leave_alone() {
    let range = Range::new(-0.2, 0.1);
    let cases = [
        (Kind::Revolute(range), turned(Vector3::z() * 0.4), turned(Vector3::z() * 0.1)),
        (Kind::Revolute(range), turned(Vector3::z() * -0.4), turned(Vector3::z() * -0.2)),
        (Kind::Revolute(Range::new(3.0, 3.2)), turned(Vector3::z() * -3.0), turned(Vector3::z() * 3.2)),
        (Kind::Prismatic(range), at(0.4, 0.0, 0.0), at(0.1, 0.0, 0.0)),
        (
            Kind::ConeTwist { twist: 0.1, swing_y: 0.2, swing_z: 0.3 },
            turned(Vector3::y() * 0.5),
            turned(Vector3::y() * 0.2),
        ),
        (
            Kind::SixDof { linear: [range; 3], angular: [range; 3] },
            at(0.3, -0.1, -0.5) * turned(Vector3::y() * 0.5),
            at(0.1, -0.1, -0.2) * turned(Vector3::y() * 0.1),
        ),
    ];
    for (kind, file, expected) in cases {
        // About its centre of mass nothing is shifted by a rotation.
        let mut bodies = vec![ground(), rod(file)];
        let joints = [joint(kind, [0, 1], [Isometry3::identity(); 2])];
        assert!(assemble(&mut bodies, &joints), "{kind:?}");
        all_closed(&joints, &bodies);
        let pose = &bodies[1].pose;
        let error =
            (pose.translation.vector - expected.translation.vector).norm() + pose.rotation.angle_to(&expected.rotation);
        assert!(error < 1e-9, "{kind:?}: {pose} instead of {expected}");
    }
    let inside = Kind::Revolute(range);
    let mut bodies = vec![ground(), rod(turned(Vector3::z() * 0.05))];
    let before = bodies.clone();
    assert!(assemble(&mut bodies, &[joint(inside, [0, 1], [Isometry3::identity(); 2])]));
    assert_eq!(bodies, before);
}

#[test]
fn a_limit_against_which_other_joints_push_holds() {
    // A slider on the ground that a spring-loaded partner of the loop would pull beyond its limit.
    let mut bodies = vec![ground(), rod(at(0.09, 0.0, 0.0)), rod(at(0.3, 0.0, 0.0))];
    let joints = [
        joint(Kind::Prismatic(Range::new(-0.1, 0.1)), [0, 1], [Isometry3::identity(); 2]),
        joint(Kind::PointToPoint, [1, 2], [Isometry3::identity(), at(-0.1, 0.0, 0.0)]),
    ];
    assert!(assemble(&mut bodies, &joints));
    all_closed(&joints, &bodies);
    assert!((bodies[1].pose.translation.x - 0.1).abs() < 1e-9, "{}", bodies[1].pose);
    assert!((bodies[2].pose.translation.x - 0.2).abs() < 1e-9, "{}", bodies[2].pose);
}

#[test]
fn inertias_of_no_use_break_nothing() {
    for inertia in [Vector3::zeros(), Vector3::new(1e-12, 1.0, 1.0), Vector3::repeat(1e-15), Vector3::repeat(1e4)] {
        let (mut bodies, joints) = four_bar();
        bodies[2].inertia = inertia;
        bodies[3].mass = 0.0;
        bodies[2].pose.translation.x += 1e-3;
        bodies[3].pose.translation.y += 1e-3;
        assert!(assemble(&mut bodies, &joints), "{inertia}");
        all_closed(&joints, &bodies);
        let turn = bodies[2].pose.rotation.angle();
        assert!(turn < 0.01 && (inertia != Vector3::zeros() || turn == 0.0), "{inertia}: {turn}");
    }
}

#[test]
fn bodies_far_off_are_brought_to_their_joints() {
    // A robot all links of which lie at the origin, as converters leave them, and a weld turned by half a turn.
    let mut bodies = vec![ground()];
    let mut joints = Vec::new();
    for index in 1..=8 {
        bodies.push(rod(Isometry3::identity()));
        let turn = if index % 2 == 0 { FRAC_PI_2 } else { 0.0 };
        let frames = [at(0.5, 0.0, 0.0) * turned(Vector3::x() * turn), at(-0.5, 0.0, 0.0)];
        joints.push(joint(Kind::Revolute(Range::new(-1.0, 1.0)), [index - 1, index], frames));
    }
    bodies.push(rod(at(3.0, 2.0, 1.0) * turned(Vector3::new(3.1, 0.2, 0.1))));
    joints.push(joint(Kind::Fixed, [0, 9], [Isometry3::identity(); 2]));
    assert!(assemble(&mut bodies, &joints));
    all_closed(&joints, &bodies);
}

#[test]
fn a_rope_that_is_too_long_for_its_ends_buckles() {
    // Alternating hinges with limits, every link 2 % too long.
    let (n, length, spacing) = (70, 0.042, 0.0412);
    let (mut bodies, mut joints) = (vec![ground()], Vec::new());
    for index in 1..n {
        let pose = at(0.0, 0.0, spacing * index as f64);
        bodies.push(Body { pose, mass: 0.002, inertia: Vector3::repeat(2e-7), movable: true });
    }
    for index in 0..n {
        let turn = turned(if index % 2 == 0 { Vector3::x() * FRAC_PI_2 } else { Vector3::y() * FRAC_PI_2 });
        let up = at(0.0, 0.0, length);
        let kind = Kind::Revolute(Range::new(-0.175, 0.175));
        let (child, frame) =
            if index + 1 < n { (index + 1, turn) } else { (0, at(0.0, 0.0, spacing * n as f64) * turn) };
        joints.push(joint(kind, [index, child], [up * turn, frame]));
    }
    // A rope that is straight to the last bit stays so.
    let mut numbers = Numbers(11);
    bodies[1..].iter_mut().for_each(|body| numbers.disturb(&mut body.pose, 1e-4, 1e-4));
    assert!(assemble(&mut bodies, &joints));
    all_closed(&joints, &bodies);
    for (index, body) in bodies.iter().enumerate() {
        assert!((body.pose.translation.vector - Vector3::z() * spacing * index as f64).norm() < 0.3, "{}", body.pose);
    }
}

/// Bars of 1 m along y on the ground at `feet` along x, which hold a rail along x above them. Each joint is off by up to
/// `error` m and rad. The ground is the first body, the rail the second.
fn bars(feet: &[f64], error: f64, numbers: &mut Numbers) -> (Vec<Body>, Vec<Joint>) {
    let mut bodies = vec![ground(), rod(at(0.5, 1.0, 0.0))];
    let mut joints = Vec::new();
    for &foot in feet {
        let bar = bodies.len();
        bodies.push(rod(at(foot, 0.5, 0.0)));
        let mut frames = [[at(foot, 0.0, 0.0), at(0.0, -0.5, 0.0)], [at(foot - 0.5, 0.0, 0.0), at(0.0, 0.5, 0.0)]];
        frames.iter_mut().flatten().for_each(|frame| numbers.disturb(frame, error, error));
        let [below, above] = frames;
        joints.push(joint(HINGE, [0, bar], below));
        joints.push(joint(HINGE, [1, bar], above));
    }
    (bodies, joints)
}

/// Turns the first bar to `angle` and closes the rest; the joint with the bar's foot is locked there.
fn turn_first_bar(bodies: &mut [Body], joints: &[Joint], angle: f64) -> bool {
    let mut joints = joints.to_vec();
    joints[0].kind = Kind::Revolute(Range::new(angle, angle));
    assemble(bodies, &joints)
}

#[test]
fn rows_that_lock_an_inaccurate_mechanism_are_left_out() {
    let mut numbers = Numbers(7);
    for round in 0..20 {
        let (mut bodies, mut joints) = bars(&[0.0, 1.0, 0.4], 5e-4, &mut numbers);
        // A ball joint holds a point of the rail's far end on its circle: a bar without hinges.
        let reach = bodies.len();
        bodies.push(rod(at(1.5, 0.5, 0.0)));
        joints.push(joint(Kind::PointToPoint, [0, reach], [at(1.5, 5e-4, 0.0), at(0.0, -0.5, 0.0)]));
        joints.push(joint(HINGE, [1, reach], [at(1.0, 0.0, 0.0), at(0.0, 0.5, 0.0)]));
        assemble(&mut bodies, &joints);
        let mut locked = bodies.clone();
        assert!(!turn_first_bar(&mut locked, &joints, 0.3), "round {round}: the joints lock it");
        let omitted = omit_redundant_rows(&bodies, &mut joints);
        let rows: usize = joints.iter().map(|joint| joint.omission.count()).sum();
        // 4 bodies of 6 coordinates + 1, less the one motion that is left, less 33 + 5 rows.
        assert_eq!(rows, 38 - 29, "round {round}");
        let mut misfits = omitted.iter().flat_map(|loops| &loops.omitted);
        assert!(misfits.all(|(_, misfit)| !misfit.exceeds(0.01, 0.01)), "round {round}: {omitted:?}");
        for angle in [0.0, 0.3, -0.6] {
            assert!(turn_first_bar(&mut bodies, &joints, angle), "round {round}: it moves to {angle}");
        }
    }
}

#[test]
fn rows_that_are_needed_stay() {
    let mut numbers = Numbers(3);
    let none = |what: &str, bodies: &mut Vec<Body>, joints: &mut Vec<Joint>| {
        assemble(bodies, joints);
        assert_eq!(omit_redundant_rows(bodies, joints), Vec::new(), "{what}");
        assert!(joints.iter().all(|joint| joint.omission == Omission::NONE), "{what}");
    };
    // Redundant to rounding errors: the solver copes with that, in all configurations.
    let (mut bodies, mut joints) = bars(&[0.0, 1.0, 0.4], 0.0, &mut numbers);
    none("an exact parallelogram", &mut bodies, &mut joints);
    // A chain without loops.
    let (mut bodies, mut joints) = bars(&[0.0], 1e-3, &mut numbers);
    none("a chain", &mut bodies, &mut joints);
    // A stretched four-bar linkage: its rows depend on each other in this configuration only.
    let mut bodies = vec![ground(), rod(at(0.5, 0.0, 0.0)), rod(at(1.5, 0.0, 0.0)), rod(at(2.5, 0.0, 0.0))];
    let ends = [at(-0.5, 0.0, 0.0), at(0.5, 0.0, 0.0)];
    let mut joints = vec![
        joint(Kind::PointToPoint, [0, 1], [at(0.0, 0.0, 0.0), ends[0]]),
        joint(HINGE, [1, 2], [ends[1], ends[0]]),
        joint(HINGE, [2, 3], [ends[1], ends[0]]),
        joint(Kind::PointToPoint, [0, 3], [at(3.0, 0.0, 0.0), ends[1]]),
    ];
    none("a stretched chain between two points", &mut bodies, &mut joints);
    // A truss: three bars whose ends are hinged to the ground and to each other, across the plane of the hinges.
    let (mut bodies, mut joints) = bars(&[0.0, 1.0], 1e-3, &mut numbers);
    let brace = bodies.len();
    bodies.push(rod(at(0.5, 0.5, 0.0)));
    joints.push(joint(HINGE, [0, brace], [at(0.0, 0.0, 0.0), at(-0.5, -0.5, 0.0)]));
    joints.push(joint(HINGE, [1, brace], [at(0.5, 0.0, 0.0), at(0.5, 0.5, 0.0)]));
    none("a truss", &mut bodies, &mut joints);
}
