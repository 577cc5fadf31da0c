use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

/// Buckets that a power of two is split into: a percentile is right within 1/64 of its value.
const PARTS: u32 = 32;
/// From 1 ns to 2^40 ns, over 18 minutes.
const BUCKETS: usize = 40 * PARTS as usize;

/// Distribution of durations in buckets of equal relative width. One thread records, in constant time, without a lock
/// and without allocating; any other may read meanwhile.
#[derive(Debug)]
pub struct Histogram {
    counts: Box<[AtomicU32]>,
    /// ns.
    sum: AtomicU64,
    /// ns.
    max: AtomicU64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self {
            counts: (0..BUCKETS).map(|_| AtomicU32::new(0)).collect(),
            sum: AtomicU64::new(0),
            max: AtomicU64::new(0),
        }
    }
}

impl Histogram {
    /// Counts a duration.
    pub fn record(&self, duration: Duration) {
        let ns = u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX);
        self.counts[bucket(ns)].fetch_add(1, Ordering::Relaxed);
        self.sum.fetch_add(ns, Ordering::Relaxed);
        self.max.fetch_max(ns, Ordering::Relaxed);
    }

    /// Forgets everything.
    pub fn clear(&self) {
        self.counts.iter().for_each(|count| count.store(0, Ordering::Relaxed));
        self.sum.store(0, Ordering::Relaxed);
        self.max.store(0, Ordering::Relaxed);
    }

    /// How many durations were recorded.
    pub fn count(&self) -> u64 {
        self.counts.iter().map(|count| u64::from(count.load(Ordering::Relaxed))).sum()
    }

    /// Sum of all durations, s.
    pub fn sum(&self) -> f64 {
        self.sum.load(Ordering::Relaxed) as f64 * 1e-9
    }

    /// The longest duration, s; 0 without any.
    pub fn max(&self) -> f64 {
        self.max.load(Ordering::Relaxed) as f64 * 1e-9
    }

    /// The duration that a share of 0 … 1 of all does not exceed, s, right within 1/64; 0 without any.
    pub fn percentile(&self, share: f64) -> f64 {
        let rank = ((share * self.count() as f64).ceil() as u64).max(1);
        let mut seen = 0;
        let found = self.counts.iter().position(|count| {
            seen += u64::from(count.load(Ordering::Relaxed));
            seen >= rank
        });
        found.map_or(0.0, |index| middle(index).min(self.max()))
    }
}

fn bucket(ns: u64) -> usize {
    let ns = ns.max(1);
    let power = ns.ilog2();
    let part = match power.checked_sub(PARTS.ilog2()) {
        Some(shift) => (ns >> shift) as u32 & (PARTS - 1),
        None => 0,
    };
    ((power * PARTS + part) as usize).min(BUCKETS - 1)
}

/// Middle of a bucket, s.
fn middle(index: usize) -> f64 {
    let (power, part) = (index as u32 / PARTS, index as u32 % PARTS);
    1e-9 * 2f64.powi(power as i32) * (1.0 + (f64::from(part) + 0.5) / f64::from(PARTS))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_right_within_a_bucket() {
        let histogram = Histogram::default();
        assert_eq!((histogram.percentile(0.5), histogram.max()), (0.0, 0.0));
        for us in 1..=1000 {
            histogram.record(Duration::from_micros(us));
        }
        for (share, expected) in [(0.5, 500e-6), (0.99, 990e-6), (0.999, 999e-6), (1.0, 1000e-6)] {
            let found = histogram.percentile(share);
            assert!((found / expected - 1.0).abs() < 1.0 / 50.0, "{found} for {expected}");
        }
        assert!(histogram.count() == 1000 && (histogram.sum() - 0.5005).abs() < 1e-9);
        histogram.clear();
        assert_eq!((histogram.count(), histogram.sum(), histogram.max()), (0, 0.0, 0.0));
    }

    #[test]
    fn every_duration_has_a_bucket_and_is_near_its_middle() {
        assert!(bucket(0) < BUCKETS && bucket(u64::MAX) < BUCKETS);
        for ns in [200u64, 12_345, 1_000_000, 7_654_321, 5_000_000_000] {
            let ratio = middle(bucket(ns)) / (ns as f64 * 1e-9);
            assert!((ratio - 1.0).abs() < 1.0 / 60.0, "{ns}: {ratio}");
        }
    }
}
