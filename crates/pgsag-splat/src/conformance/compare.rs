//! Two vectors, three numbers, one verdict.

use std::fmt;

/// Least cosine between what a backend and the reference say.
const COSINE: f64 = 0.99999;
/// Vectors shorter than this count as nothing.
const NOTHING: f64 = 1e-12;

/// One quantity of one scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// Scene, then what was compared.
    pub name: String,
    /// ‖b‖, b the reference.
    pub norm: f64,
    /// ‖a − b‖ / ‖b‖.
    pub relative_error: f64,
    /// Of the angle between a and b; 1 where both are nothing.
    pub cosine: f64,
    /// Σ (a − b) / Σ |b|: an error that has a direction.
    pub bias: f64,
    /// The most that `relative_error` may be.
    pub tolerance: f64,
}

impl Comparison {
    /// Whether the two agree.
    #[must_use]
    pub fn passed(&self) -> bool {
        self.relative_error < self.tolerance && self.cosine > COSINE
    }
}

/// All comparisons of a run, and the calls that failed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// In the order of the suite.
    pub comparisons: Vec<Comparison>,
    /// Calls that returned an error, and facts that do not hold.
    pub faults: Vec<String>,
}

impl Report {
    /// Whether everything agrees.
    #[must_use]
    pub fn passed(&self) -> bool {
        self.faults.is_empty() && self.comparisons.iter().all(Comparison::passed)
    }

    /// The largest error relative to its tolerance.
    #[must_use]
    pub fn worst(&self) -> Option<&Comparison> {
        let strain = |comparison: &Comparison| comparison.relative_error / comparison.tolerance;
        self.comparisons.iter().max_by(|a, b| strain(a).total_cmp(&strain(b)))
    }

    /// Compares two vectors.
    pub(super) fn compare(&mut self, name: String, found: &[f64], expected: &[f64], tolerance: f64) {
        if found.len() != expected.len() {
            self.faults.push(format!("{name}: {} values instead of {}", found.len(), expected.len()));
            return;
        }
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let difference: Vec<f64> = found.iter().zip(expected).map(|(a, b)| a - b).collect();
        let (length, wanted) = (dot(found, found).sqrt(), dot(expected, expected).sqrt());
        let nothing = wanted < NOTHING && length < NOTHING;
        let absolute: f64 = expected.iter().map(|value| value.abs()).sum();
        self.comparisons.push(Comparison {
            name,
            norm: wanted,
            relative_error: if nothing { 0.0 } else { dot(&difference, &difference).sqrt() / wanted.max(NOTHING) },
            cosine: if nothing { 1.0 } else { dot(found, expected) / (length * wanted).max(f64::MIN_POSITIVE) },
            bias: if nothing { 0.0 } else { difference.iter().sum::<f64>() / absolute.max(NOTHING) },
            tolerance,
        });
    }

    /// Notes a fact that must hold.
    pub(super) fn expect(&mut self, holds: bool, fault: impl FnOnce() -> String) {
        if !holds {
            self.faults.push(fault());
        }
    }

    /// The value of a call, or its error as a fault.
    pub(super) fn take<T>(&mut self, name: &str, result: crate::backend::Result<T>) -> Option<T> {
        result.map_err(|error| self.faults.push(format!("{name}: {error}"))).ok()
    }
}

impl fmt::Display for Report {
    /// The failures, worst of all at the end.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let failed: Vec<&Comparison> = self.comparisons.iter().filter(|comparison| !comparison.passed()).collect();
        writeln!(f, "{} of {} comparisons disagree", failed.len() + self.faults.len(), self.comparisons.len())?;
        for fault in &self.faults {
            writeln!(f, "  {fault}")?;
        }
        for comparison in failed.into_iter().chain(self.worst()) {
            let Comparison { name, norm, relative_error, cosine, bias, tolerance } = comparison;
            writeln!(
                f,
                "  {name}: error {relative_error:.2e} of {norm:.2e} (at most {tolerance:.0e}), cosine {cosine:.7}, bias {bias:.1e}"
            )?;
        }
        Ok(())
    }
}
