//! Numbers of one world, or of several worlds side by side.

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// A number of one world, or one number of each of several worlds. Every operation is that of IEEE 754 on each of them, so that a
/// world has the same bits alone and beside others.
pub trait Scalar:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
{
    /// What fills a vector up to the size that it has in C++.
    type Pad: std::fmt::Debug + Copy + Default;

    /// The same number in all worlds.
    fn splat(value: f64) -> Self;
    /// `other` where it is larger, else this one.
    fn or_larger(self, other: Self) -> Self;
    /// `other` where it is smaller, else this one.
    fn or_smaller(self, other: Self) -> Self;
    /// `then` where this is above 0, else `otherwise`.
    fn if_positive(self, then: Self, otherwise: Self) -> Self;
    /// The square root.
    fn sqrt(self) -> Self;
    /// Sine and cosine of an angle, rad.
    fn sin_cos(self) -> (Self, Self);
}

impl Scalar for f64 {
    type Pad = f64;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn or_larger(self, other: Self) -> Self {
        if self < other {
            other
        } else {
            self
        }
    }

    #[inline(always)]
    fn or_smaller(self, other: Self) -> Self {
        if other < self {
            other
        } else {
            self
        }
    }

    #[inline(always)]
    fn if_positive(self, then: Self, otherwise: Self) -> Self {
        if self > 0.0 {
            then
        } else {
            otherwise
        }
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        f64::sin_cos(self)
    }
}
