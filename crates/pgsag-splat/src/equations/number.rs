//! What the equations ask of a number: straight-line arithmetic, comparison into a mask, and `select`.
//!
//! [`Number`] can be implemented for SIMD lanes (a mask per lane); [`Scalar`] adds what the losses need of one value:
//! order, conversion, threads. Transcendentals come from `libm`, so that every machine gives the same bytes.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, BitAnd, Div, Mul, Neg, Sub, SubAssign};

/// Arithmetic without branches. Implementations: `f32`, `f64`.
pub trait Number:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
{
    /// Outcome of a comparison: one truth value per lane.
    type Truth: Copy + BitAnd<Output = Self::Truth>;

    /// The constant, rounded to this precision, in every lane.
    fn from_f64(value: f64) -> Self;
    /// Square root, correctly rounded.
    fn sqrt(self) -> Self;
    /// e to this power; the same bytes on every machine.
    fn exp(self) -> Self;
    /// Whether `self < other`.
    fn less(self, other: Self) -> Self::Truth;
    /// `yes` where `truth`, else `no`.
    fn select(truth: Self::Truth, yes: Self, no: Self) -> Self;

    /// 0.
    #[inline(always)]
    fn zero() -> Self {
        Self::from_f64(0.0)
    }
    /// 1.
    #[inline(always)]
    fn one() -> Self {
        Self::from_f64(1.0)
    }
    /// The smaller one.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self::select(other.less(self), other, self)
    }
    /// The larger one.
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self::select(self.less(other), other, self)
    }
    /// Distance from 0.
    #[inline(always)]
    fn abs(self) -> Self {
        Self::select(self.less(Self::zero()), -self, self)
    }
    /// Within `[low, high]`.
    #[inline(always)]
    fn clamp(self, low: Self, high: Self) -> Self {
        self.max(low).min(high)
    }
    /// 1, −1, or 0 at 0.
    #[inline(always)]
    fn sign(self) -> Self {
        let negative = Self::select(self.less(Self::zero()), -Self::one(), Self::zero());
        Self::select(Self::zero().less(self), Self::one(), negative)
    }
}

/// Neighbouring pixels as one number, so that the losses' kernels are written once: one pixel at a time in f64, a
/// vector's worth in f32.
pub trait Pixels<T>: Number {
    /// Pixels at a time; divides 16.
    const LEN: usize;

    /// The first `LEN` of a slice; 0 beyond its end.
    fn load(from: &[T]) -> Self;
    /// Stores as many as the slice has room for.
    fn store(self, to: &mut [T]);
    /// `f(0), f(1), …`
    fn each(f: impl FnMut(usize) -> T) -> Self;
    /// The first `LEN` of a slice as numbers; 0 beyond its end.
    fn from_bytes(bytes: &[u8]) -> Self;
    /// The first `LEN` of a slice in single precision; 0 beyond its end.
    fn from_singles(values: &[f32]) -> Self;
    /// `start`, `start + 1`, …
    fn count_from(start: usize) -> Self;
    /// `self * factor + term`; rounded once where the vector unit can.
    fn times_plus(self, factor: Self, term: Self) -> Self;
    /// For numbers from 0 to 2^31: the whole part, as numbers and as indices; anything where they are not.
    fn whole(self) -> (Self, [i32; 16]);
    /// Whether it is true of any pixel.
    fn any(truth: Self::Truth) -> bool;
    /// Sum over the pixels.
    fn total(self) -> f64;
}

/// Work on rows of pixels, for pixels of any width.
pub trait Kernel<T> {
    /// What the work yields.
    type Output;

    /// Does it. Implementations are `#[inline(always)]`, with all that they call: so they are compiled with the
    /// instructions of their vectors.
    fn run<P: Pixels<T>>(self) -> Self::Output;
}

/// One value, for code that may branch on it: losses and the reference.
pub trait Scalar: Number<Truth = bool> + PartialOrd + Default + Debug + Send + Sync + 'static {
    /// In double precision.
    fn to_f64(self) -> f64;
    /// In single precision (rounds).
    fn to_f32(self) -> f32;
    /// From single precision, exactly.
    fn from_f32(value: f32) -> Self;
    /// From a byte, exactly.
    fn from_u8(value: u8) -> Self;
    /// Runs a kernel on the widest pixels of this precision.
    fn widest<K: Kernel<Self>>(kernel: K) -> K::Output;
}

impl Number for f32 {
    type Truth = bool;

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value as Self
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    #[inline(always)]
    fn exp(self) -> Self {
        libm::expf(self)
    }
    #[inline(always)]
    fn less(self, other: Self) -> bool {
        self < other
    }
    #[inline(always)]
    fn select(truth: bool, yes: Self, no: Self) -> Self {
        if truth { yes } else { no }
    }
}

impl Number for f64 {
    type Truth = bool;

    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    #[inline(always)]
    fn exp(self) -> Self {
        libm::exp(self)
    }
    #[inline(always)]
    fn less(self, other: Self) -> bool {
        self < other
    }
    #[inline(always)]
    fn select(truth: bool, yes: Self, no: Self) -> Self {
        if truth { yes } else { no }
    }
}

impl Scalar for f32 {
    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn to_f32(self) -> f32 {
        self
    }
    #[inline(always)]
    fn from_f32(value: f32) -> Self {
        value
    }
    #[inline(always)]
    fn from_u8(value: u8) -> Self {
        Self::from(value)
    }
    #[inline(always)]
    fn widest<K: Kernel<Self>>(kernel: K) -> K::Output {
        crate::lanes::wide::widest(kernel)
    }
}

impl Scalar for f64 {
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }
    #[inline(always)]
    fn to_f32(self) -> f32 {
        self as f32
    }
    #[inline(always)]
    fn from_f32(value: f32) -> Self {
        Self::from(value)
    }
    #[inline(always)]
    fn from_u8(value: u8) -> Self {
        Self::from(value)
    }
    #[inline(always)]
    fn widest<K: Kernel<Self>>(kernel: K) -> K::Output {
        kernel.run::<Self>()
    }
}

impl Pixels<Self> for f64 {
    const LEN: usize = 1;

    #[inline(always)]
    fn load(from: &[Self]) -> Self {
        from.first().copied().unwrap_or(0.0)
    }
    #[inline(always)]
    fn store(self, to: &mut [Self]) {
        if let Some(to) = to.first_mut() {
            *to = self;
        }
    }
    #[inline(always)]
    fn each(mut f: impl FnMut(usize) -> Self) -> Self {
        f(0)
    }
    #[inline(always)]
    fn from_bytes(bytes: &[u8]) -> Self {
        bytes.first().map_or(0.0, |&byte| byte.into())
    }
    #[inline(always)]
    fn from_singles(values: &[f32]) -> Self {
        values.first().map_or(0.0, |&value| value.into())
    }
    #[inline(always)]
    fn count_from(start: usize) -> Self {
        start as Self
    }
    #[inline(always)]
    fn times_plus(self, factor: Self, term: Self) -> Self {
        self * factor + term
    }
    #[inline(always)]
    fn whole(self) -> (Self, [i32; 16]) {
        (Self::from(self as i32), [self as i32; 16])
    }
    #[inline(always)]
    fn any(truth: bool) -> bool {
        truth
    }
    #[inline(always)]
    fn total(self) -> f64 {
        self
    }
}
