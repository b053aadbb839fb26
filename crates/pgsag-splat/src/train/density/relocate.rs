//! What is culled as faint is born again where opacity is (3DGS-MCMC; method.md, appendix B).
//!
//! Only the relocation is taken over: children are parted by one draw of N(0, Σ) at birth instead of noise in every step,
//! and neither opacities nor scales are pulled down.

use super::{DensityInput, opacity, sample_offset};
use crate::backend::Birth;
use crate::train::stream;

/// So many may share a place; what would come on top stays dead. gsplat: 51.
const MOST_COPIES: u32 = 51;
/// Below it nothing is ever relocated to. gsplat: 0.005.
const MIN_OPACITY: f64 = 0.005;

/// Opacity and factor of the scales of `copies` Gaussians that together look as one of opacity `opacity` did
/// (3DGS-MCMC, Eq. 9): 1 − (1 − o′)ᴺ = o, and the same integral over a line through the middle.
pub(super) fn shared(opacity: f64, copies: u32) -> (f64, f64) {
    let each = (1.0 - libm::pow(1.0 - opacity, 1.0 / f64::from(copies))).max(MIN_OPACITY);
    let mut integral = 0.0;
    for i in 0..copies {
        let mut binomial = 1.0;
        let mut power = each;
        for k in 0..=i {
            integral += binomial * power / f64::from(k + 1).sqrt();
            binomial *= -f64::from(i - k) / f64::from(k + 1);
            power *= each;
        }
    }
    (each, opacity / integral)
}

/// Births of `faint` Gaussians on those that are neither `dead` nor wish to multiply (`busy`), drawn by opacity; whoever
/// is drawn dies and is born among them.
pub(super) fn relocations(input: &DensityInput<'_>, faint: usize, dead: &mut [bool], busy: &[bool]) -> Vec<Birth> {
    let count = input.cloud.len();
    let mut sums = Vec::with_capacity(count);
    let mut total = 0.0;
    for i in 0..count {
        if !dead[i] && !busy[i] {
            total += f64::from(opacity(input.cloud.opacity_logits[i]));
        }
        sums.push(total);
    }
    if total == 0.0 {
        return Vec::new();
    }
    let mut copies = vec![1u32; count];
    let mut random = stream(input.seed, input.iteration, u64::MAX);
    for _ in 0..faint {
        let at = random.range(0.0, total);
        let drawn = sums.partition_point(|sum| *sum <= at).min(count - 1);
        copies[drawn] = (copies[drawn] + 1).min(MOST_COPIES);
    }
    let mut births = Vec::with_capacity(2 * faint);
    for i in (0..count).filter(|&i| copies[i] > 1) {
        let (each, factor) = shared(f64::from(opacity(input.cloud.opacity_logits[i])), copies[i]);
        let mut random = stream(input.seed, input.iteration, i as u64);
        for copy in 0..copies[i] {
            let offset = if copy == 0 { [0.0; 3] } else { sample_offset(input.cloud, i, &mut random) };
            births.push(Birth {
                parent: i as u32,
                offset,
                log_scale_shift: libm::log(factor) as f32,
                opacity_logit: Some(libm::log(each / (1.0 - each)) as f32),
            });
        }
        dead[i] = true;
    }
    births
}
