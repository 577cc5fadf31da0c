//! Poses for tests, the same at each run.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// Numbers by SplitMix64.
pub(super) struct Random(u64);

impl Random {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// In [−1, 1).
    pub(super) fn signed(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    /// In [0, 1).
    pub(super) fn share(&mut self) -> f64 {
        (self.signed() + 1.0) / 2.0
    }

    /// True in one case of `n`.
    pub(super) fn one_in(&mut self, n: u64) -> bool {
        self.next().is_multiple_of(n)
    }

    pub(super) fn vector(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.signed())
    }

    pub(super) fn rotation(&mut self) -> UnitQuaternion<f64> {
        loop {
            let q = Quaternion::new(self.signed(), self.signed(), self.signed(), self.signed());
            if (0.1..1.0).contains(&q.norm()) {
                return UnitQuaternion::from_quaternion(q);
            }
        }
    }

    pub(super) fn pose(&mut self) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::from(self.vector()), self.rotation())
    }
}
