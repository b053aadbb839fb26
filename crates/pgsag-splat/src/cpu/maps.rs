//! Between block order, in which tiles are drawn, and rows, in which losses and readers think.

use rayon::prelude::*;

use super::{
    backward::LEADING_PLANES,
    lanes::{BLOCKS, Line, TILE},
    layout::of_tile,
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
        let features = render.features();
        let line = |slot: usize, block: usize, plane: usize| {
            &of_tile(&render.buffers.planes, slot, features + 1)[block * (features + 1) + plane]
        };
        let color = |slot, block, lane: usize| std::array::from_fn(|k| line(slot, block, k).0[lane]);
        let normal = |slot, block, lane: usize| std::array::from_fn(|k| line(slot, block, 3 + k).0[lane]);
        rows(render, true, &mut self.color, color);
        rows(render, render.options.planes, &mut self.normal, normal);
        rows(render, render.options.planes, &mut self.distance, |slot, block, lane| line(slot, block, 6).0[lane]);
        rows(render, true, &mut self.opacity, |slot, block, lane| line(slot, block, features).0[lane]);
        let load = &render.buffers.load;
        rows(render, render.options.load, &mut self.load, |slot, block, lane| load[slot * BLOCKS + block].0[lane]);
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

/// Fills one map from `at(tile slot, block, lane)`; empties it if it is not `wanted`.
fn rows<T: Copy + Default + Send>(
    render: &CpuRender,
    wanted: bool,
    map: &mut Vec<T>,
    at: impl Fn(usize, usize, usize) -> T + Sync,
) {
    let layout = &render.layout;
    let (width, height) = (layout.width as usize, layout.height as usize);
    map.clear();
    if !wanted {
        return;
    }
    map.resize(width * height, T::default());
    map.par_chunks_mut(TILE * width).enumerate().for_each(|(row, band)| {
        let first = layout.tiles.partition_point(|&tile| tile < row as u32 * layout.columns);
        let end = layout.tiles.partition_point(|&tile| tile < (row as u32 + 1) * layout.columns);
        for slot in first..end {
            layout.each_pixel(slot, |pixel, block, lane| band[pixel - row * TILE * width] = at(slot, block, lane));
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
    render.buffers.load_gradient.clear();
    render.buffers.load_gradient.resize(if load { tiles * BLOCKS } else { 0 }, Line::ZERO);
    render.buffers.upstream.clear();
    render.buffers.upstream.resize(if none && !load { 0 } else { tiles * BLOCKS * stride }, Line::ZERO);
    let (layout, drawn) = (&render.layout, &render.buffers.planes);
    render.buffers.upstream.par_chunks_mut(BLOCKS * stride).enumerate().for_each(|(slot, out)| {
        let drawn = of_tile(drawn, slot, planes);
        layout.each_pixel(slot, |pixel, block, lane| {
            let opacity = gradients.opacity.get(pixel).copied().unwrap_or(0.0);
            let mut put = |plane: usize, value: f32| out[block * stride + plane].0[lane] = value;
            let mut rest = opacity * drawn[block * planes + features].0[lane];
            put(1, opacity);
            let mut feature = |k: usize, value: f32| {
                put(LEADING_PLANES + k, value);
                rest += value * drawn[block * planes + k].0[lane];
            };
            for (k, &value) in gradients.color.get(pixel).into_iter().flatten().enumerate() {
                feature(k, value);
            }
            if features == 7 {
                for (k, &value) in gradients.normal.get(pixel).into_iter().flatten().enumerate() {
                    feature(3 + k, value);
                }
                feature(6, gradients.distance.get(pixel).copied().unwrap_or(0.0));
            }
            put(0, rest);
        });
    });
    render.buffers.load_gradient.par_chunks_mut(BLOCKS).enumerate().for_each(|(slot, out)| {
        layout.each_pixel(slot, |pixel, block, lane| out[block].0[lane] = gradients.load[pixel]);
    });
}
