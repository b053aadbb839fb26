//! One depth map per image from those of buildings and background (paper 4.4; method 3.8): the mean where they meet,
//! the building inside its mask, else the nearer one if it has the support.
//!
//! Along the foot of a facade each model is worst where its own mask ends: nothing holds its last pixels, and they bulge
//! towards the camera. There the two are blended over the overlap of their masks, each with the more weight the farther
//! it is from its own end.

use pgsag_scene::{Map, Mask, PixelClass};

use super::DepthMap;
use crate::error::MeshError;

/// Depths closer than this many voxels are one surface.
const SAME_SURFACE_VOXELS: f64 = 2.0;
/// Depths closer than this many voxels, across the edge of a mask, are of surfaces that meet there: a facade and the
/// ground at its foot. Where one hides the other, at eaves, they differ by more.
pub const MEETING_VOXELS: f64 = 8.0;

/// Where the mask of the buildings ends in an image.
#[derive(Clone, Copy, Debug)]
pub struct Border<'a> {
    /// Of the size of the maps.
    pub classes: &'a Mask,
    /// How far the background was trained into the buildings, pixels.
    pub overlap_px: f32,
}

/// A pixel with all it carries.
#[derive(Clone, Copy)]
struct Pixel {
    depth: f32,
    weight: f32,
    normal: [f32; 3],
    support: u8,
}

/// Puts a building's depths over the background's. Without a border every pixel where the building has a depth is inside.
/// `Free` and `Occluded` pixels are the background's; on the `Boundary` neither side has priority; where surfaces meet
/// within [`MEETING_VOXELS`] the one goes over into the other across the overlap.
///
/// # Errors
/// Rasters of different sizes.
pub fn merge_views(
    building: &DepthMap,
    border: Option<&Border<'_>>,
    background: &DepthMap,
    voxel: f64,
) -> Result<DepthMap, MeshError> {
    let Some(Border { classes, overlap_px }) = border else {
        return both(building, background, |_, house, ground| match (house, ground) {
            (Some(house), Some(ground)) => Some(resolve(house, ground, true, voxel)),
            (house, ground) => house.or(ground),
        });
    };
    same_size("the mask", building, classes.width, classes.height)?;
    let inside_px = inside_px(classes);
    both(building, background, |at, house, ground| {
        let class = classes.classes[at];
        match (class.is_active(), house, ground) {
            (true, Some(house), Some(ground)) => {
                let gap = f64::from((house.depth - ground.depth).abs());
                if gap < MEETING_VOXELS * voxel {
                    // Half and half in the middle of the overlap; the building's alone where the background ends.
                    return Some(mix(house, ground, 1.0 - inside_px[at] / (overlap_px + 1.0)));
                }
                Some(resolve(house, ground, class == PixelClass::Inside, voxel))
            }
            (true, house, ground) => house.or(ground),
            (false, _, ground) => ground,
        }
    })
}

/// `[pixels]` How far inside of the mask a pixel's centre lies, pixels: two passes of a chamfer distance, 0 outside. The
/// image border is no end of a building.
fn inside_px(classes: &Mask) -> Vec<f32> {
    let (width, height) = (classes.width as usize, classes.height as usize);
    let mut inside: Vec<f32> =
        classes.classes.iter().map(|class| if class.is_active() { f32::INFINITY } else { 0.0 }).collect();
    let mut pass = |at: usize, back: bool| {
        let (x, y) = (at % width, at / width);
        let (before, after) = if back { (x + 1 < width, x > 0) } else { (x > 0, x + 1 < width) };
        let is_row = if back { y + 1 < height } else { y > 0 };
        let step = |by: usize| if back { at + by } else { at.wrapping_sub(by) };
        let taps = [
            (before, step(1), 1.0),
            (is_row, step(width), 1.0),
            (is_row && before, step(width + 1), std::f32::consts::SQRT_2),
            (is_row && after, step(width - 1), std::f32::consts::SQRT_2),
        ];
        for (_, other, far) in taps.into_iter().filter(|(is_there, ..)| *is_there) {
            inside[at] = inside[at].min(inside[other] + far);
        }
    };
    (0..width * height).for_each(|at| pass(at, false));
    (0..width * height).rev().for_each(|at| pass(at, true));
    inside.iter_mut().for_each(|distance| *distance = (*distance - 0.5).max(0.0));
    inside
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
        return mix(one, other, 0.5);
    }
    if priority {
        return one;
    }
    let (near, far) = if one.depth <= other.depth { (one, other) } else { (other, one) };
    if near.support >= far.support { near } else { far }
}

/// The mean of two pixels by their weights, the other's counted `share` against `1 - share`.
fn mix(one: Pixel, other: Pixel, share: f32) -> Pixel {
    let share = share.clamp(0.0, 1.0);
    let (ours, theirs) = ((1.0 - share) * one.weight, share * other.weight);
    let part = theirs / (ours + theirs);
    let between = |a: f32, b: f32| a + (b - a) * part;
    Pixel {
        depth: between(one.depth, other.depth),
        weight: one.weight.max(other.weight),
        normal: unit(std::array::from_fn(|a| between(one.normal[a], other.normal[a]))),
        support: one.support.max(other.support),
    }
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
