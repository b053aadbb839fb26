//! What the host tells the shaders of a step, and where their partial sums lie.

use bytemuck::{Pod, Zeroable};
use pgsag_splat::backend::{Reading, ViewCamera};
use pgsag_splat::equations::algebra::{mat_mul, mat_vec, sub, transpose};

use super::{BLOCK, Request, Side};
use crate::view::TILE;

/// Rows of four in the buffer of sums and values.
pub(super) const TERMS: u64 = 16;
/// The first row of values, as `VALUES` in the shaders.
pub(super) const VALUES: u64 = 10;
/// Rows of values.
pub(super) const VALUE_ROWS: usize = 5;
/// Patches of a workgroup.
pub(super) const PATCHES: u32 = 64;
/// The load term's size relative to the main loss, before λ, and the bound of λ: as `losses::total`.
const LOAD_TO_MAIN: f64 = 0.1;
const LOAD_SHARE_MAX: f64 = 0.95;

/// Partial sums of one kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Region {
    Ssim = 0,
    Photo = 1,
    Normal = 4,
    Geometric = 5,
    Ncc = 6,
    Free = 7,
    Load = 8,
}

/// Regions; colours have one per channel.
pub(super) const REGIONS: usize = 9;

/// Which kernels run, in how many groups.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    /// First group and number of groups of every region.
    regions: [[u32; 4]; REGIONS],
    /// Groups of all regions.
    pub(super) groups: u32,
}

impl Plan {
    pub(super) fn new(request: &Request<'_>) -> Self {
        let (view, weights) = (request.reference.view, request.weights);
        let (tiles, frame) = (view.active.count, across(view.active.width) * across(view.active.height));
        let has_pair = request.pair().is_some();
        let some = |wanted: bool, count: u32| if wanted { count } else { 0 };
        let photo = some(weights.l1 != 0.0 || weights.dssim != 0.0, tiles);
        let patches = weights.ncc_patches.min(view.losses.pixel_count as u32).div_ceil(PATCHES);
        let counts = [
            some(weights.dssim != 0.0, 3 * if weights.mean_over_mask { tiles } else { frame }),
            photo,
            photo,
            photo,
            some(weights.normal != 0.0, tiles),
            some(has_pair, tiles),
            some(has_pair && weights.ncc != 0.0, patches),
            some(weights.free_opacity != 0.0 && view.losses.free_count > 0, frame),
            some(weights.load != 0.0 && request.has_load, frame),
        ];
        let mut groups = 0;
        let regions = counts.map(|count| {
            let first = groups;
            groups += count;
            [first, count, 0, 0]
        });
        Self { regions, groups }
    }

    pub(super) fn count(&self, region: Region) -> u32 {
        self.regions[region as usize][1]
    }

    /// What the shaders are told.
    pub(super) fn params(&self, request: &Request<'_>) -> Params {
        let other = request.neighbor.unwrap_or(request.reference);
        let (view, weights) = (request.reference.view, request.weights);
        let mean = view.losses.mean_count(weights.mean_over_mask) as f64;
        let per_value = 1.0 / (3.0 * mean);
        let free = 1.0 / view.losses.free_count.max(1) as f64;
        let load = f64::from(weights.load);
        let flatness = if weights.flatness == 0.0 { 0.0 } else { 1.0 / f64::from(request.scene_scale) };
        let with = |[x, y, z]: [f32; 3], w: f64| [x, y, z, w as f32];
        let four = |values: [f64; 4]| values.map(|value| value as f32);
        let flag = u32::from;
        Params {
            gain: with(request.exposure.gain, f64::from(weights.l1) * per_value),
            bias: with(request.exposure.bias, f64::from(weights.dssim) * per_value),
            normal: four([f64::from(weights.normal) / mean, 1.0 - f64::from(weights.normal_boundary), 0.0, 0.0]),
            multi: [
                weights.geometric,
                weights.geometric_gate_px,
                weights.ncc,
                (LOAD_TO_MAIN * load / (1.0 - load.min(LOAD_SHARE_MAX))) as f32,
            ],
            extra: four([
                f64::from(weights.free_opacity),
                f64::from(weights.free_opacity) * free,
                f64::from(weights.flatness),
                flatness,
            ]),
            shares: four([per_value, 1.0 / mean, 1.0 / view.losses.active_count.max(1) as f64, free]),
            weights: [weights.l1, weights.dssim, weights.normal, 0.0],
            draw: [
                weights.ncc_patches,
                request.seed as u32,
                (request.seed >> 32) as u32,
                view.losses.pixel_count.div_ceil(BLOCK) as u32,
            ],
            flags: [
                flag(weights.reading == Reading::Paper),
                flag(weights.normal_image_gradient),
                flag(!weights.mean_over_mask),
                flag(weights.dssim != 0.0),
            ],
            regions: self.regions,
            ..Params::between(request.reference, other)
        }
    }

    /// The same for the neighbour in place of the reference, as far as its gradient of depth asks for it.
    pub(super) fn swapped(&self, request: &Request<'_>) -> Params {
        let other = request.neighbor.unwrap_or(request.reference);
        let mut params = Params { multi: self.params(request).multi, ..Params::between(other, request.reference) };
        params.regions[Region::Geometric as usize] = [0, other.view.active.count, 0, 0];
        params
    }
}

fn across(pixels: u32) -> u32 {
    pixels.div_ceil(TILE)
}

/// `Params` in `loss_params.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct Params {
    size: [u32; 4],
    other_size: [u32; 4],
    lens: [f32; 4],
    other_lens: [f32; 4],
    inverse: [f32; 4],
    other_inverse: [f32; 4],
    between: [[f32; 4]; 3],
    gain: [f32; 4],
    bias: [f32; 4],
    normal: [f32; 4],
    multi: [f32; 4],
    extra: [f32; 4],
    shares: [f32; 4],
    weights: [f32; 4],
    draw: [u32; 4],
    flags: [u32; 4],
    regions: [[u32; 4]; REGIONS],
}

impl Params {
    /// Sizes and lenses of two views, and the way between them; composed in f64.
    fn between(reference: Side<'_>, other: Side<'_>) -> Self {
        let size = |side: Side<'_>| {
            let (width, height) = (side.view.active.width, side.view.active.height);
            [width, height, width * height, across(width)]
        };
        let (own, far) = (&reference.view.losses.camera, &other.view.losses.camera);
        let rotation = mat_mul(&far.rotation, &transpose(&own.rotation));
        let translation = sub(far.translation, mat_vec(&rotation, own.translation));
        let row = |k: usize| {
            let [x, y, z] = rotation[k];
            [x, y, z, translation[k]].map(|value| value as f32)
        };
        Self {
            size: size(reference),
            other_size: size(other),
            lens: lens(own),
            other_lens: lens(far),
            inverse: inverse(own),
            other_inverse: inverse(far),
            between: [row(0), row(1), row(2)],
            ..Self::zeroed()
        }
    }
}

fn lens(camera: &ViewCamera) -> [f32; 4] {
    let pinhole = &camera.pinhole;
    [pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy].map(|value| value as f32)
}

fn inverse(camera: &ViewCamera) -> [f32; 4] {
    [1.0 / camera.pinhole.fx, 1.0 / camera.pinhole.fy, camera.near, 0.0].map(|value| value as f32)
}
