//! Colour that depends on the direction of sight: real spherical harmonics up to degree 3. 3DGS, appendix A.

use super::algebra::{Vec3, each, normalized_grad, sub};
use super::number::Number;

/// Most basis functions: degree 3.
pub const BASIS_MAX: usize = 16;
/// Y₀, the constant function.
pub const C0: f64 = 0.282_094_791_773_878_14;
const C1: f64 = 0.488_602_511_902_919_9;
const C2: [f64; 3] = [1.092_548_430_592_079_2, 0.315_391_565_252_520_05, 0.546_274_215_296_039_6];
const C3: [f64; 5] = [
    0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    1.445_305_721_320_277,
];

/// Basis functions of a degree: (degree + 1)².
#[must_use]
pub const fn basis_count(degree: u8) -> usize {
    (degree as usize + 1) * (degree as usize + 1)
}

/// Unit direction from the camera centre to a mean, group frame, and the distance (at least 1e-12).
///     v = (μ − c) / ‖μ − c‖
#[inline(always)]
pub fn direction<T: Number>(mean: Vec3<T>, eye: Vec3<T>) -> (Vec3<T>, T) {
    super::algebra::normalized(sub(mean, eye), 1e-12)
}

/// ĝμ = (I − v vᵀ) ĝv / ‖μ − c‖
#[inline(always)]
pub fn direction_grad<T: Number>(direction: Vec3<T>, distance: T, d_direction: Vec3<T>) -> Vec3<T> {
    normalized_grad(direction, distance, d_direction)
}

/// Values Y_l of the first (degree + 1)² functions at unit direction (x, y, z); the rest are 0.
#[inline(always)]
pub fn basis<T: Number>(direction: Vec3<T>, degree: u8) -> [T; BASIS_MAX] {
    let k = T::from_f64;
    let [x, y, z] = direction;
    let mut out = [T::zero(); BASIS_MAX];
    out[0] = k(C0);
    if degree >= 1 {
        out[1] = k(-C1) * y;
        out[2] = k(C1) * z;
        out[3] = k(-C1) * x;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if degree >= 2 {
        out[4] = k(C2[0]) * x * y;
        out[5] = k(-C2[0]) * y * z;
        out[6] = k(C2[1]) * (zz + zz - xx - yy);
        out[7] = k(-C2[0]) * x * z;
        out[8] = k(C2[2]) * (xx - yy);
    }
    if degree >= 3 {
        out[9] = k(-C3[0]) * y * (k(3.0) * xx - yy);
        out[10] = k(C3[1]) * x * y * z;
        out[11] = k(-C3[2]) * y * (k(4.0) * zz - xx - yy);
        out[12] = k(C3[3]) * z * (zz + zz - k(3.0) * (xx + yy));
        out[13] = k(-C3[2]) * x * (k(4.0) * zz - xx - yy);
        out[14] = k(C3[4]) * z * (xx - yy);
        out[15] = k(-C3[0]) * x * (xx - k(3.0) * yy);
    }
    out
}

/// ∂Y_l/∂(x, y, z), x, y, z taken as independent.
#[inline(always)]
pub fn basis_grad<T: Number>(direction: Vec3<T>, degree: u8) -> [Vec3<T>; BASIS_MAX] {
    let k = T::from_f64;
    let [x, y, z] = direction;
    let o = T::zero();
    let mut out = [[o; 3]; BASIS_MAX];
    if degree >= 1 {
        out[1] = [o, k(-C1), o];
        out[2] = [o, o, k(C1)];
        out[3] = [k(-C1), o, o];
    }
    if degree >= 2 {
        out[4] = [k(C2[0]) * y, k(C2[0]) * x, o];
        out[5] = [o, k(-C2[0]) * z, k(-C2[0]) * y];
        out[6] = [k(-2.0 * C2[1]) * x, k(-2.0 * C2[1]) * y, k(4.0 * C2[1]) * z];
        out[7] = [k(-C2[0]) * z, o, k(-C2[0]) * x];
        out[8] = [k(2.0 * C2[2]) * x, k(-2.0 * C2[2]) * y, o];
    }
    if degree >= 3 {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        let (xy, yz, xz) = (x * y, y * z, x * z);
        out[9] = [k(-6.0 * C3[0]) * xy, k(-3.0 * C3[0]) * (xx - yy), o];
        out[10] = [k(C3[1]) * yz, k(C3[1]) * xz, k(C3[1]) * xy];
        out[11] = [k(2.0 * C3[2]) * xy, k(-C3[2]) * (k(4.0) * zz - xx - k(3.0) * yy), k(-8.0 * C3[2]) * yz];
        out[12] = [k(-6.0 * C3[3]) * xz, k(-6.0 * C3[3]) * yz, k(3.0 * C3[3]) * (zz + zz - xx - yy)];
        out[13] = [k(-C3[2]) * (k(4.0) * zz - k(3.0) * xx - yy), k(2.0 * C3[2]) * xy, k(-8.0 * C3[2]) * xz];
        out[14] = [k(2.0 * C3[4]) * xz, k(-2.0 * C3[4]) * yz, k(C3[4]) * (xx - yy)];
        out[15] = [k(-3.0 * C3[0]) * (xx - yy), k(6.0 * C3[0]) * xy, o];
    }
    out
}

/// R G B of a Gaussian seen along a unit direction.
///     rgb = max(0, Σ_l Y_l(v) h_l + 0.5)
/// `coefficients` `[K]` of R G B, at least (degree + 1)² of them.
#[inline(always)]
pub fn color<T: Number>(coefficients: &[[T; 3]], direction: Vec3<T>, degree: u8) -> [T; 3] {
    let values = basis(direction, degree);
    let mut rgb = [T::from_f64(0.5); 3];
    for l in 0..basis_count(degree) {
        for channel in 0..3 {
            rgb[channel] += values[l] * coefficients[l][channel];
        }
    }
    each(|c| rgb[c].max(T::zero()))
}

/// ĝh_l = Y_l ĝrgb,   ĝv = Σ_c ĝrgb_c Σ_l h_lc ∇Y_l; a channel held at 0 gives nothing.
/// Returns the gradients of the coefficients (0 beyond the degree in use) and of the direction.
/// `rgb` is what [`color`] returned.
#[inline(always)]
pub fn color_grad<T: Number>(
    coefficients: &[[T; 3]],
    direction: Vec3<T>,
    degree: u8,
    rgb: [T; 3],
    d_rgb: [T; 3],
) -> ([[T; 3]; BASIS_MAX], Vec3<T>) {
    let d_rgb: [T; 3] = each(|c| T::select(T::zero().less(rgb[c]), d_rgb[c], T::zero()));
    let values = basis(direction, degree);
    let slopes = basis_grad(direction, degree);
    let mut d_coefficients = [[T::zero(); 3]; BASIS_MAX];
    let mut d_direction = [T::zero(); 3];
    for l in 0..basis_count(degree) {
        d_coefficients[l] = each(|c| d_rgb[c] * values[l]);
        let along = super::algebra::dot(d_rgb, coefficients[l]);
        for axis in 0..3 {
            d_direction[axis] += along * slopes[l][axis];
        }
    }
    (d_coefficients, d_direction)
}
