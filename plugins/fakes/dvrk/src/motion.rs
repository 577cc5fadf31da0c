//! How the hand that holds a fake arm moves it.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// The curve of the paper, its equation 9: `P = P_off + S · (a sin(tc·t), b cos(tc·t), c sin(tc·t))`, in the device
/// frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Curve {
    /// `P_off`, m. Default: 0.
    pub offset: Vector3<f64>,
    /// `S`, m. Default: 0.1.
    pub size: f64,
    /// `a`, `b`, `c`. Default: 1, 1, 2.
    pub shape: Vector3<f64>,
    /// `tc`, rad/s. Default: 4.
    pub speed: f64,
}

impl Default for Curve {
    fn default() -> Self {
        Self { offset: Vector3::zeros(), size: 0.1, shape: Vector3::new(1.0, 1.0, 2.0), speed: 4.0 }
    }
}

impl Curve {
    /// Position at time `t`, s.
    pub fn position(&self, t: f64) -> Vector3<f64> {
        let (sin, cos) = (self.speed * t).sin_cos();
        self.offset + self.size * self.shape.component_mul(&Vector3::new(sin, cos, sin))
    }
}

/// Where a hand wants to be, in the device frame.
#[derive(Debug, Clone, PartialEq)]
pub enum Motion {
    /// At rest at a pose.
    Still(Isometry3<f64>),
    /// On a curve, with constant orientation.
    Curve(Curve, UnitQuaternion<f64>),
}

impl Motion {
    /// The pose at time `t`, s.
    pub fn pose(&self, t: f64) -> Isometry3<f64> {
        match self {
            Self::Still(pose) => *pose,
            Self::Curve(curve, rotation) => Isometry3::from_parts(curve.position(t).into(), *rotation),
        }
    }
}

/// A hand that gives way: a mass on a spring and a damper to where it wants to be, pushed by the force that the arm is
/// told to show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hand {
    /// kg. Default: 0.3.
    pub mass: f64,
    /// N/m. Default: 200.
    pub stiffness: f64,
    /// N·s/m. Default: 5.
    pub damping: f64,
}

impl Default for Hand {
    fn default() -> Self {
        Self { mass: 0.3, stiffness: 200.0, damping: 5.0 }
    }
}

/// Where such a hand is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct HandState {
    /// From where it wants to be, m.
    pub deviation: Vector3<f64>,
    velocity: Vector3<f64>,
}

impl HandState {
    /// Goes on by `dt`, s, pushed by `force`, N.
    pub fn step(&mut self, hand: &Hand, force: &Vector3<f64>, dt: f64) {
        // Short steps, so that stiff hands are stable at any rate of publishing.
        let steps = (dt / 2.5e-4).ceil().clamp(1.0, 4000.0);
        let h = dt / steps;
        for _ in 0..steps as usize {
            let acceleration = (force - self.deviation * hand.stiffness - self.velocity * hand.damping) / hand.mass;
            self.velocity += acceleration * h;
            self.deviation += self.velocity * h;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_is_the_papers() {
        let curve = Curve::default();
        assert_eq!(curve.position(0.0), Vector3::new(0.0, 0.1, 0.0));
        let quarter = std::f64::consts::PI / 8.0;
        assert!((curve.position(quarter) - Vector3::new(0.1, 0.0, 0.2)).norm() < 1e-15);
    }

    #[test]
    fn a_hand_gives_way_as_its_spring_does() {
        let (hand, mut state) = (Hand::default(), HandState::default());
        for _ in 0..2000 {
            state.step(&hand, &Vector3::new(2.0, 0.0, 0.0), 1e-3);
        }
        assert!((state.deviation - Vector3::new(0.01, 0.0, 0.0)).norm() < 1e-5, "{}", state.deviation);
    }
}
