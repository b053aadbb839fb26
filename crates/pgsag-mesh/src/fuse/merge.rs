//! One depth map per image from those of buildings and background (paper 4.4; method 3.8): the mean where they meet,
//! the building inside its mask, else the nearer one if it has the support.

use pgsag_scene::{Map, Mask, PixelClass};

use super::DepthMap;
use crate::error::MeshError;

/// Depths closer than this many voxels are one surface.
const SAME_SURFACE_VOXELS: f64 = 2.0;

/// A pixel with all it carries.
#[derive(Clone, Copy)]
struct Pixel {
    depth: f32,
    weight: f32,
    normal: [f32; 3],
    support: u8,
}

/// Puts a building's depths over the background's. Without a mask every pixel where the building has a depth is inside.
/// `Free` and `Occluded` pixels are the background's; on the `Boundary` neither side has priority.
///
/// # Errors
/// Rasters of different sizes.
pub fn merge_views(
    building: &DepthMap,
    inside: Option<&Mask>,
    background: &DepthMap,
    voxel: f64,
) -> Result<DepthMap, MeshError> {
    if let Some(mask) = inside {
        same_size("the mask", building, mask.width, mask.height)?;
    }
    both(building, background, |at, house, ground| {
        let class = inside.map_or(PixelClass::Inside, |mask| mask.classes[at]);
        match (class.is_active(), house, ground) {
            (true, Some(house), Some(ground)) => Some(resolve(house, ground, class == PixelClass::Inside, voxel)),
            (true, house, ground) => house.or(ground),
            (false, _, ground) => ground,
        }
    })
}

/// Puts the depths of several groups of one image together; none has priority.
///
/// # Errors
/// No map at all; rasters of different sizes.
pub fn combine(maps: &[&DepthMap], voxel: f64) -> Result<DepthMap, MeshError> {
    let Some((first, rest)) = maps.split_first() else {
        let what = "no depth map to combine".to_string();
        return Err(MeshError::Geometry { what, cure: "give at least one" });
    };
    rest.iter().try_fold((*first).clone(), |sum, map| {
        both(&sum, map, |_, one, other| match (one, other) {
            (Some(one), Some(other)) => Some(resolve(one, other, false, voxel)),
            (one, other) => one.or(other),
        })
    })
}

fn resolve(one: Pixel, other: Pixel, priority: bool, voxel: f64) -> Pixel {
    let gap = f64::from((one.depth - other.depth).abs());
    if gap < SAME_SURFACE_VOXELS * voxel {
        let share = other.weight / (one.weight + other.weight);
        let mix = |a: f32, b: f32| a + (b - a) * share;
        let normal = std::array::from_fn(|a| mix(one.normal[a], other.normal[a]));
        return Pixel {
            depth: mix(one.depth, other.depth),
            weight: one.weight.max(other.weight),
            normal: unit(normal),
            support: one.support.max(other.support),
        };
    }
    if priority {
        return one;
    }
    let (near, far) = if one.depth <= other.depth { (one, other) } else { (other, one) };
    if near.support >= far.support { near } else { far }
}

fn unit(v: [f32; 3]) -> [f32; 3] {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    if length > 0.0 { v.map(|c| c / length) } else { v }
}

fn same_size(what: &'static str, map: &DepthMap, found_width: u32, found_height: u32) -> Result<(), MeshError> {
    let (width, height) = (map.depth.width, map.depth.height);
    if (width, height) == (found_width, found_height) {
        return Ok(());
    }
    Err(MeshError::Size { what, width, height, found_width, found_height })
}

fn both(
    one: &DepthMap,
    other: &DepthMap,
    choose: impl Fn(usize, Option<Pixel>, Option<Pixel>) -> Option<Pixel>,
) -> Result<DepthMap, MeshError> {
    same_size("the other depth map", one, other.depth.width, other.depth.height)?;
    let (width, height) = (one.depth.width, one.depth.height);
    let mut result = DepthMap::empty(width, height);
    if one.normal.is_some() || other.normal.is_some() {
        result.normal = Some(Map::filled(width, height, [0.0; 3]));
    }
    for at in 0..one.depth.values.len() {
        let Some(pixel) = choose(at, pixel(one, at), pixel(other, at)) else { continue };
        result.depth.values[at] = pixel.depth;
        result.weight.values[at] = pixel.weight;
        result.support.values[at] = pixel.support;
        if let Some(normals) = &mut result.normal {
            normals.values[at] = pixel.normal;
        }
    }
    Ok(result)
}

fn pixel(map: &DepthMap, at: usize) -> Option<Pixel> {
    let (depth, weight) = (map.depth.values[at], map.weight.values[at]);
    let normal = map.normal.as_ref().map_or([0.0; 3], |normals| normals.values[at]);
    (depth > 0.0 && weight > 0.0).then_some(Pixel { depth, weight, normal, support: map.support.values[at] })
}
