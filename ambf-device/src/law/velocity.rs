use std::time::{Duration, Instant};

use nalgebra::{UnitQuaternion, Vector3};

use super::rotation::rotation_vector;

const LENGTH: usize = 200;
/// Samples closer to the one before are dropped.
const SPACING: Duration = Duration::from_micros(100);
const LINEAR_WINDOW: Duration = Duration::from_millis(15);
const ANGULAR_WINDOW: Duration = Duration::from_millis(30);
/// Of a device slower than the windows, the sample before the newest counts up to this age.
const SLOWEST: Duration = Duration::from_millis(100);

#[derive(Debug, Clone, Copy)]
struct Entry {
    stamp: Instant,
    position: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
    gripper: f64,
}

/// Velocities of a device that measures none itself, from its last 200 samples.
///
/// `v = (newest − oldest)/Δt`, the oldest sample being the oldest one inside a window of 15 ms (translation, gripper)
/// or 30 ms (rotation); if there is none, the sample before the newest, if it is less than 100 ms older.
#[derive(Debug, Clone)]
pub struct VelocityEstimator {
    ring: [Option<Entry>; LENGTH],
    newest: usize,
}

impl Default for VelocityEstimator {
    fn default() -> Self {
        Self { ring: [None; LENGTH], newest: 0 }
    }
}

impl VelocityEstimator {
    /// Takes a sample in: position in m, gripper 0…1. One that is less than 0.1 ms younger than the last is dropped. A
    /// clock that went back by more than the longest window starts anew.
    pub fn push(
        &mut self,
        stamp: Instant,
        position: Vector3<f64>,
        rotation: UnitQuaternion<f64>,
        gripper: Option<f64>,
    ) {
        if let Some(last) = &self.ring[self.newest] {
            if stamp + SLOWEST < last.stamp {
                self.clear();
            } else if stamp < last.stamp + SPACING {
                return;
            }
        }
        self.newest = (self.newest + 1) % LENGTH;
        self.ring[self.newest] = Some(Entry { stamp, position, rotation, gripper: gripper.unwrap_or(0.0) });
    }

    /// Forgets all samples: velocities are zero until there are two new ones.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// m/s.
    pub fn linear(&self) -> Vector3<f64> {
        let pair = self.span(LINEAR_WINDOW);
        pair.map_or_else(Vector3::zeros, |(old, new, dt)| (new.position - old.position) / dt)
    }

    /// rad/s, in the axes in which the rotations are given: `R_new·log(R_oldᵀ·R_new)/Δt`.
    pub fn angular(&self) -> Vector3<f64> {
        let pair = self.span(ANGULAR_WINDOW);
        let rate = |(old, new, dt): (&Entry, &Entry, f64)| {
            new.rotation * (rotation_vector(&(old.rotation.inverse() * new.rotation)) / dt)
        };
        pair.map_or_else(Vector3::zeros, rate)
    }

    /// Of the opening 0…1, 1/s.
    pub fn gripper(&self) -> f64 {
        self.span(LINEAR_WINDOW).map_or(0.0, |(old, new, dt)| (new.gripper - old.gripper) / dt)
    }

    /// Oldest sample of the window, newest sample, time between them in s.
    fn span(&self, window: Duration) -> Option<(&Entry, &Entry, f64)> {
        let new = self.ring[self.newest].as_ref()?;
        let mut oldest = None;
        for back in 1..LENGTH {
            let Some(entry) = &self.ring[(self.newest + LENGTH - back) % LENGTH] else { break };
            let age = new.stamp.duration_since(entry.stamp);
            if age > window && (oldest.is_some() || age > SLOWEST) {
                break;
            }
            oldest = Some(entry);
            if age > window {
                break;
            }
        }
        let old = oldest?;
        Some((old, new, new.stamp.duration_since(old.stamp).as_secs_f64()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Estimate after `ticks` samples `period` apart of a motion of `v` and `w` (device axes).
    fn moved(period: Duration, ticks: u32, v: Vector3<f64>, w: Vector3<f64>) -> VelocityEstimator {
        let (mut estimator, start) = (VelocityEstimator::default(), Instant::now());
        for i in 0..ticks {
            let t = (period * i).as_secs_f64();
            let rotation = UnitQuaternion::new(w * t) * UnitQuaternion::new(Vector3::new(0.3, 1.0, -0.2));
            estimator.push(start + period * i, v * t, rotation, Some(0.5 * t));
        }
        estimator
    }

    #[test]
    fn uniform_motion_is_found_at_any_rate() {
        let (v, w) = (Vector3::new(0.1, -0.2, 0.3), Vector3::new(1.0, 0.5, -2.0));
        // 1 kHz, 100 Hz, slower than the windows, and so fast that most samples are dropped.
        for period in [1_000, 10_000, 25_000, 30].map(Duration::from_micros) {
            let estimator = moved(period, 1000, v, w);
            assert!((estimator.linear() - v).norm() < 1e-6, "{period:?}: {}", estimator.linear());
            assert!((estimator.angular() - w).norm() < 1e-6, "{period:?}: {}", estimator.angular());
            assert!((estimator.gripper() - 0.5).abs() < 1e-6);
        }
    }

    #[test]
    fn only_the_window_counts() {
        let (mut estimator, start) = (VelocityEstimator::default(), Instant::now());
        for i in 0..100u32 {
            let x = if i < 50 { 0.0 } else { f64::from(i - 50) * 1e-3 };
            let position = Vector3::new(x, 0.0, 0.0);
            estimator.push(start + Duration::from_millis(u64::from(i)), position, UnitQuaternion::identity(), None);
            if i == 57 {
                // 15 ms hold 8 ms of rest and 7 ms of 1 m/s.
                assert!((estimator.linear().x - 7.0 / 15.0).abs() < 1e-9, "{}", estimator.linear());
            }
        }
        assert!((estimator.linear().x - 1.0).abs() < 1e-9);
    }

    #[test]
    fn nothing_is_made_of_one_sample_or_a_clock_that_went_back() {
        let period = Duration::from_millis(1);
        let mut estimator = moved(period, 1, Vector3::x(), Vector3::x());
        assert_eq!((estimator.linear(), estimator.angular()), (Vector3::zeros(), Vector3::zeros()));
        let past = Instant::now().checked_sub(Duration::from_secs(1)).expect("the clock is older than that");
        for i in 0..10 {
            let position = Vector3::new(0.0, f64::from(i) * 1e-3, 0.0);
            estimator.push(past + period * i, position, UnitQuaternion::identity(), None);
        }
        assert!((estimator.linear() - Vector3::y()).norm() < 1e-6);
    }
}
