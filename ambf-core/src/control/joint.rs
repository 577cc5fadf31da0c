use std::f64::consts::{PI, TAU};

use super::Profile;
use crate::adf::Gains;

/// Differences of time below this are taken as this, s.
const MIN_DT: f64 = 1e-5;

/// PID controller of a joint in the legacy profile: `u = P·e + I·∫e dt + D·de/dt`, without anti-windup or saturation.
///
/// Force output: P in N·m/rad (N/m), I in N·m/(rad·s), D in N·m·s/rad. Velocity output: P in 1/s, I in 1/s², D without
/// unit.
#[derive(Debug, Clone)]
pub struct JointController {
    gains: Gains,
    error: f64,
    time: f64,
    integral: f64,
}

impl JointController {
    /// A controller without memory.
    pub fn new(gains: Gains) -> Self {
        Self { gains, error: 0.0, time: 0.0, integral: 0.0 }
    }

    /// Output for a process value and set point (rad or m) at `time` (s, simulated).
    ///
    /// It differentiates over whatever time has passed since the last call, from an error of 0 at the start: a kick
    /// that clients of the C++ program live with. Two calls at the same time have no derivative.
    pub fn update(&mut self, process: f64, set_point: f64, time: f64) -> f64 {
        let error = set_point - process;
        let elapsed = time - self.time;
        let dt = elapsed.max(MIN_DT);
        let derivative = if elapsed < MIN_DT { 0.0 } else { (error - self.error) / dt };
        self.integral += dt * (error + self.error) / 2.0;
        self.error = error;
        self.time = time;
        self.gains.p * error + self.gains.i * self.integral + self.gains.d * derivative
    }

    /// Gains in use.
    pub fn gains(&self) -> Gains {
        self.gains
    }

    /// Uses other gains from now on; what it remembers stays.
    pub fn set_gains(&mut self, gains: Gains) {
        self.gains = gains;
    }

    /// Forgets everything, as at the start.
    pub fn reset(&mut self) {
        *self = Self::new(self.gains);
    }
}

/// The way from angle `current` to `target`, rad, by the shorter side: in [−π, π).
///
/// In the legacy profile the result is below −π for targets more than 3π below the current angle, as in the C++
/// program, whose remainder has the sign of its dividend.
pub fn shortest_angle(current: f64, target: f64, profile: Profile) -> f64 {
    let current = if current < 0.0 { current + TAU } else { current };
    let turned = target - current + 3.0 * PI;
    let rest = match profile {
        Profile::Legacy => turned % TAU,
        Profile::Accurate => turned.rem_euclid(TAU),
    };
    rest - PI
}

#[cfg(test)]
mod tests {
    use super::*;

    const GAINS: Gains = Gains { p: 100.0, i: 10.0, d: 5.0 };

    #[test]
    fn terms_add_up() {
        let mut controller = JointController::new(GAINS);
        // First call: the error before was 0 at time 0.
        let u = controller.update(0.0, 0.5, 0.001);
        assert!((u - (50.0 + 10.0 * 0.001 * 0.25 + 5.0 * 0.5 / 0.001)).abs() < 1e-9, "{u}");
        let u = controller.update(0.1, 0.5, 0.002);
        assert!((u - (40.0 + 10.0 * (0.00025 + 0.00045) - 5.0 * 0.1 / 0.001)).abs() < 1e-9, "{u}");
    }

    #[test]
    fn no_derivative_without_time() {
        let mut controller = JointController::new(GAINS);
        assert!((controller.update(0.0, 0.5, 0.0) - 50.0).abs() < 1e-3);
    }

    #[test]
    fn the_short_way_round() {
        for profile in [Profile::Legacy, Profile::Accurate] {
            assert!((shortest_angle(3.0, -3.0, profile) - (TAU - 6.0)).abs() < 1e-12);
            assert!((shortest_angle(-3.0, 3.0, profile) - (6.0 - TAU)).abs() < 1e-12);
            assert!((shortest_angle(0.0, 0.3, profile) - 0.3).abs() < 1e-12);
        }
        assert!(shortest_angle(1.0, -10.0, Profile::Legacy) < -PI, "a defect that trajectories show");
        let way = shortest_angle(1.0, -10.0, Profile::Accurate);
        assert!((-PI..PI).contains(&way) && ((-11.0 - way) / TAU).fract().abs() < 1e-9);
    }
}
