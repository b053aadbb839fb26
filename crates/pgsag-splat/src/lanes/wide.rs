//! The equations' [`Number`] in vector lanes, so that the same source projects 16, 8 or 4 Gaussians at a time.
//!
//! `Number` makes constants out of nothing, but a vector needs its level's token. The token is carried per thread:
//! [`Carried::carry`] is called once where vector code is entered, and costs nothing after that, because the compiler
//! sees the same thread-local read over and over.

use std::cell::Cell;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use fearless_simd::{Simd, prelude::*};

use super::{LANES, Line, SimdLevel, at_level, exp2};
use crate::equations::Number;
use crate::equations::number::{Kernel, Pixels};

/// A level whose token can be found again on this thread.
pub(crate) trait Carried: Simd {
    /// Makes the token known on this thread.
    fn carry(self);
    /// The token.
    fn carried() -> Self;
}

macro_rules! carried {
    ($level:ty) => {
        const _: () = {
            thread_local! {
                static TOKEN: Cell<Option<$level>> = const { Cell::new(None) };
            }
            impl Carried for $level {
                #[inline(always)]
                fn carry(self) {
                    TOKEN.set(Some(self));
                }
                #[inline(always)]
                fn carried() -> Self {
                    TOKEN.get().expect("vector code is entered through `carry`")
                }
            }
        };
    };
}
#[cfg(target_arch = "x86_64")]
carried!(fearless_simd::x86::Avx512);
#[cfg(target_arch = "x86_64")]
carried!(fearless_simd::x86::Avx2);
#[cfg(target_arch = "aarch64")]
carried!(fearless_simd::aarch64::Neon);
carried!(fearless_simd::Fallback);

/// A native vector as a number.
#[derive(Clone, Copy)]
pub(crate) struct Wide<S: Simd>(pub(crate) S::f32s);

impl<S: Carried> Wide<S> {
    /// Lanes.
    pub(crate) const LEN: usize = S::f32s::LEN;

    /// The lanes of a line from `at` on.
    #[inline(always)]
    pub(crate) fn load(line: &Line, at: usize) -> Self {
        Self(line.load(S::carried(), at))
    }

    /// Stores the lanes at `at`.
    #[inline(always)]
    pub(crate) fn store(self, line: &mut Line, at: usize) {
        line.store(S::carried(), at, self.0);
    }

    /// The next integer below or at each lane.
    #[inline(always)]
    pub(crate) fn floor(self) -> Self {
        Self(self.0.floor())
    }

    /// The next integer above or at each lane.
    #[inline(always)]
    pub(crate) fn ceil(self) -> Self {
        Self(self.0.ceil())
    }

    /// The least lane.
    #[inline(always)]
    pub(crate) fn least(self) -> f32 {
        self.0.reduce_min()
    }

    /// The greatest lane.
    #[inline(always)]
    pub(crate) fn greatest(self) -> f32 {
        self.0.reduce_max()
    }

    /// log2, for normal positive numbers; absolute error 1e-7 near 1.
    /// Significand in [√½, √2), then the series of the area hyperbolic tangent.
    #[inline(always)]
    pub(crate) fn log2(self) -> Self {
        /// Bits of √½.
        const ROOT_HALF: u32 = 0x3f35_04f3;
        let simd = S::carried();
        let bits = self.0.bitcast::<S::u32s>();
        let shifted = bits - S::u32s::splat(simd, ROOT_HALF);
        let exponent = (shifted.bitcast::<S::i32s>() >> 23).to_float::<S::f32s>();
        let mantissa =
            ((shifted & S::u32s::splat(simd, 0x007f_ffff)) + S::u32s::splat(simd, ROOT_HALF)).bitcast::<S::f32s>();
        let ratio = (mantissa - 1.0) / (mantissa + 1.0);
        let square = ratio * ratio;
        let mut series = S::f32s::splat(simd, 2.0 / 9.0);
        for divisor in [7.0, 5.0, 3.0, 1.0] {
            series = series.mul_add(square, S::f32s::splat(simd, 2.0 / divisor));
        }
        Self((series * ratio).mul_add(S::f32s::splat(simd, std::f32::consts::LOG2_E), exponent))
    }
}

/// 0, 1, ….
static COUNT: [f32; LANES] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0];

impl<S: Carried> Pixels<f32> for Wide<S> {
    const LEN: usize = S::f32s::LEN;

    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        match from.get(..S::f32s::LEN) {
            Some(whole) => Self(S::f32s::from_slice(S::carried(), whole)),
            None => Self::load_short(from),
        }
    }
    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        match to.get_mut(..S::f32s::LEN) {
            Some(whole) => self.0.store_slice(whole),
            None => self.store_short(to),
        }
    }
    #[inline(always)]
    fn each(mut f: impl FnMut(usize) -> f32) -> Self {
        let mut line = [0.0; LANES];
        for (lane, value) in line.iter_mut().enumerate().take(S::f32s::LEN) {
            *value = f(lane);
        }
        Self(S::f32s::from_slice(S::carried(), &line[..S::f32s::LEN]))
    }
    #[inline(always)]
    fn from_bytes(bytes: &[u8]) -> Self {
        let mut short = [0; LANES];
        let bytes = match bytes.first_chunk::<LANES>() {
            Some(bytes) => bytes,
            None => {
                short[..bytes.len()].copy_from_slice(bytes);
                &short
            }
        };
        let mut line = [0.0; LANES];
        for lane in 0..LANES {
            line[lane] = f32::from(bytes[lane]);
        }
        Self(S::f32s::from_slice(S::carried(), &line[..S::f32s::LEN]))
    }
    #[inline(always)]
    fn from_singles(values: &[f32]) -> Self {
        Pixels::load(values)
    }
    #[inline(always)]
    fn count_from(start: usize) -> Self {
        Self(S::f32s::from_slice(S::carried(), &COUNT[..S::f32s::LEN]) + start as f32)
    }
    #[inline(always)]
    fn times_plus(self, factor: Self, term: Self) -> Self {
        Self(self.0.mul_add(factor.0, term.0))
    }
    #[inline(always)]
    fn whole(self) -> (Self, [i32; LANES]) {
        let whole = self.0.to_int::<S::i32s>();
        let mut indices = [0; LANES];
        whole.store_slice(&mut indices[..S::f32s::LEN]);
        (Self(whole.to_float()), indices)
    }
    #[inline(always)]
    fn any(truth: S::mask32s) -> bool {
        truth.any_true()
    }
    #[inline(always)]
    fn total(self) -> f64 {
        let mut line = [0.0; LANES];
        self.0.store_slice(&mut line[..S::f32s::LEN]);
        line.iter().map(|&value| f64::from(value)).sum()
    }
}

impl<S: Carried> Wide<S> {
    #[cold]
    fn load_short(from: &[f32]) -> Self {
        let mut line = [0.0; LANES];
        line[..from.len()].copy_from_slice(from);
        Self(S::f32s::from_slice(S::carried(), &line[..S::f32s::LEN]))
    }

    #[cold]
    fn store_short(self, to: &mut [f32]) {
        let mut line = [0.0; LANES];
        self.0.store_slice(&mut line[..S::f32s::LEN]);
        to.copy_from_slice(&line[..to.len()]);
    }
}

/// Runs a kernel on the widest vectors of this machine.
pub(crate) fn widest<K: Kernel<f32>>(kernel: K) -> K::Output {
    let level = SimdLevel::Auto.detected().expect("the scalar level is everywhere");
    at_level!(level, simd => run_carried(simd, kernel))
}

#[inline(always)]
fn run_carried<S: Carried, K: Kernel<f32>>(simd: S, kernel: K) -> K::Output {
    simd.carry();
    kernel.run::<Wide<S>>()
}

impl<S: Carried> Number for Wide<S> {
    type Truth = S::mask32s;

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        Self(S::f32s::splat(S::carried(), value as f32))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.sqrt())
    }
    /// e^x = 2^n · 2^f with n the nearest integer to x log2 e; ln 2 is taken off in two parts, so that f keeps its bits.
    #[inline(always)]
    fn exp(self) -> Self {
        const LN2_HIGH: f32 = 0.693_359_4;
        const LN2_LOW: f32 = -2.121_944_4e-4;
        let simd = S::carried();
        let splat = |value: f32| S::f32s::splat(simd, value);
        let x = self.0.max(-87.0).min(87.0);
        let n = (x * std::f32::consts::LOG2_E).round_ties_even();
        let rest = n.mul_add(splat(-LN2_LOW), n.mul_add(splat(-LN2_HIGH), x));
        let fraction = exp2(simd, rest * std::f32::consts::LOG2_E);
        Self(fraction * exp2(simd, n))
    }
    #[inline(always)]
    fn less(self, other: Self) -> Self::Truth {
        self.0.simd_lt(other.0)
    }
    #[inline(always)]
    fn select(truth: Self::Truth, yes: Self, no: Self) -> Self {
        Self(truth.select(yes.0, no.0))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(self.0.min(other.0))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(self.0.max(other.0))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        Self(self.0.abs())
    }
}

macro_rules! operator {
    ($trait:ident, $method:ident, $assign:ident, $assign_method:ident) => {
        impl<S: Carried> $trait for Wide<S> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(self.0.$method(other.0))
            }
        }
        operator!(@ $trait, $method, $assign, $assign_method);
    };
    (@ Div, $method:ident, $assign:ident, $assign_method:ident) => {};
    (@ Mul, $method:ident, $assign:ident, $assign_method:ident) => {};
    (@ $trait:ident, $method:ident, $assign:ident, $assign_method:ident) => {
        impl<S: Carried> $assign for Wide<S> {
            #[inline(always)]
            fn $assign_method(&mut self, other: Self) {
                self.0 = self.0.$method(other.0);
            }
        }
    };
}
operator!(Add, add, AddAssign, add_assign);
operator!(Sub, sub, SubAssign, sub_assign);
operator!(Mul, mul, MulAssign, mul_assign);
operator!(Div, div, DivAssign, div_assign);

impl<S: Carried> Neg for Wide<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[inline(always)]
    fn exp_and_log<S: Carried>(simd: S, x: f32) -> (f32, f32) {
        simd.carry();
        let mut out = [Line::ZERO; 2];
        let line = Line([x; LANES]);
        Wide::<S>::load(&line, 0).exp().store(&mut out[0], 0);
        Wide::<S>::load(&line, 0).exp().log2().store(&mut out[1], 0);
        (out[0].0[0], out[1].0[0])
    }

    #[test]
    fn exp_and_log2_are_accurate_at_every_level() {
        for level in SimdLevel::available() {
            let level = level.detected().expect("available levels are detected");
            for step in 0..4000 {
                let x = -20.0 + 0.01 * step as f32;
                let (exp, log) = at_level!(level, simd => exp_and_log(simd, x));
                let exact = libm::exp(f64::from(x));
                assert!((f64::from(exp) / exact - 1.0).abs() < 5e-7, "exp({x}) = {exp}");
                let exact = f64::from(x) * std::f64::consts::LOG2_E;
                assert!((f64::from(log) - exact).abs() < 2e-6 * (1.0 + exact.abs()), "log2 e^{x} = {log}");
            }
        }
    }
}
