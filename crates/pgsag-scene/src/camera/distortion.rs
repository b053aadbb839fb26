//! The lens models of COLMAP, 0 to 10: projection and its inverse.

use serde::{Deserialize, Serialize};

/// COLMAP's camera models by their numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum LensModel {
    /// f, cx, cy
    SimplePinhole = 0,
    /// fx, fy, cx, cy
    Pinhole = 1,
    /// f, cx, cy, k
    SimpleRadial = 2,
    /// f, cx, cy, k1, k2
    Radial = 3,
    /// fx, fy, cx, cy, k1, k2, p1, p2
    Opencv = 4,
    /// fx, fy, cx, cy, k1, k2, k3, k4
    OpencvFisheye = 5,
    /// fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6
    FullOpencv = 6,
    /// fx, fy, cx, cy, omega
    Fov = 7,
    /// f, cx, cy, k
    SimpleRadialFisheye = 8,
    /// f, cx, cy, k1, k2
    RadialFisheye = 9,
    /// fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1
    ThinPrismFisheye = 10,
}

/// A camera as photographed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LensCamera {
    /// Which lens.
    pub model: LensModel,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// In the model's order; as many as the model has.
    pub params: Vec<f64>,
}
