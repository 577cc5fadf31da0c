//! The references of the accuracy benchmark: laws of conservation, convergence, and agreement of independent
//! formulations.

#![allow(dead_code, reason = "the benchmark uses the rest")]

use ambf_bench::{case, jointed, reference, system};
use case::{times, Samples};
use jointed::{
    angles, arm_system, bricard_system, chain_system, crank_rocker_system, governor_system, window_states,
    window_system,
};
use nalgebra::Vector3;
use reference::multi_body::MultiBody;
use reference::{extrapolation, free_rotation, windows, State, TOLERANCE};
use system::{Freedom, System};

/// Kinetic and potential energy, J.
fn energy(system: &System, states: &[State]) -> f64 {
    let of = |(body, state): (&system::Body, &State)| {
        let spin = state.pose.inverse_transform_vector(&state.spin);
        let kinetic = body.mass * state.velocity.norm_squared() + body.inertia.component_mul(&spin).dot(&spin);
        kinetic / 2.0 - body.mass * system.gravity.dot(&state.pose.translation.vector)
    };
    system.bodies.iter().zip(states).map(of).sum()
}

/// Largest deviation of the energy from the initial one, over the largest kinetic energy.
fn energy_drift(system: &System, samples: &Samples) -> f64 {
    let rest: Vec<State> =
        system.bodies.iter().map(|body| State { pose: body.pose, velocity: body.velocity, spin: body.spin }).collect();
    let first = energy(system, &rest);
    let kinetic = |states: &Vec<State>| energy(&System { gravity: Vector3::zeros(), ..system.clone() }, states).abs();
    let most = samples.iter().map(kinetic).fold(0.0, f64::max);
    samples.iter().map(|states| (energy(system, states) - first).abs()).fold(0.0, f64::max) / most
}

/// Largest distance of points that joints hold together, m, and of their axes, rad.
fn gap(system: &System, states: &[State]) -> f64 {
    let of = |joint: &system::Joint| {
        let (a, b) = (&system.bodies[joint.parent], &system.bodies[joint.child]);
        let (pose_a, pose_b) = (&states[joint.parent].pose, &states[joint.child].pose);
        let axis_a = pose_a * a.pose.inverse_transform_vector(&joint.axis);
        let axis_b = pose_b * b.pose.inverse_transform_vector(&joint.axis);
        let point = |body: &system::Body, pose: &nalgebra::Isometry3<f64>| {
            pose * body.pose.inverse_transform_point(&joint.pivot.into())
        };
        let apart = point(a, pose_a) - point(b, pose_b);
        let across = match joint.freedom {
            Freedom::Hinge => apart,
            Freedom::Slider => apart - axis_a * axis_a.dot(&apart),
        };
        across.norm() + axis_a.cross(&axis_b).norm()
    };
    system.joints.iter().chain(&system.closures).map(of).fold(0.0, f64::max)
}

#[test]
fn extrapolation_is_exact_on_an_oscillator() {
    let mut y = [1.0, 0.0];
    let mut slope = |_: f64, y: &[f64], out: &mut [f64]| {
        out[0] = y[1];
        out[1] = -y[0];
    };
    extrapolation::integrate(&mut slope, &mut y, 0.0, 10.0, TOLERANCE, &mut |_| ());
    assert!((y[0] - 10f64.cos()).abs() < 1e-11 && (y[1] + 10f64.sin()).abs() < 1e-11, "{y:?}");
}

#[test]
fn trees_keep_their_energy() {
    for (n, last, span) in [(1, 1.0, 5), (2, 1.0, 5), (10, 1.0, 5)] {
        let system = chain_system(n, last);
        let drift = energy_drift(&system, &MultiBody::new(&system).states(&times(25, span)));
        assert!(drift < 1e-10, "{n} links: {drift:e}");
    }
    // Its mass matrix is badly conditioned.
    let system = chain_system(10, 1000.0);
    let model = MultiBody::new(&system);
    let (coarse, fine) = (model.states_within(&times(10, 5), 1e-10), model.states_within(&times(10, 5), 1e-11));
    let drift = energy_drift(&system, &fine);
    assert!(drift < 1e-10, "heavy: {drift:e}");
    let apart = |(a, b): (&State, &State)| (a.pose.translation.vector - b.pose.translation.vector).norm();
    let most = coarse.iter().flatten().zip(fine.iter().flatten()).map(apart).fold(0.0, f64::max);
    assert!(most < 1e-8, "far below every error that is compared: {most:e}");
}

#[test]
fn loops_keep_their_energy_and_stay_closed() {
    for (name, system) in
        [("crank and rocker", crank_rocker_system()), ("bricard", bricard_system()), ("governor", governor_system())]
    {
        let samples = MultiBody::new(&system).states(&times(10, 20));
        let drift = energy_drift(&system, &samples);
        assert!(drift < 1e-10, "{name}: {drift:e}");
        let open = samples.iter().map(|states| gap(&system, states)).fold(0.0, f64::max);
        assert!(open < 1e-10, "{name}: {open:e}");
        let turned = |states: &Vec<State>| states[1].pose.rotation.angle_to(&system.bodies[1].pose.rotation);
        assert!(samples.iter().map(turned).fold(0.0, f64::max) > 0.1, "{name} does not move");
    }
}

#[test]
fn a_window_in_joint_coordinates_moves_as_one_degree_of_freedom() {
    // Until shortly before the singular position.
    let times = times(10, 3);
    for n in [1, 3] {
        let system = window_system(n);
        let expected = window_states(n, &windows(n, 9.81, 1.0, &times));
        let found = MultiBody::new(&system).states(&times);
        for (a, b) in found.iter().flatten().zip(expected.iter().flatten()) {
            let apart = (a.pose.translation.vector - b.pose.translation.vector).norm()
                + a.pose.rotation.angle_to(&b.pose.rotation);
            assert!(apart < 1e-8, "{n} windows: {apart:e}");
        }
    }
}

/// The textbook's equations of two uniform rods, angles from the downward vertical.
#[test]
fn a_double_pendulum_follows_the_textbook() {
    let (g, third, half) = (9.81, 1.0 / 3.0, 0.5);
    let mut slope = |_: f64, y: &[f64], out: &mut [f64]| {
        let (difference, [a, b, u, v]) = (y[0] - y[1], [y[0], y[1], y[2], y[3]]);
        let (m11, m12, m22) = (third + 1.0, half * difference.cos(), third);
        let f1 = -half * v * v * difference.sin() - 1.5 * g * a.sin();
        let f2 = half * u * u * difference.sin() - half * g * b.sin();
        let determinant = m11 * m22 - m12 * m12;
        out.copy_from_slice(&[u, v, (m22 * f1 - m12 * f2) / determinant, (m11 * f2 - m12 * f1) / determinant]);
    };
    let quarter = std::f64::consts::FRAC_PI_2;
    let (mut y, mut now) = ([quarter, quarter, 0.0, 0.0], 0.0);
    let times = times(10, 12);
    let mut system = chain_system(2, 1.0);
    for body in &mut system.bodies[1..] {
        body.inertia.y = 1.0 / 12.0;
    }
    for (time, states) in times.iter().zip(MultiBody::new(&system).states(&times)) {
        extrapolation::integrate(&mut slope, &mut y, now, *time, TOLERANCE, &mut |_| ());
        now = *time;
        let end = Vector3::new(y[0].sin() + y[1].sin() / 2.0, 0.0, -y[0].cos() - y[1].cos() / 2.0);
        let apart = (states[2].pose.translation.vector - end).norm();
        assert!(apart < 1e-9, "{apart:e} at {time} s");
    }
}

#[test]
fn a_free_body_keeps_energy_and_angular_momentum() {
    let (inertia, spin) = (Vector3::new(0.8, 0.7, 0.14), Vector3::new(0.1, 5.0, 0.1));
    let times: Vec<f64> = (0..=200).map(|i| 4.0 + f64::from(i) * 1e-3).collect();
    let rotations = free_rotation(inertia, spin, &times);
    let momentum = inertia.component_mul(&spin);
    for ten in rotations.windows(3) {
        // Angular velocity from a central difference, good to h².
        let w = (ten[0].inverse() * ten[2]).scaled_axis() / 2e-3;
        let found = ten[1] * inertia.component_mul(&w);
        assert!((found - momentum).norm() < 1e-4, "{found} {momentum}");
    }
}

#[test]
fn a_driven_arm_follows_its_set_point() {
    let system = arm_system();
    let drive = system.drive.clone().expect("it has one");
    for (time, states) in times(5, 25).iter().zip(MultiBody::new(&system).states(&times(5, 25))) {
        let (wanted, _) = drive.set_point(*time);
        for angle in angles(&system, &states) {
            assert!((angle - wanted).abs() < 0.2, "{angle} {wanted} at {time} s");
        }
    }
}
