//! Front-to-back blending of one pixel (Eq. 1), and how much the load of a pixel answers to alpha (Eq. 9).

use super::number::Number;

/// Alpha is held below this, so that no Gaussian hides everything behind it. 3DGS.
pub const ALPHA_MAX: f64 = 0.99;
/// Steepness of the load surrogate. AdR-Gaussian.
pub const LOAD_STEEPNESS: f64 = 1000.0;
/// Alpha at which the load surrogate is a half: the 8-bit cut. AdR-Gaussian.
pub const LOAD_CENTER: f64 = 1.0 / 255.0;

/// Gaussian falloff at `delta` = (u − x, v − y), pixels from a pixel's centre to the mean; 0 where rounding makes the
/// power positive.
///     G = e^{power},   power = −½ (A dx² + C dy²) − B dx dy
#[inline(always)]
pub fn falloff<T: Number>(conic: [T; 3], delta: [T; 2]) -> T {
    let [a, b, c] = conic;
    let [dx, dy] = delta;
    let power = T::from_f64(-0.5) * (a * dx * dx + c * dy * dy) - b * dx * dy;
    T::select(T::zero().less(power), T::zero(), power.exp())
}

/// Gradients of the mean's screen position (u, v) and of the conic (A, B, C).
///     ĝu = −ĝG G (A dx + B dy),   ĝv = −ĝG G (C dy + B dx)
///     ĝA = −½ G dx² ĝG,   ĝB = −G dx dy ĝG,   ĝC = −½ G dy² ĝG
#[inline(always)]
pub fn falloff_grad<T: Number>(conic: [T; 3], delta: [T; 2], falloff: T, d_falloff: T) -> ([T; 2], [T; 3]) {
    let [a, b, c] = conic;
    let [dx, dy] = delta;
    let pull = -d_falloff * falloff;
    let half = T::from_f64(0.5);
    (
        [pull * (a * dx + b * dy), pull * (c * dy + b * dx)],
        [half * pull * dx * dx, pull * dx * dy, half * pull * dy * dy],
    )
}

/// Opacity of a Gaussian at a pixel.
///     α = min(0.99, o G)
#[inline(always)]
pub fn alpha<T: Number>(opacity: T, falloff: T) -> T {
    (opacity * falloff).min(T::from_f64(ALPHA_MAX))
}

/// ĝo = G ĝα,   ĝG = o ĝα; 0 where α is held at 0.99 (3DGS lets it through).
#[inline(always)]
pub fn alpha_grad<T: Number>(opacity: T, falloff: T, d_alpha: T) -> (T, T) {
    let free = (opacity * falloff).less(T::from_f64(ALPHA_MAX));
    let d_alpha = T::select(free, d_alpha, T::zero());
    (falloff * d_alpha, opacity * d_alpha)
}

/// One step of Eq. 1: the channels with this Gaussian's contribution, and the transmittance behind it.
///     out ← out + c α T,   T ← T (1 − α)
#[inline(always)]
pub fn over<T: Number, const K: usize>(out: &mut [T; K], channels: &[T; K], alpha: T, transmittance: T) -> T {
    let weight = alpha * transmittance;
    for k in 0..K {
        out[k] += channels[k] * weight;
    }
    transmittance * (T::one() - alpha)
}

/// Walks Eq. 1 back by one Gaussian. `transmittance` T is that before it; `behind` what lies behind it as seen through
/// clear air (starts as the background), and becomes what lies behind its predecessor.
///     ĝc = α T ĝ,   ĝα = T Σ_k ĝ_k (c_k − behind_k),   behind ← α c + (1 − α) behind
/// Returns (ĝc, ĝα).
#[inline(always)]
pub fn over_grad<T: Number, const K: usize>(
    channels: &[T; K],
    alpha: T,
    transmittance: T,
    behind: &mut [T; K],
    d_out: &[T; K],
) -> ([T; K], T) {
    let weight = alpha * transmittance;
    let mut d_channels = [T::zero(); K];
    let mut d_alpha = T::zero();
    for k in 0..K {
        d_channels[k] = d_out[k] * weight;
        d_alpha += d_out[k] * (channels[k] - behind[k]);
        behind[k] = alpha * channels[k] + (T::one() - alpha) * behind[k];
    }
    (d_channels, d_alpha * transmittance)
}

/// Smooth stand-in for "this Gaussian is blended here": a sigmoid at the cut. AdR-Gaussian, section 4.2.
///     load(α) = 1 / (1 + e^{−k (α − α₀)}),   k = 1000,   α₀ = 1/255
#[inline(always)]
pub fn load<T: Number>(alpha: T) -> T {
    T::one() / (T::one() + load_exponential(alpha))
}

/// ∂load/∂α = k E / (1 + E)²,   E = e^{−k (α − α₀)}. Only blended entries feel it.
#[inline(always)]
pub fn load_grad<T: Number>(alpha: T, d_load: T) -> T {
    let e = load_exponential(alpha);
    let sum = T::one() + e;
    d_load * T::from_f64(LOAD_STEEPNESS) * e / (sum * sum)
}

#[inline(always)]
fn load_exponential<T: Number>(alpha: T) -> T {
    (T::from_f64(LOAD_STEEPNESS) * (T::from_f64(LOAD_CENTER) - alpha)).exp()
}
