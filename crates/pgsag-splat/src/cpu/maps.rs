//! Between block order, in which tiles are drawn, and rows, in which losses and readers think.

use fearless_simd::Level;
use rayon::prelude::*;

use super::{
    backward::LEADING_PLANES,
    lanes::{BLOCK, BLOCKS, LANES, Line, TILE, at_level},
    layout::{Layout, of_tile, place},
    render::CpuRender,
};
use crate::losses::{MapGradients, RenderedMaps};

/// Row-major maps of a render, one per channel, 0 where nothing is drawn. Reused from step to step.
#[derive(Debug, Default)]
pub(crate) struct Rows {
    pub(crate) color: [Vec<f32>; 3],
    pub(crate) normal: [Vec<f32>; 3],
    pub(crate) distance: Vec<f32>,
    pub(crate) opacity: Vec<f32>,
    pub(crate) load: Vec<f32>,
}

impl Rows {
    /// Reads a render.
    pub(crate) fn fill(&mut self, render: &CpuRender) {
        let planes = render.options.planes;
        let stride = render.features() + 1;
        let Self { color: [r, g, b], normal: [x, y, z], distance, opacity, load } = self;
        let maps = if planes {
            vec![r, g, b, x, y, z, distance, opacity]
        } else {
            [x, y, z, distance].into_iter().for_each(|map| map.clear());
            vec![r, g, b, opacity]
        };
        rows(&render.layout, &render.buffers.planes, stride, maps);
        match render.options.load {
            true => rows(&render.layout, &render.buffers.load, 1, vec![load]),
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
/// are not drawn are 0 there.
fn rows(layout: &Layout, lines: &[Line], stride: usize, maps: Vec<&mut Vec<f32>>) {
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
        if end - first < layout.columns as usize {
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

/// Takes the gradients of the losses into block order, with the rest Σ ĝ C of every pixel. Gradients at pixels that are
/// not drawn are copied too, and reach nothing: no light passes there.
pub(crate) fn take_gradients(level: Level, render: &mut CpuRender, gradients: &MapGradients<f32>) {
    let features = render.features();
    let stride = LEADING_PLANES + features;
    let [r, g, b] = &gradients.color;
    let [x, y, z] = &gradients.normal;
    let maps = [&gradients.opacity, r, g, b, x, y, z, &gradients.distance];
    let maps = &maps[..=features];
    let none = maps.iter().all(|map| map.is_empty());
    let tiles = render.layout.tiles.len();
    let load = !gradients.load.is_empty();
    render.buffers.load_gradient.resize(if load { tiles * BLOCKS } else { 0 }, Line::ZERO);
    render.buffers.upstream.resize(if none && !load { 0 } else { tiles * BLOCKS * stride }, Line::ZERO);
    let (layout, drawn) = (&render.layout, &render.buffers.planes);
    render.buffers.upstream.par_chunks_mut(BLOCKS * stride).enumerate().for_each(|(slot, out)| {
        let drawn = of_tile(drawn, slot, features + 1);
        at_level!(level, _simd => {
            for (plane, map) in maps.iter().enumerate() {
                put(layout, slot, out, (stride, plane + 1), map);
            }
            rests(out, drawn, features)
        });
    });
    render.buffers.load_gradient.par_chunks_mut(BLOCKS).enumerate().for_each(|(slot, out)| {
        put(layout, slot, out, (1, 0), &gradients.load);
    });
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
