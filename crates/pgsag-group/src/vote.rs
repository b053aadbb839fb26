//! Reliability-scored multi-view voting. Paper Eq. 6-7.
//!
//! The paper projects every point into every image; a point behind a house would then vote for it. Here only views that
//! really see the point vote: those of its track, or, in a model without tracks, those where a depth buffer of the
//! sparse points says that nothing is in front.

use pgsag_scene::{Map, Scene};
use serde::{Deserialize, Serialize};

use crate::distance::signed_distance;

/// How votes are counted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VoteOptions {
    /// Votes for "building" that a reliable point needs.
    pub min_inside: u32,
    /// Largest share of votes against, `outside / (inside + outside)`.
    pub max_outside_share: f32,
    /// The paper's tolerance τ as a count of votes against; replaces the share where given. Eq. 7.
    pub max_outside_count: Option<u32>,
    /// Within this distance outside the mask's edge a view abstains: tie points sit on eaves. Pixels of the image.
    pub edge_tolerance_px: f32,
    /// In a model without tracks: how much farther than the nearest sparse point of its cell a point may lie.
    pub depth_tolerance: f32,
}

impl Default for VoteOptions {
    fn default() -> Self {
        Self {
            min_inside: 2,
            max_outside_share: 0.3,
            max_outside_count: None,
            edge_tolerance_px: 2.5,
            depth_tolerance: 0.02,
        }
    }
}

/// What the views say of one point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Vote {
    /// Views that see it inside a mask.
    pub inside: u32,
    /// Views that see it outside: the unreliability score US of Eq. 7.
    pub outside: u32,
}

impl Vote {
    /// Potential building point: in a mask at least once. Eq. 6.
    #[must_use]
    pub fn is_potential(&self) -> bool {
        self.inside > 0
    }

    /// Reliable building point: potential, and not refused by too many views. Eq. 7.
    #[must_use]
    pub fn is_reliable(&self, options: &VoteOptions) -> bool {
        let agreed = match options.max_outside_count {
            Some(count) => self.outside < count,
            None => self.outside as f32 <= options.max_outside_share * (self.inside + self.outside) as f32,
        };
        self.is_potential() && self.inside >= options.min_inside && agreed
    }
}

/// Counts the votes of all views. `mask_of` gives a view's building mask in its undistorted image (any size; scaled to
/// the camera), or `None` where it is unknown: such a view does not vote.
///
/// # Errors
/// The first error of `mask_of`.
pub fn vote<E>(
    scene: &Scene,
    mut mask_of: impl FnMut(usize) -> Result<Option<Map<bool>>, E>,
    options: &VoteOptions,
) -> Result<Vec<Vote>, E> {
    let sightings = sightings(scene, options);
    let mut votes = vec![Vote::default(); scene.points.len()];
    for (view_index, seen) in sightings.iter().enumerate() {
        let Some(mask) = mask_of(view_index)? else { continue };
        let camera = &scene.views[view_index].camera;
        let scale = [mask.width as f32 / camera.width as f32, mask.height as f32 / camera.height as f32];
        let distance = signed_distance(&mask);
        for &(point_index, xy_px) in seen {
            let (x, y) = ((xy_px[0] * scale[0]).floor(), (xy_px[1] * scale[1]).floor());
            if !(x >= 0.0 && y >= 0.0 && x < mask.width as f32 && y < mask.height as f32) {
                continue;
            }
            let distance_px = distance.at(x as u32, y as u32) / scale[0];
            let vote = &mut votes[point_index as usize];
            if distance_px < 0.0 {
                vote.inside += 1;
            } else if distance_px > options.edge_tolerance_px {
                vote.outside += 1;
            }
        }
    }
    Ok(votes)
}

/// Per view: which points it sees, and where.
fn sightings(scene: &Scene, options: &VoteOptions) -> Vec<Vec<(u32, [f32; 2])>> {
    let mut sightings = vec![Vec::new(); scene.views.len()];
    if scene.points.iter().any(|point| !point.track.is_empty()) {
        for (point_index, point) in scene.points.iter().enumerate() {
            for seen in &point.track {
                sightings[seen.view_index as usize].push((point_index as u32, seen.xy_px));
            }
        }
        return sightings;
    }
    for (view_index, seen) in sightings.iter_mut().enumerate() {
        *seen = sightings_by_depth(scene, view_index, options.depth_tolerance);
    }
    sightings
}

/// Cells of the sparse depth buffer, pixels of the image. Method: 1/8 resolution of a 1000 px image holds a few points.
const CELL_PX: u32 = 8;

fn sightings_by_depth(scene: &Scene, view_index: usize, depth_tolerance: f32) -> Vec<(u32, [f32; 2])> {
    let view = &scene.views[view_index];
    let (columns, rows) = (view.camera.width.div_ceil(CELL_PX), view.camera.height.div_ceil(CELL_PX));
    let mut nearest = Map::filled(columns, rows, f64::INFINITY);
    let mut projected = Vec::new();
    for (point_index, point) in scene.points.iter().enumerate() {
        let point_camera = view.camera_from_world.transform_point(point.position_world);
        let Some(at) = view.camera.project(point_camera).filter(|at| view.camera.contains(*at)) else { continue };
        let cell = (at.x as u32 / CELL_PX, at.y as u32 / CELL_PX);
        nearest.set(cell.0, cell.1, nearest.at(cell.0, cell.1).min(point_camera.z));
        projected.push((point_index as u32, at, cell, point_camera.z));
    }
    let reach = 1.0 + f64::from(depth_tolerance);
    projected
        .into_iter()
        .filter(|(_, _, cell, depth)| *depth <= nearest.at(cell.0, cell.1) * reach)
        .map(|(point_index, at, _, _)| (point_index, [at.x as f32, at.y as f32]))
        .collect()
}

#[cfg(test)]
mod tests;
