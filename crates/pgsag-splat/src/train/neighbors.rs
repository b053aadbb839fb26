//! Which other views a view is compared with: those that see the same surface from a useful angle (method.md 2.9, 8.9).

use std::collections::BTreeMap;

use glam::DVec3;
use pgsag_scene::{Scene, View};
use serde::{Deserialize, Serialize};

/// A view to compare with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbor {
    /// Position in the list of views that was given (not the scene's index).
    pub view: u32,
    /// How useful it is; larger is better. Angle and distance decide where there are no tracks.
    pub score: f32,
}

/// What makes a neighbour.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NeighborOptions {
    /// Neighbours per view. PGSR: 8.
    pub count: u32,
    /// Least shared points.
    pub min_shared: u32,
    /// Least angle between the rays of a shared point, degrees.
    pub min_angle_deg: f64,
    /// Most useful angle, degrees.
    pub best_angle_deg: f64,
    /// Largest angle, degrees; also the largest angle of optical axes where there are no tracks. PGSR: 30.
    pub max_angle_deg: f64,
    /// Largest ratio of ground sampling distances.
    pub max_gsd_ratio: f64,
    /// Largest distance of camera centres where there are no tracks, in median depths.
    pub max_distance: f64,
}

impl Default for NeighborOptions {
    fn default() -> Self {
        Self {
            count: 8,
            min_shared: 50,
            min_angle_deg: 3.0,
            best_angle_deg: 10.0,
            max_angle_deg: 30.0,
            max_gsd_ratio: 2.0,
            max_distance: 0.6,
        }
    }
}

/// Longer tracks are thinned evenly to this many views, so that work stays linear in the observations.
const MAX_TRACK: usize = 32;

/// Neighbours of each view of `view_indices` (indices into `Scene::views`), best first. Views that share too few points
/// with any other are content with a quarter of them, and then with optical axis and distance.
#[must_use]
pub fn neighbors_of(scene: &Scene, view_indices: &[u32], options: &NeighborOptions) -> Vec<Vec<Neighbor>> {
    let shared = shared_points(scene, view_indices, options);
    let mut lists = by_shared(&shared, view_indices.len(), options.min_shared);
    let poor = by_shared(&shared, view_indices.len(), (options.min_shared / 4).max(1));
    let depth = scene.median_depth();
    for (position, (list, poor)) in lists.iter_mut().zip(poor).enumerate() {
        if list.is_empty() {
            *list = poor;
        }
        if list.is_empty() {
            *list = by_pose(scene, view_indices, position, depth, options);
        }
        list.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.view.cmp(&b.view)));
        list.truncate(options.count as usize);
    }
    lists
}

fn by_shared(shared: &BTreeMap<(u32, u32), Pair>, count: usize, min_shared: u32) -> Vec<Vec<Neighbor>> {
    let mut lists = vec![Vec::new(); count];
    for (&(a, b), pair) in shared {
        if pair.count >= min_shared {
            lists[a as usize].push(Neighbor { view: b, score: pair.score });
            lists[b as usize].push(Neighbor { view: a, score: pair.score });
        }
    }
    lists
}

/// What two views share.
#[derive(Clone, Copy, Default)]
struct Pair {
    count: u32,
    score: f32,
}

fn shared_points(scene: &Scene, view_indices: &[u32], options: &NeighborOptions) -> BTreeMap<(u32, u32), Pair> {
    let mut position_of = vec![u32::MAX; scene.views.len()];
    for (position, &view) in view_indices.iter().enumerate() {
        position_of[view as usize] = position as u32;
    }
    let centers: Vec<DVec3> = scene.views.iter().map(View::center_world).collect();
    let mut pairs: BTreeMap<(u32, u32), Pair> = BTreeMap::new();
    let mut seen: Vec<(u32, DVec3, f64)> = Vec::new();
    for point in &scene.points {
        seen.clear();
        let mut views: Vec<u32> = point.track.iter().map(|t| t.view_index).collect();
        views.retain(|v| position_of.get(*v as usize).is_some_and(|p| *p != u32::MAX));
        views.sort_unstable();
        views.dedup();
        let kept = views.len().min(MAX_TRACK);
        for k in 0..kept {
            let index = views[k * views.len() / kept] as usize;
            let view = &scene.views[index];
            let depth = view.camera_from_world.transform_point(point.position_world).z;
            let ray = (centers[index] - point.position_world).normalize_or_zero();
            seen.push((position_of[index], ray, depth / view.camera.focal_px()));
        }
        for (i, first) in seen.iter().enumerate() {
            for second in &seen[i + 1..] {
                let weight = usefulness(first, second, options);
                if weight > 0.0 {
                    let key = (first.0.min(second.0), first.0.max(second.0));
                    let pair = pairs.entry(key).or_default();
                    pair.count += 1;
                    pair.score += weight;
                }
            }
        }
    }
    pairs
}

/// 1 at the best angle, falling to both sides; 0 outside the limits of angle or resolution.
fn usefulness(a: &(u32, DVec3, f64), b: &(u32, DVec3, f64), options: &NeighborOptions) -> f32 {
    let ratio = (a.2 / b.2).max(b.2 / a.2);
    if !(a.2 > 0.0 && b.2 > 0.0 && ratio <= options.max_gsd_ratio) {
        return 0.0;
    }
    let angle = libm::acos(a.1.dot(b.1).clamp(-1.0, 1.0)).to_degrees();
    if angle < options.min_angle_deg || angle > options.max_angle_deg {
        return 0.0;
    }
    (angle / options.best_angle_deg).min(options.best_angle_deg / angle) as f32
}

fn by_pose(
    scene: &Scene,
    view_indices: &[u32],
    position: usize,
    depth: Option<f64>,
    options: &NeighborOptions,
) -> Vec<Neighbor> {
    let of = |position: usize| {
        let view = &scene.views[view_indices[position] as usize];
        (view.center_world(), view.camera_from_world.rotation.inverse() * DVec3::Z)
    };
    let (center, axis) = of(position);
    let limit = depth.map_or(f64::INFINITY, |depth| options.max_distance * depth);
    let mut found: Vec<(f64, u32)> = (0..view_indices.len())
        .filter(|other| *other != position)
        .filter_map(|other| {
            let (other_center, other_axis) = of(other);
            let angle = libm::acos(axis.dot(other_axis).clamp(-1.0, 1.0)).to_degrees();
            let distance = center.distance(other_center);
            (angle < options.max_angle_deg && distance > 0.0 && distance < limit).then_some((distance, other as u32))
        })
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let nearest = found.first().map_or(1.0, |f| f.0);
    found.into_iter().map(|(distance, view)| Neighbor { view, score: (nearest / distance) as f32 }).collect()
}

#[cfg(test)]
mod tests;
