//! The way back: from gradients of maps to sums per Gaussian, to gradients of its parameters.
//!
//! Two ways give the same sums. *By pixels*: a thread has a pixel, subgroups add up, what is left goes to memory by f32
//! atomics. *By Gaussians*: a lane has a Gaussian of a tile's list, pixels move through the lanes; nothing is atomic, so
//! the sums are the same in every run. Which is faster depends on card and scene: both are timed, and the faster stays.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use bytemuck::Zeroable;
use pgsag_splat::backend::{BackendError, Result, Sample};

use crate::adam::Pending;
use crate::cloud::GpuCloud;
use crate::device::Device;
use crate::gpu::Gpu;
use crate::memory::Buffer;
use crate::record::{Constant, Groups, Kernel, Recorder};
use crate::render::{GpuRender, SUMS};
use crate::sort::{self, Counted};

const FRAME: &str = include_str!("../shaders/frame.wgsl");
const RECORD: &str = include_str!("../shaders/record.wgsl");
const SUMS_TEXT: &str = include_str!("../shaders/sums.wgsl");
const UNBLEND: &str = include_str!("../shaders/unblend.wgsl");
const REST: &str = include_str!("../shaders/rest.wgsl");

const BY_PIXELS: Kernel = Kernel {
    name: "backward by pixels",
    parts: &[FRAME, RECORD, SUMS_TEXT, UNBLEND, REST, include_str!("../shaders/backward_pixels.wgsl")],
    adds: &["sums"],
};
const WALK: Kernel =
    Kernel { name: "walk", parts: &[FRAME, RECORD, UNBLEND, REST, include_str!("../shaders/walk.wgsl")], adds: &[] };
const BY_GAUSSIANS: Kernel = Kernel {
    name: "backward by Gaussians",
    parts: &[FRAME, RECORD, SUMS_TEXT, UNBLEND, include_str!("../shaders/backward_chunks.wgsl")],
    adds: &[],
};
const PULL: Kernel = Kernel {
    name: "pull",
    parts: &[
        FRAME,
        include_str!("../shaders/gaussian.wgsl"),
        include_str!("../shaders/harmonics.wgsl"),
        include_str!("../shaders/color.wgsl"),
        SUMS_TEXT,
        include_str!("../shaders/pull.wgsl"),
    ],
    adds: &[],
};

/// Kernels of this room.
#[cfg(test)]
pub(crate) const KERNELS: &[&Kernel] = &[&BY_PIXELS, &WALK, &BY_GAUSSIANS, &PULL];

/// How gradients of maps become sums per Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Backward {
    /// The faster of the two on this card and scene, found out on the way.
    #[default]
    Fastest,
    /// A thread per pixel, f32 atomics: least memory.
    Pixels,
    /// A lane per Gaussian, no atomics: the same bytes in every run. Needs subgroups of one width.
    Gaussians,
}

/// Steps that each way is timed for.
const TIMED: u32 = 12;
/// Steps until they are timed again: scenes grow.
const TIMED_EVERY: u32 = 2000;

/// Which way has been faster.
#[derive(Debug, Default)]
pub(crate) struct Race(Mutex<Laps>);

#[derive(Debug, Default)]
struct Laps {
    step: u32,
    /// By pixels, by Gaussians.
    spent: [Duration; 2],
}

impl Laps {
    /// The way of the next step, and whether it is timed.
    fn next(&mut self) -> (Backward, bool) {
        let at = self.step % TIMED_EVERY;
        if at == 0 {
            self.spent = [Duration::ZERO; 2];
        }
        self.step += 1;
        let way = |second: bool| if second { Backward::Gaussians } else { Backward::Pixels };
        if at < 2 * TIMED { (way(at % 2 == 1), true) } else { (way(self.spent[1] < self.spent[0]), false) }
    }

    /// The first lap of each compiles kernels and does not count.
    fn note(&mut self, way: Backward, spent: Duration) {
        if self.step % TIMED_EVERY > 2 {
            self.spent[usize::from(way == Backward::Gaussians)] += spent;
        }
    }
}

/// `Pull` in `pull.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, Zeroable)]
struct PullUniform {
    d_flatness: f32,
    mean_pixels: f32,
    padding: [u32; 2],
}

/// Gradients of the sample's renders, left for Adam.
pub(crate) fn backward(gpu: &Gpu, cloud: &mut GpuCloud, sample: &Sample<'_, Gpu>) -> Result<()> {
    let neighbor = sample.neighbor.as_ref().map(|(view, render)| (*view, &**render));
    let renders: Vec<_> = std::iter::once((sample.view, &*sample.render)).chain(neighbor).collect();
    if renders.iter().any(|(_, render)| !render.scene.options.gradient) {
        return Err(BackendError::Device("a render without `gradient` cannot go backward".into()));
    }
    let both = gpu.device.adapter.subgroup.0 == gpu.device.adapter.subgroup.1;
    let (way, timed) = match gpu.backward {
        Backward::Gaussians if !both => {
            return Err(BackendError::Device(format!(
                "{} has subgroups of {:?} lanes; gradients by Gaussians need one width",
                gpu.device.adapter.name, gpu.device.adapter.subgroup
            )));
        }
        Backward::Fastest if both => gpu.race.0.lock().unwrap_or_else(PoisonError::into_inner).next(),
        Backward::Fastest => (Backward::Pixels, false),
        way => (way, false),
    };
    if timed {
        gpu.device.wait()?;
    }
    let started = Instant::now();
    cloud.pending = Pending::default();
    for (at, (view, render)) in renders.into_iter().enumerate() {
        // The neighbour counts where some term gave it a gradient.
        if at > 0 && !render.touched {
            continue;
        }
        let mean_pixels = view.losses.mean_count(sample.weights.mean_over_mask) as f32;
        let d_flatness = if at == 0 { render.d_flatness } else { 0.0 };
        back(&gpu.device, cloud, render, way, &PullUniform { d_flatness, mean_pixels, padding: [0; 2] })?;
        cloud.pending.renders.push((Arc::clone(&render.frame), render.scene.clone()));
    }
    if timed {
        gpu.device.wait()?;
        gpu.race.0.lock().unwrap_or_else(PoisonError::into_inner).note(way, started.elapsed());
    }
    Ok(())
}

/// One render: sums, then `pull`.
fn back(device: &Device, cloud: &GpuCloud, render: &GpuRender, way: Backward, pull: &PullUniform) -> Result<()> {
    let GpuRender { scene, frame, .. } = render;
    let options = &scene.options;
    let [color, planes] = scene.channels();
    let constants: [Constant; 4] =
        [color, planes, ("LOAD", u32::from(options.load)), ("STATISTICS", u32::from(options.statistics))];
    let nothing = Arc::new(device.buffer("sums", 0)?);
    let mut record = device.record("back");
    // Sums of pairs take most of the memory; where they do not fit, atomics do without them.
    let pair_bytes = frame.hits.size() * SUMS;
    let by_gaussians = way == Backward::Gaussians && pair_bytes <= device.ledger.largest();
    let pair_sums = match (render.touched, by_gaussians) {
        (true, true) => by_gaussian(device, &mut record, render, &constants, pair_bytes)?,
        (true, false) => {
            by_pixel(&mut record, render, &constants);
            nothing
        }
        (false, _) => nothing,
    };
    let uniform = device.uniform(pull)?;
    let [base, sh_1, sh_2, sh_3] = &*cloud.values;
    let pulled: [&Buffer; 16] = [
        &frame.uniform,
        &uniform,
        &frame.counters.sizes,
        base,
        sh_1,
        sh_2,
        sh_3,
        &frame.gaussians,
        &frame.shown,
        &frame.records,
        &frame.sums,
        &cloud.statistics,
        &frame.pair_counts,
        &frame.first_pairs,
        &frame.hits,
        &pair_sums,
    ];
    let [color, planes, load, statistics] = constants;
    let rows = ("ROWS", u32::from(by_gaussians && render.touched));
    let threads = frame.counters.threads(Counted::Drawn);
    record.run_with(&PULL, &[color, planes, load, statistics, rows], &pulled, threads);
    record.submit();
    Ok(())
}

fn by_pixel(record: &mut Recorder<'_>, render: &GpuRender, constants: &[Constant]) {
    let GpuRender { scene, frame, .. } = render;
    let bound: [&Buffer; 11] = [
        &frame.uniform,
        &scene.tiles.list,
        &frame.ranges,
        &frame.pairs,
        &frame.owners,
        &frame.records,
        &frame.maps,
        &frame.grads,
        &frame.lasts,
        &frame.hits,
        &frame.sums,
    ];
    record.run_with(&BY_PIXELS, constants, &bound, Groups::Count(u64::from(scene.tiles.count)));
}

/// Returns the sums of the pairs.
fn by_gaussian(
    device: &Device,
    record: &mut Recorder<'_>,
    render: &GpuRender,
    constants: &[Constant],
    pair_bytes: u64,
) -> Result<Arc<Buffer>> {
    let GpuRender { scene, frame, .. } = render;
    let tiles = u64::from(scene.tiles.count);
    // Every list has at most one chunk that is not full.
    let chunks = frame.hits.size() / 4 / u64::from(device.adapter.subgroup.0) + tiles;
    let pair_sums = record.scratch("sums of pairs", pair_bytes)?;
    let chunk_tiles = record.scratch("chunks", 4 * chunks)?;
    let states = record.scratch("chunks", 8 * 256 * chunks)?;
    let counters = &frame.counters;
    let lists = [&*frame.ranges, &*frame.ranges];
    let first_chunks = sort::scan(device, record, counters, &frame.uniform, (Counted::Chunks, tiles), lists)?;
    let walked: [&Buffer; 12] = [
        &frame.uniform,
        &scene.tiles.list,
        &frame.ranges,
        &frame.pairs,
        &frame.owners,
        &frame.records,
        &frame.maps,
        &frame.grads,
        &frame.lasts,
        &first_chunks,
        &chunk_tiles,
        &states,
    ];
    let [color, planes, load] = [constants[0], constants[1], constants[2]];
    record.run_with(&WALK, &[color, planes, load], &walked, Groups::Count(tiles));
    let bound: [&Buffer; 14] = [
        &frame.uniform,
        &counters.sizes,
        &scene.tiles.list,
        &frame.ranges,
        &frame.pairs,
        &frame.owners,
        &frame.records,
        &frame.grads,
        &frame.lasts,
        &frame.hits,
        &first_chunks,
        &chunk_tiles,
        &states,
        &pair_sums,
    ];
    record.run_with(&BY_GAUSSIANS, constants, &bound, counters.chunks());
    Ok(pair_sums)
}

#[cfg(test)]
mod tests;
