//! What happens at which iteration: presets, rates, weights, and the calendar of density control.
//!
//! Starts and stops are fractions of the iterations so that any count from 500 up behaves; intervals stay. Iterations
//! count from 1. Fractions restate PGSR's 30 000-iteration calendar (7000/30000 for geometry, 15000/30000 for density).

use serde::{Deserialize, Serialize};

use crate::backend::{LossWeights, Rates, Reading};
use crate::train::density::DensityOptions;

/// Adam step sizes. Colours and shapes as 3DGS; positions in local ground sampling distances (method.md 8.1).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RateOptions {
    /// First position step, in local GSD per step. 3DGS's 1.6e-4 of the extent is 0.16 at 1000 px; runs with fewer
    /// iterations need longer steps. Where it is not set, it follows from the preset's and `iterations`.
    pub position_gsd: f32,
    /// Last position step as a share of the first; exp-linear in between. 3DGS: 0.01.
    pub position_final: f32,
    /// Log units. 3DGS: 5e-3.
    pub scales: f32,
    /// Quaternion units. 3DGS: 1e-3.
    pub rotations: f32,
    /// Logit units. 3DGS: 0.05.
    pub opacity: f32,
    /// Degree-0 coefficients. 3DGS: 2.5e-3.
    pub color: f32,
    /// Higher coefficients. 3DGS: 1.25e-4.
    pub harmonics: f32,
    /// Exposure gain and bias per step. PGSR: 1e-3.
    pub exposure: f32,
    /// Step only the Gaussians that the view shows; else Adam's momentum carries the others on.
    pub sparse: bool,
}

impl Default for RateOptions {
    fn default() -> Self {
        Self {
            position_gsd: 0.32,
            position_final: 0.01,
            scales: 5e-3,
            rotations: 1e-3,
            opacity: 0.05,
            color: 2.5e-3,
            harmonics: 1.25e-4,
            exposure: 1e-3,
            sparse: false,
        }
    }
}

/// How to train one group. `Default` is the preset `standard`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainOptions {
    /// Steps, one reference view each; from 500.
    pub iterations: u32,
    /// Training ends before its last step where the photometric loss falls by less than this share from block to block,
    /// twice in a row, after density control and with all terms at full weight; 0: never.
    pub plateau_share: f32,
    /// Least length of a block, steps; rounded up to whole rounds of the views.
    pub plateau_steps: u32,
    /// Weights of the loss terms once all are on.
    pub weights: LossWeights,
    /// Share of the iterations before normal, multi-view geometric and NCC terms start. PGSR: 7000/30000.
    pub geometric_start: f32,
    /// Share of the iterations over which their weights rise to full.
    pub geometric_ramp: f32,
    /// Gate of the geometric term when it starts, pixels; it shrinks to `weights.geometric_gate_px` (method.md 8.10).
    pub geometric_gate_start_px: f32,
    /// Share of the iterations over which the gate shrinks.
    pub geometric_gate_anneal: f32,
    /// Every so many steps the multi-view terms are evaluated. PGSR: 1.
    pub geometric_interval: u32,
    /// Share of the iterations after which the degree of harmonics rises by one, again and again. 3DGS: 1000/30000.
    pub sh_interval: f32,
    /// Step sizes.
    pub rates: RateOptions,
    /// Density control.
    pub density: DensityOptions,
    /// Estimate an affine exposure per image.
    pub exposure: bool,
    /// Gaussians nearer than this share of the scene's median depth are not drawn.
    pub near: f32,
    /// Bound on prepared views that are kept on the device, bytes.
    pub view_cache_bytes: u64,
}

impl Default for TrainOptions {
    fn default() -> Self {
        Self {
            iterations: 15_000,
            plateau_share: 0.0,
            plateau_steps: 200,
            weights: LossWeights { geometric: 0.0, ncc_patches: 25_600, ..LossWeights::default() },
            geometric_start: 7.0 / 30.0,
            geometric_ramp: 1.0 / 30.0,
            geometric_gate_start_px: 4.0,
            geometric_gate_anneal: 0.3,
            geometric_interval: 1,
            sh_interval: 1.0 / 30.0,
            rates: RateOptions::default(),
            density: DensityOptions::default(),
            exposure: true,
            near: 0.02,
            view_cache_bytes: 2 << 30,
        }
    }
}

impl TrainOptions {
    /// CPU minutes: 3000 iterations, long first steps, geometry from a tenth on, few patches.
    #[must_use]
    pub fn fast() -> Self {
        Self {
            iterations: 3000,
            geometric_start: 0.1,
            geometric_ramp: 0.05,
            // Without the geometric term surfaces come out closer (docs/claims.md).
            weights: LossWeights { geometric: 0.0, ncc_patches: 2048, ..LossWeights::default() },
            rates: RateOptions { position_gsd: 0.64, ..RateOptions::default() },
            density: DensityOptions { until: 0.4, ..DensityOptions::default() },
            ..Self::default()
        }
    }

    /// The printed equations and weights of the paper wherever it defines them; method.md's choice elsewhere.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            iterations: 30_000,
            weights: LossWeights {
                geometric: 0.05,
                ncc: 0.2,
                flatness: 100.0,
                normal: 0.01,
                normal_image_gradient: false,
                load: 0.41,
                reading: Reading::Paper,
                ..LossWeights::default()
            },
            rates: RateOptions { position_gsd: 0.16, ..RateOptions::default() },
            ..Self::default()
        }
    }

    /// The first step of positions (`rates.position_gsd`) that suits so many iterations, where the options suit their own: what
    /// goes on for longer takes shorter steps, as the presets do among themselves. Fewer iterations take the same.
    #[must_use]
    pub fn position_gsd_for(&self, iterations: u32) -> f32 {
        /// From `fast` to `standard` steps are halved where iterations are five times as many.
        const EXPONENT: f64 = 0.43;
        let longer = f64::from(iterations.max(self.iterations)) / f64::from(self.iterations.max(1));
        (f64::from(self.rates.position_gsd) * libm::pow(longer, -EXPONENT)) as f32
    }

    /// Says what is wrong with the options, if anything.
    ///
    /// # Errors
    /// Names the first key that is out of range.
    pub fn check(&self) -> crate::train::Result<()> {
        let positive = [
            ("iterations", f64::from(self.iterations)),
            ("rates.position_gsd", f64::from(self.rates.position_gsd)),
            ("rates.position_final", f64::from(self.rates.position_final)),
            ("geometric_interval", f64::from(self.geometric_interval)),
            ("density.interval", f64::from(self.density.interval)),
            ("density.max_gaussians", self.density.max_gaussians as f64),
        ];
        let shares = [
            ("geometric_start", self.geometric_start),
            ("geometric_ramp", self.geometric_ramp),
            ("geometric_gate_anneal", self.geometric_gate_anneal),
            ("sh_interval", self.sh_interval),
            ("plateau_share", self.plateau_share),
            ("density.from", self.density.from),
            ("density.until", self.density.until),
            ("density.opacity_cull", self.density.opacity_cull),
            ("density.agreement", self.density.agreement),
        ];
        let bad_positive = positive.iter().find(|(_, v)| !(v.is_finite() && *v > 0.0)).map(|(k, v)| (*k, *v));
        let bad_share = shares.iter().find(|(_, v)| !(0.0..=1.0).contains(v)).map(|(k, v)| (*k, f64::from(*v)));
        match (bad_positive, bad_share) {
            (Some((key, value)), _) => {
                Err(crate::train::TrainError::Options(format!("{key} = {value} must be positive")))
            }
            (None, Some((key, value))) => {
                Err(crate::train::TrainError::Options(format!("{key} = {value} must lie between 0 and 1")))
            }
            (None, None) => Ok(()),
        }
    }

    /// The iteration at a share of the run.
    fn at(&self, share: f32) -> u32 {
        (f64::from(self.iterations) * f64::from(share)).round() as u32
    }

    /// How far the run is, 0 at the first iteration and 1 at the last.
    fn progress(&self, iteration: u32) -> f64 {
        f64::from(iteration.saturating_sub(1)) / f64::from(self.iterations.saturating_sub(1).max(1))
    }

    /// The last iteration at which the losses of two steps may differ for another reason than learning: density control
    /// or weights that rise.
    pub(crate) fn settled_at(&self) -> u32 {
        let rising = self.geometric_start + self.geometric_ramp.max(self.geometric_gate_anneal);
        self.at(rising.max(self.density.until).max(self.density.trim_until))
    }

    /// Adam step sizes of one iteration; `gsd` is the group's ground sampling distance, scene units per pixel.
    #[must_use]
    pub fn rates_at(&self, iteration: u32, gsd: f32) -> Rates {
        let decay = libm::exp(self.progress(iteration) * libm::log(f64::from(self.rates.position_final)));
        Rates {
            means: (f64::from(gsd) * f64::from(self.rates.position_gsd) * decay) as f32,
            scales: self.rates.scales,
            rotations: self.rates.rotations,
            opacity: self.rates.opacity,
            color: self.rates.color,
            harmonics: self.rates.harmonics,
            sparse: self.rates.sparse,
        }
    }

    /// Degree of harmonics in use, at most `stored`.
    #[must_use]
    pub fn sh_degree_at(&self, iteration: u32, stored: u8) -> u8 {
        let every = self.at(self.sh_interval).max(1);
        (iteration.saturating_sub(1) / every).min(u32::from(stored)) as u8
    }

    /// Weights of one iteration: geometric terms are 0 until their start, then rise linearly; the gate shrinks.
    #[must_use]
    pub fn weights_at(&self, iteration: u32) -> LossWeights {
        let start = self.at(self.geometric_start);
        let since = |share: f32| {
            let length = self.at(share).max(1);
            (iteration.saturating_sub(start) as f32 / length as f32).clamp(0.0, 1.0)
        };
        let ramp = if iteration > start { since(self.geometric_ramp) } else { 0.0 };
        let shrunk = since(self.geometric_gate_anneal);
        let full = self.weights;
        let multi_view =
            if iteration.saturating_sub(start).is_multiple_of(self.geometric_interval.max(1)) { ramp } else { 0.0 };
        let gate_ratio = f64::from(full.geometric_gate_px / self.geometric_gate_start_px);
        let gate = f64::from(self.geometric_gate_start_px) * libm::exp(f64::from(shrunk) * libm::log(gate_ratio));
        LossWeights {
            normal: full.normal * ramp,
            geometric: full.geometric * multi_view,
            ncc: full.ncc * multi_view,
            geometric_gate_px: if self.geometric_gate_start_px > full.geometric_gate_px {
                gate as f32
            } else {
                full.geometric_gate_px
            },
            ..full
        }
    }

    /// Whether density statistics are gathered in this iteration.
    #[must_use]
    pub fn gathers_at(&self, iteration: u32) -> bool {
        iteration <= self.at(self.density.until)
    }

    /// Whether clones, splits and prunes are decided after this iteration.
    #[must_use]
    pub fn densifies_at(&self, iteration: u32) -> bool {
        iteration.is_multiple_of(self.density.interval)
            && iteration > self.at(self.density.from)
            && iteration <= self.at(self.density.until)
    }

    /// The most Gaussians that density control can make of `count`: each of its turns adds at most a share.
    #[must_use]
    pub fn gaussian_bound(&self, count: usize) -> usize {
        let turns = (1..=self.at(self.density.until) / self.density.interval.max(1))
            .filter(|turn| self.densifies_at(turn * self.density.interval));
        let grown = |most: usize, _| {
            let births = f64::from(self.density.max_growth) * most as f64;
            most.saturating_add(births.ceil() as usize).min(self.density.max_gaussians.max(count))
        };
        turns.fold(count, grown)
    }

    /// Whether Gaussians that too few views see are removed after this iteration.
    #[must_use]
    pub fn trims_at(&self, iteration: u32) -> bool {
        self.density.trim_interval > 0
            && iteration.is_multiple_of(self.density.trim_interval)
            && iteration <= self.at(self.density.trim_until)
            && iteration < self.iterations
    }

    /// Whether opacities are lowered after this iteration.
    #[must_use]
    pub fn resets_opacity_at(&self, iteration: u32) -> bool {
        let every = self.at(self.density.reset_interval);
        self.iterations >= 10_000
            && every > 0
            && iteration.is_multiple_of(every)
            && iteration < self.at(self.density.until)
    }

    /// Whether faint Gaussians may be removed: not until every view has had its turn after an opacity reset.
    #[must_use]
    pub fn culls_at(&self, iteration: u32, view_count: usize) -> bool {
        let every = self.at(self.density.reset_interval);
        if self.iterations < 10_000 || every == 0 {
            return true;
        }
        let last = (iteration.saturating_sub(1) / every) * every;
        let had_reset = last > 0 && self.resets_opacity_at(last);
        !had_reset || iteration - last >= (view_count as u32).max(500)
    }
}

#[cfg(test)]
mod tests;
