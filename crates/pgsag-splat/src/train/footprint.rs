//! How large a pixel is at each Gaussian: the nearest view decides (method.md 8.1).
//!
//! Sizes are angles seen from that view, told in reference pixels of 1/1000 rad: at full frame and 1000 px they are
//! pixels, and they change neither with a crop nor with the resolution of one scene (method.md 8.2).

use rayon::prelude::*;

use crate::backend::ViewCamera;
use crate::cloud::SplatCloud;

/// Reference pixels per radian: a 1000 px frame of a usual lens.
pub const REFERENCE_FOCAL_PX: f32 = 1000.0;

/// A Gaussian as its finest view has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// z-depth in that view, scene units; infinite where no view contains it.
    pub depth: f32,
    /// Focal length of that view, pixels; 0 where no view contains it.
    pub focal_px: f32,
}

impl Footprint {
    /// Seen by no view.
    pub const UNSEEN: Self = Self { depth: f32::INFINITY, focal_px: 0.0 };

    /// Ground sampling distance, scene units per pixel.
    #[must_use]
    pub fn gsd(&self) -> f32 {
        self.depth / self.focal_px
    }

    /// A length at the Gaussian, in reference pixels.
    #[must_use]
    pub fn reference_px(&self, length: f32) -> f32 {
        length / self.depth * REFERENCE_FOCAL_PX
    }
}

/// The z-depth and pixel coordinates of a point of the group's frame; `None` outside the raster or nearer than `near`.
#[must_use]
pub fn locate(camera: &ViewCamera, point: [f32; 3]) -> Option<(f64, [f64; 2])> {
    let p = point.map(f64::from);
    let [x, y, z] = [0, 1, 2].map(|i| {
        let row = camera.rotation[i];
        row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + camera.translation[i]
    });
    if z <= camera.near.max(f64::MIN_POSITIVE) {
        return None;
    }
    let pinhole = &camera.pinhole;
    let at = glam::DVec2::new(pinhole.fx * x / z + pinhole.cx, pinhole.fy * y / z + pinhole.cy);
    pinhole.contains(at).then_some((z, at.to_array()))
}

/// The footprint of every Gaussian, `[N]`; work is views times Gaussians.
#[must_use]
pub fn footprints(means: &[[f32; 3]], cameras: &[ViewCamera]) -> Vec<Footprint> {
    means
        .par_iter()
        .with_min_len(256)
        .map(|mean| {
            let mut best = Footprint::UNSEEN;
            let mut best_gsd = f64::INFINITY;
            for camera in cameras {
                if let Some((z, _)) = locate(camera, *mean) {
                    let gsd = z / camera.pinhole.focal_px();
                    if gsd < best_gsd {
                        best_gsd = gsd;
                        best = Footprint { depth: z as f32, focal_px: camera.pinhole.focal_px() as f32 };
                    }
                }
            }
            best
        })
        .collect()
}

/// Median depth and median ground sampling distance over the Gaussians that some view contains.
#[must_use]
pub fn medians(cloud: &SplatCloud, cameras: &[ViewCamera]) -> Option<(f32, f32)> {
    let seen: Vec<Footprint> = footprints(&cloud.means, cameras).into_iter().filter(|f| f.focal_px > 0.0).collect();
    let depth = pgsag_scene::numbers::median(&mut seen.iter().map(|f| f64::from(f.depth)).collect::<Vec<_>>())?;
    let gsd = pgsag_scene::numbers::median(&mut seen.iter().map(|f| f64::from(f.gsd())).collect::<Vec<_>>())?;
    Some((depth as f32, gsd as f32))
}

#[cfg(test)]
mod tests;
