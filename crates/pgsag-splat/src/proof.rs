//! The measure of every gradient: central differences in f64 (fourth order), tests only.

use pgsag_scene::numbers::SplitMix64;

/// Step of the differences, in units of the input (inputs of proofs are of the order of 1).
pub(crate) const STEP: f64 = 1e-4;

/// Difference quotient of `f` at `at` along axis `i`; error of the order of step⁴.
pub(crate) fn difference(f: &impl Fn(&[f64]) -> f64, at: &[f64], i: usize, step: f64) -> f64 {
    let moved = |by: f64| {
        let mut at = at.to_vec();
        at[i] += by;
        f(&at)
    };
    (8.0 * (moved(step) - moved(-step)) - (moved(2.0 * step) - moved(-2.0 * step))) / (12.0 * step)
}

/// Asserts that `gradient` is that of `f` at `at`: every component within `tolerance` of the largest.
pub(crate) fn gradient(f: impl Fn(&[f64]) -> f64, at: &[f64], gradient: &[f64], tolerance: f64) {
    gradient_with_step(f, at, gradient, tolerance, STEP);
}

/// The same with another step, for functions with kinks or cuts nearby.
pub(crate) fn gradient_with_step(f: impl Fn(&[f64]) -> f64, at: &[f64], gradient: &[f64], tolerance: f64, step: f64) {
    assert_eq!(at.len(), gradient.len(), "a gradient has as many components as its input");
    let numeric: Vec<f64> = (0..at.len()).map(|i| difference(&f, at, i, step)).collect();
    let largest = numeric.iter().chain(gradient).fold(0.0, |largest: f64, value| largest.max(value.abs()));
    assert!(largest > 0.0, "a proof of a gradient that is 0 proves nothing");
    for i in 0..at.len() {
        let error = (numeric[i] - gradient[i]).abs() / largest;
        assert!(error < tolerance, "component {i}: {} by formula, {} by differences", gradient[i], numeric[i]);
    }
}

/// Uniform numbers in `[low, high)`.
pub(crate) fn numbers(random: &mut SplitMix64, count: usize, low: f64, high: f64) -> Vec<f64> {
    (0..count).map(|_| random.range(low, high)).collect()
}
