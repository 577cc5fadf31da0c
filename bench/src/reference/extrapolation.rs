//! Gragg's extrapolated midpoint rule with Neville's scheme and adaptive steps (Hairer, Nørsett, Wanner: Solving
//! Ordinary Differential Equations I, II.9).

/// Rows of the scheme: 2, 4, … 16 midpoint steps, orders 2 to 16.
const ROWS: usize = 8;
/// A step that reached this row early may grow.
const EASY: usize = 5;

/// The slope of `y` at a time, written into the last argument.
pub type Slope<'a> = dyn FnMut(f64, &[f64], &mut [f64]) + 'a;

/// Integrates `y` from `from` to `to` s with local errors below `tolerance`·max(1, |y|). `settle` may correct the state
/// after each step, such as project it onto constraints.
///
/// # Panics
/// When the step becomes so small that it no longer matters: the problem is not smooth.
pub fn integrate(
    slope: &mut Slope,
    y: &mut [f64],
    from: f64,
    to: f64,
    tolerance: f64,
    settle: &mut dyn FnMut(&mut [f64]),
) {
    let (mut now, mut step) = (from, (to - from).min(0.01));
    while now < to {
        let last = now + step >= to;
        let h = if last { to - now } else { step };
        match attempt(slope, y, now, h, tolerance) {
            Some((next, row)) => {
                y.copy_from_slice(&next);
                settle(y);
                now = if last { to } else { now + h };
                if row <= EASY {
                    step = h.max(step) * 1.4;
                } else if row + 1 == ROWS {
                    step = h * 0.8;
                }
            }
            None => step = h / 2.0,
        }
        assert!(step > 1e-9, "no convergence at {now} s");
    }
}

/// One step; the new state and the row at which it was good enough.
fn attempt(slope: &mut Slope, y: &[f64], now: f64, h: f64, tolerance: f64) -> Option<(Vec<f64>, usize)> {
    let n = y.len();
    let mut first = vec![0.0; n];
    slope(now, y, &mut first);
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for row in 0..ROWS {
        let mut next = vec![midpoint(slope, y, &first, now, h, 2 * (row + 1))];
        for (column, before) in rows.iter().enumerate() {
            // rows[column] holds T(row − 1, column).
            let ratio = (row as f64 + 1.0) / (row - column) as f64;
            let weight = 1.0 / (ratio * ratio - 1.0);
            let better: Vec<f64> =
                next[column].iter().zip(before).map(|(new, old)| new + (new - old) * weight).collect();
            next.push(better);
        }
        if row > 1 {
            let (best, second) = (&next[row], &next[row - 1]);
            let error = |((a, b), y): ((&f64, &f64), &f64)| (a - b).abs() / y.abs().max(1.0);
            let worst =
                best.iter()
                    .zip(second)
                    .zip(y)
                    .map(error)
                    .fold(0.0, |worst: f64, e| if e > worst || e.is_nan() { e } else { worst });
            if worst <= tolerance {
                return Some((next.pop().expect("it has row + 1 entries"), row));
            }
        }
        rows = next;
    }
    None
}

/// `count` midpoint steps with Gragg's start.
fn midpoint(slope: &mut Slope, y: &[f64], first: &[f64], now: f64, h: f64, count: usize) -> Vec<f64> {
    let small = h / count as f64;
    let mut before = y.to_vec();
    let mut here: Vec<f64> = y.iter().zip(first).map(|(y, d)| y + small * d).collect();
    let mut d = vec![0.0; y.len()];
    for i in 1..count {
        slope(now + i as f64 * small, &here, &mut d);
        for ((old, new), d) in before.iter_mut().zip(&mut here).zip(&d) {
            (*old, *new) = (*new, *old + 2.0 * small * d);
        }
    }
    here
}
