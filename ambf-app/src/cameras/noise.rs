//! Noise on depth.

use std::time::{SystemTime, UNIX_EPOCH};

use ambf_core::adf::DepthNoise;

/// Normally distributed numbers: SplitMix64 and the method of Box and Muller.
#[derive(Debug)]
pub(super) struct Noise {
    mean: f64,
    std_dev: f64,
    state: u64,
}

impl Noise {
    /// Noise as described; without a seed of its own it is made from the clock.
    pub fn new(described: &DepthNoise) -> Self {
        let clock = || SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos() as u64;
        let state = described.seed.map_or_else(clock, u64::from);
        Self { mean: described.mean + described.bias, std_dev: described.std_dev, state }
    }

    /// In (0, 1].
    fn share(&mut self) -> f64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.state ^ (self.state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64 + 1.0 / (1u64 << 54) as f64
    }

    /// Replaces `numbers` by `count` new ones, m.
    pub fn fill(&mut self, numbers: &mut Vec<f32>, count: usize) {
        numbers.clear();
        if self.std_dev == 0.0 {
            numbers.resize(count, self.mean as f32);
            return;
        }
        numbers.reserve(count + 1);
        while numbers.len() < count {
            let radius = self.std_dev * (-2.0 * self.share().ln()).sqrt();
            let (sine, cosine) = (std::f64::consts::TAU * self.share()).sin_cos();
            numbers.extend([sine, cosine].map(|part| (self.mean + radius * part) as f32));
        }
        numbers.truncate(count);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(std_dev: f64, seed: Option<u32>) -> Vec<f32> {
        let mut numbers = Vec::new();
        Noise::new(&DepthNoise { mean: 0.1, std_dev, bias: 0.05, seed }).fill(&mut numbers, 100_001);
        numbers
    }

    #[test]
    fn mean_and_bias_are_both_added() {
        assert!(noise(0.0, None).iter().all(|n| *n == 0.15));
    }

    #[test]
    fn it_is_normally_distributed() {
        let numbers = noise(0.02, Some(1));
        let count = numbers.len() as f64;
        let moment = |k: i32| numbers.iter().map(|n| ((f64::from(*n) - 0.15) / 0.02).powi(k)).sum::<f64>() / count;
        assert_eq!(numbers.len(), 100_001);
        assert!(moment(1).abs() < 0.015 && (moment(2) - 1.0).abs() < 0.02, "{} {}", moment(1), moment(2));
        assert!(moment(3).abs() < 0.04 && (moment(4) - 3.0).abs() < 0.1, "{} {}", moment(3), moment(4));
    }

    #[test]
    fn a_seed_repeats_it() {
        assert_eq!(noise(0.02, Some(7)), noise(0.02, Some(7)));
        assert_ne!(noise(0.02, Some(7)), noise(0.02, Some(8)));
    }
}
