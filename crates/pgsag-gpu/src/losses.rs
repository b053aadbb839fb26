//! The terms of Eq. 10-11 on the card: values, and gradients of the rendered maps (`pgsag_splat::losses` says what they are).
//!
//! `kernels` lists the shaders, `params` is what the host tells them. Photograph, mask and maps stay where they are; one
//! read-back of a hundred bytes brings the values, because the trainer looks at them in every step. Sums over pixels run
//! in a fixed order; the one exception is the neighbour's depth gradient, which is added atomically.

mod kernels;
mod params;

use pgsag_scene::{Mask, PixelClass};
use pgsag_splat::backend::{BackendError, Exposure, LossValues, LossWeights, Result, Sample, TrainingView, ViewCamera};
use std::sync::Arc;

use crate::cloud::GpuCloud;
use crate::device::Device;
use crate::gpu::Gpu;
use crate::memory::Buffer;
use crate::record::{Groups, Recorder};
use crate::render::Frame;
use crate::view::GpuView;
#[cfg(test)]
pub(crate) use kernels::KERNELS;
use params::{Plan, Region};

/// Pixels of a block when patches are counted.
const BLOCK: usize = 256;
/// Quantile of the image gradient that counts as full texture, as `losses::image_gradient`.
const FULL_TEXTURE: f64 = 0.99;
/// Levels of the image gradient.
const LEVEL_COUNT: u64 = 766;
/// Planes of scratch: three derivatives of SSIM by three channels.
const SCRATCH_PLANES: u64 = 9;

/// What the losses derive of a view.
#[derive(Debug)]
pub(crate) struct View {
    camera: ViewCamera,
    active_count: usize,
    free_count: usize,
    pixel_count: usize,
    /// `[H · W + 1]` level of the image gradient, whether windows fit into the mask; last the level of full texture.
    traits: Buffer,
}

impl View {
    /// Over how many pixels the photometric and normal terms average, at least 1.
    pub(crate) fn mean_count(&self, mean_over_mask: bool) -> usize {
        if mean_over_mask { self.active_count.max(1) } else { self.pixel_count.max(1) }
    }
}

/// Derives weights of a view whose `pixels` are on the card.
pub(crate) fn prepare(device: &Device, pixels: &Buffer, view: &TrainingView) -> Result<View> {
    let pixel_count = view.image.pixels.len();
    let traits = device.buffer("traits of pixels", 4 * (pixel_count as u64 + 1))?;
    let counts = device.buffer("counts of levels", 4 * LEVEL_COUNT)?;
    let rank = (pixel_count as f64 * FULL_TEXTURE) as u32;
    let size = device.uniform(&[view.image.width, view.image.height, pixel_count as u32, rank])?;
    let mut record = device.record("prepare");
    let blocks = Groups::Count(pixel_count.div_ceil(BLOCK) as u64);
    record.run(&kernels::VIEW, &[&size, pixels, &traits, &counts], blocks);
    record.run(&kernels::FULL, &[&size, &traits, &counts], Groups::Count(1));
    record.submit();
    let free = |mask: &Mask| mask.classes.iter().filter(|&&class| class == PixelClass::Free).count();
    Ok(View {
        camera: view.camera,
        active_count: view.mask.as_ref().map_or(pixel_count, Mask::active_count),
        free_count: view.mask.as_ref().map_or(0, free),
        pixel_count,
        traits,
    })
}

/// A view and what was rendered of it.
#[derive(Clone, Copy)]
pub(crate) struct Side<'a> {
    pub(crate) view: &'a GpuView,
    /// Planes of `[H · W]`: colour 3, opacity, normal 3, distance, depth, load.
    pub(crate) maps: &'a Buffer,
    /// The same planes.
    pub(crate) grads: &'a Buffer,
    /// `[4]` bits of the sum of smallest scales over visible Gaussians, `[5]` their number.
    pub(crate) sizes: &'a Buffer,
}

/// All that the terms look at.
#[derive(Clone, Copy)]
pub(crate) struct Request<'a> {
    pub(crate) reference: Side<'a>,
    /// Of the multi-view terms.
    pub(crate) neighbor: Option<Side<'a>>,
    pub(crate) exposure: Exposure,
    pub(crate) weights: &'a LossWeights,
    pub(crate) scene_scale: f32,
    pub(crate) seed: u64,
    /// Whether the load was rendered.
    pub(crate) has_load: bool,
}

impl<'a> Request<'a> {
    /// The neighbour, where a term asks for it.
    fn pair(&self) -> Option<Side<'a>> {
        self.neighbor.filter(|_| self.weights.geometric != 0.0 || self.weights.ncc != 0.0)
    }
}

/// Buffers of one evaluation.
struct Desk {
    plan: Plan,
    /// For the reference, and for the neighbour as if it were the reference.
    params: [Buffer; 2],
    scratch: Arc<Buffer>,
    partials: Arc<Buffer>,
    terms: Arc<Buffer>,
}

impl Desk {
    fn new(device: &Device, request: &Request<'_>) -> Result<Self> {
        let plan = Plan::new(request);
        let pixels = request.reference.view.losses.pixel_count as u64;
        Ok(Self {
            params: [device.uniform(&plan.params(request))?, device.uniform(&plan.swapped(request))?],
            scratch: device.scratch("maps of losses", 4 * SCRATCH_PLANES * pixels)?,
            partials: device.scratch("partial sums", 16 * u64::from(plan.groups))?,
            terms: device.scratch("sums of losses", 16 * params::TERMS)?,
            plan,
        })
    }

    fn groups(&self, region: Region) -> Groups<'static> {
        Groups::Count(u64::from(self.plan.count(region)))
    }
}

/// Values of all terms with weight; adds the gradients of the total to the sample's renders.
pub(crate) fn evaluate(gpu: &Gpu, cloud: &GpuCloud, sample: &mut Sample<'_, Gpu>) -> Result<LossValues> {
    loop {
        let (values, found) = look(gpu, cloud, sample)?;
        let [fault, short, other_short] = found;
        if fault != 0 {
            return Err(BackendError::NotFinite("a parameter after the Adam step"));
        }
        if short == 0 && other_short == 0 {
            return if values.total.is_finite() { Ok(values) } else { Err(BackendError::NotFinite("the loss")) };
        }
        // Gradients were added to both: both begin anew, with room for all pairs.
        gpu.redraw(sample.render)?;
        if let Some((_, render)) = &mut sample.neighbor {
            gpu.redraw(render)?;
        }
    }
}

/// Values as if every pair had fitted; then whether the cloud has a fault, and how many pairs were wanted where they did not.
fn look(gpu: &Gpu, cloud: &GpuCloud, sample: &mut Sample<'_, Gpu>) -> Result<(LossValues, [u32; 3])> {
    let weights = sample.weights;
    let request = Request {
        reference: side_of(sample.view, &sample.render.frame),
        neighbor: sample.neighbor.as_ref().map(|(view, render)| side_of(view, &render.frame)),
        exposure: sample.exposure,
        weights,
        scene_scale: sample.scene_scale,
        seed: sample.seed,
        has_load: sample.render.scene.options.load,
    };
    let other = request.neighbor.unwrap_or(request.reference);
    let wanted = [(&cloud.fault, 0), (request.reference.sizes, 12), (other.sizes, 12)];
    let (values, found) = compare(&gpu.device, &request, &wanted.map(|(buffer, first)| (&**buffer, first, 4)))?;
    sample.render.touched = true;
    sample.render.d_flatness = weights.flatness / sample.scene_scale;
    if let Some((_, render)) = &mut sample.neighbor {
        render.touched = weights.geometric != 0.0;
    }
    let word = |at: usize| bytemuck::pod_read_unaligned::<u32>(&found[at]);
    Ok((values, [word(0), word(1), word(2)]))
}

fn side_of<'a>(view: &'a GpuView, frame: &'a Frame) -> Side<'a> {
    Side { view, maps: &frame.maps, grads: &frame.grads, sizes: &frame.counters.sizes }
}

/// Depths and weights of the pair of views.
struct Pair {
    /// `[H · W]` of the reference.
    d_depth: Arc<Buffer>,
    /// `[H · W]` weights of the pixels that passed the gate.
    gates: Arc<Buffer>,
    /// `[H · W]` gradient of the neighbour's depth.
    links: Arc<Buffer>,
}

impl Pair {
    fn new(device: &Device, request: &Request<'_>, other: Side<'_>) -> Result<Self> {
        let [own, far] = [request.reference, other].map(|side| 4 * side.view.losses.pixel_count as u64);
        Ok(Self {
            d_depth: device.scratch("gradients of depth", own)?,
            gates: device.scratch("weights of pixels", own)?,
            links: device.scratch("gradients of depth", far)?,
        })
    }
}

/// Values of all terms with weight, and the parts of buffers in `extra`, read back with them; adds the gradients of the
/// total to the gradient planes of both sides.
pub(crate) fn compare(
    device: &Device,
    request: &Request<'_>,
    extra: &[(&wgpu::Buffer, u64, u64)],
) -> Result<(LossValues, Vec<Vec<u8>>)> {
    let desk = Desk::new(device, request)?;
    let pair = request.pair().map(|other| Ok((other, Pair::new(device, request, other)?))).transpose()?;
    let mut record = device.record("losses");
    if let Some((other, pair)) = &pair {
        record.clear(&pair.links, 4 * other.view.losses.pixel_count as u64);
    }
    pixelwise(&mut record, request, &desk);
    if let Some((other, pair)) = &pair {
        geometric(&mut record, request, &desk, (*other, pair));
    }
    let [params, _] = &desk.params;
    let reduce = [params, &*desk.partials, &*desk.terms];
    record.run(&kernels::REDUCE, &reduce, Groups::Count(params::REGIONS as u64));
    if let Some((other, pair)) = &pair {
        carry(&mut record, request, &desk, (*other, pair));
        ncc(&mut record, request, &desk, (*other, pair))?;
    }
    let Side { view, maps, grads, sizes } = request.reference;
    record.run(&kernels::TOTAL, &[params, &*desk.terms, sizes], Groups::Count(1));
    let level = [params, &view.pixels, &view.losses.traits, maps, grads, &*desk.terms];
    record.run(&kernels::LEVEL, &level, desk.groups(Region::Load));
    record.submit();
    let mut parts: Vec<(&wgpu::Buffer, u64, u64)> =
        vec![(&desk.terms, 16 * params::VALUES, 16 * params::VALUE_ROWS as u64)];
    parts.extend_from_slice(extra);
    let mut found = device.read_many(&parts)?;
    let values: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&found.remove(0));
    Ok((values_of(&values), found))
}

/// The terms of one view.
fn pixelwise(record: &mut Recorder<'_>, request: &Request<'_>, desk: &Desk) {
    let Side { view, maps, grads, .. } = request.reference;
    let (pixels, traits, tiles) = (&view.pixels, &view.losses.traits, &view.active.list);
    let [params, _] = &desk.params;
    let (scratch, partials): (&Buffer, &Buffer) = (&desk.scratch, &desk.partials);
    record.run(&kernels::SSIM, &[params, pixels, maps, tiles, scratch, partials], desk.groups(Region::Ssim));
    let photo = Groups::Count(3 * u64::from(desk.plan.count(Region::Photo)));
    record.run(&kernels::COLOR, &[params, pixels, maps, grads, tiles, scratch, partials], photo);
    let normal = desk.groups(Region::Normal);
    record.run(&kernels::NORMAL, &[params, pixels, traits, maps, grads, tiles, scratch, partials], normal);
    record.run(&kernels::SLANT, &[params, pixels, maps, grads, tiles, scratch], normal);
    record.run(&kernels::FREE, &[params, pixels, maps, grads, partials], desk.groups(Region::Free));
    record.run(&kernels::LOAD, &[params, pixels, traits, maps, partials], desk.groups(Region::Load));
}

/// There and back: weights and gradients of both depths, not yet divided by the number of valid pixels.
fn geometric(record: &mut Recorder<'_>, request: &Request<'_>, desk: &Desk, (other, pair): (Side<'_>, &Pair)) {
    let Side { view, maps, .. } = request.reference;
    let buffers: [&Buffer; 10] = [
        &desk.params[0],
        &view.pixels,
        maps,
        &other.view.losses.traits,
        other.maps,
        &view.active.list,
        &desk.partials,
        &pair.d_depth,
        &pair.gates,
        &pair.links,
    ];
    record.run(&kernels::GEOMETRIC, &buffers, desk.groups(Region::Geometric));
}

/// Gradients of both depths to their planes.
fn carry(record: &mut Recorder<'_>, request: &Request<'_>, desk: &Desk, (other, pair): (Side<'_>, &Pair)) {
    if request.weights.geometric == 0.0 {
        return;
    }
    for (side, params, d_depth) in
        [(request.reference, &desk.params[0], &pair.d_depth), (other, &desk.params[1], &pair.links)]
    {
        let Side { view, maps, grads, .. } = side;
        let buffers: [&Buffer; 7] = [params, &view.pixels, maps, grads, &view.active.list, &desk.terms, d_depth];
        record.run(&kernels::CARRY, &buffers, Groups::Count(view.active.count.into()));
    }
}

/// Patches: which, compared, their gradients.
fn ncc(record: &mut Recorder<'_>, request: &Request<'_>, desk: &Desk, (other, pair): (Side<'_>, &Pair)) -> Result<()> {
    let groups = desk.plan.count(Region::Ncc);
    if groups == 0 {
        return Ok(());
    }
    let Side { view, maps, grads, .. } = request.reference;
    let blocks = view.losses.pixel_count.div_ceil(BLOCK) as u64;
    let marks = record.scratch("marks of pixels", 4 * (9 * blocks + 1))?;
    let patches = u64::from(groups) * u64::from(params::PATCHES);
    let centers = record.scratch("centres of patches", 4 * patches)?;
    let slopes = record.scratch("gradients of patches", 16 * patches)?;
    let [params, _] = &desk.params;
    record.run(&kernels::MARK, &[params, &view.losses.traits, &pair.gates, &marks], Groups::Count(blocks));
    record.run(&kernels::RANK, &[params, &marks], Groups::Count(1));
    let buffers: [&Buffer; 10] = [
        params,
        &view.pixels,
        maps,
        &other.view.pixels,
        &other.view.losses.traits,
        &desk.partials,
        &marks,
        &pair.gates,
        &centers,
        &slopes,
    ];
    record.run(&kernels::NCC, &buffers, desk.groups(Region::Ncc));
    let reduce = [params, &*desk.partials, &*desk.terms];
    record.run(&kernels::REDUCE, &reduce, Groups::Count(params::REGIONS as u64));
    record.run(&kernels::PATCHES, &[params, grads, &*desk.terms, &*centers, &*slopes], desk.groups(Region::Ncc));
    Ok(())
}

/// As `loss_total` writes them.
fn values_of(rows: &[[f32; 4]]) -> LossValues {
    let three = |[a, b, c, _]: [f32; 4]| [a, b, c];
    LossValues {
        total: rows[0][0],
        l1: rows[0][1],
        dssim: rows[0][2],
        flatness: rows[0][3],
        normal: rows[1][0],
        geometric: rows[1][1],
        geometric_valid: rows[1][2],
        ncc: rows[1][3],
        ncc_patches: rows[2][0] as u32,
        load: rows[2][1],
        free_opacity: rows[2][2],
        d_gain: three(rows[3]),
        d_bias: three(rows[4]),
    }
}

#[cfg(test)]
mod tests;
