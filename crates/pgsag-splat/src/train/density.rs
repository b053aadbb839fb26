//! Which Gaussians are cloned, split or removed: a policy over numbers, without any device (method.md 2.8, 8.1, 8.2).
//!
//! Sizes are in reference pixels (1/1000 rad from the finest view) and gradients per reference pixel of motion and
//! pixel covered, so that crops and scales of one scene lead to the same decisions.

use serde::{Deserialize, Serialize};

use crate::backend::{Birth, DensityPlan, DensityStatistics};
use crate::cloud::SplatCloud;
use crate::train::footprint::{Footprint, REFERENCE_FOCAL_PX};
use crate::train::stream;

pub use agreement::Agreement;
pub(in crate::train) use agreement::VIEWS as AGREEMENT_VIEWS;

/// When and how Gaussians multiply and die.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DensityOptions {
    /// Share of the iterations before the first clone or split. 3DGS: 500/30000.
    pub from: f32,
    /// Share of the iterations after which nothing is born. 3DGS: 15000/30000.
    pub until: f32,
    /// Iterations between decisions. 3DGS: 100.
    pub interval: u32,
    /// Mean gradient of the summed loss per reference pixel of motion and pixel covered, above which a Gaussian
    /// multiplies. 3DGS's 2e-4 in NDC at 1000 x 750 px is 0.3 of the summed loss: this much per pixel covered by a
    /// Gaussian of deviation 5 px.
    pub gradient: f32,
    /// The same for sums of absolute values (AbsGS); infinite switches it off.
    pub absolute_gradient: f32,
    /// At most so many splits by absolute gradient per decision. PGSR: 50 000.
    pub max_absolute_splits: u32,
    /// Gaussians whose largest deviation exceeds this are split, smaller ones cloned; reference pixels.
    /// PGSR: 0.001 of the extent, which is 1.
    pub split_size: f32,
    /// Absolute splits need a largest deviation of at least this, reference pixels. PGSR: radius 20 px, a deviation of 6.7.
    pub absolute_split_size: f32,
    /// Gaussians whose largest deviation is below this do not multiply: the photographs cannot tell their children
    /// apart. Pixels of the finest view.
    pub min_size_px: f32,
    /// Gaussians whose largest deviation exceeds this die, reference pixels. PGSR: 0.1 of the extent, which is 100.
    pub prune_size: f32,
    /// Gaussians fainter than this die. 3DGS: 0.005, PG-SAG: 0.05.
    pub opacity_cull: f32,
    /// What dies as faint is born again on Gaussians drawn by opacity (3DGS-MCMC's relocation).
    pub relocate: bool,
    /// Only Gaussians multiply at which at least this share of ten drawn views that see them show an error (FastGS);
    /// 0: no view is asked.
    pub agreement: f32,
    /// A decision adds at most this share of the Gaussians, those with the largest gradients: while colours are still
    /// unlearnt nearly all of them ask. 3DGS-MCMC: 0.05.
    pub max_growth: f32,
    /// Never more Gaussians than this; from a memory budget.
    pub max_gaussians: usize,
    /// Iterations between multi-view trims, 0 for none. PGSR: 1000.
    pub trim_interval: u32,
    /// Share of the iterations after which nothing is trimmed.
    pub trim_until: f32,
    /// Views that must see a Gaussian, or all that could where they are fewer (method.md 8.8). PGSR: 2.
    pub trim_views: u32,
    /// Share of the iterations between opacity resets; only in runs of 10 000 iterations and more. 3DGS: 3000/30000.
    pub reset_interval: f32,
    /// Ceiling of opacities at a reset. 3DGS: 0.01.
    pub reset_opacity: f32,
}

impl Default for DensityOptions {
    fn default() -> Self {
        Self {
            from: 500.0 / 30_000.0,
            until: 0.5,
            interval: 100,
            gradient: 5e-4,
            absolute_gradient: 2e-3,
            max_absolute_splits: 50_000,
            split_size: 1.0,
            absolute_split_size: 6.7,
            min_size_px: 0.7,
            prune_size: 100.0,
            opacity_cull: 0.02,
            relocate: false,
            agreement: 0.0,
            max_growth: 0.05,
            max_gaussians: 6_000_000,
            trim_interval: 1000,
            trim_until: 0.7,
            trim_views: 2,
            reset_interval: 0.1,
            reset_opacity: 0.01,
        }
    }
}

/// Parameters, gradients and two moments of a Gaussian with these harmonics, and its share of a render, bytes.
#[must_use]
pub fn bytes_per_gaussian(sh_degree: u8) -> u64 {
    let parameters = 11 + 3 * (u64::from(sh_degree) + 1).pow(2);
    // Two renders are held at a time: records, pairs and their sums.
    4 * 4 * parameters + 2 * 1024
}

/// What a decision looks at.
#[derive(Clone, Copy, Debug)]
pub struct DensityInput<'a> {
    /// Parameters now.
    pub cloud: &'a SplatCloud,
    /// Sums since the last decision.
    pub statistics: &'a DensityStatistics,
    /// `[N]` as the finest view has each Gaussian.
    pub footprints: &'a [Footprint],
    /// Whether faint Gaussians may die now.
    pub cull: bool,
    /// Where views show errors; `None`: every Gaussian may multiply.
    pub agreement: Option<&'a Agreement>,
    /// With `iteration` and the index it decides where children appear.
    pub seed: u64,
    /// Iteration in progress.
    pub iteration: u32,
}

/// How a Gaussian multiplies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Growth {
    Clone,
    Split,
}

/// Shrink of a split's children: ln 1.6 (3DGS).
const SPLIT_SHRINK: f32 = 0.470_003_63;

/// Clones, splits and prunes of one decision.
#[must_use]
pub fn plan_density(input: &DensityInput<'_>, options: &DensityOptions) -> DensityPlan {
    let count = input.cloud.len();
    let mut dead = vec![false; count];
    for i in 0..count {
        dead[i] = is_dead(input, i, options);
    }
    let mut wishes = growth_wishes(input, &dead, options);
    let alive = dead.iter().filter(|dead| !**dead).count();
    // A clone and a split each add one Gaussian.
    let most = (f64::from(options.max_growth) * alive as f64).ceil() as usize;
    let room = options.max_gaussians.saturating_sub(alive).min(most);
    if wishes.len() > room {
        wishes.sort_unstable_by(|a, b| b.2.total_cmp(&a.2).then(a.0.cmp(&b.0)));
        wishes.truncate(room);
        wishes.sort_unstable_by_key(|wish| wish.0);
    }
    let mut births = Vec::with_capacity(2 * wishes.len());
    if options.relocate {
        let mut busy = vec![false; count];
        wishes.iter().for_each(|wish| busy[wish.0] = true);
        let faint = (0..count).filter(|&i| is_faint(input, i, options)).count();
        births.extend(relocate::relocations(input, faint, &mut dead, &busy));
    }
    for &(i, growth, _) in &wishes {
        let mut random = stream(input.seed, input.iteration, i as u64);
        let (children, shift) = match growth {
            Growth::Clone => (1, 0.0),
            Growth::Split => (2, -SPLIT_SHRINK),
        };
        for _ in 0..children {
            births.push(Birth {
                parent: i as u32,
                offset: sample_offset(input.cloud, i, &mut random),
                log_scale_shift: shift,
                opacity_logit: None,
            });
        }
        dead[i] |= growth == Growth::Split;
    }
    let keep = (0..count as u32).filter(|i| !dead[*i as usize]).collect();
    DensityPlan { keep, births, opacity_ceiling: None }
}

/// Keeps what enough views saw: `observed[i]` of at least min(`trim_views`, `could_see[i]`), and what some view could see.
#[must_use]
pub fn plan_trim(observed: &[u32], could_see: &[u32], options: &DensityOptions) -> DensityPlan {
    let keep = (0..observed.len())
        .filter(|i| could_see[*i] > 0 && observed[*i] >= options.trim_views.min(could_see[*i]))
        .map(|i| i as u32)
        .collect();
    DensityPlan { keep, births: Vec::new(), opacity_ceiling: None }
}

/// Largest deviation of a Gaussian, scene units.
fn max_scale(cloud: &SplatCloud, i: usize) -> f32 {
    let [a, b, c] = cloud.log_scales[i];
    libm::expf(a.max(b).max(c))
}

fn opacity(logit: f32) -> f32 {
    1.0 / (1.0 + libm::expf(-logit))
}

fn is_faint(input: &DensityInput<'_>, i: usize, options: &DensityOptions) -> bool {
    input.cull && opacity(input.cloud.opacity_logits[i]) < options.opacity_cull
}

fn is_dead(input: &DensityInput<'_>, i: usize, options: &DensityOptions) -> bool {
    let footprint = &input.footprints[i];
    is_faint(input, i, options)
        || (footprint.focal_px > 0.0 && footprint.reference_px(max_scale(input.cloud, i)) > options.prune_size)
}

/// (index, growth, gradient over threshold) of every Gaussian that wants to multiply, ascending by index.
fn growth_wishes(input: &DensityInput<'_>, dead: &[bool], options: &DensityOptions) -> Vec<(usize, Growth, f32)> {
    let mut wishes = Vec::new();
    let mut absolute = Vec::new();
    for i in 0..input.cloud.len() {
        let visible = input.statistics.visible_count[i];
        let footprint = &input.footprints[i];
        let is_refused = input.agreement.is_some_and(|views| !views.is_wrong(i, options.agreement));
        if dead[i] || is_refused || visible == 0 || footprint.focal_px == 0.0 {
            continue;
        }
        let scale = max_scale(input.cloud, i);
        if scale < options.min_size_px * footprint.gsd() {
            continue;
        }
        // Per pixel of motion becomes per reference pixel of motion.
        let per_reference = footprint.focal_px / REFERENCE_FOCAL_PX / visible as f32;
        let excess = input.statistics.gradient[i] * per_reference / options.gradient;
        let absolute_excess = input.statistics.absolute_gradient[i] * per_reference / options.absolute_gradient;
        let size = footprint.reference_px(scale);
        if excess >= 1.0 {
            let growth = if size > options.split_size { Growth::Split } else { Growth::Clone };
            wishes.push((i, growth, excess));
        } else if absolute_excess >= 1.0 && size > options.absolute_split_size {
            absolute.push((i, Growth::Split, absolute_excess));
        }
    }
    let cap = options.max_absolute_splits as usize;
    if absolute.len() > cap {
        absolute.sort_unstable_by(|a, b| b.2.total_cmp(&a.2).then(a.0.cmp(&b.0)));
        absolute.truncate(cap);
    }
    wishes.extend(absolute);
    wishes.sort_unstable_by_key(|wish| wish.0);
    wishes
}

/// A draw of N(0, Σ) of Gaussian `i`: R · diag(s) · ξ.
fn sample_offset(cloud: &SplatCloud, i: usize, random: &mut pgsag_scene::numbers::SplitMix64) -> [f32; 3] {
    let [w, x, y, z] = cloud.rotations[i].map(f64::from);
    let rotation = glam::DQuat::from_xyzw(x, y, z, w).normalize();
    let local = cloud.log_scales[i].map(|log| libm::exp(f64::from(log)) * random.normal());
    (rotation * glam::DVec3::from_array(local)).to_array().map(|v| v as f32)
}

mod agreement;
mod relocate;
#[cfg(test)]
mod tests;
