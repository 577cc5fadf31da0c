use std::time::Duration;

/// Buckets a power of two is split into: a percentile is right within 1/16 of its value.
const PARTS: u32 = 8;
/// From 1 ns to 2^40 ns, over 18 minutes.
const BUCKETS: usize = 40 * PARTS as usize;

/// Costs of iterations, counted over windows of one second; percentiles of the last complete window. Recording takes
/// constant time and no memory.
#[derive(Debug, Clone)]
pub(super) struct StepStatistics {
    window_start: Duration,
    counts: Box<[u32; BUCKETS]>,
    total: u32,
    max: Duration,
    /// Iterations in the last complete window, Hz.
    pub frequency: f64,
    /// 50th, 90th, 99th percentile and maximum of the last complete window, s.
    pub percentiles: [f64; 4],
}

impl StepStatistics {
    pub fn new() -> Self {
        Self {
            window_start: Duration::ZERO,
            counts: Box::new([0; BUCKETS]),
            total: 0,
            max: Duration::ZERO,
            frequency: 0.0,
            percentiles: [0.0; 4],
        }
    }

    /// Counts an iteration that ended at `now` after `cost` of computing.
    pub fn record(&mut self, now: Duration, cost: Duration) {
        let window = now.saturating_sub(self.window_start);
        if window >= Duration::from_secs(1) {
            self.close(window);
            self.window_start = now;
        }
        self.counts[bucket(cost)] += 1;
        self.total += 1;
        self.max = self.max.max(cost);
    }

    fn close(&mut self, window: Duration) {
        self.frequency = f64::from(self.total) / window.as_secs_f64();
        self.percentiles = [self.percentile(0.5), self.percentile(0.9), self.percentile(0.99), self.max.as_secs_f64()];
        self.counts.fill(0);
        self.total = 0;
        self.max = Duration::ZERO;
    }

    fn percentile(&self, share: f64) -> f64 {
        let rank = (share * f64::from(self.total)).ceil() as u32;
        let mut seen = 0;
        let found = self.counts.iter().position(|&count| {
            seen += count;
            seen >= rank
        });
        found.map_or(0.0, |index| middle(index).min(self.max.as_secs_f64()))
    }
}

fn bucket(cost: Duration) -> usize {
    let ns = (cost.as_nanos() as u64).max(1);
    let power = ns.ilog2();
    let part = if power >= 3 { (ns >> (power - 3)) as u32 & (PARTS - 1) } else { 0 };
    ((power * PARTS + part) as usize).min(BUCKETS - 1)
}

/// Middle of a bucket, s.
fn middle(index: usize) -> f64 {
    let (power, part) = (index as u32 / PARTS, index as u32 % PARTS);
    let low = 2f64.powi(power as i32);
    1e-9 * low * (1.0 + (f64::from(part) + 0.5) / f64::from(PARTS))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_of_the_last_second() {
        let mut statistics = StepStatistics::new();
        for i in 0..=1000u64 {
            statistics.record(Duration::from_millis(i), Duration::from_micros(1 + i));
        }
        assert!((statistics.frequency - 1000.0).abs() < 1e-9);
        let [p50, p90, p99, max] = statistics.percentiles;
        for (found, expected) in [(p50, 500e-6), (p90, 900e-6), (p99, 990e-6)] {
            assert!((found / expected - 1.0).abs() < 1.0 / 16.0, "{found} for {expected}");
        }
        assert_eq!(max, 1000e-6);
    }

    #[test]
    fn every_cost_has_a_bucket() {
        for cost in [0, 1, 7, 8, 1_000, u64::MAX] {
            assert!(bucket(Duration::from_nanos(cost)) < BUCKETS);
        }
        for ns in [100u64, 12_345, 7_654_321] {
            let ratio = middle(bucket(Duration::from_nanos(ns))) / (ns as f64 * 1e-9);
            assert!((ratio - 1.0).abs() < 1.0 / 15.0, "{ratio}");
        }
    }
}
