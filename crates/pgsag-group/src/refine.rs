//! Masks to the four pixel classes that training works with. Paper 4.1 (RBM and its boundary MB).
//!
//! The band where a mask's edge is uncertain is counted in pixels of mask error, not in shares of the image.

use pgsag_scene::{Map, Mask, PixelClass};
use serde::{Deserialize, Serialize};

use crate::distance::signed_distance;

/// How masks become classes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefineOptions {
    /// Half-width of the boundary band inside the mask, pixels of the training image.
    pub band_px: f32,
    /// How far a background mask reaches into the building, pixels, so that both surfaces overlap in fusion.
    pub overlap_px: f32,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self { band_px: 2.0, overlap_px: 4.0 }
    }
}

/// Classes for a building group: `Inside`, `Boundary` within `band_px` of the mask's edge, `Free` outside.
/// The image border is not an edge of the building.
#[must_use]
pub fn building_classes(building: &Map<bool>, options: &RefineOptions) -> Mask {
    classes(building, |distance_px| match distance_px {
        d if d > 0.0 => PixelClass::Free,
        d if d > -options.band_px => PixelClass::Boundary,
        _ => PixelClass::Inside,
    })
}

/// Classes for a background block: what is not building, plus `overlap_px` of it. Pixels deeper inside buildings are
/// `Occluded`: the background may go on behind them.
#[must_use]
pub fn background_classes(building: &Map<bool>, options: &RefineOptions) -> Mask {
    classes(building, |distance_px| match distance_px {
        d if d > options.band_px => PixelClass::Inside,
        d if d > -options.overlap_px => PixelClass::Boundary,
        _ => PixelClass::Occluded,
    })
}

fn classes(building: &Map<bool>, class_at: impl Fn(f32) -> PixelClass) -> Mask {
    let distance = signed_distance(building);
    Mask {
        width: building.width,
        height: building.height,
        classes: distance.values.iter().map(|d| class_at(*d)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn half() -> Map<bool> {
        let mut mask = Map::filled(20, 4, false);
        for y in 0..4 {
            for x in 10..20 {
                mask.set(x, y, true);
            }
        }
        mask
    }

    #[test]
    fn building_has_a_band_inside_its_edge() {
        let classes = building_classes(&half(), &RefineOptions::default());
        let row: Vec<_> = (8..14).map(|x| classes.at(x, 1)).collect();
        use PixelClass::{Boundary, Free, Inside};
        assert_eq!(row, [Free, Free, Boundary, Boundary, Inside, Inside]);
    }

    #[test]
    fn background_reaches_into_the_building_and_no_further() {
        let classes = background_classes(&half(), &RefineOptions::default());
        let active: Vec<_> = (0..20).map(|x| classes.at(x, 2).is_active()).collect();
        assert!(active[..14].iter().all(|a| *a));
        assert!(active[14..].iter().all(|a| !a));
    }

    #[test]
    fn all_zero_mask_says_no_building() {
        let none = Map::filled(5, 5, false);
        assert_eq!(building_classes(&none, &RefineOptions::default()).active_count(), 0);
        assert_eq!(background_classes(&none, &RefineOptions::default()).active_count(), 25);
    }
}
