//! A depth map as one small plane per pixel: a voxel is measured against the plane of the pixel it projects to, which
//! is exact on flat surfaces at any incidence, where the usual depth difference is off by half a pixel times the slope.

use glam::{DVec3, Vec3};
use pgsag_scene::Map;
use rayon::prelude::*;

use super::{Lattice, TsdfOptions};
use crate::fuse::DepthView;

/// What one pixel says about the surface. Camera frame, f32.
#[derive(Clone, Copy, Default)]
pub(crate) struct PixelPlane {
    /// Unit normal towards the camera; distance of `x` in front of the surface is `normal . x + offset`.
    pub normal: Vec3,
    /// Scene units, positive.
    pub offset: f32,
    /// Depth along the optical axis.
    pub depth: f32,
    /// Cosine of the incidence.
    pub cos: f32,
    /// 0 where the pixel says nothing.
    pub weight: f32,
}

/// One plane per pixel, row-major. Weight: confidence * cos(incidence) * (voxel / gsd)^2 (method 3.8), the last factor
/// at most 4, so that a weight of 1 is one frontal pixel as large as a voxel.
pub(crate) fn pixel_planes(view: &DepthView<'_>, lattice: &Lattice, options: &TsdfOptions) -> Vec<PixelPlane> {
    let camera = view.camera;
    let width = camera.width as usize;
    let voxel_px = lattice.voxel * camera.focal_px();
    let mut planes = vec![PixelPlane::default(); camera.pixel_count()];
    planes.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, row)| {
        for (x, plane) in row.iter_mut().enumerate() {
            let at = y * width + x;
            let (depth, confidence) = (view.depth.values[at], view.weight.values[at]);
            let usable = depth > 0.0 && depth.is_finite() && confidence > 0.0 && confidence.is_finite();
            if !usable || f64::from(depth) > options.max_depth {
                continue;
            }
            let ray = camera.ray(x as f64 + 0.5, y as f64 + 0.5);
            let given = view.normal.as_ref().map(|map| map.values[at].map(f64::from)).map(DVec3::from);
            let normal = given
                .and_then(DVec3::try_normalize)
                .or_else(|| depth_normal(&view.depth, &camera, x as u32, y as u32))
                .unwrap_or_else(|| -ray.normalize());
            let normal = if normal.dot(ray) > 0.0 { -normal } else { normal };
            let cos = -normal.dot(ray) / ray.length();
            if cos < options.min_cos {
                continue;
            }
            let depth = f64::from(depth);
            let sampling = voxel_px / depth;
            *plane = PixelPlane {
                normal: normal.as_vec3(),
                offset: (-normal.dot(ray) * depth) as f32,
                depth: depth as f32,
                cos: cos as f32,
                weight: (f64::from(confidence) * cos * (sampling * sampling).min(4.0)) as f32,
            };
        }
    });
    planes
}

/// The normal of the surface at a pixel from the depths about it, towards the camera. On either axis the side with the
/// smaller step is taken, so that a roof's edge pixels keep the roof's normal. `None` where an axis has no neighbour.
pub(crate) fn depth_normal(depth: &Map<f32>, camera: &pgsag_scene::Pinhole, x: u32, y: u32) -> Option<DVec3> {
    let here = f64::from(depth.at(x, y));
    let point = |x: u32, y: u32, z: f64| camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5) * z;
    let center = point(x, y, here);
    let step = |before: Option<(u32, u32)>, after: Option<(u32, u32)>| {
        let read = |at: Option<(u32, u32)>| {
            at.map(|(x, y)| (x, y, f64::from(depth.at(x, y)))).filter(|(_, _, z)| *z > 0.0 && z.is_finite())
        };
        match (read(before), read(after)) {
            (Some(b), Some(a)) if (b.2 - here).abs() < (a.2 - here).abs() => Some(center - point(b.0, b.1, b.2)),
            (_, Some(a)) => Some(point(a.0, a.1, a.2) - center),
            (Some(b), None) => Some(center - point(b.0, b.1, b.2)),
            (None, None) => None,
        }
    };
    let along_x = step(x.checked_sub(1).map(|x| (x, y)), (x + 1 < depth.width).then_some((x + 1, y)))?;
    let along_y = step(y.checked_sub(1).map(|y| (x, y)), (y + 1 < depth.height).then_some((x, y + 1)))?;
    let normal = along_y.cross(along_x).try_normalize()?;
    Some(if normal.dot(center) > 0.0 { -normal } else { normal })
}
