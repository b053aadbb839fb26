//! A render on this device, and how it is drawn and differentiated tile by tile.

use std::{
    ops::Range,
    sync::{Arc, Mutex},
};

use fearless_simd::Level;
use rayon::prelude::*;

use super::{
    backward::{Upstream, unblend},
    bins::Bins,
    forward::{Blend, Cuts, Tile, blend},
    lanes::{BLOCKS, Line, at_level},
    layout::{Layout, of_tile},
    maps::TileGradients,
    project::Found,
};
use crate::backend::{RenderOptions, ViewCamera};
use crate::losses::MapGradients;

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
    /// `[tile][block][F + 1]` features and opacity sum.
    pub(crate) planes: Vec<Line>,
    /// `[pairs]` blocks in which a pixel is covered.
    pub(crate) blocks: Vec<u16>,
    /// `[tile][block]` covered entries per pixel; empty without counts.
    pub(crate) load: Vec<Line>,
    /// `[pairs]` blocks in which a pixel is covered in the first half of its light; empty without counts.
    pub(crate) seen: Vec<u16>,
    /// Gradients of the maps, of this render or of an earlier one.
    pub(crate) gradients: MapGradients<f32>,
}

/// A render on the CPU: block-ordered maps of the drawn tiles, and what the gradient needs.
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

/// Cuts `slice` into the lists of all tiles.
fn by_list<'a, T>(bins: &Bins, mut slice: &'a mut [T]) -> Vec<&'a mut [T]> {
    let mut lists = Vec::with_capacity(bins.starts.len());
    for bounds in bins.starts.windows(2) {
        let count = if slice.is_empty() { 0 } else { (bounds[1] - bounds[0]) as usize };
        let (list, rest) = slice.split_at_mut(count);
        lists.push(list);
        slice = rest;
    }
    lists
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
            gaussians: &self.buffers.bins.gaussians[self.buffers.bins.list(slot)],
            drawn: &self.layout.drawn[slot],
            corner: (x as f32, y as f32),
            cuts: self.cuts,
        }
    }

    /// Blends all tiles.
    pub(crate) fn blend(&mut self, level: Level) {
        let (features, tiles) = (self.features(), self.layout.tiles.len());
        let stride = features.len() + 1;
        let pairs = self.buffers.bins.starts.last().map_or(0, |&end| end as usize);
        let counts = self.options.load || self.options.observe;
        let mut planes = std::mem::take(&mut self.buffers.planes);
        let mut blocks = std::mem::take(&mut self.buffers.blocks);
        let mut load = std::mem::take(&mut self.buffers.load);
        let mut seen = std::mem::take(&mut self.buffers.seen);
        planes.resize(tiles * BLOCKS * stride, Line::ZERO);
        blocks.resize(pairs, 0);
        load.clear();
        load.resize(if counts { tiles * BLOCKS } else { 0 }, Line::ZERO);
        seen.clear();
        seen.resize(if counts { pairs } else { 0 }, 0);
        let bins = &self.buffers.bins;
        let mut loads: Vec<&mut [Line]> = load.chunks_mut(BLOCKS).collect();
        loads.resize_with(tiles, Default::default);
        planes
            .par_chunks_mut(BLOCKS * stride)
            .zip(by_list(bins, &mut blocks))
            .zip(by_list(bins, &mut seen))
            .zip(loads)
            .enumerate()
            .for_each(|(slot, (((planes, blocks), seen), load))| {
                planes.fill(Line::ZERO);
                let tile = self.tile(slot);
                let mut out = Blend { planes, blocks, counts: counts.then_some((load, seen)) };
                at_level!(level, simd => match (features.start, features.end, counts) {
                    (0, COLORS, false) => blend::<_, 0, 3, false>(simd, &tile, &mut out),
                    (0, COLORS, true) => blend::<_, 0, 3, true>(simd, &tile, &mut out),
                    (COLORS, ..) => blend::<_, COLORS, 4, false>(simd, &tile, &mut out),
                    (_, _, false) => blend::<_, 0, 7, false>(simd, &tile, &mut out),
                    (_, _, true) => blend::<_, 0, 7, true>(simd, &tile, &mut out),
                });
            });
        self.buffers.planes = planes;
        self.buffers.blocks = blocks;
        self.buffers.load = load;
        self.buffers.seen = seen;
    }

    /// Walks all tiles back; `sums` and `plain` become `[pairs]` (`plain` only with a load).
    pub(crate) fn unblend(&self, level: Level, sums: &mut Vec<Line>, plain: &mut Vec<[f32; 2]>) {
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
        by_list(bins, sums).into_par_iter().zip(by_list(bins, plain)).enumerate().for_each(|(slot, (out, plain))| {
            let tile = self.tile(slot);
            let drawn = of_tile(&self.buffers.planes, slot, features.len() + 1);
            let blocks = &self.buffers.blocks[bins.list(slot)];
            let mut taken = TileGradients::ZERO;
            at_level!(level, simd => {
                taken.take(self, slot, drawn);
                let upstream = Upstream { planes: &taken.planes, load: load.then_some(&taken.load), blocks };
                match (features.start, features.end, statistics, load) {
                    (0, COLORS, false, false) => unblend::<_, 0, 3, 5, false, false>(simd, &tile, &upstream, out, plain),
                    (0, COLORS, true, false) => unblend::<_, 0, 3, 5, true, false>(simd, &tile, &upstream, out, plain),
                    (0, COLORS, _, true) => unblend::<_, 0, 3, 5, true, true>(simd, &tile, &upstream, out, plain),
                    (COLORS, ..) => unblend::<_, COLORS, 4, 6, false, false>(simd, &tile, &upstream, out, plain),
                    (_, _, false, false) => unblend::<_, 0, 7, 9, false, false>(simd, &tile, &upstream, out, plain),
                    (_, _, true, false) => unblend::<_, 0, 7, 9, true, false>(simd, &tile, &upstream, out, plain),
                    (_, _, _, true) => unblend::<_, 0, 7, 9, true, true>(simd, &tile, &upstream, out, plain),
                }
            });
        });
    }

    /// Gaussians with a pair for which `of_pair` is not 0, ascending.
    pub(crate) fn gaussians_with(&self, of_pair: &[u16]) -> Vec<u32> {
        let bins = &self.buffers.bins;
        bins.entries.par_iter().filter(|entry| bins.any(entry, of_pair)).map(|entry| entry.gaussian).collect()
    }
}
