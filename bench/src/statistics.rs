//! Medians and spreads.

use std::fmt;

/// Median of some measurements with their 10th and 90th percentile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    pub low: f64,
    pub median: f64,
    pub high: f64,
}

impl Spread {
    /// `None` without measurements.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = values.into_iter().collect();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| percentile(&sorted, share);
        (!sorted.is_empty()).then(|| Self { low: at(0.1), median: at(0.5), high: at(0.9) })
    }
}

/// `median (low–high)` with the precision of the formatter, else three significant digits.
impl fmt::Display for Spread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = |value: f64| f.precision().map_or_else(|| short(value), |digits| format!("{value:.digits$}"));
        write!(f, "{} ({}–{})", text(self.median), text(self.low), text(self.high))
    }
}

/// The value below which `share` of the sorted ones lie, linearly interpolated.
pub fn percentile(sorted: &[f64], share: f64) -> f64 {
    let place = share * (sorted.len() - 1) as f64;
    let (below, above) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
    below + (above - below) * place.fract()
}

/// Three significant digits, never in exponent form.
pub fn short(value: f64) -> String {
    let digits = match value.abs() {
        a if a >= 100.0 || a == 0.0 => 0,
        a if a >= 10.0 => 1,
        a if a >= 1.0 => 2,
        _ => 3,
    };
    format!("{value:.digits$}")
}
