//! L_GC-load (Eq. 9): pixels carry about equally many Gaussians, textured ones may carry more.
//!
//! Paper: std(g / ∇I); published code: std(g (1 − ĝ)²) with ĝ the normalised image gradient. Ours is the code's form
//! with a percentile in place of the maximum, on the unmasked photograph; docs/paper.md.

use super::rows::{map_rows, sum_rows};
use super::view::LossView;
use crate::backend::Reading;
use crate::equations::Scalar;

/// The printed form divides by ∇I: this is the least it divides by, one grey level.
const GRADIENT_FLOOR: f32 = 1.0 / 255.0;

/// Standard deviation over the counted pixels of x_i = g_i w_i, with its gradient times the result of `scale(σ)` added
/// to `d_load`.
///     σ² = 1/(n−1) Σ (x_i − x̄)²,   ĝ_i = w_i (x_i − x̄) / ((n−1) σ),   w = (1 − ĝ)²  or  1/∇I
/// `load` g, blended entries per pixel, `[H * W]`. Fewer than two pixels, or no deviation: 0 and no gradient.
pub fn load_balance<T: Scalar>(
    view: &LossView,
    load: &[T],
    reading: Reading,
    mean_over_mask: bool,
    scale: impl Fn(f64) -> f64,
    d_load: &mut [T],
) -> f64 {
    let counts = |index: usize| !mean_over_mask || view.is_active(index);
    let value = |index: usize| load[index].to_f64() * weight(view, reading, index);
    let moments = map_rows(d_load, view.width, |y, row| {
        let mut sums = [0.0; 3];
        for index in (y * view.width..y * view.width + row.len()).filter(|&index| counts(index)) {
            let x = value(index);
            sums = [sums[0] + 1.0, sums[1] + x, sums[2] + x * x];
        }
        sums
    });
    let [count, sum, squares] = moments.into_iter().fold([0.0; 3], |a, b| [a[0] + b[0], a[1] + b[1], a[2] + b[2]]);
    let mean = sum / count;
    let sigma = ((squares - sum * mean) / (count - 1.0)).max(0.0).sqrt();
    if count < 2.0 || sigma < 1e-6 {
        return 0.0;
    }
    let factor = scale(sigma) / ((count - 1.0) * sigma);
    sum_rows(d_load, view.width, |y, row| {
        for (x, d) in row.iter_mut().enumerate() {
            let index = y * view.width + x;
            if counts(index) {
                *d += T::from_f64(factor * weight(view, reading, index) * (value(index) - mean));
            }
        }
        0.0
    });
    sigma
}

fn weight(view: &LossView, reading: Reading, index: usize) -> f64 {
    match reading {
        Reading::Code => {
            let smooth = 1.0 - f64::from(view.gradient.normalized(index));
            smooth * smooth
        }
        Reading::Paper => 1.0 / f64::from(view.gradient.printed[index].max(GRADIENT_FLOOR)),
    }
}

#[cfg(test)]
mod tests;
