//! Numbers of one world, or of several worlds side by side.

use std::f64::consts::{PI, TAU};
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use super::motion::Equations;
use super::{Forces, Position, Rate, Tree};

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
    /// Number of worlds.
    const WORLDS: usize;

    /// The same number in all worlds.
    fn splat(value: f64) -> Self;
    /// Of each world the number that `read` gives for it.
    fn of_worlds(read: impl Fn(usize) -> f64) -> Self;
    /// The number of a world.
    fn of(self, world: usize) -> f64;
    /// Adds to the number of a world.
    fn add_in(&mut self, world: usize, number: f64);
    /// `other` where it is larger, else this one.
    fn or_larger(self, other: Self) -> Self;
    /// `other` where it is smaller, else this one.
    fn or_smaller(self, other: Self) -> Self;
    /// `then` where this is above 0, else `otherwise`.
    fn if_positive(self, then: Self, otherwise: Self) -> Self;
    /// The number without its sign.
    fn abs(self) -> Self;
    /// The square root.
    fn sqrt(self) -> Self;
    /// Sine and cosine of an angle, rad.
    fn sin_cos(self) -> (Self, Self);
    /// An angle, rad, within [-pi, pi].
    fn wrapped(self) -> Self;
    /// `Equations::couple`; there is nothing to do for worlds side by side, which have no couplings.
    fn couple(equations: &mut Equations<'_, '_, Self>, rate: &mut Rate<'_, Self>);
    /// `Tree::find_accelerations`, as a function of its own.
    fn find_accelerations(
        tree: &mut Tree<'_, Self>,
        at: Option<&Position<'_, Self>>,
        rate: &Rate<'_, Self>,
        forces: Forces<'_, Self>,
        out: &mut Rate<'_, Self>,
    );
}

/// As [`Scalar::wrapped`]; what is within is not divided.
pub fn wrapped(angle: f64) -> f64 {
    if angle.abs() <= PI {
        angle
    } else {
        let rest = angle % TAU;
        if rest.abs() > PI {
            rest - TAU.copysign(rest)
        } else {
            rest
        }
    }
}

impl Scalar for f64 {
    type Pad = f64;
    const WORLDS: usize = 1;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn of_worlds(read: impl Fn(usize) -> f64) -> Self {
        read(0)
    }

    #[inline(always)]
    fn of(self, _: usize) -> f64 {
        self
    }

    #[inline(always)]
    fn add_in(&mut self, _: usize, number: f64) {
        *self += number;
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
    fn abs(self) -> Self {
        f64::abs(self)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        f64::sin_cos(self)
    }
    #[inline(always)]
    fn wrapped(self) -> Self {
        wrapped(self)
    }

    fn couple(equations: &mut Equations<'_, '_, Self>, rate: &mut Rate<'_, Self>) {
        equations.couple(rate);
    }

    #[inline(never)]
    fn find_accelerations(
        tree: &mut Tree<'_, Self>,
        at: Option<&Position<'_, Self>>,
        rate: &Rate<'_, Self>,
        forces: Forces<'_, Self>,
        out: &mut Rate<'_, Self>,
    ) {
        tree.find_accelerations(at, rate, forces, out);
    }
}
