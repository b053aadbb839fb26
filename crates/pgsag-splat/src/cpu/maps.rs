//! Between block order, in which tiles are drawn, and rows, in which losses and readers think.

use rayon::prelude::*;

use super::{
    backward::LEADING_PLANES,
    lanes::{BLOCK, BLOCKS, LANES, Line, TILE},
    layout::{Layout, of_tile, place},
    render::{CpuRender, FEATURES_MAX},
};
use crate::losses::RenderedMaps;

/// Row-major maps of a render, one per channel. Reused from step to step: only the load is 0 where nothing is drawn, other
/// maps are where they are new, and losses look at drawn pixels alone.
#[derive(Debug, Default)]
pub(crate) struct Rows {
    pub(crate) color: [Vec<f32>; 3],
    pub(crate) normal: [Vec<f32>; 3],
    pub(crate) distance: Vec<f32>,
    pub(crate) opacity: Vec<f32>,
    pub(crate) load: Vec<f32>,
}

impl Rows {
    /// Reads a render. Maps of what it does not draw are empty.
    pub(crate) fn fill(&mut self, render: &CpuRender) {
        let features = render.features();
        let stride = features.len() + 1;
        let Self { color: [r, g, b], normal: [x, y, z], distance, opacity, load } = self;
        let mut maps = Vec::with_capacity(FEATURES_MAX + 1);
        for (feature, map) in [r, g, b, x, y, z, distance].into_iter().enumerate() {
            if features.contains(&feature) {
                maps.push(map);
            } else {
                map.clear();
            }
        }
        maps.push(opacity);
        rows(&render.layout, &render.buffers.planes, stride, maps, false);
        match render.options.load {
            true => rows(&render.layout, &render.buffers.load, 1, vec![load], true),
            false => load.clear(),
        }
    }

    /// As the losses want them.
    pub(crate) fn maps(&self) -> RenderedMaps<'_, f32> {
        RenderedMaps {
            color: self.color.each_ref().map(|map| &map[..]),
            normal: self.normal.each_ref().map(|map| &map[..]),
            distance: &self.distance,
            opacity: &self.opacity,
            load: &self.load,
        }
    }
}

/// Fills row-major maps from the planes of a block-ordered one, `stride` of them to a block. Pixels of drawn tiles that
/// are not drawn are 0 there. Other tiles become 0 with `whole`, else keep what an earlier render left (0 in new maps).
fn rows(layout: &Layout, lines: &[Line], stride: usize, maps: Vec<&mut Vec<f32>>, whole: bool) {
    let (width, height) = (layout.width as usize, layout.height as usize);
    let mut bands: Vec<Vec<&mut [f32]>> = Vec::new();
    bands.resize_with(height.div_ceil(TILE), Vec::new);
    for map in maps {
        map.resize(width * height, 0.0);
        bands.iter_mut().zip(map.chunks_mut(TILE * width)).for_each(|(bands, band)| bands.push(band));
    }
    bands.into_par_iter().enumerate().for_each(|(row, mut band)| {
        let first = layout.tiles.partition_point(|&tile| tile < row as u32 * layout.columns);
        let end = layout.tiles.partition_point(|&tile| tile < (row as u32 + 1) * layout.columns);
        if whole && end - first < layout.columns as usize {
            band.iter_mut().for_each(|band| band.fill(0.0));
        }
        for slot in first..end {
            let lines = of_tile(lines, slot, stride);
            let x = layout.corner(layout.tiles[slot]).0 as usize;
            for (plane, band) in band.iter_mut().enumerate() {
                for (y, row) in band.chunks_exact_mut(width).enumerate() {
                    let to = &mut row[x..(x + TILE).min(width)];
                    for (column, to) in to.chunks_mut(BLOCK).enumerate() {
                        let (block, lane) = place(column * BLOCK, y);
                        copy_run(to, &lines[block * stride + plane].0[lane..lane + BLOCK]);
                    }
                }
            }
        }
    });
}

/// Copies a run of four, or the shorter one at the right border.
#[inline(always)]
fn copy_run(to: &mut [f32], from: &[f32]) {
    match (to.first_chunk_mut::<BLOCK>(), from.first_chunk::<BLOCK>()) {
        (Some(to), Some(from)) => *to = *from,
        _ => to.iter_mut().zip(from).for_each(|(to, from)| *to = *from),
    }
}

/// Upstream gradients of one tile in block order, with the rest Σ ĝ C of every pixel. Gradients at pixels that are not
/// drawn are copied too, and reach nothing: no light passes there.
pub(crate) struct TileGradients {
    /// `[BLOCKS * (LEADING_PLANES + F)]`: rest, opacity sum, features.
    pub(crate) planes: [Line; BLOCKS * (LEADING_PLANES + FEATURES_MAX)],
    /// `[BLOCKS]`
    pub(crate) load: [Line; BLOCKS],
}

impl TileGradients {
    /// All 0.
    pub(crate) const ZERO: Self =
        Self { planes: [Line::ZERO; BLOCKS * (LEADING_PLANES + FEATURES_MAX)], load: [Line::ZERO; BLOCKS] };

    /// Of the tile in `slot`, whose drawn planes are `drawn`. Inlined into vector code.
    #[inline(always)]
    pub(crate) fn take(&mut self, render: &CpuRender, slot: usize, drawn: &[Line]) {
        let (layout, gradients) = (&render.layout, &render.buffers.gradients);
        let features = render.features();
        let stride = LEADING_PLANES + features.len();
        let [r, g, b] = &gradients.color;
        let [x, y, z] = &gradients.normal;
        let maps = [r, g, b, x, y, z, &gradients.distance];
        let out = &mut self.planes[..BLOCKS * stride];
        put(layout, slot, out, (stride, 1), &gradients.opacity);
        for (plane, map) in maps[features.clone()].iter().enumerate() {
            put(layout, slot, out, (stride, LEADING_PLANES + plane), map);
        }
        rests(out, drawn, features.len());
        if !gradients.load.is_empty() {
            put(layout, slot, &mut self.load, (1, 0), &gradients.load);
        }
    }
}

/// The first plane of every block of a tile: Σ ĝ C over the features and the opacity.
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

/// Copies one row-major map into one plane of a tile with `stride` lines a block; an empty map is 0.
#[inline(always)]
fn put(layout: &Layout, slot: usize, lines: &mut [Line], (stride, plane): (usize, usize), map: &[f32]) {
    let (x, y) = layout.corner(layout.tiles[slot]);
    let width = layout.width as usize;
    let inside = x as usize + TILE <= width && y as usize + TILE <= layout.height as usize;
    if map.is_empty() || !inside {
        lines.iter_mut().skip(plane).step_by(stride).for_each(|line| *line = Line::ZERO);
    }
    if map.is_empty() {
        return;
    }
    for (y, row) in map[y as usize * width..].chunks_exact(width).take(TILE).enumerate() {
        let from = &row[x as usize..(x as usize + TILE).min(width)];
        for (column, from) in from.chunks(BLOCK).enumerate() {
            let (block, lane) = place(column * BLOCK, y);
            copy_run(&mut lines[block * stride + plane].0[lane..lane + BLOCK], from);
        }
    }
}
