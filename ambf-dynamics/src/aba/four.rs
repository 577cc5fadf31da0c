//! Numbers of four worlds in a register of AVX.
//!
//! Its functions are to be inlined into functions that are compiled for AVX2, which are called where the processor has it. Closures are
//! not: arithmetic in them would stay a call of a function for each operation.

use core::arch::x86_64::{
    __m256d, _mm256_add_pd, _mm256_andnot_pd, _mm256_blendv_pd, _mm256_cmp_pd, _mm256_div_pd, _mm256_max_pd,
    _mm256_min_pd, _mm256_mul_pd, _mm256_permute2f128_pd, _mm256_set1_pd, _mm256_set_pd, _mm256_setzero_pd,
    _mm256_sqrt_pd, _mm256_sub_pd, _mm256_unpackhi_pd, _mm256_unpacklo_pd, _mm256_xor_pd, _CMP_GT_OQ,
};
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use super::motion::Equations;
use super::scalar::{wrapped, Scalar};
use super::{Forces, Position, Rate, Tree};

/// One number of each of four worlds. Only functions that are called where the processor has AVX2 may make one.
#[derive(Debug, Clone, Copy)]
#[repr(transparent)]
pub struct Four(__m256d);

impl Four {
    /// Of these worlds in turn.
    #[inline(always)]
    pub fn new(numbers: [f64; 4]) -> Self {
        // SAFETY: the processor has AVX, by the contract of the type.
        Self(unsafe { _mm256_set_pd(numbers[3], numbers[2], numbers[1], numbers[0]) })
    }

    /// Rows of four numbers become columns.
    #[inline(always)]
    pub fn transposed([a, b, c, d]: [Self; 4]) -> [Self; 4] {
        // SAFETY: the processor has AVX, by the contract of the type.
        unsafe {
            let (first, second) = (_mm256_unpacklo_pd(a.0, b.0), _mm256_unpackhi_pd(a.0, b.0));
            let (third, fourth) = (_mm256_unpacklo_pd(c.0, d.0), _mm256_unpackhi_pd(c.0, d.0));
            [
                Self(_mm256_permute2f128_pd::<0x20>(first, third)),
                Self(_mm256_permute2f128_pd::<0x20>(second, fourth)),
                Self(_mm256_permute2f128_pd::<0x31>(first, third)),
                Self(_mm256_permute2f128_pd::<0x31>(second, fourth)),
            ]
        }
    }

    /// The numbers of the worlds in turn.
    #[inline(always)]
    pub fn numbers(self) -> [f64; 4] {
        // SAFETY: the register holds four numbers, in this order in memory.
        unsafe { std::mem::transmute(self.0) }
    }
}

macro_rules! operation {
    ($operation:ident, $name:ident, $instruction:ident) => {
        impl $operation for Four {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                // SAFETY: the processor has AVX, by the contract of the type.
                Self(unsafe { $instruction(self.0, other.0) })
            }
        }
    };
}

operation!(Add, add, _mm256_add_pd);
operation!(Sub, sub, _mm256_sub_pd);
operation!(Mul, mul, _mm256_mul_pd);
operation!(Div, div, _mm256_div_pd);

impl Neg for Four {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        // SAFETY: the processor has AVX, by the contract of the type.
        Self(unsafe { _mm256_xor_pd(self.0, _mm256_set1_pd(-0.0)) })
    }
}

impl AddAssign for Four {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl SubAssign for Four {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

impl Scalar for Four {
    type Pad = ();
    const WORLDS: usize = 4;

    #[inline(always)]
    fn of_worlds(read: impl Fn(usize) -> f64) -> Self {
        Self::new([read(0), read(1), read(2), read(3)])
    }

    #[inline(always)]
    fn of(self, world: usize) -> f64 {
        self.numbers()[world]
    }

    #[inline(always)]
    fn add_in(&mut self, world: usize, number: f64) {
        let mut numbers = self.numbers();
        numbers[world] += number;
        *self = Self::new(numbers);
    }

    #[inline(always)]
    fn splat(value: f64) -> Self {
        // SAFETY: the processor has AVX, by the contract of the type.
        Self(unsafe { _mm256_set1_pd(value) })
    }

    // Where one of both is no number, these instructions give the second.
    #[inline(always)]
    fn or_larger(self, other: Self) -> Self {
        // SAFETY: the processor has AVX, by the contract of the type.
        Self(unsafe { _mm256_max_pd(other.0, self.0) })
    }

    #[inline(always)]
    fn or_smaller(self, other: Self) -> Self {
        // SAFETY: the processor has AVX, by the contract of the type.
        Self(unsafe { _mm256_min_pd(other.0, self.0) })
    }

    #[inline(always)]
    fn if_positive(self, then: Self, otherwise: Self) -> Self {
        // SAFETY: the processor has AVX, by the contract of the type.
        Self(unsafe { _mm256_blendv_pd(otherwise.0, then.0, _mm256_cmp_pd::<_CMP_GT_OQ>(self.0, _mm256_setzero_pd())) })
    }

    #[inline(always)]
    fn abs(self) -> Self {
        // SAFETY: the processor has AVX, by the contract of the type.
        Self(unsafe { _mm256_andnot_pd(_mm256_set1_pd(-0.0), self.0) })
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: the processor has AVX, by the contract of the type.
        Self(unsafe { _mm256_sqrt_pd(self.0) })
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let [a, b, c, d] = self.numbers();
        let (a, b, c, d) = (a.sin_cos(), b.sin_cos(), c.sin_cos(), d.sin_cos());
        (Self::new([a.0, b.0, c.0, d.0]), Self::new([a.1, b.1, c.1, d.1]))
    }
    #[inline(always)]
    fn wrapped(self) -> Self {
        let [a, b, c, d] = self.numbers();
        Self::new([wrapped(a), wrapped(b), wrapped(c), wrapped(d)])
    }

    fn couple(_: &mut Equations<'_, '_, Self>, _: &mut Rate<'_, Self>) {}

    #[inline(always)]
    fn find_accelerations(
        tree: &mut Tree<'_, Self>,
        at: Option<&Position<'_, Self>>,
        rate: &Rate<'_, Self>,
        forces: Forces<'_, Self>,
        out: &mut Rate<'_, Self>,
    ) {
        // SAFETY: the processor has AVX2, by the contract of the type.
        unsafe { find_accelerations(tree, at, rate, forces, out) }
    }
}

#[target_feature(enable = "avx2")]
fn find_accelerations(
    tree: &mut Tree<'_, Four>,
    at: Option<&Position<'_, Four>>,
    rate: &Rate<'_, Four>,
    forces: Forces<'_, Four>,
    out: &mut Rate<'_, Four>,
) {
    tree.find_accelerations(at, rate, forces, out);
}
