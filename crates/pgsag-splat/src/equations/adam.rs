//! One Adam step of one parameter. Kingma and Ba 2015; constants as in 3DGS.

use super::number::Number;

/// Decay of the first moment.
pub const BETA_1: f64 = 0.9;
/// Decay of the second moment.
pub const BETA_2: f64 = 0.999;
/// Added to the root of the second moment; tiny, because gradients of means are. 3DGS.
pub const EPSILON: f64 = 1e-15;

/// Bias corrections as factors, `1 / (1 − β₁ᵗ)` and `1 / √(1 − β₂ᵗ)`, of step t = 1, 2, ….
#[must_use]
pub fn corrections(step: u32) -> [f64; 2] {
    let left = |beta: f64| 1.0 - libm::pow(beta, f64::from(step));
    [1.0 / left(BETA_1), 1.0 / left(BETA_2).sqrt()]
}

/// The new parameter, first and second moment.
///     m ← β₁ m + (1 − β₁) g,   v ← β₂ v + (1 − β₂) g²,   x ← x − η c₁ m / (c₂ √v + ε)
/// `rate` η in the parameter's unit, `corrections` c₁, c₂ of this step.
#[inline(always)]
pub fn step<T: Number>(x: T, first: T, second: T, gradient: T, rate: T, corrections: [T; 2]) -> [T; 3] {
    let first = T::from_f64(BETA_1) * first + T::from_f64(1.0 - BETA_1) * gradient;
    let second = T::from_f64(BETA_2) * second + T::from_f64(1.0 - BETA_2) * gradient * gradient;
    let move_by = rate * corrections[0] * first / (corrections[1] * second.sqrt() + T::from_f64(EPSILON));
    [x - move_by, first, second]
}
