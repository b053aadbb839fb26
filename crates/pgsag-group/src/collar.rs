//! The strip of ground along the foot of facades that a building group is trained on too. Where a mask ends on a surface
//! that goes on, nothing holds the last pixels of a model, and they bulge towards the camera; with a collar the mask ends
//! on the ground, a little farther out, where another group's depths are taken anyway.

use std::collections::HashMap;

use glam::{DVec2, DVec3, I64Vec2, I64Vec3};
use pgsag_scene::numbers::quantile;

use crate::plan::PlanFrame;

/// The quantile of heights around a place that is its ground: a few points lie below it by error.
const GROUND_QUANTILE: f64 = 0.1;

/// For each cluster, which points of the `background` lie on the ground and within `reach` of one of its points:
/// `[clusters]`, indices as in `background` and in its order. What is more than `reach` above the ground around is no
/// ground: stereo carries the edges of roofs past their masks. Lengths in the units of `positions`; a reach of 0 finds
/// nothing.
#[must_use]
pub fn collars(
    clusters: &[&[u32]],
    background: &[u32],
    positions: &[DVec3],
    frame: &PlanFrame,
    reach: f64,
) -> Vec<Vec<u32>> {
    let mut found = vec![Vec::new(); clusters.len()];
    if reach <= 0.0 {
        return found;
    }
    let cell = |at: DVec3| (at / reach).floor().as_i64vec3();
    let mut cells: HashMap<I64Vec3, Vec<(u32, u32)>> = HashMap::new();
    for (cluster, points) in (0u32..).zip(clusters) {
        points
            .iter()
            .for_each(|&point| cells.entry(cell(positions[point as usize])).or_default().push((cluster, point)));
    }
    let ground = Heights::of(background.iter().map(|index| positions[*index as usize]), frame, 2.0 * reach);
    let mut near: Vec<u32> = Vec::new();
    for &index in background {
        let at = positions[index as usize];
        let steps = (0..27).map(|k| I64Vec3::new(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1));
        near.clear();
        for &(cluster, point) in steps.filter_map(|step| cells.get(&(cell(at) + step))).flatten() {
            if !near.contains(&cluster) && positions[point as usize].distance(at) <= reach {
                near.push(cluster);
            }
        }
        if !near.is_empty() && frame.height(at) <= ground.around(frame.plan(at)) + reach {
            near.iter().for_each(|cluster| found[*cluster as usize].push(index));
        }
    }
    found
}

/// The low heights of points by cell of plan view.
struct Heights {
    side: f64,
    low: HashMap<I64Vec2, f64>,
}

impl Heights {
    fn of(points: impl Iterator<Item = DVec3>, frame: &PlanFrame, side: f64) -> Self {
        let mut cells: HashMap<I64Vec2, Vec<f64>> = HashMap::new();
        for at in points {
            cells.entry(Self::cell(frame.plan(at), side)).or_default().push(frame.height(at));
        }
        let low =
            cells.into_iter().filter_map(|(cell, mut heights)| Some((cell, quantile(&mut heights, GROUND_QUANTILE)?)));
        Self { side, low: low.collect() }
    }

    fn cell(at: DVec2, side: f64) -> I64Vec2 {
        (at / side).floor().as_i64vec2()
    }

    /// The lowest of the nine cells about a place.
    fn around(&self, at: DVec2) -> f64 {
        let middle = Self::cell(at, self.side);
        let steps = (0..9).map(|k| I64Vec2::new(k % 3 - 1, k / 3 - 1));
        steps.filter_map(|step| self.low.get(&(middle + step))).copied().fold(f64::INFINITY, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_collar_is_the_ground_within_reach_of_a_cluster() {
        // Two walls of points at x = 0 and x = 3, ground along x at half a unit, and a point beside the top of the first.
        let wall = |x: f64| (0..8).map(move |k| DVec3::new(x, 0.0, 0.5 * f64::from(k)));
        let ground = (1..6).map(|k| DVec3::new(0.5 * f64::from(k), 0.0, 0.0));
        let stray = DVec3::new(0.5, 0.0, 3.5);
        let positions: Vec<DVec3> = wall(0.0).chain(wall(3.0)).chain(ground).chain([stray]).collect();
        let (first, second): (Vec<u32>, Vec<u32>) = ((0..8).collect(), (8..16).collect());
        let background: Vec<u32> = (16..22).collect();
        let frame = PlanFrame::new(DVec3::Z);
        let found = |reach| collars(&[&first, &second], &background, &positions, &frame, reach);
        assert_eq!(found(1.1), vec![vec![16, 17], vec![19, 20]]);
        assert_eq!(found(1.6), vec![vec![16, 17, 18], vec![18, 19, 20]]);
        assert_eq!(found(0.0), vec![Vec::<u32>::new(), Vec::new()]);
    }
}
