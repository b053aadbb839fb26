//! Reliability-scored multi-view voting. Paper Eq. 6-7.
//!
//! The paper projects every point into every image; a point behind a house would then vote for it. Here only views that
//! really see the point vote: those of its track, and those where a depth buffer of all points says that nothing is in
//! front.

use pgsag_scene::{Map, Scene};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::distance::signed_distance;
use crate::surface::Surface;

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
    /// How much farther than the nearest surface of its pixel a point may lie to be seen, as a share of its depth.
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

/// Views whose votes are counted at once; a fixed number, so that memory is bounded.
const BATCH: usize = 8;

/// Counts the votes of all views. `mask_of` gives a view's building mask in its undistorted image (any size; scaled to
/// the camera), or `None` where it is unknown: such a view does not vote. `surface` is that of the scene's points.
///
/// # Errors
/// The first error of `mask_of`.
pub fn vote<E: Send>(
    scene: &Scene,
    surface: &Surface,
    mask_of: impl Fn(usize) -> Result<Option<Map<bool>>, E> + Sync,
    options: &VoteOptions,
) -> Result<Vec<Vote>, E> {
    let tracks = Tracks::of(scene);
    let mut votes = vec![Vote::default(); scene.points.len()];
    let views: Vec<usize> = (0..scene.views.len()).collect();
    for batch in views.chunks(BATCH) {
        let ballots = batch.par_iter().map(|&view_index| {
            let Some(mask) = mask_of(view_index)? else { return Ok(Vec::new()) };
            Ok(ballots(scene, surface, tracks.of_view(view_index), view_index, &mask, options))
        });
        for (point_index, is_inside) in ballots.collect::<Result<Vec<_>, E>>()?.into_iter().flatten() {
            let vote = &mut votes[point_index as usize];
            if is_inside { vote.inside += 1 } else { vote.outside += 1 }
        }
    }
    Ok(votes)
}

/// Which points a view sees, in or out of its mask; those beside the mask's edge are left out.
fn ballots(
    scene: &Scene,
    surface: &Surface,
    tracked: &[(u32, [f32; 2])],
    view_index: usize,
    mask: &Map<bool>,
    options: &VoteOptions,
) -> Vec<(u32, bool)> {
    let camera = &scene.views[view_index].camera;
    let scale = [mask.width as f32 / camera.width as f32, mask.height as f32 / camera.height as f32];
    let distance = signed_distance(mask);
    let ballot = |(point_index, xy_px): (u32, [f32; 2])| {
        let (x, y) = ((xy_px[0] * scale[0]).floor(), (xy_px[1] * scale[1]).floor());
        if !(x >= 0.0 && y >= 0.0 && x < mask.width as f32 && y < mask.height as f32) {
            return None;
        }
        let distance_px = distance.at(x as u32, y as u32) / scale[0];
        let is_undecided = distance_px >= 0.0 && distance_px <= options.edge_tolerance_px;
        (!is_undecided).then_some((point_index, distance_px < 0.0))
    };
    let mut found: Vec<(u32, bool)> = tracked.iter().copied().filter_map(ballot).collect();
    let mut is_tracked = vec![false; scene.points.len()];
    tracked.iter().for_each(|(point_index, _)| is_tracked[*point_index as usize] = true);
    let beside = sightings_by_depth(scene, surface, view_index, options.depth_tolerance);
    found.extend(beside.into_iter().filter(|(point_index, _)| !is_tracked[*point_index as usize]).filter_map(ballot));
    found
}

/// Observations by view.
struct Tracks {
    starts: Vec<usize>,
    seen: Vec<(u32, [f32; 2])>,
}

impl Tracks {
    fn of(scene: &Scene) -> Self {
        let mut starts = vec![0; scene.views.len() + 1];
        let elements =
            || (0u32..).zip(&scene.points).flat_map(|(i, point)| point.track.iter().map(move |seen| (i, seen)));
        elements().for_each(|(_, seen)| starts[seen.view_index as usize + 1] += 1);
        (1..starts.len()).for_each(|view| starts[view] += starts[view - 1]);
        let mut next = starts.clone();
        let mut sorted = vec![(0, [0.0; 2]); starts[scene.views.len()]];
        for (point_index, seen) in elements() {
            let at = &mut next[seen.view_index as usize];
            sorted[*at] = (point_index, seen.xy_px);
            *at += 1;
        }
        Self { starts, seen: sorted }
    }

    fn of_view(&self, view_index: usize) -> &[(u32, [f32; 2])] {
        &self.seen[self.starts[view_index]..self.starts[view_index + 1]]
    }
}

/// Points that a view sees by the depth test, and where in its full image.
fn sightings_by_depth(
    scene: &Scene,
    surface: &Surface,
    view_index: usize,
    depth_tolerance: f32,
) -> Vec<(u32, [f32; 2])> {
    let view = &scene.views[view_index];
    let pose = &view.camera_from_world;
    let buffer = surface.render(&surface.buffer_camera(&view.camera, pose), pose, |_| true);
    let sighting = |point_index: u32| {
        let point_camera = pose.transform_point(surface.position(point_index));
        let at = view.camera.project(point_camera).filter(|at| view.camera.contains(*at))?;
        let is_seen = surface.is_seen(&buffer, point_camera, f64::from(depth_tolerance));
        is_seen.then_some((point_index, [at.x as f32, at.y as f32]))
    };
    surface.candidates(&view.camera, pose).filter_map(sighting).collect()
}

#[cfg(test)]
mod tests;
