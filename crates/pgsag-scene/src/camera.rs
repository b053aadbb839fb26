//! Pinhole intrinsics with a true principal point. Lens models and their removal are in `files::colmap` and
//! `camera::distortion`; everything after import is a pinhole.

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

pub mod distortion;
pub mod undistort;

/// An undistorted camera. Pixel `i` covers `[i, i + 1)`, its centre is `i + 0.5`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pinhole {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point x, pixels.
    pub cx: f64,
    /// Principal point y, pixels.
    pub cy: f64,
}

impl Pinhole {
    /// The ray through image coordinates `(x, y)` in the camera frame, scaled to z = 1.
    #[must_use]
    pub fn ray(&self, x: f64, y: f64) -> DVec3 {
        DVec3::new((x - self.cx) / self.fx, (y - self.cy) / self.fy, 1.0)
    }

    /// Image coordinates of a point in the camera frame; `None` at or behind the camera.
    #[must_use]
    pub fn project(&self, point_camera: DVec3) -> Option<DVec2> {
        (point_camera.z > 0.0).then(|| {
            DVec2::new(
                self.fx * point_camera.x / point_camera.z + self.cx,
                self.fy * point_camera.y / point_camera.z + self.cy,
            )
        })
    }

    /// Whether image coordinates lie on the image.
    #[must_use]
    pub fn contains(&self, at: DVec2) -> bool {
        at.x >= 0.0 && at.y >= 0.0 && at.x < f64::from(self.width) && at.y < f64::from(self.height)
    }

    /// The camera of the same image resampled to another size.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let sx = f64::from(width) / f64::from(self.width);
        let sy = f64::from(height) / f64::from(self.height);
        Self { width, height, fx: self.fx * sx, fy: self.fy * sy, cx: self.cx * sx, cy: self.cy * sy }
    }

    /// The camera of a window of the image whose top-left pixel is `(x0, y0)`.
    #[must_use]
    pub fn cropped(&self, x0: u32, y0: u32, width: u32, height: u32) -> Self {
        Self { width, height, cx: self.cx - f64::from(x0), cy: self.cy - f64::from(y0), ..*self }
    }

    /// Pixels in the image.
    #[must_use]
    pub fn pixel_count(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Geometric mean of the two focal lengths, pixels.
    #[must_use]
    pub fn focal_px(&self) -> f64 {
        (self.fx * self.fy).sqrt()
    }
}
