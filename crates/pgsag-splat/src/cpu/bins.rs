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
    wide::{Carried, Wide},
};
use crate::equations::{Number, algebra::each};

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
    /// The smallest standard deviation, scene units; blending does not read it, nor anyone from a record.
    pub(crate) const THICKNESS: usize = 15;
}
use place::{PEAK, X, XX, XY, Y, YY};

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
    /// Its smallest standard deviation, scene units.
    pub(crate) thickness: f32,
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
    listed: Vec<AtomicU32>,
    /// `[pairs]` place of each pair.
    pub(crate) places: Vec<AtomicU32>,
    order: Vec<u32>,
    cursors: Vec<u32>,
    sorter: Sorter,
}

impl Bins {
    /// Takes over what the chunks of a projection found, in order of Gaussians; `first` is still relative to its chunk.
    pub(crate) fn gather(&mut self, chunks: &[(&[Entry], &[u32])]) {
        let lengths = chunks.iter().fold((0, 0), |sum, chunk| (sum.0 + chunk.0.len(), sum.1 + chunk.1.len()));
        self.entries.resize(lengths.0, Entry::default());
        self.tiles.resize(lengths.1, 0);
        let (mut entries, mut tiles) = (&mut self.entries[..], &mut self.tiles[..]);
        let mut copies = Vec::with_capacity(chunks.len());
        let mut base = 0;
        for &(from, from_tiles) in chunks {
            let (own, rest) = entries.split_at_mut(from.len());
            let (own_tiles, rest_tiles) = tiles.split_at_mut(from_tiles.len());
            copies.push((base, from, own, from_tiles, own_tiles));
            (entries, tiles) = (rest, rest_tiles);
            base += from_tiles.len() as u32;
        }
        copies.into_par_iter().for_each(|(base, from, entries, from_tiles, tiles)| {
            tiles.copy_from_slice(from_tiles);
            for (to, from) in entries.iter_mut().zip(from) {
                *to = Entry { first: from.first + base, ..*from };
            }
        });
    }

    /// Builds the lists of `tile_count` tiles.
    pub(crate) fn fill(&mut self, tile_count: usize) {
        self.sorter.order(&self.entries, |entry| entry.depth, &mut self.order);
        self.listed.resize_with(self.tiles.len(), AtomicU32::default);
        self.places.resize_with(self.tiles.len(), AtomicU32::default);
        let chunk = self.order.len().div_ceil(rayon::current_num_threads()).max(4096);
        let chunks = self.order.len().div_ceil(chunk).max(1);
        self.cursors.clear();
        self.cursors.resize(tile_count * chunks, 0);
        let (entries, tiles) = (&self.entries, &self.tiles);
        let pairs = |entry: &Entry| entry.first as usize..(entry.first + entry.count) as usize;
        if chunks == 1 {
            // In the order of memory: the sum is the same.
            tiles.iter().for_each(|&tile| self.cursors[tile as usize] += 1);
        } else {
            let counts = self.cursors.par_chunks_mut(tile_count.max(1));
            counts.zip(self.order.par_chunks(chunk)).for_each(|(counts, order)| {
                for &at in order {
                    for &tile in &tiles[pairs(&entries[at as usize])] {
                        counts[tile as usize] += 1;
                    }
                }
            });
        }
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
                        self.listed[*cursor as usize].store(entry.gaussian, Relaxed);
                        self.places[pair].store(*cursor, Relaxed);
                        *cursor += 1;
                    }
                }
            },
        );
    }

    /// Whether `of_pair` (`[pairs]`, by place) is not 0 for a pair of the entry.
    pub(crate) fn any(&self, entry: &Entry, of_pair: &[u16]) -> bool {
        let places = &self.places[entry.first as usize..(entry.first + entry.count) as usize];
        places.iter().any(|place| of_pair[place.load(Relaxed) as usize] != 0)
    }

    /// Gaussians at some places.
    pub(crate) fn listed(&self, places: std::ops::Range<usize>) -> &[AtomicU32] {
        &self.listed[places]
    }

    /// Places of one tile's list.
    pub(crate) fn list(&self, slot: usize) -> std::ops::Range<usize> {
        self.starts[slot] as usize..self.starts[slot + 1] as usize
    }
}

/// Tiles that the boxes about the ellipses of 16 Gaussians touch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Boxes {
    /// Half widths about the centres, x and y, pixels.
    half: [Line; 2],
    /// First column and row, last column and row; as numbers.
    span: [Line; 4],
    /// 1 where there is any tile, else 0.
    any: Line,
}

impl Boxes {
    /// None.
    pub(crate) const NONE: Self = Self { half: [Line::ZERO; 2], span: [Line::ZERO; 4], any: Line::ZERO };

    /// Of the lanes from `at` on, by the places of their records, where `ahead`; in which some pixel centre may reach
    /// the alpha cut (log2).
    #[inline(always)]
    pub(crate) fn set<S: Carried>(
        &mut self,
        layout: &Layout,
        fields: &[Line; 16],
        at: usize,
        cut: f32,
        ahead: S::mask32s,
    ) {
        let load = |k: usize| Wide::<S>::load(&fields[k], at);
        let number = |value: f32| Wide::<S>::from_f64(f64::from(value));
        let (zero, four) = (number(0.0), number(4.0));
        let (p, q, s) = (-load(XX), -load(XY), -load(YY));
        let level = load(PEAK) - number(cut) + number(CULL_MARGIN);
        let determinant = four * p * s - q * q;
        let half = [(four * s * level / determinant).sqrt(), (four * p * level / determinant).sqrt()];
        let mut any = ahead & zero.less(level) & zero.less(determinant);
        let tile = number(TILE as f32);
        for (k, (place, tiles)) in [(X, layout.columns), (Y, layout.rows)].into_iter().enumerate() {
            let first = ((load(place) - half[k] - (tile - number(0.5))) / tile).ceil().max(zero);
            let last = ((load(place) + half[k] - number(0.5)) / tile).floor().min(number(tiles as f32 - 1.0));
            any &= first.less(last + number(0.5));
            first.store(&mut self.span[k], at);
            last.store(&mut self.span[2 + k], at);
            half[k].store(&mut self.half[k], at);
        }
        Wide::select(any, number(1.0), zero).store(&mut self.any, at);
    }

    /// Appends the drawn tile slots of one lane, row by row, with the same arithmetic exactly: ellipse against tile.
    /// Inlined into vector code, where rounding is one instruction.
    #[inline(always)]
    pub(crate) fn touched(&self, layout: &Layout, fields: &[Line; 16], lane: usize, cut: f32, tiles: &mut Vec<u32>) {
        if self.any.0[lane] == 0.0 {
            return;
        }
        let [x0, y0, x1, y1] = each(|k| self.span[k].0[lane] as u32);
        if !layout.any_drawn(x0, x1, y0, y1) {
            return;
        }
        if x0 == x1 {
            for row in y0..=y1 {
                push_drawn(tiles, layout, row, (x0, x0));
            }
            return;
        }
        let field = |k: usize| fields[k].0[lane];
        let (p, q, s) = (-field(XX), -field(XY), -field(YY));
        let level = field(PEAK) - cut + CULL_MARGIN;
        let determinant = 4.0 * p * s - q * q;
        let (half_x, half_y) = (self.half[0].0[lane], self.half[1].0[lane]);
        let turn = 0.5 * q / s * half_x;
        for row in y0..=y1 {
            let above = row as f32 * TILE as f32 + 0.5 - field(Y);
            let (low, high) = (above.max(-half_y), (above + (TILE - 1) as f32).min(half_y));
            let edge = |at: f32, sign: f32| {
                let y = at.max(low).min(high);
                (sign * (4.0 * p * level - determinant * y * y).max(0.0).sqrt() - q * y) / (2.0 * p)
            };
            let (left, right) = (edge(turn, -1.0), edge(-turn, 1.0));
            let (middle, half) = (0.5 * (left + right) + field(X), 0.5 * (right - left));
            if let Some(columns) = tile_span(middle, half, (layout.columns - 1) as f32) {
                push_drawn(tiles, layout, row, columns);
            }
        }
    }
}

#[inline(always)]
fn push_drawn(tiles: &mut Vec<u32>, layout: &Layout, row: u32, (first, last): (u32, u32)) {
    let base = (row * layout.columns) as usize;
    for &slot in &layout.slot_of_tile[base + first as usize..=base + last as usize] {
        if slot != NOT_DRAWN {
            tiles.push(slot);
        }
    }
}

/// First and last tile (at most `last`) with a pixel centre in `[middle - half, middle + half]`.
#[inline(always)]
pub(crate) fn tile_span(middle: f32, half: f32, last: f32) -> Option<(u32, u32)> {
    let tile = TILE as f32;
    let first = ((middle - half - (tile - 0.5)) / tile).ceil().max(0.0);
    let end = ((middle + half - 0.5) / tile).floor().min(last);
    (first <= end).then_some((first as u32, end as u32))
}

#[cfg(test)]
mod tests;
