//! One Gaussian from its parameters to the screen, and the gradients back: the chain of the equations.

use super::cloud::{HARMONICS, MEAN, OPACITY, ROTATION, Row, SCALES};
use crate::equations::algebra::{Mat3, Vec3, add, mat_vec, sub, transpose_vec};
use crate::equations::projection::{self, Lens};
use crate::equations::{activation, covariance, harmonics, plane};

/// Channels that are blended: R G B, normal, distance, one (its sum is the opacity).
pub(super) const CHANNELS: usize = 8;

/// What the screen needs of a Gaussian.
#[derive(Clone, Debug)]
pub(super) struct Projected {
    /// In the cloud.
    pub(super) index: usize,
    /// Mean, camera frame.
    pub(super) point: Vec3<f64>,
    /// Mean, pixels.
    pub(super) screen: [f64; 2],
    /// Inverse screen covariance.
    pub(super) conic: [f64; 3],
    pub(super) opacity: f64,
    pub(super) channels: [f64; CHANNELS],
    shape: Shape,
    screen_covariance: [f64; 3],
    direction: Vec3<f64>,
    eye_distance: f64,
    degree: u8,
}

/// Rotation and extent.
#[derive(Clone, Debug)]
struct Shape {
    unit: [f64; 4],
    norm: f64,
    rotation: Mat3<f64>,
    scales: Vec3<f64>,
    covariance: Mat3<f64>,
    axis: Vec3<f64>,
    normal_camera: Vec3<f64>,
}

/// Gradient of one Gaussian's appearance on the screen, summed over pixels, and its density statistics.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ScreenGradient {
    pub(super) screen: [f64; 2],
    pub(super) conic: [f64; 3],
    pub(super) opacity: f64,
    pub(super) channels: [f64; CHANNELS],
    /// Of the screen position, without the load term.
    pub(super) signed: [f64; 2],
    /// The same, pixels taken absolutely.
    pub(super) absolute: [f64; 2],
    /// Pixels covered.
    pub(super) pixels: f64,
}

impl ScreenGradient {
    pub(super) fn add(&mut self, other: &Self) {
        let sum = |a: &mut [f64], b: &[f64]| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        sum(&mut self.screen, &other.screen);
        sum(&mut self.conic, &other.conic);
        sum(&mut self.channels, &other.channels);
        sum(&mut self.signed, &other.signed);
        sum(&mut self.absolute, &other.absolute);
        self.opacity += other.opacity;
        self.pixels += other.pixels;
    }
}

impl Projected {
    /// `None` nearer than `near`.
    pub(super) fn new(lens: &Lens<f64>, near: f64, index: usize, row: &Row, degree: u8) -> Option<Self> {
        let mean = row.get(MEAN);
        let point = projection::to_camera(lens, mean);
        if point[2] <= near {
            return None;
        }
        let shape = Shape::new(lens, row, mean);
        let screen_covariance = projection::screen_covariance(lens, point, &shape.covariance);
        let (direction, eye_distance) = harmonics::direction(mean, lens.eye);
        let [r, g, b] = harmonics::color(&row.harmonics(), direction, degree);
        let [x, y, z] = shape.normal_camera;
        let distance = plane::distance(shape.normal_camera, point);
        Some(Self {
            index,
            point,
            screen: projection::screen(lens, point),
            conic: projection::conic(screen_covariance),
            opacity: activation::opacity(row.0[OPACITY]),
            channels: [r, g, b, x, y, z, distance, 1.0],
            shape,
            screen_covariance,
            direction,
            eye_distance,
            degree,
        })
    }

    pub(super) fn radius_px(&self) -> f64 {
        projection::radius(self.screen_covariance)
    }

    /// Adds the gradient of the stored parameters to `out`.
    pub(super) fn backward(&self, lens: &Lens<f64>, row: &Row, d: &ScreenGradient, out: &mut Row) {
        let shape = &self.shape;
        let d_screen_covariance = projection::conic_grad(self.conic, d.conic);
        let (d_ellipse, d_covariance) =
            projection::screen_covariance_grad(lens, self.point, &shape.covariance, d_screen_covariance);
        let [r, g, b, x, y, z, distance, _] = d.channels;
        let (d_n, d_plane) = plane::distance_grad(shape.normal_camera, self.point, distance);
        let d_position = projection::screen_grad(lens, self.point, d.screen);
        let d_point = add(add(d_ellipse, d_plane), d_position);
        let d_normal = transpose_vec(&lens.rotation, add([x, y, z], d_n));
        let (d_harmonics, d_direction) =
            harmonics::color_grad(&row.harmonics(), self.direction, self.degree, self.color(), [r, g, b]);
        out.add(MEAN, projection::to_camera_grad(lens, d_point));
        out.add(MEAN, harmonics::direction_grad(self.direction, self.eye_distance, d_direction));
        out.add(OPACITY, [activation::opacity_grad(self.opacity, d.opacity)]);
        for (l, d) in d_harmonics.into_iter().enumerate() {
            out.add(HARMONICS + 3 * l, d);
        }
        shape.backward(&d_covariance, d_normal, out);
    }

    fn color(&self) -> [f64; 3] {
        [self.channels[0], self.channels[1], self.channels[2]]
    }
}

impl Shape {
    fn new(lens: &Lens<f64>, row: &Row, mean: Vec3<f64>) -> Self {
        let (unit, norm) = activation::unit_quaternion(row.get(ROTATION));
        let rotation = covariance::rotation(unit);
        let scales = activation::scales(row.get(SCALES));
        let axis = plane::normal_axis(&rotation, scales, sub(lens.eye, mean));
        let normal_camera = mat_vec(&lens.rotation, plane::normal(&rotation, axis));
        let covariance = covariance::covariance(&rotation, scales);
        Self { unit, norm, rotation, scales, covariance, axis, normal_camera }
    }

    /// Adds what covariance and normal (group frame) give to rotation and scales.
    fn backward(&self, d_covariance: &Mat3<f64>, d_normal: Vec3<f64>, out: &mut Row) {
        let (mut d_rotation, d_scales) = covariance::covariance_grad(&self.rotation, self.scales, d_covariance);
        let d_axis = plane::normal_grad(self.axis, d_normal);
        for (row, d) in d_rotation.iter_mut().zip(d_axis) {
            *row = add(*row, d);
        }
        let d_unit = covariance::rotation_grad(self.unit, &d_rotation);
        out.add(SCALES, activation::scales_grad(self.scales, d_scales));
        out.add(ROTATION, activation::unit_quaternion_grad(self.unit, self.norm, d_unit));
    }
}
