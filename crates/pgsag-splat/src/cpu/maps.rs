//! Between block order, in which tiles are drawn, and rows, in which losses and readers think.

use std::ops::Range;

use super::{
    backward::LEADING_PLANES,
    bins::Bins,
    lanes::{BLOCK, BLOCKS, Line, TILE},
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

/// What is drawn of a part before it is written, while it is in cache.
#[derive(Default)]
pub(crate) struct Drawing {
    /// `[tile][block][F + 1]` features and opacity.
    pub(crate) planes: Vec<Line>,
    /// `[tile][block]`, or empty.
    pub(crate) load: Vec<Line>,
}

impl Drawing {
    /// Empty, for so many tiles with `stride` planes.
    #[inline(always)]
    pub(crate) fn clear(&mut self, tiles: usize, stride: usize, load: bool) {
        self.planes.clear();
        self.planes.resize(tiles * BLOCKS * stride, Line::ZERO);
        self.load.clear();
        self.load.resize(if load { tiles * BLOCKS } else { 0 }, Line::ZERO);
    }
}

/// Some tiles beside one another, and what is written for them.
pub(crate) struct Part<'a> {
    /// Drawn tiles.
    pub(crate) slots: Range<usize>,
    /// Its rows in every map, map by map.
    rows: Vec<&'a mut [f32]>,
    /// `[pairs]`
    pub(crate) blocks: &'a mut [u16],
    /// `[pairs]`, or empty.
    pub(crate) seen: &'a mut [u16],
}

impl<'a> Part<'a> {
    /// Cuts `maps`, and `blocks` and `seen` of all pairs, into parts that have drawn tiles.
    pub(crate) fn all(
        (layout, bins): (&Layout, &Bins),
        maps: Vec<&'a mut [f32]>,
        [mut blocks, mut seen]: [&'a mut [u16]; 2],
    ) -> Vec<Self> {
        let across = layout.columns.div_ceil(PART) as usize;
        let mut parts = Vec::with_capacity(across * layout.rows as usize);
        for slots in slots_of_parts(layout, PART) {
            let pairs = (bins.starts[slots.end] - bins.starts[slots.start]) as usize;
            let (own, own_seen) = (blocks.split_at_mut(pairs), seen.split_at_mut(pairs.min(seen.len())));
            (blocks, seen) = (own.1, own_seen.1);
            let rows = Vec::with_capacity(maps.len() * TILE);
            parts.push(Part { slots, rows, blocks: own.0, seen: own_seen.0 });
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

    /// Writes the planes to the first maps of `maps`, and the load to the last where there is one more. A row of all tiles at
    /// a time, so that memory is written in order. Inlined into vector code.
    #[inline(always)]
    pub(crate) fn put(&mut self, layout: &Layout, maps: usize, drawing: &Drawing) {
        let height = self.rows.len() / maps;
        let stride = drawing.planes.len() / (self.slots.len() * BLOCKS);
        for (plane, rows) in self.rows.chunks_exact_mut(height).enumerate() {
            let (lines, stride, plane) =
                if plane < stride { (&drawing.planes, stride, plane) } else { (&drawing.load, 1, 0) };
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
    /// One row of rests.
    rests: Vec<f32>,
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
        let rows = &render.buffers.rows;
        let mut terms: [(&[f32], &[f32]); FEATURES_MAX + 1] = [(&[], &[]); FEATURES_MAX + 1];
        terms[0] = (&gradients.opacity, rows.map(&features, OPACITY));
        tiles.take(&mut self.planes, (stride, 1), &gradients.opacity);
        for (plane, at) in features.clone().enumerate() {
            terms[1 + plane] = (maps[at], rows.map(&features, at));
            tiles.take(&mut self.planes, (stride, LEADING_PLANES + plane), maps[at]);
        }
        tiles.take_rests(&mut self.planes, stride, &terms, &mut self.rests);
        if !gradients.load.is_empty() {
            tiles.take(&mut self.load, (1, 0), &gradients.load);
        }
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
        self.clear_border(lines, (stride, plane), map.is_empty());
        for (y, row) in
            map.chunks_exact(self.layout.width as usize).skip(self.columns_and_top().1).take(TILE).enumerate()
        {
            self.take_row(lines, (stride, plane), y, row);
        }
    }

    /// The first plane of every block: Σ ĝ C over opacity and features, from their maps of ĝ (may be empty: 0) and C.
    #[inline(always)]
    fn take_rests(&self, lines: &mut [Line], stride: usize, terms: &[(&[f32], &[f32])], rests: &mut Vec<f32>) {
        self.clear_border(lines, (stride, 0), false);
        let (columns, top) = self.columns_and_top();
        let width = self.layout.width as usize;
        rests.resize(width, 0.0);
        for y in 0..TILE.min(self.layout.height as usize - top) {
            let own = (top + y) * width + columns.start..(top + y) * width + columns.end;
            rests[columns.clone()].fill(0.0);
            for (gradient, value) in terms.iter().filter(|(gradient, _)| !gradient.is_empty()) {
                let products = gradient[own.clone()].iter().zip(&value[own.clone()]);
                rests[columns.clone()].iter_mut().zip(products).for_each(|(rest, (g, c))| *rest += g * c);
            }
            self.take_row(lines, (stride, 0), y, rests);
        }
    }

    /// Pixels from the first tile's left to the last one's right, and the tiles' top.
    #[inline(always)]
    fn columns_and_top(&self) -> (Range<usize>, usize) {
        let (left, top) = self.layout.corner(self.tiles[0]);
        let (right, _) = self.layout.corner(self.tiles[self.tiles.len() - 1]);
        (left as usize..(right as usize + TILE).min(self.layout.width as usize), top as usize)
    }

    /// Sets a plane to 0 where rows will not fill it.
    #[inline(always)]
    fn clear_border(&self, lines: &mut [Line], (stride, plane): (usize, usize), is_empty: bool) {
        let (columns, top) = self.columns_and_top();
        if is_empty || columns.len() % TILE != 0 || top + TILE > self.layout.height as usize {
            lines.iter_mut().skip(plane).step_by(stride).for_each(|line| *line = Line::ZERO);
        }
    }

    /// Copies row `y` of the tiles from a whole row of pixels.
    #[inline(always)]
    fn take_row(&self, lines: &mut [Line], (stride, plane): (usize, usize), y: usize, row: &[f32]) {
        for (&tile, lines) in self.tiles.iter().zip(lines.chunks_exact_mut(BLOCKS * stride)) {
            let x = self.layout.corner(tile).0 as usize;
            for (column, from) in row[x..row.len().min(x + TILE)].chunks(BLOCK).enumerate() {
                let (block, lane) = place(column * BLOCK, y);
                copy_run(&mut lines[block * stride + plane].0[lane..lane + BLOCK], from);
            }
        }
    }
}
