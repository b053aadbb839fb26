//! Eq. 10-11: all terms with weight, their sum, and the gradient of every rendered map.
//!
//! ```text
//! L = L_rgb + λ₁ L_geo + λ₂ L_ncc + λ₃ L_s + λ₄ L_ban + λ_free L_free + λ/(1−λ) · s σ
//! ```
//! The paper's overall factor (1 − λ) is dropped: Adam ignores it, and it would only move thresholds.
//! Depth is made of N and D here (Eq. 4), so that the terms speak of depth and backends of N and D alone.

use super::boundary_normal::{NormalMaps, boundary_normal};
use super::free_opacity::free_opacity;
use super::geometric::{DepthView, Geometric, geometric};
use super::load_balance::load_balance;
use super::ncc::{NccInputs, ncc};
use super::photometric::{PhotometricWeights, photometric};
use super::rows::sum_rows;
use super::view::LossView;
use crate::backend::{Exposure, LossValues, LossWeights};
use crate::equations::Scalar;
use crate::equations::algebra::{Vec3, add};
use crate::equations::plane;
use crate::equations::projection::Lens;

/// The load term's size relative to the main loss, before λ. Published code: between 0.1 and 1, by decades.
const LOAD_TO_MAIN: f64 = 0.1;
/// λ is held below this, where λ/(1−λ) is still a weight.
const LOAD_SHARE_MAX: f64 = 0.95;

/// What was rendered, `[H * W]` each; `normal` and `distance` may be empty without planes, `load` without load.
#[derive(Clone, Copy, Debug)]
pub struct RenderedMaps<'a, T> {
    /// Before exposure, black background.
    pub color: &'a [[T; 3]],
    /// Blended N, camera frame.
    pub normal: &'a [Vec3<T>],
    /// Blended D, scene units.
    pub distance: &'a [T],
    /// 1 − T.
    pub opacity: &'a [T],
    /// Blended entries.
    pub load: &'a [T],
}

/// Gradients of the total with respect to rendered maps, `[H * W]` each; empty where no term asks for them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapGradients<T> {
    /// Of the colour before exposure.
    pub color: Vec<[T; 3]>,
    /// Of N.
    pub normal: Vec<[T; 3]>,
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

/// Values and gradients.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Evaluation<T> {
    /// Every term, unweighted; the weighted sum; the gradient of the exposure.
    pub values: LossValues,
    /// The weighted sum, unrounded.
    pub total: f64,
    /// For the reference render.
    pub reference: MapGradients<T>,
    /// For the neighbour's render.
    pub neighbor: MapGradients<T>,
}

/// All terms with weight.
#[must_use]
pub fn evaluate<T: Scalar>(inputs: &Inputs<'_, T>) -> Evaluation<T> {
    let mut out = Evaluation::default();
    let weights = inputs.weights;
    let mut main = f64::from(weights.flatness) * inputs.flatness;
    out.values.flatness = inputs.flatness as f32;
    main += add_photometric(inputs, &mut out);
    main += add_surface(inputs, &mut out);
    if weights.free_opacity != 0.0 {
        let weight = f64::from(weights.free_opacity);
        out.reference.opacity = zeros(inputs.view);
        let value = free_opacity(inputs.view, inputs.maps.opacity, weight, &mut out.reference.opacity);
        out.values.free_opacity = value as f32;
        main += weight * value;
    }
    out.total = main + add_load(inputs, main, &mut out);
    out.values.total = out.total as f32;
    out
}

fn zeros<V: Clone + Default>(view: &LossView) -> Vec<V> {
    vec![V::default(); view.width * view.height]
}

fn add_photometric<T: Scalar>(inputs: &Inputs<'_, T>, out: &mut Evaluation<T>) -> f64 {
    let weights = PhotometricWeights {
        l1: f64::from(inputs.weights.l1),
        dssim: f64::from(inputs.weights.dssim),
        mean_over_mask: inputs.weights.mean_over_mask,
    };
    if weights.l1 == 0.0 && weights.dssim == 0.0 {
        return 0.0;
    }
    out.reference.color = zeros(inputs.view);
    let term = photometric(inputs.view, inputs.maps.color, &inputs.exposure, &weights, &mut out.reference.color);
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
    if weights.normal == 0.0 && pair.is_none() {
        return 0.0;
    }
    let depth = depth_map(view, &inputs.maps);
    let mut d_depth = zeros(view);
    out.reference.normal = zeros(view);
    out.reference.distance = zeros(view);
    let mut sum = 0.0;
    if weights.normal != 0.0 {
        let maps = NormalMaps { normal: inputs.maps.normal, opacity: inputs.maps.opacity, depth: &depth };
        let weight = f64::from(weights.normal);
        let value = boundary_normal(view, maps, weights, weight, &mut out.reference.normal, &mut d_depth);
        out.values.normal = value as f32;
        sum += weight * value;
    }
    if let Some((other, maps)) = pair {
        let gates = add_geometric(inputs, DepthView { view, depth: &depth }, (other, &maps), &mut d_depth, out);
        sum += f64::from(weights.geometric) * gates.value + add_ncc(inputs, other, &gates.weights, out);
    }
    chain_depth(view, &inputs.maps, &d_depth, &mut out.reference);
    sum
}

/// L_mvgeo; the neighbour's gradient is carried to its N and D.
fn add_geometric<T: Scalar>(
    inputs: &Inputs<'_, T>,
    reference: DepthView<'_, T>,
    (other, maps): (&LossView, &RenderedMaps<'_, T>),
    d_depth: &mut [T],
    out: &mut Evaluation<T>,
) -> Geometric<T> {
    let depth = depth_map(other, maps);
    let mut d_other = zeros(other);
    let weight = f64::from(inputs.weights.geometric);
    let gate_px = f64::from(inputs.weights.geometric_gate_px);
    let neighbor = DepthView { view: other, depth: &depth };
    let found = geometric(reference, neighbor, gate_px, weight, [d_depth, &mut d_other]);
    out.values.geometric = found.value as f32;
    out.values.geometric_valid = found.valid_count as f32 / reference.view.active_count.max(1) as f32;
    if weight != 0.0 {
        out.neighbor.normal = zeros(other);
        out.neighbor.distance = zeros(other);
        chain_depth(other, maps, &d_other, &mut out.neighbor);
    }
    found
}

/// L_mvrgb; returns its weighted value.
fn add_ncc<T: Scalar>(inputs: &Inputs<'_, T>, neighbor: &LossView, gates: &[T], out: &mut Evaluation<T>) -> f64 {
    let weight = f64::from(inputs.weights.ncc);
    if weight == 0.0 {
        return 0.0;
    }
    let patches = NccInputs {
        view: inputs.view,
        neighbor,
        normal: inputs.maps.normal,
        distance: inputs.maps.distance,
        weights: gates,
        patch_limit: inputs.weights.ncc_patches as usize,
        seed: inputs.seed,
    };
    let MapGradients { normal, distance, .. } = &mut out.reference;
    let (value, kept) = ncc(&patches, weight, normal, distance);
    out.values.ncc = value as f32;
    out.values.ncc_patches = kept as u32;
    weight * value
}

/// λ/(1−λ) · s σ with s = 0.1 · (L_main / σ), held constant: one order below the main loss, as in the published code,
/// but without its jumps by powers of ten. Returns its part of the total.
fn add_load<T: Scalar>(inputs: &Inputs<'_, T>, main: f64, out: &mut Evaluation<T>) -> f64 {
    let share = f64::from(inputs.weights.load);
    if share == 0.0 || inputs.maps.load.is_empty() {
        return 0.0;
    }
    let weight = share / (1.0 - share.min(LOAD_SHARE_MAX));
    let scale = |sigma: f64| weight * LOAD_TO_MAIN * main / sigma;
    out.reference.load = zeros(inputs.view);
    let (reading, over_mask) = (inputs.weights.reading, inputs.weights.mean_over_mask);
    let sigma = load_balance(inputs.view, inputs.maps.load, reading, over_mask, scale, &mut out.reference.load);
    out.values.load = sigma as f32;
    if sigma > 0.0 { weight * LOAD_TO_MAIN * main } else { 0.0 }
}

/// Unbiased depth (Eq. 4) of the active pixels, 0 elsewhere.
#[must_use]
pub fn depth_map<T: Scalar>(view: &LossView, maps: &RenderedMaps<'_, T>) -> Vec<T> {
    let lens = Lens::<T>::new(&view.camera);
    let mut depth: Vec<T> = zeros(view);
    sum_rows(&mut depth, view.width, |y, row| {
        for x in view.spans[y].clone() {
            let index = y * view.width + x;
            if view.is_active(index) {
                let ray = lens.ray(T::from_f64(x as f64), T::from_f64(y as f64));
                row[x] = plane::depth(maps.distance[index], maps.normal[index], ray);
            }
        }
        0.0
    });
    depth
}

/// Carries the gradient of depth to N and D.
fn chain_depth<T: Scalar>(view: &LossView, maps: &RenderedMaps<'_, T>, d_depth: &[T], gradients: &mut MapGradients<T>) {
    let lens = Lens::<T>::new(&view.camera);
    let MapGradients { normal, distance, .. } = gradients;
    let mut rows: Vec<(&mut [[T; 3]], &mut [T])> =
        normal.chunks_mut(view.width.max(1)).zip(distance.chunks_mut(view.width.max(1))).collect();
    sum_rows(&mut rows, 1, |y, row| {
        let (d_normal, d_distance) = &mut row[0];
        for x in view.spans[y].clone() {
            let index = y * view.width + x;
            if view.is_active(index) {
                let ray = lens.ray(T::from_f64(x as f64), T::from_f64(y as f64));
                let (d_d, d_n) = plane::depth_grad(maps.distance[index], maps.normal[index], ray, d_depth[index]);
                d_distance[x] += d_d;
                d_normal[x] = add(d_normal[x], d_n);
            }
        }
        0.0
    });
}

#[cfg(test)]
mod tests;
