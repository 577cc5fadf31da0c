//! Low-pass filters of a Hydra, whose measurements tremble.

use std::f64::consts::PI;

use nalgebra::{UnitQuaternion, Vector3};

/// Reports come every 4 ms.
const PERIOD: f64 = 0.004;

/// Second order on position, critically damped (bilinear transform), first order on rotation. The first value passes as
/// it is.
#[derive(Debug, Clone)]
pub(super) struct LowPass {
    /// Factors of the input, now and one and two reports ago: 1, 2, 1 times this.
    gain: f64,
    /// Factors of the output, one and two reports ago.
    feedback: [f64; 2],
    /// How much of a new rotation is taken.
    share: f64,
    inputs: [Vector3<f64>; 2],
    outputs: [Vector3<f64>; 2],
    rotation: Option<UnitQuaternion<f64>>,
}

impl LowPass {
    /// Both filters with the corner frequency `corner`, Hz.
    pub fn new(corner: f64) -> Self {
        let k = (PI * corner * PERIOD).tan();
        let scale = 1.0 / (k * k + 2.0 * k + 1.0);
        Self {
            gain: k * k * scale,
            feedback: [2.0 * (k * k - 1.0) * scale, (k * k - 2.0 * k + 1.0) * scale],
            share: 1.0 - (-2.0 * PI * corner * PERIOD).exp(),
            inputs: [Vector3::zeros(); 2],
            outputs: [Vector3::zeros(); 2],
            rotation: None,
        }
    }

    /// Takes the pose of a report and gives back the smooth one.
    pub fn pass(&mut self, p: Vector3<f64>, r: UnitQuaternion<f64>) -> (Vector3<f64>, UnitQuaternion<f64>) {
        let Some(rotation) = self.rotation else {
            (self.inputs, self.outputs, self.rotation) = ([p; 2], [p; 2], Some(r));
            return (p, r);
        };
        let smooth = self.gain * (p + 2.0 * self.inputs[0] + self.inputs[1])
            - self.feedback[0] * self.outputs[0]
            - self.feedback[1] * self.outputs[1];
        self.inputs = [p, self.inputs[0]];
        self.outputs = [smooth, self.outputs[0]];
        // The shorter way; half a turn has none, and is taken at once.
        let rotation = rotation.try_slerp(&r, self.share, 1e-9).unwrap_or(r);
        self.rotation = Some(rotation);
        (smooth, rotation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_followed_without_overshoot() {
        let mut filter = LowPass::new(3.0);
        let start = filter.pass(Vector3::zeros(), UnitQuaternion::identity());
        assert_eq!(start.0, Vector3::zeros());
        let target = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 1.0);
        let step: Vec<_> = (0..250).map(|_| filter.pass(Vector3::x(), target)).collect();
        assert!(step.windows(2).all(|w| w[1].0.x >= w[0].0.x - 1e-12 && w[1].0.x <= 1.0 + 1e-9));
        assert!((step[249].0.x - 1.0).abs() < 1e-3 && step[249].1.angle_to(&target) < 1e-3);
        // Two poles at 3 Hz: 1 − (1 + ωt)·exp(−ωt) after 20 reports.
        let w = 2.0 * PI * 3.0 * 0.08;
        assert!((step[19].0.x - (1.0 - (1.0 + w) * (-w).exp())).abs() < 0.03, "{}", step[19].0.x);
        assert!((step[19].1.angle() - (1.0 - (-w).exp())).abs() < 1e-9);
    }

    #[test]
    fn what_rests_passes_unchanged() {
        let mut filter = LowPass::new(3.0);
        let (p, r) = (Vector3::new(0.1, 0.2, 0.3), UnitQuaternion::from_euler_angles(0.3, 0.2, 0.1));
        for _ in 0..10_000 {
            let (a, b) = filter.pass(p, r);
            assert!((a - p).norm() < 1e-12 && b.angle_to(&r) < 1e-6);
        }
    }
}
