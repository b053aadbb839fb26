//! Depth maps to oriented points: one point per cell of a grid, from the view that matches best there.

use std::collections::BTreeMap;

use pgsag_scene::{Image, Map, Pinhole, RigidTransform};

use super::StereoDepth;

/// A point of a surface with its direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// World frame.
    pub position_world: [f64; 3],
    /// Unit, world frame, towards the camera that saw it.
    pub normal_world: [f32; 3],
    /// RGB.
    pub color: [u8; 3],
    /// 1 − NCC: lower is better.
    pub cost: f32,
    /// Whatever number the caller gave to the view that found it.
    pub view: u32,
}

/// Lifts the valid pixels of one view. `depth` is 0 where there is no surface (it may be stricter than that of
/// `found`); all maps and the image share one size.
#[must_use]
pub fn lift(
    view: u32,
    camera: &Pinhole,
    camera_from_world: &RigidTransform,
    depth: &Map<f32>,
    found: &StereoDepth,
    image: &Image,
) -> Vec<SurfacePoint> {
    let world_from_camera = camera_from_world.inverse();
    let width = depth.width as usize;
    let valid = depth.values.iter().enumerate().filter(|(_, z)| **z > 0.0);
    valid
        .map(|(index, z)| {
            let ray = camera.ray((index % width) as f64 + 0.5, (index / width) as f64 + 0.5);
            let normal = found.normal.values[index].map(f64::from);
            SurfacePoint {
                position_world: world_from_camera.transform_point(ray * f64::from(*z)).to_array(),
                normal_world: (world_from_camera.rotation * glam::DVec3::from_array(normal)).as_vec3().to_array(),
                color: image.pixels[index],
                cost: found.cost.values[index],
                view,
            }
        })
        .collect()
}

/// Keeps the best-matching point of every cell; in the order of the cells, so that the result does not depend on the
/// order of the views.
#[must_use]
pub fn thin_points(points: impl IntoIterator<Item = SurfacePoint>, cell: f64) -> Vec<SurfacePoint> {
    let mut best: BTreeMap<([i64; 3], u8), SurfacePoint> = BTreeMap::new();
    for point in points {
        let key = (point.position_world.map(|v| (v / cell).floor() as i64), octant(point.normal_world));
        let entry = best.entry(key).or_insert(point);
        let rank = |p: &SurfacePoint| (p.cost, p.position_world);
        if rank(&point).partial_cmp(&rank(entry)) == Some(std::cmp::Ordering::Less) {
            *entry = point;
        }
    }
    best.into_values().collect()
}

/// The two sides of a thin wall fall into one cell but face different ways.
fn octant(normal: [f32; 3]) -> u8 {
    let largest = (0..3).max_by(|a, b| normal[*a].abs().total_cmp(&normal[*b].abs())).unwrap_or(0);
    (largest * 2) as u8 + u8::from(normal[largest] > 0.0)
}
