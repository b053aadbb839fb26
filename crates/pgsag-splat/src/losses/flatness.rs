//! L_s: Gaussians are flat. The mean, over the visible ones, of the smallest standard deviation. PGSR, section 3.1.

use crate::equations::Scalar;

/// Smallest scale and its axis, the first of equals; scene units.
#[must_use]
pub fn smallest<T: Scalar>(scales: [T; 3]) -> (usize, T) {
    let mut best = 0;
    for axis in 1..3 {
        if scales[axis] < scales[best] {
            best = axis;
        }
    }
    (best, scales[best])
}

/// Mean smallest scale of the visible Gaussians, in units of `scene_scale`; 0 of none.
///     L_s = 1/(N_vis h) Σ min_j s_j
/// `scales` after activation, scene units.
pub fn flatness<T: Scalar>(visible_scales: impl Iterator<Item = [T; 3]>, scene_scale: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for scales in visible_scales {
        sum += smallest(scales).1.to_f64();
        count += 1;
    }
    if count == 0 { 0.0 } else { sum / (count as f64 * scene_scale) }
}

/// Gradient of the logarithms of a visible Gaussian's scales.
///     ∂L_s/∂(log s_j) = s_j / (N_vis h)  at the smallest axis, 0 elsewhere; the choice is not differentiated.
/// `d_flatness` is the term's weight.
#[must_use]
pub fn flatness_grad<T: Scalar>(scales: [T; 3], visible_count: usize, scene_scale: f64, d_flatness: f64) -> [T; 3] {
    let (axis, scale) = smallest(scales);
    let mut d_log_scales = [T::zero(); 3];
    d_log_scales[axis] = scale * T::from_f64(d_flatness / (visible_count.max(1) as f64 * scene_scale));
    d_log_scales
}
