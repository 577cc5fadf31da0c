//! How often something happens, counted by one thread and read by any other, without a lock and without allocating.

use std::fmt;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Buckets that a power of two is split into: a percentile is right within 1/64 of its value.
const PARTS: u32 = 32;
/// From 1 ns to 2^40 ns, over 18 minutes.
const BUCKETS: usize = 40 * PARTS as usize;

/// Periods of something that repeats.
#[derive(Debug)]
pub(super) struct Periods {
    counts: Box<[AtomicU32]>,
    count: AtomicU64,
    /// ns.
    sum: AtomicU64,
    max: AtomicU64,
    /// Events in the last complete second.
    rate: AtomicU32,
}

impl Periods {
    pub fn new() -> Self {
        Self {
            counts: (0..BUCKETS).map(|_| AtomicU32::new(0)).collect(),
            count: AtomicU64::new(0),
            sum: AtomicU64::new(0),
            max: AtomicU64::new(0),
            rate: AtomicU32::new(0),
        }
    }

    fn record(&self, period: Duration) {
        let ns = u64::try_from(period.as_nanos()).unwrap_or(u64::MAX);
        self.counts[bucket(ns)].fetch_add(1, Ordering::Relaxed);
        self.sum.fetch_add(ns, Ordering::Relaxed);
        self.max.fetch_max(ns, Ordering::Relaxed);
        self.count.fetch_add(1, Ordering::Relaxed);
    }

    /// What was counted until now.
    pub fn read(&self) -> Rate {
        let counts: Vec<u64> = self.counts.iter().map(|count| u64::from(count.load(Ordering::Relaxed))).collect();
        let total: u64 = counts.iter().sum();
        let max = self.max.load(Ordering::Relaxed) as f64 * 1e-9;
        let percentile = |share: f64| {
            let rank = ((share * total as f64).ceil() as u64).max(1);
            let mut seen = 0;
            let found = counts.iter().position(|&count| {
                seen += count;
                seen >= rank
            });
            found.map_or(0.0, |index| middle(index).min(max))
        };
        let sum = self.sum.load(Ordering::Relaxed) as f64 * 1e-9;
        Rate {
            count: total,
            mean: if sum > 0.0 { total as f64 / sum } else { 0.0 },
            latest: f64::from(self.rate.load(Ordering::Relaxed)),
            periods: [percentile(0.5), percentile(0.99), percentile(0.999), max],
        }
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
            periods.record(now.saturating_duration_since(last));
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
    fn percentiles_are_right_within_a_bucket() {
        let periods = Periods::new();
        for us in 1..=1000 {
            periods.record(Duration::from_micros(us));
        }
        let rate = periods.read();
        for (found, expected) in rate.periods.into_iter().zip([500e-6, 990e-6, 999e-6, 1000e-6]) {
            assert!((found / expected - 1.0).abs() < 1.0 / 50.0, "{found} for {expected}");
        }
        assert!((rate.mean - 1e6 / 500.5).abs() < 1.0, "{}", rate.mean);
    }

    #[test]
    fn every_period_has_a_bucket_and_is_near_its_middle() {
        assert!(bucket(0) < BUCKETS && bucket(u64::MAX) < BUCKETS);
        for ns in [200u64, 12_345, 1_000_000, 7_654_321, 5_000_000_000] {
            let ratio = middle(bucket(ns)) / (ns as f64 * 1e-9);
            assert!((ratio - 1.0).abs() < 1.0 / 60.0, "{ns}: {ratio}");
        }
    }

    #[test]
    fn an_interruption_is_no_period() {
        let (periods, mut counter) = (Periods::new(), Counter::new());
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
