use std::ops::{Add, Mul, Sub};

use nalgebra::Vector3;

use crate::adf::{Controller, ControllerOutput, Gains};

/// Softness from which on a row is a plain force: nothing that moves changes its impulse, 1/kg or 1/(kg·m²).
const FORCE_SOFTNESS: f64 = 1e12;

/// What a row `v = velocity − softness · impulse` of the constraint solver needs to act as a controller. Units of a
/// coordinate (rad or m).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SoftVelocity<T> {
    /// 1/s.
    pub velocity: T,
    /// 1/kg or 1/(kg·m²).
    pub softness: f64,
}

/// How the solver moves what a row drives: this decides where in the sub-step the force of a spring has to be taken for
/// a motion that is right to second order in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scheme {
    /// By the velocity at the end: velocities belong to the middles of sub-steps, and forces to their beginnings. Rigid
    /// bodies.
    Staggered,
    /// By the mean of the velocities at both ends: forces belong to the middles. Joints in reduced coordinates.
    Collocated,
}

/// A coordinate, or three, at the beginning of a sub-step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackingError<T> {
    /// Set point less position, m or rad.
    pub error: T,
    /// Rate of the set point, 1/s.
    pub set_rate: T,
    /// Rate of the coordinate, 1/s.
    pub rate: T,
}

/// What a [`spring`] is made of: scalars and vectors.
pub trait Quantity: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<f64, Output = Self> {
    /// Length, or absolute value.
    fn size(self) -> f64;
}

impl Quantity for f64 {
    fn size(self) -> f64 {
        self.abs()
    }
}

impl Quantity for Vector3<f64> {
    fn size(self) -> f64 {
        self.norm()
    }
}

/// The row of a spring with damper over a sub-step of `h` s, implicit in both, with a force τ₀ beside them.
///
/// The error is taken where it will be at the end of the sub-step, `e + h·ė`, with `ė = ṡ − v` of the rate ṡ of the set
/// point and the velocity v at that end, which is stable for any h and any gains that are not negative, but damps like
/// an additional `h·P`. The rate ė₀ at the beginning takes that back: `τ = P·(e + h·(ė − w·ė₀)) + D·ė + τ₀` with w = 1,
/// or 1/2 if [collocated](Scheme::Collocated). For one degree of freedom its characteristic polynomial `(1 + K + κ)z² −
/// (2 + K + κ)z + 1 + K`, with K = h²P/m and κ = hD/m, has both roots in the unit disc for all K ≥ 0 and κ ≥ 0. No more
/// than half the error is taken back, so that a spring much harder than what it moves doesn't ring. With the impulse λ
/// = h·τ the row is `v = ṡ + (P·(e − h·w·ė₀) + τ₀)/(D + h·P) − λ/(h·(D + h·P))` (rows of this kind: Catto, *Soft
/// Constraints*, Game Developers Conference 2011).
///
/// Where `D + h·P` is not positive there is nothing to be implicit in, and the row is the plain force `P·e + D·ė₀ +
/// τ₀`.
pub fn spring<T: Quantity>(gains: &Gains, at: &TrackingError<T>, force: T, scheme: Scheme, h: f64) -> SoftVelocity<T> {
    let stiffness = gains.d + h * gains.p;
    let error_rate = at.set_rate - at.rate;
    if h * stiffness * FORCE_SOFTNESS <= 1.0 {
        let force = at.error * gains.p + error_rate * gains.d + force;
        return SoftVelocity { velocity: force * (h * FORCE_SOFTNESS), softness: FORCE_SOFTNESS };
    }
    let weight = if scheme == Scheme::Staggered { 1.0 } else { 0.5 };
    let back = error_rate * (h * weight);
    let share = (0.5 * at.error.size() / back.size()).min(1.0);
    // Nothing to take back, and no error: 0/0.
    let share = if share.is_nan() { 0.0 } else { share };
    let force = (at.error - back * share) * gains.p + force;
    SoftVelocity { velocity: at.set_rate + force * (1.0 / stiffness), softness: 1.0 / (h * stiffness) }
}

/// Expects of a rate that it changes in a sub-step as it did in the one before, as far as it did so steadily.
///
/// The D part of an implicit [`spring`] sees the rate at the end of the sub-step, half a change later than the one that
/// its force belongs to: D times half the expected change, beside it, makes it right to second order. All roots stay in
/// the unit disc for all K and κ.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct RateExtrapolator<T> {
    rate: Option<T>,
    change: Option<T>,
}

impl<T: Quantity + Default> RateExtrapolator<T> {
    /// Half the expected change from the rate at the beginning of the sub-step.
    fn half_change(&mut self, rate: T) -> T {
        let change = self.rate.replace(rate).map(|before| rate - before);
        let before = std::mem::replace(&mut self.change, change);
        match (change, before) {
            (Some(change), Some(before)) => change * (0.5 * agreement(change, before)),
            _ => T::default(),
        }
    }
}

/// How far two quantities agree: 1, if they differ by no more than half of the larger one, 0 if by all of it.
pub(crate) fn agreement<T: Quantity>(a: T, b: T) -> f64 {
    let share = 2.0 * (1.0 - (a - b).size() / a.size().max(b.size()));
    if share > 0.0 {
        share.min(1.0)
    } else {
        0.0
    }
}

/// Mean of exp(−x·t) over t in [0, 1].
fn mean_decay(x: f64) -> f64 {
    if x == 0.0 {
        1.0
    } else {
        -(-x).exp_m1() / x
    }
}

/// PID controller of a joint in the accurate profile, evaluated in every sub-step and solved with the motion that it
/// causes.
///
/// Force output is a [`spring`]. Velocity output is a motor with the mean velocity of `v = P·e + I·∫e + D·ė`, `ė = ṡ −
/// v`, over the sub-step: the error decays with the time constant (1 + D)/P, exactly and whatever the sub-step is.
#[derive(Debug, Clone)]
pub struct JointDriver {
    gains: Gains,
    output: ControllerOutput,
    integral: f64,
    /// Error of the sub-step before; `None` after a break.
    error: Option<f64>,
    trend: RateExtrapolator<f64>,
}

impl JointDriver {
    /// A controller without memory.
    pub fn new(controller: &Controller) -> Self {
        Self {
            gains: controller.gains,
            output: controller.output,
            integral: 0.0,
            error: None,
            trend: RateExtrapolator::default(),
        }
    }

    /// Whether it pulls like a spring rather than like a motor.
    pub fn is_spring(&self) -> bool {
        self.output == ControllerOutput::Force
    }

    /// Uses other gains from now on; what it remembers stays.
    pub fn set_gains(&mut self, gains: Gains) {
        self.gains = gains;
    }

    /// The row for the sub-step of `h` s that follows.
    pub fn update(&mut self, at: &TrackingError<f64>, scheme: Scheme, h: f64) -> SoftVelocity<f64> {
        let Gains { p, i, d } = self.gains;
        let &TrackingError { error, set_rate, rate } = at;
        // Trapezoids, as in the legacy profile.
        self.integral += self.error.map_or(0.0, |before| h * (error + before) / 2.0);
        self.error = Some(error);
        if self.is_spring() {
            let ahead = d.max(0.0) * self.trend.half_change(rate);
            return spring(&self.gains, at, i * self.integral + ahead, scheme, h);
        }
        let wanted = p * error + i * self.integral;
        let own = 1.0 + d;
        let velocity = if own > 0.0 {
            set_rate + (wanted - set_rate) / own * mean_decay(h * p / own)
        } else {
            wanted + d * (set_rate - rate)
        };
        SoftVelocity { velocity, softness: 0.0 }
    }

    /// Forgets everything, as after a break.
    pub fn reset(&mut self) {
        (self.integral, self.error, self.trend) = (0.0, None, RateExtrapolator::default());
    }
}

/// How a set point moves in the update to come, 1/s.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SetpointMotion<T> {
    /// Its rate: what the D part of a controller sees.
    pub rate: T,
    /// With which it goes on from the last command until the next one comes.
    pub drift: T,
}

impl<T: Quantity> SetpointMotion<T> {
    /// From the rates at which it moved in the latest update and in the one before: both are those of updates past, and
    /// by a whole update too old, so that their change is added. A jump is not taken for a motion: at most a quarter of
    /// the latest rate is added, and the set point drifts only as far as the two rates agree (fully, if they differ by
    /// no more than half of the larger one).
    pub fn following(latest: T, before: T) -> Self {
        let change = latest - before;
        let share = (0.25 * latest.size() / change.size()).min(1.0);
        let rate = latest + change * if share.is_nan() { 0.0 } else { share };
        Self { rate, drift: rate * agreement(latest, before) }
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

/// Proportional-derivative controller of a body's pose in the accurate profile, evaluated in every sub-step and solved
/// with the motion that it causes. I gains are not used; the output type of the linear part decides for both, as in the
/// legacy profile.
///
/// Force output is a [`spring`] for each part. Velocity output is the mean of `v = P·e` over the sub-step: the error
/// decays with the time constant 1/P, exactly, and D is left out.
#[derive(Debug, Clone)]
pub struct PoseDriver {
    gains: [Gains; 2],
    output: ControllerOutput,
    trends: [RateExtrapolator<Vector3<f64>>; 2],
}

impl PoseDriver {
    /// The controller of the two parts.
    pub fn new(linear: &Controller, angular: &Controller) -> Self {
        Self { gains: [linear.gains, angular.gains], output: linear.output, trends: Default::default() }
    }

    /// Whether it pulls like a spring.
    pub fn is_spring(&self) -> bool {
        self.output == ControllerOutput::Force
    }

    /// Uses other gains, linear and angular, from now on.
    pub fn set_gains(&mut self, gains: [Gains; 2]) {
        self.gains = gains;
    }

    /// The action in the sub-step of `h` s that follows. Deviations of position (m, m/s) and of orientation (rotation
    /// vector, rad, and rad/s) in world axes.
    pub fn update(&mut self, at: &[TrackingError<Vector3<f64>>; 2], h: f64) -> PoseAction {
        if self.is_spring() {
            PoseAction::Springs([0, 1].map(|i| {
                let ahead = self.trends[i].half_change(at[i].rate) * self.gains[i].d.max(0.0);
                spring(&self.gains[i], &at[i], ahead, Scheme::Staggered, h)
            }))
        } else {
            PoseAction::Velocity([0, 1].map(|i| {
                let (TrackingError { error, set_rate, .. }, p) = (at[i], self.gains[i].p);
                set_rate + (error * p - set_rate) * mean_decay(h * p)
            }))
        }
    }

    /// Forgets how the body moved, as after a break.
    pub fn reset(&mut self) {
        self.trends = Default::default();
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

    fn still(error: f64, rate: f64) -> TrackingError<f64> {
        TrackingError { error, set_rate: 0.0, rate }
    }

    /// Last error, and the largest beyond the goal, of a mass that is to go from 0 to 1.
    fn settle(controller: &Controller, mass: f64, scheme: Scheme, h: f64, seconds: f64) -> (f64, f64) {
        let (mut driver, mut x, mut v, mut beyond) = (JointDriver::new(controller), 0.0, 0.0, 0.0_f64);
        for _ in 0..(seconds / h).round() as usize {
            let before = v;
            v = solve(&driver.update(&still(1.0 - x, v), scheme, h), mass, v);
            x += h * if scheme == Scheme::Staggered { v } else { (v + before) / 2.0 };
            beyond = beyond.max(x - 1.0);
        }
        (1.0 - x, beyond)
    }

    const SCHEMES: [Scheme; 2] = [Scheme::Staggered, Scheme::Collocated];

    #[test]
    fn a_spring_is_a_spring() {
        // x = 1 - cos ωt exp(-δt)...: weakly damped, after ten turns.
        let (p, d) = (100.0_f64, 0.2);
        let (delta, omega) = (d / 2.0, (p - d * d / 4.0).sqrt());
        let t = 20.0 * std::f64::consts::PI / omega;
        let expected = ((omega * t).cos() + delta / omega * (omega * t).sin()) * (-delta * t).exp();
        for scheme in SCHEMES {
            let error = |h: f64| {
                let h = t / (t / h).round();
                (settle(&controller(p, 0.0, d, ControllerOutput::Force), 1.0, scheme, h, t).0 - expected).abs()
            };
            assert!(error(1e-3) < 4e-3 && error(1e-4) < 5e-4, "{scheme:?}: {} {}", error(1e-3), error(1e-4));
        }
    }

    #[test]
    fn dampers_are_right_to_second_order() {
        // x'' = -(x' - 1)·D: behind a set point that moves.
        for scheme in SCHEMES {
            let error = |h: f64| {
                let mut driver = JointDriver::new(&controller(0.0, 0.0, 5.0, ControllerOutput::Force));
                let (mut v, n) = (0.0, (0.4 / h) as usize);
                for i in 0..n {
                    // It speeds up, so that what a step misses does not decay.
                    let set_rate = (i as f64 + 0.5) * h;
                    v = solve(&driver.update(&TrackingError { error: 0.0, set_rate, rate: v }, scheme, h), 1.0, v);
                }
                let t = n as f64 * h;
                (v - (t - (1.0 - (-5.0 * t).exp()) / 5.0)).abs()
            };
            let (coarse, fine) = (error(0.01), error(0.0025));
            assert!(fine < 1e-4 && fine < coarse / 8.0, "{scheme:?}: {coarse} {fine}");
        }
    }

    #[test]
    fn no_step_is_too_long_and_no_gain_too_high() {
        for (scheme, h) in SCHEMES.iter().flat_map(|scheme| [1e-3, 0.016, 0.1].map(|h| (*scheme, h))) {
            for gain in [1.0, 1e3, 1e6, 1e9] {
                for output in [ControllerOutput::Force, ControllerOutput::Velocity] {
                    // A motor's mass follows its velocity at once: its way is that of the end.
                    let scheme = if output == ControllerOutput::Force { scheme } else { Scheme::Staggered };
                    let controller = controller(gain, 0.0, gain.sqrt() * 2.0, output);
                    let (rest, beyond) = settle(&controller, 1.0, scheme, h, 20.0);
                    let most = if scheme == Scheme::Staggered { 0.15 } else { 0.7 };
                    assert!(
                        rest.abs() < 2e-3 && beyond < most,
                        "{scheme:?}, {h}, {gain}, {output:?}: {rest}, {beyond}"
                    );
                }
            }
        }
    }

    #[test]
    fn the_default_motor_has_its_time_constant_at_every_step() {
        for h in [1e-4, 1e-3, 0.02] {
            // (1 + D)/P = 0.2 s.
            let (rest, _) = settle(&Controller::default(), 1.0, Scheme::Staggered, h, 0.2);
            assert!((rest - (-1.0_f64).exp()).abs() < 1e-9, "{h}: {rest}");
        }
    }

    #[test]
    fn the_integral_starts_after_a_break_and_the_set_rate_leads() {
        let mut driver = JointDriver::new(&controller(0.0, 8.0, 0.0, ControllerOutput::Velocity));
        let mut velocity = |error: f64| driver.update(&still(error, 0.0), Scheme::Staggered, 0.1).velocity;
        assert_eq!(velocity(1.0), 0.0);
        assert!((velocity(2.0) - 8.0 * 0.15).abs() < 1e-12);
        driver.reset();
        assert_eq!(driver.update(&still(1.0, 0.0), Scheme::Staggered, 0.1).velocity, 0.0);
        let mut driver = JointDriver::new(&controller(1e3, 0.0, 50.0, ControllerOutput::Force));
        let row = driver.update(&TrackingError { error: 0.0, set_rate: 0.7, rate: 0.7 }, Scheme::Staggered, 1e-3);
        assert!((solve(&row, 2.0, 0.7) - 0.7).abs() < 1e-12, "it follows without error: {row:?}");
    }

    #[test]
    fn a_set_point_goes_on_but_a_jump_does_not() {
        let SetpointMotion { rate, drift } = SetpointMotion::following(1.0, 0.9);
        assert!((rate - 1.1_f64).abs() < 1e-12 && drift == rate);
        assert_eq!(SetpointMotion::following(1.0, 0.0), SetpointMotion { rate: 1.25, drift: 0.0 });
        for (latest, before) in [(0.0, 1.0), (0.0, 0.0)] {
            assert_eq!(SetpointMotion::following(latest, before), SetpointMotion { rate: 0.0, drift: 0.0 });
        }
    }

    #[test]
    fn without_gains_to_be_implicit_in_it_is_a_force() {
        for (gains, force) in [((0.0, 3.0, 0.0), 0.0), ((-5.0, 0.0, 0.0), -10.0), ((5.0, 0.0, -1.0), 14.0)] {
            let (p, i, d) = gains;
            let mut driver = JointDriver::new(&controller(p, i, d, ControllerOutput::Force));
            let row = driver.update(&still(2.0, 4.0), Scheme::Staggered, 1e-3);
            assert!((solve(&row, 3.0, 4.0) - 4.0 - force * 1e-3 / 3.0).abs() < 1e-9, "{gains:?}: {row:?}");
        }
    }

    #[test]
    fn a_pose_has_two_springs_or_two_velocities() {
        let part = |p, output| controller(p, 0.0, 1.0, output);
        let at = [Vector3::x(), Vector3::y() * 0.1].map(|error| TrackingError {
            error,
            set_rate: Vector3::zeros(),
            rate: Vector3::zeros(),
        });
        let mut driver =
            PoseDriver::new(&part(100.0, ControllerOutput::Force), &part(10.0, ControllerOutput::Velocity));
        let PoseAction::Springs([linear, angular]) = driver.update(&at, 0.01) else {
            panic!("the linear part decides")
        };
        assert!((linear.velocity - Vector3::x() * 50.0).norm() < 1e-9 && (linear.softness - 50.0).abs() < 1e-9);
        assert!((angular.velocity - Vector3::y() / 1.1).norm() < 1e-9 && (angular.softness - 100.0 / 1.1).abs() < 1e-9);
        let mut driver = PoseDriver::new(&Controller::default(), &Controller::default());
        let PoseAction::Velocity([v, w]) = driver.update(&at, 0.01) else { panic!("velocities") };
        let mean = (1.0 - (-0.1_f64).exp()) / 0.01;
        assert!((v - Vector3::x() * mean).norm() < 1e-9 && (w - Vector3::y() * 0.1 * mean).norm() < 1e-9);
    }
}
