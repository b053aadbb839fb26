//! A render on a card: how it is drawn, and what the losses and the way back need of it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use bytemuck::Zeroable;
use pgsag_scene::Map;
use pgsag_splat::backend::{Limits, PlaneMaps, RenderOptions, Result, ViewCamera};
use pgsag_splat::equations::projection::Lens;

use crate::cloud::Bands;
use crate::device::Device;
use crate::memory::Buffer;
use crate::record::{Groups, Kernel, Recorder};
use crate::sort::{self, Counted, Counters};
use crate::view::{TILE, Tiles};

/// Planes of maps and of their gradients: colour 3, opacity, normal 3, distance, depth, load.
pub(crate) const PLANES: usize = 10;
/// Sums of a Gaussian that `backward` makes: `sums.wgsl`.
pub(crate) const SUMS: u64 = 18;

const FRAME: &str = include_str!("../shaders/frame.wgsl");
const GAUSSIAN: &str = include_str!("../shaders/gaussian.wgsl");
const TILES: &str = include_str!("../shaders/tiles.wgsl");
const RECORD: &str = include_str!("../shaders/record.wgsl");

const CULL: Kernel =
    Kernel { name: "cull", parts: &[FRAME, GAUSSIAN, TILES, include_str!("../shaders/cull.wgsl")], adds: &[] };
const SHADE: Kernel = Kernel {
    name: "shade",
    parts: &[
        FRAME,
        GAUSSIAN,
        include_str!("../shaders/harmonics.wgsl"),
        include_str!("../shaders/color.wgsl"),
        include_str!("../shaders/shade.wgsl"),
    ],
    adds: &[],
};
const EMIT: Kernel = Kernel { name: "emit", parts: &[FRAME, TILES, include_str!("../shaders/emit.wgsl")], adds: &[] };
const RANGES: Kernel = Kernel { name: "ranges", parts: &[FRAME, include_str!("../shaders/ranges.wgsl")], adds: &[] };
const FORWARD: Kernel =
    Kernel { name: "forward", parts: &[FRAME, RECORD, include_str!("../shaders/forward.wgsl")], adds: &[] };
const TALLY: Kernel = Kernel { name: "tally", parts: &[FRAME, include_str!("../shaders/tally.wgsl")], adds: &[] };
const TALLY_TOTAL: Kernel =
    Kernel { name: "tally total", parts: &[include_str!("../shaders/tally_total.wgsl")], adds: &[] };

/// Kernels of this room.
#[cfg(test)]
pub(crate) const KERNELS: &[&Kernel] = &[&CULL, &SHADE, &EMIT, &RANGES, &FORWARD, &TALLY, &TALLY_TOTAL];

/// `Frame` in `frame.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, Zeroable)]
pub(crate) struct FrameUniform {
    rows: [[f32; 4]; 3],
    focal: [f32; 2],
    inverse_focal: [f32; 2],
    center: [f32; 2],
    tangent_low: [f32; 2],
    tangent_high: [f32; 2],
    alpha_cut: f32,
    stop: f32,
    eye: [f32; 3],
    near: f32,
    size: [u32; 2],
    tile_grid: [u32; 2],
    count: u32,
    degree: u32,
    tiles: u32,
    pub(crate) pairs: u32,
    drawn: u32,
    padding: [u32; 3],
}

/// What is drawn, and where: kept so that it can be drawn again where room was short.
#[derive(Clone)]
pub(crate) struct Scene {
    pub(crate) camera: ViewCamera,
    pub(crate) options: RenderOptions,
    pub(crate) limits: Limits,
    pub(crate) values: Arc<Bands>,
    pub(crate) statistics: Arc<Buffer>,
    pub(crate) count: usize,
    pub(crate) tiles: Arc<Tiles>,
    pub(crate) pixels: Arc<Buffer>,
    /// 0 all pixels, 1 boundary and inside, 2 all but occluded.
    pub(crate) drawn: u32,
}

/// Buffers of a render.
pub(crate) struct Frame {
    pub(crate) uniform: Buffer,
    pub(crate) counters: Counters,
    /// By Gaussian: 1 + its slot where it covers a drawn pixel, else 0.
    pub(crate) shown: Arc<Buffer>,
    /// By slot: `record.wgsl`.
    pub(crate) records: Arc<Buffer>,
    /// By slot: index in the cloud.
    pub(crate) gaussians: Arc<Buffer>,
    /// By slot: its pairs and the first of them.
    pub(crate) pair_counts: Arc<Buffer>,
    pub(crate) first_pairs: Arc<Buffer>,
    /// By tile: list.
    pub(crate) ranges: Arc<Buffer>,
    /// By place in the lists: pair.
    pub(crate) pairs: Arc<Buffer>,
    /// By pair: slot of its Gaussian.
    pub(crate) owners: Arc<Buffer>,
    /// By pair: 1 where it covers a pixel, 2 in the first half of its light.
    pub(crate) hits: Arc<Buffer>,
    /// [`PLANES`] maps.
    pub(crate) maps: Arc<Buffer>,
    /// Their gradients; 16 bytes without `gradient`.
    pub(crate) grads: Arc<Buffer>,
    /// By pixel: one past the place of the last pair that covers it.
    pub(crate) lasts: Arc<Buffer>,
    /// By slot: [`SUMS`]; 16 bytes without `gradient`.
    pub(crate) sums: Arc<Buffer>,
}

/// A render on the card.
pub struct GpuRender {
    pub(crate) scene: Scene,
    pub(crate) frame: Arc<Frame>,
    /// Whether `losses` has added gradients to `grads`.
    pub(crate) touched: bool,
    /// Weight of the flattening term over the scene scale; set by `losses`.
    pub(crate) d_flatness: f32,
}

impl std::fmt::Debug for GpuRender {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("GpuRender").field("options", &self.scene.options).finish_non_exhaustive()
    }
}

/// How many pairs there is room for: what renders have needed, and a half more.
#[derive(Debug, Default)]
pub(crate) struct Room(pub(crate) AtomicU64);

impl Room {
    /// Takes note of a need.
    pub(crate) fn note(&self, pairs: u64) {
        self.0.fetch_max(pairs + pairs / 2 + 1024, Relaxed);
    }

    fn now(&self) -> Option<u64> {
        Some(self.0.load(Relaxed)).filter(|&pairs| pairs > 0)
    }
}

/// Whether colours are left out.
pub(crate) fn leaves_color_out(options: &RenderOptions) -> bool {
    let RenderOptions { planes, load, observe, statistics, without_color, .. } = *options;
    without_color && planes && !load && !observe && !statistics
}

impl Scene {
    fn uniform(&self, pairs: u64) -> FrameUniform {
        let lens = Lens::<f32>::new(&self.camera);
        let row = |k: usize| {
            let [x, y, z] = lens.rotation[k];
            [x, y, z, lens.translation[k]]
        };
        let Tiles { width, height, count, .. } = *self.tiles;
        FrameUniform {
            rows: [row(0), row(1), row(2)],
            focal: lens.focal,
            inverse_focal: lens.inverse_focal,
            center: lens.center,
            tangent_low: lens.tangent_low,
            tangent_high: lens.tangent_high,
            alpha_cut: libm::log2f(self.limits.alpha_cut).max(-100.0),
            stop: self.limits.transmittance_stop,
            eye: lens.eye,
            near: self.camera.near as f32,
            size: [width, height],
            tile_grid: [width.div_ceil(TILE), height.div_ceil(TILE)],
            count: self.count as u32,
            degree: u32::from(self.options.sh_degree),
            tiles: count,
            pairs: pairs as u32,
            drawn: self.drawn,
            padding: [0; 3],
        }
    }

    fn pixel_count(&self) -> u64 {
        u64::from(self.tiles.width) * u64::from(self.tiles.height)
    }

    /// Colour and planes, as constants of kernels.
    pub(crate) fn channels(&self) -> [(&'static str, u32); 2] {
        [("COLOR", u32::from(!leaves_color_out(&self.options))), ("PLANES", u32::from(self.options.planes))]
    }
}

/// What the first half of drawing leaves for the second.
struct Culled {
    /// By place, front to back: slot.
    order: Arc<Buffer>,
    /// By place: first pair.
    starts: Arc<Buffer>,
    records: Arc<Buffer>,
    gaussians: Arc<Buffer>,
    pair_counts: Arc<Buffer>,
    shown: Arc<Buffer>,
    ranges: Arc<Buffer>,
}

impl Scene {
    /// Draws. Where it is not yet known how many pairs there are, or the render must be whole at once (it has no losses
    /// that would look), the card is asked in between.
    pub(crate) fn draw(&self, device: &Device, room: &Room, may_overflow: bool) -> Result<Frame> {
        let guess = room.now().filter(|_| may_overflow);
        let uniform = device.uniform(&self.uniform(guess.unwrap_or(u64::from(u32::MAX))))?;
        let counters = Counters::new(device)?;
        let mut record = device.record("draw");
        let culled = self.cull(device, &mut record, &counters, &uniform)?;
        let pairs = match guess {
            Some(pairs) => pairs,
            None => {
                record.submit();
                let sizes: Vec<u32> = device.read(&counters.sizes, 0, 3)?;
                let pairs = u64::from(sizes[Counted::Pairs as usize]).max(1);
                room.note(pairs);
                device.write(&uniform, 0, &[self.uniform(pairs)]);
                record = device.record("draw");
                pairs
            }
        };
        let frame = self.blend(device, &mut record, (counters, uniform), culled, pairs)?;
        record.submit();
        Ok(frame)
    }

    /// From the cloud to records, their order and their numbers of pairs.
    fn cull(
        &self,
        device: &Device,
        record: &mut Recorder<'_>,
        counters: &Counters,
        uniform: &Buffer,
    ) -> Result<Culled> {
        let count = self.count as u64;
        let mut words = |what: &'static str, each: u64| record.scratch(what, 4 * each * count);
        let (counts, shown) = (words("tile counts", 1)?, words("slots", 1)?);
        let (records, keys) = (words("records", 16)?, words("depths", 1)?);
        let (gaussians, pair_counts) = (words("slots", 1)?, words("tile counts", 1)?);
        let ranges = record.scratch("lists", 8 * u64::from(self.tiles.count))?;
        let [base, sh_1, sh_2, sh_3] = &*self.values;
        let threads = Groups::Count(count.div_ceil(256).max(1));
        record.run(&CULL, &[uniform, base, &self.tiles.before, &counts, &shown, &ranges, &counters.sizes], threads);
        let slots = sort::scan(device, record, counters, uniform, (Counted::Drawn, count), [&counts, &counts])?;
        let shaded =
            [uniform, base, sh_1, sh_2, sh_3, &counts, &slots, &records, &keys, &gaussians, &pair_counts].map(|b| b);
        record.run_with(&SHADE, &self.channels(), &shaded, threads);
        let [_, order] = sort::sort(device, record, counters, (Counted::Drawn, count), &keys, 32)?;
        let starts = sort::scan(device, record, counters, uniform, (Counted::Pairs, count), [&pair_counts, &order])?;
        Ok(Culled { order, starts, records, gaussians, pair_counts, shown, ranges })
    }

    /// Lists of tiles, then the maps.
    fn blend(
        &self,
        device: &Device,
        record: &mut Recorder<'_>,
        (counters, uniform): (Counters, Buffer),
        culled: Culled,
        room: u64,
    ) -> Result<Frame> {
        let [tile_keys, owners, hits] = [(); 3].map(|()| record.scratch("pairs", 4 * room));
        let (tile_keys, owners, hits) = (tile_keys?, owners?, hits?);
        let first_pairs = record.scratch("slots", 4 * self.count as u64)?;
        let Culled { order, starts, records, gaussians, pair_counts, shown, ranges } = culled;
        let (sizes, before) = (&counters.sizes, &self.tiles.before);
        let emitted: [&Buffer; 11] = [
            &uniform,
            sizes,
            before,
            &records,
            &order,
            &pair_counts,
            &starts,
            &first_pairs,
            &tile_keys,
            &owners,
            &hits,
        ];
        record.run(&EMIT, &emitted, counters.threads(Counted::Drawn));
        // No part of the frame, and of another submission where the card was asked for the number of pairs.
        record.keep([order, starts]);
        // Slots of tiles, and one more for pairs that no tile wants.
        let bits = u32::BITS - self.tiles.count.leading_zeros();
        let [keys, pairs] = sort::sort(device, record, &counters, (Counted::Pairs, room), &tile_keys, bits)?;
        record.run(&RANGES, &[&uniform, sizes, &keys, &ranges], counters.threads(Counted::Pairs));
        let [maps, grads, lasts] = self.empty_maps(record)?;
        let sums = record.scratch("sums", if self.options.gradient { 4 * SUMS * self.count as u64 } else { 0 })?;
        let frame = Frame {
            uniform,
            counters,
            shown,
            records,
            gaussians,
            pair_counts,
            first_pairs,
            ranges,
            pairs,
            owners,
            hits,
            maps,
            grads,
            lasts,
            sums,
        };
        self.forward(record, &frame)?;
        Ok(frame)
    }

    /// Maps, their gradients, and the place of the last pair of every pixel; 0 where they must be.
    fn empty_maps(&self, record: &mut Recorder<'_>) -> Result<[Arc<Buffer>; 3]> {
        let pixels = self.pixel_count();
        let bytes = 4 * PLANES as u64 * pixels;
        let maps = record.scratch("maps", bytes)?;
        let grads = record.scratch("gradients of maps", if self.options.gradient { bytes } else { 0 })?;
        let lasts = record.scratch("maps", 4 * pixels)?;
        let grid = u64::from(self.tiles.width.div_ceil(TILE)) * u64::from(self.tiles.height.div_ceil(TILE));
        if u64::from(self.tiles.count) < grid {
            record.clear(&maps, bytes);
        }
        if self.options.gradient {
            record.clear(&grads, bytes);
        }
        Ok([maps, grads, lasts])
    }

    /// Blends, and finds out who was blended.
    fn forward(&self, record: &mut Recorder<'_>, frame: &Frame) -> Result<()> {
        let [color, planes] = self.channels();
        let sizes = &frame.counters.sizes;
        let drawn: [&Buffer; 10] = [
            &frame.uniform,
            &self.tiles.list,
            &self.pixels,
            &frame.ranges,
            &frame.pairs,
            &frame.owners,
            &frame.records,
            &frame.maps,
            &frame.lasts,
            &frame.hits,
        ];
        let constants = [color, planes, ("LOAD", u32::from(self.options.load))];
        record.run_with(&FORWARD, &constants, &drawn, Groups::Count(u64::from(self.tiles.count)));
        let block_sums = record.scratch("partial sums", 8 * (self.count as u64).div_ceil(256))?;
        let tallied: [&Buffer; 11] = [
            &frame.uniform,
            sizes,
            &frame.records,
            &frame.gaussians,
            &frame.pair_counts,
            &frame.first_pairs,
            &frame.hits,
            &frame.shown,
            &self.statistics,
            &frame.sums,
            &block_sums,
        ];
        let gradient = self.options.gradient;
        let constants = [("OBSERVE", u32::from(self.options.observe)), ("GRADIENT", u32::from(gradient))];
        record.run_with(&TALLY, &constants, &tallied, frame.counters.threads(Counted::Drawn));
        if gradient {
            record.run(&TALLY_TOTAL, &[sizes, &block_sums], Groups::Count(1));
        }
        Ok(())
    }

    /// Reads the maps that were asked for.
    pub(crate) fn read(&self, device: &Device, frame: &Frame) -> Result<PlaneMaps> {
        let pixels = self.pixel_count() as usize;
        let options = &self.options;
        let planes: Vec<f32> = device.read(&frame.maps, 0, PLANES * pixels)?;
        let number = |wanted: bool, plane: usize| {
            let values = if wanted { planes[plane * pixels..(plane + 1) * pixels].to_vec() } else { Vec::new() };
            self.map(values)
        };
        let triple = |wanted: bool, plane: usize| {
            let count = if wanted { pixels } else { 0 };
            self.map((0..count).map(|i| [0, 1, 2].map(|k| planes[(plane + k) * pixels + i])).collect())
        };
        Ok(PlaneMaps {
            color: triple(!leaves_color_out(options), 0),
            opacity: number(true, 3),
            normal: triple(options.planes, 4),
            distance: number(options.planes, 7),
            depth: number(options.planes, 8),
            load: number(options.load, 9),
        })
    }

    /// A map of the camera's size, or 0 x 0 where there are no values.
    fn map<T>(&self, values: Vec<T>) -> Map<T> {
        let (width, height) = if values.is_empty() { (0, 0) } else { (self.tiles.width, self.tiles.height) };
        Map { width, height, values }
    }
}

#[cfg(test)]
mod tests;
