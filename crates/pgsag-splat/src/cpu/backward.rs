//! Gradient of the blending of one tile, front to back.
//!
//! Because opacity sums are rendered too, all upstream gradients of a pixel act through one number per Gaussian,
//! d = Σ_k ĝ_k c_k; and what lies behind a Gaussian acts through another, the rest of Σ_j w_j d_j. So the walk needs
//! no channel-wise "behind", no division to recover transmittance, and the same order as the forward pass.
//! Gaussians are the outer loop: the sums of one Gaussian over the tile stay in registers, are folded by one tree and
//! stored as one record of the pair.
//!
//! ```text
//! ĝc_k = w ĝ_k,   ĝα = T d − rest / (1 − α),   v = α ĝα   (0 where alpha is held at its maximum)
//! ```

use fearless_simd::{Simd, prelude::*};

use super::{
    bins::place::{FEATURES, X, XX, XY, Y, YY},
    forward::{ALPHA_MAX, Tile, drawn_light, exponent_at},
    lanes::{BLOCKS, CENTER_X, CENTER_Y, LANES, Line, exp2, exp2_near, sums},
};
use crate::equations::algebra::each;
use crate::equations::blend::{LOAD_CENTER, LOAD_STEEPNESS};

/// Sums of one pair over the pixels of its tile; `(dx, dy)` from the Gaussian's centre.
pub(crate) mod sum {
    /// Σ v
    pub(crate) const V: usize = 0;
    /// Σ v dx
    pub(crate) const VX: usize = 1;
    /// Σ v dy
    pub(crate) const VY: usize = 2;
    /// Σ v dx²
    pub(crate) const VXX: usize = 3;
    /// Σ v dx dy
    pub(crate) const VXY: usize = 4;
    /// Σ v dy²
    pub(crate) const VYY: usize = 5;
    /// Σ w ĝ_k
    pub(crate) const FEATURES: usize = 6;
    /// Σ |∂/∂u| per pixel, in the record's units.
    pub(crate) const ABSOLUTE_U: usize = 13;
    /// Σ |∂/∂v| per pixel, in the record's units.
    pub(crate) const ABSOLUTE_V: usize = 14;
    /// Pixels covered.
    pub(crate) const COVERED: usize = 15;
}

/// Planes of upstream gradients before those of the features: Σ_k ĝ_k C_k, and the gradient of the opacity sum.
pub(crate) const LEADING_PLANES: usize = 2;

/// Upstream gradients of one tile.
#[derive(Clone, Copy)]
pub(crate) struct Upstream<'a> {
    /// `[BLOCKS * (LEADING_PLANES + F)]`: rest, opacity sum, features.
    pub(crate) planes: &'a [Line],
    /// `[BLOCKS]` gradient of the load; read with `LOAD` alone.
    pub(crate) load: Option<&'a [Line; BLOCKS]>,
    /// `[pairs]` from the forward pass.
    pub(crate) blocks: &'a [u16],
}

/// Records that are fetched at a time: they lie anywhere, and together their latencies overlap.
const BATCH: usize = 64;

/// What the walk keeps per block: transmittance and the rest.
struct State {
    light: [Line; BLOCKS],
    rest: [Line; BLOCKS],
}

/// Writes the sums of every pair that covers a pixel to `out` (of the tile, by place); leaves the others alone.
/// `F` features from `FIRST` on, `P` = F + 2 planes. `LOAD` adds the surrogate of Eq. 9 to ĝα, and then `plain` (of the tile, by place, else
/// empty) receives Σ v dx and Σ v dy without it, for the density statistics.
#[inline(always)]
pub(crate) fn unblend<
    S: Simd,
    const FIRST: usize,
    const F: usize,
    const P: usize,
    const STATISTICS: bool,
    const LOAD: bool,
>(
    simd: S,
    tile: &Tile<'_>,
    upstream: &Upstream<'_>,
    out: &mut [Line],
    plain: &mut [[f32; 2]],
) {
    let mut state = State { light: drawn_light(tile.drawn), rest: each(|block| upstream.planes[block * P]) };
    let mut batch = [Line::ZERO; BATCH];
    // What lies behind the last pair that covers a pixel is not fetched.
    let end = upstream.blocks.iter().rposition(|&blocks| blocks != 0).map_or(0, |last| last + 1);
    for pair in 0..end {
        if pair % BATCH == 0 {
            tile.fetch(&tile.listed[pair..end.min(pair + BATCH)], &mut batch);
        }
        if upstream.blocks[pair] == 0 {
            continue;
        }
        let record = &batch[pair % BATCH];
        let mut totals = [S::f32s::splat(simd, 0.0); 16];
        let mut plain_totals = [S::f32s::splat(simd, 0.0); 2];
        let mut bits = upstream.blocks[pair];
        while bits != 0 {
            let block = bits.trailing_zeros() as usize % BLOCKS;
            bits &= bits - 1;
            for part in 0..LANES / S::f32s::LEN {
                let planes = &upstream.planes[block * P..][..P];
                let at = Place { block, lane: part * S::f32s::LEN, planes, load: upstream.load };
                walk::<S, FIRST, F, STATISTICS, LOAD>(
                    simd,
                    tile,
                    record,
                    &at,
                    &mut state,
                    &mut totals,
                    &mut plain_totals,
                );
            }
        }
        sums(simd, totals, &mut out[pair]);
        if LOAD && STATISTICS {
            plain[pair] = each(|k| plain_totals[k].reduce_sum());
        }
    }
}

/// A vector's worth of pixels of a block.
struct Place<'a> {
    block: usize,
    lane: usize,
    /// Upstream planes of the block.
    planes: &'a [Line],
    load: Option<&'a [Line; BLOCKS]>,
}

#[inline(always)]
fn walk<S: Simd, const FIRST: usize, const F: usize, const STATISTICS: bool, const LOAD: bool>(
    simd: S,
    tile: &Tile<'_>,
    record: &Line,
    at: &Place<'_>,
    state: &mut State,
    totals: &mut [S::f32s; 16],
    plain: &mut [S::f32s; 2],
) {
    let r = &record.0;
    let splat = |value: f32| S::f32s::splat(simd, value);
    let dx = CENTER_X[at.block].load(simd, at.lane) - r[X];
    let dy = CENTER_Y[at.block].load(simd, at.lane) - r[Y];
    let before = state.light[at.block].load(simd, at.lane);

    let exponent = exponent_at(simd, r, dx, dy);
    let reaches = exponent.simd_ge(splat(tile.cuts.alpha_log2));
    let free = exp2_near(simd, exponent);
    let alpha = reaches.select(free.min(ALPHA_MAX), splat(0.0));
    let weight = alpha * before;
    let after = before - weight;
    state.light[at.block].store(simd, at.lane, after);
    let passed = splat(1.0) - alpha;
    let covered = reaches & after.simd_ge(splat(tile.cuts.stop));
    let weight = covered.select(weight, splat(0.0));

    let mut along = at.planes[1].load(simd, at.lane);
    for feature in 0..F {
        let gradient = at.planes[LEADING_PLANES + feature].load(simd, at.lane);
        along = gradient.mul_add(splat(r[FEATURES + FIRST + feature]), along);
        totals[sum::FEATURES + FIRST + feature] = weight.mul_add(gradient, totals[sum::FEATURES + FIRST + feature]);
    }
    let rest = (-weight).mul_add(along, state.rest[at.block].load(simd, at.lane));
    state.rest[at.block].store(simd, at.lane, rest);
    // Divided, not by Newton's steps: the divider works beside the multipliers.
    let mut d_alpha = before.mul_add(along, -(rest / passed));
    let moves = covered & free.simd_lt(splat(ALPHA_MAX));
    let alpha = moves.select(alpha, splat(0.0));
    let mut v = alpha * d_alpha;
    if STATISTICS {
        // In units of the record: ∂/∂u is −ln 2 times (2 XX dx + XY dy) v.
        let (vx, vy) = (v * dx, v * dy);
        let u = vx.mul_add(splat(2.0 * r[XX]), vy * r[XY]);
        let w = vy.mul_add(splat(2.0 * r[YY]), vx * r[XY]);
        totals[sum::ABSOLUTE_U] += u.abs();
        totals[sum::ABSOLUTE_V] += w.abs();
        totals[sum::COVERED] += covered.select(splat(1.0), splat(0.0));
        if LOAD {
            plain[0] += vx;
            plain[1] += vy;
        }
    }
    if let (true, Some(load)) = (LOAD, at.load) {
        d_alpha += load_slope(simd, alpha) * load[at.block].load(simd, at.lane);
        v = alpha * d_alpha;
    }
    let (vx, vy) = (v * dx, v * dy);
    totals[sum::V] += v;
    totals[sum::VX] += vx;
    totals[sum::VY] += vy;
    totals[sum::VXX] = vx.mul_add(dx, totals[sum::VXX]);
    totals[sum::VXY] = vx.mul_add(dy, totals[sum::VXY]);
    totals[sum::VYY] = vy.mul_add(dy, totals[sum::VYY]);
}

/// ∂load/∂α = k E / (1 + E)², E = e^{−k (α − α₀)}: [`crate::equations::blend::load_grad`] in lanes.
#[inline(always)]
fn load_slope<S: Simd>(simd: S, alpha: S::f32s) -> S::f32s {
    let steepness = (LOAD_STEEPNESS * std::f64::consts::LOG2_E) as f32;
    let offset = S::f32s::splat(simd, LOAD_CENTER as f32) - alpha;
    let e = exp2(simd, (offset * steepness).max(-60.0));
    let sum = e + 1.0;
    e * (LOAD_STEEPNESS as f32) / (sum * sum)
}
