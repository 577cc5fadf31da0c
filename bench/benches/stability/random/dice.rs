//! Draws of the generator.

use std::f64::consts::TAU;

use nalgebra::{UnitQuaternion, Vector3};

use super::super::families::Dice;

/// The sequence of scene `index` of `seed`: it depends on these two only.
pub fn of(seed: u64, index: u64) -> Dice {
    let mut dice = Dice(seed.wrapping_mul(0xd134_2543_de82_ef95) ^ index.wrapping_mul(0xa076_1d64_78bd_642f));
    dice.roll();
    dice
}

impl Dice {
    /// True with this probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.roll() < probability
    }

    /// Uniform in [low, high).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.roll()
    }

    /// Uniform in the logarithm.
    pub fn decades(&mut self, low: f64, high: f64) -> f64 {
        (low.ln() + (high / low).ln() * self.roll()).exp()
    }

    /// In [low, high], both included.
    pub fn count(&mut self, low: usize, high: usize) -> usize {
        low + self.index(high - low + 1)
    }

    /// One of the list.
    pub fn pick<T: Copy>(&mut self, list: &[T]) -> T {
        list[self.index(list.len())]
    }

    /// With each component in [-size, size).
    pub fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.between(-size, size))
    }

    /// Uniform on the sphere.
    pub fn direction(&mut self) -> Vector3<f64> {
        let (z, angle) = (self.between(-1.0, 1.0), self.between(0.0, TAU));
        let radius = (1.0 - z * z).max(0.0).sqrt();
        Vector3::new(radius * angle.cos(), radius * angle.sin(), z)
    }

    /// A coordinate axis of the world or, rarely, any direction: as people draw joints.
    pub fn axis(&mut self) -> Vector3<f64> {
        match self.index(8) {
            0 | 1 => Vector3::x(),
            2 | 3 => Vector3::y(),
            4 | 5 => Vector3::z(),
            6 => -self.pick(&[Vector3::x(), Vector3::y(), Vector3::z()]),
            _ => self.direction(),
        }
    }

    /// Rotation by up to `angle` rad about any axis.
    pub fn rotation(&mut self, angle: f64) -> UnitQuaternion<f64> {
        let axis = self.direction();
        UnitQuaternion::from_scaled_axis(axis * self.between(-angle, angle))
    }
}
