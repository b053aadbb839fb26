//! Eq. 10-11: all terms with weight, their sum, and the gradient of every rendered map.
//!
//! ```text
//! L = L_rgb + λ₁ L_geo + λ₂ L_ncc + λ₃ L_s + λ₄ L_ban + λ_free L_free + λ/(1−λ) · s σ
//! ```
//! The paper's overall factor (1 − λ) is dropped: Adam ignores it, and it would only move thresholds.
//! Depth is made of N and D here (Eq. 4), so that the terms speak of depth and backends of N and D alone.

use super::boundary_normal::{NormalGradients, NormalMaps, boundary_normal};
use super::free_opacity::free_opacity;
use super::geometric::{DepthView, geometric};
use super::load_balance::load_balance;
use super::ncc::{NccInputs, ncc};
use super::photometric::{PhotometricWeights, photometric};
use super::spare::Spare;
use rayon::prelude::*;

use super::view::LossView;
use crate::backend::{Exposure, LossValues, LossWeights};
use crate::equations::Scalar;
use crate::equations::algebra::{Vec3, each};
use crate::equations::number::{Kernel, Pixels};
use crate::equations::plane;
use crate::equations::projection::Lens;

/// The load term's size relative to the main loss, before λ. Published code: between 0.1 and 1, by decades.
const LOAD_TO_MAIN: f64 = 0.1;
/// λ is held below this, where λ/(1−λ) is still a weight.
const LOAD_SHARE_MAX: f64 = 0.95;

/// Rows that a thread takes at a time, at least.
const ROWS_AT_ONCE: usize = 8;

/// What was rendered, `[H * W]` each; `normal` and `distance` may be empty without planes, `load` without load.
#[derive(Clone, Copy, Debug)]
pub struct RenderedMaps<'a, T> {
    /// Before exposure, black background: R, G, B.
    pub color: [&'a [T]; 3],
    /// Blended N, camera frame: x, y, z.
    pub normal: [&'a [T]; 3],
    /// Blended D, scene units.
    pub distance: &'a [T],
    /// 1 − T.
    pub opacity: &'a [T],
    /// Blended entries.
    pub load: &'a [T],
}

/// Gradients of the total with respect to rendered maps, `[H * W]` each; empty where no term asks for them. Where buffers
/// are used again, pixels that are neither active nor free keep what an earlier evaluation left there.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapGradients<T> {
    /// Of the colour before exposure: R, G, B.
    pub color: [Vec<T>; 3],
    /// Of N: x, y, z.
    pub normal: [Vec<T>; 3],
    /// Of D.
    pub distance: Vec<T>,
    /// Of 1 − T.
    pub opacity: Vec<T>,
    /// Of the load; reaches alpha by `equations::blend::load_grad`, and not the density statistics.
    pub load: Vec<T>,
}

/// All that the terms look at.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<'a, T> {
    /// The reference view.
    pub view: &'a LossView,
    /// Its render.
    pub maps: RenderedMaps<'a, T>,
    /// A neighbour and its render; without one the multi-view terms are 0.
    pub neighbor: Option<(&'a LossView, RenderedMaps<'a, T>)>,
    /// Of the reference view.
    pub exposure: Exposure,
    /// Weights and forms.
    pub weights: &'a LossWeights,
    /// Value of `flatness::flatness`, which the backend computes where the scales are.
    pub flatness: f64,
    /// Decides which NCC patches are drawn.
    pub seed: u64,
}

/// Values and gradients; reused from step to step, so that no page is asked of the system twice.
#[derive(Clone, Debug, Default)]
pub struct Evaluation<T> {
    /// Every term, unweighted; the weighted sum; the gradient of the exposure.
    pub values: LossValues,
    /// The weighted sum, unrounded.
    pub total: f64,
    /// For the reference render.
    pub reference: MapGradients<T>,
    /// For the neighbour's render.
    pub neighbor: MapGradients<T>,
    /// Depths of both views.
    depth: [Vec<T>; 2],
    /// Their gradients.
    d_depth: [Vec<T>; 2],
    /// Of the geometric term's pixels.
    gates: Vec<T>,
    /// Memory to work in.
    rooms: Spare<Vec<T>>,
}

/// All terms with weight.
#[must_use]
pub fn evaluate<T: Scalar>(inputs: &Inputs<'_, T>) -> Evaluation<T> {
    let mut out = Evaluation::default();
    evaluate_into(inputs, &mut out);
    out
}

/// The same, into the buffers of an earlier evaluation.
pub fn evaluate_into<T: Scalar>(inputs: &Inputs<'_, T>, out: &mut Evaluation<T>) {
    let weights = inputs.weights;
    out.values = LossValues::default();
    let mut main = f64::from(weights.flatness) * inputs.flatness;
    out.values.flatness = inputs.flatness as f32;
    main += add_photometric(inputs, out);
    main += add_surface(inputs, out);
    size(&mut out.reference.opacity, inputs.view, weights.free_opacity != 0.0);
    if weights.free_opacity != 0.0 {
        let weight = f64::from(weights.free_opacity);
        out.reference.opacity.fill(T::zero());
        let value = free_opacity(inputs.view, inputs.maps.opacity, weight, &mut out.reference.opacity);
        out.values.free_opacity = value as f32;
        main += weight * value;
    }
    out.total = main + add_load(inputs, main, out);
    out.values.total = out.total as f32;
}

/// Makes a map as large as a view, with whatever it held, or empty.
fn size<T: Scalar>(map: &mut Vec<T>, view: &LossView, wanted: bool) {
    if wanted { map.resize(view.width * view.height, T::zero()) } else { map.clear() }
}

/// Makes a map 0 wherever somebody may look at it.
fn clear<T: Scalar>(view: &LossView, map: &mut [T]) {
    let rows = map.par_chunks_mut(view.width.max(1)).with_min_len(ROWS_AT_ONCE).enumerate();
    rows.for_each(|(y, row)| row[view.reach(y)].fill(T::zero()));
}

/// The same for the rows of a map from `first` on.
#[inline(always)]
pub(super) fn clear_rows<T: Scalar>(view: &LossView, first: usize, map: &mut [T]) {
    for (y, row) in map.chunks_exact_mut(view.width.max(1)).enumerate() {
        row[view.reach(first + y)].fill(T::zero());
    }
}

fn add_photometric<T: Scalar>(inputs: &Inputs<'_, T>, out: &mut Evaluation<T>) -> f64 {
    let weights = PhotometricWeights {
        l1: f64::from(inputs.weights.l1),
        dssim: f64::from(inputs.weights.dssim),
        mean_over_mask: inputs.weights.mean_over_mask,
    };
    let wanted = weights.l1 != 0.0 || weights.dssim != 0.0;
    out.reference.color.iter_mut().for_each(|map| size(map, inputs.view, wanted));
    if !wanted {
        return 0.0;
    }
    let d_color = out.reference.color.each_mut().map(|map| &mut map[..]);
    let term = photometric(inputs.view, inputs.maps.color, &inputs.exposure, &weights, d_color, &out.rooms);
    out.values.l1 = term.l1 as f32;
    out.values.dssim = term.dssim as f32;
    out.values.d_gain = term.d_gain.map(|value| value as f32);
    out.values.d_bias = term.d_bias.map(|value| value as f32);
    weights.l1 * term.l1 + weights.dssim * term.dssim
}

/// The terms that look at planes: Eq. 8 and the multi-view ones.
fn add_surface<T: Scalar>(inputs: &Inputs<'_, T>, out: &mut Evaluation<T>) -> f64 {
    let (view, weights) = (inputs.view, inputs.weights);
    let pair = inputs.neighbor.filter(|_| weights.geometric != 0.0 || weights.ncc != 0.0);
    let wanted = weights.normal != 0.0 || pair.is_some();
    let MapGradients { normal, distance, .. } = &mut out.reference;
    normal.iter_mut().chain([distance]).for_each(|map| size(map, view, wanted));
    let MapGradients { normal, distance, .. } = &mut out.neighbor;
    let other = pair.filter(|_| weights.geometric != 0.0);
    let other_view = other.map_or(view, |(view, _)| view);
    normal.iter_mut().chain([distance]).for_each(|map| size(map, other_view, other.is_some()));
    if !wanted {
        return 0.0;
    }
    depth_map(view, &inputs.maps, &mut out.depth[0]);
    size(&mut out.d_depth[0], view, true);
    let mut sum = 0.0;
    if let Some((other, maps)) = pair {
        sum += f64::from(weights.geometric) * add_geometric(inputs, (other, &maps), out);
    }
    if weights.geometric == 0.0 || pair.is_none() {
        clear(view, &mut out.d_depth[0]);
    }
    let MapGradients { normal, distance, .. } = &mut out.reference;
    if weights.normal == 0.0 {
        normal.iter_mut().for_each(|map| clear(view, map));
        chain_depth(view, &inputs.maps, &out.d_depth[0], &mut out.reference);
    } else {
        let gradients =
            NormalGradients { normal: normal.each_mut().map(|map| &mut map[..]), depth: &mut out.d_depth[0], distance };
        let maps = NormalMaps { normal: inputs.maps.normal, opacity: inputs.maps.opacity, depth: &out.depth[0] };
        let weight = f64::from(weights.normal);
        let chain = |y: usize, d_depth: &[T], d_normal: [&mut [T]; 3], d_distance: &mut [T]| {
            T::widest(ChainRow { view, maps: &inputs.maps, d_depth, y, d_normal, d_distance });
        };
        let value = boundary_normal(view, maps, weights, weight, gradients, chain, &out.rooms);
        out.values.normal = value as f32;
        sum += weight * value;
    }
    if let Some((other, _)) = pair {
        sum += add_ncc(inputs, other, out);
    }
    sum
}

/// L_mvgeo, unweighted; the neighbour's gradient is carried to its N and D.
fn add_geometric<T: Scalar>(
    inputs: &Inputs<'_, T>,
    (other, maps): (&LossView, &RenderedMaps<'_, T>),
    out: &mut Evaluation<T>,
) -> f64 {
    let [depth, other_depth] = &mut out.depth;
    let [d_depth, d_other] = &mut out.d_depth;
    depth_map(other, maps, other_depth);
    size(d_other, other, true);
    clear(other, d_other);
    size(&mut out.gates, inputs.view, true);
    let weight = f64::from(inputs.weights.geometric);
    let gate_px = f64::from(inputs.weights.geometric_gate_px);
    let reference = DepthView { view: inputs.view, depth };
    let neighbor = DepthView { view: other, depth: other_depth };
    let found = geometric(reference, neighbor, gate_px, weight, &mut out.gates, [d_depth, d_other]);
    out.values.geometric = found.value as f32;
    out.values.geometric_valid = found.valid_count as f32 / inputs.view.active_count.max(1) as f32;
    if weight != 0.0 {
        out.neighbor.normal.iter_mut().for_each(|map| clear(other, map));
        chain_depth(other, maps, d_other, &mut out.neighbor);
    }
    found.value
}

/// L_mvrgb; returns its weighted value.
fn add_ncc<T: Scalar>(inputs: &Inputs<'_, T>, neighbor: &LossView, out: &mut Evaluation<T>) -> f64 {
    let weight = f64::from(inputs.weights.ncc);
    if weight == 0.0 {
        return 0.0;
    }
    let patches = NccInputs {
        view: inputs.view,
        neighbor,
        normal: inputs.maps.normal,
        distance: inputs.maps.distance,
        weights: &out.gates,
        patch_limit: inputs.weights.ncc_patches as usize,
        seed: inputs.seed,
    };
    let MapGradients { normal, distance, .. } = &mut out.reference;
    let (value, kept) = ncc(&patches, weight, normal.each_mut().map(|map| &mut map[..]), distance);
    out.values.ncc = value as f32;
    out.values.ncc_patches = kept as u32;
    weight * value
}

/// λ/(1−λ) · s σ with s = 0.1 · (L_main / σ), held constant: one order below the main loss, as in the published code,
/// but without its jumps by powers of ten. Returns its part of the total.
fn add_load<T: Scalar>(inputs: &Inputs<'_, T>, main: f64, out: &mut Evaluation<T>) -> f64 {
    let share = f64::from(inputs.weights.load);
    let wanted = share != 0.0 && !inputs.maps.load.is_empty();
    size(&mut out.reference.load, inputs.view, wanted);
    if !wanted {
        return 0.0;
    }
    let weight = share / (1.0 - share.min(LOAD_SHARE_MAX));
    let scale = |sigma: f64| weight * LOAD_TO_MAIN * main / sigma;
    out.reference.load.fill(T::zero());
    let (reading, over_mask) = (inputs.weights.reading, inputs.weights.mean_over_mask);
    let sigma = load_balance(inputs.view, inputs.maps.load, reading, over_mask, scale, &mut out.reference.load);
    out.values.load = sigma as f32;
    if sigma > 0.0 { weight * LOAD_TO_MAIN * main } else { 0.0 }
}

/// Unbiased depth (Eq. 4) of the active pixels, 0 elsewhere.
pub fn depth_map<T: Scalar>(view: &LossView, maps: &RenderedMaps<'_, T>, depth: &mut Vec<T>) {
    size(depth, view, true);
    let rows = depth.par_chunks_mut(view.width.max(1)).with_min_len(ROWS_AT_ONCE).enumerate();
    rows.for_each(|(y, depth)| T::widest(DepthRow { view, maps, y, depth }));
}

/// One row of [`depth_map`].
struct DepthRow<'a, T> {
    view: &'a LossView,
    maps: &'a RenderedMaps<'a, T>,
    y: usize,
    depth: &'a mut [T],
}

impl<T: Scalar> Kernel<T> for DepthRow<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<P: Pixels<T>>(self) {
        let lens = Lens::<P>::new(&self.view.camera);
        let span = self.view.spans[self.y].clone();
        let (start, end) = (self.y * self.view.width, self.y * self.view.width + span.end);
        self.depth.fill(T::zero());
        for x in span.clone().step_by(P::LEN) {
            let active = P::from_bytes(bytemuck::cast_slice(&self.view.active[start + x..end]));
            let (distance, normal) = planes(self.maps, start + x);
            let depth = plane::depth(distance, normal, ray(&lens, x, self.y));
            (active * depth).store(&mut self.depth[x..span.end]);
        }
    }
}

/// D and N from a pixel on.
#[inline(always)]
fn planes<T: Scalar, P: Pixels<T>>(maps: &RenderedMaps<'_, T>, index: usize) -> (P, Vec3<P>) {
    (P::load(&maps.distance[index..]), each(|k| P::load(&maps.normal[k][index..])))
}

/// Rays from (x, y) on along the row.
#[inline(always)]
pub(super) fn ray<T: Scalar, P: Pixels<T>>(lens: &Lens<P>, x: usize, y: usize) -> Vec3<P> {
    lens.ray(P::count_from(x), P::from_f64(y as f64))
}

/// Carries the gradient of depth to N, to which it is added, and D, where it is written.
fn chain_depth<T: Scalar>(view: &LossView, maps: &RenderedMaps<'_, T>, d_depth: &[T], gradients: &mut MapGradients<T>) {
    let width = view.width.max(1);
    let MapGradients { normal, distance, .. } = gradients;
    let [x, y, z] = normal.each_mut().map(|map| map.par_chunks_mut(width));
    let rows = x.zip(y).zip(z).zip(distance.par_chunks_mut(width)).with_min_len(ROWS_AT_ONCE).enumerate();
    rows.for_each(|(row, (((x, y), z), d_distance))| {
        let d_depth = &d_depth[row * width..(row + 1) * width];
        T::widest(ChainRow { view, maps, d_depth, y: row, d_normal: [x, y, z], d_distance });
    });
}

/// One row of [`chain_depth`]; `d_depth` and the gradients are rows.
struct ChainRow<'a, T> {
    view: &'a LossView,
    maps: &'a RenderedMaps<'a, T>,
    d_depth: &'a [T],
    y: usize,
    d_normal: [&'a mut [T]; 3],
    d_distance: &'a mut [T],
}

impl<T: Scalar> Kernel<T> for ChainRow<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<P: Pixels<T>>(self) {
        let lens = Lens::<P>::new(&self.view.camera);
        let span = self.view.spans[self.y].clone();
        let start = self.y * self.view.width;
        self.d_distance[self.view.reach(self.y)].fill(T::zero());
        for x in span.clone().step_by(P::LEN) {
            let (distance, normal) = planes(self.maps, start + x);
            // 0 at inactive pixels, which have no depth.
            let d_depth = P::load(&self.d_depth[x..span.end]);
            let (d_distance, d_normal) = plane::depth_grad(distance, normal, ray(&lens, x, self.y), d_depth);
            d_distance.store(&mut self.d_distance[x..span.end]);
            for k in 0..3 {
                let out = &mut self.d_normal[k][x..span.end];
                (P::load(out) + d_normal[k]).store(out);
            }
        }
    }
}

#[cfg(test)]
mod tests;
