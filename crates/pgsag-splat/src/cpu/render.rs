//! A render on this device, and how it is drawn and differentiated tile by tile.

use std::{
    ops::Range,
    sync::{Arc, Mutex},
};

use fearless_simd::{Level, Simd};
use rayon::prelude::*;

use super::{
    backward::{Upstream, unblend},
    bins::Bins,
    forward::{Blend, Cuts, Tile, blend},
    lanes::{BLOCKS, Line, at_level},
    layout::Layout,
    maps::{Drawing, Part, PartGradients, Rows, part_read, slots_of_parts},
    project::Found,
};
use crate::backend::{RenderOptions, ViewCamera};
use crate::losses::{MapGradients, RenderedMaps, spare::Spare};

/// Features of a colour.
const COLORS: usize = 3;
/// Features at most: colour, normal, distance.
pub(crate) const FEATURES_MAX: usize = 7;

/// Buffers of finished renders, for the next ones: no page is asked of the system twice.
pub(crate) type Pool = Mutex<Vec<Buffers>>;

/// Everything of a render that has a size.
#[derive(Debug, Default)]
pub(crate) struct Buffers {
    /// By Gaussian; valid for those with entries.
    pub(crate) records: Vec<Line>,
    /// Scratch of the projection.
    pub(crate) found: Vec<Found>,
    /// Lists of tiles.
    pub(crate) bins: Bins,
    /// What was drawn, in rows.
    pub(crate) rows: Rows,
    /// `[pairs]` blocks in which a pixel is covered.
    pub(crate) blocks: Vec<u16>,
    /// `[pairs]` blocks in which a pixel is covered in the first half of its light; empty without counts.
    pub(crate) seen: Vec<u16>,
    /// Gradients of the maps, of this render or of an earlier one.
    pub(crate) gradients: MapGradients<f32>,
}

/// A render on the CPU: its maps, and what the gradient needs.
#[derive(Debug)]
pub struct CpuRender {
    pub(crate) options: RenderOptions,
    pub(crate) camera: ViewCamera,
    pub(crate) layout: Arc<Layout>,
    pub(crate) cuts: Cuts,
    pub(crate) buffers: Buffers,
    /// Whether the maps' gradients are this render's; set by `losses`.
    pub(crate) differentiated: bool,
    /// Gradient of the smallest scale of every visible Gaussian; set by `losses`.
    pub(crate) d_smallest_scale: f32,
    pub(crate) pool: Arc<Pool>,
}

impl Drop for CpuRender {
    fn drop(&mut self) {
        if let Ok(mut pool) = self.pool.lock() {
            pool.push(std::mem::take(&mut self.buffers));
        }
    }
}

/// What the backward pass reads, and `sums` and `plain` which it writes, of the tiles `slots` of one part.
struct UpstreamPart<'a> {
    taken: &'a PartGradients,
    slots: Range<usize>,
    sums: &'a mut [Line],
    plain: &'a mut [[f32; 2]],
}

/// Whether colours are left out: only where the other options have kernels for it.
pub(crate) fn leaves_color_out(options: &RenderOptions) -> bool {
    let RenderOptions { planes, load, observe, statistics, without_color, .. } = *options;
    without_color && planes && !load && !observe && !statistics
}

impl CpuRender {
    /// Features that are drawn, of colour 3, normal 3, distance 1.
    pub(crate) fn features(&self) -> Range<usize> {
        match (self.options.planes, leaves_color_out(&self.options)) {
            (_, true) => COLORS..FEATURES_MAX,
            (true, _) => 0..FEATURES_MAX,
            (false, _) => 0..COLORS,
        }
    }

    /// Takes the gradients of the maps, and gives the buffers of an earlier render for them.
    pub(crate) fn take_gradients(&mut self, gradients: &mut MapGradients<f32>) {
        std::mem::swap(&mut self.buffers.gradients, gradients);
        self.differentiated = true;
    }

    /// Whether some map has a gradient.
    pub(crate) fn has_gradients(&self) -> bool {
        let MapGradients { color, normal, distance, opacity, load } = &self.buffers.gradients;
        let mut maps = color.iter().chain(normal).chain([distance, opacity, load]);
        self.differentiated && maps.any(|map| !map.is_empty())
    }

    fn tile(&self, slot: usize) -> Tile<'_> {
        let (x, y) = self.layout.corner(self.layout.tiles[slot]);
        Tile {
            records: &self.buffers.records,
            listed: self.buffers.bins.listed(self.buffers.bins.list(slot)),
            drawn: &self.layout.drawn[slot],
            corner: (x as f32, y as f32),
            cuts: self.cuts,
        }
    }

    /// What was drawn, as losses want it.
    pub(crate) fn maps(&self) -> RenderedMaps<'_, f32> {
        self.buffers.rows.maps(&self.features(), self.options.load)
    }

    /// Blends all tiles.
    pub(crate) fn blend(&mut self, level: Level) {
        let features = self.features();
        let pairs = self.buffers.bins.starts.last().map_or(0, |&end| end as usize);
        let counts = self.options.load || self.options.observe;
        let mut rows = std::mem::take(&mut self.buffers.rows);
        let mut blocks = std::mem::take(&mut self.buffers.blocks);
        let mut seen = std::mem::take(&mut self.buffers.seen);
        blocks.resize(pairs, 0);
        seen.clear();
        seen.resize(if counts { pairs } else { 0 }, 0);
        let maps = rows.drawn(&self.layout, &features, self.options.load);
        let of_pairs = [&mut blocks[..], &mut seen[..]];
        let parts = Part::all((&self.layout, &self.buffers.bins), maps, of_pairs);
        parts.into_par_iter().with_max_len(1).for_each_init(Drawing::default, |drawing, mut part| {
            at_level!(level, simd => match (features.start, features.end, counts) {
                (0, COLORS, false) => self.blend_part::<_, 0, 3, false>(simd, &mut part, drawing),
                (0, COLORS, true) => self.blend_part::<_, 0, 3, true>(simd, &mut part, drawing),
                (COLORS, ..) => self.blend_part::<_, COLORS, 4, false>(simd, &mut part, drawing),
                (_, _, false) => self.blend_part::<_, 0, 7, false>(simd, &mut part, drawing),
                (_, _, true) => self.blend_part::<_, 0, 7, true>(simd, &mut part, drawing),
            });
        });
        self.buffers.rows = rows;
        self.buffers.blocks = blocks;
        self.buffers.seen = seen;
    }

    /// Blends one part.
    #[inline(always)]
    fn blend_part<S: Simd, const FIRST: usize, const F: usize, const COUNTS: bool>(
        &self,
        simd: S,
        part: &mut Part<'_>,
        drawing: &mut Drawing,
    ) {
        drawing.clear(part.slots.len(), F + 1, COUNTS);
        let first_pair = self.buffers.bins.starts[part.slots.start] as usize;
        for (k, slot) in part.slots.clone().enumerate() {
            let list = self.buffers.bins.list(slot);
            let own = list.start - first_pair..list.end - first_pair;
            let mut counts = None;
            if COUNTS {
                counts = Some((&mut drawing.load[k * BLOCKS..][..BLOCKS], &mut part.seen[own.clone()]));
            }
            let planes = &mut drawing.planes[k * BLOCKS * (F + 1)..][..BLOCKS * (F + 1)];
            let mut out = Blend { planes, blocks: &mut part.blocks[own], counts };
            blend::<S, FIRST, F, COUNTS>(simd, &self.tile(slot), &mut out);
        }
        part.put(&self.layout, F + 1 + usize::from(self.options.load), drawing);
    }

    /// Walks all tiles back; `sums` become `[pairs]`, and with a load `plain` too, by place.
    pub(crate) fn unblend(
        &self,
        level: Level,
        sums: &mut Vec<Line>,
        plain: &mut Vec<[f32; 2]>,
        rooms: &Spare<PartGradients>,
    ) {
        let bins = &self.buffers.bins;
        let load = self.differentiated && !self.buffers.gradients.load.is_empty();
        let statistics = self.options.statistics;
        let pairs = self.buffers.blocks.len();
        sums.resize(pairs, Line::ZERO);
        plain.resize(if load { pairs } else { 0 }, [0.0; 2]);
        if !self.has_gradients() {
            sums.fill(Line::ZERO);
            return;
        }
        let features = self.features();
        let (mut sums, mut plain) = (&mut sums[..], &mut plain[..]);
        let mut parts = Vec::new();
        for slots in slots_of_parts(&self.layout, part_read(&self.layout)) {
            if slots.is_empty() {
                continue;
            }
            let pairs = (bins.starts[slots.end] - bins.starts[slots.start]) as usize;
            let (own, own_plain) = (sums.split_at_mut(pairs), plain.split_at_mut(if load { pairs } else { 0 }));
            (sums, plain) = (own.1, own_plain.1);
            parts.push((slots, own.0, own_plain.0));
        }
        parts.into_par_iter().with_max_len(1).for_each(|(slots, sums, plain)| {
            rooms.lend(|taken| {
                at_level!(level, simd => {
                    taken.take(self, &slots);
                    let part = UpstreamPart { taken, slots, sums, plain };
                    match (features.start, features.end, statistics, load) {
                        (0, COLORS, false, false) => self.unblend_part::<_, 0, 3, 5, false, false>(simd, part),
                        (0, COLORS, true, false) => self.unblend_part::<_, 0, 3, 5, true, false>(simd, part),
                        (0, COLORS, _, true) => self.unblend_part::<_, 0, 3, 5, true, true>(simd, part),
                        (COLORS, ..) => self.unblend_part::<_, COLORS, 4, 6, false, false>(simd, part),
                        (_, _, false, false) => self.unblend_part::<_, 0, 7, 9, false, false>(simd, part),
                        (_, _, true, false) => self.unblend_part::<_, 0, 7, 9, true, false>(simd, part),
                        (_, _, _, true) => self.unblend_part::<_, 0, 7, 9, true, true>(simd, part),
                    }
                })
            });
        });
    }

    /// Walks the tiles of one part back.
    #[inline(always)]
    fn unblend_part<
        S: Simd,
        const FIRST: usize,
        const F: usize,
        const P: usize,
        const STATISTICS: bool,
        const LOAD: bool,
    >(
        &self,
        simd: S,
        part: UpstreamPart<'_>,
    ) {
        let UpstreamPart { taken, slots, mut sums, mut plain } = part;
        for (k, slot) in slots.enumerate() {
            let list = self.buffers.bins.list(slot);
            let (own, own_plain) =
                (sums.split_at_mut(list.len()), plain.split_at_mut(if LOAD { list.len() } else { 0 }));
            (sums, plain) = (own.1, own_plain.1);
            let upstream = Upstream {
                planes: &taken.planes[k * BLOCKS * P..][..BLOCKS * P],
                load: if LOAD { taken.load[k * BLOCKS..].first_chunk() } else { None },
                blocks: &self.buffers.blocks[list],
            };
            unblend::<S, FIRST, F, P, STATISTICS, LOAD>(simd, &self.tile(slot), &upstream, own.0, own_plain.0);
        }
    }

    /// Gaussians with a pair for which `of_pair` is not 0, ascending.
    pub(crate) fn gaussians_with(&self, of_pair: &[u16]) -> Vec<u32> {
        let bins = &self.buffers.bins;
        bins.entries.par_iter().filter(|entry| bins.any(entry, of_pair)).map(|entry| entry.gaussian).collect()
    }
}
