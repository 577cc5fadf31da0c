//! From what OpenGL gives back, bottom row first, to pictures, top row first.

use crate::view::Eye;

/// Pixels of `N` bytes, bottom row first, as `M` values each, top row first.
pub(super) fn top_first<const N: usize, const M: usize, T: Copy + Default>(
    bytes: &[u8],
    width: usize,
    convert: impl Fn([u8; N]) -> [T; M],
) -> Vec<T> {
    let (pixels, _) = bytes.as_chunks::<N>();
    let mut out = vec![T::default(); pixels.len() * M];
    let (places, _) = out.as_chunks_mut::<M>();
    for (from, to) in pixels.chunks_exact(width).rev().zip(places.chunks_exact_mut(width)) {
        for (from, to) in from.iter().zip(to) {
            *to = convert(*from);
        }
    }
    out
}

/// Red, green and blue of RGBA pixels, bottom row first, top row first.
pub(super) fn rgb(bytes: &[u8], width: usize) -> Vec<u8> {
    let mut out = vec![0; bytes.len() / 4 * 3];
    for (row, to) in bytes.chunks_exact(4 * width).rev().zip(out.chunks_exact_mut(3 * width)) {
        // Four pixels at once, as three words.
        let (fours, rest) = row.as_chunks::<16>();
        let (twelves, last) = to.as_chunks_mut::<12>();
        for (four, twelve) in fours.iter().zip(twelves) {
            let (pixels, _) = four.as_chunks::<4>();
            let [a, b, c, d] = std::array::from_fn(|i| u32::from_le_bytes(pixels[i]));
            let words = [a & 0xff_ffff | b << 24, b >> 8 & 0xffff | c << 16, c >> 16 & 0xff | d << 8];
            for (to, word) in twelve.as_chunks_mut::<4>().0.iter_mut().zip(words) {
                *to = word.to_le_bytes();
            }
        }
        for (pixel, to) in rest.chunks_exact(4).zip(last.chunks_exact_mut(3)) {
            to.copy_from_slice(&pixel[..3]);
        }
    }
    out
}

/// Depths of a depth buffer (native f32, bottom row first) in m along the axis, top row first.
pub(super) fn metric(bytes: &[u8], width: u32, eyes: &[Eye]) -> Vec<f32> {
    let (depths, _) = bytes.as_chunks::<4>();
    let mut out = Vec::with_capacity(depths.len());
    for row in depths.chunks_exact(width as usize).rev() {
        for eye in eyes {
            let pixels = row[eye.left as usize..(eye.left + eye.width) as usize].iter();
            let p = &eye.projection;
            let (p22, p23, p32, p33) = (p[(2, 2)], p[(2, 3)], p[(3, 2)], p[(3, 3)]);
            if (p32, p33) == (-1.0, 0.0) {
                // p23 / (p22 + n) with n = 2 d - 1, which is exact: the sum loses nothing where p22 is given by two
                // floats.
                let (numerator, high) = (p23 as f32, p22 as f32);
                let low = (p22 - f64::from(high)) as f32;
                out.extend(pixels.map(|&depth| numerator / (2.0 * f32::from_ne_bytes(depth) - 1.0 + high + low)));
            } else {
                out.extend(pixels.map(|&depth| {
                    let n = 2.0 * f64::from(f32::from_ne_bytes(depth)) - 1.0;
                    ((p23 - n * p33) / (p22 - n * p32)) as f32
                }));
            }
        }
    }
    out
}
