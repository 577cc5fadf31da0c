//! Kernels of dense vectors.

/// Whether all numbers are finite: 0 times a number is 0 if it is, and not a number otherwise.
#[inline]
pub(super) fn are_finite(values: &[f64]) -> bool {
    let mut sums = [0.0; 4];
    let mut chunks = values.chunks_exact(4);
    for chunk in chunks.by_ref() {
        for k in 0..4 {
            sums[k] += chunk[k] * 0.0;
        }
    }
    for value in chunks.remainder() {
        sums[0] += value * 0.0;
    }
    sums[0] + sums[1] + sums[2] + sums[3] == 0.0
}

/// Sum of products of two slices of the same length. Independent partial sums let additions overlap.
#[inline(always)]
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    let (a, b) = (&a[..n], &b[..n]);
    let mut sums = [0.0; 4];
    let (mut left, mut right) = (a.chunks_exact(4), b.chunks_exact(4));
    for (x, y) in left.by_ref().zip(right.by_ref()) {
        for k in 0..4 {
            sums[k] += x[k] * y[k];
        }
    }
    for (x, y) in left.remainder().iter().zip(right.remainder()) {
        sums[0] += x * y;
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

/// [`dot`] of each of the N rows that `columns` holds with one row, `other(c)` in column c, with the same bits: a sum of
/// its own for each of four consecutive columns.
#[inline(always)]
pub(super) fn dots<const N: usize>(columns: &[[f64; N]], other: impl Fn(usize) -> f64) -> [f64; N] {
    let mut sums = [[0.0; N]; 4];
    let (groups, rest) = columns.as_chunks::<4>();
    let mut add = |sum: usize, column: &[f64; N], c: usize| {
        let factor = other(c);
        for r in 0..N {
            sums[sum][r] += column[r] * factor;
        }
    };
    for (g, group) in groups.iter().enumerate() {
        for (k, column) in group.iter().enumerate() {
            add(k, column, 4 * g + k);
        }
    }
    for (k, column) in rest.iter().enumerate() {
        add(0, column, 4 * groups.len() + k);
    }
    std::array::from_fn(|r| (sums[0][r] + sums[1][r]) + (sums[2][r] + sums[3][r]))
}

/// Dot product of velocities, most of which belong to rigid bodies and have six components.
#[inline(always)]
pub(super) fn dot_velocity(a: &[f64], b: &[f64]) -> f64 {
    if let (Ok(a), Ok(b)) = (<&[f64; 6]>::try_from(a), <&[f64; 6]>::try_from(b)) {
        return (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3]) + (a[4] * b[4] + a[5] * b[5]);
    }
    dot(a, b)
}

/// `y += a x` of velocities.
#[inline(always)]
pub(super) fn add_velocity(y: &mut [f64], a: f64, x: &[f64]) {
    match (<&mut [f64; 6]>::try_from(&mut *y), <&[f64; 6]>::try_from(x)) {
        (Ok(y), Ok(x)) => add_scaled(y, a, x),
        _ => add_scaled(y, a, x),
    }
}

/// `y += a x`.
#[inline(always)]
pub(super) fn add_scaled(y: &mut [f64], a: f64, x: &[f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += a * x;
    }
}
