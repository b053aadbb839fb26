//! From the group frame to the screen: the affine approximation of EWA splatting (Zwicker 2001; 3DGS, section 4).
//!
//! The screen position is exact; the screen covariance uses the Jacobian of the projection at the mean, with X/Z and
//! Y/Z clamped to 15 % of the image beyond its edges, where the approximation breaks down.

use super::algebra::{Mat3, Vec3, add, each, mat_vec, transpose_vec};
use super::number::Number;
use crate::backend::ViewCamera;

/// Low-pass filter added to the screen covariance, pixels². 3DGS.
pub const DILATION_PX2: f64 = 0.3;
/// How far beyond each edge, in image sizes, the Jacobian's tangent is clamped; 0.15 is 3DGS's 1.3 tan of a centred
/// camera, and needs no centred camera.
pub const CLAMP_MARGIN: f64 = 0.15;
/// Smallest determinant of a screen covariance, pixels⁴; below it a Gaussian is not drawn. Never reached with dilation.
pub const DETERMINANT_FLOOR: f64 = 1e-12;

/// Pinhole and pose in the precision of the work.
#[derive(Clone, Copy, Debug)]
pub struct Lens<T> {
    /// W: rows of camera_from_group's rotation.
    pub rotation: Mat3<T>,
    /// t: p = W μ + t, scene units.
    pub translation: Vec3<T>,
    /// Focal lengths, pixels.
    pub focal: [T; 2],
    /// Their inverses.
    pub inverse_focal: [T; 2],
    /// Principal point, pixels.
    pub center: [T; 2],
    /// Least X/Z and Y/Z of the Jacobian.
    pub tangent_low: [T; 2],
    /// Greatest X/Z and Y/Z of the Jacobian.
    pub tangent_high: [T; 2],
    /// c = −Wᵀ t: the camera centre, group frame, scene units.
    pub eye: Vec3<T>,
}

impl<T: Number> Lens<T> {
    /// Of a camera.
    #[must_use]
    pub fn new(camera: &ViewCamera) -> Self {
        let pinhole = &camera.pinhole;
        let (width, height) = (f64::from(pinhole.width), f64::from(pinhole.height));
        let low =
            [(-CLAMP_MARGIN * width - pinhole.cx) / pinhole.fx, (-CLAMP_MARGIN * height - pinhole.cy) / pinhole.fy];
        let far = 1.0 + CLAMP_MARGIN;
        let high = [(far * width - pinhole.cx) / pinhole.fx, (far * height - pinhole.cy) / pinhole.fy];
        let eye = transpose_vec(&camera.rotation, camera.translation.map(|value| -value));
        Self {
            rotation: camera.rotation.map(|row| row.map(T::from_f64)),
            translation: camera.translation.map(T::from_f64),
            focal: [T::from_f64(pinhole.fx), T::from_f64(pinhole.fy)],
            inverse_focal: [T::from_f64(1.0 / pinhole.fx), T::from_f64(1.0 / pinhole.fy)],
            center: [T::from_f64(pinhole.cx), T::from_f64(pinhole.cy)],
            tangent_low: low.map(T::from_f64),
            tangent_high: high.map(T::from_f64),
            eye: eye.map(T::from_f64),
        }
    }

    /// The ray through the centre of pixel (column, row), camera frame, z = 1.
    #[inline(always)]
    pub fn ray(&self, column: T, row: T) -> Vec3<T> {
        let half = T::from_f64(0.5);
        let along = |at: T, k: usize| (at + half - self.center[k]) * self.inverse_focal[k];
        [along(column, 0), along(row, 1), T::one()]
    }
}

/// A mean in the camera frame.
///     p = W μ + t
#[inline(always)]
pub fn to_camera<T: Number>(lens: &Lens<T>, mean: Vec3<T>) -> Vec3<T> {
    add(mat_vec(&lens.rotation, mean), lens.translation)
}

/// ĝμ = Wᵀ ĝp
#[inline(always)]
pub fn to_camera_grad<T: Number>(lens: &Lens<T>, d_point: Vec3<T>) -> Vec3<T> {
    transpose_vec(&lens.rotation, d_point)
}

/// Screen coordinates of a point p = (X, Y, Z) in the camera frame, pixels.
///     u = fx X / Z + cx,   v = fy Y / Z + cy
#[inline(always)]
pub fn screen<T: Number>(lens: &Lens<T>, p: Vec3<T>) -> [T; 2] {
    let inverse = T::one() / p[2];
    [lens.focal[0] * p[0] * inverse + lens.center[0], lens.focal[1] * p[1] * inverse + lens.center[1]]
}

/// ĝX = ĝu fx/Z,   ĝY = ĝv fy/Z,   ĝZ = −(ĝu fx X + ĝv fy Y) / Z²
#[inline(always)]
pub fn screen_grad<T: Number>(lens: &Lens<T>, p: Vec3<T>, d_screen: [T; 2]) -> Vec3<T> {
    let inverse = T::one() / p[2];
    let (x, y) = (d_screen[0] * lens.focal[0] * inverse, d_screen[1] * lens.focal[1] * inverse);
    [x, y, -(x * p[0] + y * p[1]) * inverse]
}

/// J W, the 2 x 3 Jacobian of the screen position in the group frame, at the clamped tangent.
///     J = [ fx/Z  0  −fx tx/Z²        tx = clamp(X/Z) Z
///           0  fy/Z  −fy ty/Z² ]      ty = clamp(Y/Z) Z
#[inline(always)]
fn jacobian<T: Number>(lens: &Lens<T>, p: Vec3<T>) -> [Vec3<T>; 2] {
    let inverse = T::one() / p[2];
    [jacobian_row(lens, p, inverse, 0), jacobian_row(lens, p, inverse, 1)]
}

#[inline(always)]
fn jacobian_row<T: Number>(lens: &Lens<T>, p: Vec3<T>, inverse: T, i: usize) -> Vec3<T> {
    let tangent = (p[i] * inverse).clamp(lens.tangent_low[i], lens.tangent_high[i]);
    let slope = lens.focal[i] * inverse;
    each(|k| slope * (lens.rotation[i][k] - tangent * lens.rotation[2][k]))
}

/// Covariance (a, b, c) = (Σ2₀₀, Σ2₀₁, Σ2₁₁) on the screen, pixels².
///     Σ2 = K Σ Kᵀ + 0.3 I,   K = J W
/// `p` mean, camera frame; `covariance` Σ, group frame.
#[inline(always)]
pub fn screen_covariance<T: Number>(lens: &Lens<T>, p: Vec3<T>, covariance: &Mat3<T>) -> [T; 3] {
    let k = jacobian(lens, p);
    let (first, second) = (mat_vec(covariance, k[0]), mat_vec(covariance, k[1]));
    let dilation = T::from_f64(DILATION_PX2);
    [
        super::algebra::dot(k[0], first) + dilation,
        super::algebra::dot(k[0], second),
        super::algebra::dot(k[1], second) + dilation,
    ]
}

/// G_Σ = Kᵀ G₂ K,   G_K = 2 G₂ K Σ,   G_J = G_K Wᵀ, then J's entries back to X, Y, Z; where the clamp holds,
/// tx = limit · Z depends on Z alone (3DGS drops that term).   G₂ = [ĝa, ĝb/2; ĝb/2, ĝc].
/// Returns (ĝp, G_Σ); G_Σ is symmetric.
#[inline(always)]
pub fn screen_covariance_grad<T: Number>(
    lens: &Lens<T>,
    p: Vec3<T>,
    covariance: &Mat3<T>,
    d_screen: [T; 3],
) -> (Vec3<T>, Mat3<T>) {
    let k = jacobian(lens, p);
    let half = T::from_f64(0.5);
    let g2 = [[d_screen[0], half * d_screen[1]], [half * d_screen[1], d_screen[2]]];
    // G₂ K, 2 x 3.
    let gk: [Vec3<T>; 2] = each(|i| each(|j| g2[i][0] * k[0][j] + g2[i][1] * k[1][j]));
    let d_covariance: Mat3<T> = each(|i| each(|j| k[0][i] * gk[0][j] + k[1][i] * gk[1][j]));
    let inverse = T::one() / p[2];
    let mut d_point = [T::zero(); 3];
    for i in 0..2 {
        let half_k = mat_vec(covariance, gk[i]);
        let d_k = each(|j| half_k[j] + half_k[j]);
        let d_jacobian = mat_vec(&lens.rotation, d_k);
        let ratio = p[i] * inverse;
        let tangent = ratio.clamp(lens.tangent_low[i], lens.tangent_high[i]);
        let slope = lens.focal[i] * inverse;
        // J_ii = f/Z; J_i2 = −(f/Z) · tangent, and the tangent moves with X/Z only inside the clamp.
        d_point[2] -= slope * inverse * (d_jacobian[i] - tangent * d_jacobian[2]);
        let d_tangent = -slope * d_jacobian[2];
        let outside = T::select(ratio.less(lens.tangent_low[i]), T::zero(), d_tangent);
        let d_ratio = T::select(lens.tangent_high[i].less(ratio), T::zero(), outside);
        d_point[i] += d_ratio * inverse;
        d_point[2] -= d_ratio * ratio * inverse;
    }
    (d_point, d_covariance)
}

/// Inverse (A, B, C) of the screen covariance (a, b, c), pixels⁻²; zeros below [`DETERMINANT_FLOOR`].
///     A = c/det,   B = −b/det,   C = a/det,   det = a c − b²
#[inline(always)]
pub fn conic<T: Number>(covariance: [T; 3]) -> [T; 3] {
    let [a, b, c] = covariance;
    let det = a * c - b * b;
    let usable = T::from_f64(DETERMINANT_FLOOR).less(det);
    let inverse = T::select(usable, T::one() / det, T::zero());
    [c * inverse, -b * inverse, a * inverse]
}

/// G₂ = −Q G_Q Q,   Q = [A, B; B, C],   G_Q = [ĝA, ĝB/2; ĝB/2, ĝC].   Returns (ĝa, ĝb, ĝc), ĝb for the single b.
#[inline(always)]
pub fn conic_grad<T: Number>(conic: [T; 3], d_conic: [T; 3]) -> [T; 3] {
    let [a, b, c] = conic;
    let [ga, gb, gc] = d_conic;
    let two = T::from_f64(2.0);
    [
        -(a * a * ga + a * b * gb + b * b * gc),
        -(two * a * b * ga + (a * c + b * b) * gb + two * b * c * gc),
        -(b * b * ga + b * c * gb + c * c * gc),
    ]
}

/// Half-widths (x, y) in pixels of the box around the ellipse on which o e^{power} = `alpha_cut`; exact, so that culling
/// by it loses nothing.   ex = √(t a),   ey = √(t c),   t = 2 ln(o / cut), given as `level`.
/// `level` ≤ 0 (nothing reaches the cut): zero.
#[inline(always)]
pub fn extent<T: Number>(covariance: [T; 3], level: T) -> [T; 2] {
    let level = level.max(T::zero());
    [(level * covariance[0]).sqrt(), (level * covariance[2]).sqrt()]
}

/// Three standard deviations along the longer axis of the screen ellipse, pixels.
///     r = 3 √λ,   λ = m + √(max(0, m² − det)),   m = (a + c) / 2
#[inline(always)]
pub fn radius<T: Number>(covariance: [T; 3]) -> T {
    let [a, b, c] = covariance;
    let middle = T::from_f64(0.5) * (a + c);
    let spread = (middle * middle - (a * c - b * b)).max(T::zero()).sqrt();
    T::from_f64(3.0) * (middle + spread).sqrt()
}
