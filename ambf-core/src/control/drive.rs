use std::ops::{Add, Mul, Sub};

use nalgebra::Vector3;

use crate::adf::{Controller, ControllerOutput, Gains};

/// Softness from which on a row is a plain force: nothing that moves changes its impulse, 1/kg or 1/(kg·m²).
const FORCE_SOFTNESS: f64 = 1e12;

/// What a row `v = velocity − softness · impulse` of the constraint solver needs to act as a controller. Units of a coordinate (rad or m).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SoftVelocity<T> {
    /// 1/s.
    pub velocity: T,
    /// 1/kg or 1/(kg·m²).
    pub softness: f64,
}

/// The row of a spring with damper over a sub-step of `h` s, implicit in both. The error e is taken where it will be at the end of the
/// sub-step, `e + h·ė`, and `ė = ṡ − v` with the rate ṡ of the set point and the velocity v at that end: from
/// `τ = P·(e + h·ė) + D·ė + τ₀` and the impulse λ = h·τ follows `v = ṡ + (P·e + τ₀)/(D + h·P) − λ/(h·(D + h·P))`.
///
/// `force` is `P·e + τ₀`, `set_rate` ṡ, `rate` the present velocity. Stable for any gains that are not negative and any h (Catto, *Soft
/// Constraints*, Game Developers Conference 2011). Where `D + h·P` is not positive there is nothing to be implicit in, and the row is
/// the plain force `force + D·(ṡ − rate)`.
pub fn spring<T>(gains: &Gains, force: T, set_rate: T, rate: T, h: f64) -> SoftVelocity<T>
where
    T: Mul<f64, Output = T> + Add<Output = T> + Sub<Output = T>,
{
    let stiffness = gains.d + h * gains.p;
    if h * stiffness * FORCE_SOFTNESS > 1.0 {
        SoftVelocity { velocity: set_rate + force * (1.0 / stiffness), softness: 1.0 / (h * stiffness) }
    } else {
        let force = force + (set_rate - rate) * gains.d;
        SoftVelocity { velocity: force * (h * FORCE_SOFTNESS), softness: FORCE_SOFTNESS }
    }
}

/// PID controller of a joint in the accurate profile, evaluated in every sub-step and solved with the motion that it causes.
///
/// Force output is a [`spring`]. Velocity output is a motor whose velocity obeys `v = P·(e + h·ė) + I·∫e + D·ė` with `ė = ṡ − v`, that is
/// `v = (P·e + I·∫e + (h·P + D)·ṡ)/(1 + h·P + D)`: the error decays with the time constant (1 + D)/P, whatever h is.
#[derive(Debug, Clone)]
pub struct JointDriver {
    gains: Gains,
    output: ControllerOutput,
    integral: f64,
    /// Error of the sub-step before; `None` after a break.
    error: Option<f64>,
}

impl JointDriver {
    /// A controller without memory.
    pub fn new(controller: &Controller) -> Self {
        Self { gains: controller.gains, output: controller.output, integral: 0.0, error: None }
    }

    /// Whether it pulls like a spring rather than like a motor.
    pub fn is_spring(&self) -> bool {
        self.output == ControllerOutput::Force
    }

    /// The row for an `error` (rad or m) between a set point that moves with `set_rate` and a joint that moves with `rate`, 1/s, in a
    /// sub-step of `h` s.
    pub fn update(&mut self, error: f64, set_rate: f64, rate: f64, h: f64) -> SoftVelocity<f64> {
        let Gains { p, i, d } = self.gains;
        // Trapezoids, as in the legacy profile.
        self.integral += self.error.map_or(0.0, |before| h * (error + before) / 2.0);
        self.error = Some(error);
        let wanted = p * error + i * self.integral;
        if self.is_spring() {
            return spring(&self.gains, wanted, set_rate, rate, h);
        }
        let slope = h * p + d;
        let velocity =
            if slope > -1.0 { (wanted + slope * set_rate) / (1.0 + slope) } else { wanted + d * (set_rate - rate) };
        SoftVelocity { velocity, softness: 0.0 }
    }

    /// Forgets everything, as after a break.
    pub fn reset(&mut self) {
        (self.integral, self.error) = (0.0, None);
    }
}

/// What a [`PoseDriver`] wants of a body, world axes: linear part first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PoseAction {
    /// Rows that pull it.
    Springs([SoftVelocity<Vector3<f64>>; 2]),
    /// Velocities at the end of the sub-step, m/s and rad/s.
    Velocity([Vector3<f64>; 2]),
}

/// Proportional-derivative controller of a body's pose in the accurate profile, evaluated in every sub-step and solved with the motion that
/// it causes. I gains are not used; the output type of the linear part decides for both, as in the legacy profile.
///
/// Force output is a [`spring`] for each part. Velocity output is `v = P·(e + h·(ṡ − v))`, that is `v = P·(e + h·ṡ)/(1 + h·P)`: the error
/// decays with the time constant 1/P, and D is left out.
#[derive(Debug, Clone)]
pub struct PoseDriver {
    gains: [Gains; 2],
    output: ControllerOutput,
}

impl PoseDriver {
    /// The controller of the two parts.
    pub fn new(linear: &Controller, angular: &Controller) -> Self {
        Self { gains: [linear.gains, angular.gains], output: linear.output }
    }

    /// Whether it pulls like a spring.
    pub fn is_spring(&self) -> bool {
        self.output == ControllerOutput::Force
    }

    /// The action for the errors of position (m) and orientation (rotation vector, rad), the rates of the wanted pose and of the body
    /// (m/s and rad/s), linear part first, all in world axes, in a sub-step of `h` s.
    pub fn update(
        &self,
        errors: &[Vector3<f64>; 2],
        set_rates: &[Vector3<f64>; 2],
        rates: &[Vector3<f64>; 2],
        h: f64,
    ) -> PoseAction {
        if self.is_spring() {
            PoseAction::Springs(std::array::from_fn(|part| {
                let gains = &self.gains[part];
                spring(gains, errors[part] * gains.p, set_rates[part], rates[part], h)
            }))
        } else {
            PoseAction::Velocity(std::array::from_fn(|part| {
                let p = self.gains[part].p;
                if h * p > -1.0 {
                    (errors[part] + set_rates[part] * h) * (p / (1.0 + h * p))
                } else {
                    errors[part] * p
                }
            }))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn controller(p: f64, i: f64, d: f64, output: ControllerOutput) -> Controller {
        Controller { gains: Gains { p, i, d }, output }
    }

    /// Velocity after a sub-step of a mass that only the row acts on.
    fn solve(row: &SoftVelocity<f64>, mass: f64, before: f64) -> f64 {
        // v = before + λ/m and v = velocity − softness λ.
        let impulse = (row.velocity - before) / (row.softness + 1.0 / mass);
        before + impulse / mass
    }

    /// Last error, and the largest beyond the goal, of a mass that is to go from 0 to 1.
    fn settle(controller: &Controller, mass: f64, h: f64, seconds: f64) -> (f64, f64) {
        let (mut driver, mut x, mut v, mut beyond) = (JointDriver::new(controller), 0.0, 0.0, 0.0_f64);
        for _ in 0..(seconds / h) as usize {
            v = solve(&driver.update(1.0 - x, 0.0, v, h), mass, v);
            x += h * v;
            beyond = beyond.max(x - 1.0);
        }
        (1.0 - x, beyond)
    }

    #[test]
    fn a_spring_is_a_spring() {
        // Critical damping: x = 1 - (1 + ωt) exp(-ωt).
        let critical = controller(100.0, 0.0, 20.0, ControllerOutput::Force);
        for (h, tolerance) in [(1e-3, 2e-3), (1e-4, 2e-4), (1e-5, 2e-5)] {
            let (rest, beyond) = settle(&critical, 1.0, h, 0.2);
            assert!((rest - 3.0 * (-2.0_f64).exp()).abs() < tolerance && beyond == 0.0, "{h}: {rest}");
        }
    }

    #[test]
    fn no_step_is_too_long_and_no_gain_too_high() {
        for h in [1e-3, 0.016, 0.1] {
            for gain in [1.0, 1e3, 1e6, 1e9] {
                for output in [ControllerOutput::Force, ControllerOutput::Velocity] {
                    let (rest, beyond) = settle(&controller(gain, 0.0, gain.sqrt() * 2.0, output), 1.0, h, 20.0);
                    assert!(rest.abs() < 2e-3 && beyond < 0.1, "{h}, {gain}, {output:?}: {rest}, {beyond}");
                }
            }
        }
    }

    #[test]
    fn the_default_motor_has_its_time_constant_at_every_step() {
        for h in [1e-4, 1e-3, 0.02] {
            // (1 + D)/P = 0.2 s.
            let (rest, _) = settle(&Controller::default(), 1.0, h, 0.2);
            assert!((rest - (-1.0_f64).exp()).abs() < h, "{h}: {rest}");
        }
    }

    #[test]
    fn the_integral_starts_after_a_break_and_the_set_rate_leads() {
        let mut driver = JointDriver::new(&controller(0.0, 8.0, 0.0, ControllerOutput::Velocity));
        assert_eq!(driver.update(1.0, 0.0, 0.0, 0.1).velocity, 0.0);
        assert!((driver.update(2.0, 0.0, 0.0, 0.1).velocity - 8.0 * 0.15).abs() < 1e-12);
        driver.reset();
        assert_eq!(driver.update(1.0, 0.0, 0.0, 0.1).velocity, 0.0);
        let mut driver = JointDriver::new(&controller(1e3, 0.0, 50.0, ControllerOutput::Force));
        let row = driver.update(0.0, 0.7, 0.7, 1e-3);
        assert!((solve(&row, 2.0, 0.7) - 0.7).abs() < 1e-12, "it follows without error: {row:?}");
    }

    #[test]
    fn without_gains_to_be_implicit_in_it_is_a_force() {
        for (gains, force) in [((0.0, 3.0, 0.0), 0.0), ((-5.0, 0.0, 0.0), -10.0), ((5.0, 0.0, -1.0), 14.0)] {
            let (p, i, d) = gains;
            let row = JointDriver::new(&controller(p, i, d, ControllerOutput::Force)).update(2.0, 0.0, 4.0, 1e-3);
            assert!((solve(&row, 3.0, 4.0) - 4.0 - force * 1e-3 / 3.0).abs() < 1e-9, "{gains:?}: {row:?}");
        }
    }

    #[test]
    fn a_pose_has_two_springs_or_two_velocities() {
        let part = |p, output| controller(p, 0.0, 1.0, output);
        let errors = [Vector3::x(), Vector3::y() * 0.1];
        let still = [Vector3::zeros(); 2];
        let driver = PoseDriver::new(&part(100.0, ControllerOutput::Force), &part(10.0, ControllerOutput::Velocity));
        let PoseAction::Springs([linear, angular]) = driver.update(&errors, &still, &still, 0.01) else {
            panic!("the linear part decides")
        };
        assert!((linear.velocity - Vector3::x() * 50.0).norm() < 1e-9 && (linear.softness - 50.0).abs() < 1e-9);
        assert!((angular.velocity - Vector3::y() / 1.1).norm() < 1e-9 && (angular.softness - 100.0 / 1.1).abs() < 1e-9);
        let driver = PoseDriver::new(&Controller::default(), &Controller::default());
        let PoseAction::Velocity([v, w]) = driver.update(&errors, &still, &still, 0.01) else { panic!("velocities") };
        assert!((v - Vector3::x() * 10.0 / 1.1).norm() < 1e-9 && (w - Vector3::y() / 1.1).norm() < 1e-9);
    }
}
