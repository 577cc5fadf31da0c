//! How often something happens, counted by one thread and read by any other, without a lock and without allocating.

use std::fmt;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use crate::timing::Histogram;

/// Periods of something that repeats.
#[derive(Debug, Default)]
pub(super) struct Periods {
    histogram: Histogram,
    /// Events in the last complete second.
    rate: AtomicU32,
}

impl Periods {
    /// What was counted until now.
    pub fn read(&self) -> Rate {
        let (count, sum) = (self.histogram.count(), self.histogram.sum());
        let [p50, p99, p999] = [0.5, 0.99, 0.999].map(|share| self.histogram.percentile(share));
        Rate {
            count,
            mean: if sum > 0.0 { count as f64 / sum } else { 0.0 },
            latest: f64::from(self.rate.load(Ordering::Relaxed)),
            periods: [p50, p99, p999, self.histogram.max()],
        }
    }
}

/// How often something happened since the start; times without the device do not count.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rate {
    /// Periods that were counted.
    pub count: u64,
    /// Hz.
    pub mean: f64,
    /// In the last complete second, Hz; 0 in the first one.
    pub latest: f64,
    /// 50th, 99th, 99.9th percentile and maximum of the period, s; right within 1/64.
    pub periods: [f64; 4],
}

impl fmt::Display for Rate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.count == 0 {
            return write!(f, "none yet");
        }
        let [p50, p99, p999, max] = self.periods.map(|period| period * 1e3);
        write!(f, "{:.0} Hz (periods p50 {p50:.2}, p99 {p99:.2}, p99.9 {p999:.2}, max {max:.1} ms)", self.mean)
    }
}

/// The counting thread's end.
#[derive(Debug)]
pub(super) struct Counter {
    last: Option<Instant>,
    window: Option<(Instant, u32)>,
}

impl Counter {
    pub fn new() -> Self {
        Self { last: None, window: None }
    }

    /// Counts an event.
    pub fn count(&mut self, periods: &Periods, now: Instant) {
        if let Some(last) = self.last.replace(now) {
            periods.histogram.record(now.saturating_duration_since(last));
        }
        let (start, events) = self.window.get_or_insert((now, 0));
        let open = now.saturating_duration_since(*start);
        if open >= Duration::from_secs(1) {
            periods.rate.store((f64::from(*events) / open.as_secs_f64()).round() as u32, Ordering::Relaxed);
            (*start, *events) = (now, 0);
        }
        *events += 1;
    }

    /// What comes next is not a period after what came before.
    pub fn interrupt(&mut self, periods: &Periods) {
        periods.rate.store(0, Ordering::Relaxed);
        (self.last, self.window) = (None, None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interruption_is_no_period() {
        let (periods, mut counter) = (Periods::default(), Counter::new());
        let begin = Instant::now();
        for ms in 0..1500 {
            counter.count(&periods, begin + Duration::from_millis(ms));
        }
        assert_eq!(periods.read().latest, 1000.0);
        counter.interrupt(&periods);
        counter.count(&periods, begin + Duration::from_secs(60));
        let rate = periods.read();
        assert!((rate.count, rate.latest) == (1499, 0.0) && rate.periods[3] < 0.002, "{rate:?}");
        assert!(rate.to_string().starts_with("1000 Hz"), "{rate}");
    }
}
