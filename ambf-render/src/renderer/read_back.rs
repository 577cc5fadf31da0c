//! From what OpenGL gives back, bottom row first, to pictures, top row first.

use crate::view::Eye;

/// Pixels of `N` bytes, bottom row first, as values, top row first.
pub(super) fn top_first<const N: usize, T>(bytes: &[u8], width: usize, out: &mut [T], convert: impl Fn([u8; N]) -> T) {
    let (pixels, _) = bytes.as_chunks::<N>();
    assert_eq!(out.len(), pixels.len(), "size of a picture");
    for (from, to) in pixels.chunks_exact(width).rev().zip(out.chunks_exact_mut(width)) {
        for (from, to) in from.iter().zip(to) {
            *to = convert(*from);
        }
    }
}

/// Red, green and blue of RGBA pixels, bottom row first, top row first.
pub(super) fn rgb(bytes: &[u8], width: usize, out: &mut [u8]) {
    assert_eq!(out.len(), bytes.len() / 4 * 3, "size of a picture");
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
}

/// Depths of a depth buffer (native f32, bottom row first) in m along the axis, top row first.
pub(super) fn metric(bytes: &[u8], width: u32, eyes: &[Eye], out: &mut [f32]) {
    let (depths, _) = bytes.as_chunks::<4>();
    assert_eq!(out.len(), depths.len(), "size of a picture");
    let width = width as usize;
    for (row, to) in depths.chunks_exact(width).rev().zip(out.chunks_exact_mut(width)) {
        for eye in eyes {
            let columns = eye.left as usize..(eye.left + eye.width) as usize;
            let pixels = row[columns.clone()].iter().zip(&mut to[columns]);
            let p = &eye.projection;
            let (p22, p23, p32, p33) = (p[(2, 2)], p[(2, 3)], p[(3, 2)], p[(3, 3)]);
            if (p32, p33) == (-1.0, 0.0) {
                // p23 / (p22 + n) with n = 2 d - 1, which is exact: the sum loses nothing where p22 is given by two
                // floats.
                let (numerator, high) = (p23 as f32, p22 as f32);
                let low = (p22 - f64::from(high)) as f32;
                for (&depth, to) in pixels {
                    *to = numerator / (2.0 * f32::from_ne_bytes(depth) - 1.0 + high + low);
                }
            } else {
                for (&depth, to) in pixels {
                    let n = 2.0 * f64::from(f32::from_ne_bytes(depth)) - 1.0;
                    *to = ((p23 - n * p33) / (p22 - n * p32)) as f32;
                }
            }
        }
    }
}
