//! Front-to-back blending of one tile (Eq. 1).
//!
//! Batches of 64 Gaussians; an exact ellipse-against-block test gives each block the set of those that can reach it;
//! then each block blends its set with its accumulators in registers. A block ends when none of its pixels is above
//! the transmittance stop. What was blended where is kept as one bit per (pair, block), so that the backward pass
//! visits exactly the same places and culls nothing twice.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use fearless_simd::{Simd, prelude::*};

use super::{
    bins::{
        CULL_MARGIN,
        place::{FEATURES, PEAK, SLOPE_X, SLOPE_Y, X, XX, XY, Y, YY},
    },
    lanes::{BLOCK, BLOCKS, CENTER_X, CENTER_Y, LANES, Line, exp2_near},
    layout::block_corner,
};
use crate::equations::algebra::each;

/// Alpha is held below this, so that no Gaussian hides everything behind it. 3DGS.
pub(crate) const ALPHA_MAX: f32 = 0.99;
/// Gaussians of a batch.
const BATCH: usize = 64;

/// [`crate::backend::Limits`] as the kernels read them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cuts {
    /// log2 of the alpha cut.
    pub(crate) alpha_log2: f32,
    /// A pixel stops before its transmittance would fall below this.
    pub(crate) stop: f32,
}

/// What the kernels read of one tile.
#[derive(Clone, Copy)]
pub(crate) struct Tile<'a> {
    /// By Gaussian.
    pub(crate) records: &'a [Line],
    /// The tile's list, front to back: [`super::bins::Bins::listed`].
    pub(crate) listed: &'a [AtomicU32],
    /// Pixels that are drawn.
    pub(crate) drawn: &'a [u16; BLOCKS],
    /// Top-left pixel.
    pub(crate) corner: (f32, f32),
    /// Limits of blending.
    pub(crate) cuts: Cuts,
}

impl Tile<'_> {
    /// Fetches the records of some Gaussians of the list, their centres relative to the tile's corner: with the same
    /// rounding in both passes, so that both decide the same. Records lie anywhere: they are copied first, all latencies
    /// overlapping, and looked at then.
    #[inline(always)]
    pub(crate) fn fetch(&self, listed: &[AtomicU32], records: &mut [Line]) {
        for (to, listed) in records.iter_mut().zip(listed) {
            *to = self.records[listed.load(Relaxed) as usize];
        }
        for record in records.iter_mut().take(listed.len()) {
            record.0[X] -= self.corner.0;
            record.0[Y] -= self.corner.1;
        }
    }
}

/// What blending writes. `planes` are `F` features and the sum of weights, `[block][F + 1]`, zeroed by the caller.
pub(crate) struct Blend<'a> {
    /// `[BLOCKS * (F + 1)]`
    pub(crate) planes: &'a mut [Line],
    /// `[pairs]` blocks in which a pixel is covered.
    pub(crate) blocks: &'a mut [u16],
    /// `[BLOCKS]` covered entries per pixel, and `[pairs]` blocks in which a pixel is covered while more than half of the
    /// light passes; read with `COUNTS` alone.
    pub(crate) counts: Option<(&'a mut [Line], &'a mut [u16])>,
}

/// A batch, as records and as one array per field of the culling test.
struct Batch {
    records: [Line; BATCH],
    fields: [[f32; BATCH]; 8],
}

/// Places of a record that the culling test reads.
const CULLED: [usize; 8] = [X, Y, XX, XY, YY, PEAK, SLOPE_Y, SLOPE_X];

impl Batch {
    #[inline(always)]
    fn fill(&mut self, tile: &Tile<'_>, listed: &[AtomicU32]) {
        tile.fetch(listed, &mut self.records);
        for (i, record) in self.records.iter().enumerate().take(listed.len()) {
            for (field, &at) in self.fields.iter_mut().zip(&CULLED) {
                field[i] = record.0[at];
            }
        }
    }

    /// The Gaussians of the batch whose ellipse reaches a pixel centre of the block at `corner` of the tile; a few more, never fewer.
    /// The exponent is concave, so over a box it is largest on one of the two edges that face the centre, at the point
    /// of that edge where the slope through the centre says so.
    #[inline(always)]
    fn reaching<S: Simd>(&self, simd: S, count: usize, corner: (f32, f32), cuts: Cuts) -> u64 {
        let zero = S::f32s::splat(simd, 0.0);
        let mut bits = 0u64;
        let mut at = 0;
        while at < count {
            let [x, y, xx, xy, yy, peak, slope_y, slope_x] =
                each(|f| S::f32s::from_slice(simd, &self.fields[f][at..at + S::f32s::LEN]));
            let (left, top) = (S::f32s::splat(simd, corner.0 + 0.5) - x, S::f32s::splat(simd, corner.1 + 0.5) - y);
            let (right, bottom) = (left + (BLOCK - 1) as f32, top + (BLOCK - 1) as f32);
            let near_x = left.max(zero.min(right));
            let near_y = top.max(zero.min(bottom));
            let best_y = top.max((slope_y * near_x).min(bottom));
            let best_x = left.max((slope_x * near_y).min(right));
            let exponent = |dx: S::f32s, dy: S::f32s| {
                let along = xx.mul_add(dx, xy * dy);
                along.mul_add(dx, (yy * dy).mul_add(dy, peak))
            };
            let most = exponent(near_x, best_y).max(exponent(best_x, near_y));
            let reaches = most.simd_ge(S::f32s::splat(simd, cuts.alpha_log2 - CULL_MARGIN));
            bits |= reaches.to_bitmask() << at;
            at += S::f32s::LEN;
        }
        bits & (u64::MAX >> (BATCH - count))
    }
}

/// A vector's worth of pixels of a block.
struct Part<'a> {
    batch: &'a Batch,
    /// Place of the batch in the tile's list.
    first_pair: usize,
    block: usize,
    /// First lane.
    lane: usize,
    cuts: Cuts,
}

/// Blends one tile: `F` features from `FIRST` on.
#[inline(always)]
pub(crate) fn blend<S: Simd, const FIRST: usize, const F: usize, const COUNTS: bool>(
    simd: S,
    tile: &Tile<'_>,
    out: &mut Blend<'_>,
) {
    let parts = LANES / S::f32s::LEN;
    let all_parts = (1u64 << parts) - 1;
    let mut batch = Batch { records: [Line::ZERO; BATCH], fields: [[0.0; BATCH]; 8] };
    let mut light = drawn_light(tile.drawn);
    let mut live = 0u64;
    for block in 0..BLOCKS {
        live |= (u64::from(tile.drawn[block] != 0) * all_parts) << (block * parts);
    }
    out.blocks.fill(0);
    for (index, listed) in tile.listed.chunks(BATCH).enumerate() {
        if live == 0 {
            return;
        }
        batch.fill(tile, listed);
        for block in 0..BLOCKS {
            let alive = live >> (block * parts) & all_parts;
            if alive == 0 {
                continue;
            }
            let bits = batch.reaching(simd, listed.len(), block_corner(block), tile.cuts);
            if bits == 0 {
                continue;
            }
            for part in 0..parts {
                let lane = part * S::f32s::LEN;
                let at = Part { batch: &batch, first_pair: index * BATCH, block, lane, cuts: tile.cuts };
                if alive >> part & 1 != 0 && !blend_part::<S, FIRST, F, COUNTS>(simd, &at, bits, &mut light[block], out)
                {
                    live &= !(1 << (block * parts + part));
                }
            }
        }
    }
}

/// Transmittance before the first Gaussian: 1, and 0 where nothing is drawn, so that nothing is.
#[inline(always)]
pub(crate) fn drawn_light(drawn: &[u16; BLOCKS]) -> [Line; BLOCKS] {
    let mut light = [Line::ZERO; BLOCKS];
    for (light, drawn) in light.iter_mut().zip(drawn) {
        for (lane, light) in light.0.iter_mut().enumerate() {
            *light = f32::from(drawn >> lane & 1);
        }
    }
    light
}

/// Blends the Gaussians `bits` of a batch; false when no pixel lets enough light through any more.
/// `light` keeps falling past the stop, and tells by being below it that the pixel has stopped.
#[inline(always)]
fn blend_part<S: Simd, const FIRST: usize, const F: usize, const COUNTS: bool>(
    simd: S,
    at: &Part<'_>,
    mut bits: u64,
    light: &mut Line,
    out: &mut Blend<'_>,
) -> bool {
    let zero = S::f32s::splat(simd, 0.0);
    let (cut, stop) = (S::f32s::splat(simd, at.cuts.alpha_log2), S::f32s::splat(simd, at.cuts.stop));
    let (x, y) = (CENTER_X[at.block].load(simd, at.lane), CENTER_Y[at.block].load(simd, at.lane));
    let planes: &mut [Line] = &mut out.planes[at.block * (F + 1)..][..F + 1];
    let pairs = &mut out.blocks[at.first_pair..];
    let mut sums = [zero; 8];
    for plane in 0..=F {
        sums[plane] = planes[plane].load(simd, at.lane);
    }
    let mut before = light.load(simd, at.lane);
    let mut count = zero;
    let mut alive = true;
    while bits != 0 {
        let i = bits.trailing_zeros() as usize % BATCH;
        bits &= bits - 1;
        let r = &at.batch.records[i].0;
        let exponent = exponent_at(simd, r, x - r[X], y - r[Y]);
        let reaches = exponent.simd_ge(cut);
        let alpha = reaches.select(exp2_near(simd, exponent).min(ALPHA_MAX), zero);
        let weight = alpha * before;
        let after = before - weight;
        let passes = after.simd_ge(stop);
        let covered = reaches & passes;
        let weight = covered.select(weight, zero);
        for feature in 0..F {
            sums[feature] = weight.mul_add(S::f32s::splat(simd, r[FEATURES + FIRST + feature]), sums[feature]);
        }
        sums[F] += weight;
        pairs[i] |= u16::from(covered.any_true()) << at.block;
        if COUNTS {
            count += covered.select(S::f32s::splat(simd, 1.0), zero);
            if let Some((_, seen)) = &mut out.counts {
                let first_half = covered & before.simd_gt(S::f32s::splat(simd, 0.5));
                seen[at.first_pair + i] |= u16::from(first_half.any_true()) << at.block;
            }
        }
        before = after;
        if passes.all_false() {
            alive = false;
            break;
        }
    }
    light.store(simd, at.lane, before);
    for plane in 0..=F {
        planes[plane].store(simd, at.lane, sums[plane]);
    }
    if let (true, Some((load, _))) = (COUNTS, &mut out.counts) {
        let sum = load[at.block].load(simd, at.lane) + count;
        load[at.block].store(simd, at.lane, sum);
    }
    alive
}

/// log2 of alpha at `(dx, dy)` from a record's centre.
#[inline(always)]
pub(crate) fn exponent_at<S: Simd>(simd: S, record: &[f32; 16], dx: S::f32s, dy: S::f32s) -> S::f32s {
    let along = S::f32s::splat(simd, record[XX]).mul_add(dx, dy * record[XY]);
    along.mul_add(dx, (dy * record[YY]).mul_add(dy, S::f32s::splat(simd, record[PEAK])))
}
