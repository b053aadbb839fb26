//! A render on this device, and how it is drawn and differentiated tile by tile.

use std::sync::{Arc, Mutex, atomic::Ordering::Relaxed};

use fearless_simd::Level;
use rayon::prelude::*;

use super::{
    backward::{LEADING_PLANES, Upstream, unblend},
    bins::Bins,
    forward::{Blend, Cuts, Tile, blend},
    lanes::{BLOCKS, Line, at_level},
    layout::Layout,
    project::Found,
};
use crate::backend::{RenderOptions, ViewCamera};

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
    /// `[tile][block][F + 2]` upstream gradients; empty where there are none.
    pub(crate) upstream: Vec<Line>,
    /// `[tile][block]` gradient of the load; empty where there is none.
    pub(crate) load_gradient: Vec<Line>,
}

/// A render on the CPU: block-ordered maps of the drawn tiles, and what the gradient needs.
#[derive(Debug)]
pub struct CpuRender {
    pub(crate) options: RenderOptions,
    pub(crate) camera: ViewCamera,
    pub(crate) layout: Arc<Layout>,
    pub(crate) cuts: Cuts,
    pub(crate) buffers: Buffers,
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

impl CpuRender {
    /// Features per pixel.
    pub(crate) fn features(&self) -> usize {
        if self.options.planes { 7 } else { 3 }
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
        let pairs = self.buffers.bins.starts.last().map_or(0, |&end| end as usize);
        let counts = self.options.load || self.options.observe;
        let mut planes = std::mem::take(&mut self.buffers.planes);
        let mut blocks = std::mem::take(&mut self.buffers.blocks);
        let mut load = std::mem::take(&mut self.buffers.load);
        let mut seen = std::mem::take(&mut self.buffers.seen);
        planes.resize(tiles * BLOCKS * (features + 1), Line::ZERO);
        blocks.resize(pairs, 0);
        load.clear();
        load.resize(if counts { tiles * BLOCKS } else { 0 }, Line::ZERO);
        seen.clear();
        seen.resize(if counts { pairs } else { 0 }, 0);
        let bins = &self.buffers.bins;
        let mut loads: Vec<&mut [Line]> = load.chunks_mut(BLOCKS).collect();
        loads.resize_with(tiles, Default::default);
        planes
            .par_chunks_mut(BLOCKS * (features + 1))
            .zip(by_list(bins, &mut blocks))
            .zip(by_list(bins, &mut seen))
            .zip(loads)
            .enumerate()
            .for_each(|(slot, (((planes, blocks), seen), load))| {
                planes.fill(Line::ZERO);
                let tile = self.tile(slot);
                let mut out = Blend { planes, blocks, counts: counts.then_some((load, seen)) };
                at_level!(level, simd => match (features, counts) {
                    (3, false) => blend::<_, 3, false>(simd, &tile, &mut out),
                    (3, true) => blend::<_, 3, true>(simd, &tile, &mut out),
                    (_, false) => blend::<_, 7, false>(simd, &tile, &mut out),
                    (_, true) => blend::<_, 7, true>(simd, &tile, &mut out),
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
        let (load, statistics) = (!self.buffers.load_gradient.is_empty(), self.options.statistics);
        let pairs = self.buffers.blocks.len();
        sums.resize(pairs, Line::ZERO);
        plain.resize(if load { pairs } else { 0 }, [0.0; 2]);
        if self.buffers.upstream.is_empty() {
            sums.fill(Line::ZERO);
            return;
        }
        let stride = BLOCKS * (LEADING_PLANES + self.features());
        by_list(bins, sums).into_par_iter().zip(by_list(bins, plain)).enumerate().for_each(|(slot, (out, plain))| {
            let tile = self.tile(slot);
            let upstream = Upstream {
                planes: &self.buffers.upstream[slot * stride..(slot + 1) * stride],
                load: load.then(|| &self.buffers.load_gradient[slot * BLOCKS..(slot + 1) * BLOCKS]),
                blocks: &self.buffers.blocks[bins.list(slot)],
            };
            at_level!(level, simd => match (self.options.planes, statistics, load) {
                (false, false, false) => unblend::<_, 3, 5, false, false>(simd, &tile, &upstream, out, plain),
                (false, true, false) => unblend::<_, 3, 5, true, false>(simd, &tile, &upstream, out, plain),
                (false, _, true) => unblend::<_, 3, 5, true, true>(simd, &tile, &upstream, out, plain),
                (true, false, false) => unblend::<_, 7, 9, false, false>(simd, &tile, &upstream, out, plain),
                (true, true, false) => unblend::<_, 7, 9, true, false>(simd, &tile, &upstream, out, plain),
                (true, _, true) => unblend::<_, 7, 9, true, true>(simd, &tile, &upstream, out, plain),
            });
        });
    }

    /// Gaussians with a pair for which `of_pair` is not 0, ascending.
    pub(crate) fn gaussians_with(&self, of_pair: &[u16]) -> Vec<u32> {
        let bins = &self.buffers.bins;
        bins.entries
            .par_iter()
            .filter(|entry| {
                let places = &bins.places[entry.first as usize..(entry.first + entry.count) as usize];
                places.iter().any(|place| of_pair[place.load(Relaxed) as usize] != 0)
            })
            .map(|entry| entry.gaussian)
            .collect()
    }
}
