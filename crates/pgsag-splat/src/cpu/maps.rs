//! Between block order, in which tiles are drawn, and rows, in which losses and readers think.

use rayon::prelude::*;

use super::{
    backward::LEADING_PLANES,
    lanes::{BLOCK, BLOCKS, LANES, Line, TILE},
    layout::{Layout, of_tile},
    render::CpuRender,
};
use crate::losses::{MapGradients, RenderedMaps};

/// Row-major maps of a render, 0 where nothing is drawn. Reused from step to step.
#[derive(Debug, Default)]
pub(crate) struct Rows {
    pub(crate) color: Vec<[f32; 3]>,
    pub(crate) normal: Vec<[f32; 3]>,
    pub(crate) distance: Vec<f32>,
    pub(crate) opacity: Vec<f32>,
    pub(crate) load: Vec<f32>,
}

impl Rows {
    /// Reads a render.
    pub(crate) fn fill(&mut self, render: &CpuRender) {
        let planes = render.options.planes;
        let stride = render.features() + 1;
        let drawn = |plane: usize| Source { lines: &render.buffers.planes, stride, plane };
        let load = Source { lines: &render.buffers.load, stride: 1, plane: 0 };
        rows(&render.layout, Some(drawn(0)), &mut self.color, |rgb: [f32; 3]| rgb);
        rows(&render.layout, planes.then(|| drawn(3)), &mut self.normal, |normal: [f32; 3]| normal);
        rows(&render.layout, planes.then(|| drawn(6)), &mut self.distance, |[distance]: [f32; 1]| distance);
        rows(&render.layout, Some(drawn(stride - 1)), &mut self.opacity, |[opacity]: [f32; 1]| opacity);
        rows(&render.layout, render.options.load.then_some(load), &mut self.load, |[load]: [f32; 1]| load);
    }

    /// As the losses want them.
    pub(crate) fn maps(&self) -> RenderedMaps<'_, f32> {
        RenderedMaps {
            color: &self.color,
            normal: &self.normal,
            distance: &self.distance,
            opacity: &self.opacity,
            load: &self.load,
        }
    }
}

/// Planes of a block-ordered map: `stride` lines to a block, those from `plane` on are meant.
#[derive(Clone, Copy)]
struct Source<'a> {
    lines: &'a [Line],
    stride: usize,
    plane: usize,
}

/// Fills one map from `N` planes; empties it if there is no source.
fn rows<T: Copy + Default + Send, const N: usize>(
    layout: &Layout,
    source: Option<Source<'_>>,
    map: &mut Vec<T>,
    make: impl Fn([f32; N]) -> T + Sync,
) {
    let (width, height) = (layout.width as usize, layout.height as usize);
    let Some(source) = source else { return map.clear() };
    map.resize(width * height, T::default());
    map.par_chunks_mut(TILE * width).enumerate().for_each(|(row, band)| {
        let first = layout.tiles.partition_point(|&tile| tile < row as u32 * layout.columns);
        let end = layout.tiles.partition_point(|&tile| tile < (row as u32 + 1) * layout.columns);
        band.fill(T::default());
        for slot in first..end {
            let lines = of_tile(source.lines, slot, source.stride);
            layout.each_run(slot, |pixel, block, lane, bits| {
                let from = &lines[block * source.stride + source.plane..][..N];
                let to = &mut band[pixel - row * TILE * width..];
                for (i, to) in to.iter_mut().take(BLOCK).enumerate() {
                    if bits >> i & 1 != 0 {
                        *to = make(std::array::from_fn(|k| from[k].0[lane + i]));
                    }
                }
            });
        }
    });
}

/// Takes the gradients of the losses into block order, with the rest Σ ĝ C of every pixel.
pub(crate) fn take_gradients(render: &mut CpuRender, gradients: &MapGradients<f32>) {
    let features = render.features();
    let (stride, planes) = (LEADING_PLANES + features, features + 1);
    let none = gradients.color.is_empty()
        && gradients.normal.is_empty()
        && gradients.distance.is_empty()
        && gradients.opacity.is_empty();
    let tiles = render.layout.tiles.len();
    let load = !gradients.load.is_empty();
    render.buffers.load_gradient.resize(if load { tiles * BLOCKS } else { 0 }, Line::ZERO);
    render.buffers.upstream.resize(if none && !load { 0 } else { tiles * BLOCKS * stride }, Line::ZERO);
    let (layout, drawn) = (&render.layout, &render.buffers.planes);
    render.buffers.upstream.par_chunks_mut(BLOCKS * stride).enumerate().for_each(|(slot, out)| {
        out.fill(Line::ZERO);
        put(layout, slot, out, (stride, 1), &gradients.opacity, |value| [value]);
        put(layout, slot, out, (stride, LEADING_PLANES), &gradients.color, |value| value);
        if features == 7 {
            put(layout, slot, out, (stride, LEADING_PLANES + 3), &gradients.normal, |value| value);
            put(layout, slot, out, (stride, LEADING_PLANES + 6), &gradients.distance, |value| [value]);
        }
        for (gradients, drawn) in out.chunks_exact_mut(stride).zip(of_tile(drawn, slot, planes).chunks_exact(planes)) {
            let mut rest = Line::ZERO;
            let opacity = (&gradients[1], &drawn[features]);
            let features = gradients[LEADING_PLANES..].iter().zip(drawn);
            for (gradient, value) in features.chain(std::iter::once(opacity)) {
                for lane in 0..LANES {
                    rest.0[lane] += gradient.0[lane] * value.0[lane];
                }
            }
            gradients[0] = rest;
        }
    });
    render.buffers.load_gradient.par_chunks_mut(BLOCKS).enumerate().for_each(|(slot, out)| {
        out.fill(Line::ZERO);
        put(layout, slot, out, (1, 0), &gradients.load, |value| [value]);
    });
}

/// Copies one row-major map, unless it is empty, into the planes from `plane` on of a tile with `stride` lines a block.
#[inline(always)]
fn put<T: Copy, const N: usize>(
    layout: &Layout,
    slot: usize,
    lines: &mut [Line],
    (stride, plane): (usize, usize),
    map: &[T],
    split: impl Fn(T) -> [f32; N],
) {
    if map.is_empty() {
        return;
    }
    layout.each_run(slot, |pixel, block, lane, bits| {
        let to = &mut lines[block * stride + plane..][..N];
        for (i, &value) in map[pixel..].iter().take(BLOCK).enumerate() {
            if bits >> i & 1 != 0 {
                for (line, value) in to.iter_mut().zip(split(value)) {
                    line.0[lane + i] = value;
                }
            }
        }
    });
}
