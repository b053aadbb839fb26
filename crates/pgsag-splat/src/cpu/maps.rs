//! Between block order, in which tiles are drawn, and rows, in which losses and readers think.

use std::ops::Range;

use super::{
    backward::LEADING_PLANES,
    bins::Bins,
    lanes::{BLOCK, BLOCKS, LANES, Line, TILE},
    layout::{Layout, place},
    render::{CpuRender, FEATURES_MAX},
};
use crate::losses::RenderedMaps;

/// Row-major maps of a render: three of colour, three of the normal, distance, opacity, load. Those of what is not drawn may
/// hold anything. Reused from render to render: only the load is 0 where nothing is drawn, other maps are where they are
/// new, and losses look at drawn pixels alone.
#[derive(Debug, Default)]
pub(crate) struct Rows([Vec<f32>; FEATURES_MAX + 2]);

/// Place of the opacity.
const OPACITY: usize = FEATURES_MAX;
/// Place of the load.
const LOAD: usize = FEATURES_MAX + 1;

impl Rows {
    /// Maps for the features and the opacity, and with `load` for that, in the order in which tiles hold them.
    pub(crate) fn drawn(&mut self, layout: &Layout, features: &Range<usize>, load: bool) -> Vec<&mut [f32]> {
        let pixels = (layout.width * layout.height) as usize;
        let mut maps = Vec::with_capacity(FEATURES_MAX + 2);
        for (at, map) in self.0.iter_mut().enumerate() {
            if features.contains(&at) || at == OPACITY || (at == LOAD && load) {
                map.resize(pixels, 0.0);
                maps.push(&mut map[..]);
            }
        }
        if let Some(map) = maps.last_mut().filter(|_| load) {
            map.fill(0.0);
        }
        maps
    }

    /// One map of those that were drawn.
    fn map(&self, features: &Range<usize>, at: usize) -> &[f32] {
        if at >= OPACITY || features.contains(&at) { &self.0[at] } else { &[] }
    }

    /// As the losses want them; empty where `features` (and with `load` the load) were not drawn.
    pub(crate) fn maps(&self, features: &Range<usize>, load: bool) -> RenderedMaps<'_, f32> {
        let map = |at: usize| self.map(features, at);
        RenderedMaps {
            color: [map(0), map(1), map(2)],
            normal: [map(3), map(4), map(5)],
            distance: map(6),
            opacity: map(OPACITY),
            load: if load { map(LOAD) } else { &[] },
        }
    }
}

/// Tiles of a part across, at least: few enough for what is drawn of them to be in cache still when it is written.
pub(crate) const PART: u32 = 8;
/// Parts for each thread at least, so that no thread is left with much at the end.
const PARTS_PER_THREAD: u32 = 12;

/// Tiles of a part across where it is read: a whole row of tiles, whose pixels lie in one run of memory, where there are
/// rows enough.
pub(crate) fn part_read(layout: &Layout) -> u32 {
    let wanted = rayon::current_num_threads() as u32 * PARTS_PER_THREAD;
    layout.columns.div_ceil(wanted.div_ceil(layout.rows.max(1)).max(1)).max(PART)
}

/// Slots of the drawn tiles of every part, of a width in tiles; row by row.
pub(crate) fn slots_of_parts(layout: &Layout, width: u32) -> Vec<Range<usize>> {
    let before = |tile: u32| layout.tiles.partition_point(|&drawn| drawn < tile);
    let mut slots = Vec::new();
    for row in 0..layout.rows {
        for part in 1..=layout.columns.div_ceil(width) {
            let start = slots.last().map_or(0, |last: &Range<usize>| last.end);
            slots.push(start..before(row * layout.columns + (part * width).min(layout.columns)));
        }
    }
    slots
}

/// Some tiles beside one another, and what is written for them.
pub(crate) struct Part<'a> {
    /// Drawn tiles.
    pub(crate) slots: Range<usize>,
    /// `[tile][block][F + 1]`
    pub(crate) planes: &'a mut [Line],
    /// Its rows in every map, map by map.
    rows: Vec<&'a mut [f32]>,
    /// `[pairs]`
    pub(crate) blocks: &'a mut [u16],
    /// `[pairs]`, or empty.
    pub(crate) seen: &'a mut [u16],
}

impl<'a> Part<'a> {
    /// Cuts `maps`, `planes` of all tiles (`stride` lines a block), and `blocks` and `seen` of all pairs, into parts that have
    /// drawn tiles.
    pub(crate) fn all(
        (layout, bins): (&Layout, &Bins),
        maps: Vec<&'a mut [f32]>,
        (mut planes, stride): (&'a mut [Line], usize),
        [mut blocks, mut seen]: [&'a mut [u16]; 2],
    ) -> Vec<Self> {
        let across = layout.columns.div_ceil(PART) as usize;
        let mut parts = Vec::with_capacity(across * layout.rows as usize);
        for slots in slots_of_parts(layout, PART) {
            let pairs = (bins.starts[slots.end] - bins.starts[slots.start]) as usize;
            let (own_planes, own) = (planes.split_at_mut(slots.len() * BLOCKS * stride), blocks.split_at_mut(pairs));
            let own_seen = seen.split_at_mut(pairs.min(seen.len()));
            (planes, blocks, seen) = (own_planes.1, own.1, own_seen.1);
            let rows = Vec::with_capacity(maps.len() * TILE);
            parts.push(Part { slots, planes: own_planes.0, rows, blocks: own.0, seen: own_seen.0 });
        }
        for map in maps {
            for (y, row) in map.chunks_exact_mut(layout.width as usize).enumerate() {
                let parts = &mut parts[y / TILE * across..];
                row.chunks_mut(PART as usize * TILE).zip(parts).for_each(|(row, part)| part.rows.push(row));
            }
        }
        parts.retain(|part| !part.slots.is_empty());
        parts
    }

    /// Writes its planes to the first maps of `maps`, and `load` (`[tile][block]`) to the last where there is one more. A row of
    /// all tiles at a time, so that memory is written in order. Inlined into vector code.
    #[inline(always)]
    pub(crate) fn put(&mut self, layout: &Layout, maps: usize, load: &[Line]) {
        let height = self.rows.len() / maps;
        let stride = self.planes.len() / (self.slots.len() * BLOCKS);
        for (plane, rows) in self.rows.chunks_exact_mut(height).enumerate() {
            let (lines, stride, plane) = if plane < stride { (&*self.planes, stride, plane) } else { (load, 1, 0) };
            for (y, row) in rows.iter_mut().enumerate() {
                for (lines, slot) in lines.chunks_exact(BLOCKS * stride).zip(self.slots.clone()) {
                    let x = (layout.tiles[slot] % layout.columns % PART) as usize * TILE;
                    let end = row.len().min(x + TILE);
                    for (column, to) in row[x..end].chunks_mut(BLOCK).enumerate() {
                        let (block, lane) = place(column * BLOCK, y);
                        copy_run(to, &lines[block * stride + plane].0[lane..lane + BLOCK]);
                    }
                }
            }
        }
    }
}

/// Copies a run of four, or the shorter one at the right border.
#[inline(always)]
fn copy_run(to: &mut [f32], from: &[f32]) {
    match (to.first_chunk_mut::<BLOCK>(), from.first_chunk::<BLOCK>()) {
        (Some(to), Some(from)) => *to = *from,
        _ => to.iter_mut().zip(from).for_each(|(to, from)| *to = *from),
    }
}

/// Upstream gradients of a part in block order, with the rest Σ ĝ C of every pixel. Gradients at pixels that are not
/// drawn are copied too, and reach nothing: no light passes there.
#[derive(Debug, Default)]
pub(crate) struct PartGradients {
    /// `[tiles * BLOCKS * (LEADING_PLANES + F)]`: rest, opacity sum, features.
    pub(crate) planes: Vec<Line>,
    /// `[tiles * BLOCKS]`
    pub(crate) load: Vec<Line>,
}

impl PartGradients {
    /// Of the tiles in `slots`, which lie in one row. Inlined into vector code.
    #[inline(always)]
    pub(crate) fn take(&mut self, render: &CpuRender, slots: &Range<usize>) {
        let (layout, gradients) = (&render.layout, &render.buffers.gradients);
        let features = render.features();
        let stride = LEADING_PLANES + features.len();
        let [r, g, b] = &gradients.color;
        let [x, y, z] = &gradients.normal;
        let maps = [r, g, b, x, y, z, &gradients.distance];
        self.planes.resize(slots.len() * BLOCKS * stride, Line::ZERO);
        self.load.resize(slots.len() * BLOCKS, Line::ZERO);
        let tiles = Tiles { layout, tiles: &layout.tiles[slots.clone()] };
        tiles.take(&mut self.planes, (stride, 1), &gradients.opacity);
        for (plane, at) in features.clone().enumerate() {
            tiles.take(&mut self.planes, (stride, LEADING_PLANES + plane), maps[at]);
        }
        if !gradients.load.is_empty() {
            tiles.take(&mut self.load, (1, 0), &gradients.load);
        }
        let drawn = (features.len() + 1) * BLOCKS;
        rests(&mut self.planes, &render.buffers.planes[slots.start * drawn..slots.end * drawn], features.len());
    }
}

/// The first plane of every block: Σ ĝ C over the features and the opacity.
#[inline(always)]
fn rests(out: &mut [Line], drawn: &[Line], features: usize) {
    for (gradients, drawn) in out.chunks_exact_mut(LEADING_PLANES + features).zip(drawn.chunks_exact(features + 1)) {
        let mut rest = [0.0; LANES];
        for plane in 0..=features {
            // The opacity is the last plane that is drawn and the first that has a gradient.
            let value = if plane == 0 { &drawn[features] } else { &drawn[plane - 1] };
            for lane in 0..LANES {
                rest[lane] += gradients[plane + 1].0[lane] * value.0[lane];
            }
        }
        gradients[0] = Line(rest);
    }
}

/// Tiles of one row.
struct Tiles<'a> {
    layout: &'a Layout,
    tiles: &'a [u32],
}

impl Tiles<'_> {
    /// Copies one row-major map into one plane of each tile with `stride` lines a block; an empty map is 0.
    #[inline(always)]
    fn take(&self, lines: &mut [Line], (stride, plane): (usize, usize), map: &[f32]) {
        let (width, height) = (self.layout.width as usize, self.layout.height as usize);
        let (_, top) = self.layout.corner(self.tiles[0]);
        let (right, _) = self.layout.corner(self.tiles[self.tiles.len() - 1]);
        if map.is_empty() || right as usize + TILE > width || top as usize + TILE > height {
            lines.iter_mut().skip(plane).step_by(stride).for_each(|line| *line = Line::ZERO);
        }
        for (y, row) in map.chunks_exact(width).skip(top as usize).take(TILE).enumerate() {
            for (&tile, lines) in self.tiles.iter().zip(lines.chunks_exact_mut(BLOCKS * stride)) {
                let x = self.layout.corner(tile).0 as usize;
                for (column, from) in row[x..width.min(x + TILE)].chunks(BLOCK).enumerate() {
                    let (block, lane) = place(column * BLOCK, y);
                    copy_run(&mut lines[block * stride + plane].0[lane..lane + BLOCK], from);
                }
            }
        }
    }
}
