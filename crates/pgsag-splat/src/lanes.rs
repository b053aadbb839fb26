//! Vector levels, the few vector functions that kernels share, and vectors as the equations' numbers (`wide`).
//!
//! Kernels are written once, generic over `fearless_simd::Simd`, for vectors of the level's native width (16, 8 or 4
//! lanes), and entered through `at_level!`, which compiles them for every level that this file names.
//! Everything they call is `#[inline(always)]`, so that it is compiled with the level's instructions.

pub(crate) mod wide;

use fearless_simd::{Level, Simd, prelude::*};
use serde::{Deserialize, Serialize};

/// Edge of a tile, pixels.
pub(crate) const TILE: usize = 16;
/// Edge of a block, pixels; a block is what one 16-lane vector covers.
pub(crate) const BLOCK: usize = 4;
/// Pixels of a block.
pub(crate) const LANES: usize = BLOCK * BLOCK;
/// Blocks of a tile.
pub(crate) const BLOCKS: usize = (TILE / BLOCK) * (TILE / BLOCK);

/// One value per pixel of a block, or per Gaussian of a group of 16: a cache line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(64))]
pub(crate) struct Line(pub(crate) [f32; LANES]);

impl Line {
    /// All zero.
    pub(crate) const ZERO: Self = Self([0.0; LANES]);

    /// The vector that starts at lane `at`.
    #[inline(always)]
    pub(crate) fn load<S: Simd>(&self, simd: S, at: usize) -> S::f32s {
        S::f32s::from_slice(simd, &self.0[at..at + S::f32s::LEN])
    }

    /// Stores a vector at lane `at`.
    #[inline(always)]
    pub(crate) fn store<S: Simd>(&mut self, _simd: S, at: usize, vector: S::f32s) {
        vector.store_slice(&mut self.0[at..at + S::f32s::LEN]);
    }
}

/// Which vector instructions to use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SimdLevel {
    /// The best that this machine has.
    #[default]
    Auto,
    /// 16 lanes (x86-64, Ice Lake and Zen 4 or newer).
    Avx512,
    /// 8 lanes with fused multiply-add (x86-64-v3).
    Avx2,
    /// 4 lanes (aarch64).
    Neon,
    /// No vector instructions beyond those that the compiler finds; everywhere.
    Scalar,
}

impl SimdLevel {
    const BEST_FIRST: [Self; 4] = [Self::Avx512, Self::Avx2, Self::Neon, Self::Scalar];

    /// The levels that this machine can run, best first; never `Auto`, always `Scalar` at the end.
    #[must_use]
    pub fn available() -> Vec<Self> {
        Self::BEST_FIRST.into_iter().filter(|level| level.detected().is_some()).collect()
    }

    /// The proof that the machine has this level; `None` where it has not.
    pub(crate) fn detected(self) -> Option<Level> {
        #[cfg(target_arch = "x86_64")]
        let best = Level::new();
        match self {
            Self::Auto => Self::BEST_FIRST.into_iter().find_map(Self::detected),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => best.as_avx512().map(|token| token.level()),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => best.as_avx2().map(|token| token.level()),
            #[cfg(target_arch = "aarch64")]
            Self::Neon => Level::new().as_neon().map(|token| token.level()),
            Self::Scalar => Some(Level::fallback()),
            #[allow(unreachable_patterns, reason = "which levels remain depends on the target")]
            _ => None,
        }
    }
}

/// Runs an expression with `$simd` bound to the token of `$level`, compiled with that level's instructions.
macro_rules! at_level {
    ($level:expr, $simd:ident => $run:expr) => {
        match $level {
            #[cfg(target_arch = "x86_64")]
            fearless_simd::Level::Avx512($simd) => fearless_simd::Simd::vectorize(
                $simd,
                #[inline(always)]
                || $run,
            ),
            #[cfg(target_arch = "x86_64")]
            fearless_simd::Level::Avx2($simd) => fearless_simd::Simd::vectorize(
                $simd,
                #[inline(always)]
                || $run,
            ),
            #[cfg(target_arch = "aarch64")]
            fearless_simd::Level::Neon($simd) => fearless_simd::Simd::vectorize(
                $simd,
                #[inline(always)]
                || $run,
            ),
            fearless_simd::Level::Fallback($simd) => fearless_simd::Simd::vectorize(
                $simd,
                #[inline(always)]
                || $run,
            ),
            _ => unreachable!("SimdLevel::detected names only the levels above"),
        }
    };
}
pub(crate) use at_level;

/// 2 to the power of `x`, for `x` in [-126, 126]; anything outside. Relative error 2e-7 (degree 5 on [-1/2, 1/2]).
/// Own polynomial, so that every machine computes the same.
#[inline(always)]
#[expect(clippy::approx_constant, reason = "the coefficient of the best polynomial is near ln 2, and is not ln 2")]
pub(crate) fn exp2<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    exp2_by(simd, x, [1.327_647_2e-3, 9.675_541e-3, 5.550_713e-2, 2.402_212e-1, 6.931_47e-1, 1.000_000_1])
}

/// The same with a relative error of 3e-6 (degree 4): for what is blended.
#[inline(always)]
pub(crate) fn exp2_near<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    exp2_by(simd, x, [9.567_739e-3, 5.591_75e-2, 2.402_481e-1, 6.931_219e-1, 9.999_992e-1])
}

/// 2 to the power of `x` by a polynomial, highest coefficient first.
#[inline(always)]
fn exp2_by<S: Simd, const N: usize>(simd: S, x: S::f32s, polynomial: [f32; N]) -> S::f32s {
    /// 1.5 · 2^23: adding it leaves the nearest integer in the low bits of the significand.
    const ROUND: f32 = 12_582_912.0;
    let shifted = x + ROUND;
    let fraction = x - (shifted - ROUND);
    let mut value = S::f32s::splat(simd, polynomial[0]);
    for coefficient in &polynomial[1..] {
        value = value.mul_add(fraction, S::f32s::splat(simd, *coefficient));
    }
    let exponent = shifted.bitcast::<S::u32s>() << 23;
    (value.bitcast::<S::u32s>() + exponent).bitcast::<S::f32s>()
}

/// Sums of the lanes of 16 vectors: `out[i]` is the sum of `vectors[i]`, by one shuffle-add tree.
#[inline(always)]
pub(crate) fn sums<S: Simd>(simd: S, vectors: [S::f32s; 16], out: &mut Line) {
    let mut quads = [vectors[0]; 4];
    for (i, quad) in quads.iter_mut().enumerate() {
        let (a, b) = (fold::<S>(vectors[4 * i], vectors[4 * i + 1]), fold::<S>(vectors[4 * i + 2], vectors[4 * i + 3]));
        *quad = fold::<S>(a, b);
    }
    if S::f32s::LEN == 4 {
        for (i, quad) in quads.into_iter().enumerate() {
            out.store(simd, 4 * i, quad);
        }
        return;
    }
    let (low, high) = (fold::<S>(quads[0], quads[1]), fold::<S>(quads[2], quads[3]));
    if S::f32s::LEN == 8 {
        out.store(simd, 0, low);
        out.store(simd, 8, high);
    } else {
        out.store(simd, 0, fold::<S>(low, high));
    }
}

/// Sums of neighbouring lanes: those of `a`, then those of `b`.
#[inline(always)]
fn fold<S: Simd>(a: S::f32s, b: S::f32s) -> S::f32s {
    a.unzip_low(b) + a.unzip_high(b)
}

/// Columns of the pixel centres of every block of a tile, relative to the tile's corner.
pub(crate) static CENTER_X: [Line; BLOCKS] = centers(true);
/// See [`CENTER_X`].
pub(crate) static CENTER_Y: [Line; BLOCKS] = centers(false);

const fn centers(columns: bool) -> [Line; BLOCKS] {
    let mut lines = [Line::ZERO; BLOCKS];
    let mut block = 0;
    while block < BLOCKS {
        let mut lane = 0;
        while lane < LANES {
            let (x, y) = (block % (TILE / BLOCK) * BLOCK + lane % BLOCK, block / (TILE / BLOCK) * BLOCK + lane / BLOCK);
            lines[block].0[lane] = (if columns { x } else { y }) as f32 + 0.5;
            lane += 1;
        }
        block += 1;
    }
    lines
}

#[cfg(test)]
mod tests;
