//! The lens models of COLMAP, 0 to 10: projection and its inverse.
//!
//! The definitions are those of COLMAP's `sensor/models.h` (BSD): a point is divided by its depth (fisheye models then
//! replace the radius by the angle to the optical axis), distorted, and scaled by the focal lengths. Rays are returned
//! with z = 1; a fisheye pixel at or beyond 90 degrees from the axis has no such ray and gives `None`, because no
//! pinhole image can hold it.

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use super::Pinhole;

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

impl LensModel {
    /// All models, in the order of their numbers.
    pub const ALL: [Self; 11] = [
        Self::SimplePinhole,
        Self::Pinhole,
        Self::SimpleRadial,
        Self::Radial,
        Self::Opencv,
        Self::OpencvFisheye,
        Self::FullOpencv,
        Self::Fov,
        Self::SimpleRadialFisheye,
        Self::RadialFisheye,
        Self::ThinPrismFisheye,
    ];

    /// COLMAP's name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::SimplePinhole => "SIMPLE_PINHOLE",
            Self::Pinhole => "PINHOLE",
            Self::SimpleRadial => "SIMPLE_RADIAL",
            Self::Radial => "RADIAL",
            Self::Opencv => "OPENCV",
            Self::OpencvFisheye => "OPENCV_FISHEYE",
            Self::FullOpencv => "FULL_OPENCV",
            Self::Fov => "FOV",
            Self::SimpleRadialFisheye => "SIMPLE_RADIAL_FISHEYE",
            Self::RadialFisheye => "RADIAL_FISHEYE",
            Self::ThinPrismFisheye => "THIN_PRISM_FISHEYE",
        }
    }

    /// The model of that name; `None` for names that are not among 0 to 10.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.name() == name)
    }

    /// The model of that number; `None` beyond 10.
    #[must_use]
    pub fn from_number(number: i32) -> Option<Self> {
        usize::try_from(number).ok().and_then(|i| Self::ALL.get(i).copied())
    }

    /// COLMAP's number.
    #[must_use]
    pub fn number(self) -> i32 {
        self as i32
    }

    /// How many focal lengths the model has, 1 or 2.
    #[must_use]
    pub fn focal_count(self) -> usize {
        match self {
            Self::SimplePinhole
            | Self::SimpleRadial
            | Self::Radial
            | Self::SimpleRadialFisheye
            | Self::RadialFisheye => 1,
            _ => 2,
        }
    }

    /// How many parameters the model has.
    #[must_use]
    pub fn parameter_count(self) -> usize {
        match self {
            Self::SimplePinhole => 3,
            Self::Pinhole | Self::SimpleRadial | Self::SimpleRadialFisheye => 4,
            Self::Radial | Self::Fov | Self::RadialFisheye => 5,
            Self::Opencv | Self::OpencvFisheye => 8,
            Self::FullOpencv | Self::ThinPrismFisheye => 12,
        }
    }

    /// Whether the model measures angles from the axis instead of tangents.
    #[must_use]
    pub fn is_fisheye(self) -> bool {
        matches!(self, Self::OpencvFisheye | Self::SimpleRadialFisheye | Self::RadialFisheye | Self::ThinPrismFisheye)
    }

    /// Whether the model has no distortion at all.
    #[must_use]
    pub fn is_pinhole(self) -> bool {
        matches!(self, Self::SimplePinhole | Self::Pinhole)
    }
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

/// The widest and highest image that is believed, pixels.
pub const LARGEST_SIDE_PX: u32 = 1 << 16;

impl From<Pinhole> for LensCamera {
    fn from(camera: Pinhole) -> Self {
        let params = vec![camera.fx, camera.fy, camera.cx, camera.cy];
        Self { model: LensModel::Pinhole, width: camera.width, height: camera.height, params }
    }
}

impl LensCamera {
    /// Says what is wrong with the numbers of the camera, in words.
    ///
    /// # Errors
    /// The first thing that is wrong: the size, the count of parameters, a focal length or a value that is not finite.
    pub fn check(&self) -> Result<(), String> {
        let sides = [self.width, self.height];
        if sides.iter().any(|side| !(1..=LARGEST_SIDE_PX).contains(side)) {
            return Err(format!("an image of {} x {} pixels is not plausible", self.width, self.height));
        }
        let (name, want) = (self.model.name(), self.model.parameter_count());
        if self.params.len() != want {
            return Err(format!("{name} has {want} parameters, not {}", self.params.len()));
        }
        if let Some(bad) = self.params.iter().find(|value| !value.is_finite()) {
            return Err(format!("a parameter of {name} is {bad}"));
        }
        let focals = &self.params[..self.model.focal_count()];
        match focals.iter().find(|&&focal| focal <= 1e-6 || focal > 1e9) {
            Some(bad) => Err(format!("a focal length of {bad} pixels is not plausible")),
            None => Ok(()),
        }
    }

    /// Focal lengths and principal point as a pinhole of the same size, distortion left out.
    #[must_use]
    pub fn without_distortion(&self) -> Pinhole {
        let lens = Lens::new(self);
        Pinhole { width: self.width, height: self.height, fx: lens.fx, fy: lens.fy, cx: lens.cx, cy: lens.cy }
    }

    /// Image coordinates of a point in the camera frame; `None` at or behind the camera plane.
    #[must_use]
    pub fn project(&self, point_camera: DVec3) -> Option<DVec2> {
        Lens::new(self).project(point_camera)
    }

    /// The ray through image coordinates, camera frame, z = 1; `None` where the distortion has no inverse or the ray
    /// is 90 degrees or more from the optical axis.
    #[must_use]
    pub fn unproject(&self, xy_px: DVec2) -> Option<DVec3> {
        Lens::new(self).unproject(xy_px)
    }

    /// The camera of the same image resampled to another size; a single focal length scales by the mean factor, as in
    /// COLMAP's `Camera::Rescale`.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let sx = f64::from(width) / f64::from(self.width);
        let sy = f64::from(height) / f64::from(self.height);
        let scales = if self.model.focal_count() == 1 { vec![0.5 * (sx + sy), sx, sy] } else { vec![sx, sy, sx, sy] };
        let mut params = self.params.clone();
        params.iter_mut().zip(scales).for_each(|(value, scale)| *value *= scale);
        Self { model: self.model, width, height, params }
    }
}

/// A lens with its parameters sorted out, cheap to copy into inner loops.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lens {
    model: LensModel,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// Distortion parameters in the model's order.
    k: [f64; 8],
}

impl Lens {
    /// Missing parameters count as 0; [`LensCamera::check`] refuses them at import.
    pub(crate) fn new(camera: &LensCamera) -> Self {
        let value = |i: usize| camera.params.get(i).copied().unwrap_or(0.0);
        let n = camera.model.focal_count();
        let mut k = [0.0; 8];
        k.iter_mut().enumerate().for_each(|(i, k)| *k = value(n + 2 + i));
        Self { model: camera.model, fx: value(0), fy: value(n - 1), cx: value(n), cy: value(n + 1), k }
    }

    pub(crate) fn project(&self, point: DVec3) -> Option<DVec2> {
        if point.z.is_nan() || point.z < f64::EPSILON {
            return None;
        }
        let mut at = DVec2::new(point.x / point.z, point.y / point.z);
        if self.model.is_fisheye() {
            at = fisheye_from_normal(at);
        }
        let at = self.distort(at);
        let xy = DVec2::new(self.fx * at.x + self.cx, self.fy * at.y + self.cy);
        xy.is_finite().then_some(xy)
    }

    pub(crate) fn unproject(&self, xy_px: DVec2) -> Option<DVec3> {
        let distorted = DVec2::new((xy_px.x - self.cx) / self.fx, (xy_px.y - self.cy) / self.fy);
        let mut at = self.undistort(distorted)?;
        if self.model.is_fisheye() {
            at = normal_from_fisheye(at)?;
        }
        at.is_finite().then(|| at.extend(1.0))
    }

    /// From the ideal to the distorted normalised plane.
    fn distort(&self, at: DVec2) -> DVec2 {
        let k = &self.k;
        let (u, v) = (at.x, at.y);
        let r2 = u * u + v * v;
        match self.model {
            LensModel::SimplePinhole | LensModel::Pinhole => at,
            LensModel::SimpleRadial | LensModel::SimpleRadialFisheye => at + at * (k[0] * r2),
            LensModel::Radial | LensModel::RadialFisheye => at + at * (k[0] * r2 + k[1] * r2 * r2),
            LensModel::Opencv => at + at * (k[0] * r2 + k[1] * r2 * r2) + decentring(at, r2, k[2], k[3]),
            LensModel::OpencvFisheye => {
                let r4 = r2 * r2;
                at + at * (k[0] * r2 + k[1] * r4 + k[2] * (r4 * r2) + k[3] * (r4 * r4))
            }
            LensModel::FullOpencv => {
                let (r4, r6) = (r2 * r2, r2 * r2 * r2);
                let radial = (1.0 + k[0] * r2 + k[1] * r4 + k[4] * r6) / (1.0 + k[5] * r2 + k[6] * r4 + k[7] * r6);
                at * radial + decentring(at, r2, k[2], k[3])
            }
            LensModel::Fov => at * fov_factor(k[0], r2),
            LensModel::ThinPrismFisheye => {
                let (r4, r6) = (r2 * r2, r2 * r2 * r2);
                let radial = k[0] * r2 + k[1] * r4 + k[4] * r6 + k[5] * (r6 * r2);
                at + at * radial + decentring(at, r2, k[2], k[3]) + DVec2::new(k[6], k[7]) * r2
            }
        }
    }

    /// Inverse of [`Self::distort`] by Newton's method from the distorted point, steps bounded as in COLMAP so that
    /// the same branch is found; then refined until the step is below rounding.
    fn undistort(&self, target: DVec2) -> Option<DVec2> {
        const MAX_STEPS: usize = 100;
        const STEP_RADIUS: f64 = 0.1;
        const H: f64 = 1e-6;
        if self.model.is_pinhole() {
            return Some(target);
        }
        let mut at = target;
        for _ in 0..MAX_STEPS {
            let miss = self.distort(at) - target;
            let du = (self.distort(at + DVec2::X * H) - self.distort(at - DVec2::X * H)) / (2.0 * H);
            let dv = (self.distort(at + DVec2::Y * H) - self.distort(at - DVec2::Y * H)) / (2.0 * H);
            let det = du.x * dv.y - dv.x * du.y;
            let mut step = DVec2::new(dv.y * miss.x - dv.x * miss.y, du.x * miss.y - du.y * miss.x) / det;
            if !step.is_finite() {
                return None;
            }
            let radius = STEP_RADIUS * at.length().max(1.0);
            step *= (radius / step.length()).min(1.0);
            at -= step;
            if step.length() <= 1e-14 * at.length().max(1.0) {
                break;
            }
        }
        let miss = (self.distort(at) - target).length();
        (miss <= 1e-11 * target.length().max(1.0)).then_some(at)
    }
}

/// Tangential distortion of OpenCV and COLMAP.
fn decentring(at: DVec2, r2: f64, p1: f64, p2: f64) -> DVec2 {
    let uv = at.x * at.y;
    DVec2::new(2.0 * p1 * uv + p2 * (r2 + 2.0 * at.x * at.x), 2.0 * p2 * uv + p1 * (r2 + 2.0 * at.y * at.y))
}

/// Devernay and Faugeras 2001; the two series are COLMAP's and keep the same limits.
fn fov_factor(omega: f64, r2: f64) -> f64 {
    const NEARLY_ZERO: f64 = 1e-4;
    let omega2 = omega * omega;
    if omega2 < NEARLY_ZERO {
        return (omega2 * r2) / 3.0 - omega2 / 12.0 + 1.0;
    }
    let t = libm::tan(omega / 2.0);
    if r2 < NEARLY_ZERO {
        return (-2.0 * t * (4.0 * r2 * t * t - 3.0)) / (3.0 * omega);
    }
    let radius = r2.sqrt();
    libm::atan(radius * 2.0 * t) / (radius * omega)
}

fn fisheye_from_normal(at: DVec2) -> DVec2 {
    let r = at.length();
    if r > f64::EPSILON { at * (libm::atan(r) / r) } else { at }
}

fn normal_from_fisheye(at: DVec2) -> Option<DVec2> {
    let theta = at.length();
    if theta <= f64::EPSILON {
        return Some(at);
    }
    let scale = libm::tan(theta) / theta;
    (theta < std::f64::consts::FRAC_PI_2).then(|| at * scale)
}

#[cfg(test)]
mod tests;
