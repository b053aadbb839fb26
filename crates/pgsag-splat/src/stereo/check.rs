//! Which stereo depths other views confirm.

use pgsag_scene::Map;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{StereoDepth, StereoView};

/// When two depth maps agree.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CheckOptions {
    /// There and back again within so many pixels of the stereo image.
    pub max_reprojection_px: f64,
    /// Depths within this share of one another.
    pub max_depth_ratio: f64,
    /// So many neighbours must agree.
    pub min_agreeing: u32,
}

impl Default for CheckOptions {
    fn default() -> Self {
        Self { max_reprojection_px: 1.0, max_depth_ratio: 0.01, min_agreeing: 2 }
    }
}

/// The depth of `reference` where enough neighbours agree, moved to the mean of those that do; 0 elsewhere.
#[must_use]
pub fn confirmed(
    reference: (&StereoView, &StereoDepth),
    neighbors: &[(&StereoView, &StereoDepth)],
    options: &CheckOptions,
) -> Map<f32> {
    let (view, found) = reference;
    let pairs: Vec<_> = neighbors
        .iter()
        .map(|(other, _)| {
            let other_from_view = other.camera_from_world * view.camera_from_world.inverse();
            (other_from_view, other_from_view.inverse())
        })
        .collect();
    let width = found.depth.width as usize;
    let confirmed_at = |index: usize| {
        let depth = f64::from(found.depth.values[index]);
        if depth <= 0.0 {
            return 0.0;
        }
        let at = glam::DVec2::new((index % width) as f64 + 0.5, (index / width) as f64 + 0.5);
        let point = view.camera.ray(at.x, at.y) * depth;
        let (mut sum, mut agreeing) = (depth, 0);
        for ((other, other_found), (other_from_view, view_from_other)) in neighbors.iter().zip(&pairs) {
            let there = other_from_view.transform_point(point);
            let Some(hit) = other.camera.project(there).filter(|hit| other.camera.contains(*hit)) else { continue };
            let seen = f64::from(other_found.depth.at(hit.x as u32, hit.y as u32));
            if seen <= 0.0 || (seen / there.z - 1.0).abs() > options.max_depth_ratio {
                continue;
            }
            let back = view_from_other.transform_point(other.camera.ray(hit.x, hit.y) * seen);
            let Some(home) = view.camera.project(back) else { continue };
            if home.distance(at) <= options.max_reprojection_px {
                sum += back.z;
                agreeing += 1;
            }
        }
        if agreeing >= options.min_agreeing { (sum / f64::from(agreeing + 1)) as f32 } else { 0.0 }
    };
    let values = (0..found.depth.values.len()).into_par_iter().map(confirmed_at).collect();
    Map { width: found.depth.width, height: found.depth.height, values }
}
