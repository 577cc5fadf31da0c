//! Cases without contacts: free bodies, trees, loops.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::case::{largest, positions, times, Case, Family, Samples};
use super::reference::multi_body::MultiBody;
use super::reference::{free_rotation, windows, State, TOLERANCE};
use super::system::{Body, Drive, Freedom, Joint, System};

const SIDE: Vector3<f64> = Vector3::new(0.0, 1.0, 0.0);
const UP: Vector3<f64> = Vector3::new(0.0, 0.0, 1.0);

/// Peers & Hsu: an asymmetric box that flies for 10 s.
fn flying_box() -> System {
    let mut body = Body::cuboid(10.0, Vector3::new(0.1, 0.4, 0.9), Vector3::zeros());
    body.velocity = Vector3::new(-2.0, 2.0, 8.0);
    body.spin = Vector3::new(0.1, 5.0, 0.1);
    System::of(vec![body])
}

pub fn free_rotating() -> Case {
    let (system, times) = (flying_box(), times(25, 25));
    let expected = free_rotation(system.bodies[0].inertia, system.bodies[0].spin, &times);
    Case {
        name: "free-rotation",
        title: "Free body: rotation",
        words: "A box of 0.1 × 0.4 × 0.9 m and 10 kg flies for 10 s, turning about its unstable axis with (0.1, 5, 0.1) rad/s. Error: \
                largest angle to the exact orientation.",
        unit: "rad",
        family: Family::Free,
        system,
        times,
        measure: Box::new(move |samples| {
            largest(samples.iter().zip(&expected).map(|(bodies, q)| bodies[0].pose.rotation.angle_to(q)))
        }),
        limit: PI,
    }
}

pub fn free_flying() -> Case {
    let (system, times) = (flying_box(), times(25, 25));
    let (velocity, gravity) = (system.bodies[0].velocity, system.gravity);
    let expected: Vec<_> = times.iter().map(|&t| velocity * t + gravity * (t * t / 2.0)).collect();
    Case {
        name: "free-flight",
        title: "Free body: position",
        words: "The same box. Error: largest distance from the parabola.",
        unit: "m",
        family: Family::Free,
        system,
        times,
        measure: Box::new(move |samples| {
            largest(samples.iter().zip(&expected).map(|(bodies, p)| (bodies[0].pose.translation.vector - p).norm()))
        }),
        limit: 10.0,
    }
}

/// `n` rods of 1 m and 1 kg (the last of `last` kg), hinged end to end, that are let go horizontally.
pub fn chain_system(n: usize, last: f64) -> System {
    let mut system = System::of(vec![Body::fixed(None)]);
    for i in 0..n {
        let (x, mass) = (i as f64, if i + 1 == n { last } else { 1.0 });
        system.bodies.push(Body::cuboid(mass, Vector3::new(1.0, 0.05, 0.05), Vector3::new(x + 0.5, 0.0, 0.0)));
        system.joints.push(Joint::hinge(i, i + 1, Vector3::new(x, 0.0, 0.0), SIDE));
    }
    system
}

fn chain(name: &'static str, title: &'static str, words: &'static str, n: usize, last: f64) -> Case {
    let (system, times) = (chain_system(n, last), times(25, 5));
    let tolerance = if last > 1.0 { 1e-11 } else { TOLERANCE };
    let expected = MultiBody::new(&system).states_within(&times, tolerance);
    let measure = positions(expected);
    Case { name, title, words, unit: "m", family: Family::Tree, system, times, measure, limit: n as f64 }
}

pub fn pendulum() -> Case {
    let words = "A rod of 1 m and 1 kg on a hinge is let go horizontally, 2 s. Error, here and in all jointed cases: largest distance of \
                 any body's centre from where it should be, at 25 times.";
    chain("pendulum", "Pendulum", words, 1, 1.0)
}

pub fn double_pendulum() -> Case {
    chain("double-pendulum", "Double pendulum", "Two such rods, 2 s.", 2, 1.0)
}

pub fn chain10() -> Case {
    chain("chain10", "Chain of 10", "Ten such rods, 2 s.", 10, 1.0)
}

pub fn heavy_chain() -> Case {
    chain(
        "chain10-heavy",
        "Chain of 10 with a mass ratio of 1000",
        "The same with a last rod of 1000 kg, 2 s.",
        10,
        1000.0,
    )
}

/// A crank of 0.4 m that can turn all the way round, a coupler of 0.9 m and a rocker of 0.8 m over a ground of 1 m; 1
/// kg a metre. The crank starts horizontal, towards the rocker, and at rest.
pub fn crank_rocker_system() -> System {
    let at = |x: f64, z: f64| Vector3::new(x, 0.0, z);
    let (foot, crank_end, rocker_foot) = (at(0.0, 0.0), at(0.4, 0.0), at(1.0, 0.0));
    // The corner that is 0.9 m from the crank's end and 0.8 m from the rocker's foot.
    let between = rocker_foot - crank_end;
    let distance = between.norm();
    let along = (0.9_f64.powi(2) - 0.8_f64.powi(2) + distance * distance) / (2.0 * distance);
    let aside = (0.9_f64.powi(2) - along * along).sqrt();
    let corner = crank_end + between / distance * along + Vector3::y().cross(&between).normalize() * -aside;
    let mut system = System::of(vec![Body::fixed(None)]);
    for (from, to) in [(foot, crank_end), (crank_end, corner), (rocker_foot, corner)] {
        let (rod, length) = (to - from, (to - from).norm());
        let mut body = Body::cuboid(length, Vector3::new(0.05, 0.05, length), (from + to) / 2.0);
        body.pose.rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), rod.x.atan2(rod.z));
        system.bodies.push(body);
    }
    system.joints.push(Joint::hinge(0, 1, foot, SIDE));
    system.joints.push(Joint::hinge(1, 2, crank_end, SIDE));
    system.joints.push(Joint::hinge(0, 3, rocker_foot, SIDE));
    system.closures.push(Joint::hinge(2, 3, corner, SIDE));
    system
}

pub fn crank_rocker() -> Case {
    let (system, times) = (crank_rocker_system(), times(25, 25));
    let measure = positions(MultiBody::new(&system).states(&times));
    Case {
        name: "four-bar",
        title: "Four-bar mechanism",
        words: "Crank 0.4 m, coupler 0.9 m, rocker 0.8 m over a ground of 1 m, 1 kg a metre, let go with the crank horizontal, 10 s: a loop \
                without singular positions.",
        unit: "m",
        family: Family::Loop,
        system,
        times,
        measure,
        limit: 1.0,
    }
}

/// `n` windows of four-bar mechanisms side by side, upright, tops moving with 1 m/s (IFToMM A02).
pub fn window_system(n: usize) -> System {
    let mut system = System::of(vec![Body::fixed(None)]);
    let (upright, crossbar) = (Vector3::new(0.05, 0.05, 1.0), Vector3::new(1.0, 0.05, 0.05));
    for i in 0..=n {
        let mut body = Body::cuboid(1.0, upright, Vector3::new(i as f64, 0.0, 0.5));
        body.inertia = Vector3::repeat(1.0 / 12.0);
        body.velocity = Vector3::new(0.5, 0.0, 0.0);
        body.spin = SIDE;
        system.bodies.push(body);
    }
    for i in 0..n {
        let mut body = Body::cuboid(1.0, crossbar, Vector3::new(i as f64 + 0.5, 0.0, 1.0));
        body.velocity = Vector3::new(1.0, 0.0, 0.0);
        system.bodies.push(body);
    }
    for i in 0..=n {
        system.joints.push(Joint::hinge(0, 1 + i, Vector3::new(i as f64, 0.0, 0.0), SIDE));
    }
    for i in 0..n {
        let (left, bar) = (1 + i, n + 2 + i);
        system.joints.push(Joint::hinge(left, bar, Vector3::new(i as f64, 0.0, 1.0), SIDE));
        system.closures.push(Joint::hinge(bar, left + 1, Vector3::new(i as f64 + 1.0, 0.0, 1.0), SIDE));
    }
    system
}

/// States of [`window_system`] for angles of the uprights.
pub fn window_states(n: usize, angles: &[f64]) -> Samples {
    let still = State { pose: Isometry3::identity(), velocity: Vector3::zeros(), spin: Vector3::zeros() };
    let state = |position: Vector3<f64>, angle: f64| State {
        pose: Isometry3::from_parts(
            Translation3::from(position),
            UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle),
        ),
        ..still
    };
    let at = |&angle: &f64| {
        let top = Vector3::new(angle.sin(), 0.0, angle.cos());
        let foot = |i: usize| Vector3::new(i as f64, 0.0, 0.0);
        let uprights = (0..=n).map(|i| state(foot(i) + top / 2.0, angle));
        let bars = (0..n).map(|i| state(foot(i) + Vector3::new(0.5, 0.0, 0.0) + top, 0.0));
        std::iter::once(still).chain(uprights).chain(bars).collect()
    };
    angles.iter().map(at).collect()
}

fn window(name: &'static str, title: &'static str, words: &'static str, n: usize) -> Case {
    let (system, times) = (window_system(n), times(25, 25));
    let measure = positions(window_states(n, &windows(n, 9.81, 1.0, &times)));
    Case { name, title, words, unit: "m", family: Family::Loop, system, times, measure, limit: 1.0 }
}

pub fn window1() -> Case {
    let words = "A square of rods of 1 m and 1 kg on the ground, upright, tops moving with 1 m/s, 10 s (IFToMM A02). It goes through its singular \
                 position, all rods in line, in each half turn; an error above 1 m is another branch and counts as a failure.";
    window("window1", "One window", words, 1)
}

pub fn window10() -> Case {
    window("window10", "Ten windows", "Ten of them side by side: 21 bodies, 10 loops.", 10)
}

pub fn window40() -> Case {
    window("window40", "Forty windows", "Forty of them: 81 bodies, 40 loops.", 40)
}

/// Five rods along the edges of a unit cube, the sixth edge being the ground, with hinges across (IFToMM A04).
pub fn bricard_system() -> System {
    let corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1], [0, 1, 1], [0, 0, 1]];
    let corners = corners.map(|c: [i32; 3]| Vector3::new(f64::from(c[0]), f64::from(c[1]), f64::from(c[2])));
    let edge = |i: usize| corners[(i + 1) % 6] - corners[i % 6];
    // Each hinge is perpendicular to both its rods.
    let axis = |i: usize| edge(i + 5).cross(&edge(i));
    let mut system = System::of(vec![Body::fixed(None)]);
    for (i, corner) in corners.iter().enumerate().take(5) {
        let size = edge(i).abs() * 0.95 + Vector3::repeat(0.05);
        system.bodies.push(Body::cuboid(1.0, size, corner + edge(i) / 2.0));
        system.joints.push(Joint::hinge(i, i + 1, *corner, axis(i)));
    }
    // The last corner belongs to the ground: the loop is closed one corner earlier, between two rods.
    let last = system.joints.pop().expect("five joints");
    system.joints.push(Joint::hinge(0, 5, corners[5], axis(5)));
    system.closures.push(last);
    system.spatial = true;
    system
}

pub fn bricard() -> Case {
    let (system, times) = (bricard_system(), times(25, 10));
    let measure = positions(MultiBody::new(&system).states(&times));
    Case {
        name: "bricard",
        title: "Bricard mechanism",
        words: "Five rods of 1 m and 1 kg along the edges of a cube, hinged across, closed over the ground (IFToMM A04): mobile only \
                because of its symmetry, so one of its constraints is redundant. 4 s from rest.",
        unit: "m",
        family: Family::Loop,
        system,
        times,
        measure,
        limit: 1.0,
    }
}

/// A shaft that turns freely about z with one turn a second, two arms with a ball each, and rods from their middles to
/// a collar that slides on the shaft (after IFToMM A05, with rigid rods).
pub fn governor_system() -> System {
    let (angle, offset) = (PI / 6.0, 0.05);
    let mut system = System::of(vec![Body::fixed(None)]);
    let shaft = Body::cuboid(5.0, Vector3::new(0.1, 0.1, 1.0), Vector3::new(0.0, 0.0, 0.5));
    let collar_height = 1.0 - angle.cos();
    let collar = Body::cuboid(2.0, Vector3::new(0.15, 0.15, 0.1), Vector3::new(0.0, 0.0, collar_height));
    system.bodies.extend([shaft, collar]);
    system.joints.push(Joint::hinge(0, 1, Vector3::zeros(), UP));
    system.joints.push(Joint { freedom: Freedom::Slider, ..Joint::hinge(1, 2, Vector3::zeros(), UP) });
    for side in [1.0, -1.0] {
        let at = |x: f64, z: f64| Vector3::new(side * x, 0.0, z);
        let (top, middle) = (at(offset, 1.0), at(offset + angle.sin() / 2.0, 1.0 - angle.cos() / 2.0));
        let (end, foot) = (at(offset + angle.sin(), 1.0 - angle.cos()), at(offset, collar_height));
        // A ball of 5 kg on a rod without mass, and a light rod.
        let mut arm = Body::cuboid(5.0, Vector3::repeat(0.15), end);
        arm.pose.rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -side * angle);
        let mut rod = Body::cuboid(0.5, Vector3::new(0.05, 0.05, 0.5), (middle + foot) / 2.0);
        rod.pose.rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), side * angle);
        let first = system.bodies.len();
        system.bodies.extend([arm, rod]);
        system.joints.push(Joint::hinge(1, first, top, SIDE));
        system.joints.push(Joint::hinge(first, first + 1, middle, SIDE));
        system.closures.push(Joint::hinge(first + 1, 2, foot, SIDE));
    }
    for body in system.bodies.iter_mut().skip(1) {
        body.spin = UP * TAU;
        body.velocity = body.spin.cross(&body.pose.translation.vector);
    }
    system
}

pub fn governor() -> Case {
    let (system, times) = (governor_system(), times(25, 10));
    let measure = positions(MultiBody::new(&system).states(&times));
    Case {
        name: "governor",
        title: "Flyball governor",
        words: "A shaft turns freely with one turn a second; two arms with balls of 5 kg lift a collar that slides on it (after IFToMM A05, \
                with rigid rods): two loops, a slider, gyroscopic and centrifugal forces. 4 s.",
        unit: "m",
        family: Family::Loop,
        system,
        times,
        measure,
        limit: 1.0,
    }
}

/// An arm of seven hinges, roll and pitch in turn, 1.4 m when stretched, upright.
pub fn arm_system() -> System {
    let mut system = System::of(vec![Body::fixed(None)]);
    let gains = [(100.0, 6.0), (800.0, 60.0), (50.0, 3.0), (400.0, 30.0), (20.0, 0.8), (100.0, 4.0), (5.0, 0.1)];
    let masses = [4.0, 3.5, 3.0, 2.5, 2.0, 1.5, 0.5];
    for (i, mass) in masses.into_iter().enumerate() {
        let (foot, wide) = (0.2 * i as f64, 0.12 - 0.01 * i as f64);
        system.bodies.push(Body::cuboid(mass, Vector3::new(wide, wide, 0.2), Vector3::new(0.0, 0.0, foot + 0.1)));
        let axis = if i % 2 == 0 { UP } else { SIDE };
        system.joints.push(Joint::hinge(i, i + 1, Vector3::new(0.0, 0.0, foot), axis));
    }
    system.drive = Some(Drive { gains: gains.to_vec(), amplitude: 0.3, rate: 4.0 });
    system
}

/// Angles of the hinges of a chain of bodies, rad.
pub fn angles(system: &System, bodies: &[State]) -> Vec<f64> {
    let angle = |joint: &Joint| {
        let relative = bodies[joint.parent].pose.rotation.inverse() * bodies[joint.child].pose.rotation;
        // All bodies are unrotated at first: the axis in the parent is that in the world.
        2.0 * relative.imag().dot(&joint.axis).atan2(relative.w)
    };
    system.joints.iter().map(angle).collect()
}

pub fn arm() -> Case {
    arm_at(25, 10)
}

/// The arm, compared at [`times`].
pub fn arm_at(count: usize, grains: usize) -> Case {
    let (system, times) = (arm_system(), times(count, grains));
    let expected: Vec<_> =
        MultiBody::new(&system).states(&times).iter().map(|bodies| angles(&system, bodies)).collect();
    let model = system.clone();
    Case {
        name: "arm7",
        title: "Arm of 7 joints under position control",
        words: "Every joint follows 0.3·(1 − cos 4t) rad with its own P and D, 4 s. Error: largest difference of a joint's angle from that \
                with the same controllers in continuous time.",
        unit: "rad",
        family: Family::Tree,
        system,
        times,
        measure: Box::new(move |samples| {
            let wrapped = |a: f64, b: f64| ((a - b + PI).rem_euclid(TAU) - PI).abs();
            let pairs = samples.iter().zip(&expected);
            largest(pairs.flat_map(|(bodies, expected)| {
                let found = angles(&model, bodies);
                found.into_iter().zip(expected.clone()).map(move |(a, b)| wrapped(a, b))
            }))
        }),
        limit: 0.5,
    }
}
