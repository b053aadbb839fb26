//! The background as geographic blocks (VastGaussian, Lin et al. 2024, section 3.2; method 3.7): cells with equal counts
//! of cameras, expanded for training, kept only inside, outer cells without end.

use glam::{DVec2, DVec3};
use pgsag_scene::{Pinhole, RigidTransform};
use serde::{Deserialize, Serialize};

use crate::plan::PlanFrame;

/// How the background is divided.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BlockOptions {
    /// Cameras over one block; there is one more block for each so many more.
    pub cameras_per_block: u32,
    /// How far a block reaches into its neighbours in training, as a share of its side. VastGaussian: 0.2.
    pub expansion: f64,
    /// Share of an image that the block's airspace covers for the image to belong to it. VastGaussian: 0.25.
    pub min_airspace: f64,
    /// Share of a building's steps that a block takes; less where nobody looks at what lies between buildings.
    pub steps_share: f32,
}

impl Default for BlockOptions {
    fn default() -> Self {
        Self { cameras_per_block: 100, expansion: 0.2, min_airspace: 0.25, steps_share: 1.0 }
    }
}

/// A rectangle in plan; outer sides are infinite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// What it owns: lowest corner.
    pub low: DVec2,
    /// What it owns: highest corner.
    pub high: DVec2,
    /// What it is trained on besides lies within this of it.
    pub margin: DVec2,
}

impl Block {
    /// Whether it owns a place.
    #[must_use]
    pub fn owns(&self, plan: DVec2) -> bool {
        plan.cmpge(self.low).all() && plan.cmplt(self.high).all()
    }

    /// Whether a place takes part in its training.
    #[must_use]
    pub fn reaches(&self, plan: DVec2) -> bool {
        plan.cmpge(self.low - self.margin).all() && plan.cmplt(self.high + self.margin).all()
    }
}

/// Divides the plane by the cameras' places: strips with equal counts along x, cells with equal counts along y.
#[must_use]
pub fn blocks(cameras: &[DVec2], options: &BlockOptions, at_least: usize) -> Vec<Block> {
    let wanted = cameras.len().div_ceil(options.cameras_per_block.max(1) as usize).max(at_least).max(1);
    let bound = |pick: fn(DVec2, DVec2) -> DVec2| cameras.iter().copied().reduce(pick).unwrap_or(DVec2::ZERO);
    let (low, high) = (bound(DVec2::min), bound(DVec2::max));
    let size = (high - low).max(DVec2::splat(1e-9));
    let columns = ((wanted as f64 * size.x / size.y).sqrt().round() as usize).clamp(1, wanted);
    let rows = wanted.div_ceil(columns);
    let mut order: Vec<DVec2> = cameras.to_vec();
    order.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let mut found = Vec::new();
    for column in 0..columns {
        let strip = &order[column * order.len() / columns..(column + 1) * order.len() / columns];
        let xs = [edge(&order, column, columns, |p| p.x), edge(&order, column + 1, columns, |p| p.x)];
        let mut strip = strip.to_vec();
        strip.sort_by(|a, b| a.y.total_cmp(&b.y).then(a.x.total_cmp(&b.x)));
        for row in 0..rows {
            let ys = [edge(&strip, row, rows, |p| p.y), edge(&strip, row + 1, rows, |p| p.y)];
            let inner = DVec2::new(xs[1].min(high.x) - xs[0].max(low.x), ys[1].min(high.y) - ys[0].max(low.y));
            let (from, to) = (DVec2::new(xs[0], ys[0]), DVec2::new(xs[1], ys[1]));
            found.push(Block { low: from, high: to, margin: inner.max(DVec2::ZERO) * options.expansion });
        }
    }
    found
}

/// Between the cameras before and after a cut; infinite at the ends.
fn edge(sorted: &[DVec2], cut: usize, cuts: usize, of: fn(&DVec2) -> f64) -> f64 {
    let at = cut * sorted.len() / cuts;
    match (cut, cut == cuts || at >= sorted.len()) {
        (0, _) => f64::NEG_INFINITY,
        (_, true) => f64::INFINITY,
        _ if at == 0 => f64::NEG_INFINITY,
        _ => 0.5 * (of(&sorted[at - 1]) + of(&sorted[at])),
    }
}

/// A block's airspace: its plan rectangle between the ground and the highest point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Airspace {
    /// Lowest corner in plan, finite.
    pub low: DVec2,
    /// Highest corner in plan, finite.
    pub high: DVec2,
    /// Lowest and highest point.
    pub heights: [f64; 2],
}

impl Airspace {
    /// Share of a view's image that the airspace covers: the hull of its projected corners, cut at the image's border.
    #[must_use]
    pub fn share(&self, frame: &PlanFrame, camera: &Pinhole, pose: &RigidTransform) -> f64 {
        let near = 1e-6 * (self.high - self.low).length().max(1e-9);
        let corner = |k: usize| {
            let plan = DVec2::new(
                if k & 1 == 0 { self.low.x } else { self.high.x },
                if k & 2 == 0 { self.low.y } else { self.high.y },
            );
            pose.transform_point(frame.world(plan, self.heights[k >> 2]))
        };
        let corners: [DVec3; 8] = std::array::from_fn(corner);
        let mut projected: Vec<DVec2> = Vec::new();
        for (a, &from) in corners.iter().enumerate() {
            projected.extend(camera.project(from).filter(|_| from.z > near));
            // Edges that pass the camera are cut in front of it.
            for bit in [1, 2, 4].into_iter().filter(|bit| a & bit == 0) {
                let to = corners[a | bit];
                if (from.z > near) != (to.z > near) {
                    let cut = from + (to - from) * ((2.0 * near - from.z) / (to.z - from.z));
                    projected.extend(camera.project(cut));
                }
            }
        }
        let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
        area(&clipped(hull(projected), size)) / (size.x * size.y)
    }
}

/// Convex hull, counter-clockwise (Andrew 1979).
fn hull(mut points: Vec<DVec2>) -> Vec<DVec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let half = |points: &mut dyn Iterator<Item = DVec2>| {
        let mut chain: Vec<DVec2> = Vec::new();
        for point in points {
            while let [.., a, b] = chain[..] {
                if (b - a).perp_dot(point - a) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut lower = half(&mut points.iter().copied());
    lower.extend(half(&mut points.iter().rev().copied()));
    lower
}

/// A convex polygon cut to `[0, size]` (Sutherland and Hodgman 1974).
fn clipped(mut polygon: Vec<DVec2>, size: DVec2) -> Vec<DVec2> {
    let sides: [(DVec2, f64); 4] = [(DVec2::X, 0.0), (DVec2::Y, 0.0), (DVec2::NEG_X, -size.x), (DVec2::NEG_Y, -size.y)];
    for (normal, limit) in sides {
        let inside = |p: DVec2| p.dot(normal) - limit;
        let mut kept = Vec::new();
        for at in 0..polygon.len() {
            let (a, b) = (polygon[at], polygon[(at + 1) % polygon.len()]);
            let (da, db) = (inside(a), inside(b));
            if da >= 0.0 {
                kept.push(a);
            }
            if (da >= 0.0) != (db >= 0.0) {
                kept.push(a + (b - a) * (da / (da - db)));
            }
        }
        polygon = kept;
    }
    polygon
}

fn area(polygon: &[DVec2]) -> f64 {
    let cross = |at: usize| polygon[at].perp_dot(polygon[(at + 1) % polygon.len()]);
    0.5 * (0..polygon.len()).map(cross).sum::<f64>().abs()
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    #[test]
    fn blocks_share_the_cameras_evenly_and_own_every_place_once() {
        let cameras: Vec<DVec2> =
            (0..400).map(|i| DVec2::new(f64::from(i % 20).powi(2), f64::from(i / 20) * 7.0)).collect();
        let found = blocks(&cameras, &BlockOptions { cameras_per_block: 50, ..BlockOptions::default() }, 1);
        assert!(found.len() >= 8, "{}", found.len());
        for block in &found {
            let own = cameras.iter().filter(|camera| block.owns(**camera)).count();
            assert!((20..=80).contains(&own), "{own}");
        }
        for place in [DVec2::splat(-1e9), DVec2::new(1e9, 3.0), DVec2::new(100.0, 50.0), DVec2::new(30.1, 70.0)] {
            assert_eq!(found.iter().filter(|block| block.owns(place)).count(), 1, "{place}");
        }
        assert!(found.iter().filter(|block| block.reaches(DVec2::new(100.0, 70.0))).count() >= 1);
        assert_eq!(blocks(&cameras[..3], &BlockOptions::default(), 1).len(), 1);
    }

    #[test]
    fn airspace_is_the_share_of_the_image() {
        let camera = Pinhole { width: 100, height: 100, fx: 100.0, fy: 100.0, cx: 50.0, cy: 50.0 };
        let pose = RigidTransform { rotation: DQuat::IDENTITY, translation: DVec3::ZERO };
        let frame = PlanFrame::new(DVec3::Z);
        let (x, y) = (frame.plan(DVec3::X), frame.plan(DVec3::Y));
        let corners = [x * -1.0 + y * -1.0, x * 4.0 + y * 4.0];
        let airspace =
            |heights| Airspace { low: corners[0].min(corners[1]), high: corners[0].max(corners[1]), heights };
        // At depth 10 the image spans -5 … 5, so five by five of ten by ten are covered.
        assert!((airspace([10.0, 10.0]).share(&frame, &camera, &pose) - 0.25).abs() < 1e-9);
        assert_eq!(airspace([-10.0, -9.0]).share(&frame, &camera, &pose), 0.0);
        assert!(airspace([-10.0, 10.0]).share(&frame, &camera, &pose) > 0.9, "it holds the camera");
    }
}
