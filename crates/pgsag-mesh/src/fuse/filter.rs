//! The multi-view check: a depth is kept where enough of the views that could see its point agree with it. Views that
//! look past an occluder do not count, so courtyards seen by one view survive, marked by a support of 0 (method 8.4);
//! ramps that blending draws between roof and ground do not (method 8.11).

use glam::{DVec2, DVec3};
use pgsag_scene::{Map, RigidTransform};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{DepthMap, DepthView};
use crate::error::MeshError;

/// What a depth must withstand.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FilterOptions {
    /// There and back over the other view's depth a pixel comes back to within this many pixels (method 2.5).
    pub max_reprojection_px: f64,
    /// The two depths differ by at most this share (method 3.8).
    pub max_relative_depth: f64,
    /// Surfaces seen at a smaller cosine of incidence are dropped; steps steeper than that are jumps (3.8: 80 degrees).
    pub min_cos: f64,
    /// Confidence below which a depth does not count, here or in the other views (3.8: accumulated opacity 0.5).
    pub min_weight: f32,
    /// From this many views that could see a point, three must agree instead of two.
    pub many_views: u32,
    /// Weight, as a share, of a depth that no other view could confirm; 0 drops it.
    pub single_view_weight: f32,
}

impl Default for FilterOptions {
    fn default() -> Self {
        Self {
            max_reprojection_px: 1.0,
            max_relative_depth: 0.01,
            min_cos: 0.174,
            min_weight: 0.5,
            many_views: 6,
            single_view_weight: 0.25,
        }
    }
}

impl FilterOptions {
    /// How many of the views that could see a point must agree.
    #[must_use]
    pub fn required(&self, could_see: u32) -> u32 {
        if could_see >= self.many_views { 3 } else { could_see.min(2) }
    }
}

/// What another view says about a point.
enum Opinion {
    /// It has no say: off its image, no depth there, or behind something that both views know of.
    None,
    Agrees,
    /// It sees past the point, or the reference sees past what it sees.
    Disagrees,
}

/// A neighbour with the motion to it.
struct Neighbour<'a> {
    view: &'a DepthView<'a>,
    neighbour_from_reference: RigidTransform,
    reference_from_neighbour: RigidTransform,
}

/// Keeps the depths of `reference` that enough of `neighbours` confirm.
///
/// # Errors
/// A raster of the wrong size.
pub fn filter(
    reference: &DepthView<'_>,
    neighbours: &[&DepthView<'_>],
    options: &FilterOptions,
) -> Result<DepthMap, MeshError> {
    reference.check()?;
    neighbours.iter().try_for_each(|view| view.check())?;
    let neighbours: Vec<Neighbour<'_>> = neighbours
        .iter()
        .map(|view| {
            let neighbour_from_reference = view.camera_from_world * reference.camera_from_world.inverse();
            let reference_from_neighbour = neighbour_from_reference.inverse();
            Neighbour { view, neighbour_from_reference, reference_from_neighbour }
        })
        .collect();
    let (width, height) = (reference.camera.width, reference.camera.height);
    let mut kept = DepthMap::empty(width, height);
    kept.normal.clone_from(&reference.normal);
    let rows = kept.depth.values.par_chunks_mut(width.max(1) as usize);
    let weights = kept.weight.values.par_chunks_mut(width.max(1) as usize);
    let supports = kept.support.values.par_chunks_mut(width.max(1) as usize);
    rows.zip(weights).zip(supports).enumerate().for_each(|(y, ((depth, weight), support))| {
        for x in 0..width {
            let Some((share, agreeing)) = check_pixel(reference, &neighbours, x, y as u32, options) else { continue };
            depth[x as usize] = reference.depth.at(x, y as u32);
            weight[x as usize] = reference.weight.at(x, y as u32) * share;
            support[x as usize] = agreeing;
        }
    });
    Ok(kept)
}

/// Share of its weight that a pixel keeps and how many views agree; `None` where it is dropped.
fn check_pixel(
    reference: &DepthView<'_>,
    neighbours: &[Neighbour<'_>],
    x: u32,
    y: u32,
    options: &FilterOptions,
) -> Option<(f32, u8)> {
    let depth = valid_depth(reference, x, y, options)?;
    if is_ramp(reference, x, y, depth, options) || is_grazing(reference, x, y, options) {
        return None;
    }
    let at = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
    let point = reference.camera.ray(at.x, at.y) * depth;
    let (mut could_see, mut agree) = (0, 0);
    for neighbour in neighbours {
        match opinion(reference, neighbour, at, point, options) {
            Opinion::None => {}
            Opinion::Agrees => {
                could_see += 1;
                agree += 1;
            }
            Opinion::Disagrees => could_see += 1,
        }
    }
    if agree < options.required(could_see) {
        return None;
    }
    let share = if agree == 0 { options.single_view_weight } else { 1.0 };
    (share > 0.0).then_some((share, agree.min(255) as u8))
}

fn valid_depth(view: &DepthView<'_>, x: u32, y: u32, options: &FilterOptions) -> Option<f64> {
    let depth = view.depth.at(x, y);
    let sure = view.weight.at(x, y) > 0.0 && view.weight.at(x, y) >= options.min_weight;
    (depth > 0.0 && depth.is_finite() && sure).then_some(f64::from(depth))
}

/// Whether the depth jumps to both sides along an axis: a pixel on a blended ramp, or one that floats alone. A pixel at
/// a clean edge has one smooth side. A plane at incidence `i` changes by at most `depth / focal / cos(i)` per pixel.
fn is_ramp(view: &DepthView<'_>, x: u32, y: u32, depth: f64, options: &FilterOptions) -> bool {
    let smooth = |x: Option<u32>, y: Option<u32>, focal: f64| {
        let (Some(x), Some(y)) = (x, y) else { return false };
        if x >= view.camera.width || y >= view.camera.height {
            return false;
        }
        let other = f64::from(view.depth.at(x, y));
        other > 0.0 && (other - depth).abs() <= other.min(depth) / (focal * options.min_cos)
    };
    let (fx, fy) = (view.camera.fx, view.camera.fy);
    let along_x = smooth(x.checked_sub(1), Some(y), fx) || smooth(Some(x + 1), Some(y), fx);
    let along_y = smooth(Some(x), y.checked_sub(1), fy) || smooth(Some(x), Some(y + 1), fy);
    !(along_x && along_y)
}

fn is_grazing(view: &DepthView<'_>, x: u32, y: u32, options: &FilterOptions) -> bool {
    let Some(normals) = &view.normal else { return false };
    let normal = DVec3::from(normals.at(x, y).map(f64::from));
    let ray = view.camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
    normal != DVec3::ZERO && normal.dot(ray).abs() < options.min_cos * ray.length() * normal.length()
}

fn opinion(
    reference: &DepthView<'_>,
    neighbour: &Neighbour<'_>,
    at: DVec2,
    point: DVec3,
    options: &FilterOptions,
) -> Opinion {
    let view = neighbour.view;
    let there = neighbour.neighbour_from_reference.transform_point(point);
    let Some(pixel) = view.camera.project(there).filter(|pixel| view.camera.contains(*pixel)) else {
        return Opinion::None;
    };
    let (px, py) = (pixel.x as u32, pixel.y as u32);
    if valid_depth(view, px, py, options).is_none() {
        return Opinion::None;
    }
    let seen = depth_at(&view.depth, pixel);
    let seen_point = view.camera.ray(pixel.x, pixel.y) * seen;
    let back_point = neighbour.reference_from_neighbour.transform_point(seen_point);
    let Some(back) = reference.camera.project(back_point) else { return Opinion::None };
    let same_depth = (seen - there.z).abs() <= options.max_relative_depth * there.z;
    if same_depth && back.distance(at) < options.max_reprojection_px {
        return Opinion::Agrees;
    }
    if seen >= there.z {
        return Opinion::Disagrees;
    }
    // The neighbour sees something nearer. Does the reference know of it, or does it look straight through?
    if !reference.camera.contains(back) {
        return Opinion::None;
    }
    match valid_depth(reference, back.x as u32, back.y as u32, options) {
        Some(here) if here > back_point.z * (1.0 + options.max_relative_depth) => Opinion::Disagrees,
        _ => Opinion::None,
    }
}

/// Depth between four pixels where they lie on one surface, else that of the pixel itself.
fn depth_at(depth: &Map<f32>, at: DVec2) -> f64 {
    let nearest = f64::from(depth.at(at.x as u32, at.y as u32));
    let (u, v) = (at.x - 0.5, at.y - 0.5);
    if u < 0.0 || v < 0.0 || u as u32 + 1 >= depth.width || v as u32 + 1 >= depth.height {
        return nearest;
    }
    let (x, y) = (u as u32, v as u32);
    let taps = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)].map(|(x, y)| f64::from(depth.at(x, y)));
    if taps.iter().any(|z| (z - nearest).abs() > 0.02 * nearest) {
        return nearest;
    }
    let (a, b) = (u - f64::from(x), v - f64::from(y));
    (taps[0] * (1.0 - a) + taps[1] * a) * (1.0 - b) + (taps[2] * (1.0 - a) + taps[3] * a) * b
}
