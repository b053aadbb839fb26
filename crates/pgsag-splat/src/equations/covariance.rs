//! Rotation and covariance of a Gaussian: Σ = R S Sᵀ Rᵀ. 3DGS, section 4. Group frame, scene units².

use super::algebra::{Mat3, each, mat_mul, transpose};
use super::number::Number;

/// Rotation matrix of a unit quaternion w x y z; its columns are the Gaussian's axes in the group frame.
///     R = I + 2 [ −(y²+z²)   xy − wz    xz + wy
///                  xy + wz  −(x²+z²)    yz − wx
///                  xz − wy   yz + wx   −(x²+y²) ]
#[inline(always)]
pub fn rotation<T: Number>(unit: [T; 4]) -> Mat3<T> {
    let [w, x, y, z] = unit;
    let (one, two) = (T::one(), T::from_f64(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
    ]
}

/// ĝw = 2 [x(G₂₁−G₁₂) + y(G₀₂−G₂₀) + z(G₁₀−G₀₁)], and so on for x, y, z; G = ∂L/∂R.
/// The gradient of the unit quaternion; `activation::unit_quaternion_grad` carries it to the stored one.
#[inline(always)]
pub fn rotation_grad<T: Number>(unit: [T; 4], g: &Mat3<T>) -> [T; 4] {
    let [w, x, y, z] = unit;
    let two = T::from_f64(2.0);
    let (p, q, r) = (g[2][1] - g[1][2], g[0][2] - g[2][0], g[1][0] - g[0][1]);
    let (a, b, c) = (g[0][1] + g[1][0], g[0][2] + g[2][0], g[1][2] + g[2][1]);
    [
        two * (x * p + y * q + z * r),
        two * (w * p + y * a + z * b - two * x * (g[1][1] + g[2][2])),
        two * (w * q + x * a + z * c - two * y * (g[0][0] + g[2][2])),
        two * (w * r + x * b + y * c - two * z * (g[0][0] + g[1][1])),
    ]
}

/// Covariance in the group frame.
///     Σ = M Mᵀ,   M = R diag(s)
#[inline(always)]
pub fn covariance<T: Number>(rotation: &Mat3<T>, scales: [T; 3]) -> Mat3<T> {
    let m = stretched(rotation, scales);
    mat_mul(&m, &transpose(&m))
}

/// G_M = 2 G_Σ M,   G_R = G_M diag(s),   ĝs_j = Σᵢ R_ij G_M,ij.   `d_covariance` is symmetric.
#[inline(always)]
pub fn covariance_grad<T: Number>(rotation: &Mat3<T>, scales: [T; 3], d_covariance: &Mat3<T>) -> (Mat3<T>, [T; 3]) {
    let m = stretched(rotation, scales);
    let half = mat_mul(d_covariance, &m);
    let d_m: Mat3<T> = each(|i| each(|j| half[i][j] + half[i][j]));
    let d_scales = each(|j| rotation[0][j] * d_m[0][j] + rotation[1][j] * d_m[1][j] + rotation[2][j] * d_m[2][j]);
    (stretched(&d_m, scales), d_scales)
}

/// M diag(s): column j times s_j.
#[inline(always)]
fn stretched<T: Number>(m: &Mat3<T>, scales: [T; 3]) -> Mat3<T> {
    each(|i| each(|j| m[i][j] * scales[j]))
}
