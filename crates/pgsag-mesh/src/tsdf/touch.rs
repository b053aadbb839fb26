//! Which blocks a view's surface passes: all that hold a node within two voxels of it, so that every cell the surface
//! crosses finds its eight corners.

use glam::DVec3;
use rayon::prelude::*;

use super::planes::PixelPlane;
use super::{BLOCK_SIDE, CellBox, Lattice};
use crate::fuse::DepthView;

/// Rows handled together; fixed, so that the result does not depend on the threads (it is sorted anyway).
const ROWS: usize = 16;
/// A corner of a crossed cell lies within sqrt(3) voxels of the surface.
const REACH_VOXELS: f64 = 2.0;
/// Pixels coarser than this many voxels leave gaps rather than fill the memory.
const MAX_SPREAD_VOXELS: f64 = 12.0;

/// Keys of the touched blocks inside `region` and so many beside it, sorted.
pub(crate) fn touched_blocks(
    view: &DepthView<'_>,
    planes: &[PixelPlane],
    lattice: &Lattice,
    region: &CellBox,
    margin_blocks: i32,
) -> Vec<[i32; 3]> {
    let width = view.camera.width as usize;
    if region.is_empty() || width == 0 {
        return Vec::new();
    }
    let (low, high) = region.block_range();
    let range = (low.map(|k| k - margin_blocks), high.map(|k| k + margin_blocks));
    let parts: Vec<Vec<[i32; 3]>> = planes
        .par_chunks(width * ROWS)
        .enumerate()
        .map(|(chunk, part)| touched_by_rows(view, part, chunk * ROWS, lattice, range))
        .collect();
    let mut keys = parts.concat();
    keys.sort_unstable();
    keys.dedup();
    keys
}

fn touched_by_rows(
    view: &DepthView<'_>,
    planes: &[PixelPlane],
    first_row: usize,
    lattice: &Lattice,
    range: ([i32; 3], [i32; 3]),
) -> Vec<[i32; 3]> {
    let camera = view.camera;
    let world_from_camera = view.camera_from_world.inverse();
    let rotation = world_from_camera.rotation_matrix();
    let side = f64::from(BLOCK_SIDE);
    let mut keys = Vec::new();
    let mut last = None;
    for (at, plane) in planes.iter().enumerate().filter(|(_, plane)| plane.weight > 0.0) {
        let (x, y) = (at % camera.width as usize, first_row + at / camera.width as usize);
        let depth = f64::from(plane.depth);
        let point = rotation * (camera.ray(x as f64 + 0.5, y as f64 + 0.5) * depth) + world_from_camera.translation;
        let normal = rotation * plane.normal.as_dvec3();
        let pixel = depth / (camera.focal_px() * lattice.voxel * f64::from(plane.cos));
        let spread = (0.75 * pixel).min(MAX_SPREAD_VOXELS);
        let lateral = (DVec3::ONE - normal * normal).max(DVec3::ZERO);
        let half =
            normal.abs() * REACH_VOXELS + DVec3::new(lateral.x.sqrt(), lateral.y.sqrt(), lateral.z.sqrt()) * spread;
        let center = lattice.to_voxels(point);
        let low = ((center - half) / side).floor();
        let high = ((center + half) / side).floor();
        let low = [low.x as i32, low.y as i32, low.z as i32];
        let high = [high.x as i32, high.y as i32, high.z as i32];
        if last == Some((low, high)) {
            continue;
        }
        last = Some((low, high));
        let low: [i32; 3] = std::array::from_fn(|a| low[a].max(range.0[a]));
        let high: [i32; 3] = std::array::from_fn(|a| high[a].min(range.1[a]));
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                for z in low[2]..=high[2] {
                    keys.push([x, y, z]);
                }
            }
        }
    }
    keys.sort_unstable();
    keys.dedup();
    keys
}
