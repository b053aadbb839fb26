//! Metres of the options to units of the scene.

use pgsag_scene::Scene;

/// In a scene of unknown scale, this share of the median depth stands for a metre: drones fly at about a hundred.
const METRE_PER_MEDIAN_DEPTH: f64 = 0.01;

/// How long a metre is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lengths {
    units_per_metre: f64,
    is_known: bool,
}

impl Lengths {
    /// Of a scene.
    #[must_use]
    pub fn of(scene: &Scene) -> Self {
        match scene.frame.metres_per_unit {
            Some(scale) => Self::known(scale),
            None => {
                let depth = scene.median_depth().unwrap_or(1.0 / METRE_PER_MEDIAN_DEPTH);
                Self { units_per_metre: METRE_PER_MEDIAN_DEPTH * depth, is_known: false }
            }
        }
    }

    /// Of a known scale.
    #[must_use]
    pub fn known(metres_per_unit: f64) -> Self {
        Self { units_per_metre: 1.0 / metres_per_unit, is_known: true }
    }

    /// What must be said where the scale is unknown.
    #[must_use]
    pub fn assumption(&self) -> Option<String> {
        (!self.is_known).then(|| {
            format!(
                "the scale is unknown: {:.6} scene units, a hundredth of the median depth, count as a metre",
                self.units_per_metre
            )
        })
    }

    /// Metres to scene units.
    #[must_use]
    pub fn units(&self, metres: f64) -> f64 {
        metres * self.units_per_metre
    }

    /// Square metres to square units.
    #[must_use]
    pub fn square_units(&self, square_metres: f64) -> f64 {
        square_metres * self.units_per_metre * self.units_per_metre
    }

    /// Scene units to metres.
    #[must_use]
    pub fn metres(&self, units: f64) -> f64 {
        units / self.units_per_metre
    }

    /// Square units to square metres.
    #[must_use]
    pub fn square_metres(&self, square_units: f64) -> f64 {
        square_units / (self.units_per_metre * self.units_per_metre)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_scale_is_said() {
        let unknown = Lengths::of(&Scene::default());
        assert!(unknown.assumption().is_some_and(|words| words.contains("unknown")));
        assert_eq!(Lengths::known(2.0).assumption(), None);
        assert_eq!(Lengths::known(2.0).units(3.0), 1.5);
    }
}
