//! How regularly arms are updated, and how long that takes: what a dVRK component publishes as `period_statistics`.

use std::time::{Duration, Instant};

/// Length of a window.
const WINDOW: Duration = Duration::from_secs(1);

/// Mean, standard deviation and extremes of a time, s.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Summary {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub deviation: f64,
    /// Shortest.
    pub least: f64,
    /// Longest.
    pub most: f64,
}

/// What a window has shown.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Statistics {
    /// Number of the window; 0: none is over yet.
    pub window: u64,
    /// Time from one update to the next.
    pub period: Summary,
    /// Time that updates took.
    pub compute: Summary,
    /// Updates.
    pub samples: u64,
    /// Updates that took longer than the mean period of the window before.
    pub overruns: u64,
    /// How long the window was, s.
    pub interval: f64,
}

/// Running mean and sum of squares (Welford 1962).
#[derive(Debug, Clone, Copy, Default)]
struct Running {
    count: u64,
    mean: f64,
    squares: f64,
    least: f64,
    most: f64,
}

impl Running {
    fn add(&mut self, value: f64) {
        self.count += 1;
        (self.least, self.most) =
            if self.count == 1 { (value, value) } else { (self.least.min(value), self.most.max(value)) };
        let apart = value - self.mean;
        self.mean += apart / self.count as f64;
        self.squares += apart * (value - self.mean);
    }

    fn summary(&self) -> Summary {
        let variance = if self.count > 0 { self.squares / self.count as f64 } else { 0.0 };
        Summary { mean: self.mean, deviation: variance.sqrt(), least: self.least, most: self.most }
    }
}

/// Measures updates. It never allocates.
#[derive(Debug, Clone, Default)]
pub struct Meter {
    last: Statistics,
    begin: Option<Instant>,
    previous: Option<Instant>,
    period: Running,
    compute: Running,
    overruns: u64,
}

impl Meter {
    /// Counts an update from `begin` to `end`.
    pub fn record(&mut self, begin: Instant, end: Instant) {
        let window_begin = *self.begin.get_or_insert(begin);
        if let Some(previous) = self.previous.replace(begin) {
            self.period.add(begin.saturating_duration_since(previous).as_secs_f64());
        }
        let took = end.saturating_duration_since(begin).as_secs_f64();
        self.compute.add(took);
        if self.last.window > 0 && took > self.last.period.mean {
            self.overruns += 1;
        }
        let interval = begin.saturating_duration_since(window_begin);
        if interval >= WINDOW {
            self.last = Statistics {
                window: self.last.window + 1,
                period: self.period.summary(),
                compute: self.compute.summary(),
                samples: self.compute.count,
                overruns: self.overruns,
                interval: interval.as_secs_f64(),
            };
            (self.begin, self.period, self.compute, self.overruns) =
                (Some(begin), Running::default(), Running::default(), 0);
        }
    }

    /// The last window that is over.
    pub fn statistics(&self) -> Statistics {
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_has_means_deviations_and_extremes() {
        let (mut meter, start) = (Meter::default(), Instant::now());
        let mut now = start;
        // Periods of 1 and 3 ms in turn; each update takes 0.2 ms, one 5 ms.
        for k in 0..1002_u32 {
            let took = if k == 600 { 5000 } else { 200 };
            meter.record(now, now + Duration::from_micros(took));
            now += Duration::from_millis(if k % 2 == 0 { 1 } else { 3 });
        }
        let statistics = meter.statistics();
        assert_eq!(statistics.window, 2);
        assert!((statistics.period.mean - 2e-3).abs() < 1e-5, "{statistics:?}");
        assert!((statistics.period.deviation - 1e-3).abs() < 1e-5, "{statistics:?}");
        assert!((statistics.period.least - 1e-3).abs() < 1e-9 && (statistics.period.most - 3e-3).abs() < 1e-9);
        assert_eq!((statistics.samples, statistics.overruns), (500, 1));
        assert!((statistics.compute.most - 5e-3).abs() < 1e-9 && (statistics.compute.least - 2e-4).abs() < 1e-9);
        assert!((statistics.interval - 1.0).abs() < 4e-3);
    }
}
