//! How far labels drawn from points reach past the edges of what they lie on, and what is left of them without that.
//!
//! Stereo carries points past the edges of roofs, and where two surfaces are drawn the nearer one wins the pixels between
//! them: both make buildings too large, by about the same number of pixels all over a flight. The photographs tell by how
//! many: their contrast is greatest where the edges are, so many pixels inside of what is drawn.

use std::sync::Arc;

use pgsag_scene::{Image, Map};
use rayon::prelude::*;

use crate::distance::signed_distance;
use crate::label::Label;

/// Contrast is looked at up to so far from an edge, pixels.
const REACH_PX: i32 = 14;
/// Farther out than this it is that of the surroundings, to both sides.
const NEAR_PX: std::ops::Range<i32> = -11..7;
/// Nor nearer than this to what is unknown, pixels: that has edges of its own.
const KNOWN_PX: f32 = 4.0;
/// A crest less than this share above the surroundings is none.
const MIN_CREST: f64 = 0.1;
/// Fewer pixels at any distance tell nothing.
const MIN_PIXELS: f64 = 200.0;
/// Depth that a surface gains from pixel to pixel, in widths of a pixel: more is a step.
const SLOPE: f64 = 2.0;
/// So many views tell as well as all.
const MOST_VIEWS: usize = 24;
/// Bins of a profile.
const BINS: usize = 2 * REACH_PX as usize;

/// Mean contrast of photographs by distance from the edges of the buildings that are drawn into them.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// Sum of contrast and number of pixels, by distance in whole pixels from -14 (inside); the edge runs between pixels,
    /// before the bin of 0.
    bins: [[f64; 2]; BINS],
}

impl Default for Profile {
    fn default() -> Self {
        Self { bins: [[0.0; 2]; BINS] }
    }
}

impl Profile {
    /// Of one view: what is drawn, of the size of its photograph.
    #[must_use]
    pub fn of(drawn: &Map<Label>, image: &Image) -> Self {
        let mut profile = Self::default();
        let far = signed_distance(&drawn.mapped(|label| *label == Label::Building));
        let to_unknown = signed_distance(&drawn.mapped(|label| *label == Label::Unknown));
        let luma = |x: u32, y: u32| {
            let [r, g, b] = image.at(x, y).map(f64::from);
            0.299 * r + 0.587 * g + 0.114 * b
        };
        for y in 1..image.height.saturating_sub(1) {
            for x in 1..image.width.saturating_sub(1) {
                let distance = far.at(x, y).floor() as i32;
                if !(-REACH_PX..REACH_PX).contains(&distance) || to_unknown.at(x, y) < KNOWN_PX {
                    continue;
                }
                // Across the edge alone: along it there are bricks and shadows.
                let across = [far.at(x + 1, y) - far.at(x - 1, y), far.at(x, y + 1) - far.at(x, y - 1)].map(f64::from);
                let slope = [luma(x + 1, y) - luma(x - 1, y), luma(x, y + 1) - luma(x, y - 1)];
                let length = (across[0] * across[0] + across[1] * across[1]).sqrt();
                if length > 0.0 {
                    let bin = &mut profile.bins[(distance + REACH_PX) as usize];
                    bin[0] += (across[0] * slope[0] + across[1] * slope[1]).abs() / length;
                    bin[1] += 1.0;
                }
            }
        }
        profile
    }

    /// Adds the profile of another view.
    pub fn add(&mut self, other: &Self) {
        for (bin, other) in self.bins.iter_mut().zip(&other.bins) {
            bin[0] += other[0];
            bin[1] += other[1];
        }
    }

    /// How far buildings are drawn past their edges, pixels: where the crest of contrast lies inside of what is drawn; 0
    /// where there is no crest, or where it lies outside.
    #[must_use]
    pub fn fringe_px(&self) -> f64 {
        if self.bins.iter().any(|bin| bin[1] < MIN_PIXELS) {
            return 0.0;
        }
        let mean = |distance: i32| self.bins[(distance + REACH_PX) as usize].iter().copied().reduce(|sum, n| sum / n);
        let mean = |distance: i32| mean(distance).unwrap_or(0.0);
        let beyond = |side: std::ops::Range<i32>| side.clone().map(mean).sum::<f64>() / side.len() as f64;
        let level = beyond(-REACH_PX..NEAR_PX.start).max(beyond(NEAR_PX.end..REACH_PX));
        let crest: Vec<(f64, f64)> = NEAR_PX.map(|d| (f64::from(d) + 0.5, (mean(d) - level).max(0.0))).collect();
        let highest = crest.iter().map(|(_, height)| *height).fold(0.0, f64::max);
        let area: f64 = crest.iter().map(|(_, height)| height).sum();
        if highest <= MIN_CREST * level {
            return 0.0;
        }
        (-crest.iter().map(|(d, height)| d * height).sum::<f64>() / area).max(0.0)
    }
}

/// As many of `views`, spread over all, as tell the fringe.
#[must_use]
pub fn some_of(views: &[usize]) -> Vec<usize> {
    views.iter().copied().step_by(views.len().div_ceil(MOST_VIEWS).max(1)).collect()
}

/// [`Profile::fringe_px`] over `views`; `drawn` gives the labels of a view and its photograph.
///
/// # Errors
/// Those of `drawn`.
pub fn fringe_px<E: Send>(
    views: &[usize],
    drawn: impl Fn(usize) -> Result<(Map<Label>, Arc<Image>), E> + Sync,
) -> Result<f64, E> {
    let profile = |view: &usize| drawn(*view).map(|(drawn, image)| Profile::of(&drawn, &image));
    let profiles = views.par_iter().map(profile).collect::<Result<Vec<_>, E>>()?;
    let mut all = Profile::default();
    profiles.iter().for_each(|profile| all.add(profile));
    Ok(all.fringe_px())
}

/// Ends buildings `fringe_px` earlier where they hide background: where the nearest background pixel lies behind by more than
/// slopes explain. At the feet of facades, where both are one surface, and where nothing is known, labels stay. `depth` is
/// of the size of the labels, z in any unit; `focal_px` of their camera.
pub fn trim(drawn: &mut Map<Label>, depth: &Map<f32>, fringe_px: f32, focal_px: f64) {
    if fringe_px <= 0.0 {
        return;
    }
    let to_background = signed_distance(&drawn.mapped(|label| *label == Label::Background));
    let (width, height) = (drawn.width, drawn.height);
    let is_fringe = |at: usize| {
        let far = to_background.values[at];
        if drawn.values[at] != Label::Building || far >= fringe_px {
            return false;
        }
        let (x, y) = (at as u32 % width, at as u32 / width);
        let reach = far.ceil() as u32 + 1;
        let around = (y.saturating_sub(reach)..(y + reach + 1).min(height))
            .flat_map(|v| (x.saturating_sub(reach)..(x + reach + 1).min(width)).map(move |u| (u, v)));
        let background = around.filter(|(u, v)| drawn.at(*u, *v) == Label::Background);
        let nearest = background.min_by_key(|(u, v)| u.abs_diff(x).pow(2) + v.abs_diff(y).pow(2));
        let z = f64::from(depth.values[at]);
        let slope = SLOPE * f64::from(reach) * z / focal_px;
        nearest.is_some_and(|(u, v)| f64::from(depth.at(u, v)) - z > slope)
    };
    let fringe: Vec<bool> = (0..drawn.values.len()).into_par_iter().map(is_fringe).collect();
    for (label, is_fringe) in drawn.values.iter_mut().zip(fringe) {
        if is_fringe {
            *label = Label::Background;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bright roof of 60 x 60 pixels before dark ground with some texture, drawn `by` pixels too large; unknown at the
    /// right border of the image.
    fn scene(by: u32, contrast: u8) -> (Map<Label>, Image) {
        let mut drawn = Map::filled(140, 120, Label::Background);
        let mut image = Image::filled(140, 120, [80; 3]);
        for y in 0..120 {
            for x in 0..140 {
                let inside = |by: u32| (30 - by..90 + by).contains(&y) && (30 - by..90 + by).contains(&x);
                let texture = ((x * 7 + y * 13) % 5) as u8;
                let roof = if inside(0) { contrast } else { 0 };
                image.pixels[(y * 140 + x) as usize] = [80 + texture + roof; 3];
                let known = if inside(by) { Label::Building } else { Label::Background };
                drawn.set(x, y, if x > 135 { Label::Unknown } else { known });
            }
        }
        (drawn, image)
    }

    #[test]
    fn a_fringe_is_found_and_trimmed() {
        for by in [0, 2, 5, 8] {
            let (mut drawn, image) = scene(by, 100);
            let mut profile = Profile::of(&drawn, &image);
            profile.add(&profile.clone());
            let fringe = profile.fringe_px();
            assert!((fringe - f64::from(by)).abs() < 0.6, "{by}: {fringe}");
            let mut at_foot = drawn.clone();
            trim(&mut at_foot, &Map::filled(140, 120, 10.0), fringe as f32, 100.0);
            assert_eq!(at_foot, drawn, "one surface goes on");
            let depth = drawn.mapped(|label| if *label == Label::Building { 10.0 } else { 13.0 });
            trim(&mut drawn, &depth, fringe as f32, 100.0);
            let true_label = scene(0, 100).0;
            let wrong = drawn.values.iter().zip(&true_label.values).filter(|(a, b)| a != b).count();
            assert!(wrong <= 4 * (by * by) as usize, "{by}: {wrong} pixels, the corners are round");
        }
    }

    #[test]
    fn a_roof_like_its_ground_and_an_empty_image_tell_nothing() {
        let (drawn, image) = scene(5, 0);
        assert_eq!(Profile::of(&drawn, &image).fringe_px(), 0.0);
        let nothing = Map::filled(140, 120, Label::Background);
        assert_eq!(Profile::of(&nothing, &image).fringe_px(), 0.0);
        let mut kept = drawn.clone();
        trim(&mut kept, &Map::filled(140, 120, 10.0), 0.0, 100.0);
        assert_eq!(kept, drawn);
    }
}
