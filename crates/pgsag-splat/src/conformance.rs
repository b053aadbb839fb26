//! The suite that any `Backend` must pass: eight small scenes, everything compared with [`Reference`].
//!
//! Maps, loss terms, gradients of every kind of parameter, statistics, Adam and reshaping are compared as vectors: norm
//! of the difference, cosine, signed bias. Scenes stand off thresholds: gradients are compared with the alpha cut at
//! 2⁻²⁴, where a Gaussian that one backend blends and the other does not cannot matter. Tests assert `Report::passed`.
//!
//! [`Reference`]: crate::reference::Reference

mod checks;
mod compare;
mod scenes;
#[cfg(test)]
mod tests;

pub use compare::{Comparison, Report};

use crate::backend::{Backend, Limits};
use crate::reference::Reference;

/// Nothing that matters is cut.
const OPEN: Limits = Limits { alpha_cut: 1.0 / 16_777_216.0, transmittance_stop: 1e-6 };

/// Runs the suite. `make` builds the backend with given limits; it is called twice.
pub fn check<B: Backend>(make: impl Fn(Limits) -> B) -> Report {
    let Ok(report) = try_check(|limits| Ok::<B, std::convert::Infallible>(make(limits)));
    report
}

/// The same with a backend that may not be there.
///
/// # Errors
/// What `make` failed with.
pub fn try_check<B: Backend, E>(make: impl Fn(Limits) -> Result<B, E>) -> Result<Report, E> {
    let mut report = Report::default();
    let usual = (make(Limits::default())?, Reference::new(Limits::default()));
    let open = (make(OPEN)?, Reference::new(OPEN));
    for scene in scenes::all() {
        checks::maps(&usual.0, &usual.1, &scene, &mut report);
        checks::terms(&open.0, &open.1, &scene, &mut report);
        checks::statistics(&open.0, &open.1, &scene, &mut report);
    }
    let scene = scenes::random();
    checks::round_trip(&usual.0, &scene, &mut report);
    checks::adam(&open.0, &scene, &mut report);
    checks::reshape(&open.0, &open.1, &scene, &mut report);
    Ok(report)
}
