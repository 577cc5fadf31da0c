//! Motions that are known: analytic ones, and reduced coordinates integrated with an adaptive step at a tolerance of
//! 1e-13.

pub mod extrapolation;
pub mod multi_body;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// Motion of one body at one time, world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// Pose of the inertial frame.
    pub pose: Isometry3<f64>,
    /// m/s, of the centre of mass.
    pub velocity: Vector3<f64>,
    /// rad/s.
    pub spin: Vector3<f64>,
}

/// Local error of every integration, relative to max(1, |y|).
pub const TOLERANCE: f64 = 1e-13;

/// Rotations of a free rigid body with principal moments `inertia` (kg·m²) that starts unrotated with angular velocity
/// `spin` (rad/s), at the given times: Euler's equations, I ω̇ = (I ω) × ω in the body's axes, and q̇ = q ω / 2.
pub fn free_rotation(inertia: Vector3<f64>, spin: Vector3<f64>, times: &[f64]) -> Vec<UnitQuaternion<f64>> {
    let mut y = vec![spin.x, spin.y, spin.z, 0.0, 0.0, 0.0, 1.0];
    let mut slope = |_: f64, y: &[f64], out: &mut [f64]| {
        let w = Vector3::new(y[0], y[1], y[2]);
        let turned = inertia.component_mul(&w).cross(&w).component_div(&inertia);
        let (v, s) = (Vector3::new(y[3], y[4], y[5]), y[6]);
        let (vector, scalar) = ((w * s + v.cross(&w)) / 2.0, -v.dot(&w) / 2.0);
        out[..3].copy_from_slice(turned.as_slice());
        out[3..6].copy_from_slice(vector.as_slice());
        out[6] = scalar;
    };
    let mut now = 0.0;
    let rotation = |time: &f64| {
        extrapolation::integrate(&mut slope, &mut y, now, *time, TOLERANCE, &mut |_| ());
        now = *time;
        UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(y[6], y[3], y[4], y[5]))
    };
    times.iter().map(rotation).collect()
}

/// Angle of `n` four-bar windows side by side from the upright, rad, at the given times: uprights and crossbars are
/// uniform rods of 1 m and 1 kg, which move as one degree of freedom; `rate` is its initial rate, rad/s.
///
/// The n + 1 uprights turn about their feet (I = 1/3), the n crossbars move along with the tops (m l² = 1), so
/// ((n + 1)/3 + n) θ̈ = g ((n + 1)/2 + n) sin θ.
pub fn windows(n: usize, gravity: f64, rate: f64, times: &[f64]) -> Vec<f64> {
    let n = n as f64;
    let factor = gravity * ((n + 1.0) / 2.0 + n) / ((n + 1.0) / 3.0 + n);
    let mut y = vec![0.0, rate];
    let mut slope = |_: f64, y: &[f64], out: &mut [f64]| {
        out[0] = y[1];
        out[1] = factor * y[0].sin();
    };
    let mut now = 0.0;
    let angle = |time: &f64| {
        extrapolation::integrate(&mut slope, &mut y, now, *time, TOLERANCE, &mut |_| ());
        now = *time;
        y[0]
    };
    times.iter().map(angle).collect()
}
