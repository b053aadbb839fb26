//! From projected Gaussians to per-tile lists, front to back.
//!
//! Which tiles a Gaussian touches is decided exactly (ellipse against the tile's pixel centres) while it is projected;
//! then depths are sorted once per Gaussian and a stable counting sort hands the Gaussians out to their tiles, so the
//! (Gaussian, tile) pairs are never sorted.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use rayon::prelude::*;

use super::{
    lanes::{Line, TILE},
    layout::{Layout, NOT_DRAWN},
    sort::{Sorter, starts},
};

/// Places in a record (a [`Line`] per Gaussian): all that blending reads. The exponent of alpha, base 2, at the pixel
/// `(dx, dy)` from the centre is `XX dx² + XY dx dy + YY dy² + PEAK`.
pub(crate) mod place {
    /// Centre, pixels.
    pub(crate) const X: usize = 0;
    /// Centre, pixels.
    pub(crate) const Y: usize = 1;
    /// Negative.
    pub(crate) const XX: usize = 2;
    /// Any sign.
    pub(crate) const XY: usize = 3;
    /// Negative.
    pub(crate) const YY: usize = 4;
    /// log2 of the opacity.
    pub(crate) const PEAK: usize = 5;
    /// Three of colour, then three of the normal and one of the distance.
    pub(crate) const FEATURES: usize = 6;
    /// dy of the largest exponent per dx.
    pub(crate) const SLOPE_Y: usize = 13;
    /// dx of the largest exponent per dy.
    pub(crate) const SLOPE_X: usize = 14;
}
use place::{PEAK, SLOPE_X, SLOPE_Y, X, XX, XY, Y, YY};

/// Kept beyond the alpha cut when culling (log2 of alpha), so that rounding never culls what the pixel test keeps.
pub(crate) const CULL_MARGIN: f32 = 0.02;

/// One Gaussian that touches a drawn tile.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Entry {
    /// Its index in the cloud.
    pub(crate) gaussian: u32,
    /// Bits of its depth, which order as depths do.
    pub(crate) depth: u32,
    /// Its first pair.
    pub(crate) first: u32,
    /// Its pairs.
    pub(crate) count: u32,
}

/// Lists of all tiles. A *pair* is a Gaussian in a tile; pairs are numbered in the order of Gaussians, and placed in
/// the order of tiles, front to back.
#[derive(Debug, Default)]
pub(crate) struct Bins {
    /// Gaussians that touch a drawn tile, by index.
    pub(crate) entries: Vec<Entry>,
    /// `[pairs]` tile slot of every pair.
    tiles: Vec<u32>,
    /// `[tiles + 1]` where the list of each tile begins.
    pub(crate) starts: Vec<u32>,
    /// `[pairs]` Gaussian at each place.
    pub(crate) gaussians: Vec<AtomicU32>,
    /// `[pairs]` place of each pair.
    pub(crate) places: Vec<AtomicU32>,
    keys: Vec<u32>,
    order: Vec<u32>,
    cursors: Vec<u32>,
    sorter: Sorter,
}

impl Bins {
    /// Takes over what the chunks of a projection found, in order of Gaussians; `first` is still relative to its chunk.
    pub(crate) fn gather<'a>(&mut self, chunks: impl Iterator<Item = (&'a [Entry], &'a [u32])>) {
        self.entries.clear();
        self.tiles.clear();
        for (entries, tiles) in chunks {
            let base = self.tiles.len() as u32;
            self.entries.extend(entries.iter().map(|entry| Entry { first: entry.first + base, ..*entry }));
            self.tiles.extend_from_slice(tiles);
        }
    }

    /// Builds the lists of `tile_count` tiles.
    pub(crate) fn fill(&mut self, tile_count: usize) {
        self.keys.clear();
        self.keys.extend(self.entries.iter().map(|entry| entry.depth));
        self.sorter.order(&self.keys, &mut self.order);
        self.gaussians.resize_with(self.tiles.len(), AtomicU32::default);
        self.places.resize_with(self.tiles.len(), AtomicU32::default);
        let chunk = self.order.len().div_ceil(rayon::current_num_threads()).max(4096);
        let chunks = self.order.len().div_ceil(chunk).max(1);
        self.cursors.clear();
        self.cursors.resize(tile_count * chunks, 0);
        let (entries, tiles) = (&self.entries, &self.tiles);
        let pairs = |entry: &Entry| entry.first as usize..(entry.first + entry.count) as usize;
        self.cursors.par_chunks_mut(tile_count.max(1)).zip(self.order.par_chunks(chunk)).for_each(|(counts, order)| {
            for &at in order {
                for &tile in &tiles[pairs(&entries[at as usize])] {
                    counts[tile as usize] += 1;
                }
            }
        });
        let total = starts(&mut self.cursors, tile_count.max(1));
        self.starts.clear();
        self.starts.extend_from_slice(&self.cursors[..tile_count]);
        self.starts.push(total);
        self.cursors.par_chunks_mut(tile_count.max(1)).zip(self.order.par_chunks(chunk)).for_each(
            |(cursors, order)| {
                for &at in order {
                    let entry = &entries[at as usize];
                    for pair in pairs(entry) {
                        let cursor = &mut cursors[tiles[pair] as usize];
                        self.gaussians[*cursor as usize].store(entry.gaussian, Relaxed);
                        self.places[pair].store(*cursor, Relaxed);
                        *cursor += 1;
                    }
                }
            },
        );
    }

    /// Places of one tile's list.
    pub(crate) fn list(&self, slot: usize) -> std::ops::Range<usize> {
        self.starts[slot] as usize..self.starts[slot + 1] as usize
    }
}

/// Fills in the two slopes of a record, from its exponent.
pub(crate) fn set_slopes(record: &mut Line) {
    let r = &mut record.0;
    r[SLOPE_Y] = -0.5 * r[XY] / r[YY];
    r[SLOPE_X] = -0.5 * r[XY] / r[XX];
}

/// Appends the drawn tile slots in which some pixel centre may reach the alpha cut (log2), row by row.
/// Inlined into vector code, where rounding is one instruction.
#[inline(always)]
pub(crate) fn touched_tiles(layout: &Layout, record: &Line, cut: f32, tiles: &mut Vec<u32>) {
    let r = &record.0;
    let (p, q, s) = (-r[XX], -r[XY], -r[YY]);
    let level = r[PEAK] - cut + CULL_MARGIN;
    let determinant = 4.0 * p * s - q * q;
    if level.is_nan() || level <= 0.0 || determinant.is_nan() || determinant <= 0.0 {
        return;
    }
    let half_x = (4.0 * s * level / determinant).sqrt();
    let half_y = (4.0 * p * level / determinant).sqrt();
    let last = |pixels: u32| (pixels - 1) as f32;
    let (Some((x0, x1)), Some((y0, y1))) =
        (tile_span(r[X], half_x, last(layout.columns)), tile_span(r[Y], half_y, last(layout.rows)))
    else {
        return;
    };
    if !layout.any_drawn(x0, x1, y0, y1) {
        return;
    }
    let turn = 0.5 * q / s * half_x;
    for row in y0..=y1 {
        let above = row as f32 * TILE as f32 + 0.5 - r[Y];
        let (low, high) = (above.max(-half_y), (above + (TILE - 1) as f32).min(half_y));
        let edge = |at: f32, sign: f32| {
            let y = at.max(low).min(high);
            (sign * (4.0 * p * level - determinant * y * y).max(0.0).sqrt() - q * y) / (2.0 * p)
        };
        let (left, right) = if x0 == x1 { (-half_x, half_x) } else { (edge(turn, -1.0), edge(-turn, 1.0)) };
        let (middle, half) = (0.5 * (left + right) + r[X], 0.5 * (right - left));
        let Some((first, last)) = tile_span(middle, half, last(layout.columns)) else { continue };
        let base = (row * layout.columns) as usize;
        for &slot in &layout.slot_of_tile[base + first as usize..=base + last as usize] {
            if slot != NOT_DRAWN {
                tiles.push(slot);
            }
        }
    }
}

/// First and last tile (at most `last`) with a pixel centre in `[middle - half, middle + half]`.
#[inline(always)]
fn tile_span(middle: f32, half: f32, last: f32) -> Option<(u32, u32)> {
    let tile = TILE as f32;
    let first = ((middle - half - (tile - 0.5)) / tile).ceil().max(0.0);
    let end = ((middle + half - 0.5) / tile).floor().min(last);
    (first <= end).then_some((first as u32, end as u32))
}

#[cfg(test)]
mod tests;
