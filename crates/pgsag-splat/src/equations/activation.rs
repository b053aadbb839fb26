//! From what is stored to what is meant: opacity = sigmoid, scale = exp, rotation = q / ‖q‖. 3DGS, section 5.

use super::algebra::each;
use super::number::Number;

/// Opacity of a Gaussian from its logit, in (0, 1).
///     o = 1 / (1 + e^{−x})
#[inline(always)]
pub fn opacity<T: Number>(logit: T) -> T {
    T::one() / (T::one() + (-logit).exp())
}

/// ∂o/∂x = o (1 − o)
#[inline(always)]
pub fn opacity_grad<T: Number>(opacity: T, d_opacity: T) -> T {
    d_opacity * opacity * (T::one() - opacity)
}

/// Standard deviations along the three axes, scene units, from their logarithms.
///     s = e^x
#[inline(always)]
pub fn scales<T: Number>(log_scales: [T; 3]) -> [T; 3] {
    [log_scales[0].exp(), log_scales[1].exp(), log_scales[2].exp()]
}

/// ∂s/∂x = s
#[inline(always)]
pub fn scales_grad<T: Number>(scales: [T; 3], d_scales: [T; 3]) -> [T; 3] {
    [scales[0] * d_scales[0], scales[1] * d_scales[1], scales[2] * d_scales[2]]
}

/// Unit quaternion w x y z and the norm of the stored one, which is at least 1e-12.
///     u = q / ‖q‖
#[inline(always)]
pub fn unit_quaternion<T: Number>(raw: [T; 4]) -> ([T; 4], T) {
    let square = raw[0] * raw[0] + raw[1] * raw[1] + raw[2] * raw[2] + raw[3] * raw[3];
    let norm = square.sqrt().max(T::from_f64(1e-12));
    let inverse = T::one() / norm;
    (each(|k| raw[k] * inverse), norm)
}

/// ĝq = (ĝu − (ĝu · u) u) / ‖q‖
#[inline(always)]
pub fn unit_quaternion_grad<T: Number>(unit: [T; 4], norm: T, d_unit: [T; 4]) -> [T; 4] {
    let along = d_unit[0] * unit[0] + d_unit[1] * unit[1] + d_unit[2] * unit[2] + d_unit[3] * unit[3];
    let inverse = T::one() / norm;
    each(|i| (d_unit[i] - along * unit[i]) * inverse)
}
