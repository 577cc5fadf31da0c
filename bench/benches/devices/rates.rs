//! Periods of loops, and their table cells.

use std::time::{Duration, Instant};

use super::statistics::percentile;

/// Periods between events in a stretch of time.
#[derive(Debug, Clone)]
pub struct Periods {
    /// ms.
    sorted: Vec<f64>,
    /// Events a second.
    pub rate: f64,
}

impl Periods {
    /// Of the events in `from..to`; none are infinitely long.
    pub fn of(events: impl IntoIterator<Item = Instant>, from: Instant, to: Instant) -> Self {
        let inside: Vec<Instant> = events.into_iter().filter(|at| (from..to).contains(at)).collect();
        let mut sorted: Vec<f64> = inside.windows(2).map(|pair| (pair[1] - pair[0]).as_secs_f64() * 1e3).collect();
        sorted.sort_by(f64::total_cmp);
        let span = (to - from).as_secs_f64();
        if sorted.is_empty() {
            sorted.push(span * 1e3);
        }
        Self { sorted, rate: inside.len() as f64 / span }
    }

    pub fn percentile(&self, share: f64) -> f64 {
        percentile(&self.sorted, share)
    }

    pub fn max(&self) -> f64 {
        self.percentile(1.0)
    }

    /// Share of the periods shorter than `ms`, %.
    pub fn below(&self, ms: f64) -> f64 {
        100.0 * self.sorted.partition_point(|period| *period < ms) as f64 / self.sorted.len() as f64
    }
}

/// Events a second, in each slice of `width`; (s after `from`, Hz).
pub fn over_time(
    events: impl IntoIterator<Item = Instant>,
    from: Instant,
    to: Instant,
    width: Duration,
) -> Vec<(f64, f64)> {
    let slices = ((to - from).as_secs_f64() / width.as_secs_f64()) as usize;
    let mut counts = vec![0.0; slices];
    for at in events.into_iter().filter(|at| (from..to).contains(at)) {
        let slice = ((at - from).as_secs_f64() / width.as_secs_f64()) as usize;
        if let Some(count) = counts.get_mut(slice) {
            *count += 1.0;
        }
    }
    let width = width.as_secs_f64();
    counts.iter().enumerate().map(|(i, count)| ((i as f64 + 0.5) * width, count / width)).collect()
}
