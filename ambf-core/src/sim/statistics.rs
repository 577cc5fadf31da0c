use std::time::Duration;

use crate::device::timing::Histogram;

/// Costs of iterations, counted over windows of one second; percentiles of the last complete window. Recording takes
/// constant time and no memory.
#[derive(Debug, Default)]
pub(super) struct StepStatistics {
    window_start: Duration,
    costs: Histogram,
    total: u32,
    /// Iterations in the last complete window, Hz.
    pub frequency: f64,
    /// 50th, 90th, 99th percentile and maximum of the last complete window, s.
    pub percentiles: [f64; 4],
}

impl StepStatistics {
    /// Counts an iteration that ended at `now` after `cost` of computing.
    pub fn record(&mut self, now: Duration, cost: Duration) {
        let window = now.saturating_sub(self.window_start);
        if window >= Duration::from_secs(1) {
            self.frequency = f64::from(self.total) / window.as_secs_f64();
            let [p50, p90, p99] = [0.5, 0.9, 0.99].map(|share| self.costs.percentile(share));
            self.percentiles = [p50, p90, p99, self.costs.max()];
            self.costs.clear();
            self.total = 0;
            self.window_start = now;
        }
        self.costs.record(cost);
        self.total += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_of_the_last_second() {
        let mut statistics = StepStatistics::default();
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
}
