//! Depth of a trained cloud from one camera, and which of its pixels deserve belief (method.md 3.8, 8.11).

use pgsag_scene::{Map, Mask};
use serde::{Deserialize, Serialize};

use crate::backend::{Backend, PlaneMaps, RenderOptions, ViewCamera};
use crate::train::Result;

/// What a pixel must satisfy.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthOptions {
    /// Least sum of blending weights; 0.9 is strict.
    pub min_opacity: f32,
    /// Largest angle between the ray and the surface normal, degrees.
    pub max_incidence_deg: f32,
    /// Nearest depth, scene units.
    pub near: f32,
    /// Farthest depth, scene units.
    pub far: f32,
    /// A pixel whose both neighbours in a row or column lie farther than this from its plane is the blend of a
    /// foreground with a background; ground sampling distances. Infinite switches the test off.
    pub max_step_gsd: f32,
}

impl Default for DepthOptions {
    fn default() -> Self {
        Self { min_opacity: 0.5, max_incidence_deg: 80.0, near: 0.0, far: f32::INFINITY, max_step_gsd: 2.0 }
    }
}

/// A depth map ready for fusion.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthWithWeight {
    /// z-depth, scene units; 0 where invalid.
    pub depth: Map<f32>,
    /// cos(incidence) · opacity / depth², 1 / scene units²; 0 where invalid.
    pub weight: Map<f32>,
    /// Unit normal in the camera frame, facing the camera (z < 0 on frontal surfaces); zero where invalid.
    pub normal: Map<[f32; 3]>,
}

/// Renders colour and planes of a cloud, without gradients. With a view, only where its mask is active.
///
/// # Errors
/// Where the device fails.
pub fn render_depth<B: Backend>(
    backend: &B,
    cloud: &B::Cloud,
    camera: &ViewCamera,
    mask: Option<&B::View>,
    sh_degree: u8,
) -> Result<PlaneMaps> {
    let options = RenderOptions { sh_degree, planes: true, ..RenderOptions::default() };
    Ok(backend.read(&backend.render(cloud, camera, mask, &options)?)?)
}

/// Keeps the pixels that satisfy `options` and the mask, and weighs them.
#[must_use]
pub fn valid_depth(
    maps: &PlaneMaps,
    camera: &ViewCamera,
    mask: Option<&Mask>,
    options: &DepthOptions,
) -> DepthWithWeight {
    let (width, height) = (maps.depth.width, maps.depth.height);
    let mut out = DepthWithWeight {
        depth: Map::filled(width, height, 0.0),
        weight: Map::filled(width, height, 0.0),
        normal: Map::filled(width, height, [0.0; 3]),
    };
    let min_cosine = libm::cosf(options.max_incidence_deg.to_radians());
    for y in 0..height {
        for x in 0..width {
            let depth = maps.depth.at(x, y);
            let opacity = maps.opacity.at(x, y);
            let in_range = depth > options.near.max(0.0) && depth < options.far;
            if !in_range || opacity < options.min_opacity || mask.is_some_and(|m| !m.at(x, y).is_active()) {
                continue;
            }
            let Some((normal, cosine)) = facing(maps, camera, x, y) else { continue };
            if cosine < min_cosine || is_ramp(maps, camera, x, y, normal, options.max_step_gsd) {
                continue;
            }
            out.depth.set(x, y, depth);
            out.weight.set(x, y, cosine * opacity / (depth * depth));
            out.normal.set(x, y, normal);
        }
    }
    out
}

fn ray(camera: &ViewCamera, x: u32, y: u32) -> [f32; 3] {
    camera.pinhole.ray(f64::from(x) + 0.5, f64::from(y) + 0.5).to_array().map(|v| v as f32)
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Unit normal and cosine of the incidence; `None` where the normal vanishes or turns away.
fn facing(maps: &PlaneMaps, camera: &ViewCamera, x: u32, y: u32) -> Option<([f32; 3], f32)> {
    let blended = maps.normal.at(x, y);
    let length = dot(blended, blended).sqrt();
    if length.is_nan() || length < 1e-6 {
        return None;
    }
    let normal = blended.map(|v| v / length);
    let along = ray(camera, x, y);
    let cosine = -dot(normal, along) / dot(along, along).sqrt();
    (cosine > 0.0).then_some((normal, cosine))
}

/// Whether the pixel lies on neither of two surfaces: both its neighbours along a row or a column are off its plane.
fn is_ramp(maps: &PlaneMaps, camera: &ViewCamera, x: u32, y: u32, normal: [f32; 3], max_step_gsd: f32) -> bool {
    let depth = maps.depth.at(x, y);
    let tolerance = max_step_gsd * depth / camera.pinhole.focal_px() as f32;
    let offset = depth * dot(normal, ray(camera, x, y));
    let is_off = |x: u32, y: u32| {
        let towards = dot(normal, ray(camera, x, y));
        let found = maps.depth.at(x, y);
        // Distance from the plane, along its normal.
        found > 0.0 && (found * towards - offset).abs() > tolerance
    };
    let (width, height) = (maps.depth.width, maps.depth.height);
    let row = x > 0 && x + 1 < width && is_off(x - 1, y) && is_off(x + 1, y);
    let column = y > 0 && y + 1 < height && is_off(x, y - 1) && is_off(x, y + 1);
    row || column
}

#[cfg(test)]
mod tests;
